# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Freshness: select the item to forget when a memory has reached its limit.

The policy follows Kahn and Mazor (2002), section IV (docs/algorithm.md, "Forgetting"). A random
share of the items fades: such an item has a freshness that is 1 when it is observed and falls to 0
over a decay time. An item whose freshness is 0 may be removed, but only to make room at the limit.
Items that do not fade stay, so that regions not seen for long become sparse and recent ones stay
dense.

All items decay alike, so their order and the time at which they pass a threshold are the same for
every monotone decay: the threshold is 0, and the decay time is the only parameter.

The paper leaves open what happens if the limit is reached and no item may be removed. A new item
is where the robot is now, and refusing it would leave the robot without a map there. Therefore an
item is removed in any case:

1. Of the items whose freshness is 0, remove the one that was not observed for the longest time.
2. If there is none, remove one of the old items: those that do not fade and were not observed for
   a decay time. Of the old items with the fewest visits, choose one at random, which thins all old
   regions alike.
3. If there is no old item, or if the recent ones already fill more than half of the memory, remove
   the fading item that was not observed for the longest time. A decay time that is long compared
   to the limit therefore does not replace the map of old regions by that of the recent ones.
4. If nothing fades either, remove a random item. The one that was not observed for the longest
   time would be the worst choice on a route that is repeated and longer than the memory: it would
   always be the one that the robot is about to see again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.rows import KeyedRows
from ratslam_ros.core.common.saved import MAX_COUNT, Field, Saved, count
from ratslam_ros.core.common.state import State

REVISIT_SHARE = 0.1
"""An observation counts as another visit after an absence of this share of the decay time."""

ROBUST_VISITS_COUNT = 3
"""Number of visits, the creation included, after which an item does not fade any more: places on
frequent routes stay."""

_ITEM, _OBSERVED_NS, _VISITS, _FADES = range(4)
"""Columns of the table of items; fades is 0 or 1."""

_NS_PER_S = 1_000_000_000
_MAX_NS = 2**62
_MASK = 2**64 - 1


class Freshness(Saved):
    """Freshness, visits and last observation of items, which are named by integers.

    Time is measured by the stamps passed to ``advance``. It does not go back: after a jump back of
    the stamps it continues from where it was. Random draws depend on the seed and on the number of
    draws made before, which is part of the state.
    """

    SAVED = (
        count('draws', '_draws'), Field('now_ns', '_now_ns', int, low=0),
        Field('stamp_ns', '_stamp_ns', int), count('forced', 'forced'),
        Field('items', '', 'i8', ('items',), save=lambda own: own.items),
        Field('observed_ns', '', 'i8', ('items',), save=lambda own: own._column(_OBSERVED_NS)),
        Field('visits', '', 'i8', ('items',), 0, MAX_COUNT,
              save=lambda own: own._column(_VISITS)),
        Field('fades', '', 'u1', ('items',), 0, 1, save=lambda own: own._column(_FADES)),
    )

    def __init__(self, share: float, decay_s: float, seed: int = 0) -> None:
        """Create an empty memory.

        Args:
            share: probability that a new item fades, ``forget_share``: p_f of the paper.
            decay_s: time after the last observation at which the freshness reaches 0,
                ``forget_after_s``.
            seed: seed of the random draws.
        """
        self._share = share
        self._decay_ns = max(round(decay_s * _NS_PER_S), 1)
        self._revisit_ns = round(REVISIT_SHARE * self._decay_ns)
        self._seed = seed
        self._draws = 0
        self._now_ns = 0
        self._stamp_ns = 0
        self.forced = 0
        """Number of selections at which no faded item could be selected."""
        self._rows = KeyedRows(1, 4, np.int64)

    def __len__(self) -> int:
        return len(self._rows)

    def __contains__(self, item: int) -> bool:
        return (item,) in self._rows

    @property
    def items(self) -> NDArray[np.int64]:
        """(n,) all items, in the order of the arrays returned and expected; do not modify."""
        return self._column(_ITEM)

    def _column(self, column: int) -> NDArray[np.int64]:
        return self._rows.values[:, column]

    def advance(self, stamp_ns: int) -> None:
        """Advance the time to a stamp; it stands still before the first item and in jumps back."""
        if len(self):
            elapsed_ns = max(stamp_ns - self._stamp_ns, 0)
            self._now_ns = min(self._now_ns + elapsed_ns, _MAX_NS)
        self._stamp_ns = stamp_ns

    def add(self, item: int) -> None:
        """Add an item that is observed for the first time; it fades with the given probability."""
        self._rows.put((item,), (self._now_ns, 1, self._draw() < self._share))

    def observe(self, item: int) -> None:
        """Restore the freshness of an item, and count a visit if the item was absent before."""
        observed_ns, visits, fades = self._rows.get(item)
        visits += self._now_ns - observed_ns >= self._revisit_ns
        fades = fades and visits < ROBUST_VISITS_COUNT
        self._rows.put((item,), (self._now_ns, visits, fades))

    def remove(self, item: int) -> None:
        """Remove an item; the last one takes its place in the arrays."""
        self._rows.drop(item)

    def candidate(self, allowed: NDArray[np.bool_] | None = None) -> int | None:
        """Select the item to remove at the limit; the module describes the policy.

        Args:
            allowed: (n,) which of ``items`` may be selected; None: all.

        Returns:
            The item; None if no item is allowed.
        """
        n = len(self)
        selectable = np.ones(n, np.bool_) if allowed is None else allowed
        if not selectable.any():
            return None
        is_old = self._now_ns - self._column(_OBSERVED_NS) >= self._decay_ns
        fading = np.flatnonzero(selectable & (self._column(_FADES) != 0))
        faded = fading[is_old[fading]]
        if len(faded) > 0:
            return self._longest_unseen(faded)
        self.forced += 1
        old = np.flatnonzero(selectable & is_old)
        recent_count = n - np.count_nonzero(is_old)
        if len(old) > 0 and (len(fading) == 0 or 2 * recent_count <= n):
            visits = self._column(_VISITS)[old]
            return self._random(old[visits == visits.min()])
        if len(fading) > 0:
            return self._longest_unseen(fading)
        return self._random(np.flatnonzero(selectable))

    def _restored(self, state: State) -> None:
        columns = [state[name] for name in ('items', 'observed_ns', 'visits', 'fades')]
        self._rows.replace(np.column_stack(columns))

    def _longest_unseen(self, rows: NDArray[np.int64]) -> int:
        return int(self.items[rows[np.argmin(self._column(_OBSERVED_NS)[rows])]])

    def _random(self, rows: NDArray[np.int64]) -> int:
        return int(self.items[rows[int(self._draw() * len(rows))]])

    def _draw(self) -> float:
        """Return the next random number, from 0 to below 1: SplitMix64, Steele et al. (2014)."""
        self._draws += 1
        z = (self._seed + self._draws * 0x9E3779B97F4A7C15) & _MASK
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _MASK
        return ((z ^ (z >> 31)) >> 11) * 2.0**-53
