# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Advice after a run: every problem is reported with a command, and a good run has none."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.pipeline.items import OdometryStep, Step, ViewStep
from ratslam_ros.results.advice import LONG_DRIVE_S, Observations, Source, advise

S = 10**9
PER_LAP = 200
PLACES = 100
"""Every place is seen in two frames."""

SUMMARY = {'frames': 2000, 'experiences': 100, 'loop_closures': 400}
SOURCE = Source(Path('a bag'), Config(), visual_odometry=True)


def drive(
    laps: int = 10, lap_deg: float = 360.0, period_s: float = 0.1,
    template: Callable[[int], int] = lambda frame: frame % PER_LAP * PLACES // PER_LAP,
    rest: range = range(0), gap: tuple[int, float] = (0, 0.0),
) -> Iterator[Step]:
    """Yield the steps of a robot that drives laps.

    Args:
        laps: number of laps.
        lap_deg: measured turn in a lap.
        period_s: time between frames.
        template: template id by frame.
        rest: frames at which the robot stands still.
        gap: frame before which time passes, and the duration in s.
    """
    seen: set[int] = set()
    x_m = heading_rad = time_s = 0.0
    for frame in range(laps * PER_LAP):
        time_s += period_s + (gap[1] if frame == gap[0] else 0.0)
        if frame not in rest:
            x_m += 0.1
            heading_rad = wrap(heading_rad + math.radians(lap_deg / PER_LAP))
        stamp_ns = round(time_s * S)
        pose = Pose(x_m, 0.0, heading_rad)
        yield OdometryStep(stamp_ns, pose, pose, 0, Pose(0.0, 0.0, 0.0))
        number = template(frame)
        match = ViewMatch(number, number not in seen, 0.0, 0.0)
        seen.add(number)
        action = MapAction('none', -1, -1, number, 0.0, Place(0.0, 0.0, 0.0))
        yield ViewStep(stamp_ns, match, action)


def observed(steps: Iterable[Step]) -> Observations:
    observations = Observations()
    for step in steps:
        observations.add(step)
    return observations


def advice(steps: Iterable[Step], source: Source = SOURCE, **summary: Any) -> list[str]:
    return advise(observed(steps), {**SUMMARY, **summary}, source)


def only(lines: list[str]) -> tuple[str, list[str]]:
    """Return the problem and the words of the command of the only line."""
    [line] = lines
    problem, _, command = line.rpartition(': ')
    return problem, shlex.split(command)


def test_good_runs_have_no_advice() -> None:
    assert advice(drive()) == []
    assert advice(drive(lap_deg=340.0)) == []
    assert advice(drive(lap_deg=0.0)) == []
    assert advice(drive(laps=1), loop_closures=0) == []
    assert advice([]) == []


def test_wrong_turn_around_loop_names_field_of_view() -> None:
    problem, command = only(advice(drive(lap_deg=150.0)))
    assert '150 deg around a loop' in problem
    assert command == [
        'ratslam', 'replay', 'a bag', '--set', 'visual_odometry.camera_fov_deg=120'
    ]


@pytest.mark.parametrize('known', [range(300), range(300, 600)])
def test_turns_without_odometry_say_nothing(known: range) -> None:
    """The odometry begins late or ends early, and the robot drives on."""
    steps = (
        step for number, step in enumerate(drive(laps=3))
        if isinstance(step, ViewStep) or number // 2 in known
    )
    assert advice(steps) == []


def test_turn_that_no_field_of_view_explains_is_a_confusion() -> None:
    problem, words = only(advice(drive(lap_deg=49.0)))  # 50 degrees of view would be 367
    assert 'by 49 deg' in problem and 'confused' in problem
    assert words == ['ratslam', 'tune', 'a bag']


def test_turns_before_the_field_of_view_was_found_say_nothing() -> None:
    found = {'rotation_gain': 2.4, 'calibration_loops': 9}
    assert advice(drive(lap_deg=150.0), odom_calibration=found) == []


def test_wrong_turn_of_odometry_names_the_gain() -> None:
    source = Source(Path('bag'), Config(), False, ('--odom-topic', 'odom'), ('--config', 'irat'))
    _, command = only(advice(drive(lap_deg=-300.0), source))
    assert command == [
        'ratslam', 'replay', 'bag', '--odom-topic', 'odom', '--config', 'irat',
        '--set', 'inputs.odom_rotation_gain=1.2',
    ]


def test_confused_places_are_reported() -> None:
    def template(frame: int) -> int:
        place = frame % PER_LAP * PLACES // PER_LAP
        return place % 50 if place % 5 == 0 else place  # Two places at opposite headings.

    problem, command = only(advice(drive(template=template)))
    assert 'different places are confused' in problem
    assert command == ['ratslam', 'tune', 'a bag']


@pytest.mark.parametrize(
    ('template', 'word'),
    [
        (lambda frame: 0 if frame % 5 else frame, 'same template'),
        (lambda frame: frame, 'match no template'),
        (lambda frame: frame if frame % 3 else 0, 'in one frame only'),
    ],
)
def test_threshold_at_edge_of_errors_is_reported(
    template: Callable[[int], int], word: str
) -> None:
    problem, command = only(advice(drive(template=template)))
    assert word in problem
    assert command == ['ratslam', 'tune', 'a bag']


def test_robot_at_rest_says_nothing_about_threshold() -> None:
    rest = range(100, 2000)
    assert advice(drive(template=lambda frame: min(frame // 2, 50), rest=rest)) == []


@pytest.mark.parametrize('closures', [0, 2])
def test_long_drive_without_closures_is_reported(closures: int) -> None:
    problem, command = only(advice(drive(), loop_closures=closures))
    assert f'{closures or "no"} loop closures in 200 s' in problem
    assert command == ['ratslam', 'tune', 'a bag']
    assert advice(drive(period_s=0.9 * LONG_DRIVE_S / 2000), loop_closures=closures) == []


@pytest.mark.parametrize(
    ('frame', 'words'), [(200, ['--start', '30']), (1900, ['--duration', '189'])]
)
def test_gap_of_odometry_is_reported(frame: int, words: list[str]) -> None:
    problem, command = only(advice(drive(gap=(frame, 9.9))))
    assert 'odometry gap of 10.0 s' in problem
    assert command == ['ratslam', 'replay', 'a bag', *words]
    assert '2 parts' in advice(drive(gap=(frame, 9.9)), components=2)[0]
    assert advice(drive(gap=(frame, 9.9)), components=1) == []
    assert advice(drive(gap=(frame, 1.5))) == []


def test_views_without_structure_are_reported() -> None:
    problem, command = only(advice(drive(), low_texture=300))
    assert '15% of the views' in problem
    assert command == ['ratslam', 'replay', 'a bag', '--video', 'video.mp4']
    assert advice(drive(), low_texture=100) == []
