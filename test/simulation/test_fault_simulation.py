# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All nodes under faults from seeds: the short form of tools/simulate_faults.py."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest
from contract import IS_STAND_IN, UNAVAILABLE

from ratslam_ros.core.warm_up import warm_up

if not IS_STAND_IN:
    reason = UNAVAILABLE or 'rclpy of ROS has a bus and a clock of its own'
    pytest.skip(reason, allow_module_level=True)

from virtual_bus import BusFaults
from virtual_robot import simulate
from virtual_time import MS, Hang, Process, S, Scheduler, VirtualCondition, VirtualTime
from virtual_world import DRIVE_S, MAPPING, ROBOTS, SETTINGS, Plan, replayed

SEEDS = 2, 3, 8
"""Three kinds of robots, with and without kills, lost messages and a full disk."""

UNDISTURBED = Plan(BusFaults(), (), None, True, True, 0.0, 0.0, 0, False, 'closed')


@pytest.fixture(scope='module', autouse=True)
def warm() -> Iterator[None]:
    """Compile in the time of the machine."""
    warm_up()
    warm_up('landmark_map', 'goal_follower')
    yield


@pytest.mark.parametrize('robot, names', [
    ('wheels', MAPPING), ('camera', ROBOTS['camera']), ('laser', ('landmark_map',)),
    ('camera, one process', ('camera_process',)),
])
def test_killed_processes_resume_exactly(robot: str, names: tuple[str, ...]) -> None:
    """One after another is killed. It has a log, its neighbours and the source have histories."""
    kills = tuple(((5 * n + 5) * S, (name,), S) for n, name in enumerate(names))
    outcome = simulate(1, plan=replace(UNDISTURBED, robot=robot, kills=kills))
    assert (outcome.kind, outcome.kills) == ('identical', len(names)), outcome


def test_nodes_wait_for_the_slowest_of_them_after_a_restart_of_all() -> None:
    """The source goes on meanwhile, so that odometry arrives long before the templates."""
    kills = tuple((DRIVE_S * S * part // 3, ROBOTS['wheels'], S) for part in (1, 2))
    plan = replace(UNDISTURBED, bus=BusFaults(discovery_ns=400 * MS), kills=kills, lockstep=False)
    assert simulate(2, plan=plan).kind == 'identical'


def test_lost_images_are_reported() -> None:
    """The check is able to fail: without a source that sends again, the map differs."""
    plan = replace(UNDISTURBED, kills=((DRIVE_S * S // 2, ('local_view',), S),), resends=False)
    outcome = simulate(2, plan=plan)
    assert not outcome.identical
    assert 'lost span' in outcome.losses, outcome


def test_lost_images_without_a_next_one_are_reported() -> None:
    """The node is killed at the end of the drive."""
    plan = replace(
        UNDISTURBED, kills=(((DRIVE_S - 1) * S, ('camera_head',), S),), resends=False,
        lockstep=False, robot='camera',
    )
    outcome = simulate(5, plan=plan)
    assert not outcome.identical
    assert 'lost span' in outcome.losses, outcome


def test_messages_are_reported_that_only_their_source_knew() -> None:
    """All nodes are killed after the first image, before anything is in the file."""
    plan = replace(
        UNDISTURBED, bus=BusFaults(delay_ns=20 * MS, discovery_ns=20 * MS), duplicates=0.05,
        jitter_ns=40 * MS, kills=((115 * MS, ROBOTS['wheels'], 100 * MS),), resends=False,
    )
    outcome = simulate(4693, plan=plan)
    assert not outcome.identical
    assert outcome.losses == ('lost span',), outcome


def test_nodes_killed_at_once_go_on_saving(monkeypatch: pytest.MonkeyPatch) -> None:
    """local_view gets older odometry again than the others, which subscribe to it too."""
    for name in 'vt_match_threshold', 'vt_match_ratio':
        monkeypatch.setitem(SETTINGS, f'local_view.{name}', -1.0)
    replayed.cache_clear()
    plan = replace(UNDISTURBED, kills=((DRIVE_S * S // 2, MAPPING, S),), lockstep=False)
    try:
        outcome = simulate(7, plan=plan)
        assert outcome.kind == 'identical', outcome
    finally:
        replayed.cache_clear()


def test_source_keeps_what_it_sends_while_all_nodes_are_away() -> None:
    """They are away for longer than those are visible that were killed, 10 s."""
    kill = 3 * S, ('single_process',), 11 * S
    plan = replace(UNDISTURBED, robot='wheels, one process', kills=(kill,), lockstep=False)
    assert simulate(8, plan=plan).kind == 'identical'


def test_process_behind_saves_no_state_that_lacks_passed_items() -> None:
    """The first one saves it, and is killed before the restarted one has got them."""
    kills = (5 * S, ('pose_cells',), 3 * S), (8 * S, ('local_view',), 3 * S)
    plan = replace(UNDISTURBED, kills=kills, ends='killed')
    assert simulate(3, plan=plan).kind == 'identical'


def test_late_process_gets_all_after_others_were_killed_again() -> None:
    """All are killed; before the last one is up, the others have saved their states."""
    kills = (5 * S, MAPPING[:2], S), (5 * S, MAPPING[2:], 12 * S), (12 * S, MAPPING[:2], S)
    assert simulate(0, plan=replace(UNDISTURBED, kills=kills)).kind == 'identical'


def test_odometry_of_images_survives_all_its_receivers() -> None:
    kill = DRIVE_S * S // 2, ('pose_cells', 'experience_map'), S
    plan = replace(UNDISTURBED, kills=(kill,), resends=False, robot='camera')
    assert simulate(6, plan=plan).kind == 'identical'


def test_nodes_save_together_after_one_went_back() -> None:
    """pose_cells is killed while the disk is full, so that it has no log."""
    outcome = simulate(3514)
    assert outcome.problems == []
    assert 'lost span' in outcome.losses


def test_log_goes_on_in_the_pause_in_which_a_disk_was_full() -> None:
    """Nothing is received between the cut of the pause and the end of all processes."""
    plan = replace(
        UNDISTURBED, kills=((5 * S, ('pose_cells',), 3 * S), (9500 * MS, ROBOTS['camera'], S)),
        full=(6 * S, 9 * S), robot='camera',
    )
    outcome = simulate(0, plan=plan)
    assert (outcome.kind, outcome.losses) == ('identical', ()), outcome


def test_state_of_a_pause_is_not_taken_for_that_of_a_point_of_the_grid() -> None:
    """Messages come late: the first node pauses before a point that the others pass.

    The seed fails if a pause has the number of the next point. A new topic changes the random
    numbers of all seeds.
    """
    assert simulate(2141).kind == 'identical'


def test_faults_lose_nothing_unnoticed_and_are_repeated_by_the_seed() -> None:
    outcomes = [simulate(seed) for seed in SEEDS]
    assert [(one.seed, one.problems) for one in outcomes if one.problems] == []
    # What can be repaired is to be repaired, and not only reported.
    repairable = [one for one in outcomes if one.is_repairable]
    assert len(repairable) == 2
    assert [one for one in repairable if not one.identical] == []
    again = simulate(SEEDS[-1], trace=True)
    assert len(again.trace) > 500
    assert again.trace_hash == outcomes[-1].trace_hash
    assert len({one.trace_hash for one in outcomes}) == len(SEEDS)


def test_time_passes_only_while_all_threads_wait() -> None:
    scheduler = Scheduler(1)
    clock, condition, order = VirtualTime(scheduler), VirtualCondition(scheduler), []

    def wait() -> None:
        with condition:
            woken = condition.wait(5.0)
        order.append(('waiter', woken, round(clock.monotonic(), 3)))

    def notify() -> None:
        clock.sleep(2.0)
        with condition:
            condition.notify_all()
        order.append(('notifier', True, round(clock.monotonic(), 3)))

    process = Process('test')
    scheduler.start(process, 'wait', wait)
    scheduler.start(process, 'notify', notify)
    scheduler.sleep(10 * S)
    assert sorted(order) == [('notifier', True, 1002.0), ('waiter', True, 1002.0)]
    assert scheduler.failures == []


def test_killed_thread_ends_where_it_is() -> None:
    scheduler = Scheduler(1)
    steps: list[int] = []

    def run() -> None:
        try:
            for step in range(100):
                steps.append(step)
                scheduler.sleep(10 * MS)
        except Exception:
            steps.append(-1)

    process = Process('test')
    task = scheduler.start(process, 'run', run)
    scheduler.sleep(35 * MS)
    scheduler.kill(process)
    assert task.is_done
    assert steps == [0, 1, 2, 3]
    scheduler.sleep(S)
    assert steps == [0, 1, 2, 3]


def test_endless_thread_is_a_hang(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('virtual_time.MAX_SWITCHES', 1000)
    scheduler = Scheduler(1)

    def run() -> None:
        while True:
            scheduler.sleep(1)

    process = Process('test')
    scheduler.start(process, 'run', run)
    with pytest.raises(Hang):
        scheduler.sleep(S)
    scheduler.kill(process)
