# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam doctor``: one line for each check, with what to do."""

import os
import subprocess
import sys
from pathlib import Path

from ratslam_ros.cli import installation_commands, main

ROOT = Path(__file__).parents[2]


def test_doctor_with_bad_settings_says_what_to_do(tmp_path: Path) -> None:
    environment = {
        **os.environ, 'PYTHONPATH': str(ROOT), 'NUMBA_CACHE_DIR': str(tmp_path),
        'ROS_DOMAIN_ID': '233', 'DISPLAY': '', 'WAYLAND_DISPLAY': '',
    }
    done = subprocess.run(
        [sys.executable, '-m', 'ratslam_ros', 'doctor'], cwd=tmp_path, env=environment,
        capture_output=True, text=True, check=True,
    )
    lines = {line[4:18].strip(): line for line in done.stdout.splitlines()}
    assert list(lines) == [
        'Python', 'packages', 'compiled cache', 'cameras', 'ROS', 'DDS', 'free disk', 'browser',
    ]
    assert sys.executable in lines['Python'] and 'numba ' in lines['packages']
    assert 'check failed' not in done.stdout
    assert lines['compiled cache'].startswith('!!') and 'warm-up' in lines['compiled cache']
    assert lines['DDS'].startswith('!!  DDS') and 'from 0 to 232' in lines['DDS']
    assert lines['browser'].startswith('!!')
    assert str(tmp_path) in lines['free disk']


def test_doctor_names_missing_packages_and_goes_on(monkeypatch, capsys) -> None:
    def version(name: str) -> str | None:
        return None if name == 'rosbags' else '1'

    monkeypatch.setattr(installation_commands, '_version', version)
    for check in ('_cache', '_cameras', '_ros', '_dds'):
        monkeypatch.setattr(installation_commands, check, lambda: 1 / 0)
    assert main(['doctor']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].endswith('; missing: python3 -m pip install rosbags')
    assert lines[2].startswith('!!  compiled cache  the check failed') and len(lines) == 8
