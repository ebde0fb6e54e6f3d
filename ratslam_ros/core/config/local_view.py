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
        0, 'Left edge of the image crop that is compared.', unit='px', low=0, high=65535,
        raise_if='the robot itself is seen at the left', lower_if='more of the scene should count',
    )
    image_crop_x_max: int = parameter(
        WHOLE, 'Right edge (exclusive) of the crop.', unit=CROP_MAX, low=WHOLE, high=65535,
        raise_if='more of the scene should count',
        lower_if='the robot itself is seen at the right',
    )
    image_crop_y_min: int = parameter(
        0, 'Upper edge of the crop.', unit='px', low=0, high=65535,
        raise_if='sky or ceiling carry no information', lower_if='landmarks are cut off',
    )
    image_crop_y_max: int = parameter(
        WHOLE, 'Lower edge (exclusive) of the crop.', unit=CROP_MAX, low=WHOLE, high=65535,
        raise_if='landmarks are cut off', lower_if='the robot itself or plain floor is seen below',
    )
    vt_descriptor: str = parameter(
        'gradients',
        'Descriptor that images are reduced to: intensity (grey values, as in OpenRatSLAM), '
        'gradients (gradient orientations in cells), efficientnet (a pretrained network), the '
        'name of an installed descriptor, or the path of a model (.onnx).',
        raise_if='set to gradients if the light or the season changes, or as a first choice',
        lower_if='set to intensity to use a configuration of OpenRatSLAM',
    )
    template_x_size: int = parameter(
        12, 'Width of a template.', unit='px, or cells of gradients', low=1, high=1024,
        raise_if='different places look alike',
        lower_if='small deviations from the path prevent recognition',
    )
    template_y_size: int = parameter(
        9, 'Height of a template.', unit='px, or cells of gradients', low=1, high=1024,
        raise_if='different places look alike',
        lower_if='pitching of the camera prevents recognition',
    )
    vt_match_threshold: float = parameter(
        -1.0,
        'Largest difference at which a view is recognised as a known template. Automatic: about '
        'half the difference between views of unrelated places, which is measured while driving.',
        unit='mean difference', low=0.0, high=1.0, automatic=True,
        raise_if='known places are not recognised (ratslam tune proposes a value)',
        lower_if='different places are confused', runtime='at next message',
    )
    vt_match_ratio: float = parameter(
        -1.0,
        'If vt_match_threshold is automatic: largest difference of a match. Automatic: lower in '
        'environments with places that look alike, as odometry shows; odometry from a camera '
        'cannot.',
        unit='share of the difference between unrelated views', low=0.0, high=1.0, automatic=True,
        raise_if='known places are not recognised',
        lower_if='places that look alike, or neighbouring places, are confused',
        runtime='at next message',
    )
    vt_shift_match: int = parameter(
        1, 'Largest horizontal shift tried to either side (forward camera).',
        unit='template px', low=0, high=511,
        raise_if='the robot passes places with other headings or in other lanes',
        lower_if='different places look alike',
    )
    vt_shift_fov_deg: float = parameter(
        0.0,
        'Horizontal field of view of the cropped image (forward camera). With it, the shift of '
        'the best match gives the heading relative to the template.',
        unit='deg; 0: no', low=0.0, high=180.0,
        raise_if='the camera is on the turning axis of a robot between walls, so that shifts are '
        'caused by turns: set it to the field of view',
        lower_if='shifts are caused by lane changes, as on a road: set it to 0, as in OpenRatSLAM',
    )
    vt_step_match: int = parameter(
        1, 'Step between the shifts tried.', unit='template px', low=1, high=511,
        raise_if='matching is too slow', lower_if='views between the steps are not recognised',
    )
    vt_shift_match_y: int = parameter(
        1, 'Largest vertical shift tried up and down.', unit='template px', low=0, high=511,
        raise_if='the camera pitches, or passes places at other distances',
        lower_if='different places look alike',
    )
    vt_recent_templates: int = parameter(
        -1,
        'Number of newest templates that are matched with vt_recent_threshold. Automatic: the '
        'newest ones back to the first that does not match the view.',
        unit='templates; 0: off', low=0, high=100_000, automatic=True,
        raise_if='slow driving matches the latest templates instead of learning new ones',
        lower_if='a loop is shorter than this many templates', runtime='at next message',
    )
    vt_recent_threshold: float = parameter(
        0.45,
        'Stricter threshold for the newest templates, by which a new stretch is learned in finer '
        'steps.',
        unit='share of vt_match_threshold', low=0.0, high=1.0,
        raise_if='too many templates are learned',
        lower_if='one template covers too long a stretch', runtime='at next message',
    )
    vt_max: int = parameter(
        0,
        'Limit of the number of templates. At the limit, each new template replaces one that is '
        'selected by its freshness (forget_share and forget_after_s). A view of a removed '
        'template is learned again under a new number.',
        unit='templates; 0: any number', low=0, high=100_000_000,
        raise_if='places are forgotten that are still needed',
        lower_if='the templates take too much memory, or matching is too slow',
    )
    vt_normalisation: float = parameter(
        0.0, 'Scale every view to this mean brightness.',
        unit='mean brightness; 0: off', low=0.0, high=1.0,
        raise_if='the brightness of the whole image varies',
        lower_if='bright parts saturate at white',
    )
    vt_normalise_range: bool = parameter(
        False,
        'Divide every view by its range, from its darkest to its brightest pixel. With '
        'vt_normalisation, the mean becomes that; without, the darkest pixel becomes 0 and the '
        'brightest 1. Only for vt_descriptor: intensity.',
        raise_if='the contrast of the whole image varies, as in haze or dusk',
        lower_if='a single lamp or reflection determines the range',
    )
    vt_patch_normalise: int = parameter(
        0,
        'Normalise each pixel by the mean and standard deviation of the square patch of this '
        'radius around it.',
        unit='template px; 0: off', low=0, high=128,
        raise_if='shadows or local lighting vary', lower_if='noise in plain areas is amplified',
    )
    vt_min_patch_normalisation_std: float = parameter(
        0.0, 'Patches with a standard deviation below this count as uniform and become 0.5.',
        unit='of brightness 0 to 1', low=0.0, high=1.0,
        raise_if='noise in plain areas is amplified', lower_if='faint texture should count',
    )
    vt_min_structure: float = parameter(
        0.03,
        'Images with less structure (root mean square of the brightness gradient per pixel, at a '
        'size of 48 x 36 px) are neither recognised nor learned. Sensor noise has up to 0.023.',
        unit='of brightness 0 to 1; 0: off', low=0.0, high=1.0,
        raise_if='blank walls or dark images are confused',
        lower_if='faint scenes should be recognised', runtime='at next message',
    )
    vt_panoramic: bool = parameter(
        False, 'The camera sees 360 degrees: views are compared at every rotation.',
        raise_if='the camera is panoramic', lower_if='the camera looks forward',
    )

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
