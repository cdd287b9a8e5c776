"""Long form of the random runs of time stepping: thrown bodies, boxes, rods and chains, whatever the seed makes.

    python tests/stress/random_runs.py [number of runs] [first seed]

Every run must end by itself, without NaN, in its time; contacts must not do work in any step, beyond what the end of
slip within a step leaves; and the total energy must not rise beyond the errors of first order of the step.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pinocchio as pin

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from test_moreau import G, body_scene, random_scene

import pincontact as pc

STEP, DURATION = 1e-3, 0.4
# Work of the contacts in one step, and rise of the total energy, over the largest kinetic energy. Where slip ends
# within a step, the impulse that ends it meets the mean of the velocities at both ends.
WORK, RISE = 1e-3, 0.1
# s for a run of 0.1 s: what no run may take
PATIENCE = 60.0


def random_law(rng):
    laws = [None, pc.Coulomb(rng.uniform(0.0, 0.3)), pc.Coulomb(rng.uniform(0.3, 2.0)), pc.NoSlip()]
    return laws[rng.integers(4)]


def box(rng):
    """A box thrown on its eight corners, all of the same law."""
    size, mass = rng.uniform(0.05, 0.3, 3), 10.0 ** rng.uniform(-1.0, 1.0)
    moments = mass / 3.0 * (size @ size - size * size)
    scene = body_scene(pin.JointModelFreeFlyer(), mass, moments)
    floor = scene.add_contour("floor", pc.Plane())
    law, restitution = random_law(rng), float(rng.choice([0.0, rng.random()]))
    for i in range(8):
        place = size * [1 - 2 * (i >> k & 1) for k in range(3)]
        corner = scene.add_contour(f"corner{i}", pc.Point(), "body", pin.SE3(np.eye(3), place))
        scene.add_contact(f"corner{i}", corner, floor, friction=law, restitution=restitution)
    turn = rng.normal(size=4)
    turn /= np.linalg.norm(turn)
    velocity = pin.Quaternion(turn).matrix().T @ [*rng.normal(size=2), -1.0]
    q = np.array([0.0, 0.0, np.linalg.norm(size) + 0.05 * rng.random(), *turn])
    return scene, scene.initial_state(q, [*velocity, *(4.0 * rng.normal(size=3))], free=list(scene.contacts))


def rod(rng):
    """Painleve's rod with a tip on the floor, sliding."""
    half, angle = rng.uniform(0.2, 1.0), rng.uniform(0.2, 1.4)
    scene = body_scene(pin.JointModelFreeFlyer(), 1.0, (1e-3, half**2 / 3.0, half**2 / 3.0))
    tip = scene.add_contour("tip", pc.Point(), "body", pin.SE3(np.eye(3), np.array([half, 0.0, 0.0])))
    floor = scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", tip, floor, friction=pc.Coulomb(rng.uniform(0.5, 5.0)))
    rotation = pin.utils.rotate("y", angle)
    q = np.concatenate([[0.0, 0.0, half * np.sin(angle)], pin.Quaternion(rotation).coeffs()])
    speed = rotation.T @ np.array([rng.uniform(-3.0, 3.0), rng.uniform(-1.0, 1.0), 0.0])
    return scene, scene.initial_state(q, np.concatenate([speed, np.zeros(3)]))


def chain(rng):
    """Links that swing onto the floor, with joint limits, dry friction and damping."""
    model, placement, joint = pin.Model(), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.3])), 0
    for i in range(int(rng.integers(1, 4))):
        joint = model.addJoint(joint, pin.JointModelRY(), placement, f"joint{i}")
        inertia = pin.Inertia(rng.uniform(0.2, 2.0), np.array([0.1, 0.0, 0.0]), 0.01 * np.eye(3))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addBodyFrame(f"link{i}", joint, pin.SE3.Identity(), 0)
        placement = pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.0]))
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -rng.uniform(0.5, 2.0), rng.uniform(0.5, 2.0)
    model.upperDryFrictionLimit[:] = rng.choice([0.0, 0.5 * rng.random()])
    model.lowerDryFrictionLimit[:] = -model.upperDryFrictionLimit
    model.damping[:] = rng.choice([0.0, rng.random()])
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    tip = scene.add_contour("tip", pc.Sphere(0.03), f"link{model.njoints - 2}", placement)
    scene.add_contact("c", tip, floor, friction=random_law(rng), restitution=float(rng.choice([0.0, rng.random()])))
    return scene, scene.initial_state(np.zeros(model.nv), rng.normal(size=model.nv), free=["c"])


KINDS = (random_scene, box, rod, chain)


def check(seed: int) -> tuple[str, str]:
    """Kind of the run of this seed, and what is wrong with it, or nothing."""
    rng = np.random.default_rng(seed)
    make = KINDS[seed % len(KINDS)]
    began = time.perf_counter()
    try:
        scene, state = make(rng)
        run = pc.simulate(scene, state, DURATION, method="Moreau", step=STEP, energies=True)
    except pc.ContactError as error:
        return make.__name__, f"{type(error).__name__}: {error}"
    taken = time.perf_counter() - began
    if run.status < 0:
        return make.__name__, f"stopped: {run.message}"
    if not (np.isfinite(run.q).all() and np.isfinite(run.v).all()):
        return make.__name__, "not finite"
    energies = run.energies()
    scale = max(energies.kinetic.max(), 1e-3 * G)
    # an impulse that a joint's stop sends through a chain shares its work between both in any way
    work = np.diff(energies.friction_work + energies.damping_work).max() / scale
    rise = (energies.total - np.minimum.accumulate(energies.total)).max() / scale
    if work > WORK:
        return make.__name__, f"contacts did work {work:.2g}"
    if rise > RISE:
        return make.__name__, f"energy rose {rise:.2g}"
    if taken > PATIENCE:
        return make.__name__, f"took {taken:.0f} s"
    return make.__name__, ""


def main(count: int = 10_000, first: int = 0) -> int:
    """Run and report; the number of runs that went wrong."""
    wrong: Counter[str] = Counter()
    for seed in range(first, first + count):
        kind, fault = check(seed)
        if fault:
            wrong[kind] += 1
            print(f"seed {seed} ({kind}): {fault}", flush=True)
        if (seed - first + 1) % 1000 == 0:
            print(f"{seed - first + 1} runs, {sum(wrong.values())} wrong {dict(wrong)}", flush=True)
    return sum(wrong.values())


if __name__ == "__main__":
    sys.exit(min(main(*(int(argument) for argument in sys.argv[1:])), 1))
