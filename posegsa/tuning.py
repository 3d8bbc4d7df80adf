"""The main job: a configuration in, a tuned schedule out, judged on noise it has not seen."""

import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jax import Array

from posegsa import config, results
from posegsa.evaluate import judge, keys, run_scenario, scenario_keys
from posegsa.gain import FuzzyGain
from posegsa.optimisers import GSA, Box, Optimiser, RandomSearch, Search, advance, start
from posegsa.parameters import ParameterSpace, parameter_space
from posegsa.population import Problem, population_costs, problem
from posegsa.results import TuneResult
from posegsa.runtime import environment
from posegsa.scenario import scenario

CHUNKS = 50
"""How many times a search reports its progress, at most; results do not depend on it."""


class Progress(NamedTuple):
    """What a progress callback is told."""

    iteration: int
    """Iterations done."""
    iterations: int
    """Iterations in all."""
    best_cost: float
    """Best cost so far; infinite before any finite one."""
    seconds: float
    """Time since the search began, compiling not counted."""


def tune(
    experiment: config.Experiment | str | Path | None = None,
    *,
    seed: int | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: Callable[[Progress], object] | None = None,
) -> TuneResult:
    """Tune a fuzzy gain schedule.

    The whole search, simulations included, is one compiled loop; it is run in chunks only so that
    it can report progress.

    Args:
        experiment: An experiment, or a TOML file; by default the recommended experiment.
        seed: Replaces the experiment's seed.
        out: Folder to write the result to.
        overwrite: Replace another run in that folder.
        progress: Called once when the search is compiled, and after each chunk of iterations.

    Returns:
        The result, with the cost on held-out noise seeds beside the training cost.

    Raises:
        ConfigError: The configuration is not valid.
        RunFolderError: `out` holds a run already, or can't be written; found before the search
        begins.
    """
    if experiment is None:
        experiment = config.Experiment()
    elif not isinstance(experiment, config.Experiment):
        experiment = config.load(experiment)
    if seed is not None:
        experiment = config.override(experiment, [f"run.seed={seed}"])
    if out is not None:
        results.claim(out, overwrite=overwrite)
    with jax.enable_x64(experiment.run.dtype == "float64"):
        result = _tune(experiment, progress)
    if out is not None:
        result.save(out, overwrite=True)
    return result


def _tune(
    experiment: config.Experiment, progress: Callable[[Progress], object] | None
) -> TuneResult:
    use = keys(experiment.run.seed)
    one = scenario(experiment)
    training = problem(
        experiment, one, scenario_keys(use.training, experiment.run.training_scenarios)
    )
    space = parameter_space(experiment)
    optimiser = make_optimiser(experiment)

    begun = time.perf_counter()
    search = start(optimiser, Box(space.lower, space.upper), use.search)
    # No iterations yet: this compiles, unless a search of this structure has run in this process.
    search = jax.block_until_ready(_advance(optimiser, search, training, space, 0))
    compiled = time.perf_counter()
    if progress is not None:
        progress(Progress(0, optimiser.iterations, math.inf, 0.0))
    chunk = -(-optimiser.iterations // CHUNKS)
    for done in range(0, optimiser.iterations, chunk):
        stop = min(done + chunk, optimiser.iterations)
        search = jax.block_until_ready(_advance(optimiser, search, training, space, stop))
        if progress is not None:
            seconds = time.perf_counter() - compiled
            progress(Progress(stop, optimiser.iterations, float(search.best_cost), seconds))
    finished = time.perf_counter()

    controller = space.controller(search.best_position)
    schedule = FuzzyGain(controller)
    return TuneResult(
        experiment=experiment,
        best_cost=float(search.best_cost),
        parameters=np.asarray(space.vector(controller), np.float64),
        judged=judge(schedule, one, experiment),
        evaluations=optimiser.agents * optimiser.iterations,
        non_finite=int(search.non_finite),
        compile_seconds=compiled - begun,
        search_seconds=finished - compiled,
        history=jax.tree.map(np.asarray, search.history),
        trajectory=run_scenario(schedule, one, experiment, scenario_keys(use.held_out, 1)[0]),
        environment=environment(),
        version=results.VERSION,
    )


@partial(jax.jit, static_argnums=0)
def _advance(
    optimiser: Optimiser, search: Search, training: Problem, space: ParameterSpace, stop: Array
) -> Search:
    """Run the search on to iteration `stop`, one compiled loop over iterations, agents and time."""

    def objective(vectors: Array) -> Array:
        return population_costs(vectors, training, space)

    return advance(optimiser, objective, Box(space.lower, space.upper), search, stop)


def make_optimiser(experiment: config.Experiment) -> Optimiser:
    """The optimiser that an experiment configures."""
    search = experiment.search
    if search.optimiser == "random_search":
        return RandomSearch(search.agents, search.iterations)
    return GSA(search.agents, search.iterations, **experiment.gsa.model_dump())
