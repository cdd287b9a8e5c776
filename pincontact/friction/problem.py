"""Contact problems as users give them: checked, as contiguous arrays."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arguments import NOT_REAL, real_array
from ..errors import ArgumentError


def checked_problem(
    delassus: npt.ArrayLike, b: npt.ArrayLike, mu: npt.ArrayLike
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The problem as contiguous arrays (3n, 3n), (3n,), (n,); ArgumentError if it is none."""
    try:
        matrix, b, given = (np.ascontiguousarray(real_array(value)) for value in (delassus, b, mu))
    except NOT_REAL as error:
        raise ArgumentError(f"the Delassus matrix, b and mu must be arrays of real numbers: {error}") from None
    b, given = b.reshape(-1), given.reshape(np.shape(mu))
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.shape[0] % 3:
        raise ArgumentError(f"the Delassus matrix must be (3n, 3n), got {matrix.shape}")
    contacts = matrix.shape[0] // 3
    if b.shape[0] != 3 * contacts:
        raise ArgumentError(f"b must have {3 * contacts} entries for {contacts} contacts, got {b.shape[0]}")
    if given.ndim > 1 or given.size not in (1, contacts):
        raise ArgumentError(f"mu must be one number or ({contacts},), got shape {given.shape}")
    friction = np.array(np.broadcast_to(given, (contacts,)))
    if not (np.isfinite(matrix).all() and np.isfinite(b).all()):
        raise ArgumentError("the Delassus matrix and b must be finite")
    if np.isnan(friction).any() or (friction < 0.0).any():
        raise ArgumentError(f"mu must not be negative or NaN, got {friction.tolist()}")
    diagonal = np.diagonal(matrix)
    if contacts and diagonal.min() < 0.0:
        raise ArgumentError(f"the Delassus matrix has a negative diagonal entry, {diagonal.min()}")
    # |G_ij - G_ji| against sqrt(G_ii G_jj), the largest a positive semidefinite matrix allows: free of units.
    allowed = 1e-8 * np.outer(np.sqrt(diagonal), np.sqrt(diagonal)) + 1e-14 * diagonal.max(initial=0.0)
    asymmetry = np.abs(matrix - matrix.T)
    if (asymmetry > allowed).any():
        row, column = np.unravel_index(np.argmax(asymmetry - allowed), matrix.shape)
        worst = (int(row), int(column))
        raise ArgumentError(f"the Delassus matrix is not symmetric: entries {worst} differ by {asymmetry[worst]:.3g}")
    if asymmetry.any():
        matrix = 0.5 * (matrix + matrix.T)
    return matrix, b, friction
