"""Models and shapes of MJCF files, made from the arrays of MuJoCo's compiled model.

Joints, and so q and v, keep its order. What makes forces there and is no part of a Pinocchio model is named.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

import coal
import mujoco
import numpy as np
import pinocchio as pin

from .errors import ModelError

_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
_MESH, _PLANE = int(mujoco.mjtGeom.mjGEOM_MESH), int(mujoco.mjtGeom.mjGEOM_PLANE)
# Of slides and of hinges: about or along x, y, z, and any axis.
_AXIS_JOINTS = {
    True: (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ, pin.JointModelPrismaticUnaligned),
    False: (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ, pin.JointModelRevoluteUnaligned),
}
# Sizes are radii and half lengths.
_SHAPES = {
    _PLANE: lambda size: coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0),
    int(mujoco.mjtGeom.mjGEOM_SPHERE): lambda size: coal.Sphere(size[0]),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): lambda size: coal.Capsule(size[0], 2.0 * size[1]),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): lambda size: coal.Cylinder(size[0], 2.0 * size[1]),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): lambda size: coal.Ellipsoid(*size),
    int(mujoco.mjtGeom.mjGEOM_BOX): lambda size: coal.Box(*(2.0 * size)),
}
# Actuators of biases up to this one follow a command.
_SERVO = int(mujoco.mjtBias.mjBIAS_AFFINE)
# Geoms of higher groups are for contacts alone, by a habit of those who write such files.
_LAST_DRAWN_GROUP = 2
# MuJoCo's own colour of a geom, which gives way to that of its material.
_NO_COLOUR = (0.5, 0.5, 0.5, 1.0)
# What is read, by kind of element: MuJoCo lets through what is not finite.
_READ = {
    "body": ("body_pos", "body_quat", "body_mass", "body_ipos", "body_iquat", "body_inertia"),
    "joint": ("jnt_pos", "jnt_axis", "jnt_range", "jnt_actfrcrange"),
    "dof": ("dof_damping", "dof_armature", "dof_frictionloss"),
    "geom": ("geom_pos", "geom_quat", "geom_size"),
    "site": ("site_pos", "site_quat"),
    "key": ("key_qpos",),
}


class Body(NamedTuple):
    """placement: of the body in its joint; frame: its index among the frames."""

    name: str
    joint: int
    frame: int
    placement: pin.SE3


class Built(NamedTuple):
    """left_out: effects, each with the elements that have it. unread: shapes, visual and collision."""

    model: pin.Model
    shapes: list[pin.GeometryModel]
    left_out: dict[str, list[str]]
    unread: list[list[str]]


def read(file: str) -> Built:
    """Raises ModelError for what MuJoCo's compiler refuses, and for what has no rigid model."""
    try:
        compiled = mujoco.MjModel.from_xml_path(file)
    except ValueError as error:
        raise ModelError(f"{file} cannot be read as an MJCF: {' '.join(str(error).split())}") from error
    _check(file, compiled)
    model, bodies = _model(compiled)
    shapes, unread = _shapes(compiled, bodies)
    left_out = {effect: owners for effect, owners in _left_out(compiled) if owners}
    return Built(model, shapes, left_out, unread)


def _check(file: str, m: Any) -> None:
    if m.nbody == 1:
        raise ModelError(f"{file} cannot be read as an MJCF: no body found")
    for flex in np.flatnonzero(m.flex_rigid == 0):
        raise ModelError(f"{file}: flex {_name(m, 'flex', int(flex))!r} is no rigid body, and cannot be read")
    for kind, count in (("body", m.nbody), ("joint", m.njnt)):
        name, times = Counter(_name(m, kind, i) for i in range(count)).most_common(1)[0] if count else ("", 1)
        if times > 1:
            raise ModelError(f"{file}: a {kind} without a name is called {name!r}, as another is; give it a name")
    if not np.isfinite(m.opt.gravity).all():
        raise ModelError(f"{file}: gravity must be 3 finite numbers, got {m.opt.gravity}")
    for kind, arrays in _READ.items():
        for array in arrays:
            values = getattr(m, array)
            wrong = ~np.isfinite(values)
            if array in ("dof_armature", "dof_frictionloss"):
                wrong |= values < 0.0
            for row in np.argwhere(wrong)[:1, 0]:
                owner = _owner(m, *(("joint", m.dof_jntid[row]) if kind == "dof" else (kind, row)))
                raise ModelError(f"{file}: {owner}: {array.partition('_')[2]} cannot be {values[row]}")


def _name(m: Any, kind: str, index: int) -> str:
    """An element's name; for one without, its kind and number, or what Pinocchio's own reader would call a joint."""
    name = mujoco.mj_id2name(m, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), index)
    if name or kind != "joint":
        return str(name or f"{kind}_{index}")
    body = m.jnt_bodyid[index]
    ending = "_free" if m.jnt_type[index] == _FREE else f"Joint_{index - m.body_jntadr[body]}"
    return _name(m, "body", body) + ending


def _owner(m: Any, kind: str, index: int) -> str:
    name = _name(m, kind, index)
    if kind == "equality" and name == f"{kind}_{index}":
        # one without a name is known by what it is about
        of = mujoco.mj_id2name(m, m.eq_objtype[index], m.eq_obj1id[index])
        return f"a {mujoco.mjtEq(m.eq_type[index]).name.removeprefix('mjEQ_').lower()} of {of!r}"
    return f"{kind} {name!r}"


def _pose(position: np.ndarray, quaternion: np.ndarray) -> pin.SE3:
    """quaternion: MuJoCo's, the real part first."""
    return pin.SE3(pin.Quaternion(*quaternion.tolist()).normalized().matrix(), np.array(position))


def _shift(vector: np.ndarray) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(vector))


def _model(m: Any) -> tuple[pin.Model, list[Body]]:
    model = pin.Model()
    model.name = m.names.split(b"\0", 1)[0].decode()
    bodies = [Body("world", 0, 0, pin.SE3.Identity())]
    for i in range(1, m.nbody):
        _, joint, frame, within = bodies[m.body_parentid[i]]
        placement = within * _pose(m.body_pos[i], m.body_quat[i])
        for j in range(m.body_jntadr[i], m.body_jntadr[i] + m.body_jntnum[i]):
            made, at, placement = _joint(m, j, placement)
            joint = model.addJoint(joint, made, at, _name(m, "joint", j))
            frame = model.addJointFrame(joint, frame)
        name = _name(m, "body", i)
        bodies.append(Body(name, joint, model.addBodyFrame(name, joint, placement, frame), placement))
        if joint != 0:
            principal = _pose(m.body_ipos[i], m.body_iquat[i])
            inertia = pin.Inertia(m.body_mass[i], np.zeros(3), np.diag(m.body_inertia[i]))
            model.appendBodyToJoint(joint, inertia, placement * principal)
    for i in range(m.nsite):
        if m.site(i).name:
            body = bodies[m.site_bodyid[i]]
            placement = body.placement * _pose(m.site_pos[i], m.site_quat[i])
            model.addFrame(pin.Frame(m.site(i).name, body.joint, body.frame, placement, pin.FrameType.OP_FRAME))
    model.gravity.linear = np.array(m.opt.gravity) if _on(m, "GRAVITY") else np.zeros(3)
    _set_forces(m, model)
    configurations = model.referenceConfigurations
    configurations["qpos0"] = _configuration(m, m.qpos0)
    for i in range(m.nkey):
        if m.key(i).name:
            configurations[m.key(i).name] = _configuration(m, m.key_qpos[i])
    return model, bodies


def _joint(m: Any, j: int, body: pin.SE3) -> tuple[pin.JointModel, pin.SE3, pin.SE3]:
    """A joint's model, its placement, and that of its body in it.

    body: where the body is in the joint before this one while this one is where the file has it.
    """
    kind, anchor, axis, ref = m.jnt_type[j], m.jnt_pos[j], m.jnt_axis[j], m.qpos0[m.jnt_qposadr[j]]
    if kind == _FREE:
        # its coordinates are the pose in the world
        return pin.JointModelFreeFlyer(), pin.SE3.Identity(), pin.SE3.Identity()
    at = body * _shift(anchor)
    if kind == _BALL:
        return pin.JointModelSpherical(), at, _shift(-anchor)
    if ref != 0.0:
        # the coordinate is `ref` where the file has the body
        at *= _shift(-ref * axis) if kind == _SLIDE else pin.SE3(pin.AngleAxis(-ref, axis).matrix(), np.zeros(3))
    *aligned, unaligned = _AXIS_JOINTS[kind == _SLIDE]
    for unit, make in zip(np.eye(3), aligned):
        if (axis == unit).all():
            return make(), at, _shift(-anchor)
    return unaligned(np.array(axis)), at, _shift(-anchor)


def _set_forces(m: Any, model: pin.Model) -> None:
    """Limits, damping, armature and dry friction."""
    axes = m.jnt_type[m.dof_jntid] != _FREE
    friction = m.dof_frictionloss * (axes & _on(m, "CONSTRAINT", "FRICTIONLOSS"))
    model.damping = m.dof_damping * _on(m, "DAMPER", "PASSIVE")
    model.armature = m.dof_armature * axes
    model.upperDryFrictionLimit, model.lowerDryFrictionLimit = friction, -friction
    one = (m.jnt_type != _FREE) & (m.jnt_type != _BALL)
    limited = (m.jnt_limited != 0) & one & _on(m, "CONSTRAINT", "LIMIT")
    q, v = m.jnt_qposadr[limited], m.jnt_dofadr[(m.jnt_actfrclimited != 0) & one]
    model.lowerPositionLimit[q], model.upperPositionLimit[q] = m.jnt_range[limited].T
    model.lowerEffortLimit[v], model.upperEffortLimit[v] = m.jnt_actfrcrange[m.dof_jntid[v]].T


def _configuration(m: Any, qpos: np.ndarray) -> np.ndarray:
    """qpos with its quaternions in Pinocchio's order."""
    q = np.array(qpos)
    for kind, start in zip(m.jnt_type, m.jnt_qposadr):
        if kind in (_FREE, _BALL):
            first = start + 3 * (kind == _FREE)
            w, x, y, z = q[first : first + 4]
            q[first : first + 4] = np.array([x, y, z, w]) / np.linalg.norm([x, y, z, w])
    return q


def _on(m: Any, *forces: str) -> bool:
    """Whether none of these kinds of forces is switched off. Versions of MuJoCo differ in what can be."""
    bits = [getattr(mujoco.mjtDisableBit, f"mjDSBL_{force}", 0) for force in forces]
    return not any(m.opt.disableflags & int(bit) for bit in bits)


def _left_out(m: Any) -> Iterator[tuple[str, list[str]]]:
    """What makes forces and is no part of a Pinocchio model, each with the elements that have it."""

    def some(*arrays: str) -> np.ndarray:
        # those of later versions are not there in others
        return np.concatenate([np.argwhere(getattr(m, array, ()))[:, 0] for array in arrays])

    constraints, springs, dampers = _on(m, "CONSTRAINT"), _on(m, "SPRING", "PASSIVE"), _on(m, "DAMPER", "PASSIVE")
    limits, friction = constraints and _on(m, "LIMIT"), constraints and _on(m, "FRICTIONLOSS")
    ball, free = m.jnt_type == _BALL, m.jnt_type[m.dof_jntid] == _FREE
    for effect, kind, acts, having in (
        ("stiffness", "joint", springs, some("jnt_stiffness", "jnt_stiffnesspoly")),
        ("nonlinear damping", "joint", dampers, m.dof_jntid[some("dof_dampingpoly")]),
        ("range of a ball", "joint", limits, np.flatnonzero(ball & (m.jnt_limited != 0))),
        # along the axes of the world, which those of a free flyer are not
        ("armature of a free joint", "joint", True, m.dof_jntid[free & (m.dof_armature != 0.0)]),
        ("dry friction of a free joint", "joint", friction, m.dof_jntid[free & (m.dof_frictionloss != 0.0)]),
        ("gravity compensation", "body", _on(m, "GRAVITY"), some("body_gravcomp")),
        ("motion from outside (mocap)", "body", True, np.flatnonzero(m.body_mocapid >= 0)),
        ("plugin", "body", springs or dampers, np.flatnonzero(m.body_plugin >= 0)),
        ("equality constraint", "equality", constraints and _on(m, "EQUALITY"), some("eq_active0")),
        ("stiffness of a tendon", "tendon", springs, some("tendon_stiffness", "tendon_stiffnesspoly")),
        ("damping of a tendon", "tendon", dampers, some("tendon_damping", "tendon_dampingpoly")),
        ("dry friction of a tendon", "tendon", friction, some("tendon_frictionloss")),
        ("range of a tendon", "tendon", limits, some("tendon_limited")),
        ("armature of a tendon", "tendon", True, some("tendon_armature")),
        ("armature of an actuator", "actuator", True, some("actuator_armature")),
        ("damping of an actuator", "actuator", dampers, some("actuator_damping", "actuator_dampingpoly")),
        ("passive force of an actuator", "actuator", _on(m, "ACTUATION"), np.flatnonzero(m.actuator_biastype > _SERVO)),
    ):
        yield effect, [_owner(m, kind, i) for i in np.unique(having)] if acts else []
    fluid = [f"option {name}" for name in ("density", "viscosity") if getattr(m.opt, name) != 0.0]
    yield "fluid forces", fluid if springs or dampers else []


def _shapes(m: Any, bodies: list[Body]) -> tuple[list[pin.GeometryModel], list[list[str]]]:
    """Visual and collision shapes, named after their body and numbered, and those of each that could not be read.

    A geom that touches nothing (contype and conaffinity 0) is no collision shape; one of a group above 2 is not drawn;
    planes are not drawn, and half-spaces to collide with.
    """
    models = [pin.GeometryModel(), pin.GeometryModel()]
    unread: list[list[str]] = [[], []]
    numbers: Counter[tuple[int, str]] = Counter()
    meshes: dict[int, coal.BVHModelOBBRSS] = {}
    for i in range(m.ngeom):
        kind, of, body = m.geom_type[i], m.geom_dataid[i], bodies[m.geom_bodyid[i]]
        word = mujoco.mjtGeom(kind).name.removeprefix("mjGEOM_")
        shape = _SHAPES[kind](m.geom_size[i]) if kind in _SHAPES else None
        if kind == _MESH:
            shape = meshes[of] = meshes.get(of) or _mesh(m, of)
        colour = m.geom_rgba[i]
        if m.geom_matid[i] >= 0 and (colour == _NO_COLOUR).all():
            colour = m.mat_rgba[m.geom_matid[i]]
        placement = body.placement * _pose(m.geom_pos[i], m.geom_quat[i])
        collides = bool(m.geom_contype[i] or m.geom_conaffinity[i])
        drawn = (not collides or m.geom_group[i] <= _LAST_DRAWN_GROUP) and kind != _PLANE
        for use in [use for use, wanted in enumerate((drawn, collides)) if wanted]:
            if shape is None:
                unread[use].append(f"{_owner(m, 'geom', i)} ({word.lower()})")
                continue
            name, look = f"{body.name}_{numbers[use, body.name]}", (word, np.ones(3), True, colour.astype(float))
            item = pin.GeometryObject(name, body.joint, body.frame, placement, shape, *look)
            models[use].addGeometryObject(item)
            numbers[use, body.name] += 1
    return models, unread


def _mesh(m: Any, of: int) -> coal.BVHModelOBBRSS:
    vertices = m.mesh_vert[m.mesh_vertadr[of] :][: m.mesh_vertnum[of]].astype(float)
    faces = m.mesh_face[m.mesh_faceadr[of] :][: m.mesh_facenum[of]].astype(np.int64)
    made = coal.BVHModelOBBRSS()
    made.beginModel(len(faces), len(vertices))
    made.addVertices(vertices)
    made.addTriangles(faces)
    made.endModel()
    return made
