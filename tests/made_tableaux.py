"""How the data of `integration/tableaux.json` are made that are not the pairs' own: interpolants from the stages that
there are anyway, and the error estimate of Sharp98. Prints the interpolants."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

# Step, over the time in which a motion changes, at which a free interpolant's errors of two orders are weighed.
FURTHER_STEP = 0.1
# Conditions of order that combine to less than this part of the largest are the same one.
RANK = 1e-10
# Size of the error estimate of Sharp98. With it, and at tolerances up to 1e-5, runs through poles and mode changes end
# with errors of a hundredth of the tolerance, at worst of twice the tolerance. At coarser ones steps would become as
# long as stability allows, and the estimate, whose order is three below the pair's, too small. The exponent of its
# step-size control, 10, is above the estimate's own, 6: errors of steps as long as these fall faster than that, and
# steps would swing.
SHARP98_ESTIMATE = 4.5e-6

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
    size = FURTHER_STEP ** (sizes[n:] - order - 1.0) / (symmetries * densities[n:])
    error, wanted = size[:, None] * matrix[n:], size[:, None] * right[n:]
    matrix, right = matrix[:n], right[:n]
    _, singular, basis = np.linalg.svd(matrix)
    rank = int(np.sum(singular > RANK * singular[0]))
    weights = np.linalg.lstsq(matrix, right, rcond=RANK)[0]
    free = basis[rank:].T
    weights += free @ np.linalg.lstsq(error @ free, wanted - error @ weights, rcond=RANK)[0]
    return np.column_stack([weights.T, np.zeros(order + further)])


def sharp98_estimate(c: np.ndarray) -> np.ndarray:
    """Weights (n,) of the error estimate of Sharp98, of whose stages these are the nodes.

    His own takes a stage more. Here it is the sixth divided difference of the slopes at seven nodes, where the stages
    are accurate enough: it vanishes for all trees up to order 6, so that it is a multiple of the difference to an
    embedded solution of that order. There is one of order 7, too, but it has no slope beyond 0.916 of the step, so that
    jumps of the slopes near the end, as where slip turns round, would pass unnoticed. Of all choices of nodes with both
    ends of the step this one is closest to a constant multiple of true errors, of rolling and sliding bodies.
    """
    chosen = [0, 8, 9, 10, 11, 13, 14]
    gaps = np.subtract.outer(c[chosen], c[chosen])
    np.fill_diagonal(gaps, 1.0)
    weights = np.zeros(len(c))
    weights[chosen] = SHARP98_ESTIMATE / gaps.prod(axis=1)
    return weights


if __name__ == "__main__":
    from pincontact.integration.tableaux import tableau

    for name, further in (("DOP853", 1), ("Sharp98", 2)):
        pair = tableau(name)
        print(name, free_dense(pair.a[: pair.stages + 1, : pair.stages + 1], 6, further).tolist())
