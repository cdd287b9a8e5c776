"""What users' functions raise comes out of every call as it is, and a run's exception has what was computed so far."""

from __future__ import annotations

import _thread
import dataclasses
import pickle
import re
import signal
import sys
import threading
import traceback

import numpy as np
import pinocchio as pin
import pytest
from shared import one_body

import pincontact as pc

METHODS = ("DOP853", "RK45", "RK23", "Sharp98", "Moreau")
# Functions fail from here on, s.
FAILS = 0.05
# The pose given at construction is looked at until 1 s.
OFFSET = 2.0


class Own(Exception):
    """An exception of the user's own that counts as false."""

    def __bool__(self):
        return False


class Slotted(Exception):
    __slots__ = ("reason",)


@dataclasses.dataclass(frozen=True)
class Frozen(Exception):
    reason: str = "no plan"


class Unspeakable(Exception):
    def __str__(self):
        raise ValueError("no words")


RAISED = [
    KeyError("no plan"),
    StopIteration("no plan"),
    pc.FrictionError("no plan"),
    pc.SolverError("no plan"),
    Own("no plan"),
    Slotted("no plan"),
    Frozen(),
    Unspeakable(),
    KeyboardInterrupt("no plan"),
    SystemExit("no plan"),
]


def at_rest(t):
    return pin.SE3.Identity(), np.zeros(6), np.zeros(6)


class Case:
    """A ball that slides, then rolls on a plate; one of the user's functions raises `error` from FAILS on."""

    def __init__(self, where: str, error: BaseException | None = None) -> None:
        self.where, self.error = where, error
        model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.004 * np.eye(3)), "ball")
        self.scene = scene = pc.Scene(model)
        ball = scene.add_contour("ball", pc.Sphere(0.1), "ball")
        motion = pc.CallableMotion(self.move) if where == "motion" else None
        scene.add_contact("c", ball, scene.add_contour("plate", pc.Plane(), motion=motion), friction=pc.Coulomb(0.3))
        self.state = scene.initial_state([0, 0, 0.1, 0, 0, 0, 1], [0.2, 0, 0, 0, 0, 0], t=OFFSET)

    def fail(self, t):
        if self.error is not None and t > OFFSET + FAILS:
            raise self.error

    def move(self, t):
        self.fail(t)
        return at_rest(t)

    def control(self, t, q, v):
        self.fail(t)
        return np.full(6, 1e-3)

    def event(self, t, q, v):
        self.fail(t)
        return q[0] - 1e-3

    def run(self, method="DOP853", duration=0.2, **options):
        options |= {"step": 1e-2} if method == "Moreau" else {"max_step": 1e-2, "rtol": 1e-6}
        given = {"control": {"control": self.control}, "events": {"events": self.event}, "motion": {}}[self.where]
        return pc.simulate(self.scene, self.state, duration, method=method, **given, **options)


def inner_frame(error):
    return traceback.extract_tb(error.__traceback__)[-1].name


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("where", ["control", "events", "motion"])
def test_exceptions_are_raised_and_have_the_run(where, method):
    """The very object, from the very place, with the rows of a run in which nothing has failed."""
    error = KeyError("no plan")
    case, fine = Case(where, error), Case(where).run(method)
    assert fine.status == 0
    with pytest.raises(KeyError) as caught:
        case.run(method)
    assert caught.value is error
    assert inner_frame(error) == "fail"
    run = error.run
    who = {"control": "control", "events": r"events[0]", "motion": "the motion of contour 'plate'"}[where]
    assert isinstance(run, pc.Trajectory)
    assert run.status == -5 and not run.success
    assert f"{who} raised KeyError: 'no plan'" in run.message
    assert run.message.startswith("t = 2.05") or run.message.startswith("t = 2.06"), run.message
    n = run.t.size
    # a step of 0.01 s goes over the time from which on it fails
    assert n >= 5 and OFFSET + FAILS - 1e-2 - 1e-9 <= run.t[-1] <= OFFSET + FAILS + 1e-9
    for name in ("t", "q", "v"):
        np.testing.assert_array_equal(getattr(run, name), getattr(fine, name)[:n])
    np.testing.assert_array_equal(run.contacts["c"].force, fine.contacts["c"].force[:n])
    assert [e.kind for e in run.events] == [e.kind for e in fine.events if e.time <= run.t[-1]]
    # it can be gone on from, and the scene is as good as before
    case.error = None
    again = pc.simulate(case.scene, run.state(-1), 0.01, method=method)
    assert again.status == 0
    np.testing.assert_array_equal(case.run(method).q, fine.q)


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize("error", RAISED, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("where", ["control", "events", "motion"])
def test_any_exception(where, error, method):
    case = Case(where, error)
    with pytest.raises(type(error)) as caught:
        case.run(method)
    assert caught.value is error
    assert inner_frame(error) == "fail"
    assert error.run.status == -5 and error.run.t.size >= 5
    assert type(error).__name__ in error.run.message
    # raised once more, by another run: that one's
    first = error.run
    with pytest.raises(type(error)):
        case.run(method, t_eval=[OFFSET, OFFSET + 0.02, OFFSET + 0.1])
    assert error.run is not first
    np.testing.assert_array_equal(error.run.t, [OFFSET, OFFSET + 0.02])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("where", ["control", "events", "motion"])
def test_a_function_that_raises_at_once(where, method):
    """There is the state that the run was to start from."""
    case = Case(where, ValueError("at once"))
    case.fail = lambda t: (_ for _ in ()).throw(case.error)
    with pytest.raises(ValueError, match="at once") as caught:
        case.run(method)
    run = caught.value.run
    assert run.status == -5
    np.testing.assert_array_equal(run.t, [OFFSET])
    # the quaternion has been normalised once more
    np.testing.assert_allclose(run.q, [case.state.q], rtol=0.0, atol=1e-15)


def test_warnings_that_are_errors():
    """NumPy's, where the user's function asks for them."""
    case = Case("control")

    def control(t, q, v):
        with np.errstate(invalid="raise"):
            return np.sqrt(OFFSET + FAILS - t) * np.zeros(6)

    with pytest.raises(FloatingPointError, match="invalid value") as caught:
        pc.simulate(case.scene, case.state, 0.2, control=control, max_step=1e-2)
    assert "control raised FloatingPointError" in caught.value.run.message


def test_an_attribute_of_the_exceptions_own_is_kept():
    """One named `run` that is no trajectory: the exception comes as it is; a note says that the run does not."""

    class Numbered(Exception):
        run = 7

    class Given(Exception):
        def __init__(self, number):
            super().__init__(number)
            self.run = number

    @dataclasses.dataclass(frozen=True)
    class FrozenAndNumbered(Exception):
        run: int = 7

    for error in (Numbered("seventh"), Given(7), FrozenAndNumbered()):
        with pytest.raises(type(error)) as caught:
            Case("control", error).run()
        assert caught.value is error
        assert caught.value.run == 7
        if sys.version_info >= (3, 11) and not isinstance(error, FrozenAndNumbered):
            assert "the run up to there is not kept" in error.__notes__[0]


def test_runs_within_runs():
    """The outer run's exception has the outer run."""
    outer, inner = Case("control"), Case("events", KeyError("inner"))

    def control(t, q, v):
        if t > OFFSET + FAILS:
            inner.run()
        return np.zeros(6)

    with pytest.raises(KeyError, match="inner") as caught:
        pc.simulate(outer.scene, outer.state, 0.2, control=control, max_step=1e-2)
    assert caught.value.run.scene is outer.scene
    assert "control raised KeyError" in caught.value.run.message


def test_results_that_cannot_be_used_are_not_exceptions():
    """Unless a call within the control raises for them: that is an exception of the control."""
    case = Case("control")
    for wrong, text in (
        ((at_rest(0.0)[0], np.zeros(5), np.zeros(6)), r"velocity of f\(2.05\d*\) must have shape \(6\)"),
        ((at_rest(0.0)[0], np.full(6, np.nan), np.zeros(6)), "not finite"),
        (pin.SE3.Identity(), r"must be \(pose, velocity, acceleration\), got SE3"),
    ):
        motion = pc.CallableMotion(lambda t, wrong=wrong: at_rest(t) if t <= OFFSET + FAILS else wrong)
        scene = pc.Scene(case.scene.model)
        ball = scene.add_contour("ball", pc.Sphere(0.1), "ball")
        plate = scene.add_contour("p", pc.Plane(), motion=motion)
        scene.add_contact("c", ball, plate, friction=pc.Coulomb(0.3))
        state = scene.initial_state([0, 0, 0.1, 0, 0, 0, 1], [0.2, 0, 0, 0, 0, 0], t=OFFSET)
        for options in ({"max_step": 1e-2}, {"method": "Moreau", "step": 1e-2}):
            run = pc.simulate(scene, state, 0.2, **options)
            assert run.status == -5 and run.t.size >= 5
            assert re.search(r"^t = 2.05.*the motion of contour 'p': CallableMotion.*" + text, run.message), run.message
        stepper = pc.Stepper(scene, state, 1e-2)
        with pytest.raises(pc.ContourError, match="the motion of contour 'p': CallableMotion.*" + text):
            stepper.step(np.zeros(6), 10)

        def control(t, q, v, scene=scene, state=state):
            return np.zeros(6) if t <= OFFSET + 0.1 else pc.Stepper(scene, state, 1e-2).step(np.zeros(6), 10)

        with pytest.raises(pc.ContourError, match="'p': CallableMotion") as caught:
            pc.simulate(case.scene, case.state, 0.2, control=control)
        assert caught.value.run.status == -5


@pytest.mark.parametrize("error", RAISED, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("ask", [lambda s: s.step(np.zeros(6), 20), lambda s: s.rollout(np.zeros((20, 6)))])
def test_steppers_stop_where_they_are(ask, error):
    """And go on as if nothing had been, once the function does."""
    case, other = Case("motion", error), Case("motion")
    stepper, fine = pc.Stepper(case.scene, case.state, 1e-2), pc.Stepper(other.scene, other.state, 1e-2)
    with pytest.raises(type(error)) as caught:
        ask(stepper)
    assert caught.value is error and inner_frame(error) == "fail"
    fine.step(np.zeros(6), 5)
    assert stepper.t == fine.t
    for _ in range(2):
        for name in ("q", "v", "location", "discrete"):
            np.testing.assert_array_equal(getattr(stepper.state, name), getattr(fine.state, name))
        with pytest.raises(type(error)):
            stepper.step(np.zeros(6))
    case.error = None
    one, two = stepper.step(np.zeros(6), 10), fine.step(np.zeros(6), 10)
    np.testing.assert_array_equal(np.r_[one.q, one.v], np.r_[two.q, two.v])


@pytest.mark.parametrize("error", [KeyError("no plan"), pc.FrictionError("no plan"), KeyboardInterrupt("no plan")])
def test_analysis(error):
    """Wherever a motion is asked, and the conditions of an equilibrium."""
    case = Case("motion", error)
    rest = case.scene.initial_state([0, 0, 0.1, 0, 0, 0, 1], t=OFFSET + 0.01)
    late = dataclasses.replace(rest, t=OFFSET + 1.0)

    def conditions(q):
        raise error

    for call in (
        lambda: pc.linearize(case.scene, late),
        lambda: pc.analyze(case.scene, late),
        lambda: pc.external_forces(case.scene, late),
        lambda: pc.inverse_dynamics(case.scene, late, np.zeros(6)),
        lambda: pc.find_equilibrium(case.scene, rest.q, t=OFFSET + 1.0),
        lambda: pc.find_equilibrium(case.scene, rest.q, t=OFFSET, conditions=conditions),
        lambda: pc.find_steady_motion(case.scene, rest.q, np.zeros(6), t=OFFSET + 1.0),
        lambda: case.scene.initial_state(rest.q, t=OFFSET + 1.0),
        lambda: pc.Stepper(case.scene, late),
        lambda: pc.simulate(case.scene, late, 0.1),
        lambda: pc.simulate(case.scene, late, 0.1, method="Moreau"),
    ):
        with pytest.raises(type(error)) as caught:
            call()
        assert caught.value is error


def test_sweeps_have_rows_with_the_error():
    def build(fails):
        case = Case("control", KeyError("no plan") if fails else None)
        return case.scene, case.state, {"duration": 0.2, "control": case.control}

    table = pc.sweep(build, {"fails": [0, 1]}, workers=0, progress=False)
    assert table[0]["error"] == "" and table[0]["status"] == 0
    assert table[1]["error"] == "KeyError: 'no plan'"


def test_exceptions_travel_with_their_run():
    """Between processes, as results of executors do."""
    with pytest.raises(KeyError) as caught:
        Case("control", KeyError("no plan")).run()
    again = pickle.loads(pickle.dumps(caught.value))
    np.testing.assert_array_equal(again.run.q, caught.value.run.q)
    assert again.run.message == caught.value.run.message


@pytest.mark.parametrize("controlled", [False, True])
@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
def test_an_interrupt_of_compiled_steps_keeps_the_run(method, controlled):
    """Ctrl-C while nothing of the user's runs, or as a control is called."""
    # a shell's background job ignores interrupts
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    case = Case("events")
    # until the event is reached everything is compiled already
    pc.simulate(case.scene, case.state, 0.01, method=method)
    options = {"step": 1e-4} if method == "Moreau" else {"max_step": 1e-4}
    if controlled:
        options["control"] = lambda t, q, v: np.zeros(case.scene.model.nv)
    timer = threading.Timer(0.3, _thread.interrupt_main)
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt) as caught:
            # hours, if it were not interrupted
            pc.simulate(case.scene, case.state, 1e5, method=method, max_steps=10**15, t_eval=[OFFSET], **options)
    finally:
        timer.cancel()
        signal.signal(signal.SIGINT, usual)
    run = caught.value.run
    assert run.status == -5 and run.stats["steps"] > 100
    assert "ended by KeyboardInterrupt" in run.message
    np.testing.assert_array_equal(run.t, [OFFSET])
