"""Inverse dynamics with contacts: torques and contact forces for wanted accelerations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arguments import check_flag, check_tolerance
from ..display import Summary
from ..dynamics.units import whitened_velocity
from ..errors import ArgumentError, SolverError, StateError
from ..geometry.patterns import ON_CURVE
from ..layout import MODE, MU_STATIC, PATTERN, ROLLING_ROW, SLIPPING, STICK
from .farkas import FarkasCertificate
from .forces import check_forces, forces_of_locks
from .instant import Instant
from .inverse_loads import unit_forces
from .inverse_problem import Options, Wanted, opening_contacts
from .inverse_program import InverseProgram, Solved
from .tasks import Accelerations, Weights

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..scene import Scene
    from ..state import State

# Torques above the limit of a resistance by less than this part of it are at it.
_LIMIT_SLACK = 1e-9
# Accelerations wanted that are missed by less than this part of them, or of those without contacts, are met.
_MISSED = 1e-6
_UNREACHABLE, _REDUNDANT = ("error", "nearest"), ("least", "centred", "last")


@dataclass(frozen=True, eq=False)
class HeldTurn:
    """What keeps a contact that resists spinning or rolling from turning.

    Attributes
    ----------
    contact : str
        Its name.
    kind : {"spinning", "rolling"}
    torque : (3,) array
        On the second contour given, world axes, N m.
    limit : float
        The most that the resistance can do under the contact's normal force, N m.
    """

    contact: str
    kind: str
    torque: np.ndarray
    limit: float

    @property
    def within(self) -> bool:
        """Whether the resistance can do it, but for round-off; else the contact would begin to turn."""
        return float(np.linalg.norm(self.torque)) <= self.limit * (1.0 + _LIMIT_SLACK)


@dataclass(frozen=True, eq=False, repr=False)
class InverseDynamics(Summary):
    """Joint torques and contact forces, as `inverse_dynamics` finds them.

    Attributes
    ----------
    tau : (nv,) array
        Joint torques in N and N m, actuation @ efforts.
    efforts : (na,) array
        Of the actuators, in N and N m.
    acceleration : (nv,) array
        The one that was wanted, or found, in m/s^2 and rad/s^2.
    forces : dict of str to (3,) array
        Force of each contact in N, on the second contour given, world axes.
    torques : dict of str to (3,) array
        What resists spinning and rolling in N m, likewise.
    residual : float
        What is left of the equations of motion, in N and N m.
    joint_forces : (nv,) array
        Dry friction of joints and what the ends of their ways, or locked joints, carry, in N and N m.
    held : tuple of HeldTurn
        Of `torques` those of resistances that are at rest, each with the limit that it was not made to obey.
    missed : float
        By how much the accelerations wanted are missed, because of contacts, ends of joints, actuators or limits: the
        root of the sum of weight * error^2, for a vector without weights in the norm of the mass matrix.
    shortfall : float
        The part of this that limits are the reason for: by how much what could be reached without them is missed.
    certificate : FarkasCertificate or None
        Why they are out of reach.
    programs : dict of str to int
        How many quadratic programs ProxQP solved in this call, for the nearest "accelerations", the least "efforts",
        redundant "forces" and the "certificate" that nothing is admissible. Empty for calls without limits, named
        accelerations or a choice of forces.
    """

    tau: np.ndarray
    efforts: np.ndarray
    acceleration: np.ndarray
    forces: dict[str, np.ndarray]
    torques: dict[str, np.ndarray]
    residual: float
    joint_forces: np.ndarray
    held: tuple[HeldTurn, ...] = ()
    missed: float = 0.0
    shortfall: float = 0.0
    certificate: FarkasCertificate | None = None
    programs: dict[str, int] = field(default_factory=dict)
    _program: InverseProgram | None = field(default=None, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        # copies in files and other processes are results, not `warm`
        return self.__dict__ | {"_program": None}


def inverse_dynamics(
    scene: Scene,
    state: State,
    acceleration: Accelerations = None,
    *,
    actuation: ArrayLike | Sequence[str] | None = None,
    forces: Mapping[str, ArrayLike] | None = None,
    tolerance: float = 1e-8,
    cones: bool = False,
    effort_limits: bool = False,
    weights: Weights = None,
    unreachable: str = "error",
    redundant: str = "least",
    warm: InverseDynamics | None = None,
) -> InverseDynamics:
    """Joint torques and contact forces that give a scene the accelerations wanted at a state.

    They solve M a + nle + damping v = actuation efforts + joint forces + sum of (contact rows)^T F.

    With contacts many pairs of torques and forces do it. The ones returned have the least torques (the norm of
    `efforts`) and, among those, the contact forces that `redundant` chooses. Closed contacts stay closed; those at rest
    stick or roll, and carry what that takes, within their cones with `cones=True`; contacts that slide carry Coulomb's
    force. Likewise a resistance to spinning or rolling that is at rest holds with whatever torque it takes, or with
    `cones=True` within its limit: `held` says with which, and whether that is within. Contacts that are given in
    `forces` carry just that, and resist no turning.

    Joints have their dry friction. One that moves, or is to begin to, has all of it, against its motion. One that rests
    and is to stay at rest may have any friction in its range, and any push of a limit that it rests at; the least
    efforts make use of both. Where the range contains zero, no friction is as possible as any other: to find torques
    that hold without it, set the model's `lowerDryFrictionLimit` and `upperDryFrictionLimit` to zero.

    Limits, named accelerations and choices of forces make it a sequence of quadratic programs, solved by ProxQP: the
    accelerations nearest to those wanted, the least efforts with these, and the chosen forces with these efforts. In a
    control loop pass the last result as `warm`; the programs then go on from its solution, at a fraction of the time::

        found = None
        while True:
            found = pc.inverse_dynamics(scene, stepper.state, wanted, cones=True, effort_limits=True, warm=found)
            stepper.step(found.tau)

    Parameters
    ----------
    scene : Scene
        The scene.
    state : State
        A state of it. A contact that sticks in the state, as the last step of a `Stepper` left it, sticks.
    acceleration : (nv,) array_like, mapping or None
        Wanted. A vector must keep the closed contacts closed and rolling, unless `unreachable="nearest"`. A mapping
        has for names of joints the accelerations of their coordinates (a free flyer's are in body axes), and for names
        of other frames that of the frame's origin (3,), or of that and the frame's rotation (6,), both in world axes;
        where contacts forbid these, the nearest are found, and `missed` of the result says how near.
        None: the one nearest zero, in the norm of the mass matrix (going on at constant velocity as far as the contacts
        let it).
    actuation : (nv, na) array_like, sequence of str or None
        Matrix, or names of joints; None: all joints except a free-flying root.
    forces : mapping of str to (3,) array_like or None
        Contact -> force in N on the second contour given, world axes. A unilateral contact that is given no force may
        open: its gap is kept from shrinking only.
    tolerance : float
        Largest residual and largest constraint defect that counts as none, relative to the loads.
    cones : bool
        Contact forces stay in their friction cones, elliptic ones too, and push, to 1e-6 of the loads. The normal
        force of a contact that cannot open has either sign; points on curves have its direction without cones, or the
        opposite one.
    effort_limits : bool
        The torques that actuators make stay within the model's `effortLimit`.
    weights : float, (nv,) array_like or mapping, optional
        How much accelerations count that cannot all be reached: the sum of weight * error^2 is least. One number or
        (nv,) for a vector, else name -> one number, or one for each of its entries. None: 1, but for a vector the norm
        of the mass matrix.
    unreachable : {"error", "nearest"}
        What is done where cones, limits or (for a vector) contacts do not let the accelerations be as near to those
        wanted as they could be without: InfeasibleError, or the nearest ones, with `shortfall` and `certificate`.
    redundant : {"least", "centred", "last"}
        Which contact forces are taken among those with the same efforts and accelerations: those of least norm of their
        components, the most central ones within cones (of least norm where the cones leave no inside), or those nearest
        to the forces of `warm`.
    warm : InverseDynamics or None
        The result of the last call for this scene with limits, named accelerations, a choice of forces or `warm`. It
        hands its programs on. The scene and its model must be what they were.

    Returns
    -------
    InverseDynamics

    Raises
    ------
    StateError
        For an acceleration that breaks the contacts (with the contact and the number), that takes a joint beyond its
        end, or is no vector (nv,).
    ArgumentError
        For a bad actuation, weight or option, an unknown contact, joint or frame, or a state of another scene.
    InfeasibleError
        Where cones and limits make the accelerations impossible, or all of them whatever `unreachable` says; its
        `certificate` is a `FarkasCertificate`.
    SolverError
        Where these actuators cannot do it: accelerations that are a vector without weights, unless
        `unreachable="nearest"`.

    Examples
    --------
    A ball on a table accelerates at 1 m/s^2: its own torque about y is all there is to drive it.

    >>> import pincontact as pc
    >>> scene = pc.Scene.from_urdf("urdf/ball.urdf", floating_base=True)
    >>> ball = scene.add_contour("ball", pc.Sphere(0.1), frame="ball")
    >>> floor = scene.add_contour("floor", pc.Plane())
    >>> contact = scene.add_contact("ball/floor", floor, ball, friction=pc.NoSlip())
    >>> state = scene.initial_state([0, 0, 0.1, 0, 0, 0, 1])
    >>> torque_about_y = [[0], [0], [0], [0], [1], [0]]
    >>> found = pc.inverse_dynamics(scene, state, [1, 0, 0, 0, 10, 0], actuation=torque_about_y)
    >>> mass, inertia = scene.model.inertias[1].mass, scene.model.inertias[1].inertia[1, 1]
    >>> bool(abs(found.efforts[0] - (0.1 * mass + 10 * inertia)) < 1e-9)
    True
    >>> bool(abs(found.forces["ball/floor"] - [mass, 0, 9.81 * mass]).max() < 1e-9)
    True
    """
    check_tolerance(tolerance)
    check_flag("cones", cones)
    check_flag("effort_limits", effort_limits)
    for name, value, known in (("unreachable", unreachable, _UNREACHABLE), ("redundant", redundant, _REDUNDANT)):
        if not (isinstance(value, str) and value in known):
            raise ArgumentError(f"{name} must be one of {', '.join(map(repr, known))}, got {value!r}")
    named, given = isinstance(acceleration, Mapping), {} if forces is None else forces
    limited = cones or effort_limits or unreachable != "error" or redundant != "least"
    exact = not (named or limited or weights is not None or warm is not None)
    program = _program(scene, state, warm)
    wanted = Wanted(
        program.tasks.read(acceleration, weights, program.instant.q, program.instant.v),
        program.actuation(actuation),
        check_forces(scene, given),
        Options(cones, effort_limits, unreachable, redundant, tolerance, exact),
    )
    if acceleration is None or named or unreachable != "error":
        return _found(program, wanted)
    _check_kept(program.instant, wanted)
    found = _found(program, wanted)
    if weights is None:
        _refuse_missed(program.instant, wanted, found.missed)
    return found


def _refuse_missed(instant: Instant, wanted: Wanted, missed: float) -> None:
    """Raise SolverError where accelerations of all coordinates are missed, in the norm of the mass matrix."""
    sizes = (whitened_velocity(instant.system, a) for a in (wanted.tasks.wanted, instant.system.free_acceleration))
    if missed > _MISSED * max(map(np.linalg.norm, sizes)):
        raise SolverError(
            f"inverse dynamics: the actuators and contacts miss the accelerations wanted by {missed:.3g} in the norm "
            'of the mass matrix; unreachable="nearest" takes the nearest ones'
        )


def _program(scene: Scene, state: State, warm: InverseDynamics | None) -> InverseProgram:
    """The program of the last result, at this state, or a new one."""
    if warm is None:
        return InverseProgram(scene, state)
    if not isinstance(warm, InverseDynamics) or warm._program is None:
        raise ArgumentError(
            "warm must be the result of inverse_dynamics with limits, named accelerations or a choice of forces, got "
            + (type(warm).__name__ if not isinstance(warm, InverseDynamics) else "one without")
        )
    if not warm._program.fits(scene):
        raise ArgumentError("warm: the result belongs to another scene, or contacts were added after it was made")
    warm._program.instant.move_to(state)
    return warm._program


def _found(program: InverseProgram, wanted: Wanted) -> InverseDynamics:
    """What the program finds."""
    instant, exact = program.instant, wanted.options.exact
    before, found = program.programs, program.solve(wanted)
    problem, system = found.problem, instant.system
    left, allowed = problem.unbalanced(found.u, wanted.tasks), wanted.options.tolerance * problem.load
    if exact and left > allowed:
        raise SolverError(
            f"inverse dynamics: the actuators and contacts leave {left:.3g} N (N m) of the equations of motion "
            f"(tolerance {allowed:.3g})"
        )
    joint_forces = system.joint_forces() + problem.beginning
    joint_forces[problem.resting.index] += found.holding
    acting, torques, held = _contact_forces(found, wanted.given)
    a, tau = problem.acceleration(found.u), wanted.actuation.matrix @ found.efforts
    joint_forces[system.locked] = forces_of_locks(instant, a, tau, acting, torques)
    return InverseDynamics(
        tau,
        found.efforts,
        a,
        acting,
        torques,
        problem.residual(found.u),
        joint_forces,
        held,
        problem.missed(found.u, wanted.tasks),
        found.shortfall,
        found.certificate,
        {} if exact else {name: count - before[name] for name, count in program.programs.items()},
        None if exact else program,
    )


def _check_kept(instant: Instant, wanted: Wanted) -> None:
    """Raise StateError for accelerations of all coordinates that break the contacts, or move what is locked."""
    system, a, tolerance = instant.system, wanted.tasks.wanted, wanted.options.tolerance
    opening = opening_contacts(instant, wanted.given)
    constrained = [item for item in instant.constrained() if system.owner(item[0]) not in opening]
    bias = instant.biases(constrained)
    scale = max(1.0, float(np.abs(a).max(initial=0.0)), float(np.abs(bias).max(initial=0.0)))
    for lock in system.locks:
        if abs(a[lock.index_v]) > tolerance * scale:
            raise StateError(f"acceleration: it moves joint {lock.joint!r}, which is locked, at {a[lock.index_v]:.3g}")
    defects = instant.rows(constrained) @ a + bias
    if constrained and np.abs(defects).max() > tolerance * scale:
        worst = int(np.argmax(np.abs(defects)))
        c, row = constrained[worst]
        kind = "apart" if (c, row) in instant.holonomic() else "into slip" if c < system.nc else "into turning"
        raise StateError(
            f"acceleration: it takes contact {system.contacts[system.owner(c)].name!r} {kind} at "
            f"{defects[worst]:.3g} {'m' if c < system.nc else 'rad'}/s^2 (tolerance {tolerance * scale:.3g})"
        )


def _contact_forces(
    found: Solved, given: dict[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], tuple[HeldTurn, ...]]:
    """Forces and torques on second contours, and the turns that are held."""
    instant, system = found.problem.instant, found.problem.instant.system
    # along the bases of items
    local = np.zeros((system.items, 3))
    for (c, row), component, share in zip(found.problem.items, found.components, found.problem.shares):
        if not system.nr and system.contact_int[c, MODE] != SLIPPING:
            local[c, row] += component
            continue
        for item, unit in unit_forces(instant, c, row, share).items():
            local[item] += component * unit
    acting, torques, held = {}, {contact.name: np.zeros(3) for contact in system.contacts}, []
    for c, contact in enumerate(system.contacts):
        sign = -1.0 if contact.swapped else 1.0
        acting[contact.name] = given.get(contact.name, sign * (local[c] @ system.basis[c]))
    for item in system.resisting():
        contact = system.contacts[system.owner(item)]
        sign = -1.0 if contact.swapped else 1.0
        torque = sign * (local[item] @ system.basis[item])
        torques[contact.name] += torque
        if system.contact_int[item, MODE] == STICK and contact.name not in given:
            held.append(_held_turn(instant, item, torque, acting))
    return acting, torques, tuple(held)


def _held_turn(instant: Instant, item: int, torque: np.ndarray, forces: dict[str, np.ndarray]) -> HeldTurn:
    """A resistance at rest with its torque, and the limit that follows from its contact's force."""
    system = instant.system
    c = system.owner(item)
    name, force = system.contacts[c].name, system.basis[c] @ forces[system.contacts[c].name]
    load = float(np.hypot(force[1], force[2]) if system.contact_int[c, PATTERN] == ON_CURVE else abs(force[2]))
    kind = "rolling" if system.contact_int[c, ROLLING_ROW] == item else "spinning"
    return HeldTurn(name, kind, torque, float(system.contact_real[item, MU_STATIC]) * load)
