# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""RatSLAM: the whole system in one process, for library users."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan, scan_stream
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.core.goal_memory.goal_memory import GoalMemory
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.pose_hint import PoseHint
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.vision.local_view import UNDECODABLE, LocalView, ViewMatch
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.core.vision.visual_odometry import VisualOdometry
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.pipeline.commands import (
    NOW,
    Configure,
    Hint,
    NewSession,
    SetBehaviour,
    SetMapping,
)
from ratslam_ros.pipeline.experience_map import ExperienceMapStage
from ratslam_ros.pipeline.items import MapStep, OdometryStep, Step, Template, ViewStep
from ratslam_ros.pipeline.local_view import LocalViewStage
from ratslam_ros.pipeline.order import Counts
from ratslam_ros.pipeline.pipeline import COMMAND, Pipeline, Stopwatch, lateness_ns
from ratslam_ros.pipeline.pose_cells import PoseCellsStage
from ratslam_ros.pipeline.stage import Stage
from ratslam_ros.pipeline.visual_odometry import VisualOdometryStage

if TYPE_CHECKING:
    from ratslam_ros.core.mapping.relocator import Relocator
    from ratslam_ros.core.mapping.scan_matching import ScanMatcher

AnyStage = TypeVar('AnyStage', PoseCellsStage, ExperienceMapStage)

AUTO = 'auto'
"""Head that depends on whether odometry comes."""

STAGES: tuple[type[Stage], ...] = (
    VisualOdometryStage, LocalViewStage, PoseCellsStage, ExperienceMapStage,
)
"""The stages of RatSLAM, in the direction of flow."""


def stages_from(head: str, own: Sequence[type[Stage]] = ()) -> tuple[type[Stage], ...]:
    """Return the stages from the one that takes the inputs on.

    Args:
        head: `visual_odometry` for images alone, `local_view` for images and odometry,
            `pose_cells` for templates and odometry.
        own: stages of the user: each takes the place of the one with its name, or comes last.

    Raises:
        UnusableParameter: no stage has this name.
    """
    stages = {stage.NAME: stage for stage in (*STAGES, *own)}
    names = [*stages]
    if head not in names:
        raise UnusableParameter(f'there is no stage {head!r}: expected one of {", ".join(names)}')
    return tuple(stages.values())[names.index(head):]


def head_of(states: Mapping[str, State]) -> str:
    """Return the head of the pipeline that has saved these states."""
    return next((stage.NAME for stage in STAGES if stage.NAME in states), 'local_view')


def _checked(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image; raises UnusableInput unless it has grey levels of 8 bits."""
    if isinstance(image, np.ndarray) and image.ndim == 2 and image.dtype == np.uint8:
        return image
    found = type(image).__name__
    if isinstance(image, np.ndarray):
        found = f'{found} of shape {image.shape} and type {image.dtype}'
    raise UnusableInput(
        f'the image is a {found}: expected an array of (H, W) grey levels as uint8, such as '
        'cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)'
    )


class Steps:
    """Collects the steps of a pipeline."""

    def __init__(self, pipeline: Pipeline) -> None:
        self._steps: list[Step] = []
        self._match = UNDECODABLE
        pipeline.observe('template', self.note_match)
        pipeline.observe('pose', self._note_pose)
        pipeline.observe('update', self._note_update)

    def taken(self) -> list[Step]:
        """Return the steps since the last call."""
        steps, self._steps = self._steps, []
        return steps

    def note_match(self, stamp_ns: int, item: ViewMatch | Template) -> None:
        """Note the view that the next update of the map results from."""
        self._match = item.match if isinstance(item, Template) else item

    def _note_pose(self, stamp_ns: int, step: OdometryStep) -> None:
        self._steps.append(step)

    def _note_update(self, stamp_ns: int, step: MapStep) -> None:
        update, relocation, reason = step.update, step.update.relocation, step.update.reason
        self._steps.append(ViewStep(
            stamp_ns, self._match, step.action, update.pruned, reason != '',
            NO_EXPERIENCE if relocation is None else relocation.experience_id, reason,
        ))


class RatSLAM:
    """Visual odometry, local view, pose cells and experience map, fed in the order of stamps."""

    def __init__(
        self, config: Config = Config(), head: str = AUTO,
        stopwatch: Stopwatch | None = None, stages: Sequence[type[Stage]] = (),
    ) -> None:
        """Prepare an empty map.

        Args:
            config: all parameters.
            head: the stage that takes the inputs, see ``stages_from``. 'auto': local_view if
                odometry comes, or else visual_odometry once images have waited for it for
                ``max_lateness_s``; the stages are created anew then.
            stopwatch: function that takes the name of a step, and returns a context manager that
                is entered around it; the pipeline has no clock of its own.
            stages: stages of your own: each takes the place of the one with its name, or comes
                last (examples/custom_stage.py).
        """
        self.config = config
        self._stages, self._stopwatch = stages, stopwatch
        self._is_open = head == AUTO
        """Whether the head is not decided yet."""
        self._has_decided = False
        """Whether it was decided for visual odometry."""
        self._refused = 0
        self._build('local_view' if self._is_open else head)

    def _build(self, head: str) -> None:
        made = [kind(self.config) for kind in stages_from(head, self._stages)]
        self.pipeline = Pipeline(made, lateness_ns(self.config), self._stopwatch)
        self._cells = self._stage(PoseCellsStage)
        self._graph = self._stage(ExperienceMapStage)
        self._steps = Steps(self.pipeline)

    def _stage(self, kind: type[AnyStage]) -> AnyStage:
        """Return a stage of which this class uses more than what every stage has."""
        stage: Any = self.pipeline.stages[kind.NAME]
        if not isinstance(stage, kind):
            raise UnusableParameter(
                f'{type(stage).__name__} takes the place of {kind.NAME}; expected a class derived '
                f'from {kind.__name__}, whose map and poses are the results'
            )
        return stage

    # Inputs

    @property
    def wants_colour(self) -> bool:
        """Whether the descriptor uses the colour of images."""
        return self.pipeline.wants_colour

    def feed(self, stream: str, stamp_ns: int, item: Any) -> list[Step]:
        """Process one input of any stream; return the steps of all messages that it released.

        Args:
            stream: name of the stream, such as `image`; see pipeline/streams.py.
            stamp_ns: stamp of the input.
            item: what the method of this name takes, such as ``image``.
        """
        if stream == 'image':
            return self.image(stamp_ns, item)
        if isinstance(item, Odometry):
            return self.odometry(item)
        return self.scan(item) if isinstance(item, Scan) else self._feed(stream, stamp_ns, item)

    def prepare(
        self, image: NDArray[np.uint8], colour: NDArray[np.uint8] | None = None
    ) -> PreparedImage:
        """Compute what depends on one image alone; another thread may do so for later images.

        Args:
            image: (H, W) grey levels, 0 to 255.
            colour: (H, W, 3) uint8 in BGR order, used if ``wants_colour``.

        Returns:
            The image for ``image``, which gives the same results as without ``prepare``.

        Raises:
            UnusableInput: it is no grey image.
        """
        prepared = self.pipeline.prepare(_checked(image), colour)
        return replace(prepared, has_all=False)  # states have pixels

    def image(
        self, stamp_ns: int, image: NDArray[np.uint8] | PreparedImage | None
    ) -> list[Step]:
        """Process one image; return the steps of all messages that it released.

        Args:
            stamp_ns: stamp of the image. An image whose stamp does not increase is refused and
                counted.
            image: (H, W) grey levels, 0 to 255, or what ``prepare`` returned for them; None if the
                image could not be decoded.

        Raises:
            UnusableInput: it is no grey image, or the stamp is no integer.
            UnusableParameter: the crop, window or template does not fit the first image.
        """
        if image is not None and not isinstance(image, PreparedImage):
            image = PreparedImage(_checked(image))
        return self._feed('image', stamp_ns, image)

    def odometry(self, odometry: Odometry) -> list[Step]:
        """Process one odometry message; return the steps of all messages that it released.

        A message with a value that is not finite, or is implausible, is refused and counted.
        """
        if not self._graph.motion.accepts(odometry):
            self._refused += 1
            return []
        return self._feed('odometry', odometry.stamp_ns, odometry)

    def template(self, stamp_ns: int, match: ViewMatch) -> list[Step]:
        """Process one template message; return the steps of all messages that it released."""
        return self._feed('template', stamp_ns, match)

    def scan(self, scan: Scan) -> list[Step]:
        """Process one laser scan; return the steps of all messages that it released.

        Scans are ignored without ``exp_align_scans`` and a stage of your own that reads them.

        Raises:
            UnusableInput: ``scan_topics`` has fewer lasers than the number of the scan's one.
        """
        lasers, stream = self._graph.lasers, scan_stream(scan.laser)
        if stream in self.pipeline.inputs:
            return self._feed(stream, scan.stamp_ns, scan)
        if not lasers:
            return []
        raise UnusableInput(
            f'a scan is of laser {scan.laser}; expected 0 to {lasers - 1}: name all lasers in '
            'experience_map.scan_topics'
        )

    def finish(self) -> list[Step]:
        """Process all messages that are still held."""
        self._decide(math.inf)
        self.pipeline.finish()
        return self._steps.taken()

    def suggest(self, stamp_ns: int, hint: PoseHint) -> None:
        """Use a pose that an operator has given from the first message with its stamp on.

        Raises:
            UnusableInput: a value is not finite, or the covariance is none.
        """
        self.pipeline.feed(COMMAND, stamp_ns, Hint(hint.checked()))

    def reconfigure(self, config: Config, from_ns: int = NOW) -> None:
        """Continue with other parameters from a stamp on, as live nodes whose parameters are set.

        Args:
            config: all parameters.
            from_ns: the stamp; 0: the next message.

        Raises:
            UnusableParameter: a parameter differs that cannot change; nothing is changed.
        """
        self.config.check_change(config)
        self.pipeline.feed(COMMAND, from_ns, Configure(config))

    def _feed(self, stream: str, stamp_ns: int, item: Any) -> list[Step]:
        if stream not in self.pipeline.inputs:
            advice = 'choose another head'
            if self._has_decided:
                advice = (
                    'images had come without odometry for longer than max_lateness_s, and it is '
                    "estimated from them; if it begins later, give head='local_view'"
                )
            raise UnusableInput(
                f'{stream} is no input of this RatSLAM, which takes '
                f'{", ".join(self.pipeline.inputs)}: {advice}'
            )
        if not isinstance(stamp_ns, (int, np.integer)):
            raise UnusableInput(
                f'the stamp of the {stream} is {stamp_ns!r}: expected an integer in ns, such as '
                'round(seconds * 1e9)'
            )
        if self._is_open:
            self._decide(stamp_ns if stream == 'image' else -math.inf)
        self.pipeline.feed(stream, stamp_ns, item)
        return self._steps.taken()

    def _decide(self, stamp_ns: float) -> None:
        """Use visual odometry if images have waited for odometry until a stamp for too long."""
        before = self.pipeline
        if not self._is_open or not {'image', 'odometry'} <= {*before.inputs}:
            return
        self._is_open = before.order.newest_of('odometry') is None and before.order.next_ns == 0
        images = before.order.held_of('image')
        if self._is_open and images and stamp_ns - images[0][0] > before.max_lateness_ns:
            self._is_open, self._has_decided = False, True
            self._build('visual_odometry')
            before.move_to(self.pipeline)

    # State

    @property
    def mapping(self) -> bool:
        """Whether anything is learned; False: the robot is only localised on the map."""
        return self.pose_cells.mapping

    @mapping.setter
    def mapping(self, mapping: bool) -> None:
        self.pipeline.feed(COMMAND, NOW, SetMapping(mapping))

    @property
    def behaviour(self) -> str:
        """Name of the active behaviour, stored in the links; '' if unknown."""
        return self._graph.behaviour

    @behaviour.setter
    def behaviour(self, behaviour: str) -> None:
        self.pipeline.feed(COMMAND, NOW, SetBehaviour(behaviour))

    def state(self) -> dict[str, State]:
        """Return everything, for ``restore``: a state for each part.

        A run that continues from it gives the same results, byte for byte, as one that was not
        interrupted.
        """
        states = self.pipeline.state()
        states['inputs']['refused'] = self._refused
        return states

    def restore(self, states: Mapping[str, State]) -> bool:
        """Restore what ``state`` returned, or the states of nodes; nothing must be learned yet.

        Returns:
            Whether the held inputs were restored, too. Otherwise the states are those of nodes or
            of an earlier version, and the inputs begin anew: call ``begin_session``.

        Raises:
            UnusableInput: the states do not fit the parameters. This object must not be used then.
        """
        is_open, self._is_open = self._is_open, False
        if is_open:
            self._build(head_of(states))
        try:
            has_inputs = self.pipeline.restore(dict(states))
        except (LookupError, ValueError, TypeError, AttributeError, OverflowError) as error:
            raise UnusableInput(
                f'the saved map is damaged, of another version, or of other stages ({error!r}); '
                'give the stages that it was saved with (stages=), or use a backup'
            ) from None
        if has_inputs:
            self._refused = states['inputs']['refused']
            self._is_open = is_open and self.pipeline.order.next_ns == 0
        else:
            self._cells.motion.restart()
            self._graph.motion.restart()
        return has_inputs

    def begin_session(self) -> None:
        """Continue the map with inputs that do not follow the last ones: another drive, or robot.

        Held messages are dropped, and stamps may begin anywhere. The motion since the last session
        is unknown: the robot is in a separate component until it recognises a place.
        """
        self.pipeline.begin_inputs()
        self.pipeline.feed(COMMAND, NOW, NewSession())

    # Parts and outputs

    @property
    def visual_odometry(self) -> VisualOdometry | None:
        """Visual odometry, None if odometry comes from outside."""
        stage = self.pipeline.stages.get('visual_odometry')
        return stage.core if isinstance(stage, VisualOdometryStage) else None

    @property
    def local_view(self) -> LocalView | None:
        """Local view, None if templates come from outside, or from a stage of your own."""
        stage = self.pipeline.stages.get('local_view')
        return stage.core if isinstance(stage, LocalViewStage) else None

    @property
    def pose_cells(self) -> PoseCells:
        """Pose cells."""
        return self._cells.core

    @property
    def goal_memory(self) -> GoalMemory | None:
        """Goal memory, learned along with the map if ``goal_memory.goal_memory`` is set."""
        return self._cells.goal_memory

    @property
    def experience_map(self) -> ExperienceMap:
        """Experience map."""
        return self._graph.core

    @property
    def scan_matcher(self) -> ScanMatcher | None:
        """Scan matcher, None without ``exp_align_scans``."""
        return self._graph.scans

    @property
    def relocator(self) -> Relocator | None:
        """Relocation by scans, None if ``exp_relocate`` is `views` or there is no laser."""
        return self._graph.relocator

    @property
    def dead_reckoning(self) -> Pose:
        """Pose by odometry alone, in the map frame."""
        return self._graph.dead_reckoning

    @property
    def newest_ns(self) -> int:
        """Newest accepted stamp of any input, 0 before the first."""
        return self.pipeline.order.newest_ns or 0

    @property
    def counts(self) -> Counts:
        """Numbers of late and of refused messages."""
        counts = self.pipeline.order.counts
        return Counts(counts.late, counts.refused + self._refused)

    @property
    def offset(self) -> Pose:
        """Pose of the robot in the frame of the current experience, including held odometry."""
        held = self.pipeline.waiting('odometry')
        return self._graph.motion.ahead(held, self.experience_map.offset)

    @property
    def pose(self) -> Pose:
        """Pose of the robot on the map, including held odometry."""
        return self._graph.pose_after(self.pipeline.waiting('odometry'))
