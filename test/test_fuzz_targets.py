# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Targets of tools/fuzz.py: valid inputs are read, and past findings and damaged ones are handled.

A file test/data/fuzz/TARGET/NAME is an input that was not handled once.
"""

from __future__ import annotations

from pathlib import Path

import fuzz_targets as targets
import numpy as np
import pytest

from ratslam_ros.errors import RatslamError

ROOT = Path(__file__).parents[1]
MUTATIONS = 60
"""Damaged copies of the valid inputs, per target."""


@pytest.mark.parametrize('name', sorted(targets.TARGETS))
def test_valid_inputs_are_read(name: str, tmp_path: Path) -> None:
    made = list(targets._SEEDS[name]())
    assert made
    for data in made:
        targets.TARGETS[name](data, tmp_path)


@pytest.mark.parametrize('path', sorted((ROOT / 'test/data/fuzz').glob('*/*')), ids=lambda path: (
    f'{path.parent.name}-{path.name}'
))
def test_past_finding_is_handled(path: Path, tmp_path: Path) -> None:
    try:
        targets.TARGETS[path.parent.name](path.read_bytes(), tmp_path)
    except RatslamError as error:
        assert '\n' not in str(error)


@pytest.mark.parametrize('name', sorted(targets.TARGETS))
def test_damaged_inputs_are_handled(name: str, tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    made = list(targets._SEEDS[name]())
    for _ in range(MUTATIONS):
        data = bytearray(made[random.integers(len(made))])
        for _ in range(random.integers(1, 5)):
            at = int(random.integers(len(data)))
            word = targets.DICTIONARY[random.integers(len(targets.DICTIONARY))]
            data[at : at + len(word)] = word if random.random() < 0.5 else random.bytes(1)
        try:
            targets.TARGETS[name](bytes(data), tmp_path)
        except RatslamError as error:
            assert '\n' not in str(error)
