# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Speed of RatSLAM on a simulated data set of the length of St Lucia: 57,690 frames of 640x480.

    python benchmarks/replay_speed_st_lucia.py [--frames 57690] [--seed 1] [--out FOLDER]

A car with a colour camera at 10 Hz drives through a simulated town (`simulated_town.py`), through
most streets more than once; the preset is stlucia, with the additions of extended. The time
measured is that of a replay after reading the messages: conversion to grey and encoding in a
read-ahead thread, and RatSLAM. Rendering the frames is not measured. The target is 30 times real
time on two cores. Linux only.
"""

from __future__ import annotations

import argparse
import itertools
import math
import resource
import time
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from simulated_town import At, Camera, Laps, Pixels, Town, drive, resident_mb

from ratslam_ros.core.config import Value
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.files.config import load_config
from ratslam_ros.images import RawImage
from ratslam_ros.pipeline.items import ViewStep
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.recordings import ImageEvent
from ratslam_ros.recordings.prefetch import prefetch_prepared
from ratslam_ros.results.evaluation import fit

matplotlib.use('Agg')
import matplotlib.pyplot as plt

ROOT = Path(__file__).resolve().parents[1]
PRESET = 'stlucia'
CHANGED: dict[str, Value] = {
    'local_view.vt_match_threshold': 0.05, 'inputs.image_grey': 'luma',
    'experience_map.exp_relaxation': 'solve', 'pose_cells.pc_vt_agree_views': 3.0,
}
"""Parameters that differ from the preset: the threshold is adapted to the simulated world, and the
others are those of the preset extended."""
HZ, WIDTH, HEIGHT = 10, 640, 480
TARGET_RATIO = 30.0  # speed relative to real time
CHUNK = 128  # frames rendered before they are processed
WINDOW = 1000  # frames per point of the curves
SAME_PLACE_M, SAME_HEADING_RAD = 10.0, math.radians(20.0)
STEPS = ('decode', 'encode', 'visual_odometry.image', 'local_view.image', 'pose_cells.odometry',
         'pose_cells.template', 'experience_map.action')


@dataclass(frozen=True, slots=True)
class Message:
    """A sensor_msgs/Image as read by rosbags."""

    data: NDArray[np.uint8]
    height: int = HEIGHT
    width: int = WIDTH
    encoding: str = 'bgr8'
    is_bigendian: int = 0
    step: int = 3 * WIDTH


@dataclass
class Journey:
    """Timings, and the result of every frame."""

    slam: RatSLAM
    laps: Laps
    wall_s: float = 0.0
    rendering_s: float = 0.0
    truth: list[At] = field(default_factory=list)
    views: list[ViewStep] = field(default_factory=list)
    templates: array[int] = field(default_factory=lambda: array('q'))
    resident_mb: array[float] = field(default_factory=lambda: array('d'))

    def window_ms(self, step: str) -> NDArray[np.float64]:
        """Return the median time of a step over every WINDOW frames."""
        all_ms = np.array(self.laps.s[step]) * 1e3
        return np.array([np.median(all_ms[i : i + WINDOW]) for i in range(0, len(all_ms), WINDOW)])


def travel(frames: int, seed: int) -> Journey:
    """Drive through the town, and process every frame with RatSLAM."""
    config = load_config(PRESET)[0].with_values(CHANGED)
    laps = Laps()
    journey = Journey(RatSLAM(config, head='visual_odometry', stopwatch=laps), laps)
    town = Town()
    way = enumerate(itertools.islice(drive(town, seed, 1.0 / HZ), frames))
    camera = Camera(town, seed, WIDTH, HEIGHT)
    room = np.zeros((CHUNK, HEIGHT, WIDTH, 3), np.uint8)
    while chunk := list(itertools.islice(way, CHUNK)):
        start_s = time.perf_counter()
        for pixels, (number, at) in zip(room, chunk, strict=False):
            camera.take(at, number / HZ, pixels)
        journey.rendering_s += time.perf_counter() - start_s
        journey.truth += [at for _, at in chunk]
        look(journey, images(room, chunk))
        if len(journey.truth) // WINDOW > len(journey.resident_mb):
            journey.resident_mb.append(resident_mb())
    journey.views += [step for step in journey.slam.finish() if isinstance(step, ViewStep)]
    return journey


def images(room: Pixels, chunk: list[tuple[int, At]]) -> Iterator[ImageEvent]:
    for pixels, (number, _) in zip(room, chunk, strict=False):
        stamp_ns = (number + 1) * 10**9 // HZ
        yield ImageEvent(stamp_ns, stamp_ns, RawImage(Message(pixels.reshape(-1))))


def look(journey: Journey, events: Iterator[ImageEvent]) -> None:
    """Convert and process frames; measure all but the end of the thread."""
    slam, laps = journey.slam, journey.laps
    start_s = time.perf_counter()

    def prepare(event: ImageEvent) -> PreparedImage:
        with laps('decode'):
            grey = event.grey()
        with laps('encode'):
            return slam.prepare(grey)

    with prefetch_prepared(events, prepare) as prepared:
        for event, image in prepared:
            with laps('frame'):
                steps = slam.image(event.stamp_ns, image)
            journey.views += [step for step in steps if isinstance(step, ViewStep)]
            journey.templates.append(len(slam.local_view))
        journey.wall_s += time.perf_counter() - start_s


@dataclass(frozen=True)
class Recognition:
    """Place recognition in streets that were driven before.

    on_known: fraction of the frames in streets driven before
    recall: fraction of these frames that match a template of an earlier passage
    precision: fraction of such matches at the place and heading of the template
    error_m: distance of such matches from the place of the template
    """

    on_known: float
    recall: float
    precision: float
    error_m: NDArray[np.float64]


def recognition(journey: Journey) -> Recognition:
    learned: dict[int, int] = {}
    since = known = old = found = right = 0
    errors_m = []
    for number, (at, view) in enumerate(zip(journey.truth, journey.views, strict=True)):
        if number and at.passage != journey.truth[number - 1].passage:
            since = number
        learned_at = learned.setdefault(view.match.template_id, number)
        known += at.times_before > 0
        if learned_at >= since:
            continue
        then = journey.truth[learned_at]
        if then.passage != at.passage and number - learned_at < 10 * HZ:
            continue  # the previous street section is still in view
        old += 1
        found += at.times_before > 0
        error_m = math.hypot(at.x_m - then.x_m, at.y_m - then.y_m)
        turned = math.remainder(at.heading_rad - then.heading_rad, 2.0 * math.pi)
        right += error_m <= SAME_PLACE_M and abs(turned) <= SAME_HEADING_RAD
        errors_m.append(error_m)
    return Recognition(
        known / len(journey.truth), found / max(known, 1), right / max(old, 1), np.array(errors_m)
    )


def closures(journey: Journey) -> int:
    """Return the number of loop closures: links from the newest experience to an older one."""
    newest = -1
    closed = 0
    for view in journey.views:
        action = view.action
        if action.action == 'create':
            newest = action.target_id
        elif action.action == 'link' and action.source_id == newest:
            closed += 1
    return closed


def map_errors_m(journey: Journey) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return the final map's experiences aligned with the truth, the truth, and the scale.

    The scale is fitted, because the preset's vtrans_scaling is not meant for this world.
    """
    made_at = [i for i, view in enumerate(journey.views) if view.action.action == 'create']
    truth = np.array([(journey.truth[i].x_m, journey.truth[i].y_m) for i in made_at])
    poses = journey.slam.experience_map.poses[:, :2]
    transform = fit(poses, truth, scale=True)
    return transform.apply(poses), truth, transform.scale


def report(journey: Journey) -> str:
    frames, laps, slam = len(journey.truth), journey.laps, journey.slam
    duration_s = frames / HZ
    km = sum(at.speed_mps for at in journey.truth) / HZ / 1e3
    realtime = duration_s / journey.wall_s
    changed = ', '.join(f'{key}={value}' for key, value in CHANGED.items()) or 'unchanged'
    lines = [
        f'{frames} frames of {WIDTH}x{HEIGHT} bgr8 at {HZ} Hz: {duration_s:.0f} s, {km:.1f} km; '
        f'preset {PRESET}: {changed}',
        f'conversion and RatSLAM  {journey.wall_s:.1f} s wall, {realtime:.1f} times real time '
        f'(target {TARGET_RATIO:.0f}); not counted: {journey.rendering_s:.1f} s of rendering',
        'step, ms                median      p99    worst    all, s',
    ]
    for step in (*STEPS, 'frame'):
        times_ms = np.array(laps.s[step]) * 1e3
        lines.append(
            f'  {step:20} {np.median(times_ms):8.3f} {np.percentile(times_ms, 99):8.3f} '
            f'{times_ms.max():8.2f} {times_ms.sum() / 1e3:9.1f}'
        )
    lines.append('  (decode and encode run in parallel; frame: the sum of the others)')
    whole = journey.window_ms('frame')
    lines.append(
        f'median of the first and the last {WINDOW} frames  {whole[0]:.3f} and '
        f'{np.median(np.array(laps.s["frame"])[-WINDOW:]) * 1e3:.3f} ms'
    )
    experiences = slam.experience_map
    lines.append(
        f'{len(slam.local_view)} templates, {len(experiences)} experiences, '
        f'{experiences.link_count} links, {closures(journey)} loop closures (links from the '
        'newest experience to an older one)'
    )
    seen = recognition(journey)
    lines += [
        f'in streets driven before      {seen.on_known:.1%} of the frames; '
        f'{seen.recall:.1%} of these match a template of an earlier passage',
        f'precision of the matches      {seen.precision:.1%} within {SAME_PLACE_M:g} m and '
        f'{math.degrees(SAME_HEADING_RAD):.0f} deg of the pose of the template',
    ]
    if len(seen.error_m):
        median, most = np.percentile(seen.error_m, (50, 95))
        lines.append(f'distance from that pose       median {median:.1f} m, 95 % {most:.1f} m')
    aligned, truth, scale = map_errors_m(journey)
    error_m = np.sqrt(np.mean(np.sum((aligned - truth) ** 2, axis=1)))
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    room_mb = CHUNK * HEIGHT * WIDTH * 3 / 2**20
    resident = ', '.join(f'{mb:.0f}' for mb in journey.resident_mb[:: max(1, frames // 8000)])
    lines += [
        f'map against the truth         RMSE {error_m:.1f} m (scale of the visual odometry '
        f'fitted: {scale:.2f})',
        f'memory                        peak {peak_mb:.0f} MB, of which {room_mb:.0f} MB are '
        f'rendered frames; over the run {resident} MB',
    ]
    for wrong, what in (
        (realtime < TARGET_RATIO, f'slower than {TARGET_RATIO:.0f} times real time'),
        (not frames // 100 < len(slam.local_view) < frames // 2, 'implausible template count'),
        (seen.on_known > 0.0 and seen.recall < 0.5, 'low recall in streets driven before'),
        (seen.precision < 0.9, 'low precision'),
    ):
        if wrong:
            lines.append(f'MISSED: {what}')
    return '\n'.join(lines)


def plot(journey: Journey, path: Path) -> None:
    figure, (times, sizes, ways) = plt.subplots(3, 1, figsize=(9, 14), layout='constrained')
    for step in (*STEPS, 'frame'):
        curve = journey.window_ms(step)
        times.plot(WINDOW * (np.arange(len(curve)) + 0.5), curve, label=step)
    target = f'{TARGET_RATIO:.0f} x real time'
    times.axhline(1e3 / HZ / TARGET_RATIO, color='grey', linestyle=':', label=target)
    times.set(xlabel='frame', ylabel=f'ms per frame, median of {WINDOW}', yscale='log')
    times.legend(ncols=2)
    experiences = np.cumsum([view.action.action == 'create' for view in journey.views])
    sizes.plot(journey.templates, label='templates')
    sizes.plot(experiences, label='experiences')
    sizes.set(xlabel='frame', ylabel='number')
    memory = sizes.twinx()
    at = WINDOW * np.arange(1, len(journey.resident_mb) + 1)
    memory.plot(at, journey.resident_mb, color='grey', label='memory')
    most_mb = max(journey.resident_mb, default=1.0)
    memory.set(ylabel='resident memory, MB', ylim=(0.0, 1.2 * most_mb))
    sizes.legend()
    memory.legend(loc='lower right')
    aligned, truth, scale = map_errors_m(journey)
    ways.plot(*truth.T, '.', color='lightgrey', label='true positions of experiences')
    ways.plot(*aligned.T, '.', markersize=1, label=f'final map, aligned (scale {scale:.2f})')
    ways.set(aspect='equal', xlabel='x, m', ylabel='y, m')
    ways.legend()
    figure.savefig(path, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--frames', type=int, default=57690)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--out', type=Path, default=ROOT / 'results' / 'benchmarks')
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    warm_up()
    journey = travel(options.frames, options.seed)
    print(report(journey))
    path = options.out / 'st_lucia_length.png'
    plot(journey, path)
    print(f'plot: {path}')


if __name__ == '__main__':
    main()
