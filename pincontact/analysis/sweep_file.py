"""The file of a sweep: rows as JSON lines, appended to as they come, whole lines only.

The first line says what was swept; each further one is a row: key, parameters, figures, error, seconds. NaN and
infinities are written as Python's json does.
"""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from ..errors import ArgumentError, TrajectoryError

FORMAT = 1
# A lost machine may cost the rows of so many seconds; a lost process costs none.
_SYNC_SECONDS = 1.0

Row = dict[str, Any]


class RowFile:
    """A file of rows, appended to by one process at a time; its first line says what sweep it belongs to."""

    def __init__(self, path: Path, header: Row, resume: bool | str) -> None:
        self.path, self._header, self._resume = path, header, resume
        self.rows: dict[str, Row] = {}
        self._file: IO[bytes] | None = None
        self._synced = 0.0

    def __enter__(self) -> RowFile:
        try:
            # not truncated by opening it: another sweep may be at it
            self._file = open(self.path, "a+b")
        except OSError as error:
            raise ArgumentError(f"file: {self.path} cannot be written: {error}") from error
        try:
            _lock(self._file, self.path)
            self._begin()
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self._file.close()

    def _begin(self) -> None:
        assert self._file is not None
        if self._file.tell() > 0:
            header, rows, end = read_rows(self.path)
            if header and self._resume is not False:
                if self._resume is True:
                    self._compare(header)
                self.rows = rows
                # what a crash has cut short
                self._file.truncate(end)
                return
            self._file.truncate(0)
        self._write(self._header)

    def _compare(self, header: Row) -> None:
        what = {"names": "the parameters' names", "fingerprint": "build or measure", "version": "the package's version"}
        for key, text in what.items():
            old, new = header.get(key), self._header[key]
            if old != new and not (key == "names" and not new):
                raise ArgumentError(
                    f"file: {self.path} holds {header['build']} and {text} have changed since (from {old} to {new}); "
                    "take another file, resume=False to begin anew or resume='anyway' to keep its rows"
                )

    def append(self, row: Row) -> None:
        self._write(row)

    def _write(self, entry: Row) -> None:
        assert self._file is not None
        self._file.write(json.dumps(entry).encode() + b"\n")
        self._file.flush()
        now = time.monotonic()
        if now - self._synced > _SYNC_SECONDS:
            self._synced = now
            os.fsync(self._file.fileno())


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
