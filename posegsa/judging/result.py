"""A result: a tuned filter, how it was found, and how good it is."""

import warnings
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from pydantic import Field

from posegsa.arguments import check_type, refuse
from posegsa.config import PARAMETERS, SEARCHED, Experiment, number_at
from posegsa.errors import PosegsaWarning
from posegsa.filters.base import Filter, Sensors, sensors_of
from posegsa.filters.noise_schedules import NoiseGains
from posegsa.filters.observer import Observer, ObserverGains
from posegsa.filters.rollout import Estimates
from posegsa.judging.description import (
    StoredFilter,
    candidate_of,
    described_filter,
    rules_text,
    tuned_experiment,
)
from posegsa.judging.known_sensors import KnownSensors, of_frame, of_recordings, of_scenario
from posegsa.judging.on_recordings import OnRecordings
from posegsa.judging.on_scenarios import OnScenarios
from posegsa.model.estimate import checked_state
from posegsa.model.fuzzy import FuzzyController
from posegsa.model.measurements import Measurements
from posegsa.model.schedules import FuzzyGain, GainSchedule
from posegsa.optimisers import History
from posegsa.recordings.frames import UP, Frame, known_frame
from posegsa.recordings.imu import as_read_by
from posegsa.recordings.recording import Recording
from posegsa.recordings.running import run_filter, state_of
from posegsa.search.candidates import Candidate
from posegsa.search.configured_filters import OwnFilter
from posegsa.settings.arrays import Cost
from posegsa.settings.fields import NonNegative
from posegsa.words import counted, text_table

TunedOn = Literal["scenarios", "recordings", "recordings and scenarios"]
"""The data that a search used."""

AT_END = 0.01
"""A number within this share of its box from an end, on its scale, counts as at that end."""


@dataclass(frozen=True, kw_only=True)
class FoundBy:
    """How a tuned filter was found."""

    tuned_on: TunedOn
    cost: str
    """The name of the cost that was minimised (`search.population.cost_name`)."""
    position_weight: NonNegative
    """Weight of the position's RMSE in the cost on recordings [deg/m]; 0 without recordings."""
    best_cost: Cost
    """Lowest cost that the search found: in deg on recordings, the configured cost on scenarios."""
    non_finite: Annotated[int, Field(ge=0)]
    """Number of evaluated agents whose cost or gradient was not finite."""
    compile_seconds: NonNegative
    search_seconds: NonNegative
    history: History
    """The costs of each iteration."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """A tuned filter, how it was found, and how good it is.

    `tune` makes one; `configured` makes one of a filter that was not searched.
    """

    experiment: Experiment
    """The experiment that was searched."""
    filter: StoredFilter
    """The tuned filter: its kind, its schedule's own numbers, and the other tuned numbers."""
    search: FoundBy | None
    """How it was found; None for a filter that was not searched."""
    on_scenarios: OnScenarios | None = None
    """Its performance on drawn scenarios; None if it was not run on any."""
    on_recordings: OnRecordings | None = None
    """Its performance on recordings; None if it was not run on any."""
    environment: dict[str, str]
    """Versions and device."""
    version: str
    own: OwnFilter | None = field(default=None, compare=False, metadata={"stored": False})
    """The user's own filter, if it is one; it is passed again when a result is read."""

    @property
    def parameters(self) -> np.ndarray:
        """The schedule's own numbers: (22,) k1..k22, put in order and repaired as configured."""
        own = [each for name, each in self.filter.numbers.items() if name != "rules"]
        return np.array([value for each in own for value in each])

    @property
    def also(self) -> dict[str, float]:
        """The tuned numbers in addition to the schedule's own, by key of the configuration."""
        return self.filter.also

    @property
    def best_cost(self) -> float | None:
        """Lowest cost that the search found; None without a search."""
        return None if self.search is None else self.search.best_cost

    @cached_property
    def candidate(self) -> Candidate:
        """The tuned schedule, with the other numbers that were tuned."""
        return candidate_of(self.filter, self.experiment)

    @property
    def tuned(self) -> Experiment:
        """The experiment with all tuned numbers: its file describes the tuned filter."""
        return tuned_experiment(self.experiment, self.filter)

    @property
    def schedule(self) -> GainSchedule:
        """The tuned gain schedule, ready for `Observer`; `candidate.schedule` has belief too.

        Raises:
            ArgumentError: The filter does not have one.
        """
        schedule = self.candidate.gain
        if schedule is None:
            refuse(f"schedule of a {self.filter.title}", "that of an observer")
        return schedule

    @property
    def controller(self) -> FuzzyController:
        """The tuned fuzzy controller; `controller(error=..., rate=...)` is a gain [1/s].

        Raises:
            ArgumentError: The filter does not have one.
        """
        schedule = self.candidate.gain
        if not isinstance(schedule, FuzzyGain):
            refuse(f"controller of a {self.filter.title}", "that of a fuzzy gain")
        return schedule.controller

    @property
    def controllers(self) -> dict[str, FuzzyController]:
        """The tuned fuzzy controllers, by the quantity that they schedule.

        "gain" and "belief" of an observer; "unknown" and "belief" of a Kalman filter's noises. That
        of belief is the one of the vectors.
        """
        schedule = self.candidate.schedule
        found: dict[str, GainSchedule | None] = {"gain": self.candidate.gain}
        if isinstance(schedule, NoiseGains):
            found = {"unknown": schedule.unknown}
        if isinstance(schedule, NoiseGains | ObserverGains):
            found["belief"] = schedule.vectors or schedule.landmarks
        return {
            role: each.controller for role, each in found.items() if isinstance(each, FuzzyGain)
        }

    @property
    def known_sensors(self) -> KnownSensors:
        """The sensors that the filter knows: those of its recordings, or else of its scenario.

        Raises:
            ArgumentError: The recordings have different references, or references that move.
        """
        on = self.on_recordings
        if on is not None and on.sensors is not None:
            return on.sensors
        on_scenarios = self.search is not None and self.search.tuned_on == "scenarios"
        if on is not None and not on_scenarios and (on.training or on.held_out):
            refuse(
                "a filter of recordings whose references differ, or move",
                "those of one recording: `posegsa export RUN --recording FILE`, in Python "
                "result.with_sensors_of(recording); or references of your own in PoseFilter, or in "
                "filter_to_c with result.filter_on(recording)",
            )
        if self.filter.kind == "imu":
            return of_frame("ENU")
        return of_scenario(self.experiment)

    @property
    def knows_scenario(self) -> bool:
        """Whether `known_sensors` are those of the configuration's scenarios, of no real body."""
        on = self.on_recordings
        return (on is None or on.sensors is None) and self.filter.kind != "imu"

    def with_sensors_of(self, recording: Recording) -> "Result":
        """The same filter for the vectors and landmarks of a recording, for exports and streams.

        Its judgement stays as it was.

        Raises:
            ArgumentError: The recording's references move.
        """
        check_type("recording", recording, Recording)
        sensors = of_recordings([self.as_read(recording)])
        if sensors is None:
            refuse(f"{recording.name}: its references move", "the same in all samples")
        return self._with_sensors(sensors)

    @property
    def frame(self) -> Frame | None:
        """The inertial frame that a filter for inertial sensors knows; None if it knows none.

        It is that of the recordings that it was tuned on, if they have one in common, or that of
        `in_frame`.
        """
        on = self.on_recordings
        return on.frame if on is not None and self.filter.kind == "imu" else None

    def as_read(self, recording: Recording) -> Recording:
        """A recording as the filter reads it; one that states no frame is in that of the filter."""
        return as_read_by(self.filter.kind, recording, self.frame)

    def in_frame(self, frame: Frame) -> "Result":
        """The same filter for inertial sensors in another inertial frame.

        Exports, streams and recordings that state no frame of their own are in it.

        Args:
            frame: "ENU", "NED" or "NWU".

        Raises:
            ArgumentError: The filter reads no inertial sensors, or there is no such frame.
        """
        if self.filter.kind != "imu":
            refuse(f"a frame, with a filter of kind {self.filter.kind!r}", "with imu")
        if (known := known_frame(frame)) is None:
            refuse(f"frame = {frame!r}", ", ".join(UP))
        return self._with_sensors(of_frame(known))

    def _with_sensors(self, sensors: KnownSensors) -> "Result":
        judged = self.on_recordings or OnRecordings(training=[], held_out=[])
        return replace(self, on_recordings=replace(judged, sensors=sensors))

    def filter_for(self, vectors: int, landmarks: int) -> Filter:
        """The tuned filter for a number of vectors and landmarks, each seen with the factor 1.

        An observer's vectors take the weights of the experiment's vectors in order; further vectors
        have the weight 1, and so do landmarks. If there are as many as in the recordings that it
        was tuned on, the weights that these have there are in its settings. Weights in measurements
        are factors on these.
        """
        sensors = Sensors(vectors, landmarks)
        filter = described_filter(self.filter, self.experiment, self.own, sensors)
        known = None if self.on_recordings is None else self.on_recordings.sensors
        same = known and (len(known.vectors), len(known.landmarks)) == (vectors, landmarks)
        if known and same and isinstance(filter, Observer):
            with jax.enable_x64(self.experiment.run.dtype == "float64"):
                return replace(filter, settings=known.weighted(filter.settings))
        return filter

    def filter_on(self, recording: Recording) -> Filter:
        """The tuned filter for a recording, whose own weights are factors on the filter's."""
        sensors = sensors_of(recording.measurements)
        return described_filter(self.filter, self.experiment, self.own, sensors)

    def estimate(
        self,
        measurements: Measurements | Recording,
        rotation: ArrayLike | None = None,
        position: ArrayLike | None = None,
        bias: ArrayLike | None = None,
    ) -> Estimates:
        """Run the tuned filter on your own measurements, or on a recording.

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
        dtype = np.dtype(self.experiment.run.dtype)
        if isinstance(measurements, Recording):
            measurements = self.as_read(measurements)
        with jax.enable_x64(dtype == np.float64):
            own_start = rotation is None and position is None and bias is None
            if isinstance(measurements, Recording) and own_start:
                start = state_of(measurements.initial())
            elif rotation is None or position is None:
                refuse("rotation, position: not both given", "both, or neither with a Recording")
            else:
                start = checked_state(rotation, position, bias, dtype)
            if isinstance(measurements, Recording):  # its score reports the effect of the limit
                return run_filter(self.filter_on(measurements), measurements, start)
            sensed = measurements.at_least(dtype)
            vectors, landmarks = (np.shape(a)[-2] for a in (sensed.vectors, sensed.landmarks))
            sensed = jax.tree.map(lambda a: jnp.asarray(np.asarray(a), dtype), sensed)
            estimates = run_filter(self.filter_for(vectors, landmarks), sensed, start)
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

    def __repr__(self) -> str:
        cost = "" if self.search is None else f", best training cost {self.search.best_cost:.4g}"
        return f"<Result: a {self.filter.title}{cost}; see summary()>"

    def summary(self) -> str:
        """A short readable text."""
        parts = [self._head()]
        if self.on_scenarios is not None:
            parts.append(self.on_scenarios.text(self.experiment.run.endurance_scenarios))
        if self.on_recordings is not None:
            parts.append(self.on_recordings.text(self.experiment.objective.simulated_share))
        simple = {name: each for name, each in self.filter.numbers.items() if len(each) == 1}
        numbers = simple | {key: [value] for key, value in self.also.items()}
        if numbers:
            beside = (
                f" in addition to k1 to k{len(PARAMETERS)}" if self.filter.kind == "fuzzy" else ""
            )
            tuned = ", ".join(f"{key} = {each[0]:.4g}" for key, each in numbers.items())
            parts.append(f"Tuned{beside}: {tuned}")
        if self.filter.kind == "fuzzy" and self.experiment.fuzzy.rules == SEARCHED:
            parts.append(rules_text(self.controller.rules))
        parts.append(self.verdict())
        kept = self._kept()
        lines = [f"  note: {words}" for words in ([kept] if kept else self.at_ends())]
        lines += [f"  warning: {warning}" for warning in self.warnings()]
        return "\n".join(["\n\n".join(filter(None, parts)), *lines])

    def verdict(self) -> str:
        """Which of the compared filters do better, on scenarios and recordings; "" without any."""
        parts = []
        if self.on_scenarios is not None:
            parts.append(self.on_scenarios.evaluation.verdict())
        if self.on_recordings is not None:
            parts.append(self.on_recordings.verdict())
        return "\n\n".join(filter(None, parts))

    def at_ends(self) -> list[str]:
        """Which of the tuned numbers are at an end of their box, in words."""
        found, tuned = [], {} if self.search is None else self.also
        if self.search is not None and (listed := self._k_at_ends()):
            found.append(
                f"{', '.join(listed)}: at an end of the box ([parameters] lower and upper)"
            )
        for one in self.experiment.also:
            if one.key not in tuned or one.lower == one.upper:
                continue
            ends = np.array([one.lower, tuned[one.key], one.upper])
            low, value, high = np.log(ends) if one.scale == "logarithmic" else ends
            share = (value - low) / (high - low)
            if not AT_END <= share <= 1 - AT_END:
                end = "lower" if share < AT_END else "upper"
                found.append(
                    f"{one.key} = {tuned[one.key]:.4g} is at the {end} end of its box, "
                    f"{one.lower:g} to {one.upper:g}: widen it ([[parameters.also]]), or state it"
                )
        return found

    def _k_at_ends(self) -> list[str]:
        """The k's at an end of their box, with the box."""
        found, boxes = [], self.experiment.parameters
        for name, values in self.filter.numbers.items():
            before, _, last = name.rpartition("k")
            if last or len(values) != len(PARAMETERS):
                continue
            for k, value, low, high in zip(
                PARAMETERS, values, boxes.lower, boxes.upper, strict=True
            ):
                near = AT_END * (high - low)
                if high > low and not low + near <= value <= high - near:
                    found.append(f"{before}{k} = {value:.4g} ({low:g} to {high:g})")
        return found

    def _kept(self) -> str:
        """A sentence, if the search improved the cost too little to change the numbers; else ""."""
        least, numbers = self.experiment.objective.least_gain, self.also
        if self.search is None or not (least and numbers):
            return ""
        before = [number_at(self.experiment, key) for key in numbers]
        if not np.allclose(list(numbers.values()), before, rtol=1e-6, atol=0.0):
            return ""
        return (
            f"the search gained less than {100 * least:.3g} % of the cost: the numbers stay as "
            "they were before it"
        )

    def _head(self) -> str:
        """How the filter was found."""
        if self.search is None:
            return f"A {self.filter.title} that was not searched"
        run, search = self.experiment.run, self.experiment.search
        recordings = 0 if self.on_recordings is None else len(self.on_recordings.training)
        seen = {
            "recordings": counted(recordings, "recording"),
            "scenarios": counted(run.training_scenarios, "training scenario"),
        }
        words = " and ".join(seen[group] for group in self.search.tuned_on.split(" and "))
        return (
            f"{search.optimiser}: {search.size_in_words()} for a {self.filter.title} on {words}, "
            f"seed {run.seed}: {counted(self.filter.evaluations, 'evaluation')} in "
            f"{self.search.search_seconds:.2f} s (+ {self.search.compile_seconds:.2f} s to "
            f"compile), cost {self.search.best_cost:.4g}"
        )

    def warnings(self) -> list[str]:
        """What a reader of the result must know before trusting it."""
        found = [] if self.on_scenarios is None else self.on_scenarios.warnings()
        if self.on_recordings is not None:
            found += self.on_recordings.warnings()
        observer = self.experiment.filter.kind == "observer"
        if observer and self.experiment.gain.signal == "pose":
            found.append("signal pose: the gain looks at the true errors, which no vehicle knows")
        if self.search is None:
            return found
        if not np.isfinite(self.search.best_cost):
            found.append(
                "no agent had a finite cost: the numbers are the middle of the boxes, no result"
            )
        if self.search.non_finite:
            found.append(
                f"{counted(self.search.non_finite, 'agent')} of the search had no finite cost"
            )
        return found


@dataclass(frozen=True)
class TuneBatch:
    """Results of a batch of runs, in the order of its experiments and seeds."""

    results: tuple[Result, ...]

    def summary(self) -> str:
        """Median and range over the batch, of training and held-out costs."""
        judged = [each.on_scenarios for each in self.results if each.on_scenarios is not None]
        costs: dict[str, list[float]] = {}
        for name in judged[0].training:
            costs[f"{name}, training"] = [float(np.mean(one.training[name])) for one in judged]
            costs[f"{name}, held out"] = [one.evaluation.cost(name).mean for one in judged]
        rows = [[counted(len(self.results), "search", "searches"), "median", "minimum", "maximum"]]
        for name, each in costs.items():
            rows.append([name, *(f"{of(each):.4g}" for of in (np.median, np.min, np.max))])
        return text_table(rows)
