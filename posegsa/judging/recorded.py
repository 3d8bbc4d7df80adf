"""Results on recordings: a tuned filter, judged on training and held-out recordings."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import jax
import numpy as np
from jax import Array
from pydantic import AfterValidator, Field

from posegsa import steps
from posegsa.arguments import check_type, refuse
from posegsa.config import SEARCHED, Experiment, override
from posegsa.errors import FuzzyError, RecordingError
from posegsa.filters.observer import Observer
from posegsa.filters.rollout import Estimates
from posegsa.judging.baselines import candidate_of, describe, rules_text, tuned_experiment
from posegsa.judging.evaluation import CONSTANT, SCHEDULES, TUNED, Description, StoredFilter
from posegsa.judging.known_sensors import (
    KnownSensors,
    StoredSensors,
    of_recordings,
    of_scenario,
)
from posegsa.judging.replay import HEADS, error_rows, replayed_on
from posegsa.judging.result import TuneResult
from posegsa.model.fuzzy import FuzzyController
from posegsa.model.schedules import FuzzyGain, GainSchedule
from posegsa.recordings.accuracy import AnyNumber, Rmse
from posegsa.recordings.fingerprint import fingerprint
from posegsa.recordings.recording import Recording
from posegsa.recordings.running import run_filter, state_of
from posegsa.runtime import environment
from posegsa.search.build import TuningProblem, parameter_space, rule_table, signal_settings
from posegsa.search.candidates import Candidate
from posegsa.search.population import costs_by_scenario
from posegsa.search.recorded import DEGREES_PER_METRE, settings_on
from posegsa.search.run import Found
from posegsa.settings.arrays import Cost
from posegsa.settings.fields import NonNegative
from posegsa.version import VERSION
from posegsa.words import counted, text_table

TunedOn = Literal["recordings", "scenarios", "recordings and scenarios", "nothing"]
"""What a filter was tuned on; "nothing" if it was made by hand."""


def _has_judged_phase(errors: dict[str, Rmse]) -> dict[str, Rmse]:
    """Check that errors by phase include the phase "judged", and return them."""
    if "judged" not in errors:
        raise ValueError(
            f"its phases are {', '.join(errors) or 'none'}; allowed: judged among them"
        )
    return errors


USED_SHARE = 0.99
"""A used gain below this share of the requested gain counts as limited."""
LIMITED_SHARE = 0.5
"""A result warns if the gain limit sets the gain in more than this share of the samples."""
Share = Annotated[float, Field(ge=0, le=1)]


class RecordingScore(NamedTuple):
    """A filter on one recording."""

    name: str
    samples: int
    duration: float
    """[s]"""
    attitude_only: bool
    sources: dict[str, str]
    """Which quantities are measured and which were made from the truth, in words."""
    notes: list[str]
    """Samples and columns that were bridged, dropped or left out."""
    errors: Annotated[dict[str, Rmse], AfterValidator(_has_judged_phase)]
    """Root mean square errors by phase, "judged" first."""
    fingerprint: str
    """SHA-256 of the recording's numbers (`recordings.fingerprint`)."""
    limited: Share | None = None
    """Share of the samples with a measurement in which the gain limit cut the schedule's gain; None
    for a filter without a gain K."""


class SimulatedScore(NamedTuple):
    """Costs on simulated scenarios of a filter tuned on recordings and simulated scenarios."""

    training: Annotated[list[AnyNumber], Field(min_length=1)]
    """Cost on each training scenario [deg], from the root mean square errors."""
    held_out: Annotated[list[AnyNumber], Field(min_length=1)]
    """The same on each held-out scenario."""

    def text(self, share: float) -> str:
        """Both as text, with the scenarios' share of the cost that was minimised."""
        rows = [
            [label, f"{np.mean(costs):.4g}", f"{np.max(costs):.4g}", str(len(costs))]
            for label, costs in (("tuned on", self.training), ("held out", self.held_out))
        ]
        title = f"Simulated scenarios, {share:g} of what was minimised, cost [deg]"
        return text_table([[title, "mean", "worst", "scenarios"], *rows])


@dataclass(frozen=True, kw_only=True)
class RecordingResult:
    """A gain schedule, how it was found, and its errors on recordings."""

    experiment: Experiment
    tuned_on: TunedOn
    """What the search used for training."""
    filter: StoredFilter
    """The schedule's kind and numbers, and the numbers that were tuned beside it."""
    position_weight: NonNegative
    """Weight of the position RMSE in the cost on recordings [deg/m]; 0 if not tuned on any."""
    best_cost: Cost | None
    """Lowest cost that the search found: on recordings [deg], on scenarios the configured cost;
    None for a filter made by hand."""
    training: list[RecordingScore]
    """Errors on each training recording."""
    held_out: list[RecordingScore]
    """Errors on each held-out recording; empty if there were none."""
    compile_seconds: NonNegative
    search_seconds: NonNegative
    environment: dict[str, str]
    version: str
    non_finite: Annotated[int, Field(ge=0)] = 0
    """Number of agents whose cost was not finite."""
    simulated: SimulatedScore | None = None
    """Costs on simulated scenarios, if the filter was tuned on them too."""
    baselines: dict[str, list[RecordingScore]] = field(default_factory=dict)
    """Other filters on the same held-out recordings, by name (`evaluate`)."""
    sensors: StoredSensors | None = None
    """Sensors of the training recordings, for exports and streams; None if they differ, or there
    are no recordings."""

    @cached_property
    def candidate(self) -> Candidate:
        """The tuned schedule, with the numbers that were tuned beside it."""
        with jax.enable_x64(self.experiment.run.dtype == "float64"):
            return candidate_of(self.filter, parameter_space(self.experiment))

    @property
    def schedule(self) -> GainSchedule:
        """The tuned gain schedule, ready for `run_filter`."""
        schedule = self.candidate.schedule
        assert schedule is not None  # every stored kind has a schedule
        return schedule

    @property
    def tuned(self) -> Experiment:
        """The experiment, with everything that was tuned beside the schedule."""
        return tuned_experiment(self.experiment, self.filter)

    @property
    def controller(self) -> FuzzyController:
        """The tuned fuzzy controller; `controller(error=..., rate=...)` is a gain [1/s].

        Raises:
            ArgumentError: The schedule is of another kind and has no controller.
        """
        schedule = self.schedule
        if not isinstance(schedule, FuzzyGain):
            refuse(f"controller of a {self.filter.kind} gain", "that of a fuzzy gain")
        return schedule.controller

    @property
    def known_sensors(self) -> KnownSensors:
        """The sensors of the filter's recordings, or of its scenario if it has none.

        Raises:
            ArgumentError: The recordings have different references, or references that move.
        """
        if self.sensors is not None:
            return self.sensors
        if self.tuned_on != "scenarios" and (self.training or self.held_out):
            refuse(
                "a filter of recordings whose references differ, or move",
                "in Python, filter_to_c or PoseFilter with result.filter_on(recording) and "
                "references of your own",
            )
        return of_scenario(self.experiment)

    def filter_for(self, vectors: int, landmarks: int) -> Observer:
        """The tuned filter for a number of vectors and landmarks, each with the factor 1.

        If `sensors` has the same numbers of them, their weights in the recordings are multiplied
        into the filter's weights.
        """
        observer, known = self._observer(vectors, landmarks), self.sensors
        if known and (len(known.vectors), len(known.landmarks)) == (vectors, landmarks):
            return replace(observer, settings=known.weighted(observer.settings))
        return observer

    def filter_on(self, recording: Recording) -> Observer:
        """The tuned filter for a recording; the recording's weights are factors on its weights."""
        return self._observer(*_sensors(recording))

    def _observer(self, vectors: int, landmarks: int) -> Observer:
        return Observer(
            self.schedule,
            settings_on(self.tuned, vectors, landmarks),
            signal_settings(self.tuned.gain, self.experiment.run.dtype),
        )

    def estimate(self, recording: Recording) -> Estimates:
        """Run the tuned filter over a recording.

        Raises:
            ArgumentError: The argument is not a recording.
            MeasurementError: The recording has no initial estimate.
        """
        check_type("recording", recording, Recording)
        with jax.enable_x64(self.experiment.run.dtype == "float64"):
            return run_filter(self.filter_on(recording), recording, state_of(recording.initial()))

    def __repr__(self) -> str:
        return f"<RecordingResult: a {self.filter.kind} gain; see summary()>"

    def summary(self) -> str:
        """A short text; it always says whether recordings were held out."""
        numbers = self.filter.numbers | {key: [a] for key, a in self.filter.also.items()}
        found = ", ".join(f"{key} = {a[0]:.4g}" for key, a in numbers.items() if len(a) == 1)
        share = self.experiment.objective.simulated_share
        schedule, rules = self.schedule, ""
        if isinstance(schedule, FuzzyGain) and self.experiment.fuzzy.rules == SEARCHED:
            rules = rules_text(schedule.controller.rules)
        alone = (
            "No recording was held out: these errors say how well the filter fits the recordings "
            "that it was tuned on, not how good it is on others."
        )
        parts = [
            self._head(),
            f"Numbers: {found}" if found else "",
            rules,
            self.table() if self.training or self.held_out else "",
            "" if self.held_out else alone,
            "" if self.simulated is None else self.simulated.text(share),
            self.origins(),
        ]
        warned = "\n".join(f"  warning: {warning}" for warning in self.warnings())
        return "\n\n".join(part for part in (*parts, warned) if part)

    def warnings(self) -> list[str]:
        """What a reader of the result must know before trusting it."""
        found = []
        if self.best_cost is not None and not np.isfinite(self.best_cost):
            found.append(
                "no agent had a finite cost: the numbers are the middle of the boxes, no result"
            )
        if self.non_finite:
            found.append(f"{counted(self.non_finite, 'agent')} of the search had no finite cost")
        if behind := self._behind_constant():
            found.append(behind)
        shares = [each.limited for each in self.held_out or self.training]
        cut = [share for share in shares if share is not None]
        if cut and np.mean(cut) > LIMITED_SHARE:
            found.append(
                "the schedule asks for more than the gain limit allows in "
                f"{100 * np.mean(cut):.0f} % of the samples with a measurement: there the limit "
                "sets the gain, not the schedule, and a constant gain may do as well (`posegsa "
                "evaluate` shows it beside)"
            )
        return found

    def _behind_constant(self) -> str:
        """A warning if the best constant gains have lower mean errors on what was held out."""
        others = self.baselines.get(CONSTANT)
        if not (others and self.held_out):
            return ""
        own, constant = mean_errors(self.held_out), mean_errors(others)
        pairs = [(own.total, constant.total, "deg")]
        if own.position is not None and constant.position is not None:
            pairs.append((own.position, constant.position, "m"))
        if not all(a > b for a, b, _ in pairs):
            return ""
        errors = " and ".join(f"{a:.3g} {unit} instead of {b:.3g}" for a, b, unit in pairs)
        return f"on what was held out it errs more than the best constant gains, {errors}"

    def _head(self) -> str:
        """How the filter was found."""
        if self.best_cost is None:
            return f"A {self.filter.kind} gain made by hand"
        scenarios = self.experiment.run.training_scenarios
        seen = {
            "recordings": counted(len(self.training), "recording"),
            "scenarios": counted(scenarios, "simulated scenario"),
        }
        seen = " and ".join(seen[group] for group in self.tuned_on.split(" and "))
        search = self.experiment.search
        return (
            f"{search.optimiser}: {search.size_in_words()} for a {self.filter.kind} gain on "
            f"{seen}: "
            f"{counted(self.filter.evaluations, 'evaluation')} in {self.search_seconds:.2f} s "
            f"(+ {self.compile_seconds:.2f} s to compile), cost {self.best_cost:.4g}"
        )

    def table(self) -> str:
        """Root mean square errors by recording and phase, of this and the other filters."""
        heads = ["", *HEADS]
        blocks = {"tuned on": self.training, "held out": self.held_out}
        blocks |= {f"{name}, held out": scores for name, scores in self.baselines.items()}
        rows = [
            [title if first == 0 else "", *row]
            for title, scores in blocks.items()
            for first, row in enumerate(_rows(scores))
        ]
        if not any(row[-1] for row in rows):
            heads, rows = heads[:-1], [row[:-1] for row in rows]
        return text_table([heads, *rows])

    def origins(self) -> str:
        """Which quantities of the recordings are measured and which synthetic, and the notes."""
        lines = []
        for one in (*self.training, *self.held_out):
            words = [f"{quantity}: {text}" for quantity, text in one.sources.items()]
            lines += [f"{one.name}: {text}" for text in (*words, *one.notes)]
        return "\n".join(dict.fromkeys(lines))


def _rows(scores: Sequence[RecordingScore]) -> list[list[str]]:
    """A row for each phase of each recording, and the mean if there are several."""
    rows = [row for one in scores for row in error_rows(one.name, one.errors.items())]
    if len(scores) > 1:
        mean = mean_errors(scores)
        rows += error_rows("mean", [("judged", mean)])
    return rows


def mean_errors(scores: Sequence[RecordingScore]) -> Rmse:
    """Root mean square errors of the phase "judged", mean over recordings."""
    judged = [one.errors["judged"] for one in scores]
    positions = [one.position for one in judged if one.position is not None]
    return Rmse(
        total=float(np.mean([one.total for one in judged])),
        heading=float(np.mean([one.heading for one in judged])),
        inclination=float(np.mean([one.inclination for one in judged])),
        position=float(np.mean(positions)) if positions else None,
        samples=sum(one.samples for one in judged),
    )


def score(recording: Recording, estimates: Estimates) -> RecordingScore:
    """The score of a filter's estimates on a recording with a truth."""
    errors = replayed_on(recording, estimates).errors
    if errors is None:
        raise RecordingError(f"{recording.name}: has no truth, so that nothing can be judged")
    return RecordingScore(
        name=recording.name,
        samples=recording.samples,
        duration=recording.duration,
        attitude_only=recording.attitude_only,
        sources=recording.sources,
        notes=list(recording.notes),
        errors=errors.rmse(),
        fingerprint=fingerprint(recording),
        limited=_limited(recording, estimates),
    )


def _limited(recording: Recording, estimates: Estimates) -> float | None:
    """`RecordingScore.limited` for a filter's estimates."""
    m = recording.measurements
    weights = np.concatenate([m.vector_weights, m.landmark_weights], axis=1)
    asked, used = (np.asarray(g, np.float64) for g in (estimates.gain, estimates.gain_used))
    seen = (np.asarray(weights) > 0).any(axis=1) & np.isfinite(asked) & np.isfinite(used)
    if not seen.any():
        return None
    return float(np.mean(used[seen] < USED_SHARE * asked[seen]))


def judge_on_recordings(
    problem: TuningProblem,
    found: Found,
    position_weight: float,
    training: Sequence[Recording],
    held_out: Sequence[Recording],
) -> RecordingResult:
    """Judge the best candidate of a search on recordings."""
    experiment, search = problem.experiment, found.search
    tuned = problem.space.candidate(search.best_position)
    simulated = None if problem.beside is None else _on_scenarios(tuned, problem)
    result = RecordingResult(
        experiment=experiment,
        tuned_on="recordings" if simulated is None else "recordings and scenarios",
        filter=describe(tuned, parameter_space(experiment), experiment.search.evaluations),
        position_weight=position_weight,
        best_cost=float(search.best_cost),
        training=[],
        held_out=[],
        compile_seconds=found.compile_seconds,
        search_seconds=found.search_seconds,
        environment=environment(),
        version=VERSION,
        non_finite=int(search.non_finite),
        simulated=simulated,
        sensors=of_recordings(training),
    )
    both = ((result.training, training), (result.held_out, held_out))
    pairs = [(scores, one) for scores, recordings in both for one in recordings]
    for scores, one in steps.each("judging", pairs, lambda pair: pair[1].name):
        scores.append(score(one, result.estimate(one)))
    return result


def _on_scenarios(tuned: Candidate, problem: TuningProblem) -> SimulatedScore:
    """The cost on each simulated scenario of a problem."""
    agent = jax.tree.map(lambda a: a[None], tuned)
    costs = np.asarray(costs_by_scenario(agent, problem.scenarios)[:, 0], np.float64).tolist()
    count = problem.experiment.run.training_scenarios
    return SimulatedScore(costs[:count], costs[count:])


def tuned_on_scenarios(result: TuneResult, filter: Description | None = None) -> RecordingResult:
    """The filter of a run on simulated scenarios, not yet judged on recordings.

    Args:
        result: The run.
        filter: Another filter tuned on the run's scenarios, instead of the tuned one.
    """
    tuned = result.evaluation.contenders[TUNED].filter
    return RecordingResult(
        experiment=result.experiment,
        tuned_on="scenarios",
        filter=tuned if filter is None else filter,
        position_weight=0.0,
        best_cost=result.best_cost,
        training=[],
        held_out=[],
        compile_seconds=result.compile_seconds,
        search_seconds=result.search_seconds,
        environment=result.environment,
        version=result.version,
        non_finite=result.non_finite,
    )


def by_hand(
    schedule: GainSchedule,
    experiment: Experiment | None = None,
    *,
    recordings: Sequence[Recording] = (),
) -> RecordingResult:
    """A result from a schedule that was not searched, for judging, saving and exporting it.

    Args:
        schedule: `ConstantGain`, `FuzzyGain` with a controller that the experiment can produce,
            or another schedule of `posegsa.model.schedules`.
        experiment: Gives the filter, signal and weights; by default the recommended experiment.
        recordings: Recordings to judge the filter on.

    Raises:
        ArgumentError: The schedule has another type.
        FuzzyError: The experiment can't produce this controller.
    """
    chosen = Experiment() if experiment is None else experiment
    check_type("experiment", chosen, Experiment)
    check_type("schedule", schedule, FuzzyGain, *SCHEDULES.values())
    chosen = override(chosen, ["parameters.also=[]"])  # nothing is searched
    if isinstance(schedule, FuzzyGain) and chosen.fuzzy.rules == SEARCHED:
        chosen = chosen.replace(**{"fuzzy.rules": rule_table(schedule.controller.rules)})
    with jax.enable_x64(chosen.run.dtype == "float64"):
        space = parameter_space(chosen)
        if isinstance(schedule, FuzzyGain):
            own = schedule.controller
            made = space.schedule(space.checked(np.asarray(space.vector(own)))).controller
            for each in fields(FuzzyController):
                # `reach` only says how far terms overlap, to save time; it changes no output.
                if each.name != "reach" and not _same(getattr(made, each.name), own, each.name):
                    raise FuzzyError(
                        f"schedule.controller.{each.name}: is not what the experiment makes of its "
                        f"parameters, {getattr(made, each.name)}; allowed: a controller of this "
                        "experiment, or an experiment with the controller's [fuzzy] settings"
                    )
        found = describe(Candidate(schedule), space, 0)
    result = RecordingResult(
        experiment=chosen,
        tuned_on="nothing",
        filter=found,
        position_weight=DEGREES_PER_METRE,  # for the baselines beside it
        best_cost=None,
        training=[],
        held_out=[],
        compile_seconds=0.0,
        search_seconds=0.0,
        environment=environment(),
        version=VERSION,
        sensors=of_recordings(recordings),
    )
    result.held_out.extend(score(one, result.estimate(one)) for one in recordings)
    return result


def _same(made: object, controller: FuzzyController, name: str) -> bool:
    """Whether a controller's field equals `made`, arrays up to the precision of both."""
    own = getattr(controller, name)
    if isinstance(own, Array | np.ndarray):
        eps = 8 * max(float(np.finfo(np.asarray(a).dtype).eps) for a in (made, own))
        low, high = controller.output_range
        return bool(np.allclose(np.asarray(made), np.asarray(own), rtol=0, atol=eps * (high - low)))
    return made == own


def _sensors(recording: Recording) -> tuple[int, int]:
    m = recording.measurements
    return np.shape(m.vectors)[1], np.shape(m.landmarks)[1]
