"""Controls that numba has compiled: asked without Python, with the same answers, and the same words where they fail."""

import re
import sys

import numba
import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc
import pincontact.control

# A part of the suite runs kernels as Python: then numba compiles nothing.
pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="numba compiles nothing")

FOOT = 0.1


def block(motion=None):
    """A block of 1 kg on four feet, mu = 0.4: at rest on the floor."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "block")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.1), pin.SE3.Identity())
    corners = [(x, y) for x in (-FOOT, FOOT) for y in (-FOOT, FOOT)]
    for i, (x, y) in enumerate(corners):
        place = pin.SE3(np.eye(3), np.array([x, y, -0.05]))
        model.addFrame(pin.Frame(f"foot{i}", joint, 0, place, pin.FrameType.OP_FRAME))
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane(), motion=motion)
    for i in range(4):
        foot = scene.add_contour(f"foot{i}", pc.Point(), frame=f"foot{i}")
        scene.add_contact(f"foot{i}", floor, foot, friction=pc.Coulomb(0.4))
    q = pin.neutral(model)
    q[2] = 0.05
    return scene, scene.initial_state(q)


def push(t, q, v):
    """A push that changes its direction, with a spring and a damper: sums and products, which all compilers round
    alike."""
    tau = np.zeros(6)
    tau[0] = 8.0 * (1.0 - 4.0 * t) * (1.0 - t) - 3.0 * q[0] - 0.2 * v[0]
    tau[1] = 2.0 * t
    return tau


compiled_push = numba.njit(push)


def python_calls(run):
    """What a call returns, and how often Python asked a control in it."""
    asked = 0

    def count(frame, event, argument):
        nonlocal asked
        asked += (
            event == "call"
            and frame.f_code.co_name.startswith("ask")
            and frame.f_code.co_filename.endswith("control.py")
        )

    sys.setprofile(count)
    try:
        result = run()
    finally:
        sys.setprofile(None)
    return result, asked


@pytest.mark.parametrize("method", ["DOP853", "RK45", "Moreau"])
def test_same_run_without_python(method):
    """Outputs of time steps are asked for from Python, and so is what is looked at once an event; not the stages."""
    scene, state = block()
    plain, asked_plain = python_calls(lambda: pc.simulate(scene, state, 1.0, method=method, control=push))
    compiled, asked = python_calls(lambda: pc.simulate(scene, state, 1.0, method=method, control=compiled_push))
    assert plain.status == compiled.status == 0 and len(plain.events) > 4
    assert [(e.kind, e.contact, e.time) for e in plain.events] == [(e.kind, e.contact, e.time) for e in compiled.events]
    assert np.array_equal(plain.q, compiled.q) and np.array_equal(plain.v, compiled.v)
    assert all(np.array_equal(plain.contacts[f"foot{i}"].force, compiled.contacts[f"foot{i}"].force) for i in range(4))
    assert asked_plain > 300 and asked <= 2


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
def test_its_arrays_are_its_own(method):
    @numba.njit
    def control(t, q, v):
        tau = compiled_push(t, q, v)
        q[:] = 7.0
        v[:] = -7.0
        return tau

    scene, state = block()
    plain = pc.simulate(scene, state, 0.5, method=method, control=compiled_push)
    assert np.array_equal(plain.q, pc.simulate(scene, state, 0.5, method=method, control=control).q)


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
def test_with_a_signature(method):
    """A function that is compiled for one signature takes no read-only arrays."""
    control = numba.njit("float64[:](float64, float64[:], float64[:])")(push)
    scene, state = block()
    plain = pc.simulate(scene, state, 0.5, method=method, control=push)
    assert np.array_equal(plain.q, pc.simulate(scene, state, 0.5, method=method, control=control).q)


def test_with_a_motion_in_python():
    """Motions that are written in Python are asked together with the control."""

    def belt(t):
        moves = np.array([0.3 * t**2, 0.0, 0.0])
        return pin.SE3(np.eye(3), moves), np.r_[0.6 * t, np.zeros(5)], np.r_[0.6, np.zeros(5)]

    scene, state = block(pc.CallableMotion(belt))
    plain = pc.simulate(scene, state, 0.3, control=push)
    compiled = pc.simulate(scene, state, 0.3, control=compiled_push)
    assert plain.status == compiled.status == 0
    assert np.array_equal(plain.q, compiled.q) and abs(plain.q[-1, 0]) > 1e-3


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
def test_what_it_raises_is_passed_on(method):
    @numba.njit
    def control(t, q, v):
        if t > 0.3:
            raise ValueError("too late")
        return np.zeros(6)

    scene, state = block()
    with pytest.raises(ValueError, match="too late") as caught:
        pc.simulate(scene, state, 1.0, method=method, control=control)
    run = caught.value.run
    assert run.status == -5 and run.t[-1] <= 0.3 and "control raised ValueError" in run.message


def returned(kind):
    """A control that returns something else than real numbers (6,), and what it is."""
    controls = {
        "five": (lambda t, q, v: np.zeros(5), "shape \\(5,\\)"),
        "nan": (lambda t, q, v: np.array([0.0, 0.0, np.nan, 0.0, 0.0, 0.0]), "nan"),
        "square": (lambda t, q, v: np.zeros((6, 6)), "shape \\(6, 6\\)"),
        "complex": (lambda t, q, v: np.zeros(6) * 1j, "complex"),
        "none": (lambda t, q, v: None, "None"),
        "number": (lambda t, q, v: 1.0, "shape \\(\\)"),
    }
    return controls[kind]


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize("kind", ["five", "nan", "square", "complex", "none", "number"])
def test_told_as_of_python(kind, method):
    control, told = returned(kind)
    scene, state = block()
    plain = pc.simulate(scene, state, 0.1, method=method, control=control)
    compiled = pc.simulate(scene, state, 0.1, method=method, control=numba.njit(control))
    assert compiled.status == plain.status == -5 and compiled.message == plain.message
    assert re.search(told, compiled.message)


@pytest.mark.parametrize(
    "control",
    [
        lambda t, q, v: (1.0 * t, 0.0, 0.0, 0.0, 0.0, 0.0),
        lambda t, q, v: [6.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        lambda t, q, v: np.array([6, 0, 0, 0, 0, 0]),
        lambda t, q, v: np.array([6, 0, 0, 0, 0, 0], dtype=np.float32),
        lambda t, q, v: np.ones((6, 12))[:, 3],
    ],
    ids=["tuple", "list", "whole numbers", "single precision", "strided"],
)
def test_other_sequences(control):
    scene, state = block()
    plain = pc.simulate(scene, state, 0.5, control=control)
    compiled = pc.simulate(scene, state, 0.5, control=numba.njit(control))
    assert plain.status == compiled.status == 0 and np.array_equal(plain.q, compiled.q)
    assert np.array_equal(plain.contacts["foot0"].force, compiled.contacts["foot0"].force)


def test_compiled_again():
    """numba takes globals as they are when it compiles; `recompile` is its way to take new ones."""
    scene, state = block()
    control = numba.njit(lambda t, q, v: np.array([_PUSH[0], 0.0, 0.0, 0.0, 0.0, 0.0]))
    _PUSH[0] = 1.0
    first = pc.simulate(scene, state, 0.1, control=control)
    _PUSH[0] = 2.0
    control.recompile()
    second = pc.simulate(scene, state, 0.1, control=control)
    assert _drag(first) == pytest.approx(1.0, abs=1e-9) and _drag(second) == pytest.approx(2.0, abs=1e-9)


_PUSH = np.ones(1)


def _drag(run):
    """The push in N that friction takes of a block at rest."""
    return abs(sum(run.contacts[f"foot{i}"].force[-1, 0] for i in range(4)))


def test_few_are_kept(monkeypatch):
    """Controls that are made anew for each run do not fill the memory."""
    monkeypatch.setattr(pincontact.control, "_KNOWN", {})
    monkeypatch.setattr(pincontact.control, "_MOST_KNOWN", 2)
    scene, state = block()
    kept = numba.njit(push)
    before = pc.simulate(scene, state, 0.1, control=kept)
    for i in range(3):
        made = numba.njit(lambda t, q, v, i=i: np.array([float(i), 0.0, 0.0, 0.0, 0.0, 0.0]))
        assert _drag(pc.simulate(scene, state, 0.01, control=made)) == pytest.approx(i, abs=1e-9)
        assert len(pincontact.control._KNOWN) <= 2
    assert kept not in pincontact.control._KNOWN
    assert np.array_equal(pc.simulate(scene, state, 0.1, control=kept).q, before.q)
