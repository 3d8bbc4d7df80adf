"""`posegsa compare`: optimisers at equal budgets on the same scenarios, or on a test function."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array

from posegsa import config, steps
from posegsa.arguments import check_callable, check_number, check_type, check_whole, several
from posegsa.defaults import EVALUATIONS, REPEATS
from posegsa.errors import ConfigError
from posegsa.figures.figure_choice import chosen_figures
from posegsa.judging.comparison import DIGITS, Gradients, OptimiserComparison, Repeat
from posegsa.judging.description import check_kind, kind_of, title_of
from posegsa.optimisers import OPTIMISERS, Optimiser, runner, start
from posegsa.optimisers.functions import ClassicalFunction
from posegsa.progress import shown
from posegsa.runtime import environment
from posegsa.saving.comparison_files import continued, write_comparison, write_searches
from posegsa.saving.folder import locked_folder
from posegsa.search import memory
from posegsa.search.keys import repeat_key
from posegsa.search.population import costs_by_scenario
from posegsa.search.problem import tuning_problem
from posegsa.search.run_search import (
    Found,
    Progress,
    first_search,
    run_search,
    run_timed,
    tell_share,
)
from posegsa.settings.fields import MAX_COUNT

POINTS = 250
"""Number of evenly spaced iterations whose best cost is stored; more early ones are added."""


class Subject(NamedTuple):
    """The problem that every optimiser minimises."""

    title: str
    search: Callable[[Optimiser, Array, Callable[[Progress], object]], Found]
    """Runs one search with a random key, and measures its time."""
    held_out: Callable[[Array], float | None]
    """Cost of a position on held-out scenarios; None for a test function."""


def _filter(experiment: config.Experiment) -> Subject:
    """An experiment's filter. All searches use the same training scenarios."""
    problem = tuning_problem(experiment)

    def search(optimiser: Optimiser, key: Array, tell: Callable[[Progress], object]) -> Found:
        one = problem._replace(experiment=experiment.model_copy(update={"search": optimiser}))
        return run_search(one, tell, search=first_search(one, key))

    def held_out(position: Array) -> float:
        one = jax.tree.map(lambda a: a[None], problem.space.candidate(position))
        return float(np.mean(costs_by_scenario(one, unseen)))

    unseen, count = problem.held_out, experiment.run.training_scenarios
    return Subject(
        f"{title_of(kind_of(experiment))} on {count} training scenarios", search, held_out
    )


def _function(function: ClassicalFunction) -> Subject:
    """A test function; its gradient is computed in reverse mode."""
    box = function.box

    def search(optimiser: Optimiser, key: Array, tell: Callable[[Progress], object]) -> Found:
        run, begin = runner(optimiser, function, box), start(optimiser, box, key)
        return run_timed(run, begin, optimiser.total_iterations, tell)

    return Subject(function.title, search, lambda _: None)


def compare(
    experiment: config.Experiment | str | Path | None = None,
    *,
    optimisers: Iterable[str] = tuple(OPTIMISERS),
    repeats: int = REPEATS,
    evaluations: int = EVALUATIONS,
    function: ClassicalFunction | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    levels: Sequence[float] | None = None,
    figures: Iterable[str] | None = None,
    progress: steps.Listener | None = None,
) -> OptimiserComparison:
    """Run several optimisers repeatedly on one problem, with the same number of evaluations.

    All searches of an experiment use the same training scenarios. The repeats of an optimiser
    differ in their random key; repeat r has the same key for every optimiser. Searches run one
    after the other, because one search already uses the whole machine.

    Args:
        experiment: The problem and the optimisers' settings, or a TOML file; by default the
            recommended experiment. The optimiser of its [search] takes all settings from there,
            every other optimiser only the number of agents.
        optimisers: Names as in search.optimiser. Settings may follow a name after colons, such as
            "gsa:g0=1.0" or "cma_es:agents=20". The others are compared with the first.
        repeats: Searches of each optimiser.
        evaluations: Evaluations of a search, rounded down to whole iterations. A cost with its
            gradient counts as the optimiser's gradient_price.
        function: A test function to minimise instead of the experiment's cost.
        out: Folder for the comparison. The JSON is written after each search, table and figure at
            the end. Searches already stored there, of the same problem, budget and settings, are
            not run again.
        overwrite: Replace a different comparison in that folder.
        levels: Target costs of the table in `out`; by default the optimisers' medians.
        figures: Names of the figures to draw in `out`: "comparison", the default, or none.
        progress: Called with each `steps.Step`. Each search is a part of the step "comparing", and
            `about` names it. Searches stored in the folder count as done.

    Returns:
        The comparison. Optimisers that only the folder had follow the requested ones.

    Raises:
        ConfigError: The experiment, or an optimiser's name or setting, is invalid, or a search
            would need more memory than available.
        ArgumentError: A number is out of range, or an argument has the wrong type.
        RunFolderError: `out` holds a different comparison, can't be used, or another process is
            writing there.
    """
    check_callable("progress", progress)
    drawn = chosen_figures(figures, ["comparison"])
    one = config.as_experiment(experiment)
    if function is None:
        check_kind(one, "compare")
    names = several("optimisers", optimisers, str, "several names")
    if not names:
        raise ConfigError("optimisers: none were given; allowed: at least one")
    if function is not None:
        check_type("function", function, ClassicalFunction)
    if levels is not None:
        levels = several("levels", levels, object, "several numbers")
        for level in levels:
            check_number("levels", level)
    check_whole("repeats", repeats, 1, 10**6)
    check_whole("evaluations", evaluations, 1, 10**12)
    made = {name: specify(one, name, evaluations) for name in names}
    for optimiser in made.values():
        optimiser.check_usable()
        if function is None:
            memory.check([one.model_copy(update={"search": optimiser})])
    # A run in that folder is safe: its files have other names.
    place = nullcontext() if out is None else locked_folder(out, overwrite=True)
    in_dtype = jax.enable_x64(one.run.dtype == "float64")
    with shown(progress), place as folder, in_dtype:
        steps.begin("preparing")
        subject = _filter(one) if function is None else _function(function)
        comparison = OptimiserComparison(
            subject=subject.title,
            budget=evaluations,
            settings=_settings(one, function),
            repeats={name: [] for name in names},
            gradients={name: used for name, each in made.items() if (used := _gradients(each))},
            environment=environment(),
        )
        if folder is not None:
            comparison = continued(comparison, folder, overwrite=overwrite)
        for before, (name, optimiser) in enumerate(made.items()):
            for repeat in range(len(comparison.repeats[name]), repeats):
                done, about = before * repeats + repeat, f"{name} {repeat + 1}/{repeats}"
                steps.begin("comparing", done, len(made) * repeats, about)
                key = repeat_key(one.run.seed, repeat)
                comparison.repeats[name].append(_search(subject, optimiser, key))
                if folder is not None:
                    write_searches(comparison, folder)
        if folder is not None:
            steps.begin("drawing")
            write_comparison(comparison, folder, levels, figure=bool(drawn))
    return comparison


def _settings(experiment: config.Experiment, function: ClassicalFunction | None) -> dict[str, Any]:
    """The settings that searches depend on, without those that `compare` sets or ignores."""
    data = experiment.model_dump(mode="json", exclude={"checkpoint"})
    del data["search"]["iterations"]
    if function is None:
        return data
    return {"function": vars(function), "run": data["run"], "search": data["search"]}


def _gradients(optimiser: Optimiser) -> Gradients | None:
    """How an optimiser uses gradients; None if it does not."""
    before = 0
    for phase in optimiser.phases:
        if phase.wants_gradients:
            return Gradients(phase.evaluations_per_agent, before)
        before += phase.evaluations
    return None


def specify(experiment: config.Experiment, text: str, evaluations: int) -> Optimiser:
    """The optimiser that a text such as "gsa:g0=1.0" describes, limited to a number of evaluations.

    All other settings come from the experiment.

    Raises:
        ConfigError: The name or a setting is invalid, or there are too few evaluations for one
            iteration.
    """
    name, *own = text.split(":")
    if name not in OPTIMISERS:
        raise ConfigError(f"optimiser {name!r} of {text!r}; allowed: {', '.join(OPTIMISERS)}")
    keys = [k for k in OPTIMISERS[name].model_fields if k not in ("optimiser", "iterations")]
    for setting in own:
        key = setting.partition("=")[0].strip()
        if key not in keys:
            raise ConfigError(f"{key!r} of {text!r}; allowed: {', '.join(keys)}")
    # An upper bound: `within` reduces the iterations to what the evaluations allow.
    settings = [f"search.optimiser={name}", f"search.iterations={min(evaluations, MAX_COUNT)}"]
    settings += [f"search.{setting}" for setting in own]
    return config.override(experiment, settings).search.within(evaluations)


def _search(subject: Subject, optimiser: Optimiser, key: Array) -> Repeat:
    stamps = [(0, 0.0)]

    def told(progress: Progress) -> None:
        if progress.iteration > stamps[-1][0]:  # not when it is compiled
            stamps.append((progress.iteration, progress.seconds))
        tell_share(progress)

    search, compile_seconds, seconds = subject.search(optimiser, key, told)
    spent = optimiser.evaluations_spent()
    # Store POINTS evenly spaced iterations, and more early ones.
    even, early = np.linspace(1, len(spent), POINTS), np.geomspace(1, len(spent), POINTS // 4)
    kept = np.unique(np.concatenate([even, early]).round().astype(int)) - 1
    done, since = np.array(stamps).T
    times = np.interp(kept + 1, done, since)
    best = np.asarray(search.history.best, np.float64)[kept]
    return Repeat(
        cost=float(search.best_cost),
        held_out=subject.held_out(search.best_position),
        position=np.asarray(search.best_position, np.float64).tolist(),
        seconds=seconds,
        compile_seconds=compile_seconds,
        non_finite=int(search.non_finite),
        evaluations=spent[kept].tolist(),
        best=[float(f"{c:.{DIGITS}g}") for c in best],
        times=[round(t, 4) for t in times.tolist()],
    )
