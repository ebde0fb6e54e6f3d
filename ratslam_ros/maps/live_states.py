# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The states that a live process saves: of its parts, and of its inputs and settings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from ratslam_ros.core.common.state import State
from ratslam_ros.maps.logged_items import encode_item
from ratslam_ros.pipeline.commands import SetMapping, SetPaused, UseOdometry
from ratslam_ros.pipeline.item_states import command_state
from ratslam_ros.pipeline.pipeline import Pipeline

Setting = SetMapping | SetPaused | UseOdometry
"""Commands that are in effect until the next one for the same stage."""


def live_states(
    pipeline: Pipeline, parts: Mapping[str, State], settings: Iterable[Setting]
) -> dict[str, State]:
    """Return the memories, and what a process that was interrupted needs besides.

    Args:
        pipeline: the pipeline.
        parts: the states of its parts, in the direction of flow.
        settings: the commands that are in effect.
    """
    states: dict[str, State] = {}
    for name, state in parts.items():
        own = [command_state(one) for one in settings if one.stage == name]
        states[name] = {**state, **({'settings': own} if own else {})}
    first = next(iter(states))
    states[first]['inputs'] = pipeline.inputs_state(
        lambda item: np.frombuffer(encode_item(item), np.uint8)
    )
    return states
