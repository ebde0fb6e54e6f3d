# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Documentation: generated files are up to date, and everything that the pages name exists."""

import argparse
import json
import re
import shlex
from pathlib import Path

import pytest
from write_docs import ROOT, documents, main

from ratslam_ros.cli.main import parser
from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import SECTIONS, Config, section_of
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.files.config import parse_setting
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.results.writer import FRAMES_HEADER

PAGES = [
    *(ROOT / name for name in
      ('README.md', 'CONTRIBUTING.md', 'benchmarks/README.md', 'tools/README.md')),
    *sorted((ROOT / 'docs').glob('*.md')),
]

SOURCES = sorted(
    path
    for folder in (
        'ratslam_ros', 'ratslam_simulator', 'ratslam_tuning', 'rclpy_standin', 'benchmarks',
        'config', 'examples', 'launch', 'test', 'tools',
    )
    for path in (ROOT / folder).rglob('*')
    if path.suffix in ('.py', '.yaml') and path != Path(__file__)
)

SCRIPTS = [path for folder in ('benchmarks', 'tools') for path in (ROOT / folder).glob('*.py')]

CODE_FOLDERS = (ROOT, ROOT / 'ratslam_ros', ROOT / 'ratslam_ros/core')
"""Folders that paths of modules in the pages are relative to."""

KEYS = ('pc_x', 'pc_y', 'pc_theta')
"""Keys of map.json that look like names of parameters."""

page = pytest.mark.parametrize('path', PAGES, ids=lambda path: str(path.relative_to(ROOT)))


def commands(text: str) -> list[str]:
    """Return the ratslam commands in code blocks."""
    blocks = re.findall(r'```sh\n(.*?)```', text, re.DOTALL)
    blocks = [block.replace('\\\n', ' ') for block in blocks]
    lines = [line.strip() for block in blocks for line in block.splitlines()]
    return [re.split(r'\s[#>]\s', line)[0] for line in lines if line.startswith('ratslam ')]


def parsers(top: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    """Return the parsers of all commands, and of their own commands."""
    if top._subparsers is None:
        return [top]
    choices = top._subparsers._group_actions[0].choices
    return [one for inner in choices.values() for one in parsers(inner)]


def anchors(text: str) -> set[str]:
    """Return the anchors that GitHub gives to the headings of a page."""
    prose = re.sub(r'```.*?```', '', text, flags=re.DOTALL)
    found: list[str] = []
    for heading in re.findall(r'^#+ +(.+?) *$', prose, re.MULTILINE):
        shown = re.sub(r'\[([^\]]*)\]\([^)]*\)', r'\1', heading).lower()
        anchor = re.sub(r'[^\w\- ]', '', shown).replace(' ', '-')
        found.append(anchor if anchor not in found else f'{anchor}-{found.count(anchor)}')
    return set(found)


def broken_links(path: Path) -> list[str]:
    """Return the relative links of a page whose file or anchor does not exist."""
    broken = []
    for link in re.findall(r'\]\(([^)\s]+)\)', path.read_text('utf-8')):
        target, _, anchor = link.partition('#')
        if '://' in target:
            continue
        file = path.parent / target if target else path
        if not file.exists() or (anchor and anchor not in anchors(file.read_text('utf-8'))):
            broken.append(link)
    return broken


def missing_files(text: str) -> list[str]:
    """Return the mentioned files of this project that do not exist."""
    mentions = re.findall(
        r'(?<![\w/.:-])((?:\.\./)?(?:[\w-]+/)*[\w-]+(?:\.\w+)?\.(?:py|md|cff))\b', text
    )
    names = {path.name for path in (*SOURCES, *PAGES)}
    return [
        mention
        for mention in mentions
        if not (
            any((folder / mention.removeprefix('../')).is_file() for folder in CODE_FOLDERS)
            or (ROOT / 'docs' / mention).is_file()
            or ('/' not in mention and mention in names)
        )
    ]


@pytest.mark.parametrize('path', documents(), ids=str)
def test_generated_file_is_up_to_date(path: Path):
    assert (ROOT / path).read_text('utf-8') == documents()[path], 'run "make docs"'


def test_architecture_is_short():
    assert len((ROOT / 'docs/architecture.md').read_text('utf-8').split()) <= 1500


def test_check_reports_outdated_files_and_writes_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr('write_docs.ROOT', tmp_path)
    assert main(['--check']) == 1
    assert 'make docs' in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert main([]) == 0
    assert main(['--check']) == 0


@pytest.mark.parametrize('section', SECTIONS)
def test_every_parameter_is_described(section: str):
    text = (ROOT / 'docs/parameters.md').read_text('utf-8')
    entry = text[text.index(f'## {section}\n') :].split('\n## ')[0]
    for name, info, _ in SECTIONS[section].parameters():
        assert f'### {name}\n\n{info.effect}\n' in entry
        assert info.raise_if and info.lower_if, f'{name}: say when to change it'


@page
def test_links_of_page_exist_with_anchors(path: Path):
    assert broken_links(path) == []


@page
def test_files_named_in_page_exist(path: Path):
    assert missing_files(path.read_text('utf-8')) == []


@pytest.mark.parametrize('path', SCRIPTS, ids=lambda path: f'{path.parent.name}/{path.name}')
def test_script_is_described_in_readme_of_its_folder(path: Path):
    assert f'`{path.name}`' in (path.parent / 'README.md').read_text('utf-8')


def test_readme_has_at_most_120_lines():
    assert len((ROOT / 'README.md').read_text('utf-8').splitlines()) <= 120


def test_files_named_in_changelog_exist():
    assert missing_files((ROOT / 'CHANGELOG.rst').read_text('utf-8')) == []


def test_broken_link_and_anchor_are_found(tmp_path):
    page = tmp_path / 'page.md'
    page.write_text(
        '# A `heading`, here\n\n```\n# no heading\n```\n'
        '[a](#a-heading-here) [b](#no-heading) [c](none.md) [d](page.md#none) [e](https://none)\n'
    )
    assert broken_links(page) == ['#no-heading', 'none.md', 'page.md#none']


def test_missing_files_are_found():
    text = '`core/warm_up.py`, `core/none.py`, benchmarks/none.py, `warm_up.py`, `none.py`'
    assert missing_files(text) == ['core/none.py', 'benchmarks/none.py', 'none.py']


def test_pages_and_sections_named_in_sources_exist():
    found = 0
    for path in SOURCES:
        for name, section in re.findall(
            r'docs/(\w+\.md)(?:,\s+"([^"]+)")?', path.read_text('utf-8')
        ):
            page = ROOT / 'docs' / name
            assert page.is_file(), f'{path.name} names docs/{name}'
            headings = re.findall(r'^#+ (.+)$', page.read_text('utf-8'), re.MULTILINE)
            assert not section or section in headings, f'{path.name} names section "{section}"'
            found += 1
    assert found > 5


def test_cited_papers_are_in_reference_list():
    text = (ROOT / 'docs/algorithm.md').read_text('utf-8')
    entries = set(re.findall(r'^\d+\. (\w+).*?\((\d{4})\)', text, re.MULTILINE))
    name = r'(?:[A-Z][a-z]+)+'
    citations = (
        rf'(?<!, )\b({name})(?:, {name})*(?: and {name}| et al\.)\s\(?((?:19|20)\d\d)\b',
        rf'(?<!and )(?<!, )\b({name})\s\(((?:19|20)\d\d)\)',
    )
    cited = {
        paper
        for path in (*PAGES, *SOURCES, ROOT / 'CHANGELOG.rst')
        for citation in citations
        for paper in re.findall(citation, path.read_text('utf-8'))
    }
    assert ('Milford', '2006') in cited
    assert cited <= entries
    implemented = (ROOT / 'CITATION.cff').read_text('utf-8')
    assert set(re.findall(r'^    year: (\d{4})', implemented, re.MULTILINE)) <= {
        year for _, year in entries
    }


def test_texts_cite_papers_by_author_and_year():
    paths = [path for path in SOURCES if ROOT / 'test' not in path.parents]
    for path in (*PAGES, *paths, ROOT / 'CHANGELOG.rst'):
        found = re.search(r'\bseed 00\d', path.read_text('utf-8'), re.IGNORECASE)
        assert not found, path.name


@page
def test_commands_of_page_are_valid(path: Path):
    for command in commands(path.read_text('utf-8')):
        options = parser().parse_args(shlex.split(command)[1:])
        settings = [parse_setting(text) for text in getattr(options, 'settings', [])]
        Config().with_values(dict(settings))


@page
def test_parameters_and_options_of_page_exist(path: Path):
    text = path.read_text('utf-8')
    for name in re.findall(r'`((?:vt|pc|exp|vtrans|vrot|image_crop)_\w+)[^`]*`', text):
        assert section_of(name) or name in KEYS, name
    for section, name in re.findall(r'`(\w+)\.(\w+)(?:=[^`]*)?`', text):
        if section in SECTIONS and name != 'py':
            assert name in {known for known, _, _ in SECTIONS[section].parameters()}, name
    options = {option for one in parsers(parser()) for option in one._option_string_actions}
    for script in SCRIPTS:
        options |= set(re.findall(r"add_argument\(\s*'(--[a-z-]+)'", script.read_text('utf-8')))
    for option in re.findall(r'`(--[a-z-]+)', text):
        assert option in options, option


def test_all_result_columns_and_keys_are_described():
    text = (ROOT / 'docs/results.md').read_text('utf-8')
    graph = ExperienceMap(Config().experience_map)
    for source, target in ((-1, 0), (0, 1)):
        graph.integrate(Motion(1.0, 1.0, 0.1))
        graph.apply(MapAction('create', source, target, target, 0.0, Place(0.0, 0.0, 0.0)))
    content = json.loads(encode_map(1, graph))
    summary = (ROOT / 'ratslam_ros/offline/replay.py').read_text('utf-8')
    names = [
        *FRAMES_HEADER.split(','),
        *content, *content['experiences'][0], *content['links'][0],
        *re.findall(r"^ +'(\w+)': ", summary, re.MULTILINE),
    ]
    assert 'step_ms' in names and 'pc_x' in names and 'facing_rad' in names
    for name in names:
        assert f'`{name}`' in text, name


def test_names_in_glossary_exist_in_code():
    text = (ROOT / 'docs/glossary.md').read_text('utf-8')
    code = '\n'.join(path.read_text('utf-8') for path in (ROOT / 'ratslam_ros').rglob('*.py'))
    words = set(re.findall(r'\w+', code))
    rows = re.findall(r'^\| [^|]+\| ([^|]+)\|', text, re.MULTILINE)[2:]
    names = [name for row in rows for name in re.findall(r'`([^`]+)`', row)]
    assert len(names) > 40
    for name in names:
        if name.endswith('.py'):
            assert (ROOT / 'ratslam_ros' / name).is_file(), name
        elif '/' in name:
            assert f"'{name}'" in code, name
        else:
            assert set(name.split('.')) - {'tum'} <= words, name
