"""Gears by the flanks of their teeth: of many contacts that start open few are anywhere at the start."""

import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

MODULE, TEETH, PRESSURE = 0.1, (24, 25), math.radians(20.0)


def flank(radius: float, tip: float) -> pc.Contour:
    """The involute of a circle up to the tip."""

    def point(u):
        return radius * (math.cos(u) + u * math.sin(u)), radius * (math.sin(u) - u * math.cos(u)), 0.0

    return pc.ParametricCurve(point, domain=(0.02, math.sqrt((tip / radius) ** 2 - 1.0)))


def gears(teeth: range) -> tuple[pc.Scene, pc.State]:
    """Two gears on fixed axes, with the pairs of flanks of these teeth, of which number 0 touches."""
    model, (one, two) = pin.Model(), (0.5 * MODULE * number for number in TEETH)
    model.gravity.linear = np.zeros(3)
    for name, x in (("first", 0.0), ("second", one + two)):
        place = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        joint = model.addJoint(0, pin.JointModelRZ(), place, name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame(f"{name} gear", joint, pin.SE3.Identity(), 0)
    scene, involute = pc.Scene(model), math.tan(PRESSURE) - PRESSURE

    def turned(angle: float) -> pin.SE3:
        return pin.SE3(pin.utils.rotate("z", angle), np.zeros(3))

    shapes = [flank(radius * math.cos(PRESSURE), radius + MODULE) for radius in (one, two)]
    for i in teeth:
        angles = 2.0 * math.pi * i / TEETH[0] - involute, math.pi - involute - 2.0 * math.pi * i / TEETH[1]
        first = scene.add_contour(f"a{i}", shapes[0], "first gear", turned(angles[0]))
        second = scene.add_contour(f"b{i}", shapes[1], "second gear", turned(angles[1]))
        scene.add_contact(f"t{i}", first, second)
    return scene, scene.initial_state([0.0, 0.0], free=[f"t{i}" for i in teeth if i])


@pytest.mark.parametrize("options", [{}, {"method": "Moreau", "step": 4e-3}])
def test_teeth_take_over_from_each_other(options):
    """Involutes keep the ratio of speeds: so do angles, over four teeth. Of ten pairs some have no point at
    the start at which they are nearest; they touch when their turn comes."""
    scene, state = gears(range(-3, 7))
    run = pc.simulate(scene, state, 1.7, control=lambda t, q, v: np.array([-2.0, -1.0]), **options)
    assert run.status == 0, run.message
    assert {event.contact for event in run.events if event.kind == "touch"} >= {"t1", "t2", "t3"}
    # energy: both turn like one with torque tau_1 - tau_2 N_1 / N_2 and inertia 1 + (N_1 / N_2)^2
    ratio = TEETH[0] / TEETH[1]
    angle = 0.5 * 1.7**2 * (-2.0 + ratio) / (1.0 + ratio**2)
    np.testing.assert_allclose(run.q[-1], [angle, -ratio * angle], rtol=0.0, atol=1e-9)


def test_any_pair_may_start_open():
    """All around: beside those that are near each other there are pairs that are nowhere."""
    _, state = gears(range(-11, 13))
    assert np.isfinite(state.location).all()
    assert (state.discrete[:, 0] == -1).sum() == 23


@pytest.mark.parametrize("friction", [pc.NoSlip(), pc.Coulomb(0.3)])
@pytest.mark.parametrize("start", [0.0, 0.7, 2.0])
def test_elliptic_gears_that_cannot_part(start, friction):
    """Ellipses that turn about their foci: where they roll, the normal of their contact keeps the same velocity as its
    tangent, and says so in the middle of steps only to their square. Their ratio is that of the distances from the foci
    to where they touch."""
    a, b = 0.1, 0.08
    c = math.sqrt(a * a - b * b)
    model, inertias = pin.Model(), (0.02, 0.03)
    for name, x, inertia in (("first", 0.0, inertias[0]), ("second", 2.0 * a, inertias[1])):
        place = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        joint = model.addJoint(0, pin.JointModelRZ(), place, name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), inertia * np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame(f"{name} gear", joint, pin.SE3.Identity(), 0)
    scene, focus = pc.Scene(model), pin.SE3(np.eye(3), np.array([-c, 0.0, 0.0]))
    contours = [scene.add_contour(f"{name}s", pc.Ellipse(a, b), f"{name} gear", focus) for name in ("first", "second")]
    scene.add_contact("gears", *contours, friction, bilateral=True)

    def angle(first):
        """Of the second gear, from that of the first one; its derivative is minus the ratio of both distances."""
        factor = (a - c) / (a + c)
        return -2.0 * np.unwrap(np.arctan2(factor * np.sin(0.5 * first), np.cos(0.5 * first)), period=np.pi)

    def ratio(first):
        distance = b * b / (a + c * np.cos(first))
        return -distance / (2.0 * a - distance)

    speed = 5.0
    energy = inertias[0] + inertias[1] * ratio(start) ** 2
    state = scene.initial_state([start, float(angle(np.array([start]))[0])], [speed, ratio(start) * speed])
    run = pc.simulate(scene, state, 0.25, method="Moreau", dt=1e-3, t_eval=np.linspace(0.0, 0.25, 51))
    assert run.status == 0, run.message
    # second order in the way of a step, which is 0.005 to 0.02 rad
    np.testing.assert_allclose(run.q[:, 1], angle(run.q[:, 0]), rtol=0.0, atol=1e-4)
    np.testing.assert_allclose(
        run.v[:, 0], speed * np.sqrt(energy / (inertias[0] + inertias[1] * ratio(run.q[:, 0]) ** 2)), rtol=1e-4
    )


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("options", [{}, {"max_step": 1e-4}, {"method": "Moreau", "dt": 1e-4}])
def test_flanks_that_are_next_to_each_other_pass_their_tips(seed, options):
    """Two involutes turn past each other, a tenth of a millimetre apart all the time: as both end they are nowhere near
    a touch along a line, though they are next to parallel."""
    rng = np.random.default_rng(seed)
    pressure, base = rng.uniform(0.3, 0.45), rng.uniform(0.25, 0.35, 2)
    distance = base.sum() / math.cos(pressure)
    length = distance * math.sin(pressure)
    middle, way, gap = base[0] * math.tan(pressure), rng.uniform(0.1, 0.2) * length, 1e-4
    starts = (middle, length - middle)
    turned = (middle / base[0] - pressure, (length - middle) / base[1] - pressure - math.pi)
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    for name, x in (("gear 0", 0.0), ("gear 1", distance)):
        joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    scene, flanks = pc.Scene(model), []
    for i, (radius, start) in enumerate(zip(base, starts)):

        def involute(u, radius=radius):
            return radius * (np.cos(u) + u * np.sin(u)), radius * (u * np.cos(u) - np.sin(u)), 0.0

        curve = pc.ParametricCurve(involute, domain=((start - 1.08 * way) / radius, (start + way) / radius))
        place = pin.SE3(pin.exp3(np.array([0.0, 0.0, turned[i]])), np.zeros(3))
        flanks.append(scene.add_contour(f"flank {i}", curve, f"gear {i}", place))
    scene.add_contact("teeth", *flanks)
    direction = rng.choice([-1.0, 1.0])
    along, speed = direction * way * rng.uniform(0.9, 0.98), direction * rng.uniform(0.2, 1.0)
    q, v = [along / base[0], (-gap - along) / base[1]], [speed / base[0], -speed / base[1]]
    state = scene.initial_state(q, v, free=["teeth"])
    run = pc.simulate(scene, state, 0.3 * way / abs(speed), **options)
    assert run.status == 0, run.message
    assert run.contacts["teeth"].gap[0] == pytest.approx(gap, abs=1e-9)
    np.testing.assert_allclose(run.v[-1], v, rtol=1e-12)


@pytest.mark.parametrize("step", [2e-4, 1e-4, 5e-5])
def test_a_pawl_rattles_in_the_valley_of_a_ratchet(step):
    """It leaves two flanks, which it touches again within one step: the one that it touches first is not behind the
    other, though it is let go. Such a step was tried again and again."""
    axes = np.array([0.0, 0.0]), np.array([0.061333156899364645, 0.06692035786426917])
    tip = -axes[1] + [0.0, 0.05765075782207417]
    outer, inner, teeth, undercut = 0.05613298947955303, 0.04699204151823831, 17, -0.028683732021289998
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    masses = (1.0, np.zeros(2), 0.0021660568189145217), (0.1, 0.5 * tip, 3.206401350153528e-05)
    for name, place, (mass, centre, inertia) in zip(("wheel", "pawl"), axes, masses):
        joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), np.append(place, 0.0)), name)
        body = pin.Inertia(mass, np.append(centre, 0.0), inertia * np.eye(3))
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
        model.addBodyFrame(f"{name} body", joint, pin.SE3.Identity(), 0)
    model.upperDryFrictionLimit = np.array([0.002806649473977652, 0.0])
    model.lowerDryFrictionLimit = -model.upperDryFrictionLimit
    scene = pc.Scene(model)
    end = scene.add_contour(
        "tip", pc.Circle(0.00039510855293598685), "pawl body", pin.SE3(np.eye(3), np.append(tip, 0.0))
    )

    def polar(radius, angle):
        return radius * np.array([math.cos(angle), math.sin(angle)])

    valley = polar(inner, 6.0 * math.pi / teeth)
    crests = (polar(outer, 2.0 * math.pi * k / teeth - undercut) for k in (3, 4))
    # both go on a little behind the valley
    for name, first, last in (("left", next(crests), valley), ("right", valley, next(crests))):
        length = float(np.linalg.norm(last - first))
        domain = (0.0, 1.15 * length) if name == "left" else (-0.15 * length, length)
        turn = pin.utils.rotate("z", math.atan2(*(last - first)[::-1]))
        flank = scene.add_contour(name, pc.Line(domain), "wheel body", pin.SE3(turn, np.append(first, 0.0)))
        scene.add_contact(name, end, flank, side=1, restitution=0.3)
    q, v = [0.40025416609672837, 0.16939636190797494], [-0.008050668896289578, -0.00691597604008623]
    state = scene.initial_state(q, v, free=["left", "right"])

    def torques(t, q, v):
        drive = -0.08733975205980611 + 0.15905822440008122 * math.sin(2.869968169617364 * (t + 0.4325))
        spring = 0.3776454309087665 * (0.4303042191778054 - q[1])
        return np.array([drive - 1.1226596e-4 * v[0], spring - 1.1226596e-5 * v[1]])

    runs = [pc.simulate(scene, state, 0.05, control=torques, **kind) for kind in ({}, {"method": "Moreau", "dt": step})]
    assert [run.status for run in runs] == [0, 0]
    # where rebounds of 1e-8 m leave it
    np.testing.assert_allclose(runs[1].q[-1], runs[0].q[-1], rtol=0.0, atol=1e-5)
