"""MJCF files: what loads without a warning moves as MuJoCo's own model of the file; the rest is refused or named."""

import warnings

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from mujoco_peer import Peer
from random_mjcf import RandomFile

import pincontact as pc

# Two programs multiply and add the same numbers in another order: a thousand operations on the largest entry.
ROUNDING = 1e-12


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """MuJoCo logs its warnings in the working folder."""
    monkeypatch.chdir(tmp_path)


def written(tmp_path, text):
    path = tmp_path / "robot.xml"
    path.write_text(text)
    return path


def read(tmp_path, text):
    """Scene and MuJoCo's model of a file that is read without a warning."""
    path = written(tmp_path, text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return pc.Scene.from_mjcf(path), Peer(path)


def file(body, before="", after="", angle="radian"):
    return f"""
<mujoco model="m"><compiler angle="{angle}"/>{before}
<worldbody>{body}</worldbody>{after}</mujoco>"""


def arm(joint="", parts="", body=""):
    """A hinged body with the given attributes of its joint, further parts, and attributes of its own."""
    return f"""
<body name="arm" pos="0.1 0 0.2" {body}>
  <joint name="elbow" axis="0 1 0" {joint}/>
  <inertial pos="0.1 0.2 0.3" mass="2" diaginertia="0.02 0.03 0.04"/>
  {parts}
</body>"""


def random_state(model, rng):
    bounded = model.copy()
    bounded.lowerPositionLimit[:], bounded.upperPositionLimit[:] = -1.0, 1.0
    pin.seed(int(rng.integers(2**31)))
    return pin.randomConfiguration(bounded), rng.normal(size=model.nv)


def configurations(model):
    return {entry.key(): entry.data() for entry in model.referenceConfigurations}


def assert_same(model, peer, seed=0):
    """Mass matrix, bias forces, joint forces, limits and start are those of MuJoCo."""
    assert (model.nq, model.nv) == (peer.model.nq, peer.model.nv)
    data, rng = model.createData(), np.random.default_rng(seed)
    for _ in range(3):
        q, v = random_state(model, rng)
        mass, bias = peer.mass_and_bias(q, v)
        pin.crba(model, data, q)
        found = np.triu(data.M) + np.triu(data.M, 1).T
        np.testing.assert_allclose(found, mass, rtol=0.0, atol=ROUNDING * np.abs(mass).max(initial=1.0))
        found = pin.nonLinearEffects(model, data, q, v)
        np.testing.assert_allclose(found, bias, rtol=0.0, atol=ROUNDING * np.abs(bias).max(initial=1.0))
    np.testing.assert_allclose(model.gravity.linear, peer.gravity(), rtol=0.0, atol=0.0)
    np.testing.assert_allclose(model.damping, peer.model.dof_damping, rtol=1e-15)
    np.testing.assert_allclose(model.armature, peer.model.dof_armature, rtol=1e-15)
    np.testing.assert_allclose(model.upperDryFrictionLimit, peer.model.dof_frictionloss, rtol=1e-15)
    np.testing.assert_allclose(model.lowerDryFrictionLimit, -peer.model.dof_frictionloss, rtol=1e-15)
    ends = np.column_stack([model.lowerPositionLimit, model.upperPositionLimit])
    ends[np.abs(ends) >= np.finfo(float).max] *= np.inf
    np.testing.assert_allclose(ends, peer.limits(), rtol=1e-15)
    start = configurations(model)["qpos0"]
    apart = pin.difference(model, start, peer.to_pinocchio(peer.model.qpos0))
    np.testing.assert_allclose(apart, 0.0, rtol=0.0, atol=1e-13)


# ---------------------------------------------------------------------------------------------------- the same motion


@pytest.mark.parametrize("seed", range(40))
def test_random_files(tmp_path, seed):
    scene, peer = read(tmp_path, RandomFile(seed).text)
    assert_same(scene.model, peer, seed)


BALL = '<geom type="sphere" size="0.1"/>'
FEATURES = {
    "ball damping": arm(parts=f'<body><joint type="ball" damping="3" armature="0.1" frictionloss="0.2"/>{BALL}</body>'),
    "free damping": f'<body><joint type="free" damping="3"/>{BALL}</body>',
    "limited false": arm('range="-1 1" limited="false"'),
    "limited by default": arm('range="-1 1"'),
    "ref moves limits": arm('range="-1 1" ref="0.4"'),
    "slide with ref": arm('type="slide" range="-1 1" ref="0.4"'),
    "axis of any length": arm().replace('axis="0 1 0"', 'axis="0 3 4"'),
    "axisangle of any length": arm(body='axisangle="1 2 3 0.4"'),
    "two joints": arm(parts='<joint name="second" type="slide" axis="1 0 0" pos="0.1 0 0" damping="2"/>'),
    "several bodies": arm() + f'<body pos="1 0 0"><freejoint/>{BALL}</body><body><geom size="0.1"/></body>',
    "bodies without names": f"<body><joint/>{BALL}<body><joint/>{BALL}</body><body><joint/>{BALL}</body></body>",
    "joint after child": f'<body><body pos="0 0 1"><joint/>{BALL}</body>{BALL}<joint axis="0 1 0"/></body>',
    "visual geoms weigh": '<body><joint/><geom size="0.1"/><geom size="0.2" contype="0" conaffinity="0"/></body>',
    "massless geom": f'<body><joint/>{BALL}<geom type="box" size="1 1 1" mass="0"/></body>',
    "fixed child": arm(parts=f'<body pos="0.3 0 0" euler="0.1 0.2 0.3">{BALL}</body>'),
    "frames": f'<frame pos="0 0 1" euler="0.1 0.2 0.3"><frame pos="0 1 0">{arm()}</frame></frame>',
    "motor and its servo": arm(),
}
AROUND = {
    "motor and its servo": {"after": '<actuator><position joint="elbow" kp="30"/></actuator><sensor/>'},
    "ball damping": {"before": '<option timestep="1e-3" integrator="RK4"><flag contact="disable"/></option>'},
}


@pytest.mark.parametrize("name", FEATURES)
def test_features(tmp_path, name):
    scene, peer = read(tmp_path, file(FEATURES[name], **AROUND.get(name, {})))
    assert_same(scene.model, peer)


CLASSES = """
<default>
  <joint damping="1" armature="0.1"/>
  <default class="a"><joint damping="2"/><default class="b"><joint frictionloss="3"/></default></default>
  <default class="c"><joint armature="0.4"/><geom quat="1 1 0 0" type="box" size="0.1 0.2 0.3"/></default>
</default>"""


@pytest.mark.parametrize(
    "body",
    [
        arm(),
        arm('class="a"'),
        arm('class="b"'),
        arm(body='childclass="b"'),
        # a class of the element's own is instead of the body's, not on top of it
        arm('class="c"', body='childclass="b"'),
        arm(body='childclass="b"', parts=f"<body><joint/>{BALL}</body>"),
        arm(body='childclass="b"', parts='<body childclass="c"><joint/><geom/><geom euler="0.1 0.2 0.3"/></body>'),
        f'<body childclass="b"><freejoint/>{BALL}</body>',
        f'<frame childclass="b">{arm()}</frame>',
        '<body><joint class="c"/><geom class="c"/><geom class="c" axisangle="1 0 0 0.3"/></body>',
    ],
)
def test_default_classes(tmp_path, body):
    scene, peer = read(tmp_path, file(body, CLASSES))
    assert_same(scene.model, peer)


@pytest.mark.parametrize(
    "compiler",
    [
        'angle="degree" eulerseq="ZYX"',
        'eulerseq="xYz"',
        'inertiafromgeom="true"',
        'inertiafromgeom="false"',
        'balanceinertia="true"',
        'boundmass="3" boundinertia="0.5" balanceinertia="true"',
        'settotalmass="7"',
        'autolimits="false"',
        'inertiagrouprange="1 2"',
        'fusestatic="true"',
        'discardvisual="true"',
    ],
)
def test_settings_of_the_compiler(tmp_path, compiler):
    bodies = f"""
<body pos="0 0 1" euler="10 20 30"><joint ref="0"/>
  <inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 {"0.3" if "balance" in compiler else "0.15"}"/>
  <geom size="0.1 0.2" type="capsule" axisangle="1 1 0 40" group="1"/>
  <geom size="0.1" mass="0.2" contype="0" conaffinity="0"/>
  <body><joint axis="1 0 0" range="-1 1" limited="true"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <geom size="0.3" group="2"/></body>
  <body name="small"><geom size="0.01"/><inertial mass="1e-3" pos="0 0 0" diaginertia="1e-6 1e-6 1e-6"/></body>
</body>"""
    scene, peer = read(tmp_path, f"<mujoco><compiler {compiler}/><worldbody>{bodies}</worldbody></mujoco>")
    assert_same(scene.model, peer)


@pytest.mark.parametrize(
    "option",
    [
        '<option gravity="1 2 3"/>',
        '<option><flag gravity="disable"/></option>',
        '<option gravity="1 2 3"/><option timestep="1e-4"><flag gravity="enable"/></option>',
    ],
)
def test_gravity(tmp_path, option):
    scene, peer = read(tmp_path, file(arm(), option))
    assert_same(scene.model, peer)


def test_forces_that_are_switched_off(tmp_path):
    """What MuJoCo leaves out on demand is not there either, and nothing to warn of."""
    joint = 'damping="1" frictionloss="2" range="-1 1" stiffness="3"'
    flags = ("damper", "frictionloss", "limit", "spring", "equality")
    option = "<option><flag " + " ".join(f'{flag}="disable"' for flag in flags) + "/></option>"
    scene, _ = read(tmp_path, file(arm(joint), option, '<equality><joint joint1="elbow"/></equality>'))
    model = scene.model
    assert not model.damping.any() and not model.upperDryFrictionLimit.any()
    assert model.upperPositionLimit[0] == np.finfo(float).max


def test_inclusions(tmp_path):
    """Their paths start at the folder of the main file."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "body.xml").write_text('<mujoco><include file="parts/ball.xml"/></mujoco>')
    (tmp_path / "parts" / "ball.xml").write_text(f"<mujoco>{BALL}</mujoco>")
    (tmp_path / "class.xml").write_text(f"<mujoco>{CLASSES}</mujoco>")
    body = '<body name="b"><joint/><include file="parts/body.xml"/></body>'
    scene, peer = read(tmp_path, file(body, '<include file="class.xml"/>'))
    assert_same(scene.model, peer)
    assert scene.model.damping[0] == 1.0


def test_free_motion(tmp_path):
    """Damped joints of all kinds swing for half a second as they do with MuJoCo."""
    body = """
<body pos="0 0 1"><freejoint/><geom type="box" size="0.2 0.3 0.1"/>
  <body pos="0.2 0 0"><joint axis="0 1 1" damping="0.3" armature="0.05" ref="0.2"/>
    <geom type="capsule" size="0.05 0.2"/>
    <body pos="0 0 0.4"><joint type="ball" damping="0.05"/><geom type="ellipsoid" size="0.1 0.2 0.05"/></body>
  </body>
</body>
<body pos="3 0 0"><joint type="slide" axis="1 0 1" damping="2"/><geom size="0.1"/></body>"""
    scene, peer = read(tmp_path, file(body, '<option timestep="1e-4" integrator="RK4"/>'))
    q = configurations(scene.model)["qpos0"]
    v = 0.5 * np.random.default_rng(3).normal(size=scene.model.nv)
    run = pc.simulate(scene, scene.initial_state(q, v), 0.5, rtol=1e-11, atol=1e-13)
    peer.set(q, v)
    for _ in range(5000):
        mujoco.mj_step(peer.model, peer.data)
    # order 4 with steps of 1e-4 s: rounding of 5000 steps is what is left
    np.testing.assert_allclose(run.q[-1], peer.to_pinocchio(peer.data.qpos), rtol=0.0, atol=1e-10)
    assert np.abs(run.q[-1] - q).max() > 0.1


def test_key_frames(tmp_path):
    body = f'<body pos="1 2 3" quat="1 1 0 0"><freejoint/>{BALL}<body><joint ref="0.3"/>{BALL}</body></body>'
    key = '<keyframe><key name="home" qpos="1 2 3 0 0 3 4 0.5"/><key time="2"/></keyframe>'
    scene, peer = read(tmp_path, file(body, after=key))
    found = configurations(scene.model)
    np.testing.assert_allclose(found["home"], [1.0, 2.0, 3.0, 0.0, 0.6, 0.8, 0.0, 0.5], rtol=0.0, atol=1e-15)
    assert found["qpos0"][-1] == 0.3 and set(found) == {"qpos0", "home"}
    assert_same(scene.model, peer)


def test_efforts_and_sites(tmp_path):
    parts = '<site name="tip" pos="1 0 0" euler="0 0 0.5"/><body name="f"><geom size="0.1"/><site name="s"/></body>'
    scene, peer = read(tmp_path, file(arm('actuatorfrcrange="-3 4"', parts)))
    model = scene.model
    assert (model.lowerEffortLimit[0], model.upperEffortLimit[0]) == (-3.0, 4.0)
    q, v = random_state(model, np.random.default_rng(0))
    peer.set(q, v)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    for name in ("tip", "s"):
        pose, site = data.oMf[model.getFrameId(name)], peer.data.site(name)
        np.testing.assert_allclose(pose.translation, site.xpos, rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(pose.rotation.ravel(), site.xmat, rtol=0.0, atol=1e-14)


# ---------------------------------------------------------------------------------------------------- what is named

EQUALITIES = '<equality><weld body1="arm"/><joint name="lock" joint1="elbow" active="false"/></equality>'
TENDON = '<tendon><fixed name="t" {}><joint joint="elbow" coef="1"/></fixed></tendon>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (file(arm('stiffness="3"')), r"stiffness \(joint 'elbow'\)"),
        (file(arm('class="s"'), '<default><default class="s"><joint stiffness="3"/></default></default>'), "stiffness"),
        (file(arm('springdamper="0.1 1"')), r"springdamper \(joint 'elbow'\)"),
        (file(arm('damping="1 2"')), r"nonlinear damping \(joint 'elbow'\)"),
        (file(arm(body='gravcomp="1"')), r"gravity compensation \(body 'arm'\)"),
        (file(f'<body><joint name="b" type="ball" range="0 1"/>{BALL}</body>'), r"range of a ball \(joint 'b'\)"),
        (file(arm(), after=EQUALITIES), r"equality constraint \(a weld of 'arm'\)$"),
        (file(arm(), after=TENDON.format('stiffness="1"')), r"stiffness of a tendon \(fixed 't'\)"),
        (file(arm(), after=TENDON.format('armature="1"')), r"armature of a tendon"),
        (file(arm(), after=TENDON.format('range="0 1"')), r"range of a tendon"),
        (file(arm(), '<option density="1.2"/>'), r"fluid forces \(option density\)"),
        (file(arm(), after='<actuator><motor joint="elbow" armature="1"/></actuator>'), "armature of an actuator"),
        (file(f'<body name="f"><freejoint name="r" align="true"/>{BALL}</body>'), r"align \(freejoint 'r'\)"),
        (file(arm('elasticity="2"')), "not known here, and left out: elasticity of <joint>"),
        (file(arm('><spring/></joint><geom size="0.1" mass="0"')), "<spring> of <joint>"),
        (file(arm(), "<weather/>"), "not known here, and left out: <weather>"),
        (file(arm(), "<default><cloud/></default>"), "<cloud> in default class 'main'"),
    ],
)
def test_what_is_left_out_is_named(tmp_path, text, message):
    with pytest.warns(UserWarning, match=message) as caught:
        pc.Scene.from_mjcf(written(tmp_path, text))
    assert len(caught) == 1 and caught[0].filename == __file__


def test_passive_tendons_and_actuators_are_nothing_to_warn_of(tmp_path):
    more = TENDON.format("") + '<actuator><motor tendon="t"/></actuator>'
    scene, peer = read(tmp_path, file(arm(), after=more))
    assert_same(scene.model, peer)


MESH = '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (file('<body name="b"><joint/><geom type="mesh" mesh="m"/></body>', MESH), "a geom of 'b': .* inertia .* mesh"),
        (
            file('<body><joint/><geom name="g" size="0.1" shellinertia="true"/></body>'),
            "geom 'g': the inertia of a shell",
        ),
        (file("<replicate count='3'><body/></replicate>"), "<replicate> in body 'world'"),
        (file(arm(parts="<flexcomp/>")), "<flexcomp> in body 'arm'"),
        (file(arm(parts="<attach/>")), "<attach> in body 'arm'"),
        (file(arm(parts="<weather/>")), "<weather> in body 'arm'"),
        (file(arm(), "<deformable><flex name='f'/></deformable>"), "<flex> 'f'"),
        (file('<body><joint name="j" type="free" armature="1"/><geom size="0.1"/></body>'), "joint 'j': armature"),
        (file(arm() + arm()), "body 'arm': there is another body"),
        (file(arm(parts='<joint name="elbow"/>')), "another joint named 'elbow'"),
        (file(arm(parts='<site name="s"/><site name="s"/>')), "another site"),
        (file(arm(parts="<freejoint/>")), "only a body of the world can move freely"),
        (file(arm(parts="<body><freejoint/></body>")), "only a body of the world can move freely"),
        (file(arm('class="lost"')), "joint 'elbow': there is no default class 'lost'"),
        (file(arm(body='childclass="lost"')), "body 'arm': there is no default class 'lost'"),
        (file(arm(body='quat="0 0 0 0"')), "body 'arm': quat has no direction"),
        (file(arm(body='euler="0 0 0" zaxis="0 0 1"')), "body 'arm': its orientation is given by zaxis and by euler"),
        (file(arm(body='euler="0 0 0" quat="1 0 0 0"')), "body 'arm': its orientation is given by quat and by euler"),
        (file(arm().replace("diaginertia", 'quat="1 1 0 0" fullinertia')), "both fullinertia and quat"),
        (file(arm('type="screw"')), "joint 'elbow': type must be one of hinge"),
        (file(arm('damping="much"')), "joint 'elbow': damping must be 1 to 3 finite numbers, got 'much'"),
        (file(arm('armature="-1"')), "joint 'elbow': armature must not be negative"),
        (file(arm('range="1 -1" limited="true"')), "joint 'elbow': range must increase"),
        (file(arm('pos="1 2"')), "joint 'elbow': pos must be 3 finite numbers, got '1 2'"),
        (file(arm('limited="perhaps"')), "limited must be one of true, false, auto, got 'perhaps'"),
        (file(arm('range="-1 1"'), '<compiler autolimits="false"/>'), "range is given but not limited"),
        (file(arm(), '<compiler eulerseq="abc"/>'), "eulerseq"),
        (file(arm(), '<compiler coordinate="global"/>'), "coordinate must be one of local"),
        (file(arm().replace("0.02 0.03 0.04", "0.02 0.03 0.4")), r"body 'arm': .*A \+ B >= C"),
        (file(arm().replace('mass="2"', "")), "an inertial of 'arm': mass is missing"),
        (file(arm(), after='<keyframe><key name="k" qpos="1 2"/></keyframe>'), "key 'k': qpos must be a finite number"),
        (file('<body><geom type="box" size="1 1"/></body>'), "size of a box must be 3 positive numbers, got '1 1'"),
        (file('<body name="b"><frame><inertial/></frame></body>'), "body 'b' has its <inertial> within a <frame>"),
        (file(arm(parts='<body name="universe"/>')), "named 'universe', which is the name of the world"),
        (file("<joint/>" + arm()), "the world has a <joint>"),
        (file(arm(), '<include file="lost.xml"/>'), "not found: .*lost.xml"),
        (file(arm(), '<include file="robot.xml"/>'), "robot.xml includes itself"),
    ],
)
def test_what_is_refused(tmp_path, text, message):
    with pytest.raises(pc.ModelError, match=message):
        pc.Scene.from_mjcf(written(tmp_path, text))


def test_meshes_that_do_not_move_need_no_inertia(tmp_path):
    path = written(tmp_path, file(arm() + '<body><geom type="mesh" mesh="m"/></body>', MESH))
    with pytest.warns(UserWarning, match=r"a geom of 'body_2' \(mesh 'm' has no file\)"):
        scene = pc.Scene.from_mjcf(path)
    assert_same(scene.model, Peer(path))


# ---------------------------------------------------------------------------------------------------- shapes


def test_shapes(tmp_path):
    """Names, carriers and placements of drawn and of collision shapes; the world's among them."""
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "part.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\n")
    before = """
<compiler meshdir="meshes"/><default><mesh scale="2 2 2"/></default>
<asset><mesh file="part.obj"/><material name="red" rgba="1 0 0 1"/></asset>"""
    geoms = """
<geom type="mesh" mesh="part" material="red" contype="0" conaffinity="0"/>
<geom type="capsule" size="0.1" fromto="0 0 0 0 0 1"/><geom size="0.2" group="4"/>"""
    world = '<geom type="plane" size="1 1 1"/><geom type="box" size="1 1 0.1" pos="0 0 -0.1"/>'
    body = world + arm('pos="0.3 0.2 0.1" ref="0.4"', geoms)
    scene, peer = read(tmp_path, file(body, before))
    drawn = [item.name for item in scene.visual_model.geometryObjects]
    assert drawn == ["world_0", "arm_0", "arm_1"]
    collision = [item.name for item in scene.collision_model.geometryObjects]
    assert collision == ["world_0", "world_1", "arm_0", "arm_1"]
    mesh = scene.visual_model.geometryObjects[1]
    np.testing.assert_array_equal(mesh.meshColor, [1.0, 0.0, 0.0, 1.0])
    np.testing.assert_array_equal(np.asarray(mesh.geometry.vertices()).max(axis=0), [2.0, 2.0, 2.0])
    found = scene.add_contours_from_collision()
    assert found["world_0_plane"].frame == "universe" and isinstance(found["world_0_plane"].contour, pc.Plane)
    assert found["arm_1_sphere"].frame == "arm"
    # the capsule is where MuJoCo has it
    q, v = random_state(scene.model, np.random.default_rng(0))
    peer.set(q, v)
    data = scene.model.createData()
    pin.forwardKinematics(scene.model, data, q)
    item = scene.collision_model.geometryObjects[2]
    pose = data.oMi[item.parentJoint] * item.placement
    np.testing.assert_allclose(pose.translation, peer.data.geom_xpos[3], rtol=0.0, atol=1e-14)


def test_shapes_that_cannot_be_read_are_named(tmp_path):
    body = arm(parts='<geom name="hull" type="mesh" mesh="hull"/><geom type="sphere" size="0.1"/>')
    path = written(tmp_path, file(body, '<asset><mesh name="hull" file="hull.stl"/></asset>'))
    with pytest.warns(UserWarning, match=r"shapes that could not be read: geom 'hull' \(mesh file not found: .*hull"):
        scene = pc.Scene.from_mjcf(path)
    with pytest.warns(UserWarning, match="geom 'hull'"):
        assert list(scene.add_contours_from_collision()) == ["arm_0_sphere"]
