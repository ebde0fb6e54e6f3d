# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The nodes of RatSLAM, and a recording that is played to them in place of a robot.

All arguments of ratslam.launch.py are arguments of this file too.
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    IncludeLaunchDescription,
    LogInfo,
    OpaqueFunction,
    Shutdown,
)
from launch.events.process import ProcessExited
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from ratslam_ros.live.launch import remappings

YES_OR_NO = ['true', 'false']
NODES = Path(__file__).with_name('ratslam.launch.py')

ARGUMENTS = [
    DeclareLaunchArgument(
        'recording',
        description='rosbag2 folder or file, ROS 1 bag, video, or folder of images'),
    DeclareLaunchArgument(
        'rate', default_value='1.0', description='speed; 0: as fast as possible'),
    DeclareLaunchArgument(
        'clock', default_value='false', choices=YES_OR_NO,
        description="publish the recording's time on /clock, and have the nodes use it"),
    DeclareLaunchArgument(
        'loop', default_value='false', choices=YES_OR_NO, description='again and again'),
    DeclareLaunchArgument(
        'lockstep', default_value='false', choices=YES_OR_NO,
        description='wait until each image has been acted on'),
    DeclareLaunchArgument(
        'start', default_value='0.0', description='skip so many seconds of the recording'),
    DeclareLaunchArgument(
        'duration', default_value='', description='stop after so many seconds (empty: at the end)'
    ),
    DeclareLaunchArgument(
        'recorded_image_topic', default_value='',
        description='which images of the recording (empty: where there is no choice)'),
    DeclareLaunchArgument(
        'recorded_odom_topic', default_value='',
        description='which odometry of the recording (empty: where there is no choice)'),
    DeclareLaunchArgument(
        'recorded_scan_topic', default_value='',
        description='which scans of the recording, for exp_align_scans (empty: none)'),
    DeclareLaunchArgument(
        'wait', default_value='30.0',
        description='wait so many seconds for the nodes; their first start compiles for a while'),
    DeclareLaunchArgument(
        'shutdown', default_value='false', choices=YES_OR_NO,
        description='end everything when the recording has been played'),
]  # fmt: skip


def generate_launch_description() -> LaunchDescription:
    """Return what is launched; every argument has a description (--show-args)."""
    nodes = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(NODES)),
        launch_arguments={'use_sim_time': LaunchConfiguration('clock')}.items(),
    )
    return LaunchDescription([*ARGUMENTS, nodes, OpaqueFunction(function=_play)])


def _play(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    arguments = ['play', given('recording'), '--quiet']
    for name in ('rate', 'start', 'wait'):
        arguments += [f'--{name}', given(name)]
    for option, name in (
        ('duration', 'duration'),
        ('image-topic', 'recorded_image_topic'),
        ('odom-topic', 'recorded_odom_topic'),
        ('scan-topic', 'recorded_scan_topic'),
    ):
        if given(name):
            arguments += [f'--{option}', given(name)]
    for name in ('clock', 'loop', 'lockstep', 'visual_odometry'):
        if given(name) == 'true':
            arguments.append('--' + name.replace('_', '-'))

    def done(event: ProcessExited, context: LaunchContext) -> list[LaunchDescriptionEntity]:
        if event.returncode:
            return [Shutdown(reason='the recording cannot be played')]
        if given('shutdown') == 'true':
            return [Shutdown(reason='the recording has been played')]
        return [LogInfo(msg='the recording has been played; Ctrl-C ends the nodes')]

    player = Node(
        package='ratslam_ros',
        executable='ratslam',
        namespace=given('namespace'),
        arguments=arguments,
        remappings=remappings(*(given(f'{name}_topic') for name in ('image', 'odom', 'scan'))),
        output='screen',
        on_exit=done,
    )
    return [player]
