"""MJCF files: what loads without a warning moves as MuJoCo's own model of the file; the rest is refused or named."""

import sys
import warnings
from collections import Counter

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


def norm(vector):
    return float(np.linalg.norm(vector))


def assert_same_shapes(scene, peer):
    """Every collision shape is where MuJoCo has it, and as large."""
    m, model = peer.model, scene.model
    q, v = random_state(model, np.random.default_rng(0))
    peer.set(q, v)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    found = {item.name: item for item in scene.collision_model.geometryObjects}
    numbers = Counter()
    for i in np.flatnonzero(m.geom_contype | m.geom_conaffinity):
        if m.geom_type[i] == mujoco.mjtGeom.mjGEOM_HFIELD:
            continue
        body = m.body(m.geom_bodyid[i]).name or f"body_{m.geom_bodyid[i]}"
        item = found.pop(f"{body}_{numbers[body]}")
        numbers[body] += 1
        assert model.frames[item.parentFrame].name == (body if body != "world" else "universe")
        pose = data.oMi[item.parentJoint] * item.placement
        position, rotation = peer.data.geom_xpos[i], peer.data.geom_xmat[i].reshape(3, 3)
        np.testing.assert_allclose(pose.translation, position, rtol=0.0, atol=ROUNDING * (1.0 + norm(position)))
        np.testing.assert_allclose(pose.rotation, rotation, rtol=0.0, atol=ROUNDING)
        shape, size = item.geometry, m.geom_size[i]
        if m.geom_type[i] == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        # its box is that of the geom, which MuJoCo keeps in single precision for meshes
        shape.computeLocalAABB()
        box = shape.aabb_local
        np.testing.assert_allclose(0.5 * (box.max_ - box.min_), m.geom_aabb[i, 3:], rtol=1e-6)
        np.testing.assert_allclose(0.5 * (box.max_ + box.min_), m.geom_aabb[i, :3], rtol=0.0, atol=1e-6 * max(size))
    assert not found


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
        pin.framesForwardKinematics(model, data, q)
        for name, kind, position, rotation in peer.frames():
            pose = data.oMf[model.getFrameId(name, kind)]
            np.testing.assert_allclose(pose.translation, position, rtol=0.0, atol=ROUNDING * (1.0 + norm(position)))
            np.testing.assert_allclose(pose.rotation.ravel(), rotation, rtol=0.0, atol=ROUNDING)
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


@pytest.mark.parametrize("seed", range(16))
def test_random_files(tmp_path, seed):
    scene, peer = read(tmp_path, RandomFile(seed).text)
    assert_same(scene.model, peer, seed)
    assert_same_shapes(scene, peer)


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


MORE = """
<asset>
  <mesh name="m" vertex="0 0 0 1 0 0 0 2 0 0 0 3 1 1 -1" refpos="0.1 0.2 0.3" refquat="1 2 3 4" scale="0.2 0.1 0.3"/>
  <material name="red" rgba="1 0 0 1"/>
</asset>
<default><default class="c"><joint armature="0.4" damping="2"/><geom euler="0.1 0.2 0.3"/></default></default>"""


@pytest.mark.parametrize(
    "body",
    [
        '<body name="b"><joint class="c"/><geom name="g" type="mesh" mesh="m" pos="1 2 3"/></body>',
        '<body name="b"><joint axis="0 1 1"/><geom type="box" mesh="m"/><geom type="mesh" mesh="m" class="c"/></body>',
        '<body name="b"><joint axis="0 1 1"/><geom type="capsule" size="0.1 0.2" shellinertia="true"/></body>',
        '<body name="b"><freejoint align="true"/><geom type="mesh" mesh="m"/><site name="s" pos="1 2 3"/></body>',
        f'<replicate count="3" offset="1 0 0" euler="0 2 1"><body name="b"><joint name="j"/>{BALL}</body></replicate>',
        f'<body name="a"><joint/>{BALL}<attach model="other" body="arm" prefix="other_"/></body>',
        f'<body name="a"><joint/>{BALL}<include file="part.xml"/></body>',
        """<body name="b"><joint/><frame pos="1 0 0" euler="0.3 0.2 0.1"><frame childclass="c"><joint type="ball"/>
           <inertial pos="0.1 0.2 0.3" mass="1" fullinertia="0.3 0.4 0.5 0.02 0.03 0.04"/></frame></frame></body>""",
    ],
)
def test_what_the_compiler_makes(tmp_path, body):
    """Meshes, shells, copies, parts of other files: nothing of these is ours, and all of it arrives."""
    (tmp_path / "part.xml").write_text(f'<mujoco><body name="p" pos="0 0 1"><joint/>{BALL}</body></mujoco>')
    (tmp_path / "other.xml").write_text(file(arm()))
    other = MORE.replace("</asset>", '<model name="other" file="other.xml"/></asset>')
    scene, peer = read(tmp_path, file(body, other if "attach" in body else MORE))
    assert_same(scene.model, peer)
    assert_same_shapes(scene, peer)


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
    assert {name for name, *_ in peer.frames()} == {"arm", "f", "tip", "s"}
    assert_same(model, peer)


# ---------------------------------------------------------------------------------------------------- what is named

EQUALITIES = '<equality><weld body1="arm"/><joint name="lock" joint1="elbow" active="false"/></equality>'
HILL = '<asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 0.1"/></asset>'
TENDON = '<tendon><fixed name="t" {}><joint joint="elbow" coef="1"/></fixed></tendon>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (file(arm('stiffness="3"')), r"stiffness \(joint 'elbow'\)"),
        (file(arm('class="s"'), '<default><default class="s"><joint stiffness="3"/></default></default>'), "stiffness"),
        (file(arm('springdamper="0.1 1"')), r"stiffness \(joint 'elbow'\)"),
        (file(arm('damping="1 2"')), r"nonlinear damping \(joint 'elbow'\)"),
        (file(arm(body='gravcomp="1"')), r"gravity compensation \(body 'arm'\)"),
        (file(f'<body><joint name="b" type="ball" range="0 1"/>{BALL}</body>'), r"range of a ball \(joint 'b'\)"),
        (file(arm(), after=EQUALITIES), r"equality constraint \(a weld of 'arm'\)\.$"),
        (file(arm(), after=TENDON.format('stiffness="1"')), r"stiffness of a tendon \(tendon 't'\)"),
        (file(arm(), after=TENDON.format('armature="1"')), r"armature of a tendon"),
        (file(arm(), after=TENDON.format('range="0 1"')), r"range of a tendon"),
        (file(arm(), '<option density="1.2"/>'), r"fluid forces \(option density\)"),
        (file(arm(), after='<actuator><motor joint="elbow" armature="1"/></actuator>'), "armature of an actuator"),
        (file(arm(), after='<actuator><motor joint="elbow" damping="1"/></actuator>'), "damping of an actuator"),
        (
            file(arm(), after='<actuator><muscle name="m" joint="elbow" lengthrange="0 1"/></actuator>'),
            r"passive .*\(actuator 'm'\)",
        ),
        (file(arm(), after=TENDON.format('damping="1"')), r"damping of a tendon"),
        (file(arm(), after=TENDON.format('frictionloss="1"')), r"dry friction of a tendon"),
        (file(f'<body name="h" mocap="true">{BALL}</body>' + arm()), r"mocap\) \(body 'h'\)\.$"),
        (
            file(f'<body><joint type="free" name="f" armature="1"/>{BALL}</body>'),
            r"armature of a free .*\(joint 'f'\)\.$",
        ),
        (
            file(f'<body><joint type="free" frictionloss="1"/>{BALL}</body>'),
            r"dry friction .*\(joint 'body_1_free'\)\.$",
        ),
        (file(arm() + '<geom type="hfield" hfield="h"/>', HILL), r"could not be read: geom 'geom_0' \(hfield\)\.$"),
        (file(arm('stiffness="1"') + '<geom type="hfield" hfield="h"/>', HILL), "left out.* stiffness.*hfield"),
    ],
)
def test_what_is_left_out_is_named(tmp_path, text, message):
    with pytest.warns(UserWarning, match=message) as caught:
        pc.Scene.from_mjcf(written(tmp_path, text))
    assert len(caught) == 1 and caught[0].filename == __file__


def test_what_is_left_out_of_a_free_joint_is_not_there(tmp_path):
    body = '<body><joint type="free" {}/><geom type="box" size="0.1 0.2 0.3"/></body>'
    with pytest.warns(UserWarning, match="armature of a free joint .*, dry friction of a free joint "):
        model = pc.Scene.from_mjcf(written(tmp_path, file(body.format('armature="1" frictionloss="2"')))).model
    assert_same(model, Peer(written(tmp_path, file(body.format("")))))


def test_passive_tendons_and_actuators_are_nothing_to_warn_of(tmp_path):
    more = TENDON.format("") + '<actuator><motor tendon="t"/></actuator>'
    scene, peer = read(tmp_path, file(arm(), after=more))
    assert_same(scene.model, peer)


FLEX = '<flexcomp name="f" type="grid" count="2 2 2" spacing="1 1 1" dim="3"/>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (file(arm('elasticity="2"')), "cannot be read as an MJCF: .*'elasticity' Element 'joint', line 5"),
        (file(arm(), '<asset><mesh file="lost.stl"/></asset>'), "cannot be read as an MJCF: .*lost.stl"),
        (file(arm() + FLEX), "flex 'f' is no rigid body"),
        (file(arm(), '<option gravity="0 0 nan"/>'), "gravity must be 3 finite numbers"),
        (file(arm(body='quat="1 0 nan 0"')), r"body 'arm': quat cannot be \[.* nan"),
        (file(arm('range="nan 1" limited="true"')), r"joint 'elbow': range cannot be \[nan"),
        (file(arm('damping="inf"')), "joint 'elbow': damping cannot be inf"),
        (file(arm('armature="-1"')), "joint 'elbow': armature cannot be -1"),
        (file(arm('frictionloss="-1"')), "joint 'elbow': frictionloss cannot be -1"),
        (file(arm(), after='<keyframe><key name="k" qpos="nan"/></keyframe>'), r"key 'k': qpos cannot be \[nan"),
        (file(arm(parts='<body/><body name="body_2"/>')), "a body without a name is called 'body_2', as another is"),
        (file(arm(parts='<body name="universe"/>')), "named 'universe', which is the name of the world"),
    ],
)
def test_what_is_refused(tmp_path, text, message):
    with pytest.raises(pc.ModelError, match=message) as raised:
        pc.Scene.from_mjcf(written(tmp_path, text))
    assert "\n" not in str(raised.value)


def test_mujoco_is_an_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.delitem(sys.modules, "pincontact.mjcf", raising=False)
    monkeypatch.delattr(pc, "mjcf", raising=False)
    with pytest.raises(pc.MissingExtraError, match=r'pip install "pincontact\[mjcf\]"'):
        pc.Scene.from_mjcf(written(tmp_path, file(arm())))


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
    corners = np.asarray(mesh.geometry.vertices()) @ mesh.placement.rotation.T + mesh.placement.translation
    # in the frame of the joint, which is at (0.3, 0.2, 0.1); vertices are in single precision
    np.testing.assert_allclose(corners.max(axis=0), [1.7, 1.8, 1.9], rtol=0.0, atol=1e-6)
    found = scene.add_contours_from_collision()
    assert found["world_0_plane"].frame == "universe" and isinstance(found["world_0_plane"].contour, pc.Plane)
    assert found["arm_1_sphere"].frame == "arm"
    assert_same_shapes(scene, peer)


@pytest.mark.parametrize("seed", range(6))
def test_floors_are_where_mujoco_touches_them(tmp_path, seed):
    """A plane becomes a contour without ends: gap, normal and contact point beneath a ball are those of MuJoCo."""
    rng = np.random.default_rng(seed)
    turn, where = rng.uniform(-60.0, 60.0, 3), rng.normal(size=3)
    tilt = f'pos="{where[0]} {where[1]} {where[2]}" euler="{turn[0]} {turn[1]} {turn[2]}"'
    # a size that ends far from the ball: it is for the picture alone
    world = f'<geom name="floor" type="plane" size="0.1 0.1 1" {tilt}/>'
    ball = '<body name="ball"><freejoint/><geom size="0.2" pos="0.05 0 0.02"/></body>'
    path = written(tmp_path, file(world + ball, angle="degree"))
    scene = pc.Scene.from_mjcf(path)
    found = scene.add_contours_from_collision()
    scene.add_contact("ball/floor", found["ball_0_sphere"], found["world_0_plane"])
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    floor = pin.SE3(data.geom("floor").xmat.reshape(3, 3), data.geom("floor").xpos)
    # over the floor, far from its origin, a little inside
    pose = pin.SE3(pin.exp3(rng.normal(size=3)), np.zeros(3))
    offset = pose.rotation @ np.array([0.05, 0.0, 0.02])
    pose.translation = floor.act(np.array([*rng.uniform(2.0, 5.0, 2), 0.2 - 1e-3])) - offset
    q = pin.SE3ToXYZQUAT(pose)
    data.qpos[:] = [*q[:3], q[6], *q[3:6]]
    mujoco.mj_forward(model, data)
    (touch,) = data.contact
    state = scene.initial_state(q)
    assert state.correction.gaps["ball/floor"] == pytest.approx(touch.dist, abs=ROUNDING * 10.0)
    at = pc.analyze(scene, state)["ball/floor"]
    np.testing.assert_allclose(at.frame[:, 2], touch.frame[:3], rtol=0.0, atol=ROUNDING)
    # half the depth is corrected along the normal, or all of it, by what moves: the ball
    across = (at.point - touch.pos) - ((at.point - touch.pos) @ touch.frame[:3]) * touch.frame[:3]
    assert norm(across) < 1e-3 * 0.3
    assert abs((at.point - floor.translation) @ floor.rotation[:, 2]) < 1e-12 * 10.0


def test_shapes_that_cannot_be_read_are_named(tmp_path):
    path = written(tmp_path, file(arm(parts='<geom size="0.1"/>') + '<geom type="hfield" hfield="h"/>', HILL))
    with pytest.warns(UserWarning, match="hfield"):
        scene = pc.Scene.from_mjcf(path)
    with pytest.warns(UserWarning, match=r"could not be read: geom 'geom_0' \(hfield\)"):
        assert list(scene.add_contours_from_collision()) == ["arm_0_sphere"]
