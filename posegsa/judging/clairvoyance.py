"""Costs of the clairvoyant, the reference for filters on the same drawn scenarios."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.random import wrap_key_data

from posegsa import config
from posegsa.arguments import refuse
from posegsa.filters.base import samples_of
from posegsa.filters.clairvoyant import Clairvoyant, with_events
from posegsa.filters.kalman import KalmanNoise
from posegsa.filters.rollout import simulate_cost
from posegsa.judging.untuned import bias_spread
from posegsa.model.cost import CostWeights
from posegsa.model.estimate import initial_state
from posegsa.model.events import events_of
from posegsa.model.family import Family, realise
from posegsa.model.first_pose import first_pose, waiting_until
from posegsa.model.scenario import Scenario
from posegsa.search.drawn_scenarios import cost_weights, family, scenario
from posegsa.search.groups import in_groups, padded
from posegsa.search.keys import GENERATOR, held_out_keys

INITIAL_DEVIATION = 1e-3
"""Deviation of its initial pose about and along each axis [rad], [m]: small, but not 0."""


def clairvoyant_costs(experiment: config.Experiment, keys: Array | None = None) -> np.ndarray:
    """Costs (S,) of the clairvoyant on an experiment's scenarios, paired with any filter's.

    It starts where and when the experiment's filter does: with `scenario.start = "sensors"` at the
    first sample that fixes a pose, but at the true one. Nothing but the costs is kept.

    Args:
        experiment: its scenario, family and cost are used, its filter is not.
        keys: (S,) keys of the scenarios, by default the held-out ones; the same keys give the same
            scenarios in `scenario_batch`.

    Raises:
        ArgumentError: There are no keys, or they belong to another generator.
    """
    run = experiment.run
    keys = held_out_keys(run.seed, run.held_out_scenarios) if keys is None else keys
    words, count = np.asarray(jax.random.key_data(keys)), len(keys)
    if words.shape != (count, 2) or not count:
        refuse(f"keys of shape {words.shape}", f"at least one, of the generator {GENERATOR}")
    dtype = jnp.dtype(run.dtype)
    one = scenario(experiment)
    longer, drawn_from = replace(one, samples=padded(one.samples)), family(experiment, dtype)
    weights = cost_weights(experiment.cost, one.samples, dtype)
    prior, start = _prior(experiment), experiment.scenario.start

    def some(index: np.ndarray) -> Array:
        return _costs(longer, drawn_from, prior, weights, words[index], start)

    return in_groups(some, count, longer.samples)


def _prior(experiment: config.Experiment) -> Clairvoyant:
    """The clairvoyant with the spread of an experiment's biases; each scenario sets the rest."""
    dtype, spread = np.dtype(experiment.run.dtype), bias_spread(experiment)
    numbers = dict.fromkeys(KalmanNoise._fields, 0.0) | {
        "vector": 1.0,
        "landmark": 1.0,
        "initial_attitude": INITIAL_DEVIATION,
        "initial_position": INITIAL_DEVIATION,
        "initial_angular_bias": spread.angular,
        "initial_linear_bias": spread.linear,
        "initial_vector_bias": spread.vector,
    }
    arrays = {name: jax.device_put(dtype.type(number)) for name, number in numbers.items()}
    return Clairvoyant(KalmanNoise(**arrays))


@partial(jax.jit, static_argnames="start")
def _costs(
    scenario: Scenario,
    family: Family,
    prior: Clairvoyant,
    weights: CostWeights,
    keys: Array,
    start: str,
) -> Array:
    """Costs (S,) for key data (S, 2), over as many samples as there are weights."""
    N = weights.transient.shape[0]

    def cost(key: Array) -> Array:
        drawn, truth, sensed = realise(scenario, family, wrap_key_data(key, impl=GENERATOR))
        events, measured = events_of(drawn), sensed.measurements
        begin, first = None, 0
        if start != "given":
            found = first_pose(measured)
            measured = waiting_until(measured, found.sample)
            waits = jnp.arange(scenario.samples, dtype=jnp.int32)[:, None] < found.sample
            events = events._replace(jumps=jnp.where(waits, 0, events.jumps))
            begin = found.sample.astype(truth.time.dtype) * scenario.time_step
            first = jnp.minimum(found.sample, scenario.samples - 1)
        walk = drawn.bias_drift
        filter = prior.with_values({"angular_walk": walk[0], "linear_walk": walk[3]})
        samples = samples_of(
            filter, events.weighted(measured), truth.rotation, truth.position, truth.time
        )
        samples = with_events(samples, events, jumps=bool(drawn.jumps.time.size))
        samples = jax.tree.map(lambda a: a[:N], samples)
        initial = initial_state(truth.rotation[first], truth.position[first])
        end = None if family.duration is None else drawn.end
        counted = weights.between(samples.time, begin, end)
        return simulate_cost(filter, samples, initial, counted).total

    return jax.vmap(cost)(keys)
