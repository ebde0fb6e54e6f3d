# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Build a map from a folder of images, with odometry from the camera.

usage: python examples/map_images.py FOLDER [MAP.json]
"""

import sys
from pathlib import Path

import cv2

from ratslam_ros import Config, RatSLAM, encode_map
from ratslam_ros.recordings.image_folder import image_files

FRAME_NS = 100_000_000  # the images were taken at 10 Hz


def main(folder: Path, output: Path) -> None:
    """Map the images in natural order: 2.jpg before 10.jpg."""
    slam = RatSLAM(Config(), head='visual_odometry')
    stamp_ns = 0
    for path in image_files(folder):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)  # None if it is damaged
        if image is not None:
            stamp_ns += FRAME_NS
            slam.image(stamp_ns, image)
    slam.finish()
    output.write_text(encode_map(stamp_ns, slam.experience_map))
    graph = slam.experience_map
    print(f'{stamp_ns // FRAME_NS} images, {len(slam.local_view)} templates, '
          f'{len(graph)} experiences, {graph.link_count} links: {output}')  # fmt: skip


if __name__ == '__main__':
    main(Path(sys.argv[1]), Path(sys.argv[2] if len(sys.argv) > 2 else 'map.json'))
