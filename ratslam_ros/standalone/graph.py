# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The graph: which nodes there are, and what they publish, subscribe to and offer."""

from __future__ import annotations

import re
import threading
from collections import defaultdict
from collections.abc import Iterable
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from ratslam_ros.standalone import names
from ratslam_ros.standalone.dds import Discovered, EndpointQos, Participant
from ratslam_ros.standalone.qos import QoSProfile, from_dds
from ratslam_ros.standalone.types import decode_or_none, encode, message_class

_TOPIC = 'ros_discovery_info'
_INFO = 'rmw_dds_common/msg/ParticipantEntitiesInfo'
UNKNOWN_NAME, UNKNOWN_NAMESPACE = '_NODE_NAME_UNKNOWN_', '_NODE_NAMESPACE_UNKNOWN_'

NamesAndTypes = list[tuple[str, list[str]]]


class NodeName(NamedTuple):
    """A node's name and namespace."""

    name: str
    namespace: str


class TopicEndpointTypeEnum(IntEnum):
    """What an endpoint is."""

    INVALID = 0
    PUBLISHER = 1
    SUBSCRIPTION = 2


class TopicEndpointInfo(NamedTuple):
    """A publisher or subscription, and whose it is."""

    node_name: str
    node_namespace: str
    topic_type: str
    endpoint_type: TopicEndpointTypeEnum
    endpoint_gid: list[int]
    qos_profile: QoSProfile


class Graph:
    """What one participant tells of its nodes, and knows of all others."""

    def __init__(self, participant: Participant) -> None:
        """Begin to tell and to listen."""
        self._participant = participant
        self._own: dict[NodeName, tuple[set[bytes], set[bytes]]] = {}
        """Readers and writers by node."""
        self._nodes: dict[bytes, Any] = {}
        """What each participant told last."""
        self._lock = threading.RLock()
        # No key tells the participants apart: a reader that keeps the last one forgets others.
        self._reader = participant.reader(_TOPIC, _INFO, EndpointQos(None, True, True))
        self._writer = participant.writer(_TOPIC, _INFO, EndpointQos(1, True, True))
        message_class(_INFO)

    def close(self) -> None:
        """Tell and listen no longer."""
        self._reader.close()
        self._writer.close()

    # What is told

    def add_node(self, node: NodeName) -> None:
        """Announce a node."""
        with self._lock:
            self._own[node] = (set(), set())
            self._tell()

    def remove_node(self, node: NodeName) -> None:
        """Take a node back."""
        with self._lock:
            self._own.pop(node, None)
            self._tell()

    def add(
        self, node: NodeName, readers: Iterable[bytes] = (), writers: Iterable[bytes] = ()
    ) -> None:
        """Announce a node's endpoints."""
        with self._lock:
            if node in self._own:
                self._own[node][0].update(readers)
                self._own[node][1].update(writers)
                self._tell()

    def remove(self, node: NodeName, gids: Iterable[bytes]) -> None:
        """Take endpoints back."""
        with self._lock:
            if node in self._own:
                for known in self._own[node]:
                    known.difference_update(gids)
                self._tell()

    def _tell(self) -> None:
        info = message_class('rmw_dds_common/msg/NodeEntitiesInfo')
        message = message_class(_INFO)(
            gid=_gid(self._participant.gid),
            node_entities_info_seq=[
                info(
                    node_namespace=node.namespace,
                    node_name=node.name,
                    reader_gid_seq=[_gid(of) for of in sorted(readers)],
                    writer_gid_seq=[_gid(of) for of in sorted(writers)],
                )
                for node, (readers, writers) in self._own.items()
            ],
        )
        self._writer.write(encode(message))

    # What is known

    def nodes(self) -> list[NodeName]:
        """Return all nodes."""
        return [
            NodeName(node.node_name, node.node_namespace)
            for told in self._told()
            for node in told.node_entities_info_seq
        ]

    def count(self, topic: str, kind: str) -> int:
        """Return how many endpoints (``writer``, ``reader``) there are on a topic of DDS."""
        return sum(found.topic == topic for found in self._participant.endpoints(kind))

    def topics(self, mangled: bool = False) -> NamesAndTypes:
        """Return all topics and their types."""
        return _listed(
            (found.topic if mangled else names.topic_from_dds(found.topic), _type_of(found))
            for kind in ('writer', 'reader')
            for found in self._participant.endpoints(kind)
        )

    def services(self) -> NamesAndTypes:
        """Return all services and their types."""
        return _listed(map(_service_of, [*self._all('reader'), *self._all('writer')]))

    def endpoints(self, topic: str, kind: str) -> list[TopicEndpointInfo]:
        """Return the endpoints on a topic of DDS."""
        owners = {
            bytes(gid.data): (node.node_name, node.node_namespace)
            for told in self._told()
            for node in told.node_entities_info_seq
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
            for found in self._all(kind)
            if found.topic == topic
        ]

    def _all(self, kind: str) -> list[Discovered]:
        return self._participant.endpoints(kind)

    def _told(self) -> list[Any]:
        with self._lock:
            kind = message_class(_INFO)
            while taken := self._reader.take(lambda data: decode_or_none(data, kind)):
                if taken.value is not None:
                    self._nodes[bytes(taken.value.gid.data)[:12]] = taken.value
            present = self._participant.participants()
            for gone in set(self._nodes) - present:
                del self._nodes[gone]
            return list(self._nodes.values())


def _service_of(found: Discovered) -> tuple[str | None, str]:
    service = names.service_from_dds(found.topic)
    return service[0] if service else None, re.sub('_(Request|Response)$', '', _type_of(found))


def _type_of(found: Discovered) -> str:
    return names.type_from_dds(found.type)


def _gid(gid: bytes) -> Any:
    return message_class('rmw_dds_common/msg/Gid')(data=np.frombuffer(gid, np.uint8))


def _listed(pairs: Iterable[tuple[str | None, str]]) -> NamesAndTypes:
    found: dict[str, set[str]] = defaultdict(set)
    for name, kind in pairs:
        if name is not None:
            found[name].add(kind)
    return [(name, sorted(kinds)) for name, kinds in sorted(found.items())]
