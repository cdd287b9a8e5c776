"""Certificates that accelerations are out of reach (Farkas' lemma)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..display import Summary
from ..dynamics.joints import joint_of
from ..dynamics.units import unwhiten
from .inverse_problem import Problem

# Multipliers below this part of the largest are round-off.
_NEGLIGIBLE = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class FarkasCertificate(Summary):
    """Why accelerations are out of reach: a virtual velocity p under which the forces cannot do so little power.

    By the equations of motion p . (M a + nle + damping v - given forces) is the power of efforts, contact forces and
    held joints under p. Within limits and cones it is `least` at least; the accelerations wanted have `wanted`, which
    is less. That it is least can be seen: p does not move efforts that have no limit, others do no less than
    -(limit |p|), and contact forces in their cones no less than nothing, since `contacts` lie in the dual cones.

    Attributes
    ----------
    velocity : (nv,) ndarray
        p, its largest entry 1 or -1.
    wanted, least : float
        Powers under p, in W. Where contacts open or joints begin to move, what keeps their accelerations from going
        the other way counts, too.
    contacts : dict of str to (3,) ndarray
        Velocity under p of the second contour given against the first, in m/s, world axes, of the contacts whose
        limits matter.
    joints : tuple of str
        Joints whose limit of effort, dry friction or end of their way matters.
    """

    velocity: np.ndarray
    wanted: float
    least: float
    contacts: dict[str, np.ndarray]
    joints: tuple[str, ...]

    def __str__(self) -> str:
        names = [f"the cone of contact {name!r}" for name in self.contacts]
        return " and ".join([*names, *(f"the limit of joint {name!r}" for name in self.joints)])


def certificate_of(
    problem: Problem, on_cones: np.ndarray, on_rows: np.ndarray, task: np.ndarray, point: np.ndarray
) -> FarkasCertificate:
    """From multipliers of cones (m, 3) and rows (k,), and the tasks' gradient (nz,) in z, that add up to nothing in all
    free directions; point (n,): u of the accelerations wanted."""
    region, system = problem.region, problem.instant.system
    gradient = np.einsum("mi,min->n", on_cones, region.cones) + on_rows @ region.rows
    bounds = np.where(on_rows > 0.0, region.high, region.low)
    least = -float(on_rows @ np.where(np.isfinite(bounds), bounds, 0.0))
    wanted = -float(gradient @ point)
    gradient[: task.size] += task
    dual = np.linalg.lstsq(problem.equations.T, gradient, rcond=None)[0]
    velocity = unwhiten(system, dual)
    size = float(np.abs(velocity).max(initial=0.0))
    size = size if size > 0.0 else 1.0
    # u is in units of load, and the equations were divided by rate
    power = problem.rate / size
    shares = np.concatenate([np.abs(on_cones).max(axis=1, initial=0.0), np.abs(on_rows)])
    acting = [owner for owner, share in zip(problem.owners, shares) if share > _NEGLIGIBLE * shares.max(initial=0.0)]
    contacts = {}
    for c in dict.fromkeys(c for kind, c in acting if kind == "contact"):
        sign = -1.0 if system.contacts[c].swapped else 1.0
        contacts[system.contacts[c].name] = sign * (system.basis[c].T @ (system.rows[c] @ velocity)) / size
    joints = tuple(dict.fromkeys(joint_of(system.model, k) for kind, k in acting if kind == "joint"))
    return FarkasCertificate(velocity / size, power * wanted, power * least, contacts, joints)
