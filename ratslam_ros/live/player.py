# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam play``: publish a recording, complete and in order."""

from __future__ import annotations

import argparse
import math
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, LaserScan
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from ratslam_ros.console import ProgressBar, print_notice, ticking
from ratslam_ros.errors import UnusableInput
from ratslam_ros.event_inputs import laser_mount
from ratslam_ros.live import ros
from ratslam_ros.live.action_wait import ACTION, ACTION_TIMEOUT_S, ActionWait
from ratslam_ros.live.messages import BASE_FRAME, camera_info, message_of, mount_of, transform_of
from ratslam_ros.recordings import Event, ImageEvent, Recording, ScanEvent, Selection, topics
from ratslam_ros.recordings.pacing import Pacing
from ratslam_ros.recordings.prefetch import prefetch
from ratslam_ros.ros.convert import time_of
from ratslam_ros.ros.qos import CLOCK, PLAYED, STATE, STATIC
from ratslam_ros.ros.restart.history import History
from ratslam_ros.starting import starting

ODOM, SCAN, TEMPLATE = 'odom', 'scan', 'local_view/template'
CAMERA_INFO = 'camera_info'
PLAYED_AS = {
    topics.RAW_IMAGE: (Image, 'image'),
    topics.VIDEO: (Image, 'image'),
    topics.COMPRESSED_IMAGE: (CompressedImage, 'image/compressed'),
    topics.IMAGE_FILES: (CompressedImage, 'image/compressed'),
    topics.ODOMETRY: (Odometry, ODOM),
    topics.TABLE: (Odometry, ODOM),
    topics.LASER_SCAN: (LaserScan, SCAN),
    topics.STRING: (String, TEMPLATE),
}
"""Type and topic of the published message by the type of the recorded topic."""
TOPICS = dict(PLAYED_AS.values())

MAPPING_NODES = frozenset({'local_view', 'pose_cells', 'experience_map'})
MAPPING_TOPICS = (TEMPLATE, ACTION)
"""The mapping nodes, and the topics between them, whose connections are awaited too."""

READERS = {TEMPLATE: 'pose_cells', ACTION: 'experience_map', ODOM: 'pose_cells'}
"""Node that reads each of these topics; in one process with the writer, it does not subscribe."""

UNKNOWN_NODE = '_NODE_NAME_UNKNOWN_'
"""Name that rclpy gives to a node whose name has not arrived yet."""

SETTLE_S = 0.3
"""Delay after all connections are visible, because the other side may see them later."""

SILENT_WAIT_S = 1.0
"""Time of waiting for subscribers without a notice."""

START_TIMEOUT_S = 180.0
"""Longest time to wait for nodes that are starting on this machine."""

ACKNOWLEDGE_TIMEOUT_S = 10.0
CLOCK_PERIOD_S = 0.02
POLL_S = 0.002


def play(recording: Recording, selection: Selection, options: argparse.Namespace) -> str:
    """Publish a recording.

    Args:
        recording: the recording.
        selection: its topics to publish.
        options: those of ``ratslam play``.

    Returns:
        A summary in one line.

    Raises:
        UnusableInput: an option is out of range, the recording has nothing to play, no node
            subscribes, or pose_cells is missing in lockstep.
    """
    if not (math.isfinite(options.rate) and options.rate >= 0.0):
        raise UnusableInput(
            f'--rate {options.rate:g}: expected 0 (as fast as possible) or more, 1 for real time'
        )
    if not options.wait >= 0.0:
        raise UnusableInput(f'--wait {options.wait:g}: expected 0 s or more')
    with ros.node('player', options.ros_args) as node:
        player = _Player(node, recording, selection, options)
        player.wait_for_subscribers()
        try:
            player.run()
        finally:
            player.close()
        return player.summary()


class _Player:
    """Node that publishes one recording, once or in a loop."""

    def __init__(
        self, node: Any, recording: Recording, selection: Selection, options: argparse.Namespace
    ) -> None:
        self._node = node
        self._recording = recording
        self._selection = selection
        self._options = options
        self._counts: Counter[str] = Counter()
        self._played_s = 0.0
        self._elapsed_s = 0.0
        played = [topic for topic in recording.topics if topic.name in selection.topics]
        # Further lasers are played as they were recorded, in the namespace of the node.
        further = {name: name.lstrip('/') for name in selection.scan_topics[1:]}
        self._further_lasers = list(further.values())
        kinds = {
            further.get(topic.name, name): kind
            for topic in played for kind, name in [PLAYED_AS[topic.type]]
        }
        self._publishers = {
            name: node.create_publisher(kind, name, PLAYED) for name, kind in kinds.items()
        }
        self._calibration = recording.calibration(selection)
        self._camera_info = (
            node.create_publisher(CameraInfo, CAMERA_INFO, PLAYED) if self._calibration else None
        )
        # Nothing else publishes odom -> base_link in place of the robot.
        self._tf = node.create_publisher(TFMessage, '/tf', STATE) if ODOM in kinds else None
        mounts = []
        for topic in selection.scan_topics:
            one = replace(selection, scan_topic=topic)
            frames = recording.laser_frames(one)
            if frames is not None and frames.laser not in ('', BASE_FRAME):
                mount = laser_mount(recording, one)
                mounts.append(mount_of(frames.laser, mount, recording.start_ns))
        if mounts:
            static = node.create_publisher(TFMessage, '/tf_static', STATIC)
            static.publish(TFMessage(transforms=mounts))
        self._clock = node.create_publisher(Clock, '/clock', CLOCK) if options.clock else None
        self._history = History(node)
        self._actions = (
            ActionWait(node, selection.odom_topic is not None)
            if options.lockstep else None
        )

    def wait_for_subscribers(self) -> None:
        """Wait until all expected subscribers and publishers are visible.

        Raises:
            UnusableInput: no node subscribes, or pose_cells is missing in lockstep.
        """
        if self._options.wait == 0.0:
            return
        with ticking('waiting:', not self._options.quiet):
            self._wait()
            time.sleep(SETTLE_S)
        missing = self._missing()
        publishers = self._publishers.values()
        if missing and not any(one.get_subscription_count() for one in publishers):
            names = ' or '.join(one.topic_name for one in publishers)
            raise UnusableInput(
                f'no node subscribes to {names}: start the nodes first (ratslam launch), in the '
                'same namespace and with the same ROS_DOMAIN_ID, or wait longer with --wait'
            )
        action = self._node.resolve_topic_name(ACTION)
        if self._actions is not None and not self._node.count_publishers(action):
            raise UnusableInput(
                f'--lockstep waits for {action}, which no node publishes: start pose_cells, or '
                'leave out --lockstep'
            )
        if missing:
            print_notice(f'warning: going on without {", ".join(missing)}')

    def _wait(self) -> None:
        """Wait for missing connections, and as long as nodes start on this machine."""
        start_s = time.monotonic()
        end_s = start_s + self._options.wait
        shown: list[str] | None = None
        while True:
            names, now_s = starting(), time.monotonic()
            if names:
                end_s = min(now_s + self._options.wait, start_s + START_TIMEOUT_S)
            missing = self._missing()
            if now_s >= end_s or not (names or missing):
                return
            if names != shown and now_s - start_s >= SILENT_WAIT_S:
                nodes = [f'{name} to start' for name in names]
                slow = ' (a first start compiles for about half a minute)' if names else ''
                print_notice(f'waiting for {", ".join(nodes or missing)}{slow}')
                shown = names
            time.sleep(POLL_S)

    def run(self) -> None:
        """Publish the recording, repeatedly with the option loop."""
        start_s = time.monotonic()
        try:
            while True:
                self._pass()
                if not self._options.loop:
                    break
            for publisher in self._publishers.values():
                if not publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_TIMEOUT_S)):
                    print_notice(
                        f'warning: {publisher.topic_name}: not all messages were received within '
                        f'{ACKNOWLEDGE_TIMEOUT_S:g} s of the last one'
                    )
        finally:
            self._elapsed_s = time.monotonic() - start_s

    def close(self) -> None:
        """Print warnings about missed actions and about the recording."""
        if self._actions is not None and self._actions.missed:
            print_notice(
                f'warning: {self._actions.missed} actions did not arrive within '
                f'{ACTION_TIMEOUT_S:g} s; check the diagnostics of local_view and pose_cells'
            )
        for warning in self._recording.warnings:
            print_notice(f'warning: {warning}')

    def summary(self) -> str:
        """Return number of messages, duration and speed in one line."""
        odometry, templates = self._counts[ODOM], self._counts[TEMPLATE]
        scans = sum(self._counts[topic] for topic in (SCAN, *self._further_lasers))
        views = self._counts.total() - odometry - templates - scans
        counts = [f'{views} images' if views or not templates else f'{templates} templates']
        if scans:
            counts.append(f'{scans} scans')
        skipped = self._recording.skipped
        return (
            f'{", ".join(counts)} and {odometry} odometry messages over {self._played_s:.1f} s, '
            f'in {self._elapsed_s:.1f} s ({self._played_s / max(self._elapsed_s, 1e-6):.2f}x real '
            f'time){f", {skipped} skipped" if skipped else ""}'
        )

    def _pass(self) -> None:
        options, recording = self._options, self._recording
        length_s = (recording.end_ns - recording.start_ns) * 1e-9 - options.start
        if options.duration is not None:
            length_s = min(length_s, options.duration)
        events = recording.events(self._selection, options.start, options.duration)
        with ExitStack() as stack:
            ready = stack.enter_context(prefetch((event, message_of(event)) for event in events))
            bar = stack.enter_context(ProgressBar(length_s, shown=not options.quiet))
            pacing = None
            for event, message in ready:
                if pacing is None:
                    pacing = Pacing(event.log_ns, options.rate)
                    if self._clock is not None:
                        stack.enter_context(_running_clock(self._clock, pacing))
                time.sleep(pacing.wait_s(event.log_ns))
                if self._actions is not None:
                    self._actions.wait_before(event)
                self._publish(event, message)
                pacing.published(event.log_ns)
                bar.update(pacing.played_s)
            if self._actions is not None:
                self._actions.wait()
            if pacing is not None:
                self._played_s += pacing.played_s

    def _publish(self, event: Event, message: Any) -> None:
        topic = TOPICS[type(message)]
        if isinstance(event, ScanEvent) and event.laser:
            topic = self._further_lasers[event.laser - 1]
        if self._actions is not None:
            self._actions.add(event)
        if self._calibration is not None and isinstance(event, ImageEvent):
            ros.send(self._camera_info, camera_info(self._calibration.message, message.header))
        ros.send(self._publishers[topic], message)
        self._history.add(topic, message)
        if self._tf is not None and isinstance(message, Odometry):
            transform = transform_of(message)
            if transform is not None:
                self._tf.publish(TFMessage(transforms=[transform]))
        self._counts[topic] += 1

    def _missing(self) -> list[str]:
        """Return the missing publishers and subscribers, in words."""
        node, missing = self._node, []
        for publisher in self._publishers.values():
            name = publisher.topic_name
            if not publisher.get_subscription_count():
                missing.append(f'a subscriber of {name}')
            # The name of a node may become visible after its subscriptions.
            readers = node.get_subscriptions_info_by_topic(name)
            if any(reader.node_name == UNKNOWN_NODE for reader in readers):
                missing.append(f'the name of the node that reads {name}')
        names_here = {
            name
            for name, namespace in node.get_node_names_and_namespaces()
            if namespace == node.get_namespace()
        }
        if names_here & MAPPING_NODES or self._actions is not None:
            own = () if self._selection.odom_topic else (ODOM,)
            for topic in (*MAPPING_TOPICS, *own):
                full = node.resolve_topic_name(topic)
                if not node.count_publishers(full):
                    missing.append(f'a publisher of {full}')
                if READERS[topic] not in names_here and not node.count_subscribers(full) - (
                    topic == ACTION and self._actions is not None
                ):
                    missing.append(f'a subscriber of {full}')
        return list(dict.fromkeys(missing))


@contextmanager
def _running_clock(publisher: Any, pacing: Pacing) -> Iterator[None]:
    """Publish the time of the recording on /clock, between messages too."""
    stopped = threading.Event()

    def publish() -> None:
        publisher.publish(Clock(clock=time_of(pacing.time_ns())))

    def run() -> None:
        publish()
        while not stopped.wait(CLOCK_PERIOD_S):
            publish()

    thread = threading.Thread(target=run, name='clock', daemon=True)
    thread.start()
    try:
        yield
    finally:
        stopped.set()
        thread.join()
        publish()  # The last time is that of the last message.
