"""Progress bars of runs and sweeps, on stderr."""

from __future__ import annotations

import sys
from contextlib import closing, suppress
from typing import Any


def progress_bar(wanted: bool, total: float, **options: Any) -> closing[Any]:
    """A context with a bar whose `update(n)` adds to its `n`: tqdm's where it is installed, else a line of text.

    options: as those of tqdm.
    """
    kind: Any = PlainBar
    if wanted:
        with suppress(ImportError):
            from tqdm import tqdm

            kind = tqdm
    return closing(kind(total=total, disable=not wanted, **options))


class PlainBar:
    """What is shown without tqdm: a percentage, at most a hundred times. total: in the unit of update."""

    def __init__(self, total: float, initial: float = 0.0, disable: bool = False, **_: Any) -> None:
        self.n, self._total, self._disable, self._shown = initial, total, disable, -1

    def update(self, n: float) -> None:
        self.n += n
        percent = int(100.0 * self.n / self._total) if self._total > 0.0 else 100
        if percent > self._shown and not self._disable:
            self._shown = percent
            sys.stderr.write(f"\rpincontact: {percent:3d} %")
            sys.stderr.flush()

    def close(self) -> None:
        if not self._disable:
            sys.stderr.write("\n")
