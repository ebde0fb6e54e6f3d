# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Precision and recall of the local view on real recordings.

    python benchmarks/place_recognition.py [--data ../shared/data]

The presets of the folder `config` are used. Missing recordings are reported and skipped.

Laps (rc_car_loops, donkeycar_track). `LocalView` processes all images in order, except those whose
stamp does not increase. `lap_phase.csv` contains the lap of each frame and its place on the lap,
`ref_frame`, which is cyclic. A frame of lap 2 or later counts as recognised if its template was
first seen in an earlier lap and more than half a lap of frames before. The recognition is correct
if the first frame of the template shows the same place, within the tolerance of the recording.
Precision = correct / recognised; recall = correct / frames of the evaluated laps.
Laps are numbered as in `lap_phase.csv`. Lap 1 defines the places; lap 0 is the stretch before it.
rc_car_loops has laps 0 to 10 (lap 0: 20 frames), donkeycar_track laps 0 to 2 (lap 0: 40 frames;
lap 2: 438 of 521).
Held-out data: rc_car was tuned on lap 2, laps 3 to 10 are held out. donkeycar was tuned on the
first half of lap 2 (up to frame 780), the rest of the lap is held out.

Corridors. The references are learned in order. Then the best match of each query among them is
computed without a threshold and without learning.
- corridor_vpr: 111 queries, 111 references; correct if the reference is in the list of the query
  in `ground_truth.csv`.
- corridor_circuit: images 1 to 40 (by number) are learned, images 41 to 84 are the queries. Image
  i shows the place of image i + 40, cyclic; correct within +-1. Image 46 shows a blank wall.
The preset corridor was tuned on both recordings, so its figures are not held out. The held-out
figures are those of settings tuned on the other recording alone: the centre of the 3 x 3 x 3 x 3
neighbourhood with the best mean, in a grid over width (20 to 40), height (20 to 48), both shifts
and four normalisations.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.intensity import make_view
from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.files.config import load_config
from ratslam_ros.recordings import ImageEvent, open_recording

Image = NDArray[np.uint8]

ROOT = Path(__file__).resolve().parents[1]

TUNED_ON_CIRCUIT = LocalViewParameters(
    template_x_size=20, template_y_size=20, vt_shift_match=6, vt_shift_match_y=3
)
TUNED_ON_VPR = LocalViewParameters(
    template_x_size=32, template_y_size=48, vt_shift_match=4, vt_shift_match_y=9,
    vt_patch_normalise=15, vt_min_patch_normalisation_std=0.05,
)  # fmt: skip

CIRCUIT_IMAGES = 40
"""Number of images of one round of the circuit."""


@dataclass(frozen=True)
class Laps:
    """A recording of laps, and the frames that its preset was not tuned on.

    Attributes:
        folder: folder of the recording.
        preset: name of the preset.
        lap_length: frames of a lap.
        tolerance: largest distance between frames of the same place, in frames.
        held_out: description of the held-out frames.
        held_out_lap: first held-out lap.
        held_out_frame: first held-out frame.
        target: target of precision and recall, for all laps from the 2nd.
    """

    folder: str
    preset: str
    lap_length: int
    tolerance: int
    held_out: str
    held_out_lap: int = 2
    held_out_frame: int = 0
    target: tuple[float, float] = (0.0, 0.0)


LAPS = (
    Laps('rc_car_loops', 'rc_car', 191, 8, 'laps 3 to 10', held_out_lap=3, target=(0.98, 0.90)),
    Laps('donkeycar_track', 'donkeycar', 521, 5, 'lap 2 from frame 781 on', held_out_frame=781,
         target=(0.97, 0.80)),
)  # fmt: skip


def lap_recognition(
    template_ids: Sequence[int] | NDArray[np.int64],
    lap_phase_csv: str | Path,
    tolerance: int,
    lap_length: int,
    from_lap: int = 2,
    from_frame: int = 0,
) -> tuple[float, float]:
    """Return precision and recall of recognising places of earlier laps.

    The module docstring has the definitions.

    Args:
        template_ids: template ids of all frames in order; -1: none.
        lap_phase_csv: file with columns frame, lap and ref_frame, one row per frame.
        tolerance: largest distance between frames of the same place, in frames.
        lap_length: frames of a lap.
        from_lap: first lap that is evaluated.
        from_frame: first frame that is evaluated.
    """
    ids = np.asarray(template_ids)
    with open(lap_phase_csv, newline='') as file:
        rows = list(csv.DictReader(file))
    if len(rows) != len(ids):
        raise ValueError(f'{lap_phase_csv} has {len(rows)} frames, expected {len(ids)}')
    lap = np.array([int(row['lap']) for row in rows])
    place = np.array([int(row['ref_frame']) for row in rows])
    frame = np.arange(len(ids))

    _, first_frames, which = np.unique(ids, return_index=True, return_inverse=True)
    first = first_frames[which]
    counted = (lap >= from_lap) & (frame >= from_frame)
    recognised = counted & (ids >= 0) & (lap[first] < lap) & (frame - first > lap_length / 2)
    apart = np.abs(place - place[first]) % lap_length
    correct = recognised & (np.minimum(apart, lap_length - apart) <= tolerance)
    return correct.sum() / max(recognised.sum(), 1), correct.sum() / max(counted.sum(), 1)


def best_matches(
    references: Iterable[Image], queries: Iterable[Image], parameters: LocalViewParameters
) -> list[int]:
    """Return the index of the most similar reference for each query."""
    local_view = LocalView(parameters)
    for image in references:
        local_view.learn(make_view(image, parameters))
    best = []
    for image in queries:
        match = local_view.best_match(make_view(image, parameters))
        if match is None:
            raise ValueError('there are no references')
        best.append(match[0])
    return best


def vpr_top_1(folder: Path, parameters: LocalViewParameters) -> float:
    """Return the ratio of correct best matches on corridor_vpr."""
    with open(folder / 'ground_truth.csv', newline='') as file:
        references = [{int(i) for i in row['ref_list'].split()} for row in csv.DictReader(file)]
    best = best_matches(images_in(folder / 'ref'), images_in(folder / 'query'), parameters)
    return float(np.mean([b in correct for b, correct in zip(best, references, strict=True)]))


def circuit_top_1(folder: Path, parameters: LocalViewParameters, tolerance: int = 1) -> float:
    """Return the ratio of correct best matches on corridor_circuit."""
    images = list(images_in(folder))
    best = np.array(best_matches(images[:CIRCUIT_IMAGES], images[CIRCUIT_IMAGES:], parameters))
    apart = np.abs(best - np.arange(len(best))) % CIRCUIT_IMAGES
    return float(np.mean(np.minimum(apart, CIRCUIT_IMAGES - apart) <= tolerance))


def images_in(folder: Path) -> Iterator[Image]:
    """Yield the JPEG images of a folder in the numerical order of their names."""
    for path in sorted(folder.glob('*.jpg'), key=lambda path: int(path.stem)):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise ValueError(f'{path} cannot be decoded')
        yield image.astype(np.uint8, copy=False)


def template_ids(recording_path: Path, parameters: LocalViewParameters) -> list[int]:
    """Return the template ids of all images of a recording whose stamps increase."""
    local_view = LocalView(parameters)
    ids = []
    with open_recording(recording_path) as recording:
        last_ns = -1
        selection = recording.select(visual_odometry=True)
        for event in recording.events(selection):
            if isinstance(event, ImageEvent) and event.stamp_ns > last_ns:
                last_ns = event.stamp_ns
                ids.append(local_view.match(event.grey()).template_id)
    return ids


def preset(name: str) -> LocalViewParameters:
    """Return the local view parameters of a preset."""
    config, _ = load_config(str(ROOT / 'config' / f'{name}.yaml'))
    return config.local_view


def report_laps(data: Path, laps: Laps) -> None:
    """Print the results of a recording of laps."""
    folder = data / laps.folder
    ids = template_ids(folder, preset(laps.preset))
    common = (ids, folder / 'lap_phase.csv', laps.tolerance, laps.lap_length)
    whole = lap_recognition(*common)
    held_out = lap_recognition(*common, laps.held_out_lap, laps.held_out_frame)
    measure = f'precision / recall, +-{laps.tolerance}'
    target = f'{laps.target[0]:.2f} / {laps.target[1]:.2f}'
    for part, (precision, recall) in ((laps.held_out, held_out), ('from lap 2', whole)):
        print_row(laps.folder, measure, part, f'{precision:.3f} / {recall:.3f}', target)
    print_row(laps.folder, 'templates', 'all', str(max(ids) + 1), '')


def report_corridors(data: Path) -> None:
    """Print the results of both corridors, with the preset and with the held-out settings."""
    tuned_on_both = preset('corridor')
    for name, top_1, target, other, by_other in (
        ('corridor_vpr', vpr_top_1, '0.65', 'circuit', TUNED_ON_CIRCUIT),
        ('corridor_circuit', circuit_top_1, '0.80', 'vpr', TUNED_ON_VPR),
    ):
        folder = data / name
        if not folder.is_dir():
            print(f'{name}: skipped, {folder} not found')
            continue
        print_row(name, 'top-1', f'tuned on {other}', f'{top_1(folder, by_other):.3f}', target)
        value = f'{top_1(folder, tuned_on_both):.3f}'
        print_row(name, 'top-1', 'preset, tuned on both', value, target)


def print_row(recording: str, measure: str, part: str, value: str, target: str) -> None:
    """Print one row of the table."""
    print(f'{recording:17} {measure:23} {part:24} {value:>15} {target:>13}', flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description='Place recognition on real recordings.')
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    data: Path = parser.parse_args().data
    print_row('recording', 'measure', 'part', 'value', 'target')
    for laps in LAPS:
        if (data / laps.folder).is_dir():
            report_laps(data, laps)
        else:
            print(f'{laps.folder}: skipped, {data / laps.folder} not found')
    report_corridors(data)


if __name__ == '__main__':
    main()
