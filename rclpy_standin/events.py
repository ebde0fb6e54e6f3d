# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Event callbacks of publishers and subscriptions: matches, incompatible QoS, lost messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

from rclpy_standin.dds import Endpoint, StatusChange
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
class MatchedInfo:
    """Number of matched endpoints on the topic."""

    total_count: int
    total_count_change: int
    current_count: int
    current_count_change: int


class _EventCallbacks:
    """Callbacks by event; callbacks for unsupported events raise NotImplementedError."""

    STATUSES: ClassVar[dict[str, str]]
    """DDS status by name of the event."""
    REMOTE: ClassVar[str]
    """Kind of the endpoints at the other side of the topic."""

    def __init__(
        self,
        *,
        incompatible_qos: Callback = None,
        matched: Callback = None,
        message_lost: Callback = None,
        use_default_callbacks: bool = True,
        **others: Callback,
    ) -> None:
        for name, callback in others.items():
            if callback is not None:
                raise NotImplementedError(f'the stand-in for rclpy does not support {name} events')
        self.incompatible_qos = incompatible_qos
        self.matched = matched
        self.message_lost = message_lost
        self.use_default_callbacks = use_default_callbacks

    def by_status(self, logger: Any, topic: str) -> Iterator[tuple[str, Callable[[Any], None]]]:
        """Yield the DDS statuses to watch and their callbacks."""

        def warn(event: IncompatibleQosInfo) -> None:
            logger.warning(
                f"New {self.REMOTE} discovered on topic '{topic}', with incompatible QoS. No "
                f'messages will be exchanged with it. Last incompatible policy: '
                f'{event.last_policy_kind.name}'
            )

        for name, status in self.STATUSES.items():
            callback = getattr(self, name)
            if callback is None and name == 'incompatible_qos' and self.use_default_callbacks:
                callback = warn
            if callback is not None:
                yield status, callback


class SubscriptionEventCallbacks(_EventCallbacks):
    """Callbacks for the events of a subscription."""

    STATUSES: ClassVar[dict[str, str]] = {
        'incompatible_qos': 'requested_incompatible_qos',
        'matched': 'subscription_matched',
        'message_lost': 'sample_lost',
    }
    REMOTE = 'publisher'


class PublisherEventCallbacks(_EventCallbacks):
    """Callbacks for the events of a publisher."""

    STATUSES: ClassVar[dict[str, str]] = {
        'incompatible_qos': 'offered_incompatible_qos',
        'matched': 'publication_matched',
    }
    REMOTE = 'subscription'

    def __init__(self, *, message_lost: None = None, **callbacks: Any) -> None:
        if message_lost is not None:
            raise TypeError('publishers have no message_lost events')
        super().__init__(**callbacks)


class Events:
    """Events of one endpoint, handled in the spinning thread."""

    def __init__(
        self, endpoint: Endpoint, callbacks: _EventCallbacks | None, logger: Any, topic: str
    ) -> None:
        """Watch the statuses that have a callback."""
        if callbacks is None:
            kind = PublisherEventCallbacks if hasattr(endpoint, 'write') else None
            callbacks = (kind or SubscriptionEventCallbacks)()
        self._endpoint = endpoint
        self._callbacks = dict(callbacks.by_status(logger, topic))
        endpoint.watch(*self._callbacks)

    @property
    def reference(self) -> int | None:
        """DDS entity to wait for; None if there are no callbacks."""
        return self._endpoint.reference if self._callbacks else None

    def execute(self) -> bool:
        """Run the callbacks of all changed statuses; return whether any changed."""
        any_change = False
        for status, callback in self._callbacks.items():
            if not self._endpoint.is_open:  # closed after this was queued, or by the last callback
                break
            change = self._endpoint.take_status(status)
            if change.total_change or change.current_change:
                any_change = True
                callback(_info(status, change))
        return any_change


def _info(status: str, change: StatusChange) -> Any:
    if status == 'sample_lost':
        return MessageLostInfo(change.total, change.total_change)
    if status.endswith('_matched'):
        return MatchedInfo(
            change.total, change.total_change, change.current, change.current_change
        )
    kind = POLICY_KINDS.get(change.policy, QoSPolicyKind.INVALID)
    return IncompatibleQosInfo(change.total, change.total_change, kind)
