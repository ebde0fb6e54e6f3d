# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from ratslam_ros.core.config import LEAST_EXP_MAX, SECTIONS, SHARED, Config, section_of
from ratslam_ros.core.config.local_view import LEAST_VT_MAX
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.files.config import (
    BASE,
    ORIGINAL,
    UNNAMED,
    combined_yaml,
    load_config,
    parse_setting,
    preset_config,
    presets,
    stored_config,
    to_yaml,
)

OPENRATSLAM = preset_config(ORIGINAL)


@pytest.fixture
def file(tmp_path: Path) -> Any:
    def write(text: str, name: str = 'a.yaml') -> str:
        path = tmp_path / name
        path.write_text(text, encoding='utf-8')
        return str(path)

    return write


def load(source: str, *notices: str) -> Config:
    config, found = load_config(source)
    assert found == [f'{source}: {notice}' for notice in notices]
    return config


# YAML


def values_of(info: Any, default: Any) -> st.SearchStrategy[Any]:
    if isinstance(default, bool):
        return st.booleans()
    if isinstance(default, str):
        names = st.text('abcXYZ019_/-', min_size=1, max_size=12).filter(
            lambda text: not text.replace('_', '').isdecimal()
        )
        return st.sampled_from(info.choices) if info.choices else names
    if isinstance(default, int):
        low, high = int(info.low), int(info.high)
        return st.integers(low, high).map(lambda v: v | 1 if 'odd' in info.unit else v)
    return st.floats(info.low, info.high)


PARAMETERS = {
    f'{section}.{name}': values_of(info, default)
    for section, cls in SECTIONS.items()
    for name, info, default in cls.parameters()
}
# 0 for no limit; very small limits are rejected.
for _name, _least in (('pose_cells.exp_max', LEAST_EXP_MAX), ('local_view.vt_max', LEAST_VT_MAX)):
    PARAMETERS[_name] = PARAMETERS[_name].filter(
        lambda count, least=_least: not 0 < count < least
    )


@settings(max_examples=20)
@given(st.fixed_dictionaries(PARAMETERS))
def test_values_survive_a_round_trip_through_yaml(values: dict[str, Any]) -> None:
    values['local_view.vt_shift_match'] = 0
    values['local_view.vt_shift_match_y'] = 0
    config = Config().with_values(values)
    document = yaml.safe_load(to_yaml(config))
    read = {}
    for key, section in document.items():
        for name, value in section['ros__parameters'].items():
            if isinstance(value, dict):  # A nested section: its node reads it as name.inner.
                read |= {f'{name}.{inner}': v for inner, v in value.items()}
            else:
                of = section_of(name) if key == '/**' else key.rsplit('/', 1)[-1]
                read[f'{of}.{name}'] = value
    assert Config().with_values(read) == config
    # ROS is strict about types: a float must not be read as text or as an integer.
    assert {k: type(v) for k, v in read.items()} == {
        f'{section}.{name}': type(v) for section, p in config.values().items()
        for name, v in p.items()
    }


def test_written_configuration_is_read_back(file: Any) -> None:
    config = Config().with_values({
        'pose_cells.pc_global_inhib': 2e-05, 'local_view.vt_panoramic': True,
        'pose_cells.pc_dim_xy': 11, 'visual_odometry.vtrans_scaling': 1e-7,
        'inputs.odom_source': 'pose',
    })
    assert load(file(to_yaml(config))) == config


def test_documented_defaults_are_the_defaults(file: Any) -> None:
    text = presets()['default'].read_text('utf-8')
    assert load(file(text)) == Config()
    for section, cls in SECTIONS.items():
        assert section in SHARED or f'/**/{section}:' in text or f'    {section}:\n' in text
        for name, info, _ in cls.parameters():
            assert f'    {name}: ' in text
            assert info.effect in text


@pytest.mark.parametrize('text', [
    'pose_cells:\n  pc_global_inhib: {}\n',
    'pose_cells:\n  ros__parameters:\n    pc_global_inhib: {}\n',
    '/pose_cells:\n  ros__parameters:\n    pc_global_inhib: {}\n',
    '/robot1/pose_cells:\n  ros__parameters:\n    pc_global_inhib: {}\n',
    '/**/pose_cells:\n  ros__parameters:\n    pc_global_inhib: {}\n',
    '/**:\n  ros__parameters:\n    pc_global_inhib: {}\n',
    '/**:\n  ros__parameters:\n    use_sim_time: true\n    pc_global_inhib: {}\n',
    '/**:\n  ros__parameters:\n    pose_cells:\n      pc_global_inhib: {}\n',
    'pose_cells:\n\n  pc_global_inhib: "{}"\n',
])
@pytest.mark.parametrize('number', ['2e-05', '0.00002', '2E-5'])
def test_all_yaml_forms_of_ros_are_read(file: Any, text: str, number: str) -> None:
    """YAML 1.1 reads 2e-05 as text, but users write it as a number."""
    config = load(file(text.format(number)), UNNAMED)
    assert config == OPENRATSLAM


def test_parameter_for_all_nodes_is_shared(file: Any) -> None:
    text = '/**:\n  ros__parameters:\n    odom_source: pose\n    pc_dim_xy: 30\n'
    config = load(file(text), UNNAMED)
    assert config.inputs.odom_source == 'pose'
    assert (config.pose_cells.pc_dim_x, config.pose_cells.pc_dim_y) == (30, 30)


@pytest.mark.parametrize('text', ['', '# nothing\n', 'pose_cells:\n', '/**:\n'])
def test_empty_file_gives_the_defaults(file: Any, text: str) -> None:
    assert load(file(text)) == Config()


@pytest.mark.parametrize(('text', 'hint'), [
    ('local_view:\n  vt_match_treshold: 0.1\n', 'vt_match_threshold'),
    ('local_view:\n  vt_panoramic: true\n  vt_match_threshold: 7\n', '0 to 1'),
    ('local_view:\n  vt_match_threshold:\n', 'number'),
    ('local_view:\n  vt_match_threshold: [0.1]\n', 'number'),
    ('local_view: 3\n', 'parameters below'),
    ('/**:\n  ros__parameters:\n    nonsense: 1\n', 'nonsense'),
    ('nonsense:\n  a: 1\n', 'the sections are'),
    ('local_view:\n  vt_shift_match: 1.5\n', 'whole'),
    ('- 1\n- 2\n', 'sections'),
    ('just text\n', 'sections'),
    ('a: [1,\n', 'cannot be read'),
    ('a: b: c\n', 'cannot be read'),
])
def test_invalid_file_is_reported_in_one_line(file: Any, text: str, hint: str) -> None:
    with pytest.raises((UnusableInput, UnusableParameter), match=r'a\.yaml') as error:
        load_config(file(text))
    assert hint in str(error.value)
    assert '\n' not in str(error.value)


def test_binary_file_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / 'a.yaml'
    path.write_bytes(b'\xff\xfe\x00\x80')
    with pytest.raises(UnusableInput, match='text file'):
        load_config(str(path))


def test_unknown_preset_is_rejected() -> None:
    with pytest.raises(UnusableInput, match='no such file or preset'):
        load_config('no_such_robot')


def test_no_source_gives_the_defaults() -> None:
    assert load_config(None) == load_config('default') == (Config(), [])


def test_former_name_of_the_defaults_gives_them_with_a_notice() -> None:
    assert load_config('auto') == (Config(), ['the preset auto is called default now'])


PARTIAL = {'local_view.vt_shift_match': 3}
PARTIAL_TEXT = 'local_view:\n  ros__parameters:\n    vt_shift_match: 3\n'


@pytest.mark.parametrize(('base', 'config'), [
    ('default', Config()), ('openratslam', OPENRATSLAM), ('irat', load_config('irat')[0]),
])
@pytest.mark.parametrize('form', ['{{ros__parameters: {{base: {}}}}}', '{{base: {}}}'])
def test_partial_file_starts_from_its_base(
    file: Any, base: str, config: Config, form: str
) -> None:
    assert load(file(f'/**: {form.format(base)}\n{PARTIAL_TEXT}')) == config.with_values(PARTIAL)


def test_partial_file_without_base_keeps_its_meaning_with_a_notice(file: Any) -> None:
    assert load(file(PARTIAL_TEXT), UNNAMED) == OPENRATSLAM.with_values(PARTIAL)
    assert '/**: {ros__parameters: {base: openratslam}}' in UNNAMED


@pytest.mark.parametrize('text', [
    '/**: {base: default}\npose_cells: {pc_vt_agree_near: 20.0}',
    '/**: {base: default, pc_vt_agree_near: 20.0}',
])
def test_removed_parameters_are_ignored_with_a_notice(file: Any, text: str) -> None:
    text = f'{text}\n{PARTIAL_TEXT}'
    config, (notice,) = load_config(file(text))
    assert 'pc_vt_agree_near: had no effect on maps' in notice
    assert config == Config().with_values(PARTIAL)


def test_removed_parameter_on_the_command_line_is_named() -> None:
    with pytest.raises(UnusableParameter, match=r'no parameter: .* leave it out'):
        Config().with_values({'pose_cells.pc_vt_agree_near': 20.0})


@pytest.mark.parametrize('base', ['no_such_robot', 7, '[1]'])
def test_unknown_base_is_rejected(file: Any, base: Any) -> None:
    with pytest.raises(UnusableInput, match=r'a\.yaml: no such .*the presets are .*default'):
        load_config(file(f'/**: {{{BASE}: {base}}}\n'))


@pytest.mark.parametrize('installed', ['lib/python3.12/site-packages', 'lib/site-packages'])
def test_presets_are_found_beside_installed_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, installed: str
) -> None:
    share = tmp_path / 'share' / 'ratslam_ros' / 'config'
    share.mkdir(parents=True)
    (share / 'default.yaml').write_text('')
    module = tmp_path / installed / 'ratslam_ros' / 'files' / 'config.py'
    monkeypatch.setattr('ratslam_ros.files.config.__file__', str(module))
    assert presets()['default'] == share / 'default.yaml'


# INI files of OpenRatSLAM

INI = """\
topic_root=robot
# a comment of its own line
[visual_odometry]
vtrans_image_x_min=195 ; behind a value
vtrans_image_x_max=475
camera_fov_deg=53   # this one too
; and this
[local_view]
vt_panoramic=0
vt_shift_match = 5
vt_match_threshold=0.085
template_x_size=60
template_y_size=10
image_crop_x_min=40

[pose_cells]
pc_dim_xy=30
pc_global_inhib=2e-05
exp_delta_pc_threshold=1.0
[experience_map]
exp_loops=20
exp_initial_em_deg=140
[draw]
enable=1
exp_map_size=110
"""


def test_openratslam_ini_file_is_read(file: Any) -> None:
    config, notices = load_config(file(INI, 'config_robot.txt'))
    assert config == OPENRATSLAM.with_values({
        'visual_odometry.vtrans_image_x_min': 195, 'visual_odometry.vtrans_image_x_max': 475,
        'visual_odometry.camera_fov_deg': 53.0, 'local_view.vt_shift_match': 5,
        'local_view.vt_match_threshold': 0.085, 'local_view.template_x_size': 60,
        'local_view.template_y_size': 10, 'local_view.image_crop_x_min': 40,
        'pose_cells.pc_dim_xy': 30, 'pose_cells.pc_global_inhib': 2e-05,
        'pose_cells.exp_delta_pc_threshold': 1.0, 'experience_map.exp_loops': 20,
        'experience_map.exp_initial_em_deg': 140.0,
    })
    (notice,) = notices
    for unused in ('topic_root', 'draw.enable', 'draw.exp_map_size'):
        assert unused in notice


PORT_NAMES = {
    **{
        f'{kind}-IMAGE-{axis}-{end}': f'visual_odometry.{kind}_image_{axis}_{end}'.lower()
        for kind in ('VTRANS', 'VROT') for axis in 'XY' for end in ('MIN', 'MAX')
    },
    **{
        f'IMAGE-VT-{axis}-RANGE-{end}': f'local_view.image_crop_{axis}_{end}'.lower()
        for axis in 'XY' for end in ('MIN', 'MAX')
    },
    'VT-MATCH-THRESHOLD': 'local_view.vt_match_threshold',
    'VT-NORMALISATION': 'local_view.vt_normalisation',
    'TEMPLATE-X-SIZE': 'local_view.template_x_size',
    'TEMPLATE-Y-SIZE': 'local_view.template_y_size',
    'PC-VT-INJECT-ENERGY': 'pose_cells.pc_vt_inject_energy',
    'PC-GLOBAL-INHIB': 'pose_cells.pc_global_inhib',
    'PC-W-E-DIM': 'pose_cells.pc_w_e_dim',
}
"""The parameters that the documentation of the Python port names (July 2017), and ours."""


@pytest.mark.parametrize('name, spelling', [
    *((name, str) for name in PORT_NAMES),
    ('PC-W-E-DIM', lambda name: name.replace('-', '_')), ('PC-W-E-DIM', str.lower),
])
def test_names_of_python_port_are_accepted(file: Any, name: str, spelling: Any) -> None:
    key, written = PORT_NAMES[name], spelling(name)
    value = 61 if 'DIM' in name or 'SIZE' in name or 'IMAGE' in name else 0.5
    expected = OPENRATSLAM.with_values({key: value})
    assert expected != OPENRATSLAM
    section = key.partition('.')[0]
    for text, path in (
        (f'{written} = {value}\n', 'a.ini'),
        (f'/**: {{base: openratslam}}\n{section}: {{{written}: {value}}}\n', 'a.yaml'),
        (f'/**: {{base: openratslam, {written}: {value}}}\n', 'b.yaml'),
    ):
        assert load_config(file(text, path)) == (expected, [])
    assert OPENRATSLAM.with_values({f'{section}.{written}': value}) == expected


def test_misspelled_name_is_answered_with_nearest_known_in_either_spelling() -> None:
    for name in ('VT-MATCH-TRESHOLD', 'vt_match_treshold'):
        with pytest.raises(UnusableParameter, match='nearest known: vt_match_threshold') as error:
            OPENRATSLAM.with_values({f'local_view.{name}': 0.5})
        assert str(error.value).count(',') <= 3


@pytest.mark.parametrize('name', [
    'IMAGE-WIDTH', 'IMAGE_HEIGHT', 'image_width', 'PC_CELLS_TO_AVG',
])
def test_needless_names_of_python_port_are_refused_with_reason(file: Any, name: str) -> None:
    used = {'local_view.vt_shift_match': 3}
    for text, path in (
        (f'{name}=64\nVT_SHIFT_MATCH=3\n', 'a.ini'),
        (f'/**: {{base: openratslam, {name}: 64, VT_SHIFT_MATCH: 3}}\n', 'a.yaml'),
    ):
        config, (notice,) = load_config(file(text, path))
        assert config == OPENRATSLAM.with_values(used)
        assert re.search(f'{name}: is always .*; leave it out', notice)
    with pytest.raises(UnusableParameter, match='is no parameter: it is always'):
        Config().with_values({f'local_view.{name}': 64})


def test_ini_section_of_parameter_is_ignored(file: Any) -> None:
    """OpenRatSLAM has some parameters in other sections."""
    config, _ = load_config(file('vt_panoramic=1\n[pose_cells]\nexp_loops=3\n', 'a.ini'))
    assert config.local_view.vt_panoramic is True
    assert config.experience_map.exp_loops == 3


@pytest.mark.parametrize(('name', 'text'), [
    ('a.ini', '[local_view]\nvt_panoramic=1\n'), ('a.yaml', 'local_view: {vt_panoramic: true}\n'),
])
def test_byte_order_mark_of_an_editor_is_ignored(file: Any, name: str, text: str) -> None:
    config, _ = load_config(file(f'\ufeff{text}', name))
    assert config.local_view.vt_panoramic is True


@pytest.mark.parametrize('text', [
    'vt_match_threshold=9\n', 'vt_match_threshold=wide\n', '[local_view]\nvt_step_match=0\n',
    'exp_loops=2.5\n',
])
def test_invalid_ini_value_is_reported(file: Any, text: str) -> None:
    with pytest.raises(UnusableParameter, match=r'robot\.ini'):
        load_config(file(text, 'robot.ini'))


@pytest.mark.parametrize(
    'text', ['', 'hello\n', '[draw]\nenable=1\n', '\x00\x01', '[local_view\n']
)
def test_file_without_parameters_is_rejected(file: Any, text: str) -> None:
    with pytest.raises(UnusableInput) as error:
        load_config(file(text, 'a.txt'))
    assert '\n' not in str(error.value)


# --set


@pytest.mark.parametrize(('text', 'expected'), [
    ('local_view.vt_panoramic=true', True), ('local_view.vt_panoramic=False', False),
    ('pose_cells.pc_dim_th=36', 36), ('pose_cells.pc_global_inhib=2e-05', 2e-05),
    ('inputs.odom_source=pose', 'pose'), ('a.b = -1.5 ', -1.5), ('a.b=', ''),
    ('a.b=c=d', 'c=d'),
])
def test_setting_is_parsed_with_its_type(text: str, expected: Any) -> None:
    key, value = parse_setting(text)
    assert key == text.partition('=')[0].strip()
    assert value == expected
    assert type(value) is type(expected)


def test_setting_without_equals_sign_is_rejected() -> None:
    with pytest.raises(UnusableParameter, match=r'section\.name=value'):
        parse_setting('local_view.vt_panoramic')


def test_sections_that_contradict_each_other_are_refused(file: Any) -> None:
    text = 'pose_cells: {odom_source: pose}\nexperience_map: {odom_source: twist}\n'
    with pytest.raises(UnusableParameter, match=r'a\.yaml: pose_cells.odom_source .* experience_'):
        load_config(file(text))


def test_sections_of_nodes_are_combined_in_any_order() -> None:
    """Each node writes its own section; some of their values must be equal."""
    whole = Config()
    assert whole.inputs.max_odom_gap_s != OPENRATSLAM.inputs.max_odom_gap_s
    parts = 'local_view', 'pose_cells', 'experience_map'
    for names in (parts, parts[::-1]):
        text = ''
        for name in names:
            text = combined_yaml(text, to_yaml(whole, [name]))
            partial, notices = stored_config(text, 'the map')
            assert getattr(partial, name) == getattr(whole, name)
            assert notices == []
        assert text == to_yaml(whole, names)


def test_shared_values_of_the_later_node_hold() -> None:
    one, other = (
        Config().with_values({'inputs.odom_source': source}) for source in ('twist', 'pose')
    )
    text = combined_yaml(to_yaml(one, ['pose_cells']), to_yaml(other, ['experience_map']))
    config, notices = stored_config(text, 'the map')
    assert config.inputs.odom_source == 'pose'
    assert config.pose_cells == one.pose_cells
    assert notices == []


def test_stored_sections_of_earlier_versions_may_contradict_each_other() -> None:
    text = 'local_view: {odom_source: pose}\npose_cells: {odom_source: twist}\n'
    config, notices = stored_config(text, 'the map')
    assert config.inputs.odom_source == 'twist'
    assert notices == ['the map: local_view.odom_source was pose, twist is used']


def test_stored_colours_of_earlier_versions_are_weighted() -> None:
    """They had no image_grey, and maps must not be continued with other views."""
    config, _ = stored_config('local_view: {vt_descriptor: intensity}\n', 'the map')
    assert config.inputs.image_grey == 'luma'
