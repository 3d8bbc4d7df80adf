"""Costs of the clairvoyant, the reference for filters on the same drawn scenarios."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa import config
from posegsa.filters.base import Filter, samples_of
from posegsa.filters.clairvoyant import Clairvoyant, with_events
from posegsa.filters.kalman import KalmanNoise
from posegsa.judging.metrics import cost_parts, error_tracks
from posegsa.judging.untuned import bias_spread
from posegsa.model.estimate import initial_state
from posegsa.model.events import events_of
from posegsa.model.first_pose import first_pose, waiting_until
from posegsa.model.scenario import Scenario, Sensed, Truth
from posegsa.search.candidates import Candidate
from posegsa.search.drawn_scenarios import cost_weights, drawing
from posegsa.search.groups import SCENARIOS, in_groups, padded
from posegsa.search.keys import held_out_keys
from posegsa.search.population import ScenarioBatch

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
    run, c = experiment.run, experiment.scenario
    keys = held_out_keys(run.seed, run.held_out_scenarios) if keys is None else keys
    draw, filter = drawing(experiment, keys), _prior(experiment)
    weights = cost_weights(experiment.cost, c.samples, jnp.dtype(run.dtype))

    def some(index: np.ndarray) -> np.ndarray:
        def draw_some(i: np.ndarray) -> dict[str, Any]:
            return _made_ready(filter, *draw(index[i]), c.start)

        made = in_groups(draw_some, len(index), padded(c.samples))
        samples = jax.tree.map(lambda a: a[:, : c.samples], made.pop("samples"))
        batch = ScenarioBatch(samples, **made, weights=weights, filter=filter)
        if experiment.family.duration == "off":
            batch = batch._replace(end=None)
        # Most evaluations have few scenarios, for which compiling takes longer than running.
        tracks = error_tracks(Candidate(), batch, optimised=False)
        transient, steady = cost_parts(tracks, batch)
        return transient + steady

    # As many at once as are judged at once, so that their samples are never all in memory.
    every = np.arange(len(keys))
    return np.concatenate([some(every[i : i + SCENARIOS]) for i in every[::SCENARIOS]])


def _prior(experiment: config.Experiment) -> Clairvoyant:
    """The clairvoyant with the spread of an experiment's biases; its samples hold the rest."""
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
def _made_ready(
    filter: Filter, drawn: Scenario, truth: Truth, sensed: Sensed, start: str
) -> dict[str, Any]:
    """Fields of a `ScenarioBatch` of drawn scenarios, for the clairvoyant."""

    def one(drawn: Scenario, truth: Truth, sensed: Sensed) -> dict[str, Any]:
        events, measured = events_of(drawn), sensed.measurements
        begin, first = None, 0
        if start != "given":
            found = first_pose(measured)
            measured = waiting_until(measured, found.sample)
            waits = jnp.arange(drawn.samples, dtype=jnp.int32)[:, None] < found.sample
            events = events._replace(jumps=jnp.where(waits, 0, events.jumps))
            begin = found.sample.astype(truth.time.dtype) * drawn.time_step
            first = jnp.minimum(found.sample, drawn.samples - 1)
        samples = samples_of(
            filter, events.weighted(measured), truth.rotation, truth.position, truth.time
        )
        jumps = bool(drawn.jumps.time.size)
        return {
            "samples": with_events(samples, events, drawn.bias_drift, jumps=jumps),
            "initial": initial_state(truth.rotation[first], truth.position[first]),
            "bias": sensed.bias[-1],  # not read, as only costs are kept
            "vector_bias": drawn.vector_bias,
            "begin": begin,
            "end": drawn.end,
        }

    return jax.vmap(one)(drawn, truth, sensed)
