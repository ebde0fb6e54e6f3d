# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Growing tables of numbers: what a memory learns, in the form in which its state is saved.

A live node saves its state every two seconds between two messages. Converting lists of thousands
of Python objects would delay the messages by tens of milliseconds; copying an array does not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

_MIN_CAPACITY = 64


class Rows:
    """A table with a fixed number of columns and a growing number of rows."""

    def __init__(self, columns: int | None, dtype: DTypeLike = np.float64) -> None:
        """Create an empty table; ``columns``: None for rows of a single number."""
        shape = () if columns is None else (columns,)
        self._values: NDArray[Any] = np.empty((_MIN_CAPACITY, *shape), dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, row: int) -> Any:
        """Return the list of the numbers of a row, or its single number."""
        return self._values[row].tolist()

    def __setitem__(self, row: int, values: float | Sequence[float]) -> None:
        """Replace a row, or add it at the end."""
        if row == self._count:
            if row == len(self._values):
                self._values = np.concatenate([self._values, np.empty_like(self._values)])
            self._count += 1
        self._values[row] = values

    @property
    def values(self) -> NDArray[Any]:
        """(rows, columns) or (rows,) a view, valid until rows are added or removed.

        Writing to it changes the table.
        """
        return self._values[: self._count]

    def append(self, values: Sequence[float]) -> None:
        """Add a row at the end."""
        self[self._count] = values

    def replace(self, values: ArrayLike) -> None:
        """Replace all rows by (rows, columns) values; an empty list has no rows."""
        given = np.asarray(values, self._values.dtype).reshape(-1, *self._values.shape[1:])
        self._values, self._count = with_capacity(given, _MIN_CAPACITY), len(given)

    def clear(self) -> None:
        """Remove all rows."""
        self._count = 0

    def remove(self, row: int) -> None:
        """Remove a row; the last row takes its place."""
        self._count -= 1
        self._values[row] = self._values[self._count]

    def keep(self, kept: NDArray[np.bool_]) -> None:
        """Remove the rows that are not marked; the others keep their order."""
        self.take(np.flatnonzero(kept))

    def take(self, rows: NDArray[np.int64]) -> None:
        """Remove all rows but the given ones, which ascend."""
        self._count = len(rows)
        self._values[: len(rows)] = self._values.take(rows, axis=0)


class KeyedRows(Rows):
    """A table whose first columns are whole numbers by which a row is found.

    Iteration yields these keys in the order in which they were added.
    """

    def __init__(self, keys: int, columns: int, dtype: DTypeLike = np.float64) -> None:
        """Create an empty table.

        Args:
            keys: number of columns that are the key of a row.
            columns: number of all columns.
            dtype: type of all columns.
        """
        super().__init__(columns, dtype)
        self._keys = keys
        self._row_of: dict[tuple[int, ...], int] = {}

    def __contains__(self, key: tuple[int, ...]) -> bool:
        return key in self._row_of

    def __iter__(self) -> Iterator[tuple[int, ...]]:
        return iter(self._row_of)

    def get(self, *key: int) -> list[Any]:
        """Return the columns after the key of a row."""
        return self[self._row_of[key]][self._keys :]

    def put(self, key: tuple[int, ...], values: Sequence[float] = ()) -> None:
        """Replace the columns after the key, or add a row."""
        self[self._row_of.setdefault(key, len(self))] = *key, *values

    def drop(self, *key: int) -> None:
        """Remove a row; the last row takes its place."""
        row = self._row_of.pop(key)
        self.remove(row)
        if row < len(self):
            self._row_of[tuple(map(int, self[row][: self._keys]))] = row

    def replace(self, values: ArrayLike) -> None:
        """Replace all rows; of several with one key, the last one is kept."""
        super().replace(values)
        given = self.values.tolist()
        self.clear()
        for row in given:
            self.put(tuple(map(int, row[: self._keys])), row[self._keys :])

    def clear(self) -> None:
        """Remove all rows."""
        super().clear()
        self._row_of.clear()


def require_shapes(owner: object, **shapes: tuple[int, ...]) -> None:
    """Raise ValueError if an array of an object does not have the shape that it should."""
    for name, shape in shapes.items():
        found = getattr(owner, name).shape
        if found != shape:
            raise ValueError(f'{name} has the shape {found}, expected {shape}')


def listed(values: Any) -> list[Any]:
    """Return the rows of a saved table as lists; earlier versions have saved lists."""
    rows: list[Any] = values.tolist() if isinstance(values, np.ndarray) else values
    return rows


def with_capacity(rows: NDArray[Any], capacity: int) -> NDArray[Any]:
    """Return an array that begins with the given rows and has at least ``capacity`` rows."""
    grown = np.empty((max(capacity, len(rows)), *rows.shape[1:]), rows.dtype)
    grown[: len(rows)] = rows
    return grown
