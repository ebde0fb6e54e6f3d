# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS graph: nodes, topics, services and endpoints in the domain."""

from __future__ import annotations

import re
import threading
from collections import defaultdict
from collections.abc import Iterable
from enum import IntEnum
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from rclpy_standin import names
from rclpy_standin.dds import DiscoveredEndpoint, EndpointQos, Participant
from rclpy_standin.qos import QoSProfile, from_dds
from rclpy_standin.types import decode_or_none, encode, message_class

_DISCOVERY_TOPIC = 'ros_discovery_info'
_DISCOVERY_TYPE = 'rmw_dds_common/msg/ParticipantEntitiesInfo'
UNKNOWN_NAME, UNKNOWN_NAMESPACE = '_NODE_NAME_UNKNOWN_', '_NODE_NAMESPACE_UNKNOWN_'

NamesAndTypes = list[tuple[str, list[str]]]


class NodeName(NamedTuple):
    """A node's name and namespace."""

    name: str
    namespace: str


class TopicEndpointTypeEnum(IntEnum):
    """Kind of a topic endpoint."""

    INVALID = 0
    PUBLISHER = 1
    SUBSCRIPTION = 2


class TopicEndpointInfo(NamedTuple):
    """A publisher or subscription, with the name of its node."""

    node_name: str
    node_namespace: str
    topic_type: str
    endpoint_type: TopicEndpointTypeEnum
    endpoint_gid: list[int]
    qos_profile: QoSProfile


class Graph:
    """Announces the nodes of one participant, and collects those of all participants."""

    def __init__(self, participant: Participant) -> None:
        """Create the reader and writer of the discovery topic."""
        self._participant = participant
        self._own: dict[NodeName, tuple[set[bytes], set[bytes]]] = {}
        """GIDs of the readers and writers of each own node."""
        self._latest: dict[bytes, Any] = {}
        """Latest announcement of each participant, by GUID prefix."""
        self._lock = threading.RLock()
        # The topic has no key: a KEEP_LAST reader would drop announcements of other participants.
        self._reader = participant.reader(
            _DISCOVERY_TOPIC, _DISCOVERY_TYPE, EndpointQos(None, True, True)
        )
        self._writer = participant.writer(
            _DISCOVERY_TOPIC, _DISCOVERY_TYPE, EndpointQos(1, True, True)
        )
        message_class(_DISCOVERY_TYPE)

    def close(self) -> None:
        """Delete the reader and writer of the discovery topic."""
        self._reader.close()
        self._writer.close()

    # Announcements of own nodes

    def add_node(self, node: NodeName) -> None:
        """Announce a node."""
        with self._lock:
            self._own[node] = (set(), set())
            self._publish()

    def remove_node(self, node: NodeName) -> None:
        """Withdraw a node."""
        with self._lock:
            self._own.pop(node, None)
            self._publish()

    def add(
        self, node: NodeName, readers: Iterable[bytes] = (), writers: Iterable[bytes] = ()
    ) -> None:
        """Announce endpoints of a node, given by their GIDs."""
        with self._lock:
            if node in self._own:
                self._own[node][0].update(readers)
                self._own[node][1].update(writers)
                self._publish()

    def remove(self, node: NodeName, gids: Iterable[bytes]) -> None:
        """Withdraw endpoints of a node."""
        with self._lock:
            if node in self._own:
                for own_gids in self._own[node]:
                    own_gids.difference_update(gids)
                self._publish()

    def _publish(self) -> None:
        info = message_class('rmw_dds_common/msg/NodeEntitiesInfo')
        message = message_class(_DISCOVERY_TYPE)(
            gid=_gid(self._participant.gid),
            node_entities_info_seq=[
                info(
                    node_namespace=node.namespace,
                    node_name=node.name,
                    reader_gid_seq=[_gid(gid) for gid in sorted(readers)],
                    writer_gid_seq=[_gid(gid) for gid in sorted(writers)],
                )
                for node, (readers, writers) in self._own.items()
            ],
        )
        self._writer.write(encode(message))

    # Queries

    def nodes(self) -> list[NodeName]:
        """Return all nodes."""
        return [
            NodeName(node.node_name, node.node_namespace)
            for announcement in self._announcements()
            for node in announcement.node_entities_info_seq
        ]

    def count(self, topic: str, kind: str) -> int:
        """Return the number of endpoints on a DDS topic; ``kind`` is writer or reader."""
        return sum(found.topic == topic for found in self._participant.endpoints(kind))

    def topics(self) -> NamesAndTypes:
        """Return all topics and their types."""
        return _group_types(
            (names.topic_from_dds(found.topic), _type_of(found))
            for kind in ('writer', 'reader')
            for found in self._participant.endpoints(kind)
        )

    def services(self) -> NamesAndTypes:
        """Return all services and their types."""
        return _group_types(
            _service_of(found)
            for kind in ('writer', 'reader')
            for found in self._participant.endpoints(kind)
        )

    def endpoints(self, topic: str, kind: str) -> list[TopicEndpointInfo]:
        """Return the endpoints on a DDS topic; ``kind`` is writer or reader."""
        on_topic = [one for one in self._participant.endpoints(kind) if one.topic == topic]
        if not on_topic:
            return []
        owners = {
            bytes(gid.data): (node.node_name, node.node_namespace)
            for announcement in self._announcements()
            for node in announcement.node_entities_info_seq
            for gid in (node.writer_gid_seq if kind == 'writer' else node.reader_gid_seq)
        }
        endpoint_type = (
            TopicEndpointTypeEnum.PUBLISHER
            if kind == 'writer'
            else TopicEndpointTypeEnum.SUBSCRIPTION
        )
        return [
            TopicEndpointInfo(
                *owners.get(found.gid, (UNKNOWN_NAME, UNKNOWN_NAMESPACE)),
                names.type_from_dds(found.type),
                endpoint_type,
                list(found.gid),
                from_dds(found.qos),
            )
            for found in on_topic
        ]

    def _announcements(self) -> list[Any]:
        with self._lock:
            kind = message_class(_DISCOVERY_TYPE)
            while taken := self._reader.take(lambda data: decode_or_none(data, kind)):
                if taken.value is not None:
                    self._latest[bytes(taken.value.gid.data)[:12]] = taken.value
            present = self._participant.participants()
            for gone in set(self._latest) - present:
                del self._latest[gone]
            return list(self._latest.values())


def _service_of(found: DiscoveredEndpoint) -> tuple[str | None, str]:
    service = names.service_from_dds(found.topic)
    return service[0] if service else None, re.sub('_(Request|Response)$', '', _type_of(found))


def _type_of(found: DiscoveredEndpoint) -> str:
    return names.type_from_dds(found.type)


@lru_cache(4096)
def _gid(gid: bytes) -> Any:
    """Return the message of a GID, which is only encoded and never changed."""
    return message_class('rmw_dds_common/msg/Gid')(data=np.frombuffer(gid, np.uint8))


def _group_types(pairs: Iterable[tuple[str | None, str]]) -> NamesAndTypes:
    """Return names and their types, sorted; pairs without a name are dropped."""
    found: dict[str, set[str]] = defaultdict(set)
    for name, kind in pairs:
        if name is not None:
            found[name].add(kind)
    return [(name, sorted(kinds)) for name, kinds in sorted(found.items())]
