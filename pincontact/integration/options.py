"""What a user may ask of the steps and outputs of an event-driven run."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..dynamics.system import System
from .pieces import Pieces


@dataclass
class Options:
    """Step-size and output options of a run.

    t_eval: output times in s, None for every accepted step; breakpoints: times in s, in order within the run, at which
    steps end and modes are decided anew; discrete: of a system, the discrete part of its contacts; None where
    `Driver.good` is not to be kept; pieces: keeps the interpolants of all steps, None where they are not wanted.
    """

    t_eval: np.ndarray | None = None
    max_step: float = math.inf
    max_steps: int = 1_000_000
    fixed_step: float | None = None
    first_step: float | None = None
    breakpoints: Sequence[float] = ()
    discrete: Callable[[System], np.ndarray] | None = None
    pieces: Pieces | None = None
