"""The folder of a tuning run: result, tables, figures and report, written and read."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from posegsa import config
from posegsa.arguments import check_type
from posegsa.errors import ConfigError, RunFolderError
from posegsa.figures import result as result_figures
from posegsa.figures.result import draw
from posegsa.figures.style import png
from posegsa.judging import evaluation
from posegsa.judging.evaluation import CONSTANT, TUNED
from posegsa.judging.result import TuneResult
from posegsa.judging.trajectory import read_trajectory
from posegsa.judging.trust import Trust
from posegsa.report import report_html
from posegsa.saving.folder import FIGURES, RESULT, as_path, claimed, read, replace_files
from posegsa.saving.history import history_csv, read_history

SCHEMA = 2
"""Number of the layout of result.json; it changes when a key changes its meaning."""

EVALUATION, TABLE, REPORT = "evaluation.json", "evaluation.txt", "report.html"
HISTORY, TRAJECTORY = "history.csv", "trajectory.csv"
MAX_BYTES = 2**27
"""Size up to which a file of a run is read: 128 MiB."""
MAX_ROW = 2**10
"""Size up to which trajectory.csv is read for each sample of its run, if that is more: a row has 25
numbers of at most 25 characters."""


def save(result: TuneResult, folder: str | Path, *, overwrite: bool = False) -> Path:
    """Write a result to the folder of a run: JSON, tables, figures and report.

    Args:
        result: From `tune` or `evaluate`.
        folder: Where; made if missing.
        overwrite: Replace another run's files there.

    Returns:
        The folder.

    Raises:
        RunFolderError: It holds a run already, or can't be written.
    """
    check_type("result", result, TuneResult)
    with claimed(folder, overwrite=overwrite) as folder:
        write(result, folder)
    return folder


def write(result: TuneResult, folder: Path) -> None:
    """Write all files of a result at once, to a folder that the caller has `claimed`."""
    pictures = {name: png(figure) for name, figure in draw(result).items()}
    texts = {
        HISTORY: history_csv(result.history),
        TRAJECTORY: result.trajectory.csv(),
        EVALUATION: result.evaluation.to_json(),
        TABLE: result.evaluation.table() + "\n",
        REPORT: report_html(result, pictures),
        RESULT: json.dumps(_plain(result), indent=2) + "\n",
    }
    figures = {_figure(name): picture for name, picture in pictures.items()}
    files = {name: text.encode("utf-8") for name, text in texts.items()} | figures
    # Not all evaluations have all figures.
    replace_files(folder, files, remove=[_figure(each.name) for each in result_figures.FIGURES])


def _plain(result: TuneResult) -> dict[str, Any]:
    tuned, constant = (
        {
            "training_mean": _number(np.mean(training)),
            "held_out_mean": _number(np.mean(held_out)),
            "held_out_worst": _number(np.max(held_out)),
            "held_out_diverged": int(np.sum(result.evaluation.contenders[name].metrics.diverged)),
            "training": [_number(c) for c in training],
        }
        for name, training in (
            (TUNED, result.training_costs),
            (CONSTANT, result.constant_training_costs),
        )
        for held_out in [result.evaluation.contenders[name].metrics.cost]
    )
    trust = vars(result.trust) | {"rule_weights": result.trust.rule_weights.tolist()}
    return {
        "schema": SCHEMA,
        "version": result.version,
        "best_cost": _number(result.best_cost),
        "parameters": dict(zip(config.PARAMETERS, result.parameters.tolist(), strict=True)),
        "tuned": tuned,
        "constant_gain": result.constant_gain,
        "constant": constant,
        "held_out_scenarios": result.evaluation.scenarios,
        "held_out_seed": result.evaluation.seed,
        "warnings": result.warnings(),
        "trust": {k: _number(v) if isinstance(v, float) else v for k, v in trust.items()},
        "evaluations": result.evaluations,
        "non_finite": result.non_finite,
        "compile_seconds": result.compile_seconds,
        "search_seconds": result.search_seconds,
        "environment": result.environment,
        "config": result.experiment.model_dump(mode="json"),
    }


def load(folder: str | Path) -> TuneResult:
    """Read a run's folder back.

    Raises:
        RunFolderError: It is not a run's folder, or a file in it is damaged or of another schema.
    """
    folder = as_path("folder", folder)
    path = folder / RESULT
    try:
        data = json.loads(read(folder, RESULT, MAX_BYTES))
    except RunFolderError:
        raise
    except OSError as error:
        raise RunFolderError(
            f"{folder}: holds no finished run ({RESULT}: {error.strerror})"
        ) from None
    except (ValueError, RecursionError) as error:
        raise RunFolderError(f"{path}: is not JSON: {error}") from None
    try:
        if data["schema"] != SCHEMA:
            raise RunFolderError(
                f"{path}: has schema {data['schema']}; this version of posegsa reads {SCHEMA}"
            )

        def costs(d: dict[str, Any]) -> np.ndarray:
            return np.array([float(c) for c in d["training"]])

        checked, experiment = data["trust"], config.from_dict(data["config"])
        longest = max(MAX_BYTES, MAX_ROW * experiment.scenario.samples)
        return TuneResult(
            experiment=experiment,
            best_cost=float(data["best_cost"]),
            parameters=np.array([float(data["parameters"][k]) for k in config.PARAMETERS]),
            training_costs=costs(data["tuned"]),
            constant_gain=float(data["constant_gain"]),
            constant_training_costs=costs(data["constant"]),
            evaluation=evaluation.from_json(read(folder, EVALUATION, MAX_BYTES)),
            trust=Trust(
                cost_float32=float(checked["cost_float32"]),
                cost_float64=float(checked["cost_float64"]),
                cost_perturbed=float(checked["cost_perturbed"]),
                sensitive=bool(checked["sensitive"]),
                uncovered=float(checked["uncovered"]),
                rule_weights=np.array(checked["rule_weights"], np.float64),
            ),
            evaluations=int(data["evaluations"]),
            non_finite=int(data["non_finite"]),
            compile_seconds=float(data["compile_seconds"]),
            search_seconds=float(data["search_seconds"]),
            history=read_history(read(folder, HISTORY, MAX_BYTES)),
            trajectory=read_trajectory(read(folder, TRAJECTORY, longest)),
            environment={str(k): str(v) for k, v in data["environment"].items()},
            version=str(data["version"]),
        )
    except OSError as error:
        if isinstance(error, RunFolderError):
            raise
        raise RunFolderError(f"{folder}: cannot be read: {error}") from None
    except (
        KeyError,
        TypeError,
        ValueError,
        AttributeError,
        OverflowError,
        RecursionError,
    ) as error:
        if isinstance(error, ConfigError):
            raise RunFolderError(f"{path}: its configuration is not valid: {error}") from None
        raise RunFolderError(f"{path}: is not a result: {type(error).__name__} {error}") from None


def _figure(name: str) -> str:
    return f"{FIGURES}/{name}.png"


def _number(value: float | np.floating) -> float | str:
    """A float for JSON, which has no infinity: that is written as text, and read by `float`."""
    value = float(value)
    return value if np.isfinite(value) else str(value)
