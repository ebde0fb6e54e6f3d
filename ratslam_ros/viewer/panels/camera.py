# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera and match: what the robot sees, and how well it recognises it."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from ratslam_ros.history.records import ImageRecord, MatchRecord
from ratslam_ros.history.run_state import RunState
from ratslam_ros.viewer.panels.desk import Desk, put
from ratslam_ros.viewer.panels.html import BLUE, GREEN, ORANGE, RED, block, css, dim, mark, strong
from ratslam_ros.viewer.panels.image_loader import ImageLoader
from ratslam_ros.viewer.panels.pictures import error_curves, match_picture
from ratslam_ros.viewer.panels.texts import decision_text, match_picture_text, match_text

if TYPE_CHECKING:
    import viser
    import viser.uplot

PLOT_EVERY = 5
"""Number of updates between two drawings of the plot: 2 Hz suffice for a minute."""

PLOT_HEIGHT_PX = 150
PLOT_FONT, FAINT = '11px sans-serif', 'rgba(128,128,128,0.25)'

MATCH_LABEL = 'View (above) and matched template (below)'
NO_IMAGE = 'no camera image for this moment'
NO_PICTURE = np.full((3, 4, 3), 127, np.uint8)


class CameraPanel:
    """Camera image, view and template, and the match error of the last minute."""

    def __init__(self, desk: Desk) -> None:
        self._desk, gui = desk, desk.gui
        self.loader = ImageLoader(desk.post)
        self.image = gui.add_image(
            NO_PICTURE, label='Camera', format='jpeg', visible=False
        )
        self.no_image = gui.add_html(block(dim(NO_IMAGE)))
        self.text = gui.add_html('')
        self.match = gui.add_image(NO_PICTURE, label=MATCH_LABEL, visible=False)
        self.match_text = gui.add_html('')
        axis: viser.uplot.Axis = {
            'stroke': 'gray', 'grid': {'stroke': FAINT}, 'ticks': {'stroke': FAINT},
            'font': PLOT_FONT, 'labelFont': PLOT_FONT,
        }
        self.plot = gui.add_uplot(
            data=error_curves((), 0),
            series=(
                {'label': 'time'},
                {'label': 'match error', 'stroke': css(BLUE), 'width': 1.5},
                {'label': 'threshold', 'stroke': css(RED), 'width': 1.5, 'dash': (6, 4)},
                {'label': 'new template', 'stroke': css(ORANGE), 'width': 0, 'auto': False,
                 'points': {'show': True, 'size': 6, 'fill': css(ORANGE)}},
            ),
            scales={'x': {'time': False, 'range': (-60.0, 0.0)}, 'y': {'range': (0.0, None)}},
            axes=(
                {**axis, 'label': 'seconds before the shown moment', 'size': 28, 'labelSize': 16},
                {**axis, 'size': 42},
            ),
            legend={'live': False},
            height=PLOT_HEIGHT_PX, visible=False,
        )
        self._drawn = -PLOT_EVERY
        self._match: MatchRecord | None = None
        self._small: ImageRecord | None = None
        self.forget()

    def forget(self) -> None:
        """Draw everything again, because another run with the same stamps may be shown."""
        self._shown_ns = self._plotted_ns = -1

    def update(self, state: RunState) -> None:
        """Show the image and the match of a moment."""
        stamp_ns = state.view.stamp_ns if state.view is not None else state.stamp_ns
        if stamp_ns != self._shown_ns or state.image is not self._small:
            self._request_image(state, stamp_ns)
        view = state.view
        if view is not None:
            required = self._desk.playback.source.required_views
            symbol = mark('◆', ORANGE) if view.is_new else mark('●', GREEN)
            text = block(
                f'{symbol} {strong(match_text(view))}', escape(decision_text(view, required))
            )
        else:
            text = block(dim('no view for this moment'))
        put(self.text, 'content', text)
        text, match = '', state.match
        if match is not None:
            text = block(dim(match_picture_text(match, stamp_ns)))
            if match is not self._match:
                self.match.image = match_picture(match)
        self._match = match
        put(self.match, 'visible', match is not None)
        put(self.match_text, 'content', text)
        self._show_plot(state, stamp_ns)

    def _request_image(self, state: RunState, stamp_ns: int) -> None:
        self._shown_ns, self._small = stamp_ns, state.image
        small = None if state.image is None else state.image.jpeg

        def show(jpeg: bytes | None) -> None:
            self._show_image(jpeg or small)

        self.loader.request(self._desk.playback.source, stamp_ns, show)

    def _show_image(self, jpeg: bytes | None) -> None:
        put(self.image, 'visible', jpeg is not None)
        put(self.no_image, 'visible', jpeg is None)
        if jpeg is not None:
            # viser's own setter takes pixels and would compress them again.
            self.image._data = jpeg

    def _show_plot(self, state: RunState, stamp_ns: int) -> None:
        due = self._desk.updates - self._drawn >= PLOT_EVERY
        if due and stamp_ns != self._plotted_ns:
            self._drawn, self._plotted_ns = self._desk.updates, stamp_ns
            curves = error_curves(state.recent, stamp_ns)
            put(self.plot, 'visible', len(curves[0]) > 0)
            self.plot.data = curves
