"""Run time against error: pincontact's methods and other engines on the same scenes, in one run.

    python examples/benchmarks/work_precision.py [--scenes smooth|events|NAME,...] [--peers NAME,...|none]
        [--output DIR] [--quick] [--readme]

Every engine gets the same mechanism, the same consistent start and the same output times; a figure is the median of
several whole runs, with compilation and the first run left out. The error is the largest distance in m of a marked
point from a reference (a closed form, or pincontact's own converged solution, and then it says so) over all output
times. Peers that are installed (the extra `bench`) run in processes of their own, one after the other, with settings
chosen in their favour; what one cannot express is left out and the reason printed. A fixed piece of
work is timed before and after every run; all times but those in the CSV are scaled to its median, so that a machine
whose speed changes favours nobody. Writes a table, work_precision.csv and one figure a scene to DIR; --readme also
writes the README's figures and its sections between two marks: that of the smooth scenes, that of the scenes of many
events, or both.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import platform
import queue
import re
import statistics
import subprocess
import sys
import tempfile
import textwrap
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from peers import PEERS  # noqa: E402
from peers.event_scenes import EVENT_SCENES  # noqa: E402
from peers.measure import QUICK, Effort, Row, largest_distance, measure, pace  # noqa: E402
from peers.problem import Problem  # noqa: E402
from peers.scenes import SCENES, SMOOTH_SCENES  # noqa: E402
from peers.with_pincontact import ENGINE as OURS  # noqa: E402
from peers.with_pincontact import consistent, reference  # noqa: E402

ROOT = HERE.parents[1]
FIGURES = ROOT / "pincontact" / "docs" / "figures"
MARKS = ("<!-- work-precision: begin -->", "<!-- work-precision: end -->")
EVENT_MARKS = ("<!-- work-precision, events: begin -->", "<!-- work-precision, events: end -->")
# what the README has a section of
GROUPS = {"smooth": (SMOOTH_SCENES, MARKS), "events": (EVENT_SCENES, EVENT_MARKS)}
LEVELS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10)
# a peer that hangs must not hang the benchmark; what it had done by then is kept
PATIENCE = 90.0
COLOURS = {
    "pincontact": "#c1272d",
    "MuJoCo": "#1f77b4",
    "Drake": "#7f7f7f",
    "Exudyn": "#2ca02c",
    "Jiminy": "#ff9d1e",
    "Pinocchio": "#9467bd",
}
OUR_MARKS = {"DOP853": "o-", "Sharp98": "D-", "RK45": "s--", "RK23": "v-.", "Moreau": "^:", "Stepper": "s:"}


@dataclass
class Result:
    """Everything of one run."""

    problems: dict[str, Problem] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)  # where the references are from, and how sure they are
    reach: dict[str, float] = field(default_factory=dict)  # largest distance in m of any marker from where it started
    # pin.aba on one free body over the fixed piece of work, each time it was looked at
    aba: list[float] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    versions: dict[str, str] = field(default_factory=dict)
    settings: dict[str, dict[str, str]] = field(default_factory=dict)
    left_out: list[tuple[str, str | None, str]] = field(default_factory=list)


def aba_time(batches: int = 7, calls: int = 4000) -> float:
    """Seconds of `pin.aba` on one free body: the unit in which machines can be compared."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag([0.02, 0.03, 0.04])), pin.SE3.Identity())
    data, q, zero = model.createData(), pin.neutral(model), np.zeros(6)
    times = []
    for _ in range(batches):
        began = time.perf_counter()
        for _ in range(calls):
            pin.aba(model, data, q, zero, zero)
        times.append((time.perf_counter() - began) / calls)
    return statistics.median(times)


def run_ours(result: Result, name: str, quick: bool, folder: Path) -> Path:
    """The reference of a scene and pincontact's own rows; returns the file that tells the peers what to do."""
    problem = consistent(SCENES[name]())
    expected, source, sure = reference(problem)
    result.problems[name] = problem
    result.reach[name] = largest_distance(np.broadcast_to(expected[:1], expected.shape), expected)
    result.sources[name] = f"{source} to {sure:.0e} m"
    result.aba.append(aba_time() / pace())
    result.rows += measure(OURS, problem, expected, QUICK if quick else Effort())
    result.versions[OURS.name], result.settings[OURS.name] = OURS.version(), OURS.settings
    file = folder / f"{name}.npz"
    np.savez(file, q=problem.q, v=problem.v, x=expected)
    return file


class PeerProcess:
    """A peer in a process of its own, which waits for its turn.

    Their libraries clash with each other's, and one that crashes or hangs must not take the benchmark with it.
    """

    def __init__(self, peer: str, quick: bool, folder: Path) -> None:
        self.name = peer
        command = [sys.executable, "-m", "peers.worker", peer, *(["--quick"] if quick else [])]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(HERE), *_search_path()])}
        self.errors = open(folder / f"{peer}.txt", "w+")  # noqa: SIM115  (closed with the process)
        self.process = subprocess.Popen(
            command,
            cwd=folder,
            env=environment,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
        )
        self.answers: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.answers.put(line)
        self.answers.put(None)

    def _answer(self) -> dict[str, Any]:
        """The next answer; of kind "absent" if there is none."""
        try:
            line = self.answers.get(timeout=PATIENCE)
        except queue.Empty:
            self.process.kill()
            return {"kind": "absent", "reason": f"stopped after {PATIENCE:.0f} s without an answer"}
        if line is None:
            self.errors.seek(0)
            return {"kind": "absent", "reason": f"its process ended: {self.errors.read()[-200:]!r}"}
        return json.loads(line)

    def introduce(self, result: Result) -> bool:
        """Wait until it is ready; False if the engine is not there."""
        entry = self._answer()
        if entry["kind"] != "engine":
            result.left_out.append((self.name, None, entry["reason"]))
            return False
        self.name = entry["name"]
        result.versions[self.name], result.settings[self.name] = entry["version"], entry["settings"]
        return True

    def run(self, result: Result, scene: str, file: Path) -> bool:
        """Its rows of a scene; False if it did not survive."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{scene} {file}\n")
        self.process.stdin.flush()
        while (entry := self._answer())["kind"] != "done":
            kind = entry.pop("kind")
            if kind == "row":
                result.rows.append(Row(**entry))
            else:
                result.left_out.append((self.name, scene, entry["reason"]))
                if kind == "absent":
                    return False
        return True

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        try:
            self.process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
        self.errors.close()


def run_all(names: list[str], peers: list[str], quick: bool) -> Result:
    """Scene by scene, so that what is compared was measured within the same minute."""
    result = Result()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        started = [PeerProcess(peer, quick, folder) for peer in peers]
        try:
            alive = [peer for peer in started if peer.introduce(result)]
            for name in names:
                began = time.perf_counter()
                file = run_ours(result, name, quick, folder)
                alive = [peer for peer in alive if peer.run(result, name, file)]
                print(f"{name}: {time.perf_counter() - began:.0f} s", file=sys.stderr)
        finally:
            for peer in started:
                peer.close()
    return result


def _search_path() -> list[str]:
    return [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]


# ---------------------------------------------------------------------------------------------------- results


def usual_pace(result: Result) -> float:
    """Median time in s of the fixed piece of work."""
    return statistics.median(row.pace for row in result.rows if math.isfinite(row.pace))


def usual_aba(result: Result) -> float:
    """What pin.aba on one free body takes at that pace, in us."""
    return 1e6 * statistics.median(result.aba) * usual_pace(result)


def evened(result: Result) -> list[Row]:
    """The rows as if the machine had always had its usual pace."""
    usual = usual_pace(result)
    return [replace(row, seconds=row.seconds * usual / row.pace, pace=usual) for row in result.rows]


def fastest(rows: list[Row], level: float) -> Row | None:
    """The quickest run with an error of at most the level."""
    good = [row for row in rows if row.error <= level]
    return min(good, key=lambda row: row.seconds) if good else None


def front(rows: list[Row]) -> list[Row]:
    """Runs that no other run beats in both time and error, by time."""
    best, out = math.inf, []
    for row in sorted((r for r in rows if math.isfinite(r.error)), key=lambda r: (r.seconds, r.error)):
        if row.error < best:
            best = row.error
            out.append(row)
    return out


def by_engine(result: Result, scene: str) -> dict[str, list[Row]]:
    rows: dict[str, list[Row]] = {}
    for row in result.rows:
        if row.scene == scene:
            rows.setdefault(row.engine, []).append(row)
    return rows


def milliseconds(seconds: float) -> str:
    return f"{seconds * 1e3:.3g}" if seconds < 1.0 else f"{seconds * 1e3:.0f}"


def print_tables(result: Result) -> None:
    for name, problem in result.problems.items():
        print(f"\n{problem.title} ({name}), {problem.duration:g} s; error: {problem.measured}")
        print(f"reference: {result.sources[name]}; pin.aba on one free body: {usual_aba(result):.2f} us")
        print(f"{'engine':11s} {'method':18s} {'setting':40s} {'ms':>9s} {'error':>9s} {'steps':>8s} {'evals':>8s}")
        for rows in by_engine(result, name).values():
            for row in rows:
                steps, calls = ("" if n is None else str(n) for n in (row.steps, row.evaluations))
                print(
                    f"{row.engine:11s} {row.method:18s} {row.setting:40s} {row.seconds * 1e3:9.2f} {row.error:9.1e} "
                    f"{steps:>8s} {calls:>8s} {row.note}"
                )
    print("\nLeft out:" if result.left_out else "")
    for engine, scene, reason in result.left_out:
        print(f"  {engine} on {scene or 'everything'}: {reason}")
    print("\nSettings:")
    for engine, methods in result.settings.items():
        print(f"  {engine} {result.versions[engine]}")
        for method, text in methods.items():
            print(f"    {method}: {text}")


def write_csv(result: Result, file: Path) -> None:
    with open(file, "w", newline="") as stream:
        writer = csv.writer(stream)
        names = [f.name for f in fields(Row)]
        writer.writerow(names)
        for row in result.rows:
            values = asdict(row)
            writer.writerow([values[n] for n in names])


def draw(result: Result, folder: Path) -> None:
    """One figure a scene: each of our methods, and of each peer the runs that none of its others beats."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    for name, problem in result.problems.items():
        figure, axes = plt.subplots(figsize=(5.2, 3.7), layout="constrained")
        # runs that went astray would take the room of the others
        far = 10.0 * result.reach.get(name, math.inf)
        for engine, every in by_engine(result, name).items():
            rows = [row for row in every if row.error <= far]
            colour = COLOURS.get(engine, "black")
            if engine == OURS.name:
                for method, mark in OUR_MARKS.items():
                    ours = [r for r in rows if r.method == method]
                    if not ours:
                        continue
                    label = f"{engine} {method}"
                    errors, times = [r.error for r in ours], [r.seconds * 1e3 for r in ours]
                    axes.loglog(errors, times, mark, color=colour, ms=4, lw=1.4, label=label)
            elif best := front(rows):
                errors, times = [r.error for r in best], [r.seconds * 1e3 for r in best]
                axes.loglog(errors, times, "D-", color=colour, ms=3.5, lw=1.2, label=engine)
        axes.invert_xaxis()
        axes.set(xlabel=f"error in m ({problem.measured})", ylabel="run time in ms", title=problem.title)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
        figure.savefig(folder / f"work_precision_{name}.png", dpi=90)
        plt.close(figure)


# ---------------------------------------------------------------------------------------------------- README


def contests(result: Result) -> Iterator[tuple[str, float, Row, Row | None]]:
    """(scene, level, the fastest peer's run, our fastest) wherever a peer reaches an error level.

    Errors as large as the whole motion are no level: whoever stood still would have them.
    """
    for name in result.problems:
        engines = by_engine(result, name)
        ours = engines.pop(OURS.name)
        for level in (level for level in LEVELS if level < result.reach.get(name, math.inf)):
            theirs = [row for rows in engines.values() if (row := fastest(rows, level))]
            best = min(theirs, key=lambda row: row.seconds, default=None)
            if best is not None:
                yield name, level, best, fastest(ours, level)


def losses(result: Result) -> list[tuple[str, float, Row, Row | None]]:
    """Those of the `contests` in which the peer is faster."""
    return [entry for entry in contests(result) if entry[3] is None or entry[2].seconds < entry[3].seconds]


def section(result: Result) -> str:
    """The README's section of the scenes that the result has."""
    shown = (
        (1e-2, 1e-3, 1e-4, 1e-6, 1e-8) if result.problems.keys() <= EVENT_SCENES.keys() else (1e-2, 1e-4, 1e-6, 1e-8)
    )
    peers = ", ".join(f"{name} {version}" for name, version in result.versions.items() if name != OURS.name) or "none"
    aba = usual_aba(result)
    lines = [
        *_paragraph(
            "Every engine gets the same mechanism, start and 20 output times; times are medians of whole runs without "
            f"compilation, scaled to one pace of the machine, at which `pin.aba` takes {aba:.2f} us for one free body. "
            f"Peers: {peers}; "
            "their settings, chosen in their favour, and the references are printed with the full table."
        ),
        *_paragraph(
            "Milliseconds to reach an error in m, pincontact first, then the fastest peer; a dash where none did:"
        ),
        "| scene | " + " | ".join(f"{level:.0e}" for level in shown) + " |",
        "|---|" + "---|" * len(shown),
    ]
    for name, problem in result.problems.items():
        engines = by_engine(result, name)
        ours = engines.pop(OURS.name)
        cells = []
        for level in shown:
            mine = fastest(ours, level)
            theirs = [row for rows in engines.values() if (row := fastest(rows, level))]
            best = min(theirs, key=lambda row: row.seconds, default=None)
            left = f"**{milliseconds(mine.seconds)}**" if mine else "–"
            cells.append(f"{left}, {f'{milliseconds(best.seconds)} {best.engine}' if best else '–'}")
        lines.append(f"| {problem.title} ({problem.duration:g} s) | " + " | ".join(cells) + " |")
    lines += ["", "| | |", "|---|---|"]
    pictures = [f"![{p.title}](pincontact/docs/figures/work_precision_{n}.png)" for n, p in result.problems.items()]
    pictures += [""] * (len(pictures) % 2)
    lines += [f"| {a} | {b} |" for a, b in zip(pictures[::2], pictures[1::2])]
    lines += ["", *_paragraph(f"Where a peer wins: {_where_peers_win(result)} {_small_motions(result)}".rstrip())]
    left_out = [entry for entry in result.left_out if entry[1] is None or entry[1] in result.problems]
    for engine in dict.fromkeys(engine for engine, _, _ in left_out):
        scenes = [scene for name, scene, _ in left_out if name == engine]
        titles = [result.problems[scene].title if scene else "everything" for scene in scenes]
        lines += _paragraph(f"Not run by {engine}, for the reasons printed: {'; '.join(titles)}.")
    return "\n".join(lines).rstrip()


def _paragraph(text: str) -> list[str]:
    return [*textwrap.wrap(text, 118, break_long_words=False, break_on_hyphens=False), ""]


def _where_peers_win(result: Result) -> str:
    grouped: dict[tuple[str, str], list[tuple[float, Row, Row | None]]] = {}
    for name, level, theirs, mine in losses(result):
        grouped.setdefault((name, theirs.engine), []).append((level, theirs, mine))
    texts = []
    for (name, engine), entries in grouped.items():
        level, theirs, mine = entries[0]
        levels = f"{level:.0e}" if len(entries) == 1 else f"{level:.0e} to {entries[-1][0]:.0e}"
        against = f"against {milliseconds(mine.seconds)}" if mine else "where pincontact does not get there"
        texts.append(
            f"{engine} on the {result.problems[name].title} at errors of {levels} m "
            f"({milliseconds(theirs.seconds)} ms {against})"
        )
    if texts:
        return "; ".join(texts) + "."
    won = ((name, level, theirs, mine) for name, level, theirs, mine in contests(result) if mine is not None)
    closest = min(won, key=lambda entry: entry[2].seconds / entry[3].seconds, default=None)
    if closest is None:
        return "nowhere in this run."
    name, level, theirs, mine = closest
    doubt = ", less than runs differ by" if theirs.seconds < 1.1 * mine.seconds else ""
    return (
        f"nowhere in this run. Closest comes {theirs.engine} on the {result.problems[name].title} at errors of "
        f"{level:.0e} m ({milliseconds(theirs.seconds)} ms against {milliseconds(mine.seconds)}{doubt})."
    )


def _small_motions(result: Result) -> str:
    """Which of the levels say nothing, and why."""
    small = [
        f"{problem.title} {result.reach[name]:.2g} m"
        for name, problem in result.problems.items()
        if result.reach.get(name, math.inf) <= LEVELS[0]
    ]
    if not small:
        return ""
    return (
        "Errors as large as the motion itself are not counted. Largest distance of a body from its start: "
        f"{'; '.join(small)}."
    )


def write_section(readme: Path, text: str, marks: tuple[str, str] = MARKS) -> None:
    """Replace what stands between the marks."""
    old = readme.read_text()
    pattern = re.compile(re.escape(marks[0]) + r".*?" + re.escape(marks[1]), re.DOTALL)
    if not pattern.search(old):
        raise SystemExit(f"{readme.name} has no marks {marks[0]} ... {marks[1]}")
    readme.write_text(pattern.sub(lambda _: f"{marks[0]}\n{text}\n{marks[1]}", old))


def write_sections(readme: Path, result: Result) -> None:
    """The section of every group all of whose scenes were run."""
    for scenes, marks in GROUPS.values():
        if scenes.keys() <= result.problems.keys():
            of_group = replace(result, problems={name: result.problems[name] for name in scenes})
            write_section(readme, section(of_group), marks)


def _listed(text: str, known: list[str], what: str) -> list[str]:
    names = known if text == "all" else [] if text == "none" else text.split(",")
    unknown = [name for name in names if name not in known]
    if unknown:
        raise SystemExit(f"unknown {what}: {', '.join(unknown)}; known: {', '.join(known)}")
    return names


def main(arguments: list[str] | None = None) -> Result:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", default="all", help=f"all, smooth, events, or some of {','.join(SCENES)}")
    parser.add_argument("--peers", default="all", help=f"all, none, or some of {','.join(PEERS)}")
    parser.add_argument("--output", type=Path, default=Path("work_precision"), help="folder for table, CSV and figures")
    parser.add_argument("--quick", action="store_true", help="short ladders, single runs: to see that it works")
    parser.add_argument("--readme", action="store_true", help="write the README's sections and figures")
    options = parser.parse_args(arguments)
    group = GROUPS.get(options.scenes)
    names = list(group[0]) if group else _listed(options.scenes, list(SCENES), "scenes")
    peers = _listed(options.peers, list(PEERS), "peers")
    options.output.mkdir(parents=True, exist_ok=True)
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}, pin {pin.__version__}")
    result = run_all(names, peers, options.quick)
    write_csv(result, options.output / "work_precision.csv")
    result.rows = evened(result)
    print_tables(result)
    draw(result, options.output)
    if options.readme:
        FIGURES.mkdir(parents=True, exist_ok=True)
        draw(result, FIGURES)
        write_sections(ROOT / "README.md", result)
    return result


if __name__ == "__main__":
    main()
