# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Growth on known ground: a recording of laps is replayed many times in a row, as one recording.

    python benchmarks/known_ground.py [--recording rc_car_loops] [--times 20]

Nothing is configured. Each row shows the numbers of templates and places after a repetition, and
the time that it took for each image. Between two repetitions the odometry has a gap, because
the recording does not end where it starts. The last rows show the measures of `stability.py` for
the first and for the last repetition.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from lap_measures import LAPS, Setup, image_stamps, measure, read_frames, read_lap_phases

from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.recordings import Event, Recording, Selection

PAUSE_NS = 10_000_000_000
"""Time between two repetitions, in which the robot is carried to the start."""


class RepeatedRecording(Recording):
    """A recording several times in a row."""

    def __init__(self, source: Recording, times: int) -> None:
        super().__init__(source.path, source._warnings)
        self._source, self._times = source, times
        self.kind, self.topics = source.kind, source.topics
        self.period_ns = source.end_ns - source.start_ns + PAUSE_NS
        self.start_ns = source.start_ns
        self.end_ns = source.end_ns + (times - 1) * self.period_ns
        self.began_s: list[float] = []

    def read_events(self, selection: Selection, start_ns: int, stop_ns: int) -> Iterator[Event]:
        """Yield the events with start_ns <= log_ns < stop_ns."""
        source = self._source
        for number in range(self._times):
            self.began_s.append(time.perf_counter())
            later = number * self.period_ns
            for event in source.read_events(selection, source.start_ns, source.end_ns + 1):
                if start_ns <= event.log_ns + later < stop_ns:
                    yield replace(
                        event, log_ns=event.log_ns + later, stamp_ns=event.stamp_ns + later
                    )

    def close(self) -> None:
        """Close the files."""
        self._source.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--recording', choices=list(LAPS), default='rc_car_loops')
    parser.add_argument('--times', type=int, default=20)
    Setup.add_options(parser)
    options = parser.parse_args()
    laps, times = LAPS[options.recording], options.times
    warm_up()
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary)
        with laps.open(options.data) as source:
            stamp_ns = image_stamps(source, source.select())
            recording = RepeatedRecording(source, times)
            Setup.of(options).replay(recording, out)
            began_s = [*recording.began_s[-times:], time.perf_counter()]
        frames = read_frames(out / 'frames.csv')
        with open(out / 'frames.csv', newline='') as file:
            experience = np.array([int(row['experience_id']) for row in csv.DictReader(file)])
        phases = read_lap_phases(laps.path(options.data) / 'lap_phase.csv')
        print('repetition  templates  places  ms for an image')
        for number in range(times):
            end_ns = stamp_ns[-1] + number * recording.period_ns
            seen = frames.stamp_ns <= end_ns
            print(f'{number + 1:10} {frames.template_id[seen].max() + 1:10} '
                  f'{experience[seen].max() + 1:7} '
                  f'{(began_s[number + 1] - began_s[number]) * 1e3 / len(stamp_ns):16.2f}')
        for number in (0, times - 1):
            at_ns = stamp_ns + number * recording.period_ns
            found = measure(out, phases, at_ns, laps.tolerance)
            print(f'repetition {number + 1}: spread {found.spread:.4f}, '
                  f'turns for each lap {found.turns:.2f}')


if __name__ == '__main__':
    main()
