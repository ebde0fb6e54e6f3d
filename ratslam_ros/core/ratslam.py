# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""RatSLAM: the whole system in one process.

    camera image --+--> visual_odometry --> odometry <-- wheel encoders
                   |                           |
                   +--> local_view -template-> pose_cells -action-> experience_map
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import (
    Motion,
    MotionFromOdometry,
    Odometry,
    moved,
)
from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.common.scan import Scan, scan_stream
from ratslam_ros.core.common.stamp_order import Counts, Released, StampOrder
from ratslam_ros.core.common.state import State, unused
from ratslam_ros.core.config import Config, ConfigChanges
from ratslam_ros.core.goal_memory.goal_memory import GoalMemory
from ratslam_ros.core.held_messages import (
    image_from_state,
    image_state,
    item_from_state,
    item_state,
)
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.mapping_step import adopt_correction, apply_action
from ratslam_ros.core.mapping.pose_hint import PendingHints, PoseHint
from ratslam_ros.core.mapping.relocator import Relocator
from ratslam_ros.core.mapping.scan_matching import ScanMatcher
from ratslam_ros.core.navigation.goals import Goals
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.core.pose_cells.map_relocation import MapRelocations
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.steps import OdometryStep, Step, ViewStep
from ratslam_ros.core.vision.local_view import (
    UNDECODABLE,
    EncodedView,
    LocalView,
    ViewMatch,
    ViewMatcher,
    delayed_ns,
    uses_odometry,
)
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.core.vision.visual_odometry import VisualOdometry
from ratslam_ros.errors import UnusableInput, UnusableParameter

Stopwatch = Callable[[str], AbstractContextManager[object]]


class RatSLAM:
    """Visual odometry, local view, pose cells and experience map, fed in the order of stamps."""

    def __init__(
        self,
        config: Config,
        visual_odometry: bool = False,
        stopwatch: Stopwatch = lambda name: nullcontext(),
        local_view: ViewMatcher | None = None,
    ) -> None:
        """Prepare an empty map.

        Args:
            config: all parameters.
            visual_odometry: whether odometry is estimated from the images.
            stopwatch: function that takes the name of a part, and returns a context manager that
                is entered around each of its steps; the core has no clock of its own.
            local_view: matcher of the images; None: the one that ``config`` describes.
        """
        self.visual_odometry = VisualOdometry(config.visual_odometry) if visual_odometry else None
        self.local_view = LocalView(config.local_view) if local_view is None else local_view
        self.pose_cells = PoseCells(config.pose_cells)
        self.experience_map = ExperienceMap(config.experience_map)
        self.behaviour = ''
        """Name of the active behaviour, stored in the links; '' if unknown."""
        self.goal_memory: GoalMemory | None = None
        """Goal memory, learned along with the map if ``goal_memory.goal_memory`` is set."""
        if config.goal_memory.goal_memory:
            self.goal_memory = GoalMemory(config.goal_memory, config.pose_cells)
        self.scan_matcher = ScanMatcher() if config.experience_map.exp_align_scans else None
        self.relocator: Relocator | None = None
        """Relocation by scans, if ``exp_relocate`` is not `views` and there is a laser."""
        if self.scan_matcher is not None and config.experience_map.exp_relocate != 'views':
            self.relocator = Relocator(self.experience_map, self.scan_matcher)
        self._goals = Goals()
        """Named places of a map that nodes have made; their anchors may be pruned."""
        self.experience_map.on_pruned.append(self._goals.remove_pruned)
        self._unused: dict[str, State] = {}
        """Items of the restored parts that only other programs use."""
        self.dead_reckoning = self.experience_map.origin
        """Pose by odometry alone, in the map frame."""
        lasers = 0 if self.scan_matcher is None else len(config.experience_map.lasers)
        # At equal stamps the stream named first is processed first.
        streams = 'odometry', *map(scan_stream, range(lasers)), 'template'
        self.order: StampOrder[Odometry | Scan | ViewMatch] = StampOrder(
            streams, round(config.pose_cells.max_lateness_s * 1e9), 'odometry'
        )
        self._motion = MotionFromOdometry(
            config.pose_cells.odom_source, config.pose_cells.max_odom_gap_s,
            config.pose_cells.turn_correction,
        )
        self._images: StampOrder[PreparedImage | None] = StampOrder(('image',), 0)
        self._views: StampOrder[PreparedImage | Odometry | None] | None = None
        if uses_odometry(config.local_view) and isinstance(self.local_view, LocalView):
            lateness_ns = round(config.local_view.max_lateness_s * 1e9)
            self._views = StampOrder(('odometry', 'image'), lateness_ns)
        self._relocations = MapRelocations()
        self._view_count = 0
        self._refused = 0
        self._has_matched = False
        self._watch = stopwatch
        self._config = config
        self._hints = PendingHints()
        self._odometry_changes, self._view_changes, self._map_changes = (
            ConfigChanges(), ConfigChanges(), ConfigChanges()
        )  # fmt: skip

    def reconfigure(self, config: Config, from_ns: int = 0) -> None:
        """Continue with other parameters from a stamp on, as live nodes whose parameters are set.

        Every part takes them over before it processes its first message with this stamp or a
        later one. Changes that are not in force yet are not part of ``state``.

        Args:
            config: all parameters.
            from_ns: the stamp; 0: the next message.

        Raises:
            UnusableParameter: a parameter differs that cannot change; nothing is changed.
        """
        self._config.check_change(config)
        for changes in (self._odometry_changes, self._view_changes, self._map_changes):
            changes.add(config, from_ns)

    # Inputs

    def prepare(self, image: NDArray[np.uint8]) -> PreparedImage:
        """Compute what depends on one image alone; another thread may do so for later images.

        Args:
            image: (H, W) grey levels, 0 to 255.

        Returns:
            The image for ``image``, which gives the same results as without ``prepare``.
        """
        encoded = profiles = None
        # If a window does not fit, ``image`` raises, unless it is a single image of another size.
        with suppress(UnusableParameter):
            if self.visual_odometry is not None:
                profiles = self.visual_odometry.profiles(image)
            if isinstance(self.local_view, LocalView) and self.local_view.encodes_ahead:
                encoded = EncodedView(self.local_view.encode(image))
        return PreparedImage(image, encoded, profiles)

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
            UnusableParameter: the crop, window or template does not fit the first image.
        """
        if isinstance(image, np.ndarray):
            image = PreparedImage(image)
        return self._process_images(self._images.push('image', stamp_ns, image))

    def odometry(self, odometry: Odometry) -> list[Step]:
        """Process one odometry message; return the steps of all messages that it released.

        A message with a value that is not finite, or is implausible, is refused and counted.
        """
        if not self._motion.accepts(odometry):
            self._refused += 1
            return []
        steps: list[Step] = []
        if self._views is not None:
            steps = self._match_images(
                self._views.push('odometry', delayed_ns(odometry.stamp_ns), odometry)
            )
        return steps + self._process(self.order.push('odometry', odometry.stamp_ns, odometry))

    def template(self, stamp_ns: int, match: ViewMatch) -> list[Step]:
        """Process one template message; return the steps of all messages that it released."""
        return self._process(self.order.push('template', stamp_ns, match))

    def scan(self, scan: Scan) -> list[Step]:
        """Process one laser scan; return the steps of all messages that it released.

        Without ``exp_align_scans`` scans are ignored.

        Raises:
            UnusableInput: ``scan_topics`` has fewer lasers than the number of the scan's one.
        """
        if self.scan_matcher is None:
            return []
        lasers = len(self._config.experience_map.lasers)
        if not 0 <= scan.laser < lasers:
            raise UnusableInput(
                f'a scan is of laser {scan.laser}; expected 0 to {lasers - 1}: name all lasers in '
                'experience_map.scan_topics'
            )
        return self._process(self.order.push(scan_stream(scan.laser), scan.stamp_ns, scan))

    def finish(self) -> list[Step]:
        """Process all messages that are still held."""
        steps = self._process_images(self._images.flush())
        if self._views is not None:
            steps += self._match_images(self._views.flush())
        return steps + self._process(self.order.flush())

    def suggest(self, stamp_ns: int, hint: PoseHint) -> None:
        """Use a pose that an operator has given from the first message with its stamp on.

        A hint that has not been used yet is not part of ``state``.

        Raises:
            UnusableInput: a value is not finite, or the covariance is none.
        """
        self._hints.add(stamp_ns, hint.checked())

    # State

    @property
    def mapping(self) -> bool:
        """Whether anything is learned; False: the robot is only localised on the map."""
        return self.pose_cells.mapping

    @mapping.setter
    def mapping(self, mapping: bool) -> None:
        if isinstance(self.local_view, LocalView):
            self.local_view.mapping = mapping
        self.pose_cells.mapping = self.experience_map.mapping = mapping

    def state(self) -> dict[str, State]:
        """Return everything, for ``restore``: a state for each part.

        A run that continues from it gives the same results, byte for byte, as one that was not
        interrupted.

        Raises:
            UnusableInput: the local view is of a class of your own.
        """
        if not isinstance(self.local_view, LocalView):
            raise UnusableInput(
                f'the local view is a {type(self.local_view).__name__}, whose memory cannot be '
                'saved; expected a LocalView'
            )
        matcher, relocator = self.scan_matcher, self.relocator
        states: dict[str, State] = {
            'local_view': {'core': self.local_view.state(), 'has_matched': self._has_matched},
            'pose_cells': {
                'core': self.pose_cells.state(), 'motion': self._motion.state(),
                'relocations': self._relocations.state(), 'sequence': self._view_count,
                **({} if self.goal_memory is None else {'goal_memory': self.goal_memory.state()}),
            },
            'experience_map': {
                'core': self.experience_map.state(), 'correction': list(self._motion.correction),
                'dead_reckoning': list(self.dead_reckoning),
                **({} if matcher is None else {'scans': matcher.state()}),
                **({} if relocator is None else {'relocator': relocator.state()}),
                **({'goals': self._goals.state()} if len(self._goals) else {}),
            },
            'inputs': {
                'order': self.order.state(item_state), 'images': self._images.state(image_state),
                'refused': self._refused,
                **({} if self._views is None else {'views': self._views.state(item_state)}),
            },
        }  # fmt: skip
        if self.visual_odometry is not None:
            states['visual_odometry'] = {'core': self.visual_odometry.state()}
        return {part: {**self._unused.get(part, {}), **own} for part, own in states.items()}

    def restore(self, states: Mapping[str, State]) -> None:
        """Restore what ``state`` returned, or the states of nodes; nothing must be learned yet.

        Without the part `inputs`, which only a single process has, the inputs begin anew: see
        ``begin_session``.

        Raises:
            UnusableInput: the states do not fit the parameters. This object must not be used then.
        """
        try:
            self._restore(states)
            if isinstance(self.local_view, LocalView):
                self._unused = {
                    part: unused(states[part], own)
                    for part, own in self.state().items() if part in states and part != 'inputs'
                }
        except (LookupError, ValueError, TypeError, AttributeError, OverflowError) as error:
            raise UnusableInput(
                f'the saved map is damaged, or of another version ({error!r}); use a backup'
            ) from None

    def _restore(self, states: Mapping[str, State]) -> None:
        if isinstance(self.local_view, LocalView) and 'local_view' in states:
            self.local_view.restore(states['local_view']['core'])
            self._has_matched = states['local_view'].get('has_matched', True)
        cells = states.get('pose_cells')
        if cells is not None:
            self.pose_cells.restore(cells['core'])
            if self.goal_memory is not None and 'goal_memory' in cells:
                self.goal_memory.restore(cells['goal_memory'])
            if 'motion' in cells:
                self._motion.restore(cells['motion'])
                self._relocations.restore(cells['relocations'])
            elif self.pose_cells.calibration is not None:
                self._motion.correction = self.pose_cells.calibration.correction
            self._view_count = cells['sequence']
        graph = states.get('experience_map')
        if graph is not None:
            self.experience_map.restore(graph['core'])
            self.dead_reckoning = Pose(*graph.get('dead_reckoning', self.experience_map.pose))
            if self.scan_matcher is not None and 'scans' in graph:
                self.scan_matcher.restore(graph['scans'])
            if self.relocator is not None and 'relocator' in graph:
                self.relocator.restore(graph['relocator'])
            self._goals.restore(graph.get('goals', self._goals.state()))
        if self.visual_odometry is not None and 'visual_odometry' in states:
            self.visual_odometry.restore(states['visual_odometry']['core'])
        inputs = states.get('inputs')
        if inputs is None:
            self._motion.restart()
            return
        self.order.restore(inputs['order'], item_from_state)
        self._images.restore(inputs['images'], image_from_state)
        self._refused = inputs['refused']
        if self._views is not None and 'views' in inputs:
            self._views.restore(inputs['views'], item_from_state)

    def begin_session(self) -> None:
        """Continue the map with inputs that do not follow the last ones: another drive, or robot.

        Held messages are dropped, and stamps may begin anywhere. The motion since the last session
        is unknown: the robot is in a separate component until it recognises a place.
        """
        lateness_ns = self.order.max_lateness_ns
        self.order = StampOrder(self.order.streams, lateness_ns, 'odometry')
        self._images = StampOrder(('image',), 0)
        if self._views is not None:
            self._views = StampOrder(self._views.streams, self._views.max_lateness_ns)
        if isinstance(self.local_view, LocalView):
            self.local_view.relocated()
        if self.visual_odometry is not None:
            self.visual_odometry.restart()
        self._motion.restart()
        if len(self.experience_map) == 0:
            return
        unknown = Motion(0.0, 0.0, 0.0, False)
        self.pose_cells.integrate(unknown)
        if self.goal_memory is not None:
            self.goal_memory.integrate(unknown, self.pose_cells)
        self.experience_map.integrate(unknown)
        if self.scan_matcher is not None:
            self.scan_matcher.integrate(0, unknown)

    # Outputs

    @property
    def counts(self) -> Counts:
        """Numbers of late and of refused messages."""
        order, images = self.order.counts, self._images.counts
        return Counts(order.late, order.refused + images.refused + self._refused)

    @property
    def offset(self) -> Pose:
        """Pose of the robot in the frame of the current experience, including held odometry."""
        waiting = (o for o in self.order.waiting('odometry') if isinstance(o, Odometry))
        return self._motion.ahead(waiting, self.experience_map.offset)

    @property
    def pose(self) -> Pose:
        """Pose of the robot on the map, including held odometry."""
        graph = self.experience_map
        return composed(graph.pose_of(graph.current_id), self.offset)

    # One step

    def _process_images(
        self, images: Iterable[Released[PreparedImage | None]]
    ) -> list[Step]:
        return [step for stamp_ns, _, image in images for step in self._see(stamp_ns, image)]

    def _see(self, stamp_ns: int, image: PreparedImage | None) -> list[Step]:
        odometry = None
        for config in self._odometry_changes.due(stamp_ns):
            if self.visual_odometry is not None:
                self.visual_odometry.reconfigure(config.visual_odometry)
        if image is not None and self.visual_odometry is not None:
            with self._tolerating_odd_sizes(), self._watch('visual_odometry'):
                odometry = self.visual_odometry.estimate(stamp_ns, image.pixels, image.profiles)
        steps = [] if odometry is None else self.odometry(odometry.as_received())
        if self._views is None:
            return steps + self._match(stamp_ns, image)
        return steps + self._match_images(self._views.push('image', stamp_ns, image))

    def _match_images(
        self, released: Iterable[Released[PreparedImage | Odometry | None]]
    ) -> list[Step]:
        steps: list[Step] = []
        for stamp_ns, _, item in released:
            if not isinstance(item, Odometry):
                steps += self._match(stamp_ns, item)
            elif isinstance(self.local_view, LocalView):
                self.local_view.follow(item)
        return steps

    def _match(self, stamp_ns: int, image: PreparedImage | None) -> list[Step]:
        match = UNDECODABLE
        for config in self._view_changes.due(stamp_ns):
            if isinstance(self.local_view, LocalView):
                self.local_view.reconfigure(config.local_view)
        if image is not None:
            with self._tolerating_odd_sizes(), self._watch('local_view'):
                if isinstance(self.local_view, LocalView):
                    match = self.local_view.match(image.pixels, stamp_ns, image.encoded)
                else:
                    match = self.local_view.match(image.pixels)
                self._has_matched = True
        return self.template(stamp_ns, match)

    @contextmanager
    def _tolerating_odd_sizes(self) -> Iterator[None]:
        """Treat an image of a size that no window fits as undecodable, except for the first."""
        try:
            yield
        except UnusableParameter:
            if not self._has_matched:
                raise  # the crop, window or template does not fit this camera

    def _process(self, released: Iterable[Released[Odometry | Scan | ViewMatch]]) -> list[Step]:
        steps: list[Step] = []
        for stamp_ns, _, item in released:
            for config in self._map_changes.due(stamp_ns):
                self.pose_cells.reconfigure(config.pose_cells)
                self.experience_map.reconfigure(config.experience_map)
            if (hint := self._hints.due(stamp_ns)) is not None:
                self.experience_map.suggest(hint)
            if isinstance(item, Odometry):
                steps.append(self._move(item))
            elif isinstance(item, ViewMatch):
                steps.append(self._act(stamp_ns, item))
            elif self.scan_matcher is not None:
                self.scan_matcher.scan(item)
        return steps

    def _move(self, odometry: Odometry) -> OdometryStep:
        motion = self._motion.update(odometry)
        if motion is not None:
            with self._watch('pose_cells'):
                self.pose_cells.integrate(motion)
            if self.goal_memory is not None:
                with self._watch('goal_memory'):
                    self.goal_memory.integrate(motion, self.pose_cells)
            self.experience_map.integrate(motion)
            self.dead_reckoning = moved(self.dead_reckoning, motion)
            if self.scan_matcher is not None:
                self.scan_matcher.integrate(odometry.stamp_ns, motion)
        graph = self.experience_map
        gap_s = 0.0 if motion is None or motion.is_known else motion.dt_s
        return OdometryStep(
            odometry.stamp_ns, graph.pose, self.dead_reckoning, graph.current_id, graph.offset,
            gap_s,
        )  # fmt: skip

    def _act(self, stamp_ns: int, match: ViewMatch) -> ViewStep:
        relocation = self._relocations.due(self._view_count)
        if relocation is not None and self.pose_cells.relocate(relocation) and (
            self.goal_memory is not None
        ):
            self.goal_memory.relocated()
        with self._watch('pose_cells_view'):
            action = self.pose_cells.view(match, self._motion.reaches(stamp_ns), stamp_ns)
        with self._watch('experience_map'):
            adopt_correction(self._motion, self.experience_map, action)
            update = apply_action(
                self.experience_map, self.scan_matcher, stamp_ns, action, self.behaviour,
                self.relocator,
            )
        self._relocations.answer(self._view_count, update.relocation)
        self._view_count += 1
        relocated_to = NO_EXPERIENCE
        if update.relocation is not None:
            relocated_to = update.relocation.experience_id
        return ViewStep(
            stamp_ns, match, action, update.pruned, update.rejected, relocated_to,
            update.reason,
        )
