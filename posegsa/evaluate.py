"""`posegsa evaluate`: a finished run on many unseen scenarios, beside every baseline."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from posegsa import memory
from posegsa.arguments import check_callable, check_type, check_whole
from posegsa.baselines import (
    oracle,
    search_schedule,
    smooth_box,
    smooth_gain,
)
from posegsa.comparison import (
    CONSTANT,
    ORACLE,
    RANDOM,
    SMOOTH,
    TUNED,
    contender,
    evaluation,
    held_out_keys,
    training_keys,
)
from posegsa.config import override
from posegsa.config.fields import MOST
from posegsa.gain import ConstantGain, FuzzyGain, GainSchedule
from posegsa.keys import keys, scenario_keys
from posegsa.metrics import run
from posegsa.named_optimisers import gsa_of
from posegsa.parameters import parameter_space
from posegsa.population import problem
from posegsa.results import TuneResult
from posegsa.scenario import Scenario, scenario
from posegsa.search import make_ready, run_search

ORACLE_SCENARIOS = 32
"""Scenarios that the oracle is fitted to; none of them is a training or a held-out one."""

Baseline = Callable[[], tuple[GainSchedule, dict[str, Any]]]
"""Finds a schedule, and says what it is."""


def evaluate(
    result: TuneResult,
    *,
    scenarios: int = 1000,
    seed: int | None = None,
    progress: Callable[[str], object] | None = None,
) -> TuneResult:
    """Judge a tuned schedule on unseen scenarios beside all baselines.

    Random search and the smooth schedule are searched on the run's training scenarios with the
    run's number of evaluations; the best constant gain is the run's. The scenarios that judge are
    drawn with keys that no search has seen.

    Args:
        result: A tuned result.
        scenarios: Number of held-out scenarios, at least 2.
        seed: Another held-out set than the run's own.
        progress: Told in words what is done next.

    Returns:
        The result with its evaluation replaced.

    Raises:
        ArgumentError: Fewer than 2 scenarios, or an argument of another type.
        MemoryLimitError: So many scenarios would need more memory than there is.
    """
    check_type("result", result, TuneResult)
    check_whole("scenarios", scenarios, 2, MOST)
    if seed is not None:
        check_whole("seed", seed, 0, 2**31 - 1)
    check_callable("progress", progress)
    experiment = result.experiment
    memory.check([experiment], held_out=scenarios)
    say = progress if progress is not None else lambda _: None
    with jax.enable_x64(experiment.run.dtype == "float64"):
        one = scenario(experiment)
        # All are found, the oracle first, before any is compared.
        found: dict[str, tuple[GainSchedule, dict[str, Any]]] = {}
        for name, find in baselines(result, one).items():
            say(f"searching: {name}")
            found[name] = find()
        found[TUNED] = result.schedule, {"k": result.parameters.tolist()}
        held_out = problem(experiment, one, held_out_keys(experiment, scenarios, seed))
        contenders = {}
        for name in (TUNED, CONSTANT, RANDOM, SMOOTH, ORACLE):
            say(f"judging: {name}")
            schedule, description = found[name]
            contenders[name] = contender(run(schedule, held_out), held_out, description)
        return replace(result, evaluation=evaluation(contenders, held_out, seed))


def baselines(result: TuneResult, one: Scenario) -> dict[str, Baseline]:
    """How to find each baseline of a run, by name."""
    experiment = result.experiment
    space, search = parameter_space(experiment), experiment.search
    training = problem(experiment, one, training_keys(experiment))
    gains, dtype, objective = experiment.parameters.gain_range, training.dtype, experiment.objective
    use = keys(experiment.run.seed)

    def constant() -> tuple[GainSchedule, dict[str, Any]]:
        # The grid's best: with one number to find, a full search ends at the same cost.
        gain = jnp.asarray(result.constant_gain, dtype)
        return ConstantGain(gain), {"gain": result.constant_gain}

    def random() -> tuple[GainSchedule, dict[str, Any]]:
        # By name, because the library of the run's own optimiser may not be installed here.
        task = make_ready(override(experiment, ["search.optimiser=random_search"]))
        best = run_search(task).search.best_position
        controller = space.controller(best)
        return FuzzyGain(controller), {"k": np.asarray(space.vector(controller)).tolist()}

    def smooth() -> tuple[GainSchedule, dict[str, Any]]:
        box = smooth_box(gains, dtype)
        optimiser = gsa_of(experiment, search.iterations)
        found = search_schedule(optimiser, smooth_gain, objective, box, training, use.baselines)
        schedule = smooth_gain(found)
        return schedule, {name: float(value) for name, value in vars(schedule).items()}

    def best_sequence() -> tuple[GainSchedule, dict[str, Any]]:
        keys_of = scenario_keys(use.oracle, ORACLE_SCENARIOS)
        knots, how = oracle(problem(experiment, one, keys_of))
        gain = np.exp(np.asarray(knots.log_gain, np.float64))
        time = np.asarray(knots.time, np.float64)
        return knots, {"time": time.tolist(), "gain": gain.tolist(), **how}

    return {ORACLE: best_sequence, CONSTANT: constant, RANDOM: random, SMOOTH: smooth}
