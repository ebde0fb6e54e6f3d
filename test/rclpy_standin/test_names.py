# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names, remapping, and ROS arguments."""
from pathlib import Path

import pytest
import rclpy
from rclpy.exceptions import (
    InvalidNamespaceException,
    InvalidNodeNameException,
    InvalidServiceNameException,
    InvalidTopicNameException,
)
from rclpy.utilities import remove_ros_args
from std_msgs.msg import String
from std_srvs.srv import Trigger


def test_relative_and_private_names_expand_to_full_names(ros) -> None:
    node = ros.node('n', namespace='/a/b')
    assert node.get_name() == 'n' and node.get_namespace() == '/a/b'
    assert node.get_fully_qualified_name() == '/a/b/n'
    assert node.resolve_topic_name('x') == '/a/b/x'
    assert node.resolve_topic_name('/x') == '/x'
    assert node.resolve_topic_name('~/x') == '/a/b/n/x'
    assert node.resolve_service_name('x/y') == '/a/b/x/y'
    publisher = node.create_publisher(String, '~/x', 1)
    assert publisher.topic_name == '/a/b/n/x'
    assert ros.node('root').get_namespace() == '/'


def test_remapping_rules_apply_to_topics_services_and_nodes(make_ros) -> None:
    ros = make_ros(
        '--ros-args', '-r', '__ns:=/robot', '-r', '__node:=renamed', '-r', 'image:=/camera/image',
        '--remap', 'odom:=wheels', '-r', '~/private:=public',
    )
    node = ros.node('given', namespace='/elsewhere')
    assert node.get_fully_qualified_name() == '/robot/renamed'
    assert node.resolve_topic_name('image') == '/camera/image'
    assert node.resolve_topic_name('/robot/image') == '/camera/image'
    assert node.resolve_topic_name('/image') == '/image'
    assert node.resolve_topic_name('odom') == '/robot/wheels'
    assert node.resolve_topic_name('~/private') == '/robot/public'
    assert node.resolve_service_name('image') == '/camera/image'
    assert node.create_publisher(String, 'image', 1).topic_name == '/camera/image'


def test_remapping_rule_with_node_name_affects_only_it(make_ros) -> None:
    ros = make_ros('--ros-args', '-r', 'a:x:=y', '-r', 'b:__ns:=/b')
    a, b = ros.node('a'), ros.node('b')
    assert (a.resolve_topic_name('x'), b.resolve_topic_name('x')) == ('/y', '/b/x')


def test_node_can_ignore_the_arguments_of_the_process(make_ros) -> None:
    ros = make_ros('--ros-args', '-r', 'x:=global', '-p', 'p:=1')
    alone = ros.node('m', use_global_arguments=False)
    assert alone.resolve_topic_name('x') == '/x' and alone.declare_parameter('p', 0).value == 0


def test_invalid_names_are_rejected(ros) -> None:
    node = ros.node()
    for topic in ('', 'a//b', '1a', 'a b', 'a-b', 'a/', '{nothing}', 'x' * 300):
        with pytest.raises((InvalidTopicNameException, ValueError)):
            node.create_publisher(String, topic, 1)
    with pytest.raises(InvalidServiceNameException):
        node.create_client(Trigger, 'a b')
    with pytest.raises(InvalidNodeNameException):
        ros.node('a/b')
    with pytest.raises(InvalidNamespaceException):
        ros.node('a', namespace='/a b')


@pytest.mark.parametrize(
    'words',
    [
        ['--unknown'], ['-r', 'nothing'], ['-p', 'a'], ['--log-level', 'loud'],
        ['--params-file', '/no/such/file.yaml'], ['-r'], ['-r', '__node:=a/b'],
    ],
    ids=' '.join,
)
def test_invalid_ros_arguments_are_rejected(words: list[str]) -> None:
    with pytest.raises(RuntimeError):
        rclpy.init(args=['prog', '--ros-args', *words])
    assert not rclpy.ok()


def test_logging_and_non_ros_arguments_are_accepted(make_ros) -> None:
    make_ros(
        'prog', '-x', '--unknown', '--ros-args', '--log-level', 'info', '--log-level', 'a.b:=warn',
        '--disable-rosout-logs', '--enable-stdout-logs', '--disable-external-lib-logs', '--',
        '--unknown', '--ros-args', '-p', 'a:=1',
    )


def test_remove_ros_args_keeps_other_arguments() -> None:
    words = ['prog', '-x', '--ros-args', '-p', 'a:=1', '--', 'rest', '--ros-args', '-r', 'a:=b']
    assert remove_ros_args(words) == ['prog', '-x', 'rest']


def test_invalid_parameter_file_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / 'broken.yaml'
    path.write_text('a: [1, {', encoding='utf-8')
    with pytest.raises(RuntimeError):
        rclpy.init(args=['--ros-args', '--params-file', str(path)])
