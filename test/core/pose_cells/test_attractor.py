# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Attractor network: conservation of activity, and equality with a dense reference."""

import math

import numpy as np
import pytest
from helpers import DenseNetwork, around, extended, peak_of
from hypothesis import given, settings
from hypothesis import strategies as st

from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.pose_cells.attractor import Network, kernel
from ratslam_ros.core.pose_cells.packet import Packet

SIZES = [1, 2, 3, 5, 8, 11, 21]


def parameters(theta: int, y: int, x: int, **more: float) -> PoseCellsParameters:
    return extended('pose_cells', pc_dim_th=theta, pc_dim_y=y, pc_dim_x=x, **more)


def network(p: PoseCellsParameters) -> Network:
    return Network(
        (p.pc_dim_th, p.pc_dim_y, p.pc_dim_x),
        kernel(p.pc_w_e_dim, p.pc_w_e_var),
        kernel(p.pc_w_i_dim, p.pc_w_i_var),
        p.pc_global_inhib,
    )


motions = st.lists(
    st.tuples(
        st.one_of(st.floats(-4.0, 4.0), st.sampled_from([0.0, 1.0, -1.0, 3.0, -25.5])),
        st.one_of(st.floats(-2.0, 2.0), st.sampled_from([0.0, 0.5, 1.0, 40.0])),
    ),
    min_size=1,
    max_size=15,
)


@settings(max_examples=60)
@given(
    st.sampled_from([1, 2, 3, 4, 5, 11, 36]), st.sampled_from(SIZES), st.sampled_from(SIZES),
    motions, st.sampled_from([(7, 5), (3, 3), (1, 5), (5, 9), (21, 13)]),
)
def test_sum_stays_one_on_any_torus(
    theta: int, y: int, x: int, steps: list[tuple[float, float]], widths: tuple[int, int]
) -> None:
    """OpenRatSLAM loses activity at the wrap and above one cell per step."""
    net = network(parameters(theta, y, x, pc_w_e_dim=widths[0], pc_w_i_dim=widths[1]))
    packets = net.start()
    for cells, planes in steps:
        packets = net.step(packets, cells, planes)
        activity = net.dense(packets)
        assert activity.shape == (theta, y, x)
        assert activity.min() > -1e-15  # rounding
        assert abs(activity.sum() - 1.0) <= 1e-12


@settings(max_examples=30)
@given(
    st.tuples(st.floats(0, 36), st.floats(0, 11), st.floats(0, 7)),
    st.floats(-3.5, 3.5), st.integers(0, 1000),
)
def test_sum_stays_one_with_several_packets(
    place: tuple[float, float, float], cells: float, seed: int
) -> None:
    net = network(parameters(36, 11, 7))
    rng = np.random.default_rng(seed)
    packets = net.inject(net.start(), *place, 0.7)
    for _ in range(10):
        packets = net.step(packets, cells, float(rng.normal()))
        assert abs(net.dense(packets).sum() - 1.0) <= 1e-12
        packets = net.inject(packets, *rng.uniform(0, [36, 11, 7]).tolist(), 0.2)
        assert abs(net.dense(packets).sum() - 1.2) <= 1e-12


@pytest.mark.parametrize('dims', [(1, 1, 1), (2, 1, 3), (3, 2, 1), (1, 5, 2)])
def test_activity_that_does_not_survive_competition_is_kept(
    dims: tuple[int, int, int],
) -> None:
    """On a torus this small the inhibition removes all activity."""
    net = network(parameters(*dims, pc_global_inhib=1.0))
    packets = net.start()
    before = net.dense(packets)
    assert np.array_equal(net.dense(net.step(packets, 0.0, 0.0)), before)
    assert net.dense(net.step(packets, 1.5, 0.5)).sum() == pytest.approx(1.0, abs=1e-12)


def test_initial_activity_is_in_middle_cell() -> None:
    activity = network(parameters(36, 20, 41)).dense(network(parameters(36, 20, 41)).start())
    assert activity[18, 10, 20] == activity.sum() == 1.0


def test_kernel_is_normalised_separable_gaussian() -> None:
    axis = kernel(7, 1.5)
    cube = axis[:, None, None] * axis[None, :, None] * axis[None, None, :]
    r2 = sum(np.meshgrid(*[(np.arange(7) - 3) ** 2] * 3))
    expected = np.exp(-r2 / (2 * 1.5**2))
    assert np.allclose(cube, expected / expected.sum(), atol=1e-15)
    assert cube.sum() == pytest.approx(1.0, abs=1e-14)


# Stationary robot: comparison with the dense reference, cell by cell


def compare_stationary(p: PoseCellsParameters, seed: int, steps: int = 60) -> None:
    """Run network and dense reference side by side with injections at random places."""
    net, dense = network(p), DenseNetwork(p)
    rng = np.random.default_rng(seed)
    packets = net.start()
    for step in range(steps):
        if step % 4 == 1:
            place = rng.uniform(0, dense.dims)
            if step % 8 == 1:
                place = np.floor(place)
            energy = float(rng.uniform(0.02, 0.6))
            packets = net.inject(packets, *place.tolist(), energy)
            dense.inject(*place.tolist(), energy)
        assert np.abs(net.dense(packets) - dense.activity).max() < 1e-9, step
        packets = net.step(packets, 0.0, 0.0)
        dense.step()
    assert np.abs(net.dense(packets) - dense.activity).max() < 1e-9


@pytest.mark.parametrize('widths', [(3, 9), (9, 3), (1, 7), (15, 15)])
def test_stationary_activity_with_other_kernels_equals_dense_network(
    widths: tuple[int, int],
) -> None:
    p = parameters(24, 18, 20, pc_w_e_dim=widths[0], pc_w_i_dim=widths[1], pc_w_e_var=1.3)
    compare_stationary(p, 3, 24)


@settings(max_examples=20)
@given(
    st.tuples(st.integers(1, 30), st.integers(1, 18), st.integers(1, 18)), st.integers(0, 999)
)
def test_stationary_activity_on_any_torus_equals_dense_network(
    dims: tuple[int, int, int], seed: int
) -> None:
    compare_stationary(parameters(*dims), seed, 18)


def winner_changes(wins: list[bool]) -> list[int]:
    return [i for i, (now, before) in enumerate(zip(wins, [False, *wins], strict=False))
            if now != before]


def competition(
    speed: float, energy: float, every: int, count: int, theta: float, steps: int = 40
) -> tuple[list[bool], list[bool]]:
    """Inject far from the packet; return for every step whether the peak is at the new place.

    The new place moves along its own heading, so that each injection coincides with the remains of
    earlier ones.

    Returns:
        Results of the network and of the dense reference.
    """
    p = parameters(36, 40, 40)
    net, dense = network(p), DenseNetwork(p)
    packets = net.start()
    for _ in range(10):
        packets = net.step(packets, speed, 0.0)
        dense.step(speed)
    place = np.array([theta, 5.3, 31.6])
    heading = theta * math.pi / 18
    displacement = speed * np.array([0.0, math.sin(heading), math.cos(heading)])
    ours, theirs = [], []
    for step in range(steps):
        if step % every == 0 and step // every < count:
            packets = net.inject(packets, *place.tolist(), energy)
            dense.inject(*place.tolist(), energy)
        packets = net.step(packets, speed, 0.0)
        dense.step(speed)
        place = place + displacement
        for peak, wins in ((net.peak(packets), ours), (dense.peak(), theirs)):
            d = around(np.array(peak) - place, np.array(dense.dims))
            wins.append(bool(np.abs(d).max() < 6.0))
    return ours, theirs


@pytest.mark.parametrize(
    ('energy', 'every', 'count', 'theta'),
    [(0.1, 1, 5, 9.4), (0.3, 3, 10, 0.0), (0.3, 1, 5, 9.4), (1.2, 1, 1, 9.4)],
)
def test_stationary_competition_has_same_winner_at_every_step(
    energy: float, every: int, count: int, theta: float
) -> None:
    ours, theirs = competition(0.0, energy, every, count, theta)
    assert ours == theirs


def test_tested_competitions_have_both_outcomes() -> None:
    """The comparisons would prove nothing if the same packet always won."""
    assert not any(competition(0.0, 0.05, 1, 1, 0.0)[1])
    assert competition(0.0, 1.2, 1, 5, 0.0)[1][-1]


@pytest.mark.parametrize(
    ('speed', 'theta', 'energy', 'count'),
    [(0.05, 9.4, 0.15, 6), (0.3, 27.0, 0.3, 3), (1.0, 0.0, 0.6, 4), (0.3, 27.0, 0.02, 2)],
)
def test_moving_competition_changes_winner_within_one_step(
    speed: float, theta: float, energy: float, count: int
) -> None:
    ours, theirs = competition(speed, energy, 1, count, theta, 25)
    assert ours[-1] == theirs[-1]
    changes = winner_changes(ours), winner_changes(theirs)
    assert len(changes[0]) == len(changes[1])
    assert all(abs(a - b) <= 1 for a, b in zip(*changes, strict=True))


# Peak


@pytest.mark.parametrize('dims', [(36, 21, 21), (36, 3, 11), (5, 8, 2), (1, 1, 1)])
def test_peak_equals_population_vectors_of_dense_reference(
    dims: tuple[int, int, int],
) -> None:
    p = parameters(*dims)
    net = network(p)
    rng = np.random.default_rng(3)
    packets = net.start()
    for _ in range(12):
        packets = net.inject(packets, *rng.uniform(0, dims).tolist(), 0.4)
        expected = peak_of(net.dense(packets))
        found = net.peak(packets)
        ring = np.array(dims)
        assert np.abs(around(np.array(found) - expected, ring)).max() < 1e-9
        assert all(0.0 <= value < n for value, n in zip(found, dims, strict=True))
        packets = net.step(packets, 0.0, 0.0)


@pytest.mark.parametrize('energy', [0.1, 0.3, 0.9])
def test_rounding_errors_do_not_enlarge_packets(energy: float) -> None:
    """A packet of one heading plane moves with its mean: the two boxes must stay separate."""
    network = Network((36, 41, 41), kernel(1, 1.0), kernel(1, 1.0), 0.0)
    packets = network.inject([], 1.0, 10.0, 10.0, energy)
    packets = network.inject(packets, 1.0, 10.0, 14.0, energy)
    assert len(network.step(packets, 1.0, 0.0)) == 2


def test_merged_packets_keep_the_lattice_of_the_heavier_one() -> None:
    light, heavy = (
        Packet(np.full((1, 1, 1), energy), np.array([3, 4, x, 1, 1, 1]), np.array([0.0, 0.0, e]))
        for energy, x, e in ((0.2, 20, 0.25), (0.5, 1, -0.25))  # across the edge
    )
    net = network(parameters(36, 21, 21))
    for packets in ([light, heavy], [heavy, light]):
        [merged] = net._merged(packets)
        assert merged.frame.tolist() == [0.0, 0.0, -0.25]
        assert merged.cells.sum() == pytest.approx(0.7)
        assert merged.box.tolist() == [3, 4, 20, 1, 1, 3]
