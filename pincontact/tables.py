"""A run as another package's table: xarray's Dataset, pandas' DataFrame."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .extras import required
from .tracks import is_bare

if TYPE_CHECKING:
    import pandas
    import pinocchio as pin
    import xarray

    from .trajectory import Trajectory

_AXES = ("x", "y", "z")
# name in a track -> names of its further dimensions, unit, what it is
_OF_CONTACTS: dict[str, tuple[tuple[str, ...], str, str]] = {
    "mode": ((), "1", "-1 open, 0 frictionless, 1 stick, 2 slip"),
    "gap": ((), "m", "gap, positive when apart"),
    "point": (("axis",), "m", "contact point, world axes"),
    "force": (("axis",), "N", "force on the second contour named, world axes"),
    "normal_force": ((), "N", "normal force, positive in compression"),
    "tangential_force": ((), "N", "length of the tangential force"),
    "slip_velocity": (("axis",), "m/s", "velocity of the second contour's material point against the first's"),
    "multipliers": (("direction",), "N", "components of the force in the dual frame, F_j = e_j . F"),
    "frame": (("axis", "direction"), "1", "e_1, e_2, e_3 in world axes"),
    "dual_frame": (("axis", "direction"), "1", "m^1, m^2, m^3 in world axes"),
    "location_first": (("parameter",), "", "location parameters on the first contour named, NaN beyond its own"),
    "location_second": (("parameter",), "", "location parameters on the second contour named, NaN beyond its own"),
    "conditioning": ((), "1", "conditioning of the location equations, 1 good, 0 singular"),
}


def run_to_xarray(run: Trajectory) -> xarray.Dataset:
    """See `Trajectory.to_xarray`."""
    package = required("xarray", "a Dataset needs xarray", "pincontact[data]")
    names = list(run.contacts)
    variables: dict[str, Any] = {
        "q": (("t", "position"), run.q, {"long_name": "configuration, as Pinocchio's"}),
        "v": (("t", "velocity"), run.v, {"long_name": "velocity, as Pinocchio's"}),
    }
    coordinates: dict[str, Any] = {
        "t": ("t", run.t, {"units": "s"}),
        "position": ("position", _coordinate_names(run, "q")),
        "velocity": ("velocity", _coordinate_names(run, "v")),
    }
    if names:
        coordinates |= {
            "contact": ("contact", names),
            "axis": ("axis", list(_AXES)),
            "direction": ("direction", [1, 2, 3]),
        }
    for key, (inner, unit, text) in _OF_CONTACTS.items() if names else ():
        columns = [getattr(run.contacts[name], key) for name in names]
        if "parameter" in inner:
            columns = [np.pad(a, ((0, 0), (0, 2 - a.shape[1])), constant_values=np.nan) for a in columns]
        attributes = {"long_name": text} | ({"units": unit} if unit else {})
        variables[key] = (("t", "contact", *inner), np.stack(columns, axis=1), attributes)
    energies = None if is_bare(run) else run.energies()
    for key, values in vars(energies).items() if energies is not None else ():
        if isinstance(values, np.ndarray):
            variables[key] = (("t",), values, {"units": "J"})
    return package.Dataset(variables, coordinates, {"status": run.status, "message": run.message})


def run_to_pandas(run: Trajectory) -> pandas.DataFrame:
    """See `Trajectory.to_pandas`."""
    package = required("pandas", "a DataFrame needs pandas", "pincontact[data]")
    columns: dict[str, np.ndarray] = {}
    for kind, rows in (("q", run.q), ("v", run.v)):
        for i, name in enumerate(_coordinate_names(run, kind)):
            columns[f"{kind}.{name}"] = rows[:, i]
    suffixes = {"axis": _AXES, "direction": ("1", "2", "3"), "parameter": ("1", "2")}
    for name in run.contacts:
        for key, (inner, _, _) in _OF_CONTACTS.items():
            values = getattr(run.contacts[name], key)
            if len(inner) == 0:
                columns[f"{name}.{key}"] = values
            elif len(inner) == 1:
                for i, suffix in zip(range(values.shape[1]), suffixes[inner[0]]):
                    columns[f"{name}.{key}.{suffix}"] = values[:, i]
    return package.DataFrame(columns, index=package.Index(run.t, name="t"))


def _coordinate_names(run: Trajectory, kind: str) -> list[str]:
    """Names of the entries of q or v: the joint's, with an index where it has several."""
    if is_bare(run):
        return [str(i) for i in range((run.q if kind == "q" else run.v).shape[1])]
    model: pin.Model = run.scene.model
    names = []
    for joint, name in list(zip(model.joints, model.names))[1:]:
        size = joint.nq if kind == "q" else joint.nv
        names += [name] if size == 1 else [f"{name}[{i}]" for i in range(size)]
    return names
