"""Robots from other files and objects: the same robot moves the same, and what is left out is said."""

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
    for text in ("down", "-9.81 1", "nan"):
        with pytest.raises(pc.ModelError, match="gravity must be 3 finite numbers"):
            pc.Scene.from_mjcf(mjcf(tmp_path, text))


def test_a_mesh_that_is_missing_does_not_matter_to_the_motion(tmp_path):
    text = DISK_MJCF.replace('type="cylinder" size="0.3 0.01"', 'type="mesh" mesh="lost"')
    with pytest.warns(UserWarning, match="there is no mesh 'lost'"):
        scene = pc.Scene.from_mjcf(mjcf(tmp_path, text=text))
    assert rolled(scene).success
    with pytest.raises(pc.ModelError, match="no contour was found .*no shape; .*there is no mesh 'lost'"):
        scene.add_contours_from_collision()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco", "cannot be read as an MJCF"),
        ("<robot/>", "first element is <robot>, not <mujoco>"),
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
