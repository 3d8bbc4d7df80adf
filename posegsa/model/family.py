"""Scenario families: one scenario drawn from the distribution that a configuration describes."""

import math
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array, random

from posegsa.model.measurements import Measurements
from posegsa.model.scenario import Profile, Scenario, Truth, integrate, measure
from posegsa.model.se3 import random_rotation


@partial(
    jax.tree_util.register_dataclass,
    data_fields=[
        "attitude_error",
        "position_error",
        "bias_scale",
        "noise_scale",
        "landmark_spread",
        "motion_scale",
    ],
    meta_fields=["random_phase"],
)
@dataclass(frozen=True)
class Family:
    """Ranges that scenarios are drawn from; the ends are traced, which ones there are is not."""

    attitude_error: Array | None
    """(2,) least and largest angle of the initial attitude error [rad], or None: as the
    scenario's."""
    position_error: Array | None
    """(2,) length of the initial position error [m], or None: as the scenario's."""
    bias_scale: Array | None
    """(2,) factor on the velocity biases, or None."""
    noise_scale: Array | None
    """(2,) factor on all noise levels, or None."""
    landmark_spread: Array
    """Half the width of the cube about each landmark that it is drawn from [m]."""
    motion_scale: Array | None
    """(2,) factor on the velocities' amplitudes, or None."""
    random_phase: bool


def draw_scenario(scenario: Scenario, family: Family, key: Array) -> Scenario:
    """One scenario of a family (pure, jittable; vmap it over keys).

    What the family does not vary is the given scenario's, bit for bit. Each quantity has a key of
    its own, so that varying one does not change what is drawn of another.
    """
    names = (
        "attitude",
        "axis",
        "position",
        "direction",
        "bias",
        "noise",
        "landmarks",
        "motion",
        "phase",
    )
    use = dict(zip(names, random.split(key, len(names)), strict=True))
    dtype = scenario.time_step.dtype
    changed: dict[str, Array | Profile] = {}

    def unit(key: Array, *shape: int) -> Array:
        # Drawn in float32 whatever the dtype, so that a key means the same scenario in both.
        return random.uniform(key, shape, jnp.float32).astype(dtype)

    def between(ends: Array, key: Array) -> Array:
        return ends[0] + (ends[1] - ends[0]) * unit(key)

    # As precise on a GPU, whose products are coarser by default.
    matmul = partial(jnp.matmul, precision="highest")
    R_err = matmul(scenario.rotation_estimate, scenario.rotation.T)
    P_err = scenario.position_estimate - matmul(R_err, scenario.position)
    if family.attitude_error is not None:
        R_err = random_rotation(use["axis"], between(family.attitude_error, use["attitude"]))
        changed["rotation_estimate"] = matmul(R_err, scenario.rotation)
    if family.position_error is not None:
        direction = random.normal(use["direction"], (3,), jnp.float32).astype(dtype)
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
        profile: Profile = getattr(scenario, name)
        if family.motion_scale is not None:
            factor = between(family.motion_scale, use["motion"])
            profile = profile._replace(amplitude=factor * profile.amplitude)
        if family.random_phase:
            turn = 2 * math.pi * unit(phase_key, *profile.phase.shape)
            profile = profile._replace(phase=turn)
        changed[name] = profile
    return replace(scenario, **changed)


def realise(scenario: Scenario, family: Family, key: Array) -> tuple[Scenario, Truth, Measurements]:
    """One scenario of a family with its true motion and its measurements (pure, jittable)."""
    of_family, of_noise = random.split(key)
    drawn = draw_scenario(scenario, family, of_family)
    truth = integrate(drawn)
    return drawn, truth, measure(drawn, truth, of_noise)
