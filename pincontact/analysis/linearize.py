"""Linearised motion about equilibria and steady motions, with rolling, sliding and frictionless contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
import scipy

from ..arguments import check_tolerance
from ..display import Summary
from ..errors import ArgumentError, StateError
from ..state import State
from .instant import Instant, jacobian
from .symmetry import find_symmetries

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..scene import Scene

# A coordinate is chosen only if the others depend on it by less than the inverse of this.
_WELL_CONDITIONED = 1e-6
# A symmetry that moves the state by less (in m and rad) leaves it where it is.
_NO_MOTION = 1e-7


@dataclass(frozen=True, eq=False, repr=False)
class Linearization(Summary):
    """x' = A x + B dtau about a steady motion, for n independent deviations x.

    x holds deviations of some of the model's velocity coordinates: the first `positions` of them of the configuration
    (dq, tangent to it as `pin.difference` gives it), the others of the velocity (dv). All consistent deviations are
    dq = dq_dx x, dv = dv_dx x. dtau are changes of the joint torques. SI units, Pinocchio's order.

    Attributes
    ----------
    A : (n, n) array
    B : (n, nv) array
    indices : (n,) array of int
        Velocity coordinates that x holds.
    positions : int
        How many of them are of the configuration.
    names : list of str
        Their names, such as "q:steer" or "v:root_joint.wx".
    dq_dx, dv_dx : (nv, n) array
        Deviations of all coordinates.
    symmetries : (n, s) array
        By columns, deviations that lead to the same motion elsewhere (position on the plane, heading, spin); they span
        an invariant subspace of A.
    error : float
        Estimated error of A's entries, from the differences and from how exactly A keeps to consistent deviations.
    defect : float
        How far the motion is from steady, in m, rad and s.
    """

    A: np.ndarray
    B: np.ndarray
    indices: np.ndarray
    positions: int
    names: list[str]
    dq_dx: np.ndarray
    dv_dx: np.ndarray
    symmetries: np.ndarray
    error: float
    defect: float

    @cached_property
    def _eigen(self) -> tuple[np.ndarray, np.ndarray]:
        values, vectors = np.linalg.eig(self.A)
        order = np.lexsort((values.imag, -values.real))
        return values[order], vectors[:, order]

    @property
    def eigenvalues(self) -> np.ndarray:
        """Eigenvalues of A, (n,) complex, in 1/s, the least stable first."""
        return self._eigen[0]

    @property
    def eigenvectors(self) -> np.ndarray:
        """Eigenvectors of A, (n, n) complex, by columns, in x."""
        return self._eigen[1]

    def reduce(self, dq: ArrayLike, dv: ArrayLike) -> np.ndarray:
        """The coordinates x of a consistent deviation.

        Parameters
        ----------
        dq, dv : (nv,) array_like
            Deviation of configuration (tangent) and velocity.

        Returns
        -------
        (n,) array
        """
        dq, dv = np.asarray(dq, dtype=float), np.asarray(dv, dtype=float)
        return np.concatenate([dq[self.indices[: self.positions]], dv[self.indices[self.positions :]]])

    def without_symmetries(self) -> Linearization:
        """The same with deviations along the symmetries left out: what matters to stability.

        Position, heading and spin are dropped, and their eigenvalues with them (zeros, or plus and minus i times the
        turning rate). Where steady motions come in families, a zero eigenvalue is left for each parameter of the
        family, such as the speed of a vehicle. The coordinates that remain keep their names; the others take the values
        with which the deviation along symmetries is zero.

        Returns
        -------
        Linearization
        """
        if self.symmetries.shape[1] == 0:
            return self
        basis, triangle, _ = scipy.linalg.qr(self.symmetries, mode="economic", pivoting=True)
        sizes = np.abs(np.diag(triangle))
        basis = basis[:, : int((sizes > _NO_MOTION * max(1.0, sizes[0])).sum())]
        if basis.shape[1] == 0:
            return self
        dropped = _independent(basis, range(self.positions))
        kept = [i for i in range(self.A.shape[0]) if i not in dropped]
        # x[kept] - basis[kept] basis[dropped]^-1 x[dropped] does not change along symmetries
        project = np.zeros((len(kept), self.A.shape[0]))
        project[:, kept] = np.eye(len(kept))
        project[:, dropped] = -np.linalg.solve(basis[dropped].T, basis[kept].T).T
        return replace(
            self,
            A=(project @ self.A)[:, kept],
            B=project @ self.B,
            indices=self.indices[kept],
            positions=sum(i < self.positions for i in kept),
            names=[self.names[i] for i in kept],
            dq_dx=self.dq_dx[:, kept],
            dv_dx=self.dv_dx[:, kept],
            symmetries=np.zeros((len(kept), 0)),
            error=max(self.error, float(np.abs(project @ self.A @ basis).max(initial=0.0))),
        )


def linearize(
    scene: Scene,
    state: State,
    tau: ArrayLike | None = None,
    *,
    coordinates: Sequence[str | int] = (),
    tolerance: float = 1e-6,
) -> Linearization:
    """Linearise a scene's motion about an equilibrium or a steady motion.

    Contacts keep the mode they have at the state, and so do joints: one that rests at an end of its way stays there, as
    by a GC, as a locked one does; one that rests by dry friction has no velocity, as by a VC, and the dry friction of
    one that moves is a constant force. Geometric constraints (GC) reduce configurations and velocities, rolling
    constraints (VC) velocities only, so n = 2 (nv - GCs) - VCs: rolling does not bind the configuration. Derivatives
    are Richardson extrapolations of the package's own constrained accelerations, exact to about 1e-11; their error is
    estimated and reported.

    A steady motion follows a symmetry of the scene: the deviation is taken in axes that go along with it, where A is
    constant. So a bicycle that runs straight, a disk that rolls in a circle and a bead in a rotating hoop are all
    points of rest.

    Parameters
    ----------
    scene : Scene
    state : State
        The equilibrium, or a state of the steady motion.
    tau : (nv,) array_like, optional
        Joint torques that act in N and N m, zero if not given.
    coordinates : sequence of str or int
        Velocity coordinates (indices, or names such as "steer" and "root_joint.wx") to describe deviations by. Those
        are taken that are independent, in this order, then the best conditioned of the others.
    tolerance : float
        How far the motion may be from steady (`Linearization.defect`), relative to v and a where these exceed 1.

    Returns
    -------
    Linearization

    Raises
    ------
    StateError
        Where the motion is farther from steady, where a contact or a joint begins to slip at the state, or rests with
        its friction just at the limit, or for a bad tau.
    ArgumentError
        For an unknown coordinate or a state of another scene.
    SolverError, SingularContactError
        Where there are no accelerations.

    Examples
    --------
    A ball at the bottom of a bowl swings with the angular frequency sqrt(g / (R - r)) if nothing makes it roll:

    >>> import pincontact as pc
    >>> scene = pc.Scene.from_urdf("urdf/ball.urdf", floating_base=True)
    >>> ball = scene.add_contour("ball", pc.Sphere(0.1), frame="ball")
    >>> bowl = scene.add_contour("bowl", pc.Sphere(1.0))
    >>> contact = scene.add_contact("ball/bowl", ball, bowl, side=-1)
    >>> state = scene.initial_state([0, 0, -0.9, 0, 0, 0, 1])
    >>> motion = pc.linearize(scene, state).without_symmetries()
    >>> sorted(abs(motion.eigenvalues.imag).round(6).tolist())[-2:], round((9.81 / 0.9) ** 0.5, 6)
    ([3.301515, 3.301515], 3.301515)
    """
    check_tolerance(tolerance)
    if not isinstance(coordinates, Sequence):
        raise ArgumentError(f"coordinates must be names or numbers of velocity coordinates, got {coordinates!r}")
    coordinates = [coordinates] if isinstance(coordinates, str) else coordinates
    instant = Instant(scene, state, tau)
    if instant.starting():
        raise StateError(f"{instant.starting()[0]} begins to slip at this state: no linear motion describes it")
    if instant.at_limit():
        raise StateError(
            f"{instant.at_limit()[0]} rests with its friction just at the limit: no linear motion describes it"
        )
    return _linearized(instant, [_coordinate(instant.model, entry) for entry in coordinates], tolerance)


def _linearized(instant: Instant, wanted: list[int], tolerance: float) -> Linearization:
    """The linear motion about the state of an instant, in these velocity coordinates as far as they are independent."""
    q, v, model, nv = instant.q, instant.v, instant.model, instant.system.nv
    a = instant.evaluate()
    constrained, holonomic = instant.constrained(), instant.holonomic()
    # consistent deviations: dq = Z y; dv = W u + G y, with the constrained components of v_c staying zero
    z, w = instant.free_directions(holonomic), instant.free_directions(constrained)
    symmetries = find_symmetries(instant)
    combination, defect = symmetries.fit(q, v, a)
    scale = max(1.0, float(np.abs(v).max(initial=0.0)), float(np.abs(a).max(initial=0.0)))
    if not defect <= tolerance * scale:
        raise StateError(
            f"the motion is not steady: velocities or accelerations are off by {defect:.3g} from every motion along a "
            f"symmetry of the scene (tolerance {tolerance * scale:.3g}); see find_equilibrium and find_steady_motion"
        )
    carrying = symmetries.carrying(combination)

    configuration = _independent(z, wanted)
    z = np.linalg.solve(z[configuration].T, z.T).T
    velocity = _independent(w, wanted)
    w = np.linalg.solve(w[velocity].T, w.T).T
    unit, load = np.eye(nv), max(1.0, float(np.abs(instant.system.bias_forces).max(initial=0.0)))

    def varied(change: np.ndarray) -> np.ndarray:
        acceleration = instant.varied(change)
        return np.concatenate([instant.velocities(constrained), acceleration])

    changes = scipy.linalg.block_diag(z, unit)
    flow, errors = jacobian(varied, changes, [instant.step_along(change) for change in changes.T])
    turning, pull = np.vsplit(flow[:, : z.shape[1]], [len(constrained)])
    drag = flow[len(constrained) :, z.shape[1] :]
    torque, noise = jacobian(lambda dtau: instant.evaluate(tau=instant.tau + dtau), unit, [0.1 * load] * nv)
    error = float(np.concatenate([errors, noise]).max(initial=0.0))
    instant.evaluate()
    g = -instant.least_change(constrained, turning)
    g -= w @ g[velocity]

    dq_dx = np.hstack([z, np.zeros((nv, w.shape[1]))])
    dv_dx = np.hstack([g, w])
    # the flow seen from axes that go along with the symmetry, which carries x at a rate C x: dq' = dv - [v, dq] - C dq,
    # dv' = A_q dq + A_v dv - C dv
    q_rate = dv_dx - (symmetries.brackets(v) + carrying) @ dq_dx
    v_rate = np.hstack([pull, np.zeros_like(w)]) + (drag - carrying) @ dv_dx
    matrix = np.vstack([q_rate[configuration], v_rate[velocity]])
    for found, expected in ((q_rate, dq_dx @ matrix), (v_rate, dv_dx @ matrix)):
        error = max(error, float(np.abs(found - expected).max(initial=0.0)))
    orbit = np.vstack([symmetries.displacements(q)[configuration], symmetries.accelerations(v)[velocity]])
    names = velocity_names(model)
    return Linearization(
        matrix,
        np.vstack([np.zeros((len(configuration), nv)), torque[velocity]]),
        np.array(configuration + velocity),
        len(configuration),
        [f"q:{names[k]}" for k in configuration] + [f"v:{names[k]}" for k in velocity],
        dq_dx,
        dv_dx,
        orbit,
        error,
        defect,
    )


def velocity_names(model: pin.Model) -> list[str]:
    """Names of the velocity coordinates: the joint's, with .vx ... .wz for a free flyer and .0, .1, ... for others."""
    names: list[str] = [""] * model.nv
    for j in range(1, model.njoints):
        joint, name = model.joints[j], str(model.names[j])
        if joint.nv == 1:
            parts = [name]
        elif joint.shortname() == "JointModelFreeFlyer":
            parts = [f"{name}.{axis}" for axis in ("vx", "vy", "vz", "wx", "wy", "wz")]
        else:
            parts = [f"{name}.{k}" for k in range(joint.nv)]
        names[joint.idx_v : joint.idx_v + joint.nv] = parts
    return names


def _coordinate(model: pin.Model, entry: str | int) -> int:
    names = velocity_names(model)
    if isinstance(entry, str):
        if entry not in names:
            raise ArgumentError(f"unknown coordinate {entry!r}; velocity coordinates: {', '.join(names)}")
        return names.index(entry)
    if not isinstance(entry, (int, np.integer)) or not 0 <= entry < model.nv:
        raise ArgumentError(f"coordinate {entry!r} is not one of the {model.nv} velocity coordinates")
    return int(entry)


def _independent(basis: np.ndarray, wanted: Sequence[int]) -> list[int]:
    """As many rows of a basis (n, k) as it has columns, independent: those wanted first, then the best conditioned."""
    chosen: list[int] = []
    rest, waiting = basis.copy(), list(wanted)
    while len(chosen) < basis.shape[1]:
        sizes = np.linalg.norm(rest, axis=1)
        row = waiting.pop(0) if waiting else int(np.argmax(sizes))
        if sizes[row] > _WELL_CONDITIONED:
            unit = rest[row] / sizes[row]
            rest -= np.outer(rest @ unit, unit)
            chosen.append(row)
    return sorted(chosen)
