# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read ahead: events and their decoded images from a second thread, in order."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.recordings import Event, ImageEvent, UndecodableImage
from ratslam_ros.timing import StepTimes

BATCH = 16  # events handed over at once
BATCHES = 4  # that wait at most

Decoded = tuple[Event, NDArray[np.uint8] | None]


class ReadAhead(AbstractContextManager['ReadAhead']):
    """Reads and decodes on a second thread, in order, a few events ahead."""

    def __init__(self, events: Iterator[Event], times: StepTimes) -> None:
        self._events = events
        self._times = times
        self._queue: queue.Queue[list[Decoded] | BaseException | None] = queue.Queue(BATCHES)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._read, name='read ahead', daemon=True)
        self._batch: Iterator[Decoded] = iter(())

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        while self._thread.is_alive():  # it may wait for room
            try:
                self._queue.get(timeout=0.05)
            except queue.Empty:
                continue

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Decoded:
        for item in self._batch:
            return item
        batch = self._queue.get()
        if batch is None:
            raise StopIteration
        if isinstance(batch, BaseException):
            raise batch
        self._batch = iter(batch)
        return next(self._batch)

    def _read(self) -> None:
        try:
            batch: list[Decoded] = []
            for event in self._events:
                if self._stopped.is_set():
                    return
                batch.append((event, self._decode(event)))
                if len(batch) == BATCH:
                    self._queue.put(batch)
                    batch = []
            if batch:
                self._queue.put(batch)
            self._queue.put(None)
        except BaseException as error:
            self._queue.put(error)

    def _decode(self, event: Event) -> NDArray[np.uint8] | None:
        if not isinstance(event, ImageEvent):
            return None
        try:
            with self._times('decode'):
                return event.grey()
        except UndecodableImage:
            return None
