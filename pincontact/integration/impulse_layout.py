"""Names of the arrays of one step of Moreau's method, and of the fields of the records in them."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..layout import CONTACT_INTS, MOTION_SIZE, SLIPPING
from ..workspace import INTEGERS, REALS, Layout, Scratch, Workspace, record
from .momentum_transport import INERTIA_SIZE

# What steps count and choose, in four groups. Of the problem: how many joint limits and dry frictions there are, units
# and equations; touched: whether anything touches in the step; reviews, sharings: how often its solution was looked at,
# and how often parts of viscous friction were changed; rigid: whether the laws hold for velocities in the midpoint's
# geometry, see `impulse_problem`; coupled, holding, choosing: see below; open_loads: problems in which the rule for
# redundant forces leaves loads open, see `impulse_choices`. Of a trial step: passes over its midpoint
# before the present one; has_trend: what the midpoint's velocity follows from, trend_before: the same in the first
# pass; thorough: whether its cone problems are solved with all means; changed: whether anything discrete is another
# since the last step; jumped: the contact whose bodies a motion has moved by a jump. Of a run: steps done, the last
# one, and the limit; watched: whether every step is looked at before it is accepted; turns: whether anything resists
# turning; row_count rows that steps write, rows_done so far, a row every row_steps steps, targeted: whether each has a
# target of its own. Of the solver: problems solved in compiled code by the task cone_task, and steps that had a
# solution in rigid geometry only. actuators: how many there are.
COUNTS = record(
    INTEGERS,
    *("joints", "units", "equations", "touched", "reviews", "rigid", "coupled", "holding", "choosing", "open_loads"),
    "sharings",
    *("passes", "has_trend", "trend_before", "thorough", "changed", "jumped"),
    *("steps", "last", "step_limit", "watched", "turns", "row_count", "rows_done", "row_steps", "targeted"),
    *("solved", "cone_task", "rigid_steps", "actuators"),
)
# counts.has_trend: nothing, or what the velocity at the midpoint follows from
ACCELERATION, MEAN_VELOCITY = 1, 2
# counts.coupled: whether the problem is solved together with the loads that it takes as given
APART, TOGETHER = range(2)
# counts.holding: forces that hold what was at rest: nobody was asked for them; Python is; it has found none; they have
# been looked for. counts.choosing: whether Python is to choose among redundant forces of what slides
UNASKED, WANTED, IN_VAIN, LOOKED_FOR = range(4)

# h: step size in s; ahead: s after the step's start at which its geometry and smooth terms are taken, the middle or,
# where bodies collide, the mean time of the impulses, impact. kept: part of the restitution that is applied, and the
# bounds between which it is looked for. load_change: by how much the last review changed loads that the problem takes
# as given, relative to their size. free_change: norm of the change of velocity without impulses, in the metric of
# the masses; miss: how far the midpoint's velocity was from the step's mean velocity, relative to that, in this metric.
# made: the energy in J that the step makes by its error (see `impulse_works`), moving: the square of that velocity,
# twice the kinetic energy or thereabouts. made_so_far: by all accepted steps, the least and the most that it ever was,
# and the most that ever moved.
# weight: of the step's end in the forces of actuators, see `actuators`. Of a run, in s: its start and end and the size
# of its steps. cone_tolerance: what is asked of cone problems, and the largest residual of any.
NUMBERS = record(
    REALS,
    *("h", "ahead", "impact", "kept", "kept_low", "kept_high", "load_change", "free_change", "miss", "weight"),
    *("made", "moving", "made_so_far", "least_made", "most_made", "most_moving"),
    *("run_start", "run_end", "step_size", "cone_tolerance", "cone_residual"),
)
# What steps call by address: kernels, and a Python function that sets the torques, or 0, its arguments, a compiled one
# that is asked first, or 0, and the result that means failure.
CALLS = record(
    INTEGERS, "run_task", "solve_cones", "assemble", "move_charts", "asked", "asked_with", "control", "call_failed"
)

# A joint limit or the dry friction of a joint: its kind, where the coordinate is in q, v and among the limited ones;
# bound: the limit in rad or m, or half the width of the range of friction forces in N m or N; middle: that range's.
JOINT = np.dtype(
    [*((name, INTEGERS) for name in ("kind", "index_q", "index_v", "limit")), ("bound", REALS), ("middle", REALS)]
)
LOWER_LIMIT, UPPER_LIMIT, DRY_FRICTION = range(3)
# What a limited coordinate does: it rests at the lower end of its way, moves down or up under dry friction, moves with
# none, rests at the upper end, is held by dry friction.
JOINT_AT_LOW, JOINT_SLIDES_DOWN, JOINT_MOVES, JOINT_SLIDES_UP, JOINT_AT_HIGH, JOINT_STICKS = range(-2, 4)

# Columns of what a contact resists: slip, rolling, spinning; what is closed rests in them (STICK), moves (SLIPPING), or
# has turned round in the step.
SLIP, ROLL, SPIN = range(3)
TURNED_ROUND = -SLIPPING

# An implicit PD actuator: where its coordinate is in q and v, whether q has cosine and sine of it there; gains in
# N m/rad and N m s/rad, or N/m and N s/m.
ACTUATOR = np.dtype(
    [*((name, INTEGERS) for name in ("index_q", "index_v", "circular")), ("stiffness", REALS), ("damping", REALS)]
)

# A unit of the cone problem. kind and index: of which contact or joint; mask: bit r is set where row r is real, the
# others only fill up the cone; touches: whether it closes in the step, struck: or impulses of what does act on it;
# midpoint: whether slip is opposed along the mean of its velocities at both ends; at_rest: whether it holds up to its
# coefficient of sticking; slid: whether it slid at the step's start; held: whether it stays at rest if any forces hold
# it; tied: whether its normal velocity follows from the equations, which then carry its load, too; group: the first of
# the units that act on each other, chooses: whether the rule chooses their forces. Row r of a unit that resists turning
# is about basis vector axis + r; parent is the unit of its contact, -1 where equations give its normal impulse.
# impulse_time: s after the step's start at which its impulse acts; approach and free_rate: its normal velocity before
# the impact and the rate of that, shift: the rebound less what the smooth forces take back of it; load: normal impulse
# that is taken as given; sliding: its coefficient in slip, sticking_again: that up to which it holds where its slip
# comes to rest, until that is tried.
UNIT = np.dtype(
    [
        *((name, INTEGERS) for name in ("kind", "index", "mask", "touches", "midpoint", "at_rest", "slid", "held")),
        *((name, INTEGERS) for name in ("tied", "struck", "group", "chooses")),
        *((name, INTEGERS) for name in ("axis", "parent")),
        *((name, REALS) for name in ("impulse_time", "approach", "free_rate", "shift")),
        *((name, REALS) for name in ("load", "sliding", "sticking_again", "unpressed")),
    ]
)
ON_CONTACT, ON_LOADED, ON_JOINT, ON_TURN = range(4)

# Arrays by what they hold, with their extents: numbers, or names of `step_workspace`; rows stands for 3 units.
_ARRAYS: dict[str, tuple[Any, ...]] = {
    "counts": (COUNTS,),
    "numbers": (NUMBERS,),
    "calls": (CALLS,),
    # the state at the step's start; of contacts: v_c in world axes, its components along n and the second normal, the
    # way to the nearest end of the contours' domains, negative beyond it; of joints: at which end one was held, or 0
    "start_q": (REALS, "nq"),
    "start_v": (REALS, "nv"),
    "start_location": (REALS, "contacts", 4),
    "start_rates": (REALS, "contacts", 4),
    "start_slip": (REALS, "contacts", 3),
    "start_normal": (REALS, "contacts", 2),
    "start_gap": (REALS, "contacts"),
    "start_mode": (INTEGERS, "contacts"),
    "start_domain": (REALS, "contacts"),
    # s after the step's start at which an open contact touches, see `impulse_units`; that way then
    "instant": (REALS, "contacts"),
    # whether it is left to the next step, see `impulse_trial`
    "put_off": (INTEGERS, "contacts"),
    "touch_ways": (REALS, "contacts"),
    # where users' functions have their contours then, see `impulse_drives`
    "start_drives": (REALS, "sides", MOTION_SIZE),
    # what resisted motions do at the step's start, and after the trial step, see SLIP; 0 where there are none
    "start_motion": (INTEGERS, "contacts", 3),
    "motion": (INTEGERS, "contacts", 3),
    "start_end": (INTEGERS, "limits"),
    # what limited coordinates do at the step's start, and after the trial step, see JOINT_MOVES; s after the step's
    # start at which one came to an end of its way, negative where it did not
    "start_joint": (INTEGERS, "limits"),
    "joint_state": (INTEGERS, "limits"),
    "limit_time": (REALS, "limits"),
    # whether an open contact has passed beside its contours to their far side
    "behind": (INTEGERS, "contacts"),
    # a contact's integers and charts after the last step
    "known": (INTEGERS, "contacts", CONTACT_INTS + 2),
    # mean acceleration of the last step, in the start's axes; v_0 and this in the axes of the midpoint, and v_0 in
    # those of the step's end; rate at which velocities turn with these axes, inertias of turning joints: see
    # `momentum_transport`
    "trend": (REALS, "nv"),
    "transported_v": (REALS, "nv"),
    "transported_trend": (REALS, "nv"),
    "seen_v": (REALS, "nv"),
    "turning_rate": (REALS, "nv"),
    "inertias": (REALS, "blocks", INERTIA_SIZE),
    # the velocity at the step's end, before it is put on the constraints
    "unprojected_v": (REALS, "nv"),
    # v_free - v_0, the displacement, and that over the step size
    "change": (REALS, "nv"),
    "displacement": (REALS, "nv"),
    "mean": (REALS, "nv"),
    # coefficients of restitution, and those up to which contacts at rest stick; -1 where the user named the contours
    # the other way round; normal impulse over the step size in the last step where something depends on it, N
    "restitution": (REALS, "contacts"),
    "sticking": (REALS, "contacts"),
    "orientation": (REALS, "contacts"),
    "load": (REALS, "contacts"),
    # which part of its viscous friction acts, and the search for it: see `impulse_viscous`
    "viscous_part": (REALS, "contacts"),
    "viscous_search": (REALS, "contacts", 4),
    "joints": (JOINT, "joints"),
    # actuators, the configuration that they aim at, and their mean torques over the last step
    "actuators": (ACTUATOR, "nv"),
    "target": (REALS, "nq"),
    "actuation": (REALS, "nv"),
    # the cone problem: units, and of their two tangents the velocities at the start and what drives add to them; rows
    # of units without what the equations take, L^-T rows^T, and what these take; what rigid geometry leaves out of b,
    # and what is then out of reach; Delassus matrix, of which the first (3 n)^2 numbers are used, b, coefficients of
    # friction; the solver's solution, and the forces of the first one of these units
    "units": (UNIT, "units"),
    "unit_start": (REALS, "units", 2),
    "unit_driven": (REALS, "units", 2),
    "whitened": (REALS, "rows", "nv"),
    "overlap": (REALS, "rows", "equations"),
    "beyond": (REALS, "rows", 2),
    "delassus": (REALS, "rows_squared"),
    "loads": (REALS, "rows"),
    "friction": (REALS, "units"),
    "cone_forces": (REALS, "rows"),
    "cone_velocities": (REALS, "rows"),
    "cone_modes": (INTEGERS, "units"),
    # coefficients with which what was at rest cannot slip
    "holding_friction": (REALS, "units"),
    "first_forces": (REALS, "rows"),
    # change of velocity by all impulses before what slid is held, whitened
    "slid_change": (REALS, "nv"),
    # by number of units the cone solver's table, 0 where there is none yet
    "cone_tables": (INTEGERS, "sizes"),
    # equations u = 0: contact and row, an orthonormal basis of their whitened rows, the rows in that basis; where they
    # are redundant, what the square of an impulse counts; change of velocity in that basis, what rigid geometry leaves
    # out of it, impulses
    "equation_index": (INTEGERS, "equations", 2),
    "equations": (REALS, "equations", "nv"),
    "equation_factor": (REALS, "equations", "equations"),
    "equation_unit": (REALS, "equations"),
    "equation_share": (REALS, "equations"),
    "equation_beyond": (REALS, "equations"),
    "equation_impulse": (REALS, "equations"),
    # results: impulses of contacts along the basis, N s, and of joint limits, dry friction, and what resists spinning
    # and rolling; s after the step's start at which a contact touched, or opened at the end of a contour, negative
    # where it did not; impulse over step size on the second contour given, world axes, and what resists turning, too
    "contact_impulse": (REALS, "contacts", 3),
    "joint_impulse": (REALS, "nv"),
    "touch_time": (REALS, "contacts"),
    "edge_time": (REALS, "contacts"),
    # modes and state before what touches is put together, see `impulse_trial`
    "impact_mode": (INTEGERS, "contacts"),
    "impact_state": (REALS, "state"),
    "forces": (REALS, "contacts", 3),
    "torques": (REALS, "contacts", 3),
    # the torques of the last pass over the midpoint, and the user's, while an output has others
    "asked_before": (REALS, "nv"),
    "set_aside": (REALS, "nv"),
}
# Arrays of a rollout, made for it: torques and targets of the steps that end with a row, and the state then.
_OF_ROWS = {name: (REALS, "rows_wanted", "of_row") for name in ("rows_tau", "rows_target", "rows_q", "rows_v")}
# What is read before a step writes it.
_ZERO = {"counts", "numbers", "calls", "behind", "known", "joints", "cone_tables", "actuators", "target", "actuation"}

STEP = Layout(
    "step",
    **{name: (kind if name in _ZERO else Scratch(kind), *extents) for name, (kind, *extents) in _ARRAYS.items()},
    **_OF_ROWS,
)
step_at = STEP.at


def step_workspace(nq: int, nv: int, nc: int, ng: int, nj: int, nt: int, nblocks: int) -> Workspace:
    """The arrays of `STEP` for a system with ng limited joint coordinates, nj limits and dry frictions of these,
    nt resistances to turning, and nblocks blocks of the configuration."""
    step = Workspace(STEP)
    units = max(nc + nj + nt, 1)
    sizes = {
        "nq": nq,
        "nv": max(nv, 1),
        "state": nq + nv + 4 * nc,
        "contacts": max(nc, 1),
        "sides": max(2 * nc, 1),
        "limits": max(ng, 1),
        "joints": max(nj, 1),
        "blocks": max(nblocks, 1),
        "units": units,
        "sizes": units + 1,
        "rows": 3 * units,
        "rows_squared": 9 * units * units,
        "equations": max(3 * nc, 1),
    }
    step.allocate(**sizes)
    step.counts["joints"] = nj
    return step
