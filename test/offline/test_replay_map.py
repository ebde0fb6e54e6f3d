# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replays that keep their map in a file: interrupted, killed, continued, and localised on."""

from __future__ import annotations

import hashlib
import itertools
import multiprocessing
import os
import resource
import shutil
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest
from helpers import SMALL_IMAGES, circles, extended, picture, real_recording, write_bag
from kill_replays import Job, kill_replays
from open_every_save import open_every_save

from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import load_config
from ratslam_ros.maps import file_writer, read_map, schema
from ratslam_ros.offline import replay_map
from ratslam_ros.offline.replay import ReplayOptions, ReplayOutcome, replay
from ratslam_ros.offline.replay_map import ReplayMap
from ratslam_ros.recordings import Event, Recording, open_recording
from ratslam_ros.results.writer import Results

CONFIG = extended().with_values(SMALL_IMAGES)


class StoppedError(Exception):
    """A replay was stopped between two events."""


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp('bag') / 'circles', circles(laps=3))


def run(
    bag: Path, folder: Path, *, stop_after: int | None = None, localize: bool = False,
    duration_s: float | None = None, config: Config = CONFIG, map_name: str = 'a.map',
    lines: list[str] | None = None, act_after: int | None = None,
    action: Callable[[], Any] = lambda: None, history: bool = False,
) -> tuple[ReplayOutcome, ReplayMap]:
    """Replay with the map in a folder.

    ``stop_after``: number of events after which it ends as if it was killed. ``act_after``:
    number of events after which an action is carried out.
    """
    lines = [] if lines is None else lines
    map_file = ReplayMap(folder / map_name, localize, lines.append, lines.append)
    map_file.configuration()
    options = ReplayOptions(
        duration_s=duration_s, progress=False, map_file=map_file, history=history
    )
    with open_recording(bag) as recording:
        if stop_after is not None:
            _stop(recording, stop_after)
        if act_after is not None:
            _act(recording, act_after, action)
        outcome = replay(recording, recording.select(), config, folder / 'results', options)
    return outcome, map_file


def _stop(recording: Recording, count: int) -> None:
    events = recording.read_events

    def first(*args: Any) -> Iterator[Event]:
        yield from itertools.islice(events(*args), count)
        raise StoppedError

    recording.read_events = first  # type: ignore[method-assign]


def _act(recording: Recording, count: int, action: Callable[[], Any]) -> None:
    events = recording.read_events

    def interrupted(*args: Any) -> Iterator[Event]:
        for place, event in enumerate(events(*args)):
            if place == count:
                action()
                time.sleep(0.05)  # This thread reads ahead.
            yield event

    recording.read_events = interrupted  # type: ignore[method-assign]


def _remove(folder: Path) -> None:
    """Remove a folder in which another thread creates and removes files."""
    while folder.exists():
        shutil.rmtree(folder, ignore_errors=True)


def result_of(folder: Path) -> tuple[bytes, str]:
    return (folder / 'results' / 'map.json').read_bytes(), read_map(folder / 'a.map').digest


@pytest.fixture(scope='module')
def undisturbed(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('undisturbed')
    run(bag, folder)
    return folder


@pytest.fixture
def frequent_cuts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Save after each message, without waiting for the disk."""
    def connect(*args: Any) -> Any:
        database = schema.connect(*args)
        database.execute('PRAGMA synchronous = OFF')
        return database

    monkeypatch.setattr(file_writer, 'connect', connect)
    monkeypatch.setattr(replay_map, 'CUT_PERIOD_S', 0.0)


def test_map_file_does_not_change_the_map(bag: Path, undisturbed: Path, tmp_path: Path) -> None:
    with open_recording(bag) as recording:
        replay(recording, recording.select(), CONFIG, tmp_path, ReplayOptions(progress=False))
    assert (tmp_path / 'map.json').read_bytes() == result_of(undisturbed)[0]
    assert [path.name for path in undisturbed.iterdir()] in (
        ['a.map', 'results'], ['results', 'a.map'],
    )


@pytest.mark.usefixtures('frequent_cuts')
def test_stopped_replay_continues_exactly(bag: Path, undisturbed: Path, tmp_path: Path) -> None:
    stops = 1, 40, 41, 120
    for stop in stops:
        with pytest.raises(StoppedError):
            run(bag, tmp_path, stop_after=stop)
    lines: list[str] = []
    outcome, map_file = run(bag, tmp_path, lines=lines)
    # Events are handed over in batches, so that the last ones before the stop may be missing.
    assert max(stops) - 16 <= map_file.skipped <= max(stops)
    assert result_of(tmp_path) == result_of(undisturbed)
    assert outcome.summary['map']['messages_before'] == map_file.skipped
    assert any(f'after {map_file.skipped} messages' in line for line in lines)


def test_part_of_a_recording_is_continued_exactly(
    bag: Path, undisturbed: Path, tmp_path: Path
) -> None:
    run(bag, tmp_path, duration_s=2.0)
    run(bag, tmp_path, duration_s=1.0)  # contained already
    outcome, _ = run(bag, tmp_path)
    assert outcome.summary['map']['messages_before'] > 0
    assert result_of(tmp_path) == result_of(undisturbed)


def test_complete_recording_is_not_repeated(bag: Path, undisturbed: Path, tmp_path: Path) -> None:
    run(bag, tmp_path)
    lines: list[str] = []
    outcome, _ = run(bag, tmp_path, lines=lines)
    assert outcome.summary['frames'] == 0
    assert result_of(tmp_path) == result_of(undisturbed)
    assert any('contains all' in line for line in lines)


@pytest.mark.parametrize('kind', ['bag', 'images'])
def test_map_and_results_inside_a_recording_do_not_change_it(
    kind: str, bag: Path, tmp_path: Path
) -> None:
    inside = tmp_path / 'inside'
    if kind == 'bag':
        shutil.copytree(bag, inside)
    else:
        (inside / 'left').mkdir(parents=True)
        for number in range(30):
            cv2.imwrite(str(inside / f'left/{number}.png'), picture(number, 24, 32))
        rows = [f'{number},left/{number}.png' for number in range(30)]
        (inside / 'table.csv').write_text('\n'.join(['time_s,file', *rows]))
    run(inside, inside / 'left')
    (inside / 'truth.tum').write_text('0 0 0 0 0 0 0 1\n')
    lines: list[str] = []
    _, map_file = run(inside, inside / 'left', lines=lines)
    assert any(line.startswith('the map contains all') for line in lines)
    assert map_file.skipped


def test_other_recording_is_a_new_session(bag: Path, tmp_path: Path) -> None:
    other = write_bag(tmp_path / 'others', circles(laps=2))
    run(bag, tmp_path)
    before = read_map(tmp_path / 'a.map')
    lines: list[str] = []
    outcome, map_file = run(other, tmp_path, lines=lines)
    after = read_map(tmp_path / 'a.map')
    assert map_file.skipped == 0
    assert outcome.summary['frames'] > 0
    assert replay_map.session_titles(after) == ['circles', 'others']
    assert after.digest != before.digest
    assert 'places, 1 session' in lines[0]
    assert lines[0].startswith(f'continues {tmp_path / "a.map"}: ')


def test_localising_leaves_the_file_unchanged(bag: Path, tmp_path: Path) -> None:
    run(bag, tmp_path)
    files = {path: hashlib.sha256(path.read_bytes()).digest() for path in tmp_path.glob('a.map*')}
    assert len(files) == 1
    places = len(read_map(tmp_path / 'a.map').states['experience_map']['core']['labels'])
    other = write_bag(tmp_path / 'others', circles(laps=4))
    outcome, _ = run(other, tmp_path, localize=True)
    assert outcome.summary['frames'] > 0
    assert outcome.summary['experiences'] == places
    assert outcome.summary['templates'] == 0
    assert outcome.summary['map']['localize'] is True
    assert files == {
        path: hashlib.sha256(path.read_bytes()).digest() for path in tmp_path.glob('a.map*')
    }


def test_localising_without_a_map_is_refused(bag: Path, tmp_path: Path) -> None:
    with pytest.raises(UnusableInput, match='does not exist; make it first'):
        run(bag, tmp_path, localize=True)


@pytest.mark.parametrize(
    ('name', 'value'),
    [('local_view.template_x_size', 20), ('pose_cells.pc_dim_x', 40),
     ('local_view.vt_descriptor', 'gradients')],
)
def test_other_sizes_than_those_of_the_map_are_refused(
    name: str, value: Any, undisturbed: Path, bag: Path
) -> None:
    before = read_map(undisturbed / 'a.map').digest
    with pytest.raises(UnusableInput, match=f'has {name} .*, but {value} was given'):
        run(bag, undisturbed, config=CONFIG.with_values({name: value}))
    assert read_map(undisturbed / 'a.map').digest == before


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGINT])
def test_stop_signal_saves_the_map_to_be_continued_exactly(
    number: signal.Signals, bag: Path, undisturbed: Path, tmp_path: Path
) -> None:
    lines: list[str] = []
    outcome, map_file = run(
        bag, tmp_path, lines=lines, act_after=100, action=lambda: os.kill(os.getpid(), number)
    )
    assert outcome.interrupted
    assert map_file.problem == ''
    assert sorted(path.name for path in tmp_path.glob('a.map*')) == ['a.map']
    progress = read_map(tmp_path / 'a.map').states['inputs'][replay_map.PROGRESS]
    assert 0 < sum(progress['counts'].values()) < 180
    run(bag, tmp_path)
    assert result_of(tmp_path) == result_of(undisturbed)


def test_full_disk_is_reported_once_and_loses_nothing(
    bag: Path, undisturbed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay_map, 'FLUSH_STEP_S', 0.1)
    run(bag, tmp_path, duration_s=1.0)
    before = read_map(tmp_path / 'a.map')
    context = multiprocessing.get_context('fork')
    receiver, sender = context.Pipe(duplex=False)

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))
        lines: list[str] = []
        _, map_file = run(bag, tmp_path, lines=lines)
        sender.send((lines, map_file.problem))

    process = context.Process(target=limited)
    process.start()
    process.join(60.0)
    assert receiver.poll()
    lines, problem = receiver.recv()
    assert problem
    assert lines.count(f'{problem}; mapping continues in memory, and saving is tried again') == 1
    assert read_map(tmp_path / 'a.map').digest == before.digest
    run(bag, tmp_path)
    assert result_of(tmp_path) == result_of(undisturbed)


def test_missing_folder_of_the_map_is_created(bag: Path, tmp_path: Path) -> None:
    run(bag, tmp_path, map_name='maps/office.map', duration_s=1.0)
    assert read_map(tmp_path / 'maps' / 'office.map').states


@pytest.mark.filterwarnings('error')  # such as that of an exception in a thread
@pytest.mark.usefixtures('frequent_cuts')
def test_removed_folder_of_the_map_is_created_again(
    bag: Path, undisturbed: Path, tmp_path: Path
) -> None:
    lines: list[str] = []
    maps = tmp_path / 'maps'
    _, map_file = run(
        bag, tmp_path, map_name='maps/a.map', lines=lines, act_after=100,
        action=lambda: _remove(maps),
    )
    assert map_file.problem == ''
    assert 'written again' in lines[-1]
    (maps / 'a.map').rename(tmp_path / 'a.map')
    assert result_of(tmp_path) == result_of(undisturbed)


def test_removed_folder_of_the_results_is_reported_in_one_line(
    bag: Path, undisturbed: Path, tmp_path: Path
) -> None:
    with pytest.raises(UnusableInput, match='was removed since this run began'):
        run(
            bag, tmp_path, act_after=100, action=lambda: shutil.rmtree(tmp_path / 'results')
        )
    assert read_map(tmp_path / 'a.map').digest == read_map(undisturbed / 'a.map').digest


@pytest.mark.parametrize('earlier', [False, True])
def test_other_run_in_the_folder_of_results_is_reported_and_kept(
    bag: Path, earlier: bool, tmp_path: Path
) -> None:
    results = tmp_path / 'results'
    if earlier:
        results.mkdir()
        (results / 'map.json').write_text('of an earlier run')
    others: list[Results] = []
    with pytest.raises(UnusableInput, match='has been written by another run'):
        run(
            bag, tmp_path, act_after=100, history=True,
            action=lambda: others.append(Results(results, load_config(None)[0])),
        )
    others[0].check_folder()
    others[0].discard()
    assert [path.name for path in results.iterdir()] == ['map.json'] * earlier


def test_map_given_as_recording_is_named(undisturbed: Path) -> None:
    with pytest.raises(UnusableInput, match='is a map: expected a recording'):
        open_recording(undisturbed / 'a.map')


def test_map_file_does_not_depend_on_the_speed(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay_map, 'CUT_PERIOD_S', 0.5)

    def slowed(function: Any) -> Any:
        def slow(*args: Any) -> Any:
            time.sleep(0.005)
            return function(*args)

        return slow

    run(bag, tmp_path / 'fast')
    for owner, name in ((ReplayMap, 'after'), (file_writer.FileWriter, 'write')):
        monkeypatch.setattr(owner, name, slowed(getattr(owner, name)))
    run(bag, tmp_path / 'slow')
    assert (tmp_path / 'fast/a.map').read_bytes() == (tmp_path / 'slow/a.map').read_bytes()


def test_unsaved_map_is_reported_and_results_are_written(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(file_writer.FileWriter, '_write', full)
    monkeypatch.setattr(replay_map, 'FLUSH_STEP_S', 0.1)
    lines: list[str] = []
    outcome, map_file = run(bag, tmp_path, lines=lines)
    assert 'No space left' in map_file.problem
    assert outcome.summary['map']['saved'] is False
    assert (tmp_path / 'results' / 'map.json').exists()
    assert sum('No space left' in line for line in lines) == 1


def test_killed_replays_end_with_identical_maps(bag: Path, tmp_path: Path) -> None:
    job = Job(bag, CONFIG, None, period_s=0.1)
    tally = kill_replays(job, 2, seed=3, folder=tmp_path, per_map=2)
    assert tally.failures == []
    assert tally.identical == tally.maps > 0
    assert tally.behind == 0
    assert tally.kills.total() == 2


def test_remaining_events_are_counted_by_stream(bag: Path, tmp_path: Path) -> None:
    map_file = ReplayMap(tmp_path / 'a.map', False, print, print)
    map_file._to_skip.update(image=2, odometry=3)
    with open_recording(bag) as recording:
        events = list(recording.events(recording.select()))
    left = list(map_file.remaining(iter(events)))
    counts = [Counter(one.KIND for one in items) for items in (events, left)]
    assert counts[0] - counts[1] == Counter(image=2, odometry=3)
    assert map_file.skipped == 5


def test_map_saved_after_every_message_opens_as_it_was() -> None:
    """5 s of a recording; tools/open_every_save.py checks whole ones."""
    assert open_every_save(real_recording('rc_car_eight'), load_config('auto')[0], 5.0) > 40
