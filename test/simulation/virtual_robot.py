# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One simulation of all mapping nodes with a map file: faults drawn from a seed, and the checks.

``simulate(seed)`` runs the nodes as simulated processes on the stand-in for rclpy, with the bus,
the time, the threads and the disk of this folder. A source plays 20 s of a small synthetic world.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import rclpy
from helpers import extended
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Image, LaserScan
from state_digest import digest_of
from virtual_bus import Bus, Graph, Guard, Participant, WaitSet
from virtual_disk import Disk
from virtual_time import EPOCH_NS, MS, Process, S, Scheduler, VirtualThreading, VirtualTime
from virtual_world import (
    CHAINS,
    KINDS,
    LEARNING,
    LOSSES,
    MOST_NS,
    SETTINGS,
    SETTLED_NS,
    Event,
    Plan,
    replayed,
    world,
)

from ratslam_ros.chain import ALONE
from ratslam_ros.errors import RatslamError
from ratslam_ros.files.config import combined_yaml
from ratslam_ros.live.action_wait import ActionWait
from ratslam_ros.live.ros import send
from ratslam_ros.maps import read_map
from ratslam_ros.maps import store as store_module
from ratslam_ros.maps.cut_grid import NUMBERS_PER_RUN
from ratslam_ros.maps.locks import MapLock
from ratslam_ros.ros.host import Host
from ratslam_ros.ros.qos import PLAYED
from ratslam_ros.ros.restart.history import History
from ratslam_ros.starting import starting
from rclpy_standin.context import Context, get_default_context

NOT_MEMORY = 'goals', 'inputs', 'answers'
"""Parts of a saved state that are no result of a replay."""

JOIN_NS = 4_000_000_000
"""Time after which all nodes save in the same run of stamps, see ``CutGrid.join_run``."""


@dataclass
class Outcome:
    """Result of a simulation.

    trace_hash: equal for equal seeds. identical: whether the map is that of the replay. losses:
    kinds of reported losses. problems: violations of what must always hold.
    """

    seed: int
    trace_hash: int = 0
    identical: bool = False
    losses: tuple[str, ...] = ()
    kills: int = 0
    problems: list[str] = field(default_factory=list)
    trace: list[str] = field(default_factory=list)

    is_repairable: bool = False
    """Whether the source can send everything again, and waits for restarted nodes."""

    @property
    def kind(self) -> str:
        """Class of the outcome in words."""
        if self.problems:
            return 'FAILED'
        if self.identical:
            return 'identical'
        return f'differs, reported: {", ".join(self.losses)}'


def simulate(seed: int, trace: bool = False, plan: Plan | None = None) -> Outcome:
    """Run the simulation of a seed.

    Args:
        seed: the seed; equal ones give equal runs.
        trace: keep the events as text.
        plan: faults; None for those of the seed.
    """
    with tempfile.TemporaryDirectory(prefix='simulation', dir=_memory_folder()) as folder:
        return Simulation(seed, plan or Plan.drawn(seed), Path(folder) / 'map', trace).run()


def _memory_folder() -> str | None:
    return '/dev/shm' if Path('/dev/shm').is_dir() else None


class RobotProcess(Process):
    """A process with one node or several."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.nodes: dict[str, Any] = {}
        """By the name of the node."""
        self.is_ready = self.must_stop = self.has_ended = False
        self.refusal = ''


class Simulation:
    """All nodes, the source and the faults."""

    def __init__(self, seed: int, plan: Plan, path: Path, trace: bool) -> None:
        self.seed, self.plan, self.path = seed, plan, path
        self.scheduler = Scheduler(seed)
        if trace:
            self.scheduler.trace = []
        self.bus = Bus(self.scheduler, plan.bus)
        self.disk = Disk(self.scheduler)
        self.nodes: dict[str, RobotProcess] = {}
        self.cuts: dict[tuple[str, bytes], int] = {}
        """Number of each cut, by its part and the digest of the state."""
        self.runs: dict[int, int] = {}
        """Time of the first cut of each run of stamps."""
        self.logs: list[str] = []
        self.is_played = False
        self.last_message_ns = 0
        self.outcome = Outcome(seed, is_repairable=plan.is_repairable)
        self._drive_ns: int | None = None

    def run(self) -> Outcome:
        """Run until the nodes are idle, end them, and check the result."""
        scheduler, outcome, plan = self.scheduler, self.outcome, self.plan
        replayed(plan.robot, plan.jitter_ns)  # in the time of the machine
        with installed(self):
            try:
                self._drive()
            except Exception as error:
                self.outcome.problems.append(f'{type(error).__name__}: {error}')
            for process in [*self.nodes.values(), self._source]:
                self._kill(process)
        outcome.problems += scheduler.failures
        self._check_file()
        text = '\n'.join(self.logs)
        outcome.losses = tuple(
            name for name, pattern in LOSSES.items()
            # Messages that the source sent twice are refused, and nothing is lost.
            if re.search(pattern, text) and not (name == 'refused' and self.plan.duplicates)
        )
        if not outcome.problems and not outcome.identical and not outcome.losses:
            outcome.problems.append('the map differs from the replay, and no loss is reported')
        outcome.trace_hash = scheduler.trace_hash
        outcome.trace = scheduler.trace or []
        return outcome

    def _drive(self) -> None:
        scheduler, plan = self.scheduler, self.plan
        self._source = RobotProcess('player')
        for name in plan.names:
            self._start(name)
        scheduler.start(self._source, 'player', self._play)
        self._until(lambda: self._drive_ns is not None)
        assert self._drive_ns is not None
        if plan.full is not None:
            scheduler.at(self._drive_ns + plan.full[0], self._fill_disk)
        restarts: list[tuple[int, str]] = []
        kills = list(plan.kills)
        idle_ns = 0
        while idle_ns < SETTLED_NS:
            now_ns = scheduler.now_ns - self._drive_ns
            assert now_ns < MOST_NS, 'the nodes are not idle in time'
            while kills and kills[0][0] <= now_ns:
                _, names, pause_ns = kills.pop(0)
                for name in names:
                    if not self.nodes[name].is_dead:
                        self.outcome.kills += 1
                        self._kill(self.nodes[name])
                        restarts.append((now_ns + pause_ns, name))
            for one in [one for one in restarts if one[0] <= now_ns]:
                restarts.remove(one)
                self._start(one[1])
            for name, process in self.nodes.items():
                if process.has_ended and not process.is_dead:  # the map could not be opened
                    self._kill(process)
                    restarts.append((now_ns + S, name))
            assert not scheduler.failures
            is_busy = (
                kills or restarts or not self.is_played or not all(map(_is_mapping, self._alive()))
            )
            idle_ns = 0 if is_busy else idle_ns + 50 * MS
            scheduler.sleep(50 * MS)
        self._compare()
        if plan.ends == 'closed':
            for process in self.nodes.values():
                process.must_stop = True
            self._until(lambda: all(process.has_ended for process in self.nodes.values()))

    def _alive(self) -> list[RobotProcess]:
        return list(self.nodes.values())

    def _until(self, condition: Callable[[], Any]) -> None:
        end_ns = self.scheduler.now_ns + MOST_NS
        while not condition():
            assert not self.scheduler.failures
            assert self.scheduler.now_ns < end_ns, 'a step takes too long'
            self.scheduler.sleep(50 * MS)

    def _fill_disk(self) -> None:
        assert self.plan.full is not None
        self.disk.full_until_ns = self.scheduler.now_ns + self.plan.full[1] - self.plan.full[0]

    # Processes

    def _start(self, name: str) -> None:
        process = RobotProcess(name)
        self.nodes[name] = process
        self.scheduler.note(f'start {name}')
        self.scheduler.start(process, name, lambda: self._run_node(process, KINDS[name]))

    def _run_node(self, process: RobotProcess, kinds: tuple[type[Any], ...]) -> None:
        self.scheduler.sleep(self.scheduler.chance.randrange(100 * MS, 2 * S))
        context = self._context()
        values = {**SETTINGS, **{f'{part}.map': str(self.path) for part in LEARNING}}
        host = Host(chain=CHAINS.get(process.name, ALONE))
        nodes = [kind(extended().with_values(values), host) for kind in kinds]
        host.start()
        process.nodes = {node.SECTION: node for node in nodes}
        if self.plan.backlog and hasattr(nodes[0], '_backlog'):
            nodes[0]._backlog._max_bytes = self.plan.backlog
        try:
            host.map.open()
        except RatslamError as error:
            process.refusal = str(error)
            self.log(f'{process.name}: {error}')
            process.has_ended = True
            return
        executor = SingleThreadedExecutor(context=context)
        for node in nodes:
            executor.add_node(node)
        process.is_ready = True
        while not process.must_stop:
            executor.spin_once(timeout_sec=0.5)
            if getattr(nodes[0], 'error', None) is not None:
                raise nodes[0].error
        for node in nodes:
            node.close()
        process.has_ended = True

    def _context(self) -> Context:
        context = Context()
        context.init(['--ros-args', '--disable-rosout-logs'])
        self.scheduler.current.process.context = context  # type: ignore[attr-defined]
        return context

    def _kill(self, process: RobotProcess) -> None:
        if process.is_dead:
            return
        self.scheduler.note(f'kill {process.name}')
        self.bus.kill(process)
        self.scheduler.kill(process)
        self.disk.kill(process, self.path)

    def _play(self) -> None:
        """Publish the world, and keep its messages if the plan says so."""
        plan, chance, scheduler = self.plan, self.scheduler.chance, self.scheduler
        context = self._context()
        node = Node('player', context=context)
        image_qos = rclpy.qos.qos_profile_sensor_data if plan.best_effort else PLAYED
        kinds = {'odom': Odometry, 'image': Image, 'scan': LaserScan}
        topics = sorted({event.topic for event in world(plan.robot, plan.jitter_ns)})
        publishers = {
            topic: node.create_publisher(
                kinds[topic], topic, image_qos if topic == 'image' else PLAYED
            ) for topic in topics
        }
        history = History(node) if plan.resends else None
        actions = ActionWait(node, 'odom' in topics) if plan.lockstep else None
        while (
            self._starting()
            or not self._are_connected(node)
            or not all(publisher.get_subscription_count() for publisher in publishers.values())
        ):
            rclpy.spin_once(node, timeout_sec=0.05)
        scheduler.sleep(300 * MS + 2 * plan.bus.discovery_ns)
        self._drive_ns = start_ns = scheduler.now_ns
        for event in self._order():
            due_ns = start_ns + event.stamp_ns - EPOCH_NS
            while scheduler.now_ns < due_ns:
                rclpy.spin_once(node, timeout_sec=(due_ns - scheduler.now_ns) / 1e9)
            if actions is not None:
                actions.wait_before(event.recorded)
                start_ns += max(0, scheduler.now_ns - due_ns)
                actions.add(event.recorded)
            for _ in range(1 + (chance.random() < plan.duplicates)):
                send(publishers[event.topic], event.message)
            if history is not None:
                history.add(event.topic, event.message)
        self.is_played = True
        while True:
            rclpy.spin_once(node, timeout_sec=0.5)

    def _are_connected(self, node: Node) -> bool:
        return all(map(node.count_publishers, ('local_view/template', 'pose_cells/action')))

    def _order(self) -> Iterator[Event]:
        """Yield the world, with some neighbours swapped that are of different topics."""
        events = list(world(self.plan.robot, self.plan.jitter_ns))
        for n in range(len(events) - 1):
            if events[n].topic != events[n + 1].topic and (
                self.scheduler.chance.random() < self.plan.swaps
            ):
                events[n], events[n + 1] = events[n + 1], events[n]
        yield from events

    def _starting(self) -> list[str]:
        """Return the nodes that are starting, in place of ``starting``."""
        return [name for name, one in self.nodes.items() if not (one.is_ready or one.is_dead)]

    def log(self, text: str) -> None:
        """Keep a line of a node's log."""
        text = text.replace(str(self.path.parent), '')
        self.logs.append(text)
        self.scheduler.note(text)

    # Checks

    def note_cut(self, store: Any, cut: Any, states: Any) -> None:
        """Keep what is handed over to be written."""
        for part, state in states.items():
            digest = digest_of(state)
            self.cuts[part, digest] = cut.number
            run, now_ns = cut.number // NUMBERS_PER_RUN, self.scheduler.now_ns
            self.runs.setdefault(run, now_ns)
            if any(one > run and now_ns - at > JOIN_NS for one, at in self.runs.items()):
                self.outcome.problems.append(f'the cuts of {part} do not fit those of others')
            self.scheduler.note(f'cut {cut.number} {digest.hex()[:8]}')

    def _state(self, part: str) -> Any:
        [node] = [one.nodes[part] for one in self.nodes.values() if part in one.nodes]
        return node.host.live.state_of(part)

    def _compare(self) -> None:
        different = [
            name
            for name, digest in replayed(self.plan.robot, self.plan.jitter_ns).items()
            if digest_of(self._state(name)['core']) != digest
        ]
        self.outcome.identical = not different
        if different:
            self.scheduler.note(f'different: {different}')

    def _check_file(self) -> None:
        """Check that the file opens, and contains states that the nodes have handed over."""
        try:
            saved = read_map(self.path)
        except Exception as error:
            self.outcome.problems.append(f'the map does not open: {error!r}')
            return
        for part, state in saved.states.items():
            if (part, digest_of(state)) not in self.cuts:
                self.outcome.problems.append(f'{part} in the file was never in memory')
        if self.plan.ends == 'closed' and not self.outcome.problems:
            beside = sorted(path.name for path in self.path.parent.iterdir())
            if beside != [self.path.name]:
                self.outcome.problems.append(f'files are left at the end: {beside}')
            for name in replayed(self.plan.robot, self.plan.jitter_ns):
                kept, found = (
                    {key: value for key, value in state.items() if key not in NOT_MEMORY}
                    for state in (self._state(name), saved.states[name])
                )
                if digest_of(kept) != digest_of(found):
                    self.outcome.problems.append(f'{name}: the saved state is not the last one')


def _is_mapping(process: RobotProcess) -> bool:
    if process.nodes and not LEARNING & process.nodes.keys():
        return process.is_ready and not process.is_dead
    if not process.is_ready or process.is_dead:
        return False
    file = next(node.host.map for node in process.nodes.values())
    return file.store is not None and not file.recovery.is_catching_up


_combined = cache(combined_yaml)


@contextmanager
def installed(simulation: Simulation) -> Iterator[None]:
    """Replace transport, time, threads and disk of the nodes by those of a simulation."""
    from rclpy_standin import context, executors, logging

    scheduler = simulation.scheduler
    new_time, new_threading = VirtualTime(scheduler), VirtualThreading(scheduler)

    def present_context() -> Context:
        found: Context = scheduler.current.process.context  # type: ignore[attr-defined]
        return found

    class Lock(MapLock):
        def __init__(self, path: Path) -> None:
            super().__init__(path)
            simulation.disk.locks.setdefault(scheduler.current.process, []).append(self)

    class Store(store_module.MapStore):
        def cut(self, cut: Any, states: Any) -> None:
            simulation.note_cut(self, cut, states)
            super().cut(cut, states)

    replaced: list[tuple[Any, Any]] = [
        (sys.modules['time'], new_time), (sys.modules['threading'], new_threading),
        (sys.modules['sqlite3'], simulation.disk), (starting, simulation._starting),
        (get_default_context, present_context), (MapLock, Lock),
        (store_module.MapStore, Store),
        (combined_yaml, _combined),  # a pure function that takes most of the time of a restart
        (context.Graph, Graph), (context.Participant, lambda _: Participant(simulation.bus)),
        (executors.Guard, Guard), (executors.WaitSet, WaitSet),
    ]
    by_id = {id(old): (old, new) for old, new in replaced}
    with ExitStack() as stack:
        for name, module in list(sys.modules.items()):
            ours = name.startswith(('ratslam_ros.', 'rclpy_standin.'))
            if not ours or name == 'ratslam_ros.maps.reader':
                continue
            for key, value in list(vars(module).items()):
                old, new = by_id.get(id(value), (None, None))
                if old is value and old is not None:
                    stack.enter_context(mock.patch.object(module, key, new))
        stack.enter_context(
            mock.patch.object(logging, '_print', lambda record: simulation.log(
                f'[{record.level.name}] [{record.name}]: {record.text}'
            ))
        )
        # The executor of a simulation that has ended belongs to another bus.
        stack.enter_context(mock.patch.object(executors, '_global', None))
        stack.enter_context(
            mock.patch('ratslam_ros.live.action_wait.print_notice', simulation.log)
        )
        stack.enter_context(
            mock.patch('ratslam_ros.maps.input_log.write', simulation.disk.write)
        )
        yield
