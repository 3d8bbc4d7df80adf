"""Tune a filter, compare it with baselines, and export it.

python examples/tune_and_export.py      # minutes; less with fewer scenarios
"""

from pathlib import Path

import posegsa


def main(experiment="quick", folder="tuned", scenarios=200):
    # Searches the 22 numbers of the fuzzy controller and some of the filter and the error signal
    # on simulated scenarios; judges the best on scenarios that the search did not use.
    result = posegsa.tune(experiment, seed=1)
    print(result.summary())

    # Compares it on more scenarios with constant gains, a time switch, Kalman filters and others,
    # each searched with the same budget.
    result = posegsa.evaluate(result, scenarios=scenarios)
    print(result.on_scenarios.evaluation.table())

    # The same folder that `posegsa tune` writes: report.html for people, result.json for programs.
    folder = posegsa.save(result, folder, overwrite=True)
    (folder / "gain.h").write_text(posegsa.export_c(result), encoding="utf-8")
    (folder / "gain.fis").write_text(posegsa.export_fis(result), encoding="utf-8")
    print(f"See {Path(folder) / 'report.html'}")
    return result


if __name__ == "__main__":
    posegsa.enable_fast_path()  # before anything else uses JAX: all cores, full vectors
    main()
