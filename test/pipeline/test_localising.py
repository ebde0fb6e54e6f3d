# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Localisation only: no part learns anything, with every adaptation that can be switched on."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import kidnapped_drive
import pytest
from learned import PRESENT, learned
from states import differences
from test_stages import SMALL, VARIANTS, Message, circles

from ratslam_ros.pipeline.ratslam import RatSLAM


def feed(slam: RatSLAM, messages: Sequence[Message]) -> None:
    for message in messages:
        if message[0] in slam.pipeline.inputs:
            slam.pipeline.feed(*message)


@pytest.mark.parametrize(('variant', 'begins'), [
    *((variant, False) for variant in VARIANTS), ('pruning by visits, goal memory', True),
])
def test_localisation_learns_nothing(variant: str, begins: bool) -> None:
    new = partial(RatSLAM, SMALL.with_values(VARIANTS[variant]))
    slam = new()
    messages = circles(120)
    mapped_until = len(messages) * 5 // 8
    feed(slam, messages[:mapped_until])
    if begins:
        slam.finish()
    before = slam.state()
    mapped = new()
    mapped.restore(before)
    slam.mapping = False
    if begins:
        slam.begin_session()
    # The rest of the third lap has new views, and the fourth one known places.
    rest = messages[0 if begins else mapped_until:]
    feed(slam, rest)
    feed(mapped, rest)
    slam.finish()
    after = slam.state()
    assert list(differences(learned(after), learned(before))) == []
    if not begins:  # the same drive does teach a system that maps
        assert list(differences(learned(mapped.state()), learned(before))) != []


def test_localisation_by_scans_learns_nothing() -> None:
    drive = kidnapped_drive.Drive(kidnapped_drive.config())
    given = kidnapped_drive.samples(1, kidnapped_drive.Pose(1.25, 8.0, 0.5), 30)
    drive.feed(given[:-30])
    drive.slam.finish()
    before = drive.slam.state()
    drive.slam.mapping = False
    drive.feed(given[-30:])
    drive.slam.finish()
    assert list(differences(learned(drive.slam.state()), learned(before))) == []


def test_every_present_entry_exists() -> None:
    """A path that is misspelt, or was renamed, would excuse nothing, or too much."""
    found: set[str] = set()
    driven = RatSLAM(SMALL.with_values(VARIANTS['automatic, scans, forgetting']))
    feed(driven, circles(90))
    for slam in (
        driven, RatSLAM(SMALL, 'visual_odometry'),
        RatSLAM(SMALL.with_values(VARIANTS['pruning by visits, goal memory'])),
        RatSLAM(kidnapped_drive.config()),
    ):
        for part, state in slam.state().items():
            _collect(state, part, found)
    assert set(PRESENT) <= found


def _collect(value: object, path: str, found: set[str]) -> None:
    found.add(path)
    if isinstance(value, dict):
        for key, item in value.items():
            _collect(item, f'{path}/{key}', found)
