# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``python -m ratslam_ros``: the ratslam command."""

import signal
import sys

# Until the command runs, Ctrl-C ends the process by the signal, without a traceback of imports.
handler = signal.getsignal(signal.SIGINT)
if handler is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from ratslam_ros.cli import main  # noqa: E402

signal.signal(signal.SIGINT, handler)
sys.exit(main())
