# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Links to recognised places: weights, false recognitions, and what the map requires of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from graphs import new_map, place_of
from helpers import ahead, restored, turning

from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping import experience_map
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.link_weights import KERNEL_STDS, geman_mcclure, reach_m
from ratslam_ros.core.mapping.odometry_noise import PRIOR_STD
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, Action, MapAction

PER_LAP = 40
SPACING_M = 1.0
TRUE_RADIUS_M = PER_LAP * SPACING_M / (2.0 * math.pi)


def act(
    graph: ExperienceMap, kind: Action, recognised: int = NO_EXPERIENCE, agreement: float = 1.0
) -> None:
    source = graph.current_id
    target = len(graph) if kind == 'create' else source
    graph.apply(MapAction(
        kind, source, target, 10 + target, 0.0, place_of(max(target, 0)), None,
        recognised, agreement, SPACING_M,
    ))


def drive_laps(
    graph: ExperienceMap, laps: int, gain: float = 1.05, false: int = 0, first: int = 0
) -> None:
    """Drive laps on a circle with odometry that turns too far, and create experiences.

    After the first lap each view is recognised as that of the first lap; every ``false``-th as
    one half a lap away.
    """
    for n in range(first, laps * PER_LAP):
        if n > 0:
            half = turning(0.5 * gain * 2.0 * math.pi / PER_LAP)
            for motion in (half, ahead(SPACING_M), half):
                graph.integrate(motion)
        known = n % PER_LAP if n >= PER_LAP else NO_EXPERIENCE
        if false and known != NO_EXPERIENCE and n % false == 0:
            known = (known + PER_LAP // 2) % PER_LAP
        act(graph, 'create', known)


def spread_m(graph: ExperienceMap) -> float:
    """Return the median distance between the experiences of one place."""
    laps = graph.poses[:, :2].reshape(-1, PER_LAP, 2)
    return float(np.median(np.linalg.norm(laps[1:] - laps[0], axis=2)))


def settle(graph: ExperienceMap) -> None:
    for _ in range(20):
        graph.settle()


@pytest.mark.parametrize('gain', [1.05, 1.1])
def test_false_recognitions_are_deleted(gain: float) -> None:
    true, mixed = new_map(), new_map()
    drive_laps(true, 3, gain)
    drive_laps(mixed, 3, gain, false=5)
    for graph in (true, mixed):
        settle(graph)
    assert spread_m(true) < 0.15 * SPACING_M
    assert np.ptp(true.poses[:, 0]) == pytest.approx(2.0 * TRUE_RADIUS_M, rel=0.15)
    assert spread_m(mixed) < spread_m(true) + 0.1 * SPACING_M
    recognitions = [k for k in mixed.links() if k.recognised]
    assert len(recognitions) == 2 * PER_LAP * 4 // 5
    assert all((k.source_id - k.target_id) % PER_LAP == 0 for k in recognitions)
    shares = mixed.state()['shares']
    assert min(shares) > 0.5


def act_known(graph: ExperienceMap, target: int) -> None:
    graph.apply(MapAction(
        'link', graph.current_id, target, 10 + target, 0.0, place_of(target),
        view_spacing_m=SPACING_M,
    ))


def visit(graph: ExperienceMap, target: int) -> None:
    if target == len(graph):
        act(graph, 'create')
    else:
        act_known(graph, target)


def test_inexact_recognitions_hardly_shrink_the_map(monkeypatch: pytest.MonkeyPatch) -> None:
    """Least squares shrinks links between places that are recognised within their distance."""
    step_m, places = 0.25, 2 * PER_LAP
    half = turning(math.pi * step_m / PER_LAP)

    def radius_m(spacings: float) -> float:
        monkeypatch.setattr(experience_map, 'DEPARTURE_SPACINGS', spacings)
        rng, graph = np.random.default_rng(1), new_map()
        for n in range(5 * 2 * places):  # five laps; on the first, every other step adds a place
            for motion in (half, ahead(step_m), half) if n else ():
                graph.integrate(motion)
            seen = round(n / 2 + rng.normal(0.0, 0.6)) % places
            if n >= 2 * places and rng.random() < 0.7:
                if seen != graph.current_id:
                    act_known(graph, seen)
            elif n >= 2 * places or n % 2 == 0:
                act(graph, 'create')
        settle(graph)
        circle_m = graph.poses[:places, :2]
        return float(np.linalg.norm(circle_m - circle_m.mean(axis=0), axis=1).mean())

    used = experience_map.DEPARTURE_SPACINGS
    assert radius_m(0.0) < 0.94 * TRUE_RADIUS_M < 0.95 * TRUE_RADIUS_M < radius_m(used)


@pytest.mark.parametrize('interrupted', [False, True])
def test_new_place_is_linked_past_the_known_ones(interrupted: bool) -> None:
    graph = new_map()
    for target in (0, 1, 2, 1, 0, 3):
        visit(graph, target)
        graph.integrate(ahead(SPACING_M))
        if interrupted:
            graph = restored(graph, graph.parameters)
    past, start = graph.links()[-1], graph.links()[-2]
    assert (past.source_id, past.target_id, past.recognised) == (2, 3, False)
    assert past.distance_m == pytest.approx(3.0 * SPACING_M)
    assert past.duration_s == pytest.approx(3.0 * start.duration_s)
    assert (start.source_id, start.target_id, start.recognised) == (0, 3, True)


def test_return_to_the_departure_makes_one_driven_link() -> None:
    graph = new_map()
    for target in (0, 1, 0, 1, 2):
        visit(graph, target)
        graph.integrate(ahead(SPACING_M))
    link = graph.links()[-1]
    assert (link.source_id, link.target_id, link.recognised, link.count) == (1, 2, False, 1)


def test_a_long_known_path_is_not_bypassed() -> None:
    graph = new_map()
    for target in (0, 1, 0, 1, 0, 1, 0, 2):
        visit(graph, target)
        graph.integrate(ahead(SPACING_M))
    link = graph.links()[-1]
    assert (link.source_id, link.target_id, link.recognised) == (0, 2, False)


def test_view_seen_between_two_experiences_keeps_its_offset() -> None:
    graph = new_map()
    act(graph, 'create')
    graph.integrate(ahead(3.0))
    act(graph, 'create')
    graph.integrate(ahead(-2.5))
    act(graph, 'none', 0)
    link = graph.links()[-1]
    assert (link.source_id, link.target_id, link.recognised) == (1, 0, True)
    assert link.distance_m == pytest.approx(2.5)
    assert abs(link.heading_rad) == pytest.approx(math.pi)
    assert link.facing_rad == pytest.approx(0.0)
    act(graph, 'none', 0)
    assert graph.link_count == 2  # a second recognition from the same experience adds nothing


def test_distant_place_requires_more_agreement() -> None:
    graph = new_map()
    act(graph, 'create')
    graph.integrate(ahead(60.0))
    act(graph, 'create')
    act(graph, 'none', 0, agreement=0.5)
    assert graph.link_count == 1
    act(graph, 'none', 0, agreement=1.0)
    assert graph.link_count == 2


def test_reach_grows_with_drift_and_agreement() -> None:
    assert reach_m(0.0, 0.0, SPACING_M) == 2.0 * SPACING_M
    assert reach_m(0.0, 0.5, SPACING_M) == 5.0 * SPACING_M
    assert reach_m(100.0, 0.5, SPACING_M) == 15.0
    assert reach_m(0.0, 1.0, SPACING_M) == math.inf


def test_kernel_is_a_quarter_at_its_width_and_falls() -> None:
    assert geman_mcclure(0.0) == 1.0
    assert geman_mcclure(KERNEL_STDS**2) == pytest.approx(0.25)
    falling = [geman_mcclure(0.5 * n) for n in range(100)]
    assert falling == sorted(falling, reverse=True)


@pytest.mark.parametrize('scale', [0.1, 30.0])
def test_scaled_world_gives_the_same_map(scale: float) -> None:
    """Weights have no unit of length but the view spacing."""
    graphs = []
    for factor in (1.0, scale):
        graph = new_map()
        for n in range(12):
            graph.integrate(turning(0.5))
            graph.integrate(ahead(0.8 * factor))
            graph.apply(MapAction(
                'create', n - 1, n, n, 0.0, place_of(n), None,
                n % 4 if n > 5 else NO_EXPERIENCE, 1.0, factor,
            ))
        graphs.append(graph.poses)
    assert graphs[1][:, :2] == pytest.approx(scale * graphs[0][:, :2], abs=1e-9 * scale)
    assert graphs[1][:, 2] == pytest.approx(graphs[0][:, 2])


def test_resumed_map_continues_identically() -> None:
    graph = new_map()
    drive_laps(graph, 2, false=7)
    resumed = restored(graph, ExperienceMapParameters(exp_initial_em_deg=0.0))
    for one in (graph, resumed):
        drive_laps(one, 3, false=7, first=2 * PER_LAP)
        settle(one)
    assert graph.poses.tobytes() == resumed.poses.tobytes()


def test_deleted_links_keep_the_weights_of_the_others() -> None:
    graph = new_map()
    drive_laps(graph, 2, false=7)
    settle(graph)
    before = {(k.source_id, k.target_id): k.recognised for k in graph.links()}
    pruned = 50
    act_on = MapAction('create', graph.current_id, pruned, 99, 0.0, place_of(99))
    graph.integrate(ahead(1.0))
    graph.apply(act_on)
    after = {
        (k.source_id, k.target_id): k.recognised for k in graph.links()
        if pruned not in (k.source_id, k.target_id)
    }
    assert all(before[ends] == kind for ends, kind in after.items() if ends in before)


def test_map_without_recognitions_saves_nothing_new() -> None:
    graph = new_map()
    graph.integrate(ahead(1.0))
    graph.apply(MapAction('create', -1, 0, 0, 0.0, place_of(0)))
    assert not {'recognised', 'shares', 'view_spacing_m', 'recognised_at_m'} & set(graph.state())


def test_recognition_in_another_component_makes_no_link() -> None:
    graph = new_map()
    act(graph, 'create')
    graph._separate()
    act(graph, 'create')
    act(graph, 'none', 0)
    assert graph.link_count == 0


def drive_known_laps(graph: ExperienceMap, laps: int, weighted: bool, false: int = 0) -> None:
    """Drive laps on a circle by odometry that turns too far, back to the places of the first lap.

    Every ``false``-th place is taken for the one half a lap away.
    """
    for n in range(laps * PER_LAP):
        if n > 0:
            half = turning(0.5 * 1.05 * 2.0 * math.pi / PER_LAP)
            for motion in (half, ahead(SPACING_M), half):
                graph.integrate(motion)
        target = n if n < PER_LAP else n % PER_LAP
        if false and n > PER_LAP and n % false == 0:
            target = (target + PER_LAP // 2) % PER_LAP
        graph.apply(MapAction(
            'create' if n < PER_LAP else 'link', graph.current_id, target, 10 + target, 0.0,
            place_of(target), view_spacing_m=SPACING_M if weighted else 0.0,
        ))


def bend_m(graph: ExperienceMap) -> float:
    """Return the standard deviation of the distances of the experiences from their centre."""
    settle(graph)
    away = graph.poses[:, :2] - graph.poses[:, :2].mean(axis=0)
    return float(np.std(np.linalg.norm(away, axis=1)))


def test_weighted_links_resist_transitions_to_false_places() -> None:
    mixed, equal = new_map(), new_map()
    drive_known_laps(mixed, 3, weighted=True, false=13)
    drive_known_laps(equal, 3, weighted=False, false=13)
    assert bend_m(mixed) < 0.5 * bend_m(equal)


def test_returns_to_known_places_measure_the_odometry() -> None:
    weighted, equal = new_map(), new_map()
    drive_known_laps(weighted, 5, weighted=True)
    drive_known_laps(equal, 5, weighted=False)
    assert equal.optimiser.noise.std == PRIOR_STD
    assert weighted.optimiser.noise.std < 0.5 * PRIOR_STD


@pytest.mark.parametrize('gated', [False, True])
def test_gate_rejects_recognitions_beyond_the_drift(gated: bool) -> None:
    """A carried robot recognises places that its odometry contradicts."""
    graph = new_map(exp_gate_closures=gated)
    for _ in range(30):
        act(graph, 'create')
        graph.integrate(ahead(SPACING_M))
    act(graph, 'create', recognised=0)
    assert (graph.link_table.row(30, 0) is None) == gated
    graph.integrate(ahead(SPACING_M))
    act(graph, 'create', recognised=30)
    assert graph.link_table.row(31, 30) is not None
