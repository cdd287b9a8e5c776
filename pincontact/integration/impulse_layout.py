"""Names of the arrays of one step of Moreau's method, and of the columns within them."""

from __future__ import annotations

from ..layout import CONTACT_INTS
from ..workspace import INTEGERS, REALS, Layout, Workspace
from .carrying import INERTIA_SIZE

# Arrays of one step; ns units, ne equations.
STEP = Layout(
    "step",
    counts=(INTEGERS, 1),  # (NCOUNTS,): see the COUNT columns
    numbers=(REALS, 1),  # (8,): see the columns below
    start_q=(REALS, 1),
    start_v=(REALS, 1),
    start_location=(REALS, 2),  # (nc, 4)
    start_rates=(REALS, 2),  # (nc, 4)
    start_slip=(REALS, 2),  # (nc, 3) v_c, world axes
    start_normal=(REALS, 2),  # (nc, 2) components of v_c along n and the second normal
    start_gap=(REALS, 1),  # (nc,)
    start_mode=(INTEGERS, 1),  # (nc,)
    start_domain=(REALS, 1),  # (nc,) way to the nearest end of the contours' domains, negative beyond it
    behind=(INTEGERS, 1),  # (nc,): whether an open contact has passed beside its contours to their far side
    trend=(REALS, 1),  # (nv,) mean acceleration of the last step, in the start's axes
    carried_v=(REALS, 1),  # (nv,) v_0, and the trend, in the axes of the midpoint
    carried_trend=(REALS, 1),
    seen_v=(REALS, 1),  # (nv,) v_0 in the axes of the step's end
    turning_rate=(REALS, 1),  # (nv,) of velocities at the midpoint, see `carrying`
    inertias=(REALS, 2),  # (nblocks, INERTIA_SIZE) of turning joints at the start, see `carrying`
    change=(REALS, 1),  # (nv,) v_free - v_0
    restitution=(REALS, 1),  # (nc,)
    sticking=(REALS, 1),  # (nc,) coefficient up to which a contact at rest sticks
    load=(REALS, 1),  # (nc,) normal impulse over the step size in the last step of contacts whose disks depend on it, N
    start_end=(INTEGERS, 1),  # (ng,): end at which a guarded joint coordinate was held, 0: at none
    joint_int=(INTEGERS, 2),  # (nj, JOINT_INTS): kind, index in q, index in v, guard
    joint_real=(REALS, 2),  # (nj, 2): limit and nothing, or half the width and the middle of the friction force's range
    unit_int=(INTEGERS, 2),  # (ns, UNIT_INTS)
    unit_real=(REALS, 2),  # (ns, UNIT_REALS)
    whitened=(REALS, 2),  # (3 ns, nv) L^-T rows^T, without what the equations take
    overlap=(REALS, 2),  # (3 ns, ne) what they take
    delassus=(REALS, 1),  # (9 ns ns,) of which the first (3 n)^2 are used
    loads=(REALS, 1),  # (3 ns,) b of the cone problem
    friction=(REALS, 1),  # (ns,)
    cone_forces=(REALS, 1),  # (3 n,) of the solver
    cone_velocities=(REALS, 1),
    cone_modes=(INTEGERS, 1),
    equation_index=(INTEGERS, 2),  # (ne, 2): contact and row
    equations=(REALS, 2),  # (ne, nv) orthonormal basis of their whitened rows
    equation_factor=(REALS, 2),  # (ne, ne) the rows in that basis
    equation_unit=(REALS, 1),  # (ne,) where they are redundant, what the square of an impulse counts
    equation_share=(REALS, 1),  # (ne,) change of velocity in that basis
    equation_impulse=(REALS, 1),  # (ne,)
    contact_impulse=(REALS, 2),  # (nc, 3) along the basis, N s
    joint_impulse=(REALS, 1),  # (nv,) of limits, dry friction, and of what resists spinning and rolling
    touch_time=(REALS, 1),  # (nc,) s after the step's start, negative: did not touch
    edge_time=(REALS, 1),  # (nc,) likewise, when a contact opened at the end of a contour
    displacement=(REALS, 1),  # (nv,)
    mean=(REALS, 1),  # (nv,) displacement over the step size
    forces=(REALS, 2),  # (nc, 3) impulse over step size on the second contour given, world axes
    torques=(REALS, 2),  # (nc, 3) what resists spinning and rolling, likewise
    orientation=(REALS, 1),  # (nc,): -1 where the user named the contours the other way round
    known=(INTEGERS, 2),  # (nc, CONTACT_INTS + 2): the contact's integers and charts after the last step
    calls=(INTEGERS, 1),  # (NCALLS,): what steps call by address
    cone_tables=(INTEGERS, 1),  # (ns + 1,): by number of units the cone solver's table, 0 where there is none yet
    set_aside=(REALS, 1),  # (nv,) the user's torques, while an output has others
    rows_tau=(REALS, 2),  # (rows, nv) torques of the steps that end with a row, and the state then
    rows_q=(REALS, 2),  # (rows, nq)
    rows_v=(REALS, 2),
)
step_at = STEP.at

# counts. RIGID: the laws hold for velocities in the midpoint's geometry, see `impulse_problem`. Of an attempt: PASSES
# over its midpoint before the present one, TREND_BEFORE what counts[HAS_TREND] is without them, THOROUGH whether its
# cone problems are solved with all means. CHANGED: whether anything discrete is another since the last step. Of a run:
# STEPS done and LAST, STEP_LIMIT, WATCHED: whether every step is looked at before it is accepted, TURNS: whether
# anything resists turning; ROW_COUNT rows that are written by steps, ROWS_DONE so far, a row every ROW_STEPS steps.
# SOLVED_HERE: cone problems that were solved in compiled code, by CONE_TASK; RIGID_STEPS: those that had a solution in
# rigid geometry only. Of an attempt: COUPLED: whether its problem is solved together with the loads that it takes as
# given, see below; HOLDING: whether forces have been looked for that hold what was at rest, see below; CHOOSING:
# whether Python is to choose among redundant forces of what slides; OPEN_LOADS: problems in which the rule for these
# leaves loads open, see `_leaves_choice`.
(
    NJ,
    MAX_UNITS,
    MAX_EQUATIONS,
    UNITS,
    NEQ,
    HAS_TREND,
    TOUCHED,
    REVIEWS,
    RIGID,
    PASSES,
    TREND_BEFORE,
    THOROUGH,
    CHANGED,
    STEPS,
    LAST,
    STEP_LIMIT,
    WATCHED,
    TURNS,
    ROW_COUNT,
    ROWS_DONE,
    ROW_STEPS,
    SOLVED_HERE,
    CONE_TASK,
    RIGID_STEPS,
    COUPLED,
    HOLDING,
    CHOOSING,
    OPEN_LOADS,
) = range(28)
NCOUNTS = 28
# counts[HAS_TREND]: nothing, or what the velocity at the midpoint follows from
ACCELERATION, MEAN_VELOCITY = 1, 2
# numbers; AHEAD: s after the step's start at which its geometry and smooth terms are taken, the middle or, where bodies
# collide, the mean time of the impulses, IMPACT; FREE_CHANGE: norm of the change of velocity without impulses, in the
# mass metric; MISS: how far the midpoint's velocity was from the step's mean velocity, relative to that, in the metric
# of the masses; of a run, in s, RUN_START, RUN_END and STEP_SIZE; what is asked of cone problems, and the
# largest residual of any
(
    H,
    KEPT,
    KEPT_LOW,
    KEPT_HIGH,
    FREE_CHANGE,
    MISS,
    RUN_START,
    RUN_END,
    STEP_SIZE,
    CONE_TOLERANCE,
    CONE_RESIDUAL,
    AHEAD,
    IMPACT,
) = range(13)
NNUMBERS = 13
# calls: `run_task`, `solve_cones`, `assemble`, `move_charts`; a Python function that sets the torques, or 0, its
# arguments and the result that means failure
RUN_TASK, SOLVE_CONES, ASSEMBLE, MOVE_CHARTS, ASKED, ASKED_WITH, CALL_FAILED = range(7)
NCALLS = 7
# joint_int
JOINT_KIND, JOINT_Q, JOINT_V, JOINT_GUARD = range(4)
JOINT_INTS = 4
LOWER_LIMIT, UPPER_LIMIT, DRY_FRICTION = range(3)
# unit_int; ROW_MASK: bit r is set where row r is real, the others only fill up the cone. Row r of a unit that resists
# turning is about basis vector AXIS + r; PARENT is the unit of the contact, -1 where equations give its normal impulse.
# AT_REST: whether it holds up to its coefficient of sticking. SLID: whether it slid at the step's start. HELD:
# whether it stays at rest if any forces hold it.
UNIT_KIND, UNIT_INDEX, ROW_MASK, TOUCHES, MIDPOINT, AT_REST, AXIS, PARENT, SLID, HELD = range(10)
UNIT_INTS = 10
ON_CONTACT, ON_LOADED, ON_JOINT, ON_TURN = range(4)
# counts[COUPLED]
APART, TOGETHER = range(2)
# counts[HOLDING]: nobody was asked; Python is; they have been looked for
UNASKED, WANTED, LOOKED_FOR = range(3)
# unit_real; STICKING_AGAIN: the coefficient up to which it holds where its slip comes to rest, until that is tried
(
    IMPULSE_TIME,
    SHIFT,
    APPROACH,
    FREE_RATE,
    START_T1,
    START_T2,
    UNIT_LOAD,
    SLIDING,
    STICKING_AGAIN,
    DRIVEN_T1,
    DRIVEN_T2,
) = range(11)
UNIT_REALS = 11


def step_workspace(nq: int, nv: int, nc: int, ng: int, nj: int, nt: int, nblocks: int) -> Workspace:
    """The arrays of `STEP` for a system with ng guarded joint coordinates, nj limits and dry frictions of these,
    nt resistances to turning, and nblocks blocks of the configuration."""
    step = Workspace(STEP)
    contacts, units, equations = max(nc, 1), max(nc + nj + nt, 1), max(3 * nc, 1)
    counts = step.zeros("counts", NCOUNTS)
    counts[[NJ, MAX_UNITS, MAX_EQUATIONS]] = nj, units, equations
    step.zeros("numbers", NNUMBERS)
    step.scratch("start_q", nq)
    carried = "carried_v", "carried_trend", "seen_v", "turning_rate"
    for name in ("start_v", "trend", *carried, "change", "joint_impulse", "displacement", "mean", "set_aside"):
        step.scratch(name, max(nv, 1))
    for name in ("start_location", "start_rates"):
        step.scratch(name, contacts, 4)
    for name in ("start_slip", "contact_impulse", "forces", "torques"):
        step.scratch(name, contacts, 3)
    step.scratch("inertias", max(nblocks, 1), INERTIA_SIZE)
    step.scratch("start_normal", contacts, 2)
    for name in (
        "start_gap",
        "restitution",
        "sticking",
        "load",
        "touch_time",
        "edge_time",
        "start_domain",
        "orientation",
    ):
        step.scratch(name, contacts)
    step.scratch("start_mode", contacts)
    step.zeros("behind", contacts)
    step.zeros("known", contacts, CONTACT_INTS + 2)
    step.scratch("start_end", max(ng, 1))
    step.zeros("joint_int", max(nj, 1), JOINT_INTS)
    step.zeros("joint_real", max(nj, 1), 2)
    step.scratch("unit_int", units, UNIT_INTS)
    step.scratch("unit_real", units, UNIT_REALS)
    step.scratch("whitened", 3 * units, nv)
    step.scratch("overlap", 3 * units, equations)
    step.scratch("delassus", 9 * units * units)
    for name in ("loads", "cone_forces", "cone_velocities"):
        step.scratch(name, 3 * units)
    step.scratch("friction", units)
    step.scratch("cone_modes", units)
    step.zeros("calls", NCALLS)
    step.zeros("cone_tables", units + 1)
    step.scratch("equation_index", equations, 2)
    step.scratch("equations", equations, nv)
    step.scratch("equation_factor", equations, equations)
    for name in ("equation_unit", "equation_share", "equation_impulse"):
        step.scratch(name, equations)
    return step
