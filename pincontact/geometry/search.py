"""All contact points that two contours may have in one configuration: samples, then Newton from the best of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import scipy

from ..contours import Contour
from ..contours.tails import ends_near
from ..errors import SingularContactError
from ..layout import CLOSED_FORM, CONDITION, DETERMINANT_SIGN, END_MARGIN, LENGTH, OK, PATTERN, SAME_PLACE, SINGULAR
from ..workspace import Workspace
from .location import BRANCHES, NO_CLOSED_FORM, ROUND_ON_PLANE
from .patterns import CROSSING_CURVES, ON_CURVE
from .planar import pose_of

# Samples of a curve, of an unbounded contour along a parameter at most, and along both parameters of a surface.
_CURVE_SAMPLES, _MOST_SAMPLES = 241, 4001
_SURFACE_SAMPLES = (61, 31)
# So many starts, a third for each of these weights of alignment against distance, apart from each other by this part of
# the contact's length; each sample of body 1 with so many neighbours.
_SEEDS, _WEIGHTS, _APART, _NEIGHBOURS = 24, (1.0, 0.0, 10.0), 0.25, 4
# So many pairs are looked through at a time for some that are apart.
_PART = 256
# Unbounded contours are sampled as far as the bodies' distance plus so many of their sizes; samples keep off the ends
# of domains by this part of them.
_WINDOW, _INSET = 2.0, 1e-3
# Descents from the nearest sample to the nearest point: it is as near to it as rounding has it after a few, or almost.
_DESCENTS = 30
# At least so far, in m: two points at one place have neither size nor distance.
_LEAST_WINDOW = 1e-3
# Along unbounded parameters other than lengths, samples are this part of the contour's size apart; its speed |f_a| is
# taken for at least this part of a window per unit of the parameter.
_SPACING, _SLOWEST = 0.25, 1e-3
# Places that are tried in each octave where a contour may leave what is near.
_PARTS = 8
_UNKNOWN = (math.nan, math.nan)


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
    points : (2, 3) array
        Points on body 1 and body 2 in m, world frame.
    determinant_sign, branch : int
        Which solution of the location equations it is.
    charts : (int, int)
        Of both bodies.
    """

    location: np.ndarray
    gap: float
    side: int
    points: np.ndarray
    determinant_sign: int
    branch: int
    charts: tuple[int, int]

    @property
    def point(self) -> np.ndarray:
        """(3,) array : point on body 2 in m, world frame."""
        return self.points[1]

    def is_at(self, other: Candidate, length: float) -> bool:
        """Whether it is the same as another one, to a millionth of the contact's length.

        Parameters
        ----------
        other : Candidate
        length : float
            In m.

        Returns
        -------
        bool
        """
        near = abs(self.gap - other.gap) < SAME_PLACE * length
        return near and bool(np.linalg.norm(self.point - other.point) < SAME_PLACE * length)


def find_candidates(
    system: Workspace, t: float, guess: np.ndarray, beyond: bool = False, end: np.ndarray | None = None
) -> list[Candidate]:
    """Candidates of a system with a single contact at its (q, v), nearest (least |gap|) first.

    guess (4,): contact coordinates, NaN where unknown. A complete guess is the only start. beyond: where there is none
    inside the contours' domains, those on their continuations, where nothing touches, will do. end (k2,): parameters of
    an end of body 2, beyond which it goes on as well; that which is nearest to it is first.
    Raises SingularContactError where there is none and a start ended where the location equations are singular.
    """
    contact = system.contacts[0]
    k1, k2 = contact.body1.contour.dimension, contact.body2.contour.dimension
    complete = bool(np.isfinite([*guess[:k1], *guess[2 : 2 + k2]]).all())
    system.contact_int[0, DETERMINANT_SIGN] = 0
    form = int(system.contact_int[0, CLOSED_FORM])
    if form != NO_CLOSED_FORM:
        start = np.where(np.isnan(guess), 0.0, guess)
        branches = list(BRANCHES[form])
        starts = np.tile(start, (len(branches), 1))
    else:
        starts = np.array([guess] if complete else _seeds(system, t, guess)).reshape(-1, 4)
        branches = [1] * len(starts)
    found: list[Candidate] = []
    # of a body on a plane the far side may be over it, and the near one not yet
    anywhere = end is not None or (beyond and form == ROUND_ON_PLANE)
    every, statuses = stationary_points(system, t, starts, branches, inside=not anywhere)
    if beyond and not every:
        every, _ = stationary_points(system, t, starts, branches, inside=False)
    for candidate in every:
        if not any(candidate.is_at(c, system.contact_real[0, LENGTH]) for c in found):
            found.append(candidate)
    if complete and found:
        # of a formula's solutions, the guess names one
        found = [min(found, key=lambda c: _moved(system, c, guess, t))]
    if not found and SINGULAR in statuses:
        raise SingularContactError(
            f"contact {contact.name!r}: the location equations are singular wherever {contact.first.name!r} and "
            f"{contact.second.name!r} could touch, as where contours fit into each other, are parallel, or one of them "
            "is on an axis of symmetry of the other: move q a little",
            abs(float(system.contact_real[0, CONDITION])),
        )
    if end is None:
        return sorted(found, key=lambda c: abs(c.gap))
    contour, same = contact.body2.contour, SAME_PLACE * system.contact_real[0, LENGTH]
    point = pose_of(system.data, contact.body2, t).act(contour.point(end.tolist(), t))
    for candidate in found:
        _unwind(contour, candidate, end, t, same)
    # of both sides of a place the nearer one
    return sorted(found, key=lambda c: (round(float(np.linalg.norm(c.point - point)) / same), abs(c.gap)))


def _unwind(contour: Contour, found: Candidate, end: np.ndarray, t: float, same: float) -> None:
    """Have angles on body 2, of which Newton's method may have gone round, as near to those of an end as the same point
    has them: domains with ends are not periodic."""
    own = found.location[2 : 2 + contour.dimension]
    point = contour.point(own.tolist(), t) if found.charts[1] == 0 else None
    for a in range(contour.dimension if point is not None else 0):
        back = own.copy()
        back[a] -= 2.0 * math.pi * round((own[a] - end[a]) / (2.0 * math.pi))
        if back[a] != own[a] and np.linalg.norm(contour.point(back.tolist(), t) - point) < same:
            own[a] = back[a]


def _moved(system: Workspace, found: Candidate, guess: np.ndarray, t: float) -> float:
    """How far in m both contact points are on their contours from where a guess has them."""
    way, contact = 0.0, system.contacts[0]
    for side, contour in enumerate((contact.body1.contour, contact.body2.contour)):
        own = slice(2 * side, 2 * side + contour.dimension)
        point = contour.point(found.location[own], t, found.charts[side])
        way += float(np.linalg.norm(point - contour.point(guess[own], t)))
    return way


def on_side(found: list[Candidate], side: int) -> list[Candidate]:
    """Those of candidates that are on a side, or may be, 0 for any; all where none is."""
    return [one for one in found if side == 0 or one.side in (0, side)] or found


def stationary_points(
    system: Workspace,
    t: float,
    starts: np.ndarray,
    branches: Sequence[int],
    inside: bool = True,
    charts: tuple[int, int] = (0, 0),
) -> tuple[list[Candidate], set[int]]:
    """What Newton's method finds from starts (n, 4), in these charts, in their order, and how it went; inside: without
    what is beyond finite domains. branches: of closed forms."""
    integers, reals = system.find_stationary(t, starts, np.array(branches, dtype=np.int64), charts)
    found = (
        Candidate(row[:4], row[4], ints[1], row[5:].reshape(2, 3), ints[2], branch, (ints[3], ints[4]))
        for ints, row, branch in zip(integers.tolist(), reals, branches)
        if ints[0] == OK
    )
    return [one for one in found if comes_back(system, one) or not inside], set(integers[:, 0].tolist())


def comes_back(system: Workspace, found: Candidate) -> bool:
    """Take coordinates after which a contour repeats back to its domain; whether all are within theirs."""
    contact, within = system.contacts[0], True
    for side, contour in enumerate((contact.body1.contour, contact.body2.contour)):
        if found.charts[side] != 0:
            continue
        u = found.location[2 * side :]
        for a, (low, high) in enumerate(contour.domain):
            if math.isfinite(contour.periods[a]):
                # where the domain is less than a period, next to its middle
                first = 0.5 * (low + high - contour.periods[a])
                u[a] -= contour.periods[a] * math.floor((u[a] - first) / contour.periods[a])
            if not contour.periodic[a]:
                within = within and low - END_MARGIN <= u[a] <= high + END_MARGIN
    return within


def _seeds(system: Workspace, t: float, guess: np.ndarray) -> list[np.ndarray]:
    """Starts for Newton: sample pairs that are near each other, and near with their tangents aligned; first the nearest
    point to one that is given."""
    contact = system.contacts[0]
    bodies = contact.body1, contact.body2
    poses = [pose_of(system.data, body, t) for body in bodies]
    distance = float(np.linalg.norm(poses[0].translation - poses[1].translation))
    sizes = [b.contour.size if math.isfinite(b.contour.size) else 0.0 for b in (contact.body1, contact.body2)]
    window = distance + _WINDOW * sum(sizes) + _LEAST_WINDOW
    first = sample(contact.body1.contour, poses[0], t, window, guess[:2])
    second = sample(contact.body2.contour, poses[1], t, window, guess[2:])
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
    seeds = []
    for own, other in ((0, 1), (1, 0)):
        given, wanted = (slice(2 * i, 2 * i + bodies[i].contour.dimension) for i in (own, other))
        if given.stop > given.start and np.isfinite(guess[given]).all() and np.isnan(guess[wanted]).any():
            point = poses[own].act(bodies[own].contour.point(guess[given].tolist(), t))
            seeds.append(guess.copy())
            seeds[-1][wanted] = nearest_point(bodies[other].contour, poses[other].actInv(point), t)[0]
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
    taken: list[np.ndarray] = []
    # part by part: the first parts are mostly enough
    for start in range(0, len(order), _PART):
        left = order[start : start + _PART]
        for point in taken:
            left = left[np.linalg.norm(points[left] - point, axis=1) > distance]
        while left.size:
            if len(taken) == count:
                return
            yield int(left[0])
            taken.append(points[left[0]])
            left = left[np.linalg.norm(points[left] - taken[-1], axis=1) > distance]


def ends_within(contour: Contour, a: int, t: float, place: np.ndarray, radius: float) -> tuple[float, float]:
    """Ends of a parameter beyond which a contour is nowhere within a radius in m of a place (3,) in its frame. Where
    bounds do not tell them, where it leaves, for what is tried, all that is as near to its origin as that, or as far
    away as samples reach."""
    ends = list(ends_near(contour, a, place, radius, t))
    middle, window = _middle(contour), radius + float(np.linalg.norm(place))
    speed, spacing = _pace(contour, a, t, window)
    octaves = max(math.log2(0.25 * _MOST_SAMPLES * spacing / (speed * window)), 0.0)
    widths = window * 2.0 ** (np.arange(_PARTS * math.ceil(octaves) + 1) / _PARTS)
    for i, sign in enumerate((-1.0, 1.0)):
        if math.isinf(ends[i]):
            tried = np.tile(middle, (len(widths), 1))
            tried[:, a] += sign * widths
            near = np.linalg.norm(contour.evaluate_many(tried, t)[:, 0], axis=1) < window
            ends[i] = float(tried[min(int(np.flatnonzero(near).max(initial=-1)) + 1, len(widths) - 1), a])
    return ends[0], ends[1]


def _middle(contour: Contour) -> list[float]:
    """Parameters where it is begun to look for where a contour without ends leaves something."""
    return [min(max(0.0, low), high) for low, high in contour.domain]


def _pace(contour: Contour, a: int, t: float, window: float) -> tuple[float, float]:
    """How fast a contour goes along a parameter, in m per unit, and how far in m samples along it are apart."""
    spacing = _SPACING * (contour.size if math.isfinite(contour.size) else window)
    # at least so fast that the window is left, or the samples used up, after a while
    speed = float(np.linalg.norm(contour.evaluate(_middle(contour), t)[1 + a]))
    return max(speed, _SLOWEST * (spacing / window)), spacing


def _within(contour: Contour, a: int, t: float, window: float) -> tuple[float, float, int]:
    """Ends of a parameter without end beyond which the contour is outside the window in m around its origin, as far as
    from there to it added; and how many samples show what is between."""
    radius = window + float(np.linalg.norm(contour.point(_middle(contour), t)))
    low, high = ends_within(contour, a, t, np.zeros(3), radius)
    speed, spacing = _pace(contour, a, t, window)
    return low, high, int(min(speed * (high - low) / spacing, _MOST_SAMPLES - 1)) + 1


def sample(
    contour: Contour, pose: pin.SE3, t: float, window: float, guess: Sequence[float] | np.ndarray = _UNKNOWN
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """Parameters (n, 2), world points (n, 3), unit normals (n, 3) and unit tangents [(n, 3)] of a contour, of lengths
    within a window in m. guess: parameters, NaN where unknown."""
    axes = []
    counts = (_CURVE_SAMPLES,) if contour.dimension == 1 else _SURFACE_SAMPLES
    for a in range(contour.dimension):
        low, high = contour.domain[a]
        if not math.isnan(guess[a]):
            axes.append(np.array([guess[a]]))
            continue
        count = counts[a]
        # what is infinite is cut to the window; so are lengths, but not angles and other people's parameters
        if contour.lengths and math.isinf(contour.periods[a]):
            low, high = max(low, min(-window, high)), min(high, max(window, low))
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


def nearest_point(contour: Contour, point: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Parameters (k,) of a contour's nearest point to one (3,) in its frame, its ends included, and f and its
    derivatives (10, 3) there: from the nearest sample down."""
    k = contour.dimension
    parameters, points, _, _ = sample(contour, pin.SE3.Identity(), t, 2.0 * float(np.linalg.norm(point)) + 1.0)
    low, high = contour.ends().reshape(2, 2)[:k].T
    # poles, which are no ends, are as near as samples are
    low = np.where(np.isinf(low) & ~np.array(contour.periodic[:k]), parameters[:, :k].min(axis=0), low)
    high = np.where(np.isinf(high) & ~np.array(contour.periodic[:k]), parameters[:, :k].max(axis=0), high)
    u = np.clip(parameters[int(np.argmin(np.linalg.norm(points - point, axis=1)))][:k], low, high)
    values, factor = contour.evaluate(u.tolist(), t), 1.0
    for _ in range(_DESCENTS):
        way = point - values[0]
        new = np.clip(u + factor * np.linalg.lstsq(values[1 : 1 + k].T, way, rcond=None)[0], low, high)
        if (new == u).all():
            break
        there = contour.evaluate(new.tolist(), t)
        if np.linalg.norm(point - there[0]) < np.linalg.norm(way):
            u, values = new, there
        else:
            factor *= 0.5
    return u, values


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
