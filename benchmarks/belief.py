"""Whom to believe where sensors are disturbed: Kalman filters on `configs/disturbed.toml`.

Each is searched with the same optimiser, seed and number of evaluations on the same 32 scenarios,
and judged on 200 others, beside the noises of the sensors and the clairvoyant. Prints the table of
README; ten minutes on two cores.

    python benchmarks/belief.py
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import posegsa
from posegsa import config
from posegsa.config import KALMAN_ALSO
from posegsa.judging.clairvoyance import clairvoyant_costs
from posegsa.search.build import filter_of, scenario, scenario_batch, tuning_problem
from posegsa.search.candidates import Candidate
from posegsa.search.keys import held_out_keys
from posegsa.search.population import costs_by_scenario
from posegsa.search.run_search import run_search
from posegsa.words import text_table

SCENARIOS, SET = 200, 10
"""How many held-out scenarios, and which set of them."""
LANES = 8
"""Copies of one candidate that are run, as a vector register holds more than one filter."""
NOISES = [one.model_dump(mode="json") for one in KALMAN_ALSO]
GATE = {"belief": "ramp", "belief_smoothing": 0.0}
SMOOTHING = [
    {"key": "filter.belief_smoothing", "lower": 0.01, "upper": 1.0, "scale": "logarithmic"}
]
CONTENDERS: dict[str, tuple[dict[str, Any], list[dict[str, Any]]]] = {
    "fixed noises, tuned": ({"belief": "off"}, NOISES),
    "straight line at once, a gate if steep": (GATE, []),
    "straight line, low-passed": ({"belief": "ramp"}, SMOOTHING),
    "the paper's controller": ({"belief": "fuzzy"}, SMOOTHING),
}
"""By name: its section of the configuration, and what is tuned beside a schedule."""


def experiment(section: dict[str, Any], also: list[dict[str, Any]]) -> config.Experiment:
    """The disturbed experiment with another belief, searched by differential evolution."""
    data = config.load("disturbed").model_dump(mode="json")
    data["filter"] |= section
    data["parameters"]["also"], data["tuned"] = also, {}
    data["search"] = {"optimiser": "de", "agents": 24, "iterations": 22, "strategy": "best/1/bin"}
    return config.from_dict(data)


def row(name: str, training: float | None, costs: np.ndarray) -> list[str]:
    """A row of the table."""
    figures = (np.mean(costs), np.median(costs), np.quantile(costs, 0.99), np.max(costs))
    return [name, "" if training is None else f"{training:.1f}", *(f"{x:.1f}" for x in figures)]


def held_out(one: config.Experiment, candidate: Candidate) -> np.ndarray:
    """Costs (S,) of a candidate on the held-out scenarios."""
    keys = held_out_keys(one.run.seed, SCENARIOS, SET)
    batch = scenario_batch(one, scenario(one), keys, filter_of(one))
    several = jnp.ones(LANES, batch.dtype)

    def lanes(leaf: Any) -> Any:
        return several.reshape(-1, *(1,) * jnp.ndim(leaf)) * jnp.asarray(leaf)

    return np.asarray(costs_by_scenario(jax.tree.map(lanes, candidate), batch))[:, 0]


def main() -> None:
    """Search and judge all of them."""
    posegsa.enable_fast_path()
    rows = [["Kalman filter from sensors", "training", "mean", "median", "99 %", "worst"]]
    plain = experiment({"belief": "off"}, NOISES)
    assert isinstance(plain.filter, config.KalmanConfig)
    vector = jnp.asarray(plain.filter.vector, jnp.float32)
    rows.append(
        row(
            "the sensors' noises",
            None,
            held_out(plain, Candidate(None, (vector,), ("filter.vector",))),
        )
    )
    for name, (section, also) in CONTENDERS.items():
        one = experiment(section, also)
        problem = tuning_problem(one)
        found = run_search(problem).search
        best = problem.space.candidate(found.best_position)
        rows.append(row(name, float(found.best_cost), held_out(one, best)))
        print(text_table(rows), flush=True)
    keys = held_out_keys(plain.run.seed, SCENARIOS, SET)
    rows.append(row("clairvoyant", None, clairvoyant_costs(plain, keys)))
    print(text_table(rows))


if __name__ == "__main__":
    main()
