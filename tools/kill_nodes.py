# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kill live nodes at random times while they map, and compare the map with an undisturbed run.

    python tools/kill_nodes.py [--kills 200] [--seed 1] [--recording BAG] [--rate 2]

The nodes run over DDS with a map file, and a recording is played to them in lockstep. Random
nodes, sometimes all of them, are killed by SIGKILL and started again. A separate process records
which stamps the nodes have reported as saved: a restarted node must not continue from before them.
At the end of each recording the map must equal that of ``ratslam replay``, byte for byte, or the
nodes must have reported lost spans. The exit code is 0 if all of this holds.

Without --recording, a synthetic drive in circles is used.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / 'test')]

NODES = 'local_view', 'pose_cells', 'experience_map'
SETTINGS = {
    'local_view.template_x_size': 16, 'local_view.template_y_size': 8,
    'local_view.vt_shift_match': 2, 'pose_cells.pc_cell_x_size': 0.5,
    'pose_cells.exp_delta_pc_threshold': 1.0,
}
"""Parameters for the small images of the synthetic drive."""

ALL_SHARE = 0.15
"""Share of the kills that hit all nodes at once, as a power cut does."""

RUNNING_S = 1.0, 4.0
"""Limits of the time between a restart and the next kill."""

START_S, MAP_S = 120.0, 60.0
MAX_LOST_S = 5.0


def main() -> int:
    """Kill nodes, and print a table; return the exit code."""
    parser = argparse.ArgumentParser(description='Kill live nodes, and compare their maps.')
    parser.add_argument('--kills', type=int, default=200)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--recording', type=Path)
    parser.add_argument('--rate', type=float, default=2.0)
    parser.add_argument('--record', type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.record is not None:
        record(options.record)
        return 0
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # ends the nodes
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', '101')
    # On ROS 2, rclpy is found by the given path.
    os.environ['PYTHONPATH'] = os.pathsep.join(
        filter(None, [str(ROOT), os.environ.get('PYTHONPATH')])
    )
    chance = random.Random(options.seed)
    table = Table()
    with tempfile.TemporaryDirectory() as folder:
        recording, settings = options.recording, {}
        if recording is None:
            recording, settings = synthetic(Path(folder)), SETTINGS
        expected = replayed(recording, Path(folder) / 'offline', settings)
        while table.kill_count < options.kills:
            run_folder = Path(folder) / f'run_{table.runs}'
            run_folder.mkdir()
            run = Run(run_folder, recording, settings, options.rate)
            try:
                run.kill_randomly(chance, options.kills - table.kill_count, table)
                found = run.map(expected)
            finally:
                run.end()
            table.add(run, found == expected)
            print(table.line(), flush=True)
    print(table.text())
    return 0 if table.is_good() else 1


def command(*arguments: str) -> list[str]:
    """Return the command line of a ratslam command."""
    return [sys.executable, '-m', 'ratslam_ros', *arguments]


def synthetic(folder: Path) -> Path:
    """Write a drive of one minute in circles."""
    from helpers import circles, write_bag

    return write_bag(folder / 'circles', list(circles(20, 30)))


def replayed(recording: Path, folder: Path, settings: dict[str, object]) -> str:
    """Return the map of a replay."""
    given = [item for key, value in settings.items() for item in ('--set', f'{key}={value}')]
    subprocess.run(
        command('replay', str(recording), '--out', str(folder), '--quiet', '--config',
                'extended', *given), check=True,
    )
    return (folder / 'map.json').read_text()


@dataclass
class Table:
    """Results of all runs."""

    kills: Counter[str] = field(default_factory=Counter)
    restarts_s: list[float] = field(default_factory=list)
    runs: int = 0
    identical: int = 0
    reported: int = 0
    kills_identical: int = 0
    forgotten: list[str] = field(default_factory=list)
    lost_s: list[float] = field(default_factory=list)

    @property
    def kill_count(self) -> int:
        """Number of kills."""
        return self.kills.total()

    def add(self, run: Run, is_same: bool) -> None:
        """Add a run."""
        self.runs += 1
        self.identical += is_same
        self.lost_s += run.lost_s()
        self.reported += not is_same and bool(run.lost_s())
        self.kills_identical += run.kills if is_same else 0
        if not is_same and not run.lost_s():
            print(run.logs())

    def is_good(self) -> bool:
        """Return whether every map is right or its losses are reported, and nothing saved lost."""
        return (
            self.identical + self.reported == self.runs and not self.forgotten
            and all(lost_s < MAX_LOST_S for lost_s in self.lost_s)
        )

    def line(self) -> str:
        """Return the progress in one line."""
        return (
            f'{self.kill_count} kills in {self.runs} runs: {self.identical} maps identical, '
            f'{self.reported} with reported losses'
        )

    def text(self) -> str:
        """Return the table."""
        times_s = sorted(self.restarts_s) or [0.0]
        rows = [
            *((f'kills of {name}', number) for name, number in sorted(self.kills.items())),
            ('runs of the recording', self.runs), ('maps identical', self.identical),
            ('kills in runs with identical maps', self.kills_identical),
            ('maps that differ, with reported losses', self.reported),
            ('reported losses, s', ', '.join(f'{one:.1f}' for one in self.lost_s) or 'none'),
            ('saved states that were forgotten', '; '.join(self.forgotten) or 'none'),
            ('restart until ready, median and longest, s',
             f'{times_s[len(times_s) // 2]:.1f}, {times_s[-1]:.1f}'),
        ]
        return '\n'.join(f'{name:<44} {value}' for name, value in rows)


class Run:
    """The nodes, and one recording that is played to them."""

    def __init__(
        self, folder: Path, recording: Path, settings: dict[str, object], rate: float
    ) -> None:
        from ratslam_ros.files.config import load_config, to_yaml
        from ratslam_ros.live.launch import nodes, with_map
        from ratslam_ros.pipeline.choice import DEFAULT, TOPIC

        self._arguments = nodes(DEFAULT, TOPIC, split=True)
        self.kills = 0
        self._folder = folder
        self._parameters = folder / 'parameters.yaml'
        base, _ = load_config('extended')
        config = with_map(base.with_values(settings), str(folder / 'map'), False)
        self._parameters.write_text(to_yaml(config))
        self._saved = folder / 'saved'
        self._saved.touch()
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._starts: Counter[str] = Counter()
        self._spawn('recorder', [sys.executable, __file__, '--record', str(self._saved)])
        self.start(*NODES)
        self._spawn('player', command(
            'play', str(recording), '--quiet', '--lockstep', '--rate', str(rate)
        ))

    def kill_randomly(self, chance: random.Random, count: int, table: Table) -> None:
        """Kill and restart nodes until the recording ends."""
        while count > 0:
            end_s = time.monotonic() + chance.uniform(*RUNNING_S)
            while time.monotonic() < end_s and self._processes['player'].poll() is None:
                time.sleep(0.02)
            if self._processes['player'].poll() is not None:
                break
            names = NODES if chance.random() < ALL_SHARE else (chance.choice(NODES),)
            saved = self.saved()
            for name in names:
                self._processes[name].send_signal(signal.SIGKILL)
                self._processes[name].wait()
            start_s = time.monotonic()
            self.start(*names)
            table.restarts_s.append(time.monotonic() - start_s)
            table.kills['all at once' if len(names) > 1 else names[0]] += 1
            count -= 1
            self.kills += 1
            self._check(names, saved, table)
        self._processes['player'].wait()

    def start(self, *names: str) -> None:
        """Start nodes, and wait until they are ready."""
        for name in names:
            self._starts[name] += 1
            self._spawn(name, command(
                'run', name, *self._arguments[name], '--ros-args', '--params-file',
                str(self._parameters),
            ))
        end_s = time.monotonic() + START_S
        for name in names:
            while ']: ready' not in self._log(name).read_text():
                assert self._processes[name].poll() is None, self._log(name).read_text()
                assert time.monotonic() < end_s, self._log(name).read_text()
                time.sleep(0.02)

    def map(self, expected: str) -> str:
        """Return the map; wait for the expected one for a limited time."""
        end_s, found = time.monotonic() + MAP_S, ''
        while found != expected and time.monotonic() < end_s:
            found = subprocess.run(
                command('echo', 'experience_map/map', '--once', '--field', 'data',
                        '--timeout', '10'), capture_output=True, text=True, check=False,
            ).stdout.rstrip('\n')
        return found

    def saved(self) -> dict[str, int]:
        """Return the newest stamp that each node has reported as saved, in ns."""
        lines = [line.split() for line in self._saved.read_text().splitlines()]
        return {name: int(stamp_ns) for name, stamp_ns in lines}

    def lost_s(self) -> list[float]:
        """Return the lengths of the lost spans that the nodes have reported."""
        logs = self.logs()
        spans = re.findall(r'\w+ from (\S+) s to (\S+) s (?:are|is) lost', logs)
        ends = re.findall(r'; (\S+) s are missing, up to stamp (\S+) s', logs)  # all were killed
        lengths_s = [float(end) - float(begin) for begin, end in dict.fromkeys(spans)]
        return lengths_s + [float(length) for length, _ in dict.fromkeys(ends)]

    def logs(self) -> str:
        """Return all logs."""
        return '\n'.join(
            f'{path.name}: {path.read_text()}' for path in sorted(self._folder.glob('*.log'))
        )

    def end(self) -> None:
        """End all processes."""
        for process in self._processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for process in self._processes.values():
            try:
                process.wait(20.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _check(self, names: tuple[str, ...], saved: dict[str, int], table: Table) -> None:
        """Check that restarted nodes continue from what they had reported as saved.

        They may restore an earlier state that all of them have, and repeat what came since.
        """
        for name in names:
            end_s = time.monotonic() + 10.0
            pattern = re.compile(r'continued from the map at (\d+)\.(\d+) s with (\d+) messages')
            while not (found := pattern.search(self._log(name).read_text())):
                if time.monotonic() > end_s:
                    break
                time.sleep(0.02)
            from_ms = int(found[1] + found[2]) if found else -1
            # After a power cut, all continue at the newest cut that all have.
            known = saved.values() if len(names) > 1 else [saved.get(name, -1)]
            wanted_ms = min(known, default=-1) // 10**6 if len(saved) == len(NODES) else -1
            if from_ms < wanted_ms and not (found and int(found[3])):
                table.forgotten.append(f'{name}: {wanted_ms} ms was saved, continued at {from_ms}')

    def _spawn(self, name: str, arguments: list[str]) -> None:
        with self._log(name).open('wb') as log:
            self._processes[name] = subprocess.Popen(
                arguments, cwd=self._folder, stdout=log, stderr=subprocess.STDOUT
            )

    def _log(self, name: str) -> Path:
        return self._folder / f'{name}_{self._starts[name]}.log'


def record(path: Path) -> None:
    """Write down what the nodes report as saved, until the process is interrupted."""
    from ratslam_ros.live import ros

    ros.require()
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray

    from ratslam_ros.ros.qos import STATE

    with ros.node('recorder', ()) as node, path.open('a', buffering=1) as file:

        def on_diagnostics(message: DiagnosticArray) -> None:
            for status in message.status:
                values = {item.key: item.value for item in status.values}
                if int(values.get('map_saved_ns', -1)) >= 0:
                    file.write(f'{status.name.rpartition(" ")[2]} {values["map_saved_ns"]}\n')

        node.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, STATE)
        while True:
            rclpy.spin_once(node, timeout_sec=0.5)


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
