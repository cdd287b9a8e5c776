"""The sequence of ProxQP programs as the solver of Coulomb's law: its rates, its solutions, and runs that use it."""

import importlib.util
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
import reference
from shared import rotation
from test_moreau import block_scene

import pincontact as pc
from pincontact.friction.loads import Loads, LoadSolver
from pincontact.friction.proxqp import ConePrograms
from pincontact.friction.solve import OPEN, SLIP, STICK, ContactSolver, solve_contacts


def feet(rng, contacts):
    """Points of one body: redundant from three on."""
    jacobian = np.zeros((3 * contacts, 6))
    for i in range(contacts):
        x, y, z = rng.uniform(-1.0, 1.0, 3)
        basis = rotation(rng)
        if basis[2] @ (x, y, z) > 0.0:
            basis[[0, 2]] *= -1.0
        jacobian[3 * i : 3 * i + 3] = basis @ np.c_[np.eye(3), [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]]
    return jacobian @ jacobian.T, jacobian @ (rng.normal(size=6) - [0, 0, 2, 0, 0, 0]), rng.uniform(0.0, 1.0, contacts)


def dense(rng, contacts, rank):
    jacobian = rng.normal(size=(3 * contacts, rank))
    mu = rng.choice([0.0, 0.3, 1.0, 5.0, 10.0], contacts)
    return jacobian @ jacobian.T, jacobian @ rng.normal(size=rank), mu


def errors(delassus, b, mu, forces):
    """Largest violation of Coulomb's law, relative to b: cones, no pull, no approach, and power of what presses."""
    f, u = forces.reshape(-1, 3), (delassus @ forces + b).reshape(-1, 3)
    speed, tangential = np.hypot(u[:, 0], u[:, 1]), np.hypot(f[:, 0], f[:, 1])
    largest, force = np.abs(b).max(), np.abs(forces).max() + 1e-300
    power = f[:, 2] * u[:, 2] + (f[:, :2] * u[:, :2]).sum(axis=1) + mu * speed * f[:, 2]
    return max(
        (tangential - mu * f[:, 2]).max() / force,
        -f[:, 2].min() / force,
        -u[:, 2].min() / largest,
        np.abs(f[:, 2] * u[:, 2]).max() / (force * largest),
        np.abs(power).max() / (force * largest),
    )


def alone(**options):
    """A solver that has nothing but the programs."""
    return ContactSolver(stages=("qp",), contact_solver="proxqp", **options)


@pytest.mark.parametrize("contacts, count", [(1, 40), (2, 60), (4, 60), (8, 60), (16, 30)])
@pytest.mark.parametrize("redundant", [False, True], ids=["independent", "redundant"])
def test_random_problems_are_solved_without_help(contacts, count, redundant):
    rng, solver, solved = np.random.default_rng(contacts), alone(), 0
    for k in range(count):
        rank = int(rng.integers(contacts, 3 * contacts)) if redundant else 3 * contacts + 3
        problem = feet(rng, contacts) if redundant and k % 2 else dense(rng, contacts, rank)
        solver.forget()
        if solver.solve(*problem):
            solved += 1
            assert solver.decided_by == "qp"
            assert solver.residual <= 1e-10
            assert errors(*problem, solver.forces) <= 1e-9
    assert solved >= count - 1
    assert solver.decided["qp"] == solved
    assert solver.program_counts["qp_failures"] == count - solved
    # a sequence is short, its first program often enough
    assert count <= solver.qp_count <= 6 * count
    assert solver.program_counts["qp_iterations"] >= solver.qp_count


def test_forces_are_the_homotopys_where_these_are_unique():
    rng, solver, path = np.random.default_rng(3), alone(), ContactSolver(stages=("path",))
    for contacts in (2, 3, 4, 8) * 5:
        factor = np.eye(3 * contacts) + 0.1 * rng.normal(size=(3 * contacts, 3 * contacts)) / np.sqrt(contacts)
        problem = factor @ factor.T, rng.normal(size=3 * contacts), rng.uniform(0.0, 0.5, contacts)
        solver.forget()
        path.forget()
        assert solver.solve(*problem) and path.solve(*problem)
        np.testing.assert_allclose(solver.forces, path.forces, rtol=0.0, atol=1e-12 * np.abs(path.forces).max())
        np.testing.assert_array_equal(solver.modes, path.modes)


def test_all_modes_and_coefficients_from_none_to_infinite():
    b = np.tile([3.0, -1.0, -1.0], 4)
    mu = np.array([0.0, 0.5, 1e6, np.inf])
    solution = solve_contacts(np.eye(12), b, mu, contact_solver="proxqp")
    assert solution.modes.tolist() == [SLIP, SLIP, STICK, STICK]
    np.testing.assert_allclose(solution.forces[:, 2], 1.0, rtol=1e-12)
    np.testing.assert_allclose(solution.forces[1, :2], -0.5 * np.array([3.0, -1.0]) / np.sqrt(10.0), rtol=1e-12)
    np.testing.assert_allclose(solution.velocities[2:], 0.0, atol=1e-12)
    assert solution.qp_count >= 1
    away = solve_contacts(np.eye(6), np.tile([1.0, 0.0, 1.0], 2), 0.5, contact_solver="proxqp")
    assert away.modes.tolist() == [OPEN, OPEN]


def test_units_do_not_matter():
    rng = np.random.default_rng(5)
    delassus, b, mu = dense(rng, 4, 15)
    solver = alone()
    assert solver.solve(delassus, b, mu)
    forces = solver.forces.copy()
    units = np.repeat(10.0 ** rng.uniform(-4.0, 4.0, 4), 3)
    solver.forget()
    assert solver.solve(units[:, None] * delassus * units, 1e5 * units * b, mu)
    np.testing.assert_allclose(solver.forces * units / 1e5, forces, rtol=1e-8, atol=1e-10 * np.abs(forces).max())


def test_warm_starts_take_fewer_programs_and_fewer_than_cold_ones():
    rng, cold, warm = np.random.default_rng(11), alone(), alone()
    for _ in range(40):
        delassus, b, mu = dense(rng, 8, 27)
        start = alone()
        if not start.solve(delassus, b, mu):
            continue
        nearby = b + 1e-4 * rng.normal(size=24)
        warm.forget()
        cold.forget()
        assert cold.solve(delassus, nearby, mu)
        before = warm.qp_count
        warm.warm_start(*start.kept())
        assert warm.solve(delassus, nearby, mu)
        assert warm.qp_count - before <= 3
        assert errors(delassus, nearby, mu, warm.forces) <= 1e-9
    assert 40 <= warm.qp_count <= 44 < cold.qp_count


def test_what_has_no_solution_is_refused_and_proved():
    # two jaws that close on a rigid body
    normal = np.array([[1.0, -1.0], [-1.0, 1.0]])
    delassus = np.zeros((6, 6))
    delassus[2::3, 2::3] = normal
    delassus[:2, :2] = delassus[3:5, 3:5] = np.eye(2)
    b = np.tile([0.3, 0.0, -1.0], 2)
    solver = alone()
    assert not solver.solve(delassus, b, np.full(2, 0.5))
    assert solver.program_counts["qp_failures"] == 1
    with pytest.raises(pc.InfeasibleError) as error:
        solve_contacts(delassus, b, 0.5, contact_solver="proxqp")
    assert (error.value.certificate > 0.0).all()


def test_a_failed_sequence_leaves_everything_as_it_was_and_others_take_over():
    solver = ContactSolver(contact_solver="proxqp")
    delassus, b, mu = dense(np.random.default_rng(2), 4, 15)
    # Newton's method is never content, so that no program helps
    programs = ConePrograms(4)
    forces = np.arange(12.0)
    assert not programs.solve(delassus, b, mu, forces, False, lambda: False, programs=2)
    assert (programs.programs, programs.failures) == (6, 1)
    assert not programs.solve(delassus, b, mu, forces, True, lambda: False, programs=2)
    assert programs.programs == 6 + 8
    assert solver.solve(delassus, b, mu)
    kept = solver.kept()
    bad = b.copy()
    bad[0] = np.nan
    assert not solver.solve(delassus, bad, mu)
    for mine, before in zip(solver.kept(), kept, strict=True):
        np.testing.assert_array_equal(mine, before)
    solver.renew()
    assert solver.program_counts == {"qp": 0, "qp_iterations": 0, "qp_failures": 0}


def _note(ways, forces):
    ways.append(forces.tobytes())


class Inaccurate:
    """ProxQP with results that differ by as much as they do with the place of its factors in memory."""

    def __init__(self, qp, seed):
        self._qp, self._rng = qp, np.random.default_rng(seed)
        self.update, self.solve = qp.update, qp.solve

    @property
    def results(self):
        x, z = np.array(self._qp.results.x), np.array(self._qp.results.z)
        x += 3e-9 * np.abs(x).max() * self._rng.normal(size=x.size)
        return SimpleNamespace(x=x, z=z * (1.0 + 1e-4 * self._rng.normal(size=z.size)), info=self._qp.results.info)


@pytest.mark.parametrize("make", [feet, lambda rng, contacts: dense(rng, contacts, 3 * contacts)])
def test_the_same_problem_gives_the_same_bits_whatever_digits_proxqp_has(make):
    """Redundant contacts, too, in whose null space next to nothing decides."""
    rng = np.random.default_rng(8)
    for contacts in (4, 8):
        problem, found = make(rng, contacts), set()
        for seed in range(20):
            forces, ways, programs = np.zeros(3 * contacts), [], ConePrograms(contacts)
            programs._qp = Inaccurate(programs._qp, seed)
            programs.solve(*problem, forces, False, partial(_note, ways, forces), programs=4)
            found.add(tuple(ways))
        assert len(found) == 1
        assert len(set(ways)) > 6


def test_steppers_go_on_alike_wherever_in_memory():
    """Feet that stick and slip, of which some steps have several solutions: the last bit of a program decides."""
    scene, state = block_scene(0.3)
    torques = np.random.default_rng(0).normal(size=(90, 6))
    stepper = pc.Stepper(scene, state, contact_solver="proxqp")
    stepper.rollout(torques[:60])
    # memory is given out in multiples of 16 bytes, of which vector instructions take four at once
    twins, padding = [], []
    for i in range(8):
        padding.append(np.zeros(2 * i + 1))
        twins.append(stepper.copy())
        twins[-1].step(torques[60])
    ends = {twin.rollout(torques[61:])[1].tobytes() for twin in twins}
    assert len(ends) == 1
    assert stepper._step.stats["qp"] > 60


def test_other_names_are_refused():
    with pytest.raises(pc.ArgumentError, match="contact_solver must be one of"):
        ContactSolver(contact_solver="admm")
    with pytest.raises(pc.ArgumentError, match="contact_solver must be one of"):
        solve_contacts(np.eye(3), np.zeros(3), 0.5, contact_solver="pgs")
    scene, state = block()
    with pytest.raises(pc.ArgumentError, match="contact_solver must be one of"):
        pc.simulate(scene, state, 0.1, contact_solver="qp")
    with pytest.raises(pc.ArgumentError, match="contact_solver must be one of"):
        pc.Stepper(scene, state, contact_solver=None)


def block(mu=0.4, height=0.1, velocity=(0.8, 0.3, 0.0, 0.0, 0.0, 2.0)):
    """A block on four feet."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(2.0, 0.6, 0.4, 0.2), pin.SE3.Identity())
    model.addBodyFrame("block", joint, pin.SE3.Identity(), model.addJointFrame(joint))
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    for i, (x, y) in enumerate(((0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2))):
        placement = pin.SE3(np.eye(3), np.array([x, y, -0.1]))
        foot = scene.add_contour(f"foot {i}", pc.Point(), frame="block", placement=placement)
        scene.add_contact(f"foot {i}/floor", foot, floor, friction=pc.Coulomb(mu))
    return scene, scene.initial_state(np.array([0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0]), np.array(velocity))


def push(t, q, v):
    """Slides, comes to rest, and is pushed on."""
    return np.array([9.5 * np.sin(4.0 * t), 0.0, 0.0, 0.0, 0.0, 0.3])


@pytest.mark.parametrize("method, duration", [("DOP853", 1.0), ("Moreau", 0.5)])
@pytest.mark.parametrize("height", [0.1, 0.15], ids=["on the floor", "falls"])
def test_a_block_on_four_feet_moves_as_it_does_otherwise(method, duration, height):
    scene, state = block(height=height)
    runs = {
        name: pc.simulate(scene, state, duration, method=method, control=push, contact_solver=name)
        for name in ("auto", "proxqp")
    }
    usual, run = runs["auto"], runs["proxqp"]
    assert run.success and usual.success
    np.testing.assert_allclose(run.t, usual.t, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(run.q, usual.q, rtol=0.0, atol=1e-12)
    # how feet that slide share the load is a matter of choice, made to round-off in both
    np.testing.assert_allclose(run.v, usual.v, rtol=0.0, atol=1e-12)
    stats = run.stats
    assert usual.stats["qp"] == usual.stats["qp_iterations"] == 0
    assert stats["qp_failures"] == 0
    assert stats["cone_problems"] <= stats["qp"] <= 3 * stats["cone_problems"] + 10
    if method == "Moreau":
        assert stats["cone_problems"] > 0
        assert set(name for name, count in stats["decided"].items() if count) == {"qp"}


def test_a_stepper_uses_it_and_a_later_run_of_the_scene_does_not():
    scene, state = block()
    steppers = [pc.Stepper(scene, state, 1e-3, contact_solver=name) for name in ("auto", "proxqp")]
    for _ in range(200):
        for stepper in steppers:
            stepper.step(np.array([8.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(steppers[1].q, steppers[0].q, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(steppers[1].v, steppers[0].v, rtol=0.0, atol=1e-9)
    # a copy goes on with the same solver
    twin, problems = steppers[1].copy(), steppers[1]._step.stats["cone_problems"]
    assert problems > 0
    for one in (twin, steppers[1]):
        one.step(np.array([8.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert twin._step.stats["decided"]["qp"] > 0
    np.testing.assert_array_equal(twin.v, steppers[1].v)
    assert pc.simulate(scene, state, 0.01, method="Moreau", contact_solver="proxqp").stats["qp"] > 0
    assert pc.simulate(scene, state, 0.01, method="Moreau").stats["qp"] == 0


def example(name):
    file = Path(__file__).parent.parent / "examples" / f"{name}.py"
    specification = importlib.util.spec_from_file_location(name, file)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "method, duration, options", [("Moreau", 0.8, {"step": 1e-3}), ("DOP853", 0.7, {"rtol": 1e-9})]
)
def test_a_quadruped_slips_as_it_does_otherwise(method, duration, options):
    module = example("quadruped")
    scene = module.quadruped()
    state = module.standing(scene)
    holding = pc.inverse_dynamics(scene, state).tau

    def control(t, q, v):
        tau = holding.copy()
        tau[6:] -= module.STIFFNESS * (q[7:] - state.q[7:]) + module.DAMPING * v[6:]
        tau[:3] += pin.Quaternion(q[3:7]).matrix()[0] * 16.0 * t / 1.2
        return tau

    usual, run = (
        pc.simulate(scene, state, duration, method=method, control=control, contact_solver=name, **options)
        for name in ("auto", "proxqp")
    )
    assert run.success and [event.kind for event in run.events] == ["slip"]
    for mine, other in ((run.t, usual.t), (run.q, usual.q), (run.v, usual.v)):
        np.testing.assert_allclose(mine, other, rtol=0.0, atol=1e-9)
    # one foot alone at its limit slips against its friction: there is nothing to decide
    assert method == "DOP853" or run.stats["cone_problems"] > 0
    assert run.stats["qp_failures"] == 0
    assert run.stats["cone_problems"] <= run.stats["qp"] <= 1.1 * run.stats["cone_problems"]
    assert usual.stats["qp"] == 0


def test_of_several_solutions_of_an_impact_it_finds_the_usual_one():
    """A bicycle that has fallen: the rear wheel touches, and the front one may stay or be thrown off."""
    module = example("bicycle")
    scene = module.bicycle()
    usual, run = (
        pc.simulate(scene, module.running(scene, 3.0, 0.05), 3.7, rtol=1e-9, contact_solver=name)
        for name in ("auto", "proxqp")
    )
    assert run.success and run.stats["qp"] > run.stats["cone_problems"] > 0
    assert [(event.kind, event.contact) for event in run.events] == [(e.kind, e.contact) for e in usual.events]
    np.testing.assert_allclose(run.q[-1], usual.q[-1], rtol=0.0, atol=1e-9)


WITH_FRICTION = [
    name
    for name, scene in reference.SPECIFICATIONS.items()
    if any(map(reference.friction_of, scene["contacts"], scene["mode0"]))
]


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize("name", WITH_FRICTION)
def test_reference_scenes_move_as_they_do_otherwise(name, method):
    # searches for second places, which formulas of shapes ask for, are the same in both runs
    scene, state = reference.build(name, native=name in reference.NATIVE_NAMES)
    end = float(reference.reference(name)["t"][-1])
    options, end = ({"rtol": 1e-10, "atol": 1e-12}, end) if method == "DOP853" else ({"step": 1e-3}, min(end, 0.4))
    usual, run = (
        pc.simulate(scene, state, end, method=method, contact_solver=choice, **options) for choice in ("auto", "proxqp")
    )
    for mine, other in ((run.t, usual.t), (run.q, usual.q), (run.v, usual.v)):
        np.testing.assert_allclose(mine, other, rtol=0.0, atol=1e-9)
    assert run.stats["qp_failures"] == 0
    assert run.stats["cone_problems"] <= run.stats["qp"] and usual.stats["qp"] == 0
    assert method == "DOP853" or run.stats["cone_problems"] > 0


def test_outputs_of_time_stepping_are_solved_by_programs_too(monkeypatch):
    """Their modes are found when somebody asks for them: a disk that comes to roll, with more friction than it has."""
    solved = []
    solve = ConePrograms.solve
    monkeypatch.setattr(ConePrograms, "solve", lambda self, *given: solved.append(1) or solve(self, *given))
    name = "disk_in_circular_bowl_slip_then_roll"
    end = float(reference.reference(name)["t"][-1])
    counts, modes = {}, {}
    for choice in ("auto", "proxqp"):
        run = pc.simulate(*reference.build(name), end, method="Moreau", step=1e-3, contact_solver=choice)
        solved.clear()
        modes[choice] = run.contacts["0"].mode
        counts[choice] = len(solved)
    assert counts["auto"] == 0 < counts["proxqp"]
    np.testing.assert_array_equal(modes["proxqp"], modes["auto"])


def test_problems_with_loads_begin_from_the_programs_guess():
    """Two loads that do not touch each other; only a start with both pressed has them in the first place."""
    both, none = np.ones(2), np.zeros(2)
    problem = Loads(np.eye(6), np.tile([0.0, 0.0, -1.0], 2), both, none, none, np.zeros(4), np.zeros((4, 6)))
    asked = []

    def guess(speed):
        asked.append(speed)
        return np.tile([0.0, 0.0, 1.0], 2)

    start = np.tile([0.0, 0.0, 1.0], 2)
    usual, first = LoadSolver(), LoadSolver(guess_first=True)
    assert usual.solve(problem, start, guess) and not asked
    assert first.solve(problem, start, guess) and len(asked) == 1 and first.unguessed == 0
    assert first.solve(problem, start, lambda speed: None) and first.unguessed == 1
    np.testing.assert_array_equal(first.forces, start)
