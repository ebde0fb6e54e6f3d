# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Descriptors of other packages, and neural networks, for the local view.

See docs/descriptors.md.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.built_in import BUILT_IN, built_in_encoder
from ratslam_ros.core.vision.encoder import Encoder, Image, Layout, View
from ratslam_ros.core.vision.image_window import cropped
from ratslam_ros.descriptors import efficientnet
from ratslam_ros.errors import UnusableParameter

GROUP = 'ratslam_ros.descriptors'
"""Entry-point group in which packages announce their descriptors."""

MODEL_SUFFIX = '.onnx'
"""Values of ``vt_descriptor`` with this suffix are paths of models."""

QUANTISATION_STEPS = 32.0
"""Bytes per root mean square of a descriptor's values; values beyond 4 times that are limited."""

_MEAN = np.array([[[0.485]], [[0.456]], [[0.406]]], np.float32)
_DEVIATION = np.array([[[0.229]], [[0.224]], [[0.225]]], np.float32)
"""Normalisation of ImageNet, which models with three input channels are trained with."""


class Descriptor(Protocol):
    """What a package has to implement.

    With an attribute ``wants_colour`` that is true, images are (H, W, 3) uint8 in BGR order where
    their colour is known.
    """

    def compute(self, images: Sequence[Image]) -> NDArray[Any]:
        """Return one descriptor per image: (n, d) numbers.

        Args:
            images: n images, (H, W) uint8 grey, cropped but not resized.
        """
        ...


def encoder_of(p: LocalViewParameters) -> Encoder:
    """Return the encoder that ``vt_descriptor`` names: built in, installed, or a network.

    Raises:
        UnusableParameter: there is no such descriptor, or it cannot be used.
    """
    name = p.vt_descriptor
    if name in BUILT_IN:
        return built_in_encoder(p)
    if p.vt_panoramic:
        raise UnusableParameter(
            f'local_view.vt_panoramic is true, but {name} is compared without rotations; set '
            f'vt_panoramic to false, or vt_descriptor to one of {", ".join(BUILT_IN)}'
        )
    return DescriptorEncoder(name, _descriptor(name), p)


def _descriptor(name: str) -> Descriptor:
    if name == efficientnet.NAME:
        return OnnxDescriptor(name, efficientnet.model())
    return OnnxDescriptor(name) if name.endswith(MODEL_SUFFIX) else _installed(name)


class DescriptorEncoder:
    """Encoder that quantises the descriptors of another package to bytes.

    Descriptors are normalised to unit length first, so the sum of absolute differences measures
    the angle between them. They are compared without shifts.
    """

    def __init__(self, name: str, descriptor: Descriptor, parameters: LocalViewParameters) -> None:
        """Compute the descriptor of a test image, to learn its length.

        Raises:
            UnusableParameter: ``compute`` returned something else than one row of numbers.
        """
        self._name, self._descriptor, self._p = name, descriptor, parameters
        self.wants_colour = bool(getattr(descriptor, 'wants_colour', False))
        ramp = np.add.outer(np.arange(120), np.arange(160))
        self.layout = Layout(width=len(self._values(ramp.astype(np.uint8))), height=1)

    def encode(self, image: Image) -> View | None:
        """Return the quantised descriptor, (1, d) uint8, or None if it is zero.

        Raises:
            UnusableParameter: the crop exceeds the image, or ``compute`` returned something else
                than one row of numbers.
        """
        window = cropped(image, self._p)
        crop = image[window.y_min : window.y_max, window.x_min : window.x_max]
        values = self._values(np.ascontiguousarray(crop))
        if len(values) != self.layout.width:
            raise self._unusable(f'(1, {len(values)})', f'(1, {self.layout.width}) as before')
        length = math.sqrt(math.fsum(values * values))
        if length == 0.0:
            return None
        scale = QUANTISATION_STEPS * math.sqrt(len(values)) / length
        return np.clip(np.floor(values * scale + 128.5), 0, 255).astype(np.uint8)[np.newaxis]

    def _values(self, image: Image) -> NDArray[np.float64]:
        values = np.asarray(self._descriptor.compute([image]))
        if values.ndim != 2 or len(values) != 1 or values.shape[1] == 0:
            raise self._unusable(str(values.shape), '(1, d) for one image')
        try:
            row: NDArray[np.float64] = values[0].astype(np.float64)
        except (TypeError, ValueError):
            raise self._unusable(str(values.dtype), 'numbers') from None
        if not np.isfinite(row).all():
            raise self._unusable('values that are not finite', 'finite numbers')
        return row

    def _unusable(self, found: str, expected: str) -> UnusableParameter:
        return UnusableParameter(
            f'local_view.vt_descriptor: compute of {self._name} returned {found}; expected '
            f'{expected}'
        )


def _installed(name: str) -> Descriptor:
    """Return a new instance of an installed descriptor."""
    found = {point.name: point for point in entry_points(group=GROUP)}
    if name not in found:
        known = ', '.join([*BUILT_IN, efficientnet.NAME, *sorted(found)])
        raise UnusableParameter(
            f'local_view.vt_descriptor is {name}; expected one of {known}, the name of a '
            f'descriptor that an installed package announces in the entry-point group {GROUP}, or '
            f'the path of a model ({MODEL_SUFFIX})'
        )
    try:
        descriptor: Descriptor = found[name].load()()
    except Exception as error:  # the package's own code
        raise UnusableParameter(
            f'local_view.vt_descriptor: {name} ({found[name].value}) cannot be loaded: {error}'
        ) from error
    return descriptor


class OnnxDescriptor:
    """Descriptor computed by an ONNX model, on the CPU in one thread.

    The model has one input, (n, channels, height, width) with 1 or 3 channels and a fixed height
    and width. Its first output is the descriptor. Images are resized. Three channels are red,
    green and blue; the values of grey images are repeated. Inputs of type float are scaled to 0 to
    1, and with three channels also normalised as is usual for ImageNet. Inputs of type uint8 are
    not scaled.
    """

    def __init__(self, path: str, model: bytes | None = None) -> None:
        """Load a model.

        Args:
            path: path of the model.
            model: the model itself; it then needs no file, and ``path`` only names it.

        Raises:
            UnusableParameter: onnxruntime is not installed, or the file is no such model.
        """
        # From version 1.29 on, onnxruntime reports models and machine to its maker.
        os.environ.setdefault('ORT_DISABLE_TELEMETRY', '1')
        try:
            import onnxruntime
        except ImportError:
            raise UnusableParameter(
                f'local_view.vt_descriptor is {path}, which needs onnxruntime: '
                f"pip install '.[{'onnx' if model is None else 'learned'}]'"
            ) from None
        file = Path(path).expanduser()
        if model is None and not file.is_file():
            raise UnusableParameter(f'local_view.vt_descriptor: {path} is not a file')
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        try:
            self._session = onnxruntime.InferenceSession(
                model or str(file), options, providers=['CPUExecutionProvider']
            )
        except Exception as error:  # onnxruntime raises several types
            raise UnusableParameter(
                f'local_view.vt_descriptor: {path} cannot be loaded: {str(error)[:200]}'
            ) from None
        inputs = self._session.get_inputs()
        shape = inputs[0].shape if len(inputs) == 1 else []
        if (
            len(shape) != 4 or shape[1] not in (1, 3)
            or not all(isinstance(size, int) for size in shape[2:])
            or inputs[0].type not in ('tensor(float)', 'tensor(uint8)')
        ):
            found = ', '.join(f'{i.type} {i.shape}' for i in inputs)
            raise UnusableParameter(
                f'local_view.vt_descriptor: {path} has the inputs {found}; expected one of type '
                'float or uint8 and shape (n, 1 or 3, height, width) with fixed height and width'
            )
        self._input = inputs[0].name
        self._channels, self._height, self._width = shape[1:]
        self._scaled = inputs[0].type == 'tensor(float)'
        self.wants_colour = self._channels == 3

    def compute(self, images: Sequence[Image]) -> NDArray[Any]:
        """Return one descriptor per image, (n, d); the model runs once per image."""
        rows = [self._session.run(None, {self._input: self._prepared(i)})[0] for i in images]
        return np.stack([np.asarray(row).reshape(-1) for row in rows])

    def _prepared(self, image: Image) -> NDArray[Any]:
        import cv2

        small = cv2.resize(image, (self._width, self._height), interpolation=cv2.INTER_AREA)
        planes = np.atleast_3d(small)[:, :, ::-1].transpose(2, 0, 1)  # BGR to RGB
        planes = np.repeat(planes, self._channels // len(planes), 0)
        if not self._scaled:
            return planes[np.newaxis]
        values = planes.astype(np.float32) / np.float32(255.0)
        if self._channels == 3:
            values = (values - _MEAN) / _DEVIATION
        return values[np.newaxis]
