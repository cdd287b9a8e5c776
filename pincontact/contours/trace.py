"""Tracing: running a user's Python function once on symbols turns it into a tape.

A branch follows the outcome at one point, and the path keeps what was compared; `branches` finds out where else the
outcome is the same. A call into compiled code is given a number, and the path keeps that it cannot be made a tape.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import tape as ops
from .base import F_1, F_1T, F_2, F_2T, F_11, F_12, F_22, F_T, F_TT, F
from .enclosures import ORIGIN, Check, Interval, is_risky, margins, values
from .graph import Graph, Symbol, Untraceable
from .substitutes import replaced
from .tape import COS, SIN, VARIABLE, Node, traced

# What a slot's entries are, by the variables of the tape: rows of the derivative array.
ROWS = {
    "u": (F, F_1, F_11),
    "ut": (F, F_1, F_T, F_11, F_1T, F_TT),
    "uv": (F, F_1, F_2, F_11, F_12, F_22),
    "uvt": (F, F_1, F_2, F_T, F_11, F_12, F_1T, F_22, F_2T, F_TT),
}

# Kinds of checks.
COMPARISON, RISK, CUT = range(3)


@dataclass
class Program:
    """What became of a formula.

    evaluator:       kernel of the contour that evaluates it
    pool:            what that reads (writable: a tape holds its own scratch area)
    time_dependent:  t occurs in it
    constants:       for each output its value if it depends on no variable, else None
    error:           of the fit in the formula's unit, 0 for a tape
    times:           (first, last) time in s at which it is tried; none where t does not occur
    """

    evaluator: Any
    pool: np.ndarray
    time_dependent: bool
    constants: tuple[float | None, ...]
    error: float = 0.0
    times: tuple[tuple[float, float], ...] = ()


class Path:
    """What a function does at one point, and wherever else its comparisons have the same outcome.

    graph:     its expressions
    reason:    why there is no tape, empty if there is one
    checks:    what decides where it holds and where it is smooth
    kinds:     of these: COMPARISON, RISK (an operation of its tape that is not smooth for all arguments) or CUT (an
               angle of its tape, which jumps by a turn there)
    order:     nodes that the checks depend on
    decisive:  nodes that the comparisons depend on
    """

    def __init__(self, function: Callable[..., Any], variables: str, outputs: int, at: Sequence[float]) -> None:
        self.graph = Graph(variables, at)
        self.variables, self.reason = variables, ""
        self._components: list[Any] = []
        arguments = [self.graph.symbol(VARIABLE, name=name) for name in variables]
        try:
            result = replaced(function, {})(*arguments)
            self._components = _components(result, outputs)
            self.reason = self.graph.leak
        except Untraceable as reason:
            self.reason = str(reason)
        except Exception as error:  # whatever the user's code raises on a symbol means the same
            self.reason = f"{type(error).__name__}: {error}"
        reachable = self.graph.reachable
        self._used = reachable(part.index for part in self._components if isinstance(part, Symbol))
        used = [] if self.reason else [self.graph.nodes[index] for index in self._used]
        comparisons = list(dict.fromkeys(self.graph.comparisons))
        risks = [check for node in used if (check := _risk(node)) is not None]
        cuts: list[Check] = [(ops.ATAN2, node.x, node.y, 0.0) for node in used if node.op == ops.ATAN2]
        self.checks = [*comparisons, *risks, *cuts]
        self.kinds = np.repeat([COMPARISON, RISK, CUT], [len(comparisons), len(risks), len(cuts)])
        self.order = reachable(index for check in self.checks for index in check[1:3])
        self.decisive = reachable(check[1] for check in comparisons)

    def values(self, points: np.ndarray, order: list[int]) -> dict[int, Interval]:
        """Nodes at points (m, n)."""
        return values(self.graph.nodes, order, self.variables, points)

    def margins(
        self, checks: Sequence[Check], low: np.ndarray, high: np.ndarray, inside: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `enclosures.margins`, of some of the checks."""
        return margins(self.graph.nodes, self.order, checks, self.variables, low, high, inside)

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Whether it is the function's path at points (m, n)."""
        found = self.values(points, self.decisive)
        out = np.ones(len(points), dtype=bool)
        for (_, index, _, sign), kind in zip(self.checks, self.kinds):
            if kind == COMPARISON:
                out &= sign * found[index].lo >= 0.0
        return out

    def tape(self) -> Program:
        """The tape of this path, which has no reason against it."""
        nodes = self.graph.nodes
        timed = any(nodes[index].name == "t" for index in self._used)
        variables = self.variables if timed else self.variables.replace("t", "")
        slots, program, count = _program(nodes, self._used, variables)
        rows = ROWS[variables]
        width, n = len(rows), len(variables)
        scratch = ops.INSTRUCTIONS + ops.INSTRUCTION_SIZE * len(program)
        pool = np.zeros(scratch + count * width)
        pool[: ops.RESULTS] = len(program), n, width, scratch, len(self._components)
        for i, part in enumerate(self._components):
            result = (scratch + width * slots[part.index], 0.0) if isinstance(part, Symbol) else (-1.0, part)
            pool[ops.RESULTS + 2 * i : ops.RESULTS + 2 * i + 2] = result
        pool[ops.ROWS : ops.ROWS + width] = rows
        pool[ops.TIMES : ops.TIMES + 2] = -math.inf, math.inf
        for i, (op, a, b, c, d) in enumerate(program):
            at = ops.INSTRUCTIONS + ops.INSTRUCTION_SIZE * i
            pool[at : at + ops.INSTRUCTION_SIZE] = op, scratch + width * a, scratch + width * b, c, d
        for i in range(n):
            pool[scratch + width * i + 1 + i] = 1.0
        constants = tuple(None if isinstance(part, Symbol) else part for part in self._components)
        return Program(traced, pool, timed, constants)


def _program(
    nodes: Sequence[Node], order: Sequence[int], variables: str
) -> tuple[dict[int, int], list[tuple[int, int, int, float, float]], int]:
    """The slots of nodes, the instructions that fill them, and how many slots there are; variables have the first."""
    slots: dict[int, int] = {-1: 0}
    pairs: dict[int, int] = {}
    program: list[tuple[int, int, int, float, float]] = []
    count = len(variables)
    for index in order:
        node = nodes[index]
        if node.op == VARIABLE:
            slots[index] = variables.index(node.name)
        elif node.op in (SIN, COS):
            if node.x not in pairs:
                pairs[node.x] = count
                program.append((ops.SINCOS, slots[node.x], 0, 0.0, 0.0))
                count += 2
            slots[index] = pairs[node.x] + (node.op == COS)
        else:
            program.append((node.op, slots[node.x], slots[node.y], node.c, node.d))
            slots[index] = count
            count += 1
    return slots, program, count


def _risk(node: Node) -> Check | None:
    """Where an operation is not smooth, by the arguments that decide it: those of others would only mislead."""
    if node.op == ops.DIVIDE:
        return ops.INVERSE, node.y, node.y, 0.0
    if node.op == ops.ATAN2:
        return ORIGIN, node.x, node.y, 0.0
    return (node.op, node.x, node.x, node.c) if is_risky(node.op, node.c) else None


def _components(result: Any, outputs: int) -> list[Any]:
    components = np.asarray(result, dtype=object).reshape(-1).tolist()
    if len(components) != outputs:
        raise Untraceable(f"returned {len(components)} numbers instead of {outputs}")
    return [part if isinstance(part, Symbol) else float(part) for part in components]
