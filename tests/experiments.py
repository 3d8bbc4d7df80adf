"""Experiments so small that a test can run them whole."""

from posegsa import config

TINY = [
    "scenario.duration=2.0",
    "cost.steady_window=[150, 199]",
    "search.agents=6",
    "search.iterations=4",
    "run.training_scenarios=2",
    "run.held_out_scenarios=3",
]


def tiny(*settings: str) -> config.Experiment:
    return config.override(config.Experiment(), [*TINY, *settings])
