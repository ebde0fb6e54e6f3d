# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The browser of the desktop, if there is one."""

from __future__ import annotations

import atexit
import os
import sys
import tempfile
import threading
import webbrowser
from html import escape
from pathlib import Path

from ratslam_ros.console import print_notice


def open_browser(url: str) -> None:
    """Open a page in the user's browser, in a thread, if this machine has a desktop."""
    if has_desktop():
        threading.Thread(target=_open, args=(url,), name='browser', daemon=True).start()


def has_desktop() -> bool:
    """Return whether a browser would appear on a screen of this machine.

    Without a desktop, the module webbrowser would start a browser in the terminal.
    """
    if sys.platform in ('darwin', 'win32'):
        return True
    return bool(os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY'))


def _open(url: str) -> None:
    """Open a page by a file that refers to it: users of this machine see a browser's arguments."""
    try:
        # In the home folder: a browser installed as a snap reads neither /tmp nor hidden folders.
        handle, name = tempfile.mkstemp('.html', 'ratslam-view-', Path.home())  # mode 0600
        atexit.register(Path(name).unlink, missing_ok=True)
        with open(handle, 'w', encoding='utf-8') as file:
            file.write(f'<meta http-equiv="refresh" content="0; url={escape(url)}">\n')
        is_open = webbrowser.open(Path(name).as_uri())
    except OSError:
        is_open = False
    if not is_open:
        print_notice('no browser could be opened; open the address above in one')
