# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inspection of a recording before it is replayed without a configuration.

The inspection sets what depends on the robot and its camera and cannot be estimated while driving:
the used part of the odometry messages, the crop, and the least structure of faint images. For a
camera without odometry, it also sets how much different places look alike, and the field of view
with which the replay begins. Results depend on the recording alone, never on the time that the
inspection takes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from ratslam_ros.console import Progress, ProgressBar
from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.config import WHOLE, Config, LocalViewParameters, Value, declared
from ratslam_ros.core.config.additions import uses_odometry
from ratslam_ros.core.vision.image_window import Window
from ratslam_ros.core.vision.intensity import crop_window
from ratslam_ros.core.vision.match_threshold import RELATED_RATIO
from ratslam_ros.core.vision.structure import structure
from ratslam_ros.event_inputs import calibrated, odometry_from_event
from ratslam_ros.offline.look_ahead import field_of_view_deg, look_ahead, look_alike_ratio
from ratslam_ros.offline.movement import Movement
from ratslam_ros.pipeline.order import StampOrder
from ratslam_ros.recordings import (
    Event,
    ImageEvent,
    OdometryEvent,
    Recording,
    Selection,
    UndecodableImage,
)
from ratslam_ros.recordings.describe import mean_rate_hz
from ratslam_ros.results.advice import GAP_S

Image = NDArray[np.uint8]

MAX_DURATION_S = 600.0
"""Duration of the inspected part. Odometry and camera are the same throughout a recording."""

MAX_IMAGE_COUNT = 240
"""Number of images that are decoded."""

SMALL_WIDTH_PX = 320
"""Images are shrunk by an integer factor, to at least this width."""

MIN_IMAGE_COUNT = 20
"""With fewer images, static borders cannot be told from a robot at rest."""

STATIC_RATIO = 0.15
"""Rows and columns with a smaller fraction of the median deviation over time are static."""

MAX_BORDER_RATIO = 0.4
"""A larger static border at one side is part of the scene, such as a ceiling, and is kept."""

MIN_BORDER_RATIO = 0.02
"""Narrower borders have no effect on templates."""

FAINT_SHARE = 0.25
"""Least structure of a view in a faint recording, relative to the 0.9 quantile of the structure
of all views. A camera that is covered half of the time changes this quantile little. In the
recordings at hand, blank walls have a tenth of it, and all other views at least 0.3."""

NOISE_STRUCTURE = 0.0125
"""Structure of sensor noise without a scene, of 10 grey levels at 320 x 240 px. If nine tenths of
the views have less, the camera is covered or it is dark: they are not faint views."""

FIELD_OF_VIEW = 'visual_odometry.camera_fov_deg'
STRUCTURE = 'local_view.vt_min_structure'

EMPTY_M, EMPTY_RAD = 0.5, 0.5
"""Movement by the pose from which a twist of zeros is empty, not that of a robot at rest."""


@dataclass(frozen=True)
class Inspection:
    """Configuration for a recording, and the reasons for it: rotation, odometry, images.

    jumps: a warning if the odometry jumps, or ''. A replay adds its own, of all that it replays.
    """

    config: Config
    lines: tuple[str, ...]
    jumps: str


def inspect(
    recording: Recording, selection: Selection, config: Config, fixed: Collection[str] = (),
    start_s: float = 0.0, duration_s: float | None = None, progress: bool | Progress = False,
) -> Inspection:
    """Choose parameters for a recording.

    Args:
        recording: the recording.
        selection: its topics to use.
        config: the initial parameters.
        fixed: parameters, by full name, that keep their value.
        start_s, duration_s: the part of the recording to use, in s, as for a replay.
        progress: show a progress bar for each pass over the recording, or call this instead.

    Raises:
        UnusableInput: nothing can be read.
        UnusableParameter: a crop or window does not fit the images.
    """
    fixed = {name for key in fixed for name in declared(key)}
    part_s = MAX_DURATION_S if duration_s is None else min(MAX_DURATION_S, duration_s)
    length_s = min(part_s, (recording.end_ns - recording.start_ns) * 1e-9 - start_s)

    def events() -> Iterator[Event]:
        """Yield the events of the part, and show how much has been read."""
        start_ns = recording.start_ns + round(start_s * 1e9)
        with ProgressBar(length_s, shown=progress, label='inspecting ') as bar:
            for event in recording.events(selection, start_s, part_s):
                bar.update((event.log_ns - start_ns) * 1e-9)
                yield event

    found = _read(events(), length_s, config.inputs.image_grey)
    if late := _late(found, selection, config.inputs.max_lateness_s):
        recording.warn(late)
    jumps, odometry, odometry_line = _odometry(found, selection, config)
    images, images_line = _images(found, config.local_view, STRUCTURE in fixed)
    chosen = {**odometry, **images}
    config = config.with_values({name: chosen[name] for name in chosen if name not in fixed})
    if selection.odom_topic is not None:
        rotation_line = f'that of {selection.odom_topic}{_from_loops(config)}'
    else:
        camera, rotation_line, text = _camera(recording, selection, config, fixed, events)
        config = config.with_values(camera)
        images_line += text
    return Inspection(config, (
        f'rotation: {rotation_line}', f'odometry: {odometry_line}', f'images: {images_line}'
    ), jumps)


@dataclass
class _Found:
    """What was read.

    duration_s: length of the part. odometry: messages. image_ns: stamps of all images.
    odometry_delays_ns, image_delays_ns: recording times minus stamps. shape: height and width of
    the first image. images: some of the images, shrunk by ``factor``. encoding: that of the last
    one. problem: why the last image that could not be decoded could not.
    """

    duration_s: float
    odometry: list[Odometry] = field(default_factory=list)
    odometry_delays_ns: list[int] = field(default_factory=list)
    image_ns: list[int] = field(default_factory=list)
    image_delays_ns: list[int] = field(default_factory=list)
    shape: tuple[int, ...] = ()
    images: list[Image] = field(default_factory=list)
    encoding: str = ''
    problem: str = ''

    @property
    def factor(self) -> int:
        """Factor by which the images are shrunk."""
        return max(1, self.shape[1] // SMALL_WIDTH_PX)

    def add(self, image: Image) -> None:
        """Add a decoded image, if it has the size of the first one."""
        self.shape = self.shape or image.shape
        if image.shape == self.shape:
            size = image.shape[1] // self.factor, max(1, image.shape[0] // self.factor)
            small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
            self.images.append(np.asarray(small, np.uint8))


def _read(events: Iterator[Event], duration_s: float, grey: str) -> _Found:
    found = _Found(duration_s)
    step_ns = duration_s * 1e9 / MAX_IMAGE_COUNT
    due_ns = -1.0
    for event in events:
        if isinstance(event, OdometryEvent):
            found.odometry.append(odometry_from_event(event))
            found.odometry_delays_ns.append(event.log_ns - event.stamp_ns)
        elif isinstance(event, ImageEvent):
            found.image_ns.append(event.stamp_ns)
            found.image_delays_ns.append(event.log_ns - event.stamp_ns)
            if event.log_ns >= due_ns:
                due_ns = event.log_ns + step_ns
                try:
                    found.add(event.grey(grey))
                    found.encoding = event.image.encoding
                except UndecodableImage as error:
                    found.problem = str(error)
    return found


def _from_loops(config: Config) -> str:
    is_calibrated = config.pose_cells.odom_calibration
    return ', corrected by closed loops while driving' if is_calibrated else ''


def _camera(
    recording: Recording, selection: Selection, config: Config, fixed: Collection[str],
    events: Callable[[], Iterator[Event]],
) -> tuple[dict[str, Value], str, str]:
    """Return settings of the camera, a description of them, and an addition to that of the images.

    The settings are the field of view if returns show it, and the ratio of the match threshold if
    places look alike; the addition is '' if they do not.
    """
    seen = calibrated(config, recording, selection)
    fov_deg = seen.visual_odometry.camera_fov_deg
    is_known = seen is not config or FIELD_OF_VIEW in fixed
    if seen is not config:
        line = f'field of view {fov_deg:.1f} deg, from camera_info'
    else:
        line = f'field of view {fov_deg:g} deg ' + (
            f'as set{_from_loops(config)}' if is_known else
            f'assumed{_from_loops(config)}; set {FIELD_OF_VIEW} if you know it'
        )
    ratio = 'local_view.vt_match_ratio'
    if ratio in fixed or not uses_odometry(config.local_view):
        return {}, line, ''
    looks = look_ahead(events(), config)
    settings: dict[str, Value] = {}
    if not is_known:
        found_deg = field_of_view_deg(looks, config)
        if found_deg is None:  # With a wrong one, closed loops would seem to lead away.
            return settings, line, ''
        settings[FIELD_OF_VIEW] = fov_deg = round(found_deg, 1)
        line = f'field of view {fov_deg:g} deg as returns to places show{_from_loops(config)}'
    found = look_alike_ratio(looks, config, fov_deg)
    if found is None or (found := round(found, 3)) >= RELATED_RATIO:
        return settings, line, ''
    text = f'; places look alike: vt_match_ratio {found} keeps 98% of them apart'
    return {**settings, ratio: found}, line, text


# Odometry


def _odometry(
    found: _Found, selection: Selection, config: Config
) -> tuple[str, dict[str, Value], str]:
    """Return a warning of jumps, the part of the messages to use, and a description of them."""
    gap_s = min(config.inputs.max_odom_gap_s, GAP_S)
    settings: dict[str, Value] = {}
    if selection.odom_topic is None:
        return '', {}, f'estimated from the images; {_gaps(found.image_ns, "image", gap_s)}'
    stamps = [message.stamp_ns for message in found.odometry]
    source = config.inputs.odom_source
    other = 'pose' if source == 'twist' else 'twist'
    used, unused = Movement(source, selection.odom_topic), Movement(other, selection.odom_topic)
    for message in found.odometry:
        used.add(message)
        unused.add(message)
    why = ''
    if (used.distance_m == 0.0 and unused.distance_m > EMPTY_M) or (
        used.turn_rad == 0.0 and unused.turn_rad > EMPTY_RAD
    ):
        settings = {'inputs.odom_source': other}
        why = f', because the {source} is empty'
        source, used = other, unused
    if not used.distance_m and not used.turn_rad:
        moves = 'the robot never moves: choose another topic, or try --visual-odometry'
    else:
        moves = f'{used.distance_m:.0f} m and {np.degrees(used.turn_rad):.0f} deg of turns'
    return used.warning, settings, (
        f'{source} of {selection.odom_topic}{why}, {_rate(stamps, found)}, {moves}; '
        f'{_gaps(stamps, "message", gap_s, found.image_ns)}'
    )


def _late(found: _Found, selection: Selection, max_lateness_s: float) -> str:
    """Return a warning if the stamps of one topic are behind those of the other, or ''."""
    if not found.odometry or not found.image_ns:
        return ''
    (least_s, first), (most_s, last) = sorted([
        (float(np.median(found.image_delays_ns)) * 1e-9, selection.image_topic or ''),
        (float(np.median(found.odometry_delays_ns)) * 1e-9, selection.odom_topic or ''),
    ])
    lateness_s = most_s - least_s
    if lateness_s <= max_lateness_s:
        return ''
    return (
        f'the stamps of {last} are {lateness_s:.1f} s behind those of {first} that were recorded '
        'at the same time, so that the messages are late: expected the stamps of one clock, at '
        f'most max_lateness_s ({max_lateness_s:g} s) apart; if they are right, raise '
        'inputs.max_lateness_s, otherwise correct the clock or the driver, and record again'
    )


def _gaps(
    stamps_ns: Sequence[int], what: str, least_s: float, covered_ns: Sequence[int] = ()
) -> str:
    """Describe the longest interval between successive accepted stamps, in the covered time."""
    stamps_ns, covered_ns = _accepted(stamps_ns), _accepted(covered_ns)
    if len(stamps_ns) < 2:
        return f'{len(stamps_ns)} {what}s'
    if covered_ns:
        first_ns, last_ns = min(stamps_ns[0], covered_ns[0]), max(stamps_ns[-1], covered_ns[-1])
        stamps_ns = [first_ns, *stamps_ns, last_ns]
    steps_s = np.diff(np.array(stamps_ns, np.int64)).astype(np.float64) * 1e-9
    longest = int(steps_s.argmax())
    if steps_s[longest] <= least_s:
        return 'no gaps'
    since_s = (stamps_ns[longest] - stamps_ns[0]) * 1e-9
    count = int(np.sum(steps_s > least_s))
    return (
        f'{count} gap{"s" if count > 1 else ""} of more than {least_s:g} s, the longest '
        f'{steps_s[longest]:.1f} s at {since_s:.0f} s'
    )


def _accepted(stamps_ns: Sequence[int]) -> list[int]:
    """Return the stamps that a replay accepts: it refuses a single wrong one."""
    order = StampOrder[None](('one',), 0)
    released = [one for stamp_ns in stamps_ns for one in order.push('one', stamp_ns, None)]
    return [one.stamp_ns for one in (*released, *order.flush())]


def _rate(stamps_ns: list[int], found: _Found) -> str:
    """Return the mean rate, which is that of ``ratslam info``."""
    return f'{mean_rate_hz(len(stamps_ns), found.duration_s) or 0.0:.1f} Hz'


# Images


def _images(
    found: _Found, p: LocalViewParameters, is_structure_fixed: bool
) -> tuple[dict[str, Value], str]:
    """Return the crop, the structure of faint images, and a description of the images.

    The crop holds at least a template.
    """
    if not found.images:
        none = f'none can be decoded: {found.problem}'
        return {}, none if found.image_ns else 'recorded templates are used'
    height, width = found.shape
    crop_window(np.zeros(found.shape, np.uint8), p)  # Raises if a given crop does not fit.
    small = static_borders(found.images)
    structures = [structure(image, Window(*small)) for image in found.images]
    least = p.vt_min_structure
    most = float(np.quantile(structures, 0.9))
    if most > NOISE_STRUCTURE and not is_structure_fixed:
        least = min(least, round(FAINT_SHARE * most, 4))
    flat = np.mean(np.array(structures) < least)
    left, right, top, bottom = (border * found.factor for border in small)
    # Rows and columns beyond the last whole pixel of the shrunk images belong to the scene.
    right = right if right // found.factor < found.images[0].shape[1] else width
    bottom = bottom if bottom // found.factor < found.images[0].shape[0] else height
    if right - left < p.template_x_size:
        left, right = 0, width
    if bottom - top < p.template_y_size:
        top, bottom = 0, height
    settings: dict[str, Value] = {}
    if left or right < width:
        for prefix in ('local_view.image_crop', 'visual_odometry.vtrans_image',
                       'visual_odometry.vrot_image'):
            settings[f'{prefix}_x_min'] = left
            settings[f'{prefix}_x_max'] = right if right < width else WHOLE
    if top or bottom < height:
        settings['local_view.image_crop_y_min'] = top
        settings['local_view.image_crop_y_max'] = bottom if bottom < height else WHOLE
    crop = f'crop x {left} to {right}, y {top} to {bottom}: the rest never changes'
    line = (
        f'{width}x{height} at {_rate(found.image_ns, found)}, '
        f'{f"{flat:.0%} of the views have too little structure" if flat else "all are usable"}; '
        f'{crop if settings else "no static borders, no crop"}'
    )
    if least < p.vt_min_structure:
        settings[STRUCTURE] = least
        line += f'; faint: vt_min_structure {least:g}'
    if flat and '16' in found.encoding:
        line += '; 16-bit pixels must use the upper bits (docs/recordings.md)'
    return settings, line


def static_borders(images: Sequence[Image]) -> tuple[int, int, int, int]:
    """Return the window (left, right, top, bottom) without the borders that never change.

    Such borders are black masks, the robot itself, or captions.

    Args:
        images: n images of (H, W) uint8, from all over the recording.
    """
    height, width = images[0].shape
    if len(images) < MIN_IMAGE_COUNT:
        return 0, width, 0, height
    total, squares = np.zeros((2, height, width))
    for image in images:
        total += image
        squares += np.square(image, dtype=np.float64)
    deviation = np.sqrt(np.maximum(squares / len(images) - (total / len(images)) ** 2, 0.0))
    return (
        *_changing(np.median(deviation, axis=0)),
        *_changing(np.median(deviation, axis=1)),
    )


def _changing(deviation: NDArray[np.float64]) -> tuple[int, int]:
    """Return first and last + 1 index of a profile without its static ends."""
    count = len(deviation)
    changing = np.flatnonzero(deviation > STATIC_RATIO * np.median(deviation))
    if not len(changing):
        return 0, count
    first, last = int(changing[0]), int(changing[-1]) + 1
    ends = (MIN_BORDER_RATIO * count, MAX_BORDER_RATIO * count)
    return (
        first if ends[0] <= first <= ends[1] else 0,
        last if ends[0] <= count - last <= ends[1] else count,
    )
