"""Numbers tuned in addition to k1 to k22 give the same filter as in the configuration."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import LEARNT, paper

from posegsa import config
from posegsa.config.tunable import tunable
from posegsa.filters.observer import Observer
from posegsa.model.schedules import ConstantGain
from posegsa.search.candidates import Candidate
from posegsa.search.configured_filters import filter_of
from posegsa.search.population import evaluate_population
from posegsa.search.problem import tuning_problem
from posegsa.search.run_search import run_search
from posegsa.search.search_spaces import parameter_space, search_space

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")

LEARNING = paper(
    *LEARNT,
    "run.training_scenarios=2",
    "run.held_out_scenarios=1",
    "search.agents=20",
    "search.iterations=3",
    "search.optimiser=random_search",
)
PAIR = config.override(LEARNING, ["filter.gamma=[5.0, 10.0]"])
SCALAR = config.override(LEARNING, ["filter.gamma=5.0"])
KEYS = [
    *((PAIR, key) for key in tunable(PAIR)),
    (SCALAR, "filter.gamma"),
    (config.override(LEARNING, ["filter.vector_bias=off"]), "filter.gain_limit"),
]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("experiment", "key"), KEYS, ids=[key for _, key in KEYS])
def test_a_number_of_its_own_is_that_of_the_configuration(experiment, key) -> None:
    candidate = Candidate(ConstantGain(jnp.asarray(9.0)), (jnp.asarray(0.37),), (key,))
    assert candidate.values_by_key() == {key: 0.37}

    def settings(of: config.Experiment):
        filter = filter_of(of)
        assert isinstance(filter, Observer)
        return replace(filter, schedule=ConstantGain(jnp.asarray(9.0)))

    changed = config.with_tuned(experiment, candidate.values_by_key())
    assert changed == config.override(experiment, [f"{key}=0.37"]) != experiment
    ours, configured, before = (
        jax.tree.leaves_with_path(each)
        for each in (
            candidate.applied(settings(experiment)),
            settings(changed),
            settings(experiment),
        )
    )
    assert [path for path, _ in ours] == [path for path, _ in configured]
    for (path, own), (_, wanted) in zip(ours, configured, strict=True):
        assert own.dtype == wanted.dtype
        assert float(own) == float(wanted), path
    moved = [path for (path, a), (_, b) in zip(ours, before, strict=True) if float(a) != float(b)]
    assert len(moved) == (2 if key == "filter.gamma" else 1)


@pytest.mark.usefixtures("x64")
def test_a_key_of_something_else_is_refused() -> None:
    for key in ("scenario.velocity_noise", "filter.vector_bias_gain"):
        candidate = Candidate(ConstantGain(jnp.float32(9)), (jnp.float32(1),), (key,))
        off = config.override(LEARNING, ["filter.vector_bias=off"])
        name = key.removeprefix("filter.")
        with pytest.raises(ValueError, match=f"{name}: not a number of this filter"):
            candidate.applied(filter_of(off))


@pytest.mark.usefixtures("x64")
def test_they_are_searched_between_their_bounds_by_number_or_logarithm() -> None:
    gamma = '{key="filter.gamma.1", lower=0.5, upper=50.0, scale="logarithmic"}'
    weight = '{key="scenario.landmarks.0.weight", lower=0.2, upper=2.0}'
    experiment = config.override(PAIR, [f"parameters.also=[{gamma}, {weight}]"])
    box = (space := search_space(experiment, parameter_space(experiment))).box
    assert box.lower.shape == (24,)
    np.testing.assert_allclose(box.lower[22:], [math.log(0.5), 0.2], rtol=1e-6)
    np.testing.assert_allclose(box.upper[22:], [math.log(50), 2.0], rtol=1e-6)
    middle = (np.asarray(box.lower) + np.asarray(box.upper)) / 2
    values = space.candidate(middle).values_by_key()
    assert values == pytest.approx({"filter.gamma.1": 5.0, "scenario.landmarks.0.weight": 1.1})


@pytest.mark.usefixtures("x64")
def test_what_a_search_finds_costs_as_much_in_the_configuration() -> None:
    """All numbers at once; every third is fixed, because its two bounds are equal."""
    keys = tuple(tunable(PAIR))
    lower = [0.3 + 0.015 * i for i in range(len(keys))]
    upper = [low if i % 3 == 0 else low + 0.3 for i, low in enumerate(lower)]
    scales = ["logarithmic" if i % 2 else "linear" for i in range(len(keys))]
    tables = [
        f'{{key="{key}", lower={low!r}, upper={high!r}, scale="{scale}"}}'
        for key, low, high, scale in zip(keys, lower, upper, scales, strict=True)
    ]
    problem = tuning_problem(config.override(PAIR, [f"parameters.also=[{', '.join(tables)}]"]))
    found = run_search(problem).search
    values = problem.space.candidate(found.best_position).values_by_key()
    assert tuple(values) == keys
    slack = 1e-12
    for value, low, high in zip(values.values(), lower, upper, strict=True):
        assert low - slack <= value <= high + slack
        assert low == high or low < value < high

    def cost(experiment: config.Experiment) -> float:
        """Cost of the result, repeated 100 times to use the same program as other tests."""
        made = tuning_problem(config.override(experiment, ["parameters.also=[]"]))
        vectors = jnp.asarray(np.tile(np.asarray(found.best_position)[:22], (100, 1)))
        return float(evaluate_population(vectors, made.training, made.space)[0])

    assert cost(config.with_tuned(problem.experiment, values)) == pytest.approx(
        float(found.best_cost), rel=1e-9
    )
    assert abs(cost(PAIR) - found.best_cost) > 1e-3, "the numbers matter"
