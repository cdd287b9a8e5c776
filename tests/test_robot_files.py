"""Robots from other files and objects: the same robot moves the same, and what is left out is said."""

import math
import warnings

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

DISK_MJCF = """
<mujoco model="disk">
  <compiler angle="radian"/>
  <option gravity="0 0 {gravity}"/>
  <worldbody>
    <body name="disk" pos="0.1 0 0.3">
      <freejoint name="root"/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.045 0.045 0.09"/>
      <geom name="wheel" type="cylinder" size="0.3 0.01"/>
    </body>
  </worldbody>
  {more}
</mujoco>
"""
DISK_SDF = """<?xml version="1.0"?>
<sdf version="1.9"><model name="disk"><link name="disk"><inertial><mass>2</mass>
<inertia><ixx>0.045</ixx><iyy>0.045</iyy><izz>0.09</izz></inertia></inertial></link></model></sdf>
"""


def mjcf(tmp_path, gravity="-9.81", more="", text=DISK_MJCF):
    path = tmp_path / "disk.xml"
    path.write_text(text.replace("{gravity}", gravity).replace("{more}", more))
    return path


def model():
    """The disk of the files, built by hand."""
    made = pin.Model()
    joint = made.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    made.appendBodyToJoint(joint, pin.Inertia(2.0, np.zeros(3), np.diag([0.045, 0.045, 0.09])), pin.SE3.Identity())
    made.addBodyFrame("disk", joint, pin.SE3.Identity(), 0)
    return made


def rolled(scene):
    scene.add_contact(
        "c", scene.add_contour("rim", pc.Circle(0.3), "disk"), scene.add_contour("floor", pc.Plane()), pc.NoSlip()
    )
    q = [0.0, 0.0, 0.2796, 0.0, 0.564642, 0.0, 0.825336]
    return pc.simulate(scene, scene.initial_state(q, [0, 0, 0, 0, 0, 5.0]), 0.5)


def test_mjcf(tmp_path):
    scene = pc.Scene.from_mjcf(mjcf(tmp_path))
    assert scene.model.existFrame("disk")
    np.testing.assert_array_equal(dict_of(scene.model.referenceConfigurations)["qpos0"][:3], [0.1, 0.0, 0.3])
    run, expected = rolled(scene), rolled(pc.Scene(model()))
    np.testing.assert_allclose(run.q, expected.q, rtol=0.0, atol=1e-12)
    contours = scene.add_contours_from_collision()
    assert any(isinstance(attached.contour, pc.Circle) for attached in contours.values())


def dict_of(configurations):
    return {entry.key(): entry.data() for entry in configurations}


def test_gravity_of_mjcf(tmp_path):
    np.testing.assert_array_equal(pc.Scene.from_mjcf(mjcf(tmp_path, "-1.62")).model.gravity.linear, [0.0, 0.0, -1.62])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco", "cannot be read as an MJCF"),
        ("<mujoco/>", "no body found"),
    ],
)
def test_files_that_are_no_mjcf(tmp_path, text, message):
    with pytest.raises(pc.ModelError, match=message) as raised:
        pc.Scene.from_mjcf(mjcf(tmp_path, text=text))
    assert "\n" not in str(raised.value)
    with pytest.raises(pc.ModelError, match="not found: nowhere"):
        pc.Scene.from_mjcf("nowhere.xml")


@pytest.mark.skipif(pin.WITH_SDFORMAT, reason="this Pinocchio reads SDF")
def test_builds_without_sdf_say_so(tmp_path):
    with pytest.raises(pc.MissingExtraError, match="WITH_SDFORMAT"):
        pc.Scene.from_sdf(tmp_path / "disk.sdf")


@pytest.mark.skipif(not pin.WITH_SDFORMAT, reason="this Pinocchio reads no SDF")
def test_sdf(tmp_path):
    path = tmp_path / "disk.sdf"
    path.write_text(DISK_SDF)
    run, expected = rolled(pc.Scene.from_sdf(path, floating_base=True)), rolled(pc.Scene(model()))
    np.testing.assert_allclose(run.q, expected.q, rtol=0.0, atol=1e-12)


def test_robot_wrapper():
    shapes = pin.GeometryModel(), pin.GeometryModel()
    robot = pin.RobotWrapper(model(), *shapes)
    scene = pc.Scene(robot)
    assert scene.model is robot.model
    assert scene.collision_model is robot.collision_model and scene.visual_model is robot.visual_model
    np.testing.assert_array_equal(rolled(scene).q, rolled(pc.Scene(model())).q)
    other = pin.GeometryModel()
    assert pc.Scene(robot, collision_model=other).collision_model is other
    with pytest.raises(pc.ModelError, match="Model or RobotWrapper, got str"):
        pc.Scene("robot")


def test_scene_files_of_other_robots(tmp_path):
    mjcf(tmp_path)
    path = tmp_path / "scene.toml"
    path.write_text('mjcf = "disk.xml"\n')
    assert pc.load_scene(path).scene.model.nq == 7
    for text, message in (
        ('mjcf = "disk.xml"\nurdf = "disk.urdf"\n', r"mjcf: the model is given by urdf already"),
        ('mjcf = "disk.xml"\nfloating_base = true\n', r"floating_base: .*<freejoint>"),
        ('mjcf = "lost.xml"\n', r"mjcf: MJCF file not found"),
    ):
        path.write_text(text)
        with pytest.raises(pc.SceneFileError, match=message):
            pc.load_scene(path)
    path.write_text('sdf = "disk.sdf"\n')
    with pytest.raises(pc.ContactError, match=r"WITH_SDFORMAT|not found"):
        pc.load_scene(path)


# ---------------------------------------------------------------------------------------------------- URDF

MASS = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
LIMIT = '<limit lower="-1" upper="1" effort="5" velocity="2"/>'


def urdf(tmp_path, joint=LIMIT, link=MASS, kind="revolute", axis='<axis xyz="0 0 1"/>', more=""):
    """A file of two links and a joint."""
    path = tmp_path / "robot.urdf"
    path.write_text(
        f'<robot name="r"><link name="a">{MASS}</link><link name="b">{link}</link>'
        f'<joint name="j" type="{kind}"><parent link="a"/><child link="b"/>{axis}{joint}</joint>{more}</robot>'
    )
    return path


def test_what_urdfs_say_of_joints_is_read(tmp_path, recwarn):
    dynamics = '<dynamics damping="3" friction="4"/>'
    for kind in ("revolute", "prismatic", "continuous"):
        model = pc.Scene.from_urdf(urdf(tmp_path, LIMIT + dynamics, kind=kind)).model
        assert (model.damping[0], model.upperDryFrictionLimit[0], model.lowerDryFrictionLimit[0]) == (3.0, 4.0, -4.0)
        if kind != "continuous":
            assert (model.lowerPositionLimit[0], model.upperPositionLimit[0]) == (-1.0, 1.0)
    irrelevant = '<safety_controller k_velocity="1"/><calibration rising="0"/>'
    more = '<transmission name="t"><type>x</type></transmission><gazebo reference="a"><x/></gazebo><material name="m"/>'
    pc.Scene.from_urdf(urdf(tmp_path, LIMIT + irrelevant, more=more))
    assert not recwarn


def test_planar_joints_of_urdfs_move_in_their_plane(tmp_path, recwarn):
    # the plane's normal is z of the joint's frame, which <origin> turns to the world's -y
    origin = '<origin xyz="0 0 1" rpy="1.5707963267948966 0 0"/>'
    model = pc.Scene.from_urdf(urdf(tmp_path, origin, kind="planar")).model
    data = model.createData()
    pin.forwardKinematics(model, data, np.array([0.3, 0.2, math.cos(0.4), math.sin(0.4)]))
    np.testing.assert_allclose(data.oMi[1].translation, [0.3, 0.0, 1.2], atol=1e-15)
    np.testing.assert_allclose(data.oMi[1].rotation[:, 0], [math.cos(0.4), 0.0, math.sin(0.4)], atol=1e-15)
    assert not recwarn


MIMIC = (
    f'<link name="c">{MASS}</link><joint name="k" type="revolute"><parent link="b"/><child link="c"/>{LIMIT}'
    '<mimic joint="j" multiplier="2"/></joint>'
)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"more": MIMIC}, "move on their own here.*: 'k' mimics 'j'"),
        ({"kind": "floating", "joint": '<dynamics damping="3"/>'}, "left out, .*: damping of joint 'j'"),
        ({"kind": "planar", "joint": '<dynamics friction="3"/>'}, "left out, .*: friction of joint 'j'"),
        ({"kind": "planar"}, "left out, .*: limits of joint 'j'"),
        ({"joint": '<limit effort="5" velocity="2"/>'}, "cannot move, .*: 'j'"),
        ({"link": MASS.replace('ixx="1"', 'ixx="-1"')}, "no body has the inertia of these links.*: 'b'"),
        ({"joint": LIMIT + '<dynamic damping="3"/>'}, "not known here, and left out: <dynamic> of joint 'j'"),
        ({"joint": LIMIT + '<dynamics damping="3" stiffness="4"/>'}, "left out: stiffness of <dynamics> of joint 'j'"),
        ({"joint": LIMIT + '<origin xyz="0 0 1" quat_xyzw="0 0 1 1"/>'}, "quat_xyzw of <origin> of joint 'j'"),
        ({"link": MASS + MASS}, "a second <inertial> of link 'b'"),
        ({"more": "<weather/>"}, "left out: <weather> of the robot"),
    ],
)
def test_what_urdfs_leave_out_is_named(tmp_path, changes, message):
    with pytest.warns(UserWarning, match=message) as caught:
        pc.Scene.from_urdf(urdf(tmp_path, **changes))
    assert len(caught) == 1 and caught[0].filename == __file__


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"axis": '<axis xyz="0 0 0"/>'}, "joint 'j': its axis has no direction"),
        ({"kind": "planar", "joint": "", "axis": ""}, "joint 'j': its plane is normal to '1 0 0'"),
        ({"kind": "planar", "joint": "", "axis": '<axis xyz="0 1 0"/>'}, "joint 'j': its plane is normal to '0 1 0'"),
        ({"link": MASS.replace('izz="1"', "")}, "link 'b': izz of its inertia must be a finite number, got None"),
        ({"link": MASS.replace('mass value="1"', 'mass value="nan"')}, "link 'b': value of its mass .* got 'nan'"),
        ({"link": MASS.replace('mass value="1"', 'mass value="-1"')}, "link 'b': its mass must not be negative"),
        ({"link": '<inertial><mass value="1"/></inertial>'}, "link 'b': ixx of its inertia"),
        ({"kind": "spherical"}, "cannot be read as a URDF"),
    ],
)
def test_what_of_a_urdf_is_refused(tmp_path, changes, message):
    with pytest.raises(pc.ModelError, match=message):
        pc.Scene.from_urdf(urdf(tmp_path, **changes))


def test_files_that_are_no_urdf(tmp_path):
    (tmp_path / "x.urdf").write_text("<mujoco/>")
    with pytest.raises(pc.ModelError, match="first element is <mujoco>, not <robot>"):
        pc.Scene.from_urdf(tmp_path / "x.urdf")


def test_joints_that_move_nothing_are_named(tmp_path):
    scene = pc.Scene.from_urdf(urdf(tmp_path, link="", more=MIMIC.replace(MASS, "").split("<mimic")[0] + "</joint>"))
    with pytest.raises(pc.ModelError, match=r"joint '[jk]' moves nothing that has inertia"):
        scene.initial_state(np.zeros(2))


@pytest.mark.parametrize("tag", ["visual", "collision"])
def test_meshes_that_are_missing_are_named(tmp_path, tag):
    """The shapes that can be read stay."""
    (tmp_path / "part.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\n")
    shapes = "".join(
        f"<{tag}><geometry>{shape}</geometry></{tag}>"
        for shape in (
            '<mesh filename="package://part.obj"/>',
            '<sphere radius="0.1"/>',
            '<mesh filename="package://lost/hull.stl"/>',
        )
    )
    with pytest.warns(UserWarning, match=rf"could not be read: {tag} of link 'b' \(mesh package://lost/hull.stl\)\.$"):
        scene = pc.Scene.from_urdf(urdf(tmp_path, link=MASS + shapes))
    shapes = scene.visual_model if tag == "visual" else scene.collision_model
    assert [item.name for item in shapes.geometryObjects] == ["b_0", "b_1"]
    if tag == "collision":
        with pytest.warns(UserWarning, match=r"ignored: b_0 .*could not be read: .*hull\.stl"):
            assert list(scene.add_contours_from_collision()) == ["b_1_sphere"]
        with pytest.raises(pc.ModelError, match=r"no contour .* corners of: b_1 \(Sphere\);.*hull\.stl"):
            scene.add_contours_from_collision(kinds="corners")
    else:
        with pytest.raises(pc.ModelError, match=r"no contour was found among faces and rims of: no shape\.$"):
            scene.add_contours_from_collision()


@pytest.mark.parametrize("tag", ["visual", "collision"])
def test_shapes_that_the_parser_does_not_know_are_named(tmp_path, tag):
    """Capsules are known from version 1.2 on. Other shapes of the link stay, also those that come later."""
    paint = '<material name="paint"/>'
    before, odd, after, other = (
        f"<{kind}><geometry>{shape}</geometry>{paint if kind == 'visual' else ''}</{kind}>"
        for kind, shape in (
            (tag, '<sphere radius="0.1"/>'),
            (tag, '<capsule radius="0.1" length="0.2"/>'),
            (tag, '<box size="1 1 1"/>'),
            ("collision" if tag == "visual" else "visual", '<sphere radius="0.2"/>'),
        )
    )
    # a colour that is defined elsewhere
    more = paint.replace("/>", '><color rgba="1 0 0 1"/></material>')
    path = urdf(tmp_path, link=MASS + before + odd + after + other, more=more)
    with pytest.warns(UserWarning, match=rf"could not be read: {tag} of link 'b' \(<capsule>\)\.$"):
        scene = pc.Scene.from_urdf(path)
    models = {"visual": scene.visual_model, "collision": scene.collision_model}
    kinds = {name: [type(item.geometry).__name__ for item in shapes.geometryObjects] for name, shapes in models.items()}
    assert kinds.pop(tag) == ["Sphere", "Box"] and list(kinds.values()) == [["Sphere"]]
    path.write_text(path.read_text().replace('<robot name="r"', '<robot name="r" version="1.2"'))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        newer = pc.Scene.from_urdf(path)
    shapes = newer.visual_model if tag == "visual" else newer.collision_model
    assert [type(item.geometry).__name__ for item in shapes.geometryObjects] == ["Sphere", "Capsule", "Box"]
    with pytest.warns(UserWarning, match=rf"{tag} of link 'b' \(no geometry\)"):
        pc.Scene.from_urdf(urdf(tmp_path, link=f"{MASS}<{tag}/>{other}", more=more))


def test_links_whose_only_mesh_is_missing(tmp_path):
    shape = '<collision><geometry><mesh filename="lost.stl"/></geometry></collision>'
    with pytest.warns(UserWarning, match=r"lost\.stl"):
        scene = pc.Scene.from_urdf(urdf(tmp_path, link=MASS + shape))
    with pytest.raises(pc.ModelError, match=r"link 'b' has no collision shape; .*could not be read: .*lost\.stl"):
        scene.add_contours_from_collision(links="b")


# ---------------------------------------------------------------------------------------------------- quaternions


def test_the_real_part_of_a_quaternion_in_front_is_warned_of():
    """A ball moves the same however it is turned, so nothing else would tell."""
    scene = pc.Scene(model())
    with pytest.warns(UserWarning, match=r"q\[3:7\] of joint 'root' is \(1, 0, 0, 0\), half a turn") as caught:
        turned = scene.initial_state([0, 0, 0, 1, 0, 0, 0])
    assert caught[0].filename == __file__
    spherical = pin.Model()
    joint = spherical.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    spherical.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    with pytest.warns(UserWarning, match=r"q\[0:4\] of joint 'ball'"):
        pc.Scene(spherical).initial_state([1, 0, 0, 0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        meant = scene.initial_state([0, 0, 0, -1, 0, 0, 0])
        # what a run has come to is nobody's typing error
        pc.simulate(scene, turned, 0.01)
    np.testing.assert_array_equal(pin.difference(scene.model, turned.q, meant.q), 0.0)
