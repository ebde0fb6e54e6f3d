# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replay: recording -> map, in lock-step, as fast as the machine can, nothing dropped."""

from __future__ import annotations

import signal
import threading
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan, UnusableScan, checked_scan
from ratslam_ros.core.config import Config
from ratslam_ros.core.ratslam import RatSLAM, Step, ViewStep
from ratslam_ros.core.vision.visual_odometry import field_of_view_deg
from ratslam_ros.messages.mapping import MalformedMessage, decode_template
from ratslam_ros.progress import ProgressBar
from ratslam_ros.recordings import (
    Event,
    ImageEvent,
    OdometryEvent,
    Recording,
    ScanEvent,
    Selection,
    UndecodableImage,
)
from ratslam_ros.recordings.prefetch import prefetch_images
from ratslam_ros.results.video import MapVideo
from ratslam_ros.results.writer import Results
from ratslam_ros.timing import StepTimes

PROGRESS_DELAY_S = 0.5
"""The progress bar appears later than errors in the options, which then take one line."""


@dataclass(frozen=True)
class ReplayOptions:
    """What of a recording is replayed, and what is shown meanwhile."""

    start_s: float = 0.0
    duration_s: float | None = None
    video: Path | None = None
    progress: bool = True


@dataclass(frozen=True)
class ReplayOutcome:
    """How a replay ended."""

    summary: dict[str, Any]
    interrupted: bool


def replay(
    recording: Recording,
    selection: Selection,
    config: Config,
    folder: Path,
    options: ReplayOptions = ReplayOptions(),
) -> ReplayOutcome:
    """Replay a recording and write the results; an interrupt writes those so far.

    Raises:
        UnusableInput: the recording has nothing to replay, or the folder cannot be written.
        UnusableParameter: a crop or window does not fit the images.
    """
    run = _Run(recording, selection, config, folder, options)
    interrupted = False
    try:
        with ExitStack() as stack:
            interrupts = stack.enter_context(_Interrupts())
            if options.video is not None:
                run.film = stack.enter_context(_Film(options.video, run.slam))
            events = recording.events(selection, options.start_s, options.duration_s)
            decoded = stack.enter_context(prefetch_images(events, run.times))
            bar = stack.enter_context(
                ProgressBar(
                    recording, options.start_s, options.duration_s,
                    shown=options.progress, delay_s=PROGRESS_DELAY_S, status=run.status,
                )
            )  # fmt: skip
            for event, image in decoded:
                run.feed(event, image)
                bar.update(run.span.duration_s)
                if interrupts.seen:
                    raise KeyboardInterrupt
    except KeyboardInterrupt:
        if run.results is None:
            raise  # nothing to write; earlier results in the folder stay
        interrupted = True
    except BaseException:
        run.abandon()
        raise
    return ReplayOutcome(run.finish(), interrupted)


class _Interrupts:
    """Keeps SIGINT and SIGTERM until a step is done, so that nothing is left half done.

    Raised wherever they fall they could also come out of compiled code as an internal error. A
    second one is raised at once, for a recording that gives no more events.
    """

    def __init__(self) -> None:
        self.seen = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():  # others cannot set signals
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: object) -> None:
        if self.seen:
            raise KeyboardInterrupt
        self.seen = True


class _Run:
    """One replay: RatSLAM, its results, and what was counted on the way."""

    def __init__(
        self,
        recording: Recording,
        selection: Selection,
        config: Config,
        folder: Path,
        options: ReplayOptions,
    ) -> None:
        self.times = StepTimes()
        visual_odometry = selection.odom_topic is None and selection.image_topic is not None
        if visual_odometry:
            config = _calibrated(config, recording, selection)
        self.slam = RatSLAM(
            config,
            visual_odometry=visual_odometry,
            stopwatch=self.times,
        )
        # Opened at the first result: what is refused before leaves no files behind.
        self.results: Results | None = None
        self.film: _Film | None = None
        self.span = _Span()
        self._recording = recording
        self._config = config
        self._folder = folder
        self._without_scans = self.slam.scan_matcher is not None and selection.scan_topic is None
        self._unused: Counter[str] = Counter()
        self._why_unused: dict[str, str] = {}
        self._start_s = time.perf_counter()

    def feed(self, event: Event, image: NDArray[np.uint8] | None) -> None:
        """Process one event; ``image`` is its decoded image, None if it has none."""
        self.span.add(event.log_ns)
        if isinstance(event, OdometryEvent):
            self._keep(self.slam.odometry(_odometry(event)))
        elif isinstance(event, ImageEvent):
            if self.film is not None:
                self.film.keep(event)
            self._keep(self.slam.image(event.stamp_ns, image))
        elif isinstance(event, ScanEvent):
            try:
                self.slam.scan(_scan(event))
            except UnusableScan as error:
                self._pass_over('scan', error)
        else:
            try:
                stamp_ns, match, _ = decode_template(event.payload)
            except MalformedMessage as error:
                self._pass_over('template', error)
                return
            self._keep(self.slam.template(stamp_ns, match))

    def finish(self) -> dict[str, Any]:
        """Process what still waits, write all files, return the summary."""
        self._keep(self.slam.finish())
        wall_s = self.elapsed_s
        results = self.results or Results(self._folder)
        warnings = self._recording.warnings
        if self._without_scans:
            warnings.append('no scans are there for exp_align_scans: the map is made without')
        for kind, number in self._unused.items():
            warnings.append(
                f'{number} {kind} messages were not used, the first: {self._why_unused[kind]}'
            )
        counts = self.slam.counts
        summary = {
            'frames': results.frames,
            'odometry': results.odometry,
            'templates': results.templates,
            'experiences': len(self.slam.experience_map),
            'links': self.slam.experience_map.link_count,
            'loop_closures': results.loop_closures,
            'dropped': results.without_view + self._unused.total() + self._recording.skipped,
            'late': counts.late,
            'refused': counts.refused,
            'duration_s': round(self.span.duration_s, 3),
            'wall_s': round(wall_s, 3),
            'times_realtime': round(self.span.duration_s / wall_s, 1) if wall_s > 0.0 else 0.0,
            'step_ms': self.times.summary_ms(),
        }
        results.finish(self.slam.experience_map, self._config, summary)
        self.results = results
        return summary

    def abandon(self) -> None:
        """End after an error: neither what was mapped is lost nor an earlier run's map."""
        if self.results is None:
            return
        if (self._folder / 'map.json').exists():
            self.results.discard()
        else:
            self.finish()

    @property
    def elapsed_s(self) -> float:
        """Time since the start of the replay, reading and decoding included."""
        return time.perf_counter() - self._start_s

    def status(self) -> str:
        """Return the speed of the replay and the size of the map, for the progress bar."""
        text = f'{self.span.duration_s / max(self.elapsed_s, 1e-6):.0f}x real time'
        results = self.results
        if results is not None:
            text += (
                f', {results.templates} templates, {results.experiences} experiences, '
                f'{results.loop_closures} loop closures'
            )
        return text

    def _pass_over(self, kind: str, error: Exception) -> None:
        self._unused[kind] += 1
        self._why_unused.setdefault(kind, str(error))

    def _keep(self, steps: list[Step]) -> None:
        if not steps:
            return
        if self.results is None:
            self.results = Results(self._folder)
        for step in steps:
            self.results.add(step)
            if self.film is not None:
                self.film.add(step)


def _odometry(event: OdometryEvent) -> Odometry:
    return Odometry(
        event.stamp_ns,
        Twist(event.linear_x, event.angular_z),
        Pose(event.x, event.y, event.heading_rad),
    )


def _scan(event: ScanEvent) -> Scan:
    return checked_scan(
        event.stamp_ns,
        event.angle_min_rad,
        event.angle_increment_rad,
        event.range_min_m,
        event.range_max_m,
        event.ranges_m,
    )


def _calibrated(config: Config, recording: Recording, selection: Selection) -> Config:
    """Take the field of view from the recording, as visual_odometry takes it from camera_info."""
    camera = recording.calibration(selection)
    if camera is None or not config.visual_odometry.fov_from_camera_info:
        return config
    fov_deg = field_of_view_deg(camera.focal_px, camera.width_px)
    return config.with_values({'visual_odometry.camera_fov_deg': fov_deg})


class _Span:
    """From the first to the last time of the recording that was replayed."""

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._last_ns = 0

    def add(self, log_ns: int) -> None:
        if self._first_ns is None:
            self._first_ns = self._last_ns = log_ns
        self._last_ns = max(self._last_ns, log_ns)

    @property
    def duration_s(self) -> float:
        return 0.0 if self._first_ns is None else (self._last_ns - self._first_ns) * 1e-9


class _Film:
    """The video of a replay; keeps the images that wait for their turn."""

    def __init__(self, path: Path, slam: RatSLAM) -> None:
        self._slam = slam
        self._video = MapVideo(path)
        self._images: dict[int, ImageEvent] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._video.close()

    def keep(self, event: ImageEvent) -> None:
        """Remember an image until its template message is processed."""
        self._images[event.stamp_ns] = event

    def add(self, step: Step) -> None:
        """Write a frame if this step is a view's."""
        if not isinstance(step, ViewStep):
            return
        for stamp_ns in [s for s in self._images if s < step.stamp_ns]:
            del self._images[stamp_ns]
        event = self._images.pop(step.stamp_ns, None)
        if event is None:
            return
        try:
            image = event.bgr()
        except UndecodableImage:
            return
        known = step.match.template_id
        self._video.write(
            image,
            self._slam.local_view.template(known) if known >= 0 else None,
            self._slam.pose_cells.activity(),
            self._slam.experience_map.poses[:, :2],
            self._slam.experience_map.pose,
            f'template {known}  experience {step.action.target_id}  {step.action.action}',
        )
