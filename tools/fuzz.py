# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzing of the readers of inputs, guided by coverage (atheris): pip install -e '.[fuzz]'.

    python tools/fuzz.py recordings --seconds 600
    python tools/fuzz.py payloads --runs 1000000
    python tools/fuzz.py payloads --input crash-1234       one input again, without atheris

Prints the number of executions and the coverage. An input fails the run if it raises anything
else than a RatslamError, takes more than 1 s of processor time, or more than 512 MiB of memory,
writes outside of its folder, runs a program, unpickles or connects to the network. It is kept as
crash-... in the present folder. Found inputs are kept in --corpus, and used by the next run.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import ratslam_ros
from ratslam_ros.errors import RatslamError

MAX_S = 1.0
MAX_MEMORY_KIB = 512 * 1024
MAX_INPUT_BYTES = 2**16
PACKAGES = ('ratslam_ros', 'ratslam_simulator', 'ratslam_tuning')
INSTRUMENTED = (
    'ratslam_ros.files', 'ratslam_ros.history', 'ratslam_ros.images', 'ratslam_ros.limits',
    'ratslam_ros.maps', 'ratslam_ros.messages', 'ratslam_ros.recordings',
    'ratslam_ros.results.trajectory', 'ratslam_simulator.floor_plan',
)
"""Readers of inputs. Compiled functions cannot be instrumented."""

FORBIDDEN = frozenset({
    'pickle.find_class', 'subprocess.Popen', 'os.system', 'os.exec', 'os.posix_spawn',
    'socket.connect', 'sqlite3.enable_load_extension', 'sqlite3.load_extension', 'os.remove',
    'os.rename', 'os.mkdir', 'os.rmdir', 'os.symlink', 'os.link', 'os.truncate', 'shutil.rmtree',
})
"""Audit events that no input may cause, except for files in the temporary folder."""


class Defect(Exception):  # noqa: N818
    """An input that was not handled as it has to be."""


class Guard:
    """Watches what a target does, by Python's audit events."""

    def __init__(self, folder: Path) -> None:
        self._folder = str(folder.parent)
        self._is_on = False
        self.found: list[str] = []
        sys.addaudithook(self._audit)

    def run(self, target: Any, data: bytes, folder: Path) -> None:
        """Pass data to a target; raises Defect."""
        before = resource.getrusage(resource.RUSAGE_SELF)
        begin_s = time.thread_time()
        self._is_on = True
        try:
            target(data, folder)
        except RatslamError as error:
            if not str(error) or '\n' in str(error):
                raise Defect(f'the error is not one line: {error!r}') from error
        finally:
            self._is_on = False
        took_s = time.thread_time() - begin_s
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before.ru_maxrss
        if took_s > MAX_S:
            raise Defect(f'it took {took_s:.1f} s; expected at most {MAX_S:g} s')
        if grown > MAX_MEMORY_KIB:
            raise Defect(f'it took {grown // 1024} MiB; expected at most {MAX_MEMORY_KIB // 1024}')
        if self.found:
            raise Defect(f'it did what no input may do: {self.found}')

    def _audit(self, event: str, arguments: Any) -> None:
        if not self._is_on:
            return
        if event == 'open':
            path, _, flags = arguments
            is_writing = flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT) if flags else False
            if not is_writing or not isinstance(path, (str, bytes)):
                return
        elif event not in FORBIDDEN:
            return
        names = [os.fsdecode(a) for a in arguments if isinstance(a, (str, bytes))]
        if event in ('os.remove', 'os.rmdir') and not os.path.isabs(names[0]):
            return  # shutil.rmtree, relative to a folder that it has opened
        if not names or not os.path.realpath(names[0]).startswith(self._folder):
            self.found.append(f'{event} {arguments!r:.200}')


def main(arguments: Sequence[str] | None = None) -> int:
    """Fuzz one target."""
    parser = argparse.ArgumentParser(description=str(__doc__).split('\n')[0])
    parser.add_argument('target', help='one of the functions in tools/fuzz_targets.py')
    parser.add_argument('--runs', type=int, default=-1, help='largest number of executions')
    parser.add_argument('--seconds', type=int, default=0, help='longest time')
    parser.add_argument('--corpus', type=Path, help='folder of inputs that increase the coverage')
    parser.add_argument('--input', type=Path, help='file to pass to the target once')
    options = parser.parse_args(arguments)
    sys.path.insert(0, str(Path(__file__).parent))
    with tempfile.TemporaryDirectory(prefix='ratslam-fuzz-') as temporary:
        tempfile.tempdir = temporary  # temporary copies of recordings
        folder = Path(temporary) / 'inputs'
        folder.mkdir()
        if options.input is not None:
            from fuzz_targets import TARGETS

            Guard(folder).run(TARGETS[options.target], options.input.read_bytes(), folder)
            print('handled as it has to be')
            return 0
        return _fuzz(options, folder)


def _fuzz(options: argparse.Namespace, folder: Path) -> int:
    try:
        import atheris
    except ImportError:
        print("tools/fuzz.py needs atheris: pip install -e '.[fuzz]'", file=sys.stderr)
        return 2
    root = Path(ratslam_ros.__file__).parents[1]
    modules = [
        '.'.join(path.relative_to(root).with_suffix('').parts)
        for package in PACKAGES for path in (root / package).rglob('*.py')
    ]
    others = [
        name.removesuffix('.__init__') for name in modules if not name.startswith(INSTRUMENTED)
    ]
    with atheris.instrument_imports(include=[*PACKAGES, 'mcap', 'yaml'], exclude=others):
        import fuzz_targets

        from ratslam_ros.core.warm_up import warm_up
    warm_up('landmark_map')
    corpus = options.corpus or folder.parent / 'corpus'
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(fuzz_targets.seeds(options.target)):
        (corpus / f'seed-{number}').write_bytes(seed)
        with suppress(RatslamError):  # Imports modules, and loads Numba's cache, which is pickled.
            fuzz_targets.TARGETS[options.target](seed, folder)
    dictionary = folder.parent / 'dictionary'
    dictionary.write_text(''.join(
        '"{}"\n'.format(''.join(f'\\x{byte:02x}' for byte in word))
        for word in fuzz_targets.DICTIONARY
    ))
    target, guard = fuzz_targets.TARGETS[options.target], Guard(folder)

    def once(data: bytes) -> None:
        if data:
            guard.run(target, data, folder)

    def mutated(data: bytes, most: int, seed: int) -> bytes:
        changed = fuzz_targets.mutated_json(data, seed) if seed % 2 else None
        return atheris.Mutate(data, most) if changed is None else changed[:most]

    atheris.Setup(
        [
            sys.argv[0], str(corpus), f'-runs={options.runs}', f'-dict={dictionary}',
            f'-max_total_time={options.seconds}', f'-max_len={MAX_INPUT_BYTES}', '-timeout=20',
            '-rss_limit_mb=4096', '-print_final_stats=1',
        ],
        once,
        **({'custom_mutator': mutated} if options.target == 'payloads' else {}),
    )
    atheris.Fuzz()  # ends the process
    return 0


if __name__ == '__main__':
    sys.exit(main())
