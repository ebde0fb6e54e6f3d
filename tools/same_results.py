# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check that a refactoring changed no result: run two versions and compare what they write.

    python tools/same_results.py BASE [--quick] [--additions] [--only NAME ...] [--tree DIR]

BASE is a commit. The other version is the working tree, uncommitted changes included. Both are
copied into the cache folder and run there by the commands and topics of the program only, because
module names may change. Maps, trajectories, frames, configurations, memory files, payloads,
parameters, topics, services and exit codes must be identical; wording and timings are ignored.
With --additions, the working tree may have further parameters, options, topics and keys of
summary.json and of memory files; maps, trajectories and frames must still be identical.

The results of BASE are kept in the cache, so that later runs only run the working tree. The first
run of a version compiles for about 20 s. The exit code is 0 if all cases agree, 1 if one does
not, and 2 if the tool was used wrongly.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import fcntl
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from fnmatch import fnmatch
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from live_session import LiveError, LiveSession, Observer

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'ratslam_ros'
COMPILED = (f'{PACKAGE}/core', 'ratslam_simulator', 'ratslam_tuning')
"""Folders with compiled functions, and with all that they use."""

ENTRY = f'import sys; from {PACKAGE}.cli import main; sys.exit(main())'
WITH_CAMERA = '--odometry', 'camera'
WORKERS = 2
COMMAND_TIMEOUT_S = 300.0
CONTEXT_CHARACTERS = 60
KEPT_COUNT = 12
"""Compiled versions and BASE commits that stay in the cache, the newest ones."""

SAME, DIFFERENT, WRONG_USE = 0, 1, 2

FAILURE = 'FAILURE'
"""Name of the output that holds why a case could not be run."""

TIMING_KEYS = {'wall_s', 'times_realtime', 'step_ms'}
"""Keys of summary.json that depend on the speed of the machine."""

EXACT_FILES = ('*.tum', 'frames.csv', 'trials.csv')
"""Result files that are compared byte by byte."""

GROWING_FILES = (
    'config.yaml', 'summary.json', 'options-*.txt', 'config/*.yaml', '*endpoints.txt',
    '*_parameters.json', '*_parameters.yaml',
)
"""Outputs that may have further lines in the working tree with --additions."""


class CaseError(Exception):
    """A command of a case did not do what it must do in every version."""


class UsageError(Exception):
    """The arguments do not name something that can be compared."""


# Versions of the program


@dataclass(frozen=True)
class Version:
    """One version of the program, and where its outputs go.

    ``inputs`` holds the recordings that BASE simulated; both versions replay these.
    """

    name: str
    tree: Path
    outputs: Path
    inputs: Path
    data: Path
    compiled: Path

    def environment(self) -> dict[str, str]:
        """Return the environment that makes Python use this version."""
        keep = {k: v for k, v in os.environ.items() if not k.startswith(('ROS_', 'RATSLAM_'))}
        return {
            **keep, 'PYTHONPATH': str(self.tree), 'NUMBA_CACHE_DIR': str(self.compiled),
            'PYTHONUNBUFFERED': '1', 'PYTHONHASHSEED': '0',
        }

    def check_import(self) -> None:
        """Raise UsageError unless Python imports the package from this version's folder."""
        code = f'import {PACKAGE}; print({PACKAGE}.__file__)'
        done = subprocess.run(
            [sys.executable, '-c', code], env=self.environment(), cwd=self.outputs,
            capture_output=True, text=True, check=False,
        )
        if not done.stdout.startswith(str(self.tree)):
            found = done.stdout.strip() or done.stderr.strip()
            raise UsageError(f'{PACKAGE} was imported from {found}; expected {self.tree}')


def git(*arguments: str, folder: Path) -> bytes:
    """Return what a git command prints; raise UsageError if it fails."""
    done = subprocess.run(['git', *arguments], cwd=folder, capture_output=True, check=False)
    if done.returncode:
        raise UsageError(f'git {" ".join(arguments)}: {done.stderr.decode().strip()}')
    return done.stdout


def extract_commit(commit: str, repository: Path, folder: Path) -> None:
    """Write the files of a commit; their modification time is that of the commit."""
    if folder.is_dir():
        return
    fresh = folder.with_name(f'{folder.name}.part')
    shutil.rmtree(fresh, ignore_errors=True)
    with tarfile.open(fileobj=io.BytesIO(git('archive', commit, folder=repository))) as archive:
        archive.extractall(fresh, filter='data')
    fresh.rename(folder)


def copy_working_tree(tree: Path, folder: Path) -> None:
    """Copy all files that git does not ignore; keep unchanged files, remove others.

    Edits that are made while the cases run then have no effect.
    """
    listed = git('ls-files', '-z', '--cached', '--others', '--exclude-standard', folder=tree)
    names = {name for name in listed.decode().split('\0') if name and (tree / name).is_file()}
    for path in sorted(folder.rglob('*'), reverse=True):
        if path.is_dir():
            with contextlib.suppress(OSError):
                path.rmdir()
        elif path.relative_to(folder).as_posix() not in names:
            path.unlink()
    for name in sorted(names):
        source, target = tree / name, folder / name
        if target.is_file() and _stamp(source) == _stamp(target):
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source, target)


def _stamp(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_mtime_ns, status.st_size


def compiled_key(tree: Path) -> str:
    """Return a hash of the code that compiled functions depend on.

    Numba notices a change in the file of the function that it compiled, but not in the functions
    and constants that this function uses. Therefore every key has a compilation cache of its own.
    """
    files = [path for folder in COMPILED for path in sorted((tree / folder).rglob('*.py'))]
    return _hash(b''.join(path.read_bytes() for path in files))


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def forget_old(folder: Path, kept: Sequence[Path] = ()) -> None:
    """Remove all but the most recently used entries of a cache folder."""
    entries = sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in entries[KEPT_COUNT:]:
        if path not in kept:
            shutil.rmtree(path, ignore_errors=True)


# Running one case


class Run:
    """One case in one version: runs its commands and keeps its outputs."""

    def __init__(self, version: Version, name: str, temporary: Path) -> None:
        self.version = version
        self.folder = version.outputs / name
        self.work = temporary

    def input(self, name: str) -> Path:
        """Return the recording that a case of BASE made."""
        return self.version.inputs / name

    def data(self, name: str) -> Path:
        """Return a real recording."""
        return self.version.data / name

    def command(self, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
        """Run a command to its end, whatever its exit code."""
        words = list(map(str, arguments))
        try:
            return subprocess.run(
                [sys.executable, '-c', ENTRY, *words], env=self.version.environment(),
                cwd=self.work, capture_output=True, text=True, stdin=subprocess.DEVNULL,
                timeout=COMMAND_TIMEOUT_S, check=False,
            )
        except subprocess.TimeoutExpired:
            raise CaseError(
                f'ratslam {" ".join(words)}: not finished after {COMMAND_TIMEOUT_S:.0f} s'
            ) from None

    def ratslam(self, *arguments: str | Path) -> str:
        """Run a command that must succeed; return what it prints."""
        done = self.command(*arguments)
        if done.returncode:
            raise CaseError(
                f'ratslam {" ".join(map(str, arguments))}: exit code {done.returncode}\n'
                f'{done.stderr.strip()[-2000:]}'
            )
        return done.stdout

    def keep(self, name: str, text: str) -> None:
        """Keep an output for comparison."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding='utf-8')

    def keep_results(self, folder: Path, into: str = '') -> None:
        """Keep the files of a results folder, without comments and timings."""
        prefix = f'{into}/' if into else ''
        for pattern in EXACT_FILES:
            for path in sorted(folder.glob(pattern)):
                self.keep(prefix + path.name, path.read_text(encoding='utf-8'))
        for path in sorted(folder.glob('*.yaml')):
            self.keep(prefix + path.name, without_comments(path.read_text(encoding='utf-8')))
        for path in sorted(folder.glob('*.json')):
            self.keep(prefix + path.name, json_values(path.read_text(encoding='utf-8')))

    def replay(self, recording: Path, *arguments: str | Path, into: str = '') -> None:
        """Replay a recording and keep its results."""
        folder = self.work / f'replay-{into}'
        self.ratslam('replay', recording, '--quiet', '--out', folder, *arguments)
        for name in ('map.json', 'frames.csv', 'trajectory_final.tum', 'config.yaml'):
            if not (folder / name).is_file():
                raise CaseError(f'replay wrote no {name}')
        self.keep_results(folder, into)


def without_comments(text: str) -> str:
    """Return a YAML text without comments and empty lines; values and order stay."""
    lines = (re.sub(r'(^|\s)#.*$', '', line).rstrip() for line in text.splitlines())
    return '\n'.join(line for line in lines if line) + '\n'


def without_timings(value: Any) -> Any:
    """Return a JSON value without the keys that depend on the speed of the machine."""
    if isinstance(value, dict):
        return {k: without_timings(v) for k, v in value.items() if k not in TIMING_KEYS}
    if isinstance(value, list):
        return [without_timings(item) for item in value]
    return value


def json_values(text: str) -> str:
    """Return a JSON text without timings and with the numbers formatted by json."""
    return json.dumps(without_timings(json.loads(text)), indent=1) if text else ''


def describe_recording(folder: Path) -> str:
    """Return a line for every topic of a rosbag2 folder: type, number and hash of messages."""
    from rosbags.rosbag2 import Reader

    topics: dict[str, Any] = {}
    with Reader(folder) as reader:
        for connection, stamp_ns, data in reader.messages():
            entry = topics.setdefault(connection.topic, [connection.msgtype, 0, hashlib.sha256()])
            entry[1] += 1
            entry[2].update(stamp_ns.to_bytes(8, 'little', signed=True))
            entry[2].update(data)
    if not topics:
        raise CaseError(f'{folder.name} has no messages')
    return ''.join(
        f'{topic} {kind} {count} {digest.hexdigest()}\n'
        for topic, (kind, count, digest) in sorted(topics.items())
    )


def describe_memory(path: Path) -> str:
    """Return a line for each part that a node saved: its name, and the digest of its state."""
    from ratslam_ros.maps import read_map

    digests = read_map(path).digests
    return ''.join(f'{part} {digest.hex()}\n' for part, digest in sorted(digests.items()))


# The cases


@dataclass(frozen=True)
class Case:
    """Commands that both versions run.

    ``needs`` is a real recording. A case that differs runs again in both versions until ``tries``
    are used up: on a busy machine, live nodes that are not scheduled for seconds lose their order
    of messages. A changed result differs in every try. ``since`` is a file that BASE must have, or
    the case is skipped.
    """

    name: str
    run: Callable[[Run], None]
    quick: bool = False
    needs: str = ''
    tries: int = 1
    since: str = ''


FLOOR = 'floor'
FLOOR_TOPICS = ('--scan-topic', '/scan')


def setting(text: str) -> tuple[str, str]:
    """Return the arguments that set one parameter."""
    return '--set', text


def replayed(recording: str, *arguments: str) -> Callable[[Run], None]:
    """Return a case that replays a recording of BASE."""
    return lambda run: run.replay(run.input(recording), *arguments)


def replayed_data(name: str, *arguments: str) -> Callable[[Run], None]:
    """Return a case that replays a real recording."""
    return lambda run: run.replay(run.data(name), *arguments)


def simulated(recording: str, *arguments: str) -> Callable[[Run], None]:
    """Return a case that simulates a robot; a recording becomes an input of other cases."""

    def run_case(run: Run) -> None:
        folder, recorded = run.work / 'out', run.work / (recording or 'recording')
        run.ratslam('simulate', '--quiet', '--out', folder, '--record', recorded, *arguments)
        run.keep_results(folder)
        keep_recording(run, recorded, recording)

    return run_case


def keep_recording(run: Run, folder: Path, name: str) -> None:
    """Keep a description of a recording, and in BASE the recording itself if it has a name."""
    run.keep('recording.txt', describe_recording(folder))
    if name and run.version.name == 'BASE':
        target = run.version.inputs / name
        shutil.rmtree(target, ignore_errors=True)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(folder, target)


def demo(run: Run) -> None:
    """Run the demo."""
    folder = run.work / 'demo'
    run.ratslam('demo', '--quiet', '--out', folder, '--config', 'pioneer')
    run.keep_results(folder)
    keep_recording(run, folder / 'recording', '')
    truth = folder / 'recording' / 'truth.tum'
    for name in ('trajectory', 'trajectory_final', 'dead_reckoning'):
        for align in ('se2', 'sim2', 'none') if name == 'trajectory' else ('se2',):
            text = run.ratslam(
                'evaluate', folder / f'{name}.tum', truth, '--json', '--align', align,
                '--plot', run.work / 'errors.png',
            )
            run.keep(f'errors-{name}-{align}.json', text)


def exp_max(run: Run) -> None:
    """Replay with a limit to the number of experiences that is certainly reached."""
    recording, limit = run.input(FLOOR), 100
    run.replay(recording, '--config', 'navigation', *setting(f'pose_cells.exp_max={limit}'))
    made = {
        line.rsplit(',', 1)[-1]
        for line in (run.folder / 'frames.csv').read_text().splitlines()[1:]
    }
    if len(made - {'-1'}) < limit:
        raise CaseError(f'{len(made)} experiences were visited; expected at least {limit}')


INI = """[local_view]
vt_match_threshold=0.05
template_x_size=20
template_y_size=10
[pose_cells]
pc_dim_xy=31
pc_vt_inject_energy=0.2
[experience_map]
exp_loops=7
exp_initial_em_deg=140
[draw]
enable=1
"""


def ini(run: Run) -> None:
    """Replay with a partial configuration of OpenRatSLAM."""
    path = run.work / 'robot.ini'
    path.write_text(INI, encoding='utf-8')
    run.replay(run.input(FLOOR), '--config', path)


def exit_codes(run: Run) -> None:
    """Compare the exit codes of right and wrong uses."""
    recording = str(run.input(FLOOR))
    missing = str(run.work / 'missing')
    right = [
        ('--version',), ('--help',), ('info', recording),
    ]
    wrong = [
        (), ('no_such_command',), ('info', missing), ('replay', missing), ('play', missing),
        ('replay', recording, '--config', 'no_such_preset'),
        ('replay', recording, '--set', 'local_view.vt_match_threshold=2000'),
        ('replay', recording, '--set', 'local_view.no_such_parameter=1'),
        ('replay', recording, '--set', 'local_view.template_x_size=many'),
        ('replay', recording, '--image-topic', '/no_such_topic'),
        ('replay', recording, '--start', '-5'),
        ('evaluate', missing, missing), ('plot', missing),
        ('simulate', '--plan', 'no_such_plan'), ('simulate', '--goals', 'no_such_place'),
        ('simulate', '--obstacle', 'box'), ('simulate', '--explore', 'nan'),
        ('demo', '--seed', '-1'),
        ('run', 'no_such_node'), ('run', 'pose_cells', '--ros-args', '-p', 'pc_dim_th:=-3'),
        ('call', 'a_service', 'no_such/srv/Type'), ('echo', 'a_topic', 'no_such/msg/Type'),
    ]
    codes = []
    for expected, uses in ((True, right), (False, wrong)):
        for use in uses:
            code = run.command(*use).returncode
            words = ' '.join(use).replace(recording, 'RECORDING').replace(missing, 'MISSING')
            codes.append(f'{code} ratslam {words}')
            if (code == 0) is not expected:
                run.keep('exit_codes.txt', '\n'.join(codes) + '\n')
                raise CaseError(f'ratslam {words}: exit code {code}')
    run.keep('exit_codes.txt', '\n'.join(codes) + '\n')


COMMANDS = (
    'info', 'replay', 'demo', 'simulate', 'evaluate', 'plot', 'tune', 'run', 'launch', 'play',
    'call', 'echo',
)


def options(run: Run) -> None:
    """Compare the options of all commands, and the values of all presets."""
    for command in COMMANDS:
        text = run.ratslam(command, '--help')
        found = re.findall(r'^\s+(?:-\w(?: \S+)?, )?(--[a-z-]+)', text, re.MULTILINE)
        run.keep(f'options-{command}.txt', '\n'.join(found) + '\n')
    for path in sorted((run.version.tree / 'config').glob('*.yaml')):
        run.keep(f'config/{path.name}', values_of(run, path.stem))
    run.keep('config/none.yaml', values_of(run, None))


def values_of(run: Run, preset: str | None) -> str:
    """Return the values of all parameters with a preset, or None for no configuration."""
    code = f"""
from {PACKAGE}.files.config import load_config, to_yaml
print(to_yaml(load_config({preset!r})[0]))
"""
    return subprocess.run(
        [sys.executable, '-c', code], env=run.version.environment(), cwd=run.work,
        capture_output=True, text=True, check=True,
    ).stdout


FLOOR_SCENE = ('--plan', 'obstacle_loop', '--explore', '0.7', '--goals', 'X,G', '--seed', '3')
OBSTACLE_SCENE = (
    '--plan', 'obstacle_loop', '--explore', '0.8', '--random-goals', '1', '--seed', '5',
    '--people', '2', '--noise', '1.5', '--obstacle', 'box,8,2,0.8,1,20,90',
)
SPAN = ('--duration', '60')
PRESETS = {
    # The crops of these presets are for larger images than those of the simulated camera.
    'irat': ('local_view.image_crop_y_max=40',),
    'stlucia': (
        'local_view.image_crop_x_min=5', 'local_view.image_crop_x_max=75',
        'local_view.image_crop_y_min=15', 'local_view.image_crop_y_max=40',
    ),
    'newcollege': (),
    'camera_navigation': (),
    'corridor': (),
    'lecture_hall': (),
    'openratslam': (),
    'milford2005': (),
    'milford2006': (),
    'milford2006_small': (),
}
NAVIGATION = ('--config', 'navigation')
EXTENDED = ('--config', 'extended')


LIVE_TRIES = 3
SETTLE_TIMEOUT_S = 60.0
FLUSHED_S = 4.0
"""Nodes process messages that they held back after flush_after_s, 2 s, of silence."""
LEARNERS = ('local_view', 'pose_cells', 'experience_map')
TRIGGER = 'std_srvs/srv/Trigger'
STREAMED = (
    'local_view/template', 'pose_cells/action', 'pose_cells/active_experiences',
    'pose_cells/goal_memory',
)
LIVE_CONFIG = (
    *NAVIGATION, *setting('experience_map.exp_align_scans=false'),
    *setting('goal_memory.goal_memory=true'),
)
BEFORE_MARK = ('--duration', '15')
AFTER_MARK = ('--start', '15', '--duration', '15')
BEFORE_SAVE = ('--duration', '30')
AFTER_SAVE = ('--start', '30', '--duration', '30')


def live(run: Run) -> None:
    """Play a recording to live nodes; save in the middle, go on, load and go on once more.

    The map before saving must be the map of a replay, and so must be the one at the end.
    """
    recording, parts = run.input(FLOOR), (BEFORE_SAVE, AFTER_SAVE)
    memory = run.work / 'memory'
    folders = [f'{node}.memory_folder={memory}' for node in LEARNERS]
    config = [*LIVE_CONFIG, *(word for text in folders for word in setting(text))]
    run.ratslam('replay', recording, *LIVE_CONFIG, *parts[0], '--quiet', '--out', run.work / 'out')
    expected = (run.work / 'out' / 'map.json').read_text()
    images = (run.work / 'out' / 'frames.csv').read_text().count('\n') - 1
    with session(run) as nodes:
        nodes.start('launch', 'launch', *config, ready=3)
        observer = nodes.observe()
        run.keep('endpoints.txt', '\n'.join(observer.endpoints()) + '\n')
        nodes.play(recording, *BEFORE_MARK)
        time.sleep(FLUSHED_S)
        for service in ('pose_cells/mark_goal', 'experience_map/name_place'):
            run.keep(f'{service}.yaml', nodes.call(service, TRIGGER))
        nodes.play(recording, *AFTER_MARK)
        time.sleep(FLUSHED_S)
        found = settled(observer, lambda text: text == expected)
        run.keep('live_map_before_save.json', json_values(found))
        if found != expected:
            raise CaseError('the live map is not the map of a replay')
        check_complete(observer.received(), images)
        for service in ('experience_map/list_goals', 'experience_map/temporal_map'):
            run.keep(f'{service}.yaml', nodes.call(service, TRIGGER))
        run.keep('recall_goal.yaml', nodes.call(
            'experience_map/recall_goal', 'nav_msgs/srv/GetPlan', RECALL))
        save(run, nodes, memory, 'saved')
        observer.publish('pose_cells/goal', 'goal_1')
        nodes.play(recording, *parts[1])
        time.sleep(FLUSHED_S)
        observer.publish('experience_map/goal', '{"name": "place_1"}')
        keep_received(run, observer, '', 2 * images)
        run.keep('exit_code.txt', f'{nodes.stop("launch")}\n')
    with session(run) as nodes:
        nodes.start('launch', 'launch', *config, ready=3)
        observer = nodes.observe()
        for node in LEARNERS:
            run.keep(f'{node}/load.txt', success(nodes.call(f'{node}/load', TRIGGER)))
        nodes.play(recording, *parts[1])
        keep_received(run, observer, 'loaded/', images)
        save(run, nodes, memory, 'saved_again')
        run.keep('exit_code_2.txt', f'{nodes.stop("launch")}\n')


RECALL = '{goal: {header: {frame_id: map}, pose: {position: {x: 0.0, y: 0.5}}}, tolerance: 5.0}'


def live_camera(run: Run) -> None:
    """Play images only to all nodes in one process: the map must be that of a replay."""
    recording, part = run.input(FLOOR), BEFORE_SAVE
    config = ('--config', 'pioneer')
    run.ratslam('replay', recording, *config, *part, '--visual-odometry', '--quiet', '--out',
                run.work / 'out')
    expected = (run.work / 'out' / 'map.json').read_text()
    with session(run) as nodes:
        nodes.start('launch', 'launch', *config, *setting('goal_memory.goal_memory=true'),
                    *WITH_CAMERA, ready=4)
        observer = nodes.observe()
        nodes.play(recording, *part, '--visual-odometry')
        found = settled(observer, lambda text: text == expected)
        run.keep('live_map.json', json_values(found))
        if found != expected:
            raise CaseError('the live map is not the map of a replay')
        images = (run.work / 'out' / 'frames.csv').read_text().count('\n') - 1
        keep_received(run, observer, '', images)
        run.keep('exit_code.txt', f'{nodes.stop("launch")}\n')


PARAMETER_SERVICE = re.compile(r'^\d+ subscriber rq/(\S+)/list_parametersRequest ')


def graph(run: Run) -> None:
    """Start all nodes, then the simulated robot: compare topics, services and parameters."""
    with session(run) as nodes:
        nodes.start(
            'launch', 'launch', *EXTENDED, *WITH_CAMERA, '--goal-follower', ready=5
        )
        keep_graph(run, nodes, 'nodes', 5)
    with session(run) as nodes:
        nodes.start('robot', 'simulate', '--live', '--plan', 'obstacle_loop')
        keep_graph(run, nodes, 'robot', 1)


def keep_graph(run: Run, nodes: LiveSession, folder: str, count: int) -> None:
    """Keep the endpoints of running nodes, and their parameters."""
    observer = nodes.observe('--endpoints-only')
    endpoints = stable(observer.endpoints)
    run.keep(f'{folder}/endpoints.txt', '\n'.join(endpoints) + '\n')
    names = [match[1] for line in endpoints if (match := PARAMETER_SERVICE.match(line))]
    if len(names) != count:
        raise CaseError(f'nodes with parameters: {names}; expected {count}')
    kind = 'rcl_interfaces/srv'
    for name in names:
        listed = nodes.call(f'{name}/list_parameters', f'{kind}/ListParameters')
        run.keep(f'{name}/list_parameters.yaml', listed)
        parameters = re.findall(r'^  - (\S+)$', listed, re.MULTILINE)
        if len(parameters) < 5:
            raise CaseError(f'{name} has the parameters {parameters}; expected more')
        request = json.dumps({'names': parameters})
        for service in ('GetParameters', 'DescribeParameters'):
            snake = re.sub(r'(?<!^)([A-Z])', r'_\1', service).lower()
            text = nodes.call(f'{name}/{snake}', f'{kind}/{service}', request)
            run.keep(f'{name}/{snake}.json', without_descriptions(text))


def without_descriptions(text: str) -> str:
    """Return a YAML text without the values of `description` and `additional_constraints`."""
    import yaml

    def cleaned(value: Any) -> Any:
        if isinstance(value, dict):
            return {
                key: cleaned(item) for key, item in value.items()
                if key not in ('description', 'additional_constraints')
            }
        return [cleaned(item) for item in value] if isinstance(value, list) else value

    return json.dumps(cleaned(yaml.safe_load(text)), indent=1)


@contextlib.contextmanager
def session(run: Run) -> Iterator[LiveSession]:
    """Run nodes of this version."""
    with LiveSession(ENTRY, run.version.environment(), run.work) as nodes:
        yield nodes


def stable(found: Callable[[], list[str]]) -> list[str]:
    """Return a list of endpoints once it has been the same for two seconds."""
    last, since_s = found(), time.monotonic()
    end_s = since_s + SETTLE_TIMEOUT_S
    while time.monotonic() < min(since_s + 2.0, end_s):
        time.sleep(0.2)
        if (now := found()) != last:
            last, since_s = now, time.monotonic()
    return last


def settled(observer: Observer, is_final: Callable[[str], bool]) -> str:
    """Return the last map, as soon as it is final or time is up."""
    end_s = time.monotonic() + SETTLE_TIMEOUT_S
    while not is_final(observer.last('experience_map/map')) and time.monotonic() < end_s:
        time.sleep(0.1)
    return observer.last('experience_map/map')


def check_complete(received: Mapping[str, Sequence[str]], images: int) -> None:
    """Raise CaseError unless there is a template and an action for each image."""
    for topic in ('local_view/template', 'pose_cells/action'):
        count = len(received.get(topic, ()))
        if count != images:
            raise CaseError(f'{count} messages of {topic}; expected {images}')


def keep_received(run: Run, observer: Observer, prefix: str, images: int) -> None:
    """Keep the streams, the last map and the last status, once the map holds the last action."""
    def stamp(text: str) -> Any:
        return json.loads(text)['stamp'] if text else None

    settled(observer, lambda text: stamp(text) == stamp(observer.last('pose_cells/action')))
    time.sleep(FLUSHED_S)
    map_json, status = observer.last('experience_map/map'), observer.last('experience_map/status')
    received = observer.end()
    check_complete(received, images)
    for topic in STREAMED:
        if lines := received.get(topic):
            run.keep(f'{prefix}{topic}.txt', '\n'.join(map(without_sender, lines)) + '\n')
    poses = received['experience_map/pose']
    run.keep(f'{prefix}experience_map/pose.txt', stamps_and_last(poses))
    run.keep(f'{prefix}map.json', json_values(map_json))
    # The last change of the status may come with either of the last two odometry messages.
    run.keep(f'{prefix}status.json', re.sub(r'"stamp":\{.*?\},', '', status, count=1))


def without_sender(payload: str) -> str:
    """Return a template or an action without the number that its node has drawn at the start."""
    return re.sub(r',"sender":\d+', '', payload)


def stamps_and_last(lines: Sequence[str]) -> str:
    """Return the stamps and frames of all poses, and the last pose with 6 decimals.

    Whether a pose was computed before or after the action of the same stamp came depends on
    timing. Only the last pose, for which nothing more comes, is certain.
    """
    stamps = sorted({line.partition(' (')[0] for line in lines})
    numbers = ast.literal_eval(lines[-1].partition(' ')[2].partition(' ')[2])
    last = ' '.join(f'{number + 0.0:.6f}' for number in numbers)
    return '\n'.join([*stamps, last]) + '\n'


def save(run: Run, nodes: LiveSession, memory: Path, name: str) -> None:
    """Save what the nodes have learned, and keep it."""
    for node in LEARNERS:
        run.keep(f'{name}/{node}.answer', success(nodes.call(f'{node}/save', TRIGGER)))
    for path in sorted(memory.iterdir()):
        run.keep(f'{name}/{path.name}.txt', describe_memory(path))


def success(answer: str) -> str:
    """Return whether a service succeeded; raise CaseError if it did not."""
    if 'success: true' not in answer:
        raise CaseError(f'a service answered {answer}')
    return 'success: true\n'


def goal_memory_trial(run: Run) -> None:
    """Run the goal memory experiment of the benchmarks, with one seed; compare its numbers."""
    done = subprocess.run(
        [sys.executable, str(run.version.tree / 'benchmarks' / 'navigation.py'), 'goal_memory',
         '--seeds', '1', '--minutes', '1.5', '--out', str(run.work / 'out')],
        env=run.version.environment(), cwd=run.work, capture_output=True, text=True, check=False,
        timeout=COMMAND_TIMEOUT_S,
    )
    rows = [line for line in done.stdout.splitlines() if re.match(r' *(\d+|all) +\w', line)]
    rows = [row for row in rows if len(row.split()) > 4]
    if done.returncode or len(rows) < 4:
        raise CaseError(f'exit code {done.returncode}\n{done.stdout}\n{done.stderr[-2000:]}')
    run.keep('table.txt', '\n'.join(' '.join(row.split()) for row in rows) + '\n')


def all_cases() -> list[Case]:
    """Return the cases; the one that makes the recording of others is first, then the longest."""
    cases = [
        Case('goals', simulated(FLOOR, *FLOOR_SCENE), quick=True),
        Case('live', live, tries=LIVE_TRIES),
        Case('demo', demo),
        Case('live_camera', live_camera, tries=LIVE_TRIES),
        Case('graph', graph, tries=LIVE_TRIES),
        Case('obstacle', simulated('', *OBSTACLE_SCENE)),
        Case('goal_memory_trial', goal_memory_trial),
        Case('exit_codes', exit_codes, quick=True),
        Case('options', options, quick=True),
        Case('scans', replayed(FLOOR, *NAVIGATION, *FLOOR_TOPICS), quick=True),
        Case('pruning', exp_max, quick=True),
        Case('sweep', replayed(
            FLOOR, *NAVIGATION, *setting('experience_map.exp_relaxation=sweep')), quick=True),
        Case('preset_pioneer', replayed(FLOOR, '--config', 'pioneer'), quick=True),
        Case('extended', replayed(FLOOR, *EXTENDED), quick=True),
        Case('default', replayed(FLOOR)),
        Case('ini', ini, quick=True),
        Case('goal_memory', replayed(
            FLOOR, *NAVIGATION, *setting('goal_memory.goal_memory=true')), quick=True),
        Case('visual_odometry', replayed(FLOOR, *EXTENDED, '--visual-odometry', *SPAN)),
    ]
    for name, values in PRESETS.items():
        words = [word for value in values for word in setting(value)]
        run = replayed(FLOOR, '--config', name, *SPAN, *words)
        cases.append(Case(f'preset_{name}', run, since=f'config/{name}.yaml'))
    for name, folder in (('rc_car', 'rc_car_loops'), ('donkeycar', 'donkeycar_track')):
        run = replayed_data(folder, '--config', name, '--duration', '45')
        cases.append(Case(f'preset_{name}', run, needs=folder))
    return cases


# Comparing


def first_difference(base: Path, tree: Path, additions: bool = False) -> str | None:
    """Return where the outputs of a case differ first, None if they are equal.

    Args:
        base, tree: folders with the outputs of both versions.
        additions: whether the working tree may have further lines in `GROWING_FILES`.
    """
    outputs = [_outputs(folder) for folder in (base, tree)]
    for side, files in zip(('BASE', 'the working tree'), outputs, strict=True):
        if FAILURE in files:
            return f'failed in {side}: {files[FAILURE].read_text(encoding="utf-8")}'
        if not files:
            return f'there is nothing to compare: no output of {side}'
    for name in sorted(outputs[0].keys() | outputs[1].keys()):
        if name not in outputs[1]:
            return f'{name}: only in BASE'
        growing = additions and any(fnmatch(name, pattern) for pattern in GROWING_FILES)
        if name not in outputs[0]:
            if growing:
                continue
            return f'{name}: only in the working tree'
        texts = [files[name].read_bytes() for files in outputs]
        if growing:
            if (line := first_missing_line(*(text.decode('utf-8') for text in texts))) is None:
                continue
            return f'{name}: the working tree lacks the line {line!r}, or has it elsewhere'
        if hashlib.sha256(texts[0]).digest() != hashlib.sha256(texts[1]).digest():
            return f'{name}, {_first_line(*(text.decode("utf-8") for text in texts))}'
    return None


def first_missing_line(base: str, tree: str) -> str | None:
    """Return the first line of BASE that the working tree lacks in this order, or None.

    A comma at the end is ignored: in JSON it depends on whether a further key follows.
    """
    lines = (line.rstrip(',') for line in tree.splitlines())
    wanted = (line.rstrip(',') for line in base.splitlines())
    return next((line for line in wanted if line not in lines), None)


def _outputs(folder: Path) -> dict[str, Path]:
    return {
        path.relative_to(folder).as_posix(): path
        for path in folder.rglob('*') if path.is_file()
    }


def _first_line(base: str, tree: str) -> str:
    lines = base.split('\n'), tree.split('\n')
    number = next(
        (i for i, (a, b) in enumerate(zip(*lines, strict=False)) if a != b),
        min(map(len, lines)) - 1,
    )
    if lines[0][number] == lines[1][number]:
        return f'{len(lines[0])} and {len(lines[1])} lines, equal up to the end of the shorter one'
    a, b = lines[0][number], lines[1][number]
    column = next(
        (i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b))
    )
    begin = max(0, column - CONTEXT_CHARACTERS)
    end = column + CONTEXT_CHARACTERS
    return (
        f'line {number + 1}, column {column + 1}\n    BASE  {a[begin:end]}\n'
        f'    tree  {b[begin:end]}'
    )


# The whole run


@dataclass
class Comparison:
    """Runs the cases of both versions, two at a time, and reports each as soon as it is known."""

    base: Version
    tree: Version
    cases: Sequence[Case]
    additions: bool = False
    different: list[str] = field(default_factory=list)
    _took_ms: Counter[str] = field(default_factory=Counter)
    _printing: threading.Lock = field(default_factory=threading.Lock)

    def run(self) -> None:
        """Run all cases.

        The first case of each version runs alone, because it compiles the inner loops and makes
        the recording of the others.
        """
        versions = self.base, self.tree
        maker, *others = self.cases
        with ThreadPoolExecutor(WORKERS) as pool:
            wait_all([pool.submit(self._run_side, version_, maker) for version_ in versions])
            self._report(maker)
            wait_all([pool.submit(self._run_both, case) for case in others])

    def _run_both(self, case: Case) -> None:
        for number in range(case.tries):
            if number:
                (self.base.outputs / f'{case.name}.done').unlink(missing_ok=True)
            for version_ in (self.base, self.tree):
                self._run_side(version_, case)
            if self._difference(case) is None:
                break
        self._report(case)

    def _run_side(self, version: Version, case: Case) -> None:
        """Run a case in one version, unless BASE has its outputs already."""
        folder = version.outputs / case.name
        done = version.outputs / f'{case.name}.done'
        if done.exists():
            return
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        start_s = time.monotonic()
        with tempfile.TemporaryDirectory(prefix='same_results-') as temporary:
            run = Run(version, case.name, Path(temporary))
            try:
                case.run(run)
            except (CaseError, LiveError) as error:
                run.keep(FAILURE, str(error))
                return
            finally:
                self._took_ms[case.name] += int(1000 * (time.monotonic() - start_s))
        if version.name == 'BASE':
            done.touch()

    def _difference(self, case: Case) -> str | None:
        return first_difference(
            self.base.outputs / case.name, self.tree.outputs / case.name, self.additions
        )

    def _report(self, case: Case) -> None:
        difference = self._difference(case)
        count = len(_outputs(self.tree.outputs / case.name))
        with self._printing:
            if difference is None:
                took_s = 1e-3 * self._took_ms[case.name]
                print(f'ok         {case.name}: {count} outputs ({took_s:.1f} s)', flush=True)
            else:
                self.different.append(case.name)
                print(f'DIFFERENT  {case.name}: {difference}', flush=True)


def wait_all(futures: Sequence[Future[None]]) -> None:
    """Wait for all; raise the first error."""
    for future in futures:
        future.result()


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a lock between processes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open('w') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print('waiting for another run that uses the same commit or tree', flush=True)
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def tool_key(data: Path) -> str:
    """Return a hash of all that the results depend on beside the program."""
    parts = [Path(__file__).read_text(encoding='utf-8'), sys.version]
    for name in ('numpy', 'scipy', 'numba', 'opencv-python-headless', 'rosbags'):
        with contextlib.suppress(PackageNotFoundError):
            parts.append(f'{name} {version(name)}')
    parts += [f'{path.name} {path.stat().st_size}' for path in sorted(data.glob('*/*.mcap'))]
    return _hash('\n'.join(parts).encode())


def prepare(commit: str, tree: Path, cache: Path, data: Path) -> tuple[Version, Version]:
    """Copy both versions into the cache."""
    base_folder = cache / 'base' / commit[:16]
    base_folder.mkdir(parents=True, exist_ok=True)
    extract_commit(commit, tree, base_folder / 'tree')
    results = base_folder / f'results-{tool_key(data)}'
    tree_folder = cache / 'trees' / _hash(str(tree).encode())
    (tree_folder / 'tree').mkdir(parents=True, exist_ok=True)
    copy_working_tree(tree, tree_folder / 'tree')
    shutil.rmtree(tree_folder / 'outputs', ignore_errors=True)
    versions = []
    for name, folder, outputs in (
        ('BASE', base_folder, results / 'outputs'), ('tree', tree_folder, tree_folder / 'outputs')
    ):
        compiled = cache / 'compiled' / compiled_key(folder / 'tree')
        for path in (compiled, outputs):
            path.mkdir(parents=True, exist_ok=True)
        os.utime(compiled)
        version_ = Version(
            name, folder / 'tree', outputs, results / 'inputs', data, compiled
        )
        version_.check_import()
        versions.append(version_)
    os.utime(base_folder)
    forget_old(cache / 'compiled', [v.compiled for v in versions])
    forget_old(cache / 'base', [base_folder])
    return versions[0], versions[1]


def chosen(
    only: Sequence[str], quick: bool, data: Path, in_base: Callable[[str], bool] = bool
) -> list[Case]:
    """Return the cases to run, after the one that makes the recording for them.

    Args:
        only: names of cases, all if empty.
        quick: whether to leave out the other cases.
        data: folder of the real recordings.
        in_base: returns whether BASE has a file.
    """
    cases = all_cases()
    names = [case.name for case in cases]
    unknown = [name for name in only if name not in names]
    if unknown:
        raise UsageError(f'there is no case {", ".join(unknown)}; expected {", ".join(names)}')
    maker, *others = cases
    found = [maker]
    for case in others:
        if case.needs and not (data / case.needs).is_dir():
            print(f'skipped    {case.name}: there is no {data / case.needs}')
        elif case.since and not in_base(case.since):
            print(f'skipped    {case.name}: BASE has no {case.since}')
        elif case.name in only or (not only and (case.quick or not quick)):
            found.append(case)
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare two versions; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').partition('\n')[0])
    parser.add_argument('base', metavar='BASE', help='the commit to compare with')
    parser.add_argument('--quick', action='store_true', help='the most important cases only')
    parser.add_argument('--additions', action='store_true',
                        help='allow further parameters, options and keys')
    parser.add_argument('--only', nargs='+', default=[], metavar='NAME', help='these cases only')
    parser.add_argument('--tree', type=Path, default=ROOT, metavar='DIR',
                        help='the working tree (default: the one that this tool is in)')
    parser.add_argument('--data', type=Path, metavar='DIR',
                        help='real recordings (default: shared/data beside the repository)')
    user = os.getuid()
    parser.add_argument('--cache', type=Path, metavar='DIR',
                        default=Path(tempfile.gettempdir()) / f'ratslam_same_results-{user}',
                        help='(default: a folder of its own among the temporary files)')
    options = parser.parse_args(arguments)
    start_s = time.monotonic()
    try:
        tree = Path(git('rev-parse', '--show-toplevel', folder=options.tree).decode().strip())
        commit = git('rev-parse', '--verify', f'{options.base}^{{commit}}', folder=tree)
        commit_id = commit.decode().strip()
        data = (options.data or data_folder(tree)).resolve()
        files = git('ls-tree', '-r', '--name-only', commit_id, folder=tree).decode().split('\n')
        cases = chosen(options.only, options.quick, data, lambda name: name in files)
        cache = options.cache.resolve()
        with locked(cache / 'trees' / f'{_hash(str(tree).encode())}.lock'), \
                locked(cache / f'{commit_id[:16]}.lock'):
            versions = prepare(commit_id, tree, cache, data)
            comparison = Comparison(*versions, cases, options.additions)
            comparison.run()
    except (UsageError, OSError) as error:
        print(f'same_results: {error}', file=sys.stderr)
        return WRONG_USE
    took_s = time.monotonic() - start_s
    if comparison.different:
        print(f'{len(comparison.different)} of {len(cases)} cases differ from '
              f'{commit_id[:10]}: {", ".join(comparison.different)} ({took_s:.0f} s)')
        return DIFFERENT
    print(f'all {len(cases)} cases are identical to {commit_id[:10]} ({took_s:.0f} s)')
    return SAME


def data_folder(tree: Path) -> Path:
    """Return the folder of real recordings beside the repository, also for a git worktree."""
    common = git('rev-parse', '--path-format=absolute', '--git-common-dir', folder=tree)
    return Path(common.decode().strip()).parent.parent / 'shared' / 'data'


if __name__ == '__main__':
    sys.exit(main())
