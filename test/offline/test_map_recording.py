# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``map_recording`` equals ``ratslam replay``, and its tables equal the files of the run."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers import circles, write_bag

from ratslam_ros import MapResult, map_recording, open_recording
from ratslam_ros.cli import main
from ratslam_ros.core.config import Value
from ratslam_ros.errors import UnusableInput

SETTINGS: dict[str, Value] = {
    'local_view.template_x_size': 16, 'local_view.template_y_size': 8,
    'local_view.vt_panoramic': True,
}
SAME = (
    'config.yaml', 'dead_reckoning.tum', 'frames.csv', 'map.json', 'trajectory.tum',
    'trajectory_final.tum',
)


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp('recordings') / 'circles', circles(2, 20))


@pytest.fixture(scope='module')
def result(bag: Path) -> MapResult:
    return map_recording(bag, settings=SETTINGS, quiet=True)


def test_map_recording_writes_the_files_of_replay(
    bag: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    words = [word for item in SETTINGS.items() for word in ('--set', '{}={}'.format(*item))]
    assert main(['replay', str(bag), *words, '--start=1', f'--out={tmp_path}']) == 0
    printed = capfd.readouterr()
    result = map_recording(bag, settings=SETTINGS, start_s=1.0)
    for name in SAME:
        assert (result.folder / name).read_bytes() == (tmp_path / name).read_bytes()
    assert capfd.readouterr().err == printed.err
    assert printed.out.splitlines()[1] == str(result).splitlines()[1]


def test_video_does_not_replace_the_recording(tmp_path: Path) -> None:
    path = tmp_path / 'drive.mp4'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'mp4v'), 10.0, (64, 48))
    for _ in range(3):
        writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    before = path.read_bytes()
    with pytest.raises(UnusableInput, match='is read'):
        map_recording(path, tmp_path / 'results', video=path, quiet=True)
    assert path.read_bytes() == before


def test_open_recording_with_map_file_is_continued(bag: Path, tmp_path: Path) -> None:
    config = {'settings': SETTINGS, 'quiet': True, 'map_file': tmp_path / 'circles.map'}
    with open_recording(bag) as recording:
        first = map_recording(recording, duration_s=2.0, **config)
        last = map_recording(recording, **config)
    assert 0 < first.map_file.saved.stamp_ns < last.map_file.saved.stamp_ns
    assert last.map_file.skipped > 0


def test_tables_of_result_equal_its_files(result: MapResult) -> None:
    content = json.loads((result.folder / 'map.json').read_text())
    for table, rows in (
        (result.places, content['experiences']), (result.links, content['links']),
        (result.frames, list(csv.DictReader((result.folder / 'frames.csv').open()))),
    ):
        assert len(table) == len(rows) > 0
        for name in table.dtype.names:
            assert table[name].tolist() == [type(table[name][0].item())(row[name]) for row in rows]
    graph = result.experience_map
    assert np.array_equal(np.column_stack([result.places['x_m'], result.places['y_m']]),
                          graph.poses[:, :2])
    assert len(result.trajectory) == len(result.trajectory_final) == len(result.dead_reckoning)


def test_graph_of_result_has_places_and_links(result: MapResult) -> None:
    pytest.importorskip('networkx')
    graph = result.to_networkx()
    assert sorted(graph) == result.places['id'].tolist()
    ends = zip(result.links['source_id'].tolist(), result.links['target_id'].tolist(), strict=True)
    assert {frozenset(ends) for ends in graph.edges} == {frozenset(ends) for ends in ends}
    source_id, target_id = result.links['source_id'][0], result.links['target_id'][0]
    assert graph.edges[source_id, target_id]['duration_s'] == result.links['duration_s'][0]


def test_data_frame_of_result_has_the_frames(result: MapResult) -> None:
    pytest.importorskip('pandas')
    assert result.to_pandas().to_records(index=False).tolist() == result.frames.tolist()


def test_progress_callback_receives_every_phase_to_its_end(bag: Path) -> None:
    calls: list[tuple[str, float, float]] = []
    map_recording(bag, settings=SETTINGS, quiet=True, progress=lambda *call: calls.append(call))
    assert {phase for phase, _, _ in calls} == {'inspecting', 'mapping'}
    mapped_s = [done_s for phase, done_s, _ in calls if phase == 'mapping']
    assert mapped_s == sorted(mapped_s)
    assert mapped_s[-1] == calls[-1][2] == 3.9


def test_saved_result_stays_when_result_is_gone(bag: Path, tmp_path: Path) -> None:
    result = map_recording(bag, settings=SETTINGS, quiet=True, inspect=False)
    temporary = result.folder
    assert cv2.imdecode(np.frombuffer(result._repr_png_(), np.uint8), 1).std() > 0
    folder = result.save(tmp_path / 'saved')
    with pytest.raises(UnusableInput, match='expected the name of a new folder'):
        result.save(folder)
    del result
    assert not temporary.exists()
    assert {*SAME, 'map.png', 'history.sqlite'} <= {path.name for path in folder.iterdir()}


def test_recording_without_odometry_gives_warning(
    bag: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    result = map_recording(bag, visual_odometry=True, duration_s=0.05, inspect=False, quiet=True)
    assert capfd.readouterr().err == f'warning: {result.warnings[0]}\n'
    assert result.warnings[0].startswith('no odometry could be used, so the map is empty')
    assert '--visual-odometry' not in result.warnings[0]  # it is given


def test_failed_map_recording_leaves_no_temporary_folder(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path))
    with pytest.raises(UnusableInput, match='the start at 99 s is outside'):
        map_recording(bag, start_s=99.0, inspect=False, quiet=True)
    assert not list(tmp_path.iterdir())
