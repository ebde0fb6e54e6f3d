# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS graph: nodes, topics and services of this process and of another one."""
from rclpy.qos import ReliabilityPolicy
from std_msgs.msg import Int32, String

OTHER = """
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from std_srvs.srv import Trigger
rclpy.init(args=[])
node = rclpy.create_node('other', namespace='/far')
qos = QoSProfile(depth=3, reliability=ReliabilityPolicy.BEST_EFFORT)
publisher = node.create_publisher(String, 'chat', qos)
node.create_subscription(String, '/near', print, 1)
node.create_service(Trigger, 'do', lambda q, r: r)
print('ready')
input()
node.destroy_publisher(publisher)
print('gone')
input()
node.destroy_node()
rclpy.shutdown()
"""


def wait_for_publisher(ros, node, topic: str, owner: str):
    """Return the publisher of a topic, once discovery has assigned it to its node."""
    found = ros.until(
        lambda: [i for i in node.get_publishers_info_by_topic(topic) if i.node_name == owner]
    )
    assert len(found) == len(node.get_publishers_info_by_topic(topic)) == 1
    return found[0]


def test_graph_follows_nodes_and_endpoints_of_another_process(ros, start_process) -> None:
    node = ros.node('near')
    other = start_process(OTHER)
    assert other.stdout.readline() == 'ready\n', other.stderr.read()
    ros.until(lambda: ('other', '/far') in node.get_node_names_and_namespaces())
    ros.until(lambda: node.count_publishers('/far/chat') == 1)
    info = wait_for_publisher(ros, node, '/far/chat', 'other')
    assert (info.node_name, info.node_namespace) == ('other', '/far')
    assert info.topic_type == 'std_msgs/msg/String' and len(info.endpoint_gid) == 16
    assert info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert info.endpoint_type.name == 'PUBLISHER'
    service = ('/far/do', ['std_srvs/srv/Trigger'])
    ros.until(lambda: service in node.get_service_names_and_types())
    topic = ('/far/chat', ['std_msgs/msg/String'])
    ros.until(lambda: topic in node.get_topic_names_and_types())
    ros.until(lambda: node.get_subscriptions_info_by_topic('/near'))
    other.stdin.write('\n')
    other.stdin.flush()
    assert other.stdout.readline() == 'gone\n'
    ros.until(lambda: node.count_publishers('/far/chat') == 0)
    assert node.get_publishers_info_by_topic('/far/chat') == []
    other.stdin.write('\n')
    other.stdin.flush()
    assert other.wait(20.0) == 0
    ros.until(lambda: ('other', '/far') not in node.get_node_names_and_namespaces())


def test_node_lists_itself_and_its_endpoints(ros) -> None:
    node = ros.node('self', namespace='/ns')
    publisher = node.create_publisher(String, 'chat', 7)
    node.create_subscription(String, 'chat', print, 1)
    ros.until(lambda: node.count_publishers('chat') == node.count_subscribers('/ns/chat') == 1)
    ros.until(lambda: 'self' in node.get_node_names())
    assert ('self', '/ns') in node.get_node_names_and_namespaces()
    info = wait_for_publisher(ros, node, 'chat', 'self')
    assert (info.node_name, info.node_namespace) == ('self', '/ns')
    assert info.qos_profile.depth == 7
    assert publisher in node.publishers
    assert node.destroy_publisher(publisher)
    assert not node.destroy_publisher(publisher)
    ros.until(lambda: node.count_publishers('chat') == 0)
    assert publisher not in node.publishers


def test_endpoints_of_two_nodes_have_own_node_names(ros) -> None:
    a, b = ros.node('a'), ros.node('b')
    a.create_publisher(String, 'chat', 1)
    b.create_publisher(String, 'chat', 1)
    ros.until(lambda: len(a.get_publishers_info_by_topic('/chat')) == 2)
    ros.until(
        lambda: {info.node_name for info in a.get_publishers_info_by_topic('/chat')} == {'a', 'b'}
    )
    b.destroy_node()
    ros.until(lambda: [i.node_name for i in a.get_publishers_info_by_topic('/chat')] == ['a'])
    ros.until(lambda: 'b' not in a.get_node_names())
    assert 'a' in a.get_node_names()


def test_topic_with_two_types_lists_both(ros) -> None:
    node = ros.node()
    node.create_publisher(String, 'mixed', 1)
    node.create_subscription(Int32, 'mixed', print, 1)
    expected = ('/mixed', ['std_msgs/msg/Int32', 'std_msgs/msg/String'])
    ros.until(lambda: expected in [(n, sorted(t)) for n, t in node.get_topic_names_and_types()])
