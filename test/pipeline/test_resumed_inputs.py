# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A pipeline whose state is saved while it runs goes on as without the interruption."""

from __future__ import annotations

from typing import Any, ClassVar

import pytest
from helpers import seen, twist

from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.common.state import State
from ratslam_ros.pipeline.pipeline import Pipeline
from ratslam_ros.pipeline.stage import Reader


class Waiting:
    """Awaits an answer to each template before the next one."""

    NAME: ClassVar[str] = 'waiting'
    WRITES: ClassVar[tuple[str, ...]] = ()

    def __init__(self, read: list[int]) -> None:
        self.read, self.answers = read, 0

    def readers(self) -> dict[str, Reader]:
        return {'odometry': self._ignore, 'template': self._view, 'relocation': self._answered}

    def _ignore(self, stamp_ns: int, item: Odometry) -> None:
        pass

    def _view(self, stamp_ns: int, item: Any) -> None:
        self.read.append(stamp_ns)

    def _answered(self, stamp_ns: int, item: Any) -> None:
        self.answers += 1

    def awaits_answer(self) -> bool:
        return len(self.read) > self.answers

    def expect_answers(self) -> None:
        raise AssertionError('nothing is passed on')

    def state(self) -> State:
        return {'read': [*self.read], 'answers': self.answers}

    def restore(self, state: State) -> None:
        self.read[:], self.answers = state['read'], state['answers']


def filled() -> tuple[Pipeline, list[int]]:
    """Return a pipeline in which templates wait for an answer to the first."""
    pipeline = Pipeline([Waiting(read := [])], 10)
    for stamp_ns in range(1, 6):
        pipeline.feed('odometry', stamp_ns, twist(stamp_ns))
        pipeline.feed('template', stamp_ns, seen(stamp_ns))
    assert read == [1]
    return pipeline, read


@pytest.mark.parametrize(('end', 'at'), [
    ('go_on_unanswered', 2), *(('finish', at) for at in range(2, 6))
])
def test_state_saved_while_items_pass_unanswered_lets_them_pass(end: str, at: int) -> None:
    pipeline, read = filled()
    saved: list[dict[str, Any]] = []

    def save(stamp_ns: int, item: Any) -> None:
        if stamp_ns == at:
            saved.append(pipeline.state())

    pipeline.observe('template', save)
    getattr(pipeline, end)()
    [states] = saved
    again, read_again = filled()
    again.restore_stage('waiting', states['waiting'])
    again.restore_inputs(states['inputs'])
    again.go_on()
    assert read_again == read
    assert again.state() == pipeline.state()
