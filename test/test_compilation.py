# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A start that compiles announces it; a start from the cache prints nothing."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODULE = """
from ratslam_ros.core.common.compiled import compiled

@compiled
def half(value):
    return 0.5 * value

@compiled
def third(value):
    return half(value) / 1.5
"""
START = """
from ratslam_ros.compilation import announced_compilation
from loops import half, third

with announced_compilation(print, *AFTER):
    third(1.0)
    half(1.0)
"""


def start(folder: Path, after: str = '(0.0,)') -> list[str]:
    environment = {
        **os.environ, 'PYTHONPATH': os.pathsep.join([str(ROOT), str(folder)]),
        'NUMBA_CACHE_DIR': str(folder / 'cache'),
    }
    code = START.replace('*AFTER', f'*{after}')
    done = subprocess.run(
        [sys.executable, '-c', code], env=environment, capture_output=True, text=True,
        check=False, timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_only_a_long_compilation_of_what_is_not_cached_is_announced(tmp_path: Path) -> None:
    module = tmp_path / 'loops.py'
    module.write_text(MODULE)
    assert start(tmp_path, '(1e9,)') == []
    assert start(tmp_path) == []
    module.write_text(MODULE.replace('0.5', '0.25'))
    first, last = start(tmp_path)
    assert first.startswith('compiling the inner loops')
    assert str(tmp_path / 'cache') in first
    assert last.startswith('compiled the inner loops in')


def test_long_compilation_of_one_function_is_announced_before_its_end(tmp_path: Path) -> None:
    (tmp_path / 'loops.py').write_text(MODULE)
    code = """
import threading, time
from numba.core import event
from ratslam_ros.compilation import announced_compilation

class Dispatcher:
    class stats:
        cache_path = 'folder'

said = threading.Event()
with announced_compilation(lambda text: said.set() or print(text), 0.01):
    event.start_event('numba:compile', {'dispatcher': Dispatcher})
    assert said.wait(60.0)  # the compilation has not ended
    event.end_event('numba:compile', {'dispatcher': Dispatcher})
"""
    done = subprocess.run(
        [sys.executable, '-c', code], env={**os.environ, 'PYTHONPATH': str(ROOT)},
        capture_output=True, text=True, check=False, timeout=120,
    )
    assert done.returncode == 0, done.stderr
    first, last = done.stdout.splitlines()
    assert first.startswith('compiling') and last.startswith('compiled')
