"""Embedded Runge-Kutta pairs as data, in `tableaux.json`.

DOP853, RK45 and RK23 are those of SciPy's `solve_ivp` (Hairer, Norsett, Wanner; Dormand, Prince; Bogacki, Shampine).
Sharp98: Sharp, P. W., High order explicit Runge-Kutta pairs for ephemerides of the Solar System and the Moon, J. Appl.
Math. Decis. Sci. 4 (2000), 183-192; its error estimate and interpolant, and DOP853's interpolant without extra stages,
are made in `tests/made_tableaux.py`, from the conditions of order.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ArgumentError
from ..layout import DENSE_ROWS, ERROR_ROWS, MAX_STAGES
from ..workspace import address_of
from .resolution import roughness

# Of a method's data, what are arrays; of a there is what is left of the diagonal.
_ARRAYS = ("c", "errors", "dense", "free_dense")


@dataclass(frozen=True, eq=False)
class Tableau:
    """An explicit pair with dense output.

    stages:     evaluations that make up the new state; stage number `stages` is the evaluation there
    order:      of the propagated solution; error_order: exponent that step-size control assumes
    a, c:       rows and nodes of all stages, the new state (row `stages`) and the interpolant's extra ones
    errors:     (2, n) weights of one or two error estimates
    estimate_after: stage after which the error is known
    dense:      (rows, n + 1) weights of the interpolant's coefficients, that of y_1 - y_0 last; nested: see `dense`
    free_dense: the same of an interpolant that needs no extra stages, where `dense` does
    coarsest:   largest relative tolerance that its error estimate is good for
    """

    name: str
    stages: int
    order: int
    error_order: int
    a: np.ndarray
    c: np.ndarray
    errors: np.ndarray
    estimate_after: int
    extra: int
    dense: np.ndarray
    nested: bool
    free_dense: np.ndarray | None = None
    coarsest: float = math.inf

    @cached_property
    def tables(self) -> list[tuple[str, np.ndarray, int]]:
        """a, c, errors and dense with zeros around them: names and addresses of the kernels' arrays, which only read
        them."""
        n = self.c.size
        rows, columns = self.dense.shape
        a, c, errors = np.zeros((MAX_STAGES, MAX_STAGES)), np.zeros(MAX_STAGES), np.zeros((ERROR_ROWS, MAX_STAGES))
        dense = np.zeros((DENSE_ROWS, MAX_STAGES + 1))
        a[:n, :n], c[:n], errors[:2, :n] = self.a, self.c, self.errors
        stages = self.stages + 1
        rough = roughness(self.a[:stages, :stages], self.c[:stages])
        errors[2 : 2 + len(rough), :stages] = rough
        dense[:rows, : columns - 1], dense[:rows, -1] = self.dense[:, :-1], self.dense[:, -1]
        named = {"coefficients": a, "nodes": c, "weights_error": errors, "dense_weights": dense}
        return [(name, array, address_of(array)) for name, array in named.items()]

    @cached_property
    def without_extra_stages(self) -> Tableau:
        """The same pair with the interpolant that its own stages allow."""
        assert self.free_dense is not None
        return replace(self, extra=0, dense=self.free_dense, nested=False)

    @cached_property
    def widest(self) -> float:
        """Largest distance between the nodes of two neighbouring stages, as a fraction of the step."""
        return float(np.diff(np.unique(self.c[: self.stages + 1])).max())


@cache
def _data() -> dict[str, dict[str, Any]]:
    data: dict[str, dict[str, Any]] = json.loads((Path(__file__).parent / "tableaux.json").read_text(encoding="utf-8"))
    return data


@cache
def tableau(method: str) -> Tableau:
    """The tableau of a method's name; ArgumentError for an unknown one."""
    if method not in _data():
        raise ArgumentError(f"unknown method {method!r}; one of {', '.join(_data())}, Moreau")
    fields: dict[str, Any] = dict(_data()[method])
    fields |= {name: np.array(fields[name]) for name in _ARRAYS if name in fields}
    rows, fields["a"] = fields["a"], np.zeros((len(fields["a"]),) * 2)
    for i, row in enumerate(rows):
        fields["a"][i, :i] = row
    return Tableau(method, **fields)
