"""The seven contact patterns (Sec. 2.2, Table 1) and how two contours name theirs."""

from __future__ import annotations

from dataclasses import dataclass

from ..contours.base import Contour
from ..errors import PatternError

# How the contact frame is built (Def. 5): from the surface's two tangents, from both curves' tangents, from a
# planar curve's tangent and the plane's normal, or from the tangent of a spatial curve that carries a point.
ON_SURFACE, CROSSING_CURVES, PLANAR, ON_CURVE = range(4)
# In place of a pattern: of a resistance to spinning or rolling, which has no normal of its own.
NO_NORMAL = -1


@dataclass(frozen=True)
class Pattern:
    """One row of Table 1: how two kinds of contour touch.

    Attributes
    ----------
    name : str
        Such as "P-S".
    code : int
        How the contact frame is built.
    equations : int
        Number m of the conditions C1 and C2.
    parameters : int
        Number k of the location parameters.
    tangents : int
        Number of the velocity constraints of rolling.
    """

    name: str
    code: int
    equations: int
    parameters: int
    tangents: int

    @property
    def constraints(self) -> int:
        """Number nu = m - k of the geometric constraints."""
        return self.equations - self.parameters


PATTERNS = {
    p.name: p
    for p in (
        Pattern("P-2C", PLANAR, 2, 1, 1),
        Pattern("P-3C", ON_CURVE, 3, 1, 1),
        Pattern("P-S", ON_SURFACE, 3, 2, 2),
        Pattern("2C-2C", PLANAR, 3, 2, 1),
        Pattern("3C-3C", CROSSING_CURVES, 3, 2, 2),
        Pattern("3C-S", ON_SURFACE, 4, 3, 2),
        Pattern("S-S", ON_SURFACE, 5, 4, 2),
    )
}

_SPATIAL = {(0, 1): "P-3C", (0, 2): "P-S", (1, 1): "3C-3C", (1, 2): "3C-S", (2, 2): "S-S"}
_PLANAR = {(0, 1): "P-2C", (1, 1): "2C-2C"}


def candidate_patterns(body1: Contour, body2: Contour) -> tuple[str, ...]:
    """Names of the patterns that two contours with k2 >= k1 can form, the spatial one first."""
    key = (body1.dimension, body2.dimension)
    names = [_SPATIAL[key]] if key in _SPATIAL else []
    if key in _PLANAR and body2.planar and (body1.planar or body1.dimension == 0):
        names.append(_PLANAR[key])
    return tuple(names)


def find_pattern(contact: str, body1: Contour, body2: Contour, wanted: str | None, moves_in_plane: bool) -> Pattern:
    """The pattern of two contours, sorted so that k2 >= k1.

    wanted: a name given by the user, or None to infer.
    moves_in_plane: whether the mechanism keeps both contours in the plane of body 2's.
    Raises PatternError when the contours form no pattern, or not the one wanted.
    """
    if body1.dimension == body2.dimension == 0:
        raise PatternError(f"contact {contact!r}: a point against a point is not one of the seven patterns")
    possible = candidate_patterns(body1, body2)
    if wanted is None:
        return PATTERNS[possible[-1] if moves_in_plane else possible[0]]
    if wanted not in PATTERNS:
        raise PatternError(f"contact {contact!r}: unknown pattern {wanted!r}; one of {', '.join(PATTERNS)}")
    if wanted not in possible:
        raise PatternError(
            f"contact {contact!r}: {body1.name} and {body2.name} form {' or '.join(possible)}, not {wanted}"
        )
    pattern = PATTERNS[wanted]
    if pattern.code == PLANAR and not moves_in_plane:
        raise PatternError(
            f"contact {contact!r}: pattern {wanted} needs both contours to lie in one plane and the mechanism to "
            "stay in it, but this mechanism can leave the plane of the second contour"
        )
    return pattern
