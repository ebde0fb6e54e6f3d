# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import sys
from pathlib import Path

import pytest
from helpers import real_recordings

sys.path.insert(0, str(Path(__file__).parent))  # Makes fabricate.py importable.


@pytest.fixture
def data() -> Path:
    """Return the folder of real recordings, which are not part of this repository."""
    return real_recordings()
