"""Parts of an evaluation on arrays made by hand: corrections of constraints, resistances' rows, round-off of rows; and
what an evaluation asks for, on small scenes."""

from __future__ import annotations

import functools
import math

import numba
import numpy as np
import pinocchio as pin
import pytest
from calling import from_python
from made_systems import made_system
from shared import one_body

import pincontact as pc
from pincontact.analysis.instant import Instant
from pincontact.constraints import kinematics
from pincontact.constraints.kinematics import NORMAL_RATE
from pincontact.contours.motion import MOTION_HARMONIC
from pincontact.dynamics import evaluation, resistance
from pincontact.dynamics.evaluation import KINEMATICS_OF_ALL, PLACES_OF_ALL, PLACES_OF_CLOSED, VELOCITIES_OF_ALL
from pincontact.dynamics.system import System
from pincontact.geometry.carriers import ALPHA, OMEGA
from pincontact.geometry.patterns import NO_NORMAL, ON_CURVE, ON_SURFACE
from pincontact.layout import (
    CONTACT_INTS,
    DOMAIN,
    END_MARGIN,
    FREE,
    FRICTIONLESS,
    HIGH_END,
    JOINT_END,
    JOINT_Q,
    JOINT_V,
    LOW_END,
    MODE,
    NOTHING_THERE,
    OK,
    OWNER,
    PATTERN,
    ROLLING_ROW,
    SINGULAR,
    SLIPPING,
    SPINNING_ROW,
    STICK,
    SUPPORT_SIZE,
    SYSTEM,
    TANGENTS,
    TIME_DEPENDENT,
)
from pincontact.workspace import address_of

SEEDS = pytest.mark.parametrize("seed", range(4))
part = functools.cache(from_python)


def system_of(rng, nc, ng, nr, nv, nq=None):
    return made_system(nc, ng, nr, nv, nq, rng)


# ---------------------------------------------------------------------------------------------- corrections


def closed_contacts(rng, redundant):
    """Contacts that stick, slide on a curve, are open and without friction; coordinates held at each end, at none, and
    free; resistances of the first, and of the open one."""
    system = system_of(rng, 4, 4, 2, 16, 18)
    integers, limits, bounds = system.contact_int, system.joint_int, system.joint_real
    integers[:, MODE] = (
        STICK,
        SLIPPING,
        FREE,
        FRICTIONLESS,
        FRICTIONLESS,
        FRICTIONLESS,
        FRICTIONLESS,
        FREE,
        STICK,
        STICK,
    )
    integers[1, [PATTERN, TANGENTS]] = ON_CURVE, 1
    # only resistances go with their owners
    integers[:8, OWNER] = 2
    integers[8:, PATTERN], integers[8:, OWNER] = NO_NORMAL, [0, 2]
    limits[:, JOINT_Q], limits[:, JOINT_V], limits[:, JOINT_END] = [3, 5, 7, 9], [2, 4, 6, 8], [-1, 1, 0, 0]
    bounds[:, LOW_END], bounds[:, HIGH_END] = rng.normal(size=(2, 4))
    for g in range(4):
        system.basis[4 + g], system.rows[4 + g] = np.eye(3), 0.0
        system.rows[4 + g, 2, limits[g, JOINT_V]] = 1.0
    if redundant:
        # the same gap twice
        system.rows[3, 2], system.gaps[3, 0] = system.rows[0, 2], system.gaps[0, 0]
    return system


LISTED = [(0, 2), (0, 0), (0, 1), (1, 2), (1, 1), (3, 2), (4, 2), (5, 2), (6, 2), (8, 0), (8, 1)]


@SEEDS
@pytest.mark.parametrize("redundant", [False, True])
def test_corrections_are_the_least_in_the_mass_metric(redundant, seed):
    """Of positions by the gaps, where held ends have theirs; of velocities by what has to rest."""
    rng = np.random.default_rng(seed)
    system = closed_contacts(rng, redundant)
    q, v, factor = system.q, system.v, system.factor
    gaps, bounds = system.gaps.copy(), system.joint_real
    gaps[4:8, 0] = q[3] - bounds[0, LOW_END], q[5] - bounds[1, HIGH_END], 0.0, 0.0
    slip = system.slip.copy()
    slip[4:8, 2] = v[[2, 4, 6, 8]]
    assert part(evaluation.contact_corrections, SYSTEM)(system) == len(LISTED)
    assert system.contact_int[9, MODE] == FREE
    residual = np.array(
        [system.basis[c, row] @ (slip[c] if c < 4 or c > 7 else [0, 0, slip[c, 2]]) for c, row in LISTED]
    )
    rows = np.array([system.rows[c, row] for c, row in LISTED])
    inverse = np.linalg.inv(factor)
    expected = inverse @ np.linalg.pinv(rows @ inverse, rcond=1e-9) @ -residual
    # systems with condition numbers of up to 1e3
    assert system.correction_v == pytest.approx(expected, abs=1e-9)
    normals = [i for i, (c, row) in enumerate(LISTED) if row == 2 or c == 1]
    left = np.array([gaps[LISTED[i][0], 2 - LISTED[i][1]] for i in normals])
    expected = inverse @ np.linalg.pinv(rows[normals] @ inverse, rcond=1e-9) @ -left
    assert system.correction_q == pytest.approx(expected, abs=1e-9)
    scalars = system.scalars
    assert scalars["gap_residual"] == pytest.approx(np.abs(left).max(), rel=1e-14)
    assert scalars["velocity_residual"] == pytest.approx(np.abs(residual).max(), rel=1e-13)
    assert scalars["correction_size"] == pytest.approx(np.abs(system.correction_q).max(), rel=1e-14)
    unmet = np.abs(rows @ system.correction_v + residual).max()
    assert scalars["velocity_left"] == (pytest.approx(unmet, rel=1e-9) if redundant else 0.0)
    assert redundant == (unmet > 1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_joints_that_friction_holds_give_way_to_gaps(seed):
    """They hold wherever they are: a gap that only one of them can close is closed by it."""
    system = closed_contacts(np.random.default_rng(seed), False)
    system.rows[0, 2] = 0.0
    system.rows[0, 2, 6] = 0.7
    q, gaps, bounds = system.q, system.gaps.copy(), system.joint_real
    gaps[4:6, 0] = q[3] - bounds[0, LOW_END], q[5] - bounds[1, HIGH_END]
    part(evaluation.contact_corrections, SYSTEM)(system)
    firm = [(c, row) for c, row in LISTED if (row == 2 or c == 1) and c != 6]
    left = np.array([gaps[c, 2 - row] for c, row in firm])
    rows, inverse = np.array([system.rows[c, row] for c, row in firm]), np.linalg.inv(system.factor)
    expected = inverse @ np.linalg.pinv(rows @ inverse, rcond=1e-9) @ -left
    # systems with condition numbers of up to 1e3
    assert system.correction_q == pytest.approx(expected, abs=1e-9)
    assert rows[0] @ system.correction_q == pytest.approx(-gaps[0, 0], abs=1e-9)


def test_rows_of_normals():
    expected = {(ON_SURFACE, 2): True, (ON_CURVE, 2): True, (ON_CURVE, 1): True}
    for pattern in (ON_SURFACE, ON_CURVE, NO_NORMAL):
        for row in range(3):
            found = part(evaluation.is_normal_row)(pattern, row)
            assert found == expected.get((pattern, row), pattern == NO_NORMAL and row == 2)


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_numbers_to_go_on_with(value, place):
    finite = part(evaluation._finite)
    a = np.array([1.0, -2.0, 3.0, value])
    assert finite(a, 3)
    a[place] = value
    with np.errstate(invalid="ignore"):
        assert not finite(a, 3)


# ---------------------------------------------------------------------------------------------- round-off


def test_rows_of_which_round_off_is_left():
    """Against the largest term that cancels: what a joint moves either body by, its angular part times its reach."""
    drop = part(kinematics.drop_round_off, SYSTEM)
    nv = 4
    for side, kind, reach in ((2, "linear", 1.0), (3, "linear", 1.0), (2, "origin", 4.0), (3, "point", 5.0)):
        for axis in range(3):
            system = made_system(3, nv=nv)
            jacobian, support, side_int = system.jacobian, system.support, system.side_int
            frames, derivatives = system.frames, system.derivatives
            side_int[[2, 3], SUPPORT_SIZE], support[[2, 3], 1] = 2, 3
            # joints that move neither, sides of other contacts, and other vectors do not count
            jacobian[1], frames[[0, 1, 4, 5]], derivatives[[0, 1, 4, 5]] = 1e6, 1e6, 1e6
            frames[2:4, [0, 1, 2, 4, 5, 6, 7]], derivatives[2:4, 1:] = 1e6, 1e6
            if kind == "linear":
                jacobian[3, axis] = -0.02
                size = 0.02
            else:
                jacobian[3, 3 + (axis + 1) % 3] = -0.01
                (frames[side, 3] if kind == "origin" else derivatives[side, 0])[axis] = -reach
                size = 0.01 * reach
            if kind == "linear" and side == 3:
                side_int[2, SUPPORT_SIZE] = 0
            for scale, left in ((0.97e-13, False), (1.03e-13, True)):
                row = system.rows[1, 2]
                row[:] = scale * size * np.array([0.5, -1.0, 0.2, 0.0])
                before = row.copy()
                drop(system, 1, 2)
                assert (row == (before if left else 0.0)).all()
    # no joint moves either
    row[:] = [1e-10, 0.0, 0.0, 0.0]
    side_int[:, SUPPORT_SIZE] = 0
    drop(system, 1, 2)
    assert row[0] == 1e-10
    # nor are rows looked at that are not small
    side_int[:, SUPPORT_SIZE], jacobian[:] = 2, 1e6
    for k in range(nv):
        row[:] = 0.0
        row[k] = -1.1e-9
        drop(system, 1, 2)
        assert row[k] == -1.1e-9
        row[k] = 0.9e-9
        drop(system, 1, 2)
        assert not row.any()


# ---------------------------------------------------------------------------------------------- resistances


@SEEDS
@pytest.mark.parametrize("tangents", [1, 2])
def test_rows_of_resistances(tangents, seed):
    """Their rates are derivatives of the components of omega along a basis that turns, but for what a tangent gets
    from the other one; their rows what joints do to them."""
    rng = np.random.default_rng(seed)
    system = system_of(rng, 2, 1, 3, 6)
    integers, frames, vectors = system.contact_int, system.frames, system.vectors
    integers[1, TANGENTS] = tangents
    integers[1, [SPINNING_ROW, ROLLING_ROW]] = 4, 5
    integers[4, TANGENTS], integers[5, TANGENTS] = 1, tangents
    side_int, support = system.side_int, system.support
    side_int[2:, SUPPORT_SIZE], support[2, :2], support[3, :3] = [2, 3], [0, 3], [1, 2, 3]
    basis = system.basis[1].copy()
    turning = rng.normal(size=3)
    vectors[NORMAL_RATE] = np.cross(turning, basis[2])
    before = {name: getattr(system, name).copy() for name in ("bias", "rows", "slip", "basis")}
    part(resistance.resistance_kinematics, SYSTEM)(system, 1)
    omega = frames[3, OMEGA] - frames[2, OMEGA]
    rate = frames[3, ALPHA] - frames[2, ALPHA]
    about = {4: [basis[2]], 5: [basis[0], basis[1]] if tangents == 2 else [basis[1]]}
    jacobian = np.zeros((3, 6))
    jacobian[:, [1, 2, 3]] += system.jacobian[[1, 2, 3], 3:].T
    jacobian[:, [0, 3]] -= system.jacobian[[0, 3], 3:].T
    for item, axes in about.items():
        assert system.slip[item] == pytest.approx(omega, abs=1e-14)
        for row, axis in enumerate(axes):
            assert system.basis[item, row] == pytest.approx(axis, abs=1e-15)
            # (axis . omega)', with axis' = turning x axis
            change = axis @ rate + np.cross(turning, axis) @ omega
            for other in basis[:2]:
                if item == 5 and other @ axis < 0.5:
                    change -= (np.cross(turning, axis) @ other) * (other @ omega)
            assert system.bias[item, row] == pytest.approx(change, abs=1e-12)
            assert system.rows[item, row] == pytest.approx(axis @ jacobian, abs=1e-13)
        rest = slice(len(axes), 3)
        assert (system.bias[item, rest] == before["bias"][item, rest]).all()
        assert (system.rows[item, rest] == before["rows"][item, rest]).all()
        # a basis of its own
        assert np.linalg.det(system.basis[item]) == pytest.approx(1.0, rel=1e-12)
    for name, values in before.items():
        assert (getattr(system, name)[[0, 1, 2, 3]] == values[[0, 1, 2, 3]]).all()


@pytest.mark.parametrize("which", [SPINNING_ROW, ROLLING_ROW])
def test_a_contact_with_one_resistance(which):
    system = system_of(np.random.default_rng(1), 2, 0, 2, 5)
    system.contact_int[1, which] = 3
    kept = system.slip.copy()
    part(resistance.resistance_kinematics, SYSTEM)(system, 1)
    omega = system.frames[3, OMEGA] - system.frames[2, OMEGA]
    assert system.slip[3] == pytest.approx(omega, abs=1e-14)
    assert (system.slip[:3] == kept[:3]).all()
    assert system.basis[3, 0] == pytest.approx(system.basis[1, 2 if which == SPINNING_ROW else 0], abs=1e-15)


def test_what_resists_and_what_it_bears():
    integers, force = np.zeros((6, CONTACT_INTS), dtype=np.int64), np.zeros((6, 3))
    for spinning, rolling in ((0, 0), (3, 0), (0, 4), (3, 4)):
        integers[0, [SPINNING_ROW, ROLLING_ROW]] = spinning, rolling
        assert part(resistance.resists)(integers[0]) == (spinning + rolling > 0)
    force[1] = 7.0, -3.0, -4.0
    assert part(resistance.size_of_load)(integers, force, 1) == 4.0
    integers[1, PATTERN] = ON_CURVE
    assert part(resistance.size_of_load)(integers, force, 1) == 5.0
    integers[:, MODE], integers[1, MODE], integers[:, OWNER] = STICK, FREE, [1, 1, 1, 1, 0, 1]
    part(resistance.free_with_owners)(integers, 4, 6)
    assert integers[:, MODE].tolist() == [STICK, FREE, STICK, STICK, STICK, FREE]
    for largest, kept in ((0.9e-13, False), (-1.1e-13, True)):
        for k in range(3):
            row = np.full(4, 1e-14)
            row[k] = largest
            part(resistance.drop_unturned)(row, 3)
            assert row[:3].any() == kept
            assert row[3] == 1e-14


# ---------------------------------------------------------------------------------------------- on scenes


def slider():
    return one_body(pin.JointModelTranslation(), pin.Inertia(1.0, np.zeros(3), np.eye(3)), "bead")


def bead(surface, location, height=0.0):
    """A point on a slider of three directions over a surface, which it touches at (x, y)."""
    scene = pc.Scene(slider())
    point = scene.add_contour("point", pc.Point(), frame="bead")
    scene.add_contact("c", point, scene.add_contour("surface", surface), side=1, location=(None, location))
    return Instant(scene, scene.initial_state([*location, height], np.zeros(3)))


@pytest.mark.parametrize(
    ("x", "y", "distance"), [(0.2, 0.1, 0.8), (-0.9, 0.1, 0.1), (0.3, -1.9, 0.1), (0.5, 1.7, 0.3), (0.6, 0.0, 0.4)]
)
def test_distances_from_the_ends_of_a_surface(x, y, distance):
    patch = pc.ParametricSurface(lambda u, w: (u, w, 0.0), ((-1.0, 1.0), (-2.0, 2.0)))
    instant = bead(patch, (x, y))
    instant.evaluate()
    assert instant.system.contact_real[0, DOMAIN] == pytest.approx(distance + END_MARGIN, abs=1e-14)


def rods():
    """A rod that slides and turns above another, both along x at first."""
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), np.eye(3)), "rod"))
    upper, lower = scene.add_contour("upper", pc.Line(), frame="rod"), scene.add_contour("lower", pc.Line())
    scene.add_contact("c", upper, lower, side=1)
    q = np.array([0.2, 0.1, 0.5, 0.0, 0.0, math.sin(0.4), math.cos(0.4)])
    return scene, scene.initial_state(q, [0.3, 0.2, 0.1, 0.1, 0.2, 0.3], free=["c"])


def test_an_open_contact_without_a_nearest_point():
    """Parallel rods: it is beyond all ends, moves nothing, and keeps its place for when it comes back."""
    scene, state = rods()
    system = Instant(scene, state).system
    system.contact_int[0, MODE] = FREE
    assert system.evaluate_kinematics(0.0) == OK
    assert system.gaps[0, 0] != NOTHING_THERE
    for array in (system.rates, system.slip, system.bias, system.rows):
        array[:] = 7.0
    kept = system.location.copy()
    system.q[3:] = 0.0, 0.0, 0.0, 1.0
    assert system.evaluate_kinematics(0.0) == OK
    assert system.gaps[0, 0] == NOTHING_THERE
    assert system.contact_real[0, DOMAIN] == -1.0
    for array in (system.rates, system.slip, system.bias, system.rows):
        assert not array.any()
    assert (system.location == kept).all()
    # one that is closed says so
    system.contact_int[0, MODE] = STICK
    assert system.evaluate_kinematics(0.0) != OK


def asked_directly(system, choice=KINEMATICS_OF_ALL):
    return evaluation.evaluate_state(system.address, 0.0, choice)


def test_which_reference_forces_are_taken():
    """None, or one at the loads of the state."""
    system = bead(pc.Plane(), (0.1, 0.2)).system
    for has, expected in ((0.0, 5.0), (1.0, 3.0)):
        system.scalars["has_reference"] = has
        system.reference[:], system.reference_start[:], system.reference_slope[:] = 5.0, 3.0, 0.0
        assert system.evaluate(0.0) == OK
        # independent forces do not depend on it
        assert system.force[0, 2] == pytest.approx(9.81 * system.basis[0, 2, 2] * -1.0, rel=1e-12)
        assert system.reference[0, 2] == pytest.approx(expected, rel=1e-14)


@pytest.mark.skipif(not numba.config.DISABLE_JIT, reason="compiled code calls its own parts")
def test_what_is_left_of_an_open_contact_without_a_place(monkeypatch):
    """Nothing but where it was; a closed one ends the evaluation with what was found of it."""
    system = bead(pc.Plane(), (0.1, 0.2)).system
    system.location[0] = [0.1, 0.2, 0.3, 0.4]
    place = system.location[0].copy()

    def lost(*given):
        system.location[:], system.gaps[:], system.contact_real[0, DOMAIN] = 9.0, 9.0, 9.0
        for array in (system.rates, system.slip, system.bias, system.rows):
            array[:] = 9.0
        return SINGULAR

    monkeypatch.setattr(evaluation, "contact_kinematics", lost)
    for mode, status in ((STICK, SINGULAR), (FREE, OK)):
        system.contact_int[0, MODE] = mode
        assert asked_directly(system) == status
        if mode == FREE:
            assert (system.location[0] == place).all()
            assert system.gaps[0].tolist() == [NOTHING_THERE, 9.0]
            assert system.contact_real[0, DOMAIN] == -1.0
            assert not any(array.any() for array in (system.rates, system.slip, system.bias, system.rows))
        else:
            assert (system.location == 9.0).all()
            system.location[0] = place


@pytest.mark.parametrize(("kind", "timed"), [(0, 0), (0, 1), (MOTION_HARMONIC, 0), (MOTION_HARMONIC, 1)])
def test_drives_are_evaluated_once_a_side(kind, timed):
    """One that is at rest leaves the pose as the side's own; what it is driven by is added to that."""
    motion = pc.HarmonicMotion([0.0, 0.0, 0.2], 0.5) if kind else None
    scene = pc.Scene(slider())
    point = scene.add_contour("point", pc.Point(), frame="bead")
    place = pin.SE3(pin.utils.rotate("x", 0.2), np.array([0.3, 0.4, 0.0]))
    scene.add_contact("c", point, scene.add_contour("floor", pc.Plane(), placement=place, motion=motion), side=1)
    system = System(scene.model, list(scene.contacts.values()))
    system.side_int[1, TIME_DEPENDENT] = timed
    before = system.counters["drives_evaluated"]
    # what an evaluation before has left of it
    if kind:
        system.frames[1] = 7.0
    assert asked_directly(system) == OK
    assert system.counters["drives_evaluated"] - before == int(kind != 0 or timed != 0)
    frame = system.frames[1]
    assert frame[:3] == pytest.approx(place.rotation, abs=1e-15)
    offset = place.rotation @ [0.0, 0.0, 0.2] if kind else np.zeros(3)
    wave = 2.0 * math.pi * 0.5
    assert frame[3] == pytest.approx(place.translation, abs=1e-15)
    # at t = 0 of a sine: velocity alone
    assert frame[4] == pytest.approx(wave * offset, abs=1e-14)
    assert frame[5:8] == pytest.approx(np.zeros((3, 3)), abs=1e-14)
    # rows are those of the only side that joints move
    assert system.rows[0] == pytest.approx(-system.basis[0], abs=1e-13)


CHOICES = (0, KINEMATICS_OF_ALL, PLACES_OF_CLOSED, PLACES_OF_ALL, VELOCITIES_OF_ALL)


@pytest.mark.parametrize("choice", CHOICES)
@pytest.mark.parametrize("mode", [FREE, FRICTIONLESS])
def test_what_an_evaluation_is_confined_to(mode, choice):
    """Rows of open contacts where they are asked for, biases and forces not with places alone."""
    instant = bead(pc.Plane(), (0.1, 0.2))
    system = instant.system
    instant.evaluate()
    system.contact_int[0, MODE] = mode
    counted = ["evaluation_count", "rows_formed", "drives_evaluated"]
    counts = np.array(system.counters[counted].tolist())
    system.rows[:], system.bias[:], system.free_acceleration[:] = 5.0, 5.0, 5.0
    status = evaluation.evaluate_state(system.address, 0.0, choice)
    assert status == OK
    with_rows = mode != FREE or choice in (KINEMATICS_OF_ALL, PLACES_OF_ALL, VELOCITIES_OF_ALL)
    found = np.array(system.counters[counted].tolist()) - counts
    assert found.tolist() == [1, int(with_rows), 0]
    assert (system.rows[0] == 5.0).all() != with_rows
    assert (system.free_acceleration == 5.0).all() == (choice != 0)
    with_bias = choice not in (PLACES_OF_CLOSED, PLACES_OF_ALL)
    assert (system.bias[0] != 5.0).all() == with_bias


@pytest.mark.skipif(not numba.config.DISABLE_JIT, reason="compiled code calls Pinocchio itself")
@pytest.mark.parametrize("choice", CHOICES)
def test_which_of_pinocchios_algorithms_are_called_by_address(choice, monkeypatch):
    """Bias forces and mass matrix; the former alone at the same place; places alone. Through Python where the model is
    no longer what it was."""
    instant = bead(pc.Plane(), (0.1, 0.2))
    system, called, asked = instant.system, [], []
    native = np.arange(100, 118, dtype=np.int64).reshape(3, 6)
    words = np.array([11, 12], dtype=np.int64)
    monkeypatch.setattr(evaluation, "call_by_address", lambda *numbers: called.append([int(n) for n in numbers]))
    through_python = evaluation.call_python
    monkeypatch.setattr(evaluation, "call_python", lambda *given: asked.append(given[0]) or through_python(*given))
    system.callback["native"], system.callback["model"] = address_of(native), address_of(words)
    for size, joints in ((11, 12), (11, 13), (10, 12)):
        called.clear()
        asked.clear()
        system.callback["model_size"], system.callback["model_joints"] = size, joints
        evaluation.evaluate_state(system.address, 0.0, choice)
        if (size, joints) == (11, 12):
            rows = {PLACES_OF_CLOSED: [2], PLACES_OF_ALL: [2], VELOCITIES_OF_ALL: [0]}.get(choice, [0, 1])
            assert called == native[rows].tolist()
            assert not asked
        else:
            assert not called
            assert asked
    system.callback["native"] = 0
    evaluation.evaluate_state(system.address, 0.0, choice)
    assert not called
