"""Contacts over time: evaluated again at every output of a run, with the residuals of their constraints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from .arguments import output_number
from .contacts import AttachedContour, Contact, characteristic_length
from .display import MODE_NAMES, html_table, known_range
from .dynamics.joints import joint_limits
from .errors import ArgumentError, TrajectoryError
from .geometry.frames import contact_frame, dual_basis
from .integration.open_contacts import OpenContacts
from .integration.run_system import RunSystem
from .layout import (
    CHART,
    CONDITION,
    EVENT,
    FREE,
    NOTHING_THERE,
    OK,
    STICK,
)
from .records import Recorded, load_output
from .scene import Scene

if TYPE_CHECKING:
    from .trajectory import Trajectory

# Outputs whose contacts are evaluated before they are put together: some MB.
_CHUNK = 1024
# Arrays of evaluated outputs that have a row for each side of a contact.
_OF_SIDES = ("shapes", "frames", "charts")


@dataclass(frozen=True, eq=False)
class ContactTrack:
    """One contact over time, a row per output; world axes, SI units. `force_on` knows which body a force acts on.

    While the contact is open, location, point and frame are those of the nearest points, and NaN, with the gap, where
    there are none that are stationary. k is the number of location parameters, in m or rad.

    Attributes
    ----------
    location : (n, k) array
        Location parameters p* = (u_1, u_2) in the paper's order of bodies (k2 >= k1).
    location_first, location_second : (n, k1 or k2) array
        The same by the user's contours.
    rates : (n, k) array
        p*' in m/s or rad/s (Eq. 6), in the order of `location`.
    charts : (n, 2) array of int
        Of body 1 and body 2.
    point : (n, 3) array
        Contact point.
    frame : (n, 3, 3) array
        e_1, e_2, e_3 of Definition 5 as columns.
    dual_frame : (n, 3, 3) array
        m^1, m^2, m^3 as columns (Eq. 26).
    force : (n, 3) array
        On the second contour named by the user; NaN, with all that follows from it, where a closed contact's is not
        known, as where a control was not finite.
    multipliers : (n, 3) array
        Components of that force in the dual frame, F_j = e_j . F (Prop. 6).
    normal_force : (n,) array
        Positive in compression; for a point on a spatial curve the length of the part across the curve.
    tangential_force : (n,) array
        A length.
    torque : (n, 3) array
        What resists spinning and rolling, on the second contour, in N m; by time stepping its mean over the last step.
    slip_velocity : (n, 3) array
        v_c, of the second contour's material point against the first's.
    mode : (n,) array of int
        -1 open, 0 frictionless, 1 stick, 2 slip.
    gap : (n,) array
        Positive when apart.
    conditioning : (n,) array
        Of the location equations, 1 good, 0 singular.
    contours : (2,) tuple of str
        Names of the first and the second contour.
    """

    location: np.ndarray
    location_first: np.ndarray
    location_second: np.ndarray
    rates: np.ndarray
    charts: np.ndarray
    point: np.ndarray
    frame: np.ndarray
    dual_frame: np.ndarray
    force: np.ndarray
    multipliers: np.ndarray
    normal_force: np.ndarray
    tangential_force: np.ndarray
    torque: np.ndarray
    slip_velocity: np.ndarray
    mode: np.ndarray
    gap: np.ndarray
    conditioning: np.ndarray
    contours: tuple[str, str] = ("", "")

    def force_on(self, contour: str | AttachedContour) -> np.ndarray:
        """The contact force on one of the two contours.

        Parameters
        ----------
        contour : str or AttachedContour
            The contour, or its name.

        Returns
        -------
        (n, 3) array
            World axes, N. On the second contour it is `force`, on the first the opposite.

        Raises
        ------
        ArgumentError
            For a contour that is neither of the two.
        TrajectoryError
            For a run from a file that does not have the contours' names.
        """
        name = contour.name if isinstance(contour, AttachedContour) else contour
        if not all(self.contours):
            raise TrajectoryError("the run was read from a file of an earlier version, without the contours' names")
        if not isinstance(name, str) or name not in self.contours:
            first, second = self.contours
            raise ArgumentError(f"the contact is one of {first!r} and {second!r}, got {name!r}")
        return self.force.copy() if name == self.contours[1] else -self.force

    def arrays(self) -> dict[str, np.ndarray]:
        """All that is an array.

        Returns
        -------
        dict of str to ndarray
            By the name of the attribute.
        """
        return {name: values for name, values in vars(self).items() if name != "contours"}

    def at(self, index: int) -> ContactTrack:
        """One output: the same arrays without their first axis.

        Parameters
        ----------
        index : int
            Of the output.

        Returns
        -------
        ContactTrack

        Raises
        ------
        ArgumentError
            For what is no number of an output.
        """
        index = output_number(index, len(self.mode))
        return ContactTrack(**{name: values[index] for name, values in self.arrays().items()}, contours=self.contours)

    def __repr__(self) -> str:
        return f"<ContactTrack of {' and '.join(map(repr, self.contours))}: {'; '.join(self._summary().values())}>"

    def _repr_html_(self) -> str:
        return html_table(
            "ContactTrack", ("of", "is"), [("contours", ", ".join(self.contours)), *self._summary().items()]
        )

    def _summary(self) -> dict[str, str]:
        """Labels and values of a short summary."""
        mode, n = np.atleast_1d(self.mode), np.size(self.mode)
        if n == 0:
            return {"outputs": "no outputs"}
        kinds, counts = np.unique(mode, return_counts=True)
        shares = [f"{MODE_NAMES[int(kind)]} {100.0 * count / n:.0f} %" for kind, count in zip(kinds, counts)]
        force, slip = np.atleast_1d(self.normal_force), np.linalg.norm(np.atleast_2d(self.slip_velocity), axis=1)
        closed = mode != FREE
        return {
            "outputs": f"{n} output{'s' * (n > 1)}",
            "modes": ", ".join(shares),
            "normal force": known_range(force, ".4g", " N"),
            "slip": f"slip up to {np.fmax.reduce(slip[closed], initial=0.0):.4g} m/s",
        }


def is_bare(run: Trajectory) -> bool:
    """Whether the run was read from a file without its scene."""
    return bool(np.shape(run.q)[1] != run.scene.model.nq)


def model_of(run: Trajectory) -> pin.Model:
    """The model of a run's scene; TrajectoryError for one without its scene."""
    if is_bare(run):
        raise TrajectoryError(
            f"the run has configurations of {np.shape(run.q)[1]} numbers and its scene's model needs "
            f"{run.scene.model.nq}; a run read from a file has to be given its scene: Trajectory.load(path, scene)"
        )
    return run.scene.model


def evaluate_tracks(
    scene: Scene, t: np.ndarray, q: np.ndarray, v: np.ndarray, recorded: Recorded
) -> tuple[dict[str, ContactTrack], dict[str, dict[str, np.ndarray]]]:
    """Evaluate the contacts again at every output: the run itself keeps only what it cannot do without."""
    contacts = list(scene.contacts.values())
    system = RunSystem(scene.model, contacts)
    n, resistances = t.size, recorded.resistances
    tracks = {contact.name: _empty_track(contact, recorded.discrete[:, c, 0]) for c, contact in enumerate(contacts)}
    residuals = {c.name: {kind: np.zeros(n) for kind in ("C1", "C2", "GC", "VC")} for c in contacts}
    for start in range(0, n if contacts else 0, _CHUNK):
        rows, outputs = _evaluate_outputs(system, t, q, v, recorded, range(start, min(start + _CHUNK, n)))
        for c, contact in enumerate(contacts):
            # what belongs to this contact, and to the sides of both bodies
            at: dict[bool, Any] = {True: slice(2 * c, 2 * c + 2), False: c}
            own = {name: array[:, at[name in _OF_SIDES]] for name, array in outputs.items()}
            _fill_track(rows, own, contact, tracks[contact.name])
            if resistances is not None:
                tracks[contact.name].torque[rows] = resistances[rows, c]
            _fill_residuals(rows, own, contact, tracks[contact.name].mode, residuals[contact.name])
    return tracks, residuals


def _evaluate_outputs(
    system: RunSystem, t: np.ndarray, q: np.ndarray, v: np.ndarray, recorded: Recorded, wanted: range
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Which of the wanted outputs can be evaluated, (m,), and what that leaves of the contacts in the arrays of
    `System`, a row for each.

    shapes (m, 2 nc, 3, 3): points and first derivatives, in world axes; frames (m, 2 nc, 5, 3): rotation, place and
    velocity of what carries them; the rest (m, nc, ...), of sides (m, 2 nc).
    """
    nc = system.nc
    views = {
        "location": system.location[:nc],
        "rates": system.rates[:nc],
        "shapes": system.derivatives[: 2 * nc, :3],
        "frames": system.frames[: 2 * nc, :5],
        "basis": system.basis[:nc],
        "slip": system.slip[:nc],
        "gaps": system.gaps[:nc],
        "force": system.force[:nc],
        "conditioning": system.contact_real[:nc, CONDITION],
        "charts": system.side_int[: 2 * nc, CHART],
    }
    values = {name: np.empty((len(wanted), *view.shape), view.dtype) for name, view in views.items()}
    rows: list[int] = []
    opened = OpenContacts(system)
    holds = bool(joint_limits(system.model))
    for i in wanted:
        load_output(system, recorded, i, q[i], v[i])
        known = system.evaluate(time := float(t[i])) <= EVENT
        if known and FREE in system.modes and opened.follow(time):
            known = system.evaluate(time) <= EVENT
        if not known and holds and i not in recorded.forces:
            # joints that are held are free here, their forces given, so that slip may have lost positivity which it has
            # in the run; forces that satisfy the law are the run's
            system.counters.decided = 1
            known = system.evaluate(time) == OK
            system.counters.decided = 0
        # with unknown forces, as of torques that are not finite, the contact points may be known
        if known or system.evaluate_kinematics(time) == OK:
            for name, view in views.items():
                values[name][len(rows)] = view if known or name != "force" else np.nan
            if i in recorded.forces:
                values["force"][len(rows)] = recorded.forces[i]
            rows.append(i)
    return np.array(rows, dtype=np.int64), {name: array[: len(rows)] for name, array in values.items()}


def _empty_track(contact: Contact, modes: np.ndarray) -> ContactTrack:
    """A track of which nothing is known but the modes (n,)."""
    n = modes.size
    k1, k2 = contact.body1.contour.dimension, contact.body2.contour.dimension
    first, second = (k2, k1) if contact.swapped else (k1, k2)
    parameters = {"location": k1 + k2, "location_first": first, "location_second": second, "rates": k1 + k2}
    unknown: dict[str, tuple[int, ...]] = {name: (count,) for name, count in parameters.items()}
    unknown |= {"point": (3,), "frame": (3, 3), "dual_frame": (3, 3), "slip_velocity": (3,)}
    unknown |= {"gap": (), "conditioning": ()}
    none: dict[str, tuple[int, ...]] = {"force": (3,), "multipliers": (3,), "torque": (3,)}
    none |= {"normal_force": (), "tangential_force": ()}
    track = ContactTrack(
        **{name: np.full((n, *shape), np.nan) for name, shape in unknown.items()},
        **{name: np.zeros((n, *shape)) for name, shape in none.items()},
        charts=np.zeros((n, 2), dtype=np.int64),
        mode=modes.copy(),
        contours=(contact.first.name, contact.second.name),
    )
    for name in ("force", "multipliers", "normal_force", "tangential_force"):
        getattr(track, name)[modes != FREE] = np.nan
    return track


def _fill_track(rows: np.ndarray, outputs: dict[str, np.ndarray], contact: Contact, track: ContactTrack) -> None:
    """Rows of a track from what outputs leave of its contact."""
    there = outputs["gaps"][:, 0] != NOTHING_THERE
    rows, outputs = rows[there], {name: array[there] for name, array in outputs.items()}
    k1, k2 = contact.body1.contour.dimension, contact.body2.contour.dimension
    sign = -1.0 if contact.swapped else 1.0
    kept = np.r_[0:k1, 2 : 2 + k2]
    modes = track.mode[rows]
    track.location[rows] = location = outputs["location"][:, kept]
    u1, u2 = location[:, :k1], location[:, k1:]
    track.location_first[rows], track.location_second[rows] = (u2, u1) if contact.swapped else (u1, u2)
    gaps, basis = outputs["gaps"], outputs["basis"]
    track.rates[rows] = outputs["rates"][:, kept]
    track.charts[rows] = outputs["charts"]
    first, second = outputs["shapes"][:, 0], outputs["shapes"][:, 1]
    carrier = outputs["frames"][:, 1]
    track.point[rows] = carrier[:, 3] + second[:, 0]
    track.frame[rows] = frame = contact_frame(contact.pattern.code, first, second, carrier[:, 0:3, 2], basis)
    track.dual_frame[rows] = dual_basis(frame)
    track.gap[rows] = gaps[:, 0] if contact.pattern.constraints == 1 else np.hypot(gaps[:, 0], gaps[:, 1])
    track.conditioning[rows] = np.abs(outputs["conditioning"])
    track.slip_velocity[rows] = sign * outputs["slip"]
    closed = modes != FREE
    rows, along = rows[closed], outputs["force"][closed]
    track.force[rows] = force = sign * np.einsum("nij,ni->nj", basis[closed], along)
    track.multipliers[rows] = np.einsum("nij,ni->nj", frame[closed], force)
    normal, tangential = along[:, 2], np.hypot(along[:, 0], along[:, 1])
    if contact.pattern.constraints == 2:
        normal, tangential = np.hypot(along[:, 1], along[:, 2]), np.abs(along[:, 0])
    track.normal_force[rows], track.tangential_force[rows] = normal, tangential


def _fill_residuals(
    rows: np.ndarray,
    outputs: dict[str, np.ndarray],
    contact: Contact,
    modes: np.ndarray,
    residuals: dict[str, np.ndarray],
) -> None:
    """Residuals of a contact where it is closed; modes (n,): of all outputs."""
    closed = modes[rows] != FREE
    rows, outputs = rows[closed], {name: array[closed] for name, array in outputs.items()}
    first, second = outputs["shapes"][:, 0], outputs["shapes"][:, 1]
    carriers, basis = outputs["frames"], outputs["basis"]
    length = characteristic_length(contact)
    difference = (carriers[:, 1, 3] - carriers[:, 0, 3]) + (second[:, 0] - first[:, 0])
    residuals["C1"][rows] = np.linalg.norm(difference, axis=1) / length
    residuals["GC"][rows] = np.abs(outputs["gaps"]).max(axis=1) / length
    k1 = contact.body1.contour.dimension
    if k1 > 0 and contact.pattern.name != "3C-3C":
        tangents = first[:, 1 : 1 + k1]
        across = np.abs(np.einsum("nai,ni->na", tangents, basis[:, 2])) / np.linalg.norm(tangents, axis=2)
        residuals["C2"][rows] = across.max(axis=1)
    components = np.abs(np.einsum("nij,nj->ni", basis, outputs["slip"]))
    worst = components[:, 3 - contact.pattern.constraints :].max(axis=1)
    held = components[:, : contact.pattern.tangents].max(axis=1, initial=0.0)
    speeds = np.linalg.norm(carriers[:, :, 4], axis=2).max(axis=1, initial=1.0)
    residuals["VC"][rows] = np.where(modes[rows] == STICK, np.maximum(worst, held), worst) / speeds
