"""What happens at each sample of a scenario and is hidden from filters: noise, bursts, jumps."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from posegsa.model.measurements import Measurements
from posegsa.model.scenario import Scenario, jumps_between


class Events(NamedTuple):
    """The state of all sensors and the jumps of the body over N samples."""

    angular_noise: Array
    """(N,) standard deviation of each component of the angular velocity's noise [rad/s]."""
    linear_noise: Array
    """(N,) the same for the linear velocity [m/s]."""
    vector_noise: Array
    """(N, n) the same for each vector, in its unit."""
    landmark_noise: Array
    """(N, m) the same for each landmark [m]."""
    vector_bursts: Array
    """(N, n) whether a burst disturbs a vector."""
    landmark_bursts: Array
    """(N, m) whether a burst disturbs a landmark."""
    jumps: Array
    """(N, 6) jump to the next sample, xi of T <- T exp(xi^), body frame [rad, m]; 0 without one."""

    def weighted(self, measurements: Measurements) -> Measurements:
        """Measurements with weights that are inverse variances, and 0 during bursts.

        With these weights, the true noise is one of standard deviation 1.
        """
        return measurements._replace(
            vector_weights=_inverse_variance(
                measurements.vector_weights, self.vector_noise, self.vector_bursts
            ),
            landmark_weights=_inverse_variance(
                measurements.landmark_weights, self.landmark_noise, self.landmark_bursts
            ),
        )


def events_of(scenario: Scenario) -> Events:
    """The events of a scenario (pure, jittable); no random numbers are drawn for it."""
    dtype, N = scenario.time_step.dtype, scenario.samples
    time = jnp.arange(N, dtype=jnp.int32).astype(dtype) * scenario.time_step
    n, m = len(scenario.vectors), len(scenario.landmarks)
    factors = jnp.ones((N, 2 + n + m), dtype)
    if scenario.noise_jumps.time.size:
        factors = scenario.noise_jumps.at(time)
    bursts = [
        jnp.any(one.at(time) != 0, axis=-1) if one.window.size else jnp.zeros((N, count), bool)
        for one, count in ((scenario.bursts, n), (scenario.landmark_bursts, m))
    ]
    return Events(
        angular_noise=factors[:, 0] * scenario.angular_noise,
        linear_noise=factors[:, 1] * scenario.linear_noise,
        vector_noise=factors[:, 2 : 2 + n] * scenario.vector_noise[None],
        landmark_noise=factors[:, 2 + n :] * scenario.landmark_noise[None],
        vector_bursts=bursts[0],
        landmark_bursts=bursts[1],
        jumps=jumps_between(scenario),
    )


def _inverse_variance(weights: Array, deviation: Array, disturbed: Array) -> Array:
    seen = (weights > 0) & ~disturbed
    # Without noise the weight is large, but finite.
    smallest = jnp.finfo(deviation.dtype).tiny ** 0.25
    variance = jnp.maximum(deviation, smallest) ** 2
    return jnp.where(seen, 1 / variance, 0.0)
