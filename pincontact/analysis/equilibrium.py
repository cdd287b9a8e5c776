"""Equilibria and steady motions with contacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..arguments import check_tolerance, reals
from ..display import Summary
from ..dynamics.joints import check_joint_limits
from ..dynamics.units import whitened_velocity
from ..errors import ArgumentError, NoContactError, SingularContactError, SolverError, StateError
from ..geometry.search import stationary_points
from ..layout import BRANCH, CHART, DOMAIN, END_MARGIN, MODE, SIDE, SLIPPING, UNILATERAL
from ..scene import Scene
from ..state import State, check_finite
from .actuation import actuation_matrix
from .instant import ABOVE_NOISE, FIRST_STEP, Instant, jacobian
from .symmetry import find_symmetries

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# Steps of the search at most: damped ones are many where the residual is flat.
_STEPS = 200
# Directions in which the residual changes by less than this fraction of the largest change are left alone.
_FLAT = 1e-8
# Below this a residual that hardly shrinks is rounding.
_STALLED = 1e-9
# Nor is a step felt that is less than this part of the unknowns.
_UNFELT = 1e-15
# Largest step in m and rad of a slow fall, relative to the scene's length, and its smallest, relative to that.
_FALLS, _NEAR = 0.2, 1e-2
# Configuration, velocity, shares of symmetries in the motion, torques of the actuation.
Point = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
_LEAST_DAMPING, _MOST_DAMPING = 1e-13, 1e6


@dataclass(frozen=True, eq=False, repr=False)
class SteadyMotion(Summary):
    """An equilibrium or a steady motion, as `find_equilibrium` and `find_steady_motion` find it.

    Attributes
    ----------
    state : State
        On the constraints to round-off.
    tau : (nv,) array
        Joint torques that act in N and N m, those found included.
    forces : dict of str to (3,) array
        Force of each contact in N, on the second contour given, world axes.
    residual : float
        Largest component of what should vanish: gaps by the contacts' length, velocities and accelerations in m, rad,
        s.
    holds : bool
        Whether no unilateral contact pulls and none exceeds its friction limit.
    iterations : int
        Of the Levenberg-Marquardt method.
    """

    state: State
    tau: np.ndarray
    forces: dict[str, np.ndarray]
    residual: float
    holds: bool
    iterations: int


def find_equilibrium(
    scene: Scene,
    q0: ArrayLike,
    tau: ArrayLike | None = None,
    *,
    t: float = 0.0,
    actuation: ArrayLike | Sequence[str] | None = None,
    conditions: Callable[[np.ndarray], ArrayLike] | None = None,
    tolerance: float = 1e-10,
) -> SteadyMotion:
    """The equilibrium nearest to q0: all contacts closed, no velocities, no accelerations.

    Contacts with friction stick, with whatever force that takes; `SteadyMotion.holds` says whether friction allows it.
    Whether the equilibrium is stable is a question for `linearize`. Where equilibria fill a whole family (a ball on a
    plane) the one found is near q0. Joints that are not locked hold nothing: their dry friction and the push of their
    limits are left out.

    Parameters
    ----------
    scene : Scene
    q0 : (nq,) array_like
        Where the search starts, in m and rad.
    tau : (nv,) array_like, optional
        Joint torques in N and N m, zero if not given.
    t : float
        Time in s, for prescribed motions.
    actuation : (nv, na) array_like or sequence of str, optional
        Matrix, or names of joints, whose torques are unknowns, too: they are changed no more than is needed (holding
        torques). No torques are, if not given.
    conditions : callable, optional
        Called as conditions(q); returns numbers that must vanish as well.
    tolerance : float
        For `SteadyMotion.residual`, relative to the accelerations without contacts where these exceed 1.

    Returns
    -------
    SteadyMotion

    Raises
    ------
    ArgumentError
        For a bad actuation, conditions or tolerance.
    StateError
        For bad numbers, and for an equilibrium beyond a joint's limits.
    NoContactError
        Where contacts do not touch at q0.
    SingularContactError
        Where contacts degenerate at q0.
    SolverError
        Where no equilibrium is found; the message has the residual, or the contact that is beyond a contour's end.

    Examples
    --------
    A bead on a circular wire hangs at its lowest point:

    >>> import numpy as np
    >>> import pinocchio as pin
    >>> import pincontact as pc
    >>> model = pin.Model()
    >>> joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "bead")
    >>> model.appendBodyToJoint(joint, pin.Inertia.FromSphere(0.1, 0.01), pin.SE3.Identity())
    >>> scene = pc.Scene(model)
    >>> def circle(u):
    ...     return 0.5 * np.cos(u), 0.0, 0.5 * np.sin(u)
    >>> wire = scene.add_contour("wire", pc.ParametricCurve(circle, domain=(-np.pi, np.pi), periodic=True))
    >>> contact = scene.add_contact("bead/wire", wire, scene.add_contour("bead", pc.Point(), frame="bead"))
    >>> rest = pc.find_equilibrium(scene, [0.2, 0.0, -0.45])
    >>> float(rest.state.q[2].round(9)), float(rest.forces["bead/wire"][2].round(9)), rest.holds
    (-0.5, 0.981, True)
    """
    return _search(scene, (q0, None, t), tau, actuation, conditions, tolerance, moves=False)


def find_steady_motion(
    scene: Scene,
    q0: ArrayLike,
    v0: ArrayLike,
    tau: ArrayLike | None = None,
    *,
    t: float = 0.0,
    conditions: Callable[[np.ndarray, np.ndarray], ArrayLike] | None = None,
    actuation: ArrayLike | Sequence[str] | None = None,
    tolerance: float = 1e-10,
) -> SteadyMotion:
    """The steady motion nearest to (q0, v0), one that follows the scene's symmetries.

    A disk that rolls in a circle, a vehicle that turns, a bead in a rotating hoop: seen from axes that go along, they
    are at rest. Steady motions come in families; what is to be kept (a lean, a speed) goes into `conditions`.

    Parameters
    ----------
    scene : Scene
    q0 : (nq,) array_like
        Where the search starts, in m and rad.
    v0 : (nv,) array_like
        Likewise, in m/s and rad/s. Contacts with friction that slide then, however slowly, slide in the motion found,
        too; the others roll. A start that nearly rolls needs `NoSlip`, or a v0 on which it rolls.
    tau, t
        As for `find_equilibrium`.
    conditions : callable, optional
        Called as conditions(q, v); returns numbers that must vanish as well.
    actuation, tolerance
        As for `find_equilibrium`.

    Returns
    -------
    SteadyMotion

    Raises
    ------
    ArgumentError, NoContactError, SingularContactError, SolverError
        As `find_equilibrium` does.
    StateError
        For bad numbers, for a motion beyond a joint's limits, and where a prescribed motion keeps every motion from
        being steady.
    """
    return _search(scene, (q0, v0, t), tau, actuation, conditions, tolerance, moves=True)


def _search(
    scene: Scene,
    start: tuple[ArrayLike, ArrayLike | None, float],
    tau: ArrayLike | None,
    actuation: ArrayLike | Sequence[str] | None,
    conditions: Callable[..., ArrayLike] | None,
    tolerance: float,
    moves: bool,
) -> SteadyMotion:
    """The steady motion nearest to a start (q, v, t), or the equilibrium, where nothing moves.

    Unknown are changes of q and v, the shares of symmetries in the motion, and torques of the actuation.
    """
    if not isinstance(scene, Scene):
        raise ArgumentError(f"the first argument must be a Scene, got {type(scene).__name__}")
    if conditions is not None and not callable(conditions):
        raise ArgumentError(f"conditions must be a function, got {conditions!r}")
    check_tolerance(tolerance)
    try:
        begin = scene.initial_state(*start)
    except NoContactError as error:
        text = str(error).rstrip(".")
        raise NoContactError(
            f"{text} (for initial_state; here all contacts of the scene are closed: leave out those that are open)",
            error.gap,
        ) from None
    instant = Instant(scene, begin, tau, decide=False)
    nv, length = instant.system.nv, instant.length
    symmetries = find_symmetries(instant) if moves else None
    if symmetries is not None and not (
        symmetries.count or instant.driven() or instant.at_rest(np.abs(instant.v).max())
    ):
        raise StateError(
            "no motion of this scene is known to be steady, since no symmetry is seen: find_equilibrium finds where it "
            "is at rest; rotations are seen of a body on a free flyer, a ball joint, a revolute joint of its own along "
            "the axis, and on joints that only slide"
        )
    if not moves:
        instant.v = np.zeros(nv)
    holding = np.zeros((nv, 0)) if actuation is None else actuation_matrix(scene.model, actuation)
    normals, constrained = instant.holonomic(), instant.constrained()
    sizes = nv, nv if moves else 0, symmetries.count if symmetries is not None else 0, holding.shape[1]

    def moved(point: Point, change: np.ndarray) -> Point:
        """q, v, shares of the symmetries and torques of the actuation."""
        dq, dv, share, effort = np.split(change, np.cumsum(sizes[:-1]))
        v = point[1] + dv * instant.system.moves if moves else point[1]
        return instant.moved(dq, point[0]), v, point[2] + share, point[3] + effort

    def closed(point: Point) -> Point:
        q, v = instant.projected(*point[:2])
        # a search may not go through bodies
        _refuse_other_sides(instant)
        return q, v if moves else point[1], *point[2:]

    def residual(point: Point) -> np.ndarray:
        q, v, share, effort = point
        a = instant.evaluate(q, v, instant.tau + holding @ effort)
        parts = [instant.gaps(normals) / length]
        if symmetries is not None:
            parts += [instant.velocities(constrained), v - symmetries.velocity(q, share)]
            a = a - symmetries.acceleration(v, share)
        parts.append(a)
        if conditions is not None:
            given = (q.copy(), v.copy()) if moves else (q.copy(),)
            found = reals("conditions must return numbers", conditions(*given)).ravel()
            parts.append(check_finite("conditions", found))
        return np.concatenate(parts)

    speed = max(1.0, float(np.abs(instant.v).max(initial=0.0)))
    steps = np.repeat([FIRST_STEP * length, FIRST_STEP * speed, FIRST_STEP * speed, 1.0], sizes)
    share = np.zeros(sizes[2])
    if symmetries is not None:
        share, _ = symmetries.fit(instant.q, instant.v, instant.evaluate())
    point: Point = instant.q, instant.v, share, np.zeros(sizes[3])
    bound = len(normals) + (len(constrained) if moves else 0)

    def solved(point: Point) -> tuple[Point, int, float, float]:
        """From a point on: the best one, steps, its residual, and what that may be."""
        point, iterations = _solve(residual, bound, (moved, closed, instant.follow), point, steps)
        size = float(np.abs(residual(point)).max(initial=0.0))
        free = float(np.abs(instant.system.free_acceleration).max(initial=0.0))
        return point, iterations, size, tolerance * max(1.0, free)

    start_point = point
    point, iterations, size, most = solved(point)
    if not (size <= most or moves):
        # where accelerations are least near the start without being zero: from where the scene slowly goes
        instant.move_to(begin)
        others = np.zeros(sum(sizes[1:]))
        point, iterations, size, most = solved(
            _fall(instant, start_point, lambda point, dq: closed(moved(point, np.r_[dq, others])))
        )
    what = "steady motion" if moves else "equilibrium"
    if not size <= most:
        modes = instant.system.contact_int[: instant.system.nc, MODE].tolist()
        sliding = [repr(c.name) for c, mode in zip(instant.system.contacts, modes) if mode == SLIPPING]
        slides = f"; contacts that slide, as with v0: {', '.join(sliding)}" if sliding else ""
        raise SolverError(
            f"no {what} was found near this configuration: the residual is {size:.3g} after {iterations} steps "
            f"(tolerance {most:.3g}); all contacts stay closed, and tau= or actuation= are torques that help to hold it"
            f"{slides}"
        )
    q, v = point[:2]
    check_joint_limits(instant.system.limits, q)
    instant.tau = instant.tau + holding @ point[3]
    state = instant.state(q, v)
    holds = instant.holds()
    forces = instant.forces()
    beyond = np.flatnonzero(instant.system.contact_real[: instant.system.nc, DOMAIN] < -END_MARGIN)
    if beyond.size:
        raise SolverError(
            f"no {what} was found near this configuration: in that to which the search led, contact "
            f"{instant.system.contacts[beyond[0]].name!r} is beyond the end of a contour; start elsewhere"
        )
    return SteadyMotion(state, instant.tau, forces, size, holds, iterations)


def _refuse_other_sides(instant: Instant) -> None:
    """Raise SolverError where a contact touches on the other side, in the last evaluation: its bodies are inside each
    other."""
    system = instant.system
    for c in np.flatnonzero(system.contact_int[: system.nc, UNILATERAL]).tolist():
        single, charts = system.alone(c), system.side_int[2 * c : 2 * c + 2, CHART].tolist()
        single.q[:], single.v[:] = system.q, system.v
        branches, place = [system.contact_int[c, BRANCH]], system.location[c : c + 1]
        # angles may have gone round poles in the search
        here, _ = stationary_points(single, instant.t, place, branches, inside=False, charts=(charts[0], charts[1]))
        if here and here[0].side * system.contact_int[c, SIDE] < 0:
            raise SolverError(f"the bodies of contact {system.contacts[c].name!r} are inside each other")


def _solve(
    residual: Callable[[Point], np.ndarray],
    bound: int,
    motions: tuple[Callable[[Point, np.ndarray], Point], Callable[[Point], Point], Callable[[], None]],
    point: Point,
    steps: np.ndarray,
) -> tuple[Point, int]:
    """Levenberg-Marquardt along the constraints, whose residuals come first, so many of them, and on the part of the
    Jacobian's spectrum that is not flat: families of solutions are crossed the shortest way and not run along. What is
    off the constraints is none of the unknowns': there accelerations may vanish, too, and no way lead back.

    motions: (moved, closed, accepted): a point moved by a change, of which differences take the steps; a point moved
    onto the constraints; called when the residual has last been evaluated at a better point. Returns the best point
    and the number of steps.
    """
    moved, closed, accepted = motions
    damping = 1e-3
    r = residual(point)[bound:]
    if steps.size == 0:
        return point, 0
    size, length = float(r @ r), 0.0
    for iteration in range(_STEPS):
        if size == 0.0:
            return point, iteration
        matrix, errors = jacobian(lambda change: residual(moved(point, change)), np.eye(steps.size), steps)  # noqa: B023
        along = _null_space(matrix[:bound])
        u, values, vectors = np.linalg.svd(matrix[bound:] @ along, full_matrices=False)
        if not values.size or not values[0] > ABOVE_NOISE * float(np.linalg.norm(errors)):
            return point, iteration
        kept = values > _FLAT * values[0]
        u, values, vectors = u[:, kept], values[kept], vectors[kept] @ along.T
        while True:
            factors = values / (values**2 + damping * values[0] ** 2)
            step = -vectors.T @ (factors * (u.T @ r))
            try:
                new_point = closed(moved(point, step))
                new = residual(new_point)[bound:]
                new_size = float(new @ new)
            except (SolverError, SingularContactError):
                new_size = np.inf
            if new_size < size:
                break
            damping = 4.0 * max(damping, _LEAST_DAMPING)
            if damping > _MOST_DAMPING:
                return point, iteration
        stalled = new_size > 0.25 * size and float(np.abs(new).max()) < _STALLED
        point, r, size = new_point, new, new_size
        length += float(np.abs(step).max())
        accepted()
        damping = damping / 10.0 if damping > _LEAST_DAMPING else 0.0
        # rounding is reached where steps are no longer felt, or help no longer
        if stalled or float(np.abs(step).max()) <= _UNFELT * max(1.0, length):
            return point, iteration + 1
    return point, _STEPS


def _fall(instant: Instant, point: Point, moved: Callable[[Point, np.ndarray], Point]) -> Point:
    """Follow accelerations from rest, without gathering speed, to where they turn round: near an equilibrium; moved: a
    point whose configuration a change (nv,) has moved, on the constraints."""
    system, size = instant.system, _FALLS * max(instant.length, 1e-3)
    step = size

    def way(point: Point) -> np.ndarray:
        a = instant.evaluate(point[0], point[1])
        largest = float(np.abs(a).max(initial=0.0))
        return a / largest if largest > 0.0 else a

    direction = way(point)
    for _ in range(_STEPS):
        try:
            there = moved(point, step * direction)
            ahead = way(there)
            goes_on = whitened_velocity(system, ahead) @ whitened_velocity(system, direction) > 0.0
        except (SolverError, SingularContactError):
            goes_on = False
        if goes_on:
            point, direction, step = there, ahead, min(2.0 * step, size)
            instant.follow()
        elif (step := 0.25 * step) < _NEAR * size:
            break
    return point


def _null_space(rows: np.ndarray) -> np.ndarray:
    """(n, k) orthonormal changes that rows (m, n) do not see."""
    _, values, vectors = np.linalg.svd(rows)
    return vectors[int((values > _FLAT * values.max(initial=0.0)).sum()) :].T
