"""Names of the arrays that kernels share (slots of the address table) and of the columns within them."""

from __future__ import annotations

SLOTS = (
    "sizes",  # (8,) int: see the SIZE columns
    "scalars",  # (SCALARS_SIZE,): see the scalars below
    "callback",  # (CALLBACK_SIZE,) int: what kernels call by address
    # Pinocchio's data, read in place
    "mass",  # (nv, nv) lower triangle (Pinocchio's upper one, transposed view)
    "parents",  # (nv,) int: tree of the mass matrix, see `linear.factorize_tree`
    "nle",  # (nv,) bias forces
    "jacobian",  # (nv, 6) one row a velocity coordinate: linear at the world's origin, angular
    "joint_addresses",  # (njoints, 4) int: rotation, translation, v, a_gf
    "gravity",  # (3,)
    "tau",  # (nv,) joint torques of the user
    "damping",  # (nv,) viscous joint damping of the model
    # joints: how q' follows from v
    "joint_table",  # (nblocks, 4) int: kind, index in q, index in v, coordinates
    # contacts
    "contact_int",  # (nc, CONTACT_INTS) int
    "contact_real",  # (nc, CONTACT_REALS)
    "side_int",  # (2 nc, SIDE_INTS) int: side 2 c is body 1 of contact c, side 2 c + 1 is body 2
    "side_shape",  # (2 nc, SHAPE_SIZE)
    "side_domain",  # (2 nc, 4): low and high end of u1 and u2, infinite where there is none
    "side_base",  # (2 nc, 12) placement in the joint: rotation (9), position (3)
    "side_motion",  # (2 nc, 24) driven placement relative to the base, and its derivatives
    "side_motion_parameters",  # (2 nc, MOTION_PARAMETERS)
    "support",  # (2 nc, nv) int: velocity coordinates that move the side's joint
    # results of one evaluation
    "frames",  # (2 nc, 8, 3): rotation rows, origin, velocity, omega, acceleration, alpha (world)
    "derivatives",  # (2 nc, 10, 3): the contour's derivatives, world axes, from the contour's origin
    "basis",  # (nc, 3, 3): rows t1, second, n (world)
    "slip",  # (nc, 3): v_c = v_2 - v_1, world
    "gaps",  # (nc, 2): n . (r_2 - r_1); second normal's for a point on a spatial curve
    "rates",  # (nc, 4): location rates u_1', u_2'
    "bias",  # (nc, 3): row . gamma plus frame rates, along the basis
    "rows",  # (nc, 3, nv): basis . (J_2 - J_1)
    "force",  # (nc, 3): force on body 2 along the basis
    "relative_acceleration",  # (nc, 3): along the basis, for events
    "margins",  # (nc, MARGINS_PER_CONTACT): event functions, positive while the mode holds
    "location",  # (nc, 4): u_1 (2), u_2 (2)
    # linear algebra
    "factor",  # (nv, nv) Cholesky factor of the mass matrix
    "acceleration",  # (nv,)
    "free_acceleration",  # (nv,)
    "constraint_rows",  # (3 nc, nv)
    "whitened_rows",  # (3 nc, nv): L^-T rows^T, transposed
    "whitened_forces",  # (3 nc, nv): the same for the force directions
    "delassus",  # (3 nc, 3 nc + 1)
    "multipliers",  # (3 nc,)
    "row_index",  # (3 nc, 2) int: contact and basis row of each constraint row
    "permutation",  # (3 nc,) int
    # Runge-Kutta
    "state",  # (ny,) at the start of the step: q, v, location, quadratures
    "stage_state",  # (ny,)
    "new_state",  # (ny,)
    "next_state",  # (ny,) start of the next step, and its slope, while outputs of this one are written
    "next_slope",  # (ny,)
    "slopes",  # (stages, ny)
    "coefficients",  # (stages, stages)
    "nodes",  # (stages,)
    "weights_error",  # (2, stages)
    "q",  # (nq,) handed to Pinocchio
    "v",  # (nv,)
    "scale",  # (2,) rtol, atol
    "absolute",  # (ny,) absolute tolerance of each component; 0 leaves it out of the norm
    # scratch
    "system",  # (4, 8)
    "vectors",  # (16, 3)
    "local",  # (10, 3)
    "work",  # (nv,)
    "correction_q",  # (nv,)
    "correction_v",  # (nv,)
    "dense",  # (DENSE_ROWS, ny) coefficients of the interpolant
    "dense_weights",  # (DENSE_ROWS, stages + 1)
    "counters",  # (COUNTERS_SIZE,) int
    # outputs
    "output_times",  # (OUTPUT_COUNT,) s
    "recorded_reals",  # (BLOCK, ROW_WIDTH) rows, see `recording`
    "recorded_integers",  # (BLOCK, ...) int
    # guarded joint coordinates, rows nc .. nc + ng of the contacts' arrays: see `dynamics.joints`
    "guard_count",  # (1,) int: ng
    "guard_int",  # (ng, GUARD_INTS) int
    "guard_real",  # (ng, GUARD_REALS)
    # resistances to spinning and rolling, rows nc + ng .. nc + ng + nr: see `dynamics.resistance`
    "resistance_count",  # (1,) int: nr
    # least and largest margins of a step's stages, and one choice among redundant forces
    "lowest",  # (nc + ng + nr, MARGINS_PER_CONTACT)
    "highest",  # (nc + ng + nr, MARGINS_PER_CONTACT)
    "across",  # (2 (nc + ng + nr) + 1, POLYNOMIAL_SIZE): shares of a step, v_c across directions and along, see `steps`
    "reference",  # (nc + ng + nr, 3): force along the basis about which the least-norm solution is taken
    # where the reference follows loads and time: see `equations`
    "reference_start",  # (nc + ng + nr, 3) at zero loads and REFERENCE_TIME
    "reference_rate",  # (nc + ng + nr, 3)
    "reference_slope",  # (2, 3 (nc + ng + nr), nv)
    # margins along a step: at which shares of it, the evaluations' statuses, and the margins
    "scan_shares",  # (SCAN_ROOM,)
    "scan_status",  # (SCAN_ROOM,) int
    "scan_margins",  # (SCAN_ROOM, nc + ng + nr, MARGINS_PER_CONTACT)
)

# one integer constant a slot, for the kernels
(
    SIZES,
    SCALARS,
    CALLBACK,
    MASS,
    PARENTS,
    NLE,
    JACOBIAN,
    JOINT_ADDRESSES,
    GRAVITY,
    TAU,
    DAMPING,
    JOINT_TABLE,
    CONTACT_INT,
    CONTACT_REAL,
    SIDE_INT,
    SIDE_SHAPE,
    SIDE_DOMAIN,
    SIDE_BASE,
    SIDE_MOTION,
    SIDE_MOTION_PARAMETERS,
    SUPPORT,
    FRAMES,
    DERIVATIVES,
    BASIS,
    SLIP,
    GAPS,
    RATES,
    BIAS,
    ROWS,
    FORCE,
    RELATIVE_ACCELERATION,
    MARGINS,
    LOCATION,
    FACTOR,
    ACCELERATION,
    FREE_ACCELERATION,
    CONSTRAINT_ROWS,
    WHITENED_ROWS,
    WHITENED_FORCES,
    DELASSUS,
    MULTIPLIERS,
    ROW_INDEX,
    PERMUTATION,
    STATE,
    STAGE_STATE,
    NEW_STATE,
    NEXT_STATE,
    NEXT_SLOPE,
    SLOPES,
    COEFFICIENTS,
    NODES,
    WEIGHTS_ERROR,
    Q,
    V,
    SCALE,
    ABSOLUTE,
    SYSTEM,
    VECTORS,
    LOCAL,
    WORK,
    CORRECTION_Q,
    CORRECTION_V,
    DENSE,
    DENSE_WEIGHTS,
    COUNTERS,
    OUTPUT_TIMES,
    RECORDED_REALS,
    RECORDED_INTEGERS,
    GUARD_COUNT,
    GUARD_INT,
    GUARD_REAL,
    RESISTANCE_COUNT,
    LOWEST,
    HIGHEST,
    ACROSS,
    REFERENCE,
    REFERENCE_START,
    REFERENCE_RATE,
    REFERENCE_SLOPE,
    SCAN_SHARES,
    SCAN_STATUS,
    SCAN_MARGINS,
) = range(len(SLOTS))
TABLE_SIZE = len(SLOTS)

# sizes
NQ, NV, NC, NJOINTS, NBLOCKS, NSTAGES, NWORK, NY = range(8)

# scalars: of the last evaluation and step, then what steps are controlled by (times and steps in s);
# DIP is the part of a margin's change over a step by which it may dip between two stages, TURNING_RATE that of the
# slowest slip, by friction, at the accepted state, 1 / s, BAD_TORQUE the user's torque that was not finite, else 0, and
# BAD_TIME when that was; VELOCITY_LEFT: what the last projection leaves of velocities that are to be zero
(
    TIME,
    STEP,
    ERROR_NORM,
    GAP_RESIDUAL,
    VELOCITY_RESIDUAL,
    CORRECTION_SIZE,
    NOW,
    NEXT_TIME,
    NEXT_STEP,
    END,
    NEXT_OUTPUT,
    MAX_STEP,
    FIXED_STEP,
    FLOOR,
    ERROR_ORDER,
    LAST_ERROR,
    SLOWEST,
    DENSE_START,
    DENSE_STEP,
    HAS_REFERENCE,
    REFERENCE_MOVES,
    REFERENCE_TIME,
    DIP,
    TURNING_RATE,
    BAD_TORQUE,
    BAD_TIME,
    VELOCITY_LEFT,
) = range(27)
SCALARS_SIZE = 27

# contact_int; from MODE to FROZEN what a State keeps of it
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
    UNILATERAL,
    CLOSED_FORM,
    ANISOTROPIC,
    SPINNING_ROW,
    ROLLING_ROW,
    OWNER,
) = range(17)
CONTACT_INTS = 17
# contact_int[ANISOTROPIC]: friction alike in all directions, or along a tangent of body 1 or body 2 and across it
ISOTROPIC, ALONG_BODY_1, ALONG_BODY_2 = range(3)
# contact_int[SPINNING_ROW], contact_int[ROLLING_ROW]: rows of a contact's resistances among all, 0 for none;
# contact_int[OWNER]: of a resistance's row, its contact

# contact_real; MU is the coefficient as slip starts, MU_FAST that of fast slip, MU_NOW that of the last evaluation;
# coefficients of two directions are along the first, times ASPECT across it.
# HULL_X to HULL_Z and EXTENT: centre (frame of contour 1) and radius in m of a ball in which contour 1 lies. While
# open: bounds of APPROACH_SPEED in m/s, TURNING in rad/s and BENDING in m/s^2, see `integration.approach`; SPEEDING in
# m/s^2: how much that speed changed in the last step that might have touched; FLAT: whether contour 2 is a plane that
# no motion drives.
# LIMIT_SLACK is the part of the static limit by which friction may exceed it before stick ends.
# DOMAIN is the distance of the location from the nearest end of its domain, negative outside;
# LAST_NORMAL is n at the last accepted state, by which crossing curves tell their sides apart, NEXT_NORMAL that of the
# state about to be accepted; START_SPEED and _RATE are those of 3D slip there, infinite where there is none.
# A frozen slip direction is DIRECTION + p(s) ACROSS with p of the coefficients POLYNOMIAL.. in s = (t - START) / SPAN;
# vectors in world axes.
(
    MU,
    MU_STATIC,
    LIMIT_SLACK,
    MU_FAST,
    MU_NOW,
    STRIBECK_SPEED,
    STRIBECK_EXPONENT,
    VISCOUS,
    SPINNING,
    ROLLING,
    ASPECT,
    STRETCH_11,
    STRETCH_12,
    STRETCH_22,
    LENGTH,
    CONDITION,
    NORMAL_1,
    NORMAL_2,
    SLIP_SPEED,
    SLIP_RATE,
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
    START,
    SPAN,
    DIRECTION_X,
    DIRECTION_Y,
    DIRECTION_Z,
    ACROSS_X,
    ACROSS_Y,
    ACROSS_Z,
    POLYNOMIAL,
) = range(48)
POLYNOMIAL_SIZE = 5
# from START on
FROZEN_COLUMNS = 8 + POLYNOMIAL_SIZE
CONTACT_REALS = POLYNOMIAL + POLYNOMIAL_SIZE

# side_int
(
    KIND,
    CHART,
    JOINT,
    MOTION_KIND,
    TIME_DEPENDENT,
    POOL_ADDRESS,
    POOL_SIZE,
    SUPPORT_SIZE,
    MOTION_POOL,
    MOTION_POOL_SIZE,
) = range(10)
SIDE_INTS = 10

# guard_int: indices in q and v, direction of motion (0 without dry friction), end at which it is held (0: at none)
GUARD_Q, GUARD_V, GUARD_SIGN, GUARD_END = range(4)
GUARD_INTS = 4
# guard_real: range of the dry friction force, and of q
LOW_FORCE, HIGH_FORCE, LOW_END, HIGH_END = range(4)
GUARD_REALS = 4

# margins: positive while the mode holds
NORMAL_MARGIN, FRICTION_MARGIN, GAP_MARGIN, SPEED_MARGIN, DOMAIN_MARGIN = range(5)
MARGINS_PER_CONTACT = 5

# modes, as reported in `track.mode`
FREE, FRICTIONLESS, STICK, SLIPPING = -1, 0, 1, 2

# what an evaluation returns
OK, EVENT, LOCATION_FAILED, SINGULAR, MASS_NOT_POSITIVE, NO_FORCE, NOT_FINITE, TOO_LONG = range(8)

# counters, and settings that are integers; ROW_RANK is that of the last evaluation's constraint rows, 0 if not found,
# and LOST_POSITIVITY 1 if there are forces, but those from which compliances would lead away
(
    NEWTON_COUNT,
    CLOSED_COUNT,
    EVALUATION_COUNT,
    STEP_COUNT,
    REJECTED_COUNT,
    ATTEMPT_LIMIT,
    STALLED,
    ALARM,
    FAILURE,
    ESTIMATE_AFTER,
    EXTRA_STAGES,
    CHARTED,
    DENSE_NESTED,
    OUTPUT_COUNT,
    OUTPUTS_DONE,
    RECORDED,
    RECORD_STEPS,
    ROW_WIDTH,
    ROW_COUNT,
    ROWS_FORMED,
    DRIVES_EVALUATED,
    STIFF_STEPS,
    PATIENCE,
    ROW_RANK,
    PARENT_AXES,
    SCAN_COUNT,
    LOST_POSITIVITY,
) = range(27)
COUNTERS_SIZE = 27
# places along a step that are evaluated by one call, and the gap beyond the end of a contour, where nothing can touch
SCAN_ROOM = 9
NOTHING_THERE = 1e300

# what kernels call by address: a Python function to be asked first, or 0, and its arguments; one or two of Pinocchio's
# algorithms and theirs; the result that means failure; the evaluation and the address of the table that it is given;
# the algorithm that gives places, velocities and Jacobians alone; where the rows of `PinocchioCalls.native` are, or 0,
# and the model, with the two words that it begins with
(
    ASKED,
    ASKED_WITH,
    CALLED,
    CALLED_WITH,
    CALLED_NEXT,
    CALLED_NEXT_WITH,
    CALL_FAILED,
    EVALUATION,
    OWN_TABLE,
    PLACED,
    PLACED_WITH,
    NATIVE,
    MODEL,
    MODEL_SIZE,
    MODEL_JOINTS,
) = range(15)
CALLBACK_SIZE = 15
