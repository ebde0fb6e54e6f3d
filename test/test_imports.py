# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The layers of the code: which package may import which, and what core must not use."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / 'ratslam_ros'
PACKAGES = (
    PACKAGE, ROOT / 'ratslam_simulator', ROOT / 'ratslam_tuning', ROOT / 'rclpy_standin',
)

ROS = {
    'rclpy', 'sensor_msgs', 'nav_msgs', 'geometry_msgs', 'std_msgs', 'std_srvs', 'tf2_ros',
    'visualization_msgs', 'diagnostic_msgs', 'builtin_interfaces', 'rosbag2_py', 'cv_bridge',
    'launch', 'launch_ros', 'ament_index_python', 'rosbags', 'mcap', 'cyclonedds',
}
SIDE_EFFECTS = {
    'time', 'datetime', 'random', 'secrets', 'uuid', 'os', 'pathlib', 'io', 'shutil', 'tempfile',
    'socket', 'threading', 'multiprocessing', 'concurrent', 'asyncio', 'subprocess', 'sys',
    'logging', 'glob', 'pickle', 'json', 'yaml', 'configparser',
}

# Layers, lowest first. A package may import those below it; packages of one row are independent.
CORE_LAYERS = [
    ['common'],
    ['config'],
    ['vision', 'landmarks'],
    ['pose_cells'],
    ['mapping', 'goal_memory'],
    ['navigation', 'merging'],
    ['driving'],
    ['warm_up'],
]
LAYERS = [
    ['errors', 'version'],
    ['limits', 'console'],
    ['compilation', 'images', 'timing', 'quick_start', 'signals', 'starting', 'rclpy_standin'],
    ['core', 'recordings'],
    ['messages', 'files', 'descriptors'],
    ['pipeline'],
    ['chain', 'event_inputs', 'own_stages', 'results', 'supervision'],
    ['maps'],
    ['history'],
    ['ratslam_tuning', 'viewer'],
    ['ros'],
    ['ratslam_simulator'],
    ['offline'],
    ['live'],
    ['cli'],
    ['__main__'],
]
INDEPENDENT = {
    'core': {'errors'},
    'pipeline': {'core', 'descriptors', 'errors'},
    'recordings': {'errors', 'images', 'limits'},
    'rclpy_standin': set(),
    'ratslam_simulator': {
        'errors', 'limits', 'images', 'core', 'pipeline', 'results', 'recordings', 'ros',
    },
    'ratslam_tuning': {
        'errors', 'limits', 'core', 'event_inputs', 'files', 'descriptors', 'messages',
        'pipeline', 'recordings', 'results',
    },
    'results': {'errors', 'limits', 'images', 'core', 'pipeline', 'files', 'messages'},
}
"""Packages that may import less than their layer permits."""


@cache
def modules() -> dict[str, Path]:
    """Return every module of the packages by its dotted name, shortened."""
    names = {}
    for path in (path for package in PACKAGES for path in package.rglob('*.py')):
        parts = path.relative_to(ROOT).with_suffix('').parts
        names[shortened('.'.join(parts[:-1] if parts[-1] == '__init__' else parts))] = path
    return names


def shortened(name: str) -> str:
    """Return the dotted name of a module without ratslam_ros, whose parts are the layers."""
    return name.removeprefix('ratslam_ros').removeprefix('.')


def files(part: str) -> list[Path]:
    return sorted((PACKAGE / part).glob('**/*.py'))


PURE = [*files('core'), *files('pipeline')]
"""Files of which the results depend on the inputs alone."""


@cache
def nodes_of(path: Path) -> tuple[ast.AST, ...]:
    return (*ast.walk(ast.parse(path.read_text(encoding='utf-8'))),)


@cache
def imports(path: Path) -> tuple[str, ...]:
    """Return the full names of all that a file imports, in functions too."""
    found: list[str] = []
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path} imports relatively'
            found += [f'{node.module}.{alias.name}' for alias in node.names]
    return tuple(found)


@cache
def own_imports(path: Path) -> frozenset[str]:
    """Return the modules of the packages that a file imports."""
    known = modules()
    found = set()
    for name in imports(path):
        if name.split('.')[0] in {package.name for package in PACKAGES}:
            short = shortened(name)
            found.add(short if short in known else short.rpartition('.')[0])
    return frozenset(found)


def layer_of(layers: list[list[str]], package: str) -> int:
    (level,) = (n for n, row in enumerate(layers) if package in row)
    return level


def test_every_package_has_a_layer() -> None:
    assert {name.split('.')[0] for name in modules() if name} == {
        package for row in LAYERS for package in row
    }
    assert {name.split('.')[1] for name in modules() if name.startswith('core.')} == {
        package for row in CORE_LAYERS for package in row
    }


def test_modules_import_only_lower_layers() -> None:
    for name, path in modules().items():
        package = name.split('.')[0]
        for target in own_imports(path) - {''} if name else ():
            other = target.split('.')[0]
            if other != package:
                assert layer_of(LAYERS, other) < layer_of(LAYERS, package), f'{name}: {target}'
                assert other in INDEPENDENT.get(package, {other}), f'{name} imports {target}'


def test_core_packages_import_only_lower_layers() -> None:
    for name, path in modules().items():
        for target in own_imports(path) if name.startswith('core.') else ():
            package, other = (f'{one}.'.split('.')[1] for one in (name, target))
            if target.startswith('core.') and other != package:
                assert layer_of(CORE_LAYERS, other) < layer_of(CORE_LAYERS, package), (
                    f'{name} imports {target}'
                )


def test_modules_have_no_import_cycle() -> None:
    """Imports within functions count, so that none of them hides a cycle."""
    edges = {name: own_imports(path) & modules().keys() for name, path in modules().items()}
    while leaves := {name for name, targets in edges.items() if not targets - {name}}:
        edges = {
            name: targets - leaves for name, targets in edges.items() if name not in leaves
        }
    assert not edges, f'these modules are on cycles, or import modules that are: {sorted(edges)}'


def test_core_uses_no_ros_files_clock_or_randomness() -> None:
    for path in PURE:
        found = set(imports(path))
        assert not {name.split('.')[0] for name in found} & (ROS | SIDE_EFFECTS), path
        # Random generators are passed in by callers, so their type may be named.
        random = {name for name in found if name.startswith('numpy.random')}
        assert random <= {'numpy.random.Generator'}, path


def test_core_calls_no_file_or_random_function_and_has_strict_arithmetic() -> None:
    """No fastmath and no parallel loops, so that results are the same on every run."""
    for path in PURE:
        for node in nodes_of(path):
            if isinstance(node, ast.Name):
                forbidden = 'open', 'print', 'input', 'exec', 'eval', '__import__'
                assert node.id not in forbidden, path
            elif isinstance(node, ast.keyword) and node.arg in ('fastmath', 'parallel'):
                assert isinstance(node.value, ast.Constant) and node.value.value is False, path
            elif isinstance(node, ast.Attribute):
                assert node.attr not in (
                    'random', 'default_rng', 'fromfile', 'tofile', 'savetxt',
                    'prange', 'vectorize', 'guvectorize', 'dot', 'matmul',
                ), path


def test_only_nodes_and_live_commands_import_ros() -> None:
    ros = {'rclpy', 'sensor_msgs', 'nav_msgs', 'tf2_ros', 'cv_bridge', 'rosbag2_py'}
    for name, path in modules().items():
        if name != 'ratslam_simulator.node' and (
            name.split('.')[0] not in ('ros', 'live', 'rclpy_standin')
        ):
            assert not {one.split('.')[0] for one in imports(path)} & ros, name


def test_drawing_does_not_import_pyplot() -> None:
    """pyplot needs a display on some machines."""
    found = {one for path in modules().values() for one in imports(path)}
    assert any(one.startswith('matplotlib') for one in found)
    assert not [one for one in found if 'pyplot' in one or one == 'matplotlib.pylab']


def test_core_imports_without_optional_dependencies() -> None:
    code = (
        'import sys\n'
        'for name in ("cv2", "scipy", "rosbags", "matplotlib", "yaml", "tqdm", "rclpy"):\n'
        '    sys.modules[name] = None\n'
        'import ratslam_ros.pipeline.ratslam, ratslam_ros.core.config\n'
        'import ratslam_ros.messages.mapping, ratslam_ros.messages.goals\n'
        'print(sorted(m for m in sys.modules if m.startswith("ratslam_ros.")))\n'
    )
    run = subprocess.run(
        [sys.executable, '-c', code], cwd=PACKAGE.parent, capture_output=True, text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert 'ratslam_ros.recordings' not in run.stdout
