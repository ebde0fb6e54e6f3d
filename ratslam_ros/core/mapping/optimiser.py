# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose graph optimiser: schedules relaxation of the experience graph by a budget per action."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.saved import MAX_COUNT, Field, Saved, count
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.link_weights import link_weights, reweigh
from ratslam_ros.core.mapping.links import Links
from ratslam_ros.core.mapping.odometry_noise import OdometryNoise
from ratslam_ros.core.mapping.relaxation import Relaxation, batch, sweep

LINKS_PER_ACTION = 2000
"""Number of links that one action may relax on average.

Unused budget is saved for the next change of the graph. Larger maps are relaxed once in several
actions, so that the mean cost of an action is independent of the size of the map.
"""

MAX_CHANGE = 0.01
"""Change of the weight of a recognition, as a share of its full weight, below which the map has
converged."""

FALSE_SHARE = 0.01
"""Share of its full weight below which a recognition is false."""

PLANNING_STEPS_PER_LINK = 12
"""Estimated planning steps per link, used until the first plan has been made."""


class PoseGraphOptimiser(Saved):
    """Relaxes the poses when the links have changed and the saved budget suffices.

    If ``exp_relaxation`` is sweep or batch, each action corrects all experiences a little instead.
    """

    SAVED = (
        # Number of planned links, whether the plan holds, ``is_settled``, and the saved budget.
        Field('relaxation', '', int, (4,), 0, MAX_COUNT, save=lambda own: (
            0 if own._plan is None else own._plan.links, own._plan_holds, own.is_settled,
            own._saved_steps,
        )),
        count('planning_work', '_planning_work'),
        Field('odometry_noise', 'noise', OdometryNoise,
              when=lambda own: own.view_spacing_m > 0.0 or own.noise.has_scans),
    )

    def __init__(self, parameters: ExperienceMapParameters) -> None:
        self._p = parameters
        self._plan: Relaxation | None = None
        self._planning_work = 0
        self._plan_holds = False
        self._saved_steps = 0
        self.view_spacing_m = 0.0
        """Scale of the weights of all links; with 0 all links have the same weight."""
        self.noise = OdometryNoise()
        """Noise of the odometry, which the weights follow."""
        self.is_settled = True
        """Whether the poses are the optimum for the present links."""

    @property
    def is_enabled(self) -> bool:
        """Whether the parameters allow any relaxation."""
        return self._p.exp_loops > 0 and self._p.exp_correction > 0.0

    def structure_changed(self) -> None:
        """Mark that links were added or deleted, so that a new elimination plan is needed."""
        self.is_settled = self._plan_holds = False

    def measurement_changed(self) -> None:
        """Mark that the distance, heading or facing of a link changed."""
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
        cost = len(links)
        if not self._plan_holds:
            cost += (self._planning_work or PLANNING_STEPS_PER_LINK * cost) // 3
        self._saved_steps = min(self._saved_steps + LINKS_PER_ACTION, cost)
        if self.is_settled or self._saved_steps < cost:
            return
        self.discard_budget()
        self.settle(poses, links)

    def settle(self, poses: NDArray[np.float64], links: Links) -> None:
        """Move all experiences to the fixed point of relaxation, whatever the budget.

        Arguments as for ``step``.
        """
        if self.view_spacing_m > 0.0:
            self._settle_weighted(poses, links)
            return
        if self._plan is None or not self._plan_holds:
            self._plan = Relaxation(links.ends, len(poses))
            self._planning_work = self._plan.work
            self._plan_holds = True
        self._plan.relax(poses, links.ends, links.shapes)
        self.is_settled = True

    def _settle_weighted(self, poses: NDArray[np.float64], links: Links) -> None:
        """Relax with the present weights, then adapt those of the recognitions.

        This is one iteration of reweighted least squares; the next one follows at a later action.
        Recognitions that the map still contradicts after another iteration are deleted: routes
        must not use them.
        """
        recognised, shares, scale_m = links.recognised, links.shares, self.view_spacing_m
        weights = link_weights(links.shapes, recognised, shares, scale_m, self.noise.std)
        plan = Relaxation(links.ends, len(poses), weights)
        plan.relax(poses, links.ends, links.shapes, weights)
        self._planning_work = plan.work
        before = shares.copy()
        change = reweigh(poses, links.ends, links.shapes, recognised, shares, scale_m)
        self.is_settled = change < MAX_CHANGE
        false = np.flatnonzero(recognised & (np.maximum(before, shares) < FALSE_SHARE))
        if len(false) > 0:
            links.delete(false.tolist())

    def discard_budget(self) -> None:
        """Set the saved budget to zero."""
        self._saved_steps = 0

    def _restored(self, state: State) -> None:
        planned, self._plan_holds, self.is_settled, self._saved_steps = state['relaxation']
        if planned > 0 and self._plan_holds:
            self._plan = Relaxation(state['ends'][:planned], len(state['poses']))
        self.view_spacing_m = state.get('view_spacing_m', 0.0)
