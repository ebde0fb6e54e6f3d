# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Memory of a live run stays bounded, however long it lasts."""

from __future__ import annotations

import gc
import time
from pathlib import Path

import pytest
from viewer_doubles import STEP_NS, records_of

from ratslam_ros.viewer import live_run
from ratslam_ros.viewer.live_run import LiveRun
from ratslam_ros.viewer.playback import Playback

STEPS = 600
"""Steps of a part of a run: 300 s of stamps, in which all older records leave memory."""


def test_long_live_run_keeps_no_more_objects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every part of a run on a known loop brings as many records as the one before."""
    # So that the list is soon full.
    monkeypatch.setattr('ratslam_ros.history.run_state.MAX_CLOSURES', 50)
    run = LiveRun('long', tmp_path / 'history.sqlite')
    playback = Playback(run)
    counts = []
    for part in range(4):
        for number in range(part * STEPS, (part + 1) * STEPS):
            for record in records_of(number):
                run.add(record)
            if number % 10 == 0:
                playback.tick(0.1)
        end_s = time.monotonic() + 60.0
        while run._history._queue.qsize():
            assert time.monotonic() < end_s
            time.sleep(0.01)
        gc.collect()
        counts.append(len(gc.get_objects()))
    run.close()
    assert run.end_ns - run.begin_ns == (4 * STEPS - 1) * STEP_NS
    assert len(run._tail) <= 2 * live_run.TAIL_NS // STEP_NS * len(records_of(1)) + 10
    assert counts[3] - counts[1] < STEPS, counts  # two parts have ten times as many records
