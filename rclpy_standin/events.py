# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Events of publishers and subscriptions: incompatible QoS, lost messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy_standin.dds import Endpoint, StatusChange
from rclpy_standin.node_parts import Waitable
from rclpy_standin.qos import POLICY_KINDS, QoSPolicyKind

Callback = Callable[[Any], None] | None


@dataclass
class MessageLostInfo:
    """Number of messages that were lost before delivery."""

    total_count: int
    total_count_change: int


@dataclass
class IncompatibleQosInfo:
    """Number of endpoints on the topic whose QoS is incompatible."""

    total_count: int
    total_count_change: int
    last_policy_kind: QoSPolicyKind


@dataclass
class SubscriptionEventCallbacks:
    """Callbacks for the events of a subscription."""

    incompatible_qos: Callback = None
    message_lost: Callback = None


class Events:
    """Events of one endpoint, handled in the spinning thread."""

    def __init__(
        self, endpoint: Endpoint, callbacks: SubscriptionEventCallbacks, logger: Any, topic: str
    ) -> None:
        """Watch the statuses that have a callback."""
        is_writer = hasattr(endpoint, 'write')
        remote = 'subscription' if is_writer else 'publisher'

        def warn(event: IncompatibleQosInfo) -> None:
            logger.warning(
                f"New {remote} discovered on topic '{topic}', with incompatible QoS. No messages "
                'will be exchanged with it. Last incompatible policy: '
                f'{event.last_policy_kind.name}'
            )

        self._endpoint = endpoint
        incompatible = f'{"offered" if is_writer else "requested"}_incompatible_qos'
        self._callbacks = {incompatible: callbacks.incompatible_qos or warn}
        if callbacks.message_lost is not None:
            self._callbacks['sample_lost'] = callbacks.message_lost
        endpoint.watch(*self._callbacks)

    def waitable(self) -> Waitable:
        """Return the entity to wait for."""
        return Waitable(self._endpoint.reference, self.execute)

    def execute(self) -> bool:
        """Run the callbacks of all changed statuses; return whether any changed."""
        any_change = False
        for status, callback in self._callbacks.items():
            if not self._endpoint.is_open:  # closed after this was queued, or by the last callback
                break
            change = self._endpoint.take_status(status)
            if change.total_change:
                any_change = True
                callback(_info(status, change))
        return any_change


def _info(status: str, change: StatusChange) -> Any:
    if status == 'sample_lost':
        return MessageLostInfo(change.total, change.total_change)
    kind = POLICY_KINDS.get(change.policy, QoSPolicyKind.INVALID)
    return IncompatibleQosInfo(change.total, change.total_change, kind)
