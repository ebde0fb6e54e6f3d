# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Topics: within a process and between two, with every quality of service."""

import threading

import numpy as np
import pytest


def chat(ros, m, publisher_qos, subscription_qos=None, **options):
    """Return a publisher and a subscription that know each other, and what was received."""
    node, got = ros.node(), []
    subscription_qos = publisher_qos if subscription_qos is None else subscription_qos
    subscription = node.create_subscription(
        m.String, 'chat', lambda msg: got.append(msg.data), subscription_qos, **options
    )
    publisher = node.create_publisher(m.String, 'chat', publisher_qos)
    return publisher, subscription, got


def profile(**options):
    from rclpy.qos import QoSProfile

    return QoSProfile(**options)


@pytest.mark.parametrize('reliable', [True, False], ids=['reliable', 'best effort'])
@pytest.mark.parametrize('latched', [True, False], ids=['transient local', 'volatile'])
@pytest.mark.parametrize('keep_all', [True, False], ids=['keep all', 'keep last'])
def test_messages_arrive_in_order(ros, m, reliable, latched, keep_all) -> None:
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy

    publisher, subscription, got = chat(
        ros,
        m,
        profile(
            history=HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST,
            depth=100,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        ),
    )
    ros.until(lambda: publisher.get_subscription_count())
    ros.until(lambda: subscription.get_publisher_count())
    sent = [str(i) for i in range(50)]
    for text in sent:
        publisher.publish(m.String(data=text))
    ros.until(lambda: len(got) == len(sent))
    assert got == sent
    assert publisher.topic_name == subscription.topic_name == '/chat'


ECHO = """
import rclpy
from std_msgs.msg import String
rclpy.init(args=[])
node = rclpy.create_node('echo')
publisher = node.create_publisher(String, 'back', 10)
node.create_subscription(String, 'there', lambda m: publisher.publish(String(data=m.data * 2)), 10)
rclpy.spin(node)
"""


def test_messages_go_both_ways_between_two_processes(ros, m, child) -> None:
    node, got = ros.node(), []
    publisher = node.create_publisher(m.String, 'there', 10)
    subscription = node.create_subscription(m.String, 'back', lambda msg: got.append(msg.data), 10)
    child(ECHO)
    ros.until(lambda: publisher.get_subscription_count())
    ros.until(lambda: subscription.get_publisher_count())
    publisher.publish(m.String(data='ab'))
    ros.until(lambda: got == ['abab'])


def test_who_comes_late_gets_the_last_of_a_latched_topic(ros, m) -> None:
    from rclpy.qos import DurabilityPolicy, HistoryPolicy

    qos = profile(depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node, got, volatile = ros.node(), [], []
    publisher = node.create_publisher(m.String, 'map', qos)
    for i in range(10):
        publisher.publish(m.String(data=str(i)))
    keep_all = profile(history=HistoryPolicy.KEEP_ALL, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    late = ros.node('late')
    late.create_subscription(m.String, 'map', lambda msg: got.append(msg.data), keep_all)
    late.create_subscription(m.String, 'map', lambda msg: volatile.append(msg.data), 10)
    ros.until(lambda: len(got) == 3)
    ros.spin()
    assert got == ['7', '8', '9'] and volatile == []


def test_a_subscription_keeps_as_many_as_it_says_until_they_are_taken(ros, m) -> None:
    publisher, subscription, got = chat(ros, m, 100, 4)
    ros.until(lambda: publisher.get_subscription_count() and subscription.get_publisher_count())
    for i in range(20):
        publisher.publish(m.String(data=str(i)))
    ros.until(lambda: len(got) == 4)
    ros.spin()
    assert got == ['16', '17', '18', '19']


def test_one_that_keeps_all_loses_nothing(ros, m) -> None:
    from rclpy.qos import HistoryPolicy

    keep_all = profile(history=HistoryPolicy.KEEP_ALL)
    publisher, subscription, got = chat(ros, m, keep_all)
    ros.until(lambda: publisher.get_subscription_count() and subscription.get_publisher_count())
    for i in range(2000):
        publisher.publish(m.String(data=str(i)))
    ros.until(lambda: len(got) == 2000)
    assert got == [str(i) for i in range(2000)]


def test_what_does_not_fit_is_told_to_both(ros, m) -> None:
    from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
    from rclpy.qos import QoSPolicyKind, ReliabilityPolicy

    node, told, got = ros.node(), {}, []
    node.create_publisher(
        m.String,
        'chat',
        profile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT),
        event_callbacks=PublisherEventCallbacks(
            incompatible_qos=lambda event: told.update(publisher=event)
        ),
    )
    node.create_subscription(
        m.String,
        'chat',
        got.append,
        1,
        event_callbacks=SubscriptionEventCallbacks(
            incompatible_qos=lambda event: told.update(subscription=event)
        ),
    )
    ros.until(lambda: len(told) == 2)
    for event in told.values():
        assert event.total_count == event.total_count_change == 1
        assert event.last_policy_kind == QoSPolicyKind.RELIABILITY


def test_matches_are_told(ros, m) -> None:
    from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks

    node, told = ros.node(), []
    publisher = node.create_publisher(
        m.String, 'chat', 1, event_callbacks=PublisherEventCallbacks(matched=told.append)
    )
    subscription = node.create_subscription(
        m.String, 'chat', print, 1, event_callbacks=SubscriptionEventCallbacks(matched=told.append)
    )
    ros.until(lambda: len(told) == 2)
    assert [event.current_count for event in told] == [1, 1]
    assert [event.current_count_change for event in told] == [1, 1]
    node.destroy_subscription(subscription)
    ros.until(lambda: len(told) == 3)
    assert (told[2].total_count, told[2].current_count) == (1, 0)
    assert told[2].current_count_change == -1
    assert publisher.get_subscription_count() == 0


def test_messages_as_bytes(ros, m) -> None:
    from rclpy.serialization import deserialize_message, serialize_message

    data = serialize_message(m.String(data='hello'))
    assert deserialize_message(data, m.String) == m.String(data='hello')
    node, got = ros.node(), []
    publisher = node.create_publisher(m.String, 'chat', 1)
    node.create_subscription(m.String, 'chat', got.append, 1, raw=True)
    ros.until(lambda: publisher.get_subscription_count())
    publisher.publish(bytes(data))
    ros.until(lambda: got)
    assert deserialize_message(bytes(got[0]), m.String).data == 'hello'


def test_a_big_image(ros, m) -> None:
    node, got = ros.node(), []
    pixels = np.random.default_rng(1).integers(0, 256, (1080, 1920, 3), np.uint8)
    publisher = node.create_publisher(m.Image, 'image', 1)
    subscription = node.create_subscription(m.Image, 'image', got.append, 1)
    ros.until(lambda: publisher.get_subscription_count() and subscription.get_publisher_count())
    image = m.Image(height=1080, width=1920, encoding='rgb8', step=5760)
    image.data.frombytes(pixels.tobytes())
    image.header.stamp.sec = 7
    publisher.publish(image)
    ros.until(lambda: got)
    assert np.array_equal(np.frombuffer(got[0].data, np.uint8).reshape(pixels.shape), pixels)
    assert got[0].header.stamp.sec == 7 and got[0].encoding == 'rgb8'


def test_a_callback_may_ask_for_the_times(ros, m) -> None:
    node, got = ros.node(), []
    publisher = node.create_publisher(m.String, 'chat', 1)
    node.create_subscription(m.String, 'chat', lambda msg, info: got.append(info), 1)
    ros.until(lambda: publisher.get_subscription_count())
    publisher.publish(m.String())
    ros.until(lambda: got)
    assert 0 < got[0]['source_timestamp'] <= got[0]['received_timestamp']


def test_any_thread_may_publish_while_another_spins(ros, m) -> None:
    from rclpy.qos import HistoryPolicy

    publisher, subscription, got = chat(ros, m, profile(history=HistoryPolicy.KEEP_ALL))
    ros.until(lambda: publisher.get_subscription_count() and subscription.get_publisher_count())

    def work(name: str) -> None:
        for i in range(200):
            publisher.publish(m.String(data=f'{name} {i}'))

    threads = [threading.Thread(target=work, args=(name,)) for name in 'abc']
    for thread in threads:
        thread.start()
    ros.until(lambda: len(got) == 600)
    for thread in threads:
        thread.join()
    for name in 'abc':
        assert [x for x in got if x[0] == name] == [f'{name} {i}' for i in range(200)]


def test_all_is_acknowledged_in_the_end(ros, m) -> None:
    from rclpy.duration import Duration

    publisher, _, got = chat(ros, m, 10)
    ros.until(lambda: publisher.get_subscription_count())
    publisher.publish(m.String(data='x'))
    assert publisher.wait_for_all_acked(Duration(seconds=10))
    ros.until(lambda: got)


def test_a_subscription_may_go_in_a_callback(ros, m) -> None:
    node, got = ros.node(), []
    publisher = node.create_publisher(m.Int32, 'n', 10)

    def take(msg) -> None:
        got.append(msg.data)
        node.destroy_subscription(subscription)

    subscription = node.create_subscription(m.Int32, 'n', take, 10)
    ros.until(lambda: publisher.get_subscription_count())
    for i in range(3):
        publisher.publish(m.Int32(data=i))
    ros.until(lambda: got)
    ros.spin()
    assert got == [0]
    assert list(node.subscriptions) == []


def test_what_is_of_another_type_is_refused(ros, m) -> None:
    publisher = ros.node().create_publisher(m.String, 'chat', 1)
    with pytest.raises(TypeError):
        publisher.publish(m.Int32())
    with pytest.raises(TypeError):
        publisher.publish('hello')


def test_no_topic_keeps_the_others_waiting(ros, m) -> None:
    node, order = ros.node(), []
    publishers = {}
    for name in 'ab':
        publishers[name] = node.create_publisher(m.Int32, name, 100)
        node.create_subscription(m.Int32, name, lambda _, name=name: order.append(name), 100)
    ros.until(lambda: all(p.get_subscription_count() for p in publishers.values()))
    for name in 'ab':
        for _ in range(20):
            publishers[name].publish(m.Int32())
    ros.until(lambda: len(order) == 40)
    assert set(order[:6]) == {'a', 'b'}
