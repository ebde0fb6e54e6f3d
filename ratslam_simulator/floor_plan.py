# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Floor plans: grids of wall and free cells with named places, read from text or PNG files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.errors import UnusableInput
from ratslam_ros.images import EncodedImage, UndecodableImage
from ratslam_ros.limits import MAX_MESSAGE_BYTES, read_limited

# Two loops that share the left half. Corridors are three cells wide, so that a place in the middle
# row lies on the centre line. Alcoves, a lobby and its pillars distinguish the corridors.
OFFICE = """
###########################
#.........................#
#.D..........F..........C.#
#.........................#
#...##...###...########...#
#...##...###...########...#
#...########...#####......#
#...########...#####.#....#
#...########....####......#
#...########....####.#....#
#...########...###...##...#
#...########...###...##...#
#.........................#
#.A..........E..........B.#
#.........................#
###########################
"""
OFFICE_CELL_M = 0.7
"""Side of a cell of the office."""

WALL, FREE = '#', '. '
"""Characters of wall and of free cells."""

FREE_MIN_GREY = 128
"""Grey level, 0 to 255, from which on a pixel of a picture is free."""

MAX_CELLS = 2**22
"""Largest accepted number of cells: 100 m x 100 m with cells of 5 cm."""

MAX_TEXT_BYTES = 4 * MAX_CELLS

MIN_CELL_M, MAX_CELL_M = 0.001, 1000.0
"""Smallest and largest accepted side of a cell: finer than a laser measures, and a district."""

_PLANS = files('ratslam_simulator') / 'plans'


@dataclass(frozen=True)
class FloorPlan:
    """A grid of wall and free cells with named places.

    solid: (n_y, n_x) bool, True for wall; row 0 is the southernmost
    cell_m: side of a cell
    places: name -> (x_m, y_m); in a text, the centre of the cell with the letter
    """

    solid: NDArray[np.bool_]
    cell_m: float
    places: dict[str, tuple[float, float]]
    name: str = ''

    @property
    def size_m(self) -> tuple[float, float]:
        """Width along x and depth along y, in metres."""
        n_y, n_x = self.solid.shape
        return n_x * self.cell_m, n_y * self.cell_m

    def is_solid(self, x_m: float, y_m: float) -> bool:
        """Return whether a point within the plan is in a wall cell."""
        return bool(self.solid[int(y_m / self.cell_m), int(x_m / self.cell_m)])


def parse_floor_plan(text: str, cell_m: float | None = None, name: str = '') -> FloorPlan:
    """Parse a plan drawn with `#` for wall, `.` or space for free and letters for named places.

    Header lines such as `cell_m: 0.25` and `name: a house` may come first. The first line of the
    drawing is the north side. The outer cells must be wall, so that no ray leaves the plan.

    Args:
        text: the plan.
        cell_m: side of a cell if the text does not give it.
        name: name of the plan if the text does not give it.

    Raises:
        UnusableInput: the text is no floor plan; the message names the line.
    """
    lines = [line.rstrip() for line in text.splitlines()]
    first = 0
    while first < len(lines) and not lines[first].startswith(WALL):
        key, colon, value = lines[first].partition(':')
        if key.strip() == 'cell_m' and colon:
            cell_m = _length(value, first + 1)
        elif key.strip() == 'name' and colon:
            name = value.strip()
        elif lines[first]:
            raise UnusableInput(
                f'line {first + 1} of a floor plan is {lines[first]!r}: expected '
                '"cell_m: METRES", "name: TEXT" or the first line of the drawing, which is all #'
            )
        first += 1
    while lines and not lines[-1]:
        lines.pop()
    drawing = lines[first:]
    if cell_m is None:
        raise UnusableInput('a floor plan must give the side of a cell: begin with "cell_m: 0.25"')
    if len(drawing) < 3 or len(drawing[0]) < 3:
        raise UnusableInput('a floor plan needs a drawing: at least 3 lines of 3 characters')
    places: dict[str, tuple[float, float]] = {}
    for index, line in enumerate(drawing):
        number = first + index + 1
        if len(line) != len(drawing[0]):
            raise UnusableInput(
                f'the lines of a floor plan must be equally long: line {number} has {len(line)} '
                f'characters, line {first + 1} has {len(drawing[0])}'
            )
        for column, character in enumerate(line):
            if character.isalpha():
                if character in places:
                    raise UnusableInput(
                        f'line {number} of a floor plan names place {character!r}, which is named '
                        'before: choose another letter'
                    )
                places[character] = (
                    (column + 0.5) * cell_m,
                    (len(drawing) - index - 0.5) * cell_m,
                )
            elif character not in (WALL, *FREE):
                raise UnusableInput(
                    f'line {number} of a floor plan has {character!r}: draw walls with #, free '
                    'floor with . or space, named places with letters'
                )
    # From the south, row by row: random draws of places depend on their order.
    places = dict(sorted(places.items(), key=lambda item: item[1][::-1]))
    grid = np.array([list(line) for line in reversed(drawing)])
    return _require_closed(FloorPlan(grid == WALL, cell_m, places, name))


def load_floor_plan(
    plan: str | Path,
    cell_m: float | None = None,
    places: Mapping[str, tuple[float, float]] | None = None,
) -> FloorPlan:
    """Load a shipped plan by its name, or a plan from a text file or a PNG picture.

    Dark pixels of a picture are wall, light ones free.

    Args:
        plan: name of a shipped plan, or path of a file.
        cell_m: side of a pixel of a picture, or of a cell if a text does not give it.
        places: name -> (x_m, y_m) of places in addition to those in a text; (0, 0) is the lower
            left corner.

    Raises:
        UnusableInput: there is no such plan, it is malformed, or a place is not on free floor.
    """
    path = Path(plan)
    if path.suffix.lower() == '.png':
        loaded = _from_picture(path, cell_m)
    elif str(plan) == 'office':
        loaded = office()
    elif str(plan) in shipped_plans():
        loaded = parse_floor_plan((_PLANS / f'{plan}.txt').read_text('utf-8'))
    else:
        try:
            text = read_limited(path, MAX_TEXT_BYTES, 'a floor plan').decode()
        except (OSError, UnicodeDecodeError) as error:
            raise UnusableInput(
                f'cannot read the floor plan {str(plan)!r} ({error}): give a text file, a .png or '
                f'one of {", ".join(shipped_plans())}'
            ) from None
        try:
            loaded = parse_floor_plan(text, cell_m, path.stem)
        except UnusableInput as error:
            raise UnusableInput(f'{path}: {error}') from None
    if places:
        loaded = replace(loaded, places={**loaded.places, **places})
    for name, (x_m, y_m) in loaded.places.items():
        width_m, depth_m = loaded.size_m
        if not (0.0 < x_m < width_m and 0.0 < y_m < depth_m) or loaded.is_solid(x_m, y_m):
            raise UnusableInput(
                f'{plan}: place {name!r} at ({x_m:g}, {y_m:g}) is not on the free floor, which '
                f'is within {width_m:g} x {depth_m:g} m'
            )
    return loaded


def shipped_plans() -> list[str]:
    """Return the names of the plans in this package, sorted."""
    files = [path.name for path in _PLANS.iterdir()]
    return sorted(['office', *(name[:-4] for name in files if name.endswith('.txt'))])


def office() -> FloorPlan:
    """Return the built-in office floor."""
    return parse_floor_plan(OFFICE, OFFICE_CELL_M, 'office')


def _from_picture(path: Path, cell_m: float | None) -> FloorPlan:
    if cell_m is None:
        raise UnusableInput(f'{path}: give the side of a pixel of the picture in metres (cell_m)')
    _require_length(cell_m, 'metres for each pixel')
    try:
        picture = EncodedImage(read_limited(path, MAX_MESSAGE_BYTES, 'a picture')).grey()
    except (OSError, UndecodableImage) as error:
        raise UnusableInput(
            f'cannot read {path} as a picture ({error}): give a PNG file'
        ) from None
    return _require_closed(FloorPlan(picture[::-1] < FREE_MIN_GREY, cell_m, {}, path.stem))


def _require_closed(plan: FloorPlan) -> FloorPlan:
    solid = plan.solid
    if solid.size > MAX_CELLS:
        raise UnusableInput(
            f'a floor plan has {solid.shape[1]} x {solid.shape[0]} cells; expected at most '
            f'{MAX_CELLS} cells: draw it with larger ones'
        )
    if not (solid[0].all() and solid[-1].all() and solid[:, 0].all() and solid[:, -1].all()):
        raise UnusableInput(
            'a floor plan must be closed: draw # (in a picture: dark pixels) all around its edge'
        )
    return plan


def _length(value: str, line: int) -> float:
    try:
        length_m = float(value)
    except ValueError:
        length_m = math.nan
    _require_length(length_m, f'cell_m in line {line} of a floor plan', value.strip())
    return length_m


def _require_length(length_m: float, what: str, seen: str | None = None) -> None:
    if not MIN_CELL_M <= length_m <= MAX_CELL_M:
        raise UnusableInput(
            f'{what} must be a positive number of metres, {MIN_CELL_M:g} to {MAX_CELL_M:g}, not '
            f'{(seen or str(length_m))[:40]}'
        )
