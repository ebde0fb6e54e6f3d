# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The browser of the desktop, if there is one."""

from __future__ import annotations

import os
import sys
import threading
import webbrowser

from ratslam_ros.console import print_notice


def open_browser(url: str) -> bool:
    """Open a page in the user's browser, in a thread, if this machine has a desktop.

    Returns:
        Whether there is a desktop.
    """
    if not has_desktop():
        return False
    threading.Thread(target=_open, args=(url,), name='browser', daemon=True).start()
    return True


def has_desktop() -> bool:
    """Return whether a browser would appear on a screen of this machine.

    Without a desktop, the module webbrowser would start a browser in the terminal.
    """
    if sys.platform in ('darwin', 'win32'):
        return True
    return bool(os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY'))


def _open(url: str) -> None:
    if not webbrowser.open(url):
        print_notice('no browser could be opened; open the address above in one')
