"""Large populations in pieces: the same bits as in one compiled call, and a word between them."""

import math
import warnings

import jax
import numpy as np
import pytest
from bits import assert_same
from experiments import tiny
from hypothesis import given
from hypothesis import strategies as st

from posegsa.errors import PosegsaWarning
from posegsa.optimisers import gsa
from posegsa.search import devices, large_populations
from posegsa.search import run as searching
from posegsa.search.build import tuning_problem
from posegsa.search.large_populations import (
    agents_in_piece,
    is_large,
    places,
    scenarios_in_piece,
    work,
)
from posegsa.search.run import run_search, search_batch

pytestmark = pytest.mark.optimised

SAMPLES = 200
SCENARIOS, AGENTS = 9, 1100
"""More than the smallest piece on the four devices that tests have, 8 and 1024."""


def problem(*settings: str):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PosegsaWarning)
        common = (
            f"search.agents={AGENTS}",
            "search.iterations=3",
            f"run.training_scenarios={SCENARIOS}",
        )
        return tuning_problem(tiny(*common, *settings))


@pytest.fixture(scope="module")
def task():
    return problem()


@pytest.fixture(scope="module")
def whole(task):
    """The search by one compiled program."""
    assert not is_large(task)
    return run_search(task).search


@pytest.fixture
def small_pieces(monkeypatch):
    """The smallest pieces, and five parts of GSA's step."""
    monkeypatch.setattr(large_populations, "WORK", SAMPLES)
    monkeypatch.setattr(gsa, "PART", gsa.PULL_SECONDS * AGENTS**2 * 22 / 4.5)


@pytest.mark.usefixtures("small_pieces")
def test_pieces_give_the_bits_of_the_whole_and_say_how_far_they_are(task, whole):
    assert is_large(task)
    told = []
    assert_same(run_search(task, told.append).search, whole)
    # Two chunks of the agents, two groups of the scenarios, five parts: nine calls.
    shares = [progress.share for progress in told if progress.iteration == 1]
    assert shares == pytest.approx([0, *(np.arange(1, 10) / 9)])
    assert told[-1].iteration == 3
    assert told[-1].share == 0


@pytest.mark.usefixtures("small_pieces")
def test_they_do_so_on_several_devices_and_in_a_batch(task, whole, monkeypatch):
    mesh = devices.mesh_of(jax.devices()[:2])
    monkeypatch.setattr(searching, "mesh_for", lambda simulations: mesh)
    other = task._replace(experiment=task.experiment.replace(**{"run.seed": 7}))
    first, second = (found.search for found in search_batch([task, other], None))
    assert_same(first, whole)
    assert second.best_cost != whole.best_cost


def test_searches_that_are_too_much_together_run_one_by_one(task, whole, monkeypatch):
    monkeypatch.setattr(large_populations, "WORK", work(task))
    assert not is_large(task)
    told = []
    first, second = (found.search for found in search_batch([task, task], told.append))
    assert_same(first, whole)
    assert_same(second, whole)
    assert [p.share for p in told if p.iteration == 2] == [0, 0.5, 1]


def test_gradients_go_in_pieces_too(monkeypatch):
    """Of any size to the same bits; a program of the whole may round a position otherwise."""
    task = problem("search.optimiser=adam", "search.agents=4", "search.iterations=3")
    whole = run_search(task).search
    found = []
    for agents in (1, 2):
        monkeypatch.setattr(large_populations, "WORK", agents * SCENARIOS * 22 * SAMPLES)
        assert is_large(task)
        found.append(run_search(task).search)
    assert_same(*found)
    np.testing.assert_allclose(found[0].best_position, whole.best_position, rtol=1e-5)
    np.testing.assert_allclose(found[0].history.best, whole.history.best, rtol=1e-5)


@given(
    agents=st.integers(1, 10**5),
    scenarios=st.integers(1, 2000),
    length=st.integers(2, 10**5),
    most=st.integers(10**5, 10**9),
    turns=st.integers(2, 16),
)
def test_pieces_cover_everything_within_the_bound(agents, scenarios, length, most, turns):
    least = turns * large_populations.PIECE
    some = agents_in_piece(agents, scenarios * length, most, least)
    part = scenarios_in_piece(some, scenarios, length, most, turns if some <= least else 1)
    assert some <= agents
    assert some == agents or some % least == 0
    assert some * part * length <= most or (some <= least and part <= turns)
    assert part == scenarios or some <= least
    for count, size in ((agents, some), (scenarios, part)):
        begins = places(count, size)
        assert len(begins) == math.ceil(count / size)
        assert begins[0] == 0
        assert begins[-1] + size == count
        assert all(0 <= step <= size for step in np.diff(begins))
