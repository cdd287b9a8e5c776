"""What acts in inverse dynamics: unit forces of contacts with the friction that goes with them, and joints at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..dynamics.friction_scaling import associated
from ..dynamics.joints import END_SLACK
from ..errors import StateError
from ..geometry.patterns import ON_CURVE
from ..layout import MODE, MU_NOW, PATTERN, SLIP_SIGN, SLIPPING, TANGENTS, UNILATERAL
from .instant import Instant

# Smaller loads, in N or N m, are round-off.
LEAST_LOAD = 1e-6


@dataclass(frozen=True)
class RestingJoints:
    """Joint coordinates that rest and are to stay at rest, by dry friction or at an end of their way: indices in v,
    and the range (low, high) of the force that holds them, infinite towards the inside of an end."""

    index: np.ndarray
    low: np.ndarray
    high: np.ndarray


def joint_loads(
    instant: Instant, a: np.ndarray, tolerance: float, stop: bool = False
) -> tuple[RestingJoints, np.ndarray, np.ndarray]:
    """What holds joints that rest and stay at rest; the friction (nv,) of those that begin to move; and the directions
    (nv,) in which they can only go, 0 for others.

    stop: joints that are to go beyond their ends stay there, else that is a StateError.
    """
    beginning, directions = np.zeros(a.size), np.zeros(a.size)
    held: list[tuple[int, float, float]] = []
    still = tolerance * max(1.0, float(np.abs(a).max(initial=0.0)))
    for limit in instant.system.limits:
        k, position = limit.index_v, float(instant.q[limit.index_q])
        if not instant.at_rest(float(instant.v[k])):
            continue
        at_low, at_high = position <= limit.low_end + END_SLACK, position >= limit.high_end - END_SLACK
        beyond = at_low if a[k] < -still else a[k] > still and at_high
        if beyond and not stop:
            raise StateError(
                f"acceleration: it takes joint {limit.joint!r}, which is at an end of its way, q[{limit.index_q}] = "
                f"{position:.9g}, beyond it at {a[k]:.3g} rad/s^2 (m/s^2)"
            )
        if beyond or abs(a[k]) <= still:
            low, high = -np.inf if at_high else limit.low_force, np.inf if at_low else limit.high_force
            if low < high:
                held.append((k, low, high))
        else:
            beginning[k] = limit.low_force if a[k] > 0.0 else limit.high_force
            if beginning[k] != 0.0 or at_low or at_high:
                directions[k] = np.sign(a[k])
    index = np.array([k for k, *_ in held], dtype=int)
    bounds = np.array([(low, high) for _, low, high in held]).reshape(-1, 2)
    return RestingJoints(index, bounds[:, 0], bounds[:, 1]), beginning, directions


def unit_forces(instant: Instant, c: int, row: int, share: float) -> dict[int, np.ndarray]:
    """Item -> force on body 2 along its basis that a unit of one component brings with it: the component itself, and of
    a normal one the friction of the contact and of its resistances where they slide."""
    system = instant.system
    unit = np.zeros(3)
    unit[row] = 1.0
    out = {c: unit}
    if c >= system.nc or not (row == 2 or (row == 1 and system.contact_int[c, PATTERN] == ON_CURVE)):
        return out
    for item in (c, *(i for i in system.resisting() if system.owner(i) == c)):
        integers = system.contact_int[item]
        if integers[MODE] != SLIPPING:
            continue
        force, mu = out.setdefault(item, np.zeros(3)), system.contact_real[item, MU_NOW]
        if integers[TANGENTS] == 1:
            force[0] -= mu * share * float(integers[SLIP_SIGN])
        else:
            along = system.basis[item, :2] @ system.slip[item]
            force[:2] -= mu * share * associated(system, item, along / np.hypot(along[0], along[1]))
    return out


def shares_of(instant: Instant, solved: list[tuple[int, int]], components: np.ndarray) -> np.ndarray:
    """|F_n| by each normal component: the components of its unit vector on a spatial curve, else its sign."""
    out = np.ones(len(solved))
    integers = instant.system.contact_int
    for c in {c for c, _ in solved if c < instant.system.nc}:
        on_curve = integers[c, PATTERN] == ON_CURVE
        normals = [k for k, (other, row) in enumerate(solved) if other == c and (row == 2 or (row == 1 and on_curve))]
        size = float(np.linalg.norm(components[normals]))
        if size > 0.0 and not integers[c, UNILATERAL]:
            out[normals] = components[normals] / size
    return out
