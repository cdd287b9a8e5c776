"""Persistent point contacts for Pinocchio: rolling, sliding and higher pairs, exact and fast."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .analysis.kinematics import ContactKinematics as ContactKinematics
from .analysis.kinematics import analyze as analyze
from .contacts import AttachedContour as AttachedContour
from .contacts import Contact as Contact
from .contours import *  # noqa: F403
from .errors import ArgumentError as ArgumentError
from .errors import ContactError as ContactError
from .errors import ContourError as ContourError
from .errors import FrictionError as FrictionError
from .errors import InfeasibleError as InfeasibleError
from .errors import MissingExtraError as MissingExtraError
from .errors import ModelError as ModelError
from .errors import NoContactError as NoContactError
from .errors import PatternError as PatternError
from .errors import SceneFileError as SceneFileError
from .errors import SingularContactError as SingularContactError
from .errors import SolverError as SolverError
from .errors import StateError as StateError
from .errors import TrajectoryError as TrajectoryError
from .friction.centred import centred_forces as centred_forces
from .friction.laws import Coulomb as Coulomb
from .friction.laws import FrictionLaw as FrictionLaw
from .friction.laws import NoSlip as NoSlip
from .friction.laws import Stribeck as Stribeck
from .friction.solve import ContactSolution as ContactSolution
from .friction.solve import solve_contacts as solve_contacts
from .integration.results import Event as Event
from .loaded_scene import LoadedScene as LoadedScene
from .scene import Scene as Scene
from .scene_file import load_scene as load_scene
from .simulate import simulate as simulate
from .state import State as State
from .trajectory import ContactTrack as ContactTrack
from .trajectory import Trajectory as Trajectory

if TYPE_CHECKING:
    from .analysis.equilibrium import SteadyMotion as SteadyMotion
    from .analysis.equilibrium import find_equilibrium as find_equilibrium
    from .analysis.equilibrium import find_steady_motion as find_steady_motion
    from .analysis.farkas import FarkasCertificate as FarkasCertificate
    from .analysis.forces import external_forces as external_forces
    from .analysis.inverse import InverseDynamics as InverseDynamics
    from .analysis.inverse import inverse_dynamics as inverse_dynamics
    from .analysis.linearize import Linearization as Linearization
    from .analysis.linearize import linearize as linearize
    from .analysis.sweep import sweep as sweep
    from .analysis.sweep_table import SweepTable as SweepTable
    from .rollouts import rollout as rollout
    from .stepper import Stepper as Stepper
    from .view.recording import export_rerun as export_rerun
    from .view.replay import export_html as export_html
    from .view.replay import replay as replay

__version__ = "0.1.0"

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

# What has been imported from modules of the package, and what will be.
__all__ = sorted(
    _LAZY.keys() | {name for name, thing in globals().items() if getattr(thing, "__module__", "").startswith(__name__)}
)


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        from importlib import import_module

        value = globals()[name] = getattr(import_module(f".{_LAZY[name]}", __name__), name)
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}.")
