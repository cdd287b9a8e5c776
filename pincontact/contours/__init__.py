"""Contours: points, curves and surfaces that touch (Sec. 2.1 of the paper)."""

from .base import Contour
from .curves import Circle, Cycloid, Ellipse, FourierCurve, Helix, Line
from .parametric import HeightField, ParametricCurve, ParametricSurface
from .points import Point
from .revolution import SurfaceOfRevolution
from .splines import SplineCurve, SplineSurface
from .surfaces import Cone, Cylinder, Ellipsoid, Plane, Sphere, Torus

__all__ = [
    "Circle",
    "Cone",
    "Contour",
    "Cycloid",
    "Cylinder",
    "Ellipse",
    "Ellipsoid",
    "FourierCurve",
    "HeightField",
    "Helix",
    "Line",
    "ParametricCurve",
    "ParametricSurface",
    "Plane",
    "Point",
    "Sphere",
    "SplineCurve",
    "SplineSurface",
    "SurfaceOfRevolution",
    "Torus",
]
