"""An update that is iterated ten times, in place of a controller, from starts as given.

The Kalman filter of `kalman.toml`, not tuned, with `filter.iterations=10`, beside the filter with
the paper's controller that is shipped for the same scenarios. Prints mean cost (99th percentile),
and the paired difference with a 95 % interval.

    python benchmarks/iterations.py --write   # docs/recommended.md; half an hour on two cores
"""

import numpy as np
from families import options_of, with_family, with_scenarios, words
from readme import write_block
from schedules import FAMILY_START, as_configured, held_out

import posegsa
from posegsa import config
from posegsa.judging.description import candidate_of, configured_filter
from posegsa.search.keys import held_out_keys

FAMILIES = {
    "any start, 60 s": ("observer", "recommended"),
    "the same, noise 0.7 to 2.5 times as assumed, biases drawn": ("recommended", "recommended"),
    "as in the field, 60 s": ("field", "recommended"),
    "the paper's start, 15 s": ("paper_start", "recommended"),
    "sparse sensors": ("sparse", "sparse"),
}
"""By name: the configuration of its scenarios and cost, and of the filter with a controller."""


def main() -> None:
    """Judge both filters on all families."""
    options = options_of("Ten iterations an update, or a controller.", 61, "docs/recommended.md")
    posegsa.enable_fast_path()
    keys = held_out_keys(0, options.scenarios, options.set)
    iterated = config.load("kalman").replace(
        **{f"filter.{name}": value for name, value in FAMILY_START.items()},
        **{"filter.iterations": 10},
    )
    lines = [
        "| scenarios, start as given | the controller, as shipped | `kalman`, not tuned, 10 "
        "iterations | less the controller [95 %] |",
        "| --- | --: | --: | --: |",
    ]
    for name, (file, shipped) in FAMILIES.items():
        own, family = config.load(shipped), with_family(file, {})
        controlled = candidate_of(configured_filter(own), own)
        plain = with_scenarios(iterated, family)
        found = (
            held_out(with_scenarios(own, family), controlled, keys),
            held_out(plain, as_configured(plain), keys),
        )
        less = found[1] - found[0]
        gaps = np.random.default_rng(0).choice(less, (2000, len(less))).mean(axis=1)
        low, high = np.quantile(gaps, (0.025, 0.975))
        interval = f"{np.mean(less):+.1f} ({low:+.1f} to {high:+.1f})"
        lines.append(f"| {name} | {' | '.join(map(words, found))} | {interval} |")
        print(lines[-1], flush=True)
    if options.write:
        write_block("iterations", "\n".join(lines), "docs/recommended.md")


if __name__ == "__main__":
    main()
