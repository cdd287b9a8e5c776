"""The file of a sweep: rows as JSON lines, appended to as they come, whole lines only.

The first line says what was swept; each further one is a row: key, parameters, figures, error, seconds. NaN and
infinities are written as Python's json does.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from ..errors import ArgumentError, TrajectoryError

FORMAT = 1
# A lost machine may cost the rows of so many seconds; a lost process costs none.
_SYNC_SECONDS = 1.0

Row = dict[str, Any]


@contextmanager
def open_rows(
    path: Path | None, header: Row, resume: bool | str
) -> Iterator[tuple[dict[str, Row], Callable[[Row], None]]]:
    """The rows by key that a file, if there is one, holds already, and what appends a row: for one process at a time.

    header: the first line, which says what sweep the file belongs to. resume: as for `sweep`.
    """
    if path is None:
        yield {}, lambda row: None
        return
    try:
        # not truncated by opening it: another sweep may be at it
        file = open(path, "a+b")  # noqa: SIM115
    except OSError as error:
        raise ArgumentError(f"file: {path} cannot be written: {error}") from error
    synced = 0.0

    def write(entry: Row) -> None:
        nonlocal synced
        file.write(json.dumps(entry).encode() + b"\n")
        file.flush()
        if time.monotonic() - synced > _SYNC_SECONDS:
            synced = time.monotonic()
            os.fsync(file.fileno())

    with file:
        _lock(file, path)
        old, rows, end = read_rows(path) if file.tell() > 0 else ({}, {}, 0)
        if old and resume is not False:
            if resume is True:
                _compare(path, old, header)
            # what a crash has cut short
            file.truncate(end)
        else:
            rows = {}
            file.truncate(0)
            write(header)
        yield rows, write


def _compare(path: Path, old: Row, new: Row) -> None:
    what = {"names": "the parameters' names", "fingerprint": "build or measure", "version": "the package's version"}
    for key, text in what.items():
        if old.get(key) != new[key] and not (key == "names" and not new[key]):
            raise ArgumentError(
                f"file: {path} holds {old['build']} and {text} have changed since (from {old.get(key)} to {new[key]}); "
                "take another file, resume=False to begin anew or resume='anyway' to keep its rows"
            )


def _lock(file: IO[bytes], path: Path) -> None:
    """One sweep at a time; released with the file, however its process ends. Not on systems without `flock`."""
    with suppress(ImportError):
        import fcntl

        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise ArgumentError(f"file: {path} is in use by another sweep") from None


def read_rows(path: Path) -> tuple[Row, dict[str, Row], int]:
    """Header, rows by key (the last of equal ones) and the length in bytes of the whole lines of a file."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise TrajectoryError(f"{path} cannot be read: {error}") from error
    end = content.rfind(b"\n") + 1
    lines = content[:end].splitlines()
    if not lines:
        if not json.dumps({"sweep": FORMAT}).encode()[:9].startswith(content[:9]):
            raise TrajectoryError(f"{path} is not a file of a sweep")
        return {}, {}, 0
    entries = []
    for number, line in enumerate(lines, 1):
        try:
            entry = json.loads(line)
        except ValueError as error:
            raise TrajectoryError(f"{path}: line {number} is not a row of a sweep: {error}") from error
        expected = ("sweep", "names", "build") if number == 1 else ("key", "parameters", "figures", "error")
        if not isinstance(entry, dict) or any(key not in entry for key in expected):
            raise TrajectoryError(f"{path}: line {number} is not {'the head' if number == 1 else 'a row'} of a sweep")
        entries.append(entry)
    if entries[0]["sweep"] != FORMAT:
        raise TrajectoryError(f"{path}: format {entries[0]['sweep']} is not {FORMAT}")
    return entries[0], {entry["key"]: entry for entry in entries[1:]}, end
