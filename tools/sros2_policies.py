# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writes policies/ratslam.policy.xml, the SROS 2 policy of all nodes, from their interfaces.

    python tools/sros2_policies.py            writes the policy
    python tools/sros2_policies.py --check    exit code 1 if it is not up to date

Every node is created with all of its optional functions, without ROS on the stand-in. It may
publish, subscribe, reply and request exactly what it creates then, and what it creates only for a
while: see ``_add_temporary``. Actions, and the messages of Nav2, which the stand-in does not have,
are replaced by classes that only record their names. docs/security.md describes the use of the
policy.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from enum import Enum
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.sax.saxutils import escape, quoteattr

POLICY = Path(__file__).parents[1] / 'policies' / 'ratslam.policy.xml'

OPTIONS = (
    'exp_align_scans:=true', 'exp_relocate:=both', 'fov_from_camera_info:=true',
    'goal_memory.goal_memory:=true', 'pc_cell_x_size:=1.0', 'vt_match_ratio:=-1.0',
    'use_sim_time:=true',
)
"""Parameters that add interfaces."""

SONARS = {f'sonar_{number}' for number in range(8)}
"""Topics of a simulator with sonars, and of pose_cells once its grid has a subscriber."""

FOLLOWED = {'pose_cells': 'local_view', 'experience_map': 'pose_cells'}
"""Node whose stream each of these follows in a split."""

INPUTS = {
    'image', 'image/compressed', 'odom', 'scan', 'local_view/template', 'pose_cells/action',
}
"""Topics of which a node with a map file receives the history after an interruption."""

Interfaces = dict[str, set[str]]
GROUPS = {
    'execute': ('actions', 'action'), 'call': ('actions', 'action'),
    'reply': ('services', 'service'), 'request': ('services', 'service'),
    'publish': ('topics', 'topic'), 'subscribe': ('topics', 'topic'),
}
"""Elements of the policy for a group of names and for a name, by kind."""


def interfaces() -> dict[str, Interfaces]:
    """Return the names that each node uses, by kind, with absolute topics beginning with /."""
    from rclpy_standin import install

    install()
    _stand_in_for_nav2()
    import rclpy

    with tempfile.TemporaryDirectory() as folder:
        arguments = [*OPTIONS, f'map:={folder}/all.map', f'memory_folder:={folder}']
        given = [word for option in arguments for word in ('-p', option)]
        rclpy.init(args=['--ros-args', *given])
        try:
            found = {
                kind.SECTION: _of_node(kind, folder) for kind in _node_classes()
            }
        finally:
            rclpy.try_shutdown()
    _add_temporary(found)
    return found


def _node_classes() -> list[Any]:
    from ratslam_ros.ros.experience_map_node import ExperienceMapNode
    from ratslam_ros.ros.landmark_map_node import LandmarkMapNode
    from ratslam_ros.ros.local_view_node import LocalViewNode
    from ratslam_ros.ros.navigation.goal_follower_node import GoalFollowerNode
    from ratslam_ros.ros.navigation.route_server_graph_node import RouteServerGraphNode
    from ratslam_ros.ros.navigation.route_to_nav2_node import RouteToNav2Node
    from ratslam_ros.ros.pose_cells_node import PoseCellsNode
    from ratslam_ros.ros.viewing.viewer_node import ViewerNode
    from ratslam_ros.ros.visual_odometry_node import VisualOdometryNode
    from ratslam_simulator.node import SimulatorNode

    return [
        VisualOdometryNode, LocalViewNode, PoseCellsNode, ExperienceMapNode, GoalFollowerNode,
        RouteToNav2Node, RouteServerGraphNode, LandmarkMapNode, SimulatorNode, ViewerNode,
    ]


_ACTIONS: list[tuple[Any, str, str]] = []
"""Node, kind and name of all actions that were created."""


class _ActionServer:
    KIND = 'execute'

    def __init__(self, node: Any, _: Any, name: str, *args: Any, **options: Any) -> None:
        _ACTIONS.append((node, self.KIND, name))

    def destroy(self) -> None:
        """Do nothing."""


class _ActionClient(_ActionServer):
    KIND = 'call'


class _Response(Enum):
    ACCEPT = 1


def _stand_in_for_nav2() -> None:
    """Make what the nodes import for Nav2 importable on the stand-in for rclpy."""
    from std_msgs.msg import String
    from std_srvs.srv import Trigger

    message: Any = type('Message', (), {})
    for name, content in {
        'nav2_msgs': {},
        'nav2_msgs.action': dict.fromkeys(
            ('FollowPath', 'NavigateThroughPoses', 'NavigateToPose'), message
        ),
        'nav2_msgs.srv': dict.fromkeys(('DynamicEdges', 'SetRouteGraph'), Trigger),
        'action_msgs': {},
        'action_msgs.msg': {'GoalStatus': message, 'GoalStatusArray': String},
        'rclpy.action': {
            'ActionClient': _ActionClient, 'ActionServer': _ActionServer,
            'CancelResponse': _Response, 'GoalResponse': _Response,
        },
    }.items():
        sys.modules[name] = ModuleType(name)
        vars(sys.modules[name]).update(content)


def _of_node(kind: Any, folder: str) -> Interfaces:
    """Create a node and return its interfaces."""
    from ratslam_ros.messages.pose_cells import GoalMemoryPayload

    if kind.SECTION == 'viewer':
        return _of_viewer()
    node = kind()
    try:
        if hasattr(node, 'host'):
            node.host.map.open()
        found = _listed(node)
        if kind.SECTION == 'goal_follower':
            found['subscribe'].add(GoalMemoryPayload.TOPIC)  # in place of the route
        return found
    finally:
        if hasattr(node, 'close'):
            node.close()
        node.destroy_node()


def _of_viewer() -> Interfaces:
    """Return the interfaces of the viewer without opening a page."""
    import rclpy

    from ratslam_ros.ros.viewing.viewer_controls import RosControls
    from ratslam_ros.ros.viewing.viewer_topics import ViewerTopics
    from ratslam_ros.viewer.live_run import LiveRun

    node = rclpy.create_node('viewer')
    run = LiveRun('policy', None)
    try:
        ViewerTopics(node, run, RosControls(node), {})
        return _listed(node)
    finally:
        run.close()
        node.destroy_node()


def _listed(node: Any) -> Interfaces:
    found: Interfaces = {
        'publish': {publisher.topic_name for publisher in node.publishers},
        'subscribe': {subscription.topic_name for subscription in node.subscriptions},
        'reply': {service.srv_name for service in node.services},
        'request': {client.srv_name for client in node.clients},
    }
    # What rclpy creates on every node; the stand-in does not create all of it.
    found['publish'] |= {'/rosout', '/parameter_events'}
    found['subscribe'] |= {'/clock', '/parameter_events'}
    found['reply'].add(f'/{node.get_name()}/get_type_description')
    for kind in ('execute', 'call'):
        found[kind] = {name for other, used, name in _ACTIONS if other is node and used == kind}
    return {
        kind: {_relative(name, node.get_name()) for name in names}
        for kind, names in found.items()
    }


ABSOLUTE = frozenset({
    '/tf', '/tf_static', '/clock', '/diagnostics', '/rosout', '/parameter_events',
})
"""Topics that are not below the namespace of the nodes."""


def _relative(name: str, node: str) -> str:
    """Return a name as in the source of a node: relative, private after ~, or absolute."""
    if name in ABSOLUTE:
        return name
    name = name.replace('~/', f'/{node}/')
    if name.startswith(f'/{node}/') and name.rpartition('/')[2] in PARAMETER_SERVICES:
        return f'~/{name.removeprefix(f"/{node}/")}'
    return name.removeprefix('/')


PARAMETER_SERVICES = frozenset({
    'describe_parameters', 'get_parameter_types', 'get_parameters', 'list_parameters',
    'set_parameters', 'set_parameters_atomically', 'get_type_description',
})

REQUESTED = frozenset({
    'pause', 'mapping', 'relocate', 'save_map', 'load_map', 'reset', 'list_parameters',
    'get_parameters', 'set_parameters', 'list_goals', 'cancel_goal', 'send_all',
})
"""Services that the viewer calls, by the last part of their names."""

VIEWED = (
    'visual_odometry', 'local_view', 'pose_cells', 'experience_map', 'goal_follower',
    'landmark_map',
)
"""Nodes that the viewer controls."""


def _add_temporary(found: dict[str, Interfaces]) -> None:
    """Add what nodes create in a split, after an interruption, or on request."""
    from ratslam_ros.messages.commands import stream_topic
    from ratslam_ros.ros.restart.history import CUT, history_topic

    found['local_view']['subscribe'] |= {'scan', '/tf', '/tf_static'}
    found['pose_cells']['subscribe'] |= SONARS | {'/tf_static'}
    found['simulator']['publish'] |= SONARS
    for one in found.values():
        if CUT in one['publish']:
            one['subscribe'] |= {history_topic(topic) for topic in INPUTS & one['subscribe']}
    for name, before in FOLLOWED.items():
        found[name]['subscribe'].add(stream_topic(before))
        found[before]['publish'].add(stream_topic(before))
    for name in VIEWED:
        found['viewer']['request'] |= {
            service.replace('~/', f'{name}/') for service in found[name]['reply']
            if service.rpartition('/')[2] in REQUESTED
        }


def policy_text(found: dict[str, Interfaces]) -> str:
    """Return the policy as XML, in the order of its names."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<!-- Written by tools/sros2_policies.py from the interfaces of the nodes. -->',
        '<policy version="0.2.0">',
        '  <enclaves>',
    ]
    for node, names in found.items():
        lines += [
            f'    <enclave path={quoteattr(f"/ratslam/{node}")}>',
            '      <profiles>',
            f'        <profile ns="/" node={quoteattr(node)}>',
        ]
        for kind, (group, item) in GROUPS.items():
            if names[kind]:
                lines += [
                    f'          <{group} {kind}="ALLOW">',
                    *(
                        f'            <{item}>{escape(name)}</{item}>'
                        for name in sorted(names[kind])
                    ),
                    f'          </{group}>',
                ]
        lines += ['        </profile>', '      </profiles>', '    </enclave>']
    return '\n'.join([*lines, '  </enclaves>', '</policy>', ''])


def main(arguments: Sequence[str] | None = None) -> int:
    """Write or check the policy."""
    parser = argparse.ArgumentParser(description=str(__doc__).split('\n')[0])
    parser.add_argument('--check', action='store_true', help='write nothing; compare only')
    options = parser.parse_args(arguments)
    text = policy_text(interfaces())
    if options.check:
        is_same = POLICY.is_file() and POLICY.read_text(encoding='utf-8') == text
        print('up to date' if is_same else f'{POLICY} differs: run tools/sros2_policies.py')
        return 0 if is_same else 1
    POLICY.parent.mkdir(exist_ok=True)
    POLICY.write_text(text, encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())
