"""The contact problem with Coulomb friction: who sticks, slips and separates, and the forces (Sec. 5.3).

What has to be found is the modes; whatever suggests them, `newton` computes the forces and the judge of `cone`
accepts or refuses them. The suggestions come from, cheapest first,

    warm    the modes and forces of the last solution: redundant forces that have left their cones are moved into them
    sweeps  a few Gauss-Seidel passes over the last forces, and more if these do not do; redundant forces as before
    path    the homotopy of `path`, which finds a solution unless the forces on it grow without bound; once more, with a
            trace of compliance, where all has failed
    qp      a sequence of ProxQP programs (`proxqp`); before all others where the caller asks for it

The first two are one call of compiled code (`attempt`), which other kernels can make, too. A single contact needs no
search: all of its states can be tried (`exact`). All but ProxQP compute the same to the bit
from the same problem and warm start; its forces are rounded to fewer digits before Newton has them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..arguments import NOT_REAL, check_flag, check_tolerance, real_array
from ..errors import ArgumentError, InfeasibleError, SolverError
from .attempt import (
    AFRESH,
    CLASSIFY,
    CLASSIFY_NEAR,
    NEAR,
    NEAREST,
    STRICTNESS,
    SWEEP_NEWTON_PASSES,
    SWEEP_ROUNDS,
    SWEEPING,
    SWEEPS,
    SWEEPS_PER_CONTACT,
    USUAL,
    WARM,
    WARM_PASSES,
    solve_cones,
)
from .cone import (
    BY_PATH,
    DECIDED,
    DECIDERS,
    HUGE,
    KNOWN,
    OPEN,
    PASSES,
    RANK_TOLERANCE,
    SLIP,
    STICK,
    TIMES,
    TRIED,
    UNDECIDED,
    cone_workspace,
)
from .feasibility import crushing_combination
from .path import follow_path
from .proxqp import PROGRAMS, ConePrograms

__all__ = ["OPEN", "SLIP", "STICK", "ContactSolution", "ContactSolver", "centred_forces", "solve_contacts"]

# Newton passes from a point of the path: near a solution three do, elsewhere none.
PATH_NEWTON_PASSES = 6
# Values of t at which the path's forces are tried.
PATH_STOPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-9, 1e-11, 1e-13)
# Width of the tube round the path, and size of b against the path's beginning, in the order they are tried.
PATH_STARTS = (
    (0.01, 1.0), (0.002, 1.0), (0.01, 0.1), (0.01, 100.0), (0.01, 0.01), (0.01, 10.0), (0.002, 0.1), (0.0002, 1.0),
    (0.002, 0.01), (0.002, 100.0),
)  # fmt: skip
# A path on which the forces grow without bound shows that no forces make the contacts give way; this many, from
# different beginnings, end the search.
ESCAPES = 2
# Steps to a stop; a stop takes ten as a rule.
PATH_STEPS = 500
QUICK_PATH_STEPS = 20
# Compliances, relative to a contact's own, with which the path is tried again where all else has failed.
COMPLIANCES = (1e-12, 1e-13, 1e-11)
# Newton passes from a program's forces.
PROGRAM_NEWTON_PASSES = 8
# Programs per beginning where the search is to be quick: 99 problems in 100 need no more.
QUICK_PROGRAMS = 10
STAGES = ("sweeps", "path", "qp")
CONTACT_SOLVERS = ("auto", "proxqp")
# The value of t at which redundant forces count as centred.
CENTRE = 1e-9
# Velocities relative to the terms that cancel in them.
AT_REST = 1e-9
TINY = 1e-300


class _Workspace:
    """Buffers, warm start and helper solvers for problems of one size."""

    def __init__(self, contacts: int):
        self.contacts = contacts
        self.space = cone_workspace(contacts)
        self.address = self.space.address
        self.modes = self.space.modes
        self.forces = self.space.forces
        self.velocities = self.space.velocities
        self.counts = self.space.counts
        self.counts[DECIDED] = UNDECIDED
        self.reached = self.space.reached
        self.programs: ConePrograms | None = None

    def decide(self, stage: str) -> None:
        """Count a problem that a stage outside of the kernel has solved."""
        code = DECIDERS.index(stage)
        self.counts[KNOWN] = 1
        self.counts[DECIDED] = code
        self.counts[TIMES + code] += 1


@dataclass(frozen=True)
class ContactSolution:
    """Forces and relative velocities of n contacts that obey Coulomb's law; rows are (t1, t2, n).

    forces:      (n, 3), N (or N s, if b was a velocity)
    velocities:  (n, 3), u = G F + b: m/s^2 (or m/s)
    modes:       (n,) OPEN, STICK or SLIP
    residual:    relative residual of the judge (see `cone`), without units
    iterations:  Newton passes of the start that decided
    qp_count:    programs that ProxQP was given
    decided_by:  "warm", "exact", or the stage of the search: see the module
    mu:          (n,) the coefficients
    """

    forces: np.ndarray
    velocities: np.ndarray
    modes: np.ndarray
    residual: float
    iterations: int
    qp_count: int
    decided_by: str
    mu: np.ndarray

    @property
    def cone_excess(self) -> np.ndarray:
        """(n,) |F_t| - mu F_n, never positive beyond round-off where mu is finite; 0 for infinite mu."""
        tangential = np.hypot(self.forces[:, 0], self.forces[:, 1])
        finite = np.isfinite(self.mu)
        return np.where(finite, tangential - np.where(finite, self.mu, 0.0) * self.forces[:, 2], 0.0)

    @property
    def complementarity(self) -> np.ndarray:
        """(n,) F . (u + mu |u_t| n), zero up to round-off; F_n u_n where mu is infinite."""
        speed = np.hypot(self.velocities[:, 0], self.velocities[:, 1])
        finite = np.isfinite(self.mu)
        tangential = np.einsum("ij,ij->i", self.forces[:, :2], self.velocities[:, :2])
        tangential += np.where(finite, self.mu, 0.0) * speed * self.forces[:, 2]
        return self.forces[:, 2] * self.velocities[:, 2] + np.where(finite, tangential, 0.0)

    @property
    def dissipation(self) -> np.ndarray:
        """(n,) -F_t . u_t, the power that friction takes, never negative beyond round-off."""
        return -np.einsum("ij,ij->i", self.forces[:, :2], self.velocities[:, :2])


class ContactSolver:
    """Solves contact problems one after the other, each from the last one's modes. Nothing is validated here.

    After `solve` returns True, `modes` (n,), `forces` (3n,), `velocities` (3n,) and `residual` hold the solution; the
    arrays are buffers that the next call overwrites. When it returns False they are what they were before, and
    `residual` is the least that was reached.

    tolerance: relative residual up to which a solution is accepted
    stages:    how the modes are looked for where a warm start is missing or refused, in this order
    quick:     gives up early: the path is tried once, with few steps, and ProxQP not at all
    nearest:   redundant forces may be the ones nearest to the last, or to what sweeps have found, where those of least
               norm leave their cones; else other modes are looked for, and what slides has loads that do not depend on
               the past
    contact_solver: see `choose`

    Counters: polish_count (warm starts tried), path_count (paths begun), qp_count (programs), qp_iterations,
    qp_failures (problems that its programs did not solve), and decided (by stage).
    Kernels call `attempt.solve_cones` with `address(n)` and `task` themselves; `search` goes on where that failed.
    After a search that failed `jammed` says whether that was because the forces grow without bound on the path; where
    there provably is no solution `certificate` (n,) is the reason, see `InfeasibleError`, otherwise None.
    """

    def __init__(
        self,
        tolerance: float = 1e-10,
        stages: tuple[str, ...] = STAGES,
        quick: bool = False,
        nearest: bool = True,
        contact_solver: str = "auto",
    ):
        unknown = set(stages) - set(STAGES)
        if unknown:
            raise ArgumentError(f"stages are among {STAGES}, got {sorted(unknown)}")
        self.tolerance = tolerance
        self.stages = stages
        self.quick = quick
        self.nearest = nearest
        self.choose(contact_solver)
        self.residual = 0.0
        self.jammed = False
        self.certificate: np.ndarray | None = None
        self.path_count = 0
        self._qp_before = 0
        self._spaces: dict[int, _Workspace] = {}
        self._space = self._workspace(1)

    def choose(self, contact_solver: str) -> None:
        """Solve what follows in the order of the stages ("auto"), or by ProxQP programs before them ("proxqp")."""
        check_contact_solver(contact_solver)
        self.programs_first = contact_solver == "proxqp"
        # what the kernel does, nothing where programs are first; the other stages are seen to here
        usual = USUAL + (NEAREST if self.nearest else 0) + (SWEEPING if self.stages[:1] == ("sweeps",) else 0)
        self.task = WARM if self.programs_first else usual

    @property
    def iterations(self) -> int:
        """Newton passes of the last call that was accepted or refused."""
        return int(self._space.counts[PASSES])

    @property
    def decided_by(self) -> str:
        """What decided the last problem that was solved."""
        code = self._space.counts[DECIDED]
        return DECIDERS[code] if code != UNDECIDED else ""

    @property
    def decided(self) -> dict[str, int]:
        """How many problems were decided by what."""
        total = map(sum, zip(*(space.counts[TIMES:].tolist() for space in self._spaces.values())))
        return {name: count for name, count in zip(DECIDERS, total) if name in ("warm", "exact", *self._order)}

    @property
    def polish_count(self) -> int:
        """How many warm starts were tried, those of single contacts from nothing included."""
        return sum(int(space.counts[TRIED]) for space in self._spaces.values())

    @property
    def _order(self) -> tuple[str, ...]:
        others = tuple(stage for stage in self.stages if stage != "qp")
        return ("qp", *others) if self.programs_first else self.stages

    @property
    def qp_count(self) -> int:
        """Programs that ProxQP was given."""
        return self._of_programs("programs")

    @property
    def qp_iterations(self) -> int:
        """Iterations that ProxQP took for them."""
        return self._of_programs("iterations")

    @property
    def qp_failures(self) -> int:
        """Problems whose programs led to no solution."""
        return self._of_programs("failures")

    def _of_programs(self, counter: str) -> int:
        return sum(getattr(space.programs, counter) for space in self._spaces.values() if space.programs is not None)

    def _workspace(self, contacts: int) -> _Workspace:
        space = self._spaces.get(contacts)
        if space is None:
            space = self._spaces[contacts] = _Workspace(contacts)
        self._space = space
        self.modes = space.modes
        self.forces = space.forces
        self.velocities = space.velocities
        return space

    def address(self, contacts: int) -> int:
        """The address of the `cone_workspace` for problems of this size, for kernels that call the solver."""
        return self._workspace(contacts).address

    def warm_start(self, modes: np.ndarray, forces: np.ndarray, velocities: np.ndarray) -> None:
        """Begin the next problem of this size from these modes (n,), forces and velocities (3n,) or (n, 3)."""
        space = self._space
        contacts = len(modes)
        if space.contacts != contacts:
            space = self._workspace(contacts)
        space.modes[:] = modes
        try:
            space.forces[:] = forces
            space.velocities[:] = velocities
        except ValueError:
            # rows (n, 3)
            space.forces[:] = forces.reshape(-1)
            space.velocities[:] = velocities.reshape(-1)
        space.counts[KNOWN] = 1

    def warm_starts(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """The last solution of every size, as `warm_start` takes it; views."""
        return [(space.modes, space.forces, space.velocities) for space in self._spaces.values() if space.counts[KNOWN]]

    def kept(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Modes, forces and velocities of the last problem, copies, as `warm_start` takes them."""
        return self.modes.copy(), self.forces.copy(), self.velocities.copy()

    def start(self, contacts: int) -> np.ndarray:
        """(3n,) a copy of the last forces of problems of this size, zero where there are none."""
        space = self._workspace(contacts)
        return space.forces.copy() if space.counts[KNOWN] else np.zeros(3 * contacts)

    def addresses(self) -> list[tuple[int, int]]:
        """(contacts, address of its `cone_workspace`) of every size of problem there has been."""
        return [(size, space.address) for size, space in self._spaces.items()]

    def forget(self) -> None:
        """Drop all warm starts."""
        for space in self._spaces.values():
            space.counts[KNOWN] = 0

    def renew(self) -> None:
        """Be as new, with the buffers that there are."""
        self.forget()
        self.residual, self.jammed, self.certificate = 0.0, False, None
        self.path_count = self._qp_before = 0
        for space in self._spaces.values():
            if space.programs is not None:
                space.programs.renew()
            space.counts[:] = 0
            space.counts[DECIDED] = UNDECIDED

    def solve(self, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray, afresh: bool = False) -> bool:
        """Solve one problem: delassus (3n, 3n) symmetric, b (3n,), mu (n,), C-contiguous float64. True if solved.

        afresh: of several solutions not the one nearest to the last, but what Newton's method finds from all at rest,
        else the path, which knows no order of contacts.
        """
        space = self._space
        if space.contacts != mu.shape[0]:
            space = self._workspace(mu.shape[0])
        task = USUAL + AFRESH if afresh and not self.programs_first else self.task
        self.residual = residual = solve_cones(delassus, b, mu, space.address, task, 0, self.tolerance, 0, 0)
        return residual <= self.tolerance or self.search(delassus, b, mu, afresh)

    def search(self, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray, afresh: bool = False) -> bool:
        """What `solve` does where the last modes and, if these come first, sweeps were of no use."""
        space = self._space
        if space.contacts != mu.shape[0]:
            space = self._workspace(mu.shape[0])
        self._qp_before = self.qp_count
        have_swept = bool(self.task & SWEEPING) and not afresh
        self.residual = swept = float(space.reached[0]) if have_swept else np.inf
        self.certificate = None
        self.jammed = False
        # sweeps take contacts in their order: last, and where the path runs away without a proof
        for stage in sorted(self._order, key="sweeps".__eq__) if afresh else self._order:
            if stage == "sweeps":
                if have_swept:
                    continue
                solved = self._sweep(space, delassus, b, mu, STRICTNESS * self.tolerance)
                swept = self.residual
            elif not (np.isfinite(delassus).all() and np.isfinite(b).all()):
                return False
            elif stage == "path":
                solved = self._follow(space, delassus, b, mu)
            else:
                solved = self._program(space, delassus, b, mu, afresh)
            if solved:
                space.decide(stage)
                return True
            if self.jammed and not (afresh and self.certificate is None):
                break
        if "sweeps" in self.stages and swept <= self.tolerance and self._sweep(space, delassus, b, mu, self.tolerance):
            # What they had found was good enough, if not as good as can be.
            space.decide("sweeps")
            return True
        if "path" in self.stages and not (self.quick or self.jammed) and self._soften(space, delassus, b, mu):
            space.decide("path")
            return True
        return False

    def _sweep(self, space: _Workspace, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray, tolerance: float) -> bool:
        """Modes from Gauss-Seidel sweeps, from the last forces if there are any."""
        if not space.counts[KNOWN]:
            space.forces[:] = 0.0
        sweeps = SWEEPS + SWEEPS_PER_CONTACT * space.contacts
        task = CLASSIFY_NEAR if self.nearest else CLASSIFY
        self.residual = solve_cones(
            delassus, b, mu, space.address, task, SWEEP_NEWTON_PASSES, tolerance, sweeps, SWEEP_ROUNDS
        )
        return self.residual <= tolerance

    def _newton(self, space: _Workspace, problem: tuple[np.ndarray, np.ndarray, np.ndarray], tolerance: float) -> bool:
        """Newton and judge from the workspace's forces; True if accepted."""
        residual = np.inf
        if np.isfinite(space.forces).all():
            residual = solve_cones(*problem, space.address, CLASSIFY, PATH_NEWTON_PASSES, tolerance, 0, 1)
        self.residual = residual if residual <= tolerance else min(self.residual, residual)
        return residual <= tolerance

    def _follow(self, space: _Workspace, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """Modes from the path, tried again and again on its way down, from one beginning after the other."""
        problem = delassus, b, mu
        before = space.forces.copy()
        steps = QUICK_PATH_STEPS if self.quick else PATH_STEPS
        escapes = 0
        for tube, size in PATH_STARTS[:1] if self.quick else PATH_STARTS:
            self.path_count += 1
            follow_path(*problem, space.address, 1.0, tube, size, 1.0, 0)
            good: np.ndarray | None = None
            for stop in PATH_STOPS:
                reached = follow_path(*problem, space.address, stop, tube, size, 1.0, steps)
                tried = space.forces.copy()
                least = self.residual
                self.residual = np.inf
                if self._newton(space, problem, STRICTNESS * self.tolerance):
                    return True
                if self.residual <= self.tolerance:
                    good = tried
                self.residual = min(self.residual, least)
                if not reached <= stop:
                    break
            if good is not None:
                # Nothing better than the tolerance asked for: an ill-conditioned problem.
                space.forces[:] = good
                if self._newton(space, problem, self.tolerance):
                    return True
            space.forces[:] = before
            if reached >= HUGE:
                escapes += 1
                if escapes == 1:
                    self.certificate = crushing_combination(delassus, b)
                self.jammed = self.certificate is not None or escapes == ESCAPES
                if self.jammed:
                    return False
        return False

    def _soften(self, space: _Workspace, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """Modes from the path of contacts with a trace of compliance: where the matrix is singular the path may lose
        itself in round-off."""
        before = space.modes.copy(), space.forces.copy(), space.velocities.copy()
        unit = np.diag(np.repeat(np.diag(delassus).reshape(-1, 3).mean(axis=1), 3))
        task = NEAR if self.nearest else WARM
        for share in COMPLIANCES:
            if self._follow(space, delassus + share * unit, b, mu):
                residual = solve_cones(delassus, b, mu, space.address, task, WARM_PASSES, self.tolerance, 0, 1)
                self.residual = residual
                if residual <= self.tolerance:
                    return True
            space.modes[:], space.forces[:], space.velocities[:] = before
            if self.jammed:
                break
        return False

    def _program(self, space: _Workspace, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray, afresh: bool) -> bool:
        """Modes from a sequence of ProxQP programs, from the last forces if these are to be kept to."""
        if self.quick and not self.programs_first:
            return False
        if space.programs is None:
            space.programs = ConePrograms(space.contacts)
        before = space.forces.copy()
        warm = bool(space.counts[KNOWN]) and self.programs_first and not afresh
        task = CLASSIFY_NEAR if self.nearest and not afresh else CLASSIFY

        def finish() -> bool:
            self.residual = solve_cones(
                delassus, b, mu, space.address, task, PROGRAM_NEWTON_PASSES, self.tolerance, 0, 1
            )
            return self.residual <= self.tolerance

        programs = QUICK_PROGRAMS if self.quick else PROGRAMS
        if space.programs.solve(delassus, b, mu, space.forces, warm, finish, programs):
            return True
        space.forces[:] = before
        return False

    def solution(self, mu: np.ndarray) -> ContactSolution:
        """The last problem's solution as a value of its own."""
        searched = self.programs_first or self._space.counts[DECIDED] >= BY_PATH
        return ContactSolution(
            forces=self.forces.reshape(-1, 3).copy(),
            velocities=self.velocities.reshape(-1, 3).copy(),
            modes=self.modes.copy(),
            residual=self.residual,
            iterations=self.iterations,
            qp_count=self.qp_count - self._qp_before if searched else 0,
            decided_by=self.decided_by,
            mu=np.array(mu, dtype=float),
        )


def check_contact_solver(contact_solver: str) -> None:
    """ArgumentError unless it is one of `CONTACT_SOLVERS`."""
    if contact_solver not in CONTACT_SOLVERS:
        raise ArgumentError(f"contact_solver must be one of {CONTACT_SOLVERS}, got {contact_solver!r}")


def solve_contacts(
    delassus: npt.ArrayLike,
    b: npt.ArrayLike,
    mu: npt.ArrayLike,
    warm: ContactSolution | None = None,
    tolerance: float = 1e-10,
    quick: bool = False,
    contact_solver: str = "auto",
) -> ContactSolution:
    """Forces F and u = G F + b of n contacts under Coulomb's law, exactly (Sec. 5.3; see `cone` for the statement).

    delassus:  (3n, 3n) Delassus matrix G, symmetric positive semidefinite; 1/kg; rows (t1, t2, n) per contact
    b:         (3n,) or (n, 3) relative accelerations in m/s^2 (or velocities in m/s) at zero contact force
    mu:        (n,) or one number: coefficients of friction; 0 is frictionless, inf never slips while it presses
    warm:      a solution of a similar problem with as many contacts, to start from
    tolerance: relative residual up to which a solution is accepted
    quick:     give up early where the cheap ways fail, for control loops; a few hard problems in a thousand are lost
    contact_solver: "auto", cheapest ways first, or "proxqp": a sequence of ProxQP programs before all others

    Where contacts are redundant the forces are one choice among several (see `centred_forces`); u is not affected.
    The same arguments give the same bits.

    Raises ArgumentError for wrong shapes, numbers that are not finite or a matrix that is not symmetric or has a
    negative diagonal; InfeasibleError where there provably is no solution; SolverError, with the residual, where none
    was found.
    """
    matrix, b, friction = _checked_problem(delassus, b, mu)
    contacts = len(friction)
    check_tolerance(tolerance)
    check_flag("quick", quick)
    check_contact_solver(contact_solver)
    if warm is not None and not isinstance(warm, ContactSolution):
        raise ArgumentError(f"warm must be a solution of solve_contacts, got {type(warm).__name__}")
    if warm is not None and warm.modes.shape[0] != contacts:
        raise ArgumentError(f"warm is a solution of {warm.modes.shape[0]} contacts, the problem has {contacts}")
    if contacts == 0:
        empty = np.zeros((0, 3))
        return ContactSolution(empty, empty.copy(), np.zeros(0, dtype=np.int64), 0.0, 0, 0, "exact", friction)

    solver = ContactSolver(tolerance, quick=quick, contact_solver=contact_solver)
    if warm is not None:
        solver.warm_start(warm.modes, warm.forces, warm.velocities)
    if solver.solve(matrix, b, friction):
        return solver.solution(friction)
    if solver.certificate is not None:
        pressed = np.flatnonzero(solver.certificate).tolist()
        raise InfeasibleError(
            f"contacts {pressed} of {contacts} approach each other and cannot give way to any normal forces",
            solver.certificate,
        )
    reason = " (they would have to be larger than any bound)" if solver.jammed else ""
    raise SolverError(
        f"no forces found that satisfy Coulomb's law at these {contacts} contacts{reason}: relative residual "
        f"{solver.residual:.3g}, tolerance {tolerance:.3g}"
    )


def centred_forces(
    delassus: npt.ArrayLike, b: npt.ArrayLike, mu: npt.ArrayLike, solution: ContactSolution
) -> ContactSolution:
    """The solution with other forces where sticking contacts are redundant: well inside their cones.

    delassus, b, mu: the problem, as for `solve_contacts`; solution: one of it.

    All that changes are the forces of the contacts at rest (u = 0), by combinations that move nothing (G dF = 0), so
    that the velocities stay. The new forces are the most central ones: they maximise the sum of log(mu^2 F_n^2 -
    |F_t|^2) less a linear term, which bounds what contacts that press against each other could add to themselves. They
    are unique, change smoothly with the problem, and hold on under changes that would take forces of least norm out of
    the cones. Where no forces lie inside the cones (all are about to slip) the solution is returned as it is.

    Raises ArgumentError for a problem that `solve_contacts` would refuse, or a solution of another size.
    """
    matrix, b, friction = _checked_problem(delassus, b, mu)
    contacts = len(friction)
    if not isinstance(solution, ContactSolution):
        raise ArgumentError(f"the solution must be one of solve_contacts, got {type(solution).__name__}")
    if solution.modes.shape[0] != contacts:
        raise ArgumentError(f"the solution has {solution.modes.shape[0]} contacts, the problem has {contacts}")
    # At rest counts, not the mode: a force of least norm on its cone's edge slips at zero speed, and a contact that
    # only just touches can take a load.
    terms = np.abs(b) + np.abs(matrix) @ np.abs(solution.forces.ravel())
    size = terms.reshape(-1, 3).max(axis=1)
    speed = np.abs(solution.velocities).max(axis=1)
    stuck = np.flatnonzero((speed <= AT_REST * np.maximum(size, AT_REST * size.max(initial=0.0))) & (friction > 0.0))
    if not stuck.size:
        return solution
    rows = (3 * stuck[:, None] + np.arange(3)).ravel()
    block = np.ascontiguousarray(matrix[np.ix_(rows, rows)])
    forces = solution.forces[stuck].ravel()
    limits = friction[stuck]
    space = cone_workspace(len(stuck))
    # The contacts keep still: u = 0 is b with the opposite of what the forces do. Without De Saxce's term, which is of
    # no account at rest, the problem is convex, and its path comes to the centre of all solutions.
    still = -(block @ forces)
    for tube in (0.01, 0.002, 0.0002):
        follow_path(block, still, limits, space.address, 1.0, tube, 1.0, 0.0, 0)
        follow_path(block, still, limits, space.address, 1e3 * CENTRE, tube, 1.0, 0.0, PATH_STEPS)
        # The last stretch in a narrow tube: the centre is only as exact as that.
        if follow_path(block, still, limits, space.address, CENTRE, 1e-6, 1.0, 0.0, PATH_STEPS) <= CENTRE:
            break
    else:
        return solution
    centred = space.forces.copy()
    # To round-off: the least change that makes up for the rest of t.
    scale = np.repeat(np.sqrt(3.0 / np.maximum(np.diagonal(block).reshape(-1, 3).sum(axis=1), TINY)), 3)
    values, vectors = np.linalg.eigh(scale[:, None] * block * scale)
    kept = values > RANK_TOLERANCE * values[-1]
    for _ in range(2):
        missing = scale * (block @ (forces - centred))
        centred += scale * (vectors[:, kept] @ ((vectors[:, kept].T @ missing) / values[kept]))
    inside = np.hypot(centred[::3], centred[1::3]) < limits * centred[2::3]
    off = np.abs(block @ (centred - forces))
    if not (inside.all() and (off <= 1e-3 * AT_REST * terms[rows].max()).all()):
        return solution
    moved, modes = solution.forces.copy(), solution.modes.copy()
    moved[stuck], modes[stuck] = centred.reshape(-1, 3), STICK
    velocities = (matrix @ moved.ravel() + b).reshape(-1, 3)
    return replace(solution, forces=moved, velocities=velocities, modes=modes)


def _checked_problem(
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
