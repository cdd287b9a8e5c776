"""Friction laws of a contact: parameters only; what they mean for the forces is decided in `cone` and `solve`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, isclose, isfinite
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arguments import number
from ..errors import FrictionError
from ..layout import CURVE_SPEED, STRIBECK_EXPONENT
from .stribeck import stribeck

# Static coefficients of two directions are in the proportion of the sliding ones, to round-off of what users type.
_PROPORTION = 1e-9
# Exponents of the Stribeck curve: below 1 friction falls infinitely steeply as slip starts; above, a cliff.
_EXPONENTS = (1.0, 50.0)

Coefficient = float | tuple[float, float]


def _number(owner: str, name: str, value: Any) -> float:
    """The value as a float, or a FrictionError saying which parameter is not finite and non-negative."""
    found = number(f"{owner}: {name} must be a number", value, FrictionError)
    if not (isfinite(found) and found >= 0.0):
        raise FrictionError(f"{owner}: {name} must be finite and not negative, got {found}")
    return found


def _coefficient(owner: str, name: str, value: Any) -> Coefficient:
    """A number, or a pair of positive ones."""
    if isinstance(value, str) or not isinstance(value, (Sequence, np.ndarray)) or np.ndim(value) == 0:
        return _number(owner, name, value)
    if len(value) != 2:
        raise FrictionError(f"{owner}: {name} must be a number or a pair (along, across), got {value!r}")
    along, across = (_number(owner, f"{name}[{i}]", entry) for i, entry in enumerate(value))
    if along == 0.0 or across == 0.0:
        raise FrictionError(f"{owner}: {name} of two directions must be positive, got ({along}, {across})")
    return along, across


def _first(value: Coefficient) -> float:
    return value[0] if isinstance(value, tuple) else value


def _last(value: Coefficient) -> float:
    return value[1] if isinstance(value, tuple) else value


class FrictionLaw(ABC):
    """What limits the tangential force of a contact; base class of all laws.

    Laws derived from it elsewhere have constant coefficients: a law whose `coefficient` is its own, or whose `onset`
    is not `sliding`, is refused where it would be evaluated, since kernels compute coefficients.

    A contact without a law (None) is frictionless. Of two directions, coefficients are those along the first; `aspect`
    is what they are times across it.

    Attributes
    ----------
    viscous : float
        c in N s/m: a further force -c v_t, whatever the normal force.
    spinning, rolling : float
        Lengths in m: torques up to length * F_n resist rotation about the normal, about the tangents.
    along : str, optional
        Name of the contour whose first tangent the first of two coefficients belongs to.
    """

    viscous: float = 0.0
    spinning: float = 0.0
    rolling: float = 0.0
    along: str | None = None

    @property
    @abstractmethod
    def sliding(self) -> float:
        """Coefficient in force while the contact slips (fast): |F_t| = sliding * F_n; infinite where it cannot slip."""

    @property
    def sticking(self) -> float:
        """Coefficient up to which the contact sticks: |F_t| <= sticking * F_n."""
        return self.sliding

    @property
    def onset(self) -> float:
        """Coefficient in force as slip starts."""
        return self.sliding

    @property
    def aspect(self) -> float:
        """Coefficients across the first direction over those along it; 1 for isotropic friction."""
        return 1.0

    @property
    def resists_turning(self) -> bool:
        """Whether torques resist spinning or rolling."""
        return self.spinning > 0.0 or self.rolling > 0.0

    def coefficient(self, speed: npt.ArrayLike) -> np.ndarray:
        """Coefficient in force while the contact slips.

        Parameters
        ----------
        speed : (...) array_like
            Slip speeds in m/s.

        Returns
        -------
        (...) array
            Of the speed's shape.
        """
        return np.full(np.shape(speed), self.sliding)

    @property
    def curve(self) -> dict[int, float]:
        """What kernels know of a coefficient that depends on slip speed, by column of `contact_real`; empty for others.

        `CURVE_SPEED` is the speed in m/s over which the coefficient changes, whatever the curve.
        """
        return {}

    def _set_resistances(self) -> None:
        """Check and convert the parameters that all laws share."""
        owner = type(self).__name__
        for name in ("viscous", "spinning", "rolling"):
            object.__setattr__(self, name, _number(owner, name, getattr(self, name)))
        if self.along is not None and not isinstance(self.along, str):
            raise FrictionError(f"{owner}: along must be the name of a contour, got {self.along!r}")


class _Dry(FrictionLaw):
    """Friction with a coefficient of sliding and one of sticking, which may be those of two directions."""

    mu: Coefficient
    mu_static: Coefficient | None

    def _set_coefficients(self) -> None:
        """Check and convert mu and mu_static."""
        owner = type(self).__name__
        mu = _coefficient(owner, "mu", self.mu)
        object.__setattr__(self, "mu", mu)
        if self.along is not None and not isinstance(mu, tuple):
            raise FrictionError(f"{owner}: along={self.along!r} needs mu=(along, across), got mu={mu}")
        if self.mu_static is None:
            return
        static = _coefficient(owner, "mu_static", self.mu_static)
        object.__setattr__(self, "mu_static", static)
        if isinstance(mu, tuple) != isinstance(static, tuple):
            raise FrictionError(
                f"{owner}: mu and mu_static must both be numbers or both be pairs, got {mu} and {static}"
            )
        if not isclose(_first(static) * _last(mu), _last(static) * _first(mu), rel_tol=_PROPORTION):
            raise FrictionError(f"{owner}: mu_static must be in the proportion of mu, got {static} and {mu}")
        if _first(static) < _first(mu):
            raise FrictionError(f"{owner}: mu_static must not be below mu, got {static} < {mu}")

    @property
    def sliding(self) -> float:
        return _first(self.mu)

    @property
    def sticking(self) -> float:
        return _first(self.mu if self.mu_static is None else self.mu_static)

    @property
    def aspect(self) -> float:
        return _last(self.mu) / _first(self.mu) if isinstance(self.mu, tuple) else 1.0


@dataclass(frozen=True)
class Coulomb(_Dry):
    """Dry friction (Sec. 5.3): stick while |F_t| <= mu_static F_n, else F_t = -mu F_n v_t / |v_t|.

    mu = (mu_1, mu_2), both positive, is friction of two directions, along a tangent and across it: stick while
    (F_1 / mu_1)^2 + (F_2 / mu_2)^2 <= F_n^2, else the force on that ellipse that takes most power from the slip
    (the associated law), F_t = -F_n S^2 v_t / |S v_t| with S = diag(mu_1, mu_2). mu_static is then a pair of the same
    proportion.

    The torques are dry friction, too: of that length where there is rotation, and what holds it at rest where there is
    none. Lengths below 1e-12 of the contours' size are taken as zero by event-driven runs.

    Parameters
    ----------
    mu : float or (float, float)
        Coefficient of sliding friction, finite, >= 0; 0 is frictionless.
    mu_static : float or (float, float), optional
        Coefficient that has to be exceeded before a sticking contact slides, >= mu; None means mu.
    viscous : float
        c in N s/m, >= 0: a further force -c v_t, whatever the normal force.
    spinning : float
        Length in m, >= 0: a torque up to spinning * F_n resists rotation about the normal.
    rolling : float
        Length in m, >= 0: a torque up to rolling * F_n resists rotation about the tangents.
    along : str, optional
        Name of the contour whose first tangent the first of two coefficients belongs to; None means the tangent e_1
        of the contact frame, body 2's.

    Raises
    ------
    FrictionError
        For a parameter that is negative or not finite, mu_static < mu, pairs out of proportion.

    Examples
    --------
    >>> import pincontact as pc
    >>> pc.Coulomb(0.3, mu_static=0.4).sticking
    0.4
    """

    mu: Coefficient
    mu_static: Coefficient | None = None
    viscous: float = field(default=0.0, kw_only=True)
    spinning: float = field(default=0.0, kw_only=True)
    rolling: float = field(default=0.0, kw_only=True)
    along: str | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        self._set_resistances()
        self._set_coefficients()


@dataclass(frozen=True)
class Stribeck(_Dry):
    """Dry friction that falls from mu_static to mu as slip gets faster (Bo and Pavelescu's form of Stribeck's curve).

    Slip at speed s is opposed by F_n (mu + (mu_static - mu) exp(-(s / speed)^exponent)): slip starts with the force
    that stick ends with.

    Parameters
    ----------
    mu : float or (float, float)
        Coefficient of fast slip; of two directions as for `Coulomb`.
    mu_static : float or (float, float)
        Coefficient of stick and of slip that starts, >= mu.
    speed : float
        In m/s, > 0, at which the difference has fallen to 1 / e.
    exponent : float
        1 (Tustin) to 50; 2 is the Gaussian curve.
    viscous, spinning, rolling, along
        As for `Coulomb`.

    Raises
    ------
    FrictionError
        For a parameter out of bounds.

    Examples
    --------
    >>> import pincontact as pc
    >>> pc.Stribeck(0.2, 0.4, speed=0.1).coefficient([0.0, 10.0]).tolist()
    [0.4, 0.2]
    """

    mu: Coefficient
    mu_static: Coefficient
    speed: float
    exponent: float = 2.0
    viscous: float = field(default=0.0, kw_only=True)
    spinning: float = field(default=0.0, kw_only=True)
    rolling: float = field(default=0.0, kw_only=True)
    along: str | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        self._set_resistances()
        if self.mu_static is None:
            raise FrictionError("Stribeck: mu_static must be a number, got None")
        self._set_coefficients()
        for name in ("speed", "exponent"):
            object.__setattr__(self, name, _number("Stribeck", name, getattr(self, name)))
        if self.speed == 0.0:
            raise FrictionError("Stribeck: speed must be positive, got 0.0")
        if not _EXPONENTS[0] <= self.exponent <= _EXPONENTS[1]:
            raise FrictionError(f"Stribeck: exponent must lie in {list(_EXPONENTS)}, got {self.exponent}")

    @property
    def onset(self) -> float:
        return self.sticking

    @property
    def curve(self) -> dict[int, float]:
        return {CURVE_SPEED: self.speed, STRIBECK_EXPONENT: self.exponent}

    def coefficient(self, speed: npt.ArrayLike) -> np.ndarray:
        law = np.vectorize(stribeck, otypes=[float])
        return np.asarray(law(self.onset, self.sliding, self.speed, self.exponent, speed))


@dataclass(frozen=True)
class NoSlip(FrictionLaw):
    """Ideal rolling (VC, Sec. 4): whatever tangential force keeps the contact from slipping.

    It is the limit of Coulomb's law for large mu. A unilateral contact opens where its normal force reaches zero,
    however large the tangential force is by then. Where the bodies would then penetrate by more than a thousandth of
    the contact's length, it slides instead, with F_n = 0 and carried by the tangential force against its slip, until it
    sticks again or opens.

    Parameters
    ----------
    spinning, rolling : float
        Resistance to spinning and rolling in m, as of `Coulomb`.

    Raises
    ------
    FrictionError
        For a length that is negative or not finite.

    Examples
    --------
    >>> import pincontact as pc
    >>> pc.NoSlip().sliding
    inf
    """

    spinning: float = field(default=0.0, kw_only=True)
    rolling: float = field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
        self._set_resistances()

    @property
    def sliding(self) -> float:
        return inf


# All laws of the package; they cannot be written to.
LAWS: tuple[type[FrictionLaw], ...] = (Coulomb, Stribeck, NoSlip)
