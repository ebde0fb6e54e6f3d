# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sequences of views are recognised in light in which single views are not."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers import extended
from numpy.typing import NDArray
from states import differences

from ratslam_ros.core.config import AUTOMATIC
from ratslam_ros.core.vision.local_view import NO_TEMPLATE, LocalView, ViewMatch
from ratslam_ros.core.vision.sequence_matcher import SEQUENCE_LENGTH

Image = NDArray[np.uint8]

HEIGHT, WIDTH, COUNT = 36, 48, 120
PARAMETERS = extended(
    'local_view', vt_descriptor='gradients', template_x_size=12, template_y_size=9,
    vt_shift_match=1, vt_match_threshold=AUTOMATIC, vt_match_ratio=AUTOMATIC,
    vt_recent_templates=AUTOMATIC,
)


def texture(rng: np.random.Generator) -> NDArray[np.float64]:
    smooth = cv2.GaussianBlur(rng.normal(size=(HEIGHT, WIDTH)), (0, 0), 2.0)
    return np.asarray(smooth / smooth.std(), np.float64)


def places(seed: int, count: int = COUNT) -> list[Image]:
    """Return one image for each of some places."""
    rng = np.random.default_rng(seed)
    return [(128 + 40 * texture(rng)).clip(0, 255).astype(np.uint8) for _ in range(count)]


def in_other_light(images: list[Image], seed: int = 9) -> list[Image]:
    """Return the images after a change that differs between regions, with much noise."""
    rng = np.random.default_rng(seed)
    changed = []
    for image in images:
        gain = 1.0 + 0.3 * texture(rng)
        noise = 55.0 * texture(rng)
        changed.append((gain * image + noise).clip(0, 255).astype(np.uint8))
    return changed


def mapped(images: list[Image], **parameters: float) -> LocalView:
    local_view = LocalView(replace(PARAMETERS, **parameters))
    for image in images:
        assert local_view.match(image).is_new
    local_view.relocated()
    return local_view


def localising(images: list[Image]) -> LocalView:
    local_view = mapped(images)
    local_view.mapping = False
    return local_view


def matched(local_view: LocalView, images: list[Image]) -> list[ViewMatch]:
    return [local_view.match(image) for image in images]


def correct(matches: list[ViewMatch]) -> int:
    return sum(match.template_id == place for place, match in enumerate(matches))


def test_sequence_localises_where_single_views_fail() -> None:
    matches = matched(localising(places(1)), in_other_light(places(1)))
    assert correct(matches[: SEQUENCE_LENGTH - 1]) <= 3
    assert correct(matches) >= 0.9 * COUNT
    assert not any(match.is_new for match in matches)


def test_sequence_closes_loop_while_mapping() -> None:
    local_view = mapped(places(1))
    matches = matched(local_view, in_other_light(places(1)))
    assert all(match.is_new for match in matches[: SEQUENCE_LENGTH - 1])
    assert correct(matches) >= 0.9 * COUNT
    assert len(local_view) < 1.3 * COUNT


@pytest.mark.parametrize('mapping', [True, False])
def test_unknown_ground_is_not_recognised(mapping: bool) -> None:
    local_view = mapped(places(1))
    local_view.mapping = mapping
    matches = matched(local_view, places(2))
    assert all(match.is_new == mapping for match in matches)
    assert mapping or {match.template_id for match in matches} == {NO_TEMPLATE}


def test_sequences_are_unused_where_places_look_alike() -> None:
    local_view = localising(places(1))
    local_view._recognition.look_alikes.ratio = 0.3
    assert correct(matched(local_view, in_other_light(places(1)))) <= 3


def test_standing_still_adds_no_views() -> None:
    local_view = localising(places(1))
    changed = in_other_light(places(1))
    matches = matched(local_view, [changed[40]] * 5 * SEQUENCE_LENGTH)
    assert {match.template_id for match in matches} == {NO_TEMPLATE}
    assert local_view.state()['sequence']['count'] == 1


def test_robot_that_stops_remains_recognised() -> None:
    local_view = localising(places(1))
    changed = in_other_light(places(1))[:40]
    found = matched(local_view, changed)[-1]
    assert found.template_id == 39
    assert matched(local_view, changed[-1:] * 5) == [found] * 5


@pytest.mark.parametrize('mapping', [True, False])
def test_restored_sequence_continues_identically(mapping: bool) -> None:
    local_view = mapped(places(1))
    local_view.mapping = mapping
    changed = in_other_light(places(1))
    for place in (5, 9, 10, 60):
        matched(local_view, changed[local_view.state()['sequence']['count'] : place])
        restored = LocalView(PARAMETERS)
        restored.restore(local_view.state())
        restored.mapping = mapping
        assert not list(differences(local_view.state(), restored.state()))
        local_view = restored
    once = mapped(places(1))
    once.mapping = mapping
    matched(once, changed[:60])
    assert matched(local_view, changed[60:]) == matched(once, changed[60:])


def test_sequence_continues_after_templates_are_removed() -> None:
    local_view = mapped(places(1), vt_max=COUNT)
    matches, removed = [], 0
    for image in in_other_light(places(1)):
        matches.append(local_view.match(image))
        removed += len(matches[-1].removed)
        assert matches[-1].template_id in local_view
    assert removed >= SEQUENCE_LENGTH - 1
    assert correct(matches) >= 0.6 * COUNT


def test_fixed_threshold_uses_no_sequences() -> None:
    local_view = mapped(places(1), vt_match_threshold=0.05)
    local_view.mapping = False
    matched(local_view, in_other_light(places(1))[:20])
    assert 'sequence' not in local_view.state()
