# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Logging: output format, levels, filters and /rosout."""

import re

import pytest
from rcl_interfaces.msg import Log
from rclpy.logging import get_logger
from rclpy.qos import DurabilityPolicy, QoSProfile

LOG = """
import rclpy
from rclpy.logging import get_logger
rclpy.init(args=ARGS)
node = rclpy.create_node('talker', namespace='/a')
logger = node.get_logger()
logger.debug('hidden')
logger.info('shown')
logger.warning('warned')
logger.warn('warned too')
logger.error('wrong')
logger.fatal('worse')
for i in range(3):
    logger.info(f'throttled {i}', throttle_duration_sec=60.0)
    logger.info(f'once {i}', once=True)
    logger.info(f'later {i}', skip_first=True)
get_logger('free').info('without a node')
node.destroy_node()
rclpy.shutdown()
"""


def run_and_parse(start_process, *args: str) -> list[tuple[str, str, str]]:
    process = start_process(LOG.replace('ARGS', repr(['prog', *args])))
    _, err = process.communicate(timeout=60.0)
    assert process.returncode == 0, err
    found = re.findall(r'^\[(\w+)\] \[\d+\.\d{9}\] \[([\w.]+)\]: (.*)$', err, re.MULTILINE)
    assert len(found) == err.count('\n')
    return found


def test_log_lines_match_ros_format_and_filters(start_process) -> None:
    assert run_and_parse(start_process) == [
        ('INFO', 'a.talker', 'shown'),
        ('WARN', 'a.talker', 'warned'),
        ('WARN', 'a.talker', 'warned too'),
        ('ERROR', 'a.talker', 'wrong'),
        ('FATAL', 'a.talker', 'worse'),
        ('INFO', 'a.talker', 'throttled 0'),
        ('INFO', 'a.talker', 'once 0'),
        ('INFO', 'a.talker', 'later 1'),
        ('INFO', 'a.talker', 'later 2'),
        ('INFO', 'free', 'without a node'),
    ]


def test_log_level_argument_sets_levels(start_process) -> None:
    levels = '--log-level', 'error', '--log-level', 'a.talker:=warn'
    found = run_and_parse(start_process, '--ros-args', *levels)
    assert {level for level, _, _ in found} == {'WARN', 'ERROR', 'FATAL'}
    assert 'free' not in {name for _, name, _ in found}


def test_log_records_are_published_on_rosout(ros) -> None:
    node, received = ros.node('talker'), []
    node.get_logger().warning('careful')
    qos = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    ros.node('listener').create_subscription(Log, '/rosout', received.append, qos)
    ros.until(lambda: [log for log in received if log.msg == 'careful'])
    log = next(log for log in received if log.msg == 'careful')
    assert (log.name, log.level) == ('talker', 30) and log.stamp.sec > 0
    assert log.function == 'test_log_records_are_published_on_rosout' and log.line > 0


def test_logger_without_name_is_rejected() -> None:
    with pytest.raises(ValueError):
        get_logger('')
