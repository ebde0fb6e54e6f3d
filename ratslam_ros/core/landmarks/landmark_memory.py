# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmark memory: a stochastic map with a limited number of landmarks, selected by freshness."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.freshness import Freshness
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.config import MemoryParameters
from ratslam_ros.core.landmarks.features import Observations
from ratslam_ros.core.landmarks.models import MapModel
from ratslam_ros.core.landmarks.stochastic_map import Observed, StochasticMap

_ORIGIN = Pose(0.0, 0.0, 0.0)


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
        self._freshness = Freshness(memory.forget_share, memory.forget_after_s, seed)

    def __len__(self) -> int:
        """Return the number of landmarks."""
        return len(self.map)

    def observe(self, observations: Observations, stamp_ns: int) -> Observed:
        """Update the map by the landmarks seen at one moment, and add unknown ones at the limit.

        Args:
            observations: landmarks with identifiers.
            stamp_ns: time of the observations, by which freshness decays.

        Raises:
            UnusableObservations: identifiers are missing; nothing changes.
        """
        names = observations.names
        self._freshness.advance(stamp_ns)
        new = np.flatnonzero([name not in self._freshness for name in names.tolist()])
        if self._limit > 0:
            self._make_room(len(new), names)
            nearest_first = new[np.argsort(observations.values[new, 0], kind='stable')]
            refused = nearest_first[max(self._limit - len(self), 0) :]
            observations = observations.selected(~np.isin(np.arange(len(names)), refused))
        observed = self.map.observe(observations)
        for name in [*observed.updated.tolist(), *observed.repeated.tolist()]:
            self._freshness.observe(name)
        for name in observed.added.tolist():
            self._freshness.add(name)
        return observed

    def _make_room(self, count: int, in_view: NDArray[np.int64]) -> None:
        """Remove landmarks until there is room for others, or only those in view are left."""
        removed: list[int] = []
        while len(self._freshness) + count > self._limit:
            allowed = ~np.isin(self._freshness.items, in_view)
            name = self._freshness.candidate(allowed)
            if name is None:
                break
            self._freshness.remove(name)
            removed.append(name)
        if removed:
            self.map.remove(removed)
