# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam warm-up``: compile all inner loops once, in parallel, into Numba's cache."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import NamedTuple

from ratslam_ros.console import print_notice, ticking
from ratslam_ros.errors import UnusableInput


class Job(NamedTuple):
    """Functions that one process compiles, because they call each other.

    label: what they do. group: one of ``GROUPS``. parts: their names, see
    ``core.warm_up.warm_up``; 'simulator' and 'revisits' are compiled by using them.
    """

    label: str
    group: str
    parts: tuple[str, ...]


GROUPS = 'mapping', 'navigation', 'laser', 'simulator'
"""What can be compiled, by the names that the command takes."""

JOBS = (
    Job('landmarks', 'laser', ('experience_map', 'scan_alignment', 'landmark_map', 'relocation')),
    Job('goals on the pose cells', 'navigation', ('pose_cells', 'goal_memory')),
    Job('pose cells', 'mapping', ('pose_cells',)),
    Job('routes and driving', 'navigation', ('experience_map', 'goal_recall', 'goal_follower')),
    Job('experience map', 'mapping', ('experience_map',)),
    Job('images', 'mapping', ('local_view', 'visual_odometry', 'revisits')),
    Job('simulator', 'simulator', ('simulator',)),
)
"""All jobs, the longest first: 45 s to 3 s."""


def compile_kernels() -> None:
    """Compile the inner loops or load them from the cache; print a notice if they are compiled."""
    from ratslam_ros.compilation import announced_compilation
    from ratslam_ros.core.warm_up import warm_up
    from ratslam_ros.quick_start import import_numba, quick_start, settle

    import_numba()
    with quick_start(), announced_compilation(print_notice):
        warm_up()
        settle()


def compile_all(groups: Sequence[str], say: Callable[[str], None]) -> str:
    """Compile what is not in the cache yet, with a process for each core.

    Args:
        groups: keys of GROUPS; none for all.
        say: called with a line for each job that had to compile.

    Returns:
        A line that sums up.

    Raises:
        UnusableInput: there is no such group.
    """
    unknown = set(groups) - set(GROUPS)
    if unknown:
        raise UnusableInput(
            f'{", ".join(sorted(unknown))} cannot be compiled; choose from {", ".join(GROUPS)}'
        )
    jobs = _jobs(groups or GROUPS)
    start_s = time.monotonic()
    workers = min(os.cpu_count() or 1, len(jobs))
    compiled_s = 0.0
    # Fresh processes, since a process that has threads must not be forked.
    with (
        ticking('loading:'),
        ProcessPoolExecutor(workers, mp_context=get_context('spawn')) as pool,
    ):
        pending = {pool.submit(_compile, job.parts): job for job in jobs}
        for done in as_completed(pending):
            took_s = done.result()
            if took_s > 0.0:
                compiled_s += took_s
                say(f'compiled: {pending[done].label} ({took_s:.0f} s)')
    if compiled_s == 0.0:
        return 'everything is compiled already'
    return f'compiled in {time.monotonic() - start_s:.0f} s; later starts load the compiled code'


def _jobs(groups: Sequence[str]) -> list[Job]:
    """Return the jobs of some groups, but those whose parts are among those of another one."""
    found = [job for job in JOBS if job.group in groups]
    return [
        job for job in found
        if not any(set(job.parts) < set(other.parts) for other in found)
    ]


def _compile(parts: tuple[str, ...]) -> float:
    """Compile parts in this process; return the time spent on compiling in s."""
    from ratslam_ros.compilation import compilation_time
    from ratslam_ros.core.warm_up import warm_up

    with compilation_time() as taken:
        for part in parts:
            if part == 'simulator':
                from ratslam_simulator.config import SimulatorParameters, make_simulator

                for people in (0, 1):
                    make_simulator(SimulatorParameters(plan='office', people=people)).step()
            elif part == 'revisits':
                import numpy as np

                from ratslam_ros.core.config import Config
                from ratslam_tuning.revisits import compare_all

                compare_all(np.zeros((2, 8, 16), np.uint8), Config().local_view)
            else:
                warm_up(part)
    return taken.seconds
