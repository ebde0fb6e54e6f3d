# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A short run in memory, controls that record what they are asked for, and a plain scene."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.map_changes import ExperienceRows, LinkRows, MapChange
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.history.records import CellsRecord, MatchRecord, PoseRecord, Record, ViewRecord
from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.viewer.run_source import Answer

BEGIN_NS = 100 * NS_PER_S
STEP_NS = NS_PER_S // 2


def view_at(number: int, loop: int = 20) -> ViewRecord:
    """Return the view of a step: a robot that drives the same loop again and again."""
    known, here = number >= loop, number % loop
    before = (number - 1) % loop if number else -1
    action = 'create' if not known else 'link' if number == loop else 'set'
    reason = 'moves the robot by 4.0 m' if number == loop + 3 else ''
    return ViewRecord(
        BEGIN_NS + number * STEP_NS, here, not known, 0.01 + 0.001 * here, 0.03, 0.1,
        'none' if reason else action, before, here, Place(here, 2.0, 3.0),
        here if known else -1, 1.0 if known else 0.0, reason,
    )


def records_of(number: int, loop: int = 20) -> list[Record]:
    """Return the records of a step; all have the same stamp."""
    view = view_at(number, loop)
    stamp_ns, here = view.stamp_ns, number % loop
    angle = 2 * np.pi * here / loop
    pose = Pose(3 * float(np.cos(angle)), 3 * float(np.sin(angle)), float(angle))
    cells = np.array([[here, 2, 3], [here, 3, 3]])
    picture = np.full((4, 12), here % 256, np.uint8)
    return [
        view,
        MapChange(
            stamp_ns, min(number + 1, loop), here,
            experiences=ExperienceRows(
                np.array([here]), np.array([here]), np.array([pose]), np.array([0])
            ),
            links=LinkRows(
                np.array([[view.source_id, here]]), np.array([[0.9, 0.0, 0.0]]), np.array([0.5]),
                np.array([0.9]), np.array([number // loop + 1]),
                np.array([view.action == 'link']), ('forward',),
            ) if number else LinkRows(),
        ),
        PoseRecord(stamp_ns, pose),
        CellsRecord(
            stamp_ns, (20, 20, 36), cells, np.array([0.6, 0.2], np.float32),
            np.array([[here, 2.5, 3.0, 0.8]], np.float32),
            np.array([[here, 2.0, 3.0, 0.1]], np.float32),
        ),
        MatchRecord(stamp_ns, here, picture, picture, 2),
    ]


class FakeRun:
    """A run of as many steps as have been added."""

    def __init__(self, steps: int = 0, is_growing: bool = False) -> None:
        self.title = 'test run'
        self.is_growing = is_growing
        self.notices: Sequence[str] = ()
        self.required_views: float | None = 5.0
        self.stamps: list[int] = []
        self.records: list[list[Record]] = []
        self.seeks = 0
        self.grow(steps)

    def grow(self, steps: int) -> None:
        for number in range(len(self.stamps), len(self.stamps) + steps):
            self.records.append(records_of(number))
            self.stamps.append(view_at(number).stamp_ns)

    @property
    def begin_ns(self) -> int:
        return self.stamps[0] if self.stamps else 0

    @property
    def end_ns(self) -> int:
        return self.stamps[-1] if self.stamps else 0

    def seek(self, stamp_ns: int) -> RunState:
        self.seeks += 1
        state = RunState()
        self.advance(state, stamp_ns)
        return state

    def advance(self, state: RunState, stamp_ns: int) -> None:
        first = bisect_right(self.stamps, state.stamp_ns)
        for records in self.records[first : bisect_right(self.stamps, stamp_ns)]:
            for record in records:
                state.apply(record)
        # Few, unlike those of a robot that is recognised at another place in each view.
        state.closures = [
            view for view in self.views(stamp_ns) if view.action == 'link' or view.reason
        ]

    def image_at(self, stamp_ns: int) -> bytes | None:
        return b'jpeg %d' % stamp_ns if self.stamps else None

    def views(self, until_ns: int) -> list[ViewRecord]:
        count = bisect_right(self.stamps, until_ns)
        return [record for record, *_ in self.records[:count] if isinstance(record, ViewRecord)]

    def step(self, stamp_ns: int, views: int) -> int:
        if not self.stamps:
            return stamp_ns
        place = bisect_right(self.stamps, stamp_ns) - 1 + views
        return self.stamps[min(max(place, 0), len(self.stamps) - 1)]

    def visits(self, experience_id: int, until_ns: int) -> list[ViewRecord]:
        return [
            view for view in self.views(until_ns)
            if view.target_id == experience_id and not view.reason
        ]


@dataclass(frozen=True)
class FakePick:
    """What was clicked."""

    kind: str
    id: int = -1
    ends: tuple[int, int] = (-1, -1)
    point: tuple[float, float] = (0.0, 0.0)


class FakeScene:
    """A scene that draws nothing."""

    layers = ('map', 'trail', 'pose cells')

    def __init__(self) -> None:
        self.colouring, self.dark, self.detail = 'age', False, ''
        self.limit = 4000
        self.background = 20, 20, 20
        self.shown = dict.fromkeys(self.layers, True)
        self.selected: object = None
        self.looks = 0
        self.next_pick: FakePick | None = None

    def show(self, layer: str, on: bool) -> None:
        self.shown[layer] = on

    def pick(self, origin: object, direction: object, state: RunState) -> FakePick | None:
        return self.next_pick

    def select(self, pick: object) -> None:
        self.selected = pick

    def look_at_all(self) -> None:
        self.looks = self.looks + 1

    def legend(self) -> list[tuple[tuple[int, int, int], str]]:
        return [((0, 114, 178), f'{self.colouring}: oldest'), ((230, 159, 0), 'newest')]


class FakeControls:
    """Controls that record the requests, and succeed unless they are told a refusal."""

    def __init__(self, *actions: str, refusal: str = '') -> None:
        self.actions = {name: getattr(self, name) for name in actions}
        self.refusal = refusal
        self.accepts: Callable[[dict[str, object]], bool] = lambda values: True
        self.calls: list[tuple[object, ...]] = []
        self.diagnostics = {'local_view': ('OK', '10.0 Hz'), 'pose_cells': ('ERROR', 'no <odom>')}
        self.places: Sequence[str] = ('kitchen',)
        self.switches: dict[str, bool] = {}
        self.parameters: dict[str, object] = {
            f'{section}.{name}': value
            for section, values in Config().values().items()
            if section in ('local_view', 'experience_map')
            for name, value in values.items()
        }

    def __getattr__(self, name: str) -> object:
        if name == 'reason':
            raise AttributeError(name)

        def call(*values: object) -> Answer:
            self.calls.append((name, *values))
            return Answer(not self.refusal, self.refusal or f'{name} done')

        return call

    def set_parameter(self, name: str, value: object) -> Answer:
        self.calls.append(('set_parameter', name, value))
        if not self.accepts({**self.parameters, name: value}):
            return Answer(False, 'not valid')
        if not self.refusal:
            self.parameters[name] = value
        return Answer(not self.refusal, self.refusal or f'{name} is {value}')
