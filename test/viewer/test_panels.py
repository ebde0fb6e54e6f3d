# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip('viser')

from viewer_doubles import BEGIN_NS, STEP_NS, FakeControls, FakePick, FakeRun
from viewer_page import Page, open_page

from ratslam_ros.history.records import ImageRecord, StatusRecord
from ratslam_ros.viewer.controls import NoControls
from ratslam_ros.viewer.panels.desk import Desk
from ratslam_ros.viewer.panels.shortcuts import RESERVED

ALL_ACTIONS = (
    'go_to', 'go_to_place', 'name_place', 'cancel_goals', 'explore', 'pause_nodes', 'mapping',
    'save', 'load', 'reset', 'set_parameter',
)  # fmt: skip


@pytest.fixture
def page() -> Iterator[Page]:
    with open_page(FakeRun(60), FakeControls(*ALL_ACTIONS)) as page:
        yield page


@pytest.fixture
def replay() -> Iterator[Page]:
    with open_page(FakeRun(60), FakeControls('set_parameter', 'run_again')) as page:
        yield page


def trigger(page: Page, label: str) -> None:
    (command,) = [c for c in page.panels.commands if c.label == label]
    for callback in command._impl.trigger_cb:
        callback(None)
    page.update()


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


def test_play_button_becomes_pause_and_back(page: Page) -> None:
    page.at(10)
    buttons = page.panels.time.buttons
    page.give(buttons, 'Play')
    assert 'Pause' in buttons.options and 'Play' not in buttons.options
    page.give(buttons, 'Pause')
    assert 'Play' in buttons.options and not page.playback.playing


def test_speed_is_chosen_and_shown(page: Page) -> None:
    page.give(page.panels.time.speed, '10×')
    assert page.playback.speed == 10.0
    trigger(page, 'Faster')
    assert page.panels.time.speed.value == '20×'
    for _ in range(20):
        trigger(page, 'Slower')
    assert page.panels.time.speed.value == '0.1×'


def test_notices_of_the_source_are_shown(page: Page) -> None:
    assert not page.panels.time.notices.visible
    page.run.notices = ['Only the final <state> is known.']
    page.update()
    assert page.panels.time.notices.visible
    assert 'final &lt;state&gt;' in page.panels.time.notices.content


def test_run_without_records_has_panels_too() -> None:
    with open_page(FakeRun(0, is_growing=True), FakeControls(*ALL_ACTIONS)) as page:
        assert 'waiting for the first data' in page.panels.time.text.content
        assert 'no view yet' in page.panels.camera.text.content
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


def test_match_shows_shift_and_new_templates_are_marked(page: Page) -> None:
    page.at(5)
    assert '◆' in page.panels.camera.text.content
    assert 'shifted 2 px to the right' in page.panels.camera.match_text.content
    page.at(30)
    assert '◆' not in page.panels.camera.text.content


def test_error_plot_shows_the_shown_minute(page: Page) -> None:
    page.at(10)
    for _ in range(10):
        page.update()
    x, error, *_ = page.panels.camera.plot.data
    assert len(x) == 11 and x[-1] == 0.0
    assert error[-1] == pytest.approx(0.02)


def test_pose_cells_are_described(page: Page) -> None:
    page.at(23)
    text = page.panels.cells.text.content
    assert 'rejected: loop closure to experience 3' in text
    assert '0.800 in 2 active cells' in text


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
    for _ in range(10):
        page.update()
    assert selection.visits.options[1:] == ('0:12.00', '0:02.00')


def test_selected_experience_is_followed_back_to_its_creation(page: Page) -> None:
    page.panels.selection.choose(FakePick('experience', 4))
    page.at(1)
    for _ in range(10):
        page.update()
    assert 'not created yet' in page.panels.selection.text.content
    assert not page.panels.selection.visits.visible


def test_listed_closure_shows_both_images_and_values(page: Page) -> None:
    selection = page.panels.selection
    for _ in range(10):
        page.update()
    rejected, closed = selection.list.options[1:]
    page.give(selection.list, closed)
    assert 'accepted' in selection.text.content
    assert selection.images.content.count('<img') == 2
    for part in ('0.0100', '0.0300', '100%', 'displacement'):
        assert part in selection.details.content
    page.give(selection.list, rejected)
    assert 'rejected: moves the robot by 4.0 m' in selection.text.content
    page.give(selection.jump)
    assert page.playback.cursor_ns == page.run.stamps[23]


def test_clicked_link_shows_the_view_that_closed_it(page: Page) -> None:
    selection = page.panels.selection
    selection.choose(FakePick('closure', ends=(0, 19)))
    assert selection.closure is not None and selection.closure.target_id == 0
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
    for _ in range(10):
        page.update()
    assert len(page.panels.selection.list.options) == 2
    page.at(10)
    for _ in range(10):
        page.update()
    assert page.panels.selection.list.options == ('none yet',)


# Drive.


def test_goal_is_sent_to_selected_ground(page: Page) -> None:
    drive = page.panels.drive
    page.panels.selection.choose(FakePick('ground', point=(1.0, -2.0)))
    page.give(drive.groups['Selected'], 'Go here')
    page.answer()
    page.give(drive.groups['Selected'], 'Then here')
    page.answer()
    assert page.controls.calls == [('go_to', 1.0, -2.0, False), ('go_to', 1.0, -2.0, True)]
    assert drive.log.content.count('go_to done') == 2
    assert 'x 1.00 m, y -2.00 m' in drive.target.content


def test_goal_is_sent_to_selected_experience(page: Page) -> None:
    page.panels.selection.choose(FakePick('experience', 0))
    trigger(page, 'Go to the selected point')
    page.answer()
    assert page.controls.calls == [('go_to', pytest.approx(3.0), pytest.approx(0.0), False)]


def test_goal_without_selection_is_explained(page: Page) -> None:
    page.give(page.panels.drive.groups['Selected'], 'Go here')
    assert page.controls.calls == []
    assert 'Click a point on the map' in page.panels.drive.log.content


def test_refused_request_shows_its_reason(page: Page) -> None:
    page.controls.refusal = 'no route: <b>'
    page.panels.selection.choose(FakePick('ground', point=(1.0, 2.0)))
    page.give(page.panels.drive.groups['Selected'], 'Go here')
    page.answer()
    assert 'refused: no route: &lt;b&gt;' in page.panels.drive.log.content


@pytest.mark.parametrize(
    ('group', 'button', 'call'),
    [
        ('Goals', 'Cancel all goals', ('cancel_goals',)),
        ('Explore', 'On', ('explore', True)),
        ('Mapping', 'Off', ('mapping', False)),
        ('Pause nodes', 'On', ('pause_nodes', True)),
        ('Map', 'Save', ('save',)),
        ('Go to place', 'Then to place', ('go_to_place', 'kitchen', True)),
    ],
)
def test_buttons_send_their_request(page: Page, group: str, button: str, call: Any) -> None:
    page.give(page.panels.drive.groups[group], button)
    page.answer()
    assert page.controls.calls == [call]


def test_place_is_named(page: Page) -> None:
    drive = page.panels.drive
    page.give(drive.groups['Name this place'], 'Name this place')
    assert 'type a name first' in drive.log.content
    page.give(drive.name, ' office ')
    page.give(drive.groups['Name this place'], 'Name this place')
    page.answer()
    assert page.controls.calls == [('name_place', 'office')]
    page.controls.places = ('kitchen', 'office')
    page.update()
    assert drive.place.options == ('kitchen', 'office')


@pytest.mark.parametrize('button', ['Reset', 'Load'])
def test_map_is_replaced_only_after_confirmation(page: Page, button: str) -> None:
    drive = page.panels.drive
    page.give(drive.groups['Map'], button)
    page.give(drive.confirmation, 'Keep as it is')
    assert page.controls.calls == []
    page.give(drive.groups['Map'], button)
    page.give(drive.confirmation, button)
    page.answer()
    assert page.controls.calls == [(button.lower(),)]


def test_slow_request_does_not_hold_up_the_loop(page: Page) -> None:
    import threading

    release = threading.Event()
    page.panels.desk.ask('slow', lambda: (release.wait(10), page.controls.save())[1])
    page.update()
    assert 'waiting for the answer' in page.panels.drive.log.content
    release.set()
    page.answer()
    assert 'save done' in page.panels.drive.log.content


def test_request_that_raises_is_shown_as_refused(page: Page) -> None:
    def fail() -> Any:
        raise OSError('no connection')

    page.panels.desk.ask('broken', fail)
    page.answer()
    assert 'refused: OSError: no connection' in page.panels.drive.log.content


def test_finished_run_offers_nothing_and_says_why() -> None:
    with open_page(FakeRun(5), NoControls('Finished: nothing to command.')) as page:
        drive = page.panels.drive
        assert not drive.groups
        assert not drive.place.visible and not drive.name.visible
        assert 'Finished: nothing to command.' in drive.nothing.content
        trigger(page, 'Go to the selected point')
        trigger(page, 'Cancel all goals')
        assert page.posted.empty() and not drive.log.content
        assert not page.panels.parameters.inputs


def test_goals_and_diagnostics_are_shown(page: Page) -> None:
    payload = (
        '{"schema_version":1,"stamp":{"sec":1,"nanosec":0},"status":"driving","explore":false,'
        '"reason":"","experience_id":1,"neighbours":[],"goal":{"x_m":1.0,"y_m":2.0},'
        '"remaining_s":7.2,"replanned":0,"switched":0,"queue":[],"outcomes":[{"number":0,'
        '"goal":"kitchen","status":"failed","reason":"no way","expected_s":1.0,"took_s":2.0}]}'
    )
    page.run.records[7].append(StatusRecord(page.run.stamps[7], payload))
    page.at(7)
    text = page.panels.drive.status.content
    for part in ('driving', 'x 1.00 m', '7 s', 'kitchen no way'):
        assert part in text, text
    assert 'no &lt;odom&gt;' in page.panels.drive.diagnostics.content


# Parameters.


def test_parameters_of_a_section_are_generated(page: Page) -> None:
    panel = page.panels.parameters
    assert set(panel.inputs) == {k for k in page.controls.parameters if 'local_view' in k}
    page.give(panel.section, 'experience_map')
    assert 'experience_map.exp_relaxation' in panel.inputs
    assert panel.inputs['experience_map.exp_relaxation'].options == ('solve', 'sweep')
    assert panel.inputs['experience_map.exp_loops'].max == 10_000
    page.give(panel.search, 'exp_loops')
    assert set(panel.inputs) == {'experience_map.exp_loops', 'experience_map.exp_relaxation'}
    page.give(panel.search, 'xyz')
    assert not panel.inputs


def test_changed_parameter_is_sent_and_marked(page: Page) -> None:
    panel = page.panels.parameters
    page.give(panel.inputs['local_view.vt_match_threshold'], 0.05)
    page.answer()
    assert page.controls.calls == [('set_parameter', 'local_view.vt_match_threshold', 0.05)]
    assert '0.03 → 0.05' in panel.text.content
    page.give(panel.reset_all)
    page.answer()
    assert page.controls.parameters['local_view.vt_match_threshold'] == 0.03
    assert panel.inputs['local_view.vt_match_threshold'].value == 0.03
    assert '→' not in panel.text.content and not panel.changed


def test_invalid_value_is_explained_and_not_sent(page: Page) -> None:
    panel = page.panels.parameters
    handle = panel.inputs['local_view.vt_shift_match']
    page.give(handle, 40)
    assert 'expected less than half of template_x_size' in panel.text.content
    assert handle.value == 5
    assert page.controls.calls == []


def test_refused_value_is_taken_back(page: Page) -> None:
    panel = page.panels.parameters
    page.controls.refusal = 'cannot be set while the node runs'
    handle = panel.inputs['local_view.vt_max']
    page.give(handle, 50)
    page.answer()
    assert 'cannot be set while the node runs' in panel.text.content
    assert handle.value == 0 and not panel.changed


def test_value_changed_elsewhere_is_shown(page: Page) -> None:
    page.controls.parameters['local_view.vt_max'] = 77
    page.update()
    assert page.panels.parameters.inputs['local_view.vt_max'].value == 77
    assert page.controls.calls == []


def test_replay_runs_again_with_changes(replay: Page) -> None:
    panel = replay.panels.parameters
    assert panel.again.visible and panel.again.disabled
    replay.give(panel.inputs['local_view.vt_panoramic'], True)
    replay.answer()
    assert not panel.again.disabled
    replay.give(panel.again)
    replay.answer()
    assert replay.controls.calls[-1] == ('run_again',)
    assert panel.again.disabled
    assert not replay.panels.drive.groups


def test_shared_parameter_is_set_in_both_sections() -> None:
    controls = FakeControls('set_parameter')
    controls.parameters['pose_cells.odom_source'] = 'twist'
    with open_page(FakeRun(5), controls) as page:
        panel = page.panels.parameters
        page.give(panel.section, 'pose_cells')
        page.give(panel.inputs['pose_cells.odom_source'], 'pose')
        page.answer()
        assert {call[1] for call in controls.calls} >= {
            'pose_cells.odom_source', 'experience_map.odom_source',
        }  # fmt: skip


# Appearance, shortcuts and cost.


def test_layers_colours_and_theme_reach_the_scene(page: Page) -> None:
    panel = page.panels.appearance
    page.give(panel.layers['trail'], False)
    assert page.scene.shown == {'map': True, 'trail': False, 'pose cells': True}
    page.give(panel.colouring, 'visits')
    assert page.scene.colouring == 'visits'
    assert 'visits: oldest' in panel.legend.content
    trigger(page, 'Dark or light theme')
    assert page.scene.dark and panel.dark.value
    page.scene.detail = 'every 4th experience is drawn'
    page.update()
    assert panel.detail.visible and 'every 4th' in panel.detail.content


def test_shortcuts_do_not_clash(page: Page) -> None:
    keys = [(c.hotkey, c.modifier) for c in page.panels.commands]
    assert len(set(keys)) == len(keys)
    assert not {key for key, _ in keys} & RESERVED
    for command in page.panels.commands:
        assert command.label in page.panels.help.content


def test_shortcuts_step_and_play(page: Page) -> None:
    page.at(30)
    for label, number in (
        ('Next view', 31), ('Previous view', 30), ('10 views on', 40), ('10 views back', 30),
        ('Begin', 0), ('End, or live', 59),
    ):  # fmt: skip
        trigger(page, label)
        assert page.playback.cursor_ns == page.run.stamps[number], label
    page.at(30)
    trigger(page, 'Play or pause')
    assert page.playback.playing


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
        import viser

        callback(viser.GuiEvent(client=None, client_id=1, target=scrubber))
    assert page.playback.cursor_ns == before
    assert desk.playback is page.playback and not page.posted.empty()
