"""Events: contacts that open, fly and close again, impacts, and functions of the user's."""

import math

import numpy as np
import pinocchio as pin
import pytest
from reference import build
from shared import kinds, one_body

import pincontact as pc
from pincontact.integration.crossings import ENDS
from pincontact.integration.dense import Interpolant
from pincontact.integration.discrete import write_discrete
from pincontact.integration.run_system import RunSystem
from pincontact.integration.runge_kutta import RungeKutta
from pincontact.integration.steps import FIND_EARLIEST, FIND_ZERO, LOOK, SCAN_ON
from pincontact.integration.tableaux import tableau
from pincontact.layout import DOMAIN, EVENT, OK, SCAN_ROOM

G = 9.81
RADIUS = 0.1


def ball_scene(friction=None, restitution=0.0, mass=0.5):
    moment = 0.4 * mass * RADIUS**2
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia(mass, np.zeros(3), moment * np.eye(3)), "ball"))
    ball, floor = scene.add_contour("ball", pc.Sphere(RADIUS), "ball"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", ball, floor, friction=friction, restitution=restitution)
    return scene


def thrown(scene, height, v=(0.0, 0.0, 0.0), omega=(0.0, 0.0, 0.0)):
    q = np.array([0.0, 0.0, RADIUS + height, 0.0, 0.0, 0.0, 1.0])
    return scene.initial_state(q, np.array([*v, *omega]), free=["c"])


# ------------------------------------------------------------------------------------------------- flight and impact


def test_free_flight_does_no_contact_work():
    """A ball in the air: a parabola, no Newton iteration, no cone problem, no force."""
    scene = ball_scene(pc.Coulomb(0.3))
    state = thrown(scene, 1.0, (1.0, 0.5, 2.0), (1.0, 2.0, 3.0))
    run = pc.simulate(scene, state, 0.6, rtol=1e-11, atol=1e-13)
    assert run.events == []
    t = run.t[:, None]
    path = (
        np.array([0.0, 0.0, RADIUS + 1.0]) + t * np.array([1.0, 0.5, 2.0]) - 0.5 * G * t**2 * np.array([0.0, 0.0, 1.0])
    )
    assert np.abs(run.q[:, :3] - path).max() <= 1e-11
    track = run.contacts["c"]
    assert (track.mode == -1).all()
    assert not track.force.any()
    np.testing.assert_allclose(track.gap, path[:, 2] - RADIUS, rtol=0.0, atol=1e-11)
    assert run.stats["cone_problems"] == 0


def test_ball_lands_and_stays():
    """Without restitution: it touches at sqrt(2 h / g) and rests there."""
    scene = ball_scene()
    run = pc.simulate(scene, thrown(scene, 0.5), 1.0, rtol=1e-11, atol=1e-13, t_eval=np.linspace(0.0, 1.0, 51))
    assert run.status == 0
    assert kinds(run) == ["touch"]
    lands = math.sqrt(2.0 * 0.5 / G)
    assert abs(run.events[0].time - lands) <= 1e-12
    assert run.events[0].contact == "c"
    after = run.t > lands
    assert np.abs(run.q[after, 2] - RADIUS).max() <= 1e-14
    np.testing.assert_allclose(run.contacts["c"].normal_force[after], 0.5 * G, rtol=1e-12)


def test_bounces_with_restitution():
    """Each impact returns e of the speed: times in geometric progression, until it bounces no more and rests."""
    e, height = 0.6, 0.5
    scene = ball_scene(restitution=e)
    run = pc.simulate(scene, thrown(scene, height), 2.0, rtol=1e-11, atol=1e-13)
    assert run.status == 0, run.message
    touches = np.array([event.time for event in run.events if event.kind == "touch"])
    first = math.sqrt(2.0 * height / G)
    speed = G * first
    expected = [first]
    while e * speed > 2e-3:  # slower rebounds are taken as rest
        speed *= e
        expected.append(expected[-1] + 2.0 * speed / G)
    n = len(expected)
    np.testing.assert_allclose(touches[:n], expected, rtol=0.0, atol=1e-10)
    assert touches.size - n <= 2
    assert run.contacts["c"].mode[-1] == 0
    assert run.q[-1, 2] == pytest.approx(RADIUS, abs=1e-14)
    assert np.abs(run.v[-1]).max() <= 1e-12


@pytest.mark.parametrize("restitution", [0.0, 0.6])
def test_a_start_below_the_surface(restitution):
    """What leaves touches nothing; what gets deeper does, once, and rebounds from there."""
    scene = ball_scene(restitution=restitution)
    up = pc.simulate(scene, thrown(scene, -1e-3, (0.0, 0.0, 2.0)), 0.2)
    assert up.status == 0 and up.events == []
    # a parabola, in Pinocchio's body axes that do not turn
    assert up.q[-1, 2] == pytest.approx(RADIUS - 1e-3 + 2.0 * 0.2 - 0.5 * G * 0.2**2, abs=1e-9)
    down = pc.simulate(scene, thrown(scene, -1e-3, (0.0, 0.0, -2.0)), 0.1)
    assert kinds(down) == ["touch"]
    assert down.events[0].time == 0.0
    if restitution:
        rises = 2.0 * restitution * 0.1 - 0.5 * G * 0.1**2
        assert down.q[-1, 2] == pytest.approx(RADIUS - 1e-3 + rises, abs=1e-9)
    else:
        assert down.q[-1, 2] == pytest.approx(RADIUS, abs=1e-14)


def test_impact_with_friction_of_a_ball():
    """A ball that lands with spin: the impulse either slides (mu J) or stops the slip, whichever is less."""
    for mu, sticks in ((0.05, False), (0.8, True)):
        scene = ball_scene(pc.Coulomb(mu))
        state = thrown(scene, 0.5, (1.0, 0.0, 0.0))
        run = pc.simulate(scene, state, 0.5 + 1e-3, rtol=1e-11, atol=1e-13)
        lands = math.sqrt(2.0 * 0.5 / G)
        impulse = 0.5 * G * lands
        row = int(np.searchsorted(run.t, lands, side="right")) + 1
        velocity = pin.Quaternion(run.q[row, 3:]).matrix() @ run.v[row, :3]
        if sticks:
            assert mu * impulse > 2.0 / 7.0 * 0.5
            expected, mode = 5.0 / 7.0, 1
        else:
            # it goes on sliding, and braking
            expected, mode = 1.0 - mu * impulse / 0.5 - mu * G * (run.t[row] - lands), 2
        np.testing.assert_allclose(velocity, [expected, 0.0, 0.0], rtol=0.0, atol=1e-10)
        assert run.contacts["c"].mode[-1] == mode


def struck_block(law, lean, speed):
    """A point mass on the floor with a ball of its own, at which another ball of the same mass comes at 2 m/s along
    (sin lean, 0, cos lean) when the block slides at a speed along x: the block's velocity after, by each method."""
    model = pin.Model()
    for name in ("block", "hammer"):
        joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
        model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
    model.gravity.setZero()
    scene = pc.Scene(model)
    foot, floor = scene.add_contour("foot", pc.Point(), frame="block"), scene.add_contour("floor", pc.Plane())
    head, hammer = (scene.add_contour(name, pc.Sphere(0.1), frame=name) for name in ("block", "hammer"))
    scene.add_contact("c", foot, floor, friction=law)
    scene.add_contact("hit", hammer, head)
    away = np.array([math.sin(lean), 0.0, math.cos(lean)])
    block = np.array([speed, 0.0, 0.0])
    v = np.concatenate([block, block - 2.0 * away])
    state = scene.initial_state(np.concatenate([np.zeros(3), (0.2 + 2e-2) * away]), v, free=["hit"])
    runs = [
        pc.simulate(scene, state, 0.011, method=method, dt=dt) for method, dt in (("DOP853", None), ("Moreau", 1e-3))
    ]
    assert all([event.kind for event in run.events][:1] == ["touch"] for run in runs)
    return [run.v[-1, :3] for run in runs]


def pushed(mu, lean, speed):
    """The same: the impulses J of the balls and N of the floor, with friction mu N against the slip after, where the
    balls do not part along `lean` and the block does not leave the floor."""
    # the block's velocity is speed - J sin + mu N, with N = J cos; along the line the hammer keeps that
    across, along = math.cos(lean), math.sin(lean)
    impulse = 2.0 / (1.0 + along * (along - mu * across))
    return speed - impulse * (along - mu * across)


def test_coefficients_in_an_impact_are_those_before():
    """What rested holds up to mu_static, and slips with mu if it does not hold; what slid has the coefficient of its
    speed before, though it is ten times as fast after."""
    stribeck = pc.Stribeck(0.2, 0.6, 0.05)
    for law, lean, speed, mu in (
        (pc.Coulomb(0.2, mu_static=0.6), 0.4, 0.0, None),
        (pc.Coulomb(0.2, mu_static=0.6), 0.7, 0.0, 0.2),
        (stribeck, 0.4, 0.0, None),
        (stribeck, 0.7, 0.0, 0.6),
        (pc.Coulomb(0.2, mu_static=0.6), 0.4, -0.03, 0.2),
        (stribeck, 0.7, -0.03, float(stribeck.coefficient(0.03))),
    ):
        expected = 0.0 if mu is None else pushed(mu, lean, speed)
        # the line through both centres turns within a time step
        for velocity, accuracy in zip(struck_block(law, lean, speed), (1e-9, 1e-3)):
            assert velocity == pytest.approx([expected, 0.0, 0.0], abs=accuracy)


def test_disk_leaves_a_sphere_and_flies_on():
    """After the contact has opened the body falls freely: energy and angular momentum in its axes are kept."""
    scene, state = build("disk_on_sphere_detach", native=True)
    run = pc.simulate(scene, state, 1.2, rtol=1e-11, atol=1e-13)
    assert kinds(run) == ["separate"]
    opened = run.events[0].time
    flight = run.t > opened
    assert flight.any()
    acceleration = np.diff(
        [pin.Quaternion(q[3:]).matrix() @ v[:3] for q, v in zip(run.q[flight], run.v[flight])], axis=0
    )
    acceleration /= np.diff(run.t[flight])[:, None]
    np.testing.assert_allclose(acceleration, np.tile([0.0, 0.0, -G], (len(acceleration), 1)), rtol=0.0, atol=1e-7)
    energy = run.energies().total
    assert np.abs(energy / energy[0] - 1.0).max() <= 1e-10
    assert not run.contacts["0"].force[flight].any()


def test_heaving_plate_throws_a_ball():
    """A plate that goes down faster than g lets go of the ball where its acceleration is -g, and meets it again."""
    amplitude, frequency = 0.05, 3.0
    rate = 2.0 * math.pi * frequency
    assert amplitude * rate**2 > G
    model = ball_scene().model
    scene = pc.Scene(model)
    ball = scene.add_contour("ball", pc.Sphere(RADIUS), "ball")
    plate = scene.add_contour("plate", pc.Plane(), motion=pc.HarmonicMotion((0.0, 0.0, amplitude), frequency))
    scene.add_contact("c", ball, plate)
    q = np.array([0.0, 0.0, RADIUS, 0.0, 0.0, 0.0, 1.0])
    state = scene.initial_state(q, np.array([0.0, 0.0, amplitude * rate, 0.0, 0.0, 0.0]))
    run = pc.simulate(scene, state, 0.5, rtol=1e-11, atol=1e-13)
    assert kinds(run)[:2] == ["separate", "touch"]
    leaves = math.asin(G / (amplitude * rate**2)) / rate
    assert abs(run.events[0].time - leaves) <= 1e-10
    # the time of flight from the parabola and the sine
    height, speed = amplitude * math.sin(rate * leaves), amplitude * rate * math.cos(rate * leaves)

    def above(t):
        return height + speed * (t - leaves) - 0.5 * G * (t - leaves) ** 2 - amplitude * math.sin(rate * t)

    low, high = leaves + 0.02, leaves + 0.3
    assert above(low) > 0.0 > above(high)
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if above(middle) > 0.0 else (low, middle)
    assert abs(run.events[1].time - low) <= 1e-10


# ------------------------------------------------------------------------------------------------- loose tolerances


def rolling_in_a_bowl(turned=0.0):
    """A ball released 1.2 rad up in a bowl of 1 m, whose lowest point is a pole of its chart unless it is turned."""
    scene = pc.Scene(ball_scene().model)
    ball = scene.add_contour("ball", pc.Sphere(0.2), "ball")
    bowl = scene.add_contour("bowl", pc.Sphere(1.0), placement=pin.SE3(pin.utils.rotate("y", turned), np.zeros(3)))
    scene.add_contact("c", ball, bowl, friction=pc.NoSlip(), side=-1)
    return scene, scene.initial_state([0.8 * math.sin(1.2), 0.0, -0.8 * math.cos(1.2), 0.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize("turned", [0.0, 0.4])
@pytest.mark.parametrize(
    ("method", "rtol"), [("DOP853", 1e-1), ("DOP853", 1e-2), ("RK45", 1e-2), ("DOP853", 1e-3), ("Sharp98", 1e-5)]
)
def test_long_steps_over_a_pole(rtol, turned, method):
    """A step may end beyond a pole of its chart, where f_1 x f_2 points the other way: the normal does not."""
    scene, state = rolling_in_a_bowl(turned)
    times = np.linspace(0.0, 4.0, 201)
    run = pc.simulate(scene, state, 4.0, rtol=rtol, atol=1e-2 * rtol, method=method, t_eval=times)
    assert run.status == 0, run.message
    assert run.events == []
    track = run.contacts["c"]
    # m g cos(1.2) = 1.8 N at the start; errors of some tenths of a radian leave it that sign
    assert track.normal_force.min() >= 0.1
    outwards = track.point / np.linalg.norm(track.point, axis=1)[:, None]
    # points are on the bowl as well as positions are projected
    np.testing.assert_allclose(track.frame[:, :, 2], outwards, rtol=0.0, atol=1e-9)
    assert np.abs(track.location_second[:, 1]).max() <= 0.5 * math.pi
    assert np.abs(track.location_first[:, 1]).max() <= 0.5 * math.pi


@pytest.mark.parametrize("rtol", [1e-2, 1e-4])
def test_a_disk_over_a_pole(rtol):
    """The same for a curve on a surface, where the sign of the location's determinant turns, too."""
    model = build("disk_on_sphere_detach", native=True)[0].model
    scene = pc.Scene(model)
    disk, dome = (
        scene.add_contour("disk", pc.Circle(0.3), model.frames[-1].name),
        scene.add_contour("dome", pc.Sphere(2.0)),
    )
    scene.add_contact("c", disk, dome, friction=pc.NoSlip())
    # upright, rolling over the top with a spin that keeps it up
    angle, speed = -0.6, 3.0
    upright = pin.utils.rotate("y", angle) @ pin.utils.rotate("x", 0.5 * math.pi)
    q = np.concatenate([pin.utils.rotate("y", angle) @ [0.0, 0.0, 2.3], pin.Quaternion(upright).coeffs()])
    v = np.concatenate([upright.T @ pin.utils.rotate("y", angle) @ [speed, 0.0, 0.0], [0.0, 0.0, -speed / 0.3]])
    run = pc.simulate(scene, scene.initial_state(q, v), 0.9, rtol=rtol, atol=1e-2 * rtol)
    assert run.status == 0, run.message
    assert run.events == []
    point = run.contacts["c"].point
    assert point[0, 0] < -0.5 and point[-1, 0] > 0.5
    assert run.contacts["c"].normal_force.min() > 0.0
    assert run.stats["rejected"] <= 5


@pytest.mark.parametrize(("rtol", "excess"), [(1e-2, 1e-5), (1e-3, 1e-6), (1e-5, 1e-6), (1e-8, 1e-6)])
def test_what_opens_within_the_tolerance_has_not_opened(rtol, excess):
    """A point runs round inside a ring, hardly fast enough for it: at its top the force is as good as zero, and what
    a tolerance loses of the speed would let it hop by less than gaps are known."""
    scene = pc.Scene(one_body(pin.JointModelTranslation(), pin.Inertia(0.5, np.zeros(3), np.eye(3) * 1e-3), "bead"))
    ring = scene.add_contour(
        "ring", pc.Cylinder(1.0), placement=pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    )
    scene.add_contact("c", scene.add_contour("bead", pc.Point(), "bead"), ring, side=-1)
    state = scene.initial_state([0.0, 0.0, -1.0], [math.sqrt(5.0 * G * (1.0 + excess)), 0.0, 0.0])
    run = pc.simulate(scene, state, 1.2, rtol=rtol, atol=1e-2 * rtol)
    assert run.status == 0, run.message
    assert run.events == []
    track = run.contacts["c"]
    assert track.normal_force.min() >= 0.0
    assert np.abs(track.gap).max() <= 10.0 * (rtol + 1e-2 * rtol)
    assert track.mode[-1] == 0


def test_a_dip_of_the_dense_output_alone_is_none(monkeypatch):
    """An event function that is negative between the ends of a step, but not on a true step, changes no mode."""
    scene, state = rolling_in_a_bowl(0.4)
    plain = pc.simulate(scene, state, 1.0, rtol=1e-6, atol=1e-8)
    true_run, looking, dipped = RunSystem.run, [], []

    def dips(self, task, t=0.0, h=0.0):
        if task in (LOOK, SCAN_ON, FIND_ZERO, FIND_EARLIEST):
            looking.append((t, h))
        try:
            return true_run(self, task, t, h)
        finally:
            looking.clear()

    def lifts(t, q, v):
        """A pull at the ball that only looks along the dense output see."""
        force = np.zeros(6)
        start, step = looking[-1] if looking else (t, 1.0)
        theta = (t - start) / step
        if looking and start < 0.5 and 0.3 < theta < 0.6:
            dipped.append(t)
            away = -q[:3] / np.linalg.norm(q[:3]) * 20.0 * math.sin(math.pi * (theta - 0.3) / 0.3)
            force[:3] = pin.Quaternion(q[3:]).matrix().T @ away
        return force

    monkeypatch.setattr(RunSystem, "run", dips)
    monkeypatch.setattr(RungeKutta, "alarm", property(lambda self: True))
    # a user's event brings every step to where its event functions are looked at
    run = pc.simulate(scene, state, 1.0, control=lifts, rtol=1e-6, atol=1e-8, events=lambda t, q, v: 1.0)
    assert dipped
    assert run.status == 0, run.message
    assert run.events == []
    # other steps, the same tolerance
    np.testing.assert_allclose(run.q[-1], plain.q[-1], rtol=0.0, atol=1e-5)


@pytest.mark.parametrize("known", [0, 1, 2])
def test_what_cannot_be_evaluated_along_a_step_has_no_events(known, monkeypatch):
    """A dense output that can be evaluated at its beginning only is searched that far."""
    scene, state = rolling_in_a_bowl(0.4)
    plain = pc.simulate(scene, state, 0.2, rtol=1e-6, atol=1e-8)
    true_run, cut = RunSystem.run, []

    def short(self, task, t=0.0, h=0.0):
        found = true_run(self, task, t, h)
        if task == SCAN_ON:
            cut.append(self.counters["scan_count"] > known)
            self.counters["scan_count"] = min(self.counters["scan_count"], known)
            return ENDS
        return found

    monkeypatch.setattr(RunSystem, "run", short)
    monkeypatch.setattr(RungeKutta, "alarm", property(lambda self: True))
    run = pc.simulate(scene, state, 0.2, rtol=1e-6, atol=1e-8, events=lambda t, q, v: 1.0)
    assert any(cut)
    assert run.status == 0, run.message
    assert run.events == []
    # other steps, the same tolerance
    np.testing.assert_allclose(run.q[-1], plain.q[-1], rtol=0.0, atol=1e-5)


def test_looks_find_what_evaluations_find():
    """All event functions along a step, bit by bit, beyond the end of a contour too."""
    scene = ball_scene(pc.Coulomb(0.3))
    strip = scene.add_contour("strip", pc.Line((-0.05, 0.05)), placement=pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.01])))
    scene.add_contact("edge", "ball", strip, friction=None)
    q = np.array([0.0, 0.0, RADIUS + 0.02, 0.0, 0.0, 0.0, 1.0])
    state = scene.initial_state(q, np.array([3.0, 0.0, -0.2, 0.0, 1.0, 0.0]), free=["c", "edge"])
    system = RunSystem(scene.model, list(scene.contacts.values()))
    write_discrete(system, state.discrete)
    rk = RungeKutta(system, tableau("DOP853"), 1e-6, 1e-8, None)
    rk.begin_at(state.q, state.v, state.location)
    assert rk.evaluate_start(0.0) <= EVENT
    step = 0.03
    assert rk.try_step(0.0, step) == OK
    assert rk.interpolate(0.0, step)
    dense = Interpolant(rk.system)
    shares = [0.0, 0.1, 0.35, 0.8, 1.0]
    beyond = []
    for share in shares:
        known, event_functions = system.look(0.0, step, share)
        assert known
        found = event_functions.copy()
        rk.load(dense(share))
        assert rk.evaluate(share * step) <= EVENT
        there = system.contact_real[:2, DOMAIN] >= 0.0
        beyond.append(not there[1])
        assert found.tobytes() == system.event_functions[:2].tobytes()
    # the ball leaves the strip's end behind
    assert beyond == [False, False, False, True, True]

    # a scan begins with the step's first stage, or with what has been evaluated last
    places = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.6, 0.8, 1.0])
    for first in (0.0, 0.03):
        looked = [system.look(0.0, step, first)[1].copy()]
        if first == 0.0:
            system.look(0.0, step, 0.5)
        system.scan_shares[:SCAN_ROOM] = shares = first + (1.0 - first) * places
        evaluated, system.counters["scan_count"] = rk.evaluations, 0
        system.run(SCAN_ON, 0.0, step)
        n = int(system.counters["scan_count"])
        # the end of the whole step is known, too
        assert n == SCAN_ROOM and rk.evaluations - evaluated == n - (2 if first == 0.0 else 1)
        samples = system.scan_event_functions[:n, :2].copy()
        looked += [system.look(0.0, step, share)[1].copy() for share in shares[1:n].tolist()]
        # Newton's method for the contact coordinates begins elsewhere
        np.testing.assert_allclose(samples, looked, rtol=1e-12, atol=1e-12)


# ------------------------------------------------------------------------------------------------- ends of contours


def test_bead_reaches_the_end_of_its_wire():
    """A bilateral contact cannot go on there: the run ends, at that time."""
    slope, length = 0.5, 0.8
    scene = pc.Scene(one_body(pin.JointModelTranslation(), pin.Inertia(0.2, np.zeros(3), np.zeros((3, 3))), "bead"))
    bead = scene.add_contour("bead", pc.Point(), "bead")
    wire = scene.add_contour(
        "wire", pc.Line((-1.0, length)), placement=pin.SE3(pin.utils.rotate("y", slope), np.zeros(3))
    )
    scene.add_contact("bead/wire", bead, wire)
    run = pc.simulate(scene, scene.initial_state(np.zeros(3)), 5.0, rtol=1e-11, atol=1e-13)
    assert run.status < 0
    assert "bead/wire" in run.message
    assert kinds(run) == ["edge"]
    assert abs(run.events[0].time - math.sqrt(2.0 * length / (G * math.sin(slope)))) <= 1e-11
    np.testing.assert_allclose(run.events[0].q, length * np.array([math.cos(slope), 0.0, -math.sin(slope)]), atol=1e-11)


def test_ball_rolls_off_a_table():
    """A unilateral contact opens at the edge: the ball flies on with the velocity that it had."""
    edge, speed = 0.3, 0.7
    scene = pc.Scene(ball_scene().model)
    ball = scene.add_contour("ball", pc.Sphere(RADIUS), "ball")
    table = scene.add_contour("table", pc.Plane(((-1.0, edge), None)))
    scene.add_contact("c", ball, table, friction=pc.NoSlip())
    q = np.array([0.0, 0.0, RADIUS, 0.0, 0.0, 0.0, 1.0])
    state = scene.initial_state(q, np.array([speed, 0.0, 0.0, 0.0, speed / RADIUS, 0.0]))
    times = np.linspace(0.0, 1.0, 51)
    run = pc.simulate(scene, state, 1.0, rtol=1e-11, atol=1e-13, t_eval=times)
    assert run.status == 0, run.message
    assert kinds(run) == ["edge"]
    off = edge / speed
    # the end is 1e-11 m further out, that what is at it may be on it
    assert abs(run.events[0].time - off) <= 2e-11
    fall = np.maximum(times - off, 0.0)
    path = np.column_stack([speed * times, np.zeros_like(times), RADIUS - 0.5 * G * fall**2])
    assert np.abs(run.q[:, :3] - path).max() <= 1e-10
    np.testing.assert_array_equal(run.contacts["c"].mode, np.where(times <= off, 1, -1))


# ------------------------------------------------------------------------------------------------- users' events


@pytest.fixture
def rolling():
    return build("disk_plane_steady_circle", native=True)


def crossing_x(t, q, v):
    return q[0] + 0.5


def test_users_events_are_located(rolling):
    """Zeros along a circle known in closed form: x = rho (1 - cos(Omega t)) with rho = -0.794."""
    scene, state = rolling
    rho, turning = 0.5 * -3.177452701121622 / 2.0, 2.0
    run = pc.simulate(scene, state, 4.0, rtol=1e-11, atol=1e-13, events=crossing_x)
    falls = math.acos(1.0 + 0.5 / rho) / turning
    expected = [falls, 2.0 * math.pi / turning - falls, 2.0 * math.pi / turning + falls]
    assert [event.kind for event in run.events] == ["user"] * 3
    np.testing.assert_allclose([event.time for event in run.events], expected, rtol=0.0, atol=1e-9)
    assert all(event.contact is None and event.index == 0 for event in run.events)
    assert all(abs(crossing_x(event.time, event.q, event.v)) <= 1e-9 for event in run.events)


@pytest.mark.parametrize(("direction", "which"), [(-1.0, [0, 2]), (1.0, [1])])
def test_direction_of_users_events(rolling, direction, which):
    scene, state = rolling

    def function(t, q, v):
        return crossing_x(t, q, v)

    every = pc.simulate(scene, state, 4.0, events=function).events
    function.direction = direction
    some = pc.simulate(scene, state, 4.0, events=function).events
    np.testing.assert_allclose([event.time for event in some], [every[i].time for i in which], rtol=0.0, atol=1e-7)


def test_terminal_event_ends_the_run(rolling):
    scene, state = rolling

    def function(t, q, v):
        return crossing_x(t, q, v)

    function.terminal = True
    run = pc.simulate(scene, state, 4.0, rtol=1e-11, atol=1e-13, events=[lambda t, q, v: 1.0, function])
    assert run.status == 1
    assert run.success
    assert kinds(run) == ["user"]
    assert run.events[0].index == 1
    assert run.t[-1] == run.events[0].time
    assert abs(run.q[-1, 0] + 0.5) <= 1e-12


def test_outputs_do_not_disturb_the_run(rolling):
    """More output times or events do not change the steps, nor the result."""
    scene, state = rolling
    plain = pc.simulate(scene, state, 2.0)
    dense = pc.simulate(scene, state, 2.0, t_eval=np.linspace(0.0, 2.0, 333), events=crossing_x)
    assert dense.stats["steps"] == plain.stats["steps"]
    np.testing.assert_array_equal(dense.q[-1], plain.q[-1])


def test_run_goes_on_from_any_output():
    """A state of a trajectory starts another run, which is the rest of the first, modes included."""
    scene, state = build("disk_plane_slip_then_roll", native=True)
    options = {"rtol": 1e-11, "atol": 1e-13}
    whole = pc.simulate(scene, state, 3.0, t_eval=np.linspace(0.0, 3.0, 31), **options)
    for row in (5, 14, 20):
        rest = pc.simulate(scene, whole.state(row), 3.0 - whole.t[row], t_eval=whole.t[row:], **options)
        assert rest.status == 0
        assert np.abs(rest.q - whole.q[row:]).max() <= 1e-8
        np.testing.assert_array_equal(rest.contacts["0"].mode, whole.contacts["0"].mode[row:])


def test_same_run_twice_is_the_same(rolling):
    scene, state = rolling
    one, two = (pc.simulate(scene, state, 1.0) for _ in range(2))
    np.testing.assert_array_equal(one.q, two.q)
    np.testing.assert_array_equal(one.contacts["0"].force, two.contacts["0"].force)
