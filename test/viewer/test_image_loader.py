# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import queue
import threading
from collections.abc import Callable

from viewer_doubles import FakeRun

from ratslam_ros.viewer.panels.image_loader import ImageLoader


class SlowRun(FakeRun):
    """A run whose images can be held back."""

    def __init__(self) -> None:
        super().__init__(5)
        self.begun, self.release = threading.Event(), threading.Event()
        self.read: list[int] = []

    def image_at(self, stamp_ns: int) -> bytes | None:
        self.read.append(stamp_ns)
        self.begun.set()
        assert self.release.wait(10)
        if stamp_ns < 0:
            raise OSError('the recording is gone')
        return b'%d' % stamp_ns


def test_only_the_newest_of_waiting_requests_is_answered() -> None:
    run, shown = SlowRun(), []
    posted: queue.Queue[Callable[[], None]] = queue.Queue()
    loader = ImageLoader(posted.put)
    loader.request(run, 0, shown.append)
    assert run.begun.wait(10)
    for stamp_ns in range(1, 50):
        loader.request(run, stamp_ns, shown.append)
    run.release.set()
    while len(shown) < 2:
        posted.get(timeout=10)()
    assert run.read == [0, 49]
    assert shown == [b'0', b'49']


def test_unreadable_image_is_none() -> None:
    run, shown = SlowRun(), []
    posted: queue.Queue[Callable[[], None]] = queue.Queue()
    loader = ImageLoader(posted.put)
    run.release.set()
    loader.request(run, -1, shown.append)
    posted.get(timeout=10)()
    assert shown == [None]
