"""What projection would hide: accelerations, and steps before they are projected, keep the constraints by themselves.

Random contacts of all seven patterns, with any contours and motions, without friction, slipping and rolling. A wrong
bias, or a wrong row of what follows from it, moves a projected run but little: every step is put back.
"""

from __future__ import annotations

import dataclasses
import itertools
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from calling import from_python
from random_contacts import (
    EIGHTH_ORDER,
    PATTERNS,
    PLANAR,
    START,
    WELL_PLACED,
    RandomContact,
    Snapshot,
    carried,
    is_line_contact,
    motions_of,
    names_of,
)
from shared import one_body

import pincontact as pc
from pincontact.analysis.instant import Instant
from pincontact.dynamics.equations import slip_direction
from pincontact.geometry.carriers import OMEGA
from pincontact.integration.discrete import read_discrete, write_discrete
from pincontact.integration.run_system import RunSystem
from pincontact.integration.runge_kutta import RungeKutta
from pincontact.integration.tableaux import tableau
from pincontact.layout import (
    ACROSS_X,
    CONTACT_INTS,
    CONTACT_REALS,
    DIRECTION_X,
    EVENT,
    FRICTIONLESS,
    FROZEN,
    MODE,
    POLYNOMIAL,
    POLYNOMIAL_SIZE,
    SLIPPING,
    SPAN,
    STICK,
    TANGENTS,
)
from pincontact.layout import START as START_TIME

EACH_PATTERN = pytest.mark.parametrize("pattern", PATTERNS)
LAWS = {"frictionless": None, "slipping": pc.Coulomb(0.15), "rolling": pc.NoSlip()}
EACH_LAW = pytest.mark.parametrize("law", LAWS)
MODES = {"frictionless": FRICTIONLESS, "slipping": SLIPPING, "rolling": STICK}
COUNT = 6
# Differences of eighth order are good to some 1e-11; splines are four times differentiable at their knots only.
DIFFERENCES = 1e-8
# Products of some ten numbers of order one, divided by at most the conditioning.
ROUNDING = 1e-11


@cache
def placed(pattern: str, law: str) -> list[tuple[RandomContact, Instant]]:
    """Random contacts in the mode that is meant, half of them with the second contour on the world; most are driven."""
    found = []
    for seed in itertools.count():
        rng = np.random.default_rng(seed)
        names = tuple(str(rng.choice(names_of(pattern, body))) for body in (1, 2))
        motions = tuple(str(rng.choice(motions_of(pattern))) for _ in range(2))
        if is_line_contact(pattern, names):
            continue
        try:
            contact = RandomContact(pattern, names, motions, bool(seed % 2), seed, LAWS[law])
            instant = Instant(contact.scene, contact.state)
        except (pc.ContactError, ZeroDivisionError):
            # jammed, or as good as a line contact; kernels that are not compiled divide by zero there
            continue
        speed = np.linalg.norm(contact.at().slip)
        if contact.at().condition > 2.0 * WELL_PLACED and (law != "slipping" or speed > 0.1):
            assert instant.system.modes.tolist() == [MODES[law]]
            found.append((contact, instant))
        if len(found) == COUNT:
            return found
    raise AssertionError


def constrained(contact: RandomContact, law: str, here: Snapshot, there: Snapshot) -> np.ndarray:
    """What the constraints keep at zero of v_c `there`, in directions that follow the contact from `here`."""
    if law == "rolling":
        return there.slip
    if contact.pattern == "P-3C":
        return carried(here, there) @ there.slip
    return np.array([there.basis[2] @ there.slip])


def rate_of_constrained(contact: RandomContact, law: str) -> np.ndarray:
    """Rate of what the constraints keep at zero, along the contact's motion with its `acceleration`."""
    here = contact.at()
    return contact.derivative(lambda h: constrained(contact, law, here, contact.at(h)))


@EACH_LAW
@EACH_PATTERN
def test_accelerations_keep_the_constraints(pattern, law):
    """The constrained parts of v_c have no rate along a motion with the accelerations of the equations of motion."""
    biases = []
    for contact, instant in placed(pattern, law):
        contact.acceleration = instant.evaluate()
        here = contact.at()
        scale = 1.0 + np.abs(here.rows @ contact.acceleration).max()
        assert np.abs(rate_of_constrained(contact, law)).max() <= 10.0 * DIFFERENCES * scale, contact
        biases.append(np.abs(here.bias[2]))
    # accelerations have something to cancel
    assert np.median(biases) > 0.1


@EACH_LAW
@EACH_PATTERN
def test_forces_make_the_accelerations(pattern, law):
    """Newton's law by Pinocchio's own algorithm, with the contact forces as external ones; friction against v_c."""
    for contact, instant in placed(pattern, law):
        model, state = contact.scene.model, contact.state
        acceleration = instant.evaluate()
        forces = pc.external_forces(contact.scene, state)
        found = pin.aba(model, model.createData(), state.q, state.v, np.zeros(model.nv), forces)
        scale = 1.0 + np.abs(acceleration).max()
        np.testing.assert_allclose(found, acceleration, rtol=0.0, atol=ROUNDING * scale)
        force, here = instant.forces()["c"], contact.at()
        normals = here.basis[1:] if pattern == "P-3C" else here.basis[2:]
        normal = normals.T @ (normals @ force)
        slip = here.slip - normals.T @ (normals @ here.slip)
        if law == "frictionless":
            expected = np.zeros(3)
        elif law == "slipping":
            expected = -LAWS[law].mu * np.linalg.norm(normal) * slip / np.linalg.norm(slip)
        else:
            continue
        np.testing.assert_allclose(force - normal, expected, rtol=0.0, atol=ROUNDING * (1.0 + np.linalg.norm(force)))


def tangential(law: pc.FrictionLaw, load: float, slip: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """The friction on body 2 by the formulas of the laws' documentation, world axes."""
    speed = np.linalg.norm(slip)
    coefficients = np.full(2, law.mu) if np.isscalar(law.mu) else np.array(law.mu)
    if isinstance(law, pc.Stribeck):
        falling = np.exp(-((speed / law.speed) ** law.exponent))
        coefficients = coefficients + (np.array(law.mu_static) - coefficients) * falling
    # the point of the ellipse that takes most power; along the second body's first tangent the first one counts
    along = basis[:2] @ slip
    force = -load * coefficients**2 * along / np.linalg.norm(coefficients * along)
    return force @ basis[:2] - law.viscous * slip


SLIDING = {
    "viscous": pc.Coulomb(0.1, viscous=0.7),
    "only viscous": pc.Coulomb(0.0, viscous=0.7),
    "Stribeck": pc.Stribeck(0.05, 0.15, 0.5, 1.5),
    "two directions": pc.Coulomb((0.05, 0.15)),
    "all of it": pc.Stribeck((0.04, 0.12), (0.06, 0.18), 0.5, viscous=0.3),
}


# one tangent, and crossing curves, have one coefficient
TWO_TANGENTS = ("P-S", "3C-S", "S-S")


@pytest.mark.parametrize(
    ("pattern", "name"),
    [(p, name) for p in PATTERNS for name, law in SLIDING.items() if law.aspect == 1.0 or p in TWO_TANGENTS],
)
def test_laws_of_sliding(pattern, name):
    """Friction as documented, and the accelerations that go with it."""
    law = SLIDING[name]
    compared = 0
    for contact, _ in placed(pattern, "slipping"):
        try:
            again = contact.with_friction(law)
            instant = Instant(again.scene, again.state)
        except (pc.SolverError, pc.ArgumentError):
            # jammed, as bodies with long arms may be; or directions of a surface whose charts change
            continue
        acceleration, force, here = instant.evaluate(), instant.forces()["c"], again.at()
        normals = here.basis[1:] if pattern == "P-3C" else here.basis[2:]
        normal = normals.T @ (normals @ force)
        slip = here.slip - normals.T @ (normals @ here.slip)
        sign = -1.0 if again.scene.contacts["c"].swapped else 1.0
        if law.mu == 0.0:
            expected = -law.viscous * slip
        else:
            expected = tangential(law, float(np.linalg.norm(normal)), slip, here.basis)
        scale = 1.0 + np.linalg.norm(force)
        np.testing.assert_allclose(force - normal, sign * expected, rtol=0.0, atol=ROUNDING * scale)
        model, state = again.scene.model, again.state
        forces = pc.external_forces(again.scene, state)
        found = pin.aba(model, model.createData(), state.q, state.v, np.zeros(model.nv), forces)
        np.testing.assert_allclose(found, acceleration, rtol=0.0, atol=ROUNDING * (1.0 + np.abs(acceleration).max()))
        compared += 1
    assert compared >= 2


def test_several_slips_share_their_loads():
    """A body on three feet, each with a law of its own, slides and turns on a plane: Newton's law with the reported
    forces, friction of each by its own load, and no foot leaves the plane."""
    rng = np.random.default_rng(11)
    for _ in range(5):
        feet = np.array([[0.4, 0.0, 0.0], [-0.2, 0.3, 0.0], [-0.1, -0.4, 0.0]]) + 0.1 * rng.normal(size=3)
        feet[:, 2] = -0.3
        laws = [pc.Coulomb(0.1), pc.Stribeck(0.05, 0.2, 0.4), None]
        model = pin.Model()
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
        inertia = pin.Inertia(2.0, np.zeros(3), np.diag([0.3, 0.2, 0.4]))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
        scene = pc.Scene(model)
        floor = scene.add_contour("floor", pc.Plane())
        for i, (foot, law) in enumerate(zip(feet, laws)):
            scene.add_contour(f"foot {i}", pc.Point(), "body", pin.SE3(np.eye(3), foot))
            scene.add_contact(f"c{i}", f"foot {i}", floor, friction=law)
        turn = pin.Quaternion(pin.utils.rotate("z", rng.uniform(-3.0, 3.0))).coeffs()
        state = scene.initial_state([0.1, 0.2, 0.3, *turn], [*rng.normal(size=2), 0.0, 0.0, 0.0, rng.normal()])
        instant = Instant(scene, state)
        acceleration, data = instant.evaluate(), model.createData()
        found = pin.aba(model, data, state.q, state.v, np.zeros(6), pc.external_forces(scene, state))
        np.testing.assert_allclose(found, acceleration, rtol=0.0, atol=1e-12)
        pin.forwardKinematics(model, data, state.q, state.v, acceleration)
        pose, motion, rate = data.oMi[joint], data.v[joint], data.a[joint]
        for i, (foot, law) in enumerate(zip(feet, laws)):
            # on body 1, the foot, which is named first: forces are those on the floor
            force, velocity = (
                -instant.forces()[f"c{i}"],
                pose.rotation @ (motion.linear + np.cross(motion.angular, foot)),
            )
            speed = np.linalg.norm(velocity)
            mu = 0.0 if law is None else law.coefficient([speed])[0]
            assert force[2] > 0.5
            np.testing.assert_allclose(force[:2], -mu * force[2] * velocity[:2] / speed, rtol=0.0, atol=1e-12)
            point_rate = rate.linear + np.cross(rate.angular, foot) + np.cross(motion.angular, motion.linear)
            point_rate = pose.rotation @ (point_rate + np.cross(motion.angular, np.cross(motion.angular, foot)))
            assert abs(point_rate[2]) <= 1e-12


def test_prescribed_directions_of_slip():
    """A direction that is given is a polynomial of time, turned from one world vector towards another, in the tangent
    plane; v_c has no say in it, but for its size."""
    direction_of, rng = from_python(slip_direction), np.random.default_rng(4)
    for _ in range(20):
        integers, numbers = np.zeros(CONTACT_INTS, dtype=np.int64), rng.normal(size=CONTACT_REALS)
        integers[[TANGENTS, FROZEN]] = 2, 1
        basis, slip, found = pin.exp3(rng.normal(size=3)), rng.normal(size=3), np.zeros(2)
        time, start, span = numbers[START_TIME] + 0.3, numbers[START_TIME], numbers[SPAN]
        speed = direction_of(integers, numbers, slip, basis, time, found)
        polynomial = np.polynomial.Polynomial(numbers[POLYNOMIAL : POLYNOMIAL + POLYNOMIAL_SIZE])
        world = numbers[DIRECTION_X : DIRECTION_X + 3]
        world = world + polynomial((time - start) / span) * numbers[ACROSS_X : ACROSS_X + 3]
        expected = basis[:2] @ world
        np.testing.assert_allclose(found, expected / np.linalg.norm(expected), rtol=0.0, atol=1e-12)
        assert speed == pytest.approx(np.linalg.norm(basis[:2] @ slip), rel=1e-14)


class Steps:
    """Single steps of RK45 from a contact's state, in the mode of its instant."""

    def __init__(self, contact: RandomContact, instant: Instant, law: str) -> None:
        self.contact, self.law, self.here = contact, law, contact.at()
        self.system = RunSystem(contact.scene.model, list(contact.scene.contacts.values()))
        write_discrete(self.system, read_discrete(instant.system))
        self.rk = RungeKutta(self.system, tableau("RK45"), 1e-10, 1e-12, None)

    def errors(self, h: float) -> np.ndarray:
        """The largest gap, constrained component of v_c, and error of integrated location parameters at the end."""
        rk, system, state, (k1, k2) = self.rk, self.system, self.contact.state, self.contact.k
        kept = [*range(k1), *range(2, 2 + k2)]
        rk.begin_at(state.q, state.v, state.location)
        assert rk.evaluate_start(START) <= EVENT
        assert rk.try_step(START, h) <= EVENT
        rk.load(system.new_state)
        integrated = system.location[0, kept].copy()
        assert rk.evaluate(START + h) <= EVENT
        there = self.contact.evaluate(system.q, system.v, START + h)
        kinds = system.gaps[0], constrained(self.contact, self.law, self.here, there), integrated - there.location
        return np.array([np.abs(values).max() for values in kinds])


@EACH_LAW
@EACH_PATTERN
def test_steps_leave_the_constraints_by_their_local_error(pattern, law):
    """Gaps, constrained v_c, and the integral of p' (Eq. 7) against the location, after a step that is not projected:
    errors are of a high order in its length."""
    found = []
    for contact, instant in placed(pattern, law):
        steps = Steps(contact, instant, law)
        # far below the time in which anything turns by a radian
        speeds = 1.0 + float(np.abs(contact.rates).max()) + float(np.abs(contact.state.v).max())
        longest = 0.05 * steps.here.condition / speeds
        found.append([steps.errors(longest), steps.errors(0.5 * longest)])
        # steps are longer than 1e-3 s: what is wrong by a thousandth in a rate leaves 1e-6 in v_c
        assert (found[-1][1] <= 1e-7).all(), (contact, found[-1])
    long, short = np.sum(found, axis=0)
    # 64 by the leading term, less over a knot of a spline; what is wrong in a rate leaves 2 for v_c, 4 for the rest
    assert ((short <= long / 5.0) | (short <= 1e-12)).all(), (long, short)


@EACH_LAW
@EACH_PATTERN
def test_rates_along_runs(pattern, law):
    """On a real motion v_c^j changes as rows and bias say, and the integral of p' (Eq. 7) is the location."""
    finished = 0
    for contact, _ in placed(pattern, law)[:3]:
        scene, state = contact.scene, contact.state
        span = min(0.05, 20.0 * contact.step)
        # Gauss's nodes for integrals, whose error is below round-off for what is smooth over a span; then a stencil
        nodes, weights = np.polynomial.legendre.leggauss(10)
        integral = START + 0.5 * span * (1.0 + nodes)
        step = 0.1 * span
        stencil = START + 0.5 * span + step * np.arange(-4, 5)
        times = np.sort(np.concatenate([[START], integral, stencil, [START + span]]))
        run = pc.simulate(scene, state, span, rtol=1e-12, atol=1e-14, t_eval=times)
        if not run.success or run.events or np.ptp(run.contacts["c"].charts, axis=0).any():
            continue
        finished += 1
        track = run.contacts["c"]
        there = [pc.analyze(scene, run.state(i))["c"] for i in range(times.size)]
        rates = np.array([there[int(np.searchsorted(times, t))].rates for t in integral])
        moved = 0.5 * span * (weights @ rates)
        np.testing.assert_allclose(moved, track.location[-1] - track.location[0], rtol=0.0, atol=1e-10)
        at = [int(np.searchsorted(times, t)) for t in stencil]
        components = np.array([track.dual_frame[i].T @ track.slip_velocity[i] for i in at])
        rate = np.tensordot(EIGHTH_ORDER / step, components, axes=1)
        model, middle = scene.model, at[4]
        acceleration = pin.aba(
            model,
            model.createData(),
            run.q[middle],
            run.v[middle],
            np.zeros(model.nv),
            pc.external_forces(scene, run.state(middle)),
        )
        expected = there[middle].rows @ acceleration + there[middle].bias
        # values are good to the tolerance, which differences divide by the step
        tolerance = (DIFFERENCES + 1e-12 / step) * (1.0 + np.abs(expected).max())
        assert np.abs(rate - expected).max() <= tolerance, (contact, rate, expected)
    assert finished >= 2


# Lengths in m: what holds for sure on bodies of half a metre, and what turns all the same.
HOLDING, TURNING = 20.0, 1e-3


def relative_omega(contact: RandomContact, h: float) -> tuple[np.ndarray, Snapshot]:
    """omega of the second contour's body against the first's, drives included, along the contact's motion."""
    there, frames = contact.at(h), contact.system.frames
    return frames[1, OMEGA] - frames[0, OMEGA], there


def resisted(pattern: str, law: pc.NoSlip, rests: bool) -> list[tuple[RandomContact, Instant]]:
    """Rolling contacts that resist turning; rests: what is resisted does not turn, and is held."""
    found = []
    for contact, _ in placed(pattern, "rolling"):
        again = contact.with_friction(law)
        if rests:
            # resistance that holds nothing, to see what turns
            weak = dataclasses.replace(law, **{name: TURNING for name in ("spinning", "rolling") if getattr(law, name)})
            turning = contact.with_friction(weak)
            instant = Instant(turning.scene, turning.state)
            (item,) = instant.system.resisting()
            components = [(0, 0), (0, 2)] if pattern in PLANAR else [(0, 0), (0, 1), (0, 2)]
            components += [(item, row) for row in range(instant.system.contact_int[item, TANGENTS])]
            rows, off = instant.rows(components), instant.velocities(components)
            change = np.linalg.lstsq(rows, off, rcond=1e-9)[0]
            if np.abs(rows @ change - off).max() > 1e-12 * (1.0 + np.abs(off).max()):
                # a drive turns what no joint can follow
                continue
            again.state.v[:] -= change
            again.begin()
        found.append((again, Instant(again.scene, again.state)))
    assert len(found) >= 2
    return found


# nothing spins in a plane
@pytest.mark.parametrize(
    ("pattern", "rests"), [*((p, rests) for p in TWO_TANGENTS for rests in ("spin", "roll")), ("2C-2C", "roll")]
)
def test_accelerations_keep_held_turning(pattern, rests):
    """Where resistance holds, omega keeps without the normal part (spin) or the tangential one (roll), on bodies whose
    normals turn as they go."""
    law = pc.NoSlip(spinning=HOLDING) if rests == "spin" else pc.NoSlip(rolling=HOLDING)
    for contact, instant in resisted(pattern, law, True):
        (item,) = instant.system.resisting()
        assert instant.system.contact_int[item, MODE] == STICK
        contact.acceleration = instant.evaluate()

        def held(h, contact=contact):
            omega, there = relative_omega(contact, h)
            normal = there.basis[1 if pattern in PLANAR else 2]
            if pattern in PLANAR:
                return np.array([normal @ omega])
            return np.array([normal @ omega]) if rests == "spin" else omega - (normal @ omega) * normal

        scale = 1.0 + np.abs(contact.acceleration).max()
        assert np.abs(held(0.0)).max() <= ROUNDING * scale
        assert np.abs(contact.derivative(held)).max() <= 10.0 * DIFFERENCES * scale, contact


@pytest.mark.parametrize("pattern", ["3C-S", "S-S"])
def test_torques_resist_turning(pattern):
    """Torques against both parts of omega, of a length times the normal force; with them Newton's law holds."""
    for contact, instant in resisted(pattern, pc.NoSlip(spinning=TURNING, rolling=2.0 * TURNING), False):
        acceleration = instant.evaluate()
        omega, here = relative_omega(contact, 0.0)
        normal = here.basis[2]
        load, spin = abs(normal @ instant.forces()["c"]), normal @ omega
        roll = omega - spin * normal
        expected = -load * TURNING * (np.sign(spin) * normal + 2.0 * roll / np.linalg.norm(roll))
        sign = -1.0 if contact.scene.contacts["c"].swapped else 1.0
        np.testing.assert_allclose(instant.torques()["c"], sign * expected, rtol=0.0, atol=ROUNDING * (1.0 + load))
        model, state = contact.scene.model, contact.state
        forces = pc.external_forces(contact.scene, state)
        found = pin.aba(model, model.createData(), state.q, state.v, np.zeros(model.nv), forces)
        scale = 1.0 + np.abs(acceleration).max()
        np.testing.assert_allclose(found, acceleration, rtol=0.0, atol=ROUNDING * scale)


def rolling_over_poles(shape: pc.Contour, radius: float, omega: list[float]) -> tuple[pc.Scene, pc.State]:
    """A round body that rolls on a plane and turns about all its axes."""
    inertia = pin.Inertia(1.0, np.zeros(3), 0.4 * radius**2 * np.diag([1.0, 1.1, 1.2]))
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), inertia))
    body, floor = scene.add_contour("body", shape, "body"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", body, floor, friction=pc.NoSlip(), bilateral=True)
    turn = pin.Quaternion(pin.exp3(np.array([0.4, -0.3, 0.2]))).coeffs()
    return scene, scene.initial_state([0, 0, radius, *turn], [0, 0, 0, *omega], max_gap=radius)


@pytest.mark.parametrize(
    ("shape", "omega"), [(pc.Sphere(0.3), [5.0, 1.0, 0.5]), (pc.Ellipsoid(0.3, 0.26, 0.28), [5.0, 4.0, 1.0])]
)
def test_rates_between_changes_of_charts(shape, omega):
    """The integral of p' (Eq. 7) is the location in every chart that the contact goes through; on the floor, which has
    one, over the changes."""
    scene, state = rolling_over_poles(shape, 0.3, omega)
    pieces, span, nodes_each = 80, 2.4, 6
    nodes, weights = np.polynomial.legendre.leggauss(nodes_each)
    ends = np.linspace(0.0, span, pieces + 1)
    inner = ends[:-1, None] + 0.5 * (span / pieces) * (1.0 + nodes)
    times = np.sort(np.concatenate([ends, inner.ravel()]))
    run = pc.simulate(scene, state, span, rtol=1e-11, atol=1e-13, t_eval=times)
    assert run.success, run.message
    track = run.contacts["c"]
    found = [pc.analyze(scene, run.state(i))["c"] for i in range(times.size)]
    compared = changes = 0
    path = np.zeros(2)
    for k in range(pieces):
        at = slice(k * (nodes_each + 1), (k + 1) * (nodes_each + 1) + 1)
        rates = np.array([there.rates for there in found[at][1:-1]])
        moved = 0.5 * (span / pieces) * (weights @ rates)
        # the floor has one chart
        path += moved[2:]
        if np.ptp(track.charts[at], axis=0).any():
            changes += 1
            continue
        compared += 1
        location = track.location[at]
        np.testing.assert_allclose(moved, location[-1] - location[0], rtol=0.0, atol=1e-9)
    assert changes >= 2 and compared >= 0.9 * pieces
    np.testing.assert_allclose(path, track.location[-1, 2:] - track.location[0, 2:], rtol=0.0, atol=1e-8)
