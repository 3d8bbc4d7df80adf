"""A resumed run has the bits of an uninterrupted one."""

import resource
import signal

import numpy as np
import pytest
from helpers.arrays import assert_same
from helpers.experiments import tiny

import posegsa
from posegsa import config
from posegsa.errors import (
    CheckpointError,
    ConfigError,
    PosegsaWarning,
    RunFolderError,
    SearchError,
    SearchInterrupted,
)
from posegsa.optimisers import GSA, lengthened
from posegsa.saving import checkpointing
from posegsa.saving.checkpoint import read
from posegsa.saving.checkpointing import CheckpointWriter, newest_checkpoint
from posegsa.saving.interrupt import StopRequest
from posegsa.saving.resume import experiment_to_resume
from posegsa.search.problem import tuning_problem
from posegsa.search.run_search import first_search, run_search

LONG = tiny("search.iterations=8", "checkpoint.iterations=3")


@pytest.fixture(scope="module")
def task():
    return tuning_problem(LONG)


@pytest.fixture(scope="module")
def whole(task):
    """The search without interruption."""
    return run_search(task).search


def search_in(folder, task, *, stop_at=(), experiment=LONG, earlier=None):
    """Search with checkpoints; a signal asks to stop after each of these iterations."""
    search, asked = None, StopRequest()
    if earlier is not None:
        search = earlier.checkpoint.search(first_search(task))

    def tell(progress) -> None:
        if progress.iteration in stop_at:
            asked.signal_number = signal.SIGTERM

    with CheckpointWriter(folder, experiment, asked) as keep:
        return run_search(task, tell, search=search, after_chunk=keep).search


def names(folder) -> list[int]:
    return sorted(int(path.stem) for path in (folder / "checkpoints").glob("*.checkpoint"))


def test_checkpoints_come_at_their_intervals_and_the_last_two_stay(task, whole, tmp_path):
    assert_same(search_in(tmp_path, task), whole)
    assert names(tmp_path) == [6, 8]
    about = read(tmp_path / "checkpoints" / "000000008.checkpoint").about
    assert config.from_dict(about["experiment"]) == LONG
    assert about["search_seconds"] > 0


def test_intervals_in_seconds_and_clocks_that_jump(task, whole, tmp_path):
    """A clock that goes back only delays the next checkpoint."""
    times = iter([0.0, 1e9, -1e9, *np.linspace(0, 99, 99)])
    hasty = config.override(LONG, ["checkpoint.seconds=5.0", "checkpoint.iterations=1000"])
    with CheckpointWriter(tmp_path, hasty, StopRequest(), clock=lambda: next(times)) as keep:
        assert_same(run_search(task, after_chunk=keep).search, whole)
    assert names(tmp_path)[-1] == 8


def test_what_took_long_is_saved_at_once(task, whole, tmp_path):
    """The process may have to end before the next chunk is done."""
    rarely = config.override(LONG, ["checkpoint.iterations=1000"])
    with CheckpointWriter(tmp_path, rarely, StopRequest()) as keep:
        for iteration, seconds in enumerate((0.0, 1.0, 2.0, 60.0)):
            search = whole._replace(iteration=np.asarray(iteration))
            keep(search, seconds, 0.0)
            assert (iteration in names(tmp_path)) == (iteration in (0, 3))


@pytest.mark.parametrize("stops", [[0], [1], [4], [6], [7], [1, 2, 3, 5, 6]])
def test_it_resumes_bit_for_bit_wherever_it_was_stopped(task, whole, tmp_path, stops):
    earlier = None
    for at in stops:
        with pytest.raises(SearchInterrupted, match=rf"of 8.*--resume {tmp_path}") as stopped:
            search_in(tmp_path, task, stop_at=[at], earlier=earlier)
        assert stopped.value.signal_number == signal.SIGTERM
        earlier = newest_checkpoint(tmp_path)
        # The signal is seen when the running chunk, here an iteration, is done.
        assert earlier.checkpoint.search(first_search(task)).iteration == at + 1
    assert_same(search_in(tmp_path, task, earlier=earlier), whole)


def test_a_signal_after_the_last_chunk_stops_too(task, whole, tmp_path):
    """All iterations are done, but nothing is judged: the run stops as requested."""
    with pytest.raises(SearchInterrupted, match=r"iteration 8 of 8.*--resume"):
        search_in(tmp_path, task, stop_at=[8])
    earlier = newest_checkpoint(tmp_path)
    reports = []
    with CheckpointWriter(tmp_path, LONG, StopRequest()) as keep:
        search = earlier.checkpoint.search(first_search(task))
        found = run_search(task, reports.append, search=search, after_chunk=keep).search
    assert_same(found, whole)
    assert [p.iteration for p in reports] == [8], "nothing is left to search"


def test_a_skipped_damaged_checkpoint_does_not_count(task, tmp_path):
    search_in(tmp_path, task)
    newest = tmp_path / "checkpoints" / "000000008.checkpoint"
    newest.write_bytes(b"damaged")
    (tmp_path / "checkpoints" / "000000004.checkpoint").write_bytes(b"an earlier one")
    copied = tmp_path / "checkpoints" / "copy.checkpoint"
    with pytest.warns(PosegsaWarning, match="000000006"):
        earlier = newest_checkpoint(tmp_path)
    copied.write_bytes(b"somebody's own")
    with CheckpointWriter(tmp_path, LONG, StopRequest()) as keep:
        keep(earlier.checkpoint.search(first_search(task)), 0.0, 0.0)
    copied.unlink()
    assert names(tmp_path) == [4, 6], "what was just written stays, with the one before"
    assert newest_checkpoint(tmp_path).checkpoint.search(first_search(task)).iteration == 6


def test_a_damaged_checkpoint_is_reported_and_the_previous_one_is_used(task, whole, tmp_path):
    search_in(tmp_path, task)
    newest = tmp_path / "checkpoints" / "000000008.checkpoint"
    newest.write_bytes(newest.read_bytes()[:-5])
    with pytest.warns(PosegsaWarning, match=r"000000008.*damaged.*000000006"):
        earlier = newest_checkpoint(tmp_path)
    assert_same(search_in(tmp_path, task, earlier=earlier), whole)
    for path in (tmp_path / "checkpoints").iterdir():
        path.write_bytes(b"")
    with pytest.raises(CheckpointError, match=r"000000008(.|\n)*000000006(.|\n)*no checkpoint"):
        newest_checkpoint(tmp_path)


def test_what_another_machine_made_is_reported(task, tmp_path, monkeypatch):
    here = checkpointing.environment()
    earlier = {name: value for name, value in here.items() if name != "posegsa"}
    for made, said in (
        (here | {"jax": "0.99"}, r"jax 0\.99, here 0\.\d+\.\d+\)"),
        (here | {"posegsa": "9.9"}, rf"\(posegsa 9\.9, here {here['posegsa']}\)"),
        (earlier, rf"\(posegsa unknown, here {here['posegsa']}\)"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(checkpointing, "environment", lambda made=made: made)
            search_in(tmp_path, task)
        with pytest.warns(PosegsaWarning, match=said):
            newest_checkpoint(tmp_path)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("run.seed=4", r"run.seed = 4\s.* 0"),
        ("run.dtype=float64", "run.dtype"),
        ("filter.gamma=5.0", "filter.gamma"),
        ("scenario.landmarks.0.noise=0.2", "scenario.landmarks.0.noise"),
        ("run.held_out_scenarios=4", "run.held_out_scenarios"),
        ("search.iterations=7", "search.iterations = 7\\s.* 8"),
        ("search.g0=7.0", "search.g0 = 7.0\\s.* 100.0"),
        ("search.optimiser=de", 'search.optimiser = "de"\\s.* gsa'),
        ("search.decay_iterations=5", r"search.decay_iterations = 5\s.* all"),
    ],
)
def test_another_experiment_is_refused_by_what_differs(setting, said):
    with pytest.raises(ConfigError, match=said):
        experiment_to_resume(LONG, config.override(LONG, [setting]))


def test_intervals_and_more_iterations_may_differ():
    asked = config.override(LONG, ["checkpoint.keep=5", "search.iterations=20"])
    agreed = experiment_to_resume(LONG, asked)
    assert agreed == config.override(asked, ["search.decay_iterations=8"])
    again = experiment_to_resume(agreed, config.override(LONG, ["search.iterations=30"]))
    assert again.search.decay_iterations == 8
    assert again.search.iterations == 30
    by_chance = config.override(LONG, ["search.optimiser=random_search"])
    more = config.override(by_chance, ["search.iterations=30"])
    assert experiment_to_resume(by_chance, more) == more, "random search has no schedule to hold"


def test_a_disk_that_fills_does_not_stop_the_search(task, whole, tmp_path):
    """With a real limit of the system on the size of files, for a while."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill_and_clear(progress) -> None:
        room = 100 if progress.iteration in range(2, 7) else soft
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))

    often = config.override(LONG, ["checkpoint.iterations=1"])
    try:
        with (
            pytest.warns(PosegsaWarning, match=r"File too large.* 2"),
            CheckpointWriter(tmp_path, often, StopRequest()) as keep,
        ):
            assert_same(run_search(task, fill_and_clear, after_chunk=keep).search, whole)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert names(tmp_path)[-1] == 8
    assert_same(newest_checkpoint(tmp_path).checkpoint.search(first_search(task)), whole)


def test_a_disk_that_is_full_at_first_is_reported_before_the_search(task, tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        with pytest.raises(CheckpointError, match="cannot be written: File too large"):
            search_in(tmp_path, task)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not any((tmp_path / "checkpoints").iterdir())


def test_what_jax_raises_says_how_to_resume(task, whole, tmp_path):
    from jax.errors import JaxRuntimeError

    def fail(progress) -> None:
        if progress.iteration == 5:
            raise JaxRuntimeError("RESOURCE_EXHAUSTED: no memory")

    with (
        pytest.raises(SearchError, match=r"iteration 5 of 8.*--resume"),
        CheckpointWriter(tmp_path, LONG, StopRequest()) as keep,
    ):
        run_search(task, fail, after_chunk=keep)
    assert_same(search_in(tmp_path, task, earlier=newest_checkpoint(tmp_path)), whole)


def test_an_extended_run_is_that_of_its_experiment_from_the_start(task, whole, tmp_path):
    """G and K_best are constant from the eighth iteration on; the configuration says so."""
    search_in(tmp_path, task)
    earlier = newest_checkpoint(tmp_path)
    more = experiment_to_resume(
        earlier.about.experiment, config.override(LONG, ["search.iterations=11"])
    )
    longer = task._replace(experiment=more)
    extended_search = lengthened(earlier.checkpoint.search(first_search(task)), 11)
    extended = run_search(longer, search=extended_search).search
    assert_same(extended, run_search(longer).search)
    assert (extended.history.best[:8] == whole.history.best).all()
    held, longest = (o.schedule()[0] for o in (more.search, GSA(agents=6, iterations=11)))
    assert (held[:8] < longest[:8]).all(), "it is not the longer run"


def test_resume_refuses_what_it_cannot_mean(tmp_path):
    with pytest.raises(RunFolderError, match="not a folder"):
        posegsa.tune(resume=tmp_path / "none")
    with pytest.raises(RunFolderError, match="no checkpoint"):
        posegsa.tune(resume=tmp_path)
    with pytest.raises(ValueError, match="overwrite = True"):
        posegsa.tune(resume=tmp_path, overwrite=True)
    with pytest.raises(ValueError, match="out = "):
        posegsa.tune(resume=tmp_path, out=tmp_path / "other")
    with pytest.raises(RunFolderError, match="resume = 5"):
        posegsa.tune(resume=5)


def test_a_checkpoint_names_its_experiment(task, tmp_path):
    """A checkpoint of a search outside a tuning run is refused."""
    (tmp_path / "checkpoints").mkdir()
    path = tmp_path / "checkpoints" / "000000001.checkpoint"
    posegsa.save_search(path, first_search(task))
    with pytest.raises(CheckpointError, match="tuning run"):
        newest_checkpoint(tmp_path)
