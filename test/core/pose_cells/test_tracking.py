# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Algorithm.md, Tracking: the packet goes where the odometry says, at any speed.

In the original the competition pins the packet to the lattice: it follows 2 to 25 % of the motion
at 0.001 cells a step, 75 to 80 % at 0.01 and 87 % at 0.1.
"""

import math

import numpy as np
import pytest
from helpers import DenseNetwork, ahead, around, centroid, turning
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.pose_cells.attractor import Network, Packet, kernel
from ratslam_ros.core.pose_cells.pose_cells import PoseCells

DIMS = (36, 21, 24)
PLANE_RAD = 2.0 * math.pi / 36
HEADINGS = [1.5 * k + 0.37 for k in range(24)]  # planes; none lies on the lattice


@pytest.fixture(scope='module')
def net() -> Network:
    return Network(DIMS, kernel(7, 1.0), kernel(5, 2.0), 0.00002)


def settled(net: Network, heading: float) -> list[Packet]:
    """Return a packet that came to a heading off the lattice by odometry, and stands there."""
    packets = net.start()
    for _ in range(10):
        packets = net.step(packets, 0.131, (heading - 18.0) / 10)
    for _ in range(20):
        packets = net.step(packets, 0.0, 0.0)
    return packets


def travelled(
    net: Network, packets: list[Packet], steps: list[tuple[float, float]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the peak's unwrapped way (theta, y, x) and where it was in the end, after steps."""
    before = np.array(net.peak(packets))
    way = np.zeros(3)
    for cells, planes in steps:
        packets = net.step(packets, cells, planes)
        now = np.array(net.peak(packets))
        way += around(now - before, np.array(DIMS, float))
        before = now
    return way, before


def straight_error(net: Network, heading: float, speed: float, cells: float = 10.0) -> float:
    """Return how far the peak is from where it was sent, as a share of the way."""
    packets = settled(net, heading)
    angle = net.peak(packets)[0] * PLANE_RAD
    count = math.ceil(cells / abs(speed))
    way, _ = travelled(net, packets, [(speed, 0.0)] * count)
    sent = count * speed * np.array([0.0, math.sin(angle), math.cos(angle)])
    return float(np.hypot(*(way - sent)[1:]) / np.hypot(*sent[1:]))


@pytest.mark.parametrize('speed', [0.1, 0.3, 0.7, 1.0, 1.7, 2.3, 3.0, -0.2, -1.3])
def test_the_peak_follows_translation_at_24_headings(net: Network, speed: float) -> None:
    assert max(straight_error(net, heading, speed) for heading in HEADINGS) <= 0.02


@pytest.mark.parametrize(
    ('speed', 'headings'),
    [(0.001, HEADINGS[1::12]), (0.003, HEADINGS[2::8]), (0.01, HEADINGS[3::3]),
     (-0.01, HEADINGS[::6]), (0.03, HEADINGS[::2])],
)  # fmt: skip
def test_the_peak_follows_slow_translation(
    net: Network, speed: float, headings: list[float]
) -> None:
    assert max(straight_error(net, heading, speed) for heading in headings) <= 0.02


@pytest.mark.parametrize('speed', [0.05, 0.4, 1.0, 2.6])
def test_the_peak_follows_over_40_cells_round_the_torus(net: Network, speed: float) -> None:
    assert max(straight_error(net, heading, speed, 40.0) for heading in HEADINGS[::3]) <= 0.02


@pytest.mark.parametrize('speed', [0.02, 0.1, 0.5, 1.0, 2.2, -0.7])
def test_translation_does_not_turn_the_heading(net: Network, speed: float) -> None:
    """In the original translation turns a heading that is off the lattice."""
    worst = 0.0
    for heading in HEADINGS if abs(speed) > 0.4 else HEADINGS[::6]:
        count = math.ceil(40.0 / abs(speed))
        way, _ = travelled(net, settled(net, heading), [(speed, 0.0)] * count)
        worst = max(worst, abs(way[0]))
    assert worst <= 0.1


@pytest.mark.parametrize('speed', [3.0, -3.0])
def test_a_fast_drive_leaves_the_heading_as_it_was(net: Network, speed: float) -> None:
    """Seen after a stop: at 3 cells a step the planes lie apart further than the peak's box."""
    for heading in HEADINGS:
        steps = [(speed, 0.0)] * 14 + [(0.0, 0.0)] * 10
        way, _ = travelled(net, settled(net, heading), steps)
        assert abs(way[0]) <= 0.1


@pytest.mark.parametrize('rate', [0.005, 0.05, 0.3, 1.0, 2.7, -0.02, -0.6])
@pytest.mark.parametrize('heading', HEADINGS[::8])
def test_the_peak_follows_rotation(net: Network, rate: float, heading: float) -> None:
    count = math.ceil(10.0 / abs(rate))
    way, _ = travelled(net, settled(net, heading), [(0.0, rate)] * count)
    assert way[0] == pytest.approx(count * rate, rel=0.02)
    assert np.hypot(way[1], way[2]) < 0.05


@pytest.mark.parametrize(('speed', 'rate'), [(0.1, 0.05), (0.5, -0.12), (1.5, 0.4)])
def test_the_peak_follows_an_arc(net: Network, speed: float, rate: float) -> None:
    """A quarter of a circle: the way to its end, along its chord and across."""
    packets = settled(net, 4.37)
    count = round(9.0 / abs(rate))
    start = net.peak(packets)[0] * PLANE_RAD
    way, _ = travelled(net, packets, [(speed, rate)] * count)
    angles = start + (np.arange(count) + 0.5) * rate * PLANE_RAD
    sent = speed * np.array([np.sin(angles).sum(), np.cos(angles).sum()])
    assert np.hypot(*(way[1:] - sent)) <= 0.02 * count * speed
    assert way[0] == pytest.approx(count * rate, rel=0.02)


@pytest.mark.parametrize('heading', [7.37, 20.9])
def test_at_rest_off_the_lattice_nothing_drifts_in_10000_steps(
    net: Network, heading: float
) -> None:
    way, _ = travelled(net, settled(net, heading), [(0.0, 0.0)] * 10_000)
    assert np.abs(way).max() < 0.01


def test_a_packet_that_stopped_between_the_cells_stays_there(net: Network) -> None:
    packets = settled(net, 7.37)
    for _ in range(13):
        packets = net.step(packets, 0.137, 0.071)
    way, _ = travelled(net, packets, [(0.0, 0.0)] * 2000)
    assert np.abs(way).max() < 0.01


@pytest.mark.parametrize('speed', [0.05, 0.2, 1.0])
@pytest.mark.parametrize('turn_planes', [9.4, 18.0, -6.3])
def test_a_second_packet_follows_its_own_heading(speed: float, turn_planes: float) -> None:
    """The weaker packet, elsewhere and at another heading, goes no worse than bilinear shifts."""
    p = PoseCellsParameters(pc_dim_th=36, pc_dim_x=60, pc_dim_y=60)
    dims = (36, 60, 60)
    net = Network(dims, kernel(7, 1.0), kernel(5, 2.0), 0.0)
    dense = DenseNetwork(PoseCellsParameters(
        pc_dim_th=p.pc_dim_th, pc_dim_x=p.pc_dim_x, pc_dim_y=p.pc_dim_y, pc_global_inhib=0.0,
    ))  # fmt: skip
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
    ways = [np.zeros(3), np.zeros(3)]
    for _ in range(count):
        packets = net.step(packets, speed, 0.0)
        dense.step(speed)
        for i, activity in enumerate((net.dense(packets), dense.activity)):
            now = np.array(centroid(activity, tuple(places[i])))
            ways[i] += around(now - places[i], np.array(dims, float))
            places[i] = now
    angle = starts[0][0] * PLANE_RAD
    sent = count * speed * np.array([0.0, math.sin(angle), math.cos(angle)])
    ours, bilinear = (float(np.hypot(*(way - sent)[1:])) for way in ways)
    assert ours <= bilinear + 0.02 * count * speed
    assert ours <= 0.1 * count * speed


@pytest.mark.parametrize(('planes', 'deviation'), [(12, 1.0), (20, 1.0), (20, 2.0), (36, 2.0)])
def test_a_packet_spread_over_many_headings_keeps_the_robots_speed(
    planes: int, deviation: float
) -> None:
    """The mean of its planes' ways alone would be 5 to 15 % short."""
    net = Network((planes, 30, 30), kernel(7, deviation), kernel(5, 2.0), 0.00002)
    packets = net.start()
    for _ in range(20):
        packets = net.step(packets, 0.0, 0.0)
    before, way = net.peak(packets), 0.0
    for _ in range(60):
        packets = net.step(packets, -0.2, 0.0)
        now = net.peak(packets)
        way += around(now[2] - before[2], 30.0)
        before = now
    assert way == pytest.approx(12.0, rel=0.02)


@pytest.mark.parametrize(('speed', 'rate'), [(0.5, 0.0), (0.0, 0.5), (0.3, 0.3), (1.5, 0.0)])
def test_a_moving_packet_is_as_wide_as_bilinear_shifts_make_it(speed: float, rate: float) -> None:
    """Who wins shall not depend on the lattice's own motion: a wider packet is a weaker one."""
    p = PoseCellsParameters(pc_dim_th=36, pc_dim_y=21, pc_dim_x=24)
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
    still = DenseNetwork(p)
    for _ in range(60):
        still.step()
    at_rest = float((still.activity**2).sum())
    assert ours == pytest.approx(theirs, rel=0.1)
    assert theirs < 0.9 * at_rest  # or nothing would be shown


# The same through the pose cells' own door: metres, radians and arcs


@pytest.mark.parametrize('cell_m', [0.015, 0.25, 2.0])
def test_pose_cells_follow_metres_in_their_cell_size(cell_m: float) -> None:
    cells = PoseCells(PoseCellsParameters(pc_dim_x=30, pc_dim_y=20, pc_cell_x_size=cell_m))
    start = cells.peak
    for _ in range(100):
        cells.integrate(ahead(0.05 * cell_m))
    # The start is in the middle plane, which looks back along x.
    assert start.theta == 18.0
    assert around(cells.peak.x - start.x, 30) == pytest.approx(-5.0, abs=0.1)
    assert around(cells.peak.y - start.y, 20) == pytest.approx(0.0, abs=0.05)
    for _ in range(90):
        cells.integrate(turning(0.01))
    assert around(cells.peak.theta - 18.0, 36) == pytest.approx(0.9 / PLANE_RAD, rel=0.02)


@pytest.mark.parametrize('steps', [1, 7, 200])
def test_pose_cells_follow_the_exact_arc_in_steps_of_any_length(steps: int) -> None:
    """Half a circle in one step or in many ends at the same place."""
    cells = PoseCells(PoseCellsParameters(pc_dim_x=40, pc_dim_y=40))
    for _ in range(10):
        cells.integrate(Motion(0.1, 0.0, 0.0))
    start = cells.peak
    length = 8.0 * math.pi / 2.0  # radius 4
    for _ in range(steps):
        cells.integrate(Motion(0.1, length / steps, math.pi / steps))
    assert around(cells.peak.x - start.x, 40) == pytest.approx(0.0, abs=0.25)
    assert around(cells.peak.y - start.y, 40) == pytest.approx(-8.0, abs=0.25)
    assert around(cells.peak.theta - start.theta, 36) == pytest.approx(-18.0, abs=0.1) or (
        around(cells.peak.theta - start.theta, 36) == pytest.approx(18.0, abs=0.1)
    )


def test_zero_odometry_moves_nothing() -> None:
    cells = PoseCells(PoseCellsParameters())
    before = None
    for step in range(1000):
        cells.integrate(Motion(0.1, 0.0, 0.0))
        if step == 50:
            before = cells.peak
    assert before is not None
    assert np.abs(np.array(cells.peak) - np.array(before)).max() < 1e-3
