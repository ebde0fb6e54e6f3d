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
        NO_FILE, '', 0, 0,
        'Live only: file in which the node saves what it learns while it runs, and from which it '
        'continues when it is started again. Empty: the map is kept in memory only.',
        'set to a file to keep the map after the end of the nodes, or after a power cut',
        'leave empty if every run starts with an empty map',
    )  # fmt: skip
    localize: bool = parameter(
        False, '', 0, 1,
        'Live only: only localise in the map file, which stays unchanged: nothing is learned, '
        'saved or adapted.',
        'the map is complete and must not change',
        'new places must be mapped')  # fmt: skip
    keep_log: bool = parameter(
        False, '', 0, 1,
        'Live only: keep everything that is received, in a folder beside the map file, from which '
        'ratslam replay MAP --log repeats the run. It grows without a limit.',
        'a run must be reproduced later, with the messages as they came',
        'the disk is small',
    )  # fmt: skip
    memory_folder: str = parameter(
        '~/.ros/ratslam', '', 0, 0,
        'Live only: folder of the maps that the services save and load keep.',
        'set to a separate folder for each environment that the robot works in',
        'leave as it is for a single robot in a single environment',
        runtime='at once',
    )  # fmt: skip
    forget_share: float = parameter(
        0.5, 'probability', 0.0, 1.0,
        'Probability that a new item fades. At the limit, faded items are removed first, so that '
        'about the rest of the map of regions not seen for long is kept.',
        'recent regions should be kept in detail', 'old regions should be kept in detail',
    )  # fmt: skip
    forget_after_s: float = parameter(
        300.0, 's', 0.1, 1e8,
        'Time after the last observation at which an item counts as faded or old, and may be '
        'removed if the limit is reached.',
        'the robot returns to a region after a longer time',
        'the regions of this period do not fit within the limit',
    )  # fmt: skip
