# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Constants chosen by leave-one-out over the recordings: which value suits an unseen one?

    python benchmarks/leave_one_out.py --constant MODULE:NAME=VALUE,VALUE,... [--variant NAME ...]
    python benchmarks/leave_one_out.py \
        --constant ratslam_ros.core.vision.match_threshold:RELATED_RATIO=0.6,0.655,0.7

Every recording is replayed with every value, with nothing configured. The values whose mean score
is within 0.01 of the best are printed. For each recording that is left out, the value with the
best mean score on the others is chosen, and the results of the left out one with this value are
printed. Recordings from one folder are left out together. With several --constant, all
combinations of their values are compared. The values of an array are tuples:
'MODULE:NAME=(0.7,0.2,0.1),(0.6,0.3,0.1)'.

Score, from 0 to 1. Laps: the harmonic mean of precision and recall, divided by 1 + (e / limit)^2
for the spread (limit 0.05) and for the error of the turns for each lap (0.2), so that it is smooth
and a map at a limit of `stability.py` has half the score. lecture_hall, tuc_corridor and seeds of
`ratslam demo`: 1 / (1 + (ATE / target)^2), with the targets of `defaults_on_recordings.py`. The
score of several variants or seeds is their mean.

A constant is set in new processes, before any other module imports it. Values that its module
computes from it on import, including default arguments, keep the old one. Constants that compiled
functions use are refused, because their machine code is cached.
"""

# The package is imported in functions only: the processes set the constants before.
from __future__ import annotations

import argparse
import ast
import importlib
import itertools
import math
import statistics
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from lap_measures import LapMeasures, Setup

SPREAD, TURNS = 0.05, 0.2
"""Spread and error of the turns for each lap that halve the score."""

Value = float | tuple[float, ...]

Values = tuple[tuple[str, str, Value], ...]
"""Module, name and value of each constant."""

Case = tuple[str, str]
"""Names of a recording and a variant; 'demo' or 'demo_by_camera' and a seed."""

DEMOS = DEMO, DEMO_BY_CAMERA = 'demo', 'demo_by_camera'

DEMO_BY_CAMERA_M = 0.8
"""Error of the demo by camera that halves the score: the mean is 0.82 m."""

EQUAL = 0.01
"""Difference of mean scores up to which values are equally good."""


def parse(text: str) -> list[tuple[str, str, Value]]:
    """Return module, name and each value of MODULE:NAME=VALUE,VALUE,..."""
    constant, _, values = text.partition('=')
    module, _, name = constant.partition(':')
    try:
        current = vars(importlib.import_module(module))[name]
        found = ast.literal_eval(f'[{values}]')
        if not found or any(np.shape(value) != np.shape(current) for value in found):
            raise ValueError(f'{name} is {current!r}')
    except (ImportError, KeyError, SyntaxError, ValueError) as error:
        raise argparse.ArgumentTypeError(
            f'{text!r} cannot be used ({error!r}): expected MODULE:NAME=VALUE,VALUE,...'
        ) from None
    if users := compiled_users(name, current):
        raise argparse.ArgumentTypeError(
            f'{name} is part of compiled functions, whose machine code is cached: '
            f'{", ".join(users)}; make it an argument of them'
        )
    return [(module, name, value) for value in found]


def compiled_users(name: str, value: object, within: str = 'ratslam_ros') -> list[str]:
    """Return the compiled functions of imported modules within a package that read a constant."""
    return sorted({
        f'{function.__module__}.{function.__name__}'
        for key, module in list(sys.modules.items()) if key.startswith(within)
        for compiled in vars(module).values()
        if (function := getattr(compiled, 'py_func', None)) is not None
        and name in function.__code__.co_names and function.__globals__.get(name) is value
    })


def start(values: Values) -> None:
    """Set the constants, and prepare a process."""
    for module, name, value in values:
        is_array = isinstance(value, tuple)
        setattr(importlib.import_module(module), name, np.array(value) if is_array else value)
    from ratslam_ros.core.warm_up import warm_up

    warm_up()


def score(measures: LapMeasures, true_turns: float) -> float:
    """Return the score of a map of a recording of laps, as defined in the module docstring."""
    precision, recall, spread, turns, _ = measures
    if math.isnan(turns):  # no place was visited twice without a gap: the mean would be no number
        return 0.0
    return (
        2.0 * precision * recall / max(precision + recall, 1e-9)
        / (1.0 + (spread / SPREAD) ** 2) / (1.0 + ((turns - true_turns) / TURNS) ** 2)
    )


def run(data: Path, setup: Setup, case: Case) -> tuple[float, str]:
    """Replay a recording; return its score and its results as text."""
    from defaults_on_recordings import DEMO_M, ROUTES, demo_error_m, route_error_m
    from lap_measures import LAPS, run_laps
    from recording_variants import CAMERA_ONLY

    name, variant = case
    if name in LAPS:
        laps = LAPS[name]
        measures = run_laps(data, laps, setup, variant).measures
        precision, recall, spread, turns, _ = measures
        verdict = 'right' if measures.is_right(laps.turns) else 'WRONG'
        text = f'{precision:.3f} / {recall:.3f}, {spread:.3f}, {turns:.2f} turns, {verdict}'
        return score(measures, laps.turns), text
    if name == DEMO:
        error_m, target_m = demo_error_m(int(variant), setup), DEMO_M[0]
    elif name == DEMO_BY_CAMERA:
        error_m, target_m = demo_error_m(int(variant), setup, CAMERA_ONLY), DEMO_BY_CAMERA_M
    else:
        source, target_m = ROUTES[name]
        error_m = route_error_m(data, source, setup)
    return 1.0 / (1.0 + (error_m / target_m) ** 2), f'{error_m:.2f} m'


def left_out(
    scores: dict[Values, dict[str, float]], place_of: dict[str, str]
) -> dict[str, Values]:
    """Return for each recording the values that are best on the recordings of other places.

    Args:
        scores: score of each recording for each choice of values.
        place_of: place of each recording.
    """
    def mean(values: Values, place: str) -> float:
        others = [one for name, one in scores[values].items() if place_of[name] != place]
        return statistics.fmean(others)

    return {name: max(scores, key=lambda values: mean(values, place))
            for name, place in place_of.items()}


def equally_good(scores: dict[Values, dict[str, float]]) -> list[Values]:
    """Return the values whose mean score is within ``EQUAL`` of the best."""
    means = {values: statistics.fmean(found.values()) for values, found in scores.items()}
    return [values for values, mean in means.items() if mean >= max(means.values()) - EQUAL]


def described(values: Values) -> str:
    """Return the values as text."""
    return ', '.join(
        f'{name} {" ".join(f"{one:g}" for one in np.ravel(value))}' for _, name, value in values
    )


def main() -> None:
    from defaults_on_recordings import ROUTES
    from lap_measures import LAPS, Setup, in_processes
    from recording_variants import ORIGINAL, VARIANTS

    from ratslam_ros.errors import RatslamError

    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    Setup.add_options(parser)
    parser.add_argument('--constant', type=parse, action='append', required=True,
                        metavar='MODULE:NAME=VALUE,VALUE,...', help='may be repeated')
    parser.add_argument('--only', action='append', choices=(*LAPS, *ROUTES, *DEMOS),
                        metavar='RECORDING', help="may be repeated; 'demo' is one, too")
    parser.add_argument('--demos', type=int, default=3, help='simulated runs (default: 3)')
    parser.add_argument('--variant', action='append', choices=VARIANTS, metavar='NAME',
                        help='of recordings of laps; may be repeated (default: original)')
    parser.add_argument('--jobs', type=int, default=2, help='number of processes (default: 2)')
    options = parser.parse_args()
    place_of = {name: laps.folder or name for name, laps in LAPS.items()} | {
        name: name for name in ROUTES
    }
    place_of = {
        name: place for name, place in place_of.items() if (options.data / place).is_dir()
    } | {name: name for name in DEMOS}
    place_of = {name: place_of[name] for name in options.only or place_of if name in place_of}
    if len({*place_of.values()}) < 2:
        parser.error(f'{options.data} has fewer than two of the recordings: expected more')
    seeds = [str(seed) for seed in range(1, options.demos + 1)]
    variants = {name: options.variant or [ORIGINAL] for name in LAPS} | {
        name: seeds for name in DEMOS
    }
    cases = [
        (name, variant) for name in place_of for variant in variants.get(name, [ORIGINAL])
    ]
    scores: dict[Values, dict[str, float]] = {}
    texts: dict[tuple[Values, str], list[str]] = {}
    for values in itertools.product(*options.constant):
        found: dict[str, list[float]] = {name: [] for name in place_of}
        work = partial(run, options.data, Setup.of(options))
        for (name, variant), result in in_processes(
            work, cases, options.jobs, partial(start, values)
        ):
            one, text = (0.0, str(result)) if isinstance(result, RatslamError) else result
            found[name].append(one)
            texts.setdefault((values, name), []).append(f'{variant}: {text}')
            print(f'{described(values):30} {name:17} {one:.3f}  {variant}: {text}', flush=True)
        scores[values] = {name: statistics.fmean(all_of) for name, all_of in found.items()}
    print('\nscore'.ljust(18), *(f'{described(values):>22}' for values in scores))
    for name in place_of:
        print(f'{name:17}', *(f'{one[name]:22.3f}' for one in scores.values()))
    print(f'{"mean":17}', *(f'{statistics.fmean(s.values()):22.3f}' for s in scores.values()))
    good = '; '.join(map(described, equally_good(scores)))
    print(f'within {EQUAL} of the best mean: {good}')
    print('\nleft out: chosen on the others, result with it')
    for name, values in left_out(scores, place_of).items():
        print(f'{name:17} {described(values)}: {"; ".join(texts[values, name])}')


if __name__ == '__main__':
    main()
