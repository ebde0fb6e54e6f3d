# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the user's browser is opened."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

URL = 'http://127.0.0.1:8080/secret-token/'
OPEN = f"""
from threading import enumerate
from ratslam_ros.viewer.desktop import open_browser
open_browser({URL!r})
[one.join() for one in enumerate() if one.name == 'browser']
"""
BROWSER = """#!/bin/sh
echo "$@"
stat --format %a "${1#file://}"
cat "${1#file://}"
"""


def test_browser_is_opened_without_token_in_arguments(tmp_path: Path) -> None:
    browser = tmp_path / 'browser'
    browser.write_text(BROWSER)
    browser.chmod(0o755)
    environment = {**os.environ, 'DISPLAY': ':0', 'HOME': str(tmp_path), 'BROWSER': str(browser)}
    arguments, *file = subprocess.run(
        [sys.executable, '-c', OPEN], env=environment, check=True, stdout=subprocess.PIPE,
        text=True,
    ).stdout.splitlines()
    assert 'secret-token' not in arguments
    assert file == ['600', f'<meta http-equiv="refresh" content="0; url={URL}">']
    assert list(tmp_path.iterdir()) == [browser]  # the file is removed at the end
