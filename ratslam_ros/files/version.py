# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The version of this package, as files record it."""

from ratslam_ros.version import __version__


def package_version() -> str:
    """Return the version of the code that runs, whether it is installed or not."""
    return __version__
