# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Build a map from a folder of images, a video or a bag, as ``ratslam replay`` does.

usage: python examples/map_images.py RECORDING NEW_FOLDER
"""

import sys

import ratslam_ros as rs

if len(sys.argv) != 3:
    sys.exit(__doc__)
result = rs.map_recording(sys.argv[1])
print(result)
known = result.frames['is_new'] == 0
print(f'{known.mean():.0%} of the images show a known view')
for place in result.places[:3]:
    print(f'place {place["id"]} is at ({place["x_m"]:.2f}, {place["y_m"]:.2f})')
result.plot()  # map.png and matches.png, saved with the map
result.save(sys.argv[2])
