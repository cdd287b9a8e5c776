"""Sizes of what the kernels read and write of contours and motions."""

# Shape parameters of a contour; rows of f and its derivatives by u1, u2 and t up to second order (see `base`).
SHAPE_SIZE = 8
DERIVATIVE_ROWS = 10
# Parameters of a motion; its placement as a row: rotation (row-major), position, velocity, angular velocity,
# acceleration, angular acceleration.
MOTION_PARAMETERS = 16
MOTION_SIZE = 24
