"""Pinocchio's algorithms by address: the same numbers as through Python, and what happens where they cannot be had."""

import ctypes
import sys

import numba
import numpy as np
import pinocchio as pin
import pytest
from reference import build

import pincontact as pc
from pincontact.dynamics import pinocchio_calls
from pincontact.dynamics.pinocchio_calls import PinocchioCalls
from pincontact.integration.run_system import RunSystem
from pincontact.integration.steps import PROJECT_PLACES, run_task

here = pytest.mark.skipif(
    sys.platform != "linux" or bool(numba.config.DISABLE_JIT), reason="known to be there on Linux, for compiled kernels"
)
MODELS = {
    "free body": lambda: free_body(),
    "arm": pin.buildSampleModelManipulator,
    "humanoid": pin.buildSampleModelHumanoid,
    "nothing": pin.Model,
}


def free_body():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag([0.1, 0.2, 0.25])), pin.SE3.Identity())
    return model


def through_python(monkeypatch):
    monkeypatch.setattr(pinocchio_calls, "_native_calls", lambda *_: None)


def terms(system):
    """All that kernels read of Pinocchio's data."""
    data, joints = system.data, range(1, system.model.njoints)
    parts = [np.triu(data.M), system.pinocchio.bias_forces, data.J]
    for j in joints:
        parts += [data.oMi[j].homogeneous, data.v[j].vector, data.a_gf[j].vector]
    return [np.array(part) for part in parts]


@here
@pytest.mark.parametrize("name", MODELS)
def test_the_same_numbers(name, monkeypatch):
    model = MODELS[name]()
    rng = np.random.default_rng(5)
    native = RunSystem(model, [])
    assert native.pinocchio.native is not None
    through_python(monkeypatch)
    plain = RunSystem(model, [])
    assert plain.pinocchio.native is None
    for _ in range(5):
        q, v = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv)), rng.normal(size=model.nv)
        for system in (native, plain):
            system.q[:], system.v[:] = q, v
            system.evaluate(0.0)
        for one, two in zip(terms(native), terms(plain), strict=True):
            # all terms at once, which small models get through Python, round otherwise
            assert np.allclose(one, two, rtol=1e-13, atol=1e-13)
        for system in (native, plain):
            system.data.J[:] = np.nan
            run_task(system.address, PROJECT_PLACES, 0.0, 0.0)
        assert np.allclose(native.data.J, plain.data.J, rtol=1e-13, atol=1e-13)


@here
@pytest.mark.parametrize("scene", ["ellipsoid_in_ellipsoid_slip_then_roll", "tripod_slide_straight"])
def test_runs_through_python_are_the_same(scene, monkeypatch):
    """To what tolerances leave of round-off in the terms."""
    options = {"rtol": 1e-9, "atol": 1e-11, "t_eval": np.linspace(0.0, 0.3, 7)}
    one = pc.simulate(*build(scene, native=True), 0.3, **options)
    through_python(monkeypatch)
    two = pc.simulate(*build(scene, native=True), 0.3, **options)
    assert one.status == two.status == 0
    assert one.stats["rhs"] == two.stats["rhs"]
    assert np.abs(one.q - two.q).max() < 1e-11
    assert np.abs(one.v - two.v).max() < 1e-11


@here
@pytest.mark.parametrize("scene", ["ellipsoid_in_ellipsoid_slip_then_roll", "tripod_slide_straight"])
def test_repeated_midpoints_through_python_are_the_same(scene, monkeypatch):
    """Long steps are corrected: compiled calls then leave the mass matrix, Python's make it anew."""
    options = {"method": "Moreau", "step": 0.03, "t_eval": np.linspace(0.0, 0.3, 11)}
    one = pc.simulate(*build(scene, native=True), 0.3, **options)
    through_python(monkeypatch)
    two = pc.simulate(*build(scene, native=True), 0.3, **options)
    assert one.status == two.status == 0
    assert one.stats["cone_problems"] == two.stats["cone_problems"] > one.stats["steps"]
    # long as the steps are, the last correction that is left out is below 1e-12
    assert max(np.abs(track.gap).max() for track in one.contacts.values()) <= 1e-12
    assert np.abs(one.q - two.q).max() < 1e-11
    assert np.abs(one.v - two.v).max() < 1e-10


@here
def test_a_missing_function_means_calls_through_python(monkeypatch):
    monkeypatch.setattr(pinocchio_calls, "_MASS_MATRIX", "no_such_function")
    for cached in (pinocchio_calls._functions, pinocchio_calls._agrees):
        cached.cache_clear()
    try:
        assert RunSystem(free_body(), []).pinocchio.native is None
    finally:
        monkeypatch.undo()
        for cached in (pinocchio_calls._functions, pinocchio_calls._agrees):
            cached.cache_clear()
    assert RunSystem(free_body(), []).pinocchio.native is not None


@here
def test_a_function_that_does_something_else_is_not_used(monkeypatch):
    """Two functions of the same arguments, exchanged: the check on a small model notices."""
    real = pinocchio_calls._functions
    inverse_dynamics, mass_matrix, places = real()
    monkeypatch.setattr(pinocchio_calls, "_functions", lambda: [places, mass_matrix, places])
    pinocchio_calls._agrees.cache_clear()
    try:
        assert RunSystem(free_body(), []).pinocchio.native is None
    finally:
        monkeypatch.undo()
        pinocchio_calls._agrees.cache_clear()
    assert inverse_dynamics != places
    assert RunSystem(free_body(), []).pinocchio.native is not None


def test_only_models_are_taken_for_such():
    model = free_body()
    data = model.createData()
    assert pinocchio_calls._address_of_model(data) == 0
    for other in (object(), 5, np.zeros(9), pin.SE3.Identity().translation):
        assert pinocchio_calls._address_of_object(other) == 0


@here
def test_addresses_are_those_of_the_objects():
    """A number written to the model in C++'s memory is seen by Python."""
    model = free_body()
    address = pinocchio_calls._address_of_model(model)
    first = ctypes.c_int.from_address(address)
    assert first.value == model.nq == 7
    first.value = 8
    try:
        assert model.nq == 8
    finally:
        first.value = 7


def grow(model):
    model.addJoint(1, pin.JointModelRX(), pin.SE3.Identity(), "another")


def split(model):
    """Two joints with as many coordinates as the one had."""
    other = pin.Model()
    joint = other.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "first")
    other.addJoint(joint, pin.JointModelSpherical(), pin.SE3.Identity(), "second")
    assert (other.nq, other.nv) == (model.nq, model.nv)
    model.loadFromString(other.saveToString())


@pytest.mark.parametrize(("change", "says"), [(grow, "size"), (split, None)])
def test_a_model_of_another_size_raises(change, says):
    """C++ would throw through compiled code, and end the process."""
    model = free_body()
    system = RunSystem(model, [])
    system.evaluate(0.0)
    change(model)
    with pytest.raises((ValueError, RuntimeError), match=says):
        system.evaluate(0.0)


def test_calls_are_made_of_arrays_that_stay(monkeypatch):
    calls = PinocchioCalls(model := free_body(), model.createData(), pin.neutral(model), np.zeros(model.nv))
    through_python(monkeypatch)
    one = PinocchioCalls(model, model.createData(), pin.neutral(model), np.zeros(model.nv))
    for made in (calls, one):
        # the same numbers, by address or through Python
        assert [function for function, _ in made.algorithms] == [pin.rnea, pin.crba]
        assert [len(arguments) for _, arguments in made.algorithms] == [5, 4]
