"""How objects show themselves: names of modes, short lists, tables for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from html import escape
from typing import Any

import numpy as np

from .layout import FREE, FRICTIONLESS, SLIPPING, STICK

MODE_NAMES = {FREE: "open", FRICTIONLESS: "frictionless", STICK: "stick", SLIPPING: "slip"}

# So many characters of names, and so many numbers of a vector, stand in a `repr`.
_CHARACTERS, _NUMBERS = 70, 14
# Rows of a run's table of events.
EVENTS_SHOWN = 20


def shortened(names: Iterable[str]) -> str:
    """Names in a row; of many the first ones, and how many more there are."""
    known = list(names)
    ends = np.cumsum([len(name) + 2 for name in known])
    count = max(1, int(np.count_nonzero(ends <= _CHARACTERS)))
    rest = len(known) - count
    text = ", ".join(known[:count])
    return f"{text} and {rest} more" if rest > 0 else text or "none"


def numbers(vector: np.ndarray) -> str:
    """A vector with four digits; of a long one the beginning and the end."""
    return np.array2string(
        vector, precision=4, suppress_small=True, threshold=_NUMBERS, edgeitems=_NUMBERS // 2, max_line_width=10_000
    )


def known_range(values: np.ndarray, form: str, unit: str = "") -> str:
    """From the least of the values that are known to the largest, in a format."""
    known = values[np.isfinite(values)]
    return f"{known.min():{form}} to {known.max():{form}}{unit}" if known.size else "not known"


class Summary:
    """A dataclass of results, with `repr=False`, that shows its numbers, names, and the shapes of its arrays."""

    def __repr__(self) -> str:
        shown = [field.name for field in fields(self) if field.repr]  # type: ignore[arg-type]
        return f"{type(self).__name__}({', '.join(f'{name}={_summary(getattr(self, name))}' for name in shown)})"


def _summary(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"array{value.shape}"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, (Mapping, list, tuple)):
        return f"[{shortened(map(_summary, value)) if value else ''}]"
    text = repr(value)
    return text if len(text) <= _CHARACTERS else type(value).__name__


def html_table(title: str, heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A titled table, as notebooks show it; texts are escaped. Empty without rows."""
    cells = [[escape(str(entry)) for entry in row] for row in rows]
    if not cells:
        return ""
    head = "".join(f"<th>{escape(entry)}</th>" for entry in heads)
    body = "".join(f"<tr>{''.join(f'<td>{entry}</td>' for entry in row)}</tr>" for row in cells)
    return f"<table><caption>{escape(title)}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
