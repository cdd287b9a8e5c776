"""Workspaces of the kernels made by hand: arrays of a scene that nobody has to build."""

from __future__ import annotations

import numpy as np

from pincontact.contours.base import DERIVATIVE_ROWS
from pincontact.layout import (
    CONTACT_INTS,
    CONTACT_REALS,
    EVENTS_PER_CONTACT,
    JOINT_INTS,
    JOINT_REALS,
    SIDE_INTS,
    SYSTEM,
    TANGENTS,
)
from pincontact.workspace import Workspace


def made_system(nc, ng=0, nr=0, nv=5, nq=None, rng=None):
    """A workspace of nc contacts, ng joint coordinates with limits and nr resistances, with all arrays of one
    evaluation: of random numbers, or zeros, and a chain's mass matrix, factored."""
    system, n = Workspace(SYSTEM), nc + ng + nr
    nq = nv if nq is None else nq
    for name in ("sizes", "scalars", "counters"):
        system.zeros(name)
    system.sizes["nq"], system.sizes["nv"], system.sizes["nc"] = nq, nv, nc
    system.zeros("joint_count", 1)[0], system.zeros("resistance_count", 1)[0] = ng, nr
    for name, shape in (
        ("contact_int", (n, CONTACT_INTS)), ("contact_real", (n, CONTACT_REALS)),
        ("joint_int", (max(ng, 1), JOINT_INTS)), ("joint_real", (max(ng, 1), JOINT_REALS)),
        ("row_index", (3 * n, 2)), ("permutation", (3 * n,)), ("side_int", (2 * nc, SIDE_INTS)),
        ("support", (2 * nc, nv)), ("reference", (n, 3)), ("reference_start", (n, 3)),
        ("reference_slope", (2, 3 * n, nv)), ("location", (n, 4)), ("rates", (n, 4)),
    ):  # fmt: skip
        system.zeros(name, *shape)
    system.contact_int[:, TANGENTS] = 2
    for name, shape in (
        ("q", (nq,)), ("v", (nv,)), ("basis", (n, 3, 3)), ("slip", (n, 3)), ("gaps", (n, 2)), ("rows", (n, 3, nv)),
        ("bias", (n, 3)), ("correction_q", (nv,)), ("correction_v", (nv,)), ("multipliers", (3 * n,)),
        ("right_side", (3 * n,)), ("vectors", (16, 3)),
        ("whitened_rows", (3 * n, nv)), ("whitened_forces", (3 * n, nv)),
        ("delassus", (3 * n, 3 * n + 1)), ("constraint_rows", (3 * n + 1, 3 * n + 1)), ("frames", (2 * nc, 8, 3)),
        ("jacobian", (nv, 6)), ("derivatives", (2 * nc, DERIVATIVE_ROWS, 3)), ("force", (n, 3)), ("work", (nv,)),
        ("relative_acceleration", (n, 3)), ("event_functions", (n, EVENTS_PER_CONTACT)), ("acceleration", (nv,)),
        ("free_acceleration", (nv,)), ("location_system", (4, 8)),
    ):  # fmt: skip
        values = system.zeros(name, *shape)
        if rng is not None:
            values[:] = rng.normal(size=shape)
    factor = system.zeros("factor", nv, nv)
    factor[:] = np.eye(nv)
    if rng is not None:
        system.basis[:] = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(n)]
        system.basis[:, 2] *= np.linalg.det(system.basis)[:, None]
        factor[:] = np.tril(0.3 * rng.normal(size=(nv, nv)), -1) + np.diag(rng.uniform(0.5, 2.0, nv))
    system.zeros("parents", nv)[:] = np.arange(nv) - 1
    return system
