# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Implementation of ``ratslam map info``, ``check`` and ``compact``."""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from ratslam_ros.core.common.state import STAGE
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.errors import RatslamError, UnusableInput
from ratslam_ros.files.config import stored_config
from ratslam_ros.maps import SavedMap, read_map
from ratslam_ros.maps.kept_log import kept_runs, remove_kept
from ratslam_ros.maps.locks import is_written
from ratslam_ros.maps.part import load, rows_of
from ratslam_ros.maps.reader import reading
from ratslam_ros.maps.saved_map import seconds
from ratslam_ros.maps.saving import as_one_file, locked
from ratslam_ros.maps.schema import NEW, WAL, beside, connect, sync_folder
from ratslam_ros.offline.replay_map import PROGRESS, session_titles, unfinished_note
from ratslam_ros.pipeline.choice import decided_odometry
from ratslam_ros.pipeline.ratslam import RatSLAM, head_of
from ratslam_ros.pipeline.stage import Stage

BACKUP = '.bak'


def config_of_map(saved: SavedMap) -> tuple[Config, list[str]]:
    """Return the configuration of a map, or the default one, and notices.

    Raises:
        UnusableInput: it is damaged.
    """
    if not saved.meta.configuration:
        return Config(), [f'{saved.path} does not contain its configuration; the default is used']
    return stored_config(saved.meta.configuration, str(saved.path))


def experience_map_of(saved: SavedMap, config: Config) -> tuple[ExperienceMap, int]:
    """Return the experience map, and the stamp of its last view in ns.

    Raises:
        UnusableInput: the map has no places, or they are damaged.
    """
    state = saved.states.get('experience_map', {})
    if 'core' not in state:
        raise UnusableInput(f'{saved.path} has no places: nothing of the experience map was saved')
    graph = ExperienceMap(config.experience_map)
    try:
        graph.restore(state['core'])
    except RatslamError:
        raise
    except Exception as error:  # The content can be anything.
        raise UnusableInput(
            f'{saved.path}: the experience map does not fit ({error!r}); use a backup'
        ) from None
    progress = saved.states.get('inputs', {}).get(PROGRESS, {})
    return graph, int(progress.get('last_view_ns', state.get('action_ns', 0)))


def map_info(path: Path) -> dict[str, Any]:
    """Return what is known of a map, by the names that are printed.

    Raises:
        UnusableInput: the file cannot be used.
    """
    saved = read_map(path)
    config, notices = config_of_map(saved)
    graph, _ = experience_map_of(saved, config)
    view = saved.states.get('local_view', {}).get('core', {})
    goals = saved.states.get('experience_map', {}).get('goals', {}).get('named', [])
    scans = saved.states.get('experience_map', {}).get('scans', {}).get('ids', [])
    default = Config().flat()
    changed = {key: value for key, value in config.flat().items() if default[key] != value}
    sizes = Counter(graph.components)
    return {
        'file': str(path),
        'bytes': sum(one.stat().st_size for one in _files(path)),
        'places': len(graph), 'links': graph.link_count,
        'components': sorted(sizes.values(), reverse=True),
        'templates': len(view.get('templates', ())), 'scans': len(scans), 'goals': len(goals),
        'sessions': session_titles(saved),
        'parts': sorted(saved.states),
        'own_stages': own_parts(saved),
        'decided_odometry': decided_odometry(saved.states),
        'saved_at': None if saved.cut is None else seconds(saved.cut.stamp_ns),
        'kept_logs': [run.described() for run in kept_runs(path)],
        'missing': [*saved.notes, *unfinished_note(saved)],
        'in_use': _in_use(path),
        'ratslam_version': saved.meta.ratslam_version,
        'parameters': changed,
        'notices': notices,
        'digest': saved.digest,
    }


def info_text(info: dict[str, Any]) -> str:
    """Format what ``map_info`` returned for a terminal."""
    components, places = info['components'], info['places']
    parts = 'in one part' if len(components) < 2 else (
        f'in {len(components)} parts of {", ".join(map(str, components))}, whose position '
        'relative to each other is unknown'
    )
    per_place = f', {info["bytes"] / places / 1e3:.1f} kB per place' if places else ''
    rows = [
        ('size', f'{info["bytes"] / 1e6:.2f} MB{per_place}'),
        ('places', f'{places} {parts}; {info["links"]} links'),
        ('templates', str(info['templates'])),
        *((name, str(info[name])) for name in ('scans', 'goals') if info[name]),
        ('sessions', f'{len(info["sessions"])}: {", ".join(info["sessions"])}'),
        ('parts', ', '.join(info['parts'])),
        *(('own stage', f'{part} of {kind}') for part, kind in info['own_stages'].items()),
        *(('odometry', f'{source}, decided by auto') for source in [info['decided_odometry']]
          if source),
        ('saved at', 'unknown' if info['saved_at'] is None else f'stamp {info["saved_at"]} s'),
        *(('missing', line) for line in info['missing'] or ['nothing']),
        *(('kept log', _log_text(log)) for log in info['kept_logs']),
        *(('in use', line) for line in [info['in_use']] if line),
        ('written by', f'ratslam_ros {info["ratslam_version"] or "of an unknown version"}'),
        ('parameters', f'{len(info["parameters"])} differ from the defaults; --parameters '
                       'prints all'),
        *(('notice', line) for line in info['notices']),
        ('digest', info['digest']),
    ]
    return '\n'.join([info['file'], *(f'  {name:12}{value}' for name, value in rows)])


def _log_text(log: Mapping[str, Any]) -> str:
    """Return what ``KeptRun.described`` has found, in one line."""
    end = '' if log['has_ended'] else ', without its end'
    return (
        f'{log["bytes"] / 1e6:.2f} MB: {log["inputs"]} inputs over {log["duration_s"]:.1f} s of '
        f'{", ".join(log["parts"])}{end}'
    )


def drop_log(path: Path) -> str:
    """Remove the logs that were kept beside a map; return what has been done.

    Raises:
        UnusableInput: there is no such map, it is in use, or the logs cannot be removed.
    """
    if not kept_runs(path):
        if not path.exists():
            raise UnusableInput(f'{path} does not exist; expected a map file')
        return f'{path}: no log is kept'
    with locked(path):
        size = remove_kept(path)
    return f'{path}: {size / 1e6:.2f} MB of kept logs removed; the map is unchanged'


def problems(path: Path, stages: Sequence[type[Stage]] = ()) -> tuple[list[str], list[str]]:
    """Check a map: the database, every saved state, and whether the newest one can be used.

    Args:
        path: the map file.
        stages: stages of your own that have saved parts of it.

    Returns:
        Problems and notices, in one line each.

    Raises:
        UnusableInput: there is no such file.
    """
    if not path.exists():
        raise UnusableInput(f'{path} does not exist; expected a map file')
    found: list[str] = []
    try:
        found += reading(path, lambda database: _database_problems(database, path))
        saved = read_map(path)
        given = {stage.NAME for stage in stages}
        own = {part: kind for part, kind in own_parts(saved).items() if part not in given}
        if saved.states:
            restored(saved, stages, without=own)
    except RatslamError as error:
        return [*found, str(error)], []
    notices = [f'{path}: {note}' for note in [*saved.notes, *unfinished_note(saved)]]
    notices += [
        f'{path}: {part} is of a stage of yours, and only its checksum was checked: give --stage '
        f'FILE:{kind} to restore it'
        for part, kind in own.items()
    ]
    in_use = _in_use(path)
    if in_use:
        notices.append(f'{path}: {in_use}')
    return found, notices


def own_parts(saved: SavedMap) -> dict[str, str]:
    """Return the class of the stage of the user that has saved a part, for each such part."""
    return {part: state[STAGE] for part, state in saved.states.items() if STAGE in state}


def restored(
    saved: SavedMap, stages: Sequence[type[Stage]] = (), without: Container[str] = ()
) -> RatSLAM:
    """Restore a map into a new system.

    Args:
        saved: the map.
        stages: stages of the user.
        without: parts that are left out.

    Raises:
        UnusableInput: it does not fit.
    """
    config = config_of_map(saved)[0]
    try:
        slam = RatSLAM(config, head_of(saved.states), stages=stages)
        slam.restore({
            part: state for part, state in saved.states.items() if part not in without
        })
    except RatslamError as error:
        raise UnusableInput(f'{saved.path} cannot be restored: {error}') from None
    except Exception as error:  # The content can be anything.
        raise UnusableInput(f'{saved.path} cannot be restored ({error!r})') from None
    return slam


def _database_problems(database: sqlite3.Connection, path: Path) -> list[str]:
    found = [
        f'{path}: {text}' for (text,) in database.execute('PRAGMA quick_check') if text != 'ok'
    ]
    for row in rows_of(database, '1', []):
        try:
            load(database, row)
        except UnusableInput as error:
            found.append(
                f'{path}: {row.part} at stamp {seconds(row.stamp_ns)} s is damaged: {error}'
            )
    return found


def _files(path: Path) -> list[Path]:
    return [file for file in (path, beside(path, WAL)) if file.exists()]


def _in_use(path: Path) -> str:
    """Return why there is more than one file, '' if there is one."""
    if not beside(path, WAL).exists():
        return ''
    if is_written(path):
        return f'a program writes it now; until it ends, {path.name}{WAL} belongs to the map'
    return (
        f'the last program did not end properly, so {path.name}{WAL} belongs to the map: keep '
        'both files together; the next use of the map makes one of them'
    )


def compact(path: Path) -> str:
    """Rewrite a map without unused space; return what has been done.

    The map before stays as FILE.bak. At any moment there is a complete map under its name.

    Raises:
        UnusableInput: the map is in use or damaged, or the folder cannot be written.
    """
    with locked(path):
        digest = read_map(path, owned=True).digest
        before = sum(one.stat().st_size for one in _files(path))
        backup = make_backup(path)
        with closing(connect(path)) as database:
            database.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 1)  # VACUUM attaches the new file.
            database.execute('VACUUM')  # in one transaction
        as_one_file(path)
        if read_map(path, owned=True).digest != digest:
            raise UnusableInput(f'{path} was not copied exactly; use {backup}, check the disk')
    after = path.stat().st_size
    return (
        f'{path}: {before / 1e6:.2f} MB before, {after / 1e6:.2f} MB now; the map before is '
        f'{backup}'
    )


def make_backup(path: Path) -> Path:
    """Keep a map as FILE.bak too, in one complete file.

    An earlier backup stays until the new one is complete. The caller has locked the map.

    Raises:
        UnusableInput, OSError, sqlite3.Error: the map cannot be read, or the folder written.
    """
    as_one_file(path)
    backup, fresh = beside(path, BACKUP), beside(path, f'{BACKUP}{NEW}')
    fresh.unlink(missing_ok=True)
    shutil.copyfile(path, fresh)  # A hard link would change with a map of another name.
    with fresh.open('rb') as file:
        os.fsync(file.fileno())
    os.replace(fresh, backup)
    sync_folder(path)
    return backup
