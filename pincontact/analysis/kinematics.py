"""The paper's equations of every contact, and of motion, at one state, as numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..display import Summary
from ..dynamics.system import System
from ..errors import SingularContactError
from ..geometry.carriers import OMEGA, ORIGIN
from ..geometry.frames import contact_frame, curve_normal_axis, dual_basis
from ..geometry.patterns import CROSSING_CURVES, ON_SURFACE, PLANAR
from ..integration.discrete import write_discrete
from ..layout import CONDITION, NOTHING_THERE, OK, PATTERN
from ..state import State, check_state, check_vector
from .instant import Instant

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..scene import Scene


class _Forces:
    """All contacts' forces at a state, solved for when first asked for: kinematics need none, and may have none."""

    def __init__(self, scene: Scene, state: State, tau: np.ndarray) -> None:
        names = ("q", "v", "location", "discrete")
        self._at = scene, replace(state, **{name: getattr(state, name).copy() for name in names}), tau

    @cached_property
    def by_contact(self) -> dict[str, np.ndarray]:
        return Instant(*self._at).forces()


@dataclass(frozen=True, eq=False, repr=False)
class ContactKinematics(Summary):
    """The paper's equations of one contact, and of motion, at one state, as numbers.

    World axes unless said, SI units. Relative quantities are of the second contour that the user named against the
    first, as in `ContactTrack`: v_c is its slip_velocity, and v_c . force = components . multipliers. Parameters and
    frames are in the paper's order, in which body 2 has at least as many parameters as body 1 (as given when equal).
    m is the number of location equations, k that of location parameters.

    The equations of motion (Eqs. 31, 60) are M a = H + sum over all contacts of rows^T multipliers, and what acts on
    joints by dry friction and limits, or resists spinning and rolling. M and H are the same for all contacts.

    Attributes
    ----------
    f : (m,) array
        Conditions C1, components of r_first - r_second as in Eq. 42 (along world x, y, z; for a planar pattern along
        the plane's x, y, in axes of body 2), then C2, e_3 . tau_1^a (Eqs. 1, 2). In m, C2 without unit.
    f_q : (m, nv) array
        Derivatives of f along Pinocchio's velocity coordinates (Eq. 5).
    J : (m, k) array
        Derivatives of f by the location parameters.
    f_t : (m,) array
        Explicit rates of f, from prescribed motions and contours that depend on time.
    location : (k,) array
        Location parameters p = (u_1, u_2), in m or rad.
    rates : (k,) array
        p' (Eq. 6).
    M : (nv, nv) array
        Mass matrix of Pinocchio's velocity coordinates.
    H : (nv,) array
        Generalized forces tau - damping v - nle: torques, joint damping, and Pinocchio's nonlinear effects, which are
        gravity, centrifugal and Coriolis forces; in N and N m.
    frame : (3, 3) array
        e_1, e_2, e_3 as columns (Def. 5).
    dual_frame : (3, 3) array
        m^1, m^2, m^3 as columns (Eq. 26).
    v_c : (3,) array
        Velocity in m/s of the second contour's material point against the first's (Eq. 10).
    components : (3,) array
        v_c^j = m^j . v_c (Eq. 12).
    rows : (3, nv) array
        Derivatives of v_c^j by v (Eqs. 17, 29); of locked joints, which have no v, zero.
    drift : (3,) array
        Part of v_c^j that prescribed motions make: v_c^j = rows v + drift.
    bias : (3,) array
        Rate of v_c^j without accelerations a: it is rows a + bias.
    gap : float
        n . (r_2 - r_1) in m, positive when apart.
    conditioning : float
        Of the location equations, 1 good, 0 singular.
    point : (3,) array
        Contact point on body 2, in m.
    """

    f: np.ndarray
    f_q: np.ndarray
    J: np.ndarray
    f_t: np.ndarray
    location: np.ndarray
    rates: np.ndarray
    M: np.ndarray
    H: np.ndarray
    frame: np.ndarray
    dual_frame: np.ndarray
    v_c: np.ndarray
    components: np.ndarray
    rows: np.ndarray
    drift: np.ndarray
    bias: np.ndarray
    gap: float
    conditioning: float
    point: np.ndarray
    _name: str
    _forces: _Forces

    @cached_property
    def force(self) -> np.ndarray:
        """F, (3,) in N: the force on the second contour at the state, as a motion that starts there has it.

        It is solved for when it is first asked for, and zero where the contact is open.

        Raises
        ------
        SolverError, SingularContactError
            Where there are no forces.
        """
        return self._forces.by_contact[self._name]

    @cached_property
    def multipliers(self) -> np.ndarray:
        """Lambda, (3,) in N: components of `force` in the dual frame, F_j = e_j . F (Eq. 27).

        Raises
        ------
        SolverError, SingularContactError
            Where there are no forces.
        """
        return self.frame.T @ self.force


def analyze(scene: Scene, state: State, tau: ArrayLike | None = None) -> dict[str, ContactKinematics]:
    """The equations of every contact of a scene, and of motion, at a state, signed as the user named the contours.

    Parameters
    ----------
    scene : Scene
    state : State
        A state of this scene.
    tau : (nv,) array_like, optional
        Joint torques that act in N and N m, zero if not given. H and forces depend on them.

    Returns
    -------
    dict of str to ContactKinematics
        By names of contacts.

    Raises
    ------
    ArgumentError
        For a state of another scene.
    StateError
        For a state whose numbers cannot be used, or a bad tau.
    SingularContactError
        Where the location equations are singular, or an open contact has no nearest points.

    Examples
    --------
    A wheel's point of contact moves over the ground as fast as its centre:

    >>> import numpy as np
    >>> import pinocchio as pin
    >>> import pincontact as pc
    >>> scene = pc.Scene.from_urdf("urdf/disk.urdf", floating_base=True)
    >>> rim = scene.add_contour("rim", pc.Circle(radius=0.3), frame="disk")
    >>> floor = scene.add_contour("floor", pc.Plane())
    >>> contact = scene.add_contact("wheel", rim, floor, friction=pc.NoSlip())
    >>> upright = pin.Quaternion(pin.utils.rotate("x", np.pi / 2)).coeffs()
    >>> state = scene.initial_state([0, 0, 0.3, *upright], [0.6, 0, 0, 0, 0, -2.0])
    >>> found = pc.analyze(scene, state)["wheel"]
    >>> np.abs(found.rates).round(9).tolist()  # of u on the rim in rad/s, of (x, y) on the floor in m/s
    [2.0, 0.6, 0.0]
    >>> bool(np.abs(found.v_c).max() < 1e-12)
    True
    >>> weight = scene.model.inertias[1].mass * 9.81
    >>> bool(np.abs(found.force - [0, 0, -weight]).max() < 1e-9)  # on the floor, which was named second
    True
    """
    check_state(scene, state)
    contacts = list(scene.contacts.values())
    system = System(scene.model, contacts)
    torques = check_vector("tau", np.zeros(system.nv) if tau is None else tau, system.nv)
    system.q[:], system.v[:] = state.q, state.v
    system.location[: system.nc] = state.location
    write_discrete(system, state.discrete)
    if system.evaluate_kinematics(state.t) != OK:
        raise SingularContactError("the location equations are singular at this state", 0.0)
    for contact, gap in zip(contacts, system.gaps[:, 0]):
        if gap == NOTHING_THERE:
            raise SingularContactError(f"contact {contact.name!r} is open and has no nearest points at this state", 0.0)
    lower = np.tril(system.mass)
    mass, generalized = lower + np.tril(lower, -1).T, torques - system.damping * state.v - system.bias_forces
    forces = _Forces(scene, state, torques)
    return {contact.name: _one(system, c, mass, generalized, forces) for c, contact in enumerate(contacts)}


def _one(system: System, c: int, mass: np.ndarray, generalized: np.ndarray, forces: _Forces) -> ContactKinematics:
    contact = system.contacts[c]
    one, two = 2 * c, 2 * c + 1
    k1, k2 = contact.body1.contour.dimension, contact.body2.contour.dimension
    first, second = system.derivatives[one].copy(), system.derivatives[two].copy()
    frame1, frame2 = system.frames[one], system.frames[two]
    pattern = int(system.contact_int[c, PATTERN])
    plane_normal = frame2[0:3, 2].copy()
    frame = contact_frame(pattern, first, second, plane_normal, system.basis[c])
    dual = dual_basis(frame)
    v = system.v
    points = (frame1[ORIGIN] + first[0], frame2[ORIGIN] + second[0])
    linear, angular = zip(*(system.jacobians(side, point) for side, point in ((one, points[0]), (two, points[1]))))
    # the paper's order of bodies is not always the user's
    sign = -1.0 if contact.swapped else 1.0
    relative, velocity = sign * (linear[1] - linear[0]), sign * system.slip[c]
    difference = sign * (points[0] - points[1])

    # C1: components of r_first - r_second along axes of the world, or of the plane that body 2 carries
    axes = frame2[0:3, 0:2].T if pattern == PLANAR else np.eye(3)
    f = list(axes @ difference)
    f_q = list(-axes @ relative)
    tangents = [first[1 + a] for a in range(k1)] + [-second[1 + a] for a in range(k2)]
    by_p = [[sign * float(axis @ tangent) for tangent in tangents] for axis in axes]
    rates = list(-axes @ velocity)
    if pattern == PLANAR:
        for j, axis in enumerate(axes):
            moment = np.cross(axis, difference)
            f_q[j] = f_q[j] + moment @ angular[1]
            rates[j] += float(moment @ frame2[OMEGA])

    # C2: the normal of body 2 against the unit tangents of body 1
    if pattern in (ON_SURFACE, PLANAR):
        e3, moved = frame[:, 2], [_tangent_rate(frame2, second, a) for a in range(k2)]
        # e_3 is along second[1] x other
        other, by_u = (second[2], second[4:6]) if pattern == ON_SURFACE else (plane_normal, np.zeros((1, 3)))
        other_rate = moved[1] if pattern == ON_SURFACE else np.cross(frame2[OMEGA], plane_normal)
        e3_by_u2 = [_normal_rate(second[1], second[3 + b], other, by_u[b]) for b in range(k2)]
        e3_rate = _normal_rate(second[1], moved[0], other, other_rate)
        for a in range(k1):
            tangent = first[1 + a]
            tau = tangent / np.linalg.norm(tangent)
            f.append(float(e3 @ tau))
            f_q.append(np.cross(tau, e3) @ (angular[0] - angular[1]))
            by_u1 = [float(e3 @ _unit_rate(tangent, first[3 + a + b])) for b in range(k1)]
            by_p.append(by_u1 + [float(tau @ change) for change in e3_by_u2])
            rates.append(float(e3 @ _unit_rate(tangent, _tangent_rate(frame1, first, a)) + tau @ e3_rate))

    f_q_array = np.array(f_q).reshape(len(f), system.nv)
    rows = dual.T @ relative
    components = dual.T @ velocity
    kept = np.r_[0:k1, 2 : 2 + k2]
    return ContactKinematics(
        f=np.array(f, dtype=float),
        f_q=f_q_array,
        J=np.array(by_p, dtype=float).reshape(len(f), k1 + k2),
        f_t=np.array(rates, dtype=float) - f_q_array @ v,
        location=system.location[c, kept].copy(),
        rates=system.rates[c, kept].copy(),
        M=mass.copy(),
        H=generalized.copy(),
        frame=frame,
        dual_frame=dual,
        v_c=velocity,
        components=components,
        rows=rows,
        drift=components - rows @ v,
        bias=sign * _component_bias(system, c, frame, dual, first, second, pattern, k1, k2),
        gap=float(system.gaps[c, 0] if contact.pattern.constraints == 1 else np.hypot(*system.gaps[c])),
        conditioning=float(abs(system.contact_real[c, CONDITION])),
        point=points[1].copy(),
        _name=contact.name,
        _forces=forces,
    )


def _unit_rate(vector: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Rate of a vector's direction."""
    size = np.linalg.norm(vector)
    unit = vector / size
    return np.asarray((rate - unit * (unit @ rate)) / size)


def _normal_rate(a: np.ndarray, a_rate: np.ndarray, b: np.ndarray, b_rate: np.ndarray) -> np.ndarray:
    """Rate of the direction of a x b."""
    return _unit_rate(np.cross(a, b), np.cross(a_rate, b) + np.cross(a, b_rate))


def _tangent_rate(frame: np.ndarray, derivatives: np.ndarray, a: int, rates: np.ndarray | None = None) -> np.ndarray:
    """Rate of a side's tangent f_a in world axes, at rates (k,) of its parameters, or where they stay."""
    rate = np.cross(frame[OMEGA], derivatives[1 + a]) + derivatives[7 + a]
    return rate if rates is None else rate + rates @ derivatives[3 + a : 3 + a + len(rates)]


def _component_bias(
    system: System,
    c: int,
    frame: np.ndarray,
    dual: np.ndarray,
    first: np.ndarray,
    second: np.ndarray,
    pattern: int,
    k1: int,
    k2: int,
) -> np.ndarray:
    """Rate of v_c^j = m^j . v_c without joint acceleration: m^j . gamma + m^j' . v_c, with m' = -m E'^T m."""
    basis = system.basis[c]
    frame1, frame2 = system.frames[2 * c], system.frames[2 * c + 1]
    u1, u2 = system.rates[c, :k1], system.rates[c, 2 : 2 + k2]
    rate1 = _tangent_rate(frame2, second, 0, u2)
    e1_rate = _unit_rate(second[1], rate1)
    if pattern == ON_SURFACE:
        rate2, other = _tangent_rate(frame2, second, 1, u2), second[2]
    elif pattern == CROSSING_CURVES:
        rate2, other = _tangent_rate(frame1, first, 0, u1), first[1]
    elif pattern == PLANAR:
        other = frame[:, 1]
        rate2 = np.cross(frame2[OMEGA], other)
    else:
        # the kernels take the normals that do not spin about the curve; the frame's are made from a world axis
        turn = np.cross(frame[:, 0], e1_rate)
        normal_rates = {row: np.cross(turn, basis[row]) for row in (1, 2)}
        e1, axis = frame[:, 0], curve_normal_axis(frame[:, 0])
        raw, raw_rate = axis - e1 * (e1 @ axis), -e1_rate * (e1 @ axis) - e1 * (e1_rate @ axis)
        e2_rate = _unit_rate(raw, raw_rate)
        e3_rate = np.cross(e1_rate, frame[:, 1]) + np.cross(e1, e2_rate)
        return _in_dual(system, c, dual, np.column_stack([e1_rate, e2_rate, e3_rate]), normal_rates)
    e3_rate = _normal_rate(second[1], rate1, other, rate2)
    frame_rate = np.column_stack([e1_rate, _unit_rate(other, rate2), e3_rate])
    sign = 1.0 if basis[2] @ frame[:, 2] > 0.0 else -1.0
    return _in_dual(system, c, dual, frame_rate, {2: sign * e3_rate})


def _in_dual(
    system: System, c: int, dual: np.ndarray, frame_rate: np.ndarray, normal_rates: dict[int, np.ndarray]
) -> np.ndarray:
    """m^j . gamma + m^j' . v_c from the kernels' bias, whose normal rows contain n' . v_c already."""
    slip = system.slip[c]
    along = system.bias[c].copy()
    for row, rate in normal_rates.items():
        along[row] -= rate @ slip
    gamma = system.basis[c].T @ along
    dual_rate = -dual @ frame_rate.T @ dual
    return dual.T @ gamma + dual_rate.T @ slip
