"""Time stepping of bodies that touch a ground at one place after the other: where they first touch in a step, whatever
its size, by dense samples of both; and what outputs show of contacts that would pull."""

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest
from test_open_contacts import body

import pincontact as pc

# A curve's y-axis points up, the ring rolls along x.
UPRIGHT = pin.SE3(pin.utils.rotate("x", math.pi / 2), np.zeros(3))
RADIUS = 0.1
# Of a bowl: x y z w.
TURNED = [-0.3006038043720752, 0.2373156172309605, 0.17290238882348796, 0.9074268094752628]


def scene_over(shape, field, contacts, mu=0.5):
    scene = pc.Scene(body(shape))
    scene.add_contour("shape", shape, frame="body", placement=UPRIGHT)
    scene.add_contour("ground", pc.HeightField(field, domain=((-1.0, 1.0), (-1.0, 1.0))))
    for i in range(contacts):
        scene.add_contact(f"c{i}", "shape", "ground", friction=pc.Coulomb(mu) if mu else None)
    return scene


def depth(run, field):
    """How far in m samples of an upright disk are below the ground, at most, for each output."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 4001)
    x, z = run.q[:, :1] + RADIUS * np.sin(angle), run.q[:, 2:3] - RADIUS * np.cos(angle)
    slope = (field(x + 1e-6, 0.0) - field(x - 1e-6, 0.0)) / 2e-6
    return ((field(x, 0.0) - z) / np.sqrt(1.0 + slope * slope)).max(axis=1)


def profile(rng):
    """A ridge or trench of random height and width in m that a disk of this radius strikes; its least radius."""
    height = rng.uniform(0.02, 0.06) * rng.choice([-1.0, 1.0])
    width = rng.uniform(0.8, 2.0) * abs(height)
    return (lambda x, y: height * np.exp(-((x / width) ** 2)) + 0.0 * y), 0.5 * width**2 / abs(height)


def first_touches(run):
    """Of each contact the time in s of its first touch."""
    return {event.contact: event.time for event in reversed(run.events) if event.kind == "touch"}


@pytest.mark.parametrize("seed", range(2))
def test_disks_strike_flanks(seed):
    """Rings and balls roll on the plane to a ridge, or over a trench: a second contact strikes the flank within the
    step in which it is reached, at the time that events give."""
    rng = np.random.default_rng(seed)
    field, bend = profile(rng)
    shape = [pc.Circle(RADIUS), pc.Sphere(RADIUS)][seed % 2]
    scene = scene_over(shape, field, 3)
    speed = rng.uniform(0.5, 1.5)
    start = np.array([-rng.uniform(0.2, 0.3), 0.0, RADIUS + 0.01, 0.0, 0.0, 0.0, 1.0])
    state = scene.initial_state(start, [speed, 0.0, 0.0, 0.0, speed / RADIUS, 0.0], free=list(scene.contacts))
    exact = first_touches(pc.simulate(scene, state, 0.35))
    end = max(exact.values()) + 0.02
    for step in (2e-3, 4e-3):
        run = pc.simulate(scene, state, end, method="Moreau", dt=step)
        assert run.status == 0, run.message
        # a place that is none yet as the step begins comes to be by how the ground bends on the way; a place that is
        # a step late would be in by the way itself, times the sine of the slope
        assert depth(run, field).max() < 0.5 * (speed * step) ** 2 / bend
        found = first_touches(run)
        assert sorted(found.values()) == pytest.approx(sorted(exact.values()), abs=step)


def test_one_contact_flies_to_the_other_flank():
    """It leaves one edge of a trench, to which it stays nearest up to the step in which it strikes the other one."""

    def field(x, y):
        return -0.0045 * np.exp(-((x / 0.0122) ** 2)) + 0.0 * y

    scene = scene_over(pc.Circle(RADIUS), field, 1, mu=0.8)
    start = np.array([-0.15, 0.0, RADIUS + 1e-3, 0.0, 0.0, 0.0, 1.0])
    for speed, step in ((1.2, 4e-3), (1.4, 2e-3), (1.6, 4e-3), (2.2, 2e-3)):
        state = scene.initial_state(start, [speed, 0.0, 0.0, 0.0, speed / RADIUS, 0.0], free=["c0"])
        run = pc.simulate(scene, state, 0.14, method="Moreau", dt=step)
        # a step late would be 1e-4 to 1e-3
        assert run.status == 0 and depth(run, field).max() < 1e-5, run.message


def ring_in_bowl(turned):
    """A ring that lies down in a bowl: its contact runs round it at up to 450 rad/s."""
    scene = pc.Scene(body(pc.Circle(0.09114874117773833)))
    scene.add_contour("ring", pc.Circle(0.09114874117773833), frame="body")
    bowl = pc.Ellipsoid(0.6784087113578872, 0.8115534141178526, 0.8531837812705673)
    scene.add_contour("bowl", bowl, placement=pin.SE3(pin.Quaternion(np.array(turned)), np.zeros(3)))
    for i in range(4):
        scene.add_contact(f"c{i}", "ring", "bowl", side=-1)
    start = np.array([0.026748676037246233, 0.24775014171719634, 0.14633095960687653, 0.0, 0.0, 0.0, 1.0])
    v = [-1.901222739800844, -1.289537739784976, -1.8417350377917323, 0.0, 0.0, 0.0]
    return scene, scene.initial_state(start, v, free=list(scene.contacts))


@pytest.mark.parametrize("turned", [TURNED, [0.0, 0.0, 0.0, 1.0]], ids=["leaps", "comes to another"])
def test_contacts_of_one_pair_share_no_place(turned):
    """Newton's method went over to the place of another contact, which three of four came to share by 0.267 s; or what
    was open touched where another one was closed."""
    scene, state = ring_in_bowl(turned)
    run = pc.simulate(scene, state, 0.3, method="Moreau", dt=1e-3)
    assert run.status == 0, run.message
    pairs = 0
    for i in range(len(run.t)):
        closed = [track.point[i] for track in run.contacts.values() if track.mode[i] != -1]
        for one, two in itertools.combinations(closed, 2):
            pairs += 1
            assert np.linalg.norm(one - two) > 1e-3
    # it does lie down; the other one only did by the energy that a step took from it, and not in steps of 0.1 ms
    assert pairs >= 3 or turned is not TURNED


def test_steps_in_which_contacts_leap_are_divided():
    """The same in a stepper, row by row and with outputs in between; forces are means over whole steps."""
    scene, state = ring_in_bowl(TURNED)
    run = pc.simulate(scene, state, 0.27, method="Moreau", dt=1e-3)
    assert run.status == 0 and len(run.t) > 271, run.message
    times = np.linspace(0.26, 0.268, 30)
    asked = pc.simulate(scene, state, 0.27, method="Moreau", dt=1e-3, t_eval=times)
    np.testing.assert_array_equal(asked.t, times)
    stepper, other = (pc.Stepper(scene, state, dt=1e-3) for _ in range(2))
    rows, _ = other.rollout(np.zeros((270, 6)))
    mass = sum(inertia.mass for inertia in scene.model.inertias)
    inside = next(t for t in run.t if abs(t - round(t, 3)) > 1e-9)
    for i in range(270):
        before = pin.Quaternion(stepper.q[3:7]).matrix() @ stepper.v[:3]
        stepper.step(np.zeros(6))
        k = int(np.argmin(np.abs(run.t - stepper.t)))
        assert abs(run.t[k] - stepper.t) < 1e-12
        np.testing.assert_array_equal(run.q[k], stepper.q)
        np.testing.assert_array_equal(rows[i], stepper.q)
        if i == int(inside / 1e-3):
            # the mean force of a step that is divided, up to the corrections of its ends, which are a twentieth of it
            # as what leapt comes down; that of its last part is another one altogether
            gained = pin.Quaternion(stepper.q[3:7]).matrix() @ stepper.v[:3] - before
            expected = mass * (gained / 1e-3 - scene.model.gravity.linear)
            np.testing.assert_allclose(-sum(stepper.forces.values()), expected, rtol=0.06)


@pytest.mark.parametrize("law", [None, pc.Coulomb(0.4), pc.Coulomb(0.4, viscous=0.5), pc.NoSlip()], ids=str)
@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_outputs_show_no_forces_that_pull(law, speed):
    """On top of a dome: the faster ball flies off, v^2 > g (R + r), and both methods show the same at the start."""
    scene = pc.Scene(body(pc.Sphere(0.1)))
    scene.add_contour("ball", pc.Sphere(0.1), "body")
    scene.add_contour("dome", pc.Sphere(0.5))
    scene.add_contact("c", "ball", "dome", friction=law)
    spin = speed / 0.1 if isinstance(law, pc.NoSlip) else 0.0
    state = scene.initial_state([0.0, 0.0, 0.6, 0.0, 0.0, 0.0, 1.0], [speed, 0.0, 0.0, 0.0, spin, 0.0])
    tracks = [pc.simulate(scene, state, 3e-3, method=method).contacts["c"] for method in ("DOP853", "Moreau")]
    for track in tracks:
        assert (track.mode[0] == -1) == (speed > 2.0)
        assert track.normal_force.min() >= 0.0
    assert tracks[0].normal_force[0] == pytest.approx(tracks[1].normal_force[0], abs=1e-9)


def limbed(seed):
    """A body with three limbs, balls at their knees and feet and limits at their hips, above uneven ground."""
    rng, model = np.random.default_rng(seed), pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia(2.0, np.zeros(3), 0.02 * np.eye(3)), pin.SE3.Identity())
    names = []
    for i, angle in enumerate((0.0, 2.1, 4.2)):
        place = pin.SE3(pin.utils.rotate("z", angle), 0.15 * np.array([np.cos(angle), np.sin(angle), 0.0]))
        ends = [np.array([number]) for number in (50.0, 50.0, -0.3, 0.5)]
        hip = model.addJoint(base, pin.JointModelRY(), place, f"hip{i}", *ends)
        inertia = pin.Inertia(0.4, np.array([0.1, 0.0, -0.1]), 0.002 * np.eye(3))
        model.appendBodyToJoint(hip, inertia, pin.SE3.Identity())
        for name, point in ((f"knee{i}", [0.2, 0.0, -0.05]), (f"foot{i}", [0.1, 0.0, -0.3])):
            model.addBodyFrame(name, hip, pin.SE3(np.eye(3), np.array(point)), 0)
            names.append(name)
    scene = pc.Scene(model)
    ground = scene.add_contour("ground", pc.HeightField(lambda x, y: 0.03 * np.sin(8.0 * x) * np.cos(7.0 * y)))
    for name in names:
        ball = scene.add_contour(name, pc.Sphere(0.03), frame=name)
        scene.add_contact(name, ball, ground, friction=pc.Coulomb(0.7))
    q = pin.neutral(model)
    q[2], q[:2] = 0.5, rng.uniform(-1.0, 1.0, 2)
    q[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(*rng.uniform(-0.5, 0.5, 3))).coeffs()
    v = 0.5 * rng.normal(size=model.nv)
    v[6:] = 0.0
    return scene, scene.initial_state(q, v, free=names)


@pytest.mark.parametrize("seed", [0, 5, 10, 16])
def test_feet_that_open_while_others_strike_touch_again(seed):
    """They end such a step inside by up to what they move in it, and sank by 2 to 12 cm (5, 10). Bodies that are
    moved out of each other, or to the ends of joints, elsewhere make no contact leap (0, 16)."""
    scene, state = limbed(seed)
    run = pc.simulate(scene, state, 0.8, method="Moreau", dt=1e-3)
    assert run.status == 0, run.message
    # in a step of 1 ms at up to 3 m/s
    assert min(np.nanmin(track.gap) for track in run.contacts.values()) > -3e-3
