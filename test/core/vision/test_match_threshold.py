# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An automatic threshold follows the differences between unrelated views."""

from typing import Any

import cv2
import numpy as np
import pytest
from helpers import extended
from numpy.typing import NDArray

from ratslam_ros.core.config import AUTOMATIC, LocalViewParameters
from ratslam_ros.core.vision.local_view import FIXED_THRESHOLD, LocalView, ViewMatch
from ratslam_ros.core.vision.match_threshold import MatchThreshold

LAP_FRAMES = 120
WIDTH, HEIGHT = 40, 20
STEP_PX = 4


def parameters(**more: Any) -> LocalViewParameters:
    values: dict[str, Any] = {
        'template_x_size': 20, 'template_y_size': 10, 'vt_shift_match': 0,
        'vt_match_threshold': AUTOMATIC, 'vt_recent_templates': AUTOMATIC,
    }
    return extended('local_view', **(values | more))


def circular_world(seed: int = 0, contrast: float = 40.0) -> NDArray[np.uint8]:
    """Return images of one lap past a long picture that closes: (LAP_FRAMES, HEIGHT, WIDTH)."""
    rng = np.random.default_rng(seed)
    length = LAP_FRAMES * STEP_PX
    wall = cv2.GaussianBlur(np.tile(rng.normal(size=(HEIGHT, length)), 3), (0, 0), 2.0)
    wall = wall[:, length : 2 * length + WIDTH]
    wall = 128.0 + contrast * wall / wall.std()
    wall[:, length:] = wall[:, :WIDTH]
    starts = range(0, length, STEP_PX)
    return np.stack([wall[:, x : x + WIDTH].clip(0, 255).astype(np.uint8) for x in starts])


def laps(count: int, noise: float = 2.0, **world: Any) -> NDArray[np.uint8]:
    """Return the images of several laps, with noise that differs in each."""
    once = circular_world(**world).astype(float)
    rng = np.random.default_rng(1)
    images = np.concatenate([once + noise * rng.normal(size=once.shape) for _ in range(count)])
    return images.clip(0, 255).astype(np.uint8)


def matches(images: NDArray[np.uint8], p: LocalViewParameters) -> list[ViewMatch]:
    local_view = LocalView(p)
    return [local_view.match(image) for image in images]


@pytest.mark.parametrize('seed', range(2))
def test_places_of_earlier_laps_are_recognised_without_a_threshold(seed: int) -> None:
    found = matches(laps(3, seed=seed), parameters())
    first = {}
    for frame, match in enumerate(found):
        first.setdefault(match.template_id, frame)
    later = range(LAP_FRAMES + 5, 3 * LAP_FRAMES)
    apart = [(frame - first[found[frame].template_id] + 60) % 120 - 60 for frame in later]
    assert sum(found[frame].is_new for frame in later) <= len(later) // 20
    assert sum(abs(frames) > 4 for frames in apart) <= len(later) // 20


@pytest.mark.parametrize('contrast', [10.0, 20.0, 40.0])
def test_threshold_is_proportional_to_contrast(contrast: float) -> None:
    threshold = matches(laps(2, noise=0.0, contrast=contrast), parameters())[-1].threshold
    whole = matches(laps(2, noise=0.0, contrast=40.0), parameters())[-1].threshold
    assert threshold == pytest.approx(whole * contrast / 40.0, rel=0.3)


def test_standing_still_learns_one_template() -> None:
    still = np.repeat(laps(1)[:1], 200, axis=0).astype(float)
    still += np.random.default_rng(2).normal(size=still.shape)
    images = np.concatenate([still.clip(0, 255).astype(np.uint8), laps(2)])
    found = matches(images, parameters())
    assert sum(match.is_new for match in found[:200]) == 1
    assert not any(match.is_new for match in found[200 + LAP_FRAMES + 5 :])


def test_gradual_change_is_learned_in_steps() -> None:
    found = matches(laps(1), parameters())
    new = [frame for frame, match in enumerate(found) if match.is_new]
    assert max(np.diff(new)) <= 4
    assert sum(match.is_new for match in found) >= LAP_FRAMES / 4


def test_run_continues_identically_after_restore() -> None:
    images, p = laps(2), parameters()
    expected = matches(images, p)
    for split in (1, 30, LAP_FRAMES + 10):
        first, second = LocalView(p), LocalView(p)
        for image in images[:split]:
            first.match(image)
        second.restore(first.state())
        assert [second.match(image) for image in images[split:]] == expected[split:]


def test_fixed_threshold_is_not_reported_and_has_no_state() -> None:
    p = parameters(vt_match_threshold=0.05)
    local_view = LocalView(p)
    assert all(local_view.match(image).threshold == FIXED_THRESHOLD for image in laps(1))
    assert set(local_view.state()) == {'templates', 'low_texture', 'motion'}


def adapted(differences: list[list[int]], learn: bool = True) -> list[int]:
    """Return the limit for each view, given its differences to the old templates."""
    threshold = MatchThreshold(parameters(vt_match_ratio=0.5), 10_000, 0.1)
    limits = []
    for view in differences:
        threshold.adapt(len(view), lambda ranks, view=view: np.array(view)[list(ranks)], learn)
        limits.append(threshold.limit)
    return limits


def test_limit_follows_the_typical_difference_of_each_view() -> None:
    assert adapted([[3000] * 40, [1000] * 40, [3000] * 40]) == [1500, 500, 1500]


def test_few_related_templates_do_not_lower_the_limit() -> None:
    view = [300 if n % 4 == 0 else 3000 for n in range(200)]
    assert adapted([view]) == [1500]


def test_views_with_few_old_templates_use_what_other_views_showed() -> None:
    assert adapted([[]]) == [500]  # the typical difference of the descriptor
    assert adapted([[3000] * 40] * 3 + [[200] * 4])[-1] == 1500
    assert adapted([[3000] * 40] * 3 + [[200] * 4], learn=False)[-1] == 500
