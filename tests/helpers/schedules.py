"""Tuned schedules without a search, for the tests of exports and streams."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import posegsa
from helpers.controllers import search_vectors
from helpers.experiments import paper
from helpers.results import TIME, contender, description, result, trust
from posegsa.judging.evaluation import CONSTANT, TUNED, Evaluation
from posegsa.judging.result import Result
from posegsa.model.fuzzy import FuzzyController

COUNT = 10_000


def tuned(k: np.ndarray, *settings: str, dtype: str = "float32", **values: Any) -> Result:
    """A result with this vector k; the data about the search are made up."""
    experiment = paper(*settings, dtype=dtype)
    with jax.enable_x64(dtype == "float64"):
        space = posegsa.parameter_space(experiment)
        vector = space.vector(space.controller(space.checked(k)))
        repaired = np.asarray(vector, np.float64)
    costs = {TUNED: [41.0, 43.5, 45.25], CONSTANT: [44.0, 46.0, 52.5]}
    filters = {
        TUNED: description("fuzzy", k=repaired),
        CONSTANT: description("constant", gain=27.5),
    }
    contenders = {
        name: contender(0, 3, filters[name], cost=np.array(cost)) for name, cost in costs.items()
    }
    made_up: dict[str, Any] = {
        "experiment": experiment,
        "parameters": repaired,
        "best_cost": 40.5,
        "training": {TUNED: np.array([40.0, 41.0]), CONSTANT: np.array([44.0, 45.0])},
        "evaluation": Evaluation(seed=None, time=TIME, contenders=contenders),
        "trust": trust(cost_float32=40.5, cost_float64=40.5, cost_perturbed=40.5),
        "version": "0.0.1",
    }
    return result(**made_up | values)


K, *DRAWN = search_vectors(1, seed=5)[0], *search_vectors(4)
"""An ordinary vector and others; without repair, DRAWN[0], [1] and [3] have gaps."""
GAPS = ("fuzzy.coverage=false",)
MIDRANGE = (*GAPS, "fuzzy.no_rule=midrange")
SAMPLED = ("fuzzy.centroid=sampled",)


def inputs() -> np.ndarray:
    """Errors, rates and last gains (3, COUNT): the first two in and beyond [0, 1], often small."""
    rng = np.random.default_rng(0)
    error, rate = rng.uniform(-0.1, 1.1, (2, COUNT))
    error[::2], rate[::2] = error[::2] ** 2, np.abs(rate[::2]) ** 3
    return np.stack([error, rate, rng.uniform(1, 101, COUNT)])


def evaluated(controller: FuzzyController, given: np.ndarray) -> np.ndarray:
    """Gains for (error, rate, last gain) (3, n) or (error, rate) (2, n), at one shape for all n.

    Not jitted: where the area of the fired terms is 0, fusing a multiplication with an addition
    decides between two gains.
    """
    padded = np.resize(given.T, (COUNT, len(given))).T
    with jax.disable_jit():
        gains = controller(*(jnp.asarray(x, controller.output_terms.dtype) for x in padded))
    return np.asarray(gains)[: given.shape[1]]
