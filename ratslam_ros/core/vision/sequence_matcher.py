# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recognition of a place by a sequence of views, if the light or the season has changed.

After Milford and Wyeth (2012), SeqSLAM. A change of light makes all differences large, those of
the right template as well, but over several views the right ones remain the smallest on average.
See docs/algorithm.md, "Sequences of views".
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.state import State
from ratslam_ros.core.vision.encoder import Layout, View
from ratslam_ros.core.vision.template_memory import TemplateMemory

SEQUENCE_LENGTH = 10
"""Number of views of a sequence."""

FALSE_MATCH_RATE = 0.001
"""Probability with which a sequence that shows none of the templates may be recognised."""

Ids = NDArray[np.int64]


class SequenceMatch(NamedTuple):
    """The template that fits the sequence best."""

    template_id: int
    false_match_rate: float
    """Probability of such a margin to the best template elsewhere, if no template is right."""


class SequenceMatcher:
    """Comparison of the last views with the templates, in the order in which both were seen."""

    def __init__(self, layout: Layout, length: int = SEQUENCE_LENGTH) -> None:
        """Begin without views.

        Args:
            layout: layout of the views.
            length: number of views of a sequence.
        """
        self._layout, self._length = layout, length
        self.clear()

    def __len__(self) -> int:
        """Return the number of views since the sequence began."""
        return self._count

    def clear(self) -> None:
        """Begin a new sequence."""
        self._latest = TemplateMemory(self._layout)
        self._count = 0
        self.unrecognised = 0
        """Number of views since the last one that was recognised by itself."""
        self._ids: Ids = np.empty(0, np.int64)
        self._rows = np.empty((0, 0), np.float16)
        self._sums = np.empty(0, np.float32)
        self.found: int | None = None
        """Template that the latest view was recognised as."""

    def is_due(self, view: View, limit: int) -> bool:
        """Return whether a view differs from the latest one of the sequence.

        A robot that stands still thus adds no views. With the limit of the newest templates,
        views are spaced like templates.

        Args:
            view: the view.
            limit: largest SAD to the latest view that is no difference.
        """
        return self._count == 0 or self._latest.search(view).sad(self._count - 1) > limit

    def add(self, view: View, ids: Ids, sads: Ids | None) -> None:
        """Continue the sequence.

        Args:
            view: the next view.
            ids: (n,) ids of the templates, in ascending order, which is that of learning.
            sads: (n,) their SADs to the view; None if the view shall count for nothing.
        """
        if self._count:
            self._latest.remove(self._count - 1)
        self._latest.append(view, self._count)
        self._count += 1
        self.unrecognised += 1
        kept = np.isin(self._ids, ids)
        more = len(ids) - int(kept.sum())
        similarity = np.zeros(len(ids))
        if sads is not None:
            similarity = (sads.mean() - sads) / max(float(sads.std()), 1.0)
        rows = np.pad(self._rows[:, kept], ((0, 0), (0, more)))
        self._rows = np.vstack([rows, similarity.astype(np.float16)])[-self._length :]
        self._sums = np.pad(self._sums[kept], (0, more)) + self._rows[-1]
        self._ids, self.found = ids, None

    def best(self, count: int) -> SequenceMatch | None:
        """Return the best of the oldest ``count`` templates; None if there are none."""
        # Some templates are similar to everything, more so in other light. The mean similarity to
        # the views is subtracted, as if it had been zero for one sequence before.
        excess = self._rows - self._sums / (self._count + self._length)
        sums = np.zeros(len(self._ids))
        for lag, row in enumerate(excess[::-1]):
            sums[lag:] += row[: len(row) - lag]
        terms = np.minimum(np.arange(1, len(self._ids) + 1), len(excess))
        scores = (sums / np.sqrt(terms))[: max(count, 0)]
        if len(scores) == 0:
            return None
        best = int(scores.argmax())
        elsewhere = scores[np.abs(np.arange(len(scores)) - best) > (self._length + 1) // 2]
        # Of n independent normal values, the largest exceeds the second by an exponentially
        # distributed margin. Templates closer than a sequence are not independent.
        places = len(elsewhere) / self._length
        scale = float(elsewhere.std()) / math.sqrt(2.0 * math.log(places)) if places > 1.0 else 0.0
        if scale == 0.0:
            return SequenceMatch(int(self._ids[best]), 1.0)
        margin = float(scores[best] - elsewhere.max())
        return SequenceMatch(int(self._ids[best]), math.exp(-margin / scale))

    def match(self, count: int, trials: int = 1) -> int | None:
        """Return the template that the sequence is recognised as, if it is complete.

        A complete sequence has the full length, and more than half of its views count.

        Args:
            count: number of oldest templates that are candidates.
            trials: number of views that together may be recognised falsely with the probability
                of ``FALSE_MATCH_RATE``.
        """
        is_complete = 2 * np.count_nonzero(self._rows.any(axis=1)) > self._length
        best = self.best(count) if is_complete and self._count >= self._length else None
        if best is None or best.false_match_rate * trials > FALSE_MATCH_RATE:
            return None
        return best.template_id

    def state(self) -> State:
        """Return the sequence, for ``restore``."""
        return {
            'latest': self._latest.views()[0].copy(), 'count': self._count,
            'unrecognised': self.unrecognised, 'ids': self._ids, 'rows': self._rows,
            'sums': self._sums, 'found': -1 if self.found is None else self.found,
        }  # fmt: skip

    def restore(self, state: State) -> None:
        """Restore what ``state`` returned."""
        self.clear()
        self._count, self.unrecognised = int(state['count']), int(state['unrecognised'])
        self._latest.append(state['latest'], self._count - 1)
        self._ids, self._rows, self._sums = state['ids'], state['rows'], state['sums']
        self.found = None if state['found'] < 0 else int(state['found'])
