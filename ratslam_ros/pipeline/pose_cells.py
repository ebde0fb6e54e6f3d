# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stage pose_cells: odometry and templates to actions on the map."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from ratslam_ros.core.common.odometry import Motion, MotionFromOdometry, Odometry
from ratslam_ros.core.common.saved import Field, Saved, count
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config, additions
from ratslam_ros.core.goal_memory.goal_memory import GoalMemory
from ratslam_ros.core.mapping.id_map import MIN_MEMORY_NS, NO_MEMORY_NS
from ratslam_ros.core.pose_cells.map_relocation import ADOPTION_DELAY, MapRelocations
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.pipeline.commands import (
    BlockWay,
    Command,
    Configure,
    MarkGoal,
    NewSession,
    Relocated,
    Reset,
    SetMapping,
)
from ratslam_ros.pipeline.items import Answer, NumberedAction
from ratslam_ros.pipeline.stage import OF_HOST, Output, Reader

UNKNOWN_MOTION = Motion(0.0, 0.0, 0.0, False)
"""Motion after which the robot may be anywhere."""


def ignore(stamp_ns: int) -> None:
    """Do nothing."""


class PoseCellsStage(Saved):
    """Tracks the robot in the pose cells, and in the goal memory if it is switched on."""

    SAVED: ClassVar[tuple[Field, ...]] = (
        Field('core', 'core', PoseCells),
        Field('motion', 'motion', MotionFromOdometry, of_session=True, optional=True),
        Field('relocations', '_relocations', MapRelocations, of_session=True, optional=True),
        count('sequence', 'number', of_session=True),
        Field('memory_ns', 'memory_ns', int, of_session=True, optional=True),
        Field('goal_memory', 'goal_memory', GoalMemory, optional=True),
        # Of ``LivePoseCells``.
        Field('numbering', '', dict, of_session=True, optional=True), *OF_HOST,
    )

    NAME: ClassVar[str] = 'pose_cells'
    WRITES: ClassVar[tuple[str, ...]] = ('action',)

    def __init__(self, config: Config) -> None:
        self._created_with = self._config = config
        self._mapping, self._is_answered = True, False
        self.on_moved: Callable[[int], None] = ignore
        """Called with the stamp of each odometry message that has moved the activity."""
        self._begin()

    def _begin(self) -> None:
        p, inputs = self._created_with.pose_cells, self._created_with.inputs
        self.core = PoseCells(p, inputs, self._created_with.memory)
        self.core.reconfigure(self._config.pose_cells)
        self.core.mapping = self._mapping
        self.goal_memory: GoalMemory | None = None
        if self._config.goal_memory.goal_memory:
            chosen = additions.GOAL_ROUTES.instead_of(GoalMemory, self._config.goal_memory)
            self.goal_memory = chosen(p)
        self.motion = MotionFromOdometry(
            inputs.odom_source, inputs.max_odom_gap_s, inputs.turn_correction
        )
        self._relocations = MapRelocations()
        self.number = 0
        """Number of the next action."""
        self.memory_ns = NO_MEMORY_NS
        """Stamp of the memory that the ids of the actions belong to."""
        self._await_later()

    def readers(self) -> dict[str, Reader]:
        """Return the readers."""
        return {
            'command': self._obey, 'odometry': self._move, 'template': self._view,
            'relocation': self._answered,
        }

    def _obey(self, stamp_ns: int, command: Command) -> None:
        match command:
            case Configure():
                self._config = command.config
                self.core.reconfigure(command.config.pose_cells)
            case SetMapping():
                self.core.mapping = self._mapping = command.mapping
            case MarkGoal() if self.goal_memory is not None:
                self.goal_memory.mark(command.name, self.core.peak)
            case BlockWay() if self.goal_memory is not None:
                self.goal_memory.blocked(self.core.peak, command.bearing_rad, command.tried_s)
            case Reset():
                self._begin()
            case NewSession():
                self.motion.restart()
                self._await_later()  # there may be another map, or none, in this session
                if len(self.core):
                    self._integrate(UNKNOWN_MOTION)
            case Relocated():
                self._relocated()

    def _relocated(self) -> None:
        self.motion.restart()
        if self.core.calibration is not None:
            self.core.calibration.restart()
        if self.goal_memory is not None:
            self.goal_memory.relocated()

    def _move(self, stamp_ns: int, odometry: Odometry) -> None:
        motion = self.motion.update(odometry)
        if motion is not None:
            self._integrate(motion)
            self.on_moved(stamp_ns)

    def _integrate(self, motion: Motion) -> None:
        self.core.integrate(motion)
        if self.goal_memory is not None:
            self.goal_memory.integrate(motion, self.core)

    def _view(self, stamp_ns: int, match: ViewMatch) -> tuple[Output, ...]:
        relocation = self._relocations.due(self.number)
        if relocation is not None and self.core.relocate(relocation) and (
            self.goal_memory is not None
        ):
            self.goal_memory.relocated()
        action = self.core.view(match, self.motion.reaches(stamp_ns), stamp_ns)
        if action.correction is not None:
            self.motion.correction = action.correction
        number, self.number = self.number, self.number + 1
        if action.action == 'create' and self.memory_ns == NO_MEMORY_NS:
            self.memory_ns = max(stamp_ns, MIN_MEMORY_NS)
        return (Output('action', stamp_ns, NumberedAction(number, action, self.memory_ns)),)

    def _answered(self, stamp_ns: int, answer: Answer) -> None:
        number, relocation, memory_ns = answer
        # After a restart, actions are answered that will be repeated, and others were before.
        if memory_ns in (NO_MEMORY_NS, self.memory_ns) and number >= self.number - ADOPTION_DELAY:
            self._relocations.answer(number, relocation)

    def expect_answers(self) -> None:
        """Await the answers to all actions from now on."""
        self._is_answered = True
        self._await_later()

    def _await_later(self) -> None:
        self._relocations.await_after(self.number - 1 if self._is_answered else None)

    def awaits_answer(self) -> bool:
        """Return whether the map must answer an earlier action before the next template."""
        return self._relocations.is_awaited(self.number)

    def _restored(self, state: State) -> None:
        if state.get('relocations', {}).get('last') is None:
            self._await_later()
        if 'motion' not in state and self.core.calibration is not None:
            self.motion.correction = self.core.calibration.correction
        if 'memory_ns' not in state:  # of earlier versions
            self.memory_ns = MIN_MEMORY_NS if len(self.core) else NO_MEMORY_NS
