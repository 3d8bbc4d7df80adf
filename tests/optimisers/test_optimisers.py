"""The registered optimisers: their searches, budgets and names."""

from typing import Any

import jax
import numpy as np
import pytest
from helpers.experiments import tiny
from helpers.searches import AGENTS, ITERATIONS, steered

from posegsa import config
from posegsa.comparing import specify
from posegsa.errors import ConfigError
from posegsa.optimisers import (
    GSA,
    OPTIMISERS,
    Adam,
    DifferentialEvolution,
    Optimiser,
    PolishedGSA,
    RandomSearch,
    box,
    minimise,
    start,
)
from posegsa.settings.violations import Refused

EACH = pytest.mark.parametrize("name", OPTIMISERS)


def switched(name: str, *settings: str) -> Optimiser:
    """The default search with another optimiser."""
    return config.override(config.Experiment(), [f"search.optimiser={name}", *settings]).search


@EACH
def test_a_name_is_that_of_its_class_and_settings_are_described(name: str) -> None:
    kind = OPTIMISERS[name]
    made = kind()
    assert made.optimiser == name
    assert kind.title != Optimiser.title
    for key, field in kind.model_fields.items():
        assert field.description, key
    assert list(kind.model_fields)[:3] == ["optimiser", "agents", "iterations"]
    assert hash(made) == hash(kind(**made.model_dump()))
    with pytest.raises(ConfigError, match="iterations = 0"):
        kind(iterations=0)
    with pytest.raises(ConfigError, match=r"fo\n\s*unknown key"):
        kind(fo=1)


@EACH
def test_an_experiment_with_it_goes_to_toml_and_back(name: str) -> None:
    import tomllib

    experiment = config.Experiment(search=switched(name))
    text = config.to_toml(experiment)
    assert config.from_dict(tomllib.loads(text)) == experiment
    assert f'optimiser = "{name}"' in text
    only = config.from_dict({"search": {"optimiser": name}})
    assert only.search == OPTIMISERS[name]()


@EACH
def test_it_keeps_a_budget(name: str) -> None:
    each = OPTIMISERS[name]()
    assert 25000 - 8 * 23 < each.within(25000).evaluations <= 25000
    small = each.within(1500)
    assert small.evaluations <= 1500
    assert small.total_iterations == len(small.evaluations_spent())


ELSEWHERE = ("cma_es", "adam", "gsa+adam")
"""Optimisers tested in `test_cma_es` and `test_adam`."""


@pytest.mark.parametrize("name", [name for name in OPTIMISERS if name not in ELSEWHERE])
def test_it_searches(name: str) -> None:
    small = OPTIMISERS[name](agents=AGENTS).within(AGENTS * ITERATIONS)
    search = minimise(steered, box([-1, -2, 0], [3, 2, 0]), small, KEY)
    assert search.iteration == small.iterations == ITERATIONS
    assert search.best_cost < 0.2 * search.history.best[0]


KEY = jax.random.key(0)


def test_another_optimiser_keeps_the_size_or_the_budget_of_the_one_before() -> None:
    before = config.Experiment().search
    assert switched("gsa") == GSA(agents=before.agents, iterations=before.iterations)
    of_size = ["search.agents=30", "search.iterations=40"]
    named = ["search.optimiser=gsa", *of_size, "search.g0=3.0"]
    experiment = config.override(config.Experiment(), named)

    def of(*settings: str) -> Optimiser:
        return config.override(experiment, list(settings)).search

    assert of("search.optimiser=gsa") == GSA(agents=30, iterations=40, g0=3.0)
    assert of("search.optimiser=de") == DifferentialEvolution(agents=30, iterations=40)
    assert of("search.agents=9", "search.optimiser=de").agents == 9
    assert of("search.optimiser=gsa+adam") == PolishedGSA(agents=30, iterations=40)
    assert of("search.optimiser=adam") == Adam(agents=8, iterations=1200 // (8 * 23))
    four = of("search.optimiser=adam", "search.agents=4", "search.gradient_price=10")
    assert four == Adam(agents=4, iterations=30, gradient_price=10)
    assert of("search.optimiser=adam", "search.iterations=7") == Adam(agents=8, iterations=7)
    back = config.override(experiment.model_copy(update={"search": four}), ["search.optimiser=gsa"])
    assert back.search == GSA(agents=100, iterations=12), "by evaluations, not by 4 agents"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            ["search.optimiser=gas"],
            r"search.optimiser = .gas.\s+should be 'gsa', 'random_search'",
        ),
        (["search.optimiser=3"], r"search.optimiser = 3\s+should be 'gsa', 'random_search'"),
        (["search.optimiser=de", "search.g0=1.0"], r"search.g0\s+unknown key; known .* strategy"),
        (["search.optimiser=de", "search.agents=3"], r"agents = 3\s+should be .* equal to 4"),
        (["search.optimiser=adam", "search.agents=0"], r"agents = 0\s+should be .* equal to 1"),
        (["search.optimiser=adam", "search.agents=2000"], "at least 46000, one iteration of adam"),
        (
            ["search.optimiser=gsa+adam", "search.agents=2", "search.iterations=9"],
            "leaves 10 of 2 x 9",
        ),
        (["search.g1=2.0"], "unknown key"),
        (["gsa.g0=2.0"], r"gsa\s+unknown key; did you mean search.g0\?"),
    ],
)
def test_an_impossible_optimiser_is_refused_by_its_key(settings: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        config.override(config.Experiment(), settings)


@pytest.mark.parametrize("search", [3, "gsa", None, [], Optimiser])
def test_a_search_that_is_no_table_is_refused(search: Any) -> None:
    with pytest.raises(ConfigError, match=r"search = [^;]*a table with the keys optimiser, agents"):
        config.from_dict({"search": search})


# Descriptions, and the texts of a comparison ------------------------------------------------------


@pytest.mark.parametrize(
    ("search", "words"),
    [
        (GSA(agents=50, iterations=40), "50 agents x 40 iterations"),
        (RandomSearch(agents=1, iterations=1), "1 agent x 1 iteration"),
        (Adam(agents=8, iterations=10), "8 starts x 10 steps"),
        (
            PolishedGSA(agents=50, iterations=40),
            "50 agents x 20 iterations, then 8 starts x 5 steps",
        ),
    ],
)
def test_a_search_is_described(search: Optimiser, words: str) -> None:
    assert search.size_in_words() == words


def test_a_text_gives_settings_of_its_own_and_a_budget_the_iterations() -> None:
    chosen = specify(tiny(), "de:strategy=best/1/bin:factor=0.7:agents=12", 125)
    assert chosen == DifferentialEvolution(
        agents=12, iterations=10, strategy="best/1/bin", factor=0.7
    )
    assert specify(tiny("search.alpha=3.0"), "gsa:g0=2.5", 60) == GSA(
        agents=6, iterations=10, g0=2.5, alpha=3.0
    )
    assert specify(tiny(), "adam", 400) == Adam(agents=8, iterations=2)
    both = specify(tiny(), "gsa+adam:alpha=3.0:share=0.75:starts=2", 600)
    search, descent = both.phases
    assert search == GSA(agents=6, iterations=25, alpha=3.0)
    assert (descent.agents, descent.iterations) == (2, 450 // 46)
    assert all(specify(tiny(), name, 600).evaluations > 400 for name in OPTIMISERS)


@pytest.mark.parametrize(
    ("text", "evaluations", "message"),
    [
        ("gas", 100, "optimiser 'gas' of 'gas'; allowed: gsa, random_search, "),
        ("random", 100, "optimiser 'random'"),
        ("gsa:g1=2", 100, "'g1' of 'gsa:g1=2'; allowed: agents, g0, alpha"),
        ("gsa:iterations=2", 100, "'iterations' of .*; allowed: agents, g0, alpha"),
        ("gsa:g0=-2.0", 100, r"search\.g0 = -2\.0"),
        ("random_search:g0=2.0", 100, "'g0' of 'random_search:g0=2.0'; allowed: agents"),
        ("gsa", 5, "evaluations = 5; allowed: at least 6, one iteration of gsa"),
        ("adam", 100, "evaluations = 100; allowed: at least 184, one iteration of adam"),
    ],
)
def test_a_text_that_means_nothing_is_refused(text: str, evaluations: int, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        specify(tiny(), text, evaluations)


# Resuming -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [n for n in OPTIMISERS if "adam" not in n])
def test_a_search_may_be_given_more_iterations_and_nothing_else(name: str) -> None:
    earlier = OPTIMISERS[name](iterations=8)
    longer = earlier.resumed(earlier.changed(iterations=20))
    assert longer.iterations == 20
    assert longer.resumed(earlier.changed(iterations=30)).iterations == 30
    assert earlier.resumed(earlier) == earlier
    with pytest.raises(Refused, match=r"iterations = 7\s+the run has 8; allowed: as many or more"):
        earlier.resumed(earlier.changed(iterations=7))
    with pytest.raises(Refused, match=r"agents = 9\s+the run has 100; allowed: the same"):
        earlier.resumed(earlier.changed(agents=9))
    with pytest.raises(Refused, match=rf'optimiser = "adam"\s+the run has {name}'):
        earlier.resumed(Adam(iterations=8))


@pytest.mark.parametrize("earlier", [Adam(iterations=8), PolishedGSA(iterations=80)])
def test_a_descent_ends_with_its_iterations(earlier: Optimiser) -> None:
    assert earlier.resumed(earlier) == earlier
    for iterations in (earlier.iterations - 1, earlier.iterations + 1):
        with pytest.raises(Refused, match="the same, as Adam's steps shrink towards the end"):
            earlier.resumed(earlier.changed(iterations=iterations))


def test_gravity_holds_its_last_values_past_the_iterations_it_began_with() -> None:
    earlier = GSA(iterations=8)
    longer = earlier.resumed(GSA(iterations=20))
    assert longer == GSA(iterations=20, decay_iterations=8)
    assert longer.resumed(GSA(iterations=30)) == GSA(iterations=30, decay_iterations=8)
    np.testing.assert_array_equal(longer.schedule()[0][:8], earlier.schedule()[0])
    assert (longer.schedule()[0][8:] == earlier.schedule()[0][-1]).all()
    with pytest.raises(Refused, match=r"decay_iterations = 5\s+the run has all"):
        earlier.resumed(GSA(iterations=8, decay_iterations=5))


def test_an_optimiser_that_follows_none_accepts_no_start() -> None:
    state = start(GSA(agents=3), box([0], [1]), KEY).state
    with pytest.raises(NotImplementedError, match="GSA can't begin"):
        GSA(agents=3).begin_at(state, jax.numpy.zeros(1))
