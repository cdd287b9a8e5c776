"""Contours: points, curves and surfaces that touch (Sec. 2.1 of the paper)."""

from .base import Contour
from .curves import Circle, Cycloid, Ellipse, FourierCurve, Helix, Line
from .motion import CallableMotion, ConstantTwist, HarmonicMotion, Motion, SplineMotion
from .parametric import HeightField, ParametricCurve, ParametricSurface
from .points import Point
from .revolution import SurfaceOfRevolution
from .splines import SplineCurve, SplineSurface
from .surfaces import Cone, Cylinder, Ellipsoid, Plane, Sphere, Torus

__all__ = [
    "CallableMotion",
    "Circle",
    "Cone",
    "ConstantTwist",
    "Contour",
    "Cycloid",
    "Cylinder",
    "Ellipse",
    "Ellipsoid",
    "FourierCurve",
    "HarmonicMotion",
    "HeightField",
    "Helix",
    "Line",
    "Motion",
    "ParametricCurve",
    "ParametricSurface",
    "Plane",
    "Point",
    "Sphere",
    "SplineCurve",
    "SplineMotion",
    "SplineSurface",
    "SurfaceOfRevolution",
    "Torus",
]
