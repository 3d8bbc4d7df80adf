"""Scenario families: one scenario drawn from the distribution that a configuration describes."""

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, random
from jax.typing import DTypeLike

from posegsa.model.scenario import (
    Bursts,
    Jumps,
    NoiseJumps,
    Scenario,
    Sensed,
    Sines,
    Truth,
    integrate,
    measure,
)
from posegsa.model.se3 import random_rotation, stack, unstack, velocity_to

Sensors = Literal["all", "vectors", "landmarks"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Occasions:
    """An event that recurs: when one is over, the next starts after a random time."""

    rate: Array
    """Rate at which events start while none is active [1/s]."""
    duration: Array
    """(2,) minimum and maximum duration [s]."""
    most: int = field(metadata={"static": True})
    """Maximum number of events in a scenario; later ones are left out."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Disturbances:
    """Bursts of sensors of one kind: offsets in random directions."""

    occasions: Occasions
    size: Array
    """(2,) smallest and largest length of an offset, in the sensor's unit."""
    each: bool = field(metadata={"static": True})
    """Whether each sensor has bursts of its own; else each burst disturbs one of them, chosen at
    random."""


class NoiseFactors(NamedTuple):
    """Jumps of the noise of each sensor."""

    occasions: Occasions
    """When the jumps happen; they have no duration."""
    factor: Array
    """(2,) smallest and largest factor on the noise, drawn log-uniformly."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Turns:
    """Landmarks that are in sight one at a time, in order."""

    duration: Array
    """(2,) minimum and maximum time in sight [s]."""
    begin: Array
    """Time at which the first comes into sight [s]."""
    most: int = field(metadata={"static": True})
    """Maximum number of turns; the last one does not end."""


class Displacements(NamedTuple):
    """Jumps of the body between two samples."""

    occasions: Occasions
    """When the jumps happen; they have no duration."""
    angle: Array
    """(2,) smallest and largest angle, about a random axis [rad]."""
    distance: Array
    """(2,) smallest and largest distance, in a random direction [m]."""


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
    """Factor on the velocity biases, also where they are drawn."""
    noise_scale: Array | None
    """Factor on all noise levels."""
    landmark_spread: Array
    """Each landmark is drawn from a cube around it; half the width of that cube [m]."""
    motion_scale: Array | None
    """Factor on the velocities' amplitudes."""
    angular_bias: Array | None
    """Standard deviation of each component of the angular velocity's bias [rad/s]."""
    linear_bias: Array | None
    """Standard deviation of each component of the linear velocity's bias [m/s]."""
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
    bursts: Disturbances | None
    """Disturbances of the vectors."""
    landmark_bursts: Disturbances | None
    """Disturbances of the landmarks."""
    noise_jumps: NoiseFactors | None
    """Factors on the noise of each sensor."""
    landmark_turns: Turns | None
    """Landmarks in sight one at a time."""
    jumps: Displacements | None
    """Jumps of the body."""
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


def draw_scenario(scenario: Scenario, family: Family, key: Array) -> Scenario:
    """One scenario of a family (pure, jittable; vmap it over keys).

    What the family does not vary is copied from the given scenario bit for bit. Each quantity has
    its own key, so that varying one does not change another.
    """
    first = ("attitude", "axis", "position", "direction", "bias", "noise", "landmarks", "motion")
    names = (*first, "phase")
    use = dict(zip(names, random.split(key, len(names)), strict=True))
    later = ("vector_bias", "landmark_bias", "angular_drift", "linear_drift", "outages", "bursts")
    later += ("landmark_interval", "rest", "duration", "angular_bias", "linear_bias")
    later += ("landmark_bursts", "noise_jumps", "landmark_turns", "jumps")
    use |= {name: random.fold_in(key, i) for i, name in enumerate(later, start=len(names))}
    dtype = scenario.time_step.dtype
    changed: dict[str, Any] = {}

    def unit(key: Array, *shape: int) -> Array:
        return _unit(key, shape, dtype)

    def normal(key: Array, *shape: int) -> Array:
        return random.normal(key, shape, jnp.float32).astype(dtype)

    # By default GPUs compute products at a lower precision.
    matmul = partial(jnp.matmul, precision="highest")
    R_err = matmul(scenario.rotation_estimate, scenario.rotation.T)
    P_err = scenario.position_estimate - matmul(R_err, scenario.position)
    if family.attitude_error is not None:
        R_err = random_rotation(use["axis"], _between(family.attitude_error, use["attitude"]))
        changed["rotation_estimate"] = matmul(R_err, scenario.rotation)
    if family.position_error is not None:
        direction = normal(use["direction"], 3)
        length = _between(family.position_error, use["position"])
        P_err = length * direction / jnp.linalg.norm(direction)
    if family.attitude_error is not None or family.position_error is not None:
        changed["position_estimate"] = P_err + matmul(R_err, scenario.position)
    bias = [scenario.bias[:3], scenario.bias[3:]]
    for i, name in enumerate(("angular_bias", "linear_bias")):
        if (deviation := getattr(family, name)) is not None:
            bias[i] = deviation * normal(use[name], 3)
    changed["bias"] = jnp.concatenate(bias)
    if family.bias_scale is not None:
        changed["bias"] = _between(family.bias_scale, use["bias"]) * changed["bias"]
    if family.noise_scale is not None:
        factor = _between(family.noise_scale, use["noise"])
        for name in ("angular_noise", "linear_noise", "vector_noise", "landmark_noise"):
            changed[name] = factor * getattr(scenario, name)
    shift = 2 * unit(use["landmarks"], *scenario.landmarks.shape) - 1
    changed["landmarks"] = scenario.landmarks + family.landmark_spread * shift
    phase_keys = random.split(use["phase"], 2)
    for name, phase_key in zip(("angular_velocity", "velocity"), phase_keys, strict=True):
        sines: Sines = getattr(scenario, name)
        if family.motion_scale is not None:
            factor = _between(family.motion_scale, use["motion"])
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
            drift[i] = jnp.full(3, _between(ends, use[name]))
    changed["bias_drift"] = jnp.concatenate(drift)
    if family.outages is not None:
        windows = _windows(family.outages, use["outages"])
        for name in ("vectors", "landmarks"):
            if family.outage_of in ("all", name):
                changed[f"{name.removesuffix('s')}_outages"] = windows
    if family.bursts is not None:
        changed["bursts"] = _bursts(family.bursts, len(scenario.vectors), use["bursts"])
    if family.landmark_bursts is not None:
        of_landmarks = family.landmark_bursts, len(scenario.landmarks), use["landmark_bursts"]
        changed["landmark_bursts"] = _bursts(*of_landmarks)
    if family.noise_jumps is not None:
        count = 2 + len(scenario.vectors) + len(scenario.landmarks)
        changed["noise_jumps"] = _noise_jumps(family.noise_jumps, count, use["noise_jumps"])
    if family.landmark_turns is not None:
        changed["landmark_turns"] = _turns(family.landmark_turns, use["landmark_turns"])
    if family.jumps is not None:
        changed["jumps"] = _jumps(family.jumps, use["jumps"])
    if family.landmark_interval is not None:
        interval = _between(family.landmark_interval, use["landmark_interval"])
        samples = jnp.round(interval / scenario.time_step).astype(jnp.int32)
        changed["landmark_period"] = jnp.maximum(samples, 1)
    if family.rest is not None:
        of_share, of_length = random.split(use["rest"])
        length = _between(family.rest, of_length)
        rests = jnp.where(unit(of_share) < family.rest_share, length, 0)
        begin = jnp.stack([jnp.zeros_like(rests), rests])
        changed["rest"] = jnp.concatenate([scenario.rest, begin[None]])
    if family.duration is not None:
        changed["end"] = _between(family.duration, use["duration"])
    return replace(scenario, **changed)


def _unit(key: Array, shape: tuple[int, ...], dtype: DTypeLike) -> Array:
    """Uniform between 0 and 1; drawn in float32 for both dtypes, so that both agree."""
    return random.uniform(key, shape, jnp.float32).astype(dtype)


def _between(ends: Array, key: Array, *shape: int) -> Array:
    """Uniform between two ends (2,)."""
    low, high = ends
    return low + (high - low) * _unit(key, shape, ends.dtype)


def _directions(key: Array, count: int, dtype: DTypeLike) -> tuple[Array, Array]:
    """Vectors (count, 3) in directions that are uniform on the sphere, and lengths (count, 1)."""
    drawn = random.normal(key, (count, 3), jnp.float32).astype(dtype)
    return drawn, jnp.linalg.norm(drawn, axis=1, keepdims=True)


def _windows(occasions: Occasions, key: Array) -> Array:
    """Start and end times (most, 2) [s] of recurring events."""
    of_gap, of_duration = random.split(key)
    dtype, count = occasions.rate.dtype, occasions.most
    gaps = random.exponential(of_gap, (count,), jnp.float32).astype(dtype) / occasions.rate
    lengths = _between(occasions.duration, of_duration, count)
    ends = jnp.cumsum(gaps + lengths)
    return jnp.stack([ends - lengths, ends], axis=-1)


def _bursts(one: Disturbances, sensors: int, key: Array) -> Bursts:
    """Bursts of sensors of one kind; either each has its own, or they share one sequence."""
    of_window, of_sensor, of_offset = random.split(key, 3)
    most, dtype = one.occasions.most, one.size.dtype
    sequences = sensors if one.each else 1
    count = sequences * most
    size = _between(one.size, random.fold_in(key, 3), count, 1)
    direction, length = _directions(of_offset, count, dtype)
    offset = (size * direction / length).reshape(sequences, most, 3)
    if one.each:
        keys = random.split(of_window, sensors)
        return Bursts(jax.vmap(partial(_windows, one.occasions))(keys), offset)
    window = _windows(one.occasions, of_window)
    hit = random.randint(of_sensor, (most,), 0, sensors, jnp.int32)
    mine = hit[None] == jnp.arange(sensors, dtype=jnp.int32)[:, None]
    return Bursts(
        jnp.broadcast_to(window[None], (sensors, most, 2)), jnp.where(mine[..., None], offset, 0)
    )


def _noise_jumps(one: NoiseFactors, sensors: int, key: Array) -> NoiseJumps:
    """Factors of each sensor, log-uniform."""
    of_time, of_factor = random.split(key)
    windows = jax.vmap(partial(_windows, one.occasions))(random.split(of_time, sensors))
    factor = jnp.exp(_between(jnp.log(one.factor), of_factor, *windows.shape[:2]))
    return NoiseJumps(time=windows[..., 0], factor=factor)


def _turns(one: Turns, key: Array) -> Array:
    """Times (most,) [s] at which the next landmark comes into sight."""
    lengths = _between(one.duration, key, one.most - 1)
    return one.begin + jnp.pad(jnp.cumsum(lengths), (1, 0))


def _jumps(one: Displacements, key: Array) -> Jumps:
    """Jumps about random axes, and by displacements in random directions of the body frame."""
    of_time, of_angle, of_axis, of_distance, of_direction = random.split(key, 5)
    time = _windows(one.occasions, of_time)[:, 0]
    count, dtype = one.occasions.most, time.dtype

    def vectors(ends: Array, of_length: Array, of_direction: Array) -> Array:
        direction, norm = _directions(of_direction, count, dtype)
        return _between(ends, of_length, count, 1) * direction / norm

    (tx, ty, tz), (x, y, z) = (
        unstack(vectors(one.angle, of_angle, of_axis)),
        unstack(vectors(one.distance, of_distance, of_direction)),
    )
    return Jumps(time, stack((tx, ty, tz, *velocity_to((tx, ty, tz), (x, y, z)))))


def realise(scenario: Scenario, family: Family, key: Array) -> tuple[Scenario, Truth, Sensed]:
    """One scenario of a family with its true motion and its measurements (pure, jittable)."""
    of_family, of_noise = random.split(key)
    drawn = draw_scenario(scenario, family, of_family)
    truth = integrate(drawn)
    return drawn, truth, measure(drawn, truth, of_noise)
