"""Accelerations and forces of one state from all kinds of items at once, against solutions made beforehand.

Forces that obey the laws of their modes are chosen, and an acceleration; biases and the acceleration without forces are
then what makes them the solution.
"""

from __future__ import annotations

import functools
import math
from types import SimpleNamespace

import numba
import numpy as np
import pytest
from calling import from_python
from made_systems import made_system

from pincontact.dynamics import equations, positivity
from pincontact.dynamics.event_functions import JAM_LIMIT
from pincontact.friction.stribeck import stribeck
from pincontact.geometry.patterns import NO_NORMAL, ON_CURVE, ON_SURFACE
from pincontact.jit import kernel
from pincontact.layout import (
    ACROSS_X,
    ANISOTROPIC,
    CONTACT_INTS,
    CONTACT_REALS,
    CURVE_SPEED,
    DIRECTION_X,
    DOMAIN,
    DOMAIN_EVENT,
    EVENT,
    EVENTS_PER_CONTACT,
    FREE,
    FRICTION_EVENT,
    FRICTIONLESS,
    FROZEN,
    GAP_EVENT,
    HIGH_FORCE,
    JOINT_END,
    JOINT_INTS,
    JOINT_REALS,
    JOINT_V,
    LIMIT_SLACK,
    LOW_FORCE,
    MODE,
    MU,
    MU_FAST,
    MU_NOW,
    MU_STATIC,
    NO_FORCE,
    NORMAL_1,
    NORMAL_EVENT,
    NORMAL_SIGN,
    OK,
    OWNER,
    PATTERN,
    POLYNOMIAL,
    ROLLING_ROW,
    SCALING_11,
    SCALING_12,
    SCALING_22,
    SLIP_RATE,
    SLIP_SIGN,
    SLIPPING,
    SPAN,
    SPEED_EVENT,
    SPINNING_ROW,
    STICK,
    STRIBECK_EXPONENT,
    SYSTEM,
    TANGENTS,
    UNILATERAL,
    VISCOUS,
)

SEEDS = pytest.mark.parametrize("seed", range(3))
part = functools.cache(from_python)
ELLIPSE = np.array([[1.2, 0.3], [0.3, 0.7]])
NC, NG, NR, NVELOCITIES = 8, 3, 5, 32
TOTAL = NC + NG + NR
# contacts: open, without friction, in stick on an ellipse; sliding on one, along one tangent with a load that pulls, in
# a frozen direction as fast as its law is steep, on a curve, and held up by friction alone. Joint coordinates: held at
# the lower end, moving, held by friction. Resistances of the third, the fourth, the open one, the one in a frozen
# direction, and the one held up.
MODES = [FREE, FRICTIONLESS, STICK] + 5 * [SLIPPING] + [FRICTIONLESS, FREE, FRICTIONLESS]
MODES += [STICK, SLIPPING, STICK, SLIPPING, SLIPPING]
OWNERS = [2, 3, 0, 5, 7]


class Instant(SimpleNamespace):
    """All arrays of an evaluation at one state, and the solution: `wanted` forces and acceleration."""


def directions_of(at):
    """(TOTAL, 2) unit directions in which items slide."""
    out = np.zeros((TOTAL, 2))
    for i in range(TOTAL):
        along = at.basis[i, :2] @ at.slip[i]
        if at.integers[i, TANGENTS] == 1:
            along = np.array([at.integers[i, SLIP_SIGN], 0.0])
        elif at.integers[i, FROZEN]:
            along = at.basis[i, :2] @ at.numbers[i, DIRECTION_X : DIRECTION_X + 3]
        out[i] = along / np.linalg.norm(along)
    return out


def made(seed, slides=True):
    rng = np.random.default_rng(seed)
    nv = NVELOCITIES
    integers, numbers = np.zeros((TOTAL, CONTACT_INTS), dtype=np.int64), np.zeros((TOTAL, CONTACT_REALS))
    integers[:, TANGENTS], integers[:, PATTERN], integers[:, UNILATERAL] = 2, ON_SURFACE, 1
    integers[[4, 6, 12, 15], TANGENTS] = 1
    integers[6, PATTERN], integers[NC + NG :, PATTERN] = ON_CURVE, NO_NORMAL
    integers[[4, 6], UNILATERAL] = 0
    integers[:, MODE] = MODES
    if not slides:
        integers[integers[:, MODE] == SLIPPING, MODE] = STICK
    integers[:, SLIP_SIGN], integers[:, NORMAL_SIGN] = rng.choice([-1, 1], TOTAL), 1
    integers[4, NORMAL_SIGN] = -1
    integers[[2, 3], ANISOTROPIC] = 1
    integers[NC + NG :, OWNER] = OWNERS
    # what resists has rows of that; of a contact that slides they make its load one of its event functions
    integers[OWNERS, SPINNING_ROW], integers[0, ROLLING_ROW] = 11, 13
    numbers[:, [SCALING_11, SCALING_12, SCALING_22]] = ELLIPSE[0, 0], ELLIPSE[0, 1], ELLIPSE[1, 1]
    numbers[:, MU], numbers[:, MU_STATIC], numbers[:, LIMIT_SLACK] = rng.uniform(0.1, 0.25, TOTAL), 3.0, 0.01
    numbers[7, [MU, MU_STATIC]] = math.inf
    numbers[:, DOMAIN], numbers[:, SPAN], numbers[:, NORMAL_1] = rng.uniform(0.2, 0.8, TOTAL), 1.0, 1.0
    numbers[5, [MU_FAST, CURVE_SPEED, STRIBECK_EXPONENT]] = 0.05, 0.7, 2.0
    numbers[[1, 3], VISCOUS] = 0.3
    basis = np.array([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(TOTAL)])
    slip, gaps = rng.normal(size=(TOTAL, 3)), rng.uniform(0.1, 1.0, (TOTAL, 2))
    integers[5, FROZEN] = 1
    numbers[5, DIRECTION_X : DIRECTION_X + 3] = basis[5, 0] - 0.4 * basis[5, 1]
    numbers[5, ACROSS_X : ACROSS_X + 3], numbers[5, POLYNOMIAL] = 7.0 * basis[5, 2], 1.0
    for i in (4, 6, 12, 15):
        # one-sided speeds that grow
        slip[i] *= integers[i, SLIP_SIGN] * np.sign(basis[i, 0] @ slip[i])
    limits, bounds = np.zeros((NG, JOINT_INTS), dtype=np.int64), np.zeros((NG, JOINT_REALS))
    limits[:, JOINT_V], limits[:, JOINT_END] = [3, 5, 8], [-1, 0, 0]
    bounds[:] = -5.0, 6.0, -math.inf, math.inf
    rows = 0.15 * rng.normal(size=(TOTAL, 3, nv))
    for i in range(TOTAL):
        for row in range(3):
            rows[i, row, (2 * i + row) % nv] += 1.0
    at = Instant(integers=integers, numbers=numbers, basis=basis, slip=slip, gaps=gaps, rows=rows, limits=limits,
                 bounds=bounds, rng=rng)  # fmt: skip
    at.d = directions_of(at)
    # friction alone can only hold up what it pushes apart
    rows[7, 2] = -at.d[7] @ rows[7, :2] + 0.3 * rng.normal(size=nv)
    for g in range(NG):
        rows[NC + g], basis[NC + g] = 0.0, np.eye(3)
        rows[NC + g, 2, limits[g, JOINT_V]] = 1.0
    at.factor = np.eye(nv) + 0.1 * np.tril(rng.normal(size=(nv, nv)))
    at.inverse = np.linalg.inv(at.factor.T @ at.factor)
    solve_backwards(at)
    return at


def solve_backwards(at):
    """Choose forces that obey the laws, an acceleration, and what makes both the solution."""
    rng, integers, numbers = at.rng, at.integers, at.numbers
    force = np.zeros((TOTAL, 3))
    at.mu = numbers[:, MU].copy()
    at.mu[5] = stribeck(numbers[5, MU], 0.05, 0.7, 2.0, np.linalg.norm(at.basis[5, :2] @ at.slip[5]))
    at.constrained = []
    for i in range(TOTAL):
        mode, pattern = integers[i, MODE], integers[i, PATTERN]
        if i >= NC + NG and integers[integers[i, OWNER], MODE] == FREE:
            continue
        if mode == FREE:
            continue
        load = 0.0
        if pattern != NO_NORMAL:
            at.constrained.append((i, 2))
            force[i, 2] = rng.uniform(0.8, 1.5) * integers[i, NORMAL_SIGN]
            load = abs(force[i, 2])
        if pattern == ON_CURVE:
            at.constrained.append((i, 1))
            force[i, 1] = rng.normal()
            load = math.hypot(force[i, 1], force[i, 2])
        if mode == STICK:
            for row in range(integers[i, TANGENTS]):
                at.constrained.append((i, row))
                force[i, row] = 0.3 * rng.normal()
        elif mode == SLIPPING:
            owner = int(integers[i, OWNER])
            if pattern == NO_NORMAL:
                load = math.hypot(force[owner, 2], force[owner, 1] if owner == 6 else 0.0)
            d = at.d[i]
            if integers[i, ANISOTROPIC]:
                d = ELLIPSE @ ELLIPSE @ d / np.linalg.norm(ELLIPSE @ d)
            friction = at.mu[i] * load
            if math.isinf(at.mu[i]):
                friction, force[i, 2] = load, 0.0
            force[i, : integers[i, TANGENTS]] = (-friction * d)[: integers[i, TANGENTS]]
    nv = NVELOCITIES
    at.acceleration = rng.normal(size=nv)
    at.acceleration[at.limits[[0, 2], JOINT_V]] = 0.0
    at.force = force
    at.free = at.acceleration - at.inverse @ np.einsum("irk,ir->k", at.rows, force)
    at.bias = rng.normal(size=(TOTAL, 3))
    at.bias[NC : NC + NG] = 0.0
    for i, row in at.constrained:
        at.bias[i, row] = -at.rows[i, row] @ at.acceleration


def solved(at, reference=None, slope=0.0):
    """Status and outputs of the kernel; reference (TOTAL, 3), at zero loads, and how it follows these."""
    nv = NVELOCITIES
    system = made_system(NC, NG, NR, nv)
    system.contact_int[:], system.contact_real[:] = at.integers, at.numbers
    system.joint_int[:], system.joint_real[:] = at.limits, at.bounds
    for name in ("slip", "basis", "gaps", "rows", "bias", "factor"):
        getattr(system, name)[:] = getattr(at, name)
    system.free_acceleration[:] = at.free
    for name in ("row_count", "row_rank", "lost_positivity"):
        system.counters[name] = 9
    for array in (system.acceleration, system.force, system.event_functions):
        array[:] = 9.0
    if reference is not None:
        system.reference_start[:], system.reference_slope[:] = reference, slope
    system.scalars["time"], system.scalars["has_reference"] = 0.7, reference is not None
    with np.errstate(invalid="ignore"):
        status = part(equations.contact_dynamics, SYSTEM)(system)
    return Instant(
        status=status, acceleration=system.acceleration, force=system.force, relative=system.relative_acceleration,
        event_functions=system.event_functions, counters=system.counters,
        integers=system.contact_int, numbers=system.contact_real,
        row_index=system.row_index, reference=system.reference,
    )  # fmt: skip


def viscous(at):
    """Viscous forces, which are among the loads already, and reported with the others."""
    out = np.zeros((TOTAL, 3))
    for i in (1, 3):
        if at.integers[i, MODE] != STICK:
            out[i, :2] = -0.3 * at.basis[i, :2] @ at.slip[i]
    return out


def largest_multiplier(at):
    multipliers = {(i, row): abs(at.force[i, row]) for i, row in at.constrained}
    if at.integers[7, MODE] == SLIPPING:
        multipliers[7, 2] = math.hypot(*at.force[7, :2])
    return max(multipliers.values())


def mobility(at, friction):
    """What forces accelerate where what sticks is held, and the fifth contact, which slides and cannot open: with
    its friction or without."""
    held = np.array([at.rows[i, row] for i, row in at.constrained if not slips(at, i)])
    inverse = at.inverse - at.inverse @ held.T @ np.linalg.pinv(held @ at.inverse @ held.T) @ held @ at.inverse
    normal = at.rows[4, 2]
    force = normal - friction * at.numbers[4, MU] * at.integers[4, NORMAL_SIGN] * at.d[4, 0] * at.rows[4, 0]
    return inverse - np.outer(inverse @ force, normal @ inverse) / (normal @ inverse @ force)


def expected_event_functions(at):
    out = np.ones((TOTAL, EVENTS_PER_CONTACT))
    largest = largest_multiplier(at)
    out[0, GAP_EVENT] = at.gaps[0, 0]
    if at.numbers[0, DOMAIN] < math.inf:
        out[0, DOMAIN_EVENT] = max(at.gaps[0, 0], -at.numbers[0, DOMAIN])
    out[1:NC, DOMAIN_EVENT] = at.numbers[1:NC, DOMAIN]
    for i in range(TOTAL):
        mode = at.integers[i, MODE]
        if i < NC and mode != FREE and at.integers[i, UNILATERAL]:
            out[i, NORMAL_EVENT] = at.force[i, 2] + (0.01 * largest if i == 7 and mode == STICK else 0.0)
        if mode == STICK and i not in (7, 13):
            owner = at.integers[i, OWNER] if i >= NC else i
            load = math.hypot(at.force[owner, 2], at.force[owner, 1] if owner == 6 else 0.0)
            tangential = at.force[i, : at.integers[i, TANGENTS]]
            if at.integers[i, ANISOTROPIC]:
                tangential = np.linalg.solve(ELLIPSE, tangential)
            out[i, FRICTION_EVENT] = 3.0 * load - np.linalg.norm(tangential) + 0.01 * (3.0 * load + largest)
        if mode == SLIPPING and at.integers[i, TANGENTS] == 1:
            out[i, SPEED_EVENT] = at.d[i, 0] * (at.basis[i, 0] @ at.slip[i])
    out[4, NORMAL_EVENT] = -at.force[4, 2]
    if at.integers[7, MODE] == SLIPPING:
        out[7, NORMAL_EVENT] = math.hypot(*at.force[7, :2])
        pushed, own = (mobility(at, friction) @ force for friction, force in ((True, at.d[7] @ at.rows[7, :2]),
                                                                              (False, at.rows[7, 2])))  # fmt: skip
        out[7, FRICTION_EVENT] = -(at.rows[7, 2] @ pushed) / (at.rows[7, 2] @ own) - JAM_LIMIT
    out[NC, NORMAL_EVENT] = at.force[NC, 2] + 5.0
    # what only friction holds may exceed its limits by the same part as contacts
    slack = 0.01 * 11.0
    out[NC + 2, [NORMAL_EVENT, FRICTION_EVENT]] = at.force[NC + 2, 2] + 5.0 + slack, 6.0 - at.force[NC + 2, 2] + slack
    return out


@SEEDS
@pytest.mark.parametrize("slides", [False, True])
def test_forces_and_accelerations_of_all_kinds_of_items(slides, seed):
    at = made(seed, slides)
    out = solved(at)
    # of systems with condition numbers of up to 1e3; on a curve a fixed point
    assert out.acceleration == pytest.approx(at.acceleration, abs=1e-10)
    assert out.force == pytest.approx(at.force + viscous(at), abs=1e-10)
    event_functions = expected_event_functions(at)
    assert out.event_functions == pytest.approx(event_functions, abs=1e-10)
    assert out.status == (OK if event_functions.min() >= 0.0 else EVENT)
    # joint coordinates that are held have none to the last bit
    assert not out.acceleration[at.limits[[0, 2], JOINT_V]].any()
    assert out.counters[["row_count", "row_rank", "lost_positivity"]].tolist() == (*[len(at.constrained)] * 2, 0)
    assert sorted(map(tuple, out.row_index[: len(at.constrained)].tolist())) == sorted(at.constrained)
    assert out.integers[13, MODE] == FREE
    for i in range(TOTAL):
        if at.integers[i, MODE] == SLIPPING:
            relative = at.rows[i] @ at.acceleration + at.bias[i]
            assert out.relative[i] == pytest.approx(relative, abs=1e-10)
            assert out.numbers[i, SLIP_RATE] == pytest.approx(at.d[i] @ relative[:2], abs=1e-10)
            if i != 15:
                assert out.numbers[i, MU_NOW] == pytest.approx(at.mu[i], rel=1e-13)


@SEEDS
@pytest.mark.parametrize("slides", [False, True])
def test_each_event_function_below_zero_is_an_event(slides, seed):
    at = made(seed, slides)
    assert solved(at).status == OK
    changes = [(at.gaps, (0, 0), -0.1), (at.numbers, (1, DOMAIN), -0.1), (at.numbers, (2, DOMAIN), -1e-9)]
    changes += [(at.bounds, (0, LOW_FORCE), 7.0), (at.bounds, (2, HIGH_FORCE), -7.0), (at.numbers, (2, MU_STATIC), 0.0)]
    changes += [(at.numbers, (11, MU_STATIC), 0.0)]
    if slides:
        changes += [(at.integers, (4, NORMAL_SIGN), 1)]
    for array, place, value in changes:
        before = array[place]
        array[place] = value
        if place == (4, NORMAL_SIGN):
            # friction is the other way round, then
            solve_backwards(at)
            at.bias[4, 2] -= 5.0 * at.rows[4, 2] @ at.inverse @ at.rows[4, 2]
            out = solved(at)
            assert (out.event_functions[4, NORMAL_EVENT] < 0.0) == (out.force[4, 2] < 0.0)
            continue
        assert solved(at).status == EVENT
        array[place] = before


@SEEDS
@pytest.mark.parametrize("slides", [False, True])
def test_independent_forces_do_not_depend_on_the_reference(slides, seed):
    at = made(seed, slides)
    out = solved(at, at.rng.normal(size=(TOTAL, 3)))
    assert out.acceleration == pytest.approx(at.acceleration, abs=1e-9)
    assert out.force == pytest.approx(at.force + viscous(at), abs=1e-9)
    slope = at.rng.normal(size=(2, 3 * TOTAL, NVELOCITIES))
    out = solved(at, at.rng.normal(size=(TOTAL, 3)), slope)
    assert out.force == pytest.approx(at.force + viscous(at), abs=1e-8)


def doubled(seed, slides):
    """A second contact does what the one without friction does."""
    at = made(seed, slides)
    at.integers[0] = at.integers[1]
    at.rows[0], at.basis[0], at.slip[0] = at.rows[1], at.basis[1], at.slip[1]
    at.numbers[0] = at.numbers[1]
    # without the fixed point on the curve, which takes long uncompiled
    at.integers[[6, 13], MODE] = FREE
    at.integers[0, SPINNING_ROW] = 0
    solve_backwards(at)
    at.bias[0, 2] = at.bias[1, 2]
    return at


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("slides", [False, True])
def test_redundant_forces_are_the_least(slides, seed):
    at = doubled(seed, slides)
    whole = at.force[0, 2] + at.force[1, 2]
    out = solved(at)
    assert out.counters["row_rank"] == len(at.constrained) - 1
    assert out.acceleration == pytest.approx(at.acceleration, abs=1e-9)
    assert out.force[:2, 2] == pytest.approx([0.5 * whole, 0.5 * whole], rel=1e-9)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("slides", [False, True])
def test_redundant_forces_are_the_nearest_to_a_reference(slides, seed):
    """Which is a solution itself."""
    at = doubled(seed, slides)
    reference = np.zeros((TOTAL, 3))
    for i, row in at.constrained:
        reference[i, row] = at.force[i, row]
    if slides:
        # the multiplier of what friction holds up is that friction
        reference[7, 2] = np.linalg.norm(at.force[7, :2])
    out = solved(at, reference)
    assert out.acceleration == pytest.approx(at.acceleration, abs=1e-9)
    assert out.force[:2, 2] == pytest.approx(at.force[:2, 2], abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("slides", [False, True])
def test_redundant_forces_follow_a_reference(slides, seed):
    """Which is where the forces nearest to its start have brought it: as far from it as each other."""
    at = doubled(seed, slides)
    whole = at.force[0, 2] + at.force[1, 2]
    start = at.rng.normal(size=(TOTAL, 3))
    slope = at.rng.normal(size=(2, 3 * TOTAL, NVELOCITIES))
    nearest = at.force.copy()
    if slides:
        # the multiplier of what friction holds up is that friction
        nearest[7, 2] = np.linalg.norm(at.force[7, :2])
    nearest[:2, 2] = start[:2, 2] + 0.5 * (whole - start[:2, 2].sum())
    places = np.array([3 * i + row for i, row in at.constrained])
    moved = start.copy()
    moved.reshape(-1)[places] += slope[1, places] @ (slope[0, places].T @ (nearest - start).reshape(-1)[places])
    out = solved(at, start, slope)
    left = out.force[:2, 2] - moved[:2, 2]
    assert left[0] == pytest.approx(left[1], abs=1e-8 * np.abs(moved).max())
    assert out.force[:2, 2].sum() == pytest.approx(whole, abs=1e-8 * np.abs(moved).max())
    for i, row in at.constrained:
        assert out.reference[i, row] == pytest.approx(moved[i, row], abs=1e-8 * np.abs(moved).max())


@SEEDS
@pytest.mark.parametrize("slides", [False, True])
def test_contacts_that_nothing_moves_have_no_forces(slides, seed):
    """Whatever pushes them; of what friction alone holds up, nothing jams."""
    at = doubled(seed, slides)
    at.rows[:2] = 0.0
    at.rows[7] *= 0.1
    solve_backwards(at)
    at.force[:2] = 0.0
    at.free = at.acceleration - at.inverse @ np.einsum("irk,ir->k", at.rows, at.force)
    at.bias[:2, 2] = 0.7, -0.4
    out = solved(at)
    assert out.acceleration == pytest.approx(at.acceleration, abs=1e-9)
    assert out.force == pytest.approx(at.force + viscous_of(at, out), abs=1e-8)
    assert out.event_functions[7, FRICTION_EVENT] == pytest.approx(
        expected_event_functions(at)[7, FRICTION_EVENT], abs=1e-9
    )
    if slides:
        at.rows[7, 2] = 0.0
        at.bias[7, 2] = 0.3
        out = solved(at)
        assert not out.force[7].any()
        assert out.event_functions[7, FRICTION_EVENT] == 1.0 - JAM_LIMIT


def viscous_of(at, out):
    """Viscous forces of what moves, that of the twin included."""
    whole = viscous(at)
    whole[0] = whole[1]
    return whole


@SEEDS
def test_small_event_functions_are_no_events(seed):
    at = made(seed)
    at.slip[[4, 6, 12, 15]] *= 0.1
    solve_backwards(at)
    force = solved(at).force[2]
    tangential = np.linalg.norm(np.linalg.solve(ELLIPSE, force[:2]))
    at.numbers[2, MU_STATIC] = (tangential + 0.1) / (1.01 * force[2])
    out = solved(at)
    assert out.event_functions[2, FRICTION_EVENT] == pytest.approx(0.1 + 0.01 * largest_multiplier(at), abs=1e-9)
    assert 0.0 < out.event_functions[12, SPEED_EVENT] < 0.5
    assert out.status == OK


@pytest.mark.skipif(not numba.config.DISABLE_JIT, reason="compiled code calls its own parts")
def test_what_ends_the_fixed_point_of_curves(monkeypatch):
    """Forces that have not settled are none, nor those of a lost operator; it ends where nothing changes."""
    for change, lost, status, rounds in (
        (0.0, False, OK, 1), (1e-5, False, NO_FORCE, 50), (0.5e-6, False, OK, 50), (0.0, True, NO_FORCE, 1),
    ):  # fmt: skip
        at, asked = made(1), []
        monkeypatch.setattr(equations, "update_normal_shares", lambda *given, c=change, a=asked: a.append(1) or c)
        kind = positivity.CURVES_LOST if lost else positivity.NOTHING_LOST
        monkeypatch.setattr(equations, "loses_positivity", lambda *given, kind=kind: kind)
        assert (solved(at).status == NO_FORCE) == (status == NO_FORCE)
        assert len(asked) == rounds


@SEEDS
def test_a_contact_that_carries_nothing(seed):
    """Its twin carries all; it stays closed, as far as the least loads ask for none of it."""
    at = doubled(seed, True)
    whole = at.force[0, 2] + at.force[1, 2]
    at.integers[0, NORMAL_SIGN] = 0
    out = solved(at)
    assert out.force[:2, 2] == pytest.approx([0.0, whole], abs=1e-9)
    assert out.acceleration == pytest.approx(at.acceleration, abs=1e-9)
    # the least would be half of it: the event function is a load that is missing
    assert out.event_functions[0, NORMAL_EVENT] < 0.0
    assert out.status == EVENT


def test_points_on_curves_without_forces():
    """Where the two normals' own operator has lost positivity, whatever their single ones are."""
    at = made(1)
    at.numbers[6, MU] = 0.0
    solve_backwards(at)
    out = solved(at)
    assert out.force == pytest.approx(at.force + viscous(at), abs=1e-10)
    # friction that turns with the normal force and pulls harder than it pushes
    at.rows[6, 0] = 3.0 * at.rows[6, 1] * at.d[6, 0]
    at.numbers[6, MU] = 4.0
    assert solved(at).status == NO_FORCE


def slips(at, c):
    """Whether friction goes with the normal force of an item."""
    resists = [i for i in range(NC + NG, TOTAL) if OWNERS[i - NC - NG] == c]
    return any(at.integers[i, MODE] == SLIPPING for i in (c, *resists))


def test_slip_that_jams():
    """Friction pulls a sliding contact in by more than its normal force pushes it out (Painleve)."""
    at = made(2)
    # without the torque that goes with its load, too
    at.integers[12, MODE] = STICK
    d = ELLIPSE @ ELLIPSE @ at.d[3] / np.linalg.norm(ELLIPSE @ at.d[3])
    for i in range(2):
        at.rows[3, i] += at.rows[3, 2] * d[i]
    # in the motions that the others leave
    normal = at.rows[3, 2] @ mobility(at, True)
    pull = d @ at.rows[3, :2] @ normal / (at.rows[3, 2] @ normal)
    assert pull > 0.0
    for share, status in ((0.9, OK), (1.0 - 1e-10, NO_FORCE), (1.1, NO_FORCE)):
        at.numbers[3, MU] = share / pull
        out = solved(at)
        assert (out.status == NO_FORCE) == (status == NO_FORCE)
        # of what has none nothing is known
        assert (out.counters["row_rank"] == 0) == (status == NO_FORCE)
        assert status == OK or out.counters["lost_positivity"] == 0


# ---------------------------------------------------------------------------------------------- operators of slip


def slip_system(operator, own, x, on_curve=False):
    """What the solver of slip's equations returns, and x; -1 where a contact's operator has lost positivity."""
    n = len(own)
    made = made_system(n)
    made.contact_int[:, PATTERN], made.contact_int[:, MODE] = ON_CURVE if on_curve else ON_SURFACE, SLIPPING
    made.row_index[:n] = [(i, 1 + i % 2) for i in range(n)]
    made.multipliers[:n], made.delassus[:n, :n], made.delassus[:n, n] = x, operator, own
    rank = part(slip_solver, SYSTEM)(made, n)
    return rank, made.multipliers[:n], made.delassus[0, 0]


@kernel
def slip_solver(system, n):
    lost = positivity.loses_positivity(system, n)
    return -1 if lost == positivity.CONTACT_LOST else equations.solve_slip(system, n)


@SEEDS
@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_equations_of_slip(n, seed):
    rng = np.random.default_rng([n, seed])
    operator, x = 2.0 * np.eye(n) + 0.6 * rng.normal(size=(n, n)), rng.normal(size=n)
    operator.flat[:: n + 1] = np.abs(operator.diagonal())
    own = np.ones(n)
    rank, found, sign = slip_system(operator, own, x)
    assert rank == n
    # condition numbers of up to 1e2
    assert found == pytest.approx(np.linalg.solve(operator, x), abs=1e-12 * np.linalg.cond(operator))
    if n > 1:
        assert (sign > 0.0) == (np.linalg.det(operator) > 0.0)
    for i in range(n):
        # one that nothing moves has no force, and asks for none
        without, rest = own.copy(), np.arange(n) != i
        without[i] = 0.0
        blocked = operator.copy()
        blocked[i] = blocked[:, i] = 0.0
        given = np.where(rest, x, 0.0)
        rank, found, _ = slip_system(blocked, without, x)
        assert rank == n - 1
        assert found[i] == 0.0
        assert found[rest] == pytest.approx(np.linalg.solve(operator[np.ix_(rest, rest)], given[rest]), abs=1e-10)
        # one that carries nothing has no force, but is to be satisfied: here it is
        unloaded, column = own.copy(), operator.copy()
        unloaded[i], column[:, i] = -1.0, 0.0
        forces = np.where(rest, rng.normal(size=n), 0.0)
        rank, found, _ = slip_system(column, unloaded, column @ forces)
        assert rank == max(n - 1, 1)
        assert found == pytest.approx(forces, abs=1e-10)


def test_operators_of_slip_that_have_lost_positivity():
    """Against what they are without friction; a point on a curve is judged by both of its normals."""
    x = np.array([1.0, 2.0])
    for share, lost in ((1.2e-9, False), (0.8e-9, True), (0.0, True), (-1.0, True), (math.nan, True)):
        for i in range(2):
            operator, own = np.array([[2.0, 0.0], [0.0, 2.0]]), np.array([2.0, 2.0])
            operator[i, i] = share * (3.0 if i else 1.0)
            own[i] = 3.0 if i else 1.0
            assert (slip_system(operator, own, x)[0] == -1) == lost
        assert (slip_system(np.array([[share]]), np.array([1.0]), x[:1])[0] == -1) == lost
    operator = np.array([[-1.0, 0.3], [0.2, -1.0]])
    assert slip_system(operator, np.ones(2), x)[0] == -1
    assert slip_system(operator, np.ones(2), x, on_curve=True)[0] == 2
    # nothing at all, and a system that is zero
    assert slip_system(np.zeros((2, 2)), np.zeros(2), x)[0] == 0
    assert slip_system(np.zeros((2, 2)), np.ones(2), x, on_curve=True)[0] == -1
