# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the node that shows a live run in a browser."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter

NO_FILE = 'none'
"""Value of `history_file` for a temporary file, removed at the end."""


@dataclass(frozen=True)
class ViewerParameters(Section):
    """The live view in a browser, node `viewer`."""

    host: str = parameter(
        '127.0.0.1', '', 0, 0,
        'Address of the web server. With the default, only browsers on the same machine can '
        'connect.',
        'set to 0.0.0.0 to open the page from another machine; the token in the URL is then sent '
        'over the network without encryption',
        'keep the default if the browser runs on this machine, or comes through an SSH tunnel',
    )  # fmt: skip
    port: int = parameter(
        8080, '', 0, 65535, 'TCP port of the web server; 0: any free one.',
        'another program uses the port', 'another program uses the port')  # fmt: skip
    open_browser: bool = parameter(
        True, '', 0, 1, 'Open the page in a browser if this machine has a desktop.',
        'you watch on this machine', 'the page should only be opened by its URL')  # fmt: skip
    history_file: str = parameter(
        NO_FILE, '', 0, 0,
        'File for the history of the run. With `none` it is a temporary file, and messages are '
        'received only while a browser is connected.',
        'set to a path to record the whole run, and to look at it later with `ratslam view`',
        'keep `none` if nothing is to be kept')  # fmt: skip
