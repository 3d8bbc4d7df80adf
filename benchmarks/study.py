"""How the recommended configuration was chosen: one change at a time, judged on validation.

Each variant is tuned on its training scenarios and costed on validation scenarios, whose keys are
neither the training nor the held-out ones; the held-out scenarios are not read here. The best
constant gain on the same training scenarios stands beside it.

    python benchmarks/study.py [--iterations 60] [--seeds 2] [--write]
"""

import argparse
import warnings

import jax
import numpy as np
from readme import write_block
from tqdm import tqdm

import posegsa
from posegsa import config
from posegsa.judging.baselines import best_constant
from posegsa.model.schedules import ConstantGain, FuzzyGain, GainSchedule
from posegsa.search.build import scenario_batch, tuning_problem
from posegsa.search.keys import keys, scenario_keys
from posegsa.search.population import ScenarioBatch, costs_by_scenario
from posegsa.search.run import run_search

VALIDATION_SCENARIOS = 64

# Each group changes one thing of the recommended experiment.
GROUPS: dict[str, tuple[tuple[str, ...], ...]] = {
    "recommended": ((),),
    "smoothing [s]": tuple((f"gain.smoothing={s}",) for s in (0.0, 0.5, 1.0, 1.5, 3.0, 4.0)),
    "gamma [1/s^2]": tuple((f"filter.gamma={g}",) for g in (2.0, 5.0, 10.0, 20.0)),
    "gamma, Omega and V [1/s^2]": tuple(
        (f"filter.gamma={g}",) for g in ([2.0, 10.0], [10.0, 5.0], [5.0, 20.0])
    ),
    "sub-steps": tuple((f"filter.substeps={n}",) for n in (1, 4)),
    "gain limit": tuple((f"filter.gain_limit={c}",) for c in (1.0, 1.9)),
    "error scale": tuple((f"gain.error_scale={s}",) for s in (0.5, 2.0)),
    "rate scale": tuple((f"gain.rate_scale={s}",) for s in (0.0, 30.0)),
    "training scenarios": tuple((f"run.training_scenarios={n}",) for n in (1, 4, 16)),
    "objective": (("objective.name=cvar",), ("objective.name=mean_std",)),
    "signal": (("gain.signal=pose",),),
    "before: no smoothing, gamma 5": (("gain.smoothing=0.0", "filter.gamma=5.0"),),
}


def mean_cost(schedule: GainSchedule, scenarios: ScenarioBatch) -> float:
    """Mean cost of one schedule."""
    return float(np.mean(costs_by_scenario(jax.tree.map(lambda a: a[None], schedule), scenarios)))


def judge(experiment: config.Experiment) -> tuple[float, float, float]:
    """Training and validation cost of the tuned schedule, validation cost of the best constant."""
    task = tuning_problem(experiment)
    found = run_search(task)
    key = keys(experiment.run.seed).validation
    validation = scenario_batch(experiment, task.scenario, scenario_keys(key, VALIDATION_SCENARIOS))
    tuned = FuzzyGain(task.space.schedules.controller(found.search.best_position))
    constant: ConstantGain = best_constant(
        task.training, experiment.parameters.gain_range, experiment.objective
    )
    return (
        mean_cost(tuned, task.training),
        mean_cost(tuned, validation),
        mean_cost(constant, validation),
    )


def table(iterations: int, seeds: int) -> str:
    """The study as a Markdown table."""
    lines = [
        "| changed | to | training | validation | best constant, validation |",
        "| --- | --- | --- | --- | --- |",
    ]
    variants = [(group, change) for group, changes in GROUPS.items() for change in changes]
    for group, change in tqdm(variants, desc="variants"):
        rows = [
            judge(
                config.override(
                    config.Experiment(),
                    [*change, f"run.seed={seed}", f"search.iterations={iterations}"],
                )
            )
            for seed in range(seeds)
        ]
        training, validation, constant = np.mean(rows, axis=0)
        to = ", ".join(c.split("=")[1] for c in change) or "-"
        lines.append(f"| {group} | {to} | {training:.2f} | {validation:.2f} | {constant:.2f} |")
    lines += [
        "",
        f"Mean over {seeds} seeds, {iterations} iterations of 100 agents each, "
        f"{VALIDATION_SCENARIOS} validation scenarios; held-out ones were not read. Made by "
        f"`python benchmarks/study.py --iterations {iterations} --seeds {seeds} --write`.",
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="Study behind the recommended configuration.")
    parser.add_argument("--iterations", type=int, default=60, help="iterations of each search")
    parser.add_argument("--seeds", type=int, default=2, help="searches for each variant")
    parser.add_argument("--write", action="store_true", help="write the table into docs/")
    options = parser.parse_args()
    warnings.simplefilter("ignore", posegsa.PosegsaWarning)
    posegsa.enable_fast_path()
    text = table(options.iterations, options.seeds)
    print(text)
    if options.write:
        write_block("study", text, "docs/recommended.md")


if __name__ == "__main__":
    main()
