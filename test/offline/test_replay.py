# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replay: the map of a recording is reproducible and independent of the message order."""

import csv
import json
import math
import random
import time
from collections.abc import Callable, Container, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import pytest
from helpers import (
    IMAGE_TOPIC,
    ODOM_TOPIC,
    PERIOD_NS,
    SMALL_IMAGES,
    START_NS,
    TEMPLATE_TOPIC,
    Recorded,
    circles,
    extended,
    image_message,
    odometry_message,
    picture,
    string_message,
    template_text,
    undecodable_message,
    write_bag,
)
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import load_config
from ratslam_ros.maps import MapMeta, MapStore
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.mapping import TemplatePayload
from ratslam_ros.offline import replay_video
from ratslam_ros.offline.replay import ReplayOptions, ReplayOutcome, replay
from ratslam_ros.offline.replay_map import ReplayMap
from ratslam_ros.offline.replay_video import compose
from ratslam_ros.pipeline.items import ViewStep
from ratslam_ros.recordings import Event, Recording, open_recording
from ratslam_ros.results.writer import Results
from ratslam_tuning.trials import Trial, run_trials

CONFIG = extended().with_values(SMALL_IMAGES)
SAME = ('map.json', 'frames.csv', 'trajectory.tum', 'trajectory_final.tum', 'dead_reckoning.tum')
LAPS, PER_LAP = 3, 30
FRAMES = LAPS * PER_LAP


def run(
    bag: Path, folder: Path, options: ReplayOptions | None = None,
    recording_of: Callable[[Recording], Any] = lambda recording: recording,
    config: Config = CONFIG,
) -> ReplayOutcome:
    with open_recording(bag) as recording:
        return replay(
            recording_of(recording), recording.select(), config, folder,
            options or ReplayOptions(progress=False),
        )


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in SAME}


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / 'frames.csv').open(newline='') as file:
        return list(csv.DictReader(file))


def delayed(messages: list[Recorded], seed: int, most_ns: int = 1_800_000_000) -> list[Recorded]:
    """Return the messages with random recording delays, each topic in its own order."""
    rng = random.Random(seed)
    last: dict[str, int] = {}
    out = []
    for log_ns, topic, kind, message in messages:
        last[topic] = max(last.get(topic, 0) + 1, log_ns + rng.randrange(most_ns))
        out.append((last[topic], topic, kind, message))
    return sorted(out, key=lambda m: m[0])


@pytest.fixture(scope='module')
def drive() -> list[Recorded]:
    return list(circles(LAPS, PER_LAP))


@pytest.fixture(scope='module')
def base(drive: list[Recorded], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the results of replaying the drive without delays."""
    folder = tmp_path_factory.mktemp('base')
    outcome = run(write_bag(folder / 'bag', drive), folder / 'results')
    assert not outcome.interrupted
    return folder / 'results'


@pytest.mark.parametrize('source', ['twist', 'pose'])
def test_omnidirectional_robot_that_never_turns_maps_circle(source: str, tmp_path: Path) -> None:
    messages, x_m, y_m = [], 0.0, 0.0
    for stamp_ns, topic, kind, message in circles(LAPS, PER_LAP):
        if topic == ODOM_TOPIC:
            course_rad = 2.0 * math.pi / PER_LAP * (stamp_ns - START_NS) / PERIOD_NS
            ahead, left = 0.4 * math.cos(course_rad), 0.4 * math.sin(course_rad)
            x_m, y_m = x_m + ahead, y_m + left
            pose = Pose(x_m, y_m, 0.0)
            message = odometry_message(stamp_ns, 10.0 * ahead, 0.0, pose, 10.0 * left)
        messages.append((stamp_ns, topic, kind, message))
    config = CONFIG.with_values({'inputs.odom_source': source})
    outcome = run(write_bag(tmp_path / 'bag', messages), tmp_path / 'results', config=config)
    assert outcome.summary['loop_closures'] > 0
    places = json.loads((tmp_path / 'results/map.json').read_text())['experiences']
    points = np.array([(place['x_m'], place['y_m']) for place in places])
    radii = np.hypot(*(points - points.mean(axis=0)).T)
    assert len(places) < PER_LAP + 5
    np.testing.assert_allclose(radii, 0.4 * PER_LAP / (2.0 * math.pi), atol=0.2)


def test_laps_are_mapped_with_loop_closures(base: Path) -> None:
    graph = json.loads((base / 'map.json').read_text())
    summary = json.loads((base / 'summary.json').read_text())
    assert summary['frames'] == summary['odometry'] == FRAMES
    assert summary['templates'] == PER_LAP
    assert summary['experiences'] == len(graph['experiences']) >= PER_LAP // 2
    assert summary['links'] == len(graph['links'])
    assert summary['loop_closures'] > 0
    assert summary['dropped'] == summary['late'] == summary['refused'] == 0


def test_order_across_topics_does_not_change_results(
    drive: list[Recorded], base: Path, tmp_path: Path
) -> None:
    """In OpenRatSLAM the map depends on the times at which messages arrive."""
    messages = delayed(drive, 1)
    assert [m[3].header.stamp for m in messages] != [m[3].header.stamp for m in drive]
    run(write_bag(tmp_path / 'bag', messages), tmp_path / 'results')
    assert bytes_of(tmp_path / 'results') == bytes_of(base)


def test_messages_beyond_max_lateness_are_counted_as_late(
    drive: list[Recorded], tmp_path: Path
) -> None:
    """A map that differs because of lost messages must show in the counts."""
    late = [
        (log_ns + (5_000_000_000 if topic == IMAGE_TOPIC else 0), topic, kind, message)
        for log_ns, topic, kind, message in drive
    ]
    bag = write_bag(tmp_path / 'bag', sorted(late, key=lambda m: m[0]))
    summary = run(bag, tmp_path / 'results').summary
    assert summary['late'] > 0
    assert summary['frames'] + summary['late'] == FRAMES


# Files


def test_trajectories_have_one_line_per_odometry_message(base: Path) -> None:
    stamps = [f'{(START_NS + i * PERIOD_NS) // 10**9}.{i * PERIOD_NS % 10**9:09d}'
              for i in range(FRAMES)]
    for name in SAME[2:]:
        lines = (base / name).read_text().splitlines()
        assert [line.split()[0] for line in lines] == stamps
        assert all(len(line.split()) == 8 for line in lines)
        for line in lines:
            _, _, _, z, qx, qy, qz, qw = map(float, line.split())
            assert z == qx == qy == 0.0
            assert qz**2 + qw**2 == pytest.approx(1.0, abs=1e-8)


def test_final_trajectory_follows_final_map(base: Path) -> None:
    """One message after an arrival, the pose is one step from the final pose of the experience."""
    graph = json.loads((base / 'map.json').read_text())
    nodes = [Pose(e['x_m'], e['y_m'], e['heading_rad']) for e in graph['experiences']]
    final = [[float(part) for part in line.split()[1:3]]
             for line in (base / 'trajectory_final.tum').read_text().splitlines()]
    current = [int(row['experience_id']) for row in rows(base)]
    step = Motion(0.1, 2.0 * math.pi * 2.0 / PER_LAP, 2.0 * math.pi / PER_LAP)
    arrivals = [i for i in range(1, FRAMES - 1) if current[i] != current[i - 1]]
    assert len(arrivals) > FRAMES // 2
    for i in arrivals:
        expected = moved(nodes[current[i]], step)
        assert final[i + 1] == pytest.approx([expected.x_m, expected.y_m], abs=1e-8)


def test_frames_csv_has_one_row_per_image(base: Path) -> None:
    text = (base / 'frames.csv').read_text()
    assert text.startswith(
        'stamp_ns,template_id,is_new,match_error,relative_rad,experience_id\n'
    )
    table = rows(base)
    assert [int(row['stamp_ns']) for row in table] == [
        START_NS + i * PERIOD_NS for i in range(FRAMES)
    ]
    assert [int(row['template_id']) for row in table] == list(range(PER_LAP)) * LAPS
    assert [row['is_new'] for row in table] == ['1'] * PER_LAP + ['0'] * (FRAMES - PER_LAP)
    assert table[0]['match_error'] == '-1.0'
    assert all(float(row['match_error']) > 0.03 for row in table[1:PER_LAP])
    assert all(float(row['match_error']) == 0.0 for row in table[PER_LAP:])
    # The first experience is created after the second odometry message, which moves the robot.
    assert table[0]['experience_id'] == '-1'
    assert table[1]['experience_id'] == '0'


def test_summary_has_its_keys_in_order(base: Path) -> None:
    summary = json.loads((base / 'summary.json').read_text())
    assert list(summary) == [
        'frames', 'odometry', 'templates', 'experiences', 'links', 'loop_closures', 'dropped',
        'low_texture', 'late', 'refused', 'duration_s', 'wall_s', 'times_realtime', 'step_ms',
    ]
    assert summary['duration_s'] == pytest.approx((FRAMES - 1) * 0.1 + 0.001, abs=2e-3)
    assert set(summary['step_ms']) == {
        'decode', 'encode', 'local_view.image', 'pose_cells.odometry', 'pose_cells.template',
        'pose_cells.relocation', 'experience_map.odometry', 'experience_map.action',
    }
    for step in summary['step_ms'].values():
        assert list(step) == ['count', 'median', 'p99']
        assert 0.0 < step['median'] <= step['p99']
    assert summary['step_ms']['local_view.image']['count'] == FRAMES


def test_map_has_last_stamp_and_no_paths(base: Path) -> None:
    text = (base / 'map.json').read_text()
    last_ns = START_NS + (FRAMES - 1) * PERIOD_NS
    assert json.loads(text)['stamp'] == {'sec': last_ns // 10**9, 'nanosec': last_ns % 10**9}
    assert str(base) not in text
    assert '/' not in text


def test_no_partial_files_remain(base: Path) -> None:
    assert sorted(path.name for path in base.iterdir()) == sorted(
        [*SAME, 'summary.json', 'config.yaml']
    )


def test_rejected_loop_closure_keeps_current_experience(tmp_path: Path) -> None:
    results = Results(tmp_path, Config())
    place = Place(0.0, 0.0, 0.0)
    for kind, target, rejected in (
        ('create', 20, False), ('link', 3, True), ('none', 3, False), ('link', 4, False),
    ):
        action = MapAction(kind, 20, target, 0, 0.0, place)  # type: ignore[arg-type]
        match = ViewMatch(target, False, 0.0, 0.0)
        results.add(ViewStep(START_NS, match, action, rejected=rejected))
    results.finish(ExperienceMap(Config().experience_map), {})
    rows = (tmp_path / 'frames.csv').read_text().splitlines()[1:]
    assert [row.split(',')[5] for row in rows] == ['20', '20', '20', '4']
    assert results.closures.count == 1


@pytest.mark.parametrize('action', ['link', 'set'])
def test_link_to_one_of_ten_newest_is_no_closure(
    tmp_path: Path, action: Literal['link', 'set']
) -> None:
    results = Results(tmp_path, Config())

    def step(kind: Literal['create', 'link', 'set'], target: int) -> None:
        place = Place(0.0, 0.0, 0.0)
        match = ViewMatch(target, kind == 'create', 0.0, 0.0)
        results.add(ViewStep(START_NS, match, MapAction(kind, 20, target, 0, 0.0, place)))

    for number in range(21):
        step('create', number)
    for number in range(11, 21):
        step(action, number)
    assert results.closures.count == 0
    step(action, 10)
    step(action, 0)
    assert results.closures.count == 2


def test_jump_of_odometry_is_reported_wherever_it_is(tmp_path: Path) -> None:
    drive = list(circles(LAPS, PER_LAP))
    odometry = [message for _, topic, _, message in drive if topic == ODOM_TOPIC]
    odometry[-2].twist.twist.linear.x = 1e6
    opened: list[Recording] = []
    run(
        write_bag(tmp_path / 'bag', drive), tmp_path / 'results',
        recording_of=lambda one: opened.append(one) or one,
    )
    [warning] = opened[0].warnings
    assert warning.startswith(f'the twist of /odom jumps at 1 of {len(odometry) - 1} messages')


# Undecodable images, recorded templates


def with_undecodable(
    drive: list[Recorded], broken: Container[int]
) -> Iterator[Recorded]:
    """Yield the drive without the content of some images."""
    for i, (log_ns, topic, kind, message) in enumerate(drive):
        if topic == IMAGE_TOPIC and i // 2 in broken:
            message = undecodable_message(START_NS + i // 2 * PERIOD_NS)
        yield log_ns, topic, kind, message


@pytest.mark.parametrize('is_map', [False, True])
def test_recording_of_undecodable_images_is_refused(
    drive: list[Recorded], is_map: bool, tmp_path: Path
) -> None:
    bag = write_bag(tmp_path / 'bag', with_undecodable(drive, range(FRAMES)))
    map_file = ReplayMap(tmp_path / 'a.map', False, print, print) if is_map else None
    options = ReplayOptions(progress=False, history=True, map_file=map_file)
    for folder in tmp_path / 'new', tmp_path:
        before = {*folder.iterdir()} if folder.exists() else None
        with pytest.raises(UnusableInput, match=f'none of the {FRAMES} images of .* can be deco'):
            run(bag, folder, options)
        assert before == ({*folder.iterdir()} if folder.exists() else None)


@pytest.mark.parametrize('name', ['results/a.map', 'link.map', 'empty.map'])
def test_failed_replay_removes_only_what_it_has_created(
    name: str, drive: list[Recorded], tmp_path: Path
) -> None:
    bag = write_bag(tmp_path / 'bag', with_undecodable(drive, range(FRAMES)))
    (tmp_path / 'link.map').symlink_to('new.map')
    MapStore(tmp_path / 'empty.map', ['pose_cells'], MapMeta('', '', ''), print).close()
    before = {*tmp_path.iterdir()}
    map_file = ReplayMap(tmp_path / name, False, print, print)
    with pytest.raises(UnusableInput, match='can be decoded'):
        run(bag, tmp_path / 'results', ReplayOptions(progress=False, map_file=map_file))
    assert {*tmp_path.iterdir()} == before


def test_undecodable_image_has_id_minus_one_and_is_dropped(
    drive: list[Recorded], tmp_path: Path
) -> None:
    broken = {5, 6, 40}
    bag = write_bag(tmp_path / 'bag', with_undecodable(drive, broken))
    opened: list[Recording] = []
    summary = run(
        bag, tmp_path / 'results', recording_of=lambda one: opened.append(one) or one
    ).summary
    [warning] = opened[0].warnings
    assert warning.startswith('3 of the 90 images cannot be decoded and are dropped, the first: ')
    assert summary['dropped'] == len(broken)
    assert summary['frames'] == FRAMES
    table = rows(tmp_path / 'results')
    for i, row in enumerate(table):
        assert (row['template_id'] == '-1') == (i in broken)
    assert table[5]['is_new'] == '0'
    assert table[5]['match_error'] == '-1.0'
    assert table[5]['experience_id'] == table[6]['experience_id'] == table[4]['experience_id']


def recorded_templates(drive: list[Recorded], results: Path) -> Iterator[Recorded]:
    """Yield the drive with the templates of the results in place of the images."""
    views = iter(rows(results))
    for log_ns, topic, kind, message in drive:
        if topic != IMAGE_TOPIC:
            yield log_ns, topic, kind, message
            continue
        row = next(views)
        match = ViewMatch(
            int(row['template_id']), row['is_new'] == '1', float(row['match_error']),
            float(row['relative_rad']),
        )
        text = encode(TemplatePayload.of(int(row['stamp_ns']), match, START_NS))
        yield log_ns, TEMPLATE_TOPIC, 'string', string_message(text)


def test_recorded_templates_give_same_results_as_images(
    drive: list[Recorded], base: Path, tmp_path: Path
) -> None:
    bag = write_bag(tmp_path / 'bag', recorded_templates(drive, base))
    run(bag, tmp_path / 'results')
    assert bytes_of(tmp_path / 'results') == bytes_of(base)


def test_malformed_templates_are_dropped_with_warning(
    drive: list[Recorded], base: Path, tmp_path: Path
) -> None:
    messages = list(recorded_templates(drive, base))
    bad = ['no json', template_text(START_NS, 3, id=True), template_text(START_NS, 3, error=None)]
    for i, text in enumerate(bad):
        log_ns = START_NS + 50 * PERIOD_NS + i + 1
        messages.append((log_ns, TEMPLATE_TOPIC, 'string', string_message(text)))
    bag = write_bag(tmp_path / 'bag', sorted(messages, key=lambda m: m[0]))
    with open_recording(bag) as recording:
        outcome = replay(recording, recording.select(), CONFIG, tmp_path / 'results',
                         ReplayOptions(progress=False))
        assert recording.warnings[0].startswith('3 template messages were not used')
        assert len(recording.warnings) == 1
    assert outcome.summary['dropped'] == 3
    assert bytes_of(tmp_path / 'results') == bytes_of(base)


def test_recording_without_odometry_uses_visual_odometry(
    drive: list[Recorded], tmp_path: Path
) -> None:
    images = [message for message in drive if message[1] == IMAGE_TOPIC]
    summary = run(write_bag(tmp_path / 'bag', images), tmp_path / 'results').summary
    assert summary['odometry'] == FRAMES - 1
    assert summary['frames'] == FRAMES
    assert 'visual_odometry.image' in summary['step_ms']


def test_odometry_from_poses_maps_recording_without_twists(tmp_path: Path) -> None:
    messages: list[Recorded] = []
    for i in range(40):
        stamp = START_NS + i * PERIOD_NS
        odometry = odometry_message(stamp, 0.0, 0.0, Pose(0.2 * i, 1.0, 0.0))
        messages.append((stamp, ODOM_TOPIC, 'odometry', odometry))
        messages.append((stamp + 1, IMAGE_TOPIC, 'image', image_message(stamp, picture(i))))
    config = CONFIG.with_values({'inputs.odom_source': 'pose'})
    run(write_bag(tmp_path / 'bag', messages), tmp_path / 'results', config=config)
    last = (tmp_path / 'results' / 'dead_reckoning.tum').read_text().splitlines()[-1].split()
    # The map starts at 90 degrees.
    assert [float(last[1]), float(last[2])] == pytest.approx([0.0, 0.2 * 39], abs=1e-6)


# Parts of a recording, and runs that end early


class FailingRecording:
    """Recording whose event stream raises an error after some events."""

    def __init__(self, recording: Recording, after: int, error: BaseException) -> None:
        self._recording = recording
        self._after = after
        self._error = error

    def __getattr__(self, name: str) -> Any:
        return getattr(self._recording, name)

    def events(self, *arguments: Any) -> Iterator[Event]:
        for number, event in enumerate(self._recording.events(*arguments)):
            if number == self._after:
                raise self._error
            yield event


def test_error_while_reading_is_raised(drive: list[Recorded], tmp_path: Path) -> None:
    bag = write_bag(tmp_path / 'bag', drive)
    for after in (0, 50):
        broken = partial(FailingRecording, after=after, error=ZeroDivisionError())
        with pytest.raises(ZeroDivisionError):
            run(bag, tmp_path / 'results', recording_of=broken)


def test_odometry_with_nan_is_refused_and_counted(drive: list[Recorded], tmp_path: Path) -> None:
    stamp_ns = drive[20][0] - 1
    message = odometry_message(stamp_ns, float('nan'), 0.0, Pose(0.0, 0.0, 0.0))
    messages = [*drive[:20], (stamp_ns, ODOM_TOPIC, 'odometry', message), *drive[20:]]
    summary = run(write_bag(tmp_path / 'bag', messages), tmp_path / 'results').summary
    assert (summary['refused'], summary['dropped'], summary['late']) == (1, 0, 0)


def test_error_keeps_new_results_or_earlier_ones(drive: list[Recorded], tmp_path: Path) -> None:
    failing = partial(FailingRecording, after=60, error=RuntimeError('the disk is gone'))
    bag = write_bag(tmp_path / 'bag', drive)
    with pytest.raises(RuntimeError):
        run(bag, tmp_path / 'new', recording_of=failing)
    assert len(rows(tmp_path / 'new')) > 10
    assert json.loads((tmp_path / 'new' / 'map.json').read_text())['experiences']
    run(bag, tmp_path / 'old')
    before = bytes_of(tmp_path / 'old')
    with pytest.raises(RuntimeError):
        run(bag, tmp_path / 'old', recording_of=failing)
    assert bytes_of(tmp_path / 'old') == before
    assert not list((tmp_path / 'old').glob('*.part'))


def test_images_smaller_than_template_still_give_odometry(
    drive: list[Recorded], tmp_path: Path
) -> None:
    """Visual odometry continues with the smaller images."""
    messages = []
    for number, (log_ns, topic, kind, message) in enumerate(
        m for m in drive if m[1] == IMAGE_TOPIC
    ):
        stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        small = image_message(stamp_ns, picture(number, 2, 2))
        messages.append((log_ns, topic, kind, small if number >= 40 else message))
    summary = run(write_bag(tmp_path / 'bag', messages), tmp_path / 'results').summary
    assert summary['frames'] == FRAMES
    assert summary['dropped'] == FRAMES - 40
    ids = [row['template_id'] for row in rows(tmp_path / 'results')]
    assert ids.count('-1') == FRAMES - 40
    assert summary['odometry'] == FRAMES - 2  # The first image of each size gives none.


@pytest.mark.parametrize('descriptor', ['intensity', 'gradients'])
def test_low_texture_images_are_counted_apart_from_dropped_ones(
    tmp_path: Path, descriptor: str
) -> None:
    messages = list(circles(1, 10))
    blank = np.full((24, 32), 70, np.uint8)
    for at, (log_ns, topic, kind, _) in enumerate(messages):
        if topic == IMAGE_TOPIC and (log_ns - START_NS) // PERIOD_NS in (3, 4):
            messages[at] = log_ns, topic, kind, image_message(log_ns - 1_000_000, blank)
    config = CONFIG.with_values({
        'local_view.vt_min_structure': 0.03, 'local_view.vt_descriptor': descriptor,
    })
    summary = run(write_bag(tmp_path / 'bag', messages), tmp_path / 'results', config=config)
    assert summary.summary['low_texture'] == 2
    assert summary.summary['dropped'] == 0
    ids = [int(row['template_id']) for row in rows(tmp_path / 'results')]
    assert [n for n, template in enumerate(ids) if template == -1] == [3, 4]


def test_video_has_every_fourth_image_and_its_time_does_not_count(
    drive: list[Recorded], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slow_compose(*arguments: Any) -> NDArray[np.uint8]:
        time.sleep(0.02)
        return compose(*arguments)

    monkeypatch.setattr(replay_video, 'compose', slow_compose)
    start_s = time.perf_counter()
    options = ReplayOptions(progress=False, video=tmp_path / 'a.mp4')
    summary = run(write_bag(tmp_path / 'bag', drive), tmp_path / 'out', options).summary
    elapsed_s = time.perf_counter() - start_s
    reader = cv2.VideoCapture(str(tmp_path / 'a.mp4'))
    frames = 0
    while reader.grab():
        frames += 1
    assert frames == math.ceil(summary['frames'] / 4)
    assert summary['wall_s'] <= elapsed_s - 0.02 * frames


def test_video_encoder_that_does_not_open_is_rejected(
    drive: list[Recorded], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cv2.VideoWriter, 'fourcc', lambda *_: 0x58585858)
    options = ReplayOptions(progress=False, video=tmp_path / 'a.mp4')
    with pytest.raises(UnusableInput, match='cannot be written'):
        run(write_bag(tmp_path / 'bag', drive), tmp_path / 'out', options)


@pytest.mark.parametrize(('grey', 'count'), [('luma', 1), ('mean', 2)])
def test_image_grey_distinguishes_colours_of_equal_luma(
    tmp_path: Path, grey: str, count: int
) -> None:
    """Pure blue has a luma of 29 and a mean of 85."""
    for number, bgr in enumerate([(29, 29, 29), (255, 0, 0)]):
        cv2.imwrite(str(tmp_path / f'{number}.png'), np.full((12, 16, 3), bgr, np.uint8))
    config = load_config('openratslam')[0].with_values({
        'inputs.image_grey': grey, 'local_view.template_x_size': 16,
        'local_view.template_y_size': 8,
    })
    outcome = run(tmp_path, tmp_path / 'results', config=config)
    assert outcome.summary['templates'] == count
    with open_recording(tmp_path) as recording:
        both = run_trials(recording, recording.select(), [
            config.with_values({'inputs.image_grey': value}) for value in ('luma', 'mean')
        ])
    assert [trial.templates for trial in both if isinstance(trial, Trial)] == [1, 2]
