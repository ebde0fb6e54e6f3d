# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every parameter is validated, and a failed change changes nothing."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import pytest

from ratslam_ros.core.config import (
    AUTOMATIC,
    SECTIONS,
    Config,
    LocalViewParameters,
    PoseCellsParameters,
    Section,
    parameter,
    section_of,
)
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.files.config import ORIGINAL, preset_config

PARAMETERS = [
    (section, name, info, default)
    for section, cls in SECTIONS.items()
    for name, info, default in cls.parameters()
]
IDS = [f'{section}.{name}' for section, name, _, _ in PARAMETERS]
each = pytest.mark.parametrize(('section', 'name', 'info', 'default'), PARAMETERS, ids=IDS)


def refused(key: str, value: Any) -> str:
    """Return the error message for an invalid value."""
    with pytest.raises(UnusableParameter) as error:
        Config().with_values({key: value})
    return str(error.value)


@each
def test_parameter_has_help_text_and_accepts_its_default(
    section: str, name: str, info: Any, default: Any
) -> None:
    assert info.effect.endswith('.')
    assert getattr(getattr(Config(), section), name) == default
    changed = Config().with_values({f'{section}.{name}': default})
    assert changed == Config()
    assert type(getattr(getattr(changed, section), name)) is type(default)


@each
def test_value_of_wrong_type_or_range_is_refused(
    section: str, name: str, info: Any, default: Any
) -> None:
    if isinstance(default, (bool, str)):
        any_name = isinstance(default, str) and not info.choices
        text = 'two words' if any_name else 'nonsense'
        texts = (text, '') if default != '' else ('a\nb', 'x' * 5000)  # '': path of a file
        for wrong in (7, None, 2.5, [True], *texts):
            assert name in refused(f'{section}.{name}', wrong)
        return
    assert info.lowest <= default <= info.high
    whole = isinstance(default, int)
    for wrong in (info.lowest - 1, info.high + 1, math.nan, math.inf, -math.inf):
        assert name in refused(f'{section}.{name}', wrong)
    for wrong in ('text', None, True, [1], '3'):
        assert name in refused(f'{section}.{name}', wrong)
    if whole:
        assert 'whole' in refused(f'{section}.{name}', default + 0.5)


@each
def test_whole_values_are_converted_to_the_declared_type(
    section: str, name: str, info: Any, default: Any
) -> None:
    if isinstance(default, bool):
        value: Any = int(default)
    elif isinstance(default, int):
        value = float(default)
    elif isinstance(default, float) and default == int(default):
        value = int(default)
    else:
        value = default
    read = getattr(getattr(Config().with_values({f'{section}.{name}': value}), section), name)
    assert read == default
    assert type(read) is type(default)


@pytest.mark.parametrize(('section', 'name', 'default'), [
    ('local_view', 'vt_match_threshold', 0.03), ('local_view', 'vt_normalisation', 0.0),
    ('local_view', 'vt_shift_match', 5), ('local_view', 'vt_step_match', 1),
    ('local_view', 'vt_patch_normalise', 0), ('local_view', 'vt_panoramic', False),
    ('local_view', 'vt_min_patch_normalisation_std', 0.0),
    ('pose_cells', 'pc_dim_x', 21), ('pose_cells', 'pc_dim_y', 21),
    ('pose_cells', 'pc_dim_th', 36),
    ('pose_cells', 'pc_w_e_dim', 7), ('pose_cells', 'pc_w_e_var', 1.0),
    ('pose_cells', 'pc_w_i_dim', 5), ('pose_cells', 'pc_w_i_var', 2.0),
    ('pose_cells', 'pc_global_inhib', 0.00002), ('pose_cells', 'pc_cell_x_size', 1.0),
    ('pose_cells', 'vt_active_decay', 1.0), ('pose_cells', 'pc_vt_inject_energy', 0.15),
    ('pose_cells', 'pc_vt_restore', 0.05), ('pose_cells', 'exp_delta_pc_threshold', 2.0),
    ('inputs', 'max_lateness_s', 2.0), ('inputs', 'odom_source', 'twist'),
    ('experience_map', 'exp_correction', 0.5), ('experience_map', 'exp_loops', 10),
    ('experience_map', 'exp_initial_em_deg', 90.0),
    ('visual_odometry', 'camera_fov_deg', 50.0), ('visual_odometry', 'camera_hz', 10.0),
    ('visual_odometry', 'vtrans_scaling', 100.0), ('visual_odometry', 'vtrans_max', 20.0),
    ('visual_odometry', 'vrot_image_x_min', 0), ('visual_odometry', 'vtrans_image_y_max', -1),
    ('local_view', 'image_crop_x_min', 0), ('local_view', 'image_crop_y_max', -1),
])
def test_names_and_defaults_match_openratslam(section: str, name: str, default: Any) -> None:
    assert preset_config(ORIGINAL).values()[section][name] == default


def test_one_invalid_value_leaves_config_unchanged() -> None:
    config = Config()
    with pytest.raises(UnusableParameter):
        config.with_values({'local_view.vt_shift_match': 3, 'pose_cells.pc_dim_th': -1})
    assert config == Config()


def test_interdependent_values_are_validated_together() -> None:
    """Each change alone would leave no columns to compare."""
    config = Config().with_values({'local_view.vt_shift_match': 40,
                                   'local_view.template_x_size': 100})
    assert config.local_view.vt_shift_match == 40
    back = config.with_values({'local_view.template_x_size': 12, 'local_view.vt_shift_match': 2})
    assert back.local_view.template_x_size == 12


def test_pc_dim_xy_sets_both_dimensions() -> None:
    config = Config().with_values({'pose_cells.pc_dim_xy': 30})
    assert (config.pose_cells.pc_dim_x, config.pose_cells.pc_dim_y) == (30, 30)
    later = config.with_values({'pose_cells.pc_dim_y': 11})
    assert (later.pose_cells.pc_dim_x, later.pose_cells.pc_dim_y) == (30, 11)
    assert 'pc_dim_x' in refused('pose_cells.pc_dim_xy', 0)


@pytest.mark.parametrize(('key', 'hint'), [
    ('local_view.vt_match_treshold', 'vt_match_threshold'),
    ('pose_cells.pc_dim', 'pc_dim_x'),
    ('local_view.pc_dim_th', 'pose_cells.pc_dim_th'),
    ('vt_match_threshold', 'local_view.vt_match_threshold'),
    ('localview.vt_panoramic', 'local_view.vt_panoramic'),
    ('nonsense.nonsense', 'the sections are inputs, memory, visual_odometry'),
    ('pc_dim_xy', 'pose_cells.pc_dim_xy'),
    ('experience_map.exp_loop', 'exp_loops'),
])
def test_unknown_name_error_suggests_closest_known(key: str, hint: str) -> None:
    text = refused(key, 1)
    assert hint in text
    assert key.rpartition('.')[2] in text


def test_shared_parameter_may_be_given_in_any_section() -> None:
    expected = Config().with_values({'inputs.odom_source': 'pose'})
    one = {'pose_cells.odom_source': 'pose'}
    assert Config().with_values(one) == expected
    assert Config().with_values({**one, 'experience_map.odom_source': 'pose'}) == expected
    with pytest.raises(UnusableParameter, match=(
        r"pose_cells.odom_source is 'pose' and local_view.odom_source is 'twist'; expected one .*"
        r'inputs.odom_source'
    )):
        Config().with_values({**one, 'local_view.odom_source': 'twist'})


@pytest.mark.parametrize('name', ['pc_w_e_dim', 'pc_w_i_dim'])
def test_even_kernel_width_is_refused(name: str) -> None:
    assert 'odd' in refused(f'pose_cells.{name}', 6)
    assert 'pose_cells.' in refused(f'pose_cells.{name}', 6)


def test_shifts_beyond_half_the_template_are_refused() -> None:
    assert 'vt_shift_match' in refused('local_view.vt_shift_match', 6)
    assert 'vt_shift_match_y' in refused('local_view.vt_shift_match_y', 5)
    LocalViewParameters(vt_shift_match=5)
    LocalViewParameters(vt_shift_match=6, vt_panoramic=True)  # no effect if panoramic


def test_error_names_value_and_expected_range() -> None:
    text = refused('local_view.vt_match_threshold', 3.5)
    assert 'local_view.vt_match_threshold' in text
    assert '3.5' in text
    assert '0 to 1' in text
    assert 'twist, pose' in refused('inputs.odom_source', 'wheel')


def test_config_is_immutable() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        Config().pose_cells.pc_dim_x = 5  # type: ignore[misc]


def test_section_validates_values_when_constructed() -> None:
    with pytest.raises(UnusableParameter, match='pc_dim_x'):
        PoseCellsParameters(pc_dim_x=0)


def test_section_of_finds_every_name() -> None:
    for section, name, _, _ in PARAMETERS:
        found = section_of(name)
        assert found is not None
        assert name in dict.fromkeys(n for n, _, _ in SECTIONS[found].parameters())
        assert found == section or name in (
            'publish_tf', 'odom_frame', 'base_frame', 'map_frame', 'map_period_s'
        )
    assert section_of('nonsense') is None


def test_values_has_all_parameters_in_declared_order() -> None:
    assert [
        (section, name) for section, values in Config().values().items() for name in values
    ] == [(section, name) for section, name, _, _ in PARAMETERS]


@dataclass(frozen=True)
class _Automatic(Section):
    length_m: float = parameter(2.0, 'A length.', unit='m', low=0.5, high=9.0, automatic=True)
    count: int = parameter(3, 'A number.', unit='views', low=1, high=9, automatic=True)


def test_automatic_parameters_accept_minus_one_and_their_range() -> None:
    assert _Automatic(AUTOMATIC, AUTOMATIC) == _Automatic(-1.0, -1)
    for wrong in (-0.5, 0.4, 9.5):
        with pytest.raises(UnusableParameter, match=r'expected 0.5 to 9, or -1 \(automatic\) m'):
            _Automatic(length_m=wrong)
    with pytest.raises(UnusableParameter, match='expected a whole number'):
        _Automatic(count=-0.5)
