# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The place of a process in a split, in which the stages run in processes that follow one another.

The first process sorts the inputs. Each passes on a numbered stream, which the next one follows.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

from ratslam_ros.core.config import Config

BASE_FRAME = Config().experience_map.base_frame


@dataclass(frozen=True)
class Chain:
    """The place of a process; by default it has no neighbours in a split.

    follows: node of the process whose stream it follows; '' if it sorts its inputs itself.
    is_followed: whether it passes on a stream. scans: topics of the lasers whose scans the first
    process passes on. base_frame: frame of the robot for them, as that of experience_map.
    """

    follows: str = ''
    is_followed: bool = False
    scans: tuple[str, ...] = ()
    base_frame: str = BASE_FRAME


ALONE = Chain()
"""The place of a process without neighbours in a split."""


def add_chain(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a process."""
    parser.add_argument('--follows', default='', metavar='NODE',
                        help='take everything from the stream of the process of this node')
    parser.add_argument('--followed', action='store_true', help='pass on a stream')
    parser.add_argument('--scans', default='', metavar='A,B',
                        help='topics of the lasers whose scans are passed on')
    parser.add_argument('--base-frame', default=BASE_FRAME, metavar='F',
                        help='base_frame of experience_map, for the scans')


def chain_of(options: argparse.Namespace) -> Chain:
    """Return the place that the arguments name."""
    scans = tuple(filter(None, options.scans.split(',')))
    return Chain(options.follows, options.followed, scans, options.base_frame)


def chain_arguments(
    processes: Sequence[Sequence[str]], number: int, scans: Sequence[str]
) -> list[str]:
    """Return the arguments of one of the processes of a split.

    Args:
        processes: the stages of each process, in the direction of flow.
        number: index of the process.
        scans: further arguments of a process that receives scans.
    """
    arguments: list[str] = []
    if number > 0:
        arguments += ['--follows', processes[number - 1][-1]]
    if number < len(processes) - 1:
        arguments += ['--followed', *(scans if number == 0 else ())]
    return arguments
