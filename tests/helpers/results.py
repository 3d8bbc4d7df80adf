"""Made-up results of a tune, with random numbers."""

from dataclasses import replace

import numpy as np

from helpers.experiments import BASE
from posegsa import config
from posegsa.config import KALMAN_ALSO
from posegsa.judging.description import Description
from posegsa.judging.endurance import Endurance
from posegsa.judging.evaluation import (
    AS_CONFIGURED,
    CONSTANT,
    CONTENDERS,
    EKF,
    EKF_CLOCK,
    EKF_GATED,
    EKF_ITERATED,
    EKF_VECTORS,
    OPEN_LOOP,
    RANDOM,
    REPLAYED,
    SMOOTH,
    SWITCH,
    TUNED,
    UNTUNED,
    Contender,
    Evaluation,
)
from posegsa.judging.metrics import Bands, Metrics
from posegsa.judging.on_scenarios import OnScenarios
from posegsa.judging.result import FoundBy, Result
from posegsa.judging.trajectory import Trajectory
from posegsa.judging.trust import Trust
from posegsa.optimisers import History
from posegsa.search.population import cost_name

ANGLES = np.linspace(0, 180, 40)
TIME = np.linspace(0, 15, 61)


def description(kind: str, evaluations: int = 960, **numbers) -> Description:
    """A filter described by its numbers, each a scalar or a list."""
    listed = {name: np.ravel(np.float64(value)).tolist() for name, value in numbers.items()}
    return Description(kind, listed, {}, evaluations)


K = [0.5] * 22
KNOTS = {"time": [0.0, 7.5, 15.0], "log_gain": np.log([90.0, 50.0, 10.0])}
NOISES = {one.key: 0.1 for one in KALMAN_ALSO}
OF_BIASES = ("filter.vector_walk", "filter.initial_vector_bias")
"""Noises of a Kalman filter with the vectors' biases as states."""
GATES = {
    f"{role}.{name}": [value]
    for role in ("vectors", "landmarks")
    for name, value in (("start", 0.2), ("slope", 100.0))
}
CLOCK = {f"unknown.{name}": np.ravel(values).tolist() for name, values in KNOTS.items()}
FILTERS = {
    TUNED: description("fuzzy", k=K),
    CONSTANT: description("constant", gain=53.5),
    SWITCH: description("switch", before=80.0, after=20.0, time=1.5, learning_time=0.0),
    REPLAYED: description("open loop", evaluations=0, **KNOTS),
    RANDOM: description("fuzzy", k=K),
    SMOOTH: description("smooth", low=20.0, high=90.0, half=0.1),
    OPEN_LOOP: description("open loop", **KNOTS),
    EKF: Description("kalman", {}, {k: v for k, v in NOISES.items() if k not in OF_BIASES}, 400),
    EKF_VECTORS: Description("kalman", {}, NOISES, 400),
    EKF_ITERATED: Description("kalman", {}, NOISES, 400),
    EKF_GATED: Description("kalman", GATES, NOISES, 400),
    EKF_CLOCK: Description("kalman", CLOCK, NOISES, 400),
    UNTUNED: Description("kalman", {}, {}, 0),
    AS_CONFIGURED: Description("kalman", {}, {}, 0),
}
OF_THE_OBSERVER = tuple(name for name in CONTENDERS if name != AS_CONFIGURED)
assert tuple(FILTERS) == CONTENDERS


def contender(seed: int, scenarios: int = 40, filter=FILTERS[TUNED], **metrics) -> Contender:
    rng = np.random.default_rng(seed)
    drawn = {name: rng.uniform(1, 40, scenarios) for name in Metrics._fields}
    drawn["diverged"] = np.zeros(scenarios, bool)
    if filter.kind != "kalman":
        drawn |= dict.fromkeys(("nees", "nees_inside", "nis"), np.full(scenarios, np.nan))
    drawn["initial_angle"] = np.full(scenarios, 174.8)
    bands = Bands(*np.sort(rng.uniform(0.1, 50, (3, 3, len(TIME))), axis=1))
    return Contender(Metrics(**{**drawn, **metrics}), bands, filter)


def evaluation(names=OF_THE_OBSERVER, seed=None, **metrics) -> Evaluation:
    """Contenders with random metrics; some fields may be given for all of them."""
    all_of_them = {
        name: contender(i, filter=FILTERS[name], **metrics) for i, name in enumerate(names)
    }
    return Evaluation(seed=seed, time=TIME, contenders=all_of_them)


def changed(given: Evaluation, name: str, **metrics) -> Evaluation:
    """An evaluation with some metrics of one contender changed."""
    one = given.contenders[name]
    one = one._replace(metrics=one.metrics._replace(**metrics))
    return replace(given, contenders={**given.contenders, name: one})


def trust(**values) -> Trust:
    weights = np.zeros((5, 5))
    weights[0, 1], weights[3, 4] = 0.25, 0.0125
    return Trust(
        **{
            **{"cost_float32": 44.1, "cost_float64": 44.2, "cost_perturbed": 44.05},
            **{"sensitive": False, "uncovered": 0.0, "rule_weights": weights},
            **values,
        }
    )


def endurance(**values) -> Endurance:
    """Errors over windows of runs of 120 s; the constant gain is worse in all of them."""
    return Endurance(
        **{
            **{"begin": np.array([0.0, 15, 30, 60]), "end": np.array([15.0, 30, 60, 120])},
            **{"attitude": np.array([40.0, 6, 5, 5.5]), "position": np.array([3.0, 0.2, 0.1, 0.1])},
            "distance": np.array([3.0, 0.25, 0.2, 0.4]),
            "other_attitude": np.array([42.0, 9, 8, 8.5]),
            "other_position": np.array([3.5, 0.3, 0.2, 0.2]),
            "other_distance": np.array([3.5, 0.35, 0.4, 0.8]),
            **values,
        }
    )


def history(iterations=40, non_finite=0):
    cost = 40 + 20 / np.arange(1.0, iterations + 1)
    return History(cost, cost + 5, cost + 9, np.full(iterations, non_finite))


def trajectory(samples=301, **values):
    rng = np.random.default_rng(0)
    shapes = {"euler": 3, "euler_est": 3, "position": 3, "position_est": 3, "bias_est": 6}
    shapes |= dict.fromkeys(("attitude_parts", "attitude_sigma", "position_sigma"), 3)
    shapes |= {"vector_bias_est": 6, "vector_bias_error": 2}
    names = Trajectory.__dataclass_fields__
    drawn = {
        n: rng.uniform(0.1, 80, (samples, shapes[n]) if n in shapes else samples) for n in names
    }
    return Trajectory(**{**drawn, "time": 0.01 * np.arange(samples), **values})


# In order and without gaps, so that the repairs do not change them.
PARAMETERS = np.array(
    [
        *(0.1, 0.05, 0.1, 0.2, 0.15, 0.2, 0.3, 0.2, 0.4, 0.8, 0.6),
        *(10.0, 5.0, 15.0, 30.0, 20.0, 35.0, 50.0, 40.0, 60.0, 70.0, 65.0),
    ]
)


def result(*settings: str, **values) -> Result:
    """A result on scenarios; `values` are fields of it, of its search or of its evaluation."""
    filter = description("fuzzy", k=values.pop("parameters", PARAMETERS))
    search = {
        "tuned_on": "scenarios",
        "cost": cost_name(None),
        "position_weight": 0.0,
        "best_cost": 41.25,
        "non_finite": 0,
        "compile_seconds": 5.0,
        "search_seconds": 0.25,
        "history": history(),
    }
    judged = {
        "training": {TUNED: np.array([41.0, 41.5]), CONSTANT: np.array([44.0, 46.0])},
        "evaluation": evaluation(),
        "endurance": endurance(),
        "trust": trust(),
        "trajectory": trajectory(),
    }
    for part in (search, judged):
        part |= {name: values.pop(name) for name in [*values] if name in part}
    filter = filter._replace(also=values.pop("also", {}))
    return Result(
        **{
            "experiment": config.override(config.Experiment(), [*BASE, *settings]),
            "filter": filter,
            "search": FoundBy(**search),
            "on_scenarios": OnScenarios(**judged),
            "environment": {"jax": "0.10", "device": "1 x cpu"},
            "version": "1.2.3",
            **values,
        }
    )


def consistent(samples: int = 61, **values) -> Result:
    """A result with consistent parts, so that it can be saved and loaded.

    Args:
        samples: Number of samples of trajectory and error bands, up to 61; 3 scenarios if fewer.
        values: Fields with other values.
    """
    given = evaluation(initial_angle=ANGLES)
    scenarios = 40 if samples == len(TIME) else 3
    contenders = {
        name: Contender(
            Metrics(*(each[:scenarios] for each in one.metrics)),
            Bands(*(band[:, :samples] for band in one.bands)),
            one.filter,
        )
        for name, one in given.contenders.items()
    }
    contenders[TUNED] = contenders[TUNED]._replace(filter=description("fuzzy", k=PARAMETERS))
    return result(
        *("scenario.sampling_time=0.25", f"scenario.duration={0.25 * samples}"),
        *("cost.transient_window=[0, 1]", f"cost.steady_window=[2, {samples - 1}]"),
        "run.training_scenarios=2",
        **{
            "best_cost": float(history().best[-1]),
            "evaluation": replace(given, time=TIME[:samples], contenders=contenders),
            "trajectory": trajectory(samples, time=TIME[:samples]),
            **values,
        },
    )
