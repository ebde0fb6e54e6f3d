# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Merging maps of robots with a laser."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from kidnapped_drive import LAP_STEPS, Drive, Sample, config, samples

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.merging.merge import MergedMap, merge_sessions
from ratslam_ros.core.merging.session import Session
from ratslam_ros.errors import UnusableInput
from ratslam_ros.pipeline.ratslam import RatSLAM


@cache
def drive(first: int, last: int, is_mirrored: bool = False) -> tuple[Drive, dict[int, Pose]]:
    """Map a part of a lap; return the system and the true poses of its experiences."""
    done = Drive(config())
    truths = {}
    for sample in samples(1)[first:last]:
        done.feed([mirrored(sample) if is_mirrored else sample])
        current = done.slam.experience_map.current_id
        if current >= 0:
            truths.setdefault(current, sample.truth)
    return done, truths


def mirrored(sample: Sample) -> Sample:
    """Return a sample of a floor whose walls are those of the mirror image."""
    scan = sample.scan
    ranges = scan.ranges_m[::-1].copy()
    return sample._replace(
        scan=Scan(scan.stamp_ns, scan.angle_min_rad, scan.angle_increment_rad, ranges)
    )


def session(name: str, done: Drive, size: int) -> Session:
    """Return a map with views of a size; a robot with another camera has other ones."""
    parameters = config(local_view__template_x_size=size)
    states = done.slam.state()
    # Templates arrive as messages, so the local view has not learned any.
    count = 1 + max(template for template, _ in done.slam.experience_map.labels)
    shape = count, parameters.local_view.template_y_size, size
    templates = np.random.default_rng(size).integers(0, 256, shape).astype(np.uint8)
    states['local_view'] = {'core': {
        **RatSLAM(parameters).state()['local_view']['core'], 'templates': templates,
    }}
    return Session(name, parameters, states)


def errors(merged: MergedMap, truths: list[dict[int, Pose]]) -> list[float]:
    """Return the errors of the poses of the second session in the frame of the first one's."""
    poses = merged.states['experience_map']['core']['poses']

    def at(number: int, experience: int) -> Pose:
        own = Pose(*poses[merged.experience_ids[number][experience]].tolist())
        return composed(own, Pose(*merged.offsets[number][experience].tolist()))

    first = min(truths[0])
    found = []
    for experience, truth in truths[1].items():
        expected = composed(inverse(truths[0][first]), truth)
        seen = composed(inverse(at(0, first)), at(1, experience))
        found.append(math.dist(seen[:2], expected[:2]))
        assert abs(wrap(seen.heading_rad - expected.heading_rad)) < 0.1
    return found


def test_scans_measure_places_that_views_share() -> None:
    (first, first_truths), (second, second_truths) = drive(0, 170), drive(60, 240)
    merged = merge_sessions([session('a', first, 60), session('b', second, 60)])
    assert [join.by for join in merged.joins] == ['views']
    assert merged.components == 1
    truths = {'a': first_truths, 'b': second_truths}
    assert max(errors(merged, [truths[name] for name in merged.names])) < 0.1


def test_scans_contradict_places_that_look_alike() -> None:
    first, second = drive(0, 170)[0], drive(0, 170, is_mirrored=True)[0]
    merged = merge_sessions([session('a', first, 60), session('b', second, 60)])
    assert merged.components == 2
    assert any('the scans fit at only' in join.refused for join in merged.joins)


def test_scans_join_maps_of_different_cameras() -> None:
    (first, first_truths), (second, second_truths) = drive(0, LAP_STEPS), drive(60, 240)
    merged = merge_sessions([session('a', first, 60), session('b', second, 40)])
    assert merged.names == ('a', 'b')
    assert [(join.by, join.refused) for join in merged.joins] == [('scans', '')]
    assert max(errors(merged, [first_truths, second_truths])) < 0.1
    slam = RatSLAM(merged.config)
    slam.restore(merged.states)
    assert len(slam.local_view) == merged.templates[0]  # the camera of the larger map
    assert slam.relocator is not None
    assert len(slam.relocator.landmarks) < sum(
        len(one.slam.relocator.landmarks) for one in (first, second) if one.slam.relocator
    )


def test_different_cameras_on_different_floors_are_refused() -> None:
    first, second = drive(0, LAP_STEPS)[0], drive(60, 240, is_mirrored=True)[0]
    with pytest.raises(UnusableInput, match='template_x_size is 40, expected 60'):
        merge_sessions([session('a', first, 60), session('b', second, 40)])


def test_scan_merging_does_not_depend_on_the_order() -> None:
    one, other = session('a', drive(0, 170)[0], 60), session('b', drive(60, 240)[0], 60)
    merged, again = merge_sessions([one, other]), merge_sessions([other, replace(one, name='x')])
    for key in ('points', 'sizes', 'ids'):
        np.testing.assert_array_equal(
            merged.states['experience_map']['scans'][key],
            again.states['experience_map']['scans'][key],
        )
