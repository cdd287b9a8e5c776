"""Friction laws of a contact: parameters only; what they mean for the forces is decided in `cone` and `solve`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any

from ..errors import FrictionError


def _coefficient(owner: str, name: str, value: Any) -> float:
    """The value as a float, or a FrictionError saying which coefficient is not finite and non-negative."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise FrictionError(f"{owner}: {name} must be a number, got {value!r}") from None
    if not (isfinite(number) and number >= 0.0):
        raise FrictionError(f"{owner}: {name} must be finite and not negative, got {number}")
    return number


class FrictionLaw(ABC):
    """What limits the tangential force of a contact. A contact without a law (None) is frictionless."""

    @property
    @abstractmethod
    def sliding(self) -> float:
        """Coefficient in force while the contact slips: |F_t| = sliding * F_n; infinite where it cannot slip."""

    @property
    def sticking(self) -> float:
        """Coefficient up to which the contact sticks: |F_t| <= sticking * F_n."""
        return self.sliding


@dataclass(frozen=True)
class Coulomb(FrictionLaw):
    """Dry friction (Sec. 5.3): stick while |F_t| <= mu_static F_n, else F_t = -mu F_n v_t / |v_t|.

    mu:        coefficient of sliding friction, finite, >= 0; 0 is frictionless
    mu_static: coefficient that has to be exceeded before a sticking contact slides, >= mu; None means mu

    Raises FrictionError for a coefficient that is negative or not finite, or mu_static < mu.
    """

    mu: float
    mu_static: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "mu", _coefficient("Coulomb", "mu", self.mu))
        if self.mu_static is not None:
            static = _coefficient("Coulomb", "mu_static", self.mu_static)
            object.__setattr__(self, "mu_static", static)
            if static < self.mu:
                raise FrictionError(f"Coulomb: mu_static must not be below mu, got {static} < {self.mu}")

    @property
    def sliding(self) -> float:
        return self.mu

    @property
    def sticking(self) -> float:
        return self.mu if self.mu_static is None else self.mu_static


@dataclass(frozen=True)
class NoSlip(FrictionLaw):
    """Ideal rolling (VC, Sec. 4): whatever tangential force keeps the contact from slipping.

    A unilateral contact is let go where its normal force reaches zero, however large the tangential force is by then:
    with infinite friction the law says no more, in every method.
    """

    @property
    def sliding(self) -> float:
        return inf
