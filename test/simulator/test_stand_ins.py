# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated recordings in the formats of the data sets of Ball et al. (2013)."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import cv2
import pytest
from rosbags.highlevel import AnyReader

from ratslam_ros.cli.main import main
from ratslam_ros.errors import UnusableInput
from ratslam_ros.results.trajectory import read_tum
from ratslam_simulator.stand_ins import DATA_SETS, write_stand_in

DOCS = Path(__file__).resolve().parents[2] / 'docs/experiments.md'
SECONDS = 2.0
IMAGE, ODOMETRY = 'sensor_msgs/msg/CompressedImage', 'nav_msgs/msg/Odometry'
FORMATS = {
    'irat': (
        (240, 320), 41, {
            '/irat_red/camera/image/compressed': IMAGE, '/irat_red/odom': ODOMETRY,
            '/overhead/pose': 'geometry_msgs/msg/PoseStamped',
        },
    ),
    'stlucia': ((480, 640), 21, {'/stlucia/camera/image/compressed': IMAGE}),
    'newcollege': (
        (128, 512), 11,
        {'/newcollege/camera/image/compressed': IMAGE, '/newcollege/odom': ODOMETRY},
    ),
}


def command(name: str) -> list[str]:
    """Return the command of a data set in docs/experiments.md, without the program."""
    [line] = [
        x for x in DOCS.read_text('utf-8').splitlines()
        if x.startswith('ratslam replay') and f'--config {name}' in x and x[-1] != '\\'
    ]
    return shlex.split(line)[1:]


@pytest.mark.parametrize('name', DATA_SETS)
def test_stand_in_has_format_and_replays_with_documented_command(
    name: str, tmp_path: Path
) -> None:
    bag = tmp_path / f'{name}.bag'
    truth = read_tum(write_stand_in(bag, name, duration_s=SECONDS))
    size, count, topics = FORMATS[name]
    with AnyReader([bag]) as reader:
        assert {x.topic: x.msgtype for x in reader.connections} == topics
        images = [
            (at_ns, reader.deserialize(data, x.msgtype))
            for x, at_ns, data in reader.messages() if x.msgtype == IMAGE
        ]
    assert len(images) == count
    assert cv2.imdecode(images[0][1].data, cv2.IMREAD_GRAYSCALE).shape == size
    stamps_ns = [x.header.stamp.sec * 10**9 + x.header.stamp.nanosec for _, x in images]
    assert stamps_ns == [at_ns for at_ns, _ in images]
    arguments = command(name)
    arguments[1] = str(bag)
    assert main([*arguments, '--out', str(tmp_path / 'out'), '--quiet', '--no-history']) == 0
    summary = json.loads((tmp_path / 'out/summary.json').read_text('utf-8'))
    assert summary['frames'] == count
    has_odometry = ODOMETRY in topics.values()
    assert summary['odometry'] == (41 if has_odometry else count - 1)
    assert summary.get('visual_odometry', False) != has_odometry
    assert summary['experiences'] >= 2
    if has_odometry:
        driven_m = read_tum(tmp_path / 'out/dead_reckoning.tum').position_m[-1]
        true_m = truth.position_m[-1] - truth.position_m[0]
        assert (driven_m**2).sum() == pytest.approx((true_m**2).sum(), rel=0.05)


def test_existing_bag_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / 'irat.bag').touch()
    with pytest.raises(UnusableInput, match='exists already'):
        write_stand_in(tmp_path / 'irat.bag', 'irat', duration_s=1.0)
