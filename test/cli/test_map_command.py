# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam map``: info, check, export, prune and compact, in this process."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import START_NS, circles, write_bag

from ratslam_ros.cli import main
from ratslam_ros.errors import UnusableInput
from ratslam_ros.maps import Cut, MapMeta, MapStore, read_map
from ratslam_ros.maps.saved_map import seconds
from ratslam_ros.offline import map_merging, map_pruning, map_upkeep
from ratslam_ros.offline.map_upkeep import config_of_map, experience_map_of
from ratslam_ros.offline.replay import _Run

SETTINGS = (
    'local_view.template_x_size=16', 'local_view.template_y_size=8',
    'local_view.vt_shift_match=2', 'pose_cells.pc_cell_x_size=0.2',
    'pose_cells.exp_delta_pc_threshold=1.0',
)


def replayed(bag: Path, folder: Path, *words: str) -> int:
    settings = [word for one in SETTINGS for word in ('--set', one)]
    return main([
        'replay', str(bag), '--config', 'extended', *settings, '--map', str(folder / 'a.map'),
        '--out', str(folder / 'results'), '--no-history', *words,
    ])


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp('bag') / 'circles', circles(laps=3, radius_m=5.0))


@pytest.fixture(scope='module')
def mapped(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('mapped')
    assert replayed(bag, folder, '--quiet') == 0
    return folder


@pytest.fixture
def copied(mapped: Path, tmp_path: Path) -> Path:
    """Return a copy of the map."""
    return Path(shutil.copy(mapped / 'a.map', tmp_path / 'a.map'))


def test_info_prints_sizes_sessions_and_digest(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['map', 'info', str(copied)]) == 0
    text = capsys.readouterr().out
    assert main(['map', 'info', str(copied), '--json']) == 0
    info = json.loads(capsys.readouterr().out)
    saved = read_map(copied)
    assert info['places'] == len(saved.states['experience_map']['core']['labels']) > 20
    assert info['templates'] == len(saved.states['local_view']['core']['templates']) > 20
    assert info['sessions'] == ['circles']
    assert info['missing'] == []
    assert info['digest'] == saved.digest
    assert info['bytes'] == copied.stat().st_size
    for part in (f'{info["places"]} in one part', '1: circles', saved.digest, 'nothing'):
        assert part in text


def test_stored_parameters_are_a_configuration(
    bag: Path, copied: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['map', 'info', str(copied), '--parameters']) == 0
    config = tmp_path / 'stored.yaml'
    config.write_text(capsys.readouterr().out)
    again = tmp_path / 'again'
    assert main(['replay', str(bag), '--config', str(config), '--out', str(again),
                 '--quiet', '--no-history']) == 0
    assert main(['map', 'export', str(copied), '--format', 'json']) == 0
    assert capsys.readouterr().out == (again / 'map.json').read_text()


@pytest.mark.parametrize('name', ['a.map', 'results/map.json'])
def test_export_of_results_replaces_nothing_that_it_reads(
    name: str, mapped: Path, refusal: Callable[..., str]
) -> None:
    out, before = str(mapped / name), (mapped / name).read_bytes()
    results = str(mapped / 'results')
    assert 'is read' in refusal('map', 'export', results, '--format', 'json', '-o', out)
    assert (mapped / name).read_bytes() == before


@pytest.mark.parametrize('form', ['json', 'tum', 'png'])
def test_results_and_map_json_are_exported_like_the_map_file(
    form: str, mapped: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, 'networkx', None)
    results = mapped / 'results'
    written = []
    for number, path in enumerate((mapped / 'a.map', results / 'map.json', results)):
        out = tmp_path / f'{number}.{form}'
        assert main(['map', 'export', str(path), '-o', str(out)]) == 0
        assert capsys.readouterr().out.strip() == str(out)
        written.append(out.read_bytes())
    assert len(written[0]) > 1000
    assert written[0] == written[1]
    # The plot of a results folder also has dead reckoning.
    assert written[2] == ((results / 'map.png').read_bytes() if form == 'png' else written[0])


def test_export_of_results_reads_their_map_file_while_it_is_the_same(
    mapped: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = Path(shutil.copytree(mapped / 'results', tmp_path / 'results'))
    export = ['map', 'export', str(results), '--format', 'json']
    text = (results / 'map.json').read_text(encoding='utf-8')
    (results / 'map.json').write_text(f'{text}\n', encoding='utf-8')  # the same values
    assert main(export) == 0
    assert capsys.readouterr().out == text
    text = text.replace('"pc_x":', '"pc_x":1')  # other places
    (results / 'map.json').write_text(text, encoding='utf-8')
    assert main(export) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(text)


@pytest.mark.parametrize(
    ('words', 'reason'),
    [((), 'give the format'), (('-o', 'map.txt'), 'give the format'),
     (('--format', 'json', '--spacing', '2'), 'use it with geojson'),
     (('--format', 'png'), 'give --out'), (('-o', 'map.pgm'), 'has no scans'),
     (('--format', 'geojson', '--spacing', '500'), 'smaller --spacing')],
)
def test_wrong_export_is_one_line(
    words: tuple[str, ...], reason: str, copied: Path, refusal: Callable[..., str]
) -> None:
    assert reason in refusal('map', 'export', str(copied), *words)


def test_export_to_a_hyphen_is_printed(
    copied: Path, capfd: pytest.CaptureFixture[str], refusal: Callable[..., str]
) -> None:
    words = 'map', 'export', str(copied), '--format', 'json'
    assert main([*words]) == 0
    printed = capfd.readouterr().out
    assert main([*words, '-o', '-']) == 0
    assert capfd.readouterr().out == printed
    assert 'give --out' in refusal('map', 'export', str(copied), '--format', 'png', '-o', '-')
    assert not Path('-').exists()


def test_map_that_is_a_pipe_is_refused(tmp_path: Path, refusal: Callable[..., str]) -> None:
    os.mkfifo(tmp_path / 'a.map')
    assert 'it is a pipe' in refusal('map', 'info', str(tmp_path / 'a.map'))


@pytest.mark.parametrize(('form', 'name'), [('json', 'a.map'), ('png', 'link.map')])
def test_export_over_its_own_map_is_refused(
    form: str, name: str, copied: Path, refusal: Callable[..., str]
) -> None:
    copied.with_name('link.map').symlink_to(copied)
    before = copied.read_bytes()
    out = str(copied.with_name(name))
    assert 'is read' in refusal('map', 'export', str(copied), '--format', form, '-o', out)
    assert copied.read_bytes() == before


def test_check_finds_every_damaged_chunk(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with sqlite3.connect(copied) as database:
        rows = database.execute('SELECT rowid FROM chunks').fetchall()
        database.execute("UPDATE chunks SET data = x'00' WHERE rowid = ?", rows[len(rows) // 2])
    database.close()
    assert main(['map', 'check', str(copied)]) == 1
    assert 'is damaged' in capsys.readouterr().out


def test_check_finds_damaged_pages(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = bytearray(copied.read_bytes())
    data[4096:8192] = os.urandom(4096)
    copied.write_bytes(data)
    assert main(['map', 'check', str(copied)]) == 1
    assert str(copied) in capsys.readouterr().out


def test_check_reports_log_of_interrupted_program(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with sqlite3.connect(copied) as database:
        database.execute('PRAGMA journal_mode = WAL')
        database.execute("UPDATE sessions SET meta = meta || ' '")
        database.commit()
        for suffix in ('', '-wal'):
            shutil.copy(f'{copied}{suffix}', f'{copied}.killed{suffix}')
    database.close()
    killed = f'{copied}.killed'
    assert main(['map', 'check', killed]) == 0
    assert 'did not end properly' in capsys.readouterr().err
    assert main(['map', 'compact', killed]) == 0
    capsys.readouterr()
    assert not Path(f'{killed}-wal').exists()
    assert main(['map', 'check', killed]) == 0
    assert 'did not end' not in capsys.readouterr().err


@pytest.mark.parametrize('action', ['info', 'check', 'compact', 'drop-log'])
def test_missing_map_is_one_line(action: str, tmp_path: Path, refusal: Callable[..., str]) -> None:
    assert 'does not exist' in refusal('map', action, str(tmp_path / 'none.map'))
    assert list(tmp_path.iterdir()) == []


def test_compact_keeps_the_content_and_a_backup(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with sqlite3.connect(copied) as database:
        database.execute("INSERT INTO log VALUES ('odometry', 1, zeroblob(300000))")
        database.commit()
        database.execute('DELETE FROM log')
    database.close()
    before, digest = copied.read_bytes(), read_map(copied).digest
    assert main(['map', 'compact', str(copied)]) == 0
    assert copied.stat().st_size < len(before) - 250_000
    assert read_map(copied).digest == digest
    assert Path(f'{copied}.bak').read_bytes() == before
    assert sorted(path.name for path in copied.parent.glob('a.map*')) == ['a.map', 'a.map.bak']
    assert main(['map', 'check', str(copied)]) == 0


def test_failing_disk_never_loses_the_map(
    copied: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    digest = read_map(copied).digest
    refused = 0
    for number in range(1, 50):
        path, left = copied.with_name(f'{number}.map'), [number]
        shutil.copy(copied, path)
        with monkeypatch.context() as patch:
            for name in ('link', 'replace', 'fsync'):
                patch.setattr(os, name, _failing(getattr(os, name), left))
            code = main(['map', 'compact', str(path)])
        if code == 0:  # Some failures do no harm, such as that of a hard link.
            assert read_map(f'{path}.bak').digest == digest
        else:
            refused += 1
            assert code == 2
            assert 'No space left' in capsys.readouterr().err
            assert read_map(path).digest == digest
        assert main(['map', 'check', str(path)]) == 0
        capsys.readouterr()
        if left[0] > 0:
            break
    assert code == 0
    assert refused >= 2


def _failing(function: Callable[..., Any], left: list[int]) -> Callable[..., Any]:
    def fails(*args: Any, **kwargs: Any) -> Any:
        left[0] -= 1
        if left[0] == 0:
            raise OSError(28, 'No space left on device')
        return function(*args, **kwargs)

    return fails


def test_compact_of_map_in_use_is_refused(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = MapStore(copied, ['pose_cells'], MapMeta(), lambda line: None)
    try:
        assert main(['map', 'compact', str(copied)]) == 2
        assert 'in use' in capsys.readouterr().err
    finally:
        store.close()


def test_prune_leaves_a_connected_map_in_which_the_robot_is_localised(
    bag: Path, copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = read_map(copied)
    before, _ = experience_map_of(saved, config_of_map(saved)[0])
    assert main(['map', 'prune', str(copied), '--max-experiences', '20']) == 0
    assert f'{len(before)} places before, 20 now' in capsys.readouterr().out
    assert read_map(f'{copied}.bak').digest == saved.digest
    assert main(['map', 'check', str(copied)]) == 0
    after = read_map(copied)
    graph, _ = experience_map_of(after, config_of_map(after)[0])
    assert len(graph) == 20
    assert graph.component_count == before.component_count == 1
    known = {tuple(pose) for pose in before.poses.tolist()}
    assert known >= {tuple(pose) for pose in graph.poses.tolist()}
    ends = graph.link_ends
    assert {0} | set(np.unique(ends).tolist()) == set(range(20))
    reached = {0}
    for _ in range(20):
        reached |= {b for a, b in [*ends.tolist(), *ends[:, ::-1].tolist()] if a in reached}
    assert len(reached) == 20
    digest = after.digest
    assert replayed(bag, copied.parent, '--quiet', '--localize') == 0
    summary = json.loads((copied.parent / 'results' / 'summary.json').read_text())
    assert summary['experiences'] == 20
    assert summary['loop_closures'] > 10
    assert read_map(copied).digest == digest


def test_prune_to_more_places_than_there_are_changes_nothing(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = copied.read_bytes()
    assert main(['map', 'prune', str(copied), '--max-experiences', '5000']) == 0
    assert 'nothing is pruned' in capsys.readouterr().out
    assert main(['map', 'prune', str(copied), '--max-experiences', '5']) == 2
    assert copied.read_bytes() == before


def test_replay_uses_the_configuration_of_the_map(
    bag: Path, copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copied.parent / 'results'
    words = ['replay', str(bag), '--map', str(copied), '--localize', '--out', str(folder),
             '--no-history']
    assert main(words) == 0
    assert 'nothing was learned, and the file is unchanged' in capsys.readouterr().out
    assert 'template_x_size: 16\n' in (folder / 'config.yaml').read_text()
    assert main([*words, '--set', 'local_view.template_x_size=24']) == 2
    assert 'has local_view.template_x_size 16, but 24 was given' in capsys.readouterr().err


def test_localise_without_map_is_one_line(bag: Path, refusal: Callable[..., str]) -> None:
    assert '--localize needs the map' in refusal('replay', str(bag), '--localize')


def test_backup_stays_if_the_map_is_continued_under_another_name(
    copied: Path, tmp_path: Path
) -> None:
    os.link(copied, tmp_path / 'other.map')
    assert main(['map', 'prune', str(copied), '--max-experiences', '25']) == 0
    before = Path(f'{copied}.bak').read_bytes()
    store = MapStore(tmp_path / 'other.map', ['goal_follower'], MapMeta(), print)
    store.cut(Cut(1, 1), {'goal_follower': {'n': 1}})
    store.close()
    assert Path(f'{copied}.bak').read_bytes() == before


@pytest.mark.parametrize(('module', 'words'), [
    (map_upkeep, ('compact', '{0}')),
    (map_pruning, ('prune', '{0}', '--max-experiences', '25')),
    (map_merging, ('merge', '{0}', '{1}', '-o', '{0}', '--force')),
])
def test_map_cannot_be_written_once_it_is_read_to_be_replaced(
    module: Any, words: tuple[str, ...], copied: Path, mapped: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr('ratslam_ros.maps.locks.OPENING_S', 0.1)
    read, refused = module.read_map, []

    def read_and_write(*args: Any, **options: Any) -> Any:
        saved = read(*args, **options)
        try:
            MapStore(copied, ['goal_follower'], MapMeta(), print).close()
        except UnusableInput:
            refused.append(args[0])
        return saved

    monkeypatch.setattr(module, 'read_map', read_and_write)
    assert main(['map', *(word.format(copied, mapped / 'a.map') for word in words)]) == 0
    assert copied in refused
    assert not Path(f'{copied}-lock').exists()


def test_interrupted_replay_prints_what_is_saved_and_how_to_continue(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    feed = _Run.feed

    def feed_and_interrupt(run: _Run, event: Any, image: Any) -> None:
        feed(run, event, image)
        if event.stamp_ns > START_NS + 2_000_000_000:
            signal.raise_signal(signal.SIGTERM)

    with monkeypatch.context() as patch:
        patch.setattr(_Run, 'feed', feed_and_interrupt)
        assert replayed(bag, tmp_path, '--quiet') == 130
    path = tmp_path / 'a.map'
    cut = read_map(path).cut
    assert cut is not None
    stamp = f'saved up to stamp {seconds(cut.stamp_ns)} s'
    line = capsys.readouterr().err.splitlines()[-1]
    assert f'{path} is {stamp}; give the same command again to continue' in line
    for action in ('info', 'check'):
        assert main(['map', action, str(path)]) == 0
        assert f'did not reach its end: the map is {stamp}' in ''.join(capsys.readouterr())
    assert replayed(bag, tmp_path, '--quiet') == 0
    capsys.readouterr()
    assert main(['map', 'check', str(path)]) == 0
    assert 'did not reach' not in capsys.readouterr().err
