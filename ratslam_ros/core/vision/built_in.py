# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The descriptors that need neither a model nor another package."""

from __future__ import annotations

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.encoder import Encoder
from ratslam_ros.core.vision.gradients import Gradients
from ratslam_ros.core.vision.intensity import Intensity
from ratslam_ros.errors import UnusableParameter

INTENSITY, GRADIENTS = 'intensity', 'gradients'
BUILT_IN = (INTENSITY, GRADIENTS)
"""Values of ``vt_descriptor`` that this module implements."""


def built_in_encoder(p: LocalViewParameters) -> Encoder:
    """Return the encoder that ``vt_descriptor`` names.

    Raises:
        UnusableParameter: the descriptor is not built in.
    """
    if p.vt_descriptor == INTENSITY:
        return Intensity(p)
    if p.vt_descriptor == GRADIENTS:
        return Gradients(p)
    raise UnusableParameter(
        f'local_view.vt_descriptor is {p.vt_descriptor}, which is not built in; expected one of '
        f'{", ".join(BUILT_IN)}'
    )
