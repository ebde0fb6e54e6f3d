# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tests on recordings of other projects; skipped if the data folder is missing."""

import re

import pytest

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings import ImageEvent, OdometryEvent, describe, open_recording


def test_rc_car_loops_is_read_completely(data):
    with open_recording(data / 'rc_car_loops') as recording:
        selection = recording.select()
        events = list(recording.events(selection))
        assert sum(isinstance(event, ImageEvent) for event in events) == 1964
        assert sum(isinstance(event, OdometryEvent) for event in events) == 1964
        assert events[1].grey().shape == (120, 160)
        assert recording.warnings == []
        image, odom = describe(recording).splitlines()[3:5]
        assert re.search(r' 1964 +11\.[456] Hz +160x120 jpeg$', image)
        assert re.search(r' 1964 ', odom)


def test_donkeycar_track_is_read_as_folder_and_file(data):
    for name in ('donkeycar_track', 'donkeycar_track/donkeycar_track.db3'):
        with open_recording(data / name) as recording:
            assert len(list(recording.events(recording.select()))) == 1000
            assert recording.count() == {'/camera/image/compressed': 1000}


def test_image_folder_is_read_and_parent_rejected(data):
    with open_recording(data / 'corridor_circuit') as recording:
        assert len(list(recording.events(recording.select()))) == 84
    with pytest.raises(UnusableInput, match=r'give one of .*query'):
        open_recording(data / 'corridor_vpr')


def test_bags_of_other_software_are_read_or_rejected(data):
    paths = [
        path for path in (data / 'bags').rglob('*')
        if path.suffix in ('.bag', '.mcap', '.db3') or (path.is_dir() and any(path.glob('*_0.*')))
    ]
    assert len(paths) > 50
    refused = set()
    for path in paths:
        try:
            with open_recording(path) as recording:
                described = describe(recording)
                assert sum(recording.count().values()) > 0, path
                assert 'next: ' in described or 'holds no images' in described, path
        except UnusableInput as error:
            assert '\n' not in str(error)
            refused.add(path.name)
    assert refused == {
        'empty-file.bag', 'no-messages.bag', 'wrong_rmw_test', 'wrong_rmw_test_0.mcap',
        'wrong_rmw_test_0.db3',
    }
