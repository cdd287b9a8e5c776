"""Inverse dynamics within friction cones and limits of efforts: random states, optimality, certificates, choices."""

import dataclasses
import math
import pickle
from collections import Counter
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from inverse_cases import by_pinocchio, check_case, random_case, solve, tasks
from scipy.optimize import lsq_linear, minimize

import pincontact as pc
from pincontact.analysis.inverse_program import _null as null_directions
from pincontact.friction import cone_least_squares
from pincontact.friction.cone_least_squares import ConeLeastSquares, Region

URDF = Path(__file__).resolve().parent.parent / "urdf"


# ---------------------------------------------------------------------------------- least squares within cones


def random_region(rng, n, cones=4, rows=6):
    apexes = np.column_stack([rng.normal(size=cones) + 0.3, rng.normal(size=(cones, 2))])
    matrix = rng.normal(size=(rows, n))
    low, high = -rng.uniform(0.0, 1.0, rows), rng.uniform(0.0, 1.0, rows)
    return Region(rng.normal(size=(cones, 3, n)) * [[0.7], [1.0], [1.0]], apexes, matrix, low, high)


def check_multipliers(region, found):
    """Signs, complementarity, and that the region holds the solution: with stationarity sufficient for the least."""
    assert region.contains(found.y, 1e-7)
    assert (np.hypot(found.cones[:, 1], found.cones[:, 2]) <= -found.cones[:, 0] + 1e-7).all()
    x = region.apexes + region.cones @ found.y
    # either factor is off by 1e-7, the other of sizes up to some tens
    np.testing.assert_allclose(np.einsum("mi,mi->m", x, found.cones), 0.0, atol=4e-6)
    ends = np.where(found.rows > 0.0, region.high, region.low)
    np.testing.assert_allclose(found.rows * (region.rows @ found.y - ends), 0.0, atol=4e-6)


def test_least_squares_within_cones_by_their_multipliers():
    """Also in a sequence, from the facets and multipliers of the problem before."""
    solved = refuted = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        n = 12
        matrix, right = rng.normal(size=(int(rng.integers(3, 13)), n)), 3.0 * rng.normal(size=n)
        right = right[: len(matrix)]
        region, level, guess = random_region(rng, n), ConeLeastSquares(), np.zeros(n)
        for k in range(3):
            changed = right * (1.0 + 1e-3 * k)
            found = level.solve(matrix, changed, region, guess)
            if found is None:
                break
            left = matrix.T @ (matrix @ found.y - changed) + found.rows @ region.rows
            left += np.einsum("mi,min->n", found.cones, region.cones)
            # ProxQP's accuracy where Newton's method does not finish
            np.testing.assert_allclose(left, 0.0, atol=1e-6)
            check_multipliers(region, found)
            guess, solved = found.y, solved + 1
        else:
            continue
        # no solution: multipliers of the least enlargement combine the limits to a contradiction
        wider = region.elastic()
        size = wider.rows.shape[1] - n
        picked = np.hstack([np.zeros((size, n)), np.eye(size)])
        elastic = ConeLeastSquares().solve(picked, np.zeros(size), wider, np.zeros(n + size))
        assert elastic is not None
        rows = elastic.rows[: len(region.rows)] + elastic.rows[len(region.rows) :]
        combined = np.einsum("mi,min->n", elastic.cones, region.cones) + rows @ region.rows
        np.testing.assert_allclose(combined, 0.0, atol=1e-6)
        ends = np.where(rows > 0.0, region.high, region.low)
        assert np.einsum("mi,mi->", elastic.cones, region.apexes) - rows @ ends > 1e-9
        refuted += 1
    assert solved > 45 and refuted > 3


def test_how_far_away_the_least_is_does_not_matter():
    """Optimal by its multipliers, which are as large as the distance, and as exact."""
    solved = exact = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(1, 12))
        matrix, far = rng.normal(size=(n, n)), 10.0 ** rng.uniform(0.0, 5.0)
        right, region = far * rng.normal(size=n), random_region(rng, n, cones=int(rng.integers(0, 3)))
        found = ConeLeastSquares().solve(matrix, right, region, np.zeros(n))
        near = ConeLeastSquares().solve(matrix, right / far, region, np.zeros(n))
        assert (found is None) == (near is None), seed
        if found is None:
            continue
        scale = max(1.0, float(np.abs(matrix.T @ right).max()))
        left = matrix.T @ (matrix @ found.y - right) + found.rows @ region.rows
        left += np.einsum("mi,min->n", found.cones, region.cones)
        np.testing.assert_allclose(left, 0.0, atol=1e-6 * scale)
        check_multipliers(region, dataclasses.replace(found, cones=found.cones / scale, rows=found.rows / scale))
        solved, exact = solved + 1, exact + found.exact
    assert solved > 30 and exact > 0.9 * solved, (solved, exact)


def test_facets_alone_come_to_the_same(monkeypatch):
    """Without Newton's method at the end the half-spaces are refined until no cone is left by more than 1e-7; where
    they become too much alike for ProxQP, nothing is returned."""
    solved = 0
    for seed in range(14):
        rng = np.random.default_rng(100 + seed)
        matrix, right, region = rng.normal(size=(12, 12)), 3.0 * rng.normal(size=12), random_region(rng, 12)
        exact = ConeLeastSquares().solve(matrix, right, region, np.zeros(12))
        if exact is None or not exact.exact:
            continue
        with monkeypatch.context() as patched:
            patched.setattr(cone_least_squares, "_finish", lambda *given: None)
            level = ConeLeastSquares()
            refined = level.solve(matrix, right, region, np.zeros(12))
        if refined is None:
            continue
        assert not refined.exact
        check_multipliers(region, refined)
        assert level.programs > 1
        solved += 1
        # within the facets' distance from the cones, by the objective's curvature
        np.testing.assert_allclose(refined.y, exact.y, rtol=0.0, atol=1e-2)
    assert solved > 3


def test_what_all_solutions_share():
    """The nearest to a point among all least-squares solutions, in two levels as `inverse_dynamics` has them, against
    one sum of both squares with a small weight: no solution is lost or added.

    The first level presses onto a ray of a cone, an apex and a row's end, or onto nothing, at random.
    """
    counts: Counter[str] = Counter()
    for seed in range(36):
        rng = np.random.default_rng(seed)
        n = 10
        region, target = random_region(rng, n, cones=4, rows=4), 3.0 * rng.normal(size=n)
        # the others far enough to be seldom at their limits in the first level, and often in the second
        region.apexes[2:, 0] += 3.0
        region.low[1:], region.high[1:] = -3.0, 3.0
        inside = ConeLeastSquares().solve(np.eye(n), np.zeros(n), region, np.zeros(n))
        if inside is None:
            continue
        # d . t - s <= 0 in the first cone, -s <= 0 in the second, and the first row's upper end
        angle, pressed = rng.uniform(0.0, 2.0 * np.pi), rng.random(3) < 0.5
        ray = np.array([-1.0, np.cos(angle), np.sin(angle)])
        onto = np.array([ray @ region.cones[0], -region.cones[1, 0], region.rows[0]])[pressed]
        ends = np.array([-ray @ region.apexes[0], region.apexes[1, 0], region.high[0]])[pressed]
        other = rng.normal(size=(1, n))
        matrix, right = np.vstack([onto, other]), np.append(ends + rng.uniform(0.5, 2.0), other @ inside.y)
        first = ConeLeastSquares().solve(matrix, right, region, np.zeros(n))
        # one that Newton's method did not finish says little of what solutions share
        if first is None or not first.exact:
            counts["unfinished"] += 1
            continue
        common = np.vstack([matrix, region.shared(first)])
        null = null_directions(common)
        inner = region.restricted(first.y, null, keep=True)
        second = ConeLeastSquares().solve(null, target - first.y, inner, np.zeros(null.shape[1]))
        if second is None:
            counts["unfinished"] += 1
            continue
        y = first.y + null @ second.y
        assert region.contains(y, 1e-6), seed
        # directions count as null below 1e-9 of the largest
        moved = 1e-9 * np.linalg.norm(common, 2) * np.linalg.norm(second.y)
        np.testing.assert_allclose(matrix @ y, matrix @ first.y, rtol=0.0, atol=moved + 1e-9)
        # the sum's solution is nearer by a part that falls with the square of the weight; one that Newton's method did
        # not finish is known to ProxQP's accuracy over that square, which says nothing
        far, apart = float(np.sum((y - target) ** 2)), math.inf
        for weight in (1e-2, 1e-3, 1e-4):
            both = np.vstack([matrix, weight * np.eye(n)])
            sums = ConeLeastSquares().solve(both, np.append(right, weight * target), region, y)
            if sums is not None and sums.exact:
                apart = min(apart, abs(far - float(np.sum((sums.y - target) ** 2))))
            if apart < 1e-2 * (1.0 + far):
                break
        if apart == math.inf:
            continue  # badly scaled, for ProxQP
        assert apart < 1e-2 * (1.0 + far), seed
        if null.shape[1]:
            counts.update(np.flatnonzero(pressed).tolist() if pressed.any() else ["none"])
            counts["second"] += int(np.abs(second.cones).max() > 1e-6 or np.abs(second.rows).max() > 1e-6)
    assert min(counts[kind] for kind in (0, 1, 2, "none", "second")) >= 3, counts
    # six or so, by the alignment of memory
    assert counts["unfinished"] <= 9, counts


# ---------------------------------------------------------------------------------- random states


@pytest.mark.parametrize("kind", ["quadruped", "arm"])
def test_random_states(kind):
    """Equations to round-off, cones and limits to 1e-6, Farkas for what is out of reach; a thousand in tests/stress."""
    outcomes = Counter(check_case(random_case(kind, seed)) for seed in range(16))
    assert outcomes["reached"] > 5
    assert outcomes["nearest"] > 1


def test_a_program_that_fails_proves_nothing(monkeypatch):
    """A point within all limits is looked for then, and what is nearest from there."""
    assert check_case(random_case("arm", 818)) == "nearest"
    case = random_case("arm", 0)
    expected, solve_as_ever, calls = solve(case, unreachable="nearest"), ConeLeastSquares.solve, []

    def fails_first(self, *problem):
        calls.append(problem)
        return None if len(calls) <= failures else solve_as_ever(self, *problem)

    monkeypatch.setattr(ConeLeastSquares, "solve", fails_first)
    failures = 1
    np.testing.assert_allclose(solve(case, unreachable="nearest").acceleration, expected.acceleration, atol=1e-9)
    calls.clear()
    failures = 100
    with pytest.raises(pc.SolverError, match="nor a reason why") as told:
        solve(case, unreachable="nearest")
    assert not isinstance(told.value, pc.InfeasibleError)


@pytest.mark.parametrize("seed", range(6))
def test_nearest_and_least_against_slsqp(seed):
    """The arm: nothing is nearer within cones and limits, and no efforts are less that make the same accelerations."""
    case = random_case("arm", seed)
    found, equations = solve(case, unreachable="nearest"), by_pinocchio(case)
    nv, limits, (mu, _) = case.scene.model.nv, case.scene.model.effortLimit, case.mu["pad"]
    frame, jacobian = equations.axes["pad"], equations.jacobians["pad"]
    kinematics = pc.analyze(case.scene, case.state)["pad"]
    rows = kinematics.rows if equations.sticks["pad"] else kinematics.rows[2:]
    bias = kinematics.bias[: len(rows)] if equations.sticks["pad"] else kinematics.bias[2:]
    load = max(1.0, float(np.abs(found.tau).max()), float(np.abs(found.forces["pad"]).max()))

    def split(x):
        # accelerations; efforts and force in parts of the load
        return x[:nv], load * x[nv : 2 * nv], load * frame.T @ x[2 * nv :]

    def balance(x):
        a, efforts, force = split(x)
        left = (equations.mass @ a + equations.nle - efforts - jacobian.T @ force) / load
        parts = [left, rows @ a + bias]
        if not equations.sticks["pad"]:
            parts.append(x[2 * nv : 2 * nv + 2] + mu * x[2 * nv + 2] * equations.slip["pad"])
        return np.concatenate(parts)

    def within(x):
        inside = [limits / load - x[nv : 2 * nv], limits / load + x[nv : 2 * nv], x[2 * nv + 2 :]]
        if equations.sticks["pad"]:
            inside.append([mu * x[2 * nv + 2] - math.sqrt(x[2 * nv] ** 2 + x[2 * nv + 1] ** 2 + 1e-24)])
        return np.concatenate(inside)

    wanted, goal = tasks(case)
    start = np.concatenate([found.acceleration, found.efforts / load, -frame @ found.forces["pad"] / load])
    assert np.abs(balance(start)).max() < 1e-9 and within(start).min() > -1e-6
    constraints = [{"type": "eq", "fun": balance}, {"type": "ineq", "fun": within}]
    rng = np.random.default_rng(seed)

    def distance(x):
        return float(np.sum((wanted @ x[:nv] - goal) ** 2))

    scale = 1.0 + distance(start)
    elsewhere = start + 1e-2 * rng.normal(size=start.size)
    options = {"maxiter": 500, "ftol": 1e-14}
    nearest = minimize(lambda x: distance(x) / scale, elsewhere, constraints=constraints, options=options)
    if np.abs(balance(nearest.x)).max() < 1e-7 and within(nearest.x).min() > -1e-7:
        assert distance(start) <= distance(nearest.x) + 1e-5 * scale
    same = [*constraints, {"type": "eq", "fun": lambda x: wanted @ (x[:nv] - found.acceleration)}]
    least = minimize(lambda x: float(np.sum(x[nv : 2 * nv] ** 2)), start, constraints=same, options=options)
    assert np.linalg.norm(found.efforts / load) <= np.linalg.norm(least.x[nv : 2 * nv]) + 1e-5


def test_warm_starts_change_nothing():
    """A sequence of wanted accelerations, from the last call's programs or each by itself; and few programs a call."""
    case = random_case("quadruped", 3)
    last, calls, programs = None, 40, 0
    for k in range(calls):
        case.wanted["root_joint"] = np.array([math.sin(0.05 * k), 0.3, -0.2, 0.1, math.cos(0.05 * k), 0.0])
        last = solve(case, unreachable="nearest", warm=last)
        alone = solve(case, unreachable="nearest")
        programs += sum(last.programs.values())
        # the least efforts are always asked for, the nearest accelerations only where those wanted are out of reach
        assert alone.programs["efforts"] > 0
        assert (alone.programs["accelerations"] > 0) >= (alone.certificate is not None)
        scale = 1.0 + np.abs(alone.efforts).max()
        np.testing.assert_allclose(last.efforts, alone.efforts, rtol=0.0, atol=1e-6 * scale)
        np.testing.assert_allclose(last.acceleration, alone.acceleration, rtol=0.0, atol=1e-5 * scale)
    assert calls <= programs < 4 * calls


def test_results_can_be_pickled():
    """As results; programs do not go along."""
    case = random_case("quadruped", 3)
    found = solve(case, unreachable="nearest")
    again = pickle.loads(pickle.dumps(found))
    np.testing.assert_array_equal(again.tau, found.tau)
    assert again.programs == found.programs and again.forces.keys() == found.forces.keys()
    with pytest.raises(pc.ArgumentError, match="warm must be the result"):
        solve(case, unreachable="nearest", warm=again)


@pytest.mark.parametrize("gear", [0.5, 2.0])
def test_limits_are_those_of_torques(gear):
    """`effortLimit` is the joint's, whatever the lever of the effort that drives it."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.02, 0.0, 0.0]), 0.2 * np.eye(3)), pin.SE3.Identity())
    model.effortLimit = np.array([0.3])
    scene = pc.Scene(model)
    found = pc.inverse_dynamics(
        scene, scene.initial_state([0.0]), [10.0], actuation=[[gear]], effort_limits=True, unreachable="nearest"
    )
    np.testing.assert_allclose(found.tau, 0.3, rtol=1e-9)
    np.testing.assert_allclose(found.efforts, 0.3 / gear, rtol=1e-9)
    # its weight turns it down, about +y
    np.testing.assert_allclose(found.acceleration, (0.3 + 9.81 * 0.02) / (0.2 + 0.02**2), rtol=1e-9)


@pytest.mark.parametrize("weightless", [False, True])
def test_limits_hold_however_far_away_the_wanted_accelerations_are(weightless):
    """Random arms, whose limits and wanted accelerations are of any size: nearest by SciPy's bounded least squares."""
    out_of_reach = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        model, joint = pin.Model(), 0
        for i in range(int(rng.integers(1, 5))):
            kind = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ, pin.JointModelPX)[rng.integers(4)]
            placement = pin.SE3(pin.Quaternion(*_unit(rng, 4)).matrix(), rng.normal(size=3))
            joint = model.addJoint(joint, kind(), placement, f"joint {i}")
            body = pin.Inertia(rng.uniform(0.5, 2.0), 0.3 * rng.normal(size=3), np.diag(rng.uniform(1.0, 1.5, 3)))
            model.appendBodyToJoint(joint, body, pin.SE3.Identity())
        if weightless:
            model.gravity = pin.Motion.Zero()
        q, data, nv = rng.normal(size=model.nq), model.createData(), model.nv
        mass, weight = pin.crba(model, data, q), pin.computeGeneralizedGravity(model, data, q)
        limits = np.abs(weight) + 10.0 ** rng.uniform(-2.0, 3.0, nv)
        model.effortLimit[:] = limits
        wanted = rng.normal(size=nv) * 10.0 ** rng.uniform(-4.0, 10.0)
        scene = pc.Scene(model)
        found = pc.inverse_dynamics(scene, scene.initial_state(q), wanted, effort_limits=True, unreachable="nearest")
        whitening = np.linalg.inv(np.linalg.cholesky(mass))
        goal = whitening @ (weight + mass @ wanted)
        nearest = lsq_linear(whitening, goal, (-limits, limits), method="bvls", tol=1e-14, max_iter=1000).x
        missed = float(np.linalg.norm(whitening @ nearest - goal))
        # to 1e-7 of the loads, which are up to ten times as large as efforts
        np.testing.assert_allclose(found.tau, nearest, rtol=0.0, atol=1e-6 * np.abs(nearest).max())
        assert (np.abs(found.tau) <= limits + 1e-6 * np.abs(nearest).max()).all()
        assert found.shortfall == pytest.approx(missed, rel=1e-6, abs=1e-8 * np.linalg.norm(goal))
        assert found.missed == pytest.approx(missed, rel=1e-6, abs=1e-8 * np.linalg.norm(goal))
        assert (found.certificate is not None) == (missed > 1e-7 * np.linalg.norm(goal))
        out_of_reach += found.certificate is not None
    assert 5 < out_of_reach < 40


def test_limits_of_joints_that_know_nothing_of_each_other():
    """Sliders with masses, limits and wanted accelerations of all sizes: the limit of one holds beside another that is
    to go any number of times as fast."""
    for seed in range(80):
        rng, count = np.random.default_rng(seed), 1 + seed % 4
        model, masses = pin.Model(), 10.0 ** rng.uniform(-1.0, 1.0, count)
        for i, mass in enumerate(masses):
            joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), f"slider {i}")
            model.appendBodyToJoint(joint, pin.Inertia.FromSphere(mass, 0.1), pin.SE3.Identity())
        limits = 10.0 ** rng.uniform(-2.0, 2.0, count)
        model.effortLimit[:] = limits
        wanted = rng.normal(size=count) * 10.0 ** rng.uniform(-3.0, 12.0, count)
        scene, options = pc.Scene(model), {"effort_limits": True, "unreachable": "nearest"}
        found = pc.inverse_dynamics(scene, scene.initial_state(np.zeros(count)), wanted, **options)
        efforts = np.clip(masses * wanted, -limits, limits)
        assert (np.abs(found.tau) <= limits + 1e-6 * np.abs(efforts).max()).all(), seed
        # errors of 1e-9 beside the largest that is wanted are not told from none
        seen = 1e-6 * np.abs(efforts).max() + 1e-9 * np.abs(wanted).max()
        np.testing.assert_allclose(found.tau, efforts, rtol=0.0, atol=seen, err_msg=str(seed))


def _unit(rng, n):
    direction = rng.normal(size=n)
    return direction / np.linalg.norm(direction)


def test_how_much_contacts_forbid_is_told():
    """A resting ball is to go downwards at 3 m/s^2 (with weight 4), or to turn at 2 rad/s^2 without rolling: it does
    what is nearest. Nothing is missed where nothing is forbidden."""
    scene, state = puck(pc.NoSlip())
    found = pc.inverse_dynamics(scene, state, {"root_joint": [0, 0, -3.0, 0, 0, 0]}, weights={"root_joint": 4.0})
    assert found.missed == pytest.approx(6.0, rel=1e-12) and found.shortfall == 0.0
    # least (r w)^2 + (w - 2)^2
    anything = {"actuation": np.eye(6)}
    found = pc.inverse_dynamics(scene, state, {"root_joint": [0, 0, 0, 0, 2.0, 0]}, **anything)
    assert found.acceleration[4] == pytest.approx(2.0 / 1.01, rel=1e-9)
    assert found.missed == pytest.approx(2.0 * math.sqrt(0.01 / 1.01), rel=1e-9) and found.certificate is None
    found = pc.inverse_dynamics(scene, state, {"root_joint": [0.2, 0, 0, 0, 2.0, 0]}, **anything)
    assert found.missed == pytest.approx(0.0, abs=1e-9)
    # nothing drives it
    found = pc.inverse_dynamics(scene, state, {"root_joint": [0.2, 0, 0, 0, 2.0, 0]})
    assert found.missed == pytest.approx(math.hypot(0.2, 2.0), rel=1e-9) and found.shortfall == 0.0
    # a vector, in the norm of the mass matrix
    mass = scene.model.inertias[1].mass
    found = pc.inverse_dynamics(scene, state, [0, 0, -3.0, 0, 0, 0], unreachable="nearest")
    assert found.missed == pytest.approx(3.0 * math.sqrt(mass), rel=1e-9)


@pytest.mark.parametrize("name", [3, "universe", "nobody"])
def test_names_of_what_moves_nothing_are_refused(name):
    case = random_case("quadruped", 3)
    case.wanted, case.weights = {name: [0.0, 0.0, 1.0]}, None
    with pytest.raises(pc.ArgumentError, match="no joint or frame"):
        solve(case)


def test_vectors_that_can_be_reached_are_as_without_limits():
    """Limits that do not matter change nothing."""
    case = random_case("quadruped", 1)
    model = case.scene.model
    model.effortLimit = np.full(model.nv, 1e3)
    q = case.state.q.copy()
    rest = case.scene.initial_state(q)
    plain = pc.inverse_dynamics(case.scene, rest)
    limited = pc.inverse_dynamics(case.scene, rest, np.zeros(model.nv), effort_limits=True)
    np.testing.assert_allclose(limited.efforts, plain.efforts, rtol=0.0, atol=1e-9 * np.abs(plain.efforts).max())
    for name, force in plain.forces.items():
        np.testing.assert_allclose(limited.forces[name], force, rtol=0.0, atol=1e-8)


# ---------------------------------------------------------------------------------- closed forms


def puck(friction, bilateral=False):
    """A ball of 2 kg on a floor, pulled by forces at its centre."""
    scene = pc.Scene.from_urdf(URDF / "ball.urdf", floating_base=True)
    ball, floor = scene.add_contour("ball", pc.Sphere(0.1), frame="ball"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", ball, floor, friction=friction, bilateral=bilateral)
    return scene, scene.initial_state([0, 0, 0.1, 0, 0, 0, 1])


def test_a_ball_that_is_pulled_at_its_rim_rolls_as_fast_as_friction_lets_it():
    """Only torques about its axes: friction alone drives it, at most mu g; the nearest to more is that."""
    mu, g = 0.3, 9.81
    scene, state = puck(pc.Coulomb(mu))
    torques = np.eye(6)[:, 3:]
    wanted = {"root_joint": [5.0, 0.0, 0.0, 0.0, 50.0, 0.0]}
    found = pc.inverse_dynamics(scene, state, wanted, actuation=torques, cones=True, unreachable="nearest")
    assert found.acceleration[0] == pytest.approx(mu * g, rel=1e-9)
    assert found.acceleration[4] == pytest.approx(mu * g / 0.1, rel=1e-9)
    assert list(found.certificate.contacts) == ["c"] and found.certificate.joints == ()
    # root of 1 + 1 / r^2 over the two rows, of what is missing
    assert found.shortfall == pytest.approx((5.0 - mu * g) * math.sqrt(1.0 + 100.0), rel=1e-9)
    with pytest.raises(pc.InfeasibleError, match=r"out of reach, by .* for the cone of contact 'c'"):
        pc.inverse_dynamics(scene, state, wanted, actuation=torques, cones=True)


def test_a_motor_that_is_too_weak_is_named():
    """It pushes a rolling ball of mass m on a rail: 7/5 m a of force for a. The nearest is what its limit makes."""
    model = pin.Model()
    along = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "along")
    up = model.addJoint(along, pin.JointModelPZ(), pin.SE3.Identity(), "up")
    spin = model.addJoint(up, pin.JointModelRY(), pin.SE3.Identity(), "spin")
    mass, limit, wanted = 2.0, 5.0, 4.0
    model.appendBodyToJoint(spin, pin.Inertia.FromSphere(mass, 0.1), pin.SE3.Identity())
    model.effortLimit[:] = limit
    scene = pc.Scene(model)
    scene.add_contour("ball", pc.Sphere(0.1), "spin")
    scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", "ball", "floor", pc.Coulomb(0.5))
    state = scene.initial_state([0.0, 0.1, 0.0])
    options = {"actuation": ["along"], "cones": True, "effort_limits": True}
    found = pc.inverse_dynamics(scene, state, {"along": [wanted]}, unreachable="nearest", **options)
    reached = limit / (1.4 * mass)
    assert found.acceleration[0] == pytest.approx(reached, rel=1e-9)
    assert found.efforts == pytest.approx([limit], rel=1e-9)
    assert found.shortfall == pytest.approx(wanted - reached, rel=1e-9)
    assert found.certificate.joints == ("along",) and not found.certificate.contacts
    with pytest.raises(pc.InfeasibleError, match=r"out of reach, by .* for the limit of joint 'along'\.$") as told:
        pc.inverse_dynamics(scene, state, {"along": [wanted]}, **options)
    assert told.value.certificate.wanted < told.value.certificate.least


def test_the_aim_of_an_elliptic_cone():
    """Driven diagonally, over twice as much friction across: the nearest point of an ellipse, by its normal."""
    along, across, g = 0.2, 0.4, 9.81
    scene, state = puck(pc.Coulomb((along, across), along="floor"))
    aim = np.array([6.0, 6.0])
    wanted = {"root_joint": [*aim, 0.0, -aim[1] / 0.1, aim[0] / 0.1, 0.0]}
    found = pc.inverse_dynamics(scene, state, wanted, actuation=np.eye(6)[:, 3:], cones=True, unreachable="nearest")
    x, y = found.acceleration[:2] / g
    assert math.hypot(x / along, y / across) == pytest.approx(1.0, rel=1e-9)
    away = aim / g - [x, y]
    normal = np.array([x / along**2, y / across**2])
    assert away[0] * normal[1] - away[1] * normal[0] == pytest.approx(0.0, abs=1e-8)


def test_contacts_push_only_and_open_without_force():
    """A ball that weighs on a floor cannot do without it; lifted by an actuator it opens the contact."""
    scene, state = puck(pc.Coulomb(0.3))
    free = {"c": np.zeros(3)}
    with pytest.raises(pc.InfeasibleError, match="whatever the accelerations, for the cone of contact 'c'") as error:
        pc.inverse_dynamics(scene, state, {}, actuation=np.eye(6)[:, 3:], cones=True, forces=free)
    # through the floor: forces have no power along the vertical, which it needs unless it falls
    assert error.value.certificate.wanted < error.value.certificate.least
    np.testing.assert_allclose(np.abs(error.value.certificate.velocity), [0, 0, 1, 0, 0, 0], atol=1e-9)
    up = {"root_joint": [0.0, 0.0, 3.0, 0.0, 0.0, 0.0]}
    lifted = pc.inverse_dynamics(scene, state, up, actuation=np.eye(6), cones=True, forces=free)
    assert lifted.acceleration[2] == pytest.approx(3.0, rel=1e-12)
    assert lifted.efforts[2] == pytest.approx(0.5 * (9.81 + 3.0), rel=1e-12)
    # pressed down on a contact that is to carry nothing it stays where it is
    down = pc.inverse_dynamics(
        scene, state, {"root_joint": [0, 0, -3.0, 0, 0, 0]}, actuation=np.eye(6), cones=True, forces=free,
        unreachable="nearest",
    )  # fmt: skip
    assert down.acceleration[2] == pytest.approx(0.0, abs=1e-9)
    assert list(down.certificate.contacts) == ["c"]


def test_rolling_resistance_is_a_cone_too():
    """A motor within a ball that is to hold it on a ramp: resistance to rolling helps by its length times the load."""
    length, slope = 4e-3, 0.2
    scene, state = puck(pc.Coulomb(0.5, rolling=length))
    model = scene.model
    model.gravity.linear = 9.81 * np.array([math.sin(slope), 0.0, -math.cos(slope)])
    still = np.zeros(6)
    needed = 0.5 * 9.81 * math.sin(slope) * 0.1
    held = pc.inverse_dynamics(scene, state, still, actuation=np.eye(6)[:, 3:], cones=True)
    limit = length * 0.5 * 9.81 * math.cos(slope)
    assert np.linalg.norm(held.efforts) == pytest.approx(needed - limit, rel=1e-9)
    (turn,) = held.held
    assert turn.within and np.linalg.norm(turn.torque) == pytest.approx(limit, rel=1e-9)


@pytest.mark.parametrize("up", [-1.0, 1.0])
def test_cones_of_contacts_that_cannot_open(up):
    """Pulled up by twice its weight or not, the ball's friction is limited by the size of the normal force."""
    mu = 0.3
    scene, state = puck(pc.Coulomb(mu), bilateral=True)
    wanted = {"root_joint": [50.0, 0.0, 0.0, 0.0, 500.0, 0.0]}
    scene.model.gravity.linear = np.array([0.0, 0.0, 9.81 * up])
    found = pc.inverse_dynamics(scene, state, wanted, actuation=np.eye(6)[:, 3:], cones=True, unreachable="nearest")
    assert found.acceleration[0] == pytest.approx(mu * 9.81, rel=1e-9)
    assert found.forces["c"][2] == pytest.approx(0.5 * 9.81 * up, rel=1e-9)


# ---------------------------------------------------------------------------------- redundant forces


def rover(speed, rate):
    """Two wheels and a caster of no friction, on a curve: the wheels' sideways constraints are one and the same."""
    scene = pc.Scene.from_urdf(URDF / "rover.urdf", floating_base=True)
    floor = scene.add_contour("floor", pc.Plane())
    axle = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    for name in ("left", "right"):
        tyre = scene.add_contour(name, pc.Torus(0.065, 0.015), f"{name}_wheel", axle)
        scene.add_contact(name, tyre, floor, friction=pc.Coulomb(0.8))
    centre = pin.SE3(np.eye(3), np.array([-0.16, 0.0, 0.03 - 0.08]))
    scene.add_contact("caster", scene.add_contour("caster", pc.Sphere(0.03), "base", centre), floor)
    model = scene.model
    q, v = pin.neutral(model), np.zeros(model.nv)
    q[2], v[0], v[5] = 0.08, speed, rate
    for name, side in (("left", 1.0), ("right", -1.0)):
        v[model.joints[model.getJointId(f"{name}_axle")].idx_v] = (speed - side * 0.17 * rate) / 0.08
    return scene, scene.initial_state(q, v)


def test_choices_of_redundant_forces():
    """Efforts and accelerations do not depend on the choice. Least: equal sideways forces; centred: in the middle of
    what the cones admit, more where there is more load; last: what was, as long as that is admissible."""
    scene, state = rover(0.9, 1.5)
    found = {}
    for redundant in ("least", "centred"):
        found[redundant] = pc.inverse_dynamics(scene, state, cones=True, redundant=redundant)
    found["last"] = pc.inverse_dynamics(scene, state, cones=True, redundant="last", warm=found["centred"])
    sideways = {}
    for redundant, one in found.items():
        np.testing.assert_allclose(one.efforts, found["least"].efforts, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(one.acceleration, found["least"].acceleration, rtol=0.0, atol=1e-9)
        assert one.residual < 1e-10
        sideways[redundant] = np.array([-one.forces[name][1] for name in ("left", "right")])
        for name in ("left", "right"):
            force = one.forces[name]
            assert math.hypot(force[0], force[1]) < -0.8 * force[2]
    total = sideways["least"].sum()
    np.testing.assert_allclose(sideways["least"], 0.5 * total, rtol=1e-9)
    assert sideways["centred"].sum() == pytest.approx(total, rel=1e-9)
    loads = np.array([-found["least"].forces[name][2] for name in ("left", "right")])
    # the inner wheel has less, which its share of the force follows
    assert (np.diff(loads) * np.diff(sideways["centred"]) > 0.0).all()
    assert abs(np.diff(sideways["centred"])[0]) > 0.1 * abs(total)
    np.testing.assert_allclose(sideways["last"], sideways["centred"], rtol=0.0, atol=1e-8)
    # without limits, too
    plain = pc.inverse_dynamics(scene, state)
    again = pc.inverse_dynamics(scene, state, redundant="last", warm=found["least"])
    for name, force in plain.forces.items():
        np.testing.assert_allclose(again.forces[name], force, rtol=0.0, atol=1e-9)


def test_choices_among_the_forces_of_a_run():
    """The run's accelerations need no efforts, whatever is chosen; the sum of what is redundant is the run's."""
    scene, state = rover(0.9, 1.5)
    run, k = pc.simulate(scene, state, 0.2), -1
    model = scene.model
    tau = -model.damping * run.v[k]
    a = pin.aba(model, model.createData(), run.q[k], run.v[k], tau, run.external_forces(k))
    axle = pin.Quaternion(run.q[k, 3:7]).matrix()[:, 1]
    total = sum(run.contacts[name].force[k] @ axle for name in ("left", "right"))
    sideways = {}
    for redundant in ("least", "centred"):
        found = pc.inverse_dynamics(scene, run.state(k), a, cones=True, redundant=redundant)
        np.testing.assert_allclose(found.efforts, 0.0, atol=1e-7)
        np.testing.assert_allclose(found.acceleration, a, rtol=0.0, atol=1e-7)
        sideways[redundant] = np.array([found.forces[name] @ axle for name in ("left", "right")])
        assert sideways[redundant].sum() == pytest.approx(total, abs=1e-7)
    assert np.diff(sideways["least"])[0] == pytest.approx(0.0, abs=1e-9)
    assert abs(np.diff(sideways["centred"])[0]) > 0.1 * abs(total)


# ---------------------------------------------------------------------------------- arguments


def test_bad_arguments():
    scene, state = puck(pc.Coulomb(0.3))
    other, elsewhere = puck(pc.Coulomb(0.3))

    def call(wanted=None, **options):
        return pc.inverse_dynamics(scene, state, wanted, actuation=np.eye(6), **options)

    with pytest.raises(pc.ArgumentError, match="no joint or frame 'ball_joint'"):
        call({"ball_joint": [0.0]})
    with pytest.raises(pc.StateError, match=r"acceleration\['root_joint'\] must have 6 entries, got 3"):
        call({"root_joint": np.zeros(3)})
    with pytest.raises(pc.StateError, match=r"acceleration\['ball'\]\[1\] is nan"):
        call({"ball": [0.0, math.nan, 0.0]})
    with pytest.raises(pc.ArgumentError, match="no acceleration of 'ball' is wanted"):
        call({}, weights={"ball": 1.0})
    with pytest.raises(pc.ArgumentError, match=r"weights\['ball'\] must be finite and not negative"):
        call({"ball": np.zeros(3)}, weights={"ball": -1.0})
    with pytest.raises(pc.StateError, match=r"weights must be one number or 6, got shape \(2,\)"):
        call(np.zeros(6), weights=[1.0, 2.0])
    with pytest.raises(pc.ArgumentError, match="must be a mapping from their names"):
        call({"ball": np.zeros(3)}, weights=1.0)
    with pytest.raises(pc.ArgumentError, match="not a mapping"):
        call(np.zeros(6), weights={"ball": 1.0})
    with pytest.raises(pc.ArgumentError, match="cones must be"):
        call(cones=1)
    with pytest.raises(pc.ArgumentError, match="unreachable must be one of 'error', 'nearest', got 'near'"):
        call(unreachable="near")
    with pytest.raises(pc.ArgumentError, match="redundant must be one of 'least', 'centred', 'last', got None"):
        call(redundant=None)
    with pytest.raises(pc.ArgumentError, match=r"warm must be the result .* got dict"):
        call(warm={})
    with pytest.raises(pc.ArgumentError, match=r"warm must be the result .* got one without"):
        call(warm=call())
    with pytest.raises(pc.ArgumentError, match="warm: the result belongs to another scene"):
        call(warm=pc.inverse_dynamics(other, elsewhere, actuation=np.eye(6), cones=True))
    with pytest.raises(pc.StateError, match="takes contact 'c' apart at"):
        call([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], cones=True)


def test_a_vector_that_actuators_miss_is_refused():
    """A body on two feet turns about the line through them as gravity has it, whatever holds its feet: nothing else
    drives that."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(joint, pin.Inertia(2.0, np.zeros(3), 0.05 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    scene, height = pc.Scene(model), 0.4
    floor = scene.add_contour("floor", pc.Plane())
    for name, y in (("left", 0.2), ("right", -0.2)):
        foot = scene.add_contour(name, pc.Point(), "body", placement=pin.SE3(np.eye(3), np.array([0.0, y, -height])))
        scene.add_contact(name, foot, floor, pc.Coulomb(0.8))
    state = scene.initial_state([0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0])
    sideways = [[0], [1], [0], [0], [0], [0]]
    tips = [height, 0.0, 0.0, 0.0, 1.0, 0.0]
    for options in ({}, {"cones": True}, {"redundant": "centred"}):
        with pytest.raises(pc.SolverError, match="the actuators and contacts"):
            pc.inverse_dynamics(scene, state, tips, actuation=sideways, **options)
    nearest = pc.inverse_dynamics(scene, state, tips, actuation=sideways, cones=True, unreachable="nearest")
    # half the square of what is missed is the kinetic energy of that turning, at 1 rad/s
    assert nearest.missed == pytest.approx(math.sqrt(0.05 + 2.0 * height**2), abs=1e-9)
    np.testing.assert_allclose(nearest.acceleration, 0.0, rtol=0.0, atol=1e-9)
