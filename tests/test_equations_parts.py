"""Accelerations and contact forces of one state: the parts that the equations are made with, each alone."""

from __future__ import annotations

import functools
import itertools
import math

import numpy as np
import pytest
from calling import from_python
from made_systems import made_system

from pincontact.dynamics import equations, event_functions, least_forces, positivity, sliding
from pincontact.geometry.patterns import NO_NORMAL, ON_CURVE, ON_SURFACE
from pincontact.jit import kernel
from pincontact.layout import (
    ACROSS_X,
    ANISOTROPIC,
    CONTACT_INTS,
    CONTACT_REALS,
    DIRECTION_X,
    DOMAIN_EVENT,
    EVENT,
    EVENTS_PER_CONTACT,
    FREE,
    FRICTION_EVENT,
    FRICTIONLESS,
    FROZEN,
    GAP_EVENT,
    HIGH_END,
    HIGH_FORCE,
    JOINT_END,
    JOINT_INTS,
    JOINT_REALS,
    JOINT_SIGN,
    LIMIT_SLACK,
    LOW_END,
    LOW_FORCE,
    MODE,
    MU,
    MU_NOW,
    MU_STATIC,
    NORMAL_1,
    NORMAL_2,
    NORMAL_EVENT,
    NORMAL_SIGN,
    OK,
    PATTERN,
    POLYNOMIAL,
    SCALING_11,
    SCALING_12,
    SCALING_22,
    SLIP_RATE,
    SLIP_SIGN,
    SLIP_SPEED,
    SLIPPING,
    SPAN,
    SPEED_EVENT,
    START,
    STICK,
    SYSTEM,
    TANGENTS,
    UNILATERAL,
    VISCOUS,
)

SEEDS = pytest.mark.parametrize("seed", range(3))
MODES = (FREE, FRICTIONLESS, STICK, SLIPPING)
ELLIPSE = np.array([[1.2, 0.3], [0.3, 0.7]])


part = functools.cache(from_python)


def part_of_system(kernel):
    """One that takes a workspace."""
    return part(kernel, SYSTEM)


def items(n):
    return np.zeros((n, CONTACT_INTS), dtype=np.int64), np.zeros((n, CONTACT_REALS))


class Constrained:
    """A workspace of random items in their modes, in a chain's velocities, with its constraint rows listed."""

    def __init__(self, rng, integers, numbers, nv=7, rank=None):
        """rank: rows are in so many directions."""
        self.n = len(integers)
        self.system = system = made_system(self.n, nv=nv, rng=rng)
        self.integers, self.numbers = system.contact_int, system.contact_real
        self.integers[:], self.numbers[:] = integers, numbers
        if rank is not None:
            system.rows[:] = system.rows @ (rng.normal(size=(nv, rank)) @ rng.normal(size=(rank, nv)))
        system.row_index[:] = -1
        self.count, self.slipping = part_of_system(equations.list_constraints)(system)
        self.inverse = np.linalg.inv(system.factor.T @ system.factor)
        self.index, self.whitened = system.row_index[: self.count], system.whitened_rows[: self.count]
        self.forces = system.whitened_forces[: self.count]
        rows = system.rows[self.index[:, 0], self.index[:, 1]]
        assert self.whitened @ self.whitened.T == pytest.approx(rows @ self.inverse @ rows.T, abs=1e-11)


@pytest.mark.parametrize("mode", MODES)
def test_what_holds_a_contact(mode):
    """Of contacts that slide, held up by friction alone, and of viscous friction."""
    for unilateral, sign, mu, viscous in itertools.product((0, 1), (-1, 0, 1), (0.0, 0.4, math.inf), (0.0, 0.5)):
        integers, numbers = (array[0] for array in items(1))
        integers[[MODE, UNILATERAL, NORMAL_SIGN]] = mode, unilateral, sign
        numbers[[MU, VISCOUS]] = mu, viscous
        shares = mode == SLIPPING and unilateral == 1 and sign == -1
        assert part(sliding.shares_viscous_force)(integers) == shares
        assert part(sliding.is_held_up)(integers, numbers) == (shares or (mode == SLIPPING and mu == math.inf))
        moves = mode in (FRICTIONLESS, SLIPPING) and viscous > 0.0
        assert part(sliding.resists_viscously)(integers, numbers) == (moves and not shares)


@kernel
def viscous_loads(system):
    equations.add_viscous_loads(system, system.free_acceleration)


@SEEDS
def test_viscous_loads(seed):
    rng = np.random.default_rng(seed)
    system = made_system(4, rng=rng)
    integers, numbers = system.contact_int, system.contact_real
    integers[:, MODE], integers[:, TANGENTS] = (FRICTIONLESS, SLIPPING, STICK, FREE), (1, 2, 2, 2)
    numbers[:, VISCOUS] = rng.uniform(0.1, 1.0, 4)
    basis, slip, rows, load = system.basis, system.slip, system.rows, system.free_acceleration
    expected = load - numbers[0, VISCOUS] * rows[0, 0] * (basis[0, 0] @ slip[0])
    for row in (0, 1):
        expected -= numbers[1, VISCOUS] * rows[1, row] * (basis[1, row] @ slip[1])
    part_of_system(viscous_loads)(system)
    assert load == pytest.approx(expected, abs=1e-13)


@SEEDS
def test_directions_of_slip(seed):
    rng = np.random.default_rng(seed)
    integers, numbers = (array[0] for array in items(1))
    basis, slip, out = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3), np.zeros(2)
    along = basis @ slip
    find = part(sliding.slip_direction)
    # one tangent: the sign is a mode, and the speed along it
    integers[TANGENTS], integers[SLIP_SIGN] = 1, -1
    assert find(integers, numbers, slip, basis, 0.3, out) == pytest.approx(-along[0], abs=1e-15)
    assert out.tolist() == [-1.0, 0.0]
    integers[TANGENTS] = 2
    speed = math.hypot(along[0], along[1])
    assert find(integers, numbers, slip, basis, 0.3, out) == pytest.approx(speed, rel=1e-14)
    assert out == pytest.approx(along[:2] / speed, rel=1e-14)
    # a frozen one is a polynomial in the part of its span
    world, across = rng.normal(size=(2, 3))
    numbers[DIRECTION_X : DIRECTION_X + 3], numbers[ACROSS_X : ACROSS_X + 3] = world, across
    polynomial = numbers[POLYNOMIAL : POLYNOMIAL + 5] = rng.normal(size=5)
    numbers[START], numbers[SPAN] = 0.1, 0.4
    turn = sum(a * 0.5**i for i, a in enumerate(polynomial))
    expected = basis[:2] @ (world + turn * across)
    for frozen, velocity in ((1, slip), (0, 0.0 * slip)):
        integers[FROZEN] = frozen
        found = find(integers, numbers, velocity, basis, 0.3, out)
        assert found == pytest.approx(0.0 if frozen == 0 else speed, rel=1e-14)
        assert out == pytest.approx(expected / np.linalg.norm(expected), rel=1e-12)
    # however small what is left of it in the tangent plane
    numbers[DIRECTION_X : DIRECTION_X + 3], numbers[ACROSS_X : ACROSS_X + 3] = 1e-3 * world, 1e-3 * across
    find(integers, numbers, 0.0 * slip, basis, 0.3, out)
    assert out == pytest.approx(expected / np.linalg.norm(expected), rel=1e-12)
    # none is none
    numbers[DIRECTION_X : DIRECTION_X + 3] = numbers[ACROSS_X : ACROSS_X + 3] = 0.0
    find(integers, numbers, 0.0 * slip, basis, 0.3, out)
    assert out.tolist() == [0.0, 0.0]


def test_rows_in_their_order():
    """The normal first, then a curve's other normal, then stuck tangents."""
    integers, _ = items(8)
    integers[:, MODE] = FREE, FRICTIONLESS, STICK, STICK, SLIPPING, STICK, SLIPPING, STICK
    integers[:, TANGENTS] = 2, 2, 2, 1, 2, 1, 1, 2
    integers[:, PATTERN] = ON_SURFACE
    integers[[5, 6], PATTERN], integers[7, PATTERN] = ON_CURVE, NO_NORMAL
    index = np.full((24, 2), -1)
    expected = [[1, 2], [2, 2], [2, 0], [2, 1], [3, 2], [3, 0], [4, 2], [5, 2], [5, 1], [5, 0], [6, 2], [6, 1], [7, 0],
                [7, 1]]  # fmt: skip
    assert part(equations.list_rows)(integers, 8, index) == (14, True)
    assert index[:14].tolist() == expected
    integers[[4, 6], MODE] = FREE
    assert part(equations.list_rows)(integers, 8, index) == (11, False)


def curves(rng, n=3):
    """Points on curves that slip with friction, after a contact that does not."""
    integers, numbers = items(n)
    integers[:, MODE], integers[:, PATTERN], integers[:, TANGENTS] = SLIPPING, ON_CURVE, 1
    integers[0, PATTERN], integers[0, MODE] = ON_SURFACE, STICK
    numbers[:, MU] = 0.3
    return Constrained(rng, integers, numbers)


@kernel
def assembled(system, n):
    equations.assemble_slip(system, n)
    return positivity.loses_positivity(system, n)


def lost_by(system, count):
    return part_of_system(assembled)(system, count)


@pytest.mark.parametrize("in_plane", [False, True])
def test_how_little_of_a_curves_operator_is_left(in_plane):
    """1e-9 of its determinant without friction, or of its trace, in any units."""
    system = made_system(1, nv=2)
    system.contact_int[0, [MODE, PATTERN]] = SLIPPING, ON_CURVE
    system.row_index[:2] = [0, 2], [0, 1]
    for unit in (0.1, 10.0):
        own = unit * np.array([[1.0, 0.0], [0.0, 0.0 if in_plane else 1.0]])
        for share, lost in ((1.2e-9, positivity.NOTHING_LOST), (0.8e-9, positivity.CURVES_LOST)):
            system.whitened_rows[:2], system.whitened_forces[:2] = own, np.array([[share], [1.0]]) * own
            assert lost_by(system, 2) == lost


def test_the_least_angle_between_normals_that_counts():
    """Their sine squared is 1e-11 times the trace squared, which is 4 for units."""
    for sine, in_plane in ((5e-6, True), (8e-6, False)):
        assert part(positivity.is_plane)(2.0, sine**2) == in_plane


@SEEDS
@pytest.mark.parametrize("in_plane", [False, True])
def test_operators_of_curves_that_lose_positivity(in_plane, seed):
    """Against the determinant of the operator of both normals, or its trace, in the motions that what sticks leaves."""
    rng, lost = np.random.default_rng(seed), 0
    for _ in range(40):
        parts = curves(rng)
        whitened, forces = parts.whitened, parts.forces
        held = len(whitened) - 4
        if in_plane:
            for row in (held, held + 2):
                whitened[row + 1] = rng.normal() * whitened[row]
        sizes = np.linalg.norm(whitened, axis=1, keepdims=True)
        forces[:] = whitened + 0.8 * sizes * rng.normal(size=whitened.shape)
        forces[:held] = whitened[:held]
        free = np.eye(7) - np.linalg.pinv(whitened[:held]) @ whitened[:held]
        expected = False
        for row in (held, held + 2):
            own, pushed = whitened[row : row + 2], forces[row : row + 2]
            size = np.trace if in_plane else np.linalg.det
            expected = expected or bool(size(own @ free @ pushed.T) <= 0.0)
        assert (lost_by(parts.system, parts.count) == positivity.CURVES_LOST) == expected
        lost += expected
    assert 0 < lost < 40
    # what nothing moves has nothing to lose
    whitened[held:] = forces[held:] = 0.0
    assert lost_by(parts.system, parts.count) == positivity.NOTHING_LOST


@SEEDS
def test_what_cannot_open_has_one_operator(seed):
    """Against determinants, where what sticks is held: that of all that slips and cannot open, and with it that of
    each contact that slips and can; they are positive without friction, and a single element may be negative."""
    rng, found = np.random.default_rng([3, seed]), set()
    for _ in range(400):
        integers, numbers = items(5)
        integers[:, MODE], integers[:, PATTERN], integers[:, TANGENTS] = SLIPPING, ON_SURFACE, 1
        stuck = int(rng.choice([0, 4]))
        integers[:, UNILATERAL], integers[:, NORMAL_SIGN] = [1, 0, 1, 0, 0], 1
        integers[4 - stuck, MODE], integers[stuck, MODE] = rng.choice([SLIPPING, FREE]), STICK
        parts = Constrained(rng, integers, numbers)
        whitened, forces, items_of = parts.whitened, parts.forces, parts.index[:, 0]
        held = items_of == stuck
        forces[:] = whitened + 0.5 * np.linalg.norm(whitened, axis=1, keepdims=True) * rng.normal(size=whitened.shape)
        forces[held] = whitened[held]
        free = np.eye(7) - np.linalg.pinv(whitened[held]) @ whitened[held]
        operator = whitened @ free @ forces.T
        alone = [r for r in np.flatnonzero(~held).tolist() if integers[items_of[r], UNILATERAL]]
        closed = [r for r in np.flatnonzero(~held).tolist() if r not in alone]
        units = (whitened @ free / np.linalg.norm(whitened, axis=1, keepdims=True))[closed + alone]
        if np.linalg.det(units @ units.T) < 1e-2:
            # next to redundant
            continue
        common, *beside = (
            np.linalg.det(operator[np.ix_(rows, rows)]) for rows in (closed, *([*closed, r] for r in alone))
        )
        lost = lost_by(parts.system, parts.count) == positivity.CONTACT_LOST
        assert lost == (min(common, *beside) <= 0.0)
        found.add((bool(operator.diagonal()[closed + alone].min() <= 0.0), lost))
    assert len(found) == 4


@SEEDS
def test_operators_of_what_slips_beside_what_is_held(seed):
    """Against its own where only what the others leave can move: it may have lost it there alone, or only without."""
    rng, found = np.random.default_rng(seed), set()
    for _ in range(800):
        integers, numbers = items(3)
        integers[:, MODE], integers[:, PATTERN], integers[:, TANGENTS] = [STICK, SLIPPING, FRICTIONLESS], ON_SURFACE, 2
        parts = Constrained(rng, integers, numbers)
        whitened, forces = parts.whitened, parts.forces
        row = int(np.flatnonzero(parts.index[:, 0] == 1)[0])
        forces[:] = whitened
        forces[row] += 1.5 * np.linalg.norm(whitened[row]) * rng.normal(size=7) / math.sqrt(7.0)
        others = np.delete(whitened, row, axis=0)
        free = np.eye(7) - np.linalg.pinv(others) @ others
        alone, beside = whitened[row] @ forces[row], whitened[row] @ free @ forces[row]
        lost = lost_by(parts.system, parts.count)
        assert (lost == positivity.CONTACT_LOST) == (beside <= 0.0)
        found.add((bool(alone <= 0.0), bool(beside <= 0.0)))
        # what the others hold but for a thousandth of its mobility is one of redundant forces
        part_left = free @ whitened[row]
        for share, exempt in ((9e-4, True), (1.1e-3, False)):
            rest = math.sqrt(share / (1.0 - share)) * np.linalg.norm(whitened[row] - part_left)
            near = whitened[row] - part_left + rest * part_left / np.linalg.norm(part_left)
            kept = whitened[row].copy(), forces[row].copy()
            whitened[row], forces[row] = near, near - 2.0 * rest * part_left / np.linalg.norm(part_left)
            assert (lost_by(parts.system, parts.count) == positivity.NOTHING_LOST) == exempt
            whitened[row], forces[row] = kept
    assert len(found) == 4


@SEEDS
@pytest.mark.parametrize("in_plane", [False, True])
def test_normal_forces_on_curves(in_plane, seed):
    """Their direction is that of the multipliers; of redundant ones the least with the same effect."""
    rng = np.random.default_rng(seed)
    parts = curves(rng)
    numbers, multipliers, whitened = parts.numbers, parts.system.multipliers, parts.whitened
    numbers[:, NORMAL_1], numbers[:, NORMAL_2] = rng.normal(size=(2, 3))
    before = numbers.copy()
    expected, changes = before[:, [NORMAL_1, NORMAL_2]], []
    for c, row in ((1, 2), (2, 4)):
        if in_plane:
            # the larger one either of both
            whitened[row + 1] = (-0.5 if c == 1 else 3.0) * whitened[row]
        own = whitened[row : row + 2]
        force = multipliers[row : row + 2]
        if in_plane:
            force = np.linalg.pinv(own.T) @ (own.T @ force)
        changes.append(np.abs(expected[c] - force / np.linalg.norm(force)).sum())
        expected[c] = force / np.linalg.norm(force)
    update = part_of_system(equations.update_normal_shares)
    assert update(parts.system, parts.count) == pytest.approx(max(changes), rel=1e-12)
    assert numbers[:, [NORMAL_1, NORMAL_2]] == pytest.approx(expected, rel=1e-12)
    assert update(parts.system, parts.count) == pytest.approx(0.0, abs=1e-15)
    # where nothing moves along one of both, all of it is along the other, however slightly that moves
    for none, other in ((2, 3), (3, 2)):
        whitened[none], whitened[other] = 0.0, 0.01 * rng.normal(size=7)
        update(parts.system, parts.count)
        share = numbers[1, [NORMAL_1, NORMAL_2]]
        assert share[none - 2] == 0.0
        assert share[other - 2] == math.copysign(1.0, multipliers[other])
    # without a force, or without friction, the last one stays
    multipliers[2:4] = 0.0
    assert update(parts.system, parts.count) == pytest.approx(0.0, abs=1e-15)
    multipliers[2:4], kept = rng.normal(size=2), numbers.copy()
    numbers[:, MU] = 0.0
    assert update(parts.system, parts.count) == 0.0
    assert (numbers[:, [NORMAL_1, NORMAL_2]] == kept[:, [NORMAL_1, NORMAL_2]]).all()


def units_of(parts):
    """(count,) the force by which each multiplier is measured: the mean mobility over the directions of its cone."""
    out, integers, numbers, all_rows = [], parts.integers, parts.numbers, parts.system.rows
    for c, row in parts.index:
        mobility = np.einsum("ik,kl,il->i", all_rows[c], parts.inverse, all_rows[c])
        own = mobility[row]
        if integers[c, PATTERN] == ON_CURVE and row != 0:
            unit = mobility.mean()
        elif row != 2 or integers[c, MODE] == FRICTIONLESS or integers[c, TANGENTS] == 0:
            out.append(own)
            continue
        elif integers[c, TANGENTS] == 1:
            unit = (own + mobility[0] + max(own, mobility[0])) / 3.0
        elif integers[c, ANISOTROPIC]:
            stretched = ELLIPSE @ all_rows[c, :2]
            unit = (own + np.einsum("ik,kl,il->", stretched, parts.inverse, stretched)) / 3.0
        else:
            unit = mobility.mean()
        if integers[c, MODE] == SLIPPING and numbers[c, MU] < math.inf:
            unit *= 1.0 + numbers[c, MU_NOW] ** 2
        out.append(unit)
    return np.array(out)


def loaded_contacts(rng, rank):
    """Contacts that slide, of which two carry nothing, one that sticks, one on a curve and one without friction."""
    integers, numbers = items(7)
    integers[:, MODE] = SLIPPING, SLIPPING, SLIPPING, SLIPPING, STICK, SLIPPING, FRICTIONLESS
    integers[:, TANGENTS] = 2, 1, 2, 2, 1, 1, 2
    integers[:, PATTERN], integers[5, PATTERN] = ON_SURFACE, ON_CURVE
    integers[:, UNILATERAL], integers[:, NORMAL_SIGN] = 1, 1
    integers[[1, 2], NORMAL_SIGN] = 0
    # a bilateral one has no sign that says this
    integers[5, UNILATERAL], integers[5, NORMAL_SIGN] = 0, 0
    numbers[:, MU_NOW], numbers[:, MU] = rng.uniform(0.1, 0.8, (2, 7))
    numbers[3, MU] = math.inf
    integers[0, ANISOTROPIC] = 1
    numbers[0, [SCALING_11, SCALING_12, SCALING_22]] = ELLIPSE[0, 0], ELLIPSE[0, 1], ELLIPSE[1, 1]
    return Constrained(rng, integers, numbers, rank=rank)


@SEEDS
@pytest.mark.parametrize("rank", [None, 3])
def test_whether_a_load_would_be_asked_for(rank, seed):
    """Least forces that are not negative: N = A^T y + s, in their units, with s >= 0 where they are zero."""
    rng = np.random.default_rng(seed)
    parts = loaded_contacts(rng, rank)
    system, count, nv = parts.system, parts.count, 7
    forces = parts.whitened + 0.2 * rng.normal(size=(count, nv))
    if rank is not None:
        forces = parts.whitened * rng.uniform(0.5, 1.5, (count, 1))
    parts.forces[:] = forces
    unit = 1.0 / np.sqrt(units_of(parts))
    operator, found = parts.whitened @ forces.T, system.delassus[:count, : count + 1]
    part_of_system(least_forces.weigh_forces)(system, count)
    assert found[:, count] == pytest.approx(unit, rel=1e-12)
    assert found[:, :count] == pytest.approx(operator * unit, abs=1e-11)
    empty = [r for r, (c, row) in enumerate(parts.index.tolist()) if c in (1, 2) and row == 2]
    for r in range(count):
        system.sizes["nc"] = 7
        assert part_of_system(least_forces.carries_nothing)(system, r) == (r in empty)
        # beyond the contacts there are others
        system.sizes["nc"] = parts.index[r, 0]
        assert not part_of_system(least_forces.carries_nothing)(system, r)
    system.sizes["nc"] = 7
    part_of_system(least_forces.leave_unloaded)(system, count)
    assert np.flatnonzero(found[:, count] == -1.0).tolist() == empty
    assert not found[:, empty].any()
    rest = [r for r in range(count) if r not in empty]
    assert found[:, rest] == pytest.approx((operator * unit)[:, rest], abs=1e-11)

    def event_functions(bias):
        y = rng.normal(size=count)
        multipliers = np.where(np.isin(np.arange(count), empty), 0.0, unit * ((operator * unit).T @ y))
        least = np.linalg.pinv((operator * unit)[:, rest].T, rcond=1e-9) @ (multipliers / unit)[rest]
        system.event_functions[:], system.multipliers[:count], system.bias[:], out = (
            5.0,
            multipliers,
            bias,
            system.event_functions,
        )
        status = part_of_system(unloaded)(system, count)
        # the others' event functions are not its business
        assert (out[[0, 3, 4, 5, 6]] == 5.0).all()
        assert np.delete(out, NORMAL_EVENT, axis=1).min() == 5.0
        assert status == (EVENT if out[1:3, NORMAL_EVENT].min() < 0.0 else OK)
        return out[1:3, NORMAL_EVENT], -(unit * ((operator * unit).T @ least))[empty]

    bias = -(system.rows @ system.acceleration)
    for _ in range(5):
        found, expected = event_functions(bias)
        # of systems with condition numbers of up to 1e4
        assert found == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    # what does not stay closed, or not apart, by itself
    for change, closes in ((1e-9, True), (1e-5, False), (-1e-5, False)):
        other = bias.copy()
        other[1, 2] += change
        found, expected = event_functions(other)
        assert (found[0] == -1.0) == (not closes)
        assert found[1] != -1.0
    # none of them, none to look at
    parts.integers[:, NORMAL_SIGN] = 1
    system.event_functions[:] = 5.0
    assert part_of_system(unloaded)(system, count) == OK
    assert (system.event_functions == 5.0).all()


@SEEDS
def test_forces_from_a_reference(seed):
    """It follows forces; what the multipliers have to make up is less by what it does."""
    rng = np.random.default_rng(seed)
    system, count = made_system(3, rng=rng), 4
    index = system.row_index[:count]
    index[:] = [0, 2], [1, 2], [1, 0], [2, 1]
    c, row = index.T
    loads = -(system.rows[c, row] @ system.free_acceleration + system.bias[c, row])
    part_of_system(equations.right_hand_sides)(system, count)
    x = system.multipliers[:count]
    assert x == pytest.approx(loads, abs=1e-13)
    system.reference[:] = 7.0
    system.reference_start[:] = rng.normal(size=(3, 3))
    slope = system.reference_slope
    slope[:] = rng.normal(size=slope.shape)
    places, start, forces = 3 * c + row, system.reference_start[c, row], rng.normal(size=count)
    moved = start + slope[1, places] @ (slope[0, places].T @ (forces - start))
    x[:] = forces
    part_of_system(equations.move_reference)(system, count)
    assert system.reference[c, row] == pytest.approx(moved, abs=1e-12)
    assert (system.reference == 7.0).sum() == 9 - count
    operator = system.whitened_rows[:count] @ system.whitened_forces[:count].T
    part_of_system(taken)(system, count)
    assert x == pytest.approx(loads - operator @ moved, abs=1e-11)


@kernel
def taken(system, count):
    equations.take_reference(system, count, system.whitened_forces)


@kernel
def unloaded(system, count):
    return least_forces.unloaded_event_functions(system, count)


def test_dry_friction_of_joints():
    numbers = np.zeros(JOINT_REALS)
    numbers[[LOW_FORCE, HIGH_FORCE]] = -2.0, 3.0
    for mode, sign, force in ((FREE, 1, -2.0), (FREE, -1, 3.0), (FREE, 0, 0.0), (STICK, 1, 0.0)):
        limit = np.zeros(JOINT_INTS, dtype=np.int64)
        limit[JOINT_SIGN] = sign
        assert part(equations.dry_friction_force)(mode, limit, numbers) == force


@SEEDS
def test_event_functions_of_limited_joints(seed):
    """Moving: ways to both ends, and the speed; held: forces above the lower and below the upper bound."""
    rng = np.random.default_rng(seed)
    nc, cases = 2, list(itertools.product((FREE, FRICTIONLESS), (-1, 0, 1), (-1, 0, 1), (False, True), (False, True)))
    ng = len(cases)
    system = made_system(nc, ng, rng=rng)
    integers, limits, numbers = system.contact_int, system.joint_int, system.joint_real
    slip, gaps, force, values = system.slip, system.gaps, system.force, system.event_functions
    numbers[:, LOW_FORCE], numbers[:, HIGH_FORCE] = -rng.random(ng), rng.random(ng)
    expected = np.ones((nc + ng, EVENTS_PER_CONTACT))
    for g, (mode, sign, end, low, high) in enumerate(cases):
        i = nc + g
        integers[i, MODE], limits[g, JOINT_SIGN], limits[g, JOINT_END] = mode, sign, end
        numbers[g, LOW_END] = gaps[i, 0] - rng.normal() - 0.5 if low else -math.inf
        numbers[g, HIGH_END] = gaps[i, 0] + rng.normal() + 0.5 if high else math.inf
        if mode == FREE:
            if low:
                expected[i, GAP_EVENT] = gaps[i, 0] - numbers[g, LOW_END]
            if high:
                expected[i, DOMAIN_EVENT] = numbers[g, HIGH_END] - gaps[i, 0]
            if sign:
                expected[i, SPEED_EVENT] = sign * slip[i, 2]
        else:
            if end != 1:
                expected[i, NORMAL_EVENT] = force[i, 2] - numbers[g, LOW_FORCE]
            if end != -1:
                expected[i, FRICTION_EVENT] = numbers[g, HIGH_FORCE] - force[i, 2]
    values[:nc], values[nc:] = 1.0, 9.0
    of_joints = part_of_system(event_functions.joint_event_functions)
    assert of_joints(system) == EVENT
    assert values == pytest.approx(expected, abs=1e-15)
    # one by one
    for g in range(ng):
        alone = made_system(nc, 1)
        for name in ("contact_int", "slip", "gaps", "force"):
            getattr(alone, name)[nc] = getattr(system, name)[nc + g]
        alone.joint_int[0], alone.joint_real[0] = limits[g], numbers[g]
        assert of_joints(alone) == (EVENT if expected[nc + g].min() < 0.0 else OK)


@SEEDS
@pytest.mark.parametrize("tangents", [1, 2])
def test_event_functions_of_friction(tangents, seed):
    """Forces of slip are against it, those of stick within the limit; and rates of the speed."""
    rng = np.random.default_rng(seed)
    system, load = made_system(2, rng=rng), rng.uniform(0.5, 2.0)
    basis, slip, force, value = system.basis[1], system.slip[1], system.force[1], system.event_functions[1]
    relative = system.rows[1] @ system.acceleration + system.bias[1]
    sign = 1 if rng.random() < 0.5 else -1
    for mode, unilateral, normal_sign, mu in (
        (STICK, 1, 1, 0.4), (STICK, 1, 1, math.inf), (FRICTIONLESS, 1, 1, 0.0), (SLIPPING, 1, 1, 0.4),
        (SLIPPING, 1, 1, math.inf), (SLIPPING, 1, -1, 0.4), (SLIPPING, 0, -1, 0.4), (SLIPPING, 1, 1, 0.0),
    ):  # fmt: skip
        integers, numbers = system.contact_int[1], system.contact_real[1]
        integers[[MODE, UNILATERAL, NORMAL_SIGN, TANGENTS, SLIP_SIGN]] = mode, unilateral, normal_sign, tangents, sign
        numbers[[MU, MU_STATIC, MU_NOW, LIMIT_SLACK, VISCOUS]] = mu, 1.5 * mu, 0.9 * mu, 0.01, 0.3
        before = rng.normal(size=3)
        force[:], value[:] = before, 1.0
        with np.errstate(invalid="ignore"):
            part_of_system(event_functions.friction_event_functions)(system, 1, load)
        expected, after = np.ones(EVENTS_PER_CONTACT), before.copy()
        if mode == STICK and mu < math.inf:
            expected[FRICTION_EVENT] = 1.01 * 1.5 * mu * load - np.linalg.norm(before[:tangents])
        if mode == SLIPPING:
            along = (basis @ slip)[:2]
            direction = np.array([sign, 0.0]) if tangents == 1 else along / np.linalg.norm(along)
            speed, rate = direction @ along, direction @ relative[:2]
            assert system.relative_acceleration[1] == pytest.approx(relative, abs=1e-13)
            assert numbers[[SLIP_SPEED, SLIP_RATE]] == pytest.approx([speed, rate], abs=1e-13)
            shares = unilateral == 1 and normal_sign == -1
            friction = 0.9 * mu * load
            if shares or mu == math.inf:
                friction, after[2] = before[2], 0.0
            after[:tangents] = -friction * direction[:tangents]
            if shares:
                expected[FRICTION_EVENT] = 0.3 * abs(speed) - friction
            if tangents == 1 and mu > 0.0:
                expected[SPEED_EVENT] = speed
        assert force == pytest.approx(after, abs=1e-13)
        assert value == pytest.approx(expected, abs=1e-13)
