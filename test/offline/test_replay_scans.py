# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replay with laser scans: the map made with them, and scans that cannot be used."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from helpers import (
    IMAGE_TOPIC,
    ODOM_TOPIC,
    PERIOD_NS,
    SCAN_TOPIC,
    SMALL_IMAGES,
    START_NS,
    Recorded,
    extended,
    image_message,
    odometry_message,
    picture,
    scan_message,
    set_options,
    write_bag,
)
from rooms import Line, scan_in

from ratslam_ros.cli import main
from ratslam_ros.core.common.odometry import Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan, UnusableScan, checked_scan
from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableInput
from ratslam_ros.event_inputs import recorded_inputs
from ratslam_ros.maps import read_map
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.offline.map_recording import map_recording
from ratslam_ros.offline.map_upkeep import experience_map_of
from ratslam_ros.offline.replay import ReplayOptions, replay
from ratslam_ros.offline.replay_map import ReplayMap
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.recordings import open_recording
from ratslam_ros.results.evaluation import evaluate
from ratslam_ros.results.trajectory import read_tum, tum_line

WITHOUT = extended().with_values(SMALL_IMAGES)
CONFIG = WITHOUT.with_values({'experience_map.exp_align_scans': True})
WORDS = ['--config', 'extended', *set_options(SMALL_IMAGES)]
ALIGN = ['--set', 'experience_map.exp_align_scans=true']
MAPS = ('map.json', 'frames.csv', 'trajectory.tum', 'trajectory_final.tum', 'dead_reckoning.tum')

ROOM: list[Line] = [
    [(-3.0, -4.0), (4.0, -4.0), (4.0, 1.0), (3.5, 1.0), (3.5, 3.0), (-1.0, 3.0), (-1.0, 4.0),
     (-3.5, 4.0), (-3.5, 0.0), (-3.0, 0.0), (-3.0, -4.0)],
]
LAPS, PER_LAP, RADIUS_M = 3, 24, 2.0
SHIFTS = (0.0, 0.4, -0.35)
"""Lead of the robot in each lap, in steps; the images are the same as without it."""

FRAMES = LAPS * PER_LAP
STAMPS = [START_NS + i * PERIOD_NS for i in range(FRAMES)]


def angle(i: int) -> float:
    return math.tau / PER_LAP * (i + SHIFTS[i // PER_LAP])


def truth(i: int) -> Pose:
    a = angle(i)
    return Pose(RADIUS_M * math.cos(a), RADIUS_M * math.sin(a), a + math.pi / 2)


def motion(i: int) -> Twist:
    turn = (angle(i) - angle(i - 1)) if i else 0.0
    return Twist(RADIUS_M * turn / 0.1, turn / 0.1)


def scan(i: int) -> Scan:
    """Return a scan of the room with the float32 values of a message."""
    seen = scan_in(ROOM, truth(i), STAMPS[i], beams=91)
    return dataclasses.replace(
        seen,
        angle_min_rad=float(np.float32(seen.angle_min_rad)),
        angle_increment_rad=float(np.float32(seen.angle_increment_rad)),
        ranges_m=seen.ranges_m.astype(np.float32).astype(np.float64),
    )


def pixels(i: int) -> np.ndarray:
    return picture(i % PER_LAP, 24, 32)


def drive(scan_topics: tuple[str, ...] = (SCAN_TOPIC,)) -> Iterator[Recorded]:
    """Yield laps in a room whose views are recognised some way before and behind their place."""
    still = Pose(0.0, 0.0, 0.0)
    for i, stamp_ns in enumerate(STAMPS):
        message = odometry_message(stamp_ns, *motion(i)[:2], still)
        yield stamp_ns, ODOM_TOPIC, 'odometry', message
        for topic in scan_topics:
            yield stamp_ns + 1, topic, 'scan', scan_message(scan(i))
        yield stamp_ns + 2, IMAGE_TOPIC, 'image', image_message(stamp_ns, pixels(i))


def spoiled(messages: list[Recorded], which: dict[int, Any]) -> list[Recorded]:
    """Return the messages with some scans, given by number, replaced."""
    scans = [i for i, message in enumerate(messages) if message[1] == SCAN_TOPIC]
    out = list(messages)
    for number, message in which.items():
        out[scans[number]] = (*out[scans[number]][:3], message)
    return out


def run(bag: Path, folder: Path, config: Config = CONFIG, **given: Any) -> tuple[Any, list[str]]:
    """Replay; return the summary and the warnings."""
    with open_recording(bag) as recording:
        selection = recording.select(scans=config.experience_map.exp_align_scans, **given)
        outcome = replay(recording, selection, config, folder, ReplayOptions(progress=False))
        return outcome.summary, recording.warnings


def bytes_of(folder: Path) -> list[bytes]:
    return [(folder / name).read_bytes() for name in MAPS]


@pytest.fixture(scope='module')
def messages() -> list[Recorded]:
    return list(drive())


@pytest.fixture(scope='module')
def bag(messages: list[Recorded], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp('recordings') / 'rounds', messages)


@pytest.fixture(scope='module')
def aligned(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the results of a replay with scans."""
    folder = tmp_path_factory.mktemp('aligned')
    summary, warnings = run(bag, folder)
    assert warnings == []
    assert summary['frames'] == summary['odometry'] == FRAMES
    assert summary['loop_closures'] > PER_LAP
    assert summary['dropped'] == summary['late'] == summary['refused'] == 0
    return folder


@pytest.fixture(scope='module')
def blind(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the results of a replay that ignores the recorded scans."""
    folder = tmp_path_factory.mktemp('blind')
    _, warnings = run(bag, folder, WITHOUT)
    assert warnings == []
    return folder


def error_m(folder: Path, tmp_path: Path) -> float:
    """Return the ATE of the final trajectory."""
    (tmp_path / 'truth.tum').write_text(''.join(map(tum_line, STAMPS, map(truth, range(FRAMES)))))
    final, true = (read_tum(f / n) for f, n in ((folder, MAPS[3]), (tmp_path, 'truth.tum')))
    return float(evaluate(final, true).ate.rmse)


def test_scans_reduce_the_map_error(aligned: Path, blind: Path, tmp_path: Path) -> None:
    assert error_m(aligned, tmp_path) < 0.02
    assert error_m(blind, tmp_path) > 0.08


def test_recording_without_scans_is_mapped_with_warning(
    messages: list[Recorded], blind: Path, tmp_path: Path
) -> None:
    bare = [message for message in messages if message[1] != SCAN_TOPIC]
    _, warnings = run(write_bag(tmp_path / 'bag', bare), tmp_path / 'out')
    assert bytes_of(tmp_path / 'out') == bytes_of(blind)
    assert warnings == [
        'exp_align_scans is set, but the recording has no scans: the map is built without them'
    ]


def test_invalid_scans_are_dropped_with_warning(
    messages: list[Recorded], aligned: Path, tmp_path: Path
) -> None:
    no_angles, no_beams = (scan_message(scan(i)) for i in (30, 40))
    no_angles.angle_min = math.nan
    no_beams.ranges = np.empty(0, np.float32)
    bag = write_bag(tmp_path / 'bag', spoiled(messages, {30: no_angles, 40: no_beams}))
    summary, (warning,) = run(bag, tmp_path / 'out')
    assert warning.startswith('2 scan messages were not used, the first: angle_min is nan')
    assert summary['dropped'] == 2
    assert summary['frames'] == FRAMES
    # The map equals that of a recording without these scans.
    left = [m for m in messages if m[1] != SCAN_TOPIC or m[0] - 1 not in (STAMPS[30], STAMPS[40])]
    run(write_bag(tmp_path / 'missing', left), tmp_path / 'other')
    assert bytes_of(tmp_path / 'out') == bytes_of(tmp_path / 'other')
    assert bytes_of(tmp_path / 'out') != bytes_of(aligned)


def test_several_scan_topics_require_a_choice(
    messages: list[Recorded], aligned: Path, tmp_path: Path
) -> None:
    both = []
    for message in messages:
        both.append(message)
        if message[1] == SCAN_TOPIC:  # Another laser, which faces a wall.
            wall = dataclasses.replace(scan(0), stamp_ns=message[0] - 1)
            both.append((message[0], '/rear/scan', 'scan', scan_message(wall)))
    bag = write_bag(tmp_path / 'bag', both)
    with pytest.raises(UnusableInput, match=r'2 topics with scans: .* --scan-topic /rear/scan or'):
        run(bag, tmp_path / 'out')
    run(bag, tmp_path / 'out', scan_topic='scan')
    assert bytes_of(tmp_path / 'out') == bytes_of(aligned)
    run(bag, tmp_path / 'rear', scan_topic='/rear/scan')
    assert bytes_of(tmp_path / 'rear') != bytes_of(aligned)


def halved(messages: list[Recorded], late_ns: int = 0) -> list[Recorded]:
    """Return the messages with each scan split between two lasers."""
    split = []
    for message in messages:
        if message[1] != SCAN_TOPIC:
            split.append(message)
            continue
        whole = scan(STAMPS.index(message[0] - 1))
        middle = len(whole.ranges_m) // 2
        left = dataclasses.replace(
            whole, ranges_m=whole.ranges_m[middle:],
            angle_min_rad=whole.angle_min_rad + middle * whole.angle_increment_rad,
        )
        right = dataclasses.replace(whole, ranges_m=whole.ranges_m[:middle])
        split.append((message[0], SCAN_TOPIC, 'scan', scan_message(right)))
        split.append((message[0] + late_ns, '/left/scan', 'scan', scan_message(left)))
    return sorted(split, key=lambda message: message[0])


def test_two_lasers_map_like_one_that_sees_both_parts(
    messages: list[Recorded], aligned: Path, tmp_path: Path
) -> None:
    config = CONFIG.with_values({'experience_map.scan_topics': 'right,left'})
    folders = []
    for late_ns in (0, 70_000_000):  # the second laser arrives after the next image
        bag = write_bag(tmp_path / f'bag{late_ns}', halved(messages, late_ns))
        folders.append(tmp_path / f'out{late_ns}')
        run(bag, folders[-1], config, scan_topic='scan,/left/scan')
    assert bytes_of(folders[0]) == bytes_of(folders[1])
    assert error_m(folders[0], tmp_path) == pytest.approx(error_m(aligned, tmp_path), abs=0.002)
    run(bag, tmp_path / 'right', scan_topic='scan')
    assert bytes_of(tmp_path / 'right') != bytes_of(folders[0])
    with pytest.raises(UnusableInput, match=r'scan_topics names 2 lasers \(right,left\): name as'):
        run(bag, tmp_path / 'out', config, scan_topic='/left/scan')
    with pytest.raises(UnusableInput, match='names a topic twice'):
        run(bag, tmp_path / 'out', config, scan_topic='scan,/scan')


def assert_grid_shows_the_room(map_file: Path, pgm: Path) -> None:
    """Export the grid of a map: walls around all places, which are free."""
    assert main(['map', 'export', str(map_file), '--format', 'pgm', '-o', str(pgm)]) == 0
    about = yaml.safe_load(pgm.with_suffix('.yaml').read_text())
    grey = cv2.imread(str(pgm.with_name(about['image'])), cv2.IMREAD_UNCHANGED)
    assert set(np.unique(grey)) == {0, 205, 254}
    x_m, y_m, _ = about['origin']
    graph, _ = experience_map_of(read_map(map_file), Config())
    columns, rows = ((graph.poses[:, :2] - (x_m, y_m)) / about['resolution']).astype(int).T
    below = grey.shape[0] - 1 - rows  # the first row of an image is the highest one
    assert (grey[below, columns] == 254).all()
    for wall, place in zip(np.nonzero(grey == 0), (below, columns), strict=True):
        assert wall.min() < place.min() and place.max() < wall.max()


def test_command_reads_scans_if_aligned(
    bag: Path, aligned: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    arguments = ['replay', str(bag), *WORDS, *ALIGN, '--scan-topic', 'scan']
    file, out = tmp_path / 'a.map', tmp_path / 'out'
    assert main([*arguments, '--map', str(file), '--out', str(out), '--quiet']) == 0
    assert bytes_of(out) == bytes_of(aligned)
    assert_grid_shows_the_room(file, tmp_path / 'grid.pgm')
    assert main(['map', 'export', str(out), '-o', str(tmp_path / 'of_results.pgm')]) == 0
    assert (tmp_path / 'of_results.pgm').read_bytes() == (tmp_path / 'grid.pgm').read_bytes()
    assert 'warning' not in capfd.readouterr().err


@pytest.mark.parametrize(('extra', 'message'), [
    (['--scan-topic', '/scan'], 'leave out --scan-topic'),
    ([*ALIGN, '--scan-topic', '/nowhere'], '--scan-topic /scan'),
    ([*ALIGN, '--scan-topic', ODOM_TOPIC], 'is of type nav_msgs/msg/Odometry'),
], ids=['unused', 'nowhere', 'odometry'])
def test_wrong_scan_topic_is_reported_in_one_line(
    bag: Path, tmp_path: Path, refusal: Callable[..., str], extra: list[str], message: str
) -> None:
    out = tmp_path / 'out'
    assert message in refusal('replay', str(bag), *WORDS, *extra, '--out', str(out))
    assert not out.exists()


# Validation of scans


def test_ranges_outside_limits_are_infinite_or_minimum() -> None:
    given = [0.1, 1.0, 9.0, math.inf, math.nan, -math.inf]
    found = checked_scan(5, -1.0, 0.4, 0.5, 8.0, given)
    assert (found.stamp_ns, found.angle_min_rad, found.angle_increment_rad) == (5, -1.0, 0.4)
    assert found.ranges_m.tolist() == [math.inf, 1.0, math.inf, math.inf, math.inf, 0.5]
    assert checked_scan(0, 0.0, 0.0, 0.0, 8.0, [-math.inf]).ranges_m.tolist() == [0.01]


@pytest.mark.parametrize(('numbers', 'ranges', 'message'), [
    ((0.0, 0.1, 0.0, 8.0), [], '0 beams'),
    ((0.0, 0.0, 0.0, 8.0), np.ones(100_001), '100001 beams'),
    ((math.nan, 0.1, 0.0, 8.0), [1.0, 1.0], 'angle_min is nan'),
    ((0.0, math.inf, 0.0, 8.0), [1.0, 1.0], 'angle_increment inf'),
    ((0.0, 0.0, 0.0, 8.0), [1.0, 1.0], 'at most one turn'),
    ((0.0, 1.0, 0.0, 8.0), np.ones(9), 'at most one turn'),
    ((0.0, 0.1, 8.0, 8.0), [1.0, 1.0], 'range_max above'),
    ((0.0, 0.1, -1.0, 8.0), [1.0, 1.0], 'range_max above'),
    ((0.0, 0.1, math.nan, 8.0), [1.0, 1.0], 'range_max above'),
])
def test_invalid_scan_is_rejected(
    numbers: tuple[float, float, float, float], ranges: Any, message: str
) -> None:
    with pytest.raises(UnusableScan, match=message):
        checked_scan(0, *numbers, ranges)


def test_landmarks_are_mapped_beside_the_map(bag: Path, blind: Path, tmp_path: Path) -> None:
    out = tmp_path / 'out'
    words = ['replay', str(bag), *WORDS, '--quiet', '--landmarks', '--out', str(out)]
    assert main(words) == 0
    landmarks = json.loads((out / 'landmarks.json').read_text())
    assert len(landmarks['landmarks']) >= 4 and not landmarks['pose']['is_lost']
    assert json.loads((out / 'summary.json').read_text())['landmarks'] >= 4
    assert bytes_of(out) == bytes_of(blind)


def test_landmarks_without_scans_are_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / 'rounds', list(drive(()))[:40])
    with open_recording(bag) as recording, pytest.raises(UnusableInput, match='no scans'):
        options = ReplayOptions(progress=False, landmarks=True)
        replay(recording, recording.select(scans=True), WITHOUT, tmp_path / 'out', options)


def test_map_with_scans_and_landmarks_is_continued_exactly(bag: Path, tmp_path: Path) -> None:
    def run(name: str, *parts_s: float | None) -> tuple[str, bytes, bytes]:
        folder = tmp_path / name
        for duration_s in parts_s:
            map_file = ReplayMap(folder / 'a.map', False, print, print)
            options = ReplayOptions(
                duration_s=duration_s, progress=False, landmarks=True, map_file=map_file
            )
            config = CONFIG.with_values({'experience_map.exp_relocate': 'both'})
            with open_recording(bag) as recording:
                selection = recording.select(scans=True)
                replay(recording, selection, config, folder, options)
        results = [(folder / file).read_bytes() for file in ('map.json', 'landmarks.json')]
        return read_map(folder / 'a.map').digest, results[0], results[1]

    assert run('in_parts', 3.05, None) == run('undisturbed', None)


def test_recorded_inputs_fed_one_by_one_equal_replay(
    messages: list[Recorded], tmp_path: Path
) -> None:
    broken = scan_message(scan(0))
    broken.range_max = 0.0
    bag = write_bag(tmp_path / 'bag', spoiled(messages, {3: broken}))
    slam = RatSLAM(CONFIG)
    with open_recording(bag) as recording:
        for recorded in recorded_inputs(recording, slam):
            slam.feed(*recorded)
        assert len(recording.warnings) == 1
    slam.finish()
    map_recording(bag, tmp_path / 'theirs', config=CONFIG, quiet=True)
    mine = encode_map(slam.newest_ns, slam.experience_map)
    assert mine == (tmp_path / 'theirs' / 'map.json').read_text()
