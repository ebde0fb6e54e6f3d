# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Histories that replays write, and results without history."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers import (
    IMAGE_TOPIC,
    ODOM_TOPIC,
    PERIOD_NS,
    START_NS,
    circles,
    extended,
    image_message,
    odometry_message,
    picture,
    write_bag,
)
from records_for_tests import plain_state

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.map_changes import MapChangeTracker
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import load_config
from ratslam_ros.history.file import HISTORY_NAME, HistoryMeta, part_path
from ratslam_ros.history.history_run import HistoryRun
from ratslam_ros.history.opening import NOTICE, FinalRun, open_run
from ratslam_ros.history.recorder import Recorder
from ratslam_ros.history.writer import HistoryWriter
from ratslam_ros.messages.commands import CommandPayload
from ratslam_ros.messages.json_schema import decode
from ratslam_ros.offline.replay import ReplayOptions, replay
from ratslam_ros.pipeline.codec import command_from_state
from ratslam_ros.pipeline.commands import (
    Command,
    Configure,
    NamePlace,
    Relocated,
    Reset,
    SetMapping,
    SetPaused,
)
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.recordings import open_recording
from ratslam_ros.results.trajectory import read_tum, tum_line

CONFIG = extended().with_values({
    'local_view.template_x_size': 16, 'local_view.template_y_size': 8,
    'local_view.vt_shift_match': 2, 'pose_cells.pc_cell_x_size': 0.5,
    'pose_cells.exp_delta_pc_threshold': 1.0,
})
SHOWN = ReplayOptions(progress=False, history=True)


def replayed(bag: Path, folder: Path, options: ReplayOptions = SHOWN) -> Path:
    with open_recording(bag) as recording:
        replay(recording, recording.select(), CONFIG, folder, options)
    return folder


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('circles') / 'bag'
    write_bag(folder, circles(3, 30))
    return folder


@pytest.fixture(scope='module')
def results(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return replayed(bag, tmp_path_factory.mktemp('results') / 'run')


def test_history_does_not_change_the_map(bag: Path, results: Path, tmp_path: Path) -> None:
    plain_results = replayed(bag, tmp_path / 'plain', ReplayOptions(progress=False))
    for name in ('map.json', 'frames.csv', 'trajectory.tum', 'trajectory_final.tum'):
        assert (plain_results / name).read_bytes() == (results / name).read_bytes()
    assert not (plain_results / HISTORY_NAME).exists()


def test_replaying_again_gives_an_identical_history(
    bag: Path, results: Path, tmp_path: Path
) -> None:
    again = replayed(bag, tmp_path / 'again') / HISTORY_NAME
    assert again.read_bytes() == (results / HISTORY_NAME).read_bytes()


def test_history_ends_with_the_final_map(results: Path) -> None:
    check_final_map(results)


def test_map_of_more_rows_than_a_change_may_have_is_written(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Readers refuse changes of a million rows."""
    monkeypatch.setattr(MapChangeTracker.next_change, '__defaults__', (10,))
    folder = replayed(bag, tmp_path / 'run')
    check_final_map(folder)
    (folder / HISTORY_NAME).unlink()
    check_final_map(folder, FinalRun)


def check_final_map(results: Path, kind: type[HistoryRun | FinalRun] = HistoryRun) -> None:
    run = open_run(results)
    assert isinstance(run, kind) and not run.is_growing
    assert run.notices == ([] if kind is HistoryRun else [NOTICE])
    final = json.loads((results / 'map.json').read_text())
    state = run.seek(run.end_ns)
    poses = [(one['x_m'], one['y_m'], one['heading_rad']) for one in final['experiences']]
    np.testing.assert_allclose(state.map.poses, poses, atol=1.6e-3)  # sent beyond 1 mm
    templates = [one['template_id'] for one in final['experiences']]
    assert state.map.template_ids.tolist() == templates
    assert state.map.link_count == len(final['links'])
    assert state.map.current_id == final['current_experience_id']
    run.close()


def test_history_has_every_view_of_the_run(results: Path) -> None:
    run = open_run(results)
    with (results / 'frames.csv').open(newline='') as file:
        frames = list(csv.DictReader(file))
    at_ns = run.step(run.begin_ns, -1000)
    for frame in frames:
        view = run.view_at(at_ns)
        assert view is not None
        assert view.stamp_ns == at_ns == int(frame['stamp_ns'])
        assert view.template_id == int(frame['template_id'])
        assert view.error == pytest.approx(float(frame['match_error']), abs=1e-6)
        at_ns = run.step(at_ns, 1)
    assert run.seek(run.end_ns).closures
    run.close()


def test_state_in_the_middle_shows_cells_match_and_trail(results: Path) -> None:
    run = open_run(results)
    state = run.seek(run.begin_ns + (run.end_ns - run.begin_ns) // 5)
    assert 0 < len(state.map) < len(run.seek(run.end_ns).map)
    assert state.cells is not None and state.cells.activity.max() > 0.0
    assert state.match is not None and state.match.view.shape == (8, 16)
    assert state.pose is not None and len(state.trail.points_m) > 3
    run.close()


def test_image_is_read_from_the_recording_if_it_is_there(tmp_path: Path, bag: Path) -> None:
    copy = tmp_path / 'copy'
    shutil.copytree(bag, copy)
    folder = replayed(copy, tmp_path / 'run')
    run = open_run(folder)
    at_ns = run.step(run.begin_ns, 40)
    full = run.image_at(at_ns)
    with open_recording(copy) as recording:
        grey = next(
            event.grey() for event in recording.events(recording.select())
            if event.stamp_ns == at_ns and hasattr(event, 'image')
        )
    assert full is not None
    shown = cv2.imdecode(np.frombuffer(full, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert np.abs(shown.astype(int) - grey).mean() < 8.0
    run.close()
    shutil.rmtree(copy)
    run = open_run(folder)
    assert run.image_at(at_ns) is not None
    assert 'is not there any more' in run.notices[0]
    run.close()


def test_truth_of_the_folder_is_aligned_at_the_start(results: Path, tmp_path: Path) -> None:
    folder = tmp_path / 'run'
    shutil.copytree(results, folder)
    estimated = read_tum(folder / 'trajectory.tum')
    # The same drive in a frame that is turned by 90 degrees and moved.
    with (folder / 'truth.tum').open('w') as file:
        for stamp, (x, y), heading in zip(
            estimated.stamp_ns.tolist(), estimated.position_m.tolist(),
            estimated.heading_rad.tolist(), strict=True,
        ):
            file.write(tum_line(stamp, Pose(5.0 - y, 7.0 + x, heading + np.pi / 2)))
            if stamp > estimated.stamp_ns[0] + 4 * 10**9:
                break
    run = open_run(folder)
    at_ns = int(estimated.stamp_ns[0]) + 2 * 10**9
    state = run.seek(at_ns)
    assert state.pose is not None and state.pose.truth is not None
    np.testing.assert_allclose(state.pose.truth[:2], state.pose.pose[:2], atol=0.3)
    assert len(state.truth.points_m) > 2
    advanced = run.seek(0)
    run.advance(advanced, at_ns)
    assert plain_state(advanced) == plain_state(state)
    run.close()


def test_results_without_history_show_the_final_state(results: Path, tmp_path: Path) -> None:
    folder = tmp_path / 'run'
    shutil.copytree(results, folder)
    (folder / HISTORY_NAME).unlink()
    check_final_map(folder, FinalRun)
    run = open_run(folder)
    assert run.begin_ns == run.end_ns == run.step(run.end_ns, -3)
    assert len(run.seek(run.end_ns).trail.points_m) > 3


def test_replay_without_history_removes_that_of_an_earlier_run(bag: Path, tmp_path: Path) -> None:
    folder = replayed(bag, tmp_path / 'run')
    assert (folder / HISTORY_NAME).exists()
    replayed(bag, folder, ReplayOptions(progress=False))
    assert isinstance(open_run(folder), FinalRun)


def test_large_images_are_reduced(tmp_path: Path) -> None:
    messages = []
    for k in range(8):
        stamp_ns = START_NS + k * PERIOD_NS
        odometry = odometry_message(stamp_ns, 1.0, 0.0, Pose(0.0, 0.0, 0.0))
        pixels = np.kron(picture(k, 24, 32), np.ones((20, 20), np.uint8))
        messages.append((stamp_ns, ODOM_TOPIC, 'odometry', odometry))
        messages.append((stamp_ns, IMAGE_TOPIC, 'image', image_message(stamp_ns, pixels)))
    write_bag(tmp_path / 'bag', messages)
    folder = replayed(tmp_path / 'bag', tmp_path / 'run')
    shutil.rmtree(tmp_path / 'bag')
    run = open_run(folder)
    jpeg = run.image_at(run.end_ns)
    assert jpeg is not None
    shown = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert shown.shape[1] == 320
    assert not part_path(folder / HISTORY_NAME).exists()
    run.close()


def test_damaged_history_leaves_the_final_state(results: Path, tmp_path: Path) -> None:
    folder = tmp_path / 'run'
    shutil.copytree(results, folder)
    history = folder / HISTORY_NAME
    history.write_bytes(history.read_bytes()[:3000])
    run = open_run(folder)
    assert isinstance(run, FinalRun)
    [notice] = run.notices
    assert 'only the final state' in notice and str(history) in notice
    assert len(run.seek(run.end_ns).map)
    (folder / 'map.json').unlink()
    with pytest.raises(UnusableInput, match='no readable history'):
        open_run(folder)


def test_history_states_how_many_views_must_agree(results: Path) -> None:
    run = open_run(results)
    assert isinstance(run, HistoryRun)
    config = load_config(str(results / 'config.yaml'))[0]
    assert run.required_views == config.pose_cells.pc_vt_agree_views > 0
    run.close()


def test_commands_are_read_with_their_stamps(tmp_path: Path) -> None:
    slam, path = RatSLAM(CONFIG), tmp_path / HISTORY_NAME
    recorder = Recorder(slam, lambda: HistoryWriter(path, HistoryMeta('commanded')))
    slam.mapping = False  # before the first input
    given: dict[int, list[Command]] = {
        20: [SetMapping(True), NamePlace('dock')], 25: [SetPaused(True, 'local_view')],
        30: [SetPaused(False, 'local_view'), Reset('pose_cells')],
        35: [Configure(CONFIG.with_values({'pose_cells.pc_vt_inject_energy': 0.4}))],
    }
    for n in range(40):
        stamp_ns = START_NS + n * PERIOD_NS
        for command in given.get(n, ()):
            slam.pipeline.command(command, stamp_ns)
        steps = slam.odometry(Odometry(stamp_ns, Twist(1.0, 0.5)))
        for step in [*steps, *slam.image(stamp_ns, picture(n))]:
            recorder.add(step)
    for step in slam.finish():
        recorder.add(step)
    slam.pipeline.command(Relocated())
    recorder.close()
    run = HistoryRun(path)
    expected = [
        (0, SetMapping(False)),
        *((START_NS + n * PERIOD_NS, command) for n, some in given.items() for command in some),
        (START_NS + 39 * PERIOD_NS + 1, Relocated()),
    ]
    found = run.seek(run.end_ns).commands
    decoded = [decode(CommandPayload, record.payload) for record in found]
    assert [(one.stamp.ns, command_from_state(one.command)) for one in decoded] == expected
    assert [one.stamp_ns for one in found] == [run.begin_ns, *(ns for ns, _ in expected[1:])]
    assert len(run.seek(START_NS + 25 * PERIOD_NS - 1).commands) == 3
    assert [view for n in (26, 29) if (view := run.view_at(START_NS + n * PERIOD_NS))] == [
        run.view_at(START_NS + 24 * PERIOD_NS)
    ] * 2  # paused
    run.close()
