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
from ratslam_ros.viewer.panels.parameters import problem_of
from ratslam_ros.viewer.run_source import NoControls


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
        ('Robot', 'Relocate', ('relocate',)),
        ('Map', 'Save', ('save',)),
        ('Go to place', 'Then to place', ('go_to_place', 'kitchen', True)),
    ],
)
def test_buttons_send_their_request(page: Page, group: str, button: str, call: Any) -> None:
    page.give(page.panels.drive.groups[group], button)
    page.answer()
    assert page.controls.calls == [call]


def test_switches_mark_the_present_state_and_keep_working(page: Page) -> None:
    drive = page.panels.drive
    page.update()
    assert drive.groups['Mapping'].options == ('On', 'Off')
    page.controls.switches = {'mapping': True, 'explore': False}
    page.update()
    assert drive.groups['Mapping'].options == ('● On', 'Off')
    assert drive.groups['Explore'].options == ('On', '● Off')
    assert drive.groups['Pause nodes'].options == ('On', 'Off')
    page.give(drive.groups['Explore'], '● Off')
    page.give(drive.groups['Mapping'], 'Off')
    page.answer()
    assert sorted(page.controls.calls) == [('explore', False), ('mapping', False)]


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
    page.panels.desk.ask('slow', lambda: (release.wait(10), page.controls.actions['save']())[1])
    page.update()
    assert 'waiting for the answer' in page.panels.drive.log.content
    release.set()
    page.answer()
    assert 'save done' in page.panels.drive.log.content


def test_finished_run_offers_nothing_and_says_why() -> None:
    with open_page(FakeRun(5), NoControls('Finished: nothing to command.')) as page:
        drive = page.panels.drive
        assert not drive.groups
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
    assert 'sweep' in panel.inputs['experience_map.exp_relaxation'].options
    assert panel.inputs['experience_map.exp_loops'].max == 10_000
    page.give(panel.search, 'exp_loops')
    assert set(panel.inputs) == {'experience_map.exp_loops', 'experience_map.exp_relaxation'}
    page.give(panel.search, 'xyz')
    assert not panel.inputs


def test_edits_are_marked_and_applied_together(page: Page) -> None:
    panel = page.panels.parameters
    assert panel.apply.disabled
    page.give(panel.inputs['local_view.vt_match_threshold'], 0.05)
    page.give(panel.inputs['local_view.vt_panoramic'], True)
    assert page.controls.calls == []
    assert '-1.0 → 0.05' in panel.text.content
    assert panel.inputs['local_view.vt_panoramic'].label.startswith('◆')
    page.give(panel.apply)
    page.answer()
    assert page.controls.calls == [
        ('set_parameter', 'local_view.vt_match_threshold', 0.05),
        ('set_parameter', 'local_view.vt_panoramic', True),
    ]
    assert panel.apply.disabled and not panel.edits and not panel.text.content
    assert panel.inputs['local_view.vt_panoramic'].label.startswith('vt')


def test_edits_are_discarded_or_set_to_defaults(page: Page) -> None:
    page.controls.parameters['local_view.vt_max'] = 500
    page.update()
    panel = page.panels.parameters
    handle = panel.inputs['local_view.vt_max']
    page.give(handle, 700)
    page.give(panel.buttons, 'Discard')
    assert handle.value == 500 and not panel.edits
    page.give(panel.buttons, 'Defaults')
    assert handle.value == 0 and panel.edits == {'local_view.vt_max': 0}
    page.give(handle, 500)
    assert not panel.edits and panel.apply.disabled


def test_invalid_edits_are_explained_until_they_fit_together(page: Page) -> None:
    panel = page.panels.parameters
    page.give(panel.inputs['local_view.vt_shift_match'], 40)
    assert 'expected less than half of template_x_size' in panel.text.content
    assert panel.apply.disabled
    page.give(panel.inputs['local_view.template_x_size'], 100)
    assert 'expected' not in panel.text.content and not panel.apply.disabled
    # The controls refuse the first value until they have the second one.
    page.controls.accepts = lambda values: not problem_of(values)
    page.give(panel.apply)
    page.answer()
    assert page.controls.parameters['local_view.vt_shift_match'] == 40
    assert not panel.edits


def test_refused_edits_stay_with_the_reason(page: Page) -> None:
    panel = page.panels.parameters
    page.controls.refusal = 'cannot be set while the node runs'
    page.give(panel.inputs['local_view.vt_max'], 50)
    page.give(panel.apply)
    page.answer()
    assert 'cannot be set while the node runs' in panel.text.content
    assert panel.edits == {'local_view.vt_max': 50}


def test_value_changed_elsewhere_is_shown_beside_edits(page: Page) -> None:
    panel = page.panels.parameters
    page.give(panel.inputs['local_view.vt_shift_match'], 7)
    page.controls.parameters['local_view.vt_max'] = 77
    page.update()
    assert panel.inputs['local_view.vt_max'].value == 77
    assert panel.edits == {'local_view.vt_shift_match': 7}
    assert page.controls.calls == []


def test_replay_runs_again_with_changes(replay: Page) -> None:
    panel = replay.panels.parameters
    assert panel.apply.label == 'Run again with the changes'
    replay.give(panel.inputs['local_view.vt_panoramic'], True)
    replay.give(panel.apply)
    replay.answer()
    assert replay.controls.calls == [
        ('set_parameter', 'local_view.vt_panoramic', True), ('run_again',)
    ]
    assert panel.apply.disabled
    assert not replay.panels.drive.groups
