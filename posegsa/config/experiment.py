"""The whole experiment, with the sections for running, filtering and judging."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from posegsa.config.changes import with_values
from posegsa.config.family_config import FamilyConfig
from posegsa.config.filter_config import (
    BELIEF_ALSO,
    FILTERS,
    ONE_FILTER,
    SCHEDULE_NUMBERS,
    FilterConfig,
    KalmanConfig,
    ObserverConfig,
)
from posegsa.config.scenario_config import ScenarioConfig
from posegsa.config.schedule_config import (
    SEARCHED,
    FuzzyConfig,
    GainConfig,
    ParametersConfig,
)
from posegsa.config.tunable import (
    AlsoTuned,
    Places,
    also_conflicts,
    is_stated,
    tunable,
    with_numbers,
)
from posegsa.optimisers import OPTIMISERS, DifferentialEvolution, Optimiser
from posegsa.settings.choice import Choice
from posegsa.settings.fields import (
    Ascending,
    Count,
    Index,
    NonNegative,
    Number,
    Section,
)
from posegsa.settings.violations import (
    Violation,
    config_error,
    violations_error,
    violations_of,
)

StartOff = tuple[Annotated[NonNegative, Field(le=180)], NonNegative]
"""How far a start is from the truth, in attitude [deg] and position [m]."""
Window = Annotated[tuple[Index, Index], Ascending]
"""First and last sample, both included."""
_BY_DEFAULT = tuple(one for kind in FILTERS.values() for one in kind.also)
"""Numbers that are tuned by default; where one has no effect, it is left out without an error."""
ONE_OPTIMISER = Choice("optimiser", OPTIMISERS)
"""The optimisers that [search] can select."""


class RunConfig(Section):
    """[run]: randomness, precision and the number of scenarios."""

    seed: Annotated[int, Field(strict=True, ge=0, le=2**32 - 1)] = 0
    """Seed of everything random: noise, first agents, search."""
    dtype: Literal["float32", "float64"] = "float32"
    """Precision of the simulation."""
    training_scenarios: Count = 24
    """Number of scenarios that the search uses."""
    held_out_scenarios: Count = 64
    """Number of other scenarios on which the result is judged."""
    endurance_scenarios: Count = 16
    """Number of further scenarios, longer than those that the filter was tuned on."""
    endurance_times: Annotated[int, Field(strict=True, ge=1, le=1000)] = 8
    """Duration of these as a multiple of the others'; 1 means that none are run."""


class CostConfig(Section):
    """[cost]: the sum of attitude and position errors over two windows of time."""

    transient_weight: NonNegative = 0.3
    """Weight of the transient window's sum, no unit."""
    steady_weight: NonNegative = 1.0
    """Weight of the steady window's sum, no unit."""
    position_weight: NonNegative = 0.2
    """Weight of the position error [m] relative to the attitude error (0 to 1) [1/m]."""
    transient_window: Window = (0, 100)
    """First and last sample of the transient, both included (the paper: 0 to 1 s)."""
    steady_window: Window = (400, 5900)
    """First and last sample of the steady state, both included: 4 to 59 s (the paper: to 14 s)."""


class ObjectiveConfig(Section):
    """[objective]: how the costs on the training scenarios are combined into what is minimised."""

    name: Literal["mean", "median", "worst", "cvar", "mean_std"] = "mean"
    """The "mean", the "median" or the "worst" cost; "cvar", the mean of the worst costs;
    "mean_std", the mean plus a multiple of the standard deviation."""
    level: Annotated[float, Field(strict=True, ge=0, lt=1)] = 0.75
    """Only for "cvar": the share of the scenarios with the lowest costs that is left out, no
    unit."""
    factor: NonNegative = 1.0
    """Only for "mean_std": the multiple of the standard deviation, no unit."""
    simulated_share: Annotated[float, Field(strict=True, ge=0, lt=1)] = 0.0
    """Only for tuning on recordings: the weight of simulated scenarios in the objective, no unit. 0
    simulates none; 0.5 weighs both groups equally, whatever their sizes."""
    least_gain: Annotated[float, Field(strict=True, ge=0, lt=1)] = 0.0
    """Only on recordings, for a filter without a schedule: if a search lowers the cost by less than
    this share of it, the numbers stay as configured, no unit."""
    starts_off: tuple[StartOff, ...] = ()
    """Only on recordings: further starts from which each is tuned, by their distance from its
    truth, [deg, m], in random directions; besides its own start."""


class TunedConfig(Section):
    """[tuned]: the numbers of the last tuning. The filter has them if it is not searched.

    A search does not start from them, and replaces them in its result.
    """

    numbers: tuple[Number, ...] = ()
    """The schedule's own numbers: k1..k22; the gain; or low, high and half of a smooth gain."""
    also: dict[str, Number] = Field(default_factory=dict)
    """The further numbers, by the keys of parameters.also."""

    def __hash__(self) -> int:
        return hash((self.numbers, *sorted(self.also.items())))


class CheckpointConfig(Section):
    """[checkpoint]: when a search with a folder saves its state; this does not change results.

    A checkpoint is saved when either interval has passed, and at the end.
    """

    iterations: Count = 100
    """Maximum number of iterations between checkpoints."""
    seconds: NonNegative = 10.0
    """Maximum time between checkpoints [s]; the running chunk of iterations is finished first."""
    keep: Annotated[int, Field(strict=True, ge=2, le=1000)] = 2
    """Number of latest checkpoints to keep; at least two, because one may be damaged."""


class Experiment(Section):
    """A whole experiment. `Experiment()` is that of configs/observer.toml."""

    run: RunConfig = RunConfig()
    """Randomness, precision and the number of scenarios."""
    scenario: ScenarioConfig = ScenarioConfig()
    """True motion, sensors and initial estimate."""
    family: FamilyConfig = FamilyConfig()
    """What differs from scenario to scenario, besides the noise."""
    filter: Annotated[FilterConfig, ONE_FILTER] = ObserverConfig()
    """The filter, selected by `filter.kind`, with its settings."""
    gain: GainConfig = GainConfig()
    """The error signal, the input of the gain schedule."""
    fuzzy: FuzzyConfig = FuzzyConfig()
    """The fuzzy inference."""
    parameters: ParametersConfig = ParametersConfig()
    """The boxes of k1..k22."""
    cost: CostConfig = CostConfig()
    """The cost of a simulation."""
    objective: ObjectiveConfig = ObjectiveConfig()
    """How costs on several scenarios are combined."""
    search: Annotated[Optimiser, ONE_OPTIMISER] = DifferentialEvolution(
        agents=96, iterations=90, strategy="best/1/bin", factor=0.6
    )
    """The optimiser, selected by `search.optimiser`, with its settings."""
    tuned: TunedConfig = TunedConfig()
    """The numbers of the last tuning."""
    checkpoint: CheckpointConfig = CheckpointConfig()
    """When a search saves its state."""

    @property
    def also(self) -> tuple[AlsoTuned, ...]:
        """The further numbers that are tuned, without defaults that have no effect here."""
        places, asked = self._places(), self.parameters.also
        return tuple(one for one in asked if one.key in places or one not in _BY_DEFAULT)

    @property
    def default_also(self) -> tuple[AlsoTuned, ...]:
        """The numbers tuned by default, without parameters.also, for this kind of filter."""
        also = FILTERS[self.filter.kind].also
        if isinstance(self.filter, ObserverConfig) and self.filter.roles:
            return (*also, *BELIEF_ALSO)
        return also

    def _places(self) -> Places:
        """The numbers that a search may tune and that have an effect, by key."""
        if not isinstance(self.filter, ObserverConfig):
            without = ("gain.", "scenario.")
        else:
            without = ("gain.",) if self.filter.schedule == "constant" else ()
        return {key: at for key, at in tunable(self).items() if not key.startswith(without)}

    def replace(self, **values: object) -> Self:
        """A checked copy with other values: `replace(**{"filter.gamma": 2.0})`.

        Args:
            values: New values by path, `section.key`; or whole sections, `search=posegsa.GSA(...)`.
                They affect optimiser and tuned numbers as in `config.override`.

        Raises:
            ConfigError: The result is not a valid experiment.
        """
        titles = "values that cannot be replaced", "not a valid experiment with these values"
        return self.with_changes(list(values.items()), titles)

    def with_changes(
        self,
        changes: Sequence[tuple[str, object]],
        titles: tuple[str, str],
        unread: Iterable[Violation] = (),
    ) -> Self:
        """A checked copy with other values, without [tuned] if its numbers no longer fit.

        Args:
            changes: Paths and new values; a [tuned] that is among them is kept, and so may be
                refused.
            titles: Titles of the errors: for values that cannot be set, for an invalid result.
            unread: What could not be read, refused together with values that cannot be set.

        Raises:
            ConfigError: The result is not a valid experiment.
        """
        data, refused = with_values(self.model_dump(mode="json"), self.search, changes)
        if refused := [*unread, *refused]:
            raise violations_error(titles[0], refused)
        try:
            return type(self).model_validate(data)
        except ValidationError as error:
            if not any(path.partition(".")[0] == "tuned" for path, _ in changes):
                with suppress(ValidationError):
                    return type(self).model_validate(data | {"tuned": {}})
            raise config_error(titles[1], error, type(self)) from None

    def _conflicts_of_bounds(self) -> Iterator[Violation]:
        """Conflicts that arise if all further tuned numbers are at their lower or upper bounds."""
        also = self.also
        for name in ("lower", "upper") if also else ():
            values = {one.key: getattr(one, name) for one in also}
            data = with_numbers(self.model_dump(mode="json"), values)
            data["parameters"]["also"], data["tuned"] = [], {}
            try:
                type(self).model_validate(data)
            except ValidationError as error:
                for violation in violations_of(error, type(self)):
                    reason = f"with all these numbers at their {name} bounds: {violation}"
                    yield Violation("parameters.also", reason)

    def _conflicts_of_numbers(self, places: Places) -> Iterator[Violation]:
        """Numbers of a schedule that are not those of the filter's schedule."""
        given, kinds, words = len(self.tuned.numbers), [], ""
        if isinstance(self.filter, ObserverConfig):
            kinds = [self.filter.schedule, *self.filter.roles.values()]
            names = ", ".join(SCHEDULE_NUMBERS[self.filter.schedule])
            words = f"of a {self.filter.schedule} gain ({names})"
            words += f" and of belief ({', '.join(self.filter.roles)})" if kinds[1:] else ""
        elif isinstance(self.filter, KalmanConfig):
            kinds = self.filter.roles.values()
            words = f"of its schedules ({', '.join(self.filter.roles)})"
        needed = sum(sum(SCHEDULE_NUMBERS[kind].values()) for kind in kinds)
        if given and given != needed:
            allowed = f"{needed} {words}, or none" if needed else "none, as no schedule is on"
            yield Violation("tuned.numbers", f"allowed: {allowed}", given)
        for key, value in self.tuned.also.items():
            if key not in places:
                reason = f"has no effect here; allowed: {', '.join(places)}"
                yield Violation(f"tuned.also.{key}", reason, value)
            elif refusal := places[key].refusal(value):
                yield Violation(f"tuned.also.{key}", refusal, value)

    @model_validator(mode="after")
    def _leave_what_is_stated(self) -> Self:
        """Remove from the default list those numbers that the user has set."""
        given = self.parameters
        if "also" not in given.model_fields_set:
            kept = tuple(one for one in self.default_also if not is_stated(self, one.key))
            # The section is frozen; this is part of its construction.
            object.__setattr__(self, "parameters", given.model_copy(update={"also": kept}))
        return self

    def _conflicts(self) -> Iterator[Violation]:
        found = list(self._conflicts_as_configured())
        yield from found or self._conflicts_of_bounds()

    def _conflicts_as_configured(self) -> Iterator[Violation]:
        samples = self.scenario.samples
        for key, window in self.cost:
            if isinstance(window, tuple) and window[1] >= samples:
                yield Violation(
                    f"cost.{key}",
                    f"allowed: samples 0 to {samples - 1}, as scenario.duration = "
                    f"{self.scenario.duration} and scenario.sampling_time = "
                    f"{self.scenario.sampling_time} make {samples}",
                    window,
                )
        scheduled = isinstance(self.filter, KalmanConfig) and self.filter.roles
        if scheduled and self.fuzzy.rules == SEARCHED:
            reason = "allowed: a table, because the controllers of a Kalman filter share it"
            yield Violation("fuzzy.rules", reason, SEARCHED)
        crossed = isinstance(self.filter, ObserverConfig) and self.filter.cross_vector
        if crossed and not self.scenario.cross_vector:
            yield Violation(
                "filter.cross_vector",
                "allowed: false, or first two vectors that are not collinear",
                True,
            )
        weight = getattr(self.filter, "cross_vector_weight", 0.0) if crossed else 0.0
        yield from (v.under(("scenario",)) for v in self.scenario.observability_conflicts(weight))
        places = self._places()
        yield from also_conflicts(places, self.parameters.also, needless=_BY_DEFAULT)
        yield from self._conflicts_of_numbers(places)
        if self.fuzzy.rules == SEARCHED and all(p.wants_gradients for p in self.search.phases):
            reason = (
                f"allowed: a table, because search.optimiser = {self.search.optimiser!r} only "
                "follows gradients, and a choice between terms has none"
            )
            yield Violation("fuzzy.rules", reason, SEARCHED)
        if self.fuzzy.ordering:
            yield from (v.under(("parameters",)) for v in self.parameters.disorder())
        if self.fuzzy.coverage:
            yield from (v.under(("parameters",)) for v in self.parameters.gaps())
