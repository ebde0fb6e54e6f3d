# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the two nodes that process images."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, Image

from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.images import UndecodableImage, image_of
from ratslam_ros.nodes.backlog import Backlog
from ratslam_ros.nodes.convert import stamp_ns
from ratslam_ros.nodes.node import FLUSH_CHECK_PERIOD_S, RatslamNode

Message = Any
"""A sensor_msgs Image or CompressedImage."""


class ImageNode(RatslamNode[Message]):
    """A node that processes every image, raw or compressed, in a thread beside the executor."""

    def __init__(self, initial: Config = Config()) -> None:
        super().__init__(('image',), initial)
        self.error: BaseException | None = None
        """The exception that ended the thread, if any; ``run`` raises it."""
        self._backlog: Backlog[Message] = Backlog(self._process_message, self._failed)

    def _subscribe_to_images(self) -> None:
        """Subscribe; must be the last step of the constructor."""
        self._add_input('image', self._topics(), self._on_image, resume=self._process_message)
        self.create_timer(FLUSH_CHECK_PERIOD_S, self._flush, clock=self._steady)

    def _topics(self) -> dict[str, type]:
        transport = self._section.image_transport
        return {
            topic: kind for topic, name, kind in (
                ('image', 'raw', Image), ('image/compressed', 'compressed', CompressedImage)
            )
            if transport in ('auto', name)
        }  # fmt: skip

    def _on_set(self, before: Config) -> None:
        if getattr(before, self.SECTION).image_transport != self._section.image_transport:
            for one in self._inputs:
                if one.name == 'image':
                    one.use(self._topics())

    def close(self) -> None:
        """Process the current image, drop the queued ones, and stop."""
        dropped = self._backlog.close() + self._drop_queued()
        if dropped:
            self.get_logger().warning(f'{dropped} queued images were dropped at the end')
        super().close()

    def _on_image(self, message: Message) -> None:
        if not self._backlog.put(message, len(message.data)):
            self._diagnostics.drop(
                'dropped',
                'an image was dropped: images arrive faster than they are processed; lower the '
                'rate of the camera or of ratslam play',
            )

    def _process_message(self, message: Message) -> None:
        with self._lock:
            self._push('image', stamp_ns(message.header), message)

    def _failed(self, error: BaseException) -> None:
        self.error = error

    def _process_item(self, stamp_ns: int, stream: str, item: Message) -> None:
        try:
            with self._diagnostics.times('decode'):
                grey = image_of(item).grey()
            self._process_image(stamp_ns, grey, item.header.frame_id)
        except (UndecodableImage, UnusableParameter) as error:
            self._diagnostics.drop('undecodable', f'an image cannot be used: {error}')
            self._process_undecodable(stamp_ns)

    def _process_image(self, stamp_ns: int, image: NDArray[np.uint8], frame_id: str) -> None:
        """Process an image, (H, W) uint8; raises UnusableParameter if no window fits it."""
        raise NotImplementedError

    def _process_undecodable(self, stamp_ns: int) -> None:
        """React to an image that cannot be decoded."""

    def _diagnostic_values(self) -> dict[str, Any]:
        return {'backlog': len(self._backlog)}

    def _flush(self) -> None:
        if len(self._backlog) == 0:
            super()._flush()

    def _drop_queued(self) -> int:
        return self._backlog.clear()
