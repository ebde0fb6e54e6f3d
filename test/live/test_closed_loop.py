# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A simulated robot and all nodes, each in a process: exploration and driving to a goal."""

from __future__ import annotations

import json
import math
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from processes import Commands

RING = """\
name: A ring
cell_m: 0.5
##########
#........#
#.S......#
#........#
#...##...#
#...##...#
#........#
#........#
#........#
##########
"""
RATES = 4.0, 1.0
"""Speeds in units of real time. On a loaded machine, the robot may miss the goal at four times
real time; then it has to reach it in real time."""
OVER_S = 240.0
"""Limit in real time: a loaded machine does not reach the rates."""

NODES = ('local_view', 'pose_cells', 'experience_map', 'goal_follower')

def test_exploring_robot_drives_to_named_goal(
    commands: Commands, here: Callable[..., object], tmp_path: Path
) -> None:
    """``here`` moves this process to the domain of the nodes."""
    plan = tmp_path / 'ring.txt'
    plan.write_text(RING)
    for rate in RATES:
        result = drive(commands, plan, rate)
        if result['status'] == 'succeeded' and result['away_m'] <= 0.5:
            break
    else:
        raise AssertionError(result)
    assert result['goal'] == 'there'


def drive(commands: Commands, plan: Path, rate: float) -> dict[str, Any]:
    """Start all processes, explore, drive to the goal, end them; return the goal's outcome."""
    settings = [
        'goal_follower.explore=true',
        # At four times real time, delays of a loaded machine count four times.
        'inputs.max_lateness_s=4.0',
        # This test is about the processes: tolerate differences caused by their timing.
        'local_view.vt_match_threshold=0.05', 'goal_recall.goal_radius_m=0.1',
    ]
    nodes = commands.start(
        'launch', '--config', 'navigation', '--goal-follower',
        *(word for setting in settings for word in ('--set', setting)),
    )
    assert nodes.stderr is not None
    ready = 0
    while ready < len(NODES):
        line = nodes.stderr.readline()
        assert line, 'a node has ended'
        ready += 'ready' in line
    robot = commands.start(
        'run', 'simulator', '--ros-args', '-p', f'plan:={plan}', '-p', f'rate:={rate}',
        '-p', 'seed:=2', '-p', 'aliasing:=0.0', '-p', 'noise:=0.5', '-p', 'light_change:=0.0',
    )
    result = operate(OVER_S)
    for process in (robot, nodes):
        process.send_signal(signal.SIGINT)
        assert process.wait(20.0) == 0
    return result


def operate(over_s: float) -> dict[str, Any]:
    """Name the place after 5 s of driving; after 40 s, ask for it from 1.5 m away or more."""
    from geometry_msgs.msg import PoseStamped
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import String
    from std_srvs.srv import SetBool

    from ratslam_ros.live import ros
    from ratslam_ros.ros.qos import LATCHED, PLAYED, STATE

    truths: list[tuple[float, float, float]] = []
    statuses: list[dict[str, Any]] = []
    end_s = time.monotonic() + over_s

    def on_truth(message: Any) -> None:
        stamp, at = message.header.stamp, message.pose.position
        truths.append((stamp.sec + stamp.nanosec * 1e-9, at.x, at.y))

    def until(condition: Callable[[], object]) -> None:
        while not condition():
            if time.monotonic() > end_s:
                raise TimeoutError(truths[-1:], statuses[-1:])
            executor.spin_once(timeout_sec=0.1)

    def paused(yes: bool) -> None:
        until(pause.service_is_ready)
        until(pause.call_async(SetBool.Request(data=yes)).done)

    def elapsed_s() -> float:
        return truths[-1][0] - truths[0][0] if truths else 0.0

    def drive_s(duration_s: float) -> None:
        since_s = elapsed_s()
        until(lambda: elapsed_s() > since_s + duration_s)

    with ros.node('operator', ()) as node:
        node.create_subscription(PoseStamped, 'ground_truth/pose', on_truth, STATE)
        node.create_subscription(
            String, 'experience_map/status', lambda m: statuses.append(json.loads(m.data)),
            LATCHED,
        )
        name = node.create_publisher(String, 'experience_map/name_place', PLAYED)
        goal = node.create_publisher(String, 'experience_map/goal', PLAYED)
        pause = node.create_client(SetBool, 'goal_follower/pause')
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        try:
            drive_s(5.0)
            paused(True)
            drive_s(5.0)
            place = truths[-1][1:]
            assert math.dist(truths[-40][1:], place) < 0.01  # It is stationary.
            name.publish(String(data='{"name": "there"}'))
            drive_s(5.0)
            paused(False)
            until(lambda: elapsed_s() > 40.0 and math.dist(truths[-1][1:], place) > 1.5)
            goal.publish(String(data='{"name": "there"}'))
            until(lambda: statuses and statuses[-1]['outcomes'])
            last = statuses[-1]
            at_s = last['stamp']['sec'] + last['stamp']['nanosec'] * 1e-9
            until(lambda: truths[-1][0] >= at_s)
        except TimeoutError as error:
            return {'status': str(error)}
        there = min(truths, key=lambda truth: abs(truth[0] - at_s))
        return {**last['outcomes'][0], 'away_m': math.dist(there[1:], place)}
