"""One peer, in a process of its own, which takes its turn in each scene.

    python -m peers.worker PEER [--quick]

Reads lines "SCENE FILE", FILE being an npz with the start (q, v) and the reference (x); answers with lines of JSON, the
last of a scene being {"kind": "done"}.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from . import PEERS
from .measure import QUICK, Effort, Engine, Unsupported, measure
from .scenes import SCENES


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("peer", choices=list(PEERS))
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    # engines print as they like: what they write to the standard output goes to the errors instead
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def put(**values: Any) -> None:
        answers.write(json.dumps(values) + "\n")
        answers.flush()

    try:
        engine: Engine = importlib.import_module(f".{PEERS[arguments.peer]}", __package__).ENGINE
        put(kind="engine", name=engine.name, version=engine.version(), settings=engine.settings)
    except Exception as failure:  # an engine that is absent or broken is left out, with its reason
        put(kind="absent", reason=f"{type(failure).__name__}: {failure}"[:300])
        return
    for line in sys.stdin:
        name, _, file = line.strip().partition(" ")
        given = np.load(file)
        problem = replace(SCENES[name](), q=given["q"], v=given["v"])
        try:
            for row in measure(engine, problem, given["x"], QUICK if arguments.quick else Effort()):
                put(kind="row", **asdict(row))
        except Unsupported as reason:
            put(kind="left out", scene=name, reason=str(reason))
        except Exception as failure:
            put(kind="left out", scene=name, reason=" ".join(f"{type(failure).__name__}: {failure}".split())[:300])
        put(kind="done")


if __name__ == "__main__":
    main()
