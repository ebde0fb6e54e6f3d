# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publishing without loss while subscribers are slow."""

from __future__ import annotations

import time
from typing import Any

from ratslam_ros.errors import UnusableInput

SEND_TIMEOUT_S = 30.0
RETRY_S = 0.002


def send(publisher: Any, message: Any, timeout_s: float = SEND_TIMEOUT_S) -> None:
    """Publish a message; repeat it while the middleware refuses it.

    Fast DDS waits 0.1 s for slow subscribers, and then refuses the message.

    Raises:
        UnusableInput: the message is still refused after `timeout_s`.
    """
    end_s = time.monotonic() + timeout_s
    while True:
        try:
            publisher.publish(message)
        except RuntimeError as error:
            if time.monotonic() > end_s:
                raise UnusableInput(
                    f'{publisher.topic_name}: publishing failed for {timeout_s:g} s ({error}); '
                    'look for a subscriber that hangs'
                ) from None
            time.sleep(RETRY_S)
        else:
            return
