"""Directions of slip, each part alone, on items whose loads are given: what friction does to them is linear."""

from __future__ import annotations

import math

import numpy as np
import pytest
from shared import rotation

from pincontact.dynamics import directions
from pincontact.dynamics.directions import align_slips, freeze_slip, slip_direction
from pincontact.layout import (
    ACROSS_X,
    ANISOTROPIC,
    CONTACT_INTS,
    CONTACT_REALS,
    DIRECTION_X,
    EVENT,
    FROZEN,
    MODE,
    NO_FORCE,
    OK,
    POLYNOMIAL,
    POLYNOMIAL_SIZE,
    SCALING_11,
    SCALING_12,
    SCALING_22,
    SLIP_RATE,
    SLIP_SIGN,
    SLIPPING,
    SPAN,
    START,
    TANGENTS,
)

SEEDS = pytest.mark.parametrize("seed", range(6))


class Sliding:
    """n items that slide under given loads times coefficients, in a mechanism of nv velocities."""

    def __init__(self, rng, n, friction=0.4, stretched=False, nv=5, unit=1.0):
        self.contact_int = np.full((n, CONTACT_INTS), 3, dtype=np.int64)
        # of whatever size: the motions below do not depend on it
        self.contact_real = np.random.default_rng(n).normal(size=(n, CONTACT_REALS))
        self.contact_int[:, [TANGENTS, FROZEN, ANISOTROPIC]] = 2, 0, int(stretched)
        self.contact_real[:, [SCALING_11, SCALING_12, SCALING_22]] = 1.3, 0.2, 0.8
        self.shape = np.array([[1.3, 0.2], [0.2, 0.8]]) if stretched else np.eye(2)
        self.basis = np.array([rotation(rng) for _ in range(n)])
        self.slip = np.zeros((n, 3))
        self.rows = rng.normal(size=(n, 3, nv))
        self.factor = np.tril(0.3 * rng.normal(size=(nv, nv)), -1) + np.diag(rng.uniform(0.7, 1.5, nv))
        self.inverse = np.linalg.inv(self.factor.T @ self.factor)
        self.free = 4.0 * unit * rng.normal(size=nv)
        self.limits = unit * friction * rng.uniform(0.5, 1.0, n)
        self.force, self.relative_acceleration = np.zeros((n, 3)), np.zeros((n, 3))
        self.evaluations, self.status = 0, OK

    def along(self, i):
        return self.basis[i, :2] @ self.contact_real[i, DIRECTION_X : DIRECTION_X + 3]

    def evaluate(self, t):
        assert t == 0.7
        self.evaluations += 1
        pull = np.zeros(len(self.free))
        for i, limit in enumerate(self.limits):
            stretched = self.shape @ self.along(i)
            self.force[i, :2] = -limit * self.shape @ stretched / np.linalg.norm(stretched)
            pull += self.rows[i].T @ self.force[i]
        self.relative_acceleration[:] = self.rows @ (self.free + self.inverse @ pull)
        for i in range(len(self.limits)):
            self.contact_real[i, SLIP_RATE] = self.along(i) @ self.relative_acceleration[i, :2]
        return self.status


@SEEDS
def test_a_frozen_direction(seed):
    """It is a unit vector in the world, what it turns into is across it, and nothing else is touched."""
    rng = np.random.default_rng(seed)
    system = Sliding(rng, 3)
    # of neither the others nor other columns
    integers, numbers = system.contact_int.copy(), system.contact_real.copy()
    direction = 3.0 * rng.normal(size=2)
    for given in (direction, np.zeros(2)):
        freeze_slip(system, 1, given)
        length = np.linalg.norm(given)
        expected = given / length if length > 0.0 else np.array([1.0, 0.0])
        integers[1, [MODE, FROZEN]] = SLIPPING, 1
        world = expected @ system.basis[1, :2]
        numbers[1, DIRECTION_X : DIRECTION_X + 3] = world
        numbers[1, ACROSS_X : ACROSS_X + 3] = np.cross(system.basis[1, 2], world)
        numbers[1, POLYNOMIAL : POLYNOMIAL + POLYNOMIAL_SIZE] = 0.0
        numbers[1, [START, SPAN]] = 0.0, 1.0
        assert system.contact_int.tolist() == integers.tolist()
        assert system.contact_real == pytest.approx(numbers, abs=1e-15)
        # as long as v_c shows none that counts, this is the one
        for slip in (np.zeros(3), rng.normal(size=3)):
            system.slip[1] = slip
            assert slip_direction(system, 1) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize(("along", "sign"), [(-0.3, -1), (0.0, 1), (0.2, 1)])
def test_a_direction_along_one_tangent_is_a_sign(along, sign):
    system = Sliding(np.random.default_rng(0), 2)
    system.contact_int[:, TANGENTS], system.contact_int[:, FROZEN] = 1, 1
    integers, numbers = system.contact_int.copy(), system.contact_real.copy()
    freeze_slip(system, 1, np.array([along, -5.0]))
    integers[1, [MODE, FROZEN, SLIP_SIGN]] = SLIPPING, 0, sign
    assert system.contact_int.tolist() == integers.tolist()
    assert (system.contact_real == numbers).all()
    assert slip_direction(system, 1).tolist() == [sign, 0.0]


@SEEDS
def test_the_direction_of_slip(seed):
    """That of v_c in the tangent plane; the frozen one where it has none; zero where there is none at all."""
    rng = np.random.default_rng(seed)
    system = Sliding(rng, 2)
    system.slip[1] = rng.normal(size=3)
    tangential = system.basis[1, :2] @ system.slip[1]
    assert slip_direction(system, 1) == pytest.approx(tangential / np.linalg.norm(tangential), rel=1e-14)
    kept = system.along(1) / np.linalg.norm(system.along(1))
    system.contact_int[1, FROZEN] = 1
    assert slip_direction(system, 1) == pytest.approx(kept, rel=1e-14)
    system.contact_int[1, FROZEN], system.slip[1] = 0, 0.0
    assert slip_direction(system, 1) == pytest.approx(kept, rel=1e-14)
    system.contact_real[1, DIRECTION_X : DIRECTION_X + 3] = 0.0
    assert slip_direction(system, 1).tolist() == [0.0, 0.0]


def begin(system, angles):
    for i, angle in enumerate(angles):
        freeze_slip(system, i, np.array([math.cos(angle), math.sin(angle)]))


def left(system):
    """What is across the directions of relative accelerations, and along them, in their units."""
    system.evaluate(0.7)
    across, along = [], []
    for i in range(len(system.limits)):
        d, a = system.along(i), system.relative_acceleration[i, :2]
        across.append(abs(d[0] * a[1] - d[1] * a[0]) / np.linalg.norm(a))
        along.append(d @ a / np.linalg.norm(a))
    return max(across), min(along)


@SEEDS
@pytest.mark.parametrize("stretched", [False, True])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_slip_begins_where_its_acceleration_points(n, stretched, seed):
    """By a few evaluations; a direction that is right stays what it is to the last bit."""
    unit = (1e-4, 1.0, 1e4)[seed % 3]
    system = Sliding(np.random.default_rng([n, seed]), n, 0.3 / n, stretched, 3 * n, unit)
    begin(system, np.random.default_rng(seed).uniform(0.0, 6.0, n))
    assert align_slips(system, 0.7, list(range(n)), system.evaluate)
    spent = system.evaluations
    across, along = left(system)
    # to 1e-11 of what cancels, which is some ten times the acceleration
    assert across <= 1e-9
    assert along > 0.0
    # from up to half a turn away, with a round of projections where turns of half a rad lead astray
    assert spent <= 120
    before = system.contact_real.copy()
    system.evaluations = 0
    assert align_slips(system, 0.7, list(range(n)), system.evaluate)
    if system.evaluations == 1:
        assert (system.contact_real == before).all()
    else:
        # within rounding of the bound
        assert system.evaluations <= 2 + 2 * n
    # from near by: differences for n directions, and as many steps as Broyden's method takes from 1e-2 to 1e-11
    angles = [math.atan2(*system.along(i)[::-1]) for i in range(n)]
    begin(system, [angle + 0.01 * (-1) ** i for i, angle in enumerate(angles)])
    system.evaluations = 0
    assert align_slips(system, 0.7, list(range(n)), system.evaluate)
    assert system.evaluations <= 8 + 2 * n


def test_directions_that_are_known():
    """One item, whose mobility is the same in all directions, goes where it would without friction."""
    system = Sliding(np.random.default_rng(4), 1, nv=3)
    system.factor = system.inverse = np.eye(3)
    system.rows[0], system.free = np.eye(3), np.array([-3.0, 4.0, 0.5])
    for push in (1.0, 0.2):
        system.free[:2] *= push
        begin(system, [-0.3])
        assert align_slips(system, 0.7, [0], system.evaluate)
        assert system.along(0) == pytest.approx([-0.6, 0.8], abs=1e-10)
        assert system.contact_real[0, SLIP_RATE] == pytest.approx(5.0 * push - system.limits[0], rel=1e-9)


@SEEDS
def test_without_a_direction_nothing_has_changed(seed):
    """Friction beyond what pushes: slip goes nowhere. The last evaluation is that in the directions from before."""
    system = Sliding(np.random.default_rng(seed), 1, nv=3)
    system.factor = system.inverse = np.eye(3)
    system.rows[0], system.free = np.eye(3), np.array([1.2, 1.6, 0.5])
    system.limits[0] = 2.5
    begin(system, [1.1])
    before = system.contact_real[:, DIRECTION_X:].copy()
    assert not align_slips(system, 0.7, [0], system.evaluate)
    assert system.contact_real[:, DIRECTION_X:] == pytest.approx(before, abs=1e-15)
    kept = system.force.copy()
    system.evaluate(0.7)
    assert (system.force == kept).all()


def test_what_cannot_be_evaluated_has_no_direction():
    system = Sliding(np.random.default_rng(5), 2)
    begin(system, [0.3, 0.4])
    before = system.contact_real[:, DIRECTION_X:].copy()
    for status in (NO_FORCE, EVENT + 1):
        system.status = status
        assert not align_slips(system, 0.7, [0, 1], system.evaluate)
        assert system.contact_real[:, DIRECTION_X:] == pytest.approx(before, abs=1e-15)
    system.status, system.evaluations = EVENT, 0
    assert align_slips(system, 0.7, [0, 1], system.evaluate)
    # what is not frozen is not looked at
    system.contact_int[:, FROZEN] = system.evaluations = 0
    assert align_slips(system, 0.7, [0, 1], system.evaluate)
    assert system.evaluations == 0


@SEEDS
def test_whether_directions_fit(seed):
    """As exactly as round-off of what cancels allows, along and across; without any other evaluation."""
    rng = np.random.default_rng(seed)
    system = Sliding(rng, 2)
    begin(system, [0.4, 2.0])
    given = np.array([system.along(i) for i in range(2)])
    alignment = directions._Alignment(system, 0.7, [0, 1], None)
    scale = np.array([3.0, 0.1])
    alignment._scale = lambda: scale
    for i in range(2):
        for sideways, backwards, fits in (
            (0.9, 0.9, True), (-0.9, -5.0, True), (1.1, 0.0, False), (-1.1, 0.0, False), (0.0, 1.1, False),
        ):  # fmt: skip
            rates, across = np.array([1.0, 1.0]), np.zeros(2)
            rates[i], across[i] = -1e-11 * backwards * scale[i], 1e-11 * sideways * scale[i]

            def evaluate(t, rates=rates, across=across):
                for k, d in enumerate(given):
                    system.relative_acceleration[k, :2] = rates[k] * d + across[k] * np.array([-d[1], d[0]])
                system.contact_real[:, SLIP_RATE] = rates
                return system.status

            alignment.evaluate, system.status = evaluate, EVENT
            assert alignment._fits(given) is fits
            system.status = NO_FORCE
            assert not alignment._fits(given)


@SEEDS
def test_sizes_of_what_cancels(seed):
    """Of an item's relative acceleration, and by Cauchy of what its friction adds: |J M^-1 J^T F| <= |J|_M |F|_M."""
    rng = np.random.default_rng(seed)
    system = Sliding(rng, 3)
    begin(system, rng.uniform(0.0, 6.0, 3))
    system.evaluate(0.7)
    alignment = directions._Alignment(system, 0.7, [0, 2], system.evaluate)
    expected = []
    for i in (0, 2):
        rows, force = system.rows[i, :2], system.force[i, :2]
        gram = rows @ system.inverse @ rows.T
        expected.append(
            np.linalg.norm(system.relative_acceleration[i, :2]) + math.sqrt((force @ gram @ force) * np.trace(gram))
        )
    assert alignment._scale() == pytest.approx(expected, rel=1e-12)
    system.force *= 1e-3
    system.relative_acceleration *= 1e-3
    assert alignment._scale() == pytest.approx(1e-3 * np.array(expected), rel=1e-12)
    system.force[:] = system.relative_acceleration[:] = 0.0
    assert alignment._scale().tolist() == [1.0, 1.0]


@SEEDS
@pytest.mark.parametrize("stretched", [False, True])
@pytest.mark.parametrize("mobile", [0.5, 2.0])
def test_projections_lead_to_the_same_directions(mobile, stretched, seed):
    """Under loads that are given they converge: thirty of them come near from anywhere, and stay at what is right."""
    rng = np.random.default_rng(seed)
    system = Sliding(rng, 2, 0.2, stretched, nv=6)
    for i in range(2):
        # of nearly the same mobility in all directions
        system.rows[i] = 0.2 * system.rows[i]
        system.rows[i, :, 3 * i : 3 * i + 3] += np.eye(3)
    system.rows *= mobile
    system.free /= mobile
    system.limits /= mobile**2
    system.factor = np.eye(6) + 0.1 * np.tril(rng.normal(size=(6, 6)))
    system.inverse = np.linalg.inv(system.factor.T @ system.factor)
    begin(system, rng.uniform(0.0, 6.0, 2))
    alignment = directions._Alignment(system, 0.7, [0, 1], system.evaluate)
    assert alignment.run()
    found = np.array([math.atan2(*system.along(i)[::-1]) for i in range(2)])
    from_afar = alignment._project(found + np.array([1.5, -1.2]))
    assert np.cos(from_afar - found) == pytest.approx(np.ones(2), abs=1e-6)
    stayed = alignment._project(found)
    assert np.cos(stayed - found) == pytest.approx(np.ones(2), abs=1e-12)
    # evaluated in what it returns
    assert system.along(0) == pytest.approx([math.cos(stayed[0]), math.sin(stayed[0])], abs=1e-14)
    system.status = NO_FORCE
    assert alignment._project(found) is None
    system.status, system.rows[:, :2] = OK, 0.0
    assert alignment._project(found) is None


@SEEDS
def test_derivatives_of_what_is_across(seed):
    rng = np.random.default_rng(seed)
    system = Sliding(rng, 3, nv=6)
    begin(system, np.zeros(3))
    alignment = directions._Alignment(system, 0.7, [0, 1, 2], system.evaluate)
    angles = rng.uniform(0.0, 6.0, 3)
    across = alignment._across(angles)
    for i, angle in enumerate(angles):
        normal = np.array([-math.sin(angle), math.cos(angle)])
        assert across[i] == pytest.approx(normal @ system.relative_acceleration[i, :2], abs=1e-13)
    jacobian = alignment._jacobian(angles, across)
    step = 1e-4
    for j in range(3):
        ahead = np.eye(3)[j] * step
        expected = (alignment._across(angles + ahead) - alignment._across(angles - ahead)) / (2.0 * step)
        # one-sided differences over 1e-6, of numbers of some ten
        assert jacobian[:, j] == pytest.approx(expected, abs=1e-4)
    system.status = NO_FORCE
    assert alignment._across(angles) is None
    assert alignment._jacobian(angles, across) is None
