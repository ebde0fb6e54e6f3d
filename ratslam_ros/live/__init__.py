# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The live commands: run and launch nodes, play recordings, call services, echo topics.

They work with ROS 2 and with the stand-in for it alike. What imports rclpy does so at its top, and
is itself imported only after ``ros.require()`` has seen to it that there is one.
"""
