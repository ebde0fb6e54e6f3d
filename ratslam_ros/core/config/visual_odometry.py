# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of visual odometry."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import CROP_MAX, WHOLE, Section, parameter


@dataclass(frozen=True)
class VisualOdometryParameters(Section):
    """Estimation of speed and turn rate from camera images."""

    vtrans_image_x_min: int = parameter(
        0, 'px', 0, 65535, 'Left edge of the window in which speed is measured.',
        'the robot itself is seen at the left', 'more of the scene should count')  # fmt: skip
    vtrans_image_x_max: int = parameter(
        WHOLE, CROP_MAX, WHOLE, 65535, 'Right edge (exclusive) of the speed window.',
        'more of the scene should count', 'the robot itself is seen at the right')  # fmt: skip
    vtrans_image_y_min: int = parameter(
        0, 'px', 0, 65535, 'Upper edge of the speed window.',
        'sky or distant walls, which hardly move in the image, reduce the measured speed',
        'the ground nearby is blurred')  # fmt: skip
    vtrans_image_y_max: int = parameter(
        WHOLE, CROP_MAX, WHOLE, 65535, 'Lower edge (exclusive) of the speed window.',
        'too little of the ground is seen', 'the robot itself is seen below')  # fmt: skip
    vrot_image_x_min: int = parameter(
        0, 'px', 0, 65535, 'Left edge of the window in which the turn rate is measured.',
        'the robot itself is seen at the left', 'fast turns exceed the window')  # fmt: skip
    vrot_image_x_max: int = parameter(
        WHOLE, CROP_MAX, WHOLE, 65535, 'Right edge (exclusive) of the turn window.',
        'fast turns exceed the window', 'the robot itself is seen at the right')  # fmt: skip
    vrot_image_y_min: int = parameter(
        0, 'px', 0, 65535, 'Upper edge of the turn window.',
        'a featureless ceiling or sky weakens the profile',
        'distant objects, which move in the image by rotation only, are cut off')  # fmt: skip
    vrot_image_y_max: int = parameter(
        WHOLE, CROP_MAX, WHOLE, 65535, 'Lower edge (exclusive) of the turn window.',
        'distant objects, which move in the image by rotation only, are cut off',
        'the ground, which moves in the image with the speed, disturbs the turn rate')  # fmt: skip
    vrot_height_share: float = parameter(
        0.5, '', 0.05, 1.0,
        'Share of the height of the turn window that is used, from its upper edge.',
        'the upper part of the image is featureless',
        'the ground, which moves in the image with the speed, disturbs the turn rate; 0.5 uses '
        'the upper half, whatever the size of the image')  # fmt: skip
    vrot_subpixel: bool = parameter(
        True, '', 0, 1,
        'Measure the turn rate to a fraction of a pixel, from profiles without their mean, which '
        'varies with the exposure. Images of any width are measured as if they were 160 px wide, '
        'also for the speed.',
        'the map must not depend on the size of the images',
        'results must be those of OpenRatSLAM',
    )  # fmt: skip
    camera_fov_deg: float = parameter(
        50.0, 'deg', 1.0, 360.0, 'Horizontal field of view of the whole image.',
        'measured turns are too small', 'measured turns are too large')  # fmt: skip
    camera_hz: float = parameter(
        10.0, 'Hz', 0.01, 1000.0,
        'Frame rate for which vtrans_scaling was chosen; time intervals come from the stamps.',
        'the measured speed is too high', 'the measured speed is too low')  # fmt: skip
    vtrans_scaling: float = parameter(
        100.0, 'm/s per unit of profile difference', 0.0, 1e6,
        'Speed per unit of difference between successive profiles.',
        'the map is too small', 'the map is too large',
        runtime='at next message',
    )  # fmt: skip
    vtrans_max: float = parameter(
        20.0, 'm/s', 0.0, 1000.0, 'Upper limit of the measured speed.', 'fast driving is cut off',
        'changes of light cause bursts of speed',
        runtime='at next message',
    )  # fmt: skip
    fov_from_camera_info: bool = parameter(
        True, '', 0, 1,
        'Use the field of view from camera_info if it is recorded or published. Live, images wait '
        'for the first camera_info message.',
        'the camera is calibrated', 'camera_info is wrong',
    )  # fmt: skip
    publish_tf: bool = parameter(
        False, '', 0, 1, 'Live only: publish odom_frame -> base_frame on /tf.',
        'no other node publishes it', 'the robot publishes it',
        runtime='at once',
    )  # fmt: skip
    odom_frame: str = parameter(
        'odom', '', 0, 0, 'Live only: frame of the integrated pose.',
        "set to the name of the robot's odometry frame",
        'leave as it is if no other node uses another name',
    )  # fmt: skip
    base_frame: str = parameter(
        'base_link', '', 0, 0, 'Live only: frame of the robot.',
        "set to the name of the robot's base frame",
        'leave as it is if no other node uses another name',
    )  # fmt: skip
