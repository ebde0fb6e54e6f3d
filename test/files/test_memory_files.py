# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Memory files: an exact round trip, and rejection of damaged files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import PERIOD_NS, START_NS, original, picture, twist
from states import differences

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.id_map import IdMap
from ratslam_ros.core.mapping.late_join import LateJoin
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.memory import load, save
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.pipeline.ratslam import RatSLAM

CONFIG = original().with_values({
    'local_view.template_x_size': 16, 'local_view.template_y_size': 8,
    'local_view.vt_shift_match': 2, 'local_view.vt_shift_match_y': 1,
    'pose_cells.pc_cell_x_size': 0.5, 'pose_cells.exp_delta_pc_threshold': 1.0,
})  # fmt: skip
PER_LAP = 30


def drive(slam: RatSLAM, first: int, last: int) -> None:
    """Drive laps on a circle with the same images in each lap."""
    for n in range(first, last):
        stamp_ns = START_NS + n * PERIOD_NS
        slam.odometry(twist(stamp_ns, 4.0, 2.0 * np.pi * 10 / PER_LAP))
        slam.image(stamp_ns, picture(n % PER_LAP, 24, 32))


@pytest.mark.parametrize('steps', [0, 1, 20, 45, 80])
def test_restored_state_continues_identically(
    steps: int, tmp_path: Path
) -> None:
    slam = RatSLAM(CONFIG)
    drive(slam, 0, steps)
    for part in ('local_view', 'pose_cells', 'experience_map'):
        save(tmp_path / part, part, getattr(slam, part).state())
    other = RatSLAM(CONFIG)
    drive(other, 0, steps)
    for part in ('local_view', 'pose_cells', 'experience_map'):
        state = {**other.pipeline.state_of(part), 'core': load(tmp_path / part, part)}
        other.pipeline.restore_stage(part, state)
    for instance in (slam, other):
        drive(instance, steps, 100)
        instance.finish()
    assert encode_map(1, other.experience_map) == encode_map(1, slam.experience_map)
    assert len(slam.experience_map) > 10
    assert np.array_equal(other.pose_cells.activity(), slam.pose_cells.activity())


def test_id_map_and_late_join_are_restored(tmp_path: Path) -> None:
    numbering = IdMap()
    numbering.set_memory(3)
    numbering.own_id(9)
    numbering.set_memory(4)
    graph = ExperienceMap(CONFIG.experience_map)
    joining = LateJoin(graph)
    save(tmp_path / 'x', 'x', {'a': numbering.state(), 'b': joining.state()})
    found = load(tmp_path / 'x', 'x')
    again, joined = IdMap(), LateJoin(graph)
    again.restore(found['a'])
    joined.restore(found['b'])
    assert again.own_id(0) == numbering.own_id(0) == 10
    assert list(differences(joined.state(), joining.state())) == []


def test_state_of_another_size_is_rejected(tmp_path: Path) -> None:
    core = LocalView(CONFIG.local_view)
    core.match(picture(0, 24, 32))
    with pytest.raises(UnusableInput, match='template_y_size'):
        LocalView(original('local_view')).restore(core.state())
    with pytest.raises(UnusableInput, match='pc_dim_x'):
        PoseCells(original().with_values({'pose_cells.pc_dim_x': 50}).pose_cells).restore(
            PoseCells(CONFIG.pose_cells).state()
        )


@pytest.mark.parametrize('damage', ['missing', 'empty', 'cut', 'other', 'text', 'folder'])
def test_unusable_file_is_rejected_in_one_line(damage: str, tmp_path: Path) -> None:
    path = tmp_path / 'memory.npz'
    save(path, 'other' if damage == 'other' else 'part', {'a': np.arange(1000)})
    content = path.read_bytes()
    if damage == 'missing':
        path.unlink()
    elif damage == 'empty':
        path.write_bytes(b'')
    elif damage == 'cut':
        path.write_bytes(content[: len(content) // 2])
    elif damage == 'text':
        path.write_text('nonsense')
    elif damage == 'folder':
        path.unlink()
        path.mkdir()
    with pytest.raises(UnusableInput, match=r'memory\.npz') as error:
        load(path, 'part')
    assert '\n' not in str(error.value)


def test_failed_write_keeps_the_earlier_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / 'memory.npz'
    save(path, 'part', {'a': 1})

    def full(*_: object) -> None:
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr('os.fsync', full)
    with pytest.raises(UnusableInput, match='No space left'):
        save(path, 'part', {'a': 2})
    assert load(path, 'part') == {'a': 1}
    assert [file.name for file in tmp_path.iterdir()] == ['memory.npz']
