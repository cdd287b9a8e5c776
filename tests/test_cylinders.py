"""Cylinders and capsules beside each other, at any angle: gaps and touches against the exact distance of segments."""

import math

import numpy as np
import pinocchio as pin
import pytest
import scipy
from shared import one_body, rotation

import pincontact as pc


def flying():
    """A free body without gravity."""
    model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)))
    model.gravity.linear = np.zeros(3)
    return model


def capsules(sizes, order=None, **options):
    """A scene of a capsule of the world along z and a free one, and names of its nine contacts. sizes: radius and half
    length of each."""
    scene, parts = pc.Scene(flying()), []
    for name, frame, (radius, half) in zip("ab", (None, "body"), sizes):
        where = {} if frame is None else {"frame": frame}
        own = [scene.add_contour(name, pc.Cylinder(radius, (None, (-half, half))), **where)]
        for sign in (1, -1):
            end = pin.SE3(np.eye(3), np.array([0.0, 0.0, sign * half]))
            own.append(scene.add_contour(f"{name}{sign}", pc.Sphere(radius), placement=end, **where))
        parts.append(own)
    pairs = [(one, two) for one in parts[0] for two in parts[1]]
    turned = np.zeros(9, dtype=bool) if order is None else order
    names = [
        scene.add_contact(one.name + two.name, *((two, one) if turn else (one, two)), **options).name
        for (one, two), turn in zip(pairs, turned)
    ]
    return scene, names


def distance(place, axis, halves):
    """Of a segment (-half, half) along z and one around a place, along an axis: by its parts, which are convex."""

    def from_first(s):
        point = place + s * axis
        point = point - [0.0, 0.0, min(max(point[2], -halves[0]), halves[0])]
        return math.hypot(*point)

    inside = scipy.optimize.minimize_scalar(from_first, bounds=(-halves[1], halves[1]), options={"xatol": 1e-14})
    return min(inside.fun, from_first(-halves[1]), from_first(halves[1]))


@pytest.mark.parametrize("tilt", [1.5, 0.1, 1e-3])
def test_place_and_gap(tilt):
    """On the line across both axes, by least squares; the gap is what is left of it between them."""
    rng = np.random.default_rng(3)
    for _ in range(5):
        first, turn = rotation(rng), np.cross(rng.normal(size=3), rng.normal(size=3))
        turn -= turn @ first[:, 2] * first[:, 2]
        second = pin.exp3(tilt * turn / np.linalg.norm(turn)) @ first
        origin, place = rng.normal(size=(2, 3))
        radii = rng.uniform(0.05, 0.2, 2)
        model = one_body(pin.JointModelFreeFlyer(), pin.Inertia.FromSphere(1.0, 0.1))
        scene = pc.Scene(model)
        scene.add_contour("own", pc.Cylinder(radii[1]), "body")
        scene.add_contour("other", pc.Cylinder(radii[0]), placement=pin.SE3(first, origin))
        scene.add_contact("c", "own", "other")
        state = scene.initial_state(np.r_[place, pin.Quaternion(second).coeffs()], free=["c"])
        axes = np.column_stack([second[:, 2], -first[:, 2]])
        along, *_ = np.linalg.lstsq(axes, origin - place, rcond=None)
        feet = place + along[0] * second[:, 2], origin + along[1] * first[:, 2]
        between = np.linalg.norm(feet[1] - feet[0])
        track = pc.analyze(scene, state)["c"]
        scale = 1e-12 / tilt**2  # how far rounding moves the place along the axes
        assert abs(track.gap - (between - radii.sum())) < 1e-12 + scale * between
        towards = (feet[1] - feet[0]) / between
        for name, foot, radius, sign in (("own", feet[0], radii[1], 1.0), ("other", feet[1], radii[0], -1.0)):
            point = scene.contours[name]
            pose = pin.SE3(second, place) if name == "own" else pin.SE3(first, origin)
            u = state.location_of("c")[0 if name == "own" else 1]
            found = pose.act(point.contour.point(u))
            np.testing.assert_allclose(found, foot + sign * radius * towards, atol=1e-11 + 10.0 * scale)


@pytest.mark.parametrize("method", ["DOP853", "RK45", "Moreau"])
@pytest.mark.parametrize("seed", range(8))
def test_capsules_touch_when_segments_say_so(method, seed):
    """Nearly parallel ones, too, whichever contour comes first: the first touch, and that nothing overlaps before."""
    rng = np.random.default_rng(seed)
    sizes = rng.uniform(0.05, 0.2, (2, 2))
    halves, radii = sizes[:, 1], sizes[:, 0].sum()
    turn = pin.exp3(rng.normal(size=3) * 10.0 ** rng.uniform(-5.0, 0.0))
    normal = rng.normal(size=3) * [1.0, 1.0, 0.2]
    normal /= np.linalg.norm(normal)
    place = normal * (radii + 0.03) + [0.0, 0.0, rng.uniform(-0.2, 0.2)]
    velocity, spin = -normal * rng.uniform(0.2, 1.0), 0.2 * rng.normal(size=3)

    def gap(t):
        axis = pin.exp3(spin * t) @ turn[:, 2]
        return distance(place + t * velocity, axis, halves) - radii

    times = np.linspace(0.0, 0.3, 301)
    inside = np.flatnonzero(np.array([gap(t) for t in times]) < 0.0)
    touch = scipy.optimize.brentq(gap, times[inside[0] - 1], times[inside[0]]) if inside.size else math.inf
    scene, names = capsules(sizes, rng.random(9) < 0.5, restitution=1.0)
    q, v = np.r_[place, pin.Quaternion(turn).coeffs()], np.r_[turn.T @ velocity, turn.T @ spin]
    assert gap(0.0) > 1e-3
    state = scene.initial_state(q, v, free=names)
    run = pc.simulate(scene, state, min(touch + 0.05, 0.3), method=method)
    assert run.status == 0, run.message
    touches = [event.time for event in run.events if event.kind == "touch"]
    if touch > 0.3:
        assert not touches
    else:
        # steps of 1 ms tell their instants; else to the tolerance, over the speed
        assert abs(touches[0] - touch) < (2e-3 if method == "Moreau" else 1e-6)
    axes = [pin.Quaternion(q[3:]).matrix()[:, 2] for q in run.q]
    depth = min(distance(q[:3], axis, halves) for q, axis in zip(run.q, axes)) - radii
    # a step of 1 ms goes up to a millimetre in
    assert depth > (-1e-3 if method == "Moreau" else -1e-7)


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
def test_parallel_ones_are_told_where_they_touch_along_a_line(method):
    """Not before: they are nowhere until then."""
    scene = pc.Scene(flying())
    scene.add_contour("a", pc.Cylinder(0.1, (None, (-0.15, 0.15))))
    scene.add_contour("b", pc.Cylinder(0.1, (None, (-0.15, 0.15))), "body")
    scene.add_contact("c", "a", "b")
    state = scene.initial_state([0.25, 0.0, 0.02, 0.0, 0.0, 0.0, 1.0], [-0.5, 0.0, 0.0, 0.0, 0.0, 0.0], free=["c"])
    run = pc.simulate(scene, state, 0.09, method=method)
    assert run.status == 0 and not run.events
    run = pc.simulate(scene, state, 0.2, method=method)
    assert run.status == -3 and "along a line" in run.message
    told = float(run.message.removeprefix("t = ").split()[0])
    assert run.t[-1] <= 0.1 + 1e-3 and abs(told - 0.1) < 1e-2


@pytest.mark.parametrize(("method", "step", "cases"), [("DOP853", None, 12), ("Moreau", 1e-3, 12), ("Moreau", 1e-4, 3)])
def test_a_needle_comes_across_a_capsule_near_the_end_of_its_side(method, step, cases):
    """Within a step of time stepping it touches the side first, and then, as if the side were not there, the cap's
    sphere, which goes on below it; the side holds it."""
    radius, half, long = 0.2, 0.17, 0.5
    for seed in range(cases):
        rng = np.random.default_rng(seed)
        scene = pc.Scene(flying())
        scene.add_contour("side", pc.Cylinder(radius, (None, (-half, half))))
        scene.add_contour("needle", pc.Line((-long, long)), "body")
        for sign in (1, -1):
            end = pin.SE3(np.eye(3), np.array([0.0, 0.0, sign * half]))
            scene.add_contour(f"cap {sign}", pc.Sphere(radius), placement=end)
            tip = pin.SE3(np.eye(3), np.array([sign * long, 0.0, 0.0]))
            scene.add_contour(f"tip {sign}", pc.Point(), "body", tip)
        own = [name for name in scene.contours if name.startswith(("side", "cap"))]
        names = [
            scene.add_contact(f"{one} {other}", one, other, friction=pc.Coulomb(0.4)).name
            for one in own
            for other in scene.contours
            if other not in own
        ]
        along = rng.normal(size=3) * [1.0, 1.0, 0.5]
        along /= np.linalg.norm(along)
        normal = np.array([-along[1], along[0], 0.0]) / math.hypot(*along[:2])
        height = rng.choice([1.0, -1.0]) * (half - rng.uniform(0.0, 0.03))
        place = (radius + 0.03) * normal + rng.uniform(-0.2, 0.2) * along + [0.0, 0.0, height]
        across = np.cross(along, [0.0, 0.0, 1.0]) / math.hypot(*along[:2])
        turn = np.column_stack([along, across, np.cross(along, across)])
        velocity, spin = -rng.uniform(0.5, 1.5) * normal + 0.2 * rng.normal(size=3), 2.0 * rng.normal(size=3)
        if distance(place, along, (half, long)) < radius + 2e-3:
            continue
        q, v = np.r_[place, pin.Quaternion(turn).coeffs()], np.r_[turn.T @ velocity, turn.T @ spin]
        times = np.linspace(0.0, 0.1, 51)
        state = scene.initial_state(q, v, free=names)
        run = pc.simulate(scene, state, 0.1, method=method, dt=step, t_eval=times)
        assert run.status == 0, run.message
        axes = [pin.Quaternion(q[3:]).matrix()[:, 0] for q in run.q]
        depth = min(distance(q[:3], axis, (half, long)) for q, axis in zip(run.q, axes)) - radius
        assert depth > -1e-7


def test_a_rim_and_a_side_start_apart_wherever_they_are():
    """Where none of their points face each other inside the side's ends, too: it bends away from the rim."""
    rng = np.random.default_rng(0)
    angles = np.linspace(0.0, 2.0 * np.pi, 721)
    started = 0
    for _ in range(150):
        rim, radius, half = rng.uniform(0.05, 0.3), rng.uniform(0.03, 0.15), rng.uniform(0.03, 0.2)
        scene = pc.Scene(flying())
        scene.add_contour("rim", pc.Circle(rim))
        scene.add_contour("side", pc.Cylinder(radius, (None, (-half, half))), "body")
        scene.add_contact("c", "rim", "side")
        turn, place = rotation(rng), rng.uniform(-0.7, 0.7, 3)
        points = (rim * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles]) - place) @ turn
        if ((np.hypot(points[:, 0], points[:, 1]) < radius) & (np.abs(points[:, 2]) < half)).any():
            continue
        scene.initial_state(np.r_[place, pin.Quaternion(turn).coeffs()], free=["c"])
        started += 1
    assert started > 120
