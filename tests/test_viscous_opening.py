"""Unilateral contacts whose viscous friction vanishes as they open: what it pushes apart would close again at once."""

import functools
import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from shared import one_body

import pincontact as pc
from pincontact.layout import SLIPPING

G = 9.81


def skid(rng):
    """A planar body on one point, drawn over a plane and pulled up: its scene, start, load and numbers. Friction turns
    it such that the point is pushed up."""
    mass, inertia = rng.uniform(0.5, 2.0), rng.uniform(0.002, 0.02)
    x, h = rng.uniform(0.03, 0.15), rng.uniform(0.03, 0.2)
    mu, viscous = rng.choice([0.0, rng.uniform(0.05, 0.3)]), rng.uniform(0.3, 4.0)
    side = rng.choice([-1.0, 1.0])
    model, joint = pin.Model(), 0
    for name, kind in (("x", pin.JointModelPX()), ("z", pin.JointModelPZ()), ("turn", pin.JointModelRY())):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), inertia * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    place = pin.SE3(np.eye(3), np.array([side * x, 0.0, -h]))
    point, floor = scene.add_contour("point", pc.Point(), "body", place), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", point, floor, friction=pc.Coulomb(mu, viscous=viscous))
    state = scene.initial_state([0.0, h, 0.0], [-side * rng.uniform(0.5, 2.0), 0.0, 0.0])
    lift, omega = rng.uniform(1.3, 3.0) * mass * G, rng.uniform(3.0, 12.0)
    # a torque that keeps the body on its point for a while
    turn = -side * x * mass * G

    def load(t):
        return np.array([0.0, lift * math.sin(omega * t), turn])

    return scene, state, load, (mass, inertia, side * x, -h, mu, viscous)


def forces(t, y, load, numbers):
    """Normal force, tangential force and share of the viscous force of the closed contact (Filippov's solution where
    the normal force would pull), and the accelerations."""
    mass, inertia, rx, rz, mu, viscous = numbers
    weights = np.array([1.0 / mass, 1.0 / mass, 1.0 / inertia])
    c, s, rate = math.cos(y[2]), math.sin(y[2]), y[5]
    px, pz = rx * c + rz * s, -rx * s + rz * c
    along, up = np.array([1.0, 0.0, pz]), np.array([0.0, 1.0, -px])
    free = weights * load(t) - np.array([0.0, G, 0.0])
    slip = along @ y[3:]
    sign = math.copysign(1.0, slip)
    # the point's second derivative without forces
    base = up @ free - pz * rate**2
    lift, cross = up @ (weights * up), up @ (weights * along)
    drag = -viscous * slip
    normal = -(base + cross * drag) / (lift - mu * sign * cross)
    share = 1.0
    if normal < 0.0:
        normal, share = 0.0, -base / (cross * drag)
    tangential = share * drag - sign * mu * normal
    return normal, tangential, share, free + weights * (along * tangential + up * normal)


@functools.cache
def skid_that_opens(case):
    """What `skid` gives, and the solution of the same equations in three coordinates up to where the point opens after
    a part of the friction has kept it closed."""
    rng = np.random.default_rng(case)
    while True:
        scene, state, load, numbers = skid(rng)

        def rate(t, y, load=load, numbers=numbers):
            return np.r_[y[3:], forces(t, y, load, numbers)[3]]

        def opens(t, y, load=load, numbers=numbers):
            return forces(t, y, load, numbers)[2]

        def stops(t, y, numbers=numbers):
            return y[3] + (-numbers[2] * math.sin(y[2]) + numbers[3] * math.cos(y[2])) * y[5]

        opens.terminal = stops.terminal = True
        # kinks of the right side cost this integrator no more than short steps
        exact = solve_ivp(
            rate, (0.0, 0.5), [*state.q, *state.v], events=(opens, stops), rtol=1e-11, atol=1e-13, dense_output=True
        )
        closed, late = opens(0.0, exact.y[:, 0]) == 1.0, 0.975 * exact.t[-1]
        if closed and exact.t_events[0].size and opens(late, exact.sol(late)) < 0.9:
            return scene, state, load, numbers, exact


@pytest.mark.parametrize("method", ["DOP853", "RK45"])
@pytest.mark.parametrize("case", range(6))
def test_a_part_of_the_friction_keeps_it_closed(case, method):
    """Against the same equations in three coordinates, with the share of the friction that keeps the point closed."""
    scene, state, load, numbers, exact = skid_that_opens(case)
    end = exact.t[-1]
    times = np.linspace(0.0, end, 41)
    run = pc.simulate(
        scene, state, end + 1e-3, control=lambda t, q, v: load(t), t_eval=[*times[:-1], end + 1e-3], method=method
    )
    assert run.status == 0, run.message
    assert [event.kind for event in run.events] == ["separate"]
    # ten times the tolerance; where forces fall to zero slowly their time is known less well
    assert run.events[0].time == pytest.approx(end, abs=1e-6)
    np.testing.assert_allclose(run.q[:-1], exact.sol(times[:-1])[:3].T, rtol=0.0, atol=1e-7)
    track, normal, shared = run.contacts["c"], [], 0
    for i, t in enumerate(times[:-1]):
        n, along, share, _ = forces(t, exact.sol(t), load, numbers)
        normal.append(n)
        assert track.tangential_force[i] == pytest.approx(abs(along), abs=1e-5)
        shared += share < 0.99
        assert (track.mode[i] == SLIPPING) or share == 1.0
    np.testing.assert_allclose(track.normal_force[:-1], normal, rtol=0.0, atol=1e-5)
    assert shared > 0


@pytest.mark.parametrize("case", range(6))
def test_time_stepping_lets_a_part_of_it_act(case):
    """Of first order, as what opens does so in a step; nothing pulls, and nothing leaves and comes back."""
    scene, state, load, numbers, exact = skid_that_opens(case)
    end = exact.t[-1]
    times, errors, options = (
        np.linspace(0.0, 0.9 * end, 10),
        [],
        {"method": "Moreau", "control": lambda t, q, v: load(t)},
    )
    for count in (100, 200, 400):
        run = pc.simulate(scene, state, end, t_eval=times, dt=end / count, **options)
        assert run.status == 0, run.message
        assert [event.kind for event in run.events] in ([], ["separate"])
        errors.append(np.abs(run.q - exact.sol(times)[:3].T).max())
        normal = [forces(t, exact.sol(t), load, numbers)[0] for t in times]
        np.testing.assert_allclose(run.contacts["c"].normal_force, normal, rtol=0.0, atol=0.1)
    assert errors[2] <= 0.4 * errors[0]
    assert errors[2] <= 1e-4


LAWS = [
    pc.Coulomb(0.4, viscous=0.3),
    pc.Coulomb(0.0, viscous=0.5),
    pc.Coulomb(0.2, viscous=5.0),
    pc.Coulomb(0.1, mu_static=0.3, viscous=1.0),
    pc.Stribeck(0.1, 0.3, 0.1, viscous=1.0),
]


@pytest.mark.parametrize("case", [*range(5), 109, 128, 155, 179, 188])
def test_feet_that_are_lifted_by_turns(case):
    """A block on four feet, shaken: its feet open and touch all the time, but not without end, and nothing gains
    energy."""
    rng = np.random.default_rng(case)
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.004 * np.eye(3))))
    floor = scene.add_contour("floor", pc.Plane())
    for i, (x, y) in enumerate([(0.1, 0.1), (0.1, -0.1), (-0.1, 0.1), (-0.1, -0.1)]):
        place = pin.SE3(np.eye(3), np.array([x, y, -0.05]))
        scene.add_contact(
            f"foot {i}", scene.add_contour(f"p{i}", pc.Point(), "body", place), floor, friction=LAWS[case % len(LAWS)]
        )
    v = [*rng.normal(size=2), 0.0, 0.0, 0.0, rng.normal()]
    state = scene.initial_state([0, 0, 0.05, 0, 0, 0, 1.0], v)
    push, tilt = rng.uniform(0.0, 3.0), rng.uniform(1.3, 2.4)
    omega, other = rng.uniform(1.0, 15.0, 2)

    def load(t, q, v):
        return np.array([push * math.sin(other * t), 0.0, 0.0, 0.0, tilt * math.sin(omega * t), 0.0])

    run = pc.simulate(scene, state, 1.0, control=load, energies=True, max_steps=20000)
    assert run.status == 0, run.message
    assert len(run.events) <= 400
    energies = run.energies()
    scale = energies.kinetic.max() + 1.0
    assert np.diff(energies.friction_work).max() <= 1e-7 * scale
    assert np.abs(energies.balance).max() <= 1e-5 * scale
