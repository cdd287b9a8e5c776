"""Arrays that the kernels of a run share, and the columns within them."""

from __future__ import annotations

from .contours.sizes import DERIVATIVE_ROWS, MOTION_PARAMETERS, MOTION_SIZE, SHAPE_SIZE
from .workspace import INTEGERS, REALS, Layout, Scratch, record

SIZES = record(INTEGERS, "nq", "nv", "nc", "njoints", "nblocks", "nstages", "nwork", "ny")

# scalars: of the last evaluation and step, then what steps are controlled by (times and steps in s);
# DIP is the part of an event function's change over a step by which it may dip between two stages, TURNING_RATE that of
# the slowest slip, by friction, at the accepted state, 1 / s, BAD_TORQUE the user's torque that was not finite, else 0,
# and BAD_TIME when that was; VELOCITY_LEFT: what the last projection leaves of velocities that are to be zero;
# FREE_SIZE is that of a_free in the mass metric
SCALARS = record(
    REALS,
    "time",
    "step",
    "error_norm",
    "gap_residual",
    "velocity_residual",
    "correction_size",
    "now",
    "next_time",
    "next_step",
    "end",
    "next_output",
    "max_step",
    "fixed_step",
    "floor",
    "error_order",
    "last_error",
    "slowest",
    "dense_start",
    "dense_step",
    "has_reference",
    "dip",
    "turning_rate",
    "bad_torque",
    "bad_time",
    "velocity_left",
    "free_size",
    "largest_force",
)

# counters, and settings that are integers; ROW_RANK is that of the last evaluation's constraint rows, 0 if not found,
# REDUNDANT 1 where those that are next to depending on each other count as if they did, LOST_POSITIVITY 1 if there are
# forces, but those from which compliances would lead away, and DECIDED 1 where modes
# are taken to have forces, whatever their operator
COUNTERS = record(
    INTEGERS,
    "newton_count",
    "closed_count",
    "evaluation_count",
    "step_count",
    "rejected_count",
    "trial_limit",
    "stalled",
    "alarm",
    "failure",
    "estimate_after",
    "extra_stages",
    "charted",
    "paired",
    "dense_nested",
    "output_count",
    "outputs_done",
    "recorded",
    "record_steps",
    "row_width",
    "row_count",
    "rows_formed",
    "drives_evaluated",
    "stiff_steps",
    "patience",
    "row_rank",
    "redundant",
    "decided",
    "parent_axes",
    "scan_count",
    "sought_item",
    "sought_kind",
    "lost_positivity",
)

# what kernels call by address: a Python function to be asked first, or 0, its arguments, and whether it is for places,
# too; a compiled control that is asked instead, or 0; two of Pinocchio's algorithms and theirs; the result that means
# failure; the evaluation; the algorithm that gives places, velocities and Jacobians alone; where the rows of
# `PinocchioCalls.native` are, or 0, and the model, with the two words that it begins with
CALLBACK = record(
    INTEGERS,
    "asked",
    "asked_with",
    "asked_for_places",
    "control",
    "called",
    "called_with",
    "called_next",
    "called_next_with",
    "call_failed",
    "evaluation",
    "placed",
    "placed_with",
    "native",
    "model",
    "model_size",
    "model_joints",
)

# contact_int; from MODE to BESIDE what a State keeps of it. BESIDE: an open contact whose body is beside the
# ends of the other contour, and has not come over it since, or whose curves cross: where its side is not given, that
# may change
(
    PATTERN,
    K1,
    K2,
    TANGENTS,
    MODE,
    SIDE,
    BRANCH,
    DETERMINANT_SIGN,
    SLIP_SIGN,
    NORMAL_SIGN,
    FROZEN,
    BESIDE,
    UNILATERAL,
    CLOSED_FORM,
    ANISOTROPIC,
    SPINNING_ROW,
    ROLLING_ROW,
    OWNER,
    WHOLE,
    NEXT,
) = range(20)
CONTACT_INTS = 20
# contact_int[ANISOTROPIC]: friction alike in all directions, or along a tangent of body 1 or body 2 and across it
ISOTROPIC, ALONG_BODY_1, ALONG_BODY_2 = range(3)
# contact_int[SPINNING_ROW], contact_int[ROLLING_ROW]: rows of a contact's resistances among all, 0 for none;
# contact_int[OWNER]: of a resistance's row, its contact; contact_int[WHOLE]: the body (0 or 1) whose contour lies in
# the ball of HULL and EXTENT; contact_int[NEXT]: the next contact of the same two contours, in a ring

# contact_real; MU is the coefficient as slip starts, MU_FAST that of fast slip, MU_NOW that of the last evaluation;
# coefficients of two directions are along the first, times ASPECT across it.
# HULL_X to HULL_Z and EXTENT: centre (frame of the contour) and radius in m of a ball in which one contour lies. While
# open: bounds of APPROACH_SPEED in m/s, TURNING in rad/s and BENDING in m/s^2, see `integration.approach`; SPEEDING in
# m/s^2: how much that speed changed in the last step that might have touched; FLAT: whether contour 2 is a plane that
# no motion drives.
# CURVE_SPEED is the speed in m/s over which a coefficient that depends on slip changes, 0 for constant ones;
# STRIBECK_EXPONENT belongs to one such curve.
# LIMIT_SLACK is the part of the static limit by which friction may exceed it before stick ends.
# OVERLAP is how far in m bodies may be inside each other that come into a domain from its end, and not behind it.
# LIFT is by how much the force of what slips parts the bodies, friction included and what sticks held, relative to what
# it does without friction.
# DOMAIN is the distance of the contact coordinates from the nearest end of their domain, negative outside;
# LAST_NORMAL is n at the last accepted state, by which crossing curves tell their sides apart, NEXT_NORMAL that of the
# state about to be accepted; START_SPEED and _RATE are those of 3D slip there, infinite where there is none, LAST_SPEED
# and _RATE those one step before, LAST_STEP the size in s of the step that led there; STOP_ERROR is that of velocities
# in m/s if the way to its end is one linear step, and STOP_TIME in s what steps may go of it; START_SLIP its v_c there.
# A frozen slip direction is DIRECTION + p(s) ACROSS with p of the coefficients POLYNOMIAL.. in s = (t - START) / SPAN;
# vectors in world axes.
(
    MU,
    MU_STATIC,
    LIMIT_SLACK,
    MU_FAST,
    MU_NOW,
    CURVE_SPEED,
    STRIBECK_EXPONENT,
    VISCOUS,
    SPINNING,
    ROLLING,
    ASPECT,
    SCALING_11,
    SCALING_12,
    SCALING_22,
    LENGTH,
    OVERLAP,
    CONDITION,
    NORMAL_1,
    NORMAL_2,
    SLIP_SPEED,
    SLIP_RATE,
    LIFT,
    DOMAIN,
    LAST_NORMAL_X,
    LAST_NORMAL_Y,
    LAST_NORMAL_Z,
    NEXT_NORMAL_X,
    NEXT_NORMAL_Y,
    NEXT_NORMAL_Z,
    HULL_X,
    HULL_Y,
    HULL_Z,
    EXTENT,
    APPROACH_SPEED,
    TURNING,
    SPEEDING,
    FLAT,
    BENDING,
    START_SPEED,
    START_RATE,
    START_TOLERANCE,
    LAST_SPEED,
    LAST_RATE,
    LAST_STEP,
    STOP_ERROR,
    STOP_TIME,
    START_SLIP_X,
    START_SLIP_Y,
    START_SLIP_Z,
    START,
    SPAN,
    DIRECTION_X,
    DIRECTION_Y,
    DIRECTION_Z,
    ACROSS_X,
    ACROSS_Y,
    ACROSS_Z,
    POLYNOMIAL,
) = range(58)
POLYNOMIAL_SIZE = 5
# from START on
FROZEN_COLUMNS = 8 + POLYNOMIAL_SIZE
CONTACT_REALS = POLYNOMIAL + POLYNOMIAL_SIZE

# side_int; POOL_ADDRESS, MOTION_POOL: of further numbers of the contour and its motion; EVALUATOR, MOTION_EVALUATOR:
# of the kernels that evaluate them; CARRIER: a number for what carries it, a joint and a motion
(
    KIND,
    CHART,
    JOINT,
    CARRIER,
    MOTION_KIND,
    TIME_DEPENDENT,
    POOL_ADDRESS,
    POOL_SIZE,
    SUPPORT_SIZE,
    MOTION_POOL,
    MOTION_POOL_SIZE,
    EVALUATOR,
    MOTION_EVALUATOR,
) = range(13)
SIDE_INTS = 13

# joint_int: indices in q and v, direction of motion (0 without dry friction), end at which it is held (0: at none)
JOINT_Q, JOINT_V, JOINT_SIGN, JOINT_END = range(4)
JOINT_INTS = 4
# joint_real: range of the dry friction force, and of q
LOW_FORCE, HIGH_FORCE, LOW_END, HIGH_END = range(4)
JOINT_REALS = 4

# event_functions: positive while the mode holds
NORMAL_EVENT, FRICTION_EVENT, GAP_EVENT, SPEED_EVENT, DOMAIN_EVENT = range(5)
EVENTS_PER_CONTACT = 5

# modes, as reported in `track.mode`
FREE, FRICTIONLESS, STICK, SLIPPING = -1, 0, 1, 2

# what an evaluation returns
OK, EVENT, LOCATION_FAILED, SINGULAR, MASS_NOT_POSITIVE, NO_FORCE, NOT_FINITE, TOO_LONG = range(8)

# Memory of a Runge-Kutta step. Rows of the coefficients and of the slopes: 16 for stages and the interpolant, the last
# one for scratch; of the error weights: two estimates of the state's error, the rest for event functions (see
# `integration.resolution`); of the interpolant's coefficients (Sharp98 uses all, DOP853 seven, RK45 four, RK23 three);
# of event functions that are kept behind those of a scan: of all stages from the step's start on, and of one state; and
# behind these: of the last look for a zero, and of the first zero that is known.
MAX_STAGES = 17
ERROR_ROWS = 14
DENSE_ROWS = 8
KEPT_ROWS = MAX_STAGES + 1
# quadratures at the end of the state, J, where energies are recorded: work of friction, of prescribed motions, of the
# user's torques, of the joints' damping and dry friction
FRICTION_WORK, DRIVE_WORK, TORQUE_WORK, DAMPING_WORK = range(4)
NUMBER_OF_WORKS = 4

# places along a step that are evaluated by one call, and the gap beyond the end of a contour, where nothing can touch
SCAN_ROOM = 9
LOOK_ROW = SCAN_ROOM + KEPT_ROWS
LEFT_ROW, RIGHT_ROW = LOOK_ROW + 1, LOOK_ROW + 2
SCAN_ROWS = RIGHT_ROW + 1
NOTHING_THERE = 1e300
# Two places of a contact closer than this, relative to its length, are one.
SAME_PLACE = 1e-6
# What is at an end of a contour is on it, whatever rounding says: ends are so much further out, in m or rad.
END_MARGIN = 1e-11


_REALS, _INTEGERS = Scratch(REALS), Scratch(INTEGERS)
# Extents are of `System`, those of a run of `RunSystem`; "given": an array of somebody else's is put there.
SYSTEM = Layout(
    "system",
    sizes=(SIZES,),
    scalars=(SCALARS,),
    callback=(CALLBACK,),
    # Pinocchio's data, read in place
    mass=(REALS, "given", "given"),  # (nv, nv) lower triangle (Pinocchio's upper one, transposed view)
    # (nv,): tree of the mass matrix without what is locked, see `linalg.factorize_tree`
    parents=(INTEGERS, "some_nv"),
    nle=(REALS, "given"),  # (nv,) bias forces
    jacobian=(REALS, "given", 6),  # (nv, 6) one row a velocity coordinate: linear at the world's origin, angular
    joint_addresses=(INTEGERS, "joints", 4),  # (njoints, 4): rotation, translation, v, a_gf
    gravity=(REALS, 3),  # (3,)
    tau=(REALS, "nv"),  # (nv,) joint torques of the user
    damping=(REALS, "nv"),  # (nv,) viscous joint damping of the model
    moves=(REALS, "nv"),  # (nv,) 1, but 0 for coordinates that are locked
    # joints: how q' follows from v
    joint_table=(INTEGERS, "blocks", 4),  # (nblocks, 4): kind, index in q, index in v, coordinates
    # contacts
    contact_int=(INTEGERS, "items", CONTACT_INTS),  # (nc, CONTACT_INTS)
    contact_real=(REALS, "items", CONTACT_REALS),  # (nc, CONTACT_REALS)
    # side 2 c is body 1 of contact c, side 2 c + 1 is body 2
    side_int=(INTEGERS, "sides", SIDE_INTS),  # (2 nc, SIDE_INTS)
    side_shape=(REALS, "sides", SHAPE_SIZE),  # (2 nc, SHAPE_SIZE)
    side_domain=(REALS, "sides", 4),  # (2 nc, 4): low and high end of u1 and u2, infinite where there is none
    side_base=(REALS, "sides", 12),  # (2 nc, 12) placement in the joint: rotation (9), position (3)
    # prescribed placement relative to the base, and its derivatives
    side_motion=(REALS, "sides", MOTION_SIZE),  # (2 nc, 24)
    side_motion_parameters=(REALS, "sides", MOTION_PARAMETERS),  # (2 nc, MOTION_PARAMETERS)
    support=(INTEGERS, "sides", "some_nv"),  # (2 nc, nv): velocity coordinates, not locked, that move the side's joint
    # results of one evaluation
    frames=(REALS, "sides", 8, 3),  # (2 nc, 8, 3): rotation rows, origin, velocity, omega, acceleration, alpha (world)
    derivatives=(REALS, "item_sides", DERIVATIVE_ROWS, 3),  # (2 nc, 10, 3): the contour's, world axes, from its origin
    basis=(_REALS, "items", 3, 3),  # (nc, 3, 3): rows t1, second, n (world)
    slip=(REALS, "items", 3),  # (nc, 3): v_c = v_2 - v_1, world
    gaps=(_REALS, "items", 2),  # (nc, 2): n . (r_2 - r_1); second normal's for a point on a spatial curve
    rates=(_REALS, "items", 4),  # (nc, 4): rates of the contact coordinates u_1', u_2'
    bias=(REALS, "items", 3),  # (nc, 3): row . gamma plus frame rates, along the basis
    rows=(REALS, "items", 3, "nv"),  # (nc, 3, nv): basis . (J_2 - J_1)
    # zero where no evaluation has solved for a force: time stepping gives that of joints with the torques
    force=(REALS, "items", 3),  # (nc, 3): force on body 2 along the basis
    relative_acceleration=(_REALS, "items", 3),  # (nc, 3): along the basis, for events
    event_functions=(_REALS, "items", EVENTS_PER_CONTACT),  # (items, 5): positive while the mode holds
    location=(REALS, "items", 4),  # (nc, 4): contact coordinates u_1 (2), u_2 (2)
    # linear algebra
    factor=(REALS, "nv", "nv"),  # (nv, nv) Cholesky factor of the mass matrix
    acceleration=(_REALS, "nv"),  # (nv,)
    free_acceleration=(_REALS, "nv"),  # (nv,)
    constraint_rows=(_REALS, "rows", "bordered"),  # (3 nc, 3 nc + 1)
    whitened_rows=(_REALS, "rows", "nv"),  # (3 nc, nv): L^-T rows^T, transposed
    whitened_forces=(_REALS, "rows", "nv"),  # (3 nc, nv): the same for the force directions
    delassus=(_REALS, "rows", "bordered"),  # (3 nc, 3 nc + 1)
    multipliers=(_REALS, "rows"),  # (3 nc,)
    right_side=(_REALS, "rows"),  # (3 nc,)
    row_index=(_INTEGERS, "rows", 2),  # (3 nc, 2): contact and basis row of each constraint row
    permutation=(_INTEGERS, "rows"),  # (3 nc,)
    # Runge-Kutta
    state=(REALS, "ny"),  # (ny,) at the start of the step: q, v, contact coordinates, quadratures
    stage_state=(_REALS, "run_ny"),  # (ny,)
    new_state=(_REALS, "run_ny"),  # (ny,)
    next_state=(_REALS, "run_ny"),  # (ny,) start of the next step, and its slope, while outputs of this one are written
    next_slope=(_REALS, "run_ny"),  # (ny,)
    slopes=(_REALS, MAX_STAGES, "run_ny"),  # (stages, ny)
    coefficients=(REALS, "given", "given"),  # (stages, stages)
    nodes=(REALS, "given"),  # (stages,)
    weights_error=(REALS, "given", "given"),  # (2, stages)
    q=(REALS, "nq"),  # (nq,) handed to Pinocchio
    v=(REALS, "nv"),  # (nv,)
    scale=(REALS, 2),  # (2,) rtol, atol
    absolute=(REALS, "run_ny"),  # (ny,) absolute tolerance of each component; 0 leaves it out of the norm
    # scratch
    location_system=(_REALS, 4, 8),  # (4, 8)
    vectors=(_REALS, 16, 3),  # (16, 3)
    local=(_REALS, DERIVATIVE_ROWS, 3),  # (10, 3)
    work=(_REALS, "some_nv"),  # (nv,)
    correction_q=(_REALS, "nv"),  # (nv,)
    correction_v=(_REALS, "nv"),  # (nv,)
    dense=(_REALS, DENSE_ROWS, "run_ny"),  # (DENSE_ROWS, ny) coefficients of the interpolant
    dense_weights=(REALS, "given", "given"),  # (DENSE_ROWS, stages + 1)
    counters=(COUNTERS,),
    # outputs
    output_times=(REALS, "given"),  # (OUTPUT_COUNT,) s
    recorded_reals=(REALS, "given", "given"),  # (BLOCK, ROW_WIDTH) rows, see `recording`
    recorded_integers=(INTEGERS, "given", "given"),  # (BLOCK, ...)
    # joint coordinates with limits or dry friction, rows nc .. nc + ng of the contacts' arrays: see `dynamics.joints`
    joint_count=(INTEGERS, 1),  # (1,): ng
    joint_int=(INTEGERS, "limits", JOINT_INTS),  # (ng, JOINT_INTS)
    joint_real=(REALS, "limits", JOINT_REALS),  # (ng, JOINT_REALS)
    # resistances to spinning and rolling, rows nc + ng .. nc + ng + nr: see `dynamics.resistance`
    resistance_count=(INTEGERS, 1),  # (1,): nr
    # least and largest event functions of a step's stages, and one choice among redundant forces
    lowest=(_REALS, "items", EVENTS_PER_CONTACT),  # (nc + ng + nr, EVENTS_PER_CONTACT)
    highest=(_REALS, "items", EVENTS_PER_CONTACT),  # (nc + ng + nr, EVENTS_PER_CONTACT)
    # force along the basis about which the least-norm solution is taken
    reference=(REALS, "items", 3),  # (nc + ng + nr, 3)
    # how the reference moves: see `equations`
    reference_start=(REALS, "items", 3),  # (nc + ng + nr, 3) when it was chosen
    reference_slope=(REALS, 2, "rows", "nv"),  # (2, 3 (nc + ng + nr), nv)
    # event functions of all items along a step: at which shares of it, the evaluations' statuses, and their values
    scan_shares=(_REALS, SCAN_ROWS),  # (SCAN_ROWS,)
    scan_status=(_INTEGERS, SCAN_ROWS),  # (SCAN_ROWS,)
    scan_event_functions=(_REALS, SCAN_ROWS, "run_items", EVENTS_PER_CONTACT),
    # what event functions may be below zero, and which are looked at for zeros: see `crossings`
    slack=(REALS, "run_items", EVENTS_PER_CONTACT),  # (nc + ng + nr, EVENTS_PER_CONTACT)
    sought=(_REALS, "run_items", EVENTS_PER_CONTACT),  # (nc + ng + nr, EVENTS_PER_CONTACT)
    # shares of a step with values around a zero, of a function and of a polynomial, whose coefficients follow
    brackets=(_REALS, 3, SCAN_ROOM),  # (3, SCAN_ROOM)
)

# the workspace at an address that Python gives an entry kernel
system_at = SYSTEM.at
