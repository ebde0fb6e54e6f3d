# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stochastic map: pose and landmarks with their joint covariance, by an extended Kalman filter.

Smith, Self and Cheeseman (1990), "Estimating uncertain spatial relationships in robotics". The
landmarks are recognised by their identifiers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.saved import Field, Saved, count
from ratslam_ros.core.common.state import State
from ratslam_ros.core.landmarks import stochastic_map_kernels as kernels
from ratslam_ros.core.landmarks.features import BAR_SIZE, POINT_SIZE, Features, Observations
from ratslam_ros.core.landmarks.models import MapModel
from ratslam_ros.core.landmarks.stochastic_map_kernels import POSE_SIZE, Estimate
from ratslam_ros.errors import UnusableInput

MAX_MOTION = 1e9
"""Motions with a larger distance in m or turn in rad are rejected."""

_ORIGIN = Pose(0.0, 0.0, 0.0)
_NO_COVARIANCE = np.zeros((POSE_SIZE, POSE_SIZE))


@dataclass(frozen=True, slots=True)
class Observed:
    """Result of the observations of one moment.

    Attributes:
        added: identifiers of the landmarks that are new in the map.
        updated: identifiers of the known landmarks that updated the map.
        repeated: identifiers of known landmarks that were seen from nearly the same place before
            (``repeat_m``) and did not update the map.
        rejected: identifiers of outliers, and of landmarks at the very place of the robot.
        squared: (n,) squared Mahalanobis distances of the innovations, outliers included; NaN
            for new and repeated landmarks. They follow a chi-square distribution if the noise is
            as assumed, with 2 degrees of freedom if landmark or observation is a point, else 4.
    """

    added: NDArray[np.int64]
    updated: NDArray[np.int64]
    repeated: NDArray[np.int64]
    rejected: NDArray[np.int64]
    squared: NDArray[np.float64]


def _offsets_fit(offsets: NDArray[np.int64], state: State) -> bool:
    """Return whether the offsets are those of the values, which the kernels find by them."""
    sizes, size = np.diff(offsets), int(offsets[-1])
    return (
        offsets[0] == POSE_SIZE and bool(np.isin(sizes, (POINT_SIZE, BAR_SIZE)).all())
        and len(sizes) == len(state['identifiers']) == len(state['updated_at_m'])
        and size == len(state['values']) == len(state['first_values'])
        and _triangle_size(size) == len(state['triangle'])
    )


class StochasticMap(Saved):
    """Pose of a robot and landmarks around it, estimated by an extended Kalman filter.

    The Jacobians are computed at the first estimates: landmarks where they were added, the pose
    where it was predicted. A filter with Jacobians at the latest estimates gains information on
    the absolute heading, which observations cannot provide, and becomes overconfident
    (Huang, Mourikis and Roumeliotis 2010).

    A landmark that was first seen as a point remains a point; directions and lengths of later
    observations are not used. An observation without them updates the position of a bar.
    """

    SAVED = (
        Field('values', '', 'f8', ('',), save=lambda own: own._state.x),
        Field('first_values', '', 'f8', ('',), save=lambda own: own._state.first),
        Field('triangle', '', 'f8', ('',), save=lambda own: own._state.p),
        Field('identifiers', '_identifiers', 'i8', ('',)),
        Field('offsets', '_offsets', 'i8', ('',), POSE_SIZE,
              fits=('where each landmark begins', _offsets_fit)),
        Field('travelled_m', '_travelled_m'), Field('updated_at_m', '_updated_at_m', 'f8', ('',)),
        count('outlier_count', 'outlier_count'),
    )

    def __init__(
        self, model: MapModel = MapModel(), pose: Pose = _ORIGIN,
        covariance: NDArray[np.float64] = _NO_COVARIANCE,
    ) -> None:
        """Start at a pose, which is known exactly unless a (3, 3) covariance is given.

        Raises:
            UnusableInput: the pose is not finite, or the covariance is invalid.
        """
        self._p = model
        self._variances = np.array([
            model.range_sd_m**2, model.bearing_sd_rad**2,
            model.direction_sd_rad**2, model.length_sd_m**2,
        ])
        self._state = Estimate(
            np.zeros(POSE_SIZE), np.zeros(POSE_SIZE), np.zeros(_triangle_size(POSE_SIZE))
        )
        self._offsets = np.array([POSE_SIZE], np.int64)
        self._identifiers = np.zeros(0, np.int64)
        self._index: dict[int, int] = {}
        self._travelled_m = 0.0
        self._updated_at_m = np.zeros(0)
        self.outlier_count = 0
        """Number of observations that were rejected as outliers."""
        self.move_to(pose, covariance)

    def __len__(self) -> int:
        """Return the number of landmarks."""
        return len(self._identifiers)

    @property
    def pose(self) -> Pose:
        """Estimated pose of the robot."""
        return Pose(*self._state.x[:POSE_SIZE].tolist())

    @property
    def pose_covariance(self) -> NDArray[np.float64]:
        """(3, 3) covariance of x and y in m and of the heading in rad."""
        return kernels.covariance_from(self._state.p, 0, POSE_SIZE)

    @property
    def identifiers(self) -> NDArray[np.int64]:
        """(n,) identifiers of the landmarks, in the order in which they were added."""
        return self._identifiers.copy()

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(d, d) joint covariance of the pose and all values of the landmarks."""
        return kernels.covariance_from(self._state.p, 0, len(self._state.x))

    def predict(self, forward_m: float, left_m: float, turn_rad: float) -> None:
        """Move the robot by odometry.

        Noise of the position grows with the distance, and noise of the heading with the distance
        and the angle. On a straight way the result is independent of the number of steps.

        Args:
            forward_m, left_m: displacement in the frame of the robot before the motion.
            turn_rad: change of the heading, counter-clockwise.

        Raises:
            UnusableInput: a value is not finite, or implausibly large.
        """
        motion = forward_m, left_m, turn_rad
        if not all(abs(value) <= MAX_MOTION for value in motion):
            raise UnusableInput(f'the motion is {motion}; expected finite m, m and rad')
        p = self._p
        kernels.predict(
            self._state, float(forward_m), float(left_m), float(turn_rad),
            p.odom_position_sd_m**2, p.odom_drift_sd_rad**2, p.odom_turn_sd_rad**2,
        )
        self._travelled_m += math.hypot(forward_m, left_m) + abs(turn_rad)

    def observe(self, observations: Observations) -> Observed:
        """Update the map by the landmarks that are seen at one moment, and add the unknown ones.

        Known landmarks come first, so that new ones are added at the corrected pose.

        Args:
            observations: landmarks with identifiers.

        Raises:
            UnusableObservations: identifiers are missing; the map is unchanged.
        """
        names, sizes = observations.names, observations.sizes
        z, variances = observations.values, self._variances_of(observations)
        index = np.array([self._index.get(name, -1) for name in names.tolist()], np.int64)
        is_known = index >= 0
        starts = np.where(is_known, self._offsets[index], -1)
        degrees = np.minimum(sizes, np.where(is_known, self._offsets[index + 1] - starts, sizes))
        # Of an unknown landmark, the last element counts.
        updated_at_m = np.append(self._updated_at_m, -math.inf)[index]
        is_repeated = updated_at_m > self._travelled_m - self._p.repeat_m
        results, squared = kernels.observe(
            self._state, self._offsets, starts, is_repeated, z, degrees, variances,
            self._p.outlier_probability,
        )
        is_updated, is_new = results == kernels.UPDATED, results == kernels.NEW
        self._updated_at_m[index[is_updated]] = self._travelled_m
        if is_new.any():
            self._add(names[is_new], z[is_new], sizes[is_new], variances[is_new])
        rejected = names[results == kernels.REJECTED]
        self.outlier_count += len(rejected)
        return Observed(names[is_new], names[is_updated], names[is_repeated], rejected, squared)

    def nearest(self, observations: Observations) -> NDArray[np.int64]:
        """Return the index of the nearest landmark for each observation.

        A pair has the same type and passes the chi-square test. The nearest pairs are formed
        first, and no landmark is used twice. Without a landmark the result is -1 for an unknown
        one, and -2 if the observation may be an outlier of a known one. Identifiers are not used.
        """
        return kernels.associate(
            self._state, self._offsets, observations.values, observations.sizes,
            self._variances_of(observations), self._p.outlier_probability,
        )

    def remove(self, identifiers: Iterable[int]) -> None:
        """Delete landmarks with their rows and columns of the covariance.

        The others are unchanged: this is the marginal distribution.

        Raises:
            KeyError: a landmark is not on the map, which is unchanged then.
        """
        removed = {self._index[int(identifier)] for identifier in identifiers}
        indices = [index for index in range(len(self)) if index not in removed]
        sizes = np.diff(self._offsets)[indices]
        kept = [np.arange(POSE_SIZE)]
        kept += [np.arange(self._offsets[i], self._offsets[i + 1]) for i in indices]
        self._state = kernels.without(self._state, np.concatenate(kept))
        self._updated_at_m = self._updated_at_m[indices]
        self._set_features(
            self._identifiers[indices],
            np.concatenate(([POSE_SIZE], POSE_SIZE + np.cumsum(sizes))).astype(np.int64),
        )

    def features(self) -> Features:
        """Return the landmarks in the frame of the map."""
        x, _, p = self._state
        return Features(
            self.identifiers, self._offsets - POSE_SIZE, x[POSE_SIZE:].copy(),
            kernels.covariance_from(p, POSE_SIZE, len(x)),
        )

    def seen_from_robot(self) -> Features:
        """Return the landmarks in the frame of the robot.

        Their covariance includes that of the pose and its correlation with the landmarks.
        """
        values, covariance = kernels.to_robot_frame(self._state, self._offsets)
        return Features(self.identifiers, self._offsets - POSE_SIZE, values, covariance)

    def move_to(self, pose: Pose, covariance: NDArray[np.float64]) -> None:
        """Set the pose and its covariance, as after a relocalisation.

        The new pose is uncorrelated with the landmarks. If it was computed from them, pass a wide
        covariance and then ``observe`` the landmarks that it was computed from.

        Args:
            pose: the new pose.
            covariance: (3, 3) of x and y in m and of the heading in rad.

        Raises:
            UnusableInput: the pose is not finite, or the covariance is not finite, symmetric and
                positive semi-definite.
        """
        block = np.asarray(covariance, np.float64)
        if not all(abs(value) <= MAX_MOTION for value in pose):
            raise UnusableInput(f'the pose is {tuple(pose)}; expected finite m, m and rad')
        if block.shape != _NO_COVARIANCE.shape or not _is_covariance(block):
            raise UnusableInput(
                f'the covariance of the pose is {block.tolist()}; expected a symmetric positive '
                'semi-definite 3x3 matrix'
            )
        x, first, p = self._state
        x[:POSE_SIZE] = pose.x_m, pose.y_m, wrap(float(pose.heading_rad))
        first[:POSE_SIZE] = x[:POSE_SIZE]
        for i in range(POSE_SIZE):
            p[_triangle_size(i) : _triangle_size(i + 1)] = block[i, : i + 1]
        for i in range(POSE_SIZE, len(x)):
            p[_triangle_size(i) : _triangle_size(i) + POSE_SIZE] = 0.0

    def move_origin(self) -> None:
        """Make the robot's pose the origin of the map, with no uncertainty.

        The uncertainty of the pose passes to the landmarks, as in robocentric mapping
        (Castellanos et al. 2007).
        """
        seen = self.seen_from_robot()
        self.move_to(_ORIGIN, _NO_COVARIANCE)
        x, first, p = self._state
        x[POSE_SIZE:] = seen.values
        first[:] = x
        for i, row in enumerate(seen.covariance):
            start = _triangle_size(POSE_SIZE + i) + POSE_SIZE
            p[start : start + i + 1] = row[: i + 1]

    def _restored(self, state: State) -> None:
        self._state = Estimate(*(
            np.array(state[key], np.float64) for key in ('values', 'first_values', 'triangle')
        ))
        self._set_features(self._identifiers, self._offsets)

    def _variances_of(self, seen: Observations) -> NDArray[np.float64]:
        """Return the (n, 4) variances of observations, by default those of the parameters."""
        if seen.variances is not None:
            return seen.variances
        return np.repeat(self._variances[np.newaxis], len(seen), axis=0)

    def _set_features(self, identifiers: NDArray[np.int64], offsets: NDArray[np.int64]) -> None:
        self._identifiers, self._offsets = identifiers, offsets
        self._index = {identifier: i for i, identifier in enumerate(identifiers.tolist())}

    def _add(
        self, identifiers: NDArray[np.int64], z: NDArray[np.float64], sizes: NDArray[np.int64],
        variances: NDArray[np.float64],
    ) -> None:
        self._state = kernels.extended(self._state, z, sizes, variances)
        self._set_features(
            np.concatenate((self._identifiers, identifiers)),
            np.concatenate((self._offsets, self._offsets[-1] + np.cumsum(sizes))),
        )
        added_at_m = np.full(len(identifiers), self._travelled_m)
        self._updated_at_m = np.concatenate((self._updated_at_m, added_at_m))


def _triangle_size(n: int) -> int:
    """Return the number of elements of n rows of the triangle."""
    return n * (n + 1) // 2


def _is_covariance(block: NDArray[np.float64]) -> bool:
    """Return whether a matrix is symmetric and positive semi-definite, up to rounding."""
    if not np.isfinite(block).all() or not np.allclose(block, block.T, rtol=1e-9, atol=0.0):
        return False
    eigenvalues = np.linalg.eigvalsh(block)
    return bool(eigenvalues[0] >= -1e-9 * eigenvalues[-1])
