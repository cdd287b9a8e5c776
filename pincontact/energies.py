"""Energies of a run, and what its works leave unexplained."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .display import Summary
from .errors import TrajectoryError


@dataclass(frozen=True, eq=False, repr=False)
class Energies(Summary):
    """Energies at every output; works are None unless the run recorded them.

    Works are counted from the state that the run started from, whether that is an output or not, and with what impacts
    took out of it there.

    Attributes
    ----------
    kinetic : (n,) array
        In J, with the rotors' (armature).
    potential : (n,) array
        In J.
    friction_work : (n,) array, optional
        Of contact forces on v_c, and of their impulses in impacts, in J.
    drive_work : (n,) array, optional
        Of contact forces on prescribed motions, in J.
    torque_work : (n,) array, optional
        Of the control's torques, in J.
    damping_work : (n,) array, optional
        Of joints' damping, dry friction and limits, in J.
    total_at_start : float, optional
        Kinetic and potential energy in J where works are zero.
    """

    kinetic: np.ndarray
    potential: np.ndarray
    friction_work: np.ndarray | None = None
    drive_work: np.ndarray | None = None
    torque_work: np.ndarray | None = None
    damping_work: np.ndarray | None = None
    total_at_start: float | None = None

    @property
    def total(self) -> np.ndarray:
        """Kinetic and potential energy, (n,), in J."""
        return self.kinetic + self.potential

    @property
    def balance(self) -> np.ndarray:
        """What the integration lost or won, (n,), in J: total - total_at_start - all works.

        Raises
        ------
        TrajectoryError
            Where the run did not record works.
        """
        works = (self.friction_work, self.drive_work, self.torque_work, self.damping_work)
        if self.total_at_start is None or any(w is None for w in works):
            raise TrajectoryError("the run did not record works: simulate(..., energies=True)")
        return self.total - self.total_at_start - sum(w for w in works if w is not None)
