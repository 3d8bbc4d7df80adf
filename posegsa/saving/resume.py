"""Checks for resuming a run: same folder, and the same experiment or a longer one."""

from pathlib import Path
from typing import Any

import jax

from posegsa import config
from posegsa.arguments import refuse
from posegsa.errors import ArgumentError, RunFolderError
from posegsa.judging.recorded import RecordingResult
from posegsa.judging.result import TuneResult
from posegsa.saving.checkpointing import RecordedTask
from posegsa.saving.folder import as_path
from posegsa.saving.recorded import load_recorded
from posegsa.saving.run import load
from posegsa.settings.violations import Refused, Violation, violations_error


def folder_to_resume(resume: str | Path, out: str | Path | None, overwrite: bool) -> Path:
    """The folder of the run to resume, after checking that the arguments of `tune` fit together.

    Raises:
        ArgumentError: They do not.
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


def finished_result(folder: Path, experiment: config.Experiment) -> TuneResult | None:
    """The result of this experiment, if it is in the folder."""
    try:
        result = load(folder)
    except RunFolderError:
        return None
    same = result.experiment.model_copy(update={"checkpoint": experiment.checkpoint})
    return result if same == experiment else None


def check_same_recordings(stored: RecordedTask | None, asked: RecordedTask, folder: Path) -> None:
    """Raise an ArgumentError unless a run was tuned on these recordings with these arguments."""
    if stored is None:
        refuse(f"recordings with resume = {folder}", "none: the run is on simulated scenarios")
    for name in ("schedule", "position_weight"):
        if (given := getattr(asked, name)) != (kept := getattr(stored, name)):
            refuse(f"{name} = {given!r}", f"{kept!r}, as in the run to go on with")
    for name, own, kept in (
        ("recordings", asked.training, stored.training),
        ("held_out", asked.held_out, stored.held_out),
    ):
        if len(own) != len(kept):
            refuse(f"{name}: {len(own)} of them", f"the {len(kept)} of the run to go on with")
        for i, (one, other) in enumerate(zip(own, kept, strict=True)):
            if one != other:
                refuse(f"{name}[{i}]: holds other numbers", "that of the run to go on with")


def finished_on_recordings(
    folder: Path, experiment: config.Experiment, task: RecordedTask
) -> RecordingResult | None:
    """The result of this experiment on these recordings, if it is in the folder."""
    try:
        result = load_recorded(folder)
    except RunFolderError:
        return None
    own = result.experiment.model_copy(update={"checkpoint": experiment.checkpoint})
    trained = [one.fingerprint for one in result.training]
    asked = (experiment, task.training, task.schedule, task.position_weight)
    found = (own, trained, result.filter.kind, result.position_weight)
    return result if found == asked else None


def experiment_to_resume(stored: config.Experiment, asked: config.Experiment) -> config.Experiment:
    """The experiment to resume: the stored one with the allowed changes.

    Allowed are another [checkpoint] and, if the optimiser supports it, more iterations.

    Raises:
        ConfigError: Something else differs, or there are fewer iterations; names it.
    """
    have, want = (
        _leaves(one.model_dump(mode="json", exclude={"search", "checkpoint"}))
        for one in (stored, asked)
    )
    problems = []
    for key in want | have:
        if key not in want:
            problems.append(Violation(key, f"missing; the run has {have[key]}"))
        elif have.get(key) != want[key]:
            reason = f"the run has {have.get(key, 'no such value')}; allowed: the same"
            problems.append(Violation(key, reason, want[key]))
    search = stored.search
    try:
        search = search.resumed(asked.search)
    except Refused as refused:
        problems += [problem.under(("search",)) for problem in refused.violations]
    if problems:
        raise violations_error("the run to go on with is of another experiment", problems)
    return stored.model_copy(update={"search": search, "checkpoint": asked.checkpoint})


def _leaves(data: dict[str, Any]) -> dict[str, Any]:
    """The values of nested plain data by their dotted paths."""
    leaves = jax.tree_util.tree_leaves_with_path(data)
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves}
