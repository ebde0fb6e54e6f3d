# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Load of drawing the occupancy grid."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

from ratslam_ros.ros.mapping import grid_publisher, sliced_publisher


@pytest.mark.parametrize(('worked_s', 'pause_s'), [(0.001, 0.01), (0.01, 0.1)])
def test_pause_after_a_slice_is_for_work_and_not_for_stalls(
    monkeypatch: pytest.MonkeyPatch, worked_s: float, pause_s: float
) -> None:
    """A busy machine may stop a slice for seconds; ten times that would be a frozen picture."""
    clock = SimpleNamespace(now_s=100.0, worked_s=5.0)
    clocks = SimpleNamespace(
        monotonic=lambda: clock.now_s, thread_time=lambda: clock.worked_s
    )
    for module in (grid_publisher, sliced_publisher):
        monkeypatch.setattr(module, 'time', clocks)
    topic = SimpleNamespace(get_subscription_count=lambda: 1)
    node: Any = SimpleNamespace(create_publisher=lambda *_: topic)
    stage: Any = SimpleNamespace(core=None, scans=SimpleNamespace(), action_ns=0)
    grids = grid_publisher.GridPublisher(node, stage)

    def update(*_: Any) -> int:
        clock.now_s += 3.0
        clock.worked_s += worked_s
        return 0

    grids._grid = SimpleNamespace(update=update, has_changed=False, is_empty=True)  # type: ignore[assignment]
    assert grids.advance()
    stopped_s = clock.now_s
    clock.now_s = stopped_s + 0.9 * pause_s
    assert not grids.advance()
    clock.now_s = stopped_s + 1.1 * pause_s
    assert grids.advance()


def test_closed_publisher_has_sent_its_message() -> None:
    sent: list[str] = []

    def make() -> str:
        time.sleep(0.3)
        return 'message'

    topic = SimpleNamespace(publish=sent.append)
    publisher = sliced_publisher.SlicedPublisher(topic)
    publisher.close()  # without a message
    publisher._send(sliced_publisher.THREAD_BYTES, make)
    publisher.close()
    assert sent == ['message']
