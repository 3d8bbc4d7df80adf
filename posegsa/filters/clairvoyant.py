"""The clairvoyant: a Kalman filter that knows what no real filter can know, as a reference.

It starts from the true pose, with biases of 0 and their spread as standard deviations, and knows
the noise of each sensor at each sample, each burst (it drops that measurement), each outage, and
each jump of the body (its velocity includes the jump). It is no bound: a filter that also models
how smoothly the body moves, or that estimates what a burst adds, can have a lower cost.

It is the Kalman filter of `filters.kalman`. Its `noise` has the deviations of the start and the
walk of the vectors' biases; `vector` and `landmark` are 1, since the weights of its measurements
are inverse variances (`model.events`). A jump exp(xi^) follows the velocity of its sample:

    T_est <- T_est exp(xi^),    Sigma <- A Sigma A^T,    A = Ad(exp(-xi^)).
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from posegsa.filters.base import Record, Samples
from posegsa.filters.kalman import KalmanFilter, KalmanNoise, KalmanState, propagate, update
from posegsa.model.events import Events
from posegsa.model.sample import Sample
from posegsa.model.se3 import Vec3, add, scale, unstack

JUMP_TIME = 1e-9
"""Time in which a jump happens [s]: long enough for float32, too short for a bias to act."""


class KnownMotion(NamedTuple):
    """What the clairvoyant knows about the motion, by components (N,), or of one sample."""

    angular_velocity: Array
    """Density of the angular velocity's noise [rad/sqrt(s)]."""
    velocity: Array
    """Density of the velocity's noise [m/sqrt(s)]."""
    angular_walk: Array
    """Random walk of the angular velocity's bias [rad/s/sqrt(s)]."""
    linear_walk: Array
    """Random walk of the velocity's bias [m/s/sqrt(s)]."""
    jump: tuple[Vec3, Vec3] | None
    """Rotation [rad] and displacement [m] of the jump to the next sample, xi of T <- T exp(xi^);
    None if the body never jumps."""


def with_events(samples: Samples, events: Events, walk: Array, *, jumps: bool) -> Samples:
    """The clairvoyant's input: samples of weighted measurements, and what it knows besides.

    Args:
        samples: N samples, prepared from `events.weighted(measurements)`.
        events: the events of the same N samples.
        walk: (6,) random walks of the velocities' biases, as in `Scenario.bias_drift`.
        jumps: whether the body ever jumps; without jumps a step takes half as long.
    """
    root = jnp.sqrt(samples.sample.time_step)
    tx, ty, tz, x, y, z = unstack(events.jumps)
    known = KnownMotion(
        angular_velocity=events.angular_noise * root,
        velocity=events.linear_noise * root,
        angular_walk=jnp.full_like(root, walk[0]),
        linear_walk=jnp.full_like(root, walk[3]),
        jump=((tx, ty, tz), (x, y, z)) if jumps else None,
    )
    return samples._replace(known=known)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Clairvoyant(KalmanFilter):
    """The Kalman filter that knows everything (`filters.base.Filter`, with input `with_events`).

    Of its `noise` the deviations at the start and the walk of the vectors' biases are used;
    `vector` and `landmark` are 1, and those of `KnownMotion` take the place of the others.
    """

    elementwise = KalmanFilter.elementwise  # a subclass must say so itself (`filters.base`)

    def step(self, state: KalmanState, now: Samples) -> tuple[KalmanState, Record]:
        """One sample: update, propagation by the velocities, and the jump, if there is one."""
        known: KnownMotion = now.known
        noise = self.noise._replace(
            angular_velocity=known.angular_velocity,
            velocity=known.velocity,
            angular_walk=known.angular_walk,
            linear_walk=known.linear_walk,
        )
        updated, found = update(state, now.sample, noise)
        moved = propagate(updated, (), now.sample, noise)
        if known.jump is not None:
            moved = _jumped(moved, now.sample, *known.jump)
        return moved, Record(nis=found.nis, scalars=found.scalars)


def _jumped(state: KalmanState, sample: Sample, turn: Vec3, displacement: Vec3) -> KalmanState:
    """The state after T <- T exp([turn; displacement]^), which is known exactly.

    It is a propagation over an instant with the velocity of the jump, which has no error.
    """
    zero = jnp.zeros_like(sample.time_step)
    silent = KalmanNoise(*(zero for _ in KalmanNoise._fields))
    instant = zero + JUMP_TIME
    during = sample._replace(
        time_step=instant,
        angular_velocity=add(state.estimate.bias_angular, scale(1 / instant, turn)),
        velocity=add(state.estimate.bias_linear, scale(1 / instant, displacement)),
    )
    return propagate(state, (), during, silent)
