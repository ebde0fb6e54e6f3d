# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam study``: a parameter search over several recordings with Optuna, and its report.

Optuna is an optional dependency and is imported on first use. The study is kept in a storage, so
that it can be interrupted and resumed, and searched by several processes and machines.
"""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ratslam_ros.core.config import Config, Value
from ratslam_ros.errors import RatslamError, UnusableInput, UnusableParameter
from ratslam_ros.files.config import to_yaml
from ratslam_ros.results.plots import BLUE, GREY, VERMILLION, new_figure, save_figure
from ratslam_tuning.study_plan import Judge, Range, Result, StudyPlan

if TYPE_CHECKING:
    from optuna import Study
    from optuna import Trial as OptunaTrial
    from optuna.trial import FrozenTrial

VALIDATED_COUNT = 3
"""Number of the best configurations that are validated, beside the initial one."""

MIN_IMPORTANCE_TRIALS = 20
EXPLORING_SHARE = 0.2
"""Share of the trials that are drawn at random before the sampler uses their results."""

PLAN_KEY = 'plan'
"""User attribute of the study: the plan that its trials belong to."""


@dataclass(frozen=True)
class Validated:
    """A configuration with its results.

    Attributes:
        name: ``initial``, or the number of the trial.
        config: the configuration.
        values: values of the searched parameters.
        search: objective on the recordings of the search.
        results: results by recording, those of the search first.
    """

    name: str
    config: Config
    values: dict[str, Value]
    search: float
    results: tuple[Result, ...]


def import_optuna() -> Any:
    """Return the module.

    Raises:
        UnusableInput: it is not installed.
    """
    try:
        import optuna
    except ImportError:
        raise UnusableInput("studies require Optuna, which is not installed; install it with: "
                            "pip install '.[study]'") from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


def search(plan: StudyPlan, storage: str, jobs: int, report: Callable[[str], None]) -> None:
    """Run the trials of a study that are still missing in its storage.

    Args:
        plan: the study.
        storage: URL of a database, or path of a file.
        jobs: number of processes.
        report: called with a line of text after each trial; a function of a module if there are
            several jobs, as it is sent to other processes.

    Raises:
        UnusableInput: a recording or the storage cannot be used.
    """
    study = _open(plan, storage)
    for recording in plan.recordings:
        Judge(recording, plan.config).check()
    if jobs == 1:
        _work(plan, storage, 0, report)
        return
    context = multiprocessing.get_context('spawn')
    report(f'{_finished(study)} of {plan.trials} trials are finished; searching with {jobs} '
           'processes')
    workers = [context.Process(target=_work_or_report, args=(plan, storage, number, report))
               for number in range(jobs)]
    try:
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
    finally:
        for worker in workers:
            if worker.is_alive():
                worker.terminate()
                worker.join()
    if not _finished(study):
        raise UnusableInput('no trial was finished, for the reasons above')


def _work_or_report(plan: StudyPlan, storage: str, worker: int,
                    report: Callable[[str], None]) -> None:
    """Run trials in a process of its own; report an error in one line."""
    try:
        _work(plan, storage, worker, report)
    except RatslamError as error:
        report(str(error))
    except KeyboardInterrupt:
        return


def _work(plan: StudyPlan, storage: str, worker: int, report: Callable[[str], None]) -> None:
    """Run trials until the study has enough of them."""
    optuna = import_optuna()
    study = _open(plan, storage, worker)
    judges = [Judge(recording, plan.config) for recording in plan.recordings if recording.search]

    def objective(trial: OptunaTrial) -> float:
        values = {item.name: _suggest(trial, item) for item in plan.ranges}
        try:
            config = plan.config.with_values(values)
            results = [judge.judge(config) for judge in judges]
        except UnusableParameter as error:
            trial.set_user_attr('error', str(error))
            raise optuna.TrialPruned from None
        trial.set_user_attr('results', [result.text for result in results])
        return float(np.mean([result.value for result in results]))

    def finished(study: Study, trial: FrozenTrial) -> None:
        text = 'does not fit the images' if trial.value is None else f'{trial.value:.4f}'
        best = _ranked(study)
        report(f'trial {trial.number}: {text}'
               + (f', best {best[0].value:.4f} (trial {best[0].number})' if best else ''))
        if _finished(study) >= plan.trials:
            study.stop()

    if _finished(study) < plan.trials:
        study.optimize(objective, callbacks=[finished])


def _open(plan: StudyPlan, storage: str, worker: int = 0) -> Study:
    """Create or load the study."""
    optuna = import_optuna()
    try:
        if '://' in storage:
            backend: Any = optuna.storages.RDBStorage(storage)
        else:
            backend = optuna.storages.JournalStorage(
                optuna.storages.journal.JournalFileBackend(storage))
        study = optuna.create_study(storage=backend, study_name=plan.name, direction='maximize',
                                    load_if_exists=True)
    except (ImportError, OSError, ValueError, optuna.exceptions.StorageInternalError) as error:
        raise UnusableInput(f'the storage {storage} cannot be used: '
                            f'{" ".join(str(error).split())[:200]}') from None
    # A resumed study continues with other random numbers instead of repeating the first ones.
    seed = np.random.SeedSequence((plan.seed, worker, len(study.trials))).generate_state(1)[0]
    study.sampler = optuna.samplers.TPESampler(
        seed=int(seed), n_startup_trials=max(5, math.ceil(EXPLORING_SHARE * plan.trials)),
        multivariate=True, constant_liar=True)
    known = study.user_attrs.get(PLAN_KEY)
    if known is None:
        study.set_user_attr(PLAN_KEY, plan.fingerprint)
        study.enqueue_trial(_within(plan), skip_if_exists=True)
    elif known != plan.fingerprint:
        raise UnusableInput(f'the storage {storage} holds a study {plan.name!r} with other '
                            'recordings, ranges or initial values; give another --out or name')
    return study


def _within(plan: StudyPlan) -> dict[str, Value]:
    """Return the initial values that lie in their ranges; they are tried first."""
    return {item.name: value for item in plan.ranges
            if (value := plan.initial[item.name]) in item.values
            or (not item.values and not isinstance(value, (bool, str))
                and item.low <= value <= item.high)}


def _suggest(trial: OptunaTrial, item: Range) -> Value:
    value: Value
    if item.values:
        value = trial.suggest_categorical(item.name, item.values)
    elif isinstance(item.low, int):
        value = trial.suggest_int(item.name, item.low, int(item.high), log=item.log,
                                  step=1 if item.log else int(item.step or 1))
    else:
        value = trial.suggest_float(item.name, item.low, item.high, step=item.step, log=item.log)
    return value


def _ranked(study: Study) -> list[FrozenTrial]:
    """Return the trials with a value, best first."""
    trials = [trial for trial in study.get_trials(deepcopy=False)
              if trial.state.name == 'COMPLETE' and trial.value is not None]
    return sorted(trials, key=lambda trial: (-(trial.value or 0.0), trial.number))


def _finished(study: Study) -> int:
    return sum(trial.state.is_finished() for trial in study.get_trials(deepcopy=False))


# Report


def write_report(plan: StudyPlan, storage: str, folder: Path) -> str:
    """Validate the best configurations, and write report.md, its plots and best.yaml.

    Args:
        plan: the study.
        storage: URL of a database, or path of a file.
        folder: existing folder for the files.

    Returns:
        A summary for the terminal.

    Raises:
        UnusableInput: no trial has a value, or a recording cannot be used.
    """
    study = _open(plan, storage)
    best = _ranked(study)
    if not best:
        raise UnusableInput('no configuration of the study fits the recordings; check the ranges')
    judges = [Judge(recording, plan.config)
              for recording in sorted(plan.recordings, key=lambda r: not r.search)]
    rows = [_validated('initial', plan.initial, plan, judges)]
    rows += [_validated(f'trial {trial.number}', dict(trial.params), plan, judges)
             for trial in best[:VALIDATED_COUNT]]
    importance = _importance(study)
    draw_history(study, folder / 'history.png')
    draw_slices(study, plan, importance, folder / 'slices.png')
    (folder / 'best.yaml').write_text(to_yaml(rows[1].config), encoding='ascii')
    text = format_report(plan, rows, importance, _finished(study), len(best), judges)
    (folder / 'report.md').write_text(text, encoding='utf-8')
    return text


def _validated(name: str, values: dict[str, Value], plan: StudyPlan,
               judges: Sequence[Judge]) -> Validated:
    config = plan.config.with_values(values)
    results = tuple(judge.judge(config) for judge in judges)
    searched = [result.value for judge, result in zip(judges, results, strict=True)
                if judge.recording.search]
    return Validated(name, config, values, float(np.mean(searched)), results)


def _importance(study: Study) -> dict[str, float]:
    """Return the importance of the parameters, 0 to 1, largest first; empty if unknown."""
    optuna = import_optuna()
    values = [trial.value for trial in _ranked(study)]
    if len(values) < MIN_IMPORTANCE_TRIALS or len(set(values)) < 2:
        return {}
    found: dict[str, float] = optuna.importance.get_param_importances(
        study, evaluator=optuna.importance.PedAnovaImportanceEvaluator())
    return found


def format_report(plan: StudyPlan, rows: Sequence[Validated], importance: dict[str, float],
                  finished: int, complete: int, judges: Sequence[Judge]) -> str:
    """Format the report as Markdown."""
    lines = [f'# Study {plan.name}', '',
             f'{finished} trials, {finished - complete} of them without a map. The objective is '
             'the mean over the recordings of the search, 0 to 1, larger is better.', '',
             '| configuration | objective | ' + ' | '.join(
                 f'{judge.name} ({"search" if judge.recording.search else "validation"})'
                 for judge in judges) + ' |',
             '| --- ' * (2 + len(judges)) + '|']
    for row in rows:
        cells = [f'{result.value:.4f}: {result.text}' for result in row.results]
        lines.append(f'| {row.name} | {row.search:.4f} | {" | ".join(cells)} |')
    lines += ['', _verdict(rows, judges), '', '## Parameters', '',
              '| parameter | initial | ' + ' | '.join(row.name for row in rows[1:])
              + ' | importance |', '| --- ' * (2 + len(rows)) + '|']
    for item in plan.ranges:
        share = f'{importance[item.name]:.2f}' if item.name in importance else ''
        values = [_number(row.values[item.name]) for row in rows]
        lines.append(f'| {item.name} | {" | ".join(values)} | {share} |')
    lines += ['', '![objective of the trials](history.png)', '',
              '![objective over each parameter](slices.png)', '']
    return '\n'.join(lines)


def _verdict(rows: Sequence[Validated], judges: Sequence[Judge]) -> str:
    """State whether the best trial is better than the initial one on unused recordings."""
    held_out = [index for index, judge in enumerate(judges) if not judge.recording.search]
    if not held_out:
        return ('No recording is kept for validation: the figures above are those of the '
                'recordings that the values were chosen on.')
    initial, best = ([float(row.results[index].value) for index in held_out] for row in rows[:2])
    change = float(np.mean(best) - np.mean(initial))
    better = sum(b > a for a, b in zip(initial, best, strict=True))
    return (f'On the {len(held_out)} validation recordings, {rows[1].name} changes the objective '
            f'by {change:+.4f}; it is better on {better}.')


def _number(value: Value) -> str:
    return f'{value:.4g}' if isinstance(value, float) else str(value)


def draw_history(study: Study, path: Path) -> Path:
    """Draw the objective of each trial and the best one so far."""
    trials = sorted(_ranked(study), key=lambda trial: trial.number)
    numbers = [trial.number for trial in trials]
    values = np.array([trial.value for trial in trials], np.float64)
    figure = new_figure(8.0, 4.5)
    axes = figure.add_subplot()
    axes.plot(numbers, values, linestyle='', marker='.', color=BLUE, label='trial')
    axes.step(numbers, np.maximum.accumulate(values), where='post', color=VERMILLION,
              label='best so far')
    axes.set(xlabel='trial', ylabel='objective')
    axes.legend(fontsize=8)
    return save_figure(figure, path)


def draw_slices(study: Study, plan: StudyPlan, importance: dict[str, float],
                path: Path) -> Path:
    """Draw the objective of the trials over the values of each parameter."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    trials = _ranked(study)
    columns = min(len(plan.ranges), 3)
    rows = -(-len(plan.ranges) // columns)
    figure = new_figure(max(4.0 * columns, 6.0), 3.2 * rows)
    for index, item in enumerate(plan.ranges):
        axes = figure.add_subplot(rows, columns, index + 1)
        values: list[Any] = [trial.params[item.name] for trial in trials]
        if item.values:
            values = [str(value) for value in values]
        axes.plot(values, [trial.value for trial in trials], linestyle='', marker='.', color=GREY)
        axes.plot(values[:1], [trials[0].value], linestyle='', marker='o', color=VERMILLION)
        if item.log:
            axes.set_xscale('log')
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.xaxis.set_major_formatter(FormatStrFormatter('%g'))
            axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_ylabel('objective' if index % columns == 0 else '', fontsize=8)
        share = f'\nimportance {importance[item.name]:.2f}' if item.name in importance else ''
        axes.set_title(f'{item.name}{share}', fontsize=9)
        axes.tick_params(labelsize=7)
    return save_figure(figure, path)
