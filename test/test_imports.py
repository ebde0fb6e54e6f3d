# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Who may know of whom: core of nobody, recordings and the stand-in for rclpy not of RatSLAM."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / 'ratslam_ros'

ROS = {
    'rclpy', 'sensor_msgs', 'nav_msgs', 'geometry_msgs', 'std_msgs', 'std_srvs', 'tf2_ros',
    'visualization_msgs', 'diagnostic_msgs', 'builtin_interfaces', 'rosbag2_py', 'cv_bridge',
    'launch', 'launch_ros', 'ament_index_python', 'rosbags', 'mcap', 'cyclonedds',
}  # fmt: skip
WORLD = {
    'time', 'datetime', 'random', 'secrets', 'uuid', 'os', 'pathlib', 'io', 'shutil', 'tempfile',
    'socket', 'threading', 'multiprocessing', 'concurrent', 'asyncio', 'subprocess', 'sys',
    'logging', 'glob', 'pickle', 'json', 'yaml', 'configparser',
}  # fmt: skip


def files(part: str) -> list[Path]:
    return sorted((PACKAGE / part).glob('**/*.py'))


def imports(path: Path) -> Iterator[str]:
    """Yield the full names of all modules a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path} imports relatively'
            yield from (f'{node.module}.{alias.name}' for alias in node.names)


def own(name: str) -> bool:
    return name.split('.')[0] == 'ratslam_ros'


def ids(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


@pytest.mark.parametrize('path', files('core'), ids=ids)
def test_core_knows_no_ros_no_files_no_clock_and_no_chance(path: Path) -> None:
    found = set(imports(path))
    assert not {name.split('.')[0] for name in found} & (ROS | WORLD)
    # Chance is brought by whoever calls: its type may be named.
    assert not {n for n in found if n.startswith('numpy.random')} - {'numpy.random.Generator'}


@pytest.mark.parametrize('path', files('core'), ids=ids)
def test_core_knows_nothing_around_it(path: Path) -> None:
    for name in filter(own, imports(path)):
        assert name.startswith(('ratslam_ros.core.', 'ratslam_ros.errors.'))


@pytest.mark.parametrize('path', files('core'), ids=ids)
def test_core_opens_no_files_and_draws_no_chance(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Name):
            assert node.id not in ('open', 'print', 'input', 'exec', 'eval', '__import__')
        if isinstance(node, ast.Attribute):
            assert node.attr not in ('random', 'default_rng', 'fromfile', 'tofile', 'savetxt')


@pytest.mark.parametrize('path', files('core'), ids=ids)
def test_core_compiles_strictly(path: Path) -> None:
    """No fastmath, no parallel loops: numbers are the same at every run."""
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.keyword) and node.arg in ('fastmath', 'parallel'):
            assert isinstance(node.value, ast.Constant)
            assert node.value.value is False
        if isinstance(node, ast.Attribute):
            assert node.attr not in ('prange', 'vectorize', 'guvectorize', 'dot', 'matmul')


@pytest.mark.parametrize('path', files('recordings'), ids=ids)
def test_recordings_know_nothing_of_ratslam(path: Path) -> None:
    for name in filter(own, imports(path)):
        assert name.startswith(
            ('ratslam_ros.recordings.', 'ratslam_ros.images.', 'ratslam_ros.errors.')
        )


def test_the_stand_in_for_rclpy_knows_nothing_of_ratslam() -> None:
    for path in files('standalone'):
        for name in filter(own, imports(path)):
            assert name.startswith('ratslam_ros.standalone.'), path


@pytest.mark.parametrize(
    'path', [path for path in files('.') if 'nodes' not in path.parts], ids=ids
)
def test_ros_is_only_needed_by_nodes(path: Path) -> None:
    """Everything else runs with no ROS installed; live commands put the stand-in there first."""
    if 'standalone' in path.parts or 'live' in path.parts:
        return
    found = {name.split('.')[0] for name in imports(path)}
    assert not found & {'rclpy', 'sensor_msgs', 'nav_msgs', 'tf2_ros', 'cv_bridge', 'rosbag2_py'}


def test_core_can_be_imported_alone() -> None:
    """Without OpenCV, SciPy, rosbags and all that the commands need."""
    code = (
        'import sys\n'
        'for name in ("cv2", "scipy", "rosbags", "matplotlib", "yaml", "tqdm", "rclpy"):\n'
        '    sys.modules[name] = None\n'
        'import ratslam_ros.core.ratslam, ratslam_ros.core.config, ratslam_ros.messages.mapping\n'
        'print(sorted(m for m in sys.modules if m.startswith("ratslam_ros.")))\n'
    )
    run = subprocess.run(
        [sys.executable, '-c', code], cwd=PACKAGE.parent, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert 'ratslam_ros.recordings' not in run.stdout
