"""Equilibria and steady motions with contacts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arguments import check_tolerance
from ..dynamics.joints import check_guards
from ..errors import ArgumentError, SingularContactError, SolverError
from ..scene import Scene
from ..state import State, check_vector
from .instant import ABOVE_NOISE, FIRST_STEP, Instant, derivative
from .inverse import actuation_matrix
from .symmetry import find_symmetries

Conditions = Callable[[np.ndarray, np.ndarray], Any]

_STEPS = 200
# Directions in which the residual changes by less than this fraction of the largest change are left alone.
_FLAT = 1e-8
# Below this a residual that hardly shrinks is rounding.
_STALLED = 1e-9
_LEAST_DAMPING, _MOST_DAMPING = 1e-13, 1e6


@dataclass(frozen=True, eq=False)
class SteadyMotion:
    """An equilibrium or a steady motion.

    state: on the constraints to round-off. tau (nv,): joint torques that act, those found included.
    forces: contact -> force (3,) in N on the second contour given, world axes.
    residual: largest component of what should vanish (gaps by the contacts' length, m, rad, s).
    holds: whether no unilateral contact pulls and none exceeds its friction limit.
    iterations: of the Levenberg-Marquardt method.
    """

    state: State
    tau: np.ndarray
    forces: dict[str, np.ndarray]
    residual: float
    holds: bool
    iterations: int


def find_equilibrium(
    scene: Scene,
    q0: Any,
    tau: Any | None = None,
    *,
    t: float = 0.0,
    actuation: Any | None = None,
    conditions: Callable[[np.ndarray], Any] | None = None,
    tolerance: float = 1e-10,
) -> SteadyMotion:
    """The equilibrium nearest to q0: all contacts closed, no velocities, no accelerations.

    Contacts with friction stick, with whatever force that takes: see `holds`. Stable or not is not asked for; see
    `linearize`. Where equilibria fill a whole family (a ball on a plane) the one found is near q0.

    tau (nv,): joint torques, zero by default. actuation: (nv, na) matrix or joint names whose torques are unknowns too,
    changed no more than is needed (holding torques); None for none. conditions: called as conditions(q), numbers that
    must vanish as well. t: time in s, for drives. tolerance: for `residual`, relative to the free accelerations.
    Joints hold nothing: what dry friction could hold, or an end of a joint's way, is not asked for.
    Raises StateError for bad numbers and for an equilibrium beyond a joint's limits, NoContactError where contacts do
    not touch at q0, SolverError (with the residual) where no equilibrium is found.
    """
    _check(scene, conditions, tolerance)
    guess = scene.initial_state(q0, None, t)
    instant = Instant(scene, guess, tau, decide=False)
    holding = np.zeros((instant.system.nv, 0)) if actuation is None else actuation_matrix(scene.model, actuation)
    normals = instant.holonomic()
    nv = instant.system.nv
    rest = np.zeros(nv)
    instant.v = rest

    def residual(x: np.ndarray) -> np.ndarray:
        q = instant.moved(x[:nv])
        a = instant.evaluate(q, rest, instant.tau + holding @ x[nv:])
        extra = [] if conditions is None else [_numbers("conditions", conditions(q.copy()))]
        return np.concatenate([instant.gaps(normals) / instant.length, a, *extra])

    steps = np.concatenate([np.full(nv, FIRST_STEP * instant.length), np.ones(holding.shape[1])])
    x, iterations = _solve(residual, np.zeros(nv + holding.shape[1]), steps, instant.follow)
    return _found(
        instant, "equilibrium", residual, x, instant.moved(x[:nv]), rest, holding @ x[nv:], iterations, tolerance
    )


def find_steady_motion(
    scene: Scene,
    q0: Any,
    v0: Any,
    tau: Any | None = None,
    *,
    t: float = 0.0,
    conditions: Conditions | None = None,
    actuation: Any | None = None,
    tolerance: float = 1e-10,
) -> SteadyMotion:
    """The steady motion nearest to (q0, v0), one that follows the scene's symmetries (see `analysis.symmetry`).

    A disk that rolls in a circle, a vehicle that turns, a bead in a rotating hoop.

    Steady motions come in families; what is to be kept (a lean, a speed) goes into conditions(q, v), numbers that must
    vanish as well. Other arguments as for `find_equilibrium`.
    Raises as `find_equilibrium`, and StateError where a drive keeps every motion from being steady.
    """
    _check(scene, conditions, tolerance)
    guess = scene.initial_state(q0, v0, t)
    instant = Instant(scene, guess, tau, decide=False)
    symmetries = find_symmetries(instant)
    holding = np.zeros((instant.system.nv, 0)) if actuation is None else actuation_matrix(scene.model, actuation)
    normals, constrained = instant.holonomic(), instant.constrained()
    nv, s = instant.system.nv, symmetries.count

    def residual(x: np.ndarray) -> np.ndarray:
        q, v = instant.moved(x[:nv]), instant.v + x[nv : 2 * nv]
        a = instant.evaluate(q, v, instant.tau + holding @ x[2 * nv + s :])
        share = x[2 * nv : 2 * nv + s]
        extra = [] if conditions is None else [_numbers("conditions", conditions(q.copy(), v.copy()))]
        return np.concatenate(
            [
                instant.gaps(normals) / instant.length,
                instant.velocities(constrained),
                v - symmetries.velocity(q, share),
                a - symmetries.acceleration(v, share),
                *extra,
            ]
        )

    combination, _ = symmetries.fit(instant.q, instant.v, instant.evaluate())
    start = np.concatenate([np.zeros(2 * nv), combination, np.zeros(holding.shape[1])])
    speed = max(1.0, float(np.abs(instant.v).max(initial=0.0)))
    steps = np.concatenate(
        [np.full(nv, FIRST_STEP * instant.length), np.full(nv + s, FIRST_STEP * speed), np.ones(holding.shape[1])]
    )
    x, iterations = _solve(residual, start, steps, instant.follow)
    q, v = instant.moved(x[:nv]), instant.v + x[nv : 2 * nv]
    return _found(instant, "steady motion", residual, x, q, v, holding @ x[2 * nv + s :], iterations, tolerance)


def _check(scene: Any, conditions: Any, tolerance: Any) -> None:
    if not isinstance(scene, Scene):
        raise ArgumentError(f"the first argument must be a Scene, got {type(scene).__name__}")
    if conditions is not None and not callable(conditions):
        raise ArgumentError(f"conditions must be a function, got {conditions!r}")
    check_tolerance(tolerance)


def _found(
    instant: Instant,
    what: str,
    residual: Callable[[np.ndarray], np.ndarray],
    x: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    torque: np.ndarray,
    iterations: int,
    tolerance: float,
) -> SteadyMotion:
    size = float(np.abs(residual(x)).max(initial=0.0))
    scale = max(1.0, float(np.abs(instant.system.free_acceleration).max(initial=0.0)))
    if not size <= tolerance * scale:
        raise SolverError(
            f"no {what} was found near this configuration: the residual is {size:.3g} after {iterations} steps "
            f"(tolerance {tolerance * scale:.3g})"
        )
    check_guards(instant.system.guards, q)
    tau = instant.tau + torque
    instant.tau = tau
    state = instant.state(q, v)
    return SteadyMotion(state, tau, instant.forces(), size, instant.holds(), iterations)


def _solve(
    residual: Callable[[np.ndarray], np.ndarray], x: np.ndarray, steps: np.ndarray, accepted: Callable[[], None]
) -> tuple[np.ndarray, int]:
    """Levenberg-Marquardt on the part of the Jacobian's spectrum that is not flat: families of solutions are crossed
    the shortest way and not run along. accepted: called when the residual has last been evaluated at a better x.
    Returns the best x and the number of steps."""
    damping = 1e-3
    r = residual(x)
    if x.size == 0:
        return x, 0
    size = float(r @ r)
    for iteration in range(_STEPS):
        if size == 0.0:
            return x, iteration
        columns = [_column(residual, x, unit, step) for unit, step in zip(np.eye(x.size), steps)]
        noise = float(np.linalg.norm([error for _, error in columns]))
        u, values, vectors = np.linalg.svd(np.column_stack([column for column, _ in columns]), full_matrices=False)
        if not values[0] > ABOVE_NOISE * noise:
            return x, iteration
        kept = values > _FLAT * values[0]
        u, values, vectors = u[:, kept], values[kept], vectors[kept]
        while True:
            factors = values / (values**2 + damping * values[0] ** 2)
            step = -vectors.T @ (factors * (u.T @ r))
            try:
                new = residual(x + step)
                new_size = float(new @ new)
            except (SolverError, SingularContactError):
                new_size = np.inf
            if new_size < size:
                break
            damping = 4.0 * max(damping, _LEAST_DAMPING)
            if damping > _MOST_DAMPING:
                return x, iteration
        stalled = new_size > 0.25 * size and float(np.abs(new).max()) < _STALLED
        x, r, size = x + step, new, new_size
        accepted()
        damping = damping / 10.0 if damping > _LEAST_DAMPING else 0.0
        # rounding is reached where steps are no longer felt, or help no longer
        if stalled or float(np.abs(step).max()) <= 1e-15 * max(1.0, float(np.abs(x).max())):
            return x, iteration + 1
    return x, _STEPS


def _column(
    residual: Callable[[np.ndarray], np.ndarray], x: np.ndarray, unit: np.ndarray, step: float
) -> tuple[np.ndarray, float]:
    return derivative(lambda h: residual(x + h * unit), step)


def _numbers(name: str, value: Any) -> np.ndarray:
    try:
        array = np.atleast_1d(np.asarray(value, dtype=float)).ravel()
    except (TypeError, ValueError):
        raise ArgumentError(f"{name} must return numbers, got {value!r}") from None
    return check_vector(name, array, array.size)
