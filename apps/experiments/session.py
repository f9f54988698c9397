"""An experiment from its list of runs to finished files: what is done is skipped, what fails does not stop the rest."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from warpdef.apps.experiments.plan import Experiment, label
from warpdef.apps.experiments.run import ExperimentRun, execute
from warpdef.apps.experiments.store import Store
from warpdef.errors import WarpdefError

Results = dict[str, dict[str, Any]]
Executor = Callable[[Sequence[ExperimentRun]], Iterator[tuple[ExperimentRun, "dict[str, Any] | Exception"]]]
"""Does runs in any order; yields each with its result, or with what stopped it."""


@dataclass
class Outcome:
    """What there is of an experiment.

    results:  of finished runs, by key
    failures: what stopped the others, by key, one sentence
    skipped:  how many were finished before
    """

    results: Results = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    skipped: int = 0


def run_experiment(
    experiment: Experiment,
    store: Store,
    executor: Executor,
    *,
    again: bool = False,
    say: Callable[[str], Any] = lambda text: None,
    after_each: Callable[[Outcome], Any] = lambda outcome: None,
) -> Outcome:
    """Do all runs that are not finished, and keep each as soon as it is.

    Args:
        experiment: what to do.
        store: where finished runs are.
        executor: does them, here or elsewhere.
        again: also those that are finished.
        say: told a line about every run.
        after_each: called when a run has been added.

    Raises:
        WarpdefError: a stored result is damaged. KeyboardInterrupt: finished runs are kept.
    """
    outcome = Outcome()
    runs = experiment.runs()
    for run in runs:
        found = None if again else store.find(run)
        if found is not None:
            outcome.results[run.key] = found
    outcome.skipped = len(outcome.results)
    waiting = [run for run in runs if run.key not in outcome.results]
    if outcome.skipped:
        say(f"{experiment.name}: {outcome.skipped} of {len(runs)} runs are finished already")
    names = {run.key: f"{label(run)}, {s.name}" for s in reversed(experiment.settings) for run in s.runs}
    for done, (run, result) in enumerate(executor(waiting), 1):
        place = f"[{done}/{len(waiting)}] {names[run.key]}"
        if isinstance(result, Exception):
            outcome.failures[run.key] = f"{names[run.key]}: {explain(result)}"
            say(f"{place}: FAILED: {explain(result)}")
            if not isinstance(result, WarpdefError):
                say("".join(traceback.format_exception(result)))
        else:
            store.put(run, result)
            outcome.results[run.key] = result
            cd, seconds = 1e5 * result["mean"]["chamfer_l2"], result["reconstruct_s"]
            say(f"{place}: CD {cd:.3f}e-5 in {seconds:.0f} s")
        after_each(outcome)
    return outcome


def explain(error: BaseException) -> str:
    """An error on one line; one that is not for users with its type."""
    text = " ".join(str(error).split())
    return text if isinstance(error, WarpdefError) else f"{type(error).__name__}: {text}"


def here(device: str = "auto", threads: int | None = None, keep: Path | None = None) -> Executor:
    """One run after the other in this process; those that ask for it in a process of their own."""

    def go(runs: Sequence[ExperimentRun]) -> Iterator[tuple[ExperimentRun, dict[str, Any] | Exception]]:
        for run in runs:
            try:
                work = _in_fresh_process if run.fresh else execute
                yield run, work(run, device, threads, keep)
            except Exception as error:  # a night's other runs go on; the error is reported with its traceback
                yield run, error

    return go


def _in_fresh_process(run: ExperimentRun, device: str, threads: int | None, keep: Path | None) -> dict[str, Any]:
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(execute, run, device, threads, keep).result()
