# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files that a run writes, as they come, in constant memory."""

from __future__ import annotations

import json
import os
import struct
import tempfile
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.experience_map import ExperienceMap, PrunedExperience
from ratslam_ros.core.pose_cells.pose_cells import NO_EXPERIENCE
from ratslam_ros.core.ratslam import OdometryStep, Step, ViewStep
from ratslam_ros.core.vision.local_view import NO_TEMPLATE
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import to_yaml
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.results.trajectory import tum_line

FRAMES_HEADER = 'stamp_ns,template_id,is_new,match_error,relative_rad,experience_id\n'

NEWEST_EXPERIENCES = 10
"""A link or set to one of the experiences made this recently is no loop closure."""

_OFFSET = struct.Struct('<qqddd')


class Results:
    """Writes one run's files into a folder; they take their names when the run is finished.

    Until then they are called ``.part``, and whatever an earlier run left stays as it is.
    """

    def __init__(self, folder: Path) -> None:
        """Open the files.

        Raises:
            UnusableInput: the folder cannot be made or written to.
        """
        self.folder = folder
        self.frames = 0
        self.odometry = 0
        self.templates = 0
        self.experiences = 0
        self._newest: deque[int] = deque(maxlen=NEWEST_EXPERIENCES)
        self._at = NO_EXPERIENCE
        self._places = _Places()
        self.loop_closures = 0
        self.without_view = 0
        """Frames of template -1: images that could not be decoded or used."""
        self._action_ns = 0
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._frames = _writer(folder / 'frames.csv.part')
            self._trajectory = _writer(folder / 'trajectory.tum.part')
            self._dead_reckoning = _writer(folder / 'dead_reckoning.tum.part')
        except OSError as error:
            raise UnusableInput(
                f'{folder} cannot be written to ({error.strerror}); give another --out'
            ) from None
        self._frames.write(FRAMES_HEADER)
        # Where each pose lies from its experience: the final trajectory needs the final map.
        self._offsets: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - closed by finish

    def add(self, step: Step) -> None:
        """Write what one message led to."""
        if isinstance(step, OdometryStep):
            self._add_odometry(step)
        else:
            self._add_view(step)

    def _add_odometry(self, step: OdometryStep) -> None:
        self.odometry += 1
        self._trajectory.write(tum_line(step.stamp_ns, step.pose))
        self._dead_reckoning.write(tum_line(step.stamp_ns, step.dead_reckoning))
        place = self._places.of(step.experience_id)
        self._offsets.write(_OFFSET.pack(step.stamp_ns, place, *step.offset))

    def _add_view(self, step: ViewStep) -> None:
        match, action = step.match, step.action
        self.frames += 1
        self.templates += match.is_new
        self.without_view += match.template_id == NO_TEMPLATE
        if match.template_id != NO_TEMPLATE:
            self._action_ns = step.stamp_ns
        if step.pruned is not None:
            self._places.forget(step.pruned)
        if action.action == 'create':
            self.experiences += step.pruned is None
            self._newest.append(action.target_id)
        if action.action != 'none' and not step.rejected:
            is_closure = action.action != 'create' and action.target_id not in self._newest
            self.loop_closures += is_closure
            self._at = action.target_id
        self._frames.write(
            f'{step.stamp_ns},{match.template_id},{int(match.is_new)},{match.error!r},'
            f'{match.relative_rad!r},{self._at}\n'
        )

    def finish(
        self, experience_map: ExperienceMap, config: Config, summary: dict[str, Any]
    ) -> None:
        """Write the map, the final trajectory and the summary, and close all files."""
        self._write_final(experience_map)
        for file in self._files:
            file.close()
            os.replace(file.name, file.name.removesuffix('.part'))
        map_json = encode_map(self._action_ns, experience_map)
        _replace(self.folder / 'map.json', map_json)  # the bytes of experience_map/map
        _replace(self.folder / 'config.yaml', to_yaml(config))
        _replace(self.folder / 'summary.json', json.dumps(summary, indent=2) + '\n')

    def discard(self) -> None:
        """Remove what was written of this run."""
        self._offsets.close()
        for file in self._files:
            file.close()
            Path(file.name).unlink(missing_ok=True)

    @property
    def _files(self) -> tuple[IO[str], ...]:
        return self._frames, self._trajectory, self._dead_reckoning

    def _write_final(self, experience_map: ExperienceMap) -> None:
        self._offsets.seek(0)
        pose_of = self._places.poses(experience_map)
        with _writer(self.folder / 'trajectory_final.tum.part') as file:
            while chunk := self._offsets.read(_OFFSET.size * 4096):
                for stamp_ns, place, x, y, heading in _OFFSET.iter_unpack(chunk):
                    line = tum_line(stamp_ns, composed(pose_of(place), Pose(x, y, heading)))
                    file.write(line)
        self._offsets.close()
        os.replace(file.name, file.name.removesuffix('.part'))


class _Places:
    """Places that stay, for experiences whose numbers come to mean others."""

    def __init__(self) -> None:
        self._of: dict[int, int] = {}
        self._forgotten: list[tuple[int, int, Pose]] = []

    def of(self, experience_id: int) -> int:
        """Return the place that an experience's number means now: itself, or one below -1."""
        return self._of.get(experience_id, experience_id)

    def forget(self, pruned: PrunedExperience) -> None:
        """Let the number mean another place from now on."""
        experience_id, stand_in_id, pose = pruned
        self._forgotten.append((self.of(experience_id), self.of(stand_in_id), pose))
        self._of[experience_id] = -1 - len(self._forgotten)

    def poses(self, experience_map: ExperienceMap) -> Callable[[int], Pose]:
        """Return what tells where on the final map a place is, forgotten or not."""
        now = {place: experience_id for experience_id, place in self._of.items()}
        gone: dict[int, Pose] = {}

        def pose_of(place: int) -> Pose:
            known = gone.get(place)
            return experience_map.pose_of(now.get(place, place)) if known is None else known

        for place, stand_in, pose in reversed(self._forgotten):  # those it hangs on went later
            gone[place] = composed(pose_of(stand_in), pose)
        return pose_of


def link_latest(folder: Path) -> None:
    """Let ``latest``, beside a results folder, point to it; where links exist."""
    link = folder.parent / 'latest'
    if link.exists() and not link.is_symlink():
        return
    fresh = folder.parent / f'.latest-{os.getpid()}'
    try:
        fresh.symlink_to(folder.name)
        fresh.replace(link)
    except OSError:
        fresh.unlink(missing_ok=True)


def _writer(path: Path) -> IO[str]:
    return open(path, 'w', encoding='ascii', newline='\n')


def _replace(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    part = path.with_name(path.name + '.part')
    part.write_text(text, encoding='ascii', newline='\n')
    part.replace(path)
