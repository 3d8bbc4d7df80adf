"""Experiments so small that a test can run them whole."""

from posegsa import config

BASE = [
    "family.attitude_error=off",
    "family.position_error=off",
    "family.random_phase=false",
    "filter.gamma=[5.0, 10.0]",
    "filter.gamma_law=fixed",
    "filter.vector_bias=off",
    "filter.cross_vector_weight=1.0",
    "gain.smoothing=2.0",
    "gain.error_scale=1.0",
    "parameters.also=[]",
    "search.optimiser=gsa",
]
"""The paper's scenario and filter with two sub-steps and smoothing, searched by GSA."""
TINY = [
    *BASE,
    "scenario.duration=2.0",
    "cost.steady_window=[150, 199]",
    "search.agents=6",
    "search.iterations=4",
    "run.training_scenarios=3",
    "run.held_out_scenarios=3",
]
"""As many scenarios to train on as held out: what has one shape is compiled once."""


def tiny(*settings: str) -> config.Experiment:
    return config.override(config.Experiment(), [*TINY, *settings])
