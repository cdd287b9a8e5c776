"""Curves in closed form. The planar ones lie in their frame's xy-plane."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..arguments import NOT_REAL, real_array
from ..errors import ContourError
from ..jit import kernel
from .base import (
    CIRCLE,
    CYCLOID,
    ELLIPSE,
    FOURIER_CURVE,
    HELIX,
    LINE,
    Contour,
    finite,
    half_diagonal,
    in_space,
    interval,
    positive,
    turning,
)

TURN = (-math.pi, math.pi)
ALL = (-math.inf, math.inf)
_WHOLE = 2.0 * math.pi * (1.0 + 1e-14)


def _arc(owner: str, domain: Any) -> tuple[tuple[float, float], bool]:
    """Domain of an angle and whether it closes; no domain means the full turn."""
    if domain is None:
        return TURN, True
    low, high = interval(owner, "domain", domain)
    if not high - low <= _WHOLE:
        raise ContourError(f"{owner}: domain must not exceed one turn, got {high - low} rad")
    return (low, high), closes(low, high)


def closes(low: float, high: float) -> bool:
    """Whether these angles are one turn apart, up to the rounding of multiples of pi."""
    return abs(high - low - 2.0 * math.pi) <= _WHOLE - 2.0 * math.pi


class Line(Contour):
    """The x axis: f(u) = (u, 0, 0).

    domain: (low, high) of u in m for a segment; infinite if not given.
    Raises ContourError unless low < high.
    """

    def __init__(self, domain: tuple[float, float] | None = None) -> None:
        low, high = ALL if domain is None else interval("Line", "domain", domain)
        super().__init__(
            kind=LINE,
            dimension=1,
            domain=((low, high),),
            periodic=(False,),
            planar=True,
            size=0.5 * (high - low),
        )


class Circle(Contour):
    """f(u) = radius (cos u, sin u, 0).

    radius: m; domain: (low, high) of u in rad for an arc of at most one turn.
    Raises ContourError for a radius that is not positive or a domain that is not such an arc.
    """

    def __init__(self, radius: float, domain: tuple[float, float] | None = None) -> None:
        (radius,) = positive("Circle", radius=radius)
        arc, closed = _arc("Circle", domain)
        super().__init__(
            kind=CIRCLE,
            dimension=1,
            shape=(radius,),
            domain=(arc,),
            periodic=(closed,),
            planar=True,
            size=radius,
            convex_side=1 if closed else 0,
        )


class Ellipse(Contour):
    """f(u) = (a cos u, b sin u, 0).

    a, b: semi-axes in m; domain: (low, high) of u in rad for an arc of at most one turn.
    Raises ContourError for a semi-axis that is not positive or a domain that is not such an arc.
    """

    def __init__(self, a: float, b: float, domain: tuple[float, float] | None = None) -> None:
        a, b = positive("Ellipse", a=a, b=b)
        arc, closed = _arc("Ellipse", domain)
        super().__init__(
            kind=ELLIPSE,
            dimension=1,
            shape=(a, b),
            domain=(arc,),
            periodic=(closed,),
            planar=True,
            size=max(a, b),
            convex_side=1 if closed else 0,
        )


class Helix(Contour):
    """f(u) = (radius cos u, radius sin u, pitch u / (2 pi)).

    radius: m; pitch: m of climb along z per turn, negative for a left-handed helix; domain: (low, high) of u in
    rad, infinite if not given.
    Raises ContourError for a radius that is not positive or a pitch that is not finite.
    """

    def __init__(self, radius: float, pitch: float, domain: tuple[float, float] | None = None) -> None:
        (radius,) = positive("Helix", radius=radius)
        (pitch,) = finite("Helix", pitch=pitch)
        super().__init__(
            kind=HELIX,
            dimension=1,
            shape=(radius, pitch / (2.0 * math.pi)),
            domain=(ALL if domain is None else interval("Helix", "domain", domain),),
            periodic=(False,),
            size=radius,
        )


# A contact comes to an end so far from a cusp, rad, since u' grows without bound towards it. What is left of the arch
# is of the order of its square.
_CUSP = 1e-4


class Cycloid(Contour):
    """One arch of a cycloid, opening to +y (a cup): f(u) = radius (u + sin u, 1 - cos u, 0), |u| < pi.

    radius: of the generating circle, m; domain: (low, high) of u within (-pi, pi), whose ends are cusps.
    Raises ContourError for a radius that is not positive or a domain beyond the cusps.
    """

    def __init__(self, radius: float, domain: tuple[float, float] = TURN) -> None:
        (radius,) = positive("Cycloid", radius=radius)
        low, high = interval("Cycloid", "domain", domain)
        if low < -math.pi or high > math.pi:
            raise ContourError(f"Cycloid: domain must stay between the cusps -pi and pi, got ({low}, {high})")
        super().__init__(
            kind=CYCLOID,
            dimension=1,
            shape=(radius,),
            domain=((low, high),),
            periodic=(False,),
            planar=True,
            size=radius,
        )

    def ends(self) -> np.ndarray:
        out = super().ends()
        out[0], out[1] = max(out[0], _CUSP - math.pi), min(out[1], math.pi - _CUSP)
        return out


class FourierCurve(Contour):
    """A closed curve f(u) = sum over k = 0..n of cosine[k] cos(k u) + sine[k] sin(k u).

    cosine, sine: (n + 1, 3) coefficients in m, or (n + 1, 2) for a planar curve; sine[0] has no effect.
    Raises ContourError for shapes that do not match, numbers that are not finite or a curve without extent.
    """

    def __init__(self, cosine: Any, sine: Any) -> None:
        tables = []
        for name, given in (("cosine", cosine), ("sine", sine)):
            try:
                table = real_array(given)
            except NOT_REAL:
                raise ContourError(f"FourierCurve: {name} must be an array of numbers") from None
            if table.ndim != 2 or table.shape[1] not in (2, 3) or len(table) < 2:
                raise ContourError(f"FourierCurve: {name} must be (n + 1, 2 or 3), n > 0, got {table.shape}")
            if not np.isfinite(table).all():
                raise ContourError(f"FourierCurve: {name} has an entry that is not finite")
            tables.append(in_space(table))
        if tables[0].shape != tables[1].shape:
            raise ContourError(f"FourierCurve: {len(tables[0])} rows of cosine but {len(tables[1])} of sine")
        if not np.any(tables[0][1:]) and not np.any(tables[1][1:]):
            raise ContourError("FourierCurve: all coefficients beyond the constant one are zero")
        tables[1][0] = 0.0
        super().__init__(
            kind=FOURIER_CURVE,
            dimension=1,
            shape=(float(len(tables[0])),),
            pool=np.stack(tables, axis=1).ravel(),
            domain=(TURN,),
            periodic=(True,),
            planar=not np.any([table[:, 2] for table in tables]),
        )
        object.__setattr__(self, "size", half_diagonal(self))
        object.__setattr__(self, "convex_side", turning(self))


@kernel
def put_curve(out, x, y, z, x_1, y_1, z_1, x_11, y_11, z_11):
    """Write the rows F, F_1 and F_11."""
    out[0, 0], out[0, 1], out[0, 2] = x, y, z
    out[1, 0], out[1, 1], out[1, 2] = x_1, y_1, z_1
    out[3, 0], out[3, 1], out[3, 2] = x_11, y_11, z_11


@kernel
def closed_form_curve(kind, shape, u, out):
    """Line, circle, ellipse, helix or cycloid."""
    if kind == LINE:
        put_curve(out, u, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        return
    c, s = math.cos(u), math.sin(u)
    a = shape[0]
    if kind == CYCLOID:
        # 1 - cos u and 1 + cos u without cancellation.
        half_s, half_c = math.sin(0.5 * u), math.cos(0.5 * u)
        y, x_1 = 2.0 * a * half_s * half_s, 2.0 * a * half_c * half_c
        put_curve(out, a * (u + s), y, 0.0, x_1, a * s, 0.0, -a * s, a * c, 0.0)
        return
    b = shape[1] if kind == ELLIPSE else a
    climb = shape[1] if kind == HELIX else 0.0
    put_curve(out, a * c, b * s, climb * u, -a * s, b * c, climb, -a * c, -b * s, 0.0)


@kernel
def fourier_curve(shape, pool, u, out):
    """Coefficients (cosine, sine) of each order in turn; the angle is advanced by complex multiplication."""
    for i in range(3):
        out[0, i], out[1, i], out[3, i] = 0.0, 0.0, 0.0
    c, s = math.cos(u), math.sin(u)
    c_k, s_k = 1.0, 0.0
    for k in range(int(shape[0])):
        for i in range(3):
            a, b = pool[6 * k + i], pool[6 * k + 3 + i]
            value = a * c_k + b * s_k
            out[0, i] += value
            out[1, i] += k * (b * c_k - a * s_k)
            out[3, i] -= k * k * value
        c_k, s_k = c_k * c - s_k * s, s_k * c + c_k * s
