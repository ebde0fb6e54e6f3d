# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Path integration: the packet follows the odometry at any speed.

In OpenRatSLAM the competition pins the packet to its cells: it follows 2 to 25 % of the motion at
0.001 cells per step, 75 to 80 % at 0.01 and 87 % at 0.1.
"""

import math

import numpy as np
import pytest
from helpers import DenseNetwork, ahead, around, centroid, extended, turning
from numpy.typing import NDArray

from ratslam_ros.core.pose_cells.attractor import Network, kernel
from ratslam_ros.core.pose_cells.packet import Packet
from ratslam_ros.core.pose_cells.pose_cells import PoseCells

DIMS = (36, 21, 24)
PLANE_RAD = 2.0 * math.pi / 36
HEADINGS = [1.5 * k + 0.37 for k in range(24)]
"""Headings between the planes, in planes."""


@pytest.fixture(scope='module')
def net() -> Network:
    return Network(DIMS, kernel(7, 1.0), kernel(5, 2.0), 0.00002)


def settled(net: Network, heading: float) -> list[Packet]:
    """Return a stationary packet at a heading between the planes, reached by odometry."""
    packets = net.start()
    for _ in range(10):
        packets = net.step(packets, 0.131, (heading - 18.0) / 10)
    for _ in range(20):
        packets = net.step(packets, 0.0, 0.0)
    return packets


def travelled(
    net: Network, packets: list[Packet], steps: list[tuple[float, float]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the unwrapped displacement (theta, y, x) of the peak, and its final place."""
    before = np.array(net.peak(packets))
    displacement = np.zeros(3)
    for cells, planes in steps:
        packets = net.step(packets, cells, planes)
        now = np.array(net.peak(packets))
        displacement += around(now - before, np.array(DIMS, float))
        before = now
    return displacement, before


def straight_error(net: Network, heading: float, speed: float, cells: float = 10.0) -> float:
    """Return the position error of the peak relative to the driven distance."""
    packets = settled(net, heading)
    angle = net.peak(packets)[0] * PLANE_RAD
    count = math.ceil(cells / abs(speed))
    displacement, _ = travelled(net, packets, [(speed, 0.0)] * count)
    expected = count * speed * np.array([0.0, math.sin(angle), math.cos(angle)])
    return float(np.hypot(*(displacement - expected)[1:]) / np.hypot(*expected[1:]))


@pytest.mark.parametrize('speed', [0.1, 1.0, 2.3, -1.3])
def test_peak_follows_translation_at_12_headings(net: Network, speed: float) -> None:
    assert max(straight_error(net, heading, speed) for heading in HEADINGS[::2]) <= 0.02


@pytest.mark.parametrize(
    ('speed', 'headings'),
    [(0.001, HEADINGS[1:2]), (0.01, HEADINGS[3::8]), (-0.01, HEADINGS[::12])],
)
def test_peak_follows_slow_translation(
    net: Network, speed: float, headings: list[float]
) -> None:
    assert max(straight_error(net, heading, speed) for heading in headings) <= 0.02


@pytest.mark.parametrize('speed', [0.1, 1.0, -0.7])
def test_translation_does_not_change_heading(net: Network, speed: float) -> None:
    """In OpenRatSLAM translation changes a heading between two planes."""
    worst = 0.0
    for heading in HEADINGS[::6]:
        count = math.ceil(40.0 / abs(speed))
        displacement, _ = travelled(net, settled(net, heading), [(speed, 0.0)] * count)
        worst = max(worst, abs(displacement[0]))
    assert worst <= 0.1


@pytest.mark.parametrize('rate', [0.005, 0.3, 2.7, -0.6])
@pytest.mark.parametrize('heading', HEADINGS[::12])
def test_peak_follows_rotation(net: Network, rate: float, heading: float) -> None:
    count = math.ceil(10.0 / abs(rate))
    displacement, _ = travelled(net, settled(net, heading), [(0.0, rate)] * count)
    assert displacement[0] == pytest.approx(count * rate, rel=0.02)
    assert np.hypot(displacement[1], displacement[2]) < 0.05


@pytest.mark.parametrize(('speed', 'rate'), [(0.1, 0.05), (0.5, -0.12), (1.5, 0.4)])
def test_peak_follows_arc(net: Network, speed: float, rate: float) -> None:
    """Drive a quarter of a circle and compare the end point."""
    packets = settled(net, 4.37)
    count = round(9.0 / abs(rate))
    start = net.peak(packets)[0] * PLANE_RAD
    displacement, _ = travelled(net, packets, [(speed, rate)] * count)
    angles = start + (np.arange(count) + 0.5) * rate * PLANE_RAD
    expected = speed * np.array([np.sin(angles).sum(), np.cos(angles).sum()])
    assert np.hypot(*(displacement[1:] - expected)) <= 0.02 * count * speed
    assert displacement[0] == pytest.approx(count * rate, rel=0.02)


def test_stationary_peak_between_cells_does_not_drift(net: Network) -> None:
    displacement, _ = travelled(net, settled(net, 7.37), [(0.0, 0.0)] * 5_000)
    assert np.abs(displacement).max() < 0.01


@pytest.mark.parametrize(('speed', 'turn_planes'), [(0.1, 9.4), (1.0, -6.3)])
def test_second_packet_follows_its_own_heading(speed: float, turn_planes: float) -> None:
    """A weaker packet at another heading is tracked as well as with bilinear shifts."""
    p = extended('pose_cells', pc_dim_th=36, pc_dim_x=60, pc_dim_y=60)
    dims = (36, 60, 60)
    net = Network(dims, kernel(7, 1.0), kernel(5, 2.0), 0.0)
    dense = DenseNetwork(extended(
        'pose_cells', pc_dim_th=p.pc_dim_th, pc_dim_x=p.pc_dim_x, pc_dim_y=p.pc_dim_y,
        pc_global_inhib=0.0,
    ))
    main, second = np.array([5.0, 15.0, 15.0]), np.array([(5.0 + turn_planes) % 36, 42.2, 41.7])
    packets = net.inject(net.inject([], *main, 1.0), *second, 0.9)
    dense.activity[:] = 0.0
    dense.inject(*main, 1.0)
    dense.inject(*second, 0.9)
    for _ in range(12):
        packets = net.step(packets, 0.0, 0.0)
        dense.step()
    starts = centroid(net.dense(packets), tuple(second)), centroid(dense.activity, tuple(second))
    count = round(6.0 / speed)
    places = [np.array(start) for start in starts]
    displacements = [np.zeros(3), np.zeros(3)]
    for _ in range(count):
        packets = net.step(packets, speed, 0.0)
        dense.step(speed)
        for i, activity in enumerate((net.dense(packets), dense.activity)):
            now = np.array(centroid(activity, tuple(places[i])))
            displacements[i] += around(now - places[i], np.array(dims, float))
            places[i] = now
    angle = starts[0][0] * PLANE_RAD
    expected = count * speed * np.array([0.0, math.sin(angle), math.cos(angle)])
    ours, bilinear = (float(np.hypot(*(d - expected)[1:])) for d in displacements)
    assert ours <= bilinear + 0.02 * count * speed
    assert ours <= 0.1 * count * speed


@pytest.mark.parametrize(('planes', 'deviation'), [(12, 1.0), (36, 2.0)])
def test_packet_over_many_headings_moves_at_robot_speed(
    planes: int, deviation: float
) -> None:
    """The mean displacement of its planes alone would be 5 to 15 % short."""
    net = Network((planes, 30, 30), kernel(7, deviation), kernel(5, 2.0), 0.00002)
    packets = net.start()
    for _ in range(20):
        packets = net.step(packets, 0.0, 0.0)
    before, displacement = net.peak(packets), 0.0
    for _ in range(60):
        packets = net.step(packets, -0.2, 0.0)
        now = net.peak(packets)
        displacement += around(now[2] - before[2], 30.0)
        before = now
    assert displacement == pytest.approx(12.0, rel=0.02)


@pytest.mark.parametrize(('speed', 'rate'), [(0.0, 0.5), (1.5, 0.0)])
def test_moving_packet_has_width_of_bilinear_shifts(speed: float, rate: float) -> None:
    """The winner must not depend on the motion of the lattice: a wider packet is a weaker one."""
    p = extended('pose_cells', pc_dim_th=36, pc_dim_y=21, pc_dim_x=24)
    net, dense = Network(DIMS, kernel(7, 1.0), kernel(5, 2.0), 0.00002), DenseNetwork(p)
    packets = net.start()
    widths: list[list[float]] = [[], []]
    for step in range(60):
        packets = net.step(packets, speed, rate)
        dense.step(speed, rate)
        if step >= 20:
            widths[0].append(sum(float((packet.cells**2).sum()) for packet in packets))
            widths[1].append(float((dense.activity**2).sum()))
    ours, theirs = (float(np.mean(width)) for width in widths)
    stationary = DenseNetwork(p)
    for _ in range(60):
        stationary.step()
    at_rest = float((stationary.activity**2).sum())
    assert ours == pytest.approx(theirs, rel=0.1)
    assert theirs < 0.9 * at_rest  # otherwise the comparison would prove nothing


# The same with PoseCells: metres, radians and arcs


@pytest.mark.parametrize('cell_m', [0.015, 2.0])
def test_pose_cells_convert_metres_by_cell_size(cell_m: float) -> None:
    cells = PoseCells(extended('pose_cells', pc_dim_x=30, pc_dim_y=20, pc_cell_x_size=cell_m))
    start = cells.peak
    for _ in range(100):
        cells.integrate(ahead(0.05 * cell_m))
    # The initial heading is the middle plane, along negative x.
    assert start.theta == 18.0
    assert around(cells.peak.x - start.x, 30) == pytest.approx(-5.0, abs=0.1)
    assert around(cells.peak.y - start.y, 20) == pytest.approx(0.0, abs=0.05)
    for _ in range(90):
        cells.integrate(turning(0.01))
    assert around(cells.peak.theta - 18.0, 36) == pytest.approx(0.9 / PLANE_RAD, rel=0.02)
