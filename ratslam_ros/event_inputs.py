# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of recordings and their events to the configuration and inputs of RatSLAM."""

from __future__ import annotations

from dataclasses import replace

from ratslam_ros.core.common.mount import CENTRED, FrameTree, Mount
from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan, checked_scan
from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings import OdometryEvent, Recording, ScanEvent, Selection


def odometry_from_event(event: OdometryEvent) -> Odometry:
    """Return the twist and the planar pose of an odometry event."""
    return Odometry(
        event.stamp_ns,
        Twist(event.linear_x, event.angular_z, event.linear_y),
        Pose(event.x, event.y, event.heading_rad),
    )


def laser_mounts(recording: Recording, selection: Selection) -> list[Mount]:
    """Return ``laser_mount`` of each laser, by its number."""
    return [
        laser_mount(recording, replace(selection, scan_topic=topic))
        for topic in selection.scan_topics
    ]


def laser_mount(recording: Recording, selection: Selection) -> Mount:
    """Return where the laser of the selected scans, which must be the only one, is mounted.

    If the recording does not tell, it is taken to be at the centre and to look ahead, with a
    warning of the recording if its frame is not that of the robot.

    Raises:
        UnusableMount: the scans are not parallel to the floor.
    """
    frames = None if selection.scan_topic is None else recording.laser_frames(selection)
    if frames is None:
        return CENTRED
    tree = FrameTree()
    for transform in frames.transforms:
        tree.add(*transform)
    mount = tree.mount_of(frames.laser, frames.base)
    if mount is None:
        recording.warn(
            f'the recording has no transform from {frames.base} to {frames.laser} on /tf_static '
            "or /tf: the laser is taken to sit at the robot's centre and to look ahead; record "
            '/tf_static if it does not'
        )
        return CENTRED
    return mount


def check_lasers(selection: Selection, topics: tuple[str, ...]) -> None:
    """Check that scans are read for each laser of ``experience_map.scan_topics``, or none at all.

    Raises:
        UnusableInput: another number of lasers was selected.
    """
    read = len(selection.scan_topics)
    if read not in (0, len(topics)):
        raise UnusableInput(
            f'the scans of {selection.scan_topic} are read, but experience_map.scan_topics names '
            f'{len(topics)} lasers ({",".join(topics)}): name as many topics with --scan-topic, '
            'separated by commas and in the same order'
        )


def scan_from_event(event: ScanEvent, mount: Mount = CENTRED) -> Scan:
    """Return the checked scan of an event.

    Args:
        event: the event.
        mount: where the laser sits on the robot.

    Raises:
        UnusableScan: angles, range limits or number of beams are invalid.
    """
    scan = checked_scan(
        event.stamp_ns,
        event.angle_min_rad,
        event.angle_increment_rad,
        event.range_min_m,
        event.range_max_m,
        event.ranges_m,
        mount,
    )
    return replace(scan, laser=event.laser) if event.laser else scan


def head_of(selection: Selection) -> str:
    """Return the stage that takes the selected topics."""
    if selection.template_topic is not None:
        return 'pose_cells'
    visual_odometry = selection.odom_topic is None and selection.image_topic is not None
    return 'visual_odometry' if visual_odometry else 'local_view'


def calibrated(config: Config, recording: Recording, selection: Selection) -> Config:
    """Return the configuration with the field of view of the recorded calibration.

    The node visual_odometry computes it from camera_info in the same way.
    """
    camera = recording.calibration(selection)
    if camera is None or not config.visual_odometry.fov_from_camera_info:
        return config
    from ratslam_ros.core.vision.visual_odometry import field_of_view_deg  # imports Numba

    fov_deg = field_of_view_deg(camera.focal_px, camera.width_px)
    return config.with_values({'visual_odometry.camera_fov_deg': fov_deg})
