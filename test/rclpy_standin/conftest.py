# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures of tests that run on the stand-in or, if ROS 2 is installed, on the real rclpy."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from contract import ROOT, pytest_pycollect_makemodule
from domains import own_domain

__all__ = ['pytest_pycollect_makemodule']

PRELUDE = 'from rclpy_standin import install\ninstall()\n'
TIMEOUT_S = 20.0


@pytest.fixture(scope='session', autouse=True)
def domain() -> Iterator[None]:
    """Use a separate domain for each test process, limited to this machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('ROS_DOMAIN_ID', str(own_domain()))
        patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        yield


class Ros:
    """rclpy between init and shutdown, with one executor."""

    def __init__(self) -> None:
        from rclpy.executors import SingleThreadedExecutor

        self.executor = SingleThreadedExecutor()
        self._nodes: list[Any] = []

    def node(self, name: str = 'node', **options: Any) -> Any:
        import rclpy

        node = rclpy.create_node(name, **options)
        self._nodes.append(node)
        self.executor.add_node(node)
        return node

    def until(self, condition: Callable[[], Any], timeout_s: float = TIMEOUT_S) -> Any:
        """Spin until a condition is true, and return its value."""
        end_s = time.monotonic() + timeout_s
        while not (value := condition()):
            assert time.monotonic() < end_s, 'timed out while waiting for a condition'
            self.executor.spin_once(timeout_sec=0.02)
        return value

    def spin(self, seconds: float = 0.1) -> None:
        """Spin for a fixed time, to show that something does not happen."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.executor.spin_once(timeout_sec=0.02)

    def call(self, client: Any, request: Any) -> Any:
        assert client.wait_for_service(timeout_sec=TIMEOUT_S)
        future = client.call_async(request)
        self.executor.spin_until_future_complete(future, timeout_sec=TIMEOUT_S)
        assert future.done()
        return future.result()

    def close(self) -> None:
        for node in self._nodes:
            node.destroy_node()
        self.executor.shutdown()


@pytest.fixture
def make_ros() -> Iterator[Callable[..., Ros]]:
    """Return a function that initialises rclpy with a command line."""
    import rclpy

    started = []

    def make(*args: str) -> Ros:
        rclpy.init(args=list(args))
        started.append(Ros())
        return started[-1]

    yield make
    for ros in started:
        ros.close()
    rclpy.try_shutdown()


@pytest.fixture
def ros(make_ros: Callable[..., Ros]) -> Ros:
    return make_ros()


@pytest.fixture
def start_process() -> Iterator[Callable[..., Any]]:
    """Return a function that starts a Python process with unbuffered output pipes."""
    started = []

    def start(code: str, *args: str) -> Any:
        process = subprocess.Popen(
            [sys.executable, '-u', '-c', PRELUDE + code, *args], text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            env={**os.environ, 'PYTHONPATH': os.pathsep.join([str(ROOT), *sys.path[1:]])},
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()
