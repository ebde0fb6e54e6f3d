# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The version of this package; setup.py reads it here."""

__version__ = '0.1.0'
