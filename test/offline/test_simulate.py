# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam simulate``, and the parameters of a simulated robot."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ratslam_ros.cli import main
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.opening import open_run
from ratslam_ros.recordings import open_recording
from ratslam_ros.results.trajectory import read_tum
from ratslam_simulator.config import (
    SimulatorParameters,
    parse_carries,
    parse_obstacles,
    parse_start,
    parse_walks,
)
from ratslam_simulator.floor_plan import load_floor_plan, office
from ratslam_simulator.people import Walk
from ratslam_simulator.simulation import ObstacleEvent

OFFICE = office()
RUN = ('simulate', '--plan', 'office', '--explore', '0.5', '--quiet')


def test_short_run_writes_all_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, record = tmp_path / 'out', tmp_path / 'recording'
    assert main([*RUN, '--goals', 'E,C', '--out', str(out), '--record', str(record)]) == 0
    report = capsys.readouterr().out
    assert report.startswith('explored for 0.5 minutes')
    assert 'of 2 goals reached' in report
    plots = [line for line in report.splitlines() if line.endswith('.png')]
    assert all(Path(name).stat().st_size > 1000 for name in plots)
    assert {Path(name).name for name in plots} >= {'floor.png', 'map.png', 'matches.png'}
    first, second = csv.DictReader((out / 'trials.csv').open())
    assert (first['goal'], second['goal']) == ('E', 'C')
    assert second['outcome'] == 'refused'  # The robot has not passed it.
    assert second['succeeded'] == 'False'
    truth = read_tum(out / 'truth.tum')
    summary = json.loads((out / 'summary.json').read_text())
    assert summary['odometry'] == len(truth)
    assert summary['simulator']['plan'] == 'office'
    experiences = json.loads((out / 'map.json').read_text())['experiences']
    assert experiences
    run = open_run(out)
    state = run.seek(run.end_ns)
    assert len(state.map) == len(experiences)
    assert state.scan is not None
    assert run.image_at(run.end_ns) is not None
    with open_recording(record) as recording:
        selection = recording.select(None, None)
    assert (selection.image_topic, selection.odom_topic) == ('/camera/image/compressed', '/odom')
    assert 'name: /scan' in (record / 'metadata.yaml').read_text()
    assert (record / 'truth.tum').read_text() == (out / 'truth.tum').read_text()


def test_same_seed_gives_same_map_and_random_goals(tmp_path: Path) -> None:
    words = [*RUN, '--random-goals', '1', '--noise', '2', '--people', '2', '--seed', '3']
    found = []
    for name in ('first', 'second'):
        assert main([*words, '--out', str(tmp_path / name)]) == 0
        files = (tmp_path / name / file for file in ('map.json', 'trials.csv'))
        found.append([file.read_text() for file in files])
    assert found[0] == found[1]
    assert 'place_1' in found[0][1]


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['--goals', 'E,Nowhere'], 'Nowhere'), (['--plan', 'mars'], 'mars'),
        (['--start', 'Q'], "'Q'"), (['--explore', '-1'], '--explore'),
        (['--obstacle', 'box,1,2'], 'box,1,2'), (['--noise', '-1'], 'noise'),
        (['--carry', '1,2,3'], 'x,y,degrees,at_s'), (['--walk', '1,2'], 'x,y,x,y,...,from_s,to_s'),
        (['--set', 'goal_follower.speed=1'], 'speed'), (['--start', '0,0,0'], 'does not fit'),
        (['--goals', 'A', '--random-goals', '2'], 'not allowed'),
    ],
)
def test_invalid_option_is_reported_in_one_line(
    tmp_path: Path, refusal: Callable[..., str], words: list[str], message: str
) -> None:
    assert message in refusal(*RUN, *words, '--out', str(tmp_path / 'out'))


def test_start_is_place_or_pose() -> None:
    plan = office()
    assert parse_start('A', plan) == Pose(*plan.places['A'], 0.0)
    assert parse_start('any', load_floor_plan('obstacle_loop')).x_m == pytest.approx(1.26)
    x_m, y_m = next(iter(plan.places.values()))
    assert parse_start('any', plan) == Pose(x_m, y_m, 0.0)
    assert parse_start('1.5,2,90', plan) == Pose(1.5, 2.0, math.pi / 2)
    for wrong in ('', '1,2', 'nan,1,2', 'a,b,c', '1,2,3,4'):
        with pytest.raises(UnusableInput, match='start'):
            parse_start(wrong, plan)


def test_obstacles_are_added_and_removed() -> None:
    assert parse_obstacles('none') == []
    assert parse_obstacles('a,1,2,3,4,5,6;b,1,2,3,4,5') == [
        ObstacleEvent(5.0, 'add', 'a', 1.0, 2.0, 3.0, 4.0), ObstacleEvent(6.0, 'remove', 'a'),
        ObstacleEvent(5.0, 'add', 'b', 1.0, 2.0, 3.0, 4.0),
    ]
    for wrong in ('', 'a', 'a,1,2,3,4', ',1,2,3,4,5', 'a,1,2,3,4,inf', 'a,1,2,3,4,6,5', 'a;b'):
        with pytest.raises(UnusableInput, match='obstacle'):
            parse_obstacles(wrong)


def test_carries_are_times_and_poses() -> None:
    assert parse_carries('none') == []
    assert parse_carries('1,2,90,600;3,4,0,5') == [
        (600.0, Pose(1.0, 2.0, math.pi / 2)), (5.0, Pose(3.0, 4.0, 0.0)),
    ]
    for wrong in ('', '1,2,3', '1,2,3,inf', 'a,1,2,3', '1,2,3,4,5'):
        with pytest.raises(UnusableInput, match='carry'):
            parse_carries(wrong)


def test_walks_are_points_and_times() -> None:
    assert parse_walks('none') == []
    assert parse_walks('1,2,600,660;1,2,3,4,5') == [
        Walk([(1.0, 2.0)], 600.0, 660.0), Walk([(1.0, 2.0), (3.0, 4.0)], 5.0),
    ]
    for wrong in ('', '1,2', '1,2,inf', 'a,1,2', '1,2,6,5', '1,2,3;4'):
        with pytest.raises(UnusableInput, match='walk'):
            parse_walks(wrong)


@given(st.text(max_size=20))
def test_any_text_is_parsed_or_rejected_in_one_line(text: str) -> None:
    parse_in_office = partial(parse_start, plan=OFFICE)
    for read in (parse_obstacles, parse_carries, parse_walks, parse_in_office):
        try:
            read(text)
        except UnusableInput as error:
            assert '\n' not in str(error)


def test_noise_factor_scales_all_sensors() -> None:
    twice, once = SimulatorParameters(noise=2.0).options(), SimulatorParameters().options()
    assert twice.laser is not None and once.laser is not None
    assert twice.camera is not None and once.camera is not None
    assert twice.laser.noise_m == 2.0 * once.laser.noise_m
    assert twice.camera.noise_grey == 2.0 * once.camera.noise_grey
    assert twice.robot.slip_m == 2.0 * once.robot.slip_m
