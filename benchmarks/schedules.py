"""Schedules of a Kalman filter's noises compared with alternatives, on one family of scenarios.

Every contender is searched with the same optimiser on the same training scenarios, and judged on
others. All have the same number of evaluations, or more: a search goes on until CHECK_INTERVAL more
improve its training cost by less than MIN_IMPROVEMENT (or it has MAX_FACTOR times that number).
Prints the table of a family: mean cost, its difference from the paper's controller with a 95 %
interval (paired, bootstrap), median, 99th percentile, worst.

    python benchmarks/schedules.py recommended     # bodies that are moved; over an hour on a core
    python benchmarks/schedules.py field --seeds 3
    python benchmarks/schedules.py disturbed       # belief in sensors
"""

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from nis_reset import RESET, RESET_ALSO, NisReset, nis_reset

import posegsa
from posegsa import config
from posegsa.config import KALMAN_ALSO
from posegsa.filters.kalman import KalmanNoise
from posegsa.filters.noise_schedules import NoiseGains
from posegsa.judging.baselines import replayed
from posegsa.judging.clairvoyance import clairvoyant_costs
from posegsa.judging.description import candidate_of, configured_filter
from posegsa.judging.metrics import error_tracks, metrics_of
from posegsa.model.schedules import RampGain
from posegsa.optimisers import Search
from posegsa.optimisers.search_box import to_unit
from posegsa.search.candidates import Candidate, ScheduleSpace, SimpleSpace
from posegsa.search.configured_filters import filter_of
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import held_out_keys
from posegsa.search.problem import TuningProblem, tuning_problem
from posegsa.search.run_search import first_search, run_search
from posegsa.search.schedule_spaces import NoiseSpaces
from posegsa.search.search_spaces import role_space, search_space
from posegsa.words import text_table

SEARCHES: dict[str, dict[str, Any]] = {
    name: {"optimiser": "de", "agents": agents, "iterations": iterations, "strategy": "best/1/bin"}
    for name, agents, iterations in (("unknown", 32, 30), ("belief", 24, 22))
}
"""By the role that is scheduled."""
NOISES = [one.model_dump(mode="json") for one in KALMAN_ALSO]
BELIEF_ALSO = [
    {"key": "filter.belief_smoothing", "lower": 0.01, "upper": 1.0, "scale": "logarithmic"}
]
CHECK_INTERVAL, MIN_IMPROVEMENT, MAX_FACTOR = 500, 0.005, 4
"""Evaluations and share of the cost, and factor on the common number of evaluations."""
CONTROLLER = "the paper's controller"
TWO, NOISES_TOO = ", once, reset in two frames", ", noises too"
TIED, BOTH = f"{CONTROLLER}, one for all sensors", f"{CONTROLLER}, both roles"
CLOCK, ONCE, ITERATED = "clock, 16 knots", ", not iterated", "fixed noises, tuned, iterated"
FIRST_BIAS = "the same, the vectors' first bias tuned"
STATED_GATE = "gate, noises as stated"
GATE, HUBER, POWER, SAGE_HUSA = "gate", "Huber", "plain residual law", "Sage and Husa"
RULES: dict[str, tuple[list[tuple[float, float]], Callable[[Array], RampGain]]] = {
    GATE: ([(0.0, 0.4)], lambda x: RampGain(x[0], jnp.full_like(x[0], 1000.0))),
    HUBER: ([(0.0, 0.4)], lambda x: RampGain(x[0], jnp.full_like(x[0], 0.5))),
    POWER: ([(0.1, 3.0)], lambda x: RampGain(jnp.zeros_like(x[0]), x[0])),
    # The threshold is searched too: as written by Sage and Husa it is 1, which is 0 here.
    SAGE_HUSA: ([(0.0, 0.2)], lambda x: RampGain(x[0], jnp.ones_like(x[0]))),
}
"""Rules that users know, as straight lines of belief with one number each for vectors and for
landmarks. The factor is q^slope above a threshold. A gate ignores what is above it. Huber's weight
of a residual r in standard deviations, c / |r| beyond c, is the slope 1/2 of q = r^2, at once. The
plain residual law is a power of the low-passed q. Sage and Husa's variance is the low-passed
variance that the residuals imply. Where all sensors of a sample are doubted, each is weaker than as
users know it (`filters.belief.halfway_to_the_least`)."""
BIAS = [one for one in NOISES if one["key"].endswith("initial_vector_bias")]
NIS, OWN = "reset when a test of the NIS fails", {"kind": "own", **RESET}
Contenders = dict[str, tuple[dict[str, Any], list[dict[str, Any]] | None]]
"""By name: changes of [filter], and numbers tuned in addition to a schedule, or None for no search.
A contender whose name begins with that of a rule is searched in the rule's space."""


def contenders(role: str, also: list[dict[str, Any]]) -> Contenders:
    """The Kalman filters that are compared where a role is scheduled."""
    if role == "belief":
        gate = {"belief": "ramp", "belief_smoothing": 0.0}
        power = {"belief": "ramp", "belief_input": "residual"}
        return {
            "the sensors' noises, not tuned": ({"belief": "off"}, None),
            "fixed noises, tuned": ({"belief": "off"}, NOISES),
            "straight line at once": (gate, []),
            "straight line, low-passed": ({"belief": "ramp"}, BELIEF_ALSO),
            f"straight line, low-passed{NOISES_TOO}": (
                {"belief": "ramp"},
                [*NOISES, *BELIEF_ALSO],
            ),
            STATED_GATE: (gate | {"noise_adaptation": "off"}, []),
            f"{GATE}, low-passed": ({"belief": "ramp"}, BELIEF_ALSO),
            GATE: (gate, []),
            f"{GATE}{NOISES_TOO}": (gate, NOISES),
            HUBER: (gate, []),
            f"{HUBER}{NOISES_TOO}": (gate, NOISES),
            POWER: (power, BELIEF_ALSO),
            f"{POWER}{NOISES_TOO}": (power, [*NOISES, *BELIEF_ALSO]),
            SAGE_HUSA: ({"belief": "ramp", "belief_input": "variance"}, BELIEF_ALSO),
            f"{SAGE_HUSA}{NOISES_TOO}": (
                {"belief": "ramp", "belief_input": "variance"},
                [*NOISES, *BELIEF_ALSO],
            ),
            CLOCK: ({"belief": "clock"}, []),
            f"{CLOCK}{NOISES_TOO}": ({"belief": "clock"}, NOISES),
            ITERATED: ({"belief": "off", "iterations": 10}, NOISES),
            TIED: ({"belief": "fuzzy"}, also),
            BOTH: ({"belief": "fuzzy", "unknown": "fuzzy"}, also),
            CONTROLLER: ({"belief": "fuzzy"}, also),
            f"{CONTROLLER}{NOISES_TOO}": ({"belief": "fuzzy"}, [*NOISES, *also]),
        }
    off, once_reset = {"unknown": "off"}, {"iterations": 1, "reset": "two frames"}
    return {
        "the sensors' noises, not tuned": (off | FAMILY_START, None),
        FIRST_BIAS: (off, BIAS),
        "fixed noises, tuned": (off, NOISES),
        f"fixed noises, tuned{ONCE}": (off | {"iterations": 1}, NOISES),
        CLOCK: ({"unknown": "clock"}, also),
        "straight line": ({"unknown": "ramp"}, also),
        "smooth K(e)": ({"unknown": "smooth"}, also),
        f"fixed noises, tuned{TWO}": (off | once_reset, NOISES),
        f"straight line{TWO}": ({"unknown": "ramp"} | once_reset, also),
        f"{CONTROLLER}{TWO}": ({"unknown": "fuzzy"} | once_reset, also),
        **{
            f"{rule}{NOISES_TOO}": (off | {"belief": "ramp"} | of_rule, [*NOISES, *smoothed])
            for rule, of_rule, smoothed in (
                (GATE, {"belief_smoothing": 0.0}, []),
                (HUBER, {"belief_smoothing": 0.0}, []),
                (POWER, {}, BELIEF_ALSO),
                (SAGE_HUSA, {"belief_input": "variance"}, BELIEF_ALSO),
            )
        },
        NIS: (OWN, [*RESET_ALSO, *BIAS]),
        f"{NIS}, estimated noises": (OWN | {"noise_adaptation": 100.0}, [*RESET_ALSO, *BIAS]),
        f"{CONTROLLER}{ONCE}": ({"unknown": "fuzzy", "iterations": 1}, also),
        CONTROLLER: ({"unknown": "fuzzy"}, also),
    }


FAMILY_START = {"initial_attitude": 1.05, "initial_position": 3.3, "initial_vector_bias": 0.1}
"""A third of 180 deg and of 10 m, and the vectors' biases."""


def experiments(family: config.Experiment, seed: int) -> dict[str, tuple[config.Experiment, bool]]:
    """The experiment of each contender on a family, and whether it is searched."""
    if isinstance(family.filter, config.KalmanConfig) and family.filter.belief != "off":
        role, base = "belief", family
    else:
        role = "unknown"
        base = config.load("recommended").replace(
            run=family.run, scenario=family.scenario, family=family.family, cost=family.cost
        )
    data = base.model_dump(mode="json") | {"search": SEARCHES[role], "tuned": {}}
    data["run"]["seed"] = seed
    also = data["parameters"]["also"]
    found: dict[str, tuple[config.Experiment, bool]] = {}
    for contender, (section, searched) in contenders(role, also).items():
        parameters = data["parameters"] | {"also": searched or []}
        numbers = data["filter"]
        if section.get("kind") == "own":
            numbers = {name: numbers[name] for name in KalmanNoise._fields}
        one = data | {"filter": numbers | section, "parameters": parameters}
        found[contender] = config.from_dict(one), searched is not None
    return found


def own_filter(one: config.Experiment) -> Callable[..., NisReset] | None:
    """What makes the filter of a contender that is none of posegsa's."""
    return nis_reset if isinstance(one.filter, config.OwnConfig) else None


def held_out(one: config.Experiment, candidate: Candidate, keys: jax.Array) -> np.ndarray:
    """Costs (S,) of a candidate on scenarios."""
    batch = scenario_batch(one, keys, filter_of(one, own_filter(one)))
    return metrics_of(error_tracks(candidate, batch), batch)[0].cost


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TiedSpace:
    """The numbers of one schedule, which serves vectors and landmarks."""

    each: ScheduleSpace

    @property
    def lower(self) -> Array:
        """(d,)."""
        return self.each.lower

    @property
    def upper(self) -> Array:
        """(d,)."""
        return self.each.upper

    def schedule(self, vector: Array) -> NoiseGains:
        """The schedules of a vector (d,)."""
        one: Any = self.each.schedule(vector)
        return NoiseGains(vectors=one, landmarks=one)

    def valid(self, vector: Array) -> Array:
        """Whether a vector (d,) has a cost."""
        return self.each.valid(vector)


class EnoughSearched(Exception):
    """Stops a search that hardly improves; holds it."""

    def __init__(self, search: Search) -> None:
        super().__init__()
        self.search = search


class Searched(NamedTuple):
    """What the search of a contender found."""

    candidate: Candidate
    training: float
    evaluations: int
    position: Array
    """(d,) of the candidate, in the units of the search box."""
    keys: tuple[str, ...]
    """Names of its last numbers, those that are tuned in addition to a schedule."""


def search(name: str, one: config.Experiment, simpler: Searched | None = None) -> Searched:
    """The best candidate of a contender's search.

    With `simpler`, what the same schedule's search found with the noises as configured, the first
    agent is that filter.
    """
    agents, number = one.search.agents, one.search.evaluations
    iterations = MAX_FACTOR * one.search.total_iterations
    one = one.replace(**{"search.iterations": iterations})
    problem = tuning_problem(one, own=own_filter(one))
    if name == TIED:
        problem = problem._replace(space=search_space(one, TiedSpace(role_space("fuzzy", one))))
    if rule := next((rule for rule in RULES if name.startswith(rule)), None):
        bounds, make = RULES[rule]
        lower, upper = (jnp.asarray(ends, one.run.dtype) for ends in zip(*bounds, strict=True))
        space, roles = SimpleSpace(lower, upper, make), ("vectors", "landmarks")
        spaces = NoiseSpaces((space,) * len(roles), roles)
        problem = problem._replace(space=search_space(one, spaces))

    def stop(search: Search, *_: float) -> None:
        before = int(search.iteration) - math.ceil(CHECK_INTERVAL / agents)
        if before > 0 and int(search.iteration) * agents >= number:
            earlier = float(search.history.best[before - 1])
            if float(search.best_cost) > (1 - MIN_IMPROVEMENT) * earlier:
                raise EnoughSearched(search)

    try:
        begin = first_search(problem)
        if simpler is not None:
            unit = to_unit(problem.space.box, with_configured(one, problem, simpler))
            begin = begin._replace(state=one.search.begin_at(begin.state, unit))
        found = run_search(problem, search=begin, after_chunk=stop).search
    except EnoughSearched as enough:
        found = enough.search
    position = found.best_position
    return Searched(
        problem.space.candidate(position),
        float(found.best_cost),
        int(found.iteration) * agents,
        position,
        problem.space.keys,
    )


def with_configured(one: config.Experiment, problem: TuningProblem, simpler: Searched) -> Array:
    """(d,) the position of a simpler search, and the numbers that it lacks as configured."""
    space, there = problem.space, len(simpler.position) - len(simpler.keys)
    known = dict(zip(simpler.keys, simpler.position[there:], strict=True))
    numbers = list(simpler.position[:there])
    for key, logarithmic in zip(space.keys, space.logarithmic, strict=True):
        value = getattr(one.filter, key.removeprefix("filter."))
        numbers.append(known.get(key, math.log(value) if logarithmic else value))
    return jnp.asarray(numbers, simpler.position.dtype)


def difference(costs: np.ndarray, beside: np.ndarray, digits: int) -> str:
    """The mean paired difference, with a 95 % interval by bootstrap."""
    less = costs - beside
    means = np.random.default_rng(0).choice(less, (2000, len(less))).mean(axis=1)
    low, high = np.quantile(means, (0.025, 0.975))
    return f"{np.mean(less):+.{digits}f} ({low:+.{digits}f} to {high:+.{digits}f})"


def row(name: str, found: Searched | None, costs: np.ndarray, beside: np.ndarray) -> list[str]:
    """A row of the table; `beside` are the controller's costs, `found` None without a search."""
    of_search = ["", ""] if found is None else [f"{found.evaluations}", f"{found.training:.2f}"]
    words = [name, *of_search, f"{np.mean(costs):.2f}"]
    words.append("" if costs is beside else difference(costs, beside, 2))
    return [*words, *(f"{np.quantile(costs, share):.1f}" for share in (0.5, 0.99, 1.0))]


def main() -> None:
    """Search and judge all contenders of a family."""
    parser = argparse.ArgumentParser(description="Schedules of a Kalman filter and alternatives.")
    parser.add_argument("family", help="a configuration of posegsa: its scenarios and cost")
    parser.add_argument("--seeds", type=int, default=1, help="searches of each contender")
    parser.add_argument("--first", type=int, default=0, help="seed of the first search")
    parser.add_argument("--scenarios", type=int, default=200)
    parser.add_argument("--set", type=int, default=10, help="which held-out scenarios")
    parser.add_argument(
        "--settings", nargs="+", default=[], metavar="KEY=VALUE", help="of the family"
    )
    parser.add_argument("--only", nargs="+", help="contenders beside the controller (all)")
    options = parser.parse_args()
    posegsa.enable_fast_path()
    keys = held_out_keys(0, options.scenarios, options.set)
    family = config.override(config.load(options.family), options.settings)
    for seed in range(options.first, options.first + options.seeds):
        found: dict[str, tuple[Searched | None, np.ndarray]] = {}
        one = of_controller = family
        for name, (contender, searched) in experiments(family, seed).items():
            if options.only and name not in (CONTROLLER, *options.only):
                continue
            one = contender
            of_controller = one if name == CONTROLLER else of_controller
            simpler = found.get(name.removesuffix(NOISES_TOO), (None,))[0]
            best = search(name, one, simpler) if searched else None
            candidate = Candidate() if best is None else best.candidate
            found[name] = best, held_out(one, candidate, keys)
            after = "" if best is None else f" after {best.evaluations} evaluations"
            print(f"  {name}: {found[name][1].mean():.2f}{after}", flush=True)
        controller = found[CONTROLLER][0]
        assert controller is not None
        schedules = controller.candidate.schedule
        if isinstance(schedules, NoiseGains) and schedules.unknown is not None:
            changes = {"filter.unknown": "clock", "tuned": config.TunedConfig()}
            clock = of_controller.replace(**changes)
            again = replayed(tuning_problem(clock), controller.candidate)
            found["the controller's outputs, replayed"] = None, held_out(clock, again, keys)
        if isinstance(family.filter, config.ObserverConfig):
            tuned = candidate_of(configured_filter(family), family)
            found["the observer as shipped"] = None, held_out(family, tuned, keys)
        if family.scenario.start == "given" and options.family != "sparse":
            plain = one.replace(
                scenario=one.scenario.model_copy(update={"start": "sensors"}),
                filter=config.load("kalman").filter,
                parameters=one.parameters.model_copy(update={"also": ()}),
            )
            found["not tuned, from sensors"] = None, held_out(plain, Candidate(), keys)
        found["clairvoyant"] = None, np.asarray(clairvoyant_costs(one, keys))
        heads = ["Kalman filter", "evaluations", "training", "held out", "less controller"]
        beside = found[CONTROLLER][1]
        rows = [row(name, best, costs, beside) for name, (best, costs) in found.items()]
        print(f"{options.family}, search {seed}")
        print(text_table([[*heads, "median", "99 %", "worst"], *rows]), flush=True)


if __name__ == "__main__":
    main()
