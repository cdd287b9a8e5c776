"""One peer over several scenes, in a process of its own: rows of the result as lines of JSON.

python -m peers.worker PEER REFERENCES.npz RESULT.jsonl [--quick] SCENE...
"""

from __future__ import annotations

import argparse
import importlib
import json
from dataclasses import asdict, replace

import numpy as np

from . import PEERS
from .measure import QUICK, Effort, Engine, Unsupported, measure
from .scenes import SCENES


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("peer", choices=list(PEERS))
    parser.add_argument("references")
    parser.add_argument("result")
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    references = np.load(arguments.references)
    with open(arguments.result, "w") as file:

        def put(**values) -> None:
            file.write(json.dumps(values) + "\n")
            file.flush()

        try:
            engine: Engine = importlib.import_module(f".{PEERS[arguments.peer]}", __package__).ENGINE
            put(kind="engine", name=engine.name, version=engine.version(), settings=engine.settings)
        except Exception as failure:  # an engine that is absent or broken is left out, with its reason
            put(kind="left out", scene=None, reason=f"{type(failure).__name__}: {failure}"[:300])
            return
        for name in arguments.scenes:
            start = {key: references[f"{name}/{key}"] for key in ("q", "v")}
            problem = replace(SCENES[name](), **start)
            try:
                for row in measure(engine, problem, references[f"{name}/x"], QUICK if arguments.quick else Effort()):
                    put(kind="row", **asdict(row))
            except Unsupported as reason:
                put(kind="left out", scene=name, reason=str(reason))
            except Exception as failure:
                put(kind="left out", scene=name, reason=" ".join(f"{type(failure).__name__}: {failure}".split())[:300])


if __name__ == "__main__":
    main()
