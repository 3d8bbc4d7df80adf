"""Tune a filter, judge it beside what one could take instead, and write it for elsewhere.

python examples/tune_and_export.py      # minutes; less with fewer scenarios
"""

from pathlib import Path

import posegsa


def main(experiment="quick", folder="tuned", scenarios=200):
    # Searches the 22 numbers of the fuzzy controller, and those of filter and signal beside them,
    # on simulated scenarios; judges the best on scenarios that the search has not seen.
    result = posegsa.tune(experiment, seed=1)
    print(result.summary())

    # The same scenarios for constant gains, a time switch, Kalman filters and others, each of them
    # searched with the same budget.
    result = posegsa.evaluate(result, scenarios=scenarios)
    print(result.evaluation.table())

    # The folder that `posegsa tune` writes: report.html for people, result.json for programs.
    folder = posegsa.save(result, folder, overwrite=True)
    (folder / "gain.h").write_text(posegsa.export_c(result), encoding="utf-8")
    (folder / "gain.fis").write_text(posegsa.export_fis(result), encoding="utf-8")
    print(f"See {Path(folder) / 'report.html'}")
    return result


if __name__ == "__main__":
    posegsa.enable_fast_path()  # before anything else uses JAX: all cores, full vectors
    main()
