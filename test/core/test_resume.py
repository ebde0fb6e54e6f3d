# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run that continues from a saved state gives the results of one that was not interrupted."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import PERIOD_NS, START_NS, original, picture, real_recording
from learned import learned
from rooms import Line, scan_in

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files import memory
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.recordings import ImageEvent, OdometryEvent, open_recording

Call = tuple[str, tuple[Any, ...]]
ROOM: list[Line] = [
    [(-4.0, -4.0), (4.0, -4.0), (4.0, 3.0), (1.0, 3.0), (1.0, 4.0), (-4.0, 4.0), (-4.0, -4.0)]
]
SMALL = {
    'local_view.template_x_size': 16, 'local_view.template_y_size': 8,
    'local_view.vt_shift_match': 2, 'pose_cells.exp_delta_pc_threshold': 1.0,
}  # fmt: skip
SETTINGS: dict[str, dict[str, Any]] = {
    'default': {'pose_cells.pc_cell_x_size': 0.5},
    'limits': {
        'pose_cells.pc_cell_x_size': 0.5, 'local_view.vt_max': 25, 'pose_cells.exp_max': 20,
        'pose_cells.exp_forget': 'freshness', 'local_view.forget_after_s': 5.0,
        'pose_cells.forget_after_s': 5.0,
    },
    'scans': {
        'pose_cells.pc_cell_x_size': 0.5, 'experience_map.exp_align_scans': True,
        'experience_map.exp_relocate': 'both', 'goal_memory.goal_memory': True,
    },
}  # fmt: skip


def laps(count: int = 4, per_lap: int = 24, radius_m: float = 2.0) -> Iterator[Call]:
    """Yield the inputs of a robot on a circle, some of them out of order or in a gap."""
    rng = np.random.default_rng(1)
    for i in range(count * per_lap):
        at = math.tau / per_lap * i
        stamp_ns = START_NS + i * PERIOD_NS + (3 * 10**9 if i >= 2 * per_lap else 0)
        turn = math.tau / per_lap * (1.0 + 0.05 * rng.standard_normal())
        pose = Pose(radius_m * math.cos(at), radius_m * math.sin(at), at + math.pi / 2)
        yield 'odometry', (Odometry(stamp_ns, Twist(radius_m * turn / 0.1, turn / 0.1), pose),)
        if i % 7 != 3:  # the scan is late, so that messages are held
            yield 'scan', (scan_in(ROOM, pose, stamp_ns, beams=91),)
        yield 'image', (stamp_ns, picture(i % per_lap, 24, 32))


def fed(slam: RatSLAM, calls: list[Call]) -> list[str]:
    return [repr(getattr(slam, name)(*arguments)) for name, arguments in calls]


def through_file(slam: RatSLAM, folder: Path) -> dict[str, Any]:
    """Return the state of all parts after it was written and read."""
    states = {}
    for part, state in slam.state().items():
        memory.save(folder / 'state.npz', part, state)
        states[part] = memory.load(folder / 'state.npz', part)
    return states


def check(
    make: Callable[[], RatSLAM], calls: list[Call], folder: Path, cuts: list[int]
) -> RatSLAM:
    """Interrupt a run at the cuts; return the one that was not interrupted."""
    whole, saved, expected = make(), {}, []
    for number, call in enumerate(calls):
        if number in cuts:
            saved[number] = through_file(whole, folder)
        expected += fed(whole, [call])
    last = repr(whole.finish())
    for cut in cuts:
        again = make()
        again.restore(saved[cut])
        assert through_file(again, folder).keys() == saved[cut].keys()
        assert fed(again, calls[cut:]) == expected[cut:], cut
        assert repr(again.finish()) == last
        assert encode_map(0, again.experience_map) == encode_map(0, whole.experience_map)
        np.testing.assert_equal(again.state(), whole.state())
    return whole


@pytest.mark.parametrize('name', SETTINGS)
def test_an_interrupted_run_equals_a_whole_one(name: str, tmp_path: Path) -> None:
    config = original().with_values({**SMALL, **SETTINGS[name]})
    config = config.with_values({'pose_cells.max_odom_gap_s': 1.0,
                                 'experience_map.max_odom_gap_s': 1.0})  # fmt: skip
    calls = list(laps())
    whole = check(lambda: RatSLAM(config), calls, tmp_path, [1, 50, 131, 145, 160, 222, 260])
    assert len(whole.experience_map) > 10


def test_automatic_parameters_and_visual_odometry_continue(tmp_path: Path) -> None:
    calls = [(name, values) for name, values in laps() if name == 'image']
    whole = check(
        lambda: RatSLAM(Config(), 'visual_odometry'), calls, tmp_path, [1, 30, 47, 48, 49, 80]
    )
    assert whole.visual_odometry is not None


@pytest.mark.parametrize('visual', [False, True])
def test_a_real_recording_continues(visual: bool, tmp_path: Path) -> None:
    calls: list[Call] = []
    with open_recording(real_recording('rc_car_loops')) as recording:
        for event in recording.events(recording.select(visual_odometry=visual), 0.0, 60.0):
            if isinstance(event, OdometryEvent):
                pose = Pose(event.x, event.y, event.heading_rad)
                odometry = Odometry(event.stamp_ns, Twist(event.linear_x, event.angular_z), pose)
                calls.append(('odometry', (odometry,)))
            elif isinstance(event, ImageEvent):
                calls.append(('image', (event.stamp_ns, event.grey())))
    whole = check(
        lambda: RatSLAM(Config(), 'visual_odometry' if visual else 'local_view'), calls,
        tmp_path, [len(calls) * 2 // 3],
    )
    assert len(whole.experience_map) > 100


def test_a_session_starts_apart_and_joins_where_it_recognises_a_place() -> None:
    config = original().with_values({**SMALL, **SETTINGS['default']})
    slam, calls = RatSLAM(config), list(laps(2))
    fed(slam, calls)
    slam.finish()
    count = len(slam.experience_map)
    assert slam.experience_map.component_count == 1
    slam.begin_session()
    # Another drive with earlier stamps, which starts at an unknown place.
    strange = [
        ('image', (START_NS // 2 + i * PERIOD_NS, picture(500 + i, 24, 32))) for i in range(8)
    ]
    moves = [
        ('odometry', (Odometry(START_NS // 2 + i * PERIOD_NS, Twist(5.0, 0.0),
                               Pose(0.5 * i, 0.0, 0.0)),)) for i in range(9)
    ]  # fmt: skip
    fed(slam, [call for pair in zip(moves, strange, strict=False) for call in pair])
    slam.finish()
    assert len(slam.experience_map) > count
    assert slam.experience_map.component_count == 2
    slam.begin_session()
    fed(slam, calls)
    slam.finish()
    assert slam.experience_map.component_of(slam.experience_map.current_id) == 0


def test_a_session_on_an_empty_map_changes_nothing() -> None:
    config = original().with_values({**SMALL, **SETTINGS['default']})
    calls = list(laps(2))
    plain, begun = RatSLAM(config), RatSLAM(config)
    begun.begin_session()
    assert fed(begun, calls) == fed(plain, calls)


@pytest.mark.parametrize('name', ['default', 'limits', 'scans'])
def test_localisation_learns_nothing(name: str) -> None:
    settings = {**SMALL, **SETTINGS[name], 'pose_cells.odom_calibration': True}
    config = original().with_values(settings)
    slam, calls = RatSLAM(config), list(laps())
    fed(slam, calls)
    slam.finish()
    slam.begin_session()
    slam.mapping = False
    before = learned(slam.state())
    fed(slam, calls)
    slam.finish()
    np.testing.assert_equal(learned(slam.state()), before)
    assert slam.experience_map.current_id >= 0  # it is localised all the same


def test_states_of_other_parameters_are_refused() -> None:
    config = original().with_values({**SMALL, **SETTINGS['default']})
    slam = RatSLAM(config)
    fed(slam, list(laps(1)))
    states = slam.state()
    with pytest.raises(UnusableInput, match='template_y_size'):
        RatSLAM(config.with_values({'local_view.template_y_size': 9})).restore(states)
    with pytest.raises(UnusableInput, match='pc_dim_x'):
        RatSLAM(config.with_values({'pose_cells.pc_dim_x': 30})).restore(states)
    scans = config.with_values({'experience_map.exp_align_scans': True})
    assert not RatSLAM(scans).restore(states)  # its inputs are others
    del states['experience_map']['core']['poses']
    with pytest.raises(UnusableInput, match=r"damaged, or of another version .*'poses'"):
        RatSLAM(config).restore(states)
