# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recognition of places by sequences of views, if the light or the season has changed.

After Milford and Wyeth (2012), SeqSLAM: in other light all templates differ much from a view, but
over several views the right ones differ least. See docs/algorithm.md, "Sequences of views".
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.saved import Field, Saved, count
from ratslam_ros.core.common.state import State
from ratslam_ros.core.vision.encoder import Layout, View
from ratslam_ros.core.vision.template_memory import TemplateMemory

SEQUENCE_LENGTH = 10
"""Number of views of a sequence."""

MEMORY_VIEWS = 4 * SEQUENCE_LENGTH
"""Time constant of the mean similarity of each template, in views: longer than the passage of a
place, and short enough to follow a change of light."""

FALSE_MATCH_RATE = 0.01
"""Probability with which a sequence that shows no template may be recognised."""

Ids = NDArray[np.int64]


class SequenceMatch(NamedTuple):
    """The template that fits the sequence best."""

    template_id: int
    false_match_rate: float
    """Probability of such a margin to the best template elsewhere, if no template is right."""


class SequenceMatcher(Saved):
    """Comparison of the last views with the templates, in the order in which both were seen."""

    SAVED = (
        Field('latest', '', 'u1', ('', '', ''), save=lambda own: own._latest.views()),
        count('count', '_count'), Field('ids', '_ids', 'i8', ('candidates',), 0, is_fixed=True),
        Field('rows', '_rows', 'f2', ('', 'candidates'), is_fixed=True),
        Field('means', '_means', 'f4', (2, 'candidates')), count('unrecognised', 'unrecognised'),
        Field('found', 'found', int, (), -1, save=lambda found: -1 if found is None else found,
              load=lambda found: None if found < 0 else found),
        count('first_id', 'first_id'),
    )

    def __init__(self, layout: Layout, length: int = SEQUENCE_LENGTH) -> None:
        """Begin without views; ``length`` is the number of views of a sequence."""
        self._layout, self._length = layout, length
        self.clear()

    def clear(self, next_id: int = 0) -> None:
        """Begin a new sequence, when ``next_id`` will be the id of the next template."""
        self.first_id = next_id
        """Id from which on templates are learned during the sequence."""
        self._latest = TemplateMemory(self._layout)
        self._count = 0
        self.unrecognised = 0
        """Number of views since the last one that was recognised without a sequence."""
        self._ids: Ids = np.empty(0, np.int64)
        self._rows = np.empty((0, 0), np.float16)
        self._means = np.empty((2, 0), np.float32)
        """Decaying sums of the similarities and of their number, of each template."""
        self.found: int | None = None
        """Template that the latest view is recognised as."""

    def is_due(self, view: View, limit: int) -> bool:
        """Return whether the SAD of a view to the latest one of the sequence exceeds a limit.

        With the limit for the newest templates, views are spaced like templates, and a robot that
        stands still adds none.
        """
        return self._count == 0 or self._latest.search(view).sad(self._count - 1) > limit

    def add(self, view: View, ids: Ids, sads: Ids | None) -> None:
        """Continue the sequence.

        Args:
            view: the next view.
            ids: (n,) ids of the candidates, in ascending order, which is that of learning.
            sads: (n,) their SADs to the view; None if the view shall count for nothing.
        """
        if self._count:
            self._latest.remove(self._count - 1)
        self._latest.append(view, self._count)
        self._count += 1
        self.unrecognised += 1
        kept = np.isin(self._ids, ids, assume_unique=True)
        more = len(ids) - int(kept.sum())
        rows = np.pad(self._rows[:, kept], ((0, 0), (0, more)))
        row = np.zeros(len(ids), np.float16)
        self._means = np.pad(self._means[:, kept], ((0, 0), (0, more)))
        if sads is not None:
            row = ((sads.mean() - sads) / max(float(sads.std()), 1.0)).astype(np.float16)
            self._means *= 1.0 - 1.0 / MEMORY_VIEWS
            self._means += row, np.ones(len(ids))
        self._rows = np.vstack([rows, row])[-self._length :]
        self._ids, self.found = ids, None

    def best(self) -> SequenceMatch | None:
        """Return the best of the latest candidates; None if there are none."""
        if len(self._ids) == 0:
            return None
        # Some templates are similar to all views. Their means begin with some views of zero.
        sums, counts = self._means
        excess = self._rows - sums / (counts + SEQUENCE_LENGTH)
        excess[~self._rows.any(axis=1)] = 0.0
        scores = np.zeros(len(self._ids))
        for lag, row in enumerate(excess[::-1]):
            scores[lag:] += row[: max(len(row) - lag, 0)]
        terms = np.minimum(np.arange(1, len(scores) + 1), len(excess))
        scores /= np.sqrt(terms)
        best = int(scores.argmax())
        elsewhere = scores[np.abs(np.arange(len(scores)) - best) > (self._length + 1) // 2]
        # Of n independent normal values, the largest exceeds the second by an exponentially
        # distributed margin. Templates closer than a sequence are not independent.
        places = len(elsewhere) / self._length
        deviation, rate = float(elsewhere.std()) if places > 1.0 else 0.0, 1.0
        if deviation > 0.0:
            margin = float(scores[best] - elsewhere.max()) / deviation
            rate = math.exp(-margin * math.sqrt(2.0 * math.log(places)))
        return SequenceMatch(int(self._ids[best]), rate)

    def match(self, trials: int = 1) -> int | None:
        """Return the template that the sequence is recognised as, if it is complete.

        A complete sequence has the full length, and more than half of its views count.

        Args:
            trials: number of views that have the false match rate together.
        """
        is_full = self._count >= self._length
        best = self.best() if is_full and 2 * self._rows.any(axis=1).sum() > self._length else None
        is_match = best and best.false_match_rate * trials <= FALSE_MATCH_RATE
        return best.template_id if best and is_match else None

    def _restored(self, state: State) -> None:
        for view in state['latest'].reshape(-1, self._layout.height, self._layout.width):
            self._latest.append(view, self._count - 1)
