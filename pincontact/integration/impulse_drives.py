"""Prescribed motions that jump within a time step: they would put bodies elsewhere with no speed at all."""

from __future__ import annotations

from ..callback import separate_kernel
from ..contours.motion import MOTION_CALLABLE
from ..geometry.small import cross, dot, norm, rotate, rotate_back
from ..jit import INTEGER, NOTHING, REAL, STEPPING, kernel
from ..layout import FREE, LENGTH, MODE, MOTION_KIND, MOTION_SIZE, SYSTEM
from ..workspace import square
from .accuracy import LEAPS
from .impulse_layout import STEP


@separate_kernel(NOTHING, SYSTEM.type, STEP.type, when=STEPPING)
def note_drives(system, step):
    """Keep where motions that users' functions give have their contours in the last evaluation, at a step's start."""
    for side in range(2 * system.sizes.nc):
        if system.side_int[side, MOTION_KIND] == MOTION_CALLABLE:
            for i in range(MOTION_SIZE):
                step.start_drives[side, i] = system.side_motion[side, i]


@kernel
def _place(motion, point, place, arm):
    """Where a motion (24,), see `carriers.add_drive`, has a point of its contour, and its arm from the origin there."""
    rotate(square(motion, 3), point, arm)
    for i in range(3):
        place[i] = arm[i] + motion[9 + i]


@kernel
def _speed(motion, arm, normal, scratch):
    """Speed along the normal at which a motion moves the point at the end of this arm."""
    cross(motion[15:18], arm, scratch)
    return dot(normal, motion[12:15]) + dot(normal, scratch)


@kernel
def _acceleration(motion, arm, first, second):
    """Size of the acceleration of the point at the end of this arm."""
    cross(motion[15:18], arm, first)
    cross(motion[15:18], first, second)
    cross(motion[21:24], arm, first)
    for i in range(3):
        second[i] += first[i] + motion[18 + i]
    return norm(second)


@kernel
def _unexplained(system, step, side, c, h):
    """By how many metres a motion has taken the point of its contour that is in contact c at the step's end further
    along the normal than its velocities and accelerations at both ends allow; negative where these allow more."""
    before, after, frame = step.start_drives[side], system.side_motion[side], system.frames[side]
    vectors = system.vectors
    point, normal, along, first, second = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]
    arms, places = vectors[5:7], vectors[7:9]
    # in the contour's axes, then in those of its carrier
    rotate_back(frame[0:3], system.derivatives[side, 0], point)
    rotate_back(frame[0:3], system.basis[c, 2], normal)
    rotate(square(after, 3), normal, along)
    _place(before, point, places[0], arms[0])
    _place(after, point, places[1], arms[1])
    way = dot(along, places[1]) - dot(along, places[0])
    speed = max(abs(_speed(before, arms[0], along, first)), abs(_speed(after, arms[1], along, first)))
    change = max(_acceleration(before, arms[0], first, second), _acceleration(after, arms[1], first, second))
    return abs(way) - h * (speed + 0.5 * h * change)


@separate_kernel(INTEGER, SYSTEM.type, STEP.type, REAL, when=STEPPING)
def driven_apart(system, step, h):
    """The first contact whose bodies a motion has put into each other, or closed ones apart, by a jump in the step of
    size h to the evaluated state; -1 where there is none."""
    for side in range(2 * system.sizes.nc):
        if system.side_int[side, MOTION_KIND] != MOTION_CALLABLE:
            continue
        c = side // 2
        if system.contact_int[c, MODE] == FREE and (system.gaps[c, 0] >= 0.0 or step.behind[c] != 0):
            continue
        if _unexplained(system, step, side, c, h) > LEAPS * system.contact_real[c, LENGTH]:
            return c
    return -1
