# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Any sequence of inputs, saves, kills, loads, merges and prunes, against a RatSLAM in memory."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

from helpers import SMALL_IMAGES, START_NS, extended, picture
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from map_states import LONG_S, opened
from state_digest import digest_of

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.merging.merge import merge_sessions
from ratslam_ros.core.merging.session import Session
from ratslam_ros.errors import UnusableInput
from ratslam_ros.maps import Cut, read_map
from ratslam_ros.maps.system import load_map, save_map
from ratslam_ros.offline.map_pruning import prune
from ratslam_ros.pipeline.ratslam import RatSLAM

CONFIG = extended().with_values({
    **SMALL_IMAGES, 'pose_cells.pc_dim_xy': 10, 'pose_cells.pc_dim_th': 18,
})
PARTS = 'experience_map', 'inputs', 'local_view', 'pose_cells'
PLACES, STEP_NS, STEP_M = 12, 200_000_000, 0.5
BACK_NS = 30_000_000_000
"""Jump of the clock: more than a stamp order takes for messages that came late."""


def digests(states: Any) -> dict[str, bytes]:
    """Return the digest of each part."""
    return {part: digest_of(state) for part, state in states.items()}


class MapMachine(RuleBasedStateMachine):
    """A system with a map file, and the model: a system in memory with the same inputs."""

    def __init__(self) -> None:
        super().__init__()
        self.temporary = tempfile.TemporaryDirectory()
        self.folder = Path(self.temporary.name)
        self.path = self.folder / 'office.map'
        self.model, self.slam = RatSLAM(CONFIG), RatSLAM(CONFIG)
        self.inputs: list[Any] = []
        """Everything that was put in, of which a restart repeats what came after the cut."""
        self.stamp_ns, self.place, self.saved = START_NS, 0, 0
        self.store = opened(self.path, *PARTS)

    def teardown(self) -> None:
        self.store.close()
        self.temporary.cleanup()

    def put(self, *inputs: Any) -> None:
        """Put the same into both systems."""
        for one in inputs:
            self.inputs.append(one)
            enter(self.model, one)
            enter(self.slam, one)

    @initialize(laps=st.integers(1, 2))
    def drive_laps(self, laps: int) -> None:
        self.images(laps * PLACES)

    @rule(count=st.integers(1, PLACES))
    def images(self, count: int) -> None:
        for _ in range(count):
            self.odometry()
            self.put((self.stamp_ns, self.place))
            self.place = (self.place + 1) % PLACES

    @rule()
    def odometry(self) -> None:
        self.stamp_ns += STEP_NS
        seconds = STEP_NS * 1e-9
        twist = Twist(STEP_M / seconds, 2.0 * math.pi / PLACES / seconds)
        self.put(Odometry(self.stamp_ns, twist, Pose(0.0, 0.0, 0.0)))

    @rule()
    def unusable_image(self) -> None:
        self.put((self.stamp_ns + 1, -1))

    @rule()
    def clock_back(self) -> None:
        self.stamp_ns -= BACK_NS

    @rule()
    def session(self) -> None:
        self.put('session')

    @precondition(lambda self: len(self.inputs) > self.saved)
    @rule()
    def save(self) -> None:
        self.saved = len(self.inputs)
        self.store.cut(Cut(self.saved, max(self.stamp_ns, 0)), self.slam.state())
        assert self.store.flush(LONG_S)

    @rule(unsaved=st.integers(0, 5))
    def kill(self, unsaved: int) -> None:
        """What was put in after the last cut is put in again."""
        for _ in range(unsaved):
            self.odometry()
        self.store.file.release()
        self.store = opened(self.path, *PARTS)
        self.resume()

    @rule()
    def close_and_open(self) -> None:
        self.store.close()
        assert [path.name for path in self.folder.iterdir()] == [self.path.name]
        self.store = opened(self.path, *PARTS)
        self.resume()

    def resume(self) -> None:
        restored = self.store.file.restored
        self.slam = RatSLAM(CONFIG)
        if restored is None or restored.cut is None:
            assert self.saved == 0
        else:
            assert restored.cut.number == self.saved
            self.slam.restore(restored.states)
        for one in self.inputs[self.saved :]:
            enter(self.slam, one)

    @rule()
    def load_what_was_saved(self) -> None:
        copy = self.folder / 'copy.map'
        save_map(self.slam, copy, CONFIG)
        assert digests(load_map(copy).state()) == digests(self.model.state())
        copy.unlink()

    @rule(other=st.integers(1, PLACES))
    def merge(self, other: int) -> None:
        """The order has no effect, and a map merged with itself stays as it is."""
        robot = RatSLAM(CONFIG)
        for n in range(other):
            enter(robot, (START_NS + n * STEP_NS, n))
        present = Session('present', CONFIG, self.slam.state())
        short = Session('short', CONFIG, robot.state())
        one = merged([present, short])
        assert one == merged([short, present])
        again = Session('again', CONFIG, merge_sessions([present, short]).states)
        assert merged([again, again]) == one
        assert merged([present, Session('copy', CONFIG, self.slam.state())]) == merged([present])

    @rule(count=st.integers(1, PLACES))
    def prune_a_copy(self, count: int) -> None:
        copy = self.folder / 'copy.map'
        save_map(self.slam, copy, CONFIG)
        before = len(self.slam.experience_map)
        try:
            prune(copy, count)
        except UnusableInput:
            assert digests(read_map(copy).states) == digests(self.model.state())
        else:
            after = len(load_map(copy).experience_map)
            assert after == before if before <= count else after <= count
        for path in self.folder.glob('copy.map*'):
            path.unlink()

    @invariant()
    def is_the_model(self) -> None:
        assert digests(self.slam.state()) == digests(self.model.state())


def enter(slam: RatSLAM, one: Any) -> None:
    """Put odometry, an image, or the beginning of a session into a system."""
    if one == 'session':
        slam.begin_session()
    elif isinstance(one, Odometry):
        slam.odometry(one)
    else:
        stamp_ns, place = one
        slam.image(stamp_ns, None if place < 0 else picture(place, 24, 32))


def merged(sessions: list[Session]) -> dict[str, bytes]:
    """Return the digests of a merged map."""
    return digests(merge_sessions(sessions).states)


TestMapMachine = MapMachine.TestCase
TestMapMachine.settings = settings(
    max_examples=8, stateful_step_count=15, deadline=None, derandomize=True,
    suppress_health_check=list(HealthCheck),
)
