"""Replay pages, arrows, resampling and plots, on a run known in closed form."""

from __future__ import annotations

import base64
import gzip
import json
import re
import sys
import warnings
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
import umsgpack
from fake_run import (
    END,
    GRAVITY,
    HOP_END,
    HOP_START,
    MASS,
    MU,
    RADIUS,
    SLIP_END,
    SPEED,
    TURN,
    fake_run,
    placement,
    point,
    wheel_model,
)

import pincontact as pc
from pincontact.contours import Circle, Helix, Line, ParametricSurface, Plane, Point, Sphere
from pincontact.contours.motion import HarmonicMotion
from pincontact.errors import ArgumentError, TrajectoryError
from pincontact.geometry.patterns import PATTERNS
from pincontact.layout import FREE, SLIPPING, STICK
from pincontact.view import arrows, export_html, meshes, plots, replay
from pincontact.view.drawing import Drawing
from pincontact.view.outlines import tile_size
from pincontact.view.page import pack_commands
from pincontact.view.palette import MODE_COLORS, contact_color
from pincontact.view.picture import fitting_distance, fitting_force_scale, scene_size
from pincontact.view.replay import PARTS, compose, page_info
from pincontact.view.robot import draw_robot
from pincontact.view.sampling import (
    Motion,
    configurations,
    contact_frames,
    frame_times,
    intervals,
    joint_placements,
    split_force,
)

CONTACT = "rim/floor"


@pytest.fixture(scope="module")
def run():
    return fake_run()


@pytest.fixture(scope="module")
def page(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "run.html"
    assert export_html(run, path, title="a <wheel> & its floor") == path
    return path.read_text(encoding="utf-8")


@pytest.fixture
def pyplot():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg", force=True)
    from matplotlib import pyplot

    yield pyplot
    pyplot.close("all")


TYPES = {0x12: np.uint8, 0x13: np.int16, 0x14: np.uint16, 0x16: np.uint32, 0x17: np.float32}
HANDLERS = {code: lambda ext, dtype=dtype: np.frombuffer(ext.data, dtype) for code, dtype in TYPES.items()}


def unpacked(commands):
    """Commands as the viewer gets them, with arrays."""
    return [umsgpack.unpackb(umsgpack.packb(command), ext_handlers=HANDLERS) for command in commands]


def commands_of(text):
    """The commands a page carries out."""
    places = json.loads(re.search(r"^const commands = (.*);$", text, re.M).group(1))
    data = gzip.decompress(base64.b64decode(re.search(r'^const packed = "(.*)";$', text, re.M).group(1)))
    pieces = [b"".join(data[a:b] for a, b in zip(place[::2], place[1::2])) for place in places]
    return [umsgpack.unpackb(piece, ext_handlers=HANDLERS) for piece in pieces]


def tracks_of(commands):
    """(path, property) -> track."""
    (animation,) = (c for c in commands if c["type"] == "set_animation")
    return {(a["path"], t["name"]): t for a in animation["animations"] for t in a["clip"]["tracks"]}


def changed(thing, **attributes):
    """A copy of a run or a scene, as far as it is read, with other attributes."""
    return SimpleNamespace(**{**vars(thing), **attributes})


def frames_at(run, times):
    q = configurations(run, times)
    return contact_frames(run, CONTACT, times, q, joint_placements(run.scene.model, q))


class Elements(HTMLParser):
    def __init__(self):
        super().__init__()
        self.elements = []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))


# Pages


def test_page_is_self_contained(page):
    parser = Elements()
    parser.feed(page)
    tags = [tag for tag, _ in parser.elements]
    assert tags.count("script") == 3
    assert "link" not in tags and "iframe" not in tags and "img" not in tags
    for _, attributes in parser.elements:
        assert not {"src", "href", "srcset", "data"} & set(attributes)
    assert "MeshCat" in page
    # A closed element of its own for every script: nothing inside one ended it early.
    assert page.count("</script>") == 3
    assert "<title>a &lt;wheel&gt; &amp; its floor</title>" in page


def test_page_builds_every_node_before_it_animates(page):
    commands = commands_of(page)
    assert commands[-1]["type"] == "set_animation"
    made = {c["path"] for c in commands if c["type"] == "set_object"}
    for path, _ in tracks_of(commands):
        node = path.removesuffix("/<object>")
        assert any(other == node or other.startswith(node + "/") for other in made), path


def test_page_animates_body_point_arrows_and_traces(page):
    tracks = tracks_of(commands_of(page))
    body, contact = "/meshcat/pincontact/bodies/root", "/meshcat/pincontact/contacts/rim|floor"
    expected = {
        (body, ".position"),
        (body, ".quaternion"),
        (f"{contact}/point", ".position"),
        (f"{contact}/point", ".visible"),
        (f"{contact}/trace/<object>", ".geometry[drawRange].count"),
        (f"{body}/traces/rim|floor on rim/<object>", ".geometry[drawRange].count"),
    }
    for part in ("normal", "friction"):
        expected |= {(f"{contact}/{part}", p) for p in (".position", ".quaternion", ".visible")}
        expected |= {(f"{contact}/{part}/head", ".position"), (f"{contact}/{part}/head", ".scale")}
        expected.add((f"{contact}/{part}/shaft", ".scale"))
        for mode in ("stick", "slip"):
            expected |= {(f"{contact}/{part}/{piece}/{mode}", ".visible") for piece in ("shaft", "head")}
    assert set(tracks) == expected
    sizes = {"vector3": 3, "quaternion": 4, "number": 1, "boolean": 1}
    for track in tracks.values():
        times = np.asarray(track["times"])
        assert np.all(np.diff(times) > 0.0)
        # float32 in the page
        assert times[0] == 0.0 and times[-1] == pytest.approx(END, rel=1e-6)
        assert len(track["values"]) == sizes[track["type"]] * len(times)
        if track["type"] != "boolean":
            assert np.isfinite(track["values"]).all()


def test_page_moves_the_wheel_as_the_run_does(page):
    tracks = tracks_of(commands_of(page))
    position = tracks[("/meshcat/pincontact/bodies/root", ".position")]
    quaternion = tracks[("/meshcat/pincontact/bodies/root", ".quaternion")]
    rotations = np.asarray(quaternion["values"], dtype=float).reshape(-1, 4)
    for time, where, turned in zip(position["times"], np.reshape(position["values"], (-1, 3)), rotations):
        expected = placement(float(time))
        # Away from the hop's kinks the cubic between rows 0.025 s apart errs by (w h)^4 / 384, some 1e-7; at a
        # kink by about h dv / 8; float32 adds 1e-7.
        kink = min(abs(time - HOP_START), abs(time - HOP_END)) < 0.03
        assert where == pytest.approx(expected.translation, abs=4e-3 if kink else 3e-6)
        error = pin.log3(expected.rotation.T @ pin.Quaternion(turned / np.linalg.norm(turned)).matrix())
        assert np.linalg.norm(error) < 1e-5


def test_page_arrow_pieces_show_one_mode_at_a_time(page, run):
    commands = commands_of(page)
    tracks = tracks_of(commands)
    colors = {
        c["path"].rsplit("/", 1)[1]: c["object"]["materials"][0]["color"]
        for c in commands
        if c["type"] == "set_object" and "/normal/shaft/" in c["path"]
    }
    for mode, name in ((STICK, "stick"), (SLIPPING, "slip")):
        red, green, blue = (round(255 * x) for x in MODE_COLORS[mode])
        assert colors[name] == 65536 * red + 256 * green + blue

    def visible(path, time):
        track = tracks[("/meshcat/pincontact/contacts/rim|floor/" + path, ".visible")]
        return track["values"][np.searchsorted(np.asarray(track["times"]), time, side="right") - 1]

    for time, shown, stick in ((0.3, True, False), (1.0, True, True), (2.1, False, None), (2.8, True, True)):
        assert visible("normal", time) is shown
        if shown:
            assert visible("normal/head/stick", time) is stick
            assert visible("normal/head/slip", time) is not stick


def test_page_info_is_what_the_bar_shows(page, run):
    info = json.loads(re.search(r"^const info = (.*);$", page, re.M).group(1))
    assert info["duration"] == END and info["frames"] == 91 and info["step"] == pytest.approx(1 / 30)
    (contact,) = info["contacts"]
    # The floor belongs to the world, so the arrows show the force on the rim.
    assert contact["name"] == CONTACT and contact["on"] == "rim"
    assert contact["mode"][3] == SLIPPING and contact["mode"][30] == STICK and contact["mode"][63] == FREE
    # five digits are kept
    assert contact["normal"][30] == pytest.approx(MASS * GRAVITY, rel=1e-5)
    assert contact["friction"][3] == pytest.approx(MU * MASS * GRAVITY, rel=1e-5)
    assert contact["limit"][3] == contact["limit"][30] == pytest.approx(MU * MASS * GRAVITY, rel=1e-5)
    assert contact["normal"][63] == contact["limit"][63] == 0.0
    assert info["events"][1] == [HOP_START, CONTACT, "separate"] and info["events"][3] == [2.5, "", "user"]


def test_page_text_cannot_end_its_script(tmp_path):
    text = export_html(fake_run(name="</script><b>"), tmp_path / "x.html").read_text(encoding="utf-8")
    assert text.count("</script>") == 3
    info = json.loads(re.search(r"^const info = (.*);$", text, re.M).group(1).replace("<\\/", "</"))
    assert info["contacts"][0]["name"] == "</script><b>"


def test_speed_is_the_viewers_in_a_page_and_in_the_tracks_live(run):
    picture = compose(run, 30.0, 0.5, 3000, None, None, ("robot",))
    slowed = picture.commands(environment=False, time_scale=2.0)[-1]
    # Meshcat divides track times by the rate.
    assert {a["clip"]["fps"] for a in slowed["animations"]} == {0.5}
    assert page_info(picture, run, 0.5)["speed"] == 0.5
    # Half speed at 30 frames per second of replay: 60 per second of motion.
    assert len(picture.times) == 181


def test_following_brings_the_point_to_the_origin(run):
    picture = compose(run, 30.0, 1.0, 3000, None, CONTACT, ("points",))
    tracks = tracks_of(picture.commands(environment=True))
    assert ("/meshcat/pincontact", ".position") in tracks
    touching = picture.contacts[CONTACT].touching
    # The wheel rolls evenly, so the parameter is interpolated to round-off and the wheel to 3e-6 m; next to the hop the
    # wheel's cubic meets a kink (h dv / 8).
    assert picture.followed[touching] == pytest.approx(point(picture.times[touching]), abs=4e-3)
    smooth = touching & (picture.times < HOP_START - 0.03)
    assert picture.followed[smooth] == pytest.approx(point(picture.times[smooth]), abs=3e-6)
    for name, offset in (("disk", RADIUS), ("rim", RADIUS)):
        followed = compose(run, 30.0, 1.0, 3000, None, name, ()).followed
        # to the error of the cubic between rows
        assert followed[0] == pytest.approx([TURN, 0.0, offset], abs=1e-12)


def test_a_run_without_its_scene_says_how_to_get_it(run, tmp_path):
    bare = changed(run, scene=pc.Scene(pin.Model()))
    with pytest.raises(TrajectoryError, match=r"of 7 numbers .* needs 0; .* Trajectory.load\(path, scene\)"):
        export_html(bare, tmp_path / "x.html")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"fps": 0.0}, "fps must be positive and finite, got 0.0"),
        ({"speed": -1.0}, "speed must be positive and finite, got -1.0"),
        ({"fps": float("nan")}, "fps must be positive and finite, got nan"),
        ({"max_frames": 1}, "max_frames must be at least 2, got 1"),
        ({"force_scale": float("inf")}, "force_scale must be positive and finite, got inf"),
        ({"follow": "hub"}, "'hub' is not the name"),
        ({"show": ("robots",)}, "unknown parts robots"),
    ],
)
def test_bad_arguments_raise_before_anything_is_written(run, tmp_path, arguments, message):
    target = tmp_path / "never.html"
    with pytest.raises(ArgumentError, match=message):
        export_html(run, target, **arguments)
    assert not target.exists()


def test_show_leaves_out_what_is_not_asked_for(run, tmp_path):
    text = export_html(run, tmp_path / "x.html", show=["robot"]).read_text(encoding="utf-8")
    commands = commands_of(text)
    assert not [c for c in commands if c["type"] == "set_object" and c["path"].startswith("/meshcat")]
    assert set(tracks_of(commands)) == {("/meshcat/pincontact/bodies/root", p) for p in (".position", ".quaternion")}


def test_pages_of_one_run_are_equal(run, page, tmp_path):
    again = export_html(run, tmp_path / "again.html", title="a <wheel> & its floor")
    assert again.read_text(encoding="utf-8") == page


def test_live_replay_sends_the_same_scene_to_a_given_viewer(run):
    sent = []
    window = SimpleNamespace(send=lambda command: sent.append(command.lower()))
    viewer = SimpleNamespace(window=window)
    assert replay(run, viewer=viewer, speed=0.5) is viewer
    assert [c["type"] for c in sent].count("set_animation") == 1 and sent[-1]["type"] == "set_animation"
    assert sent[0] == {"type": "delete", "path": "/meshcat/pincontact"}
    # A viewer that is the user's keeps its background, light and camera.
    assert all(c["path"].startswith("/meshcat/pincontact") for c in sent[:-1])
    # Pinocchio's visualizer holds one.
    assert replay(run, viewer=SimpleNamespace(viewer=viewer)) is viewer


def test_live_replay_through_a_real_server(run):
    meshcat = pytest.importorskip("meshcat")
    viewer = meshcat.Visualizer()
    try:
        for _ in range(2):
            replay(run, viewer=viewer, max_frames=20)
        # What the server tells a browser that connects now: every node, and then the animation.
        texts = re.findall(r'base64,([^"]*)"', viewer.static_html().rsplit("new MeshCat.Viewer", 1)[1])
        kept = [umsgpack.unpackb(base64.b64decode(text)) for text in texts]
        drawn = {c["path"] for c in kept if c["type"] == "set_object"}
        assert "/meshcat/pincontact/contacts/rim|floor/trace" in drawn
        assert [c["type"] for c in kept].count("set_animation") == 1 and kept[-1]["type"] == "set_animation"
    finally:
        viewer.window.server_proc.kill()
        viewer.window.server_proc.communicate()


def test_names_with_slashes_stay_apart():
    drawing = Drawing(("meshcat",))
    paths = {drawing.path(name) for name in ("a/b", "a|b", "a|b'", "a")}
    assert len(paths) == 4
    assert drawing.path("a/b") == drawing.path("a/b") == "/meshcat/a|b"
    assert all(path.count("/") == 2 for path in paths)


# A run as users make it


@pytest.fixture(scope="module")
def rolled():
    """A leaning disk set rolling with some slip, 2 s: two runs of one motion, the second with many outputs."""
    scene = pc.Scene(wheel_model())
    rim, floor = scene.add_contour("rim", Circle(RADIUS), "disk"), scene.add_contour("floor", Plane())
    scene.add_contact(CONTACT, rim, floor, friction=pc.Coulomb(MU))
    rotation = pin.rpy.rpyToMatrix(0.5 * np.pi - 0.35, 0.0, 0.0)
    q = np.concatenate([[0.0, 0.0, RADIUS * np.cos(0.35)], pin.Quaternion(rotation).coeffs()])
    omega = rotation.T @ [0.0, 0.0, 1.2] + [0.0, 0.0, -4.0]
    velocity = np.cross(np.array([0.0, -RADIUS, 0.0]), omega) + np.array([0.6, 0.0, 0.0])
    v = np.concatenate([velocity, omega])
    state = scene.initial_state(q, v)
    sparse = pc.simulate(scene, state, 2.0, rtol=1e-8)
    return sparse, pc.simulate(scene, state, 2.0, rtol=1e-8, t_eval=np.linspace(0.0, 2.0, 61))


def test_frames_of_a_real_run_are_what_the_run_gives_there(rolled):
    sparse, dense = rolled
    assert np.diff(sparse.t).max() > 0.06
    frames = frames_at(sparse, dense.t)
    track = dense.contacts[CONTACT]
    # Steps of up to 0.1 s, half a radian of rolling: measured 9e-5 m, of the parameter's monotone cubic.
    assert frames.point == pytest.approx(track.point, abs=1e-3 * RADIUS)
    # The mode changes once, between two rows.
    assert (frames.mode != track.mode).sum() <= 1
    same = frames.mode == track.mode
    # measured 0.12 % of the weight, also of monotone cubics
    assert (frames.normal + frames.friction)[same] == pytest.approx(track.force[same], abs=0.005 * MASS * GRAVITY)
    # Along and across e_3 the two parts are those the track reports.
    assert np.linalg.norm(frames.friction[same], axis=1) == pytest.approx(
        track.tangential_force[same], abs=0.005 * MASS * GRAVITY
    )


def test_real_run_makes_a_page_and_plots(rolled, tmp_path, pyplot):
    run, _ = rolled
    text = pc.export_html(run, tmp_path / "run.html", follow="rim").read_text(encoding="utf-8")
    info = json.loads(re.search(r"^const info = (.*);$", text, re.M).group(1))
    assert [kind for _, _, kind in info["events"]] == [e.kind for e in run.events] == ["stick"]
    assert ("/meshcat/pincontact/contacts/rim|floor/trace/<object>", ".geometry[drawRange].count") in tracks_of(
        commands_of(text)
    )
    figure = run.plot()
    assert [ax.get_title() for ax in figure.axes] == list(plots.KINDS)
    figure.canvas.draw()


# What is missing


def test_missing_matplotlib_names_the_extra(run, monkeypatch):
    from pincontact.errors import MissingExtraError

    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"pip install pincontact\[plot\]"):
        plots.plot(run)


def test_missing_meshcat_is_said(run, monkeypatch, tmp_path):
    from pincontact.errors import MissingExtraError

    monkeypatch.setattr("pincontact.view.page.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match="meshcat"):
        export_html(run, tmp_path / "x.html")


# Arrows


def rotate(quaternion, vector):
    return pin.Quaternion(np.asarray(quaternion)).matrix() @ vector


def test_rotation_from_z_closed_forms():
    half = np.sqrt(0.5)
    directions = np.array([[0, 0, 1], [1, 0, 0], [0, -1, 0], [0, 0, -1]], dtype=float)
    expected = np.array([[0, 0, 0, 1], [0, half, 0, half], [half, 0, 0, half], [1, 0, 0, 0]])
    found = arrows.rotation_from_z(directions)
    # Up to the sign, which is chosen for continuity.
    for q, e in zip(found, expected):
        assert min(np.abs(q - e).max(), np.abs(q + e).max()) < 1e-15


def test_rotation_from_z_at_random_and_next_to_minus_z():
    rng = np.random.default_rng(7)
    directions = rng.normal(size=(200, 3))
    tilt = np.array([1e-3, 1e-7, 1e-9, 1e-12, 1e-30, 1e-170])
    near = np.column_stack([np.sin(tilt), 0.3 * np.sin(tilt), -np.cos(tilt)])
    directions = np.concatenate([directions, near])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    quaternions = arrows.rotation_from_z(directions)
    # Each a unit quaternion to a few roundings, with no loss of digits next to -z.
    assert np.linalg.norm(quaternions, axis=1) == pytest.approx(1.0, abs=4e-16)
    for q, d in zip(quaternions, directions):
        assert rotate(q, np.array([0.0, 0.0, 1.0])) == pytest.approx(d, abs=1e-15)
    products = np.einsum("ij,ij->i", quaternions[1:], quaternions[:-1])
    assert (products >= 0.0).all()


@pytest.mark.parametrize("length", [0.01, 0.15, 0.2, 0.7, 12.0])
def test_arrow_ends_where_the_vector_ends(length):
    head = 0.1
    direction = np.array([2.0, -1.0, 2.0]) / 3.0
    tail = np.array([[0.3, -0.2, 5.0]])
    arrow = arrows.place_arrow(tail, length * direction[None], head)
    tip = np.array([0.0, 0.0, arrow.head_position[0, 2] + arrow.head_scale[0, 2]])
    # round-off
    assert tail[0] + rotate(arrow.quaternion[0], tip) == pytest.approx(tail[0] + length * direction, rel=1e-14)
    # The shaft reaches exactly to the head.
    assert arrow.shaft_scale[0, 2] == pytest.approx(arrow.head_position[0, 2], rel=1e-14)
    # From twice the head's length on, the head keeps its size; below, all proportions are kept.
    size = head * min(1.0, length / (2.0 * head))
    assert arrow.head_scale[0] == pytest.approx(size * np.array([0.34, 0.34, 1.0]), rel=1e-14)
    assert arrow.shaft_scale[0, :2] == pytest.approx(0.13 * size, rel=1e-14)
    assert arrow.visible[0]


def test_vanishing_vector_hides_the_arrow_and_keeps_its_direction():
    vectors = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    arrow = arrows.place_arrow(np.zeros((4, 3)), vectors, 0.1)
    assert arrow.visible.tolist() == [False, True, False, True]
    assert rotate(arrow.quaternion[2], np.array([0.0, 0.0, 1.0])) == pytest.approx([1.0, 0.0, 0.0], abs=1e-15)
    # No scale is zero: its matrix would be singular.
    assert (arrow.shaft_scale > 0.0).all() and (arrow.head_scale > 0.0).all()


def test_arrows_show_the_force_on_the_moving_body(run):
    picture = compose(run, 30.0, 1.0, 3000, 0.01, None, ("forces",))
    tracks = tracks_of(unpacked(picture.commands(environment=False)))
    base = "/meshcat/pincontact/contacts/rim|floor/normal"
    quaternion = np.reshape(tracks[(base, ".quaternion")]["values"], (-1, 4))
    head = np.reshape(tracks[(base + "/head", ".position")]["values"], (-1, 3))
    scale = np.reshape(tracks[(base + "/head", ".scale")]["values"], (-1, 3))
    # The recorded force is on the floor, downwards; the arrow on the rim points up. float32.
    assert rotate(quaternion[30].astype(float), np.array([0.0, 0.0, 1.0])) == pytest.approx([0, 0, 1], abs=1e-6)
    assert head[30, 2] + scale[30, 2] == pytest.approx(0.01 * MASS * GRAVITY, rel=1e-6)


def test_fitting_scale_ignores_one_impact(run):
    contacts = {CONTACT: frames_at(run, np.linspace(0.0, END, 91))}
    usual = fitting_force_scale(contacts, 0.3)
    largest = np.hypot(MASS * GRAVITY, MU * MASS * GRAVITY)
    # The percentile falls among the frames of slip, which the interpolation bends by some 1e-7 next to its end.
    assert usual == pytest.approx(0.9 * 0.3 / largest, rel=1e-5)
    contacts[CONTACT].normal[40] *= 1000.0
    assert fitting_force_scale(contacts, 0.3) == pytest.approx(usual, rel=1e-5)


# Splitting forces


def test_split_force_by_pattern():
    frame = np.array([[[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]]]).transpose(0, 2, 1)
    track = SimpleNamespace(force=np.array([[3.0, -2.0, 7.0]]), frame=frame)
    normal, friction = split_force(SimpleNamespace(pattern=PATTERNS["3C-S"]), track)
    # e_1 and e_2 are oblique; the split does not depend on them.
    assert normal.tolist() == [[0.0, 0.0, 7.0]] and friction.tolist() == [[3.0, -2.0, 0.0]]
    # A bead on a wire: all that is not along the wire is normal.
    normal, friction = split_force(SimpleNamespace(pattern=PATTERNS["P-3C"]), track)
    assert normal.tolist() == [[0.0, -2.0, 7.0]] and friction.tolist() == [[3.0, 0.0, 0.0]]


# Resampling


def test_frame_times_rate_ends_and_cap():
    t = np.array([1.0, 1.7, 4.0])
    times = frame_times(t, 30.0, 1.0, 3000)
    assert len(times) == 91 and times[0] == 1.0 and times[-1] == 4.0
    assert len(frame_times(t, 30.0, 3.0, 3000)) == 31
    assert len(frame_times(t, 30.0, 0.1, 3000)) == 901
    capped = frame_times(np.array([0.0, 1e5]), 60.0, 1.0, 500)
    assert len(capped) == 500 and capped[-1] == 1e5
    # A run of one row, or of no length, still makes a picture.
    assert frame_times(np.array([2.0]), 30.0, 1.0, 10).tolist() == [2.0, 2.0]
    with pytest.raises(ArgumentError, match="no recorded time"):
        frame_times(np.zeros(0), 30.0, 1.0, 10)


def test_a_run_of_one_row_makes_a_page(tmp_path):
    run = fake_run(rows=2)
    track = run.contacts[CONTACT].arrays()
    first = pc.ContactTrack(**{key: value[:1] for key, value in track.items()})
    still = changed(run, t=run.t[:1], q=run.q[:1], v=run.v[:1], contacts={CONTACT: first})
    commands = commands_of(export_html(still, tmp_path / "x.html").read_text(encoding="utf-8"))
    for track in tracks_of(commands).values():
        assert np.all(np.diff(np.asarray(track["times"])) > 0.0)


def test_intervals_take_the_later_row_of_a_repeated_time():
    t = np.array([0.0, 1.0, 1.0, 2.0])
    assert intervals(t, np.array([0.0, 0.5, 1.0, 1.5, 2.0])).tolist() == [0, 0, 2, 2, 2]


def test_motion_is_fourth_order_and_meets_the_rows():
    errors = []
    for rows in (31, 61, 121):
        run = fake_run(rows)
        times = np.linspace(0.05, 1.95, 77)
        q = configurations(run, times)
        found = joint_placements(run.scene.model, q)[:, 1]
        gaps = [np.linalg.norm(pin.log6(placement(x).inverse() * pin.SE3(m)).vector) for x, m in zip(times, found)]
        errors.append(max(gaps))
        at_rows = configurations(run, run.t)
        # round-off of one difference and one integrate
        assert max(np.abs(pin.difference(run.scene.model, a, b)).max() for a, b in zip(at_rows, run.q)) < 1e-13
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # Nominal order 4; the coarsest pair is within a fifth of it.
    assert (orders > 3.8).all(), (errors, orders)


def test_motion_falls_back_to_the_shortest_path_across_an_impact():
    model = pin.Model()
    model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slide")
    # Down at 3 m/s, up at 3 m/s, next to no way in between: the cubic would dive by 0.75 m.
    motion = Motion(model, np.array([0.0, 1.0]), np.array([[0.2], [0.3]]), np.array([[-3.0], [3.0]]))
    # exact up to rounding
    assert motion(0.5, 0) == pytest.approx([0.25], abs=1e-15)


def test_contact_frames_keep_phases_apart(run):
    times = np.linspace(0.0, END, 1201)
    frames = frames_at(run, times)
    free = (times >= HOP_START) & (times < HOP_END)
    # At a border of phases the mode is that of the row before.
    inside = (np.abs(times - HOP_START) > 0.026) & (np.abs(times - HOP_END) > 0.026)
    assert ((frames.mode == FREE) == free)[inside].all()
    assert (frames.normal[frames.mode == FREE] == 0.0).all() and (frames.friction[frames.mode == FREE] == 0.0).all()
    assert np.isfinite(frames.point).all()
    # Never more or less than recorded: nothing leaks in from the free phase. A few roundings of the interpolant.
    touching = frames.touching
    assert frames.normal[touching, 2] == pytest.approx(-MASS * GRAVITY, rel=1e-14)
    recorded = run.contacts[CONTACT].force[:, :2]
    friction = frames.friction[touching][:, :2]
    assert (friction <= recorded.max(axis=0) + 1e-13).all() and (friction >= recorded.min(axis=0) - 1e-13).all()
    # The wheel rolls evenly, so the parameter is interpolated to round-off and the wheel itself to 3e-6 m. The wheel's
    # cubic meets a kink at the hop.
    compared = touching & inside
    assert frames.point[compared] == pytest.approx(point(times[compared]), abs=3e-6)


def test_points_lie_on_the_contour_however_far_apart_the_rows_are():
    # 0.3 s between rows: the wheel rolls by 0.9 rad in between.
    run = fake_run(rows=11)
    times = np.linspace(0.0, 1.5, 151)
    q = configurations(run, times)
    points = contact_frames(run, CONTACT, times, q, joint_placements(run.scene.model, q)).point
    for where, placed in zip(points, q):
        local = pin.XYZQUATToSE3(placed).actInv(where)
        # round-off
        assert np.hypot(local[0], local[1]) == pytest.approx(RADIUS, rel=1e-13) and abs(local[2]) < 1e-13


def test_a_contact_that_never_closes_shows_nothing(run, tmp_path):
    empty = {
        key: np.full_like(value, np.nan)
        for key, value in run.contacts[CONTACT].arrays().items()
        if value.dtype == float
    }
    track = replace(run.contacts[CONTACT], **empty, mode=np.full(len(run.t), FREE))
    track = replace(track, force=np.zeros_like(track.force))
    other = changed(run, contacts={CONTACT: track})
    commands = commands_of(export_html(other, tmp_path / "x.html").read_text(encoding="utf-8"))
    assert not [path for path, _ in tracks_of(commands) if "normal" in path or "trace" in path]
    for track in tracks_of(commands).values():
        assert np.isfinite(track["values"]).all()


# Meshes


def is_closed(mesh):
    """Every edge, by position, is used once in each direction."""
    keys = np.round(mesh.vertices, 9) + 0.0
    _, names = np.unique(keys, axis=0, return_inverse=True)
    faces = names.reshape(-1)[mesh.faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).tolist()
    forward = sorted(map(tuple, edges))
    return forward == sorted((b, a) for a, b in edges) and len(set(forward)) == len(forward)


def volume(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0


RING = np.column_stack([np.cos(np.arange(80) * np.pi / 40), np.sin(np.arange(80) * np.pi / 40), np.zeros(80)])


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (meshes.sphere(0.5, 80), np.pi / 6.0),
        (arrows.unit_shaft(), np.pi),
        (arrows.unit_head(), np.pi / 3.0),
        (meshes.tube(RING, 0.1, True, 40), 2.0 * np.pi**2 * 0.01),
    ],
)
def test_closed_shapes_have_their_volume_and_outward_normals(mesh, expected):
    assert is_closed(mesh)
    # A polygon of 20 (shaft) or 28 (head) sides lacks 1.6 % or 0.8 % of its circle; the others under 0.6 %.
    assert volume(mesh) == pytest.approx(expected, rel=0.02)
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0, abs=1e-12)
    corners = mesh.vertices[mesh.faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(face_normals, axis=1)
    solid = area > 1e-12
    agreement = np.einsum("ij,ij->i", face_normals, mesh.normals[mesh.faces].mean(axis=1))[solid] / area[solid]
    assert agreement.min() > 0.5


def test_closed_tube_of_a_twisted_curve_meets_itself():
    u = np.linspace(0.0, 2.0 * np.pi, 161)[:-1]
    knot = np.column_stack([np.sin(u) + 2 * np.sin(2 * u), np.cos(u) - 2 * np.cos(2 * u), -np.sin(3 * u)])
    mesh = meshes.tube(knot, 0.2, True, 12)
    assert is_closed(mesh)
    rows = mesh.vertices.reshape(161, 13, 3)
    # The last ring is the first one again, vertex by vertex: the transport's twist has been taken out.
    assert rows[-1] == pytest.approx(rows[0], abs=2e-2)


def test_simplify_keeps_within_the_tolerance_and_drops_rest():
    t = np.linspace(0.0, 6.0, 2000)
    path = np.column_stack([np.cos(t), np.sin(t), 0.1 * t])
    kept = meshes.simplify(path, 1e-3, 10.0)
    assert kept[0] == 0 and len(kept) < 200
    for a, b in pairwise(kept):
        chord = path[b] - path[a]
        offset = path[a : b + 1] - path[a]
        across = offset - np.outer(np.clip(offset @ chord / (chord @ chord), 0.0, 1.0), chord)
        assert np.linalg.norm(across, axis=1).max() <= 1e-3
    line = np.column_stack([np.linspace(0.0, 1.0, 101), np.zeros(101), np.zeros(101)])
    assert len(meshes.simplify(line, 1e-3, 10.0)) == 2
    # No chord longer than asked: ten of them.
    assert len(meshes.simplify(line, 1e-3, 0.1 + 1e-9)) == 11
    assert meshes.simplify(np.zeros((50, 3)), 1e-3, 1.0).tolist() == [0]
    there_and_back = np.concatenate([line, line[::-1]])
    assert 100 in meshes.simplify(there_and_back, 1e-3, 10.0) or 101 in meshes.simplify(there_and_back, 1e-3, 10.0)


def test_surface_samples_lie_on_the_surface_with_its_normals():
    sphere = Sphere(0.7)
    points, normals = meshes.sample_surface(sphere, np.array(sphere.domain), (13, 9))
    # round-off, and at the poles the normal from 1e-4 of the way inside
    assert np.linalg.norm(points, axis=2) == pytest.approx(0.7, abs=1e-15)
    assert normals == pytest.approx(points / 0.7, abs=3e-4)
    assert normals[:, 1:-1] == pytest.approx(points[:, 1:-1] / 0.7, abs=1e-14)


def test_unbounded_contours_are_cut_around_the_motion():
    centre, radius = np.array([40.0, -3.0, 0.0]), 2.0
    low, high = meshes.drawn_domain(Line(), np.array([40.0, 0.0, 0.0]), radius)[0]
    # The border is found to a step of 64 or 32 over the width, never too narrow.
    assert 37.9 < low <= 38.0 and 42.0 <= high < 42.1
    domain = meshes.drawn_domain(Plane(), centre, radius)
    assert (domain[:, 0] <= centre[:2] - radius).all() and (domain[:, 1] >= centre[:2] + radius).all()
    assert domain[:, 1] - domain[:, 0] == pytest.approx(2.0 * radius, rel=0.15)
    # However far away and however small.
    domain = meshes.drawn_domain(Plane(), np.array([5e3, 5e3, 0.0]), 0.01)
    assert domain[:, 1] - domain[:, 0] == pytest.approx(0.02, rel=0.15)
    # A bounded one is drawn whole.
    assert meshes.drawn_domain(Circle(0.3), centre, radius).tolist() == [[-np.pi, np.pi]]


def test_tile_size_is_round():
    assert [tile_size(x) for x in (0.3, 0.05, 7.0, 1.0, 19.0)] == pytest.approx([0.2, 0.05, 5.0, 1.0, 10.0])


def test_visuals_are_drawn_below_their_joint(run, tmp_path):
    import coal

    visual = pin.GeometryModel()
    pose = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([0.1, 0.2, 0.3]))
    box = pin.GeometryObject("hub", 1, pose, coal.Box(0.1, 0.1, 0.1))
    box.meshColor = np.array([1.0, 0.5, 0.0, 0.5])
    visual.addGeometryObject(box)
    visual.addGeometryObject(pin.GeometryObject("ground", 0, pin.SE3.Identity(), coal.Halfspace()))
    robot = changed(run, scene=changed(run.scene, visual_model=visual))
    text = export_html(robot, tmp_path / "x.html").read_text(encoding="utf-8")
    commands = commands_of(text)
    path = "/meshcat/pincontact/bodies/root/visuals/hub"
    (made,) = (c for c in commands if c["type"] == "set_object" and c["path"] == path)
    material = made["object"]["materials"][0]
    assert material["color"] == 0xFF7F00 and material["opacity"] == 0.5 and material["transparent"]
    (placed,) = (c for c in commands if c["type"] == "set_transform" and c["path"] == path)
    matrix = np.reshape(placed["matrix"], (4, 4)).T
    assert matrix == pytest.approx(pose.homogeneous, abs=1e-15)
    # Pinocchio draws a half space as a large square.
    assert "/meshcat/pincontact/bodies/universe/visuals/ground" in {c["path"] for c in commands}
    # A body with a picture of its own keeps its contour's curve, without a disc.
    drawn = {c["path"] for c in commands if c["type"] == "set_object"}
    assert "/meshcat/pincontact/bodies/root/contours/rim/curve" in drawn
    assert "/meshcat/pincontact/bodies/root/contours/rim/disc" not in drawn


def test_scene_size_follows_what_moves(run):
    times = np.linspace(0.0, END, 10)
    q = configurations(run, times)
    placements = joint_placements(run.scene.model, q)
    contacts = {CONTACT: contact_frames(run, CONTACT, times, q, placements)}
    assert scene_size(run.scene, placements, contacts) == RADIUS


# Contours


def test_driven_contour_moves_on_its_body():
    pose = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.0, 0.1), np.array([0.1, 0.0, 0.2]))
    motion = HarmonicMotion((0.0, 0.0, 0.2), frequency=0.5, axis=(1.0, 0.0, 0.0), angle=0.4)
    other = fake_run()
    other.scene.add_contour("plate", Circle(0.2), "disk", pose, motion)
    picture = compose(other, 30.0, 1.0, 3000, None, None, ("contours",))
    tracks = tracks_of(unpacked(picture.commands(environment=False)))
    path = "/meshcat/pincontact/bodies/root/contours/plate"
    where = np.reshape(tracks[(path, ".position")]["values"], (-1, 3))
    turned = np.reshape(tracks[(path, ".quaternion")]["values"], (-1, 4)).astype(float)
    for frame in (0, 17, 45):
        expected = pose * motion.placement(picture.times[frame])
        # float32 in the tracks
        assert where[frame] == pytest.approx(expected.translation, abs=1e-7)
        assert rotate(turned[frame], np.eye(3)) == pytest.approx(expected.rotation, abs=1e-6)


def test_contour_that_depends_on_time_is_shown_one_shape_at_a_time():
    wave = ParametricSurface(lambda a, b, t: (a, b, 0.1 * np.sin(4 * a - 3 * t)), ((-0.5, 0.5), (-0.5, 0.5)))
    other = fake_run()
    other.scene.add_contour("wave", wave)
    picture = compose(other, 30.0, 1.0, 3000, None, None, ("contours",))
    commands = unpacked(picture.commands(environment=False))
    tracks = {
        path: track for (path, name), track in tracks_of(commands).items() if "/wave/" in path and name == ".visible"
    }
    assert len(tracks) > 20
    for time in picture.times:
        # A frame's time as the page has it, in float32.
        at = np.float32(time)
        shown = [
            path
            for path, track in tracks.items()
            if track["values"][np.searchsorted(np.asarray(track["times"]), at, side="right") - 1]
        ]
        assert len(shown) == 1
    (mesh,) = (c["object"] for c in commands if c["path"] == f"{shown[0]}/surface" and c["type"] == "set_object")
    data = mesh["geometries"][0]["data"]["attributes"]["position"]["array"]
    x, _, z = np.reshape(data, (-1, 3)).T.astype(float)
    # The last shape stands for the last two frames or fewer of 1/30 s; it moves at up to 0.3 m/s.
    assert z == pytest.approx(0.1 * np.sin(4 * x - 3 * END), abs=0.3 * 2 / 30 + 1e-6)


def test_wire_is_not_filled_and_hollow_world_is_seen_through(run):
    other = fake_run()
    scene = other.scene
    scene.add_contour("wire", Circle(0.5), "disk")
    scene.add_contour("bead", Point())
    scene.add_contour("bowl", Sphere(2.0))
    scene.add_contact("on wire", "bead", "wire")
    track = replace(run.contacts[CONTACT], location=run.contacts[CONTACT].location[:, :1])
    other.contacts = {**run.contacts, "on wire": track}
    commands = compose(other, 30.0, 1.0, 3000, None, None, ("contours",)).commands(environment=False)
    made = {c["path"]: c["object"] for c in commands if c["type"] == "set_object"}
    body = "/meshcat/pincontact/bodies/"
    assert f"{body}root/contours/rim/disc" in made
    assert f"{body}root/contours/wire/curve" in made and f"{body}root/contours/wire/disc" not in made
    assert made[f"{body}universe/contours/bowl/surface"]["materials"][0]["opacity"] < 1.0
    assert made[f"{body}universe/contours/floor/surface"]["materials"][0]["opacity"] == 1.0


def test_floor_fields_are_aligned_to_the_world(run):
    commands = unpacked(compose(run, 30.0, 1.0, 3000, None, None, ("contours",)).commands(environment=False))
    path = "/meshcat/pincontact/bodies/universe/contours/floor/surface"
    (mesh,) = (c["object"] for c in commands if c["type"] == "set_object" and c["path"] == path)
    data = mesh["geometries"][0]["data"]["attributes"]
    points = np.reshape(data["position"]["array"], (-1, 3)).astype(float)
    colors = np.reshape(data["color"]["array"], (-1, 3))
    edge = tile_size(0.7 * RADIUS)
    # float32 in the page
    assert np.abs(points[:, :2] / edge - np.rint(points[:, :2] / edge)).max() < 1e-5
    assert (points[:, 2] == 0.0).all()
    # The field next to the origin in the first quadrant is light, wherever the floor begins.
    fields = points.reshape(-1, 4, 3).mean(axis=1)
    (origin,) = np.flatnonzero(np.linalg.norm(fields - (0.5 * edge, 0.5 * edge, 0.0), axis=1) < 1e-5)
    assert colors[4 * origin].tolist() == colors.max(axis=0).tolist()
    # The floor reaches under all of the path.
    assert points[:, 0].min() < -TURN and points[:, 0].max() > TURN and points[:, 1].max() > TURN


def test_smooth_polyline_turns_little_and_keeps_its_ends():
    helix = Helix(0.5, 0.1)
    domain = np.array([[-30.0, 30.0]])
    points = meshes.smooth_polyline(helix, domain, 0.5)
    assert points[[0, -1]] == pytest.approx(np.array([helix.point(-30.0), helix.point(30.0)]), abs=1e-15)
    # Neighbours turn by 0.12 rad at most, so chords come within R 0.12^2 / 8 of the helix; dropped points add 5e-4 of
    # the size.
    middle = 0.5 * (points[1:] + points[:-1])
    assert (0.5 - np.hypot(middle[:, 0], middle[:, 1])).max() < 0.5 * 0.12**2 / 8 + 2.5e-4


# Plots


def lines(ax):
    return {line.get_label(): np.asarray(line.get_ydata(), dtype=float) for line in ax.get_lines()}


def test_plot_draws_every_kind(run, pyplot):
    figure = plots.plot(run)
    assert [ax.get_title() for ax in figure.axes] == list(plots.KINDS)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure.canvas.draw()


def test_forces_show_the_limit(run, pyplot):
    shown = lines(plots.forces(run, CONTACT))
    assert (shown["normal"] == run.contacts[CONTACT].normal_force).all()
    assert (shown["friction"] == run.contacts[CONTACT].tangential_force).all()
    assert (shown["friction limit"] == MU * run.contacts[CONTACT].normal_force).all()


def test_limit_depends_on_mode_and_law(run):
    scene = SimpleNamespace(contacts={CONTACT: SimpleNamespace(friction=pc.Coulomb(0.3, 0.5))})
    other = SimpleNamespace(scene=scene, contacts=run.contacts)
    ratio = plots.limit(other, CONTACT) / (MASS * GRAVITY)
    # slipping, sticking: exact up to one rounding
    assert ratio[10] == pytest.approx(0.3, rel=1e-15) and ratio[60] == pytest.approx(0.5, rel=1e-15)
    # no law, none that binds, none that is a single number
    for law in (None, pc.NoSlip(), pc.Coulomb((0.3, 0.5))):
        scene.contacts[CONTACT].friction = law
        assert plots.limit(other, CONTACT) is None
    scene.contacts[CONTACT].friction = law = pc.Stribeck(0.3, 0.5, 0.1)
    speed = np.linalg.norm(run.contacts[CONTACT].slip_velocity[10])
    assert plots.limit(other, CONTACT)[10] == pytest.approx(law.coefficient(speed) * MASS * GRAVITY, rel=1e-15)


def test_cone_has_its_edge_and_colours_by_mode(run, pyplot):
    ax = plots.friction_cone(run)
    by_label = {line.get_label(): line for line in ax.get_lines()}
    x, y = by_label["mu = 0.4"].get_data()
    assert y[1] / x[1] == MU
    assert by_label["stick"].get_color() == MODE_COLORS[STICK]
    assert len(by_label["slip"].get_xdata()) == (run.t < SLIP_END).sum()
    assert (by_label["stick"].get_ydata() == MASS * SPEED**2 / TURN).all()


def test_slip_has_one_band_a_phase(run, pyplot):
    ax = plots.slip(run, CONTACT)
    bands = [(p.get_x(), p.get_x() + p.get_width()) for p in ax.patches]
    # The phases meet, at the rows where the mode changes (rows 0.025 s apart).
    edges = np.array([0.0, SLIP_END, HOP_START, HOP_END, END])
    assert np.array(bands) == pytest.approx(np.column_stack([edges[:-1], edges[1:]]), abs=1e-12)


def test_single_plots_draw_into_given_axes(run, pyplot):
    _, ax = pyplot.subplots()
    for function in plots.KINDS.values():
        assert function(run, ax=ax) is ax
    figure, grid = pyplot.subplots(1, 2)
    assert plots.plot(run, ["energy", "motion"], axes=grid) is figure
    assert [ax.get_title() for ax in grid] == ["energy", "motion"]
    assert set(lines(plots.location(run))) == {"rim u1", "floor u1", "floor u2"}
    assert set(lines(grid[0])) == {"kinetic", "potential", "total", "friction work"}


def test_motion_is_plotted_as_lengths_and_angles(pyplot):
    model = pin.Model()
    joints = {
        "free": pin.JointModelFreeFlyer(),
        "ball": pin.JointModelSpherical(),
        "flat": pin.JointModelPlanar(),
        "wheel": pin.JointModelRUBX(),
        "slide": pin.JointModelTranslation(),
        "hinge": pin.JointModelRX(),
    }
    for name, joint in joints.items():
        model.addJoint(0, joint, pin.SE3.Identity(), name)
    t = np.linspace(0.0, 2.0, 81)
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    # each turns by 5 rad a second, so more than once
    turns = [pin.Quaternion(pin.exp3(5.0 * time * axis)).coeffs() for time in t]
    flip = [(-1) ** k * turn for k, turn in enumerate(turns)]
    pair = np.column_stack([np.cos(5.0 * t), np.sin(5.0 * t)])
    q = np.column_stack([t, 2 * t, 3 * t, turns, flip, t, -t, pair, pair, t, t * t, 4 * t, 0.5 * t])
    v = np.tile(np.arange(model.nv), (len(t), 1))
    moved = SimpleNamespace(t=t, q=q, v=v, scene=SimpleNamespace(model=model))
    drawn = {line.get_label(): line.get_ydata() for line in plots.motion(moved).lines}
    expected = {f"free {name}": k * t for name, k in zip("xyz", (1, 2, 3))}
    for joint in ("free", "ball"):
        expected |= {f"{joint} rotation vector {name}": 5.0 * t * axis[k] for k, name in enumerate("xyz")}
    expected |= {"flat x": t, "flat y": -t, "flat angle": 5.0 * t, "wheel": 5.0 * t, "hinge": 0.5 * t}
    expected |= {"slide.0": t, "slide.1": t * t, "slide.2": 4 * t}
    assert drawn.keys() == expected.keys()
    for name, values in expected.items():
        # round-off of logarithms near half turns
        assert drawn[name] == pytest.approx(values, abs=1e-7), name
    rates = [line.get_label() for line in plots.motion(moved, velocities=True).lines]
    assert rates[:6] == ["free.vx", "free.vy", "free.vz", "free.wx", "free.wy", "free.wz"] and rates[-1] == "hinge"


def test_plot_arguments(run, pyplot):
    with pytest.raises(ArgumentError, match="unknown kind of plot 'power'"):
        plots.plot(run, ["power"])
    with pytest.raises(ArgumentError, match="no contact 'hub'; it has 'rim/floor'"):
        plots.slip(run, "hub")
    with pytest.raises(ArgumentError, match="2 kinds of plot need as many axes, got 1"):
        plots.plot(run, ["energy", "motion"], axes=pyplot.subplots()[1])
    with pytest.raises(ArgumentError, match="empty"):
        plots.plot(run, [])


def test_a_fingertip_that_no_visual_covers_is_drawn(run):
    import coal

    def surfaces(radius):
        visual = pin.GeometryModel()
        visual.addGeometryObject(pin.GeometryObject("hub", 1, pin.SE3.Identity(), coal.Sphere(radius)))
        scene = pc.Scene(run.scene.model, visual)
        tip = scene.add_contour("tip", Sphere(0.3), "disk")
        scene.add_contact("tip", tip, scene.add_contour("ground", pc.Plane()), friction=pc.NoSlip())
        rolling = pc.simulate(scene, scene.initial_state(np.r_[0, 0, 0.3, 0, 0, 0, 1.0]), 0.1)
        commands = compose(rolling, 30.0, 1.0, 3000, None, None, PARTS).commands(environment=False)
        return {c["path"] for c in commands if c["type"] == "set_object" and "/contours/" in c["path"]}

    tip = "/meshcat/pincontact/bodies/root/contours/tip/surface"
    assert tip in surfaces(0.2)
    # the body's own sphere is where the contour is: one picture of it is enough
    assert tip not in surfaces(0.3)


def test_camera_sees_all_and_no_more_than_that():
    rng = np.random.default_rng(5)
    centres, radii = rng.normal(size=(40, 3)) * [3.0, 1.0, 0.5], rng.uniform(0.0, 0.3, 40)
    distance = fitting_distance(centres, radii)
    view = np.array([0.506, -0.759, 0.409])
    view /= np.linalg.norm(view)
    right = np.cross([0.0, 0.0, 1.0], view)
    right /= np.linalg.norm(right)
    depth = distance - centres @ view
    slope = np.tan(np.radians(20.0))
    across = (np.abs(centres @ right) + radii) / (1.3 * slope * depth)
    along = (np.abs(centres @ np.cross(view, right)) + radii) / (0.8 * slope * depth)
    # one ball touches the edge of the picture
    assert max(across.max(), along.max()) == pytest.approx(1.0, rel=1e-12)


def test_several_contacts_have_a_strip_of_modes_each_and_one_legend_of_styles(run, pyplot):
    both = changed(run, contacts={CONTACT: run.contacts[CONTACT], "other": run.contacts[CONTACT]})
    both.scene = changed(run.scene, contacts={name: run.scene.contacts[CONTACT] for name in both.contacts})
    ax = plots.slip(both)
    (strips,) = ax.child_axes
    assert len(strips.patches) == 8 and not ax.patches
    assert [label.get_text() for label in strips.get_yticklabels()] == [CONTACT, "other"]
    labels = plots.forces(both).get_legend_handles_labels()[1]
    assert labels == [CONTACT, "other", "normal", "friction", "friction limit"]


def test_a_contact_has_one_colour_everywhere(run, pyplot):
    both = changed(run, contacts={"other": run.contacts[CONTACT], CONTACT: run.contacts[CONTACT]})
    both.scene = changed(run.scene, contacts={name: run.scene.contacts[CONTACT] for name in both.contacts})
    for kind in (plots.forces, plots.slip, plots.location):
        (alone,) = {line.get_color() for line in kind(both, CONTACT).get_lines()}
        assert alone == contact_color(1) != contact_color(0)
    assert plots.slip(both).child_axes[0].get_yticklabels()[1].get_color() == contact_color(1)
    info = page_info(compose(both, 30.0, 1.0, 3000, None, None, ()), both, 1.0)
    assert [contact["color"] for contact in info["contacts"]] == [contact_color(0), contact_color(1)]


def repeated(run, count):
    """A run of so many contacts, all the same."""
    names = [f"contact {number}" for number in range(count)]
    scene = changed(run.scene, contacts=dict.fromkeys(names, run.scene.contacts[CONTACT]))
    return changed(run, scene=scene, contacts=dict.fromkeys(names, run.contacts[CONTACT]))


@pytest.mark.parametrize("count", [1, 8])
def test_legends_cover_nothing(run, pyplot, count):
    figure = plots.plot(repeated(run, count))
    figure.canvas.draw()
    # with labels, titles and strips, but without what legends add
    boxes = [ax.get_window_extent() for ax in figure.axes] + [
        text.get_window_extent() for ax in figure.axes for text in (ax.title, ax.xaxis.label, ax.yaxis.label)
    ]
    legends = [ax.get_legend().get_window_extent() for ax in figure.axes if ax.get_legend() is not None]
    assert len(legends) == len(plots.KINDS)
    for number, legend in enumerate(legends):
        assert not any(legend.overlaps(box) for box in [*boxes, *legends[:number]])
        assert figure.bbox.x0 <= legend.x0 and legend.x1 <= figure.bbox.x1


def test_modes_of_eight_contacts_are_readable(run, pyplot):
    ax = plots.slip(repeated(run, 8))
    ax.figure.canvas.draw()
    (strips,) = ax.child_axes
    names = [label.get_window_extent() for label in strips.get_yticklabels()]
    assert len(names) == 8 and len(strips.patches) == 32
    for above, below in pairwise(names):
        assert above.y0 >= below.y1
    # four phases of each, at eight heights
    assert len({round(patch.get_y(), 6) for patch in strips.patches}) == 8
    # a strip is some points high, and above the plot
    assert strips.get_window_extent().height / 8 > 10.0 and strips.get_window_extent().y0 > ax.get_window_extent().y1


def test_residuals_are_written_out(rolled, pyplot):
    run, _ = rolled
    written = {
        "C1": "C1: distance of the points",
        "C2": "C2: tangents out of the plane",
        "GC": "GC: gap (geometric constraint)",
        "VC": "VC: slip (velocity constraint)",
    }
    shown, residuals = lines(plots.residuals(run)), run.residuals()
    assert list(shown) == [written[name] for name in residuals] and residuals.keys() == written.keys()
    for name, label in written.items():
        seen = np.isfinite(shown[label])
        np.testing.assert_array_equal(shown[label][seen], residuals[name][seen])
        assert (residuals[name][~seen] == 0.0).all()


def test_a_page_stores_equal_objects_once():
    shape = {"type": "set_object", "object": {"data": "x" * 1000}}
    places, packed = pack_commands([{"path": name, **shape} for name in ("/a", "/b")])
    data = gzip.decompress(packed)
    found = [umsgpack.unpackb(b"".join(data[a:b] for a, b in zip(p[::2], p[1::2]))) for p in places]
    assert found == [{"path": name, **shape} for name in ("/a", "/b")]
    assert len(data) < 1200


def test_contact_point_is_where_the_bodies_touch_however_far_apart_the_rows_are():
    # A ball rolls 10 rad in 4 rows: interpolated parameters would lie up to a radius above the table.
    scene = pc.Scene(wheel_model())
    scene.add_contact(CONTACT, scene.add_contour("ball", Sphere(0.3), "disk"), scene.add_contour("floor", Plane()))
    state = scene.initial_state([0, 0, 0.3, 0, 0, 0, 1], [0, 3.0, 0, -10.0, 0, 0])
    run = pc.simulate(scene, state, 1.0, t_eval=np.linspace(0.0, 1.0, 5))
    times = np.linspace(0.0, 1.0, 60)
    found = frames_at(run, times)
    assert found.point[:, 2] == pytest.approx(0.0, abs=1e-12)
    assert found.point[:, :2] == pytest.approx(np.column_stack([0 * times, 3.0 * times]), abs=1e-9)


def test_traces_are_as_smooth_as_the_motion(monkeypatch):
    # a ball rolls and spins about the vertical, 40 rad/s each: its contact point goes round it within few of its frames
    scene = pc.Scene.from_urdf(Path(__file__).parent.parent / "urdf" / "ball.urdf", floating_base=True)
    ball, floor = scene.add_contour("ball", Sphere(0.1), "ball"), scene.add_contour("floor", Plane())
    scene.add_contact("c", ball, floor, pc.NoSlip())
    run = pc.simulate(scene, scene.initial_state([0, 0, 0.1, 0, 0, 0, 1], [4.0, 0, 0, 0, 40.0, 40.0]), 1.0)
    drawn = []
    monkeypatch.setattr(meshes, "tube", lambda points, *_: drawn.append(points) or meshes.sphere(1.0))
    compose(run, 30.0, 1.0, 3000, None, None, ("traces",))
    assert len(drawn) == 2
    for points in drawn:
        steps = np.diff(points, axis=0)
        steps /= np.linalg.norm(steps, axis=1)[:, None]
        turns = np.arccos(np.clip(np.einsum("ij,ij->i", steps[1:], steps[:-1]), -1.0, 1.0))
        # a turn of the body by a tenth of a radian between samples, and what `simplify` leaves out
        assert turns.max() < 0.3
    # rolling, the ways on both bodies are equally long
    assert [np.linalg.norm(np.diff(points, axis=0), axis=1).sum() for points in drawn] == pytest.approx(
        [4.0, 4.0], rel=0.01
    )


def test_location_is_broken_where_the_chart_changes(run, pyplot):
    track = run.contacts[CONTACT]
    charts = track.charts.copy()
    charts[30:] = 1
    moved = changed(run, contacts={CONTACT: replace(track, charts=charts)})
    whole, broken = (lines(plots.location(r))["floor u1"] for r in (run, moved))
    assert np.isfinite(whole[30]) and np.isnan(broken[30])
    whole[30] = np.nan
    assert np.array_equal(whole, broken, equal_nan=True)


def test_a_scaled_mesh_from_triangles_is_scaled_once():
    # meshcat cannot merge the parts of this Collada file, so its triangles are drawn, which Pinocchio has scaled.
    urdf = Path(__file__).parent.parent / "urdf" / "cart.urdf"
    (given,) = (g for g in pc.Scene.from_urdf(urdf).visual_model.geometryObjects if g.name == "cart_1")
    import coal

    scale = np.array([0.5, -2.0, 1.0])
    shape = coal.MeshLoader().load(given.meshPath, scale)
    visual = pin.GeometryModel()
    visual.addGeometryObject(
        pin.GeometryObject("mast", 0, 0, pin.SE3.Identity(), shape, given.meshPath, scale, True, np.ones(4))
    )
    drawing = Drawing()
    draw_robot(drawing, pin.Model(), visual, lambda item: "/mast")
    (made,) = (c for c in drawing.commands if c["type"] == "set_object")
    (placed,) = (c for c in drawing.commands if c["type"] == "set_transform")
    (geometry,) = made["object"]["geometries"]
    position = unpacked([{"x": geometry["data"]["attributes"]["position"]["array"]}])[0]["x"].reshape(-1, 3)
    drawn = position @ np.reshape(placed["matrix"], (4, 4))[:3, :3]
    # float32
    assert drawn == pytest.approx(shape.vertices(), abs=1e-6)


COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>{asset}</asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="9">1 2 3 4 5 6 7 8 10</float_array><technique_common>
<accessor source="#pa" count="3" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh></geometry>
</library_geometries><library_visual_scenes><visual_scene id="w"><node>{node}</node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#w"/></scene></COLLADA>"""
PART = '<instance_geometry url="#g"/>'


@pytest.mark.parametrize("node", [PART, f"<node>{PART}</node>"], ids=["merged by meshcat", "triangles"])
@pytest.mark.parametrize(
    ("asset", "seen"),
    [
        ("", (1, 2, 3)),
        ("<up_axis>Z_UP</up_axis>", (1, 2, 3)),
        # "Y_UP: right x, up y, in z; Z_UP: right x, up z, in -y" (Collada 1.4.1, sec. up_axis); X_UP: -y, x, z
        ("<up_axis>Y_UP</up_axis>", (1, -3, 2)),
        ("<up_axis>X_UP</up_axis>", (-2, -3, 1)),
        (
            "<contributor><authoring_tool>VCGLib | MeshLab</authoring_tool></contributor><up_axis>Y_UP</up_axis>",
            (1, 2, 3),
        ),
    ],
    ids=["unsaid", "z", "y", "x", "MeshLab"],
)
def test_collada_files_stand_upright(tmp_path, asset, seen, node):
    (tmp_path / "part.dae").write_text(COLLADA.format(asset=asset, node=node))
    link = '<link name="l"><visual><geometry><mesh filename="part.dae" scale="2 2 2"/></geometry></visual></link>'
    (tmp_path / "r.urdf").write_text(f'<robot name="r">{link}</robot>')
    scene = pc.Scene.from_urdf(tmp_path / "r.urdf")
    before = scene.visual_model.geometryObjects[0].placement.copy()
    drawing = Drawing()
    draw_robot(drawing, scene.model, scene.visual_model, lambda item: "/part")
    (placed,) = (c for c in drawing.commands if c["type"] == "set_transform")
    assert np.array([1.0, 2.0, 3.0, 1.0]) @ np.reshape(placed["matrix"], (4, 4)) == pytest.approx(
        [*(2 * np.array(seen)), 1]
    )
    assert scene.visual_model.geometryObjects[0].placement == before


def test_events_of_joints_are_named(run):
    stop = SimpleNamespace(time=1.0, contact=None, kind="limit", joint="elbow")
    info = page_info(compose(run, 30.0, 1.0, 3000, None, None, ()), changed(run, events=[stop]), 1.0)
    assert info["events"] == [[1.0, "elbow", "limit"]]
