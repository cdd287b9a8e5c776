"""Persistent point contacts for Pinocchio: rolling, sliding and higher pairs, exact and fast."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .analysis.kinematics import ContactKinematics, analyze
from .contacts import AttachedContour, Contact
from .contours import *  # noqa: F403
from .contours import __all__ as _contours
from .errors import (
    ArgumentError,
    ContactError,
    ContourError,
    FrictionError,
    InfeasibleError,
    MissingExtraError,
    ModelError,
    NoContactError,
    PatternError,
    SceneFileError,
    SingularContactError,
    SolverError,
    StateError,
    TrajectoryError,
)
from .friction.centred import centred_forces
from .friction.laws import Coulomb, FrictionLaw, NoSlip, Stribeck
from .friction.solve import ContactSolution, solve_contacts
from .integration.results import Event
from .loaded_scene import LoadedScene
from .scene import Scene
from .scene_file import load_scene
from .simulate import simulate
from .state import State
from .trajectory import ContactTrack, Trajectory

if TYPE_CHECKING:
    from .analysis.equilibrium import SteadyMotion, find_equilibrium, find_steady_motion
    from .analysis.farkas import FarkasCertificate
    from .analysis.forces import external_forces
    from .analysis.inverse import InverseDynamics, inverse_dynamics
    from .analysis.linearize import Linearization, linearize
    from .analysis.sweep import sweep
    from .analysis.sweep_table import SweepTable
    from .rollouts import rollout
    from .stepper import Stepper
    from .view.recording import export_rerun
    from .view.replay import export_html, replay

__version__ = "0.1.0"

__all__ = [
    "ArgumentError",
    "AttachedContour",
    "Contact",
    "ContactError",
    "ContactKinematics",
    "ContactSolution",
    "ContactTrack",
    "ContourError",
    "Coulomb",
    "Event",
    "FarkasCertificate",
    "FrictionError",
    "FrictionLaw",
    "InfeasibleError",
    "InverseDynamics",
    "Linearization",
    "LoadedScene",
    "MissingExtraError",
    "ModelError",
    "NoContactError",
    "NoSlip",
    "PatternError",
    "Scene",
    "SceneFileError",
    "SingularContactError",
    "SolverError",
    "State",
    "StateError",
    "SteadyMotion",
    "Stepper",
    "Stribeck",
    "SweepTable",
    "Trajectory",
    "TrajectoryError",
    "analyze",
    "centred_forces",
    "export_html",
    "export_rerun",
    "external_forces",
    "find_equilibrium",
    "find_steady_motion",
    "inverse_dynamics",
    "linearize",
    "load_scene",
    "replay",
    "rollout",
    "simulate",
    "solve_contacts",
    "sweep",
    *_contours,
]

# Imported when first used: Meshcat costs more than everything else together, the stepper has kernels of its own.
_LAZY = {
    "FarkasCertificate": "analysis.farkas",
    "InverseDynamics": "analysis.inverse",
    "Linearization": "analysis.linearize",
    "SteadyMotion": "analysis.equilibrium",
    "Stepper": "stepper",
    "export_html": "view.replay",
    "export_rerun": "view.recording",
    "external_forces": "analysis.forces",
    "find_equilibrium": "analysis.equilibrium",
    "find_steady_motion": "analysis.equilibrium",
    "inverse_dynamics": "analysis.inverse",
    "linearize": "analysis.linearize",
    "replay": "view.replay",
    "rollout": "rollouts",
    "SweepTable": "analysis.sweep_table",
    "sweep": "analysis.sweep",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        from importlib import import_module

        value = globals()[name] = getattr(import_module(f".{_LAZY[name]}", __name__), name)
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}.")
