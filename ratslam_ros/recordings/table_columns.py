# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of a table of images, found by their usual names with an optional unit."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ratslam_ros.errors import UnusableInput

EXAMPLE = 'time_s,file,speed_mps,yaw_rate_radps'


@dataclass(frozen=True)
class Quantity:
    """What a column may contain.

    names: usual names; the first that is found is used. units: their factors; the first is the
    unit of a column without one.
    """

    label: str
    names: tuple[str, ...]
    units: dict[str, float] = field(default_factory=dict, hash=False)

    def found_in(self, header: Sequence[str]) -> Column | None:
        """Return the column of this quantity, preferably one with the last unit."""
        plain = {_plain(name): name for name in header}
        for name in self.names:
            for unit in reversed(self.units):
                if f'{name}_{unit}' in plain:
                    return Column(plain[f'{name}_{unit}'], unit, self.units[unit])
            if name in plain:
                return Column(plain[name], *next(iter(self.units.items()), ('', 1.0)))
        return None

    def is_meant_in(self, header: Sequence[str]) -> bool:
        """Return whether a column has the name of this quantity, with any suffix."""
        starts = tuple(f'{name}_' for name in self.names if len(name) > 2)
        return self.found_in(header) is not None or any(
            f'{_plain(name)}_'.startswith(starts) for name in header
        )

    def __str__(self) -> str:
        units = f', with {", ".join(self.units)} as a suffix' if self.units else ''
        return f'{", ".join(self.names[:-1])} or {self.names[-1]}{units}'


@dataclass(frozen=True)
class Column:
    """A column of a table: its name in the header, its unit, and the factor to the first unit."""

    name: str
    unit: str
    factor: float


_SPEEDS = {'mps': 1.0, 'm_s': 1.0, 'kmph': 1.0 / 3.6, 'kmh': 1.0 / 3.6, 'km_h': 1.0 / 3.6}
_TURN_RATES = {'radps': 1.0, 'rad_s': 1.0} | dict.fromkeys(('degps', 'deg_s'), math.pi / 180.0)
IMAGE = Quantity('image', ('image', 'file', 'filename', 'path'))
TIME = Quantity(
    'time', ('stamp', 'timestamp', 'time', 't'), {'s': 10**9, 'ms': 10**6, 'us': 1000, 'ns': 1}
)
SPEED = Quantity('speed', ('linear_x', 'vx', 'speed', 'velocity', 'v'), _SPEEDS)
TURN_RATE = Quantity(
    'turn rate', ('angular_z', 'yaw_rate', 'yawrate', 'omega', 'wz', 'vth'), _TURN_RATES
)
SIDEWAYS = Quantity('speed to the left', ('linear_y', 'vy'), _SPEEDS)
MOTION = SPEED, TURN_RATE, SIDEWAYS


class Columns(dict[Quantity, Column]):
    """The columns of a table by their quantity, as far as they are found."""

    def __init__(self, path: Path, header: Sequence[str]) -> None:
        found = {quantity: quantity.found_in(header) for quantity in (TIME, IMAGE, *MOTION)}
        super().__init__({key: column for key, column in found.items() if column is not None})
        self._path, self._header = path, header
        self._has_motion = any(quantity.is_meant_in(header) for quantity in MOTION)

    @property
    def is_table(self) -> bool:
        """Whether the table has images and their times."""
        return IMAGE in self and TIME in self

    @property
    def is_nearly(self) -> bool:
        """Whether a column seems to be missing, rather than the file to be about other things."""
        return self._has_motion and (IMAGE in self or {TIME, SPEED, TURN_RATE} <= self.keys())

    def check(self) -> None:
        """Raise UnusableInput if a column is missing; odometry may be missing as a whole."""
        needed = [IMAGE, TIME, *([SPEED, TURN_RATE] if self._has_motion else [])]
        for quantity in needed:
            if quantity not in self:
                rest = '; rename the others if they are no odometry' if quantity in MOTION else ''
                raise UnusableInput(
                    f'{self._path} has the columns {", ".join(self._header) or "none"}, and none '
                    f'for the {quantity.label}: expected {quantity}, as in "{EXAMPLE}" with the '
                    f'row "0.05,0001.jpg,0.5,0.1"{rest}'
                )

    def __str__(self) -> str:
        parts = [
            f'{key.label} from {column.name}' + (f' ({column.unit})' if column.unit else '')
            for key, column in self.items()
        ]
        used = {column.name for column in self.values()}
        ignored = ', '.join(name for name in self._header if name not in used)
        return f'{self._path.name}: {", ".join(parts)}' + (
            f'; not used: {ignored}' if ignored else ''
        )


def _plain(name: str) -> str:
    """Return a name in lower case with single underscores: '#Timestamp [ns]' is timestamp_ns."""
    return re.sub('[^a-z0-9]+', '_', name.lower()).strip('_')
