# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rates for which equation (7) of Milford et al. (2006) converges on the map of a recording.

The equation corrects all experiences at once, here with the sign of its second sum corrected. It
converges for rates below 2 / L, where L is the largest eigenvalue of the Laplacian of the map.

    python benchmarks/batch_rates.py RECORDING [--config rc_car] [--rate 0.5 ...]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.linalg import eigsh

from ratslam_ros.offline.map_recording import map_recording

MAX_SWEEPS = 2000
"""Sweeps after which a rate counts as one that converges."""

DISTURBANCE = 1e-3
"""Standard deviation of the disturbance that the sweeps reduce or amplify."""

GROWTH = 1e3
"""Growth of the disturbance at which a rate has diverged."""


def laplacian(ends: NDArray[np.int64], count: int) -> csr_array:
    """Return the Laplacian of a map with links ``ends``, (links, 2), without experience 0.

    Experience 0 is not corrected.
    """
    i, j = ends[ends[:, 0] != ends[:, 1]].T
    rows, columns = np.concatenate([i, j]), np.concatenate([j, i])
    beside = csr_array((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    degrees = np.asarray(beside.sum(axis=1)).ravel()
    own = csr_array((degrees, (np.arange(count), np.arange(count))), shape=(count, count))
    return csr_array((own - beside)[1:, 1:])


def sweeps_until_divergence(laplacian: csr_array, rate: float) -> int:
    """Return the sweeps until a disturbance is ``GROWTH`` times its size; 0: it is never.

    Equation (7) is linear: a difference d from its fixed point becomes d - rate * Laplacian d.
    """
    off = np.random.default_rng(1).normal(scale=DISTURBANCE, size=laplacian.shape[0])
    limit = GROWTH * np.abs(off).max()
    for sweep in range(1, MAX_SWEEPS + 1):
        off = off - rate * (laplacian @ off)
        if np.abs(off).max() > limit:
            return sweep
    return 0


def main() -> None:
    """Print the largest rate that converges, and what other rates do."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').partition('\n')[0])
    parser.add_argument('recording', type=Path)
    parser.add_argument('--config', default='rc_car', help='preset or file of parameters')
    parser.add_argument('--rate', type=float, nargs='+', default=[0.5, 0.25, 0.1])
    options = parser.parse_args()
    found = map_recording(options.recording, config=options.config, history=False, quiet=True)
    ends = np.stack([found.links['source_id'], found.links['target_id']], axis=1)
    matrix = laplacian(ends, len(found.places))
    [largest] = eigsh(matrix, 1, return_eigenvectors=False)
    print(f'{len(found.places)} experiences, up to {matrix.diagonal().max():.0f} links each')
    print(f'largest eigenvalue {largest:.2f}: converges for rates below {2.0 / largest:.3f}')
    for rate in options.rate:
        sweeps = sweeps_until_divergence(matrix, rate)
        print(f'rate {rate:g}: {f"diverges after {sweeps} sweeps" if sweeps else "converges"}')


if __name__ == '__main__':
    main()
