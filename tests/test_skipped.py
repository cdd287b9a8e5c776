"""What a scene doesn't need is not computed: the counts of `run.stats`."""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc
from pincontact.dynamics import pinocchio_calls

sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "benchmarks"))

import skipped
from skipped import CASES

NOTHING_UNDECIDED = ("disk, frictionless", "disk, rolling (`NoSlip`)", "ball, clear slip", "ball, rolling (`Coulomb`)")


@pytest.fixture(scope="module")
def stats():
    return {name: case().stats for name, case in CASES.items()}


@pytest.mark.parametrize("name", NOTHING_UNDECIDED)
def test_no_cone_problem_where_nothing_is_undecided(stats, name):
    """Also no QP: it is one way to solve them. Rolling well inside the cone is tried before any problem is set up."""
    assert stats[name]["cone_problems"] == stats[name]["qp"] == 0


@pytest.mark.parametrize("name", NOTHING_UNDECIDED)
def test_no_program_where_nothing_is_undecided(stats, name, monkeypatch):
    """Nor if programs are asked for: all counts are the same."""
    simulate = pc.simulate
    monkeypatch.setattr(pc, "simulate", lambda *given, **options: simulate(*given, **options, contact_solver="proxqp"))
    counts, usual = CASES[name]().stats, dict(stats[name])
    assert counts["qp"] == 0
    assert {**counts, "wall_time": 0.0} == {**usual, "wall_time": 0.0}


def test_no_newton_for_closed_forms(stats):
    for name in ("disk, frictionless", "ball slips, then rolls", "ball on a heaving plate"):
        assert stats[name]["newton"] == 0
        assert stats[name]["closed_form"] >= stats[name]["rhs"]
    assert stats["ball on waves"]["newton"] > stats["ball on waves"]["rhs"]
    assert stats["ball on waves"]["closed_form"] == 0


def test_no_time_derivatives_without_drives(stats):
    for name, counts in stats.items():
        if name == "ball on a heaving plate":
            assert counts["drives"] == counts["rhs"]
        else:
            assert counts["drives"] == 0, name


def test_free_flight_forms_no_constraint_rows(stats):
    """Nothing but the gap: one location an evaluation."""
    counts = stats["ball in free flight"]
    assert counts["contact_rows"] == 0
    assert counts["closed_form"] == counts["rhs"]
    assert counts["cone_problems"] == 0


def test_no_contact_no_contact_work(stats):
    counts = stats["free body, no contact"]
    assert counts["contact_rows"] == counts["closed_form"] == counts["newton"] == 0


@pytest.mark.parametrize("name", ["disk, rolling (`NoSlip`)", "ball slips, then rolls", "disk, 101 outputs"])
def test_one_pinocchio_call_an_evaluation(name, monkeypatch):
    """Counted where Pinocchio is called: through Python, which does what compiled calls do."""
    calls = []

    def counted(function):
        def call(*arguments):
            calls.append(function)
            return function(*arguments)

        return call

    def begin(scene, q, v, free=(), **options):
        # what finding the contact costs is not the run's
        state = scene.initial_state(q, v, free=free)
        monkeypatch.setattr(pinocchio_calls, "_native_calls", lambda *_: None)
        for algorithm in ("rnea", "computeJointJacobiansTimeVariation"):
            monkeypatch.setattr(pin, algorithm, counted(getattr(pin, algorithm)))
        return pc.simulate(scene, state, 1.0, **{"t_eval": [1.0], **options})

    monkeypatch.setattr(skipped, "run", begin)
    run = CASES[name]()
    # and one when the run's arrays are made
    assert len(calls) == run.stats["pinocchio"] + 1 == run.stats["rhs"] + 1


def test_outputs_cost_few_evaluations(stats):
    one, many = stats["disk, rolling (`NoSlip`)"], stats["disk, 101 outputs"]
    assert (one["outputs"], many["outputs"]) == (1, 101)
    assert many["steps"] == one["steps"]
    # three stages a step for the interpolant; each output is projected, with one evaluation to check on it
    assert many["rhs"] - one["rhs"] <= 3 * many["steps"] + 100 * 3


def test_outputs_of_time_stepping_cost_no_evaluation():
    """A run of which only q and v are asked is not evaluated at its outputs; who asks for contacts gets true modes."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    joint = model.addJoint(joint, pin.JointModelPZ(), pin.SE3.Identity(), "lift")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    scene = pc.Scene(model)
    tip = scene.add_contour("tip", pc.Point(), frame="lift")
    scene.add_contact("tip/floor", tip, scene.add_contour("floor", pc.Plane()), friction=pc.Coulomb(mu=0.4))
    state = scene.initial_state(np.zeros(2), np.zeros(2))

    def push(t, q, v):
        # beyond the limit of 3.92 N from t = 0.1 on
        return np.array([39.24 * t, 0.0])

    options = {"method": "Moreau", "step": 0.01, "control": push}
    many = pc.simulate(scene, state, 0.2, t_eval=np.linspace(0.0, 0.2, 21), **options)
    one = pc.simulate(scene, state, 0.2, t_eval=[0.2], **options)
    assert many.stats["pinocchio"] == one.stats["pinocchio"]
    # at rest until the end of the step at whose end the push is too much, by a step's share
    track = many.contacts["tip/floor"]
    assert list(track.mode[:10]) == [1] * 10
    assert list(track.mode[11:]) == [2] * 10
    assert np.allclose(track.tangential_force[:10], 39.24 * many.t[:10], atol=1e-12)
    assert np.allclose(track.tangential_force[11:], 0.4 * 9.81, atol=1e-12)
    # asked for once, it stays, whatever the scene's cached system, which has been put back, does next
    found = many.state(10).discrete.tobytes()
    again = pc.simulate(scene, state, 0.2, t_eval=[0.2], **options)
    assert many.state(10).discrete.tobytes() == found
    assert again.q.tobytes() == one.q.tobytes()
