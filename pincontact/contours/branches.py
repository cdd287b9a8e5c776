"""Where a user's function is smooth: its paths and their risks, followed through the whole domain.

The domain is cut into boxes until bounds prove for each that one path of the function holds all over it and that
nothing of that path leaves its arguments' domain: no root of a quantity that falls to zero, no vanishing denominator.
What cannot be proved where boxes have become tiny is a place where the function changes from path to path, or where it
is not smooth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ..errors import ContourError
from .base import Contour
from .enclosures import FAULTS, Check, Interval, is_end, margins, values
from .formula import Formula
from .tape import traced
from .trace import Path, Tape

# Boxes no wider than this part of the domain are not cut again; so far from its ends a formula may do what it likes.
_TINY = 1e-9
# What is taken for the size of an infinite domain there.
_UNBOUNDED = 1.0
# Boxes are examined so many at a time and so many times. Each variable needs some thirty times; what is left over then
# has been looked at in thousands of places.
_BATCH = 256
_ROUNDS = 100
# Beyond this an infinite domain is not searched.
_FAR = 1e6
# A function with more paths is not followed.
_MOST_PATHS = 64
# Nor is one with branches followed further than this many bounds: a fit then shows what it is like.
_MOST_WORK = 1500
# Times for which a formula need not be good are searched this often, for the rest is likely to be unused.
_LATER_ROUNDS = 50
# Beside the end of a quantity's domain, so far from it, it has no value on one side.
_BESIDE = 1e-6
# Where in a box its path is looked at: not in the middle, where thresholds like to be.
_INSIDE = 0.4637
# Whether f jumps where an angle of it does is seen in boxes of this part of the domain, and in so many of them.
_CUT_WIDTH = 1e-3
_CUTS = 60
# To rounding, from such a box.
_HALVINGS = 60
# How far f may jump there, relative to its size: rounding, far less than angles jump.
_JUMP = 1e-9
# So many boxes of each path, and of what lies between two of them, are looked at in fits.
_PLACES = 40
# Where beside an edge, in its widths from its lower end.
_BESIDE_EDGES = (-3.0, 4.0)
# A root that is known no better than to this part of a box is not cut beside: the middle is as good.
_MOST_DOUBT = 0.1


@dataclass
class Survey:
    """What is known of a function before it is compiled.

    tape:    of the whole function, None where it has several paths or cannot be traced
    times:   first and last time at which the tape is the function, as far as is known
    reason:  why there is none
    breaks:  for each variable, where the function changes from path to path
    places:  (k, n) points on all paths and next to where they change
    """

    tape: Tape | None
    times: tuple[float, float]
    reason: str
    breaks: list[list[float]]
    places: np.ndarray


def names(variables: str) -> list[str]:
    """The variables of a function as users know them."""
    return list(variables) if "v" not in variables else [{"u": "u1", "v": "u2"}.get(name, name) for name in variables]


def place(variables: str, point: np.ndarray) -> str:
    """A point, for messages."""
    # what is zero up to rounding is shown as zero
    return ", ".join(f"{name} = {round(float(value), 12):.6g}" for name, value in zip(names(variables), point))


class _Followed:
    """A path with what decides where it holds and where it is smooth.

    checks: comparisons, then operations that may not be smooth, then angles that may jump
    """

    def __init__(self, path: Path, variables: str) -> None:
        self.path = path
        comparisons = list(dict.fromkeys(path.comparisons))
        self.checks: list[Check] = [*comparisons, *path.risks, *path.cuts]
        self.kinds = np.repeat([0, 1, 2], [len(comparisons), len(path.risks), len(path.cuts)])
        self.variables = variables
        self.nodes = path.graph.nodes
        self.order = path.graph.reachable([index for check in self.checks for index in check[1:3]])
        self.decisive = path.graph.reachable([check[1] for check in comparisons])

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Whether it is the function's path at points (m, n)."""
        found = self.values(points, self.decisive)
        out = np.ones(len(points), dtype=bool)
        for _, index, _, sign in self.checks[: int((self.kinds == 0).sum())]:
            out &= sign * found[index].lo >= 0.0
        return out

    def values(self, points: np.ndarray, order: list[int]) -> dict[int, Interval]:
        """Nodes at points (m, n)."""
        box = {name: Interval(points[:, i], points[:, i]) for i, name in enumerate(self.variables)}
        return values(self.nodes, order, box, {})


def survey(formula: Formula, domain: Sequence[tuple[float, float]], all_times: bool) -> Survey:
    """Follow a formula through its domain.

    domain:     (low, high) of each argument, possibly infinite
    all_times:  other times than those in the domain count, too: a formula may have no value there, which a run
                notices, but must not be another one, or rough, at later ones

    Raises ContourError naming what of the formula is not smooth, and where.
    """
    variables = formula.variables
    search = _Search(formula, domain, all_times)
    nowhere = np.zeros((0, len(variables)))
    try:
        search.run()
    except _TooManyPaths:
        reason = f"it has more than {_MOST_PATHS} branches"
        return Survey(None, search.times, reason, [[] for _ in domain], nowhere)
    followed, breaks = search.paths[0], search.breaks()
    if search.single and not followed.path.reason:
        tape = followed.path.tape(variables)
        search.check_cuts(tape)
        return Survey(tape, search.times, "", breaks, nowhere)
    where = [f"{name} = {places[0]:.6g}" for name, places in zip(names(variables), breaks) if places]
    reason = followed.path.reason
    if not search.single and not reason:
        reason = "it branches" + (f" at {', '.join(where)}" if where else "")
    return Survey(None, search.times, reason, breaks, search.places())


class _TooManyPaths(Exception):
    pass


class _Search:
    """Boxes that are still to be examined, and what was found.

    low, high:  (m, n) ends of the boxes
    trust:      (m,) margin at a point of the box that they were cut from; the least are the most suspicious
    branching:  (m,) whether a comparison may have both outcomes
    hint:       (m,) the path of the box that they were cut from
    cells:      boxes (low, high) on which a path holds, with its number
    edges:      boxes on which paths change, tiny ones or those left over
    work:       operations that were bounded; those at points cost a quarter of it
    single:     no second path has been found, but at early times
    known_times: those of the domain
    times:      first and last time for which the first path is good
    outside:    boxes are of times before or after those of the domain now
    """

    def __init__(self, formula: Formula, domain: Sequence[tuple[float, float]], all_times: bool) -> None:
        self.formula, self.owner, self.variables = formula, formula.owner, formula.variables
        low, high = np.array(domain, dtype=float).T
        self.size = np.where(np.isfinite(high - low), high - low, _UNBOUNDED)
        self.start, self.end = low + _TINY * self.size, high - _TINY * self.size
        self.low, self.high = self.start[None], self.end[None]
        self.trust, self.branching, self.hint = np.zeros(1), np.zeros(1, dtype=bool), np.zeros(1, dtype=int)
        self.paths: list[_Followed] = []
        self.cells: list[tuple[int, np.ndarray, np.ndarray]] = []
        self.edges: list[tuple[np.ndarray, np.ndarray]] = []
        self.cuts: list[np.ndarray] = []
        self.work = 0
        self.single, self.outside = True, False
        self.times = (-math.inf, math.inf)
        self.time = self.variables.find("t")
        self.all_times = all_times and self.time >= 0
        self.known_times = float(low[self.time]), float(high[self.time])

    @property
    def inside(self) -> np.ndarray:
        """A point of each box."""
        return _between(self.low, self.high, _INSIDE)

    def run(self) -> None:
        """Examine the domain, and all times where that is asked for."""
        self._search(_ROUNDS)
        self.edges += [(self.low[i], self.high[i]) for i in np.flatnonzero(self.branching)]
        self.single = self.single and not self.edges
        if self.time < 0 or not (self.single and self.paths[0].checks):
            return
        if not self.all_times:
            self.times = self.known_times
            return
        first, last = self.known_times
        self.outside = True
        self.low, self.high = np.tile(self.start, (2, 1)), np.tile(self.end, (2, 1))
        self.low[:, self.time], self.high[:, self.time] = (-math.inf, last), (first, math.inf)
        self.start[self.time], self.end[self.time] = -math.inf, math.inf
        self.trust, self.branching, self.hint = np.zeros(2), np.zeros(2, dtype=bool), np.zeros(2, dtype=int)
        self._search(_LATER_ROUNDS)
        self._end_early(self.high[self.branching])

    def _end_early(self, high: np.ndarray) -> None:
        """The first path is not known to be good at early times in boxes with these upper ends."""
        ends = high[high[:, self.time] <= self.known_times[0], self.time]
        self.times = max([self.times[0], *ends.tolist()]), self.times[1]

    def _search(self, rounds: int) -> None:
        """Examine boxes until none is left, or for long enough."""
        for _ in range(rounds):
            if not len(self.low):
                return
            if not self.single and self.work > _MOST_WORK:
                return
            # the most suspicious boxes, of which one is wrong if any is, and the largest ones
            size = np.minimum((self.high - self.low) / self.size, 1e300).max(axis=1)
            chosen = np.zeros(len(size), dtype=bool)
            for order in (np.argsort(self.trust, kind="stable"), np.argsort(-size, kind="stable")):
                chosen[order[: _BATCH // 2]] = True
            batch, rest = np.flatnonzero(chosen), ~chosen
            low, high, inside, hint = self.low[batch], self.high[batch], self.inside[batch], self.hint[batch]
            self.low, self.high, self.trust, self.branching, self.hint = (
                column[rest] for column in (self.low, self.high, self.trust, self.branching, self.hint)
            )
            path_of = self._path_of(inside, hint)
            for number in np.unique(path_of):
                mine = path_of == number
                self._examine(int(number), low[mine], high[mine], inside[mine])

    def _path_of(self, points: np.ndarray, hint: np.ndarray) -> np.ndarray:
        """The number of the path at each point; paths that are met for the first time are added."""
        out = np.full(len(points), -1)
        for among in (lambda number: hint == number, lambda number: True):
            for number, followed in enumerate(self.paths):
                open_ = np.flatnonzero((out < 0) & among(number))
                if open_.size:
                    self.work += len(followed.decisive) // 4
                    out[open_[followed.holds(points[open_])]] = number
        while (out < 0).any():
            if len(self.paths) == _MOST_PATHS:
                raise _TooManyPaths
            first = int(np.argmax(out < 0))
            path = Path(self.formula.function, self.variables, self.formula.outputs, points[first].tolist())
            self.paths.append(_Followed(path, self.variables))
            open_ = np.flatnonzero(out < 0)
            out[open_[self.paths[-1].holds(points[open_])]] = out[first] = len(self.paths) - 1
        return out

    def _examine(self, number: int, low: np.ndarray, high: np.ndarray, inside: np.ndarray) -> None:
        """Prove what a path does on boxes at whose points it holds, or cut them."""
        followed = self.paths[number]
        early = np.zeros(len(low), dtype=bool)
        if self.outside:
            early = high[:, self.time] <= self.known_times[0]
        if number > 0:
            self.single = self.single and bool(early.all())
        if not followed.checks:
            self.cells += [(number, a, b) for a, b in zip(low, high)]
            return
        self.work += len(followed.order)
        least, there, slopes = margins(
            followed.nodes, followed.order, followed.checks, self.variables, *self._widened(low, high), inside
        )
        kinds = followed.kinds[:, None]
        branching = ((least < 0.0) & (kinds == 0)).any(axis=0)
        risky = (least <= 0.0) & (kinds == 1) & ~early
        broken = risky & (there <= 0.0)
        if self.outside:
            # what has no value is no other shape
            ending = np.array([is_end(check[0], check[3]) for check in followed.checks])[:, None]
            risky &= ~(broken & ending & (there < 0.0)).any(axis=0)
            broken &= risky
        if broken.any():
            check, box = np.argwhere(broken)[0]
            self._refuse(followed.checks[check], inside[box])
        open_ = (least < 0.0) & (kinds == 0) | risky | (least <= 0.0) & (kinds == 2)
        # the check whose margin is least says along which variable a box is cut
        trust = np.where(open_, np.nan_to_num(there, nan=0.0), np.inf)
        boxes = np.arange(len(low))
        worst = np.argmin(trust, axis=0)
        with np.errstate(invalid="ignore"):
            along = np.abs(slopes[worst, boxes]).max(axis=-1).sum(axis=-1) * (high - low)
        along = np.minimum(np.nan_to_num(along, nan=0.0), 1e300) * ((high - low) > _TINY * self.size)
        # of variables that matter without bounds, the one that is widest
        along = np.where(along >= 1e300, 1e300 * np.minimum((high - low) / self.size, 1e3), along)
        axis = np.argmax(along, axis=1)
        # angles may jump where f does not: a look at some of these places is enough
        cut = open_.any(axis=0) & ~(open_ & (kinds < 2)).any(axis=0)
        cut &= ((high - low)[boxes, axis] <= _CUT_WIDTH * self.size[axis]) | (len(self.cuts) >= _CUTS)
        if number == 0:
            self.cuts += [np.stack(box) for box in zip(low[cut], high[cut])]
        done = cut | ~open_.any(axis=0)
        tiny = ~done & ~(along.max(axis=1) > 0.0)
        for box in np.flatnonzero(tiny):
            if early[box]:
                self._end_early(high[box][None])
            elif branching[box]:
                self.edges.append((low[box], high[box]))
                self.single = False
            elif not (self.outside and self._is_end(followed, followed.checks[worst[box]], inside[box])):
                self._refuse(followed.checks[worst[box]], inside[box])
        nearest = np.where(np.isinf(low), -high, low)[boxes, axis]
        far = np.isinf((high - low)[boxes, axis]) & (nearest >= _FAR)
        self.cells += [(number, a, b) for a, b in zip(low[done | far], high[done | far])]
        if number > 0:
            self._end_early(high[(done | far) & early])
        left = np.flatnonzero(~(done | far | tiny))
        middle = _between(low[left], high[left], 0.5)[np.arange(len(left)), axis[left]]
        for i, box in enumerate(left):
            k, j = worst[box], axis[box]
            if kinds[k] == 0 and (np.delete(along[box], j) == 0.0).all():
                # next to the only place where the comparison's outcome changes, as far as its slope is known
                slope = np.sort(slopes[k, box, j, 0] * followed.checks[k][3])
                line = (inside[box, j], there[k, box], *slope.tolist())
                middle[i] = _beside_root(low[box, j], high[box, j], line, _TINY * self.size[j], middle[i])
        for upper in (False, True):
            ends = (low[left].copy(), high[left].copy())
            ends[0 if upper else 1][np.arange(len(left)), axis[left]] = middle
            self.low, self.high = np.concatenate([self.low, ends[0]]), np.concatenate([self.high, ends[1]])
            self.trust = np.concatenate([self.trust, trust[worst[left], left]])
            self.branching = np.concatenate([self.branching, branching[left]])
            self.hint = np.concatenate([self.hint, np.full(len(left), number)])

    def _widened(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A little more than the boxes: what happens at an end must not fall between two of them."""
        more = 0.25 * _TINY * self.size
        return np.maximum(low - more, self.start), np.minimum(high + more, self.end)

    def _is_end(self, followed: _Followed, check: Check, point: np.ndarray) -> bool:
        """Whether the function has no value on one side of a point."""
        if not is_end(check[0], check[3]):
            return False
        around = np.array([point + _BESIDE * np.array(signs) for signs in product((-1.0, 1.0), repeat=len(point))])
        _, there, _ = margins(followed.nodes, followed.order, [check], self.variables, around, around, around)
        return bool((there < 0.0).any())

    def _refuse(self, check: Check, point: np.ndarray) -> None:
        where = place(self.variables, point)
        fault = FAULTS.get(check[0], "an angle that jumps by a turn")
        hint = "; if that is no time of interest, say so by time_domain=(first, last)" if self.all_times else ""
        raise ContourError(f"{self.owner}: not smooth near {where}: f takes {fault}{hint}")

    def check_cuts(self, tape: Tape) -> None:
        """Refuse a formula that jumps, or whose derivatives do, where an angle of it jumps by a turn."""
        if not self.cuts:
            return
        followed = self.paths[0]
        boxes = np.array(self.cuts[:_CUTS])
        low, high = self._widened(boxes[:, 0], boxes[:, 1])
        sides = [np.zeros((0, 2, len(self.variables)))]
        for check in (check for check, kind in zip(followed.checks, followed.kinds) if kind == 2):
            order = followed.path.graph.reachable([check[1]])
            for axis in range(len(self.variables)):
                # From one side of the cut to the other: the sign of the angle's first argument.
                a = _between(low, high, _INSIDE)
                b = a.copy()
                a[:, axis], b[:, axis] = low[:, axis], high[:, axis]
                sign = followed.values(a, order)[check[1]].lo
                across = sign * followed.values(b, order)[check[1]].lo < 0.0
                a, b, sign = a[across], b[across], sign[across]
                for _ in range(_HALVINGS):
                    middle = 0.5 * (a + b)
                    same = (followed.values(middle, order)[check[1]].lo * sign > 0.0)[:, None]
                    a, b = np.where(same, middle, a), np.where(same, b, middle)
                sides.append(np.stack([a, b], axis=1))
        pairs = np.concatenate(sides)
        parameters = self.variables.replace("t", "")
        contour = Contour(traced, len(parameters), pool=tape.pool)
        times = pairs[..., -1] if "t" in self.variables else np.zeros(pairs.shape[:2])
        rows = np.array(
            [
                [contour.evaluate(p[: len(parameters)], float(t)) for p, t in zip(pair, pair_times)]
                for pair, pair_times in zip(pairs, times)
            ]
        )
        valid = np.isfinite(rows).all(axis=(1, 2, 3))  # not beyond the end of what has a value for a time only
        for pair, (before, after) in zip(pairs[valid], rows[valid]):
            jump = np.abs(after - before).max(axis=1)
            if (jump > _JUMP * np.abs(rows[valid]).max()).any():
                raise ContourError(
                    f"{self.owner}: not smooth near {place(self.variables, pair[0])}: f jumps by {jump[0]:.2e} and its "
                    f"derivatives by up to {jump[1:].max():.2e} where an angle of it (atan2) jumps by a turn"
                )

    def breaks(self) -> list[list[float]]:
        """For each variable, where edges are that go across it."""
        out = []
        for axis in range(len(self.variables)):
            tiny = _TINY * self.size[axis]
            thin = [(a, b) for a, b in self.edges if b[axis] - a[axis] <= 2.0 * tiny]
            groups: list[list[np.ndarray]] = []
            for a, b in sorted(thin, key=lambda edge: edge[0][axis]):
                if groups and a[axis] - groups[-1][1][axis] <= 4.0 * tiny:
                    groups[-1][1] = np.where(np.arange(len(a)) == axis, b, groups[-1][1])
                else:
                    groups.append([a, b])
            out.append([self._change(axis, a, b, tiny) for a, b in groups])
        return out

    def _change(self, axis: int, low: np.ndarray, high: np.ndarray, tiny: float) -> float:
        """Where between two points the path changes along one variable."""
        a = _between(low, high, _INSIDE)
        b = a.copy()
        a[axis] = max(low[axis] - tiny, self.start[axis])
        b[axis] = min(high[axis] + tiny, self.end[axis])
        followed = self.paths[self._path_of(a[None], np.zeros(1, dtype=int))[0]]
        rounding = np.finfo(float).eps * self.size[axis]
        while b[axis] - a[axis] > rounding:
            point = np.where(np.arange(len(a)) == axis, 0.5 * (a[axis] + b[axis]), a)
            if np.array_equal(point, a) or np.array_equal(point, b):
                break
            a, b = (point, b) if followed.holds(point[None])[0] else (a, point)
        return float(b[axis]) if abs(b[axis]) > rounding else 0.0

    def places(self) -> np.ndarray:
        """Points (k, n) on every path, and on both sides of where they change, in a finite domain."""
        out: list[np.ndarray] = []
        if not np.isfinite([self.start, self.end]).all():
            return np.zeros((0, len(self.variables)))
        for number in range(len(self.paths)):
            boxes = [(a, b) for path, a, b in self.cells if path == number]
            boxes.sort(key=lambda box: -float(np.prod(box[1] - box[0])))
            out += [_between(a, b, _INSIDE) for a, b in boxes[:_PLACES]]
        for low, high in self.edges[:: 1 + len(self.edges) // _PLACES]:
            thin = (high - low) <= 2.0 * _TINY * self.size
            for part in _BESIDE_EDGES:
                place = low + np.where(thin, part, _INSIDE) * (high - low)
                out.append(np.clip(place, self.start, self.end))
        return np.array(out).reshape(-1, len(self.variables))


def _between(low: np.ndarray, high: np.ndarray, part: float) -> np.ndarray:
    """That part of the way from low to high; where an end is infinite, twice as far out as the other one.

    For half of the way that is where infinite boxes are cut: at 0, 1, 3, 7...
    """
    off = part - 0.5
    with np.errstate(invalid="ignore"):
        between = low + part * (high - low)
        beyond = np.where(np.isinf(high), 2.0 * np.maximum(low, 0.0) + 1.0, 2.0 * np.minimum(high, 0.0) - 1.0)
        beyond = np.where(np.isinf(low) & np.isinf(high), 20.0 * off, beyond + off)
    return np.where(np.isinf(low) | np.isinf(high), beyond, between)


def _beside_root(low: float, high: float, line: tuple[float, float, float, float], tiny: float, middle: float) -> float:
    """A place between low and high just before or after a root, so that two such cuts leave little of it.

    line: a point, the quantity's value there, bounds of its slope. Where these are too far apart: the middle.
    """
    x, value, least, most = line
    slope, width = 0.5 * (least + most), high - low
    if not (np.isfinite([least, most, width]).all() and least * most > 0.0):
        return middle
    doubt = 0.4 * tiny + 2.0 * width * (most - least) / abs(slope)
    if doubt > _MOST_DOUBT * width:
        return middle
    for place in (x - value / slope - doubt, x - value / slope + doubt):
        if low + doubt < place < high - doubt:
            return place
    return middle
