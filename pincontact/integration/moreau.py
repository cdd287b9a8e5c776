"""Time stepping with impulses (Moreau's midpoint method): for many contacts, impacts, accumulating bounces and jams.

Every step solves one cone problem in velocities and impulses, whatever happens within it; nothing is located and no
mode is kept. Second order in h while modes last, first order through their changes; see `impulses` for the equations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..callback import kernel_address
from ..friction.starts import solve_cones
from ..geometry.chart_changes import move_charts
from ..jit import compile_kernels
from ..layout import (
    CHART,
    CONDITION,
    CONTACT_INTS,
    DOMAIN,
    FREE,
    LOCATION_FAILED,
    NO_FORCE,
    OK,
    SINGULAR,
    TOO_LONG,
    UNILATERAL,
    VISCOUS,
)
from .contradictions import apart, contradiction, crushed
from .impulse_cones import ImpulseSolver
from .impulse_layout import DRY_FRICTION, LOWER_LIMIT, ON_JOINT, UPPER_LIMIT, step_workspace
from .impulse_problem import assemble
from .impulse_steps import ACCEPT, BEGIN, GOING_ON, INTEGRATE, RELOCATE, STEP, TRY, run_steps
from .impulse_trial import APPROVED, CONE_LEFT, FRESH, SOLVED, TAKEN, UNSOLVED, WITH_ROOM
from .open_contacts import MANY_STEPS, OpenContacts
from .reports import least_conditioned
from .results import (
    CLOSED_APART,
    CONTOUR_ENDS,
    CONTRADICTION,
    FAILURES,
    FLIES_THROUGH,
    LEAPT,
    MOTION_JUMPS,
    OFF_BALANCE,
    OVERLAPS_AT_END,
    TOUCHES_AROUND,
    TOUCHES_TWICE,
    Stop,
)
from .run_system import RunSystem
from .steps import run_task

if TYPE_CHECKING:
    from ..contacts import Contact
    from ..dynamics.joints import JointLimit
    from ..dynamics.system import Torque
    from .actuators import Actuator

# Step in s where none is given: impacts and stick-slip of bodies of some cm to m are resolved.
DEFAULT_STEP = 1e-3

# Motion in one step (rad or m) from which on a failure is put down to steps that are too long.
_RUNAWAY = 10.0
# Motion in one step (rad or m) below which no body has turned far in it.
_TURNS_FAR = 0.3

# Parts, by halves, into which a step is divided at most.
_MOST_PARTS = 256
# What fails so is divided: contacts are not where they go in the step.
_DIVIDED = LEAPT, LOCATION_FAILED, OFF_BALANCE

# Kernels that steps call by address.
_CALLED = {"run_task": run_task, "solve_cones": solve_cones, "assemble": assemble, "move_charts": move_charts}
# Arrays of a step that are not of its state: addresses, and what there is within a call only.
_OWN = ("calls", "cone_tables", "rows_tau", "rows_target", "rows_q", "rows_v")
# Arrays of the system that are of the state.
_OF_SYSTEM = ("state", "stage_state", "q", "v", "tau", "location", "contact_int", "contact_real")

# Rows of a rollout, up to which their room is kept for the next one.
_ROWS_KEPT = 10_000


def joint_constraints(limits: Sequence[JointLimit]) -> list[tuple[int, int, int, int, float, float]]:
    """Position limits and dry friction of joints, as records `impulse_layout.JOINT`."""
    found = []
    for g, joint_limit in enumerate(limits):
        place = joint_limit.index_q, joint_limit.index_v, g
        if joint_limit.dry:
            half, middle = (
                0.5 * (joint_limit.high_force - joint_limit.low_force),
                0.5 * (joint_limit.high_force + joint_limit.low_force),
            )
            found.append((DRY_FRICTION, *place, half, middle))
        for kind, limit in ((LOWER_LIMIT, joint_limit.low_end), (UPPER_LIMIT, joint_limit.high_end)):
            if math.isfinite(limit):
                found.append((kind, *place, limit, 0.0))
    return found


class _Rows:
    """Rows of torques, targets, q and v, and where they are: to ask for an address takes as long as to copy many
    rows."""

    def __init__(self, n: int, nq: int, nv: int) -> None:
        self.tau, self.target, self.q, self.v = (np.empty((n, columns)) for columns in (nv, nq, nq, nv))
        self.arrays = {"rows_tau": self.tau, "rows_target": self.target, "rows_q": self.q, "rows_v": self.v}


class MoreauStep:
    """One system, with all limits and dry frictions of its joints, that goes forward by steps of Moreau's method.

    The state at the step's start is `system.state`; `try_step` leaves the new one in `system.stage_state`, and may be
    called again with another size; `accept` makes it the start. Arrays (views, world axes, one row a contact):
    forces (nc, 3): mean force over the last step on the contour named second, N; torques (nc, 3): what resisted its
    spinning and rolling, N m;
    touch_time, edge_time (nc,): s after the step's start at which a contact closed, or opened at the end of a contour,
    negative where it did not; start_mode (nc,): modes at its start; start_gap, start_domain (nc,): gaps in m,
    and ways to the nearest end of the contours' domains, at the start of the next one; start_motion, motion (nc, 3):
    what resisted motions did at its start and do after it, see `impulse_layout.SLIP`; start_joint, joint_state,
    limit_time (ng,): what limited coordinates did at the start and do after the last step, see
    `impulse_layout.JOINT_MOVES`, and when one came to an end of its way. apart: closed contacts that were
    apart when the motion began, and by how many metres; open: what is known of open ones.
    """

    def __init__(self, system: RunSystem, contacts: Sequence[Contact]) -> None:
        # these kernels are compiled for those who use them
        compile_kernels(several=True, stepping=True)
        self.system = system
        self._viscous = bool((system.contact_real[: system.nc, VISCOUS] > 0.0).any())
        joints = joint_constraints(system.limits)
        laws = [contact.friction for contact in contacts if contact.friction is not None]
        turns = sum((law.spinning > 0.0) + (law.rolling > 0.0) for law in laws)
        self.resists_turning = turns > 0
        # whether forces act on joints that are neither torques nor contact forces
        self.acts_on_joints = bool(joints) or self.resists_turning
        self.step_arrays = arrays = step_workspace(
            system.nq, system.nv, system.nc, system.ng, len(joints), turns, int(system.sizes["nblocks"])
        )
        if joints:
            arrays.joints[:] = joints
        for c, contact in enumerate(contacts):
            arrays.restitution[c] = contact.restitution
            arrays.sticking[c] = 0.0 if contact.friction is None else contact.friction.sticking
            arrays.orientation[c] = -1.0 if contact.swapped else 1.0
        nc = system.nc
        self.forces, self.torques, self.start_mode = arrays.forces[:nc], arrays.torques[:nc], arrays.start_mode[:nc]
        self.start_gap, self.start_domain = arrays.start_gap[:nc], arrays.start_domain[:nc]
        self.start_motion, self.motion = arrays.start_motion[:nc], arrays.motion[:nc]
        self.touch_time, self.edge_time = arrays.touch_time[:nc], arrays.edge_time[:nc]
        ng = system.ng
        self.start_joint, self.joint_state = arrays.start_joint[:ng], arrays.joint_state[:ng]
        self.limit_time = arrays.limit_time[:ng]
        self._joint_impulse = arrays.joint_impulse[: system.nv]
        # what is told of a step, and how much of it comes from one of its halves
        self._shares = (self.forces, 0.5), (self.torques, 0.5), (self._joint_impulse, 1.0)
        self._counts, self._numbers = arrays.counts, arrays.numbers
        # views of what every step of a `Stepper` asks for: a record takes twenty times as long to read
        fields = np.asarray(arrays.counts)
        self._steps, self._last, self._changed = fields["steps"], fields["last"], fields["changed"]
        self._rows: _Rows | None = None
        for name, entry in _CALLED.items():
            arrays.calls[name] = kernel_address(entry)
        arrays.calls["call_failed"] = id(False)
        self.cones = ImpulseSolver(arrays)
        arrays.keep()
        self._begin_anew()
        # into how many parts the present step is divided
        self.parts = 1
        # whether steps have to stop for a look at open contacts, from any start and from the present one
        self._always_looks = self._looks = self.open.watches()

    def _begin_anew(self) -> None:
        system = self.system
        self.cones.begin()
        self.open = OpenContacts(system)
        self._asked: tuple[Callable[[], bool], tuple[()], Torque] | None = None
        if self._viscous:
            # the mass matrix with viscous friction couples branches of the tree
            system.set_tree(range(-1, system.nv - 1))

    def renew(self) -> None:
        """Be as new, for a system that is as new: buffers are kept, nothing in them matters."""
        self.step_arrays.restore()
        self.cones.solver.renew()
        self._begin_anew()

    # ---------------------------------------------------------------- steps

    def ask(self, torque: Torque | None) -> None:
        """Set the function that sets `system.tau` for the system's (q, v) at the middle of every step, and for every
        output. None for constant torques."""
        # kept alive here: the kernels know the addresses only
        self._asked = None
        calls = self.step_arrays.calls
        calls["asked"] = calls["asked_with"] = calls["control"] = 0
        if torque is None:
            return
        self.system.asks = True
        self._asked = self.system.callback_of(torque.ask), (), torque
        calls["asked"], calls["asked_with"] = map(id, self._asked[:2])
        calls["control"] = torque.address

    def _run(self, task: int, t: float = 0.0, h: float = 0.0, found: int = FRESH) -> int:
        """A task of `run_steps`, with the cone problems that it leaves. Raises what `System.check_callbacks` does."""
        result = run_steps(self.system.address, self.step_arrays.address, task, found, t, h)
        while result == CONE_LEFT:
            if self.cones.makes_room():
                solved = WITH_ROOM
            else:
                solved = SOLVED if self.cones.solve() else UNSOLVED
            result = run_steps(self.system.address, self.step_arrays.address, task, solved, t, h)
        if self.system.asks:
            self.system.check_callbacks()
        return result

    def begin(self, t: float) -> int:
        """Start from `system.state`; closed contacts get the mode that their v_c shows. Returns a status; sets
        `apart`."""
        self.open.forget_way()
        # contact problems leave open what constraints that are next to redundant would turn into much more
        self.system.counters["redundant"] = 1
        closed = self.system.closed()
        self._looks = self._always_looks or bool(self.open.at_ends())
        status = self._run(BEGIN, t)
        self.apart = apart(self.system, closed) if status == OK else {}
        return status

    def try_step(self, t: float, h: float) -> int:
        """A step of size h from the start at t; returns a status of `layout`."""
        return self._run(TRY, t, h)

    def foresee(self, t: float, h: float) -> None:
        """Know the forces of a step of size h from the start at t as those of the last step; before any step."""
        kept = self.kept()
        status = self.try_step(t, h)
        means = [(of, of.copy()) for of, _ in self._shares]
        self.restore(kept)
        # nothing has been solved, and nothing is known to start from
        self.cones.solver.renew()
        self.cones.begin()
        if status == OK:
            self._numbers["h"] = h
            for of, mean in means:
                of[:] = mean

    def accept(self, t: float) -> None:
        """The state after the trial step becomes the start; t is its time."""
        self._run(ACCEPT, t)

    def set_run(self, start: float, end: float, size: float, count: int, limit: int, watched: bool) -> None:
        """What `advance` and `integrate` go by: count steps of a size in s, the last of which ends at the end, but not
        more than the limit; watched: every step is looked at before it is accepted."""
        numbers, counts = self._numbers, self._counts
        numbers["run_start"], numbers["run_end"], numbers["step_size"] = start, end, size
        counts["steps"], counts["last"], counts["step_limit"] = 0, count, limit
        counts["watched"], counts["turns"] = watched, self.resists_turning

    def integrate(self, most: int, ahead: int, approved: bool) -> int:
        """Steps and outputs until something is to be done here: see `run_steps`. It stops after `most` steps of the
        run, and after so many from here; approved: beginning with the trial step."""
        self._counts["step_limit"] = min(most, self.steps + ahead)
        return self._run(INTEGRATE, found=APPROVED if approved else FRESH)

    def advance(self, count: int) -> int:
        """So many steps of the run, accepted; returns a status of `layout`: where that is not OK, of the step after the
        last accepted one."""
        last = self.steps + count
        self._last[()] = last
        status = GOING_ON
        while status == GOING_ON or self.steps < last:
            if self._looks:
                # what opens in a step is looked at before the next one
                steps = self.look()
                if steps == 0:
                    return self.trouble
                if FREE not in self.system.modes.tolist():
                    steps = 1
                self._last[()] = min(last, self.steps + steps)
            status = self._run(STEP)
            if status in _DIVIDED:
                t = self._numbers["run_start"].item() + self.steps * self._numbers["step_size"].item()
                status = self._take_parts(t) if self.divides(status, t) else status
                if status == OK:
                    status = self._run(STEP, found=TAKEN)
            if status not in (OK, GOING_ON):
                break
        return status

    def divides(self, status: int, t: float) -> bool:
        """Whether the step from t that failed so is to be made in shorter ones, from the state at its start, which is
        evaluated then: contacts were not followed on its way."""
        if status not in _DIVIDED or self.parts == _MOST_PARTS:
            return False
        integers, charts = self.known
        nc = self.system.nc
        self.system.contact_int[:nc, :CONTACT_INTS] = integers
        self.system.side_int[: 2 * nc, CHART] = charts.ravel()
        self.touch_time[:] = -1.0
        return self._run(RELOCATE, t) == OK

    def _take_parts(self, start: float) -> int:
        """Go the way of the next step, from `start`, by steps of half its size, of which it has the mean forces; a
        status."""
        counts, numbers = self._counts, self._numbers
        names = ("steps", "last", "step_limit", "row_count"), ("run_start", "run_end", "step_size")
        kept = [{name: of[name].item() for name in fields} for of, fields in zip((counts, numbers), names)]
        size = numbers["step_size"].item()
        means = [(of, share, np.zeros_like(of)) for of, share in self._shares]
        self.set_run(start, start + size, 0.5 * size, 2, 2, False)
        counts["row_count"], self.parts = 0, 2 * self.parts
        try:
            for _ in range(2):
                if (status := self.advance(1)) != OK:
                    break
                for of, share, mean in means:
                    mean += share * of
        finally:
            self.parts //= 2
            for of, values in zip((counts, numbers), kept):
                for name, value in values.items():
                    of[name] = value
        if status == OK:
            numbers["h"] = size
            for of, _, mean in means:
                of[:] = mean
        return status

    def actuate(self, actuators: Sequence[Actuator]) -> None:
        """Have these PD actuators, and no others, from the next step on; they aim at `target`."""
        arrays, n = self.step_arrays, len(actuators)
        arrays.actuation[:] = 0.0
        if n:
            arrays.actuators[:n] = actuators
        self._counts["actuators"] = n

    @property
    def target(self) -> np.ndarray:
        """(nq,) configuration at which the actuators aim; a view that may be written to."""
        target: np.ndarray = self.step_arrays.target[: self.system.nq]
        return target

    def advance_by_rows(
        self, tau: np.ndarray, count: int, targets: np.ndarray | None = None
    ) -> tuple[int, np.ndarray, np.ndarray]:
        """So many steps under the torques in each row of tau (n, nv), n at least 1, with the target in the same row of
        targets (n, nq), where these are given; returns a status as `advance` does, and q (m, nq) and v (m, nv) after
        every row that was finished."""
        system, counts, n = self.system, self._counts, len(tau)
        rows = self._rows
        if rows is None or n > len(rows.q):
            rows = _Rows(n, system.nq, system.nv)
            self._rows = rows if n <= _ROWS_KEPT else None
        if self._looks:
            return self._advance_row_by_row(tau, count, targets, rows)
        rows.tau[:n] = tau
        if targets is not None:
            rows.target[:n], self.target[:] = targets, targets[0]
        for name, array in rows.arrays.items():
            self.step_arrays.put(name, array)
        counts["row_count"], counts["rows_done"], counts["row_steps"] = n, 0, count
        counts["targeted"] = targets is not None
        system.tau[:] = tau[0]
        try:
            status = self.advance(count)
        finally:
            counts["row_count"] = 0
        done = counts["rows_done"].item()
        return status, rows.q[:done].copy(), rows.v[:done].copy()

    def _advance_row_by_row(
        self, tau: np.ndarray, count: int, targets: np.ndarray | None, rows: _Rows
    ) -> tuple[int, np.ndarray, np.ndarray]:
        """`advance_by_rows` with looks at open contacts in between."""
        nq, nv = self.system.nq, self.system.nv
        status, done = OK, 0
        for i, row in enumerate(tau):
            self.system.tau[:] = row
            if targets is not None:
                self.target[:] = targets[i]
            status = self.advance(count)
            if status != OK:
                break
            rows.q[done], rows.v[done] = self.system.state[:nq], self.system.state[nq : nq + nv]
            done += 1
        return status, rows.q[:done].copy(), rows.v[:done].copy()

    # ---------------------------------------------------------------- open contacts

    def look(self) -> int:
        """How many steps of the run may be taken before the next look at what bodies may touch: all, where that is
        nothing; none, where they cannot go on, see `trouble`."""
        size = self._numbers["step_size"].item()
        t = self._numbers["run_start"].item() + self.steps * size
        if not (self._looks and self.open.are_any(t)):
            return MANY_STEPS
        behind = self.step_arrays.behind
        self._note_apart()
        self.open.watch_ends(t, size)
        if self.open.relocated:
            self.open.relocated.clear()
            self._run(RELOCATE, t)
            self._note_apart()
        steps = self.open.look(t, size, self.touch_time >= 0.0)
        if self.open.relocated:
            relocated = list(self.open.relocated)
            self.open.relocated.clear()
            self._run(RELOCATE, t)
            # these have been looked for there: they have not leapt
            behind[relocated] = ~self.open.apart[relocated]
        return steps

    def _note_apart(self) -> None:
        """Note which contacts touch when their gaps come down through zero."""
        beside = (self.start_domain < 0.0) & (self.start_gap < 0.0)
        self.open.apart[:] = (self.step_arrays.behind[: self.system.nc] == 0) & ~beside

    def follow(self, t: float) -> None:
        """Look at t, the start of the next step, whether open contacts are where they are nearest."""
        if self._looks and FREE in self.system.modes.tolist() and self.open.follow(t):
            self._run(RELOCATE, t)

    def goes_wrong(self, t: float) -> bool:
        """Whether the last step, which ended at t, carried bodies through what was near, or into it, see `trouble`."""
        return self._looks and self.open.goes_wrong(t, self.size, self.touch_time >= 0.0)

    @property
    def trouble(self) -> int:
        """Why steps cannot go on."""
        return self.open.trouble

    # ---------------------------------------------------------------- what there is to be told

    @property
    def steps(self) -> int:
        """Accepted steps of the run."""
        return int(self._steps.item())

    @steps.setter
    def steps(self, number: int) -> None:
        self._steps[()] = number

    @property
    def size(self) -> float:
        """Size in s of the last trial step."""
        return float(self._numbers["h"])

    @property
    def changed(self) -> bool:
        """Whether any mode, sign or chart is another than before the last accepted step."""
        return bool(self._changed.item())

    @property
    def known(self) -> tuple[np.ndarray, np.ndarray]:
        """Integers (nc, CONTACT_INTS) and charts (nc, 2) of contacts after the last accepted step; views."""
        known = self.step_arrays.known[: self.system.nc]
        return known[:, :CONTACT_INTS], known[:, CONTACT_INTS:]

    @property
    def joint_force(self) -> np.ndarray:
        """(nv,) mean force over the last step of joint limits, dry friction, and what resists spinning and rolling."""
        return self._joint_impulse / self.size if self.size > 0.0 else np.zeros_like(self._joint_impulse)

    @property
    def stats(self) -> dict[str, Any]:
        """Cone problems so far, as `Trajectory.stats` has them."""
        counts, numbers, cones = self._counts, self._numbers, self.cones
        made, moving = float(numbers["most_made"] - numbers["least_made"]), 0.5 * float(numbers["most_moving"])
        return {
            "cone_problems": cones.left + int(counts["solved"]),
            "rigid": int(counts["rigid_steps"]),
            "softened": cones.softened,
            "settled": cones.settled,
            "open_loads": int(counts["open_loads"]),
            "decided": cones.solver.decided,
            **cones.solver.program_counts,
            "cone_residual": float(numbers["cone_residual"]),
            "energy_error": made / moving if moving > 0.0 else 0.0,
        }

    def describe(self, status: int, t: float) -> Stop:
        """The Stop for a failed status, naming the contact and the number."""
        code, reason = FAILURES[status]
        where = number = ""
        if status == CONTRADICTION:
            reason = contradiction(self.system, t + self.size) or reason
        system = self.system
        if status in (SINGULAR, LOCATION_FAILED) and system.nc:
            c = int(np.argmin(np.abs(system.contact_real[: system.nc, CONDITION])))
            where = f"contact {system.contacts[c].name!r} ({system.contacts[c].pattern.name}): "
            number = f"; conditioning of J {abs(system.contact_real[c, CONDITION]):.3g}"
        elif status == CONTOUR_ENDS:
            where = f"contact {system.contacts[self.nearest_end()].name!r} "
        elif status in (FLIES_THROUGH, TOUCHES_TWICE, TOUCHES_AROUND):
            where = f"contact {system.contacts[self.open.where].name!r}: "
        elif status == OVERLAPS_AT_END:
            entered = (self.start_domain < 0.0) & (system.contact_real[: system.nc, DOMAIN] >= 0.0)
            deepest = int(np.argmin(np.where(entered & (system.modes == FREE), system.gaps[: system.nc, 0], math.inf)))
            where = f"contact {system.contacts[deepest].name!r}: "
        elif status == MOTION_JUMPS:
            where = f"the bodies of contact {system.contacts[self._counts['jumped']].name!r} are moved "
        elif status == CLOSED_APART:
            gaps = np.where(system.modes != FREE, np.abs(system.gaps[: system.nc, 0]), 0.0)
            c = int(np.argmax(gaps))
            where, number = f"contact {system.contacts[c].name!r}: ", f" by {gaps[c]:.3g} m"
            number += f"{least_conditioned(system)}; near 0 bodies touch along a line, where shorter steps do not help"
        elif status == NO_FORCE:
            pressing = self.cones.crushing()
            if pressing:
                limits = self.step_arrays.joints["limit"]
                joints = [f"joint {system.limits[limits[i]].joint!r}" for on_joint, i in pressing if on_joint]
                return crushed(
                    t, [f"contact {system.contacts[i].name!r}" for on_joint, i in pressing if not on_joint] + joints
                )
            units = self.step_arrays.units[: self._counts["units"]]
            contacts = dict.fromkeys(units["index"][units["kind"] != ON_JOINT].tolist())
            number = f" at {', '.join(repr(system.contacts[c].name) for c in contacts)}" if contacts else ""
            number += f"; relative residual {self.cones.solver.residual:.3g}"
        h, fastest = self.size, float(np.abs(system.state[system.nq : system.nq + system.nv]).max(initial=0.0))
        if status == TOO_LONG and self._asked is not None and h * fastest < _TURNS_FAR:
            reason = (
                f"the control is too stiff for steps of {h:.6g} s, or jumps as a relay does: the velocity at the "
                "middle of a step, which its torques depend on, does not settle; a Stepper holds torques over a step"
            )
        if h * fastest > _RUNAWAY:
            # as where a control is too stiff for the step: other reasons are consequences
            number += f"; a coordinate moves by {h * fastest:.3g} (rad or m) in a step of {h:.6g} s: it may be too long"
        return Stop(code, f"t = {t:.9g} s: {where}{reason}{number}")

    def nearest_end(self) -> int:
        """Of the contacts that cannot open the one nearest to the end of a contour, or furthest beyond it."""
        system = self.system
        bilateral = system.contact_int[: system.nc, UNILATERAL] == 0
        return int(np.argmin(np.where(bilateral, system.contact_real[: system.nc, DOMAIN], math.inf)))

    # ---------------------------------------------------------------- copies

    def kept(self) -> dict[str, Any]:
        """Copies of all that the next step depends on, warm starts of the solver included, for `restore`."""
        arrays, system = self.step_arrays, self.system
        return {
            "arrays": {
                name: getattr(arrays, name).copy()
                for name, (_, dimensions) in arrays.layout.arrays.items()
                if name not in _OWN and dimensions
            },
            "records": {
                record: {field: getattr(arrays, record)[field].item() for field in getattr(arrays, record).dtype.names}
                for record in ("counts", "numbers")
            },
            "system": {name: getattr(system, name).copy() for name in _OF_SYSTEM},
            "charts": system.side_int[:, CHART].copy(),
            "warm_starts": self.cones.solver.warm_starts(),
        }

    def restore(self, kept: dict[str, Any]) -> None:
        """Go on as the step of an equal system would that `kept` is of."""
        for name, values in kept["arrays"].items():
            getattr(self.step_arrays, name)[...] = values
        for record, fields in kept["records"].items():
            for field, value in fields.items():
                getattr(self.step_arrays, record)[field] = value
        for name, values in kept["system"].items():
            getattr(self.system, name)[...] = values
        self.system.side_int[:, CHART] = kept["charts"]
        self.cones.restore(kept["warm_starts"])

    def forget(self) -> None:
        """Let the next step depend on the state alone."""
        self.cones.solver.forget()
        if self._looks:
            # what was found on another way
            self.open = OpenContacts(self.system)
