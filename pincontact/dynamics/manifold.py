"""Velocity to configuration rate on Pinocchio's manifold: q' = T(q) v, block by block, and velocities in other axes.

Quaternion and circle blocks are integrated in their ambient space, which keeps the order of any Runge-Kutta method,
and normalised when a configuration is handed to Pinocchio and at the end of every step.
Pinocchio gives the velocities of free, planar and spherical joints in the axes of the moving body. Seen from there
even a ball that flies on a straight line has velocities that turn as fast as it spins; in the axes of the joint's
parent they are as smooth as the motion. Steps of order 8 are 5 times (a wheel) to 5000 times (a ball) as accurate.
"""

from __future__ import annotations

import math
from collections import deque

import pinocchio as pin

from ..errors import ModelError
from ..jit import kernel

# Kinds of blocks of the configuration vector.
VECTOR, FREE_FLYER, QUATERNION, CIRCLE_BLOCK, PLANAR_BLOCK = range(5)

_BLOCKS = {
    "JointModelFreeFlyer": FREE_FLYER,
    "JointModelSpherical": QUATERNION,
    "JointModelPlanar": PLANAR_BLOCK,
}


# Kinds whose velocities turn with the body in Pinocchio's axes.
TURNING = (FREE_FLYER, QUATERNION, PLANAR_BLOCK)

# (copy of a model, its blocks): asking a model for its joints costs far more than comparing it with a copy.
_known: deque[tuple[pin.Model, tuple[tuple[int, int, int, int], ...]]] = deque(maxlen=4)


def configuration_blocks(model: pin.Model) -> tuple[tuple[int, int, int, int], ...]:
    """(kind, index in q, index in v, coordinates) of every block; neighbouring vector blocks are merged.

    Raises ModelError for a joint whose configuration space is not known.
    """
    for seen, blocks in tuple(_known):
        if model == seen:
            return blocks
    blocks = tuple(_find_blocks(model))
    _known.appendleft((model.copy(), blocks))
    return blocks


def _find_blocks(model: pin.Model) -> list[tuple[int, int, int, int]]:
    blocks: list[tuple[int, int, int, int]] = []

    def add(joint: object, owner: str, idx_q: int, idx_v: int) -> None:
        name = joint.shortname()  # type: ignore[attr-defined]
        if name == "JointModelComposite":
            for child in joint.extract().joints:  # type: ignore[attr-defined]
                add(child, owner, idx_q, idx_v)
                idx_q, idx_v = idx_q + child.nq, idx_v + child.nv
        elif name in _BLOCKS:
            blocks.append((_BLOCKS[name], idx_q, idx_v, joint.nv))  # type: ignore[attr-defined]
        elif joint.nq == 2 and joint.nv == 1:  # type: ignore[attr-defined]
            blocks.append((CIRCLE_BLOCK, idx_q, idx_v, 1))
        elif joint.nq == joint.nv:  # type: ignore[attr-defined]
            last = blocks[-1] if blocks else None
            if last and last[0] == VECTOR and last[1] + last[3] == idx_q and last[2] + last[3] == idx_v:
                blocks[-1] = (VECTOR, last[1], last[2], last[3] + joint.nv)  # type: ignore[attr-defined]
            else:
                blocks.append((VECTOR, idx_q, idx_v, joint.nv))  # type: ignore[attr-defined]
        else:
            raise ModelError(f"joint {owner!r}: type {name} has a configuration space that pincontact does not know")

    for i in range(1, model.njoints):
        joint = model.joints[i]
        add(joint, str(model.names[i]), joint.idx_q, joint.idx_v)
    return blocks


@kernel
def rotate_by_quaternion(x, y, z, w, a, b, c):
    """Rotate (a, b, c) by a unit quaternion."""
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx


@kernel
def _quaternion_rate(q, wx, wy, wz, out):
    """out = q (omega, 0) / 2 for q = (x, y, z, w) and omega in body axes."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    out[0] = 0.5 * (w * wx + y * wz - z * wy)
    out[1] = 0.5 * (w * wy + z * wx - x * wz)
    out[2] = 0.5 * (w * wz + x * wy - y * wx)
    out[3] = -0.5 * (x * wx + y * wy + z * wz)


@kernel
def configuration_rate(blocks, q, unit_q, v, out):
    """out = T(q) v. q: ambient configuration, unit_q: the same with its blocks normalised."""
    for b in range(blocks.shape[0]):
        kind, iq, iv, n = blocks[b, 0], blocks[b, 1], blocks[b, 2], blocks[b, 3]
        if kind == VECTOR:
            for i in range(n):
                out[iq + i] = v[iv + i]
        elif kind == FREE_FLYER:
            out[iq], out[iq + 1], out[iq + 2] = rotate_by_quaternion(
                unit_q[iq + 3], unit_q[iq + 4], unit_q[iq + 5], unit_q[iq + 6], v[iv], v[iv + 1], v[iv + 2]
            )
            _quaternion_rate(q[iq + 3 : iq + 7], v[iv + 3], v[iv + 4], v[iv + 5], out[iq + 3 : iq + 7])
        elif kind == QUATERNION:
            _quaternion_rate(q[iq : iq + 4], v[iv], v[iv + 1], v[iv + 2], out[iq : iq + 4])
        elif kind == CIRCLE_BLOCK:
            out[iq] = -q[iq + 1] * v[iv]
            out[iq + 1] = q[iq] * v[iv]
        else:
            c, s = unit_q[iq + 2], unit_q[iq + 3]
            out[iq] = c * v[iv] - s * v[iv + 1]
            out[iq + 1] = s * v[iv] + c * v[iv + 1]
            out[iq + 2] = -q[iq + 3] * v[iv + 2]
            out[iq + 3] = q[iq + 2] * v[iv + 2]


@kernel
def _turn_axes(blocks, unit_q, sign, v, out):
    """out = v (nv,) with the velocities of turning joints turned by the joints' rotations, or back (sign -1.0)."""
    for b in range(blocks.shape[0]):
        kind, iq, iv, n = blocks[b, 0], blocks[b, 1], blocks[b, 2], blocks[b, 3]
        if kind in (FREE_FLYER, QUATERNION):
            first = iq + 3 if kind == FREE_FLYER else iq
            x, y, z, w = sign * unit_q[first], sign * unit_q[first + 1], sign * unit_q[first + 2], unit_q[first + 3]
            for i in range(iv, iv + n, 3):
                out[i], out[i + 1], out[i + 2] = rotate_by_quaternion(x, y, z, w, v[i], v[i + 1], v[i + 2])
        elif kind == PLANAR_BLOCK:
            c, s = unit_q[iq + 2], sign * unit_q[iq + 3]
            out[iv], out[iv + 1] = c * v[iv] - s * v[iv + 1], s * v[iv] + c * v[iv + 1]
            out[iv + 2] = v[iv + 2]
        else:
            for i in range(iv, iv + n):
                out[i] = v[i]


@kernel
def to_parent_axes(blocks, unit_q, v, out):
    """out = velocities v (nv,), or any tangent vector, with those of turning joints in the axes of their parents."""
    _turn_axes(blocks, unit_q, 1.0, v, out)


@kernel
def to_joint_axes(blocks, unit_q, w, out):
    """The inverse of `to_parent_axes`: velocities in Pinocchio's axes."""
    _turn_axes(blocks, unit_q, -1.0, w, out)


@kernel
def rate_in_parent_axes(blocks, unit_q, v, acceleration, out):
    """out = rates (nv,) of the velocities in parents' axes, from v and its rate in Pinocchio's: R (v' + omega x v)."""
    for b in range(blocks.shape[0]):
        kind, iv, n = blocks[b, 0], blocks[b, 2], blocks[b, 3]
        for i in range(iv, iv + n):
            out[i] = acceleration[i]
        if kind == FREE_FLYER:
            x, y, z = v[iv + 3], v[iv + 4], v[iv + 5]
            out[iv] += y * v[iv + 2] - z * v[iv + 1]
            out[iv + 1] += z * v[iv] - x * v[iv + 2]
            out[iv + 2] += x * v[iv + 1] - y * v[iv]
        elif kind == PLANAR_BLOCK:
            out[iv] -= v[iv + 2] * v[iv + 1]
            out[iv + 1] += v[iv + 2] * v[iv]
    to_parent_axes(blocks, unit_q, out, out)


@kernel
def normalize(blocks, q, out):
    """out = q with every quaternion and circle block scaled to unit length (out may be q)."""
    for b in range(blocks.shape[0]):
        kind, iq, n = blocks[b, 0], blocks[b, 1], blocks[b, 3]
        if kind == VECTOR:
            for i in range(n):
                out[iq + i] = q[iq + i]
            continue
        first, size = iq, 4
        if kind == FREE_FLYER:
            first = iq + 3
        elif kind == CIRCLE_BLOCK:
            size = 2
        elif kind == PLANAR_BLOCK:
            first, size = iq + 2, 2
        for i in range(iq, first):
            out[i] = q[i]
        length = 0.0
        for i in range(first, first + size):
            length += q[i] * q[i]
        length = 1.0 / math.sqrt(length)
        for i in range(first, first + size):
            out[i] = q[i] * length


@kernel
def move(blocks, q, step, rate, out):
    """out = q moved by the small tangent step: first order in ambient space, then normalised (for corrections)."""
    configuration_rate(blocks, q, q, step, rate)
    for i in range(q.shape[0]):
        out[i] = q[i] + rate[i]
    normalize(blocks, out, out)


@kernel
def _turn(q, i, wx, wy, wz, out):
    """out[i:i+4] = quaternion q[i:i+4] times the exponential of the rotation vector w (body axes)."""
    angle = math.sqrt(wx * wx + wy * wy + wz * wz)
    half = 0.5 * angle
    s = 0.5 * (1.0 - half * half / 6.0) if angle < 1e-4 else math.sin(half) / angle
    a, b, c, d = s * wx, s * wy, s * wz, math.cos(half)
    x, y, z, w = q[i], q[i + 1], q[i + 2], q[i + 3]
    out[i] = w * a + x * d + y * c - z * b
    out[i + 1] = w * b + y * d + z * a - x * c
    out[i + 2] = w * c + z * d + x * b - y * a
    out[i + 3] = w * d - x * a - y * b - z * c


@kernel
def displace(blocks, q, axes, step, out):
    """out = q moved by the finite step (nv,), which is in the axes of the configuration `axes`: translated by it, and
    turned by its exponential."""
    for b in range(blocks.shape[0]):
        kind, iq, iv, n = blocks[b, 0], blocks[b, 1], blocks[b, 2], blocks[b, 3]
        if kind == VECTOR:
            for i in range(n):
                out[iq + i] = q[iq + i] + step[iv + i]
        elif kind in (FREE_FLYER, QUATERNION):
            first = iq
            if kind == FREE_FLYER:
                first = iq + 3
                x, y, z = rotate_by_quaternion(
                    axes[first], axes[first + 1], axes[first + 2], axes[first + 3], step[iv], step[iv + 1], step[iv + 2]
                )
                out[iq], out[iq + 1], out[iq + 2] = q[iq] + x, q[iq + 1] + y, q[iq + 2] + z
                iv += 3
            x, y, z = rotate_by_quaternion(
                axes[first], axes[first + 1], axes[first + 2], axes[first + 3], step[iv], step[iv + 1], step[iv + 2]
            )
            x, y, z = rotate_by_quaternion(-q[first], -q[first + 1], -q[first + 2], q[first + 3], x, y, z)
            _turn(q, first, x, y, z, out)
        else:
            first, turn = (iq, step[iv]) if kind == CIRCLE_BLOCK else (iq + 2, step[iv + 2])
            c, s = q[first], q[first + 1]
            if kind != CIRCLE_BLOCK:
                cm, sm = axes[first], axes[first + 1]
                out[iq] = q[iq] + cm * step[iv] - sm * step[iv + 1]
                out[iq + 1] = q[iq + 1] + sm * step[iv] + cm * step[iv + 1]
            ct, st = math.cos(turn), math.sin(turn)
            out[first], out[first + 1] = c * ct - s * st, s * ct + c * st
    normalize(blocks, out, out)
