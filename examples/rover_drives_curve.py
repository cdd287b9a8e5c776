"""A rover speeds up on a circle as its tyres let it, by inverse dynamics within friction cones at 1 kHz.

Each millisecond one call of `inverse_dynamics` finds the torques of both wheels of urdf/rover.urdf for the
accelerations nearest to those wanted, with forces inside friction cones and torques within their limits. The robot asks
for more than it can have. The controller's tyres have a little less friction than the real ones: it drives off at the
edge of its cones, along the circle and without a slip, and comes to a steady turn. There the tyres' sideways forces and
their loads have closed forms.

    python examples/rover_drives_curve.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "rover.urdf"
WHEEL, TYRE, HALF_TRACK = 0.08, 0.015, 0.17
CASTER_RADIUS, CASTER_BEHIND = 0.03, 0.16
# friction of the tyres, and what the controller trusts in; N m
MU, TRUSTED, EFFORT = 0.5, 0.45, 3.0
# the circle in m, the speed on it in m/s, what is asked for to reach it, in m/s^2, and rates of errors, 1/s
RADIUS, SPEED, HASTE, RATE = 0.8, 1.4, 6.0, 20.0
WHEELS = ("left", "right")
# mode of a contact
STICK = 1


def rover(mu: float) -> pc.Scene:
    """Two tyres and a caster on the floor."""
    scene = pc.Scene.from_urdf(URDF, floating_base=True)
    limits = scene.model.effortLimit.copy()
    limits[6:] = EFFORT
    scene.model.effortLimit = limits
    floor = scene.add_contour("floor", pc.Plane())
    axle = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    for name in WHEELS:
        tyre = scene.add_contour(name, pc.Torus(WHEEL - TYRE, TYRE), f"{name}_wheel", axle)
        scene.add_contact(name, tyre, floor, friction=pc.Coulomb(mu))
    centre = pin.SE3(np.eye(3), np.array([-CASTER_BEHIND, 0.0, CASTER_RADIUS - WHEEL]))
    scene.add_contact("caster", scene.add_contour("caster", pc.Sphere(CASTER_RADIUS), "base", centre), floor)
    return scene


def closed_forms(model: pin.Model) -> tuple[float, float]:
    """In the steady turn to the left: the tyres' sideways force on the robot, and the load of the right less that of
    the left, N."""
    base, wheel = model.inertias[1], model.inertias[2]
    turning = SPEED**2 / RADIUS
    sideways = (base.mass + 2.0 * wheel.mass) * turning
    # moments about the line of motion: inertia at its height, and the spin of the wheels, which turns along
    moment = (base.mass * (WHEEL + base.lever[2]) + 2.0 * wheel.mass * WHEEL) * turning
    moment += 2.0 * wheel.inertia[1, 1] * turning / WHEEL
    return sideways, moment / HALF_TRACK


def main(html: Path | None = None, duration: float = 3.0, dt: float = 1e-3) -> dict[str, float]:
    scene, trusted = rover(MU), rover(TRUSTED)
    model = scene.model
    q = pin.neutral(model)
    q[2] = WHEEL
    start = state = scene.initial_state(q)
    stepper = pc.Stepper(scene, state, dt=dt)
    found: pc.InverseDynamics | None = None
    torques, ratios, efforts, off, limited, sliding = [], [], [], 0.0, 0, 0
    while stepper.t < duration - 0.5 * dt:
        speed, rate = state.v[0], state.v[5]
        forward = min(RATE * (SPEED - speed), HASTE)
        # turning follows the speed that there is
        gained = forward if found is None else found.acceleration[0]
        turn = gained / RADIUS + RATE * (speed / RADIUS - rate)
        found = pc.inverse_dynamics(
            trusted,
            replace(state, scene=trusted),
            {"root_joint": [forward, 0.0, 0.0, 0.0, 0.0, turn]},
            weights={"root_joint": [1.0, 0.0, 0.0, 0.0, 0.0, 1.0]},
            cones=True,
            effort_limits=True,
            unreachable="nearest",
            warm=found,
        )
        limited += found.certificate is not None
        state = stepper.step(found.tau)
        torques.append(found.tau)
        efforts.append(np.abs(found.efforts).max())
        ratios.append([np.hypot(*found.forces[name][:2]) / -found.forces[name][2] for name in WHEELS])
        sliding += int((stepper.modes[:2] != STICK).sum())
        off = max(off, abs(np.hypot(state.q[0], state.q[1] - RADIUS) - RADIUS))
    # on the robot, along its own axes
    turned = pin.Quaternion(state.q[3:7]).matrix()
    forces = {name: -turned.T @ stepper.forces[name] for name in WHEELS}
    sideways = sum(force[1] for force in forces.values())
    transfer = forces["right"][2] - forces["left"][2]
    expected_sideways, expected_transfer = closed_forms(model)
    result = {
        "speed": float(state.v[0]),
        "off_circle": float(off),
        "sideways": float(sideways),
        "expected_sideways": expected_sideways,
        "transfer": float(transfer),
        "expected_transfer": expected_transfer,
        "largest_ratio": float(np.max(ratios)),
        "sliding": float(sliding),
        "largest_effort": float(np.max(efforts)),
        "limited": float(limited),
    }
    print(
        f"{state.v[0]:.6f} m/s after {duration} s, within {1e3 * off:.2f} mm of the circle; in {limited} calls "
        "the tyres were the limit"
    )
    print(
        f"friction at most {np.max(ratios):.6f} of the load ({TRUSTED} is trusted in, {MU} sticks), {sliding} slips, "
        f"torques at most {np.max(efforts):.3f} N m"
    )
    print(
        f"sideways {sideways:.6f} N (closed form {expected_sideways:.6f}), loads differ by {transfer:.6f} N "
        f"({expected_transfer:.6f})"
    )
    if html is not None:
        played = pc.simulate(
            scene,
            start,
            duration,
            control=lambda t, q, v: torques[min(int(t / dt + 1e-6), len(torques) - 1)],
            method="Moreau",
            dt=dt,
        )
        print(f"wrote {pc.export_html(played, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    main(parser.parse_args().html)
