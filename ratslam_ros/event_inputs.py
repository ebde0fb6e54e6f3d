# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of recordings and their events to the configuration and inputs of RatSLAM."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from ratslam_ros.core.common.mount import CENTRED, FrameTree, Mount
from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan, UnusableScan, checked_scan, scan_stream
from ratslam_ros.core.config import Config
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.errors import UnusableInput
from ratslam_ros.messages.json_schema import MalformedMessage, decode
from ratslam_ros.messages.mapping import TemplatePayload
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.recordings import (
    Event,
    ImageEvent,
    OdometryEvent,
    Recording,
    ScanEvent,
    Selection,
    UndecodableImage,
)

Input = tuple[str, int, Any]
"""Stream, stamp in ns, and item of an input, for ``RatSLAM.feed``."""


def recorded_inputs(
    recording: Recording, slam: RatSLAM, selection: Selection | None = None,
    start_s: float = 0.0, duration_s: float | None = None,
) -> Iterator[Input]:
    """Yield the inputs that a recording contains, in the order in which they were recorded.

    An image is None if it cannot be decoded. Scans and templates that cannot be used are left out,
    with a warning of the recording.

    Args:
        recording: the opened recording.
        slam: what they are for: whether it uses scans and colours is taken into account.
        selection: the topics to read; None: the only ones.
        start_s: recording time to start at, in s from the start of the recording.
        duration_s: length to read, in s; None reads to the end.

    Raises:
        UnusableInput: the topics or the span cannot be read.
    """
    if selection is None:
        selection = recording.select(scans='scan' in slam.pipeline.inputs)
    mounts, image = laser_mounts(recording, selection), None
    for event in recording.events(selection, start_s, duration_s):
        if isinstance(event, ImageEvent):
            try:
                colour = event.bgr() if slam.wants_colour else None
                image = PreparedImage(event.grey(slam.config.inputs.image_grey), colour=colour)
            except UndecodableImage:
                image = None
        try:
            yield input_from_event(event, mounts, image)
        except (UnusableScan, MalformedMessage) as error:
            recording.warn(f'a message was not used: {error}')


def input_from_event(event: Event, mounts: Sequence[Mount], image: object) -> Input:
    """Return the input that an event contains.

    Args:
        event: the event.
        mounts: where each laser sits on the robot, by its number.
        image: the image of an image event, None if it could not be decoded.

    Raises:
        UnusableScan, MalformedMessage: a scan or template cannot be used.
    """
    if isinstance(event, ImageEvent):
        return 'image', event.stamp_ns, image
    if isinstance(event, OdometryEvent):
        return 'odometry', event.stamp_ns, odometry_from_event(event)
    if isinstance(event, ScanEvent):
        scan = scan_from_event(event, mounts[event.laser])
        return scan_stream(scan.laser), scan.stamp_ns, scan
    template = decode(TemplatePayload, event.payload)
    return 'template', template.stamp.ns, template.match


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
        tree.add_stamped(transform)
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
