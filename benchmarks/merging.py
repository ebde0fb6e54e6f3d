# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Maps merged of several sessions, compared with one session and with the truth.

    python benchmarks/merging.py halves [--data ../shared/data]
    python benchmarks/merging.py others [--data ../shared/data]
    python benchmarks/merging.py many
    python benchmarks/merging.py floors [--minutes 8] [--plan NAME] [--seed 1]

halves: each half of a recording is a session. The map of both is compared with that of the whole
    recording: numbers of templates and experiences, and the error. It is the ATE RMSE for demos
    and lecture_hall, and for laps the spread: the median distance between frames of different
    laps that show the same place, relative to the diameter of the map.
others: pairs of maps of different places: the demos of different seeds have the same floor plan
    and partly equal walls. None may be joined. Then the limit on the share of recognised places
    is chosen without each recording in turn, between the extremes of the others, and tested on
    that recording.
many: a demo as eight sessions of 50 s, merged at once and one after the other.
floors: a floor of the simulator on two days. On the second one, the light is other, five people
    walk about, and a box stands in the way. Merged map and sessions are compared with the truth.
    Then a robot starts in the merged map, finds itself, and drives to places that were named on
    the first day. A floor with the same plan and other walls must not be joined.

The lecture hall has no images; those given to the local view are noise for each place of the loop
candidates, 13 % of which are wrong.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import lecture_hall
import navigation
import numpy as np
from lap_measures import ROOT, spread
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.config import Config
from ratslam_ros.core.merging.merge import JoinReport, MergedMap, merge_sessions
from ratslam_ros.core.merging.session import Session
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.event_inputs import calibrated, head_of, odometry_from_event
from ratslam_ros.files.config import load_config
from ratslam_ros.messages.json_schema import decode
from ratslam_ros.messages.mapping import TemplatePayload
from ratslam_ros.offline.inspection import inspect
from ratslam_ros.pipeline.items import Step, ViewStep
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.recordings import ImageEvent, OdometryEvent, Recording, open_recording
from ratslam_ros.results.evaluation import evaluate, fit
from ratslam_ros.results.trajectory import Trajectory, read_tum
from ratslam_ros.results.writer import Places
from ratslam_simulator.closed_loop import ClosedLoop
from ratslam_simulator.config import SimulatorParameters, parse_start
from ratslam_simulator.floor_plan import load_floor_plan
from ratslam_simulator.recording import write_recording
from ratslam_simulator.simulation import ObstacleEvent, Simulator
from ratslam_simulator.trials import attempt, choose_goals
from ratslam_tuning.lap_phases import read_lap_phases
from ratslam_tuning.map_score import poses_at

LAPS = 'rc_car_loops', 'donkeycar_track', 'lab_car'
DEMO_SEEDS = 1, 2, 3
FLOORS = 'university_floor', 'hall', 'house', 'school', 'obstacle_loop'
HALL_VIEWS = {
    'local_view.vt_descriptor': 'intensity', 'local_view.template_x_size': 24,
    'local_view.template_y_size': 8, 'local_view.vt_shift_match': 0,
    'local_view.vt_shift_match_y': 0, 'local_view.vt_min_structure': 0.0,
    'local_view.vt_match_threshold': 0.05, 'local_view.vt_match_ratio': 0.655,
    'local_view.vt_recent_templates': 0,
}
"""Encoding of the noise images: equal or unrelated."""

SESSIONS_COUNT, SESSION_S = 8, 50.0
GOALS_COUNT = 5
FIND_S = 300.0
"""Time within which the robot has to find itself on the merged map."""

Frame = tuple[int, int, Pose]
"""Stamp, place id of the current experience (``Places``), and pose of the robot in its frame."""


@dataclass(frozen=True)
class Run:
    """A session and where the robot was at each image."""

    session: Session
    frames: list[Frame]
    places: Places
    rotation_gain: float


@dataclass(frozen=True)
class Recorded:
    """Two halves of a recording and the whole; error: of a trajectory, with its unit."""

    name: str
    halves: tuple[Run, Run]
    whole: Run
    error: Callable[[Trajectory], float]
    unit: str


def run(
    recording: Recording, config: Config, name: str, start_s: float, duration_s: float | None
) -> Run:
    """Replay a part of a recording."""
    selection = recording.select()
    # The templates of lecture_hall become images.
    head = head_of(selection) if selection.template_topic is None else 'local_view'
    slam, frames, places = RatSLAM(config, head), [], Places()

    def take(steps: list[Step]) -> None:
        graph = slam.experience_map
        for step in steps:
            if isinstance(step, ViewStep):
                if step.pruned is not None:
                    places.prune(step.pruned)
                frames.append((step.stamp_ns, places.of(graph.current_id), graph.offset))

    for event in recording.events(selection, start_s, duration_s):
        if isinstance(event, ImageEvent):
            take(slam.image(event.stamp_ns, event.grey()))
        elif isinstance(event, OdometryEvent):
            take(slam.odometry(odometry_from_event(event)))
        elif hasattr(event, 'payload'):  # lecture_hall
            template = decode(TemplatePayload, event.payload)
            take(slam.image(template.stamp.ns, _noise_image(template.id)))
    take(slam.finish())
    calibration = slam.pose_cells.calibration
    gain = 1.0 if calibration is None else calibration.correction.gain
    return Run(Session(name, config, slam.state()), frames, places, gain)


@cache
def _noise_image(template_id: int) -> NDArray[np.uint8]:
    return np.random.default_rng(template_id).integers(0, 256, (8, 24)).astype(np.uint8)


ErrorOf = Callable[[Run], Callable[[Trajectory], float]]


def in_halves(path: Path, name: str, config: Config, error_of: ErrorOf, unit: str) -> Recorded:
    """Return the sessions of both halves, and of the whole."""
    with open_recording(path) as recording:
        half_s = 0.5e-9 * (recording.end_ns - recording.start_ns)
        whole = run(recording, config, f'{name}, whole', 0.0, None)
        if recording.select().odom_topic is None:  # A half has too few loops to show it.
            fov_deg = config.visual_odometry.camera_fov_deg * whole.rotation_gain
            config = config.with_values({'visual_odometry.camera_fov_deg': fov_deg})
        first = run(recording, config, f'{name}, first half', 0.0, half_s)
        second = run(recording, config, f'{name}, second half', half_s, None)
    return Recorded(name, (first, second), whole, error_of(whole), unit)


def recordings(data: Path, temporary: Path) -> Iterator[Recorded]:
    """Yield all recordings that are present, in halves."""
    default = Config()
    for seed in DEMO_SEEDS:
        made = write_recording(temporary / f'demo{seed}', seed)
        truth = read_tum(made.truth)
        yield in_halves(made.recording, f'demo {seed}', default, _ate(truth), 'm')
    for name in LAPS:
        if (data / name).is_dir():
            with open_recording(data / name) as recording:
                selection = recording.select()
                config = calibrated(
                    inspect(recording, selection, default).config, recording, selection
                )
            yield in_halves(data / name, name, config, _spread(data / name / 'lap_phase.csv'), '')
    if (data / lecture_hall.FOLDER).is_dir():
        path, truth_path = lecture_hall.convert(data, temporary)
        config = default.with_values(HALL_VIEWS)
        yield in_halves(path, lecture_hall.FOLDER, config, _ate(read_tum(truth_path)), 'm')


def _ate(truth: Trajectory) -> ErrorOf:
    return lambda _: lambda trajectory: evaluate(trajectory, truth, max_difference_s=0.3).ate.rmse


def _spread(lap_phase: Path) -> ErrorOf:
    phases = read_lap_phases(lap_phase)

    def error_of(whole: Run) -> Callable[[Trajectory], float]:
        stamp_ns = np.array([stamp for stamp, _, _ in whole.frames])

        def spread_of(trajectory: Trajectory) -> float:
            used = np.isin(stamp_ns, trajectory.stamp_ns)
            return spread(poses_at(trajectory, stamp_ns)[0], phases.only(used))

        return spread_of

    return error_of


def trajectory_on(merged: MergedMap, runs: tuple[Run, ...]) -> Trajectory:
    """Return the trajectory of some sessions on a map, as trajectory_final of a replay."""
    core = merged.states['experience_map']['core']
    poses = core['poses']
    components = core.get('components', {'experiences': [0] * len(poses)})['experiences']
    rows = []
    for one in runs:
        number = merged.names.index(one.session.name)
        own = merged.experience_ids[number].tolist()
        final = [
            composed(Pose(*poses[i].tolist()), Pose(*offset.tolist()))
            if components[i] == 0 else Pose(math.nan, math.nan, math.nan)
            for i, offset in zip(own, merged.offsets[number], strict=True)
        ]
        pose_of = one.places.poses(final.__getitem__)
        for stamp_ns, place, offset in one.frames:
            if place != NO_EXPERIENCE and not math.isnan(pose_of(place).x_m):
                rows.append((stamp_ns, *composed(pose_of(place), offset)))
    table = np.array(rows)
    stamps = np.array([row[0] for row in rows], np.int64)
    _, kept = np.unique(stamps, return_index=True)
    return Trajectory(stamps[kept], table[kept, 1:3], table[kept, 3], True)


def described(join: JoinReport) -> str:
    """Return a join in one line."""
    result = f'refused: {join.refused}' if join.refused else f'residual {join.residual_m:.2f} m'
    return (
        f'      {join.by}: {join.matched} matches, {join.places} places, share {join.share:.2f} '
        f'of {join.overlapping}; {result}'
    )


def size(merged: MergedMap) -> str:
    """Return the size of a map."""
    core = merged.states['experience_map']['core']
    templates = len(merged.states['local_view']['core']['templates'])
    return f'{templates:5} templates {len(core["labels"]):5} experiences'


def report_halves(data: Path) -> None:
    """Print sizes and errors of halves, merged and whole."""
    with tempfile.TemporaryDirectory() as temporary:
        for one in recordings(data, Path(temporary)):
            start_s = time.perf_counter()
            merged = merge_sessions([half.session for half in one.halves])
            took_s = time.perf_counter() - start_s
            maps = [
                (f'{one.name}: merged', merged, one.halves),
                ('whole recording', merge_sessions([one.whole.session]), (one.whole,)),
                *((half.session.name, merge_sessions([half.session]), (half,))
                  for half in one.halves),
            ]
            for name, shown, runs in maps:
                error = one.error(trajectory_on(shown, runs))
                print(f'{name:34}{size(shown)}   error {error:.3f} {one.unit}')
            for join in merged.joins:
                print(described(join))
            print(f'      {merged.components} components, merged in {took_s:.1f} s', flush=True)


def report_others(data: Path) -> None:
    """Print whether different places are joined, and the limit chosen without each recording."""
    with tempfile.TemporaryDirectory() as temporary:
        found = list(recordings(data, Path(temporary)))
    shares: dict[str, dict[bool, list[float]]] = {
        one.name: {True: [], False: []} for one in found
    }
    for one in found:
        merged = merge_sessions([half.session for half in one.halves])
        shares[one.name][True].append(max((join.share for join in merged.joins), default=0.0))
    demos = [one for one in found if one.name.startswith('demo')]
    for index, one in enumerate(demos):
        for other in demos[index + 1 :]:
            merged = merge_sessions([one.whole.session, other.whole.session])
            share = max((join.share for join in merged.joins), default=0.0)
            print(f'{one.name} and {other.name}: {merged.components} components')
            for join in merged.joins:
                print(described(join))
            for name in (one.name, other.name):
                shares[name][False].append(share)
    for name, own in shares.items():
        others = [found for other, found in shares.items() if other != name]
        least = min(min(found[True]) for found in others)
        most = max((max(found[False]) for found in others if found[False]), default=0.0)
        limit = math.sqrt(least * max(most, 0.02))
        right = min(own[True]) > limit and max(own[False], default=0.0) < limit
        print(
            f'without {name:18} limit {limit:.2f}: its share {min(own[True]):.2f}, of another '
            f'place at most {max(own[False], default=0.0):.2f}: {"right" if right else "WRONG"}'
        )


def report_many() -> None:
    """Print sizes of the merged map of more and more sessions."""
    config = Config()
    with tempfile.TemporaryDirectory() as temporary:
        made = write_recording(Path(temporary) / 'demo', 1)
        with open_recording(made.recording) as recording:
            sessions = [
                run(recording, config, f'{k}', k * SESSION_S, SESSION_S).session
                for k in range(SESSIONS_COUNT)
            ]
    for count in (1, 2, 4, SESSIONS_COUNT):
        merged = merge_sessions(sessions[:count])
        total = sum(merged.experiences)
        print(f'{count} sessions, {total:5} experiences: {size(merged)}, {merged.components} '
              'components')
    growing = sessions[0]
    for session in sessions[1:]:
        merged = merge_sessions([growing, session])
        growing = Session('growing', merged.config, merged.states)
    print(f'one after the other: {size(merged)}, {merged.components} components')


# Floors of the simulator


def loop_on(
    plan: str, seed: int, appearance: int, config: Config, changed: bool = False,
    box: tuple[float, float] | None = None,
) -> ClosedLoop:
    """Return a robot on a floor.

    Args:
        plan: the floor plan.
        seed: of all noise, of the light and of the people.
        appearance: seed of the walls.
        config: of RatSLAM.
        changed: whether it is the second day.
        box: centre of a box of half a metre.
    """
    path = navigation.FOLDER / f'{plan}.txt'
    floor = load_floor_plan(str(path) if path.exists() else plan)
    p = SimulatorParameters(seed=seed, light_change=0.3 if changed else 0.1)
    start = parse_start('any', floor)
    boxes = [] if box is None else [ObstacleEvent(0.0, 'add', 'box', *box, 0.5, 0.5)]
    people = 5 if changed else 0
    simulator = Simulator(floor, start, seed, p.options(), boxes, people, appearance)
    return ClosedLoop(simulator, config, seed)


def beside_path(loop: ClosedLoop) -> tuple[float, float]:
    """Return a position to the left of the place that is farthest from the start."""
    places = list(loop.log.truth_of.values())
    x_m, y_m, heading_rad = max(places, key=lambda pose: math.dist(pose[:2], places[0][:2]))
    return x_m - 0.7 * math.sin(heading_rad), y_m + 0.7 * math.cos(heading_rad)


def day(
    name: str, loop: ClosedLoop, minutes: float
) -> tuple[Session, dict[str, tuple[float, float]]]:
    """Explore, name places, and return the session and the true positions of its places."""
    places = navigation.explore_and_name(loop, 60.0 * minutes)
    states = loop.ratslam.state()
    names = {place: f'{place} of {name}' for place in places}
    for place, new_name in names.items():
        loop.navigator.goals.rename(place, new_name)
    states['experience_map']['goals'] = loop.navigator.goals.state()
    return Session(name, loop.config, states), {names[p]: at for p, at in places.items()}


def true_poses(merged: MergedMap, loops: dict[str, ClosedLoop]) -> dict[int, tuple[int, Pose]]:
    """Return session and true pose of the merged experiences that have one."""
    found: dict[int, tuple[int, Pose]] = {}
    for number, name in enumerate(merged.names):
        for own, pose in loops[name].log.truth_of.items():
            merged_id = int(merged.experience_ids[number][own])
            if not merged.offsets[number][own].any():
                found.setdefault(merged_id, (number, pose))
    return found


def map_error_m(merged: MergedMap, loops: dict[str, ClosedLoop]) -> tuple[float, int]:
    """Return the RMSE of positions of the largest component, and the number of sessions in it."""
    core = merged.states['experience_map']['core']
    components = core.get('components', {'experiences': [0] * len(core['labels'])})['experiences']
    found = {i: one for i, one in true_poses(merged, loops).items() if components[i] == 0}
    at = core['poses'][list(found), :2]
    truth = np.array([pose[:2] for _, pose in found.values()])
    errors = np.linalg.norm(fit(at, truth).apply(at) - truth, axis=1)
    return float(np.sqrt(np.mean(errors**2))), len({session for session, _ in found.values()})


def use_map(loop: ClosedLoop, merged: MergedMap, loops: dict[str, ClosedLoop]) -> None:
    """Let a robot that has not moved yet continue in a merged map."""
    loop.ratslam.restore(merged.states)
    loop.ratslam.begin_session()
    loop.navigator.goals.restore(merged.states['experience_map']['goals'])
    loop.log.truth_of = {i: pose for i, (_, pose) in true_poses(merged, loops).items()}


def report_floor(plan: str, minutes: float, seed: int) -> None:
    """Print the results of one floor."""
    config, _ = load_config('navigation')
    loops = {'monday': loop_on(plan, seed, seed, config)}
    days = {'monday': day('monday', loops['monday'], minutes)}
    box = beside_path(loops['monday'])
    loops['tuesday'] = loop_on(plan, seed + 100, seed, config, True, box)
    loops['other walls'] = loop_on(plan, seed + 200, seed + 7, config)
    days |= {name: day(name, loops[name], minutes) for name in ('tuesday', 'other walls')}
    for name, (session, _) in days.items():
        alone = merge_sessions([session])
        error_m, _ = map_error_m(alone, loops)
        print(f'{plan}: {name:22}{size(alone)}   error {error_m:.2f} m')
    start_s = time.perf_counter()
    merged = merge_sessions([days['monday'][0], days['tuesday'][0]])
    took_s = time.perf_counter() - start_s
    error_m, count = map_error_m(merged, loops)
    print(
        f'{plan}: {"merged":22}{size(merged)}   error {error_m:.2f} m, {merged.components} '
        f'components, the largest of {count} days; {took_s:.1f} s'
    )
    for join in merged.joins:
        print(described(join))
    false = merge_sessions([days['monday'][0], days['other walls'][0]])
    print(f'{plan}: monday and other walls: {false.components} components')
    for join in false.joins:
        print(described(join), flush=True)
    robot = loop_on(plan, seed + 300, seed, config, True, box)
    use_map(robot, merged, loops)
    unknown = robot.experience_map.component_of(NO_EXPERIENCE)
    robot.exploration.restart()
    robot.run(robot.exploring, lambda: robot.now_s > FIND_S or (
        robot.experience_map.component_of(NO_EXPERIENCE) != unknown
        and robot.experience_map.current_id != NO_EXPERIENCE
    ))
    found_s = robot.now_s
    places = {**days['monday'][1]}
    rng = np.random.Generator(np.random.PCG64(seed))
    names = choose_goals(places, robot.simulator.truth, GOALS_COUNT, rng)
    trials = [attempt(robot, name, places[name]) for name in names]
    reached = sum(trial.succeeded for trial in trials)
    texts = ', '.join(f'{t.outcome} at {t.error_m:.1f} m' for t in trials)
    print(
        f'{plan}: found on the merged map after {found_s:.0f} s; {reached} of {len(trials)} goals '
        f'of monday reached ({texts})', flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('experiment', choices=('halves', 'others', 'many', 'floors'))
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    parser.add_argument('--minutes', type=float, default=8.0, help='exploration of each day')
    parser.add_argument('--plan', choices=FLOORS, help='floor plan (default: all)')
    parser.add_argument('--seed', type=int, default=1)
    options = parser.parse_args()
    warm_up()
    if options.experiment == 'halves':
        report_halves(options.data)
    elif options.experiment == 'others':
        report_others(options.data)
    elif options.experiment == 'many':
        report_many()
    else:
        for plan in [options.plan] if options.plan else FLOORS:
            report_floor(plan, options.minutes, options.seed)


if __name__ == '__main__':
    main()
