# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a finished run of the demo, and what clicks on it do."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pages import Page, count_pixels, wait_for
from viewer_doubles import FakeControls

from ratslam_ros.cli import main
from ratslam_ros.history.opening import open_run


class Demo:
    """A page that shows the demo; its tests share it."""

    def __init__(self, served: Any, controls: FakeControls, page: Page, run: Any) -> None:
        self.served, self.controls, self.page, self.run = served, controls, page, run

    @property
    def colour(self) -> tuple[int, int, int]:
        """Colour of experiences, from the legend."""
        legend = self.served.page.scene.legend()
        return next(colour for colour, text in legend if text == 'experience')

    def places(self, picture: NDArray[np.uint8]) -> int:
        """Return the number of pixels of experiences."""
        return count_pixels(picture, self.colour)


@pytest.fixture(scope='module')
def demo(
    chromium: Any, serving: Any, recording: Any, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Demo]:
    folder = tmp_path_factory.mktemp('results') / 'demo'
    assert main(['replay', str(recording.recording), '--quiet', '--out', str(folder)]) == 0
    run = open_run(folder)
    controls = FakeControls('go_to', 'cancel_goals', 'save')
    served = serving(run, controls)
    with Page(chromium) as page:
        yield Demo(served, controls, page.open(served.url), run)
    run.close()


def test_earlier_moment_has_its_own_image_and_map(demo: Demo) -> None:
    page = demo.page
    page.wait_for_text(r'0:30\.0 of 0:30\.0')
    page.close_notices()
    page.wait_for_picture(lambda scene: demo.places(scene) > 300, 'experiences')
    last = wait_for(page.images, 'the camera image')[0]
    page.click('Begin')
    page.wait_for_text(r'0:00\.\d of 0:30\.0')
    wait_for(lambda: page.images()[0] != last, 'another image')
    page.wait_for_picture(lambda scene: demo.places(scene) < 100, 'an empty map')
    page.click('End')
    wait_for(lambda: page.images()[0] == last, 'the same image as before')
    page.wait_for_picture(lambda scene: demo.places(scene) > 300, 'experiences')


def test_time_control_stays_in_sight_and_image_fills_panel(demo: Demo) -> None:
    page = demo.page
    page.open_tab('Help')
    page.wait_for_text('Ctrl K')
    scrolled, top, width = page.run(
        "const label = [...document.querySelectorAll('label')]"
        ".find(e => e.innerText.trim() === 'Playback');"
        "const area = label.closest('[data-scrollarea-viewport]'); area.scrollTop = 1000;"
        'const image = [...document.images].find(e => e.naturalWidth === 160);'
        'const found = [area.scrollTop, label.getBoundingClientRect().top, image.width];'
        'area.scrollTop = 0; return found'
    )
    assert scrolled > 50 and 0 < top < 200  # of 720
    assert width > 250
    page.open_tab('Map')


def select_experience(demo: Demo) -> int:
    """Click an experience on the map; return its id."""
    page = demo.page
    page.close_notices()
    page.click('End')
    scene = page.wait_for_picture(lambda scene: demo.places(scene) > 300, 'experiences')
    near = np.abs(scene.astype(int) - np.array(demo.colour)).max(axis=2) <= 40
    rows, columns = np.nonzero(near)
    middle = len(rows) // 2
    page.open_tab('Select')
    page.click_at(page.scene_span[0] + int(columns[middle]), int(rows[middle]))
    return int(page.wait_for_text(r'[Ee]xperience (\d+)')[1])


def test_click_selects_and_goal_is_sent(demo: Demo) -> None:
    page = demo.page
    assert select_experience(demo) < len(demo.run.seek(demo.run.end_ns).map)
    page.open_tab('Drive')
    page.click('Go here')
    wait_for(lambda: [call for call in demo.controls.calls if call[0] == 'go_to'], 'the goal')
    page.wait_for_text('go_to done')
    _, x_m, y_m, *_ = next(call for call in demo.controls.calls if call[0] == 'go_to')
    gaps = np.hypot(*(demo.run.seek(demo.run.end_ns).map.poses[:, :2] - (x_m, y_m)).T)
    assert gaps.min() < 0.01


def test_picture_stays_without_messages(demo: Demo) -> None:
    """The picture is still there after a while without messages."""
    page = demo.page
    page.open_tab('Map')
    demo.served.wait_for_updates(5)
    before = page.received_count
    demo.served.wait_for_updates(10)
    assert page.received_count - before < 10
    assert demo.places(page.scene()) > 300
