# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Requests and responses of the services that are known; the type store has messages only."""

from __future__ import annotations

SERVICES = {
    'diagnostic_msgs/srv/AddDiagnostics': (
        'string load_namespace',
        'bool success\nstring message',
    ),
    'diagnostic_msgs/srv/SelfTest': (
        '',
        'string id\nbyte passed\nDiagnosticStatus[] status',
    ),
    'nav_msgs/srv/GetMap': (
        '',
        'OccupancyGrid map',
    ),
    'nav_msgs/srv/GetPlan': (
        'geometry_msgs/PoseStamped start\ngeometry_msgs/PoseStamped goal\nfloat32 tolerance',
        'Path plan',
    ),
    'nav_msgs/srv/LoadMap': (
        'string map_url',
        'uint8 RESULT_SUCCESS=0\nuint8 RESULT_MAP_DOES_NOT_EXIST=1\n'
        'uint8 RESULT_INVALID_MAP_DATA=2\nuint8 RESULT_INVALID_MAP_METADATA=3\n'
        'uint8 RESULT_UNDEFINED_FAILURE=255\nOccupancyGrid map\nuint8 result',
    ),
    'nav_msgs/srv/SetMap': (
        'OccupancyGrid map\ngeometry_msgs/PoseWithCovarianceStamped initial_pose',
        'bool success',
    ),
    'rcl_interfaces/srv/DescribeParameters': (
        'string[] names',
        'ParameterDescriptor[] descriptors',
    ),
    'rcl_interfaces/srv/GetParameterTypes': (
        'string[] names',
        'uint8[] types',
    ),
    'rcl_interfaces/srv/GetParameters': (
        'string[] names',
        'ParameterValue[] values',
    ),
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
    'sensor_msgs/srv/SetCameraInfo': (
        'CameraInfo camera_info',
        'bool success\nstring status_message',
    ),
    'std_srvs/srv/Empty': ('', ''),
    'std_srvs/srv/SetBool': (
        'bool data',
        'bool success\nstring message',
    ),
    'std_srvs/srv/Trigger': (
        '',
        'bool success\nstring message',
    ),
    'tf2_msgs/srv/FrameGraph': (
        '',
        'string frame_yaml',
    ),
}
"""The two halves of each .srv file, without comments."""
