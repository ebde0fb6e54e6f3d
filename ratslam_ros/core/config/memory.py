# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters that all parts share: where they save what they learn, and what they forget."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import NO_FILE, Section, parameter


@dataclass(frozen=True)
class MemoryParameters(Section):
    """What the parts have learned: the map file, and what is forgotten at a limit."""

    map: str = parameter(
        NO_FILE,
        'Live only: file in which the node saves what it learns while it runs, and from which it '
        'continues when it is started again. Empty: the map is kept in memory only.',
        low=0, high=0,
        raise_if='set to a file to keep the map after the end of the nodes, or after a power cut',
        lower_if='leave empty if every run starts with an empty map',
    )
    localize: bool = parameter(
        False,
        'Live only: only localise in the map file, which stays unchanged: nothing is learned, '
        'saved or adapted.',
        raise_if='the map is complete and must not change', lower_if='new places must be mapped',
    )
    keep_log: bool = parameter(
        False,
        'Live only: keep everything that is received, in a folder beside the map file, from '
        'which ratslam replay MAP --log repeats the run. It grows without a limit.',
        raise_if='a run must be reproduced later, with the messages as they came',
        lower_if='the disk is small',
    )
    memory_folder: str = parameter(
        '~/.ros/ratslam', 'Live only: folder of the maps that the services save and load keep.',
        raise_if='set to a separate folder for each environment that the robot works in',
        lower_if='leave as it is for a single robot in a single environment', runtime='at once',
    )
    forget_share: float = parameter(
        0.5,
        'Probability that a new item fades. At the limit, faded items are removed first, so that '
        'about the rest of the map of regions not seen for long is kept.',
        unit='probability', low=0.0, high=1.0,
        raise_if='recent regions should be kept in detail',
        lower_if='old regions should be kept in detail',
    )
    forget_after_s: float = parameter(
        300.0,
        'Time after the last observation at which an item counts as faded or old, and may be '
        'removed if the limit is reached.',
        unit='s', low=0.1, high=1e8,
        raise_if='the robot returns to a region after a longer time',
        lower_if='the regions of this period do not fit within the limit',
    )
