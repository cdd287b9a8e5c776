"""Quadratic programs solved in examples, README scripts and scenes, and what each was for.

Runs examples, the README's scripts, scene files and the reference scenes of the tests with friction, each with
contact_solver="auto" and "proxqp", and prints a table from `run.stats`: cone problems, ProxQP programs, iterations and
problems that these left, apart for runs between events (accelerations and impacts when modes change) and time stepping
(a problem a step). A second table has the programs of `inverse_dynamics` by what they were for, which are the same with
either contact solver.

    python examples/benchmarks/count_programs.py [names that are run, such as rover README]
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import io
import os
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pincontact as pc

ROOT = Path(__file__).resolve().parents[2]
STATISTICS = ("cone_problems", "qp", "qp_iterations", "qp_failures")
PURPOSES = {True: "steps", False: "changes of modes"}
INVERSE = "inverse dynamics"
LEVELS = ("accelerations", "efforts", "forces", "certificate")


@contextlib.contextmanager
def choice(contact_solver: str) -> Iterator[dict[str, Counter[str]]]:
    """Let `pc.simulate` use this contact solver, and add up its statistics by what problems are for, and those of
    `pc.inverse_dynamics`."""
    counts: dict[str, Counter[str]] = {purpose: Counter() for purpose in (*PURPOSES.values(), INVERSE)}
    simulate, inverse_dynamics = pc.simulate, pc.inverse_dynamics

    def counted(*given: Any, **options: Any) -> pc.Trajectory:
        run = simulate(*given, **{"contact_solver": contact_solver} | options)
        count = counts[PURPOSES[options.get("method") == "Moreau"]]
        count["runs"] += 1
        for name in STATISTICS:
            count[name] += run.stats[name]
        return run

    def counted_inverse(*given: Any, **options: Any) -> pc.InverseDynamics:
        found = inverse_dynamics(*given, **options)
        if found.programs:
            counts[INVERSE].update(found.programs | {"calls": 1})
        return found

    pc.simulate, pc.inverse_dynamics = counted, counted_inverse
    try:
        yield counts
    finally:
        pc.simulate, pc.inverse_dynamics = simulate, inverse_dynamics


def example(path: Path) -> Callable[[], object]:
    """What runs an example's `main`."""
    specification = importlib.util.spec_from_file_location(path.stem, path)
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    main: Callable[[], object] = module.main
    return main


def readme() -> None:
    """The README's scripts."""
    for text in re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(), flags=re.DOTALL | re.MULTILINE):
        # they name files below this folder
        text = re.sub(r'"(urdf|examples)/', rf'"{ROOT}/\1/', text)
        exec(compile(text, "README.md", "exec"), {"__name__": "readme"})


def scene_files() -> None:
    """The scene files of the gallery."""
    for path in sorted((ROOT / "examples" / "scenes").glob("*.toml")):
        loaded = pc.load_scene(path)
        pc.simulate(loaded.scene, loaded.state, **loaded.options())


def references(method: str) -> None:
    """The reference scenes with friction."""
    import reference

    for name in reference.NAMES:
        scene, state = reference.build(name)
        if any(contact.friction is not None for contact in scene.contacts.values()):
            pc.simulate(scene, state, float(reference.reference(name)["t"][-1]), method=method)


def sources() -> dict[str, Callable[[], object]]:
    """What can be run, by name."""
    sys.path[:0] = [str(ROOT / "examples"), str(ROOT / "tests")]
    found: dict[str, Callable[[], object]] = {}
    for path in sorted((ROOT / "examples").glob("*.py")):
        if "def main(" in path.read_text() and path.stem != "gallery":
            found[path.stem] = lambda path=path: example(path)()
    found |= {"README": readme, "scene files": scene_files}
    found["reference scenes, DOP853"] = lambda: references("DOP853")
    found["reference scenes, Moreau"] = lambda: references("Moreau")
    return found


def main(names: list[str] | None = None) -> dict[tuple[str, str, str], Counter[str]]:
    """Prints a row for each source, contact solver and purpose with cone problems; the counts by these."""
    known, found = sources(), {}
    print("| source | contact solver | for | runs | cone problems | programs | iterations | left |")
    print("|---|---|---|---:|---:|---:|---:|---:|")
    total: dict[tuple[str, str], Counter[str]] = {}
    for name in names or list(known):
        for contact_solver in ("auto", "proxqp"):
            with choice(contact_solver) as counts, contextlib.redirect_stdout(io.StringIO()):
                try:
                    known[name]()
                except (Exception, SystemExit) as error:
                    print(f"{name} does not run here: {error}", file=sys.stderr)
            inverse = counts.pop(INVERSE)
            if inverse["calls"] and contact_solver == "auto":
                found[name, contact_solver, INVERSE] = inverse
            for purpose, count in counts.items():
                found[name, contact_solver, purpose] = count
                total.setdefault((contact_solver, purpose), Counter()).update(count)
                if count["cone_problems"]:
                    print_row((name, f'`"{contact_solver}"`', purpose), count, ("runs", *STATISTICS))
    for (contact_solver, purpose), count in total.items():
        print_row(("all", f'`"{contact_solver}"`', purpose), count, ("runs", *STATISTICS))
    print(f"\n| source | calls of inverse dynamics | programs for {' | '.join(LEVELS)} |")
    print("|---|" + "---:|" * (1 + len(LEVELS)))
    for (name, _, purpose), count in found.items():
        if purpose == INVERSE:
            print_row((name,), count, ("calls", *LEVELS))
    return found


def print_row(titles: tuple[str, ...], count: Counter[str], keys: tuple[str, ...]) -> None:
    """One row of a table."""
    print("| " + " | ".join([*titles, *(str(count[key]) for key in keys)]) + " |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="of examples, README, scene files, ...; all if none is given")
    arguments = parser.parse_args()
    known_names = list(sources())
    if unknown := [name for name in arguments.names if name not in known_names]:
        parser.error(f"unknown: {unknown}; known: {known_names}")
    with tempfile.TemporaryDirectory() as folder:
        # scripts save files where they run
        os.chdir(folder)
        main(arguments.names)
