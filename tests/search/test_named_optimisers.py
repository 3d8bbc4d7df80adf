"""Optimisers by name: every name, their budgets, and settings of one's own."""

from typing import Any, get_args

import pytest
from experiments import tiny

from posegsa.config import OptimiserName
from posegsa.errors import ConfigError
from posegsa.optimisers import GSA, DifferentialEvolution, Polish, evaluations_spent
from posegsa.search.named_optimisers import TITLES, make_optimiser, size_in_words, specify


def test_every_name_makes_an_optimiser_that_keeps_the_budget() -> None:
    assert set(TITLES) == set(get_args(OptimiserName))
    for name in TITLES:
        experiment = tiny(f"search.optimiser={name}", "search.agents=50", "search.iterations=40")
        spent = evaluations_spent(make_optimiser(experiment))[-1]
        assert 2000 - 8 * 23 < spent <= 2000, name


def test_settings_reach_the_optimiser() -> None:
    made = make_optimiser(specify(tiny(), "de:strategy=best/1/bin:factor=0.7:agents=12", 125))
    assert made == DifferentialEvolution(12, 10, "best/1/bin", 0.7, 0.9)
    assert make_optimiser(specify(tiny(), "gsa:g0=2.5", 60)) == GSA(6, 10, g0=2.5)
    both = make_optimiser(specify(tiny(), "gsa+adam:alpha=3.0:share=0.75:starts=2", 600))
    assert isinstance(both, Polish)
    assert both.first == GSA(6, 25, alpha=3.0)
    assert both.second.agents == 2
    assert both.second.iterations == 450 // 46
    assert specify(tiny(), "random", 60).search.optimiser == "random_search"


@pytest.mark.parametrize(
    ("text", "evaluations", "message"),
    [
        ("gas", 100, "optimiser 'gas' of 'gas'; allowed: random, gsa, "),
        ("gsa:g1=2", 100, "'g1' of 'gsa:g1=2'; allowed: agents, g0, alpha"),
        ("gsa:g0=-2.0", 100, r"gsa\.g0"),
        ("random:g0=2.0", 100, "'g0' of 'random:g0=2.0'; allowed: agents"),
        ("gsa", 5, "evaluations = 5 of 'gsa'; allowed: at least 6"),
        ("adam", 100, "adam.*: 96 evaluations are not enough for one step; allowed: at least 184"),
    ],
)
def test_what_can_not_be_run_is_refused(text: str, evaluations: int, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make_optimiser(specify(tiny(), text, evaluations))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["search.optimiser=de", "search.agents=3"], "agents = 3; allowed: an integer of at least"),
        (["search.optimiser=adam"], "24 evaluations are not enough for one step.*at least 184"),
    ],
)
def test_a_search_too_small_for_its_optimiser_is_refused(settings: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=f"search.optimiser = .*{message}"):
        make_optimiser(tiny(*settings))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("gsa", "50 agents x 40 iterations"),
        ("pycma", "50 agents x 40 iterations"),
        ("adam", "8 starts x 10 steps"),
        ("gsa+adam", "50 agents x 20 iterations, then 8 starts x 5 steps"),
    ],
)
def test_a_search_is_told_in_words(name: str, words: str) -> None:
    settings = [f"search.optimiser={name}", "search.agents=50", "search.iterations=40"]
    assert size_in_words(tiny(*settings)) == words
