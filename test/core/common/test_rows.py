# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables with a key equal a dictionary, whatever is done to them."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ratslam_ros.core.common.rows import KeyedRows

KEY = st.tuples(st.integers(-1, 1), st.integers(0, 1))
STEP = st.tuples(st.sampled_from(['put', 'put', 'drop', 'replace', 'clear']), KEY)


@given(st.lists(STEP, min_size=20, max_size=60))
def test_table_with_keys_equals_dictionary(steps: list[tuple[str, tuple[int, int]]]) -> None:
    table, model = KeyedRows(2, 3), dict[tuple[int, ...], float]()
    for value, (step, key) in enumerate(steps):
        if step == 'put':
            table.put(key, (value,))
            model[key] = value
        elif step == 'drop' and key in model:
            table.drop(*key)
            del model[key]
        elif step == 'replace':  # as when a state is restored: the last row with a key is kept
            table.replace([*table.values.tolist(), [*key, value]])
            model[key] = value
        elif step == 'clear':
            table.clear()
            model.clear()
        assert len(table) == len(model) and {*table} == {*model}
        assert {(a, b): last for a, b, last in table.values.tolist()} == model
        assert all(table.get(*one) == [last] for one, last in model.items())
        assert (key in table) == (key in model)
