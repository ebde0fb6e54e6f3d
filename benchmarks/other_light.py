# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recognition of places after a change of light, with and without sequences of views.

    python benchmarks/other_light.py [--data ../shared/data] [--only RECORDING ...] [--maps]

The local view, with nothing configured and without odometry, learns the templates of a recording
of laps up to the end of lap 1. In lap 2 the images are changed as by `changes`, and it localises
in the templates (mapping off) or maps on, in a new session. Columns "single" are without the
sequence matcher. Of the frames of lap 2 with a label, recognised is the share whose template was
learned before, and right the share whose template shows the same place (`lap_measures.py`).

--maps: whole replays with nothing configured, where the light changes in one session, when the
middle lap begins. Candidates of the sequences are the templates of
- "none": earlier sessions, so that there are none. This is what the package does.
- "before": the laps before the change, whose time is given.
- "older": all but the newest `MEMORY_VIEWS`, as soon as so many views were recognised.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from lap_measures import LAPS, ROOT, Laps, Setup, image_stamps, measure
from numpy.typing import NDArray
from recording_variants import ORIGINAL, VARIANTS, ChangedRecording, Variant

from ratslam_ros.core.config import Config, LocalViewParameters
from ratslam_ros.core.vision.local_view import EncodedView, LocalView, ViewMatch
from ratslam_ros.core.vision.sequence_matcher import MEMORY_VIEWS, SequenceMatcher
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.recordings import ImageEvent
from ratslam_tuning.lap_phases import LapPhases, read_lap_phases

Image = NDArray[np.uint8]

RECORDINGS = 'rc_car_loops', 'home_robot', 'outdoor_car', 'hall_car', 'lab_car'

MAP_LIGHTS = ORIGINAL, 'night', 'glare', 'lamp'

NONE, BEFORE, OLDER = CANDIDATES = 'none', 'before', 'older'


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
) -> tuple[float, float]:
    """Return the shares of the frames of lap 2 that are recognised, and recognised correctly."""
    local_view, change = LocalView(LocalViewParameters()), changes()[light]
    if not sequences:
        local_view._recognition._sequence = SingleViews(local_view._layout)
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


def with_candidates(candidates: str, from_ns: int) -> Callable[..., ViewMatch]:
    """Return `LocalView.match` with candidates as in the module docstring."""
    own, known, has_changed = LocalView.match, 0, False

    def match(
        self: LocalView, image: Image, stamp_ns: int = 0, encoded: EncodedView | None = None
    ) -> ViewMatch:
        nonlocal known, has_changed
        sequence, next_id = self._recognition._sequence, self._memory.next_id
        if candidates == BEFORE and not has_changed and stamp_ns >= from_ns:
            has_changed = True
            sequence.clear(next_id)
        elif candidates == OLDER and known >= MEMORY_VIEWS:
            sequence.first_id = max(next_id - MEMORY_VIEWS, 0)
        found = own(self, image, stamp_ns, encoded)
        known += not found.is_new and 0 <= found.template_id < next_id - MEMORY_VIEWS
        return found

    return match


def map_row(data: Path, laps: Laps, light: str, candidates: str) -> str:
    """Replay a recording whose light changes in the middle lap; return its results as text."""
    phases = read_lap_phases(laps.path(data) / 'lap_phase.csv')
    with laps.open(data) as recording, tempfile.TemporaryDirectory() as out:
        stamp_ns = image_stamps(recording, recording.select())
        from_ns = int(stamp_ns[np.argmax(phases.lap > phases.lap.max() // 2)])
        own, LocalView.match = LocalView.match, with_candidates(candidates, from_ns)
        try:
            changed = ChangedRecording(recording, Variant(changes()[light], from_ns=from_ns))
            Setup(Config()).replay(changed, Path(out))
        finally:
            LocalView.match = own
        found = measure(Path(out), phases, stamp_ns, laps.tolerance)
    precision, recall, spread, turns, _ = found
    verdict = 'right' if found.is_right(laps.turns) else 'WRONG'
    return f'{precision:.3f} / {recall:.3f}, {spread:.3f}, {turns:.2f} turns, {verdict}'


def report_maps(data: Path, names: list[str]) -> None:
    """Print the results of all replays of recordings whose light changes."""
    warm_up()
    for name in names:
        if LAPS[name].path(data).is_dir():
            for light in MAP_LIGHTS:
                for candidates in CANDIDATES:
                    text = map_row(data, LAPS[name], light, candidates)
                    print(f'{name:17}{light:9} {candidates:8} {text}', flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    parser.add_argument('--only', action='append', choices=LAPS, metavar='RECORDING',
                        help=f'may be repeated (default: {", ".join(RECORDINGS)})')
    parser.add_argument('--maps', action='store_true',
                        help='replay recordings whose light changes in one session')
    options = parser.parse_args()
    if options.maps:
        own = [name for name, laps in LAPS.items() if laps.base == ORIGINAL]
        report_maps(options.data, options.only or own)
        return
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
