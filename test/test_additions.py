# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The published algorithm and our additions are apart: the former runs without the latter."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from ratslam_ros.core.config import Config
from ratslam_ros.core.config.additions import ADDITIONS
from ratslam_ros.files.config import preset_config

ROOT = Path(__file__).resolve().parents[1]
PAPERS = 'milford2005', 'milford2006', 'milford2006_small', 'openratslam'

RUN_PAPERS = """
import json, sys
import numpy as np
from ratslam_ros.files.config import preset_config
from without_additions import remove
remove(json.loads(sys.argv[1]))
from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.pipeline.ratslam import RatSLAM
images = np.random.default_rng(0).integers(0, 256, (24, 48, 64), np.uint8)
found = {}
for name in sys.argv[2:]:
    slam = RatSLAM(preset_config(name))
    for n in range(54):  # more than two laps of a circle
        ns = 10**18 + n * 10**8
        slam.odometry(Odometry(ns, Twist(5.0, 10.0 * np.pi / 12.0)))
        slam.image(ns, images[n % 24])
    slam.finish()
    ends = slam.experience_map.link_ends
    found[name] = len(slam.experience_map), int((ends[:, 0] > ends[:, 1]).sum())
print(json.dumps(found))
"""


def selected(config: Config) -> set[str]:
    return {
        one.module for one in ADDITIONS if one.is_selected(getattr(config, one.section))
    }


def run(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(ROOT), str(ROOT / 'tools')])
    return subprocess.run(
        [sys.executable, '-c', code, *arguments], env={**os.environ, 'PYTHONPATH': path},
        capture_output=True, text=True, timeout=120,
    )


@pytest.mark.parametrize('name', PAPERS)
def test_presets_of_papers_select_no_addition(name: str) -> None:
    assert selected(preset_config(name)) == set()


def test_defaults_select_additions_without_laser() -> None:
    off = {one.module for one in ADDITIONS} - selected(Config())
    assert off == {
        'mapping.gated_closures', 'mapping.scan_matching', 'mapping.relocator',
        'goal_memory.goal_routes',
    }


PUBLISHED = re.findall(
    r'`(core/[a-z_/]+\.py)`',
    (ROOT / 'docs/algorithm.md').read_text('utf-8').partition('## Published and added')[2]
    .partition('Each of our modules')[0],
)
"""Modules of the table of published ones in docs/algorithm.md."""


@pytest.mark.parametrize('path', PUBLISHED)
def test_published_module_is_short_and_imports_no_addition(path: str) -> None:
    code = (ROOT / 'ratslam_ros' / path).read_text('utf-8')
    assert len(code.splitlines()) <= 300
    imported = set(re.findall(r'from ratslam_ros\.core\.([a-z_.]+) import', code))
    assert not imported & {one.module for one in ADDITIONS}


def test_presets_of_papers_run_without_all_additions() -> None:
    modules = json.dumps(sorted({one.module for one in ADDITIONS}))
    ended = run(RUN_PAPERS, modules, *PAPERS[:2], PAPERS[3])
    assert ended.returncode == 0, ended.stderr
    for name, (experiences, closures) in json.loads(ended.stdout).items():
        assert experiences >= 24, name
        assert closures > 0, name


def test_selected_addition_without_its_module_names_it() -> None:
    code = (
        'from without_additions import remove\n'
        'remove(["pose_cells.agreement"])\n'
        'from ratslam_ros.pipeline.ratslam import RatSLAM\n'
        'RatSLAM()\n'
    )
    ended = run(code)
    assert ended.returncode != 0
    assert 'ratslam_ros.core.pose_cells.agreement was removed' in ended.stderr
