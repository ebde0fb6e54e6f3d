# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmark memory: bounded, sparse where the robot was long ago, and otherwise the same map."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import MemoryParameters
from ratslam_ros.core.landmarks.features import Observations, UnusableObservations
from ratslam_ros.core.landmarks.landmark_memory import LandmarkMemory
from ratslam_ros.core.landmarks.models import MapModel
from ratslam_ros.core.landmarks.stochastic_map import StochasticMap

S = 1_000_000_000
STEP_M, VIEW_M = 0.5, 4.0


def forgetting(limit: int, seed: int = 0, pose: Pose = Pose(0.0, 0.0, 0.0)) -> LandmarkMemory:
    return LandmarkMemory(limit, MapModel(), pose, seed, MemoryParameters(forget_after_s=40.0))


class Corridor:
    """A robot that drives along a corridor with a point landmark every metre on either side."""

    def __init__(self, memory: LandmarkMemory | StochasticMap, length_m: int, seed: int) -> None:
        self.memory = memory
        self.rng = np.random.default_rng(seed)
        at = np.repeat(np.arange(length_m, dtype=float), 2)
        self.places = np.stack((at, np.where(np.arange(len(at)) % 2 == 0, 1.5, -1.5)), axis=1)
        self.x_m = 0.0
        self.largest = 0

    def observations(self) -> Observations:
        away = self.places - (self.x_m, 0.0)
        ranges, bearings = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])
        names = np.flatnonzero(ranges < VIEW_M)
        noise = self.rng.normal(0.0, 1.0, (2, len(names)))
        values = np.abs(ranges[names] + 0.1 * noise[0]), bearings[names] + 0.0175 * noise[1]
        return Observations(np.stack(values, axis=1), names)

    def drive(self, steps: int) -> None:
        """Drive straight on, one step a second."""
        for _ in range(steps):
            self.x_m += STEP_M
            forward_m = STEP_M + 0.05 * math.sqrt(STEP_M) * self.rng.normal()
            turn_rad = 0.02 * math.sqrt(STEP_M) * self.rng.normal()
            stamp_ns = round(self.x_m / STEP_M * S)
            if isinstance(self.memory, LandmarkMemory):
                self.memory.map.predict(forward_m, 0.0, turn_rad)
                self.memory.observe(self.observations(), stamp_ns)
            else:
                self.memory.predict(forward_m, 0.0, turn_rad)
                self.memory.observe(self.observations())
            self.largest = max(self.largest, len(self.memory))


def identifiers(memory: LandmarkMemory) -> NDArray[np.int64]:
    return memory.map.identifiers


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 60), st.integers(0, 10**6))
def test_memory_never_exceeds_its_limit(limit: int, seed: int) -> None:
    corridor = Corridor(forgetting(limit, seed), 60, seed)
    corridor.drive(80)
    assert corridor.largest <= limit


def test_old_stretches_become_sparse_and_the_recent_one_stays_dense() -> None:
    memory = forgetting(120)
    corridor = Corridor(memory, 120, 1)
    corridor.drive(220)
    metres = identifiers(memory) // 2
    recent = metres >= 92  # seen within the last 40 s
    assert np.count_nonzero(recent) == 44  # all
    for low in (0, 28, 56):  # two thirds or less of 56
        assert 5 <= np.count_nonzero((metres >= low) & (metres < low + 28)) <= 37


def test_limit_that_is_not_reached_changes_nothing() -> None:
    limited, unlimited = forgetting(100), StochasticMap()
    Corridor(limited, 30, 2).drive(40)
    Corridor(unlimited, 30, 2).drive(40)
    assert limited.map.covariance.tobytes() == unlimited.covariance.tobytes()
    assert limited.map.pose == unlimited.pose


def test_landmarks_in_view_stay_and_the_farthest_new_ones_are_refused() -> None:
    memory = forgetting(3)
    ranges = np.array([3.0, 1.0, 2.0, 4.0, 0.5])
    near = Observations(np.stack((ranges, np.linspace(-1.0, 1.0, 5)), axis=1), np.arange(5))
    memory.observe(near, 0)
    assert identifiers(memory).tolist() == [1, 2, 4]
    again = memory.observe(near, 100 * S)
    assert identifiers(memory).tolist() == again.updated.tolist() == [1, 2, 4]


def test_map_stays_accurate_within_a_limit() -> None:
    """The estimate is consistent: forgetting marginalises, it does not distort."""
    normalised = []
    for seed in range(8):
        memory = forgetting(40, seed)
        corridor = Corridor(memory, 60, seed)
        corridor.drive(100)
        features = memory.map.features()
        away = (features.positions_m - corridor.places[features.identifiers]).reshape(-1)
        normalised.append(away @ np.linalg.solve(features.covariance, away) / len(away))
    assert 0.6 < np.mean(normalised) < 1.4


def test_unusable_observations_leave_the_memory_unchanged() -> None:
    memory = forgetting(30, pose=Pose(1.0, 2.0, 3.0))
    Corridor(memory, 20, 4).drive(10)
    before = memory.state()
    with pytest.raises(UnusableObservations):
        memory.observe(Observations(np.ones((40, 2))), 100 * S)
    after = memory.state()
    assert after['map']['triangle'].tobytes() == before['map']['triangle'].tobytes()
    assert after['freshness']['now_ns'] == before['freshness']['now_ns']


def test_landmarks_seen_again_from_the_same_place_stay_fresh() -> None:
    """They do not improve the map, as their errors may be the same, but they are remembered."""
    memory = LandmarkMemory(
        30, MapModel(repeat_m=0.3),
        memory=MemoryParameters(forget_share=1.0, forget_after_s=40.0),
    )
    corridor = Corridor(memory, 20, 4)
    corridor.drive(4)
    memory.observe(corridor.observations(), 60 * S)
    seen = set(corridor.observations().identifiers.tolist())  # type: ignore[union-attr]
    freshness = memory.state()['freshness']
    fresh = dict(zip(freshness['items'].tolist(), freshness['observed_ns'].tolist(), strict=True))
    assert seen and all(fresh[name] == freshness['now_ns'] for name in seen)
