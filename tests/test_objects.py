"""Objects that show themselves, forces that know whose they are, files, names, and messages."""

import ast
import copy
import functools
import importlib
import inspect
import logging
import math
import pkgutil
import re
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from shared import kinds_of

import pincontact as pc
from pincontact import log
from pincontact.__main__ import main
from pincontact.contours.base import as_written
from pincontact.errors import sentence
from pincontact.progress import PlainBar
from pincontact.view.plots import plot

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "pincontact"


@functools.cache
def sources():
    """Syntax trees of the package's files."""
    files = [path for path in sorted(PACKAGE.rglob("*.py")) if "docs" not in path.parts]
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in files}


def sliding_ball(mu=0.2):
    scene = pc.Scene.from_urdf(ROOT / "urdf" / "ball.urdf", floating_base=True)
    ball, floor = scene.add_contour("ball", pc.Sphere(0.1), frame="ball"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("b/f", ball, floor, friction=pc.Coulomb(mu))
    return scene, scene.initial_state([0, 0, 0.1, 0, 0, 0, 1], [1.0, 0, 0, 0, 0, 0])


@pytest.fixture(scope="module")
def slide():
    return pc.simulate(*sliding_ball(), 0.2)


# ---------------------------------------------------------------------------------------------------- repr


def many_contacts():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.2), pin.SE3.Identity())
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    for i in range(40):
        place = pin.SE3(np.eye(3), np.array([0.1 * math.cos(i), 0.1 * math.sin(i), -0.1]))
        point = scene.add_contour(f"a point with a long name {i}", pc.Point(), "root", place)
        scene.add_contact(f"a contact with a long name {i}", point, floor, pc.Coulomb(0.5))
    return scene, scene.initial_state([0, 0, 0.1, 0, 0, 0, 1])


def test_objects_show_themselves_in_two_lines(slide):
    scene, state = many_contacts()
    attached, contact = scene.contours["floor"], next(iter(scene.contacts.values()))
    of_slide = [slide, slide.contacts["b/f"], slide.events[0], slide.scene, slide.state(-1)]
    for shown in (scene, state, attached, contact, pc.Stepper(scene, state), *of_slide):
        lines = repr(shown).splitlines()
        assert len(lines) <= 2, shown
        assert max(map(len, lines)) <= 240, shown
    for text in ("b/f", "nq 7", "ball, floor"):
        assert text in repr(slide.scene)
    assert "and 38 more" in repr(scene) and "and 39 more" in repr(state)
    assert "slip" in repr(slide.contacts["b/f"]) and "'ball' and 'floor'" in repr(slide.contacts["b/f"])
    assert "Sphere(radius=0.1)" in repr(slide.scene.contours["ball"])


def test_results_show_shapes_of_arrays():
    scene, state = many_contacts()
    ball, rolling = sliding_ball()
    found = pc.inverse_dynamics(scene, state, np.zeros(6), cones=True)
    steady = pc.find_equilibrium(scene, state.q)
    results = [
        pc.linearize(ball, replace(rolling, v=np.zeros(6))),
        pc.simulate(ball, rolling, 0.1, energies=True).energies(),
        pc.analyze(scene, state)["a contact with a long name 7"],
        pc.solve_contacts(np.eye(90), np.tile([0.0, 0.0, -1.0], 30), [0.5] * 30),
        *(found, steady),
    ]
    for shown in results:
        assert len(repr(shown)) <= 600, shown
    assert "A=array(8, 8)" in repr(results[0]) and "friction_work=array(" in repr(results[1])
    assert "tau=array(6,)" in repr(found) and "and 38 more" in repr(found) and "_program" not in repr(found)
    assert "state=State, " in repr(steady) and "holds=True" in repr(steady)


def test_notebooks_show_tables(slide):
    scene, state = sliding_ball()
    scene.add_contour("<b>", pc.Circle(0.3))
    for shown in (scene, state, slide, slide.contacts["b/f"], slide.events[0], pc.Plane()):
        html = shown._repr_html_()
        assert html.startswith("<") and html.endswith(">")
        # every tag is closed, and names are texts
        for tag in ("table", "tr", "td", "code"):
            assert html.count(f"<{tag}>") == html.count(f"</{tag}>")
        assert "<b>" not in html
    assert "&lt;b&gt;" in scene._repr_html_() and "stick" in slide._repr_html_()
    # a run of no outputs, and one of no contacts
    empty = pc.simulate(*sliding_ball(), 0.2, t_eval=[])
    assert "without outputs" in repr(empty) and "no outputs" in repr(empty.contacts["b/f"]) and empty._repr_html_()


SHAPES = [
    pc.Point(),
    pc.Line(),
    pc.Line((-math.inf, 2.0)),
    pc.Circle(0.1 + 0.2),
    pc.Circle(np.float64(1 / 3), domain=(np.float64(0.1), 2)),
    pc.Ellipse(0.3, b=0.2),
    pc.Helix(0.3, -0.2),
    pc.Cycloid(0.3),
    pc.FourierCurve([[0, 0], [1, 0]], np.array([[0.0, 0.0], [0.0, 1 / 3]])),
    pc.Plane(),
    pc.Plane(((-1, 1), None)),
    pc.Sphere(0.3),
    pc.Ellipsoid(0.3, 0.2, 0.1),
    pc.Cylinder(0.3),
    pc.Cone(0.4),
    pc.Torus(0.3, 0.1),
]


# of these what is shown is not all: they have much data, or a function
NOT_READ_BACK = {
    *("HeightField", "ParametricCurve", "ParametricSurface", "SplineCurve", "SplineSurface", "SurfaceOfRevolution"),
}


def test_contours_that_are_read_back_are_all_there():
    missing = kinds_of(pc.Contour) - NOT_READ_BACK - {type(shape).__name__ for shape in SHAPES}
    assert not missing, f"SHAPES or NOT_READ_BACK lacks {missing}"


@pytest.mark.parametrize("shape", SHAPES, ids=repr)
def test_contours_are_read_back_from_what_they_show(shape):
    again = eval(repr(shape), {**vars(pc), "inf": math.inf})
    assert type(again) is type(shape)
    assert repr(again) == repr(shape)
    for name, value in vars(shape).items():
        other = getattr(again, name)
        # to the last bit
        assert np.array_equal(other, value) if isinstance(value, np.ndarray) else other == value, name


def test_contours_of_much_data_are_shown_by_its_size():
    wave = np.array([[math.cos(u), math.sin(u), 0.1 * math.sin(2 * u)] for u in np.linspace(0.0, 6.0, 12)])
    assert repr(pc.SplineCurve(wave)) == "SplineCurve(points=array(12, 3))"
    assert repr(pc.SplineCurve(wave.tolist())) == "SplineCurve(points=array(12, 3))"
    # a large grid is not written out first
    grid = np.zeros((300, 300))
    tracemalloc.start()
    written = as_written(pc.Sphere, (grid,), {})
    assert written == "Sphere(radius=array(300, 300))" and tracemalloc.get_traced_memory()[1] < 100_000
    tracemalloc.stop()
    assert as_written(pc.Sphere, ((grid, [1, 2]),), {}) == "Sphere(radius=(array(300, 300), [1, 2]))"


# ---------------------------------------------------------------------------------------------------- forces


def test_force_on_either_body(slide):
    track = slide.contacts["b/f"]
    # the floor carries the ball: mg = 0.5 kg * 9.81 m/s^2
    np.testing.assert_allclose(track.force_on("ball")[:, 2], 4.905, rtol=1e-12)
    np.testing.assert_array_equal(track.force_on("floor"), -track.force_on("ball"))
    np.testing.assert_array_equal(track.force_on(slide.scene.contours["floor"]), track.force)
    track.force_on("floor")[:] = 0.0
    assert np.abs(track.force).max() > 1.0
    for wrong in ("rim", "", 3, None, pc.Plane(), slide.scene.contacts["b/f"]):
        with pytest.raises(pc.ArgumentError, match=r"one of 'ball' and 'floor', got"):
            track.force_on(wrong)


def test_force_on_does_not_depend_on_the_order_of_naming(slide):
    scene, _ = sliding_ball()
    scene.contacts.clear()
    scene.add_contact("f/b", "floor", "ball", friction=pc.Coulomb(0.2))
    other = pc.simulate(scene, scene.initial_state(slide.q[0], slide.v[0]), 0.2).contacts["f/b"]
    assert other.contours == ("floor", "ball")
    np.testing.assert_allclose(other.force_on("ball")[0], slide.contacts["b/f"].force_on("ball")[0], atol=1e-12)


# ---------------------------------------------------------------------------------------------------- files


@pytest.mark.parametrize("name", ["r", "r.npz", "r.run"])
def test_saved_runs_end_in_npz(slide, tmp_path, name):
    written = slide.save(tmp_path / name)
    assert [written] == list(tmp_path.iterdir()) and written.suffix == ".npz"
    for path in (written, tmp_path / name, str(tmp_path / name)):
        again = pc.Trajectory.load(path)
        np.testing.assert_array_equal(again.q, slide.q)
        # also without its scene
        np.testing.assert_array_equal(again.contacts["b/f"].force_on("ball"), slide.contacts["b/f"].force_on("ball"))


def test_older_files_do_not_know_the_contours(slide, tmp_path):
    track = pc.ContactTrack(**slide.contacts["b/f"].arrays())
    with pytest.raises(pc.TrajectoryError, match="earlier version"):
        track.force_on("ball")


def test_a_file_by_the_name_that_was_given_is_read(slide, tmp_path):
    slide.save(tmp_path / "r").rename(tmp_path / "r")
    assert pc.Trajectory.load(tmp_path / "r").t.size == slide.t.size


# ---------------------------------------------------------------------------------------------------- names


def test_plot_says_its_arguments():
    own = list(inspect.signature(pc.Trajectory.plot).parameters.values())[1:]
    those = list(inspect.signature(plot).parameters.values())[1:]
    assert [(p.name, p.default) for p in own] == [(p.name, p.default) for p in those]
    assert all(p.kind is not inspect.Parameter.VAR_KEYWORD for p in own)


def test_one_name_for_a_time_step(tmp_path, capsys):
    """`dt`; `step` is the same in calls, scene files and on the command line."""
    scene, state = sliding_ball()
    runs = [
        pc.simulate(scene, state, 0.05, method="Moreau", **given)
        for given in ({"dt": 2e-3}, {"step": 2e-3}, {"step": None, "dt": 2e-3})
    ]
    for run in runs:
        np.testing.assert_array_equal(run.q, runs[0].q)
    assert runs[0].stats["steps"] == 25
    with pytest.raises(pc.ArgumentError, match=r"step is another name of dt.*dt=0.1 and step=0.2"):
        pc.simulate(scene, state, 0.05, method="Moreau", dt=0.1, step=0.2)
    with pytest.raises(pc.ArgumentError, match=r"dt is for method 'Moreau'"):
        pc.simulate(scene, state, 0.05, dt=0.1)
    with pytest.raises(pc.ArgumentError, match=r"unknown method 'moreau'.*Moreau"):
        pc.simulate(scene, state, 0.05, method="moreau", dt=0.1)
    text = (ROOT / "examples" / "scenes" / "clattering_capsule.toml").read_text(encoding="utf-8")
    urdf = (ROOT / "urdf").as_posix()
    text = text.replace("../../urdf", urdf)
    (line,) = (line for line in text.splitlines() if line.startswith(("dt =", "step =")))
    for i, given in enumerate(("dt = 0.002", "step = 0.002", "dt = 0.002\nstep = 0.001")):
        path = tmp_path / f"{i}.toml"
        path.write_text(text.replace(line, given), encoding="utf-8")
        if i == 2:
            with pytest.raises(pc.SceneFileError, match=r"simulation.step: it is another name of dt"):
                pc.load_scene(path)
            continue
        loaded = pc.load_scene(path)
        assert loaded.settings["dt"] == 0.002 and "step" not in loaded.settings
        assert loaded.options(step=0.005)["dt"] == 0.005 and loaded.options(dt=0.005)["dt"] == 0.005
        for option in ("--dt", "--step"):
            assert main(["run", str(path), option, "0.01", "--duration", "0.1"]) == 0
            assert re.search(r"\b10 +steps", capsys.readouterr().out)


def test_the_command_is_the_module():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    module, function = re.search(r'\[project.scripts\]\npincontact = "([\w.]+):(\w+)"', text).groups()
    assert getattr(importlib.import_module(module), function) is main


# ---------------------------------------------------------------------------------------------------- messages


def test_what_is_a_sentence():
    assert sentence("got 3") == "got 3." and sentence("got 3.") == "got 3." and sentence("did you mean u?\n")[-1] == "?"
    assert sentence("") == ""
    assert str(pc.NoContactError("too far", 0.2)) == "too far." and pc.NoContactError("too far", 0.2).gap == 0.2
    again = copy.copy(pc.StateError("q"))
    assert str(again) == "q." and isinstance(again, ValueError)
    assert not str(pc.ContactError())


def literal_end(node):
    """The last characters of an expression that makes a text, None where only a run shows them."""
    if isinstance(node, ast.Constant):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return literal_end(node.values[-1])
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return literal_end(node.right)
    return None


# Raised for the package itself or for Python, and not shown to users as messages: see where they are caught.
INTERNAL = {"Stop", "Mismatch", "Untraceable", "_Refused"}


def raised():
    """(file, line, name of the class, its first argument) of every `raise Name(...)` in the package."""
    for path, tree in sources().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and isinstance(node.exc.func, ast.Name):
                arguments = node.exc.args
                yield path.relative_to(PACKAGE), node.lineno, node.exc.func.id, arguments[0] if arguments else None


def test_messages_end_in_a_full_stop():
    """Those of the package's errors do since their base class sees to it, functions that make errors make such; all
    others as they are written."""
    errors = {name: value for name, value in vars(importlib.import_module("pincontact.errors")).items()}
    seen = set()
    for path, line, name, message in raised():
        seen.add(name)
        if name in errors:
            assert issubclass(errors[name], pc.ContactError)
        elif name not in INTERNAL and message is not None and name.lstrip("_")[0].isupper():
            end = literal_end(message)
            assert end is not None and end.endswith("."), f"{path}:{line}: {name}"
    assert {"ArgumentError", "ContourError", "SolverError", "Stop"} <= seen


def test_errors_do_not_skip_their_base():
    """Every error class's constructor, where it has one, hands its message to the base class."""
    for name in pc.__all__:
        error = getattr(pc, name)
        if isinstance(error, type) and issubclass(error, pc.ContactError):
            assert str(error("a message")) == "a message.", name


def test_warnings_end_in_a_full_stop():
    count = 0
    for path, tree in sources().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "warnings.warn":
                count += 1
                text = node.args[0]
                made = isinstance(text, ast.Call) and ast.unparse(text.func) == "sentence"
                assert made or (literal_end(text) or "").endswith("."), f"{path}:{node.lineno}"
    assert count >= 3


def test_runs_end_with_a_sentence(slide, tmp_path):
    assert slide.message == "the end of the interval was reached."
    short = pc.simulate(*sliding_ball(), 0.2, max_steps=3)
    assert short.status < 0 and short.message.endswith(".") and not short.message.endswith("..")
    assert pc.Trajectory.load(short.save(tmp_path / "short")).message == short.message


def test_nothing_is_printed_but_by_the_command_line():
    for path, tree in sources().items():
        if path.name != "__main__.py":
            calls = [ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)]
            assert "print" not in calls, path


def test_no_module_has_a_logger_of_its_own():
    names = [module.name for module in pkgutil.iter_modules([str(PACKAGE)])]
    assert "log" in names and log.log is logging.getLogger("pincontact")
    assert len(log.log.handlers) == 1 and log.log.propagate


LOGGING = """
import logging, sys
{before}
from pincontact.log import log
{after}
log.info("compiling")
"""


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ("", "", "pincontact: compiling\n"),
        ("", "log.setLevel('WARNING')", ""),
        ("logging.getLogger('pincontact').setLevel('WARNING')", "", ""),
        ("", "logging.basicConfig(format='%(name)s!%(message)s', level='INFO')", "pincontact!compiling\n"),
        ("logging.basicConfig(format='%(name)s!%(message)s', level='INFO')", "", "pincontact!compiling\n"),
        ("", "log.addHandler(logging.NullHandler())", ""),
    ],
)
def test_records_are_seen_once_and_where_the_application_wants_them(before, after, expected):
    """In a process of its own: on stderr without further ado, else with the application's handlers and levels only."""
    # the module by itself, without what importing the package takes
    script = LOGGING.format(before=before, after=after).replace(
        "from pincontact.log import log",
        "import types\n"
        "package = sys.modules['pincontact'] = types.ModuleType('pincontact')\n"
        f"package.__path__ = [{str(PACKAGE)!r}]\n"
        "from pincontact.log import log",
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stderr == expected and done.stdout == ""


def test_plain_progress_goes_to_stderr(capsys):
    bar = PlainBar(total=2.0)
    for _ in range(4):
        bar.update(0.5)
    bar.close()
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.split("\r")[1:] == [
        "pincontact:  25 %",
        "pincontact:  50 %",
        "pincontact:  75 %",
        "pincontact: 100 %\n",
    ]


def test_a_state_does_not_call_a_contact_with_friction_frictionless():
    scene = pc.Scene.from_urdf(Path(__file__).parent.parent / "urdf" / "ball.urdf", floating_base=True)
    ball, floor = scene.add_contour("ball", pc.Sphere(0.1), "ball"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("rough", ball, floor, friction=pc.Coulomb(0.5))
    scene.add_contact("smooth", ball, scene.add_contour("plate", pc.Plane()))
    state = scene.initial_state([0, 0, 0.1, 0, 0, 0, 1])
    # a run decides whether the first sticks or slips
    assert "rough closed, smooth frictionless" in repr(state)
    assert "closed" in state._repr_html_()
