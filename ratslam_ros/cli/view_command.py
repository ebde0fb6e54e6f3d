# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam view``, and the option ``--view`` of other commands: a run in a browser or a page."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from ratslam_ros.cli.options import (
    Commands,
    add_out,
    add_replay_options,
    add_view_options,
    config_of,
    numbered,
    positive,
    read_truth,
    results_folder,
    words_of,
)
from ratslam_ros.cli.replaying import replayed
from ratslam_ros.console import print_notice, print_notices
from ratslam_ros.errors import DONE, INTERRUPTED, RatslamError, UnusableInput
from ratslam_ros.files.text import check_output
from ratslam_ros.signals import StopSignals

if TYPE_CHECKING:
    from ratslam_ros.cli.child import Child
    from ratslam_ros.viewer.app import Page
    from ratslam_ros.viewer.followed_run import FollowedRun
    from ratslam_ros.viewer.run_source import Controls, RunSource
    from ratslam_ros.viewer.server import ViewServer

POLL_S = 0.05

END_S = 1.2
"""Time for a replay to write its results after Ctrl-C, so that all ends within 2 s."""

CAMERA_END_S = 60.0
"""The same for a camera. OpenCV waits up to 30 s for an image of a stream that has stopped."""

SIMULATED_ROBOT = (
    '"ratslam launch --view --config navigation --goal-follower" in one terminal and '
    '"ratslam simulate --live" in another one.'
)

VIEW_OPTIONS = (
    'view', 'host', 'port', 'browser', 'out', 'export', 'export_duration', 'export_dark',
)
"""Options that a child process does not get, or gets with another value."""


def add_view(commands: Commands) -> None:
    """Add ``ratslam view``."""
    view = commands.add_parser(
        'view', help='show a recording or a finished run in a browser',
        description='Replay a recording and show it in a browser, or show the results of a run.',
    )
    add_replay_options(view, 'PATH', ', to be replayed; or folder of results')
    add_out(view, 'results/NAME-TIME, with the link results/latest')
    add_view_options(view, always=True)
    view.add_argument('--export', type=Path, metavar='FILE.html',
                      help='instead of showing the run, write a page that plays it; the page '
                           'needs neither Python nor a network')
    view.add_argument('--export-duration', type=positive, default=30.0, metavar='S',
                      help='time that the exported page plays, in s (default: 30)')
    view.add_argument('--export-dark', action='store_true', help='export with the dark theme')
    view.set_defaults(
        run=_view, parser=view, quiet=True, video=None, no_history=False, map=None, localize=False
    )


def _view(options: argparse.Namespace) -> int:
    from ratslam_ros.history.file import HISTORY_NAME, PART
    from ratslam_ros.history.opening import open_run

    path: Path = options.recording
    names = HISTORY_NAME, HISTORY_NAME + PART, 'map.json'
    if path.is_file() and path.name in names:
        path = options.recording = path.parent
    if options.export is not None:
        _check_export(options.export)
    if any((path / name).is_file() for name in names):
        return _view_results(options)
    if options.export is None:
        return view_replay(options)
    options.quiet = False  # there is no page that would show the progress
    code, folder = replayed(options)
    return _export(open_run(folder), options) if code == DONE else code


def _check_export(path: Path) -> None:
    """Raise if no file can be written there, so that it is reported before a replay.

    Raises:
        UnusableInput: the name is none of a page, or the folder does not exist.
    """
    if path.suffix.lower() not in ('.html', '.htm'):
        raise UnusableInput(f'--export {path}: expected the name of a page, FILE.html')
    check_output(path)


def _export(run: RunSource, options: argparse.Namespace) -> int:
    """Write the page and print what has been written; return the exit code.

    Raises:
        UnusableInput: the file cannot be written, or there is nothing to show.
    """
    from ratslam_ros.viewer.export import export_html

    if not run.end_ns:
        raise UnusableInput(f'{options.recording} has no moment that can be shown: export nothing')
    done = export_html(
        run, options.export, duration_s=options.export_duration, dark=options.export_dark
    )
    print_notices(run.notices)
    moments = 'one moment' if done.frames == 1 else f'{done.frames} moments'
    print(f'{options.export}: {moments}, {done.size / 1e6:.1f} MB')
    return DONE


def _view_results(options: argparse.Namespace) -> int:
    from ratslam_ros.history.opening import open_run
    from ratslam_ros.viewer.run_source import NoControls

    given = words_of(options.parser, options, (*VIEW_OPTIONS, 'recording', 'truth'))
    if given:
        raise UnusableInput(
            f'{options.recording} is a finished run, on which {given[0].partition("=")[0]} has no '
            'effect; give the recording to replay it'
        )
    run = open_run(options.recording, options.truth)
    if options.export is not None:
        return _export(run, options)
    return _show(_server(options), run, NoControls(), options)


def view_replay(options: argparse.Namespace) -> int:
    """Replay a recording in a child process and show it, until Ctrl-C.

    Args:
        options: those of ``ratslam replay`` and of the web server.
    """
    from ratslam_ros.recordings import open_recording
    from ratslam_ros.viewer.replay_controls import ReplayControls
    from ratslam_ros.viewer.run_source import NoControls

    config = config_of(options)
    # What cannot be used is reported before a page is opened.
    read_truth(options.truth)
    with open_recording(options.recording, images_rate_hz=options.images_rate) as recording:
        recording.select(
            options.image_topic, options.odom_topic, options.visual_odometry,
            options.scan_topic, config.experience_map.exp_align_scans or options.landmarks,
        )
        name = recording.name
    words = ['replay', *words_of(options.parser, options, VIEW_OPTIONS)]
    if '--quiet' not in words:
        words += ['--quiet'] * options.quiet
    replays = _replays(options, words, name)
    if options.map is not None:
        fixed = NoControls('The map is kept in a file, so the parameters stay as they are.')
        return _view_child(options, replays, fixed)
    return _view_child(options, replays, ReplayControls(config, replays.request))


def view_simulation(options: argparse.Namespace, command: str, title: str) -> int:
    """Run ``ratslam demo`` or ``simulate`` in a child process and show it, until Ctrl-C.

    Args:
        options: those of the command and of the web server.
        command: the command.
        title: name of the run on the page.
    """
    from ratslam_ros.viewer.run_source import NoControls

    controls = NoControls(
        'This simulation drives by itself and takes no requests. To drive a simulated robot, '
        f'start {SIMULATED_ROBOT}'
    )
    words = [command, *words_of(options.parser, options, VIEW_OPTIONS)]
    return _view_child(options, _replays(options, words, command, title), controls)


def view_camera(options: argparse.Namespace) -> int:
    """Run ``ratslam camera`` in a child process and show it, until Ctrl-C.

    Args:
        options: those of the command and of the web server.
    """
    from ratslam_ros.recordings.camera import Camera, check_record
    from ratslam_ros.viewer.run_source import NoControls

    # What cannot be used is reported before a page is opened.
    config_of(options)
    if options.record is not None:
        check_record(options.record)
    with Camera(options.source) as camera:
        name = camera.name
    controls = NoControls('The map is built from a camera, so the parameters stay as they are.')
    words = [name, *words_of(options.parser, options, VIEW_OPTIONS), '--no-view']
    return _view_child(options, _replays(options, words, name), controls, CAMERA_END_S)


def _replays(
    options: argparse.Namespace, words: Sequence[str], name: str, title: str = ''
) -> _Replays:
    folder, truth = results_folder(options, name), getattr(options, 'truth', None)
    return _Replays(words, folder, title or name, options.out is None, truth)


def _view_child(
    options: argparse.Namespace, replays: _Replays, controls: Controls, end_s: float = END_S
) -> int:
    server = _server(options)
    try:
        return _show(server, replays.start(), controls, options, replays, end_s)
    finally:
        replays.end(0.0)


class _Replays:
    """The child process that writes the shown run, and its successors.

    All but ``request`` is called by the main thread.
    """

    def __init__(
        self, words: Sequence[str], folder: Path, title: str, is_latest: bool,
        truth: Path | None,
    ) -> None:
        self._truth = truth
        self._words, self._first_folder, self._title = words, folder, title
        self._is_latest = is_latest
        self._number = 0
        self._requested: Sequence[str] | None = None
        self._child: Child | None = None
        self.followed: FollowedRun
        """The run that the child writes."""
        self.folder = folder
        """Results of the child."""

    def request(self, settings: Sequence[str]) -> None:
        """Request another replay, with settings `section.name=value`; called by any thread."""
        self._requested = settings

    def start(self, settings: Sequence[str] = ()) -> RunSource:
        """Start a child and return the run to show until its history is opened."""
        from ratslam_ros.cli.child import Child
        from ratslam_ros.history.file import HISTORY_NAME
        from ratslam_ros.viewer.followed_run import FollowedRun

        self._number += 1
        if self._number > 1:
            self.folder = numbered(self._first_folder, self._number)
        title = ', '.join([self._title, *settings])
        self.followed = FollowedRun(self.folder / HISTORY_NAME, title, self._truth)
        sets = [f'--set={setting}' for setting in settings]
        self._child = Child([*self._words, *sets, f'--out={self.folder}'])
        return self.followed.run

    def take_request(self) -> RunSource | None:
        """Start a requested replay, if any, in place of a running one."""
        settings, self._requested = self._requested, None
        if settings is None:
            return None
        self.end(END_S)
        return self.start(settings)

    def poll(self) -> tuple[int, str] | None:
        """Return the exit code and last line of a child that has ended since the last call."""
        if self._child is None or (code := self._child.code) is None:
            return None
        child = self._child
        warnings = [line for line in child.lines if line.startswith('warning: ')]
        notices = [line.removeprefix('warning: ') for line in warnings]
        self._ended(code, *notices, *([] if code == DONE else [child.reason]))
        return code, child.reason

    def interrupt(self) -> None:
        """Have the child write its results and end."""
        if self._child is not None:
            self._child.interrupt()

    def end(self, within_s: float) -> int | None:
        """End the child; return its exit code, None if none was running."""
        if self._child is None:
            return None
        self._child.interrupt()
        code = self._child.end(within_s)
        self._ended(code)
        return code

    def _ended(self, code: int, *notices: str) -> None:
        from ratslam_ros.results.writer import link_latest

        self._child = None
        if code == DONE and self._is_latest:
            link_latest(self.folder)
        self.followed.end(*notices)


def _show(
    server: ViewServer, run: RunSource, controls: Controls, options: argparse.Namespace,
    replays: _Replays | None = None, end_s: float = END_S,
) -> int:
    """Show a run in a browser until Ctrl-C; return the exit code.

    Args:
        server: serves the page.
        run: what is shown first.
        controls: what the user can ask of it.
        options: those of the web server.
        replays: the child processes that write the shown runs, if there are any.
        end_s: time for a child to end in s.
    """
    from ratslam_ros.viewer.app import Page

    page: Page | None = None
    try:
        with StopSignals() as signals:
            page = Page(server, run, controls)
            _announce(server, options.browser)
            code = _wait(page, signals, controls, replays)
    finally:
        # Child and server end at the same time.
        end_s += time.monotonic()
        if replays is not None:
            replays.interrupt()
        if page is None:
            server.stop()
        else:
            page.close(max(0.0, end_s - time.monotonic()))
        ended = None if replays is None else replays.end(end_s - time.monotonic())
    if replays is None or ended is None:
        return code
    if ended == DONE:
        return DONE
    kept = (replays.folder / 'map.json').is_file()
    print_notice(
        f'interrupted: the results so far are in {replays.folder}' if kept
        else 'interrupted: no results have been written'
    )
    return INTERRUPTED


def _wait(
    page: Page, signals: StopSignals, controls: Controls, replays: _Replays | None
) -> int:
    """Return when a signal comes, or a child fails before there is anything to show.

    Raises:
        BaseException: the thread that draws has failed.
    """
    first = None if replays is None else replays.followed.run
    while not signals.received:
        time.sleep(POLL_S)
        if page.error is not None:
            raise page.error
        if replays is None:
            continue
        run = replays.take_request()
        ended = replays.poll()
        if replays.followed.open():
            run = replays.followed.run
        if run is not None:
            page.show(run)
        if ended is None:
            continue
        code, reason = ended
        if code == DONE:
            _use_config(controls, replays.folder)
        elif replays.followed.run is first:  # the first run has not begun
            return code if code > 0 else INTERRUPTED
        else:
            page.notify('The replay has failed', reason)
    return DONE


def _use_config(controls: Controls, folder: Path) -> None:
    """Show the parameters that the replay has had: some are chosen for the recording."""
    from ratslam_ros.viewer.replay_controls import ReplayControls

    if isinstance(controls, ReplayControls):
        from ratslam_ros.files.config import load_config

        with suppress(RatslamError):
            controls.use(load_config(str(folder / 'config.yaml'))[0])


def _announce(server: ViewServer, in_browser: bool) -> None:
    from ratslam_ros.viewer.desktop import open_browser

    print(f'view: {server.url} (Ctrl-C ends it)', flush=True)
    if server.is_public:
        print_notice(
            'warning: other machines can open the view; whoever has its address, which is '
            'sent without encryption, controls the run'
        )
    if in_browser:
        open_browser(server.url)


def _server(options: argparse.Namespace) -> ViewServer:
    from ratslam_ros.viewer.server import DEFAULT_HOST, DEFAULT_PORT, ViewServer

    host = DEFAULT_HOST if options.host is None else options.host
    return ViewServer(host, DEFAULT_PORT if options.port is None else options.port)
