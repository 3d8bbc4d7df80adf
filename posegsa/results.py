"""The result of a tuning run, and its folder: JSON, tables and figures."""

import json
import warnings
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from matplotlib.figure import Figure

from posegsa import comparison, config, plots, plots_evaluation
from posegsa.arguments import check_type
from posegsa.comparison import CONSTANT, TUNED, Evaluation
from posegsa.errors import ConfigError, PosegsaWarning, RunFolderError
from posegsa.figure_style import png
from posegsa.filter import checked_state, filter_settings
from posegsa.fuzzy import FuzzyController
from posegsa.gain import FuzzyGain, signal_settings
from posegsa.history import history_csv, read_history
from posegsa.measurements import Measurements
from posegsa.named_optimisers import size_in_words
from posegsa.optimisers import History
from posegsa.parameters import parameter_space
from posegsa.report import report_html
from posegsa.report.markup import counted
from posegsa.rollout import Estimates, run_filter
from posegsa.run_folder import FIGURES, RESULT, as_path, claimed, read, replace_files
from posegsa.trajectory import Trajectory, read_trajectory
from posegsa.trust import Trust

VERSION = version("posegsa")

SCHEMA = 1
"""Number of the layout of result.json; it changes when a key changes its meaning."""

EVALUATION, TABLE, REPORT = "evaluation.json", "evaluation.txt", "report.html"
HISTORY, TRAJECTORY = "history.csv", "trajectory.csv"
MAX_BYTES = 2**27
"""Size up to which a file of a run is read: 128 MiB."""


@dataclass(frozen=True)
class TuneResult:
    """A tuned schedule, how it was found, and what it is worth."""

    experiment: config.Experiment
    best_cost: float
    """Least cost that the search found on the training scenarios."""
    parameters: np.ndarray
    """(22,) k1..k22, in order and repaired as configured."""
    training_costs: np.ndarray
    """(S,) its cost on each training scenario; infinite where it diverged."""
    constant_gain: float
    """The constant gain with the least mean cost on the training scenarios [1/s]."""
    constant_training_costs: np.ndarray
    """(S,) what that costs on each of them."""
    evaluation: Evaluation
    """It and the best constant gain (after `evaluate`, all baselines) on held-out scenarios."""
    trust: Trust
    """Numerical sensitivity and use of the rules."""
    evaluations: int
    """Number of agents evaluated, each on all training scenarios; a cost with its gradient counts
    as the `gradient_price` of the optimiser that asks for it."""
    non_finite: int
    """Number of agents whose cost, or gradient where there is one, was not finite; each counts as
    one."""
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
            measurements: N samples (`Measurements.from_arrays`), brought to its precision.
            rotation: (3, 3) R_est at the first sample, body to inertial.
            position: (3,) P_est there [m], inertial frame.
            bias: (6,) b_est there [rad/s, m/s], body frame, angular first; zeros by default.

        Raises:
            MeasurementError: The pose or bias has the wrong shape, is not finite or no rotation.
            ArgumentError: The schedule was tuned on the signal "pose", which needs the truth.
        """
        check_type("measurements", measurements, Measurements)
        dtype = np.dtype(self.experiment.run.dtype)
        with jax.enable_x64(dtype == np.float64):
            start = checked_state(rotation, position, bias, dtype)
            estimates = run_filter(
                self.schedule,
                jax.tree.map(lambda a: jnp.asarray(np.asarray(a), dtype), measurements),
                start,
                filter_settings(self.experiment.filter, dtype),
                signal_settings(self.experiment.gain, dtype),
            )
        asked, used = (float(np.median(g)) for g in (estimates.gain, estimates.gain_used))
        if used < 0.1 * asked:
            warnings.warn(
                f"the gain limit cuts the gain from {asked:.3g} to {used:.3g} 1/s (medians): the "
                "landmarks are far for their weights, and the bias law may destabilise the filter; "
                "give landmark_weights of about 1 / (distance in m)^2",
                PosegsaWarning,
                stacklevel=2,
            )
        return estimates

    def figures(self) -> dict[str, Figure]:
        """The figures by name: the paper's five, convergence, the schedule, the evaluation."""
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
                "rules": plots_evaluation.plot_rules(self.trust),
                **plots_evaluation.evaluation_figures(self.evaluation),
            }

    def __repr__(self) -> str:
        return f"<TuneResult: best training cost {self.best_cost:.4g}; see summary()>"

    def summary(self) -> str:
        """A short text for a person."""
        run, search = self.experiment.run, self.experiment.search
        last = self.trajectory
        settled = last.time >= 0.5 * last.time[-1]

        def row(name: str, label: str, training: np.ndarray) -> str:
            metrics = self.evaluation.contenders[name].metrics
            bad = int(np.sum(metrics.diverged))
            return (
                f"  {label:<28}{np.mean(training):>10.4g}{np.mean(metrics.cost):>12.4g}"
                f"{np.max(metrics.cost):>12.4g}" + (f"   diverged on {bad}" if bad else "")
            )

        return "\n".join(
            [
                f"{search.optimiser}: {size_in_words(self.experiment)} on "
                f"{counted(run.training_scenarios, 'training scenario')}, seed {run.seed}: "
                f"{self.evaluations} evaluations in {self.search_seconds:.2f} s "
                f"(+ {self.compile_seconds:.2f} s to compile)",
                "",
                f"  {'mean cost':<28}{'training':>10}{'held out':>12}{'worst':>12}"
                f"   ({counted(self.evaluation.scenarios, 'unseen scenario')})",
                row(TUNED, TUNED, self.training_costs),
                row(
                    CONSTANT, f"{CONSTANT} {self.constant_gain:.4g}/s", self.constant_training_costs
                ),
                "",
                "  On one unseen scenario, second half: attitude error "
                f"{_rms(last.attitude_error[settled]):.2f} deg RMS, position error "
                f"{100 * _rms(last.position_error[settled]):.1f} cm RMS.",
            ]
            + [f"  warning: {warning}" for warning in self.warnings()]
        )

    def warnings(self) -> list[str]:
        """What a reader of the result must know before trusting it."""
        found = []
        t = self.trust
        if t.sensitive:
            found.append(
                f"SENSITIVE: training cost {t.cost_float32:.4g} in float32, {t.cost_float64:.4g} "
                f"in float64, {t.cost_perturbed:.4g} from a start changed by 1e-6; they should "
                "agree within 1 %. The simulation is chaotic: do not trust this schedule"
            )
        if self.experiment.gain.signal == "pose":
            found.append("signal pose: the gain looks at the true errors, which no vehicle knows")
        if bad := int(np.sum(self.evaluation.contenders[TUNED].metrics.diverged)):
            found.append(f"the tuned filter diverged on {bad} held-out scenarios")
        if t.uncovered > 0:
            found.append(f"no rule fires for {100 * t.uncovered:.1f} % of errors and rates")
        if not np.isfinite(self.best_cost):
            found.append(
                "no agent had a finite cost: the parameters are the middle of the boxes, no result"
            )
        if self.non_finite:
            found.append(f"{self.non_finite} agents of the search had no finite cost")
        return found

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
        with claimed(folder, overwrite=overwrite) as folder:
            self.write(folder)
        return folder

    def write(self, folder: Path) -> None:
        """Write all files of the run's folder, for who has `claimed` it."""
        files = {HISTORY: history_csv(self.history), TRAJECTORY: self.trajectory.csv()}
        self._replace(folder, files)

    def save_evaluation(self, folder: str | Path) -> None:
        """Write what the evaluation changes in a run's folder: tables, figures, report, result.

        Raises:
            RunFolderError: There is no such folder, or it can't be written.
        """
        if not as_path("folder", folder).is_dir():
            raise RunFolderError(f"{folder}: cannot be written: No such folder")
        with claimed(folder, overwrite=True) as folder:
            self.write_evaluation(folder)

    def write_evaluation(self, folder: Path) -> None:
        """The same for who has `claimed` the folder."""
        self._replace(folder, {})

    def _replace(self, folder: Path, texts: dict[str, str]) -> None:
        """Replace these files and all that show the evaluation, at once."""
        pictures = {name: png(figure) for name, figure in self.figures().items()}
        texts = texts | {
            EVALUATION: self.evaluation.to_json(),
            TABLE: self.evaluation.table() + "\n",
            REPORT: report_html(self, pictures),
            RESULT: json.dumps(self._json(), indent=2) + "\n",
        }
        figures = {_figure(name): picture for name, picture in pictures.items()}
        files = {name: text.encode("utf-8") for name, text in texts.items()} | figures
        # Not all evaluations have all figures.
        replace_files(folder, files, remove=[_figure(name) for name in plots_evaluation.NAMES])

    def _json(self) -> dict[str, Any]:
        tuned, constant = (
            {
                "training_mean": _number(np.mean(training)),
                "held_out_mean": _number(np.mean(held_out)),
                "held_out_worst": _number(np.max(held_out)),
                "held_out_diverged": int(np.sum(self.evaluation.contenders[name].metrics.diverged)),
                "training": [_number(c) for c in training],
            }
            for name, training in (
                (TUNED, self.training_costs),
                (CONSTANT, self.constant_training_costs),
            )
            for held_out in [self.evaluation.contenders[name].metrics.cost]
        )
        trust = vars(self.trust) | {"rule_weights": self.trust.rule_weights.tolist()}
        return {
            "schema": SCHEMA,
            "version": self.version,
            "best_cost": _number(self.best_cost),
            "parameters": dict(zip(config.PARAMETERS, self.parameters.tolist(), strict=True)),
            "tuned": tuned,
            "constant_gain": self.constant_gain,
            "constant": constant,
            "held_out_scenarios": self.evaluation.scenarios,
            "held_out_seed": self.evaluation.seed,
            "warnings": self.warnings(),
            "trust": {k: _number(v) if isinstance(v, float) else v for k, v in trust.items()},
            "evaluations": self.evaluations,
            "non_finite": self.non_finite,
            "compile_seconds": self.compile_seconds,
            "search_seconds": self.search_seconds,
            "environment": self.environment,
            "config": self.experiment.model_dump(mode="json"),
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

        checked = data["trust"]
        return TuneResult(
            experiment=config.from_dict(data["config"]),
            best_cost=float(data["best_cost"]),
            parameters=np.array([float(data["parameters"][k]) for k in config.PARAMETERS]),
            training_costs=costs(data["tuned"]),
            constant_gain=float(data["constant_gain"]),
            constant_training_costs=costs(data["constant"]),
            evaluation=comparison.from_json(read(folder, EVALUATION, MAX_BYTES)),
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
            trajectory=read_trajectory(read(folder, TRAJECTORY, MAX_BYTES)),
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


def _rms(a: np.ndarray) -> float:
    return float(np.sqrt(np.mean(a**2)))
