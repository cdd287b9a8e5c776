"""A scene compiled for the kernels: what is laid out for its joints, contacts, laws and drives, table by table."""

from __future__ import annotations

import ctypes
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from shared import one_body

import pincontact as pc
from pincontact.contacts import characteristic_length
from pincontact.dynamics import system as system_module
from pincontact.dynamics.joints import joint_limits
from pincontact.dynamics.system import FORCE_SLACK, System, Torque
from pincontact.errors import UnusableResult
from pincontact.geometry.patterns import NO_NORMAL
from pincontact.integration.run_system import RunSystem
from pincontact.layout import (
    ALONG_BODY_1,
    ALONG_BODY_2,
    ANISOTROPIC,
    ASPECT,
    CHART,
    CLOSED_FORM,
    CONTACT_INTS,
    CURVE_SPEED,
    FREE,
    FRICTIONLESS,
    HIGH_END,
    HIGH_FORCE,
    JOINT,
    JOINT_Q,
    JOINT_SIGN,
    JOINT_V,
    K1,
    K2,
    LAST_SPEED,
    LENGTH,
    LIMIT_SLACK,
    LOW_END,
    LOW_FORCE,
    MODE,
    MU,
    MU_FAST,
    MU_NOW,
    MU_STATIC,
    NORMAL_1,
    NORMAL_2,
    NORMAL_SIGN,
    NUMBER_OF_WORKS,
    OWNER,
    PATTERN,
    POLYNOMIAL_SIZE,
    ROLLING,
    ROLLING_ROW,
    SCALING_11,
    SCALING_12,
    SCALING_22,
    SIDE,
    SLIP_SIGN,
    SPAN,
    SPINNING,
    SPINNING_ROW,
    START_SPEED,
    STICK,
    STRIBECK_EXPONENT,
    SUPPORT_SIZE,
    TANGENTS,
    TIME_DEPENDENT,
    UNILATERAL,
    VISCOUS,
)
from pincontact.system_cache import CachedSystem, put_back, take_system

URDF = Path(__file__).resolve().parent.parent / "urdf"

PLACE = pin.SE3(pin.utils.rotate("x", 0.3), np.array([0.1, 0.2, 0.3]))
LAWS = [
    pc.Stribeck((0.2, 0.1), (0.6, 0.3), 0.5, 1.5, along="tray", spinning=2e-3, rolling=1e-3),
    pc.Coulomb((0.3, 0.6), (0.4, 0.8), along="field", viscous=0.7, rolling=3e-3),
]


def tree():
    """An arm of two links, and a free body on the second, with limits, dry friction and damping."""
    model = pin.Model()
    joint = 0
    for name, kind in (
        ("shoulder", pin.JointModelRZ()),
        ("slide", pin.JointModelPX()),
        ("flyer", pin.JointModelFreeFlyer()),
    ):
        joint = model.addJoint(joint, kind, PLACE, name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame(f"{name} body", joint, PLACE, 0)
    side = model.addJoint(1, pin.JointModelRX(), PLACE, "branch")
    model.appendBodyToJoint(side, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.lowerPositionLimit[1], model.upperPositionLimit[1] = -0.7, 0.9
    model.lowerDryFrictionLimit[[1, 8]], model.upperDryFrictionLimit[[1, 8]] = [-0.2, -0.1], [0.3, 0.4]
    model.damping[:] = np.linspace(0.1, 0.9, model.nv)
    model.gravity.linear = np.array([0.1, 0.2, -9.0])
    return model


def scene_of(laws=LAWS, motion=None):
    """A ball over a tray, and over a field of the world that is driven; points that are not found in closed form come
    first."""
    scene = pc.Scene(tree())
    ball = scene.add_contour("ball", pc.Sphere(0.1), frame="flyer body", placement=PLACE)
    field = scene.add_contour("field", pc.HeightField(lambda x, y: 0.05 * math.sin(x) * math.cos(y)), motion=motion)
    tray = scene.add_contour("tray", pc.Plane(), frame="slide body")
    edge = scene.add_contour("edge", pc.Circle(0.4), frame="slide body")
    scene.add_contact("edge", field, edge, bilateral=True, side=-1)
    scene.add_contact("tray", ball, tray, friction=laws[0])
    scene.add_contact("field", field, ball, friction=laws[1], side=1)
    return scene


@pytest.fixture
def laid_out():
    scene = scene_of()
    limits = joint_limits(scene.model)
    return scene, limits, RunSystem(scene.model, list(scene.contacts.values()), True, limits, True)


def test_sizes(laid_out):
    scene, limits, system = laid_out
    nq, nv = scene.model.nq, scene.model.nv
    sizes = system.sizes
    ny = nq + nv + 12 + NUMBER_OF_WORKS
    assert sizes[["nq", "nv", "nc", "njoints", "nblocks"]].tolist() == (nq, nv, 3, 5, 3)
    assert sizes[["nwork", "ny"]].tolist() == (NUMBER_OF_WORKS, ny)
    assert (system.nq, system.nv, system.nc, system.ng, system.nr, system.items, system.ny) == (nq, nv, 3, 2, 3, 8, ny)
    assert [len(getattr(system, name)) for name in ("state", "new_state", "absolute")] == [ny] * 3
    assert system.joint_count.tolist() == [2]
    assert system.resistance_count.tolist() == [3]
    assert len(limits) == 2
    for name in (
        "contact_int",
        "contact_real",
        "basis",
        "slip",
        "rows",
        "force",
        "event_functions",
        "reference",
        "location",
    ):
        assert len(getattr(system, name)) == 8
    assert system.whitened_rows.shape == (24, nv)
    assert system.joint_table[:, 1:].tolist() == [[0, 0, 2], [2, 2, 6], [9, 8, 1]]
    assert (system.q == pin.neutral(scene.model)).all()
    assert system.counters.charted
    assert system.turns
    without = System(scene.model, [], False)
    assert without.ny == nq + nv
    # room for one
    assert without.contact_int.shape == (1, CONTACT_INTS)
    assert len(without.side_int) == 2
    assert not without.counters.charted
    # places in the state that are not there, or are found without a start: the first contact's circle has one, the
    # field two, as it has with the ball, which has two
    start = nq + nv
    first = [start + 1]
    assert system.contact_int[:3, CLOSED_FORM].tolist()[1] != system.contact_int[0, CLOSED_FORM]
    assert system.unfollowed.tolist() == first + [start + 4 + i for i in range(4)]


def test_what_is_locked_takes_no_part():
    """Branches hang on what is before the locks; locked coordinates move no contact and are not followed."""
    scene = scene_of()
    model = scene.model
    model.lowerPositionLimit[[0, 1]] = model.upperPositionLimit[[0, 1]] = 0.1, -0.2
    system = RunSystem(model, list(scene.contacts.values()), True, joint_limits(model), True)
    assert system.locked == [0, 1] and [lock.value for lock in system.locks] == [0.1, -0.2]
    assert system.moves.tolist() == [0.0, 0.0] + [1.0] * (model.nv - 2)
    parents = list(model.createData().parents_fromRow)[: model.nv]
    assert system.parents.tolist() == [-1 if k < 2 or parents[k] < 2 else parents[k] for k in range(model.nv)]
    moving = {k for row, ints in zip(system.support, system.side_int) for k in row[: ints[SUPPORT_SIZE]].tolist()}
    assert moving and not moving & {0, 1}
    nq = model.nq
    assert system.unfollowed.tolist()[:4] == [0, nq, 1, nq + 1]
    assert [limit.index_v for limit in system.limits] == [8]
    system.set_tree(range(-1, model.nv - 1))
    assert system.parents.tolist() == [-1, -1, -1, *range(2, model.nv - 1)]


def test_pinocchios_data_in_place(laid_out):
    scene, _, system = laid_out
    model, data = scene.model, system.data
    assert system.parents.tolist() == list(data.parents_fromRow)[: model.nv]
    assert system.gravity.tolist() == [0.1, 0.2, -9.0]
    assert (system.damping == model.damping).all()
    q = pin.integrate(model, pin.neutral(model), np.linspace(0.1, 0.9, model.nv))
    system.q[:], system.v[:] = q, np.linspace(-0.5, 0.5, model.nv)
    system.evaluate_kinematics(0.0)
    for j in range(1, model.njoints):
        wanted = data.oMi[j].rotation.ravel(order="F"), data.oMi[j].translation, data.v[j].vector, data.a_gf[j].vector
        for address, values in zip(system.joint_addresses[j].tolist(), wanted):
            found = np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(ctypes.c_double)), (len(values),))
            assert found.tolist() == values.tolist()
    # of the mass matrix the upper triangle is what Pinocchio promises; kernels have it transposed
    assert (np.tril(system.mass) == np.triu(data.M).T).all()
    assert np.triu(data.M).any()
    assert system.jacobian == pytest.approx(data.J.T)


def test_contacts_and_their_sides(laid_out):
    scene, _, system = laid_out
    contacts = list(scene.contacts.values())
    integers, numbers = system.contact_int[:3], system.contact_real[:3]
    assert integers[:, K1].tolist() == [1, 2, 2]
    assert integers[:, K2].tolist() == [2, 2, 2]
    assert integers[:, PATTERN].tolist() == [contact.pattern.code for contact in contacts]
    assert integers[:, TANGENTS].tolist() == [2, 2, 2]
    assert integers[:, MODE].tolist() == [FRICTIONLESS] * 3
    assert integers[:, UNILATERAL].tolist() == [0, 1, 1]
    assert integers[:, SIDE].tolist() == [-1, contacts[1].side or 1, 1]
    assert integers[:, SLIP_SIGN].tolist() == integers[:, NORMAL_SIGN].tolist() == [1, 1, 1]
    assert numbers[:, LENGTH].tolist() == [characteristic_length(contact) for contact in contacts]
    assert numbers[:, [NORMAL_1, NORMAL_2, SPAN]].tolist() == [[1.0, 0.0, 1.0]] * 3
    assert (system.contact_real[:, [START_SPEED, LAST_SPEED]] == math.inf).all()
    assert (system.contact_real[:, LIMIT_SLACK] == FORCE_SLACK).all()
    for c, contact in enumerate(contacts):
        for side, attached in enumerate((contact.body1, contact.body2)):
            row = system.side_int[2 * c + side]
            assert row[[CHART, JOINT, TIME_DEPENDENT]].tolist() == [0, attached.joint, 0]
            place = attached.placement_in_joint
            assert system.side_base[2 * c + side].tolist() == [*place.rotation.ravel(), *place.translation]
            assert (system.side_shape[2 * c + side] == attached.contour.shape_row()).all()
            assert system.side_domain[2 * c + side].tolist() == list(attached.contour.ends())
            moving = system.support[2 * c + side, : row[SUPPORT_SIZE]].tolist()
            # what moves it is what its Jacobian has columns for
            jacobian = pin.computeJointJacobian(scene.model, scene.model.createData(), system.q, attached.joint)
            assert moving == np.flatnonzero(np.abs(jacobian).max(axis=0)).tolist()
            if attached.joint == 0:
                frame = system.frames[2 * c + side]
                assert (frame[:3] == place.rotation).all()
                assert (frame[3] == place.translation).all()


def test_laws(laid_out):
    _, _, system = laid_out
    names = [MU, MU_NOW, MU_FAST, MU_STATIC, VISCOUS, SPINNING, ROLLING, CURVE_SPEED, STRIBECK_EXPONENT]
    numbers = system.contact_real
    assert not numbers[0, names].any()
    assert numbers[1, names].tolist() == [0.6, 0.6, 0.2, 0.6, 0.0, 2e-3, 1e-3, 0.5, 1.5]
    assert numbers[2, names].tolist() == [0.3, 0.3, 0.3, 0.4, 0.7, 0.0, 3e-3, 0.0, 0.0]
    ellipses = numbers[:3, [ASPECT, SCALING_11, SCALING_12, SCALING_22]]
    assert ellipses.tolist() == [[1.0, 1.0, 0.0, 1.0], [0.5, 1.0, 0.0, 0.5], [2.0, 1.0, 0.0, 2.0]]
    assert system.contact_int[:3, ANISOTROPIC].tolist() == [0, ALONG_BODY_2, ALONG_BODY_1]
    # resistances: about the normal first
    assert system.resistances == [(1, True), (1, False), (2, False)]
    integers = system.contact_int
    assert integers[:3, [SPINNING_ROW, ROLLING_ROW]].tolist() == [[0, 0], [5, 6], [0, 7]]
    assert [system.resists(c) for c in range(3)] == [False, True, True]
    assert integers[5:, [OWNER, PATTERN, MODE, TANGENTS, SLIP_SIGN, NORMAL_SIGN]].tolist() == [
        [1, NO_NORMAL, FREE, 1, 1, 1], [1, NO_NORMAL, FREE, 2, 1, 1], [2, NO_NORMAL, FREE, 2, 1, 1],
    ]  # fmt: skip
    assert numbers[5:, [MU, MU_FAST, MU_STATIC, MU_NOW]].tolist() == [[2e-3] * 4, [1e-3] * 4, [3e-3] * 4]
    assert (numbers[5:, [ASPECT, SCALING_11, SCALING_22, SPAN, LENGTH, NORMAL_1]] == 1.0).all()
    assert [system.owner(i) for i in (0, 1, 2, 5, 6, 7)] == [0, 1, 2, 1, 1, 2]


def test_ellipses_along_a_contour(laid_out):
    """Of the law's first direction the stretch makes the same, across it `aspect` times as much."""
    scene, _, system = laid_out
    system.q[:] = pin.integrate(scene.model, system.q, np.linspace(0.2, -0.3, system.nv))
    system.evaluate_kinematics(0.0)
    a, b, d = system.contact_real[2, [SCALING_11, SCALING_12, SCALING_22]]
    shape = np.array([[a, b], [b, d]])
    along = system.basis[2, :2] @ system.derivatives[4, 1]
    assert shape @ along == pytest.approx(along, rel=1e-12)
    across = np.array([-along[1], along[0]])
    assert shape @ across == pytest.approx(2.0 * across, rel=1e-12)
    assert abs(along[1]) > 1e-3 * abs(along[0])


def test_resistances_above_round_off():
    for length, found in ((0.0, []), (0.9e-13, []), (1.1e-13, [(1, True), (1, False)])):
        scene = scene_of([pc.Coulomb(0.3, spinning=length, rolling=length), None])
        system = System(scene.model, list(scene.contacts.values()), resistances=True)
        assert system.resistances == found
        # one coefficient is for all directions
        assert not system.contact_int[:, ANISOTROPIC].any()
        assert (system.contact_real[:3, [ASPECT, SCALING_11, SCALING_22]] == 1.0).all()


def test_joint_coordinates(laid_out):
    _, limits, system = laid_out
    assert [limit.joint for limit in limits] == ["slide", "branch"]
    assert system.joint_int[:, [JOINT_Q, JOINT_V]].tolist() == [[1, 1], [9, 8]]
    bounds = system.joint_real[:, [LOW_FORCE, HIGH_FORCE, LOW_END, HIGH_END]].tolist()
    assert bounds == [[-0.2, 0.3, -0.7, 0.9], [-0.1, 0.4, -math.inf, math.inf]]
    for g, velocity in enumerate((1, 8)):
        assert system.contact_int[3 + g, MODE] == FREE
        assert (system.basis[3 + g] == np.eye(3)).all()
        expected = np.zeros((3, system.nv))
        expected[2, velocity] = 1.0
        assert (system.rows[3 + g] == expected).all()
    # forces of those that are held, friction of those that move
    kept = system.contact_int.copy()
    system.force[3:5] = [[9.0, 9.0, 0.7], [9.0, 9.0, -0.6]]
    for sign, friction in ((-1, 0.3), (0, 0.0), (1, -0.2)):
        system.joint_int[:, JOINT_SIGN] = sign
        system.contact_int[3:5, MODE] = FREE, FRICTIONLESS
        expected = np.zeros(system.nv)
        expected[[1, 8]] = friction, -0.6
        assert system.joint_forces().tolist() == expected.tolist()
        assert system.held() == [1]
    system.contact_int[3:5, MODE] = FRICTIONLESS, FREE
    assert system.held() == [0]
    # what is closed, and resists
    system.contact_int[:3, MODE] = FREE, STICK, FREE
    assert system.closed() == [1]
    assert system.resisting() == [5, 6]
    system.contact_int[:3, MODE] = FRICTIONLESS, FREE, STICK
    assert system.closed() == [0, 2]
    assert system.resisting() == [7]
    system.contact_int[:] = kept


def test_several_contacts_need_other_kernels(monkeypatch):
    scene, asked = scene_of((LAWS[0], pc.NoSlip())), []
    monkeypatch.setattr(system_module, "compile_kernels", lambda several: asked.append(several))
    edge, tray, field = scene.contacts.values()
    for contacts in ([], [edge], [edge, field], [edge, tray, field]):
        System(scene.model, contacts)
    assert asked == [False, False, True, True]


@pytest.mark.parametrize(
    "motion", [None, pc.ConstantTwist(np.array([0.1, 0.0, 0.0]), np.zeros(3)), pc.HarmonicMotion([0, 0, 0.1], 1.0)]
)
def test_what_varies_with_time(motion):
    scene = scene_of(motion=motion)
    contacts = list(scene.contacts.values())
    for chosen in (contacts, contacts[1:2], contacts[2:]):
        system = System(scene.model, chosen)
        unsteady = isinstance(motion, pc.HarmonicMotion) and chosen != contacts[1:2]
        assert system.varies_with_time is unsteady
        assert not system.asks
        assert system.callback[["asked", "asked_with"]].tolist() == (0, 0)
        system.before_evaluation(Torque(lambda t: None, None))
        assert system.asks
        assert system.varies_with_time
        system.before_evaluation()
        assert not system.asks
    timed = pc.ParametricCurve(lambda u, t: (u, t, 0.0), (-1.0, 1.0))
    scene.add_contact("timed", scene.add_contour("timed", timed, frame="slide body"), scene.contours["field"])
    assert System(scene.model, list(scene.contacts.values())).varies_with_time


def test_drives_in_python_are_asked():
    times = []

    def given(t):
        times.append(t)
        if t > 1.0:
            raise KeyError("late")
        return pin.SE3.Identity(), np.zeros(6), np.zeros(6)

    scene = scene_of(motion=pc.CallableMotion(given))
    system = System(scene.model, list(scene.contacts.values()))
    assert system.asks
    assert system.varies_with_time
    assert [(side, name) for side, name, _ in system.python_drives] == [(1, "field"), (4, "field")]
    times.clear()
    system.scalars["time"] = 0.25
    ask = system.callback_of(lambda t: given(t))
    assert ask()
    assert times == [0.25]
    system.check_callbacks()
    for time in (1.5, 2.5):
        system.scalars["time"] = time
        assert not ask()
    assert times == [0.25, 1.5, 2.5]
    with pytest.raises(KeyError):
        system.check_callbacks()
    system.check_callbacks()
    # what a run says of it
    assert system.tell(UnusableResult("3 numbers")) == "3 numbers."
    system.blame("t = 1.5 s: the control")
    assert system.tell(KeyError("late")) == "t = 1.5 s: the control raised KeyError: 'late'"
    assert system.tell(ValueError()) == "t = 1.5 s: the control raised ValueError"
    assert "raised" in system.tell(UnusableResult("own"))
    assert not system.is_own(UnusableResult("own"))
    assert system.tell(KeyboardInterrupt()) == "t = 2.5 s: ended by KeyboardInterrupt"


@pytest.mark.parametrize("contacts", [1, 4])
def test_a_drive_is_asked_once_an_evaluation(contacts):
    """However many contacts its contour has; another contour's drive is asked, too."""
    times = {1.0: [], 2.0: []}

    def driven(speed):
        def motion(t):
            times[speed].append(t)
            return pin.SE3(np.eye(3), np.array([speed * t, 0.0, 0.0])), speed * np.eye(6)[0], np.zeros(6)

        return pc.CallableMotion(motion)

    model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), np.eye(3)))
    scene = pc.Scene(model)
    for speed in times:
        plate = scene.add_contour(f"plate {speed}", pc.Plane(), motion=driven(speed))
        for k in range(contacts):
            point = scene.add_contour(f"point {k} {speed}", pc.Point(), "body")
            scene.add_contact(f"{k} {speed}", point, plate, friction=pc.Coulomb(0.3))
    system = System(scene.model, list(scene.contacts.values()))
    system.q[:] = pin.neutral(model)
    for asked in times.values():
        asked.clear()
    system.evaluate(0.25)
    assert times == {1.0: [0.25], 2.0: [0.25]}
    expected = np.repeat([1.0, 2.0], contacts)
    np.testing.assert_allclose(system.slip[: system.nc, 0], expected, rtol=0.0, atol=1e-14)


def test_torques_that_are_not_finite():
    scene = scene_of()
    system = System(scene.model, [])
    system.check_callbacks()
    system.check_torques(0.5)
    system.tau[2] = math.inf
    with pytest.raises(UnusableResult, match=r"t = 0\.5 s: control returned inf"):
        system.check_torques(0.5)
    system.scalars["bad_torque"], system.scalars["bad_time"] = -math.inf, 0.25
    with pytest.raises(UnusableResult, match=r"t = 0\.25 s: control returned -inf"):
        system.check_callbacks()


@pytest.mark.parametrize("count", [0, 3, 256, 257])
def test_times_of_output(count):
    system = RunSystem(scene_of().model, [])
    times = np.linspace(0.5, 1.0, count)
    system.counters["outputs_done"] = 7
    system.set_output_times(times)
    assert system.counters[["output_count", "outputs_done", "record_steps"]].tolist() == (count, 0, 0)
    for time in times[:3]:
        assert system.scalars["next_output"] == time
        system.output_done()
    if count <= 3:
        assert system.scalars["next_output"] == math.inf
    assert (system.output_times == times).all()
    assert (system.output_times[:count] == times).all()
    system.set_output_times(None)
    assert system.counters[["output_count", "outputs_done", "record_steps"]].tolist() == (0, 0, 1)
    assert system.scalars["next_output"] == math.inf


# ---------------------------------------------------------------------------------------------- kept for the next run


def test_a_system_fits_what_it_was_made_from():
    """As long as all of it is the same: model, contacts, placements, what contours and motions hold."""
    motion = pc.SplineMotion(
        np.linspace(0.0, 1.0, 7), [pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1 * i])) for i in range(7)]
    )
    scene = scene_of(motion=motion)
    cached = CachedSystem(scene, True, False)
    assert cached.fits(scene)
    assert not cached.fits(scene_of(motion=motion))
    placement = scene.contours["ball"].placement_in_joint
    changes = [
        (scene.model.damping, 0), (placement.translation, 1), (motion.parameters, 0), (motion.pool, 2),
        (scene.contours["field"].contour.pool, 0),
    ]  # fmt: skip
    for array, place in changes:
        if not array.size or not array.flags.writeable:
            continue
        kept = array[place]
        array[place] += 0.5
        assert not cached.fits(scene)
        array[place] = kept
        assert cached.fits(scene)
    scene.add_contact("more", scene.contours["tray"], scene.contours["field"], side=1)
    assert not cached.fits(scene)


def test_a_cached_system_is_taken_once():
    scene = scene_of()
    cached = take_system(scene, False, True)
    put_back(scene, cached)
    cached.system.q[0] = 7.0
    again = take_system(scene, False, True)
    assert again is cached
    # as new
    assert (again.system.q == pin.neutral(scene.model)).all()
    assert take_system(scene, False, True) is not cached
    put_back(scene, cached)
    assert take_system(scene, True, True) is not cached


@pytest.mark.parametrize("driven", [False, True])
def test_places_need_motions_but_no_control(driven):
    """As slip begins v_c is looked at along a step: the control is not asked there, unless motions are, too."""
    calls = {"control": 0, "motion": 0}

    def still(t):
        calls["motion"] += 1
        return pin.SE3.Identity(), np.zeros(6), np.zeros(6)

    def push(t, q, v):
        calls["control"] += 1
        return np.array([t, 0.5 * t, 0.0, 0.0, 0.0, 0.0])

    scene = pc.Scene.from_urdf(URDF / "ball.urdf", floating_base=True)
    motion = pc.CallableMotion(still) if driven else None
    ball, floor = scene.add_contour("p", pc.Point(), "ball"), scene.add_contour("floor", pc.Plane(), motion=motion)
    scene.add_contact("c", ball, floor, friction=pc.Coulomb(0.1))
    state = scene.initial_state([0, 0, 0, 0, 0, 0, 1.0])
    calls.update(control=0, motion=0)
    run = pc.simulate(scene, state, 2.0, control=push)
    assert [event.kind for event in run.events] == ["slip"]
    looks = run.stats["rhs"] - calls["control"]
    assert looks == 0 if driven else looks >= 2 * POLYNOMIAL_SIZE - 1
    assert calls["motion"] == (calls["control"] if driven else 0)
