"""Checks for resuming a run: same folder, and the same experiment or a longer one."""

from pathlib import Path
from typing import Any

import jax

from posegsa import config
from posegsa.arguments import refuse
from posegsa.errors import ArgumentError, RunFolderError
from posegsa.judging.result import Result
from posegsa.saving.checkpointing import RecordedTask
from posegsa.saving.folder import as_path
from posegsa.saving.result_files import load
from posegsa.search.configured_filters import OwnFilter
from posegsa.settings.violations import Refused, Violation, violations_error


def folder_to_resume(resume: str | Path, out: str | Path | None, overwrite: bool) -> Path:
    """The folder of the run to resume, after checking that the arguments of `tune` fit together.

    Raises:
        ArgumentError: They do not.
        RunFolderError: There is no such folder.
    """
    folder = as_path("resume", resume)
    if overwrite:
        raise ArgumentError("overwrite = True; allowed: False, as resume continues a run")
    if out is not None and Path(out) != folder:
        raise ArgumentError(f"out = {out!s}; allowed: nothing, as resume = {folder} is the folder")
    if not folder.is_dir():
        raise RunFolderError(f"{folder}: is not a folder; needed: the folder of a run to resume")
    return folder


def finished_result(
    folder: Path,
    experiment: config.Experiment,
    task: RecordedTask | None,
    own: OwnFilter | None,
) -> Result | None:
    """The result of this experiment on these recordings, if there are any, from its folder."""
    try:
        result = load(folder, filter=own)
    except (RunFolderError, ArgumentError):
        return None
    same = result.experiment.model_copy(update={"checkpoint": experiment.checkpoint})
    on, search = result.on_recordings, result.search
    if same != experiment or search is None:
        return None
    if task is None:
        return result if search.tuned_on == "scenarios" else None
    trained = [] if on is None else [one.fingerprint for one in on.training]
    asked = (task.training, task.position_weight)
    return result if (trained, search.position_weight) == asked else None


def check_same_recordings(
    stored: RecordedTask | None, asked: RecordedTask | None, folder: Path
) -> None:
    """Raise an ArgumentError unless a run was tuned on these recordings with these arguments."""
    if stored is None and asked is None:
        return
    if stored is None:
        refuse(f"recordings with resume = {folder}", "none: the run is on simulated scenarios")
    if asked is None:
        refuse(
            f"resume = {folder} without recordings",
            "with those that it is tuned on and those held out (recordings=, held_out=; "
            "--recording, --held-out)",
        )
    if asked.position_weight != stored.position_weight:
        words = f"{stored.position_weight!r}, as in the run to resume"
        refuse(f"position_weight = {asked.position_weight!r}", words)
    for name, own, kept in (
        ("recordings", asked.training, stored.training),
        ("held_out", asked.held_out, stored.held_out),
    ):
        if len(own) != len(kept):
            refuse(f"{name}: {len(own)} of them", f"the {len(kept)} of the run to resume")
        for i, (one, other) in enumerate(zip(own, kept, strict=True)):
            if one != other:
                refuse(f"{name}[{i}]: holds other numbers", "that of the run to resume")


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
        raise violations_error("the run to resume is of another experiment", problems)
    return stored.model_copy(update={"search": search, "checkpoint": asked.checkpoint})


def _leaves(data: dict[str, Any]) -> dict[str, Any]:
    """The values of nested plain data by their dotted paths."""
    leaves = jax.tree_util.tree_leaves_with_path(data)
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves}
