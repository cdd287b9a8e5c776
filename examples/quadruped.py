"""A quadruped on four feet, one of them on ice, pushed from behind until that foot slips.

The robot of urdf/quadruped.urdf holds its stance with joint springs and dampers about torques from inverse dynamics,
and stands without creep. A push grows slowly; the foot on ice begins to slip at the force where its cone says so, the
other three stay where they are; when the push goes the robot comes back, and the foot stands a little elsewhere.

    python examples/quadruped.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "quadruped.urdf"
FEET = ("fl", "fr", "hl", "hr")
SHANK, FOOT = 0.16, 0.016
BEND, MU, MU_ICE, ICY = 0.6, 0.7, 0.2, "hl"
STIFFNESS, DAMPING = 30.0, 1.2
# modes of a contact
STICK, SLIP = 1, 2


def quadruped() -> pc.Scene:
    """Four round feet on the floor, one with little friction."""
    scene = pc.Scene.from_urdf(URDF, floating_base=True)
    floor = scene.add_contour("floor", pc.Plane())
    centre = pin.SE3(np.eye(3), np.array([0.0, 0.0, -SHANK]))
    for name in FEET:
        foot = scene.add_contour(name, pc.Sphere(FOOT), f"{name}_shank", centre)
        scene.add_contact(name, foot, floor, friction=pc.Coulomb(MU_ICE if name == ICY else MU))
    return scene


def standing(scene: pc.Scene) -> pc.State:
    """Knees back, feet below the hips."""
    model = scene.model
    q = pin.neutral(model)
    q[2] = 2.0 * SHANK * math.cos(BEND) + FOOT
    for name in FEET:
        q[model.joints[model.getJointId(f"{name}_hip")].idx_q] = BEND
        q[model.joints[model.getJointId(f"{name}_knee")].idx_q] = -2.0 * BEND
    return scene.initial_state(q)


def main(html: Path | None = None, push: float = 16.0) -> dict[str, float]:
    scene = quadruped()
    state = standing(scene)
    holding = pc.inverse_dynamics(scene, state).tau
    duration, grows, step = 2.0, 1.2, 1e-3

    def pushed(t: float) -> float:
        """The push in N: grows linearly for a while, then goes smoothly."""
        return push * t / grows if t < grows else push * math.exp(-(((t - grows) / 0.1) ** 2))

    def stance(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        tau = holding.copy()
        tau[6:] -= STIFFNESS * (q[7:] - state.q[7:]) + DAMPING * v[6:]
        return tau

    def control(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        tau = stance(t, q, v)
        tau[:3] += pin.Quaternion(q[3:7]).matrix()[0] * pushed(t)
        return tau

    rest = pc.simulate(scene, state, 1.0, control=stance)
    # the friction of a foot that creeps can turn in no time; time stepping does not mind, and finds the slip to a step
    run = pc.simulate(scene, state, duration, control=control, method="Moreau", dt=step)
    ice = run.contacts[ICY]
    coarse = float(run.t[np.argmax(ice.mode == SLIP)])
    # which an event-driven run then locates
    exact = pc.simulate(scene, state, coarse + step, control=control, rtol=1e-9)
    slip = next(event for event in exact.events if event.kind == "slip")
    at = int(np.searchsorted(exact.t, slip.time))
    cone = exact.contacts[ICY].tangential_force[at] / exact.contacts[ICY].normal_force[at]
    others = [name for name in FEET if name != ICY]
    result = {
        "status": run.status,
        "rest_drift": float(np.abs(rest.q[-1] - rest.q[0]).max()),
        "weight_error": float(abs(sum(rest.contacts[name].normal_force[-1] for name in FEET) / weight(scene) - 1.0)),
        "slips_at": slip.time,
        "coarse": coarse,
        "cone": float(cone),
        "others_stick": float(all((run.contacts[name].mode == STICK).all() for name in others)),
        "others_slip": float(max(np.linalg.norm(run.contacts[name].slip_velocity, axis=1).max() for name in others)),
        "slid": float(np.linalg.norm(ice.point[-1] - ice.point[0])),
        "sticks_again": float(ice.mode[-1] == STICK),
    }
    print(f"one second at rest: q moves by {result['rest_drift']:.0e}")
    print(
        f"{ICY} slips at {slip.time:.9f} s, a push of {pushed(slip.time):.3f} N, where it carries {cone:.9f} of its "
        f"load sideways (time stepping: {coarse:.3f} s)"
    )
    print(
        f"{run.message} The foot stands {1e3 * result['slid']:.2f} mm from where it stood; the others slip at "
        f"{result['others_slip']:.0e} m/s at most"
    )
    if html is not None:
        print(f"wrote {pc.export_html(run, html)}")
    return result


def weight(scene: pc.Scene) -> float:
    """Of the robot, N."""
    return float(pin.computeTotalMass(scene.model) * -scene.model.gravity.linear[2])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    main(parser.parse_args().html)
