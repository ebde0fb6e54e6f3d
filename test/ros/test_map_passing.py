# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Maps pass between replays, nodes and the map commands, and lose nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers import START_NS, image_message, odometry_message, picture, write_bag
from ros_messages import MakeWorld
from std_srvs.srv import Trigger
from test_map_operations import PERIOD_NS, Nodes

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.goal_memory.goal_memory import GoalMemory
from ratslam_ros.core.merging.session import Session, SessionMap
from ratslam_ros.maps import read_map, save_map
from ratslam_ros.offline.map_export import exported
from ratslam_ros.offline.map_merging import merge_files
from ratslam_ros.offline.map_pruning import prune
from ratslam_ros.offline.map_upkeep import config_of_map, experience_map_of, problems
from ratslam_ros.offline.replay import ReplayOptions, replay
from ratslam_ros.offline.replay_map import ReplayMap
from ratslam_ros.recordings import open_recording
from ratslam_ros.ros.pose_cells_node import PoseCellsNode

IMAGES = 26
"""5 s of ``Nodes.drive``."""
LAST_NS = START_NS + (IMAGES - 1) * PERIOD_NS

CONFIG = Config().with_values({
    'local_view.template_x_size': 16, 'local_view.template_y_size': 8,
    'local_view.vt_shift_match': 2, 'pose_cells.pc_cell_x_size': 0.5,
})


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    messages = []
    for n in range(IMAGES):
        stamp_ns = START_NS + n * PERIOD_NS
        odometry = odometry_message(stamp_ns, 1.0, 0.0, Pose(0.0, 0.0, 0.0))
        messages += [
            (stamp_ns, '/odom', 'odometry', odometry),
            (stamp_ns + 1, '/image', 'image', image_message(stamp_ns, picture(n, 24, 32))),
        ]
    return write_bag(tmp_path_factory.mktemp('bag') / 'drive', messages)


class Ways:
    """All ways to use a map; each returns the map with which others continue."""

    def __init__(self, world: MakeWorld, bag: Path) -> None:
        self._world, self._bag = world, bag

    def replay(self, path: Path, localize: bool = False) -> Path:
        map_file = ReplayMap(path, localize, print, print)
        options = ReplayOptions(progress=False, map_file=map_file)
        with open_recording(self._bag) as recording:
            replay(recording, recording.select(), CONFIG, path.parent / 'results', options)
        return path

    def replay_localize(self, path: Path) -> Path:
        return self.replay(path, localize=True)

    def nodes(self, path: Path, *arguments: str) -> Path:
        # A machine that stalls makes no message late.
        given = '-p', f'map:={path}', '-p', 'flush_after_s:=60.0', *arguments
        nodes = Nodes(self._world, *given)
        nodes.drive(IMAGES)
        graph = nodes.world.nodes[-1]
        nodes.world.until(lambda: graph.host.pipeline.order.newest_of('action') == LAST_NS)
        nodes.world.call(Trigger, 'experience_map/name_place')
        nodes.world.close()
        nodes.world.close = lambda: None
        return path

    def nodes_localize(self, path: Path) -> Path:
        return self.nodes(path, '-p', 'localize:=true')

    def merge(self, path: Path) -> Path:
        out = path.with_name('merged.map')
        other = self.replay(path.with_name('other.map'))
        merge_files([path, other], out)
        return out

    def prune(self, path: Path) -> Path:
        prune(path, 20)
        return path

    def export(self, path: Path) -> Path:
        saved = read_map(path)
        exported(*experience_map_of(saved, config_of_map(saved)[0]), 'json')
        return path


def check(path: Path) -> None:
    """Check that a map has no problem, the views and the places of the drive, and its name."""
    assert problems(path) == ([], [])
    saved = read_map(path)
    goals = saved.states['experience_map'].get('goals', {'named': []})
    assert len(goals['named']) >= 1
    session = SessionMap(Session('', config_of_map(saved)[0], saved.states))
    assert len(session.local_view) == IMAGES  # All views were recognised.
    assert len(session.map_ids) == len(session) >= 20  # The pose cells have all places.


def test_map_passes_from_any_program_to_any_other(
    world: MakeWorld, bag: Path, tmp_path: Path
) -> None:
    ways, path = Ways(world, bag), tmp_path / 'a.map'
    ways.replay(path)
    for step in (
        'nodes', 'replay', 'replay_localize', 'nodes_localize', 'merge', 'nodes', 'export',
        'prune', 'replay',
    ):
        path = getattr(ways, step)(path)
        check(path)


def test_prune_keeps_parts_that_it_does_not_use(
    world: MakeWorld, bag: Path, tmp_path: Path
) -> None:
    path = Ways(world, bag).replay(tmp_path / 'a.map')
    saved, other = read_map(path), {'core': {'number': 1}}
    save_map(path, {**saved.states, 'goal_follower': other}, saved.meta, saved.cut)
    prune(path, 20)
    states = read_map(path).states
    assert states['goal_follower'] == other
    assert 'inputs' not in states  # Held messages belong to the map before.


def test_node_keeps_goal_memory_without_using_it_until_a_reset(world: MakeWorld) -> None:
    made = world(PoseCellsNode)
    [node] = made.nodes
    memory = GoalMemory(CONFIG.pose_cells).state()
    state = node.host.live.state_of(node.SECTION)
    node.host.live.replace('pose_cells', {**state, 'goal_memory': memory})
    assert node.host.live.state_of(node.SECTION)['goal_memory'] is memory
    made.call(Trigger, 'pose_cells/reset')
    assert 'goal_memory' not in node.host.live.state_of(node.SECTION)
