"""The equations of a contact's location, their rates and the bias of its acceleration, against differences.

Contours are quadratic in their parameters and in time, on bodies that move like `Course`.
"""

import numpy as np
import pytest
from calling import from_python
from made_systems import made_system
from test_carried_frames import NEAR, Course, H, frame_of

from pincontact.constraints import kinematics
from pincontact.geometry import location as parts
from pincontact.geometry.patterns import CROSSING_CURVES, ON_CURVE, ON_SURFACE, PLANAR
from pincontact.layout import K1, K2, PATTERN, SIDE, SYSTEM

location_jacobian, location_residual, rate_equations, measure, acceleration_bias = (
    from_python(part, SYSTEM)
    for part in (
        parts.location_jacobian,
        parts.location_residual,
        parts.rate_equations,
        kinematics.measure,
        kinematics.acceleration_bias,
    )
)
basis_at_contact = from_python(kinematics.basis_at_contact)

CASES = [
    (PLANAR, 0, 1),
    (PLANAR, 1, 1),
    (ON_CURVE, 0, 1),
    (CROSSING_CURVES, 1, 1),
    (ON_SURFACE, 0, 2),
    (ON_SURFACE, 1, 2),
    (ON_SURFACE, 2, 2),
]


class Contact:
    """Two such contours at parameters zero; p: those of body 2, then of body 1."""

    def __init__(self, pattern, k1, k2, seed):
        self.pattern, self.k1, self.k2 = pattern, k1, k2
        rng = np.random.default_rng([seed, pattern, k1, k2])
        self.courses = Course(seed), Course(seed + 5)
        self.constants, self.slopes = rng.normal(size=(2, 3)), rng.normal(size=(2, 3, 3))
        bends = rng.normal(size=(2, 3, 3, 3))
        self.bends = bends + np.swapaxes(bends, 1, 2)

    def split(self, p):
        """Parameters of both bodies."""
        u = np.zeros((2, 2))
        u[0, : self.k1], u[1, : self.k2] = p[self.k2 :], p[: self.k2]
        return u

    def tangent(self, body, u, t, a):
        x = np.array([*u, t])
        return self.courses[body](t).rotation @ (self.slopes[body, a] + self.bends[body, a].T @ x)

    def point(self, body, u, t):
        x = np.array([*u, t])
        shape = self.constants[body] + self.slopes[body].T @ x + 0.5 * np.einsum("i,ijk,j->k", x, self.bends[body], x)
        return self.courses[body](t).act(shape)

    def normal(self, p, t):
        u = self.split(p)
        along = self.tangent(1, u[1], t, 0)
        if self.pattern == ON_SURFACE:
            return np.cross(along, self.tangent(1, u[1], t, 1))
        if self.pattern == PLANAR:
            return np.cross(along, self.courses[1](t).rotation[:, 2])
        return np.cross(along, self.tangent(0, u[0], t, 0))

    def equations(self, p, t):
        """C1 on body 2's tangents, then C2, or C1 on the other curve's tangent (Eqs. 1-4)."""
        u = self.split(p)
        apart = self.point(1, u[1], t) - self.point(0, u[0], t)
        out = [self.tangent(1, u[1], t, a) @ apart for a in range(self.k2)]
        other = apart if self.pattern == CROSSING_CURVES else self.normal(p, t)
        return np.array([*out, *(self.tangent(0, u[0], t, a) @ other for a in range(self.k1))])

    def slip(self, p, t):
        """Of material points: parameters are held."""
        u = self.split(p)
        before, after = (self.point(1, u[1], s) - self.point(0, u[0], s) for s in (t - H, t + H))
        return (after - before) / (2 * H)

    def derivatives(self, body):
        turn, slope, bend = self.courses[body].start.rotation, self.slopes[body], self.bends[body]
        rows = [self.constants[body], slope[0], slope[1], bend[0, 0], bend[0, 1], bend[1, 1]]
        return np.array([*rows, slope[2], bend[0, 2], bend[1, 2], bend[2, 2]]) @ turn.T

    def system(self):
        """It is contact 1 of a workspace, with both contours evaluated and measured."""
        system = made_system(2, rng=np.random.default_rng(1))
        system.contact_int[1, [PATTERN, K1, K2]] = self.pattern, self.k1, self.k2
        system.frames[2:] = [frame_of(course) for course in self.courses]
        system.derivatives[2:] = self.derivatives(0), self.derivatives(1)
        measure(system, 1)
        apart = self.point(1, np.zeros(2), 0.0) - self.point(0, np.zeros(2), 0.0)
        assert system.vectors[parts.DIFFERENCE] == pytest.approx(apart, abs=1e-13)
        return system


def by_differences(f):
    return (f(H) - f(-H)) / (2 * H)


@pytest.mark.parametrize(("pattern", "k1", "k2"), CASES)
@pytest.mark.parametrize("seed", range(2))
def test_equations_with_all_their_derivatives(seed, pattern, k1, k2):
    contact = Contact(pattern, k1, k2, seed)
    n, zero = k1 + k2, np.zeros(k1 + k2)
    system = contact.system()
    if pattern != ON_CURVE:
        assert system.vectors[parts.NORMAL] == pytest.approx(contact.normal(zero, 0.0), abs=1e-12)
    location_jacobian(system, 1)
    metric, one, two, sides = system.location_system
    matrix = np.zeros((n, n))
    matrix[:k2, :k2] = np.array([[metric[0], metric[1]], [metric[1], metric[2]]])[:k2, :k2]
    for a, row in enumerate((one, two)[:k1]):
        matrix[:k2, k2 + a], matrix[k2 + a, :k2], matrix[k2 + a, k2:] = row[:k2], row[2 : 2 + k2], row[4 : 4 + k1]
    for i, direction in enumerate(np.eye(n)):
        exact = by_differences(lambda h, d=direction: contact.equations(h * d, 0.0))
        assert matrix[:, i] == pytest.approx(exact, **NEAR)

    def right():
        return np.array([*sides[:k2], *sides[2 : 2 + k1]])

    location_residual(system, 1)
    assert right() == pytest.approx(-contact.equations(zero, 0.0), abs=1e-12)
    system.slip[1] = contact.slip(zero, 0.0)
    rate_equations(system, 1)
    assert right() == pytest.approx(-by_differences(lambda h: contact.equations(zero, h)), **NEAR)


@pytest.mark.parametrize(("pattern", "k1", "k2"), CASES)
@pytest.mark.parametrize("side", [1, -1])
def test_the_bias_of_the_acceleration(side, pattern, k1, k2):
    """Rates of v_c along the contact's way, where the bodies' coordinates have none, met by normals that turn."""
    contact = Contact(pattern, k1, k2, 3)
    system = contact.system()
    system.contact_int[1, SIDE] = side
    way = np.random.default_rng(k1 + 3 * k2).normal(size=k1 + k2)
    system.rates[1, :k1], system.rates[1, 2 : 2 + k2] = way[k2:], way[:k2]
    basis, vectors = np.zeros((3, 3)), system.vectors
    basis_at_contact(pattern, side, system.derivatives[3], vectors[parts.NORMAL], basis)
    slip = contact.slip(np.zeros(k1 + k2), 0.0)
    system.basis[1], system.slip[1], system.bias[1] = basis, slip, np.nan
    acceleration_bias(system, 1)
    expected = basis @ by_differences(lambda h: contact.slip(h * way, h))

    def unit(vector):
        return vector / np.linalg.norm(vector)

    if pattern == ON_CURVE:
        # carried along the curve without turning about it
        turn = by_differences(lambda h: unit(contact.tangent(1, contact.split(h * way)[1], h, 0)))
        for i in (1, 2):
            expected[i] -= (basis[i] @ turn) * (basis[0] @ slip)
    else:
        normal_rate = by_differences(lambda h: -side * unit(contact.normal(h * way, h)))
        assert vectors[kinematics.NORMAL_RATE] == pytest.approx(normal_rate, **NEAR)
        expected[2] += normal_rate @ slip
    assert system.bias[1] == pytest.approx(expected, **NEAR)
