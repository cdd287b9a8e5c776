"""Result codes of a run and the events in it."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

import numpy as np

from ..layout import LOCATION_FAILED, MASS_NOT_POSITIVE, NO_FORCE, NOT_FINITE, SINGULAR, TOO_LONG

# As `solve_ivp`: 0 finished, 1 ended by a terminal event, negative: the run could not go on.
FINISHED, TERMINATED = 0, 1
STEP_TOO_SMALL, STEP_LIMIT, SINGULAR_CONTACT, NO_CONTACT_FORCE, CONTROL_FAILED, CHATTER, MODEL_FAILED = range(
    -1, -8, -1
)
END_OF_CONTOUR, STEP_TOO_LONG = -8, -9

# What is told to those whose run cannot go on, and what to those whose steps are at their limit.
MORE_STEPS = 'a larger max_steps, or method="Moreau", which takes steps of constant size, gets further'
ADVICE = 'method="Moreau" goes on with impulses, in steps of constant size; fallback="Moreau" does from here on'

# Error of gaps, in tolerances of positions: a contact whose gap is smaller than that is closed.
GAP_TOLERANCE = 10.0
# What runs say of forces on which the motion depends, and of which more than one choice is right.
OPEN_LOADS = "rigid bodies leave open how redundant contacts share loads while some slide"
# And of rebounds lower than gaps are known that do not get lower beside a motion.
LASTING_REBOUNDS = (
    "bounce on without getting lower, by less than gaps are known, which is left out and may change the motion"
)

# And of slips that begin as soon as rows of contacts are independent, and are found when that shows.
SLIPS_LATE = (
    "begin to slip as constraints become independent, which shows late; errors are larger than tolerances allow"
)

# Statuses of single time steps, beside those of `layout`: a closed contact that cannot open is beyond the end of a
# contour, or one ends apart; constraints on velocities contradict each other; an open contact may go, or has gone,
# through what is near; the bodies of a closed one touch elsewhere, too; a motion has moved bodies that touch by a
# jump; a closed contact has not been followed; bodies touch all around, or where nothing was found before, or overlap
# where they come into a contour from its end.
CONTOUR_ENDS, CLOSED_APART, CONTRADICTION, FLIES_THROUGH, TOUCHES_TWICE, MOTION_JUMPS, LEAPT = range(50, 57)
TOUCHES_AROUND, TOUCHES_UNSEEN, OVERLAPS_AT_END, OFF_BALANCE = range(57, 61)

FAILURES = {
    LOCATION_FAILED: (SINGULAR_CONTACT, "the location parameters could not be continued (Newton left its branch)"),
    SINGULAR: (SINGULAR_CONTACT, "the location equations became singular: the point contact degenerates"),
    MASS_NOT_POSITIVE: (MODEL_FAILED, "the mass matrix is not positive definite"),
    NO_FORCE: (NO_CONTACT_FORCE, "no contact force satisfies Coulomb's law (Painleve), or none was found"),
    NOT_FINITE: (MODEL_FAILED, "the accelerations are not finite"),
    TOO_LONG: (STEP_TOO_LONG, "the step is too long for this motion: bodies or contacts turn too far in it"),
    CONTOUR_ENDS: (END_OF_CONTOUR, "reached the end of a contour"),
    CONTRADICTION: (NO_CONTACT_FORCE, "velocity constraints cannot be met together"),
    CLOSED_APART: (STEP_TOO_LONG, "the step is too long for this motion: a closed contact ends apart"),
    MOTION_JUMPS: (STEP_TOO_SMALL, "at once: a motion jumps by more than its velocities in the step explain"),
    FLIES_THROUGH: (STEP_TOO_LONG, "the step is too long for this motion: the open bodies could go through each other"),
    TOUCHES_AROUND: (
        SINGULAR_CONTACT,
        "the bodies touch along a line or a circle, as parallel ones or those on an axis of symmetry do, and not at a "
        "point",
    ),
    OFF_BALANCE: (
        STEP_TOO_LONG,
        "the step is too long for this motion: contact forces add to its energy, or take from it, by themselves",
    ),
    LEAPT: (STEP_TOO_LONG, "the step is too long for this motion: a contact leaps to another place"),
    TOUCHES_UNSEEN: (
        SINGULAR_CONTACT,
        "the bodies are inside each other at a place that was not found before they were: it is too narrow or steep",
    ),
    OVERLAPS_AT_END: (
        SINGULAR_CONTACT,
        "the bodies overlap where it comes into a contour from its end: that is an edge, for which a contact of its "
        "own is to be declared, with a Line or Point there, say; if there is one, its side= may have the other sign",
    ),
    TOUCHES_TWICE: (
        SINGULAR_CONTACT,
        "the pair touches at another point: declare another contact of these two contours, which starts open",
    ),
}


class Stop(Exception):
    """Ends a run from within: result code and message. Never leaves `Driver.run`. blocked: whether time stepping could
    not go on, either."""

    def __init__(self, code: int, message: str, blocked: bool = False):
        super().__init__(message)
        self.code, self.message, self.blocked = code, message, blocked


@dataclass(frozen=True, init=False)
class Event:
    """Something that happened at a time, with the state.

    Attributes
    ----------
    time : float
        In s.
    contact : str or None
        To which contact; None for events of joints and of the user.
    kind : str
        Of contacts: "stick", "slip", "separate", "touch", "edge" (the contact point has reached the end of a contour: a
        unilateral contact opens there), "singular"; where contacts resist spinning or rolling, "turn" and "hold"
        (turning begins, has come to rest). Of joints: "limit" (a position limit is reached), "release" (its force would
        pull), "stick" and "slip" (dry friction). "user": an event function of the user. "fallback": from here on time
        stepping.
    q : (nq,) array
        Configuration, in m and rad.
    v : (nv,) array
        Velocity, in m/s and rad/s.
    index : int
        Number of the user's event function, -1 for other events.
    joint : str or None
        To which joint.
    """

    time: float
    contact: str | None
    kind: str
    q: np.ndarray
    v: np.ndarray
    index: int = -1
    joint: str | None = None

    def __init__(
        self,
        time: float,
        contact: str | None,
        kind: str,
        q: np.ndarray,
        v: np.ndarray,
        index: int = -1,
        joint: str | None = None,
    ) -> None:
        # all at once: that of a frozen dataclass takes several times as long, and runs may have many events
        vars(self).update(time=time, contact=contact, kind=kind, q=q, v=v, index=index, joint=joint)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Event):
            return NotImplemented
        own, others = ((e.time, e.contact, e.kind, e.index, e.joint) for e in (self, other))
        return own == others and np.array_equal(self.q, other.q) and np.array_equal(self.v, other.v)

    def __repr__(self) -> str:
        name = self.contact if self.contact is not None else self.joint
        what = f"{name!r}: {self.kind}" if name is not None else self.kind
        number = f" event {self.index}" if self.kind == "user" else ""
        return f"<{what}{number} at {self.time:.9g} s>"

    def _repr_html_(self) -> str:
        return f"<code>{escape(repr(self)[1:-1])}</code>"
