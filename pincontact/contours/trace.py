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
from .enclosures import ORIGIN, Check, is_risky
from .graph import Graph, Symbol, Untraceable
from .substitutes import replaced
from .tape import COS, SIN, VARIABLE, Node

# What a slot's entries are, by the variables of the tape: rows of the derivative array.
ROWS = {
    "u": (F, F_1, F_11),
    "ut": (F, F_1, F_T, F_11, F_1T, F_TT),
    "uv": (F, F_1, F_2, F_11, F_12, F_22),
    "uvt": (F, F_1, F_2, F_T, F_11, F_12, F_1T, F_22, F_2T, F_TT),
}


@dataclass(frozen=True)
class Tape:
    """A traced function.

    pool:            the tape as the kernels read it (writable: it holds its own scratch area)
    time_dependent:  whether t occurs in it
    constants:       for each output its value if it does not depend on any variable, else None
    """

    pool: np.ndarray
    time_dependent: bool
    constants: tuple[float | None, ...]

    @property
    def instructions(self) -> int:
        """How many instructions it has."""
        return int(self.pool[ops.COUNT])


class Path:
    """What a function does at one point, and wherever else its comparisons have the same outcome.

    graph:        its expressions
    reason:       why there is no tape, empty if there is one
    comparisons:  the signs that its comparisons found
    risks:        the operations of its tape that are not smooth for all arguments
    cuts:         the angles of its tape, which jump by a turn at their cut
    """

    def __init__(
        self, function: Callable[..., Any], variables: str, outputs: int, at: Sequence[float] | None = None
    ) -> None:
        self.graph = Graph(None if at is None else dict(zip(variables, at)))
        self.reason = ""
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
        roots = [part.index for part in self._components if isinstance(part, Symbol)]
        self._order = self.graph.reachable(roots)
        used = [] if self.reason else [self.graph.nodes[index] for index in self._order]
        self.comparisons: list[Check] = self.graph.comparisons
        self.risks: list[Check] = [check for node in used if (check := _risk(node)) is not None]
        self.cuts: list[Check] = [(ops.ATAN2, node.x, node.y, 0.0) for node in used if node.op == ops.ATAN2]

    def tape(self, variables: str) -> Tape:
        """The tape of this path. Raises `Untraceable` with the reason where there is none."""
        if self.reason:
            raise Untraceable(self.reason)
        nodes = self.graph.nodes
        timed = any(nodes[index].name == "t" for index in self._order)
        variables = variables if timed else variables.replace("t", "")
        slots, program, count = _program(nodes, self._order, variables)
        rows = ROWS[variables]
        width, n = len(rows), len(variables)
        scratch = ops.INSTRUCTIONS + ops.INSTRUCTION_SIZE * len(program)
        pool = np.zeros(scratch + count * width)
        pool[: ops.RESULTS] = len(program), n, width, scratch, len(self._components)
        constants: list[float | None] = []
        for i, part in enumerate(self._components):
            traced = isinstance(part, Symbol)
            result = (scratch + width * slots[part.index], 0.0) if traced else (-1.0, part)
            pool[ops.RESULTS + 2 * i : ops.RESULTS + 2 * i + 2] = result
            constants.append(None if traced else part)
        pool[ops.ROWS : ops.ROWS + width] = rows
        pool[ops.TIMES : ops.TIMES + 2] = -math.inf, math.inf
        for i, (op, a, b, c, d) in enumerate(program):
            at = ops.INSTRUCTIONS + ops.INSTRUCTION_SIZE * i
            pool[at : at + ops.INSTRUCTION_SIZE] = op, scratch + width * a, scratch + width * b, c, d
        for i in range(n):
            pool[scratch + width * i + 1 + i] = 1.0
        return Tape(pool, timed, tuple(constants))


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
    if node.op == ops.POWER:
        return ops.POWER, node.x, node.x, 0.0
    if node.op in (ops.ATAN2, ops.HYPOT):
        return ORIGIN if node.op == ops.ATAN2 else ops.HYPOT, node.x, node.y, 0.0
    return (node.op, node.x, node.x, node.c) if is_risky(node.op, node.c) else None


def trace(function: Callable[..., Any], variables: str, outputs: int) -> Tape:
    """The tape of function(*variables) -> `outputs` numbers, which compares none of them.

    variables: "u", "ut", "uv" or "uvt".
    Raises `Untraceable` with the reason where the function does not follow from elementary operations.
    """
    return Path(function, variables, outputs).tape(variables)


def _components(result: Any, outputs: int) -> list[Any]:
    components = np.asarray(result, dtype=object).reshape(-1).tolist()
    if len(components) != outputs:
        raise Untraceable(f"returned {len(components)} numbers instead of {outputs}")
    return [part if isinstance(part, Symbol) else float(part) for part in components]
