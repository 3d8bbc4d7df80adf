"""Tune, evaluate and export
=========================

A search for the 22 numbers of the fuzzy controller and some of the filter and the error signal, on
simulated scenarios; then the tuned filter as C and as a fuzzy controller for other tools. ::

    python examples/tune_and_export.py          # half a minute
    python examples/tune_and_export.py 200      # with all baselines on 200 scenarios; minutes
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

import posegsa


def main(experiment="quick", folder="tuned_example", scenarios=0):
    # Searches, and judges the best on scenarios that the search did not use.
    result = posegsa.tune(experiment, seed=1)
    print(result.summary())

    # Compares it on more scenarios with constant gains, a time switch, Kalman filters and others,
    # each searched with the same budget.
    if scenarios:
        result = posegsa.evaluate(result, scenarios=scenarios)
        print(result.on_scenarios.evaluation.table())

    # The same folder that `posegsa tune` writes: report.html for people, result.json for programs.
    folder = posegsa.save(result, folder, overwrite=True)
    (folder / "gain.h").write_text(posegsa.export_c(result), encoding="utf-8")
    (folder / "gain.fis").write_text(posegsa.export_fis(result), encoding="utf-8")
    print(f"See {Path(folder) / 'report.html'}")

    # How the search went, and the gain that it found.
    _, (search, gain) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    search.plot(result.search.history.best, label="best so far")
    search.plot(result.search.history.mean, label="mean of the agents")
    search.set(xlabel="iteration", ylabel="cost")
    search.legend()
    surface = gain.pcolormesh(*result.controller.surface())
    gain.set(xlabel="scaled error", ylabel="its rate")
    plt.colorbar(surface, label="gain K [1/s]")
    return result


if __name__ == "__main__":
    posegsa.enable_fast_path()  # before anything else uses JAX: all cores, full vectors
    main(scenarios=int(sys.argv[1]) if len(sys.argv) > 1 else 0)
    plt.show()
