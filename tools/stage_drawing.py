# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drawing of the stages and streams in docs/architecture.md, from the tables of the pipeline."""

from __future__ import annotations

from collections.abc import Sequence

from ratslam_ros.core.config import Config
from ratslam_ros.pipeline.landmark_map import LandmarkMapStage
from ratslam_ros.pipeline.ratslam import STAGES
from ratslam_ros.pipeline.stage import Stage
from ratslam_ros.pipeline.streams import STREAMS

BEGIN, END = '<!-- Drawn by `make docs`; do not edit. -->\n', '<!-- End of the drawing. -->\n'
WRITTEN, READ, ANSWERED, PASSING = '●▼▲│'
CONFIG = Config().with_values({
    'experience_map.exp_align_scans': True, 'experience_map.exp_relocate': 'both',
    'local_view.vt_match_threshold': -1, 'local_view.vt_match_ratio': -1,
})
"""Parameters with which the stages read all streams that they can."""


def drawing(stages: Sequence[type[Stage]] = (*STAGES, LandmarkMapStage)) -> str:
    """Return a row for each stage, in the direction of flow, and a column for each stream."""
    reads = [{*stage(CONFIG).readers()} for stage in stages]
    writes = [{*stage.WRITES} for stage in stages]
    rows = ['outside', *(stage.NAME for stage in stages)]
    lines = [f'{row:16}' for row in ('', *rows)]
    for stream in STREAMS:
        name = stream.name
        written = [n for n, names in enumerate(writes, 1) if name in names]
        read = [n for n, names in enumerate(reads, 1) if name in names]
        if not written and name.startswith('scan_'):
            continue  # further lasers, like the first one
        # Odometry comes from outside or from images.
        outside = [0] if name == 'odometry' or not written else []
        ends = [*outside, *written, *read]
        lines[0] += f'  {name}'
        for n in range(len(rows)):
            symbol = PASSING if min(ends) < n < max(ends) else ' '
            if n in read:
                symbol = ANSWERED if stream.answers else READ
            if n in (*outside, *written):
                symbol = WRITTEN
            lines[n + 1] += f'  {symbol:^{len(name)}}'
    return '\n'.join(line.rstrip() for line in lines)


def with_drawing(page: str) -> str:
    """Return a page with the present drawing in the place of its last one."""
    before, rest = page.split(BEGIN)
    _, after = rest.split(END)
    return f'{before}{BEGIN}```\n{drawing()}\n```\n{END}{after}'
