# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam demo`` and ``simulate``: simulated robots."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ratslam_ros.cli.options import (
    Commands,
    add_config,
    add_out,
    add_view_options,
    config_of,
    make_folder,
    positive,
    positive_number,
    results_folder,
    whole_number,
)
from ratslam_ros.console import print_notice, ticking
from ratslam_ros.errors import DONE, UnusableInput


def add_demo(commands: Commands) -> None:
    """Add ``ratslam demo``."""
    demo = commands.add_parser('demo', help='simulate a robot in an office, and map it')
    demo.add_argument('--seed', type=whole_number, default=1,
                      help='random seed of world and noise (default: 1)')
    demo.add_argument('--seeds', type=positive_number, metavar='N',
                      help='run N seeds, starting at --seed, and print the mean and worst errors')
    add_config(demo)
    add_out(demo, 'results/demo-TIME, with the link results/latest')
    demo.add_argument('--quiet', action='store_true', help='no progress bar')
    add_view_options(demo)
    demo.set_defaults(run=_demo, parser=demo)


def add_simulate(commands: Commands) -> None:
    """Add ``ratslam simulate``."""
    simulate = commands.add_parser(
        'simulate', help='simulate a robot that explores a floor plan and drives to goals'
    )
    simulate.add_argument('--plan', metavar='NAME|FILE',
                          help='floor plan: a name from the package, or a text or PNG file')
    simulate.add_argument('--cell-m', type=float, metavar='M',
                          help='side length of a cell or pixel')
    simulate.add_argument('--start', metavar='PLACE|X,Y,DEG',
                          help='start pose (default: place S, or a random one)')
    simulate.add_argument('--seed', type=whole_number,
                          help='random seed of world and noise (default: 1)')
    simulate.add_argument('--explore', type=positive, default=30.0, metavar='MINUTES',
                          help='duration of exploration before the goals (default: 30)')
    which = simulate.add_mutually_exclusive_group()
    which.add_argument('--goals', metavar='A,B,C',
                       help='places of the plan, in order (default: all visited ones)')
    which.add_argument('--random-goals', type=positive_number, default=0, metavar='N',
                       help='drive to N randomly chosen visited places')
    simulate.add_argument('--people', type=whole_number, metavar='N',
                          help='number of people who walk about at random')
    simulate.add_argument('--walk', action='append', metavar='X,Y,X,Y,...,FROM_S,TO_S',
                          help='a person walks along points, back and forth, or stands at one '
                               'point, from FROM_S to TO_S; may be repeated')
    simulate.add_argument('--obstacle', action='append', metavar='NAME,X,Y,W,D,FROM_S,TO_S',
                          help='place a box from FROM_S to TO_S; may be repeated')
    simulate.add_argument('--carry', action='append', metavar='X,Y,DEG,AT_S',
                          help='carry the robot to a pose at a time; may be repeated')
    simulate.add_argument('--noise', type=float, metavar='FACTOR',
                          help='factor on the odometry noise (default: 1)')
    simulate.add_argument('--rear-laser', action='store_true', default=None,
                          help='add a laser that looks back; set experience_map.scan_topics to '
                               'scan,scan_rear')
    simulate.add_argument('--sonars', action='store_true', default=None,
                          help='add eight sonars; the robot steers by them')
    add_config(simulate, 'navigation')
    simulate.add_argument('--record', type=Path, metavar='DIR',
                          help='record all sensor data (rosbag2)')
    simulate.add_argument('--live', action='store_true',
                          help='simulate the robot for live nodes: publish image, odom, scan '
                               'and /clock')
    simulate.add_argument('--rate', type=float, metavar='R',
                          help='speed of time with --live (default: 1)')
    simulate.add_argument('--no-history', action='store_true',
                          help='do not write history.sqlite, from which `ratslam view` shows any '
                               'moment of the run')
    add_out(simulate, 'results/simulate-TIME, with the link results/latest')
    simulate.add_argument('--quiet', action='store_true', help='no progress bar')
    add_view_options(simulate)
    simulate.set_defaults(run=_simulate, parser=simulate)


def _demo(options: argparse.Namespace) -> int:
    if options.view:
        if options.seeds is not None:
            raise UnusableInput('--view shows one run; leave out --seeds')
        from ratslam_ros.cli.view_command import view_simulation
        from ratslam_ros.offline.demo import TITLE

        return view_simulation(options, 'demo', TITLE)
    folder = None if options.seeds else results_folder(options, 'demo')
    if not options.quiet:
        print_notice('demo: a simulated robot drives through an office, and maps it')
    with ticking('loading:', not options.quiet):
        from ratslam_ros.files.config import parse_setting
        from ratslam_ros.offline.demo import run_demo, run_seeds
    config = config_of(options)  # an unknown parameter is reported before the simulation
    settings = dict(parse_setting(text) for text in options.settings)
    parameters = None if options.config is None else config, settings
    if folder is None:
        seeds = range(options.seed, options.seed + options.seeds)
        print(run_seeds(*parameters, seeds, not options.quiet))
        return DONE
    make_folder(folder)
    print(run_demo(*parameters, options.seed, folder, not options.quiet))
    if options.out is None:
        from ratslam_ros.results.writer import link_latest

        link_latest(folder)
    return DONE


def _simulate(options: argparse.Namespace) -> int:
    if options.view:
        if options.live:
            raise UnusableInput(
                '--view shows the map, which live nodes build: leave it out here, and run '
                'ratslam launch --view'
            )
        from ratslam_ros.cli.view_command import view_simulation

        where = '' if options.plan is None else f' on the floor plan {options.plan}'
        return view_simulation(options, 'simulate', f'simulate: a robot{where}')
    from ratslam_simulator.config import SimulatorParameters

    given = {
        name: value
        for name in (
            'plan', 'cell_m', 'start', 'seed', 'people', 'noise', 'rear_laser', 'sonars', 'rate'
        )
        if (value := getattr(options, name)) is not None
    }
    if options.obstacle:
        given['obstacles'] = ';'.join(options.obstacle)
    if options.walk:
        given['walks'] = ';'.join(options.walk)
    if options.carry:
        given['carries'] = ';'.join(options.carry)
    if options.live:
        from ratslam_ros.live.run import run

        values = [f'{name}:={json.dumps(value)}' for name, value in given.items()]
        return run('simulator', ['--ros-args', *(w for value in values for w in ('-p', value))])
    from ratslam_ros.offline.compile_all import compile_kernels
    from ratslam_ros.offline.simulate import simulate
    from ratslam_ros.results.writer import link_latest

    config = config_of(options)
    parameters = SimulatorParameters(**given)
    compile_kernels()
    folder = make_folder(results_folder(options, 'simulate'))
    goals = None if options.goals is None else options.goals.split(',')
    print(simulate(
        parameters, config, folder, explore_s=60.0 * options.explore, goals=goals,
        random_goals=options.random_goals, record=options.record, progress=not options.quiet,
        history=not options.no_history,
    ))
    if options.out is None:
        link_latest(folder)
    return DONE
