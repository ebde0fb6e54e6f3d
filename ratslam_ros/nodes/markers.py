# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Markers of the experience map, for RViz and Foxglove."""

from __future__ import annotations

from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

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


def _marker(number: int, namespace: str, kind: int, size_m: float, color: ColorRGBA) -> Marker:
    marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD, color=color)
    marker.scale.x = marker.scale.y = marker.scale.z = size_m
    marker.pose.orientation.w = 1.0
    return marker
