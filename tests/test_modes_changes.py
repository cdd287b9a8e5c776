"""The choice of modes step by step: what is opened, held, let go, loaded or turned when evaluations say what they do.

Evaluations are played by functions, so that each step is seen alone.
"""

from __future__ import annotations

import functools
import itertools
import math

import numpy as np
import pytest
from calling import from_python, record_of
from made_systems import made_system
from scipy.optimize import nnls
from shared import rotation
from test_modes_parts import made

from pincontact.dynamics import contact_modes, equations, modes, redistribution
from pincontact.dynamics.mode_loads import ModeSolution
from pincontact.dynamics.modes import Decision, ModeSolver
from pincontact.dynamics.system import System
from pincontact.friction import cone
from pincontact.friction.centred import Choice, Cone
from pincontact.geometry.patterns import NO_NORMAL, ON_CURVE, ON_SURFACE
from pincontact.layout import (
    ANISOTROPIC,
    CONTACT_INTS,
    CONTACT_REALS,
    COUNTERS,
    DIRECTION_X,
    EVENT,
    EVENTS_PER_CONTACT,
    FREE,
    FRICTION_EVENT,
    FRICTIONLESS,
    FROZEN,
    HIGH_FORCE,
    JOINT_END,
    JOINT_INTS,
    JOINT_REALS,
    JOINT_SIGN,
    JOINT_V,
    LENGTH,
    LOCATION_FAILED,
    LOW_FORCE,
    MODE,
    MU,
    MU_NOW,
    MU_STATIC,
    NO_FORCE,
    NORMAL_1,
    NORMAL_2,
    NORMAL_EVENT,
    NORMAL_SIGN,
    OK,
    OWNER,
    PATTERN,
    SCALARS,
    SCALING_11,
    SCALING_12,
    SCALING_22,
    SLIP_RATE,
    SLIP_SIGN,
    SLIPPING,
    STICK,
    SYSTEM,
    TANGENTS,
    UNILATERAL,
    VISCOUS,
)

SEEDS = pytest.mark.parametrize("seed", range(4))
part = functools.cache(from_python)
T = 0.6


class Items:
    """The arrays of contacts, joint coordinates and resistances that an evaluation leaves."""

    closed, held, resisting, owner, modes = (
        System.closed, System.held, System.resisting, System.owner, System.modes,
    )  # fmt: skip

    @property
    def mass(self):
        return self.factor.T @ self.factor

    def __init__(self, nc, ng=0, nr=0, nv=6, seed=0):
        rng = np.random.default_rng(seed)
        self.nc, self.ng, self.nr, self.nv, self.trees = nc, ng, nr, nv, np.ones((nv, 1))
        n = self.items = nc + ng + nr
        self.contact_int, self.contact_real = np.zeros((n, CONTACT_INTS), np.int64), np.zeros((n, CONTACT_REALS))
        self.contact_int[:, [TANGENTS, MODE, UNILATERAL, NORMAL_SIGN]] = 2, STICK, 1, 1
        self.contact_int[nc + ng :, PATTERN] = NO_NORMAL
        self.contact_real[:, [MU, MU_STATIC, MU_NOW]] = 0.3, 0.5, 0.2
        self.joint_int, self.joint_real = np.zeros((ng, JOINT_INTS), np.int64), np.zeros((ng, JOINT_REALS))
        self.joint_int[:, JOINT_V] = np.arange(ng) + 1
        self.event_functions, self.force = np.ones((n, EVENTS_PER_CONTACT)), rng.normal(size=(n, 3))
        self.rows, self.bias = rng.normal(size=(n, 3, nv)), rng.normal(size=(n, 3))
        self.basis = np.array([rotation(rng) for _ in range(n)])
        self.slip = rng.normal(size=(n, 3))
        self.v, self.acceleration, self.free_acceleration = rng.normal(size=(3, nv))
        self.factor = np.eye(nv) + 0.2 * np.tril(rng.normal(size=(nv, nv)))
        self.inverse = np.linalg.inv(self.factor.T @ self.factor)
        self.bias_forces, self.tau = np.zeros(nv), np.zeros(nv)
        self.scale = np.array([1e-8, 1e-10])
        self.counters, self.scalars = record_of(COUNTERS), record_of(SCALARS)
        self.reference = rng.normal(size=(n, 3))
        self.reference_start = rng.normal(size=(n, 3))
        self.reference_slope = rng.normal(size=(2, 3 * n, nv))
        self.row_index = np.zeros((3 * n, 2), np.int64)
        self.whitened_rows = self.whitened_forces = np.zeros((3 * n, nv))

    def list_rows(self, index):
        """Constraint rows (item, row) of an evaluation, whitened."""
        self.row_index[: len(index)] = index
        self.counters["row_count"] = len(index)
        self.whitened_rows = np.zeros((len(self.row_index), self.nv))
        rows = np.array([self.rows[c, row] for c, row in index])
        self.whitened_rows[: len(index)] = np.linalg.solve(self.factor.T, rows.T).T
        self.whitened_forces = self.whitened_rows.copy()
        self.counters["row_rank"] = np.linalg.matrix_rank(rows)


class Played:
    """An evaluation that returns these statuses one after the other, the last one again and again; what modes it was
    asked with. then: what happens to the system besides, given the number of the call."""

    def __init__(self, system, *statuses, then=None):
        self.system, self.statuses, self.then = system, statuses or (OK,), then
        self.asked = []

    def __call__(self, t):
        assert t == T
        self.asked.append(self.system.contact_int[:, MODE].tolist())
        if self.then is not None:
            self.then(len(self.asked) - 1)
        return self.statuses[min(len(self.asked), len(self.statuses)) - 1]


def saying(*answers):
    """A function that answers so, one after the other, the last one again and again; with what it was asked."""
    asked = []

    def answer(*arguments):
        asked.append(arguments)
        return answers[min(len(asked), len(answers)) - 1]

    answer.asked = asked
    return answer


def never(*arguments):
    raise AssertionError(arguments)


def slides_along(system, i, direction):
    assert system.contact_int[i, [MODE, FROZEN]].tolist() == [SLIPPING, 1]
    world = system.contact_real[i, DIRECTION_X : DIRECTION_X + 3]
    assert system.basis[i, :2] @ world == pytest.approx(direction / np.linalg.norm(direction), abs=1e-12)


# ---------------------------------------------------------------------------------------------- what contacts are


def test_what_contacts_are():
    system = Items(2)
    for mode, unilateral, sign, mu, viscous in itertools.product(
        (FREE, FRICTIONLESS, STICK, SLIPPING), (0, 1), (-1, 0, 1), (0.0, 0.4, math.inf), (0.0, 0.7)
    ):
        system.contact_int[1, [MODE, UNILATERAL, NORMAL_SIGN]] = mode, unilateral, sign
        system.contact_real[1, [MU, VISCOUS]] = mu, viscous
        shares = mode == SLIPPING and unilateral == 1 and sign == -1
        assert contact_modes.shares_viscous_force(system, 1) == shares
        assert contact_modes.held_up_by_friction(system, 1) == (shares or (mode == SLIPPING and mu == math.inf))
        assert contact_modes.drags(system, 1) == (
            mode in (FRICTIONLESS, SLIPPING) and unilateral == 1 and viscous > 0.0
        )
        before = system.contact_int[0].tolist()
        ModeSolver(system).load(1)
        # what only a part of viscous friction has kept closed has no other
        assert system.contact_int[1, MODE] == (FRICTIONLESS if shares and mu == 0.0 else mode)
        assert system.contact_int[1, NORMAL_SIGN] == 1
        assert system.contact_int[0].tolist() == before
    assert [contact_modes.rest_mode(mu) for mu in (0.0, 1e-9, math.inf)] == [FRICTIONLESS, STICK, STICK]


def test_every_closed_contact_gets_a_load():
    system = Items(6)
    solver = ModeSolver(system)
    assert solver._load_all()
    system.contact_int[:, NORMAL_SIGN] = 1, 0, -1, 0, -1, 0
    system.contact_int[3, UNILATERAL] = 0
    system.contact_int[5, MODE] = FREE
    assert not solver._load_all()
    assert system.contact_int[:, NORMAL_SIGN].tolist() == [1, 1, 1, 0, 1, 0]
    assert solver._load_all()


def test_nothing_is_counted_before_it_is_done():
    solver = ModeSolver(Items(2, 1))
    assert (solver.cone_problems, solver.redistributions, solver.worst_residual) == (0, 0, 0.0)
    assert not solver.redundant
    assert not solver.proved


def test_sizes_of_round_off():
    """Of forces: from the loads on joints."""
    system = Items(3, nv=2)
    solver = ModeSolver(system)
    assert solver.force_round_off() == 0.0
    system.bias_forces[:], system.tau[:] = [1.0, -2.0], [3.0, -4.0]
    assert solver.force_round_off() == pytest.approx(6e-11, rel=1e-12)


def test_a_part_of_viscous_friction_is_less_than_all_of_it():
    system = Items(2)
    system.force[1] = 3.0, -4.0, 100.0
    for margin, all_of_it in ((-4.9e-6, False), (-5.1e-6, True), (1.0, False)):
        system.event_functions[1, FRICTION_EVENT] = margin
        assert ModeSolver(system)._takes_all(1) is all_of_it


# ---------------------------------------------------------------------------------------------- joint coordinates


@pytest.mark.parametrize("dry", [False, True])
def test_coordinates_are_held_and_let_go(dry):
    system = Items(2, 3)
    solver = ModeSolver(system)
    system.contact_int[:, MODE] = FREE
    system.joint_real[:, [LOW_FORCE, HIGH_FORCE]] = [-0.2, 0.1] if dry else [0.0, 0.0]
    expected, limits = system.contact_int.copy(), system.joint_int.copy()
    for end in (-1, 0, 1):
        system.joint_int[1, JOINT_SIGN] = 1
        solver.hold(1, end)
        expected[3, MODE] = FRICTIONLESS
        limits[1, [JOINT_SIGN, JOINT_END]] = 0, end
        assert (system.contact_int.tolist(), system.joint_int.tolist()) == (expected.tolist(), limits.tolist())
        sign = 1 if end <= 0 else -1
        solver.release(1, sign)
        expected[3, MODE] = FREE
        limits[1, [JOINT_SIGN, JOINT_END]] = sign if dry else 0, 0
        assert (system.contact_int.tolist(), system.joint_int.tolist()) == (expected.tolist(), limits.tolist())


def test_a_coordinate_moves_whose_force_is_beyond_a_bound():
    system = Items(4, 3)
    solver, released = ModeSolver(system), {}
    system.tau[:] = 10.0
    system.joint_real[:, HIGH_FORCE] = 0.1
    system.joint_int[:, JOINT_END] = 1, 0, -1
    # round-off of the loads
    system.event_functions[4:, [NORMAL_EVENT, FRICTION_EVENT]] = -0.9e-10
    assert not solver._release_one(released)
    system.event_functions[5, FRICTION_EVENT], system.event_functions[6, NORMAL_EVENT] = -1.1e-10, -0.3
    assert solver._release_one(released)
    # below its upper bound: friction cannot push enough that way
    assert released == {1: (0, -1)}
    assert system.joint_int[1, JOINT_SIGN] == -1
    assert solver._release_one(released)
    assert released == {1: (0, -1), 2: (-1, 1)}
    assert system.held() == [0]
    assert not solver._release_one(released)
    # what would go back is held where it was
    system.free_acceleration[:] = 0.0, 0.0, 5.0, -20.0, 0.0, 0.0
    system.acceleration[1:4] = -1.0, 1.9e-10, -1.9e-10
    assert not solver._hold_one(released)
    system.acceleration[3] = -2.1e-10
    assert solver._hold_one(released)
    assert released == {1: (0, -1)}
    assert system.held() == [0, 2]
    assert system.joint_int[2, JOINT_END] == -1
    system.acceleration[2] = 0.3
    assert solver._hold_one(released)
    assert not released
    assert system.joint_int[1, JOINT_END] == 0


# ---------------------------------------------------------------------------------------------- contacts that open


@pytest.mark.parametrize("mode", [FRICTIONLESS, SLIPPING])
@pytest.mark.parametrize("tangents", [1, 2])
@pytest.mark.parametrize("along", [-0.4, 0.0, 0.3])
def test_a_contact_kept_closed_by_a_part_of_its_friction(along, tangents, mode, monkeypatch):
    def tried(statuses=(OK, EVENT), gap=-1.0, margin=0.0, other=0.0, takes_all=False, viscous=0.1):
        system = Items(2)
        solver = ModeSolver(system)
        system.contact_int[1, [MODE, TANGENTS, SLIP_SIGN]] = mode, tangents, 5
        system.contact_real[1, VISCOUS], system.tau[:] = viscous, 10.0
        system.basis[1] = np.eye(3)
        system.slip[1] = along, 0.7, 0.1
        system.event_functions[:2, NORMAL_EVENT] = other, margin
        gaps = saying(gap)
        monkeypatch.setattr(solver, "gap_acceleration", gaps)
        monkeypatch.setattr(solver, "_takes_all", saying(takes_all))
        before = system.contact_int.copy()
        evaluate = Played(system, *statuses, OK)
        kept = solver.share(T, 1, evaluate)
        # whether it would close without
        assert not evaluate.asked or evaluate.asked[0] == [STICK, FREE]
        assert gaps.asked in ([], [(T, 1)])
        if kept:
            assert system.contact_int[1, [MODE, NORMAL_SIGN]].tolist() == [SLIPPING, -1]
            assert system.contact_int[1, SLIP_SIGN] == (5 if tangents == 2 else 1 if along >= 0.0 else -1)
            assert evaluate.asked == [[STICK, FREE], [STICK, SLIPPING]]
            # not twice
            assert not solver.share(T, 1, never)
        else:
            assert system.contact_int.tolist() == before.tolist()
            assert not evaluate.asked or evaluate.asked[-1] == [STICK, mode]
        return kept, len(evaluate.asked)

    assert tried() == (True, 2)
    assert tried((NO_FORCE,)) == tried(gap=0.0) == tried(gap=math.nan) == (False, 2)
    assert tried((OK, NO_FORCE)) == (False, 3)
    assert tried(margin=-1e-3) == (False, 3)
    assert tried(takes_all=True) == (False, 3)
    # no other contact would pull then, but for round-off
    assert tried(other=-0.9e-10) == (True, 2)
    assert tried(other=-1.1e-10) == (False, 3)
    assert tried(viscous=0.0) == (False, 0)


def test_accelerations_of_gaps():
    system = Items(3)
    for status in (OK, EVENT, LOCATION_FAILED):
        system.evaluate_kinematics = saying(status)
        found = ModeSolver(system).gap_acceleration(T, 1)
        if status == OK:
            assert found == pytest.approx(system.rows[1, 2] @ system.acceleration + system.bias[1, 2], rel=1e-14)
        else:
            assert math.isnan(found)
        assert system.evaluate_kinematics.asked == [(T,)]


# ---------------------------------------------------------------------------------------------- slip that passes


def test_what_steps_may_be_wrong_by():
    """1e-3 of a velocity, or ten thousand absolute tolerances of every coordinate, in the mass metric."""
    system = Items(1)
    solver = ModeSolver(system)
    system.scale[:] = 1e-8, 1e-12
    assert solver.negligible(3.0) == pytest.approx(3e-3, rel=1e-12)
    system.scale[0] = 1e-2
    assert solver.negligible(3.0) == pytest.approx(3e-2, rel=1e-12)
    system.scale[1] = 1e-4
    assert solver.negligible(3.0) == pytest.approx(math.sqrt((system.factor**2).sum()), rel=1e-12)
    before = np.random.default_rng(0).normal(size=6)
    change, size = solver.taken_from(before)
    mass = system.factor.T @ system.factor
    d = system.v - before
    assert change == pytest.approx(math.sqrt(d @ mass @ d), rel=1e-12)
    assert size == pytest.approx(math.sqrt(before @ mass @ before), rel=1e-12)


def sticking(seed, nv=8):
    """Two contacts of two tangents and one of one, after an evaluation in stick, whose forces end all slip."""
    system = Items(3, nv=nv, seed=seed)
    system.contact_int[2, TANGENTS] = 1
    system.contact_real[:, LENGTH] = 0.5, 2.0, 4.0
    # of any size
    system.rows[0] *= 0.05
    system.v *= 0.05
    index = [(0, 2), (0, 0), (0, 1), (1, 2), (1, 0), (1, 1), (2, 2), (2, 0)]
    system.slip[:] = 0.0
    system.acceleration[:] = np.linalg.lstsq(
        np.array([system.rows[c, row] for c, row in index]), [-system.bias[c, row] for c, row in index]
    )[0]
    system.list_rows(index)
    return system


@SEEDS
def test_stick_that_would_take_too_much(seed):
    """The least change of velocity that ends the slip of these contacts, and leaves other rows alone, by its energy."""
    rng = np.random.default_rng(seed)
    system = sticking(seed, nv=9)
    solver = ModeSolver(system)
    assert solver._unheld([0, 1, 2]) is None
    speed = np.linalg.norm(system.factor @ system.v)
    allowed = solver.negligible(speed)
    for c, component in ((0, 0), (1, 1), (2, 0)):
        for given in ([0, 1, 2], [c]):
            system.slip[:] = 0.0
            system.slip[c] = system.basis[c, component] - 0.2 * system.basis[c, 2]
            residual = np.zeros(8)
            residual[[(0, 2), (0, 0), (0, 1), (1, 2), (1, 0), (1, 1), (2, 2), (2, 0)].index((c, component))] = 1.0
            needed = np.linalg.norm(np.linalg.pinv(system.whitened_rows[:8]) @ residual)
            slip = system.slip[c] * allowed / needed
            system.slip[c] = 0.99 * slip
            assert solver._unheld(given) is None
            system.slip[c] = 1.01 * slip
            assert solver._unheld(given) == c
            assert solver._unheld([i for i in range(3) if i != c]) is None
    # whichever moves most for its row
    system.slip[:] = rng.normal(size=(3, 3))
    found = solver._unheld([0, 1, 2])
    lengths = np.linalg.norm(system.whitened_rows[:8], axis=1)
    sizes = {
        c: max(
            abs(system.basis[c, row] @ system.slip[c]) / lengths[r]
            for r, (i, row) in enumerate(system.row_index[:8].tolist())
            if i == c and row < system.contact_int[c, TANGENTS]
        )
        for c in range(3)
    }
    assert found == max(sizes, key=sizes.get)
    # states at rest or worse are not looked at
    assert solver._unheld([]) is None
    system.counters["row_count"], kept = 0, system.v.copy()
    assert solver._unheld([0, 1, 2]) is None
    system.counters["row_count"] = 8
    for v in (0.0, math.nan):
        system.v[:] = v
        assert solver._unheld([0, 1, 2]) is None
    system.v[:] = kept
    assert solver._unheld([0, 1, 2]) == found


@SEEDS
def test_stick_that_no_force_brings_about(seed):
    """Of dependent rows: what is left of the relative acceleration, by what forces and turning do to it; which of them
    the evaluation left out does not matter."""
    for c in range(3):
        system, normals = sticking(seed), np.random.default_rng(seed).uniform(0.5, 1.0, 3)
        solver = ModeSolver(system)
        for numbers in (system.rows, system.bias):
            numbers[c, 0] = normals @ numbers[:, 2]
        system.list_rows([(0, 2), (0, 0), (0, 1), (1, 2), (1, 0), (1, 1), (2, 2), (2, 0)])
        system.counters["row_rank"] = 7
        assert solver._unheld([0, 1, 2]) is None
        sizes = np.abs(system.rows[c])
        rate = (sizes @ np.abs(system.free_acceleration) + np.abs(system.bias[c])).max()
        rate += (sizes @ np.abs(system.v)).max() ** 2 / system.contact_real[c, LENGTH]
        kept = system.bias[c, 0]
        for part, held in ((0.97e-6, True), (1.03e-6, False)):
            for sign in (-1.0, 1.0):
                system.bias[c, 0] = kept + sign * part * rate
                assert solver._unheld([0, 1, 2]) == (None if held else c)
                assert solver._unheld([i for i in range(3) if i != c]) is None
        # independent ones are held exactly, whatever round-off says
        system.counters["row_rank"] = 8
        assert solver._unheld([0, 1, 2]) is None
        system.bias[c, 0] = kept
    # round-off of rows that are zero, by the arms of 2 m and of at least one
    system.counters["row_rank"] = 7
    for c, arm in ((0, 1.0), (1, 2.0)):
        rounding = 1e-13 * arm * (np.abs(system.free_acceleration).max() + np.abs(system.v).max() ** 2)
        rows, bias = system.rows[c].copy(), system.bias[c].copy()
        system.rows[c] = system.bias[c] = 0.0
        for part, held in ((0.97, True), (1.03, False)):
            system.bias[c, 1] = part * rounding
            assert solver._unheld([c]) == (None if held else c)
        system.rows[c], system.bias[c] = rows, bias


def test_rows_that_move_nothing_do_not_count(monkeypatch):
    system = sticking(1, nv=9)
    solver = ModeSolver(system)
    system.slip[0] = 10.0 * system.basis[0, 0]
    assert solver._unheld([0]) == 0
    # a row without effect, and one that is not finite
    for value in (0.0, math.inf):
        system.whitened_rows[1] = value
        assert solver._unheld([0, 1]) is None


def test_what_cannot_stick_slides_on_without_friction(monkeypatch):
    system = Items(3)
    system.contact_int[2, TANGENTS] = 1
    solver = ModeSolver(system)
    unheld = saying(1, 2, None)
    monkeypatch.setattr(solver, "_unheld", unheld)
    evaluate = Played(system, EVENT)
    passing = solver._let_pass(T, [0, 1, 2], evaluate)
    rates = [system.rows[c, :n] @ system.acceleration + system.bias[c, :n] for c, n in ((1, 2), (2, 1))]
    assert passing == pytest.approx({1: np.linalg.norm(rates[0]), 2: abs(rates[1][0])})
    slides_along(system, 1, rates[0])
    assert system.contact_int[2, [MODE, SLIP_SIGN]].tolist() == [SLIPPING, math.copysign(1, rates[1][0])]
    assert unheld.asked == [([0, 1, 2],), ([0, 2],), ([0],)]
    frictionless = [[STICK, FRICTIONLESS, STICK], [STICK, SLIPPING, STICK], [STICK, SLIPPING, FRICTIONLESS]]
    assert evaluate.asked == [*frictionless, [STICK, SLIPPING, SLIPPING]]
    # what cannot be evaluated sticks
    system = Items(2)
    solver = ModeSolver(system)
    monkeypatch.setattr(solver, "_unheld", saying(1))
    evaluate = Played(system, NO_FORCE, OK)
    assert solver._let_pass(T, [0, 1], evaluate) == {}
    assert evaluate.asked == [[STICK, FRICTIONLESS], [STICK, STICK]]


# ---------------------------------------------------------------------------------------------- the decision


def deciding(monkeypatch, loaded=True, passing=None, holds=True, chosen=False, status=7):
    system = Items(3, seed=2)
    system.contact_int[:, [MODE, FROZEN]] = SLIPPING, 1
    solver = ModeSolver(system)
    answers = {"_load_all": loaded, "_let_pass": passing or {}, "_holds": holds, "redistribute": chosen}
    for name, answer in answers.items():
        monkeypatch.setattr(solver, name, saying(answer))
    solved = saying(Decision(status, {0: 1.0, 2: 2.0}))
    monkeypatch.setattr(solver, "_solve", solved)
    return system, solver, solved


def test_what_sticks_needs_no_cones(monkeypatch):
    """An evaluation that is known is not made again, unless loads or the choice of forces were others."""
    for loaded, reference, status, times in (
        (True, 0.0, OK, 0), (True, 0.0, None, 1), (False, 0.0, OK, 1), (True, 1.0, OK, 1),
    ):  # fmt: skip
        system, solver, solved = deciding(monkeypatch, loaded)
        system.scalars["has_reference"], solver.proved = reference, True
        evaluate = Played(system)
        decision = solver.resolve_modes(T, [0, 2], evaluate, status=status)
        assert (decision.status, decision.started, decision.forces) == (OK, {}, None)
        assert len(evaluate.asked) == times
        assert not solved.asked
        assert not solver.proved
        assert system.scalars["has_reference"] == 0.0
        assert system.contact_int[:, MODE].tolist() == [STICK, SLIPPING, STICK]
        assert system.contact_int[:, FROZEN].tolist() == [0, 1, 0]


@pytest.mark.parametrize(
    ("status", "beyond", "holds", "chosen", "lost", "solves"),
    [
        (OK, None, False, False, 0, False),
        (EVENT, None, True, False, 0, False),
        (EVENT, None, False, True, 0, False),
        (EVENT, None, False, False, 0, True),
        (NO_FORCE, None, True, True, 0, True),
        (OK, 1, True, True, 0, True),
        (OK, None, True, True, 1, True),
        (EVENT, None, True, True, 1, True),
    ],
)
def test_when_cones_decide(status, beyond, holds, chosen, lost, solves, monkeypatch):
    system, solver, solved = deciding(monkeypatch, holds=holds, chosen=chosen)
    system.counters["lost_positivity"] = lost
    system.event_functions[:, FRICTION_EVENT] = 0.0, 1.0, -0.1
    evaluate = Played(system, status)
    decision = solver.resolve_modes(T, [0], evaluate, beyond)
    if not solves:
        assert (decision.status, solved.asked) == (status, [])
        return
    assert solved.asked == [(T, evaluate, {}, {})]
    # what has exceeded its limit is held by sliding friction
    assert solver._limits.tolist() == [0.5, 0.5 if beyond is None else 0.3, 0.3]
    assert decision.status == 7
    # of what was said to begin, that which slides
    assert decision.started == {2: 2.0}


def test_what_passes_is_no_longer_undecided(monkeypatch):
    system, solver, solved = deciding(monkeypatch, passing={0: 0.7}, holds=False, status=OK)
    evaluate = Played(system, OK, EVENT)
    decision = solver.resolve_modes(T, [0, 1], evaluate)
    assert solved.asked == [(T, evaluate, {0: 0.7}, {})]
    assert len(evaluate.asked) == 2
    assert decision.started == {2: 2.0}
    system, solver, solved = deciding(monkeypatch, passing={2: 0.7})
    decision = solver.resolve_modes(T, [1, 2], Played(system))
    assert (decision.status, decision.started, solved.asked) == (OK, {2: 0.7}, [])
    # where that leaves no forces, it is decided with the others
    system, solver, solved = deciding(monkeypatch, passing={0: 0.7}, holds=False)
    evaluate = Played(system, OK, EVENT, OK)
    solver.resolve_modes(T, [0, 1], evaluate)
    assert solved.asked == [(T, evaluate, {0: 0.7}, {}), (T, evaluate, {}, {})]
    assert len(evaluate.asked) == 3 and system.contact_int[0, MODE] == STICK
    # what begins beside it is decided with it
    system, solver, solved = deciding(monkeypatch, passing={1: 0.7}, holds=False)
    solver.resolve_modes(T, [0], Played(system, EVENT))
    assert solved.asked[0][2] == {1: 0.7}


def test_what_cannot_be_evaluated_is_not_decided(monkeypatch):
    for passing, statuses in (({}, (LOCATION_FAILED,)), ({0: 0.7}, (OK, LOCATION_FAILED))):
        system, solver, solved = deciding(monkeypatch, passing=passing)
        evaluate = Played(system, *statuses)
        decision = solver.resolve_modes(T, [0, 1], evaluate)
        assert (decision.status, decision.started, solved.asked) == (LOCATION_FAILED, {}, [])
        assert len(evaluate.asked) == len(statuses)


def test_viscous_friction_of_what_opens_takes_a_part(monkeypatch):
    """What opens against its own viscous friction, and would close again, is held up by a part of it, or opens; what
    needs more carries a load again. Each time all modes are what they were; where it does not end it opens."""

    def tried(*answers, takes_all=False, gaps=(-1.0, -1.0)):
        """answers: contacts that open, in each solution, None without one."""
        system = Items(3, 1)
        solver = ModeSolver(system)
        system.contact_int[1:3, MODE], system.contact_real[1:3, [VISCOUS, MU]] = FRICTIONLESS, [0.1, 0.0]
        before, asked = system.contact_int.copy(), []

        def solve(t, evaluate, ahead):
            asked.append(system.contact_int[1:3, NORMAL_SIGN].tolist())
            others = [MODE, NORMAL_SIGN, SLIP_SIGN]
            assert np.delete(system.contact_int, others, 1).tolist() == np.delete(before, others, 1).tolist()
            opened = answers[min(len(asked), len(answers)) - 1]
            if opened is None:
                return Decision(NO_FORCE)
            system.contact_int[opened, MODE] = FREE
            system.joint_int[:] = 6
            return Decision(OK, opened=list(opened))

        monkeypatch.setattr(solver, "_solve_contacts", solve)
        monkeypatch.setattr(solver, "_takes_all", lambda c: takes_all)
        monkeypatch.setattr(solver, "gap_acceleration", lambda t, c: gaps[c - 1])
        monkeypatch.setattr(solver, "_align", saying(True))
        return solver._solve(T, Played(system), {}).status, system.modes.tolist(), asked

    all_of_it, first, both = [1, 1], [-1, 1], [-1, -1]
    assert tried([]) == (OK, [STICK, FRICTIONLESS, FRICTIONLESS], [all_of_it])
    # without viscous friction it opens at once, as does what would not close again
    assert tried([0]) == (OK, [FREE, FRICTIONLESS, FRICTIONLESS], [all_of_it])
    assert tried([1, 2], gaps=(0.0, 0.1)) == (OK, [STICK, FREE, FREE], [all_of_it])
    assert tried([1], []) == (OK, [STICK, SLIPPING, FRICTIONLESS], [all_of_it, first])
    assert tried([1, 2], [2]) == (OK, [STICK, SLIPPING, FREE], [all_of_it, both])
    assert tried([1, 2], [2], gaps=(-1.0, 0.0)) == (OK, [STICK, SLIPPING, FREE], [all_of_it, first])
    # neither a part nor all, and no solution with a part
    assert tried([1], [], [1], takes_all=True) == (OK, [STICK, FREE, FRICTIONLESS], [all_of_it, first, all_of_it])
    assert tried([1], None, [1]) == (OK, [STICK, FREE, FRICTIONLESS], [all_of_it, first, all_of_it])
    assert tried(None)[::2] == (NO_FORCE, [all_of_it])
    # no slip that goes where it is said to
    solver = ModeSolver(Items(1))
    monkeypatch.setattr(solver, "_solve_contacts", saying(Decision(OK)))
    monkeypatch.setattr(solver, "_align", saying(False))
    assert solver._solve(T, never, {}).status == NO_FORCE


def test_slip_turns_with_loads_that_are_chosen_anew(monkeypatch):
    def tried(aligned, holds, chosen, status=EVENT, slipping=True):
        system = Items(3)
        solver = ModeSolver(system)
        system.contact_int[1, MODE] = SLIPPING if slipping else STICK
        system.contact_real[:, SLIP_RATE] = 0.4
        align = saying(*aligned)
        monkeypatch.setattr(modes, "align_slips", align)
        monkeypatch.setattr(solver, "_holds", saying(*holds))
        monkeypatch.setattr(solver, "redistribute", saying(*chosen))
        decision = Decision(status, {0: 3.0, 1: 5.0})
        found = solver._align(T, decision, never)
        assert all(asked[2] == [1] for asked in align.asked)
        assert decision.started == {0: 3.0, 1: 0.4 if align.asked else 5.0}
        return found, len(align.asked)

    assert tried([True], [True], [True]) == (True, 1)
    assert tried([True], [False], [False]) == (True, 1)
    assert tried([False], [False], [True]) == (False, 1)
    assert tried([True], [False, True], [True]) == (True, 2)
    assert tried([True], [False], [True]) == (True, 4)
    assert tried([True, False], [False], [True]) == (False, 2)
    assert tried([False], [False], [True], status=NO_FORCE) == (True, 0)
    assert tried([False], [False], [True], slipping=False) == (True, 0)


# ---------------------------------------------------------------------------------------------- solutions of cones


def solved_cones(monkeypatch, forces, velocities, kinds, statuses=(OK,), holds=True, chosen=True, residual=3e-15):
    """Contacts 1 .. 6 of seven, of which 1, 2, 3 are undecided, 5 is bilateral and 6 ideal; joint coordinates at no
    end, at the lower and at the upper one; two resistances."""
    system = Items(7, 3, 2)
    system.contact_int[0, MODE], system.contact_int[[4, 5], MODE] = FREE, SLIPPING
    system.contact_int[10:, OWNER] = 1, 2
    system.contact_int[10:, MODE] = STICK
    system.joint_int[:, JOINT_END] = 0, -1, 1
    system.joint_real[:, [LOW_FORCE, HIGH_FORCE]] = -0.2, 0.3
    system.contact_int[7:10, MODE] = FRICTIONLESS
    system.contact_real[6, MU] = math.inf
    system.contact_real[:, SLIP_RATE] = 1.0
    solver = ModeSolver(system)
    solver._limits[:] = system.contact_real[:, MU]
    monkeypatch.setattr(solver, "_pose", saying("posed"))
    solution = saying(ModeSolution(forces.copy(), velocities.copy(), np.array(kinds), residual, 2e12))
    monkeypatch.setattr(solver, "_solve_posed", solution)
    monkeypatch.setattr(solver, "_holds", saying(holds))
    monkeypatch.setattr(solver, "redistribute", saying(chosen))
    kept = saying(None)
    monkeypatch.setattr(solver, "_keep_solution", kept)
    evaluate = Played(system, *statuses)
    decision = solver._solve_contacts(T, evaluate)
    return system, solver, decision, kept, evaluate, solution


OPEN, SLIP, HOLD = cone.OPEN, cone.SLIP, cone.STICK


def test_modes_of_a_solution(monkeypatch):
    """What moves by less than 1e-13 of the largest acceleration, here 0.2, rests; or by less than ten residuals."""
    rng = np.random.default_rng(3)
    forces, velocities = rng.normal(size=(12, 3)), np.zeros((12, 3))
    kinds = np.array([HOLD, SLIP, SLIP, HOLD, OPEN, OPEN, SLIP, SLIP, OPEN, OPEN, SLIP, SLIP])
    velocities[1], velocities[2], velocities[3] = [0.4, 0.1, 0.0], [0.3, -0.4, 0.0], [0.5, 0.5, 0.0]
    velocities[4], velocities[5], velocities[6] = [9.0, 9.0, 0.19], [0.0, 0.0, 0.21], [0.0, -0.3, 0.0]
    velocities[7:10, 2] = -0.25, 0.21, -0.19
    velocities[10, :2], velocities[11, :2] = [0.15, 0.15], [0.1, 0.0]
    system, solver, decision, kept, evaluate, _ = solved_cones(monkeypatch, forces, velocities, kinds)
    before = Items(7, 3, 2)
    # contacts 1, 2 and 6 slip; contact 3 only holds, at its limit or not
    slides_along(system, 1, velocities[1, :2])
    slides_along(system, 2, velocities[2, :2])
    slides_along(system, 6, velocities[6, :2])
    slides_along(system, 10, velocities[10, :2])
    rates = {1: math.hypot(0.4, 0.1), 2: 0.5, 6: 0.3, 10: 0.15 * math.sqrt(2.0)}
    assert decision.started == pytest.approx(rates)
    assert system.contact_int[:7, MODE].tolist() == [FREE, SLIPPING, SLIPPING, STICK, SLIPPING, FREE, SLIPPING]
    assert system.contact_int[11, MODE] == STICK
    assert decision.opened == [5]
    # the one that stays closed without leaving carries nothing
    assert system.contact_int[:7, NORMAL_SIGN].tolist() == [1, 1, 1, 1, 0, 1, 1]
    # friction gives way along, an end away from it
    assert system.held() == [2]
    assert system.joint_int[:, JOINT_SIGN].tolist() == [-1, 1, 0]
    assert (decision.status, decision.residual) == (OK, 3e-15)
    np.testing.assert_array_equal(decision.forces, forces)
    assert solver.worst_residual == 3e-15
    assert len(evaluate.asked) == 1
    assert not kept.asked
    assert system.contact_real[0].tolist()[:4] == before.contact_real[0].tolist()[:4]
    # the other way round; and what rests at its limit
    velocities[7:10, 2] = 0.25, 0.19, -0.21
    velocities[1, :2] = velocities[10, :2] = 0.1
    system, _, decision, *_ = solved_cones(monkeypatch, forces, velocities, kinds)
    assert system.joint_int[:, JOINT_SIGN].tolist() == [1, 0, -1]
    assert system.held() == [1]
    assert sorted(decision.started) == [2, 6]
    assert system.contact_int[[1, 10], MODE].tolist() == [STICK, STICK]
    # or by less than ten times what the solution is known to
    system, _, decision, *_ = solved_cones(monkeypatch, forces, velocities, kinds, residual=2.4e-14)
    assert sorted(decision.started) == [2]
    # what slides already goes on as it does
    velocities[7, 2], kinds[4], velocities[4] = 0.19, SLIP, [0.5, 0.6, 0.0]
    system, _, decision, *_ = solved_cones(monkeypatch, forces, velocities, kinds)
    assert system.held() == [0, 1]
    assert system.contact_int[4, [MODE, FROZEN]].tolist() == [SLIPPING, 0]
    assert sorted(decision.started) == [2, 6]


@pytest.mark.parametrize("load", [-2.0, 0.9e-10, -0.9e-10, 3.0])
@pytest.mark.parametrize("pattern", [ON_SURFACE, ON_CURVE])
def test_normal_forces_of_bilateral_contacts_have_the_solutions_sign(pattern, load, monkeypatch):
    """Beyond round-off; on a curve a direction."""
    system = Items(2)
    solver = ModeSolver(system)
    system.contact_int[1, [PATTERN, UNILATERAL, NORMAL_SIGN]], system.tau[:] = [pattern, 0, 7], 10.0
    system.contact_real[1, [NORMAL_1, NORMAL_2]] = 0.6, 0.8
    forces = np.array([[0.0, 0.0, -9.0], [5.0, 0.75 * load, load]])
    solution = ModeSolution(forces, np.zeros((2, 3)), np.array([HOLD, HOLD]), 0.0, 1.0)
    monkeypatch.setattr(solver, "_pose", saying(None))
    monkeypatch.setattr(solver, "_solve_posed", saying(solution))
    solver._solve_contacts(T, Played(system))
    told = abs(load) > 1e-3
    sign = 7 if pattern == ON_CURVE or not told else math.copysign(1.0, load)
    assert system.contact_int[:, NORMAL_SIGN].tolist() == [1, sign]
    direction = math.copysign(1.0, load) * np.array([0.8, 0.6]) if pattern == ON_CURVE and told else [0.6, 0.8]
    if pattern == ON_SURFACE or told or abs(load) * 1.25 < 1e-10:
        assert system.contact_real[1, [NORMAL_1, NORMAL_2]] == pytest.approx(direction)


@pytest.mark.parametrize(
    ("status", "holds", "chosen", "keeps"),
    [
        (EVENT, False, False, True),
        (EVENT, True, False, False),
        (OK, False, True, False),
        (NO_FORCE, False, False, False),
    ],
)
def test_forces_on_rims_are_kept(status, holds, chosen, keeps, monkeypatch):
    """Where there are no others inside, those of the solution; and where under others slip would go back."""
    forces = np.random.default_rng(4).normal(size=(12, 3))
    kinds = [HOLD] * 12
    decision, kept, evaluate = solved_cones(monkeypatch, forces, np.zeros((12, 3)), kinds, (status,), holds, chosen)[
        2:5
    ]
    assert decision.status == status
    assert len(kept.asked) == keeps
    if keeps:
        t, found, function = kept.asked[0]
        assert (t, function) == (T, evaluate)
        assert found == pytest.approx(forces, abs=1e-14)
    if chosen and not holds:
        monkeypatch.setattr(ModeSolver, "_going_back", saying([0]))
        made = solved_cones(monkeypatch, forces, np.zeros((12, 3)), kinds, (status,), holds, chosen)
        assert len(made[3].asked) == 1


def test_what_begins_to_slip_and_goes_back():
    system = Items(3)
    solver = ModeSolver(system)
    system.free_acceleration[:] = 0.0, 1.0, -10.0, 0.0, 0.0, 0.0
    system.contact_int[:, MODE] = SLIPPING, STICK, SLIPPING
    system.contact_real[:, SLIP_RATE] = -0.9e-10, -1.0, -1.1e-10
    assert solver._going_back(Decision(OK, {0: 1.0, 1: 1.0})) == []
    assert solver._going_back(Decision(OK, {0: 1.0, 2: 1.0})) == [2]


def test_what_gives_way_has_sliding_friction(monkeypatch):
    """What slips beyond its sliding limits: once more, with those. What does not stick has none to lose."""
    system = Items(4)
    solver = ModeSolver(system)
    system.contact_int[3, MODE] = SLIPPING
    solver._limits[:] = 0.5, 0.5, 0.3, 0.5
    zero = np.zeros((4, 3))
    answers = [[SLIP, HOLD, SLIP, SLIP], [SLIP, SLIP, HOLD, SLIP], [SLIP, SLIP, HOLD, SLIP]]
    limits = []

    def solve(*arguments):
        assert arguments == ("posed", [])
        limits.append(solver._limits.tolist())
        return ModeSolution(zero.copy(), zero.copy(), np.array(answers[len(limits) - 1]), 0.0, 1.0)

    posed = saying("posed")
    monkeypatch.setattr(solver, "_pose", posed)
    monkeypatch.setattr(solver, "_solve_posed", solve)
    solver._solve_contacts(T, Played(system))
    # with the limits that the slip found so far has left
    assert posed.asked == [([0, 1, 2, 3], [], {}, False)] * 3
    assert limits == [[0.5, 0.5, 0.3, 0.5], [0.3, 0.5, 0.3, 0.5], [0.3, 0.3, 0.3, 0.5]]
    monkeypatch.setattr(solver, "_solve_posed", saying(None))
    decision = solver._solve_contacts(T, never)
    assert (decision.status, decision.forces) == (NO_FORCE, None)


@SEEDS
def test_a_solution_as_the_choice_of_forces(seed):
    """Turning that slides has none to choose; of what is held up by friction that is chosen."""
    rng = np.random.default_rng(seed)
    system, solver = made(rng, ideal=True)
    system.contact_int[2, MODE] = SLIPPING
    system.reference, system.scalars = np.ones((10, 3)), record_of(SCALARS, 1.0)
    system.reference_start, system.reference_slope = np.ones((10, 3)), np.ones((2, 30, 5))
    forces = rng.normal(size=(10, 3))
    asked = []
    system.closed = lambda: [0, 1, 2, 3, 4]
    solver._keep_solution(T, forces, asked.append)
    expected = forces.copy()
    expected[9] = 0.0
    expected[2, 2] = math.hypot(*forces[2, :2])
    assert system.reference == pytest.approx(expected, abs=1e-14)
    assert (system.reference_start == system.reference).all()
    assert not system.reference_slope.any()
    assert system.scalars["has_reference"] == 1.0
    assert asked == [T]


# ---------------------------------------------------------------------------------------------- redundant forces


def test_cones_of_forces():
    """Of unilateral contacts, with their static friction where they stick, of bilateral ones' friction under the
    present sign, of resistances by their contact's load, and the bounds of held coordinates."""
    system = Items(7, 3, 2)
    system.contact_int[0, MODE], system.contact_int[1, MODE] = FREE, SLIPPING
    system.contact_int[3, TANGENTS], system.contact_real[4, MU_STATIC] = 1, math.inf
    system.contact_int[5:7, UNILATERAL], system.contact_int[6, PATTERN] = 0, ON_CURVE
    system.contact_int[6, TANGENTS] = 1
    system.force[5] = 1.0, 1.0, -2.0
    system.joint_int[:, JOINT_END] = 0, -1, 1
    system.joint_real[:, LOW_FORCE], system.joint_real[:, HIGH_FORCE] = [-0.2, -0.3, -0.4], [0.5, 0.6, 0.7]
    system.contact_int[7:10, MODE] = FRICTIONLESS
    system.contact_int[10:, OWNER] = 2, 5
    system.contact_int[11, TANGENTS] = 1
    system.contact_real[10:, MU_STATIC] = 0.02, 0.03
    # friction along an axis that is none of the basis
    system.contact_int[2, ANISOTROPIC] = 1
    system.contact_real[2, [SCALING_11, SCALING_12, SCALING_22]] = 2.0, 0.3, 1.5
    stretched = np.linalg.inv([[2.0, 0.3], [0.3, 1.5]])
    listed = [(1, 2), (2, 2), (2, 0), (2, 1), (3, 2), (3, 0), (4, 2), (4, 0), (4, 1), (5, 2), (5, 0), (5, 1), (6, 2)]
    listed += [(6, 1), (6, 0), (7, 2), (8, 2), (9, 2), (10, 0), (10, 1), (11, 0)]
    place = {row: r for r, row in enumerate(listed)}
    expected = [
        Cone(place[1, 2], 1.0, 0.0), Cone(place[2, 2], 0.5, 0.0, (place[2, 0], place[2, 1])),
        Cone(place[3, 2], 0.5, 0.0, (place[3, 0],)), Cone(place[4, 2], 1.0, 0.0),
        Cone(place[5, 2], -0.5, 0.0, (place[5, 0], place[5, 1])),
        Cone(place[2, 2], 0.02, 0.0, (place[10, 0], place[10, 1])), Cone(place[5, 2], -0.03, 0.0, (place[11, 0],)),
        Cone(place[7, 2], 1.0, 0.2), Cone(place[7, 2], -1.0, 0.5), Cone(place[8, 2], 1.0, 0.3),
        Cone(place[9, 2], -1.0, 0.7),
    ]  # fmt: skip

    parts, offsets = ModeSolver(system)._cones(np.array(listed))
    assert offsets.reshape(-1, 3).tolist() == [[wanted.offset, 0.0, 0.0] for wanted in expected]
    for (along, *tangents), wanted in zip(parts.reshape(-1, 3, len(listed)), expected, strict=True):
        assert along.tolist() == (wanted.factor * np.eye(len(listed))[wanted.normal]).tolist()
        scaling = (stretched if wanted is expected[1] else np.eye(2))[:, : len(wanted.tangents)]
        assert np.array(tangents) == pytest.approx(scaling @ np.eye(len(listed))[list(wanted.tangents)], abs=1e-15)
    for fewer, i in ((1, 11), (2, 10)):
        system.contact_int[i, MODE] = SLIPPING
        assert len(ModeSolver(system)._cones(np.array(listed))[1]) == 3 * (len(expected) - fewer)


def reference_at(system, index, forces):
    """The reference that an evaluation takes where these forces are the nearest to its start, from its kernel."""
    made = made_system(system.nc, system.ng, system.nr, system.nv)
    for name in ("reference_start", "reference_slope"):
        getattr(made, name)[:] = getattr(system, name)
    made.row_index[: len(index)], made.multipliers[: len(index)] = index, forces
    part(equations.move_reference, SYSTEM)(made, len(index))
    return made.reference[index[:, 0], index[:, 1]]


@SEEDS
def test_a_choice_is_followed_along_its_tangent(seed):
    """As the forces nearest to it change."""
    rng = np.random.default_rng(seed)
    system = Items(3, nv=5, seed=seed)
    solver = ModeSolver(system)
    index = np.array([(0, 2), (0, 0), (1, 2), (2, 2), (2, 0), (2, 1)])
    basis = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    span, null = basis[:, :4], basis[:, 4:]
    choice = Choice(rng.normal(size=6), null @ rng.normal(size=(2, 4)), span)
    solver._follow(index, [choice])
    assert system.scalars["has_reference"] == 1.0
    assert reference_at(system, index, choice.forces) == pytest.approx(choice.forces, abs=1e-15)
    change = rng.normal(size=4)
    # whatever these have of what moves nothing
    nearest = choice.forces + span @ change + null @ rng.normal(size=2)
    moved = choice.forces + (span + choice.slope) @ change
    assert reference_at(system, index, nearest) == pytest.approx(moved, abs=1e-12)
    solver._take_reference(None)
    assert system.scalars["has_reference"] == 0.0
    # one that stays
    forces = rng.normal(size=system.reference.shape)
    solver._take_reference(forces)
    assert system.reference.tolist() == forces.tolist()
    assert reference_at(system, index, nearest) == pytest.approx(forces[index[:, 0], index[:, 1]], abs=1e-15)


def redundant():
    """A body with one velocity on two contacts without friction and one that slides."""
    system = Items(3, nv=2)
    system.factor = system.inverse = np.eye(2)
    system.contact_int[:2, MODE] = FRICTIONLESS
    system.contact_int[2, MODE] = FREE
    system.rows[:] = 0.0
    system.rows[0, 2] = system.rows[1, 2] = [1.0, 0.0]
    system.force[:] = 0.0
    system.force[:2, 2] = 1.0, 3.0
    system.list_rows([(0, 2), (1, 2)])
    return system, ModeSolver(system)


def test_redundant_forces_are_chosen_anew(monkeypatch):
    """The central ones are those in the middle."""
    system, solver = redundant()
    system.free_acceleration[:] = -4.0, 0.0
    system.bias[:] = 0.0
    monkeypatch.setattr(solver, "_holds", saying(True))
    assert solver.redistribute(T, Played(system, EVENT))
    assert (solver.redistributions, solver.redundant) == (1, True)
    # Newton's last step is that by which the cost falls by 1e-9
    assert system.reference_start[:2, 2] == pytest.approx([2.0, 2.0], abs=1e-4)
    for holds, status in ((False, OK), (True, NO_FORCE)):
        monkeypatch.setattr(solver, "_holds", saying(holds))
        before = [array.copy() for array in (system.reference, system.reference_start, system.reference_slope)]
        system.scalars["has_reference"] = 0.0
        evaluate = Played(system, status)
        assert not solver.redistribute(T, evaluate)
        # the last is one with the forces as they were
        assert len(evaluate.asked) == 2
        for array, value in zip((system.reference, system.reference_start, system.reference_slope), before):
            assert array.tolist() == value.tolist()
        assert system.scalars["has_reference"] == 0.0
        assert solver.redistributions == 1


def test_when_there_is_no_choice(monkeypatch):
    system, solver = redundant()
    system.counters["row_rank"] = 2
    assert not solver.redistribute(T, never)
    system.counters["row_rank"] = 1
    # loads of what slides alone
    unload = saying(True)
    monkeypatch.setattr(solver, "_choose_least_loads", unload)
    for i, mode in ((0, SLIPPING), (1, SLIPPING)):
        system.contact_int[i, MODE] = mode
        assert solver.redistribute(T, never, 1)
        assert unload.asked[-1] == (T, never, [0, 1], 1)
        system.contact_int[i, MODE] = FRICTIONLESS
    assert len(unload.asked) == 2
    # forces that are not finite, or independent after all
    system.whitened_rows[1, 0] = math.nan
    assert not solver.redistribute(T, never)
    system.whitened_rows[1] = 0.3, 1.0
    solver.redundant = True
    assert not solver.redistribute(T, never)
    assert not solver.redundant
    # none inside the cones
    system.whitened_rows[1] = 1.0, 0.0
    monkeypatch.setattr(redistribution, "central_choice", saying(None))
    assert not solver.redistribute(T, never)
    assert solver.redundant


def test_what_friction_holds_up_counts_by_its_friction(monkeypatch):
    """Its multiplier is the length of its tangential force; directions are those of forces where something slides."""
    system, solver = redundant()
    system.contact_int[2, [MODE, TANGENTS]] = STICK, 1
    system.contact_int[1, [MODE, NORMAL_SIGN]] = SLIPPING, -1
    system.force[0], system.force[1], system.force[2] = [5.0, 6.0, 1.0], [3.0, -4.0, 0.0], [0.1, 0.2, 0.3]
    system.rows[2, 0] = [0.0, 1.0]
    system.list_rows([(0, 2), (1, 2), (2, 2), (2, 0)])
    system.counters["row_rank"] = 3
    system.whitened_forces[1] = 2.0, 0.0
    asked = saying(None)
    monkeypatch.setattr(redistribution, "central_choice", asked)
    solver.redistribute(T, never)
    forces, null, parts, _ = asked.asked[0]
    # the row that does nothing has no force to choose
    assert forces.tolist() == [1.0, 5.0, 0.1]
    # one of the two that do the same, the second twice as much
    assert null.shape == (3, 1)
    assert np.abs(np.array([1.0, 2.0, 0.0]) @ null).max() < 1e-12
    assert np.abs(null[2]).max() < 1e-12
    assert parts.shape == (9, 3)
    system.contact_int[1, MODE] = FRICTIONLESS
    solver.redistribute(T, never)
    forces, null, _, _ = asked.asked[1]
    assert forces.tolist() == [1.0, 0.0, 0.1]
    assert np.abs(np.array([1.0, 1.0, 0.0]) @ null).max() < 1e-12


class Feet(Items):
    """Feet of a body that slides, whose least loads are those of least norm among the ones that carry any."""

    def __init__(self, operator, loads):
        n = operator.shape[1]
        super().__init__(n + 1)
        self.operator, self.loads, self.evaluations = operator, loads, 0
        self.contact_int[:, MODE], self.tau[:] = SLIPPING, 1.0
        # one that is held up by friction has none to choose
        self.contact_int[n, NORMAL_SIGN] = -1
        self.event_functions[n, NORMAL_EVENT] = -9.0

    def __call__(self, t):
        n = self.operator.shape[1]
        self.evaluations += 1
        loaded = self.contact_int[:n, NORMAL_SIGN] == 1
        least = np.linalg.pinv(self.operator[:, loaded]) @ self.loads
        if np.abs(self.operator[:, loaded] @ least - self.loads).max() > 1e-9:
            return NO_FORCE
        y = np.linalg.pinv(self.operator[:, loaded].T) @ least
        self.event_functions[:n, NORMAL_EVENT] = -self.operator.T @ y
        self.event_functions[:n, NORMAL_EVENT][loaded] = least
        return EVENT


def test_loads_within_round_off_are_none():
    feet = Feet(np.ones((1, 2)), np.array([1.0]))
    evaluate = Played(
        feet, then=lambda call: feet.event_functions.__setitem__((slice(2), NORMAL_EVENT), [1.0, -0.9e-11])
    )
    assert ModeSolver(feet)._choose_least_loads(T, evaluate, feet.closed(), None)
    assert len(evaluate.asked) == 1


def test_loads_of_bilateral_contacts_have_either_sign():
    """Of three contacts the bilateral one, whose load is negative, takes the other sign; none leaves its load."""
    system = Items(3)
    system.contact_int[:, MODE], system.tau[:], system.contact_int[1, UNILATERAL] = SLIPPING, 1.0, 0

    def then(call):
        system.event_functions[:, NORMAL_EVENT] = system.contact_int[:, NORMAL_SIGN] * [2.0, -3.0, 0.5]

    evaluate = Played(system, EVENT, then=then)
    assert ModeSolver(system)._choose_least_loads(T, evaluate, system.closed(), None)
    assert system.contact_int[:, NORMAL_SIGN].tolist() == [1, -1, 1]
    assert len(evaluate.asked) == 2


@pytest.mark.parametrize("seed", range(12))
def test_least_loads_that_are_not_negative(seed):
    rng = np.random.default_rng(seed)
    n = 5
    operator = np.vstack([np.ones(n), rng.normal(size=(1, n))])
    loads = operator @ rng.uniform(0.0, 1.0, n) * [1.0, 3.0]
    feasible = operator[1].min() < loads[1] / loads[0] < operator[1].max()
    # the least of sum N^2, with the balance weighed a million times
    least = nnls(np.vstack([1e6 * operator, np.eye(n)]), np.append(1e6 * loads, np.zeros(n)))[0]
    feet = Feet(operator, loads)
    solver = ModeSolver(feet)
    feet.scalars["has_reference"] = 1.0
    found = solver._choose_least_loads(T, feet, feet.closed(), None)
    # what is not found leaves the choice as it was
    assert feet.scalars["has_reference"] == (0.0 if found else 1.0)
    signs = feet.contact_int[:, NORMAL_SIGN].tolist()
    assert signs[n] == -1
    if not feasible:
        assert not found
        assert signs[:n] == [1] * n
        assert solver.redistributions == 0
        return
    assert found
    assert solver.redistributions == 1
    assert signs[:n] == (least > 1e-8).astype(int).tolist()
    assert (np.where(np.array(signs[:n]) == 1, feet.event_functions[:n, NORMAL_EVENT], 0.0)) == pytest.approx(
        least, abs=1e-6
    )
    # of one whose load has ended it is known that the sign is the other one; else there is nothing to be had
    wrong = signs.index(1)
    kept = feet.contact_int[:, NORMAL_SIGN].copy()
    assert not solver._choose_least_loads(T, feet, feet.closed(), wrong)
    assert (feet.contact_int[:, NORMAL_SIGN] == kept).all()
    assert not solver._choose_least_loads(T, never, feet.closed(), n)
    if 0 in signs:
        feet.contact_int[signs.index(0), NORMAL_SIGN] = 1
        before, feet.evaluations = solver.redistributions, 0
        assert solver._choose_least_loads(T, feet, feet.closed(), signs.index(0))
        # with that sign at once
        assert (solver.redistributions, feet.evaluations) == (before + 1, 1)
        assert feet.contact_int[:, NORMAL_SIGN].tolist() == signs
