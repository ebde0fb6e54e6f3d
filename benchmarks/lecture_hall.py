# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectory errors on real odometry with partly wrong recognitions: places of TU Chemnitz.

    python benchmarks/lecture_hall.py [--data ../shared/data] [--config NAME]
    python benchmarks/lecture_hall.py --convert FOLDER      only write the recording and its truth

The data (Neubert et al. 2019) contain odometry and loop candidates with a similarity, 13 % of them
wrong by more than 5 m, but no images. They are converted to a recording of `/odom` and
`/local_view/template` without using the truth:

- Views are taken at all times of candidates, and every 1.2 m or 0.6 rad between them.
- The view at t1 gets the template of its most similar t2 that is at least 10 s older, or a new
  one. It is sent every 0.2 s until the next view.
- Odometry is averaged over 0.5 s; only its forward speed and turn rate are used.

`convert` also converts tuc_corridor, of the same authors, for defaults_on_recordings.py. Only its
candidates with a similarity of at least 0.8 count, and their times are rounded to whole seconds:
candidates of the same second belong to one place.

The script prints the errors of trajectory_final and trajectory (RMSE after rigid alignment in the
plane) for the preset lecture_hall and for nine settings around it, over a factor of 8 in
pc_vt_inject_energy and a factor of 4 in pc_cell_x_size. The preset was tuned on this recording, as
there is no second one, so the errors of the nine settings matter more. With `--config NAME`, for
example default, it prints those of that configuration and of twelve settings on top of it: four of
pc_vt_inject_energy and three of pc_cell_x_size.
"""

from __future__ import annotations

import argparse
import itertools
import math
import statistics
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.files.config import load_config
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.mapping import TemplatePayload
from ratslam_ros.offline.replay import ReplayOptions, replay
from ratslam_ros.recordings import open_recording
from ratslam_ros.results.evaluation import evaluate
from ratslam_ros.results.trajectory import Trajectory, read_tum, tum_line

ROOT = Path(__file__).resolve().parents[1]
FOLDER = 'lecture_hall'
ODOMETRY_SAMPLES = 5
"""Number of odometry samples that are averaged, of 0.1 s each."""

VIEW_M, VIEW_RAD, VIEW_S = 1.2, 0.6, 0.2
"""Distance or rotation after which a view is taken, and the interval at which it is sent."""

OLDER_S = 10.0
"""Least age of a candidate that a view is matched with."""

ENERGY_FACTORS = (1 / math.sqrt(8), 1.0, math.sqrt(8))
CELL_FACTORS = (0.5, 1.0, 2.0)
ENERGIES = (0.03, 0.07, 0.15, 0.24)
CELLS_M = (0.5, 1.0, 2.0)

Table = NDArray[np.float64]


@dataclass(frozen=True)
class Source:
    """Data of one place.

    folder: folder of the files. files: beginning of their names. similarity: least similarity of
    the candidates that are used. decimals: to which their times are rounded.
    """

    folder: str
    files: str
    similarity: float = 0.0
    decimals: int = 12


LECTURE_HALL = Source(FOLDER, 'Lecture_Hall')
TUC_CORRIDOR = Source('tuc_corridor', 'Corridor', similarity=0.8, decimals=0)


def read(data: Path, source: Source) -> tuple[Table, Table, Table]:
    """Return odometry (t, v_x, w), loop candidates (t1, t2, similarity) and truth (t, x, y)."""
    odometry, loops = [], []
    folder = data / source.folder
    with open(folder / f'{source.files}_Input.txt', encoding='ascii') as file:
        for line in file:
            kind, *fields = line.split()
            if kind == 'odom2':
                odometry.append([float(fields[0]), float(fields[1]), float(fields[3])])
            elif kind == 'loop':
                t1, t2, similarity = map(float, fields[:3])
                if similarity >= source.similarity:
                    decimals = source.decimals
                    loops.append([round(t1, decimals), round(t2, decimals), similarity])
    truth: list[list[float]] = []
    with open(folder / f'{source.files}_GT.txt', encoding='ascii') as file:
        for line in file:
            point = [float(field) for field in line.split()[1:4]]
            if truth and point[0] <= truth[-1][0]:
                break  # a second table follows, with times from 0
            truth.append(point)
    return np.array(odometry), np.array(loops), np.array(truth)


def view_times(odometry: Table, loops: Table) -> list[float]:
    """Return the times at which views are taken, in s."""
    candidate_times = sorted({*loops[:, 0].tolist(), *loops[:, 1].tolist()})
    times = [float(odometry[0, 0])]
    distance_m = turn_rad = 0.0
    next_candidate = 0
    for (before_s, _, _), (now_s, speed, rate) in itertools.pairwise(odometry):
        distance_m += abs(speed) * (now_s - before_s)
        turn_rad += abs(rate) * (now_s - before_s)
        taken = False
        while next_candidate < len(candidate_times) and candidate_times[next_candidate] <= now_s:
            times.append(candidate_times[next_candidate])
            next_candidate += 1
            taken = True
        if not taken and (distance_m >= VIEW_M or turn_rad >= VIEW_RAD):
            times.append(float(now_s))
            taken = True
        if taken:
            distance_m = turn_rad = 0.0
    return sorted(set(times))


def view_templates(times_s: list[float], loops: Table) -> list[tuple[int, float]]:
    """Return the template id and the match error (-1: new template) of each view.

    The match error is one minus the similarity.
    """
    best: dict[float, tuple[float, float]] = {}
    for t1, t2, similarity in loops.tolist():
        if t1 - t2 >= OLDER_S and similarity > best.get(t1, (-1.0, 0.0))[0]:
            best[t1] = similarity, t2
    templates: dict[float, int] = {}
    views = []
    new = 0
    for time_s in times_s:
        if time_s in best:
            similarity, older_s = best[time_s]
            templates[time_s] = templates[older_s]
            views.append((templates[time_s], 1.0 - similarity))
        else:
            templates[time_s] = new
            views.append((new, -1.0))
            new += 1
    return views


def convert(data: Path, folder: Path, source: Source = LECTURE_HALL) -> tuple[Path, Path]:
    """Write the recording and the truth to a folder; return their paths."""
    odometry, loops, truth = read(data, source)
    recording, truth_path = folder / source.folder, folder / 'truth.tum'
    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    vector, quaternion = types['geometry_msgs/msg/Vector3'], types['geometry_msgs/msg/Quaternion']
    pose = types['geometry_msgs/msg/PoseWithCovariance'](
        types['geometry_msgs/msg/Pose'](
            types['geometry_msgs/msg/Point'](0.0, 0.0, 0.0), quaternion(0.0, 0.0, 0.0, 1.0)
        ),
        np.zeros(36),
    )

    def odometry_message(stamp_ns: int, speed: float, rate: float) -> bytes:
        stamp = types['builtin_interfaces/msg/Time'](stamp_ns // 10**9, stamp_ns % 10**9)
        twist = types['geometry_msgs/msg/Twist'](vector(speed, 0.0, 0.0), vector(0.0, 0.0, rate))
        message = types['nav_msgs/msg/Odometry'](
            types['std_msgs/msg/Header'](stamp, 'odom'), 'base_link', pose,
            types['geometry_msgs/msg/TwistWithCovariance'](twist, np.zeros(36)),
        )
        return bytes(store.serialize_cdr(message, 'nav_msgs/msg/Odometry'))

    messages: list[tuple[int, str, bytes]] = []
    for start in range(0, len(odometry) - ODOMETRY_SAMPLES + 1, ODOMETRY_SAMPLES):
        part = odometry[start : start + ODOMETRY_SAMPLES]
        stamp_ns = round(part[-1, 0] * 1e9)
        mean_v, mean_w = part[:, 1].mean(), part[:, 2].mean()
        messages.append((stamp_ns, '/odom', odometry_message(stamp_ns, mean_v, mean_w)))
    times_s = view_times(odometry, loops)
    views = view_templates(times_s, loops)
    seen: set[int] = set()
    current = 0
    for tick in range(int(odometry[-1, 0] / VIEW_S) + 1):
        time_s = tick * VIEW_S
        while current + 1 < len(times_s) and times_s[current + 1] <= time_s:
            current += 1
        template, error = views[current]
        stamp_ns = round(time_s * 1e9)
        match = ViewMatch(template, template not in seen, error, 0.0)
        seen.add(template)
        text = types['std_msgs/msg/String'](encode(TemplatePayload.of(stamp_ns, match, 0)))
        data_bytes = bytes(store.serialize_cdr(text, 'std_msgs/msg/String'))
        messages.append((stamp_ns, '/local_view/template', data_bytes))
    with Writer(recording, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            name: writer.add_connection(name, kind, typestore=store)
            for name, kind in (
                ('/odom', 'nav_msgs/msg/Odometry'),
                ('/local_view/template', 'std_msgs/msg/String'),
            )
        }
        for stamp_ns, topic, payload in sorted(messages, key=lambda m: m[:2]):
            writer.write(connections[topic], stamp_ns, payload)
    truth_path.write_text(
        ''.join(tum_line(round(t * 1e9), Pose(x, y, 0.0)) for t, x, y in truth.tolist()),
        encoding='ascii',
    )
    return recording, truth_path


def errors(recording: Path, truth: Trajectory, config: Config, folder: Path) -> tuple[float, ...]:
    """Replay the recording; return the ATE RMSE in m of its trajectories.

    They are trajectory_final, trajectory and dead_reckoning.
    """
    with open_recording(recording) as opened:
        replay(opened, opened.select(), config, folder, ReplayOptions(progress=False))
    return tuple(
        evaluate(read_tum(folder / f'{name}.tum'), truth).ate.rmse
        for name in ('trajectory_final', 'trajectory', 'dead_reckoning')
    )


def settings_of(name: str, config: Config) -> list[tuple[float, float]]:
    """Return the settings of energy and cell size in m to evaluate."""
    if name != FOLDER:
        return list(itertools.product(ENERGIES, CELLS_M))
    p = config.pose_cells
    return [
        (round(p.pc_vt_inject_energy * energy, 4), round(p.pc_cell_x_size * cell, 4))
        for energy, cell in itertools.product(ENERGY_FACTORS, CELL_FACTORS)
    ]


def run(
    data: Path, name: str = FOLDER
) -> tuple[tuple[float, ...], dict[tuple[float, float], tuple[float, ...]]]:
    """Return the errors of a configuration, and those of the settings of ``settings_of``."""
    config, _ = load_config(name)
    with tempfile.TemporaryDirectory() as temporary:
        recording, truth_path = convert(data, Path(temporary))
        truth = read_tum(truth_path)
        out = Path(temporary) / 'results'
        around = {}
        for energy, cell in settings_of(name, config):
            setting = config.with_values(
                {'pose_cells.pc_vt_inject_energy': energy, 'pose_cells.pc_cell_x_size': cell}
            )
            around[energy, cell] = errors(recording, truth, setting, out)
        return errors(recording, truth, config, out), around


def report(data: Path, name: str = FOLDER) -> str:
    """Return the results as text."""
    if not (data / FOLDER).is_dir():
        return f'lecture_hall: skipped, {data / FOLDER} not found'
    preset, around = run(data, name)
    lines = [
        'lecture_hall, ATE RMSE in m      final       live   dead reckoning',
        f'{"preset" if name == FOLDER else name:<31}{preset[0]:7.2f}    {preset[1]:7.2f}          '
        f'{preset[2]:7.2f}',
    ]
    for (energy, cell), (final, live, _) in around.items():
        setting = f'energy {energy:6.3f}, cells {cell:5.2f} m'
        lines.append(f'{setting}   {final:7.2f}    {live:7.2f}')
    finals = [figures[0] for figures in around.values()]
    lines.append(
        f'median of the {"nine" if len(finals) == 9 else len(finals)} settings '
        f'{statistics.median(finals):.2f}, worst {max(finals):.2f}'
    )
    return '\n'.join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    parser.add_argument('--config', default=FOLDER, metavar='NAME')
    parser.add_argument('--convert', type=Path, metavar='FOLDER')
    options = parser.parse_args()
    if options.convert:
        for path in convert(options.data, options.convert):
            print(path)
    else:
        print(report(options.data, options.config))


if __name__ == '__main__':
    main()
