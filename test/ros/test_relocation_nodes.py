# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes of the pose cells and the map with a carried robot: same results as a replay."""

from __future__ import annotations

import dataclasses
import json
import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import START_NS
from kidnapped_drive import Drive, Sample, config, samples
from ros_messages import MakeWorld, laser_scan, odometry, string, template
from std_msgs.msg import String
from std_srvs.srv import Trigger
from test_host_map import actions, drive

from ratslam_ros.chain import Chain
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.messages.json_schema import MalformedMessage, decode, encode
from ratslam_ros.messages.mapping import ActionPayload, RelocationPayload, encode_map
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.host import Host
from ratslam_ros.ros.pose_cells_node import PoseCellsNode

NORTH = Pose(9.5, 9.4, math.pi + 0.2)
LAPS, STEPS = 1, 24
IN_FLIGHT = 5
"""Samples that may be on their way."""


def parameters(folder: Path) -> tuple[str, ...]:
    return tuple(
        item for setting in (
            'base:=extended', 'pc_dim_xy:=61', 'pc_cell_x_size:=0.25', 'exp_align_scans:=true',
            'exp_gate_closures:=true', 'exp_relocate:=both', 'exp_initial_em_deg:=0.0',
            'map_period_s:=1000.0', f'memory_folder:={folder}', 'flush_after_s:=60.0',
        ) for item in ('-p', setting)
    )


def send(made: Any, sample: Sample) -> None:
    made.send('odom', odometry(sample.stamp_ns, *sample.odometry.twist[:2]))
    made.send('scan', laser_scan(sample.scan))
    made.send('local_view/template', template(
        sample.stamp_ns, sample.match.template_id, error=0.0, is_new=sample.match.is_new
    ))


def test_nodes_relocate_as_a_replay_does(world: MakeWorld, tmp_path: Path) -> None:
    given = samples(LAPS, NORTH, STEPS)
    replayed = Drive(config())
    hosts = [
        Host(chain=Chain(is_followed=True, scans=('scan',))),
        Host(chain=Chain(follows='pose_cells')),
    ]
    made = world(
        *(partial(kind, Config(), host) for kind, host in zip(
            (PoseCellsNode, ExperienceMapNode), hosts, strict=True
        )), arguments=parameters(tmp_path),
    )
    for host, node in zip(hosts, made.nodes, strict=True):
        host.start()
        node.host.map.open()
    cells_node, map_node = made.nodes
    answers = made.listen(String, 'experience_map/relocation')
    # A LaserScan has single precision.
    single = [sample._replace(scan=_single(sample)) for sample in given]
    replayed.feed(single)
    replayed.slam.finish()
    for number, sample in enumerate(single):
        send(made, sample)
        # However slow the machine is, answers come within the time for which they are awaited.
        made.until(lambda number=number: map_node._stage.late_join._next > number - IN_FLIGHT)
    for host in hosts:
        order = host.pipeline.order
        made.until(lambda order=order: order.newest_ns == single[-1].stamp_ns)
        made.until(lambda host=host: host.pipeline.waiting_ns is None)
        host.live.finish()
    made.until(lambda: map_node._stage.late_join._next == len(given))
    relocations = [decode(RelocationPayload, one.data).relocation for one in answers]
    assert sum(one is not None for one in relocations) == 1
    assert encode_map(0, map_node._core) == encode_map(0, replayed.slam.experience_map)
    assert cells_node._core.peak == replayed.slam.pose_cells.peak
    assert cells_node._core.current_experience == replayed.slam.pose_cells.current_experience
    relocator = replayed.slam.relocator
    assert relocator is not None
    assert map_node._stage.relocator.counts == relocator.counts
    values = map_node._diagnostic_values()
    assert values['relocations_found'] == 1
    assert cells_node.diagnostics.counts['missed'] == 1  # local_view had learned before

    answer = made.call(Trigger, 'experience_map/relocate')
    assert (answer.success, 'at (' in answer.message) == (True, True)
    assert made.call(Trigger, 'experience_map/save').success
    assert made.call(Trigger, 'experience_map/reset').success
    answer = made.call(Trigger, 'experience_map/relocate')
    assert (answer.success, answer.message) == (False, 'too little: there is no scan yet')
    before = relocator.state()['landmarks']['visits'].tolist()
    assert made.call(Trigger, 'experience_map/load').success
    loaded = map_node._stage.relocator.state()
    assert loaded['landmarks']['visits'].tolist() == before
    assert list(loaded['misplaced']) == list(relocator.state()['misplaced'])


def _single(sample: Sample) -> Any:
    scan = sample.scan
    return dataclasses.replace(
        scan, ranges_m=scan.ranges_m.astype(np.float32).astype(np.float64),
        angle_min_rad=float(np.float32(scan.angle_min_rad)),
        angle_increment_rad=float(np.float32(scan.angle_increment_rad)),
    )


def test_service_without_landmarks_names_the_parameters(world: MakeWorld) -> None:
    made = world(ExperienceMapNode)
    answer = made.call(Trigger, 'experience_map/relocate')
    assert not answer.success
    assert 'exp_align_scans' in answer.message
    assert 'relocations_found' not in made.nodes[0]._diagnostic_values()


@pytest.mark.parametrize(('key', 'value'), [
    ('sequence', -1), ('memory', 'x'), ('relocation', [1]),
    ('relocation', {'experience_id': 1, 'template_id': 1}),
    ('relocation', {
        'experience_id': -1, 'template_id': 1, 'relative_x_m': 0.0, 'relative_y_m': 0.0,
        'relative_rad': 0.0,
    }),
])
def test_malformed_relocation_is_rejected(key: str, value: Any) -> None:
    fields = json.loads(encode(RelocationPayload.of(5, 3, None, 7)))
    found = decode(RelocationPayload, json.dumps(fields))
    assert (found.sequence, found.adopted, found.memory) == (3, None, 7)
    with pytest.raises(MalformedMessage, match='experience_map/relocation'):
        decode(RelocationPayload, json.dumps({**fields, key: value}))


def answered_cells(world: MakeWorld, *arguments: str) -> tuple[Any, list[Any]]:
    """Return pose cells whose first ten actions the map has answered."""
    made = world(PoseCellsNode, arguments=('-p', 'flush_after_s:=60.0', *arguments))
    found = actions(made)
    drive(made, 0, 10)
    for number in range(10):
        answer = string(encode(RelocationPayload.of(1, number, None, 0)))
        made.send('experience_map/relocation', answer)
    made.until(lambda: made.nodes[0]._stage._relocations.state()['last'] == 9)
    return made, found


def test_reset_pose_cells_wait_for_no_earlier_answer(world: MakeWorld) -> None:
    made, found = answered_cells(world)
    assert made.call(Trigger, 'pose_cells/reset').success
    drive(made, 10, 18)
    made.until(lambda: len(found) == 18)


def test_restarted_pose_cells_wait_for_answers(world: MakeWorld) -> None:
    made, found = answered_cells(world)
    drive(made, 10, 14)
    made.until(lambda: len(found) == 14)
    state = made.nodes[0].host.live.state_of(made.nodes[0].SECTION)
    made.close()
    made.close = lambda: None
    again = world(PoseCellsNode, arguments=('-p', 'flush_after_s:=60.0'))
    again.nodes[0].host.live.replace('pose_cells', state)
    drive(again, 14, 16)
    again.until(lambda: again.nodes[0].host.pipeline.waiting_ns is not None)


def test_pose_cells_go_on_without_an_answer_that_never_comes(
    world: MakeWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The map may have missed the action, and pose cells that wait send it no other."""
    monkeypatch.setattr('ratslam_ros.ros.host.ANSWER_TIMEOUT_S', 1.0)
    host = Host(chain=Chain(is_followed=True))
    made = world(
        partial(PoseCellsNode, Config(), host), arguments=('-p', 'flush_after_s:=0.1')
    )
    host.start()
    made.nodes[0].host.map.open()
    found = actions(made)
    drive(made, 0, 8)
    made.until(lambda: host.pipeline.waiting_ns is not None)
    assert len(found) < 8
    made.until(lambda: len(found) == 8)


def test_templates_from_before_a_jump_back_are_dropped(world: MakeWorld) -> None:
    made, found = answered_cells(world, '-p', 'on_jump_back:=start_over')
    drive(made, 10, 18)
    made.until(lambda: len(found) == 14)  # and four wait for answers
    for n in range(12):
        stamp_ns = START_NS - 60 * 10**9 + n * 10**8
        made.send('local_view/template', template(stamp_ns, 0))
        made.send('odom', odometry(stamp_ns))
    made.until(lambda: len(found) >= 14 + 12)
    assert all(decode(ActionPayload, one.data).stamp.ns < START_NS for one in found[14:])
