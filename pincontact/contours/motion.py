"""Prescribed motions of contours: a placement as a function of time, with its first two time derivatives.

A motion moves a contour relative to the frame that carries it: a heaving plate, a turntable, a belt, a prescribed
cam. All vectors are in the axes of the carrier; velocities and accelerations are those of the moving origin, relative
to the carrier (the acceleration is the second derivative of the position, not a spatial one).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import address_of
from ..callback import kernel_caller
from ..errors import ContourError, UnusableResult
from ..jit import CALLED, INTEGER, REAL, entry_kernel, kernel
from ..workspace import reals_at
from .base import Written
from .checks import array, finite, flag, interval
from .fits import fit
from .piecewise import piecewise
from .sizes import MOTION_PARAMETERS, MOTION_SIZE
from .splines import spline, spline_pool

MOTION_NONE, MOTION_HARMONIC, MOTION_TWIST, MOTION_SPLINE, MOTION_CALLABLE = range(5)

# Parameters of a turn about a fixed axis through a fixed point with a translation: both are proportional to time
# (twist) or to a sine.
_DIRECTION, _AXIS, _CENTER = 0, 3, 6
_ANGLE, _RATE, _PHASE, _TURN_RATE, _TURN_PHASE = range(9, 14)
# A spline's pool: offset of its scratch area, then position and quaternion as piecewise polynomials.
_SPLINE_SCRATCH = 70
# Of the quaternions of neighbouring poses, their product without sign: half a turn apart it is zero, and nothing tells
# which way to turn.
_LEAST_OVERLAP = 0.1
# So many times are looked at for the signs of a function's quaternions; in between they are those of the nearest one.
_SIGN_TIMES = 2000
# Derivatives are wrong if they are off by this part of their size: wrong axes or signs, no digits.
_WRONG = 1e-2
# Half the time in s over which differences are taken for that, and what rounding leaves of them, in m/s and rad/s.
_DIFFERENCE, _DIFFERENCE_ERROR = 1e-5, 1e-4


class Motion(Written):
    """A placement as a function of time; base class of all motions.

    Parameters
    ----------
    parameters : sequence of float
        Up to 16 numbers that the kernels read, by kind.
    pool : (n,) array, optional
        Further numbers, those of a spline.

    Attributes
    ----------
    kind : int
        MOTION_CALLABLE is evaluated in Python, all others are compiled.

    Examples
    --------
    >>> import pincontact as pc
    >>> belt = pc.ConstantTwist(linear=(0.5, 0.0, 0.0))
    >>> belt.placement(2.0).translation.tolist()
    [1.0, 0.0, 0.0]
    """

    kind: int = MOTION_NONE
    _ATTRIBUTES: tuple[str, ...] = ("kind", "parameters", "pool")

    def __setattr__(self, name: str, value: Any) -> None:
        # the numbers of a motion are read when it is made: another `frequency` afterwards would change nothing
        if name not in self._ATTRIBUTES and type(self).__module__ == __name__:
            raise AttributeError(
                f"{type(self).__name__} has no attribute {name!r}, only "
                f"{', '.join(known for known in self._ATTRIBUTES if not known.startswith('_'))}; its numbers are "
                "given when it is made."
            )
        super().__setattr__(name, value)

    def __init__(self, parameters: Sequence[float] = (), pool: np.ndarray | None = None) -> None:
        self.parameters = np.zeros(MOTION_PARAMETERS)
        self.parameters[: len(parameters)] = parameters
        self.pool = np.zeros(0) if pool is None else pool

    def evaluate(self, t: float, out: np.ndarray | None = None) -> np.ndarray:
        """Placement and its derivatives, as the row that the kernels use.

        Parameters
        ----------
        t : float
            Time in s.
        out : (24,) array, optional
            Where to put it.

        Returns
        -------
        (24,) array
            Rotation (9, row-major) of the contour in its carrier, position (3), linear velocity (3), angular velocity
            (3), linear acceleration (3), angular acceleration (3), in carrier axes.

        Raises
        ------
        ContourError
            Where the function of a `CallableMotion` returned something else than it has to.
        """
        if out is None:
            out = np.zeros(MOTION_SIZE)
        pool = self.pool
        motion_at(self.kind, address_of(self.parameters), address_of(pool), pool.size, float(t), address_of(out))
        return out

    def placement(self, t: float) -> pin.SE3:
        """Placement of the contour in its carrier.

        Parameters
        ----------
        t : float
            Time in s.

        Returns
        -------
        pin.SE3
        """
        row = self.evaluate(t)
        return pin.SE3(row[:9].reshape(3, 3), row[9:12])


class ConstantTwist(Motion):
    """Constant angular velocity about a fixed axis and constant linear velocity: turntable, belt, screw.

    The placement at t = 0 is the identity.

    Parameters
    ----------
    angular : (3,) array
        Angular velocity in rad/s, carrier axes.
    linear : (3,) array
        Velocity in m/s, carrier axes.
    center : (3,) array
        A point of the axis at t = 0, in m; it moves with `linear`.

    Raises
    ------
    ContourError
        For numbers that are not finite.

    Examples
    --------
    >>> import pincontact as pc
    >>> turntable = pc.ConstantTwist(angular=(0.0, 0.0, 2.0))
    >>> turntable.evaluate(0.0)[15:18].tolist()
    [0.0, 0.0, 2.0]
    """

    kind = MOTION_TWIST

    def __init__(
        self,
        angular: Sequence[float] = (0.0, 0.0, 0.0),
        linear: Sequence[float] = (0.0, 0.0, 0.0),
        center: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        omega = array("ConstantTwist", "angular", angular, 3)
        rate = float(np.linalg.norm(omega))
        axis = omega / rate if rate > 0.0 else omega
        velocity = array("ConstantTwist", "linear", linear, 3)
        super().__init__([*velocity, *axis, *array("ConstantTwist", "center", center, 3), rate])


class HarmonicMotion(Motion):
    """Oscillation along a direction and about an axis.

    Position: amplitude sin(2 pi frequency t + phase); angle about `axis` through `center`:
    angle sin(2 pi turn_frequency t + turn_phase).

    Parameters
    ----------
    amplitude : (3,) array
        In m, carrier axes.
    frequency : float
        In Hz.
    phase : float
        In rad.
    axis : (3,) array, optional
        Of any length but zero, carrier axes.
    angle : float
        Amplitude of the angle in rad.
    turn_frequency : float, optional
        In Hz, that of the translation if not given.
    turn_phase : float
        In rad.
    center : (3,) array
        A point of the axis, in m.

    Raises
    ------
    ContourError
        For numbers that are not finite, or an angle without an axis.

    Examples
    --------
    >>> import pincontact as pc
    >>> heave = pc.HarmonicMotion(amplitude=(0.0, 0.0, 0.1), frequency=0.5)
    >>> heave.placement(0.5).translation.round(12).tolist()
    [0.0, 0.0, 0.1]
    """

    kind = MOTION_HARMONIC

    def __init__(
        self,
        amplitude: Sequence[float] = (0.0, 0.0, 0.0),
        frequency: float = 1.0,
        phase: float = 0.0,
        axis: Sequence[float] | None = None,
        angle: float = 0.0,
        turn_frequency: float | None = None,
        turn_phase: float = 0.0,
        center: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        owner = "HarmonicMotion"
        frequency, phase, angle, turn_phase = finite(
            owner, frequency=frequency, phase=phase, angle=angle, turn_phase=turn_phase
        )
        (turn_frequency,) = finite(owner, turn_frequency=frequency if turn_frequency is None else turn_frequency)
        n = np.zeros(3)
        if axis is not None:
            n = array(owner, "axis", axis, 3)
            length = float(np.linalg.norm(n))
            if not length > 0.0:
                raise ContourError(f"{owner}: axis must not be zero, got {n.tolist()}")
            n /= length
        elif angle != 0.0:
            raise ContourError(f"{owner}: an oscillating angle of {angle} rad needs an axis")
        super().__init__(
            [
                *array(owner, "amplitude", amplitude, 3),
                *n,
                *array(owner, "center", center, 3),
                angle,
                2.0 * math.pi * frequency,
                phase,
                2.0 * math.pi * turn_frequency,
                turn_phase,
            ]
        )


class SplineMotion(Motion):
    """A smooth motion through placements: quintic splines of the position and of the quaternion, normalised.

    Before the first and after the last time a motion that is not periodic goes on with constant second derivatives of
    its splines.

    Parameters
    ----------
    times : (n,) array, or (n + 1,) if periodic
        Increasing, in s; if periodic, the last one closes the motion.
    poses : sequence of n pin.SE3 or (4, 4) arrays
        Contour in carrier, at least 6.
    periodic : bool
        The motion closes and repeats.

    Raises
    ------
    ContourError
        For too few poses, times that do not increase, matrices that are no placements, or two poses half a turn apart.

    Examples
    --------
    >>> import numpy as np
    >>> import pinocchio as pin
    >>> import pincontact as pc
    >>> poses = [pin.SE3(np.eye(3), np.array([0.1 * i, 0.0, 0.0])) for i in range(6)]
    >>> pc.SplineMotion(range(6), poses).placement(2.5).translation.round(12).tolist()
    [0.25, 0.0, 0.0]
    """

    kind = MOTION_SPLINE

    def __init__(self, times: Sequence[float], poses: Sequence[pin.SE3 | np.ndarray], periodic: bool = False) -> None:
        owner = "SplineMotion"
        periodic = flag(owner, "periodic", periodic)
        if not isinstance(poses, (Sequence, np.ndarray)):
            raise ContourError(f"{owner}: poses must be a sequence of placements, got {type(poses).__name__}")
        placements = [_placement(owner, f"poses[{i}]", pose) for i, pose in enumerate(poses)]
        if periodic:
            placements += placements[:1]
        t = array(owner, "times", times, len(placements))
        values = np.array([_coordinates(pose) for pose in placements]).reshape(-1, 7)
        values[:, 3:] = connected(values[:, 3:])
        overlaps = _overlaps(values[:, 3:])
        i = int(np.argmin(overlaps)) if len(overlaps) else 0
        if len(overlaps) and overlaps[i] < _LEAST_OVERLAP:
            raise ContourError(
                f"{owner}: poses {i} and {i + 1} are {2.0 * math.acos(overlaps[i]):.3f} rad apart; add a pose between "
                "them to say which way to turn"
            )
        if periodic and values[-1, 3:] @ values[0, 3:] < 0.0:
            # An odd number of turns: the quaternion closes after two rounds only.
            again = values[1:].copy()
            again[:, 3:] = -again[:, 3:]
            values = np.concatenate([values, again])
            t = np.concatenate([t, t[1:] + (t[-1] - t[0])])
        curve = spline(owner, t, values, 5, periodic)
        super().__init__((), _motion_pool(spline_pool(curve, periodic)))


class CallableMotion(Motion):
    """A motion given by a Python function.

    Parameters
    ----------
    f : callable
        f(t) -> (pose, velocity, acceleration): pose a `pin.SE3`, velocity (6,) and acceleration (6,) linear before
        angular, in carrier axes; the acceleration is the second derivative of the position. It is called in Python
        once per evaluation of the dynamics. Accelerations may jump, as of a belt that starts and stops: pass the times
        to `simulate` as `breakpoints`. Or f(t) -> pose, with a time domain: the pose is fitted there to round-off,
        once, and no Python runs afterwards; it must be smooth.
    time_domain : (first, last), optional
        In s, for an f that returns poses only. Beyond it the motion goes on with constant second derivatives.

    Attributes
    ----------
    fit_error : float
        Largest error of fitted positions (m) and quaternions, 0 where f returns velocities, too.

    Raises
    ------
    ContourError
        For a function that raises, naming it, for a pose without time domain, results of the wrong kind, or derivatives
        that are not those of the pose.

    Examples
    --------
    >>> import numpy as np
    >>> import pinocchio as pin
    >>> import pincontact as pc
    >>> def lift(t):
    ...     return pin.SE3(np.eye(3), np.array([0.0, 0.0, t * t]))
    >>> pc.CallableMotion(lift, time_domain=(0.0, 1.0)).placement(0.5).translation.round(12).tolist()
    [0.0, 0.0, 0.25]
    """

    kind = MOTION_CALLABLE
    _ATTRIBUTES = (*Motion._ATTRIBUTES, "fit_error", "_function")

    def __init__(self, f: Callable[[float], Any], time_domain: tuple[float, float] | None = None) -> None:
        owner = "CallableMotion"
        if not callable(f):
            raise ContourError(f"{owner}: a function is needed, got {f!r}")
        given, f = f, _named_failure(owner, f)
        self._function = f
        self.fit_error = 0.0
        first, last = (0.0, 1.0) if time_domain is None else interval(owner, "time_domain", time_domain)
        if not (math.isfinite(first) and math.isfinite(last)):
            raise ContourError(f"{owner}: time_domain must be finite, got ({first}, {last})")
        sample = f(first)
        if isinstance(sample, tuple):
            super().__init__()
            for part in (0.137, 0.618):
                self._check(first + part * (last - first))
            # what it raises in a run is reported there, with the contour's name
            self._function = given
            return
        if time_domain is None:
            raise ContourError(
                f"{owner}: a function that returns a pose only needs time_domain=(first, last); one that returns "
                "(pose, velocity, acceleration) needs none"
            )
        pose = _continued(lambda t: _coordinates(_placement(owner, f"f({t})", f(t))), first, last)
        cure = (
            "; where the acceleration jumps, return (pose, velocity, acceleration) without time_domain, and give "
            "simulate the times as breakpoints"
        )
        result = fit(owner, pose, [(first, last)], (False,), cure=cure)
        self.kind = MOTION_SPLINE
        self.fit_error = result.error
        super().__init__((), _motion_pool(result.pool))

    def evaluate(self, t: float, out: np.ndarray | None = None) -> np.ndarray:
        if self.kind == MOTION_SPLINE:
            return super().evaluate(t, out)
        if out is None:
            out = np.zeros(MOTION_SIZE)
        result = self._function(float(t))
        try:
            _fill_row(t, result, out)
        except ContourError as error:
            raise UnusableResult(str(error)) from None
        return out

    def _check(self, t: float) -> None:
        """Compare the derivatives with differences of the pose: catches wrong axes and signs, not digits."""
        h = _DIFFERENCE
        before, here, after = self.evaluate(t - h), self.evaluate(t), self.evaluate(t + h)
        turn = after[:9].reshape(3, 3) @ before[:9].reshape(3, 3).T
        changes = [after[9:12] - before[9:12], pin.log3(turn), after[12:18] - before[12:18]]
        expected = np.concatenate(changes) / (2.0 * h)
        names = np.repeat(["velocity", "angular velocity", "acceleration", "angular acceleration"], 3)
        for i, (found, value) in enumerate(zip(here[12:], expected)):
            size = np.abs(expected[3 * (i // 3) : 3 * (i // 3) + 3]).max()
            if not abs(found - value) <= _WRONG * size + _DIFFERENCE_ERROR:
                raise ContourError(
                    f"CallableMotion: {names[i]}[{i % 3}] of f({t}) is {found}, but differences give {value} "
                    "(carrier axes, acceleration as second derivative of the position)"
                )


def _named_failure(owner: str, f: Callable[[float], Any]) -> Callable[[float], Any]:
    """The function, whose exceptions become ContourErrors with its name and the time."""

    def named(t: float) -> Any:
        try:
            return f(t)
        except ContourError:
            raise
        except Exception as error:
            name = getattr(f, "__qualname__", repr(f))
            raise ContourError(f"{owner}: {name}({t:.9g}) raised {type(error).__name__}: {error}") from error

    return named


def _overlaps(quaternions: np.ndarray) -> np.ndarray:
    """Products of neighbouring quaternions (n, 4)."""
    return np.einsum("ij,ij->i", quaternions[1:], quaternions[:-1])


def connected(quaternions: np.ndarray) -> np.ndarray:
    """The same rotations (n, 4) with signs such that neighbours have a non-negative product."""
    signs = np.cumprod(np.where(_overlaps(quaternions) < 0.0, -1.0, 1.0))
    return quaternions * np.concatenate([[1.0], signs])[:, None]


def _continued(coordinates: Callable[[float], np.ndarray], first: float, last: float) -> Callable[[float], np.ndarray]:
    """Coordinates of a pose with the quaternion's sign continued from the first time."""
    times = np.linspace(first, last, _SIGN_TIMES)
    grid = connected(np.array([coordinates(float(t))[3:] for t in times]))

    def continued(t: float) -> np.ndarray:
        values = coordinates(t)
        if values[3:] @ grid[np.abs(times - t).argmin()] < 0.0:
            values[3:] *= -1.0
        return values

    return continued


def _fill_row(t: float, result: Any, out: np.ndarray) -> None:
    """What a function of time has returned, as a row of `Motion.evaluate`."""
    try:
        pose, velocity, acceleration = result
    except (TypeError, ValueError):
        raise ContourError(
            f"CallableMotion: f({t}) must be (pose, velocity, acceleration), got {type(result).__name__}"
        ) from None
    pose = _placement("CallableMotion", f"the pose of f({t})", pose)
    out[:9] = pose.rotation.ravel()
    out[9:12] = pose.translation
    for start, name, given in ((12, "velocity", velocity), (18, "acceleration", acceleration)):
        vector = getattr(given, "vector", given)
        out[start : start + 6] = array("CallableMotion", f"{name} of f({t})", vector, 6)


def _placement(owner: str, name: str, given: Any) -> pin.SE3:
    if isinstance(given, pin.SE3):
        matrix = given.homogeneous
    else:
        matrix = array(owner, name, given, 4, 4)
    rotation = matrix[:3, :3]
    # Rotations that come from files have six digits; those are taken and made orthogonal by the quaternion.
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if not error < 1e-5 or np.linalg.det(rotation) < 0.0 or np.abs(matrix[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-9:
        raise ContourError(f"{owner}: {name} is not a placement: its rotation is off by {error:.1e}")
    if not np.isfinite(matrix).all():
        raise ContourError(f"{owner}: {name} is not finite")
    return pin.SE3(rotation, matrix[:3, 3])


def _coordinates(pose: pin.SE3) -> np.ndarray:
    """Position and quaternion (x, y, z, w)."""
    coordinates: np.ndarray = pin.SE3ToXYZQUAT(pose)
    return coordinates


def _motion_pool(polynomials: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros(_SPLINE_SCRATCH), polynomials])


@kernel
def _rotation(x, y, z, w, s, out):
    """Rotation matrix (9) of a quaternion; s: 2 by the square of its length."""
    out[0], out[1], out[2] = 1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)
    out[3], out[4], out[5] = s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)
    out[6], out[7], out[8] = s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)


@kernel
def _fixed_axis(kind, p, t, out):
    """Turn about a fixed axis through a fixed point, with a translation along a fixed direction."""
    shift, shift_t, shift_tt = t, 1.0, 0.0
    angle, angle_t, angle_tt = p[_ANGLE] * t, p[_ANGLE], 0.0
    if kind == MOTION_HARMONIC:
        rate, turn_rate = p[_RATE], p[_TURN_RATE]
        argument, turn = rate * t + p[_PHASE], turn_rate * t + p[_TURN_PHASE]
        shift, shift_t = math.sin(argument), rate * math.cos(argument)
        shift_tt = -rate * rate * shift
        angle, angle_t = p[_ANGLE] * math.sin(turn), p[_ANGLE] * turn_rate * math.cos(turn)
        angle_tt = -turn_rate * turn_rate * angle
    axis = p[_AXIS : _AXIS + 3]
    sine = math.sin(0.5 * angle)
    _rotation(axis[0] * sine, axis[1] * sine, axis[2] * sine, math.cos(0.5 * angle), 2.0, out)
    # The axis goes through `center`, so that the origin, -center from it, moves on a circle.
    x = -(out[0] * p[_CENTER] + out[1] * p[_CENTER + 1] + out[2] * p[_CENTER + 2])
    y = -(out[3] * p[_CENTER] + out[4] * p[_CENTER + 1] + out[5] * p[_CENTER + 2])
    z = -(out[6] * p[_CENTER] + out[7] * p[_CENTER + 1] + out[8] * p[_CENTER + 2])
    # axis x arm, axis x (axis x arm)
    a, b, c = axis[1] * z - axis[2] * y, axis[2] * x - axis[0] * z, axis[0] * y - axis[1] * x
    d, e, f = axis[1] * c - axis[2] * b, axis[2] * a - axis[0] * c, axis[0] * b - axis[1] * a
    out[9], out[10], out[11] = x + p[_CENTER], y + p[_CENTER + 1], z + p[_CENTER + 2]
    out[12], out[13], out[14] = angle_t * a, angle_t * b, angle_t * c
    square = angle_t * angle_t
    out[18], out[19], out[20] = angle_tt * a + square * d, angle_tt * b + square * e, angle_tt * c + square * f
    for i in range(3):
        direction = p[_DIRECTION + i]
        out[9 + i] += shift * direction
        out[12 + i] += shift_t * direction
        out[18 + i] += shift_tt * direction
        out[15 + i] = angle_t * axis[i]
        out[21 + i] = angle_tt * axis[i]


@kernel
def _spline_motion(pool, t, out):
    """Position and rotation from piecewise polynomials of a position and a quaternion of any length."""
    rows = pool[:_SPLINE_SCRATCH].reshape(10, 7)
    piecewise(pool[_SPLINE_SCRATCH:], t, 0.0, 0.0, rows)
    for i in range(3):
        out[9 + i], out[12 + i], out[18 + i] = rows[0, i], rows[1, i], rows[3, i]
    x, y, z, w = rows[0, 3], rows[0, 4], rows[0, 5], rows[0, 6]
    x_t, y_t, z_t, w_t = rows[1, 3], rows[1, 4], rows[1, 5], rows[1, 6]
    x_tt, y_tt, z_tt, w_tt = rows[3, 3], rows[3, 4], rows[3, 5], rows[3, 6]
    # With s = 2 / |q|^2 nothing has to be normalised; omega = s Im(q_t q*), whose derivative has no q_t q_t* term
    # since that is real.
    s = 2.0 / (x * x + y * y + z * z + w * w)
    shrink = -s * (x * x_t + y * y_t + z * z_t + w * w_t)
    _rotation(x, y, z, w, s, out)
    out[15] = s * (x_t * w - w_t * x + z_t * y - y_t * z)
    out[16] = s * (y_t * w - w_t * y + x_t * z - z_t * x)
    out[17] = s * (z_t * w - w_t * z + y_t * x - x_t * y)
    out[21] = s * (x_tt * w - w_tt * x + z_tt * y - y_tt * z) + shrink * out[15]
    out[22] = s * (y_tt * w - w_tt * y + x_tt * z - z_tt * x) + shrink * out[16]
    out[23] = s * (z_tt * w - w_tt * z + y_tt * x - x_tt * y) + shrink * out[17]


@kernel
def evaluate_motion(kind, parameters, pool, t, out):
    """Fill out (24,) as in `Motion.evaluate`. A callable's row is left alone: Python has filled it."""
    if kind in (MOTION_HARMONIC, MOTION_TWIST):
        _fixed_axis(kind, parameters, t, out)
    elif kind == MOTION_SPLINE:
        _spline_motion(pool, t, out)
    elif kind == MOTION_NONE:
        for i in range(MOTION_SIZE):
            out[i] = 1.0 if i in (0, 4, 8) else 0.0


_ARGUMENTS = (INTEGER, INTEGER, INTEGER, INTEGER, REAL, INTEGER)
# `call_motion(motion, kind, parameters, pool, pool_size, t, out)`: `evaluate_motion` by the kernel at address `motion`;
# parameters, pool, out: addresses of (MOTION_PARAMETERS,), (pool_size,) and (24,).
call_motion = kernel_caller(INTEGER, *_ARGUMENTS)


@entry_kernel(*_ARGUMENTS, when=CALLED)
def motion_at(kind, parameters, pool, pool_size, t, out):
    """See `call_motion`."""
    given, rest = reals_at(parameters, MOTION_PARAMETERS), reals_at(pool, pool_size)
    evaluate_motion(kind, given, rest, t, reals_at(out, MOTION_SIZE))
    return 0
