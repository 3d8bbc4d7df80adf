"""Checks of a tuned result: its numerical sensitivity, and how its rules are used."""

from dataclasses import dataclass
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from pydantic import Field

from posegsa.filters.rollout import ErrorTrack
from posegsa.judging.metrics import error_tracks, metrics_of
from posegsa.judging.trajectory import Trajectory
from posegsa.model.estimate import FilterState
from posegsa.model.fuzzy import FuzzyController, membership
from posegsa.model.schedules import FuzzyGain
from posegsa.search.candidates import Candidate
from posegsa.search.problem import TuningProblem
from posegsa.settings.arrays import Cost, Numbers

PERTURBATION = 1e-6
"""Change of the initial estimate: about this much per quaternion component, and in [m]."""
SENSITIVE = 0.01
"""Relative difference of costs above which a result counts as sensitive."""
RESOLUTION = 201
"""Grid points along each input for the share where no rule fires."""


@dataclass(frozen=True)
class Trust:
    """Checks of one tuned result on its training scenarios."""

    cost_float32: Cost
    """Mean training cost simulated in float32."""
    cost_float64: Cost
    """The same in float64."""
    cost_perturbed: Cost
    """The same in the experiment's precision, with the initial estimate changed by PERTURBATION."""
    sensitive: bool
    """Whether one of them differs from the experiment's own cost by more than SENSITIVE."""
    uncovered: Annotated[float, Field(ge=0, le=1)] | None
    """Share of all pairs of scaled error and rate for which no rule fires; None without rules."""
    rule_weights: Annotated[np.ndarray, Numbers(5, 5, allow="any")] | None
    """(5, 5) mean firing strength of each rule over a trajectory, [rate, error], VS to VL; NaN if
    the trajectory diverged to NaN. None without rules."""

    @property
    def chaotic(self) -> bool:
        """Whether it is sensitive, other than by costs of which none is finite."""
        costs = (self.cost_float32, self.cost_float64, self.cost_perturbed)
        return self.sensitive and bool(np.isfinite(costs).any())

    @property
    def used_rules(self) -> int:
        """Number of rules that carry at least 1 % of all firing strength; 0 without rules."""
        if self.rule_weights is None:
            return 0
        weights = self.rule_weights
        return int(np.count_nonzero((weights > 0) & (weights >= 0.01 * np.nansum(weights))))


def check(
    problem: TuningProblem,
    tuned: Candidate,
    errors: ErrorTrack,
    trajectory: Trajectory,
    other: float,
) -> Trust:
    """Check the tuned candidate of a problem.

    `errors` are its errors on all scenarios of the problem, `trajectory` is its run on one of them,
    and `other` is its cost in `other_precision`.
    """
    experiment = problem.experiment

    def mean_cost(tracks: ErrorTrack) -> float:
        metrics, _ = metrics_of(tracks, problem.training, problem.cost)
        return float(np.mean(metrics.cost))

    cost = mean_cost(errors.select(slice(experiment.run.training_scenarios)))
    schedule = tuned.gain
    controller = schedule.controller if isinstance(schedule, FuzzyGain) else None
    start = problem.training.initial
    pushed = problem.training._replace(initial=_perturbed(start))
    perturbed = mean_cost(error_tracks(tuned, pushed))
    double = experiment.run.dtype == "float64"
    # A cost that is not finite counts as sensitive: its difference is NaN or infinite.
    steady = all(abs(c - cost) <= SENSITIVE * abs(cost) for c in (other, perturbed))
    return Trust(
        cost_float32=other if double else cost,
        cost_float64=cost if double else other,
        cost_perturbed=perturbed,
        sensitive=not steady,
        uncovered=None if controller is None else uncovered(controller),
        rule_weights=None
        if controller is None
        else rule_weights(controller, trajectory.error, trajectory.rate),
    )


def other_precision(problem: TuningProblem, tuned: Candidate) -> float:
    """Mean training cost of the same measurements, filtered in the other of float32 and float64."""
    dtype = "float32" if problem.experiment.run.dtype == "float64" else "float64"
    own = jax.device_get((tuned, problem.training))

    def cast(a: np.ndarray) -> np.ndarray:
        return a.astype(dtype) if np.issubdtype(a.dtype, np.floating) else a

    with jax.enable_x64(dtype == "float64"):
        candidate, training = jax.tree.map(cast, own)
        # It runs once, on the training scenarios alone.
        tracks = error_tracks(candidate, training, optimised=False)
        metrics, _ = metrics_of(tracks, training, problem.cost)
        return float(np.mean(metrics.cost))


def _perturbed(initial: FilterState) -> FilterState:
    """The initial estimate, turned 2 x PERTURBATION rad about z and moved PERTURBATION m."""
    w, x, y, z = initial.attitude
    p = PERTURBATION
    # To first order; the filter normalises quaternions.
    turned = (w - p * z, x + p * y, y - p * x, z + p * w)
    px, py, pz = initial.place
    return initial._replace(attitude=turned, place=(px + p, py + p, pz + p))


def uncovered(controller: FuzzyController) -> float:
    """Share of a grid over all scaled errors and rates on which no rule fires."""
    axis = np.linspace(0.0, 1.0, RESOLUTION).astype(controller.output_terms.dtype)
    some = np.max(np.asarray(_memberships(controller, axis)), axis=0) > 0
    # Every pair of terms has a rule, so a rule fires where both inputs have a membership > 0.
    return float(1 - np.mean(some) ** 2)


def rule_weights(controller: FuzzyController, error: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Mean firing strength (5, 5) of each rule over inputs (N,), [rate, error]."""
    dtype = controller.output_terms.dtype
    inputs = (np.asarray(each, dtype) for each in (error, rate))
    of_error, of_rate = (np.asarray(_memberships(controller, a), np.float64) for a in inputs)
    return np.mean(np.minimum(of_rate[:, None], of_error[None]), axis=-1)


@jax.jit
def _memberships(controller: FuzzyController, inputs: ArrayLike) -> jax.Array:
    """Memberships (5, N) of inputs (N,) in the input terms."""
    x = jnp.asarray(inputs)
    return jnp.stack([membership(x, term) for term in controller.prepare().inputs])
