# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reader of one mcap file, by its index, or by a scan if the index is missing or damaged."""

import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel as ChannelRecord
from mcap.records import Chunk, Schema
from mcap.summary import Summary

from ratslam_ros.recordings.salvage import decompress
from ratslam_ros.recordings.stored_file import Span, StoredFile
from ratslam_ros.recordings.stream import Channel, Warnings

MCAP_MAGIC = b'\x89MCAP0\r\n'
_RECORD = struct.Struct('<BQ')  # Opcode, length.
_MESSAGE = struct.Struct('<HIQQ')  # Channel id, sequence number, log time, publish time.
_TIMES = struct.Struct('<QQ')  # First and last log time, at the beginning of a chunk.
_FOOTER = struct.Struct('<QQI')  # Offsets of summary and summary offset section, checksum.
_INVALID_IN_CHUNK = frozenset({0, Opcode.HEADER})  # Found in a chunk only if it is damaged.
_UNCHUNKED_SPAN_BYTES = 1 << 20  # Approximate size of a span of unchunked messages.


class McapFile(StoredFile):
    """The messages of one mcap file."""

    KIND = 'rosbag2 (mcap)'
    UNREADABLE = (
        'is truncated or damaged and no message in it can be read: expected an mcap file with '
        'messages'
    )

    def __init__(self, path: Path, warnings: Warnings, expected: int | None = None) -> None:
        """Open the file, and scan it if it has no usable index.

        Args:
            path: the file.
            warnings: receives messages for the user.
            expected: number of messages according to the metadata; None if unknown.

        Raises:
            UnusableInput: the file is damaged and no message can be read.
        """
        super().__init__(path, warnings, expected)
        self._schemas: dict[int, str] = {0: ''}
        summary = self._read_summary()
        statistics = summary.statistics if summary else None
        if summary and summary.chunk_indexes:
            self._spans = [
                Span(
                    c.chunk_start_offset, c.chunk_length, c.message_start_time, c.message_end_time
                )
                for c in summary.chunk_indexes
                if c.message_end_time or c.message_index_offsets  # Others hold no messages.
            ]
            if statistics:
                self._counts = Counter(statistics.channel_message_counts)
        elif statistics and statistics.message_count == 0:
            self._counts = Counter()
        else:
            state = self._scan()
            self._counts = self._scanned()
            stored = statistics.message_count if statistics else expected
            if summary is None or (statistics and self._counts.total() < (stored or 0)):
                self._warn_of_recovery(state, stored)
        self.start_ns, self.end_ns = self._times()

    def _read_summary(self) -> Summary | None:
        """Return the summary, None if it is missing or inconsistent with the file."""
        try:
            self._file.seek(-len(MCAP_MAGIC) - _FOOTER.size, 2)
            start, _, checksum = _FOOTER.unpack(self._file.read(_FOOTER.size))
            if self._file.read() != MCAP_MAGIC or not start:
                return None
            self._file.seek(start)
            tail = self._file.read(self._size - start - len(MCAP_MAGIC) - 4)
            if checksum and zlib.crc32(tail) != checksum:
                return None
            self._file.seek(0)
            summary = make_reader(self._file).get_summary()
            if summary is None or any(
                chunk.chunk_start_offset + chunk.chunk_length > self._size
                or chunk.message_start_time > chunk.message_end_time
                for chunk in summary.chunk_indexes
            ):
                return None
            for schema in summary.schemas.values():
                self._schemas[schema.id] = schema.name
            for record in summary.channels.values():
                self._add_channel(record)
            return summary if summary.channels or not summary.chunk_indexes else None
        except Exception:  # The library raises many types on damaged bytes.
            return None

    def _add_channel(self, record: ChannelRecord) -> None:
        self._channels.setdefault(
            record.id,
            Channel(
                record.topic, self._schemas.get(record.schema_id, ''), record.message_encoding
            ),
        )

    def _scan(self) -> str:
        """Collect the channels, message counts and time ranges by reading the whole file.

        Returns:
            What is wrong with the file, as a predicate.
        """
        position, loose = len(MCAP_MAGIC), None
        while position + _RECORD.size <= self._size:
            self._file.seek(position)
            opcode, length = _RECORD.unpack(self._file.read(_RECORD.size))
            whole = position + _RECORD.size + length <= self._size
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return 'has no index or a damaged one'
            elif opcode == Opcode.MESSAGE and whole and length >= _MESSAGE.size:
                channel_id, _, log_ns, _ = _MESSAGE.unpack(self._file.read(_MESSAGE.size))
                if loose is None or loose.length > _UNCHUNKED_SPAN_BYTES:
                    loose = Span(position, 0, log_ns, log_ns)
                    self._spans.append(loose)
                loose.counts[channel_id] += 1
                loose.length = position + _RECORD.size + length - loose.offset
                loose.start_ns = min(loose.start_ns, log_ns)
                loose.end_ns = max(loose.end_ns, log_ns)
            elif opcode in (Opcode.CHUNK, Opcode.SCHEMA, Opcode.CHANNEL):
                self._scan_span(Span(position, _RECORD.size + length, 0, 0))
                loose = None
            elif opcode == 0 or (opcode == Opcode.MESSAGE and whole):
                return 'is damaged'
            if not whole:
                break
            position += _RECORD.size + length
        return 'is truncated'

    def _messages_in(self, span: Span) -> Iterator[tuple[int, int, memoryview]]:
        """Yield (log_ns, channel id, data) for the messages of a span, in file order."""
        self._file.seek(span.offset)
        data = self._file.read(min(span.length, self._size - span.offset))
        yield from self._walk(data, span)

    def _walk(
        self, data: bytes, span: Span, within_chunk: bool = False
    ) -> Iterator[tuple[int, int, memoryview]]:
        view, position = memoryview(data), 0
        while position + _RECORD.size <= len(view):
            opcode, length = _RECORD.unpack_from(view, position)
            position += _RECORD.size
            body = view[position : position + length]
            position += length
            if opcode == Opcode.CHUNK and not within_chunk and len(body) >= _TIMES.size:
                first_ns, last_ns = _TIMES.unpack_from(body)
                for message in self._walk(self._decompressed(body, span), span, within_chunk=True):
                    if not last_ns or first_ns <= message[0] <= last_ns:
                        yield message
                    else:
                        self._warn_of_damage(span)
            elif len(body) < length or opcode in _INVALID_IN_CHUNK:
                self._warn_of_damage(span)
                return
            elif opcode == Opcode.MESSAGE and length >= _MESSAGE.size:
                channel_id, _, log_ns, _ = _MESSAGE.unpack_from(body)
                yield log_ns, channel_id, body[_MESSAGE.size :]
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._add_record(opcode, bytes(body))

    def _add_record(self, opcode: int, body: bytes) -> None:
        try:
            stream = ReadDataStream(BytesIO(body))
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas.setdefault(schema.id, schema.name)
            else:
                self._add_channel(ChannelRecord.read(stream))
        except Exception:  # Messages of a damaged channel record are not attributable.
            self._warnings.add(f'{self.path.name} holds a damaged description of a topic')

    def _decompressed(self, body: memoryview, span: Span) -> bytes:
        """Decompress a chunk, up to the first damage."""
        try:
            chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        except Exception:  # The chunk header is damaged or truncated.
            self._warn_of_damage(span)
            return b''
        plain, whole = decompress(chunk.data, chunk.compression, chunk.uncompressed_size)
        if whole and chunk.uncompressed_crc and zlib.crc32(plain) != chunk.uncompressed_crc:
            whole = False
        if not whole:
            self._warn_of_damage(span)
        return plain
