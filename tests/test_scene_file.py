"""Scene files: what they build is what the same calls in Python build, and every mistake is named with its key."""

import inspect
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shared import kinds_of

import pincontact as pc
from pincontact.expressions import FUNCTIONS, compiled, evaluate

ROOT = Path(__file__).parent.parent
URDF, SCENES = ROOT / "urdf", sorted((ROOT / "examples" / "scenes").glob("*.toml"))

MINIMAL = f"""
urdf = '{URDF / "ball.urdf"}'
floating_base = true

[contours.ball]
kind = "Sphere"
radius = 0.1
frame = "ball"

[contours.floor]
kind = "Plane"

[contacts.touch]
between = ["ball", "floor"]
friction = 0.4

[initial]
q = [0, 0, 0.1, 0, 0, 0, 1]
v = [0.5, 0, 0, 0, 0, 0]

[simulation]
duration = 0.5
"""


def write(tmp_path, text, name="scene.toml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def load(tmp_path, text):
    return pc.load_scene(write(tmp_path, text))


def contour(tmp_path, body, constants=""):
    """The contour that a table describes."""
    text = f"urdf = '{URDF / 'ball.urdf'}'\n[constants]\n{constants}\n[contours.c]\n{body}"
    return load(tmp_path, text).scene.contours["c"]


# ---------------------------------------------------------------------------------------------------- whole files


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_scenes_of_the_repository_run(path):
    """Every one starts within what is corrected and keeps its constraints; a short run, and its outputs."""
    loaded = pc.load_scene(path)
    run = loaded.simulate(duration=0.2)
    assert run.success and run.t[-1] == pytest.approx(0.2, abs=1e-15)
    assert run.t.size == loaded.outputs
    # closed to rounding in units of the contour's size
    assert max(residual.max() for residual in run.residuals().values()) < 1e-12


def test_there_are_scenes():
    assert len(SCENES) >= 7


def test_file_builds_what_python_builds(tmp_path):
    """Bit for bit the same run."""
    loaded = load(tmp_path, MINIMAL + "rtol = 1e-7\natol = 1e-9\noutputs = 26\nmethod = 'RK45'\n")
    scene = pc.Scene.from_urdf(URDF / "ball.urdf", floating_base=True)
    scene.add_contour("ball", pc.Sphere(0.1), "ball")
    scene.add_contour("floor", pc.Plane())
    scene.add_contact("touch", "ball", "floor", friction=pc.Coulomb(0.4))
    state = scene.initial_state(np.array([0, 0, 0.1, 0, 0, 0, 1]), np.array([0.5, 0, 0, 0, 0, 0]))
    times = np.linspace(0.0, 0.5, 26)
    expected = pc.simulate(scene, state, 0.5, rtol=1e-7, atol=1e-9, t_eval=times, method="RK45")
    run = loaded.simulate()
    np.testing.assert_array_equal(run.t, times)
    np.testing.assert_array_equal(run.q, expected.q)
    np.testing.assert_array_equal(run.v, expected.v)
    assert [e.kind for e in run.events] == [e.kind for e in expected.events] == ["stick"]


def test_ball_on_turntable_runs_in_circles():
    """Ball of moment 2/5: its centre goes round at 2/7 of the table's rate; seven turns of the table close it."""
    loaded = pc.load_scene(ROOT / "examples" / "scenes" / "ball_on_turntable.toml")
    run = loaded.simulate(rtol=1e-11, atol=1e-13)
    velocity = np.array([pin.Quaternion(*q[[6, 3, 4, 5]]).matrix() @ v[:3] for q, v in zip(run.q, run.v)])
    turn = 3.0 * 2.0 / 7.0 * run.t
    v0 = velocity[0]
    expected = np.column_stack(
        [v0[0] * np.cos(turn) - v0[1] * np.sin(turn), v0[0] * np.sin(turn) + v0[1] * np.cos(turn)]
    )
    np.testing.assert_allclose(velocity[:, :2], expected, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(run.q[-1, :2], run.q[0, :2], rtol=0.0, atol=1e-9)


def test_rattleback_turns_back():
    """The sign of the product of inertia decides which spin is the stable one."""
    loaded = pc.load_scene(ROOT / "examples" / "scenes" / "rattleback.toml")
    assert loaded.state.correction.dv < 0.05
    run = loaded.simulate(duration=5.0, rtol=1e-8, atol=1e-10)
    assert run.v[0, 5] < -4.9 and run.v[-1, 5] > 2.0
    stable = loaded.scene.initial_state(loaded.state.q, -loaded.state.v)
    other = pc.simulate(loaded.scene, stable, 5.0, rtol=1e-8, atol=1e-10)
    # it wobbles while it spins on, but never comes near a stop
    assert other.v[:, 5].min() > 4.0


def test_every_option_of_simulate_can_be_written(tmp_path):
    given = {
        "duration": 0.5,
        "rtol": 1e-7,
        "atol": 1e-9,
        "method": "RK45",
        "energies": True,
        "max_step": math.inf,
        "first_step": 1e-3,
        "fixed_step": 1e-2,
        "dt": 2e-3,
        "max_steps": 500,
        "breakpoints": [0.1, 0.2],
        "fallback": "Moreau",
        "contact_solver": "proxqp",
        "dense_output": False,
    }
    others = {"scene", "state", "t_eval", "control", "events", "progress", "step"}
    assert set(given) == set(inspect.signature(pc.simulate).parameters) - others
    lines = "\n".join(
        f"{key} = {str(value).lower() if value in (True, False) else repr(value)}" for key, value in given.items()
    )
    assert load(tmp_path, MINIMAL.replace("duration = 0.5", lines)).settings == given
    assert load(tmp_path, MINIMAL + "step = 2e-3").settings == {"duration": 0.5, "dt": 2e-3}


def test_yaml_is_the_same(tmp_path):
    pytest.importorskip("yaml")
    text = f"""
urdf: {URDF / "ball.urdf"}
floating_base: true
contours:
  ball: {{kind: Sphere, radius: 0.1, frame: ball}}
  floor: {{kind: Plane}}
contacts:
  touch: {{between: [ball, floor], friction: 0.4}}
initial:
  q: [0, 0, 0.1, 0, 0, 0, 1]
  v: [0.5, 0, 0, 0, 0, 0]
simulation:
  duration: 0.5
  rtol: 1e-7
"""
    loaded = pc.load_scene(write(tmp_path, text, "scene.yaml"))
    assert loaded.settings == {"duration": 0.5, "rtol": 1e-7}
    other = load(tmp_path, MINIMAL + "rtol = 1e-7")
    np.testing.assert_array_equal(loaded.simulate().q[-1], other.simulate().q[-1])


def test_yaml_without_its_package(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "yaml", None)
    with pytest.raises(pc.MissingExtraError, match="PyYAML"):
        pc.load_scene(write(tmp_path, "urdf: x", "scene.yml"))


def test_paths_are_relative_to_the_file(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    (tmp_path / "ball.urdf").write_text((URDF / "ball.urdf").read_text())
    path = write(tmp_path / "here", MINIMAL.replace(str(URDF / "ball.urdf"), "../ball.urdf"))
    monkeypatch.chdir("/")
    assert pc.load_scene(path).scene.model.nv == 6


def test_gravity_and_collision(tmp_path):
    text = MINIMAL.replace("floating_base = true", "floating_base = true\ngravity = [0, 0, -1.62]\ncollision = {}")
    loaded = load(tmp_path, text)
    np.testing.assert_array_equal(loaded.scene.model.gravity.linear, [0.0, 0.0, -1.62])
    assert "ball_0_sphere" in loaded.scene.contours


# ---------------------------------------------------------------------------------------------------- parts

CONTOURS = [
    ("kind = 'Point'", lambda: pc.Point()),
    ("kind = 'Line'\ndomain = [-1, 2]", lambda: pc.Line((-1.0, 2.0))),
    ("kind = 'Circle'\nradius = 0.3", lambda: pc.Circle(0.3)),
    ("kind = 'Circle'\nradius = 0.3\ndomain = [0, 'pi']", lambda: pc.Circle(0.3, (0.0, math.pi))),
    ("kind = 'Ellipse'\na = 0.3\nb = 0.2", lambda: pc.Ellipse(0.3, 0.2)),
    ("kind = 'Helix'\nradius = 0.3\npitch = -0.1", lambda: pc.Helix(0.3, -0.1)),
    ("kind = 'Cycloid'\nradius = 0.3", lambda: pc.Cycloid(0.3)),
    (
        "kind = 'FourierCurve'\ncosine = [[0, 0], [1, 0]]\nsine = [[0, 0], [0, 0.5]]",
        lambda: pc.FourierCurve([[0, 0], [1, 0]], [[0, 0], [0, 0.5]]),
    ),
    (
        "kind = 'SplineCurve'\npoints = [[0, 0], [1, 0], [2, 1], [3, 1], [4, 0], [5, 0], [6, 1]]\ndegree = 4",
        lambda: pc.SplineCurve([[0, 0], [1, 0], [2, 1], [3, 1], [4, 0], [5, 0], [6, 1]], degree=4),
    ),
    (
        "kind = 'ParametricCurve'\nf = ['u', 'R * sin(u)**2', 0.5]\ndomain = [-1, 1]",
        lambda: pc.ParametricCurve(lambda u: (u, 0.3 * math.sin(u) ** 2, 0.5), (-1.0, 1.0)),
    ),
    (
        "kind = 'ParametricCurve'\nf = ['u', 'sin(u - 2 * t)', '0']\ndomain = [-inf, inf]",
        lambda: pc.ParametricCurve(lambda u, t: (u, math.sin(u - 2 * t), 0.0), (-math.inf, math.inf)),
    ),
    ("kind = 'Plane'\ndomain = [[-1, 1], [-inf, inf]]", lambda: pc.Plane(((-1.0, 1.0), None))),
    ("kind = 'Sphere'\nradius = 'R'", lambda: pc.Sphere(0.3)),
    ("kind = 'Ellipsoid'\na = 0.3\nb = 0.2\nc = 0.1", lambda: pc.Ellipsoid(0.3, 0.2, 0.1)),
    ("kind = 'Cylinder'\nradius = 0.3\ndomain = [['-pi', 'pi'], [0, 1]]", lambda: pc.Cylinder(0.3, (None, (0.0, 1.0)))),
    ("kind = 'Cone'\nhalf_angle = 'radians(30)'", lambda: pc.Cone(math.radians(30))),
    ("kind = 'Torus'\nmajor = 0.3\nminor = 0.1", lambda: pc.Torus(0.3, 0.1)),
    (
        "kind = 'SurfaceOfRevolution'\nprofile = ['R + 0.1 * s**2', 's']\ndomain = [-1, 1]",
        lambda: pc.SurfaceOfRevolution(lambda s: (0.3 + 0.1 * s**2, s), (-1.0, 1.0)),
    ),
    (
        "kind = 'SurfaceOfRevolution'\nprofile = [[1, 0], [1.1, 1], [1, 2], [0.9, 3], [1, 4], [1, 5], [1, 6]]",
        lambda: pc.SurfaceOfRevolution([[1, 0], [1.1, 1], [1, 2], [0.9, 3], [1, 4], [1, 5], [1, 6]]),
    ),
    (
        "kind = 'HeightField'\nf = '0.1 * x * y + 0.2 * x**2'",
        lambda: pc.HeightField(lambda x, y: 0.1 * x * y + 0.2 * x**2),
    ),
    (
        "kind = 'HeightField'\nf = 'x + abs(t - 5)'\ntime_domain = [0, 4]",
        lambda: pc.HeightField(lambda x, y, t: x + abs(t - 5), time_domain=(0.0, 4.0)),
    ),
    (
        "kind = 'HeightField'\nf = 'sin(x - t)'\ndomain = [[-1, 1], [-1, 1]]",
        lambda: pc.HeightField(lambda x, y, t: math.sin(x - t), domain=((-1.0, 1.0), (-1.0, 1.0))),
    ),
    (
        "kind = 'HeightField'\ndegree = 4\nx = [0, 1, 2, 3, 4]\ny = [0, 1, 2, 3, 4]\n"
        "z = [[0, 0, 0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 0]]",
        lambda: pc.HeightField(range(5), range(5), np.eye(25)[12].reshape(5, 5), degree=4),
    ),
    (
        "kind = 'ParametricSurface'\nf = ['u1 + 0.5 * u2', 'u2', 'exp(-u1**2)']\ndomain = [[-2, 2], [-2, 2]]",
        lambda: pc.ParametricSurface(lambda u, v: (u + 0.5 * v, v, math.exp(-(u**2))), ((-2.0, 2.0), (-2.0, 2.0))),
    ),
]


@pytest.mark.parametrize(("body", "make"), CONTOURS, ids=[body.split("'")[1] for body, _ in CONTOURS])
def test_contour_kinds(tmp_path, body, make):
    found, expected = contour(tmp_path, body, "R = 0.3").contour, make()
    assert type(found) is type(expected)
    assert (found.domain, found.periodic, found.time_dependent) == (
        expected.domain,
        expected.periodic,
        expected.time_dependent,
    )
    window = [(-0.9, 0.9)] * expected.dimension
    for u in expected.samples(5, window if not np.isfinite(expected.domain).all() else None):
        np.testing.assert_array_equal(found.evaluate(u, 0.3), expected.evaluate(u, 0.3))


def test_every_kind_of_contour_can_be_written():
    missing = kinds_of(pc.Contour) - {make().name for _, make in CONTOURS} - {"SplineSurface"}
    assert not missing, f"CONTOURS lacks {missing}"


def test_spline_surface(tmp_path):
    x, y = np.meshgrid(np.arange(6.0), np.arange(7.0), indexing="ij")
    points = np.stack([x, y, 0.1 * x * y], axis=-1)
    found = contour(tmp_path, f"kind = 'SplineSurface'\npoints = {points.tolist()}\nperiodic = [false, false]").contour
    np.testing.assert_array_equal(found.pool, pc.SplineSurface(points).pool)


def test_placements(tmp_path):
    turned = contour(tmp_path, "kind = 'Plane'\nxyz = [1, 2, 3]\nrpy = [0.1, '-pi / 2', 0.3]").placement
    np.testing.assert_array_equal(turned.translation, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(turned.rotation, pin.rpy.rpyToMatrix(0.1, -0.5 * math.pi, 0.3), atol=1e-15)
    q = np.array([0.1, 0.2, 0.3, 0.9])
    q /= np.linalg.norm(q)
    by_quaternion = contour(tmp_path, f"kind = 'Plane'\nquaternion = {np.round(q, 5).tolist()}").placement
    # five digits are written; the rotation is exact all the same
    np.testing.assert_allclose(by_quaternion.rotation, pin.Quaternion(q[3], *q[:3]).matrix(), atol=1e-5)
    np.testing.assert_allclose(by_quaternion.rotation @ by_quaternion.rotation.T, np.eye(3), atol=1e-15)


MOTIONS = [
    (
        "{kind = 'ConstantTwist', angular = [0, 0, 'R'], linear = [1, 0, 0], center = [0, 1, 0]}",
        lambda: pc.ConstantTwist((0, 0, 0.3), (1, 0, 0), (0, 1, 0)),
    ),
    (
        "{kind = 'HarmonicMotion', amplitude = [0, 0, 0.1], frequency = 2, axis = [0, 1, 0], angle = 0.2, phase = 0.1}",
        lambda: pc.HarmonicMotion((0, 0, 0.1), 2.0, 0.1, (0, 1, 0), 0.2),
    ),
    (
        "{kind = 'SplineMotion', times = [0, 1, 2, 3, 4, 5], poses = ["
        + ", ".join(f"{{xyz = [{0.1 * i * i}, 0, 0], rpy = [0, 0, {0.2 * i}]}}" for i in range(6))
        + "]}",
        lambda: pc.SplineMotion(
            range(6), [pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.2 * i), np.array([0.1 * i * i, 0, 0])) for i in range(6)]
        ),
    ),
    (
        "{kind = 'CallableMotion', xyz = ['0.1 * sin(t)', 0, 't**2'], rpy = [0, 0, '0.5 * t'], time_domain = [0, 2]}",
        lambda: pc.CallableMotion(
            lambda t: pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.5 * t), np.array([0.1 * math.sin(t), 0.0, t**2])), (0, 2)
        ),
    ),
]


@pytest.mark.parametrize(("text", "make"), MOTIONS, ids=[text.split("'")[1] for text, _ in MOTIONS])
def test_motions(tmp_path, text, make):
    motion = contour(tmp_path, f"kind = 'Plane'\nmotion = {text}", "R = 0.3").motion
    for t in (0.0, 0.7, 1.9):
        np.testing.assert_allclose(motion.evaluate(t), make().evaluate(t), rtol=0.0, atol=1e-13)


@pytest.mark.parametrize(
    ("text", "law"),
    [
        ("'none'", None),
        ("'no slip'", pc.NoSlip()),
        ("'NoSlip'", pc.NoSlip()),
        ("0.5", pc.Coulomb(0.5)),
        ("'1 / 3'", pc.Coulomb(1.0 / 3.0)),
        ("{ mu = 0.5 }", pc.Coulomb(0.5)),
        ("{ mu = 0.5, mu_static = 0.6 }", pc.Coulomb(0.5, 0.6)),
        ("{ mu = 0, viscous = '2 * 3' }", pc.Coulomb(0.0, viscous=6.0)),
        ("{ mu = [0.1, 0.2], along = 'floor', rolling = 1e-3 }", pc.Coulomb((0.1, 0.2), along="floor", rolling=1e-3)),
        ("{ mu = 0.1, mu_static = 0.2, speed = 0.01 }", pc.Stribeck(0.1, 0.2, 0.01)),
        ("{ mu = 0.1, mu_static = 0.2, speed = 0.01, exponent = 1 }", pc.Stribeck(0.1, 0.2, 0.01, 1.0)),
        ("{ mu = 'no slip', spinning = 0.01 }", pc.NoSlip(spinning=0.01)),
    ],
)
def test_friction_laws(tmp_path, text, law):
    scene = load(tmp_path, MINIMAL.replace("friction = 0.4", f"friction = {text}")).scene
    assert scene.contacts["touch"].friction == law


def test_contact_options(tmp_path):
    text = MINIMAL.replace(
        "friction = 0.4", "bilateral = true\nrestitution = 0.5\nside = 1\npattern = 'S-S'\nlocation = [[], [0.1, 0.2]]"
    )
    contact = load(tmp_path, text).scene.contacts["touch"]
    assert (contact.bilateral, contact.restitution, contact.side, contact.pattern.name) == (True, 0.5, 1, "S-S")
    assert contact.location == (None, [0.1, 0.2])


def test_coordinates_by_joint(tmp_path):
    """An angle for a continuous joint, a placement for a free one, neutral where nothing is said."""
    initial = "[initial]\nt = 0.5\nq = { shaft = 'pi / 3' }\nv = { guide = [0.2] }"
    loaded = load(tmp_path, f"urdf = '{URDF / 'cam_follower.urdf'}'\n{initial}")
    state, model = loaded.state, loaded.scene.model
    shaft, guide = (model.joints[model.getJointId(name)] for name in ("shaft", "guide"))
    np.testing.assert_allclose(state.q[shaft.idx_q : shaft.idx_q + 2], [0.5, math.sqrt(0.75)], atol=1e-15)
    assert (state.q[guide.idx_q], state.v[shaft.idx_v], state.v[guide.idx_v]) == (0.0, 0.0, 0.2)
    assert state.t == 0.5
    text = (
        f"urdf = '{URDF / 'ball.urdf'}'\nfloating_base = true\n[initial.q]\n"
        "root_joint = { xyz = [1, 2, 3], rpy = [0, 0, 'pi / 2'] }"
    )
    half = math.sqrt(0.5)
    np.testing.assert_allclose(load(tmp_path, text).state.q, [1, 2, 3, 0, 0, half, half], atol=1e-15)


def test_outputs_follow_the_duration(tmp_path):
    loaded = load(tmp_path, MINIMAL + "outputs = 6")
    np.testing.assert_allclose(loaded.options()["t_eval"], np.linspace(0.0, 0.5, 6))
    np.testing.assert_allclose(loaded.options(duration=1.0)["t_eval"], np.linspace(0.0, 1.0, 6))
    assert loaded.options(t_eval=[0.1])["t_eval"] == [0.1]
    listed = load(tmp_path, MINIMAL + "outputs = [0, 0.2, 0.5]")
    assert listed.options()["t_eval"] == [0.0, 0.2, 0.5]
    assert listed.options(duration=0.3)["t_eval"] == [0.0, 0.2]
    assert "t_eval" not in load(tmp_path, MINIMAL).options()
    with pytest.raises(pc.ArgumentError, match="duration"):
        load(tmp_path, MINIMAL.replace("duration = 0.5", "")).options()


# ---------------------------------------------------------------------------------------------------- mistakes


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("floating_base", "floating_bas", r"floating_bas: unknown key; did you mean floating_base"),
        ("radius = 0.1", "radios = 0.1", r"contours\.ball\.radios: unknown key; did you mean radius"),
        ("radius = 0.1", "", r"contours\.ball\.radius: is missing"),
        ("radius = 0.1", "radius = -0.1", r"contours\.ball: Sphere: radius must be positive.*-0\.1"),
        ("radius = 0.1", "radius = true", r"contours\.ball\.radius: expected a number.*got True"),
        ("radius = 0.1", "radius = '0.1 +'", r"contours\.ball\.radius: '0\.1 \+' is not a formula"),
        ("radius = 0.1", "radius = nan", r"contours\.ball\.radius: expected a number.*got nan"),
        ("radius = 0.1", "radius = inf", r"contours\.ball\.radius: expected a number .finite.*got inf"),
        ("radius = 0.1", f"radius = 1{'0' * 400}", r"contours\.ball\.radius: expected a number"),
        ("duration = 0.5", "duration = inf", r"simulation\.duration: expected a number .finite"),
        ("radius = 0.1", "radius = 'R'", r"contours\.ball\.radius: 'R': unknown name 'R'"),
        ('"Sphere"', '"sphere"', r"contours\.ball\.kind: .*did you mean Sphere"),
        ('"Sphere"', '"Dodecahedron"', r"contours\.ball\.kind: there is no 'Dodecahedron'; expected one of .*Circle, "),
        ('frame = "ball"', 'frame = "bal"', r"contours\.ball: .*no frame 'bal'; did you mean ball"),
        ('frame = "ball"', "xyz = [0, 0]", r"contours\.ball\.xyz: expected 3 numbers, got \[0, 0\]"),
        ('frame = "ball"', "rpy = [0, 0, 0]\nquaternion = [0, 0, 0, 1]", r"contours\.ball\.rpy: expected rpy or quat"),
        ('frame = "ball"', "quaternion = [0, 0, 0, 2]", r"contours\.ball\.quaternion: .*norm 1 instead of 2"),
        ('frame = "ball"', "motion = {kind = 'Constanttwist'}", r"contours\.ball\.motion\.kind: .*mean ConstantTwist"),
        ('frame = "ball"', "motion = {kind = 'HarmonicMotion', angle = 1}", r"contours\.ball\.motion: .*needs an axis"),
        ('["ball", "floor"]', '["ball", "flor"]', r"contacts\.touch\.between: .*'flor'; did you mean floor"),
        ('["ball", "floor"]', '["ball"]', r"contacts\.touch\.between: expected the names of two contours"),
        ("friction = 0.4", "friction = -0.4", r"contacts\.touch\.friction: Coulomb: mu .*-0\.4"),
        ("friction = 0.4", "friction = 'sticky'", r"contacts\.touch\.friction: expected \"none\""),
        ("friction = 0.4", "friction = {mu = 1, static = 2}", r"contacts\.touch\.friction: expected \"none\""),
        ("friction = 0.4", "friction = {mu = 1, speed = 2}", r"contacts\.touch\.friction: expected mu_static, too"),
        (
            "friction = 0.4",
            "friction = {mu = 1, exponent = 2}",
            r"contacts\.touch\.friction: expected mu_static and speed, too",
        ),
        ("friction = 0.4", "friction = {mu = [1, 2, 3]}", r"contacts\.touch\.friction: expected 2 numbers"),
        ("friction = 0.4", "friction = {mu = 'no slip', viscous = 1}", r"contacts\.touch\.friction: expected mu = .no"),
        (
            "friction = 0.4",
            "friction = {mu = [0.1, 0.2], along = 'x'}",
            r"contacts\.touch: .*along 'x', which is neither",
        ),
        ("friction = 0.4", "side = 2", r"contacts\.touch\.side: expected 1 or -1, got 2"),
        ("friction = 0.4", "restitution = 2", r"contacts\.touch: .*restitution.*2"),
        ("friction = 0.4", "location = [[1], []]", r"contacts\.touch: .*needs 2"),
        ("friction = 0.4", "pattern = '3C-S'", r"contacts\.touch: .*S-S, not 3C-S"),
        ("q = [0, 0, 0.1, 0, 0, 0, 1]", "q = [0, 0, 0.1]", r"initial\.q: expected 7 numbers"),
        ("q = [0, 0, 0.1, 0, 0, 0, 1]", "q = [0, 0, 0.1, 0, 0, 0, 2]", r"initial: .*norm 2"),
        ("q = [0, 0, 0.1, 0, 0, 0, 1]", "q = {root = 1}", r"initial\.q\.root: .*expected one of root_joint"),
        ("q = [0, 0, 0.1, 0, 0, 0, 1]", "q = {root_joint = [1, 2]}", r"initial\.q\.root_joint: expected 7 numbers"),
        ("q = [0, 0, 0.1, 0, 0, 0, 1]", "q = {root_joint = {xy = [1]}}", r"root_joint: expected a placement"),
        ("q = [0, 0, 0.1, 0, 0, 0, 1]", "free = ['touches']", r"initial: free: unknown contact 'touches'"),
        ("duration = 0.5", "outputs = 1", r"simulation\.outputs: expected a number of output times"),
        ("duration = 0.5", "duraton = 1", r"simulation\.duraton: unknown key; did you mean duration"),
        ("[simulation]", "[simulations]", r"simulations: unknown key; did you mean simulation"),
        ("[contours.floor]", "[contours.floor]\nf = 'x'\n", r"contours\.floor\.f: unknown key"),
        ("floating_base = true", "floating_base = true\ngravity = [0, 0, nan]", r"gravity: .*finite"),
        ("floating_base = true", "collision = { kinds = ['sides'] }", r"collision: .*'sides'"),
        ("floating_base = true", "constants = { t = 1 }", r"constants\.t: this name"),
        ("floating_base = true", "constants = 3", r"constants: expected a table, got 3"),
        ("ball.urdf", "none.urdf", r"urdf: URDF file not found.*none\.urdf"),
        ("urdf = ", "model = ", r"model: unknown key"),
        ("urdf = ", "# ", r"urdf: is missing"),
    ],
)
def test_mistakes_are_named(tmp_path, old, new, text):
    assert old in MINIMAL
    path = write(tmp_path, MINIMAL.replace(old, new, 1))
    with pytest.raises(pc.SceneFileError, match=text) as caught:
        pc.load_scene(path)
    message = str(caught.value)
    # the file is named once, at the start
    assert message.startswith(str(path)) and message.count(str(path)) == 1


def test_files_that_are_none(tmp_path):
    with pytest.raises(pc.SceneFileError, match="cannot be read"):
        pc.load_scene(tmp_path / "nowhere.toml")
    with pytest.raises(pc.SceneFileError, match=r"ends in \.toml"):
        pc.load_scene(write(tmp_path, "", "scene.json"))
    with pytest.raises(pc.SceneFileError, match=r"not valid TOML.*line 2"):
        pc.load_scene(write(tmp_path, "a = 1\nb = = 2"))
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(pc.SceneFileError, match="cannot be read"):
        pc.load_scene(tmp_path / "bytes.toml")
    pytest.importorskip("yaml")
    with pytest.raises(pc.SceneFileError, match="not valid YAML"):
        pc.load_scene(write(tmp_path, "a: [1", "scene.yaml"))
    with pytest.raises(pc.SceneFileError, match="expected tables"):
        pc.load_scene(write(tmp_path, "- 1", "scene.yaml"))
    with pytest.raises(pc.SceneFileError, match="not valid YAML"):
        pc.load_scene(write(tmp_path, "a: !!python/object/apply:os.getcwd []", "scene.yaml"))


YAML = f"""
urdf: {URDF / "ball.urdf"}
floating_base: true
contours:
  ball: {{kind: Sphere, radius: 0.1, frame: ball}}
  floor:
    kind: Plane
contacts:
  touch: {{between: [ball, floor], friction: {{mu: 0.4}}}}
initial:
  q: [0, 0, 0.1, 0, 0, 0, 1]
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "floating_base: true",
            "floating_base: true\nfloating_base: false",
            r"floating_base is given twice, first in line 3(.|\n)*line 4",
        ),
        ("kind: Plane", "kind: Plane\n    kind: Line", r"kind is given twice, first in line 7(.|\n)*line 8"),
        ("radius: 0.1", "radius: 0.1, radius: 0.2", r"radius is given twice, first in line 5(.|\n)*line 5"),
        ("mu: 0.4", "mu: 0.4, mu: 0.5", r"mu is given twice"),
        ("initial:", "contours: {}\ninitial:", r"contours is given twice, first in line 4(.|\n)*line 10"),
        ("  touch:", "  on:", r"a key must be a text; put it in quotes(.|\n)*line 9"),
        ("  touch:", "  1:", r"a key must be a text(.|\n)*line 9"),
        ("radius: 0.1", "radius: 0:30", "contours.ball.radius: '0:30' is not a formula"),
        ("radius: 0.1", "radius: .nan", "contours.ball.radius: expected a number.*got nan"),
        ("radius: 0.1", "radius: .inf", "contours.ball.radius: expected a number .finite.*got inf"),
        ("radius: 0.1", "radius: yes", "contours.ball.radius: expected a number.*got True"),
        ("frame: ball", "frame: no", "contours.ball.frame: expected a text, got False"),
        ("[0, 0, 0.1, 0, 0, 0, 1]", "&q [*q]", r"initial\.q: "),
    ],
)
def test_what_yaml_would_pass_over(tmp_path, old, new, message):
    pytest.importorskip("yaml")
    assert old in YAML
    path = write(tmp_path, YAML.replace(old, new, 1), "scene.yaml")
    with pytest.raises(pc.SceneFileError, match=message):
        pc.load_scene(path)


def test_numbers_of_yaml(tmp_path):
    """Exponents without a point, and zeros in front, are decimal numbers; mappings may still be merged."""
    pytest.importorskip("yaml")
    text = YAML.replace("radius: 0.1", "radius: 1e-1").replace("[0, 0, 0.1,", "[00, 0, 1E-1,")
    text = text.replace("kind: Plane", "<<: &plane {kind: Line}\n    kind: Plane\n  wall: *plane")
    scene = pc.load_scene(write(tmp_path, text, "scene.yaml")).scene
    assert scene.contours["ball"].contour.size == 0.1
    assert isinstance(scene.contours["wall"].contour, pc.Line)


def test_mappings_of_yaml_that_lead_back_to_themselves(tmp_path):
    pytest.importorskip("yaml")
    path = write(tmp_path, YAML.replace("kind: Plane", "&plane\n    frame: *plane"), "scene.yaml")
    with pytest.raises(pc.SceneFileError, match=r"contours\.floor"):
        pc.load_scene(path)


def test_the_real_part_of_a_quaternion_in_front(tmp_path):
    text = MINIMAL.replace("[contours.floor]", "[contours.floor]\nquaternion = [1, 0, 0, 0]")
    with pytest.warns(UserWarning, match=r"contours\.floor\.quaternion is \(1, 0, 0, 0\), half a turn") as caught:
        load(tmp_path, text)
    assert caught[0].filename == __file__


def test_collision_shapes_that_give_no_contour(tmp_path):
    with pytest.raises(pc.SceneFileError, match="collision: no contour was found among corners of: ball_0"):
        load(tmp_path, MINIMAL + "\n[collision]\nkinds = ['corners']")


def test_contours_that_do_not_touch_keep_their_gap(tmp_path):
    with pytest.raises(pc.NoContactError, match=r"0\.2 m") as caught:
        load(tmp_path, MINIMAL.replace("0, 0, 0.1, 0", "0, 0, 0.3, 0"))
    assert caught.value.gap == pytest.approx(0.2, abs=1e-14)


# ---------------------------------------------------------------------------------------------------- formulas


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2 * 3 + 4 / 8 - 1", 5.5),
        ("-2**2", -4.0),
        ("2**3**2", 512.0),
        ("1e-3", 1e-3),
        ("R * cos(pi)", -0.3),
        ("hypot(3, 4) + abs(-1)", 6.0),
        (" atan2(1, 1) * 4 - pi", 0.0),
        ("log(e) + sqrt(16)", 5.0),
    ],
)
def test_formulas_of_constants(text, value):
    assert evaluate(text, {"R": 0.3}) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').getcwd()",
        "().__class__.__bases__",
        "open('x')",
        "[x for x in (1,)]",
        "lambda: 1",
        "u if u else 1",
        "(u := 1)",
        "'text'",
        "f'{1}'",
        "True",
        "1j",
        "sin(*[1])",
        "sin(x=1)",
        "sin",
        "sin(u).real",
        "pi.real",
        "u[0]",
        "u < 1",
        "u and 1",
        "not u",
        "~1",
        "u // 2",
        "u % 2",
        "2^3",
        "await u",
        "",
        "u;u",
        "1\x00",
        "(" * 500,
        "-" * 4000 + "1",
        "1+" * 3000 + "1",
        "9" * 400,
    ],
)
def test_what_is_no_formula(text):
    with pytest.raises(pc.ArgumentError):
        compiled([text], ("u",))


@pytest.mark.parametrize("text", ["1 / 0", "sqrt(-1)", "(-8)**(1 / 3)", "9**9**9**9", "1e999", "sin(1, 2)", "log(0)"])
def test_formulas_without_a_value(text):
    with pytest.raises(pc.ArgumentError):
        evaluate(text)


def test_time_is_an_argument_only_where_it_occurs():
    assert compiled(["u", "2 * u"], ("u", "t"))(3.0) == (3.0, 6.0)
    assert compiled(["u", "2 * t"], ("u", "t"))(3.0, 4.0) == (3.0, 8.0)


_LEAVES = st.one_of(st.just("u"), st.just("v"), st.just("pi"), st.floats(0.1, 9.0).map(lambda x: f"{x:.6f}"))
_FORMULAS = st.recursive(
    _LEAVES,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+-*"), inner).map(lambda p: f"({p[0]} {p[1]} {p[2]})"),
        inner.map(lambda p: f"sin({p})"),
        inner.map(lambda p: f"(-{p})"),
        inner.map(lambda p: f"sqrt(1 + {p}**2)"),
    ),
    max_leaves=8,
)


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(text=_FORMULAS, u=st.floats(-2.0, 2.0), v=st.floats(-2.0, 2.0))
def test_formulas_mean_what_python_means(text, u, v):
    names = {"sin": math.sin, "sqrt": math.sqrt, "pi": math.pi, "u": u, "v": v}
    assert compiled([text], ("u", "v"))(u, v)[0] == eval(text, {"__builtins__": {}}, names)


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_every_function_can_be_traced(name):
    """No fit, no Python in a run: derivatives are exact. (radians and degrees are products.)"""
    arguments = (
        "1.5 + 0.1 * u, 2" if name in ("atan2", "hypot") else "1.5 + 0.1 * u" if name == "acosh" else "0.5 + 0.1 * u"
    )
    curve = pc.ParametricCurve(compiled(["u", f"{name}({arguments})", "0"], ("u", "t")), (-1.0, 1.0))
    assert curve.fit_error == 0.0
    h = 1e-5
    slope = (curve.point(0.2 + h) - curve.point(0.2 - h)) / (2.0 * h)
    # central differences: h^2 and rounding / h are 1e-10
    np.testing.assert_allclose(curve.evaluate(0.2)[1], slope, rtol=0.0, atol=1e-9)
