# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Problems of a finished run that its results reveal, each with the next command to try.

`Observations` collects what is needed during the run, in memory proportional to the number of
templates. `advise` compares it with thresholds. They were set between the values of good maps and
of failed ones; docs/results.md lists them.
"""

from __future__ import annotations

import math
import shlex
from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.vision.local_view import NO_TEMPLATE
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.messages.json_schema import NS_PER_S
from ratslam_ros.pipeline.items import OdometryStep, Step, ViewStep

LONG_DRIVE_S = 120.0
"""Time in motion from which a map without loop closures is reported: indoors and on tracks, robots
return to a known place within two minutes."""

CLOSURE_SHARE = 0.02
"""Loop closures per experience below which the map counts as not closed. A robot that drives a
tenth of its way twice closes a loop at about every tenth experience."""

AWAY_COUNT = 10
"""Number of changes of the template after which the robot has left a place."""

MIN_LOOP_COUNT = 20
MAX_TURN_ERROR_DEG = 30.0
"""Largest median deviation of a turn of 360 degrees around loops: three cells of heading. A gyro
and uncalibrated wheels drift by less than 25 degrees within a lap."""

OTHER_PLACE_DEG, CONFUSED_SHARE = 60.0, 0.15
"""Deviation of a turn from which a return must be to another place, and the share of such returns
that is reported. Drift alone exceeds it in less than a twentieth of the returns."""

MIN_TEMPLATE_COUNT = 50
"""Number of templates, or of frames in motion, below which nothing can be said about them."""

NEW_SHARE = 0.9
"""Share of frames in motion with a new template above which the threshold is below almost all
match errors."""

SINGLE_SHARE = 0.5
"""Share of frames in motion with the same template above which the threshold is above almost all
match errors."""

ONCE_SHARE = 0.5
"""Share of templates that were seen in one frame only above which a long drive has recognised few
places."""

FLAT_SHARE = 0.1
"""Share of views with too little structure for a template that is reported."""

GAP_S = 2.0
"""Interval between odometry messages, or the images of a camera without odometry, that is reported
unless `max_odom_gap_s` is shorter; drivers of 1 Hz or more stay below."""


@dataclass(slots=True)
class _Visit:
    """Last visit of a template: heading and number of gaps at its begin, changes at its end."""

    count: int = 0
    change: int = 0
    gaps: int = 0
    heading_rad: float = 0.0


class Observations:
    """What a run reveals about its inputs and thresholds; `add` is called for every step."""

    def __init__(self) -> None:
        self.driven_s = 0.0
        """Time in motion, without gaps."""
        self.driven_frames = 0
        """Number of views since whose predecessor the robot has moved."""
        self.driven_new = 0
        """How many of them became a new template."""
        self.gap_s = 0.0
        """Longest interval between odometry messages."""
        self.gap_at_s = 0.0
        """Time of the gap since the first message."""
        self.loop_turns_rad = array('d')
        """Heading change by dead reckoning between two visits of the same template.

        Visits before and after a gap of the odometry do not count.
        """
        self._visits: dict[int, _Visit] = {}
        self._driven_of: dict[int, int] = {}
        self._start_ns: int | None = None
        self._last_ns = 0
        self._pose = Pose(0.0, 0.0, 0.0)
        self._heading_rad = 0.0
        self._moved = False
        self._template = NO_TEMPLATE
        self._changes = 0
        self._gaps = 0
        """Number of gaps of the odometry, those at its begin and end included."""

    @property
    def duration_s(self) -> float:
        """Time from the first to the last odometry message."""
        return 0.0 if self._start_ns is None else (self._last_ns - self._start_ns) / NS_PER_S

    @property
    def once_share(self) -> float:
        """Share of the templates that were seen in one frame only."""
        once = sum(visit.count == 1 for visit in self._visits.values())
        return once / max(len(self._visits), 1)

    @property
    def single_share(self) -> float:
        """Largest share of the frames in motion with the same template."""
        return max(self._driven_of.values(), default=0) / max(self.driven_frames, 1)

    def add(self, step: Step) -> None:
        """Observe the result of one message."""
        if isinstance(step, OdometryStep):
            self._add_odometry(step)
        elif step.match.template_id != NO_TEMPLATE:
            self._add_view(step)

    def _add_odometry(self, step: OdometryStep) -> None:
        pose = step.dead_reckoning
        if self._start_ns is None:
            self._start_ns = step.stamp_ns
        else:
            interval_s = (step.stamp_ns - self._last_ns) / NS_PER_S
            if interval_s > self.gap_s:
                self.gap_s = interval_s
                self.gap_at_s = (self._last_ns - self._start_ns) / NS_PER_S
            self._gaps += interval_s > GAP_S
            if pose != self._pose:
                self._moved = True
                self.driven_s += interval_s if interval_s < GAP_S else 0.0
                self._heading_rad += wrap(pose.heading_rad - self._pose.heading_rad)
        self._last_ns, self._pose = step.stamp_ns, pose

    def _add_view(self, step: ViewStep) -> None:
        template = step.match.template_id
        self._gaps += self._start_ns is None or step.stamp_ns - self._last_ns > GAP_S * NS_PER_S
        self._changes += template != self._template
        visit = self._visits.setdefault(template, _Visit())
        heading_rad = self._heading_rad - step.match.relative_rad
        returned = visit.count > 0 and self._changes - visit.change > AWAY_COUNT
        if returned and visit.gaps == self._gaps:
            self.loop_turns_rad.append(heading_rad - visit.heading_rad)
        if returned or not visit.count:
            visit.heading_rad, visit.gaps = heading_rad, self._gaps
        visit.count += 1
        visit.change = self._changes
        self._template = template
        if self._moved:
            self.driven_frames += 1
            self.driven_new += step.match.is_new
            self._driven_of[template] = self._driven_of.get(template, 0) + 1
        self._moved = False


@dataclass(frozen=True)
class Source:
    """Recording of a run, and its configuration.

    visual_odometry: whether the odometry was estimated from the images. topics: options that
    select what is read. given: further options of the replay.
    """

    path: Path
    config: Config
    visual_odometry: bool
    topics: tuple[str, ...] = ()
    given: tuple[str, ...] = ()

    def replay(self, *words: str) -> str:
        """Return the command line of the replay with further options."""
        return shlex.join(
            ['ratslam', 'replay', str(self.path), *self.topics, *self.given, *words]
        )

    def tune(self) -> str:
        """Return the command line that proposes parameters."""
        return shlex.join(['ratslam', 'tune', str(self.path), *self.topics])


def advise(seen: Observations, summary: Mapping[str, Any], source: Source) -> list[str]:
    """Return a line for each problem: what was found, and the next command.

    Args:
        seen: observations of the whole run.
        summary: content of summary.json.
        source: the recording and the configuration of the run.
    """
    problems = (
        _gaps(seen, summary, source), _rotation(seen, summary, source), _views(seen, source),
        _closures(seen, summary, source), _texture(summary, source),
    )
    return [line for line in problems if line]


def _gaps(seen: Observations, summary: Mapping[str, Any], source: Source) -> str:
    parts = summary.get('components')
    limit_s = min(source.config.inputs.max_odom_gap_s, GAP_S)
    if seen.gap_s <= limit_s or parts == 1:
        return ''  # No gap, or a place seen before and after it joined the map.
    effect = f', the map has {parts} parts' if parts else ', the map is wrong if the robot moved'
    after_s = seen.gap_at_s + seen.gap_s
    if seen.gap_at_s < seen.duration_s - after_s:
        remedy = f'to map only what follows: {source.replay("--start", f"{math.ceil(after_s)}")}'
    else:
        duration_s = max(math.floor(seen.gap_at_s), 1)
        remedy = f'to map only what precedes: {source.replay("--duration", f"{duration_s}")}'
    return f'odometry gap of {seen.gap_s:.1f} s at {seen.gap_at_s:.0f} s{effect}; {remedy}'


def _rotation(seen: Observations, summary: Mapping[str, Any], source: Source) -> str:
    turns_deg = np.abs(np.degrees(np.array(seen.loop_turns_rad)))
    full = np.round(turns_deg / 360.0)
    errors_deg = np.abs(turns_deg - 360.0 * full) / np.maximum(full, 1.0)  # of each full turn
    count = len(errors_deg)
    loops = summary.get('odom_calibration', {}).get('calibration_loops', 0)
    if count < MIN_LOOP_COUNT or (source.visual_odometry and loops > 0):
        return ''  # Closed loops have shown the field of view, before which turns were wrong.
    if np.median(errors_deg) <= MAX_TURN_ERROR_DEG:
        confused = float(np.mean(errors_deg > OTHER_PLACE_DEG))
        if confused <= CONFUSED_SHARE:
            return ''
        return (
            f'{confused:.0%} of the returns to a known place contradict the turns since the last '
            f'visit: different places are confused: {source.tune()}'
        )
    turn_deg = float(np.median(turns_deg))
    gain = 360.0 * max(1, round(turn_deg / 360.0)) / turn_deg
    found = (
        f'the robot turns by {turn_deg:.0f} deg around a loop (median of {count} visits), '
        'expected a multiple of 360'
    )
    if source.visual_odometry:
        name = 'visual_odometry.camera_fov_deg'
        value = source.config.visual_odometry.camera_fov_deg
    else:
        name, value = 'inputs.odom_rotation_gain', source.config.inputs.odom_rotation_gain
    text = f'{value * gain:.3g}'
    try:
        source.config.with_values({name: float(text)})
    except UnusableParameter:  # no camera or wheel turns by so much
        return f'{found}: different places are confused: {source.tune()}'
    return f'{found}: {source.replay("--set", f"{name}={text}")}'


def _views(seen: Observations, source: Source) -> str:
    """Return a line on the threshold and the templates, which have the same remedy."""
    if seen.driven_frames < MIN_TEMPLATE_COUNT:
        return ''
    tune = source.tune()
    if seen.single_share > SINGLE_SHARE:
        return (
            f'{seen.single_share:.0%} of the views in motion match the same template: '
            f'local_view.vt_match_threshold is above almost all match errors: {tune}'
        )
    if seen.driven_new > NEW_SHARE * seen.driven_frames:
        return (
            f'{seen.driven_new / seen.driven_frames:.0%} of the views in motion match no '
            f'template: local_view.vt_match_threshold is below almost all match errors: {tune}'
        )
    if seen.driven_s >= LONG_DRIVE_S and seen.once_share > ONCE_SHARE:
        return (
            f'{seen.once_share:.0%} of the templates were seen in one frame only; if the robot '
            f'returned to a place: {tune}'
        )
    return ''


def _closures(seen: Observations, summary: Mapping[str, Any], source: Source) -> str:
    closures = summary['loop_closures']
    if seen.driven_s < LONG_DRIVE_S or closures > CLOSURE_SHARE * summary['experiences']:
        return ''
    return (
        f'{closures or "no"} loop closures in {seen.driven_s:.0f} s of driving; if the robot '
        f'returned to a place: {source.tune()}'
    )


def _texture(summary: Mapping[str, Any], source: Source) -> str:
    share = summary.get('low_texture', 0) / max(summary['frames'], 1)
    if share <= FLAT_SHARE:
        return ''
    return (
        f'{share:.0%} of the views have too little structure to be recognised; look for a cover, '
        f'darkness, or blank walls in a video: {source.replay("--video", "video.mp4")}'
    )
