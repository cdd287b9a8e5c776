"""The command line: what it prints, what it writes and its exit codes."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pincontact as pc
from pincontact.__main__ import main

ROOT = Path(__file__).parent.parent
DISK, BLOCK = (str(ROOT / "examples" / "scenes" / f"{name}.toml") for name in ("rolling_disk", "block_on_incline"))

# A rod that slides with its tip ahead, at an angle at which Coulomb's law leaves no force (Painleve): mu > 4/3.
PAINLEVE_ROBOT = """<?xml version="1.0"?>
<robot name="rod">
  <link name="base"/>
  <link name="x"><inertial><mass value="1e-9"/>
    <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="z"><inertial><mass value="1e-9"/>
    <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="rod"><inertial><mass value="1"/>
    <inertia ixx="0" iyy="0.3333333333333333" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="px" type="prismatic"><parent link="base"/><child link="x"/><axis xyz="1 0 0"/>
    <limit lower="-9" upper="9" effort="1" velocity="9"/></joint>
  <joint name="pz" type="prismatic"><parent link="x"/><child link="z"/><axis xyz="0 0 1"/>
    <limit lower="-9" upper="9" effort="1" velocity="9"/></joint>
  <joint name="turn" type="continuous"><parent link="z"/><child link="rod"/><axis xyz="0 1 0"/></joint>
</robot>
"""
PAINLEVE_SCENE = """
urdf = "rod.urdf"

[contours.tip]
kind = "Point"
frame = "rod"
xyz = [1, 0, 0]

[contours.ground]
kind = "Plane"

[contacts.tip]
between = ["tip", "ground"]
friction = 2.0

[initial]
q = { pz = "sin(1.2)", turn = 1.2 }
v = { px = 3.0 }

[simulation]
duration = 0.5
"""


def failing_scene(tmp_path):
    (tmp_path / "rod.urdf").write_text(PAINLEVE_ROBOT)
    path = tmp_path / "painleve.toml"
    path.write_text(PAINLEVE_SCENE)
    return str(path)


def table(text, title):
    """Rows of a printed table, split at runs of two blanks."""
    lines = text.split(f"\n{title}\n", 1)[1].split("\n\n")[0].splitlines()
    return [re.split(r"\s{2,}", line.strip()) for line in lines]


def test_run_prints_what_the_run_says(capsys):
    assert main(["run", DISK, "--duration", "0.5"]) == 0
    out = capsys.readouterr().out
    loaded = pc.load_scene(DISK)
    run = loaded.simulate(duration=0.5)
    assert f"status 0: {run.message}" in out
    assert re.search(r"0\.5 s simulated in [\d.e-]+ s, [\d.e+]+ x real time", out)
    counts = {row[1]: row[0] for row in table(out, "counts")[1:]}
    assert counts["steps"] == str(run.stats["steps"]) and counts["rhs"] == str(run.stats["rhs"])
    energies = {row[0]: [float(x) for x in row[1:]] for row in table(out, "energies [J]")[1:]}
    expected = run.energies()
    # six digits are printed
    assert energies["kinetic"] == pytest.approx([expected.kinetic[0], expected.kinetic[-1]], rel=1e-5)
    assert energies["potential"] == pytest.approx([expected.potential[0], expected.potential[-1]], rel=1e-5)
    residuals = {row[0]: float(row[1]) for row in table(out, "worst residuals")[1:]}
    assert residuals == pytest.approx({k: v.max() for k, v in run.residuals().items()}, rel=0.1)
    ((name, modes, _, slip),) = table(out, "contacts")[1:]
    assert (name, modes) == ("rim/floor", "stick 100 %") and float(slip) < 1e-12


def test_run_lists_events(tmp_path, capsys):
    """A ball that starts to slide on a rough floor rolls after 2 v / (7 mu g)."""
    path = tmp_path / "ball.toml"
    text = (ROOT / "examples" / "scenes" / "ball_on_turntable.toml").read_text()
    text = text.replace("../../urdf", str(ROOT / "urdf"))
    text = text.replace('motion = { kind = "ConstantTwist", angular = [0, 0, "rate"] }', "")
    path.write_text(text.replace('"no slip"', "0.15").replace("v = [0.1, 0.2,", "v = [0.8, 0,"))
    assert main(["run", str(path), "--duration", "0.5"]) == 0
    rows = table(capsys.readouterr().out, "events")
    assert rows[1][1:] == ["ball", "stick"] and len(rows) == 2
    assert float(rows[1][0]) == pytest.approx(2.0 * 0.8 / (7.0 * 0.15 * 9.81), rel=1e-5)


def test_run_saves_and_replays(tmp_path, capsys):
    npz, html = tmp_path / "run.npz", tmp_path / "run.html"
    assert main(["run", DISK, "--duration", "0.1", "--save", str(npz), "--html", str(html)]) == 0
    out = capsys.readouterr().out
    assert f"wrote {npz}" in out and f"wrote {html}" in out
    stored = pc.Trajectory.load(npz)
    np.testing.assert_array_equal(stored.q, pc.load_scene(DISK).simulate(duration=0.1).q)
    assert html.read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype html")


def test_progress_is_shown(capsys):
    pytest.importorskip("tqdm")
    assert main(["run", DISK, "--duration", "0.1", "--progress"]) == 0
    assert "0.1/0.1 s" in capsys.readouterr().err


def test_info(capsys):
    assert main(["info", BLOCK]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"{BLOCK}: block, nq 7, nv 6, 15 contours, 4 contacts")
    assert table(out, "bodies")[1] == ["root_joint", "JointModelFreeFlyer", "universe", "0:7", "0:6", "3"]
    contours = {row[0]: row[1:] for row in table(out, "contours")[1:]}
    assert contours["block_0_face_-z"] == ["Plane", "block", "2", "-0.2 0.2 -0.15 0.15"]
    assert contours["incline"] == ["Plane", "universe", "2", "-inf inf -inf inf"]
    heads, *rows = table(out, "contacts")
    assert heads[3:9] == ["pattern", "m", "k", "GC", "VC", "friction"]
    assert [row[3:9] for row in rows] == [["P-S", "3", "2", "1", "2", "mu 0.2"]] * 4
    heads, *rows = table(out, "initial state as given")
    correction = pc.load_scene(BLOCK).state.correction
    for name, gap, normal, tangential, found in rows:
        # six digits are printed
        assert float(gap) == pytest.approx(correction.gaps[name], rel=1e-5, abs=1e-20)
        assert [float(normal), float(tangential)] == pytest.approx(correction.slips[name], rel=1e-5, abs=1e-20)
        assert found == "1"
    assert f"by at most {correction.dq:.3g} in q (m, rad) and {correction.dv:.3g} in v" in out
    residuals = {row[0]: float(row[1]) for row in table(out, "residuals")[1:]}
    assert list(residuals) == ["C1", "C2", "GC", "VC"] and max(residuals.values()) < 1e-12
    heads, *rows = table(out, "initial state")
    assert [row[heads.index("mode")] for row in rows] == ["slip"] * 4
    # one evaluation decides the forces: together they carry the weight across the slope
    total = sum(float(row[-1]) for row in rows)
    assert total == pytest.approx(3.0 * 9.81 * np.cos(0.3), rel=1e-5)


@pytest.mark.parametrize(
    ("law", "text"),
    [
        ("{mu = 0.3, mu_static = 0.4, viscous = 2}", "mu 0.3, static 0.4, viscous 2 N s/m"),
        ("{mu = [0.3, 0.5]}", "mu 0.3 x 0.5"),
        ("{mu = 0.1, mu_static = 0.2, speed = 0.01}", "mu 0.1, static 0.2, speed 0.01 m/s, exponent 2"),
        ("{mu = 0.1, rolling = 1e-3}", "mu 0.1, rolling 0.001 m"),
        ("{mu = 'no slip', spinning = 1e-3}", "no slip, spinning 0.001 m"),
    ],
)
def test_info_names_the_friction_law(tmp_path, capsys, law, text):
    (tmp_path / "rod.urdf").write_text(PAINLEVE_ROBOT)
    path = tmp_path / "rod.toml"
    path.write_text(PAINLEVE_SCENE.replace("friction = 2.0", f"friction = {law}"))
    assert main(["info", str(path)]) == 0
    heads, row = table(capsys.readouterr().out, "contacts")
    assert row[heads.index("friction")] == text


@pytest.mark.parametrize("command", ["run", "info"])
def test_a_run_that_cannot_finish(tmp_path, capsys, command):
    assert main([command, failing_scene(tmp_path)]) == 1
    captured = capsys.readouterr()
    assert re.search(r"painleve\.toml: status -4: .*Painleve", captured.err)
    assert "Traceback" not in captured.err
    assert "painleve.toml" in captured.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "nowhere.toml"], r"nowhere\.toml cannot be read"),
        (["info", "nowhere.toml"], r"nowhere\.toml cannot be read"),
        (["run", DISK, "--duration", "-1"], r"duration must not be negative, got -1"),
        (["run", DISK, "--html", "no/such/folder/run.html"], r"there is no folder no/such/folder"),
        (["run", DISK, "--save", "no/such/folder/run.npz"], r"there is no folder no/such/folder"),
    ],
)
def test_bad_input(capsys, arguments, message):
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert re.search(message, captured.err) and captured.err.count("\n") == 1
    assert captured.out == ""


def test_contours_apart_are_bad_input(tmp_path, capsys):
    path = tmp_path / "apart.toml"
    text = (ROOT / "examples" / "scenes" / "ball_on_turntable.toml").read_text()
    path.write_text(text.replace("../../urdf", str(ROOT / "urdf")).replace("q = [0.4, 0, 0.1,", "q = [0.4, 0, 0.9,"))
    assert main(["info", str(path)]) == 2
    assert re.search(r"apart\.toml: contact 'ball': .*gap is 0\.8 m", capsys.readouterr().err)


def test_options_of_a_run(capsys, recwarn):
    assert main(["run", DISK, "--duration", "0.05", "--method", "Moreau", "--step", "0.01"]) == 0
    # the file's tolerances are for its own method
    assert "rtol" in Path(DISK).read_text(encoding="utf-8") and not recwarn
    counts = {row[1]: row[0] for row in table(capsys.readouterr().out, "counts")[1:]}
    assert counts["steps"] == "5"
    with pytest.raises(SystemExit):
        main(["run", DISK, "--method", "Moreau", "--dt", "0.01", "--step", "0.01"])
    assert "not allowed with argument" in capsys.readouterr().err
    few = main(["run", DISK, "--duration", "1", "--rtol", "1e-3"]), capsys.readouterr().out
    many = main(["run", DISK, "--duration", "1", "--rtol", "1e-11"]), capsys.readouterr().out
    few_steps, many_steps = (
        int({row[1]: row[0] for row in table(out, "counts")[1:]}["steps"]) for _, out in (few, many)
    )
    assert few_steps < many_steps
    assert main(["run", DISK, "--method", "Euler"]) == 2
    assert re.search(r"method.*Euler", capsys.readouterr().err)


def test_version(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["--version"])
    assert stopped.value.code == 0
    assert capsys.readouterr().out.startswith(f"pincontact {pc.__version__} (pinocchio ")


def test_interrupt(capsys, monkeypatch):
    def interrupted(path):
        raise KeyboardInterrupt

    monkeypatch.setattr("pincontact.__main__.load_scene", interrupted)
    assert main(["info", DISK]) == 130
    assert capsys.readouterr().err == "pincontact: interrupted.\n"


def test_usage_is_bad_input(capsys):
    for arguments in ([], ["walk", DISK], ["run", DISK, "--duration", "long"]):
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        assert stopped.value.code == 2
    assert "usage: pincontact" in capsys.readouterr().err


# Not the checkout: the installed package is meant, and its compiled kernels.
ELSEWHERE = Path(__file__).parent


def test_as_a_module(monkeypatch, capsys):
    """The exit code reaches whoever started it: `python -m` runs the module like this."""
    monkeypatch.setattr(sys, "argv", ["pincontact", "info", "nowhere.toml"])
    monkeypatch.delitem(sys.modules, "pincontact.__main__")
    with pytest.raises(SystemExit) as stopped:
        runpy.run_module("pincontact", run_name="__main__", alter_sys=True)
    assert stopped.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.startswith("pincontact: nowhere.toml cannot be read")


def test_a_reader_that_has_seen_enough():
    """As `head`: closed before the first line is written."""
    started = subprocess.Popen(
        [sys.executable, "-m", "pincontact", "info", DISK],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ELSEWHERE,
    )
    started.stdout.close()
    message = started.stderr.read()
    assert started.wait(timeout=120) == 0
    assert "Traceback" not in message and "BrokenPipe" not in message
