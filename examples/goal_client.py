# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ask the experience map for a route to a position, with plain rclpy.

usage: python3 examples/goal_client.py X_M Y_M
"""

import sys

import rclpy
from nav_msgs.srv import GetPlan


def main(x_m: float, y_m: float) -> None:
    """Call experience_map/recall_goal and print the poses of the route."""
    rclpy.init()
    node = rclpy.create_node('goal_client')
    client = node.create_client(GetPlan, 'experience_map/recall_goal')
    if not client.wait_for_service(timeout_sec=10.0):
        sys.exit('experience_map/recall_goal is not available: start the nodes first')
    request = GetPlan.Request(tolerance=1.0)  # metres to the nearest experience
    request.goal.header.frame_id = 'map'
    request.goal.pose.position.x, request.goal.pose.position.y = x_m, y_m
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=10.0)
    response = future.result()
    if response is None or not response.plan.poses:
        sys.exit('no route: see no_route_because in /diagnostics')
    for pose in response.plan.poses:
        print(f'{pose.pose.position.x:.2f} {pose.pose.position.y:.2f}')
    rclpy.shutdown()


if __name__ == '__main__':
    main(float(sys.argv[1]), float(sys.argv[2]))
