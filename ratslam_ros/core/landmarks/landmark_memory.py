# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmark memory: a stochastic map with a limited number of landmarks, selected by freshness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.freshness import Freshness
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.config import MemoryParameters
from ratslam_ros.core.landmarks.features import (
    Observations,
    UnusableObservations,
    checked_observations,
)
from ratslam_ros.core.landmarks.models import MapModel
from ratslam_ros.core.landmarks.stochastic_map import Observed, StochasticMap

_ORIGIN = Pose(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Remembered:
    """Result of the observations of one moment.

    Attributes:
        observed: what the map did with the observations.
        removed: identifiers of the landmarks that made room for new ones.
        refused: identifiers of new landmarks for which there was no room.
    """

    observed: Observed
    removed: tuple[int, ...]
    refused: tuple[int, ...]


class LandmarkMemory(Saved):
    """Stochastic map that holds a limited number of landmarks.

    At the limit, landmarks are removed by their freshness (docs/algorithm.md, "Forgetting") before
    new ones are added. A landmark that is in view at that moment is not removed: if only such
    landmarks are left, the farthest new ones are refused, because all others are at the present
    place too and are known already.

    Removing a landmark marginalises it out, so what it contributed to the estimates of the pose
    and of the other landmarks is kept. A removed landmark that is seen again is a new one.
    """

    SAVED = (
        Field('map', 'map', StochasticMap), Field('freshness', '_freshness', Freshness),
    )

    def __init__(
        self, limit: int = 0, model: MapModel = MapModel(), pose: Pose = _ORIGIN, seed: int = 0,
        memory: MemoryParameters = MemoryParameters(),
    ) -> None:
        """Create an empty map.

        Args:
            limit: largest number of landmarks; 0: any number.
            model: noise of odometry and sensor.
            pose: pose of the robot, which is known exactly.
            seed: seed of the random choice of the landmarks that fade.
            memory: what is forgotten at the limit.
        """
        self._limit = limit
        self.map = StochasticMap(model, pose)
        """The map; add and remove landmarks through this class only."""
        self._freshness = Freshness.of(memory, seed)

    def __len__(self) -> int:
        """Return the number of landmarks."""
        return len(self.map)

    @property
    def forced(self) -> int:
        """Number of removals at which no landmark had faded."""
        return self._freshness.forced

    def observe(self, observations: Observations, stamp_ns: int) -> Remembered:
        """Update the map by the landmarks seen at one moment, and add unknown ones at the limit.

        Args:
            observations: landmarks with identifiers.
            stamp_ns: time of the observations, by which freshness decays.

        Raises:
            UnusableObservations: values are invalid, or identifiers are missing; nothing changes.
        """
        o = observations
        seen = checked_observations(
            o.range_m, o.bearing_rad, o.direction_rad, o.length_m, o.identifiers, o.variances
        )
        if seen.identifiers is None:
            raise UnusableObservations('identifiers are missing; expected one per landmark')
        self._freshness.advance(stamp_ns)
        is_new = np.array([i not in self._freshness for i in seen.identifiers.tolist()], np.bool_)
        removed = self._make_room(int(is_new.sum()), seen.identifiers)
        refused = np.zeros(len(seen), np.bool_)
        if self._limit > 0:
            new = np.flatnonzero(is_new)
            nearest_first = new[np.argsort(seen.range_m[new], kind='stable')]
            refused[nearest_first[max(self._limit - len(self), 0) :]] = True
        observed = self.map.observe(_selected(seen, ~refused))
        for identifier in [*observed.updated.tolist(), *observed.repeated.tolist()]:
            self._freshness.observe(identifier)
        for identifier in observed.added.tolist():
            self._freshness.add(identifier)
        return Remembered(observed, removed, tuple(seen.identifiers[refused].tolist()))

    def _make_room(self, count: int, in_view: NDArray[np.int64]) -> tuple[int, ...]:
        """Remove landmarks until there is room for others, or only those in view are left."""
        removed: list[int] = []
        if self._limit > 0:
            while len(self._freshness) + count > self._limit:
                allowed = ~np.isin(self._freshness.items, in_view)
                identifier = self._freshness.candidate(allowed)
                if identifier is None:
                    break
                self._freshness.remove(identifier)
                removed.append(identifier)
            if removed:
                self.map.remove(removed)
        return tuple(removed)


def _selected(seen: Observations, rows: NDArray[np.bool_]) -> Observations:
    """Return some of the observations."""
    return Observations(
        seen.range_m[rows], seen.bearing_rad[rows], seen.direction_rad[rows], seen.length_m[rows],
        None if seen.identifiers is None else seen.identifiers[rows],
        None if seen.variances is None else seen.variances[rows],
    )
