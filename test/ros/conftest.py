# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes in the test process, on rclpy if it is installed, else on the stand-in for it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from typing import Any
from unittest.mock import patch

import pytest
from contract import IS_STAND_IN, pytest_pycollect_makemodule
from helpers import live_environment

from ratslam_ros.core.warm_up import warm_up

__all__ = ['pytest_pycollect_makemodule']

os.environ.update(live_environment())
TIMEOUT_S = 20.0


class World:
    """The nodes under test and a tester node that communicates with them, on one executor."""

    def __init__(self, makers: tuple[Callable[[], Any], ...], arguments: tuple[str, ...]) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        rclpy.init(args=['--ros-args', *arguments] if arguments else [])
        self.executor = SingleThreadedExecutor()
        self.nodes = [make() for make in makers]
        self.tester = rclpy.create_node(
            'tester', use_global_arguments=False, start_parameter_services=False,
            enable_rosout=False,
        )
        self.publishers: dict[str, Any] = {}
        for node in (*self.nodes, self.tester):
            self.executor.add_node(node)

    def close(self) -> None:
        import rclpy

        for node in self.nodes:
            node.close()
        for node in (*self.nodes, self.tester):
            self.executor.remove_node(node)
            node.destroy_node()
        self.executor.shutdown()
        rclpy.try_shutdown()

    def until(self, condition: Callable[[], Any], timeout_s: float = TIMEOUT_S) -> None:
        """Spin until a condition holds; fail after the timeout."""
        end_s = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end_s, f'not within {timeout_s} s'
            self.executor.spin_once(timeout_sec=0.02)

    def spin(self, duration_s: float) -> None:
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            self.executor.spin_once(timeout_sec=0.02)

    def listen(self, kind: type, topic: str, qos: Any = None) -> list[Any]:
        """Subscribe to a topic; return a list to which each message is appended."""
        from ratslam_ros.ros.qos import INPUT

        received: list[Any] = []
        self.tester.create_subscription(kind, topic, received.append, qos or INPUT)
        self.until(lambda: self.tester.count_publishers(topic) > 0)
        return received

    def send(self, topic: str, message: Any, qos: Any = None) -> None:
        """Publish a message, after waiting for a subscriber."""
        from ratslam_ros.ros.qos import PLAYED

        if topic not in self.publishers:
            publisher = self.tester.create_publisher(type(message), topic, qos or PLAYED)
            self.until(lambda: publisher.get_subscription_count() > 0)
            self.publishers[topic] = publisher
        self.publishers[topic].publish(message)

    def call(self, kind: type, name: str, **fields: Any) -> Any:
        """Call a service and return the response."""
        client = self.tester.create_client(kind, name)
        self.until(client.service_is_ready)
        future = client.call_async(kind.Request(**fields))  # type: ignore[attr-defined]
        self.until(future.done)
        self.tester.destroy_client(client)
        return future.result()

    def diagnostics(self) -> dict[str, dict[str, str]]:
        """Return what each node under test publishes as diagnostics, by its name."""
        found: dict[str, dict[str, str]] = {}
        for node in self.nodes:
            with patch.object(node.diagnostics, '_publisher') as publisher:
                node._publish_diagnostics()  # the timer does once a second
            [status] = publisher.publish.call_args.args[0].status
            level = status.level
            number = level[0] if isinstance(level, bytes) else int(level)
            found[node.get_name()] = {
                **{item.key: item.value for item in status.values},
                'level': str(number), 'message': status.message,
            }
        return found

    def reported(self, name: str, **expected: str) -> dict[str, str]:
        """Wait until the diagnostics of a node have these values, and return all of them."""
        end_s = time.monotonic() + TIMEOUT_S
        while True:
            found = self.diagnostics()[name]
            if all(found.get(key) == value for key, value in expected.items()):
                return found
            assert time.monotonic() < end_s, f'{name} has {found}; expected {expected}'
            self.executor.spin_once(timeout_sec=0.02)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Let nodes act more often, and wait less for others, which are in the same process here.

    Their parameter services, half of their endpoints, are created only in files that use them.
    """
    if IS_STAND_IN and not getattr(request.module, 'USES_PARAMETER_SERVICES', False):
        monkeypatch.setattr('rclpy_standin.node.create_parameter_services', lambda *_: None)
    monkeypatch.setattr('ratslam_ros.ros.node.FLUSH_CHECK_PERIOD_S', 0.02)
    monkeypatch.setattr('ratslam_ros.ros.plain_node.DIAGNOSTICS_PERIOD_S', 0.2)
    monkeypatch.setattr('ratslam_ros.ros.restart.recovery.LEAST_S', 0.3)


@pytest.fixture(scope='session', autouse=True)
def warm() -> None:
    """Compile before the time limit of any test runs, as nodes do before they are ready."""
    warm_up()
    warm_up('scan_alignment', 'relocation', 'goal_recall', 'goal_memory')
    warm_up('goal_follower', 'landmark_map')


@pytest.fixture
def world(quick: None) -> Iterator[Callable[..., World]]:
    """Return a factory of Worlds; its ``arguments`` are those after --ros-args."""
    made: list[World] = []

    def make(*makers: Callable[[], Any], arguments: tuple[str, ...] = ()) -> World:
        made.append(World(makers, arguments))
        return made[-1]

    yield make
    import rclpy

    for one in made:
        one.close()
    rclpy.try_shutdown()
