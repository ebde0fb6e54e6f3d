# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of numbers of which changes are sent, in turn and rounded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Ids = NDArray[np.int64]
Reals = NDArray[np.float64]

ROUNDING = 1000.0
"""Lengths, angles, durations and confidences are rounded to 1/1000 of their unit: 1 mm and 1 mrad
are far below the accuracy of a map and the resolution of a screen, and short as text."""


class SentRows:
    """Rows of numbers: as they are now, as they were sent, and which of them differ.

    The arrays are ordered (column, row), as comparing whole columns is several times faster.
    """

    def __init__(self, tolerances: Reals, rounded: int) -> None:
        """Start without rows.

        Args:
            tolerances: (k,) largest difference of each column that is not sent.
            rounded: number of the first columns, which are rounded when they are sent.
        """
        self._tolerances, self._rounded = tolerances[:, None], rounded
        # Arrays with room for more rows: allocating megabytes takes longer than comparing them.
        self._all = np.empty((3, len(tolerances), 0))
        self._differs: NDArray[np.bool_] = np.empty(0, np.bool_)
        self._next = 0
        self.pending = 0
        """Number of rows that differ from what was sent."""

    def __len__(self) -> int:
        return len(self._differs)

    @property
    def was_sent(self) -> NDArray[np.bool_]:
        """(n,) whether a row was ever sent."""
        return ~np.isnan(self._sent[0])

    @property
    def _sent(self) -> Reals:
        return self._all[1, :, : len(self)]

    @property
    def _now(self) -> Reals:
        return self._all[0, :, : len(self)]

    def resize(self, count: int, expected: int) -> Reals:
        """Append rows; return the present numbers, (k, n), to be changed before ``compare``.

        Args:
            count: number of rows, at least as many as before.
            expected: number of rows that will soon be needed.
        """
        known = len(self)
        if count > self._all.shape[2]:
            grown = np.empty((*self._all.shape[:2], max(64, expected + expected // 4)))
            grown[:, :, :known] = self._all[:, :, :known]
            self._all = grown
        if count > known:
            self._all[1, :, known:count] = np.nan
            self._differs = np.append(self._differs, np.ones(count - known, np.bool_))
        return self._now

    def compare(self) -> None:
        """Compare the present numbers with those that were sent."""
        difference = self._all[2, :, : len(self)]
        np.subtract(self._now, self._sent, out=difference)
        np.abs(difference, out=difference)
        is_close = difference <= self._tolerances  # False for NaN
        self._differs = np.logical_not(is_close.all(axis=0))
        self.pending = int(np.count_nonzero(self._differs))

    def keep(self, kept: NDArray[np.bool_]) -> None:
        """Delete all rows but those marked."""
        count = int(np.count_nonzero(kept))
        self._all[:2, :, :count] = self._all[:2, :, : len(kept)][:, :, kept]
        self._differs = self._differs[kept]
        self.pending = int(np.count_nonzero(self._differs))

    def take(self, limit: int) -> Ids:
        """Return at most ``limit`` rows that differ, and record that they are sent."""
        if not self.pending or limit <= 0:
            return np.empty(0, np.int64)
        rows = np.flatnonzero(self._differs)
        if len(rows) > limit:
            is_new = np.isnan(self._sent[0, rows])
            moved = rows[~is_new]
            at = int(np.searchsorted(moved, self._next))
            rows = np.concatenate([rows[is_new], moved[at:], moved[:at]])[:limit]
            if len(rows) > np.count_nonzero(is_new):
                self._next = int(rows[-1]) + 1
        values = self._now[:, rows]
        values[: self._rounded] = np.rint(values[: self._rounded] * ROUNDING) / ROUNDING
        self._sent[:, rows] = values
        self._differs[rows] = False
        self.pending -= len(rows)
        return rows

    def sent(self, rows: Ids) -> Reals:
        """Return the numbers of rows as they were last sent, (k, rows); NaN before."""
        return self._sent[:, rows]
