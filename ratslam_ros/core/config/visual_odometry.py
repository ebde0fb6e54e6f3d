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
        0, 'Left edge of the window in which speed is measured.', unit='px', low=0, high=65535,
        raise_if='the robot itself is seen at the left', lower_if='more of the scene should count',
    )
    vtrans_image_x_max: int = parameter(
        WHOLE, 'Right edge (exclusive) of the speed window.', unit=CROP_MAX, low=WHOLE, high=65535,
        raise_if='more of the scene should count',
        lower_if='the robot itself is seen at the right',
    )
    vtrans_image_y_min: int = parameter(
        0, 'Upper edge of the speed window.', unit='px', low=0, high=65535,
        raise_if='sky or distant walls, which hardly move in the image, reduce the measured speed',
        lower_if='the ground nearby is blurred',
    )
    vtrans_image_y_max: int = parameter(
        WHOLE, 'Lower edge (exclusive) of the speed window.', unit=CROP_MAX, low=WHOLE, high=65535,
        raise_if='too little of the ground is seen', lower_if='the robot itself is seen below',
    )
    vrot_image_x_min: int = parameter(
        0, 'Left edge of the window in which the turn rate is measured.',
        unit='px', low=0, high=65535,
        raise_if='the robot itself is seen at the left', lower_if='fast turns exceed the window',
    )
    vrot_image_x_max: int = parameter(
        WHOLE, 'Right edge (exclusive) of the turn window.', unit=CROP_MAX, low=WHOLE, high=65535,
        raise_if='fast turns exceed the window', lower_if='the robot itself is seen at the right',
    )
    vrot_image_y_min: int = parameter(
        0, 'Upper edge of the turn window.', unit='px', low=0, high=65535,
        raise_if='a featureless ceiling or sky weakens the profile',
        lower_if='distant objects, which move in the image by rotation only, are cut off',
    )
    vrot_image_y_max: int = parameter(
        WHOLE, 'Lower edge (exclusive) of the turn window.', unit=CROP_MAX, low=WHOLE, high=65535,
        raise_if='distant objects, which move in the image by rotation only, are cut off',
        lower_if='the ground, which moves in the image with the speed, disturbs the turn rate',
    )
    vrot_height_share: float = parameter(
        0.5, 'Share of the height of the turn window that is used, from its upper edge.',
        low=0.05, high=1.0,
        raise_if='the upper part of the image is featureless',
        lower_if='the ground, which moves in the image with the speed, disturbs the turn rate; '
        '0.5 uses the upper half, whatever the size of the image',
    )
    vrot_subpixel: bool = parameter(
        True,
        'Measure the turn rate to a fraction of a pixel, from profiles without their mean, which '
        'varies with the exposure. Images of any width are measured as if they were 160 px wide, '
        'also for the speed.',
        raise_if='the map must not depend on the size of the images',
        lower_if='results must be those of OpenRatSLAM',
    )
    camera_fov_deg: float = parameter(
        50.0, 'Horizontal field of view of the whole image.', unit='deg', low=1.0, high=360.0,
        raise_if='measured turns are too small', lower_if='measured turns are too large',
    )
    camera_hz: float = parameter(
        10.0,
        'Frame rate for which vtrans_scaling was chosen; time intervals come from the stamps.',
        unit='Hz', low=0.01, high=1000.0,
        raise_if='the measured speed is too high', lower_if='the measured speed is too low',
    )
    vtrans_scaling: float = parameter(
        100.0, 'Speed per unit of difference between successive profiles.',
        unit='m/s per unit of profile difference', low=0.0, high=1e6,
        raise_if='the map is too small', lower_if='the map is too large',
        runtime='at next message',
    )
    vtrans_max: float = parameter(
        20.0, 'Upper limit of the measured speed.', unit='m/s', low=0.0, high=1000.0,
        raise_if='fast driving is cut off', lower_if='changes of light cause bursts of speed',
        runtime='at next message',
    )
    fov_from_camera_info: bool = parameter(
        True,
        'Use the field of view from camera_info if it is recorded or published. Live, images '
        'wait for the first camera_info message.',
        raise_if='the camera is calibrated', lower_if='camera_info is wrong',
    )
    publish_tf: bool = parameter(
        False, 'Live only: publish odom_frame -> base_frame on /tf.',
        raise_if='no other node publishes it', lower_if='the robot publishes it',
        runtime='at once',
    )
    odom_frame: str = parameter(
        'odom', 'Live only: frame of the integrated pose.',
        raise_if="set to the name of the robot's odometry frame",
        lower_if='leave as it is if no other node uses another name',
    )
    base_frame: str = parameter(
        'base_link', 'Live only: frame of the robot.',
        raise_if="set to the name of the robot's base frame",
        lower_if='leave as it is if no other node uses another name',
    )
