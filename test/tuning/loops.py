# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot that drives in circles, for tests of commands that judge maps by revisits."""

import math
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from helpers import (
    IMAGE_TOPIC,
    ODOM_TOPIC,
    START_NS,
    Recorded,
    extended,
    image_message,
    odometry_message,
    write_bag,
)
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose

PER_LAP = 80
HEIGHT, WIDTH = 32, 48
PERIOD_NS = 10**8
FRAMES_PER_SCENE = 4
TURN_ERROR = 1.08
"""Factor by which the odometry overestimates the turns."""

FINE = extended().with_values(
    {
        'local_view.template_x_size': 16, 'local_view.template_y_size': 8,
        'local_view.vt_shift_match': 1, 'local_view.vt_match_threshold': 0.06,
        'local_view.vt_patch_normalise': 0, 'pose_cells.pc_cell_x_size': 0.2,
    }
)
"""A configuration that maps the circles."""

BLIND = FINE.with_values({'local_view.vt_match_threshold': 0.0001})
"""One that recognises nothing."""

DAZED = FINE.with_values({'local_view.vt_match_threshold': 0.6})
"""One that takes every view for the first one."""


def frames(count: int, per_lap: int = PER_LAP, seed: int = 0) -> Iterator[NDArray[np.uint8]]:
    """Yield noisy images; the scene changes every few frames, and repeats after a lap."""
    rng = np.random.default_rng(seed)
    scenes = [cv2.GaussianBlur(rng.normal(size=(HEIGHT, WIDTH)), (0, 0), 3.0)
              for _ in range(per_lap // FRAMES_PER_SCENE)]
    for i in range(count):
        scene, step = divmod(i % per_lap, FRAMES_PER_SCENE)
        share = step / FRAMES_PER_SCENE
        view = (1.0 - share) * scenes[scene] + share * scenes[(scene + 1) % len(scenes)]
        view = 128.0 + 50.0 * view / view.std() + rng.normal(scale=6.0, size=(HEIGHT, WIDTH))
        yield np.clip(view, 0, 255).astype(np.uint8)


def laps(count: int, per_lap: int = PER_LAP) -> Iterator[Recorded]:
    """Yield images and odometry of circles of 2 m radius."""
    step_m, step_rad = 4.0 * math.pi / per_lap, 2.0 * math.pi / per_lap
    for i, image in enumerate(frames(count, per_lap)):
        stamp_ns = START_NS + i * PERIOD_NS
        message = odometry_message(
            stamp_ns, step_m / 0.1, TURN_ERROR * step_rad / 0.1, Pose(0.0, 0.0, 0.0)
        )
        yield stamp_ns, ODOM_TOPIC, 'odometry', message
        yield stamp_ns + 1000, IMAGE_TOPIC, 'image', image_message(stamp_ns, image)


def write_loops(folder: Path, count: int = 240, per_lap: int = PER_LAP) -> Path:
    """Write three laps as a bag, and the true trajectory and the laps beside it."""
    bag = write_bag(folder / 'loops', laps(count, per_lap))
    rows = ''.join(f'{i},{i // per_lap},{i % per_lap}\n' for i in range(count))
    (folder / 'lap_phase.csv').write_text(f'frame,lap,ref_frame\n{rows}')
    lines = []
    for i in range(count):
        angle = 2.0 * math.pi * i / per_lap
        seconds, nanoseconds = divmod(START_NS + i * PERIOD_NS, 10**9)
        lines.append(f'{seconds}.{nanoseconds:09d} {2.0 * math.sin(angle):.6f} '
                     f'{2.0 - 2.0 * math.cos(angle):.6f} 0 0 0 {math.sin(angle / 2.0):.6f} '
                     f'{math.cos(angle / 2.0):.6f}\n')
    (folder / 'truth.tum').write_text(''.join(lines))
    return bag
