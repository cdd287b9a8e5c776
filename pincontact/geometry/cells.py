"""Cells of a contour that may be nearest to samples of another one, and feet of points on a contour: compiled.

A cell is a box of parameters: its middle, and a radius within which all its points lie. What is farther than the
nearest one is left out, the rest divided.
"""

from __future__ import annotations

import math

import numpy as np

from ..callback import kernel_address
from ..contours.base import F_1, F_2, F_11, F_12, F_22, Contour
from ..contours.evaluation import call_contour
from ..contours.sizes import DERIVATIVE_ROWS
from ..jit import CALLED, INTEGER, entry_kernel, kernel
from ..workspace import INTEGERS, REALS, Layout, Scratch, Workspace, record
from .small import cross, dot, norm, rotate_back

# Cells of a curve and along each parameter of a surface to begin with, how often they are divided, and how many are.
CURVE_CELLS, SURFACE_CELLS = 128, 24
_DIVISIONS, _MOST_CELLS = 12, 4096
# What tangents within a cell are longer by than the longest that was seen, and than what was seen in the cell that it
# is a part of: a flank that is seen from there may be in any one of its parts.
LONGER, _KEPT = 1.2, 0.5
# Cells are divided along both parameters but where they are so many times longer along one of them.
_LONGISH = 2.0
# Cells that are resolved, relative to the distance and to the radius of curvature.
_FINE, FINEST = 0.05, 0.05
# And relative to how much farther than the nearest ones they are, to cells of samples, and to radii of curvature there.
_COARSER = 0.25
# Samples of a leaf of their tree, and levels that it may have.
_LEAF, _LEVELS = 8, 24
# Steps of Newton's method to a foot, and feet that are looked for at the same time, at most.
_FOOT_STEPS, MOST_FEET = 4, 16
# Among so many places, one in each other neighbourhood, those are looked for from which to start.
_LOOKED_AT = 64
# Relative determinants below this are round-off.
_REGULAR = 1e-12

# evaluator, dimension: of the contour; cells, feet, lowest: how many there are
_COUNTS = record(INTEGERS, "evaluator", "dimension", "cells", "feet", "lowest")
# time in s; in m: beyond, how much farther than the nearest cell others may be that are kept; around, the radius of a
# sample's cell; finest, of cells that are resolved; apart, how far starts are from each other, at least. sharpest: the
# largest curvature found in the middles of cells, 1/m
_NUMBERS = record(REALS, "time", "beyond", "around", "finest", "apart", "sharpest")
_REALS, _INTEGERS = Scratch(REALS), Scratch(INTEGERS)
# "given": an array of somebody else's is put there
SEARCH = Layout(
    "search",
    counts=(_COUNTS,),
    numbers=(_NUMBERS,),
    shape=(REALS, "given"),  # of the contour, see `contours.evaluation`
    pool=(REALS, "given"),
    domain=(REALS, 2, 2),  # (2, 2) low and high ends of its parameters
    box=(REALS, 2, 2),  # (2, 2) the part of that which is covered
    pose=(REALS, 5, 3),  # (5, 3) rotation of the samples' frame in the contour's; a point in the latter, in the former
    samples=(REALS, "given", 3),  # (m, 3), see `SampleTree`
    nodes=(REALS, "given", 4),  # (k, 4)
    ends=(INTEGERS, "given", 2),  # (k, 2)
    order=(INTEGERS, "given"),  # (m,)
    middles=(_REALS, _MOST_CELLS, 2),  # (n, 2) parameters of cells
    halves=(_REALS, _MOST_CELLS, 2),  # (n, 2) half their size
    points=(_REALS, _MOST_CELLS, 3),  # (n, 3) their middles, in the contour's frame
    tangents=(_REALS, _MOST_CELLS, 2),  # (n, 2) how long these are in cells, as far as their middles tell
    stretches=(_REALS, _MOST_CELLS, 2),  # (n, 2) and as far as all around tells
    reaches=(_REALS, _MOST_CELLS),  # (n,) their radii in m
    bends=(_REALS, _MOST_CELLS),  # (n,) largest curvatures in their middles, in 1/m
    distances=(_REALS, _MOST_CELLS),  # (n,) of their middles from the nearest sample, in m
    pairs=(_INTEGERS, _MOST_CELLS),  # (n,) that sample, in the order of the tree
    left=(_INTEGERS, _MOST_CELLS),  # (n,) whether it may be chosen yet
    lowest=(_INTEGERS, MOST_FEET // 2),  # cells to start from
    targets=(_REALS, MOST_FEET, 3),  # (MOST_FEET, 3) in the contour's frame
    feet=(_REALS, MOST_FEET, 2),  # (MOST_FEET, 2) parameters: starts, then feet
    stack=(_INTEGERS, 2 * _LEVELS),
    rows=(REALS, DERIVATIVE_ROWS, 3),  # (10, 3) f and its derivatives: those that there are not stay zero
    vectors=(_REALS, 2, 3),
)
_search_at = SEARCH.at


class SampleTree:
    """Points (m, 3) in a tree of balls, each of which holds the samples between its ends.

    samples (m, 3), order (m,): in the tree's order, and which they were; nodes (k, 4), ends (k, 2): centre and radius
    in m, and first and last sample, of a heap.
    """

    def __init__(self, points: np.ndarray) -> None:
        depth = max(math.ceil(math.log2(len(points) / _LEAF)), 0)
        count = 2 ** (depth + 1) - 1
        self.order = np.arange(len(points))
        self.nodes, self.ends = np.zeros((count, 4)), np.zeros((count, 2), dtype=np.int64)
        self.ends[0] = 0, len(points)
        for i in range(count):
            first, last = self.ends[i].tolist()
            own = self.order[first:last]
            low, high = points[own].min(axis=0), points[own].max(axis=0)
            centre = 0.5 * (low + high)
            self.nodes[i] = *centre, np.linalg.norm(points[own] - centre, axis=1).max()
            if 2 * i + 2 < count:
                own[:] = own[np.argsort(points[own, np.argmax(high - low)], kind="stable")]
                middle = (first + last) // 2
                self.ends[2 * i + 1], self.ends[2 * i + 2] = (first, middle), (middle, last)
        self.samples = np.ascontiguousarray(points[self.order])


def search_workspace(contour: Contour, tree: SampleTree) -> Workspace:
    """The arrays of `SEARCH` for a contour and samples of another one."""
    search = Workspace(SEARCH)
    search.allocate()
    search.put("shape", contour.shape_row())
    search.put("pool", contour.pool)
    search.domain[: contour.dimension] = contour.domain
    search.counts["evaluator"], search.counts["dimension"] = kernel_address(contour.evaluator), contour.dimension
    put_samples(search, tree)
    return search


def put_samples(search: Workspace, tree: SampleTree) -> None:
    """Search for what is near these samples from here on."""
    for name in ("samples", "nodes", "ends", "order"):
        search.put(name, getattr(tree, name))


@kernel
def _evaluate(search, u1, u2):
    counts = search.counts
    call_contour(counts.evaluator, 0, search.shape, search.pool, u1, u2, search.numbers.time, search.rows)


@kernel
def _square_between(a, b):
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2


@kernel
def _nearest_sample(search, place, guess):
    """The sample nearest to a place (3,) in its frame, and its distance; guess: one that may be near."""
    samples, nodes, ends, stack = search.samples, search.nodes, search.ends, search.stack
    found, best = guess, _square_between(samples[guess], place)
    inner, top = nodes.shape[0] // 2, 1
    stack[0] = 0
    while top > 0:
        top -= 1
        i = stack[top]
        away = math.sqrt(_square_between(nodes[i], place)) - nodes[i, 3]
        if away > 0.0 and away * away >= best:
            continue
        if i >= inner:
            for k in range(ends[i, 0], ends[i, 1]):
                square = _square_between(samples[k], place)
                if square < best:
                    best, found = square, k
        else:
            one, two = 2 * i + 1, 2 * i + 2
            if _square_between(nodes[one], place) < _square_between(nodes[two], place):
                one, two = two, one
            stack[top], stack[top + 1] = one, two
            top += 2
    return found, math.sqrt(best)


@kernel
def _curvature(rows, dimension, vectors):
    """The largest curvature, of a surface the largest normal curvature, in 1/m; 0 where a tangent vanishes."""
    normal, speed = vectors[0], dot(rows[F_1], rows[F_1])
    if dimension == 1:
        cross(rows[F_1], rows[F_11], normal)
        return norm(normal) / (speed * math.sqrt(speed)) if speed > 0.0 else 0.0
    cross(rows[F_1], rows[F_2], normal)
    area, mixed, other = dot(normal, normal), dot(rows[F_1], rows[F_2]), dot(rows[F_2], rows[F_2])
    if not area > _REGULAR * speed * other:
        return 0.0
    l11, l12, l22 = dot(rows[F_11], normal), dot(rows[F_12], normal), dot(rows[F_22], normal)
    middle = 0.5 * (l11 * other - 2.0 * l12 * mixed + l22 * speed) / area
    product = (l11 * l22 - l12 * l12) / area
    return (abs(middle) + math.sqrt(max(middle * middle - product, 0.0))) / math.sqrt(area)


@kernel
def _place_cell(search, i, u1, u2, half1, half2, guess):
    """Make cell i of these parameters, of which nothing is known but what its middle tells."""
    search.middles[i, 0], search.middles[i, 1] = u1, u2
    search.halves[i, 0], search.halves[i, 1] = half1, half2
    _evaluate(search, u1, u2)
    pose, rows, point = search.pose, search.rows, search.points[i]
    lever, place = search.vectors[0], search.vectors[1]
    for k in range(3):
        point[k] = rows[0, k]
        lever[k] = point[k] - pose[3, k]
    rotate_back(pose, lever, place)
    for k in range(3):
        place[k] += pose[4, k]
    search.pairs[i], search.distances[i] = _nearest_sample(search, place, guess)
    search.bends[i] = _curvature(rows, search.counts.dimension, search.vectors)
    mixed = norm(rows[F_12])
    search.tangents[i, 0] = norm(rows[F_1]) + half1 * norm(rows[F_11]) + half2 * mixed
    search.tangents[i, 1] = norm(rows[F_2]) + half1 * mixed + half2 * norm(rows[F_22])
    search.stretches[i, 0], search.stretches[i, 1] = search.tangents[i, 0], search.tangents[i, 1]


@kernel
def _stretch(search, i, j, a):
    """What neighbouring cells, along parameter a, tell of each other's tangents."""
    for k in range(2):
        longest = max(search.tangents[i, k], search.tangents[j, k])
        if k == a:
            way = abs(search.middles[i, a] - search.middles[j, a])
            longest = max(longest, math.sqrt(_square_between(search.points[i], search.points[j])) / way)
        search.stretches[i, k] = max(search.stretches[i, k], longest)
        search.stretches[j, k] = max(search.stretches[j, k], longest)


@kernel
def _reach(search, i):
    halves, stretches = search.halves[i], search.stretches[i]
    return LONGER * (stretches[0] * halves[0] + stretches[1] * halves[1])


@kernel
def _divide(search, i, n, dimension):
    """Divide cell i, of n, in halves along each parameter along which it is long: the first part takes its place, the
    others come last. Their number."""
    u1, u2, half1, half2 = search.middles[i, 0], search.middles[i, 1], search.halves[i, 0], search.halves[i, 1]
    stretch1, stretch2 = _KEPT * search.stretches[i, 0], _KEPT * search.stretches[i, 1]
    long1, long2 = stretch1 * half1, stretch2 * half2
    parts1 = 2 if dimension == 1 or _LONGISH * long1 > long2 else 1
    parts2 = 2 if dimension == 2 and _LONGISH * long2 > long1 else 1
    half1, half2 = half1 / parts1, half2 / parts2
    guess, place, first = search.pairs[i], i, n
    for a in range(parts1):
        for b in range(parts2):
            v1, v2 = u1 + (2 * a + 1 - parts1) * half1, u2 + (2 * b + 1 - parts2) * half2
            _place_cell(search, place, v1, v2, half1, half2, guess)
            search.stretches[place, 0] = max(search.stretches[place, 0], stretch1)
            search.stretches[place, 1] = max(search.stretches[place, 1], stretch2)
            place, n = n, n + 1
    if parts1 + parts2 < 4:
        _stretch(search, i, first, 2 - parts1)
    else:
        for a in range(2):
            _stretch(search, i, first + a, 1 - a)
            _stretch(search, first + a, first + 2, a)
    return n - 1


@kernel
def _move_cell(search, i, k):
    """Cell i takes the place of cell k."""
    for a in range(2):
        search.middles[k, a], search.halves[k, a] = search.middles[i, a], search.halves[i, a]
        search.tangents[k, a], search.stretches[k, a] = search.tangents[i, a], search.stretches[i, a]
    for a in range(3):
        search.points[k, a] = search.points[i, a]
    search.distances[k], search.pairs[k], search.bends[k] = search.distances[i], search.pairs[i], search.bends[i]


@kernel
def _cover(search, dimension):
    """Cells all over the box; their number."""
    box = search.box
    count1, count2 = (SURFACE_CELLS, SURFACE_CELLS) if dimension == 2 else (CURVE_CELLS, 1)
    half1 = 0.5 * (box[0, 1] - box[0, 0]) / count1
    half2 = 0.5 * (box[1, 1] - box[1, 0]) / count2
    guess, n = 0, 0
    for a in range(count1):
        for b in range(count2):
            u1, u2 = box[0, 0] + half1 * (2 * a + 1), box[1, 0] + half2 * (2 * b + 1)
            _place_cell(search, n, u1, u2, half1, half2, guess)
            guess, n = search.pairs[n], n + 1
    for i in range(n):
        if i + count2 < n:
            _stretch(search, i, i + count2, 0)
        if (i + 1) % count2 != 0:
            _stretch(search, i, i + 1, 1)
    return n


@kernel
def _is_coarse(reach, farther, finest):
    """Whether a cell of this radius in m, whose middle is so much farther than what is nearest, is to be divided."""
    return reach > max(finest, _COARSER * farther)


@entry_kernel(INTEGER, when=CALLED)
def near_cells(address):
    """Find the cells that may be nearest to the samples."""
    search = _search_at(address)
    counts, numbers, distances, reaches = search.counts, search.numbers, search.distances, search.reaches
    dimension = counts.dimension
    n = _cover(search, dimension)
    for _ in range(_DIVISIONS):
        nearest = math.inf
        for i in range(n):
            nearest = min(nearest, distances[i])
            reaches[i] = _reach(search, i)
        beyond, sharpest = nearest + numbers.beyond + numbers.around, 0.0
        for i in range(n):
            if distances[i] - reaches[i] <= beyond:
                sharpest = max(sharpest, search.bends[i])
        numbers.sharpest, kept, coarse = sharpest, 0, 0
        finest = max(_FINE * max(nearest - numbers.around, 0.0), max(numbers.finest, _COARSER * numbers.around))
        if sharpest * finest > _COARSER:
            finest = max(_COARSER / sharpest, numbers.finest)
        for i in range(n):
            if distances[i] - reaches[i] <= beyond:
                _move_cell(search, i, kept)
                reaches[kept] = reaches[i]
                coarse += _is_coarse(reaches[i], distances[i] - nearest, finest)
                kept += 1
        n = kept
        if coarse == 0 or n + (2 * dimension - 1) * coarse > distances.shape[0]:
            break
        for i in range(kept):
            if _is_coarse(reaches[i], distances[i] - nearest, finest):
                n = _divide(search, i, n, dimension)
    for i in range(n):
        reaches[i] = _reach(search, i)
    counts.cells = n


@entry_kernel(INTEGER, when=CALLED)
def lowest_cells(address):
    """Where to start from: the cells with the least distances, apart from each other, and first those that have no
    lower one so near, or next to them. Around where a large body touches many are lower than wherever it touches
    next."""
    search = _search_at(address)
    counts, points, distances, reaches = search.counts, search.points, search.distances, search.reaches
    left = search.left
    apart, lowest, n, found, total = search.numbers.apart, search.lowest, counts.cells, 0, 0
    most = lowest.shape[0]
    for j in range(n):
        left[j] = 1
    for _ in range(_LOOKED_AT):
        i = -1
        for j in range(n):
            if left[j] != 0 and (i < 0 or distances[j] < distances[i]):
                i = j
        if i < 0 or found == most:
            break
        is_lowest = True
        for j in range(n):
            way = math.sqrt(_square_between(points[i], points[j]))
            if way <= apart:
                left[j] = 0
            if distances[j] < distances[i] and way <= max(apart, reaches[i] + reaches[j]):
                is_lowest = False
        if total < most:
            total += 1
        elif not is_lowest:
            continue
        if is_lowest:
            lowest[total - 1], lowest[found] = lowest[found], i
            found += 1
        else:
            lowest[total - 1] = i
    counts.lowest = total


@kernel
def _bending(rows, away):
    """-f_ab . away, of which only what is positive is kept."""
    b11, b12, b22 = -dot(rows[F_11], away), -dot(rows[F_12], away), -dot(rows[F_22], away)
    middle, half = 0.5 * (b11 + b22), math.hypot(0.5 * (b11 - b22), b12)
    low, high = middle - half, middle + half
    if low >= 0.0:
        return b11, b12, b22
    if high <= 0.0:
        return 0.0, 0.0, 0.0
    # high v v^T = high (B - low) / (high - low)
    scale = high / (high - low)
    return scale * (b11 - low), scale * b12, scale * (b22 - low)


@entry_kernel(INTEGER, when=CALLED)
def find_feet(address):
    """Newton's method from the starts in `feet` to points nearer to `targets`; a surface's curvature counts where it
    keeps steps short. The feet take the place of the starts."""
    search = _search_at(address)
    rows, domain, away, dimension = search.rows, search.domain, search.vectors[0], search.counts.dimension
    for i in range(search.counts.feet):
        foot, target, least = search.feet[i], search.targets[i], math.inf
        u1, u2 = foot[0], foot[1]
        for _ in range(_FOOT_STEPS):
            _evaluate(search, u1, u2)
            for k in range(3):
                away[k] = target[k] - rows[0, k]
            square = dot(away, away)
            if not square < least:
                break
            foot[0], foot[1], least = u1, u2, square
            g11, g12, g22 = _bending(rows, away)
            g11 += dot(rows[F_1], rows[F_1])
            along1, along2 = dot(rows[F_1], away), 0.0
            if dimension == 2:
                g12 += dot(rows[F_1], rows[F_2])
                g22 += dot(rows[F_2], rows[F_2])
                along2 = dot(rows[F_2], away)
            else:
                g12, g22 = 0.0, 1.0
            determinant = g11 * g22 - g12 * g12
            if determinant > _REGULAR * g11 * g22:
                step1, step2 = (g22 * along1 - g12 * along2) / determinant, (g11 * along2 - g12 * along1) / determinant
            elif g11 > g22:
                step1, step2 = along1 / g11, 0.0
            else:
                # as at a pole, where one of the tangents vanishes
                step1, step2 = 0.0, along2 / max(g22, 1e-300)
            u1 = min(max(u1 + step1, domain[0, 0]), domain[0, 1])
            u2 = min(max(u2 + step2, domain[1, 0]), domain[1, 1])
