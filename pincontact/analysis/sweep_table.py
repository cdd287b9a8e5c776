"""Results of a sweep as a table: rows, columns, arrays, and other packages' tables."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import ArgumentError, TrajectoryError
from ..extras import required
from .sweep_file import Row, read_rows

if TYPE_CHECKING:
    import pandas
    import xarray


@dataclass(frozen=True, eq=False)
class SweepTable(Sequence[Row]):
    """Rows of a sweep, in the order of its parameters; each a dict of parameters, figures and `error`.

    Attributes
    ----------
    rows : list of dict
        A figure that a row lacks is not in it.
    parameters : tuple of str
        Names of the parameters.
    axes : dict of str to list, optional
        Values of each parameter of the grid; None for a list of samples.
    seconds : float
        Wall time of the call of `sweep`, in s; NaN for a table from a file.
    """

    rows: list[Row]
    parameters: tuple[str, ...]
    axes: dict[str, list[Any]] | None = None
    seconds: float = math.nan

    @classmethod
    def load(cls, file: str | os.PathLike[str]) -> SweepTable:
        """The rows of a sweep's file, in the order in which they came.

        Parameters
        ----------
        file : str or Path

        Returns
        -------
        SweepTable

        Raises
        ------
        TrajectoryError
            For a file that is not one of a sweep, or is empty or damaged.
        """
        header, rows, _ = read_rows(Path(file))
        if not header:
            raise TrajectoryError(f"{os.fspath(file)} is empty")
        return cls([flat_row(row) for row in rows.values()], tuple(header["names"]))

    def __getitem__(self, index: Any) -> Any:
        return self.rows[index]

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        failed = f", {len(self.failed)} failed" if self.failed else ""
        return f"<SweepTable of {len(self)} runs{failed}: {', '.join(self.columns)}>"

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of parameters and figures, in order of appearance, and "error"."""
        found = dict.fromkeys(self.parameters)
        for row in self.rows:
            found.update(dict.fromkeys(row))
        found.pop("error", None)
        return (*found, "error")

    @property
    def failed(self) -> list[Row]:
        """The rows with an error."""
        return [row for row in self.rows if row["error"]]

    def column(self, name: str) -> np.ndarray:
        """One parameter or figure of all rows.

        Parameters
        ----------
        name : str

        Returns
        -------
        (n, ...) array
            NaN, "" or None where a row has none.

        Raises
        ------
        ArgumentError
            For a name that is no column's.
        """
        if name not in self.columns:
            raise ArgumentError(f"the sweep has no column {name!r}; columns: {', '.join(self.columns)}")
        return _column([row.get(name) for row in self.rows])

    def grid(self, name: str) -> np.ndarray:
        """A column in the grid's shape, one axis a parameter in their order.

        Parameters
        ----------
        name : str

        Returns
        -------
        (n_1, ..., n_k, ...) array

        Raises
        ------
        ArgumentError
            For a name that is no column's, or without a grid.
        """
        if self.axes is None:
            raise ArgumentError("the sweep ran over a list of samples, not over a grid")
        values = self.column(name)
        return values.reshape(*(len(axis) for axis in self.axes.values()), *values.shape[1:])

    def to_numpy(self) -> np.ndarray:
        """A structured array with a field for each column.

        Returns
        -------
        (n,) array
        """
        columns = {name: self.column(name) for name in self.columns}
        out = np.empty(len(self), dtype=[(name, values.dtype, values.shape[1:]) for name, values in columns.items()])
        for name, values in columns.items():
            out[name] = values
        return out

    def to_pandas(self) -> pandas.DataFrame:
        """A DataFrame with a row for each run.

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        MissingExtraError
            Without pandas (the extra `data`).
        """
        package = required("pandas", "a DataFrame needs pandas", "pincontact[data]")
        columns = {name: self.column(name) for name in self.columns}
        return package.DataFrame(
            {name: values if values.ndim == 1 else list(values) for name, values in columns.items()}
        )

    def to_xarray(self) -> xarray.Dataset:
        """A Dataset over the grid's axes, or over "run" for samples.

        Returns
        -------
        xarray.Dataset

        Raises
        ------
        MissingExtraError
            Without xarray (the extra `data`).
        """
        package = required("xarray", "a Dataset needs xarray", "pincontact[data]")
        if self.axes is None:
            axes, shaped = ["run"], self.column
            coordinates: dict[str, Any] = {}
            names = self.columns
        else:
            axes, shaped = list(self.axes), self.grid
            coordinates = {name: (name, _column(values)) for name, values in self.axes.items()}
            names = tuple(name for name in self.columns if name not in self.axes)
        variables = {}
        for name in names:
            values = shaped(name)
            inner = [f"{name}_{i}" for i in range(values.ndim - len(axes))]
            variables[name] = ([*axes, *inner], values)
        return package.Dataset(variables, coordinates)


def _column(values: list[Any]) -> np.ndarray:
    """An array of the narrowest kind that holds the values, None being NaN among numbers and "" among texts."""
    present = [value for value in values if value is not None]
    whole = len(present) == len(values)
    if present and all(isinstance(value, str) for value in present):
        return np.array([value or "" for value in values])
    with suppress(ValueError, OverflowError):
        blank = np.full(np.shape(present[0]) if present else (), math.nan)
        found = np.array([blank if value is None else value for value in values])
        if found.dtype.kind in "biuf":
            kind = bool if found.dtype.kind == "b" else np.int64 if found.dtype.kind in "iu" and whole else float
            return found.astype(kind).reshape(len(values), *blank.shape)
    out = np.empty(len(values), dtype=object)
    out[:] = values
    return out


def flat_row(stored: Mapping[str, Any]) -> Row:
    """Parameters, figures and error of a stored row in one dict."""
    return {**stored["parameters"], **stored["figures"], "error": stored["error"]}
