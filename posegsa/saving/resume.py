"""Going on with a run: from which checkpoint, and with which experiment."""

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from posegsa import config
from posegsa.errors import (
    ArgumentError,
    CheckpointError,
    DamagedCheckpointError,
    PosegsaWarning,
    RunFolderError,
)
from posegsa.judging.result import TuneResult
from posegsa.optimisers import Search, lengthened
from posegsa.runtime import environment
from posegsa.saving.checkpoint import Checkpoint, read
from posegsa.saving.checkpointing import About, checkpoint_paths
from posegsa.saving.folder import as_path
from posegsa.saving.records import from_plain
from posegsa.saving.run import load
from posegsa.search.build import TuningProblem
from posegsa.search.named_optimisers import make_optimiser
from posegsa.search.run import first_search
from posegsa.settings.violations import Violation, report

ROUNDING = ("posegsa", "jax", "numpy", "platform", "device")
"""Entries of the environment that may change the last bits of a result."""


class CheckpointedRun(NamedTuple):
    """A run as its newest good checkpoint has it."""

    checkpoint: Checkpoint
    about: About

    @property
    def experiment(self) -> config.Experiment:
        """What it searches."""
        return self.about.experiment

    @property
    def seconds(self) -> tuple[float, float]:
        """Time that it has searched and compiled [s]."""
        return self.about.search_seconds, self.about.compile_seconds

    def search(self, problem: TuningProblem) -> Search:
        """Its search, with room for as many iterations as a problem asks for."""
        begun = problem._replace(optimiser=make_optimiser(self.experiment))
        search = self.checkpoint.search(first_search(begun))
        return lengthened(search, problem.experiment.search.iterations)


def folder_to_resume(resume: object, out: str | Path | None, overwrite: bool) -> Path:
    """The folder of the run to go on with, if `tune`'s arguments make sense together.

    Raises:
        ArgumentError: They don't.
        RunFolderError: There is no such folder.
    """
    folder = as_path("resume", resume)
    if overwrite:
        raise ArgumentError("overwrite = True; allowed: False, as resume goes on with a run")
    if out is not None and Path(out) != folder:
        raise ArgumentError(f"out = {out!s}; allowed: nothing, as resume = {folder} is the folder")
    if not folder.is_dir():
        raise RunFolderError(f"{folder}: is not a folder; needed: that of a run to go on with")
    return folder


def newest_checkpoint(folder: Path) -> CheckpointedRun:
    """A run from its newest good checkpoint; damaged ones are passed over with a warning.

    Raises:
        CheckpointError: There is no good one, or it is of another format.
    """
    if not folder.is_dir():
        raise CheckpointError(f"{folder}: is not a folder; needed: that of a run to go on with")
    damaged = []
    for path in checkpoint_paths(folder):
        try:
            found = read(path)
        except DamagedCheckpointError as error:
            damaged.append(str(error))
            continue
        for message in damaged:
            warnings.warn(f"{message}; going on from {path.name}", PosegsaWarning, stacklevel=2)
        return _run_of(found)
    none = f"{folder}: holds no checkpoint to go on from"
    if not damaged:
        none += "; a run with search.optimiser = 'pycma' makes none and can't be resumed"
    raise CheckpointError("\n".join([*damaged, none]))


def _run_of(checkpoint: Checkpoint) -> CheckpointedRun:
    """The run that a checkpoint is of; warns if it was made where numbers may round differently."""
    try:
        about = from_plain(About, checkpoint.about, checkpoint.path)
    except RunFolderError as error:
        raise CheckpointError(f"{error}; needed: the checkpoint of a tuning run") from None
    here = environment()
    made = {name: about.environment.get(name, "unknown") for name in ROUNDING}
    differs = [f"{k} {made[k]}, here {here[k]}" for k in ROUNDING if made[k] != here[k]]
    if differs:
        warnings.warn(
            f"{checkpoint.path} was made elsewhere ({'; '.join(differs)}): the result may differ "
            "by rounding from that of an uninterrupted run",
            PosegsaWarning,
            stacklevel=3,
        )
    return CheckpointedRun(checkpoint, about)


def finished_result(folder: Path, experiment: config.Experiment) -> TuneResult | None:
    """The result of this experiment, if the folder has it."""
    try:
        result = load(folder)
    except RunFolderError:
        return None
    same = result.experiment.model_copy(update={"checkpoint": experiment.checkpoint})
    return result if same == experiment else None


def experiment_to_resume(stored: config.Experiment, asked: config.Experiment) -> config.Experiment:
    """The experiment to go on with: the stored one, with what may change as it is asked for.

    That is when checkpoints are made, and more iterations. Past the iterations that the run began
    with, G and K_best hold their final values, and `gsa.decay_iterations` says so.

    Raises:
        ConfigError: They differ in anything else, or fewer iterations are asked for; names it.
    """
    have, want = (dict(_leaves(e.model_dump(mode="json"))) for e in (stored, asked))
    open_to_change = {"search.iterations"}
    if asked.gsa.decay_iterations == "all":
        open_to_change.add("gsa.decay_iterations")
    problems = [
        Violation(key, f"the run has {have.get(key, 'no such value')}; allowed: the same", value)
        for key, value in want.items()
        if have.get(key) != value
        and key not in open_to_change
        and not key.startswith("checkpoint.")
    ]
    problems += [
        Violation(key, f"missing; the run has {value}")
        for key, value in have.items()
        if key not in want
    ]
    first, iterations = stored.search.iterations, asked.search.iterations
    if iterations < first:
        reason = f"the run has {first}; allowed: as many or more"
        problems.append(Violation("search.iterations", reason, iterations))
    if iterations > first and "adam" in stored.search.optimiser:
        reason = f"the run has {first}; allowed: the same, as Adam's steps shrink towards the end"
        problems.append(Violation("search.iterations", reason, iterations))
    if problems:
        raise report("the run to go on with is of another experiment", problems)
    decay = stored.gsa.decay_iterations
    if decay == "all" and iterations > first and stored.search.optimiser == "gsa":
        decay = first
    changes: dict[str, Any] = {
        "search": stored.search.model_copy(update={"iterations": iterations}),
        "gsa": stored.gsa.model_copy(update={"decay_iterations": decay}),
        "checkpoint": asked.checkpoint,
    }
    return stored.model_copy(update=changes)


def _leaves(data: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every value of nested plain data, by its dotted path."""
    if isinstance(data, Mapping):
        items = data.items()
    elif isinstance(data, list) and data:
        items = enumerate(data)
    else:
        yield path, data
        return
    for key, value in items:
        yield from _leaves(value, f"{path}.{key}" if path else str(key))
