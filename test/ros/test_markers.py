# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Markers of the map are those of its experiences and links."""

from __future__ import annotations

from typing import Any

import pytest
from graphs import new_map
from helpers import ahead, turning
from rclpy.serialization import deserialize_message
from ros_messages import MakeWorld
from visualization_msgs.msg import MarkerArray

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.ros.mapping.markers import PLACES, SEPARATE, serialised_markers


def drive(count: int, gap_every: int = 1000) -> ExperienceMap:
    graph = new_map()
    for n in range(count):
        graph.apply(MapAction('create', graph.current_id, n, n, 0.0, Place(1.0, 2.0, 3.0)))
        graph.integrate(ahead(0.7))
        graph.integrate(turning(0.3))
        if (n + 1) % gap_every == 0:
            graph.integrate(Motion(1.0, 0.0, 0.0, is_known=False))
    return graph


@pytest.mark.parametrize(('frame_id', 'count', 'gap_every'), [
    ('map', 0, 9), ('the_map', 1, 9), ('a_map', 7, 9), ('maps4', 9, 2),  # four alignments
])
def test_serialised_markers_contain_the_map(
    world: MakeWorld, frame_id: str, count: int, gap_every: int
) -> None:
    graph = drive(count, gap_every)
    graph.frame_id = frame_id
    data = serialised_markers(graph, 1_700_000_012_500_000_000)
    links, places, current = deserialize_message(data, MarkerArray).markers

    def points(marker: Any) -> list[tuple[float, float, float]]:
        return [(point.x, point.y, point.z) for point in marker.points]

    expected = [(x, y, 0.0) for x, y, _ in graph.poses.tolist()]
    assert points(places) == expected
    assert points(links) == [expected[end] for ends in graph.link_ends for end in ends]
    is_placed = graph.current_id >= 0
    assert points(current) == ([expected[graph.current_id]] if is_placed else [])
    colours = [PLACES, *SEPARATE]
    shown = [(c.r, c.g, c.b, c.a) for c in places.colors]
    numbers = graph.components if any(graph.components) else []
    assert shown == [
        pytest.approx((c.r, c.g, c.b, c.a))
        for c in (colours[n and 1 + (n - 1) % 3] for n in numbers)
    ]
    for marker, name in ((links, 'links'), (places, 'experiences'), (current, 'current')):
        assert (marker.ns, marker.header.frame_id) == (name, frame_id)
        assert marker.header.stamp.nanosec == 500_000_000
        assert (marker.scale.x > 0.0, marker.pose.orientation.w) == (True, 1.0)
        assert (marker.text, marker.mesh_file.filename) == ('', '')
