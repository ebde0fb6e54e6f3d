# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Independent random streams of a simulation, all derived from one seed."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np


@dataclass(frozen=True)
class RandomStreams:
    """One generator per use, so that the draws of one use do not change those of another.

    Append new streams at the end: the existing ones then keep their draws.
    """

    decoration: np.random.Generator
    driving: np.random.Generator
    wheel_slip: np.random.Generator
    camera: np.random.Generator
    laser: np.random.Generator
    people: np.random.Generator
    light: np.random.Generator
    rear_laser: np.random.Generator
    sonars: np.random.Generator

    @classmethod
    def from_seed(cls, seed: int) -> RandomStreams:
        """Spawn all streams from a seed."""
        return cls(*np.random.Generator(np.random.PCG64(seed)).spawn(len(fields(cls))))
