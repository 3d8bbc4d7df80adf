"""Scenarios drawn from a configuration's [scenario] and [family], ready to simulate."""

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.random import wrap_key_data
from jax.typing import DTypeLike

from posegsa import config
from posegsa.arguments import refuse
from posegsa.errors import PosegsaWarning
from posegsa.filters.base import Filter, samples_of
from posegsa.model.cost import CostWeights
from posegsa.model.estimate import initial_state
from posegsa.model.family import (
    Displacements,
    Disturbances,
    Family,
    NoiseFactors,
    Occasions,
    Turns,
    realise,
)
from posegsa.model.first_pose import bias_at_rest, first_pose, waiting_until
from posegsa.model.scenario import Bursts, Jumps, NoiseJumps, Scenario, Sensed, Sines, Truth
from posegsa.model.se3 import project_rotation
from posegsa.search.configured_filters import filter_of
from posegsa.search.groups import in_groups, padded
from posegsa.search.host_arrays import host_array
from posegsa.search.keys import GENERATOR, held_out_keys, training_keys
from posegsa.search.population import ScenarioBatch

T = TypeVar("T")
M = TypeVar("M")

DEFAULT_ESTIMATE = config.ScenarioConfig().initial_rotation_estimate


def all_scenarios(experiment: config.Experiment, filter: Filter | None = None) -> ScenarioBatch:
    """The training scenarios of an experiment, then the held-out ones.

    Warns of an initial estimate that is no rotation.
    """
    run = experiment.run
    _warn_of_projection(experiment.scenario)
    training = training_keys(run.seed, run.training_scenarios)
    held_out = held_out_keys(run.seed, run.held_out_scenarios)
    return scenario_batch(experiment, jnp.concatenate([training, held_out]), filter)


def scenario_batch(
    experiment: config.Experiment,
    keys: Array,
    filter: Filter | None = None,
    *,
    quiet: bool = False,
) -> ScenarioBatch:
    """S scenarios of an experiment's family, one for each key of keys (S,), ready to simulate.

    The arrays are on the host, where selecting scenarios compiles nothing. They are prepared for
    `filter`, by default the experiment's own.

    Raises:
        ArgumentError: There are no keys, or they belong to another generator.

    Warns:
        PosegsaWarning: The start waits for a pose that no sample of a scenario fixes; not if
            `quiet`.
    """
    filter, samples = filter or filter_of(experiment), experiment.scenario.samples
    draw, start = drawing(experiment, keys), experiment.scenario.start

    def some(index: np.ndarray) -> dict[str, Any]:
        made = _made_ready(filter, *draw(index), np.int32(samples - 1), start)
        return made | {"samples": jax.tree.map(lambda a: a[:, :samples], made["samples"])}

    drawn = in_groups(some, len(keys), padded(samples))
    if experiment.family.duration == "off":
        drawn["end"] = None
    if start == "given":
        drawn["begin"] = None
    elif not quiet and (
        never := int(np.sum(drawn["begin"] > (samples - 0.5) * experiment.scenario.sampling_time))
    ):
        warnings.warn(
            f"scenario.start = {start!r}: in {never} of {len(keys)} scenarios no sample fixes a "
            "pose; nothing is estimated there and nothing counts",
            PosegsaWarning,
            stacklevel=2,
        )
    weights = cost_weights(experiment.cost, samples, jnp.dtype(experiment.run.dtype))
    return ScenarioBatch(**drawn, weights=weights, filter=filter)


Drawn: TypeAlias = tuple[Scenario, Truth, Sensed]
"""S scenarios with their true motion and their measurements, leaves (S, ...)."""


def drawing(experiment: config.Experiment, keys: Array) -> Callable[[np.ndarray], Drawn]:
    """A function that draws some of an experiment's scenarios, by their numbers.

    They have a `padded` number of samples, so that scenarios of similar duration share a program.

    Raises:
        ArgumentError: There are no keys, or they belong to another generator.
    """
    words, count = np.asarray(jax.random.key_data(keys)), len(keys)
    if words.shape != (count, 2) or not count:
        refuse(f"keys of shape {words.shape}", f"at least one, of the generator {GENERATOR}")
    one, drawn_from = scenario(experiment), family(experiment, jnp.dtype(experiment.run.dtype))
    longer = replace(one, samples=padded(one.samples))
    return lambda index: _drawn(longer, drawn_from, words[index])


@jax.jit
def _drawn(scenario: Scenario, family: Family, keys: Array) -> Drawn:
    """Scenarios of a family for key data (S, 2)."""
    return jax.vmap(lambda key: realise(scenario, family, wrap_key_data(key, impl=GENERATOR)))(keys)


@partial(jax.jit, static_argnames="start")
def _made_ready(
    filter: Filter, drawn: Scenario, truth: Truth, sensed: Sensed, last: Array, start: str
) -> dict[str, Any]:
    """Fields of a `ScenarioBatch` of drawn scenarios; the bias is that of sample `last`."""

    def one(drawn: Scenario, truth: Truth, sensed: Sensed) -> dict[str, Any]:
        measured, begin = sensed.measurements, truth.time[0]
        pose = drawn.rotation_estimate, drawn.position_estimate
        bias = drawn.bias_estimate
        if start != "given":
            found = first_pose(measured)
            if start == "rest":
                bias = bias_at_rest(measured, found.sample)
            measured = waiting_until(measured, found.sample)
            pose = found.rotation, found.position
            begin = found.sample.astype(begin.dtype) * drawn.time_step
        return {
            "samples": samples_of(filter, measured, truth.rotation, truth.position, truth.time),
            "initial": initial_state(*pose, bias),
            "bias": sensed.bias[last],
            "vector_bias": drawn.vector_bias,
            "begin": begin,
            "end": drawn.end,
        }

    return jax.vmap(one)(drawn, truth, sensed)


def scenario(experiment: config.Experiment) -> Scenario:
    """The scenario that an experiment configures, at its dtype.

    The initial attitude estimate is projected onto SO(3): the matrix that the paper prints has
    determinant 0.943.
    """
    c = experiment.scenario
    dtype = jnp.dtype(experiment.run.dtype)

    def array(values: object, *shape: int) -> Array:
        return host_array(np.asarray(values, dtype).reshape(shape), dtype)

    def sines(axes: tuple[tuple[config.Sine, ...], ...]) -> Sines:
        length = max(1, *(len(axis) for axis in axes))
        table = np.zeros((3, 3, length))
        for i, axis in enumerate(axes):
            for j, sine in enumerate(axis):
                table[:, i, j] = sine.amplitude, sine.frequency, sine.phase
        return Sines(*(array(t, 3, length) for t in table))

    n, m = len(c.vectors), len(c.landmarks)
    drift = [c.angular_velocity_drift] * 3 + [c.velocity_drift] * 3
    return Scenario(
        samples=c.samples,
        time_step=array(c.sampling_time),
        angular_velocity=sines(c.angular_velocity),
        velocity=sines(c.velocity),
        rest=array(c.rest, len(c.rest), 2),
        bias=array([*c.angular_velocity_bias, *c.velocity_bias], 6),
        bias_drift=array(drift, 6),
        angular_noise=array(c.angular_velocity_noise),
        linear_noise=array(c.velocity_noise),
        vectors=array([v.direction for v in c.vectors], n, 3),
        vector_bias=array([v.bias for v in c.vectors], n, 3),
        vector_noise=array([v.noise for v in c.vectors], n),
        vector_outages=array([], 0, 2),
        vector_period=host_array([v.period for v in c.vectors], np.int32),
        vector_begin=host_array([_samples(v.begin, c.sampling_time) for v in c.vectors], np.int32),
        bursts=Bursts(array([], n, 0, 2), array([], n, 0, 3)),
        landmarks=array([p.position for p in c.landmarks], m, 3),
        landmark_bias=array([p.bias for p in c.landmarks], m, 3),
        landmark_noise=array([p.noise for p in c.landmarks], m),
        landmark_outages=array([], 0, 2),
        landmark_period=host_array(c.landmark_period, np.int32),
        landmark_turns=array([], 0),
        landmark_bursts=Bursts(array([], m, 0, 2), array([], m, 0, 3)),
        noise_jumps=NoiseJumps(array([], 2 + n + m, 0), array([], 2 + n + m, 0)),
        jumps=Jumps(array([], 0), array([], 0, 6)),
        rotation=array(c.initial_rotation, 3, 3),
        position=array(c.initial_position, 3),
        rotation_estimate=array(project_rotation(np.array(c.initial_rotation_estimate)), 3, 3),
        position_estimate=array(c.initial_position_estimate, 3),
        bias_estimate=array(c.initial_bias_estimate, 6),
        end=array(math.inf),
    )


def _samples(time: float, step: float) -> int:
    """Index of the first sample at a time or after it; at most the largest 32-bit integer."""
    return min(math.ceil(time / step - 1e-6), np.iinfo(np.int32).max)


def _warn_of_projection(c: config.ScenarioConfig) -> None:
    """Warn of an initial estimate that is no rotation, unless it is the default."""
    printed = np.array(c.initial_rotation_estimate)
    moved = np.abs(project_rotation(printed) - printed).max()
    # No warning for the default, the paper's matrix: the configuration and the README mention it.
    if moved > 1e-6 and c.initial_rotation_estimate != DEFAULT_ESTIMATE:
        warnings.warn(
            "scenario.initial_rotation_estimate is not a rotation (determinant "
            f"{np.linalg.det(printed):.3f}); it was projected onto SO(3), which moved its entries "
            f"by up to {moved:.2g}",
            PosegsaWarning,
            stacklevel=4,
        )


def family(experiment: config.Experiment, dtype: DTypeLike) -> Family:
    """The family of a configuration's [family] section, at a dtype."""
    section, duration = experiment.family, experiment.scenario.duration

    def ends(values: tuple[float, float] | str, unit: float = 1.0) -> Array | None:
        return None if isinstance(values, str) else host_array([unit * v for v in values], dtype)

    def number(value: float | str) -> Array | None:
        return None if isinstance(value, str) else host_array(value, dtype)

    def array(values: tuple[float, ...]) -> Array:
        return host_array(values, dtype)

    # Outages and bursts have the same number of windows: another number would change the draws.
    both = [o for o in (section.outages, section.bursts) if not isinstance(o, str)]
    most = max((_most_windows(o.rate * duration) for o in both), default=0)

    def lasting(one: config.Occasions, most: int | None = None) -> Occasions:
        expected = one.rate * duration
        most = _most_windows(expected) if most is None else most
        return Occasions(host_array(one.rate, dtype), array(one.duration), most)

    def sudden(one: config.NoiseJumpsConfig | config.JumpsConfig) -> Occasions:
        most = _most_windows(one.rate * duration)
        return Occasions(host_array(one.rate, dtype), array((0.0, 0.0)), most)

    def disturbances(one: config.BurstsConfig, most: int | None = None) -> Disturbances:
        size = one.size if isinstance(one.size, tuple) else (one.size, one.size)
        return Disturbances(lasting(one, most), array(size), one.each)

    def turns(one: config.InTurn) -> Turns:
        low, high = one.duration
        count = min(math.ceil(duration / low) + 1, _most_windows(2 * duration / (low + high)))
        return Turns(array(one.duration), host_array(one.begin, dtype), count)

    def displacements(one: config.JumpsConfig) -> Displacements:
        low, high = (math.radians(angle) for angle in one.angle)
        return Displacements(sudden(one), array((low, high)), array(one.distance))

    return Family(
        attitude_error=ends(section.attitude_error, math.pi / 180),
        position_error=ends(section.position_error),
        bias_scale=ends(section.bias_scale),
        noise_scale=ends(section.noise_scale),
        landmark_spread=host_array(section.landmark_spread, dtype),
        motion_scale=ends(section.motion_scale),
        angular_bias=number(section.angular_velocity_bias),
        linear_bias=number(section.velocity_bias),
        vector_bias=number(section.vector_bias),
        landmark_bias=number(section.landmark_bias),
        angular_drift=ends(section.angular_velocity_drift),
        linear_drift=ends(section.velocity_drift),
        outages=_made(section.outages, lambda one: lasting(one, most)),
        bursts=_made(section.bursts, lambda one: disturbances(one, most)),
        landmark_bursts=_made(section.landmark_bursts, disturbances),
        noise_jumps=_made(
            section.noise_jumps, lambda one: NoiseFactors(sudden(one), array(one.factor))
        ),
        landmark_turns=_made(section.landmarks_in_turn, turns),
        jumps=_made(section.jumps, displacements),
        landmark_interval=ends(section.landmark_interval),
        rest=ends(section.rest),
        rest_share=host_array(section.rest_share, dtype),
        duration=ends(section.duration),
        random_phase=section.random_phase,
        outage_of="all" if isinstance(section.outages, str) else section.outages.sensors,
    )


def _most_windows(expected: float) -> int:
    """A number of windows that is almost never exceeded; powers of two limit recompilation."""
    return 2 ** math.ceil(math.log2(expected + 6 * math.sqrt(expected) + 4))


def _made(given: T | Literal["off"], make: Callable[[T], M]) -> M | None:
    """What `make` returns for a setting; None if it is off."""
    return None if isinstance(given, str) else make(given)


def cost_weights(cost: config.CostConfig, samples: int, dtype: jnp.dtype) -> CostWeights:
    """Weights of the configured cost for N = `samples` samples; windows include both ends."""
    k = np.arange(samples)

    def inside(ends: tuple[int, int]) -> np.ndarray:
        return (k >= ends[0]) & (k <= ends[1])

    transient, steady = inside(cost.transient_window), inside(cost.steady_window)
    return CostWeights(
        transient=host_array(np.where(transient, cost.transient_weight, 0.0), dtype),
        steady=host_array(np.where(steady, cost.steady_weight, 0.0), dtype),
        window=host_array(steady, bool),
        position=host_array(cost.position_weight, dtype),
    )
