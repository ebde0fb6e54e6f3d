# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The /clock topic while a recording is played."""

from __future__ import annotations

import threading
from typing import Any, Self

from rosgraph_msgs.msg import Clock

from ratslam_ros.live.pacing import Pacing
from ratslam_ros.ros.convert import time_of

CLOCK_PERIOD_S = 0.02


class ClockThread:
    """Context manager that publishes the time of the recording, between messages too."""

    def __init__(self, publisher: Any, pacing: Pacing) -> None:
        self._publisher = publisher
        self._pacing = pacing
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name='clock', daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join()
        self._publish()  # The last time is that of the last message.

    def _run(self) -> None:
        self._publish()
        while not self._stopped.wait(CLOCK_PERIOD_S):
            self._publish()

    def _publish(self) -> None:
        self._publisher.publish(Clock(clock=time_of(self._pacing.time_ns())))
