# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lines and flat shapes as binary glTF 2.0, which browsers draw without shading.

On software rendering, 20,000 lines of this kind were drawn at 16 frames per second, and as viser's
line segments, which are six triangles each, at 3 frames per second.
"""

from __future__ import annotations

import json
import struct

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.viewer.scene.palette import Bytes

LINES, TRIANGLES = 1, 4

ACES_IN = np.array([
    [0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777],
])
ACES_OUT = np.array([
    [1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602],
])
BRIGHTEST = 0.95
"""Brightest linear value that is asked of the filmic curve; it reaches 1 only at infinity."""

MAGIC, JSON_CHUNK, BINARY_CHUNK = b'glTF', b'JSON', b'BIN\0'


def _linear(colours: Bytes) -> NDArray[np.float32]:
    """Return colours that a browser displays as given.

    glTF colours are linear, and viser's renderer maps them by the filmic curve of ACES as fitted
    by Hill (three.js uses the same fit), which pales them. This is the inverse of both.
    """
    share = np.arange(256) / 255.0
    table = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    out = np.minimum(table[colours], BRIGHTEST) @ np.linalg.inv(ACES_OUT).T
    # out = (v^2 + 0.0245786 v - 0.000090537) / (0.983729 v^2 + 0.4329510 v + 0.238081)
    out = np.clip(out, 0.0, BRIGHTEST)
    a, b = 1.0 - 0.983729 * out, 0.0245786 - 0.432951 * out
    c = -0.000090537 - 0.238081 * out
    v = (-b + np.sqrt(b * b - 4.0 * a * c)) / (2.0 * a)
    mapped: NDArray[np.float32] = (v @ np.linalg.inv(ACES_IN).T * 0.6).astype(np.float32)
    return np.maximum(mapped, 0.0)


def encoded(points: NDArray[np.floating], colours: Bytes) -> bytes:
    """Return lines of one pixel, or triangles that are visible from both sides.

    Args:
        points: (n, 2, 3) ends of every line or (n, 3, 3) corners of every triangle, at least one.
        colours: the same number of colours.
    """
    mode = LINES if points.shape[1] == 2 else TRIANGLES
    places = np.ascontiguousarray(points.reshape(-1, 3), '<f4')
    tints = np.ascontiguousarray(_linear(colours.reshape(-1, 3)), '<f4')
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
            {'bufferView': 1, 'componentType': 5126, 'count': len(places), 'type': 'VEC3'},
        ],
        'bufferViews': [
            {'buffer': 0, 'byteOffset': 0, 'byteLength': places.nbytes},
            {'buffer': 0, 'byteOffset': places.nbytes, 'byteLength': tints.nbytes},
        ],
        'buffers': [{'byteLength': len(binary)}],
    }
    text = json.dumps(head, separators=(',', ':')).encode()
    text += b' ' * (-len(text) % 4)
    return b''.join([
        MAGIC, struct.pack('<II', 2, 12 + 8 + len(text) + 8 + len(binary)),
        struct.pack('<I', len(text)), JSON_CHUNK, text,
        struct.pack('<I', len(binary)), BINARY_CHUNK, binary,
    ])
