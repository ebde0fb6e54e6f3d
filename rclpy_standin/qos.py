# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service profiles."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from rclpy_standin.dds import EndpointQos


class InvalidQoSProfileException(Exception):  # noqa: N818
    """A QoS profile with incomplete settings."""

    def __init__(self, *args: object) -> None:
        super().__init__(f'Invalid QoSProfile: {args}')


class QoSPolicyKind(IntEnum):
    """Kind of a QoS policy, in events."""

    INVALID = 1
    DURABILITY = 2
    DEADLINE = 4
    LIVELINESS = 8
    RELIABILITY = 16
    HISTORY = 32
    LIFESPAN = 64


POLICY_KINDS = {
    2: QoSPolicyKind.DURABILITY,
    4: QoSPolicyKind.DEADLINE,
    8: QoSPolicyKind.LIVELINESS,
    11: QoSPolicyKind.RELIABILITY,
    13: QoSPolicyKind.HISTORY,
    21: QoSPolicyKind.LIFESPAN,
}
"""Policy kind by DDS policy ID."""


class HistoryPolicy(IntEnum):
    """Whether the last ``depth`` messages are kept, or all."""

    SYSTEM_DEFAULT = 0
    KEEP_LAST = 1
    KEEP_ALL = 2


class ReliabilityPolicy(IntEnum):
    """Whether lost messages are retransmitted."""

    SYSTEM_DEFAULT = 0
    RELIABLE = 1
    BEST_EFFORT = 2


class DurabilityPolicy(IntEnum):
    """Whether late-joining subscriptions receive earlier messages."""

    SYSTEM_DEFAULT = 0
    TRANSIENT_LOCAL = 1
    VOLATILE = 2


@dataclass(init=False)
class QoSProfile:
    """Quality of service of a publisher, subscription, service or client."""

    history: HistoryPolicy
    depth: int
    reliability: ReliabilityPolicy
    durability: DurabilityPolicy

    def __init__(
        self, *, history: HistoryPolicy | int | None = None, depth: int | None = None,
        reliability: ReliabilityPolicy | int = ReliabilityPolicy.RELIABLE,
        durability: DurabilityPolicy | int = DurabilityPolicy.VOLATILE, **unsupported: object,
    ) -> None:
        if unsupported:
            raise NotImplementedError(
                f'the stand-in for rclpy does not support {", ".join(unsupported)}'
            )
        if history is None and depth is None:
            raise InvalidQoSProfileException('History and/or depth settings are required.')
        self.history = HistoryPolicy(HistoryPolicy.KEEP_LAST if history is None else history)
        if self.history == HistoryPolicy.KEEP_LAST and depth is None:
            raise InvalidQoSProfileException('History set to KEEP_LAST without a depth setting.')
        self.depth = 10 if depth is None else depth
        if not isinstance(self.depth, int) or self.depth < 0:
            raise ValueError(f'depth {depth!r}: expected an integer >= 0')
        self.reliability = ReliabilityPolicy(reliability)
        self.durability = DurabilityPolicy(durability)


qos_profile_sensor_data = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
qos_profile_services_default = QoSProfile(depth=10)
qos_profile_parameters = QoSProfile(depth=1000)
qos_profile_parameter_events = QoSProfile(depth=1000)


def to_profile(qos: QoSProfile | int) -> QoSProfile:
    """Return a profile; a number stands for KEEP_LAST with that depth."""
    if isinstance(qos, QoSProfile):
        return qos
    if isinstance(qos, int) and not isinstance(qos, bool):
        return QoSProfile(depth=qos)
    raise TypeError(f'Expected QoSProfile or int, but received {type(qos)!r}')


def to_dds(qos: QoSProfile) -> EndpointQos:
    """Convert a profile to the QoS of a DDS endpoint."""
    return EndpointQos(
        None if qos.history == HistoryPolicy.KEEP_ALL else max(1, qos.depth),
        qos.reliability != ReliabilityPolicy.BEST_EFFORT,
        qos.durability == DurabilityPolicy.TRANSIENT_LOCAL,
    )


def from_dds(qos: EndpointQos) -> QoSProfile:
    """Convert the QoS of a discovered endpoint to a profile."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if qos.depth is None else HistoryPolicy.KEEP_LAST,
        depth=qos.depth or 0,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL
        if qos.transient_local
        else DurabilityPolicy.VOLATILE,
    )
