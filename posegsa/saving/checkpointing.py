"""Checkpoints of a run: written during the search, read to resume it."""

import contextlib
import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Self

import jax

from posegsa import config
from posegsa.errors import (
    CheckpointError,
    DamagedCheckpointError,
    PosegsaWarning,
    RunFolderError,
    SearchError,
    SearchInterrupted,
)
from posegsa.optimisers import Search, lengthened
from posegsa.runtime import environment
from posegsa.saving.atomic_files import PART
from posegsa.saving.checkpoint import Checkpoint, read, save_search
from posegsa.saving.folder import CHECKPOINT_SUFFIX, CHECKPOINTS, write_errors
from posegsa.saving.interrupt import StopRequest, deferred_signals, resumable
from posegsa.saving.records import from_plain
from posegsa.search.population import CONFIGURED, cost_name
from posegsa.search.problem import TuningProblem
from posegsa.search.run_search import LONGEST_CHUNK, Found, Progress, first_search, run_search
from posegsa.settings.fields import NonNegative
from posegsa.settings.plain import plain

ROUNDING = ("posegsa", "jax", "numpy", "platform", "device")
"""Entries of the environment that may change the last bits of a result."""


class RecordedTask(NamedTuple):
    """The task of a run on recordings; the recordings themselves are not included."""

    position_weight: NonNegative
    training: list[str]
    """The fingerprint of each training recording."""
    held_out: list[str]
    """The fingerprint of each held-out recording."""


class About(NamedTuple):
    """The data in a checkpoint of a run besides the search."""

    experiment: config.Experiment
    """The experiment, with the number of iterations requested last."""
    search_seconds: NonNegative
    """Search time of all processes so far [s]."""
    compile_seconds: NonNegative
    environment: dict[str, str]
    cost: str
    """The name of the cost that is minimised (`search.population.cost_name`)."""
    recorded: RecordedTask | None
    """The task of a run on recordings; None for a run on simulated scenarios."""


class CheckpointedRun(NamedTuple):
    """A run read from a checkpoint."""

    checkpoint: Checkpoint
    about: About


def search_with_checkpoints(
    problem: TuningProblem,
    folder: Path,
    run: CheckpointedRun | None,
    progress: Callable[[Progress], object] | None,
    recorded: RecordedTask | None = None,
) -> Found:
    """Search to the end, or until a signal asks to stop where the search can be resumed.

    It continues a given run. Otherwise it starts a new one, which replaces all checkpoints in the
    locked folder. The times in the result are totals over all processes. `recorded` is the task of
    a run on recordings.

    Raises:
        SearchInterrupted: Ctrl-C, SIGTERM or SIGUSR1.
        SearchError: JAX failed.
        CheckpointError: The first checkpoint can't be written.
    """
    experiment = problem.experiment
    if run is None:
        with write_errors(folder):
            for path in checkpoint_paths(folder):
                path.unlink()
        search, before = first_search(problem), (0.0, 0.0)
    else:
        search = first_search(problem._replace(experiment=run.about.experiment))
        search = lengthened(run.checkpoint.search(search), experiment.search.total_iterations)
        before = run.about.search_seconds, run.about.compile_seconds
    with deferred_signals() as request:
        cost = cost_name(problem.cost)
        writer = CheckpointWriter(folder, experiment, request, before, cost, recorded)
        with resumable(lambda: f"interrupted {writer.where()}"), writer:
            found = run_search(problem, progress, search=search, after_chunk=writer)
    return found._replace(
        search_seconds=found.search_seconds + before[0],
        compile_seconds=found.compile_seconds + before[1],
    )


def newest_checkpoint(folder: Path) -> CheckpointedRun:
    """A run from its newest valid checkpoint; damaged ones are skipped with a warning.

    Raises:
        CheckpointError: There is no valid one, or it has another format.
    """
    if not folder.is_dir():
        raise CheckpointError(f"{folder}: is not a folder; needed: the folder of a run to resume")
    damaged = []
    for path in checkpoint_paths(folder):
        try:
            found = read(path)
        except DamagedCheckpointError as error:
            damaged.append(str(error))
            continue
        for message in damaged:
            warnings.warn(f"{message}; resuming from {path.name}", PosegsaWarning, stacklevel=2)
        return _run_of(found)
    none = f"{folder}: holds no checkpoint to resume from"
    if not damaged:
        none += "; a run has none that was stopped before its search began: start it again"
    raise CheckpointError("\n".join([*damaged, none]))


def _run_of(checkpoint: Checkpoint) -> CheckpointedRun:
    """The run in a checkpoint; warns if it was made where numbers may be rounded differently."""
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


@dataclass
class CheckpointWriter:
    """Writes a run's checkpoints, as a context around its search.

    It stops the search if a signal has asked for that, even after the last chunk; the process that
    resumes the run then judges it. A search that ends early, for whatever reason, is saved. If a
    checkpoint can't be written, a warning says so and the search continues until the next one is
    due; only the very first one must succeed.
    """

    folder: Path
    experiment: config.Experiment
    request: StopRequest
    before: tuple[float, float] = (0.0, 0.0)
    """Seconds of search and compilation in earlier processes."""
    cost: str = CONFIGURED
    """The name of the cost that is minimised."""
    recorded: RecordedTask | None = None
    """The task of a run on recordings; None for a run on simulated scenarios."""
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        self._last: tuple[Search, float, float] | None = None
        self._iteration, self._best = -1, math.inf
        self._saved: int | None = None  # iteration of the newest checkpoint
        self._saved_at = 0.0
        self._warned = False

    def __enter__(self) -> Self:
        """Remove files that earlier processes did not finish."""
        with write_errors(self.folder):
            (self.folder / CHECKPOINTS).mkdir(exist_ok=True)
            for path in (self.folder / CHECKPOINTS).glob(f"*{PART}"):
                path.unlink()
        return self

    def __call__(self, search: Search, search_seconds: float, compile_seconds: float) -> None:
        """Write a checkpoint if one is due; called as `search.run_search.AfterChunk` says.

        Raises:
            SearchInterrupted: A signal has asked to stop; the search is saved.
            CheckpointError: The very first checkpoint can't be written.
        """
        took = search_seconds - (self._last[1] if self._last else 0.0)
        self._last = search, search_seconds, compile_seconds
        self._iteration, self._best = int(search.iteration), float(search.best_cost)
        # A long chunk is saved at once: it must not be lost if the process ends during the next.
        if took > LONGEST_CHUNK or self._is_due():
            self._save()
        self.stop_if_asked()

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        """Save the search; turn an error of JAX into a SearchError that says how to resume."""
        if error is not None:
            with contextlib.suppress(CheckpointError, PosegsaWarning):
                self._save()
        if isinstance(error, jax.errors.JaxRuntimeError):
            raise SearchError(f"the search failed {self.where()}: {error}") from error
        if error is None:
            self.stop_if_asked()

    def _is_due(self) -> bool:
        """Whether a checkpoint is due: the first, the last, after an interval, before a stop."""
        intervals = self.experiment.checkpoint
        return (
            self._saved is None
            or self.request.signal_number is not None
            or self._iteration - self._saved >= intervals.iterations
            or self.clock() - self._saved_at >= intervals.seconds
            or self._iteration >= self.experiment.search.total_iterations
        )

    def stop_if_asked(self) -> None:
        """Stop the search if a signal has asked for that; an unfinished iteration is lost.

        Raises:
            SearchInterrupted: A signal has asked to stop.
        """
        if self.request.signal_number is not None:
            self._save()
            raise SearchInterrupted(f"interrupted {self.where()}", self.request.signal_number)

    def _save(self) -> None:
        if self._last is None or self._saved == self._iteration:
            return
        search, search_seconds, compile_seconds = self._last
        about = About(
            experiment=self.experiment,
            search_seconds=self.before[0] + search_seconds,
            compile_seconds=self.before[1] + compile_seconds,
            environment=environment(),
            cost=self.cost,
            recorded=self.recorded,
        )
        path = self.folder / CHECKPOINTS / f"{self._iteration:09d}{CHECKPOINT_SUFFIX}"
        try:
            save_search(path, search, plain(about))
        except CheckpointError as problem:
            if self._saved is None:
                raise
            self._saved_at = self.clock()  # try again when the next one is due
            if not self._warned:
                self._warned = True
                warnings.warn(
                    f"{problem}; the search goes on, its last checkpoint is that of iteration "
                    f"{self._saved}",
                    PosegsaWarning,
                    stacklevel=4,
                )
            return
        self._saved, self._saved_at, self._warned = self._iteration, self.clock(), False
        # The latest few are kept. Checkpoints of later iterations, which were damaged, are removed.
        with contextlib.suppress(OSError):
            numbered = [p for p in checkpoint_paths(self.folder) if p.stem.isdecimal()]
            later = [p for p in numbered if int(p.stem) > self._iteration]
            kept = len(later) + self.experiment.checkpoint.keep
            for path in [*later, *numbered[kept:]]:
                path.unlink()

    def where(self) -> str:
        """The progress of the search, and how to resume it, in words."""
        if self._last is None:
            return "before its first iteration; nothing is saved"
        saved = "" if self._saved == self._iteration else f" (saved: {self._saved})"
        iterations = self.experiment.search.total_iterations
        best = f", best cost {self._best:.4g}" if math.isfinite(self._best) else ""
        return (
            f"after iteration {self._iteration} of {iterations}{saved}{best}; "
            f"{how_to_resume(self.folder, self.recorded)}"
        )


def how_to_resume(folder: Path, recorded: RecordedTask | None) -> str:
    """How to resume the run in a folder, in words."""
    again = " --recording ... (the same)" if recorded is not None else ""
    return f"resume with: posegsa tune --resume {folder}{again}"


def checkpoint_paths(folder: Path) -> list[Path]:
    """A run's checkpoints, the newest first."""
    return sorted((folder / CHECKPOINTS).glob(f"*{CHECKPOINT_SUFFIX}"), reverse=True)
