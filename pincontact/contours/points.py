"""A material point as a contour (no parameters)."""

from __future__ import annotations

from ..jit import kernel
from .base import POINT, Contour


class Point(Contour):
    """The origin of its frame."""

    def __init__(self) -> None:
        super().__init__(kind=POINT, dimension=0, size=0.0)


@kernel
def point(out):
    out[0, 0], out[0, 1], out[0, 2] = 0.0, 0.0, 0.0
