"""One tuned filter on untrained families of scenarios, compared with the alternatives.

The recommended filter as shipped, with the numbers in its configuration; the Kalman filter of
`kalman.toml`, not tuned, with a smaller first bias, and what it costs more than the recommended
one; the observer as it was tuned for that family, or else for any start; the Kalman filter of
`kalman.toml`, started from the sensors and not tuned; and the clairvoyant. Prints mean cost (99th
percentile) of each family.

    python benchmarks/families.py --write   # docs/which_filter.md; twenty minutes on two cores
"""

import argparse
from typing import Any

import numpy as np
from readme import write_block
from schedules import difference

import posegsa
from posegsa import config
from posegsa.judging.clairvoyance import clairvoyant_costs
from posegsa.judging.description import candidate_of, configured_filter
from posegsa.judging.metrics import Metrics, error_tracks, metrics_of
from posegsa.search.configured_filters import filter_of
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import held_out_keys

DRAWN = {"angular_velocity_bias": 0.1, "velocity_bias": 0.3, "vector_bias": 0.1}
FOR_A_WRONG_START = ("filter.initial_vector_bias=0.04",)
"""Settings of `kalman.toml`; 0.04 was the best on validation scenarios."""
FAMILIES: dict[str, tuple[str, tuple[str, ...]]] = {
    "of `recommended`: any start, noise 0.7 to 2.5 times, body moved": ("recommended", ()),
    "the same, body not moved": ("recommended", ("family.jumps=off",)),
    "any start, 60 s": ("observer", ()),
    "the same, biases drawn": ("observer", tuple(f"family.{k}={b}" for k, b in DRAWN.items())),
    "as in the field, 60 s": ("field", ()),
    "the paper's start, 15 s": ("paper_start", ()),
    "the same, 60 s": ("paper_start", ("scenario.duration=60", "cost.steady_window=[400, 5900]")),
}
"""By name: the configuration of its scenarios and cost, and settings."""


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


def judged(
    own: config.Experiment, scenarios: config.Experiment, keys: Any, start: str = "given"
) -> Metrics:
    """The filter of a configuration as it is, on the scenarios and the cost of another."""
    one = with_scenarios(own, scenarios, start)
    batch = scenario_batch(one, keys, filter_of(one))
    return metrics_of(error_tracks(candidate_of(configured_filter(own), own), batch), batch)[0]


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
    recommended, kalman = config.load("recommended"), config.load("kalman")
    smaller_bias = config.override(kalman, FOR_A_WRONG_START)
    keys = held_out_keys(0, options.scenarios, options.set)
    lines = [
        "| scenarios | recommended, start given | `kalman`, first bias 0.04, start given "
        "| observer, start given | `kalman`, from sensors | recommended, from sensors "
        "| clairvoyant |",
        "| --- | --: | --: | --: | --: | --: | --: |",
    ]
    for name, (file, settings) in FAMILIES.items():
        family = config.override(config.load(file), settings)
        observer = config.load("observer" if file == "recommended" else file)
        beside, untuned = (judged(one, family, keys).cost for one in (recommended, smaller_bias))
        found = (
            judged(observer, family, keys).cost,
            judged(kalman, family, keys, "sensors").cost,
            judged(recommended, family, keys, "sensors").cost,
            np.asarray(clairvoyant_costs(with_scenarios(recommended, family), keys)),
        )
        more = f"{words(untuned)}: {difference(untuned, beside, 1)}"
        lines.append(f"| {' | '.join((name, words(beside), more, *map(words, found)))} |")
        print(lines[-1], flush=True)
    if options.write:
        write_block("families", "\n".join(lines), "docs/which_filter.md")


if __name__ == "__main__":
    main()
