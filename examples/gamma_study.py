"""How much does gamma, the gain of the bias law, matter? A study, and its plot.

python examples/gamma_study.py          # minutes; writes gamma_study.png
"""

import matplotlib.pyplot as plt
import numpy as np

import posegsa
from posegsa.judging.evaluation import CONSTANT, TUNED


def main(base="paper", gammas=(0.5, 1, 2, 5, 10, 20), seeds=range(5), out="gamma_study.png"):
    base = base if isinstance(base, posegsa.Experiment) else posegsa.load_config(base)
    experiments = [posegsa.config.override(base, [f"filter.gamma={float(g)}"]) for g in gammas]

    # Experiments that differ only in numbers run in one compiled search, each with all seeds.
    results = posegsa.tune_batch(experiments, seeds=seeds).results
    judged = [result.on_scenarios.evaluation for result in results]

    # The cost of each seed's result on scenarios that it was not tuned on.
    costs = {
        name: np.reshape([each.cost(name).mean for each in judged], (len(gammas), -1))
        for name in (TUNED, CONSTANT)
    }
    figure, axes = plt.subplots()
    for name, each in costs.items():
        axes.plot(gammas, np.median(each, axis=1), "o-", label=name)
        axes.fill_between(gammas, each.min(axis=1), each.max(axis=1), alpha=0.2)
    axes.set(xscale="log", xlabel="gamma [1/s²]", ylabel="cost on unseen scenarios")
    axes.set_title(f"Median and range of {len(list(seeds))} seeds")
    axes.legend()
    figure.savefig(out)
    plt.close(figure)
    for gamma, tuned, constant in zip(gammas, costs[TUNED], costs[CONSTANT], strict=True):
        print(
            f"gamma {gamma:5g}: tuned {np.median(tuned):7.2f}, {CONSTANT} {np.median(constant):.2f}"
        )
    return costs


if __name__ == "__main__":
    posegsa.enable_fast_path()
    main()
