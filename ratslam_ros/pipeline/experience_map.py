# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stage experience_map: odometry, scans and actions to a map, and to the robot's pose on it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, ClassVar

from ratslam_ros.core.common.odometry import Motion, MotionFromOdometry, Odometry, moved
from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.common.scan import Scan, scan_stream
from ratslam_ros.core.common.state import State
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.config import Config
from ratslam_ros.core.config.additions import RELOCATION, SCANS
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.late_join import LateJoin
from ratslam_ros.core.mapping.map_update import MapUpdate
from ratslam_ros.core.mapping.mapping_step import adopt_correction, apply_action
from ratslam_ros.core.navigation.goals import Goal, Goals
from ratslam_ros.errors import UnreachableGoal
from ratslam_ros.pipeline.commands import (
    Command,
    Configure,
    Hint,
    NamePlace,
    NewSession,
    Relocated,
    ReportBehaviour,
    Reset,
    SearchPlace,
    SetBehaviour,
    SetMapping,
)
from ratslam_ros.pipeline.items import Answer, MapStep, NumberedAction, OdometryStep
from ratslam_ros.pipeline.pose_cells import UNKNOWN_MOTION
from ratslam_ros.pipeline.stage import OF_HOST, Output, Reader

if TYPE_CHECKING:
    from ratslam_ros.core.mapping.relocator import Relocation, Relocator
    from ratslam_ros.core.mapping.scan_matching import ScanMatcher

BEHAVIOUR_NS = 2_000_000_000
"""Time for which a report of the behaviour holds; they must come more often than this."""


class ExperienceMapStage(Saved):
    """Builds the map, and locates the robot on it."""

    SAVED: ClassVar[tuple[Field, ...]] = (
        Field('core', 'core', ExperienceMap),
        Field('correction', '', float, (2,), optional=True,
              save=lambda own: own.motion.correction),
        Field('motion', 'motion', MotionFromOdometry, of_session=True, optional=True),
        Field('dead_reckoning', 'dead_reckoning', float, (3,), make=Pose, of_session=True,
              optional=True),
        Field('joining', 'late_join', LateJoin, of_session=True, optional=True),
        Field('scans', 'scans', SCANS, optional=True),
        Field('relocator', 'relocator', RELOCATION, optional=True),
        Field('goals', 'goals', Goals, when=lambda own: len(own.goals) > 0),
        Field('behaviour', '', list, save=lambda own: [own.behaviour, own._reported_ns],
              when=lambda own: own._reported_ns is not None, of_session=True,
              fits=('a name and a stamp', lambda pair, _: [*map(type, pair)] == [str, int])),
        Field('action_ns', '', int, of_session=True, optional=True),
        Field('answers', '', list, of_session=True, optional=True),
        Field('behaviours', '', dict, of_session=True, optional=True), *OF_HOST,
    )

    NAME: ClassVar[str] = 'experience_map'
    WRITES: ClassVar[tuple[str, ...]] = ('pose', 'update', 'relocation')

    def __init__(self, config: Config) -> None:
        self._created_with = self._config = config
        self._mapping = True
        self.behaviour = ''
        """Name of the active behaviour, stored in the links; '' if unknown."""
        self._reported_ns: int | None = None
        """Stamp of the report of the behaviour; None: it was set, and holds until it is set."""
        self.unlearned = 0
        """Number of links that were unlearned as reported attempts were blocked."""
        p = config.experience_map
        self.lasers = len(p.lasers) if p.exp_align_scans else 0
        """Number of lasers whose scans are used."""
        self._begin()

    def _begin(self) -> None:
        p, inputs = self._created_with.experience_map, self._created_with.inputs
        self.core = ExperienceMap(p)
        self.core.reconfigure(self._config.experience_map)
        self.core.mapping = self._mapping
        self.goals = Goals()
        """Named places, whose anchors follow pruning."""
        self.late_join = LateJoin(self.core)
        """The ids of the pose cells, which may be reset or restarted alone, as the map may."""
        self.core.on_pruned.append(self.goals.remove_pruned)
        self.scans: ScanMatcher | None = SCANS.of(p)
        self.relocator: Relocator | None = RELOCATION.of(p, self.core, self.scans)
        self.named: Goal | UnreachableGoal | None = None
        """Result of the last command for a named place."""
        self.searched: Relocation | None = None
        """Result of the last command to search for the robot's place."""
        self.motion = MotionFromOdometry(
            inputs.odom_source, inputs.max_odom_gap_s, inputs.turn_correction
        )
        self.dead_reckoning = self.core.origin
        """Pose by odometry alone, in the map frame."""

    def readers(self) -> dict[str, Reader]:
        """Return the readers."""
        scans = {scan_stream(laser): self._scan for laser in range(self.lasers)}
        return {'command': self._obey, 'odometry': self._move, **scans, 'action': self._act}

    def _obey(self, stamp_ns: int, command: Command) -> None:
        match command:
            case Configure():
                self._config = command.config
                self.core.reconfigure(command.config.experience_map)
            case SetMapping():
                self.core.mapping = self._mapping = command.mapping
            case Hint():
                self.core.suggest(command.hint)
            case NamePlace():
                self.named = self._name(command)
            case SearchPlace() if self.relocator is not None:
                self.searched = self.relocator.search(is_lost=True)
            case SetBehaviour():
                self.behaviour, self._reported_ns = command.name, None
            case ReportBehaviour():
                self._report(command)
            case Reset():
                self._forget_report()
                self._begin()
            case NewSession():
                self._forget_report()
                self.motion.restart()
                if len(self.core):
                    self._integrate(0, UNKNOWN_MOTION)
                    self.core.lose('a session has begun, and no place was recognised in it yet')
            case Relocated():
                self._relocated()

    def _name(self, command: NamePlace) -> Goal | UnreachableGoal:
        try:
            if command.remove:
                return self.goals.remove(command.name)
            if command.rename_to:
                return self.goals.rename(command.name, command.rename_to)
            offset = None if command.offset is None else Pose(*command.offset)
            return self.goals.name_place(self.core, command.name, offset)
        except UnreachableGoal as error:
            return error

    def _report(self, report: ReportBehaviour) -> None:
        """Use a report of the behaviour, unless a later one has come."""
        if self._reported_ns is None or report.since_ns >= self._reported_ns:
            self.behaviour, self._reported_ns = report.name, report.since_ns
            if report.failed:
                self.unlearned += self.core.unlearn_blocked(report.name, report.ahead_rad)

    def _forget_report(self) -> None:
        if self._reported_ns is not None:
            self.behaviour, self._reported_ns = '', None

    def _relocated(self) -> None:
        self._forget_report()
        self.motion.restart()
        if self.scans is not None:
            self.scans.restart()
        self.core.gate.restart()
        self.core.lose('the robot may have been moved')

    def lose_place(self) -> None:
        """Continue after a start in a saved map: the robot may be anywhere."""
        self.core.lose('the node has started in a saved map, and recognised no place since')

    def pose_after(self, held: Iterable[Odometry]) -> Pose:
        """Return the robot's pose on the map, including the motion of odometry that waits."""
        ahead = self.motion.ahead(held, self.core.offset)
        return composed(self.core.pose_of(self.core.current_id), ahead)

    def _integrate(self, stamp_ns: int, motion: Motion) -> None:
        self.core.integrate(motion)
        if self.scans is not None:
            self.scans.integrate(stamp_ns, motion)

    def _move(self, stamp_ns: int, odometry: Odometry) -> tuple[Output, ...]:
        motion, gap_s = self.motion.update(odometry), 0.0
        if motion is not None:
            self._integrate(stamp_ns, motion)
            self.dead_reckoning = moved(self.dead_reckoning, motion)
            gap_s = 0.0 if motion.is_known else motion.dt_s
        graph = self.core
        step = OdometryStep(
            stamp_ns, graph.pose, self.dead_reckoning, graph.current_id, graph.offset, gap_s
        )
        return (Output('pose', stamp_ns, step),)

    def _scan(self, stamp_ns: int, scan: Scan) -> None:
        assert self.scans is not None
        self.scans.scan(scan)

    def _act(self, stamp_ns: int, item: NumberedAction) -> tuple[Output, ...]:
        number, action, memory_ns = item
        if self._reported_ns is not None and stamp_ns - self._reported_ns > BEHAVIOUR_NS:
            self._forget_report()
        adopt_correction(self.motion, self.core, action)
        translated = self.late_join.translate(action, number, memory_ns)
        update = MapUpdate()
        if translated is not None:
            action = translated
            update = apply_action(
                self.core, self.scans, stamp_ns, action, self.behaviour, self.relocator
            )
        relocation = self.late_join.peer_relocation(update.relocation)
        return (
            Output('update', stamp_ns, MapStep(number, action, update)),
            # Always: the pose cells wait for it.
            Output('relocation', stamp_ns, Answer(number, relocation, memory_ns)),
        )

    def _restored(self, state: State) -> None:
        if 'behaviour' in state:
            self.behaviour, self._reported_ns = state['behaviour']
        if 'dead_reckoning' not in state:
            self.dead_reckoning = self.core.pose
        if 'joining' not in state:
            self.late_join.assume()
        if 'motion' not in state:
            default = self._created_with.inputs.turn_correction
            self.motion.correction = TurnCorrection(*state.get('correction', default))
