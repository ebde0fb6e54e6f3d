# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Managed nodes: the states of the ROS 2 life cycle for any of the nodes.

    unconfigured --configure--> inactive --activate--> active
         ^---------cleanup---------/  ^---deactivate-----/

Parameters are declared and checked when the process starts. `configure` opens the map file and
restores its map; it fails, with the reason in the log, if the file cannot be used. Only an active
node processes messages: others are ignored, and counted as `paused`. `deactivate` processes what
is held and saves; the robot may be elsewhere when the node is activated again. `cleanup` saves and
closes the map file, and empties the memory. `shutdown` saves and closes it too.
"""

from __future__ import annotations

from typing import Any

from ratslam_ros.errors import RatslamError, UnusableInput
from ratslam_ros.pipeline.commands import Reset, SetPaused

LIFECYCLE, AUTOSTART = '--lifecycle', '--autostart'
"""Arguments of a node's process: it is managed, and activates itself."""


def managed(kind: Any) -> type[Any]:
    """Return a class of the same nodes with the states of the life cycle.

    Args:
        kind: class of RatslamNodes whose constructor takes the initial configuration.

    Raises:
        UnusableInput: rclpy has no managed nodes.
    """
    try:
        from rclpy.lifecycle import LifecycleNodeMixin, TransitionCallbackReturn
    except ImportError:
        raise UnusableInput(
            f'{LIFECYCLE} needs ROS 2: the stand-in for rclpy has no managed nodes; leave it out '
            '(lifecycle:=false)'
        ) from None
    done, failed = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE

    class Managed(LifecycleNodeMixin, kind):  # type: ignore[misc]
        def __init__(self, initial: Any, host: Any = None) -> None:
            kind.__init__(self, initial, host)
            LifecycleNodeMixin.__init__(self)
            self._was_active = False
            self._failure = ''

        def connect(self, pipeline: Any) -> None:
            super().connect(pipeline)
            self._is_active = False
            self._update_halted()

        def start(self) -> None:
            """Configure and activate the node; raises UnusableInput if that fails."""
            if self.trigger_configure() != done:
                raise UnusableInput(self._failure)
            self.trigger_activate()

        def on_configure(self, state: Any) -> Any:
            try:
                if self.host.nodes[0] is self:
                    self.host.map.restore()
            except RatslamError as error:
                self._failure = str(error)
                self.get_logger().error(self._failure)
                return failed
            return done

        def on_activate(self, state: Any) -> Any:
            self._is_active = True
            if self._was_active or self._is_paused:
                self._update_halted()
            else:
                with self._lock:
                    self.host.live.carry_out(SetPaused(False, self.SECTION))
            self._was_active = True
            if all(node._is_active for node in self.host.nodes):
                self.host.map.catch_up()
            return done

        def on_deactivate(self, state: Any) -> Any:
            self._is_active = False
            with self._lock:
                self._update_halted()
                self.host.map.save()
            return done

        def on_cleanup(self, state: Any) -> Any:
            self.host.map.close()
            self.host.command(Reset(self.SECTION))
            self._was_active = False
            return done

        def on_shutdown(self, state: Any) -> Any:
            self.host.map.close()
            self._is_active = False
            self._update_halted()
            return done

        def _state(self) -> str:
            _, label = self._state_machine.current_state
            return super()._state() if self._is_active else str(label)

    Managed.__name__ = Managed.__qualname__ = kind.__name__
    return Managed
