# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Logs that are kept: all that a live process has received, and the state that it began from.

A process with `keep_log` moves the files of its log (input_log.py) into a folder beside the map,
where it would remove them otherwise. A run begins with a file NUMBER.json and, if its map was not
empty, the map NUMBER.map; the files of its log follow, with successive numbers. It goes on after
an interruption whose log is complete.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from glob import escape
from itertools import chain, count
from pathlib import Path
from typing import Any

import msgspec

from ratslam_ros.chain import ALONE, Chain
from ratslam_ros.core.common.state import State
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.text import write_durably
from ratslam_ros.maps.input_log import END, Entry, entries_of, kept_folder, log_prefix, used
from ratslam_ros.maps.reader import read_map
from ratslam_ros.maps.saved_map import MapMeta
from ratslam_ros.maps.saving import save_map
from ratslam_ros.pipeline.streams import STREAMS

DIGITS = 9
"""Number of digits of the number of a file."""

PASSED = 'passed'
"""Entry with an item of the stream that a process of a split follows."""

INPUTS = frozenset((*(stream.name for stream in STREAMS if not stream.answers), PASSED))
"""Streams of which entries count as inputs."""


class Beginning(msgspec.Struct, frozen=True):
    """What a run began from.

    parts: the parts of the process, in the direction of flow. configuration: their parameters, as
    YAML. version: that of the log. cut_ns: stamp of the restored state, None for an empty
    map. is_first: whether the first message may belong to another session than that state.
    is_resumed: whether the state contains inputs and settings of the same session.
    was_interrupted: whether messages may come from before the state. settings: commands that were
    in effect. own_stages: stages that are not of this package. chain: place of the process in a
    split.
    """

    parts: tuple[str, ...]
    configuration: str
    version: str
    cut_ns: int | None = None
    is_first: bool = True
    is_resumed: bool = False
    was_interrupted: bool = False
    settings: list[dict[str, Any]] = []
    own_stages: tuple[str, ...] = ()
    chain: Chain = ALONE


@dataclass(frozen=True)
class KeptRun:
    """A run of a process whose log is kept.

    map_file: the map beside which it is. folder: the folder of the process. number: of the run,
    which is that of its first file.
    """

    map_file: Path
    folder: Path
    number: int

    @cached_property
    def beginning(self) -> Beginning:
        """What it began from.

        Raises:
            UnusableInput: its file is damaged.
        """
        path = self._path('.json')
        try:
            return msgspec.json.decode(path.read_bytes(), type=Beginning)
        except (OSError, msgspec.MsgspecError) as error:
            raise UnusableInput(
                f'{path} is damaged ({error}): this log cannot be used; remove the logs with '
                f'ratslam map drop-log {self.map_file}'
            ) from None

    @property
    def states(self) -> Mapping[str, State]:
        """The states of the parts that it began from, {} for an empty map.

        Raises:
            UnusableInput: the file is damaged or missing.
        """
        if self.beginning.cut_ns is None:
            return {}
        return read_map(self._path('.map')).states

    @property
    def files(self) -> list[Path]:
        """The files of the log, oldest first; the last may still lie beside the map."""
        first = self.beginning.parts[0]
        found: list[Path] = []
        for number in count(self.number):
            kept = self._path('', number)
            waiting = Path(f'{log_prefix(self.map_file, first)}{number:0{DIGITS}d}')
            path = next((one for one in (kept, waiting) if one.exists()), None)
            if path is None or (found and self._path('.json', number).exists()):
                return found
            found.append(path)
        return found

    @property
    def time_s(self) -> tuple[float, float]:
        """When it began, and when something was last written, of the clock of the file system."""
        began_s = self._path('.json').stat().st_mtime
        return began_s, max((path.stat().st_mtime for path in self.files), default=began_s)

    def entries(self) -> Iterator[Entry]:
        """Yield what was used, in its order, and at last ``END`` if the run has ended properly."""
        return used(chain.from_iterable(map(entries_of, self.files)))

    @property
    def bytes(self) -> int:
        """The size of all its files."""
        others = [self._path('.json'), self._path('.map')]
        return sum(path.stat().st_size for path in (*self.files, *others) if path.exists())

    def described(self) -> dict[str, Any]:
        """Return its size, number of inputs and length for ``ratslam map info``."""
        inputs, first_ns, last_ns, has_ended = 0, 0, 0, False
        for entry in self.entries():
            has_ended = entry.stream == END
            if entry.stream in INPUTS:
                inputs += 1
                first_ns = min(first_ns or entry.stamp_ns, entry.stamp_ns)
                last_ns = max(last_ns, entry.stamp_ns)
        return {
            'run': self.number, 'parts': [*self.beginning.parts], 'bytes': self.bytes,
            'inputs': inputs, 'duration_s': round((last_ns - first_ns) * 1e-9, 3),
            'has_ended': has_ended,
        }

    def _path(self, suffix: str, number: int | None = None) -> Path:
        return self.folder / f'{self.number if number is None else number:0{DIGITS}d}{suffix}'


class LogKeeper:
    """The folder of a process, which gets the files of its log instead of removing them."""

    def __init__(self, map_file: Path, parts: tuple[str, ...]) -> None:
        """Create the folder.

        Raises:
            UnusableInput: it cannot be created.
        """
        self._map_file = map_file
        self.folder = kept_folder(map_file, parts[0])
        self._loads = 0
        try:
            self.folder.mkdir(exist_ok=True)
        except OSError as error:
            raise UnusableInput(
                f'{self.folder} cannot be created ({error.strerror}), in which the log is kept: '
                'leave out keep_log, or choose another folder for the map'
            ) from None

    def begin(self, number: int, beginning: Beginning, states: Mapping[str, State]) -> bool:
        """Begin a run with a file of the log, or go on with the last run; return whether it began.

        Args:
            number: of the first file since the restored state.
            beginning: what the process begins from.
            states: the restored states, {} for an empty map.

        Raises:
            UnusableInput: it cannot be written.
        """
        runs = _runs_in(self._map_file, self.folder)
        if runs and runs[-1].number <= number:
            last = runs[-1]
            known = last.beginning
            follows = last.number + len(last.files) > number
            if follows and (known.parts, known.configuration, known.version) == (
                beginning.parts, beginning.configuration, beginning.version
            ):
                return False
        if beginning.cut_ns is not None:
            save_map(self.folder / f'{number:0{DIGITS}d}.map', states, MapMeta())
        path = self.folder / f'{number:0{DIGITS}d}.json'
        write_durably(path, msgspec.json.encode(beginning))
        return True

    def loaded(self, number: int, part: str, state: State) -> bytes:
        """Keep a state that replaces that of a part; return the content of its entry."""
        self._loads += 1
        name = f'{number:0{DIGITS}d}-{self._loads}.map'
        save_map(self.folder / name, {part: state}, MapMeta())
        return f'{part}:{name}'.encode()


def loaded_state(folder: Path, data: bytes) -> tuple[str, State]:
    """Return the part and the state that ``LogKeeper.loaded`` has kept.

    Raises:
        UnusableInput: the file is damaged or missing.
    """
    part, _, name = data.decode().partition(':')
    path = folder / Path(name).name
    states = read_map(path).states
    if part not in states:
        raise UnusableInput(f'{path} has no {part}; expected the state that was loaded')
    return part, states[part]


def kept_runs(map_file: Path) -> list[KeptRun]:
    """Return the runs of all processes whose logs are kept beside a map, by folder and number."""
    map_file = map_file.resolve()
    return [run for folder in _folders(map_file) for run in _runs_in(map_file, folder)]


def remove_kept(map_file: Path) -> int:
    """Remove all logs that are kept beside a map; return their size in bytes.

    Raises:
        UnusableInput: they cannot be removed.
    """
    folders = _folders(map_file.resolve())
    size = sum(one.stat().st_size for folder in folders for one in folder.iterdir())
    try:
        for folder in folders:
            shutil.rmtree(folder)
    except OSError as error:
        raise UnusableInput(f'{error.filename} cannot be removed ({error.strerror})') from None
    return size


def _folders(map_file: Path) -> list[Path]:
    return sorted(map_file.parent.glob(f'{escape(map_file.name)}-kept-*'))


def _runs_in(map_file: Path, folder: Path) -> list[KeptRun]:
    numbers = [int(one.stem) for one in folder.glob('*.json') if one.stem.isdecimal()]
    return [KeptRun(map_file, folder, number) for number in sorted(numbers)]
