# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam evaluate`` and ``plot``: trajectories and the files of a run."""

from __future__ import annotations

import argparse
from pathlib import Path

from ratslam_ros.cli.options import Commands, read_truth
from ratslam_ros.errors import DONE


def add_evaluate(commands: Commands) -> None:
    """Add ``ratslam evaluate``."""
    evaluate = commands.add_parser('evaluate',
                                   help='compute the errors of a trajectory against the truth')
    evaluate.add_argument('trajectory', type=Path, metavar='TRAJECTORY', help='a TUM file')
    evaluate.add_argument('truth', type=Path, metavar='TRUTH', help='a TUM file')
    evaluate.add_argument('--align', choices=('se2', 'sim2', 'none'), default='se2',
                          help='rigid, similarity or no alignment (default: se2)')
    evaluate.add_argument('--json', action='store_true', help='print JSON')
    evaluate.add_argument('--plot', type=Path, metavar='FILE.png',
                          help='file for the plot (default: beside the trajectory)')
    evaluate.set_defaults(run=_evaluate)


def add_plot(commands: Commands) -> None:
    """Add ``ratslam plot``."""
    plot = commands.add_parser('plot', help='draw the plots of a results folder again')
    plot.add_argument('folder', type=Path, metavar='DIR')
    plot.add_argument('--truth', type=Path, metavar='FILE.tum')
    plot.add_argument('--times-from', type=int, metavar='ID',
                      help='also draw the travel times from this experience to all others')
    plot.add_argument('--route-to', type=int, metavar='ID',
                      help='also draw the route to this experience, from --times-from or the '
                           'last pose')
    plot.set_defaults(run=_plot)


def _evaluate(options: argparse.Namespace) -> int:
    from ratslam_ros.files.text import check_output
    from ratslam_ros.results.evaluation import evaluate
    from ratslam_ros.results.plots import plot_evaluation
    from ratslam_ros.results.trajectory import read_tum

    path = options.plot or options.trajectory.with_name(f'{options.trajectory.stem}_error.png')
    check_output(path, options.trajectory, options.truth)
    trajectory, truth = read_tum(options.trajectory), read_tum(options.truth)
    evaluation = evaluate(trajectory, truth, options.align)
    plot_evaluation(evaluation, path)
    print(evaluation.to_json() if options.json else f'{evaluation.format()}\n{path}')
    return DONE


def _plot(options: argparse.Namespace) -> int:
    from ratslam_ros.results.plots import draw_all

    paths = draw_all(options.folder, read_truth(options.truth))
    if options.times_from is not None or options.route_to is not None:
        from ratslam_ros.results.goal_plots import draw_times

        paths.append(draw_times(options.folder, options.times_from, options.route_to))
    for path in paths:
        print(path)
    return DONE
