"""What a run says of itself: the list of its events, why it stops, and chatter, which stops it."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from ..dynamics.joints import without_inertia
from ..dynamics.modes import ModeSolver
from ..dynamics.system import System
from ..layout import (
    CONDITION,
    FREE,
    LENGTH,
    LOCATION_FAILED,
    MASS_NOT_POSITIVE,
    NO_FORCE,
    SINGULAR,
    SLIPPING,
    STICK,
    UNILATERAL,
)
from .nearness import of_same_contours, places_of
from .open_contacts import OpenContacts
from .results import (
    ADVICE,
    CHATTER,
    FAILURES,
    MORE_STEPS,
    NO_CONTACT_FORCE,
    SINGULAR_CONTACT,
    STEP_LIMIT,
    STEP_TOO_SMALL,
    Event,
    Stop,
)
from .runge_kutta import RungeKutta

# Chatter: so many mode changes within this fraction of the run, or so many within this fraction of it (and at most
# this time in s) for every contact and limited joint coordinate. Rebounds end by themselves as a rule: of these so many
# are too many where times are the same but for this part, in which bodies move by no more than gaps are known to.
_CHATTER_EVENTS, _CHATTER_SPAN = 40, 1e-9
_DENSE_EVENTS, _DENSE_SPAN, _DENSE_TIME = 500, 1e-2, 1.0
_REBOUNDS, _INSTANT = 2000, 1e-12
# Contacts named in a message.
_NAMES = 3
# Below this conditioning of the location equations, a failure is that of a contact that degenerates.
_DEGENERATE = 1e-5
# Contacts of the same contours that are singular within this part of their length of each other have come together.
_TOGETHER = 1e-2
# And one below which steps may fail because of it: errors of contact coordinates are larger than those of gaps by its
# inverse.
_POOR = 1e-2


# Open contacts deeper than this part of their length are told; ideal rolling that is let go may dip by a thousandth.
_BEHIND = 1e-2


class Reports:
    """The events of a run, and the messages with which it stops.

    An *item* is a contact (0 to nc - 1), a limited joint coordinate (the next ng) or a contact's resistance to turning.
    span: duration of the run in s.
    """

    def __init__(self, rk: RungeKutta, modes: ModeSolver, names: list[str], span: float) -> None:
        self.rk, self.system, self.modes, self.names = rk, rk.system, modes, names
        self.events: list[Event] = []
        self._changes: list[tuple[float, int]] = []
        # so many mode changes are too many within so many s
        dense, long = _DENSE_EVENTS * self.system.items, min(_DENSE_SPAN * span, _DENSE_TIME)
        self._chatter = (_CHATTER_EVENTS, _CHATTER_SPAN * span), (dense, long)
        self._rebounds: list[tuple[float, int]] = []

    def listed(self, contacts: list[int]) -> str:
        """The names of contacts, as messages have them."""
        return ", ".join(repr(self.names[c]) for c in contacts)

    # ---------------------------------------------------------------- events

    def announce(self, t: float, item: int | None, kind: str, index: int = -1) -> Event:
        """Add an event of an item, or of the user's function number index, with the system's present state."""
        return self.announce_at(t, item, kind, self.system.q.copy(), self.system.v.copy(), index)

    def announce_at(
        self, t: float, item: int | None, kind: str, q: np.ndarray, v: np.ndarray, index: int = -1
    ) -> Event:
        """Add an event with the state (q, v)."""
        contact, joint = self._name(item) if item is not None else (None, None)
        event = Event(t, contact, kind, q, v, index, joint)
        self.events.append(event)
        return event

    def friction_event(self, item: int, slips: bool) -> str:
        """Kind of the event that a contact, or its resistance to turning, begins to slip or comes to rest."""
        if item >= self.system.nc:
            return "turn" if slips else "hold"
        return "slip" if slips else "stick"

    def announce_friction(self, t: float, item: int, slips: bool) -> None:
        """A contact, or what resists its turning, has begun to slip or come to rest."""
        self.announce(t, item, self.friction_event(item, slips))

    def withdraw(self, event: Event) -> None:
        """Take an event back."""
        self.events = [other for other in self.events if other is not event]

    def _name(self, item: int) -> tuple[str | None, str | None]:
        """Name of an item's contact, or else of its joint."""
        nc, ng = self.system.nc, self.system.ng
        if nc <= item < nc + ng:
            return None, self.system.limits[item - nc].joint
        return self.names[self.system.owner(item)], None

    def describe(self, item: int) -> str:
        contact, joint = self._name(item)
        return f"contact {contact!r}" if contact is not None else f"joint {joint!r}"

    # ---------------------------------------------------------------- ends of runs

    def check_chatter(self, t: float, item: int) -> None:
        """Count a mode change of an item; raises Stop where there are too many in too short a time."""
        self._count(self._changes, t, item, "mode changes", self._chatter)

    def check_rebounds(self, t: float, item: int) -> None:
        """Count a rebound of an item; raises Stop where there are too many at one time: a light body between heavy ones
        may be thrown to and fro ever faster."""
        limits = ((_REBOUNDS * self.system.items, _INSTANT * abs(t)),)
        self._count(self._rebounds, t, item, "rebounds", limits)

    def _count(
        self, happened: list[tuple[float, int]], t: float, item: int, what: str, limits: tuple[tuple[int, float], ...]
    ) -> None:
        """Add what has happened; limits: so many are too many within so many s."""
        happened.append((t, item))
        for count, span in limits:
            if len(happened) > count and t - happened[-count - 1][0] <= span:
                often = Counter(i for _, i in happened[-count:]).most_common(_NAMES)
                raise Stop(
                    CHATTER,
                    f"t = {t:.9g} s: {count} {what} within {t - happened[-count - 1][0]:.3g} s (chatter), most of "
                    f"{', '.join(self.describe(i) for i, _ in often)}",
                )
        most = 2 * max(limits)[0]
        if len(happened) > most:
            del happened[: most // 2]

    def failure(self, t: float, status: int) -> Stop:
        """The Stop for the status of an evaluation or a step; it names the contact, its pattern and the number."""
        if (status == LOCATION_FAILED or status not in FAILURES) and self._degenerates(t):
            status = SINGULAR
        if status not in FAILURES:
            return Stop(STEP_TOO_SMALL, f"t = {t:.9g} s: the step size fell below its floor{self._largest_slide()}")
        code, reason = FAILURES[status]
        if status == NO_FORCE and self.modes.proved:
            reason = "no contact forces satisfy Coulomb's law, but for unstable ones (Painleve)"
        elif status == NO_FORCE and self.system.counters.lost_positivity:
            reason = "friction between several contacts leaves more than one solution (Painleve)"
        if status == MASS_NOT_POSITIVE:
            reason = without_inertia(self.system.model, self.system.data, self.system.q)
        culprit = self._culprit(status)
        if code == SINGULAR_CONTACT:
            self.announce(t, culprit, "singular")
        where, number = "", ""
        if culprit is not None:
            where = f"contact {self.names[culprit]!r} ({self.system.contacts[culprit].pattern.name}): "
            if code == SINGULAR_CONTACT:
                number = f"; conditioning of J {abs(self.system.contact_real[culprit, CONDITION]):.3g}"
        return Stop(code, f"t = {t:.9g} s: {where}{reason}{number}")

    def _largest_slide(self) -> str:
        """What a message adds where something slides: friction may let forces grow without bound (Painleve)."""
        sliding = np.flatnonzero(self.system.modes == SLIPPING)
        if not sliding.size:
            return ""
        forces = np.linalg.norm(self.system.force[sliding], axis=1)
        name = self.names[sliding[forces.argmax()]]
        return f"; the largest force on what slides is {forces.max():.3g} N at contact {name!r}"

    def _degenerates(self, t: float) -> bool:
        """Whether a closed contact is as good as singular at the accepted state, which is evaluated."""
        system = self.system
        closed = system.closed()
        if not closed:
            return False
        self.rk.load(system.state)
        self.rk.evaluate(t)
        return bool(np.abs(system.contact_real[closed, CONDITION]).min() < _DEGENERATE)

    def _culprit(self, status: int) -> int | None:
        """The contact that a failure is put down to."""
        system = self.system
        if status == NO_FORCE:
            return next(iter(np.flatnonzero(system.modes == SLIPPING).tolist()), None)
        if status in (SINGULAR, LOCATION_FAILED) and system.nc:
            return int(np.argmin(np.abs(system.contact_real[: system.nc, CONDITION])))
        return None


def told(system: System, stop: Stop) -> str:
    """The message of a run that ends here: which contacts are concerned, where it does not say so, and what goes on."""
    merged = _run_together(system) if stop.code in (STEP_TOO_SMALL, SINGULAR_CONTACT) else ""
    if merged or stop.code not in (STEP_TOO_SMALL, STEP_LIMIT, NO_CONTACT_FORCE, CHATTER):
        return stop.message + merged
    named = any(repr(contact.name) in stop.message for contact in system.contacts)
    concerned = "" if named else _closed_contacts(system)
    if stop.code == STEP_TOO_SMALL:
        concerned += least_conditioned(system, _POOR)
    advice = MORE_STEPS if stop.code == STEP_LIMIT else ADVICE
    return stop.message + concerned + ("" if stop.blocked else f"; {advice}")


def _run_together(system: System) -> str:
    """What contacts of the same contours that have become singular together, in one place, say."""
    for c in np.flatnonzero(np.abs(system.contact_real[: system.nc, CONDITION]) < _POOR).tolist():
        for i in of_same_contours(system, c):
            places = places_of(system, [c, i], c)
            if len(places) == 2 and np.abs(places[0] - places[1]).max() < _TOGETHER * system.contact_real[c, LENGTH]:
                return (
                    f"; contacts {system.contacts[c].name!r} and {system.contacts[i].name!r} run together, and no "
                    "event-driven method goes through the instant at which they become one; "
                    'method="Moreau" does, with both'
                )
    return ""


def _closed_contacts(system: System) -> str:
    """What closed contacts do: those that slide, the slowest first, with their speeds, and those that stick."""
    modes, said = system.modes.tolist(), ""
    speeds = {c: float(np.linalg.norm(system.basis[c, :2] @ system.slip[c])) for c in system.closed()}
    sliding = sorted((c for c in speeds if modes[c] == SLIPPING), key=lambda c: speeds[c])
    if sliding:
        said += f"; {_listed([f'{system.contacts[c].name!r} at {speeds[c]:.2g} m/s' for c in sliding])} slide"
    sticking = [repr(system.contacts[c].name) for c in speeds if modes[c] == STICK]
    return said + (f"; {_listed(sticking)} stick" if sticking else "")


def _listed(names: list[str]) -> str:
    more = len(names) - _NAMES
    return ", ".join(names[:_NAMES]) + (f" and {more} more" if more > 0 else "")


def least_conditioned(system: System, below: float = math.inf) -> str:
    """What the message of a failed step adds: the closed contact that is nearest to singular, if it is nearer than
    this."""
    closed = system.closed()
    if not closed:
        return ""
    conditions = np.abs(system.contact_real[closed, CONDITION])
    least = int(conditions.argmin())
    if not conditions[least] < below:
        return ""
    name = system.contacts[closed[least]].name
    return f"; of the closed contacts {name!r} has the least conditioning, {conditions[least]:.3g}"


def left_behind(system: System, gaps: np.ndarray, ways: np.ndarray, opened: OpenContacts, t: float) -> str:
    """What a run says of bodies that end inside or behind each other, where open contacts do not touch.

    gaps, ways (nc,): in m, and to the nearest end of the contours' domains, at the end of the run, t in s.
    """
    deep = -_BEHIND * system.contact_real[: system.nc, LENGTH]
    # what is at an end of a face is on the next one
    open_there = (system.modes == FREE) & (system.contact_int[: system.nc, UNILATERAL] != 0) & (ways > -deep)
    behind = np.flatnonzero(open_there & (gaps < deep)).tolist()
    found = [c for c in behind if not _is_past(system, gaps, deep, c) and opened.is_behind(t, c)]
    named = ", ".join(f"{system.contacts[c].name!r} (gap {gaps[c]:.3g} m)" for c in found)
    return f"; bodies end inside or behind each other at {named}: they touch only after being apart" if found else ""


def _is_past(system: System, gaps: np.ndarray, deep: np.ndarray, c: int) -> bool:
    """Whether what is behind a face of a body is beyond that body: on or in front of another one of its faces, which is
    the nearer one and looks the other way; deep (nc,): gaps in m below which it is behind one."""
    contact, normals = system.contacts[c], system.basis[: system.nc, 2]
    return any(
        other.body1 is contact.body1
        and other.body2.carrier == contact.body2.carrier
        and deep[i] <= gaps[i] < -gaps[c]
        and normals[i] @ normals[c] < 0.0
        for i, other in enumerate(system.contacts)
    )
