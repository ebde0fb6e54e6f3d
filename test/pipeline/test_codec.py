# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Items in the log of a process keep every bit, and damaged ones are refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.config import Config
from ratslam_ros.core.pose_cells.map_action import MapAction, Place
from ratslam_ros.core.pose_cells.map_relocation import MapRelocation
from ratslam_ros.core.vision.local_view import EncodedView, ViewMatch
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.errors import UnusableInput
from ratslam_ros.pipeline.codec import decode_item, encode_item, item_from_state, item_state
from ratslam_ros.pipeline.commands import Relocated, SetPaused
from ratslam_ros.pipeline.items import Answer, NumberedAction, Template
from ratslam_ros.pipeline.local_view import LocalViewStage
from ratslam_ros.pipeline.pipeline import Pipeline
from ratslam_ros.pipeline.visual_odometry import VisualOdometryStage

STAMP_NS = 1_700_000_000_123_456_789
PIXELS = np.arange(60 * 80, dtype=np.uint8).reshape(60, 80)
SCAN = Scan(5, -1.5, 0.1, np.array([0.1, math.inf, 3.0]), 0.3, -0.2, 1)
ACTION = MapAction(
    'link', 3, 4, 7, 0.5, Place(1 / 3, 2.0, 0.1), TurnCorrection(1.1, -0.01), 3, 0.25, 0.5
)
ITEMS = [
    Odometry(STAMP_NS, Twist(0.1, math.nan, -1e-300), Pose(1 / 3, -1e300, 5e-324), False),
    Odometry(STAMP_NS, Twist(-0.0, 1.0), Pose(0.0, 0.0, math.pi)),
    None, NumberedAction(5, ACTION, 6), Answer(5, None, 6), SetPaused(True, 'local_view'),
    Answer(2**40, MapRelocation(3, 4, Pose(0.1, 1 / 7, -3.0)), 6), Relocated(),
]


@pytest.mark.parametrize('item', ITEMS, ids=lambda item: type(item).__name__)
def test_item_keeps_every_bit(item: Any) -> None:
    assert repr(decode_item(encode_item(item))) == repr(item)


def test_template_and_scan_keep_every_bit() -> None:
    template = Template(ViewMatch(4, True, 1 / 3, -0.1, 0.2, 7, (1, 2)), 9)
    assert decode_item(encode_item(template)) == template
    found = decode_item(encode_item(SCAN))
    assert found.ranges_m.tobytes() == SCAN.ranges_m.tobytes()
    assert repr(found) == repr(SCAN)


@pytest.mark.parametrize('stages, is_small', [
    ((LocalViewStage, VisualOdometryStage), True), ((LocalViewStage,), True), ((), False),
])
def test_image_is_logged_as_what_was_prepared(stages: Any, is_small: bool) -> None:
    pipeline = Pipeline([stage(Config()) for stage in stages], 0)
    image = pipeline.prepare(PIXELS) if stages else PreparedImage(PIXELS)
    data = encode_item(image)
    assert (len(data) < PIXELS.size) == is_small
    found = decode_item(data)
    assert found.pixels.shape == PIXELS.shape
    assert is_small or np.array_equal(found.pixels, PIXELS)
    assert encode_item(found) == data
    for stage in stages:
        outputs = []
        for each in (image, found):
            one = stage(Config())
            reader = one.readers()['image']
            reader(STAMP_NS, each)
            outputs.append(repr((reader(2 * STAMP_NS, each), one.state())))
        assert outputs[0] == outputs[1]


def test_colour_is_logged_and_saved_while_it_is_needed() -> None:
    colour = np.stack([PIXELS, PIXELS + 1, PIXELS + 2], 2)
    image = PreparedImage(PIXELS, colour=colour)
    for found in (decode_item(encode_item(image)), item_from_state(item_state(image))):
        assert np.array_equal(found.pixels, PIXELS)
        assert np.array_equal(found.colour, colour)
    is_prepared = PreparedImage(PIXELS, EncodedView(None), None, True, colour)
    assert decode_item(encode_item(is_prepared)).colour is None


def test_view_without_structure_is_no_view() -> None:
    found = decode_item(encode_item(PreparedImage(PIXELS, EncodedView(None), None, True)))
    assert found.encoded == EncodedView(None)


def test_damaged_items_are_refused() -> None:
    for item in [*ITEMS, SCAN, PreparedImage(PIXELS, EncodedView(PIXELS[:4]), None, True)]:
        data = encode_item(item)
        whole = {1, *range(len(data) - 16, len(data), 8)}  # undecodable, and scans of fewer beams
        for size in set(range(len(data))) - (whole if data[:1] in b'us' else set()):
            with pytest.raises(UnusableInput):
                decode_item(data[:size])
    with pytest.raises(UnusableInput, match='begins with'):
        decode_item(b'?')
