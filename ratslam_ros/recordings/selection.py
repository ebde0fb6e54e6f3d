# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which topics of a recording to use: guessed where that is safe, asked for where it is not."""

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings.topics import (
    IMAGE_TYPES,
    ODOMETRY_TYPES,
    SCAN_TYPES,
    STRING,
    Selection,
    Topic,
    TopicSource,
)

TEMPLATE_NAME = 'local_view/template'


def select(
    recording: TopicSource,
    image_topic: str | None = None,
    odom_topic: str | None = None,
    visual_odometry: bool = False,
    scan_topic: str | None = None,
    scans: bool = False,
) -> Selection:
    """Choose the topics, guessing those not named; raises UnusableInput if it cannot.

    ``scans``: one with scans too, if there is one.
    """
    notices: list[str] = []
    templates = template_candidates(recording)
    image = template = odom = scan = None
    if image_topic is not None:
        image = _named(recording, image_topic, IMAGE_TYPES, 'images', '--image-topic')
    else:
        image = _only(recording, image_candidates(recording), 'images', '--image-topic')
    if image is None:
        if not templates:
            raise UnusableInput(
                f'{recording.path} holds no images: expected a topic of type sensor_msgs/Image or '
                f'sensor_msgs/CompressedImage; its topics are {_listed(recording.topics)}'
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
            f'both the odometry of {odom_topic} and visual odometry are asked for: expected one '
            'of them; leave out --odom-topic or --visual-odometry'
        )
    if odom_topic is not None:
        odom = _named(recording, odom_topic, ODOMETRY_TYPES, 'odometry', '--odom-topic')
    elif not visual_odometry:
        odom = _only(recording, odometry_candidates(recording), 'odometry', '--odom-topic')
    if odom is None:
        if image is None:
            raise UnusableInput(
                f'{recording.path} holds recorded templates and no images: expected a topic of '
                'type nav_msgs/Odometry to go with them'
                + (
                    '; leave out --visual-odometry, which needs images'
                    if visual_odometry
                    else f'; its topics are {_listed(recording.topics)}'
                )
            )
        notices.append(
            'visual odometry is used, as it was asked for'
            if visual_odometry
            else 'no odometry topic: visual odometry is used'
        )
    if scan_topic is not None:
        if not scans:
            raise UnusableInput(
                f'the scans of {scan_topic} are asked for, and nothing uses them: set '
                'experience_map.exp_align_scans, or leave out --scan-topic'
            )
        scan = _named(recording, scan_topic, SCAN_TYPES, 'scans', '--scan-topic')
    elif scans:
        scan = _only(recording, scan_candidates(recording), 'scans', '--scan-topic')
    return Selection(
        image.name if image else None,
        odom.name if odom else None,
        template.name if template else None,
        scan.name if scan else None,
        tuple(notices),
    )


def camera_info_of(image_topic: str) -> str:
    """Return where a camera's driver publishes camera_info: beside the raw images."""
    return f'{image_topic.removesuffix("/compressed").rpartition("/")[0]}/camera_info'


def image_candidates(recording: TopicSource) -> list[Topic]:
    """Return the topics of cameras: no depth images, no compressed twins of a raw topic."""
    topics = [topic for topic in _usable(recording, IMAGE_TYPES) if not recording.is_depth(topic)]
    names = {topic.name for topic in topics}
    return [
        topic
        for topic in topics
        if not (
            topic.name.endswith('/compressed') and topic.name.removesuffix('/compressed') in names
        )
    ]


def odometry_candidates(recording: TopicSource) -> list[Topic]:
    """Return the topics with odometry."""
    return _usable(recording, ODOMETRY_TYPES)


def scan_candidates(recording: TopicSource) -> list[Topic]:
    """Return the topics with laser scans."""
    return _usable(recording, SCAN_TYPES)


def template_candidates(recording: TopicSource) -> list[Topic]:
    """Return the topics with recorded local_view templates."""
    return [
        topic
        for topic in _usable(recording, frozenset({STRING}))
        if topic.name.endswith(TEMPLATE_NAME)
    ]


def _usable(recording: TopicSource, types: frozenset[str]) -> list[Topic]:
    return [
        topic
        for topic in recording.topics
        if topic.type in types and topic.readable is None and not recording.is_empty(topic)
    ]


def _named(
    recording: TopicSource, name: str, types: frozenset[str], what: str, option: str
) -> Topic:
    """Return the topic that the user named, with or without its leading slash."""
    fitting = [topic for topic in recording.topics if topic.type in types]
    for topic in recording.topics:
        if topic.name.lstrip('/') != name.lstrip('/'):
            continue
        if topic.type not in types:
            problem = f'is of type {topic.type}'
        elif topic.readable is not None:
            problem = f'cannot be decoded ({topic.readable})'
        elif recording.is_empty(topic):
            problem = 'has no messages'
        else:
            return topic
        break
    else:
        problem = 'does not exist'
    others = [topic for topic in fitting if topic.name.lstrip('/') != name.lstrip('/')]
    if others:
        answer = f'{option} {others[0].name}' if len(others) == 1 else f'one of {_listed(others)}'
    else:
        answer = f'the topics are {_listed(recording.topics)}'
    raise UnusableInput(
        f'{option} {name} {problem} in {recording.path}: expected a topic with {what}: {answer}'
    )


def _only(recording: TopicSource, found: list[Topic], what: str, option: str) -> Topic | None:
    if len(found) > 1:
        raise UnusableInput(
            f'{recording.path} holds {len(found)} topics with {what}: expected a choice; give '
            + ' or '.join(f'{option} {topic.name}' for topic in found)
        )
    return found[0] if found else None


def _listed(topics: tuple[Topic, ...] | list[Topic]) -> str:
    shown = [f'{topic.name} ({topic.type})' for topic in topics[:12]]
    more = [f'and {len(topics) - 12} more'] if len(topics) > 12 else []
    return ', '.join(shown + more) or 'none'
