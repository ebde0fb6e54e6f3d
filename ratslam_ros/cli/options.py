# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Options shared by several commands, and helpers to evaluate them."""

from __future__ import annotations

import argparse
import itertools
import tempfile
import time
from collections.abc import Container
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from ratslam_ros.console import print_notice, print_notices
from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableInput
from ratslam_ros.limits import IMAGES_RATE_HZ
from ratslam_ros.own_stages import add_stage

RESULTS = {'frames.csv', 'history.sqlite', 'map.json', 'summary.json', 'tuned.yaml'}
"""Files by which a folder is known to have results of a run."""


class Parser(argparse.ArgumentParser):
    """Argument parser that reports wrong use in one line."""

    def parse_known_args(  # type: ignore[no-untyped-def]
        self, args=None, namespace=None
    ):
        """Parse arguments; report unknown ones here, because only this parser has their command.

        Argparse would leave those of a command to the parser of all commands.
        """
        namespace, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f'unrecognized arguments: {" ".join(unknown)}')
        return namespace, unknown

    def error(self, message: str) -> NoReturn:
        """Raise UnusableInput with a pointer to the help text."""
        raise UnusableInput(f'{message}; see {self.prog} --help')


if TYPE_CHECKING:
    from ratslam_ros.results.trajectory import Trajectory

    Commands = argparse._SubParsersAction[Parser]
else:
    Commands = argparse._SubParsersAction  # has no subscript at run time


def add_recording(
    parser: argparse.ArgumentParser, metavar: str = 'RECORDING', alternative: str = ''
) -> None:
    """Add the recording, or another thing that may take its place, and options for reading it."""
    parser.add_argument('recording', type=Path, metavar=metavar,
                        help='rosbag2 folder or file, ROS 1 bag, video, or folder of images'
                             + alternative)
    parser.add_argument('--images-rate', type=float, default=IMAGES_RATE_HZ, metavar='HZ',
                        help='frame rate of a folder of images without time stamps '
                             f'(default: {IMAGES_RATE_HZ:g})')


def add_topics(parser: argparse.ArgumentParser) -> None:
    """Add the topics to read from a recording."""
    parser.add_argument('--image-topic', metavar='T',
                        help='camera topic (default: the only one)')
    parser.add_argument('--odom-topic', metavar='T',
                        help='odometry topic (default: the only one)')


def add_config(parser: argparse.ArgumentParser, default: str | None = None) -> None:
    """Add the configuration, and single parameters that override it."""
    parser.add_argument('--config', metavar='FILE|PRESET', default=default,
                        help='YAML, an INI file of OpenRatSLAM, or the name of a preset '
                             f'(default: {default or "default"})')
    parser.add_argument('--set', action='append', default=[], dest='settings',
                        metavar='section.name=value', help='one parameter; may be repeated')


def add_span(parser: argparse.ArgumentParser) -> None:
    """Add the part of a recording to use."""
    parser.add_argument('--start', type=float, default=0.0, metavar='S',
                        help='skip the first S seconds of the recording')
    parser.add_argument('--duration', type=float, metavar='S',
                        help='stop after S seconds of the recording')


def add_replay_options(
    parser: argparse.ArgumentParser, metavar: str = 'RECORDING', alternative: str = ''
) -> None:
    """Add the recording, and the options that change what is made of it."""
    add_recording(parser, metavar, alternative)
    add_config(parser)
    add_stage(parser)
    parser.add_argument('--no-inspect', action='store_true',
                        help='without --config: do not inspect the recording before the replay')
    add_topics(parser)
    parser.add_argument('--scan-topic', metavar='T',
                        help='laser topic, read if experience_map.exp_align_scans is set or '
                             'with --landmarks; several: T,T in the order of scan_topics')
    parser.add_argument('--landmarks', action='store_true',
                        help='also map corners and edges of walls: landmarks.json')
    parser.add_argument('--visual-odometry', action='store_true',
                        help='estimate odometry from the camera, even if there is an odometry '
                             'topic')
    add_span(parser)
    parser.add_argument('--truth', type=Path, metavar='FILE.tum',
                        help='true trajectory, for the plot and the errors')


def add_out(parser: argparse.ArgumentParser, default: str) -> None:
    """Add the folder for results."""
    parser.add_argument('--out', type=Path, metavar='DIR',
                        help=f'folder for the results (default: {default})')
    parser.add_argument('--overwrite', action='store_true',
                        help='replace earlier results in that folder (default: write to DIR-2, '
                             'DIR-3, ...)')


def add_view_options(parser: argparse.ArgumentParser, always: bool = False) -> None:
    """Add the options of the web server, and ``--view`` unless the command always shows a run."""
    if not always:
        parser.add_argument('--view', action='store_true', help='show the run in a browser')
    parser.add_argument('--host', metavar='ADDRESS',
                        help='address for the browser to connect to; others than this machine '
                             'can connect to 0.0.0.0 (default: 127.0.0.1)')
    parser.add_argument('--port', type=int, metavar='P',
                        help='port for the browser to connect to; 0: any free one (default: 8080)')
    parser.add_argument('--no-browser', action='store_false', dest='browser',
                        help='print the address, and open no browser')


def add_ros_args(parser: argparse.ArgumentParser) -> None:
    """Add arguments in the form that ROS 2 nodes take."""
    parser.add_argument('--ros-args', nargs=argparse.REMAINDER, default=[], metavar='...',
                        help='pass the rest to ROS, such as -r image:=/camera/image -r __ns:=/b')


def words_of(
    parser: argparse.ArgumentParser, options: argparse.Namespace, without: Container[str] = ()
) -> list[str]:
    """Return arguments that a parser would parse into these options, as for a child process.

    Args:
        parser: the parser of the command.
        options: its options.
        without: names of options to leave out.
    """
    words: list[str] = []
    for action in parser._actions:
        value = getattr(options, action.dest, None)
        if action.dest in without or value in (None, action.default):
            continue
        if not action.option_strings:
            words.append(str(value))
        elif action.nargs == 0:
            words.append(action.option_strings[-1])
        else:
            values = value if isinstance(value, list) else [value]
            words += [f'{action.option_strings[-1]}={item}' for item in values]
    return words


def whole_number(text: str) -> int:
    """Parse an integer of 0 or more."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f'{text!r} is not a whole number of 0 or more')
    return int(text)


def positive_number(text: str) -> int:
    """Parse an integer of 1 or more."""
    if whole_number(text) == 0:
        raise argparse.ArgumentTypeError('0 is not a number of 1 or more')
    return int(text)


def positive(text: str) -> float:
    """Parse a number of more than 0."""
    value = float(text)
    if not 0.0 < value < float('inf'):
        raise argparse.ArgumentTypeError(f'{text} is not a number of more than 0')
    return value


def config_of(options: argparse.Namespace) -> Config:
    """Return the configuration that ``--config`` and ``--set`` select; print its notices."""
    from ratslam_ros.files.config import load_config, parse_setting

    config, notices = load_config(options.config)
    print_notices(notices)
    return config.with_values(dict(parse_setting(text) for text in options.settings))


def results_folder(options: argparse.Namespace, name: str) -> Path:
    """Return the folder for results: ``--out``, or one named after the run and the time.

    Unless ``--overwrite`` is given, a folder with earlier results gets a number. The folder is
    not created, but a file can be written there.

    Raises:
        UnusableInput: the folder has other contents, or cannot be written to.
    """
    folder = options.out or Path('results') / f'{name}-{time.strftime("%Y%m%d-%H%M%S")}'
    has_results = _has_results(folder)
    if has_results and not options.overwrite:
        earlier, folder = folder, numbered(folder)
        print_notice(f'{earlier} has the results of an earlier run; the new ones are written to '
                     f'{folder} (--overwrite replaces the earlier ones)')
    existing = folder.absolute()
    while not existing.exists():
        existing = existing.parent
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise _unwritable(folder, error) from None
    return folder


def numbered(folder: Path, number: int = 2) -> Path:
    """Return the first of folder-2, folder-3, ... that has no results.

    Args:
        folder: the folder to which the number is appended.
        number: the first number to try.
    """
    folder = folder if folder.name not in ('', '..') else folder.resolve()
    return next(one for one in (Path(f'{folder}-{n}') for n in itertools.count(number))
                if not _has_results(one))


def _has_results(folder: Path) -> bool:
    """Return whether a folder has files of an earlier run; raise if it has only other ones."""
    try:
        names = sorted(path.name for path in folder.iterdir())
    except FileNotFoundError:
        return False
    except OSError as error:
        raise _unwritable(folder, error) from None
    if names and not {name.removesuffix('.part') for name in names} & RESULTS:
        raise UnusableInput(
            f'{folder} has {names[0]}{", ..." if len(names) > 1 else ""}, which no run has '
            'written; expected a new or empty folder as --out'
        )
    return bool(names)


def _unwritable(folder: Path, error: OSError) -> UnusableInput:
    return UnusableInput(
        f'{folder} cannot be written to ({error.strerror}); give another --out'
    )


def make_folder(folder: Path) -> Path:
    """Create a folder; raises UnusableInput if that is impossible."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(folder, error) from None
    return folder


def read_truth(path: Path | None) -> Trajectory | None:
    """Read the true trajectory; callers do so first, so that a wrong file costs no time."""
    if path is None:
        return None
    from ratslam_ros.results.trajectory import read_tum

    return read_tum(path)
