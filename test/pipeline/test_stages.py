# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every stage gives the same bytes in one pipeline and in two, with late messages, and restored.

tools/check_stages.py does the same with whole recordings, and with stages of your own.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence

import gap_drives
import kidnapped_drive
import numpy as np
import pytest
from check_stages import Message, broken_rules, differences, messages_of, run, stages_of
from helpers import PERIOD_NS, SMALL_IMAGES, START_NS, extended, picture, real_recording, twist
from rooms import Line, scan_in
from state_digest import digest_of

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.state import State
from ratslam_ros.core.mapping.pose_hint import PoseHint
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.files.config import load_config
from ratslam_ros.pipeline import commands
from ratslam_ros.pipeline.local_view import LocalViewStage
from ratslam_ros.pipeline.pipeline import COMMAND
from ratslam_ros.pipeline.stage import Output, Reader

PER_LAP = 30
ROOM: list[Line] = [
    [(-4.0, -4.0), (4.0, -4.0), (4.0, 3.0), (1.0, 3.0), (1.0, 4.0), (-4.0, 4.0), (-4.0, -4.0)]
]
SMALL = extended().with_values(SMALL_IMAGES)
FORGETTING = {
    'local_view.vt_max': 50, 'pose_cells.exp_max': 40, 'pose_cells.exp_forget': 'freshness',
    'memory.forget_after_s': 4.0,
}
AUTOMATIC = {
    'local_view.vt_match_threshold': -1, 'local_view.vt_match_ratio': -1,
    'local_view.vt_recent_templates': -1, 'pose_cells.pc_cell_x_size': -1,
    'pose_cells.exp_delta_pc_threshold': -1, 'pose_cells.odom_calibration': True,
    'pose_cells.exp_view_links': True,
}
SCANS = {'experience_map.exp_align_scans': True, 'experience_map.exp_relocate': 'both'}
VARIANTS = {
    'pruning by visits, goal memory': {
        'pose_cells.exp_max': 40, 'goal_memory.goal_memory': True,
        'pose_cells.pc_vt_agree_views': 3.0, 'pose_cells.exp_weigh_links': True,
    },
    'automatic, scans, forgetting': {**AUTOMATIC, **SCANS, **FORGETTING},
}


def circles(count: int, streams: Sequence[str] = ('odometry', 'scan', 'image')) -> list[Message]:
    """Drive two laps of a circle that stays the same, then one with new views, and so on.

    Some images are repeated, and some cannot be decoded.
    """
    found: list[Message] = []
    for n in range(count):
        lap, place = divmod(n, PER_LAP)
        circle, at = lap // 3 + 1 if lap % 3 == 2 else 0, math.tau * place / PER_LAP
        ns = START_NS + n * PERIOD_NS
        pose = Pose(2.0 * math.cos(at), 2.0 * math.sin(at), at + math.pi / 2.0)
        image = None if n % 53 == 52 else PreparedImage(picture(100 * circle + place))
        found.append(('odometry', ns, twist(ns, 20.0 * math.tau / PER_LAP, math.tau / 3.0)))
        if n % 7 != 3:
            found.append(('scan', ns, scan_in(ROOM, pose, ns, beams=91)))
        found += [('image', ns, image)] * (1 + (n % 37 == 36))
    return [message for message in found if message[0] in streams]


def kidnapped() -> list[Message]:
    north = Pose(9.5, 9.4, math.pi + 0.2)
    return [
        (stream, one.stamp_ns, item) for one in kidnapped_drive.samples(1, north, 30)
        for stream, item in (
            ('odometry', one.odometry), ('scan', one.scan), ('template', one.match)
        )
    ]


def with_gap() -> list[Message]:
    drive = gap_drives.Drive(gap_drives.config())
    drive.forward(60)
    drive.carry(30)
    drive.forward(70)
    return [
        (stream, stamp_ns, item) for stamp_ns, message in drive.messages.items()
        for stream, item in (
            ('odometry', message),
            ('template', ViewMatch(drive.templates[stamp_ns], False, 0.0, 0.0)),
        )
    ]


@pytest.mark.parametrize('variant', VARIANTS)
def test_stages_with_odometry_split_anywhere_give_the_same_bytes(variant: str) -> None:
    config = SMALL.with_values(VARIANTS[variant])
    assert [*differences(stages_of(config), circles(95), 70)] == []


def test_stages_with_visual_odometry_split_anywhere_give_the_same_bytes() -> None:
    messages = circles(40, ('scan', 'image'))
    stages = stages_of(SMALL.with_values(SCANS), 'visual_odometry')
    assert len(stages()) == 5
    assert [*differences(stages, messages, 7)] == []


def test_stages_with_a_gap_of_the_odometry_give_the_same_bytes() -> None:
    assert [*differences(stages_of(gap_drives.config(), 'pose_cells'), with_gap(), 20)] == []


def test_stages_with_a_relocation_give_the_same_bytes() -> None:
    all_stages = stages_of(kidnapped_drive.config(), 'pose_cells')
    split = run(lambda: all_stages()[:2], kidnapped(), 1, random.Random(1), 200)
    whole = run(lambda: all_stages()[:2], kidnapped(), 2)
    assert any('MapRelocation' in one for one in whole.written['relocation'])
    assert split.written == whole.written
    assert digest_of(split.states()) == digest_of(whole.states())


def test_stages_of_this_package_break_no_rule() -> None:
    messages = circles(150)
    stages = stages_of(SMALL.with_values({**SCANS, **AUTOMATIC}))
    assert [*broken_rules(stages, messages)] == []
    cameras = stages_of(SMALL.with_values(SCANS), 'visual_odometry')
    assert [*broken_rules(cameras, circles(60, ('scan', 'image')))] == []


class Broken(LocalViewStage):
    """A local view that breaks one rule of stages."""

    rule = ''

    def readers(self) -> dict[str, Reader]:
        found = super().readers()
        if self.rule == 'reads no command':
            del found['command']
        if self.rule == 'written nothing':
            found['image'] = lambda stamp_ns, image: ()
        return found

    def _obey(self, stamp_ns: int, command: commands.Command) -> tuple[Output, ...]:
        kind = {'reset': commands.Reset, 'mapping is off': commands.SetMapping}.get(self.rule)
        return () if kind and isinstance(command, kind) else super()._obey(stamp_ns, command)

    def state(self) -> State:
        state = super().state()
        if self.rule == 'changed later':
            state['core']['count'] = self._count
        return state

    def _match(self, stamp_ns: int, image: PreparedImage | None) -> tuple[Output, ...]:
        self._count[0] += 1
        return super()._match(stamp_ns, image)

    _count = np.zeros(1, np.int64)


@pytest.mark.parametrize('rule', [
    'reads no command', 'written nothing', 'reset', 'mapping is off', 'changed later',
])
def test_broken_rules_of_a_stage_are_found(rule: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Broken, 'rule', rule)
    found = [*broken_rules(stages_of(SMALL, own=[Broken]), circles(60))]
    assert any(text.startswith('local_view: ') and rule in text for text in found), found


COMMANDS: dict[str, list[commands.Command]] = {
    'process': [
        commands.Configure(SMALL.with_values({'local_view.vt_match_threshold': 0.5})),
        commands.SetMapping(False), commands.SetMapping(True, 'local_view'),
        commands.SetPaused(True, 'pose_cells'), commands.SetPaused(False, 'pose_cells'),
        commands.Relocated('pose_cells'), commands.Reset(),
    ],
    'map': [
        commands.NewSession(), commands.Relocated(), commands.SetBehaviour('wall'),
        commands.ReportBehaviour(START_NS + 49 * PERIOD_NS, 'free'),  # expires
        commands.Hint(PoseHint(Pose(1.0, 2.0, 0.5), 1.0, 0.0, 1.0, 0.1)),
        commands.MarkGoal('dock'),
        commands.BlockWay(0.5, 3.0), commands.NamePlace('dock'), commands.SearchPlace(),
    ],
    'camera': [
        commands.ReportBehaviour(10**18, 'wall', True, 0.5), commands.SetFieldOfView(70.0),
        commands.Reset('visual_odometry'),
    ],
}


@pytest.mark.parametrize('name', COMMANDS)
def test_commands_at_stamps_in_any_split_give_the_same_bytes(name: str) -> None:
    messages = circles(75) if name != 'camera' else circles(60, ('scan', 'image'))
    stages = stages_of(SMALL, 'visual_odometry' if name == 'camera' else 'local_view')
    plain = run(stages, messages, len(stages()))
    for number, command in enumerate(COMMANDS[name]):
        stamp_ns = START_NS + (37 + 4 * number) * PERIOD_NS
        before = next(n for n, one in enumerate(messages) if one[1] >= stamp_ns)
        messages.insert(before, (COMMAND, stamp_ns, command))
    assert [*differences(stages, messages, 40)] == []
    found = run(stages, messages, len(stages()))
    assert [*map(digest_of, found.states().values())] != [*map(digest_of, plain.states().values())]


@pytest.mark.parametrize('name', ['rc_car_eight', 'lab_car'])
def test_real_recordings_give_the_same_bytes_in_any_split(name: str) -> None:
    head, messages = messages_of(real_recording(name), 5.0)
    assert [*differences(stages_of(load_config('auto')[0], head), messages, 50)] == []
