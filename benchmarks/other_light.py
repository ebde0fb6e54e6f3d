# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recognition of places after a change of light, with and without sequences of views.

    python benchmarks/other_light.py [--data ../shared/data] [--only RECORDING ...]

The local view, with nothing configured and without odometry, learns the templates of a recording
of laps up to the end of lap 1. In lap 2 the images are changed as by `changes`, and it localises
in the templates (mapping off) or maps on, in a new session. Columns "single" are without the
sequence matcher. Of the frames of lap 2 with a label, recognised is the share whose template was
learned before, and right the share whose template shows the same place (`lap_measures.py`).
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from lap_measures import LAPS, ROOT
from numpy.typing import NDArray
from recording_variants import ORIGINAL, VARIANTS

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.core.vision.sequence_matcher import SequenceMatcher
from ratslam_ros.recordings import ImageEvent
from ratslam_tuning.lap_phases import LapPhases, read_lap_phases

Image = NDArray[np.uint8]

RECORDINGS = 'rc_car_loops', 'home_robot', 'outdoor_car', 'hall_car', 'lab_car'


def changes() -> dict[str, Callable[[Image], Image]]:
    """Return the changes of the light by name."""
    rng = np.random.default_rng(1)

    def noisy(grey: NDArray[np.float64], noise: float) -> Image:
        return (grey + rng.normal(0.0, noise, grey.shape)).clip(0, 255).astype(np.uint8)

    def lamp(image: Image) -> Image:
        height, width = image.shape
        y, x = np.mgrid[:height, :width]
        radius = np.hypot((x / width - 0.5) / 0.35, (y / height - 0.6) / 0.35)
        return noisy(330.0 * (image / 255.0) ** 1.5 * np.exp(-(radius**2)), 6.0)

    return {
        **{name: VARIANTS[name].change
           for name in (ORIGINAL, 'gamma 0.5', 'gamma 2', 'contrast 0.5')},
        'night': lambda image: noisy(127.5 * (image / 255.0) ** 3, 10.0),
        'lamp': lamp,
        'glare': lambda image: noisy(3.0 * image - 60.0, 0.0),
        'folded': lambda image: noisy(np.abs(2.0 * image - 255.0), 0.0),
    }


class SingleViews(SequenceMatcher):
    """Sequence matcher that recognises nothing."""

    def match(self, trials: int = 1) -> int | None:
        """Return None."""
        return None


def shares(
    pixels: list[Image], phases: LapPhases, tolerance: int, light: str, mapping: bool,
    sequences: bool,
) -> tuple[float, float]:  # fmt: skip
    """Return the shares of the frames of lap 2 that are recognised, and recognised correctly."""
    local_view, change = LocalView(LocalViewParameters()), changes()[light]
    if not sequences:
        local_view._sequence = SingleViews(local_view._layout)
    place_of, recognised, right = {}, [], []
    for image, lap, place in zip(pixels, phases.lap, phases.place.tolist(), strict=True):
        if lap > 2:
            break
        if lap == 2 and not recognised:
            local_view.relocated()  # another session
        local_view.mapping = mapping or lap < 2
        match = local_view.match(change(image) if lap == 2 else image)
        if lap < 2 and match.is_new:
            place_of[match.template_id] = place
        elif lap == 2 and place >= 0:
            seen = place_of.get(match.template_id, math.nan)
            apart = abs(seen - place)
            recognised.append(match.template_id in place_of)
            right.append(seen >= 0 and min(apart, phases.lap_length - apart) <= tolerance)
    return float(np.mean(recognised)), float(np.mean(right))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    parser.add_argument('--only', action='append', choices=LAPS, metavar='RECORDING',
                        help=f'may be repeated (default: {", ".join(RECORDINGS)})')  # fmt: skip
    options = parser.parse_args()
    print(f'{"recognised / right":25}    localising: single     sequence     mapping: single     '
          'sequence')
    for name in options.only or RECORDINGS:
        laps = LAPS[name]
        if not laps.path(options.data).is_dir():
            print(f'{name}: skipped, {laps.path(options.data)} not found')
            continue
        phases = read_lap_phases(laps.path(options.data) / 'lap_phase.csv')
        with laps.open(options.data) as recording:
            events = recording.events(recording.select())
            pixels = [event.grey() for event in events if isinstance(event, ImageEvent)]
        for light in changes():
            cells = (
                '{:.2f} / {:.2f}'.format(
                    *shares(pixels, phases, laps.tolerance, light, mapping, sequences)
                )
                for mapping in (False, True) for sequences in (False, True)
            )
            print(f'{name:13}{light:12}', *(f'{cell:>15}' for cell in cells), flush=True)


if __name__ == '__main__':
    main()
