# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The version of this package, as files record it."""

from importlib.metadata import PackageNotFoundError, version


def package_version() -> str:
    """Return the version of this package, '' if it is not installed."""
    try:
        return version('ratslam_ros')
    except PackageNotFoundError:
        return ''
