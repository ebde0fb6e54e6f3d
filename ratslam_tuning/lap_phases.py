# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Precision and recall of place recognition on recordings of laps."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.errors import UnusableInput

Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Matches(NamedTuple):
    """Whether each frame counts and is recognised, and the first frame of its template; (n,) each.

    ``apart`` is the distance between the places of both frames, in frames.
    """

    is_counted: Flags
    is_recognised: Flags
    first: NDArray[np.intp]
    apart: Ints


@dataclass(frozen=True)
class LapPhases:
    """Lap and place on the lap of each frame of a recording, (n,) each.

    Two frames show the same place if their places are equal. Places are cyclic. A place of -1
    means that the frame has no label.
    """

    lap: Ints
    place: Ints
    lap_length: int
    """Number of different places."""

    def only(self, frames: Flags) -> LapPhases:
        """Return the phases without the labels of all but the given frames, an (n,) mask."""
        return replace(self, place=np.where(frames, self.place, -1))

    def recognition(self, template_ids: Sequence[int] | Ints, tolerance: int,
                    from_lap: int = 2, from_frame: int = 0) -> tuple[float, float]:
        """Return precision and recall of recognising places of earlier laps.

        A frame counts as recognised if its template was first seen in an earlier lap and more
        than half a lap of frames before. The recognition is correct if the first frame of the
        template shows the same place. Frames without label are left out, and frames of templates
        that were first seen without label.

        Args:
            template_ids: template ids of all frames in order; -1: none.
            tolerance: largest distance between frames of the same place, in frames.
            from_lap: first lap that is evaluated.
            from_frame: first frame that is evaluated.

        Raises:
            UnusableInput: the number of frames differs.
        """
        found = self.matches(template_ids, from_lap, from_frame)
        correct = found.is_recognised & (found.apart <= tolerance)
        return (float(correct.sum() / max(found.is_recognised.sum(), 1)),
                float(correct.sum() / max(found.is_counted.sum(), 1)))

    def matches(self, template_ids: Sequence[int] | Ints, from_lap: int = 2,
                from_frame: int = 0) -> Matches:
        """Return which frames count and are recognised, as defined in ``recognition``.

        Raises:
            UnusableInput: the number of frames differs.
        """
        ids = np.asarray(template_ids)
        if len(ids) != len(self.lap):
            raise UnusableInput(f'the laps of {len(self.lap)} frames are given, but '
                                f'{len(ids)} frames were processed; expected one row per frame')
        frame = np.arange(len(ids))
        _, first_frames, which = np.unique(ids, return_index=True, return_inverse=True)
        first = first_frames[which]
        has_label = self.place >= 0
        counted = ((self.lap >= from_lap) & (frame >= from_frame)
                   & has_label & (has_label[first] | (ids < 0)))
        recognised = (counted & (ids >= 0) & (self.lap[first] < self.lap)
                      & (frame - first > self.lap_length / 2))
        return Matches(counted, recognised, first, self.apart(self.place, self.place[first]))

    def apart(self, places: Ints, others: Ints) -> Ints:
        """Return the cyclic distances of places, in frames."""
        ahead: Ints = (places - others) % self.lap_length
        behind: Ints = (others - places) % self.lap_length
        return np.where(ahead < behind, ahead, behind)


def read_lap_phases(path: Path) -> LapPhases:
    """Read a CSV file with the columns lap and ref_frame, one row per frame.

    Raises:
        UnusableInput: the file cannot be read.
    """
    try:
        with path.open(newline='', encoding='utf-8') as file:
            rows = [(int(row['lap']), int(row['ref_frame'])) for row in csv.DictReader(file)]
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise UnusableInput(f'{path} cannot be read ({error!r}); expected a CSV file with the '
                            'columns lap and ref_frame') from None
    table = np.array(rows, np.int64).reshape(-1, 2)
    lap, place = table.T
    return LapPhases(lap, place, len(np.unique(place[place >= 0])))
