# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiling everything at once: it covers all parts, and does nothing a second time."""

from __future__ import annotations

import pytest

from ratslam_ros.compilation import compilation_time
from ratslam_ros.core import warm_up
from ratslam_ros.errors import UnusableInput
from ratslam_ros.offline import compile_all as module
from ratslam_ros.offline.compile_all import GROUPS, JOBS, compile_all


def test_all_parts_are_compiled_by_some_job() -> None:
    compiled = {part for job in JOBS for part in job.parts}
    assert compiled - {'simulator', 'revisits'} == set(warm_up._PARTS)


def test_jobs_do_nothing_twice() -> None:
    assert {job.group for job in JOBS} == set(GROUPS)
    parts = [set(job.parts) for job in module._jobs(GROUPS)]
    assert not any(a < b for a in parts for b in parts)


def test_a_second_time_nothing_is_compiled() -> None:
    module._compile(('simulator',))
    said: list[str] = []
    assert compile_all(['simulator'], said.append) == 'everything is compiled already'
    assert said == []


def test_unknown_groups_are_refused() -> None:
    with pytest.raises(UnusableInput, match='attic cannot be compiled; choose from mapping'):
        compile_all(['attic', 'mapping'], print)


def test_only_compiling_takes_time() -> None:
    from numba import njit

    function = njit(lambda value: value + 1)
    caches: list[str] = []
    with compilation_time(caches.append) as taken:
        function(1)
    assert taken.seconds > 0.0
    assert caches == ['']  # a function without a cache
    with compilation_time(caches.append) as taken:
        function(2)
    assert taken.seconds == 0.0
