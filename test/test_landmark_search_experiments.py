# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The experiments on relocalisation of benchmarks/landmarks.py, on one seed."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope='module')
def bench() -> ModuleType:
    path = Path(__file__).parents[1] / 'benchmarks/landmarks.py'
    spec = importlib.util.spec_from_file_location('benchmarks_landmarks_search', path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize('case', ['distinct', 'normal, twice the noise'])
def test_kidnaps_are_right(bench: ModuleType, case: str) -> None:
    rows = bench.relocalisation_run(case, 1)
    assert [row.outcome for row in rows] == ['right'] * bench.KIDNAPS_COUNT


def test_few_observations_are_never_wrong(bench: ModuleType) -> None:
    outcomes = {row.outcome for row in bench.relocalisation_run('twice the noise, 4 seen', 1)}
    assert outcomes <= {'right', 'ambiguous', 'not here'}


def test_never_mapped_regions_are_not_here(bench: ModuleType) -> None:
    rows = [
        *bench.unmapped_run('normal, twice the noise', 1),
        *bench.unmapped_plan_run('house', 1),
    ]
    assert {row.outcome for row in rows} == {'not here'}


def test_sampling_finds_set_of_jcbb_with_fewer_nodes(bench: ModuleType) -> None:
    exhaustive, printed, jcbb, sampling = bench.effort_run((1, 8, 100))
    assert exhaustive.pairs == jcbb.pairs == sampling.pairs == 8
    assert printed.pairs <= 8
    assert sampling.nodes < jcbb.nodes < exhaustive.nodes
