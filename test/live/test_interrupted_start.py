# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C ends a node in every phase of its start: at once, and without a traceback."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import live_environment

from ratslam_ros.signals import STOP_SIGNALS
from ratslam_ros.supervision import supervise

ROOT = Path(__file__).parents[2]
END_S = 120.0

START_SOURCE = """
import signal, sys

class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[1]:
            signal.raise_signal(signal.SIGINT)

sys.meta_path.insert(0, Interrupt())
from ratslam_ros.live.run import run
run('pose_cells')
print('continued')
"""

COMPILING_SOURCE = """
import signal, sys
import ratslam_ros.core.warm_up as core

def compile(*parts):
    try:
        signal.raise_signal(signal.SIGINT)
    except BaseException:  # as the callbacks of the compiler
        pass

core.warm_up = compile
from ratslam_ros.live.run import run
run('pose_cells')
print('continued')
"""

READY_SOURCE = """
import signal, threading
import ratslam_ros.core.warm_up as core

compiled = core.warm_up

def compile(*parts):
    if threading.current_thread() is threading.main_thread():
        return compiled(*parts)
    signal.raise_signal(signal.SIGINT)
    threading.Event().wait()  # as an import of SciPy that takes long

core.warm_up = compile
from ratslam_ros.live.run import run
run('experience_map')
print('continued')
"""


def started(source: str, *arguments: str) -> tuple[int, str]:
    """Run a source until it ends; return its exit code and output."""
    done = subprocess.run(
        [sys.executable, '-c', source, *arguments], cwd=ROOT,
        env={**os.environ, **live_environment()},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=END_S, check=False,
    )
    return done.returncode, done.stdout


@pytest.mark.parametrize('module', ['numpy', 'numba.np.arraymath'])
def test_interrupted_import_ends_node(ros: None, module: str) -> None:
    assert started(START_SOURCE, module) == (0, '')


def test_signal_before_interpreter_ends_node(ros: None) -> None:
    def interrupt() -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        os.kill(os.getpid(), signal.SIGINT)  # pending until the node has a handler

    done = subprocess.run(
        [sys.executable, '-m', 'ratslam_ros', 'run', 'pose_cells'], cwd=ROOT,
        env={**os.environ, **live_environment()}, preexec_fn=interrupt, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True, timeout=END_S, check=False,
    )
    assert (done.returncode, done.stdout) == (0, '')


def test_launched_nodes_begin_with_signals_blocked(capfd: pytest.CaptureFixture[str]) -> None:
    source = 'import signal; print(sorted(map(int, signal.pthread_sigmask(signal.SIG_BLOCK, ()))))'
    for are_nodes, expected in (True, f'{sorted(map(int, STOP_SIGNALS))}\n'), (False, '[]\n'):
        supervise({'node': [sys.executable, '-c', source]}, are_nodes=are_nodes)
        assert capfd.readouterr().out == expected
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == set()


def test_interrupted_compilation_ends_node(ros: None) -> None:
    assert started(COMPILING_SOURCE) == (0, '')


def test_node_ends_while_it_imports_scipy(ros: None) -> None:
    code, output = started(READY_SOURCE)
    assert (code, output.count('\n')) == (0, 1), output
    assert output.endswith('[experience_map]: ready\n')


ENDED_SOURCE = """
import atexit, signal
atexit.register(lambda: print(signal.getsignal(signal.SIGINT) is signal.SIG_IGN))  # the last one
from ratslam_ros.live import entry
entry.find_spec, entry.run = bool, lambda node, arguments: 0
raise SystemExit(entry.local_view())
"""


def test_interrupt_after_the_end_of_a_node_is_ignored(ros: None) -> None:
    """ros2 launch repeats SIGINT, and would report that the process has died."""
    assert started(ENDED_SOURCE) == (0, 'True\n')
