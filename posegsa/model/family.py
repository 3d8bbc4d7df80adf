"""Scenario families: one scenario drawn from the distribution that a configuration describes."""

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, random

from posegsa.model.scenario import Bursts, Scenario, Sensed, Sines, Truth, integrate, measure
from posegsa.model.se3 import random_rotation

Sensors = Literal["all", "vectors", "landmarks"]


class Occasions(NamedTuple):
    """An event that recurs: when one is over, the next starts after a random time."""

    rate: Array
    """Rate at which events start while none is active [1/s]."""
    duration: Array
    """(2,) minimum and maximum duration [s]."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Family:
    """The ranges that scenarios are drawn from; numbers are traced, None is static.

    A range is (2,), minimum and maximum; values are drawn uniformly between them. None keeps the
    scenario's own value.
    """

    attitude_error: Array | None
    """Angle of the initial attitude error [rad]."""
    position_error: Array | None
    """Length of the initial position error [m]."""
    bias_scale: Array | None
    """Factor on the velocity biases."""
    noise_scale: Array | None
    """Factor on all noise levels."""
    landmark_spread: Array
    """Each landmark is drawn from a cube around it; half the width of that cube [m]."""
    motion_scale: Array | None
    """Factor on the velocities' amplitudes."""
    vector_bias: Array | None
    """Standard deviation of each component of each vector's bias, in the vector's unit."""
    landmark_bias: Array | None
    """Standard deviation of each component of each landmark's bias [m]."""
    angular_drift: Array | None
    """Intensity of the random walk of the angular velocity's bias [rad/s/sqrt(s)]."""
    linear_drift: Array | None
    """Intensity of the random walk of the linear velocity's bias [m/s/sqrt(s)]."""
    outages: Occasions | None
    """Times without measurements of the sensors `outage_of`."""
    bursts: Occasions | None
    """Times during which one of the vectors, drawn at random, is disturbed."""
    burst_size: Array
    """Length of the disturbance, which has a random direction, in the vector's unit."""
    landmark_interval: Array | None
    """Time between two measurements of the landmarks [s]."""
    rest: Array | None
    """Time at rest at the start [s], in scenarios that start at rest."""
    rest_share: Array
    """Share of the scenarios that start at rest."""
    duration: Array | None
    """Time after which samples no longer count [s]."""
    random_phase: bool = field(metadata={"static": True})
    outage_of: Sensors = field(metadata={"static": True})
    most_windows: int = field(metadata={"static": True})
    """Maximum number of outages, and of bursts, in a scenario; later ones are left out."""


def draw_scenario(scenario: Scenario, family: Family, key: Array) -> Scenario:
    """One scenario of a family (pure, jittable; vmap it over keys).

    What the family does not vary is copied from the given scenario bit for bit. Each quantity has
    its own key, so that varying one does not change another.
    """
    first = ("attitude", "axis", "position", "direction", "bias", "noise", "landmarks", "motion")
    names = (*first, "phase")
    use = dict(zip(names, random.split(key, len(names)), strict=True))
    later = ("vector_bias", "landmark_bias", "angular_drift", "linear_drift", "outages", "bursts")
    later += ("landmark_interval", "rest", "duration")
    use |= {name: random.fold_in(key, i) for i, name in enumerate(later, start=len(names))}
    dtype = scenario.time_step.dtype
    changed: dict[str, Any] = {}

    def unit(key: Array, *shape: int) -> Array:
        # Drawn in float32 for both dtypes, so that a key gives the same scenario in both.
        return random.uniform(key, shape, jnp.float32).astype(dtype)

    def normal(key: Array, *shape: int) -> Array:
        return random.normal(key, shape, jnp.float32).astype(dtype)

    def between(ends: Array, key: Array) -> Array:
        return ends[0] + (ends[1] - ends[0]) * unit(key)

    # By default GPUs compute products at a lower precision.
    matmul = partial(jnp.matmul, precision="highest")
    R_err = matmul(scenario.rotation_estimate, scenario.rotation.T)
    P_err = scenario.position_estimate - matmul(R_err, scenario.position)
    if family.attitude_error is not None:
        R_err = random_rotation(use["axis"], between(family.attitude_error, use["attitude"]))
        changed["rotation_estimate"] = matmul(R_err, scenario.rotation)
    if family.position_error is not None:
        direction = normal(use["direction"], 3)
        length = between(family.position_error, use["position"])
        P_err = length * direction / jnp.linalg.norm(direction)
    if family.attitude_error is not None or family.position_error is not None:
        changed["position_estimate"] = P_err + matmul(R_err, scenario.position)
    if family.bias_scale is not None:
        changed["bias"] = between(family.bias_scale, use["bias"]) * scenario.bias
    if family.noise_scale is not None:
        factor = between(family.noise_scale, use["noise"])
        for name in ("angular_noise", "linear_noise", "vector_noise", "landmark_noise"):
            changed[name] = factor * getattr(scenario, name)
    shift = 2 * unit(use["landmarks"], *scenario.landmarks.shape) - 1
    changed["landmarks"] = scenario.landmarks + family.landmark_spread * shift
    phase_keys = random.split(use["phase"], 2)
    for name, phase_key in zip(("angular_velocity", "velocity"), phase_keys, strict=True):
        sines: Sines = getattr(scenario, name)
        if family.motion_scale is not None:
            factor = between(family.motion_scale, use["motion"])
            sines = sines._replace(amplitude=factor * sines.amplitude)
        if family.random_phase:
            turn = 2 * math.pi * unit(phase_key, *sines.phase.shape)
            sines = sines._replace(phase=turn)
        changed[name] = sines
    for name in ("vector_bias", "landmark_bias"):
        if (deviation := getattr(family, name)) is not None:
            changed[name] = deviation * normal(use[name], *getattr(scenario, name).shape)
    drift = [scenario.bias_drift[:3], scenario.bias_drift[3:]]
    for i, name in enumerate(("angular_drift", "linear_drift")):
        if (ends := getattr(family, name)) is not None:
            drift[i] = jnp.full(3, between(ends, use[name]))
    changed["bias_drift"] = jnp.concatenate(drift)
    if family.outages is not None:
        windows = _windows(family.outages, family.most_windows, use["outages"])
        for name in ("vectors", "landmarks"):
            if family.outage_of in ("all", name):
                changed[f"{name.removesuffix('s')}_outages"] = windows
    if family.bursts is not None:
        of_window, of_vector, of_offset = random.split(use["bursts"], 3)
        direction = normal(of_offset, family.most_windows, 3)
        length = jnp.linalg.norm(direction, axis=1, keepdims=True)
        count = scenario.vectors.shape[0]
        changed["bursts"] = Bursts(
            window=_windows(family.bursts, family.most_windows, of_window),
            vector=random.randint(of_vector, (family.most_windows,), 0, count, jnp.int32),
            offset=family.burst_size * direction / length,
        )
    if family.landmark_interval is not None:
        interval = between(family.landmark_interval, use["landmark_interval"])
        samples = jnp.round(interval / scenario.time_step).astype(jnp.int32)
        changed["landmark_period"] = jnp.maximum(samples, 1)
    if family.rest is not None:
        of_share, of_length = random.split(use["rest"])
        length = between(family.rest, of_length)
        rests = jnp.where(unit(of_share) < family.rest_share, length, 0)
        begin = jnp.stack([jnp.zeros_like(rests), rests])
        changed["rest"] = jnp.concatenate([scenario.rest, begin[None]])
    if family.duration is not None:
        changed["end"] = between(family.duration, use["duration"])
    return replace(scenario, **changed)


def _windows(occasions: Occasions, count: int, key: Array) -> Array:
    """Start and end times (count, 2) [s] of recurring events."""
    of_gap, of_duration = random.split(key)
    dtype = occasions.rate.dtype
    gaps = random.exponential(of_gap, (count,), jnp.float32).astype(dtype) / occasions.rate
    low, high = occasions.duration
    lengths = low + (high - low) * random.uniform(of_duration, (count,), jnp.float32).astype(dtype)
    ends = jnp.cumsum(gaps + lengths)
    return jnp.stack([ends - lengths, ends], axis=-1)


def realise(scenario: Scenario, family: Family, key: Array) -> tuple[Scenario, Truth, Sensed]:
    """One scenario of a family with its true motion and its measurements (pure, jittable)."""
    of_family, of_noise = random.split(key)
    drawn = draw_scenario(scenario, family, of_family)
    truth = integrate(drawn)
    return drawn, truth, measure(drawn, truth, of_noise)
