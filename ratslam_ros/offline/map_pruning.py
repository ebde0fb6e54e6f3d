# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Implementation of ``ratslam map prune``."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ratslam_ros.core.merging.pruned_map import pruned_states
from ratslam_ros.core.merging.session import Session, SessionMap
from ratslam_ros.descriptors import encoder_of
from ratslam_ros.maps import read_map
from ratslam_ros.maps.saving import locked, replace_map
from ratslam_ros.maps.sessions import TRANSIENT
from ratslam_ros.offline.map_upkeep import config_of_map, make_backup


def prune(path: Path, count: int) -> str:
    """Reduce a map to a number of places; return what has been done.

    The map before stays as FILE.bak. At any moment there is a complete map under its name.

    Args:
        path: the map file.
        count: largest number of places.

    Raises:
        UnusableInput: the map is in use, damaged or incomplete, or cannot be pruned so far.
    """
    with locked(path):
        saved = read_map(path, owned=True)
        session = SessionMap(
            Session(path.name, config_of_map(saved)[0], saved.states), encoder_of
        )
        before = len(session)
        if before <= count:
            return f'{path}: {before} places, no more than {count}: nothing is pruned'
        others = {part: state for part, state in saved.states.items() if part not in TRANSIENT}
        states = {**others, **pruned_states(session, count)}
        backup = make_backup(path)
        title = f'{saved.meta.title}, pruned' if saved.meta.title else 'pruned'
        meta = dataclasses.replace(saved.meta, title=title, recording='', recording_bytes=0)
        replace_map(path, states, meta, saved.cut)
    after = len(states['experience_map']['core']['labels'])
    return f'{path}: {before} places before, {after} now; the map before is {backup}'
