# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tool that compares two versions reports every difference, and never compares nothing."""

import subprocess
from pathlib import Path

import pytest
import same_results
from same_results import (
    FAILURE,
    UsageError,
    all_cases,
    chosen,
    compiled_key,
    copy_working_tree,
    first_difference,
    first_missing_line,
    without_sender,
)

from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.mapping import TemplatePayload


def folders(tmp_path: Path, base: dict[str, str], tree: dict[str, str]) -> tuple[Path, Path]:
    for side, files in (('base', base), ('tree', tree)):
        (tmp_path / side).mkdir()
        for name, text in files.items():
            (tmp_path / side / name).write_text(text)
    return tmp_path / 'base', tmp_path / 'tree'


def test_changed_number_is_reported_with_both_values(tmp_path: Path) -> None:
    found = first_difference(
        *folders(tmp_path, {'a.tum': '1 2.5\n3 4.5\n'}, {'a.tum': '1 2.5\n3 4.6\n'})
    )
    assert found is not None
    assert all(part in found for part in ('a.tum', 'line 2', '3 4.5', '3 4.6'))


def test_templates_of_restarted_nodes_are_equal() -> None:
    match = ViewMatch(3, False, 0.1, 0.0)
    texts = {encode(TemplatePayload.of(5, match, 1, sender)) for sender in (7, 8)}
    assert len(texts) == 2
    assert len({without_sender(text) for text in texts}) == 1
    assert '"id":3' in without_sender(texts.pop())


@pytest.mark.parametrize('tree', ['a\nb', 'a\nb\nc\nd\n', ''])
def test_shorter_or_longer_output_is_reported(tmp_path: Path, tree: str) -> None:
    assert first_difference(*folders(tmp_path, {'x': 'a\nb\nc\n'}, {'x': tree})) is not None


@pytest.mark.parametrize(
    ('base', 'tree', 'expected'),
    [
        ({'a': '1', 'b': '2'}, {'a': '1'}, 'only in BASE'),
        ({'a': '1'}, {'a': '1', 'b': '2'}, 'only in the working tree'),
        ({}, {}, 'nothing to compare'),
        ({'a': '1'}, {}, 'nothing to compare'),
        ({FAILURE: 'exit code 1'}, {FAILURE: 'exit code 1'}, 'failed in BASE: exit code 1'),
        ({'a': '1'}, {'a': '1', FAILURE: 'no map'}, 'failed in the working tree: no map'),
    ],
)
def test_missing_output_or_failure_is_reported(
    tmp_path: Path, base: dict[str, str], tree: dict[str, str], expected: str
) -> None:
    found = first_difference(*folders(tmp_path, base, tree))
    assert found is not None and expected in found


@pytest.mark.parametrize(
    ('tree', 'expected'),
    [
        ('a: 1\nb: 2\nc: 3\n', None),
        ('new: 0\na: 1,\nnew: 1\nb: 2\nc: 3\nnew: 2\n', None),
        ('a: 1\nb: 3\nc: 3\n', 'b: 2'),
        ('b: 2\na: 1\nc: 3\n', 'b: 2'),
        ('a: 1\nb: 2\n', 'c: 3'),
    ],
)
def test_further_lines_are_no_change(tree: str, expected: str | None) -> None:
    assert first_missing_line('a: 1\nb: 2\nc: 3\n', tree) == expected


@pytest.mark.parametrize(
    ('name', 'allowed'),
    [('config.yaml', True), ('summary.json', True), ('map.json', False), ('frames.csv', False)],
)
def test_additions_are_allowed_on_request_only(tmp_path: Path, name: str, allowed: bool) -> None:
    base, tree = folders(tmp_path, {name: 'a\nb\n'}, {name: 'a\nnew\nb\n'})
    assert first_difference(base, tree) is not None
    assert (first_difference(base, tree, additions=True) is None) == allowed


def test_case_of_a_later_version_is_skipped(tmp_path: Path) -> None:
    for has_file in (False, True):
        cases = chosen(['preset_irat'], False, tmp_path, lambda name, found=has_file: found)
        assert ('preset_irat' in [case.name for case in cases]) == has_file


def test_compiled_key_covers_constants_of_other_files(tmp_path: Path) -> None:
    keys = set()
    for name, text in (('core/angles', '1'), ('core/angles', '2'), ('ros/node', '3')):
        path = tmp_path / f'ratslam_ros/{name}.py'
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        keys.add(compiled_key(tmp_path))
    assert len(keys) == 2


def test_working_tree_is_copied_with_uncommitted_changes(tmp_path: Path) -> None:
    tree, copy = tmp_path / 'tree', tmp_path / 'copy'
    for folder in (tree / 'a', copy / 'old'):
        folder.mkdir(parents=True)
    (copy / 'old' / 'module.py').write_text('gone')
    for name, text in {'.gitignore': 'ignored\n', 'a/new.py': 'x = 1', 'ignored': ''}.items():
        (tree / name).write_text(text)
    subprocess.run(['git', 'init', '-q', str(tree)], check=True)
    copy_working_tree(tree, copy)
    (tree / 'a' / 'new.py').write_text('x = 22')
    copy_working_tree(tree, copy)
    files = {path.relative_to(copy).as_posix() for path in copy.rglob('*') if path.is_file()}
    assert files == {'.gitignore', 'a/new.py'}
    assert (copy / 'a' / 'new.py').read_text() == 'x = 22'


def test_every_preset_has_a_case(tmp_path: Path) -> None:
    names = [case.name for case in all_cases()]
    assert len(set(names)) == len(names)
    presets = {path.stem for path in (same_results.ROOT / 'config').glob('*.yaml')}
    assert presets - {name.removeprefix('preset_') for name in names} == {'navigation'}
    assert 'scans' in names  # replays the preset navigation


def test_unknown_case_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match='no_such_case'):
        chosen(['no_such_case'], False, tmp_path)


def test_unknown_commit_is_wrong_use(capsys: pytest.CaptureFixture[str]) -> None:
    assert same_results.main(['no_such_commit', '--quick']) == 2
    assert 'no_such_commit' in capsys.readouterr().err
