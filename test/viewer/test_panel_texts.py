# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from msgspec.structs import replace
from viewer_doubles import BEGIN_NS, STEP_NS, view_at

from ratslam_ros.core.config import Config
from ratslam_ros.history.records import MatchRecord
from ratslam_ros.viewer.panels import html
from ratslam_ros.viewer.panels.drive import diagnostics_html
from ratslam_ros.viewer.panels.export import file_name
from ratslam_ros.viewer.panels.parameters import found, problem_of
from ratslam_ros.viewer.panels.pictures import PLOT_POINTS, error_curves, match_picture
from ratslam_ros.viewer.panels.texts import (
    agreement_text,
    decision_text,
    joins,
    time_text,
    told_apart,
)


@pytest.mark.parametrize(
    ('seconds', 'text'),
    [(0.0, '0:00.0'), (59.96, '1:00.0'), (83.44, '1:23.4'), (3725.0, '1:02:05.0'), (-1, '0:00.0')],
)
def test_time_text_counts_minutes_and_hours(seconds: float, text: str) -> None:
    assert time_text(seconds) == text


@pytest.mark.parametrize(
    ('agreement', 'required', 'text'),
    [
        (0.6, 5.0, '3 of 5 views agree'), (1.0, 7.0, '7 of 7 views agree'),
        (1.0, 2.5, '3 of 2.5 views agree'), (3 / 7, 7.0, '3 of 7 views agree'),
        (1.0, 0.0, 'no agreement required'), (0.43, None, 'agreement 43%'),
    ],
)
def test_agreement_is_a_number_of_views(
    agreement: float, required: float | None, text: str
) -> None:
    view = replace(view_at(25), agreement=agreement)
    assert agreement_text(view, required) == text
    assert text in decision_text(view, required)


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
    ):
        assert '<script>' not in text and '&lt;script&gt;' in text


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
