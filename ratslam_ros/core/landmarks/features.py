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


@dataclass(frozen=True, slots=True)
class Observations:
    """Landmarks that a robot sees at one moment, relative to its pose.

    All arrays have length n. A landmark without direction and length (NaN) is a point.
    Identifiers name the landmarks; None if the sensor does not recognise them.
    ``variances`` is (n, 4), of range, bearing, direction and length in m^2 and rad^2; None if the
    noise is the same for all landmarks and a parameter of the map.
    """

    range_m: NDArray[np.float64]
    bearing_rad: NDArray[np.float64]
    direction_rad: NDArray[np.float64]
    length_m: NDArray[np.float64]
    identifiers: NDArray[np.int64] | None = None
    variances: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        """Return the number of observations."""
        return len(self.range_m)


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


def checked_observations(
    range_m: NDArray[np.float64],
    bearing_rad: NDArray[np.float64],
    direction_rad: NDArray[np.float64] | None = None,
    length_m: NDArray[np.float64] | None = None,
    identifiers: NDArray[np.int64] | None = None,
    variances: NDArray[np.float64] | None = None,
) -> Observations:
    """Validate observations and return them; without directions and lengths they are points.

    Args:
        range_m: (n,) distances, not negative.
        bearing_rad: (n,) directions to the landmarks, counter-clockwise from straight ahead.
        direction_rad: (n,) directions of the bars relative to the robot's heading, or NaN.
        length_m: (n,) lengths of the bars, not negative, or NaN.
        identifiers: (n,) names, each at most once.
        variances: (n, 4) of range, bearing, direction and length, positive; those of direction
            and length of a point are not used.

    Raises:
        UnusableObservations: a value is invalid, or the arrays differ in length.
    """
    ranges = np.asarray(range_m, np.float64)
    n = len(ranges)
    if n > MAX_OBSERVATION_COUNT:
        raise UnusableObservations(f'there are {n}; expected at most {MAX_OBSERVATION_COUNT}')
    nothing = np.full(n, np.nan)
    bearings = np.asarray(bearing_rad, np.float64)
    directions = nothing if direction_rad is None else np.asarray(direction_rad, np.float64)
    lengths = nothing if length_m is None else np.asarray(length_m, np.float64)
    columns = {
        'range': ranges, 'bearing': bearings, 'direction': directions, 'length': lengths,
    }
    if identifiers is not None:
        columns['identifier'] = np.asarray(identifiers, np.float64)
    for name, column in columns.items():
        if column.shape != (n,):
            raise UnusableObservations(f'{name} has shape {column.shape}; expected ({n},)')
    for name in ('range', 'bearing', 'identifier'):
        if name in columns and not np.isfinite(columns[name]).all():
            raise UnusableObservations(f'a {name} is not finite')
    for name in ('range', 'length'):
        if (columns[name] < 0.0).any():
            raise UnusableObservations(f'a {name} is negative: {np.nanmin(columns[name]):g} m')
    if (np.isnan(directions) != np.isnan(lengths)).any() or (
        np.isinf(directions) | np.isinf(lengths)
    ).any():
        raise UnusableObservations('a bar needs both a direction and a length, both finite')
    names = None if identifiers is None else np.asarray(identifiers, np.int64)
    if names is not None and len(np.unique(names)) != n:
        raise UnusableObservations('an identifier appears twice')
    if variances is not None:
        variances = np.asarray(variances, np.float64)
        if variances.shape != (n, BAR_SIZE):
            raise UnusableObservations(
                f'variances has shape {variances.shape}; expected ({n}, {BAR_SIZE})'
            )
        is_used = np.ones((n, BAR_SIZE), np.bool_)
        is_used[np.isnan(lengths), POINT_SIZE:] = False
        if not (np.isfinite(variances) & (variances > 0.0))[is_used].all():
            raise UnusableObservations('a variance is not finite and positive')
    return Observations(ranges, bearings, directions, lengths, names, variances)
