# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots: no display needed, identical files, error messages, bounded cost."""

import json
import math

import cv2
import numpy as np
import pytest
from helpers import START_NS

from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnusableInput
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.results import plots
from ratslam_ros.results.evaluation import evaluate
from ratslam_ros.results.plots import (
    draw_all,
    draw_map,
    draw_matches,
    plot_evaluation,
)
from ratslam_ros.results.trajectory import read_tum
from ratslam_ros.results.writer import FRAMES_HEADER

VERMILLION_BGR = (0x00, 0x5E, 0xD5)
ELLIPSE_M = (10.0, 6.0)


def write_results(folder, frames=400, per_lap=60, laps=3):
    """Write the results of a run of some laps on an ellipse."""
    folder.mkdir(exist_ok=True)

    def pose(lap):
        angle = 2.0 * math.pi * lap
        return (ELLIPSE_M[0] * math.cos(angle), ELLIPSE_M[1] * math.sin(angle),
                angle + math.pi / 2)

    graph = ExperienceMap(ExperienceMapParameters())
    for k in range(per_lap):
        graph.apply(MapAction('create', k - 1, k, k, 0.0, Place(0.0, 0.0, 0.0)))
    graph.apply(MapAction('link', per_lap - 1, 0, 0, 0.0, Place(0.0, 0.0, 0.0)))
    content = json.loads(encode_map(0, graph))
    for k, one in enumerate(content['experiences']):
        one['x_m'], one['y_m'] = pose(k / per_lap)[:2]
    content['current_experience_id'] = 20
    (folder / 'map.json').write_text(json.dumps(content))

    def write_tum(name, turn, shift):
        c, s = math.cos(turn), math.sin(turn)
        with (folder / name).open('w') as file:
            for i in range(frames):
                x, y, heading = pose(laps * i / frames)
                x, y = c * x - s * y + shift, s * x + c * y
                stamp_ns = START_NS + i * 10**8
                file.write(f'{stamp_ns // 10**9}.{stamp_ns % 10**9:09d} {x!r} {y!r} 0 0 0 '
                           f'{math.sin((heading + turn) / 2)!r} '
                           f'{math.cos((heading + turn) / 2)!r}\n')

    write_tum('trajectory.tum', 0.0, 0.0)
    write_tum('trajectory_final.tum', 0.0, 0.0)
    write_tum('dead_reckoning.tum', -1.0, 0.0)
    write_tum('truth.tum', 2.0, 50.0)
    with (folder / 'frames.csv').open('w') as file:
        file.write('stamp_ns,template_id,is_new,match_error,relative_rad,experience_id\n')
        for i in range(frames):
            place = laps * per_lap * i // frames
            new = place < per_lap and (i == 0 or place != laps * per_lap * (i - 1) // frames)
            error = -1.0 if i == 0 else (0.06 if new else 0.02) + 0.01 * math.sin(i)
            file.write(f'{START_NS + i * 10**8},{place % per_lap},{int(new)},{error!r},0.0,'
                       f'{place % per_lap}\n')
        file.write(f'{START_NS + frames * 10**8},-1,0,-1.0,0.0,{per_lap - 1}\n')
    (folder / 'config.yaml').write_text('local_view:\n  vt_match_threshold: 0.045\n')
    return folder


def pixels(path, colour):
    """Return how many pixels have exactly this colour (b, g, r)."""
    return int(np.all(cv2.imread(str(path)) == colour, axis=2).sum())


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    return write_results(tmp_path_factory.mktemp('results'))


def test_draw_all_twice_writes_identical_files(folder):
    paths = draw_all(folder, folder / 'truth.tum')
    assert [path.name for path in paths] == ['map.png', 'matches.png']
    before = [path.read_bytes() for path in paths]
    assert [path.read_bytes() for path in draw_all(folder, folder / 'truth.tum')] == before
    assert all(b'atplotlib' not in png and b'tIME' not in png for png in before)


def test_axes_have_no_metres_if_the_scale_is_unknown(folder, monkeypatch):
    labels = []
    save = plots.save_figure

    def record(figure, path):
        labels.append(figure.axes[0].get_xlabel())
        return save(figure, path)

    monkeypatch.setattr(plots, 'save_figure', record)
    summary = folder / 'summary.json'
    for text in ('{"frames": 3}', '{"visual_odometry": true}'):
        summary.write_text(text)
        draw_map(folder)
    summary.unlink()
    assert labels == ['x [m]', f'x {plots.UNKNOWN_SCALE}']


def test_loop_closures_are_found(folder):
    assert pixels(draw_map(folder), VERMILLION_BGR) > 0


def test_matches_show_new_templates_and_threshold(folder):
    assert pixels(draw_matches(folder), VERMILLION_BGR) > 100
    drawn = (folder / 'matches.png').read_bytes()
    (folder / 'config.yaml').rename(folder / 'elsewhere')
    assert draw_matches(folder).read_bytes() != drawn
    (folder / 'elsewhere').rename(folder / 'config.yaml')


def test_empty_run_is_drawn(tmp_path):
    (tmp_path / 'map.json').write_text(encode_map(0, ExperienceMap(ExperienceMapParameters())))
    (tmp_path / 'frames.csv').write_text(f'{FRAMES_HEADER}\n')
    assert all(path.stat().st_size > 1000 for path in draw_all(tmp_path))


@pytest.mark.parametrize(('count', 'label'), [
    (1, None), (2, 'component 1, not joined'), (60, '59 components, not joined'),
])
def test_components_have_one_entry_of_the_legend(folder, tmp_path, count, label, monkeypatch):
    content = json.loads((folder / 'map.json').read_text())
    content['components'] = [k % count for k in range(len(content['experiences']))]
    (tmp_path / 'map.json').write_text(json.dumps(content))
    labels = []
    add = plots.add_legend_below

    def record(figure, axes):
        labels.extend(axes.get_legend_handles_labels()[1])
        add(figure, axes)

    monkeypatch.setattr(plots, 'add_legend_below', record)
    draw_map(tmp_path)
    assert [text for text in labels if 'component' in text] == [label] * (label is not None)


@pytest.mark.parametrize(('name', 'text', 'complaint'), [
    ('map.json', '{', 'not a map'),
    ('map.json', '[]', 'not a map'),
    ('frames.csv', 'a,b\n', 'the first line has to name stamp_ns'),
    ('frames.csv', f'{FRAMES_HEADER}\n1,2\n', 'line 2'),
    ('frames.csv', f'{FRAMES_HEADER}\n1,2,0,x,0.0,3\n', 'line 2'),
    ('frames.csv', f'{FRAMES_HEADER}\n1,2,7,0.1,0.0,3\n', 'line 2'),
])
def test_unusable_results_are_rejected_in_one_line(folder, tmp_path, name, text, complaint):
    for file in ('map.json', 'frames.csv'):
        (tmp_path / file).write_bytes((folder / file).read_bytes())
    (tmp_path / name).write_text(text)
    with pytest.raises(UnusableInput, match=complaint) as caught:
        draw_all(tmp_path)
    assert '\n' not in str(caught.value)


def test_folder_without_results_is_rejected_with_advice(tmp_path):
    with pytest.raises(UnusableInput, match='the folder that ratslam replay wrote'):
        draw_map(tmp_path)
    with pytest.raises(UnusableInput, match='the folder that ratslam replay wrote'):
        draw_matches(tmp_path)


def test_truth_without_common_stamps_is_rejected(folder):
    truth = read_tum(folder / 'truth.tum')
    late = type(truth)(truth.stamp_ns + 10**13, truth.position_m, truth.heading_rad, True)
    with pytest.raises(UnusableInput, match='same clock'):
        draw_map(folder, late)


def test_evaluation_is_drawn_or_refused_in_one_line(folder, tmp_path):
    result = evaluate(read_tum(folder / 'trajectory.tum'), read_tum(folder / 'truth.tum'))
    assert plot_evaluation(result, tmp_path / 'a.png').stat().st_size > 1000
    with pytest.raises(UnusableInput, match='cannot be written'):
        plot_evaluation(result, tmp_path / 'no' / 'a.png')
