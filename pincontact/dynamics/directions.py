"""Directions of slip: which one a contact has, and which one slip has that begins from rest.

Slip that begins has the direction of the relative acceleration, which depends on friction, and so on that direction and
on the loads. The loads are those of evaluations in these directions, not those of a cone problem: redundant loads are
not unique, and contacts that are bilateral, or held up by friction, have no load in a cone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..layout import (
    DIRECTION_X,
    EVENT,
    FROZEN,
    FROZEN_COLUMNS,
    MODE,
    POLYNOMIAL_SIZE,
    SLIP_RATE,
    SLIP_SIGN,
    SLIPPING,
    START,
    TANGENTS,
)
from .friction_scaling import friction_scaling
from .units import whiten

if TYPE_CHECKING:
    from .system import System

# A relative acceleration points along a direction if no more than this part of it, and of what friction does to it,
# is across.
_ALONG = 1e-11
# Where Broyden's method stops at round-off, a relative residual up to this is accepted.
_ACCEPTED = 1e-8
# Angle in rad of the differences that give derivatives; its error leaves as much of each step.
_TURN = 1e-6
_STEPS, _LARGEST_TURN = 16, 0.5
# Derivatives are found anew where a step leaves more than this part.
_SLOW = 0.2
# Rounds of projections of friction between trials of Broyden's method, and projections in each.
_ATTEMPTS, _PROJECTIONS = 6, 30


def slip_direction(system: System, c: int) -> np.ndarray:
    """(2,) unit direction along (t1, second) of an item that slides, zero where there is none."""
    if system.contact_int[c, TANGENTS] == 1:
        return np.array([float(system.contact_int[c, SLIP_SIGN]), 0.0])
    along = system.basis[c, :2] @ system.slip[c]
    speed = math.hypot(along[0], along[1])
    if system.contact_int[c, FROZEN] or speed == 0.0:
        along = system.basis[c, :2] @ system.contact_real[c, DIRECTION_X : DIRECTION_X + 3]
        speed = math.hypot(along[0], along[1])
    return along / speed if speed > 0.0 else np.zeros(2)


def freeze_slip(system: System, c: int, direction: np.ndarray) -> None:
    """Let contact c slip in a given direction (components along its tangents) whatever its present v_c."""
    integers, numbers = system.contact_int[c], system.contact_real[c]
    integers[MODE] = SLIPPING
    if integers[TANGENTS] == 1:
        integers[SLIP_SIGN] = 1 if direction[0] >= 0.0 else -1
        integers[FROZEN] = 0
        return
    along, aside = direction.tolist()
    size = math.hypot(along, aside)
    along, aside = (along / size, aside / size) if size > 0.0 else (1.0, 0.0)
    tangents = list(zip(*system.basis[c, :2].tolist()))
    forward = [along * first + aside * second for first, second in tangents]
    # n x (a t1 + b second), since n x t1 is the second tangent
    across = [along * second - aside * first for first, second in tangents]
    # START, SPAN, DIRECTION, ACROSS, POLYNOMIAL
    numbers[START : START + FROZEN_COLUMNS] = [0.0, 1.0, *forward, *across, *[0.0] * POLYNOMIAL_SIZE]
    integers[FROZEN] = 1


def align_slips(system: System, t: float, items: list[int], evaluate: Callable[[float], int]) -> bool:
    """Turn the frozen directions of these items, which slide, to where their relative accelerations point under the
    loads of the evaluation in them, which is the last one then; False where there are none, and nothing has changed.
    """
    items = [i for i in items if system.contact_int[i, FROZEN]]
    return not items or _Alignment(system, t, items, evaluate).run()


class _Alignment:
    """Frozen directions of items as angles, and what is across them of relative accelerations."""

    def __init__(self, system: System, t: float, items: list[int], evaluate: Callable[[float], int]) -> None:
        self.system, self.t, self.items, self.evaluate = system, t, items, evaluate
        self.scalings = np.array([friction_scaling(system, i) for i in items])

    def run(self) -> bool:
        directions = [slip_direction(self.system, i) for i in self.items]
        # directions that fit already stay as they are to the last bit: conversion to angles would round them
        if self._fits(np.array(directions)):
            return True
        start = np.array([math.atan2(y, x) for x, y in directions])
        angles = start
        for _ in range(_ATTEMPTS):
            if self._solve(angles):
                return True
            projected = self._project(angles)
            if projected is None:
                break
            angles = projected
        self._across(start)
        return False

    def _fits(self, directions: np.ndarray) -> bool:
        """Whether relative accelerations point along these directions (k, 2), which the items have."""
        system = self.system
        if self.evaluate(self.t) > EVENT:
            return False
        along, scale = system.relative_acceleration[self.items], self._scale()
        across = directions[:, 0] * along[:, 1] - directions[:, 1] * along[:, 0]
        rates = system.contact_real[self.items, SLIP_RATE]
        return bool((np.abs(across) <= _ALONG * scale).all() and (rates >= -_ALONG * scale).all())

    def _across(self, angles: np.ndarray) -> np.ndarray | None:
        """(k,) relative accelerations in m/s^2 across the directions at these angles; None without an evaluation."""
        system = self.system
        for i, angle in zip(self.items, angles.tolist()):
            freeze_slip(system, i, np.array([math.cos(angle), math.sin(angle)]))
        if self.evaluate(self.t) > EVENT:
            return None
        along = system.relative_acceleration[self.items]
        return np.cos(angles) * along[:, 1] - np.sin(angles) * along[:, 0]

    def _solve(self, angles: np.ndarray) -> bool:
        """Broyden's method from these angles; whether it has found directions along which slip grows, or rests."""
        system = self.system
        across = self._across(angles)
        if across is None:
            return False
        scale = self._scale()
        jacobian: np.ndarray | None = None
        least = math.inf
        for _ in range(_STEPS):
            error = float((np.abs(across) / scale).max())
            if error <= _ALONG or (error <= _ACCEPTED and error >= 0.5 * least):
                return bool((system.contact_real[self.items, SLIP_RATE] >= -_ALONG * scale).all())
            if jacobian is None or error > _SLOW * least:
                jacobian = self._jacobian(angles, across)
                if jacobian is None:
                    return False
            least = min(error, least)
            step = -np.linalg.lstsq(jacobian, across, rcond=_ALONG)[0]
            step *= min(1.0, _LARGEST_TURN / max(float(np.abs(step).max()), _TURN))
            angles = angles + step
            found = self._across(angles)
            if found is None:
                return False
            jacobian += np.outer(found - across - jacobian @ step, step) / max(float(step @ step), _TURN**4)
            across = found
        return False

    def _jacobian(self, angles: np.ndarray, across: np.ndarray) -> np.ndarray | None:
        """(k, k) derivative of `_across` by the angles, at which it is known; None without an evaluation."""
        columns = []
        for j in range(angles.size):
            turned = angles.copy()
            turned[j] += _TURN
            moved = self._across(turned)
            if moved is None:
                return None
            columns.append((moved - across) / _TURN)
        return np.array(columns).T

    def _scale(self) -> np.ndarray:
        """(k,) sizes in m/s^2 of the relative accelerations, and of what friction adds to them."""
        system = self.system
        sizes = np.linalg.norm(system.relative_acceleration[self.items, :2], axis=1)
        for k, i in enumerate(self.items):
            pull = whiten(system, system.force[i, :2] @ system.rows[i, :2])
            sizes[k] += float(np.linalg.norm(pull)) * float(np.linalg.norm(whiten(system, system.rows[i, :2].T)))
        return np.where(sizes > 0.0, sizes, 1.0)

    def _project(self, angles: np.ndarray) -> np.ndarray | None:
        """Angles after projections of friction on the rims of its disks, in scaled coordinates, as loads change."""
        system = self.system
        if self._across(angles) is None:
            return None
        rows = [self.scalings[k] @ system.rows[i, :2] for k, i in enumerate(self.items)]
        columns = whiten(system, np.vstack(rows).T)
        mobility = float(np.linalg.norm(columns, 2)) ** 2
        if not mobility > 0.0:
            return None
        for _ in range(_PROJECTIONS):
            directions = []
            for k, i in enumerate(self.items):
                shape, angle = self.scalings[k], float(angles[k])
                along = shape @ np.array([math.cos(angle), math.sin(angle)])
                friction = np.linalg.norm(np.linalg.solve(shape, system.force[i, :2]))
                along *= friction / np.linalg.norm(along)
                along += shape @ system.relative_acceleration[i, :2] / mobility
                directions.append(np.linalg.solve(shape, along))
            angles = np.array([math.atan2(y, x) for x, y in directions])
            if self._across(angles) is None:
                return None
        return angles
