# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reading of maps: it changes nothing, and survives damaged and malicious files."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import random
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from map_states import META, growing_state, opened, same, write

import ratslam_ros
from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableInput
from ratslam_ros.maps import Cut, MapMeta, read_map, save_map
from ratslam_ros.maps.chunks import Compressor
from ratslam_ros.maps.reader import unusable


def made(path: Path, state: dict[str, Any] | None = None) -> Path:
    save_map(path, {'local_view': growing_state(3) if state is None else state}, META, Cut(3, 30))
    return path


def killed_writer(folder: Path) -> Path:
    """Return a folder with a map and its log as a killed writer leaves them."""
    store = opened(folder / 'a.map', 'local_view')
    write(store, 1)
    killed = folder / 'killed'
    killed.mkdir()
    for file in ('a.map', 'a.map-wal'):
        shutil.copy(folder / file, killed)
    store.close()
    return killed


def changed(path: Path, *statements: str) -> Path:
    """Change a map by SQL."""
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        for statement in statements:
            database.execute(statement)
        database.execute('PRAGMA wal_checkpoint(TRUNCATE)')
    return path


def refusal(path: Path) -> str:
    """Return why a map is refused by readers and writers, which is one line."""
    with pytest.raises(UnusableInput) as error:
        read_map(path)
    before = path.read_bytes()
    with pytest.raises(UnusableInput):
        opened(path, 'local_view')
    assert path.read_bytes() == before
    assert '\n' not in str(error.value)
    return str(error.value)


def test_reading_changes_no_file(tmp_path: Path) -> None:
    path = made(tmp_path / 'a.map')
    before = path.stat().st_mtime_ns, hashlib.sha256(path.read_bytes()).digest()
    saved = read_map(path)
    assert same(saved.states['local_view'], growing_state(3))
    assert (saved.cut, saved.meta, [*saved.states]) == (Cut(3, 30), META, ['local_view'])
    assert (path.stat().st_mtime_ns, hashlib.sha256(path.read_bytes()).digest()) == before
    assert os.listdir(tmp_path) == ['a.map']


def test_reading_after_a_kill_changes_no_file(tmp_path: Path) -> None:
    killed = killed_writer(tmp_path)
    before = {file.name: file.read_bytes() for file in killed.iterdir()}
    assert same(read_map(killed / 'a.map').states['local_view'], growing_state(1))
    assert {file.name: file.read_bytes() for file in killed.iterdir()} == before


def test_map_on_a_disk_without_locks_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program that could not write a map there has left its lock file."""
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, 'No locks available')

    path = made(tmp_path / 'a.map')
    Path(f'{path}-lock').touch()
    monkeypatch.setattr('ratslam_ros.maps.locks._call', refuse)
    assert read_map(path).cut == Cut(3, 30)


def test_restored_arrays_may_be_changed(tmp_path: Path) -> None:
    state = read_map(made(tmp_path / 'a.map')).states['local_view']
    state['core']['poses'][:] = 1


@pytest.mark.parametrize('name', ['none.map', 'none/none.map'])
def test_missing_map_is_reported(tmp_path: Path, name: str) -> None:
    with pytest.raises(UnusableInput, match='does not exist; expected a map file'):
        read_map(tmp_path / name)


def test_newer_format_is_reported_in_one_line(tmp_path: Path) -> None:
    path = changed(made(tmp_path / 'a.map'), 'PRAGMA user_version = 2')
    assert 'newer version of ratslam_ros (map format 2, this version reads up to 1)' in (
        refusal(path)
    )


@pytest.mark.parametrize('statement', [
    'CREATE TABLE extra (a)', 'CREATE VIEW extra AS SELECT 1', 'DROP TABLE log',
    'CREATE TRIGGER extra AFTER INSERT ON cuts BEGIN DELETE FROM chunks; END',
    'CREATE INDEX extra ON log (data)', 'ALTER TABLE cuts ADD COLUMN extra',
    'PRAGMA user_version = 0', 'CREATE VIRTUAL TABLE extra USING fts5(a)',
])
def test_unexpected_layout_is_refused(tmp_path: Path, statement: str) -> None:
    assert 'was changed by another program' in refusal(
        changed(made(tmp_path / 'a.map'), statement)
    )


def test_other_databases_are_refused(tmp_path: Path) -> None:
    path = changed(made(tmp_path / 'a.map'), 'PRAGMA application_id = 5')
    assert 'another kind of database' in refusal(path)


OUTLINE = "part = 'local_view' AND array = ''"


@pytest.mark.parametrize('statement', [
    f'DELETE FROM chunks WHERE {OUTLINE}', "DELETE FROM chunks WHERE array = '/core/poses'",
    "DELETE FROM chunks WHERE array = '/core/poses' AND position = 2",
    "UPDATE chunks SET data = 'text'", "UPDATE chunks SET data = x'00'",
    "UPDATE chunks SET data = zeroblob(70000000) WHERE array = ''",
    'UPDATE cuts SET outline_bytes = -1', 'UPDATE cuts SET outline_bytes = 1 << 60',
    'UPDATE cuts SET outline_bytes = 9', "UPDATE cuts SET digest = 'text'",
    "UPDATE cuts SET digest = x'00'", "UPDATE cuts SET stamp_ns = 'text'",
    'UPDATE cuts SET stamp_ns = 1.5', "UPDATE cuts SET part = 'Other part'",
    "UPDATE chunks SET array = '/other' WHERE array = '/core/poses'",
    'UPDATE chunks SET since = since + 1', "UPDATE sessions SET meta = '['",
    'UPDATE sessions SET meta = \'{"title": 3}\'', 'UPDATE sessions SET meta = zeroblob(9)',
    "UPDATE sessions SET lost_from_ns = 'text'", 'UPDATE members SET part = 3',
    "UPDATE members SET joined = 'text'",
    "UPDATE sessions SET lost_to_ns = x'00'",
])
def test_damaged_rows_are_refused(tmp_path: Path, statement: str) -> None:
    refusal(changed(made(tmp_path / 'a.map'), statement))


def test_error_of_damaged_chunk_says_what_to_do(tmp_path: Path) -> None:
    text = refusal(changed(made(tmp_path / 'a.map'), "UPDATE chunks SET data = x'00'"))
    assert 'a.map is damaged (' in text and text.endswith('; use a backup')


def test_name_of_a_map_is_no_sign_of_damage(tmp_path: Path) -> None:
    path = made(tmp_path / 'malformed.map')
    error = PermissionError(errno.EACCES, 'Permission denied', str(path))
    assert 'cannot be read' in str(unusable(path, error))


def test_flipped_bit_of_the_configuration_is_noticed(tmp_path: Path) -> None:
    path = made(tmp_path / 'a.map')
    changed(path, "UPDATE sessions SET meta = replace(meta, 'a: 1', 'a: 3')")
    assert 'checksum' in refusal(path)
    changed(path, "UPDATE sessions SET meta = json_remove(meta, '$.checksum')")
    assert read_map(path).meta.configuration == 'a: 3\n'  # as of versions without checksums


@pytest.mark.xfail(strict=True, reason='the issue on the store (39)')
@pytest.mark.parametrize('is_restored', [False, True])
def test_map_without_its_log_is_refused(tmp_path: Path, is_restored: bool) -> None:
    """It was copied without it, or a backup was restored beside that of a killed program."""
    backup = made(tmp_path / 'backup.map')
    path = Path(shutil.copy(backup, tmp_path / 'a.map'))
    copied = tmp_path / 'copied.map'
    for number in (1, 2):
        store = opened(path, 'local_view')
        write(store, number)
        shutil.copy(backup if is_restored else path, copied)
        if is_restored:
            shutil.copy(f'{path}-wal', f'{copied}-wal')
        store.close()
    with pytest.raises(UnusableInput, match=f'{copied}.*{copied}-wal'):
        read_map(copied)


def test_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    """Every chunk claims its size, and all of them together at most that of the outline."""
    path = made(tmp_path / 'a.map', {'a': np.zeros(200_000_000 // 8)})
    assert path.stat().st_size < 4_000_000
    text = json.dumps({'a': {'$array': ['<f8', [2**31]]}})
    store = opened(tmp_path / 'b.map', 'local_view')
    write(store, 1, {'a': 1})
    store.close()
    frame = Compressor().compressed(np.frombuffer(text.encode(), np.uint8), 1)
    changed(
        tmp_path / 'b.map', f"UPDATE chunks SET data = x'{frame.hex()}'",
        f'UPDATE cuts SET outline_bytes = {len(text)}',
    )
    assert 'claims 17179869184 bytes' in refusal(tmp_path / 'b.map')


def test_damaged_bytes_are_refused_or_have_no_effect(tmp_path: Path) -> None:
    original = made(tmp_path / 'a.map').read_bytes()
    digest = read_map(tmp_path / 'a.map').digest
    generator = random.Random(1)
    refused = 0
    for _ in range(60):
        content = bytearray(original)
        for _ in range(generator.choice((1, 1, 5))):
            content[generator.randrange(len(content))] ^= 1 << generator.randrange(8)
        if generator.random() < 0.2:
            del content[generator.randrange(len(content)) :]
        (tmp_path / 'b.map').write_bytes(content)
        try:
            assert read_map(tmp_path / 'b.map').digest == digest
        except UnusableInput as error:
            refused += 1
            assert '\n' not in str(error)
    assert refused > 30


def test_interrupted_replacement_keeps_the_earlier_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = made(tmp_path / 'a.map')
    before = path.read_bytes()

    def fail(*names: object) -> None:
        raise OSError(28, 'No space left on device')

    with monkeypatch.context() as patch:
        patch.setattr(os, 'replace', fail)
        with pytest.raises(UnusableInput, match='No space left'):
            made(path, {'a': 1})
    assert path.read_bytes() == before
    with pytest.raises(TypeError):
        made(path, {'a': object()})
    assert path.read_bytes() == before
    assert [name for name in os.listdir(tmp_path) if not name.endswith('-lock')] == ['a.map']
    made(path, {'a': 1})
    assert read_map(path).states['local_view'] == {'a': 1}


def test_file_that_is_no_map_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / 'notes.txt').write_text('keep')
    with pytest.raises(UnusableInput, match='is not a map file'):
        made(tmp_path / 'notes.txt')
    assert (tmp_path / 'notes.txt').read_text() == 'keep'


def test_replaced_map_is_not_mixed_with_the_log_of_a_killed_writer(tmp_path: Path) -> None:
    killed = killed_writer(tmp_path)
    save_map(killed / 'a.map', {'pose_cells': {'n': 1}}, META)
    assert read_map(killed / 'a.map').states == {'pose_cells': {'n': 1}}
    assert 'a.map-wal' not in os.listdir(killed)


def test_ratslam_is_saved_and_loaded(tmp_path: Path) -> None:
    slam = ratslam_ros.RatSLAM(Config())
    image = np.random.default_rng(1).integers(0, 255, (120, 160), np.uint8)
    for number in range(30):
        slam.odometry(Odometry(number * 10**8, Twist(0.3, 0.05), Pose(0.0, 0.0, 0.0)))
        slam.image(number * 10**8 + 5, np.roll(image, 4 * number, axis=1))
    path = tmp_path / 'a.map'
    ratslam_ros.save_map(slam, path, Config())
    again = ratslam_ros.load_map(path)
    assert len(again.experience_map) == len(slam.experience_map) > 0
    ratslam_ros.save_map(again, tmp_path / 'b.map', Config())
    assert read_map(path).digest == read_map(tmp_path / 'b.map').digest
    assert read_map(path).meta.title == 'a'
    save_map(path, {}, MapMeta())
    with pytest.raises(UnusableInput, match='contains no configuration'):
        ratslam_ros.load_map(path)
