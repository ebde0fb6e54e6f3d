# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Views to fill a memory with and to look for in it: noise, simulated and real ones."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from town import Camera, Town, drive

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.local_view import make_view
from ratslam_ros.recordings import ImageEvent, open_recording

Views = NDArray[np.uint8]
QUERIES = 20
RECORDINGS = ('rc_car_loops', 'donkeycar_track')


@dataclass(frozen=True)
class Kind:
    """Templates (n, 10, 60), views that are not among them, and what they are matched with."""

    name: str
    templates: Views
    unknown: Views
    parameters: LocalViewParameters

    def known(self) -> Views:
        """Return views of templates spread over the memory, each pixel off by up to 3."""
        rng = np.random.default_rng(2)
        at = rng.choice(len(self.templates), QUERIES, replace=False)
        noise = rng.integers(-3, 4, (QUERIES, *self.templates.shape[1:]))
        return np.clip(self.templates[at].astype(int) + noise, 0, 255).astype(np.uint8)


def kinds(count: int, data: Path) -> list[Kind]:
    """Return every kind of views, plain and patch-normalised; real ones where there is data."""
    plain = LocalViewParameters(template_x_size=60, template_y_size=10)
    patch = LocalViewParameters(
        template_x_size=60, template_y_size=10, vt_patch_normalise=2, vt_match_threshold=0.054
    )
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 256, (count + QUERIES, 10, 60), dtype=np.uint8)
    found = [Kind('noise', noise[:count], noise[count:], plain)]
    sources = {'simulated': simulated(count + QUERIES)}
    if all((data / name).is_dir() for name in RECORDINGS):
        sources['real'] = real(data)
    for name, images in sources.items():
        for how, p in (('', plain), (', patches', patch)):
            if name == 'real':
                held_out = len(images) // 6  # unknown views come from images of their own
                templates = np.stack([cut(images[held_out:], p, rng) for _ in range(count)])
                unknown = np.stack([cut(images[:held_out], p, rng) for _ in range(QUERIES)])
            else:
                views = np.stack([make_view(image, p) for image in images])
                # Far along the way, in streets that the templates do not show.
                templates, unknown = views[:count], views[count:]
            found.append(Kind(name + how, templates, unknown, p))
    return found


def simulated(count: int) -> list[Views]:
    """Return what a car's camera sees on its way through a town, a view every 2.8 m."""
    town = Town(known=0.1)
    camera = Camera(town, 1, 160, 120)
    images = []
    pixels = np.empty((120, 160, 3), np.uint8)
    for number, at in enumerate(islice(drive(town, 1, 0.2), count)):
        camera.take(at, number * 0.2, pixels)
        images.append(np.ascontiguousarray(pixels[15:75, :, 1]))
    return images


def real(data: Path) -> list[Views]:
    """Return every other image of two recordings, in no order."""
    images = []
    for name in RECORDINGS:
        with open_recording(data / name) as recording:
            events = recording.events(recording.select())
            seen = [event for event in events if isinstance(event, ImageEvent)]
            images += [event.grey() for event in seen[::2]]
    np.random.default_rng(3).shuffle(images)  # type: ignore[arg-type]
    return images


def cut(images: list[Views], p: LocalViewParameters, rng: np.random.Generator) -> Views:
    """Return a view of a random part of a random image: as many views as are asked for."""
    image = images[rng.integers(len(images))]
    height, width = image.shape
    h, w = int(height * rng.uniform(0.35, 0.9)), int(width * rng.uniform(0.6, 1.0))
    y, x = rng.integers(0, height - h + 1), rng.integers(0, width - w + 1)
    return make_view(np.ascontiguousarray(image[y : y + h, x : x + w]), p)
