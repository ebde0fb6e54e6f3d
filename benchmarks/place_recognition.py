# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Precision and recall of the local view on real recordings.

    python benchmarks/place_recognition.py [--data ../shared/data] [--descriptor NAME ...]
    python benchmarks/place_recognition.py --data FOLDER [--descriptor NAME ...]

A FOLDER with the folders `query` and `ref` (the layout of VPR-Bench) is evaluated with every
descriptor, see "Descriptors" below. Otherwise --data is the folder of the recordings below, which
are evaluated with the presets of the folder `config` and then with every descriptor. Missing
recordings are reported and skipped.

Descriptors. The settings of `settings` are compared, one setting for all data, and the descriptors
given by --descriptor (names of installed descriptors, or paths of ONNX models). The measures are
- top-1: share of the queries whose best match is correct. Queries without a reference do not
  count; images with too little structure have no match.
- AUC: area under the precision-recall curve of the best matches, ordered by their error.
- ms: median time of encoding a view, and of searching all references.
On recordings of laps, the references are every second frame of the first whole lap, and the
queries up to 300 frames of the later laps. The corridors are also evaluated with references and
queries exchanged. "held out" is the leave-one-out score: that of the setting with the best mean
top-1 on all other places, where both directions of a corridor have half the weight. Presets, which
were tuned on some of the data, are not chosen.

Sequences. The default descriptor and those given by --descriptor are evaluated with the sequence
matcher of the package, over the last 1, 5, 10 and 20 queries (fewer at the start), without a
threshold. The matches are ordered by their margin to the best reference elsewhere.
- recall: share of the queries whose match is correct, among the best ones that together have a
  precision of 99 %.
On recordings of laps, the queries are every second frame of the second lap, like the references.

VPR-Bench: the images of `query` and `ref` are ordered by the numbers in their names.
`ground_truth.csv` has the columns query and ref_list (numbers separated by spaces). Without it,
`ground_truth_new.npy` is read, a pickle of pairs of a query and a list of references, by an
unpickler that runs no code.

Laps (rc_car_loops, donkeycar_track). `LocalView` processes all images in order, except those whose
stamp does not increase. `lap_measures.py` defines precision and recall.
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
import math
import operator
import re
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from lap_measures import LAPS, ROOT

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.core.vision.sequence_matcher import SequenceMatcher
from ratslam_ros.core.vision.template_memory import TemplateMemory
from ratslam_ros.descriptors import encoder_of
from ratslam_ros.descriptors.tensors import RestrictedUnpickler, UnpicklingError
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.files.config import load_config
from ratslam_ros.images import EncodedImage, UndecodableImage
from ratslam_ros.recordings import ImageEvent, Recording, open_recording
from ratslam_tuning.lap_phases import read_lap_phases

ORIGINAL = load_config('openratslam')[0].local_view
TUNED_ON_CIRCUIT = replace(
    ORIGINAL, template_x_size=20, template_y_size=20, vt_shift_match=6, vt_shift_match_y=3
)
TUNED_ON_VPR = replace(
    ORIGINAL, template_x_size=32, template_y_size=48, vt_shift_match=4, vt_shift_match_y=9,
    vt_patch_normalise=15, vt_min_patch_normalisation_std=0.05,
)

CIRCUIT_IMAGES = 40
"""Number of images of one round of the circuit."""

TUNED_PRESETS = 'corridor', 'rc_car', 'donkeycar'
"""Presets that were tuned on some of the recordings."""

DESCRIPTOR_LAPS = 'rc_car_loops', 'donkeycar_track', 'lab_car'
"""Recordings of laps that descriptors are evaluated on."""

SEQUENCE_LENGTHS = 1, 5, 10, 20


@dataclass(frozen=True)
class TunedLaps:
    """A recording of laps, and the frames that its preset was not tuned on.

    Attributes:
        folder: folder of the recording.
        preset: name of the preset.
        held_out: description of the held-out frames.
        held_out_lap: first held-out lap.
        held_out_frame: first held-out frame.
        target: target of precision and recall, for all laps from the 2nd.
    """

    folder: str
    preset: str
    held_out: str
    held_out_lap: int = 2
    held_out_frame: int = 0
    target: tuple[float, float] = (0.0, 0.0)


TUNED_LAPS = (
    TunedLaps('rc_car_loops', 'rc_car', 'laps 3 to 10', held_out_lap=3, target=(0.98, 0.90)),
    TunedLaps('donkeycar_track', 'donkeycar', 'lap 2 from frame 781 on', held_out_frame=781,
              target=(0.97, 0.80)),
)


def increasing(recording: Recording) -> Iterator[ImageEvent]:
    """Yield the images of a recording whose stamps increase."""
    last_ns = -1
    for event in recording.events(recording.select(visual_odometry=True)):
        if isinstance(event, ImageEvent) and event.stamp_ns > last_ns:
            last_ns = event.stamp_ns
            yield event


def template_ids(recording_path: Path, parameters: LocalViewParameters) -> list[int]:
    """Return the template ids of all images of a recording whose stamps increase."""
    local_view = LocalView(parameters)
    with open_recording(recording_path) as recording:
        return [local_view.match(image.grey()).template_id for image in increasing(recording)]


def preset(name: str) -> LocalViewParameters:
    """Return the local view parameters of a preset."""
    config, _ = load_config(str(ROOT / 'config' / f'{name}.yaml'))
    return config.local_view


def report_laps(data: Path, laps: TunedLaps) -> None:
    """Print the results of a recording of laps."""
    folder, tolerance = data / laps.folder, LAPS[laps.folder].tolerance
    ids = template_ids(folder, preset(laps.preset))
    phases = read_lap_phases(folder / 'lap_phase.csv')
    whole = phases.recognition(ids, tolerance)
    held_out = phases.recognition(ids, tolerance, laps.held_out_lap, laps.held_out_frame)
    measure = f'precision / recall, +-{tolerance}'
    target = f'{laps.target[0]:.2f} / {laps.target[1]:.2f}'
    for part, (precision, recall) in ((laps.held_out, held_out), ('from lap 2', whole)):
        print_row(laps.folder, measure, part, f'{precision:.3f} / {recall:.3f}', target)
    print_row(laps.folder, 'templates', 'all', str(max(ids) + 1), '')


def report_corridors(data: Path) -> None:
    """Print the results of both corridors, with the preset and with the held-out settings."""
    tuned_on_both = preset('corridor')
    for name, read_set, target, other, by_other in (
        ('corridor_vpr', vpr_set, '0.65', 'circuit', TUNED_ON_CIRCUIT),
        ('corridor_circuit', circuit_set, '0.80', 'vpr', TUNED_ON_VPR),
    ):
        folder = data / name
        if not folder.is_dir():
            print(f'{name}: skipped, {folder} not found')
            continue
        place_set = read_set(folder)
        for part, parameters in (
            (f'tuned on {other}', by_other), ('preset, tuned on both', tuned_on_both),
        ):
            print_row(name, 'top-1', part, f'{evaluate(place_set, parameters).top_1:.3f}', target)


# Descriptors


@dataclass(frozen=True)
class PlaceSet:
    """References, queries, and which references show the place of each query.

    Attributes:
        place: name of the place.
        exchanged: whether references and queries are exchanged.
        references, queries: images with colour.
        correct: set of the correct references of each query.
    """

    place: str
    references: list[PreparedImage]
    queries: list[PreparedImage]
    correct: list[set[int]]
    exchanged: bool = False

    @property
    def name(self) -> str:
        """Name in the table."""
        return f'{self.place}, exchanged' if self.exchanged else self.place

    def exchange(self) -> PlaceSet:
        """Return the set with references and queries exchanged."""
        correct: list[set[int]] = [set() for _ in self.references]
        for query, those in enumerate(self.correct):
            for reference in those:
                correct[reference].add(query)
        return PlaceSet(self.place, self.queries, self.references, correct, True)


@dataclass(frozen=True)
class Scores:
    """Results of one setting on one set; the measures are defined in the module docstring."""

    top_1: float
    auc: float
    encode_ms: float
    search_ms: float


def settings() -> dict[str, LocalViewParameters]:
    """Return the compared settings by name."""
    return {
        'intensity (openratslam)': ORIGINAL,
        'intensity, patches': replace(
            ORIGINAL, template_y_size=24, vt_patch_normalise=4, vt_shift_match_y=2
        ),
        **{name: preset(name) for name in TUNED_PRESETS},
        'gradients (default)': LocalViewParameters(),
        **{
            f'gradients {x}x{y}, shift {shift_x}, {shift_y}': replace(
                ORIGINAL, vt_descriptor='gradients', template_x_size=x, template_y_size=y,
                vt_shift_match=shift_x, vt_shift_match_y=shift_y,
            )
            for x, y, shift_x, shift_y in (
                (12, 9, 0, 0), (12, 9, 1, 0), (12, 9, 2, 1), (16, 12, 2, 1), (24, 12, 2, 1)
            )
        },
    }


def evaluate(place_set: PlaceSet, parameters: LocalViewParameters) -> Scores:
    """Return the scores of the best matches, without a threshold and without learning."""
    local_view = LocalView(parameters, encoder_of(parameters))
    number_of = []
    for number, image in enumerate(place_set.references):
        view = local_view.encode(image.pixels, image.colour)
        if view is not None:
            local_view.learn(view)
            number_of.append(number)
    results, encode_ms, search_ms = [], [], []
    for image, correct in zip(place_set.queries, place_set.correct, strict=True):
        start_s = time.perf_counter()
        view = local_view.encode(image.pixels, image.colour)
        encoded_s = time.perf_counter()
        match = None if view is None else local_view.best_match(view)
        search_ms.append((time.perf_counter() - encoded_s) * 1e3)
        encode_ms.append((encoded_s - start_s) * 1e3)
        if correct and match is not None:
            results.append((match.sad, number_of[match.template_id] in correct))
    queries = sum(bool(correct) for correct in place_set.correct)
    right = [correct for _, correct in sorted(results, key=lambda result: result[0])]
    return Scores(
        sum(right) / queries, average_precision(right, queries), statistics.median(encode_ms),
        statistics.median(search_ms),
    )


def evaluate_sequences(
    place_set: PlaceSet, parameters: LocalViewParameters, length: int
) -> tuple[float, float]:
    """Return top-1, and the recall at a precision of 99 %, of sequences of queries."""
    encoder = encoder_of(parameters)
    local_view = LocalView(parameters, encoder)
    memory = TemplateMemory(encoder.layout)
    for number, image in enumerate(place_set.references):
        view = local_view.encode(image.pixels, image.colour)
        if view is not None:
            memory.append(view, number)
    ids, matcher, results = memory.ids, SequenceMatcher(encoder.layout, length), []
    for image, correct in zip(place_set.queries, place_set.correct, strict=True):
        view = local_view.encode(image.pixels, image.colour)
        if view is not None:
            matcher.add(view, ids, memory.search(view).sads(range(len(memory))))
            match = matcher.best()
            if correct and match is not None:
                results.append((match.false_match_rate, match.template_id in correct))
    queries = sum(bool(correct) for correct in place_set.correct)
    right = np.cumsum([correct for _, correct in sorted(results, key=lambda result: result[0])])
    precise = right[right >= 0.99 * np.arange(1, len(right) + 1)]
    return float(right[-1]) / queries, float(max(precise, default=0)) / queries


def average_precision(right: Sequence[bool], count: int) -> float:
    """Return the area under the precision-recall curve.

    Args:
        right: whether each match is correct, best match first.
        count: number of queries.
    """
    found, area = 0, 0.0
    for number, correct in enumerate(right, 1):
        if correct:
            found += 1
            area += found / number / count
    return area


def vpr_set(folder: Path) -> PlaceSet:
    """Return a set in the layout of VPR-Bench."""
    references, queries = (images_of(folder / part) for part in ('ref', 'query'))
    correct: list[set[int]] = [set() for _ in queries]
    for query, those in ground_truth(folder):
        correct[query] = those
    return PlaceSet(folder.name, references, queries, correct)


def ground_truth(folder: Path) -> list[tuple[int, set[int]]]:
    """Return pairs of a query and its correct references."""
    table, stored = folder / 'ground_truth.csv', folder / 'ground_truth_new.npy'
    if table.is_file():
        with table.open(newline='') as file:
            rows = list(csv.DictReader(file))
        return [(int(row['query']), {int(i) for i in row['ref_list'].split()}) for row in rows]
    if stored.is_file():
        return pickled_pairs(stored)
    raise SystemExit(
        f'{folder} has neither a ground_truth.csv with the columns query and ref_list (numbers '
        'separated by spaces) nor a ground_truth_new.npy'
    )


class Stored:
    """An array or a type in a pickle. NumPy would trust its flags, which can damage memory."""

    def __init__(self, *_: object) -> None:
        pass

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.state = state


PICKLED = dict.fromkeys([
    ('numpy.core.multiarray', '_reconstruct'), ('numpy._core.multiarray', '_reconstruct'),
    ('numpy', 'ndarray'), ('numpy', 'dtype'),
], Stored)
"""Names in the pickle of an array of objects."""


def pickled_pairs(path: Path) -> list[tuple[int, set[int]]]:
    """Return the pairs of an array of objects, (n, 2) numbers and lists of numbers.

    A query without a reference has -1.

    Raises:
        SystemExit: the file contains something else.
    """
    try:
        with path.open('rb') as file:
            np.lib.format.read_magic(file)
            np.lib.format.read_array_header_1_0(file)
            *_, values = RestrictedUnpickler(file, PICKLED).load().state
        return [
            (operator.index(query), {n for n in map(operator.index, those) if n >= 0})
            for query, those in zip(values[::2], values[1::2], strict=True)
        ]
    except (UnpicklingError, AttributeError, EOFError, TypeError, ValueError) as error:
        raise SystemExit(
            f'{path} cannot be read ({error}); expected pairs of a query and a list of references'
        ) from None


def images_of(folder: Path) -> list[PreparedImage]:
    """Return all images of a folder, ordered by the numbers in their names."""
    suffixes = {'.jpg', '.jpeg', '.png', '.bmp', '.ppm'}
    paths = [path for path in folder.iterdir() if path.suffix.lower() in suffixes]

    def order(path: Path) -> list[tuple[int, str]]:
        return [(int(part or 0), text) for text, part in re.findall(r'(\D*)(\d*)', path.stem)]

    try:
        images = [decoded(EncodedImage(path.read_bytes())) for path in sorted(paths, key=order)]
    except UndecodableImage as error:
        raise SystemExit(f'{folder}: {error}') from None
    if not images:
        raise SystemExit(f'{folder}: no images')
    return images


def decoded(image: EncodedImage | ImageEvent) -> PreparedImage:
    """Return an image with its colour."""
    return PreparedImage(image.grey(), colour=image.bgr())


def circuit_set(folder: Path) -> PlaceSet:
    """Return corridor_circuit as a set."""
    images = images_of(folder)
    queries = images[CIRCUIT_IMAGES:]
    correct = [
        {(number + d) % CIRCUIT_IMAGES for d in (-1, 0, 1)} for number in range(len(queries))
    ]
    return PlaceSet(folder.name, images[:CIRCUIT_IMAGES], queries, correct)


def lap_set(folder: Path, tolerance: int, consecutive: bool = False) -> PlaceSet:
    """Return a recording of laps as a set: the first whole lap, and frames of later ones.

    Args:
        folder: folder of the recording.
        tolerance: largest distance between frames of the same place, in frames.
        consecutive: whether the queries are every second frame of the second lap.
    """
    phases = read_lap_phases(folder / 'lap_phase.csv')
    with open_recording(folder) as recording:
        images = list(increasing(recording))
        references = np.flatnonzero(phases.lap == 1)[::2]
        later = np.flatnonzero(phases.lap >= 2)
        queries = later[:: max(math.ceil(len(later) / 300), 1)]
        if consecutive:
            queries = np.flatnonzero(phases.lap == 2)[::2]
        places = phases.place[queries][:, None], phases.place[references]
        correct = phases.apart(*places) <= tolerance
        return PlaceSet(
            folder.name, [decoded(images[n]) for n in references],
            [decoded(images[n]) for n in queries],
            [set(np.flatnonzero(row).tolist()) for row in correct],
        )


def shared_sets(data: Path, consecutive: bool = False) -> list[PlaceSet]:
    """Return all sets of the shared recordings that exist; see ``lap_set``."""
    found = []
    if (data / 'corridor_vpr').is_dir():
        found.append(vpr_set(data / 'corridor_vpr'))
    if (data / 'corridor_circuit').is_dir():
        found.append(circuit_set(data / 'corridor_circuit'))
    found += [place_set.exchange() for place_set in found]
    for name in DESCRIPTOR_LAPS:
        if (data / name).is_dir():
            found.append(lap_set(data / name, LAPS[name].tolerance, consecutive))
    return found


def report_descriptors(place_sets: list[PlaceSet], descriptors: Sequence[str]) -> None:
    """Print the scores of all settings on all sets, and the leave-one-out choice."""
    compared = settings()
    compared |= {name: replace(ORIGINAL, vt_descriptor=name) for name in descriptors}
    print(f'\n{"top-1 / AUC / ms to encode + search":38}', *(f'{s.name:>27}' for s in place_sets))
    top_1: dict[str, list[float]] = {}
    for name, parameters in compared.items():
        cells = []
        for place_set in place_sets:
            try:
                scores = evaluate(place_set, parameters)
            except UnusableParameter:
                cells.append('does not fit the images')
                continue
            top_1.setdefault(name, []).append(scores.top_1)
            cells.append(f'{scores.top_1:.3f} / {scores.auc:.3f} / '
                         f'{scores.encode_ms:.2f} + {scores.search_ms:.2f}')
        print(f'{name:38}', *(f'{cell:>27}' for cell in cells), flush=True)
    complete = {
        name: row for name, row in top_1.items()
        if len(row) == len(place_sets) and name not in TUNED_PRESETS
    }
    places = list(dict.fromkeys(place_set.place for place_set in place_sets))
    if len(places) > 1 and complete:
        for held_out in places:
            means = {
                name: statistics.fmean(
                    statistics.fmean(
                        score for score, s in zip(row, place_sets, strict=True) if s.place == place
                    )
                    for place in places if place != held_out
                )
                for name, row in complete.items()
            }
            best = max(means, key=lambda name: means[name])
            for score, place_set in zip(complete[best], place_sets, strict=True):
                if place_set.place == held_out:
                    print(f'held out: {place_set.name:30} {score:.3f} by {best}')


def report_sequences(place_sets: list[PlaceSet], descriptors: Sequence[str]) -> None:
    """Print top-1 and recall of sequences of several lengths."""
    compared = {'gradients (default)': LocalViewParameters()}
    compared |= {name: replace(ORIGINAL, vt_descriptor=name) for name in descriptors}
    print(f'\n{"top-1 / recall at 99 %, views in sequence":50}',
          *(f'{length:>15}' for length in SEQUENCE_LENGTHS))
    for place_set in place_sets:
        for name, parameters in compared.items():
            cells = (
                '{:.3f} / {:.3f}'.format(*evaluate_sequences(place_set, parameters, length))
                for length in SEQUENCE_LENGTHS
            )
            print(f'{place_set.name:28} {name:21}', *(f'{cell:>15}' for cell in cells), flush=True)


def print_row(recording: str, measure: str, part: str, value: str, target: str) -> None:
    """Print one row of the table."""
    print(f'{recording:17} {measure:23} {part:24} {value:>15} {target:>13}', flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description='Place recognition on real recordings.')
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    parser.add_argument(
        '--descriptor', action='append', default=[], metavar='NAME',
        help='also evaluate this descriptor or ONNX model (may be repeated)',
    )
    options = parser.parse_args()
    data: Path = options.data
    if (data / 'query').is_dir() and (data / 'ref').is_dir():
        report_descriptors([vpr_set(data)], options.descriptor)
        report_sequences([vpr_set(data)], options.descriptor)
        return
    print_row('recording', 'measure', 'part', 'value', 'target')
    for laps in TUNED_LAPS:
        if (data / laps.folder).is_dir():
            report_laps(data, laps)
        else:
            print(f'{laps.folder}: skipped, {data / laps.folder} not found')
    report_corridors(data)
    place_sets = shared_sets(data)
    if place_sets:
        report_descriptors(place_sets, options.descriptor)
        report_sequences(shared_sets(data, consecutive=True), options.descriptor)


if __name__ == '__main__':
    main()
