"""The warnings of a search before it starts. For resuming see `saving/test_resume`."""

import warnings

import pytest
from helpers.experiments import tiny

from posegsa.errors import PosegsaWarning
from posegsa.search import run_search
from posegsa.search.problem import tuning_problem

pytestmark = pytest.mark.filterwarnings("ignore:scenario.initial_rotation:posegsa.PosegsaWarning")


def test_an_iteration_that_takes_long_is_announced(monkeypatch) -> None:
    task = tuning_problem(tiny())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run_search.run_search(task)
    # 6 agents x 3 scenarios x 200 samples
    monkeypatch.setattr(run_search, "SAMPLES_PER_SECOND", 100.0)
    with pytest.warns(PosegsaWarning, match=r"an iteration simulates 3\.6e\+03 samples.* 36 s"):
        run_search.run_search(task)


def test_an_iteration_of_a_batch_is_as_long_as_those_of_all_its_searches(monkeypatch) -> None:
    task = tuning_problem(tiny())
    monkeypatch.setattr(run_search, "SAMPLES_PER_SECOND", 900.0)  # 4 s each
    with pytest.warns(PosegsaWarning, match="7.2e\\+03 samples.* 8 s"):
        run_search.search_batch([task, task], None)


def test_a_gradient_counts_once_for_each_dimension() -> None:
    task = tuning_problem(tiny())
    adam = tiny("search.optimiser=adam", "search.agents=6").search
    by_gradients = task._replace(experiment=task.experiment.model_copy(update={"search": adam}))
    assert run_search.samples_per_iteration(by_gradients) == 22 * run_search.samples_per_iteration(
        task
    )
