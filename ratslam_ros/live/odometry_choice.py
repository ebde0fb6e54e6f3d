# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam launch --odometry``: odometry of the robot, or estimated from the camera."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ratslam_ros.console import print_notice
from ratslam_ros.live import graph, ros
from ratslam_ros.starting import announced

TOPIC, CAMERA, AUTO = CHOICES = 'topic', 'camera', 'auto'
"""Values of the option."""

ODOMETRY_WAIT_S = 2.0
"""Time after the first publisher of images in which that of the odometry must be visible."""

IMAGE_TOPICS = 'image', 'image/compressed'
ODOMETRY_TOPIC = 'odom'


def is_estimated(odometry: str, ros_arguments: Sequence[str]) -> bool:
    """Return whether odometry is estimated from the camera; decide and print it for ``auto``.

    The decision is made before the nodes start, so it precedes all their inputs. It depends on
    the publishers alone: a player or driver that waits for subscribers sends nothing until then.

    Args:
        odometry: one of `CHOICES`.
        ros_arguments: what follows ``--ros-args`` for the nodes.
    """
    if odometry != AUTO:
        return odometry == CAMERA
    ros.require()
    with ros.node('odometry_choice', ros_arguments) as node:
        *images, odom = map(node.resolve_topic_name, (*IMAGE_TOPICS, ODOMETRY_TOPIC))
        print_notice(f'ratslam launch: waiting for a publisher of {" or ".join(images)}')
        graph.until(lambda: any(map(node.count_publishers, images)), math.inf)
        with announced('launch'):
            is_published = graph.until(lambda: node.count_publishers(odom) > 0, ODOMETRY_WAIT_S)
    print_notice(
        f'ratslam launch: odometry of {odom}, which has a publisher' if is_published
        else f'ratslam launch: odometry from the camera: {odom} has no publisher '
        f'{ODOMETRY_WAIT_S:g} s after the first one of images'
    )  # fmt: skip
    return not is_published
