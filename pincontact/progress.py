"""Progress bars of runs and sweeps, on stderr."""

from __future__ import annotations

import sys
from typing import Any


class ProgressBar:
    """A progress bar over simulated time; tqdm where it is installed, else a line of text."""

    def __init__(self, wanted: bool, t: float, duration: float) -> None:
        self._wanted, self._t, self._duration = wanted, t, duration
        self._bar: Any = None

    def __enter__(self) -> ProgressBar:
        if self._wanted:
            try:
                from tqdm import tqdm
            except ImportError:
                tqdm = PlainBar
            self._bar = tqdm(
                total=self._duration, unit="s", bar_format="{l_bar}{bar}| {n:.3g}/{total:.3g} s [{elapsed}]"
            )
        return self

    def update(self, t: float) -> None:
        self._bar.update(t - self._t)
        self._t = t

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()


class PlainBar:
    """What `progress=True` shows on stderr without tqdm: a percentage, at most a hundred times. total: in the unit of
    update."""

    def __init__(self, total: float, **_: Any) -> None:
        self._total, self._n, self._shown = total, 0.0, -1

    def update(self, n: float) -> None:
        self._n += n
        percent = int(100.0 * self._n / self._total) if self._total > 0.0 else 100
        if percent > self._shown:
            self._shown = percent
            sys.stderr.write(f"\rpincontact: {percent:3d} %")
            sys.stderr.flush()

    def close(self) -> None:
        sys.stderr.write("\n")
