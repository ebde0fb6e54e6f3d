# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Route loss recovery of Milford et al. (2006), section IV.D, as printed.

``RouteFollowing.update`` uses it instead of the position on the map if
``goal_recall.route_position`` is ``elapsed_time``.
"""

from __future__ import annotations

from ratslam_ros.core.navigation.tracked_route import TrackedRoute


class RouteLoss:
    """Position on the last route by elapsed time, while no route leads to the goal."""

    def __init__(self) -> None:
        self._last_ns = 0
        self.is_lost = False
        """Whether the last known route is followed, as there is no other one."""

    def update(
        self, stamp_ns: int, last: TrackedRoute | None, planned: TrackedRoute | None
    ) -> TrackedRoute | None:
        """Return the last route while there is no plan, advanced by the time since the last call.

        Args:
            stamp_ns: current stamp.
            last: the route that is followed.
            planned: the route from the current experience, None if there is none.

        Returns:
            The route to follow; None if the plan replaces the route that was followed by time.
        """
        elapsed_s = (stamp_ns - self._last_ns) * 1e-9
        was_lost, self.is_lost = self.is_lost, planned is None and last is not None
        self._last_ns = stamp_ns
        if last is not None and planned is None:
            last.advance_by_time(elapsed_s)
        return last if self.is_lost or not was_lost else None
