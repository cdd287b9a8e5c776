"""What a scene doesn't need is not computed: the counts of `run.stats`."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "benchmarks"))

from skipped import CASES

NOTHING_UNDECIDED = ("disk, frictionless", "disk, rolling (`NoSlip`)", "ball, clear slip", "ball, rolling (`Coulomb`)")


@pytest.fixture(scope="module")
def stats():
    return {name: case().stats for name, case in CASES.items()}


@pytest.mark.parametrize("name", NOTHING_UNDECIDED)
def test_no_cone_problem_where_nothing_is_undecided(stats, name):
    """Also no QP: it is one way to solve them. Rolling well inside the cone is tried before any problem is set up."""
    assert stats[name]["cone_problems"] == stats[name]["qp"] == 0


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


def test_one_pinocchio_call_an_evaluation_and_few_for_an_output(stats):
    for counts in stats.values():
        assert counts["pinocchio"] == counts["rhs"]
    one, many = stats["disk, rolling (`NoSlip`)"], stats["disk, 101 outputs"]
    assert (one["outputs"], many["outputs"]) == (1, 101)
    assert many["steps"] == one["steps"]
    # three stages a step for the interpolant; each output is projected, with one evaluation to check on it
    assert many["rhs"] - one["rhs"] <= 3 * many["steps"] + 100 * 3
