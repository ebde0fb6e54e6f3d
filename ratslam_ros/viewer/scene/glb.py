# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lines and flat shapes as binary glTF 2.0, which browsers draw without shading.

On software rendering, 20,000 lines of this kind are drawn at about 16 frames per second; viser's
line segments, six triangles each, at 3 frames per second.
"""

from __future__ import annotations

import json
import struct

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ratslam_ros.viewer.scene.palette import Bytes

LINES, TRIANGLES = 1, 4
MAGIC, JSON_CHUNK, BINARY_CHUNK = b'glTF', b'JSON', b'BIN\0'


def lines(points: NDArray[np.floating], colours: Bytes) -> bytes:
    """Return lines of one pixel.

    Args:
        points: (n, 2, 3) ends of every line, at least one.
        colours: (n, 3) colours of the lines.
    """
    return _primitive(points.reshape(-1, 3), np.repeat(colours, 2, axis=0), LINES)


def triangles(points: NDArray[np.floating], colours: ArrayLike) -> bytes:
    """Return triangles that are visible from both sides.

    Args:
        points: (n, 3, 3) corners of every triangle, at least one.
        colours: (n, 3) colours of the triangles, or one colour.
    """
    flat = np.broadcast_to(np.asarray(colours, np.uint8), (len(points), 3))
    return _primitive(points.reshape(-1, 3), np.repeat(flat, 3, axis=0), TRIANGLES)


def _linear(colours: Bytes) -> Bytes:
    """Return colours in the linear space of glTF; browsers convert them back to sRGB."""
    share = np.arange(256) / 255.0
    table = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.round(65535 * table).astype(np.uint16)[colours]


def _primitive(points: NDArray[np.floating], colours: Bytes, mode: int) -> bytes:
    places = np.ascontiguousarray(points, '<f4')
    tints = np.full((len(places), 4), 65535, '<u2')
    tints[:, :3] = _linear(colours)
    low, high = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    binary = places.tobytes() + tints.tobytes()
    head = {
        'asset': {'version': '2.0'},
        'scene': 0,
        'scenes': [{'nodes': [0]}],
        'nodes': [{'mesh': 0}],
        'meshes': [{'primitives': [
            {'attributes': {'POSITION': 0, 'COLOR_0': 1}, 'mode': mode, 'material': 0}
        ]}],
        'materials': [{'doubleSided': True, 'extensions': {'KHR_materials_unlit': {}}}],
        'extensionsUsed': ['KHR_materials_unlit'],
        'accessors': [
            {'bufferView': 0, 'componentType': 5126, 'count': len(places), 'type': 'VEC3',
             'min': low, 'max': high},
            {'bufferView': 1, 'componentType': 5123, 'normalized': True, 'count': len(places),
             'type': 'VEC4'},
        ],
        'bufferViews': [
            {'buffer': 0, 'byteOffset': 0, 'byteLength': places.nbytes},
            {'buffer': 0, 'byteOffset': places.nbytes, 'byteLength': tints.nbytes},
        ],
        'buffers': [{'byteLength': len(binary)}],
    }  # fmt: skip
    text = json.dumps(head, separators=(',', ':')).encode()
    text += b' ' * (-len(text) % 4)
    return b''.join([
        MAGIC, struct.pack('<II', 2, 12 + 8 + len(text) + 8 + len(binary)),
        struct.pack('<I', len(text)), JSON_CHUNK, text,
        struct.pack('<I', len(binary)), BINARY_CHUNK, binary,
    ])  # fmt: skip
