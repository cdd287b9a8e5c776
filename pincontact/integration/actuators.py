"""PD actuators that act implicitly: stiff gains make no step unstable.

An actuator applies kp (target - q) - kd v. With v_0 and v_1 = v_0 + dv at the ends of a step, e its error at the start
and the displacement h v_0 + (h/2) dv, it contributes over the step

    h [kp (e - (2 w - 1/2) h v_0 - w^2 h dv) - kd (v_0 + w dv)],

whose terms in dv go to the left-hand side: the mass that contacts, limits and dry friction feel is
M + w h kd + w^2 h^2 kp. For the coordinate q + (w - 1/2) h v this is the rule that takes the values at both ends with
weights 1 - w and w, so for w >= 1/2 no gains make it unstable; w = 1/2 is the implicit midpoint rule, w = 1 damps
within one step what is too fast for it. With z = h kd / (2 M_ii), the decay in a step,

    w = 1 / (1 - exp(-z)) - 1 / z = 1/2 + z / 12 - ...

keeps second order, and makes a critically damped joint (kp = kd^2 / (4 M)) decay by exactly exp(-z) in a step. All
actuators share the weight of the fastest decay, since the proof of stability needs a common one.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..arguments import NOT_REAL, real_array
from ..dynamics.joints import joint_locks, joint_of
from ..dynamics.manifold import CIRCLE_BLOCK, VECTOR, configuration_blocks
from ..errors import ArgumentError
from ..jit import kernel

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# Up to here the series of the weight is exact to 1e-13.
_SMALL = 0.1


@kernel
def fitted_weight(z):
    """1 / (1 - exp(-z)) - 1 / z for z >= 0."""
    if z < _SMALL:
        return 0.5 + z * (1.0 / 12.0 + z * z * (z * z / 30240.0 - 1.0 / 720.0))
    return 1.0 / -math.expm1(-z) - 1.0 / z


@kernel
def end_weight(step, mass, h):
    """The weight w of a step of size h; mass: the mass matrix, of which the diagonal is read."""
    fastest = 0.0
    for a in range(step.counts.actuators):
        actuator = step.actuators[a]
        k = actuator.index_v
        if mass[k, k] > 0.0:
            fastest = max(fastest, 0.5 * h * actuator.damping / mass[k, k])
    return fitted_weight(fastest)


@kernel
def _error(step, actuator):
    """Target less coordinate at the step's start; of circular joints the shorter way round."""
    target, q, i = step.target, step.start_q, actuator.index_q
    if actuator.circular == 0:
        return target[i] - q[i]
    cosine, sine = q[i], q[i + 1]
    return math.atan2(target[i + 1] * cosine - target[i] * sine, target[i] * cosine + target[i + 1] * sine)


@kernel
def _start_force(step, actuator, h):
    """The part of an actuator's force that does not depend on dv."""
    v, w = step.transported_v[actuator.index_v], step.numbers.weight
    force = -actuator.damping * v
    if actuator.stiffness > 0.0:
        force += actuator.stiffness * (_error(step, actuator) - (2.0 * w - 0.5) * h * v)
    return force


@kernel
def _rate(step, actuator, h):
    """By how much an actuator's force falls with dv."""
    w = step.numbers.weight
    return w * (actuator.damping + w * h * actuator.stiffness)


@kernel
def add_actuators(step, h, matrix, loads):
    """Add the actuators to the matrix (its diagonal) and the loads of a step's equations of motion."""
    for a in range(step.counts.actuators):
        actuator = step.actuators[a]
        k = actuator.index_v
        matrix[k, k] += h * _rate(step, actuator, h)
        loads[k] += h * _start_force(step, actuator, h)


@kernel
def find_actuation(step, h, v1):
    """Mean forces of the actuators over the step that ends with v1."""
    for a in range(step.counts.actuators):
        actuator = step.actuators[a]
        k = actuator.index_v
        gained = v1[k] - step.transported_v[k]
        step.actuation[k] = _start_force(step, actuator, h) - _rate(step, actuator, h) * gained


Actuator = tuple[int, int, int, float, float]


def actuators_of(model: pin.Model, kp: ArrayLike, kd: ArrayLike) -> list[Actuator]:
    """Actuators with these gains, as records `impulse_layout.ACTUATOR`. A number is the gain of every joint of one
    degree of freedom; locked ones have none. Raises ArgumentError."""
    stiffness, damping = _gains(model, "kp", kp), _gains(model, "kd", kd)
    locked = [lock.index_v for lock in joint_locks(model)]
    found: list[Actuator] = []
    for kind, iq, iv, n in configuration_blocks(model):
        for k in range(iv, iv + n):
            if stiffness[k] > 0.0 and kind not in (VECTOR, CIRCLE_BLOCK):
                raise ArgumentError(
                    f"kp[{k}] is {stiffness[k]}: the configuration of joint {joint_of(model, k)!r} is no vector, "
                    "which has no coordinate that could have a target"
                )
            # what is locked takes no part, nor in which decay is the fastest
            if (stiffness[k] > 0.0 or damping[k] > 0.0) and k not in locked:
                found.append((iq + k - iv, k, int(kind == CIRCLE_BLOCK), float(stiffness[k]), float(damping[k])))
    return found


def _gains(model: pin.Model, name: str, gains: ArrayLike) -> np.ndarray:
    """(nv,) gains that are checked."""
    nv = model.nv
    try:
        given = real_array(gains)
    except NOT_REAL:
        raise ArgumentError(f"{name} must be a number or {nv} numbers, got {gains!r}") from None
    if given.shape not in ((), (nv,)):
        raise ArgumentError(f"{name} must be a number or have shape ({nv},), got shape {given.shape}")
    for index, gain in enumerate(given.flat):
        if not 0.0 <= gain < math.inf:
            which = f"{name}[{index}]" if given.ndim else name
            raise ArgumentError(f"{which} must be finite and at least 0, got {gain}")
    if given.ndim:
        return given
    found = np.zeros(nv)
    found[[joint.idx_v for joint in model.joints if joint.nv == 1]] = given
    return found
