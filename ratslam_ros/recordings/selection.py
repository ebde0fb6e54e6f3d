# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Selection of the topics to read: automatic if unambiguous, otherwise by the user."""

from pathlib import Path

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings.topics import (
    IMAGE_TYPES,
    ODOMETRY_TYPES,
    SCAN_TYPES,
    STRING,
    Selection,
    Topic,
)

TEMPLATE_NAME = 'local_view/template'


class TopicSource:
    """The topics of a recording, and the choice of those to read."""

    path: Path
    topics: tuple[Topic, ...]
    notices: tuple[str, ...] = ()
    """What the user must know of every selection."""

    def is_depth(self, topic: Topic) -> bool:
        """Return whether the first image of a topic is a depth image."""
        return False

    def is_empty(self, topic: Topic) -> bool:
        """Return whether a topic has no messages."""
        return topic.count == 0

    def select(
        self,
        image_topic: str | None = None,
        odom_topic: str | None = None,
        visual_odometry: bool = False,
        scan_topic: str | None = None,
        scans: bool = False,
    ) -> Selection:
        """Choose the topics to read.

        Args:
            image_topic: topic with images; None selects the only candidate.
            odom_topic: topic with odometry; None selects the only candidate.
            visual_odometry: ignore recorded odometry.
            scan_topic: topic with scans, or several separated by commas; None selects the only
                candidate.
            scans: whether to read scans at all.

        Raises:
            UnusableInput: a named topic cannot be used, arguments contradict each other, there are
                several candidates, or there are neither images nor templates with odometry.
        """
        notices: list[str] = []
        templates = [
            topic for topic in usable(self, frozenset({STRING}))
            if topic.name.endswith(TEMPLATE_NAME)
        ]
        image = template = odom = None
        lasers: list[Topic] = []
        if image_topic is not None:
            image = _named(self, image_topic, IMAGE_TYPES, 'images', '--image-topic')
        else:
            image = _single(self, image_candidates(self), 'images', '--image-topic')
        if image is None:
            if not templates:
                if depth := usable(self, IMAGE_TYPES):
                    raise UnusableInput(
                        f'{self.path} holds depth images only: expected those of a camera; '
                        f'--image-topic {depth[0].name} uses them all the same'
                    )
                raise UnusableInput(
                    f'{self.path} holds no images: expected a topic of type sensor_msgs/Image or '
                    f'sensor_msgs/CompressedImage; its topics are {_format_topics(self.topics)}'
                )
            template = templates[0]
            notices.append(f'no images: the recorded templates of {template.name} are used')
        elif templates:
            notices.append(
                f'the images of {image.name} are used, not the recorded templates of '
                f'{templates[0].name}'
            )
        if odom_topic is not None and visual_odometry:
            raise UnusableInput(
                f'both the odometry of {odom_topic} and visual odometry are requested: expected '
                'one of them; leave out --odom-topic or --visual-odometry'
            )
        if odom_topic is not None:
            odom = _named(self, odom_topic, ODOMETRY_TYPES, 'odometry', '--odom-topic')
        elif not visual_odometry:
            odom = _single(self, usable(self, ODOMETRY_TYPES), 'odometry', '--odom-topic')
        if odom is None:
            if image is None:
                raise UnusableInput(
                    f'{self.path} holds recorded templates and no images: expected a topic of '
                    'type nav_msgs/Odometry to go with them'
                    + ('; leave out --visual-odometry, which needs images' if visual_odometry
                       else f'; its topics are {_format_topics(self.topics)}')
                )
            notices.append(
                'visual odometry is used, as requested' if visual_odometry
                else 'no odometry topic: visual odometry is used'
            )
        if scan_topic is not None:
            if not scans:
                raise UnusableInput(
                    f'the scans of {scan_topic} are requested, but nothing uses them: set '
                    'experience_map.exp_align_scans, or leave out --scan-topic'
                )
            lasers = [
                _named(self, name, SCAN_TYPES, 'scans', '--scan-topic')
                for name in scan_topic.split(',')
            ]
            if len(set(lasers)) < len(lasers):
                raise UnusableInput(
                    f'--scan-topic {scan_topic} names a topic twice; expected a topic for each '
                    'laser'
                )
        elif scans:
            only = _single(self, usable(self, SCAN_TYPES), 'scans', '--scan-topic')
            lasers = [] if only is None else [only]
        return Selection(
            image.name if image else None,
            odom.name if odom else None,
            template.name if template else None,
            ','.join(laser.name for laser in lasers) or None,
            (*self.notices, *notices),
        )


def camera_info_topic(image_topic: str) -> str:
    """Return the camera_info topic in the namespace of an image topic, as image_transport does."""
    return f'{image_topic.removesuffix("/compressed").rpartition("/")[0]}/camera_info'


def image_candidates(recording: TopicSource) -> list[Topic]:
    """Return the image topics except depth images and compressed duplicates of raw topics."""
    topics = [topic for topic in usable(recording, IMAGE_TYPES) if not recording.is_depth(topic)]
    names = {topic.name for topic in topics}
    return [
        topic for topic in topics
        if not topic.name.endswith('/compressed') or topic.name[: -len('/compressed')] not in names
    ]


def usable(recording: TopicSource, types: frozenset[str]) -> list[Topic]:
    """Return the topics of some types that can be read and have messages."""
    return [
        topic for topic in recording.topics
        if topic.type in types and topic.problem is None and not recording.is_empty(topic)
    ]


def _named(
    recording: TopicSource, name: str, types: frozenset[str], what: str, option: str
) -> Topic:
    """Return the topic that the user named, with or without its leading slash."""
    plain = name.lstrip('/')
    topic = next((one for one in recording.topics if one.name.lstrip('/') == plain), None)
    if topic is None:
        problem = 'does not exist'
    elif topic.type not in types:
        problem = f'is of type {topic.type}'
    elif topic.problem is not None:
        problem = f'cannot be decoded ({topic.problem})'
    elif recording.is_empty(topic):
        problem = 'has no messages'
    else:
        return topic
    others = [
        one for one in recording.topics if one.type in types and one.name.lstrip('/') != plain
    ]
    if others:
        several = f'one of {_format_topics(others)}'
        answer = f'{option} {others[0].name}' if len(others) == 1 else several
    else:
        answer = f'the topics are {_format_topics(recording.topics)}'
    raise UnusableInput(
        f'{option} {name} {problem} in {recording.path}: expected a topic with {what}: {answer}'
    )


def _single(recording: TopicSource, found: list[Topic], what: str, option: str) -> Topic | None:
    if len(found) > 1:
        raise UnusableInput(
            f'{recording.path} holds {len(found)} topics with {what}: expected one; choose with '
            + ' or '.join(f'{option} {topic.name}' for topic in found)
        )
    return found[0] if found else None


def _format_topics(topics: tuple[Topic, ...] | list[Topic]) -> str:
    shown = [f'{topic.name} ({topic.type})' for topic in topics[:12]]
    more = [f'and {len(topics) - 12} more'] if len(topics) > 12 else []
    return ', '.join(shown + more) or 'none'
