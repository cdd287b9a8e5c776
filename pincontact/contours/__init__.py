"""Contours: points, curves and surfaces that touch (Sec. 2.1 of the paper)."""

from .base import Contour
from .curves import Circle, Line
from .parametric import ParametricCurve, ParametricSurface
from .points import Point
from .surfaces import Plane, Sphere

__all__ = ["Circle", "Contour", "Line", "ParametricCurve", "ParametricSurface", "Plane", "Point", "Sphere"]
