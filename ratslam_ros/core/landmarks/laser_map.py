# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmark map from odometry and laser scans, without RatSLAM."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.saved import Field, Saved, count
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config import MemoryParameters
from ratslam_ros.core.landmarks.association import jointly_nearest
from ratslam_ros.core.landmarks.features import BAR_SIZE, Features
from ratslam_ros.core.landmarks.landmark_memory import LandmarkMemory
from ratslam_ros.core.landmarks.line_extraction import extract_landmarks, observations_of
from ratslam_ros.core.landmarks.local_map import LocalMap
from ratslam_ros.core.landmarks.models import MapModel
from ratslam_ros.core.landmarks.place_search import RelocalisationParameters
from ratslam_ros.core.landmarks.relocalisation import relocalise

CONFIRMING_COUNT = 3
"""Number of used scans that must show a landmark before it enters the map. Within the travel
between them, a person walks away."""

CANDIDATE_RADIUS_M = 0.3
"""Distance within which landmarks of two scans are one candidate, and least distance of a new
landmark from those on the map, if their directions agree."""

CANDIDATE_TURN_RAD = 0.5
"""Angle between the directions of two landmarks up to which they agree. Corners and edges at one
position differ by 45 degrees or more."""

CANDIDATE_TRAVEL_M = 2.0
"""Travel after which a candidate that is not seen again is dropped."""

LOOSE_SD_M, PROVING_COUNT = 0.3, 5
"""Uncertainty of a landmark's place, as the robot sees it, beyond which a pair needs others that
agree, and the number of such pairs. With fewer, two equal shelves are taken for one."""

SCAN_INTERVAL_M = 0.2
"""Travel between two used scans in m, where a turn of 1 rad counts as 1 m. Scans of one place
repeat the errors of the walls and add no information."""

_COLUMNS = 5
"""Of a candidate: x, y, direction, number of scans, travel at the last one."""


class LaserMap(Saved):
    """Map of corners and edges, which the robot sees with a laser and associates by itself.

    After an unknown motion, or when a map was loaded, the robot is lost: nothing enters the map
    until a relocalisation by the landmarks of the last metre succeeds.
    """

    SAVED = (
        Field('memory', 'memory', LandmarkMemory), Field('local', '_local', LocalMap),
        Field('is_lost', 'is_lost', bool), count('scan_count', 'scan_count'),
        count('relocated_count', 'relocated_count'), Field('travelled_m', '_travelled_m'),
        Field('next_scan_m', '_next_scan_m'), count('next_identifier', '_next_identifier'),
        Field('candidates', '_candidates', 'f8', ('', _COLUMNS), -math.inf),
    )

    def __init__(
        self, limit: int = 0, memory: MemoryParameters = MemoryParameters(),
        interval_m: float = SCAN_INTERVAL_M,
    ) -> None:
        """Create an empty map.

        Args:
            limit: largest number of landmarks; 0: any number.
            memory: what is forgotten at the limit.
            interval_m: travel between two used scans, where a turn of 1 rad counts as 1 m.
        """
        self._interval_m = interval_m
        self.memory = LandmarkMemory(limit, memory=memory)
        """The landmarks and the pose of the robot."""
        self.mapping = True
        """Whether new landmarks are added; known ones always correct the pose."""
        self.is_lost = False
        """Whether the robot's pose on the map is unknown."""
        self.scan_count = self.relocated_count = 0
        """Number of used scans, and of successful relocalisations."""
        self._travelled_m = 0.0
        self._next_scan_m = 0.0
        self._next_identifier = 0
        self._candidates = np.zeros((0, _COLUMNS))
        self._local = LocalMap()

    def __len__(self) -> int:
        """Return the number of landmarks."""
        return len(self.memory)

    @property
    def pose(self) -> Pose:
        """Estimated pose of the robot."""
        return self.memory.map.pose

    def integrate(self, motion: Motion) -> None:
        """Move the robot by one motion of the odometry."""
        if not motion.is_known:
            self.lose()
            return
        direction, chord_m = 0.5 * motion.turn_rad + motion.course_rad, motion.chord_m
        step = chord_m * math.cos(direction), chord_m * math.sin(direction), motion.turn_rad
        self.memory.map.predict(*step)
        self._local.predict(*step)
        self._travelled_m += abs(motion.distance_m) + abs(motion.turn_rad)

    def lose(self) -> None:
        """Regard the pose as unknown, as after the robot was carried."""
        self._candidates = np.zeros((0, _COLUMNS))
        self._local.clear()
        self._next_scan_m = self._travelled_m
        # On an empty map every pose is right.
        self.is_lost = len(self.memory) > 0

    def scan(self, scan: Scan) -> bool:
        """Correct the pose by a scan and add what is new; return whether the scan was used."""
        if self._travelled_m < self._next_scan_m:
            return False
        self._next_scan_m = self._travelled_m + self._interval_m
        self.scan_count += 1
        seen = extract_landmarks(scan).features
        if self.is_lost:
            self._relocalise(seen)
        else:
            self._update(scan.stamp_ns, seen)
        return True

    def _relocalise(self, seen: Features) -> None:
        self._local.observe(observations_of(seen))
        found = relocalise(
            self._local.features(), self.memory.map.features(), RelocalisationParameters(),
            seed=self.scan_count,
        )
        if found.outcome == 'found':
            place = found.places[0]
            self.memory.map.move_to(place.pose, place.covariance)
            self.is_lost = False
            self.relocated_count += 1
            self._local.clear()

    def _update(self, stamp_ns: int, seen: Features) -> None:
        known = self.memory.map.seen_from_robot()
        matches = jointly_nearest(seen, known, MapModel.outlier_probability)
        matches = _proven(matches, known)
        names = np.where(matches >= 0, np.append(known.identifiers, -1)[matches], -1)
        if self.mapping:
            self._confirm(seen, known, names)
        used = np.flatnonzero(names >= 0)
        chosen = seen.selected(used)
        observations = observations_of(
            Features(names[used], chosen.offsets, chosen.values, chosen.covariance)
        )
        self.memory.observe(observations, stamp_ns)

    def _confirm(self, seen: Features, known: Features, names: NDArray[np.int64]) -> None:
        """Name the unknown landmarks that enough scans have shown, in place."""
        x_m, y_m, heading_rad = self.pose
        c, s = math.cos(heading_rad), math.sin(heading_rad)
        oldest_m = self._travelled_m - CANDIDATE_TRAVEL_M
        candidates = [row for row in self._candidates.tolist() if row[4] >= oldest_m]
        known_bars = _bars(known)
        for index, (forward, left, direction) in enumerate(_bars(seen)):
            # A landmark beside one of the same direction is the same one, seen badly.
            if names[index] >= 0 or _beside(known_bars, forward, left, direction) >= 0:
                continue
            x, y = x_m + c * forward - s * left, y_m + s * forward + c * left
            direction = wrap(heading_rad + direction)
            at = _beside(candidates, x, y, direction)
            count = 1.0 if at < 0 else candidates.pop(at)[3] + 1.0
            if count < CONFIRMING_COUNT:
                candidates.append([x, y, direction, count, self._travelled_m])
            else:
                names[index] = self._next_identifier
                self._next_identifier += 1
        self._candidates = np.array(candidates).reshape(-1, _COLUMNS)


def _proven(matches: NDArray[np.int64], known: Features) -> NDArray[np.int64]:
    """Drop pairs with a landmark of uncertain place, unless enough of them agree.

    After a long way, the landmark that is expected somewhere may be another one that looks alike.
    """
    starts = known.offsets[:-1]
    variances = np.diagonal(known.covariance)
    is_loose = variances[starts] + variances[starts + 1] > LOOSE_SD_M * LOOSE_SD_M
    loose = np.append(is_loose, False)[matches]
    if 0 < np.count_nonzero(loose) < PROVING_COUNT:
        return np.where(loose, -1, matches)
    return matches


def _bars(features: Features) -> list[list[float]]:
    """Return x, y and direction of bars."""
    rows: list[list[float]] = features.values.reshape(-1, BAR_SIZE)[:, :3].tolist()
    return rows


def _beside(rows: list[list[float]], x: float, y: float, direction: float) -> int:
    """Return the first of some rows of x, y, direction, ... that is near a bar, or -1."""
    for index, row in enumerate(rows):
        if (
            math.hypot(row[0] - x, row[1] - y) <= CANDIDATE_RADIUS_M
            and abs(wrap(row[2] - direction)) <= CANDIDATE_TURN_RAD
        ):
            return index
    return -1
