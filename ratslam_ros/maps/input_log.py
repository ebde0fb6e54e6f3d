# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Log of what a process has received since its last cuts, in files beside the map file.

A state of a map file and what was received after it give the state at the end, however the process
ended. An entry is written before it is processed, by one call of the operating system, which keeps
it when the process is killed. It is not synchronised with the disk: after a restart of the
machine the log is not used, and the map is that of the newest cut.

Each cut begins a new file, so that what is older than all cuts that may be needed is removed.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from glob import escape
from os import write  # by its name, so that a simulated disk can be full
from pathlib import Path
from typing import NamedTuple

import msgspec

from ratslam_ros.maps.schema import beside
from ratslam_ros.version import __version__

MAX_ENTRY_BYTES = 2**27
"""Largest accepted entry: an image of 128 megapixels, as one is logged that cannot be prepared."""

MAX_FILES = 64
"""Largest number of files: two minutes of cuts at least."""

ATTEMPT, MOST_ATTEMPTS = 'attempt', 2
"""Entry at each restart, and their number after which the last input is left out, as it seems to
end the process."""

END = 'end'
"""Entry at the proper end of a process whose log is kept (kept_log.py)."""

VERSION = f'{__version__}, log format 2'
"""Version of a log: others are not read."""

_HEAD = struct.Struct('<II')
"""Length and checksum of the rest of an entry."""
_BOOT = Path('/proc/sys/kernel/random/boot_id')


class Entry(NamedTuple):
    """What was received: the name of a stream or kind, its stamp and its content."""

    stream: str
    stamp_ns: int
    data: bytes


class Base(NamedTuple):
    """A cut in a map file: inode of the file, session and number. (inode, 0, 0): an empty map."""

    inode: int
    session: int
    number: int


class _Header(msgspec.Struct, array_like=True):
    base: Base | None
    parts: tuple[str, ...]
    boot: str
    version: str
    is_fresh: bool
    was_interrupted: bool


class InputLog:
    """The log of a process that writes some parts of a map."""

    def __init__(
        self, path: Path, parts: Sequence[str], base: Base, is_interrupted: bool = True,
        keep: Path | None = None,
    ) -> None:
        """Read what followed a cut if that was interrupted, and remove the rest.

        Args:
            path: the map file.
            parts: the parts that the process writes.
            base: the cut that it continues from.
            is_interrupted: whether the process was interrupted, as far as the map file knows.
            keep: folder to which files are moved that are not needed any more; None: they are
                removed.
        """
        self._keep = keep
        self._path, self._parts = path, tuple(parts)
        self._files: list[tuple[Base | None, Path]] = []
        """The files that are kept, with the cuts after which they begin, oldest first."""
        self._file: int | None = None
        names = [one.stem for one in kept_folder(path, self._parts[0]).glob('*')]
        self.number = max((int(name) for name in names if name.isdecimal()), default=0)
        """Number of the present file; those that are kept have others."""
        self._refused: tuple[Base | None, bool] | None = None
        """What the present file begins with if the disk has refused it, and nothing was received
        since."""
        self.failed = False
        """Whether something could not be written."""
        self.entries: list[Entry] = []
        """What followed the cut, in the order in which it was received."""
        self.is_known = False
        """Whether the log has recorded what followed the cut."""
        self.is_fresh = True
        """Whether it begins with a start of the process, and not with the cut itself: the inputs
        and settings that the cut contains are those of an earlier run."""
        self.was_interrupted = is_interrupted
        """Whether the process that began it had been interrupted before."""
        found = self._found()
        while found and not (is_interrupted and found[0][0].base == base):
            self._drop([found.pop(0)[1]])
        if found:
            self.is_known, self.is_fresh = True, found[0][0].is_fresh
            self.was_interrupted = found[0][0].was_interrupted
            self._files = [(header.base, file) for header, file in found]
            for _, file in found:
                self.entries += entries_of(file)
        elif self.number:
            self.number += 1  # a gap: this does not follow what was logged before
        self.first = self.number + 1 - len(found)
        """Number of the first file since the restored state."""
        self._begin(None if found else base, is_fresh=True)

    def append(self, stream: str, stamp_ns: int, data: bytes) -> None:
        """Write an entry; if that fails, nothing is known until the next cut."""
        self.begin_again()
        if self._write(stream, stamp_ns, data) or (self._file is None and self._refused is None):
            return
        self.forget()
        self.failed = True
        self.number += 1  # a gap, so that a log that is kept ends here

    def begin_again(self) -> None:
        """Begin the present file if the disk has refused that before."""
        if self._refused is not None:
            self._begin(*self._refused)

    def forget(self) -> None:
        """Remove everything, until the next cut."""
        self._close()
        self._refused = None
        self._drop([file for _, file in self._files])
        self._files.clear()

    def cut(self, base: Base) -> None:
        """Begin a new file: what follows belongs to a new cut.

        The log is forgotten if it has become too long, because no newer cut has been common to
        all processes.
        """
        self._close()
        if len(self._files) >= MAX_FILES:
            self.forget()
        self._begin(base)

    def forget_before(self, base: Base) -> None:
        """Remove what is older than a cut."""
        if any(found == base for found, _ in self._files):
            while self._files[0][0] != base:
                self._drop([self._files.pop(0)[1]])

    def close(self, remove: bool) -> None:
        """End; remove the files if everything is saved."""
        if remove and self._keep is not None:
            self.append(END, 0, b'')
        self._close()
        if remove:
            self._drop([file for _, file in self._files])

    def _drop(self, files: Sequence[Path]) -> None:
        """Remove files that are not needed any more, or let them be kept."""
        if self._keep is None:
            _remove(files)
            return
        for path in files:
            try:
                path.replace(self._keep / path.name.removeprefix(self._prefix.name))
            except OSError:
                self.failed = True
                _remove([path])

    def _found(self) -> list[tuple[_Header, Path]]:
        """Return the files of this log that were written since the machine was started."""
        found: list[tuple[_Header, Path]] = []
        own = self._parts, _boot(), VERSION
        self._remove_others()
        for path in sorted(self._prefix.parent.glob(f'{escape(self._prefix.name)}*')):
            text, header = path.name.removeprefix(self._prefix.name), _header(path)
            if header is None or not text.isdecimal() or not all(own) or (
                (header.parts, header.boot, header.version) != own
            ):
                _remove([path])
                continue
            if found and int(text) != self.number + 1:  # one in between could not be written
                _remove([file for _, file in found])
                found.clear()
            self.number = int(text)
            found.append((header, path))
        return found

    def _remove_others(self) -> None:
        """Remove logs of processes with the same parts in another grouping: none is running."""
        for path in self._path.parent.glob(f'{escape(self._path.name)}-log-*'):
            header = _header(path)
            if header is not None and header.parts[:1] != self._parts[:1] and (
                set(header.parts) & set(self._parts)
            ):
                _remove([path])

    @property
    def _prefix(self) -> Path:
        return log_prefix(self._path, self._parts[0])

    def _begin(self, base: Base | None, is_fresh: bool = False) -> None:
        path = self._prefix.with_name(f'{self._prefix.name}{self.number + 1:09d}')
        header = msgspec.json.encode(
            _Header(
                base, self._parts, _boot(), VERSION, is_fresh, self.was_interrupted
            )
        )
        with suppress(OSError):
            self._file = os.open(
                path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND | os.O_CLOEXEC, 0o666
            )
        if self._write('', 0, header):
            self._refused = None
            self.number += 1
            self._files.append((base, path))
        else:
            self._refused = base, is_fresh
            self._close()
            _remove([path])

    def _write(self, stream: str, stamp_ns: int, data: bytes) -> bool:
        """Write an entry to the present file; return whether all of it is there."""
        if self._file is None:
            return False
        rest = msgspec.msgpack.encode((stream, stamp_ns, data))
        entry = _HEAD.pack(len(rest), zlib.crc32(rest)) + rest
        try:
            return write(self._file, entry) == len(entry)
        except OSError:
            return False

    def _close(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None


def log_prefix(path: Path, part: str) -> Path:
    """Return how the files beside a map begin with the log of the process with a first part."""
    return beside(path, f'-log-{part}-')


def kept_folder(path: Path, part: str) -> Path:
    """Return the folder beside a map with the logs that are kept of such a process."""
    return beside(path, f'-kept-{part}')


def used(entries: Iterable[Entry]) -> Iterator[Entry]:
    """Yield the entries that a process uses: without restarts, and what it did not survive."""
    last, attempts = None, 0
    for entry in entries:
        if entry.stream == ATTEMPT:
            attempts += 1
            continue
        if last is not None and attempts <= MOST_ATTEMPTS:
            yield last
        last, attempts = entry, 0
    if last is not None and attempts <= MOST_ATTEMPTS:
        yield last


def _header(path: Path) -> _Header | None:
    """Return the header of a file, None if it has none."""
    try:
        with path.open('rb') as file:
            found = _read(file.read(2**16))
        if not found or found[0].stream:
            return None
        return msgspec.json.decode(found[0].data, type=_Header)
    except (OSError, msgspec.MsgspecError):
        return None


def entries_of(path: Path) -> list[Entry]:
    """Return the entries of a file up to the first that is not whole."""
    try:
        return _read(path.read_bytes())[1:]
    except OSError:
        return []


def _read(data: bytes) -> list[Entry]:
    found: list[Entry] = []
    at = 0
    while at + _HEAD.size < len(data):
        length, checksum = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        rest = data[at : at + length]
        if length > MAX_ENTRY_BYTES or length != len(rest) or zlib.crc32(rest) != checksum:
            break
        at += length
        try:
            found.append(msgspec.msgpack.decode(rest, type=Entry))
        except msgspec.MsgspecError:  # of an earlier version
            break
    return found


def _remove(files: Sequence[Path]) -> None:
    for path in files:
        with suppress(OSError):
            path.unlink(missing_ok=True)


def _boot() -> str:
    """Return what differs after a restart of the machine; '' if the system does not tell."""
    with suppress(OSError):
        return _BOOT.read_text().strip()
    return ''
