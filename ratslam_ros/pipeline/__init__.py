# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One ordered stream of inputs, and the stages that turn it into a map.

    command, odometry, scan, image | visual_odometry | local_view | pose_cells | experience_map

The head of a pipeline sorts its inputs by stamp (order.py). Each stage reads the stream and adds
its results to it. Nothing here reads a clock or a file, or imports ROS. Start with pipeline.py;
streams.py lists what flows, and each stage has a file of its own.
"""
