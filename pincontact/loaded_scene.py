"""What a scene file describes, ready to run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .arguments import time_step
from .display import Summary
from .errors import ArgumentError
from .scene import Scene
from .simulate import simulate
from .state import State

if TYPE_CHECKING:
    from .trajectory import Trajectory


# Options that time stepping does not use.
_EVENT_DRIVEN = ("rtol", "atol", "max_step", "first_step", "fixed_step")


@dataclass(frozen=True, eq=False, repr=False)
class LoadedScene(Summary):
    """What a scene file describes.

    Attributes
    ----------
    path : Path
        The file.
    scene : Scene
    state : State
        Ready for `simulate`.
    settings : dict
        The options of `simulate` that the file gives, outputs excepted.
    outputs : int or tuple of float, optional
        Number of equally spaced output times, or the times in s themselves; every step, if not given.
    """

    path: Path
    scene: Scene
    state: State
    settings: dict[str, Any]
    outputs: int | tuple[float, ...] | None = None

    def options(self, **changes: Any) -> dict[str, Any]:
        """Keyword arguments for `simulate`: the file's, with changes; t_eval follows from outputs and duration.

        Parameters
        ----------
        **changes : dict
            Arguments of `simulate`.

        Returns
        -------
        dict

        Raises
        ------
        ArgumentError
            Where neither the file nor the changes say the duration, or the changes give dt by both its names.
        """
        if "step" in changes:
            # in place of the file's, whatever its name there
            changes["dt"] = time_step(changes.get("dt"), changes.pop("step"))
        settings = self.settings
        if changes.get("method") == "Moreau":
            # what the file says of steps and tolerances is for its own method
            settings = {name: value for name, value in settings.items() if name not in _EVENT_DRIVEN}
        options = {**settings, **changes}
        if "duration" not in options:
            raise ArgumentError(f"{self.path}: simulation.duration is not in the file, and none was given")
        if "t_eval" not in options and self.outputs is not None:
            start, duration = self.state.t, options["duration"]
            if isinstance(self.outputs, int):
                options["t_eval"] = np.linspace(start, start + duration, self.outputs)
            else:
                # a shorter run than the file's keeps the outputs it reaches
                options["t_eval"] = [t for t in self.outputs if "duration" not in changes or t <= start + duration]
        return options

    def simulate(self, **changes: Any) -> Trajectory:
        """Run the scene with the file's settings.

        Parameters
        ----------
        **changes : dict
            Arguments of `pincontact.simulate` that replace the file's.

        Returns
        -------
        Trajectory

        Raises
        ------
        ArgumentError, StateError
            As `pincontact.simulate` does, and where neither the file nor the changes say the duration.
        """
        return simulate(self.scene, self.state, **self.options(**changes))
