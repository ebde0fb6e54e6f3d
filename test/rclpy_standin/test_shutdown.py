# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Initialisation, signals, shutdown, and clean exit of processes."""

import signal
import threading
import time
from contextlib import suppress

import pytest
import rclpy
from contract import IS_STAND_IN
from rclpy.context import Context
from rclpy.exceptions import NotInitializedException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from std_msgs.msg import String

SPIN = """
import sys
import threading
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from std_msgs.msg import String
rclpy.init(args=[])
node = rclpy.create_node('spinner')
publisher = node.create_publisher(String, 'chat', 10)
node.create_timer(0.05, lambda: publisher.publish(String(data='x')))
heard = []
def hear(message):
    if not heard:
        print('ready')  # A signal before spinning has another outcome.
    heard.append(message)
node.create_subscription(String, 'chat', hear, 10)
outcome = 'returned'
try:
    if sys.argv[1] == 'rclpy':
        rclpy.spin(node)
    else:
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.spin()
except KeyboardInterrupt:
    outcome = 'KeyboardInterrupt'
except ExternalShutdownException:
    outcome = 'ExternalShutdownException'
except RuntimeError as error:
    outcome = type(error).__name__
finally:
    node.destroy_node()
    rclpy.try_shutdown()
print(outcome, rclpy.ok())
"""


@pytest.mark.parametrize(('number', 'spin_with'), [
    (signal.SIGINT, 'rclpy'), (signal.SIGTERM, 'executor'),
])
def test_signal_ends_spinning(start_process, number, spin_with) -> None:
    process = start_process(SPIN, spin_with)
    assert process.stdout.readline() == 'ready\n', process.stderr.read()
    process.send_signal(number)
    out, err = process.communicate(timeout=20.0)
    assert process.returncode == 0, err
    outcome, ok = out.split()
    if number == signal.SIGINT:
        assert outcome == 'KeyboardInterrupt'
    else:
        # rclpy can raise RCLError if the context is shut down between two waits.
        assert outcome in (
            'ExternalShutdownException',
            'returned',
            *(() if IS_STAND_IN else ('RCLError',)),
        )
    assert ok == 'False' and err == ''


NO_HANDLERS = """
import signal
import rclpy
from rclpy.signals import SignalHandlerOptions
signals = []
signal.signal(signal.SIGTERM, lambda *_: signals.append(1))
rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
node = rclpy.create_node('own')
print('ready')
while not signals:
    rclpy.spin_once(node, timeout_sec=0.1)
assert rclpy.ok()
node.destroy_node()
rclpy.shutdown()
"""


def test_own_signal_handler_is_kept_without_rclpy_handlers(start_process) -> None:
    process = start_process(NO_HANDLERS)
    assert process.stdout.readline() == 'ready\n', process.stderr.read()
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=20.0)
    assert (process.returncode, err) == (0, '')


LEFT_OPEN = """
import rclpy
from std_msgs.msg import String
rclpy.init(args=[])
node = rclpy.create_node('left_open')
publisher = node.create_publisher(String, 'chat', 10)
node.create_subscription(String, 'chat', print, 10)
publisher.publish(String(data='x'))
rclpy.spin_once(node, timeout_sec=0.1)
"""


def test_process_exits_with_entities_left_open(start_process) -> None:
    """Those of the first contexts while further ones are used, and the last ones at the end."""
    ends = 'rclpy.shutdown()\n', 'node.destroy_node()\nrclpy.shutdown()\n', 'del node\n'
    process = start_process(''.join(LEFT_OPEN + end for end in ends))
    _, err = process.communicate(timeout=20.0)
    assert (process.returncode, err) == (0, '')


def test_shutdown_ends_spinning_in_another_thread() -> None:
    rclpy.init(args=[])
    node, ended = rclpy.create_node('n'), []

    def work() -> None:
        with suppress(ExternalShutdownException):
            rclpy.spin(node)
        ended.append(1)

    thread = threading.Thread(target=work)
    thread.start()
    time.sleep(0.3)
    rclpy.shutdown()
    thread.join(10.0)
    assert ended
    node.destroy_node()


def test_init_and_shutdown_can_be_repeated() -> None:
    for _ in range(3):
        assert not rclpy.ok()
        rclpy.init(args=[])
        assert rclpy.ok()
        with pytest.raises(RuntimeError):
            rclpy.init(args=[])
        node = rclpy.create_node('n')
        rclpy.spin_once(node, timeout_sec=0.01)
        node.destroy_node()
        rclpy.shutdown()
    with pytest.raises(RuntimeError):
        rclpy.shutdown()
    rclpy.try_shutdown()


def test_create_node_without_init_raises() -> None:
    with pytest.raises(NotInitializedException):
        rclpy.create_node('n')


def test_nodes_of_separate_contexts_exchange_messages() -> None:
    a, b = Context(), Context()
    rclpy.init(args=[], context=a)
    rclpy.init(args=[], context=b)
    assert not rclpy.ok() and rclpy.ok(context=a)
    sender, receiver = rclpy.create_node('s', context=a), rclpy.create_node('t', context=b)
    publisher, received = sender.create_publisher(String, 'chat', 1), []
    receiver.create_subscription(String, 'chat', received.append, 1)
    executor = SingleThreadedExecutor(context=b)
    executor.add_node(receiver)
    end_s = time.monotonic() + 20.0
    while not received and time.monotonic() < end_s:
        publisher.publish(String(data='x'))
        executor.spin_once(timeout_sec=0.1)
    assert received
    executor.shutdown()
    for node, context in ((sender, a), (receiver, b)):
        node.destroy_node()
        rclpy.shutdown(context=context)
