"""An experiment made ready to search: its scenarios and its search space."""

from typing import NamedTuple

import jax.numpy as jnp

from posegsa import config
from posegsa.arguments import check_type
from posegsa.errors import ConfigError
from posegsa.search import memory
from posegsa.search.candidates import SearchSpace
from posegsa.search.configured_filters import OwnFilter, filter_of
from posegsa.search.drawn_scenarios import all_scenarios
from posegsa.search.population import ScenarioBatch, TrackCost, check_cost
from posegsa.search.search_spaces import search_space


class TuningProblem(NamedTuple):
    """An experiment with its scenarios and its search space, ready to search."""

    experiment: config.Experiment
    scenarios: ScenarioBatch | None
    """Training scenarios, then held-out ones; None where nothing is simulated."""
    training: ScenarioBatch
    """What is tuned on: scenarios, or recordings."""
    space: SearchSpace
    cost: TrackCost | None = None
    """A user's own cost of a simulation; None for the configured one."""
    beside: ScenarioBatch | None = None
    """Simulated scenarios that a search on recordings also uses, or None."""
    own: OwnFilter | None = None
    """The user's own filter, if it is one."""

    @property
    def simulated(self) -> ScenarioBatch:
        """`scenarios`, where there are some."""
        assert self.scenarios is not None
        return self.scenarios

    @property
    def held_out(self) -> ScenarioBatch:
        """The scenarios that only evaluate the result."""
        return self.simulated.select(slice(self.experiment.run.training_scenarios, None))


def tuning_problem(
    experiment: config.Experiment, cost: TrackCost | None = None, own: OwnFilter | None = None
) -> TuningProblem:
    """Build an experiment's scenarios and parameter space.

    Args:
        experiment: What is searched.
        cost: A user's own cost.
        own: The user's own filter, where the experiment has one.

    Raises:
        MemoryLimitError: It would need more memory than there is.
        ArgumentError: The user's cost does not return one number, or the filter is missing.
        ConfigError: It has a share for simulated scenarios, which only a search on recordings has;
            or its filter reads inertial sensors, which scenarios do not have.
    """
    check_type("experiment", experiment, config.Experiment)
    if experiment.objective.simulated_share:
        raise ConfigError(
            f"objective.simulated_share = {experiment.objective.simulated_share}; allowed: 0.0 "
            "without recordings"
        )
    if isinstance(experiment.filter, config.AttitudeConfig):
        raise ConfigError(
            'filter.kind = "imu" reads an accelerometer and a magnetometer, which no scenario has; '
            "allowed: recordings of inertial sensors"
        )
    memory.check([experiment])
    run, drawn = experiment.run, experiment.scenario
    check_cost(cost, drawn.samples, len(drawn.vectors), jnp.dtype(run.dtype))
    scenarios = all_scenarios(experiment, filter_of(experiment, own))
    return TuningProblem(
        experiment=experiment,
        scenarios=scenarios,
        training=scenarios.select(slice(run.training_scenarios)),
        space=search_space(experiment),
        cost=cost,
        own=own,
    )
