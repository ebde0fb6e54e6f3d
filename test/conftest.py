# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import sys
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))  # for helpers.py, in every import mode of pytest

# The same examples at every run, and no limit on the first one's time, which may compile.
settings.register_profile('ratslam', deadline=None, derandomize=True, print_blob=True)
settings.load_profile('ratslam')
