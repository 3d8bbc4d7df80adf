"""The experiments that tests run: the paper's, very small ones, and scenarios of any kind."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from posegsa import config
from posegsa.config import CostConfig, Experiment, ObserverConfig, RunConfig, ScenarioConfig
from posegsa.filters.observer import Observer
from posegsa.search.candidates import SearchSpace
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import scenario_keys
from posegsa.search.parameters import ParameterSpace
from posegsa.search.population import ScenarioBatch
from posegsa.search.search_spaces import parameter_space, search_space

PAPER = config.load(Path(__file__).parents[2] / "configs" / "paper.toml")

LEARNT = (
    *("filter.vector_bias=estimated", "filter.vector_bias_law=linear"),
    *("filter.gamma_law=quadratic", "filter.substeps=2", "gain.smoothing=1.5"),
    *("filter.length=2.0", "filter.bias_bound=[0.5, 1.5]", "filter.length_growth=0.1"),
    *("filter.bias_wait=0.4", "gain.unknown=0.5"),
)
"""The laws of the observer of observer.toml, with all optional numbers of a filter."""


def paper(*settings: str, dtype: str = "float64") -> config.Experiment:
    """The paper's experiment with single values changed, as `--set` does."""
    return config.override(PAPER, [f"run.dtype={dtype}", *settings])


def lasting(seconds: float) -> tuple[str, ...]:
    """Settings for a shorter run, with windows at the same fractions of it as the paper's."""
    N = round(seconds / PAPER.scenario.sampling_time)
    return (
        f"scenario.duration={seconds}",
        f"cost.transient_window=[0, {N // 15}]",
        f"cost.steady_window=[{4 * N // 15}, {14 * N // 15}]",
    )


def space(*settings: str, dtype: str = "float64") -> ParameterSpace:
    """The parameter space of the paper's experiment with single values changed."""
    return parameter_space(paper(*settings, dtype=dtype))


def searched(*settings: str, dtype: str = "float64") -> SearchSpace[ParameterSpace]:
    """The tuning problem of the paper's experiment with single values changed."""
    experiment = paper(*settings, dtype=dtype)
    return search_space(experiment, parameter_space(experiment))


def posed(experiment: config.Experiment, scenarios: int = 1) -> ScenarioBatch:
    """The problem of an experiment's scenario with some noise keys, at its dtype."""
    return scenario_batch(experiment, scenario_keys(jax.random.key(0), scenarios))


def without_limit(limited: ScenarioBatch) -> ScenarioBatch:
    """The same problem without gain limit."""
    assert isinstance(limited.filter, Observer)
    settings = limited.filter.settings
    free = dataclasses.replace(settings, gain_limit=jnp.full_like(settings.gain_limit, jnp.inf))
    return limited._replace(filter=dataclasses.replace(limited.filter, settings=free))


# Very small ones ----------------------------------------------------------------------------------

BASE = [
    "family.attitude_error=off",
    "family.position_error=off",
    "family.random_phase=false",
    "filter.gamma=[5.0, 10.0]",
    "filter.gamma_law=fixed",
    "filter.vector_bias=off",
    "filter.cross_vector_weight=1.0",
    "gain.smoothing=2.0",
    "gain.error_scale=1.0",
    "parameters.also=[]",
    "search.optimiser=gsa",
]
"""The paper's scenario and filter with two sub-steps and smoothing, searched by GSA."""
TINY = [
    *BASE,
    "scenario.duration=2.0",
    "cost.steady_window=[150, 199]",
    "search.agents=6",
    "search.iterations=4",
    "run.training_scenarios=3",
    "run.held_out_scenarios=3",
]
"""As many training as held-out scenarios, so that both use one compiled program."""


def tiny(*settings: str) -> config.Experiment:
    return config.override(config.Experiment(), [*TINY, *settings])


# Scenarios of any kind ----------------------------------------------------------------------------

AT_REST: dict[str, Any] = {"angular_velocity": ((), (), ()), "velocity": ((), (), ())}
"""A scenario without motion."""


def experiment(dtype: str = "float64", *, cross_vector: bool = True, **scenario: Any) -> Experiment:
    """The paper's experiment with another scenario, of any length."""
    return Experiment(
        filter=ObserverConfig(cross_vector=cross_vector),
        run=RunConfig(dtype=dtype),
        scenario=ScenarioConfig(**scenario),
        cost=CostConfig(transient_window=(0, 1), steady_window=(1, 1)),
    )
