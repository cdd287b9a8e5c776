"""Pairs of contours near each other that can keep a regular point contact, found by coal's broadphase."""

from __future__ import annotations

import math
import warnings
from itertools import combinations
from typing import TYPE_CHECKING

import coal
import numpy as np
import pinocchio as pin

from .arguments import check_flag, check_positive
from .contacts import Assembly, AttachedContour, in_order
from .contours import Circle, Contour, Cylinder, Ellipsoid, Line, Plane, Point, Sphere, Torus
from .geometry.patterns import PLANAR, candidate_patterns, find_pattern
from .geometry.planar import moves_in_plane
from .state import check_configuration, coordinates_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# Points, curves and patches get this radius or half thickness in m: next to nothing, and not zero, for coal's volumes.
_THIN = 1e-9
# Straight contours, or a rim or tyre and a plane, touch along a line or nowhere alone if they differ by less, in rad.
_PARALLEL = 1e-3
_ROUND = (Sphere, Ellipsoid)
# Pairs without a regular point contact in space, however they lie.
_FLAT = ({Plane}, {Plane, Line}, {Plane, Cylinder}, {Circle}, {Circle, Line}, {Point}, {Point, Circle}, {Point, Line})


def propose_pairs(scene: Assembly, distance: float, q: ArrayLike | None, within: bool) -> tuple[list[str], list[str]]:
    """Names of the contours that `Scene.propose_contacts` returns."""
    check_positive(distance=distance)
    check_flag("within", within)
    model = scene.model
    configuration = pin.neutral(model) if q is None else check_configuration(coordinates_of(model), q)
    shapes = pin.GeometryModel()
    solids: list[AttachedContour] = []
    left_out = []
    for attached in scene.contours.values():
        solid = _solid(attached.contour)
        if solid is None:
            left_out.append(f"{attached.name} ({attached.contour.name})")
            continue
        placement = attached.placement_in_joint
        if attached.motion is not None:
            placement = placement * attached.motion.placement(0.0)
        shape, in_contour = solid
        shapes.addGeometryObject(pin.GeometryObject(attached.name, attached.joint, placement * in_contour, shape))
        solids.append(attached)
    if left_out:
        names = ", ".join(left_out)
        warnings.warn(
            f"contours of which no contact is proposed, having no end or no closed form: {names}.", stacklevel=3
        )
    taken = {frozenset((contact.first.name, contact.second.name)) for contact in scene.contacts.values()}
    together, robots = _held_together(model), _robots(model)
    pairs = [
        (i, j)
        for i, j in combinations(range(len(solids)), 2)
        if (min(solids[i].joint, solids[j].joint), max(solids[i].joint, solids[j].joint)) not in together
        and (within or robots[solids[i].joint] != robots[solids[j].joint])
        and frozenset((solids[i].name, solids[j].name)) not in taken
        and candidate_patterns(*(solid.contour for solid in in_order(solids[i], solids[j])))
    ]
    placed, near = _near(model, shapes, pairs, configuration, distance)
    kept = [(i, j) for i, j in near if _is_regular(model, solids[i], solids[j], placed[i], placed[j])]
    return [solids[i].name for i, _ in kept], [solids[j].name for _, j in kept]


def _solid(contour: Contour) -> tuple[coal.ShapeBase, pin.SE3] | None:
    """coal's shape of a contour and its placement in the contour's frame, None for a contour that has none."""
    if isinstance(contour, Point):
        return coal.Sphere(_THIN), pin.SE3.Identity()
    if isinstance(contour, Sphere):
        return coal.Sphere(contour.size), pin.SE3.Identity()
    if isinstance(contour, Ellipsoid):
        return coal.Ellipsoid(*contour.shape), pin.SE3.Identity()
    if isinstance(contour, Circle):
        return coal.Cylinder(contour.size, 2.0 * _THIN), pin.SE3.Identity()
    if isinstance(contour, Torus):
        major, minor = contour.shape
        hull = coal.Cylinder(major, 2.0 * _THIN)
        hull.setSweptSphereRadius(minor)
        return hull, pin.SE3.Identity()
    if _is_endless(contour):
        return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0), pin.SE3.Identity()
    if not isinstance(contour, (Line, Plane, Cylinder)) or not np.isfinite(contour.domain).all():
        return None
    domain = np.array(contour.domain)
    middle, length = domain.mean(axis=1), domain[:, 1] - domain[:, 0]
    if isinstance(contour, Cylinder):
        return coal.Cylinder(contour.size, length[1]), pin.SE3(np.eye(3), np.array([0.0, 0.0, middle[1]]))
    extent, centre = np.full(3, 2.0 * _THIN), np.zeros(3)
    extent[: len(length)], centre[: len(length)] = length, middle
    return coal.Box(*extent), pin.SE3(np.eye(3), centre)


def _is_endless(contour: Contour) -> bool:
    """Whether it is a plane without ends."""
    return isinstance(contour, Plane) and bool(np.isinf(contour.domain).all())


def _held_together(model: pin.Model) -> set[tuple[int, int]]:
    """Pairs of joints (0: the world) whose bodies are one, or joined: parent and child.

    A child of the world is joined to it only if its joint cannot translate: a free base may lie on the ground.
    """
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    pairs = {(joint, joint) for joint in range(model.njoints)}
    for joint in range(1, model.njoints):
        parent, start = int(model.parents[joint]), model.idx_vs[joint]
        # Pinocchio gives a matrix of one column as a vector
        jacobian = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL).reshape(6, model.nv)
        if parent > 0 or not jacobian[:3, start : start + model.nvs[joint]].any():
            pairs.add((parent, joint))
    return pairs


def _robots(model: pin.Model) -> list[int]:
    """For each joint that of the world's children from which it hangs; 0 for the world."""
    roots = [0]
    for joint in range(1, model.njoints):
        roots.append(roots[model.parents[joint]] or joint)
    return roots


def _near(
    model: pin.Model, shapes: pin.GeometryModel, pairs: list[tuple[int, int]], q: np.ndarray, distance: float
) -> tuple[list[pin.SE3], list[tuple[int, int]]]:
    """Placements of the shapes in the world, and which of the pairs are no further apart than this."""
    endless = [isinstance(item.geometry, coal.Halfspace) for item in shapes.geometryObjects]
    for i, j in pairs:
        # trees of bounding boxes miss half-spaces, which have none
        if not (endless[i] or endless[j]):
            shapes.addCollisionPair(pin.CollisionPair(i, j))
    data, geometry = model.createData(), shapes.createData()
    for request in geometry.collisionRequests:
        request.security_margin = distance
    pin.updateGeometryPlacements(model, data, shapes, geometry, q)
    placed = [pin.SE3(pose) for pose in geometry.oMg]
    found = set()
    if len(shapes.collisionPairs):
        manager = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(model, shapes, geometry)
        pin.computeCollisions(model, data, manager, q)
        found = {
            (int(pair.first), int(pair.second))
            for pair, result in zip(shapes.collisionPairs, geometry.collisionResults)
            if result.isCollision()
        }
    poses = [coal.Transform3s(pose.rotation, pose.translation) for pose in placed]
    solids = [item.geometry for item in shapes.geometryObjects]
    for i, j in pairs:
        if endless[i] != endless[j]:
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            if coal.distance(solids[i], poses[i], solids[j], poses[j], request, result) <= distance:
                found.add((i, j))
    return placed, sorted(found)


def _is_regular(model: pin.Model, a: AttachedContour, b: AttachedContour, place_a: pin.SE3, place_b: pin.SE3) -> bool:
    """Whether the pair's nearest points are alone, so that it touches at a point and not along a line or an area."""
    one, two = in_order(a, b)
    planar = len(candidate_patterns(one.contour, two.contour)) > 1 and moves_in_plane(model, one, two)
    kinds = {type(a.contour), type(b.contour)}
    if find_pattern("", one.contour, two.contour, None, planar).code == PLANAR:
        return kinds != {Line}
    if Torus in kinds and not (_is_endless(a.contour) or _is_endless(b.contour)):
        # coal has its convex hull, which is as far from a half-space, but has no hole for other things to be in
        return False
    if isinstance(a.contour, _ROUND) or isinstance(b.contour, _ROUND):
        return True
    if kinds in _FLAT:
        return False
    if kinds in ({Circle, Plane}, {Torus, Plane}, {Line}, {Line, Cylinder}, {Cylinder}):
        return float(np.linalg.norm(np.cross(_direction(a, place_a), _direction(b, place_b)))) > math.sin(_PARALLEL)
    return True


def _direction(attached: AttachedContour, place: pin.SE3) -> np.ndarray:
    """Of a line, or the axis of a cylinder, rim, tyre or plane."""
    return place.rotation[:, 0 if isinstance(attached.contour, Line) else 2]
