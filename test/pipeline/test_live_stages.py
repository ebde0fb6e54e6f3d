# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stages whose neighbours may be other processes: what they report."""

from __future__ import annotations

from collections import Counter

import pytest
from helpers import seen, twist
from test_stages import SMALL, circles

from ratslam_ros.core.mapping.id_map import NO_MEMORY_NS
from ratslam_ros.core.pose_cells.map_relocation import ADOPTION_DELAY
from ratslam_ros.pipeline.commands import NewSession
from ratslam_ros.pipeline.items import Answer, Template
from ratslam_ros.pipeline.live_stages import LiveLocalView, LivePoseCells, LiveTemplates
from ratslam_ros.pipeline.pipeline import Passing, Pipeline
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.pipeline.streams import STREAMS

FORWARD = [one for one in STREAMS if not one.answers]


class Reporter:
    """Keeps what is reported."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.notes: list[str] = []
        self.note = self.notes.append

    def drop(self, reason: str, text: str, number: int = 1) -> None:
        self.notes.append(text)


@pytest.mark.parametrize('learned', [0, 3])
def test_replayed_map_is_late_only_for_its_templates(learned: int) -> None:
    reporter = Reporter()
    replayed = RatSLAM(SMALL)
    for message in circles(learned, ('odometry', 'image')):
        replayed.pipeline.feed(*message)
    replayed.finish()
    views = LiveTemplates(LiveLocalView(SMALL, reporter))
    pipeline = Pipeline([views, LivePoseCells(SMALL, reporter)], 0, streams=FORWARD)
    pipeline.restore_stage('local_view', replayed.pipeline.state_of('local_view'))
    for message in circles(10, ('odometry', 'image'))[2 * learned :]:
        pipeline.feed(*message)
    pipeline.finish()
    assert any('started late' in note for note in reporter.notes) == (learned > 0)


def test_pose_cells_wait_for_a_map_that_follows_although_it_does_not_run_yet() -> None:
    """Otherwise they run ahead of it, and every answer is too late to be adopted."""
    passed: list[int] = []
    pose_cells = LivePoseCells(SMALL, Reporter())
    pipeline = Pipeline([pose_cells], 0, passing=Passing(
        ('action',),
        lambda stream, _, item: passed.append(item.number) if stream == 'action' else None,
    ))

    def feed(first_ns: int) -> None:
        for stamp_ns in range(first_ns, first_ns + 10):
            pipeline.feed('odometry', stamp_ns, twist(stamp_ns))
            pipeline.feed('template', stamp_ns, Template(seen(0, is_new=stamp_ns == 1), 1))
        pipeline.go_on()

    feed(1)
    assert passed == [*range(ADOPTION_DELAY)]
    for number in range(10):
        pipeline.feed('relocation', 0, Answer(number, None, NO_MEMORY_NS))
    assert passed == [*range(10)]
    pipeline.command(NewSession())
    feed(11)
    assert passed == [*range(10 + ADOPTION_DELAY)]
