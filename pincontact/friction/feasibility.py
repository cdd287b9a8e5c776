"""Contact problems that have no solution, and the proof of it.

Normal forces y >= 0 that move nothing, G y = 0, while the contacts they press approach each other in total, b . y < 0:
two jaws that close on a rigid body. For all forces F then u . y = F . G y + b . y = b . y < 0, which contradicts
u_n >= 0. By Farkas' lemma there are such y exactly where no normal forces give u_n >= 0 everywhere.
"""

from __future__ import annotations

import numpy as np

# Any forces that solve the problem have to be larger than b asks for by the inverse of this.
_YIELD = 1e-7


def crushing_combination(delassus: np.ndarray, b: np.ndarray) -> np.ndarray | None:
    """Normal forces (n,) that prove that the problem (3n, 3n), (3n,) has no solution; None if there are none.

    They are the non-negative least squares solution of G y = 0, b . y = -1 (Lawson and Hanson), if that is exact.
    """
    # SciPy's optimisers take a while to import, and most runs never need this.
    from scipy.optimize import nnls

    trace = np.diagonal(delassus).reshape(-1, 3).sum(axis=1)
    scale = np.sqrt(3.0 / np.where(trace > 0.0, trace, 3.0))
    normal = scale[:, None] * delassus[2::3, 2::3] * scale
    approach = scale * b[2::3]
    largest = np.abs(scale * np.abs(b).reshape(-1, 3).max(axis=1)).max(initial=0.0)
    if not (np.isfinite(normal).all() and 0.0 < largest < np.inf and approach.min() < 0.0):
        return None
    system = np.vstack([normal, -approach / largest])
    try:
        combination, _ = nnls(system, np.r_[np.zeros(len(scale)), 1.0])
    except RuntimeError:
        # Its limit of iterations: nothing is known.
        return None
    closing = -(approach @ combination) / largest
    # With w = |F|_G the kinetic norm, any solution has w |y|_G >= closing.
    if closing <= 0.5 or np.sqrt(max(combination @ normal @ combination, 0.0)) > _YIELD * closing:
        return None
    # Round-off of a force that is there only in the least squares is none that presses.
    combination[combination < _YIELD * combination.max()] = 0.0
    return scale * combination
