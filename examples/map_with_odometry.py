# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Feed images and odometry by hand, here from a table of stamp_ns,image,speed_mps,yaw_rate_radps.

usage: python examples/map_with_odometry.py TABLE.csv [MAP.json]
"""

import csv
import sys
from pathlib import Path

import cv2

import ratslam_ros as rs

if len(sys.argv) < 2:
    sys.exit(__doc__)
table = Path(sys.argv[1])
slam = rs.RatSLAM()  # leave out the odometry, and it is estimated from the images
for row in csv.DictReader(table.open()):
    stamp_ns = int(row['stamp_ns'])
    speed, turn_rate = float(row['speed_mps']), float(row['yaw_rate_radps'])  # left: positive
    slam.odometry(rs.Odometry(stamp_ns, rs.Twist(speed, turn_rate)))
    slam.image(stamp_ns, cv2.imread(str(table.parent / row['image']), cv2.IMREAD_GRAYSCALE))
slam.finish()
print(f'{len(slam.experience_map)} places, now at {slam.pose}')
Path(*sys.argv[2:3] or ['map.json']).write_text(rs.encode_map(stamp_ns, slam.experience_map))
