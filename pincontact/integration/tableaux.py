"""Embedded Runge-Kutta pairs as data; the coefficients are SciPy's, and Sharp's."""

from __future__ import annotations

import math
import os
import pickle
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
import scipy

from ..errors import ArgumentError
from ..jit import cache_directory
from ..layout import DENSE_ROWS, ERROR_ROWS, MAX_STAGES
from ..workspace import address_of
from . import sharp98
from .resolution import roughness


@dataclass(frozen=True, eq=False)
class Tableau:
    """An explicit pair with dense output.

    stages:     evaluations that make up the new state; stage number `stages` is the evaluation there
    order:      of the propagated solution; error_order: exponent that step-size control assumes
    a, c:       rows and nodes of all stages, the new state (row `stages`) and the interpolant's extra ones
    errors:     (2, n) weights of one or two error estimates
    estimate_after: stage after which the error is known
    dense:      (rows, n + 1) weights of the interpolant's coefficients, that of y_1 - y_0 last; nested: see `dense`
    coarsest:   largest relative tolerance that its error estimate is good for
    """

    name: str
    stages: int
    order: int
    error_order: int
    a: np.ndarray
    c: np.ndarray
    errors: np.ndarray
    estimate_after: int
    extra: int
    dense: np.ndarray
    nested: bool
    coarsest: float = math.inf

    @cached_property
    def tables(self) -> list[tuple[str, np.ndarray, int]]:
        """a, c, errors and dense with zeros around them: names and addresses of the kernels' arrays, which only read
        them."""
        n = self.c.size
        rows, columns = self.dense.shape
        a, c, errors = np.zeros((MAX_STAGES, MAX_STAGES)), np.zeros(MAX_STAGES), np.zeros((ERROR_ROWS, MAX_STAGES))
        dense = np.zeros((DENSE_ROWS, MAX_STAGES + 1))
        a[:n, :n], c[:n], errors[:2, :n] = self.a, self.c, self.errors
        stages = self.stages + 1
        rough = roughness(self.a[:stages, :stages], self.c[:stages])
        errors[2 : 2 + len(rough), :stages] = rough
        dense[:rows, : columns - 1], dense[:rows, -1] = self.dense[:, :-1], self.dense[:, -1]
        named = {"coefficients": a, "nodes": c, "weights_error": errors, "dense_weights": dense}
        return [(name, array, address_of(array)) for name, array in named.items()]

    @cached_property
    def without_extra_stages(self) -> Tableau:
        """The same pair with the interpolant that its own stages allow: see `free_dense`."""
        n = self.stages + 1
        return replace(self, extra=0, dense=free_dense(self.a[:n, :n], 6), nested=False)

    @cached_property
    def widest(self) -> float:
        """Largest distance between the nodes of two neighbouring stages, as a fraction of the step."""
        return float(np.diff(np.unique(self.c[: self.stages + 1])).max())


# Step, over the time in which a motion changes, at which a free interpolant's errors of two orders are weighed.
_FURTHER_STEP = 0.1
# Conditions of order that combine to less than this part of the largest are the same one.
_RANK = 1e-10

# Size of the error estimate of Sharp98, and the coarsest tolerance for which it holds: with these, runs through poles
# and mode changes end with errors of a hundredth of the tolerance, at worst of twice the tolerance. At coarser ones
# steps would become as long as stability allows, and the estimate, whose order is three below the pair's, too small.
_SHARP98_ESTIMATE = 4.5e-6
_SHARP98_COARSEST = 1e-5
# Exponent of its step-size control, above the estimate's own, 6: errors of steps as long as these fall faster than
# that, and steps would swing.
_SHARP98_ERROR_ORDER = 10

# A rooted tree is the tuple of its root's subtrees, in order.
Tree = tuple[Any, ...]


def rooted_trees(order: int) -> list[Tree]:
    """All rooted trees of so many vertices: the elementary differentials (Hairer, Norsett, Wanner, Sec. II.2)."""

    def forests(vertices: int, largest: tuple[int, Tree] | None) -> Iterator[Tree]:
        if vertices == 0:
            yield ()
        for size in range(1, vertices + 1):
            for tree in rooted_trees(size):
                if largest is None or (size, tree) <= largest:
                    for rest in forests(vertices - size, (size, tree)):
                        yield (tree, *rest)

    return list(forests(order - 1, None))


def _vertices(tree: Tree) -> int:
    return 1 + sum(_vertices(part) for part in tree)


def _density(tree: Tree) -> int:
    return _vertices(tree) * math.prod(_density(part) for part in tree)


def _symmetry(tree: Tree) -> int:
    return math.prod(math.factorial(times) * _symmetry(part) ** times for part, times in Counter(tree).items())


def _weights(tree: Tree, a: np.ndarray) -> np.ndarray:
    """(n,) elementary weights of the stages."""
    out = np.ones(len(a))
    for part in tree:
        out *= a @ _weights(part, a)
    return out


def free_dense(a: np.ndarray, order: int, further: int = 1) -> np.ndarray:
    """Weights (order + further, n + 1) of an interpolant of this order from the stages a (n, n) alone, the new state's
    last.

    Row k - 1 is the coefficient of theta^k; the last column, of y_1 - y_0, is zero. y_0 + h sum_j b_j(theta) k_j has
    the order if for all its trees the elementary weights sum to theta^vertices / density; of all such b the one with
    the least errors of the so many further orders is taken, for which its degree is that of the last of them. For
    DOP853 and order 6 the equations have solutions, and errors for steps of a radian are no greater than those of its
    own interpolant of order 7, which takes three evaluations more; those of Sharp98 with two further orders are a tenth
    of these.
    """
    degrees = np.arange(1, order + further + 1)
    known = [tree for vertices in degrees[:order] for tree in rooted_trees(vertices)]
    following = [tree for vertices in degrees[order:] for tree in rooted_trees(vertices)]
    sizes = np.array([_vertices(tree) for tree in known + following])
    densities = np.array([_density(tree) for tree in known + following])
    symmetries = np.array([_symmetry(tree) for tree in following])
    # the coefficients of theta^vertices / density, and the equations multiplied by the density: all of one size
    right = (sizes[:, None] == degrees).astype(float)
    matrix = densities[:, None] * np.array([_weights(tree, a) for tree in known + following])
    n = len(known)
    # errors of the elementary differentials, at a step for which those of higher orders count for less
    size = _FURTHER_STEP ** (sizes[n:] - order - 1.0) / (symmetries * densities[n:])
    error, wanted = size[:, None] * matrix[n:], size[:, None] * right[n:]
    matrix, right = matrix[:n], right[:n]
    _, singular, basis = np.linalg.svd(matrix)
    rank = int(np.sum(singular > _RANK * singular[0]))
    weights = np.linalg.lstsq(matrix, right, rcond=_RANK)[0]
    free = basis[rank:].T
    weights += free @ np.linalg.lstsq(error @ free, wanted - error @ weights, rcond=_RANK)[0]
    return np.column_stack([weights.T, np.zeros(order + further)])


def _dop853() -> Tableau:
    pair = scipy.integrate.DOP853
    n, extra = pair.n_stages, len(pair.A_EXTRA)
    a, errors = np.zeros((n + 1 + extra, n + 1 + extra)), np.zeros((2, n + 4))
    a[:n, :n], a[n, :n], a[n + 1 :] = pair.A, pair.B, pair.A_EXTRA
    c = np.concatenate([pair.C, [1.0], pair.C_EXTRA])
    errors[0, : n + 1], errors[1, : n + 1] = pair.E5, pair.E3
    # Hairer's form: the difference, the slopes at both ends, and four combinations of all stages
    dense = np.zeros((7, n + 5))
    dense[0, -1], dense[1, -1], dense[2, -1] = 1.0, -1.0, 2.0
    dense[1, 0], dense[2, 0], dense[2, n] = 1.0, -1.0, -1.0
    dense[3:, : n + 4] = pair.D
    return Tableau("DOP853", n, 8, 7, a, c, errors, n - 1, extra, dense, True)


def _single_estimate(name: str) -> Tableau:
    """SciPy's RK45 or RK23: the slope of the new state is the last stage, and the interpolant needs no others."""
    pair = getattr(scipy.integrate, name)
    n = pair.n_stages
    a = np.zeros((n + 1, n + 1))
    c = np.zeros(n + 1)
    a[:n, : pair.A.shape[1]], c[:n] = pair.A, pair.C
    a[n, :n], c[n] = pair.B, 1.0
    errors = np.zeros((2, n + 1))
    errors[0] = pair.E
    dense = np.zeros((pair.P.shape[1], n + 2))
    dense[:, : n + 1] = pair.P.T
    return Tableau(name, n, pair.order, pair.error_estimator_order, a, c, errors, n, 0, dense, False)


def _sharp98() -> Tableau:
    """Sharp, P. W., High order explicit Runge-Kutta pairs for ephemerides of the Solar System and the Moon, J. Appl.
    Math. Decis. Sci. 4 (2000), 183-192; coefficients from rklib (J. Williams), named rks98 there.

    His error estimate takes a stage more. Here it is the sixth divided difference of the slopes at seven nodes, where
    the stages are accurate enough: it vanishes for all trees up to order 6, so that it is a multiple of the difference
    to an embedded solution of that order. There is one of order 7, too, but it has no slope beyond 0.916 of the step,
    so that jumps of the slopes near the end, as where slip turns round, would pass unnoticed. Of all choices of nodes
    with both ends of the step this one is closest to a constant multiple of true errors, of rolling and sliding bodies.
    """
    n = len(sharp98.NODES)
    a, c = np.zeros((n + 1, n + 1)), np.array([*sharp98.NODES, 1.0])
    for i, row in enumerate(sharp98.FIRST_ROWS, 1):
        a[i, :i] = row
    for i, row in enumerate(sharp98.ROWS, len(sharp98.FIRST_ROWS) + 1):
        a[i, [0, *range(5, i)]] = row
    a[n, [0, *range(7, n)]] = sharp98.NEW_STATE
    chosen = [0, 8, 9, 10, 11, 13, 14]
    gaps = np.subtract.outer(c[chosen], c[chosen])
    np.fill_diagonal(gaps, 1.0)
    errors = np.zeros((2, n + 1))
    errors[0, chosen] = _SHARP98_ESTIMATE / gaps.prod(axis=1)
    dense = free_dense(a, 6, 2)
    return Tableau("Sharp98", n, 9, _SHARP98_ERROR_ORDER, a, c, errors, n - 1, 0, dense, False, _SHARP98_COARSEST)


_TABLEAUX: dict[str, Callable[[], Tableau]] = {
    "DOP853": _dop853,
    "Sharp98": _sharp98,
    "RK45": partial(_single_estimate, "RK45"),
    "RK23": partial(_single_estimate, "RK23"),
}


@cache
def tableau(method: str) -> Tableau:
    """The tableau of a method's name; ArgumentError for an unknown one."""
    if method not in _TABLEAUX:
        raise ArgumentError(f"unknown method {method!r}; one of {', '.join(_TABLEAUX)}, Moreau")
    # kept on disk: importing SciPy's integrators takes a sixth of the time in which a first run starts
    file = cache_directory(_dop853) / f"{method}, SciPy {scipy.__version__}"
    try:
        kept: Tableau = pickle.loads(file.read_bytes())
        return kept
    except Exception:
        # not there yet, or what a crash or a full disk has left
        made = _TABLEAUX[method]()
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_name(f"{file.name}.{os.getpid()}")
        part.write_bytes(pickle.dumps(made))
        part.replace(file)
    return made
