"""Training against held-out cost as a function of the number of training scenarios: a figure.

    python benchmarks/generalisation.py [--seeds 5]

Writes benchmarks/generalisation.png, which the README shows, and prints the numbers.
"""

import argparse
import warnings
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

import posegsa
from posegsa import config
from posegsa.judging.evaluation import CONSTANT, TUNED

NUMBERS = (1, 2, 4, 8, 16)
FIGURE = Path(__file__).parent / "generalisation.png"


def draw(costs: dict[str, np.ndarray]) -> Figure:
    """The figure of costs (numbers of scenarios, seeds), by name."""
    figure = Figure(figsize=(6.5, 3.6), layout="constrained")
    axes = figure.subplots()
    for (name, values), style in zip(costs.items(), ("o--", "s-", "^:"), strict=True):
        middle = np.median(values, axis=1)
        low, high = values.min(axis=1), values.max(axis=1)
        axes.errorbar(
            NUMBERS, middle, yerr=(middle - low, high - middle), fmt=style, capsize=3, label=name
        )
    axes.set_xscale("log", base=2)
    axes.set_xticks(NUMBERS, [str(n) for n in NUMBERS])
    axes.set(xlabel="Training scenarios [-]", ylabel="Cost [-]")
    axes.legend(frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description="Generalisation gap of the recommended search.")
    parser.add_argument("--seeds", type=int, default=5, help="searches for each number")
    parser.add_argument("--iterations", type=int, default=250, help="iterations of each search")
    options = parser.parse_args()
    warnings.simplefilter("ignore", posegsa.PosegsaWarning)
    posegsa.enable_fast_path()
    shape = (len(NUMBERS), options.seeds)
    costs = {
        "tuned, training": np.zeros(shape),
        "tuned, held out": np.zeros(shape),
        "best constant gain, held out": np.zeros(shape),
    }
    for i, number in enumerate(tqdm(NUMBERS, desc="training scenarios")):
        settings = [f"run.training_scenarios={number}", f"search.iterations={options.iterations}"]
        experiment = config.override(config.Experiment(), settings)
        for j, result in enumerate(
            posegsa.tune_batch(experiment, seeds=range(options.seeds)).results
        ):
            found = (
                float(np.mean(result.training_costs)),
                result.evaluation.cost(TUNED).mean,
                result.evaluation.cost(CONSTANT).mean,
            )
            for values, cost in zip(costs.values(), found, strict=True):
                values[i, j] = cost
    draw(costs).savefig(FIGURE, dpi=200)
    print(f"{'training scenarios':<32}" + "".join(f"{n:>8}" for n in NUMBERS))
    for name, values in costs.items():
        print(f"{name:<32}" + "".join(f"{c:>8.2f}" for c in np.median(values, axis=1)))
    print(f"Median over {options.seeds} seeds; written: {FIGURE}")


if __name__ == "__main__":
    main()
