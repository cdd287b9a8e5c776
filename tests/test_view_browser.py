"""The page of a replay in a real browser, without a display: does it draw, seek and show what the run says.

Skipped where there is no Chromium; then the page has been checked as text and data only (`test_view.py`).
"""

from __future__ import annotations

from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from browser import PROGRAM, Browser
from fake_run import END, HOP_END, HOP_START, SLIP_END, fake_run, placement

import pincontact as pc
from pincontact.view import export_html
from pincontact.view.page import render_page
from pincontact.view.palette import contact_color
from pincontact.view.replay import MORE_PARTS, PARTS, compose, page_info

pytestmark = pytest.mark.skipif(PROGRAM is None, reason="no Chromium found: pages are not opened, only read")

# What three.js' objects are like at a time.
PROBE = """((time) => {
  const node = (...names) => viewer.scene_tree.find(["meshcat", "pincontact", ...names]).object;
  run(false);
  seek(time);
  viewer.scene.updateMatrixWorld();
  const body = node("bodies", "root"), trace = node("contacts", "rim|floor", "trace", "<object>");
  return {
    position: body.position.toArray(), quaternion: body.quaternion.toArray(),
    arrow: node("contacts", "rim|floor", "normal").visible,
    stick: node("contacts", "rim|floor", "normal", "shaft", "stick").visible,
    trace: trace.geometry.drawRange.count, clock: element("clock").textContent,
    mode: element("contacts").querySelector("tr").cells[1].textContent,
  };
})"""

# Which nodes under the drawing have triangles in the picture at the end, with their colours; and the panels.
LOOK = """(() => {
  run(false);
  seek(info.duration);
  viewer.scene.updateMatrixWorld(true);
  viewer.camera.updateMatrixWorld(true);
  const inside = (mesh) => {
    mesh.geometry.computeBoundingSphere();
    const centre = mesh.geometry.boundingSphere.center.clone().applyMatrix4(mesh.matrixWorld).project(viewer.camera);
    return Math.abs(centre.x) < 1 && Math.abs(centre.y) < 1;
  };
  const seen = [];
  const walk = (node, path) => {
    if (!node.object.visible) return;
    node.object.children.forEach((child) => {
      if (child.isMesh && child.visible && child.geometry.attributes.position.count > 0 && inside(child)) {
        seen.push([path, child.material.color.getHex()]);
      }
    });
    for (const [name, child] of Object.entries(node.children)) walk(child, path + "/" + name);
  };
  walk(viewer.scene_tree.find(["meshcat", "pincontact"]), "");
  const shown = (panel) => panel.getClientRects().length > 0;
  const boxes = [...document.querySelectorAll(".panel, .dg.main")].filter(shown).map((panel) => {
    const { left, top, right, bottom } = panel.getBoundingClientRect();
    return [panel.id, left, top, right, bottom];
  });
  const bar = slider.getBoundingClientRect();
  return {
    seen, said, note: element("note").textContent, slider: [bar.width, bar.height, bar.right, bar.bottom], boxes,
    rows: [...element("contacts").querySelectorAll("tr")].filter((row) => row.style.display !== "none").length,
    list: element("contacts").getBoundingClientRect().height,
  };
})()"""

# Shows the nodes of a name again, and hides those of another one.
SHOW = """((shown, hidden) => {
  const walk = (node) => {
    for (const [name, child] of Object.entries(node.children)) {
      if (name === shown) child.object.visible = child.was;
      else if (name === hidden) {
        child.was = child.object.visible;
        child.object.visible = false;
      } else walk(child);
    }
  };
  walk(viewer.scene_tree.find(["meshcat", "pincontact"]));
  viewer.set_dirty();
  return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
})"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return export_html(fake_run(), tmp_path_factory.mktemp("page") / "run.html")


def test_page_plays_in_a_browser(browser, page):
    times = [0.3, 1.0, 2.1, 2.75]
    browser.open(page)
    seen = [browser.run(f"{PROBE}({time})") for time in times]
    for time, state in zip(times, seen):
        expected = placement(time)
        # 2.1 s is the top of the hop; elsewhere the frames are 1/30 s apart and interpolated along chords: w^2 h^2 / 8
        # of 0.8 m is 1.4e-4 m.
        assert state["position"] == pytest.approx(expected.translation, abs=1e-3)
        x, y, z, w = state["quaternion"]
        axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        assert axis == pytest.approx(expected.rotation[:, 2], abs=1e-3)
        assert state["clock"] == f"t = {time:.3f} s"
    assert [state["mode"] for state in seen] == ["slip", "stick", "open", "stick"]
    assert [state["arrow"] for state in seen] == [True, True, False, True]
    assert [state["stick"] for state in seen if state["arrow"]] == [False, True, True]
    counts = [state["trace"] for state in seen]
    assert 0 < counts[0] < counts[1] < counts[2] < counts[3]
    assert SLIP_END < times[1] < HOP_START


def test_page_shows_the_wheel_and_its_arrow(browser, tmp_path):
    browser.resize(800, 600)
    browser.open(export_html(fake_run(), tmp_path / "run.html", follow="rim/floor"), "#t=1.0")
    red, green, blue = browser.picture()[80:520].reshape(-1, 3).T
    # The wheel is orange and yellow, the arrow of a sticking contact green, the floor and the sky grey and blue.
    wheel = (red > green + 20) & (green > blue + 20)
    arrow = (green > red + 40) & (green > blue + 30)
    assert wheel.mean() > 0.02, "the wheel is not to be seen"
    assert arrow.sum() > 100, "the arrow is not to be seen"


# One scene of each kind


URDF = Path(__file__).parent.parent / "urdf"


def cart():
    """Meshes: STL, OBJ and Collada; the wheels roll."""
    scene = pc.Scene.from_urdf(URDF / "cart.urdf", floating_base=True)
    floor = scene.add_contour("floor", pc.Plane())
    for wheel in ("front_left", "front_right", "rear_left", "rear_right"):
        rim = scene.add_contour(wheel, pc.Sphere(0.1), wheel)
        scene.add_contact(wheel, rim, floor, friction=pc.Coulomb(0.6))
    v = np.r_[0.5, np.zeros(5), np.full(4, 5.0)]
    return scene, np.r_[0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0, np.tile([1.0, 0.0], 4)], v


def ball():
    scene = pc.Scene.from_urdf(URDF / "ball.urdf", floating_base=True)
    surface, floor = scene.add_contour("ball", pc.Sphere(0.1), "ball"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("ball/floor", surface, floor, friction=pc.Coulomb(0.3))
    return scene, [0, 0, 0.1, 0, 0, 0, 1], [4.0, 0, 0, 0, 0, 0]


def wire():
    scene = pc.Scene.from_urdf(URDF / "bead.urdf", floating_base=True)
    bead, helix = scene.add_contour("bead", pc.Point(), "bead"), scene.add_contour("wire", pc.Helix(0.5, 0.2))
    scene.add_contact("bead/wire", bead, helix, friction=pc.Coulomb(0.1))
    return scene, [0.5, 0, 0, 0, 0, 0, 1], [0, -1.0, 0, 0, 0, 0]


def feet():
    """A block on 16 feet, with 16 more above the floor."""
    scene = pc.Scene.from_urdf(URDF / "block.urdf", floating_base=True)
    floor = scene.add_contour("floor", pc.Plane())
    for k in range(32):
        place = pin.SE3(np.eye(3), np.array([0.1 * (k % 4), 0.1 * (k // 4 % 4), 0.0 if k < 16 else 0.2]) - 0.15)
        scene.add_contact(f"foot {k}", scene.add_contour(f"foot {k}", pc.Sphere(0.02), "block", place), floor)
    return scene, [0, 0, 0.17, 0, 0, 0, 1], [0.5, 0, 0, 0, 0, 0]


@pytest.mark.parametrize(
    ("make", "drawn", "rows", "size"),
    [
        (cart, ["visuals", "contours", "trace", "normal", "point"], 4, (800, 600)),
        (ball, ["visuals", "contours", "trace", "normal", "friction", "point", "e1", "m3", "cone"], 1, (800, 600)),
        (wire, ["contours", "trace"], 1, (800, 600)),
        (feet, ["normal"], 16, (800, 600)),
        (ball, ["normal", "point"], 1, (390, 844)),
    ],
    ids=["meshes", "primitives", "wire", "32 contacts", "phone"],
)
def test_all_parts_are_in_the_picture(browser, tmp_path, make, drawn, rows, size):
    scene, q, v = make()
    free = [name for name in scene.contacts if make is feet and int(name.split()[1]) >= 16]
    run = pc.simulate(scene, scene.initial_state(q, v, free=free), 0.2, rtol=1e-5, atol=1e-7)
    page = export_html(run, tmp_path / "run.html", show=[*PARTS, *(MORE_PARTS if "cone" in drawn else ())])
    browser.resize(*size, touch=size[0] < 400)
    browser.open(page)
    state = browser.run(LOOK)
    assert state["said"] == [] and state["note"] == ""
    paths = [path for path, _ in state["seen"]]
    whole = browser.picture()
    for part, before in zip(drawn, ["", *drawn]):
        assert any(part in path.split("/") for path in paths), (part, paths)
        # without it the picture is another one
        browser.run(f"{SHOW}('{before}', '{part}')")
        changed = np.abs(browser.picture() - whole).sum(axis=2) > 30
        # a contact point on a phone has some four pixels across
        assert changed.sum() > 10, f"{part} is not to be seen"
    browser.run(f"{SHOW}('{drawn[-1]}', '')")
    assert (browser.picture() == whole).all()
    bodies = {item.name for item in scene.visual_model.geometryObjects}
    assert bodies <= {path.split("/")[-1] for path in paths}
    assert state["rows"] == rows
    # sixteen closed contacts are folded, and leave the scene free
    assert 10 < state["list"] < 0.2 * size[1]
    width, height, right, bottom = state["slider"]
    # room for a finger, within the window
    assert width > 150 and height >= 28 and right <= size[0] and bottom <= size[1]
    if make is cart:
        colors = {path.split("/")[-1]: color for path, color in state["seen"] if "visuals" in path}
        # of the URDF; of the Collada file, whose parts meshcat cannot merge
        assert colors["cart_0"] == 0xD83319 and colors["cart_1"] == 0x193FCC
        assert page.stat().st_size < 1.5e6
    # panels are in the window, and none covers another
    for name, left, top, right, bottom in state["boxes"]:
        assert left >= 0 and top >= 0 and right <= size[0] and bottom <= size[1], name
    for one, other in combinations(state["boxes"], 2):
        apart = one[3] <= other[1] or other[3] <= one[1] or one[4] <= other[2] or other[4] <= one[2]
        assert apart, (one, other)


def test_a_command_that_fails_is_told_and_the_others_are_carried_out(browser, tmp_path):
    run = fake_run()
    picture = compose(run, 30.0, 1.0, 3000, None, None, PARTS)
    first, *others = picture.commands(environment=True)
    broken = {"type": "set_object", "path": "/meshcat/broken", "object": {"geometries": [{"type": "No such"}]}}
    page = tmp_path / "run.html"
    page.write_text(render_page([first, broken, *others], page_info(picture, run, 1.0), "run"), encoding="utf-8")
    browser.open(page)
    state = browser.run(LOOK)
    assert state["note"].count("not drawn") == 1 and "/meshcat/broken" in state["note"]
    paths = {part for path, _ in state["seen"] for part in path.split("/")}
    assert {"contours", "trace", "normal", "point"} <= paths
    assert browser.run(f"{PROBE}(1.0)")["clock"] == "t = 1.000 s"


# What a user does with a page


def test_event_marks_have_labels_and_tooltips_and_lead_to_their_times(browser, page):
    browser.resize(1000, 600)
    browser.open(page)
    marks = browser.run(
        """[...element("ticks").querySelectorAll("button")].map((tick) => {
          const box = tick.getBoundingClientRect(), x = box.x + box.width / 2, y = box.y + box.height / 2;
          return [tick.title, x, y, document.elementFromPoint(x, y) === tick];
        })"""
    )
    events = [(SLIP_END, "rim/floor: stick"), (HOP_START, "rim/floor: separate"), (HOP_END, "rim/floor: touch")]
    assert [title for title, *_ in marks] == [f"{text}, t = {time:.4f} s" for time, text in [*events, (2.5, "user")]]
    bar = browser.run(
        "(() => { const box = element('ticks').getBoundingClientRect(); return [box.left, box.width]; })()"
    )
    for (title, x, y, reached), time in zip(marks, [SLIP_END, HOP_START, HOP_END, 2.5]):
        assert reached, f"{title} is covered by something else"
        # at its time on the slider
        assert x == pytest.approx(bar[0] + bar[1] * time / END, abs=1.0)
        browser.press(x, y)
        assert browser.run("element('clock').textContent") == f"t = {time:.3f} s"
        assert browser.run("Number(slider.value)") == pytest.approx(time, abs=END / 10000)
    labels = browser.run(
        """[...element("ticks").querySelectorAll("span")].map((label) => {
          const box = label.getBoundingClientRect();
          return [label.textContent, box.left, box.right, box.width > 0 && getComputedStyle(label).visibility];
        })"""
    )
    # there is no room for that of the touch, 0.2 s later
    assert [text for text, *_ in labels] == ["stick", "separate", "user"]
    assert all(left[2] < right[1] for left, right in pairwise(labels)) and {v for *_, v in labels} == {"visible"}


def dark_columns(browser):
    """x of the columns of the plot that are dark from top to bottom, in its pixels."""
    return browser.run(
        """(() => {
          const pen = canvas.getContext("2d"), high = Math.round(canvas.height * 0.8), found = [];
          const data = pen.getImageData(0, 0, canvas.width, high).data;
          for (let x = 0; x < canvas.width; x += 1) {
            let dark = 0;
            for (let y = 0; y < high; y += 1) {
              const at = 4 * (y * canvas.width + x);
              if (data[at + 3] > 100 && data[at] + data[at + 1] + data[at + 2] < 240) dark += 1;
            }
            if (dark > 0.95 * high) found.push(x);
          }
          return found;
        })()"""
    )


def test_plots_and_animation_have_one_time(browser, page):
    browser.resize(1200, 700)
    browser.open(page, "#t=0")
    left, right, width = browser.run("[margin.left, margin.right, canvas.clientWidth]")
    assert width > 300, "there is no plot"
    for time in (0.5, 1.7, 2.9):
        browser.run(f"run(false); seek({time})")
        (first, *others) = dark_columns(browser)
        assert len(others) < 3
        # a line of one pixel
        assert first == pytest.approx(left + (width - left - right) * time / END, abs=2.0)
    x, y = browser.run("(() => { const box = canvas.getBoundingClientRect(); return [box.left, box.top]; })()")
    wanted = [0.8, 2.0]
    at = [x + left + (width - left - right) * time / END for time in wanted]
    # a press, and a drag
    browser.press(at[0], y + 50)
    assert browser.run("Number(slider.value)") == pytest.approx(wanted[0], abs=END / (width - left - right))
    browser.press(at[0], y + 50, (at[1], y + 60))
    assert browser.run("Number(slider.value)") == pytest.approx(wanted[1], abs=END / (width - left - right))
    body = browser.run("viewer.scene_tree.find(['meshcat', 'pincontact', 'bodies', 'root']).object.position.toArray()")
    # the animation is there, too: one pixel of the plot is 6 mm of the way
    assert body == pytest.approx(placement(wanted[1]).translation, abs=0.01)
    # all contacts' numbers are drawn: beside the axes' grey and black there is the contact's colour
    assert (
        browser.run(
            """(() => {
          const data = picture.getContext("2d").getImageData(0, 0, picture.width, picture.height).data;
          let blue = 0;
          for (let i = 0; i < data.length; i += 4) if (data[i + 2] > data[i] + 100) blue += 1;
          return blue;
        })()"""
        )
        > 300
    )


def test_plots_show_forces_and_their_limit_in_the_colour_of_the_contact(browser, page):
    browser.resize(1200, 700)
    browser.open(page, "#t=0")
    lines = browser.run(
        """(() => {
          const kind = CanvasRenderingContext2D.prototype, stroke = kind.stroke, found = [];
          kind.stroke = function () { found.push([this.strokeStyle, this.getLineDash()]); stroke.call(this); };
          drawPlots();
          kind.stroke = stroke;
          return found;
        })()"""
    )
    # normal force, friction and its limit
    assert [dashes for color, dashes in lines if color == contact_color(0)] == [[], [2, 3], [7, 4]]


@pytest.mark.parametrize("size", [(1000, 600), (640, 480), (390, 844)], ids=["desktop", "small", "phone"])
def test_camera_frames_what_moves(browser, page, size):
    browser.resize(*size, touch=size[0] < 400)
    # a phone gives the window its size while the page is read
    early = "document.addEventListener('DOMContentLoaded', () => window.dispatchEvent(new Event('resize')));"
    added = browser.call("Page.addScriptToEvaluateOnNewDocument", source=early)
    browser.open(page, "#t=0")
    browser.call("Page.removeScriptToEvaluateOnNewDocument", **added)
    corners = browser.run(
        f"""(() => {{
          const found = [], body = viewer.scene_tree.find(["meshcat", "pincontact", "bodies", "root"]).object;
          for (let time = 0; time <= {END}; time += 0.1) {{
            seek(time);
            viewer.scene.updateMatrixWorld(true);
            viewer.camera.updateMatrixWorld(true);
            body.traverse((mesh) => {{
              if (!mesh.isMesh) return;
              const at = mesh.geometry.attributes.position;
              for (let i = 0; i < at.count; i += 7) {{
                const p = viewer.camera.position.clone().set(at.getX(i), at.getY(i), at.getZ(i));
                p.applyMatrix4(mesh.matrixWorld).project(viewer.camera);
                found.push([p.x, p.y]);
              }}
            }});
          }}
          return found;
        }})()"""
    )
    pane = browser.run("[element('meshcat-pane').clientWidth, element('meshcat-pane').clientHeight]")
    x, y = ((np.array(corners) * [1.0, -1.0] + 1.0) * 0.5 * pane).T
    bar = browser.run("element('bar').getBoundingClientRect().top")
    # all of the wheel at all times, above the bar, and not from far away
    assert x.min() >= 0.0 and x.max() <= pane[0] and y.min() >= 0.0 and y.max() <= bar
    assert max(np.ptp(x) / pane[0], np.ptp(y) / bar) > 0.5


def test_slider_works_with_a_finger_on_a_phone(browser, page):
    browser.resize(390, 844, touch=True)
    browser.open(page, "#t=0")
    left, top, width, height = browser.run(
        "(() => { const box = slider.getBoundingClientRect(); return [box.left, box.top, box.width, box.height]; })()"
    )
    # room for a finger, across the whole page
    assert height >= 40 and width > 0.8 * 390
    y = top + height / 2
    point = {"x": left + 10.0, "y": y}
    browser.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[point])
    for part in (0.2, 0.4, 0.6):
        browser.call("Input.dispatchTouchEvent", type="touchMove", touchPoints=[{"x": left + part * width, "y": y}])
    browser.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    # the thumb is some 16 pixels wide
    assert browser.run("Number(slider.value)") == pytest.approx(0.6 * END, abs=0.05 * END)
    assert browser.run("element('play').textContent") == "play"
    assert browser.run("document.documentElement.scrollWidth") <= 390


TEXTURED = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><up_axis>Z_UP</up_axis></asset>
<library_images><image id="i"><init_from>red.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="s"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="t"><sampler2D><source>s</source></sampler2D></newparam>
<technique sid="c"><lambert><diffuse><texture texture="t" texcoord="UV"/></diffuse></lambert></technique>
</profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="9">-1 0 -1 1 0 -1 0 0 1</float_array><technique_common>
<accessor source="#pa" count="3" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<source id="n"><float_array id="na" count="9">0 -1 0 0 -1 0 0 -1 0</float_array><technique_common>
<accessor source="#na" count="3" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<source id="u"><float_array id="ua" count="6">0 0 1 0 0 1</float_array><technique_common>
<accessor source="#ua" count="3" stride="2"><param name="S" type="float"/><param name="T" type="float"/>
</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1" material="m"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="NORMAL" source="#n" offset="1"/><input semantic="TEXCOORD" source="#u" offset="2" set="0"/>
<p>0 0 0 1 1 1 2 2 2</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w"><node><instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="m" target="#m"><bind_vertex_input semantic="UV" input_semantic="TEXCOORD" input_set="0"/>
</instance_material></technique_common></bind_material></instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#w"/></scene></COLLADA>
"""


def test_images_of_meshes_are_there_before_anything_moves(browser, tmp_path):
    image = pytest.importorskip("PIL.Image")
    image.new("RGB", (512, 512), (230, 20, 20)).save(tmp_path / "red.png")
    (tmp_path / "sign.dae").write_text(TEXTURED)
    origin = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    mesh = '<visual><geometry><mesh filename="sign.dae"/></geometry></visual>'
    (tmp_path / "sign.urdf").write_text(f'<robot name="sign"><link name="sign">{origin}{mesh}</link></robot>')
    scene = pc.Scene.from_urdf(tmp_path / "sign.urdf", floating_base=True)
    run = pc.simulate(scene, scene.initial_state([0, 0, 0, 0, 0, 0, 1]), 0.1)
    browser.resize(800, 600)
    browser.open(export_html(run, tmp_path / "run.html"), "#t=0")
    red, green, blue = browser.picture()[80:450].reshape(-1, 3).T
    assert ((red > 100) & (green < 60) & (blue < 60)).sum() > 10000
    assert browser.run("said") == []
