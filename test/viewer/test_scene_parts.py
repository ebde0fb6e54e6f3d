# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import json
import struct

import numpy as np
import pytest
from synthetic_runs import DIMS, SyntheticRun

from ratslam_ros.core.mapping.map_changes import LinkRows
from ratslam_ros.history.records import StatusRecord
from ratslam_ros.viewer.scene import glb
from ratslam_ros.viewer.scene.cell_drawing import activity_levels, repeated
from ratslam_ros.viewer.scene.map_drawing import thinned_links
from ratslam_ros.viewer.scene.palette import LEVELS
from ratslam_ros.viewer.scene.robot_drawing import (
    ACCEPTED_NS,
    REJECTED_NS,
    ellipse,
    goal_of,
    recent_closures,
)
from ratslam_ros.viewer.scene.surroundings import Bounds, grid_step
from ratslam_ros.viewer.scene.trails import steps


def links(*ends: tuple[int, int]) -> LinkRows:
    n = len(ends)
    return LinkRows(
        np.array(ends), np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.zeros(n, np.int64),
        np.zeros(n, np.bool_), [''] * n,
    )


def test_unthinned_links_keep_all_but_deleted() -> None:
    ends, drawn = thinned_links(links((0, 1), (-1, -1), (2, 1)), 1)
    assert drawn.tolist() == [True, False, True]
    assert ends[drawn].tolist() == [[0, 1], [2, 1]]


def test_thinned_links_join_drawn_experiences_once() -> None:
    ends, drawn = thinned_links(links((0, 1), (3, 4), (4, 3), (7, 8), (9, 1)), 4)
    # 0-1 has become a point; 4-3 equals 3-4; the closure 9-1 remains.
    assert drawn.tolist() == [False, True, False, True, True]
    assert ends[drawn].tolist() == [[0, 4], [4, 8], [8, 0]]


def test_thinned_chain_stays_connected() -> None:
    n, every = 1000, 7
    ends, drawn = thinned_links(links(*((k, k + 1) for k in range(n))), every)
    assert ends[drawn].tolist() == [[k, k + every] for k in range(0, n - every + 1, every)]


def test_glb_holds_points_and_colours() -> None:
    points = np.arange(12, dtype=np.float32).reshape(2, 2, 3)
    data = glb.encoded(points, np.full((2, 2, 3), [[[255]], [[0]]], np.uint8))
    magic, version, total, text_length = struct.unpack_from('<4sIII', data)
    assert (magic, version, total) == (b'glTF', 2, len(data))
    head = json.loads(data[20 : 20 + text_length])
    assert head['meshes'][0]['primitives'][0]['mode'] == glb.LINES
    binary = data[28 + text_length :]
    assert head['buffers'][0]['byteLength'] == len(binary)
    values = np.frombuffer(binary, '<f4').reshape(2, 4, 3)
    np.testing.assert_array_equal(values[0], points.reshape(4, 3))
    assert (values[1, :2] > 1.0).all()
    np.testing.assert_allclose(values[1, 2:], 0.0, atol=0.01)


def test_glb_colours_survive_the_filmic_curve() -> None:
    wanted = np.array([[213, 94, 0], [120, 132, 150], [0, 138, 100], [30, 30, 30]], np.uint8)
    colour = glb._linear(wanted).astype(np.float64)
    v = colour / 0.6 @ glb.ACES_IN.T
    v = (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.432951) + 0.238081)
    shown = np.clip(v @ glb.ACES_OUT.T, 0.0, 1.0)
    srgb = np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055)
    # Pure orange is outside of what the curve can produce.
    np.testing.assert_allclose(255 * srgb, wanted, atol=45)
    np.testing.assert_allclose(255 * srgb[1:], wanted[1:], atol=30)
    np.testing.assert_allclose(255 * srgb[1], wanted[1], atol=2)


def test_cells_at_faces_repeat_beyond_opposite_faces() -> None:
    where, rows = repeated(np.array([[0, 10, 20], [12, 12, 12], [24, 24, 35]]), DIMS)
    assert where[rows == 0].tolist() == [[25.5, 10.5, 20.5]]
    assert not (rows == 1).any()
    assert len(where[rows == 2]) == 7  # a corner: three faces, three edges and the other corner
    assert [-0.5, -0.5, -0.5] in where[rows == 2].tolist()


def test_activity_levels_follow_the_logarithm() -> None:
    levels, sizes = activity_levels(np.array([1.0, 0.1, 0.01, 1e-9]))
    assert levels.tolist() == [LEVELS - 1, 21, 10, 0]
    assert sizes.tolist() == [0, 1, 2, 2]
    assert activity_levels(np.zeros(2))[1].tolist() == [2, 2]


def test_jumps_of_a_trail_are_not_drawn() -> None:
    points = np.array([[0.0, 0], [0.1, 0], [0.2, 0], [5.0, 0], [5.1, 0]])
    drawn = steps(points)
    np.testing.assert_allclose(drawn[:, 0, 0], [0.0, 0.1, 5.0])
    assert steps(points[:1]).shape == (0, 2, 3)


def test_trail_needs_lines_at_corners_only() -> None:
    leg = np.linspace(0.0, 10.0, 101)
    out = np.stack([1e4 + leg, 0.0 * leg], 1)
    up = np.stack([1e4 + 10.0 + 0.0 * leg, leg], 1)
    away = up + np.array([50.0, 0.0])  # after a jump
    drawn = steps(np.concatenate([out, up[1:], away]), 0.01)
    corners = np.array([[[0, 0], [10, 0]], [[10, 0], [10, 10]], [[60, 0], [60, 10]]])
    np.testing.assert_allclose(drawn[:, :, :2] - [1e4, 0.0], corners, atol=0.01)


def test_trail_stays_within_the_tolerance() -> None:
    angles = np.linspace(0.0, 6.0, 400)
    points = 5.0 * np.stack([np.cos(angles), np.sin(angles)], 1)
    drawn = steps(points, 0.01)[:, :, :2].astype(float)
    assert len(drawn) < 100
    a, along = drawn[:, 0], drawn[:, 1] - drawn[:, 0]
    share = np.einsum('pnk,nk->pn', points[:, None] - a, along) / (along**2).sum(1)
    off = points[:, None] - a - np.clip(share, 0, 1)[..., None] * along
    assert np.hypot(*off.T).min(axis=0).max() < 0.0101


def test_grid_steps_are_round() -> None:
    assert [grid_step(side) for side in (8.0, 60.0, 600.0, 13_000.0)] == [0.5, 5.0, 50.0, 1000.0]


def test_bounds_grow_rarely_and_include_everything() -> None:
    run, bounds = SyntheticRun(400), Bounds()
    state = run.state()
    bounds.include(state)
    for edge in state.map.poses.min(axis=0), state.map.poses.max(axis=0):
        assert (abs(edge[:2] - bounds.centre) <= bounds.side_m / 2).all()
    version = bounds.version
    bounds.include(state)
    assert bounds.version == version


def test_rejected_closure_shows_reason_for_seconds() -> None:
    run = SyntheticRun(100)
    state = run.state()
    view = run.reject('too far')
    state.apply(view)
    (event,) = recent_closures(state)
    assert event.reason == 'too far'
    assert event.a == pytest.approx(tuple(state.map.poses[99, :2]))
    assert event.b == pytest.approx(tuple(state.map.poses[50, :2]))
    state.stamp_ns = view.stamp_ns + REJECTED_NS + 1
    assert recent_closures(state) == []


def test_accepted_closure_is_emphasised_for_seconds() -> None:
    run = SyntheticRun(100)
    state = run.state()
    for record in run.close():
        state.apply(record)
    (event,) = recent_closures(state)
    assert event.reason == ''
    state.stamp_ns += ACCEPTED_NS + 1
    assert recent_closures(state) == []


def test_goal_is_read_from_the_status() -> None:
    run = SyntheticRun(50)
    run.state()
    status = run.goals()[2]
    x, y = run.poses[25, :2]
    assert goal_of(status) == (pytest.approx(x), pytest.approx(y), 'goal: kitchen, 18 s left')


@pytest.mark.parametrize('payload', ['', '[]', '{"goal": null}', '{"goal": {"x_m": "a"}}', '3'])
def test_unreadable_status_is_no_goal(payload) -> None:
    assert goal_of(StatusRecord(1, payload)) is None


@pytest.mark.parametrize('heading_rad', [0.0, 0.7])
def test_ellipse_has_the_covariance_along_the_axes_of_the_map(heading_rad: float) -> None:
    covariance = np.array([[0.25, -0.125], [-0.125, 0.5]])
    lines = ellipse((0.25, -0.125, 0.5), heading_rad)
    assert np.array_equal(lines[1:, 0], lines[:-1, 1])
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    on_map = lines[:, 0, :2] @ np.array([[c, s], [-s, c]])
    squared = np.einsum('ni,ij,nj->n', on_map, np.linalg.inv(covariance), on_map)
    assert np.allclose(squared, 5.991)
    assert np.allclose(on_map.mean(axis=0), 0.0, atol=1e-9)
