"""The result of a tuning run, or of a batch of runs."""

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from pydantic import Field

from posegsa.arguments import check_type, refuse
from posegsa.config import PARAMETERS, SEARCHED, Experiment, with_tuned
from posegsa.errors import PosegsaWarning
from posegsa.filters.observer import Observer
from posegsa.filters.rollout import Estimates
from posegsa.judging.baselines import rules_text, tuned_experiment
from posegsa.judging.endurance import Endurance
from posegsa.judging.evaluation import CONSTANT, TUNED, Evaluation
from posegsa.judging.trajectory import Trajectory
from posegsa.judging.trust import Trust
from posegsa.model.estimate import checked_state
from posegsa.model.fuzzy import FuzzyController
from posegsa.model.measurements import Measurements
from posegsa.model.schedules import FuzzyGain
from posegsa.optimisers import History
from posegsa.recordings.recording import Recording
from posegsa.recordings.running import run_filter, state_of
from posegsa.search.build import parameter_space, signal_settings
from posegsa.search.candidates import Candidate
from posegsa.search.recorded import settings_on
from posegsa.settings.arrays import Cost, Numbers
from posegsa.settings.fields import NonNegative
from posegsa.words import counted, text_table


@dataclass(frozen=True)
class TuneResult:
    """A tuned schedule, how it was found, and its performance."""

    experiment: Experiment
    cost: str
    """The name of the cost that was minimised (`search.population.cost_name`)."""
    best_cost: Cost
    """Lowest cost that the search found on the training scenarios."""
    parameters: Annotated[np.ndarray, Numbers(len(PARAMETERS))]
    """(22,) k1..k22, put in order and repaired as configured."""
    also: dict[str, float]
    """Numbers that were tuned beside them, by key of the configuration."""
    training_costs: Annotated[np.ndarray, Numbers("training scenarios", allow="infinite")]
    """(S,) cost of the tuned filter on each training scenario; infinite where it diverged."""
    constant_gain: float
    """The constant gain with the lowest mean cost on the training scenarios [1/s]."""
    constant_training_costs: Annotated[np.ndarray, Numbers("training scenarios", allow="infinite")]
    """(S,) cost of the constant gain on each training scenario."""
    evaluation: Evaluation
    """Tuned filter and best constant gain (after `evaluate`, all baselines) on held-out data."""
    endurance: Endurance
    """Both filters long after the time that they were tuned for."""
    trust: Trust
    evaluations: Annotated[int, Field(ge=1)]
    """Number of agents evaluated, each on all training scenarios; a cost with its gradient counts
    as several (`search.gradient_price`)."""
    non_finite: Annotated[int, Field(ge=0)]
    """Number of evaluated agents whose cost or gradient was not finite."""
    compile_seconds: NonNegative
    search_seconds: NonNegative
    history: History
    trajectory: Trajectory
    """The tuned filter on the first held-out scenario."""
    environment: dict[str, str]
    """Versions and device."""
    version: str

    @property
    def candidate(self) -> Candidate:
        """The tuned schedule, with the numbers that were tuned beside it."""
        dtype = self.experiment.run.dtype
        with jax.enable_x64(dtype == "float64"):
            values = tuple(jnp.asarray(value, dtype) for value in self.also.values())
            return Candidate(self.schedule, values, tuple(self.also))

    @property
    def tuned(self) -> Experiment:
        """The experiment, with everything that was tuned beside k1..k22."""
        if self.experiment.fuzzy.rules != SEARCHED:
            return with_tuned(self.experiment, self.also)
        found = self.evaluation.contenders[TUNED].filter
        return tuned_experiment(self.experiment, found._replace(also=self.also))

    @cached_property
    def controller(self) -> FuzzyController:
        """The tuned fuzzy controller, at the experiment's precision."""
        with jax.enable_x64(self.experiment.run.dtype == "float64"):
            space = parameter_space(self.tuned)
            return space.controller(space.checked(self.parameters))

    @cached_property
    def schedule(self) -> FuzzyGain:
        """The tuned gain schedule, ready for `run_filter` or `simulate`."""
        return FuzzyGain(self.controller)

    def estimate(
        self,
        measurements: Measurements | Recording,
        rotation: ArrayLike | None = None,
        position: ArrayLike | None = None,
        bias: ArrayLike | None = None,
    ) -> Estimates:
        """Run the tuned filter on measurements of one's own, with the experiment's settings.

        Args:
            measurements: N samples (`Measurements.from_arrays`), or a recording; converted to the
                experiment's precision. `filter_for` says how its weights are used.
            rotation: (3, 3) R_est at the first sample, body to inertial; by default that of the
                recording, with its position and bias.
            position: (3,) P_est there [m], inertial frame.
            bias: (6,) b_est there [rad/s, m/s], body frame, angular first; zeros by default.

        Raises:
            MeasurementError: The pose or bias has a wrong shape, is not finite, or is no rotation.
            ArgumentError: The schedule was tuned on the signal "pose", which needs the truth; or
                the initial pose is missing.
        """
        check_type("measurements", measurements, Measurements, Recording)
        recorded = isinstance(measurements, Recording)
        dtype = np.dtype(self.experiment.run.dtype)
        with jax.enable_x64(dtype == np.float64):
            sensed = measurements.measurements if recorded else measurements.at_least(dtype)
            vectors, landmarks = (np.shape(a)[-2] for a in (sensed.vectors, sensed.landmarks))
            if recorded and rotation is None and position is None and bias is None:
                start = state_of(measurements.initial())
            elif rotation is None or position is None:
                refuse("rotation, position: not both given", "both, or neither with a Recording")
            else:
                start = checked_state(rotation, position, bias, dtype)
            if not recorded:
                measurements = jax.tree.map(lambda a: jnp.asarray(np.asarray(a), dtype), sensed)
            estimates = run_filter(self.filter_for(vectors, landmarks), measurements, start)
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

    def filter_for(self, vectors: int, landmarks: int) -> Observer:
        """The tuned filter for a number of vectors and landmarks.

        The vectors take the weights of the experiment's vectors in order; further vectors have the
        weight 1, and so do landmarks. Weights in a recording or in measurements are factors on
        these.
        """
        return Observer(
            self.schedule,
            settings_on(self.tuned, vectors, landmarks),
            signal_settings(self.tuned.gain, np.dtype(self.experiment.run.dtype)),
        )

    def __repr__(self) -> str:
        return f"<TuneResult: best training cost {self.best_cost:.4g}; see summary()>"

    def summary(self) -> str:
        """A short text."""
        run, search, last = self.experiment.run, self.experiment.search, self.trajectory
        unseen = f"({counted(self.evaluation.scenarios, 'unseen scenario')})"
        rows = [["mean cost", "training", "held out", "worst", unseen]]
        for name, label, training in (
            (TUNED, TUNED, self.training_costs),
            (CONSTANT, f"{CONSTANT} {self.constant_gain:.4g}/s", self.constant_training_costs),
        ):
            metrics = self.evaluation.contenders[name].metrics
            costs = (np.mean(training), np.mean(metrics.cost), np.max(metrics.cost))
            bad = np.count_nonzero(metrics.diverged)
            rows.append([label, *(f"{c:.4g}" for c in costs), f"diverged on {bad}" if bad else ""])
        settled = last.time >= 0.5 * last.time[-1]
        parts = [
            f"{search.optimiser}: {search.size_in_words()} on "
            f"{counted(run.training_scenarios, 'training scenario')}, seed {run.seed}: "
            f"{counted(self.evaluations, 'evaluation')} in {self.search_seconds:.2f} s "
            f"(+ {self.compile_seconds:.2f} s to compile)",
            text_table(rows),
            "On one unseen scenario, second half: attitude error "
            f"{_rms(last.attitude_error[settled]):.2f} deg RMS, distance |P_est - P| "
            f"{100 * _rms(last.distance[settled]):.1f} cm RMS (the cost's position error, "
            f"|P_est - R_err P|: {100 * _rms(last.position_error[settled]):.1f} cm).",
            self.endurance.table(CONSTANT, run.endurance_scenarios),
            f"{self.trust.used_rules} of {self.trust.rule_weights.size} rules carry 1 % or more of "
            "the weight.",
        ]
        if self.also:
            tuned = ", ".join(f"{key} = {value:.4g}" for key, value in self.also.items())
            parts.append(f"Tuned beside k1 to k{len(PARAMETERS)}: {tuned}")
        if self.experiment.fuzzy.rules == SEARCHED:
            parts.append(rules_text(self.controller.rules))
        warned = [f"  warning: {warning}" for warning in self.warnings()]
        return "\n".join(["\n\n".join(parts), *warned])

    def warnings(self) -> list[str]:
        """What a reader of the result must know before trusting it."""
        found, t = [], self.trust
        if t.sensitive:
            found.append(
                f"SENSITIVE: training cost {t.cost_float32:.4g} in float32, {t.cost_float64:.4g} "
                f"in float64, {t.cost_perturbed:.4g} from a start changed by 1e-6; they should "
                "agree within 1 %. The simulation is chaotic: do not trust this schedule"
            )
        if self.experiment.gain.signal == "pose":
            found.append("signal pose: the gain looks at the true errors, which no vehicle knows")
        if bad := int(np.sum(self.evaluation.contenders[TUNED].metrics.diverged)):
            found.append(f"the tuned filter diverged on {counted(bad, 'held-out scenario')}")
        if t.uncovered > 0:
            found.append(f"no rule fires for {100 * t.uncovered:.1f} % of errors and rates")
        if worse := self.endurance.worse():
            found.append(
                f"past the time that it was tuned for it is worse than constant gains: "
                f"{', '.join(worse)}"
            )
        if not np.isfinite(self.best_cost):
            found.append(
                "no agent had a finite cost: the parameters are the middle of the boxes, no result"
            )
        if self.non_finite:
            found.append(f"{counted(self.non_finite, 'agent')} of the search had no finite cost")
        return found


@dataclass(frozen=True)
class TuneBatch:
    """Results of a batch of runs, in the order of its experiments and seeds."""

    results: tuple[TuneResult, ...]

    def summary(self) -> str:
        """Median and range over the batch, of training and held-out costs."""
        costs = {f"{TUNED}, training": [float(np.mean(r.training_costs)) for r in self.results]}
        for name in (TUNED, CONSTANT):
            costs[f"{name}, held out"] = [r.evaluation.cost(name).mean for r in self.results]
        rows = [[counted(len(self.results), "search", "searches"), "median", "minimum", "maximum"]]
        for name, each in costs.items():
            rows.append([name, *(f"{of(each):.4g}" for of in (np.median, np.min, np.max))])
        return text_table(rows)


@np.errstate(over="ignore")  # a filter may diverge to any number
def _rms(a: np.ndarray) -> float:
    return float(np.sqrt(np.mean(a**2)))
