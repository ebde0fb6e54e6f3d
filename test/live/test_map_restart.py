# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes with a map file that are killed and started again: same map as without, byte for byte."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path

import pytest
from helpers import circles, write_bag
from processes import wait_for
from test_live_nodes import SMALL, THREE, Live, offline

from ratslam_ros.cli import main
from ratslam_ros.live.launch import nodes
from ratslam_ros.maps import read_map
from ratslam_ros.offline.replay_log import mapping_runs
from ratslam_ros.pipeline.choice import DEFAULT, TOPIC


def restart(live: Live, *nodes: str) -> set[str]:
    """Kill nodes, start them again; return the stamps from which they have continued."""
    live.stop(*nodes, number=signal.SIGKILL)
    live.start(*nodes)
    return {continued_at(live.log(node)) for node in nodes}


def continued_at(log: Path) -> str:
    text = r'continued from the map at (\S+) s'
    return str(wait_for(lambda: re.search(text, log.read_text()))[1])


def test_killed_nodes_continue_and_build_the_undisturbed_map(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """First one node, then all at once, as in a power cut; the kept log repeats the run."""
    bag = write_bag(tmp_path / 'circles', list(circles(6, 30)))
    path = tmp_path / 'office.ratslam'
    # A process of a loaded machine may take seconds to start, in which its neighbours get nothing.
    more = {'memory.map': str(path), 'memory.keep_log': True, 'inputs.flush_after_s': 10.0}
    expected = offline(bag, tmp_path / 'offline', SMALL)
    with Live(tmp_path / 'live', {**SMALL, **more}) as live:
        live.arguments = nodes(DEFAULT, TOPIC, split=True)
        live.start(*THREE)
        live.begin('play', 'play', str(bag), '--quiet', '--lockstep', '--rate', '2')
        live.run('echo', 'ratslam/cut', '--once', '--field', 'data', '--timeout', '20')
        restart(live, 'local_view')
        assert len(restart(live, *THREE)) == 1
        assert live.processes.pop('play').wait(60.0) == 0, live.logs()
        assert live.settled_map(expected) == expected, live.logs()
        assert live.stop() == dict.fromkeys(THREE, 0), live.logs()
        assert 'lost' not in live.logs()
    assert [one.name for one in tmp_path.glob('office*') if one.is_file()] == [path.name]
    saved = read_map(path)
    assert saved.states.keys() == set(THREE)
    assert len(saved.states['experience_map']['core']['poses']) == len(
        json.loads(expected)['experiences']
    )
    capsys.readouterr()
    out = tmp_path / 'out'
    assert main(['replay', str(path), '--log', '--out', str(out)]) == 0
    assert 'reproduced, byte for byte' in capsys.readouterr().out
    assert read_map(out / 'replayed.map').digest == saved.digest
    begun = [one.beginning.cut_ns is not None for one in mapping_runs(path)[1:]]
    assert begun == [False, False]
