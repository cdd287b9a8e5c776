"""Several sliding feet: which of them carry the body is a complementarity problem, solved as one."""

from __future__ import annotations

import pickle
from itertools import combinations

import numpy as np
import pinocchio as pin
import pytest
from differential import Runs
from random_motions import random_motion
from shared import one_body

import pincontact as pc

GRAVITY = 9.81


def body_on_feet(points, mu, mass=1.0, inertia=None):
    """A free body, its centre of mass at its origin, and contacts of its feet (n, 3) with a floor; mu: of all, of each,
    or laws."""
    laws = mu if isinstance(mu, list) else np.broadcast_to(mu, len(points)).tolist()
    inertia = 0.01 * np.eye(3) if inertia is None else inertia
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia(mass, np.zeros(3), inertia), "base"))
    floor = scene.add_contour("floor", pc.Plane())
    for i, point in enumerate(points):
        foot = scene.add_contour(f"foot {i}", pc.Point(), "base", placement=pin.SE3(np.eye(3), np.array(point)))
        scene.add_contact(
            f"foot {i}",
            foot,
            floor,
            friction=laws[i] if isinstance(laws[i], (pc.Coulomb, pc.NoSlip)) else pc.Coulomb(laws[i]),
        )
    return scene


def normal_problem(points, mu, mass, inertia, v):
    """Gap accelerations A N + b of the sliding feet of a body that is level."""
    linear, omega = v[:3], v[3:]
    inverse = np.linalg.inv(inertia)
    free = -inverse @ np.cross(omega, inertia @ omega)
    n = len(points)
    operator, base = np.zeros((n, n)), np.zeros(n)
    up = np.array([0.0, 0.0, 1.0])
    for i, r in enumerate(points):
        base[i] = -GRAVITY + np.cross(free, r)[2] + np.cross(omega, np.cross(omega, r))[2]
        for j, s in enumerate(points):
            slip = linear + np.cross(omega, s)
            force = up - mu[j] * slip / np.linalg.norm(slip)
            operator[i, j] = force[2] / mass + np.cross(inverse @ np.cross(s, force), r)[2]
    return operator, base


def all_solutions(operator, base):
    """Every N >= 0, A N + b >= 0, N (A N + b) = 0 that a choice of loaded feet gives."""
    n, found = len(base), []
    for number in range(n + 1):
        for loaded in map(list, combinations(range(n), number)):
            forces = np.zeros(n)
            if loaded:
                forces[loaded] = np.linalg.lstsq(operator[np.ix_(loaded, loaded)], -base[loaded], rcond=1e-11)[0]
            gaps = operator @ forces + base
            # round-off of systems of conditioning up to 1e6
            if (forces >= -1e-8).all() and (gaps >= -1e-8).all() and np.abs(gaps[loaded]).max(initial=0.0) < 1e-8:
                found.append(forces)
    return found


def test_two_sliding_feet_one_of_which_carries_all():
    """N = (24.525, 0), with the friction of the loaded foot tipping the body over it."""
    points = np.array([[0.1, 0.0, -0.2], [-0.1, 0.0, -0.2]])
    scene = body_on_feet(points, 0.8)
    state = scene.initial_state([0, 0, 0.2, 0, 0, 0, 1], [1.0, 0, 0, 0, 0, 0])
    run = pc.simulate(scene, state, 1e-4, t_eval=[0.0])
    assert run.status == 0
    # 1 - mu h a / I + a^2 / I = 0.4, and N = g / 0.4
    assert run.contacts["foot 0"].normal_force[0] == pytest.approx(GRAVITY / 0.4, rel=1e-12)
    assert run.contacts["foot 1"].mode[0] == -1


@pytest.mark.parametrize("seed", [0, 1, 2, 47, 50, 59])
def test_random_sliding_feet(seed):
    """The run refuses what has no solution, and takes it where there is one."""
    rng = np.random.default_rng(seed)
    refused = loaded_in_part = 0
    for _ in range(20):
        n = int(rng.integers(2, 6))
        height = rng.uniform(0.02, 0.4)
        points = np.column_stack([rng.uniform(-0.2, 0.2, (n, 2)), np.full(n, -height)])
        mu = rng.uniform(0.05, 1.2, n)
        turn = pin.Quaternion(rng.normal(size=4)).normalized().matrix()
        inertia = turn @ np.diag(rng.uniform(0.5, 1.0, 3) * 10 ** rng.uniform(-2.5, -1.0)) @ turn.T
        v = np.array([*rng.normal(size=2), 0.0, 0.0, 0.0, rng.normal()])
        operator, base = normal_problem(points, mu, 1.0, inertia, v)
        solutions = all_solutions(operator, base)
        scene = body_on_feet(points, mu, 1.0, inertia)
        run = pc.simulate(scene, scene.initial_state([0, 0, height, 0, 0, 0, 1], v), 0.0)
        # what a foot's own force would push further in is no support
        sound = [N for N in solutions if not ((N > 1e-8) & (operator.diagonal() <= 0.0)).any()]
        if run.status == -4:
            assert not sound
            refused += 1
            continue
        assert run.status == 0, run.message
        forces = np.array([run.contacts[f"foot {i}"].normal_force[0] for i in range(n)])
        gaps = operator @ forces + base
        scale = 1.0 + np.abs(forces).max()
        # evaluated once, in systems of conditioning up to 1e6
        assert forces.min() > -1e-8 * scale
        assert gaps.min() > -1e-8 * scale
        assert np.abs(forces * gaps).max() < 1e-7 * scale**2
        if len(sound) == 1:
            assert forces == pytest.approx(sound[0], abs=1e-7 * scale)
        loaded_in_part += bool((forces < 1e-9).any())
    # the family has both
    assert refused and loaded_in_part


# ---------------------------------------------------------------- fallback


def painleve_rod(energies=False, **options):
    """A run of a rod that slides on its tip at an angle at which mu = 3 leaves no force (1 m, 1 kg, 1/12 kg m^2)."""
    inertia = np.diag([1 / 12, 1 / 12, 1e-3])
    scene = body_on_feet([[0.0, 0.0, -0.5]], 3.0, 1.0, inertia)
    lean = pin.Quaternion(pin.utils.rotate("y", 0.5))
    tip = lean.matrix() @ [0.0, 0.0, -0.5]
    v = lean.matrix().T @ [-1.0, 0.0, 0.0]
    state = scene.initial_state([*-tip, *lean.coeffs()], [*v, 0, 0, 0])
    return scene, state, pc.simulate(scene, state, 0.2, energies=energies, **options)


def test_painleve_says_that_there_is_no_force_and_what_to_do():
    run = painleve_rod()[2]
    assert run.status == -4
    assert "no contact forces satisfy" in run.message
    assert 'fallback="Moreau"' in run.message


def test_fallback_goes_on_by_time_stepping():
    scene, state, run = painleve_rod(fallback="Moreau", step=1e-4)
    alone = pc.simulate(scene, state, 0.2, method="Moreau", step=1e-4)
    assert run.status == alone.status == 0
    (event,) = [e for e in run.events if e.kind == "fallback"]
    assert event.time == 0.0
    assert repr(event) == "<fallback at 0 s>"
    # nothing but time stepping is left of it
    assert run.t[-1] == pytest.approx(0.2)
    assert run.q[-1] == pytest.approx(alone.q[-1], abs=1e-12)
    assert len(run.contacts["foot 0"].force) == run.t.size == run.stats["outputs"]


@pytest.mark.parametrize("outputs", [None, np.linspace(0.0, 1.0, 41)])
def test_fallback_joins_two_parts(outputs, monkeypatch, tmp_path):
    """A run that is stopped in its course goes on from there: one trajectory, whose works are those of the whole."""
    from pincontact.integration import driver
    from pincontact.integration.results import CHATTER, Stop

    points = [[x, y, -0.05] for x in (0.1, -0.1) for y in (0.1, -0.1)]
    scene = body_on_feet(points, 0.2)
    state = scene.initial_state([0, 0, 0.05, 0, 0, 0, 1], [1.0, 0, 0, 0, 0, 0])
    whole = pc.simulate(scene, state, 1.0, t_eval=outputs, energies=True)

    def stop(self, t):
        kept(self, t)
        if t > 0.3:
            raise Stop(CHATTER, "stopped")

    kept = driver.Driver._keep_good
    monkeypatch.setattr(driver.Driver, "_keep_good", stop)
    run = pc.simulate(
        scene, state, 1.0, t_eval=outputs, energies=True, max_step=0.05, fallback="Moreau", step=1e-3,
        control=lambda t, q, v: np.zeros(6), events=lambda t, q, v: 1.0,
    )  # fmt: skip
    assert run.status == 0
    (event,) = [e for e in run.events if e.kind == "fallback"]
    assert 0.3 < event.time < 0.36
    assert (np.diff(run.t) > 0.0).all()
    # before its tracks are asked for, too
    again = pickle.loads(pickle.dumps(run))
    np.testing.assert_array_equal(again.contacts["foot 1"].force, run.contacts["foot 1"].force)
    if outputs is not None:
        assert run.t == pytest.approx(outputs, abs=0.0)
    for values in (run.q, run.v, run.contacts["foot 1"].force, run.contacts["foot 1"].mode):
        assert len(values) == run.t.size
    # friction is constant: time stepping is exact but for the step in which the block stops
    assert run.q[-1] == pytest.approx(whole.q[-1], abs=1e-4)
    energies = run.energies()
    assert np.abs(energies.balance).max() < 1e-3
    assert energies.friction_work[-1] == pytest.approx(-0.5, abs=1e-3)
    run.save(tmp_path / "run.npz")
    assert pc.Trajectory.load(tmp_path / "run.npz", scene).events[-1].kind == run.events[-1].kind


def test_fallback_is_checked():
    scene, state, _ = painleve_rod()
    with pytest.raises(pc.ArgumentError, match="fallback must be"):
        pc.simulate(scene, state, 0.1, fallback="RK45")
    with pytest.raises(pc.ArgumentError, match="event-driven"):
        pc.simulate(scene, state, 0.1, method="Moreau", fallback="Moreau")


# ---------------------------------------------------------------- redundant loads


LAWS = {
    "Coulomb": lambda i: pc.Coulomb(0.4),
    "Stribeck": lambda i: pc.Stribeck(mu=0.2, mu_static=0.5, speed=0.1),
    "two directions": lambda i: pc.Coulomb(mu=(0.5, 0.2)),
    "four coefficients": lambda i: pc.Coulomb([0.2, 0.3, 0.4, 0.5][i]),
}


def table_that_slides(order, law, height, v=(0.8, 0.3, 0, 0, 0, 4.0), **options):
    """Where a body ends that slides and spins on four feet, contacts made in this order."""
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag([0.01, 0.012, 0.02]))
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), inertia, "base"))
    floor = scene.add_contour("floor", pc.Plane())
    points = [(0.02 + x, 0.01 + y, -height) for x in (0.1, -0.1) for y in (0.1, -0.1)]
    for i in order:
        foot = scene.add_contour(f"foot {i}", pc.Point(), "base", placement=pin.SE3(np.eye(3), np.array(points[i])))
        scene.add_contact(f"foot {i}", foot, floor, friction=LAWS[law](i))
    state = scene.initial_state([0, 0, height, 0, 0, 0, 1], v)
    run = pc.simulate(scene, state, 0.5, **options)
    assert run.status == 0, run.message
    return run


@pytest.mark.parametrize("law", LAWS)
def test_redundant_sliding_feet_carry_the_same_in_all_methods(law):
    """In slip loads move the body: both kinds of methods take the same ones, whatever the order of the contacts."""
    one = table_that_slides((0, 1, 2, 3), law, 0.05).q[-1]
    # round-off, and what it makes of the time at which a contact sticks
    assert table_that_slides((3, 1, 0, 2), law, 0.05).q[-1] == pytest.approx(one, abs=1e-9)
    # its own error, of first order in the step at the end of slip; other loads end 1e-4 m apart
    steps = table_that_slides((0, 1, 2, 3), law, 0.05, method="Moreau", step=2e-4)
    assert steps.q[-1] == pytest.approx(one, abs=3e-6)


def test_a_sliding_foot_that_carries_nothing_stays_closed():
    """Least loads that are not negative: a foot comes to carry nothing, without an event or a jump of what the others
    carry, and the motion does not depend on the order of the feet."""
    v = (-1.0, 0.3, 0, 0, 0, 3.0)
    times = np.linspace(0.0, 0.5, 501)
    run = table_that_slides((0, 1, 2, 3), "Coulomb", 0.2, v, t_eval=times)
    loads = np.column_stack([run.contacts[f"foot {i}"].normal_force for i in range(4)])
    modes = np.column_stack([run.contacts[f"foot {i}"].mode for i in range(4)])
    sliding = (modes == 2).all(axis=1)
    assert (loads[sliding].min(axis=1) < 1e-9).sum() > 100
    assert (loads[sliding].min(axis=1) > 1e-2).sum() > 100
    assert loads.min() > -1e-9
    # they change by up to 90 N/s
    assert np.abs(np.diff(loads[sliding], axis=0)).max() < 0.1
    other = table_that_slides((2, 0, 3, 1), "Coulomb", 0.2, v, t_eval=times)
    assert other.q[-1] == pytest.approx(run.q[-1], abs=1e-9)


def test_light_and_heavy_bodies_slide_side_by_side():
    """Their mobilities differ by 1e5, which says nothing of what friction makes of them: each stops by itself."""
    model = pin.Model()
    for name, mass in (("light", 0.1), ("heavy", 1e4)):
        joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
        model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    for name in ("light", "heavy"):
        scene.add_contact(name, scene.add_contour(name, pc.Point(), name), floor, friction=pc.Coulomb(0.3))
    run = pc.simulate(scene, scene.initial_state(np.zeros(6), [1.0, 0.0, 0.0, 0.0, 2.0, 0.0]), 0.1)
    assert run.status == 0, run.message
    # v t - mu g t^2 / 2, to the tolerance
    fall = 0.5 * 0.3 * 9.81 * 0.01
    assert run.q[-1] == pytest.approx([0.1 - fall, 0.0, 0.0, 0.0, 0.2 - fall, 0.0], abs=1e-8)


@pytest.mark.parametrize("seed", [90300])
def test_loads_that_constraints_leave_open(seed):
    """What slides or turns against a torque beside redundant contacts: modes came and went for ever where a choice of
    loads that the motion depends on holds them. It is told."""
    runs = Runs(random_motion(seed)[1])
    run, tight = runs.run(), runs.tight()
    assert run.status == tight.status == 0, (run.message, tight.message)
    # tolerances, over impacts
    assert runs.apart(run, tight).max() < 1e-5
    assert run.stats["open_loads"] > 0 and "rigid bodies leave open" in run.message


@pytest.mark.parametrize("held", ["dry", "limit"])
@pytest.mark.parametrize("seed", range(2))
def test_held_joints_share_the_load_of_what_slides(held, seed):
    """A foot slides on the floor below a vertical joint that dry friction, or the end of its way, holds, too: rigid
    bodies leave open which of them carries the weight. Both kinds of methods take the same share, and tell."""
    rng = np.random.default_rng(seed)
    model, limit = pin.Model(), rng.uniform(0.5, 4.0)
    slider = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slider")
    model.appendBodyToJoint(slider, pin.Inertia(rng.uniform(0.5, 2.0), np.zeros(3), np.eye(3)), pin.SE3.Identity())
    column = model.addJoint(slider, pin.JointModelPZ(), pin.SE3.Identity(), "column")
    mass = rng.uniform(0.5, 2.0)
    model.appendBodyToJoint(column, pin.Inertia(mass, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("foot", column, pin.SE3.Identity(), 0)
    if held == "dry":
        model.upperDryFrictionLimit[1], model.lowerDryFrictionLimit[1] = limit, -limit
    else:
        model.lowerPositionLimit[1] = 0.0
    scene, mu = pc.Scene(model), rng.uniform(0.1, 0.3)
    foot, floor = scene.add_contour("foot", pc.Point(), "foot"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("foot", foot, floor, pc.Coulomb(mu), pattern="P-S")
    state = scene.initial_state([0.0, 0.0], [3.0, 0.0])
    run = pc.simulate(scene, state, 0.3)
    load = run.contacts["foot"].normal_force[-1]
    assert 0.0 < load < mass * GRAVITY + limit + 1e-9
    stepped = [pc.simulate(scene, state, 0.3, method="Moreau", dt=dt) for dt in (1e-3, 2e-3)]
    for one in (run, *stepped):
        assert one.status == 0 and "rigid bodies leave open" in one.message
        # the share is found to the square root of round-off: it is where a slope vanishes
        assert one.v[-1] == pytest.approx(run.v[-1], abs=1e-7)
        assert one.contacts["foot"].normal_force[-1] == pytest.approx(load, rel=1e-7)


# ---------------------------------------------------------------- jams beside what is held


def body_that_turns_about_a_point(seed, pivot):
    """A body that turns about a point of the floor, a joint or a contact that never slips, and slides on a foot."""
    rng = np.random.default_rng(seed)
    com = np.r_[rng.uniform(-0.3, 0.3, 2), rng.uniform(0.2, 0.6)]
    turned = pin.Quaternion(rng.normal(size=4)).normalized().matrix()
    # moments of inertia of point masses: any of these is one of a body
    spread = 10 ** rng.uniform(-2.5, -1.0, 3)
    inertia = turned @ np.diag(spread.sum() - spread) @ turned.T
    foot, mu, turning = np.r_[rng.uniform(-0.4, 0.4, 2), 0.0], rng.uniform(0.5, 3.0), 3.0 * rng.choice([-1.0, 1.0])
    model = pin.Model()
    kind = pin.JointModelSpherical() if pivot == "joint" else pin.JointModelFreeFlyer()
    joint = model.addJoint(0, kind, pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, com, inertia), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    if pivot == "contact":
        scene.add_contact("pivot", scene.add_contour("pivot", pc.Point(), "body"), floor, pc.NoSlip(), bilateral=True)
    point = scene.add_contour("foot", pc.Point(), "body", placement=pin.SE3(np.eye(3), foot))
    scene.add_contact("foot", point, floor, pc.Coulomb(mu))
    v = np.zeros(model.nv)
    v[-1] = turning
    # n^T M^-1 (n - mu d) of the foot, where the body is free and where it turns about the point
    n, d = np.array([0.0, 0.0, 1.0]), np.cross([0.0, 0.0, turning], foot)
    push, values = n - mu * d / np.linalg.norm(d), []
    about = inertia + com @ com * np.eye(3) - np.outer(com, com)
    for arm, moments, moves in ((foot - com, inertia, 1.0), (foot, about, 0.0)):
        values.append(moves + np.cross(arm, n) @ np.linalg.solve(moments, np.cross(arm, push)))
    return scene, scene.initial_state(pin.neutral(model), v), values


def test_held_contacts_keep_from_jamming_as_joints_do():
    """Friction jams a foot (Painleve), or does not, by how the body can move beside what holds it: the same whether
    that is a joint or a contact. With jams that there are only without, and only with it."""
    kinds = {(True, False): 0, (False, True): 0}
    for seed in range(3000):
        *_, (alone, held) = body_that_turns_about_a_point(seed, "joint")
        kind = (alone < -0.05, held < -0.05)
        if kinds.get(kind, 3) >= 3 or min(abs(alone), abs(held)) < 0.05:
            continue
        kinds[kind] += 1
        scene, state, _ = body_that_turns_about_a_point(seed, "joint")
        by_joint = pc.simulate(scene, state, 0.05)
        scene, state, _ = body_that_turns_about_a_point(seed, "contact")
        by_contact = pc.simulate(scene, state, 0.05)
        assert by_contact.status == by_joint.status, (seed, by_joint.message, by_contact.message)
        if by_joint.status == 0:
            one, two = by_joint.q[-1], by_contact.q[-1, 3:]
            # a tenth of the tolerance
            assert two * np.sign(one @ two) == pytest.approx(one, abs=1e-9), seed
        if min(kinds.values()) == 3:
            break
    assert min(kinds.values()) == 3, kinds
