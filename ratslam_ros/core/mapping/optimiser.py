# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose graph optimiser: schedules relaxation of the experience graph by a budget per action."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.saved import MAX_COUNT, Field, Saved, count
from ratslam_ros.core.common.state import State
from ratslam_ros.core.common.turn_correction import UNCORRECTED, TurnCorrection
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.link_weights import link_weights, reweigh
from ratslam_ros.core.mapping.links import Links
from ratslam_ros.core.mapping.odometry_noise import OdometryNoise
from ratslam_ros.core.mapping.relaxation import (
    batch,
    corrected_turns,
    relax,
    relax_with_turns,
    sweep,
)

LINKS_PER_ACTION = 2000
"""Number of links that one action may relax on average.

Unused budget is saved for the next change of the graph. Larger maps are relaxed once in several
actions, so that the mean cost of an action is independent of the size of the map.
"""

MAX_CHANGE = 0.01
"""Change of the weight of a recognition, as a share of its full weight, below which the map has
converged."""

LEAST_GAIN = 0.1
"""Decrease of the cost of the map (chi-square) by one step, below which the map has converged."""

MAX_STEPS, MOST_LEFT = 5, 0.9
"""Number of Gauss-Newton steps that one relaxation may take, and the share of the cost that a step
must leave for it to be the last one. Before loops are closed, residuals do not show which
recognitions are false."""

EQUAL_WEIGHTS = (1e3, 1e9)
"""Weights of the position, in 1/m^2, and of the heading, in 1/rad^2, of each link if the view
spacing is unknown. The second is so large that positions do not affect the headings, as at the
fixed point of equation (7) of Milford et al. (2006)."""

FALSE_SHARE = 0.01
"""Share of its full weight below which a recognition is false."""

STEPS_PER_LINK = 12
"""Estimated elimination steps per link, used until the first relaxation."""


class PoseGraphOptimiser(Saved):
    """Relaxes the poses when the links have changed and the saved budget suffices.

    If ``exp_relaxation`` is sweep or batch, each action corrects all experiences a little instead.
    """

    SAVED = (
        # Two numbers of earlier versions, ``is_settled``, and the saved budget.
        Field('relaxation', '', int, (4,), 0, MAX_COUNT, save=lambda own: (
            0, 0, own.is_settled, own._saved_steps
        )),
        count('planning_work', '_work'),
        Field('odometry_noise', 'noise', OdometryNoise,
              when=lambda own: own.view_spacing_m > 0.0 or own.noise.has_scans),
        Field('turns', 'turns', float, (2,), make=TurnCorrection,
              when=lambda own: own.turns != UNCORRECTED),
    )

    def __init__(self, parameters: ExperienceMapParameters) -> None:
        self._p = parameters
        self._work = 0
        self._saved_steps = 0
        self.view_spacing_m = 0.0
        """Scale of the weights of all links; with 0 all links have the same weight."""
        self.turns = UNCORRECTED
        """Correction of the turns of odometry that suits the map best."""
        self.noise = OdometryNoise()
        """Noise of the odometry, which the weights follow."""
        self.is_settled = True
        """Whether the poses are close to the optimum for the present links."""

    @property
    def is_enabled(self) -> bool:
        """Whether the parameters allow any relaxation."""
        return self._p.exp_loops > 0 and self._p.exp_correction > 0.0

    def weights(self, links: Links) -> NDArray[np.float64]:
        """Return the (links, 2) weights of links; see ``link_weights`` and ``EQUAL_WEIGHTS``."""
        if self.view_spacing_m == 0.0:
            return np.tile(EQUAL_WEIGHTS, (len(links), 1))
        return link_weights(
            links.shapes, links.recognised, links.shares, self.view_spacing_m, self.noise.std,
            self.noise.std_rad,
        )

    def links_changed(self) -> None:
        """Mark that a link was added, deleted or measured again."""
        self.is_settled = False

    def step(self, poses: NDArray[np.float64], links: Links) -> None:
        """Add one action's budget to the saved one, and relax if the sum suffices.

        Args:
            poses: (n, 3) x, y in m and heading in rad; changed in place.
            links: the constraints.
        """
        p = self._p
        if len(links) == 0 or not self.is_enabled:
            return
        if p.exp_relaxation != 'solve':
            correct = sweep if p.exp_relaxation == 'sweep' else batch
            correct(poses, links.ends, links.shapes, p.exp_correction, p.exp_loops)
            return
        cost = len(links) + (self._work or STEPS_PER_LINK * len(links)) // 3
        self._saved_steps = min(self._saved_steps + LINKS_PER_ACTION, cost)
        if self.is_settled or self._saved_steps < cost:
            return
        self.discard_budget()
        self.settle(poses, links)

    def settle(self, poses: NDArray[np.float64], links: Links) -> None:
        """Move all experiences close to their most likely poses, whatever the budget.

        Then adapt the weights of recognitions, one iteration of reweighted least squares, and
        estimate the systematic errors of turns: a new recognition, which may be false, has its
        full weight before. Those that the map still contradicts after another iteration are
        deleted: routes must not use them. Arguments as for ``step``.
        """
        ends, recognised, shares = links.ends, links.recognised, links.shares
        weights, old_shares = self.weights(links), shares.copy()
        shapes = corrected_turns(links.shapes, ~recognised, *self.turns)
        for _ in range(MAX_STEPS):
            self._work, before, after = relax(poses, ends, shapes, weights)
            if after >= MOST_LEFT * before:
                break
        spacing_m = self.view_spacing_m
        change = reweigh(poses, ends, shapes, recognised, shares, spacing_m)
        if spacing_m > 0.0:
            _, before, after, self.turns = relax_with_turns(
                poses, ends, links.shapes, self.weights(links), ~recognised, self.turns, spacing_m
            )
        self.is_settled = before - after < LEAST_GAIN and change < MAX_CHANGE
        false = np.flatnonzero(recognised & (np.maximum(old_shares, shares) < FALSE_SHARE))
        if len(false) > 0:
            links.delete(false.tolist())

    def discard_budget(self) -> None:
        """Set the saved budget to zero."""
        self._saved_steps = 0

    def _restored(self, state: State) -> None:
        *_, self.is_settled, self._saved_steps = state['relaxation']
        self.view_spacing_m = state.get('view_spacing_m', 0.0)
