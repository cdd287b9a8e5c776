"""What a contact's mode says of its forces, and the outcome of a choice of modes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.patterns import ON_CURVE
from ..layout import (
    FRICTIONLESS,
    MODE,
    MU,
    NORMAL_1,
    NORMAL_SIGN,
    PATTERN,
    SLIPPING,
    STICK,
    UNILATERAL,
    VISCOUS,
)

if TYPE_CHECKING:
    from .system import System


@dataclass
class Decision:
    """Outcome of `ModeSolver.resolve_modes`.

    status: of the evaluation in the new modes; started: contacts that begin to slip, with the relative acceleration
    in m/s^2 at which they do; opened: contacts that open; residual of the contact problem, 0 where none was solved;
    forces (items, 3) of its solution in N.
    """

    status: int
    started: dict[int, float] = field(default_factory=dict)
    opened: list[int] = field(default_factory=list)
    residual: float = 0.0
    forces: np.ndarray | None = None


def held_up_by_friction(system: System, c: int) -> bool:
    """Whether contact c slides with F_n = 0 and a tangential force against its slip: ideal rolling, or what a part of
    its viscous friction keeps from closing."""
    return ideal_slip(system, c) or shares_viscous_force(system, c)


def ideal_slip(system: System, c: int) -> bool:
    """Whether contact c is ideal rolling that slides, held up by friction alone."""
    return bool(system.contact_int[c, MODE] == SLIPPING and math.isinf(system.contact_real[c, MU]))


def shares_viscous_force(system: System, c: int) -> bool:
    """Whether contact c is held up by a part of its viscous friction alone."""
    integers = system.contact_int[c]
    return bool(integers[MODE] == SLIPPING and integers[UNILATERAL] and integers[NORMAL_SIGN] < 0)


def drags(system: System, c: int) -> bool:
    """Whether contact c is unilateral and moves with viscous friction, which vanishes as it opens."""
    integers = system.contact_int[c]
    moves = integers[MODE] in (SLIPPING, FRICTIONLESS) and integers[UNILATERAL]
    return bool(moves and system.contact_real[c, VISCOUS] > 0.0)


def rest_mode(mu: float) -> int:
    """The mode of a closed contact that does not slide."""
    return FRICTIONLESS if mu == 0.0 else STICK


def set_normal(system: System, c: int, force: np.ndarray, least: float = 0.0) -> None:
    """Give contact c, if it is bilateral, the sign, on a curve the direction, of the normal force among these (3,), if
    that exceeds `least` in N."""
    integers, numbers = system.contact_int[c], system.contact_real[c]
    on_curve = integers[PATTERN] == ON_CURVE
    size = math.hypot(force[1], force[2]) if on_curve else abs(force[2])
    if integers[UNILATERAL] or not size > least:
        return
    if on_curve:
        numbers[NORMAL_1 : NORMAL_1 + 2] = force[2] / size, force[1] / size
    else:
        integers[NORMAL_SIGN] = 1 if force[2] > 0.0 else -1
