# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the selection of topics and of the description of a recording."""

import re
import sqlite3

import numpy as np
import pytest
from fabricate import (
    COMPRESSED,
    IMAGE,
    ODOMETRY,
    STRING,
    compressed_image,
    odometry,
    raw_image,
    write_mcap,
    write_sqlite,
)
from helpers import START_NS, picture, string_message, template_text

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings import describe, open_recording

MESSAGES = {
    'raw': (IMAGE, raw_image(picture(0))),
    'compressed': (COMPRESSED, compressed_image(picture(0))),
    'depth': (IMAGE, raw_image(np.zeros((4, 4), np.uint16), '16UC1', step=8)),
    'depth32': (IMAGE, raw_image(np.zeros((4, 4), np.float32), '32FC1', step=16)),
    'compressed_depth': (COMPRESSED, compressed_image(picture(0), form='16UC1; compressedDepth')),
    'odometry': (ODOMETRY, odometry()),
    'template': (STRING, string_message(template_text(START_NS, 0))),
    'broken': (IMAGE, b'\x00\x01\x00\x00'),
}


@pytest.fixture
def recorded(tmp_path):
    opened = []

    def record(sqlite=False, **topics):
        """Record one message per topic; in the keywords, which name the topics, __ is /."""
        messages = [
            (START_NS + index, '/' + name.replace('__', '/'), *MESSAGES[kind])
            for index, (name, kind) in enumerate(topics.items())
        ]
        path = tmp_path / f'r{len(opened)}.{"db3" if sqlite else "mcap"}'
        opened.append(open_recording((write_sqlite if sqlite else write_mcap)(path, messages)))
        return opened[-1]

    yield record
    for recording in opened:
        recording.close()


@pytest.mark.parametrize(('topics', 'image', 'odom'), [
    ({'a': 'raw', 'odom': 'odometry'}, '/a', '/odom'),
    ({'a': 'raw', 'a__compressed': 'compressed', 'odom': 'odometry'}, '/a', '/odom'),
    ({'a': 'raw', 'b': 'depth', 'c': 'depth32', 'd': 'compressed_depth'}, '/a', None),
    ({'a': 'depth', 'a__compressed': 'compressed'}, '/a/compressed', None),
    ({'a': 'raw', 'local_view__template': 'template', 'odom': 'odometry'}, '/a', '/odom'),
])
def test_single_candidates_are_selected(recorded, topics, image, odom):
    for sqlite in (False, True):  # Only mcap stores message counts.
        selection = recorded(sqlite, **topics).select()
        assert (selection.image_topic, selection.odom_topic) == (image, odom)
        assert selection.template_topic is None


def test_notices_state_the_selected_source(recorded):
    recording = recorded(a='raw', local_view__template='template', odom='odometry')
    assert 'not the recorded templates' in recording.select().notices[0]
    assert recording.select(visual_odometry=True).odom_topic is None
    assert 'as requested' in recording.select(visual_odometry=True).notices[1]
    assert recorded(a='raw').select().notices == ('no odometry topic: visual odometry is used',)


@pytest.mark.parametrize(('topics', 'arguments', 'message'), [
    ({'a': 'raw', 'b': 'compressed'}, {},
     'holds 2 topics with images: .* --image-topic /a or --image-topic /b'),
    ({'a': 'raw', 'o': 'odometry', 'p': 'odometry'}, {},
     'holds 2 topics with odometry: .* --odom-topic /o or --odom-topic /p'),
    ({'o': 'odometry'}, {}, r'holds no images: .*/o \(nav_msgs/msg/Odometry\)'),
    ({'a': 'depth', 'o': 'odometry'}, {}, 'holds depth images only: .*--image-topic /a'),
    ({'local_view__template': 'template'}, {}, 'expected a topic of type nav_msgs/Odometry'),
    ({'a': 'raw'}, {'image_topic': '/b'}, '--image-topic /b does not exist .*--image-topic /a'),
    ({'a': 'raw', 'o': 'odometry'}, {'image_topic': '/o'}, 'is of type nav_msgs/msg/Odometry'),
    ({'a': 'raw', 'o': 'odometry'}, {'odom_topic': '/x'}, 'does not exist .*--odom-topic /o'),
    ({'a': 'raw'}, {'odom_topic': '/x'}, r'the topics are /a \(sensor_msgs/msg/Image\)'),
    ({'a': 'raw', 'o': 'odometry'}, {'odom_topic': '/o', 'visual_odometry': True},
     'expected one of them'),
])
def test_ambiguous_or_invalid_choice_lists_the_options(recorded, topics, arguments, message):
    with pytest.raises(UnusableInput, match=message) as error:
        recorded(**topics).select(**arguments)
    assert '\n' not in str(error.value)


def test_topics_without_messages_are_not_candidates(recorded):
    path = recorded(sqlite=True, a='raw', b='raw', odom='odometry').path
    database = sqlite3.connect(path)
    database.execute('DELETE FROM messages WHERE topic_id = 1')
    database.commit()
    database.close()
    with open_recording(path) as recording:
        assert recording.select().image_topic == '/b'
        with pytest.raises(UnusableInput, match='has no messages'):
            recording.select('/a')


def test_named_topics_are_selected(recorded):
    recording = recorded(a='raw', b='depth', o='odometry', p='odometry')
    selection = recording.select('b', '/p')  # Without slash; depth images only by name.
    assert (selection.image_topic, selection.odom_topic) == ('/b', '/p')
    image = next(event for event in recording.events(selection) if hasattr(event, 'grey'))
    assert image.grey().shape == (4, 4)


def test_description_gives_the_replay_command(recorded):
    for sqlite in (False, True):
        described = describe(recorded(sqlite, a='raw', o='odometry'))
        command = described.splitlines()[-1]
        assert command.startswith('next: ratslam replay ') and 'topic' not in command
        assert re.search(r'/a +sensor_msgs/msg/Image +1 +16x12 mono8\n', described)
        described = describe(recorded(sqlite, a='broken', b='raw', o='odometry', p='odometry'))
        assert described.endswith('--image-topic /b --odom-topic /o')
        assert 'no image in it can be decoded' in described


def test_description_without_command_gives_the_reason(recorded):
    described = describe(recorded(o='odometry'))
    assert 'next:' not in described
    assert 'note: ' in described and 'holds no images' in described
