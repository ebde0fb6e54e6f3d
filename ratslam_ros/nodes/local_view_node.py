# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node of the local view: image -> local_view/template."""

from __future__ import annotations

from typing import Any

import numpy as np
from nav_msgs.msg import Odometry as OdometryMessage
from numpy.typing import NDArray
from sensor_msgs.msg import Image
from std_msgs.msg import String

from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.id_map import MIN_MEMORY_NS, NO_MEMORY_NS
from ratslam_ros.core.vision.local_view import (
    FIXED_THRESHOLD,
    NO_TEMPLATE,
    ODOMETRY_DELAY_NS,
    UNDECODABLE,
    LocalView,
    ViewMatch,
    delayed_ns,
    uses_odometry,
)
from ratslam_ros.descriptors import encoder_of
from ratslam_ros.messages.logged import decode_odometry
from ratslam_ros.messages.mapping import decode_template, encode_template
from ratslam_ros.nodes.convert import grey_image, odometry_of
from ratslam_ros.nodes.image_node import ImageNode
from ratslam_ros.nodes.match_pictures import joined
from ratslam_ros.nodes.qos import RESULT, VIEW
from ratslam_ros.nodes.run import run
from ratslam_ros.pipeline.order import StampOrder


class LocalViewNode(ImageNode):
    """Matches each image with the learned templates and publishes one template message."""

    SECTION = 'local_view'
    MAPS = True
    REPEATS = ('template',)

    def __init__(self, initial: Config = Config()) -> None:
        super().__init__(initial)
        self._publisher = self.create_publisher(String, 'local_view/template', RESULT)
        self._matched = self.create_publisher(Image, 'local_view/matched', VIEW)
        try:
            self._encoder = encoder_of(self._section)
        except BaseException:
            self.destroy_node()  # the caller gets no node that it could destroy
            raise
        self._reset_state()
        if uses_odometry(self._first_section):
            self._add_input(
                'odometry', {'odom': OdometryMessage}, self._on_odometry,
                lambda data: self._follow(decode_odometry(data)), delay_ns=ODOMETRY_DELAY_NS,
            )  # fmt: skip
        self._subscribe_to_images()

    def _reset_state(self) -> None:
        self._core = self._new_core()
        self._core.mapping = self._mapping
        self._memory_ns = NO_MEMORY_NS
        self._last = UNDECODABLE

    def _new_core(self) -> LocalView:
        core = LocalView(self._first_section, self._encoder)
        core.reconfigure(self._section)
        return core

    def _reconfigure(self, section: Any) -> None:
        self._core.reconfigure(section)

    def _set_mapping(self, mapping: bool) -> None:
        self._core.mapping = mapping

    def _memory_state(self) -> State:
        return {'memory_ns': self._memory_ns, 'core': self._core.state()}

    def _restore(self, state: State) -> None:
        core = self._new_core()
        core.restore(state['core'])
        # A replay has no other memory that its ids could be confused with.
        assumed_ns = MIN_MEMORY_NS if len(core) else NO_MEMORY_NS
        self._memory_ns = int(state.get('memory_ns', assumed_ns))
        self._core = core
        self._core.mapping = self._mapping

    def _new_order(self) -> StampOrder[Any]:
        if uses_odometry(self._first_section):
            return StampOrder(
                ('odometry', 'image'), round(self._section.max_lateness_s * 1e9),
                is_patient=self._is_restart_expected,
            )  # fmt: skip
        return StampOrder(('image',), 0)

    def _last_of_session_ns(self) -> int | None:
        """Leave out odometry that is delayed beyond the last image: no other node is so far."""
        return self._order.newest_of('image')

    def _on_odometry(self, message: OdometryMessage) -> None:
        self._follow(odometry_of(message))

    def _follow(self, odometry: Odometry) -> None:
        with self._lock:
            self._push('odometry', delayed_ns(odometry.stamp_ns), odometry)

    def _on_relocated(self) -> None:
        self._core.relocated()

    def _process_item(self, stamp_ns: int, stream: str, item: Any) -> None:
        if isinstance(item, Odometry):
            self._core.follow(item)
        else:
            super()._process_item(stamp_ns, stream, item)

    def _on_caught_up(self, are_images_lost: bool) -> None:
        """Use no id of a template again that was learned from an image that is lost."""
        assert self._keeper is not None
        if are_images_lost:
            last_id = NO_TEMPLATE
            for _, data in self._keeper.logged('template'):
                _, match, memory_ns = decode_template(data.decode())
                if memory_ns == self._memory_ns:
                    last_id = max(last_id, match.template_id)
            self._core.skip_ids(last_id + 1)

    def _process_image(self, stamp_ns: int, image: NDArray[np.uint8], frame_id: str) -> None:
        with self._diagnostics.times('local_view'):
            match = self._core.match(image, stamp_ns)
        if match.is_new and self._memory_ns == NO_MEMORY_NS:
            self._memory_ns = max(stamp_ns, MIN_MEMORY_NS)
        self._publish(stamp_ns, match)
        if self._matched.get_subscription_count() > 0:
            self._publish_matched(stamp_ns, image, frame_id, match)

    def _process_undecodable(self, stamp_ns: int) -> None:
        self._publish(stamp_ns, UNDECODABLE)

    def _publish(self, stamp_ns: int, match: ViewMatch) -> None:
        self._last = match
        payload = encode_template(stamp_ns, match, self._memory_ns, self._sender_id)
        self._publisher.publish(String(data=payload))
        self._log('template', stamp_ns, payload.encode)

    def _publish_matched(
        self, stamp_ns: int, image: NDArray[np.uint8], frame_id: str, match: ViewMatch
    ) -> None:
        """Publish the view as it was compared, above the template that it matched."""
        view = self._core.encode(image)
        if view is None:
            return
        template = np.zeros_like(view)
        if match.template_id >= 0:
            template = self._core.template(match.template_id)
        both = joined(self._core.picture(view), self._core.picture(template))
        self._matched.publish(grey_image(stamp_ns, frame_id, both))

    def _diagnostic_values(self) -> dict[str, Any]:
        return {
            **super()._diagnostic_values(),
            'templates': len(self._core),
            'low_texture': self._core.low_texture,
            'template': self._last.template_id,
            'match_error': round(self._last.error, 4),
            **(
                {'match_threshold': round(self._last.threshold, 4)}
                if self._last.threshold != FIXED_THRESHOLD else {}
            ),
        }


def main(args: list[str] | None = None) -> int:
    """Run the node until it is interrupted."""
    return run(LocalViewNode, args=args)
