# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Local map: the landmarks of the last metre in the robot's frame, the input of relocalisation.

It is a stochastic map whose origin follows the robot, so its uncertainty remains bounded however
far the robot drives. Sensors that recognise no landmarks suffice: identifiers are not used.
"""

from __future__ import annotations

import math

import numpy as np

from ratslam_ros.core.common.saved import Field, Saved, count
from ratslam_ros.core.common.state import State
from ratslam_ros.core.landmarks.features import Features, Observations
from ratslam_ros.core.landmarks.models import MapModel
from ratslam_ros.core.landmarks.stochastic_map import StochasticMap
from ratslam_ros.core.landmarks.stochastic_map_kernels import DOUBTFUL, UNKNOWN


class LocalMap(Saved):
    """Landmarks that were seen within the last metre of travel (``local_m``).

    Each observation is associated with the nearest landmark of the local map that passes the
    chi-square test, and becomes a new landmark if there is none; observations that are probably
    outliers are not used, so that they do not become landmarks. Nearest neighbours suffice here,
    because the odometry since the last moment is much more accurate than the sensor; landmarks
    closer to each other than the sensor's noise may be exchanged, at an error of that size. With
    each moment's observations as separate landmarks, a landmark that was seen ten times would
    count as ten pieces of evidence in relocalisation.

    Relocalisation from a single moment uses a new local map with one call of ``observe``.
    """

    SAVED = (
        Field('map', '_map', StochasticMap), count('next_identifier', '_next_identifier'),
        Field('travelled_m', '_travelled_m'),
        Field('seen_at_m', '', float, ('',), save=lambda own: (
            own._seen_at_m[name] for name in own._map.identifiers.tolist()
        )),
    )

    def __init__(self, model: MapModel = MapModel()) -> None:
        self._p = model
        self.clear()

    def __len__(self) -> int:
        """Return the number of landmarks."""
        return len(self._map)

    def clear(self) -> None:
        """Forget all landmarks, as after an unknown motion."""
        self._map = StochasticMap(self._p)
        self._next_identifier = 0
        self._travelled_m = 0.0
        self._seen_at_m: dict[int, float] = {}

    def predict(self, forward_m: float, left_m: float, turn_rad: float) -> None:
        """Move the robot by odometry, and drop the landmarks that were seen too long ago.

        Arguments and errors as for ``StochasticMap.predict``.
        """
        self._map.predict(forward_m, left_m, turn_rad)
        self._travelled_m += math.hypot(forward_m, left_m)
        earliest_m = self._travelled_m - self._p.local_m
        dropped = [name for name, at_m in self._seen_at_m.items() if at_m < earliest_m]
        if dropped:
            self._map.remove(dropped)
            for name in dropped:
                del self._seen_at_m[name]

    def observe(self, observations: Observations) -> None:
        """Add the landmarks that are seen at one moment; their identifiers are not used."""
        matches = self._map.nearest(observations)
        self._map.move_origin()
        names = matches.copy()
        names[matches >= 0] = self._map.identifiers[matches[matches >= 0]]
        unknown = np.flatnonzero(matches == UNKNOWN)
        names[unknown] = self._next_identifier + np.arange(len(unknown))
        self._next_identifier += len(unknown)
        used = matches != DOUBTFUL
        seen = observations.selected(used)
        observed = self._map.observe(Observations(seen.values, names[used], seen.variances))
        present = observed.added, observed.updated, observed.repeated
        for name in np.concatenate(present).tolist():
            self._seen_at_m[name] = self._travelled_m

    def features(self) -> Features:
        """Return the landmarks in the frame of the robot, with their joint covariance."""
        return self._map.seen_from_robot()

    def _restored(self, state: State) -> None:
        names = self._map.identifiers.tolist()
        self._seen_at_m = dict(zip(names, map(float, state['seen_at_m']), strict=True))
