# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node of the live view: the topics of all nodes -> a page in a browser."""

from __future__ import annotations

import time
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan, points_of
from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.files.config import to_yaml
from ratslam_ros.ros.parameters import declare
from ratslam_ros.ros.viewing.viewer_controls import RosControls
from ratslam_ros.ros.viewing.viewer_topics import ViewerTopics
from ratslam_ros.viewer.config import NO_FILE, ViewerParameters
from ratslam_ros.viewer.desktop import open_browser
from ratslam_ros.viewer.live_run import LiveRun

CHECK_PERIOD_S = 0.25
"""Period of the checks whether a browser is connected."""

GRACE_S = 60.0
"""Time for which messages are received after the last browser has left, so that reloading the page
loses nothing."""

SILENCE_S = 5.0
"""Time without a message after which a topic is reported as missing: the default of
`watchdog_after_s`."""


class ViewerNode(Node):  # type: ignore[misc]
    """Shows the run in a browser; subscribes only while one is connected or a file is written."""

    SECTION = 'viewer'

    def __init__(self) -> None:
        from ratslam_ros.viewer.app import Page
        from ratslam_ros.viewer.server import ViewServer

        super().__init__(self.SECTION, automatically_declare_parameters_from_overrides=True)
        with ExitStack() as begun:
            begun.callback(self.destroy_node)
            self._p = declare(self, ViewerParameters)
            # Before the history: without a port, there is no run that could have one.
            server = ViewServer(self._p.host, self._p.port)
            begun.callback(server.stop)
            name = self.get_namespace().strip('/')
            given = self._p.history_file
            path = None if given == NO_FILE else Path(given).expanduser()
            self.run = LiveRun(f'live: {name}' if name else 'live', path)
            self.controls = RosControls(self)
            self._page = Page(server, self.run, self.controls)
            begun.pop_all()
        self.topics: ViewerTopics | None = None
        """What receives messages, while that is wanted."""
        self._frames: dict[str, Pose] = {}
        self._seen_s = -GRACE_S
        self._missing = ''
        self._values: object = None
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(CHECK_PERIOD_S, self._check, clock=steady)
        # Not logged: /rosout would send the token to everyone.
        print(f'view: {server.url}', flush=True)
        if self._p.open_browser:
            open_browser(server.url)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load from the cache the conversion of scans."""
        points_of(Scan(0, 0.0, 1.0, np.ones(1)))

    def close(self) -> None:
        """End the page; its browsers show that the connection is lost."""
        self._page.close()
        self.run.close()

    @property
    def error(self) -> BaseException | None:
        """The exception that ended the loop that draws, if any; ``run`` raises it."""
        return self._page.error

    def _check(self) -> None:
        """Subscribe or unsubscribe, and report topics that are silent."""
        now_s = time.monotonic()
        if self._page.server.client_count > 0:
            self._seen_s = now_s
        is_wanted = self._p.history_file != NO_FILE or now_s - self._seen_s < GRACE_S
        if is_wanted:
            if self.topics is None:
                self.topics = ViewerTopics(self, self.run, self.controls, self._frames)
            self.controls.refresh()
            self._use_values()
            self.topics.map.request_if_needed()
            self._report(self.topics.missing(SILENCE_S))
        elif self.topics is not None:
            self.topics.close()
            self.topics = None

    def _use_values(self) -> None:
        """Have the run and its history contain the parameters of the nodes."""
        values = self.controls.values
        if values == self._values:
            return
        self._values = values
        self.run.required_views = float(values['pose_cells.pc_vt_agree_views'])
        with suppress(UnusableParameter):  # of nodes of another version
            self.run.configure(to_yaml(Config().with_values(values)))

    def _report(self, text: str) -> None:
        if text != self._missing:
            self._missing = text
            self.run.problems.pop('missing', None)
            if text:
                self.run.problems['missing'] = text
                self.get_logger().warning(text)
