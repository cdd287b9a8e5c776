"""Events of limited joint coordinates: they reach an end of their way, leave it, stick and slip by dry friction."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..dynamics.joints import END_SLACK
from ..dynamics.modes import ModeSolver
from ..layout import DOMAIN_EVENT, FREE, GAP_EVENT, JOINT_END, JOINT_SIGN, MODE, NORMAL_EVENT, SPEED_EVENT
from .accuracy import count_rebound, gap_resolution, gaps_at_once, rest_speed
from .reports import Reports
from .run_system import RunSystem


class JointEvents:
    """What the limited coordinates of a system do, and what has been announced of it.

    A coordinate g is held at an end of its way (-1 the lower, +1 the upper one) or by dry friction (0), or moves.
    depths: (items,) how far in m or rad moving coordinates may be beyond their ends; the event locator reads it.
    """

    def __init__(self, system: RunSystem, modes: ModeSolver, reports: Reports, depths: np.ndarray) -> None:
        self.system, self.modes, self.reports, self._depths = system, modes, reports, depths
        # at which end a coordinate has been, if it was no further from it since than positions are known
        self._at_end: dict[int, int] = {}
        # of every coordinate: see `_state`
        self._announced: list[tuple[bool, int]] = []

    def begin(self) -> None:
        """The present state is that of a run's start, of which nothing is announced."""
        self._announced = [self._state(g) for g in range(self.system.ng)]
        self._at_end = self.held_at_ends()

    def is_free(self, g: int) -> bool:
        """Whether coordinate g is not held."""
        return bool(self.system.contact_int[self.system.nc + g, MODE] == FREE)

    def accuracy(self, g: int) -> float:
        """Error in m or rad of the distance of coordinate g from its ends."""
        return float(self.system.gap_accuracy[self.system.nc + g])

    def resolution(self, g: int) -> float:
        """Way in m or rad below which a motion of coordinate g is none."""
        return float(gap_resolution(self.system)[self.system.nc + g])

    def set_from_velocities(self, stay: dict[int, int] | None = None) -> None:
        """Hold the coordinates that rest at an end or by dry friction, free the others; stay: ends at which some are
        held whatever their velocities (coordinate -> end)."""
        system, stay = self.system, stay or {}
        slowest = rest_speed(system)
        for g, limit in enumerate(system.limits):
            position, speed = float(system.q[limit.index_q]), float(system.v[limit.index_v])
            end = -1 if position <= limit.low_end + END_SLACK else int(position >= limit.high_end - END_SLACK)
            if g in stay:
                self.modes.hold(g, stay[g])
            elif abs(speed) > slowest:
                self.modes.release(g, 1 if speed > 0.0 else -1)
            elif end != 0 or limit.dry:
                self.modes.hold(g, end)
            else:
                self.modes.release(g, 0)

    def held_at_ends(self) -> dict[int, int]:
        """The coordinates that are held at an end of their way, and at which."""
        ends = {g: int(self.system.joint_int[g, JOINT_END]) for g in self.system.held()}
        return {g: end for g, end in ends.items() if end != 0}

    def stop_those_at_ends(self, t: float) -> bool:
        """Hold the free coordinates that are at an end of their way and move beyond it; whether there are any."""
        system, found = self.system, False
        for g, limit in enumerate(system.limits):
            position, speed = float(system.q[limit.index_q]), float(system.v[limit.index_v])
            low, high = position <= limit.low_end + END_SLACK, position >= limit.high_end - END_SLACK
            if self.is_free(g) and ((low and speed < 0.0) or (high and speed > 0.0)):
                self.stop(t, g, -1 if low else 1)
                found = True
        return found

    def stop(self, t: float, g: int, end: int) -> None:
        """Coordinate g has come to an end of its way, and is held there."""
        self.reports.announce(t, self.system.nc + g, "limit")
        speed = abs(float(self.system.v[self.system.limits[g].index_v]))
        count_rebound(self.system, self.system.nc + g, speed, self._at_end.get(g) == end)
        self._announced[g] = True, end
        self._hold(g, end)

    def hold_near(self) -> None:
        """Hold the free coordinates that come to an end now as far as instants are told apart.

        What has left that end by less is held only where it is back: its bounce has been followed to round-off.
        """
        at_once = gaps_at_once(self.system)[self.system.nc :].tolist()
        for g in filter(self.is_free, range(self.system.ng)):
            for end in (-1, 1):
                near = self.resolution(g) if self._at_end.get(g) == end else at_once[g]
                if self._way(g, end) <= near:
                    self._hold(g, end)
                    break

    def _hold(self, g: int, end: int) -> None:
        self.modes.hold(g, end)
        self._at_end[g] = end

    def _way(self, g: int, end: int) -> float:
        """Distance in m or rad of coordinate g from an end; negative beyond it."""
        limit = self.system.limits[g]
        position = float(self.system.q[limit.index_q])
        return limit.high_end - position if end > 0 else position - limit.low_end

    def watch(self, stepped: bool) -> None:
        """Look which coordinates have left their ends at the accepted state, and which are beyond.

        What moves back from beyond an end, where the corrections of others have put it, is let do so: it would be
        stopped again and again. stepped: whether the last trial step led there in the present modes.
        """
        system = self.system
        self._at_end |= self.held_at_ends()
        for g in filter(self.is_free, [*self._at_end]):
            end = self._at_end[g]
            ways = [self._way(g, end)]
            if stepped:
                ways.append(float(system.highest[system.nc + g, DOMAIN_EVENT if end > 0 else GAP_EVENT]))
            if max(ways) > self.accuracy(g):
                del self._at_end[g]
        self._depths[system.nc : system.nc + system.ng] = [self._depth(g) for g in range(system.ng)]

    def _depth(self, g: int) -> float:
        """How far coordinate g may be beyond its ends in the next step."""
        if not self.is_free(g):
            return 0.0
        end = min((-1, 1), key=lambda end: self._way(g, end))
        way, speed = self._way(g, end), float(self.system.v[self.system.limits[g].index_v])
        if way < 0.0 and end * speed < 0.0:
            return -way
        return float(self._depths[self.system.nc + g]) if way <= self.accuracy(g) else 0.0

    def switch(self, t: float, g: int, kind: int) -> bool:
        """Event function `kind` of coordinate g has reached zero at t; whether g strikes an end of its way."""
        system = self.system
        if kind in (GAP_EVENT, DOMAIN_EVENT):
            self.stop(t, g, -1 if kind == GAP_EVENT else 1)
            return True
        if kind == SPEED_EVENT:
            speed = float(system.v[system.limits[g].index_v])
            if abs(speed) > rest_speed(system):
                # a short step of another's slip has carried it through zero: it slides the other way now
                self.modes.release(g, 1 if speed > 0.0 else -1)
            else:
                self.modes.hold(g, 0)
        else:
            self.modes.release(g, 1 if kind == NORMAL_EVENT else -1)
        return False

    def announce_changes(self, t: float) -> None:
        """Events of the coordinates whose state is not what was last announced."""
        for g, before in enumerate(self._announced):
            now = self._state(g)
            if now == before:
                continue
            self._announced[g] = now
            if now[0]:
                kind = "limit" if now[1] else "stick"
            elif before[0] and before[1]:
                kind = "release"
            elif before[0] or before[1] * now[1] < 0:
                kind = "slip"
            else:
                continue
            self.reports.announce(t, self.system.nc + g, kind)

    def _state(self, g: int) -> tuple[bool, int]:
        """Whether coordinate g is held, and at which end (0: by friction), or in which direction it slips."""
        held = not self.is_free(g)
        return held, int(self.system.joint_int[g, JOINT_END if held else JOINT_SIGN])

    # ---------------------------------------------------------------- motions too short to be told from rest

    def stops_soon(self, g: int, resolution: Callable[[int, float], float]) -> bool:
        """Whether dry friction ends the motion of coordinate g in a way that is none: shorter than resolution(item,
        speed). Needs the evaluation."""
        limit, sign = self.system.limits[g], int(self.system.joint_int[g, JOINT_SIGN])
        speed, rate = abs(float(self.system.v[limit.index_v])), sign * float(self.system.acceleration[limit.index_v])
        if not limit.dry or sign == 0 or rate >= 0.0:
            return False
        return speed * speed <= -2.0 * rate * resolution(self.system.nc + g, speed)

    def returns_soon(self, g: int, end: int, resolution: Callable[[int, float], float]) -> bool:
        """Whether coordinate g comes back to the end that it leaves from no further than that. Needs the evaluation."""
        index = self.system.limits[g].index_v
        speed, back = abs(float(self.system.v[index])), end * float(self.system.acceleration[index])
        return back > 0.0 and speed * speed <= 2.0 * back * resolution(self.system.nc + g, speed)
