"""Random motions of everything that can be declared: the scenes of other files, and bodies on feet, thrown bodies,
beads and joints, which rest or move under drives and loads of random frequency, with contours that end and open
starts."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import test_axles
import test_ends_in_steps
import test_ideal_rolling
import test_moreau
import test_places_in_steps
import test_random_runs
from random_contacts import PATTERNS
from random_scenes import axis, random_scene, resting_chain
from shared import one_body
from test_dead_centres import random_crank

import pincontact as pc

G = 9.81
Control = Callable[[float, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Motion:
    """A motion to be followed: scene, start, what acts. free: contacts that start open; breakpoints: of the control."""

    scene: pc.Scene
    q: np.ndarray
    v: np.ndarray
    t: float
    free: tuple[str, ...]
    duration: float
    control: Control | None = None
    breakpoints: tuple[float, ...] = ()

    @classmethod
    def of(cls, scene: pc.Scene, state: pc.State, duration: float, control: Control | None = None) -> Motion:
        opened = tuple(name for name, row in zip(scene.contacts, state.discrete) if row[0] == -1)
        return cls(scene, state.q, state.v, state.t, opened, duration, control)

    @property
    def passive(self) -> bool:
        """Whether nothing can do work on it."""
        shapes = self.scene.contours.values()
        return self.control is None and not any(s.motion or s.contour.time_dependent for s in shapes)

    def state(self) -> pc.State:
        return self.scene.initial_state(self.q, self.v, self.t, free=list(self.free), max_gap=0.3)

    def rebuilt(
        self, world: pin.SE3 | None = None, rng: np.random.Generator | None = None, gravity: float = 1.0
    ) -> Motion:
        """The same in another world frame, with contacts and contours named and made in random order; gravity: factor.

        q and v stay what they are, as joints on the world are placed anew.
        """
        world, old = pin.SE3.Identity() if world is None else world, self.scene
        model = old.model.copy()
        model.gravity.linear = gravity * (world.rotation @ model.gravity.linear)
        for j in range(1, model.njoints):
            if model.parents[j] == 0:
                model.jointPlacements[j] = world * model.jointPlacements[j]
        scene = pc.Scene(model)
        for name in _shuffled(old.contours, rng):
            c = old.contours[name]
            frame, place = ("universe", world * c.placement_in_joint) if c.joint == 0 else (c.frame, c.placement)
            scene.add_contour(name, c.contour, frame, place, c.motion)
        for name in _shuffled(old.contacts, rng):
            c = old.contacts[name]
            pair, location = (c.first.name, c.second.name), c.location
            if rng is not None and rng.random() < 0.5 and c.first.contour.dimension != c.second.contour.dimension:
                pair, location = pair[::-1], location and location[::-1]
            options = {"bilateral": c.bilateral, "pattern": c.pattern.name, "location": location, "side": c.side}
            scene.add_contact(name, *pair, c.friction, restitution=c.restitution, **options)
        return replace(self, scene=scene)


def _shuffled(names: dict, rng: np.random.Generator | None) -> list[str]:
    return list(names) if rng is None else [str(name) for name in rng.permutation(list(names))]


# ---------------------------------------------------------------------------------------------------- what acts


def frequency(rng: np.random.Generator) -> float:
    """rad/s, of 0.1 to 100 Hz."""
    return 2.0 * math.pi * 10.0 ** rng.uniform(-1.0, 2.0)


def loaded(motion: Motion, rng: np.random.Generator, size: float = 1.0) -> Motion:
    """With a load on the joints: a sine, a smooth pulse, or one that jumps, as large as weights times `size`."""
    model = motion.scene.model
    data = model.createData()
    pin.crba(model, data, motion.q)
    mass = np.triu(data.M) + np.triu(data.M, 1).T
    tau = (
        size
        * G
        * 10.0 ** rng.uniform(-1.0, 0.3)
        * np.sqrt(np.diag(mass).mean() * np.diag(mass))
        * axis_of(rng, model.nv)
    )
    if rng.random() < 0.4:
        tau = mass @ (size * G * rng.uniform(0.1, 1.5) * axis_of(rng, model.nv))
    kind, start = rng.choice(["sine", "pulse", "jump"]), motion.t + motion.duration * rng.uniform(0.1, 0.6)
    if kind == "sine":
        omega, phase = frequency(rng), rng.uniform(0.0, 2.0 * math.pi) * (rng.random() < 0.5)
        return replace(motion, control=lambda t, q, v: math.sin(omega * t + phase) * tau)
    if kind == "pulse":
        length = rng.uniform(0.25, 0.6)

        def pulse(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
            u = (t - start) / length
            return math.sin(math.pi * u) ** 4 * tau if 0.0 < u < 1.0 else 0.0 * tau

        return replace(motion, control=pulse)
    end = start + 10.0 ** rng.uniform(-2.5, -0.3)
    control = lambda t, q, v: tau if start <= t < end else 0.0 * tau  # noqa: E731
    return replace(motion, control=control, breakpoints=(start, end))


def axis_of(rng: np.random.Generator, size: int) -> np.ndarray:
    a = rng.normal(size=size) * (rng.random(size) < 0.6)
    return a / max(float(np.linalg.norm(a)), 1.0)


def drive(rng: np.random.Generator) -> pc.Motion:
    """Harmonic, of random frequency, with accelerations up to twice those of weight."""
    omega = frequency(rng)
    reach = min(rng.uniform(0.05, 2.0) * G / omega**2, 0.2)
    turn = reach * rng.uniform(0.0, 3.0) * (rng.random() < 0.4)
    return pc.HarmonicMotion(reach * axis(rng), omega / (2.0 * math.pi), rng.uniform(0.0, 6.0), axis(rng), turn)


def law(rng: np.random.Generator, along: str | None = None) -> pc.FrictionLaw | None:
    """Any law; of two directions where there is a surface to take them from."""
    mu = rng.uniform(0.05, 0.8)
    kind = rng.integers(9)
    if kind == 0:
        return None
    if kind == 1:
        return pc.NoSlip()
    if kind == 2:
        return pc.Coulomb(mu, mu_static=mu * rng.uniform(1.0, 1.5))
    if kind == 3:
        return pc.Stribeck(mu, 1.4 * mu, rng.uniform(0.02, 0.2))
    if kind == 4 and along is not None:
        return pc.Coulomb((mu, mu * rng.uniform(0.5, 2.0)), along=along)
    if kind == 5:
        return pc.Coulomb(mu * (rng.random() < 0.7), viscous=rng.uniform(0.05, 1.0))
    if kind == 6 and along is not None:
        resistance = {"spinning": 0.01 * rng.random() * (rng.random() < 0.7), "rolling": 0.01 * rng.random()}
        return pc.Coulomb(mu, **resistance)
    return pc.Coulomb(mu)


# ---------------------------------------------------------------------------------------------------- bodies


def free_body(mass: float, moments: np.ndarray, offset: np.ndarray | None = None) -> pin.Model:
    inertia = pin.Inertia(mass, np.zeros(3) if offset is None else offset, np.diag(moments))
    return one_body(pin.JointModelFreeFlyer(), inertia)


def patch(rng: np.random.Generator, reach: float) -> pc.Plane:
    """A plane, or a plate that ends."""
    if rng.random() < 0.6:
        return pc.Plane()
    return pc.Plane(tuple((-rng.uniform(reach, 3.0 * reach), rng.uniform(reach, 3.0 * reach)) for _ in range(2)))


def feet(rng: np.random.Generator) -> Motion:
    """A body on one to five feet, on a slope or a plate, at rest or sliding, its feet of one law or of several."""
    count = int(rng.integers(1, 6))
    height, mass = rng.uniform(0.0, 0.15), rng.uniform(0.5, 5.0)
    scene = pc.Scene(free_body(mass, mass * rng.uniform(0.005, 0.01, 3)))
    slope = pin.SE3(pin.exp3(rng.uniform(-0.3, 0.3) * axis(rng) * (rng.random() < 0.5)), np.zeros(3))
    floor = scene.add_contour(
        "floor", patch(rng, 0.3), placement=slope, motion=drive(rng) if rng.random() < 0.4 else None
    )
    one, turn = law(rng, "floor"), rng.uniform(0.0, 6.0)
    for i in range(count):
        angle, reach = turn + 2.0 * math.pi * i / count, rng.uniform(0.08, 0.2) * (count > 1)
        place = pin.SE3(np.eye(3), np.array([reach * math.cos(angle), reach * math.sin(angle), -height]))
        foot = scene.add_contour(f"foot {i}", pc.Point(), "body", place)
        friction = one if i == 0 or rng.random() < 0.8 else law(rng, "floor")
        scene.add_contact(f"foot {i}", foot, floor, friction, restitution=0.3 * (rng.random() < 0.1))
    up = slope.rotation[:, 2] * height
    q, v = np.array([*up, *pin.Quaternion(slope.rotation).coeffs()]), np.zeros(6)
    if rng.random() < 0.4:
        v[[0, 1, 5]] = rng.normal(size=3)
    state = scene.initial_state(q, v, max_gap=0.3)
    motion = Motion.of(scene, state, float(rng.choice([0.5, 1.0, 3.0])))
    return loaded(motion, rng, 0.5) if rng.random() < 0.6 else motion


def rolling(rng: np.random.Generator) -> Motion:
    """A ball, an ellipsoid, a point or a ring in a bowl, on waves, on a plane that may end or on a barrel; laid or
    dropped."""
    a = rng.uniform(0.03, 0.1)
    shape = [pc.Sphere(a), pc.Ellipsoid(a, 0.9 * a, 0.8 * a), pc.Point(), pc.Circle(a)][
        rng.choice(4, p=(0.5, 0.2, 0.15, 0.15))
    ]
    ground, side, level = [
        (patch(rng, 0.2), None, 0.0),
        (pc.HeightField(lambda x, y: 0.03 * math.sin(6.0 * x) * math.cos(5.0 * y)), None, 0.0),
        (pc.HeightField(lambda x, y: 0.05 * math.sin(12.0 * x), domain=((-1.0, 1.0), (-1.0, 1.0))), None, 0.0),
        (pc.Sphere(rng.uniform(0.3, 1.0)), -1, 0.0),
        (pc.Ellipsoid(1.0, 0.9, 0.7), -1, 0.0),
        (pc.Sphere(0.5), None, 0.5),
        (
            pc.ParametricSurface(lambda x, y, t: (x, y, 0.01 * math.sin(4.0 * x - 3.0 * t)), ((-9.0, 9.0),) * 2),
            None,
            0.0,
        ),
    ][rng.integers(7)]
    mass = rng.uniform(0.3, 3.0)
    scene = pc.Scene(
        free_body(
            mass, 0.4 * mass * a**2 * rng.uniform(0.8, 1.0, 3), 0.1 * a * rng.normal(size=3) * (rng.random() < 0.3)
        )
    )
    body = scene.add_contour("shape", shape, "body")
    slope = pin.exp3(rng.uniform(0.0, 0.2) * axis(rng))
    floor = scene.add_contour(
        "ground", ground, placement=pin.SE3(slope, np.zeros(3)), motion=drive(rng) if rng.random() < 0.3 else None
    )
    scene.add_contact(
        "c",
        # side is that of the first of two surfaces
        *((body, floor)[:: 1 if side else rng.choice([-1, 1])]),
        law(rng, "ground"),
        side=side,
        restitution=float(rng.choice([0.0, 0.0, rng.random()])),
    )
    turned = pin.Quaternion(pin.exp3(rng.normal(size=3)))
    drop = rng.random() < 0.5
    place = np.array([*rng.uniform(-0.1, 0.1, 2), level + rng.uniform(0.1, 0.3) if drop or side is None else 0.0])
    q, v = np.array([*place, *turned.coeffs()]), np.concatenate([0.5 * rng.normal(size=3), 3.0 * rng.normal(size=3)])
    if drop:
        state = scene.initial_state(q, v, free=["c"])
    else:
        state = scene.initial_state(q, v * (rng.random() < 0.6), max_gap=1.5)
    motion = Motion.of(scene, state, rng.uniform(0.5, 1.5))
    return loaded(motion, rng, 0.5) if rng.random() < 0.4 else motion


def bead(rng: np.random.Generator) -> Motion:
    """A bead on a wire that may end, of any shape, fixed, driven or of time."""
    wide = rng.uniform(0.3, 1.0)
    wire = [
        pc.Line((-wide, wide)),
        pc.Circle(wide),
        pc.Ellipse(wide, 0.6 * wide),
        pc.Helix(wide, 0.3),
        pc.Cycloid(wide),
        pc.ParametricCurve(lambda u: (u, 0.3 * math.sin(4.0 * u), 0.2 * u * u), (-wide, wide)),
        pc.ParametricCurve(lambda u, t: (u, 0.1 * math.sin(3.0 * u + 2.0 * t), 0.0), (-3.0, 3.0)),
        pc.SplineCurve(
            wide * np.column_stack([np.cos(k := np.arange(10) * 0.2 * math.pi), np.sin(k), 0.2 * np.sin(2 * k)]),
            periodic=True,
        ),
    ][rng.integers(8)]
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "bead")
    model.appendBodyToJoint(
        joint, pin.Inertia(rng.uniform(0.2, 2.0), np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity()
    )
    if rng.random() < 0.2:
        model.damping[:] = rng.uniform(0.1, 1.0)
    scene = pc.Scene(model)
    place = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
    scene.add_contour("bead", pc.Point(), "bead")
    scene.add_contour("wire", wire, placement=place, motion=drive(rng) if rng.random() < 0.4 else None)
    scene.add_contact("c", "bead", "wire", law(rng), bilateral=True)
    u = [
        float(
            rng.uniform(max(wire.domain[0][0], 0.3), min(wire.domain[0][1], 3.0))
            if isinstance(wire, pc.Cycloid)
            else rng.uniform(-0.2, 0.2)
        )
    ]
    state = scene.initial_state(
        (
            place
            * (scene.contours["wire"].motion.placement(0.0) if scene.contours["wire"].motion else pin.SE3.Identity())
        ).act(wire.point(u, 0.0)),
        rng.normal(size=3) * (rng.random() < 0.6),
        max_gap=0.3,
    )
    motion = Motion.of(scene, state, float(rng.choice([0.5, 1.0, 3.0])))
    return loaded(motion, rng, 0.5) if rng.random() < 0.5 else motion


def joints(rng: np.random.Generator) -> Motion:
    """A cart with a chain of joints at rest, in dry friction or on their stops, under constant and varying loads."""
    scene, q, v, tau = resting_chain(int(rng.integers(10**9)))
    motion = Motion.of(scene, scene.initial_state(q, v), float(rng.choice([0.5, 1.0, 2.0])))
    varying = loaded(motion, rng, rng.uniform(0.1, 1.0))
    return replace(varying, control=lambda t, q, v: tau + varying.control(t, q, v))


def cam(rng: np.random.Generator) -> Motion:
    """A cam that a motor turns, or that is driven, and a follower that a spring presses onto it: a point, a roller or a
    flat face, on a slider or a lever; it may lift off."""
    fast = 10.0 ** rng.uniform(-0.3, 1.8)
    a, b = rng.uniform(0.02, 0.06), rng.uniform(0.0, 0.3)
    lobes = int(rng.integers(1, 4))
    shape = [
        pc.Circle(a),
        pc.Ellipse(a, (1.0 - b) * a),
        pc.ParametricCurve(
            lambda u: (
                a * (1.0 + b / lobes**2 * math.cos(lobes * u)) * math.cos(u),
                a * (1.0 + b / lobes**2 * math.cos(lobes * u)) * math.sin(u),
                0.0,
            ),
            (0.0, 2.0 * math.pi),
            periodic=True,
        ),
    ][rng.integers(3)]
    model, driven = pin.Model(), rng.random() < 0.4
    model.gravity.linear = np.array([0.0, -G * (rng.random() < 0.7), 0.0])
    offset = pin.SE3(np.eye(3), np.array([0.5 * a * rng.random(), 0.0, 0.0]))
    if not driven:
        shaft = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "cam")
        inertia = pin.Inertia(rng.uniform(0.2, 2.0), offset.translation, rng.uniform(1e-4, 1e-2) * np.eye(3))
        model.appendBodyToJoint(shaft, inertia, pin.SE3.Identity())
        model.addBodyFrame("cam", shaft, pin.SE3.Identity(), 0)
    lever, mass = rng.random() < 0.4, rng.uniform(0.1, 1.0)
    reach = rng.uniform(0.1, 0.2)
    if lever:
        # from a pivot beside the cam to above it
        place = pin.SE3(np.eye(3), np.array([-reach, 1.5 * a, 0.0]))
        arm = model.addJoint(0, pin.JointModelRZ(), place, "follower")
        model.appendBodyToJoint(arm, pin.Inertia(mass, np.array([reach, 0, 0]), 1e-3 * np.eye(3)), pin.SE3.Identity())
        tip = pin.SE3(np.eye(3), np.array([reach, 0.0, 0.0]))
    else:
        place = pin.SE3(np.eye(3), np.array([0.3 * a * rng.uniform(-1.0, 1.0), 1.5 * a, 0.0]))
        arm = model.addJoint(0, pin.JointModelPY(), place, "follower")
        model.appendBodyToJoint(arm, pin.Inertia(mass, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
        tip = pin.SE3.Identity()
    model.addBodyFrame("follower", arm, tip, 0)
    scene = pc.Scene(model)
    turning = pc.ConstantTwist((0.0, 0.0, fast)) if driven else None
    scene.add_contour("cam", shape, "universe" if driven else "cam", offset, turning)
    face = [pc.Point(), pc.Circle(rng.uniform(0.2, 0.5) * a), pc.Line((-3.0 * a, 3.0 * a))][rng.integers(3)]
    scene.add_contour("follower", face, "follower")
    scene.add_contact("c", "follower", "cam", law(rng), restitution=0.4 * (rng.random() < 0.2))
    n = model.nv
    q, v = np.zeros(n), np.zeros(n)
    if not driven:
        q[0], v[0] = rng.uniform(-3.0, 3.0), fast * rng.choice([-1.0, 1.0])
    stiff, preload = mass * (10.0 ** rng.uniform(0.0, 2.0)) ** 2, mass * G * rng.uniform(0.5, 5.0)
    arm_length = reach if lever else 1.0
    torque = rng.uniform(-1.0, 1.0) * preload * a

    def control(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        tau = np.zeros(n)
        tau[-1] = -arm_length * (preload + stiff * arm_length * q[-1])
        if not driven:
            tau[0] = torque
        return tau

    state = scene.initial_state(q, v, max_gap=1.0)
    return replace(Motion.of(scene, state, min(0.5, 20.0 / fast)), control=control)


def stones(rng: np.random.Generator) -> Motion:
    """A ball, a ring or a point rolls or flies along a ground that is flat but for one or two narrow places."""
    a, places = rng.uniform(0.05, 0.2), []
    for _ in range(int(rng.integers(1, 3))):
        width = a * 10.0 ** rng.uniform(-1.0, 0.3)
        height = width * rng.uniform(0.2, 1.5) * rng.choice([-1.0, 1.0])
        places.append((height, width, *rng.uniform(-2.0, 2.0, 2) * a, float(rng.random() < 0.5)))

    def surface(x, y):
        z = 0.0 * x
        for height, width, x0, y0, round_ in places:
            z = z + height * np.exp(-((x - x0) * (x - x0) + round_ * (y - y0) * (y - y0)) / width**2)
        return z

    domain = None if rng.random() < 0.5 else ((-9.0, 9.0), (-9.0, 9.0))
    shape = (pc.Sphere(a), pc.Circle(a), pc.Point())[rng.choice(3, p=(0.6, 0.2, 0.2))]
    mass = rng.uniform(0.3, 3.0)
    scene = pc.Scene(free_body(mass, 0.4 * mass * a**2 * np.ones(3)))
    body = scene.add_contour("shape", shape, "body")
    floor = scene.add_contour("ground", pc.HeightField(surface, domain=domain))
    # which of the contacts of one pair is at which place is open, so they are alike
    names, friction, restitution = [f"c{i}" for i in range(3)], law(rng), 0.3 * (rng.random() < 0.2)
    for name in names:
        scene.add_contact(name, body, floor, friction, restitution=restitution)
    up = pin.rpy.rpyToMatrix(0.5 * math.pi, 0.0, 0.0)
    rolls = not isinstance(shape, pc.Point) and rng.random() < 0.5
    start, speed = np.array([-rng.uniform(4.0, 8.0) * a, 0.3 * a * rng.normal()]), rng.uniform(0.5, 3.0)
    height = float(surface(*start)) + (0.0 if isinstance(shape, pc.Point) else a)
    q = np.array([*start, height + (0.0 if rolls else rng.uniform(0.1, 1.0) * a), *pin.Quaternion(up).coeffs()])
    v = np.array([speed, 0.0, 0.0, 0.0, 0.0, -speed / a if rolls else 3.0 * rng.normal()])
    state = scene.initial_state(q, v, free=names[1:] if rolls else names, max_gap=0.3)
    return Motion.of(scene, state, 14.0 * a / speed)


# ---------------------------------------------------------------------------------------------------- other files'


def _of(make: Callable[[int], tuple], duration: float, size: float = 0.3) -> Callable[[np.random.Generator], Motion]:
    """A scene of another file: make(seed) gives scene, state and more; a third of them with a load."""

    def motion(rng: np.random.Generator) -> Motion:
        scene, state, *rest = make(int(rng.integers(10**9)))
        found = Motion.of(scene, state, rest[0] if rest and isinstance(rest[0], float) else duration)
        if rest and callable(rest[0]):
            return replace(found, control=rest[0])
        return loaded(found, rng, size) if rng.random() < 0.33 else found

    return motion


def _crank(seed: int) -> tuple[pc.Scene, pc.State]:
    pattern = ["P-2C", "P-3C", "2C-2C", "P-S"][seed % 4]
    crank, begin, *_ = random_crank(seed, 0.05 if pattern == "2C-2C" else 0.0)
    scene = crank.scene(pattern)
    if seed % 3 == 0:
        scene.model.upperDryFrictionLimit[:], scene.model.lowerDryFrictionLimit[:] = 0.3, -0.3
    return scene, scene.initial_state(*crank.place(*begin))


def _thrown(seed: int) -> tuple[pc.Scene, pc.State]:
    scene, q, v, _ = test_random_runs.thrown_body(seed)
    return scene, scene.initial_state(q, v, max_gap=0.2)


def _pair(seed: int) -> tuple[pc.Scene, pc.State]:
    contact, _ = test_random_runs.random_contact(list(PATTERNS)[seed % len(PATTERNS)], seed)
    return contact.scene, contact.state


KINDS: dict[str, Callable[[np.random.Generator], Motion]] = {
    "feet": feet,
    "rolling": rolling,
    "bead": bead,
    "joints": joints,
    "chain": _of(random_scene, 0.7),
    "ends": _of(test_ends_in_steps.random_case, 0.8),
    "crank": _of(_crank, 1.0),
    "thrown": _of(_thrown, 0.7),
    "thrown, NoSlip": _of(test_ideal_rolling.thrown_body, 0.7),
    "pair": _of(_pair, 0.3),
    "two bodies": _of(lambda seed: test_moreau.random_scene(np.random.default_rng(seed)), 0.4),
    "box": _of(test_ideal_rolling.thrown_box, 0.4),
    "cam": cam,
    "stones": stones,
    "cart": _of(test_axles.random_cart, 0.4),
    "limbs": _of(test_places_in_steps.limbed, 0.6),
}


def kind_of(seed: int) -> str:
    """Kind of motion of this seed: from 8,000,000 on of all kinds, below of those whose seeds tests know."""
    return list(KINDS)[seed % (len(KINDS) if seed >= 8_000_000 else list(KINDS).index("cam"))]


def random_motion(seed: int) -> tuple[str, Motion]:
    """Kind and motion of this seed."""
    kind = kind_of(seed)
    return kind, KINDS[kind](np.random.default_rng(seed))


def default_and_tight(scene: pc.Scene, state: pc.State, duration: float) -> tuple[pc.Trajectory, pc.Trajectory]:
    """The run at default options and one at tight tolerances with small steps, at 31 times; both come to their end."""
    times = np.linspace(0.0, duration, 31)
    tight = pc.simulate(scene, state, duration, t_eval=times, rtol=1e-11, atol=1e-13, max_step=duration / 100.0)
    run = pc.simulate(scene, state, duration, t_eval=times)
    assert tight.status == 0, tight.message
    assert run.status == 0, run.message
    return run, tight
