"""Recordings for the rerun viewer, read back from their files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from fake_run import END, GRAVITY, HOP_END, HOP_START, MASS, MU, RADIUS, SLIP_END, fake_run, placement, point

import pincontact as pc
from pincontact.view import palette

URDF = Path(__file__).parent.parent / "urdf"
CONTACT = "rim/floor"


def read(path):
    """By entity: static components, and (times in s, {component: rows}); of the first recording in a file."""
    chunk = pytest.importorskip("rerun.chunk", reason="this version of rerun does not read recordings")
    static, timed = {}, {}
    for piece in chunk.RrdReader(path).stream().to_chunks():
        batch = piece.to_record_batch()
        parts = {field.name: batch.column(field.name).to_pylist() for field in batch.schema}
        name = piece.entity_path
        if piece.is_static:
            static.setdefault(name, {}).update({key: rows[0] for key, rows in parts.items()})
        elif "time" in parts:
            times = [at.total_seconds() if hasattr(at, "total_seconds") else at * 1e-9 for at in parts.pop("time")]
            timed.setdefault(name, []).append((np.array(times), parts))
    return static, timed


def series(timed, name, component):
    """times (n,) and rows of a component, in order."""
    pieces = [(times, parts[component]) for times, parts in timed[name] if component in parts]
    times = np.concatenate([times for times, _ in pieces])
    rows = [row for _, rows in pieces for row in rows]
    order = np.argsort(times, kind="stable")
    return times[order], [rows[i] for i in order]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    pytest.importorskip("rerun", reason="rerun is not installed: pip install pincontact[rerun]")
    path = tmp_path_factory.mktemp("recording") / "run.rrd"
    assert pc.export_rerun(fake_run(), path, force_scale=0.01) == path
    return read(path)


def test_bodies_move_as_in_the_run(recorded):
    static, timed = recorded
    times, places = series(timed, "/scene/bodies/root", "Transform3D:translation")
    _, turned = series(timed, "/scene/bodies/root", "Transform3D:quaternion")
    assert times[0] == 0.0 and times[-1] == pytest.approx(END) and len(times) == 91
    # static data would hide them
    assert "Transform3D:translation" not in static.get("/scene/bodies/root", {})
    for time, (place,), (quaternion,) in zip(times, places, turned):
        expected = placement(time)
        # rows 0.025 s apart: as the page's, whose test says why; float32
        kink = min(abs(time - HOP_START), abs(time - HOP_END)) < 0.03
        assert place == pytest.approx(expected.translation, abs=4e-3 if kink else 3e-6)
        error = pin.log3(expected.rotation.T @ pin.Quaternion(np.array(quaternion)).matrix())
        assert np.linalg.norm(error) < 1e-5


def test_contact_points_and_arrows(recorded):
    static, timed = recorded
    base = f"/scene/contacts/{CONTACT.replace('/', chr(92) + '|')}"
    times, points = series(timed, f"{base}/point", "Points3D:positions")
    _, arrows = series(timed, f"{base}/normal", "Arrows3D:vectors")
    _, colors = series(timed, f"{base}/normal", "Arrows3D:colors")
    _, origins = series(timed, f"{base}/normal", "Arrows3D:origins")
    for time, at, arrow, color, origin in zip(times, points, arrows, colors, origins):
        if min(abs(time - x) for x in (SLIP_END, HOP_START, HOP_END)) < 0.03:
            continue
        if HOP_START < time < HOP_END:
            assert not at and not arrow
            continue
        assert at[0] == pytest.approx(point(np.array([time]))[0], abs=4e-3)
        assert origin == at
        # on the rim, which moves: upwards, 1 cm a newton
        assert arrow[0] == pytest.approx([0.0, 0.0, 0.01 * MASS * GRAVITY], abs=1e-6)
        red, green, blue = (round(255 * x) for x in palette.MODE_COLORS[2 if time < SLIP_END else 1])
        assert color[0] == red << 24 | green << 16 | blue << 8 | 255
    trace = np.array(static[f"{base}/trace"]["Mesh3D:vertex_positions"])
    # a tube along the circle, without the hop
    heading = np.mod(np.arctan2(trace[:, 1], trace[:, 0]) + 0.5, 2.0 * np.pi)
    assert np.ptp(heading) == pytest.approx(0.9 * END / 0.8, abs=0.05) and np.abs(trace[:, 2]).max() < 0.05


def test_contours_hang_on_their_bodies(recorded):
    static, _ = recorded
    rim = np.array(static["/scene/bodies/root/contours/rim/curve"]["Mesh3D:vertex_positions"])
    assert np.linalg.norm(rim, axis=1) == pytest.approx(RADIUS, abs=0.05 * RADIUS)
    assert static["/scene/bodies/root/contours/rim"]["Transform3D:translation"] == [[0.0, 0.0, 0.0]]
    floor = np.array(static["/scene/bodies/universe/contours/floor/surface"]["Mesh3D:vertex_positions"])
    assert np.ptp(floor[:, 2]) == 0.0 and np.ptp(floor[:, 0]) > 1.6


def test_plots_and_events(recorded):
    _, timed = recorded
    run = fake_run()
    track, name = run.contacts[CONTACT], CONTACT.replace("/", chr(92) + "|")
    expected = {
        f"forces/{name}/normal": track.normal_force,
        f"forces/{name}/friction": track.tangential_force,
        f"forces/{name}/limit": np.where(track.mode == -1, 0.0, MU * MASS * GRAVITY),
        f"slip_speed/{name}": np.linalg.norm(track.slip_velocity, axis=1),
        f"gap/{name}": track.gap,
        f"mode/{name}": track.mode,
        "q": run.q,
        "v": run.v,
        "energy/total": run.energies().total,
    }
    for path, values in expected.items():
        times, rows = series(timed, f"/plots/{path}", "Scalars:scalars")
        # nanoseconds
        assert times == pytest.approx(run.t, abs=1e-9)
        assert np.array(rows) == pytest.approx(values.reshape(len(run.t), -1), rel=1e-14), path
    times, texts = series(timed, "/events", "TextLog:text")
    assert list(times) == pytest.approx([SLIP_END, HOP_START, HOP_END, 2.5])
    assert [text for (text,) in texts] == [f"{CONTACT}: stick", f"{CONTACT}: separate", f"{CONTACT}: touch", "user"]


def test_robots_are_there_with_their_shapes_and_colours(tmp_path):
    pytest.importorskip("rerun", reason="rerun is not installed: pip install pincontact[rerun]")
    scene = pc.Scene.from_urdf(URDF / "cart.urdf", floating_base=True)
    run = pc.simulate(scene, scene.initial_state(pin.neutral(scene.model)), 0.0)
    static, _ = read(pc.export_rerun(run, tmp_path / "cart.rrd"))
    for geometry in scene.visual_model.geometryObjects:
        joint = scene.model.names[geometry.parentJoint]
        drawn = static[f"/scene/bodies/{joint}/visuals/{geometry.name}"]
        assert drawn["Transform3D:translation"][0] == pytest.approx(geometry.placement.translation)
        corners = np.array(drawn["Mesh3D:vertex_positions"])
        assert np.ptp(corners, axis=0) == pytest.approx(np.ptp(geometry.geometry.vertices(), axis=0), rel=1e-6)
        normals = np.array(drawn["Mesh3D:vertex_normals"])
        assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0, rel=1e-6)
        # closed bodies: the volume inside is positive if normals and triangles look outwards
        assert np.einsum("ij,ij->", corners - corners.mean(axis=0), normals) > 0.0
    assert static["/scene/bodies/root_joint/visuals/cart_0"]["Mesh3D:albedo_factor"] == [0xD9331AFF]


def test_a_contour_that_changes_is_shown_one_shape_at_a_time(tmp_path):
    pytest.importorskip("rerun", reason="rerun is not installed: pip install pincontact[rerun]")
    scene = pc.Scene.from_urdf(URDF / "ball.urdf", floating_base=True)
    wave = pc.ParametricSurface(lambda x, y, t: (x, y, -1.0 + 0.1 * t * x), ((-1.0, 1.0), (-1.0, 1.0)))
    scene.add_contact("c", scene.add_contour("ball", pc.Sphere(0.1), "ball"), scene.add_contour("wave", wave))
    state = scene.initial_state([0, 0, 0.5, 0, 0, 0, 1], free=["c"])
    _, timed = read(pc.export_rerun(pc.simulate(scene, state, 0.1), tmp_path / "x.rrd"))
    shapes = {name: parts for name, parts in timed.items() if name.startswith("/scene/bodies/universe/contours/wave/")}
    assert len(shapes) == 4
    for number, name in enumerate(sorted(shapes)):
        pieces = shapes[name]
        drawn = [times for times, parts in pieces if "Mesh3D:vertex_positions" in parts]
        cleared = [times for times, parts in pieces if "Clear:is_recursive" in parts]
        assert len(drawn) == 1 and len(cleared) == (number < len(shapes) - 1)


def test_arguments(tmp_path, monkeypatch):
    run = fake_run()
    for options in ({"fps": 0.0}, {"max_frames": 1}, {"force_scale": -1.0}):
        with pytest.raises(pc.ArgumentError, match=next(iter(options))):
            pc.export_rerun(run, tmp_path / "x.rrd", **options)
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(pc.MissingExtraError, match=r"pip install pincontact\[rerun\]"):
        pc.export_rerun(run, tmp_path / "x.rrd")
    assert not (tmp_path / "x.rrd").exists()


def test_a_folder_that_is_not_there_is_an_error_of_the_system(tmp_path):
    pytest.importorskip("rerun", reason="rerun is not installed: pip install pincontact[rerun]")
    with pytest.raises(FileNotFoundError):
        pc.export_rerun(fake_run(), tmp_path / "none" / "x.rrd")


def test_rerun_is_not_imported_before_it_is_used():
    code = "import sys, pincontact as pc; pc.export_rerun, pc.replay; assert 'rerun' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parent)
