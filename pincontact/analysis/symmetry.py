"""Symmetries of a scene's motion: position on a plane, heading, spin of round bodies.

A generator moves the configuration by a left part, fixed in the space that carries a joint (a body pushed along the
plane, turned about the vertical), and a right part, fixed in the body (a wheel turned about its own axis). On the
Lie groups of Pinocchio's joints, with Ad and ad of the tangent coordinates,

    dq = Ad left + right,      dv = [v, right],      da = [a, right]   if the equations of motion do not notice.

Displacements p of what slides along axes without turning are turned by a linear map of the coordinates, as well,

    dq = turn p,      dv = turn v,      da = turn a,

so that the rotations of a bead on three sliding joints are seen as they are on a free flyer. Of revolute joints one
after the other only those motions are seen that the joints have alone.

A steady motion is one that follows a generator: v = dq and a = dv (a relative equilibrium); an equilibrium follows 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pinocchio as pin

from ..errors import SingularContactError, SolverError, StateError
from .instant import ABOVE_NOISE, Instant, derivative, jacobian

# Random states at which a symmetry must hold, and how far they are from the given one.
_SAMPLES = 3
# Differences here tell zero from not: fewer levels do.
_LEVELS = 5
_SPREAD = 0.05
_RETRIES = 12
# Singular values below this fraction of the largest are symmetries; differences are good to about 1e-11.
_TOLERANCE = 1e-7
# First step in s of differences in time, and a share of time in a generator (of unit length) that counts as none.
_TIME_STEP = 0.05
_TIMELESS = 1e-6


class Brackets:
    """The Lie bracket of Pinocchio's tangent coordinates, [x, y]_i = sum over j, k of constants[i, j, k] x_j y_k.

    Read off Pinocchio's own transport exp(-h [x, .]) along a motion, so that it knows every joint; rounded, since the
    constants of these groups are -1, 0 and 1.
    """

    def __init__(self, model: pin.Model) -> None:
        q, unit = pin.neutral(model), np.eye(model.nv)
        rates, _ = jacobian(lambda x: pin.dIntegrate(model, q, x, pin.ArgumentPosition.ARG0), unit, [0.5] * model.nv)
        self.constants = -np.round(rates).swapaxes(1, 2)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """(nv, nv) matrix of y -> [x, y]."""
        return np.einsum("ijk,j->ik", self.constants, x)


@dataclass(frozen=True)
class Symmetries:
    """Generators, one a column; left (nv, s) in the tangent coordinates of the state's configuration q0; turns
    (s, nv, nv).

    drift (nv,), twist (nv,), turn (nv, nv): the parts of the generator that goes with time, at unit rate (a rotating
    hoop carries its bead around); zero where no drive depends on time.
    """

    model: pin.Model
    brackets: Brackets
    q0: np.ndarray
    left: np.ndarray
    right: np.ndarray
    turns: np.ndarray
    drift: np.ndarray
    twist: np.ndarray
    turn: np.ndarray

    @property
    def count(self) -> int:
        return int(self.left.shape[1])

    def displacements(self, q: np.ndarray) -> np.ndarray:
        """(nv, s) how the generators move q."""
        return self._transport(q) @ self.left + self.right + (self.turns @ _slides(self.model, q)).T

    def accelerations(self, v: np.ndarray) -> np.ndarray:
        """(nv, s) how they change v."""
        return self.brackets(v) @ self.right + (self.turns @ v).T

    def velocity(self, q: np.ndarray, combination: np.ndarray) -> np.ndarray:
        """(nv,) rate of q along the generator of time and a combination (s,) of the others."""
        by_time = self._transport(q) @ self.drift + self.twist + self.turn @ _slides(self.model, q)
        return self.displacements(q) @ combination + by_time

    def carrying(self, combination: np.ndarray) -> np.ndarray:
        """(nv, nv) matrix from velocities to their rates along them."""
        turn = np.tensordot(combination, self.turns, axes=1) + self.turn
        return np.asarray(turn - self.brackets(self.right @ combination + self.twist))

    def acceleration(self, v: np.ndarray, combination: np.ndarray) -> np.ndarray:
        """(nv,) rate of v along them."""
        return self.carrying(combination) @ v

    def fit(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, float]:
        """The combination (s,) of generators that the motion follows, and how far it is from following one.

        The distance is the largest component of v and a that is left over, in m, rad and s.
        """
        matrix = np.vstack([self.displacements(q), self.accelerations(v)])
        none = np.zeros(self.count)
        motion = np.concatenate([v - self.velocity(q, none), a - self.acceleration(v, none)])
        combination = np.linalg.lstsq(matrix, motion, rcond=1e-10)[0]
        return combination, float(np.abs(motion - matrix @ combination).max(initial=0.0))

    def _transport(self, q: np.ndarray) -> np.ndarray:
        apart = pin.difference(self.model, self.q0, q)
        return pin.dIntegrate(self.model, self.q0, apart, pin.ArgumentPosition.ARG0)


def _slides(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """(nv,) the coordinates of joints that have as many as velocities, in the order of these; zeros for others."""
    out = np.zeros(model.nv)
    for joint in model.joints[1:]:
        if joint.nq == joint.nv:
            out[joint.idx_v : joint.idx_v + joint.nv] = q[joint.idx_q : joint.idx_q + joint.nq]
    return out


def _find_turns(model: pin.Model, locked: Sequence[int]) -> np.ndarray:
    """(k, nv, nv) linear maps of the coordinates of joints that only slide, one after the other, which turn what they
    carry about the origin of their coordinates, in each plane that their axes span. Joints between them may be locked.
    """
    if model.nv == 0:
        return np.zeros((0, 0, 0))
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    columns = [[k for k in range(joint.idx_v, joint.idx_v + joint.nv) if k not in locked] for joint in model.joints]
    rates = [pin.getJointJacobian(model, data, j, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1) for j in range(model.njoints)]
    sliding = [j for j in range(1, model.njoints) if not rates[j][3:, columns[j]].any()]
    turns: list[np.ndarray] = []
    for last in set(sliding) - {model.parents[j] for j in sliding}:
        own, j = list(columns[last]), model.parents[last]
        while j in sliding:
            own, j = columns[j] + own, model.parents[j]
        if not own:
            continue
        _, sizes, axes = np.linalg.svd(rates[last][:3, own], full_matrices=False)
        span = range(int((sizes > _TOLERANCE * sizes[0]).sum()))
        for a, b in combinations(span, 2):
            turns.append(np.zeros((model.nv, model.nv)))
            ratio = sizes[b] / sizes[a]
            turns[-1][np.ix_(own, own)] = ratio * np.outer(axes[a], axes[b]) - np.outer(axes[b], axes[a]) / ratio
    return np.array(turns).reshape(len(turns), model.nv, model.nv)


def find_symmetries(instant: Instant) -> Symmetries:
    """All generators under which contacts and accelerations stay alike, found by differences at random states nearby.

    Raises SolverError where no states nearby can be evaluated, StateError where a drive makes the motion look different
    as time goes on, from whatever axes.
    """
    model, nv = instant.model, instant.system.nv
    rng = np.random.default_rng(20070815)
    brackets = Brackets(model)
    # of the coordinates that do not commute with all others: elsewhere the right part is the left one
    rights = np.flatnonzero(np.abs(brackets.constants).sum(axis=(0, 1)))
    turns = _find_turns(model, instant.system.locked)
    blocks: list[np.ndarray] = []
    noise = 0.0
    spread = _SPREAD
    for _ in range(_RETRIES):
        if len(blocks) == _SAMPLES:
            break
        apart = spread * instant.length * rng.uniform(-1.0, 1.0, nv)
        speed = max(1.0, float(np.abs(instant.v).max(initial=0.0)))
        # velocities, too: what does not turn goes on along its own axes as it does along the world's
        v = instant.v + 0.3 * speed * spread / _SPREAD * rng.uniform(-1.0, 1.0, nv) * instant.system.moves
        try:
            block, error = _defects(instant, brackets, *instant.projected(instant.moved(apart), v), rights, turns)
        except (SolverError, SingularContactError):
            spread *= 0.5
            continue
        blocks.append(block)
        noise = math.hypot(noise, error)
    if len(blocks) < _SAMPLES:
        raise SolverError("symmetries: the equations of motion cannot be evaluated near this state")
    matrix = np.vstack(blocks)
    _, values, vectors = np.linalg.svd(matrix)
    rank = int((values > _TOLERANCE * values[0]).sum()) if values.size and values[0] > ABOVE_NOISE * noise else 0
    free = vectors[rank:].T
    # turn the basis so that one generator alone goes with time
    rates = free[-1]
    speed = float(np.linalg.norm(rates))
    if speed < _TIMELESS:
        raise StateError("the motion is not steady: a drive makes the accelerations depend on time")
    basis = np.linalg.qr(np.column_stack([rates / speed, np.eye(rates.size)]))[0]
    with_time = free @ rates / speed**2
    free = free @ basis[:, 1:]
    parts = np.cumsum([nv, rights.size, len(turns)])
    lefts, of_right, of_turns, _ = np.vsplit(np.column_stack([free, with_time]), parts)
    right = np.zeros((nv, lefts.shape[1]))
    right[rights] = of_right
    turn = np.tensordot(of_turns.T, turns, axes=1)
    others, last = (lefts[:, :-1], right[:, :-1], turn[:-1]), (lefts[:, -1], right[:, -1], turn[-1])
    return Symmetries(model, brackets, instant.q.copy(), *others, *last)


def _defects(
    instant: Instant, brackets: Brackets, q: np.ndarray, v: np.ndarray, rights: np.ndarray, turns: np.ndarray
) -> tuple[np.ndarray, float]:
    """(rows, nv + rights + turns + 1) what each elementary generator changes at a state: gaps' rates, what is locked,
    accelerations; and the error of all that. The last generator is time.
    """
    model, nv = instant.model, instant.system.nv
    a = instant.evaluate(q, v)
    holonomic = instant.holonomic()
    normals, speeds = instant.rows(holonomic), instant.velocities(holonomic)
    scale = max(1.0, float(np.abs(a).max(initial=0.0)))
    transport = pin.dIntegrate(model, instant.q, pin.difference(model, instant.q, q), pin.ArgumentPosition.ARG0)
    turned = np.eye(nv)[:, rights]
    dq = np.hstack([transport, turned, (turns @ _slides(model, q)).T])
    dv, expected = (np.hstack([np.zeros((nv, nv)), brackets(x) @ turned, (turns @ x).T]) for x in (v, a))

    changes = np.vstack([dq, dv])
    steps = [instant.step_along(change, q, v) for change in changes.T]
    change, errors = jacobian(lambda x: instant.varied(x, q, v), changes, steps, _LEVELS)
    aging, error = np.zeros(nv), 0.0
    if instant.driven():
        aging, error = derivative(lambda h: instant.evaluate(q, v, t=instant.t + h), _TIME_STEP)
    # what of the normal velocities the drives make
    locked = instant.system.locked
    by_time = np.concatenate([speeds - normals @ v, np.zeros(len(locked)), aging / scale])
    block = np.vstack([normals @ dq, dq[locked], (change - expected) / scale])
    return np.column_stack([block, by_time]), float(np.linalg.norm([*errors, error])) / scale
