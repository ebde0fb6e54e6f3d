# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes with stages of the user."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ratslam_ros.errors import UnusableParameter
from ratslam_ros.own_stages import own_stages
from ratslam_ros.pipeline.choice import NAMES
from ratslam_ros.pipeline.live_stages import LiveTemplates
from ratslam_ros.pipeline.stage import Stage
from ratslam_ros.ros.local_view_node import LocalViewNode
from ratslam_ros.ros.node import RatslamNode


def node_of(stage: type[Stage]) -> type[RatslamNode]:
    """Return the class of a node with a stage of the user.

    Raises:
        UnusableParameter: it has the name of a stage that does more than to write templates.
    """
    if stage.NAME in NAMES and stage.NAME != LocalViewNode.SECTION:
        raise UnusableParameter(
            f'the stage {stage.__name__} takes the place of {stage.NAME} only offline; live, '
            'write a node of your own, and choose the others by --stages'
        )
    name = f'{stage.__name__}Node'
    if stage.NAME == LocalViewNode.SECTION:
        return type(name, (LocalViewNode,), {
            'new_stage': lambda self, config: LiveTemplates(stage(config)),
        })
    return type(name, (RatslamNode,), {
        'SECTION': stage.NAME, 'MAPS': True, 'new_stage': lambda self, config: stage(config),
        'warm_up': lambda: None,
    })


def with_own(
    kinds: Iterable[type[RatslamNode]], names: Sequence[str]
) -> list[type[RatslamNode]]:
    """Return the classes of nodes, with stages of the user in place of some or at the end.

    Args:
        kinds: the classes.
        names: the stages, see ``own_stages``.
    """
    own = {stage.NAME: node_of(stage) for stage in own_stages(names)}
    return [*(own.pop(kind.SECTION, kind) for kind in kinds), *own.values()]
