"""The ant of MuJoCo's benchmarks, with its floor: an MJCF file on rigid contacts.

The file is read as it is. Its plane becomes the floor, the rounded ends of its capsules become feet, with the file's
friction. The ant does push-ups, its feet sliding out and in. MuJoCo runs the same file beside it, from the same start,
with the same torques; its contacts are soft, so that the two agree up to what they give way.

The file is not part of this package: pip install "pincontact[robots,mjcf]", or gymnasium and mujoco by themselves.

    python examples/mujoco_ant.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import mujoco
import numpy as np
from robot_data import RobotDataMissing, gymnasium_model

import pincontact as pc

FILE = "ant.xml"
# N m at each ankle, the part that carries the body and that of the push-ups, and s
HOLD, TORQUE, PERIOD = 0.8, 1.5, 2.0


def ant() -> pc.Scene:
    """The ant on its four feet."""
    path = gymnasium_model(FILE)
    scene = pc.Scene.from_mjcf(path)
    shapes = scene.add_contours_from_collision()
    (floor,) = [name for name, shape in shapes.items() if isinstance(shape.contour, pc.Plane)]
    friction = mujoco.MjModel.from_xml_path(str(path)).geom("floor").friction[0]
    # a foot is the ball at the far end of a leg's last capsule
    feet = [name for name, shape in shapes.items() if np.linalg.norm(shape.placement.translation[:2]) > 0.5]
    for name in feet:
        scene.add_contact(name, name, floor, friction=pc.Coulomb(friction))
    return scene


def push(t: float) -> np.ndarray:
    """Torques of the eight motors: the ankles', whose axes differ in sign."""
    return (HOLD + TORQUE * math.cos(2.0 * math.pi * t / PERIOD)) * np.array([0, 1, 0, -1, 0, -1, 0, 1], dtype=float)


def in_mujoco(state: pc.State, duration: float) -> tuple[np.ndarray, float]:
    """qpos after a run of MuJoCo's, and how deep its contacts are at the end, m.

    They begin where shapes touch, and are as hard and as little creeping as they can be.
    """
    model = mujoco.MjModel.from_xml_path(str(gymnasium_model(FILE)))
    model.geom_margin[:] = 0.0
    model.opt.timestep, model.opt.cone, model.opt.impratio = 2e-4, mujoco.mjtCone.mjCONE_ELLIPTIC, 100.0
    data = mujoco.MjData(model)
    data.qpos[:] = state.q
    data.qpos[3:7] = np.roll(state.q[3:7], 1)
    while data.time < duration - 1e-9:
        data.qfrc_applied[6:] = push(data.time)
        mujoco.mj_step(model, data)
    return data.qpos.copy(), float(max(-contact.dist for contact in data.contact))


def main(html: Path | None = None, duration: float = 2.0) -> dict[str, float]:
    scene = ant()
    q = scene.model.referenceConfigurations["qpos0"].copy()
    # legs down, each foot at the same height
    q[7:] = [0.0, 0.7, 0.0, -0.7, 0.0, -0.7, 0.0, 0.7]
    q[2] = 0.44
    state = scene.initial_state(q, max_gap=0.1)
    # feet that slide in under a load jam for a moment, friction being 1: time stepping goes through that
    run = pc.simulate(
        scene, state, duration, method="Moreau", dt=1e-3, control=lambda t, q, v: np.r_[np.zeros(6), push(t)]
    )
    there, depth = in_mujoco(state, duration)
    tracks = list(run.contacts.values())
    result = {
        "status": run.status,
        "height_apart": float(abs(run.q[-1, 2] - there[2])),
        "angle_apart": float(np.abs(run.q[-1, 7:] - there[7:]).max()),
        "depth": depth,
        "rises": float(np.ptp(run.q[:, 2])),
        "slides": float(max(np.linalg.norm(np.diff(track.point, axis=0), axis=1).sum() for track in tracks)),
        "sticks": float(any((track.mode == 1).any() for track in tracks)),
        "slips": float(any((track.mode == 2).any() for track in tracks)),
    }
    print(
        f"{run.message} The body goes up and down by {1e3 * result['rises']:.1f} mm, each foot goes "
        f"{1e3 * result['slides']:.1f} mm over the floor"
    )
    print(
        f"MuJoCo ends {1e6 * result['height_apart']:.0f} um and {1e3 * result['angle_apart']:.2f} mrad from here; its "
        f"feet are {1e6 * depth:.2f} um deep"
    )
    if html is not None:
        print(f"wrote {pc.export_html(run, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    try:
        main(parser.parse_args().html)
    except RobotDataMissing as missing:
        raise SystemExit(str(missing)) from missing
