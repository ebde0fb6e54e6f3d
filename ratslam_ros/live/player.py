# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ratslam play: a recording as live topics, complete and in order."""

from __future__ import annotations

import json
import math
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Self

import rclpy
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, LaserScan
from std_msgs.msg import String

from ratslam_ros.errors import UnusableInput
from ratslam_ros.live import graph, ros
from ratslam_ros.live.lockstep import Lockstep
from ratslam_ros.live.messages import camera_info, message_of, time_message
from ratslam_ros.live.pacing import Pacing
from ratslam_ros.nodes.qos import CLOCK, INPUT, PLAYED
from ratslam_ros.progress import ProgressBar
from ratslam_ros.recordings import Event, ImageEvent, OdometryEvent, Recording, Selection
from ratslam_ros.recordings.prefetch import Prefetch
from ratslam_ros.recordings.topics import (
    COMPRESSED_IMAGE,
    IMAGE_FILES,
    LASER_SCAN,
    ODOMETRY,
    RAW_IMAGE,
    STRING,
    TABLE,
    VIDEO,
)

ODOM, SCAN, ACTION, TEMPLATE = 'odom', 'scan', 'pose_cells/action', 'local_view/template'
CAMERA_INFO = 'camera_info'
TOPICS = {
    Image: 'image',
    CompressedImage: 'image/compressed',
    Odometry: ODOM,
    LaserScan: SCAN,
    String: TEMPLATE,
}
"""Where messages of each type are published."""
PLAYED_AS = {
    RAW_IMAGE: Image,
    VIDEO: Image,
    COMPRESSED_IMAGE: CompressedImage,
    IMAGE_FILES: CompressedImage,
    ODOMETRY: Odometry,
    TABLE: Odometry,
    LASER_SCAN: LaserScan,
    STRING: String,
}
"""Which message a recorded topic is published as, by its type."""
OWN_TOPICS = (TEMPLATE, ACTION)
OWN_NODES = frozenset({'local_view', 'pose_cells', 'experience_map'})
"""The nodes between which nothing may be lost either, and the topics that join them."""

SETTLE_S = 0.3  # the other side may learn of a connection a little later than this one
TELL_S = 1.0
CLOCK_PERIOD_S = 0.02
ACTION_S = 10.0
SPREAD_S = 0.05
AHEAD_NS = 1_000_000_000  # the half of max_lateness_s, as it is by default
POLL_S = 0.002
PATIENCE_S = 30.0
ACKNOWLEDGED_S = 10.0


@dataclass(frozen=True)
class PlayOptions:
    """What of a recording is played, and how."""

    rate: float = 1.0
    clock: bool = False
    loop: bool = False
    lockstep: bool = False
    start_s: float = 0.0
    duration_s: float | None = None
    wait_s: float = 10.0
    progress: bool = True

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate) and self.rate >= 0.0):
            raise UnusableInput(
                f'--rate {self.rate:g}: expected 0 (as fast as possible) or more, 1 for real time'
            )
        if not self.wait_s >= 0.0:
            raise UnusableInput(f'--wait {self.wait_s:g}: expected 0 s or more')


def play(
    recording: Recording,
    selection: Selection,
    options: PlayOptions,
    ros_arguments: Sequence[str] = (),
) -> str:
    """Play a recording, and return how that went in a line.

    Raises:
        UnusableInput: nothing to play, nobody to play it to, or no node to keep step with.
    """
    with ros.node('player', ros_arguments) as node:
        player = _Player(node, recording, selection, options)
        player.wait_for_listeners()
        try:
            player.run()
        finally:
            player.close()
        return player.summary()


class _Player:
    """One node that plays one recording, once or in a loop."""

    def __init__(
        self, node: Any, recording: Recording, selection: Selection, options: PlayOptions
    ) -> None:
        self._node = node
        self._recording = recording
        self._selection = selection
        self._options = options
        self._counts: Counter[str] = Counter()
        self._played_s = 0.0
        self._start_s = time.monotonic()
        self._elapsed_s = 0.0
        played = [topic for topic in recording.topics if topic.name in selection.topics]
        kinds = [PLAYED_AS[topic.type] for topic in played]
        self._publishers = {
            TOPICS[kind]: node.create_publisher(kind, TOPICS[kind], PLAYED) for kind in kinds
        }
        self._calibration = recording.calibration(selection)
        self._camera_info = (
            node.create_publisher(CameraInfo, CAMERA_INFO, PLAYED) if self._calibration else None
        )
        self._clock = node.create_publisher(Clock, '/clock', CLOCK) if options.clock else None
        self._actions = (
            _Actions(node, selection.odom_topic is not None) if options.lockstep else None
        )

    def wait_for_listeners(self) -> None:
        """Wait until nothing can be lost at the start, as far as that can be told from here."""
        if self._options.wait_s == 0.0:
            return
        end_s = time.monotonic() + self._options.wait_s
        if not graph.until(lambda: not self._missing(), min(TELL_S, self._options.wait_s)):
            _say(f'waiting for {", ".join(self._missing())}')
            graph.until(lambda: not self._missing(), end_s - time.monotonic())
        missing = self._missing()
        if missing and not any(map(_listeners, self._publishers.values())):
            raise UnusableInput(
                f'nobody listens to {" or ".join(self._full_names())}: start the nodes first '
                '(ratslam launch), in the same namespace and with the same ROS_DOMAIN_ID, or wait '
                'longer with --wait'
            )
        action = self._node.resolve_topic_name(ACTION)
        if self._actions is not None and not self._node.count_publishers(action):
            raise UnusableInput(
                f'--lockstep waits for {action}, which nobody publishes: start pose_cells, or '
                'leave out --lockstep'
            )
        if missing:
            _say(f'warning: going on without {", ".join(missing)}')
        time.sleep(SETTLE_S)

    def run(self) -> None:
        """Publish everything, again and again if that is asked for."""
        self._start_s = time.monotonic()
        try:
            while True:
                self._pass()
                if not self._options.loop:
                    break
            for publisher in self._publishers.values():
                self._acknowledged(publisher)
        finally:
            self._elapsed_s = time.monotonic() - self._start_s

    def close(self) -> None:
        """Tell what went wrong on the way."""
        if self._actions is not None and self._actions.missed:
            _say(
                f'warning: {self._actions.missed} actions did not come within {ACTION_S:g} s; '
                'look at the diagnostics of local_view and pose_cells'
            )
        for warning in self._recording.warnings:
            _say(f'warning: {warning}')

    def summary(self) -> str:
        """Return what was published."""
        odometry, templates, scans = (self._counts[topic] for topic in (ODOM, TEMPLATE, SCAN))
        views = self._counts.total() - odometry - templates - scans
        told = [f'{views} images' if views or not templates else f'{templates} templates']
        if scans:
            told.append(f'{scans} scans')
        skipped = self._recording.skipped
        return (
            f'{", ".join(told)} and {odometry} odometry messages over {self._played_s:.1f} s, in '
            f'{self._elapsed_s:.1f} s ({self._played_s / max(self._elapsed_s, 1e-6):.2f}x real '
            f'time){f", {skipped} skipped" if skipped else ""}'
        )

    def _pass(self) -> None:
        options = self._options
        events = self._recording.events(self._selection, options.start_s, options.duration_s)
        with ExitStack() as stack:
            ready = stack.enter_context(Prefetch((event, message_of(event)) for event in events))
            bar = stack.enter_context(
                ProgressBar(
                    self._recording, options.start_s, options.duration_s, shown=options.progress
                )
            )
            pacing = None
            for event, message in ready:
                if pacing is None:
                    pacing = Pacing(event.log_ns, options.rate)
                    if self._clock is not None:
                        stack.enter_context(_ClockThread(self._clock, pacing))
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
        if self._actions is not None:
            self._actions.published(event)
        if self._camera_info is not None and isinstance(event, ImageEvent):
            assert self._calibration is not None
            send(self._camera_info, camera_info(self._calibration.message, message.header))
        send(self._publishers[topic], message)
        self._counts[topic] += 1

    def _missing(self) -> list[str]:
        """Return whom the first message would be lost on."""
        names = zip(self._publishers.values(), self._full_names(), strict=True)
        missing = [
            f'a subscriber of {name}' for publisher, name in names if not _listeners(publisher)
        ]
        node = self._node
        seen = {
            name
            for name, namespace in node.get_node_names_and_namespaces()
            if namespace == node.get_namespace()
        }
        if seen & OWN_NODES or self._actions is not None:
            for topic in OWN_TOPICS:
                full = node.resolve_topic_name(topic)
                if not node.count_publishers(full):
                    missing.append(f'a publisher of {full}')
                if not node.count_subscribers(full) - (
                    topic == ACTION and self._actions is not None
                ):
                    missing.append(f'a subscriber of {full}')
        return list(dict.fromkeys(missing))

    def _full_names(self) -> list[str]:
        return [self._node.resolve_topic_name(topic) for topic in self._publishers]

    def _acknowledged(self, publisher: Any) -> None:
        if not publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED_S)):
            _say(
                f'warning: {publisher.topic_name}: not all messages were received within '
                f'{ACKNOWLEDGED_S:g} s of the last one'
            )


class _Actions:
    """The actions that come back, for playing in lockstep.

    An action has to be known to experience_map too before stamps go on by as much as counts as
    late there. It gets it from pose_cells at the same moment as this node, give or take how
    busy the machine is: SPREAD_S is allowed for that.
    """

    def __init__(self, node: Any, odometry_is_played: bool) -> None:
        self.missed = 0
        self._node = node
        self._lockstep = Lockstep(odometry_is_played)
        self._awaited: set[int] = set()
        self._came: deque[tuple[int, float]] = deque()
        node.create_subscription(String, ACTION, self._take, INPUT)

    def published(self, event: Event) -> None:
        """Note what goes out; to be called before it does."""
        self._awaited.update(self._lockstep.publish(event))

    def wait_before(self, event: Event) -> None:
        """Wait for all that a message may not overtake."""
        far_ns = event.stamp_ns - AHEAD_NS
        self.wait(far_ns if isinstance(event, OdometryEvent) else None)
        while any(stamp_ns < far_ns for stamp_ns, _ in self._fresh()):
            time.sleep(POLL_S)

    def wait(self, before_ns: int | None = None) -> None:
        """Wait until the views that the nodes can act on have been acted on.

        Args:
            before_ns: wait only for views with smaller stamps.
        """
        end_s = time.monotonic() + ACTION_S
        while awaited := [s for s in self._awaited if before_ns is None or s < before_ns]:
            rclpy.spin_once(self._node, timeout_sec=0.1)
            if time.monotonic() < end_s:
                continue
            if not self._node.count_publishers(self._node.resolve_topic_name(ACTION)):
                raise UnusableInput('--lockstep: pose_cells is gone; start the nodes again')
            if not self.missed:
                _say(
                    f'warning: no {self._node.resolve_topic_name(ACTION)} came for the image with '
                    f'stamp {min(awaited) * 1e-9:.3f} s within {ACTION_S:g} s; going on'
                )
            self.missed += len(awaited)
            self._awaited.difference_update(awaited)

    def _fresh(self) -> deque[tuple[int, float]]:
        """Return the stamps of actions that others may not have received yet."""
        while self._came and time.monotonic() - self._came[0][1] > SPREAD_S:
            self._came.popleft()
        return self._came

    def _take(self, message: String) -> None:
        try:
            stamp = json.loads(message.data)['stamp']
            stamp_ns = stamp['sec'] * 1_000_000_000 + stamp['nanosec']
        except (ValueError, KeyError, TypeError, RecursionError):
            return  # not an action; experience_map says what is wrong with it
        self._awaited.discard(stamp_ns)
        self._came.append((stamp_ns, time.monotonic()))


class _ClockThread:
    """Publishes the recording's time, between messages too."""

    def __init__(self, publisher: Any, pacing: Pacing) -> None:
        self._publisher = publisher
        self._pacing = pacing
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name='clock', daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join()
        self._publish()  # where the recording ended

    def _run(self) -> None:
        self._publish()
        while not self._stopped.wait(CLOCK_PERIOD_S):
            self._publish()

    def _publish(self) -> None:
        self._publisher.publish(Clock(clock=time_message(self._pacing.time_ns())))


def send(publisher: Any, message: Any, patience_s: float = PATIENCE_S) -> None:
    """Publish, however slow the subscribers are.

    Fast DDS waits for them for a tenth of a second only, and then refuses the message.
    """
    end_s = time.monotonic() + patience_s
    while True:
        try:
            publisher.publish(message)
        except RuntimeError as error:
            if time.monotonic() > end_s:
                raise UnusableInput(
                    f'{publisher.topic_name}: nothing can be published for {patience_s:g} s '
                    f'({error}); look for a subscriber that hangs'
                ) from None
            time.sleep(POLL_S)
        else:
            return


def _listeners(publisher: Any) -> int:
    return int(publisher.get_subscription_count())


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
