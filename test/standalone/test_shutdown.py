# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The end: signals, shutdown, and processes that must not hang."""

import signal
import time

import pytest
from contract import IS_STAND_IN

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
node.create_subscription(String, 'chat', lambda m: None, 10)
print('ready')
how = 'returned'
try:
    if sys.argv[1] == 'rclpy':
        rclpy.spin(node)
    else:
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.spin()
except KeyboardInterrupt:
    how = 'KeyboardInterrupt'
except ExternalShutdownException:
    how = 'ExternalShutdownException'
except RuntimeError as error:
    how = type(error).__name__
finally:
    node.destroy_node()
    rclpy.try_shutdown()
print(how, rclpy.ok())
"""


@pytest.mark.parametrize('way', ['rclpy', 'executor'])
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM], ids=lambda n: n.name)
def test_a_signal_ends_spinning(child, number, way) -> None:
    process = child(SPIN, way)
    assert process.stdout.readline() == 'ready\n', process.stderr.read()
    time.sleep(0.2)
    process.send_signal(number)
    out, err = process.communicate(timeout=20.0)
    assert process.returncode == 0, err
    how, ok = out.split()
    if number == signal.SIGINT:
        assert how == 'KeyboardInterrupt'
    else:
        # Between two waits, rclpy can also stumble over the context that is gone.
        assert how in (
            'ExternalShutdownException',
            'returned',
            *(() if IS_STAND_IN else ('RCLError',)),
        )
    assert ok == 'False' and err == ''


NO_HANDLERS = """
import signal
import rclpy
from rclpy.signals import SignalHandlerOptions
asked = []
signal.signal(signal.SIGTERM, lambda *_: asked.append(1))
rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
node = rclpy.create_node('own')
print('ready')
while not asked:
    rclpy.spin_once(node, timeout_sec=0.1)
assert rclpy.ok()
node.destroy_node()
rclpy.shutdown()
"""


def test_a_program_may_handle_signals_itself(child) -> None:
    process = child(NO_HANDLERS)
    assert process.stdout.readline() == 'ready\n', process.stderr.read()
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=20.0)
    assert (process.returncode, err) == (0, '')


LEFT_OPEN = """
import rclpy
from std_msgs.msg import String
rclpy.init(args=[])
node = rclpy.create_node('careless')
publisher = node.create_publisher(String, 'chat', 10)
node.create_subscription(String, 'chat', print, 10)
publisher.publish(String(data='x'))
rclpy.spin_once(node, timeout_sec=0.1)
"""


@pytest.mark.parametrize('end', ['', 'rclpy.shutdown()', 'node.destroy_node()', 'del node'])
def test_nothing_hangs_that_is_left_open(child, end) -> None:
    process = child(LEFT_OPEN + end)
    _, err = process.communicate(timeout=20.0)
    assert (process.returncode, err) == (0, '')


def test_shutdown_wakes_who_spins_in_another_thread(child) -> None:
    process = child("""
import threading, time
import rclpy
from rclpy.executors import ExternalShutdownException
rclpy.init(args=[])
node = rclpy.create_node('n')
ended = []
def work():
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        pass
    ended.append(1)
thread = threading.Thread(target=work)
thread.start()
time.sleep(0.3)
rclpy.shutdown()
thread.join(10.0)
assert ended
node.destroy_node()
""")
    _, err = process.communicate(timeout=30.0)
    assert (process.returncode, err) == (0, '')


def test_init_and_shutdown_any_number_of_times() -> None:
    import rclpy

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


def test_without_init_there_are_no_nodes() -> None:
    import rclpy
    from rclpy.exceptions import NotInitializedException

    with pytest.raises(NotInitializedException):
        rclpy.create_node('n')


def test_a_context_of_ones_own() -> None:
    import rclpy
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import String

    a, b = Context(), Context()
    rclpy.init(args=[], context=a)
    rclpy.init(args=[], context=b)
    assert not rclpy.ok() and rclpy.ok(context=a)
    sender, taker = rclpy.create_node('s', context=a), rclpy.create_node('t', context=b)
    publisher, got = sender.create_publisher(String, 'chat', 1), []
    taker.create_subscription(String, 'chat', got.append, 1)
    executor = SingleThreadedExecutor(context=b)
    executor.add_node(taker)
    end_s = time.monotonic() + 20.0
    while not got and time.monotonic() < end_s:
        publisher.publish(String(data='x'))
        executor.spin_once(timeout_sec=0.1)
    assert got
    executor.shutdown()
    for node, context in ((sender, a), (taker, b)):
        node.destroy_node()
        rclpy.shutdown(context=context)
