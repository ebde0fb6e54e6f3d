# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Topics within a process and between processes, with different QoS settings."""
import re
import threading
import time

import numpy as np
import pytest
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import Int32, String


def create_chat(ros, publisher_qos, subscription_qos=None, **options):
    """Return a publisher and a subscription of one topic, and the list of received texts."""
    node, received = ros.node(), []
    subscription_qos = publisher_qos if subscription_qos is None else subscription_qos
    subscription = node.create_subscription(
        String, 'chat', lambda msg: received.append(msg.data), subscription_qos, **options
    )
    publisher = node.create_publisher(String, 'chat', publisher_qos)
    return publisher, subscription, received


def profile(**options):
    return QoSProfile(**options)


@pytest.mark.parametrize(('reliable', 'transient_local', 'keep_all'), [
    (True, True, False), (True, False, True), (False, False, False),
])
def test_messages_arrive_in_order_with_every_qos(ros, reliable, transient_local, keep_all) -> None:
    publisher, subscription, received = create_chat(
        ros,
        profile(
            history=HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST,
            depth=100,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL
            if transient_local
            else DurabilityPolicy.VOLATILE,
        ),
    )
    ros.until(lambda: publisher.get_subscription_count())
    ros.until(lambda: subscription.get_publisher_count())
    sent = [str(i) for i in range(50)]
    for text in sent:
        publisher.publish(String(data=text))
    ros.until(lambda: len(received) == len(sent))
    assert received == sent
    assert publisher.topic_name == subscription.topic_name == '/chat'


def test_late_subscription_receives_last_transient_local_messages(ros) -> None:
    qos = profile(depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node, received, volatile = ros.node(), [], []
    publisher = node.create_publisher(String, 'map', qos)
    for i in range(10):
        publisher.publish(String(data=str(i)))
    keep_all = profile(history=HistoryPolicy.KEEP_ALL, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    late = ros.node('late')
    late.create_subscription(String, 'map', lambda msg: received.append(msg.data), keep_all)
    late.create_subscription(String, 'map', lambda msg: volatile.append(msg.data), 10)
    ros.until(lambda: len(received) == 3)
    ros.spin()
    assert received == ['7', '8', '9'] and volatile == []


def test_subscription_keeps_last_messages_up_to_depth(ros) -> None:
    publisher, subscription, received = create_chat(ros, 100, 4)
    ros.until(lambda: publisher.get_subscription_count() and subscription.get_publisher_count())
    for i in range(20):
        publisher.publish(String(data=str(i)))
    ros.until(lambda: len(received) == 4)
    ros.spin()
    assert received == ['16', '17', '18', '19']


def test_incompatible_qos_triggers_an_event(ros) -> None:
    node, events = ros.node(), []
    best_effort = profile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_publisher(String, 'chat', best_effort)
    callbacks = SubscriptionEventCallbacks(incompatible_qos=events.append)
    node.create_subscription(String, 'chat', print, 1, event_callbacks=callbacks)
    ros.until(lambda: events)
    assert events[0].total_count == events[0].total_count_change == 1
    assert events[0].last_policy_kind == QoSPolicyKind.RELIABILITY


def test_incompatible_qos_is_logged_on_both_sides(ros, capfd) -> None:
    node, logged = ros.node(), ''
    best_effort = profile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_publisher(String, 'chat', best_effort)
    node.create_subscription(String, 'chat', print, 1)
    end_s = time.monotonic() + 20.0
    while logged.count('incompatible QoS') < 2 and time.monotonic() < end_s:
        ros.spin()
        logged += capfd.readouterr().err
    for other in 'publisher', 'subscription':
        # rclpy writes the name as given, and "requesting" or "offering".
        text = rf"New {other} discovered on topic '/?chat', \w+ incompatible QoS"
        assert re.search(text, logged)
    assert 'RELIABILITY' in logged


def test_serialised_messages_can_be_published_and_received(ros) -> None:
    data = serialize_message(String(data='hello'))
    assert deserialize_message(data, String) == String(data='hello')
    node, received = ros.node(), []
    publisher = node.create_publisher(String, 'chat', 1)
    node.create_subscription(String, 'chat', received.append, 1, raw=True)
    ros.until(lambda: publisher.get_subscription_count())
    publisher.publish(bytes(data))
    ros.until(lambda: received)
    assert deserialize_message(bytes(received[0]), String).data == 'hello'


def test_large_image_arrives_unchanged(ros) -> None:
    node, received = ros.node(), []
    pixels = np.random.default_rng(1).integers(0, 256, (1080, 1920, 3), np.uint8)
    publisher = node.create_publisher(Image, 'image', 1)
    subscription = node.create_subscription(Image, 'image', received.append, 1)
    ros.until(lambda: publisher.get_subscription_count() and subscription.get_publisher_count())
    image = Image(height=1080, width=1920, encoding='rgb8', step=5760)
    image.data.frombytes(pixels.tobytes())
    image.header.stamp.sec = 7
    publisher.publish(image)
    ros.until(lambda: received)
    assert np.array_equal(np.frombuffer(received[0].data, np.uint8).reshape(pixels.shape), pixels)
    assert received[0].header.stamp.sec == 7 and received[0].encoding == 'rgb8'


def test_several_threads_publish_while_another_spins(ros) -> None:
    publisher, subscription, received = create_chat(
        ros, profile(history=HistoryPolicy.KEEP_ALL)
    )
    ros.until(lambda: publisher.get_subscription_count() and subscription.get_publisher_count())

    def publish_texts(name: str) -> None:
        for i in range(200):
            publisher.publish(String(data=f'{name} {i}'))

    threads = [threading.Thread(target=publish_texts, args=(name,)) for name in 'abc']
    for thread in threads:
        thread.start()
    ros.until(lambda: len(received) == 600)
    for thread in threads:
        thread.join()
    for name in 'abc':
        assert [x for x in received if x[0] == name] == [f'{name} {i}' for i in range(200)]


def test_wait_for_all_acked_returns_after_delivery(ros) -> None:
    publisher, _, received = create_chat(ros, 10)
    ros.until(lambda: publisher.get_subscription_count())
    publisher.publish(String(data='x'))
    assert publisher.wait_for_all_acked(Duration(seconds=10))
    ros.until(lambda: received)


def test_subscription_can_be_destroyed_in_its_callback(ros) -> None:
    node, received = ros.node(), []
    publisher = node.create_publisher(Int32, 'n', 10)

    def receive_one(msg) -> None:
        received.append(msg.data)
        node.destroy_subscription(subscription)

    subscription = node.create_subscription(Int32, 'n', receive_one, 10)
    ros.until(lambda: publisher.get_subscription_count())
    for i in range(3):
        publisher.publish(Int32(data=i))
    ros.until(lambda: received)
    ros.spin()
    assert received == [0]
    assert list(node.subscriptions) == []


def test_publishing_wrong_type_raises_type_error(ros) -> None:
    publisher = ros.node().create_publisher(String, 'chat', 1)
    with pytest.raises(TypeError):
        publisher.publish(Int32())
    with pytest.raises(TypeError):
        publisher.publish('hello')


def test_busy_topic_does_not_starve_others(ros) -> None:
    node, order = ros.node(), []
    publishers = {}
    for name in 'ab':
        publishers[name] = node.create_publisher(Int32, name, 100)
        node.create_subscription(Int32, name, lambda _, name=name: order.append(name), 100)
    ros.until(lambda: all(p.get_subscription_count() for p in publishers.values()))
    for name in 'ab':
        for _ in range(20):
            publishers[name].publish(Int32())
    ros.until(lambda: len(order) == 40)
    assert set(order[:6]) == {'a', 'b'}
