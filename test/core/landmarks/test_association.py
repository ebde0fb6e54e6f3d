# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nearest neighbours that are jointly compatible."""

from __future__ import annotations

import numpy as np
import pytest

from ratslam_ros.core.landmarks.association import jointly_nearest
from ratslam_ros.core.landmarks.features import Features

SD_M = 0.05


def bars(positions: list[tuple[float, float]], shift_sd_m: float = 0.0) -> Features:
    """Return bars along x; ``shift_sd_m``: error along y that is common to all."""
    n = len(positions)
    values = np.zeros((n, 4))
    values[:, :2] = np.array(positions).reshape(-1, 2)
    covariance = np.diag(np.full(4 * n, SD_M**2))
    rows = np.arange(n) * 4 + 1
    covariance[np.ix_(rows, rows)] += shift_sd_m**2
    return Features(np.arange(n), np.arange(n + 1) * 4, values.reshape(-1), covariance)


POSTS = [(2.0, 0.0), (4.0, 0.0), (6.0, 0.0), (6.0, 1.0)]
"""A row, and a post beside its last one."""


def test_common_shift_is_resolved_by_the_joint_test() -> None:
    """The last two posts are nearer to a neighbour than to themselves, but the row is not."""
    known = bars([*POSTS, (2.0, 1.5)], shift_sd_m=0.5)
    seen = bars([(x, y + 0.6) for x, y in POSTS])
    assert jointly_nearest(seen, known, 0.001).tolist() == [0, 1, 2, 3]


def test_unrelated_landmarks_have_no_partner() -> None:
    matches = jointly_nearest(bars([(3.0, 0.0), (2.0, 0.0)]), bars(POSTS), 0.001)
    assert matches.tolist() == [-1, 0]


def test_direction_separates_landmarks_of_one_position() -> None:
    known, seen = bars(POSTS[:2]), bars(POSTS[:2])
    seen.values[2] = 1.5
    seen.values[6] = 2.0 * np.pi - 1e-3
    assert jointly_nearest(seen, known, 0.001).tolist() == [-1, 1]


@pytest.mark.parametrize(('seen', 'known'), [([], POSTS), (POSTS, []), ([], [])])
def test_nothing_seen_or_known_gives_no_pairs(seen: list, known: list) -> None:
    assert jointly_nearest(bars(seen), bars(known), 0.001).tolist() == [-1] * len(seen)
