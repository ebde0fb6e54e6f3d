# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ``ratslam`` command: its sub-commands, and the exit codes of errors."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from ratslam_ros import __version__
from ratslam_ros.cli.camera_command import add_camera
from ratslam_ros.cli.installation_commands import add_doctor, add_warm_up
from ratslam_ros.cli.live_commands import add_live
from ratslam_ros.cli.map_command import add_map
from ratslam_ros.cli.options import Parser
from ratslam_ros.cli.recording_commands import add_info, add_replay, add_tune
from ratslam_ros.cli.result_commands import add_evaluate, add_plot
from ratslam_ros.cli.simulation_commands import add_demo, add_simulate
from ratslam_ros.cli.study_command import add_study
from ratslam_ros.cli.view_command import add_view
from ratslam_ros.console import print_notice
from ratslam_ros.errors import (
    DISK_FULL_ERRORS,
    DONE,
    INTERRUPTED,
    NO_ANSWER,
    UNUSABLE,
    NoAnswer,
    RatslamError,
    missing_package,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return its exit code.

    0 success, 1 a fault of the program, 2 unusable input or wrong use, 130 interrupted.
    """
    if sys.stderr is None:  # it is closed, as by 2>&-
        sys.stderr = Path(os.devnull).open('w', encoding='utf-8')  # noqa: SIM115 - until the end
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # raises KeyboardInterrupt
    try:
        options = parser().parse_args(arguments)
        return int(options.run(options))
    except RatslamError as error:
        print_notice(f'ratslam: {error}')
        return UNUSABLE
    except NoAnswer as reason:
        print_notice(f'ratslam: {reason}')
        return NO_ANSWER
    except ModuleNotFoundError as error:
        print_notice(f'ratslam: {missing_package(error)}')
        return UNUSABLE
    except (KeyboardInterrupt, SystemError) as error:
        # Compiled code makes a SystemError of an interrupt.
        if not isinstance(error.__cause__ or error, KeyboardInterrupt):
            raise
        print_notice('ratslam: interrupted')
        return INTERRUPTED
    except BrokenPipeError:  # as in `ratslam info X | head`
        sys.stderr.close()
        return DONE
    except OSError as error:
        if error.errno not in DISK_FULL_ERRORS:
            raise
        where = 'while writing' if error.filename is None else f'while writing {error.filename}'
        print_notice(
            f'ratslam: {error.strerror} {where}; free some space, or give another --out'
        )
        return UNUSABLE


def parser() -> Parser:
    """Return the parser of the whole command line."""
    top = Parser(prog='ratslam', description='RatSLAM: from a recording to a map.')
    top.add_argument('--version', action='version', version=f'ratslam {__version__}')
    commands = top.add_subparsers(title='commands', metavar='COMMAND', required=True)
    add_info(commands)
    add_replay(commands)
    add_view(commands)
    add_camera(commands)
    add_map(commands)
    add_demo(commands)
    add_simulate(commands)
    add_evaluate(commands)
    add_plot(commands)
    add_tune(commands)
    add_study(commands)
    add_live(commands)
    add_warm_up(commands)
    add_doctor(commands)
    return top
