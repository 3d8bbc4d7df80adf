"""The whole experiment, with the sections for running, filtering and judging."""

from collections.abc import Iterator
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from posegsa.config.changes import with_values
from posegsa.config.family import FamilyConfig
from posegsa.config.scenario import ScenarioConfig
from posegsa.config.schedule import (
    DEFAULT_ALSO,
    SEARCHED,
    FuzzyConfig,
    GainConfig,
    ParametersConfig,
)
from posegsa.config.tunable import AlsoTuned, also_conflicts, is_stated, with_effect, with_numbers
from posegsa.filters.observer import GainLaw, Law
from posegsa.optimisers import OPTIMISERS, DifferentialEvolution, Optimiser
from posegsa.settings.choice import Choice
from posegsa.settings.fields import (
    Ascending,
    Count,
    Flag,
    Index,
    NonNegative,
    Positive,
    Section,
    Tunable,
)
from posegsa.settings.violations import (
    Violation,
    config_error,
    violations_error,
    violations_of,
)

Window = Annotated[tuple[Index, Index], Ascending]
"""First and last sample, both included."""
ONE_OPTIMISER = Choice("optimiser", OPTIMISERS)
"""The optimisers that [search] can select."""
_OF_VECTOR_BIAS = Tunable("vector_bias", "estimated")


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
    """Their length as a multiple of the others; 1 means that they are not longer."""


class FilterConfig(Section):
    """[filter]: the observer."""

    law: Law = "gradient"
    """Innovation and bias law: "gradient", for which the Lyapunov argument holds, or "printed" as
    in the paper, which can diverge."""
    gamma: Annotated[NonNegative | tuple[NonNegative, NonNegative], Tunable()] = 2.5
    """Gain of the bias law [1/s^2]: one for both biases, or one for b_Omega and one for b_V."""
    substeps: Annotated[int, Field(strict=True, ge=1, le=64)] = 2
    """Number of inner steps per sample; the measurement is constant over them."""
    gamma_law: GainLaw = "quadratic"
    """How gamma depends on the gain K after its limit: constant, or proportional to K or K^2.
    `gamma` is its value at K = 10/s."""
    bias_bound: Annotated[tuple[Positive, Positive] | Literal["off"], Tunable()] = "off"
    """Maximum lengths of the estimated biases of angular and linear velocity [rad/s, m/s], for
    example from data sheets; "off" means none. They limit the estimate if measurements stop before
    it has converged; an estimate far beyond its bound is reset to 0."""
    length: Annotated[Positive, Tunable("law", "gradient")] = 1.0
    """Unit of length [m], which weighs attitude against position in the gain. About the distance of
    the landmarks from the origin lets both converge equally fast."""
    gain_limit: Annotated[Positive | Literal["off"], Tunable()] = 1.5
    """Maximum step of the innovation, K L dt / substeps with L the curvature of its cost, no unit;
    steps above 2 are unstable. "off" means no limit."""
    normalise_vectors: Flag = True
    """Whether all vectors, measured (less their estimated biases) and known, are normalised to
    length one."""
    cross_vector: Flag = True
    """Whether v_1 x v_2, of the first two vectors as measured, is used as a further vector."""
    cross_vector_weight: Annotated[NonNegative, Tunable("cross_vector", True)] = 0.5
    """Weight s^R of that vector, no unit."""
    vector_bias: Literal["off", "estimated"] = "estimated"
    """Whether the constant biases of the vectors are estimated."""
    vector_bias_gain: Annotated[NonNegative, _OF_VECTOR_BIAS] = 0.2
    """Gain gamma_c of their bias law [1/s]."""
    vector_bias_law: GainLaw = "linear"
    """How gamma_c depends on the gain K after its limit; vector_bias_gain is its value at K =
    10/s."""
    vector_bias_leak: Annotated[NonNegative, _OF_VECTOR_BIAS] = 0.0
    """Rate at which an estimate decays [1/s]."""
    vector_bias_bound: Annotated[Positive, _OF_VECTOR_BIAS] = 0.5
    """Maximum length of an estimated bias, in the vector's unit."""
    excitation: Annotated[Positive, _OF_VECTOR_BIAS] = 0.3
    """Angular velocity [rad/s] above which all of vector_bias_gain is used. Below it the gain falls
    with the fourth power, because at rest a bias is indistinguishable from an attitude error."""
    excitation_time: Annotated[NonNegative, _OF_VECTOR_BIAS] = 1.0
    """Time constant of the low-pass filter of that angular velocity [s]."""

    def _conflicts(self) -> Iterator[Violation]:
        if self.law == "printed" and self.length != 1.0:
            yield Violation("length", 'allowed: 1.0, because law = "printed"', self.length)


class CostConfig(Section):
    """[cost]: the sum of attitude and position errors over two windows of time."""

    transient_weight: NonNegative = 0.3
    """Weight of the transient window's sum, no unit."""
    steady_weight: NonNegative = 1.0
    """Weight of the steady window's sum, no unit."""
    position_weight: NonNegative = 0.2
    """Weight of the position error [m] beside the attitude error (0 to 1, no unit) [1/m]."""
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


class CheckpointConfig(Section):
    """[checkpoint]: when a search with a folder saves its state; this does not change results.

    A checkpoint is saved as soon as either interval is over, and at the end.
    """

    iterations: Count = 100
    """Maximum number of iterations between checkpoints."""
    seconds: NonNegative = 10.0
    """Maximum time between checkpoints [s], plus that of the running chunk of iterations."""
    keep: Annotated[int, Field(strict=True, ge=2, le=1000)] = 2
    """Number of latest checkpoints to keep; at least two, because one may be damaged."""


class Experiment(Section):
    """A whole experiment. `Experiment()` is the recommended one."""

    run: RunConfig = RunConfig()
    """Randomness, precision and the number of scenarios."""
    scenario: ScenarioConfig = ScenarioConfig()
    """True motion, sensors and initial estimate."""
    family: FamilyConfig = FamilyConfig()
    """What differs from scenario to scenario, besides the noise."""
    filter: FilterConfig = FilterConfig()
    """The observer."""
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
    checkpoint: CheckpointConfig = CheckpointConfig()
    """When a search saves its state."""

    @property
    def also(self) -> tuple[AlsoTuned, ...]:
        """The further numbers that are tuned, without defaults that have no effect here."""
        return with_effect(self, self.parameters.also, needless=DEFAULT_ALSO)

    def replace(self, **values: object) -> Self:
        """A checked copy with other values: `replace(**{"filter.gamma": 2.0})`.

        Args:
            values: New values by path, `section.key`; or whole sections, `search=posegsa.GSA(...)`.
                They affect optimiser and tuned numbers as in `config.override`.

        Raises:
            ConfigError: The result is not a valid experiment.
        """
        data, refused = with_values(self.model_dump(mode="json"), self.search, values.items())
        if refused:
            raise violations_error("values that cannot be replaced", refused)
        try:
            return type(self).model_validate(data)
        except ValidationError as error:
            title = "not a valid experiment with these values"
            raise config_error(title, error, type(self)) from None

    def _conflicts_of_bounds(self) -> Iterator[Violation]:
        """Conflicts that arise with all further tuned numbers at their lower or upper bounds."""
        for name in ("lower", "upper") if self.also else ():
            values = {one.key: getattr(one, name) for one in self.also}
            data = with_numbers(self.model_dump(mode="json"), values)
            data["parameters"]["also"] = []
            try:
                type(self).model_validate(data)
            except ValidationError as error:
                for violation in violations_of(error, type(self)):
                    reason = f"with each of these numbers at its {name} bound: {violation}"
                    yield Violation("parameters.also", reason)

    @model_validator(mode="after")
    def _leave_what_is_stated(self) -> Self:
        """Remove from the default list those numbers that the user has set."""
        given = self.parameters
        if "also" not in given.model_fields_set:
            kept = tuple(one for one in given.also if not is_stated(self, one.key))
            # The section is frozen; this is part of its construction.
            object.__setattr__(self, "parameters", given.model_copy(update={"also": kept}))
        return self

    def _conflicts(self) -> Iterator[Violation]:
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
        if self.filter.cross_vector and not self.scenario.cross_vector:
            yield Violation(
                "filter.cross_vector",
                "allowed: false, or first two vectors that are not collinear",
                True,
            )
        weight = self.filter.cross_vector_weight if self.filter.cross_vector else 0.0
        yield from (v.under(("scenario",)) for v in self.scenario.observability_conflicts(weight))
        wrong = list(also_conflicts(self, self.parameters.also, needless=DEFAULT_ALSO))
        yield from wrong or self._conflicts_of_bounds()
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
