# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The measures and variants of recordings of laps in benchmarks/, on small examples."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import ablation
import lap_measures as measures
import leave_one_out
import numpy as np
import place_recognition
import pytest
import recording_variants as variants
from helpers import S, real_recording, real_recordings

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.config import Config
from ratslam_ros.files.config import load_config
from ratslam_ros.images import Frame
from ratslam_ros.recordings import (
    Event,
    ImageEvent,
    OdometryEvent,
    Orientation,
    Recording,
    Selection,
    Topic,
)
from ratslam_tuning.lap_phases import LapPhases

ROOT = Path(__file__).resolve().parents[1]
PLACES, LAPS = 8, 3
PHASES = LapPhases(np.arange(PLACES * LAPS) // PLACES, np.arange(PLACES * LAPS) % PLACES, PLACES)
ONE_PART = np.zeros(PLACES * LAPS, np.intp)
FACTOR = 3.0
WEIGHTS = np.array([0.8, 0.2])


@compiled
def scaled(value: float) -> float:
    return FACTOR * value


def circles(turns: float) -> tuple[np.ndarray, np.ndarray]:
    """Return positions on a circle of 1 m, 0.1 m higher on each lap, and headings."""
    angle = math.tau * np.arange(PLACES * LAPS) / PLACES
    position = np.stack([np.cos(angle), np.sin(angle) + 0.1 * PHASES.lap], 1)
    return position, turns * angle


@pytest.mark.parametrize('turns', [0.0, 1.0, -1.0, 2.0])
def test_turns_for_each_lap_are_counted_without_sign(turns: float):
    assert measures.turns(circles(turns)[1], PHASES, ONE_PART) == pytest.approx(abs(turns))


def test_turns_during_unknown_motion_do_not_count():
    """In the middle of the second lap, the robot is turned by an unknown angle."""
    _, heading = circles(1.0)
    part = np.where(np.arange(PLACES * LAPS) < 3 * PLACES // 2, 0, 1)
    heading[part == 1] += 2.0
    assert measures.turns(heading, PHASES, part) == pytest.approx(1.0)
    assert math.isnan(measures.turns(heading, PHASES, np.arange(PLACES * LAPS)))


def test_spread_is_distance_of_revisits_by_diameter():
    position, _ = circles(1.0)
    median_m, diameter_m = measures.distances_m(position, PHASES)
    assert median_m == pytest.approx(0.1)  # twice 0.1 m and once 0.2 m for each place
    assert diameter_m == pytest.approx(2.2)
    assert measures.spread(position, PHASES) == pytest.approx(0.1 / 2.2)


def test_frames_without_label_change_no_measure():
    position, heading = circles(1.0)
    has_label = np.arange(PLACES * LAPS) != 2 * PLACES
    position[~has_label], heading[~has_label] = 100.0, 100.0
    phases = PHASES.only(has_label)
    assert measures.distances_m(position, phases) == pytest.approx((0.1, 2.2), abs=0.01)
    assert measures.turns(heading, phases, ONE_PART) == pytest.approx(1.0)
    templates = PHASES.place.copy()
    templates[2 * PLACES] = 4  # a wrong match
    assert PHASES.recognition(templates, 1) == pytest.approx((7 / 8, 7 / 8))
    assert phases.recognition(templates, 1) == (1.0, 1.0)


def test_templates_first_seen_without_label_are_left_out():
    phases = PHASES.only(np.arange(PLACES * LAPS) != 0)  # the frame that template 0 is made of
    assert phases.recognition(PHASES.place, 1) == (1.0, 1.0)


def test_errors_are_near_avoidable_and_repeated():
    certainty = np.ones(PLACES * LAPS)
    ids = PHASES.place.tolist()
    assert measures.recognition_errors(PHASES, ids, 1, certainty)[:4] == (0, 0.0, 0.0, 0.0)
    far, near = 2 * PLACES, 2 * PLACES + 5
    ids[far], ids[near] = 4, 3  # of the last lap, whose places were all seen before
    certainty[[far, near]] = 0.5
    errors = measures.recognition_errors(PHASES, ids, 1, certainty)
    assert errors[:4] == (2, 0.5, 1.0, 0.0)
    assert (errors.precision_least_certain, errors.precision_most_certain) == (0.0, 1.0)


def test_error_with_misplaced_first_frame_is_repeated():
    phases = LapPhases(PHASES.lap, PHASES.place.copy(), PLACES)
    phases.place[3] = 7  # a wrong label of the frame that template 3 is made of
    ids = PHASES.place.tolist() + PHASES.place[:PLACES].tolist()
    phases = LapPhases(
        np.append(phases.lap, np.full(PLACES, LAPS)),
        np.append(phases.place, np.arange(PLACES)), PLACES,
    )
    errors = measures.recognition_errors(phases, ids, 1, np.ones(len(ids)))
    assert (errors.errors, errors.errors_repeated) == (2, 1.0)


class Drive(Recording):
    """Ten images of a gradient, and ten odometry messages, one in each second."""

    def __init__(self) -> None:
        super().__init__(Path('drive'))
        self.kind, self.topics = 'made up', (Topic('/image', 'sensor_msgs/msg/Image', 10),)
        self.start_ns, self.end_ns = 0, 9 * S
        self.pixels = np.arange(0, 240, 10, dtype=np.uint8).reshape(4, 6)

    def read_events(self, selection: Selection, start_ns: int, stop_ns: int) -> Iterator[Event]:
        for stamp_ns in range(0, 10 * S, S):
            if start_ns <= stamp_ns < stop_ns:
                yield OdometryEvent(
                    stamp_ns, stamp_ns, 1.0, 0.5, 2.0, 3.0, Orientation.of_heading(0.4), 0.1
                )
                yield ImageEvent(stamp_ns, stamp_ns, Frame(self.pixels, 'mono8'))


def events(**change: object) -> list[Event]:
    """Return the events of a variant of the drive."""
    recording = variants.ChangedRecording(Drive(), variants.Variant(**change))
    return list(recording.events(Selection('/image', '/odom', None)))


def test_mirrored_drive_turns_other_way_in_mirrored_images():
    mirrored = variants.VARIANTS['mirrored']
    odometry, image, *_ = events(change=mirrored.change, odometry=mirrored.odometry)
    assert (odometry.linear_x, odometry.angular_z, odometry.linear_y) == (1.0, -0.5, -0.1)
    assert (odometry.x, odometry.y) == (2.0, -3.0)
    assert odometry.heading_rad == pytest.approx(-0.4)
    assert np.array_equal(image.grey(), Drive().pixels[:, ::-1])


def test_second_frames_are_same_from_any_start():
    recording = variants.ChangedRecording(Drive(), variants.Variant(every=2))
    selection = Selection('/image', '/odom', None)
    for start_s in (0.0, 3.0):
        found = list(recording.events(selection, start_s))
        stamps = [event.stamp_ns // S for event in found if isinstance(event, ImageEvent)]
        assert stamps == [second for second in (0, 2, 4, 6, 8) if second >= start_s]
        assert sum(isinstance(event, OdometryEvent) for event in found) == 10 - start_s


def test_light_changes_from_its_stamp_on():
    images = [
        event.grey() for event in events(change=np.invert, from_ns=7 * S)
        if isinstance(event, ImageEvent)
    ]
    pixels = Drive().pixels
    assert [np.array_equal(image, pixels) for image in images] == [True] * 7 + [False] * 3
    assert np.array_equal(images[-1], np.invert(pixels))


def test_nothing_follows_the_end_of_a_drive():
    assert {event.stamp_ns // S for event in events(until_ns=3 * S)} == {0, 1, 2}


def test_first_laps_are_replayed_alone():
    real_recording('rc_car_loops')
    laps, setup = measures.LAPS['rc_car_loops'], measures.Setup(Config(), look_ahead=False)
    run = measures.run_laps(real_recordings(), laps, setup, count=2)
    assert run.summary['frames'] == 20 + 205 + 167  # before the first start, and of laps 1 and 2
    assert run.measures.is_right(1.0)


def test_each_variant_changes_images_or_frames():
    shapes = {'half size': (2, 3), 'double size': (8, 12)}
    for name, variant in variants.VARIANTS.items():
        changed = variant.change(Drive().pixels)
        assert changed.dtype == np.uint8 and changed.shape == shapes.get(name, (4, 6))
        differs = changed.shape != (4, 6) or not np.array_equal(changed, Drive().pixels)
        assert differs != (
            name == 'original' or variant.every > 1 or variant.skip_s > 0.0
            or not variant.has_odometry
        )


def test_drawn_variants_are_repeated_by_their_numbers():
    drawn = [variants.variant_of(f'drawn {n}', 'rc_car_eight', True) for n in range(40)]
    again = [variants.variant_of(f'drawn {n}', 'rc_car_eight', True) for n in range(40)]
    others = [variants.variant_of(f'drawn {n}', 'hall_car', False)[1] for n in range(40)]
    names = [name for _, name in drawn]
    assert names == [name for _, name in again] != others
    assert len({*names, *others}) == 80 and all(name.count(', ') == 2 for name in names)
    assert any('odometry' in name for name in names)
    assert not any('odometry' in name or 'turn' in name for name in others)
    for (one, _), (two, _) in zip(drawn, again, strict=True):
        changed = one.change(Drive().pixels)
        assert changed.dtype == np.uint8 and changed.ndim == 2 and changed.size > 0
        assert np.array_equal(changed, two.change(Drive().pixels))


def test_duration_changes_all_stamps():
    stamps = [event.stamp_ns for event in events(duration=2.0, skip_s=3.0)]
    assert stamps == [2 * second * S for second in range(3, 10) for _ in range(2)]


def test_lost_images_are_the_same_from_any_start():
    recording = variants.ChangedRecording(Drive(), variants.Variant(lost=0.5))
    whole, later = (
        [event.stamp_ns for event in recording.events(Selection('/image', '/odom', None), start_s)
         if isinstance(event, ImageEvent)]
        for start_s in (0.0, 4.0)
    )
    assert 0 < len(whole) < 10 and later == [stamp for stamp in whole if stamp >= 4 * S]


def test_map_does_not_depend_on_image_size():
    """The recording is short and has few loops, so that a slightly different turn rate shows."""
    real_recording('hall_car')
    setup = measures.Setup(Config())
    runs = [
        measures.run_laps(real_recordings(), measures.LAPS['hall_car'], setup, variant)
        for variant in ('original', 'half size')
    ]
    for run in runs:
        assert run.measures.is_right(1.0)
        assert run.measures[:2] == pytest.approx(runs[0].measures[:2], abs=0.02)
        gain, first = (one.summary['odom_calibration']['rotation_gain'] for one in (run, runs[0]))
        assert gain == pytest.approx(first, rel=0.1)


def test_value_of_left_out_recording_is_best_on_others():
    low, high = (('m', 'C', 1.0),), (('m', 'C', 2.0),)
    scores = {
        low: {'a': 0.9, 'a2': 0.9, 'b': 0.5, 'c': 0.5},
        high: {'a': 0.1, 'a2': 0.1, 'b': 0.6, 'c': 0.7},
    }
    place_of = {'a': 'a', 'a2': 'a', 'b': 'b', 'c': 'c'}
    assert leave_one_out.left_out(scores, place_of) == {'a': high, 'a2': high, 'b': low, 'c': low}


def test_map_whose_turns_are_unknown_has_no_score():
    right = measures.LapMeasures(1.0, 1.0, 0.0, 1.0, 0.1)
    assert leave_one_out.score(right, 1.0) == 1.0
    assert leave_one_out.score(right._replace(turns=math.nan), 1.0) == 0.0


def test_values_near_best_mean_are_equally_good():
    scores = {
        (('m', 'C', value),): {'a': mean - 0.1, 'b': mean + 0.1}
        for value, mean in ((1.0, 0.68), (2.0, 0.695), (3.0, 0.7))
    }
    assert leave_one_out.equally_good(scores) == [(('m', 'C', 2.0),), (('m', 'C', 3.0),)]


def test_pairs_of_vpr_bench_are_read_without_running_code(tmp_path: Path):
    pairs = np.empty((3, 2), object)
    pairs[:] = [[0, [0, 1]], [1, [300]], [2, [-1]]]
    path = tmp_path / 'ground_truth_new.npy'
    np.save(path, pairs, allow_pickle=True)
    assert place_recognition.ground_truth(tmp_path) == [(0, {0, 1}), (1, {300}), (2, set())]
    whole = path.read_bytes()
    header = whole[: whole.index(b'\n') + 1]
    others = (b'cbuiltins\nprint\n(U\x02hitR.', b'K\x01.', b'', whole[len(header):-20])
    for other in others:
        path.write_bytes(header + other)
        with pytest.raises(SystemExit, match='expected pairs of a query and a list'):
            place_recognition.ground_truth(tmp_path)


def test_each_mechanism_of_ablation_is_on() -> None:
    preset = load_config('navigation')[0]
    for config, mechanisms in ((Config(), ablation.MECHANISMS), (preset, ablation.NAVIGATION)):
        for name, values in mechanisms.items():
            is_named_only = name in (ablation.BASELINE, ablation.INSPECTION)
            assert (config.with_values(values) != config) != is_named_only


def test_ablation_table_in_docs_is_that_of_stored_results() -> None:
    page = (ROOT / 'docs/algorithm.md').read_text('utf-8')
    stored = ablation.papers.load(ROOT / 'benchmarks/ablation.json')
    assert page == ablation.with_tables(page, stored)


def test_differences_of_ablation_are_paired() -> None:
    found = {
        mechanism: {'loops': {
            variant: {'recall': value} for variant, value in zip('abc', values, strict=True)
        }}
        for mechanism, values in {
            ablation.BASELINE: (0.1, 0.5, 0.9), 'off': (0.2, 0.6, 1.0), 'noisy': (0.2, 0.4, 0.9),
        }.items()
    }
    off = ablation.difference(found, 'off', ['loops'], 'recall')
    assert off == pytest.approx((0.1, 0.0), abs=1e-9)
    mean, noise = ablation.difference(found, 'noisy', ['loops'], 'recall')
    assert (mean, noise) == pytest.approx((0.0, 0.1 / math.sqrt(3)))
