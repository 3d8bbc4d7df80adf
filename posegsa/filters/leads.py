"""Measured velocities, extrapolated to the middle of the step that they drive.

A filter moves its pose over a time step by one velocity. That fits a velocity that is the mean over
the step. One that was measured at its time stamp belongs to the beginning of the step, and moves
the pose half a step late: 0.3 deg at 1 rad/s and 100 Hz. One that comes L seconds late, or is the
mean over the step before, is later still. So each velocity is extrapolated linearly,

    w_k + lead (w_k - w_k-1) min(1, dt_k / dt_k-1),

with lead = 1/2 for a velocity at its stamp (the Adams-Bashforth method of second order), 1 for the
mean over the step before, and L / dt more for a delay. Over many steps the extrapolations cancel
except for the last: the pose gets the additional noise of `lead` samples once, not at each sample.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from posegsa.model.elementwise import choose, minimum
from posegsa.model.sample import Sample
from posegsa.model.se3 import Vec3, add, scale, subtract


class Leads(NamedTuple):
    """How far velocities are extrapolated, in time steps; traced."""

    angular: Array
    """Of the angular velocity."""
    linear: Array
    """Of the linear velocity."""


LEAD_KEYS = tuple(f"{name}_lead" for name in Leads._fields)
"""The keys of these numbers in a configuration."""


class LastSample(NamedTuple):
    """The velocities of the last sample."""

    angular: Vec3
    """[rad/s]."""
    linear: Vec3
    """[m/s]."""
    time_step: Array
    """Time from the last sample to this one [s]; 0 before the first."""


def no_sample(like: Array) -> LastSample:
    """The record before the first sample, in the shape and dtype of an array."""
    zero = jnp.zeros_like(like)
    return LastSample((zero, zero, zero), (zero, zero, zero), zero)


def extrapolated(sample: Sample, last: LastSample, leads: Leads) -> tuple[Sample, LastSample]:
    """A sample with its velocities extrapolated, and the record that the next sample needs.

    The first sample, which has no predecessor, is left unchanged.
    """
    known = last.time_step > 0
    before = choose(known, last.time_step, jnp.ones_like(last.time_step))
    share = choose(known, minimum(sample.time_step / before, 1.0), jnp.zeros_like(before))

    def ahead(lead: Array, now: Vec3, then: Vec3) -> Vec3:
        return add(now, scale(lead * share, subtract(now, then)))

    angular = ahead(leads.angular, sample.angular_velocity, last.angular)
    linear = ahead(leads.linear, sample.velocity, last.linear)
    after = LastSample(sample.angular_velocity, sample.velocity, sample.time_step)
    return sample._replace(angular_velocity=angular, velocity=linear), after
