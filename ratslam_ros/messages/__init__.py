# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads of the topics: encoding and strict decoding."""
