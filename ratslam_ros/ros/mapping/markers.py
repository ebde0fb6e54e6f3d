# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Markers of the experience map, for RViz and Foxglove."""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import Point
from rclpy.serialization import serialize_message
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ratslam_ros.core.landmarks.features import BAR_SIZE, Features
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.ros.convert import header_of

PLACES = ColorRGBA(r=0.12, g=0.33, b=0.66, a=1.0)
LINKS = ColorRGBA(r=0.45, g=0.6, b=0.8, a=1.0)
SEPARATE = (
    ColorRGBA(r=0.8, g=0.47, b=0.65, a=1.0), ColorRGBA(r=0.9, g=0.62, b=0.0, a=1.0),
    ColorRGBA(r=0.34, g=0.71, b=0.91, a=1.0),
)
"""Colours of the experiences of components that are not joined with the first one, in turn."""
CURRENT = ColorRGBA(r=0.9, g=0.3, b=0.1, a=1.0)
LANDMARKS = ColorRGBA(r=0.0, g=0.62, b=0.45, a=1.0)

ELEMENT = Point(x=-7.31e-301, y=6.43e-302, z=-5.59e-303)
COLOUR_ELEMENT = ColorRGBA(r=-7.31e-31, g=6.43e-32, b=-5.59e-33, a=4.17e-34)
"""Elements that are replaced in the lists of a marker; no marker has such a place or colour."""
POINT_BYTES = np.array([ELEMENT.x, ELEMENT.y, ELEMENT.z], '<f8').tobytes()
COLOUR_BYTES = np.array(
    [COLOUR_ELEMENT.r, COLOUR_ELEMENT.g, COLOUR_ELEMENT.b, COLOUR_ELEMENT.a], '<f4'
).tobytes()
"""CDR of these elements. Their lengths are multiples of 8 bytes, so that replacing one by many
leaves what follows aligned."""
ONE = (1).to_bytes(4, 'little')

SHORTEST_BAR_M = 0.3
"""Length of the lines that show the directions of corners."""


def serialised_markers(experience_map: ExperienceMap, stamp_ns: int) -> bytes:
    """Return a MarkerArray in CDR: links as lines, experiences as spheres, the current one larger.

    A marker of 20,000 experiences would need as many objects, whose conversion takes 100 ms. The
    message is therefore serialised with one element in each long list, which is then replaced.
    """
    poses, ends = experience_map.poses, experience_map.link_ends
    points = np.zeros((len(poses), 3))
    points[:, :2] = poses[:, :2]
    links = _marker(0, 'links', Marker.LINE_LIST, 0.05, LINKS)
    places = _marker(0, 'experiences', Marker.SPHERE_LIST, 0.15, PLACES)
    current = _marker(0, 'current', Marker.SPHERE_LIST, 0.4, CURRENT)
    if experience_map.current_id >= 0:
        x, y, z = points[experience_map.current_id].tolist()
        current.points.append(Point(x=x, y=y, z=z))
    lists: list[tuple[bytes, bytes]] = []  # element and content, in the order of the message
    if len(ends):
        links.points.append(ELEMENT)
        lists.append((POINT_BYTES, points[ends.ravel()].tobytes()))
    if len(points):
        places.points.append(ELEMENT)
        lists.append((POINT_BYTES, points.tobytes()))
    components = experience_map.components
    if any(components):
        places.colors.append(COLOUR_ELEMENT)
        palette = np.array([(c.r, c.g, c.b, c.a) for c in (PLACES, *SEPARATE)], '<f4')
        numbers = np.array(components)
        numbers[numbers > 0] = 1 + (numbers[numbers > 0] - 1) % len(SEPARATE)
        lists.append((COLOUR_BYTES, palette[numbers].tobytes()))
    markers = [links, places, current]
    for marker in markers:
        marker.header = header_of(stamp_ns, experience_map.frame_id)
    data = bytes(serialize_message(MarkerArray(markers=markers)))
    parts, at = [], 0
    for element, content in lists:
        start = data.index(element, at)
        # The length of a list of points may be followed by four bytes of padding.
        count_at = start - 4 if data[start - 4 : start] == ONE else start - 8
        count = (len(content) // len(element)).to_bytes(4, 'little')
        parts += [data[at:count_at], count, data[count_at + 4 : start], content]
        at = start + len(element)
    return b''.join([*parts, data[at:]])


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
