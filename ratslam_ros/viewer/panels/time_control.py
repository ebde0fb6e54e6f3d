# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Time control: which moment of the run is shown."""

from __future__ import annotations

from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.viewer.panels.desk import Desk, assign, offer, put
from ratslam_ros.viewer.panels.html import ORANGE, block, dim, mark, strong
from ratslam_ros.viewer.panels.page import PAGE
from ratslam_ros.viewer.panels.texts import playback_text, stamp_text, time_text

SPEEDS = {
    f'{speed:g}×': speed for speed in (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
}
"""Speeds offered, by their texts."""

SLIDER_STEP_S = 0.1

BEGIN, BACK, PLAY, PAUSE, NEXT, END = 'Begin', '◀', 'Play', 'Pause', '▶', 'End'
"""Buttons."""


class TimeControl:
    """Scrubber, buttons and speed, and where the cursor is."""

    def __init__(self, desk: Desk) -> None:
        self._desk, gui = desk, desk.gui
        playback = desk.playback
        with gui.add_folder('Time'):
            gui.add_html(PAGE)
            self.text = gui.add_html('')
            self.scrubber = gui.add_slider(
                'Time [s]', 0.0, 1.0, SLIDER_STEP_S, 0.0, marks=(),
                hint='Time since the beginning of the run. Drag it to show any moment.',
            )
            self.buttons = gui.add_button_group(
                'Playback', (BEGIN, BACK, PLAY, NEXT, END),
                hint='Begin; previous view; play or pause; next view; end. While the run goes on, '
                'End follows it live.',
            )
            self.speed = gui.add_dropdown(
                'Speed', tuple(SPEEDS), initial_value='1×',
                hint='Speed of playing, relative to the recording.',
            )
            self.notices = gui.add_html('', visible=False)
        desk.on_change(self.scrubber, self._scrub)
        desk.on_press(self.buttons, {
            BEGIN: lambda: playback.seek(playback.begin_ns),
            BACK: lambda: playback.step(-1),
            PLAY: playback.toggle,
            PAUSE: playback.toggle,
            NEXT: lambda: playback.step(1),
            END: playback.follow,
        })
        desk.on_change(self.speed, self._set_speed)

    def update(self, state: RunState) -> None:
        """Show where the cursor is."""
        playback, source = self._desk.playback, self._desk.playback.source
        begin_ns, end_ns = playback.begin_ns, playback.end_ns
        at_s, of_s = ((ns - begin_ns) / NS_PER_S for ns in (playback.cursor_ns, end_ns))
        symbol, words = playback_text(playback)
        text = block(
            strong(source.title),
            f'{mark(symbol, ORANGE)} {words}',
            f'{strong(time_text(at_s))} of {time_text(of_s)} '
            f'&ensp;{dim(stamp_text(playback.cursor_ns)) if end_ns else ""}',
        )
        put(self.text, 'content', text)
        # Whole seconds, so that a growing run changes the scale once a second.
        step_ns = NS_PER_S if playback.is_growing else round(SLIDER_STEP_S * NS_PER_S)
        steps = max(1, -(-(end_ns - begin_ns) // step_ns))
        put(self.scrubber, 'max', round(steps * step_ns / NS_PER_S, 1))
        assign(self.scrubber, round(at_s / SLIDER_STEP_S) * SLIDER_STEP_S)
        play = PAUSE if playback.playing else PLAY
        offer(self.buttons, (BEGIN, BACK, play, NEXT, END))
        assign(self.speed, f'{playback.speed:g}×')
        notices = [f'{mark("▲", ORANGE)} {dim(notice)}' for notice in source.notices]
        put(self.notices, 'visible', bool(notices))
        put(self.notices, 'content', block(*notices))

    def faster(self, places: int) -> None:
        """Choose the speed that is a number of places faster, or slower if negative."""
        playback = self._desk.playback
        speeds = [*SPEEDS.values()]
        place = speeds.index(playback.speed) + places
        playback.speed = speeds[min(max(place, 0), len(speeds) - 1)]

    def _scrub(self, seconds: float) -> None:
        playback = self._desk.playback
        if seconds >= self.scrubber.max and playback.is_growing:
            playback.follow()
        else:
            playback.seek(playback.begin_ns + round(seconds * NS_PER_S))

    def _set_speed(self, text: str) -> None:
        self._desk.playback.speed = SPEEDS[text]
