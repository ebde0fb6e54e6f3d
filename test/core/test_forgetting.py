# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""RatSLAM with limits: memory is bounded in every part, and all parts forget at the same stamp."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import PERIOD_NS, SMALL_IMAGES, START_NS, ahead, extended, picture, seen, twist

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import Config
from ratslam_ros.core.config.local_view import LEAST_VT_MAX
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.maps import MapMeta, save_map
from ratslam_ros.messages.json_schema import decode, encode
from ratslam_ros.messages.mapping import TemplatePayload, encode_map
from ratslam_ros.pipeline.items import ViewStep
from ratslam_ros.pipeline.ratslam import RatSLAM

VT_MAX, EXP_MAX = 50, 40
PER_LAP = 30
BASE = Config().with_values(SMALL_IMAGES)
LIMITED = BASE.with_values({
    'local_view.vt_max': VT_MAX, 'pose_cells.exp_max': EXP_MAX,
    'pose_cells.exp_forget': 'freshness', 'memory.forget_after_s': 4.0,
})
AUTOMATIC = LIMITED.with_values({
    'local_view.vt_match_threshold': -1, 'local_view.vt_match_ratio': -1,
    'local_view.vt_recent_templates': -1,
    'pose_cells.pc_cell_x_size': -1, 'pose_cells.exp_delta_pc_threshold': -1,
})


def drive(slam: RatSLAM, first: int, last: int) -> list[ViewStep]:
    """Drive two laps of a circle that stays the same, then one with new views, and so on."""
    steps = []
    for n in range(first, last):
        lap, place = divmod(n, PER_LAP)
        circle = lap // 3 + 1 if lap % 3 == 2 else 0
        stamp_ns = START_NS + n * PERIOD_NS
        steps += slam.odometry(twist(stamp_ns, 4.0, 2.0 * np.pi * 10 / PER_LAP))
        steps += slam.image(stamp_ns, picture(1000 * circle + place, 24, 32))
    return [step for step in steps if isinstance(step, ViewStep)]


def local_view(slam: RatSLAM) -> LocalView:
    assert slam.local_view is not None
    return slam.local_view


def test_memory_of_every_part_is_bounded(tmp_path: Path) -> None:
    slam = RatSLAM(AUTOMATIC)
    sizes = []
    for first, end in ((0, 400), (400, 600), (600, 800)):
        drive(slam, first, end)
        assert len(local_view(slam)) == VT_MAX
        assert len(slam.pose_cells) <= EXP_MAX
        state = slam.pose_cells.state()
        learned = local_view(slam).template_ids.tolist()
        associated = [template_id for template_id, *_ in state['memories']]
        assert set(associated) <= set(learned)
        assert set(slam.pose_cells._experiences._of_template) <= set(learned)
        assert set(local_view(slam).state()['look_alikes']['template_ids']) <= set(learned)
        states = {
            part: getattr(slam, part).state()
            for part in ('local_view', 'pose_cells', 'experience_map')
        }
        for constant in ('threshold', 'look_alikes'):  # samples up to a fixed number
            states['local_view'].pop(constant, None)
        states['experience_map'].pop('odometry_noise', None)
        save_map(tmp_path / 'map', states, MapMeta())
        sizes.append((tmp_path / 'map').stat().st_size)
    assert max(sizes) < 1.1 * min(sizes)


def test_removed_templates_are_announced_once_and_not_reused() -> None:
    known: set[int] = set()
    next_id = 0
    for step in drive(RatSLAM(LIMITED), 0, 500):
        match = step.match
        assert set(match.removed) <= known
        known -= set(match.removed)
        if match.is_new:
            assert match.template_id == next_id
            next_id += 1
            known.add(match.template_id)
        assert match.template_id in known
        assert len(known) <= VT_MAX
        assert bool(match.removed) == (match.is_new and match.template_id >= VT_MAX)
    assert next_id > 100


def test_templates_sent_as_messages_give_same_map() -> None:
    """The live nodes and a replay of recorded templates, which have no images, forget alike."""
    slam, receiver = RatSLAM(LIMITED), RatSLAM(LIMITED, 'pose_cells')
    for n, step in enumerate(drive(slam, 0, 450)):
        text = encode(TemplatePayload.of(step.stamp_ns, step.match, 1))
        received = decode(TemplatePayload, text)
        receiver.odometry(twist(START_NS + n * PERIOD_NS, 4.0, 2.0 * np.pi * 10 / PER_LAP))
        receiver.template(received.stamp.ns, received.match)
    for one in (slam, receiver):
        one.finish()
    assert encode_map(1, receiver.experience_map) == encode_map(1, slam.experience_map)
    assert repr(receiver.pose_cells.state()) == repr(slam.pose_cells.state())


def test_limits_that_are_not_reached_change_nothing() -> None:
    one = RatSLAM(BASE)
    other = RatSLAM(BASE.with_values({
        'local_view.vt_max': 5000, 'pose_cells.exp_max': 5000,
        'pose_cells.exp_forget': 'freshness',
    }))
    assert drive(one, 0, 200) == drive(other, 0, 200)
    assert encode_map(1, one.experience_map) == encode_map(1, other.experience_map)


def test_templates_over_the_limit_are_removed_after_loading() -> None:
    slam, limited = RatSLAM(BASE), RatSLAM(LIMITED)
    drive(slam, 0, 200)
    learned = len(local_view(slam))
    assert learned > VT_MAX
    for part in ('local_view', 'pose_cells', 'experience_map'):
        getattr(limited, part).restore(getattr(slam, part).state())
    steps = drive(limited, 200, 300)
    first = next(step for step in steps if step.match.is_new)
    assert len(first.match.removed) == learned - VT_MAX + 1
    assert len(local_view(limited)) == VT_MAX
    assert len(limited.pose_cells.state()['memories']) <= VT_MAX


def test_circle_that_is_driven_often_is_recognised_to_the_end() -> None:
    """Its templates become robust; those of circles that were driven once are forgotten."""
    steps = drive(RatSLAM(LIMITED), 0, 720)
    last = [step.match for n, step in enumerate(steps) if n // PER_LAP % 3 < 2][-PER_LAP:]
    assert sum(match.is_new for match in last) < PER_LAP / 4


def test_components_without_templates_are_removed() -> None:
    """Odometry gaps would otherwise add components without limit."""
    pose_cells = PoseCells(extended('pose_cells'))
    for template_id in range(200):
        pose_cells.integrate(Motion(5.0, 0.0, 0.0, is_known=False))
        pose_cells.integrate(ahead(0.5))
        removed = (template_id - 20,) if template_id >= 20 else ()
        pose_cells.view(replace(seen(template_id), removed=removed))
        assert len(pose_cells._evidence._components) <= 21
    assert len(pose_cells.state()['memories']) == 20
    again = PoseCells(extended('pose_cells'))
    again.restore(pose_cells.state())
    for one in (pose_cells, again):
        one.forget()
        assert len(one.state()['memories']) == 0
        assert one._evidence._components == [200]


def test_too_small_limit_of_templates_is_rejected() -> None:
    extended('local_view', vt_max=LEAST_VT_MAX)
    with pytest.raises(UnusableParameter, match='vt_max is 19; expected 0'):
        extended('local_view', vt_max=LEAST_VT_MAX - 1)
