# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node of the local view: image -> local_view/template."""

from __future__ import annotations

from typing import Any

import numpy as np
from sensor_msgs.msg import Image

from ratslam_ros.core.vision.local_view import UNDECODABLE, LocalView
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.core.vision.recognition import FIXED_THRESHOLD
from ratslam_ros.messages.mapping import TemplatePayload
from ratslam_ros.pipeline.items import Template
from ratslam_ros.pipeline.live_stages import LiveTemplates
from ratslam_ros.pipeline.local_view import LocalViewStage
from ratslam_ros.pipeline.pipeline import Pipeline
from ratslam_ros.ros.convert import image_message
from ratslam_ros.ros.image_node import ImageNode
from ratslam_ros.ros.mapping.match_pictures import joined
from ratslam_ros.ros.qos import RESULT, VIEW

TOO_LITTLE_STRUCTURE = (
    'the views have too little structure to be recognised or learned, so nothing is mapped: look '
    'for a cover, darkness or blank walls in the images (vt_min_structure)'
)


class LocalViewNode(ImageNode):
    """Publishes one template message for each image: that of the learned template it matches."""

    SECTION = 'local_view'
    MAPS = True
    TAKES = ('odometry', 'image')
    _stage: LiveTemplates

    def connect(self, pipeline: Pipeline) -> None:
        """Publish the templates, and pictures of the matches."""
        self._publisher = self.create_payload_publisher(TemplatePayload, RESULT)
        self._last = UNDECODABLE
        self._low_texture = 0
        self._flat_ns: int | None = None
        """Stamp of the first image since the last one that had enough structure."""
        pipeline.observe('template', self._publish)
        if self._core is not None:
            self._matched = self.create_publisher(Image, 'local_view/matched', VIEW)
            self._image: PreparedImage | None = None
            self._frame_id = ''
            pipeline.observe('image', self._see)

    @property
    def _core(self) -> LocalView | None:
        """The templates; None if the stage is one of the user."""
        stage = self._stage.stage
        return stage.core if isinstance(stage, LocalViewStage) else None

    def started_over(self) -> None:
        """Continue after the memory was emptied."""
        super().started_over()
        self._last, self._flat_ns = UNDECODABLE, None

    def heard(self, stream: str, message: Any) -> None:
        """Note the frame of the images."""
        super().heard(stream, message)
        if stream == 'image':
            self._frame_id = message.header.frame_id

    def _see(self, stamp_ns: int, image: PreparedImage | None) -> None:
        self._image = image

    def _publish(self, stamp_ns: int, template: Template) -> None:
        self._last, core = template.match, self._core
        payload = TemplatePayload.of(stamp_ns, *template, self._sender_id)
        self.host.map.publish(self._publisher, payload)
        if core is not None:
            self._check_structure(stamp_ns, core.low_texture)
            if self._image is not None and self._matched.get_subscription_count() > 0:
                self._publish_matched(stamp_ns, core, self._image)

    def _check_structure(self, stamp_ns: int, low_texture: int) -> None:
        """Warn while no view has enough structure."""
        is_flat, self._low_texture = low_texture > self._low_texture, low_texture
        if not is_flat:
            self._flat_ns = None
            self.diagnostics.missing.pop('structure', None)
            return
        if self._flat_ns is None or stamp_ns < self._flat_ns:  # the stamps have jumped back
            self._flat_ns = stamp_ns
        if stamp_ns - self._flat_ns > self.config.inputs.watchdog_after_s * 1e9:
            self.diagnostics.lacks('structure', TOO_LITTLE_STRUCTURE)

    def _publish_matched(self, stamp_ns: int, core: LocalView, image: PreparedImage) -> None:
        """Publish the view as it was compared, above the template that it matched."""
        view = core.encode(image.pixels, image.colour)
        if view is None:
            return
        template = np.zeros_like(view)
        if self._last.template_id >= 0:
            template = core.template(self._last.template_id)
        both = joined(core.picture(view), core.picture(template))
        self._matched.publish(image_message(stamp_ns, self._frame_id, both))

    def _diagnostic_values(self) -> dict[str, Any]:
        core, last = self._core, self._last
        return {
            **({} if core is None else {
                'templates': len(core), 'low_texture': core.low_texture,
            }),
            **super()._diagnostic_values(),
            'template': last.template_id,
            'match_error': round(last.error, 4),
            **(
                {'match_threshold': round(last.threshold, 4)}
                if last.threshold != FIXED_THRESHOLD else {}
            ),
        }
