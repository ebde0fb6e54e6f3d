# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cameras and streams as recordings without an end."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from camera_stream import camera_stream
from helpers import START_NS, live_environment, picture

from ratslam_ros.cli.main import main
from ratslam_ros.errors import UnusableInput
from ratslam_ros.images import Frame
from ratslam_ros.maps import read_map
from ratslam_ros.offline.map_recording import map_recording
from ratslam_ros.offline.replay_map import session_titles, unfinished_note
from ratslam_ros.recordings import Event, ImageEvent, Recording, Selection, Topic, open_recording
from ratslam_ros.recordings.camera import Camera, ImageFile


def test_recorded_images_are_those_that_were_mapped(tmp_path: Path) -> None:
    path = tmp_path / 'kept.mcap'
    with camera_stream(12) as url, Camera(url, path) as camera:
        mapped = list(camera.events(camera.select()))
    assert camera.warnings == ['the camera sends no more images: the map ends here']
    with open_recording(path) as recording:
        replayed = list(recording.events(recording.select()))
        assert recording.warnings == []
    assert len(mapped) == 12
    assert [one.stamp_ns for one in replayed] == [one.stamp_ns for one in mapped]
    for a, b in zip(mapped, replayed, strict=True):
        np.testing.assert_array_equal(a.grey(), b.grey())


def test_stopped_camera_ends_after_current_image(tmp_path: Path) -> None:
    with camera_stream(None) as url, Camera(url) as camera:
        count = 0
        for _ in camera.events(camera.select()):
            count += 1
            if count == 3:
                camera.stop()
    assert count == 3
    assert camera.warnings == []


def test_file_of_killed_process_is_readable(tmp_path: Path) -> None:
    file = ImageFile(tmp_path / 'kept.mcap')
    noise = np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)
    for n in range(9):  # about 600 kB each
        file.add(n + 1, noise)
    file._stream.flush()
    with open_recording(tmp_path / 'kept.mcap') as recording:
        assert len(list(recording.events(recording.select()))) >= 7
        assert 'truncated' in recording.warnings[0]
    file.close()


@pytest.mark.parametrize(('source', 'found'), [
    ('97', 'camera /dev/video97 does not exist; this machine has'),
    ('/dev/video98', 'camera /dev/video98 does not exist; this machine has'),
    ('http://127.0.0.1:1/none.mjpg', 'cannot be opened; expected the number of a camera'),
    (__file__, 'ratslam replay'),
])
def test_absent_camera_is_reported_in_one_line(source: str, found: str, tmp_path: Path) -> None:
    """In a process of its own, because OpenCV may print lines, too."""
    done = subprocess.run(
        [sys.executable, '-m', 'ratslam_ros', 'camera', source, '--no-view'], cwd=tmp_path,
        env={**os.environ, **live_environment()}, capture_output=True, text=True, check=False,
    )
    assert done.returncode == 2
    (line,) = (done.stdout + done.stderr).splitlines()
    assert found in line


@pytest.mark.parametrize('name', ['there.mcap', 'images.avi'])
def test_unusable_file_for_images_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / 'there.mcap').touch()
    with camera_stream() as url, pytest.raises(UnusableInput, match=f'{name} .*--record'):
        Camera(url, tmp_path / name)


def test_map_of_camera_equals_that_of_its_recording_and_is_continued(tmp_path: Path) -> None:
    kept, saved = tmp_path / 'kept.mcap', tmp_path / 'saved.map'
    maps = []
    with camera_stream() as url:
        for words in (
            ['camera', url, '--no-view', '--record', str(kept), '--map', str(saved)],
            ['replay', str(kept), '--no-inspect'],
            ['camera', url, '--no-view', '--map', str(saved)],
        ):
            out = tmp_path / f'out{len(maps)}'
            assert main([*words, '--out', str(out), '--quiet']) == 0
            maps.append((out / 'map.json').read_text())
    assert maps[0] == maps[1]
    assert len(json.loads(maps[2])['experiences']) >= len(json.loads(maps[0])['experiences']) > 0
    assert session_titles(read_map(saved)) == ['camera', 'camera']


class Unplugged(Recording):
    """A camera whose program is ended after 5 s."""

    kind, is_endless = 'camera', True
    topics = (Topic('images', 'video', None),)
    start_ns = end_ns = START_NS

    def read_events(self, selection: Selection, start_ns: int, stop_ns: int) -> Iterator[Event]:
        for n in range(10):
            stamp_ns = START_NS + n * 500_000_000
            yield ImageEvent(stamp_ns, stamp_ns, Frame(picture(n, 48, 64)))
        raise MemoryError


def test_map_of_ended_process_is_kept_up_to_the_last_seconds(tmp_path: Path) -> None:
    path = tmp_path / 'saved.map'
    with pytest.raises(MemoryError):
        map_recording(Unplugged(tmp_path / 'none'), map_file=path, quiet=True)
    saved = read_map(path)
    assert saved.cut is not None
    assert saved.cut.stamp_ns == START_NS + 4_000_000_000
    assert unfinished_note(saved) == []  # nothing can be read again
