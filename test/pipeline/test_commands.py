# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Commands in the stream: the stamps at which requests act, and what a stage may write."""

from __future__ import annotations

from typing import Any

import pytest
from helpers import PERIOD_NS, START_NS
from state_digest import digest_of
from test_stages import SMALL, circles

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.pose_hint import PoseHint
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.pipeline import commands
from ratslam_ros.pipeline.local_view import LocalViewStage
from ratslam_ros.pipeline.pipeline import COMMAND, Pipeline
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.pipeline.stage import Output

REQUESTS: dict[int, list[commands.Command]] = {
    20: [commands.SetPaused(True, 'local_view'), commands.SetMapping(False, 'pose_cells')],
    30: [commands.SetPaused(False, 'local_view'), commands.Relocated('local_view')],
    45: [commands.SetMapping(True, 'pose_cells')],
    60: [commands.Configure(SMALL.with_values({'pose_cells.pc_vt_inject_energy': 0.4}))],
    75: [commands.Reset('pose_cells'), commands.NamePlace('dock', offset=(0.1, 0.0, 0.0))],
    90: [commands.Hint(PoseHint(Pose(1.0, 2.0, 0.5), 1.0, 0.0, 1.0, 0.1))],
}


def digests(slam: RatSLAM) -> list[str]:
    slam.finish()
    return [digest_of(state) for name, state in slam.state().items() if name != 'inputs']


def recorded(slam: RatSLAM) -> list[tuple[int, commands.Command]]:
    found: list[tuple[int, commands.Command]] = []
    slam.pipeline.observe(COMMAND, lambda stamp_ns, command: found.append((stamp_ns, command)))
    return found


def test_replay_of_recorded_requests_gives_the_same_states() -> None:
    live, replayed = RatSLAM(SMALL), RatSLAM(SMALL)
    inputs, record = circles(110, ('odometry', 'image')), recorded(live)
    for number, message in enumerate(inputs):
        live.pipeline.feed(*message)
        if number % 2 == 0:  # odometry n has come, and waits for image n
            for command in REQUESTS.get(number // 2, ()):
                live.pipeline.feed(COMMAND, commands.NOW, command)
    requests = [command for some in REQUESTS.values() for command in some]
    assert [command for _, command in record] == requests
    stamps = [stamp_ns for stamp_ns, _ in record]
    assert stamps == sorted(set(stamps))
    for stamp_ns, command in record:
        replayed.pipeline.feed(COMMAND, stamp_ns, command)
    for message in inputs:
        replayed.pipeline.feed(*message)
    expected = digests(live)
    assert digests(replayed) == expected
    plain = RatSLAM(SMALL)
    for message in inputs:
        plain.pipeline.feed(*message)
    assert digests(plain) != expected


def test_request_does_not_drop_inputs_that_wait() -> None:
    slam = RatSLAM(SMALL)
    for message in circles(10, ('odometry', 'image'))[:-1]:
        slam.pipeline.feed(*message)
    assert slam.pipeline.order.held == 1
    slam.pipeline.feed(COMMAND, commands.NOW, commands.Reset('local_view'))
    assert len(slam.local_view or ()) == 0
    assert len(slam.pose_cells) > 0  # the command is not for it
    assert slam.pipeline.order.held == 1


def test_command_with_a_passed_stamp_acts_at_once() -> None:
    slam = RatSLAM(SMALL)
    record = recorded(slam)
    for message in circles(10, ('odometry', 'image')):
        slam.pipeline.feed(*message)
    slam.pipeline.feed(COMMAND, START_NS, commands.NewSession())
    slam.pipeline.feed(COMMAND, START_NS + 20 * PERIOD_NS, commands.NewSession())
    assert record == [(START_NS + 9 * PERIOD_NS + 1, commands.NewSession())]
    slam.finish()
    assert len(record) == 2


class Misspelt(LocalViewStage):
    WRITES = ('templates',)


class Undeclared(LocalViewStage):
    WRITES = ()

    written: Any = (Output('template', START_NS, None),)

    def _match(self, stamp_ns: int, image: Any) -> Any:
        return self.written


def test_stage_that_writes_an_unknown_stream_is_refused() -> None:
    with pytest.raises(UnusableParameter, match=r"'templates', which is no .* image, template, "):
        Pipeline([Misspelt(SMALL)], 0)


@pytest.mark.parametrize('written', [Undeclared.written, Undeclared.written[0], [('template', 1)]])
def test_reader_that_returns_undeclared_outputs_is_refused(written: Any) -> None:
    stage = Undeclared(SMALL)
    stage.written = written
    pipeline = Pipeline([stage], 0)
    with pytest.raises(UnusableParameter, match=r'local_view has .*template.* reading image; exp'):
        pipeline.feed('image', START_NS, None)
        pipeline.finish()


def test_reader_that_returns_none_writes_nothing() -> None:
    stage = Undeclared(SMALL)
    stage.written = None
    pipeline = Pipeline([stage], 0)
    pipeline.observe('template', lambda stamp_ns, match: pytest.fail('nothing was written'))
    pipeline.feed('image', START_NS, None)
    pipeline.finish()
    assert pipeline.order.held == 0


@pytest.mark.parametrize('stage', ['experience_map', 'pose_cells'])
def test_map_goes_on_after_one_stage_was_reset(stage: str) -> None:
    """Ids of the pose cells mean other places then than those of the map."""
    slam = RatSLAM(SMALL)
    inputs = circles(220, ('odometry', 'image'))  # two rounds
    for message in inputs[:200]:
        slam.pipeline.feed(*message)
    before = len(slam.experience_map)
    slam.pipeline.command(commands.Reset(stage))
    assert len(slam.experience_map) == (0 if stage == 'experience_map' else before)
    for message in inputs[200:]:
        slam.pipeline.feed(*message)
    slam.finish()
    assert len(slam.experience_map) > (0 if stage == 'experience_map' else before)
    again = RatSLAM(SMALL)
    again.restore(slam.state())
    assert digests(again) == digests(slam)
