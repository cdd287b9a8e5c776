"""Piecewise polynomials in one or two variables: splines and fits, as the kernels read them.

Along each direction a value of the variable selects an interval and gives the values and derivatives of the
degree + 1 basis functions that live there: Chebyshev polynomials of that interval (fits), or B-splines, which are
stored as combinations of them. A contraction with the coefficients of those functions is the rest.

Beyond the ends of a domain that does not close, functions go on as quadratics, so that an iteration that overshoots
still sees a twice differentiable contour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.polynomial import chebyshev

from ..jit import kernel
from .evaluation import contour_kernel
from .periods import wrapped

# Header.
_COMPONENTS, _FIRST, _DIRECTIONS, _COEFFICIENTS, _TIME = range(5)
_BLOCKS = 5
# One block per direction.
_COUNT, _DEGREE, _PERIODIC, _UNIFORM, _BREAKS, _BASIS, _STARTS, _SCRATCH, _FUNCTIONS = range(9)
_BLOCK = 9


@dataclass
class Direction:
    """One variable's intervals and the functions that live on them.

    breaks:     (n + 1,) increasing
    degree:     of the polynomials
    functions:  how many coefficients the direction has in all
    starts:     (n,) index of the first function that lives on each interval
    basis:      (n, degree + 1, degree + 1) Chebyshev coefficients of those functions, or None if they are the
                Chebyshev polynomials themselves
    """

    breaks: np.ndarray
    degree: int
    periodic: bool
    functions: int
    starts: np.ndarray
    basis: np.ndarray | None = None

    @classmethod
    def chebyshev(cls, breaks: np.ndarray, degree: int, periodic: bool = False) -> Direction:
        """Separate polynomials on every interval."""
        count = len(breaks) - 1
        starts = np.arange(count) * (degree + 1)
        return cls(np.asarray(breaks, dtype=float), degree, periodic, count * (degree + 1), starts)

    @classmethod
    def splines(cls, knots: np.ndarray, degree: int, periodic: bool = False) -> Direction:
        """The B-splines of these knots."""
        functions = len(knots) - degree - 1
        spans = [i for i in range(degree, functions) if knots[i] < knots[i + 1]]
        breaks = np.append(knots[spans], knots[functions])
        nodes = chebyshev_nodes(degree)
        to_coefficients = np.linalg.inv(chebyshev.chebvander(nodes, degree))
        basis = np.empty((len(spans), degree + 1, degree + 1))
        for i, span in enumerate(spans):
            low, high = knots[span], knots[span + 1]
            points = 0.5 * (low + high) + 0.5 * (high - low) * nodes
            values = scipy.interpolate.BSpline.design_matrix(points, knots, degree).toarray()
            basis[i] = (to_coefficients @ values[:, span - degree : span + 1]).T
        return cls(breaks, degree, periodic, functions, np.array(spans) - degree, basis)


def chebyshev_nodes(degree: int) -> np.ndarray:
    """The degree + 1 zeros of the next Chebyshev polynomial, increasing, in (-1, 1)."""
    return -np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))


def pack(directions: list[Direction], coefficients: np.ndarray, first: int = 0, time: bool = False) -> np.ndarray:
    """The pool of a function of one or two variables.

    coefficients:  (functions of each direction..., components)
    first:         column of the derivative array that the first component goes to
    time:          the second variable is t instead of u2
    """
    coefficients = np.ascontiguousarray(coefficients, dtype=float)
    if coefficients.shape[:-1] != tuple(direction.functions for direction in directions):
        raise ValueError(f"coefficients {coefficients.shape} do not fit the directions.")
    parts: list[np.ndarray] = [np.zeros(_BLOCKS + _BLOCK * len(directions))]
    header = parts[0]
    size = len(header)

    def append(values: np.ndarray) -> int:
        nonlocal size
        offset = size
        parts.append(np.ravel(values).astype(float))
        size += parts[-1].size
        return offset

    header[:_COEFFICIENTS] = coefficients.shape[-1], first, len(directions)
    header[_TIME] = time
    for i, direction in enumerate(directions):
        block = header[_BLOCKS + _BLOCK * i : _BLOCKS + _BLOCK * (i + 1)]
        breaks = direction.breaks
        even = np.linspace(breaks[0], breaks[-1], len(breaks))
        # Rounding of the breaks may put a value one interval off; the polynomials agree there.
        uniform = np.abs(breaks - even).max() <= 4e-16 * np.abs(breaks).max()
        block[_COUNT], block[_DEGREE] = len(breaks) - 1, direction.degree
        block[_PERIODIC], block[_UNIFORM] = direction.periodic, uniform
        block[_BREAKS] = append(breaks)
        if direction.basis is not None:
            block[_BASIS] = append(direction.basis)
        block[_STARTS] = append(direction.starts)
        block[_SCRATCH] = append(np.zeros(6 * (direction.degree + 1)))
        block[_FUNCTIONS] = direction.functions
    header[_COEFFICIENTS] = append(coefficients)
    return np.concatenate(parts)


def breaks_of(pool: np.ndarray) -> list[np.ndarray]:
    """The breaks (n + 1,) of each direction of what is packed."""
    blocks = [_BLOCKS + _BLOCK * i for i in range(int(pool[_DIRECTIONS]))]
    starts = [(int(pool[block + _BREAKS]), int(pool[block + _COUNT])) for block in blocks]
    return [pool[first : first + count + 1] for first, count in starts]


@kernel
def _interval(pool, breaks, count, uniform, u):
    """Index of the interval that holds u, or the first or last one."""
    low, high = pool[breaks], pool[breaks + count]
    if not u > low:
        return 0
    if u >= high:
        return count - 1
    if uniform:
        return min(int((u - low) / (high - low) * count), count - 1)
    first, last = 0, count
    while last - first > 1:
        middle = (first + last) // 2
        if u >= pool[breaks + middle]:
            first = middle
        else:
            last = middle
    return first


@kernel
def _functions(pool, block, u):
    """Values, first and second derivatives of a direction's functions at u into its scratch area.

    Returns the index of the first function and the offset of the scratch area.
    """
    count, degree = int(pool[block + _COUNT]), int(pool[block + _DEGREE])
    breaks, scratch = int(pool[block + _BREAKS]), int(pool[block + _SCRATCH])
    if pool[block + _PERIODIC] != 0.0:
        u = wrapped(u, pool[breaks], pool[breaks + count])
    interval = _interval(pool, breaks, count, pool[block + _UNIFORM] != 0.0, u)
    low, high = pool[breaks + interval], pool[breaks + interval + 1]
    scale = 2.0 / (high - low)
    x = ((u - low) - (high - u)) / (high - low)
    inside = min(max(x, -1.0), 1.0)
    beyond = x - inside
    n = degree + 1
    at = scratch
    value, first, second = 1.0, 0.0, 0.0
    next_value, next_first, next_second = inside, 1.0, 0.0
    for _ in range(n):
        pool[at] = value + beyond * (first + 0.5 * beyond * second)
        pool[at + n] = scale * (first + beyond * second)
        pool[at + 2 * n] = scale * scale * second
        at += 1
        # T_(k+1) = 2 x T_k - T_(k-1), differentiated twice; the first step is T_1 = x.
        after = 2.0 * inside * next_value - value
        after_first = 2.0 * (next_value + inside * next_first) - first
        after_second = 4.0 * next_first + 2.0 * inside * next_second - second
        value, first, second = next_value, next_first, next_second
        next_value, next_first, next_second = after, after_first, after_second
    basis = int(pool[block + _BASIS])
    if basis != 0:
        basis += interval * n * n
        target = scratch + 3 * n
        for j in range(n):
            value, first, second = 0.0, 0.0, 0.0
            for m in range(n):
                factor = pool[basis + m]
                value += factor * pool[scratch + m]
                first += factor * pool[scratch + n + m]
                second += factor * pool[scratch + 2 * n + m]
            pool[target + j], pool[target + n + j], pool[target + 2 * n + j] = value, first, second
            basis += n
        scratch = target
    return int(pool[int(pool[block + _STARTS]) + interval]), scratch


@kernel
def piecewise(pool, u1, u2, t, out):
    """Fill the function's columns of out (10, 3) with its value and derivatives."""
    components, first = int(pool[_COMPONENTS]), int(pool[_FIRST])
    start, one = _functions(pool, _BLOCKS, u1)
    n = int(pool[_BLOCKS + _DEGREE]) + 1
    m, two, stride = 1, 0, components
    row = 2
    at = int(pool[_COEFFICIENTS]) + start * components
    if pool[_DIRECTIONS] == 2.0:
        timed = pool[_TIME] != 0.0
        block = _BLOCKS + _BLOCK
        start_2, two = _functions(pool, block, t if timed else u2)
        m = int(pool[block + _DEGREE]) + 1
        stride = int(pool[block + _FUNCTIONS]) * components
        at = int(pool[_COEFFICIENTS]) + start * stride + start_2 * components
        row = 6 if timed else 2
    for i in range(components):
        f, f_1, f_11, f_2, f_12, f_22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(n):
            base = at + j * stride + i
            c, c_2, c_22 = 0.0, 0.0, 0.0
            if m == 1:
                c = pool[base]
            else:
                for k in range(m):
                    factor = pool[base + k * components]
                    c += factor * pool[two + k]
                    c_2 += factor * pool[two + m + k]
                    c_22 += factor * pool[two + 2 * m + k]
            b, b_1 = pool[one + j], pool[one + n + j]
            f += b * c
            f_1 += b_1 * c
            f_11 += pool[one + 2 * n + j] * c
            f_2 += b * c_2
            f_12 += b_1 * c_2
            f_22 += b * c_22
        column = first + i
        out[0, column], out[1, column], out[3, column] = f, f_1, f_11
        if m > 1:
            # u2 or t: rows F_2, F_12, F_22 or F_T, F_1T, F_TT.
            out[row, column] = f_2
            out[row + 2 if row == 2 else 7, column] = f_12
            out[row + 3, column] = f_22


@contour_kernel
def fitted(chart, shape, pool, u1, u2, t, out):
    """Evaluates contours whose pool is a piecewise polynomial, a spline or a fit."""
    piecewise(pool, u1, u2, t, out)
