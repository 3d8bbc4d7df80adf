"""The result of a tuning run, and its folder: JSON, tables and figures."""

import csv
import json
import tempfile
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike
from matplotlib.figure import Figure

from posegsa import config, plots
from posegsa.errors import ConfigError, RunFolderError
from posegsa.evaluate import Judged, Score
from posegsa.filter import filter_settings, initial_state
from posegsa.fuzzy import FuzzyController
from posegsa.gain import FuzzyGain, signal_settings
from posegsa.measurements import Measurements
from posegsa.optimisers import History
from posegsa.parameters import parameter_space
from posegsa.rollout import Estimates, run_filter
from posegsa.trajectory import Trajectory, read_trajectory

VERSION = version("posegsa")

SCHEMA = 1
"""Number of the layout of result.json; it changes when a key changes its meaning."""

RESULT, HISTORY, TRAJECTORY, FIGURES = "result.json", "history.csv", "trajectory.csv", "figures"


@dataclass(frozen=True)
class TuneResult:
    """A tuned schedule, how it was found, and what it is worth."""

    experiment: config.Experiment
    best_cost: float
    """Least cost that the search found on the training scenarios."""
    parameters: np.ndarray
    """(22,) k1..k22, in order and repaired as configured."""
    judged: Judged
    """What it costs on training and held-out scenarios, beside the best constant gain."""
    evaluations: int
    """Number of agents evaluated, each on all training scenarios."""
    non_finite: int
    """Number of them whose cost was not finite."""
    compile_seconds: float
    search_seconds: float
    history: History
    """Best, mean and worst cost and the number that was not finite, of each iteration."""
    trajectory: Trajectory
    """The tuned filter on the first held-out scenario."""
    environment: dict[str, str]
    """Versions and device."""
    version: str
    """Version of posegsa."""

    @property
    def controller(self) -> FuzzyController:
        """The tuned fuzzy controller, at the experiment's precision."""
        with jax.enable_x64(self.experiment.run.dtype == "float64"):
            space = parameter_space(self.experiment)
            return space.controller(space.checked(self.parameters))

    @property
    def schedule(self) -> FuzzyGain:
        """The tuned gain schedule, ready for `run_filter` or `simulate`."""
        return FuzzyGain(self.controller)

    def estimate(
        self,
        measurements: Measurements,
        rotation: ArrayLike,
        position: ArrayLike,
        bias: ArrayLike | None = None,
    ) -> Estimates:
        """Run the tuned filter on measurements of one's own, with the experiment's settings.

        Args:
            measurements: N samples, at the experiment's precision (`Measurements.from_arrays`).
            rotation: (3, 3) R_est at the first sample, body to inertial.
            position: (3,) P_est there [m], inertial frame.
            bias: (6,) b_est there [rad/s, m/s], body frame, angular first; zeros by default.

        Raises:
            ValueError: The schedule was tuned on the signal "pose", which needs the truth.
        """
        dtype = np.dtype(self.experiment.run.dtype)
        with jax.enable_x64(dtype == np.float64):
            start = initial_state(
                np.asarray(rotation, dtype),
                np.asarray(position, dtype),
                np.asarray(np.zeros(6) if bias is None else bias, dtype),
            )
            return run_filter(
                self.schedule,
                measurements,
                start,
                filter_settings(self.experiment.filter, dtype),
                signal_settings(self.experiment.gain, dtype),
            )

    def figures(self) -> dict[str, Figure]:
        """The run's figures by name: the paper's five, convergence, gain, control surface."""
        with jax.enable_x64(self.experiment.run.dtype == "float64"):
            controller = self.controller
            return {
                "input_terms": plots.plot_input_terms(controller),
                "output_terms": plots.plot_output_terms(controller),
                "euler_angles": plots.plot_euler(self.trajectory),
                "position": plots.plot_position(self.trajectory),
                "errors": plots.plot_errors(self.trajectory),
                "convergence": plots.plot_convergence(self.history),
                "gain": plots.plot_gain(self.trajectory),
                "control_surface": plots.plot_surface(controller),
            }

    def summary(self) -> str:
        """A short text for a person."""
        run, search = self.experiment.run, self.experiment.search
        last = self.trajectory
        settled = last.time >= 0.5 * last.time[-1]

        def row(name: str, score: Score) -> str:
            bad = int(np.sum(~np.isfinite(score.held_out)))
            held_out, worst = np.mean(score.held_out), np.max(score.held_out)
            return (
                f"  {name:<28}{np.mean(score.training):>10.4g}{held_out:>12.4g}{worst:>12.4g}"
                + (f"   diverged on {bad}" if bad else "")
            )

        return "\n".join(
            [
                f"{search.optimiser}: {search.agents} agents x {search.iterations} iterations on "
                f"{_count(run.training_scenarios, 'training scenario')}, seed {run.seed}: "
                f"{self.evaluations} evaluations in {self.search_seconds:.2f} s "
                f"(+ {self.compile_seconds:.2f} s to compile)",
                "",
                f"  {'mean cost':<28}{'training':>10}{'held out':>12}{'worst':>12}"
                f"   ({_count(run.held_out_scenarios, 'unseen noise seed')})",
                row("tuned fuzzy gain", self.judged.tuned),
                row(f"best constant gain {self.judged.constant_gain:.4g}/s", self.judged.constant),
                "",
                "  On one unseen scenario, second half: attitude error "
                f"{_rms(last.attitude_error[settled]):.2f} deg RMS, position error "
                f"{100 * _rms(last.position_error[settled]):.1f} cm RMS.",
            ]
            + [f"  {self.non_finite} agents had no finite cost."] * bool(self.non_finite)
        )

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write the run's folder.

        Args:
            folder: Where; made if missing.
            overwrite: Replace another run's files there.

        Returns:
            The folder.

        Raises:
            RunFolderError: It holds a run already, or can't be written.
        """
        folder = claim(folder, overwrite=overwrite)
        try:
            # result.json says that a run is complete: the old one goes first, the new comes last.
            (folder / RESULT).unlink(missing_ok=True)
            _write_atomically(folder / HISTORY, self._history_csv())
            self.trajectory.write(folder / TRAJECTORY)
            (folder / FIGURES).mkdir(exist_ok=True)
            for name, figure in self.figures().items():
                figure.savefig(folder / FIGURES / f"{name}.png", dpi=plots.DPI)
            _write_atomically(folder / RESULT, json.dumps(self._json(), indent=2) + "\n")
        except OSError as error:
            raise RunFolderError(f"{folder}: cannot be written: {error.strerror}") from error
        return folder

    def _json(self) -> dict[str, Any]:
        def score(s: Score) -> dict[str, Any]:
            return {
                "training_mean": _number(np.mean(s.training)),
                "held_out_mean": _number(np.mean(s.held_out)),
                "held_out_worst": _number(np.max(s.held_out)),
                "held_out_diverged": int(np.sum(~np.isfinite(s.held_out))),
                "training": [_number(c) for c in s.training],
                "held_out": [_number(c) for c in s.held_out],
            }

        return {
            "schema": SCHEMA,
            "version": self.version,
            "best_cost": _number(self.best_cost),
            "parameters": dict(zip(config.PARAMETERS, self.parameters.tolist(), strict=True)),
            "tuned": score(self.judged.tuned),
            "constant_gain": self.judged.constant_gain,
            "constant": score(self.judged.constant),
            "evaluations": self.evaluations,
            "non_finite": self.non_finite,
            "compile_seconds": self.compile_seconds,
            "search_seconds": self.search_seconds,
            "environment": self.environment,
            "config": self.experiment.model_dump(mode="json"),
        }

    def _history_csv(self) -> str:
        h = self.history
        lines = ["iteration,best,mean,worst,non_finite"]
        columns = (h.best.tolist(), h.mean.tolist(), h.worst.tolist(), h.non_finite.tolist())
        for i, (best, mean, worst, bad) in enumerate(zip(*columns, strict=True), start=1):
            lines.append(f"{i},{best!r},{mean!r},{worst!r},{bad}")
        return "\n".join(lines) + "\n"


def load(folder: str | Path) -> TuneResult:
    """Read a run's folder back.

    Raises:
        RunFolderError: It is not a run's folder, or a file in it is damaged or of another schema.
    """
    folder = Path(folder)
    path = folder / RESULT
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise RunFolderError(
            f"{folder}: holds no finished run ({RESULT}: {error.strerror})"
        ) from None
    except ValueError as error:
        raise RunFolderError(f"{path}: is not JSON: {error}") from None
    try:
        if data["schema"] != SCHEMA:
            raise RunFolderError(
                f"{path}: has schema {data['schema']}; this version of posegsa reads {SCHEMA}"
            )

        def score(d: dict[str, Any]) -> Score:
            return Score(*(np.array([float(c) for c in d[k]]) for k in ("training", "held_out")))

        return TuneResult(
            experiment=config.from_dict(data["config"]),
            best_cost=float(data["best_cost"]),
            parameters=np.array([float(data["parameters"][k]) for k in config.PARAMETERS]),
            judged=Judged(
                score(data["tuned"]), float(data["constant_gain"]), score(data["constant"])
            ),
            evaluations=int(data["evaluations"]),
            non_finite=int(data["non_finite"]),
            compile_seconds=float(data["compile_seconds"]),
            search_seconds=float(data["search_seconds"]),
            history=_read_history(folder / HISTORY),
            trajectory=read_trajectory(folder / TRAJECTORY),
            environment={str(k): str(v) for k, v in data["environment"].items()},
            version=str(data["version"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, ConfigError):
            raise RunFolderError(f"{path}: its configuration is not valid: {error}") from None
        raise RunFolderError(f"{path}: is not a result: {type(error).__name__} {error}") from None


def claim(folder: str | Path, *, overwrite: bool = False) -> Path:
    """Make a folder and see that a run may be written there.

    Raises:
        RunFolderError: It holds a run already, is not a folder, or can't be written.
    """
    folder = Path(folder)
    if (folder / RESULT).exists() and not overwrite:
        raise RunFolderError(
            f"{folder}: holds a run already; choose another folder, or replace the run "
            "(--overwrite; overwrite=True)"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except FileExistsError:
        raise RunFolderError(f"{folder}: is not a folder") from None
    except OSError as error:
        raise RunFolderError(f"{folder}: cannot be written: {error.strerror}") from None
    return folder


def _write_atomically(path: Path, text: str) -> None:
    """Write a file so that it is either whole or not there."""
    temporary = path.with_name(path.name + ".part")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


def _read_history(path: Path) -> History:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        columns = {
            name: np.array([float(row[name]) for row in rows]) for name in ("best", "mean", "worst")
        }
        bad = np.array([int(row["non_finite"]) for row in rows])
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise RunFolderError(f"{path}: cannot be read as a history: {error}") from None
    return History._make([columns["best"], columns["mean"], columns["worst"], bad])


def _number(value: float | np.floating) -> float | str:
    """A float for JSON, which has no infinity: that is written as text, and read by `float`."""
    value = float(value)
    return value if np.isfinite(value) else str(value)


def _count(n: int, what: str) -> str:
    return f"{n} {what}" + "s" * (n != 1)


def _rms(a: np.ndarray) -> float:
    return float(np.sqrt(np.mean(a**2)))
