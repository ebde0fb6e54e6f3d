# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A carried robot is found by its scans, also if all views are new, and never at a wrong place."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import pytest
from kidnapped_drive import LAP_STEPS, STEP_M, Drive, Sample, config, samples
from states import differences

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.relocator import LEAST_EVIDENCE_M, Relocator
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.pipeline.ratslam import RatSLAM

NORTH = Pose(9.5, 9.4, math.pi + 0.2)
"""Beside the path, and turned."""

MAPPED = LAP_STEPS + 1
GAP_NS = 10 * 10**9


@pytest.fixture(scope='module')
def mapped() -> Drive:
    drive = Drive(config())
    drive.feed(samples(1))
    return drive


@pytest.fixture
def drive(mapped: Drive) -> Drive:
    return copy.deepcopy(mapped)


def carried(to: Pose, steps: int) -> list[Sample]:
    return samples(1, to, steps)[MAPPED:]


def relocator_of(drive: Drive) -> Relocator:
    relocator = drive.slam.relocator
    assert relocator is not None
    return relocator


def test_undisturbed_robot_is_never_searched(mapped: Drive) -> None:
    relocator = relocator_of(mapped)
    assert not relocator.is_lost
    assert relocator.counts['requested'] == 0
    assert 20 < len(relocator.landmarks) < 120


def test_carried_robot_with_new_views_is_found(drive: Drive) -> None:
    given = carried(NORTH, 24)
    drive.feed(given)
    relocations = [step for step in drive.steps if step.relocated_to >= 0]
    assert len(relocations) == 1
    error_m, error_rad = drive.error(given[-1].truth)
    assert error_m < 0.1
    assert error_rad < 0.05
    took = next(n for n, step in enumerate(drive.steps[MAPPED:]) if step.relocated_to >= 0)
    assert LEAST_EVIDENCE_M <= took * STEP_M < 3.0
    assert relocator_of(drive).counts['found'] == 1
    assert drive.slam.experience_map.gate.relocation_count == 1


def test_experiences_mapped_while_lost_are_not_used_afterwards(drive: Drive) -> None:
    relocator = relocator_of(drive)
    landmarks, before = len(relocator.landmarks), len(drive.slam.experience_map)
    given = carried(NORTH, 24)
    drive.feed(given)
    found = next(step for step in drive.steps if step.relocated_to >= 0)
    created = [
        step.action.target_id for step in drive.steps[MAPPED:]
        if step.action.action == 'create' and step.stamp_ns <= found.stamp_ns
    ]
    assert created[0] == before
    assert set(relocator.state()['misplaced']) == set(created)
    assert len(relocator.landmarks) <= landmarks + 6


def test_pose_cells_follow_the_relocation(drive: Drive) -> None:
    drive.feed(carried(NORTH, 24))
    cells, graph = drive.slam.pose_cells, drive.slam.experience_map
    assert cells.current_experience == graph.current_id
    found = next(step for step in drive.steps if step.relocated_to >= 0)
    place = graph.labels[found.relocated_to][1]
    offset = graph.seen_from(found.relocated_to)
    assert offset is not None
    x, y = (
        cells.lengths.cell_m * math.remainder(peak - at, 61)
        for peak, at in ((cells.peak.x, place.x), (cells.peak.y, place.y))
    )
    assert math.hypot(x, y) == pytest.approx(math.hypot(offset.x_m, offset.y_m), abs=0.3)


def test_robot_in_unmapped_surroundings_is_not_relocated(
    drive: Drive, monkeypatch: pytest.MonkeyPatch
) -> None:
    import kidnapped_drive

    hall = [[(-4.0, -3.0), (7.0, -6.0), (9.0, 5.0), (4.0, 4.0), (2.0, 8.0), (-4.0, -3.0)]]
    monkeypatch.setattr(kidnapped_drive, 'FLOOR', hall)
    drive.feed(carried(Pose(0.0, 0.0, 0.3), 30))
    relocator = relocator_of(drive)
    assert relocator.is_lost
    assert relocator.counts['found'] == 0
    assert drive.slam.experience_map.gate.relocation_count == 0


def test_views_of_another_place_prevent_the_relocation(drive: Drive) -> None:
    """The place is proven by the scans, and two views were recognised elsewhere."""
    relocator, graph = relocator_of(drive), drive.slam.experience_map
    for sample in carried(NORTH, 16):
        drive.feed([sample])
        if relocator.is_lost:
            here = relocator._keyframes[-1].odometry
            for _ in range(2):
                relocator._views.append((here, Pose(50.0, 0.0, 0.0)))
    assert relocator.counts['found'] == 0
    assert relocator.counts['rejected'] > 0
    assert graph.gate.relocation_count == 0


def test_requested_search_confirms_the_right_pose(drive: Drive) -> None:
    pose = drive.slam.experience_map.pose
    result = relocator_of(drive).search(is_lost=True)
    assert result.outcome == 'here'
    assert result.experience_id == drive.slam.experience_map.current_id
    assert drive.slam.experience_map.pose == pose


def test_request_before_the_first_scan_names_the_reason() -> None:
    result = relocator_of(Drive(config())).search(is_lost=True)
    assert result.outcome == 'too little'
    assert result.reason == 'there is no scan yet'


def test_loaded_map_locates_a_carried_robot(mapped: Drive) -> None:
    """The pose is unknown after a map was loaded, whether or not the scans contradict it."""
    old = mapped.slam
    drive = Drive(config())
    slam = drive.slam
    assert old.scan_matcher is not None
    assert slam.scan_matcher is not None
    slam.pose_cells.restore(old.pose_cells.state())
    slam.experience_map.restore(old.experience_map.state())
    slam.scan_matcher.restore(old.scan_matcher.state())
    relocator_of(drive).restore(copy.deepcopy(relocator_of(mapped).state()))
    slam.experience_map.gate.restart()
    given = carried(NORTH, 24)
    drive.feed(given)
    assert relocator_of(drive).counts['found'] == 1
    assert drive.error(given[-1].truth)[0] < 0.1


def test_component_after_a_gap_is_joined_by_scans() -> None:
    """The motion of the robot during the gap is unknown, and all views are new."""
    gaps = {f'{section}__max_odom_gap_s': 2.0 for section in ('pose_cells', 'experience_map')}
    drive = Drive(config(**gaps))
    drive.feed(samples(1))
    given = carried(NORTH, 24)
    drive.feed([
        sample._replace(
            stamp_ns=sample.stamp_ns + GAP_NS,
            odometry=replace(sample.odometry, stamp_ns=sample.stamp_ns + GAP_NS),
            scan=replace(sample.scan, stamp_ns=sample.stamp_ns + GAP_NS),
        )
        for sample in given
    ])
    graph = drive.slam.experience_map
    assert drive.slam.pose_cells.gap_count == 1
    assert graph.component_count == 1
    assert drive.error(given[-1].truth)[0] < 0.1


def test_state_is_restored_completely(drive: Drive) -> None:
    drive.feed(carried(NORTH, 6))
    relocator, slam = relocator_of(drive), drive.slam
    assert slam.scan_matcher is not None
    again = Relocator(slam.experience_map, slam.scan_matcher)
    again.restore(relocator.state())
    assert list(differences(again.state(), relocator.state())) == []
    assert len(again.state()['misplaced']) > 0


def test_without_a_laser_relocation_changes_nothing() -> None:
    maps = []
    for mode in ('views', 'both', 'landmarks'):
        drive = Drive(config(experience_map__exp_relocate=mode))
        for sample in samples(1, NORTH, 8):
            drive.slam.odometry(sample.odometry)
            drive.slam.template(sample.stamp_ns, sample.match)
        drive.slam.finish()
        maps.append(encode_map(0, drive.slam.experience_map))
    assert maps[0] == maps[1] == maps[2]


def test_relocation_needs_scan_alignment() -> None:
    changed = config(experience_map__exp_align_scans=False)
    assert RatSLAM(changed).relocator is None
    assert RatSLAM(config(experience_map__exp_relocate='views')).relocator is None
