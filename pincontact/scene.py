"""The user's scene: a Pinocchio model, contours on its frames, contacts between contours."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from .arguments import is_number
from .collision import contours_from_collision
from .contacts import (
    Assembly,
    AttachedContour,
    Contact,
    Contours,
    check_friction,
    check_location,
    check_name,
    check_placement,
    in_order,
    in_pairs,
    may_be_beside,
    place_on_joint,
)
from .contours import Contour
from .contours.motion import Motion
from .display import html_table, shortened
from .dynamics.joints import check_model
from .errors import ArgumentError, ContactError, ContourError, ModelError, PatternError
from .friction.laws import FrictionLaw
from .geometry.patterns import candidate_patterns, find_pattern
from .geometry.planar import moves_in_plane
from .proposals import propose_pairs
from .robot_files import Folders, Robot, read_mjcf, read_sdf, read_urdf
from .state import State, find_state

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


class Scene(Assembly):
    """A robot and the contacts it keeps.

    Parameters
    ----------
    model : pin.Model or pin.RobotWrapper
        Of a RobotWrapper the shapes are taken, too. The model is not copied, and must not be changed once a state has
        been made.
    visual_model, collision_model : pin.GeometryModel, optional
        For drawing, and for contours from collision shapes.

    Attributes
    ----------
    contours : dict of str to AttachedContour
        In the order in which they were added.
    contacts : dict of str to Contact
        Likewise.

    Raises
    ------
    ModelError
        For what is none of these, and for joints that mimic others or were not added depth first.

    Examples
    --------
    >>> import pincontact as pc
    >>> scene = pc.Scene.from_urdf("urdf/ball.urdf", floating_base=True)
    >>> ball = scene.add_contour("ball", pc.Sphere(0.1), frame="ball")
    >>> floor = scene.add_contour("floor", pc.Plane())
    >>> scene.add_contact("ball/floor", ball, floor, friction=pc.Coulomb(0.5)).pattern.name
    'S-S'
    >>> state = scene.initial_state([0, 0, 0.1, 0, 0, 0, 1])
    """

    def __init__(
        self,
        model: pin.Model | pin.RobotWrapper,
        visual_model: pin.GeometryModel | None = None,
        collision_model: pin.GeometryModel | None = None,
    ) -> None:
        if isinstance(model, pin.RobotWrapper):
            visual_model = model.visual_model if visual_model is None else visual_model
            collision_model = model.collision_model if collision_model is None else collision_model
            model = model.model
        if not isinstance(model, pin.Model):
            raise ModelError(f"Scene needs a pinocchio Model or RobotWrapper, got {type(model).__name__}")
        for name, shapes in (("visual_model", visual_model), ("collision_model", collision_model)):
            if shapes is not None and not isinstance(shapes, pin.GeometryModel):
                raise ModelError(f"{name} must be a pinocchio GeometryModel or None, got {type(shapes).__name__}")
        check_model(model)
        self.model = model
        self.visual_model = visual_model
        self.collision_model = collision_model
        self.contours: dict[str, AttachedContour] = {}
        self.contacts: dict[str, Contact] = {}
        # collision shapes of the robot's file that could not be read
        self._unread_shapes: tuple[str, ...] = ()

    @classmethod
    def from_urdf(
        cls,
        path: str | os.PathLike[str],
        floating_base: bool = False,
        package_dirs: Folders = None,
    ) -> Scene:
        """A scene from a URDF file.

        Joints that mimic others are joints of their own.

        Parameters
        ----------
        path : str or Path
        floating_base : bool
            Whether the root link moves freely (Pinocchio's free-flyer joint: q starts with position and quaternion x y
            z w, v with linear and angular velocity in body axes) or is fixed to the world.
        package_dirs : str, Path or sequence of them, optional
            Folders in which `package://` mesh paths are looked up; the file's own folder is always one.

        Returns
        -------
        Scene

        Raises
        ------
        ModelError
            When the file is missing or cannot be read.
        ArgumentError
            For a floating_base that is neither True nor False.

        Warns
        -----
        UserWarning
            Names joints that mimic others, and whatever else of the file is not read as it stands there: unknown
            elements, shapes whose meshes are missing, joints that cannot move.
        """
        return cls._of(read_urdf(os.fspath(path), floating_base, package_dirs))

    @classmethod
    def from_mjcf(cls, path: str | os.PathLike[str]) -> Scene:
        """A scene from an MJCF file, which MuJoCo's compiler reads: `pip install "pincontact[mjcf]"`.

        Bodies, joints, inertias, limits, damping, dry friction, armature, gravity, geoms and sites are those of the
        compiled model: without a warning, mass matrix, bias forces and joint forces are those that it has there.
        Contacts, sensors and actuators that follow a command are not read: commands come from a control. q is MuJoCo's,
        `ref` of joints included, with quaternions in Pinocchio's order; key frames and the start ("qpos0") are in
        `model.referenceConfigurations`. A base moves freely where the file has a <freejoint>. What has no name is
        called by its kind and its number in MuJoCo, as body_2.

        Parameters
        ----------
        path : str or Path

        Returns
        -------
        Scene

        Raises
        ------
        ModelError
            When the file is missing, with MuJoCo's message when it cannot be compiled, and for flexible bodies.
        MissingExtraError
            Without MuJoCo.

        Warns
        -----
        UserWarning
            Names what makes forces and is left out (springs, tendons, equality constraints, limits of balls, gravity
            compensation, fluids, armature and dry friction of free joints), and height fields, which are no shapes
            here.
        """
        return cls._of(read_mjcf(os.fspath(path)))

    @classmethod
    def from_sdf(
        cls,
        path: str | os.PathLike[str],
        floating_base: bool = False,
        package_dirs: Folders = None,
        root_link: str = "",
    ) -> Scene:
        """A scene from an SDF file, with builds of Pinocchio that read them (pinocchio.WITH_SDFORMAT).

        Parameters
        ----------
        path : str or Path
        floating_base, package_dirs
            As for `from_urdf`.
        root_link : str
            Name of the link to take as root, "" for the first.

        Returns
        -------
        Scene

        Raises
        ------
        MissingExtraError
            With other builds.
        ModelError
            When the file is missing or cannot be read.
        ArgumentError
            For a floating_base that is neither True nor False.

        Warns
        -----
        UserWarning
            Names loop closures, which are left out.
        """
        return cls._of(read_sdf(os.fspath(path), floating_base, package_dirs, root_link))

    @classmethod
    def _of(cls, robot: Robot) -> Scene:
        scene = cls(robot.model, robot.visual_model, robot.collision_model)
        scene._unread_shapes = robot.unread
        return scene

    def __repr__(self) -> str:
        model = self.model
        return (
            f"<Scene {model.name!r}: nq {model.nq}, nv {model.nv}; contours {shortened(self.contours)}; "
            f"contacts {shortened(self.contacts)}>"
        )

    def _repr_html_(self) -> str:
        model = self.model
        contours = [(c.name, repr(c.contour), c.frame, c.motion or "") for c in self.contours.values()]
        contacts = [
            (c.name, c.first.name, c.second.name, c.pattern.name, c.friction or "none") for c in self.contacts.values()
        ]
        return (
            html_table("Scene", ("model", "joints", "nq", "nv"), [(model.name, model.njoints - 1, model.nq, model.nv)])
            + html_table("Contours", ("name", "contour", "frame", "motion"), contours)
            + html_table("Contacts", ("name", "first", "second", "pattern", "friction"), contacts)
        )

    def add_contour(
        self,
        name: str,
        contour: Contour,
        frame: str = "universe",
        placement: pin.SE3 | None = None,
        motion: Motion | None = None,
    ) -> AttachedContour:
        """Attach a contour to a frame of the model.

        Parameters
        ----------
        name : str
            Of the contour, not taken yet.
        contour : Contour
        frame : str
            Name of a frame, or of a joint that has none (`pin.Model.addJoint` makes none); "universe" is the world.
            Where a link and a joint have one name, as in some URDFs, it is the link, though the joint may move another.
        placement : pin.SE3, optional
            Pose of the contour in the frame, the identity if not given.
        motion : Motion, optional
            A further pose as a function of time: a prescribed motion of the contour against its frame, as `placement`
            has it; that is what axes and centres of the motion refer to.

        Returns
        -------
        AttachedContour

        Raises
        ------
        ContourError
            For a name that is taken, what is no contour, placement or motion.
        ModelError
            For a frame that the model does not have.
        """
        check_name(name, ContourError)
        if name in self.contours:
            raise ContourError(f"there is already a contour named {name!r}")
        if not isinstance(contour, Contour):
            raise ContourError(f"contour {name!r}: expected a contour such as Circle(0.3), got {contour!r}")
        if placement is None:
            placement = pin.SE3.Identity()
        check_placement(name, placement)
        if motion is not None and not isinstance(motion, Motion):
            raise ContourError(f"contour {name!r}: motion must be None or a Motion, got {motion!r}")
        joint, in_joint = place_on_joint(self.model, name, frame, placement)
        attached = AttachedContour(name, contour, frame, placement, motion, joint, in_joint)
        self.contours[name] = attached
        return attached

    def add_contours_from_collision(
        self,
        links: Iterable[str] | None = None,
        kinds: Collection[str] = ("faces", "rims"),
        geometry: pin.GeometryModel | None = None,
    ) -> dict[str, AttachedContour]:
        """Attach contours made from the primitive collision shapes of the model's links.

        Names are Pinocchio's name of the shape and the part's: wheel_0_cylinder, wheel_0_rim_+z, foot_1_sphere,
        foot_0_face_-z, foot_0_edge_+x-y, foot_0_corner_+x+y-z, arm_0_cap_+z.

        Parameters
        ----------
        links : iterable of str, optional
            Names of the links, all if not given.
        kinds : collection of str
            Which parts, any of "faces" (spheres, ellipsoids, sides of cylinders and capsules, a capsule's caps as whole
            spheres, a box's six patches, a half-space's plane), "rims" (a cylinder's two circles), "edges" and
            "corners" (a box's twelve lines and eight points). A cylinder's flat ends are no contours; its rims are what
            touches.
        geometry : pin.GeometryModel, optional
            Shapes to use instead of the scene's own `collision_model`.

        Returns
        -------
        dict of str to AttachedContour
            The new contours.

        Raises
        ------
        ModelError
            Without collision shapes, for a link that has none, or where no contour is found (naming what was seen).
        ContourError
            For a name that is taken or a shape without extent.
        ArgumentError
            For an unknown kind.

        Warns
        -----
        UserWarning
            Names other shapes (meshes), and those that could not be read.

        Examples
        --------
        >>> import pincontact as pc
        >>> scene = pc.Scene.from_urdf("urdf/block.urdf", floating_base=True)
        >>> list(scene.add_contours_from_collision(kinds=["corners"]))[:2]
        ['block_0_corner_+x+y+z', 'block_0_corner_+x+y-z']
        """
        shapes, unread = (self.collision_model, self._unread_shapes) if geometry is None else (geometry, ())
        found = contours_from_collision(self.model, shapes, links, kinds, unread)
        # all or nothing: a name that is taken must not leave half of the contours behind
        for name, *_ in found:
            if name in self.contours:
                raise ContourError(f"there is already a contour named {name!r}")
        return {name: self.add_contour(name, contour, frame, place) for name, contour, frame, place in found}

    def add_contact(
        self,
        name: str,
        first: AttachedContour | str,
        second: AttachedContour | str,
        friction: FrictionLaw | None = None,
        bilateral: bool = False,
        pattern: str | None = None,
        location: tuple[ArrayLike | None, ArrayLike | None] | None = None,
        side: int | None = None,
        restitution: float = 0.0,
    ) -> Contact:
        """Let two contours keep in touch.

        Parameters
        ----------
        name : str
            Of the contact, not taken yet.
        first, second : AttachedContour or str
            Attached contours or their names, in any order; reported forces act on the second.
        friction : FrictionLaw, optional
            Such as Coulomb(mu); frictionless, if not given.
        bilateral : bool
            Whether the contact never opens; that of a point on a spatial curve never does.
        pattern : str, optional
            One of the seven names, such as "P-S"; inferred, if not given.
        location : (u_first, u_second), optional
            Guess of the location parameters: of each contour as many numbers as it has parameters (m, rad), or None.
        side : {1, -1}, optional
            On which side of e_3 body 1 (`Contact.body1`) lies; inferred, if not given, at the start, and wherever it
            comes over body 2.
        restitution : float
            Newton's coefficient, 0 to 1, when the contact closes again.

        Returns
        -------
        Contact

        Raises
        ------
        ArgumentError
            For a name that is taken, an unknown contour, two contours of one body, or another argument out of bounds.
        PatternError
            Where the contours form no pattern, or not the one asked for.
        """
        check_name(name, ArgumentError)
        if name in self.contacts:
            raise ArgumentError(f"there is already a contact named {name!r}")
        a, b = self._contour(name, first), self._contour(name, second)
        if a is b:
            raise ArgumentError(f"contact {name!r}: contour {a.name!r} cannot touch itself")
        if friction is not None and not isinstance(friction, FrictionLaw):
            raise ArgumentError(
                f"contact {name!r}: friction must be None or a law such as Coulomb(mu), got {friction!r}"
            )
        if not isinstance(bilateral, (bool, np.bool_)):
            raise ArgumentError(f"contact {name!r}: bilateral must be True or False, got {bilateral!r}")
        if side is not None and not (is_number(side) and side in (1, -1)):
            raise ArgumentError(f"contact {name!r}: side must be +1, -1 or None, got {side!r}")
        if not (is_number(restitution) and 0.0 <= restitution <= 1.0):
            raise ArgumentError(f"contact {name!r}: restitution must lie in [0, 1], got {restitution!r}")
        if a.joint == b.joint and a.motion is None and b.motion is None:
            body = "the universe" if a.joint == 0 else f"joint {self.model.names[a.joint]!r}"
            raise ArgumentError(
                f"contact {name!r}: contours {a.name!r} (frame {a.frame!r}) and {b.name!r} (frame {b.frame!r}) are "
                f"fixed to the same body, that of {body}, and cannot move against each other"
                + ("; a robot that is to move freely is loaded with floating_base=True" if a.joint == 0 else "")
            )
        one, two = in_order(a, b)
        if pattern is not None and not isinstance(pattern, str):
            raise PatternError(f"contact {name!r}: pattern must be the name of a pattern or None, got {pattern!r}")
        planar = False
        if len(candidate_patterns(one.contour, two.contour)) > 1:
            planar = moves_in_plane(self.model, one, two)
        found = find_pattern(name, one.contour, two.contour, pattern, planar)
        if friction is not None:
            check_friction(name, friction, one, two, found)
        check_location(name, a, b, location)
        is_bilateral, alike = bool(bilateral) or found.constraints == 2, a.contour.dimension == b.contour.dimension
        if side == 1 and not is_bilateral and alike and may_be_beside(b.contour, a.contour):
            side = None  # a piece that is outside a body: on which of its own sides has to be seen
        contact = Contact(
            name,
            a,
            b,
            friction,
            is_bilateral,
            found,
            location,
            None if side is None else int(side),
            float(restitution),
        )
        self.contacts[name] = contact
        return contact

    def add_contacts(
        self,
        firsts: Contours,
        seconds: Contours,
        friction: FrictionLaw | None = None,
        bilateral: bool = False,
        side: int | None = None,
        restitution: float = 0.0,
    ) -> list[Contact]:
        """Let many contours keep in touch: all of them, or, where one contact is refused, none.

        Parameters
        ----------
        firsts, seconds : AttachedContour, str or iterable of them
            As many of one as of the other, in pairs; one alone is paired with each of the others. A contact's name is
            those of its contours, "first-second".
        friction, bilateral, side, restitution
            As for `add_contact`, of each.

        Returns
        -------
        list of Contact
            In the order of the pairs.

        Raises
        ------
        ArgumentError, PatternError
            For numbers of contours that make no pairs, and as for `add_contact`.

        Examples
        --------
        >>> import pincontact as pc
        >>> scene = pc.Scene.from_urdf("urdf/block.urdf", floating_base=True)
        >>> corners = scene.add_contours_from_collision(kinds="corners")
        >>> floor = scene.add_contour("floor", pc.Plane())
        >>> scene.add_contacts(corners, floor, friction=pc.Coulomb(0.5))[0].name
        'block_0_corner_+x+y+z-floor'
        """
        added: list[Contact] = []
        try:
            for name, first, second in in_pairs(firsts, seconds):
                added.append(self.add_contact(name, first, second, friction, bilateral, None, None, side, restitution))
        except ContactError:
            for contact in added:
                del self.contacts[contact.name]
            raise
        return added

    def propose_contacts(
        self, distance: float, q: ArrayLike | None = None, within: bool = False
    ) -> tuple[list[str], list[str]]:
        """Pairs of contours near each other that can keep a regular point contact, for `add_contacts`.

        Points, spheres, ellipsoids, planes, rectangles, circles (as disks), tori on planes, and lines and cylinders
        with ends. Left out are contours of one robot (what hangs from one joint of the world), of the world and a base
        that cannot translate, pairs that have a contact, flat on flat, curve on rim, and what is parallel at q.

        Parameters
        ----------
        distance : float
            In m; what is nearer is proposed, also what overlaps.
        q : (nq,) array_like
            Pinocchio's configuration in m and rad, the neutral one if not given; motions of contours are at time 0.
        within : bool
            Propose pairs of links of one robot, too, but those of parent and child. Collision shapes are often
            generous: links that never meet may overlap at q.

        Returns
        -------
        firsts, seconds : list of str
            Names of the contours of each pair, in the order of the scene's contours.

        Raises
        ------
        ArgumentError
            For a distance that is not positive, or a `within` that is neither True nor False.
        StateError
            For a configuration of the wrong size or with bad numbers.

        Warns
        -----
        UserWarning
            Names other contours.
        """
        return propose_pairs(self, distance, q, within)

    def _contour(self, contact: str, given: AttachedContour | str) -> AttachedContour:
        key = given.name if isinstance(given, AttachedContour) else given
        if not isinstance(key, str) or key not in self.contours:
            raise ArgumentError(
                f"contact {contact!r}: unknown contour {given!r}; contours: {', '.join(self.contours) or 'none'}"
            )
        attached = self.contours[key]
        if isinstance(given, AttachedContour) and attached is not given:
            raise ArgumentError(f"contact {contact!r}: contour {key!r} belongs to another scene")
        return attached

    def initial_state(
        self,
        q: ArrayLike,
        v: ArrayLike | None = None,
        t: float = 0.0,
        *,
        free: Sequence[str] = (),
        max_gap: float | None = None,
    ) -> State:
        """A consistent state near (q, v): location parameters found, q and v corrected in the mass metric.

        Parameters
        ----------
        q : (nq,) array_like
            Pinocchio's configuration, in m and rad; quaternions (x, y, z, w) have norm 1 to 1e-6.
        v : (nv,) array_like, optional
            Pinocchio's velocity in m/s and rad/s, zero if not given.
        t : float
            Time in s.
        free : sequence of str
            Names of contacts that start open.
        max_gap : float, optional
            The largest gap in m that is corrected away; if not given, a twentieth of the smaller contour's size (5 cm
            where neither has one).

        Returns
        -------
        State
            Its `correction` says how far q and v were off.

        Raises
        ------
        StateError
            For bad sizes or numbers, for a locked joint (its limits coincide) that is not where it is locked, and for
            velocity constraints that contradict each other.
        ArgumentError
            For a bad max_gap, and for names in `free` that are none of contacts that can open.
        ModelError
            For a joint that moves no inertia, or is of a type that is not known.
        NoContactError
            Where contours do not touch, or not all at once, as four legs of which one is short; it has the gap.
        SingularContactError
            Where the location equations are singular.

        Warns
        -----
        UserWarning
            Of a quaternion (1, 0, 0, 0), which is the identity where the real part comes first, and half a turn about x
            here; (-1, 0, 0, 0) is the same half turn without a warning.

        Examples
        --------
        A ball that starts a millimetre above the floor is put on it:

        >>> import pincontact as pc
        >>> scene = pc.Scene.from_urdf("urdf/ball.urdf", floating_base=True)
        >>> ball = scene.add_contour("ball", pc.Sphere(0.1), frame="ball")
        >>> contact = scene.add_contact("ball/floor", ball, scene.add_contour("floor", pc.Plane()))
        >>> state = scene.initial_state([0, 0, 0.101, 0, 0, 0, 1])
        >>> float(state.q[2].round(12)), round(state.correction.gaps["ball/floor"], 12)
        (0.1, 0.001)
        """
        return find_state(self, q, v, t, free, max_gap)
