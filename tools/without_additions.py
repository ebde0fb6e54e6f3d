# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check that the published algorithm does not need our additions: remove each, and run the tests.

    python tools/without_additions.py [MODULE ...] [--tests PATH ...]

For each module of ratslam_ros/core/config/additions.py, a process in which this module cannot be
imported imports the published algorithm and the pipeline, and runs the tests. A test that selects
the addition fails to import it: it is counted as one of the addition's own, and must not fail
otherwise. All other tests must pass. MODULE is a name such as pose_cells.agreement; by default all
are removed, one after the other. The exit code is 1 if the import or a test fails.

The table has a line for each module: the section of the parameters that select it, the tests that
passed, those of the addition, those that failed, and the modules of core that need it as well.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import pkgutil
import subprocess
import sys
from collections.abc import Generator, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

from ratslam_ros.core.config.additions import ADDITIONS  # noqa: E402 - beside ROOT

CORE = 'ratslam_ros.core'
TESTS = tuple(f'test/core/{part}' for part in ('vision', 'pose_cells', 'mapping', 'goal_memory'))

PUBLISHED = (
    'core.vision.visual_odometry', 'core.vision.local_view', 'core.pose_cells.pose_cells',
    'core.mapping.experience_map', 'core.goal_memory.goal_memory', 'core.navigation.navigator',
    'pipeline.ratslam',
)
"""Modules that must not need any addition, below ratslam_ros."""


class Removed(ModuleNotFoundError):  # noqa: N818 - the name says what it is
    """Error: a module was removed for the test."""


class Remover(MetaPathFinder):
    """Refuses to import some modules."""

    def __init__(self, modules: Sequence[str]) -> None:
        self._names = {f'{CORE}.{module}' for module in modules}

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Raise ``Removed`` for a removed module."""
        if fullname in self._names:
            raise Removed(f'{fullname} was removed')
        return None


def remove(modules: Sequence[str]) -> list[str]:
    """Make modules unimportable, and import the rest of core.

    Returns:
        The modules of core that cannot be imported without them, below ratslam_ros.core.

    Raises:
        Removed: the published algorithm needs one.
    """
    loaded = [f'{CORE}.{module}' for module in modules if f'{CORE}.{module}' in sys.modules]
    assert not loaded, f'{loaded} are imported already'
    sys.meta_path.insert(0, Remover(modules))
    for name in PUBLISHED:
        importlib.import_module(f'ratslam_ros.{name}')
    core, missing = importlib.import_module(CORE), []
    for found in pkgutil.walk_packages(core.__path__, f'{CORE}.'):
        try:
            importlib.import_module(found.name)
        except Removed:
            missing.append(found.name.removeprefix(f'{CORE}.'))
    return [name for name in missing if name not in modules]


def is_removal(error: BaseException | None) -> bool:
    """Return whether a removed module has caused an error."""
    while error is not None:
        if isinstance(error, Removed):
            return True
        error = error.__cause__ or error.__context__
    return False


class Counter:
    """Pytest plugin that skips what needs a removed module, and counts the results."""

    def __init__(self) -> None:
        self.passed = self.own = 0
        self.own_files: list[str] = []
        self.failed: list[str] = []

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(self, collector: Any) -> Generator[None, Any, Any]:
        """Skip a file that imports a removed module."""
        report = yield
        if report.failed and 'was removed' in str(report.longrepr):
            self.own_files.append(report.nodeid)
            report.outcome, report.result, report.longrepr = 'passed', [], None
        return report

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: Any, call: Any) -> Generator[None, Any, Any]:
        """Count a test."""
        report = yield
        if call.excinfo is not None and is_removal(call.excinfo.value):
            self.own += 1
            report.outcome, report.longrepr = 'skipped', (str(item.path), 0, 'own')
        elif report.failed:
            self.failed.append(report.nodeid)
        elif report.passed and report.when == 'call':
            self.passed += 1
        return report


def run_without(module: str, tests: Sequence[str]) -> dict[str, Any]:
    """Remove a module from this process, and run tests; return the counts."""
    needed_by = remove([module])
    counter = Counter()
    code = pytest.main(['-q', '-p', 'no:cacheprovider', *tests], plugins=[counter])
    if code not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        counter.failed.append(f'pytest ended with {code!r}')
    return {'needed_by': needed_by, **vars(counter)}


def main() -> int:
    """Run the command."""
    modules = {one.module: one.section for one in ADDITIONS}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('modules', nargs='*', metavar='MODULE', help='default: all')
    parser.add_argument('--tests', nargs='+', default=TESTS, metavar='PATH')
    parser.add_argument('--result', type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    unknown = sorted(set(options.modules) - set(modules))
    if unknown:
        parser.error(f'{unknown[0]} is no addition: expected one of {", ".join(modules)}')
    if options.result is not None:
        [module] = options.modules
        options.result.write_text(json.dumps(run_without(module, options.tests)), 'utf-8')
        return 0
    environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
    all_right = True
    print(f'{"removed":34}{"selected by":16}{"passed":>7}{"own":>5}{"failed":>7}  needed by')
    for module in options.modules or modules:
        result = ROOT / '.pytest_cache' / f'without_{module}.json'
        result.parent.mkdir(exist_ok=True)
        result.unlink(missing_ok=True)
        ended = subprocess.run(
            [sys.executable, __file__, module, '--result', str(result), '--tests', *options.tests],
            cwd=ROOT, env=environment, capture_output=True, text=True,
        )
        if not result.exists():
            all_right = False
            print(f'{module:34}{modules[module]:16}  {ended.stderr.strip().splitlines()[-1]}')
            continue
        found = json.loads(result.read_text('utf-8'))
        result.unlink()
        own = found['own'] + len(found['own_files'])
        print(
            f'{module:34}{modules[module]:16}{found["passed"]:7}{own:5}{len(found["failed"]):7}  '
            + ', '.join(found['needed_by']), flush=True
        )
        for name in found['failed']:
            print(f'    {name}')
        all_right = all_right and not found['failed']
    return 0 if all_right else 1


if __name__ == '__main__':
    sys.exit(main())
