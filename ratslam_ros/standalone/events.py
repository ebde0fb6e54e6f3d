# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What happens to publishers and subscriptions besides messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

from ratslam_ros.standalone.dds import Endpoint, Happened
from ratslam_ros.standalone.qos import KIND_OF_DDS, QoSPolicyKind

Callback = Callable[[Any], None] | None


@dataclass
class MessageLostInfo:
    """Messages that DDS knows of and did not deliver."""

    total_count: int
    total_count_change: int


@dataclass
class IncompatibleQosInfo:
    """Others on the topic whose quality of service does not fit."""

    total_count: int
    total_count_change: int
    last_policy_kind: QoSPolicyKind


@dataclass
class MatchedInfo:
    """Others on the topic that were found, or left."""

    total_count: int
    total_count_change: int
    current_count: int
    current_count_change: int


class _EventCallbacks:
    """Callbacks by event; those that are not offered raise when they are given."""

    STATUSES: ClassVar[dict[str, str]]
    """Name of an event: DDS's name of the status."""
    OTHER: ClassVar[str]

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
                raise NotImplementedError(f'the stand-in for rclpy does not offer {name} events')
        self.incompatible_qos = incompatible_qos
        self.matched = matched
        self.message_lost = message_lost
        self.use_default_callbacks = use_default_callbacks

    def by_status(self, logger: Any, topic: str) -> Iterator[tuple[str, Callable[[Any], None]]]:
        """Yield what is called at which status."""

        def warn(event: IncompatibleQosInfo) -> None:
            logger.warning(
                f"New {self.OTHER} discovered on topic '{topic}', with incompatible QoS. No "
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
    """Callbacks for a subscription's events."""

    STATUSES: ClassVar[dict[str, str]] = {
        'incompatible_qos': 'requested_incompatible_qos',
        'matched': 'subscription_matched',
        'message_lost': 'sample_lost',
    }
    OTHER = 'publisher'


class PublisherEventCallbacks(_EventCallbacks):
    """Callbacks for a publisher's events."""

    STATUSES: ClassVar[dict[str, str]] = {
        'incompatible_qos': 'offered_incompatible_qos',
        'matched': 'publication_matched',
    }
    OTHER = 'subscription'

    def __init__(self, *, message_lost: None = None, **callbacks: Any) -> None:
        if message_lost is not None:
            raise TypeError('publishers have no message_lost events')
        super().__init__(**callbacks)


class Events:
    """The events of one endpoint, taken in the spinning thread."""

    def __init__(
        self, endpoint: Endpoint, callbacks: _EventCallbacks | None, logger: Any, topic: str
    ) -> None:
        """Watch what there are callbacks for."""
        if callbacks is None:
            kind = PublisherEventCallbacks if hasattr(endpoint, 'write') else None
            callbacks = (kind or SubscriptionEventCallbacks)()
        self._endpoint = endpoint
        self._callbacks = dict(callbacks.by_status(logger, topic))
        endpoint.watch(*self._callbacks)

    @property
    def reference(self) -> int | None:
        """What to wait for, None where nobody wants to hear of anything."""
        return self._endpoint.reference if self._callbacks else None

    def execute(self) -> bool:
        """Call back for all that happened; return whether something did."""
        happened = False
        for status, callback in self._callbacks.items():
            change = self._endpoint.take_status(status)
            if change.total_change or change.current_change:
                happened = True
                callback(_info(status, change))
        return happened


def _info(status: str, change: Happened) -> Any:
    if status == 'sample_lost':
        return MessageLostInfo(change.total, change.total_change)
    if status.endswith('_matched'):
        return MatchedInfo(
            change.total, change.total_change, change.current, change.current_change
        )
    kind = KIND_OF_DDS.get(change.policy, QoSPolicyKind.INVALID)
    return IncompatibleQosInfo(change.total, change.total_change, kind)
