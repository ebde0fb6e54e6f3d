# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From a recording to a map: ``ratslam replay`` as a function, and its result."""

from __future__ import annotations

import json
import shutil
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.console import Progress, print_notice, print_notices
from ratslam_ros.core.config import Config, Value
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import load_config, stored_config
from ratslam_ros.files.text import check_output
from ratslam_ros.limits import IMAGES_RATE_HZ
from ratslam_ros.offline.compile_all import compile_kernels
from ratslam_ros.offline.inspection import inspect as inspect_recording
from ratslam_ros.offline.replay import ReplayOptions, ReplayOutcome, replay
from ratslam_ros.offline.replay_map import ReplayMap
from ratslam_ros.offline.replay_video import check_path
from ratslam_ros.pipeline.stage import Stage
from ratslam_ros.recordings import Recording, open_recording
from ratslam_ros.results.advice import Source, advise
from ratslam_ros.results.plots import draw_all
from ratslam_ros.results.trajectory import Trajectory, read_tum
from ratslam_ros.results.writer import THRESHOLD_COLUMN

if TYPE_CHECKING:
    from networkx import Graph
    from pandas import DataFrame

PLACE_COLUMNS = {
    'id': 'i8', 'template_id': 'i8', 'x_m': 'f8', 'y_m': 'f8', 'heading_rad': 'f8',
}
LINK_COLUMNS = {
    'source_id': 'i8', 'target_id': 'i8', 'distance_m': 'f8', 'heading_rad': 'f8',
    'facing_rad': 'f8', 'duration_s': 'f8', 'count': 'i8',
}
FRAME_COLUMNS = {
    'stamp_ns': 'i8', 'template_id': 'i8', 'is_new': 'i8', 'match_error': 'f8',
    'relative_rad': 'f8', 'experience_id': 'i8', THRESHOLD_COLUMN: 'f8',
}


@dataclass(frozen=True, eq=False, repr=False)
class MapResult(ReplayOutcome):
    """Map of a recording, with everything that the replay found.

    folder: the files of the run (docs/results.md). warnings: problems of the recording. advice:
    a line for each problem of the map, with the next command. map_file: the continued map.
    """

    folder: Path
    warnings: Sequence[str]
    advice: Sequence[str]
    map_file: ReplayMap | None

    def __repr__(self) -> str:
        text = (
            '{frames} frames and {odometry} odometry messages over {duration_s:.1f} s, in '
            '{wall_s:.1f} s ({times_realtime:.0f}x real time)\n'
            '{templates} templates, {experiences} experiences, {links} links, '
            '{loop_closures} loop closures'
        ).format(**self.summary)
        lost = [f'{number} {key}' for key, number in _lost(self.summary).items()]
        return text + (f'\nmessages not used: {", ".join(lost)}' if lost else '')

    def _repr_png_(self) -> bytes:
        """Return the plot of the map, which notebooks show."""
        return self.plot()[0].read_bytes()

    @cached_property
    def _content(self) -> dict[str, Any]:
        content: dict[str, Any] = json.loads((self.folder / 'map.json').read_text('utf-8'))
        return content

    @cached_property
    def places(self) -> NDArray[np.void]:
        """The experiences: id, template_id, x_m, y_m, heading_rad."""
        return _table(self._content['experiences'], PLACE_COLUMNS)

    @cached_property
    def links(self) -> NDArray[np.void]:
        """The links: source_id, target_id, distance_m, duration_s, ..., as in docs/results.md."""
        return _table(self._content['links'], LINK_COLUMNS)

    @cached_property
    def frames(self) -> NDArray[np.void]:
        """A row for each image: the columns of frames.csv."""
        lines = (self.folder / 'frames.csv').read_text('ascii').splitlines()
        names = lines[0].split(',')
        rows = [dict(zip(names, line.split(','), strict=True)) for line in lines[1:]]
        return _table(rows, {name: FRAME_COLUMNS[name] for name in names})

    @property
    def trajectory(self) -> Trajectory:
        """The pose estimate at each odometry message."""
        return read_tum(self.folder / 'trajectory.tum')

    @property
    def trajectory_final(self) -> Trajectory:
        """The same poses, relative to the final positions of the experiences."""
        return read_tum(self.folder / 'trajectory_final.tum')

    @property
    def dead_reckoning(self) -> Trajectory:
        """The integrated odometry, with the calibration of the run."""
        return read_tum(self.folder / 'dead_reckoning.tum')

    def plot(self, truth: str | Path | Trajectory | None = None) -> list[Path]:
        """Draw map.png and matches.png in the folder, and return their paths.

        Args:
            truth: the true trajectory, or its TUM file; None for none.
        """
        return draw_all(self.folder, truth)

    def save(self, folder: str | Path) -> Path:
        """Copy all files of the run to a new folder, for ``ratslam view``, ``plot`` and ``map``.

        Raises:
            UnusableInput: the folder exists, or cannot be written.
        """
        try:
            return Path(shutil.copytree(self.folder, folder))
        except (OSError, shutil.Error) as error:
            reason = getattr(error, 'strerror', None) or error
            raise UnusableInput(
                f'{folder} cannot be written ({reason}): expected the name of a new folder'
            ) from None

    def to_networkx(self) -> Graph:
        """Return a networkx graph: places and links with the values of map.json."""
        import networkx

        graph = networkx.Graph()
        graph.add_nodes_from((place['id'], place) for place in self._content['experiences'])
        graph.add_edges_from(
            (link['source_id'], link['target_id'], link) for link in self._content['links']
        )
        return graph

    def to_pandas(self) -> DataFrame:
        """Return the table of frames as a pandas.DataFrame."""
        import pandas

        return pandas.DataFrame(self.frames)


def map_recording(
    recording: Recording | str | Path,
    out: str | Path | None = None,
    *,
    config: Config | str | Path | None = None,
    settings: Mapping[str, Value] | None = None,
    inspect: bool = True,
    image_topic: str | None = None,
    odom_topic: str | None = None,
    scan_topic: str | None = None,
    visual_odometry: bool = False,
    landmarks: bool = False,
    start_s: float = 0.0,
    duration_s: float | None = None,
    images_rate_hz: float = IMAGES_RATE_HZ,
    map_file: str | Path | None = None,
    localize: bool = False,
    history: bool = True,
    video: str | Path | None = None,
    stages: Sequence[type[Stage]] = (),
    quiet: bool = False,
    progress: Progress | None = None,
) -> MapResult:
    """Build a map from a recording, exactly as ``ratslam replay`` with the same options.

    Args:
        recording: an open recording, or the path of one of any supported format.
        out: folder for the results; results in it are replaced. None: a temporary folder that is
            removed with the result, see ``MapResult.save``.
        config: all parameters, or a preset or file; None: the defaults, or those stored in
            ``map_file``, and else what an inspection of the recording chooses.
        settings: single parameters, ``{'section.name': value}``.
        inspect: False: do not inspect the recording. One without an end is not inspected.
        image_topic, odom_topic, scan_topic: the topics to read, None for the only one.
        visual_odometry: estimate odometry from the camera, even if there is an odometry topic.
        landmarks: also map corners and edges of walls.
        start_s, duration_s: the part of the recording to use, in s.
        images_rate_hz: frame rate of a folder of images without time stamps.
        map_file: save the map in this file while it is built; if there is one, continue it.
        localize: leave the map of ``map_file`` unchanged, and only localise the robot on it.
        history: write history.sqlite, from which ``ratslam view`` shows any moment of the run.
        video: file for a video of the growing map.
        stages: stages of your own, see ``RatSLAM``. Scans are read if one of them reads `scan`.
        quiet: print only warnings on standard error: no notices and no progress bars.
        progress: called with the phase, 'inspecting' (in several passes) or 'mapping', and the
            processed and the total seconds of the recording, in place of the progress bars.

    Raises:
        UnusableInput: the recording, a file or the folder cannot be used.
        UnusableParameter: a parameter is unknown, or does not fit the recording.
        KeyboardInterrupt: interrupted before the first result. A later interrupt ends the replay;
            ``interrupted`` of the result is set then.
    """
    if localize and map_file is None:
        raise UnusableInput('--localize needs the map to localise on: give --map FILE')
    if video is not None:
        check_path(video := Path(video))
    settings = settings or {}
    saved = None
    if map_file is not None:
        notify = (lambda line: None) if quiet else print_notice
        saved = ReplayMap(Path(map_file), localize, notify, print_notice)
    parameters, is_chosen = _parameters(config, settings, saved)
    shown = not quiet if progress is None else progress
    opened = (
        nullcontext(recording) if isinstance(recording, Recording)
        else open_recording(recording, images_rate_hz=images_rate_hz)
    )
    with opened as source:
        if video is not None:
            check_output(video, source.path)
        selection = source.select(
            image_topic, odom_topic, visual_odometry, scan_topic,
            parameters.experience_map.exp_align_scans or landmarks
            or any('scan' in stage(parameters).readers() for stage in stages),
        )
        if not quiet:
            print_notices(selection.notices)
        compile_kernels()
        if inspect and not is_chosen and not source.is_endless:
            inspection = inspect_recording(
                source, selection, parameters, settings, start_s, duration_s, shown
            )
            parameters = inspection.config
            if not quiet:
                print_notices(inspection.lines)
        folder = Path(out or tempfile.mkdtemp(prefix='ratslam-'))
        try:
            outcome = replay(
                source, selection, parameters, folder,
                ReplayOptions(start_s, duration_s, video, shown, landmarks, history,
                              images_rate_hz, map_file=saved, stages=stages),
            )
        except BaseException:
            if out is None:
                shutil.rmtree(folder)
            raise
        warnings = list(source.warnings)
    if saved is None or not saved.skipped:
        warnings += _empty_map_warnings(outcome.summary)
    warnings += _loss_warnings(outcome.summary)
    print_notices([f'warning: {warning}' for warning in warnings])
    is_usual = images_rate_hz == IMAGES_RATE_HZ
    topics = _words({
        'image-topic': image_topic, 'odom-topic': odom_topic,
        'images-rate': None if is_usual else f'{images_rate_hz:g}',
    })
    given = (
        *_words({'config': None if isinstance(config, Config) else config}),
        *(word for name, value in settings.items() for word in ('--set', f'{name}={value}')),
        *['--visual-odometry'] * visual_odometry,
    )
    advice = []
    if saved is None and not source.is_endless:
        advice = advise(outcome.observations, outcome.summary, Source(
            source.path, outcome.config, selection.odom_topic is None, topics, given
        ))
    result = MapResult(
        **vars(outcome), folder=folder, warnings=warnings, advice=advice, map_file=saved
    )
    if out is None:
        weakref.finalize(result, shutil.rmtree, folder, ignore_errors=True)
    return result


def _parameters(
    config: Config | str | Path | None, settings: Mapping[str, Value], saved: ReplayMap | None
) -> tuple[Config, bool]:
    """Return all parameters, and whether they are given or stored, so that nothing is chosen."""
    if isinstance(config, Config):
        return config.with_values(settings), True
    stored = '' if saved is None or config is not None else saved.configuration()
    if saved is not None and stored:
        found, notices = stored_config(stored, str(saved.path))
    else:
        found, notices = load_config(None if config is None else str(config))
    print_notices(notices)
    return found.with_values(settings), bool(stored) or config is not None


def _words(options: Mapping[str, str | Path | None]) -> tuple[str, ...]:
    """Return options as words of a command line, without those that are None."""
    return tuple(
        word for name, value in options.items() if value is not None
        for word in (f'--{name}', str(value))
    )


def _table(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> NDArray[np.void]:
    """Return rows as a structured array; the text of a number is converted exactly."""
    table = np.empty(len(rows), [*columns.items()])
    for name, kind in columns.items():
        table[name] = [int(row[name]) if kind == 'i8' else float(row[name]) for row in rows]
    return table


def _lost(summary: Mapping[str, Any]) -> dict[str, int]:
    """Return the number of messages that were not used, by reason."""
    return {key: summary[key] for key in ('dropped', 'late', 'refused') if summary[key]}


def _loss_warnings(summary: Mapping[str, Any]) -> list[str]:
    """Return a warning if at least a tenth of the messages could not be used."""
    lost = _lost(summary)
    if not lost or sum(lost.values()) * 10 < summary['frames'] + summary['odometry']:
        return []
    counts = ', '.join(f'{number} {key}' for key, number in lost.items())
    return [f'many messages were not used ({counts}): undecodable images and scans are dropped, '
            'messages whose stamps are negative or do not increase are refused, and messages more '
            'than max_lateness_s behind the other topics are late']


def _empty_map_warnings(summary: Mapping[str, Any]) -> list[str]:
    """Return a warning if a whole stream was unusable."""
    if not summary['odometry']:
        camera = ('expected successive images of one size' if summary.get('visual_odometry')
                  else 'try --visual-odometry')
        return [f'no odometry could be used, so the map is empty; {camera}, or a longer part of '
                'the recording']
    if not summary['frames']:
        return ['no image or template could be used, so the map is empty']
    return []
