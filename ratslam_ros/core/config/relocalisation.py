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
        0.99, 'Level of the chi-square tests of unary, binary and joint compatibility.',
        unit='probability', low=0.5, high=0.99999,
        raise_if='correct pairs are missed', lower_if='wrong pairs are accepted',
    )
    reloc_sample: int = parameter(
        3,
        'Number of observations that are drawn to generate a hypothesis (p of the memory paper). '
        'The others verify it.',
        unit='observations', low=2, high=6,
        raise_if='a map of many points makes the search slow',
        lower_if='few of the observed landmarks are on the map',
    )
    reloc_pairs: int = parameter(
        4, 'Least number of pairs of a place that is reported (m of the memory paper).',
        unit='pairs', low=2, high=1000,
        raise_if='wrong places are found', lower_if='places with few landmarks are not found',
    )
    reloc_draws: int = parameter(
        500,
        'Largest number of draws (t of the memory paper). The search ends earlier as soon as '
        'another place with enough pairs is unlikely to be missed.',
        unit='draws', low=1, high=1_000_000,
        raise_if='places are ambiguous because few of the observed landmarks are on the map',
        lower_if='the search takes too long',
    )
    reloc_nodes: int = parameter(
        500_000,
        'Largest number of pairs that are tested, about 0.5 s. If a search ends by it, its '
        'result is not `found`, because a competing place may have been missed.',
        unit='pairs', low=1000, high=1_000_000_000,
        raise_if='places of a large map of points are not found',
        lower_if='the search takes too long',
    )
    reloc_share: float = parameter(
        0.5, 'Least share of the observations that match the map at a place that is reported.',
        unit='of the observations', low=0.01, high=1.0,
        raise_if='places are found that resemble a mapped place but are not mapped, or the '
        'search is slow',
        lower_if='places are not found because few of the observed landmarks are on the map',
    )
    reloc_error: float = parameter(
        0.001,
        'Largest probability that a place that is reported as found is wrong, or that the search '
        'missed another place that matches as well.',
        unit='probability', low=1e-12, high=0.5,
        raise_if='too few places are found', lower_if='wrong places are found',
    )
    reloc_unmapped: float = parameter(
        0.5, 'Prior probability that the robot is at no place of the map.',
        unit='probability', low=1e-9, high=0.999,
        raise_if='wrong places are found in unmapped regions',
        lower_if='places are not found, and other evidence decides whether they are right',
    )
    reloc_observations: int = parameter(
        40, 'Largest number of observations that are used; more are thinned out at random.',
        unit='observations', low=2, high=1000,
        raise_if='places are ambiguous although much is seen',
        lower_if='the search takes too long',
    )
