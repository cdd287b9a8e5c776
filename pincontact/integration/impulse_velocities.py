"""Relative velocities of contacts in a step of Moreau's method, at its start and as it would go on without impulses.

Velocities of joints are in the axes of the midpoint. The relative velocity u at the step's end is
w_0 + rows (v_1 - v_0) + h bias to second order, or, to first order, w_m + rows (v_1 - v_m) in the midpoint's geometry:
that is the velocity of bodies that are rigid to the last bit, so that redundant contacts can all come to rest, and
impulses change the kinetic energy of just these velocities. counts.rigid says which of them is taken.
"""

from __future__ import annotations

from ..constraints.kinematics import add_rotation_row
from ..geometry.patterns import ON_CURVE
from ..geometry.small import dot
from ..jit import kernel
from ..layout import PATTERN, SUPPORT_SIZE
from ..linalg import inner


@kernel
def rigid_velocity(system, step, c, row):
    """Component of v_c along a basis row at the start's velocity, in the midpoint's geometry."""
    line, v0, middle = system.rows[c, row], step.transported_v, system.v
    value = dot(system.basis[c, row], system.slip[c])
    for k in range(system.sizes.nv):
        value += line[k] * (v0[k] - middle[k])
    return value


@kernel
def start_velocity(system, step, c, row):
    """Component of v_c along a basis row at the step's start."""
    if step.counts.rigid != 0:
        return rigid_velocity(system, step, c, row)
    # the biases of normals hold the normal's own rate, those of tangents do not
    if row == 2:
        return step.start_normal[c, 0]
    if row == 1 and system.contact_int[c, PATTERN] == ON_CURVE:
        return step.start_normal[c, 1]
    return dot(system.basis[c, row], step.start_slip[c])


@kernel
def free_gain(system, step, c, row):
    """What a component of v_c gains over the step if no impulse acts."""
    value = inner(system.rows[c, row], step.change, system.sizes.nv)
    if step.counts.rigid == 0:
        value += step.numbers.h * system.bias[c, row]
    return value


@kernel
def beyond_rigid(system, step, c, row, start, gain):
    """What rigid geometry leaves out of a component of v_c at the step's end, which is start and gain together."""
    return (
        start + gain - inner(system.rows[c, row], step.change, system.sizes.nv) - rigid_velocity(system, step, c, row)
    )


@kernel
def add_turn_row(system, c, axis, factor, out):
    """out += factor times the row of the relative angular velocity of contact c about a basis vector."""
    about = system.basis[c, axis]
    for side in range(2 * c, 2 * c + 2):
        signed = factor if side % 2 == 1 else -factor
        size = system.side_int[side, SUPPORT_SIZE]
        add_rotation_row(signed, system.jacobian, system.support[side], size, about, out)


@kernel
def relative_turning(system, c, axis, quantity):
    """Relative angular velocity (OMEGA), or acceleration at a = 0 (ALPHA), about a basis vector at the midpoint."""
    about = system.basis[c, axis]
    return dot(about, system.frames[2 * c + 1, quantity]) - dot(about, system.frames[2 * c, quantity])
