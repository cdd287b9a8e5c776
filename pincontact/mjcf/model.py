"""The Pinocchio model of an MJCF file: bodies, joints, inertias, limits, damping and friction of joints."""

from __future__ import annotations

from dataclasses import dataclass, field
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ..errors import ModelError
from .document import Document, Element, turned, unit, z_turned_to
from .inertia import Geom, body_inertia, read_geom

_GRAVITY = (0.0, 0.0, -9.81)
_JOINT_TYPES = ("hinge", "slide", "ball", "free")
_AXIS_JOINTS = {
    "hinge": (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ),
    "slide": (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ),
}
_ANY_AXIS = {"hinge": pin.JointModelRevoluteUnaligned, "slide": pin.JointModelPrismaticUnaligned}
# Attributes that name what an equality constraint is about.
_PARTNERS = ("body1", "site1", "joint1", "tendon1", "flex")
# Elements of bodies that do not bear on the motion.
_UNMOVING = ("camera", "light")


@dataclass(eq=False)
class Body:
    """A body of the model, or the world. placement: of the body in its joint; frame: its index among the frames."""

    name: str
    joint: int = 0
    frame: int = 0
    placement: pin.SE3 = field(default_factory=pin.SE3.Identity)
    inertia: pin.Inertia | None = None
    geoms: list[Geom] = field(default_factory=list)


# A body's element, its parent, the placement of its surroundings in the parent, and their default class.
_Pending = tuple[ElementTree.Element, Body, pin.SE3, "str | None"]


class Builder:
    """Makes `model` and `bodies` (the world first) from a document.

    The configuration is MuJoCo's, with quaternions in Pinocchio's order: the `ref` of a joint is in its placement.
    """

    def __init__(self, document: Document) -> None:
        self.document = document
        self.model = pin.Model()
        self.model.name = document.root.get("model", "")
        self.bodies = [Body("world")]
        self._start: list[np.ndarray] = []
        worlds = document.root.findall("worldbody")
        waiting: list[_Pending] = []
        for world in worlds:
            document.element(world)
            waiting += self._contents(world, self.bodies[0], pin.SE3.Identity(), None)
        waiting.reverse()
        while waiting:
            waiting += reversed(self._add_body(*waiting.pop()))
        if len(self.bodies) == 1:
            raise ModelError(f"{document.file} cannot be read as an MJCF: no body found")
        self._append_inertias()
        self._set_gravity()
        self._set_configurations()

    # ------------------------------------------------------------------------------------------------ bodies

    def _add_body(
        self, node: ElementTree.Element, parent: Body, surroundings: pin.SE3, childclass: str | None
    ) -> list[_Pending]:
        """Add a body; returns its children."""
        element = self.document.element(node)
        childclass = self._childclass(node, element.what, childclass)
        placement = surroundings * element.placement()
        # without a name: its number in MuJoCo
        body = Body(element.text("name", f"body_{len(self.bodies)}"))
        if self.model.existFrame(body.name, pin.FrameType.BODY) or body.name == "world":
            raise element.error("there is another body of this name")
        # every element of the body, those within <frame> with the placement of that
        own: list[tuple[ElementTree.Element, pin.SE3, str | None]] = []
        children = self._contents(node, body, pin.SE3.Identity(), childclass, own)
        self._add_joints(body, parent, placement, own)
        body.frame = self.model.addBodyFrame(body.name, body.joint, body.placement, body.frame)
        inertial = node.find("inertial")
        given = None if inertial is None else self.document.element(inertial, body.name)
        self._add_parts(body, own)
        # what is fixed to the world does not move, but counts where the masses are scaled
        if body.joint != 0 or self.document.compiler.has("settotalmass"):
            body.inertia = body_inertia(self.document, element.what, given, body.geoms, element.placement())
        if element.number("gravcomp") != 0.0 and not self.document.off("gravity"):
            self.document.leave_out("gravity compensation", element.what)
        self.bodies.append(body)
        return children

    def _contents(
        self,
        node: ElementTree.Element,
        body: Body,
        surroundings: pin.SE3,
        childclass: str | None,
        own: list[tuple[ElementTree.Element, pin.SE3, str | None]] | None = None,
    ) -> list[_Pending]:
        """The child bodies in a body's element, or in a <frame> of it; its other elements are put into own, or into
        the world."""
        children: list[_Pending] = []
        elements: list[tuple[ElementTree.Element, pin.SE3, str | None]] = [] if own is None else own
        for item in node:
            if item.tag == "body":
                children.append((item, body, surroundings, childclass))
            elif item.tag == "frame":
                frame = self.document.element(item)
                inner = self._childclass(item, frame.what, childclass)
                children += self._contents(item, body, surroundings * frame.placement(), inner, elements)
            elif item.tag == "inertial" and node.tag == "frame":
                # versions of MuJoCo differ in whether it is moved by the frame
                raise ModelError(f"{self.document.file}: body {body.name!r} has its <inertial> within a <frame>")
            elif item.tag in ("joint", "freejoint", "inertial", "geom", "site"):
                elements.append((item, surroundings, childclass))
            elif item.tag == "plugin":
                self.document.leave_out("plugin", f"body {body.name!r}")
            elif item.tag not in _UNMOVING:
                raise ModelError(f"{self.document.file}: <{item.tag}> in body {body.name!r} cannot be read")
        if own is None:
            for item, _, _ in elements:
                if item.tag not in ("geom", "site"):
                    raise ModelError(f"{self.document.file}: the world has a <{item.tag}>")
            self._add_parts(body, elements)
        return children

    def _childclass(self, node: ElementTree.Element, what: str, childclass: str | None) -> str | None:
        given = node.get("childclass")
        if given is not None:
            self.document.check_class(given, what)
        return childclass if given is None else given

    def _add_parts(self, body: Body, own: list[tuple[ElementTree.Element, pin.SE3, str | None]]) -> None:
        """Geoms and sites."""
        for item, surroundings, childclass in own:
            if item.tag == "geom":
                element = self.document.element(item, body.name, childclass)
                body.geoms.append(read_geom(element, surroundings))
            elif item.tag == "site" and item.get("name"):
                element = self.document.element(item, body.name, childclass)
                if self.model.existFrame(element.text("name"), pin.FrameType.OP_FRAME):
                    raise element.error("there is another site of this name")
                placement = body.placement * surroundings * _site_placement(element)
                frame = pin.Frame(element.text("name"), body.joint, body.frame, placement, pin.FrameType.OP_FRAME)
                self.model.addFrame(frame)

    # ------------------------------------------------------------------------------------------------ joints

    def _add_joints(
        self,
        body: Body,
        parent: Body,
        placement: pin.SE3,
        own: list[tuple[ElementTree.Element, pin.SE3, str | None]],
    ) -> None:
        """The body's joints, one after the other; sets its joint, its placement and the frame before its own."""
        joints = [entry for entry in own if entry[0].tag in ("joint", "freejoint")]
        body.joint, body.frame, body.placement = parent.joint, parent.frame, parent.placement * placement
        for number, (item, surroundings, childclass) in enumerate(joints):
            element = self.document.element(item, body.name, childclass)
            kind = "free" if item.tag == "freejoint" else element.choice("type", _JOINT_TYPES, "hinge")
            # names that Pinocchio's own reader would give
            name = element.text("name") or (f"{body.name}_free" if kind == "free" else f"{body.name}Joint_{number}")
            if self.model.existJointName(name):
                raise element.error(f"there is another joint named {name!r}")
            if kind == "free":
                if len(joints) > 1 or parent is not self.bodies[0]:
                    raise element.error("only a body of the world can move freely, and has no other joint then")
                # its coordinates are the pose in the world
                self._start.append(pin.SE3ToXYZQUAT(body.placement))
                model, at, anchor = pin.JointModelFreeFlyer(), pin.SE3.Identity(), np.zeros(3)
            else:
                anchor = surroundings.act(element.numbers("pos", 3, 3, (0.0, 0.0, 0.0)))
                model, offset = self._joint_model(element, kind, surroundings)
                at = body.placement * pin.SE3(np.eye(3), anchor) * offset
            body.joint = self.model.addJoint(body.joint, model, at, name)
            body.frame = self.model.addJointFrame(body.joint, body.frame)
            body.placement = pin.SE3(np.eye(3), -anchor)
            self._set_forces(element, kind)

    def _joint_model(self, element: Element, kind: str, surroundings: pin.SE3) -> tuple[pin.JointModel, pin.SE3]:
        """The joint's model, and the offset that makes its coordinate `ref` where the file has the body."""
        if kind == "ball":
            self._start.append(np.array([0.0, 0.0, 0.0, 1.0]))
            return pin.JointModelSpherical(), pin.SE3.Identity()
        axis = surroundings.rotation @ unit(element, "axis", element.numbers("axis", 3, 3, (0.0, 0.0, 1.0)))
        ref = element.number("ref") * (self.document.angle if kind == "hinge" else 1.0)
        self._start.append(np.array([ref]))
        offset = pin.SE3.Identity()
        if ref != 0.0 and kind == "hinge":
            offset.rotation = turned(axis, -ref)
        elif ref != 0.0:
            offset.translation = -ref * axis
        for unit_axis, make in zip(np.eye(3), _AXIS_JOINTS[kind]):
            if (axis == unit_axis).all():
                return make(), offset
        return _ANY_AXIS[kind](axis), offset

    def _set_forces(self, element: Element, kind: str) -> None:
        """Limits, damping, armature and dry friction of the last joint."""
        document, model = self.document, self.model
        if element.tag == "freejoint":
            if element.choice("align", ("true", "false", "auto"), "auto") == "true" or (
                element.text("align", "auto") == "auto" and document.compiler.flag("alignfree")
            ):
                document.leave_out("align", element.what)
            return
        joint = model.joints[model.njoints - 1]
        of_v = slice(joint.idx_v, joint.idx_v + joint.nv)
        off = document.off
        forceless = off("passive")
        damping = element.numbers("damping", 1, 3, (0.0,))
        if damping[1:].any():
            document.leave_out("nonlinear damping", element.what)
        if not (forceless or off("damper")):
            model.damping[of_v] = damping[0]
        if any(element.numbers("stiffness", 1, 3)) and not (forceless or off("spring")):
            document.leave_out("stiffness", element.what)
        if any(element.numbers("springdamper", 2, 2)):
            document.leave_out("springdamper", element.what)
        armature = element.not_negative("armature")
        friction = 0.0 if off("constraint") or off("frictionloss") else element.not_negative("frictionloss")
        if kind == "free" and (armature or friction):
            raise element.error(
                "armature and frictionloss of a free joint are along the axes of the world, which Pinocchio's free "
                "flyer cannot have; use <freejoint>, which has none"
            )
        model.armature[of_v] = armature
        model.upperDryFrictionLimit[of_v], model.lowerDryFrictionLimit[of_v] = friction, -friction
        if kind == "free":
            return
        scale = 1.0 if kind == "slide" else document.angle
        limits = self._range(element, "range", "limited", kind == "ball")
        if limits is not None and not (off("constraint") or off("limit")):
            if kind == "ball":
                document.leave_out("range of a ball", element.what)
            else:
                model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q] = scale * limits
        effort = None if kind == "ball" else self._range(element, "actuatorfrcrange", "actuatorfrclimited", False)
        if effort is not None:
            model.lowerEffortLimit[joint.idx_v], model.upperEffortLimit[joint.idx_v] = effort

    def _range(self, element: Element, name: str, limited: str, may_be_equal: bool) -> np.ndarray | None:
        """(low, high) where the attribute is in force."""
        wanted = element.choice(limited, ("true", "false", "auto"), "auto")
        ends = element.numbers(name, 2, 2, (0.0, 0.0))
        if wanted == "false" or (wanted == "auto" and not ends.any()):
            return None
        if wanted == "auto":
            if not self.document.compiler.flag("autolimits", True):
                raise element.error(f"{name} is given but not {limited}, and the compiler's autolimits is false")
            if not ends[0] < ends[1]:
                return None
        if not (ends[0] < ends[1] or may_be_equal):
            raise element.error(f"{name} must increase, got {element.text(name)!r}")
        return ends

    # ------------------------------------------------------------------------------------------------ the whole

    def _append_inertias(self) -> None:
        compiler = self.document.compiler
        total = compiler.number("settotalmass", -1.0)
        masses = sum(body.inertia.mass for body in self.bodies if body.inertia is not None)
        scale = total / masses if total > 0.0 and masses > 0.0 else 1.0
        for body in self.bodies:
            if body.inertia is None or body.joint == 0:
                continue
            inertia = body.inertia
            if scale != 1.0:
                inertia = pin.Inertia(scale * inertia.mass, inertia.lever, scale * inertia.inertia)
            self.model.appendBodyToJoint(body.joint, inertia, body.placement)

    def _set_gravity(self) -> None:
        gravity = self.document.option.numbers("gravity", 3, 3, _GRAVITY)
        self.model.gravity.linear = np.zeros(3) if self.document.off("gravity") else gravity

    def _set_configurations(self) -> None:
        configurations = self.model.referenceConfigurations
        configurations["qpos0"] = np.concatenate([*self._start, np.zeros(0)])
        for node in self.document.sections("keyframe"):
            element = self.document.element(node)
            if element.has("name") and element.has("qpos"):
                configurations[element.text("name")] = self._configuration(element)

    def _configuration(self, key: Element) -> np.ndarray:
        """qpos of a key frame with its quaternions normalised, in Pinocchio's order."""
        q = key.numbers("qpos", self.model.nq, self.model.nq)
        start = 0
        for part in self._start:
            first = start + part.size - 4
            if part.size > 1:
                w, x, y, z = unit(key, "qpos", q[first : first + 4])
                q[first : first + 4] = x, y, z, w
            start += part.size
        return q


def _site_placement(element: Element) -> pin.SE3:
    if not element.has("fromto"):
        return element.placement()
    ends = element.numbers("fromto", 6, 6).reshape(2, 3)
    return pin.SE3(z_turned_to(unit(element, "fromto", ends[0] - ends[1])), 0.5 * (ends[0] + ends[1]))


def note_forces(document: Document) -> None:
    """Note what makes forces and is no part of a Pinocchio model, other than what bodies and joints say themselves."""
    off = document.off
    constraints, passive = not off("constraint"), not off("passive")
    for name in ("density", "viscosity"):
        if document.option.not_negative(name) != 0.0 and passive:
            document.leave_out("fluid forces", f"option {name}")
    for node in document.sections("equality"):
        owner = next((node.get(name, "") for name in _PARTNERS if node.get(name)), "")
        element = document.element(node, owner, kind="equality")
        if element.flag("active", True) and constraints and not off("equality"):
            document.leave_out("equality constraint", element.what)
    for node in document.sections("tendon"):
        element = document.element(node, kind="tendon")
        acting = [name for name in ("stiffness", "damping", "frictionloss", "armature") if _some(element, name)]
        if element.text("limited", "auto") != "false" and (_some(element, "range") or element.has("limited")):
            acting.append("range")
        for name in acting:
            document.leave_out(f"{name} of a tendon", element.what)
    for node in document.sections("actuator"):
        element = document.element(node, kind="actuator")
        for name in ("armature", "damping"):
            if _some(element, name):
                document.leave_out(f"{name} of an actuator", element.what)


def _some(element: Element, name: str) -> bool:
    return bool(element.numbers(name, 1, 16).any()) if element.has(name) else False
