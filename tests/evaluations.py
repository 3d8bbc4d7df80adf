"""Evaluations and trust made of random numbers."""

from dataclasses import replace

import numpy as np

from posegsa.judging.evaluation import (
    CONSTANT,
    ORACLE,
    RANDOM,
    SMOOTH,
    TUNED,
    Contender,
    Evaluation,
)
from posegsa.judging.metrics import Bands, Metrics
from posegsa.judging.trust import Trust

TIME = np.linspace(0, 15, 61)


SCHEDULES = {
    TUNED: {"kind": "fuzzy", "k": [0.5] * 22},
    CONSTANT: {"kind": "constant", "gain": 53.5},
    RANDOM: {"kind": "fuzzy", "k": [0.5] * 22},
    SMOOTH: {"kind": "smooth", "low": 20.0, "high": 90.0, "half": 0.1},
    ORACLE: {
        **{"kind": "open loop", "time": [0.0, 7.5, 15.0], "gain": [90.0, 50.0, 10.0]},
        **{"cost_fitted": 36.0, "steps": 80, "converged": True},
    },
}


def contender(seed: int, scenarios: int = 40, schedule=None, **metrics) -> Contender:
    rng = np.random.default_rng(seed)
    drawn = {name: rng.uniform(1, 40, scenarios) for name in Metrics._fields}
    drawn["diverged"] = np.zeros(scenarios, bool)
    drawn["initial_angle"] = np.full(scenarios, 174.8)
    bands = Bands(*np.sort(rng.uniform(0.1, 50, (3, 3, len(TIME))), axis=1))
    return Contender(Metrics(**{**drawn, **metrics}), bands, schedule or {})


def evaluation(names=tuple(SCHEDULES), seed=None, **metrics) -> Evaluation:
    """Contenders with random metrics; some fields may be given for all of them."""
    all_of_them = {
        name: contender(i, schedule=SCHEDULES.get(name), **metrics) for i, name in enumerate(names)
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


ANGLES = np.linspace(0, 180, 40)
