# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

pytest.importorskip('viser')

import viser
from viewer_doubles import BEGIN_NS, STEP_NS, FakeControls, FakePick, FakeRun
from viewer_page import ALL_ACTIONS, Page, open_page

from ratslam_ros.history.records import ImageRecord
from ratslam_ros.viewer import export
from ratslam_ros.viewer.panels.desk import Desk

# Time control.


def test_scrubber_follows_cursor_without_seeking(page: Page) -> None:
    page.at(0)
    page.playback.play()
    seeks = page.run.seeks
    for _ in range(20):
        page.update(0.5)
    assert page.panels.time.scrubber.value == pytest.approx(10.0)
    assert page.playback.playing
    assert page.run.seeks == seeks
    assert '0:10.0' in page.panels.time.text.content


def test_user_moves_scrubber_and_sees_that_moment(page: Page) -> None:
    page.give(page.panels.time.scrubber, 5.0)
    assert page.playback.cursor_ns == BEGIN_NS + 10 * STEP_NS
    assert 'experience 10 created' in page.panels.camera.text.content
    assert 'paused' in page.panels.time.text.content


def test_scrubber_at_the_right_follows_growing_run() -> None:
    with open_page(FakeRun(20, is_growing=True)) as page:
        time = page.panels.time
        page.give(time.scrubber, 2.0)
        assert not page.playback.following
        page.give(time.scrubber, time.scrubber.max)
        assert page.playback.following
        page.run.grow(20)
        page.update(0.1)
        assert time.scrubber.max == 20.0
        assert time.scrubber.value == 19.5
        assert 'live' in time.text.content


@pytest.mark.parametrize(
    ('button', 'number'), [('Begin', 0), ('◀', 9), ('▶', 11), ('End', 59), ('Play', 10)]
)
def test_playback_buttons_move_cursor(page: Page, button: str, number: int) -> None:
    page.at(10)
    page.give(page.panels.time.buttons, button)
    assert page.playback.cursor_ns == page.run.stamps[number]
    assert page.playback.playing == (button == 'Play')


def test_run_without_records_has_panels_too() -> None:
    with open_page(FakeRun(0, is_growing=True), FakeControls(*ALL_ACTIONS)) as page:
        assert 'waiting for the first data' in page.panels.time.text.content
        assert 'no view for this moment' in page.panels.camera.text.content
        assert not page.panels.camera.image.visible
        page.run.grow(3)
        page.update(0.1)
        assert page.panels.camera.image.visible
        assert page.panels.camera.match.visible


def test_other_run_is_shown_without_old_selection(page: Page) -> None:
    page.panels.selection.choose(FakePick('experience', 4))
    run = FakeRun(60)
    run.title, run.image_at = 'other', lambda stamp_ns: b'other'  # type: ignore[method-assign]
    page.playback.use(run)
    page.update()
    assert page.panels.selection.pick is None
    assert page.panels.camera.image._data == b'other'
    assert 'other' in page.panels.time.text.content


# Camera, match and pose cells.


def test_camera_image_is_sent_once_per_view(page: Page) -> None:
    asked: list[int] = []
    image_at = page.run.image_at

    def counted(stamp_ns: int) -> bytes | None:
        asked.append(stamp_ns)
        return image_at(stamp_ns)

    page.run.image_at = counted  # type: ignore[method-assign]
    page.at(5)
    page.update(0.1)
    page.at(6)
    assert asked == page.run.stamps[5:7]
    assert page.panels.camera.image._data == b'jpeg %d' % page.run.stamps[6]


def test_reduced_image_is_shown_without_recording(page: Page) -> None:
    page.run.image_at = lambda stamp_ns: None  # type: ignore[method-assign]
    page.at(5)
    assert page.panels.camera.no_image.visible and not page.panels.camera.image.visible
    page.run.records[6].append(ImageRecord(page.run.stamps[6], b'small'))
    page.at(6)
    assert page.panels.camera.image._data == b'small' and page.panels.camera.image.visible


def test_error_plot_shows_the_shown_minute(page: Page) -> None:
    page.at(10)
    page.settle()
    x, error, *_ = page.panels.camera.plot.data
    assert len(x) == 11 and x[-1] == 0.0
    assert error[-1] == pytest.approx(0.02)


# Selection.


def test_click_selects_experience_with_view_links_and_visits(page: Page) -> None:
    page.at(45)
    page.scene.next_pick = FakePick('experience', 4)
    page.panels.selection.click((0, 0, 9), (0, 0, -1))
    page.update()
    selection = page.panels.selection
    assert page.scene.selected == FakePick('experience', 4)
    assert 'Experience 4' in selection.text.content
    assert 'first seen at 0:02.00' in selection.images.content
    assert '← 3' in selection.details.content and '→ 5' in selection.details.content
    assert selection.visits.options[1:] == ('0:22.00', '0:12.00', '0:02.00')
    page.give(selection.visits, '0:12.00')
    assert page.playback.cursor_ns == page.run.stamps[24]
    page.settle()
    assert selection.visits.options[1:] == ('0:12.00', '0:02.00')


def test_selected_experience_is_followed_back_to_its_creation(page: Page) -> None:
    page.panels.selection.choose(FakePick('experience', 4))
    page.at(1)
    page.settle()
    assert 'not created yet' in page.panels.selection.text.content
    assert not page.panels.selection.visits.visible


def test_listed_closure_shows_both_images_and_values(page: Page) -> None:
    selection = page.panels.selection
    page.settle()
    rejected, closed = selection.list.options[1:]
    page.give(selection.list, closed)
    assert 'enough recognitions agree' in selection.text.content
    assert page.scene.selected.ends == (19, 0)  # type: ignore[attr-defined]
    assert selection.images.content.count('<img') == 2
    for part in ('0.0100', '0.0300', '5 of 5 views agree', 'displacement'):
        assert part in selection.details.content
    page.give(selection.list, rejected)
    assert 'moves the robot by 4.0 m' in selection.text.content
    page.give(selection.jump)
    assert page.playback.cursor_ns == page.run.stamps[23]
    assert selection.list.value == rejected
    page.give(selection.clear_button)
    assert selection.list.value == 'choose one'


def test_clicked_link_shows_the_view_that_closed_it(page: Page) -> None:
    selection = page.panels.selection
    selection.choose(FakePick('closure', ends=(0, 19)))
    assert selection.closure is not None
    assert selection.closure.stamp_ns == page.run.stamps[20]  # the first of three transitions
    selection.choose(FakePick('closure', ends=(5, 9)))
    assert selection.closure is None
    assert 'not in the history' in selection.text.content


def test_click_on_nothing_clears_selection(page: Page) -> None:
    selection = page.panels.selection
    selection.choose(FakePick('experience', 4))
    page.scene.next_pick = None
    selection.click((0, 0, 9), (0, 0, 1))
    assert selection.pick is None and page.scene.selected is None
    assert not selection.images.visible and not selection.clear_button.visible


def test_closures_are_those_up_to_the_shown_moment(page: Page) -> None:
    page.at(21)
    page.settle()
    assert len(page.panels.selection.list.options) == 2
    page.at(10)
    page.settle()
    assert page.panels.selection.list.options == ('none',)


# Appearance, shortcuts and cost.


def test_layers_colours_and_theme_reach_the_scene(page: Page) -> None:
    panel = page.panels.appearance
    page.give(panel.layers['trail'], False)
    assert page.scene.shown == {'map': True, 'trail': False, 'pose cells': True}
    page.give(panel.colouring, 'visits')
    assert page.scene.colouring == 'visits'
    assert 'visits: oldest' in panel.legend.content
    page.give(panel.overview)
    page.trigger('Show the whole map')
    assert page.scene.looks == 2
    page.trigger('Dark or light theme')
    assert page.scene.dark and panel.dark.value
    page.give(panel.full, True)
    assert page.scene.limit > 10**6
    page.give(panel.full, False)
    assert page.scene.limit == 4000
    page.scene.detail = 'every 4th experience is drawn'
    page.update()
    assert panel.detail.visible and 'every 4th' in panel.detail.content


def test_shortcuts_do_not_clash(page: Page) -> None:
    keys = [(c.hotkey, c.modifier) for c in page.panels.commands]
    assert len(set(keys)) == len(keys)
    moves_view = {'W', 'A', 'S', 'D', 'Q', 'E', 'arrowup', 'arrowdown', 'arrowleft', 'arrowright'}
    assert not {key for key, _ in keys} & moves_view
    for command in page.panels.commands:
        assert command.label in page.panels.help.content


class FakeClient:
    """A browser that can draw, and what it was sent."""

    def __init__(self) -> None:
        self.camera = SimpleNamespace(
            position=np.zeros(3), update_timestamp=1.0, image_width=40, image_height=30
        )
        self.files: list[tuple[str, bytes]] = []
        self.notes: list[tuple[str, str, str]] = []

    def get_render(self, height: int, width: int, **more: object) -> np.ndarray:
        picture = np.full((height, width, 4), (10, 20, 30, 255), np.uint8)
        picture[1:, :, 3] = 0
        return picture

    def send_file_download(self, name: str, content: bytes, save_immediately: bool) -> None:
        self.files.append((name, content))

    def add_notification(self, title: str, body: str, *, color: str, **more: object) -> None:
        self.notes.append((title, body, color))


@pytest.fixture
def browser(page: Page, monkeypatch: pytest.MonkeyPatch) -> FakeClient:
    client = FakeClient()
    monkeypatch.setattr(page.panels.desk.server, 'get_clients', lambda: {1: client})
    return client


def test_answers_are_shown_on_every_page(page: Page, browser: FakeClient) -> None:
    page.give(page.panels.drive.groups['Map'], 'Save')
    page.answer()
    page.controls.refusal = 'no folder'
    page.give(page.panels.drive.groups['Map'], 'Save')
    page.answer()
    assert browser.notes == [
        ('Done: save', 'save done', 'green'), ('Refused: save', 'no folder', 'red')
    ]


def test_view_follows_robot_if_asked(page: Page, browser: FakeClient) -> None:
    page.at(0)
    page.at(5)
    assert not browser.camera.position.any()
    page.give(page.panels.appearance.follow, True)
    page.at(0)
    page.at(10)
    # Half of the loop of radius 3 m lies between both steps, and a quarter before the first one.
    np.testing.assert_allclose(browser.camera.position, [-3.0, -3.0, 0.0], atol=1e-9)


def test_screenshot_is_drawn_and_downloaded_by_the_browser(
    page: Page, browser: FakeClient
) -> None:
    page.at(10)
    for callback in page.panels.export.screenshot._impl.update_cb:
        callback(viser.GuiEvent(client=browser, client_id=1, target=None))  # type: ignore[arg-type]
    page.update()
    page.answer()
    ((name, content),) = browser.files
    assert name == 'test-run-0-05.0.png'
    picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (30, 40, 3) and tuple(picture[0, 0]) == (30, 20, 10)
    assert tuple(picture[1, 0]) == (20, 20, 20)  # the background of the theme


def test_recording_is_downloaded_and_its_failure_shown(
    page: Page, browser: FakeClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(source: object, path: Path, dark: bool, colouring: str) -> export.Exported:
        assert source is page.run and not dark and colouring == 'age'
        path.write_bytes(b'page')
        return export.Exported(4_000_000, 30)

    def press() -> None:
        for callback in page.panels.export.recording._impl.update_cb:
            callback(viser.GuiEvent(client=browser, client_id=1, target=None))  # type: ignore[arg-type]
        page.update()
        page.answer()
        assert not page.panels.export.recording.disabled

    monkeypatch.setattr(export, 'export_html', write)
    press()
    assert browser.files == [('test-run.html', b'page')]
    assert browser.notes[-1][1] == 'test-run.html: 4.0 MB, 30 frames'
    monkeypatch.setattr(export, 'export_html', lambda *_, **__: 1 / 0)
    press()
    assert browser.notes[-1][0] == 'Refused: recording'


def test_unchanged_state_sends_nothing(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    for _ in range(10):
        page.update(0.1)
    sent: list[object] = []
    interface = page.panels.desk.gui._websock_interface
    monkeypatch.setattr(interface, 'queue_message', sent.append)
    for _ in range(50):
        page.update(0.1)
    assert sent == []
    page.at(5)
    assert sent


def test_callbacks_of_the_page_only_post(page: Page) -> None:
    desk: Desk = page.panels.desk
    before = page.playback.cursor_ns
    scrubber = page.panels.time.scrubber
    scrubber._impl.value = 3.0
    for callback in scrubber._impl.update_cb:
        callback(viser.GuiEvent(client=None, client_id=1, target=scrubber))
    assert page.playback.cursor_ns == before
    assert desk.playback is page.playback and not page.posted.empty()
