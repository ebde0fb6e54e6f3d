# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pretrained descriptor."""

from __future__ import annotations

import io
import sys
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers import extended
from matplotlib.cbook import get_sample_data

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.descriptors import OnnxDescriptor, efficientnet, encoder_of
from ratslam_ros.descriptors.tensors import read_tensors
from ratslam_ros.errors import UnusableParameter


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the model in an empty folder."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))


@pytest.fixture
def learned() -> None:
    for package in ('onnx', 'onnxruntime', efficientnet.WEIGHTS[0]):
        pytest.importorskip(package, reason='the extra [learned] is not installed')


def parameters() -> LocalViewParameters:
    value: LocalViewParameters = extended('local_view', vt_descriptor='efficientnet')
    return value


@pytest.mark.usefixtures('learned')
def test_features_of_a_photograph_are_those_of_training() -> None:
    # The mean of a feature over the training images is the sum of the biases of the last batch
    # normalisations, of the three blocks that are added. With this photograph the correlation is
    # 0.54, with permuted weights at most 0.2.
    with get_sample_data('grace_hopper.jpg') as file:
        photograph = cv2.imdecode(np.frombuffer(file.read(), np.uint8), cv2.IMREAD_GRAYSCALE)
    weights = read_tensors(io.BytesIO(files(efficientnet.WEIGHTS[0]).joinpath(
        *efficientnet.WEIGHTS[1:]).read_bytes()))
    expected = sum(weights[f'_blocks.{block}._bn2.bias'] for block in (5, 6, 7))
    (features,) = OnnxDescriptor('efficientnet', efficientnet.model()).compute([photograph])
    means = features.reshape(80, -1).mean(1)
    assert np.corrcoef(means, expected)[0, 1] > 0.4


@pytest.mark.usefixtures('learned')
def test_cached_model_is_used_until_it_is_damaged(monkeypatch: pytest.MonkeyPatch) -> None:
    built = efficientnet.model()
    with monkeypatch.context() as without_weights:
        without_weights.setattr(efficientnet, 'WEIGHTS_SHA256', '')
        assert efficientnet.model() == built
    (file,) = efficientnet.cache_file().parent.iterdir()
    kept = file.read_bytes()
    for damaged in (kept[:-1], kept[:-1] + bytes([kept[-1] ^ 1]), b''):
        file.write_bytes(damaged)
        assert efficientnet.model() == built
        assert file.read_bytes() == kept


@pytest.mark.usefixtures('learned')
def test_model_needs_no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / 'file').touch()
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'file'))
    assert encoder_of(parameters()).layout.width == 80 * 5 * 4


@pytest.mark.usefixtures('learned')
def test_weights_of_another_version_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(efficientnet, 'WEIGHTS_SHA256', '0' * 64)
    with pytest.raises(UnusableParameter, match='have the SHA-256 579344248a93'):
        encoder_of(parameters())


def test_missing_package_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'onnx', None)
    with pytest.raises(UnusableParameter, match=r"needs onnx: pip install '.\[learned\]'"):
        encoder_of(parameters())
