# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plot of a map that was merged of several sessions."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ratslam_ros.core.merging.merge import MergedMap
from ratslam_ros.results.plots import (
    BLACK,
    BLUE,
    GREEN,
    PALE_GREY,
    SEPARATE,
    VERMILLION,
    add_legend_below,
    equal_axes,
    new_figure,
    save_figure,
)

COLOURS = (BLUE, VERMILLION, GREEN, *SEPARATE)
"""Colours of the sessions, in turn."""


def draw_merged(merged: MergedMap, path: Path) -> Path:
    """Draw the experiences in the colour of their session; those of several ones are ringed.

    Raises:
        UnusableInput: the file cannot be written.
    """
    from matplotlib.collections import LineCollection

    core = merged.states['experience_map']['core']
    at = core['poses'][:, :2]
    owners = np.zeros((len(at), len(merged.names)), np.bool_)
    for session, ids in enumerate(merged.experience_ids):
        owners[ids, session] = True
    figure = new_figure(8.0, 7.6)
    axes = figure.add_subplot()
    axes.add_collection(
        LineCollection(list(at[core['ends']]), colors=PALE_GREY, linewidths=0.8, zorder=1)
    )
    is_shared = owners.sum(axis=1) > 1
    axes.scatter(
        at[is_shared, 0], at[is_shared, 1], s=16.0, facecolors='none', edgecolors=BLACK,
        linewidths=0.4, zorder=3, label=f'in several sessions: {int(is_shared.sum())}',
    )
    first = owners.argmax(axis=1)
    for session, name in enumerate(merged.names):
        own = first == session
        axes.scatter(
            at[own, 0], at[own, 1], s=7.0, color=COLOURS[session % len(COLOURS)], linewidths=0.0,
            label=f'{name}: {int(owners[:, session].sum())}, {int(own.sum())} of them new',
            zorder=2,
        )
    axes.set_title('merged map: experiences by the session that contributed them')
    equal_axes(axes)
    add_legend_below(figure, axes, columns=2)
    return save_figure(figure, path)
