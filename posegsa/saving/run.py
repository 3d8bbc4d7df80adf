"""The files of a tuning run: result, tables, figures and report, written and read."""

import reprlib
from collections.abc import Iterable
from dataclasses import fields, make_dataclass
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from posegsa import steps
from posegsa.arguments import check_type
from posegsa.config import SEARCHED
from posegsa.errors import RunFolderError
from posegsa.figures import result as result_figures
from posegsa.figures.choice import chosen_figures
from posegsa.figures.result import draw
from posegsa.figures.style import png
from posegsa.judging.evaluation import CONSTANT, TUNED, Evaluation
from posegsa.judging.metrics import QUANTILES
from posegsa.judging.result import TuneResult
from posegsa.judging.trajectory import Trajectory
from posegsa.optimisers import History
from posegsa.report import report_html
from posegsa.saving.folder import (
    FIGURES,
    MAX_BYTES,
    RECORDED,
    RECORDED_TABLE,
    RESULT,
    as_path,
    locked_folder,
    read_text,
    replace_files,
)
from posegsa.saving.records import from_csv, from_json, to_csv, to_json

SCHEMA = 4
"""Version of the format of result.json and evaluation.json."""

EVALUATION, TABLE, REPORT = "evaluation.json", "evaluation.txt", "report.html"
HISTORY, TRAJECTORY = "history.csv", "trajectory.csv"
_FIGURE = f"{FIGURES}/{{}}.png"
RUN_FIGURES = [_FIGURE.format(name) for name in result_figures.NAMES]
FILES = (REPORT, RESULT, EVALUATION, TABLE, HISTORY, TRAJECTORY)
RUN_FILES = [*FILES, *RUN_FIGURES]
"""All files of a finished run except checkpoints."""
MAX_ROW = 2**10
"""Maximum size of a row of trajectory.csv: it has 26 numbers of at most 25 characters."""

_ELSEWHERE = ("evaluation", "history", "trajectory")
"""The fields of a result that are stored in separate files."""
_TYPES = get_type_hints(TuneResult, include_extras=True)
_StoredResult: Any = make_dataclass(
    "StoredResult", [(name, kind) for name, kind in _TYPES.items() if name not in _ELSEWHERE]
)
"""The fields of a result that are stored in result.json."""


def save(
    result: TuneResult,
    folder: str | Path,
    *,
    overwrite: bool = False,
    figures: Iterable[str] | None = None,
) -> Path:
    """Write a result to the folder of a run: JSON, tables, figures and report.

    Args:
        result: From `tune` or `evaluate`.
        folder: Where; created if missing.
        overwrite: Replace another run's files there.
        figures: Names of the figures to draw; by default all.

    Returns:
        The folder.

    Raises:
        RunFolderError: The folder contains a run already, or cannot be written.
        ArgumentError: There is no figure with such a name.
    """
    check_type("result", result, TuneResult)
    names = run_figures(figures)
    with locked_folder(folder, overwrite=overwrite) as folder:
        write_run(result, folder, names)
    return folder


def run_figures(figures: Iterable[str] | None) -> list[str]:
    """Names of a run's figures from a user, checked; None is all.

    Raises:
        ArgumentError: There is no such figure.
    """
    return chosen_figures(figures, result_figures.NAMES)


def write_run(
    result: TuneResult,
    folder: Path,
    figures: list[str] | None = None,
    *,
    same_run: bool = False,
) -> None:
    """Write all files of a result at once, to a folder that the caller has locked.

    Args:
        result: What is written.
        folder: Where.
        figures: Names of the figures to draw, by default all; others in the folder are removed.
        same_run: Whether the folder contains the same run, which was judged again. Then the files
            of the search and the results on recordings are kept.

    Raises:
        RunFolderError: They cannot be written; the folder is unchanged.
    """
    steps.begin("writing" if figures == [] else "drawing")
    drawn = list(draw(result, figures).items())
    pictures = {name: png(figure) for name, figure in steps.each("drawing", drawn)}
    held = {field.name: getattr(result, field.name) for field in fields(_StoredResult)}
    evaluation = result.evaluation
    texts = {
        EVALUATION: to_json(evaluation, SCHEMA, _evaluation_summary(evaluation)),
        TABLE: evaluation.table() + "\n",
        REPORT: report_html(result, pictures),
        RESULT: to_json(_StoredResult(**held), SCHEMA, _result_summary(result)),
    }
    if not same_run:
        texts[HISTORY] = to_csv(result.history, counted="iteration")
        texts[TRAJECTORY] = to_csv(result.trajectory)
    files = {name: text.encode("utf-8") for name, text in texts.items()}
    drawn = {_FIGURE.format(name): picture for name, picture in pictures.items()}
    # Not all evaluations have all figures.
    stale = [*RUN_FIGURES] if same_run else [*RUN_FIGURES, RECORDED, RECORDED_TABLE]
    replace_files(folder, files | drawn, remove=stale)


def _evaluation_summary(evaluation: Evaluation) -> dict[str, Any]:
    return {
        "scenarios": evaluation.scenarios,
        "quantiles": QUANTILES,
        "contenders": {name: evaluation.summary(name) for name in evaluation.contenders},
    }


def _result_summary(result: TuneResult) -> dict[str, Any]:
    costs = {TUNED: result.training_costs, CONSTANT: result.constant_training_costs}
    return {
        "rules": result.tuned.fuzzy.rules,
        "training_mean": {name: np.mean(training) for name, training in costs.items()},
        "held_out_mean": {name: result.evaluation.cost(name).mean for name in costs},
        "held_out_scenarios": result.evaluation.scenarios,
        "warnings": result.warnings(),
    }


def load(folder: str | Path) -> TuneResult:
    """Read the folder of a run on simulated scenarios.

    Raises:
        RunFolderError: It is not a run's folder, or a file in it is damaged, has another format,
            or contradicts the others; names the file and the field.
    """
    folder = as_path("folder", folder)

    def text(name: str, limit: int = MAX_BYTES) -> str:
        return read_text(folder, name, of="finished run", limit=limit)

    stored = from_json(_StoredResult, text(RESULT), SCHEMA, folder / RESULT)
    longest = max(MAX_BYTES, MAX_ROW * stored.experiment.scenario.samples)
    result = TuneResult(
        **vars(stored),
        evaluation=from_json(Evaluation, text(EVALUATION), SCHEMA, folder / EVALUATION),
        history=_history(text(HISTORY), folder / HISTORY, stored.experiment.run.dtype),
        trajectory=from_csv(Trajectory, text(TRAJECTORY, longest), folder / TRAJECTORY),
    )
    _refuse_disagreement(folder, result)
    return result


def _history(text: str, source: Path, dtype: str) -> History:
    """A history at the run's precision, as in the search."""
    columns = from_csv(History, text, source, counted="iteration")
    with np.errstate(over="ignore"):  # a damaged history, which is refused below
        return History(*(a.astype(dtype) if a.dtype == np.float64 else a for a in columns))


def _refuse_disagreement(folder: Path, result: TuneResult) -> None:
    """Raise a RunFolderError if the files of a run do not fit together."""
    experiment, evaluation, history = result.experiment, result.evaluation, result.history
    last = round(float(evaluation.time[-1]) / experiment.scenario.sampling_time)
    both = [name for name in (TUNED, CONSTANT) if name in evaluation.contenders]
    numbers = evaluation.contenders[TUNED].filter.numbers if TUNED in both else {}
    k, gain = (
        evaluation.contenders[name].filter.numbers.get(value) if name in both else None
        for name, value in ((TUNED, "k"), (CONSTANT, "gain"))
    )
    also = sorted(one.key for one in experiment.also)
    samples, training = experiment.scenario.samples, experiment.run.training_scenarios
    for file, field, found, needed in (
        (RESULT, "keys of also", sorted(result.also), also),
        (EVALUATION, "contenders", both, [TUNED, CONSTANT]),
        (EVALUATION, f"contenders.{TUNED}.filter.k", k, result.parameters.tolist()),
        (EVALUATION, f"contenders.{CONSTANT}.filter.gain", gain, [result.constant_gain]),
        (EVALUATION, "rules in it", "rules" in numbers, experiment.fuzzy.rules == SEARCHED),
        (EVALUATION, "sample of the last time", last, samples - 1),
        (TRAJECTORY, "number of rows", len(result.trajectory.time), samples),
        (RESULT, "number of training_costs", len(result.training_costs), training),
        (HISTORY, "last best", float(history.best[-1]), result.best_cost),
        (HISTORY, "sum of non_finite", int(history.non_finite.sum()), result.non_finite),
    ):
        if found != needed:
            found, needed = reprlib.repr(found), reprlib.repr(needed)
            raise RunFolderError(f"{folder / file}: {field} = {found}; in {RESULT}: {needed}")
    if experiment.fuzzy.rules == SEARCHED:
        try:
            _ = result.tuned
        except ValueError as error:
            where = f"{folder / EVALUATION}: contenders.{TUNED}.filter.numbers"
            raise RunFolderError(f"{where}.{error}") from None
