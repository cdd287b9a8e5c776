"""The command line: `pincontact run scene.toml` and `pincontact info scene.toml`, or `python -m pincontact ...`.

Exit codes: 0 done, 1 the run could not finish, 2 bad input (said in one line on stderr), 130 interrupted.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from .display import EVENTS_SHOWN, MODE_NAMES, known_range
from .errors import ContactError
from .friction.laws import FrictionLaw
from .layout import FREE
from .loaded_scene import LoadedScene
from .scene_file import load_scene
from .simulate import simulate

if TYPE_CHECKING:
    from .contacts import AttachedContour, Contact
    from .state import Correction, State
    from .tracks import ContactTrack
    from .trajectory import Trajectory

# Exit codes; the last one is that of shells.
DONE, NOT_FINISHED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        loaded = load_scene(options.scene)
        code = _info(loaded) if options.command == "info" else _run(loaded, options)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        # who reads has seen enough, as `head` does; nothing more can be said, not even at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except KeyboardInterrupt:
        print("pincontact: interrupted.", file=sys.stderr)
        return INTERRUPTED
    except (ContactError, OSError) as error:
        text = " ".join(str(error).split())
        where = "" if options.scene in text else f"{options.scene}: "
        print(f"pincontact: {where}{text}", file=sys.stderr)
        return BAD_INPUT


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="pincontact", description="Simulate persistent point contacts.")
    parser.add_argument("--version", action="version", version=_versions())
    commands = parser.add_subparsers(dest="command", required=True, metavar="command")
    run = commands.add_parser("run", help="simulate a scene file and print a summary")
    run.add_argument("scene", help="scene file (.toml, .yaml)")
    run.add_argument("--duration", type=float, metavar="SECONDS", help="simulated time, instead of the file's")
    run.add_argument("--method", metavar="NAME", help="DOP853, Sharp98, RK45, RK23 or Moreau, instead of the file's")
    run.add_argument("--rtol", type=float, metavar="NUMBER", help="relative tolerance of a step")
    step = run.add_mutually_exclusive_group()
    step.add_argument("--dt", type=float, metavar="SECONDS", help="step of method Moreau")
    step.add_argument("--step", dest="dt", type=float, metavar="SECONDS", help="another name of --dt")
    run.add_argument("--html", metavar="FILE", help="write a replay as one HTML file")
    run.add_argument("--save", metavar="FILE", help="write the trajectory as an npz file")
    run.add_argument("--progress", action="store_true", help="show a bar over simulated time")
    info = commands.add_parser("info", help="print what a scene file contains")
    info.add_argument("scene", help="scene file (.toml, .yaml)")
    return parser


def _versions() -> str:
    from numba import __version__ as numba_version

    from . import __version__

    return f"pincontact {__version__} (pinocchio {pin.__version__}, numba {numba_version}, numpy {np.__version__})"


def _table(title: str, rows: Iterable[Mapping[str, Any]]) -> None:
    """A titled table, by heads of columns that are as wide as they need be; numbers with six digits."""
    listed = list(rows)
    if not listed:
        return
    cells = [list(listed[0]), *([_cell(value) for value in row.values()] for row in listed)]
    widths = [max(map(len, column)) for column in zip(*cells)]
    print(f"\n{title}")
    for row in cells:
        print("  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip())


def _cell(value: Any) -> str:
    if isinstance(value, (float, np.floating)):
        return f"{value:.6g}"
    if isinstance(value, (np.ndarray, tuple)):
        return " ".join(_cell(entry) for entry in value) or "-"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_cell(entry)}" for key, entry in value.items())
    return str(value)


# ---------------------------------------------------------------------------------------------------- run


def _run(loaded: LoadedScene, options: argparse.Namespace) -> int:
    changes: dict[str, Any] = {"progress": options.progress}
    for name in ("duration", "method", "rtol", "dt"):
        if getattr(options, name) is not None:
            changes[name] = getattr(options, name)
    for target in (options.html, options.save):
        # a long run must not end in a file that cannot be written
        if target is not None and not Path(target).resolve().parent.is_dir():
            raise FileNotFoundError(f"{target}: there is no folder {Path(target).parent}.")
    run = loaded.simulate(**changes)
    _summary(loaded, run)
    if options.save is not None:
        print(f"\nwrote {run.save(options.save)}")
    if options.html is not None and run.t.size:
        from .view.replay import export_html

        print(f"\nwrote {export_html(run, options.html, title=loaded.path.stem)}")
    if not run.success:
        print(f"pincontact: {loaded.path}: status {run.status}: {run.message}", file=sys.stderr)
        return NOT_FINISHED
    return DONE


def _summary(loaded: LoadedScene, run: Trajectory) -> None:
    stats = run.stats
    simulated = float(run.t[-1] - loaded.state.t) if run.t.size else 0.0
    wall = stats["wall_time"]
    rate = f", {simulated / wall:.4g} x real time" if wall > 0.0 else ""
    print(f"{loaded.path}: {simulated:.6g} s simulated in {wall:.4g} s{rate}")
    print(f"status {run.status}: {run.message}")
    _table("counts", ({"number": value, "of": key} for key, value in stats.items() if key != "wall_time"))
    shown = run.events[:EVENTS_SHOWN]
    _table("events", ({"t [s]": e.time, "contact": e.contact or "-", "kind": e.kind} for e in shown))
    if len(run.events) > len(shown):
        rest = Counter(event.kind for event in run.events[len(shown) :])
        print(f"  and {', '.join(f'{count} x {kind}' for kind, count in rest.items())}")
    if not run.t.size:
        return
    _table("contacts", (_contact_row(name, track) for name, track in run.contacts.items()))
    _residuals("worst residuals", run)
    energies = run.energies()
    rows = {"kinetic": energies.kinetic, "potential": energies.potential, "total": energies.total}
    if energies.friction_work is not None:
        rows |= {"friction work": energies.friction_work, "balance": energies.balance}
    _table("energies [J]", ({"of": name, "first": e[0], "last": e[-1]} for name, e in rows.items()))


def _residuals(title: str, run: Trajectory) -> None:
    _table(title, ({"of": kind, "relative": f"{values.max():.1e}"} for kind, values in run.residuals().items()))


def _contact_row(name: str, track: ContactTrack) -> dict[str, Any]:
    modes = Counter(int(mode) for mode in track.mode)
    shares = ", ".join(
        f"{MODE_NAMES[mode]} {100.0 * count / track.mode.size:.0f} %" for mode, count in modes.most_common()
    )
    slip = float(np.fmax.reduce(np.linalg.norm(track.slip_velocity[track.mode != FREE], axis=1), initial=0.0))
    return {
        "name": name,
        "modes": shares,
        "normal force [N]": known_range(track.normal_force, ".6g"),
        "largest slip [m/s]": slip,
    }


# ---------------------------------------------------------------------------------------------------- info


def _info(loaded: LoadedScene) -> int:
    scene, state = loaded.scene, loaded.state
    model = scene.model
    print(
        f"{loaded.path}: {model.name}, nq {model.nq}, nv {model.nv}, {len(scene.contours)} contours, "
        f"{len(scene.contacts)} contacts"
    )
    joints = zip(model.names, model.joints, model.parents, model.inertias)
    _table(
        "bodies",
        (
            {
                "joint": name,
                "type": joint.shortname(),
                "parent": model.names[parent],
                "q": _range(joint.idx_q, joint.nq),
                "v": _range(joint.idx_v, joint.nv),
                "mass [kg]": inertia.mass,
            }
            for name, joint, parent, inertia in list(joints)[1:]
        ),
    )
    _table("contours", (_contour_row(c) for c in scene.contours.values()))
    _table("contacts", (_contact_data(c) for c in scene.contacts.values()))
    if scene.contacts:
        print(
            "\n  m equations, k location parameters, GC = m - k geometric and VC velocity constraints where it sticks"
        )
    given = state.correction
    if given is not None and scene.contacts:
        _table("initial state as given", (_given_row(state, given, name) for name in given.gaps))
        print(f"\n  made consistent by at most {given.dq:.3g} in q (m, rad) and {given.dv:.3g} in v (m/s, rad/s)")
    # what the friction laws decide at the start takes one evaluation: a run without duration
    start = simulate(scene, state, 0.0)
    if start.t.size:
        _table("initial state", (_start_row(name, track.at(0)) for name, track in start.contacts.items()))
        if scene.contacts:
            _residuals("residuals", start)
    if not start.success:
        print(f"pincontact: {loaded.path}: status {start.status}: {start.message}", file=sys.stderr)
        return NOT_FINISHED
    return DONE


def _given_row(state: State, given: Correction, name: str) -> dict[str, Any]:
    normal, tangential = given.slips[name]
    speeds = {"normal v_c [m/s]": normal, "tangential v_c [m/s]": tangential}
    found = len((state.candidates or {}).get(name, ()))
    return {"contact": name, "gap [m]": given.gaps[name], **speeds, "contact points found": found}


def _start_row(name: str, contact: ContactTrack) -> dict[str, Any]:
    places = {"location of first": contact.location_first, "of second": contact.location_second}
    force = {"conditioning": contact.conditioning, "normal force [N]": contact.normal_force}
    return {"contact": name, **places, "mode": MODE_NAMES[int(contact.mode)], **force}


def _range(start: int, size: int) -> str:
    """Where a joint's numbers are in q or v, as Python writes slices."""
    return str(start) if size == 1 else f"{start}:{start + size}"


def _contour_row(attached: AttachedContour) -> dict[str, Any]:
    contour = attached.contour
    kind = {"name": attached.name, "kind": contour.name, "frame": attached.frame}
    return {**kind, "parameters": contour.dimension, "domain": contour.domain}


def _contact_data(contact: Contact) -> dict[str, Any]:
    pattern, named = contact.pattern, {"name": contact.name, "first": contact.first.name, "second": contact.second.name}
    numbers = {"m": pattern.equations, "k": pattern.parameters, "GC": pattern.constraints, "VC": pattern.tangents}
    law = {"friction": _friction(contact.friction), "bilateral": contact.bilateral}
    return {**named, "pattern": pattern.name, **numbers, **law}


# How parameters of friction laws are called, where not by their names, and their units.
_LABELS = {"mu_static": "static"}
_UNITS = {"speed": " m/s", "viscous": " N s/m", "spinning": " m", "rolling": " m"}


def _friction(law: FrictionLaw | None) -> str:
    if law is None:
        return "none"
    parts = ["no slip"] if math.isinf(law.sliding) else []
    given = {name: value for name, value in vars(law).items() if name == "mu" or value not in (None, 0.0)}
    parts += [f"{_LABELS.get(name, name)} {_number(value)}{_UNITS.get(name, '')}" for name, value in given.items()]
    return ", ".join(parts) or type(law).__name__


def _number(value: float | tuple[float, float] | str) -> str:
    """A number, two of two directions, or a contour's name."""
    if isinstance(value, str):
        return repr(value)
    return " x ".join(f"{number:g}" for number in (value if isinstance(value, tuple) else (value,)))


if __name__ == "__main__":
    sys.exit(main())
