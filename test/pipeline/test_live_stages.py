# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stages whose neighbours may be other processes: what they report."""

from __future__ import annotations

from collections import Counter

import pytest
from test_stages import SMALL, circles

from ratslam_ros.pipeline.live_stages import LiveLocalView, LivePoseCells, LiveTemplates
from ratslam_ros.pipeline.pipeline import Pipeline
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
