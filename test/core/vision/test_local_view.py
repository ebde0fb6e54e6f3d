# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Views and matches equal those of the reference implementation in helpers.py."""

import contextlib
import math
from typing import Any

import numpy as np
import pytest
from helpers import extended, picture, plain_brightness, plain_match, plain_view
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.intensity import make_view
from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.errors import UnusableParameter

Image = NDArray[np.uint8]


def parameters(
    width: int = 8, height: int = 4, shift: int = 1, **more: Any
) -> LocalViewParameters:
    return extended(
        'local_view', template_x_size=width, template_y_size=height, vt_shift_match=shift, **more
    )


def assert_same_view(image: Image, p: LocalViewParameters) -> None:
    """Compare with the reference; values at a rounding boundary may differ by one."""
    difference = np.abs(make_view(image, p).astype(int) - plain_view(image, p))
    brightness = plain_brightness(image, p)
    at_boundary = np.abs(brightness - np.floor(brightness) - 0.5) < 1e-9
    assert difference.max() <= 1
    assert not difference[~at_boundary].any()


# From image to view


def test_crop_excludes_pixels_outside() -> None:
    image = np.full((20, 30), 200, np.uint8)
    image[5:13, 6:22] = 40
    p = parameters(image_crop_x_min=6, image_crop_x_max=22,
                   image_crop_y_min=5, image_crop_y_max=13)
    assert (make_view(image, p) == 40).all()
    assert_same_view(picture(5, 20, 30), p)


@pytest.mark.parametrize('crop', [
    {'image_crop_x_max': 31}, {'image_crop_y_max': 21}, {'image_crop_x_min': 23},
    {'image_crop_y_min': 17}, {'image_crop_x_min': 12, 'image_crop_x_max': 10},
])
def test_crop_outside_image_is_named_in_error(crop: dict[str, int]) -> None:
    with pytest.raises(UnusableParameter, match=r'local_view\.image_crop_[xy].*30 x 20 px'):
        make_view(picture(1, 20, 30), parameters(**crop))


@settings(max_examples=80)
@given(
    st.integers(0, 10_000), st.integers(4, 30), st.integers(8, 40), st.sampled_from([0, 1, 2, 5]),
    st.sampled_from([0.0, 0.2, 0.5, 0.9]), st.sampled_from([0.0, 0.05, 0.3]),
    st.sampled_from([2, 16, 256]), st.booleans(),
)
def test_view_equals_reference_for_any_image(
    seed: int, rows: int, columns: int, patch: int, mean: float, least_std: float, levels: int,
    by_range: bool,
) -> None:
    rng = np.random.default_rng(seed)
    image = (rng.integers(0, levels, (rows, columns)) * (255 // (levels - 1))).astype(np.uint8)
    assert_same_view(image, parameters(
        vt_patch_normalise=patch, vt_normalisation=mean, vt_min_patch_normalisation_std=least_std,
        vt_normalise_range=by_range,
    ))


@pytest.mark.parametrize('patch', [1, 2, 3])
def test_uniform_patches_become_a_half_for_every_grey(patch: int) -> None:
    """Rounding errors in their deviation have no effect, whatever lies beside them."""
    for value in range(256):
        image = np.full((8, 24), value, np.uint8)
        image[:, 16:] = picture(value, 8, 8)
        view = make_view(image, parameters(24, 8, 0, vt_patch_normalise=patch))
        assert (view[:, : 16 - patch] == 128).all(), value


# Matching


def memory(templates: list[Image], p: LocalViewParameters) -> LocalView:
    local_view = LocalView(p)
    for template in templates:
        local_view.learn(template)
    return local_view


@st.composite
def worlds(draw: st.DrawFn) -> tuple[LocalViewParameters, list[Image], list[Image]]:
    """Draw parameters, and templates and views so similar that ties are common."""
    width, height = draw(st.integers(4, 12)), draw(st.integers(1, 4))
    panoramic = draw(st.booleans())
    shift = draw(st.integers(0, (width - 1) // 2))
    p = parameters(width, height, shift, vt_panoramic=panoramic,
                   vt_step_match=draw(st.integers(1, 3)))
    rng = np.random.default_rng(draw(st.integers(0, 9999)))
    levels = draw(st.sampled_from([1, 2, 3, 256]))
    count = draw(st.integers(1, 12))
    images = (rng.integers(0, levels, (count + 4, height, width)) * 31).astype(np.uint8)
    templates = list(images[:count])
    for template in templates[: count // 3]:  # Add rotated and nearly identical copies.
        templates.append(np.roll(template, 1, axis=1))
        near = template.copy()
        near[0, 0] ^= 1
        templates.append(near)
    views = [*images[count:], templates[0], np.roll(templates[-1], 2, axis=1)]
    return p, templates, views


@settings(max_examples=80)
@given(worlds())
def test_match_equals_reference_including_ties(
    world: tuple[LocalViewParameters, list[Image], list[Image]],
) -> None:
    p, templates, views = world
    local_view = memory(templates, p)
    for view in views:
        assert local_view.best_match(view) == plain_match(templates, view, p)


@pytest.mark.parametrize('turned', [-9, -1, 0, 4, 9])
def test_panoramic_view_gives_relative_heading(turned: int) -> None:
    """Columns run clockwise: a turn to the left moves the content to the right."""
    p = parameters(20, 4, 0, vt_panoramic=True)
    local_view = LocalView(p)
    first = picture(8, 4, 20)
    assert local_view.match(first).is_new
    match = local_view.match(np.roll(first, turned, axis=1))
    assert match.template_id == 0
    assert match.error == 0.0
    assert match.relative_rad == pytest.approx(2.0 * math.pi * turned / 20, abs=1e-12)


def test_panoramic_half_turn_is_plus_pi() -> None:
    local_view = LocalView(parameters(20, 4, 0, vt_panoramic=True))
    local_view.match(picture(8, 4, 20))
    match = local_view.match(np.roll(picture(8, 4, 20), 10, axis=1))
    assert match.relative_rad == pytest.approx(math.pi)


def test_forward_camera_has_no_relative_heading() -> None:
    local_view = LocalView(parameters(20, 4, 5))
    wide = picture(5, 4, 40)
    local_view.match(np.ascontiguousarray(wide[:, 10:30]))
    match = local_view.match(np.ascontiguousarray(wide[:, 13:33]))
    assert not match.is_new
    assert match.relative_rad == 0.0


def test_template_with_different_mean_is_matched() -> None:
    """The means differ by 0.1 because of columns that are not compared at the matching shift.

    OpenRatSLAM skips templates whose mean differs by more than the threshold + 0.005.
    """
    template = picture(1, 4, 20)
    view = template.copy()
    template[:, 16:] = 0
    view[:, :4] = np.maximum(view[:, :4], 128)
    view[:, 16:] = 255
    p = parameters(20, 4, 4, vt_match_threshold=0.03)
    assert abs(float(view.mean()) - float(template.mean())) / 255 > 0.035 + 0.05
    local_view = memory([picture(7, 4, 20), template], p)
    match = local_view.match(view)
    assert (match.template_id, match.is_new, match.error) == (1, False, 0.0)


# Recognising and learning


def test_first_view_is_learned_and_later_recognised() -> None:
    local_view = LocalView(parameters())
    first = local_view.match(picture(0))
    assert (first.template_id, first.is_new, first.error) == (0, True, -1.0)
    again = local_view.match(picture(0))
    assert (again.template_id, again.is_new, again.error) == (0, False, 0.0)
    other = local_view.match(picture(1))
    assert (other.template_id, other.is_new) == (1, True)
    assert other.error > 0.03


@pytest.mark.parametrize('threshold', [0.0, 0.03, 1.0])
@pytest.mark.parametrize('panoramic', [False, True])
def test_error_up_to_threshold_is_recognised(
    threshold: float, panoramic: bool
) -> None:
    p = parameters(20, 4, 2, vt_match_threshold=threshold, vt_panoramic=panoramic)
    area = 80 if panoramic else 64
    limit = math.floor(threshold * 255 * area)
    for sad in {max(limit - 1, 0), limit, min(limit + 1, 255 * area)}:
        view = np.zeros((4, 20), np.uint8)
        columns = view if panoramic else view[:, 2:18]
        rest = sad
        for y in range(columns.shape[0]):
            for x in range(columns.shape[1]):
                columns[y, x] = min(rest, 255)
                rest -= int(columns[y, x])
        assert rest == 0
        local_view = memory([np.zeros((4, 20), np.uint8)], p)
        match = local_view.match(view)
        assert match.is_new == (sad > threshold * 255 * area)
        assert match.error == pytest.approx(sad / (255 * area), abs=1e-15)


def test_templates_are_numbered_in_learning_order() -> None:
    local_view = LocalView(parameters())
    ids = [local_view.match(picture(seed)).template_id for seed in range(200)]
    assert ids == list(range(200))
    assert local_view.templates.shape == (200, 4, 8)
    again = [0, 63, 64, 199]
    assert [local_view.match(picture(seed)).template_id for seed in again] == again


def test_returned_templates_do_not_alias_the_memory() -> None:
    local_view = LocalView(parameters())
    local_view.match(picture(0))
    returned = local_view.templates
    with contextlib.suppress(ValueError):  # read-only, or a copy
        returned[:] = 1
    assert not local_view.match(picture(0)).is_new


# Vertical shifts and recent templates (not in OpenRatSLAM)


def test_view_is_matched_at_vertical_shifts() -> None:
    p = parameters(12, 9, 1, vt_shift_match_y=2)
    tall = picture(4, 20, 12)
    local_view = memory([np.ascontiguousarray(tall[5:14])], p)
    for shift in range(-2, 3):
        found = local_view.best_match(np.ascontiguousarray(tall[5 + shift : 14 + shift]))
        assert found == (0, 1, 0)


def test_recent_templates_need_the_stricter_threshold() -> None:
    p = parameters(8, 4, 0, vt_match_threshold=0.1, vt_recent_templates=2,
                   vt_recent_threshold=0.5)
    base = picture(1, 4, 8) // 2
    near, far = base + np.uint8(10), base + np.uint8(20)  # 0.04 and 0.08
    recent = memory([picture(2, 4, 8), base], p)
    assert not recent.match(near).is_new
    assert recent.match(far).is_new
    old = memory([base, picture(2, 4, 8), picture(3, 4, 8)], p)
    assert old.match(far).template_id == 0


def test_image_layouts_share_one_compiled_function() -> None:
    """Otherwise crops, read-only buffers and other strides would be compiled during a run."""
    from ratslam_ros.core.vision import intensity, visual_odometry

    whole = np.random.default_rng(0).integers(0, 256, (40, 60), dtype=np.uint8)
    frozen = whole.copy()
    frozen.flags.writeable = False
    size = {'template_x_size': 12, 'template_y_size': 8, 'vt_shift_match': 1}
    views = [
        intensity.make_view(image, extended('local_view', **size))
        for image in (whole, frozen, np.asfortranarray(whole), np.repeat(whole, 2, 1)[:, ::2])
    ]
    assert all((view == views[0]).all() for view in views)
    intensity.make_view(frozen, extended('local_view', **size, image_crop_x_min=5))
    odometry = visual_odometry.VisualOdometry(extended('visual_odometry', vrot_image_x_min=3))
    odometry.estimate(0, whole)
    odometry.estimate(1, frozen)
    assert len(intensity._make_view.signatures) == 1
    assert len(visual_odometry._profile.signatures) == 1
