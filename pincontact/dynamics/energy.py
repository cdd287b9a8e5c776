"""Energy of a motion, and the rule by which impacts create none, for both methods.

Newton's restitution demands a rebound -e w_n at every contact that closes; where contacts, or a contact's normal and
tangent, are coupled, that and Coulomb's law together may do positive work (Kane's paradox). The work of impulses P that
take the relative velocity from w- to w+ is P . (w- + w+) / 2, summed over all contacts of the impact. Where that is
positive, all coefficients are multiplied by the largest common factor for which it is not; without restitution it never
is.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

# Work above this fraction of the sizes of its terms counts as positive; accuracy of the factor in time stepping.
ENERGY_SLACK = 1e-9
KEPT_ACCURACY = 1e-3
# Slower than this, in m/s, nothing rebounds, and what is closed at the start of a run and comes in does not collide.
REST_SPEED = 1e-3
# Of energies this part is round-off.
_ROUND_OFF = 1e-14
# So many states of a run are enough to see whether its energy grows.
_LOOKED_AT = 64


def energies_at(model: pin.Model, q: np.ndarray, v: np.ndarray, data: pin.Data | None = None) -> tuple[float, float]:
    """Kinetic and potential energy in J; the former with the rotors' (armature), the latter zero at the world's origin.

    The kinetic energy is v . M v / 2: `pin.computeKineticEnergy` leaves out the rotors of unaligned revolute and
    helical joints.
    """
    data = model.createData() if data is None else data
    # of M the upper triangle is what Pinocchio promises
    mass = np.triu(pin.crba(model, data, q))
    kinetic = float(v @ mass @ v - 0.5 * (v * v) @ mass.diagonal())
    return kinetic, float(pin.computePotentialEnergy(model, data, q))


def energy_gained(model: pin.Model, q: np.ndarray, v: np.ndarray) -> float:
    """Largest gain of total energy in J between two of at most `_LOOKED_AT` states, rows of q and v in time order, over
    the largest kinetic energy of these and the range of the total."""
    rows = np.unique(np.linspace(0, len(q) - 1, min(len(q), _LOOKED_AT)).astype(int))
    data = model.createData()
    found = np.array([energies_at(model, q[i], v[i], data) for i in rows]).reshape(-1, 2)
    total = found.sum(axis=1)
    # sums of many terms, of which a few last digits are round-off
    known = _ROUND_OFF * float(np.abs(found).max(initial=0.0))
    gained = max(float((total - np.minimum.accumulate(total)).max(initial=0.0)) - known, 0.0)
    scale = float(found[:, 0].max(initial=0.0) + np.ptp(total)) if rows.size else 0.0
    return gained / scale if scale > 0.0 else 0.0
