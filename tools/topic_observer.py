# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Record topics of running nodes by DDS alone, for same_results.py.

It uses none of the program's modules, so that it observes two versions in the same way. It joins
the domain ROS_DOMAIN_ID on this machine and appends what it receives to the file that it is given:
one JSON object for every message, with `topic` and `data`. Commands are JSON objects on standard
input, one for each line; each is answered with a line on standard output:

    {"do": "publish", "topic": "experience_map/goal", "data": "..."}
    {"do": "endpoints"}
    {"do": "end"}
"""

import json
import os
import sys
import threading
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

LOCAL = (
    '<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast><Interfaces>'
    '<NetworkInterface address="127.0.0.1"/></Interfaces></General><Discovery>'
    '<ParticipantIndex>auto</ParticipantIndex>'
    '<MaxAutoParticipantIndex>120</MaxAutoParticipantIndex>'
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)
"""Configuration that stands for ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST."""

POLL_S = 0.005
TAKEN_COUNT = 1000
MATCH_TIMEOUT_S = 30.0


@dataclass
class String(IdlStruct, typename='std_msgs::msg::dds_::String_'):
    """std_msgs/String."""

    data: str


@dataclass
class Time(IdlStruct, typename='builtin_interfaces::msg::dds_::Time_'):
    """builtin_interfaces/Time."""

    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename='std_msgs::msg::dds_::Header_'):
    """std_msgs/Header."""

    stamp: Time
    frame_id: str


@dataclass
class Point(IdlStruct, typename='geometry_msgs::msg::dds_::Point_'):
    """geometry_msgs/Point."""

    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename='geometry_msgs::msg::dds_::Quaternion_'):
    """geometry_msgs/Quaternion."""

    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename='geometry_msgs::msg::dds_::Pose_'):
    """geometry_msgs/Pose."""

    position: Point
    orientation: Quaternion


@dataclass
class PoseStamped(IdlStruct, typename='geometry_msgs::msg::dds_::PoseStamped_'):
    """geometry_msgs/PoseStamped."""

    header: Header
    pose: Pose


STREAMS: dict[str, Any] = {
    'local_view/template': String,
    'pose_cells/action': String,
    'pose_cells/active_experiences': String,
    'pose_cells/goal_memory': String,
    'experience_map/pose': PoseStamped,
}
LATCHED: dict[str, Any] = {'experience_map/map': String, 'experience_map/status': String}


def quality(latched: bool) -> Qos:
    """Return a reliable profile; a reader keeps all messages until they are taken."""
    return Qos(
        Policy.Reliability.Reliable(duration(seconds=10)),
        Policy.History.KeepAll,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
    )


class Observer:
    """Readers of all observed topics, and writers where something is published."""

    def __init__(self, domain_id: int, output: Path) -> None:
        self._domain = Domain(domain_id, LOCAL)
        self._participant = DomainParticipant(domain_id)
        self._readers = {
            name: DataReader(
                self._participant, Topic(self._participant, f'rt/{name}', kind),
                qos=quality(latched),
            )
            for latched, topics in ((False, STREAMS), (True, LATCHED))
            for name, kind in topics.items()
        }
        self._endpoints = {
            'publisher': BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication),
            'subscriber': BuiltinDataReader(self._participant, BuiltinTopicDcpsSubscription),
        }
        self._writers: dict[str, DataWriter] = {}
        self._output = output.open('a', encoding='utf-8')
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)

    def start(self) -> None:
        """Wait until every topic has a publisher, and begin to record."""
        end_s = time.monotonic() + MATCH_TIMEOUT_S
        while missing := [n for n, r in self._readers.items() if not _matched(r)]:
            if time.monotonic() > end_s:
                sys.exit(f'no publisher for {", ".join(missing)}')
            time.sleep(POLL_S)
        self._thread.start()

    def close(self) -> None:
        """Record what is still there, and end."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        self._output.close()

    def publish(self, name: str, text: str) -> None:
        """Publish a text as soon as there is a subscriber."""
        if name not in self._writers:
            topic = Topic(self._participant, f'rt/{name}', String)
            self._writers[name] = DataWriter(self._participant, topic, qos=quality(False))
        writer = self._writers[name]
        end_s = time.monotonic() + MATCH_TIMEOUT_S
        while not writer.get_matched_subscriptions() and time.monotonic() < end_s:
            time.sleep(POLL_S)
        writer.write(String(data=text))

    def endpoints(self) -> list[str]:
        """Return a line for each publisher and subscriber of other processes."""
        lines: Counter[str] = Counter()
        own = self._participant.guid
        for role, reader in self._endpoints.items():
            for found in reader.read(TAKEN_COUNT):
                alive = found.sample_info.valid_data
                if alive and found.participant_key != own:
                    policies = ' '.join(sorted(
                        str(found.qos[policy])
                        for policy in (Policy.Reliability, Policy.Durability, Policy.History)
                        if policy in found.qos
                    ))
                    lines[f'{role} {found.topic_name} {found.type_name} {policies}'] += 1
        return [f'{count} {line}' for line, count in sorted(lines.items())]

    def _read(self) -> None:
        while True:
            ended = self._ended.is_set()
            for name, reader in self._readers.items():
                for message in reader.take(TAKEN_COUNT):
                    if message.sample_info.valid_data:
                        data = message.data if isinstance(message, String) else _values(message)
                        self._output.write(json.dumps({'topic': name, 'data': data}) + '\n')
            self._output.flush()
            if ended:
                return
            time.sleep(POLL_S)


def _matched(reader: DataReader) -> bool:
    return bool(reader.get_matched_publications())


def _values(message: PoseStamped) -> str:
    """Return all numbers of a pose, as text that gives the same numbers when it is read."""
    stamp, p, q = message.header.stamp, message.pose.position, message.pose.orientation
    numbers = (p.x, p.y, p.z, q.x, q.y, q.z, q.w)
    return f'{stamp.sec}.{stamp.nanosec:09d} {message.header.frame_id} {numbers!r}'


def main() -> None:
    """Observe until standard input ends."""
    observer = Observer(int(os.environ['ROS_DOMAIN_ID']), Path(sys.argv[1]))
    if '--endpoints-only' not in sys.argv:
        observer.start()
    print(json.dumps('ready'), flush=True)
    try:
        for line in sys.stdin:
            command = json.loads(line)
            answer: Any = 'done'
            if command['do'] == 'publish':
                observer.publish(command['topic'], command['data'])
            elif command['do'] == 'endpoints':
                answer = observer.endpoints()
            elif command['do'] == 'end':
                observer.close()
            print(json.dumps(answer), flush=True)
            if command['do'] == 'end':
                break
    finally:
        observer.close()


if __name__ == '__main__':
    main()
