"""A result in its folder: result.json, and tables, figures and a report made from it."""

import reprlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from posegsa import steps
from posegsa.arguments import check_callable, check_type, refuse
from posegsa.config import SEARCHED, OwnConfig
from posegsa.errors import RunFolderError
from posegsa.figures import result_figures
from posegsa.figures.figure_choice import chosen_figures
from posegsa.figures.result_figures import draw
from posegsa.figures.style import png
from posegsa.judging.baselines import baselines
from posegsa.judging.evaluation import REPLAYED, Contender, own_name
from posegsa.judging.result import Result
from posegsa.report import report_html
from posegsa.saving.checkpointing import checkpoint_paths
from posegsa.saving.folder import (
    FIGURES,
    RESULT,
    as_path,
    locked_folder,
    read_text,
    replace_files,
)
from posegsa.saving.records import from_json, to_csv, to_json
from posegsa.search.configured_filters import OwnFilter
from posegsa.settings.fields import MAX_SAMPLES

SCHEMA = 8
"""Version of the format of result.json."""

SUMMARY, TABLE, REPORT = "summary.txt", "evaluation.txt", "report.html"
HISTORY, TRAJECTORY = "history.csv", "trajectory.csv"
_FIGURE = f"{FIGURES}/{{}}.png"
RUN_FIGURES = [_FIGURE.format(name) for name in result_figures.NAMES]
FILES = (REPORT, RESULT, SUMMARY, HISTORY, TABLE, TRAJECTORY)
RUN_FILES = [*FILES, *RUN_FIGURES]
"""All files of a finished run except checkpoints; `load` reads result.json alone."""
MAX_RESULT = 2**30 + 2**9 * MAX_SAMPLES
"""Maximum size of result.json: a sample of the trajectory takes 430 bytes, all else far less."""


def save(
    result: Result,
    folder: str | Path,
    *,
    overwrite: bool = False,
    figures: Iterable[str] | None = None,
) -> Path:
    """Write a result to a folder: result.json, and tables, figures and a report made from it.

    Args:
        result: From `tune`, `evaluate` or `configured`.
        folder: The folder; created if missing.
        overwrite: Replace another run's files there.
        figures: Names of the figures to draw; by default all that have something to show.

    Returns:
        The folder.

    Raises:
        RunFolderError: The folder contains a run already, or cannot be written.
        ArgumentError: There is no figure with such a name.
    """
    check_type("result", result, Result)
    names = run_figures(figures)
    with locked_folder(folder, overwrite=overwrite) as locked:
        write_result(result, locked, names)
    return locked


def run_figures(figures: Iterable[str] | None) -> list[str]:
    """A user's names of a run's figures, checked; None means all.

    Raises:
        ArgumentError: There is no such figure.
    """
    return chosen_figures(figures, result_figures.NAMES)


def write_result(
    result: Result,
    folder: Path,
    figures: list[str] | None = None,
    *,
    own_checkpoints: bool = False,
) -> None:
    """Write all files of a result at once, to a folder that the caller has locked.

    Args:
        result: The result to write.
        folder: The folder.
        figures: Names of the figures to draw, by default all; other figures in the folder are
            removed.
        own_checkpoints: Whether the folder's checkpoints belong to this result; others are removed.

    Raises:
        RunFolderError: They can't be written; the folder is as it was.
    """
    texts, pictures = {RESULT: to_json(result, SCHEMA)}, {}
    texts[SUMMARY] = result.summary() + "\n"
    if result.search is not None:
        texts[HISTORY] = to_csv(result.search.history, counted="iteration")
    if result.on_scenarios is not None:
        texts[TABLE] = result.on_scenarios.evaluation.table() + "\n"
        texts[TRAJECTORY] = to_csv(result.on_scenarios.trajectory)
    if result.on_scenarios is not None or result.on_recordings is not None:  # it was judged
        steps.begin("writing" if figures == [] else "drawing")
        drawn = list(draw(result, figures).items())
        pictures = {name: png(figure) for name, figure in steps.each("drawing", drawn)}
        texts[REPORT] = report_html(result, pictures)
    files = {name: text.encode("utf-8") for name, text in texts.items()}
    files |= {_FIGURE.format(name): picture for name, picture in pictures.items()}
    stale = [*RUN_FILES]
    if not own_checkpoints:
        stale += [str(path.relative_to(folder)) for path in checkpoint_paths(folder)]
    replace_files(folder, files, remove=stale)


def written(folder: str | Path) -> list[str]:
    """The names of the files of a run in its folder, as readable text: all figures are one name."""
    there = [name for name in RUN_FILES if (Path(folder) / name).exists()]
    return list(dict.fromkeys(name if name in FILES else f"{FIGURES}/" for name in there))


def load(folder: str | Path, *, filter: OwnFilter | None = None, edited: bool = False) -> Result:
    """Read a result from its folder: result.json alone.

    Args:
        folder: The folder of a run.
        filter: The user's own filter, if the result is of one: it is never imported because a file
            names it.
        edited: Read a file that was changed after posegsa wrote it. Tables, figures and report are
            not made again.

    Raises:
        RunFolderError: It is not a run's folder; or the file is damaged, was changed, has another
            format or contradicts itself, which names the field.
        ArgumentError: `filter` is missing, or has no effect.
    """
    check_callable("filter", filter if callable(filter) else None)
    path = as_path("folder", folder)
    if path.is_file():
        raise RunFolderError(f"{path}: is a file; allowed: the folder of a run")
    if (path / "recorded.json").exists() and not (path / RESULT).exists():
        raise RunFolderError(
            f"{path / 'recorded.json'}: written by a version of posegsa before 0.9; this version "
            "has all in result.json: run it again, or read it with the version that wrote it"
        )
    text = read_text(path, RESULT, of="finished run", limit=MAX_RESULT)
    how = "load(folder, edited=True), --edited"
    source = path / RESULT
    result = from_json(Result, text, SCHEMA, source, edited=edited, if_on_purpose=how)
    _refuse_disagreement(source, result)
    if isinstance(result.experiment.filter, OwnConfig):
        if filter is None:
            refuse(
                f"filter: none for {path}, a run of a filter of the user's own",
                "the filter, or its class (filter=..., --filter module:Class)",
            )
        return replace(result, own=filter)
    if filter is not None:
        refuse(f"filter for {path}", "none: the run is of a filter of posegsa")
    return result


def _keys_beside(
    result: Result, contenders: Mapping[str, Contender]
) -> Iterator[tuple[str, list[str], list[str]]]:
    """Keys of the numbers of the filters compared with the result's own: name, found, needed."""
    for name, (one, _) in baselines(result.experiment, result.filter).items():
        if name in contenders and (also := sorted(contenders[name].filter.also)):
            # Replayed gains are run with the numbers tuned along with the filter's own schedule.
            keys = result.also if name == REPLAYED else [each.key for each in one.also]
            needed = sorted(keys)
            yield f"on_scenarios: keys of filter.also of {name}", also, needed


def _refuse_disagreement(source: Path, result: Result) -> None:
    """Raise a RunFolderError where parts of a result do not fit together."""
    experiment = result.experiment
    checks = []
    if result.search is not None:
        also, history = sorted(one.key for one in experiment.also), result.search.history
        last = float(history.best[-1]) if len(history.best) else result.search.best_cost
        failed = int(history.non_finite.sum())
        checks += [
            ("keys of filter.also", sorted(result.also), also),
            ("last of search.history.best", last, result.search.best_cost),
            ("sum of search.history.non_finite", failed, result.search.non_finite),
        ]
    if result.on_scenarios is not None:
        judged, samples = result.on_scenarios, experiment.scenario.samples
        last = round(float(judged.evaluation.time[-1]) / experiment.scenario.sampling_time)
        contenders = judged.evaluation.contenders
        name = own_name(result.filter)
        own = contenders[name].filter.numbers if name in contenders else None
        both = [name for name in judged.training if name in contenders]
        rules = [one is not None for one in (judged.trust.rule_weights, judged.trust.uncovered)]
        checks += [
            ("on_scenarios.training", [*judged.training], both),
            ("number of on_scenarios.training", len(both), 2),
            (f"on_scenarios: filter of {name}", own, result.filter.numbers),
            *_keys_beside(result, contenders),
            ("on_scenarios: sample of the last time", last, samples - 1),
            ("on_scenarios: length of trajectory", len(judged.trajectory.time), samples),
            (
                "on_scenarios.trust: rule_weights, uncovered",
                rules,
                [result.filter.kind == "fuzzy"] * 2,
            ),
        ]
    for field, found, needed in checks:
        if found != needed:
            found, needed = reprlib.repr(found), reprlib.repr(needed)
            raise RunFolderError(f"{source}: {field} = {found}; needed by the rest: {needed}")
    fuzzy = result.filter.kind == "fuzzy"
    if fuzzy and ("rules" in result.filter.numbers) != (experiment.fuzzy.rules == SEARCHED):
        raise RunFolderError(f"{source}: filter.numbers: rules only where they were searched")
    try:
        _ = result.candidate, result.tuned
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise RunFolderError(f"{source}: filter.numbers: {error}") from None
