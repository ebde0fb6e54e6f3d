# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Views for benchmarks of the template memory: noise, simulated and real ones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from simulated_town import Camera, Town, drive

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.built_in import GRADIENTS, built_in_encoder
from ratslam_ros.core.vision.encoder import Encoder
from ratslam_ros.files.config import load_config
from ratslam_ros.recordings import ImageEvent, open_recording

Views = NDArray[np.uint8]
QUERIES = 20
"""Number of views that are searched for."""

RECORDINGS = ('rc_car_loops', 'donkeycar_track')


@dataclass(frozen=True)
class Kind:
    """A kind of views.

    Attributes:
        name: name in the tables.
        templates: (n, height, width) uint8, views in the memory.
        unknown: (QUERIES, height, width) uint8, views of other places.
        parameters: parameters of the local view that fit these views.
    """

    name: str
    templates: Views
    unknown: Views
    parameters: LocalViewParameters

    @property
    def gradients(self) -> bool:
        """Whether these are views of gradients."""
        return self.parameters.vt_descriptor == GRADIENTS

    def known(self) -> Views:
        """Return views of random templates, with noise of up to 3 grey levels per pixel."""
        rng = np.random.default_rng(2)
        at = rng.choice(len(self.templates), QUERIES, replace=False)
        noise = rng.integers(-3, 4, (QUERIES, *self.templates.shape[1:]))
        return np.clip(self.templates[at].astype(int) + noise, 0, 255).astype(np.uint8)


def kinds(count: int, data: Path) -> list[Kind]:
    """Return all kinds of views, plain, patch-normalised, and of gradients.

    Args:
        count: number of templates of each kind.
        data: folder of recordings; real views are omitted if it lacks them.
    """
    plain = load_config('openratslam')[0].local_view
    patch = replace(plain, vt_patch_normalise=2, vt_match_threshold=0.054)
    gradients = replace(
        plain, vt_descriptor='gradients', template_x_size=12, template_y_size=9, vt_shift_match=1,
        vt_shift_match_y=1, vt_match_threshold=0.09,
    )
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 256, (count + QUERIES, 10, 60), dtype=np.uint8)
    found = [Kind('noise', noise[:count], noise[count:], plain)]
    sources = {'simulated': simulated(count + QUERIES)}
    if all((data / name).is_dir() for name in RECORDINGS):
        sources['real'] = real(data)
    for name, images in sources.items():
        for suffix, p in (('', plain), (', patches', patch), (', gradients', gradients)):
            if name == 'real':
                held_out = len(images) // 6  # unknown views come from separate images
                templates = np.stack([crop_view(images[held_out:], p, rng) for _ in range(count)])
                unknown = np.stack([crop_view(images[:held_out], p, rng) for _ in range(QUERIES)])
            else:
                encoder = built_in_encoder(p)
                views = np.stack([encoded(encoder, image) for image in images])
                # The last views show streets that are not among the templates.
                templates, unknown = views[:count], views[count:]
            found.append(Kind(name + suffix, templates, unknown, p))
    return found


def simulated(count: int) -> list[Views]:
    """Return images of a car driving through the simulated town, one every 2.8 m."""
    town = Town(known=0.1)
    camera = Camera(town, 1, 160, 120)
    images = []
    pixels = np.empty((120, 160, 3), np.uint8)
    for number, at in enumerate(islice(drive(town, 1, 0.2), count)):
        camera.take(at, number * 0.2, pixels)
        images.append(np.ascontiguousarray(pixels[15:75, :, 1]))
    return images


def real(data: Path) -> list[Views]:
    """Return every other image of two recordings, in random order."""
    images = []
    for name in RECORDINGS:
        with open_recording(data / name) as recording:
            events = recording.events(recording.select())
            seen = [event for event in events if isinstance(event, ImageEvent)]
            images += [event.grey() for event in seen[::2]]
    np.random.default_rng(3).shuffle(images)  # type: ignore[arg-type]
    return images


def crop_view(images: list[Views], p: LocalViewParameters, rng: np.random.Generator) -> Views:
    """Return the view of a random crop of a random image, for any number of different views."""
    image = images[rng.integers(len(images))]
    height, width = image.shape
    h, w = int(height * rng.uniform(0.35, 0.9)), int(width * rng.uniform(0.6, 1.0))
    y, x = rng.integers(0, height - h + 1), rng.integers(0, width - w + 1)
    crop = np.ascontiguousarray(image[y : y + h, x : x + w])
    return encoded(built_in_encoder(p), crop)


def encoded(encoder: Encoder, image: Views) -> Views:
    """Return the view of an image, black for a uniform image."""
    view = encoder.encode(image)
    layout = encoder.layout
    return np.zeros((layout.height, layout.width), np.uint8) if view is None else view
