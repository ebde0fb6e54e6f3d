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
        '127.0.0.1',
        'Address of the web server. With the default, only browsers on the same machine can '
        'connect.',
        raise_if='set to 0.0.0.0 to open the page from another machine; the token in the URL is '
        'then sent over the network without encryption',
        lower_if='keep the default if the browser runs on this machine, or comes through an SSH '
        'tunnel',
    )
    port: int = parameter(
        8080, 'TCP port of the web server; 0: any free one.', low=0, high=65535,
        raise_if='another program uses the port', lower_if='another program uses the port',
    )
    open_browser: bool = parameter(
        True, 'Open the page in a browser if this machine has a desktop.',
        raise_if='you watch on this machine', lower_if='the page should only be opened by its URL',
    )
    history_file: str = parameter(
        NO_FILE,
        'File for the history of the run. With `none` it is a temporary file, and messages are '
        'received only while a browser is connected.',
        low=0, high=0,
        raise_if='set to a path to record the whole run, and to look at it later with `ratslam '
        'view`',
        lower_if='keep `none` if nothing is to be kept',
    )
