# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the two nodes that look at images share."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, Image

from ratslam_ros.errors import UnusableParameter
from ratslam_ros.images import UndecodableImage, image_of
from ratslam_ros.nodes.backlog import Backlog
from ratslam_ros.nodes.convert import stamp_ns
from ratslam_ros.nodes.node import FLUSH_CHECK_S, RatslamNode

Message = Any
"""A sensor_msgs Image or CompressedImage."""


class ImageNode(RatslamNode[Message]):
    """A node that looks at every image, raw or compressed, in a thread beside the executor's."""

    def __init__(self) -> None:
        super().__init__(('image',))
        self.error: BaseException | None = None
        """What ended the thread, if something did."""
        self._backlog: Backlog[Message] = Backlog(self._look, self._failed)

    def _listen_to_images(self) -> None:
        """Subscribe; the last thing to do when a node is made."""
        topics = {'image': Image, 'image/compressed': CompressedImage}
        transport = self._section.image_transport
        if transport != 'auto':
            wanted = 'image' if transport == 'raw' else 'image/compressed'
            topics = {wanted: topics[wanted]}
        self._listen('image', topics, self._on_image)
        self.create_timer(FLUSH_CHECK_S, self._flush, clock=self._steady)

    def close(self) -> None:
        """Process the image in hand, and stop."""
        dropped = self._backlog.close() + self._drop_waiting()
        if dropped:
            self.get_logger().warning(f'{dropped} images were not looked at before the end')
        super().close()

    def _on_image(self, message: Message) -> None:
        if not self._backlog.put(message, len(message.data)):
            self._diagnostics.drop(
                'dropped',
                'an image was dropped: they come faster than they can be looked at; lower the '
                'rate of the camera or of the playing',
            )

    def _look(self, message: Message) -> None:
        with self._lock:
            self._push('image', stamp_ns(message.header), message)

    def _failed(self, error: BaseException) -> None:
        self.error = error

    def _use(self, stamp_ns: int, stream: str, item: Message) -> None:
        try:
            with self._diagnostics.times('decode'):
                grey = image_of(item).grey()
            self._see(stamp_ns, grey, item.header.frame_id)
        except (UndecodableImage, UnusableParameter) as error:
            self._diagnostics.drop('undecodable', f'an image cannot be used: {error}')
            self._see_nothing(stamp_ns)

    def _see(self, stamp_ns: int, image: NDArray[np.uint8], frame_id: str) -> None:
        """Take an image, (H, W) uint8; raises UnusableParameter where no window fits it."""
        raise NotImplementedError

    def _see_nothing(self, stamp_ns: int) -> None:
        """Take note of an image that shows nothing."""

    def _state(self) -> dict[str, Any]:
        return {'backlog': len(self._backlog)}

    def _flush(self) -> None:
        if len(self._backlog) == 0:
            super()._flush()

    def _drop_waiting(self) -> int:
        return self._backlog.clear()
