# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal memory: comparison with the dense equations, and drives through small worlds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ratslam_ros.core.common.odometry import Motion, Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config, GoalMemoryParameters, additions
from ratslam_ros.core.goal_memory.goal_memory import GoalMemory, TemporalArray
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.errors import UnreachableGoal, UnusableInput
from ratslam_ros.pipeline.ratslam import RatSLAM

CELL_M = 0.25
DT_S = 0.1


def config(n_x: int = 60, n_y: int = 50) -> Config:
    return Config().with_values({
        'pose_cells.pc_dim_x': n_x, 'pose_cells.pc_dim_y': n_y,
        'pose_cells.pc_cell_x_size': CELL_M,
    })


def memory(n_x: int, n_y: int, update: str = 'cell') -> Any:
    chosen = additions.GOAL_ROUTES.instead_of(GoalMemory, GoalMemoryParameters(True, update))
    return chosen(config(n_x, n_y).pose_cells)


class Drive:
    """A robot with odometry only; it starts in the middle cell, heading along -x."""

    def __init__(self, n_x: int = 60, n_y: int = 50, update: str = 'cell') -> None:
        self.cells = PoseCells(config(n_x, n_y).pose_cells)
        self.memory = memory(n_x, n_y, update)

    @property
    def peak(self) -> Place:
        return self.cells.peak

    def move(self, dt_s: float, distance_m: float, turn_rad: float) -> None:
        motion = Motion(dt_s, distance_m, turn_rad)
        self.cells.integrate(motion)
        self.memory.integrate(motion, self.cells)

    def ahead(self, distance_m: float, speed_mps: float = 0.5) -> None:
        count = round(distance_m / speed_mps / DT_S)
        for _ in range(count):
            self.move(DT_S, distance_m / count, 0.0)

    def turn(self, angle_deg: float) -> None:
        for _ in range(10):
            self.move(DT_S, 0.0, math.radians(angle_deg) / 10)

    def towards(self, goal: Place, step_count: int) -> None:
        """Follow the bearing of the goal, until there is none or for a number of steps."""
        for _ in range(step_count):
            bearing = self.memory.bearing(self.memory.recall(goal), self.peak)
            if bearing is None:
                break
            speed = 0.3 if abs(bearing) < 0.8 else 0.0
            self.move(DT_S, speed * DT_S, max(-0.15, min(0.15, bearing)))


# Equations


def reference(n_x: int, n_y: int, seen: list[tuple[float, np.ndarray]]) -> Any:
    """Compute mu (n, n) by equations (2) to (5), cell by cell; NaN where there is no link."""
    from ratslam_ros.core.goal_memory.goal_routes import ACTIVE_SHARE

    n = n_x * n_y
    mu = np.full((n, n), np.nan)
    for (_, first), (travel_s, second) in itertools.pairwise(seen):
        i_share, j_share = first.ravel() / first.max(), second.ravel() / second.max()
        for i in range(n):
            for j in range(n):
                products = [
                    before * now
                    for before, now in ((i_share[i], j_share[j]), (i_share[j], j_share[i]))
                    if before >= ACTIVE_SHARE and now >= ACTIVE_SHARE
                ]
                if i == j or not products:
                    continue
                dx, dy = abs(i % n_x - j % n_x), abs(i // n_x - j // n_x)
                away = math.hypot(min(dx, n_x - dx), min(dy, n_y - dy))
                new = 1.0 * travel_s + 0.25 * (1.0 / max(products) - 1.0) + 0.1 * away
                mu[i, j] = new if np.isnan(mu[i, j]) else (mu[i, j] + new) / 2.0
    return mu


def relaxed(mu: np.ndarray, goal: int) -> np.ndarray:
    """Iterate equation (6) for the temporal map until it converges."""
    times = np.full(len(mu), np.inf)
    times[goal] = 0.0
    lengths = np.where(np.isnan(mu), np.inf, mu)
    while True:
        fewer = np.minimum(times, (times[None, :] + lengths).min(axis=1))
        if np.array_equal(fewer, times):
            return times
        times = fewer


@pytest.mark.parametrize('seed', range(2))
def test_links_and_times_equal_dense_equations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n_x, n_y = 6, 5
    goal_memory = memory(n_x, n_y)
    seen = []
    for _ in range(12):
        activity = rng.random((n_y, n_x)) ** 6
        seen.append((float(rng.uniform(0.1, 3.0)), activity))
        cells = np.flatnonzero(activity)
        goal_memory.learn(seen[-1][0], cells, activity.ravel()[cells])
    mu = reference(n_x, n_y, seen)
    assert len(goal_memory) * 2 == np.count_nonzero(~np.isnan(mu))
    assert np.array_equal(mu, mu.T, equal_nan=True)
    linked = np.flatnonzero((~np.isnan(mu)).any(axis=1))
    for goal in linked[:3].tolist():
        times = goal_memory.recall(Place(goal % n_x, goal // n_x, 0.0))
        np.testing.assert_allclose(times.remaining_s.ravel(), relaxed(mu, goal), rtol=1e-12)


def test_recall_is_cached_until_links_change() -> None:
    goal_memory = memory(20, 10)
    goal_memory.learn(1.0, np.array([3]), np.ones(1))
    goal_memory.learn(1.0, np.array([4]), np.ones(1))
    goal = Place(3.0, 0.0, 0.0)
    first = goal_memory.recall(goal)
    assert goal_memory.recall(goal) is first
    goal_memory.learn(1.0, np.array([5]), np.ones(1))
    assert np.isinf(first.remaining_s[0, 5])
    assert np.isfinite(goal_memory.recall(goal).remaining_s[0, 5])


# Equations (2) to (5) as printed


def test_published_links_equal_dense_equations() -> None:
    rng = np.random.default_rng(0)
    n_x, n_y = 6, 5
    n = n_x * n_y
    goal_memory = memory(n_x, n_y, 'iteration')
    mu = np.full((n, n), 1000.0)
    before = None
    for _ in range(8):
        elapsed_s = float(rng.uniform(0.1, 0.3))
        g = rng.random(n) ** 6
        goal_memory.learn(elapsed_s, np.arange(n), g)
        for i, j in itertools.product(range(n), repeat=2):
            if before is None or i == j or before[i] <= 2e-5 or g[j] <= 2e-5:
                continue
            dx, dy = abs(i % n_x - j % n_x), abs(i // n_x - j // n_x)
            tau = 1.0 * elapsed_s
            chi = 0.25 * (max(before.max(), g.max()) ** 2 / (before[i] * g[j]) - 1.0)
            delta = 0.1 * math.hypot(min(dx, n_x - dx), min(dy, n_y - dy))
            mu[i, j] = mu[j, i] = (mu[i, j] + tau + chi + delta) / 2.0
        before = g
    state = goal_memory.state()
    found = np.full((n, n), 1000.0)
    i, j = state['cells'][state['ends']].T
    found[i, j] = found[j, i] = state['mu_s']
    np.testing.assert_allclose(found, mu, rtol=1e-12)


def test_published_iterations_last_a_tenth_of_a_second() -> None:
    drive = Drive(update='iteration')
    counts = []
    for _ in range(12):
        drive.move(0.025, 0.01, 0.0)
        counts.append(drive.memory.state()['present']['observations'])
    assert counts == [0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2]  # the first iteration has no last one
    drive.move(0.3, 0.0, 0.0)  # a rate that varies; at rest, time passes as well
    assert drive.memory.state()['present']['observations'] == 3


def test_published_turns_on_the_spot_are_iterations() -> None:
    drive = Drive(update='iteration')
    drive.ahead(2.0)
    before = drive.memory.state()
    drive.turn(360.0)
    after = drive.memory.state()
    assert after['present']['observations'] == before['present']['observations'] + 10
    count = len(before['mu_s'])
    assert np.count_nonzero(after['mu_s'][:count] != before['mu_s']) > 500


def test_published_times_grow_with_duration_of_drive() -> None:
    times_s = []
    for speed_mps in (0.5, 0.05):
        drive = Drive(update='iteration')
        start = drive.peak
        drive.ahead(8.0, speed_mps)
        times = drive.memory.recall(start)
        times_s.append(drive.memory.remaining_s(times, drive.peak))
        assert drive.memory.bearing(times, drive.peak) == pytest.approx(math.pi)
    assert times_s[0] == pytest.approx(870.0, abs=1.0)
    assert times_s[1] / times_s[0] == pytest.approx(11.4, abs=0.1)


def test_published_direction_is_that_of_fastest_decrease() -> None:
    """Of the cells that surround the packet, two to eight cells away: here 8 s in 4 cells."""
    goal_memory = memory(60, 50, 'iteration')
    peak, goal = Place(30.0, 25.0, 9.0), Place(50.0, 25.0, 0.0)
    times = TemporalArray(goal, np.full((50, 60), np.inf), np.ones((50, 60), np.int64))
    times.remaining_s[25, 30] = 20.0
    times.remaining_s[25, 31] = 10.0  # of the packet itself: too near
    times.remaining_s[25, 32] = 17.0  # 1.5 s per cell
    times.remaining_s[21, 30] = 12.0  # 2 s per cell
    times.remaining_s[25, 21] = 0.0  # too far away
    assert goal_memory.direction(times, peak) == pytest.approx(-0.5 * math.pi)
    assert abs(goal_memory.bearing(times, peak)) == pytest.approx(math.pi)  # it heads along +y
    times.remaining_s[21, 30] = times.remaining_s[25, 32] = 20.0
    assert goal_memory.direction(times, peak) is None  # the plateau of section V.D
    assert goal_memory.direction(times, Place(49.5, 25.8, 0.0)) is None  # within one cell: V.C


@pytest.mark.parametrize('update', ['cell', 'iteration'])
def test_robot_reaches_goals_by_bearing_alone(update: str) -> None:
    """Two goals, of which the second one is set on the way to the first one."""
    drive = Drive(update=update)
    start = drive.peak
    drive.ahead(4.0)
    corner = drive.peak
    drive.turn(90.0)
    drive.ahead(3.0)
    drive.towards(start, 60)
    drive.towards(corner, 400)
    assert drive.memory.reached(corner, drive.peak)


def test_goal_memory_update_selects_published_equations() -> None:
    published, ours = (
        RatSLAM(config().with_values({
            'goal_memory.goal_memory': True, 'goal_memory.goal_memory_update': update,
        }), head='pose_cells') for update in ('iteration', 'cell')
    )
    for slam in (published, ours):
        for n in range(6):
            slam.odometry(Odometry((n + 1) * 10**8, Twist(0.5, 0.0)))
        slam.template(6 * 10**8, ViewMatch(0, True, 0.0, 0.0))
        slam.finish()
    assert published.goal_memory is not None
    assert ours.goal_memory is not None
    assert len(published.goal_memory) > 1000 > len(ours.goal_memory)


# Learning


@pytest.mark.parametrize(('speed', 'turn'), [(0.47, 0.9), (1.0, -2.0)])
def test_projection_equals_dense_activity_summed_over_headings(speed: float, turn: float) -> None:
    drive = Drive(12, 8)
    for _ in range(60):  # across the edges of the torus
        drive.move(DT_S, speed * DT_S, turn * DT_S)
    cells, activity = drive.cells.projected()
    plane = np.zeros(12 * 8)
    plane[cells] = activity
    assert np.all(np.diff(cells) > 0)
    assert np.all(activity > 0.0)
    dense = drive.cells.activity().sum(axis=0)
    np.testing.assert_allclose(plane.reshape(8, 12), dense, atol=1e-12)


def test_resting_and_turning_learn_nothing_and_take_no_time() -> None:
    drive, steady = Drive(), Drive()
    for robot in (drive, steady):
        for part in range(6):
            robot.ahead(0.8)
            if robot is drive and part % 2:
                links = len(robot.memory)
                for _ in range(200):
                    robot.move(DT_S, 0.0, 0.0)
                robot.turn(360.0)
                assert len(robot.memory) == links
    start = Place(30.0, 25.0, 0.0)
    rested, driven = (
        robot.memory.remaining_s(robot.memory.recall(start), robot.peak)
        for robot in (drive, steady)
    )
    assert rested == pytest.approx(driven, rel=0.1)


def test_relocation_creates_no_link() -> None:
    drive = Drive()
    drive.ahead(1.0)
    drive.memory.relocated()
    links = len(drive.memory)
    drive.memory.learn(1.0, np.array([40 * 60]), np.ones(1))
    assert len(drive.memory) == links


def test_localisation_only_learns_nothing() -> None:
    drive = Drive()
    drive.ahead(1.0)
    before = drive.memory.state()
    drive.cells.mapping = False
    drive.ahead(2.0)
    assert np.array_equal(drive.memory.state()['mu_s'], before['mu_s'])
    drive.cells.mapping = True
    drive.ahead(2.0)
    times = drive.memory.recall(drive.peak)
    assert math.isinf(drive.memory.remaining_s(times, Place(30.0, 25.0, 0.0)))  # not connected


# Small worlds


def l_shaped() -> tuple[Drive, Place]:
    drive = Drive()
    start = drive.peak
    drive.ahead(4.0)
    drive.turn(90.0)
    drive.ahead(3.0)
    return drive, start


def ring(slow_mps: float) -> tuple[Drive, Place]:
    """Drive around a square, the second half, after the far corner, at another speed."""
    drive = Drive()
    start = drive.peak
    for side in range(4):
        drive.ahead(4.0, 0.5 if side < 2 else slow_mps)
        drive.turn(90.0)
    return drive, start


def crossed() -> tuple[Drive, Place]:
    drive, start = l_shaped()
    drive.turn(90.0)
    drive.ahead(2.0, 0.2)
    drive.turn(90.0)
    drive.ahead(4.5)
    return drive, start


@pytest.mark.parametrize('world', [crossed, lambda: ring(0.2)], ids=['crossed', 'ring'])
def test_times_decrease_to_goal_from_every_cell(world: Callable[[], tuple[Drive, Place]]) -> None:
    drive, start = world()
    times = drive.memory.recall(start)
    reachable = np.flatnonzero(np.isfinite(times.remaining_s)).tolist()
    assert len(reachable) > 50
    for cell in reachable:
        for _ in range(len(reachable)):
            following = int(times.onward.flat[cell])
            if following < 0:
                break
            assert times.remaining_s.flat[following] < times.remaining_s.flat[cell]
            cell = following
        y, x = divmod(cell, times.remaining_s.shape[1])
        assert drive.memory.reached(start, Place(x, y, 0.0))


def test_route_ahead_is_in_robot_frame_in_metres() -> None:
    drive, start = l_shaped()
    times = drive.memory.recall(start)
    whole = drive.memory.route_ahead(times, drive.peak)  # back, then to its right
    assert whole[0].tolist() == [0.0, 0.0]
    assert whole[-1] == pytest.approx([-3.0, 4.0], abs=0.3)
    steps = np.hypot(*np.diff(whole, axis=0).T)
    assert 6.0 < steps.sum() < 7.6
    assert steps.max() < 1.6
    corner = np.hypot(whole[:, 0] + 3.0, whole[:, 1]).min()
    assert corner < 0.9
    short = drive.memory.route_ahead(times, drive.peak, 2.0)
    assert 2.0 <= np.hypot(*np.diff(short, axis=0).T).sum() < 3.6
    np.testing.assert_array_equal(short, whole[: len(short)])


def test_route_across_torus_edge_is_unwrapped() -> None:
    drive = Drive(40, 20)
    start = drive.peak
    drive.ahead(7.0)  # 28 cells of 40, across the edge
    assert drive.peak.x > start.x
    times = drive.memory.recall(start)
    straight = drive.memory.route_ahead(times, drive.peak)
    assert straight[-1] == pytest.approx([-7.0, 0.0], abs=0.4)
    assert np.all(np.diff(straight[:, 0]) < 0.0)


@pytest.mark.parametrize(('slow_mps', 'sign'), [(0.1, -1), (2.0, 1)])
def test_faster_route_is_preferred_over_shorter_one(slow_mps: float, sign: int) -> None:
    """Beyond the far corner, continuing on the second half is the shorter route."""
    drive, start = ring(slow_mps)
    times = drive.memory.recall(start)
    at = Place(start.x - 12.0, start.y - 16.0, 0.0)
    direction = drive.memory.direction(times, at)
    assert direction is not None
    assert sign * math.cos(direction) > 0.8


@pytest.mark.parametrize(('step_cells', 'expected'), [(0.0, 1.32), (1.0, 5.45)])
def test_length_of_step_determines_effect_of_speed(
    monkeypatch: pytest.MonkeyPatch, step_cells: float, expected: float
) -> None:
    """Over 8 m at a tenth of the speed; a step of 0 is an iteration of 0.1 s."""
    monkeypatch.setattr('ratslam_ros.core.goal_memory.goal_routes.STEP_CELLS', step_cells)
    times_s = []
    for speed_mps in (0.5, 0.05):
        drive = Drive()
        start = drive.peak
        drive.ahead(8.0, speed_mps)
        times_s.append(drive.memory.remaining_s(drive.memory.recall(start), drive.peak))
    assert times_s[1] / times_s[0] == pytest.approx(expected, abs=0.01)


def test_route_bridges_packet_jump() -> None:
    """One place has two sets of cells: the packet jumped, and the route continues beyond."""
    goal_memory = memory(60, 50)
    for x in range(5, 16):
        goal_memory.learn(1.0, np.array([10 * 60 + x]), np.ones(1))
    # A second packet, equally strong and then alone, far away, where the route continues.
    goal_memory.learn(0.1, np.array([10 * 60 + 15, 30 * 60 + 40]), np.ones(2))
    for x in range(41, 50):
        goal_memory.learn(1.0, np.array([30 * 60 + x]), np.ones(1))
    times = goal_memory.recall(Place(49.0, 30.0, 0.0))
    route = goal_memory.path(times, Place(5.0, 10.0, 0.0))
    assert route[0].tolist() == [0.0, 0.0]
    assert route[-1] == pytest.approx([19.0, 0.0], abs=1.01)
    assert np.hypot(*np.diff(route, axis=0).T).max() < 3.0


def test_blocked_route_loses_to_alternative_after_several_attempts() -> None:
    drive, start = ring(0.5)
    at = Place(start.x - 12.0, start.y - 16.0, 0.0)  # heading +x: along the second half
    free = drive.memory.recall(start)
    free_s = drive.memory.remaining_s(free, at)
    bearing = drive.memory.bearing(free, at)
    assert bearing == pytest.approx(0.0, abs=0.3)
    links = drive.memory.blocked(at, 0.0, 0.0)
    assert 10 < links < 150
    np.testing.assert_array_equal(drive.memory.recall(start).remaining_s, free.remaining_s)
    attempts = 0
    while abs(bearing) < 2.5:  # until the first half, behind the robot, is preferred
        assert drive.memory.blocked(at, 0.0, 4.0) == links
        bearing = drive.memory.bearing(drive.memory.recall(start), at)
        assert bearing is not None
        attempts += 1
        assert attempts < 10
    times = drive.memory.recall(start)
    assert drive.memory.remaining_s(times, at) > free_s + 1.0
    far = Place(start.x, start.y - 12.0, 0.0)  # beyond the obstacle the times are unchanged
    assert drive.memory.remaining_s(times, far) == drive.memory.remaining_s(free, far)
    drive.ahead(4.0)
    drive.turn(90.0)
    drive.ahead(4.0)
    drive.turn(90.0)
    drive.ahead(4.0)  # through the blocked place, from the west
    assert drive.memory.remaining_s(drive.memory.recall(start), at) < free_s + 4.0


def test_jump_links_are_never_blocked() -> None:
    goal_memory = memory(60, 50)
    for cell in (10 * 60 + 10, 10 * 60 + 40):
        goal_memory.learn(1.0, np.array([cell]), np.ones(1))
    assert goal_memory.blocked(Place(25.0, 10.0, 0.0), 0.0, 5.0) == 0


# Goals


def test_goals_are_marked_and_reached_within_a_cell() -> None:
    goal_memory = memory(60, 50)
    goal_memory.mark('door', Place(59.6, 3.0, 7.0))
    assert goal_memory.goal('door') == Place(59.6, 3.0, 7.0)
    assert goal_memory.reached(goal_memory.goal('door'), Place(0.5, 3.1, 30.0))
    assert not goal_memory.reached(goal_memory.goal('door'), Place(0.7, 3.0, 7.0))
    assert goal_memory.reached(Place(59.6, 3.0, 7.0), Place(0.0, 3.1, 7.0), 0.5)
    assert not goal_memory.reached(Place(59.6, 3.0, 7.0), Place(0.5, 3.1, 30.0), 0.5)
    with pytest.raises(UnreachableGoal, match="'kitchen'; known: door"):
        goal_memory.goal('kitchen')


def test_direction_at_goal_is_none() -> None:
    drive, start = l_shaped()
    times = drive.memory.recall(start)
    assert drive.memory.direction(times, start) is None
    assert drive.memory.remaining_s(times, start) < 1.0


def test_direction_beside_goal_leads_to_it() -> None:
    drive, start = l_shaped()
    times = drive.memory.recall(start)
    beside = Place(start.x, start.y - 3.0, 0.0)  # the goal is the nearest connected cell
    times.remaining_s[:] = np.where(times.onward < 0, times.remaining_s, np.inf)
    assert drive.memory.direction(times, beside) == pytest.approx(0.5 * math.pi)
    assert drive.memory.path(times, beside).tolist() == [[0.0, 0.0], [0.0, 3.0]]


def test_unlinked_places_raise_or_have_no_route() -> None:
    drive, _ = l_shaped()
    with pytest.raises(UnreachableGoal, match='drive there first'):
        drive.memory.recall(Place(50.0, 10.0, 0.0))
    times = drive.memory.recall(drive.peak)
    lost = Place(50.0, 10.0, 0.0)
    assert math.isinf(drive.memory.remaining_s(times, lost))
    assert drive.memory.direction(times, lost) is None
    assert drive.memory.path(times, lost).shape == (0, 2)
    assert drive.memory.route_ahead(times, lost).shape == (0, 2)


# Memory


def test_restored_goal_memory_continues_identically() -> None:
    drive, start = l_shaped()
    drive.memory.mark('start', start)
    restored = memory(60, 50)
    restored.restore(drive.memory.state())
    assert restored.goals == {'start': start}
    np.testing.assert_array_equal(
        restored.recall(start).remaining_s, drive.memory.recall(start).remaining_s
    )
    for goal_memory in (restored, drive.memory):  # both continue to learn identically
        goal_memory.relocated()
        for cell in (25 * 60 + 30, 25 * 60 + 31, 25 * 60 + 32):
            goal_memory.learn(0.5, np.array([cell]), np.ones(1))
    for name, value in restored.state().items():
        assert np.array_equal(value, drive.memory.state()[name]), name


def test_memory_of_other_extents_is_rejected() -> None:
    drive, _ = l_shaped()
    other = memory(50, 50)
    with pytest.raises(UnusableInput, match=r'\[60, 50\].*pc_dim_x'):
        other.restore(drive.memory.state())
    assert len(other) == 0


def test_goal_memory_in_ratslam_does_not_change_the_map() -> None:
    actions = []
    for switched_on in (False, True):
        c = config().with_values({'goal_memory.goal_memory': switched_on})
        slam = RatSLAM(c, 'pose_cells')
        steps = []
        for n in range(200):
            steps += slam.odometry(Odometry(n * 10**8, Twist(0.5, 0.2), Pose(0.0, 0.0, 0.0)))
            if n % 5 == 0:
                steps += slam.template(n * 10**8 + 1, ViewMatch(n // 5, True, 0.0, 0.0))
        actions.append(steps)
        assert (slam.goal_memory is not None) == switched_on
    assert slam.goal_memory is not None
    assert len(slam.goal_memory) > 100
    assert actions[0] == actions[1]
