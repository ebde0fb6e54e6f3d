# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Launch file: the nodes of RatSLAM on the topics of a robot, optionally with RViz."""

import shutil
import tempfile
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnShutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from ratslam_ros.errors import RatslamError
from ratslam_ros.files.config import load_config, to_yaml
from ratslam_ros.live.launch import (
    MANAGED,
    OPTIONAL,
    ending_launch,
    nodes,
    remappings,
    used_scans,
    with_map,
)
from ratslam_ros.pipeline.choice import DEFAULT, ODOMETRY, TOPIC
from ratslam_ros.supervision import PAUSE_S

YES_OR_NO = ['true', 'false']

ARGUMENTS = [
    DeclareLaunchArgument(
        'config', default_value='default',
        description='parameters: name of a preset, a YAML file, or an INI file of OpenRatSLAM',
    ),
    DeclareLaunchArgument(
        'namespace', default_value='', description='namespace of the nodes and their topics'),
    DeclareLaunchArgument(
        'use_sim_time', default_value='false', choices=YES_OR_NO,
        description='use the time on /clock'),
    DeclareLaunchArgument(
        'odometry', default_value=TOPIC, choices=[*ODOMETRY],
        description='topic: the robot publishes odometry; camera: it is estimated from images; '
        'auto: decide when images have a publisher: the camera if odom has none 2 s later'),
    DeclareLaunchArgument(
        'stages', default_value=DEFAULT,
        description='the mapping nodes to start; nodes of your own take the place of the others'),
    DeclareLaunchArgument(
        'own_stages', default_value='',
        description='stages of your own as FILE.py:CLASS or MODULE:CLASS, separated by commas'),
    DeclareLaunchArgument(
        'split', default_value='false', choices=YES_OR_NO,
        description='true: one process for each mapping node; false: one process for all'),
    DeclareLaunchArgument(
        'goal_follower', default_value='false', choices=YES_OR_NO,
        description='drive to goals by a laser scan; false if Nav2 or another node drives'),
    DeclareLaunchArgument(
        'nav2', default_value='false', choices=YES_OR_NO,
        description='have the controller server of Nav2 drive along the routes (route_to_nav2)'),
    DeclareLaunchArgument(
        'route_server', default_value='false', choices=YES_OR_NO,
        description='keep the graph of the route server of Nav2 up to date (route_server_graph)'),
    DeclareLaunchArgument(
        'landmarks', default_value='false', choices=YES_OR_NO,
        description='map corners and edges of walls by a laser scan (landmark_map)'),
    DeclareLaunchArgument(
        'image_topic', default_value='image',
        description="the camera's topic, raw or .../compressed; each is derived from the other"),
    DeclareLaunchArgument(
        'odom_topic', default_value='odom',
        description='topic of the odometry, nav_msgs/Odometry'),
    DeclareLaunchArgument(
        'scan_topic', default_value='scan',
        description='topic of the laser, sensor_msgs/LaserScan; for driving, landmarks and '
        'exp_align_scans'),
    DeclareLaunchArgument(
        'cmd_vel_topic', default_value='cmd_vel',
        description='topic of the motors, geometry_msgs/Twist; for goal_follower'),
    DeclareLaunchArgument(
        'image_transport', default_value='', choices=['', 'auto', 'raw', 'compressed'],
        description='images to subscribe to (empty: image_transport of the parameters)'),
    DeclareLaunchArgument(
        'publish_tf', default_value='', choices=['', *YES_OR_NO],
        description='publish the transform map -> odom (empty: publish_tf of the parameters)'),
    DeclareLaunchArgument(
        'map', default_value='',
        description='file in which the map is saved while mapping, and from which it is continued '
        '(empty: in memory only); nodes that are killed are then started again'),
    DeclareLaunchArgument(
        'localize', default_value='false', choices=YES_OR_NO,
        description='true: only localise in the map file, which stays unchanged'),
    DeclareLaunchArgument(
        'keep_log', default_value='false', choices=YES_OR_NO,
        description='true: keep everything that is received beside the map file, so that ratslam '
        'replay MAP --log repeats the run; it grows without a limit'),
    DeclareLaunchArgument(
        'viewer', default_value='false', choices=YES_OR_NO,
        description='show the run in a browser; its address is printed (docs/ros.md)'),
    DeclareLaunchArgument(
        'rviz', default_value='false', choices=YES_OR_NO,
        description='start RViz; its layout uses the topics of the root namespace'),
    DeclareLaunchArgument(
        'lifecycle', default_value='false', choices=YES_OR_NO,
        description='true: managed nodes, with the states of the ROS 2 life cycle'),
    DeclareLaunchArgument(
        'autostart', default_value='true', choices=YES_OR_NO,
        description='managed nodes configure and activate themselves; false: another node does'),
    DeclareLaunchArgument(
        'log_level', default_value='info', choices=['debug', 'info', 'warn', 'error', 'fatal'],
        description='lowest severity that the nodes log'),
]


def generate_launch_description() -> LaunchDescription:
    """Return the launch description; --show-args prints its arguments."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=_start)])


def _start(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    text, notices, scans = _parameters(
        given('config'), given('image_transport'), given('publish_tf'), given('map'),
        given('localize') == 'true', given('keep_log') == 'true',
    )
    commands = nodes(
        given('stages'), given('odometry'),
        *(given(name) == 'true'
          for name in ('split', 'goal_follower', 'landmarks', 'viewer', 'nav2', 'route_server')),
        own_stages=[one for one in given('own_stages').split(',') if one], scans=scans,
    )
    folder = Path(tempfile.mkdtemp(prefix='ratslam-'))
    parameters = folder / 'parameters.yaml'
    parameters.write_text(text, encoding='utf-8')
    use_sim_time = given('use_sim_time') == 'true'
    states = ['--lifecycle', *(['--autostart'] if given('autostart') == 'true' else [])]
    managed = MANAGED if given('lifecycle') == 'true' else frozenset()
    started = [
        Node(
            package='ratslam_ros',
            executable=name,
            namespace=given('namespace'),
            arguments=[*arguments, *(states if name in managed else [])],
            parameters=[str(parameters), {'use_sim_time': use_sim_time}],
            remappings=remappings(*(
                given(f'{name}_topic') for name in ('image', 'odom', 'scan', 'cmd_vel')
            )),
            ros_arguments=['--log-level', given('log_level')],
            output='screen',
            # With a map file, a node that is started again continues from there.
            respawn=bool(given('map')),
            respawn_delay=PAUSE_S,
            # The nodes are useless without one another, and would map incompletely.
            on_exit=(
                None if name in OPTIONAL else ending_launch(name, is_restarted=bool(given('map')))
            ),
        )
        for name, arguments in commands.items()
    ]
    remove_folder = OnShutdown(on_shutdown=lambda event, context: shutil.rmtree(folder, True))
    rviz = _rviz(use_sim_time) if given('rviz') == 'true' else []
    logged = [LogInfo(msg=notice) for notice in notices]
    return [*logged, RegisterEventHandler(remove_folder), *started, *rviz]


def _parameters(
    config: str, image_transport: str, publish_tf: str, map_file: str, localize: bool,
    keep_log: bool,
) -> tuple[str, list[str], str]:
    """Return the parameters of all nodes as the text of one file, notices, and used scans."""
    try:
        values, notices = load_config(config)
        changes: dict[str, str | bool] = {}
        if image_transport:
            changes['inputs.image_transport'] = image_transport
        if publish_tf:
            changes['experience_map.publish_tf'] = publish_tf == 'true'
        changed = with_map(values.with_values(changes), map_file, localize, keep_log)
        return to_yaml(changed), notices, used_scans(changed)
    except RatslamError as error:
        raise RuntimeError(str(error)) from None  # launch shows it in one line


def _rviz(use_sim_time: bool) -> list[LaunchDescriptionEntity]:
    try:
        get_package_share_directory('rviz2')
    except PackageNotFoundError:
        return [
            LogInfo(
                msg='rviz:=true, but rviz2 is not installed (sudo apt install ros-jazzy-rviz2); '
                'continuing without RViz'
            )
        ]
    layout = Path(get_package_share_directory('ratslam_ros')) / 'rviz' / 'ratslam.rviz'
    return [
        Node(
            package='rviz2',
            executable='rviz2',
            arguments=['-d', str(layout)],
            parameters=[{'use_sim_time': use_sim_time}],
        )
    ]
