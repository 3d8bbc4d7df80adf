"""Numbers that are tuned beside k1..k22: the same filter as with them in the configuration."""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders import quietly
from experiments import tiny
from setups import lasting, paper, search_vectors

from posegsa import config
from posegsa.config.tunable import tunable
from posegsa.model.schedules import ConstantGain
from posegsa.search.build import (
    filter_settings,
    parameter_space,
    scenario_batch,
    search_space,
    signal_settings,
    tuning_problem,
)
from posegsa.search.candidates import Candidate
from posegsa.search.keys import scenario_keys
from posegsa.search.population import evaluate_population
from posegsa.search.run import run_search, search_batch

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")

LEARNING = paper("filter.vector_bias=estimated", *lasting(0.3))
PAIR = config.override(
    LEARNING,
    ["filter.gamma=[5.0, 10.0]", "filter.length=2.0", "filter.bias_bound=[0.5, 1.5]"],
)
SCALAR = config.override(LEARNING, ["filter.gamma=5.0"])
KEYS = [
    *((PAIR, key) for key in tunable(PAIR)),
    (SCALAR, "filter.gamma"),
    (config.override(LEARNING, ["filter.vector_bias=off"]), "filter.gain_limit"),
]


def fixed(values: dict[str, float]) -> str:
    """The setting that tunes numbers between two ends that are one."""
    tables = (f'{{key = "{key}", lower = {v!r}, upper = {v!r}}}' for key, v in values.items())
    return f"parameters.also=[{', '.join(tables)}]"


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("experiment", "key"), KEYS, ids=[key for _, key in KEYS])
def test_a_number_of_its_own_is_that_of_the_configuration(experiment, key) -> None:
    candidate = Candidate(ConstantGain(jnp.asarray(9.0)), (jnp.asarray(0.37),), (key,))
    assert candidate.values_by_key() == {key: 0.37}

    def settings(of: config.Experiment):
        return filter_settings(of), signal_settings(of.gain, of.run.dtype)

    changed = config.with_tuned(experiment, candidate.values_by_key())
    assert changed == config.override(experiment, [f"{key}=0.37"]) != experiment
    ours, configured, before = (
        jax.tree.leaves_with_path(each)
        for each in (
            candidate.applied(*settings(experiment)),
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
        with pytest.raises(ValueError, match=key):
            candidate.applied(filter_settings(off), signal_settings(off.gain, np.float64))


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("vector_bias", ["estimated", "off"])
def test_costs_of_numbers_that_are_held_are_those_of_the_configuration(vector_bias) -> None:
    base = config.override(PAIR, [f"filter.vector_bias={vector_bias}"])
    values = {key: 0.3 + 0.05 * i for i, key in enumerate(tunable(base))}
    held = config.override(base, [fixed(values)])
    written = config.override(base, [f"{key}={value!r}" for key, value in values.items()])
    found = []
    for experiment in (held, written, base):
        space = search_space(experiment, parameter_space(experiment))
        vectors = jnp.asarray(search_vectors(3))
        also = jnp.broadcast_to(space.also_lower, (3, len(space.keys)))
        batch = scenario_batch(experiment, quietly(experiment), scenario_keys(jax.random.key(0), 2))
        found.append(evaluate_population(jnp.hstack([vectors, also]), batch, space))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-10)
    assert (np.abs(found[1] - found[2]) > 1e-3).all(), "the numbers matter"


SHORT = partial(
    tiny,
    "scenario.duration=0.3",
    "cost.transient_window=[0, 9]",
    "cost.steady_window=[10, 29]",
    'parameters.also=[{key="filter.gamma.1", lower=0.5, upper=50.0, scale="logarithmic"}, '
    '{key="scenario.landmarks.0.weight", lower=0.2, upper=2.0}]',
)


def test_they_are_searched_between_their_bounds_by_number_or_logarithm() -> None:
    space = tuning_problem(SHORT()).space
    assert space.box.lower.shape == (24,)
    np.testing.assert_allclose(space.box.lower[22:], [math.log(0.5), 0.2], rtol=1e-6)
    np.testing.assert_allclose(space.box.upper[22:], [math.log(50), 2.0], rtol=1e-6)
    middle = space.candidate((space.box.lower + space.box.upper) / 2).values_by_key()
    assert middle == pytest.approx({"filter.gamma.1": 5.0, "scenario.landmarks.0.weight": 1.1})


def test_one_compiled_search_finds_them_and_so_does_a_batch() -> None:
    problems = [tuning_problem(SHORT(f"run.seed={seed}")) for seed in (0, 1)]
    alone = run_search(problems[0]).search
    candidate = problems[0].space.candidate(alone.best_position)
    gamma, weight = candidate.values_by_key().values()
    assert 0.5 < gamma < 50
    assert 0.2 < weight < 2
    # The cost is that of the experiment with what was found written into it.
    written = config.with_tuned(problems[0].experiment, candidate.values_by_key())
    again = tuning_problem(config.override(written, ["parameters.also=[]"]))
    cost = evaluate_population(alone.best_position[None, :22], again.training, again.space)
    assert float(cost[0]) == pytest.approx(float(alone.best_cost), rel=1e-4)
    first, second = (found.search for found in search_batch(problems, None))
    assert float(first.best_cost) == float(alone.best_cost)
    np.testing.assert_array_equal(first.best_position, alone.best_position)
    assert float(second.best_cost) != float(first.best_cost)
