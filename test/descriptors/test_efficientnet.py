# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pretrained descriptor."""

from __future__ import annotations

import io
import sys
from importlib.resources import files

import cv2
import numpy as np
import pytest
from helpers import original
from matplotlib.cbook import get_sample_data

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.descriptors import OnnxDescriptor, efficientnet, encoder_of
from ratslam_ros.descriptors.tensors import read_tensors
from ratslam_ros.errors import UnusableParameter


@pytest.fixture
def learned() -> None:
    for package in ('onnx', 'onnxruntime', efficientnet.WEIGHTS[0]):
        pytest.importorskip(package, reason='the extra [learned] is not installed')


def parameters() -> LocalViewParameters:
    value: LocalViewParameters = original('local_view', vt_descriptor='efficientnet')
    return value


@pytest.mark.usefixtures('learned')
def test_features_of_a_photograph_are_those_of_training() -> None:
    # The mean of a feature over the training images is the sum of the biases of the last batch
    # normalisations, of the three blocks that are added. With this photograph the correlation is
    # 0.54, with permuted weights at most 0.2.
    with get_sample_data('grace_hopper.jpg') as file:
        photograph = cv2.imdecode(np.frombuffer(file.read(), np.uint8), cv2.IMREAD_GRAYSCALE)
    weights = read_tensors(io.BytesIO(files(efficientnet.WEIGHTS[0]).joinpath(
        *efficientnet.WEIGHTS[1:]).read_bytes()))  # fmt: skip
    expected = sum(weights[f'_blocks.{block}._bn2.bias'] for block in (5, 6, 7))
    (features,) = OnnxDescriptor('efficientnet', efficientnet.model()).compute([photograph])
    means = features.reshape(80, -1).mean(1)
    assert np.corrcoef(means, expected)[0, 1] > 0.4


@pytest.mark.usefixtures('learned')
def test_weights_of_another_version_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(efficientnet, 'WEIGHTS_SHA256', '0' * 64)
    with pytest.raises(UnusableParameter, match='have the SHA-256 579344248a93'):
        encoder_of(parameters())


def test_missing_package_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'onnx', None)
    with pytest.raises(UnusableParameter, match=r"needs onnx: pip install '.\[learned\]'"):
        encoder_of(parameters())
