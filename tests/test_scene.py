"""Scenes: what is inferred, in whose order and axes results come, and that coordinates do not matter."""

import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

G = 9.81
MASS, RADIUS, LEAN = 1.0, 0.5, 1.1
MOMENTS = MASS * RADIUS**2 * np.array([0.25, 0.25, 0.5])

DISK_URDF = """<?xml version="1.0"?>
<robot name="disk">
  <link name="disk">
    <inertial>
      <origin xyz="0 0 0"/>
      <mass value="1.0"/>
      <inertia ixx="0.0625" iyy="0.0625" izz="0.125" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
</robot>
"""


def leaning_rotation():
    return pin.utils.rotate("y", LEAN)


def rolling_velocity():
    """World velocity of the centre and angular velocity in body axes that roll on the plane z = 0."""
    rotation = leaning_rotation()
    omega = np.array([0.4, 0.3, 8.0])
    down = rotation @ np.array([RADIUS, 0.0, 0.0])  # from the centre to the lowest point
    assert down[2] < 0.0
    return -np.cross(rotation @ omega, down), omega


def start_height():
    return RADIUS * math.sin(LEAN)


# ------------------------------------------------------------------------------------------------- joints


def chain(*joints):
    model = pin.Model()
    parent = 0
    for i, joint in enumerate(joints):
        parent = model.addJoint(parent, joint, pin.SE3.Identity(), f"joint {i}")
    model.appendBodyToJoint(parent, pin.Inertia(MASS, np.zeros(3), np.diag(MOMENTS)), pin.SE3.Identity())
    model.addBodyFrame("disk", parent, pin.SE3.Identity(), 0)
    return model


def composite():
    joint = pin.JointModelComposite()
    for part in (pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ(), pin.JointModelSpherical()):
        joint.addJoint(part)
    return joint


MECHANISMS = {
    "free flyer": lambda: chain(pin.JointModelFreeFlyer()),
    "translation and quaternion": lambda: chain(pin.JointModelTranslation(), pin.JointModelSpherical()),
    "composite": lambda: chain(composite()),
    "Euler angles": lambda: chain(pin.JointModelTranslation(), pin.JointModelSphericalZYX()),
    "six single joints": lambda: chain(
        pin.JointModelPX(),
        pin.JointModelPY(),
        pin.JointModelPZ(),
        pin.JointModelRZ(),
        pin.JointModelRY(),
        pin.JointModelRZ(),
    ),
    "unbounded angles": lambda: chain(
        pin.JointModelTranslation(), pin.JointModelRUBZ(), pin.JointModelRUBY(), pin.JointModelRUBZ()
    ),
    "planar joint in between": lambda: chain(
        pin.JointModelPZ(), pin.JointModelPlanar(), pin.JointModelRY(), pin.JointModelRUBZ()
    ),
}


def fitting_coordinates(model, rotation, position, linear, angular):
    """(q, v) of a mechanism that put its body at a pose with a velocity (world, body axes), by Newton iterations."""
    data = model.createData()
    target = pin.SE3(rotation, position)
    joint = model.njoints - 1
    q = pin.integrate(model, pin.neutral(model), 0.3 * np.ones(model.nv))  # away from the angles' singular positions
    for _ in range(100):
        jacobian = pin.computeJointJacobian(model, data, q, joint)
        pin.forwardKinematics(model, data, q)
        error = pin.log6(data.oMi[joint].actInv(target)).vector
        if np.abs(error).max() < 1e-15:
            break
        step = np.linalg.solve(jacobian, error)
        q = pin.integrate(model, q, step * min(1.0, 0.5 / np.abs(step).max()))
    twist = np.concatenate([rotation.T @ linear, angular])
    return q, np.linalg.solve(pin.computeJointJacobian(model, data, q, joint), twist)


def body_poses(run):
    model = run.scene.model
    data = model.createData()
    poses = []
    for q in run.q:
        pin.forwardKinematics(model, data, q)
        poses.append(data.oMi[model.njoints - 1].homogeneous.copy())
    return np.array(poses)


def rolling_run(model, duration=2.0, friction=None, **options):
    scene = pc.Scene(model)
    rim, floor = scene.add_contour("rim", pc.Circle(RADIUS), "disk"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", rim, floor, friction=friction or pc.NoSlip())
    linear, angular = rolling_velocity()
    q, v = fitting_coordinates(model, leaning_rotation(), np.array([0.0, 0.0, start_height()]), linear, angular)
    state = scene.initial_state(q, v)
    times = np.linspace(0.0, duration, 21)
    run = pc.simulate(scene, state, duration, **({"rtol": 1e-11, "atol": 1e-13, "t_eval": times} | options))
    assert run.status == 0, run.message
    return run


@pytest.fixture(scope="module")
def free_flyer_run():
    return rolling_run(MECHANISMS["free flyer"]())


@pytest.mark.parametrize("name", list(MECHANISMS)[1:])
def test_coordinates_do_not_matter(name, free_flyer_run):
    """The same disk on seven mechanisms with the same freedom: quaternions, Euler angles, (cos, sin) pairs. Errors at
    rtol = 1e-11 are some 1e-10."""
    run = rolling_run(MECHANISMS[name]())
    assert np.abs(body_poses(run) - body_poses(free_flyer_run)).max() <= 1e-8
    force, expected = run.contacts["c"].force, free_flyer_run.contacts["c"].force
    assert np.abs(force - expected).max() <= 1e-7
    assert max(values.max() for values in run.residuals().values()) <= 1e-12


def test_normalised_configurations(free_flyer_run):
    """Quaternions and (cos, sin) pairs in every output have length one to rounding."""
    np.testing.assert_allclose(np.linalg.norm(free_flyer_run.q[:, 3:], axis=1), 1.0, rtol=0.0, atol=4e-16)
    run = rolling_run(MECHANISMS["unbounded angles"](), 0.5)
    for start in (3, 5, 7):
        np.testing.assert_allclose(np.linalg.norm(run.q[:, start : start + 2], axis=1), 1.0, rtol=0.0, atol=4e-16)


# ------------------------------------------------------------------------------------------------- files, order, frames


def test_disk_from_urdf(tmp_path, free_flyer_run):
    path = tmp_path / "disk.urdf"
    path.write_text(DISK_URDF)
    scene = pc.Scene.from_urdf(path, floating_base=True)
    rim, floor = scene.add_contour("rim", pc.Circle(RADIUS), "disk"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", rim, floor, friction=pc.NoSlip())
    state = scene.initial_state(free_flyer_run.q[0], free_flyer_run.v[0])
    run = pc.simulate(scene, state, 2.0, rtol=1e-11, atol=1e-13, t_eval=free_flyer_run.t)
    assert np.abs(run.q - free_flyer_run.q).max() <= 1e-10
    fixed = pc.Scene.from_urdf(path)
    assert fixed.model.nq == 0


def test_order_of_the_contours(free_flyer_run):
    """Naming the floor first changes whose force is reported, and nothing else."""
    scene = pc.Scene(MECHANISMS["free flyer"]())
    rim, floor = scene.add_contour("rim", pc.Circle(RADIUS), "disk"), scene.add_contour("floor", pc.Plane())
    contact = scene.add_contact("c", floor, rim, friction=pc.NoSlip(), location=(None, 0.1))
    assert contact.swapped
    assert contact.body1.name == "rim"
    state = scene.initial_state(free_flyer_run.q[0], free_flyer_run.v[0])
    on_floor, on_rim = state.location_of("c")
    assert (on_floor.size, on_rim.size) == (2, 1)
    run = pc.simulate(scene, state, 2.0, rtol=1e-11, atol=1e-13, t_eval=free_flyer_run.t)
    np.testing.assert_array_equal(run.q, free_flyer_run.q)
    one, two = free_flyer_run.contacts["c"], run.contacts["c"]
    np.testing.assert_array_equal(two.force, -one.force)
    np.testing.assert_array_equal(two.slip_velocity, -one.slip_velocity)
    np.testing.assert_array_equal(two.multipliers, -one.multipliers)
    np.testing.assert_array_equal(two.location, one.location)
    np.testing.assert_array_equal(two.location_first, one.location_second)
    np.testing.assert_array_equal(two.location_second, one.location_first)
    np.testing.assert_array_equal(two.normal_force, one.normal_force)
    # on the floor, the second one named: downwards
    assert (one.force[:, 2] < 0.0).all()
    assert (one.normal_force > 0.0).all()


def test_placements_compose():
    """A contour placed in a frame that is itself placed on the link: the same world contour, the same motion."""
    model = MECHANISMS["free flyer"]()
    offset = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.8])), np.array([0.1, 0.2, -0.3]))
    model.addFrame(pin.Frame("sensor", 1, 0, offset, pin.FrameType.OP_FRAME))
    scene = pc.Scene(model)
    rim = scene.add_contour("rim", pc.Circle(RADIUS), "sensor", offset.inverse())
    tilt = pin.SE3(pin.exp3(np.array([0.0, 0.0, 1.0])), np.array([3.0, 4.0, 0.0]))
    floor = scene.add_contour("floor", pc.Plane(), placement=tilt)
    scene.add_contact("c", rim, floor, friction=pc.NoSlip())
    plain = rolling_run(MECHANISMS["free flyer"](), 1.0)
    state = scene.initial_state(plain.q[0], plain.v[0])
    run = pc.simulate(scene, state, 1.0, rtol=1e-11, atol=1e-13, t_eval=plain.t)
    assert np.abs(run.q - plain.q).max() <= 1e-10
    assert np.abs(run.contacts["c"].point - plain.contacts["c"].point).max() <= 1e-10


def test_a_joint_without_a_frame_carries_contours():
    """`addJoint` makes no frame; a joint's name is as good as that of a frame at its origin."""
    model = MECHANISMS["free flyer"]()
    scene = pc.Scene(model)
    joint = model.names[1]
    assert not model.existFrame(joint)
    placement = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.8])), np.array([0.1, 0.2, -0.3]))
    by_joint = scene.add_contour("by joint", pc.Circle(RADIUS), joint, placement)
    by_frame = scene.add_contour("by frame", pc.Circle(RADIUS), "disk", placement)
    assert by_joint.joint == by_frame.joint == 1
    assert by_joint.placement_in_joint == by_frame.placement_in_joint


# ------------------------------------------------------------------------------------------------- inference


def planar_model(*joints):
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -G, 0.0])
    parent = 0
    for i, joint in enumerate(joints):
        parent = model.addJoint(parent, joint, pin.SE3.Identity(), f"joint {i}")
    model.appendBodyToJoint(parent, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("body", parent, pin.SE3.Identity(), 0)
    return model


IN_PLANE = (pin.JointModelPX, pin.JointModelPY, pin.JointModelRZ)


@pytest.mark.parametrize(
    ("joints", "first", "second", "pattern"),
    [
        (IN_PLANE, pc.Circle(0.2), pc.Line(), "2C-2C"),
        ((pin.JointModelPlanar,), pc.Circle(0.2), pc.Circle(1.0), "2C-2C"),
        ((pin.JointModelFreeFlyer,), pc.Circle(0.2), pc.Line(), "3C-3C"),
        (IN_PLANE, pc.Circle(0.2), pc.Helix(1.0, 0.2), "3C-3C"),
        (IN_PLANE, pc.Point(), pc.Line(), "P-2C"),
        ((pin.JointModelTranslation,), pc.Point(), pc.Line(), "P-3C"),
        (IN_PLANE, pc.Point(), pc.Helix(1.0, 0.2), "P-3C"),
        ((pin.JointModelRZ,), pc.Point(), pc.Line(), "P-2C"),
        ((pin.JointModelRX,), pc.Circle(0.2), pc.Line(), "3C-3C"),
        ((pin.JointModelFreeFlyer,), pc.Point(), pc.Sphere(1.0), "P-S"),
        ((pin.JointModelFreeFlyer,), pc.Helix(0.1, 0.2), pc.Plane(), "3C-S"),
        ((pin.JointModelFreeFlyer,), pc.Sphere(0.1), pc.Plane(), "S-S"),
    ],
)
def test_patterns_are_inferred(joints, first, second, pattern):
    scene = pc.Scene(planar_model(*(joint() for joint in joints)))
    a, b = scene.add_contour("a", first, "body"), scene.add_contour("b", second)
    assert scene.add_contact("ab", a, b).pattern.name == pattern
    assert scene.add_contact("ba", b, a).pattern.name == pattern


def test_curves_in_another_plane_are_spatial():
    """Parallel planes a centimetre apart, or planes at an angle: not planar, whatever the joints."""
    scene = pc.Scene(planar_model(*(joint() for joint in IN_PLANE)))
    wheel = scene.add_contour("wheel", pc.Circle(0.2), "body")
    for name, placement in (
        ("beside", pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.01]))),
        ("across", pin.SE3(pin.utils.rotate("x", 0.1), np.zeros(3))),
    ):
        rail = scene.add_contour(name, pc.Line(), placement=placement)
        assert scene.add_contact(name, wheel, rail).pattern.name == "3C-3C"
    assert scene.contacts["beside"].pattern.name == "3C-3C"


@pytest.mark.parametrize(
    ("shape", "ground", "placement", "height"),
    [
        (pc.Circle(0.2), pc.Line(), "below", 0.2),
        (pc.Circle(0.2), pc.Circle(1.0), "inside", -0.8),
        (pc.Circle(0.2), pc.Circle(1.0), "outside", 1.2),
        (pc.Ellipse(0.2, 0.2), pc.Ellipse(1.0, 1.0), "inside", -0.8),
    ],
)
def test_sides_are_inferred(shape, ground, placement, height):
    """A wheel on a line, inside a ring and on top of it: pressed against it by gravity in each case."""
    scene = pc.Scene(planar_model(pin.JointModelPlanar()))
    a, b = scene.add_contour("a", shape, "body"), scene.add_contour("b", ground)
    scene.add_contact("c", a, b)
    state = scene.initial_state(np.array([0.0, height, 1.0, 0.0]))
    track = pc.simulate(scene, state, 0.0).contacts["c"]
    assert track.normal_force[0] == pytest.approx(G, rel=1e-9), placement
    assert track.force[0, 1] == pytest.approx(-G, rel=1e-9)


def test_candidates_of_a_state():
    """A disk between floor and ceiling heights: both extreme points are candidates, the lower one touches."""
    scene = pc.Scene(MECHANISMS["free flyer"]())
    rim, floor = scene.add_contour("rim", pc.Circle(RADIUS), "disk"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", rim, floor)
    q = np.array([0.0, 0.0, start_height(), *pin.Quaternion(leaning_rotation()).coeffs()])
    found = scene.initial_state(q).candidates["c"]
    assert len(found) == 2
    assert found[0].gap == pytest.approx(0.0, abs=1e-15)
    assert abs(found[1].gap) == pytest.approx(2.0 * start_height(), abs=1e-12)


# ------------------------------------------------------------------------------------------------- cost and account


def test_nothing_is_solved_that_is_known(free_flyer_run):
    """Rolling without slip on a plane: closed-form location, no cone problem, no quadratic program."""
    stats = free_flyer_run.stats
    assert stats["newton"] == 0
    assert stats["closed_form"] > 0
    assert stats["cone_problems"] == 0
    assert stats["qp"] == 0
    assert stats["wall_time"] > 0.0
    slipping = rolling_run(MECHANISMS["free flyer"](), 0.5, pc.Coulomb(5.0))
    assert slipping.stats["qp"] == 0


def test_newton_is_warm():
    """A helix on a plane has no closed form: one or two evaluations of its location a stage, not a search."""
    scene = pc.Scene(MECHANISMS["free flyer"]())
    coil = scene.add_contour(
        "coil", pc.Helix(0.2, 0.3), "disk", pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    )
    floor = scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", coil, floor, friction=pc.NoSlip(), location=(-0.5 * math.pi, None))
    state = scene.initial_state(np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0]), np.array([0.1, 0.0, 0.0, 0.5, 1.0, 0.2]))
    run = pc.simulate(scene, state, 0.3)
    assert run.t.size > 3
    assert run.stats["newton"] <= 3.0 * run.stats["pinocchio"]


def test_energy_account():
    """Damped, driven by torques, on a shaken plate, with friction: the energy is what it was plus all works."""
    model = MECHANISMS["free flyer"]()
    model.damping = np.array([0.01, 0.02, 0.0, 0.03, 0.0, 0.002])
    scene = pc.Scene(model)
    rim = scene.add_contour("rim", pc.Circle(RADIUS), "disk")
    plate = scene.add_contour("plate", pc.Plane(), motion=pc.HarmonicMotion((0.05, 0.0, 0.02), 1.0))
    scene.add_contact("c", rim, plate, friction=pc.Coulomb(0.2))
    linear, angular = rolling_velocity()
    rotation = leaning_rotation()
    q = np.array([0.0, 0.0, start_height(), *pin.Quaternion(rotation).coeffs()])
    state = scene.initial_state(q, np.concatenate([rotation.T @ (linear + np.array([1.0, 0.5, 0.1])), angular]))

    def control(t, q, v):
        return np.array([0.1 * math.sin(3.0 * t), 0.0, 0.0, 0.0, 0.05, -0.1 * v[5]])

    run = pc.simulate(scene, state, 1.5, rtol=1e-10, atol=1e-12, control=control, energies=True)
    assert run.status == 0
    energies = run.energies()
    assert np.abs(energies.balance).max() <= 1e-7
    for work in (energies.friction_work, energies.drive_work, energies.torque_work, energies.damping_work):
        assert np.abs(work).max() > 1e-3
    assert np.diff(energies.damping_work).max() <= 1e-9
    np.testing.assert_allclose(energies.total, energies.kinetic + energies.potential)


def test_residuals_are_of_the_run(free_flyer_run):
    """What `residuals` says is what its own arrays say: C1 from the points of both contours."""
    track = free_flyer_run.contacts["c"]
    poses = body_poses(free_flyer_run)
    u = track.location_first[:, 0]
    on_rim = np.einsum(
        "nij,nj->ni", poses[:, :3, :3], RADIUS * np.column_stack([np.cos(u), np.sin(u), np.zeros_like(u)])
    )
    on_rim += poses[:, :3, 3]
    on_floor = np.column_stack([track.location_second, np.zeros_like(u)])
    assert np.abs(on_rim - on_floor).max() <= 1e-14
    assert np.abs(track.point - on_floor).max() <= 1e-14
    np.testing.assert_allclose(track.multipliers, np.einsum("nij,ni->nj", track.frame, track.force), atol=1e-13)
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", track.dual_frame, track.multipliers), track.force, rtol=0.0, atol=1e-12
    )


@pytest.mark.parametrize("shape", [pc.Sphere(0.1), pc.Ellipsoid(0.1, 0.12, 0.1)])
@pytest.mark.parametrize("turn", [0.0, np.pi, 0.4])
def test_contacts_at_the_poles_of_both_are_found(shape, turn):
    # one ball upon another: charts end at the poles, and the first ones meet just there
    scene = pc.Scene(planar_model(pin.JointModelFreeFlyer()))
    fixed = pin.SE3(pin.utils.rotate("x", turn), np.array([0.0, 0.0, 0.115]))
    tip = scene.add_contour("tip", pc.Sphere(0.015), placement=fixed)
    scene.add_contact("c", tip, scene.add_contour("ball", shape, "body"))
    state = scene.initial_state(pin.neutral(scene.model))
    assert pc.analyze(scene, state)["c"].gap == pytest.approx(0.0, abs=1e-14)
    assert pc.analyze(scene, state)["c"].point == pytest.approx([0.0, 0.0, 0.1], abs=1e-9)
