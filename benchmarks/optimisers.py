"""Compare optimisers at equal budgets on the observer's experiment and on test functions.

    python benchmarks/optimisers.py filter --optimisers gsa,pso --repeats 10
    python benchmarks/optimisers.py variants --repeats 10
    python benchmarks/optimisers.py functions --functions sphere,ackley
    python benchmarks/optimisers.py scenarios --repeats 3
    python benchmarks/optimisers.py speed
    python benchmarks/optimisers.py write
    python benchmarks/optimisers.py list

Every call adds missing results to a folder (`--folder`), so that a long comparison can be made in
parts. `speed` measures the time of the optimisers' own steps. `write` writes the results of the
folder to docs/optimisers_results.md, benchmarks/optimisers.json and two figures. `list` writes the
list of optimisers in docs/optimisers.md from their classes. `--quick` makes everything small, uses
another folder, and writes nothing.
"""

import argparse
import json
import time
import warnings
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from readme import ROOT, write_block
from tqdm import tqdm

import posegsa
from posegsa import config
from posegsa.comparing import compare, specify
from posegsa.figures.comparison_figures import plot_comparison
from posegsa.figures.style import png
from posegsa.judging.comparison import OptimiserComparison
from posegsa.model.schedules import FuzzyGain
from posegsa.optimisers import OPTIMISERS, Optimiser, minimise
from posegsa.optimisers.functions import ClassicalFunction
from posegsa.runtime import environment
from posegsa.saving.comparison_files import load_comparison
from posegsa.search.candidates import Candidate
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import keys, scenario_keys
from posegsa.search.population import costs_by_scenario
from posegsa.search.problem import tuning_problem
from posegsa.search.run_search import run_search

BEST = "de:strategy=best/1/bin"
FILTER = ("gsa", "random_search", "pso", "de", BEST, "cma_es", "adam", "gsa+adam")
VARIANTS = (
    *("gsa", "gsa:alpha=5.0", "gsa:g0=10.0", "gsa:g0=1.0"),
    *("gsa:final_percent=20.0", "gsa:final_percent=100.0", "gsa:force_power=2.0"),
)
"""GSA with a slower decay, weaker forces, more attracting agents at the end, or the paper's D^2."""
ON_FUNCTIONS = ("gsa", "gsa:g0=0.5", "random_search", "pso", "de", BEST, "cma_es", "adam")
DIMENSIONS = 30
FUNCTIONS = (
    ClassicalFunction("sphere", DIMENSIONS),
    ClassicalFunction("sphere", DIMENSIONS, shift=0.5),
    ClassicalFunction("ackley", DIMENSIONS),
    ClassicalFunction("rastrigin", DIMENSIONS),
    ClassicalFunction("rastrigin", DIMENSIONS, shift=0.5, rotation=1),
    ClassicalFunction("rosenbrock", DIMENSIONS),
)
SPENT = (
    *(("gsa", 8), ("pso", 8), (BEST, 8)),
    *(("gsa", 32), ("pso", 32), (BEST, 32), ("cma_es:agents=20", 32)),
)
"""Optimisers and numbers of training scenarios, with the same number of simulations."""
VALIDATION_SCENARIOS = 64
AGENTS, ITERATIONS = 50, 1000
"""Agents and iterations of a search on a test function, as in Rashedi's article."""
PAGE, RESULTS = "docs/optimisers.md", "docs/optimisers_results.md"
JSON, FIGURE, FUNCTION_FIGURE = (
    ROOT / "benchmarks" / name
    for name in ("optimisers.json", "optimisers.png", "optimisers_functions.png")
)


def on_filter(options: argparse.Namespace) -> None:
    """Compare on the observer's experiment."""
    _on_filter(options, FILTER, options.folder / "recommended")


def variants(options: argparse.Namespace) -> None:
    """Compare settings of GSA on the observer's experiment."""
    _on_filter(options, VARIANTS, options.folder / "variants")


def _on_filter(options: argparse.Namespace, usual: Sequence[str], out: Path) -> None:
    experiment = config.load(ROOT / "configs" / "observer.toml")
    evaluations, repeats = 25000, options.repeats
    if options.quick:
        settings = ["run.training_scenarios=1", "run.held_out_scenarios=4", "filter.substeps=1"]
        experiment, evaluations, repeats = config.override(experiment, settings), 800, 2
    found = compare(
        experiment,
        optimisers=options.optimisers or usual,
        repeats=repeats,
        evaluations=evaluations,
        out=out,
    )
    print(found.table())


def on_functions(options: argparse.Namespace) -> None:
    """Compare on the test functions."""
    repeats, iterations = (2, 20) if options.quick else (options.repeats, ITERATIONS)
    experiment = config.override(config.Experiment(), [f"search.agents={AGENTS}"])
    chosen = [f for f in FUNCTIONS if not options.functions or f.name in options.functions]
    for function in tqdm(chosen, desc="functions"):
        found = compare(
            experiment,
            optimisers=options.optimisers or ON_FUNCTIONS,
            repeats=repeats,
            evaluations=AGENTS * iterations,
            function=function,
            out=options.folder / name_of(function),
        )
        tqdm.write(found.table())


def name_of(function: ClassicalFunction) -> str:
    """The name of a function's folder."""
    turned = "" if function.rotation is None else "-rotated"
    return f"{function.name}{'-shifted' if function.shift else ''}{turned}"


def scenarios(options: argparse.Namespace) -> None:
    """Few or many training scenarios for the same number of simulations, on several sets."""
    path = options.folder / "scenarios.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    held = json.loads(path.read_text()) if path.exists() else {}
    for seed in range(1, options.repeats + 1):
        for name, count in SPENT:
            if f"{name} {count} {seed}" in held:
                continue
            simulations = (50 if options.quick else 25000) * 8
            settings = [f"run.training_scenarios={count}", f"run.seed={seed}"]
            experiment = config.override(config.Experiment(), settings)
            search = specify(experiment, name, max(100, simulations // count))
            task = tuning_problem(experiment.model_copy(update={"search": search}))
            found = run_search(task).search
            # All use the same validation scenarios; held-out scenarios are not used.
            key = scenario_keys(keys(0).validation, VALIDATION_SCENARIOS)
            controller = task.space.schedules.controller(found.best_position)
            one = Candidate(FuzzyGain(jax.tree.map(lambda a: a[None], controller)))
            costs = costs_by_scenario(one, scenario_batch(experiment, key))
            held[f"{name} {count} {seed}"] = float(found.best_cost), float(np.mean(costs))
            print(seed, name, count, *held[f"{name} {count} {seed}"], flush=True)
            path.write_text(json.dumps(held) + "\n")


def scenarios_table(path: Path) -> str:
    """Validation costs by optimiser and number of training scenarios."""
    held = json.loads(path.read_text())
    seeds = sorted({int(key.split()[-1]) for key in held})
    # Only sets that all have searched; an interrupted run leaves others.
    seeds = [s for s in seeds if all(f"{name} {count} {s}" in held for name, count in SPENT)]
    head = " | ".join(f"set {seed}" for seed in seeds)
    lines = [
        f"| optimiser | training scenarios | evaluations | validation cost: {head} |",
        "|" + " --- |" * (3 + len(seeds)),
    ]
    for name, count in SPENT:
        costs = " | ".join(f"{held[f'{name} {count} {seed}'][1]:.2f}" for seed in seeds)
        lines.append(f"| {name} | {count} | {25000 * 8 // count} | {costs} |")
    return "\n".join(
        [
            *lines,
            "",
            f"One search for each set of training scenarios; mean cost on {VALIDATION_SCENARIOS} "
            "validation scenarios, the same for all.",
        ]
    )


def speed(options: argparse.Namespace) -> None:
    """Time of each optimiser's own step: 100 agents, 22 dimensions, the sum as objective."""
    seconds = {}
    for name in FILTER[:-1]:
        optimiser = specify(config.Experiment(), name, 2000 if options.quick else 25000)
        seconds[name] = step_seconds(optimiser)
        print(f"{name:<24}{1e6 * seconds[name]:10.1f} us an iteration")
    path = options.folder / "speed.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"seconds": seconds, "environment": environment()}) + "\n")


def step_seconds(optimiser: Optimiser) -> float:
    """Seconds per iteration, the smallest of ten searches."""
    where, key = posegsa.box(np.zeros(22), np.ones(22)), jax.random.key(0)
    times = []
    for _ in range(11):  # the first one compiles
        started = time.perf_counter()
        jax.block_until_ready(minimise(add_up, where, optimiser, key).best_cost)
        times.append(time.perf_counter() - started)
    return min(times[1:]) / optimiser.total_iterations


def add_up(x: jax.Array) -> jax.Array:
    """A cheap objective: the sum of the coordinates."""
    return jnp.sum(x, axis=1)


def function_table(comparisons: Sequence[OptimiserComparison]) -> str:
    """Median final costs: functions as rows, optimisers as columns."""
    names = list(comparisons[0].repeats)
    lines = [f"| function | {' | '.join(names)} |", "|" + " --- |" * (len(names) + 1)]
    for found in comparisons:
        medians = [float(np.median(found.costs(name))) for name in names]
        cells = [f"**{m:.2g}**" if m == min(medians) else f"{m:.2g}" for m in medians]
        title = found.subject.replace(f", {DIMENSIONS} dimensions", "")
        lines.append(f"| {title} | {' | '.join(cells)} |")
    counted = comparisons[0]
    repeats = len(next(iter(counted.repeats.values())))
    return "\n".join(
        [
            *lines,
            "",
            f"Median of the best cost over {repeats} repeats of {counted.budget} evaluations "
            f"({AGENTS} agents), {DIMENSIONS} dimensions, float32; the least of a row in bold. 0 "
            "is less than float32 resolves about the minimum.",
        ]
    )


def speed_table(path: Path) -> str:
    """Time of an iteration of each optimiser alone."""
    data = json.loads(path.read_text())
    lines = ["| optimiser | an iteration by itself [us] |", "| --- | --- |"]
    for name, seconds in data["seconds"].items():
        lines.append(f"| {name} | {1e6 * seconds:.0f} |")
    machine = data["environment"]
    return "\n".join(
        [
            *lines,
            "",
            "100 agents (adam: 8 starts, gradients by reverse mode), 22 dimensions, an objective "
            "that only adds up. The least of ten searches, by iteration. "
            f"{machine['device']}, jax {machine['jax']}.",
        ]
    )


def summary(found: OptimiserComparison) -> dict:
    """The numbers behind a table and a figure."""
    optimisers = {}
    for name in found.repeats:
        evaluations, bands = found.bands(name)
        kept = np.unique(np.geomspace(1, len(evaluations), 40).round().astype(int)) - 1
        costs, unseen = found.costs(name), found.costs(name, held_out=True)
        optimisers[name] = {
            "costs": costs.tolist(),
            "held_out": unseen.tolist() if found.has_held_out else None,
            "seconds": [r.seconds for r in found.repeats[name]],
            "gradient_seconds": found.gradient_seconds(name) if name in found.gradients else None,
            "evaluations": evaluations[kept].tolist(),
            "quartiles": [[float(f"{c:.6g}") for c in band[kept]] for band in bands],
        }
    return {
        "subject": found.subject,
        "budget": found.budget,
        "environment": found.environment,
        "optimisers": optimisers,
    }


def registered() -> str:
    """The optimisers, each with its settings."""
    lines = ["| `search.optimiser` | class | | settings |", "| --- | --- | --- | --- |"]
    for name, kind in OPTIMISERS.items():
        what = (kind.__doc__ or "").partition("\n")[0].rstrip(".")
        settings = ", ".join(f"`{key}`" for key in kind.model_fields if key != "optimiser")
        lines.append(f"| `{name}` | `{kind.__name__}` | {what} | {settings} |")
    return "\n".join(lines)


def write_list(options: argparse.Namespace) -> None:
    """Write the page's list of optimisers."""
    del options
    write_block("optimisers", registered(), PAGE)


def write(options: argparse.Namespace) -> None:
    """Write the page, JSON and figures from the results in the folder."""
    held = load_comparison(options.folder / "recommended")
    held = held.only([name for name in FILTER if held.repeats.get(name)])
    folders = [options.folder / name_of(function) for function in FUNCTIONS]
    functions = [load_comparison(folder) for folder in folders if folder.exists()]
    functions = [found.only([n for n in ON_FUNCTIONS if n in found.repeats]) for found in functions]
    functions = [found for found in functions if all(found.repeats.values())]  # complete ones only
    write_block("comparison", held.markdown(), RESULTS)
    if (options.folder / "variants").exists():
        of_gsa = load_comparison(options.folder / "variants").only(VARIANTS)
        write_block("variants", of_gsa.markdown(), RESULTS)
    write_block("functions", function_table(functions), RESULTS)
    if (options.folder / "scenarios.json").exists():
        write_block("scenarios", scenarios_table(options.folder / "scenarios.json"), RESULTS)
    write_block("speed", speed_table(options.folder / "speed.json"), RESULTS)
    data = {"recommended": summary(held), "functions": [summary(found) for found in functions]}
    JSON.write_text(json.dumps(data) + "\n", encoding="utf-8")
    FIGURE.write_bytes(png(plot_comparison(held)))
    FUNCTION_FIGURE.write_bytes(png(plot_comparison(*functions)))
    print(f"Written: {RESULTS}, {JSON}, {FIGURE}, {FUNCTION_FIGURE}")


def names(text: str) -> list[str]:
    """Split names separated by commas."""
    return [word for word in text.split(",") if word]


def main() -> None:
    parser = argparse.ArgumentParser(description="Optimisers at equal budgets, and their speed.")
    parts = {
        "filter": on_filter,
        "variants": variants,
        "functions": on_functions,
        "scenarios": scenarios,
        "speed": speed,
        "write": write,
        "list": write_list,
    }
    parser.add_argument("part", choices=parts)
    parser.add_argument("--folder", type=Path, default=ROOT / "runs" / "optimisers")
    parser.add_argument("--optimisers", type=names, help="some of them; by default all")
    parser.add_argument("--functions", type=names, help="some of them; by default all")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    if options.quick:
        options.folder = options.folder.with_name(options.folder.name + "-quick")
    warnings.simplefilter("ignore", posegsa.PosegsaWarning)
    posegsa.enable_fast_path()
    if options.part in ("write", "list") and options.quick:
        parser.error(f"{options.part}: allowed without --quick only")
    parts[options.part](options)


if __name__ == "__main__":
    main()
