# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Result files of a run, written step by step in constant memory."""

from __future__ import annotations

import json
import os
import shutil
import struct
import tempfile
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.config import AUTOMATIC, Config
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.map_update import PrunedExperience
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.vision.local_view import NO_TEMPLATE
from ratslam_ros.errors import DISK_FULL_ERRORS, UnusableInput
from ratslam_ros.files.config import to_yaml
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.pipeline.items import OdometryStep, Step, ViewStep
from ratslam_ros.results.trajectory import tum_line

FRAMES_HEADER = 'stamp_ns,template_id,is_new,match_error,relative_rad,experience_id'

THRESHOLD_COLUMN = 'match_threshold'
"""Last column of frames.csv if the threshold is automatic."""

NEWEST_EXPERIENCES_COUNT = 10
"""An action that leads to one of the newest experiences is not counted as a loop closure."""

_OFFSET = struct.Struct('<qqddd')
"""Stamp in ns, place id, and the pose relative to the place: x, y in m, heading in rad."""


class Results:
    """Writer of the result files of one run.

    The files have the suffix ``.part`` until the run is finished; results of an earlier run in
    the same folder stay until then. If a file cannot be written, all parts are removed.
    """

    def __init__(self, folder: Path, config: Config) -> None:
        """Create the folder and open the files.

        Args:
            folder: the folder; it is created.
            config: the configuration of the run. If the match threshold is automatic, that of
                each frame is written.

        Raises:
            UnusableInput: the folder cannot be created or written to.
        """
        self.folder = folder
        self.is_discarded = False
        self.frames = 0
        self.odometry = 0
        self.templates = 0
        self.experiences = 0
        self.closures = LoopClosures()
        self._current_id = NO_EXPERIENCE
        self._places = Places()
        self.without_view = 0
        """Number of frames with template -1: images that could not be decoded or used."""
        self.last_view_ns = 0
        """Stamp of the last view with a template, which is that of map.json."""
        self._gaps: dict[int, float] = {}
        """Length of each gap in s, by the stamp of the odometry message at its end."""
        self._unplaced: list[OdometryStep] = []
        """Steps since the last gap, until an experience is current that they are relative to."""
        self._opened = ExitStack()
        self._parts: dict[Path, os.stat_result] = {}
        self.share = 0.0
        """Share of the run that is over, 0 to 1, for an estimate of the space that it needs."""
        with self._checked():
            folder.mkdir(parents=True, exist_ok=True)
            self._frames = self._writer('frames.csv')
            self._trajectory = self._writer('trajectory.tum')
            self._dead_reckoning = self._writer('dead_reckoning.tum')
            # Poses relative to their experience: the final trajectory needs the final map.
            offsets = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - in the stack
            self._offsets = self._opened.enter_context(offsets)
        self._config = config
        self._has_thresholds = config.local_view.vt_match_threshold == AUTOMATIC
        more = f',{THRESHOLD_COLUMN}' if self._has_thresholds else ''
        self._frames.write(f'{FRAMES_HEADER}{more}\n')

    def add(self, step: Step) -> None:
        """Write the result of one message.

        Raises:
            UnusableInput: the disk is full; all files of this run are removed.
        """
        try:  # without a context manager, because it is called for every message
            if isinstance(step, OdometryStep):
                self._add_odometry(step)
            else:
                self._add_view(step)
        except OSError as error:
            raise self._failed(error) from None

    def _add_odometry(self, step: OdometryStep) -> None:
        self.odometry += 1
        if step.gap_s > 0.0:
            self._gaps[step.stamp_ns] = step.gap_s
            self._current_id = NO_EXPERIENCE
            for file in (self._trajectory, self._dead_reckoning):
                file.write(_gap_comment(step.gap_s))
            self._write_unplaced()
        self._trajectory.write(tum_line(step.stamp_ns, step.pose))
        self._dead_reckoning.write(tum_line(step.stamp_ns, step.dead_reckoning))
        if self._gaps and step.experience_id == NO_EXPERIENCE:
            self._unplaced.append(step)
        else:
            self._write_offset(step.stamp_ns, step.experience_id, step.offset)

    def _add_view(self, step: ViewStep) -> None:
        match, action = step.match, step.action
        self.frames += 1
        self.templates += match.is_new
        self.without_view += match.template_id == NO_TEMPLATE
        if match.template_id != NO_TEMPLATE:
            self.last_view_ns = step.stamp_ns
        if step.pruned is not None:
            self._places.prune(step.pruned)
        if action.action == 'create':
            self.experiences += step.pruned is None
        if action.action != 'none' and not step.rejected:
            self._place(action)
            self._current_id = action.target_id
        self.closures.add(step)
        self._frames.write(
            f'{step.stamp_ns},{match.template_id},{int(match.is_new)},{match.error!r},'
            f'{match.relative_rad!r},{self._current_id}'
            f'{f",{match.threshold!r}" if self._has_thresholds else ""}\n'
        )

    def _place(self, action: MapAction) -> None:
        """Relate the steps since a gap to the experience that is current after an action."""
        if not self._unplaced:
            return
        # No motion lies between the last step and the action.
        to_target = composed(
            Pose(0.0, 0.0, action.relative_rad), inverse(self._unplaced[-1].pose)
        )
        for step in self._unplaced:
            offset = composed(to_target, step.pose)
            self._write_offset(step.stamp_ns, action.target_id, offset)
        self._unplaced.clear()

    def _write_unplaced(self) -> None:
        """Write the steps that no experience followed before the next gap or the end."""
        for step in self._unplaced:
            self._write_offset(step.stamp_ns, step.experience_id, step.offset)
        self._unplaced.clear()

    def _write_offset(self, stamp_ns: int, experience_id: int, offset: Pose) -> None:
        self._offsets.write(_OFFSET.pack(stamp_ns, self._places.of(experience_id), *offset))

    @property
    def gap_count(self) -> int:
        """Number of odometry gaps after which the motion was unknown."""
        return len(self._gaps)

    def summary(self, experience_map: ExperienceMap) -> dict[str, Any]:
        """Return the counts at the beginning of summary.json."""
        return {
            'frames': self.frames, 'odometry': self.odometry, 'templates': self.templates,
            'experiences': len(experience_map), 'links': experience_map.link_count,
            'loop_closures': self.closures.count,
        }

    def finish(self, experience_map: ExperienceMap, summary: dict[str, Any]) -> None:
        """Write the final trajectory, map, configuration and summary, and close all files.

        Args:
            experience_map: the final map.
            summary: content of summary.json.

        Raises:
            UnusableInput: the disk is full; all files of this run are removed.
        """
        with self._checked():
            self._write_unplaced()
            self._write_final(experience_map)
            # The same bytes as the topic experience_map/map.
            self.write('map.json', encode_map(self.last_view_ns, experience_map))
            self.write('config.yaml', to_yaml(self._config))
            self.write('summary.json', json.dumps(summary, indent=2) + '\n')
            self._opened.close()
            for part in self._parts:
                part.replace(part.with_suffix(''))

    def check_folder(self) -> None:
        """Check that the files were not removed, and that no other run has replaced them.

        Raises:
            UnusableInput: one of both; the files of this run that are left are removed.
        """
        if self._is_own(Path(self._frames.name)):
            return
        self.discard()
        reason = 'has been written by another run' if self.folder.exists() else 'was removed'
        raise UnusableInput(
            f'{self.folder} {reason} since this run began, and its results are lost; replay '
            'again, with another --out'
        )

    def write(self, name: str, text: str) -> None:
        """Write a further file of this run."""
        with self._checked():
            self._writer(name).write(text)

    def discard(self) -> None:
        """Remove the files of this run."""
        self.is_discarded = True
        with suppress(OSError):  # What is still buffered may not fit on the disk.
            self._opened.close()
        for part in self._parts:
            if self._is_own(part):
                part.unlink()

    def _is_own(self, part: Path) -> bool:
        """Return whether a file is there and no other run has replaced it."""
        try:
            return os.path.samestat(self._parts[part], part.stat())
        except OSError:
            return False

    def _writer(self, name: str) -> IO[str]:
        path = self.folder / f'{name}.part'
        path.unlink(missing_ok=True)  # Another run may still be writing to it.
        file = self._opened.enter_context(path.open('x', encoding='utf-8', newline='\n'))
        self._parts[path] = os.fstat(file.fileno())
        return file

    @contextmanager
    def _checked(self) -> Iterator[None]:
        """Report a failed write, and remove all files of this run."""
        try:
            yield
        except OSError as error:
            raise self._failed(error) from None

    def _failed(self, error: OSError) -> UnusableInput:
        """Remove all files of this run after a failed write; return what to report."""
        # With the history, which is removed, too.
        written_bytes = sum(path.stat().st_size for path in self.folder.glob('*.part*'))
        self.discard()
        needed_bytes = written_bytes / (self.share or 1.0)
        return unwritable(self.folder, error, needed_bytes, written_bytes)

    def _write_final(self, experience_map: ExperienceMap) -> None:
        self._offsets.seek(0)
        pose_of = self._places.poses(experience_map.pose_of)
        file = self._writer('trajectory_final.tum')
        while chunk := self._offsets.read(_OFFSET.size * 4096):
            for stamp_ns, place, x, y, heading in _OFFSET.iter_unpack(chunk):
                if stamp_ns in self._gaps:
                    file.write(_gap_comment(self._gaps[stamp_ns]))
                file.write(tum_line(stamp_ns, composed(pose_of(place), Pose(x, y, heading))))


class LoopClosures:
    """Number of transitions to, and recognitions of, experiences that are not among the newest."""

    def __init__(self) -> None:
        self.count = 0
        self._newest: deque[int] = deque(maxlen=NEWEST_EXPERIENCES_COUNT)
        self._recognised_id = NO_EXPERIENCE

    def add(self, step: ViewStep) -> None:
        """Count what a view has caused."""
        action = step.action
        if action.action == 'create':
            self._newest.append(action.target_id)
        elif action.action != 'none' and not step.rejected:
            self.count += action.target_id not in self._newest
        if action.recognised_id != self._recognised_id:
            self._recognised_id = action.recognised_id
            self.count += action.recognised_id not in (NO_EXPERIENCE, *self._newest)


class Places:
    """Permanent ids of experiences, whose own ids are reused after pruning.

    The place id of an experience is its own id; when the id is reused, the new experience gets
    a place id below -1.
    """

    def __init__(self) -> None:
        self._place_ids: dict[int, int] = {}
        self._pruned: list[tuple[int, int, Pose]] = []
        """Place id, place id of the stand-in, and pose relative to the stand-in."""

    def of(self, experience_id: int) -> int:
        """Return the place id of an experience."""
        return self._place_ids.get(experience_id, experience_id)

    def prune(self, pruned: PrunedExperience) -> None:
        """Assign a new place id to the id of a pruned experience."""
        experience_id, stand_in_id, pose = pruned
        self._pruned.append((self.of(experience_id), self.of(stand_in_id), pose))
        self._place_ids[experience_id] = -1 - len(self._pruned)

    def poses(self, final: Callable[[int], Pose]) -> Callable[[int], Pose]:
        """Return a function from a place id to its pose on the final map.

        The pose of a pruned experience is that of its stand-in composed with their relative pose.

        Args:
            final: function from the id of an experience of the final map to its pose.
        """
        experience_ids = {place: experience_id for experience_id, place in self._place_ids.items()}
        pruned_poses: dict[int, Pose] = {}

        def pose_of(place: int) -> Pose:
            if place in pruned_poses:
                return pruned_poses[place]
            return final(experience_ids.get(place, place))

        # In reverse, because a stand-in may have been pruned later.
        for place, stand_in, pose in reversed(self._pruned):
            pruned_poses[place] = composed(pose_of(stand_in), pose)
        return pose_of


def link_latest(folder: Path) -> None:
    """Point the link ``latest``, beside a results folder, to it, if the file system has links."""
    link = folder.parent / 'latest'
    if link.exists() and not link.is_symlink():
        return
    fresh = folder.parent / f'.latest-{os.getpid()}'
    try:
        fresh.symlink_to(folder.name)
        fresh.replace(link)
    except OSError:
        fresh.unlink(missing_ok=True)


def _gap_comment(gap_s: float) -> str:
    """Return the comment line that precedes the first pose after an odometry gap."""
    return f'# odometry gap of {gap_s:.3f} s: unknown motion\n'


def unwritable(
    folder: Path, error: OSError, needed_bytes: float, written_bytes: float = 0.0
) -> UnusableInput:
    """Return an error that names the folder, and the needed and free space if the disk is full.

    Args:
        folder: the folder for the results.
        error: why a file in it cannot be written.
        needed_bytes: estimate of the space that the results need.
        written_bytes: space that was taken by files that are removed.
    """
    if error.errno not in DISK_FULL_ERRORS:
        return UnusableInput(
            f'{folder} cannot be written to ({error.strerror}); give another --out'
        )
    free_bytes = max(shutil.disk_usage(folder).free, written_bytes)
    return UnusableInput(
        f'{folder}: {error.strerror}: the results need about {needed_bytes / 1e6:.1f} MB, and '
        f'{free_bytes / 1e6:.1f} MB are free; free some space, or give another --out'
    )
