# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / 'test'))  # for helpers.py, in every import mode of pytest
sys.path += [str(ROOT / 'tools'), str(ROOT / 'benchmarks')]

# The same examples in every run, without a time limit, because the first one may compile.
settings.register_profile(
    'ratslam', deadline=None, derandomize=True, print_blob=True, max_examples=50
)
settings.load_profile('ratslam')


# A shell starts jobs in the background with SIGINT ignored, which processes of tests inherit.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def signals() -> Iterator[None]:
    """Restore the handler that ``main`` replaces."""
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


@pytest.fixture
def refusal(signals: None, capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Return a function that runs a command that ends with exit code 2 and one line on stderr.

    It returns the line. Lines about compilation, at the first start in a new checkout, do not
    count.
    """
    from ratslam_ros.cli import main

    def run(*words: str) -> str:
        assert main(words) == 2
        out, err = capfd.readouterr()
        [line] = [one for one in err.splitlines() if not one.startswith('compil')]
        assert out == '' and line.startswith('ratslam: ')
        return line

    return run


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Spread the files of each folder over the run: tests that wait run beside others.

    A robot that is simulated in real time beside its nodes comes last, when little else runs.
    """
    folders: dict[Path, list[Path]] = {}
    for path in dict.fromkeys(item.path for item in items):
        folders.setdefault(path.parent, []).append(path)
    place = {path: n / len(files) for files in folders.values() for n, path in enumerate(files)}
    items.sort(key=lambda item: (item.path.name == 'test_closed_loop.py', place[item.path]))


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """List the reasons of skipped tests, each with its number of tests."""
    reasons = Counter(one.longrepr[2] for one in terminalreporter.stats.get('skipped', ()))
    for reason, count in reasons.most_common():
        terminalreporter.write_line(f'{count} skipped: {reason.removeprefix("Skipped: ")}')
