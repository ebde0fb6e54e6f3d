# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Descriptors of installed packages, and ONNX models."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers import Hue, extended, picture
from numpy.typing import NDArray

from ratslam_ros import map_recording
from ratslam_ros.core.config import Config, LocalViewParameters
from ratslam_ros.core.vision.gradients import Gradients
from ratslam_ros.core.vision.local_view import UNDECODABLE, LocalView
from ratslam_ros.descriptors import DescriptorEncoder, OnnxDescriptor, encoder_of
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.recordings import open_recording
from ratslam_tuning.trials import Trial, run_trials

EXAMPLE = Path(__file__).parents[2] / 'examples' / 'descriptor_package'
Image = NDArray[np.uint8]


def parameters(descriptor: str, **more: Any) -> LocalViewParameters:
    return extended('local_view', **{
        'vt_descriptor': descriptor, 'vt_match_threshold': 0.05, **more
    })


def install(folder: Path, project: str, entry_points: dict[str, str]) -> None:
    """Write the metadata that pip writes for a package with descriptors."""
    info = folder / f'{project}-1.0.dist-info'
    info.mkdir(parents=True)
    (info / 'METADATA').write_text(f'Metadata-Version: 2.1\nName: {project}\nVersion: 1.0\n')
    lines = [f'{name} = {value}' for name, value in entry_points.items()]
    (info / 'entry_points.txt').write_text('\n'.join(['[ratslam_ros.descriptors]', *lines, '']))


@pytest.fixture
def example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install the example package."""
    project = tomllib.loads((EXAMPLE / 'pyproject.toml').read_text(encoding='utf-8'))['project']
    install(tmp_path, 'thumbnail_descriptor', project['entry-points']['ratslam_ros.descriptors'])
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.syspath_prepend(str(EXAMPLE))


class Fixed:
    """Descriptor that returns given values."""

    def __init__(self, *returned: Any) -> None:
        self.returned = list(returned)

    def compute(self, images: Sequence[Image]) -> Any:
        return self.returned.pop(0) if len(self.returned) > 1 else self.returned[0]


@pytest.mark.usefixtures('example')
def test_example_package_recognises_brighter_images() -> None:
    p = parameters('thumbnail')
    view = LocalView(p, encoder_of(p))
    places = [picture(seed, 24, 32) // 2 for seed in range(10)]
    assert [view.match(image).template_id for image in places] == list(range(10))
    assert [view.match(image + np.uint8(100)).template_id for image in places] == list(range(10))
    assert view.match(np.zeros((24, 32), np.uint8)) == UNDECODABLE


def test_built_in_names_need_no_package() -> None:
    assert isinstance(encoder_of(parameters('gradients')), Gradients)


@pytest.mark.usefixtures('example')
def test_unknown_descriptor_lists_known_ones() -> None:
    with pytest.raises(UnusableParameter, match='efficientnet, thumbnail, the name of'):
        encoder_of(parameters('os.system'))


def test_descriptor_that_fails_to_load_is_one_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, 'broken', {'broken': 'no_such_module:Descriptor'})
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(UnusableParameter, match=r'broken .* cannot be loaded: No module'):
        encoder_of(parameters('broken'))


@pytest.mark.parametrize(('values', 'message'), [
    (np.zeros(4), r'returned \(4,\); expected \(1, d\)'),
    (np.zeros((2, 4)), r'returned \(2, 4\)'),
    (np.array([['a']]), 'expected numbers'),
    (np.array([[1.0, np.nan]]), 'not finite'),
])
def test_wrong_results_are_named_in_error(values: Any, message: str) -> None:
    with pytest.raises(UnusableParameter, match=message):
        DescriptorEncoder('mine', Fixed(values), parameters('mine'))


def test_changed_length_is_named_in_error() -> None:
    fixed = Fixed(np.ones((1, 4)), np.ones((1, 5)))
    encoder = DescriptorEncoder('mine', fixed, parameters('mine'))
    with pytest.raises(UnusableParameter, match=r'returned \(1, 5\); expected \(1, 4\)'):
        encoder.encode(picture(1))


def test_bytes_depend_on_direction_only() -> None:
    values = np.random.default_rng(1).normal(size=(1, 300))
    found = []
    for scale in (1.0, 1e-9, 250.0):
        encoder = DescriptorEncoder('mine', Fixed(values * scale), parameters('mine'))
        view = encoder.encode(picture(1))
        assert view is not None
        found.append(view)
    assert found[0].shape == (1, 300)
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[0], found[2])
    unit = values / np.sqrt((values**2).mean())
    assert np.abs(found[0] - np.clip(128 + 32 * unit, 0, 255)).max() <= 0.5 + 1e-6


def test_compute_gets_the_crop_only() -> None:
    class Recorder(Fixed):
        def compute(self, images: Sequence[Image]) -> Any:
            self.seen = images
            return super().compute(images)

    recorder = Recorder(np.ones((1, 3)))
    p = parameters('mine', image_crop_x_min=4, image_crop_y_max=10)
    DescriptorEncoder('mine', recorder, p).encode(picture(1))
    (seen,) = recorder.seen
    assert np.array_equal(seen, picture(1)[:10, 4:])


def test_panoramic_is_refused() -> None:
    with pytest.raises(UnusableParameter, match='vt_panoramic is true'):
        encoder_of(parameters('mine', vt_panoramic=True))


# ONNX models, written as protocol buffers by hand, so that tests need no other package


def field(number: int, value: int | bytes | str) -> bytes:
    """Encode one field of a protocol buffer."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def varint(value: int) -> bytes:
    out = b''
    while value > 127:
        out += bytes([value & 127 | 128])
        value >>= 7
    return out + bytes([value])


FLOAT, UINT8 = 1, 2
POOLED = 4


def value_info(name: str, kind: int, shape: Sequence[int | str]) -> bytes:
    sizes = b''.join(
        field(1, field(1, size) if isinstance(size, int) else field(2, size)) for size in shape
    )
    return field(1, name) + field(2, field(1, field(1, kind) + field(2, sizes)))


def average_pool(path: Path, shape: Sequence[int | str] = ('n', 1, 16, 24)) -> str:
    """Write a model that averages blocks of 4 x 4 px, and return its path."""
    def ints(name: str) -> bytes:
        return field(5, field(1, name) + field(8, POOLED) * 2 + field(20, 7))

    node = field(1, 'x') + field(2, 'y') + field(4, 'AveragePool')
    node += ints('kernel_shape') + ints('strides')
    graph = field(1, node) + field(2, 'pool') + field(11, value_info('x', FLOAT, shape))
    graph += field(12, value_info('y', FLOAT, ('n', shape[1], 'h', 'w')))
    path.write_bytes(field(1, 8) + field(7, graph) + field(8, field(1, '') + field(2, 13)))
    return str(path)


def test_onnx_model_computes_descriptors(tmp_path: Path) -> None:
    pytest.importorskip('onnxruntime')
    p = parameters(average_pool(tmp_path / 'pool.onnx'), vt_match_threshold=0.005)
    encoder = encoder_of(p)
    assert (encoder.layout.width, encoder.layout.height) == (24, 1)
    image = picture(3, 16, 24)
    pooled = image.reshape(4, 4, 6, 4).mean((1, 3)).reshape(1, -1)
    expected = DescriptorEncoder('mine', Fixed(pooled), p).encode(image)
    view = encoder.encode(image)
    assert view is not None
    assert np.array_equal(view, expected)
    assert np.array_equal(encoder.encode(image.repeat(3, 0).repeat(3, 1)), view)
    local_view = LocalView(p, encoder)
    matches = [local_view.match(picture(seed, 16, 24)) for seed in (1, 2, 3, 2)]
    assert [match.template_id for match in matches] == [0, 1, 2, 1]


def test_onnx_model_with_three_channels_is_normalised(tmp_path: Path) -> None:
    pytest.importorskip('onnxruntime')
    model = OnnxDescriptor(average_pool(tmp_path / 'pool.onnx', (1, 3, 8, 8)))
    rows = model.compute([np.full((30, 20), 51, np.uint8), np.full((8, 8), 255, np.uint8)])
    mean, deviation = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
    for row, value in zip(rows, (0.2, 1.0), strict=True):
        expected = ((value - mean) / deviation).repeat(4)
        assert row == pytest.approx(expected, abs=1e-6)


def test_onnx_model_with_three_channels_gets_red_first(tmp_path: Path) -> None:
    pytest.importorskip('onnxruntime')
    model = OnnxDescriptor(average_pool(tmp_path / 'pool.onnx', (1, 3, 8, 8)))
    assert model.wants_colour
    bgr = np.zeros((30, 20, 3), np.uint8)
    bgr[..., 2] = 255
    red, *others = model.compute([bgr])[0].reshape(3, 4).mean(1)
    assert red == pytest.approx((1.0 - 0.485) / 0.229)
    assert others == pytest.approx([-0.456 / 0.224, -0.406 / 0.225])
    assert not OnnxDescriptor(average_pool(tmp_path / 'grey.onnx')).wants_colour


@pytest.mark.parametrize('wants_colour', [True, False])
def test_replays_and_trials_give_colour_to_descriptors_that_want_it(
    wants_colour: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(Hue, 'wants_colour', wants_colour)
    monkeypatch.setattr('ratslam_ros.descriptors._installed', lambda name: Hue())
    grey = picture(1, 24, 32)[..., np.newaxis]
    for n, tint in enumerate(([1.0, 0.4, 0.1], [0.1, 0.4, 1.0], [1.0, 0.4, 0.1])):
        cv2.imwrite(str(tmp_path / f'{n}.png'), (grey * tint).astype(np.uint8))
    config = Config().with_values({
        'local_view.vt_descriptor': 'hue', 'local_view.vt_match_threshold': 0.02,
        'local_view.vt_recent_templates': 0, 'local_view.image_crop_x_min': 4,
    })
    expected = 2 if wants_colour else 1
    found = map_recording(tmp_path, config=config, inspect=False, quiet=True)
    assert found.summary['templates'] == expected
    with open_recording(tmp_path) as recording:
        mixed = [config, config.with_values({'local_view.vt_descriptor': 'gradients'})]
        trial, other = run_trials(recording, recording.select(), mixed)
    assert isinstance(trial, Trial) and trial.templates == expected
    assert isinstance(other, Trial)


def test_unusable_onnx_models_are_named_in_error(tmp_path: Path) -> None:
    pytest.importorskip('onnxruntime')
    with pytest.raises(UnusableParameter, match=r'absent\.onnx is not a file'):
        encoder_of(parameters(str(tmp_path / 'absent.onnx')))
    (tmp_path / 'text.onnx').write_text('no model')
    with pytest.raises(UnusableParameter, match=r'text\.onnx cannot be loaded'):
        encoder_of(parameters(str(tmp_path / 'text.onnx')))
    for shape in ((1, 1, 'h', 'w'), (1, 4, 8, 8)):
        with pytest.raises(UnusableParameter, match='expected one of type float or uint8'):
            encoder_of(parameters(average_pool(tmp_path / 'free.onnx', shape)))


def test_onnxruntime_sends_no_telemetry(tmp_path: Path) -> None:
    pytest.importorskip('onnxruntime')
    path = average_pool(tmp_path / 'pool.onnx')
    load = f'from ratslam_ros.descriptors import OnnxDescriptor; OnnxDescriptor({path!r})'
    # onnxruntime is silent by itself in CI; what it would send, it keeps below the home folder.
    variables = {name: value for name, value in os.environ.items()
                 if name.split('_')[0] not in ('CI', 'ORT', 'XDG')}
    variables |= {'HOME': str(tmp_path), 'PYTHONPATH': os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, '-c', load], env=variables, check=True)
    assert not [*tmp_path.rglob('*.db')]


def test_onnx_without_onnxruntime_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'onnxruntime', None)
    with pytest.raises(UnusableParameter, match=r"pip install '.\[onnx\]'"):
        encoder_of(parameters('model.onnx'))
