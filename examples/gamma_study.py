"""A study of one number, with a plot
==================================

How much does gamma matter, the gain of the law of the velocities' biases? ::

    python examples/gamma_study.py

The search is short here, so that the study takes half a minute. ``posegsa sweep`` does the same
from a shell, keeps what is finished, and divides a study among machines.
"""

import matplotlib.pyplot as plt
import numpy as np

import posegsa
from posegsa.judging.evaluation import CONSTANT, TUNED

SMALL = {"search.agents": 40, "search.iterations": 30}  # the paper's: 100 and 250


def main(base=None, gammas=(1, 3, 10, 30), seeds=range(2)):
    base = base or posegsa.load_config("paper").replace(**SMALL)
    experiments = [base.replace(**{"filter.gamma": float(gamma)}) for gamma in gammas]

    # Experiments that differ only in numbers run in one compiled search, each with all seeds.
    results = posegsa.tune_batch(experiments, seeds=seeds).results
    judged = [result.on_scenarios.evaluation for result in results]

    # The cost of each seed's result on scenarios that it was not tuned on.
    costs = {
        name: np.reshape([each.cost(name).mean for each in judged], (len(gammas), -1))
        for name in (TUNED, CONSTANT)
    }
    _, axes = plt.subplots()
    for name, each in costs.items():
        axes.plot(gammas, np.median(each, axis=1), "o-", label=name)
        axes.fill_between(gammas, each.min(axis=1), each.max(axis=1), alpha=0.2)
    axes.set(xscale="log", xlabel="gamma [1/s²]", ylabel="cost on unseen scenarios")
    axes.set_title(f"Median and range of {len(list(seeds))} seeds")
    axes.legend()
    for gamma, tuned, constant in zip(gammas, costs[TUNED], costs[CONSTANT], strict=True):
        print(
            f"gamma {gamma:5g}: tuned {np.median(tuned):7.2f}, {CONSTANT} {np.median(constant):.2f}"
        )
    return costs


if __name__ == "__main__":
    posegsa.enable_fast_path()
    main()
    plt.show()
