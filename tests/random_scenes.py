"""Random scenes with everything that does work: joints of all kinds with rotors, damping, dry friction and limits,
contacts with all laws, drives, gravity along any direction, torques."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin

import pincontact as pc


def axis(rng: np.random.Generator) -> np.ndarray:
    a = rng.normal(size=3)
    return a / np.linalg.norm(a)


def placement(rng: np.random.Generator, size: float) -> pin.SE3:
    return pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-size, size, 3))


def _composite(rng: np.random.Generator) -> pin.JointModelComposite:
    joint = pin.JointModelComposite(pin.JointModelRX())
    joint.addJoint(pin.JointModelRevoluteUnaligned(axis(rng)))
    return joint


JOINTS: dict[str, Callable[[np.random.Generator], object]] = {
    "revolute": lambda rng: pin.JointModelRX(),
    "unaligned revolute": lambda rng: pin.JointModelRevoluteUnaligned(axis(rng)),
    "unbounded": lambda rng: pin.JointModelRUBY(),
    "prismatic": lambda rng: pin.JointModelPX(),
    "unaligned prismatic": lambda rng: pin.JointModelPrismaticUnaligned(axis(rng)),
    "helical": lambda rng: pin.JointModelHX(0.2),
    "unaligned helical": lambda rng: pin.JointModelHelicalUnaligned(axis(rng), 0.2),
    "universal": lambda rng: pin.JointModelUniversal(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])),
    "spherical": lambda rng: pin.JointModelSpherical(),
    "spherical ZYX": lambda rng: pin.JointModelSphericalZYX(),
    "translation": lambda rng: pin.JointModelTranslation(),
    "planar": lambda rng: pin.JointModelPlanar(),
    "free flyer": lambda rng: pin.JointModelFreeFlyer(),
    "composite": _composite,
}
LAWS = [
    None,
    pc.Coulomb(0.3),
    pc.NoSlip(),
    pc.Stribeck(0.2, 0.4, 0.05),
    # in two directions, those of the surface
    pc.Coulomb((0.2, 0.4), along="surface"),
    pc.Coulomb(0.4, viscous=0.3),
    pc.Coulomb(0.0, viscous=0.5),
    pc.Coulomb(0.3, spinning=0.01, rolling=0.01),
    pc.NoSlip(rolling=0.01),
]


def chain(rng: np.random.Generator, names: list[str]) -> pin.Model:
    """Bodies on joints of these kinds, one after the other."""
    model, joint = pin.Model(), 0
    for k, name in enumerate(names):
        joint = model.addJoint(joint, JOINTS[name](rng), placement(rng, 0.3), f"j{k}")
        inertia = pin.Inertia(rng.uniform(0.5, 2.0), rng.uniform(-0.1, 0.1, 3), np.diag(rng.uniform(0.02, 0.03, 3)))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", joint, 0, placement(rng, 0.2), pin.FrameType.OP_FRAME))
    return model


def random_scene(seed: int) -> tuple[pc.Scene, pc.State, Callable | None]:
    """A scene, its state, and torques as a control or None."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 4))
    names = [str(rng.choice(list(JOINTS))) for _ in range(count)]
    if rng.random() < 0.4:
        names[0] = "free flyer"
    model = chain(rng, names)
    if rng.random() < 0.5:
        model.gravity.linear = 9.81 * axis(rng)
    if rng.random() < 0.7:
        model.armature[:] = rng.uniform(0.0, 0.3, model.nv)
    if rng.random() < 0.4:
        model.damping[:] = rng.uniform(0.0, 0.3, model.nv)
    if rng.random() < 0.3:
        model.upperDryFrictionLimit[:] = rng.uniform(0.0, 0.5, model.nv)
        model.lowerDryFrictionLimit[:] = -rng.uniform(0.0, 0.5, model.nv)
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-0.8, 0.8, model.nv))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    tip, scene, free = data.oMf[model.getFrameId("tip")], pc.Scene(model), []
    contacts = int(rng.integers(0, 3))
    bilateral = contacts == 1 and rng.random() < 0.5
    for c in range(contacts):
        radius = 0.1 if rng.random() < 0.5 else 0.0
        place = placement(rng, 0.2)
        centre, turned = (tip * place).translation, pin.exp3(rng.normal(size=3))
        motion = None
        if rng.random() < 0.3:
            motion = pc.HarmonicMotion(rng.uniform(-0.05, 0.05, 3), 1.3, 0.0, axis(rng), rng.uniform(-0.2, 0.2))
        surface: pc.Contour = pc.Plane()
        if rng.random() < 0.2:
            surface = pc.ParametricSurface(
                lambda a, b, t: (a, b, 0.02 * math.sin(3.0 * a - 2.0 * t) * math.cos(2.0 * b)),
                ((-math.inf, math.inf),) * 2,
            )
        opened = not bilateral and rng.random() < 0.4
        gap = 0.05 * rng.random() if opened and rng.random() < 0.6 else 0.0
        if opened:
            free.append(f"c{c}")
        law = LAWS[rng.integers(len(LAWS))]
        if isinstance(law, pc.Coulomb) and law.along is not None:
            law = dataclasses.replace(law, along=f"b{c}")
        shape = pc.Sphere(radius) if radius else pc.Point()
        pair = (
            scene.add_contour(f"a{c}", shape, "tip", place),
            scene.add_contour(
                f"b{c}", surface, placement=pin.SE3(turned, centre - (radius + gap) * turned[:, 2]), motion=motion
            ),
        )
        bounce = 0.5 if not bilateral and rng.random() < 0.4 else 0.0
        order = slice(None, None, -1 if rng.random() < 0.5 else 1)
        scene.add_contact(f"c{c}", *pair[order], friction=law, restitution=bounce, bilateral=bilateral)
    v = rng.normal(size=model.nv)
    try:
        state = scene.initial_state(q, v, free=free, max_gap=0.06)
    except pc.StateError:
        # drives that no motion could follow without slip
        for name, contact in scene.contacts.items():
            scene.contacts[name] = dataclasses.replace(contact, friction=pc.Coulomb(0.3))
        state = scene.initial_state(q, v, free=free, max_gap=0.06)
    if rng.random() < 0.4:
        # of one coordinate, which starts somewhere between its limits or at one of them
        model.lowerPositionLimit[:], model.upperPositionLimit[:] = -math.inf, math.inf
        low, high = rng.uniform(0.0, 0.1) * (rng.random() < 0.5), rng.uniform(0.0, 0.1)
        model.lowerPositionLimit[-1], model.upperPositionLimit[-1] = state.q[-1] - low, state.q[-1] + high
    torques = rng.normal(size=model.nv)
    return scene, state, (lambda t, q, v: math.cos(3.0 * t) * torques) if rng.random() < 0.4 else None


def resting_chain(seed: int) -> tuple[pc.Scene, np.ndarray, np.ndarray, np.ndarray]:
    """A cart at rest or moving, with or without dry friction, that carries a chain of joints: free, damped, held by dry
    friction or pressed onto their stops. Returns scene, q, v, tau."""
    rng = np.random.default_rng(seed)
    model, parent = pin.Model(), 0
    for i in range(int(rng.integers(3, 6))):
        joint, place = pin.JointModelPX(), pin.SE3.Identity()
        if i > 0:
            kind = pin.JointModelRevoluteUnaligned if rng.random() < 0.7 else pin.JointModelPrismaticUnaligned
            joint, place = kind(axis(rng)), placement(rng, 0.3)
        parent = model.addJoint(parent, joint, place, f"joint {i}")
        a = rng.normal(size=(3, 3))
        inertia = pin.Inertia(rng.uniform(0.5, 2.0), rng.uniform(-0.3, 0.3, 3), 0.02 * (a @ a.T + np.eye(3)))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    nv = model.nv
    q, v, damping, load = rng.uniform(-1.0, 1.0, nv), np.zeros(nv), np.zeros(nv), np.zeros(nv)
    ends, dry = np.array([np.full(nv, -np.inf), np.full(nv, np.inf)]), np.zeros((2, nv))
    for k, kind in enumerate(["cart", *rng.choice(["free", "damped", "dry", "stop", "dry stop"], nv - 1)]):
        if "dry" in kind or (k == 0 and rng.random() < 0.6):
            dry[:, k] = -rng.uniform(0.5, 2.0), rng.uniform(0.5, 2.0)
        if k == 0 and rng.random() < 0.7:
            v[0] = rng.uniform(-1.0, 1.0)
            load[0] = -dry[0 if v[0] > 0.0 else 1, 0]
        if kind == "damped" or (k == 0 and rng.random() < 0.4):
            damping[k] = rng.uniform(0.05, 0.5)
        if kind == "dry":
            load[k] = rng.uniform(-0.4, 0.4)
        if "stop" in kind:
            end = rng.integers(2)
            ends[:, k], load[k] = [(q[k], q[k] + 1.0), (q[k] - 1.0, q[k])][end], [-5.0, 5.0][end]
    model.lowerPositionLimit, model.upperPositionLimit = ends
    model.lowerDryFrictionLimit, model.upperDryFrictionLimit = dry
    model.damping = damping
    tau = pin.rnea(model, model.createData(), q, v, np.zeros(nv)) + damping * v + load
    return pc.Scene(model), q, v, tau
