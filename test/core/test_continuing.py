# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run that is saved at any moment, restored and continued equals one that was not stopped."""

from __future__ import annotations

import random
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import gap_drives
import kidnapped_drive
import numpy as np
import pytest
from helpers import PERIOD_NS, START_NS, original, picture, twist
from states import Event, continues_exactly

from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.pipeline.items import Step
from ratslam_ros.pipeline.ratslam import RatSLAM

PER_LAP = 30
SMALL = original().with_values({
    'local_view.template_x_size': 16, 'local_view.template_y_size': 8,
    'local_view.vt_shift_match': 2, 'pose_cells.pc_cell_x_size': 0.5,
    'pose_cells.exp_delta_pc_threshold': 1.0,
})  # fmt: skip
FORGETTING = {
    'local_view.vt_max': 50, 'local_view.forget_after_s': 4.0, 'pose_cells.exp_max': 40,
    'pose_cells.exp_forget': 'freshness', 'pose_cells.forget_after_s': 4.0,
}  # fmt: skip
AUTOMATIC = {
    'local_view.vt_match_threshold': -1, 'local_view.vt_match_ratio': -1,
    'local_view.vt_recent_templates': -1, 'pose_cells.pc_cell_x_size': -1,
    'pose_cells.exp_delta_pc_threshold': -1, 'pose_cells.odom_calibration': True,
    'pose_cells.exp_view_links': True,
}  # fmt: skip
VARIANTS = {
    'fixed': {},
    'forgetting': FORGETTING,
    'pruning by visits': {'pose_cells.exp_max': 40},
    'automatic': AUTOMATIC,
    'automatic, forgetting': {**AUTOMATIC, **FORGETTING},
    'goal memory': {'goal_memory.goal_memory': True, 'pose_cells.pc_vt_agree_views': 3.0},
    'late odometry': {
        'pose_cells.max_lateness_s': 3.0, 'local_view.max_lateness_s': 3.0, **AUTOMATIC,
    },
}  # fmt: skip


def _odometry(message: Odometry, slam: RatSLAM) -> list[Step]:
    return slam.odometry(message)


def _image(stamp_ns: int, image: np.ndarray | None, slam: RatSLAM) -> list[Step]:
    return slam.image(stamp_ns, image)


def _scan(scan: Scan, slam: RatSLAM) -> list[Step]:
    return slam.scan(scan)


def _template(stamp_ns: int, match: ViewMatch, slam: RatSLAM) -> list[Step]:
    return slam.template(stamp_ns, match)


def circles(count: int, own_odometry: bool = False, delayed: int = 0) -> list[Event]:
    """Drive two laps of a circle that stays the same, then one with new views, and so on.

    One message is repeated, one has a stamp far ahead, and one image cannot be decoded, so that
    messages are held and counted.
    """
    events: list[Event] = []
    late: list[Event] = []
    turn_rate = 2.0 * np.pi * 10 / PER_LAP
    for n in range(count):
        lap, place = divmod(n, PER_LAP)
        circle = lap // 3 + 1 if lap % 3 == 2 else 0
        stamp_ns = START_NS + n * PERIOD_NS
        if not own_odometry:
            events.append(partial(_odometry, twist(stamp_ns, 4.0, turn_rate)))
        if n % 41 == 40 and not own_odometry:
            events.append(partial(_odometry, twist(stamp_ns + 10**13, 1.0)))
        image = None if n % 53 == 52 else picture(100 * circle + place)
        late.append(partial(_image, stamp_ns, image))
        if n % 37 == 36:
            late.append(partial(_image, stamp_ns, image))
        while len(late) > delayed:
            events.append(late.pop(0))
    return events


def random_cuts(events: Sequence[Event], count: int, seed: int) -> list[int]:
    return sorted(random.Random(seed).sample(range(len(events)), count))


@pytest.mark.parametrize('variant', VARIANTS)
def test_a_run_continues_exactly_from_its_state(variant: str, tmp_path: Path) -> None:
    config = SMALL.with_values(VARIANTS[variant])
    events = circles(200, delayed=3 if 'late' in variant else 0)
    cuts = random_cuts(events, 3, len(variant))
    assert continues_exactly(partial(RatSLAM, config), events, cuts, tmp_path) == []


def test_visual_odometry_continues_exactly(tmp_path: Path) -> None:
    events = circles(80, own_odometry=True)
    new = partial(RatSLAM, SMALL, 'visual_odometry')
    assert continues_exactly(new, events, random_cuts(events, 3, 1), tmp_path) == []


def test_scans_and_relocation_continue_exactly(tmp_path: Path) -> None:
    events: list[Event] = []
    given = kidnapped_drive.samples(1, kidnapped_drive.Pose(1.25, 8.0, 0.5), 40)
    for one in given:
        events += [
            partial(_odometry, one.odometry), partial(_scan, one.scan),
            partial(_template, one.stamp_ns, one.match),
        ]  # fmt: skip
    # Shortly before and after the robot is carried, and anywhere.
    carried = 3 * (len(given) - 40)
    cuts = [carried - 5, carried + 1, carried + 61, *random_cuts(events, 2, 2)]
    new = partial(RatSLAM, kidnapped_drive.config(), 'pose_cells')
    assert continues_exactly(new, events, cuts, tmp_path) == []


def test_components_continue_exactly(tmp_path: Path) -> None:
    drive = gap_drives.Drive(gap_drives.config())
    drive.forward(60)
    drive.carry(30)
    drive.forward(70)
    drive.finish()
    assert drive.slam.pose_cells.gap_count == 1
    events: list[Event] = []
    for stamp_ns, message in drive.messages.items():
        match = ViewMatch(drive.templates[stamp_ns], False, 0.0, 0.0)
        events += [partial(_odometry, message), partial(_template, stamp_ns, match)]
    at_gap = 2 * 61
    cuts = [at_gap + 1, at_gap + 7, *random_cuts(events, 2, 3)]
    new = partial(RatSLAM, gap_drives.config(), 'pose_cells')
    assert continues_exactly(new, events, cuts, tmp_path) == []


def test_restored_items_of_nodes_survive_and_named_places_follow_pruning() -> None:
    config = SMALL.with_values(FORGETTING)
    events = circles(200)
    first, again = RatSLAM(config), RatSLAM(config)
    for event in events[:100]:
        event(first)
    states = first.state()
    places = {f'place {n}': n for n in range(len(first.experience_map))}
    states['experience_map']['goals'] = {
        'named': [[name, at, 0.0, 0.0, 0.0] for name, at in places.items()]
    }
    states['experience_map']['joining'] = {}  # ids between nodes, which a replay changes
    states['local_view']['other'] = {'a': 1}
    again.restore(states)
    for event in events[100:]:
        event(again)
    found = again.state()
    assert found['local_view']['other'] == {'a': 1}
    assert 'joining' not in found['experience_map']
    anchors = {name: at for name, at, *_ in found['experience_map']['goals']['named']}
    assert anchors.keys() == places.keys()
    assert anchors != places  # Those of pruned experiences have other anchors.
