"""Where a contour is and how it moves: from Pinocchio's joint, the contour's placement and its prescribed motion."""

from __future__ import annotations

from ..jit import kernel
from .small import add_cross, cross, rotate, rotate_back

# Rows of one side's frame array (8, 3): rotation in rows 0-2, then these.
ORIGIN, VELOCITY, OMEGA, ACCELERATION, ALPHA = 3, 4, 5, 6, 7


@kernel
def place_on_joint(base, rotation_columns, translation, spatial_velocity, spatial_bias, gravity, frame, scratch):
    """Pose, velocity and bias acceleration (no joint acceleration) of a contour frame fixed to a joint.

    base (12,): rotation (9) and position (3) of the contour in the joint.
    rotation_columns (3, 3): columns of the joint's rotation, one a row (Pinocchio's storage); translation (3,).
    spatial_velocity (6,): `data.v`, local, linear and angular velocity.
    spatial_bias (6,): `data.a_gf`, local, bias acceleration minus gravity.
    """
    position, omega = scratch[0], frame[OMEGA]
    for i in range(3):
        for j in range(3):
            frame[i, j] = (
                rotation_columns[0, i] * base[j]
                + rotation_columns[1, i] * base[3 + j]
                + rotation_columns[2, i] * base[6 + j]
            )
    rotate_back(rotation_columns, base[9:12], position)
    rotate_back(rotation_columns, spatial_velocity[0:3], frame[VELOCITY])
    rotate_back(rotation_columns, spatial_velocity[3:6], omega)
    rotate_back(rotation_columns, spatial_bias[0:3], frame[ACCELERATION])
    rotate_back(rotation_columns, spatial_bias[3:6], frame[ALPHA])
    for i in range(3):
        frame[ORIGIN, i] = translation[i] + position[i]
        frame[ACCELERATION, i] += gravity[i]
    add_cross(omega, position, frame[VELOCITY])
    # classical acceleration of a point = spatial one at that point + omega x its velocity
    add_cross(frame[ALPHA], position, frame[ACCELERATION])
    add_cross(omega, frame[VELOCITY], frame[ACCELERATION])


@kernel
def rest_in_world(base, frame):
    """The frame of a contour fixed to the world, as base (12,) of `place_on_joint` has it, at rest."""
    for i in range(3):
        for j in range(3):
            frame[i, j] = base[3 * i + j]
        frame[ORIGIN, i] = base[9 + i]
        for row in range(VELOCITY, ALPHA + 1):
            frame[row, i] = 0.0


@kernel
def add_drive(motion, frame, scratch):
    """Compose a frame with a placement that moves in it.

    motion (24,): rotation (9), position, velocity, angular velocity, acceleration, angular acceleration of the
    contour, all in the axes of the frame that carries it.
    """
    position, velocity, omega, turned, relative = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    rotation = frame[0:3]
    rotate(rotation, motion[9:12], position)
    rotate(rotation, motion[12:15], velocity)
    rotate(rotation, motion[15:18], omega)
    carrier = frame[OMEGA]
    for i in range(3):
        frame[ORIGIN, i] += position[i]
    # acceleration: carried point, Coriolis, relative
    cross(carrier, position, turned)
    for i in range(3):
        frame[VELOCITY, i] += turned[i] + velocity[i]
        turned[i] += 2.0 * velocity[i]
    add_cross(carrier, turned, frame[ACCELERATION])
    add_cross(frame[ALPHA], position, frame[ACCELERATION])
    rotate(rotation, motion[18:21], relative)
    for i in range(3):
        frame[ACCELERATION, i] += relative[i]
    rotate(rotation, motion[21:24], relative)
    add_cross(carrier, omega, relative)
    for i in range(3):
        frame[ALPHA, i] += relative[i]
        frame[OMEGA, i] += omega[i]
    for i in range(3):
        x, y, z = rotation[i, 0], rotation[i, 1], rotation[i, 2]
        for j in range(3):
            rotation[i, j] = x * motion[j] + y * motion[3 + j] + z * motion[6 + j]


@kernel
def point_velocity(frame, rho, partial_t, out):
    """Velocity of the material point at rho (world axes, from the origin); partial_t: R dc/dt of a moving shape."""
    for i in range(3):
        out[i] = frame[VELOCITY, i] + partial_t[i]
    add_cross(frame[OMEGA], rho, out)


@kernel
def point_bias(frame, rho, partial_t, partial_tt, out, scratch):
    """Acceleration of the material point at rho when the joints' accelerations are zero."""
    omega = frame[OMEGA]
    cross(omega, rho, scratch)
    for i in range(3):
        scratch[i] += 2.0 * partial_t[i]
        out[i] = frame[ACCELERATION, i] + partial_tt[i]
    add_cross(omega, scratch, out)
    add_cross(frame[ALPHA], rho, out)
