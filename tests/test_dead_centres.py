"""Linkages whose sliding points pass dead centres, where slip is zero for an instant though nothing comes to rest."""

import functools
import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import pincontact as pc

GRAVITY = 9.81


class SliderCrank:
    """A crank of length l1 about z, and a rod of length l2 whose tip slides on the straight rail y = offset, in x.

    radius: of the tip, a disk about (x, offset) that touches the rail y = offset - radius.
    """

    def __init__(self, l1, l2, offset, mu, masses=(1.0, 1.0), radius=0.0):
        self.l1, self.l2, self.offset, self.mu, self.masses, self.radius = l1, l2, offset, mu, masses, radius
        self.inertias = masses[0] * l1**2 / 12.0, masses[1] * l2**2 / 12.0

    def scene(self, pattern):
        model = pin.Model()
        model.gravity.linear = np.array([0.0, -GRAVITY, 0.0])
        parent, place = 0, pin.SE3.Identity()
        for name, length, mass, inertia in zip("ab", (self.l1, self.l2), self.masses, self.inertias):
            parent = model.addJoint(parent, pin.JointModelRZ(), place, name)
            body = pin.Inertia(mass, np.array([0.5 * length, 0.0, 0.0]), np.diag([inertia, inertia, inertia]))
            model.appendBodyToJoint(parent, body, pin.SE3.Identity())
            model.addBodyFrame(name, parent, pin.SE3.Identity(), 0)
            place = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
        scene = pc.Scene(model)
        friction = pc.Coulomb(self.mu)
        at_rail = pin.SE3(np.eye(3), np.array([0.0, self.offset, 0.0]))
        if pattern == "2C-2C":
            tip = scene.add_contour("tip", pc.Circle(self.radius), "b", placement=place)
            at_rail.translation[1] -= self.radius
        else:
            tip = scene.add_contour("tip", pc.Point(), "b", placement=place)
        if pattern == "P-S":
            # a plane with its normal along y: the second tangent is one that no joint moves the tip along
            at_rail.rotation = pin.utils.rotate("x", -0.5 * math.pi)
        rail = scene.add_contour("rail", pc.Plane() if pattern == "P-S" else pc.Line(), placement=at_rail)
        scene.add_contact("c", tip, rail, bilateral=True, pattern=pattern, friction=friction)
        return scene

    def place(self, angle, rate):
        """(q, v) of the two joints."""
        rod, along, _ = self._rod(angle)
        return np.array([angle, rod - angle]), np.array([rate, (along - 1.0) * rate])

    def _rod(self, angle):
        """Angle of the rod, and its first two derivatives by the crank's."""
        rod = math.asin((self.offset - self.l1 * math.sin(angle)) / self.l2)
        along = -self.l1 * math.cos(angle) / (self.l2 * math.cos(rod))
        bent = (self.l1 * math.sin(angle) + self.l2 * math.sin(rod) * along**2) / (self.l2 * math.cos(rod))
        return rod, along, bent

    def slip(self, angle, rate):
        """Velocity of the tip along x."""
        rod, along, _ = self._rod(angle)
        return -(self.l1 * math.sin(angle) + (self.l2 * math.sin(rod) - self.radius) * along) * rate

    def acceleration(self, angle, rate, sign):
        """Of the crank, with slip of this sign: Lagrange's equations in both angles, and the rail's force."""
        (m1, m2), (l1, l2) = self.masses, (self.l1, self.l2)
        rod, along, bent = self._rod(angle)
        mass = np.array(
            [
                [m1 * l1**2 / 3.0 + m2 * l1**2, 0.5 * m2 * l1 * l2 * math.cos(angle - rod)],
                [0.5 * m2 * l1 * l2 * math.cos(angle - rod), m2 * l2**2 / 3.0],
            ]
        )
        turned, coupling = along * rate, 0.5 * m2 * l1 * l2 * math.sin(angle - rod)
        loads = np.array(
            [
                -coupling * turned**2 - GRAVITY * math.cos(angle) * l1 * (0.5 * m1 + m2),
                coupling * rate**2 - GRAVITY * math.cos(rod) * 0.5 * l2 * m2,
            ]
        )
        normal = np.array([l1 * math.cos(angle), l2 * math.cos(rod)])
        tangent = np.array([-l1 * math.sin(angle), self.radius - l2 * math.sin(rod)])
        found = []
        for side in (1.0, -1.0):
            force = normal - self.mu * side * sign * tangent
            matrix = np.column_stack([mass @ [1.0, along], -force])
            value, load = np.linalg.solve(matrix, loads - mass[:, 1] * bent * rate**2)
            if load * side >= 0.0:
                found.append(value)
        assert len(found) == 1, "one solution is what these cases are chosen for"
        return found[0]

    def integrate(self, angle, rate, duration):
        """(angle, rate) at the end and the times at which the slip turned round."""
        t, y, turns = 0.0, np.array([angle, rate]), []
        sign = math.copysign(1.0, self.slip(angle, rate))
        while t < duration:

            def event(_, y):
                return self.slip(*y)

            event.terminal, event.direction = True, -sign
            found = solve_ivp(
                lambda _, y, sign=sign: [y[1], self.acceleration(*y, sign)],
                (t, duration),
                y,
                method="DOP853",
                rtol=1e-12,
                atol=1e-13,
                # events are found on the dense output, which is less exact than the steps
                max_step=5e-3,
                events=event,
            )
            t, y = float(found.t[-1]), found.y[:, -1]
            if found.status == 1:
                turns.append(t)
                sign = -sign
                if abs(y[1]) < 1.0:
                    # it may come to rest there, which is another matter
                    return y, None
        return y, turns


@functools.cache
def random_crank(seed, radius=0.0):
    """A crank that goes round, with its start, its end and the times of its dead centres."""
    rng = np.random.default_rng(seed)
    while True:
        l1 = rng.uniform(0.3, 1.0)
        offset = 0.0 if seed % 2 else rng.uniform(-0.2, 0.2) * l1
        mu, masses = rng.uniform(0.05, 0.4), tuple(rng.uniform(0.5, 2.0, 2))
        crank = SliderCrank(l1, l1 * rng.uniform(1.4, 3.0), offset, mu, masses, radius)
        angle, rate = rng.uniform(-math.pi, math.pi), rng.choice([-1.0, 1.0]) * rng.uniform(8.0, 14.0)
        expected, turns = crank.integrate(angle, rate, 1.0)
        if turns:
            return crank, (angle, rate), expected, turns


@pytest.mark.parametrize("method", ["DOP853", "Sharp98", "RK45", "RK23"])
def test_slider_crank_passes_its_dead_centre(method):
    """It used to stick there for an instant, and a projection took most of its velocity."""
    crank = SliderCrank(1.0, 1.5, 0.0, 0.4)
    scene = crank.scene("P-2C")
    expected, turns = crank.integrate(-1.0, 7.5, 1.5)
    run = pc.simulate(scene, scene.initial_state(*crank.place(-1.0, 7.5)), 1.5, method=method)
    assert run.status == 0, run.message
    assert len(turns) == 3
    # RK23 at the default tolerances has errors of some 1e-6
    np.testing.assert_allclose([run.q[-1, 0], run.v[-1, 0]], expected, rtol=0.0, atol=1e-5)
    assert [event.kind for event in run.events] == ["slip"] * 3
    np.testing.assert_allclose([event.time for event in run.events], turns, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("pattern", ["P-2C", "P-3C", "2C-2C", "P-S"])
@pytest.mark.parametrize("seed", range(2))
def test_random_slider_cranks(seed, pattern):
    crank, begin, expected, turns = random_crank(seed, 0.05 if pattern == "2C-2C" else 0.0)
    scene = crank.scene(pattern)
    start = scene.initial_state(*crank.place(*begin))
    run = pc.simulate(scene, start, 1.0, rtol=1e-10, atol=1e-12)
    assert run.status == 0, run.message
    # some hundred tolerances; on a curve in space the load has a kink where it changes direction, which steps do not
    # see: up to 1e4 of them
    allowed = 2e-6 if pattern == "P-3C" else 2e-8
    np.testing.assert_allclose([run.q[-1, 0], run.v[-1, 0]], expected, rtol=0.0, atol=allowed)
    assert [event.kind for event in run.events] == ["slip"] * len(turns)
    errors = []
    for step in (2e-3, 1e-3):
        stepped = pc.simulate(scene, start, 1.0, method="Moreau", step=step)
        assert stepped.status == 0, stepped.message
        errors.append(abs(stepped.q[-1, 0] - expected[0]))
    # second order but for the steps in which slip turns round; largest here: 2.5e-3 and 7e-4 rad
    assert errors[1] < 0.6 * errors[0] < 3e-3


@pytest.mark.parametrize("seed", [11, 12, 26, 73, 93, 97])
def test_slip_on_a_plane_turns_round_as_on_a_line(seed):
    """No step goes over a place at which slip of two tangents turns round; one of several hundred used to."""
    rng = np.random.default_rng(seed)
    crank = SliderCrank(
        0.1, rng.uniform(0.2, 0.4), rng.uniform(-0.05, 0.05), rng.uniform(0.05, 0.35), tuple(rng.uniform(0.2, 2.0, 2))
    )
    size, rate, phase = rng.uniform(-2.0, 2.0, 2) * [1.0, 0.2], rng.uniform(3.0, 15.0, 2), rng.uniform(0.0, 6.0, 2)
    place, runs = crank.place(rng.uniform(0.0, 6.0), rng.normal(0.0, 6.0)), []
    for pattern in ("P-S", "P-2C"):
        scene = crank.scene(pattern)
        state = scene.initial_state(*place)
        runs.append(pc.simulate(scene, state, 1.0, control=lambda t, q, v: size * np.sin(rate * t + phase)))
    assert [run.status for run in runs] == [0, 0]
    on_plane, on_line = ([(event.kind, event.time) for event in run.events] for run in runs)
    assert len(on_line) >= 3
    assert [kind for kind, _ in on_plane] == [kind for kind, _ in on_line]
    # a few hundred tolerances, over the accelerations at which slip passes zero
    np.testing.assert_allclose([t for _, t in on_plane], [t for _, t in on_line], rtol=0.0, atol=1e-5)


def test_start_at_a_dead_centre():
    """A run that starts where the slip is zero for an instant slides on."""
    crank = SliderCrank(1.0, 1.5, 0.0, 0.4)
    scene = crank.scene("P-2C")
    run = pc.simulate(scene, scene.initial_state(*crank.place(0.0, 7.5)), 0.3)
    assert run.status == 0, run.message
    expected, _ = crank.integrate(1e-9, 7.5, 0.3)
    np.testing.assert_allclose([run.q[-1, 0], run.v[-1, 0]], expected, rtol=0.0, atol=1e-6)


def test_a_crank_at_rest_still_sticks():
    """At rest near its dead centre friction holds it: by statics, where the load is what the cone carries."""
    crank = SliderCrank(1.0, 1.5, 0.0, 5.0)
    scene = crank.scene("P-2C")
    run = pc.simulate(scene, scene.initial_state(*crank.place(-1.0, 0.0)), 1.0)
    assert run.status == 0, run.message
    np.testing.assert_allclose(run.v[-1], 0.0, atol=1e-12)


class ScotchYoke:
    """A crank of radius a, whose pin slides with friction in the straight slot, across x, of a slider along x."""

    radius, inertia, mass = 0.1, 0.02, 1.0

    def __init__(self, mu):
        self.mu = mu

    def scene(self):
        model = pin.Model()
        model.gravity.linear = np.array([0.0, -GRAVITY, 0.0])
        for kind, name, mass, inertia in (
            (pin.JointModelRUBZ(), "crank", 1.0, self.inertia),
            (pin.JointModelPX(), "slider", self.mass, 1.0),
        ):
            joint = model.addJoint(0, kind, pin.SE3.Identity(), name)
            model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), inertia * np.eye(3)), pin.SE3.Identity())
            model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
        scene = pc.Scene(model)
        tip = pin.SE3(np.eye(3), np.array([self.radius, 0.0, 0.0]))
        scene.add_contour("pin", pc.Point(), frame="crank", placement=tip)
        slot = pin.SE3(pin.utils.rotate("z", 0.5 * math.pi), np.zeros(3))
        scene.add_contour("slot", pc.Line((-0.12, 0.12)), frame="slider", placement=slot)
        scene.add_contact("c", "pin", "slot", pc.Coulomb(self.mu), bilateral=True)
        return scene

    def motion(self, speed, duration):
        """Angle and speed of the crank at the end: with N = m x'' on the slider, of either sign, and friction mu |N|
        against the slip a w cos c."""
        a, m = self.radius, self.mass

        def rates(t, y):
            c, w = y
            for sign in (1.0, -1.0):
                arm = a * math.sin(c) - a * math.cos(c) * self.mu * sign * math.copysign(1.0, w * math.cos(c))
                change = -arm * m * a * math.cos(c) * w * w / (self.inertia + arm * m * a * math.sin(c))
                force = -m * a * (math.sin(c) * change + math.cos(c) * w * w)
                if sign * force >= 0.0:
                    break
            return w, change

        return solve_ivp(rates, (0.0, duration), (0.0, speed), rtol=1e-10, atol=1e-12, max_step=1e-3).y[:, -1]


@pytest.mark.parametrize("rtol", [1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize(("mu", "speed"), [(0.1, 10.0), (0.3, 5.0), (0.5, 20.0)])
def test_a_pin_in_a_slot(mu, speed, rtol):
    """At the ends of the slider's way slip and load pass zero at once, which neither tells where it goes."""
    yoke = ScotchYoke(mu)
    scene = yoke.scene()
    run = pc.simulate(
        scene, scene.initial_state([1.0, 0.0, yoke.radius], [speed, 0.0]), 1.0, rtol=rtol, atol=0.01 * rtol
    )
    assert run.status == 0, run.message
    angle, final = yoke.motion(speed, 1.0)
    # some hundred steps' errors, of motions at 10 rad/s
    assert run.v[-1, 0] == pytest.approx(final, abs=100.0 * rtol)
    assert math.remainder(math.atan2(run.q[-1, 1], run.q[-1, 0]) - angle, 2.0 * math.pi) == pytest.approx(
        0.0, abs=100.0 * rtol
    )


@pytest.mark.parametrize("crossing", [1.2, 2.0, 0.5 * math.pi])
@pytest.mark.parametrize("mu", [0.1, 0.2])
def test_trammel_with_friction_in_both_slots(mu, crossing):
    """A rod with two points on crossing lines turns on where one of the points turns round: nothing there holds it, and
    what the sliding one beside it pulls does not either, whichever of the dependent rows an evaluation leaves out."""
    model, length = pin.Model(), 0.4
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "rod")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.2, 0.03, 0.0]), 0.03 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("rod", joint, pin.SE3.Identity(), 0)
    turns = 0
    for angle, speed in ((0.3, -5.0), (1.3, 5.0)):
        scene = pc.Scene(model)
        for i, line in enumerate((0.5, 0.5 + crossing)):
            point = pin.SE3(np.eye(3), np.array([length * i, 0.0, 0.0]))
            scene.add_contour(f"point{i}", pc.Point(), "rod", placement=point)
            scene.add_contour(f"line{i}", pc.Line(), placement=pin.SE3(pin.utils.rotate("z", line), np.zeros(3)))
            scene.add_contact(f"c{i}", f"point{i}", f"line{i}", pc.Coulomb(mu), bilateral=True)
        # so that both points are on their lines
        normal, rod = 0.5 + crossing + 0.5 * math.pi, 0.5 + angle
        way = -length * math.cos(normal - rod) / math.cos(normal - 0.5)
        q = [way * math.cos(0.5), way * math.sin(0.5), math.cos(rod), math.sin(rod)]
        start = scene.initial_state(q, [0.0, 0.0, speed])
        run = pc.simulate(scene, start, 1.0, energies=True)
        assert run.status == 0, run.message
        turns += sum(event.kind == "slip" for event in run.events)
        assert np.abs(run.energies().balance).max() < 1e-7
        steps = pc.simulate(scene, start, 1.0, method="Moreau", dt=2.5e-4)
        np.testing.assert_allclose(steps.q[-1], run.q[-1], rtol=0.0, atol=2e-3)
    assert turns > 0
