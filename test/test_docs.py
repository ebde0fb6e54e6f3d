# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Documentation: generated files are up to date, and all names in the text exist."""

import json
import re
import shlex
from pathlib import Path

import pytest

from ratslam_ros.cli.main import parser
from ratslam_ros.cli.parameter_docs import ROOT, documents, main
from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import SECTIONS, Config, section_of
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.files.config import load_config, parse_setting
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.results.writer import FRAMES_HEADER

PAGES = [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *sorted((ROOT / 'docs').glob('*.md'))]

KEYS = ('pc_x', 'pc_y', 'pc_theta')  # keys of map.json, not parameters

page = pytest.mark.parametrize('path', PAGES, ids=lambda path: path.name)


def commands(text: str) -> list[str]:
    """Return the ratslam commands in code blocks."""
    blocks = re.findall(r'```sh\n(.*?)```', text, re.DOTALL)
    blocks = [block.replace('\\\n', ' ') for block in blocks]
    lines = [line.strip() for block in blocks for line in block.splitlines()]
    return [re.split(r'\s[#>]\s', line)[0] for line in lines if line.startswith('ratslam ')]


@pytest.mark.parametrize('path', documents(), ids=str)
def test_generated_file_is_up_to_date(path: Path):
    assert (ROOT / path).read_text('utf-8') == documents()[path], 'run "make docs"'


def test_check_reports_outdated_files_without_writing(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr('ratslam_ros.cli.parameter_docs.ROOT', tmp_path)
    assert main(['--check']) == 1
    assert 'make docs' in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert main([]) == 0
    assert main(['--check']) == 0


@pytest.mark.parametrize('section', SECTIONS)
def test_every_parameter_is_documented(section: str):
    text = (ROOT / 'docs/parameters.md').read_text('utf-8')
    entry = text[text.index(f'## {section}\n') :].split('\n## ')[0]
    for name, info, _ in SECTIONS[section].parameters():
        assert f'### {name}\n\n{info.effect}\n' in entry
        assert info.raise_if and info.lower_if, f'{name}: say when to change it'


def test_default_yaml_equals_the_defaults():
    config, notices = load_config(str(ROOT / 'config/default.yaml'))
    assert (config, notices) == (Config(), [])


@page
def test_link_targets_exist(path: Path):
    for target in re.findall(r'\]\(([^)#]+)[^)]*\)', path.read_text('utf-8')):
        if '://' not in target:
            assert (path.parent / target).exists(), f'{path.name} links to {target}'


@page
def test_commands_in_pages_are_valid(path: Path):
    for command in commands(path.read_text('utf-8')):
        options = parser().parse_args(shlex.split(command)[1:])
        settings = [parse_setting(text) for text in getattr(options, 'settings', [])]
        Config().with_values(dict(settings))


@page
def test_parameters_and_options_exist(path: Path):
    text = path.read_text('utf-8')
    for name in re.findall(r'`((?:vt|pc|exp|vtrans|vrot|image_crop)_\w+)[^`]*`', text):
        assert section_of(name) or name in KEYS, name
    for section, name in re.findall(r'`(\w+)\.(\w+)(?:=[^`]*)?`', text):
        if section in SECTIONS and name != 'py':
            assert name in {known for known, _, _ in SECTIONS[section].parameters()}, name
    actions = parser()._subparsers._group_actions[0].choices.values()
    options = {option for parser in actions for option in parser._option_string_actions}
    for option in re.findall(r'`(--[a-z-]+)', text):
        assert option in options, option


def test_all_result_columns_and_keys_are_documented():
    text = (ROOT / 'docs/results.md').read_text('utf-8')
    graph = ExperienceMap(Config().experience_map)
    for source, target in ((-1, 0), (0, 1)):
        graph.integrate(Motion(1.0, 1.0, 0.1))
        graph.apply(MapAction('create', source, target, target, 0.0, Place(0.0, 0.0, 0.0)))
    content = json.loads(encode_map(1, graph))
    summary = (ROOT / 'ratslam_ros/offline/replay.py').read_text('utf-8')
    names = [
        *FRAMES_HEADER.strip().split(','),
        *content, *content['experiences'][0], *content['links'][0],
        *re.findall(r"^ +'(\w+)': ", summary, re.MULTILINE),
    ]  # fmt: skip
    assert 'step_ms' in names and 'pc_x' in names and 'facing_rad' in names
    for name in names:
        assert f'`{name}`' in text, name


def test_names_in_glossary_exist_in_code():
    text = (ROOT / 'docs/glossary.md').read_text('utf-8')
    code = '\n'.join(path.read_text('utf-8') for path in (ROOT / 'ratslam_ros').rglob('*.py'))
    for row in re.findall(r'^\| [^|]+\| ([^|]+)\|', text, re.MULTILINE)[2:]:
        for name in re.findall(r'`([^`]+)`', row):
            there = (ROOT / 'ratslam_ros' / name).is_file() if '/' in name else False
            assert there or name.split('.')[-1] in code or name in code, name
