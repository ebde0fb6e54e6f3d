# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Log of what a process has received: what is found after an interruption at any moment."""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path

import pytest

from ratslam_ros.maps import input_log
from ratslam_ros.maps.input_log import ATTEMPT, END, Base, Entry, InputLog, used
from ratslam_ros.maps.kept_log import Beginning, LogKeeper, kept_runs, remove_kept

PARTS = 'local_view', 'pose_cells'
CUTS = [Base(7, 1, number) for number in range(4)]


def opened(folder: Path, base: Base, parts: tuple[str, ...] = PARTS) -> InputLog:
    return InputLog(folder / 'a[1].map', parts, base)


def filled(folder: Path) -> InputLog:
    """Return a log with two entries after each cut."""
    log = opened(folder, CUTS[0])
    for number, base in enumerate(CUTS):
        if number:
            log.cut(base)
        for each in range(2):
            log.append('odometry', 10 * number + each, bytes([number, each]))
    return log


def stamps(log: InputLog) -> list[int]:
    return [entry.stamp_ns for entry in log.entries]


@pytest.mark.parametrize('number', range(4))
def test_log_continues_after_any_cut(tmp_path: Path, number: int) -> None:
    filled(tmp_path)
    log = opened(tmp_path, CUTS[number])
    assert log.is_known
    assert log.entries[0] == Entry('odometry', 10 * number, bytes([number, 0]))
    assert stamps(log) == [10 * n + each for n in range(number, 4) for each in range(2)]
    log.append('odometry', 99, b'')
    again = opened(tmp_path, CUTS[number])  # interrupted again, before its next cut
    assert stamps(again) == [*stamps(log), 99]


def test_log_of_another_map_run_or_process_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bases = CUTS[0]._replace(inode=8), CUTS[0]._replace(session=2), CUTS[0]._replace(number=9)
    for base in bases:
        filled(tmp_path)
        assert not opened(tmp_path, base).is_known
        assert len(os.listdir(tmp_path)) == 1  # the new log
    filled(tmp_path)
    assert not opened(tmp_path, CUTS[0], PARTS[:1]).is_known
    filled(tmp_path)
    monkeypatch.setattr(input_log, '_boot', lambda: 'another')
    assert not opened(tmp_path, CUTS[0]).is_known  # entries may be missing on the disk


@pytest.mark.parametrize('size', range(0, 60, 7))
def test_torn_last_entry_is_left_out(tmp_path: Path, size: int) -> None:
    filled(tmp_path)
    last = max(tmp_path.iterdir())
    data = last.read_bytes()
    last.write_bytes(data[: len(data) - 1 - size])
    found = stamps(opened(tmp_path, CUTS[0]))
    whole = [0, 1, 10, 11, 20, 21, 30, 31]
    assert found == whole[: len(found)]
    assert 6 <= len(found) <= 7


def test_nothing_is_known_if_an_entry_could_not_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = filled(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(input_log, 'write', lambda file, data: len(data) - 1)
        log.append('odometry', 50, b'')
    log.append('odometry', 51, b'')
    assert not opened(tmp_path, CUTS[3]).is_known
    log = filled(tmp_path)
    log.forget()
    log.cut(CUTS[1])
    log.append('odometry', 60, b'')
    assert not opened(tmp_path / '.', CUTS[0]).is_known
    log = filled(tmp_path)
    log.forget()
    log.cut(CUTS[1])
    log.append('odometry', 60, b'')
    assert stamps(opened(tmp_path, CUTS[1])) == [60]


@pytest.mark.parametrize('is_full', [False, True], ids=['begin again', 'still full'])
def test_file_that_the_disk_refused_begins_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_full: bool
) -> None:
    """Nothing was received meanwhile, so that nothing is lost."""
    log = filled(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(input_log, 'write', lambda file, data: len(data) - 1)
        log.cut(CUTS[3]._replace(number=4))
        assert stamps(opened(tmp_path / '.', CUTS[2])) == [20, 21, 30, 31]
        if is_full:
            log.append('odometry', 40, b'')
    log.append('odometry', 41, b'')
    assert stamps(opened(tmp_path, CUTS[2])) == ([] if is_full else [20, 21, 30, 31, 41])


def test_what_is_older_than_a_common_cut_is_removed(tmp_path: Path) -> None:
    log = filled(tmp_path)
    log.forget_before(CUTS[2])
    assert len(os.listdir(tmp_path)) == 2
    log.forget_before(Base(7, 9, 9))
    assert stamps(opened(tmp_path, CUTS[2])) == [20, 21, 30, 31]


@pytest.mark.parametrize('remove', [True, False])
def test_clean_end_leaves_no_file(tmp_path: Path, remove: bool) -> None:
    filled(tmp_path).close(remove)
    assert bool(os.listdir(tmp_path)) != remove


def test_log_of_another_grouping_of_the_parts_is_removed(tmp_path: Path) -> None:
    """No process with one of the parts runs, as the new one has locked them."""
    filled(tmp_path)
    for parts in (('pose_cells',), ('landmark_map',)):
        opened(tmp_path, CUTS[0], parts)
    names = {path.name.rpartition('-')[0] for path in tmp_path.iterdir()}
    assert names == {'a[1].map-log-pose_cells', 'a[1].map-log-landmark_map'}


class Keeping:
    """A process whose log is kept, and is interrupted at will."""

    def __init__(self, folder: Path, configuration: str = '') -> None:
        self.path = folder / 'a[1].map'
        self.configuration = configuration

    def start(self, base: Base = CUTS[0], cut_ns: int | None = None) -> InputLog:
        keeper = LogKeeper(self.path, PARTS)
        log = InputLog(self.path, PARTS, base, keep=keeper.folder)
        beginning = Beginning(PARTS, self.configuration, '0', cut_ns)
        self.began = keeper.begin(log.first, beginning, {'pose_cells': {'sequence': 3}})
        return log

    @property
    def stamps(self) -> list[list[int]]:
        """The stamps of each run, -1 at its end."""
        return [
            [-1 if entry.stream == END else entry.stamp_ns for entry in run.entries()]
            for run in kept_runs(self.path)
        ]


def test_kept_log_contains_all_runs_over_interruptions(tmp_path: Path) -> None:
    one = Keeping(tmp_path)
    log = one.start()
    log.append('odometry', 1, b'')
    log.cut(CUTS[1])
    log.append('odometry', 2, b'')
    log.forget_before(CUTS[1])
    assert one.stamps == [[1, 2]]  # the last file is still beside the map
    log = one.start(CUTS[1])  # after a kill
    assert not one.began and log.is_known
    log.append(ATTEMPT, 0, b'')
    log.append('odometry', 3, b'')
    log.close(remove=True)
    assert one.stamps == [[1, 2, 3, -1]]
    log = one.start(CUTS[2], cut_ns=5)
    log.append('odometry', 4, b'')
    log.close(remove=True)
    assert one.stamps == [[1, 2, 3, -1], [4, -1]]
    first, second = kept_runs(one.path)
    assert (first.states, second.states['pose_cells']['sequence']) == ({}, 3)
    assert second.described()['has_ended'] and second.described()['inputs'] == 1
    InputLog(one.path, PARTS, CUTS[3]).close(remove=True)  # one that is not kept
    assert one.stamps == [[1, 2, 3, -1], [4, -1]]
    assert remove_kept(one.path) > 0
    assert os.listdir(tmp_path) == []


def test_kept_log_with_a_gap_ends_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = Keeping(tmp_path)
    log = one.start()
    log.append('odometry', 1, b'')
    with monkeypatch.context() as patch:
        patch.setattr(input_log, 'write', lambda file, data: 0)
        log.append('odometry', 2, b'')
    assert log.failed
    log.cut(CUTS[1])
    log.append('odometry', 3, b'')
    log.close(remove=True)
    assert one.stamps == [[1]]
    monkeypatch.setattr(input_log, '_boot', lambda: 'another')
    one.start(CUTS[1], cut_ns=5)
    assert one.began and one.stamps == [[1], []]


def test_other_parameters_begin_another_run(tmp_path: Path) -> None:
    Keeping(tmp_path).start().append('odometry', 1, b'')
    other = Keeping(tmp_path, 'pose_cells: 1')
    other.start()
    assert other.began


def test_entry_that_ends_the_process_three_times_is_not_used() -> None:
    a, b, attempt = Entry('a', 1, b''), Entry('b', 2, b''), Entry(ATTEMPT, 0, b'')
    assert [*used([a, attempt, b, attempt, attempt])] == [a, b]
    assert [*used([a, attempt, attempt, attempt, b])] == [b]


def test_foreign_files_are_left_alone_and_damaged_ones_removed(tmp_path: Path) -> None:
    other = tmp_path / 'b.map-log-local_view-000000001'
    other.write_bytes(b'other')
    damaged = tmp_path / 'a[1].map-log-local_view-000000001'
    for data in (b'', b'x' * 9, b'\xff' * 100):
        damaged.write_bytes(data)
        assert not opened(tmp_path, CUTS[0]).is_known
    assert other.exists()


def test_log_of_an_earlier_format_is_not_used(tmp_path: Path) -> None:
    header = b'[[7,1,0],["local_view","pose_cells"],"x","0.1.0",true,true]'
    rest = struct.pack('<qB', 0, 0) + header
    earlier = tmp_path / 'a[1].map-log-local_view-000000001'
    earlier.write_bytes(struct.pack('<II', len(rest), zlib.crc32(rest)) + rest)
    assert not opened(tmp_path, CUTS[0]).is_known
