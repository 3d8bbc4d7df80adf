"""The folder of a sweep: a file for each finished run, with tables and figures of all runs.

    runs/*.json               one run each, named after its experiment; only these are read
    sweep.txt, sweep.csv      the settings, over seeds
    runs.csv                  the single runs
    figures/*.png             one for each varied key

Several processes may write to one folder at once, because each run has its own file.
"""

import shutil
from collections.abc import Iterable
from pathlib import Path

from posegsa.config import Experiment
from posegsa.errors import ConfigError, RunFolderError
from posegsa.figures.style import png
from posegsa.figures.sweep_figures import plot_sweep
from posegsa.judging.sweep_runs import Sweep, SweepRun, run_name
from posegsa.saving.atomic_files import write_atomically
from posegsa.saving.folder import (
    FIGURES,
    as_path,
    finish_commit,
    lock,
    read_text,
    replace_files,
    write_errors,
)
from posegsa.saving.records import from_json, to_json

SCHEMA = 2
"""Version of the format of a run's file."""
RUNS = "runs"
TABLE, DATA, EACH = "sweep.txt", "sweep.csv", "runs.csv"
FILES = (TABLE, DATA, EACH)


def stored_runs(folder: Path) -> list[SweepRun]:
    """The runs in a folder; none if there is no such folder.

    Raises:
        RunFolderError: One is damaged or has another format or name, or they are not of one sweep.
    """
    runs = [_read(path) for path in sorted((folder / RUNS).glob("*.json"))]
    for run in runs:
        _refuse_another(folder, run, runs[0].base, list(runs[0].values))
    return runs


def _read(path: Path) -> SweepRun:
    text = read_text(path.parent, path.name, of="run of a sweep")
    run = from_json(SweepRun, text, SCHEMA, path)
    try:
        name = run_name(run.experiment)
    except ConfigError as error:
        raise RunFolderError(f"{path}: values: {error}") from None
    if path.stem != name:
        raise RunFolderError(f"{path}: is the run of another experiment; allowed: {name}.json")
    return run


def _refuse_another(folder: Path, run: SweepRun, base: Experiment, keys: list[str]) -> None:
    """Raise a RunFolderError unless a run in a folder belongs to this sweep."""
    if list(run.values) != keys:
        found, needed = (", ".join(names) for names in (run.values, keys))
        raise RunFolderError(f"{folder}: holds a sweep over {found}; needed: over {needed}")
    if run.base != base:
        raise RunFolderError(
            f"{folder}: holds a sweep of another experiment; choose another folder, or replace "
            "what is there (--overwrite; overwrite=True)"
        )


def prepare_sweep_folder(
    folder: Path, base: Experiment, keys: list[str], *, overwrite: bool = False
) -> list[SweepRun]:
    """Create the folder of a sweep if it is missing, and return the runs that it already contains.

    Args:
        folder: The folder.
        base: The settings that the sweep does not vary.
        keys: The keys that it varies.
        overwrite: Remove the runs of another sweep.

    Raises:
        RunFolderError: It cannot be written, or contains another sweep.
    """
    with write_errors(folder):
        (folder / RUNS).mkdir(parents=True, exist_ok=True)
    try:
        runs = stored_runs(folder)
        for run in runs[:1]:
            _refuse_another(folder, run, base, keys)
    except RunFolderError:
        if not overwrite:
            raise
        with write_errors(folder):
            shutil.rmtree(folder / RUNS)
            (folder / RUNS).mkdir()
        return []
    return runs


def write_sweep_run(folder: Path, run: SweepRun) -> None:
    """Write one run of a sweep to its folder.

    Raises:
        RunFolderError: It cannot be written.
    """
    with write_errors(folder):
        path = folder / RUNS / f"{run_name(run.experiment)}.json"
        write_atomically(path, to_json(run, SCHEMA).encode())


def write_sweep(folder: Path, sweep: Sweep) -> None:
    """Write tables and figures of a sweep.

    Raises:
        RunFolderError: They cannot be written.
    """
    texts = {TABLE: sweep.table() + "\n", DATA: sweep.csv(), EACH: sweep.runs_csv()}
    files = {name: text.encode() for name, text in texts.items()}
    figures = {f"{FIGURES}/{key}.png": png(plot_sweep(sweep, key)) for key in sweep.keys}
    with lock(folder):
        finish_commit(folder)
        replace_files(folder, files | figures, remove=())


def load_sweep(folder: str | Path) -> Sweep:
    """The sweep in a folder, finished or not.

    Raises:
        RunFolderError: There is none, or a file is damaged; names the file and the field.
    """
    path = as_path("folder", folder)
    runs = stored_runs(path)
    if not runs:
        raise RunFolderError(f"{path}: holds no runs of a sweep ({RUNS}/*.json)")
    return Sweep(tuple(in_order(runs)))


def merge_sweeps(folders: Iterable[str | Path], out: str | Path | None = None) -> Sweep:
    """Merge the runs of several folders of one sweep, such as its shards; write tables and figures.

    Args:
        folders: The folders with the runs; a run that is in several folders counts once.
        out: The folder for all runs, tables and figures; by default the first of `folders`.

    Raises:
        RunFolderError: A folder has no runs or those of another sweep, or `out` cannot be written.
    """
    given = [as_path("folder", folder) for folder in folders]
    if not given:
        raise RunFolderError("folders: none; allowed: at least one")
    runs: dict[str, SweepRun] = {}
    for folder in given:
        found = load_sweep(folder).runs
        first = next(iter(runs.values()), found[0])
        _refuse_another(folder, found[0], first.base, list(first.values))
        runs |= {run_name(run.experiment): run for run in found}
    target = given[0] if out is None else as_path("out", out)
    there = prepare_sweep_folder(target, first.base, list(first.values))
    for name in runs.keys() - {run_name(run.experiment) for run in there}:
        write_sweep_run(target, runs[name])
    merged = load_sweep(target)
    write_sweep(target, merged)
    return merged


def in_order(runs: Iterable[SweepRun]) -> list[SweepRun]:
    """Runs sorted by their values, numbers by size and words alphabetically, then by seed."""

    def rank(run: SweepRun) -> list[tuple[bool, float, str]]:
        values = [*run.values.values(), run.seed]
        numbers = [isinstance(value, int | float) for value in values]
        return [
            (not number, float(value) if number else 0.0, "" if number else str(value))
            for number, value in zip(numbers, values, strict=True)
        ]

    return sorted(runs, key=rank)
