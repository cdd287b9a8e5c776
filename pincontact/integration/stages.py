"""The states of a Runge-Kutta step: handed to Pinocchio, made from slopes, corrected.

State: y = (q, w, contact coordinates, quadratures). q is ambient; w is v in the axes of the joints' parents (see
`manifold`) where the counter PARENT_AXES is set, as it is for the pairs, and v itself elsewhere. The contact
coordinates ride along as the start of Newton's iteration and take part in the error norm; the quadratures are the
powers of friction, prescribed motions, torques and damping when energies are recorded.
"""

from __future__ import annotations

import math

from ..arrays import REALS, array_type
from ..callback import kernel_caller, separate_kernel
from ..contours.charts import is_across_pole, turned_back
from ..dynamics.equations import dry_friction_force
from ..dynamics.manifold import configuration_rate, move, normalize, rate_in_parent_axes, to_joint_axes, to_parent_axes
from ..dynamics.resistance import count_items, pulls
from ..dynamics.sliding import resists_viscously, viscous_force
from ..geometry.small import dot
from ..jit import INTEGER, NOTHING, REAL, entry_kernel, kernel
from ..layout import (
    CHART,
    DAMPING_WORK,
    DRIVE_WORK,
    FREE,
    FRICTION_WORK,
    JOINT_V,
    KIND,
    MAX_STAGES,
    MODE,
    MOTION_KIND,
    NUMBER_OF_WORKS,
    OWNER,
    SLIPPING,
    STICK,
    SYSTEM,
    TIME_DEPENDENT,
    TORQUE_WORK,
    system_at,
)
from ..workspace import flat

_call_evaluation = kernel_caller(INTEGER, SYSTEM.type, REAL, INTEGER)


@kernel
def evaluate(system, time, part):
    """Pinocchio's terms and one evaluation at (q, v), by a kernel of its own; arguments and status are its."""
    return _call_evaluation(system.callback.evaluation, system, time, part)


@kernel
def hand_over_start(system):
    """The state at the step's start, STATE, becomes STAGE_STATE, and is handed over."""
    state, stage_state = system.state, system.stage_state
    for i in range(system.sizes.ny):
        stage_state[i] = state[i]
    hand_over(system, stage_state)


@separate_kernel(NOTHING, SYSTEM.type, array_type(REALS, 1))
def hand_over(system, state):
    """Give a state to Pinocchio (normalised) and to the search for contact coordinates."""
    sizes = system.sizes
    nq, nv, nc = sizes.nq, sizes.nv, sizes.nc
    q, v, blocks = system.q, system.v, system.joint_table
    normalize(blocks, state, q)
    if system.counters.parent_axes != 0:
        to_joint_axes(blocks, q, state[nq : nq + nv], v)
    else:
        for k in range(nv):
            v[k] = state[nq + k]
    location, u = flat(system.location), state[nq + nv : nq + nv + 4 * nc]
    if system.counters.charted == 0:
        for k in range(4 * nc):
            location[k] = u[k]
        return
    side_int = system.side_int
    side_shape = system.side_shape
    for side in range(2 * nc):
        kind, chart, i = side_int[side, KIND], side_int[side, CHART], 2 * side
        # within a long step parameters run on over a pole of their chart
        location[i], location[i + 1] = turned_back(kind, chart, side_shape[side], u[i], u[i + 1])


@separate_kernel(NOTHING, SYSTEM.type, array_type(REALS, 1), array_type(REALS, 1))
def fill_slope(system, state, slope):
    """y' from the last evaluation."""
    sizes = system.sizes
    nq, nv, nc = sizes.nq, sizes.nv, sizes.nc
    q, v, blocks = system.q, system.v, system.joint_table
    configuration_rate(blocks, state, q, v, slope)
    acceleration = system.acceleration
    if system.counters.parent_axes != 0:
        rate_in_parent_axes(blocks, q, v, acceleration, slope[nq : nq + nv])
    else:
        for k in range(nv):
            slope[nq + k] = acceleration[k]
    rates, u, out = flat(system.rates), state[nq + nv :], slope[nq + nv :]
    for k in range(4 * nc):
        out[k] = rates[k]
    if system.counters.charted != 0:
        side_int = system.side_int
        side_shape = system.side_shape
        for side in range(2 * nc):
            i = 2 * side + 1
            if is_across_pole(side_int[side, KIND], side_int[side, CHART], side_shape[side], u[i]):
                out[i] = -rates[i]
    if sizes.nwork > 0:
        _powers(system, nv, nc, slope[nq + nv + 4 * nc :])


@kernel
def is_driven(side_int, c):
    """Whether a contour of contact c has a prescribed motion or shape."""
    for side in range(2 * c, 2 * c + 2):
        if side_int[side, MOTION_KIND] != 0 or side_int[side, TIME_DEPENDENT] != 0:
            return True
    return False


@kernel
def _powers(system, nv, nc, out):
    """Powers in W: contact force on v_c, contact force of prescribed motions, user's torques, joints' damping and dry
    friction.

    Torques that resist turning count with the contact forces.
    """
    n, ng = count_items(system), system.joint_count[0]
    contact_int = system.contact_int
    basis = system.basis
    slip = system.slip
    force = system.force
    rows = system.rows
    v, tau, damping = system.v, system.tau, system.damping
    for i in range(NUMBER_OF_WORKS):
        out[i] = 0.0
    for c in range(n):
        if contact_int[c, MODE] == FREE or nc <= c < nc + ng:
            continue
        # accelerations have dry friction change its sign with the load, and so are smooth
        owner = contact_int[c, OWNER] if c >= nc + ng else c
        turned = contact_int[c, MODE] == SLIPPING and pulls(contact_int, force, owner)
        driven = is_driven(system.side_int, owner)
        for row in range(3):
            component, on_joints = force[c, row], 0.0
            if turned and row < 2:
                component = -component
                if resists_viscously(contact_int[c], system.contact_real[c]):
                    component += 2.0 * viscous_force(system.contact_real[c], basis[c, row], slip[c])
            on_slip = component * dot(basis[c, row], slip[c])
            if row < 2 and contact_int[c, MODE] != STICK:
                # what is held does no work; its small v_c within a step would only feed the error estimate
                out[FRICTION_WORK] += on_slip
            if driven:
                for k in range(nv):
                    on_joints += rows[c, row, k] * v[k]
                out[DRIVE_WORK] += component * on_joints - on_slip
    joint_int = system.joint_int
    for g in range(ng):
        dry = dry_friction_force(contact_int[nc + g, MODE], joint_int[g], system.joint_real[g])
        out[DAMPING_WORK] += dry * v[joint_int[g, JOINT_V]]
    for k in range(nv):
        out[TORQUE_WORK] += tau[k] * v[k]
        out[DAMPING_WORK] -= damping[k] * v[k] * v[k]


@separate_kernel(NOTHING, SYSTEM.type, INTEGER)
def build_state(system, index):
    """State number `index` of the step: y + h sum_j a_ij k_j; index > 0, the number of stages gives the new state."""
    sizes = system.sizes
    ny = sizes.ny
    state, out = system.state, system.stage_state
    slopes = system.slopes
    weights = system.coefficients[index]
    scalars = system.scalars
    step = scalars.step
    weight, slope = weights[0], slopes[0]
    for i in range(ny):
        out[i] = weight * slope[i]
    for j in range(1, index):
        weight = weights[j]
        if weight != 0.0:
            slope = slopes[j]
            for i in range(ny):
                out[i] += weight * slope[i]
    for i in range(ny):
        out[i] = state[i] + step * out[i]
    if index == sizes.nstages:
        new_state = system.new_state
        for i in range(ny):
            new_state[i] = out[i]
    hand_over(system, out)


@separate_kernel(REAL, SYSTEM.type, INTEGER)
def error_norm(system, last):
    """Norm of the step's error estimate, 1 at the tolerance; stages 0 .. last are known.

    Two estimates are blended as for DOP853 (Hairer, Norsett, Wanner, Sec. II.10); a pair with a single one has zero
    weights in the second.
    """
    sizes = system.sizes
    ny = sizes.ny
    state, new_state = system.state, system.new_state
    slopes = system.slopes
    weights = system.weights_error
    absolute = system.absolute
    relative = system.scale[0]
    first, second = 0.0, 0.0
    count = 0
    for i in range(ny):
        if absolute[i] == 0.0:
            continue
        count += 1
        a, b = 0.0, 0.0
        for j in range(last + 1):
            a += weights[0, j] * slopes[j, i]
            b += weights[1, j] * slopes[j, i]
        scale = absolute[i] + relative * max(abs(state[i]), abs(new_state[i]))
        first += (a / scale) ** 2
        second += (b / scale) ** 2
    step = abs(system.scalars.step)
    if first == 0.0:
        return 0.0
    return step * first / math.sqrt((first + 0.01 * second) * count)


@entry_kernel(INTEGER)
def load_state(address):
    """Hand over STAGE_STATE to Pinocchio and the search for contact coordinates."""
    system = system_at(address)
    hand_over(system, system.stage_state)


@separate_kernel(REAL, SYSTEM.type)
def correct_state(system):
    """Apply the last corrections to STAGE_STATE: v first (its rows belong to the old q), then q; take the contact
    coordinates found, moved along with q. Returns the largest change of q and v in tolerances, infinite without any.
    """
    nq, state, q, v = system.sizes.nq, system.stage_state, system.q, system.v
    absolute, relative = system.absolute, system.scale[0]
    change, correction = 0.0, system.correction_v
    for k in range(system.sizes.nv):
        change = max(change, _in_tolerances(correction[k], absolute[nq + k] + relative * abs(v[k])))
        v[k] += correction[k]
    moved = system.slopes[MAX_STAGES - 1]
    move(system.joint_table, q, system.correction_q, moved, q)
    for i in range(nq):
        change = max(change, _in_tolerances(moved[i], absolute[i] + relative * abs(state[i])))
    keep_places(system)
    keep_velocity(system, state)
    return change


@kernel
def keep_places(system):
    """The configuration and the contact coordinates of the last evaluation become those of STAGE_STATE."""
    sizes, state, q, location = system.sizes, system.stage_state, system.q, flat(system.location)
    for i in range(sizes.nq):
        state[i] = q[i]
    for k in range(4 * sizes.nc):
        state[sizes.nq + sizes.nv + k] = location[k]


@kernel
def _in_tolerances(change, allowed):
    # a quotient of zeros would be no number, and which one of two numbers is larger then depends on their order
    if change == 0.0:
        return 0.0
    return abs(change) / allowed if allowed > 0.0 else math.inf


@kernel
def keep_velocity(system, state):
    """The velocity that Pinocchio has becomes that of the state, whose configuration it has, too."""
    sizes = system.sizes
    nq, nv = sizes.nq, sizes.nv
    v, out = system.v, state[nq : nq + nv]
    if system.counters.parent_axes != 0:
        to_parent_axes(system.joint_table, system.q, v, out)
    else:
        for k in range(nv):
            out[k] = v[k]
