# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import threading
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip('viser')

from viewer_doubles import FakeControls, FakePick, FakeRun
from viewer_page import Page, open_page

from ratslam_ros.history.records import StatusRecord
from ratslam_ros.viewer.controls import NoControls

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
    page.trigger('Go to the selected point')
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
        page.trigger('Go to the selected point')
        page.trigger('Cancel all goals')
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
