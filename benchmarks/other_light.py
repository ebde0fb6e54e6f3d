# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recognition of places after a change of light, with and without sequences of views.

    python benchmarks/other_light.py [--data ../shared/data] [--only RECORDING ...]

The local view, with nothing configured and without odometry, learns the templates of a recording
of laps. It then sees the whole recording again with the images changed: the variants of
`recording_variants.py` that change the light, and both halves of the drive in different light.
It localises in the saved templates (mapping off), or continues to map.

- recognised: share of the frames whose template was learned in the first drive.
- right: share of the frames whose template shows the same place, within the tolerance of
  `lap_measures.py`.

Frames without a label count for neither. The sequence matcher is switched off in the columns
"single".
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from lap_measures import LAPS, ROOT, Laps
from numpy.typing import NDArray
from recording_variants import VARIANTS

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.core.vision.sequence_matcher import SequenceMatcher
from ratslam_ros.offline.lap_phases import LapPhases, read_lap_phases
from ratslam_ros.recordings import ImageEvent

Image = NDArray[np.uint8]

RECORDINGS = 'rc_car_loops', 'home_robot', 'outdoor_car', 'hall_car', 'lab_car'
LIGHT = 'original', 'gamma 0.5', 'gamma 2', 'contrast 0.5'


class SingleViews(SequenceMatcher):
    """Sequence matcher that recognises nothing."""

    def match(self, trials: int = 1) -> int | None:
        """Return None."""
        return None


def images(laps: Laps, data: Path) -> list[Image]:
    """Return the images of a recording."""
    with laps.open(data) as recording:
        events = recording.events(recording.select())
        return [event.grey() for event in events if isinstance(event, ImageEvent)]


def changed(pixels: list[Image], light: str) -> Iterator[Image]:
    """Yield the images in other light."""
    for image in pixels:
        yield VARIANTS[light].change(image)


def shares(
    pixels: list[Image], phases: LapPhases, laps: Laps, light: str, mapping: bool, sequences: bool
) -> tuple[float, float]:
    """Return the shares of the frames that are recognised, and recognised correctly."""
    local_view = LocalView(LocalViewParameters())
    if not sequences:
        local_view._sequence = SingleViews(local_view._layout)
    place_of = {}
    for image, place in zip(pixels, phases.place.tolist(), strict=True):
        match = local_view.match(image)
        if match.is_new:
            place_of[match.template_id] = place
    local_view.relocated()
    local_view.mapping = mapping
    found = [
        place_of.get(local_view.match(image).template_id, -1) for image in changed(pixels, light)
    ]
    has_label = phases.place >= 0
    seen, place = np.array(found)[has_label], phases.place[has_label]
    apart = np.abs(seen - place)
    right = (seen >= 0) & (np.minimum(apart, phases.lap_length - apart) <= laps.tolerance)
    return float(np.mean(seen >= 0)), float(np.mean(right))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    parser.add_argument('--only', action='append', choices=LAPS, metavar='RECORDING',
                        help=f'may be repeated (default: {", ".join(RECORDINGS)})')  # fmt: skip
    options = parser.parse_args()
    print(f'{"recognised / right":31} {"single":>15} {"sequences":>15}')
    for name in options.only or RECORDINGS:
        laps = LAPS[name]
        if not laps.path(options.data).is_dir():
            print(f'{name}: skipped, {laps.path(options.data)} not found')
            continue
        phases = read_lap_phases(laps.path(options.data) / 'lap_phase.csv')
        pixels = images(laps, options.data)
        for light in LIGHT:
            for mapping in (False, True):
                rows = [
                    '{:.3f} / {:.3f}'.format(*shares(pixels, phases, laps, light, mapping, used))
                    for used in (False, True)
                ]
                mode = 'mapping' if mapping else 'localising'
                print(f'{name:13} {light:12} {mode:10}', *(f'{row:>15}' for row in rows),
                      flush=True)  # fmt: skip


if __name__ == '__main__':
    main()
