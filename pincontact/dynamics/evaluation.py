"""One evaluation: from Pinocchio's terms at (q, v) to accelerations, contact forces and rates of contact coordinates.

The protocol, in the arrays of `layout.SYSTEM`. Loaded before the call: `q`, `v`, a guess in `location`, the modes in
`contact_int`, and `tau` unless a control fills it. `evaluate_state(address, time, part)` then calls in turn

1. the user's control and motions, where there are any (`callback.asked`): `tau`, `side_motion`; for PLACES_OF_ALL,
   motions alone matter;
2. Pinocchio's algorithms (see `pinocchio_calls`): `mass`, `nle`, `jacobian`, and the joints' poses and velocities;
3. `evaluate_contacts`: `frames`, `location`, `derivatives`, `basis`, `slip`, `gaps`, `rates`, `bias`, `rows`;
4. `evaluate_dynamics`: `factor`, `free_acceleration`, `acceleration`, `force`, `event_functions`, `row_index`,
`multipliers`.

What is valid afterwards, where the status is OK or EVENT:

- part 0: everything, but for `rows` of open contacts;
- KINEMATICS_OF_ALL: 1 to 3 for all contacts, `rows` of open ones too; what 4 writes stays as it was;
- VELOCITIES_OF_ALL: the same, with mass, Jacobians and poses of the evaluation before, which was at the same q;
- PLACES_OF_ALL: the same without `mass`, `nle` and accelerations: no `bias`, nor the last rows of `frames`;
- PLACES_OF_CLOSED: as PLACES_OF_ALL, but no `rows` of open contacts.

With NO_FORCE the kinematics, `factor` and `free_acceleration` are valid, and nothing after them. With any other status
the evaluation broke off in the contact, or the step, that it speaks of. An open contact without a nearest point does
not end it: its gap is NOTHING_THERE. `contact_corrections` reads the last evaluation's rows, gaps, v_c and factor, and
overwrites `whitened_rows`, `multipliers` and `row_index`.
"""

from __future__ import annotations

import math

from ..arrays import address as address_in
from ..callback import call_by_address, call_python, kernel_caller, separate_kernel
from ..constraints.kinematics import constraint_rows, contact_kinematics, distance_to_ends
from ..contours.motion import call_motion
from ..friction.ellipse import set_friction_scaling
from ..geometry.carriers import ORIGIN, add_drive, place_on_joint, rest_in_world
from ..geometry.patterns import ON_CURVE
from ..geometry.small import dot
from ..jit import BOOLEAN, INTEGER, REAL, entry_kernel, inlined_kernel, kernel
from ..layout import (
    ALONG_BODY_1,
    ANISOTROPIC,
    CHART,
    DOMAIN,
    EVENT,
    EVENTS_PER_CONTACT,
    FREE,
    HIGH_END,
    JOINT,
    JOINT_END,
    JOINT_Q,
    JOINT_V,
    K1,
    LENGTH,
    LOW_END,
    MASS_NOT_POSITIVE,
    MODE,
    MOTION_EVALUATOR,
    MOTION_KIND,
    MOTION_POOL,
    MOTION_POOL_SIZE,
    NEXT,
    NOT_FINITE,
    NOTHING_THERE,
    OK,
    PATTERN,
    SAME_PLACE,
    SYSTEM,
    TIME_DEPENDENT,
    system_at,
)
from ..linalg import factorize_tree, inner, unwhiten, whiten
from ..workspace import integer_matrix_at, integers_at, matrix_at, reals_at
from .equations import add_viscous_loads, contact_dynamics, dry_friction_force, list_constraints, solve_for_rows
from .pinocchio_calls import NATIVE_COLUMNS, NATIVE_ROWS
from .resistance import count_items, resistance_kinematics, resists

# Parts that an evaluation may be confined to.
KINEMATICS_OF_ALL, PLACES_OF_CLOSED, PLACES_OF_ALL, VELOCITIES_OF_ALL = 1, 2, 3, 4
_call_control = kernel_caller(INTEGER, REAL, *(INTEGER,) * 5)
# Part of the gaps that a correction may leave for round-off.
_LEFT = 1e-6


@entry_kernel(INTEGER, REAL, INTEGER)
def evaluate_state(address, time, part):
    """Pinocchio's terms and one evaluation at (q, v); a status of `layout`. part: see above, or 0 for everything."""
    system = system_at(address)
    system.scalars.time = time
    if not ask_user(system, part) or not call_pinocchio(system, part):
        return NOT_FINITE
    system.counters.evaluation_count += 1
    with_rows = part in (KINEMATICS_OF_ALL, PLACES_OF_ALL, VELOCITIES_OF_ALL)
    status = evaluate_contacts(system, with_rows, part not in (PLACES_OF_CLOSED, PLACES_OF_ALL))
    return evaluate_dynamics(system) if status == OK and part == 0 else status


@kernel
def ask_user(system, part):
    """Call the user's control and prescribed motions, where there are any that matter; whether all torques are
    finite."""
    callback = system.callback
    if callback.asked == 0 or (part == PLACES_OF_ALL and callback.asked_for_places == 0):
        return True
    return ask_for_torques(system, callback)


@kernel
def call_pinocchio(system, part):
    """Pinocchio's algorithms for a part of an evaluation, by address or through Python; whether they have succeeded."""
    callback = system.callback
    places = part in (PLACES_OF_CLOSED, PLACES_OF_ALL)
    # C++ would throw at a model that has got another size since, and nothing here catches that; Python's calls raise
    known = callback.native != 0
    if known:
        words = integers_at(callback.model, 2)
        known = words[0] == callback.model_size and words[1] == callback.model_joints
    if known:
        native = integer_matrix_at(callback.native, NATIVE_ROWS, NATIVE_COLUMNS)
        first, end = (2, 3) if places else (0, 2)
        if part == VELOCITIES_OF_ALL:
            # all but the mass matrix, the Jacobians and the poses
            end = 1
        for i in range(first, end):
            call = native[i]
            call_by_address(call[0], call[1], call[2], call[3], call[4], call[5])
        return True
    if places:
        return call_python(callback.placed, callback.placed_with, callback.call_failed)
    if not call_python(callback.called, callback.called_with, callback.call_failed):
        return False
    return call_python(callback.called_next, callback.called_next_with, callback.call_failed)


@kernel
def ask_for_torques(system, calls):
    """Call the user's control, the compiled one where there is one; whether all torques are finite. calls: a record
    with `control` and `asked`."""
    sizes, time = system.sizes, system.scalars.time
    q, v, tau = address_in(system.q), address_in(system.v), address_in(system.tau)
    answered = calls.control != 0 and _call_control(calls.control, time, q, v, tau, sizes.nq, sizes.nv) != 0
    if not answered:
        answered = call_python(calls.asked, calls.asked_with, calls.call_failed)
    return answered and torques_finite(system, time)


@kernel
def torques_finite(system, time):
    """Whether the user's torques are numbers to go on with; else the first that is not is noted."""
    nv = system.sizes.nv
    tau, scalars = system.tau, system.scalars
    for k in range(nv):
        if not abs(tau[k]) < math.inf:
            scalars.bad_torque, scalars.bad_time = tau[k], time
            return False
    return True


@separate_kernel(INTEGER, SYSTEM.type, BOOLEAN, BOOLEAN)
def evaluate_contacts(system, with_rows, with_bias):
    """Kinematics of all contacts at the guess in `location`; with_rows: constraint rows also where no force may act;
    with_bias: what accelerations of v_c have besides the rows.

    Returns the first status that is not OK.
    """
    for c in range(system.sizes.nc):
        place_side(system, 2 * c)
        place_side(system, 2 * c + 1)
        location = system.location[c]
        start1, start2, start3, start4 = location[0], location[1], location[2], location[3]
        status = contact_kinematics(system, c, with_bias)
        if status == OK:
            if with_rows or system.contact_int[c, MODE] != FREE:
                form_rows(system, c)
            measure_ends(system, c)
        elif system.contact_int[c, MODE] == FREE:
            location[0], location[1], location[2], location[3] = start1, start2, start3, start4
            leave_apart(system, c)
        else:
            return status
    if system.counters.paired != 0:
        leave_taken_places(system)
    return OK


@kernel
def place_side(system, side):
    """Pose, velocity and bias acceleration of a side's contour, into `frames`."""
    integers, frame, vectors = system.side_int[side], system.frames[side], system.vectors
    joint = integers[JOINT]
    if joint != 0:
        found = system.joint_addresses[joint]
        place_on_joint(
            system.side_base[side],
            matrix_at(found[0], 3, 3),
            reals_at(found[1], 3),
            reals_at(found[2], 6),
            reals_at(found[3], 6),
            system.gravity,
            frame,
            vectors,
        )
    if integers[MOTION_KIND] != 0 or integers[TIME_DEPENDENT] != 0:
        system.counters.drives_evaluated += 1
    if integers[MOTION_KIND] != 0:
        if joint == 0:
            rest_in_world(system.side_base[side], frame)
        motion = system.side_motion[side]
        call_motion(
            integers[MOTION_EVALUATOR],
            integers[MOTION_KIND],
            address_in(system.side_motion_parameters[side]),
            integers[MOTION_POOL],
            integers[MOTION_POOL_SIZE],
            system.scalars.time,
            address_in(motion),
        )
        add_drive(motion, frame, vectors)


@kernel
def leave_apart(system, c):
    """An open contact without a nearest point (parallel lines, a focus) is beyond all ends for the moment."""
    system.contact_real[c, DOMAIN], system.gaps[c, 0] = -1.0, NOTHING_THERE
    for a in range(4):
        system.rates[c, a] = 0.0
    for row in range(3):
        system.slip[c, row] = system.bias[c, row] = 0.0
        for k in range(system.sizes.nv):
            system.rows[c, row, k] = 0.0


@kernel
def leave_taken_places(system):
    """An open contact that is where another one of the same contours is has no nearest point of its own."""
    contact_int, gaps = system.contact_int, system.gaps
    for c in range(system.sizes.nc):
        other = contact_int[c, NEXT]
        while contact_int[c, MODE] == FREE and other != c:
            first = other < c or contact_int[other, MODE] != FREE
            if first and gaps[other, 0] < NOTHING_THERE and are_at_one_place(system, c, other):
                leave_apart(system, c)
                break
            other = contact_int[other, NEXT]


@kernel
def are_at_one_place(system, c, other):
    """Whether two contacts, of the same contours in any order, have the same points."""
    same = SAME_PLACE * system.contact_real[c, LENGTH]
    if not abs(system.gaps[c, 0] - system.gaps[other, 0]) < same:
        return False
    square = 0.0
    for i in range(3):
        between = 0.0
        for body in range(2):
            one, two = 2 * c + body, 2 * other + body
            between += system.frames[one, ORIGIN, i] - system.frames[two, ORIGIN, i]
            between += system.derivatives[one, 0, i] - system.derivatives[two, 0, i]
        square += between * between
    return 0.25 * square < same * same


@kernel
def measure_ends(system, c):
    """The distance of the contact coordinates from the nearest end of a domain."""
    distance = math.inf
    for body in range(2):
        u, side = system.location[c, 2 * body : 2 * body + 2], 2 * c + body
        dimension, chart = system.contact_int[c, K1 + body], system.side_int[side, CHART]
        distance = distance_to_ends(dimension, u, chart, system.side_domain[side], distance)
    system.contact_real[c, DOMAIN] = distance


@inlined_kernel
def form_rows(system, c):
    """Constraint rows of a contact and of its resistances, and friction-ellipse scaling along body 1's tangent."""
    integers = system.contact_int[c]
    system.counters.rows_formed += 1
    if integers[ANISOTROPIC] == ALONG_BODY_1:
        tangent, basis = system.derivatives[2 * c, 1], system.basis[c]
        set_friction_scaling(system.contact_real[c], dot(basis[0], tangent), dot(basis[1], tangent))
    constraint_rows(system, c)
    if resists(integers):
        resistance_kinematics(system, c)


@inlined_kernel
def evaluate_dynamics(system):
    """Factor the mass matrix, then accelerations, forces and event functions in the present modes."""
    if not factorize_tree(system.mass, system.parents, system.sizes.nv, system.factor):
        return MASS_NOT_POSITIVE
    read_joints(system)
    accelerate_freely(system)
    status = contact_dynamics(system)
    if status > EVENT:
        # neither accelerations nor event functions were written
        return status if _finite(system.free_acceleration, system.sizes.nv) else NOT_FINITE
    event_functions, lowest, highest = system.event_functions, system.lowest, system.highest
    for c in range(count_items(system)):
        for i in range(EVENTS_PER_CONTACT):
            lowest[c, i] = min(lowest[c, i], event_functions[c, i])
            highest[c, i] = max(highest[c, i], event_functions[c, i])
    return status if _finite(system.acceleration, system.sizes.nv) else NOT_FINITE


@kernel
def accelerate_freely(system):
    """a_free = M^-1 (tau - damping v - nle + viscous friction + dry friction of joints that move)."""
    nv, free = system.sizes.nv, system.free_acceleration
    for k in range(nv):
        free[k] = system.moves[k] * (system.tau[k] - system.damping[k] * system.v[k] - system.nle[k])
    add_viscous_loads(system, free)
    for g in range(system.joint_count[0]):
        limit = system.joint_int[g]
        free[limit[JOINT_V]] += dry_friction_force(
            system.contact_int[system.sizes.nc + g, MODE], limit, system.joint_real[g]
        )
    whiten(system.factor, system.parents, nv, free, free)
    system.scalars.free_size = math.sqrt(inner(free, free, nv))
    unwhiten(system.factor, system.parents, nv, free, free)


@kernel
def read_joints(system):
    """Velocities and positions of joint coordinates with limits or dry friction, in the places of v_c and gaps."""
    for g in range(system.joint_count[0]):
        i, limit = system.sizes.nc + g, system.joint_int[g]
        system.slip[i, 2], system.gaps[i, 0] = system.v[limit[JOINT_V]], system.q[limit[JOINT_Q]]


@kernel
def _finite(a, n):
    total = 0.0
    for k in range(n):
        total += a[k]
    return total - total == 0.0


@separate_kernel(INTEGER, SYSTEM.type)
def contact_corrections(system):
    """Corrections of q and v in the mass metric from the last evaluation (its rows, gaps, v_c and factor of M).

    Position: gaps of closed contacts to zero. Velocity: normal components of v_c, and tangential ones in stick.
    The least change in the norm of M: -M^-1 R^T (R M^-1 R^T)^+ residual. Returns the number of constraint rows.
    """
    scalars = system.scalars
    count, _ = list_constraints(system)
    # an evaluation of kinematics alone has left them out
    read_joints(system)
    measure_joint_gaps(system)
    measure_residuals(system, count)
    scalars.velocity_left = 0.0
    if _least_correction(system, count, system.correction_v) < count:
        # redundant: whether they can be met together is another question
        scalars.velocity_left = velocity_left(system, count)
    normals = move_normals_to_front(system, count)
    if _least_correction(system, normals, system.correction_q) < normals and let_joints_move(system, count):
        _least_correction(system, normals, system.correction_q)
    largest = 0.0
    for k in range(system.sizes.nv):
        largest = max(largest, abs(system.correction_q[k]))
    scalars.correction_size = largest
    return count


@kernel
def measure_joint_gaps(system):
    """Gaps of held joint coordinates: to the end on which one rests; one that friction holds rests anywhere."""
    for g in range(system.joint_count[0]):
        end, i = system.joint_int[g, JOINT_END], system.sizes.nc + g
        position = system.gaps[i, 0]
        system.gaps[i, 0] = 0.0
        if end != 0:
            system.gaps[i, 0] = position - system.joint_real[g, LOW_END if end < 0 else HIGH_END]


@kernel
def measure_residuals(system, count):
    """Largest gap and largest velocity residual of the constraint rows; multipliers = minus the velocity residuals."""
    scalars = system.scalars
    scalars.gap_residual = scalars.velocity_residual = 0.0
    for r in range(count):
        c, row = system.row_index[r, 0], system.row_index[r, 1]
        residual = dot(system.basis[c, row], system.slip[c])
        scalars.velocity_residual = max(scalars.velocity_residual, abs(residual))
        system.multipliers[r] = -residual
        if is_normal_row(system.contact_int[c, PATTERN], row):
            scalars.gap_residual = max(scalars.gap_residual, abs(system.gaps[c, 2 - row]))


@kernel
def velocity_left(system, count):
    """The largest component of v_c that the correction of v leaves of those that are to be zero."""
    left = 0.0
    for r in range(count):
        c, row = system.row_index[r, 0], system.row_index[r, 1]
        change = inner(system.rows[c, row], system.correction_v, system.sizes.nv)
        left = max(left, abs(change + dot(system.basis[c, row], system.slip[c])))
    return left


@kernel
def move_normals_to_front(system, count):
    """Whitened rows of normals come first, multipliers = minus their gaps; returns how many there are."""
    normals = 0
    for r in range(count):
        c, row = system.row_index[r, 0], system.row_index[r, 1]
        if is_normal_row(system.contact_int[c, PATTERN], row):
            for k in range(system.sizes.nv):
                system.whitened_rows[normals, k] = system.whitened_rows[r, k]
            system.multipliers[normals] = -system.gaps[c, 2 - row]
            normals += 1
    return normals


@kernel
def let_joints_move(system, count):
    """Whether the last correction of q leaves a gap, though friction holds joints, which it does wherever they are:
    their rows are zero then, and multipliers once more minus the gaps."""
    nc, nv = system.sizes.nc, system.sizes.nv
    held, left = 0, 0.0
    for again in range(2):
        k = 0
        for r in range(count):
            i, row = system.row_index[r, 0], system.row_index[r, 1]
            if not is_normal_row(system.contact_int[i, PATTERN], row):
                continue
            gap = system.gaps[i, 2 - row]
            is_held = nc <= i < nc + system.joint_count[0] and system.joint_int[i - nc, JOINT_END] == 0
            if again == 0:
                held += is_held
                left = max(left, abs(gap + inner(system.rows[i, row], system.correction_q, nv)))
            else:
                system.multipliers[k] = -gap
                for j in range(nv if is_held else 0):
                    system.whitened_rows[k, j] = 0.0
            k += 1
        if held == 0 or left <= _LEFT * system.scalars.gap_residual:
            return False
    return True


@kernel
def is_normal_row(pattern, row):
    return row == 2 or (row == 1 and pattern == ON_CURVE)


@kernel
def _least_correction(system, count, out):
    """out = M^-1 R^T (R M^-1 R^T)^+ multipliers from the whitened rows R; returns their rank."""
    nv, whitened, x = system.sizes.nv, system.whitened_rows, system.multipliers
    rank = solve_for_rows(system, count)
    for k in range(nv):
        value = 0.0
        for r in range(count):
            value += whitened[r, k] * x[r]
        out[k] = value
    unwhiten(system.factor, system.parents, nv, out, out)
    return rank
