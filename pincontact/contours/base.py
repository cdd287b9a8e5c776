"""What a contour is: numbers, a kernel that evaluates them, and derivatives up to second order (Defs. 1-4).

A contour is a point, a curve f(u) or a surface f(u1, u2) in its own frame. Compiled code sees it as the address of its
kernel (see `evaluation`), `SHAPE_SIZE` shape parameters and, for shapes with more data, a pool of numbers.
"""

from __future__ import annotations

import inspect
import math
import reprlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

import numpy as np

from ..arguments import NOT_REAL, is_number, real, real_array
from ..errors import ContourError
from .checks import interval
from .evaluation import evaluate_contour
from .sizes import DERIVATIVE_ROWS, SHAPE_SIZE

# Rows of the derivative array that every evaluation fills: f and its derivatives by u1, u2 and t.
F, F_1, F_2, F_11, F_12, F_22, F_T, F_1T, F_2T, F_TT = range(DERIVATIVE_ROWS)

# Shapes that compiled code tells apart: those with a closed form of the contact coordinates (see `geometry.location`)
# or with several charts (see `charts`). All others are OTHER.
OTHER, POINT, LINE, ELLIPSE, PLANE, SPHERE, ELLIPSOID, REVOLUTION, CYLINDER = range(9)

ALL = (-np.inf, np.inf)
TURN = (-np.pi, np.pi)
# Numbers in an argument that is shown as it was written, and its characters.
_MOST_NUMBERS, _LONGEST_ARGUMENT = 16, 50
# In place of what is worked out from the shape.
_FROM_SHAPE: Any = None
# (low, high) of each parameter, None for the whole domain.
Window = Sequence[Sequence[float] | None] | np.ndarray | None


class Written:
    """An object that is shown as it was written, see `as_written`."""

    def __new__(cls, *given: Any, **named: Any) -> Any:
        made = super().__new__(cls)
        made.__dict__["_written"] = as_written(cls, given, named)
        return made

    def __repr__(self) -> str:
        written: str = self.__dict__["_written"]
        return written


@dataclass(frozen=True, eq=False, repr=False)
class Contour(Written):
    """A shape that can touch another, in its own frame; base class of all contours.

    Users make one of the subclasses. A new kind of contour is a subclass that hands its numbers, and a kernel that
    evaluates them, to this constructor.

    Parameters
    ----------
    evaluator : kernel
        Evaluates f and its derivatives; see `contours.evaluation`.
    dimension : int
        Number of parameters k: 0 point, 1 curve, 2 surface.
    shape : tuple of float
        Up to `SHAPE_SIZE` numbers that the kernel reads.
    pool : (n,) array
        Further numbers (coefficients, knots, instructions).
    domain : k pairs (low, high)
        Range of each parameter in the first chart, lengths in m and angles in rad; infinite if not given.
    periodic : k bools
        Whether each parameter wraps around its domain; not, if not given.
    periods : k floats
        After how much of each parameter f repeats itself, though the domain may be a part of that, as of an arc;
        infinite if it does not. Of those that wrap around the whole domain, and infinite for others, if not given.
    limits : k pairs (low, high)
        Where a contact point comes to the contour's end, if elsewhere than at the ends of the domain.
    charts : tuple of int
        Numbers of its charts; domain and periodic are those of chart 0, which every contour has.
    planar : bool
        The curve lies in its frame's xy-plane, so that it may form a planar pattern.
    time_dependent : bool
        f depends on t explicitly.
    size : float
        A characteristic length in m, infinite for planes and lines; half the diagonal of the box around the contour
        if not given.
    convex_side : int
        +1 if the material that this contour bounds is convex and lies on the side opposite to e_3 (e_3 points out of a
        convex body), -1 if e_3 points into it, 0 if the shape does not decide. For planar curves the normal is
        e_1 x k. If not given, found by integrating the curvature of a closed planar curve, and 0 for other shapes.
    fit_error : float
        How far in m the contour is from the function it was fitted to, 0 where it is exact.
    kind : int
        By what compiled code knows the shape, where it has a closed form or charts for it.
    lengths : bool
        Parameters after which f does not repeat are lengths in m.

    Examples
    --------
    >>> import pincontact as pc
    >>> rim = pc.Circle(radius=0.3)
    >>> rim, rim.dimension, rim.planar
    (Circle(radius=0.3), 1, True)
    >>> rim.point(0.0).tolist()
    [0.3, 0.0, 0.0]
    """

    evaluator: Callable[..., Any]
    dimension: int
    shape: tuple[float, ...] = ()
    pool: np.ndarray = field(default_factory=lambda: np.zeros(0))
    domain: tuple[tuple[float, float], ...] = ()
    periodic: tuple[bool, ...] = ()
    periods: tuple[float, ...] = ()
    limits: tuple[tuple[float, float], ...] = ()
    charts: tuple[int, ...] = (0,)
    planar: bool = False
    time_dependent: bool = False
    size: float = _FROM_SHAPE
    convex_side: int = _FROM_SHAPE
    fit_error: float = 0.0
    kind: int = OTHER
    lengths: bool = False

    def __post_init__(self) -> None:
        if not self.domain:
            self._set(domain=(ALL,) * self.dimension)
        if not self.periodic:
            self._set(periodic=(False,) * self.dimension)
        ends = list(zip(self.domain, self.periodic))
        if not self.periods:
            self._set(periods=tuple(high - low if wraps else math.inf for (low, high), wraps in ends))
        if not self.limits:
            self._set(limits=tuple(ALL if wraps else domain for domain, wraps in ends))
        if self.size is None:
            self._set(size=half_diagonal(self))
        if self.convex_side is None:
            self._set(convex_side=turning(self))

    def _set(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _repr_html_(self) -> str:
        return f"<code>{escape(repr(self))}</code>"

    def evaluate(self, u: Sequence[float] | np.ndarray | float = (), t: float = 0.0, chart: int = 0) -> np.ndarray:
        """f and its derivatives at one parameter value.

        Parameters
        ----------
        u : (k,) array or float
            Parameters of the given chart.
        t : float
            Time in s.
        chart : int
            One of `charts`.

        Returns
        -------
        (10, 3) array
            f, f_1, f_2, f_11, f_12, f_22, f_t, f_1t, f_2t, f_tt in the contour's frame; not finite where f is not
            differentiable.

        Raises
        ------
        ContourError
            For a wrong number of parameters or chart.

        Examples
        --------
        >>> import pincontact as pc
        >>> f, f_1, _, f_11, *_ = pc.Circle(radius=0.3).evaluate(0.0)
        >>> f.tolist(), f_1.tolist(), f_11.tolist()
        ([0.3, 0.0, 0.0], [-0.0, 0.3, 0.0], [-0.3, -0.0, 0.0])
        """
        return self.evaluate_many(np.atleast_1d(np.asarray(u))[None], t, chart)[0]

    def evaluate_many(self, u: np.ndarray, t: float = 0.0, chart: int = 0) -> np.ndarray:
        """f and its derivatives at many parameter values.

        Parameters
        ----------
        u : (n, k) array
            Parameters of the given chart.
        t, chart
            As for `evaluate`.

        Returns
        -------
        (n, 10, 3) array
            The rows of `evaluate` for each of them.

        Raises
        ------
        ContourError
            For a wrong number of parameters or chart.
        """
        try:
            # a contour without parameters has none of any type
            u, t = real_array(u) if np.size(u) else np.zeros(np.shape(u)), real(t)
        except NOT_REAL:
            raise ContourError(f"{self.name}: u and t must be real numbers, got {u!r} and {t!r}") from None
        if u.ndim != 2 or u.shape[1] != self.dimension:
            raise ContourError(f"{self.name} has {self.dimension} parameters, got {u.shape[-1]}")
        if not is_number(chart) or chart not in self.charts:
            raise ContourError(f"{self.name} has the charts {self.charts}, there is no number {chart}")
        parameters = np.zeros((len(u), 2))
        parameters[:, : self.dimension] = u
        out = np.zeros((len(u), DERIVATIVE_ROWS, 3))
        try:
            evaluate_contour(self.evaluator, chart, self.shape_row(), self.pool, parameters, t, out)
        except (ArithmeticError, ValueError):
            # Without compilation Python raises where the kernels' arithmetic gives infinity or NaN.
            if len(u) == 1:
                out[:] = np.nan
            else:
                out = np.concatenate([self.evaluate_many(one[None], t, chart) for one in u])
        return out

    def point(self, u: Sequence[float] | float = (), t: float = 0.0, chart: int = 0) -> np.ndarray:
        """The point f(u, t) in the contour's frame.

        Parameters
        ----------
        u, t, chart
            As for `evaluate`.

        Returns
        -------
        (3,) array
            In m.
        """
        return self.evaluate(u, t, chart)[F]

    def ends(self) -> np.ndarray:
        """Where the contour stops.

        Returns
        -------
        (4,) array
            Low and high end of u1 and u2 in m or rad; infinite where it does not stop (periodic parameters, poles).
        """
        out = np.array([-np.inf, np.inf, -np.inf, np.inf])
        out[: 2 * self.dimension] = np.ravel(self.limits)
        return out

    def shape_row(self) -> np.ndarray:
        """The shape parameters padded to `SHAPE_SIZE`, as kernels read them.

        Returns
        -------
        (8,) array
        """
        row = np.zeros(SHAPE_SIZE)
        row[: len(self.shape)] = self.shape
        return row

    @property
    def name(self) -> str:
        """The name of its class."""
        return type(self).__name__

    def samples(self, n: int | Sequence[int] = 50, window: Window = None) -> np.ndarray:
        """A grid of parameter values that covers the domain of the first chart.

        Parameters
        ----------
        n : int or k ints
            Values along each parameter; ends are included, except that a parameter that wraps around has its end once.
        window : k pairs (low, high), optional
            Needed where the domain is infinite, and cut to the domain.

        Returns
        -------
        (number of points, k) array
            The last parameter runs fastest.

        Raises
        ------
        ContourError
            For an infinite domain without a window.

        Examples
        --------
        >>> import pincontact as pc
        >>> pc.Plane().samples(2, window=((0, 1), (0, 1))).tolist()
        [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]]
        """
        axes = self._axes(n, window, closed=False)
        if not axes:
            return np.zeros((1, 0))
        return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)

    def polyline(self, n: int = 100, window: Window = None, t: float = 0.0) -> np.ndarray:
        """Points along a curve, both ends included, so that a closed curve ends where it starts.

        Parameters
        ----------
        n : int
            Number of points.
        window : ((low, high),), optional
            As for `samples`.
        t : float
            Time in s.

        Returns
        -------
        (n, 3) array
            In the contour's frame.

        Raises
        ------
        ContourError
            For anything but a curve.
        """
        if self.dimension != 1:
            raise ContourError(f"{self.name} is not a curve: it has {self.dimension} parameters")
        (axis,) = self._axes(n, window, closed=True)
        return self.evaluate_many(axis[:, None], t)[:, F]

    def mesh(self, n: int | Sequence[int] = 40, window: Window = None, t: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Triangles of a surface; seams of parameters that wrap around are closed.

        Parameters
        ----------
        n : int or two ints
            Values along each parameter.
        window : two pairs (low, high), optional
            As for `samples`.
        t : float
            Time in s.

        Returns
        -------
        vertices : (n1 n2, 3) array
            In the contour's frame.
        triangles : (m, 3) array
            Indices of their vertices, counter-clockwise seen from outside.

        Raises
        ------
        ContourError
            For anything but a surface.
        """
        if self.dimension != 2:
            raise ContourError(f"{self.name} is not a surface: it has {self.dimension} parameters")
        vertices = self.evaluate_many(self.samples(n, window), t)[:, F]
        n1, n2 = (len(axis) for axis in self._axes(n, window, closed=False))
        first = np.arange(n1 if self._wraps(0, window) else n1 - 1)
        second = np.arange(n2 if self._wraps(1, window) else n2 - 1)
        i, j = (grid.ravel() for grid in np.meshgrid(first, second, indexing="ij"))
        a, b = i * n2 + j, (i + 1) % n1 * n2 + j
        c, d = i * n2 + (j + 1) % n2, (i + 1) % n1 * n2 + (j + 1) % n2
        return vertices, np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])

    def _wraps(self, axis: int, window: Window) -> bool:
        return self.periodic[axis] and (window is None or window[axis] is None)

    def _axes(self, n: int | Sequence[int], window: Window, closed: bool) -> list[np.ndarray]:
        counts = list(n) if isinstance(n, (Sequence, np.ndarray)) else [n] * self.dimension
        whole = all(isinstance(count, (int, np.integer)) for count in counts)
        if not whole or len(counts) != self.dimension or any(count < 2 for count in counts):
            raise ContourError(f"{self.name}: at least 2 values are needed along each parameter, got {n!r}")
        if window is not None and not (isinstance(window, (Sequence, np.ndarray)) and len(window) == self.dimension):
            raise ContourError(f"{self.name}: window must have {self.dimension} entries, got {window!r}")
        axes = []
        for i, (count, (low, high)) in enumerate(zip(counts, self.domain)):
            if window is not None and window[i] is not None:
                start, end = interval(self.name, f"window[{i}]", window[i])
                low, high = (start, end) if self.periodic[i] else (max(low, start), min(high, end))
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
                raise ContourError(
                    f"{self.name}: parameter {i} runs over ({low}, {high}); a window within its domain is needed"
                )
            wraps = self._wraps(i, window) and not closed
            axes.append(np.linspace(low, high, count, endpoint=not wraps))
        return axes


def as_written(cls: type, given: tuple[Any, ...], named: dict[str, Any]) -> str:
    """How a user would write the object of a class that is made with these arguments; long ones, and functions, are
    shown by their size or name. Without these it can be read as Python: `eval(repr(contour))` is the same contour."""
    try:
        arguments = inspect.signature(cls.__init__).bind(None, *given, **named).arguments  # type: ignore[misc]
    except TypeError:  # the constructor says what is wrong with them
        return f"{cls.__name__}(...)"
    return f"{cls.__name__}({', '.join(f'{name}={_shown(value)}' for name, value in list(arguments.items())[1:])})"


def _shown(value: Any) -> str:
    if callable(value):
        return getattr(value, "__name__", type(value).__name__)
    try:
        shape = np.shape(value)
    except ValueError:
        # parts of different shapes
        inner = ", ".join(map(_shown, value))
        return f"[{inner}]" if isinstance(value, list) else f"({inner})"
    if math.prod(shape) <= _MOST_NUMBERS:
        text = repr(_plain(value))
        if len(text) <= _LONGEST_ARGUMENT:
            return text
    return f"array{shape}" if shape else reprlib.repr(value)


def _plain(value: Any) -> Any:
    """The same of Python's own numbers and lists."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if type(value) in (list, tuple):
        return type(value)(map(_plain, value))
    return value


def half_diagonal(contour: Contour, t: float = 0.0) -> float:
    """Half the diagonal of the box around a contour of finite domain, else infinity."""
    if not np.isfinite(contour.domain).all():
        return np.inf
    points = contour.evaluate_many(contour.samples(12 if contour.dimension == 2 else 64), t)[:, F]
    return 0.5 * float(np.linalg.norm(np.ptp(points, axis=0)))


def turning(contour: Contour) -> int:
    """`convex_side` of a curve: the sense in which it runs around a convex region, 0 if it does not.

    A closed planar curve is convex if its curvature keeps one sign and its tangent turns around once.
    """
    if not (contour.planar and contour.periodic[0]) or contour.time_dependent:
        return 0
    low, high = contour.domain[0]
    n = 720
    rows = contour.evaluate_many(contour.samples(n))
    first, second = rows[:, F_1], rows[:, F_11]
    bend = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    speed = first[:, 0] ** 2 + first[:, 1] ** 2
    if not (speed > 0.0).all() or (bend.min() < 0.0 < bend.max()):
        return 0
    turns = (high - low) / n * float((bend / speed).sum()) / (2.0 * np.pi)
    # The sum is exponentially accurate for smooth curves; a whole number of turns is all that matters here.
    whole = round(turns)
    return whole if abs(whole) == 1 else 0
