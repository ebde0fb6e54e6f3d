# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stages of the user in replays and map files, in the place of ours or beside them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import own_counters
import pytest
from helpers import START_NS, circles, write_bag
from own_counters import Brightness
from rooms import scan_in
from state_digest import digest_of

import ratslam_ros as rs
from ratslam_ros.cli import main
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import RatslamError, UnusableInput, UnusableParameter
from ratslam_ros.maps import save_map
from ratslam_ros.own_stages import own_stages

EXAMPLE = Path(__file__).parents[2] / 'examples' / 'custom_stage.py'
HASH = f'{EXAMPLE}:HashView'
BRIGHTNESS = f'{own_counters.__file__}:Brightness'


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp('bag') / 'circles', circles(laps=2))


@pytest.fixture(scope='module')
def saved(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a map of a replay with two stages of the user."""
    path = tmp_path_factory.mktemp('saved') / 'a.map'
    assert replayed(bag, path, '--stage', HASH, '--stage', BRIGHTNESS) == 0
    return path


@pytest.fixture
def copied(saved: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(saved, tmp_path / 'a.map'))


def replayed(bag: Path, path: Path, *words: str) -> int:
    out = str(path.parent / 'results')
    command = ['replay', str(bag), '--no-inspect', '--map', str(path), '--out', out, '--quiet']
    return main([*command, *words])


def counts(slam: rs.RatSLAM) -> list[int]:
    found: list[int] = slam.pipeline.stages['brightness'].counts.tolist()  # type: ignore[attr-defined]
    return found


def test_own_stages_are_saved_and_restored_by_the_library(bag: Path, tmp_path: Path) -> None:
    stages = own_stages([HASH, BRIGHTNESS])
    slam = rs.RatSLAM(stages=stages)
    with rs.open_recording(bag) as recording:
        for recorded in rs.recorded_inputs(recording, slam):
            slam.feed(*recorded)
    rs.save_map(slam, tmp_path / 'a.map', rs.Config())
    again = rs.load_map(tmp_path / 'a.map', stages=stages)
    assert counts(again) == counts(slam)
    assert counts(slam)[1] >= 59
    assert digest_of(again.state()) == digest_of(slam.state())


def test_replay_continues_a_map_with_own_stages(bag: Path, saved: Path, tmp_path: Path) -> None:
    cut = tmp_path / 'a.map'
    stages = '--stage', HASH, '--stage', BRIGHTNESS
    assert replayed(bag, cut, *stages, '--duration', '3') == 0
    assert replayed(bag, cut, *stages) == 0
    assert rs.read_map(cut).digest == rs.read_map(saved).digest
    result = rs.map_recording(
        bag, inspect=False, stages=own_stages([HASH, BRIGHTNESS]), quiet=True
    )
    graph = rs.load_map(saved, stages=own_stages([HASH, BRIGHTNESS])).experience_map
    assert rs.encode_map(1, result.experience_map) == rs.encode_map(1, graph)


@pytest.mark.parametrize(('stages', 'missing'), [
    ([], 'Brightness'), ([HASH], 'Brightness'), ([BRIGHTNESS], 'HashView'),
    ([HASH, f'{own_counters.__file__}:Other'], 'Brightness'),
])
def test_map_opened_with_other_stages_names_the_missing_one(
    stages: list[str], missing: str, bag: Path, copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(UnusableInput, match=rf'by a stage {missing} .*--stage FILE:{missing}'):
        rs.load_map(copied, stages=own_stages(stages))
    before = copied.read_bytes()
    assert replayed(bag, copied, *(word for one in stages for word in ('--stage', one))) == 2
    assert f'--stage FILE:{missing}' in capsys.readouterr().err
    assert copied.read_bytes() == before


def test_map_of_our_stages_is_refused_by_an_own_one(tmp_path: Path) -> None:
    rs.save_map(rs.RatSLAM(), tmp_path / 'a.map', rs.Config())
    with pytest.raises(UnusableInput, match=r'local_view was saved by .* not by HashView'):
        rs.load_map(tmp_path / 'a.map', stages=own_stages([HASH]))


def test_check_of_a_map_with_own_stages_finds_nothing(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    check = ['map', 'check', str(copied)]
    assert main([*check, '--stage', HASH, '--stage', BRIGHTNESS]) == 0
    assert capsys.readouterr() == (f'{copied}: no problem found\n', '')
    assert main([*check, '--stage', HASH]) == 0
    out, err = capsys.readouterr()
    assert out == f'{copied}: no problem found\n'
    assert 'brightness' in err
    assert '--stage FILE:Brightness' in err
    assert main(['map', 'info', str(copied)]) == 0
    assert 'brightness of Brightness' in capsys.readouterr().out


def test_check_finds_own_memory_that_cannot_be_restored(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = rs.read_map(copied)
    states = {**saved.states, 'brightness': {'stage': 'Brightness', 'state': {}}}

    save_map(copied, states, saved.meta, saved.cut)
    stages = ['--stage', HASH, '--stage', BRIGHTNESS]
    assert main(['map', 'check', str(copied)]) == 0
    assert main(['map', 'check', str(copied), *stages]) == 1
    assert "KeyError('counts')" in capsys.readouterr().out


def test_own_stage_in_the_place_of_the_map_is_refused() -> None:
    kind = type('Cells', (Brightness,), {'NAME': 'pose_cells'})
    with pytest.raises(UnusableParameter, match='Cells takes the place of pose_cells; expected a'):
        rs.RatSLAM(stages=[kind])


def test_own_stage_reads_scans_without_alignment(tmp_path: Path) -> None:
    class Scans(Brightness):
        def readers(self) -> dict[str, Any]:
            return {'scan': self._note}

    slam = rs.RatSLAM(stages=[Scans])
    scan = scan_in([[(-4.0, -4.0), (4.0, 4.0)]], Pose(0.0, 1.0, 0.0), START_NS, beams=9)
    slam.feed('scan', START_NS, scan)
    slam.finish()
    assert counts(slam) == [0, 1]


@pytest.mark.parametrize('name', ['My stage', 'inputs', ''])
def test_stage_whose_name_is_no_part_of_a_map_is_refused(name: str) -> None:
    kind = type('Misnamed', (Brightness,), {'NAME': name})
    with pytest.raises(UnusableParameter, match=f'NAME is {name!r}.*expected'):
        rs.RatSLAM(stages=[kind])


@pytest.mark.parametrize(('text', 'reason'), [
    ('nothing', r'nothing.*FILE.py:CLASS'),
    ('nothing.py:Stage', r'nothing.py.*No such file'),
    ('no_such_module:Stage', 'No module named'),
    (f'{__file__}:Nothing', 'has no class'),
    (f'{__file__}:EXAMPLE', 'has no class'),
    ('pathlib:Path', 'Path has no NAME'),
])
def test_wrong_stage_is_one_line(text: str, reason: str) -> None:
    with pytest.raises(RatslamError, match=reason):
        own_stages([text])
