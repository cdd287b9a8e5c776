"""Contours from collision shapes: every part lies where the shape has it, faces look outwards, names are systematic."""

import itertools
import math
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

URDF = Path(__file__).parent.parent / "urdf"
# Placements of URDF are rotated by products of sines: rounding of a few operations on numbers of order one.
ROUNDING = 1e-14

LINK = """<?xml version="1.0"?>
<robot name="r" version="1.2">
  <link name="base">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    {base}
  </link>
  <link name="arm">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    {arm}
  </link>
  <joint name="elbow" type="{joint}">
    <parent link="base"/><child link="arm"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.4 0.5 0.6"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>
"""
BOX = (
    '<collision><origin xyz="0.3 -0.2 0.5" rpy="0.3 -0.4 1.1"/><geometry><box size="1 0.6 0.4"/></geometry></collision>'
)
SPHERE = '<collision><origin xyz="0.1 0 0" rpy="0 0 0"/><geometry><sphere radius="0.2"/></geometry></collision>'
CYLINDER = (
    '<collision><origin xyz="0 0.1 0" rpy="0.2 0.1 0"/><geometry><cylinder radius="0.2" length="0.5"/></geometry>'
    "</collision>"
)
CAPSULE = '<collision><geometry><capsule radius="0.05" length="0.3"/></geometry></collision>'
HALF = np.array([0.5, 0.3, 0.2])


def robot(tmp_path, base="", arm="", joint="revolute"):
    path = tmp_path / "robot.urdf"
    path.write_text(LINK.format(base=base, arm=arm, joint=joint))
    return pc.Scene.from_urdf(path)


def in_shape(scene, attached, shape):
    """Placement of a contour in the frame of the collision shape it was made from."""
    item = scene.collision_model.geometryObjects[scene.collision_model.getGeometryId(shape)]
    assert item.parentJoint == attached.joint
    return item.placement.inverse() * attached.placement_in_joint


def test_default_parts_and_names(tmp_path):
    scene = robot(tmp_path, base=BOX + SPHERE, arm=CYLINDER + CAPSULE)
    found = scene.add_contours_from_collision()
    faces = [f"base_0_face_{sign}{axis}" for axis in "xyz" for sign in "+-"]
    arm = ["arm_0_cylinder", "arm_0_rim_+z", "arm_0_rim_-z", "arm_1_cylinder", "arm_1_cap_+z", "arm_1_cap_-z"]
    assert set(found) == {*faces, "base_1_sphere", *arm}
    assert scene.contours == found
    assert {c.frame for n, c in found.items() if n.startswith("arm")} == {"arm"}


def test_kinds_select_parts(tmp_path):
    counts = {"faces": 6 + 1 + 1 + 3, "rims": 2, "edges": 12, "corners": 8}
    for kind, count in counts.items():
        scene = robot(tmp_path, base=BOX + SPHERE, arm=CYLINDER + CAPSULE)
        assert len(scene.add_contours_from_collision(kinds=[kind])) == count
    scene = robot(tmp_path, base=BOX + SPHERE, arm=CYLINDER + CAPSULE)
    assert len(scene.add_contours_from_collision(kinds=tuple(counts))) == sum(counts.values())


def test_links_select_shapes(tmp_path):
    scene = robot(tmp_path, base=BOX, arm=SPHERE)
    assert list(scene.add_contours_from_collision(links=["arm"])) == ["arm_0_sphere"]


def test_box_faces_cover_the_box_and_look_outwards(tmp_path):
    scene = robot(tmp_path, base=BOX)
    for name, attached in scene.add_contours_from_collision().items():
        sign, axis = (1.0 if name[-2] == "+" else -1.0), "xyz".index(name[-1])
        pose = in_shape(scene, attached, "base_0")
        np.testing.assert_allclose(pose.rotation[:, 2], sign * np.eye(3)[axis], atol=ROUNDING)
        corners = np.array([pose.act(attached.contour.point(u)) for u in itertools.product(*attached.contour.domain)])
        np.testing.assert_allclose(corners[:, axis], sign * HALF[axis], atol=ROUNDING)
        np.testing.assert_allclose(
            corners.max(axis=0) - corners.min(axis=0), 2 * HALF * (np.eye(3)[axis] == 0), atol=ROUNDING
        )


def test_box_edges_and_corners_meet(tmp_path):
    scene = robot(tmp_path, base=BOX)
    found = scene.add_contours_from_collision(kinds=("edges", "corners"))
    corners = {}
    for name, attached in found.items():
        if "corner" in name:
            signs = np.array([1.0 if mark == "+" else -1.0 for mark in name.removeprefix("base_0_corner_")[::2]])
            point = in_shape(scene, attached, "base_0").translation
            np.testing.assert_allclose(point, signs * HALF, atol=ROUNDING)
            corners[tuple(signs)] = 0
    assert len(corners) == 8
    for name, attached in found.items():
        if "edge" in name:
            pose = in_shape(scene, attached, "base_0")
            for end in attached.contour.domain[0]:
                point = pose.act(attached.contour.point(end))
                np.testing.assert_allclose(np.abs(point), HALF, atol=ROUNDING)
                corners[tuple(np.sign(point))] += 1
            text = name.removeprefix("base_0_edge_")
            for mark, axis in zip(text[::2], text[1::2]):
                assert point["xyz".index(axis)] * (1.0 if mark == "+" else -1.0) > 0.0
    # three edges end at every corner, none is there twice
    assert set(corners.values()) == {3}


def test_cylinder_side_and_rims(tmp_path):
    scene = robot(tmp_path, arm=CYLINDER)
    found = scene.add_contours_from_collision()
    side = found["arm_0_cylinder"]
    assert side.contour.domain[1] == (-0.25, 0.25)
    assert side.contour.periodic == (True, False)
    for mark, sign in (("+", 1.0), ("-", -1.0)):
        rim = found[f"arm_0_rim_{mark}z"]
        pose = in_shape(scene, rim, "arm_0")
        np.testing.assert_allclose(pose.rotation[:, 2], [0.0, 0.0, sign], atol=ROUNDING)
        for u in np.linspace(-3.0, 3.0, 7):
            point = pose.act(rim.contour.point(u))
            assert math.hypot(*point[:2]) == pytest.approx(0.2, abs=ROUNDING)
            assert point[2] == pytest.approx(0.25 * sign, abs=ROUNDING)


def test_capsule_caps_close_its_cylinder(tmp_path):
    scene = robot(tmp_path, base=CAPSULE)
    found = scene.add_contours_from_collision()
    low, high = found["base_0_cylinder"].contour.domain[1]
    assert found["base_0_cylinder"].contour.size == found["base_0_cap_+z"].contour.size == 0.05
    for name, end in (("base_0_cap_-z", low), ("base_0_cap_+z", high)):
        np.testing.assert_allclose(in_shape(scene, found[name], "base_0").translation, [0.0, 0.0, end], atol=ROUNDING)


def test_shapes_of_a_link_behind_a_fixed_joint_keep_their_link(tmp_path):
    """The arm's shape is carried by the world's joint, in the arm's own frame."""
    scene = robot(tmp_path, arm=SPHERE, joint="fixed")
    attached = scene.add_contours_from_collision()["arm_0_sphere"]
    assert (attached.frame, attached.joint) == ("arm", 0)
    np.testing.assert_allclose(attached.placement.translation, [0.1, 0.0, 0.0], atol=ROUNDING)
    expected = pin.SE3(pin.rpy.rpyToMatrix(0.4, 0.5, 0.6), np.array([0.1, 0.2, 0.3])).act(np.array([0.1, 0.0, 0.0]))
    np.testing.assert_allclose(attached.placement_in_joint.translation, expected, atol=ROUNDING)


def test_ellipsoids_of_a_geometry_model_of_ones_own(tmp_path):
    scene = robot(tmp_path)
    shapes = pin.GeometryModel()
    shapes.addGeometryObject(pin.GeometryObject("egg", 0, pin.SE3.Identity(), coal.Ellipsoid(0.3, 0.2, 0.1)))
    found = scene.add_contours_from_collision(geometry=shapes)
    assert found["egg_ellipsoid"].contour.shape == (0.3, 0.2, 0.1)
    assert found["egg_ellipsoid"].frame == "universe"


def test_half_spaces_become_planes(tmp_path):
    scene = robot(tmp_path)
    shapes = pin.GeometryModel()
    normal = np.array([2.0, -1.0, 2.0]) / 3.0
    shapes.addGeometryObject(pin.GeometryObject("hill", 0, pin.SE3.Identity(), coal.Halfspace(normal, 0.7)))
    plane = scene.add_contours_from_collision(geometry=shapes)["hill_plane"]
    assert isinstance(plane.contour, pc.Plane)
    np.testing.assert_allclose(plane.placement.rotation[:, 2], normal, rtol=0.0, atol=ROUNDING)
    np.testing.assert_allclose(plane.placement.translation, 0.7 * normal, rtol=0.0, atol=ROUNDING)


def test_other_shapes_are_ignored_with_a_warning(tmp_path):
    (tmp_path / "part.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n")
    mesh = '<collision><geometry><mesh filename="package://part.obj"/></geometry></collision>'
    scene = robot(tmp_path, base=mesh + SPHERE)
    with pytest.warns(UserWarning, match="ignored: base_0 ") as caught:
        found = scene.add_contours_from_collision()
    assert list(found) == ["base_1_sphere"]
    assert caught[0].filename == __file__


def test_mistakes_leave_the_scene_as_it_was(tmp_path):
    scene = robot(tmp_path, base=BOX, arm=SPHERE)
    with pytest.raises(pc.ModelError, match="'arms' has no collision shape; did you mean arm"):
        scene.add_contours_from_collision(links=["arms"])
    with pytest.raises(pc.ArgumentError, match="unknown kind 'vertices'"):
        scene.add_contours_from_collision(kinds=["vertices"])
    scene.add_contour("arm_0_sphere", pc.Point())
    with pytest.raises(pc.ContourError, match="already a contour named 'arm_0_sphere'"):
        scene.add_contours_from_collision()
    assert list(scene.contours) == ["arm_0_sphere"]
    flat = pin.GeometryModel()
    flat.addGeometryObject(pin.GeometryObject("sheet", 0, pin.SE3.Identity(), coal.Box(1.0, 0.0, 1.0)))
    with pytest.raises(pc.ContourError, match=r"'sheet': Plane: domain"):
        scene.add_contours_from_collision(geometry=flat)
    with pytest.raises(pc.ModelError, match="geometry="):
        pc.Scene(pin.Model()).add_contours_from_collision()


def test_block_rests_on_its_corners():
    """Four corners carry the weight, and the block does not creep: what is left after 1 s is rounding of the forces."""
    scene = pc.Scene.from_urdf(URDF / "block.urdf", floating_base=True)
    corners = scene.add_contours_from_collision(kinds="corners")
    ground = scene.add_contour("ground", pc.Plane())
    for name, corner in corners.items():
        if name.endswith("-z"):
            scene.add_contact(name, corner, ground, friction=pc.Coulomb(0.5))
    q = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0])
    run = pc.simulate(scene, scene.initial_state(q), 1.0)
    assert run.success
    np.testing.assert_allclose(run.q[-1], q, rtol=0.0, atol=1e-12)
    # on the ground: three components of four forces, 3 kg; rounding of the cone solver is 1e-10 relative
    total = sum(run.contacts[name].force[-1] for name in scene.contacts)
    np.testing.assert_allclose(total, [0.0, 0.0, -3.0 * 9.81], atol=1e-8)


def test_roller_and_capsule_of_the_repository():
    """A capsule that stands on its lower cap, a roller that stands on its rim at a slant."""
    capsule = pc.Scene.from_urdf(URDF / "capsule.urdf", floating_base=True)
    capsule.add_contours_from_collision()
    capsule.add_contour("ground", pc.Plane())
    capsule.add_contact("c", "capsule_0_cap_-z", "ground", friction=pc.NoSlip())
    state = capsule.initial_state(np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0]))
    assert abs(state.correction.gaps["c"]) <= ROUNDING
    roller = pc.Scene.from_urdf(URDF / "roller.urdf", floating_base=True)
    roller.add_contours_from_collision()
    roller.add_contour("ground", pc.Plane())
    roller.add_contact("c", "roller_0_rim_-z", "ground", friction=pc.NoSlip())
    slant = 0.4
    height = 0.175 * math.cos(slant) + 0.15 * math.sin(slant)
    state = roller.initial_state(np.array([0.0, 0.0, height, math.sin(0.5 * slant), 0.0, 0.0, math.cos(0.5 * slant)]))
    assert abs(state.correction.gaps["c"]) <= ROUNDING
