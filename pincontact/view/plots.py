"""Plots of a run: one function per kind, each usable alone with `ax=`, and `plot` for several at once.

Every function takes a Trajectory, draws into `ax` (a new figure's if None) and returns the Axes. `contact` names
one contact; None takes all of them. Matplotlib is imported on the first call; without it MissingExtraError.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..analysis.linearize import velocity_names
from ..display import MODE_NAMES
from ..dynamics.joints import joint_of
from ..dynamics.manifold import FREE_FLYER, PLANAR_BLOCK, QUATERNION, VECTOR, configuration_blocks
from ..errors import ArgumentError
from ..extras import required
from ..layout import FREE
from ..tracks import is_bare
from .palette import MODE_COLORS, contact_color
from .sampling import friction_limit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..friction.laws import FrictionLaw
    from ..tracks import ContactTrack
    from ..trajectory import Trajectory

# A legend has columns of so many rows.
_LEGEND_ROWS = 16
_LIMIT = "friction limit"
# Height of a strip of modes, as a part of the axes, as long as there are no more than so many.
_STRIP, _MANY_STRIPS = 0.075, 8
_RESIDUALS = {
    "C1": "C1: distance of the points",
    "C2": "C2: tangents out of the plane",
    "GC": "GC: gap (geometric constraint)",
    "VC": "VC: slip (velocity constraint)",
}
# Works smaller than this part of the energy are rounding.
_NO_WORK = 1e-12


def _pyplot() -> ModuleType:
    required("matplotlib", "plots need matplotlib, which is not installed", "pincontact[plot]")
    from matplotlib import pyplot

    return pyplot


def _axes(ax: Axes | None) -> Axes:
    return _pyplot().subplots(layout="constrained")[1] if ax is None else ax


def _tracks(run: Trajectory, contact: str | None) -> dict[str, ContactTrack]:
    """The tracks to draw, by name. Raises ArgumentError for a contact the run does not have."""
    if contact is None:
        return dict(run.contacts)
    if contact not in run.contacts:
        known = ", ".join(repr(name) for name in run.contacts) or "none"
        raise ArgumentError(f"the run has no contact {contact!r}; it has {known}")
    return {contact: run.contacts[contact]}


def _finish(ax: Axes, ylabel: str, legend: bool = True) -> Axes:
    ax.set_xlabel("t [s]")
    ax.set_ylabel(ylabel)
    ax.grid(alpha=0.3)
    entries = len(ax.get_legend_handles_labels()[0])
    if legend and entries:
        # Beside the axes, where it covers nothing.
        columns = -(-entries // _LEGEND_ROWS)
        ax.legend(fontsize="x-small", loc="center left", bbox_to_anchor=(1.0, 0.5), ncols=columns)
    return ax


def _color(run: Trajectory, name: str) -> str:
    """The colour of a contact in every picture."""
    return contact_color(list(run.contacts).index(name))


def _label(name: str, text: str, tracks: dict[str, ContactTrack]) -> str:
    return text if len(tracks) == 1 else f"{name}: {text}"


def _law(run: Trajectory, name: str) -> FrictionLaw | None:
    """The friction law of a contact; None where there is none, or the run was read from a file without its scene."""
    return run.scene.contacts[name].friction if name in run.scene.contacts else None


def limit(run: Trajectory, name: str) -> np.ndarray | None:
    """Largest dry friction force that the law of a contact allows.

    Sliding contacts have the coefficient of their speed, all others the one up to which they stick.

    Parameters
    ----------
    run : Trajectory
    name : str
        Of the contact.

    Returns
    -------
    (n,) array or None
        In N at each output; None where the law sets no single limit.
    """
    track = run.contacts[name]
    speed = np.linalg.norm(np.asarray(track.slip_velocity), axis=1)
    return friction_limit(_law(run, name), np.asarray(track.mode), np.asarray(track.normal_force), speed)


def mode_bands(
    run: Trajectory,
    contact: str,
    ax: Axes,
    part: tuple[float, float] = (0.0, 1.0),
    alpha: float = 0.13,
    legend: bool = True,
) -> Axes:
    """Shade the times of each mode of one contact: green stick, red slip, blue frictionless, grey open.

    Parameters
    ----------
    run : Trajectory
    contact : str
        Name of the contact.
    ax : matplotlib.axes.Axes
        Where to draw, over t in s.
    part : (float, float)
        Lower and upper end of the bands, of the height of the axes, from 0 to 1.
    alpha : float
        Opacity.
    legend : bool
        Whether to name the modes.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ArgumentError
        For a contact that the run does not have.
    """
    mode = np.asarray(_tracks(run, contact)[contact].mode)
    t = np.asarray(run.t)
    if len(t) == 0:
        return ax
    starts = np.concatenate([[0], 1 + np.flatnonzero(mode[1:] != mode[:-1])])
    ends = np.concatenate([t[starts[1:]], t[-1:]])
    named: set[int] = set()
    for start, end in zip(starts, ends):
        kind = int(mode[start])
        label = MODE_NAMES[kind] if legend and kind not in named else None
        ax.axvspan(t[start], end, *part, color=MODE_COLORS[kind], alpha=alpha, linewidth=0.0, label=label)
        named.add(kind)
    return ax


def motion(run: Trajectory, ax: Axes | None = None, velocities: bool = False) -> Axes:
    """Configuration or velocity over time, named after the joints.

    Orientations are rotation vectors (axis times angle), continuous through whole turns; angles count turns.

    Parameters
    ----------
    run : Trajectory
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, if not given.
    velocities : bool
        Whether to draw velocity coordinates (m/s, rad/s) instead of the configuration (m, rad).

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    MissingExtraError
        Without Matplotlib.
    """
    ax = _axes(ax)
    model, symbol = run.scene.model, "v" if velocities else "q"
    values = np.asarray(run.v if velocities else run.q)
    if is_bare(run):
        # without its scene it knows no joints
        lines = {f"{symbol}[{k}]": values[:, k] for k in range(values.shape[1])}
    elif velocities:
        lines = {name: values[:, k] for k, name in enumerate(velocity_names(model))}
    else:
        lines = _lengths_and_angles(model, values)
    for number, (label, line) in enumerate(lines.items()):
        # Matplotlib has ten colours
        ax.plot(run.t, line, ("-", "--", ":", "-.")[number // 10 % 4], label=label)
    return _finish(ax, "v [m/s, rad/s]" if velocities else "q [m, rad]", legend=len(lines) <= _LEGEND_ROWS)


def _lengths_and_angles(model: pin.Model, q: np.ndarray) -> dict[str, np.ndarray]:
    """Configurations, (n, nq), in m and rad by label: angles count turns, orientations are rotation vectors."""
    lines: dict[str, np.ndarray] = {}
    for kind, iq, iv, count in configuration_blocks(model):
        joint = joint_of(model, iv)
        if kind == VECTOR:
            lines |= {name: q[:, iq + k] for k, name in enumerate(velocity_names(model)[iv : iv + count])}
            continue
        if kind in (FREE_FLYER, PLANAR_BLOCK):
            axes = "xyz" if kind == FREE_FLYER else "xy"
            lines |= {f"{joint} {axis}": q[:, iq + k] for k, axis in enumerate(axes)}
            iq += len(axes)
        if kind in (FREE_FLYER, QUATERNION):
            vectors = _rotation_vectors(q[:, iq : iq + 4])
            lines |= {f"{joint} rotation vector {axis}": vectors[:, k] for k, axis in enumerate("xyz")}
        else:
            turn = np.unwrap(np.arctan2(q[:, iq + 1], q[:, iq]))
            lines[f"{joint} angle" if kind == PLANAR_BLOCK else joint] = turn
    return lines


def _rotation_vectors(quaternions: np.ndarray) -> np.ndarray:
    """(n, 3) axis times angle of (n, 4) quaternions (x, y, z, w), with the turns that continue the row before."""
    vectors = np.array([pin.log3(pin.Quaternion(row).matrix()) for row in quaternions]).reshape(-1, 3)
    for before, vector in pairwise(vectors):
        angle = float(np.linalg.norm(vector))
        if angle > 0.0:
            turns = np.round((before @ vector / angle - angle) / (2.0 * np.pi))
            vector *= 1.0 + 2.0 * np.pi * turns / angle
    return vectors


def forces(run: Trajectory, contact: str | None = None, ax: Axes | None = None) -> Axes:
    """Normal and friction force in N over time, with the largest friction that the law allows (dashed).

    Parameters
    ----------
    run : Trajectory
    contact : str, optional
        Name of a contact; all of them, if not given.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, if not given.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ArgumentError
        For a contact that the run does not have.
    MissingExtraError
        Without Matplotlib.
    """
    ax = _axes(ax)
    tracks = _tracks(run, contact)
    # one contact: a line each in the legend; several: their colours, and the styles once
    alone = len(tracks) == 1
    styles = {"normal": "-", "friction": ":", _LIMIT: "--"}
    for name, track in tracks.items():
        color = _color(run, name)
        ax.plot(run.t, track.normal_force, color=color, label="normal" if alone else name)
        ax.plot(run.t, track.tangential_force, ":", color=color, label="friction" if alone else None)
        largest = limit(run, name)
        if largest is not None:
            ax.plot(run.t, largest, "--", color=color, alpha=0.6, label=_LIMIT if alone else None)
    if len(tracks) > 1:
        for text, style in styles.items():
            ax.plot([], [], style, color="0.3", label=text)
    return _finish(ax, "force [N]")


def friction_cone(run: Trajectory, contact: str | None = None, ax: Axes | None = None) -> Axes:
    """Friction force against normal force in N, coloured by mode, with the cone's edge |F_t| = mu F_n (Sec. 5.3).

    Parameters
    ----------
    run : Trajectory
    contact : str, optional
        Name of a contact; all of them, if not given.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, if not given.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ArgumentError
        For a contact that the run does not have.
    MissingExtraError
        Without Matplotlib.
    """
    ax = _axes(ax)
    named: set[int] = set()
    edges: set[float] = set()
    for name, track in _tracks(run, contact).items():
        mode = np.asarray(track.mode)
        normal, friction = np.asarray(track.normal_force), np.asarray(track.tangential_force)
        for kind in np.unique(mode[mode != FREE]):
            at = mode == kind
            label = None if kind in named else MODE_NAMES[int(kind)]
            ax.plot(normal[at], friction[at], ".", color=MODE_COLORS[int(kind)], markersize=4, label=label)
            named.add(kind)
        law = _law(run, name)
        across = 1.0 if law is None else law.aspect
        for mu in () if law is None else sorted({k * a for k in (law.sliding, law.sticking) for a in (1.0, across)}):
            if np.isfinite(mu) and mu not in edges:
                edges.add(mu)
                end = max(float(np.max(normal, initial=0.0)), np.finfo(float).tiny)
                ax.plot([0.0, end], [0.0, mu * end], "k--", linewidth=1.0, label=f"mu = {mu:g}")
    _finish(ax, "friction force [N]")
    ax.set_xlabel("normal force [N]")
    return ax


def _mode_strips(run: Trajectory, names: list[str], ax: Axes) -> None:
    """One strip a contact above the axes, its name beside it, in the contact's colour; the modes' colours below all."""
    height = _STRIP if len(names) <= _MANY_STRIPS else _STRIP * _MANY_STRIPS / len(names)
    strips = ax.inset_axes((0.0, 1.02, 1.0, height * len(names)), sharex=ax)
    seen: set[int] = set()
    for row, name in enumerate(names):
        part = 1.0 - (row + 0.85) / len(names), 1.0 - (row + 0.15) / len(names)
        mode_bands(run, name, strips, part, 0.8, legend=False)
        seen |= {int(kind) for kind in np.unique(run.contacts[name].mode)}
    strips.set(ylim=(0.0, 1.0), yticks=[1.0 - (row + 0.5) / len(names) for row in range(len(names))])
    small = max(3.0, min(7.0, 95.0 * height))
    strips.set_yticklabels(names, fontsize=small)
    for label, name in zip(strips.get_yticklabels(), names):
        label.set_color(_color(run, name))
    strips.tick_params(bottom=False, labelbottom=False, left=False, pad=2)
    for spine in strips.spines.values():
        spine.set_visible(False)
    for kind in sorted(seen):
        ax.fill_between([], [], color=MODE_COLORS[kind], alpha=0.8, linewidth=0.0, label=MODE_NAMES[kind])


def slip(run: Trajectory, contact: str | None = None, ax: Axes | None = None) -> Axes:
    """Slip speed in m/s over time, with the modes: shaded for one contact, as strips above the plot for several.

    Parameters
    ----------
    run : Trajectory
    contact : str, optional
        Name of a contact; all of them, if not given.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, if not given.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ArgumentError
        For a contact that the run does not have.
    MissingExtraError
        Without Matplotlib.
    """
    ax = _axes(ax)
    tracks = _tracks(run, contact)
    for name, track in tracks.items():
        speed = np.linalg.norm(track.slip_velocity, axis=1)
        ax.plot(run.t, speed, color=_color(run, name), label=_label(name, "slip speed", tracks))
    if len(tracks) == 1:
        mode_bands(run, next(iter(tracks)), ax)
    elif tracks:
        _mode_strips(run, list(tracks), ax)
    return _finish(ax, "slip speed [m/s]")


def location(run: Trajectory, contact: str | None = None, ax: Axes | None = None) -> Axes:
    """Location parameters of the contact point on both contours over time, in m or rad; broken where a chart ends.

    Parameters
    ----------
    run : Trajectory
    contact : str, optional
        Name of a contact; all of them, if not given.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, if not given.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ArgumentError
        For a contact that the run does not have.
    MissingExtraError
        Without Matplotlib.
    """
    ax = _axes(ax)
    tracks = _tracks(run, contact)
    for name, track in tracks.items():
        charts = np.asarray(track.charts)
        changed = np.concatenate([[False], (charts[1:] != charts[:-1]).any(axis=1)])[: len(charts)]
        contact_of = run.scene.contacts.get(name)
        sides = ("first", "second") if contact_of is None else (contact_of.first.name, contact_of.second.name)
        styles = iter(("-", "--", ":", "-."))
        for side, values in zip(sides, (track.location_first, track.location_second)):
            for k in range(values.shape[1]):
                whole = np.where(changed, np.nan, values[:, k])
                label = _label(name, f"{side} u{k + 1}", tracks)
                ax.plot(run.t, whole, next(styles), color=_color(run, name), label=label)
    return _finish(ax, "location [m, rad]")


def energy(run: Trajectory, ax: Axes | None = None) -> Axes:
    """Kinetic and potential energy, their sum, and the works that the run recorded, in J over time.

    A work that is zero throughout, to rounding, such as that of prescribed motions where there are none, is left out.

    Parameters
    ----------
    run : Trajectory
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, if not given.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    TrajectoryError
        For a run that was read from a file without its scene.
    MissingExtraError
        Without Matplotlib.
    """
    ax = _axes(ax)
    energies = run.energies()
    for name in ("kinetic", "potential", "total"):
        ax.plot(run.t, getattr(energies, name), label=name)
    for name in ("friction_work", "drive_work", "torque_work", "damping_work"):
        values = getattr(energies, name)
        if values is not None and np.abs(values).max(initial=0.0) > _NO_WORK * np.abs(energies.total).max(initial=0.0):
            ax.plot(run.t, values, "--", label=name.replace("_", " "))
    return _finish(ax, "energy [J]")


def residuals(run: Trajectory, ax: Axes | None = None) -> Axes:
    """Residuals of the constraints over time, on a logarithmic scale; exact zeros have no place on it.

    Parameters
    ----------
    run : Trajectory
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, if not given.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    MissingExtraError
        Without Matplotlib.
    """
    ax = _axes(ax)
    for name, values in run.residuals().items():
        size = np.abs(np.asarray(values, dtype=float))
        ax.plot(run.t, np.where(size > 0.0, size, np.nan), label=_RESIDUALS.get(name, name))
    ax.set_yscale("log")
    return _finish(ax, "residual")


KINDS: dict[str, Callable[..., Axes]] = {
    "motion": motion,
    "forces": forces,
    "cone": friction_cone,
    "slip": slip,
    "location": location,
    "energy": energy,
    "residuals": residuals,
}
_CONTACT_KINDS = ("forces", "cone", "slip", "location")


def plot(
    run: Trajectory, kinds: str | Sequence[str] | None = None, axes: Axes | Sequence[Axes] | np.ndarray | None = None
) -> Figure:
    """Several plots of a run in one figure.

    Parameters
    ----------
    run : Trajectory
    kinds, axes
        As for `Trajectory.plot`.

    Returns
    -------
    matplotlib.figure.Figure
        Its axes are in the order of the kinds.

    Raises
    ------
    ArgumentError, MissingExtraError
        As `Trajectory.plot` does.
    """
    chosen = [kinds] if isinstance(kinds, str) else kinds
    if chosen is None:
        chosen = [kind for kind in KINDS if run.contacts or kind not in _CONTACT_KINDS]
        if is_bare(run):
            chosen.remove("energy")
    for kind in chosen:
        if kind not in KINDS:
            raise ArgumentError(f"unknown kind of plot {kind!r}; one of {', '.join(KINDS)}")
    if not chosen:
        raise ArgumentError("kinds is empty: nothing to plot")
    if axes is None:
        columns = 1 if len(chosen) == 1 else 2
        rows = -(-len(chosen) // columns)
        _, grid = _pyplot().subplots(
            rows, columns, figsize=(5.6 * columns, 3.1 * rows), layout="constrained", squeeze=False
        )
        for unused in grid.flat[len(chosen) :]:
            unused.remove()
        axes = grid.flat[: len(chosen)]
    given = np.atleast_1d(np.asarray(axes, dtype=object)).reshape(-1)
    if len(given) != len(chosen):
        raise ArgumentError(f"{len(chosen)} kinds of plot need as many axes, got {len(given)}")
    for kind, ax in zip(chosen, given):
        KINDS[kind](run, ax=ax)
        # above the strips of modes, if there are any
        above = [child for child in ax.child_axes if child.get_ylim() == (0.0, 1.0)]
        (above[0] if above else ax).set_title(kind, fontsize="medium")
    return given[0].figure
