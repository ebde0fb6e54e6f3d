# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest
from viewer_doubles import BEGIN_NS, STEP_NS, FakeRun, records_of, view_at

from ratslam_ros.core.config import DECLARATIONS, Config
from ratslam_ros.history.records import CellsRecord, MatchRecord
from ratslam_ros.viewer.panels import html
from ratslam_ros.viewer.panels.drive import diagnostics_html, log_html, status_html
from ratslam_ros.viewer.panels.export import file_name
from ratslam_ros.viewer.panels.parameters import found, hint_text, problem_of
from ratslam_ros.viewer.panels.pictures import PLOT_POINTS, error_curves, match_picture
from ratslam_ros.viewer.panels.texts import (
    agreement_text,
    cells_text,
    closure_text,
    decision_text,
    explained,
    joins,
    match_picture_text,
    match_text,
    playback_text,
    stamp_text,
    time_text,
    told_apart,
    verdict,
)
from ratslam_ros.viewer.playback import Playback


@pytest.mark.parametrize(
    ('seconds', 'text'),
    [(0.0, '0:00.0'), (59.96, '1:00.0'), (83.44, '1:23.4'), (3725.0, '1:02:05.0'), (-1, '0:00.0')],
)
def test_time_text_counts_minutes_and_hours(seconds: float, text: str) -> None:
    assert time_text(seconds) == text


def test_stamp_text_distinguishes_calendar_time() -> None:
    assert stamp_text(12_340_000_000) == 'stamp 12.34 s'
    assert stamp_text(1_700_000_000_500_000_000) == '2023-11-14 22:13:20.5 UTC'


def test_playback_text_names_every_mode() -> None:
    run = FakeRun(0, is_growing=True)
    playback = Playback(run)
    assert playback_text(playback)[1] == 'waiting for the first data'
    run.grow(9)
    playback.tick(0.0)
    assert playback_text(playback)[1].startswith('live')
    playback.speed = 2.0
    playback.seek(BEGIN_NS)
    assert playback_text(playback)[1] == 'playing at 2×'
    playback.pause()
    assert playback_text(playback)[1] == 'paused'
    playback.seek(run.end_ns)
    assert playback_text(playback)[1] == 'paused at the end'
    run.is_growing = False
    playback.tick(0.0)
    assert playback_text(playback)[1] == 'end of the run'


def test_match_text_compares_error_with_threshold() -> None:
    view = view_at(25)
    assert match_text(view) == 'template 5 matched: error 0.0150 of 0.0300'
    assert match_text(replace(view, error=-1.0)) == 'template 5 matched'
    new = replace(view, is_new=True)
    assert match_text(new) == 'new template 5: error 0.0150 of 0.0300, but no certain match'
    worse = match_text(replace(new, error=0.05))
    assert worse == 'new template 5: best error 0.0500 exceeds 0.0300'
    assert 'too uniform' in match_text(replace(view, template_id=-1))


@pytest.mark.parametrize(
    ('agreement', 'required', 'text'),
    [
        (0.6, 5.0, '3 of 5 views agree'), (1.0, 7.0, '7 of 7 views agree'),
        (1.0, 2.5, '3 of 2.5 views agree'), (3 / 7, 7.0, '3 of 7 views agree'),
        (1.0, 0.0, 'no agreement required'), (0.43, None, 'agreement 43%'),
    ],
)  # fmt: skip
def test_agreement_is_a_number_of_views(
    agreement: float, required: float | None, text: str
) -> None:
    view = replace(view_at(25), agreement=agreement)
    assert agreement_text(view, required) == text
    assert text in decision_text(view, required)


def test_picture_of_an_earlier_match_says_so() -> None:
    picture = np.zeros((4, 12), np.uint8)
    match = MatchRecord(BEGIN_NS, 7, picture, picture, -2)
    assert match_picture_text(match, BEGIN_NS) == (
        'template 7: shifted 2 px to the left; as compared, 12 × 4 px'
    )
    assert 'template 7 0.5 s before: ' in match_picture_text(match, BEGIN_NS + STEP_NS)


def test_decision_text_names_action_and_reason() -> None:
    assert decision_text(view_at(3)) == 'experience 3 created'
    assert decision_text(view_at(20)) == (
        'recognised experience 0 (agreement 100%); experience 0 linked'
    )
    assert decision_text(view_at(23)) == (
        'rejected: loop closure to experience 3 moves the robot by 4.0 m'
    )
    assert 'moved to experience 5' in decision_text(view_at(25))
    assert 'laser scans' in decision_text(replace(view_at(25), relocated_to=7))
    assert decision_text(replace(view_at(3), action='none', target_id=-1)) == 'no experience yet'


def test_closure_texts_are_distinct() -> None:
    texts = [closure_text(view, BEGIN_NS) for view in FakeRun(60).closures(10**18)]
    assert texts == ['0:10.00  19 → 0  closed', '0:11.50  2 → 3  rejected']


def test_verdict_depends_on_reason_and_agreement() -> None:
    view = view_at(25)
    for other, expected in (
        (view, 'closed'), (replace(view, action='none'), 'closed'),
        (replace(view, action='none', agreement=0.5), 'weak'),
        (replace(view, agreement=0.0), 'closed'),
        (replace(view, reason='too far'), 'rejected'),
        (replace(view, relocated_to=3), 'relocated'),
    ):  # fmt: skip
        assert verdict(other) == expected
        assert explained(other)
    assert explained(replace(view, reason='too far')) == 'too far'


def test_view_joins_recognised_experience_with_source_and_target() -> None:
    view = replace(view_at(25), source_id=40, target_id=41, recognised_id=5)
    assert joins(view, (41, 5)) and joins(view, (5, 40))
    assert not joins(view, (40, 41)) and not joins(view, (5, 6))


def test_listed_closures_are_apart_in_time_or_verdict() -> None:
    views = [view_at(k) for k in range(25, 45)]
    kept = told_apart([*views, replace(view_at(45), reason='too far')])
    assert [view.stamp_ns - BEGIN_NS for view in kept] == [
        STEP_NS * k for k in (25, 29, 33, 37, 41, 45)
    ]
    assert told_apart([]) == []


def test_cells_text_names_energy_and_largest_packet() -> None:
    (cells,) = [record for record in records_of(4) if isinstance(record, CellsRecord)]
    rows = dict(cells_text(cells))
    assert rows['energy'] == '0.800 in 2 active cells'
    assert rows['packets'].startswith('1;')
    assert 'heading 30°' in rows['peak']
    bare = CellsRecord(0, (2, 2, 2), np.empty((0, 3), np.int64), np.empty(0))
    assert dict(cells_text(bare)) == {
        'size': '2 × 2 × 2 cells (x, y, heading)', 'energy': '0.000 in 0 active cells',
    }  # fmt: skip


@pytest.mark.parametrize('shift', [-3, 0, 3])
def test_match_picture_puts_same_columns_above_each_other(shift: int) -> None:
    scene = np.arange(100, 130, dtype=np.uint8)[None, :].repeat(4, axis=0)
    # A feature at column c of the template is at column c + shift of the view.
    view, template = scene[:, 5 - shift : 17 - shift], scene[:, 5:17]
    picture = match_picture(MatchRecord(0, 1, view, template, shift))
    assert picture.shape[1] >= 320 and picture.shape[2] == 3
    zoom = picture.shape[1] // (12 + abs(shift))
    middle = picture[:, zoom // 2 :: zoom][:, abs(shift) : 12]
    assert len(middle[0]) > 5
    assert (middle[0] == middle[-1]).all()


def test_error_curves_mark_new_templates_without_unknown_errors() -> None:
    views = [replace(view_at(k), error=-1.0 if k == 0 else 0.01) for k in range(0, 40)]
    x, error, threshold, new = error_curves(views, views[-1].stamp_ns)
    assert x[-1] == 0.0 and x[0] == pytest.approx(-38 * STEP_NS / 1e9)
    # NaN would leave the page without a scale, and so without curves.
    assert (error == 0.01).all() and (threshold == 0.03).all()
    assert np.isfinite(new[:19]).all() and np.isnan(new[19:]).all()


@pytest.mark.parametrize('count', [0, 1, PLOT_POINTS, 10 * PLOT_POINTS + 7])
def test_error_curves_are_limited_and_end_at_newest_view(count: int) -> None:
    views = [view_at(k) for k in range(count)]
    x, *_ = error_curves(views, BEGIN_NS + (count - 1) * STEP_NS)
    assert len(x) <= PLOT_POINTS
    assert len(x) == min(count, len(x)) and (not count or x[-1] == 0.0)


def test_texts_from_outside_cannot_be_html() -> None:
    evil = '<script>x</script>'
    for text in (
        html.strong(evil), html.dim(evil), html.table([[evil]], [evil]),
        html.mark(evil, (0, 0, 0)), html.legend([((0, 0, 0), evil)]),
        html.pictures([(None, evil)]),
        diagnostics_html({evil: ('WARN', evil)}), diagnostics_html({'node': (evil, '')}),
    ):  # fmt: skip
        assert '<script>' not in text and '&lt;script&gt;' in text


def test_diagnostics_have_symbol_and_word_beside_colour() -> None:
    text = diagnostics_html({'a': ('OK', ''), 'b': ('WARN', 'late'), 'c': ('STRANGE', '')})
    for part in ('●', 'OK', '▲', 'WARN', 'late', '■', 'STRANGE'):
        assert part in text
    assert diagnostics_html({}) == '' == log_html([])


def test_unreadable_status_is_reported() -> None:
    from ratslam_ros.history.records import StatusRecord

    assert status_html(None) == ''
    assert 'experience_map/status' in status_html(StatusRecord(0, 'no JSON'))


def test_hint_states_effect_unit_range_and_default() -> None:
    info, default = DECLARATIONS['local_view.vt_match_threshold']
    hint = hint_text(info, default)
    for part in (info.effect, info.unit, info.range_text, str(default), info.raise_if):
        assert part in hint


def test_every_parameter_has_a_hint() -> None:
    for info, default in DECLARATIONS.values():
        assert 'Default' in hint_text(info, default)


def test_search_finds_names_and_descriptions_in_all_sections() -> None:
    values = Config().flat()
    assert set(found(values, 'local_view', '')) == {
        key for key in values if key.startswith('local_view.')
    }
    names = found(values, 'local_view', 'loop gate')
    assert 'experience_map.exp_gate_closures' in names
    assert len(found(values, 'all sections', '')) == len(values)


def test_values_are_validated_together() -> None:
    assert problem_of({'local_view.vt_shift_match': 5}) == ''
    assert 'template_x_size' in problem_of({'local_view.vt_shift_match': 30})
    assert not problem_of({'local_view.vt_shift_match': 30, 'local_view.template_x_size': 99})


def test_file_name_has_only_portable_characters() -> None:
    assert file_name('my run/../é 1:23.4', '.png') == 'my-run-..-1-23.4.png'
    assert file_name('é', '.html') == 'run.html'
