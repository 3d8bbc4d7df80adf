"""A search over the numbers of the attitude filter for inertial sensors.

The filter's vectors are computed in NumPy before it runs (`recordings.imu`) and depend on the
numbers of [vectors]. So each candidate prepares its recordings again, and the objective is an
ordinary function, not a compiled one: it takes a second per candidate on a few minutes of motion.
"""

import time
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import jax
import numpy as np

from posegsa import steps
from posegsa.config.imu import ImuConfig, ImuVectorsConfig
from posegsa.optimisers import box, minimise
from posegsa.optimisers.loop import Search
from posegsa.recordings.accuracy import recording_errors
from posegsa.recordings.imu import ImuRecording, with_vectors
from posegsa.recordings.imu_filter import run_imu


class FoundImu(NamedTuple):
    """The result of a search."""

    config: ImuConfig
    """The filter with the best numbers; the given ones if the search found none better."""
    cost: float
    """Cost of `config`: the mean over recordings of the total RMSE [deg]."""
    cost_before: float
    """Cost of the given numbers [deg]."""
    evaluations: int
    seconds: float


def search_imu(config: ImuConfig, recordings: Sequence[ImuRecording], seed: int) -> FoundImu:
    """Search the numbers that a filter's `parameters.also` names.

    Args:
        config: The filter, the numbers to search and the optimiser.
        recordings: At least one, each with a truth.
        seed: Seed of the search.
    """
    lower, upper = (np.array([getattr(one, end) for one in config.also]) for end in _ENDS)
    by_logarithm = np.array([one.scale == "logarithmic" for one in config.also])

    @lru_cache(maxsize=1)  # computed once if the search does not change [vectors]
    def made(vectors: ImuVectorsConfig) -> list[ImuRecording]:
        return [with_vectors(one, vectors) for one in recordings]

    def cost(candidate: ImuConfig) -> float:
        each = made(candidate.vectors)  # type: ignore[arg-type]  # frozen, so it has a hash
        found = [recording_errors(run_imu(one, candidate), one) for one in each]
        return float(np.mean([errors.rmse()["judged"].total for errors in found]))

    def candidate(position: np.ndarray) -> ImuConfig:
        numbers = np.where(by_logarithm, np.exp(np.where(by_logarithm, position, 0.0)), position)
        numbers = np.clip(numbers, lower, upper)  # rounding may have passed a bound
        keys = (one.key for one in config.also)
        return config.with_numbers(dict(zip(keys, numbers.tolist(), strict=True)))

    def costs(positions: np.ndarray) -> np.ndarray:
        return np.array([cost(candidate(each)) for each in positions.astype(float)])

    begun, iterations = time.monotonic(), config.search.total_iterations

    def tell(iteration: int, best: float) -> None:
        steps.tell(steps.Step("searching", iteration, iterations, best_cost=best))

    def after(search: Search) -> None:
        tell(int(search.iteration), min(before, float(search.best_cost)))

    before = cost(config)
    tell(0, before)
    ends = (
        np.where(by_logarithm, np.log(np.where(by_logarithm, a, 1.0)), a) for a in (lower, upper)
    )
    search = minimise(
        costs,
        box(*ends),
        config.search,
        jax.random.key(seed),
        chunk=1,
        callback=after,
        python_objective=True,
    )
    better = float(search.best_cost) < before
    return FoundImu(
        config=candidate(np.asarray(search.best_position, float)) if better else config,
        cost=min(before, float(search.best_cost)),
        cost_before=before,
        evaluations=config.search.evaluations,
        seconds=time.monotonic() - begun,
    )


_ENDS = "lower", "upper"
