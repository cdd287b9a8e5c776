"""Bodies of lines and points, all of whose pairs are declared: what slides over one face of a body passes by the others
that end at its corners, what runs into a wall strikes it, and what rolls onto a corner goes on there."""

import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

G = 9.81


def body(inertia: float, turned: float) -> pin.Model:
    """A body of 1 kg in the xy-plane of a world that is turned by an angle."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), inertia * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    model.gravity.linear = G * np.array([math.sin(turned), -math.cos(turned), 0.0])
    return model


def rotation(angle: float) -> np.ndarray:
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def state_of(place, speed: float, turned: float):
    """q and v of a body at a place (2,), level with the turned world, that moves along its x-axis."""
    return [*(rotation(turned) @ place), math.cos(turned), math.sin(turned)], [speed, 0.0, 0.0]


def add_polygon(scene: pc.Scene, name: str, corners: np.ndarray, frame: str | None = None) -> None:
    """Faces (lines, of which the outside is on the side +1) and corners of a body (n, 2), anticlockwise."""
    where = {} if frame is None else {"frame": frame}
    for i, (corner, other) in enumerate(zip(corners, np.roll(corners, -1, axis=0))):
        way = other - corner
        place = pin.SE3(pin.utils.rotate("z", math.atan2(way[1], way[0])), np.array([*corner, 0.0]))
        scene.add_contour(f"{name} face {i}", pc.Line((0.0, math.hypot(*way))), placement=place, **where)
        scene.add_contour(f"{name} corner {i}", pc.Point(), placement=place, **where)


def box_over(tables, width: float, height: float, speed: float, mu: float, turned: float):
    """A box that slides onto tables (name -> corners), with all pairs of faces and corners."""
    scene = pc.Scene(body((width**2 + height**2) / 12.0, turned))
    half = 0.5 * np.array([width, height])
    add_polygon(scene, "box", half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]), "body")
    for name, corners in tables.items():
        add_polygon(scene, name, corners @ rotation(turned).T)
        for i in range(4):
            for j in range(4):
                for one, two in ((f"box corner {i}", f"{name} face {j}"), (f"{name} corner {i}", f"box face {j}")):
                    scene.add_contact(f"{one}, {two}", one, two, pc.Coulomb(mu) if mu else None, side=1)
    closed = [f"box corner {i}, {next(iter(tables))} face 2" for i in (0, 1)]
    start = state_of(np.array([-1.0 + 0.6 * width, half[1]]), speed, turned)
    return scene, scene.initial_state(*start, free=[name for name in scene.contacts if name not in closed])


def rectangle(x: float, end: float, low: float, top: float) -> np.ndarray:
    return np.array([(x, low), (end, low), (end, top), (x, top)])


def along(run, turned: float) -> float:
    return float((rotation(turned).T @ run.q[-1, :2])[0])


def over_tables(seed: int, down: float):
    """Scene and state of a box that slides over three tables, each so much lower than the one before, how far it has
    come after 1 s if it feels nothing of their ends, and the angle of the world."""
    rng = np.random.default_rng(seed)
    width, height, speed, mu = rng.uniform(0.2, 0.4), rng.uniform(0.05, 0.2), rng.uniform(1.5, 3.0), (seed % 2) * 0.05
    turned, x, tables = (0.0, *rng.uniform(-3.0, 3.0, 2))[seed], -1.0, {}
    for i in range(3):
        end = x + (rng.uniform(0.5, 0.8) if i < 2 else 5.0)
        tables[f"table {i}"] = rectangle(x, end, -0.3, -i * down)
        x = end + rng.uniform(0.05, 0.4) * width
    duration = min(1.0, speed / (mu * G)) if mu else 1.0
    expected = -1.0 + 0.6 * width + speed * duration - 0.5 * mu * G * duration**2
    return *box_over(tables, width, height, speed, mu, turned), expected, turned


@pytest.mark.parametrize(("seed", "down"), [(0, 0.0), (1, 0.0), (0, 1e-6), (2, 1e-4), (1, 1e-3)])
def test_a_box_passes_by_the_ends_of_tables(seed, down):
    """Of level tables it feels nothing; lower ones it falls onto, by so little that it is not held up. Corners of the
    tables struck its front, and its corners their ends, wherever round-off had it (status 0, 0.1 to 2 m off)."""
    scene, state, expected, turned = over_tables(seed, down)
    run = pc.simulate(scene, state, 1.0, max_steps=2000)
    assert run.status == 0, run.message
    # what is beyond the tables that it has left is behind their far faces, and that is right
    assert "behind" not in run.message
    # heights that it falls through make it a little faster, and turn it
    assert abs(along(run, turned) - expected) <= (0.05 if down == 1e-3 else 100.0 * down + 1e-6)


@pytest.mark.parametrize(("seed", "down"), [(0, 0.0), (1, 0.0), (2, 1e-6)])
def test_a_box_passes_by_the_ends_of_tables_in_steps(seed, down):
    """As above, by time stepping: 0.3 to 2.3 m off, with status 0."""
    scene, state, expected, turned = over_tables(seed, down)
    run = pc.simulate(scene, state, 1.0, method="Moreau", dt=1e-3)
    assert run.status == 0 and "behind" not in run.message, run.message
    # a step of sliding with another load than that of the motion, at each end
    assert abs(along(run, turned) - expected) <= 100.0 * down + 1e-6


@pytest.mark.parametrize("method", [{}, {"method": "Moreau", "dt": 1e-3}, {"method": "Moreau", "dt": 3e-4}])
@pytest.mark.parametrize("turned", [0.0, 0.7, -2.0])
def test_a_box_runs_into_a_wall(turned, method):
    """The wall's face ends at the floor, as faces of one body do at a corner, but this one is concave. In steps corners
    that strike at once do so in one step, also where that is at its end (the box turned over, with status 0)."""
    tables = {"floor": rectangle(-1.0, 1.0, -0.3, 0.0), "wall": rectangle(0.0, 0.3, 0.0, 0.5)}
    scene, state = box_over(tables, 0.3, 0.2, 2.0, 0.0, turned)
    run = pc.simulate(scene, state, 1.0, **method)
    assert run.status == 0, run.message
    assert along(run, turned) == pytest.approx(-0.15, abs=1e-6)
    assert np.abs(run.v[-1]).max() <= 1e-9


def on_edge(turned: float, a: float, b: float, speed: float, start: float, mu: float):
    """An ellipse that rolls along a line to its end, a corner with a contact of its own."""
    scene = pc.Scene(body(0.5 * a * b, turned))
    scene.add_contour("ellipse", pc.Ellipse(a, b), "body")
    scene.add_contour(
        "line", pc.Line((0.0, 1.0)), placement=pin.SE3(pin.utils.rotate("z", turned + math.pi), np.zeros(3))
    )
    scene.add_contour("corner", pc.Point())
    scene.add_contact("on the line", "ellipse", "line", pc.Coulomb(mu), side=1)
    scene.add_contact("on the corner", "ellipse", "corner", pc.Coulomb(mu))
    q, v = state_of(np.array([start, b]), -speed * b, turned)
    return scene, scene.initial_state(q, [*v[:2], speed], free=["on the corner"])


# rotations in which the corner closed a little before the line ended: alone, and with the line again
ROLLING = [
    (0.1416689856756877, 0.13668009209838697, -10.987562393471375, -0.4234433504099472, 0.3549882847948633),
    (0.07661302722922926, 0.062070680951449145, -11.379155843830395, -0.11620428447537386, 1.1784074347878728),
]


@pytest.mark.parametrize("shape", ROLLING)
def test_an_ellipse_rolls_over_a_corner(shape):
    """As in any other rotation of the world: where the corner closed a little before the line ended, the body stood on
    both, and all of its energy was gone."""
    ends, energies = [], []
    for turned in (0.0, 0.004348763931889987, 0.3, 0.5, 0.7, 1.0, 2.0, 2.600623799333942):
        scene, state = on_edge(turned, *shape)
        run = pc.simulate(scene, state, 0.8, max_steps=1500, energies=True)
        assert run.status == 0, run.message
        ends.append(rotation(turned).T @ run.q[-1, :2])
        energies.append(run.energies().total[-1])
    # errors of the tolerances, of which slip over the corner makes some hundred times more
    np.testing.assert_allclose(ends, np.tile(ends[0], (len(ends), 1)), atol=1e-5)
    np.testing.assert_allclose(energies, energies[0], atol=1e-5)


@pytest.mark.parametrize("side", [None, 1])
def test_an_ellipse_that_starts_beside_an_end_meets_the_line(side):
    """It is thrown up at a line from below, near its end. Its far side is over the line, its near one not yet: that was
    taken, and it flew through."""
    a, b, angle = 0.0659, 0.0604, -2.3568
    scene = pc.Scene(body(0.5 * a * b, 0.0))
    scene.add_contour("ellipse", pc.Ellipse(a, b), "body")
    scene.add_contour("line", pc.Line((0.0, 1.0)))
    scene.add_contact("line", "ellipse", "line", side=side)
    for x in (0.0, 1.0):
        scene.add_contour(f"end {x}", pc.Point(), placement=pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])))
        scene.add_contact(f"end {x}", "ellipse", f"end {x}")
    v = rotation(angle).T @ [-2.69, 3.40]
    state = scene.initial_state(
        [0.9954, -0.3234, math.cos(angle), math.sin(angle)], [*v, 7.69], free=list(scene.contacts)
    )
    run = pc.simulate(scene, state, 0.6, t_eval=np.linspace(0.0, 0.6, 61))
    assert run.status == 0, run.message
    ends = np.linspace(0.0, 1.0, 800)
    for x, y, c, s in run.q:
        points = np.column_stack((ends - x, np.zeros(ends.size) - y)) @ [[c, -s], [s, c]]
        assert np.hypot(points[:, 0] / a, points[:, 1] / b).min() >= 1.0 - 1e-6


def turned_world(seed: int, rng: np.random.Generator) -> pin.SE3:
    if seed == 0:
        return pin.SE3.Identity()
    return pin.SE3(pin.Quaternion(*rng.normal(size=4)).normalized().matrix(), rng.normal(size=3))


def box_model(sizes: np.ndarray) -> pin.Model:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    inertia = np.diag((sizes @ sizes - sizes**2) / 12.0)
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), inertia), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    return model


def flush(seed: int, height: float, speed: float):
    """A box over a fixed one of the same size, corner above corner, in a turned world: scene, q, v, that world."""
    sizes, rng = np.array([0.1, 0.08, 0.06]), np.random.default_rng(seed)
    world, model = turned_world(seed, rng), box_model(sizes)
    model.gravity.linear = world.rotation @ [0, 0, -G]
    scene = pc.Scene(model)
    face = pc.Plane(tuple((-0.5 * size, 0.5 * size) for size in sizes[:2]))
    scene.add_contour("top", face, placement=world)
    below = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0, 0, -0.5 * sizes[2]]))
    scene.add_contour("bottom", face, "body", placement=below)
    for x in (-0.05, 0.05):
        for y in (-0.04, 0.04):
            for name, other, where in (
                (f"own {x} {y}", "top", {"frame": "body", "placement": pin.SE3(np.eye(3), np.array([x, y, -0.03]))}),
                (f"other {x} {y}", "bottom", {"placement": world * pin.SE3(np.eye(3), np.array([x, y, 0.0]))}),
            ):
                scene.add_contact(name, scene.add_contour(name, pc.Point(), **where), other, friction=pc.Coulomb(0.5))
    q = pin.SE3ToXYZQUAT(world * pin.SE3(np.eye(3), np.array([0, 0, 0.03 + height])))
    return scene, q, [speed, 0, 0, 0, 0, 0], world


@pytest.mark.parametrize("method", [{}, {"method": "Moreau", "dt": 1e-3}], ids=["DOP853", "Moreau"])
@pytest.mark.parametrize("seed", [0, 1, 2, 3])
@pytest.mark.parametrize("height, speed", [(0.01, 0.0), (0.0, 0.0), (0.0, 0.3)], ids=["falls", "rests", "slides"])
def test_boxes_of_one_size_stand_on_each_other(height, speed, seed, method):
    """Their corners are at the ends of the other one's face: round-off decided whether they are on it. It fell through
    with status 0, or did not start."""
    scene, q, v, world = flush(seed, height, speed)
    state = scene.initial_state(q, v, free=list(scene.contacts) if height else [])
    run = pc.simulate(scene, state, 0.3, **method)
    assert run.status == 0, run.message
    pose = world.actInv(pin.XYZQUATToSE3(run.q[-1]))
    # v^2 / (2 mu g), to the errors of the tolerances, of an impact, or of the step in which it stops
    expected = [speed**2 / (2 * 0.5 * G), 0.0, 0.03]
    np.testing.assert_allclose(pose.translation, expected, atol=1e-6)
    np.testing.assert_allclose(pose.rotation, np.eye(3), atol=1e-6)


@pytest.mark.parametrize("method", [{}, {"method": "Moreau", "dt": 1e-3}], ids=["DOP853", "Moreau"])
@pytest.mark.parametrize("seed", range(4))
def test_a_box_slides_along_a_box_that_stands_on_the_ground(seed, method):
    """Of that box the lower face, in the plane of the ground, is declared, too: what comes in under it where the bodies
    strike waits for the strike. It was wedged between that and the ground, with status 0, and much too slow then."""
    rng, mu = np.random.default_rng(seed), 0.2
    sizes, speed = rng.uniform(0.08, 0.12, 3), np.array([rng.uniform(1.0, 1.5), rng.uniform(0.5, 1.0)])
    world, model = turned_world(seed, rng), box_model(sizes)
    model.gravity.linear = world.rotation @ [0, 0, -G]
    scene, start = pc.Scene(model), -0.05
    wall = pin.SE3(np.eye(3), np.array([0.0, 0.5 * sizes[1], 0.0]))
    up, down, across = np.eye(3), np.diag([1.0, -1.0, -1.0]), pin.utils.rotate("x", 0.5 * math.pi)
    # x and y of a contour, from its own origin; z is its outside
    scene.add_contour("ground", pc.Plane(), placement=world)
    scene.add_contour(
        "face", pc.Plane(((-2.0, 2.0), (0.0, 0.3))), placement=world * wall * pin.SE3(across, np.zeros(3))
    )
    scene.add_contour(
        "lower", pc.Plane(((-2.0, 2.0), (-0.3, 0.0))), placement=world * wall * pin.SE3(down, np.zeros(3))
    )
    signs = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
    for i, place in enumerate(signs):
        scene.add_contour(f"corner {i}", pc.Point(), "body", placement=pin.SE3(up, sizes * place))
        for other in ("ground", "face", "lower"):
            scene.add_contact(f"{i} on {other}", f"corner {i}", other, friction=pc.Coulomb(mu))
    # edges tell how the body goes on from its corners: upwards
    scene.add_contour("foot", pc.Line((-2.0, 2.0)), placement=world * wall)
    upright, half = pin.utils.rotate("y", -0.5 * math.pi), 0.5 * sizes[2]
    for x in (-0.5, 0.5):
        edge = pin.SE3(upright, sizes * [x, 0.5, 0.0])
        scene.add_contour(f"edge {x}", pc.Line((-half, half)), "body", placement=edge)
        scene.add_contact(f"edge {x} on foot", f"edge {x}", "foot", friction=pc.Coulomb(mu))
    q = pin.SE3ToXYZQUAT(world * pin.SE3(np.eye(3), np.array([0.0, start, half])))
    stands = [f"{i} on ground" for i, place in enumerate(signs) if place[2] < 0.0]
    state = scene.initial_state(q, [*speed, 0.0, 0.0, 0.0, 0.0], free=[c for c in scene.contacts if c not in stands])
    run = pc.simulate(scene, state, 1.0, **method)
    assert run.status == 0, run.message
    # straight to the wall, which takes what goes into it and friction's part of that, and along it to rest
    slowing, fast = mu * G, float(np.hypot(*speed))
    unit = speed / fast
    struck = math.sqrt(fast**2 - 2.0 * slowing * -start / unit[1])
    along = struck * (unit[0] - mu * unit[1])
    pose = world.actInv(pin.XYZQUATToSE3(run.q[-1]))
    expected = [-start * unit[0] / unit[1] + along**2 / (2.0 * slowing), 0.0, half]
    # to the errors of the impact, or of the step in which it strikes: friction acts half of that with a wrong speed
    np.testing.assert_allclose(pose.translation, expected, atol=3e-4 if method else 1e-6)
    np.testing.assert_allclose(pose.rotation, np.eye(3), atol=1e-6)
