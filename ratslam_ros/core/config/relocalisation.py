# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of relocalisation by joint compatibility with random sampling."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter


@dataclass(frozen=True)
class RelocalisationParameters(Section):
    """Search of a map for the place where a set of landmarks was seen, without a pose prior."""

    reloc_level: float = parameter(
        0.99, 'probability', 0.5, 0.99999,
        'Level of the chi-square tests of unary, binary and joint compatibility.',
        'correct pairs are missed', 'wrong pairs are accepted',
    )  # fmt: skip
    reloc_sample: int = parameter(
        3, 'observations', 2, 6,
        'Number of observations that are drawn to generate a hypothesis (p of the memory paper). '
        'The others verify it.',
        'a map of many points makes the search slow',
        'few of the observed landmarks are on the map',
    )  # fmt: skip
    reloc_pairs: int = parameter(
        4, 'pairs', 2, 1000,
        'Least number of pairs of a place that is reported (m of the memory paper).',
        'wrong places are found', 'places with few landmarks are not found',
    )  # fmt: skip
    reloc_draws: int = parameter(
        500, 'draws', 1, 1_000_000,
        'Largest number of draws (t of the memory paper). The search ends earlier as soon as '
        'another place with enough pairs is unlikely to be missed.',
        'places are ambiguous because few of the observed landmarks are on the map',
        'the search takes too long',
    )  # fmt: skip
    reloc_nodes: int = parameter(
        500_000, 'pairs', 1000, 1_000_000_000,
        'Largest number of pairs that are tested, about 0.5 s. If a search ends by it, its result '
        'is not `found`, because a competing place may have been missed.',
        'places of a large map of points are not found', 'the search takes too long',
    )  # fmt: skip
    reloc_share: float = parameter(
        0.5, 'of the observations', 0.01, 1.0,
        'Least share of the observations that match the map at a place that is reported.',
        'places are found that resemble a mapped place but are not mapped, or the search is slow',
        'places are not found because few of the observed landmarks are on the map',
    )  # fmt: skip
    reloc_error: float = parameter(
        0.001, 'probability', 1e-12, 0.5,
        'Largest probability that a place that is reported as found is wrong, or that the search '
        'missed another place that matches as well.',
        'too few places are found', 'wrong places are found',
    )  # fmt: skip
    reloc_unmapped: float = parameter(
        0.5, 'probability', 1e-9, 0.999,
        'Prior probability that the robot is at no place of the map.',
        'wrong places are found in unmapped regions',
        'places are not found, and other evidence decides whether they are right',
    )  # fmt: skip
    reloc_observations: int = parameter(
        40, 'observations', 2, 1000,
        'Largest number of observations that are used; more are thinned out at random.',
        'places are ambiguous although much is seen', 'the search takes too long',
    )  # fmt: skip
