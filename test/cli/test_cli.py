# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ``ratslam`` command: files, output and exit codes."""

import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import (
    ODOM_TOPIC,
    PERIOD_NS,
    SMALL_IMAGES,
    START_NS,
    circles,
    image_message,
    set_options,
    write_bag,
)

from ratslam_ros import __version__, console
from ratslam_ros.cli import main
from ratslam_ros.offline import demo
from ratslam_ros.pipeline.items import Step
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.recordings import Event
from ratslam_ros.recordings.bag import BagRecording
from ratslam_ros.results import plots
from ratslam_simulator.recording import write_recording

pytestmark = pytest.mark.usefixtures('signals')
Refusal = Callable[..., str]
REPOSITORY = Path(__file__).parents[2]
SIZES = set_options(SMALL_IMAGES)
SMALL = ['--config', 'extended', *SIZES]
WRITTEN = [
    'config.yaml', 'dead_reckoning.tum', 'frames.csv', 'history.sqlite', 'map.json',
    'map.png', 'matches.png', 'summary.json', 'trajectory.tum', 'trajectory_final.tum',
]


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp('recordings') / 'circles', circles(2, 20))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Change to an empty folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave plots empty, which take half of the time of a short replay."""
    monkeypatch.setattr(plots, 'save_figure', lambda figure, path: path.touch())


@pytest.fixture(scope='module')
def results(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('run') / 'results'
    before = signal.getsignal(signal.SIGTERM)
    assert main(['replay', str(bag), *SMALL, '--out', str(folder), '--quiet']) == 0
    signal.signal(signal.SIGTERM, before)
    return folder


@pytest.mark.usefixtures('undrawn')
def test_replay_without_configuration_is_inspected(
    bag: Path, here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    extra = ['--set', 'pose_cells.pc_dim_x=31', '--duration', '2']
    for arguments, count in ([], 3), (['--no-inspect'], 0), (['--config', 'default'], 0):
        words = ['replay', str(bag), *SIZES, *extra, *arguments, '--out', 'out', '--overwrite']
        assert main(words) == 0
        lines = capfd.readouterr().err.splitlines()
        starts = tuple(f'{word}: ' for word in ('rotation', 'odometry', 'images'))
        assert sum(line.startswith(starts) for line in lines) == count
        assert 'pc_dim_x: 31' in Path('out/config.yaml').read_text()


def test_replay_with_its_config_gives_the_same_files(results: Path, bag: Path, here: Path) -> None:
    config = str(results / 'config.yaml')
    assert main(['replay', str(bag), '--config', config, '--out', 'out', '--quiet']) == 0
    for name in ('map.json', 'frames.csv', 'trajectory_final.tum', 'config.yaml'):
        assert (here / 'out' / name).read_bytes() == (results / name).read_bytes()


def test_replay_as_module_gives_same_results(bag: Path, results: Path, here: Path) -> None:
    run = subprocess.run(
        [sys.executable, '-m', 'ratslam_ros', 'replay', str(bag), *SMALL, '--out', 'out'],
        cwd=here, capture_output=True, text=True, check=False,
        env={**os.environ, 'PYTHONPATH': str(REPOSITORY)},
    )
    assert run.returncode == 0, run.stderr
    assert '40 frames and 40 odometry messages' in run.stdout
    assert '20 templates' in run.stdout
    assert 'Traceback' not in run.stderr
    for name in ('map.json', 'frames.csv', 'trajectory_final.tum', 'map.png'):
        assert (here / 'out' / name).read_bytes() == (results / name).read_bytes()


def test_quiet_replay_is_linked_as_latest_and_prints_nothing(
    bag: Path, here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(['replay', str(bag), *SMALL, '--quiet']) == 0
    assert capfd.readouterr() == ('', '')
    (folder,) = [path for path in (here / 'results').iterdir() if not path.is_symlink()]
    assert folder.name.startswith('circles-')
    assert (here / 'results' / 'latest').resolve() == folder
    assert sorted(path.name for path in folder.iterdir()) == WRITTEN
    for picture in ('map.png', 'matches.png'):
        assert (folder / picture).read_bytes().startswith(b'\x89PNG')


@pytest.mark.usefixtures('undrawn')
def test_replay_with_truth_prints_errors(
    bag: Path, results: Path, here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    truth = results / 'dead_reckoning.tum'  # The simulated odometry is exact.
    assert main(['replay', str(bag), *SMALL, '--out', 'out', '--truth', str(truth)]) == 0
    out = capfd.readouterr().out
    assert 'dead reckoning    ATE   0.000 m' in out
    assert 'trajectory final' in out


# Wrong use: exit code 2 and one line with advice


@pytest.mark.parametrize(('extra', 'hint'), [
    (['--set', 'local_view.vt_match_treshold=0.1'], 'vt_match_threshold'),
    (['--set', 'local_view.vt_match_threshold=7'], '0 to 1'),
    (['--set', 'local_view.vt_match_threshold'], 'section.name=value'),
    (['--set', 'pose_cells.pc_w_e_dim=6'], 'odd'),
    (['--config', 'no_such_preset'], 'no such file or preset'),
    (['--image-topic', '/nowhere'], '/nowhere'),
    (['--image-topic', ODOM_TOPIC], ODOM_TOPIC),
    (['--odom-topic', ODOM_TOPIC, '--visual-odometry'], '--visual-odometry'),
    (['--truth', 'no_such_file.tum'], 'no_such_file.tum'),
    (['--start', '1000'], '1000'),
    (['--duration', '0'], 'duration'),
    (['--nonsense'], '--nonsense'),
], ids=' '.join)
def test_invalid_option_is_reported_in_one_line(
    bag: Path, here: Path, refusal: Refusal, extra: list[str], hint: str
) -> None:
    assert hint in refusal('replay', str(bag), *SMALL, *extra, '--out', 'out')
    assert not (here / 'out').exists()


def test_crop_outside_image_is_reported_in_one_line(
    bag: Path, here: Path, refusal: Refusal
) -> None:
    setting = 'local_view.image_crop_x_max=1000'
    line = refusal('replay', str(bag), *SIZES, '--set', setting, '--out', 'out')
    assert 'local_view.image_crop' in line
    assert '32 x 24 px' in line


@pytest.mark.parametrize('command', ['replay', 'play'])
def test_unknown_option_names_help_of_its_command(
    here: Path, refusal: Refusal, command: str
) -> None:
    line = refusal(command, 'a_bag', '--no-such-option', '5')
    assert '--no-such-option 5; see ratslam' in line
    assert line.endswith(f'ratslam {command} --help')


def test_missing_recording_is_reported_in_one_line(here: Path, refusal: Refusal) -> None:
    for command in ('replay', 'info', 'tune'):
        assert 'no_such_bag' in refusal(command, 'no_such_bag')


@pytest.mark.parametrize('text', ['', '1 2 3\n', '\x00\x01\x02'])
def test_invalid_truth_is_reported_before_replay(
    bag: Path, here: Path, refusal: Refusal, text: str
) -> None:
    (here / 'truth.tum').write_text(text)
    arguments = ['replay', str(bag), *SMALL, '--truth', 'truth.tum', '--out', 'out']
    assert 'truth.tum' in refusal(*arguments)
    assert not (here / 'out').exists()


@pytest.mark.parametrize('arguments', [
    [], ['nonsense'], ['replay'], ['evaluate', 'one.tum'], ['demo', '--seed', '-1'],
    ['demo', '--seeds', '0'], ['simulate', '--explore', '0'], ['info'],
], ids=' '.join)
def test_incomplete_command_is_reported_in_one_line(
    arguments: list[str], refusal: Refusal
) -> None:
    assert '--help' in refusal(*arguments)


def test_closed_standard_error_changes_no_exit_code() -> None:
    words = [sys.executable, '-m', 'ratslam_ros', 'replay', 'nothing']
    done = subprocess.run(
        ['sh', '-c', 'exec "$@" 2>&-', 'sh', *words], capture_output=True, cwd=REPOSITORY
    )
    assert (done.returncode, done.stdout) == (2, b'')


def test_file_that_is_no_recording_is_reported(here: Path, refusal: Refusal) -> None:
    (here / 'notes.txt').write_text('hello')
    (here / 'empty').mkdir()
    assert 'notes.txt' in refusal('replay', 'notes.txt')
    assert 'empty' in refusal('replay', 'empty')


def test_unwritable_output_is_reported_in_one_line(
    bag: Path, here: Path, refusal: Refusal
) -> None:
    (here / 'file').write_text('')
    arguments = ['replay', str(bag), *SMALL, '--out', 'file', '--quiet']
    assert '--out' in refusal(*arguments)


def test_demo_reports_unwritable_output(here: Path, refusal: Refusal) -> None:
    (here / 'file').write_text('')
    assert '--out' in refusal('demo', '--out', 'file/below')


def test_replay_without_odometry_prints_warning(
    bag: Path, here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A single image gives no visual odometry; the map is empty."""
    arguments = ['replay', str(bag), *SMALL, '--visual-odometry', '--duration', '0.05']
    assert main([*arguments, '--out', 'out', '--quiet']) == 0
    assert 'warning: no odometry could be used' in capfd.readouterr().err
    assert json.loads((here / 'out' / 'summary.json').read_text())['frames'] == 1
    assert (here / 'out' / 'map.png').exists()


def test_broken_video_is_reported_in_one_line(here: Path) -> None:
    """In a process of its own: FFmpeg writes to stderr, and reads its log level only once."""
    (here / 'broken.mp4').write_bytes(b'nothing of a video' * 100)
    done = subprocess.run(
        [sys.executable, '-m', 'ratslam_ros', 'info', 'broken.mp4'],
        capture_output=True, text=True, env={**os.environ, 'PYTHONPATH': str(REPOSITORY)},
    )
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1, done.stderr


def test_plot_without_results_is_reported_in_one_line(here: Path, refusal: Refusal) -> None:
    assert 'nowhere' in refusal('plot', 'nowhere')


# Interrupts


@pytest.mark.usefixtures('undrawn')
def test_interrupted_replay_writes_results_and_returns_130(
    bag: Path, here: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = BagRecording.events

    def interrupted(self: BagRecording, *arguments: Any) -> Iterator[Event]:
        for number, event in enumerate(whole(self, *arguments)):
            if number == 50:
                raise KeyboardInterrupt
            yield event

    monkeypatch.setattr(BagRecording, 'events', interrupted)
    assert main(['replay', str(bag), *SMALL, '--out', 'out', '--quiet']) == 130
    assert 'the results so far are in out' in capfd.readouterr().err
    assert json.loads((here / 'out' / 'map.json').read_text())['experiences']
    frames = json.loads((here / 'out' / 'summary.json').read_text())['frames']
    assert len((here / 'out' / 'frames.csv').read_text().splitlines()) == frames + 1
    assert 0 < frames < 40


def test_interrupt_before_first_result_keeps_earlier_results(
    results: Path, bag: Path, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(results, here / 'out')

    def interrupted(*arguments: Any) -> Iterator[Event]:
        raise KeyboardInterrupt
        yield

    monkeypatch.setattr(BagRecording, 'events', interrupted)
    assert main(['replay', str(bag), *SMALL, '--out', 'out', '--quiet']) == 130
    for name in WRITTEN:
        assert (here / 'out' / name).read_bytes() == (results / name).read_bytes(), name


@pytest.mark.usefixtures('undrawn')
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_signal_during_a_step_ends_replay_after_it(
    bag: Path, here: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    """An incomplete step would be in the map but not in the files."""
    calls = []

    class Signalled(RatSLAM):
        def image(self, *arguments: Any) -> list[Step]:
            calls.append(1)
            if len(calls) == 20:
                signal.raise_signal(number)
            return super().image(*arguments)

    monkeypatch.setattr('ratslam_ros.offline.replay.RatSLAM', Signalled)
    assert main(['replay', str(bag), *SMALL, '--out', 'out', '--quiet']) == 130
    assert len(calls) == 20
    assert json.loads((here / 'out' / 'summary.json').read_text())['frames'] == 20
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_interrupt_in_compiled_code_returns_130(
    here: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python raises SystemError, because Numba returns a result with an exception set."""
    def interrupted(*arguments: Any, **options: Any) -> str:
        raise SystemError('returned a result with an exception set') from KeyboardInterrupt()

    monkeypatch.setattr('ratslam_ros.offline.demo.run_demo', interrupted)
    assert main(['demo', '--out', 'out', '--quiet']) == 130
    assert capfd.readouterr().err == 'ratslam: interrupted\n'


# Other commands


def test_info_prints_topics_and_next_command(bag: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(['info', str(bag)]) == 0
    out = capfd.readouterr().out
    for part in (ODOM_TOPIC, '/camera/image', 'ratslam replay'):
        assert part in out


def test_evaluate_prints_text_or_json(
    results: Path, here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    files = [str(results / 'trajectory.tum'), str(results / 'dead_reckoning.tum')]
    assert main(['evaluate', *files, '--plot', 'error.png']) == 0
    assert (here / 'error.png').is_file()
    assert 'ATE' in capfd.readouterr().out
    assert main(['evaluate', *files, '--json']) == 0
    assert isinstance(json.loads(capfd.readouterr().out), dict)


@pytest.mark.parametrize('name', ['found.tum', 'truth.tum'])
def test_evaluate_replaces_no_trajectory(
    results: Path, here: Path, refusal: Refusal, name: str
) -> None:
    for copy in ('found.tum', 'truth.tum'):
        shutil.copy(results / 'trajectory.tum', copy)
    assert 'is read' in refusal('evaluate', 'found.tum', 'truth.tum', '--plot', name)
    assert Path(name).read_bytes() == (results / 'trajectory.tum').read_bytes()


def test_plot_draws_identical_plots(
    results: Path, here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(results, here / 'copy')
    names = 'matches.png', 'map.png'
    for name in names:
        (here / 'copy' / name).unlink()
    assert main(['plot', 'copy']) == 0
    printed = capfd.readouterr().out
    for name in names:
        assert name in printed
        assert (here / 'copy' / name).read_bytes() == (results / name).read_bytes()


def test_version_and_help(capfd: pytest.CaptureFixture[str]) -> None:
    for arguments in (['--version'], ['--help'], ['replay', '--help']):
        with pytest.raises(SystemExit) as end:
            main(arguments)
        assert end.value.code == 0
    assert __version__ in capfd.readouterr().out


@pytest.mark.usefixtures('undrawn')
def test_start_and_duration_select_part_of_recording(bag: Path, here: Path) -> None:
    arguments = ['--start', '1', '--duration', '2', '--out', 'out', '--quiet']
    assert main(['replay', str(bag), *SMALL, *arguments]) == 0
    lines = (here / 'out' / 'frames.csv').read_text().splitlines()[1:]
    assert len(lines) == 20
    assert lines[0].startswith(str(START_NS + 10 * PERIOD_NS))


# Numbers


@pytest.fixture
def titles(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list that receives the titles of all axes that are drawn."""
    found: list[str] = []
    save = plots.save_figure

    def record(figure: Any, path: Path) -> Path:
        found.extend(axes.get_title() for axes in figure.axes)
        return save(figure, path)

    monkeypatch.setattr(plots, 'save_figure', record)
    return found


def test_summary_output_and_plot_titles_have_equal_counts(
    here: Path, titles: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    *drive, (log_ns, topic, kind, _) = circles(4, 20)
    too_small = image_message(log_ns, np.zeros((4, 4), np.uint8))  # a frame without a template
    bag = write_bag(here / 'circles', [*drive, (log_ns, topic, kind, too_small)])
    assert main(['replay', str(bag), *SMALL, '--out', 'out']) == 0
    s = json.loads((here / 'out' / 'summary.json').read_text())
    printed = capfd.readouterr().out
    assert s['loop_closures'] > 0
    assert f'{s["frames"]} frames and {s["odometry"]} odometry messages' in printed
    sizes = [f'{s[name]} {name.replace("_", " ")}' for name in (
        'experiences', 'links', 'loop_closures')]
    assert ', '.join(sizes) in printed and titles[0] == ', '.join(sizes)
    assert titles[1].startswith(f'{s["frames"]} frames: {s["templates"]} new templates, ')


@pytest.mark.usefixtures('undrawn')
def test_info_and_inspection_print_equal_rates(
    here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Every third message is missing, so that mean and median interval differ."""
    kept = [one for number, one in enumerate(circles(2, 20)) if number // 2 % 3]
    bag = write_bag(here / 'circles', kept)
    assert main(['info', str(bag)]) == 0
    rates = {line.split()[3] for line in capfd.readouterr().out.splitlines() if ' Hz' in line}
    assert main(['replay', str(bag), *SIZES, '--out', 'out']) == 0
    inspected = capfd.readouterr().err
    assert all(f'{rate} Hz' in inspected for rate in rates)


# Folders of results


@pytest.mark.usefixtures('undrawn')
def test_earlier_results_stay_unless_overwritten(
    results: Path, bag: Path, here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(results, here / 'out')
    before = (here / 'out' / 'summary.json').read_bytes()
    words = ['replay', str(bag), *SMALL, '--out', 'out', '--quiet']
    assert main(words) == 0
    assert 'out-2' in capfd.readouterr().err
    assert sorted(path.name for path in (here / 'out-2').iterdir()) == WRITTEN
    assert (here / 'out' / 'summary.json').read_bytes() == before
    assert main([*words, '--overwrite']) == 0
    assert (here / 'out' / 'summary.json').read_bytes() != before


@pytest.mark.parametrize('command', ['replay', 'demo', 'tune', 'simulate'])
def test_unusable_folder_is_refused_before_anything_is_computed(
    command: str, bag: Path, here: Path, refusal: Refusal
) -> None:
    (here / 'thesis').mkdir()
    (here / 'thesis' / 'chapter.tex').write_text('')
    words = [command, str(bag)] if command in ('replay', 'tune') else [command]
    for folder in ('thesis', 'thesis/chapter.tex', 'thesis/chapter.tex/below', '/proc/below'):
        assert folder in refusal(*words, '--out', folder)


@pytest.mark.parametrize(('laps', 'limit_bytes'), [(8, 5_000), (2, 4_000)])
def test_full_disk_leaves_no_parts_and_names_path_and_space(
    here: Path, refusal: Refusal, laps: int, limit_bytes: int
) -> None:
    """A limit on the size of files stands for a full disk, while driving and at the end."""
    bag = write_bag(here / 'circles', circles(laps, 20))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, limits[1]))
    try:
        words = ['replay', str(bag), *SMALL, '--out', 'out', '--quiet', '--no-history']
        line = refusal(*words)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert re.search(r'^ratslam: out: .* need about \d+\.\d MB, and \d+\.\d MB are free', line)
    assert not (here / 'out').exists()


# Feedback


def test_demo_shows_every_phase_with_remaining_time(
    here: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console, 'is_terminal', lambda: True)
    monkeypatch.setattr(demo, 'write_recording', partial(write_recording, duration_s=10.0))
    assert main(['demo', '--out', 'out']) == 0
    out, err = capfd.readouterr()
    assert 'look-alike' not in out  # computing their share took half of the time
    phases = 'demo: ', 'simulating ', 'inspecting ', 'mapping ', 'drawing '
    found = [err.index(phase) for phase in phases]
    assert found == sorted(found)
    for phase in phases[1:4]:
        assert re.search(rf'{phase}.*left', err)


def test_missing_package_is_named_in_one_line(tmp_path: Path) -> None:
    code = (
        'import sys; sys.modules["zstandard"] = None\n'
        'from ratslam_ros.cli import main; sys.exit(main())'
    )
    done = subprocess.run(
        [sys.executable, '-c', code, 'info', str(tmp_path)],
        capture_output=True, text=True, check=False,
    )
    assert done.returncode == 2
    [line] = done.stderr.splitlines()
    assert 'needs zstandard' in line
    assert 'python3 -m colcon build' in line
