# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Features of a place (bars and points), and observations of them by range and bearing.

A bar starts at a position and extends in a direction by a length, like a wall that is seen from
one side; a corner is a bar whose length is nearly zero. A point has a position only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.errors import UnusableInput

POINT_SIZE = 2
"""Values of a point: x and y in metres."""

BAR_SIZE = 4
"""Values of a bar: x and y in metres, direction in radians, length in metres."""

MAX_OBSERVATION_COUNT = 1000
"""More observations at one moment are rejected."""


class UnusableObservations(UnusableInput):
    """Observations of landmarks that are not finite, out of range, or too many."""


@dataclass(frozen=True)
class Observations:
    """Landmarks that a robot sees at one moment, relative to its pose; validated when created.

    Attributes:
        values: (n, 4) range in m, bearing in rad, counter-clockwise from straight ahead, direction
            of a bar relative to the robot's heading in rad, and its length in m. Direction and
            length of a point are NaN. Rows of two values are points.
        identifiers: (n,) names, each at most once; None if the sensor recognises no landmarks.
        variances: (n, 4) of the values, positive; those of direction and length of a point are not
            used. None if the noise is the same for all landmarks and a parameter of the map.

    Raises:
        UnusableObservations: a value is invalid, or the arrays differ in length.
    """

    values: NDArray[np.float64]
    identifiers: NDArray[np.int64] | None = None
    variances: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        """Validate the values, and fill up those of points."""
        values = np.asarray(self.values, np.float64)
        n = len(values)
        if n > MAX_OBSERVATION_COUNT:
            raise UnusableObservations(f'there are {n}; expected at most {MAX_OBSERVATION_COUNT}')
        if values.shape == (n, POINT_SIZE):
            values = np.pad(values, ((0, 0), (0, BAR_SIZE - POINT_SIZE)), constant_values=np.nan)
        object.__setattr__(self, 'values', values)
        shapes = {'values': (n, BAR_SIZE), 'identifiers': (n,), 'variances': (n, BAR_SIZE)}
        for name, shape in shapes.items():
            column = getattr(self, name)
            if column is not None and column.shape != shape:
                raise UnusableObservations(f'{name} has shape {column.shape}; expected {shape}')
        is_missing = np.isnan(values)
        is_missing[:, :POINT_SIZE] = False
        if not np.isfinite(values[:, :POINT_SIZE]).all():
            raise UnusableObservations('a range or bearing is not finite')
        if (is_missing[:, 2] != is_missing[:, 3]).any() or np.isinf(values).any():
            raise UnusableObservations('a bar needs both a direction and a length, both finite')
        if (values[:, [0, 3]] < 0.0).any():
            raise UnusableObservations('a range or length is negative')
        if self.identifiers is not None and len(np.unique(self.identifiers)) != n:
            raise UnusableObservations('an identifier appears twice')
        if self.variances is not None and not (
            is_missing | np.isfinite(self.variances) & (self.variances > 0.0)
        ).all():
            raise UnusableObservations('a variance is not finite and positive')

    def __len__(self) -> int:
        """Return the number of observations."""
        return len(self.values)

    @property
    def sizes(self) -> NDArray[np.int64]:
        """(n,) numbers of values: those of points or bars."""
        return np.where(np.isnan(self.values[:, 3]), POINT_SIZE, BAR_SIZE)

    @property
    def names(self) -> NDArray[np.int64]:
        """(n,) identifiers.

        Raises:
            UnusableObservations: they are missing.
        """
        if self.identifiers is None:
            raise UnusableObservations('identifiers are missing; expected one per landmark')
        return self.identifiers

    def selected(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Observations:
        """Return some of the observations."""
        return Observations(
            self.values[rows], None if self.identifiers is None else self.identifiers[rows],
            None if self.variances is None else self.variances[rows],
        )


@dataclass(frozen=True)
class Features:
    """Bars and points with their joint covariance, in one frame.

    Feature i has the values ``values[offsets[i]:offsets[i + 1]]``: x, y, direction, length of a
    bar, or x, y of a point. The frame is a map, or the robot for what it saw just now.

    Attributes:
        identifiers: (n,) names, unique; without meaning between two sets of features.
        offsets: (n + 1,) places of the features within ``values``.
        values: (d,) means, in metres and radians.
        covariance: (d, d) of ``values``, symmetric and positive semi-definite.
    """

    identifiers: NDArray[np.int64]
    offsets: NDArray[np.int64]
    values: NDArray[np.float64]
    covariance: NDArray[np.float64]

    def __len__(self) -> int:
        """Return the number of features."""
        return len(self.identifiers)

    @cached_property
    def are_bars(self) -> NDArray[np.bool_]:
        """(n,) True for bars, False for points."""
        return np.diff(self.offsets) == BAR_SIZE

    @cached_property
    def positions_m(self) -> NDArray[np.float64]:
        """(n, 2) positions."""
        starts = self.offsets[:-1]
        return np.stack((self.values[starts], self.values[starts + 1]), axis=1)

    def selected(self, indices: NDArray[np.int64]) -> Features:
        """Return some of the features, in the order of the indices, with their covariance."""
        sizes = np.diff(self.offsets)[indices]
        rows = np.concatenate([
            np.arange(self.offsets[index], self.offsets[index + 1]) for index in indices
        ] or [np.zeros(0, np.int64)])
        return Features(
            self.identifiers[indices],
            np.concatenate(([0], np.cumsum(sizes))).astype(np.int64),
            self.values[rows],
            self.covariance[np.ix_(rows, rows)],
        )
