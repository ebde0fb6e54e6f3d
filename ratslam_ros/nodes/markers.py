# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Markers of the experience map, for RViz and Foxglove."""

from __future__ import annotations

import math

from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ratslam_ros.core.landmarks.features import BAR_SIZE, Features
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.nodes.convert import header_of

PLACES = ColorRGBA(r=0.12, g=0.33, b=0.66, a=1.0)
LINKS = ColorRGBA(r=0.45, g=0.6, b=0.8, a=1.0)
SEPARATE = (
    ColorRGBA(r=0.8, g=0.47, b=0.65, a=1.0), ColorRGBA(r=0.9, g=0.62, b=0.0, a=1.0),
    ColorRGBA(r=0.34, g=0.71, b=0.91, a=1.0),
)  # fmt: skip
"""Colours of the experiences of components that are not joined with the first one, in turn."""
CURRENT = ColorRGBA(r=0.9, g=0.3, b=0.1, a=1.0)
LANDMARKS = ColorRGBA(r=0.0, g=0.62, b=0.45, a=1.0)

SHORTEST_BAR_M = 0.3
"""Length of the lines that show the directions of corners."""


def markers_of(experience_map: ExperienceMap, stamp_ns: int, frame_id: str) -> MarkerArray:
    """Return markers: links as lines, experiences as small spheres, the current one larger."""
    points = [Point(x=x, y=y, z=0.0) for x, y, _ in experience_map.poses.tolist()]
    links = _marker(0, 'links', Marker.LINE_LIST, 0.05, LINKS)
    for source, target in experience_map.link_ends.tolist():
        links.points.extend((points[source], points[target]))
    places = _marker(0, 'experiences', Marker.SPHERE_LIST, 0.15, PLACES)
    places.points.extend(points)
    components = experience_map.components
    if any(components):
        colours = [PLACES, *SEPARATE]
        places.colors.extend(colours[c and 1 + (c - 1) % len(SEPARATE)] for c in components)
    current = _marker(0, 'current', Marker.SPHERE_LIST, 0.4, CURRENT)
    if experience_map.current_id >= 0:
        current.points.append(points[experience_map.current_id])
    markers = [links, places, current]
    for marker in markers:
        marker.header = header_of(stamp_ns, frame_id)
    return MarkerArray(markers=markers)


def landmark_markers(features: Features, stamp_ns: int, frame_id: str) -> MarkerArray:
    """Return markers of bars: their positions as spheres, and a line along each."""
    corners = _marker(0, 'landmarks', Marker.SPHERE_LIST, 0.12, LANDMARKS)
    bars = _marker(1, 'directions', Marker.LINE_LIST, 0.03, LANDMARKS)
    for x, y, direction, length in features.values.reshape(-1, BAR_SIZE).tolist():
        shown_m = max(length, SHORTEST_BAR_M)
        ends = (x, y), (x + shown_m * math.cos(direction), y + shown_m * math.sin(direction))
        points = [Point(x=a, y=b, z=0.0) for a, b in ends]
        corners.points.append(points[0])
        bars.points.extend(points)
    for marker in (corners, bars):
        marker.header = header_of(stamp_ns, frame_id)
    return MarkerArray(markers=[corners, bars])


def _marker(number: int, namespace: str, kind: int, size_m: float, color: ColorRGBA) -> Marker:
    marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD, color=color)
    marker.scale.x = marker.scale.y = marker.scale.z = size_m
    marker.pose.orientation.w = 1.0
    return marker
