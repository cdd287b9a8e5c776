"""Where a user's function is smooth: its paths and their risks, followed through the whole domain.

The domain is cut into boxes until bounds prove for each that one path of the function holds all over it and that
nothing of that path leaves its arguments' domain: no root of a quantity that falls to zero, no vanishing denominator.
What cannot be proved where boxes have become tiny is a place where the function changes from path to path, or where it
is not smooth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ..errors import ContourError
from .base import Contour
from .enclosures import FAULTS, Check, is_end
from .formula import Formula
from .tape import traced
from .trace import COMPARISON, CUT, RISK, Path, Program

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

    tape: Program | None
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
    path, breaks = search.paths[0], search.breaks()
    if search.single and not path.reason:
        tape = path.tape()
        search.check_cuts(tape)
        return Survey(tape, search.times, "", breaks, nowhere)
    where = [f"{name} = {places[0]:.6g}" for name, places in zip(names(variables), breaks) if places]
    reason = path.reason or "it branches" + (f" at {', '.join(where)}" if where else "")
    return Survey(None, search.times, reason, breaks, search.places())


class _TooManyPaths(Exception):
    pass


class _Search:
    """Boxes that are still to be examined, and what was found.

    boxes:      (m,) records: ends low (n,) and high (n,), trust: margin at a point of the box that it was cut from, the
                least are the most suspicious, branching: whether a comparison may have both outcomes, hint: the path of
                the box that it was cut from
    cells:      boxes (low, high) on which a path holds, with its number
    edges:      boxes on which paths change, tiny ones or those left over
    work:       operations that were bounded; those at points cost a quarter of it
    single:     no second path has been found, but at early times
    time:       the time's number among the variables, -1 without one
    known_times: those of the domain, of which boxes are first, then of early ones before them and of those after them
    times:      first and last time for which the first path is good
    """

    def __init__(self, formula: Formula, domain: Sequence[tuple[float, float]], all_times: bool) -> None:
        self.formula, self.owner, self.variables = formula, formula.owner, formula.variables
        low, high = np.array(domain, dtype=float).T
        self.size = np.where(np.isfinite(high - low), high - low, _UNBOUNDED)
        self.start, self.end = low + _TINY * self.size, high - _TINY * self.size
        self.time = self.variables.find("t")
        self.known_times = float(low[self.time]), float(high[self.time])
        self.all_times = all_times and self.time >= 0
        self.paths: list[Path] = []
        self.cells: list[tuple[int, np.ndarray, np.ndarray]] = []
        self.edges: list[tuple[np.ndarray, np.ndarray]] = []
        self.cuts: list[np.ndarray] = []
        self.work = 0
        self.single = True
        self.times = (-math.inf, math.inf)

    def run(self) -> None:
        """Examine the domain, and all times where that is asked for."""
        left = self._search(self.start[None], self.end[None], _ROUNDS)
        self.edges += list(zip(left["low"], left["high"]))
        self.single = self.single and not self.edges
        if self.time < 0 or not (self.single and self.paths[0].checks):
            return
        if not self.all_times:
            self.times = self.known_times
            return
        low, high = np.tile(self.start, (2, 1)), np.tile(self.end, (2, 1))
        high[0, self.time], low[1, self.time] = self.known_times
        low[0, self.time], high[1, self.time] = self.start[self.time], self.end[self.time] = -math.inf, math.inf
        self._end_early(self._search(low, high, _LATER_ROUNDS)["high"])

    def _is_early(self, high: np.ndarray) -> np.ndarray:
        """Whether boxes with these upper ends are of times before those of the domain; without time none is."""
        early: np.ndarray = high[:, self.time] <= self.known_times[0]
        return early

    def _end_early(self, high: np.ndarray) -> None:
        """The first path is not known to be good at early times in boxes with these upper ends."""
        ends = high[self._is_early(high), self.time]
        self.times = max([self.times[0], *ends.tolist()]), self.times[1]

    def _search(self, low: np.ndarray, high: np.ndarray, rounds: int) -> np.ndarray:
        """Examine boxes until none is left, or for long enough; those left on which a comparison has both outcomes."""
        ends = (low.shape[1],)
        fields = [("low", float, ends), ("high", float, ends), ("trust", float), ("branching", bool), ("hint", int)]
        self.boxes = np.zeros(len(low), fields)
        self.boxes["low"], self.boxes["high"] = low, high
        for _ in range(rounds):
            if not len(self.boxes) or (not self.single and self.work > _MOST_WORK):
                break
            # the most suspicious boxes, of which one is wrong if any is, and the largest ones
            size = np.minimum((self.boxes["high"] - self.boxes["low"]) / self.size, 1e300).max(axis=1)
            chosen = np.zeros(len(size), dtype=bool)
            for order in (np.argsort(self.boxes["trust"], kind="stable"), np.argsort(-size, kind="stable")):
                chosen[order[: _BATCH // 2]] = True
            batch, self.boxes = self.boxes[chosen], self.boxes[~chosen]
            inside = _between(batch["low"], batch["high"], _INSIDE)
            path_of = self._path_of(inside, batch["hint"])
            for number in np.unique(path_of):
                mine = path_of == number
                self._examine(int(number), batch[mine], inside[mine])
        return self.boxes[self.boxes["branching"]]

    def _path_of(self, points: np.ndarray, hint: np.ndarray) -> np.ndarray:
        """The number of the path at each point; paths that are met for the first time are added."""
        out = np.full(len(points), -1)
        for among in (lambda number: hint == number, lambda number: True):
            for number, path in enumerate(self.paths):
                open_ = np.flatnonzero((out < 0) & among(number))
                if open_.size:
                    self.work += len(path.decisive) // 4
                    out[open_[path.holds(points[open_])]] = number
        while (out < 0).any():
            if len(self.paths) == _MOST_PATHS:
                raise _TooManyPaths
            first = int(np.argmax(out < 0))
            path = Path(self.formula.function, self.variables, self.formula.outputs, points[first].tolist())
            self.paths.append(path)
            open_ = np.flatnonzero(out < 0)
            out[open_[path.holds(points[open_])]] = out[first] = len(self.paths) - 1
        return out

    def _examine(self, number: int, boxes: np.ndarray, inside: np.ndarray) -> None:
        """Prove what a path does on boxes at whose points it holds, or cut them."""
        path, low, high = self.paths[number], boxes["low"], boxes["high"]
        early = self._is_early(high)
        outside = early | (low[:, self.time] >= self.known_times[1])
        if number > 0:
            self.single = self.single and bool(early.all())
        if not path.checks:
            self.cells += [(number, a, b) for a, b in zip(low, high)]
            return
        self.work += len(path.order)
        least, there, slopes = path.margins(path.checks, *self._widened(low, high), inside)
        kinds = path.kinds[:, None]
        branching = ((least < 0.0) & (kinds == COMPARISON)).any(axis=0)
        risky = (least <= 0.0) & (kinds == RISK) & ~early
        broken = risky & (there <= 0.0)
        # what has no value at times outside is no other shape
        ending = np.array([is_end(check[0], check[3]) for check in path.checks])[:, None]
        risky &= ~(broken & ending & (there < 0.0) & outside).any(axis=0)
        broken &= risky
        if broken.any():
            check, box = np.argwhere(broken)[0]
            self._refuse(path.checks[check], inside[box])
        open_ = (least < 0.0) & (kinds == COMPARISON) | risky | (least <= 0.0) & (kinds == CUT)
        # the check whose margin is least says along which variable a box is cut
        trust = np.where(open_, np.nan_to_num(there, nan=0.0), np.inf)
        every = np.arange(len(low))
        worst = np.argmin(trust, axis=0)
        with np.errstate(invalid="ignore"):
            along = np.abs(slopes[worst, every]).max(axis=-1).sum(axis=-1) * (high - low)
        along = np.minimum(np.nan_to_num(along, nan=0.0), 1e300) * ((high - low) > _TINY * self.size)
        # of variables that matter without bounds, the one that is widest
        along = np.where(along >= 1e300, 1e300 * np.minimum((high - low) / self.size, 1e3), along)
        axis = np.argmax(along, axis=1)
        # angles may jump where f does not: a look at some of these places is enough
        cut = open_.any(axis=0) & ~(open_ & (kinds != CUT)).any(axis=0)
        cut &= ((high - low)[every, axis] <= _CUT_WIDTH * self.size[axis]) | (len(self.cuts) >= _CUTS)
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
            elif not (outside[box] and self._is_end(path, path.checks[worst[box]], inside[box])):
                self._refuse(path.checks[worst[box]], inside[box])
        nearest = np.where(np.isinf(low), -high, low)[every, axis]
        done |= ~tiny & np.isinf((high - low)[every, axis]) & (nearest >= _FAR)
        self.cells += [(number, a, b) for a, b in zip(low[done], high[done])]
        if number > 0:
            self._end_early(high[done & early])
        left = np.flatnonzero(~(done | tiny))
        middle = _between(low[left], high[left], 0.5)[np.arange(len(left)), axis[left]]
        for i, box in enumerate(left):
            k, j = worst[box], axis[box]
            if kinds[k] == COMPARISON and (np.delete(along[box], j) == 0.0).all():
                # next to the only place where the comparison's outcome changes, as far as its slope is known
                slope = np.sort(slopes[k, box, j, 0] * path.checks[k][3])
                line = (inside[box, j], there[k, box], *slope.tolist())
                middle[i] = _beside_root(low[box, j], high[box, j], line, _TINY * self.size[j], middle[i])
        parts = boxes[left]
        parts["trust"], parts["branching"], parts["hint"] = trust[worst[left], left], branching[left], number
        for end in ("high", "low"):
            part = parts.copy()
            part[end][np.arange(len(left)), axis[left]] = middle
            self.boxes = np.concatenate([self.boxes, part])

    def _widened(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A little more than the boxes: what happens at an end must not fall between two of them."""
        more = 0.25 * _TINY * self.size
        return np.maximum(low - more, self.start), np.minimum(high + more, self.end)

    def _is_end(self, path: Path, check: Check, point: np.ndarray) -> bool:
        """Whether the function has no value on one side of a point."""
        if not is_end(check[0], check[3]):
            return False
        around = np.array([point + _BESIDE * np.array(signs) for signs in product((-1.0, 1.0), repeat=len(point))])
        _, there, _ = path.margins([check], around, around, around)
        return bool((there < 0.0).any())

    def _refuse(self, check: Check, point: np.ndarray) -> None:
        where = place(self.variables, point)
        fault = FAULTS.get(check[0], "an angle that jumps by a turn")
        hint = "; if that is no time of interest, say so by time_domain=(first, last)" if self.all_times else ""
        raise ContourError(f"{self.owner}: not smooth near {where}: f takes {fault}{hint}")

    def check_cuts(self, tape: Program) -> None:
        """Refuse a formula that jumps, or whose derivatives do, where an angle of it jumps by a turn."""
        if not self.cuts:
            return
        path = self.paths[0]
        boxes = np.array(self.cuts[:_CUTS])
        low, high = self._widened(boxes[:, 0], boxes[:, 1])
        sides = [np.zeros((0, 2, len(self.variables)))]
        for check in (check for check, kind in zip(path.checks, path.kinds) if kind == CUT):
            for axis in range(len(self.variables)):
                # From one side of the cut to the other: the sign of the angle's first argument.
                a = _between(low, high, _INSIDE)
                b = a.copy()
                a[:, axis], b[:, axis] = low[:, axis], high[:, axis]
                sign = path.values(a, path.order)[check[1]].lo
                across = sign * path.values(b, path.order)[check[1]].lo < 0.0

                def same(points: np.ndarray, check: Check = check, sign: np.ndarray = sign[across]) -> np.ndarray:
                    return path.values(points, path.order)[check[1]].lo * sign > 0.0

                sides.append(np.stack(_halved(a[across], b[across], same), axis=1))
        pairs = np.concatenate(sides)
        k = self.formula.parameters
        contour = Contour(traced, k, pool=tape.pool)
        rows = np.array([[contour.evaluate(p[:k], *p[k:]) for p in pair] for pair in pairs])
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
        path = self.paths[self._path_of(a[None], np.zeros(1, dtype=int))[0]]
        end = float(_halved(a[None], b[None], path.holds)[1][0, axis])
        return end if abs(end) > np.finfo(float).eps * self.size[axis] else 0.0

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


def _halved(a: np.ndarray, b: np.ndarray, same: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Points (m, n) on both sides of where it changes which points are the same as those of a, brought together."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (a + b)
        kept = same(middle)[:, None]
        a, b = np.where(kept, middle, a), np.where(kept, b, middle)
    return a, b


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
