# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the local view."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.inputs import CROP_MAX, WHOLE, ImageInput, Memory
from ratslam_ros.core.config.parameter import parameter
from ratslam_ros.errors import UnusableParameter


@dataclass(frozen=True)
class LocalViewParameters(ImageInput, Memory):
    """What a view is reduced to, and when it counts as seen before."""

    image_crop_x_min: int = parameter(
        0, 'px', 0, 65535, 'Left edge of the part of the image that is compared.',
        'the robot itself is seen at the left', 'more of the scene should count')  # fmt: skip
    image_crop_x_max: int = parameter(
        WHOLE, CROP_MAX, WHOLE, 65535, 'Right edge (exclusive) of that part.',
        'more of the scene should count', 'the robot itself is seen at the right')  # fmt: skip
    image_crop_y_min: int = parameter(
        0, 'px', 0, 65535, 'Upper edge of that part.',
        'sky or ceiling carry no information', 'landmarks are cut off')  # fmt: skip
    image_crop_y_max: int = parameter(
        WHOLE, CROP_MAX, WHOLE, 65535, 'Lower edge (exclusive) of that part.',
        'landmarks are cut off', 'the robot itself or plain floor is seen below')  # fmt: skip
    template_x_size: int = parameter(
        60, 'px', 1, 1024, 'Width of a template.', 'different places look alike',
        'small differences of the path spoil recognition')  # fmt: skip
    template_y_size: int = parameter(
        10, 'px', 1, 1024, 'Height of a template.', 'different places look alike',
        'pitching of the camera spoils recognition')  # fmt: skip
    vt_match_threshold: float = parameter(
        0.03, 'mean difference', 0.0, 1.0,
        'A view at most this different from a template is recognised as that template.',
        'known places are not recognised (ratslam tune proposes a value)',
        'different places are confused')  # fmt: skip
    vt_shift_match: int = parameter(
        5, 'template px', 0, 511, 'Horizontal shifts tried to either side (forward camera).',
        'the robot passes places at other headings or lanes', 'different places look alike',
    )  # fmt: skip
    vt_shift_fov_deg: float = parameter(
        0.0, 'deg; 0: no', 0.0, 180.0,
        'Angle that the template shows, after cropping: the shift at which a view fits then tells '
        'how the robot is turned against when the template was learned (forward camera).',
        'set to the angle where shifts are turns: a camera on the axis of a robot among walls',
        'set to 0 where shifts are lanes, as on a road; 0 is as OpenRatSLAM',
    )  # fmt: skip
    vt_step_match: int = parameter(
        1, 'template px', 1, 511, 'Step between the shifts tried.', 'matching is too slow',
        'recognition misses views between the steps')  # fmt: skip
    vt_shift_match_y: int = parameter(
        0, 'template px', 0, 511, 'Vertical shifts tried to either side.',
        'the camera pitches, or passes places nearer or further', 'different places look alike',
    )  # fmt: skip
    vt_recent_templates: int = parameter(
        0, 'templates; 0: off', 0, 100_000,
        'This many of the newest templates are recognised only by vt_recent_threshold.',
        'standing or slow driving names old templates in place of learning new ones',
        'a loop is shorter than this many templates')  # fmt: skip
    vt_recent_threshold: float = parameter(
        0.5, 'share of vt_match_threshold', 0.0, 1.0,
        'The threshold of the newest templates: how finely a new stretch is learned.',
        'too many templates are learned', 'a template covers too long a stretch')  # fmt: skip
    vt_normalisation: float = parameter(
        0.0, 'mean brightness; 0: off', 0.0, 1.0, 'Scale every view to this mean brightness.',
        'the brightness of the whole image varies', 'bright parts are cut off at white',
    )  # fmt: skip
    vt_patch_normalise: int = parameter(
        0, 'template px; 0: off', 0, 128,
        'Normalise each pixel by mean and deviation of the patch this far around it.',
        'shadows or local light vary', 'noise in plain areas is blown up')  # fmt: skip
    vt_min_patch_normalisation_std: float = parameter(
        0.0, 'of brightness 0 to 1', 0.0, 1.0,
        'Patches with a deviation below this count as plain (0.5).',
        'noise in plain areas is blown up', 'faint texture should count')  # fmt: skip
    vt_panoramic: bool = parameter(
        False, '', 0, 1, 'The camera sees the full circle: compare at every turn of the view.',
        'the camera is panoramic', 'the camera looks forward')  # fmt: skip
    vt_exact_error: bool = parameter(
        True, '', 0, 1, 'Find the least error of an unknown view too; else it is told as -1.',
        'you look at how near unknown views came to the threshold',
        'there are hundreds of thousands of templates: only the error of unknown views is lost'
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.vt_panoramic and 2 * self.vt_shift_match >= self.template_x_size:
            raise UnusableParameter(
                f'vt_shift_match is {self.vt_shift_match}; expected less than half of '
                f'template_x_size ({self.template_x_size}), so that something is left to compare'
            )
        if 2 * self.vt_shift_match_y >= self.template_y_size:
            raise UnusableParameter(
                f'vt_shift_match_y is {self.vt_shift_match_y}; expected less than half of '
                f'template_y_size ({self.template_y_size}), so that something is left to compare'
            )
