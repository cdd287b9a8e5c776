"""A quadruped shifts its weight to three feet and lifts the fourth, by inverse dynamics within friction cones at 1 kHz.

Each millisecond one call of `inverse_dynamics` finds the torques for the accelerations that a trunk and a foot ought to
have, with forces inside the friction cones and torques within their limits. The trunk moves until its centre of mass
stands within the triangle of three feet; then the fourth foot's load is let go over 0.2 s, and the foot rises
along a smooth path. Once three feet carry all, their loads follow from equilibrium alone: three moments, three loads.

    python examples/quadruped_lifts_foot.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "quadruped.urdf"
FEET, LIFTED = ("fl", "fr", "hl", "hr"), "fl"
SHANK, FOOT, BEND, MU = 0.16, 0.016, 0.6, 0.6
# s: shifting the trunk, unloading the foot, lifting it; m: where the trunk goes, how high the foot
SHIFT, UNLOAD, LIFT = 0.8, 0.2, 0.4
ASIDE, HEIGHT = np.array([-0.045, -0.045]), 0.03
# of joints, N m
EFFORT = 8.0
# rates of the trunk's and the foot's errors, 1/s: critically damped
RATE = 20.0


def quadruped() -> pc.Scene:
    scene = pc.Scene.from_urdf(URDF, floating_base=True)
    limits = scene.model.effortLimit.copy()
    limits[6:] = EFFORT
    scene.model.effortLimit = limits
    floor = scene.add_contour("floor", pc.Plane())
    centre = pin.SE3(np.eye(3), np.array([0.0, 0.0, -SHANK]))
    for name in FEET:
        scene.add_contour(name, pc.Sphere(FOOT), f"{name}_shank", centre)
        scene.add_contact(name, name, floor, friction=pc.Coulomb(MU))
        shank = scene.model.frames[scene.model.getFrameId(f"{name}_shank")]
        scene.model.addFrame(
            pin.Frame(f"{name}_foot", shank.parentJoint, 0, shank.placement * centre, pin.FrameType.OP_FRAME)
        )
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


def rise(part: float, duration: float) -> tuple[float, float, float]:
    """From 0 to 1 with no speed and no acceleration at both ends, and its first two rates in 1/s, 1/s^2."""
    x = min(max(part, 0.0), 1.0)
    return (
        x**3 * (10.0 - 15.0 * x + 6.0 * x * x),
        30.0 * x**2 * (1.0 - x) ** 2 / duration,
        60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / duration**2,
    )


class Controller:
    """Wanted accelerations, and the call that finds torques for them."""

    def __init__(self, scene: pc.Scene, state: pc.State) -> None:
        self.scene, self.model, self.data = scene, scene.model, scene.model.createData()
        self.base, self.foot = self.model.getFrameId("base"), self.model.getFrameId(f"{LIFTED}_foot")
        pin.framesForwardKinematics(self.model, self.data, state.q)
        self.trunk_start = self.data.oMf[self.base].translation.copy()
        self.foot_start = self.data.oMf[self.foot].translation.copy()
        self.found: pc.InverseDynamics | None = None
        # the lifted foot's force as it was when the trunk had arrived
        self.released: np.ndarray | None = None
        self.times: list[float] = []

    def __call__(self, state: pc.State) -> pc.InverseDynamics:
        model, data, t = self.model, self.data, state.t
        pin.forwardKinematics(model, data, state.q, state.v)
        pin.updateFramePlacements(model, data)
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

        def follow(frame: int, place: np.ndarray, rate: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
            velocity = pin.getFrameVelocity(model, data, frame, axes).linear
            error = place - data.oMf[frame].translation
            return acceleration + 2.0 * RATE * (rate - velocity) + RATE**2 * error

        way = np.append(ASIDE, 0.0)
        s, ds, dds = rise(t / SHIFT, SHIFT)
        turning = pin.getFrameVelocity(model, data, self.base, axes).angular
        upright = -(RATE**2) * pin.log3(data.oMf[self.base].rotation) - 2.0 * RATE * turning
        wanted = {
            "base": np.append(follow(self.base, self.trunk_start + s * way, ds * way, dds * way), upright),
        }
        forces = None
        if t >= SHIFT and self.found is not None:
            if self.released is None:
                self.released = self.found.forces[LIFTED].copy()
            left = 1.0 - rise((t - SHIFT) / UNLOAD, UNLOAD)[0]
            forces = {LIFTED: left * self.released if left > 1e-9 else np.zeros(3)}
        if t >= SHIFT + UNLOAD:
            s, ds, dds = rise((t - SHIFT - UNLOAD) / LIFT, LIFT)
            up = np.array([0.0, 0.0, HEIGHT])
            wanted[f"{LIFTED}_foot"] = follow(self.foot, self.foot_start + s * up, ds * up, dds * up)
        begin = time.perf_counter()
        self.found = pc.inverse_dynamics(
            self.scene, state, wanted, forces=forces, cones=True, effort_limits=True, warm=self.found
        )
        self.times.append(time.perf_counter() - begin)
        return self.found


def three_loads(model: pin.Model, state: pc.State, points: list[np.ndarray]) -> np.ndarray:
    """Of three feet (their centres) that carry a robot at rest, N: its centre of mass is over their weighted mean."""
    centre = pin.centerOfMass(model, model.createData(), state.q)
    rows = np.vstack([np.array(points).T[:2], np.ones(3)])
    return np.linalg.solve(rows, np.append(centre[:2], 1.0)) * pin.computeTotalMass(model) * 9.81


def main(html: Path | None = None, duration: float = 2.0, dt: float = 1e-3) -> dict[str, float]:
    scene = quadruped()
    model, data = scene.model, scene.model.createData()
    begin = state = standing(scene)
    stepper = pc.Stepper(scene, state, dt=dt)
    controller = Controller(scene, state)
    others = [name for name in FEET if name != LIFTED]
    torques, cone, effort, left = [], 0.0, 0.0, 0.0
    while stepper.t < duration - 0.5 * dt:
        found = controller(state)
        state = stepper.step(found.tau)
        torques.append(found.tau)
        effort, left = max(effort, float(np.abs(found.efforts).max())), max(left, found.residual)
        cone = max(cone, *(float(np.hypot(*found.forces[name][:2]) / -found.forces[name][2]) for name in others))
    pin.framesForwardKinematics(model, data, state.q)
    places = {name: data.oMf[model.getFrameId(f"{name}_foot")].translation for name in FEET}
    loads = np.array([-stepper.forces[name][2] for name in others])
    expected = three_loads(model, state, [places[name] for name in others])
    trunk = data.oMf[controller.base].translation - controller.trunk_start
    times = 1e3 * np.array(controller.times)
    result = {
        "raised": float(places[LIFTED][2] - controller.foot_start[2]),
        "trunk_error": float(np.linalg.norm(trunk[:2] - ASIDE)),
        "load_error": float(np.abs(loads - expected).max()),
        "least_load": float(loads.min()),
        "largest_ratio": cone,
        "largest_effort": effort,
        "residual": left,
        "lifted_force": float(np.abs(stepper.forces[LIFTED]).max()),
    }
    print(
        f"{LIFTED} stands {1e3 * result['raised']:.2f} mm above the floor, the trunk has gone "
        f"{1e3 * np.linalg.norm(ASIDE):.0f} mm aside, to {1e3 * result['trunk_error']:.0e} mm"
    )
    print(
        f"three feet carry {', '.join(f'{load:.4f}' for load in loads)} N; "
        f"by moments {', '.join(f'{load:.4f}' for load in expected)} N"
    )
    print(f"friction at most {cone:.4f} of the load ({MU} sticks), torques at most {effort:.3f} N m of {EFFORT}")
    print(
        f"{len(times)} calls: {np.median(times):.2f} ms at the median, {np.percentile(times, 99.0):.2f} ms at 99 %; "
        f"of the equations of motion {left:.0e} N are left"
    )
    if html is not None:
        played = pc.simulate(
            scene,
            begin,
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
