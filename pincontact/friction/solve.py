"""The contact problem with Coulomb friction: who sticks, slips and separates, and the forces (Sec. 5.3).

What has to be found is the modes; whatever suggests them, `newton` computes the forces and the residual of the
natural map (`cone`) accepts or refuses them. The suggestions come from, cheapest first,

    warm    the modes and forces of the last solution: redundant forces that have left their cones are moved into them
    sweeps  projected Gauss-Seidel: a few passes over the last forces, and more if these do not do; redundant forces as
            before
    path    a homotopy (`homotopy`), which finds a solution unless the forces on it grow without bound
    qp      a sequence of ProxQP programs (`proxqp`); before all others where the caller asks for it

The first two are one call of compiled code (`starts`), which other kernels can make, too. A single contact needs no
search: all of its states can be tried (`exact`). The same problem and warm start give the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arguments import check_flag, check_tolerance
from ..display import Summary
from ..errors import ArgumentError, InfeasibleError, SolverError
from ..workspace import Workspace
from .cone import (
    BY_HOMOTOPY,
    DECIDED,
    DECIDERS,
    HUGE,
    KNOWN,
    OPEN,
    OWNERS,
    PASSES,
    RANK_TOLERANCE,
    SLIP,
    STICK,
    TIMES,
    UNDECIDED,
    cone_workspace,
)
from .feasibility import crushing_combination
from .homotopy import follow_homotopy
from .problem import checked_problem
from .proxqp import PROGRAMS, ConePrograms
from .starts import (
    AFRESH,
    CLASSIFY,
    GAUSS_SEIDEL,
    NEAREST,
    NOTHING,
    STRICTNESS,
    USUAL,
    solve_cones,
)

__all__ = ["OPEN", "SLIP", "STICK", "ContactSolution", "ContactSolver", "solve_contacts"]

# Values of t at which the path's forces are tried.
HOMOTOPY_STOPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-9, 1e-11, 1e-13)
# Width of the tube round the path, and size of b against the path's beginning, in the order they are tried.
HOMOTOPY_STARTS = (
    (0.01, 1.0), (0.002, 1.0), (0.01, 0.1), (0.01, 100.0), (0.01, 0.01), (0.01, 10.0), (0.002, 0.1), (0.0002, 1.0),
    (0.002, 0.01), (0.002, 100.0),
)  # fmt: skip
# A path on which the forces grow without bound shows that no forces make the contacts give way; this many, from
# different beginnings, end the search.
ESCAPES = 2
# Steps to a stop; a stop takes ten as a rule.
HOMOTOPY_STEPS = 500
QUICK_HOMOTOPY_STEPS = 20
# Programs per beginning where the search is to be quick: 99 problems in 100 need no more.
QUICK_PROGRAMS = 10
STAGES = ("sweeps", "path", "qp")
CONTACT_SOLVERS = ("auto", "proxqp")
# Delassus matrix, b and mu.
_Problem = tuple[np.ndarray, np.ndarray, np.ndarray]
# Counts of ProxQP where it had nothing to do.
NO_PROGRAMS = {"qp": 0, "qp_iterations": 0, "qp_failures": 0}


@dataclass(frozen=True, repr=False)
class ContactSolution(Summary):
    """Forces and relative velocities of n contacts that obey Coulomb's law; rows are (t1, t2, n).

    Attributes
    ----------
    forces : (n, 3) array
        In N, or in N s if b was a velocity.
    velocities : (n, 3) array
        u = G F + b in m/s^2, or in m/s.
    modes : (n,) array of int
        OPEN (0), STICK (1) or SLIP (2).
    residual : float
        Relative residual of the natural map, without units.
    iterations : int
        Newton iterations of the start that was accepted.
    qp_count : int
        Programs that ProxQP was given.
    decided_by : str
        What found the modes: "warm" (the last solution), "exact" (all states of a single contact), "sweeps" (projected
        Gauss-Seidel), "path" (homotopy) or "qp" (ProxQP).
    mu : (n,) array
        The coefficients.
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
    quick:     gives up early: one path is followed, with few steps, and ProxQP has to be chosen
    nearest:   redundant forces may be the ones nearest to the last, or to what Gauss-Seidel has found, where those of
               least norm leave their cones; else other modes are looked for, and what slides has loads that do not
               depend on the past

    contact_solver: see `choose`

    Counters: program_counts, and decided (by stage).
    Kernels call `starts.solve_cones` with `address(n)` and `task` themselves; `search` goes on where that failed.
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
        self.tolerance = tolerance
        self.stages = stages
        self.quick = quick
        self.nearest = nearest
        self.choose(contact_solver)
        self.residual = 0.0
        self.jammed = False
        self.certificate: np.ndarray | None = None
        self._qp_before = 0
        # by the number of contacts
        self._spaces: dict[int, Workspace] = {}
        self._sequences: dict[int, ConePrograms] = {}
        self._space = self._workspace(1)

    def choose(self, contact_solver: str) -> None:
        """Solve what follows in the order of the stages ("auto"), or by ProxQP programs before them ("proxqp")."""
        check_contact_solver(contact_solver)
        self.programs_first = contact_solver == "proxqp"
        # what the kernel does, nothing where programs are first; the other stages are seen to here
        usual = USUAL + (NEAREST if self.nearest else 0) + (GAUSS_SEIDEL if self.stages[:1] == ("sweeps",) else 0)
        self.task = NOTHING if self.programs_first else usual

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
        return dict(zip(DECIDERS, total))

    @property
    def program_counts(self) -> dict[str, int]:
        """What ProxQP did, as `Trajectory.stats` has it: programs, their iterations, and problems that they left."""
        counts = [programs.counts for programs in self._sequences.values()]
        return {name: sum(found) for name, found in zip(NO_PROGRAMS, zip(*counts))} if counts else dict(NO_PROGRAMS)

    @property
    def qp_count(self) -> int:
        """Programs that ProxQP was given."""
        return self.program_counts["qp"]

    def _workspace(self, contacts: int) -> Workspace:
        space = self._spaces.get(contacts)
        if space is None:
            space = self._spaces[contacts] = cone_workspace(contacts)
        self._space = space
        self.modes = space.modes
        self.forces = space.forces
        self.velocities = space.velocities
        return space

    def address(self, contacts: int) -> int:
        """The address of the `cone_workspace` for problems of this size, for kernels that call the solver."""
        return self._workspace(contacts).address

    def warm_start(
        self, modes: np.ndarray, forces: np.ndarray, velocities: np.ndarray, owners: int | None = None
    ) -> None:
        """Begin the next problem of this size from these modes (n,), forces and velocities (3n,) or (n, 3); owners:
        whose they are, for callers that tell problems apart, None for those of the last problem."""
        space = self._workspace(len(modes))
        space.modes[:] = modes
        try:
            space.forces[:] = forces
            space.velocities[:] = velocities
        except ValueError:
            # rows (n, 3)
            space.forces[:] = forces.reshape(-1)
            space.velocities[:] = velocities.reshape(-1)
        space.counts[KNOWN] = 1
        if owners is not None:
            space.counts[OWNERS] = owners

    def warm_starts(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, int]]:
        """The last solution of every size, as `warm_start` takes it; copies."""
        return [
            (space.modes.copy(), space.forces.copy(), space.velocities.copy(), int(space.counts[OWNERS]))
            for space in self._spaces.values()
            if space.counts[KNOWN]
        ]

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
        self._qp_before = 0
        for programs in self._sequences.values():
            programs.renew()
        for space in self._spaces.values():
            space.counts[:] = 0
            space.counts[DECIDED] = UNDECIDED

    def solve(self, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray, afresh: bool = False) -> bool:
        """Solve one problem: delassus (3n, 3n) symmetric, b (3n,), mu (n,), C-contiguous float64. True if solved.

        afresh: of several solutions not the one nearest to the last, but what Newton's method finds from all at rest,
        else the path, which knows no order of contacts.
        """
        space = self._workspace(mu.shape[0])
        task = USUAL + AFRESH if afresh and not self.programs_first else self.task
        self.residual = residual = solve_cones(delassus, b, mu, space.address, task, self.tolerance)
        return residual <= self.tolerance or self.search(delassus, b, mu, afresh)

    def search(self, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray, afresh: bool = False) -> bool:
        """The solvers beyond the kernel's, one after the other: what `solve` does where its starts have failed.

        Stages are tried in their order until one's modes are accepted, cheapest first: projected Gauss-Seidel, the
        homotopy, programs of ProxQP; these come first where they are chosen. Gauss-Seidel depends on the order of
        contacts; afresh puts it last, and lets it try where the forces of the homotopy grow without bound but no
        certificate proves that there are none.
        """
        space = self._workspace(mu.shape[0])
        problem = delassus, b, mu
        self._qp_before = self.qp_count
        self.certificate, self.jammed = None, False
        tried_already = self.task != NOTHING and bool(self.task & GAUSS_SEIDEL) and not afresh
        self.residual = float(space.reached[0]) if tried_already else np.inf
        stages = sorted(self.stages, key="sweeps".__eq__) if afresh else self.stages
        for stage in sorted(stages, key="qp".__ne__) if self.programs_first else stages:
            if stage == "sweeps":
                solved = not tried_already and self._gauss_seidel(problem)
            elif not (np.isfinite(delassus).all() and np.isfinite(b).all()):
                return False
            else:
                solved = self._homotopy(problem) if stage == "path" else self._programs(problem, afresh)
            if solved:
                self._decide(stage)
                return True
            if self.jammed and not (afresh and self.certificate is None):
                return False
        return False

    def _decide(self, stage: str) -> None:
        """Count a problem that a stage outside of the kernel has solved."""
        code, counts = DECIDERS.index(stage), self._space.counts
        counts[KNOWN], counts[DECIDED] = 1, code
        counts[TIMES + code] += 1

    def _start(self, problem: _Problem, task: int, tolerance: float) -> float:
        """Start from what the workspace holds, see `solve_cones`; the residual, of which the least is kept."""
        found: float = solve_cones(*problem, self._space.address, task, tolerance)
        self.residual = found if found <= tolerance else min(found, self.residual)
        return found

    def _gauss_seidel(self, problem: _Problem) -> bool:
        """Modes from projected Gauss-Seidel, from the last forces if there are any."""
        space, tolerance = self._space, STRICTNESS * self.tolerance
        if not space.counts[KNOWN]:
            space.forces[:] = 0.0
        task = CLASSIFY + GAUSS_SEIDEL + (NEAREST if self.nearest else 0)
        return self._start(problem, task, tolerance) <= tolerance

    def _newton(self, problem: _Problem, tolerance: float) -> float:
        """The residual that Newton's method comes to from the workspace's forces."""
        if not np.isfinite(self._space.forces).all():
            return np.inf
        return self._start(problem, CLASSIFY, tolerance)

    def _homotopy(self, problem: _Problem) -> bool:
        """Modes from the homotopy, tried again and again on its way down, from one beginning after the other."""
        forces, address, strict = self._space.forces, self._space.address, STRICTNESS * self.tolerance
        before, escapes = forces.copy(), 0
        steps = QUICK_HOMOTOPY_STEPS if self.quick else HOMOTOPY_STEPS
        for tube, size in HOMOTOPY_STARTS[:1] if self.quick else HOMOTOPY_STARTS:
            follow_homotopy(*problem, address, 1.0, tube, size, 0)
            good: np.ndarray | None = None
            for stop in HOMOTOPY_STOPS:
                reached = follow_homotopy(*problem, address, stop, tube, size, steps)
                tried = forces.copy()
                residual = self._newton(problem, strict)
                if residual <= strict:
                    return True
                if residual <= self.tolerance:
                    good = tried
                if not reached <= stop:
                    break
            if good is not None:
                # Nothing better than the tolerance asked for: an ill-conditioned problem.
                forces[:] = good
                self._newton(problem, self.tolerance)
                return True
            forces[:] = before
            if reached >= HUGE:
                escapes += 1
                if escapes == 1:
                    self.certificate = crushing_combination(*problem[:2])
                self.jammed = self.certificate is not None or escapes == ESCAPES
                if self.jammed:
                    return False
        return False

    def _programs(self, problem: _Problem, afresh: bool) -> bool:
        """Modes from a sequence of ProxQP programs, from the last forces if these are to be kept to."""
        if self.quick and not self.programs_first:
            return False
        (delassus, b, mu), space = problem, self._space
        contacts = space.modes.size
        if contacts not in self._sequences:
            self._sequences[contacts] = ConePrograms(contacts)
        before = self.kept()
        warm = afresh or bool(space.counts[KNOWN])
        if afresh:
            # as Newton's method does: from the least forces of all at rest
            trace = delassus.diagonal().reshape(-1, 3).sum(axis=1)
            scale = np.repeat(np.sqrt(3.0 / np.where(trace > 0.0, trace, 3.0)), 3)
            operator = scale[:, None] * delassus * scale
            space.forces[:] = scale * np.linalg.lstsq(operator, -scale * b, rcond=RANK_TOLERANCE)[0]
        task = CLASSIFY + (NEAREST if self.nearest and not afresh else 0)

        def finish() -> bool:
            return self._start(problem, task, self.tolerance) <= self.tolerance

        programs = QUICK_PROGRAMS if self.quick else PROGRAMS
        if self._sequences[contacts].solve(delassus, b, mu, space.forces, warm, finish, programs):
            return True
        space.modes[:], space.forces[:], space.velocities[:] = before
        return False

    def solution(self, mu: np.ndarray) -> ContactSolution:
        """The last problem's solution as a value of its own."""
        searched = self.programs_first or self._space.counts[DECIDED] >= BY_HOMOTOPY
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
    if not isinstance(contact_solver, str) or contact_solver not in CONTACT_SOLVERS:
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
    """Forces F and u = G F + b of n contacts under Coulomb's law, exactly (Sec. 5.3).

    Where contacts are redundant the forces are one choice among several (see `centred_forces`); u is not affected.
    The same arguments give the same bits.

    Parameters
    ----------
    delassus : (3n, 3n) array_like
        Delassus matrix G in 1/kg, symmetric positive semidefinite; rows (t1, t2, n) of each contact.
    b : (3n,) or (n, 3) array_like
        Relative accelerations in m/s^2 (or velocities in m/s) at zero contact force.
    mu : (n,) array_like or float
        Coefficients of friction; 0 is frictionless, inf never slips while it presses.
    warm : ContactSolution, optional
        A solution of a similar problem with as many contacts, to start from.
    tolerance : float
        Relative residual up to which a solution is accepted.
    quick : bool
        Give up early where the cheap ways fail, for control loops; a few hard problems in a thousand are lost.
    contact_solver : {"auto", "proxqp"}
        "auto": cheapest ways first. "proxqp": a sequence of ProxQP programs before all others.

    Returns
    -------
    ContactSolution

    Raises
    ------
    ArgumentError
        For wrong shapes, numbers that are not finite, a matrix that is not symmetric or has a negative diagonal, or
        another contact_solver.
    InfeasibleError
        Where there provably is no solution.
    SolverError
        Where none was found, with the residual.

    Examples
    --------
    A body of 2 kg that rests on a plane and is pushed sideways by less than its friction allows:

    >>> import numpy as np
    >>> import pincontact as pc
    >>> solution = pc.solve_contacts(np.eye(3) / 2.0, [1.0, 0.5, -9.81], mu=0.5)
    >>> solution.forces.round(6).tolist()
    [[-2.0, -1.0, 19.62]]
    """
    matrix, b, friction = checked_problem(delassus, b, mu)
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
