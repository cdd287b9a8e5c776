"""A material point as a contour (no parameters)."""

from __future__ import annotations

from .base import POINT, Contour
from .evaluation import contour_kernel


class Point(Contour):
    """The origin of its frame.

    Examples
    --------
    >>> import pincontact as pc
    >>> pc.Point().point().tolist()
    [0.0, 0.0, 0.0]
    """

    def __init__(self) -> None:
        super().__init__(point, 0, size=0.0, kind=POINT)


@contour_kernel
def point(chart, shape, pool, u1, u2, t, out):
    out[0, 0], out[0, 1], out[0, 2] = 0.0, 0.0, 0.0
