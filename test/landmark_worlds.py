# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small worlds of bars and points, and what a robot sees of them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.landmarks.features import Features

SD_M, BEARING_SD_RAD, DIRECTION_SD_RAD, LENGTH_SD_M = 0.1, math.radians(1), math.radians(2), 0.1


def features(rows: list[NDArray[np.float64]], covariance: NDArray[np.float64]) -> Features:
    """Return features of rows with 2 values (points) or 4 (bars)."""
    offsets = np.concatenate(([0], np.cumsum([len(row) for row in rows])))
    values = np.concatenate([*rows, np.zeros(0)])
    return Features(np.arange(len(rows)), offsets.astype(np.int64), values, covariance)


def world(
    rng: np.random.Generator, count: int, size_m: float, point_share: float = 0.0
) -> list[NDArray[np.float64]]:
    """Scatter bars of 0 to 3 m and points over a square."""
    return [
        np.array([
            *rng.uniform(0.0, size_m, 2), rng.uniform(-math.pi, math.pi), rng.uniform(0.0, 3.0),
        ])[: 2 if rng.random() < point_share else 4]
        for _ in range(count)
    ]


def mapped(
    rng: np.random.Generator, rows: list[NDArray[np.float64]], sd: float = 0.03, full: bool = False
) -> Features:
    """Return a map of a world; with ``full``, all its errors are correlated."""
    d = sum(len(row) for row in rows)
    root = np.eye(d) * sd
    if full:
        root = root + rng.normal(0.0, 0.3 * sd, (d, d)) / math.sqrt(d)
    noise = root @ rng.standard_normal(d)
    noisy, at = [], 0
    for row in rows:
        noisy.append(row + noise[at : at + len(row)])
        at += len(row)
    return features(noisy, root @ root.T)


def moved(
    rows: list[NDArray[np.float64]], pose: tuple[float, float, float]
) -> list[NDArray[np.float64]]:
    """Return a world in another frame: ``pose`` is that of the old frame in the new one."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    result = []
    for row in rows:
        new = row.copy()
        new[0], new[1] = pose[0] + c * row[0] - s * row[1], pose[1] + s * row[0] + c * row[1]
        if len(row) == 4:
            new[2] += pose[2]
        result.append(new)
    return result


def in_frame(known: Features, pose: tuple[float, float, float]) -> Features:
    """Return a map in another frame, with its covariance."""
    d = len(known.values)
    turn = np.eye(d)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for o in known.offsets[:-1]:
        turn[o : o + 2, o : o + 2] = [[c, -s], [s, c]]
    rows = np.split(known.values, known.offsets[1:-1])
    return features(moved(rows, pose), turn @ known.covariance @ turn.T)


def seen(
    rng: np.random.Generator,
    rows: list[NDArray[np.float64]],
    pose: tuple[float, float, float],
    range_m: float,
    noise: float = 1.0,
) -> Features:
    """Return noisy observations of all that is within range, in the robot's frame."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    back = (-c * pose[0] - s * pose[1], s * pose[0] - c * pose[1], -pose[2])
    sds = noise * np.array([SD_M, BEARING_SD_RAD, DIRECTION_SD_RAD, LENGTH_SD_M])
    found, blocks = [], []
    for row in moved(rows, back):
        distance, bearing = math.hypot(row[0], row[1]), math.atan2(row[1], row[0])
        if distance > range_m:
            continue
        errors = sds * rng.standard_normal(4)
        distance, bearing = distance + errors[0], bearing + errors[1]
        c, s = math.cos(bearing), math.sin(bearing)
        root = np.array(
            [[c * sds[0], -distance * s * sds[1]], [s * sds[0], distance * c * sds[1]]]
        )
        block = np.zeros((len(row), len(row)))
        block[:2, :2] = root @ root.T
        if len(row) == 4:
            block[2, 2], block[3, 3] = sds[2] ** 2, sds[3] ** 2
        found.append(np.array([distance * c, distance * s, *(row[2:] + errors[2 : len(row)])]))
        blocks.append(block)
    d = sum(len(row) for row in found)
    covariance = np.zeros((d, d))
    at = 0
    for block in blocks:
        covariance[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return features(found, covariance)
