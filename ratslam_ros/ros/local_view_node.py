# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node of the local view: image -> local_view/template."""

from __future__ import annotations

from typing import Any

import numpy as np
from sensor_msgs.msg import Image
from std_msgs.msg import String

from ratslam_ros.core.vision.local_view import (
    FIXED_THRESHOLD,
    UNDECODABLE,
    LocalView,
    ViewMatch,
)
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.mapping import TemplatePayload
from ratslam_ros.pipeline.items import Template
from ratslam_ros.pipeline.pipeline import Pipeline
from ratslam_ros.ros.convert import grey_image
from ratslam_ros.ros.image_node import ImageNode
from ratslam_ros.ros.mapping.match_pictures import joined
from ratslam_ros.ros.qos import RESULT, VIEW


class TemplateNode(ImageNode):
    """Publishes one template message for each image."""

    SECTION = 'local_view'
    MAPS = True
    TAKES = ('odometry', 'image')

    def connect(self, pipeline: Pipeline) -> None:
        """Publish the templates."""
        self._publisher = self.create_publisher(String, 'local_view/template', RESULT)
        self._last = UNDECODABLE
        pipeline.observe('template', self._publish)

    def started_over(self) -> None:
        """Continue after the memory was emptied."""
        super().started_over()
        self._last = UNDECODABLE

    def _publish(self, stamp_ns: int, template: Template) -> None:
        self._last = template.match
        payload = encode(TemplatePayload.of(stamp_ns, *template, self._sender_id))
        self._host.map.publish(self._publisher, String(data=payload))

    def _diagnostic_values(self) -> dict[str, Any]:
        return {
            **super()._diagnostic_values(),
            'template': self._last.template_id,
            'match_error': round(self._last.error, 4),
            **(
                {'match_threshold': round(self._last.threshold, 4)}
                if self._last.threshold != FIXED_THRESHOLD else {}
            ),
        }


class LocalViewNode(TemplateNode):
    """Matches each image with the learned templates and publishes one template message."""

    def connect(self, pipeline: Pipeline) -> None:
        """Publish the templates, and pictures of the matches."""
        self._matched = self.create_publisher(Image, 'local_view/matched', VIEW)
        self._image: PreparedImage | None = None
        self._frame_id = ''
        pipeline.observe('image', self._see)
        super().connect(pipeline)
        self._host.listen('image', self._note_frame)

    @property
    def _core(self) -> LocalView:
        core: LocalView = self._stage.stage.core
        return core

    def _note_frame(self, message: Any) -> None:
        self._frame_id = message.header.frame_id

    def _see(self, stamp_ns: int, image: PreparedImage | None) -> None:
        self._image = image

    def _publish(self, stamp_ns: int, template: Template) -> None:
        super()._publish(stamp_ns, template)
        if self._image is not None and self._matched.get_subscription_count() > 0:
            self._publish_matched(stamp_ns, self._image, template.match)

    def _publish_matched(self, stamp_ns: int, image: PreparedImage, match: ViewMatch) -> None:
        """Publish the view as it was compared, above the template that it matched."""
        view = self._core.encode(image.pixels, image.colour)
        if view is None:
            return
        template = np.zeros_like(view)
        if match.template_id >= 0:
            template = self._core.template(match.template_id)
        both = joined(self._core.picture(view), self._core.picture(template))
        self._matched.publish(grey_image(stamp_ns, self._frame_id, both))

    def _diagnostic_values(self) -> dict[str, Any]:
        return {
            'templates': len(self._core), 'low_texture': self._core.low_texture,
            **super()._diagnostic_values(),
        }  # fmt: skip
