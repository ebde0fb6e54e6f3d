# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replay: build a map from a recording, as fast as possible and without dropping messages."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ratslam_ros.console import Progress, ProgressBar, print_notice
from ratslam_ros.core.common.odometry import MAX_GAP_NS
from ratslam_ros.core.common.scan import UnusableScan
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.errors import UnusableInput
from ratslam_ros.event_inputs import (
    calibrated,
    check_lasers,
    head_of,
    input_from_event,
    laser_mounts,
)
from ratslam_ros.files.config import to_yaml
from ratslam_ros.history.file import HISTORY_NAME, HistoryMeta
from ratslam_ros.history.recorder import Recorder
from ratslam_ros.history.writer import HistoryWriter
from ratslam_ros.limits import IMAGES_RATE_HZ
from ratslam_ros.messages.json_schema import MalformedMessage, encode
from ratslam_ros.messages.landmarks import LandmarksPayload
from ratslam_ros.offline.movement import Movement
from ratslam_ros.offline.replay_map import ReplayMap
from ratslam_ros.offline.replay_video import STRIDE, ReplayVideo
from ratslam_ros.pipeline.items import Step
from ratslam_ros.pipeline.landmark_map import LandmarkMapStage
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.pipeline.stage import Stage
from ratslam_ros.recordings import Event, ImageEvent, Recording, Selection, UndecodableImage
from ratslam_ros.recordings.prefetch import IMAGE_BATCH_COUNT, prefetch_prepared
from ratslam_ros.results.advice import Observations
from ratslam_ros.results.writer import Results
from ratslam_ros.signals import StopSignals
from ratslam_ros.timing import StepTimes
from ratslam_ros.version import __version__

PROGRESS_DELAY_S = 0.5
"""Delay of the progress bar: errors in the options, found before, are one line only."""

SHOW_NS = 500_000_000
"""Time between two moments at which viewers see all of a recording without an end."""


@dataclass(frozen=True)
class ReplayOptions:
    """Part of the recording to replay, and output while it runs.

    start_s: skipped seconds at the start. duration_s: limit on the duration, None for the rest.
    video: file for a video of the growing map, None for none. progress: show a progress bar,
    or call this instead.
    landmarks: build the map of the node landmark_map, too. history: write history.sqlite.
    images_rate_hz: rate with which the recording was opened, noted in the history.
    map_file: map to be continued, None for a map that ends with the replay.
    stages: stages of the user, see ``RatSLAM``.
    """

    start_s: float = 0.0
    duration_s: float | None = None
    video: Path | None = None
    progress: bool | Progress = True
    landmarks: bool = False
    history: bool = False
    images_rate_hz: float = IMAGES_RATE_HZ
    map_file: ReplayMap | None = None
    stages: Sequence[type[Stage]] = ()


@dataclass(frozen=True)
class ReplayOutcome:
    """Result of a replay.

    summary: content of summary.json. interrupted: whether the replay was interrupted.
    config: the parameters, with the field of view of camera_info. observations: evidence for
    advice on problems. experience_map: the map.
    """

    summary: dict[str, Any]
    interrupted: bool
    config: Config
    observations: Observations
    experience_map: ExperienceMap


def replay(
    recording: Recording,
    selection: Selection,
    config: Config,
    folder: Path,
    options: ReplayOptions = ReplayOptions(),
) -> ReplayOutcome:
    """Replay a recording and write the results.

    An interrupt (SIGINT, SIGTERM) ends the replay after the current event; the results up to
    then are written. It is the end of a recording without an end.

    Args:
        recording: the recording.
        selection: its topics to use.
        config: all parameters.
        folder: the folder for the results; it is created.
        options: see `ReplayOptions`.

    Raises:
        UnusableInput: nothing of the recording can be replayed, or the folder cannot be written.
        UnusableParameter: a crop or window does not fit the images.
        KeyboardInterrupt: interrupted before the first result.
    """
    run = _Run(recording, selection, config, folder, options)
    interrupted = False
    try:
        with ExitStack() as stack:
            stop = stack.enter_context(StopSignals())
            if options.video is not None:
                run.video = stack.enter_context(ReplayVideo(options.video, run.slam))
            events = recording.events(selection, options.start_s, options.duration_s)
            if options.map_file is not None:
                events = options.map_file.remaining(events)
            decoded = stack.enter_context(prefetch_prepared(
                events, run.prepare, 1 if recording.is_endless else IMAGE_BATCH_COUNT
            ))
            bar = stack.enter_context(
                ProgressBar(
                    run.length_s, shown=not recording.is_endless and options.progress,
                    delay_s=PROGRESS_DELAY_S, status=run.status, label='mapping ',
                )
            )
            for event, image in decoded:
                run.feed(event, image)
                bar.update(run.duration_s)
                if stop.received:
                    if not recording.is_endless:
                        raise KeyboardInterrupt
                    recording.stop()
    except BaseException as error:
        if not isinstance(error, KeyboardInterrupt) or run.results is None:
            run.abandon()
            raise  # Without results, those of an earlier run in the folder stay.
        interrupted = True
    if run.video is not None and options.progress:
        print_notice(
            f'{options.video}: {run.video.frames} frames, one for every {STRIDE} images, in '
            f'{run.video.took_s:.1f} s'
        )
    complete = not interrupted and options.duration_s is None
    try:
        if not interrupted:
            run.check_images()
        summary = run.finish(complete)
    except UnusableInput:  # no image can be decoded, or the disk is full
        run.abandon()
        raise
    return ReplayOutcome(
        summary, interrupted, run.config, run.observations, run.slam.experience_map
    )


class _Run:
    """State of one replay: RatSLAM, its results, and the counts for the summary."""

    def __init__(
        self,
        recording: Recording,
        selection: Selection,
        config: Config,
        folder: Path,
        options: ReplayOptions,
    ) -> None:
        self.times = StepTimes()
        head = head_of(selection)
        visual_odometry = head == 'visual_odometry'
        if visual_odometry:
            config = calibrated(config, recording, selection)
        landmarks = [LandmarkMapStage] if options.landmarks else []
        self.slam = RatSLAM(config, head, self.times, [*options.stages, *landmarks])
        if config.experience_map.exp_align_scans:
            check_lasers(selection, config.experience_map.lasers)
        self._recorder: Recorder | None = None
        if options.history:
            path = recording.path
            meta = HistoryMeta(
                recording.name, __version__, to_yaml(config),
                str(path.absolute()) if path.exists() else '',
                image_topic=selection.image_topic or '', images_rate_hz=options.images_rate_hz,
            )
            self._recorder = Recorder(
                self.slam, lambda: HistoryWriter(folder / HISTORY_NAME, meta, recording.warn)
            )
        self._folder, self._is_new = folder, not folder.exists()  # before the map, maybe in it
        self._map = options.map_file
        if options.landmarks and (visual_odometry or selection.scan_topic is None):
            raise UnusableInput(
                'landmarks need recorded odometry and scans, but the recording has no '
                f'{"odometry" if visual_odometry else "scans"}: leave out --landmarks'
            )
        if self._map is not None:
            self._map.open(self.slam, recording, selection, config, options.start_s)
        self.results: Results | None = None
        """Opened at the first result, so that errors before it leave no files behind."""
        self.video: ReplayVideo | None = None
        self._times_ns: tuple[int, int] | None = None
        """Recording times of the first message and of the last one up to now."""
        self.length_s = (recording.end_ns - recording.start_ns) * 1e-9 - options.start_s
        """Duration of the part of the recording that is replayed."""
        if options.duration_s is not None:
            self.length_s = min(self.length_s, options.duration_s)
        self.observations = Observations()
        self._recording = recording
        self.config = config
        self._movement = Movement(config.inputs.odom_source, str(selection.odom_topic))
        self._mounts = laser_mounts(recording, selection)
        self._lacks_scans = self.slam.scan_matcher is not None and selection.scan_topic is None
        self._images = self._undecoded = 0
        """Number of images, and of those that could not be decoded."""
        self._unusable: Counter[str] = Counter()
        self._first_errors: dict[str, str] = {}
        self._start_s = time.perf_counter()
        self._shown_ns = 0

    def prepare(self, event: ImageEvent) -> PreparedImage:
        """Decode an image, and compute what depends on it alone, on another thread."""
        try:
            with self.times('decode'):
                image = event.grey(self.config.inputs.image_grey)
                colour = event.bgr() if self.slam.wants_colour else None
            with self.times('encode'):
                return self.slam.prepare(image, colour)
        except UndecodableImage as error:
            self._first_errors.setdefault(event.KIND, str(error))
            raise

    def feed(self, event: Event, image: PreparedImage | None) -> None:
        """Process one event.

        Args:
            event: the event.
            image: its prepared image, None if there is none.
        """
        first_ns, last_ns = self._times_ns or (event.log_ns, event.log_ns)
        self._times_ns = first_ns, max(last_ns, event.log_ns)
        if self.results is not None and self.length_s > 0.0:
            self.results.share = self.duration_s / self.length_s
        self._process(event, image)
        if self._recording.is_endless and event.log_ns - self._shown_ns >= SHOW_NS:
            self._shown_ns = event.log_ns
            if self._recorder is not None:
                self._recorder.flush()
        if self._map is not None:
            self._map.after(event, self._last_view_ns)

    def _process(self, event: Event, image: PreparedImage | None) -> None:
        try:
            stream, stamp_ns, item = input_from_event(event, self._mounts, image)
        except (UnusableScan, MalformedMessage) as error:
            self._unusable[event.KIND] += 1
            self._first_errors.setdefault(event.KIND, str(error))
            return
        if isinstance(event, ImageEvent):
            self._images += 1
            self._undecoded += image is None
            if self.video is not None:
                self.video.add_image(event)
            if self._recorder is not None:
                self._recorder.add_image(stamp_ns, event.image, image)
        elif stream == 'scan' and self._recorder is not None:  # the first of several lasers
            self._recorder.add_scan(item)
        elif stream == 'odometry':
            self._movement.add(item)
        self._write(self.slam.feed(stream, stamp_ns, item))

    @property
    def _last_view_ns(self) -> int:
        """Stamp of the last view of this replay with a template, 0 if there is none."""
        return 0 if self.results is None else self.results.last_view_ns

    @property
    def _is_blind(self) -> bool:
        """Whether there were images and none could be decoded, also in the part before."""
        is_continued = self._map is not None and self._map.skipped > 0
        return 0 < self._images == self._undecoded and not is_continued

    def check_images(self) -> None:
        """Raise UnusableInput if no image could be decoded."""
        if self._is_blind:
            raise UnusableInput(
                f'none of the {self._images} images of {self._recording.path} can be decoded: '
                f'{self._first_errors[ImageEvent.KIND]}'
            )

    def finish(self, complete: bool = False) -> dict[str, Any]:
        """Process all held messages, write all files, and return the summary.

        Args:
            complete: the recording was replayed to its end. Otherwise the map file keeps the
                messages that are held, so that the replay can be continued.
        """
        if self._map is not None:
            self._map.save_before_end()
        self._write(self.slam.finish())
        if self._map is not None:
            self._map.finish(complete, self._last_view_ns)
        wall_s = self.elapsed_s
        results = self.results or Results(self._folder, self.config)
        results.check_folder()
        if self._lacks_scans:
            self._recording.warn(
                'exp_align_scans is set, but the recording has no scans: the map is built '
                'without them'
            )
        if self._movement.warning:
            self._recording.warn(self._movement.warning)
        if self._undecoded:
            self._recording.warn(
                f'{self._undecoded} of the {self._images} images cannot be decoded and are '
                f'dropped, the first: {self._first_errors[ImageEvent.KIND]}'
            )
        for kind, count in self._unusable.items():
            self._recording.warn(
                f'{count} {kind} messages were not used, the first: {self._first_errors[kind]}'
            )
        counts = self.slam.counts
        local_view = self.slam.local_view
        low_texture = 0 if local_view is None else local_view.low_texture
        gaps = {
            'odometry_gaps': results.gap_count,
            'components': self.slam.experience_map.component_count,
        } if self.config.inputs.max_odom_gap_s * 1e9 < MAX_GAP_NS else {}
        summary = {
            **results.summary(self.slam.experience_map),
            **gaps,
            **{k: round(v, 6) for k, v in self.slam.pose_cells.lengths.report().items()},
            'dropped': (
                results.without_view - low_texture + self._unusable.total()
                + self._recording.skipped
            ),
            'low_texture': low_texture,
            'late': counts.late,
            'refused': counts.refused,
            'duration_s': round(self.duration_s, 3),
            'wall_s': round(wall_s, 3),
            'times_realtime': round(self.duration_s / wall_s, 1) if wall_s > 0.0 else 0.0,
            'step_ms': self.times.summary_ms(),
        }
        if self.slam.visual_odometry is not None:
            summary['visual_odometry'] = True
        calibration = self.slam.pose_cells.calibration
        if calibration is not None:
            turns = self.slam.experience_map.optimiser.turns
            summary['odom_calibration'] = calibration.summary(turns)
        if self._map is not None:
            summary['map'] = self._map.summary()
            results.last_view_ns = self._map.last_view_ns
        landmarks = self.slam.pipeline.stages.get('landmark_map')
        if isinstance(landmarks, LandmarkMapStage):
            frame_id = self.config.landmark_map.map_frame
            payload = LandmarksPayload.of(landmarks.scan_ns, landmarks.core, frame_id)
            results.write('landmarks.json', encode(payload))
            summary['landmarks'] = len(landmarks.core)
        results.finish(self.slam.experience_map, summary)
        if self._recorder is not None:
            self._recorder.close()
        else:
            (self._folder / HISTORY_NAME).unlink(missing_ok=True)  # That of an earlier run.
        self.results = results
        return summary

    def abandon(self) -> None:
        """End after an error: write the results, or keep those of an earlier run."""
        if self._map is not None:
            self._map.abandon()
        results = self.results
        if results is not None and not results.is_discarded:
            if not (self._folder / 'map.json').exists() and not self._is_blind:
                self.finish()
                return
            results.discard()
        if self._recorder is not None:
            self._recorder.discard()
        if self._is_new:
            with suppress(OSError):  # it has files, or was not created
                self._folder.rmdir()

    @property
    def elapsed_s(self) -> float:
        """Time since the start of the replay in seconds, with reading and decoding.

        The time spent on the video does not count.
        """
        video_s = 0.0 if self.video is None else self.video.took_s
        return time.perf_counter() - self._start_s - video_s

    @property
    def duration_s(self) -> float:
        """Time from the first to the last replayed message in s."""
        first_ns, last_ns = self._times_ns or (0, 0)
        return (last_ns - first_ns) * 1e-9

    def status(self) -> str:
        """Return the speed of the replay and the size of the map, for the progress bar."""
        text = f'{self.duration_s / max(self.elapsed_s, 1e-6):.0f}x real time'
        results = self.results
        if results is not None:
            text += (
                f', {results.templates} templates, {results.experiences} experiences, '
                f'{results.closures.count} loop closures'
            )
        return text

    def _write(self, steps: list[Step]) -> None:
        if not steps:
            return
        if self.results is None:
            self.results = Results(self._folder, self.config)
        for step in steps:
            self.results.add(step)
            self.observations.add(step)
            if self._recorder is not None:
                self._recorder.add(step)
            if self.video is not None:
                self.video.add_step(step)
