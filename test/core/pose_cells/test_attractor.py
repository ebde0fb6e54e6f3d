# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Attractor network: conservation of activity, and equality with a dense reference."""

import math

import numpy as np
import pytest
from helpers import DenseNetwork, around, extended
from hypothesis import given, settings
from hypothesis import strategies as st

from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.pose_cells.attractor import Network, kernel

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


@pytest.mark.parametrize('energy', [0.1, 0.3, 0.9])
def test_rounding_errors_do_not_enlarge_packets(energy: float) -> None:
    """A packet of one heading plane moves with its mean: the two boxes must stay separate."""
    network = Network((36, 41, 41), kernel(1, 1.0), kernel(1, 1.0), 0.0)
    packets = network.inject([], 1.0, 10.0, 10.0, energy)
    packets = network.inject(packets, 1.0, 10.0, 14.0, energy)
    assert len(network.step(packets, 1.0, 0.0)) == 2
