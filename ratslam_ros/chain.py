# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The place of a process in a split, in which the stages run in processes that follow one another.

The first process sorts the inputs. Each passes on a numbered stream, which the next one follows.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass


@dataclass(frozen=True)
class Chain:
    """The place of a process; by default it has no neighbours in a split.

    follows: node of the process whose stream it follows; '' if it sorts its inputs itself.
    is_followed: whether it passes on a stream. scans: topics of the lasers whose scans the first
    process passes on.
    """

    follows: str = ''
    is_followed: bool = False
    scans: tuple[str, ...] = ()


ALONE = Chain()
"""The place of a process without neighbours in a split."""


def add_chain(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a process."""
    parser.add_argument('--follows', default='', metavar='NODE',
                        help='take everything from the stream of the process of this node')
    parser.add_argument('--followed', nargs='?', const='', metavar='SCAN_A,SCAN_B',
                        help='pass on a stream, with the scans of these topics')


def chain_of(options: argparse.Namespace) -> Chain:
    """Return the place that the arguments name."""
    scans = tuple((options.followed or '').split(','))
    return Chain(options.follows, options.followed is not None, tuple(filter(None, scans)))
