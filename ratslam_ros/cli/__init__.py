# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ``ratslam`` command."""

from ratslam_ros.cli.main import main

__all__ = ['main']
