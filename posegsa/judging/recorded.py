"""What a search on recordings found, and what it is worth on recordings that it has not seen."""

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
"""What a filter was tuned on; on nothing if it was made by hand."""


def _with_what_is_judged(errors: dict[str, Rmse]) -> dict[str, Rmse]:
    """Errors by phase that were read, if those of all that is judged are among them."""
    if "judged" not in errors:
        raise ValueError(
            f"its phases are {', '.join(errors) or 'none'}; allowed: judged among them"
        )
    return errors


NOT_CUT = 0.99
"""Share of the gain asked for from which on it counts as used."""
MOSTLY = 0.5
"""Share of samples above which a result warns that the gain limit sets the gain."""
Share = Annotated[float, Field(ge=0, le=1)]


class RecordingScore(NamedTuple):
    """A filter on one recording."""

    name: str
    samples: int
    duration: float
    """[s]"""
    attitude_only: bool
    sources: dict[str, str]
    """What is measured and what was made from the truth, in words."""
    notes: list[str]
    """What was bridged, dropped or left out."""
    errors: Annotated[dict[str, Rmse], AfterValidator(_with_what_is_judged)]
    """Root mean squares by phase, "judged" first."""
    fingerprint: str
    """SHA-256 of the recording's numbers (`recordings.fingerprint`)."""
    limited: Share | None = None
    """Share of the samples with a measurement in which the gain limit cut what the schedule asked
    for; None of a filter without a gain K."""


class SimulatedScore(NamedTuple):
    """A filter that was tuned on recordings and simulated scenarios, on the latter."""

    training: Annotated[list[AnyNumber], Field(min_length=1)]
    """Its cost on each that it was tuned on [deg], by the root mean squares of its errors."""
    held_out: Annotated[list[AnyNumber], Field(min_length=1)]
    """The same on scenarios that only judge."""

    def text(self, share: float) -> str:
        """Both for a person, with the share of the scenarios in what was minimised."""
        rows = [
            [label, f"{np.mean(costs):.4g}", f"{np.max(costs):.4g}", str(len(costs))]
            for label, costs in (("tuned on", self.training), ("held out", self.held_out))
        ]
        title = f"Simulated scenarios, {share:g} of what was minimised, cost [deg]"
        return text_table([[title, "mean", "worst", "scenarios"], *rows])


@dataclass(frozen=True, kw_only=True)
class RecordingResult:
    """A gain schedule judged on recordings: how it was found, and what it is worth."""

    experiment: Experiment
    tuned_on: TunedOn
    """What the search saw."""
    filter: StoredFilter
    """The schedule by its kind and its own numbers, and what was tuned beside it."""
    position_weight: NonNegative
    """Of the position's RMSE in the cost on recordings [deg/m]; 0 where none were tuned on."""
    best_cost: Cost | None
    """Least cost that the search found: on recordings [deg], on scenarios the configured one; None
    of a filter made by hand."""
    training: list[RecordingScore]
    """On each recording that it was tuned on."""
    held_out: list[RecordingScore]
    """On recordings that only judge; empty if there were none."""
    compile_seconds: NonNegative
    search_seconds: NonNegative
    environment: dict[str, str]
    version: str
    non_finite: Annotated[int, Field(ge=0)] = 0
    """Number of agents whose cost was not finite."""
    simulated: SimulatedScore | None = None
    """On simulated scenarios, if these were tuned on too."""
    baselines: dict[str, list[RecordingScore]] = field(default_factory=dict)
    """Other filters on the same held-out recordings, by name (`evaluate`)."""
    sensors: StoredSensors | None = None
    """What the recordings that it was tuned on know of their sensors, for exports and streams; None
    where they differ in that, or there are none."""

    @cached_property
    def candidate(self) -> Candidate:
        """The tuned schedule, with what was tuned beside it."""
        with jax.enable_x64(self.experiment.run.dtype == "float64"):
            return candidate_of(self.filter, parameter_space(self.experiment))

    @property
    def schedule(self) -> GainSchedule:
        """The tuned gain schedule, ready for `run_filter`."""
        schedule = self.candidate.schedule
        assert schedule is not None  # every kind that is stored has one
        return schedule

    @property
    def tuned(self) -> Experiment:
        """The experiment with all in it that was tuned beside the schedule, its rule table too."""
        return tuned_experiment(self.experiment, self.filter)

    @property
    def controller(self) -> FuzzyController:
        """The tuned fuzzy controller; `controller(error=..., rate=...)` is a gain [1/s].

        Raises:
            ArgumentError: The gain is another kind of schedule, which has none.
        """
        schedule = self.schedule
        if not isinstance(schedule, FuzzyGain):
            refuse(f"controller of a {self.filter.kind} gain", "that of a fuzzy gain")
        return schedule.controller

    @property
    def known_sensors(self) -> KnownSensors:
        """What the filter knows of its sensors: of its recordings; of its scenario without any.

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
        """The tuned filter for so many sensors, each seen with the factor 1.

        If there are as many as in `known_sensors`, the weights that these have in the recordings
        are in its settings.
        """
        observer, known = self._observer(vectors, landmarks), self.sensors
        if known and (len(known.vectors), len(known.landmarks)) == (vectors, landmarks):
            return replace(observer, settings=known.weighted(observer.settings))
        return observer

    def filter_on(self, recording: Recording) -> Observer:
        """The tuned filter for a recording, whose own weights are factors on the filter's."""
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
            ArgumentError: It is none.
            MeasurementError: It can't be started.
        """
        check_type("recording", recording, Recording)
        with jax.enable_x64(self.experiment.run.dtype == "float64"):
            return run_filter(self.filter_on(recording), recording, state_of(recording.initial()))

    def __repr__(self) -> str:
        return f"<RecordingResult: a {self.filter.kind} gain; see summary()>"

    def summary(self) -> str:
        """A short text for a person; the held-out recordings always stand in it."""
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
        if cut and np.mean(cut) > MOSTLY:
            found.append(
                "the schedule asks for more than the gain limit allows in "
                f"{100 * np.mean(cut):.0f} % of the samples with a measurement: there the limit "
                "sets the gain, not the schedule, and a constant gain may do as well (`posegsa "
                "evaluate` shows it beside)"
            )
        return found

    def _behind_constant(self) -> str:
        """That the best constant gains err less on what was held out, in all that is judged."""
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
        """Root mean square errors by recording and phase, and those of other filters."""
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
        """What of the recordings is measured and what synthetic, and what was bridged."""
        lines = []
        for one in (*self.training, *self.held_out):
            words = [f"{quantity}: {text}" for quantity, text in one.sources.items()]
            lines += [f"{one.name}: {text}" for text in (*words, *one.notes)]
        return "\n".join(dict.fromkeys(lines))


def _rows(scores: Sequence[RecordingScore]) -> list[list[str]]:
    """A row for each phase of each recording, and the mean of what is judged of several."""
    rows = [row for one in scores for row in error_rows(one.name, one.errors.items())]
    if len(scores) > 1:
        mean = mean_errors(scores)
        rows += error_rows("mean", [("judged", mean)])
    return rows


def mean_errors(scores: Sequence[RecordingScore]) -> Rmse:
    """Means over recordings of the root mean squares of what is judged."""
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
    """A filter's estimates of a recording with a truth, judged."""
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
    """`RecordingScore.limited` of a filter's estimates."""
    m = recording.measurements
    weights = np.concatenate([m.vector_weights, m.landmark_weights], axis=1)
    asked, used = (np.asarray(g, np.float64) for g in (estimates.gain, estimates.gain_used))
    seen = (np.asarray(weights) > 0).any(axis=1) & np.isfinite(asked) & np.isfinite(used)
    if not seen.any():
        return None
    return float(np.mean(used[seen] < NOT_CUT * asked[seen]))


def judge_on_recordings(
    problem: TuningProblem,
    found: Found,
    position_weight: float,
    training: Sequence[Recording],
    held_out: Sequence[Recording],
) -> RecordingResult:
    """Judge the best candidate that a search on recordings found."""
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
    """The filter of a run on simulated scenarios, not yet judged on any recording.

    Args:
        result: The run.
        filter: Another one that was found on its scenarios, instead of the tuned one.
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
    """A filter whose gain schedule was not searched, as a result: to be judged, saved, exported.

    Args:
        schedule: `ConstantGain`, `FuzzyGain` of a controller that the experiment can have, or
            another of `posegsa.model.schedules`.
        experiment: Whose filter, signal and weights it has; by default the recommended one.
        recordings: That judge it.

    Raises:
        ArgumentError: It is another schedule.
        FuzzyError: The controller is none that the experiment can have.
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
                # How far terms overlap saves time and changes nothing.
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
        position_weight=DEGREES_PER_METRE,  # of the baselines that it is judged beside
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
    """Whether a field of a controller is what another one has, terms to the precision of both."""
    own = getattr(controller, name)
    if isinstance(own, Array | np.ndarray):
        eps = 8 * max(float(np.finfo(np.asarray(a).dtype).eps) for a in (made, own))
        low, high = controller.output_range
        return bool(np.allclose(np.asarray(made), np.asarray(own), rtol=0, atol=eps * (high - low)))
    return made == own


def _sensors(recording: Recording) -> tuple[int, int]:
    m = recording.measurements
    return np.shape(m.vectors)[1], np.shape(m.landmarks)[1]
