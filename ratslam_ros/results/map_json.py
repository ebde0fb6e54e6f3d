# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reading of map.json."""

from __future__ import annotations

from pathlib import Path

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.errors import UnusableInput
from ratslam_ros.messages.json_schema import MalformedMessage
from ratslam_ros.messages.mapping import MapPayload, decode_map


def read_map_json(path: Path) -> tuple[MapPayload, ExperienceMap]:
    """Return the content of map.json, and the graph, see ``decode_map``.

    Raises:
        UnusableInput: the file cannot be read, or is no map.
    """
    try:
        return decode_map(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise UnusableInput(
            f'{path} cannot be read ({error.strerror}); give the folder that ratslam replay wrote'
        ) from None
    except MalformedMessage as error:
        reason = str(error).removeprefix(f'{MapPayload.TOPIC}: ')
    except UnicodeDecodeError:
        reason = 'it is no text'
    raise UnusableInput(
        f'{path} is not a map of ratslam_ros ({reason}); replay the recording again'
    )
