"""States of a scene: configuration, velocity, time, and where every contact is."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin

from .arguments import is_number, reals, warn_of_order
from .contacts import Assembly, Contact, characteristic_length
from .contours.base import LINE
from .display import MODE_NAMES, html_table, numbers, shortened
from .dynamics.joints import JointLock, check_locks, joint_locks, joint_of, without_inertia
from .dynamics.manifold import (
    CIRCLE_BLOCK,
    FREE_FLYER,
    PLANAR_BLOCK,
    QUATERNION,
    VECTOR,
    configuration_blocks,
)
from .dynamics.system import System
from .errors import ArgumentError, ModelError, NoContactError, SingularContactError, StateError
from .geometry.nearest import Nearest, NearestSearch, is_searched
from .geometry.patterns import CROSSING_CURVES
from .geometry.search import Candidate, comes_back, find_candidates, on_side
from .geometry.sides import Beside, middle_of_domains, side_of_all, side_of_crossing
from .integration.accuracy import APART_AT_END
from .integration.contradictions import CLOSED_WITHIN, apart, contradiction, refuse_lost
from .integration.discrete import DISCRETE_COLUMNS, read_discrete
from .integration.nearness import of_same_contours
from .integration.run_system import RunSystem
from .layout import (
    BESIDE,
    BRANCH,
    CHART,
    DETERMINANT_SIGN,
    FREE,
    FRICTIONLESS,
    K1,
    LENGTH,
    MASS_NOT_POSITIVE,
    MODE,
    OK,
    PATTERN,
    SIDE,
    SINGULAR,
    SLIPPING,
    STICK,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# How far a quaternion's norm may be from 1 before it is taken for a mistake.
_NORM_TOLERANCE = 1e-6
_FLOAT = np.dtype(float)
# How far beside a symmetrical configuration it is looked for what is nearest, in lengths of the contact and rad.
_BESIDE = 1e-2
# Inertia that is left to a joint once all others are free, as part of what it moves, below which it is round-off.
_NO_INERTIA = 1e-10
# Of each kind of block of the configuration, where what has norm 1 begins and how long it is.
_UNITS = {VECTOR: (0, 0), FREE_FLYER: (3, 4), QUATERNION: (0, 4), CIRCLE_BLOCK: (0, 2), PLANAR_BLOCK: (2, 2)}


@dataclass(frozen=True)
class Correction:
    """How far the user's (q, v) was from the constraints, and how far it was moved.

    Attributes
    ----------
    gaps : dict of str to float
        Gap of each contact in m before the correction.
    slips : dict of str to (float, float)
        Normal and tangential component of each contact's v_c in m/s before the correction.
    dq : float
        Largest component of the change of configuration (tangent to it), in m and rad.
    dv : float
        Largest component of the change of velocity, in m/s and rad/s.
    """

    gaps: dict[str, float] = field(default_factory=dict)
    slips: dict[str, tuple[float, float]] = field(default_factory=dict)
    dq: float = 0.0
    dv: float = 0.0


@dataclass(frozen=True, eq=False)
class State:
    """A state of a scene that meets its constraints, from `Scene.initial_state`, `Trajectory.state` or `Stepper`.

    Parameters of contacts are in the paper's order of bodies (k2 >= k1); `location_of` has them in the user's.

    Attributes
    ----------
    scene : Scene
    q : (nq,) array
        Pinocchio's configuration, in m and rad.
    v : (nv,) array
        Pinocchio's velocity, in m/s and rad/s.
    t : float
        Time in s.
    location : (nc, 4) array
        Location parameters of each contact, two for u_1, two for u_2, in m or rad.
    discrete : (nc, 10) array of int
        Of each contact mode, charts of both bodies, side, branch, sign of det J, sign of slip, sign of the normal force
        (0 where it slides, closed, and carries nothing), frozen direction, whether it is open beside ends and has not
        been over them yet.
    correction : Correction, optional
        What `Scene.initial_state` changed.
    candidates : dict of str to list of Candidate, optional
        Every contact point that `Scene.initial_state` found, nearest first (Sec. 6.2: the location is multi-valued).
    """

    scene: Assembly
    q: np.ndarray
    v: np.ndarray
    t: float
    location: np.ndarray
    discrete: np.ndarray
    correction: Correction | None = None
    candidates: dict[str, list[Candidate]] | None = None

    def __repr__(self) -> str:
        modes = [f"{name} {mode}" for name, mode in self._modes()]
        return f"<State at t = {self.t:.9g} s: {shortened(modes)}\n q {numbers(self.q)}, v {numbers(self.v)}>"

    def _repr_html_(self) -> str:
        facts = [("t [s]", f"{self.t:.9g}"), ("q", numbers(self.q)), ("v", numbers(self.v)), *self._modes()]
        return html_table("State", ("of", "is"), facts)

    def _modes(self) -> list[tuple[str, str]]:
        """Contacts and their modes, as far as they are decided: a run decides those of Coulomb friction."""
        return [
            (name, "closed" if mode == FRICTIONLESS and contact.friction is not None else MODE_NAMES[mode])
            for (name, contact), mode in zip(self.scene.contacts.items(), self.discrete[:, 0].tolist())
        ]

    def location_of(self, contact: str) -> tuple[np.ndarray, np.ndarray]:
        """Location parameters of a contact, in the order in which the user named its contours.

        Parameters
        ----------
        contact : str
            Its name.

        Returns
        -------
        u_first, u_second : (k,) array
            In m or rad.

        Raises
        ------
        ArgumentError
            For an unknown contact.
        """
        names = list(self.scene.contacts)
        if contact not in names:
            raise ArgumentError(f"unknown contact {contact!r}; contacts: {', '.join(names) or 'none'}")
        entry = self.scene.contacts[contact]
        row = self.location[names.index(contact)]
        u1 = row[: entry.body1.contour.dimension].copy()
        u2 = row[2 : 2 + entry.body2.contour.dimension].copy()
        return (u2, u1) if entry.swapped else (u1, u2)


class Coordinates(NamedTuple):
    """What a model's q and v consist of: sizes, blocks of q, see `configuration_blocks`, and what is locked."""

    nq: int
    nv: int
    blocks: tuple[tuple[int, int, int, int], ...]
    locks: list[JointLock]


def coordinates_of(model: pin.Model) -> Coordinates:
    return Coordinates(model.nq, model.nv, configuration_blocks(model), joint_locks(model))


def check_state(scene: Assembly, state: Any, coordinates: Coordinates | None = None) -> None:
    """Raise ArgumentError for what is no state of this scene, StateError where its numbers cannot be used.

    A state's arrays may be written to, and it may be made by `dataclasses.replace`: nothing is known of them, and the
    kernels that are given them check nothing. coordinates: the model's, where they are known.
    """
    if not isinstance(scene, Assembly):
        raise ArgumentError(f"the first argument must be a Scene, got {type(scene).__name__}")
    if not isinstance(state, State):
        raise ArgumentError(f"a state must come from scene.initial_state(q, v), got {type(state).__name__}")
    contacts = scene.contacts.values()
    for name in ("q", "v", "location", "discrete"):
        if not isinstance(getattr(state, name), np.ndarray):
            raise StateError(f"the state's {name} must be an array, got {type(getattr(state, name)).__name__}")
    if state.scene is not scene or state.location.shape[:1] != (len(contacts),):
        raise ArgumentError("the state belongs to another scene, or contacts were added after it was made")
    if coordinates is None:
        coordinates = coordinates_of(scene.model)
    check_configuration(coordinates, state.q)
    check_vector("v", state.v, coordinates.nv)
    check_locks(coordinates.locks, state.q)
    for lock in coordinates.locks:
        if state.v[lock.index_v] != 0.0:
            raise StateError(
                f"joint {lock.joint!r} is locked, since its position limits coincide, but v[{lock.index_v}] = "
                f"{state.v[lock.index_v]:.9g}"
            )
    check_time("t", state.t)
    for name, columns in (("location", 4), ("discrete", DISCRETE_COLUMNS)):
        shape = getattr(state, name).shape
        if shape != (len(contacts), columns):
            raise StateError(f"the state's {name} must have shape {(len(contacts), columns)}, got {shape}")
    check_finite("location", state.location)
    for (mode, one, two), contact in zip(state.discrete[:, :3].tolist(), contacts):
        if not FREE <= mode <= SLIPPING:
            raise StateError(f"contact {contact.name!r} has no mode {mode}")
        # every contour has chart 0
        if one == two == 0:
            continue
        for chart, side in ((one, contact.body1), (two, contact.body2)):
            if chart not in side.contour.charts:
                raise StateError(f"contact {contact.name!r}: contour {side.name!r} has no chart {chart}")


def check_time(name: str, t: Any) -> float:
    """A finite time as a float, or a StateError."""
    if not is_number(t) or not math.isfinite(t):
        raise StateError(f"{name} must be finite, got {t!r}")
    return float(t)


def check_vector(name: str, value: ArrayLike, size: int) -> np.ndarray:
    """A finite float copy (size,), or a StateError that says what is wrong with it."""
    # a list takes a fraction of the time of array functions
    if isinstance(value, np.ndarray) and value.dtype is _FLOAT and value.shape == (size,):
        plain = np.array(value)
        if math.isfinite(sum(plain.tolist())):
            return plain
    array = reals(f"{name} must be {size} numbers", value, StateError).reshape(-1)
    if array.size != size:
        raise StateError(f"{name} must have {size} entries, got {array.size}")
    return check_finite(name, array)


def check_finite(name: str, array: np.ndarray) -> np.ndarray:
    """The array, or a StateError that names the first of its numbers that is not finite."""
    if not np.isfinite(array).all():
        index = tuple(np.argwhere(~np.isfinite(array))[0].tolist())
        raise StateError(f"{name}{list(index)} is {array[index]}")
    return array


def check_rows(name: str, value: ArrayLike, columns: int, shapes: dict[int, str]) -> np.ndarray:
    """Rows of numbers, not copied where they are floats already, or a StateError; shapes: "(n, {})" by dimension."""
    plain = isinstance(value, np.ndarray) and value.dtype is _FLOAT
    array = value if plain else reals(f"{name} must be numbers in rows of {columns}", value, StateError)
    assert isinstance(array, np.ndarray)
    if array.ndim not in shapes or array.shape[-1] != columns:
        wanted = " or ".join(shapes.values()).format(*[columns] * len(shapes))
        raise StateError(f"{name} must have shape {wanted}, got {array.shape}")
    return array


def check_configuration(coordinates: Coordinates, q: ArrayLike) -> np.ndarray:
    """A finite, normalised copy of q, or a StateError."""
    array = check_vector("q", q, coordinates.nq)
    for kind, iq, iv, n in coordinates.blocks:
        offset, size = _UNITS[kind]
        if size == 0:
            continue
        start = iq + offset
        norm = math.hypot(*array[start : start + size].tolist())
        if abs(norm - 1.0) > _NORM_TOLERANCE:
            what = "quaternion (x, y, z, w)" if size == 4 else "(cos, sin) pair"
            raise StateError(
                f"q[{start}:{start + size}] is a {what} of norm {norm:.9g}, not 1 (velocity index {iv}, {n})"
            )
        if norm != 1.0:
            array[start : start + size] /= norm
    return array


def state_of(
    scene: Assembly,
    system: System,
    t: float,
    correction: Correction | None = None,
    candidates: dict[str, list[Candidate]] | None = None,
) -> State:
    """The state that is in a system."""
    location = system.location[: system.nc].copy()
    return State(scene, system.q.copy(), system.v.copy(), t, location, read_discrete(system), correction, candidates)


def find_state(
    scene: Assembly, q: ArrayLike, v: ArrayLike | None, t: float, free: Sequence[str], max_gap: float | None
) -> State:
    """See `Scene.initial_state`."""
    model = scene.model
    coordinates = coordinates_of(model)
    q = check_configuration(coordinates, q)
    for kind, iq, iv, _ in coordinates.blocks:
        offset, size = _UNITS[kind]
        start = iq + offset
        # asking for the name of a joint takes longer than all other checks
        if size == 4 and q[start] == 1.0:
            what = f"q[{start}:{start + 4}] of joint {joint_of(model, iv)!r}"
            warn_of_order(what, q[start : start + 4], stacklevel=3)
    v = check_vector("v", np.zeros(model.nv) if v is None else v, model.nv)
    t = check_time("t", t)
    free = [free] if isinstance(free, str) else free
    if not isinstance(free, Iterable) or not all(isinstance(name, str) for name in free):
        raise ArgumentError(f"free must be names of contacts, got {free!r}")
    if max_gap is not None and not (is_number(max_gap) and max_gap >= 0.0):
        raise ArgumentError(f"max_gap must be a length in m, at least 0, got {max_gap!r}")
    for name in free:
        if name not in scene.contacts:
            raise ArgumentError(f"free: unknown contact {name!r}; contacts: {', '.join(scene.contacts) or 'none'}")
        if scene.contacts[name].bilateral:
            raise ArgumentError(f"free: contact {name!r} is bilateral and cannot open")
    contacts = list(scene.contacts.values())
    system = RunSystem(model, contacts)
    check_locks(system.locks, q)
    system.q[:], system.v[:] = q, v
    for lock in system.locks:
        system.q[lock.index_q] = lock.value
    found = {contact.name: _candidates(scene, contact, q, v, t, contact.name in free) for contact in contacts}
    candidates = {name: told.candidates for name, told in found.items()}
    places: dict[int, Candidate] = {}
    untouched: dict[str, NoContactError] = {}
    # closed ones first: open ones of the same contours are where these are not
    for c, contact in sorted(enumerate(contacts), key=lambda each: each[1].name in free):
        is_free = contact.name in free
        try:
            left = _left(system, c, candidates[contact.name], places, is_free)
            chosen = _choose(contact, left, is_free, max_gap, found[contact.name].side)
        except NoContactError as error:
            if is_free and found[contact.name].is_nowhere:
                # looked for as bodies move
                system.contact_int[c, [MODE, SIDE, BESIDE]] = (
                    FREE,
                    found[contact.name].side,
                    found[contact.name].is_beside,
                )
                system.location[c] = middle_of_domains(contact)
            else:
                untouched[contact.name] = error
            continue
        integers = system.contact_int[c]
        integers[SIDE] = found[contact.name].side or chosen.side or 1
        integers[BESIDE] = found[contact.name].is_beside
        integers[BRANCH], integers[DETERMINANT_SIGN] = chosen.branch, chosen.determinant_sign
        places[c] = chosen
        system.location[c] = chosen.location
        system.side_int[2 * c : 2 * c + 2, CHART] = chosen.charts
        ideal = contact.friction is not None and math.isinf(contact.friction.sliding)
        integers[MODE] = FREE if is_free else STICK if ideal else FRICTIONLESS
    if untouched:
        raise _together(untouched)
    correction = _correct(scene, system, q, v, t)
    return state_of(scene, system, t, correction, candidates)


def _left(
    system: System, c: int, found: list[Candidate], places: dict[int, Candidate], is_free: bool
) -> list[Candidate]:
    """Those of contact c's candidates at which no other contact of the same contours is, which are at these places; all
    for an open contact that has none left."""
    taken = [places[i] for i in of_same_contours(system, c) if i in places]
    if not taken or not found:
        return found
    length = system.contact_real[c, LENGTH]
    # on the side where the others are
    sides = (one for one in found if one.side in (0, taken[0].side))
    left = [one for one in sides if not any(one.is_at(other, length) for other in taken)]
    if not (left or is_free):
        contact = system.contacts[c]
        raise NoContactError(
            f"contact {contact.name!r}: other contacts of {contact.first.name!r} and {contact.second.name!r} are where "
            "these could touch; start it open (free=)",
            found[0].gap,
        )
    return left or found


class _Found(NamedTuple):
    """Where a contact may be, the side on which it is, 0 where that of a candidate counts, whether body 1 is beside the
    ends of body 2, and whether bodies are apart for certain, on a side that is known, though nothing was found."""

    candidates: list[Candidate]
    side: int
    is_beside: bool = False
    is_nowhere: bool = False


def _candidates(scene: Assembly, contact: Contact, q: np.ndarray, v: np.ndarray, t: float, is_free: bool) -> _Found:
    single = System(scene.model, [contact])
    single.q[:], single.v[:] = q, v
    single.evaluate_kinematics(t)
    guess = np.full(4, np.nan)
    if contact.location is not None:
        given = contact.location[::-1] if contact.swapped else contact.location
        for offset, part in ((0, given[0]), (2, given[1])):
            if part is not None:
                values = np.atleast_1d(np.asarray(part, dtype=float))
                guess[offset : offset + values.size] = values
    guess[contact.body1.contour.dimension : 2] = 0.0
    guess[2 + contact.body2.contour.dimension :] = 0.0
    side, is_over, end = contact.side or 0, True, None
    crosses = contact.side is None and single.contact_int[0, PATTERN] == CROSSING_CURVES
    if not is_free:
        return _Found(find_candidates(single, t, guess), side)
    beside = Beside(single, 0) if Beside.is_seen(single, 0) else None
    if beside is not None:
        is_over = beside.look(t)
        end = None if is_over else beside.nearest
    try:
        found = find_candidates(single, t, guess, beyond=True, end=end)
    except SingularContactError:
        if crosses and contact.body1.contour.kind == contact.body2.contour.kind == LINE:
            # parallel: nowhere, until they have turned
            return _Found([], 1, True, True)
        if not (is_searched(single, 0) and _are_apart(single, t)):
            raise
        found = _beside(single, t, guess)
    if crosses and found:
        single.location[0], single.contact_int[0, MODE] = found[0].location, FREE
        single.contact_int[0, [BRANCH, DETERMINANT_SIGN]] = found[0].branch, found[0].determinant_sign
        single.side_int[:2, CHART] = found[0].charts
        single.evaluate_kinematics(t)
        return _Found(found, side_of_crossing(single, 0) or 1, True)
    is_beyond = bool(found) and not comes_back(single, found[0])
    if beside is not None and (is_beyond or not (is_over and found)):
        side = side or beside.side
    if is_over and found and found[0].gap < 0.0 and is_searched(single, 0):
        # stationary points that are not those where bodies are nearest
        nearest = _look(single, t).candidates
        found = nearest if nearest and 0.0 <= nearest[0].gap < -found[0].gap else found
    if is_over and found and found[0].gap < 0.0 and is_searched(single, 0) and _are_apart(single, t):
        # what contours go on as may go through bodies or, as points may be, behind a contour
        as_found = is_beyond or single.contact_int[0, K1] == 0
        found = [one for one in found if one.gap >= 0.0] or (found if as_found else _beside(single, t, guess))
    is_nowhere = not found and is_searched(single, 0) and _are_apart(single, t)
    if is_nowhere:
        side = side or side_of_all(single, t)
    return _Found(found, side, not is_over, is_nowhere and side != 0)


def _beside(single: System, t: float, guess: np.ndarray) -> list[Candidate]:
    """Candidates of an open contact whose bodies are apart, and nearest along a line or a circle: those of a
    configuration a little beside. Where it is evaluated it is nowhere, and looked for as soon as bodies have moved."""
    contact = single.contacts[0]
    # in no direction that a symmetry has
    step = np.random.default_rng(0).uniform(-1.0, 1.0, single.nv) * _BESIDE * single.contact_real[0, LENGTH]
    single.q[:] = pin.integrate(single.model, single.q, step)
    single.evaluate_kinematics(t)
    try:
        every = find_candidates(single, t, guess, beyond=True)
    except SingularContactError:
        every = []
    found = [one for one in every if one.gap > 0.0]
    if every and not found and side_of_all(single, t) == -(contact.side or 1):
        raise SingularContactError(
            f"contact {contact.name!r}: {contact.first.name!r} and {contact.second.name!r} are apart, and on the other "
            f"side of each other than it has them: give add_contact side={-(contact.side or 1):+d}",
            0.0,
        )
    return found


def _are_apart(single: System, t: float) -> bool:
    """Whether the bodies of a system with one contact are apart at its (q, v), for certain."""
    return _look(single, t).distance > 0.0


def _look(single: System, t: float) -> Nearest:
    """Where the bodies of a system with one contact are nearest at its (q, v); nowhere that is known, if neither is
    bounded."""
    bodies = single.contacts[0].body1, single.contacts[0].body2
    if not any(np.isfinite(body.contour.domain).all() for body in bodies):
        return Nearest([], 0.0, 0.0, False)
    single.evaluate_kinematics(t)
    return NearestSearch(single, 0, t).search(t)


def _together(untouched: dict[str, NoContactError]) -> NoContactError:
    """One error for all contacts that do not touch: what the first one says, and the gaps of the others."""
    first = next(iter(untouched.values()))
    if len(untouched) == 1:
        return first
    gaps = {name: f"{e.gap:.6g} m" if math.isfinite(e.gap) else "no point found" for name, e in untouched.items()}
    also = ", ".join(f"{name!r} ({gap})" for name, gap in list(gaps.items())[1:])
    return NoContactError(f"{str(first).removesuffix('.')}; nor do the contours touch of contacts {also}", first.gap)


def _refuse_gaps(system: RunSystem, t: float) -> None:
    """Of more closed contacts than a body can have at once the projection leaves gaps, which would be kept."""
    system.evaluate_kinematics(t)
    left = apart(system, system.closed(), APART_AT_END)
    if left:
        largest = max(left.values())
        raise NoContactError(
            f"contacts {shortened(left)} cannot all be closed at once: near this configuration gaps of up to "
            f"{largest:.2g} m are left; start those open (free=) that do not touch",
            largest,
        )


def _choose(contact: Contact, found: list[Candidate], is_free: bool, max_gap: float | None, side: int) -> Candidate:
    """The candidate nearest to touching, on the side asked for, 0 for any, where the shapes tell sides apart."""
    pair = f"{contact.first.name!r} and {contact.second.name!r}"
    if not found:
        raise NoContactError(
            f"contact {contact.name!r}: no point at which {pair} could touch was found in this configuration; move q, "
            "give add_contact a guess location=(u_first, u_second), or look at the contours' domains"
            + (", or, as it is open and which sides face each other is not seen here, give side=" if is_free else "")
        )
    chosen = on_side(found, side)[0]
    limit = max_gap if max_gap is not None else CLOSED_WITHIN * characteristic_length(contact)
    if not is_free and abs(chosen.gap) > limit:
        raise NoContactError(
            f"contact {contact.name!r}: {pair} do not touch: the gap is {chosen.gap:.6g} m, more than the "
            f"{limit:.3g} m that is corrected (max_gap); {_cure(contact, found, chosen, limit)}",
            chosen.gap,
        )
    if not (is_free or contact.bilateral) and side * chosen.side < 0:
        raise NoContactError(
            f"contact {contact.name!r}: {pair} touch from the other side: with side={side:+d} one would be inside the "
            f"other around that point; add_contact takes side={chosen.side:+d}",
            chosen.gap,
        )
    return chosen


def _cure(contact: Contact, found: list[Candidate], chosen: Candidate, limit: float) -> str:
    """What to do about a gap that is too large."""
    side = contact.side or chosen.side or 1
    if contact.side and any(abs(c.gap) <= limit and c.side == -side for c in found):
        return f"they touch on the other side: add_contact has side={side:+d}, try side={-side:+d}"
    if chosen.gap < 0.0:
        return (
            "the bodies overlap, or are on the wrong side of each other: move q, or give add_contact "
            f"side={-side:+d} (here it is {side:+d}{'' if contact.side else ', inferred'})"
        )
    return f"move q, or to start open pass free=[{contact.name!r}]"


def _without_locked(system: RunSystem, v: np.ndarray) -> np.ndarray:
    """The velocity nearest to v, in the mass metric of the last evaluation, without motion of what is locked."""
    if not v[system.locked].any():
        return v
    lower = np.tril(system.mass)
    reach = np.linalg.inv(lower + np.tril(lower, -1).T)[:, system.locked]
    out = v - reach @ np.linalg.solve(reach[system.locked], v[system.locked])
    out[system.locked] = 0.0
    return np.asarray(out)


def _correct(scene: Assembly, system: RunSystem, q: np.ndarray, v: np.ndarray, t: float) -> Correction:
    """Project (q, v) of the system onto the constraints; reports the change."""
    names = [c.name for c in system.contacts]
    status = system.evaluate(t)
    pivots = system.factor.diagonal() ** 2
    if status == MASS_NOT_POSITIVE or (pivots <= _NO_INERTIA * system.data.M.diagonal()).any():
        raise ModelError(without_inertia(scene.model, system.data, system.q))
    if status == SINGULAR:
        raise SingularContactError("the location equations are singular in this configuration", 0.0)
    gaps, slips = {}, {}
    for c, name in enumerate(names):
        gaps[name] = float(np.hypot(*system.gaps[c]) if system.gaps[c, 1] else system.gaps[c, 0])
        first, second, normal = (system.basis[c] @ system.slip[c]).tolist()
        slips[name] = normal, math.hypot(first, second)
    given = _without_locked(system, v)
    system.v[:] = given
    system.put_state(system.stage_state, system.q, system.v, system.location[: system.nc])
    if system.project(t) != OK:
        contradicting = contradiction(system, t)
        if contradicting:
            raise StateError(contradicting)
        raise NoContactError(
            f"the constraints cannot be satisfied near this configuration: gaps {gaps}, after correction "
            f"{system.gaps[: system.nc, 0].tolist()} m",
            max((abs(g) for g in gaps.values()), default=math.nan),
        )
    refuse_lost(system, t, given)
    _refuse_gaps(system, t)
    dq = pin.difference(scene.model, q, system.q)
    return Correction(gaps, slips, float(np.abs(dq).max(initial=0.0)), float(np.abs(system.v - v).max(initial=0.0)))
