# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reader of one ROS 1 bag (format 2.0), by its index, or by a scan if it was not closed.

Source: http://wiki.ros.org/Bags/Format/2.0. The rosbags library is not used for this because it
keeps an entry for every message in memory and rejects bags without an index.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings.salvage import decompress
from ratslam_ros.recordings.stored_file import Span, StoredFile
from ratslam_ros.recordings.stream import Channel, Warnings

ROSBAG1_MAGIC = b'#ROSBAG V2.0\n'
_U32 = struct.Struct('<I')
_TIME = struct.Struct('<II')
_MESSAGE, _BAG_HEADER, _CHUNK, _CHUNK_INFO, _CONNECTION = b'\2', b'\3', b'\5', b'\6', b'\7'
_MAX_HEADER_BYTES = 1 << 20  # A longer header is taken for damage.


class _Damaged(Exception):  # noqa: N818
    """The bytes are not a valid record."""


class Rosbag1File(StoredFile):
    """The messages of one ROS 1 bag."""

    KIND = 'ROS 1 bag'
    UNREADABLE = (
        'was not closed properly and no message in it can be read: expected a ROS 1 bag with '
        'messages'
    )

    def __init__(self, path: Path, warnings: Warnings, expected: int | None = None) -> None:
        """Open the bag, and scan it if it has no usable index.

        Args:
            path: the file.
            warnings: receives messages for the user.
            expected: number of messages according to the metadata; None if unknown.

        Raises:
            UnusableInput: the bag is encrypted, or no message can be read.
        """
        super().__init__(path, warnings, expected)
        self._index_pos = 0  # Offset of the index, the size of all chunks before it.
        try:
            if not self._read_index():
                self._scan()
        except UnusableInput:
            self.close()
            raise
        self._counts = self._scanned()
        self.start_ns, self.end_ns = self._times()

    def _record(self, position: int) -> tuple[dict[bytes, bytes], int, int]:
        """Return the header fields of a record and the begin and end offsets of its data."""
        self._file.seek(position)
        size = self._file.read(4)
        if len(size) < 4 or _U32.unpack(size)[0] > _MAX_HEADER_BYTES:
            raise _Damaged
        header = self._file.read(_U32.unpack(size)[0] + 4)
        if len(header) < _U32.unpack(size)[0] + 4:
            raise _Damaged
        begin = position + 4 + len(header)
        return _fields(memoryview(header)[:-4]), begin, begin + _U32.unpack(header[-4:])[0]

    def _read_index(self) -> bool:
        """Read connections and chunk positions from the index; return False if it is unusable."""
        try:
            header, _, _ = self._record(len(ROSBAG1_MAGIC))
            if header.get(b'encryptor'):
                raise UnusableInput(
                    f'{self.path} is encrypted: expected a plain ROS 1 bag; decrypt it with '
                    '"rosbag decrypt"'
                )
            position = self._index_pos = struct.unpack('<Q', header[b'index_pos'])[0]
            if header[b'op'] != _BAG_HEADER or not 0 < position <= self._size:
                return False
            while position < self._size:
                header, begin, position = self._record(position)
                self._file.seek(begin)
                data = self._file.read(position - begin)
                if header[b'op'] == _CONNECTION:
                    self._add_connection(header, memoryview(data))
                elif header[b'op'] == _CHUNK_INFO:
                    self._spans.append(
                        Span(
                            struct.unpack('<Q', header[b'chunk_pos'])[0], 0,
                            _nanoseconds(header[b'start_time']),
                            _nanoseconds(header[b'end_time']),
                            Counter(dict(struct.iter_unpack('<II', data))),
                        )
                    )
            return all(span.offset < self._size for span in self._spans)
        except (_Damaged, KeyError, struct.error):
            return False

    def _scan(self) -> None:
        """Collect the connections, message counts and time ranges by reading the whole file."""
        self._spans, position = [], len(ROSBAG1_MAGIC)
        whole = True
        while position < self._size:
            try:
                header, _, end = self._record(position)
            except _Damaged:
                whole = False
                break
            if header.get(b'op') == _CHUNK:
                self._scan_span(Span(position, 0, 0, 0))
            position = end
        expected = self._expected
        if expected is None and self._index_pos > self._size:
            expected = round(self._scanned().total() * self._index_pos / self._size)
        is_complete = whole and position == self._size
        self._warn_of_recovery('has no index' if is_complete else 'is truncated', expected)

    def _messages_in(self, span: Span) -> Iterator[tuple[int, int, memoryview]]:
        """Yield (log_ns, connection id, data) for the messages of a chunk, in file order."""
        try:
            header, begin, end = self._record(span.offset)
            compression = header[b'compression'].decode(errors='replace')
            size = _U32.unpack(header[b'size'])[0]
        except (_Damaged, KeyError, struct.error):
            compression = ''
        if compression not in ('none', 'bz2', 'lz4'):
            self._warn_of_damage(span)
            return
        self._file.seek(begin)
        plain, whole = decompress(self._file.read(end - begin), compression, size)
        view, position = memoryview(plain), 0
        while position + 8 <= len(view):
            try:
                start = position + 4 + _U32.unpack_from(view, position)[0]
                length = _U32.unpack_from(view, start)[0]
                header = _fields(view[position + 4 : start])
                data = view[start + 4 : start + 4 + length]
                if len(data) < length:
                    raise _Damaged
                if header[b'op'] == _MESSAGE:
                    yield (_nanoseconds(header[b'time']), _U32.unpack(header[b'conn'])[0], data)
                elif header[b'op'] == _CONNECTION:
                    self._add_connection(header, data)
            except (_Damaged, KeyError, struct.error):
                whole = False
                break
            position = start + 4 + length
        if not whole and end <= self._size:  # Truncation has its own warning.
            self._warn_of_damage(span)

    def _add_connection(self, header: dict[bytes, bytes], data: memoryview) -> None:
        """Add the channel that a connection record describes."""
        about = _fields(data)
        kind = about.get(b'type', b'').decode(errors='replace')
        self._channels.setdefault(
            _U32.unpack(header[b'conn'])[0],
            Channel(header.get(b'topic', b'').decode(errors='replace'), kind, 'ros1'),
        )


def _fields(data: memoryview) -> dict[bytes, bytes]:
    """Split a record header into its fields, each stored as a length and name=value."""
    fields, position = {}, 0
    while position < len(data):
        if position + 4 > len(data):
            raise _Damaged
        begin = position + 4
        position = begin + _U32.unpack_from(data, position)[0]
        name, equals, value = bytes(data[begin:position]).partition(b'=')
        if not equals or position > len(data):
            raise _Damaged
        fields[name] = value
    return fields


def _nanoseconds(data: bytes) -> int:
    seconds, nanoseconds = _TIME.unpack(data)
    return int(seconds * 1_000_000_000 + nanoseconds)
