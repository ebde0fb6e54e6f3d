# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Digest of a state, by which tools and tests compare states."""

from __future__ import annotations

from ratslam_ros.core.common.state import State
from ratslam_ros.maps.chunks import (
    CHUNK_BYTES,
    array_digest,
    chunk_hash,
    flat,
    pack,
    state_digest,
)


def digest_of(state: State) -> bytes:
    """Return the hash of a state, which depends on nothing else."""
    digests = {}
    for name, array in pack(state).items():
        data = flat(array).data
        hashes = [
            chunk_hash(data[start : start + CHUNK_BYTES])
            for start in range(0, len(data), CHUNK_BYTES)
        ]
        digests[name] = array_digest(name, array, hashes)
    return state_digest(digests)
