# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam study``: parameter studies over several recordings."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from ratslam_ros.cli.options import Commands, make_folder, positive_number, whole_number
from ratslam_ros.console import print_notice, print_notices
from ratslam_ros.errors import DONE


def add_study(commands: Commands) -> None:
    """Add ``ratslam study``."""
    study = commands.add_parser(
        'study', help='search parameters over several recordings with Optuna')
    study.add_argument('study', type=Path, metavar='STUDY.yaml',
                       help='recordings, parameters with ranges, and the initial configuration')
    study.add_argument('--out', type=Path, metavar='DIR',
                       help='folder for the report; a study in it is resumed (default: '
                            'results/NAME-study)')
    study.add_argument('--trials', type=positive_number, metavar='N',
                       help='number of configurations to try, those of earlier runs included')
    study.add_argument('--jobs', type=positive_number, default=1, metavar='N',
                       help='number of processes (default: 1)')
    study.add_argument('--seed', type=whole_number, metavar='N', help='seed of the sampler')
    study.add_argument('--storage', metavar='URL',
                       help='database of Optuna, such as postgresql://HOST/NAME or '
                            'sqlite:///FILE, for several machines (default: a file in DIR)')
    study.add_argument('--report-only', action='store_true',
                       help='validate and report the trials of the storage')
    study.set_defaults(run=_study)


def _study(options: argparse.Namespace) -> int:
    from ratslam_tuning.study import import_optuna, search, write_report
    from ratslam_tuning.study_plan import read_plan

    import_optuna()
    plan = read_plan(options.study)
    print_notices(plan.notices)
    if options.trials is not None:
        plan = replace(plan, trials=options.trials)
    if options.seed is not None:
        plan = replace(plan, seed=options.seed)
    folder = make_folder(options.out or Path('results') / f'{plan.name}-study')
    storage = options.storage or str(folder / 'study.journal')
    from ratslam_ros.offline.compile_all import compile_kernels

    compile_kernels()
    if not options.report_only:
        search(plan, storage, options.jobs, print_notice)
    print(write_report(plan, storage, folder))
    for name in ('report.md', 'best.yaml'):
        print(folder / name)
    return DONE
