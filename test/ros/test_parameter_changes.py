# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters that are set while nodes run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from helpers import START_NS, S, extended
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from ros_messages import MakeWorld, odometry, template
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from test_host_map import crash

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.maps import MapMeta, MapStore, read_map
from ratslam_ros.messages.json_schema import decode
from ratslam_ros.messages.mapping import ActionPayload
from ratslam_ros.pipeline.items import ViewStep
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.ros.local_view_node import LocalViewNode
from ratslam_ros.ros.pose_cells_node import PoseCellsNode
from ratslam_ros.ros.visual_odometry_node import VisualOdometryNode

USES_PARAMETER_SERVICES = True
ENERGY = 'pc_vt_inject_energy'
COUNT, HALF, LAP = 60, 25, 20


def send(made: Any, first: int, last: int) -> None:
    """Send odometry and templates of a robot on a circle to the pose cells."""
    for n in range(first, last):
        stamp_ns = START_NS + n * S // 5
        made.send('odom', odometry(stamp_ns, 6.0, 1.9))
        seen = template(stamp_ns, n % LAP, error=0.5, is_new=n < LAP)
        made.send('local_view/template', seen)


def replayed(energy: float | None) -> list[str]:
    """Return the actions of the same messages in core, with a change at message HALF."""
    slam, steps = RatSLAM(extended(), 'pose_cells'), []
    if energy is not None:
        changed = extended().with_values({f'pose_cells.{ENERGY}': energy})
        slam.reconfigure(changed, START_NS + HALF * S // 5)
    for n in range(COUNT):
        stamp_ns = START_NS + n * S // 5
        steps += slam.odometry(Odometry(stamp_ns, Twist(6.0, 1.9), Pose(0.0, 0.0, 0.0)))
        steps += slam.template(stamp_ns, ViewMatch(n % LAP, n < LAP, 0.5, 0.0))
    return [repr(step.action) for step in steps if isinstance(step, ViewStep)]


def pose_cells(world: MakeWorld, *arguments: str) -> tuple[Any, list[Any]]:
    made = world(PoseCellsNode, arguments=(
        '-p', 'base:=extended', '-p', 'flush_after_s:=60.0', *arguments,
    ))
    actions = made.listen(String, 'pose_cells/action')
    made.nodes[0].host.map.open()
    return made, actions


def decoded(actions: list[Any]) -> list[str]:
    return [repr(decode(ActionPayload, message.data).change) for message in actions]


def set_values(made: Any, **values: Any) -> list[Any]:
    parameters = [
        Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
    ]
    response = made.call(SetParameters, 'pose_cells/set_parameters', parameters=parameters)
    return list(response.results)


def test_value_set_in_mid_run_equals_core_from_the_same_stamp(world: MakeWorld) -> None:
    made, actions = pose_cells(world)
    send(made, 0, HALF)
    made.until(lambda: len(actions) == HALF)
    [result] = set_values(made, **{ENERGY: 0.6})
    assert result.successful, result.reason
    send(made, HALF, COUNT)
    made.until(lambda: len(actions) == COUNT)
    assert decoded(actions) == replayed(0.6)
    assert replayed(0.6) != replayed(None)
    since_ns = START_NS + (HALF - 1) * S // 5 + 1
    values = made.nodes[0].host.live.state_of(made.nodes[0].SECTION)
    assert values['parameters_set'] == [[since_ns, f'pose_cells.{ENERGY}', 0.6]]
    made.until(lambda: 'last_parameter_set' in made.diagnostics().get('pose_cells', {}))
    shown = made.diagnostics()['pose_cells']['last_parameter_set']
    assert shown == f'pose_cells.{ENERGY} 0.6 from {since_ns * 1e-9:.3f} s'


@pytest.mark.parametrize('section', ['pose_cells', 'visual_odometry'])
def test_reset_after_a_set_value_uses_it(world: MakeWorld, section: str) -> None:
    made = world(PoseCellsNode if section == 'pose_cells' else VisualOdometryNode)
    [node] = made.nodes
    name, value = {'pose_cells': (ENERGY, 0.6), 'visual_odometry': ('vtrans_max', 3.0)}[section]
    node.set_parameters([Parameter(name, value=value)])
    assert made.call(Trigger, f'{section}/reset').success
    assert getattr(node._stage.core._p, name) == value


def test_refused_values_change_nothing(world: MakeWorld) -> None:
    made, actions = pose_cells(world)
    send(made, 0, HALF)
    made.until(lambda: len(actions) == HALF)
    wrong: dict[str, tuple[Any, str]] = {
        ENERGY: (-1.0, 'out of range'), 'pc_vt_restore': ('much', ''), 'pc_dim_x': (31, ''),
        'pc_vt_agree_cells': (-1.0, 'not automatic at the start'),
    }
    for name, (value, reason) in wrong.items():
        [result] = set_values(made, **{name: value})
        assert not result.successful
        assert reason in result.reason
        assert '\n' not in result.reason
    send(made, HALF, COUNT)
    made.until(lambda: len(actions) == COUNT)
    assert decoded(actions) == replayed(None)
    assert 'parameters_set' not in made.nodes[0].host.live.state_of(made.nodes[0].SECTION)


def test_values_set_atomically_are_all_refused_with_one(world: MakeWorld) -> None:
    made, _ = pose_cells(world)
    values = [Parameter(ENERGY, value=0.6), Parameter('pc_vt_restore', value=-1.0)]
    response = made.call(
        SetParametersAtomically, 'pose_cells/set_parameters_atomically',
        parameters=[one.to_parameter_msg() for one in values],
    )
    assert not response.result.successful
    assert made.nodes[0].get_parameter(ENERGY).value == 0.15
    assert made.nodes[0].config.pose_cells.pc_vt_inject_energy == 0.15


def switch_off(made: Any) -> None:
    """Have the pose cells only localise the robot."""
    assert made.call(SetBool, 'pose_cells/mapping', data=False).success


@pytest.mark.parametrize('request_', [lambda made: set_values(made, **{ENERGY: 0.6}), switch_off])
def test_restarted_node_repeats_requests(
    world: MakeWorld, tmp_path: Path, request_: Callable[[Any], Any]
) -> None:
    path = tmp_path / 'office.ratslam'
    made, actions = pose_cells(world, '-p', f'map:={path}')
    made.until(lambda: made.nodes[0].host.map.recovery.is_catching_up is False)
    send(made, 0, HALF)
    made.until(lambda: len(actions) == HALF)
    request_(made)
    send(made, HALF, COUNT)
    made.until(lambda: len(actions) == COUNT)
    expected = decoded(actions)
    made.nodes[0].host.map.store.flush(5.0)
    other = MapStore(path, ['experience_map'], MapMeta(), lambda text: None)
    try:
        crash(made)
        again, repeated = pose_cells(world, '-p', f'map:={path}')
        again.until(lambda: again.nodes[0].host.map.recovery.is_catching_up is False)
        again.until(lambda: expected[-1:] == decoded(repeated[-1:]))
        assert decoded(repeated) == expected[-len(repeated) :]
        is_mapping = request_ is not switch_off
        assert again.nodes[0].host.live.is_mapping('pose_cells') == is_mapping
        assert again.nodes[0]._core.mapping == is_mapping
        assert again.nodes[0].get_parameter(ENERGY).value == (0.6 if is_mapping else 0.15)
    finally:
        other.close()
    again.nodes[0].close()
    saved = read_map(path)
    assert ('pc_vt_inject_energy: 0.6' in saved.meta.configuration) == is_mapping
    assert len(saved.states['pose_cells'].get('parameters_set', ())) == is_mapping


def test_image_transport_can_be_changed_while_a_node_runs(world: MakeWorld) -> None:
    made = world(LocalViewNode, arguments=('-p', 'image_transport:=raw'))
    [node] = made.nodes
    assert made.tester.count_subscribers('image/compressed') == 0
    [result] = node.set_parameters([Parameter('image_transport', value='compressed')])
    assert result.successful, result.reason
    made.until(lambda: made.tester.count_subscribers('image/compressed') == 1)
    made.until(lambda: made.tester.count_subscribers('image') == 0)
