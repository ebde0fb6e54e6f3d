# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The live commands: arguments and error messages."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ratslam_ros.cli.main import parser
from ratslam_ros.live import entry
from ratslam_ros.live.run import NODES

ROOT = Path(__file__).parents[2]


def test_arguments_after_node_belong_to_it() -> None:
    rest = ['--ros-args', '-p', 'use_sim_time:=true', '-r', '__ns:=/a', '--log-level', 'debug']
    options = parser().parse_args(['run', 'pose_cells', *rest])
    assert (options.node, options.arguments) == ('pose_cells', rest)


def test_arguments_after_ros_args_are_for_ros() -> None:
    rest = ['-r', 'image:=/camera/image', '-r', '__ns:=/a', '--log-level', 'debug']
    for words in (['play', 'bag'], ['call', 'a', 'b', '{}', '--timeout', '3'], ['echo', 'x']):
        options = parser().parse_args([*words, '--ros-args', *rest])
        assert options.ros_args == rest
    assert parser().parse_args(['call', 'a', 'b', '--ros-args', *rest]).values == ''
    assert parser().parse_args(['play', 'bag']).ros_args == []


@pytest.mark.parametrize(
    ('words', 'parts'),
    [
        (['run', 'pose_cell'], ['pose_cell', *NODES]),
        (['run'], ['NODE']),
        (['launch', '--config', 'nowhere'], ['nowhere', 'irat']),
        (['launch', '--set', 'pose_cells.pc_dim_x=0'], ['pc_dim_x', 'expected']),
        (['launch', '--set', 'pose_cells.pc_dim'], ['section.name=value']),
        (['launch', '--stages', 'pose_cell'], ['pose_cell', 'local_view,pose_cells']),
        (['play', '/no/such/recording'], ['/no/such/recording', 'does not exist']),
        (['call', 'a'], ['TYPE']),
        (['echo'], ['TOPIC']),
        (['echo', 'a', '--timeout', 'soon'], ['--timeout', 'soon']),
    ],
    ids=lambda value: ' '.join(value) if isinstance(value, list) else None,
)
def test_invalid_input_is_reported_in_one_line(words, parts, refusal) -> None:
    line = refusal(*words)
    assert all(part in line for part in parts)


def python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=False, timeout=60,
        cwd=ROOT, env={**os.environ, 'PYTHONPATH': str(ROOT)},
    )


@pytest.mark.parametrize('node', NODES)
def test_node_without_ros_names_alternative(node: str, monkeypatch, capfd) -> None:
    monkeypatch.setattr(entry, 'find_spec', lambda name: None)
    assert getattr(entry, node)() == 2
    err = capfd.readouterr().err
    assert f'"ratslam run {node}"' in err and err.count('\n') == 1


@pytest.mark.parametrize(
    'words',
    [['run', 'pose_cells'], ['launch'], ['echo', 'x']],
    ids=lambda words: words[0],
)
def test_missing_rclpy_and_cyclonedds_is_one_line(words: list[str]) -> None:
    run = python(
        'import importlib.util, sys\n'
        'sys.modules["rclpy"] = sys.modules["cyclonedds"] = None\n'
        'find, absent = importlib.util.find_spec, ("rclpy", "cyclonedds")\n'
        'importlib.util.find_spec = lambda name: None if name in absent else find(name)\n'
        'from ratslam_ros.cli import main\n'
        f'sys.exit(main({words}))\n'
    )
    assert run.returncode == 2, run.stderr
    assert run.stderr.count('\n') == 1 and 'cyclonedds' in run.stderr


@pytest.mark.parametrize(('package', 'start'), [
    ('numpy', 'from ratslam_ros.live.entry import local_view as start'),
    ('cv2', 'from ratslam_ros.cli import main\nstart = lambda: main(["run", "local_view"])'),
], ids=['entry', 'command'])
def test_missing_package_is_reported_in_one_line(package: str, start: str) -> None:
    run = python(
        'import sys\n'
        f'sys.modules["{package}"] = None\n'
        'from ratslam_ros.live import entry\n'
        'entry.find_spec = lambda name: True  # rclpy is there\n'
        f'{start}\n'
        'sys.exit(start())\n'
    )
    assert run.returncode == 2, run.stderr
    assert run.stderr.count('\n') == 1
    assert package.replace('cv2', 'opencv') in run.stderr
    assert f'({sys.executable})' in run.stderr and 'colcon build' in run.stderr


def test_commands_do_not_import_slow_packages() -> None:
    """Neither readers of recordings nor plotting are imported by nodes and launch."""
    run = python(
        'import sys\n'
        'import ratslam_ros.cli.main, ratslam_ros.live.run, ratslam_ros.live.launch\n'
        'import ratslam_ros.live.ros\n'
        'print(*sorted(sys.modules))\n'
    )
    assert run.returncode == 0, run.stderr
    assert not {'matplotlib', 'rosbags', 'cv2', 'numpy', 'numba', 'rclpy'} & set(
        run.stdout.split()
    )
