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
    }  # fmt: skip
    code = START.replace('*AFTER', f'*{after}')
    done = subprocess.run(
        [sys.executable, '-c', code], env=environment, capture_output=True, text=True,
        check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_only_a_cold_or_outdated_cache_is_announced(tmp_path: Path) -> None:
    module = tmp_path / 'loops.py'
    module.write_text(MODULE)
    first, last = start(tmp_path)
    assert first.startswith('compiling the inner loops')
    assert str(tmp_path / 'cache') in first
    assert last.startswith('compiled the inner loops in')
    assert start(tmp_path) == []
    module.write_text(MODULE.replace('0.5', '0.25'))
    assert len(start(tmp_path)) == 2


def test_short_compilation_is_not_announced(tmp_path: Path) -> None:
    (tmp_path / 'loops.py').write_text(MODULE)
    assert start(tmp_path, '(1e9,)') == []
