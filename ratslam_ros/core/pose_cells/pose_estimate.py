# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose estimate: the activity of the network, and the pose that its peak represents.

The base of ``PoseCells``, which decides what moves and corrects it.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.pose_cells.attractor import Network, kernel
from ratslam_ros.core.pose_cells.packet import MAX_CELLS, Packet, packets_fit
from ratslam_ros.core.pose_cells.torus import Located, Place, Torus, Unwrapped


class PoseEstimate(Saved):
    """Packets of activity, the place of their peak, and its unwrapped position."""

    SAVED: ClassVar[tuple[Field, ...]] = (
        Field('dims', 'dims', int, (3,), 1, MAX_CELLS,
              parameters='pc_dim_x, pc_dim_y and pc_dim_th'),
        Field('packets', '_packets', list, fits=('boxes on the torus', packets_fit),
              save=lambda packets: [packet._asdict() for packet in packets],
              load=lambda packets: [Packet(**packet) for packet in packets]),
        # The peak cannot be decoded from the packets if a view has injected since.
        Field('unrolled/peak', 'peak', float, (3,), make=Place),
        Field('unrolled/here', '_unwrapped', float, (2,), make=lambda *here: here),
    )

    def __init__(self, parameters: PoseCellsParameters) -> None:
        p = parameters
        self._torus = Torus(p.pc_dim_x, p.pc_dim_y, p.pc_dim_th)
        self._network = Network(
            (p.pc_dim_th, p.pc_dim_y, p.pc_dim_x),
            kernel(p.pc_w_e_dim, p.pc_w_e_var),
            kernel(p.pc_w_i_dim, p.pc_w_i_var),
            p.pc_global_inhib,
            p.pc_lattice == 'fixed',
        )
        self.peak = Place(0.0, 0.0, 0.0)
        """Peak of activity after the last odometry message."""
        self._start()

    @property
    def dims(self) -> tuple[int, int, int]:
        """Numbers of cells in x, y and theta."""
        return self._torus.n_x, self._torus.n_y, self._torus.n_theta

    def activity(self) -> NDArray[np.float64]:
        """Return the activity of all cells, (n_theta, n_y, n_x)."""
        return self._network.dense(self._packets)

    def projected(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the activity summed over theta, of the active cells of the (y, x) plane.

        Returns:
            (n,) cell numbers y * n_x + x, ascending, and (n,) their activity, above 0.
        """
        return self._network.projected(self._packets)

    def active(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the active cells and their activity.

        Returns:
            (n, 3) theta, y and x, ascending, and (n,) their activity, above 0.
        """
        return self._network.active(self._packets)

    def packets(self) -> NDArray[np.float64]:
        """Return theta, y and x of the peak of each packet, and its total activity, (m, 4)."""
        return self._network.places(self._packets)

    def _start(self) -> None:
        """Begin with one active cell."""
        self._packets = self._network.start()
        self._decode()
        self._unwrapped: Unwrapped = self.peak.x, self.peak.y

    @property
    def _located(self) -> Located:
        """The peak, and its unwrapped position."""
        return Located(self.peak, self._unwrapped)

    def _step(self, chord: float, turn: float, course: float) -> None:
        """Advance the network by one motion, in cells and heading planes."""
        self._packets = self._network.step(self._packets, chord, turn, course)
        before = self.peak
        self._decode()
        self._unwrapped = self._torus.displaced(self._unwrapped, before, self.peak)

    def _turn(self, chord: float, turn: float, course: float) -> None:
        """Advance the network by a turn only, and the position by odometry alone."""
        direction = (self.peak.theta + 0.5 * turn + course) / self._torus.planes_per_rad
        x, y = self._unwrapped
        self._unwrapped = x + chord * math.cos(direction), y + chord * math.sin(direction)
        self._packets = self._network.step(self._packets, 0.0, turn)
        self._decode()
        self.peak = self._torus.wrapped(self._unwrapped, self.peak.theta)

    def _inject_at(self, place: Place, energy: float, interpolate: bool) -> None:
        """Add energy at a place; the peak stays until the next step."""
        self._packets = self._network.inject(
            self._packets, place.theta, place.y, place.x, energy, interpolate
        )

    def _move_to(
        self, located: Located, offset: Pose = Pose(0.0, 0.0, 0.0), cell_m: float = 1.0
    ) -> None:
        """Concentrate the activity at a place, or at a pose in metres in its frame."""
        (x, y, theta), unwrapped = located
        torus = self._torus
        heading_rad = theta / torus.planes_per_rad
        d_x, d_y, _ = composed(Pose(0.0, 0.0, heading_rad), offset)
        d_x, d_y = d_x / cell_m, d_y / cell_m
        self._packets = self._network.inject(
            [], (theta + offset.heading_rad * torus.planes_per_rad) % torus.n_theta,
            (y + d_y) % torus.n_y, (x + d_x) % torus.n_x, 1.0,
        )
        self._decode()
        self._unwrapped = unwrapped[0] + d_x, unwrapped[1] + d_y

    def _correct(self, known: Located) -> None:
        """Derive the unwrapped position from that of a known place nearby."""
        self._unwrapped = self._torus.displaced(known.unwrapped, known.place, self.peak)

    def _rescale(self, factor: float) -> None:
        """Multiply the position by a factor; the activity, a single packet, keeps its shape."""
        self._decode()
        before = self.peak
        place, self._unwrapped = self._torus.rescaled(self._located, factor)
        self._packets = [
            self._network.displaced(packet, place.y - before.y, place.x - before.x)
            for packet in self._packets
        ]
        self._decode()

    def _decode(self) -> None:
        theta, y, x = self._network.peak(self._packets)
        self.peak = Place(x, y, theta)
