# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that share a host: what each can do although the others run in the same pipeline."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from helpers import PERIOD_NS, START_NS, extended
from ros_messages import MakeWorld, image, odometry, string
from state_digest import digest_of
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from ratslam_ros.errors import UnusableParameter
from ratslam_ros.messages.mapping import Correction
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.ros.convert import header_of
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.host import Host
from ratslam_ros.ros.local_view_node import LocalViewNode
from ratslam_ros.ros.pose_cells_node import PoseCellsNode
from ratslam_ros.ros.visual_odometry_node import VisualOdometryNode

SMALL = extended().with_values({
    'local_view.template_x_size': 16, 'local_view.template_y_size': 8,
    'local_view.vt_shift_match': 2, 'visual_odometry.vtrans_scaling': 1.0,
    'visual_odometry.camera_fov_deg': 10.0,
})


def hosted(world: MakeWorld, *kinds: Any) -> Any:
    """Return a world with nodes that share a host."""
    host = Host()
    made = world(*(partial(kind, SMALL, host) for kind in kinds))
    host.start()
    return made


def mapping_nodes(world: MakeWorld, *before: Any) -> Any:
    return hosted(world, *before, LocalViewNode, PoseCellsNode, ExperienceMapNode)


def drive(made: Any, first: int, last: int) -> None:
    for n in range(first, last):
        stamp_ns = START_NS + n * PERIOD_NS
        made.send('odom', odometry(stamp_ns, 20.0, 0.3))
        made.send('image', image(stamp_ns, n))
        made.spin(0.01)


def test_nodes_of_a_process_with_different_shared_values_are_refused(world: MakeWorld) -> None:
    host, other = Host(), SMALL.with_values({'inputs.max_lateness_s': 7.0})
    world(partial(LocalViewNode, SMALL, host), partial(PoseCellsNode, other, host))
    with pytest.raises(UnusableParameter, match=r'max_lateness_s is 2.0 for local_view and 7.0'):
        host.start()
    del host.nodes[1]
    host.start()


@pytest.mark.parametrize('other', ['', '-p pose_cells:max_lateness_s:=8.0'])
def test_shared_value_of_one_node_is_that_of_its_process(world: MakeWorld, other: str) -> None:
    host, given = Host(), ['-p', 'local_view:max_lateness_s:=7.0', *other.split()]
    made = world(*(partial(kind, SMALL, host) for kind in (LocalViewNode, PoseCellsNode)),
                 arguments=tuple(given))
    if other:
        with pytest.raises(UnusableParameter, match=r'is 7.0 for local_view and 8.0 for pose_'):
            host.start()
        del host.nodes[1]
    host.start()
    assert host.pipeline.max_lateness_ns == 7 * 10**9
    if not other:
        _, cells = made.nodes
        assert cells.get_parameter('max_lateness_s').value == 7.0


def test_paused_map_leaves_the_odometry_to_other_nodes(world: MakeWorld) -> None:
    made = mapping_nodes(world)
    _, cells, graph = made.nodes
    assert made.call(SetBool, 'experience_map/pause', data=True).success
    drive(made, 0, 10)
    made.until(lambda: cells._stage.number >= 8)
    made.until(lambda: cells._stage.motion.state()['last'][0] >= START_NS + 8 * PERIOD_NS)
    assert (len(graph._core), cells.diagnostics.counts['paused']) == (0, 0)
    made.until(lambda: graph.diagnostics.counts['paused'] == 10)
    assert made.call(SetBool, 'experience_map/pause', data=False).success
    drive(made, 10, 20)
    made.until(lambda: len(graph._core) > 0)


def test_map_of_one_process_publishes_corrections(world: MakeWorld) -> None:
    made = mapping_nodes(world, VisualOdometryNode)
    corrections = made.listen(String, Correction.TOPIC)
    for n, seed in enumerate([*range(8)] * 4):
        made.send('image', image(START_NS + n * PERIOD_NS, seed))
    made.until(lambda: corrections)


def test_negative_stamp_is_refused_with_its_reason(world: MakeWorld) -> None:
    made = hosted(world, PoseCellsNode)
    diagnostics = made.nodes[0].diagnostics
    made.send('odom', odometry(-PERIOD_NS))
    made.until(lambda: diagnostics.counts['refused'] == 1)
    assert 'stamps must be 0 or more, and increase' in diagnostics._last_warning


def test_each_node_counts_the_refused_messages_of_its_own_inputs(world: MakeWorld) -> None:
    """After a jump back those are subtracted that are accepted as its beginning."""
    made = mapping_nodes(world)
    view, _, graph = made.nodes
    drive(made, 100, 120)
    for n in range(5):
        made.send('image', image(START_NS + n * PERIOD_NS, n))
    counts = view.diagnostics.counts, graph.diagnostics.counts
    made.until(lambda: counts[0]['refused'] == 5)
    for n in range(5, 25):
        made.send('odom', odometry(START_NS + n * PERIOD_NS, 0.4))
    made.until(lambda: graph.diagnostics.counts['jumps_back'] == 1)
    assert [one['refused'] for one in counts] == [0, 0]


def test_hint_of_later_stamp_waits_in_one_process(world: MakeWorld) -> None:
    made = mapping_nodes(world, VisualOdometryNode)
    graph = made.nodes[-1]
    hint = PoseWithCovarianceStamped(header=header_of(START_NS + 15 * PERIOD_NS, 'map'))
    hint.pose.pose.position.x = 9.0
    hint.pose.covariance[0] = hint.pose.covariance[7] = hint.pose.covariance[35] = 0.1
    for n in range(20):
        made.send('image', image(START_NS + n * PERIOD_NS, n))
        made.until(lambda n=n: graph._stage.late_join._next == n + 1)
        if n == 9:
            made.send('initialpose', hint)
            made.until(lambda: len(graph.host.pipeline._commands) == 1)
        assert len(graph.host.pipeline._commands) == (9 <= n < 15)


def test_services_of_one_process_are_repeated_by_a_replay_of_the_record(world: MakeWorld) -> None:
    made = mapping_nodes(world)
    pipeline = made.nodes[0].host.pipeline
    record: dict[str, list[Any]] = {'command': [], 'odometry': [], 'image': []}
    for stream, found in record.items():
        pipeline.observe(stream, partial(lambda found, *one: found.append(one), found))
    cells = made.nodes[1]._stage

    def reach(first: int, last: int) -> None:
        drive(made, first, last)
        made.until(lambda: len(record['image']) >= last - 1)

    reach(0, 12)
    assert made.call(SetBool, 'local_view/pause', data=True).success
    assert made.call(SetBool, 'pose_cells/mapping', data=False).success
    reach(12, 20)
    assert made.call(SetBool, 'local_view/pause', data=False).success
    assert made.call(SetBool, 'pose_cells/mapping', data=True).success
    reach(20, 30)
    made.send('odom', odometry(START_NS + 30 * PERIOD_NS, 20.0, 0.3))
    made.until(lambda: (len(record['image']), pipeline.order.held) == (30, 1))
    for node in ('experience_map', 'pose_cells', 'local_view'):
        assert made.call(Trigger, f'{node}/reset').success
    assert (pipeline.order.held, len(made.nodes[2]._core), len(cells.core)) == (1, 0, 0)
    reach(30, 40)
    pipeline.finish()
    slam = RatSLAM(made.nodes[0].host.live.config)
    for stream, found in record.items():
        for stamp_ns, item in found:
            slam.pipeline.feed(stream, stamp_ns, item)
    slam.finish()
    assert digest_of(slam.pose_cells.state()) == digest_of(cells.core.state())
    assert digest_of(slam.local_view.state()) == digest_of(made.nodes[0]._core.state())
    assert len(slam.experience_map) == len(made.nodes[2]._core) > 0
    assert (slam.experience_map.poses == made.nodes[2]._core.poses).all()


def test_callbacks_of_the_map_wait_for_the_image_thread(world: MakeWorld) -> None:
    made = mapping_nodes(world)
    graph = made.nodes[-1]
    is_locked: dict[str, bool] = {}

    def watched(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any, **named: Any) -> Any:
            is_locked[name] = graph._lock._is_owned()
            return method(*arguments, **named)

        return run

    goals = graph._goals
    goals.update = watched('timer', goals.update)
    goals._navigator.cancel = watched('service', goals._navigator.cancel)
    graph.diagnostics.drop = watched('report', graph.diagnostics.drop)
    made.send('goal_follower/behaviour', string('{}'))
    assert made.call(Trigger, 'experience_map/cancel_goal')
    made.until(lambda: {'timer', 'service', 'report'} <= set(is_locked))
    assert all(is_locked.values())


@pytest.fixture
def managed(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the function ``managed`` with as much of ROS 2 as it needs."""
    from ratslam_ros.ros.managed import managed

    lifecycle: Any = ModuleType('rclpy.lifecycle')
    lifecycle.LifecycleNodeMixin = type('Mixin', (), {
        '__init__': lambda self: None,
        '_state_machine': SimpleNamespace(current_state=(0, 'inactive')),
    })
    lifecycle.TransitionCallbackReturn = SimpleNamespace(SUCCESS='success', FAILURE='failure')
    monkeypatch.setitem(sys.modules, 'rclpy.lifecycle', lifecycle)
    return managed


def test_managed_nodes_of_one_process_wait_for_activation(world: MakeWorld, managed: Any) -> None:
    made = hosted(world, managed(PoseCellsNode), managed(ExperienceMapNode))
    cells, graph = made.nodes
    made.send('odom', odometry(START_NS))
    made.until(lambda: graph.diagnostics.counts['paused'] == 1)
    assert made.call(SetBool, 'experience_map/pause', data=False).success
    made.send('odom', odometry(START_NS + 1))
    made.until(lambda: graph.diagnostics.counts['paused'] == 2)
    assert graph.on_configure(None) == graph.on_activate(None) == 'success'
    assert not graph._core.covariance.matrix.any()  # the robot was not moved
    made.send('odom', odometry(START_NS + 2))
    made.until(lambda: cells.diagnostics.counts['paused'] == 3)
    assert graph.diagnostics.counts['paused'] == 2
    graph.on_shutdown(None)
    made.send('odom', odometry(START_NS + 3))
    made.until(lambda: graph.diagnostics.counts['paused'] == 3)


def test_node_that_is_paused_before_its_activation_stays_paused(
    world: MakeWorld, managed: Any
) -> None:
    [cells] = hosted(world, managed(PoseCellsNode)).nodes
    cells._on_pause(True)
    cells.on_activate(None)
    assert cells._is_halted
    cells._on_pause(False)
    assert not cells._is_halted
