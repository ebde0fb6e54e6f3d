# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Saving and loading of a whole RatSLAM."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import stored_config, to_yaml
from ratslam_ros.maps import saving
from ratslam_ros.maps.reader import read_map
from ratslam_ros.maps.saved_map import Cut, MapMeta
from ratslam_ros.pipeline.ratslam import RatSLAM, head_of
from ratslam_ros.pipeline.stage import Stage
from ratslam_ros.version import __version__


def save_map(slam: RatSLAM, path: str | Path, config: Config, title: str = '') -> None:
    """Save everything that a RatSLAM has learned in a map file, which `load_map` opens.

    An earlier map with this name is replaced when the new one is complete.

    Args:
        slam: the system.
        path: the map file.
        config: its parameters, with which the map is opened again.
        title: name of the map; '' for that of the file.

    Raises:
        UnusableInput: the file is in use, is no map, or cannot be written.
    """
    path = Path(path)
    meta = MapMeta(title or path.stem, __version__, to_yaml(config))
    saving.save_map(path, slam.state(), meta, Cut(0, slam.newest_ns))


def load_map(
    path: str | Path, config: Config | None = None, stages: Sequence[type[Stage]] = ()
) -> RatSLAM:
    """Open a map as a RatSLAM that continues exactly where it was saved.

    Call its ``begin_session`` if the next inputs do not follow the last ones of the map.

    Args:
        path: the map file.
        config: the parameters; None for those in the map file.
        stages: the stages of your own with which it was saved, see ``RatSLAM``.

    Raises:
        UnusableInput: the map cannot be used, or does not fit the parameters.
        UnusableParameter: a parameter in the map is unknown or out of range.
    """
    saved = read_map(path)
    if config is None:
        if not saved.meta.configuration:
            raise UnusableInput(f'{path} contains no configuration; pass one as config')
        config, _ = stored_config(saved.meta.configuration, str(path))
    slam = RatSLAM(config, head_of(saved.states), stages=stages)
    slam.restore(saved.states)
    return slam
