# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The live commands: run and launch nodes, play recordings, call services, echo topics.

They work with ROS 2 and with its stand-in. Modules that import rclpy at the top are imported only
after ``ros.require()``, which makes ``import rclpy`` work.
"""
