"""The paper's cost: transient plus steady-state error, as sums over samples."""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa.config import CostConfig, ObjectiveConfig


class CostWeights(NamedTuple):
    """The cost as a weighted sum over samples, so that it can be run up inside the simulation."""

    transient: Array
    """(N,) 0.3 inside the transient window, else 0 (0.3 as configured)."""
    steady: Array
    """(N,) 1 inside the steady-state window, else 0 (1 as configured)."""
    window: Array
    """(N,) whether a sample lies inside the steady-state window, also where that has no weight."""
    position: Array
    """Weight of the position error beside the attitude error [1/m], 0.2 in the paper."""


class CostParts(NamedTuple):
    """The two weighted parts of the cost C = 0.3 e_tr + e_ss (the paper's Eq. for C_j)."""

    transient: Array
    steady: Array

    @property
    def total(self) -> Array:
        """C."""
        return self.transient + self.steady


def cost_weights(cost: CostConfig, samples: int, dtype: jnp.dtype) -> CostWeights:
    """Weights of the configured cost for N = `samples` samples; windows include both ends."""
    k = np.arange(samples)

    def inside(ends: tuple[int, int]) -> np.ndarray:
        return (k >= ends[0]) & (k <= ends[1])

    transient, steady = inside(cost.transient_window), inside(cost.steady_window)
    return CostWeights(
        transient=jnp.asarray(np.where(transient, cost.transient_weight, 0.0).astype(dtype)),
        steady=jnp.asarray(np.where(steady, cost.steady_weight, 0.0).astype(dtype)),
        window=jnp.asarray(steady),
        position=jnp.asarray(cost.position_weight, dtype),
    )


def over_scenarios(costs: Array, objective: ObjectiveConfig) -> Array:
    """One cost for each agent from its costs on S scenarios.

    Args:
        costs: (S, ...) costs; a NaN or infinity on any scenario makes the result not finite.
        objective: "mean", "median", "worst"; "cvar": the mean of the ceil((1 - level) S) worst
            (Rockafellar and Uryasev 2000, on equally likely scenarios); "mean_std": the mean plus
            factor times the standard deviation.

    Returns:
        Costs (...).
    """
    mean = jnp.mean(costs, axis=0)
    match objective.name:
        case "mean":
            return mean
        case "median":
            # A median would forgive scenarios that diverge: the objective may not.
            return jnp.where(jnp.isfinite(mean), jnp.median(costs, axis=0), mean)
        case "worst":
            return jnp.max(costs, axis=0)
        case "cvar":
            worst = max(1, math.ceil((1 - objective.level) * costs.shape[0] - 1e-9))
            return jnp.mean(jnp.sort(costs, axis=0)[-worst:], axis=0)
        case "mean_std":
            return mean + objective.factor * jnp.std(costs, axis=0)


def sample_error(attitude: Array, position: Array, weights: CostWeights) -> Array:
    """||R_err||_I + 0.2 ||P_err||, the summand of both parts."""
    return attitude + weights.position * position


def trajectory_cost(attitude: Array, position: Array, weights: CostWeights) -> CostParts:
    """Cost of errors over time.

    Args:
        attitude: (..., N) ||R_err||_I in [0, 1].
        position: (..., N) ||P_err|| [m].
        weights: for N samples.
    """
    error = sample_error(attitude, position, weights)

    def total(weight: Array) -> Array:
        return jnp.einsum("...n,n->...", error, weight, precision="highest")

    return CostParts(total(weights.transient), total(weights.steady))
