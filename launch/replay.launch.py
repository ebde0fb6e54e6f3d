# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Launch file: the nodes of RatSLAM, and a recording played to them in place of a robot.

It has all arguments of ratslam.launch.py too.
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

from ratslam_ros.live.launch import ending, remappings
from ratslam_ros.pipeline.choice import CAMERA

YES_OR_NO = ['true', 'false']
NODES = Path(__file__).with_name('ratslam.launch.py')

ARGUMENTS = [
    DeclareLaunchArgument(
        'recording',
        description='rosbag2 folder or file, ROS 1 bag, video, or folder of images'),
    DeclareLaunchArgument(
        'rate', default_value='1.0', description='playback speed; 0: as fast as possible'),
    DeclareLaunchArgument(
        'clock', default_value='false', choices=YES_OR_NO,
        description="publish the recording's time on /clock; the nodes use it unless "
        'use_sim_time is false'),
    DeclareLaunchArgument(
        'use_sim_time', default_value=LaunchConfiguration('clock'), choices=YES_OR_NO,
        description='use the time on /clock (default: as clock); without clock, another node has '
        'to publish it'),
    DeclareLaunchArgument(
        'loop', default_value='false', choices=YES_OR_NO,
        description='repeat the recording until interrupted'),
    DeclareLaunchArgument(
        'lockstep', default_value='false', choices=YES_OR_NO,
        description='wait for the action of each image before playing on'),
    DeclareLaunchArgument(
        'start', default_value='0.0', description='seconds to skip at the start of the recording'),
    DeclareLaunchArgument(
        'duration', default_value='', description='seconds to play (empty: to the end)'
    ),
    DeclareLaunchArgument(
        'recorded_image_topic', default_value='',
        description='recorded topic of the images (empty: the only one)'),
    DeclareLaunchArgument(
        'recorded_odom_topic', default_value='',
        description='recorded topic of the odometry (empty: the only one)'),
    DeclareLaunchArgument(
        'recorded_scan_topic', default_value='',
        description='recorded topic of the scans, for exp_align_scans (empty: none)'),
    DeclareLaunchArgument(
        'wait', default_value='30.0',
        description='seconds to wait for the nodes, which compile at their first start'),
    DeclareLaunchArgument(
        'shutdown', default_value='false', choices=YES_OR_NO,
        description='end all nodes when the recording has been played'),
]


def generate_launch_description() -> LaunchDescription:
    """Return the launch description; --show-args prints its arguments."""
    nodes = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(NODES)),
        launch_arguments={'use_sim_time': LaunchConfiguration('use_sim_time')}.items(),
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
    for name in ('clock', 'loop', 'lockstep'):
        if given(name) == 'true':
            arguments.append(f'--{name}')
    if given('odometry') == CAMERA:
        arguments.append('--visual-odometry')

    def done(event: ProcessExited, context: LaunchContext) -> list[LaunchDescriptionEntity]:
        if event.returncode and not context.is_shutdown:
            raise RuntimeError(f'the recording cannot be played: {ending(event.returncode)}')
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
