# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Observations are validated; features can be selected with their covariance."""

from __future__ import annotations

import numpy as np
import pytest

from ratslam_ros.core.landmarks.features import (
    MAX_OBSERVATION_COUNT,
    Features,
    Observations,
    UnusableObservations,
)


def test_observations_without_direction_are_points() -> None:
    seen = Observations(np.array([[1.0, 0.0], [2.0, -1.0]]))
    assert len(seen) == 2 and seen.sizes.tolist() == [2, 2]
    assert np.isnan(seen.values[:, 2:]).all()
    with pytest.raises(UnusableObservations, match='identifiers are missing'):
        _ = seen.names


@pytest.mark.parametrize(
    ('values', 'others', 'reason'),
    [
        ([[np.nan, 0.0]], {}, 'range or bearing is not finite'),
        ([[1.0, np.inf]], {}, 'range or bearing is not finite'),
        ([[-1.0, 0.0]], {}, 'range or length is negative'),
        ([[1.0, 0.0, 0.0, -2.0]], {}, 'range or length is negative'),
        ([[1.0, 0.0, 0.0, np.nan]], {}, 'both a direction and a length'),
        ([[1.0, 0.0, np.inf, 1.0]], {}, 'both finite'),
        ([[1.0, 0.0, 0.0]], {}, 'values has shape'),
        ([[1.0, 0.0], [2.0, 0.0]], {'identifiers': [3]}, 'identifiers has shape'),
        ([[1.0, 0.0], [2.0, 0.0]], {'identifiers': [3, 3]}, 'appears twice'),
        ([[1.0, 0.0]], {'variances': [[1.0, 1.0]]}, 'variances has shape'),
        ([[1.0, 0.0]], {'variances': [[1.0, 0.0, 1.0, 1.0]]}, 'not finite and positive'),
        ([[1.0, 0.0]] * (MAX_OBSERVATION_COUNT + 1), {}, 'expected at most'),
    ],
)
def test_invalid_observations_are_refused(values: list, others: dict, reason: str) -> None:
    arrays = {name: np.array(column) for name, column in others.items()}
    with pytest.raises(UnusableObservations, match=reason):
        Observations(np.array(values), **arrays)


def test_selected_features_keep_their_covariance() -> None:
    root = np.arange(36.0).reshape(6, 6)
    features = Features(np.array([7, 9]), np.array([0, 4, 6]), np.arange(6.0), root @ root.T)
    assert features.are_bars.tolist() == [True, False]
    assert features.positions_m.tolist() == [[0.0, 1.0], [4.0, 5.0]]
    swapped = features.selected(np.array([1, 0]))
    assert swapped.offsets.tolist() == [0, 2, 6]
    assert swapped.values.tolist() == [4.0, 5.0, 0.0, 1.0, 2.0, 3.0]
    assert swapped.covariance[0, 2] == features.covariance[4, 0]
    assert len(features.selected(np.zeros(0, np.int64))) == 0
