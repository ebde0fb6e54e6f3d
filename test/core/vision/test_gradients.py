# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The gradient descriptor: invariance to light, shifts, and low texture."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import pytest
from helpers import extended
from numpy.typing import NDArray

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.gradients import CELL_PX, ORIENTATIONS, OUTSIDE, Gradients
from ratslam_ros.core.vision.image_window import Window
from ratslam_ros.core.vision.local_view import UNDECODABLE, LocalView
from ratslam_ros.core.vision.structure import structure
from ratslam_ros.core.vision.template_memory import TemplateMemory
from ratslam_ros.errors import UnusableInput, UnusableParameter

Image = NDArray[np.uint8]

COLUMNS, ROWS = 12, 9
LIGHTS = {
    'gain': lambda v: 0.5 * v,
    'gamma': lambda v: v**1.8,
    'offset': lambda v: 0.6 * v + 0.3,
    'side light': lambda v: v * np.linspace(0.5, 1.0, v.shape[1]),
    'shadow': lambda v: v * np.where(np.arange(v.shape[1]) < 60, 0.55, 1.0),
}


def parameters(**more: Any) -> LocalViewParameters:
    return extended('local_view', **{
        'vt_descriptor': 'gradients', 'template_x_size': COLUMNS, 'template_y_size': ROWS,
        'vt_shift_match': 2, 'vt_shift_match_y': 1, **more,
    })


def scene(seed: int, width: int = 160) -> Image:
    """Return an image, (120, width), of overlapping rectangles and discs."""
    rng = np.random.default_rng(seed)
    image = np.full((120, width), int(rng.integers(60, 180)), np.uint8)
    for _ in range(width // 5):
        x, y = int(rng.integers(width)), int(rng.integers(120))
        size, grey = int(rng.integers(5, 25)), int(rng.integers(20, 236))
        if rng.random() < 0.5:
            cv2.circle(image, (x, y), size, grey, -1)
        else:
            cv2.rectangle(image, (x, y), (x + 2 * size, y + size), grey, -1)
    return image


def lit(image: Image, light: str, seed: int = 0) -> Image:
    """Return the image in another light, with the noise of a sensor."""
    value = LIGHTS[light](image / 255.0) + np.random.default_rng(seed).normal(0, 0.01, image.shape)
    return np.clip(255.0 * value, 0, 255).astype(np.uint8)


def plain_gradients(image: Image, p: LocalViewParameters) -> NDArray[np.float64]:
    """Return the (orientations, rows, columns) view before rounding, as docs define it."""
    rows, columns = p.template_y_size, p.template_x_size
    size = columns * CELL_PX, rows * CELL_PX
    v = cv2.resize(image.astype(np.float64) / 255.0, size, interpolation=cv2.INTER_AREA)
    if p.vt_panoramic:
        dx = np.roll(v, -1, 1) - np.roll(v, 1, 1)
    else:
        wide = np.pad(v, ((0, 0), (1, 1)), mode='edge')
        dx = wide[:, 2:] - wide[:, :-2]
    tall = np.pad(v, ((1, 1), (0, 0)), mode='edge')
    dy = tall[2:] - tall[:-2]
    strength, direction = np.hypot(dx, dy), np.arctan2(dy, dx)

    def weights(cells: int, cyclic: bool) -> NDArray[np.float64]:
        place = (np.arange(cells * CELL_PX) + 0.5) / CELL_PX - 0.5
        apart = np.abs(place - np.arange(cells)[:, None])
        if cyclic:
            apart = np.minimum(apart, cells - apart)
        return np.maximum(1.0 - apart, 0.0) / CELL_PX

    energy = np.stack([
        weights(rows, False)
        @ (strength * np.maximum(np.cos(direction - 2 * np.pi * k / ORIENTATIONS), 0.0) ** 4)
        @ weights(columns, p.vt_panoramic).T
        for k in range(ORIENTATIONS)
    ])
    cell = np.sqrt((energy**2).sum(0))
    return 255.0 * np.sqrt(energy / (cell + math.sqrt((cell**2).mean())))


@pytest.mark.parametrize('panoramic', [False, True])
@pytest.mark.parametrize('size', [(120, 160), (72, 120), (360, 480)])
def test_view_equals_the_definition(size: tuple[int, int], panoramic: bool) -> None:
    """For sizes that are whole multiples of the reduced image, where blocks are of one size."""
    p = parameters(template_x_size=10, template_y_size=6, vt_panoramic=panoramic)
    image = cv2.resize(scene(3), (size[1], size[0]))
    view = Gradients(p).encode(image)
    assert view is not None
    planes = view.reshape(ORIENTATIONS, 6, -1)
    margin = 0 if panoramic else 2
    inside = planes[:, :, margin : margin + 10]
    assert np.abs(inside - plain_gradients(image, p)).max() <= 0.5 + 1e-6
    assert (np.delete(planes, range(margin, margin + 10), 2) == OUTSIDE).all()


@pytest.mark.parametrize('light', LIGHTS)
def test_scenes_in_other_light_are_recognised(light: str) -> None:
    encoder, memory = Gradients(parameters()), TemplateMemory(Gradients(parameters()).layout)
    scenes = [scene(seed) for seed in range(40)]
    for image in scenes:
        view = encoder.encode(image)
        assert view is not None
        memory.append(view)
    for number, image in enumerate(scenes):
        view = encoder.encode(lit(image, light, number))
        assert view is not None
        match = memory.search(view).best()
        assert match is not None
        assert match.template_id == number


@pytest.mark.parametrize('shift', [-2, -1, 0, 1, 2])
def test_shift_of_cells_is_recovered(shift: int) -> None:
    wide = scene(5, 240)
    cell = 160 // COLUMNS
    p = parameters(vt_shift_fov_deg=60.0, vt_match_threshold=0.1)
    view = LocalView(p)
    view.match(np.ascontiguousarray(wide[:, 40:40 + cell * COLUMNS]))
    left = 40 - shift * cell  # after a left turn, the content moves to the right
    match = view.match(np.ascontiguousarray(wide[:, left:left + cell * COLUMNS]))
    assert not match.is_new
    assert match.relative_rad == pytest.approx(math.radians(shift * 60.0 / COLUMNS))


def test_rotation_of_panoramic_view_is_recovered() -> None:
    image = cv2.resize(scene(6), (10 * COLUMNS, 90))
    view = LocalView(parameters(vt_panoramic=True))
    view.match(image)
    for columns in (1, 5, COLUMNS - 1):
        match = view.match(np.roll(image, 10 * columns, 1))
        assert match.error == 0.0
        turned = math.remainder(match.relative_rad - 2 * math.pi * columns / COLUMNS, 2 * math.pi)
        assert turned == pytest.approx(0.0, abs=1e-9)


def test_match_equals_exhaustive_search() -> None:
    p = parameters()
    encoder = Gradients(p)
    views = [encoder.encode(scene(seed)) for seed in range(60)]
    memory = TemplateMemory(encoder.layout)
    for view in views:
        assert view is not None
        memory.append(view)
    known = np.stack(views).astype(int).reshape(-1, ORIENTATIONS, ROWS, COLUMNS + 4)  # type: ignore[arg-type]
    assert np.array_equal(memory.views(), np.stack(views))  # type: ignore[arg-type]
    for seed in range(50, 70):
        query = encoder.encode(lit(scene(seed), 'gain'))
        assert query is not None
        centre = query.astype(int).reshape(ORIENTATIONS, ROWS, -1)[:, 1:-1, 2:-2]
        sums = np.stack([
            np.abs(known[:, :, y : y + ROWS - 2, x : x + COLUMNS] - centre).sum((1, 2, 3))
            for y in range(3) for x in range(5)
        ], 1)
        at, place = divmod(int(sums.argmin()), 15)
        assert memory.search(query).best() == (at, place % 5, int(sums.min()))


def test_small_images_have_smaller_cells_down_to_2_px() -> None:
    encoder = Gradients(parameters())
    assert encoder.encode(cv2.resize(scene(1), (24, 18))) is not None
    with pytest.raises(UnusableParameter, match='image_crop_x'):
        encoder.encode(cv2.resize(scene(1), (23, 18)))


# Saved memories


def test_templates_of_another_descriptor_are_refused() -> None:
    gradients = LocalView(parameters(template_x_size=10, template_y_size=5))
    gradients.match(scene(1))
    same_shape = {'template_x_size': 10, 'template_y_size': 30, 'vt_shift_match': 2}
    intensity = LocalView(extended('local_view', **same_shape))
    with pytest.raises(UnusableInput, match=r'gradients.*expected .*intensity.*vt_descriptor'):
        intensity.restore(gradients.state())
    with pytest.raises(UnusableInput, match=r'intensity.*expected .*gradients.*vt_descriptor'):
        LocalView(parameters()).restore(intensity.state())


def test_unknown_descriptor_is_named_in_error() -> None:
    with pytest.raises(UnusableParameter, match=r'nothing.*expected one of intensity, grad'):
        LocalView(parameters(vt_descriptor='nothing'))


# Low texture


def blank(level: int, deviation: float, seed: int) -> Image:
    """Return an image of a uniform surface with the noise of a sensor."""
    noise = np.random.default_rng(seed).normal(0.0, deviation, (120, 160))
    return np.clip(level + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(('level', 'deviation'), [(0, 0.0), (0, 5.0), (128, 5.0), (128, 10.0)])
def test_structure_of_noise_is_below_that_of_scenes(level: int, deviation: float) -> None:
    window = Window(0, 160, 0, 120)
    assert structure(blank(level, deviation, 1), window) < 0.025
    assert min(structure(lit(scene(seed), 'gain'), window) for seed in range(10)) > 0.03


def test_structure_of_ramp_equals_its_slope() -> None:
    ramp = np.tile(np.arange(48, dtype=np.uint8) * 5, (36, 1))
    expected = 10.0 / 255.0 * math.sqrt((46 + 2 * 0.25) / 48)
    assert structure(ramp, Window(0, 48, 0, 36)) == pytest.approx(expected)


@pytest.mark.parametrize('descriptor', ['intensity', 'gradients'])
def test_low_texture_images_neither_match_nor_are_learned(descriptor: str) -> None:
    view = LocalView(parameters(vt_descriptor=descriptor, vt_min_structure=0.03))
    assert view.match(blank(0, 0.0, 0)) == UNDECODABLE
    assert view.match(scene(1)).is_new
    for seed in range(3):
        assert view.match(blank(128, 5.0, seed)) == UNDECODABLE
    assert view.match(scene(1)).template_id == 0
    assert (len(view), view.low_texture) == (1, 4)


@pytest.mark.parametrize('descriptor', ['intensity', 'gradients'])
def test_black_reference_attracts_no_query(descriptor: str) -> None:
    """A black image, normalised, resembles all views of low contrast."""
    p = parameters(
        vt_descriptor=descriptor, template_y_size=18, template_x_size=24, vt_patch_normalise=4,
        vt_min_structure=0.03, vt_match_threshold=1.0,
    )
    references = [scene(seed) for seed in range(20)]
    top = []
    for with_black in (False, True):
        view = LocalView(p)
        for image in [*([np.zeros_like(references[0])] if with_black else []), *references]:
            encoded = view.encode(image)
            if encoded is not None:
                view.learn(encoded)
        matches = [view.match(lit(image, 'gamma', n)) for n, image in enumerate(references)]
        top.append([match.template_id for match in matches])
    assert top[0] == top[1]
    assert len(set(top[0])) >= 15


def test_flat_image_has_no_gradient_view() -> None:
    view = LocalView(parameters())
    assert view.match(np.full((120, 160), 90, np.uint8)) == UNDECODABLE
    assert len(view) == 0
