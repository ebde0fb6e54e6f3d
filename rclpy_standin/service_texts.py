# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Definitions of the supported services; the type store of rosbags has messages only."""

from __future__ import annotations

SERVICES = {
    'nav_msgs/srv/GetPlan': (
        'geometry_msgs/PoseStamped start\ngeometry_msgs/PoseStamped goal\nfloat32 tolerance',
        'Path plan',
    ),
    'rcl_interfaces/srv/DescribeParameters': (
        'string[] names',
        'ParameterDescriptor[] descriptors',
    ),
    'rcl_interfaces/srv/GetParameterTypes': ('string[] names', 'uint8[] types'),
    'rcl_interfaces/srv/GetParameters': ('string[] names', 'ParameterValue[] values'),
    'rcl_interfaces/srv/ListParameters': (
        'uint64 DEPTH_RECURSIVE=0\nstring[] prefixes\nuint64 depth',
        'ListParametersResult result',
    ),
    'rcl_interfaces/srv/SetParameters': (
        'Parameter[] parameters',
        'SetParametersResult[] results',
    ),
    'rcl_interfaces/srv/SetParametersAtomically': (
        'Parameter[] parameters',
        'SetParametersResult result',
    ),
    'std_srvs/srv/Empty': ('', ''),
    'std_srvs/srv/SetBool': ('bool data', 'bool success\nstring message'),
    'std_srvs/srv/Trigger': ('', 'bool success\nstring message'),
}
"""Request and response part of each .srv file, without comments."""
