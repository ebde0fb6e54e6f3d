# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the two nodes that receive images."""

from __future__ import annotations

from typing import Any, ClassVar

from sensor_msgs.msg import CompressedImage, Image

from ratslam_ros.images import UndecodableImage, image_of
from ratslam_ros.ros.backlog import Backlog
from ratslam_ros.ros.convert import stamp_ns
from ratslam_ros.ros.node import RatslamNode

Message = Any
"""A sensor_msgs Image or CompressedImage."""


class ImageNode(RatslamNode):
    """A node that receives every image, raw or compressed, in a thread beside the executor."""

    TAKES: ClassVar[tuple[str, ...]] = ('image',)
    UNLOCKED = (Image, CompressedImage)

    def _begin(self) -> None:
        self._backlog: Backlog[Message] = Backlog(self._process_message)
        super()._begin()

    def subscribe(self, stream: str) -> None:
        """Subscribe to a stream that comes from outside."""
        if stream != 'image':
            super().subscribe(stream)
            return
        self._add_input(stream, self._topics(), self._on_image, resume=self._process_past)

    def _topics(self) -> dict[str, type]:
        transport = self.config.inputs.image_transport
        return {
            topic: kind for topic, name, kind in (
                ('image', 'raw', Image), ('image/compressed', 'compressed', CompressedImage)
            )
            if transport in ('auto', name)
        }

    def _on_set(self) -> None:
        super()._on_set()
        for one in self.inputs:
            if one.name == 'image':
                one.use(self._topics())

    def close(self) -> None:
        """Process the current image, drop the queued ones, and stop."""
        dropped = self._backlog.close()
        if dropped:
            self.get_logger().warning(f'{dropped} queued images were dropped at the end')
        super().close()

    def _on_image(self, message: Message) -> None:
        if not self._backlog.put(message, len(message.data)):
            self.diagnostics.drop(
                'dropped',
                'an image was dropped: images arrive faster than they are processed; lower the '
                'rate of the camera or of ratslam play',
            )

    def _process_past(self, message: Message) -> None:
        """Process an image that was sent during an interruption, in the executor's thread."""
        self._process_message(message)

    def _process_message(self, message: Message) -> None:
        image = None
        try:
            with self.diagnostics.times('decode'):
                picture, pipeline = image_of(message), self.host.pipeline
                grey = picture.grey(self.config.inputs.image_grey)
                colour = picture.bgr() if pipeline.wants_colour else None
            with self.diagnostics.times('prepare'):
                image = pipeline.prepare(grey, colour)
        except UndecodableImage as error:
            self.diagnostics.drop('undecodable', f'an image cannot be used: {error}')
        self.host.heard('image', message)
        self._push('image', stamp_ns(message.header), image)

    @property
    def error(self) -> BaseException | None:
        """The exception that has ended the thread, if any; ``run`` raises it."""
        return self._backlog.error

    def _diagnostic_values(self) -> dict[str, Any]:
        return {'backlog': len(self._backlog)} if self.inputs else {}

    @property
    def is_busy(self) -> bool:
        """Whether images wait that the host has not got yet."""
        return len(self._backlog) > 0
