"""All contact points that two contours may have in one configuration: samples, then Newton from the best of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import pinocchio as pin
import scipy

from ..contours import Contour
from ..errors import SingularContactError
from ..layout import BRANCH, CHART, CLOSED_FORM, CONDITION, DETERMINANT_SIGN, LENGTH, OK, PATTERN, SIDE, SINGULAR
from ..workspace import Workspace
from .chart_changes import move_charts
from .location import BRANCHES, NO_CLOSED_FORM, ROUND_ON_PLANE
from .patterns import CROSSING_CURVES, ON_CURVE
from .planar import pose_of

# Samples of a curve, of an unbounded contour along a parameter at most, and along both parameters of a surface.
_CURVE_SAMPLES, _MOST_SAMPLES = 241, 4001
_SURFACE_SAMPLES = (61, 31)
# So many starts, a third for each of these weights of alignment against distance, apart from each other by this part of
# the contact's length; each sample of body 1 with so many neighbours.
_SEEDS, _WEIGHTS, _APART, _NEIGHBOURS = 24, (1.0, 0.0, 10.0), 0.25, 4
# Unbounded contours are sampled as far as the bodies' distance plus so many of their sizes; samples keep off the ends
# of domains by this part of them.
_WINDOW, _INSET = 2.0, 1e-3
# At least so far, in m: two points at one place have neither size nor distance.
_LEAST_WINDOW = 1e-3
# Along unbounded parameters other than lengths, samples are this part of the contour's size apart; its speed |f_a| is
# taken for at least this part of a window per unit of the parameter.
_SPACING, _SLOWEST = 0.25, 1e-3
# Two candidates closer than this (relative to the contact's length) are one.
SAME = 1e-6
# Newton may run into a pole, where a tangent vanishes and every equation with it; unit tangents tell. Relative.
_SOLVED = 1e-6


@dataclass(frozen=True)
class Candidate:
    """A stationary point of the distance between two contours.

    Attributes
    ----------
    location : (4,) array
        Location parameters, two for u_1, two for u_2, in m or rad.
    gap : float
        Signed distance in m along the normal of the side assumed.
    side : int
        The side of e_3 on which body 1 bends away, +1 or -1, 0 where the shapes do not decide.
    point : (3,) array
        Point on body 2 in m, world frame.
    determinant_sign, branch : int
        Which solution of the location equations it is.
    charts : (int, int)
        Of both bodies.
    """

    location: np.ndarray
    gap: float
    side: int
    point: np.ndarray
    determinant_sign: int
    branch: int
    charts: tuple[int, int]


def find_candidates(system: Workspace, t: float, guess: np.ndarray, beyond: bool = False) -> list[Candidate]:
    """Candidates of a system with a single contact at its (q, v), nearest (least |gap|) first.

    guess (4,): contact coordinates, NaN where unknown. A complete guess is the only start. beyond: where there is none
    inside the contours' domains, those on their continuations, where nothing touches, will do.
    Raises SingularContactError where there is none and a start ended where the location equations are singular.
    """
    contact = system.contacts[0]
    k1, k2 = contact.body1.contour.dimension, contact.body2.contour.dimension
    complete = bool(np.isfinite([*guess[:k1], *guess[2 : 2 + k2]]).all())
    statuses: set[int] = set()
    system.contact_int[0, DETERMINANT_SIGN] = 0
    form = int(system.contact_int[0, CLOSED_FORM])
    if form != NO_CLOSED_FORM:
        start = np.where(np.isnan(guess), 0.0, guess)
        starts = [(start, branch) for branch in BRANCHES[form]]
    else:
        starts = [(start, 1) for start in ([guess] if complete else _seeds(system, t, guess))]
    found: list[Candidate] = []
    for inside in (True, False):
        for start, branch in starts if inside or (beyond and not found) else []:
            candidate = refine(system, t, start, branch, statuses, inside)
            if candidate is not None and not any(_is_same(candidate, c, system) for c in found):
                found.append(candidate)
    if complete and found:
        # of a formula's solutions, the guess names one
        found = [min(found, key=lambda c: _moved(system, c, guess, t))]
    if not found and SINGULAR in statuses:
        raise SingularContactError(
            f"contact {contact.name!r}: the location equations are singular wherever {contact.first.name!r} and "
            f"{contact.second.name!r} could touch: contours that fit into each other, or are parallel",
            abs(float(system.contact_real[0, CONDITION])),
        )
    return sorted(found, key=lambda c: abs(c.gap))


def _moved(system: Workspace, found: Candidate, guess: np.ndarray, t: float) -> float:
    """How far in m both contact points are on their contours from where a guess has them."""
    way, contact = 0.0, system.contacts[0]
    for side, contour in enumerate((contact.body1.contour, contact.body2.contour)):
        own = slice(2 * side, 2 * side + contour.dimension)
        point = contour.point(found.location[own], t, found.charts[side])
        way += float(np.linalg.norm(point - contour.point(guess[own], t)))
    return way


def _is_same(a: Candidate, b: Candidate, system: Workspace) -> bool:
    length = system.contact_real[0, LENGTH]
    return abs(a.gap - b.gap) < SAME * length and bool(np.linalg.norm(a.point - b.point) < SAME * length)


def refine(
    system: Workspace, t: float, start: np.ndarray, branch: int, statuses: set[int], inside: bool = True
) -> Candidate | None:
    """Newton from a start (in the first charts); None where it fails, or leaves a finite domain and must be inside.
    statuses: how it went is added."""
    contact = system.contacts[0]
    integers = system.contact_int[0]
    integers[BRANCH] = branch
    charts = system.side_int[0:2, CHART]
    parameters = slice(system.nq + system.nv, system.nq + system.nv + 4)
    for wanted in product(contact.body1.contour.charts, contact.body2.contour.charts):
        # a start near a pole is better off in another chart, and one right at it fails in its own
        charts[:] = wanted
        system.location[0] = np.where(np.array(wanted).repeat(2) == 0, start, 0.0)
        system.state[parameters] = start
        if wanted == (0, 0) and system.charted:
            charts[:] = 0
            move_charts(system.address)
            system.location[0] = system.state[parameters]
        status = system.evaluate_kinematics(t)
        statuses.add(status)
        if status == OK:
            break
    else:
        return None
    if system.charted:
        system.state[parameters] = system.location[0]
        if move_charts(system.address):
            system.location[0] = system.state[parameters]
            if system.evaluate_kinematics(t) != OK:
                return None
    if not _is_solved(system):
        return None
    location = system.location[0].copy()
    for side, contour, u in ((0, contact.body1.contour, location[:2]), (1, contact.body2.contour, location[2:])):
        for a in range(contour.dimension):
            if charts[side] != 0:
                continue
            low, high = contour.domain[a]
            if contour.periodic[a]:
                u[a] -= (high - low) * math.floor((u[a] - low) / (high - low))
            elif inside and not low <= u[a] <= high:
                return None
    bending = _bending_side(system)
    if system.contact_int[0, CLOSED_FORM] == ROUND_ON_PLANE:
        bending = -branch
    gap = float(system.gaps[0, 0])
    if integers[PATTERN] == ON_CURVE:
        gap = float(np.hypot(*system.gaps[0]))
    elif bending * integers[SIDE] < 0:
        gap = -gap
    point = system.frames[1, 3] + system.derivatives[1, 0]
    sign = int(np.sign(system.contact_real[0, CONDITION]))
    return Candidate(location, gap, bending, point.copy(), sign, branch, (int(charts[0]), int(charts[1])))


def _is_solved(system: Workspace) -> bool:
    """Whether C1, but for the gap, and C2 hold for unit tangents too."""
    contact = system.contacts[0]
    if system.contact_int[0, CLOSED_FORM] != NO_CLOSED_FORM:
        return True
    pattern = system.contact_int[0, PATTERN]
    first, second = system.derivatives[0], system.derivatives[1]
    tangents1 = first[1 : 1 + contact.body1.contour.dimension]
    tangents2 = second[1 : 1 + contact.body2.contour.dimension]
    difference = (system.frames[1, 3] - system.frames[0, 3]) + (second[0] - first[0])
    tolerance = _SOLVED * max(system.contact_real[0, LENGTH], float(np.linalg.norm(difference)))
    across = [*tangents2, *(tangents1 if pattern == CROSSING_CURVES else ())]
    if any(not abs(tangent @ difference) <= tolerance * np.linalg.norm(tangent) for tangent in across):
        return False
    if pattern in (CROSSING_CURVES, ON_CURVE):
        return True
    normal = system.basis[0, 2]
    return all(abs(tangent @ normal) <= _SOLVED * np.linalg.norm(tangent) for tangent in tangents1)


def _bending_side(system: Workspace) -> int:
    """Sign of e_3 . (curvature of body 1 - curvature of body 2): the side towards which body 1 bends away.

    0 for points, for crossing curves, and where the relative curvature has no definite sign.
    """
    contact = system.contacts[0]
    k1 = contact.body1.contour.dimension
    if k1 == 0 or system.contact_int[0, PATTERN] == CROSSING_CURVES:
        return 0
    first, second = system.derivatives[0], system.derivatives[1]
    e3 = -system.contact_int[0, SIDE] * system.basis[0, 2]

    def form(derivatives: np.ndarray, k: int) -> np.ndarray:
        rows = [[3, 4], [4, 5]]
        return np.array([[derivatives[rows[a][b]] @ e3 for b in range(k)] for a in range(k)])

    k2 = contact.body2.contour.dimension
    tangents1, tangents2 = first[1 : 1 + k1].T, second[1 : 1 + k2].T
    # body 1's tangents in parameters of body 2
    map12 = np.linalg.lstsq(tangents2, tangents1, rcond=None)[0]
    relative = form(first, k1) - map12.T @ form(second, k2) @ map12
    eigenvalues = np.linalg.eigvalsh(relative)
    if eigenvalues[0] > 0.0:
        return 1
    if eigenvalues[-1] < 0.0:
        return -1
    return 0


def _seeds(system: Workspace, t: float, guess: np.ndarray) -> list[np.ndarray]:
    """Starts for Newton: sample pairs that are near each other, and near with their tangents aligned."""
    contact = system.contacts[0]
    poses = [pose_of(system.data, body, t) for body in (contact.body1, contact.body2)]
    distance = float(np.linalg.norm(poses[0].translation - poses[1].translation))
    sizes = [b.contour.size if math.isfinite(b.contour.size) else 0.0 for b in (contact.body1, contact.body2)]
    window = distance + _WINDOW * sum(sizes) + _LEAST_WINDOW
    first = _sample(contact.body1.contour, poses[0], t, window, guess[:2])
    second = _sample(contact.body2.contour, poses[1], t, window, guess[2:])
    length = max(system.contact_real[0, LENGTH], 1e-12)
    tree = scipy.spatial.cKDTree(second[1])
    neighbours = min(_NEIGHBOURS, tree.n)
    distances, indices = tree.query(first[1], k=neighbours)
    distances, indices = distances.reshape(len(first[1]), -1), indices.reshape(len(first[1]), -1)
    misaligned = np.zeros_like(distances)
    if contact.body1.contour.dimension > 0 and system.contact_int[0, PATTERN] not in (CROSSING_CURVES, ON_CURVE):
        normals = second[2]
        for tangent in first[3]:
            misaligned = np.maximum(misaligned, np.abs(np.einsum("ik,ijk->ij", tangent, normals[indices])))
    seeds: list[np.ndarray] = []
    # the samples of both contours, pair by pair
    ones, twos = np.arange(len(distances)).repeat(neighbours), indices.ravel()
    where = np.hstack([first[1][ones], second[1][twos]])
    parameters = np.hstack([first[0][ones], second[0][twos]])
    for weight in _WEIGHTS:
        order = np.argsort((distances + weight * length * misaligned).ravel())
        # apart from each other, or all would fall into one basin
        seeds += [parameters[i] for i in spaced(where, order, _APART * length, _SEEDS // len(_WEIGHTS))]
    return seeds


def spaced(points: np.ndarray, order: np.ndarray, distance: float, count: int) -> Iterator[int]:
    """The first points in this order, at most so many, each farther than that from those before."""
    for _ in range(count):
        if not order.size:
            return
        first = int(order[0])
        yield first
        order = order[np.linalg.norm(points[order] - points[first], axis=1) > distance]


def _within(contour: Contour, a: int, t: float, window: float) -> tuple[float, float, int]:
    """Ends of a parameter without end beyond which the contour is outside the window in m around its origin, or more
    samples away than there may be; and how many samples show what is between."""
    middle = [min(max(0.0, low), high) for low, high in contour.domain]
    spacing = _SPACING * (contour.size if math.isfinite(contour.size) else window)
    # at least so fast that the window is left, or the samples used up, after a while
    speed = max(float(np.linalg.norm(contour.evaluate(middle, t)[1 + a])), _SLOWEST * (spacing / window))
    ends = []
    for sign, end in zip((-1.0, 1.0), contour.domain[a]):
        width = window
        while not math.isfinite(end) and speed * width < 0.25 * _MOST_SAMPLES * spacing:
            place = middle.copy()
            place[a] += sign * width
            if np.linalg.norm(contour.point(place, t)) >= window:
                break
            width *= 2.0
        ends.append(end if math.isfinite(end) else middle[a] + sign * width)
    count = speed * (ends[1] - ends[0]) / spacing
    return ends[0], ends[1], int(min(count, _MOST_SAMPLES - 1)) + 1


def _sample(
    contour: Contour, pose: pin.SE3, t: float, window: float, guess: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """Parameters (n, 2), world points (n, 3), unit normals (n, 3) and unit tangents [(n, 3)] of a contour."""
    axes = []
    counts = (_CURVE_SAMPLES,) if contour.dimension == 1 else _SURFACE_SAMPLES
    for a in range(contour.dimension):
        low, high = contour.domain[a]
        if not math.isnan(guess[a]):
            axes.append(np.array([guess[a]]))
            continue
        count = counts[a]
        # what is infinite is cut to the window; so are lengths, but not angles and other people's parameters
        if not contour.periodic[a] and contour.lengths:
            low, high = max(low, -window), min(high, window)
        elif not math.isfinite(high - low):
            low, high, wanted = _within(contour, a, t, window)
            count = max(count, wanted) if contour.dimension == 1 else count
        inset = _INSET * (high - low)
        axes.append(np.linspace(low + inset, high - inset, count))
    parameters = grid(axes)
    values = evaluated(contour, parameters, t)
    rotation = pose.rotation
    points = values[:, 0] @ rotation.T + pose.translation
    tangents = [_unit(values[:, 1 + a] @ rotation.T) for a in range(contour.dimension)]
    normals = np.zeros_like(points)
    if contour.dimension == 2:
        normals = np.cross(tangents[0], tangents[1])
    elif contour.dimension == 1:
        normals = np.cross(tangents[0], rotation[:, 2])
    return parameters, points, _unit(normals), tangents


def grid(axes: list[np.ndarray]) -> np.ndarray:
    """All points (n, 2) of a contour's parameters with values (n_1,), (n_2,) of each, zeros for those it has not."""
    out = np.zeros((math.prod(len(axis) for axis in axes), 2))
    for a, values in enumerate(np.meshgrid(*axes, indexing="ij")):
        out[:, a] = values.ravel()
    return out


def evaluated(contour: Contour, parameters: np.ndarray, t: float) -> np.ndarray:
    """f and its derivatives (n, 10, 3) at parameters (n, 2), zeros for those that the contour has not."""
    return contour.evaluate_many(parameters[:, : contour.dimension], t)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (n, 3) of length one; those of length zero stay what they are."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
