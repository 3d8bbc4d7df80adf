"""Checkpoints of a tuning run: written while it searches, read to go on."""

import contextlib
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import jax

from posegsa import config
from posegsa.errors import (
    CheckpointError,
    DamagedCheckpointError,
    PosegsaWarning,
    SearchError,
    SearchInterrupted,
)
from posegsa.optimisers import Search
from posegsa.runtime import environment
from posegsa.saving.checkpoint import Checkpoint, read, save_search
from posegsa.saving.files import PART
from posegsa.saving.folder import CHECKPOINTS, SUFFIX, writing
from posegsa.saving.interrupt import Asked
from posegsa.settings.violations import Refused, Violation, report

COMPARED = ("posegsa", "jax", "numpy", "platform", "device")
"""What of the machine may change the last bits of a result."""


class Begun(NamedTuple):
    """A run that has begun, as its newest good checkpoint has it."""

    checkpoint: Checkpoint
    experiment: config.Experiment
    """What it searches; the iterations are those that were asked for at first."""
    search_seconds: float
    """Time that it has searched [s]."""
    compile_seconds: float


def begun(folder: Path) -> Begun:
    """The newest good checkpoint of a run's folder; damaged ones are passed over with a warning.

    Raises:
        CheckpointError: There is no good one, or it is of another format.
        ConfigError: Its experiment is not one of this version of posegsa.
    """
    if not folder.is_dir():
        raise CheckpointError(f"{folder}: is not a folder; needed: that of a run to go on with")
    damaged = []
    for path in _paths(folder):
        try:
            found = read(path)
        except DamagedCheckpointError as error:
            damaged.append(str(error))
            continue
        for message in damaged:
            warnings.warn(f"{message}; going on from {path.name}", PosegsaWarning, stacklevel=2)
        return _begun(found)
    none = f"{folder}: holds no checkpoint to go on from"
    if not damaged:
        none += "; a run with search.optimiser = 'pycma' makes none and can't be resumed"
    raise CheckpointError("\n".join([*damaged, none]))


def _begun(checkpoint: Checkpoint) -> Begun:
    about = checkpoint.about
    try:
        seconds = float(about["search_seconds"]), float(about["compile_seconds"])
        before, now = about["environment"], environment()
        made = {name: before.get(name, "unknown") for name in COMPARED}
        differs = [f"{k} {made[k]}, here {now[k]}" for k in COMPARED if made[k] != now[k]]
        experiment = about["experiment"]
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise CheckpointError(f"{checkpoint.path}: is no tuning run's: {error!r}") from None
    if differs:
        warnings.warn(
            f"{checkpoint.path} was made elsewhere ({'; '.join(differs)}): the result may differ "
            "by rounding from that of an uninterrupted run",
            PosegsaWarning,
            stacklevel=3,
        )
    return Begun(checkpoint, config.from_dict(experiment), *seconds)


def agreed(stored: config.Experiment, asked: config.Experiment) -> config.Experiment:
    """The experiment to go on with: the stored one, with what may change as it is asked for.

    That is when checkpoints are made, and more iterations, as the optimiser allows them.

    Raises:
        ConfigError: They differ in anything else, or fewer iterations are asked for; names it.
    """
    have, want = (
        dict(_leaves(one.model_dump(mode="json", exclude={"search", "checkpoint"})))
        for one in (stored, asked)
    )
    problems = [
        Violation(key, f"the run has {have.get(key, 'no such value')}; allowed: the same", value)
        for key, value in want.items()
        if have.get(key) != value
    ]
    problems += [
        Violation(key, f"missing; the run has {value}")
        for key, value in have.items()
        if key not in want
    ]
    search = stored.search
    try:
        search = search.resumed(asked.search)
    except Refused as refused:
        problems += [problem.under(("search",)) for problem in refused.violations]
    if problems:
        raise report("the run to go on with is of another experiment", problems)
    return stored.model_copy(update={"search": search, "checkpoint": asked.checkpoint})


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


class Saver:
    """Writes a run's checkpoints, as a context around its search.

    Called with the search whenever Python has it in hand, it writes when one is due, and stops the
    search when a signal has asked for that, also when the search has just come to its end: what is
    left to do then is for who resumes it. Whatever ends the search early, what it had is saved.
    A checkpoint that can't be written is told, and tried again when the next is due: the search
    itself goes on, unless it has not begun.
    """

    def __init__(
        self,
        folder: Path,
        experiment: config.Experiment,
        asked: Asked,
        before: tuple[float, float] = (0.0, 0.0),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._folder = folder
        self._experiment = experiment
        self._asked = asked
        self._before = before
        self._clock = clock
        self._last: tuple[Search, float, float] | None = None
        self._iteration = -1
        self._saved: int | None = None
        self._saved_at = 0.0
        self._complained = False

    def __enter__(self) -> Self:
        """Clear away what earlier processes left half written."""
        with writing(self._folder):
            (self._folder / CHECKPOINTS).mkdir(exist_ok=True)
            for path in (self._folder / CHECKPOINTS).glob(f"*{PART}"):
                path.unlink()
        return self

    def __call__(self, search: Search, search_seconds: float, compile_seconds: float) -> None:
        """Look at the search so far.

        Args:
            search: The search.
            search_seconds: Time that this process has searched [s].
            compile_seconds: Time that it has compiled [s].

        Raises:
            SearchInterrupted: A signal has asked to stop; the search is saved.
            CheckpointError: The very first checkpoint can't be written.
        """
        self._last = search, search_seconds, compile_seconds
        self._iteration = int(search.iteration)
        intervals, iterations = (
            self._experiment.checkpoint,
            self._experiment.search.total_iterations,
        )
        if (
            self._saved is None
            or self._asked.signal_number is not None
            or self._iteration - self._saved >= intervals.iterations
            or self._clock() - self._saved_at >= intervals.seconds
            or self._iteration >= iterations
        ):
            self._save()
        self._stop_if_asked()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Save what there is; an error of JAX's says how to go on.

        Raises:
            SearchInterrupted: A signal has asked to stop since the search was last looked at.
            SearchError: JAX could not go on.
        """
        if error is not None and self._last is not None:
            with contextlib.suppress(CheckpointError, PosegsaWarning):
                self._save()
        if isinstance(error, jax.errors.JaxRuntimeError):
            raise SearchError(f"the search failed {self._where()}: {error}") from error
        if error is None:
            self._stop_if_asked()

    def _stop_if_asked(self) -> None:
        if self._asked.signal_number is not None:
            raise SearchInterrupted(f"interrupted {self._where()}", self._asked.signal_number)

    def _save(self) -> None:
        assert self._last is not None
        if self._saved == self._iteration:
            return
        search, *seconds = self._last
        search_seconds, compile_seconds = (
            a + b for a, b in zip(self._before, seconds, strict=True)
        )
        about = {
            "experiment": self._experiment.model_dump(mode="json"),
            "search_seconds": search_seconds,
            "compile_seconds": compile_seconds,
            "environment": environment(),
        }
        path = self._folder / CHECKPOINTS / f"{self._iteration:09d}{SUFFIX}"
        try:
            save_search(path, search, about)
        except CheckpointError as problem:
            if self._saved is None:
                raise
            self._saved_at = self._clock()  # not again before the interval is over
            if not self._complained:
                self._complained = True
                warnings.warn(
                    f"{problem}; the search goes on, its last checkpoint is that of iteration "
                    f"{self._saved}",
                    PosegsaWarning,
                    stacklevel=4,
                )
            return
        self._saved, self._saved_at, self._complained = self._iteration, self._clock(), False
        with contextlib.suppress(OSError):
            numbered = [p for p in _paths(self._folder) if p.stem.isdecimal()]
            # Later ones were passed over as damaged: they would count as newer than this one.
            later = [p for p in numbered if int(p.stem) > self._iteration]
            kept = len(later) + self._experiment.checkpoint.keep
            for old in [*later, *numbered[kept:]]:
                old.unlink()

    def _where(self) -> str:
        """Where the search stands, and how to go on from what is saved of it."""
        saved = "" if self._saved == self._iteration else f" (saved: {self._saved})"
        best = float(self._last[0].best_cost) if self._last else float("inf")
        iterations = self._experiment.search.total_iterations
        return (
            f"after iteration {self._iteration} of {iterations}{saved}, best cost {best:.4g}; go "
            f"on with: posegsa tune --resume {self._folder}"
        )


def discard(folder: Path) -> None:
    """Remove the checkpoints of a run that another replaces."""
    with writing(folder):
        for path in _paths(folder):
            path.unlink()


def _paths(folder: Path) -> list[Path]:
    """A run's checkpoints, the newest first."""
    return sorted((folder / CHECKPOINTS).glob(f"*{SUFFIX}"), reverse=True)
