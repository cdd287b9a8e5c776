"""A material point as a contour (no parameters)."""

from __future__ import annotations

from ..workspace import matrix_at
from .base import POINT, Contour
from .evaluation import contour_kernel
from .sizes import DERIVATIVE_ROWS


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
def point(chart, shape, pool, pool_size, u1, u2, t, out):
    f = matrix_at(out, DERIVATIVE_ROWS, 3)
    f[0, 0], f[0, 1], f[0, 2] = 0.0, 0.0, 0.0
    return 0
