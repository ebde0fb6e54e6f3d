# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import os
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # Makes fabricate.py importable.


@pytest.fixture
def data() -> Path:
    """Return the folder of real recordings, which are not part of this repository."""
    default = Path(__file__).parents[3] / 'shared' / 'data'
    folder = Path(os.environ.get('RATSLAM_DATA', default))
    if not folder.is_dir():
        pytest.skip(f'the real recordings are missing: {folder} does not exist; set RATSLAM_DATA')
    return folder
