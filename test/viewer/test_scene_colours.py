# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from synthetic_runs import SyntheticRun

from ratslam_ros.core.mapping.map_changes import ExperienceRows, LinkRows, MapChange
from ratslam_ros.history.run_state import RunState
from ratslam_ros.viewer.scene.colouring import COLOURINGS, map_colours, travel_times
from ratslam_ros.viewer.scene.palette import DARK, LIGHT, Rgb, scale_colours, scaled

themes = pytest.mark.parametrize('theme', [LIGHT, DARK], ids=['light', 'dark'])


def chain(durations_s: list[float]) -> RunState:
    n = len(durations_s) + 1
    ends = np.stack([np.arange(n - 1), np.arange(1, n)], 1)
    rows = LinkRows(
        ends, np.ones((n - 1, 3)), np.array(durations_s), np.ones(n - 1),
        np.ones(n - 1, np.int64), np.zeros(n - 1, np.bool_), ('',) * (n - 1),
    )
    ids = np.arange(n)
    state = RunState()
    state.apply(
        MapChange(1, n, 0, True, ExperienceRows(ids, ids, np.zeros((n, 3)), 0 * ids), rows)
    )
    return state


def luminance(colour: Rgb) -> float:
    """Return the relative luminance of a colour, from 0 to 1, as WCAG 2 defines it."""
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
        for c in (part / 255 for part in colour)
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a: Rgb, b: Rgb) -> float:
    """Return the contrast ratio of two colours, from 1 to 21, as WCAG 2 defines it."""
    light, dark = sorted((luminance(a), luminance(b)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


@themes
def test_text_and_marks_contrast_with_background(theme) -> None:
    assert contrast(theme.text, theme.background) > 7.0
    for name in ('driven', 'experience', 'recognised', 'closure', 'robot', 'truth', 'rejected',
                 'goal', 'dead_reckoning', 'selected'):
        assert contrast(getattr(theme, name), theme.background) > 2.5, name


@themes
def test_high_values_contrast_more_than_low(theme) -> None:
    contrasts = [contrast(tuple(c), theme.background) for c in scale_colours(theme).tolist()]
    assert contrasts == sorted(contrasts)
    assert contrasts[0] > 1.5


def test_scaled_clips_and_marks_unknown_values() -> None:
    colours = scaled(np.array([-1.0, 0.0, 5.0, 9.0, np.nan, np.inf]), 0.0, 5.0, LIGHT)
    table = scale_colours(LIGHT)
    np.testing.assert_array_equal(
        colours, [table[0], table[0], table[-1], table[-1], LIGHT.unknown, LIGHT.unknown]
    )


@themes
@pytest.mark.parametrize('name', COLOURINGS)
def test_every_colouring_has_colours_and_legend(name, theme) -> None:
    state = SyntheticRun(150).state()
    colours = map_colours(name, state, theme)
    assert colours.experiences.shape == (150, 3)
    assert colours.links.shape == (len(state.map.link_rows), 3)
    assert all(text for _, text in colours.legend)
    shown = {colour for colour, _ in colours.legend}
    coloured = colours.links if name in ('confidence', 'behaviour') else colours.experiences
    if name in ('plain', 'behaviour'):
        assert {tuple(c) for c in coloured.tolist()} <= shown


def test_age_ends_at_robot_and_has_units() -> None:
    state = SyntheticRun(100).state()
    colours = map_colours('age', state, LIGHT)
    table = scale_colours(LIGHT)
    np.testing.assert_array_equal(colours.experiences[-1], table[0])
    assert not np.array_equal(colours.experiences[0], table[0])
    assert colours.legend[0][1] == '0 s time since it was created'
    assert colours.legend[4][1] == '10 s'


def test_links_are_driven_recognised_or_closures() -> None:
    state = chain([1.0] * 30)
    rows = state.map.link_rows
    rows.recognised[3] = True
    rows.ends[5] = 29, 2
    links = map_colours('plain', state, LIGHT).links
    np.testing.assert_array_equal(links[0], LIGHT.driven)
    np.testing.assert_array_equal(links[3], LIGHT.recognised)
    np.testing.assert_array_equal(links[5], LIGHT.closure)


def test_other_components_are_pale() -> None:
    state = chain([1.0, 1.0])
    state.map.components[2] = 1
    colours = map_colours('plain', state, LIGHT)
    assert colours.experiences.tolist() == [list(LIGHT.experience)] * 2 + [list(LIGHT.unknown)]
    assert 'not connected' in colours.legend[-1][1]


def test_travel_times_add_durations_both_ways() -> None:
    state = chain([1.0, 2.0, 4.0])
    np.testing.assert_allclose(travel_times(state.map), [0, 1, 3, 7])
    state.map.current_id = 2
    np.testing.assert_allclose(travel_times(state.map), [3, 2, 0, 4])


def test_travel_times_take_zero_duration_links() -> None:
    np.testing.assert_allclose(travel_times(chain([0.0, 1.0]).map), [0, 0, 1], atol=0.01)


def test_travel_times_without_way_are_infinite() -> None:
    state = chain([1.0, 1.0])
    state.apply(MapChange(2, 4, 0, removed_links=np.array([[0, 1]])))
    assert travel_times(state.map).tolist() == [0.0, np.inf, np.inf, np.inf]
    state.map.current_id = -1
    assert np.isinf(travel_times(state.map)).all()
