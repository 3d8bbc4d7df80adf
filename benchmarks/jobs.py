"""Which filter for which job: the errors of the shipped filters where each is recommended.

Each filter as shipped, with the numbers in its configuration, on 1000 scenarios that no search has
seen: RMS errors in the cost's second window, mean cost (99th percentile), and the cost of the
clairvoyant. Time and memory of a step are those that `c_filter.py` wrote to docs/export.md.

    python benchmarks/jobs.py --write   # README.md and docs/which_filter.md
"""

import re
from typing import NamedTuple

import numpy as np
from families import FOR_A_WRONG_START, STARTS, judged, options_of, with_scenarios, words
from readme import ROOT, write_block

import posegsa
from posegsa import config
from posegsa.judging.clairvoyance import clairvoyant_costs
from posegsa.search.keys import held_out_keys


class Job(NamedTuple):
    """What a user has, and the filter to take."""

    given: str
    take: str
    """Name of its configuration."""
    scenarios: str
    """Name of the configuration whose scenarios are like the job."""
    start: str
    in_c: str
    """Its row in docs/export.md."""
    controller: str
    """The cost with the paper's controller beside that with fixed gains or noises, and beside that
    with the best simpler schedule, a straight line or a smooth gain. By hand, from the searches of
    `schedules.py` and `results.py`."""
    settings: tuple[str, ...] = ()
    """Settings of the configuration, as `--set` takes them."""


KALMAN_IN_C = "Kalman, 18 states, 10 iterations, 2 vectors, 1 landmark"
"""Its row in docs/export.md."""
JOBS = (
    Job(
        "a first sample that determines the pose: two vectors and a landmark",
        *("kalman", "observer", "sensors", KALMAN_IN_C),
        "no controller",
    ),
    Job(
        "a start that may be wrong, by up to 180° and 10 m",
        *("kalman", "observer", "given", KALMAN_IN_C),
        "no controller",
        FOR_A_WRONG_START,
    ),
    Job(
        "the same, noise 0.7 to 2.5 times as assumed, a body that is moved by hand now and then",
        *("recommended", "recommended", "given", "`recommended`, 2 vectors, 1 landmark"),
        "19 to 23 % less; 0 to 1 % more",
    ),
    Job(
        "a start that may be wrong, little time or memory",
        *("observer", "observer", "given", "`observer`, 2 vectors, 1 landmark"),
        "26 to 28 % less; 0 to 2 % more",
    ),
    Job(
        "sensors that are disturbed: bursts, noise that changes, outages",
        *("disturbed", "disturbed", "sensors", "`disturbed`, 2 vectors, 3 landmarks"),
        "73 % less; 0.2 % less to 0.2 % more",
    ),
    Job(
        "slow sensors, one landmark in sight at a time, a body that is moved",
        *("sparse", "sparse", "sensors", "`sparse`, 2 vectors, 3 landmarks"),
        "20 to 26 % less; 1 % less to 1 % more",
    ),
)


def step_in_c(name: str) -> str:
    """Time and memory of a step in C, from the page that has them."""
    page = (ROOT / "docs" / "export.md").read_text("utf-8")
    pattern = rf"^\| {re.escape(name)} \| float \| (\d+) ns [^|]*\| [^|]*\| (\d+ B) \|"
    found = re.search(pattern, page, re.MULTILINE)
    if found is None:
        raise ValueError(f"docs/export.md: must have a row {name!r} | float")
    return f"{int(found[1]) / 1000:.1f} us, {found[2]}"


def row(job: Job, count: int, which: int) -> str:
    """A row of the table."""
    own = config.load(job.take)
    if job.settings:
        own = config.override(own, job.settings)
    scenarios, keys = config.load(job.scenarios), held_out_keys(0, count, which)
    metrics = judged(own, scenarios, keys, job.start)
    if metrics.diverged.any():
        print(f"  {job.take}: {metrics.diverged.sum()} of {count} diverged")
    attitude, distance = np.mean(metrics.rms_attitude), 100 * np.mean(metrics.rms_distance)
    return " | ".join(
        (
            f"| {job.given}",
            f"`{' --set '.join((job.take, *job.settings))}`"
            f"{'' if own.tuned.numbers else ', not tuned'}, {STARTS[job.start]}",
            f"{attitude:.2f}°, {distance:.1f} cm",
            words(metrics.cost),
            f"{np.mean(clairvoyant_costs(with_scenarios(own, scenarios, job.start), keys)):.1f}",
            step_in_c(job.in_c),
            f"{job.controller} |",
        )
    )


def main() -> None:
    """Judge each filter on its job."""
    options = options_of("Which filter for which job.", 43, "README.md and docs/which_filter.md")
    posegsa.enable_fast_path()
    lines = [
        "| you have | take, start | RMS errors from 4 s on | cost (99 %) | clairvoyant's cost | "
        "a step in C, state | "
        "the controller's cost beside fixed numbers; beside a simpler schedule |",
        "| --- | --- | --: | --: | --: | --: | --: |",
    ]
    print("\n".join(lines))
    for job in JOBS:
        lines.append(row(job, options.scenarios, options.set))
        print(lines[-1], flush=True)
    if options.write:
        for page in ("README.md", "docs/which_filter.md"):
            write_block("jobs", "\n".join(lines), page)


if __name__ == "__main__":
    main()
