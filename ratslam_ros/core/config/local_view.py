# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the local view."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import CROP_MAX, WHOLE, Section, parameter
from ratslam_ros.errors import UnusableParameter

LEAST_VT_MAX = 20
"""Smallest limit of the number of templates."""


@dataclass(frozen=True)
class LocalViewParameters(Section):
    """Place recognition: reduction of images to templates, and matching of templates."""

    image_crop_x_min: int = parameter(
        0, 'px', 0, 65535, 'Left edge of the image crop that is compared.',
        'the robot itself is seen at the left', 'more of the scene should count')  # fmt: skip
    image_crop_x_max: int = parameter(
        WHOLE, CROP_MAX, WHOLE, 65535, 'Right edge (exclusive) of the crop.',
        'more of the scene should count', 'the robot itself is seen at the right')  # fmt: skip
    image_crop_y_min: int = parameter(
        0, 'px', 0, 65535, 'Upper edge of the crop.',
        'sky or ceiling carry no information', 'landmarks are cut off')  # fmt: skip
    image_crop_y_max: int = parameter(
        WHOLE, CROP_MAX, WHOLE, 65535, 'Lower edge (exclusive) of the crop.',
        'landmarks are cut off', 'the robot itself or plain floor is seen below')  # fmt: skip
    vt_descriptor: str = parameter(
        'gradients', '', 0, 0,
        'Descriptor that images are reduced to: intensity (grey values, as in OpenRatSLAM), '
        'gradients (gradient orientations in cells), efficientnet (a pretrained network), the '
        'name of an installed descriptor, or the path of a model (.onnx).',
        'set to gradients if the light or the season changes, or as a first choice',
        'set to intensity to use a configuration of OpenRatSLAM')  # fmt: skip
    template_x_size: int = parameter(
        12, 'px, or cells of gradients', 1, 1024, 'Width of a template.',
        'different places look alike',
        'small deviations from the path prevent recognition')  # fmt: skip
    template_y_size: int = parameter(
        9, 'px, or cells of gradients', 1, 1024, 'Height of a template.',
        'different places look alike',
        'pitching of the camera prevents recognition')  # fmt: skip
    vt_match_threshold: float = parameter(
        -1.0, 'mean difference', 0.0, 1.0,
        'Largest difference at which a view is recognised as a known template. Automatic: about '
        'half the difference between views of unrelated places, which is measured while driving.',
        'known places are not recognised (ratslam tune proposes a value)',
        'different places are confused', automatic=True,
        runtime='at next message',
    )  # fmt: skip
    vt_match_ratio: float = parameter(
        -1.0, 'share of the difference between unrelated views', 0.0, 1.0,
        'If vt_match_threshold is automatic: largest difference of a match. Automatic: lower in '
        'environments with places that look alike, as odometry shows; odometry from a camera '
        'cannot.',
        'known places are not recognised',
        'places that look alike, or neighbouring places, are confused',
        automatic=True,
        runtime='at next message',
    )  # fmt: skip
    vt_shift_match: int = parameter(
        1, 'template px', 0, 511,
        'Largest horizontal shift tried to either side (forward camera).',
        'the robot passes places with other headings or in other lanes',
        'different places look alike',
    )  # fmt: skip
    vt_shift_fov_deg: float = parameter(
        0.0, 'deg; 0: no', 0.0, 180.0,
        'Horizontal field of view of the cropped image (forward camera). With it, the shift of '
        'the best match gives the heading relative to the template.',
        'the camera is on the turning axis of a robot between walls, so that shifts are caused '
        'by turns: set it to the field of view',
        'shifts are caused by lane changes, as on a road: set it to 0, as in OpenRatSLAM',
    )  # fmt: skip
    vt_step_match: int = parameter(
        1, 'template px', 1, 511, 'Step between the shifts tried.', 'matching is too slow',
        'views between the steps are not recognised')  # fmt: skip
    vt_shift_match_y: int = parameter(
        1, 'template px', 0, 511, 'Largest vertical shift tried up and down.',
        'the camera pitches, or passes places at other distances', 'different places look alike',
    )  # fmt: skip
    vt_recent_templates: int = parameter(
        -1, 'templates; 0: off', 0, 100_000,
        'Number of newest templates that are matched with vt_recent_threshold. Automatic: the '
        'newest ones back to the first that does not match the view.',
        'slow driving matches the latest templates instead of learning new ones',
        'a loop is shorter than this many templates', automatic=True,
        runtime='at next message',
    )  # fmt: skip
    vt_recent_threshold: float = parameter(
        0.45, 'share of vt_match_threshold', 0.0, 1.0,
        'Stricter threshold for the newest templates, by which a new stretch is learned in finer '
        'steps.',
        'too many templates are learned', 'one template covers too long a stretch',
        runtime='at next message',
    )  # fmt: skip
    vt_max: int = parameter(
        0, 'templates; 0: any number', 0, 100_000_000,
        'Limit of the number of templates. At the limit, each new template replaces one that is '
        'selected by its freshness (forget_share and forget_after_s). A '
        'view of a removed template is learned again under a new number.',
        'places are forgotten that are still needed',
        'the templates take too much memory, or matching is too slow',
    )  # fmt: skip
    vt_normalisation: float = parameter(
        0.0, 'mean brightness; 0: off', 0.0, 1.0, 'Scale every view to this mean brightness.',
        'the brightness of the whole image varies', 'bright parts saturate at white',
    )  # fmt: skip
    vt_normalise_range: bool = parameter(
        False, '', 0, 1,
        'Divide every view by its range, from its darkest to its brightest pixel. With '
        'vt_normalisation, the mean becomes that; without, the darkest pixel becomes 0 and the '
        'brightest 1. Only for vt_descriptor: intensity.',
        'the contrast of the whole image varies, as in haze or dusk',
        'a single lamp or reflection determines the range',
    )  # fmt: skip
    vt_patch_normalise: int = parameter(
        0, 'template px; 0: off', 0, 128,
        'Normalise each pixel by the mean and standard deviation of the square patch of this '
        'radius around it.',
        'shadows or local lighting vary', 'noise in plain areas is amplified')  # fmt: skip
    vt_min_patch_normalisation_std: float = parameter(
        0.0, 'of brightness 0 to 1', 0.0, 1.0,
        'Patches with a standard deviation below this count as uniform and become 0.5.',
        'noise in plain areas is amplified', 'faint texture should count')  # fmt: skip
    vt_min_structure: float = parameter(
        0.03, 'of brightness 0 to 1; 0: off', 0.0, 1.0,
        'Images with less structure (root mean square of the brightness gradient per pixel, at a '
        'size of 48 x 36 px) are neither recognised nor learned. Sensor noise has up to 0.023.',
        'blank walls or dark images are confused',
        'faint scenes should be recognised',
        runtime='at next message',
    )  # fmt: skip
    vt_panoramic: bool = parameter(
        False, '', 0, 1, 'The camera sees 360 degrees: views are compared at every rotation.',
        'the camera is panoramic', 'the camera looks forward')  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0 < self.vt_max < LEAST_VT_MAX:
            raise UnusableParameter(
                f'vt_max is {self.vt_max}; expected 0 (any number) or at least {LEAST_VT_MAX}, so '
                'that the templates of the present place are kept'
            )
        if not self.vt_panoramic and 2 * self.vt_shift_match >= self.template_x_size:
            raise UnusableParameter(
                f'vt_shift_match is {self.vt_shift_match}; expected less than half of '
                f'template_x_size ({self.template_x_size}), so that columns are left to compare'
            )
        if 2 * self.vt_shift_match_y >= self.template_y_size:
            raise UnusableParameter(
                f'vt_shift_match_y is {self.vt_shift_match_y}; expected less than half of '
                f'template_y_size ({self.template_y_size}), so that rows are left to compare'
            )
