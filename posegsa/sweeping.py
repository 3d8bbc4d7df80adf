"""`posegsa sweep`: an experiment with many values and seeds, searched in batches."""

import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from functools import partial
from itertools import product
from numbers import Integral
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from posegsa import config, steps
from posegsa.arguments import MAX_INTEGER, check_callable, check_type, check_whole, refuse, several
from posegsa.defaults import TOGETHER
from posegsa.errors import MemoryLimitError
from posegsa.judging.description import check_kind, describe
from posegsa.judging.sweep_runs import SEED, Sweep, SweepRun, Values, run_name, with_values
from posegsa.progress import shown
from posegsa.runtime import environment
from posegsa.saving.folder import as_path
from posegsa.saving.interrupt import resumable
from posegsa.saving.sweep_folder import in_order, prepare_sweep_folder, write_sweep, write_sweep_run
from posegsa.search import memory
from posegsa.search.population import costs_by_scenario
from posegsa.search.problem import TuningProblem, tuning_problem
from posegsa.search.run_search import (
    Found,
    Progress,
    samples_per_iteration,
    search_batch,
    structure,
)
from posegsa.settings.plain import plain
from posegsa.version import VERSION

MOST_RUNS = 100_000
BATCH_SAMPLES = 50_000_000
"""Maximum samples simulated per iteration of a batch, unless a single run already has more."""


class _Planned(NamedTuple):
    """A run that is still to be searched."""

    values: Values
    seed: int
    experiment: config.Experiment


def sweep(
    experiment: config.Experiment | str | Path | None = None,
    *,
    vary: Mapping[str, Iterable[Any]],
    seeds: int | Iterable[int] = 1,
    out: str | Path | None = None,
    shard: tuple[int, int] = (1, 1),
    together: int = TOGETHER,
    overwrite: bool = False,
    progress: steps.Listener | None = None,
) -> Sweep:
    """Search an experiment with every combination of values, each with several seeds.

    Runs that differ only in numbers are searched in batches: one compiled program runs several
    searches at once, with the same results to the last bit as one by one. The best candidate of
    each run is judged by its cost on the experiment's held-out scenarios.

    Args:
        experiment: An experiment, a TOML file or a name; by default the recommended experiment.
        vary: Values by key, such as `{"filter.gamma": [1, 5, 10]}`, as in `Experiment.replace`. The
            last key varies fastest.
        seeds: The number of seeds, counted from the experiment's own; or a list of seeds.
        out: Folder for the runs. Each is written when its batch is done. Runs already stored there
            are not searched again; runs of further values or seeds are added. At the end tables and
            figures are written there too, unless there are other shards.
        shard: (i, n) searches the i-th of n parts, counted from 1. Parts may run at the same time
            and share a folder; `merge_sweeps` merges folders.
        together: Maximum number of searches in a batch; fewer if memory is short.
        overwrite: Remove a different sweep in that folder.
        progress: Called with each `steps.Step`. Each run is a part of the step "sweeping". Runs
            stored in the folder count as done.

    Returns:
        All runs of this part. With a folder, the runs of all parts stored there.

    Raises:
        ConfigError: A value is invalid, or needs more memory than available.
        ArgumentError: An argument is invalid.
        RunFolderError: The folder holds a different sweep, or can't be written.
        SearchInterrupted: Ctrl-C or SIGTERM, with a folder; a KeyboardInterrupt.
    """
    check_callable("progress", progress)
    check_type("overwrite", overwrite, bool)
    check_whole("together", together, 1)
    base = config.as_experiment(experiment)
    check_kind(base, "sweep")
    mine = _part(_planned(base, vary, seeds), shard)
    if out is None:
        with shown(progress):
            return Sweep(tuple(in_order(_made(base, mine, together))))

    folder = as_path("out", out)
    stored = prepare_sweep_folder(folder, base, list(mine[0].values), overwrite=overwrite)
    names = {run_name(run.experiment) for run in stored}
    missing = [one for one in mine if run_name(one.experiment) not in names]
    made, before = [], len(mine) - len(missing)

    def how() -> str:
        done = f"{before + len(made)} of {len(mine)} runs are in {folder}"
        return f"interrupted; {done}, the same command continues from there"

    with shown(progress), resumable(how):
        for run in _made(base, missing, together, before):
            write_sweep_run(folder, run)
            made.append(run)
        found = Sweep(tuple(in_order([*stored, *made])))
        if shard[1] == 1:
            steps.begin("drawing")
            write_sweep(folder, found)
    return found


def _planned(
    base: config.Experiment, vary: Mapping[str, Iterable[Any]], seeds: int | Iterable[int]
) -> list[_Planned]:
    """Every combination of values and seeds as a checked experiment, without duplicates."""
    check_type("vary", vary, Mapping, allowed="a table of values by key")
    choices = {
        key: several(f"vary[{key!r}]", given, object, "values") for key, given in vary.items()
    }
    if not choices:
        refuse("vary: nothing", 'values by key, such as {"filter.gamma": [1, 5, 10]}')
    for key, values in choices.items():
        if key == SEED:
            refuse(f"vary: {SEED}", "other keys; seeds are given as seeds")
        if not values:
            refuse(f"vary[{key!r}]: none", "at least one value")
    if isinstance(seeds, Integral):
        check_whole("seeds", seeds, 1)
        first = base.run.seed
        chosen = list(range(first, first + int(seeds)))
    else:
        chosen = several("seeds", seeds, object, "a number of seeds, or the seeds")
        if not chosen:
            refuse("seeds: none", "at least one")
    for one in chosen:
        check_whole("seeds", one, 0, MAX_INTEGER)
    count = math.prod(map(len, choices.values())) * len(chosen)
    if count > MOST_RUNS:
        refuse(f"vary: {count} runs", f"at most {MOST_RUNS}")
    planned: dict[str, _Planned] = {}
    for combination in product(*choices.values()):
        values = plain(dict(zip(choices, combination, strict=True)))
        for seed in chosen:
            one = with_values(base, values, int(seed))
            planned.setdefault(run_name(one), _Planned(values, int(seed), one))
    return list(planned.values())


def _part(planned: list[_Planned], shard: tuple[int, int]) -> list[_Planned]:
    """The i-th of n parts of about equal size. Neighbours share programs, so they stay together.

    Raises:
        ArgumentError: There is no such part, or it would be empty.
    """
    allowed = f"(i, n) with 1 <= i <= n <= {len(planned)}, the number of runs"
    check_type("shard", shard, tuple, list, allowed=allowed)
    whole = len(shard) == 2 and all(type(number) is int for number in shard)
    if not (whole and 1 <= shard[0] <= shard[1] <= len(planned)):
        refuse(f"shard = {shard!r}", allowed)
    part, parts = shard
    return planned[len(planned) * (part - 1) // parts : len(planned) * part // parts]


def _made(
    base: config.Experiment, planned: list[_Planned], together: int, before: int = 0
) -> Iterator[SweepRun]:
    """Search runs in batches, and yield those of each finished batch; `before` are done already."""
    done, total, best = before, before + len(planned), math.inf

    def tell(running: float = 0.0, best_cost: float = math.inf) -> None:
        best_cost = min(best, best_cost)
        steps.tell(steps.Step("sweeping", done + running, total, best_cost=best_cost))

    def tell_batch(runs: int, at: Progress) -> None:
        tell(runs * at.iteration / at.iterations, at.best_cost)

    steps.begin("preparing")
    for batch in _batches(planned, together):
        tell()
        runs = len({id(one) for one in batch})
        for run in _search(base, batch, partial(tell_batch, runs)):
            done, best = done + 1, min(best, run.training_cost)
            yield run
    tell()


def _batches(planned: list[_Planned], together: int) -> Iterator[list[_Planned]]:
    """Batches of runs that have the same structure and fit in memory.

    All batches of a structure have the same size, so that one program serves them all. The last
    batch may repeat its last run to reach that size.
    """
    structures: dict[str, Hashable] = {}
    fit: dict[Hashable, int] = {}
    groups: dict[Hashable, list[_Planned]] = {}
    for one in planned:
        key = repr(one.values)
        if key not in structures:  # the seed changes numbers only
            structures[key], most = _structure(one.experiment)
            fit[structures[key]] = most
        groups.setdefault(structures[key], []).append(one)
    for kind, group in groups.items():
        most = min(_within_memory(group, together), fit[kind])
        batches = -(-len(group) // most)
        size = -(-len(group) // batches)
        for first in range(0, len(group), size):
            yield group[first : first + size] + group[-1:] * (first + size - len(group))


def _structure(experiment: config.Experiment) -> tuple[Hashable, int]:
    """The structure that the searches of a batch must share, and the maximum size of the batch.

    All runs of a batch are stored when the last is done, so large runs go in small batches.
    """
    with jax.enable_x64(experiment.run.dtype == "float64"):
        problem = tuning_problem(experiment)
        return structure(problem), max(1, BATCH_SAMPLES // samples_per_iteration(problem))


def _within_memory(group: list[_Planned], together: int) -> int:
    """How many runs of a group fit in memory at once, at least one.

    Raises:
        MemoryLimitError: Not even one fits.
    """
    size = min(together, len(group))
    while True:
        try:
            memory.check(one.experiment for one in group[:size])
            return size
        except MemoryLimitError:
            if size == 1:
                raise
            size = -(-size // 2)


def _search(
    base: config.Experiment, batch: list[_Planned], told: Callable[[Progress], object]
) -> Iterator[SweepRun]:
    """Search a batch, and yield its runs without the repeated ones."""
    first = batch[0].experiment
    with jax.enable_x64(first.run.dtype == "float64"):
        problems = [tuning_problem(one.experiment) for one in batch]
        found = search_batch(problems, told)
        last = None
        for one, problem, each in zip(batch, problems, found, strict=True):
            if one is not last:  # otherwise a repeated run that fills the batch
                yield _judged(base, one, problem, each)
            last = one


def _judged(
    base: config.Experiment, one: _Planned, problem: TuningProblem, found: Found
) -> SweepRun:
    """A finished run: the costs of its best candidate on training and held-out scenarios."""
    candidate = problem.space.candidate(found.search.best_position)
    alone = jax.tree.map(lambda a: a[None], candidate)
    costs = np.asarray(costs_by_scenario(alone, problem.simulated)[:, 0], np.float64)
    costs = np.where(np.isfinite(costs), costs, np.inf)
    count = one.experiment.run.training_scenarios
    return SweepRun(
        base=base,
        values=one.values,
        seed=one.seed,
        training_cost=float(np.mean(costs[:count])),
        held_out_cost=float(np.mean(costs[count:])),
        held_out_worst=float(np.max(costs[count:])),
        diverged=int(np.count_nonzero(np.isinf(costs[count:]))),
        filter=describe(candidate, one.experiment, one.experiment.search.evaluations),
        search_seconds=found.search_seconds,
        environment=environment(),
        version=VERSION,
    )
