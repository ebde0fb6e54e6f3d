# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Covariance of the robot's pose in the map: the only measure of how uncertain the pose is.

Uncertain spatial relations after Smith, Self and Cheeseman (1990). The error of a pose is a small
motion (x, y, heading) in the robot's frame, so that a map that turns does not change it. Driving
compounds it with the noise of the odometry, and a recognised place or an aligned scan is a
measurement. It is relative to the place where the robot was recognised last, or to the start of
the map: the map itself may be displaced and bent, which later loop closures correct, but the robot
drives along the places around it.
"""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.saved import Field, Saved

Matrix = NDArray[np.float64]

CHI_SQUARE_3 = 11.345
"""99 % quantile of the chi-square distribution with 3 degrees of freedom, x, y and heading: the
bound within which a pose and a measurement agree."""

UNKNOWN_M2, UNKNOWN_RAD2 = 1e6, math.pi**2 / 3.0
"""Variances of a robot that may be anywhere: of a position, and of a uniform heading."""

UNCERTAIN_M = 0.75
"""Standard deviation of the position in its worst direction above which a pose is uncertain."""

Localisation = Literal['unknown', 'uncertain', 'localised']
"""What is known of the robot's pose on the map. `unknown`: there is no pose on this map, and the
estimate is dead reckoning from an arbitrary place. `uncertain`: the pose was given by an operator
and not confirmed yet, or its standard deviation exceeds 0.75 m. `localised`: recent recognitions
confirm it, or the map has just begun."""


def isotropic(std_m: float, std_rad: float) -> Matrix:
    """Return the covariance of a measured pose, from the deviations along each axis."""
    return np.diag([std_m * std_m, std_m * std_m, std_rad * std_rad])


UNKNOWN = isotropic(math.sqrt(UNKNOWN_M2), math.sqrt(UNKNOWN_RAD2))


class OdometryVariance(NamedTuple):
    """Variances that driving adds: position and heading per metre, heading per radian."""

    m2_per_m: float
    rad2_per_m: float = 0.0
    rad2_per_rad: float = 0.0


def _is_semidefinite(rows: Any) -> bool:
    matrix = np.array(rows)
    least: float = np.linalg.eigvalsh(matrix)[0]
    return np.array_equal(matrix, matrix.T) and least > -1e-6


class PoseCovariance(Saved):
    """Grows with the motion of the robot, and shrinks with measurements of its pose.

    A new map begins where the robot is, so its pose is exact there.
    """

    SAVED = (
        Field('matrix', 'matrix', float, (3, 3), load=lambda rows: np.array(rows, np.float64),
              fits=('a positive semidefinite matrix', lambda rows, _: _is_semidefinite(rows))),
        Field('unknown_because', 'reason', str),
        Field('relative', 'relative', float, (3, 3), load=lambda rows: np.array(rows, np.float64),
              when=lambda own: own.relative is not None,
              fits=('a positive semidefinite matrix', lambda rows, _: _is_semidefinite(rows))),
    )

    def __init__(self) -> None:
        self.matrix: Matrix = np.zeros((3, 3))
        """Covariance of x and y in m and heading in rad, in the robot's frame."""
        self.relative: Matrix | None = None
        """Part of it that is relative to the scan of the current experience, if it has one."""
        self.reason = ''
        """Why the pose is unknown, '' if it is known."""

    @property
    def position_std_m(self) -> float:
        """Standard deviation of the position in its worst direction."""
        return math.sqrt(largest_variance(self.matrix))

    @property
    def localisation(self) -> Localisation:
        """What the covariance means."""
        if self.reason:
            return 'unknown'
        return 'localised' if self.position_std_m <= UNCERTAIN_M else 'uncertain'

    def integrate(self, motion: Motion, noise: OdometryVariance) -> None:
        """Compound the error of the pose with that of a motion."""
        if self.reason:
            return
        step = moved(Pose(0.0, 0.0, 0.0), motion)
        compound(self.matrix, *step, abs(motion.distance_m), *noise)
        if self.relative is not None:
            compound(self.relative, *step, abs(motion.distance_m), *noise)
        if largest_variance(self.matrix) > UNKNOWN_M2 or self.matrix[2, 2] > UNKNOWN_RAD2:
            self.matrix, self.relative = UNKNOWN.copy(), None

    def lose(self, reason: str) -> None:
        """Make the pose unknown, for a reason that is shown to the user."""
        self.replace(UNKNOWN)
        self.reason = reason

    def replace(self, measured: Matrix) -> None:
        """Take over the covariance of a measurement that the pose was set to."""
        self.matrix, self.reason, self.relative = measured.copy(), '', None

    def align(self, relative: Matrix) -> None:
        """Take over the covariance relative to the scan of the current experience.

        It replaces the noise of the motion since, but not the error of that scan's place.
        """
        if self.reason:
            return
        if self.relative is not None:
            self.matrix -= self.relative
        self.matrix += relative
        self.relative = relative

    def fuse(self, measured: Matrix) -> None:
        """Take a measurement into account that the pose was corrected with, by Kalman's update."""
        self.replace(updated(self.matrix, measured))

    def limit(self, measured: Matrix) -> None:
        """Take a measurement into account whose error is that of earlier ones.

        Several scans or views of one place deviate in the same way: they are no better than one.
        """
        if self.reason or largest_variance(measured) < largest_variance(self.matrix):
            self.replace(measured)

    def agrees(self, here: Pose, claimed: Pose, measured: Matrix) -> bool:
        """Return whether a pose of the robot and a measured one agree.

        Args:
            here: pose of the robot.
            claimed: measured pose, in the same frame.
            measured: covariance of the measurement, in the robot's frame.
        """
        return squared_distance(here, claimed, self.matrix + measured) <= CHI_SQUARE_3

    def on_map(self, heading_rad: float) -> Matrix:
        """Return the (3, 3) covariance along the axes of the map, given the heading on it."""
        return turned(self.matrix, heading_rad)


def squared_distance(here: Pose, claimed: Pose, covariance: Matrix) -> float:
    """Return the squared Mahalanobis distance of two poses.

    Args:
        here, claimed: the poses, in one frame.
        covariance: (3, 3) of their difference, in the frame of ``here``; positive definite.
    """
    x_m, y_m, heading_rad = composed(inverse(here), claimed)
    error = np.array([[x_m], [y_m], [wrap(heading_rad)]])
    scaled = solved(covariance, error)
    return float(error[0, 0] * scaled[0, 0] + error[1, 0] * scaled[1, 0]
                 + error[2, 0] * scaled[2, 0])


@compiled
def solved(matrix: Matrix, columns: Matrix) -> Matrix:
    """Return M^-1 B of a positive definite (3, 3) matrix, by its Cholesky factors.

    NumPy's solver would have every node load LAPACK at its start.
    """
    lower = np.zeros((3, 3))
    for i in range(3):
        for j in range(i + 1):
            rest = matrix[i, j]
            for k in range(j):
                rest -= lower[i, k] * lower[j, k]
            lower[i, j] = math.sqrt(rest) if i == j else rest / lower[j, j]
    result = columns.copy()
    for column in range(columns.shape[1]):
        for i in range(3):
            for k in range(i):
                result[i, column] -= lower[i, k] * result[k, column]
            result[i, column] /= lower[i, i]
        for i in range(2, -1, -1):
            for k in range(i + 1, 3):
                result[i, column] -= lower[k, i] * result[k, column]
            result[i, column] /= lower[i, i]
    return result


@compiled
def compound(
    matrix: Matrix, x_m: float, y_m: float, heading_rad: float, distance_m: float,
    m2_per_m: float, rad2_per_m: float, rad2_per_rad: float,
) -> None:
    """Move the frame of a covariance with the robot, and add the noise of the motion, in place.

    Args:
        matrix: (3, 3) covariance of a pose in the robot's frame.
        x_m, y_m, heading_rad: the motion, in the frame before it.
        distance_m: distance driven.
        m2_per_m, rad2_per_m, rad2_per_rad: as in ``OdometryVariance``.
    """
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    # Adjoint of the inverse motion. An error of the heading displaces the end of the motion.
    adjoint = np.array(((c, s, s * x_m - c * y_m), (-s, c, c * x_m + s * y_m), (0.0, 0.0, 1.0)))
    matrix[:] = sandwiched(adjoint, matrix)
    matrix[0, 0] += m2_per_m * distance_m
    matrix[1, 1] += m2_per_m * distance_m
    matrix[2, 2] += rad2_per_m * distance_m + rad2_per_rad * abs(heading_rad)


@compiled
def sandwiched(a: Matrix, matrix: Matrix) -> Matrix:
    """Return a M a^T, symmetric to the last bit."""
    result = np.zeros((3, 3))
    for i in range(3):
        for j in range(i + 1):
            total = 0.0
            for k in range(3):
                for m in range(3):
                    total += a[i, k] * matrix[k, m] * a[j, m]
            result[i, j] = result[j, i] = total
    return result


@compiled
def turned(matrix: Matrix, heading_rad: float) -> Matrix:
    """Return a covariance along axes in which the present ones have a heading."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    rotation = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    return sandwiched(rotation, matrix)


@compiled
def updated(matrix: Matrix, measured: Matrix) -> Matrix:
    """Return the covariance after a measurement, (P^-1 + R^-1)^-1, in the form P (P + R)^-1 R.

    It holds for singular P as well, such as that of a new map.
    """
    gain = solved(matrix + measured, measured)
    result = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                result[i, j] += matrix[i, k] * gain[k, j]
    for i in range(3):
        for j in range(i):
            result[i, j] = result[j, i] = 0.5 * (result[i, j] + result[j, i])
    return result


@compiled
def largest_variance(matrix: Matrix) -> float:
    """Return the variance of the position in its worst direction."""
    mean = 0.5 * (matrix[0, 0] + matrix[1, 1])
    return mean + math.hypot(0.5 * (matrix[0, 0] - matrix[1, 1]), matrix[0, 1])
