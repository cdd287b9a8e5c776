"""The drawings of the page on theory: each shows a contact as the package itself computes it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

import pincontact as pc

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D

BODY1, BODY2, FRAME, DUAL = "#c8553d", "#4f6d8f", "#111111", "#1b7f3b"
Window = tuple[tuple[float, float], ...] | None


class Case(NamedTuple):
    """A pattern's example. Body 1 moves by the joint and body 2 is the world; q is near contact, windows are what is
    drawn of contours, reach is half the drawing's width in m."""

    body1: pc.Contour
    body2: pc.Contour
    q: list[float]
    joint: Callable[[], pin.JointModel]
    reach: float
    window1: Window = None
    window2: Window = None
    turned1: pin.SE3 | None = None


def _pose(axis: str, angle: float, x: float, y: float, z: float) -> list[float]:
    return [x, y, z, *pin.Quaternion(pin.utils.rotate(axis, angle)).coeffs()]


def _hill(x: float, y: float) -> float:
    return 0.45 * math.exp(-2.5 * (x * x + 0.6 * y * y))


_FREE, _PLANAR, _TRANSLATION = pin.JointModelFreeFlyer, pin.JointModelPlanar, pin.JointModelTranslation
_GROUND = ((-0.9, 0.9), (-0.9, 0.9))
# A rod across the bowed rod of the crossing curves, whose tangents meet at 55 degrees.
_ACROSS = pin.SE3(pin.utils.rotate("z", math.radians(55.0 - 180.0)), np.zeros(3))
CASES = {
    "P-2C": Case(pc.Point(), pc.Ellipse(0.6, 0.35), [0.46, 0.22, 1.0, 0.0], _PLANAR, 0.75),
    "P-3C": Case(pc.Point(), pc.Helix(0.4, 0.5), [0.28, 0.28, 0.5 / 8.0], _TRANSLATION, 0.55, None, ((-5.5, 6.5),)),
    "P-S": Case(pc.Point(), pc.HeightField(_hill), [0.3, -0.25, 0.3], _TRANSLATION, 0.7, None, _GROUND),
    "2C-2C": Case(pc.Circle(0.22), pc.Ellipse(0.6, 0.35), [0.52, 0.42, 1.0, 0.0], _PLANAR, 0.85),
    "3C-3C": Case(
        pc.Line(), pc.Circle(0.8), _pose("x", 0.2, 0.0, 0.8, 0.0), _FREE, 0.6, ((-0.5, 0.5),), ((0.6, 2.5),), _ACROSS
    ),
    "3C-S": Case(pc.Circle(0.35), pc.HeightField(_hill), _pose("x", 1.25, 0.25, 0.15, 0.62), _FREE, 0.8, None, _GROUND),
    "S-S": Case(
        pc.Ellipsoid(0.34, 0.22, 0.16),
        pc.HeightField(_hill),
        _pose("y", 0.5, 0.2, -0.15, 0.5),
        _FREE,
        0.8,
        None,
        _GROUND,
    ),
}


class Touching(NamedTuple):
    """A case in contact: places of both bodies in the world, and the contact's geometry."""

    placement1: pin.SE3
    placement2: pin.SE3
    contact: pc.ContactKinematics


def touch(name: str) -> Touching:
    """Bring a case's bodies together, as `initial_state` does."""
    case = CASES[name]
    model = pin.Model()
    joint = model.addJoint(0, case.joint(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.2), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    first = scene.add_contour("first", case.body1, "body", case.turned1)
    second = scene.add_contour("second", case.body2)
    made = scene.add_contact("contact", first, second, pattern=name)
    state = scene.initial_state(case.q, max_gap=0.3)
    data = model.createData()
    pin.forwardKinematics(model, data, state.q)
    assert made.pattern.name == name and not made.swapped
    carried = data.oMi[joint] * first.placement_in_joint
    return Touching(carried, second.placement, pc.analyze(scene, state)["contact"])


def _draw_contour(ax: Axes3D, contour: pc.Contour, placement: pin.SE3, window: Window, colour: str) -> None:
    def world(points: np.ndarray) -> np.ndarray:
        return np.asarray(points) @ placement.rotation.T + placement.translation

    if contour.dimension == 0:
        ax.scatter(*placement.translation, color=colour, s=45, depthshade=False)
    elif contour.dimension == 1:
        ax.plot(*world(contour.polyline(200, window)).T, color=colour, linewidth=2.2)
    else:
        vertices, triangles = contour.mesh(28, window)
        faces = Poly3DCollection(world(vertices)[triangles], facecolors=colour, shade=True, linewidths=0.0, alpha=0.75)
        ax.add_collection3d(faces)


def _arrows(ax: Axes3D, start: np.ndarray, vectors: np.ndarray, names: str, colour: str, style: str = "-") -> None:
    for j, vector in enumerate(vectors.T):
        ax.quiver(*start, *vector, color=colour, arrow_length_ratio=0.15, linewidth=1.6, linestyle=style)
        ax.text(*(start + 1.18 * vector), names.format(j + 1), color=colour, fontsize=11, ha="center", va="center")


def draw_pattern(ax: Axes3D, name: str) -> None:
    """A pattern's bodies at their contact point, with the contact frame."""
    case, (placement1, placement2, contact) = CASES[name], touch(name)
    _draw_contour(ax, case.body2, placement2, case.window2, BODY2)
    _draw_contour(ax, case.body1, placement1, case.window1, BODY1)
    _arrows(ax, contact.point, 0.45 * case.reach * contact.frame, "$e_{}$", FRAME)
    ax.scatter(*contact.point, color="black", s=14, depthshade=False)
    for axis, centre in zip("xyz", 0.2 * (contact.point + placement1.translation)):
        getattr(ax, f"set_{axis}lim")(centre - case.reach, centre + case.reach)
    ax.set_box_aspect((1.0, 1.0, 1.0), zoom=1.25)
    planar = name in ("P-2C", "2C-2C")
    ax.view_init(elev=62.0 if planar else 24.0, azim=-75.0 if planar else -58.0)
    ax.set_axis_off()
    ax.set_title(name, y=0.98)


def patterns() -> Figure:
    """The seven patterns."""
    figure = plt.figure(figsize=(9.6, 5.2))
    for index, name in enumerate(CASES):
        # four above, three below
        row, column, width = (0, index, 0.25) if index < 4 else (1, index - 4, 1.0 / 3.0)
        rectangle = (column * width, 0.5 * (1 - row), width, 0.46)
        draw_pattern(figure.add_axes(rectangle, projection="3d", computed_zorder=False), name)
    return figure


def tangent_plane(ax: Axes, force: tuple[float, float] = (0.25, 0.85)) -> None:
    """An oblique frame and its dual, seen along the normal, with a tangential force in both of its descriptions.

    force: along e_1 and across it, in N, of the arrow that is drawn.
    """
    frame = touch("3C-3C").contact
    across = np.cross(frame.frame[:, 2], frame.frame[:, 0])
    to_plane = np.stack([frame.frame[:, 0], across])
    e, m = to_plane @ frame.frame[:, :2], to_plane @ frame.dual_frame[:, :2]
    drawn = np.array(force)

    def arrow(vector: np.ndarray, text: str, colour: str, width: float = 1.6) -> None:
        (x, y), (at_x, at_y) = vector, 1.1 * vector
        ax.annotate("", (x, y), (0.0, 0.0), arrowprops={"arrowstyle": "-|>", "color": colour, "lw": width})
        ax.text(at_x, at_y, text, color=colour, ha="center", va="center", fontsize=12)

    for j in range(2):
        arrow(e[:, j], f"$e_{j + 1}$", FRAME)
        arrow(m[:, j], f"$m^{j + 1}$", DUAL)
        foot = (drawn @ e[:, j]) * e[:, j]
        ax.plot(*np.stack([drawn, foot]).T, ":", color=FRAME, linewidth=1.0)
        ax.plot(*foot, "o", color=FRAME, markersize=4)
    components = e.T @ drawn
    corner = components[0] * m[:, 0]
    for start, end in ((np.zeros(2), corner), (corner, drawn)):
        ax.plot(*np.stack([start, end]).T, "--", color=DUAL, linewidth=1.2)
    arrow(drawn, "$F$", BODY1, width=2.4)
    corners = 1.25 * np.stack([drawn, corner, *e.T, *m.T, np.zeros(2)])
    ax.set_aspect("equal")
    ax.set_xlim(corners[:, 0].min(), corners[:, 0].max())
    ax.set_ylim(corners[:, 1].min() - 0.1, corners[:, 1].max())
    ax.set_axis_off()


def frames() -> Figure:
    """The oblique frame of two crossing curves, in space and in its tangent plane."""
    figure = plt.figure(figsize=(9.0, 3.8))
    left = figure.add_axes((0.0, 0.0, 0.5, 1.0), projection="3d", computed_zorder=False)
    draw_pattern(left, "3C-3C")
    tangent_plane(figure.add_axes((0.52, 0.04, 0.46, 0.92)))
    return figure


if __name__ == "__main__":
    for draw in (patterns, frames):
        draw().savefig(f"{draw.__name__}.png", dpi=110)
