"""One tuned filter on untrained families of scenarios, compared with the alternatives.

The recommended filter as shipped, with the numbers in its configuration; the observer with the
numbers of its own search on each family; the Kalman filter of `kalman.toml`, started from the
sensors and not tuned; the filter for disturbed sensors as shipped; and the clairvoyant. Prints mean
cost (99th percentile) of each family.

    python benchmarks/families.py --write   # docs/which_filter.md; twenty minutes on two cores
"""

import argparse
from typing import Any

import numpy as np
from readme import write_block
from schedules import as_configured, held_out

import posegsa
from posegsa import config
from posegsa.judging.clairvoyance import clairvoyant_costs
from posegsa.judging.description import candidate_of, configured_filter
from posegsa.search.keys import held_out_keys

DRAWN = {"angular_velocity_bias": 0.1, "velocity_bias": 0.3, "vector_bias": 0.1}
FAMILIES: dict[str, tuple[str, dict[str, Any]]] = {
    "any start, 60 s": ("observer", {}),
    "any start, biases drawn": ("observer", DRAWN),
    "any start, noise 3 times as high as assumed": ("observer", {"noise_scale": [3.0, 3.0]}),
    "any start, noise a third of the assumed": ("observer", {"noise_scale": [0.333, 0.333]}),
    "any start, bursts on the vectors": (
        "observer",
        {"bursts": {"rate": 0.1, "duration": [1.0, 5.0], "size": 1.0}},
    ),
    "as in the field, 60 s": ("field", {}),
    "as in the field, biases drawn": ("field", DRAWN),
    "the paper's start, 15 s": ("paper_start", {}),
    "the paper's start, 60 s": ("paper_minute", {}),
}
"""By name: the configuration of its scenarios and cost, and changes of [family]."""


STARTS = {"sensors": "from its sensors", "given": "as given"}
"""`scenario.start` in words."""


def with_family(file: str, changes: dict[str, Any]) -> config.Experiment:
    """A configuration with changes of [family]."""
    data = config.load(file).model_dump(mode="json")
    return config.from_dict(data | {"family": data["family"] | changes})


def with_scenarios(
    one: config.Experiment, scenarios: config.Experiment, start: str = "given"
) -> config.Experiment:
    """An experiment's filter on the scenarios and the cost of another."""
    data = one.model_dump(mode="json")
    data |= {
        key: getattr(scenarios, key).model_dump(mode="json")
        for key in ("scenario", "family", "cost")
    }
    data["scenario"]["start"] = start
    return config.from_dict(data)


def words(costs: np.ndarray) -> str:
    """Mean and 99th percentile."""
    return f"{np.mean(costs):.1f} ({np.quantile(costs, 0.99):.0f})"


def parser_of(about: str, which: int, pages: str, scenarios: int = 1000) -> argparse.ArgumentParser:
    """Options of a command that judges filters on held-out scenarios, by default set `which`."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--scenarios", type=int, default=scenarios)
    parser.add_argument("--set", type=int, default=which, help="which held-out scenarios")
    parser.add_argument("--write", action="store_true", help=f"into {pages}")
    return parser


def options_of(about: str, which: int, pages: str) -> argparse.Namespace:
    """The same, parsed."""
    return parser_of(about, which, pages).parse_args()


def main() -> None:
    """Judge all filters on all families."""
    options = options_of("One filter on many families of scenarios.", 11, "docs/which_filter.md")
    posegsa.enable_fast_path()
    recommended, kalman, disturbed = map(config.load, ("recommended", "kalman", "disturbed"))
    tuned = candidate_of(configured_filter(recommended), recommended)
    believing = candidate_of(configured_filter(disturbed), disturbed)
    keys = held_out_keys(0, options.scenarios, options.set)
    lines = [
        "| scenarios | recommended, start given | observer, start given | Kalman filter, "
        "not tuned, from sensors | recommended, from sensors | disturbed, from sensors "
        "| clairvoyant |",
        "| --- | --: | --: | --: | --: | --: | --: |",
    ]
    for name, (file, changes) in FAMILIES.items():
        own, family = config.load(file), with_family(file, changes)
        given, seen = (with_scenarios(recommended, family, s) for s in ("given", "sensors"))
        plain = with_scenarios(kalman, family, "sensors")
        found = (
            held_out(given, tuned, keys),
            held_out(family, candidate_of(configured_filter(own), own), keys),
            held_out(plain, as_configured(plain), keys),
            held_out(seen, tuned, keys),
            held_out(with_scenarios(disturbed, family, "sensors"), believing, keys),
            np.asarray(clairvoyant_costs(given, keys)),
        )
        lines.append(f"| {name} | {' | '.join(map(words, found))} |")
        print(lines[-1], flush=True)
    if options.write:
        write_block("families", "\n".join(lines), "docs/which_filter.md")


if __name__ == "__main__":
    main()
