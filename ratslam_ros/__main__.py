# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``python -m ratslam_ros``: the ratslam command."""

import sys

from ratslam_ros.cli import main

sys.exit(main())
