"""`posegsa compare`: on the filter and on functions, its folder, its table and its figure."""

import json
import shutil
import warnings
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import tiny
from helpers.messages import assert_states
from scipy import stats

import posegsa
from posegsa import comparing, config
from posegsa.cli.command import main
from posegsa.errors import ArgumentError, MemoryLimitError, PosegsaWarning, RunFolderError
from posegsa.figures.comparison_figures import plot_comparison
from posegsa.judging.comparison import Gradients, OptimiserComparison, Repeat, quantiles
from posegsa.optimisers import GSA, minimise
from posegsa.optimisers.functions import ClassicalFunction
from posegsa.saving.comparison_files import SCHEMA, load_comparison
from posegsa.saving.folder import locked_folder
from posegsa.saving.records import from_json, to_json
from posegsa.search import memory
from posegsa.search.keys import keys
from posegsa.search.population import costs_by_scenario
from posegsa.search.problem import tuning_problem
from posegsa.steps import Step

SPHERE = ClassicalFunction("sphere", 2)


def repeat(cost: float, held_out: float | None = None) -> Repeat:
    """A search that reached its final cost half-way."""
    best = [4 * cost, 2 * cost, cost, cost]
    return Repeat(cost, held_out, [0.0], 2.0, 0.1, 0, [10, 20, 30, 40], best, [0.5, 1, 1.5, 2.0])


def made(**costs: list[float]) -> OptimiserComparison:
    """A comparison with these final costs; held-out costs are higher by 1."""
    repeats = {name: [repeat(c, c + 1) for c in each] for name, each in costs.items()}
    return OptimiserComparison("something", 40, {"a": 1}, repeats)


A, B = [1.0, 2.0, 3.0, 4.0, 5.0, 6.5], [1.5, 3.0, 4.75, 4.25, 6.25, 5.9]


def test_the_others_are_tested_against_the_first_over_repeats() -> None:
    comparison = made(a=A, b=B, c=[c + 9 for c in A])
    found = comparison.versus_first()
    raw = [stats.wilcoxon(np.subtract(A, B), method="exact").pvalue, 2 / 2**6]
    assert found["b"].difference == pytest.approx(np.median(np.subtract(A, B)))
    assert raw[0] > 2 * raw[1]
    assert found["b"].p == pytest.approx(raw[0])
    assert found["c"].p == pytest.approx(2 * raw[1])
    assert comparison.versus_first(held_out=True) == found


def test_repeats_that_only_one_has_made_are_not_paired() -> None:
    more, fewer = made(a=[*A, 0.0, 0.0], b=B), made(a=A, b=B)
    assert more.versus_first() == fewer.versus_first()
    assert len(more.costs("a")) == 8


def test_levels_evaluations_and_seconds() -> None:
    comparison = made(a=A, b=B)
    assert comparison.levels() == [4.5, 3.5]
    evaluations, seconds, share = comparison.reached("a", 4.0)
    # Evaluations until a cost of 4: 10, 20, 30, 30, and never in two repeats.
    assert (evaluations, seconds, share) == (30, 1.5, pytest.approx(4 / 6))
    assert comparison.reached("a", 0.5) == (np.inf, np.inf, 0)
    # Half of them is enough, and stored costs are rounded: each optimiser reaches its own median.
    assert comparison.reached("a", 3.0)[0::2] == (30, 0.5)
    assert comparison.reached("a", 3.0 - 1e-8)[2] == 0.5
    assert comparison.reached("a", 3.0 - 1e-4)[2] < 0.5
    table = comparison.table([4.0])
    assert_states(table, "something", "6 repeats", "40", "held out", "to 4", "30 (1.5 s")
    assert comparison.markdown([4.0]).count("| --- ") == len(comparison.rows([4.0])[0])


def test_quartiles_are_the_usual_ones_and_infinite_among_infinite_costs() -> None:
    for values in (A, A[:5], [1.0, 2.0]):
        np.testing.assert_allclose(
            quantiles(np.array(values)), np.quantile(values, [0.25, 0.5, 0.75])
        )
    known = [(1, 1, np.inf), (np.inf, np.inf), (1, 2, 3, np.inf, np.inf), (np.inf, 1)]
    found = [quantiles(np.array(values, float))[1] for values in known]
    assert found == [1, np.inf, 3, np.inf]
    assert made(a=[1.0, 2.0]).rows([])[1][2].startswith("1.5 [")


def test_infinite_costs_rank_last_and_survive_the_file() -> None:
    comparison = made(a=[1.0, np.inf, 2.0], b=[np.inf, np.inf, 3.0])
    assert comparison.costs("a").tolist() == [1, np.inf, 2]
    assert comparison.versus_first()["b"].difference == -1
    text = to_json(comparison, SCHEMA)
    assert from_json(OptimiserComparison, text, SCHEMA, Path("comparison.json")) == comparison
    assert "inf" in comparison.table()
    plot_comparison(comparison)


def test_a_gradients_time_is_given_in_evaluations() -> None:
    comparison = made(a=A, g=B)
    comparison.gradients["g"] = Gradients(price=5, begin=20)
    # 4 gradients between evaluations 20 and 40, in the second half of 2 s; one takes 2 s / 40.
    assert comparison.gradient_seconds("g") == pytest.approx(0.25)
    assert_states(comparison.table(), "counts as 5 evaluations", "250 ms")


def test_the_figure_shows_median_and_quartiles() -> None:
    comparison = made(a=A, b=B)
    figure = plot_comparison(comparison)
    (ax,) = figure.axes
    line = ax.get_lines()[0]
    assert line.get_label() == "a"
    evaluations, (_, median, _) = comparison.bands("a")
    np.testing.assert_array_equal(line.get_xdata(), evaluations)
    np.testing.assert_array_equal(line.get_ydata(), median)
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["a", "b"]


@pytest.fixture(scope="module")
def on_sphere(tmp_path_factory: pytest.TempPathFactory):
    """A comparison of two optimisers on the sphere, its folder and its progress."""
    folder, reports = tmp_path_factory.mktemp("compare") / "out", []
    comparison = posegsa.compare(
        tiny(),
        optimisers=["gsa", "random_search"],
        repeats=3,
        evaluations=32,
        function=SPHERE,
        out=folder,
        progress=reports.append,
    )
    return comparison, folder, reports


def test_a_function_is_searched_as_minimise_would(on_sphere) -> None:
    comparison, _, reports = on_sphere
    key = jax.random.fold_in(keys(0).search, 2)
    alone = minimise(SPHERE, SPHERE.box, GSA(agents=6, iterations=5), key)
    third = comparison.repeats["gsa"][2]
    assert third.cost == float(alone.best_cost)
    assert third.evaluations == [6, 12, 18, 24, 30]
    assert third.held_out is None
    np.testing.assert_allclose(third.best, alone.history.best, rtol=1e-6)
    assert np.all(np.diff(third.times) >= 0)
    searches = [step for step in reports if step.name == "comparing"]
    assert searches[0] == Step("comparing", 0, 6, "gsa 1/3")
    best = comparison.repeats["random_search"][-1].cost
    assert searches[-1] == Step("comparing", 6, 6, "random_search 3/3", best)


def test_the_folder_is_complete_and_gone_on_from(on_sphere) -> None:
    comparison, folder, _ = on_sphere
    assert load_comparison(folder) == comparison
    assert (folder / "comparison.txt").read_text().strip() == comparison.table()
    assert (folder / "comparison.png").read_bytes()[:4] == b"\x89PNG"
    reports = []
    more = posegsa.compare(
        tiny(),
        optimisers=["random_search"],
        repeats=4,
        evaluations=32,
        function=SPHERE,
        out=folder,
        progress=reports.append,
    )
    abouts = {step.about for step in reports if step.name == "comparing" and step.done < step.parts}
    assert abouts == {"random_search 4/4"}, "only what is missing is searched"
    assert list(more.repeats) == ["random_search", "gsa"], "the content of the folder is kept"
    assert more.repeats["gsa"] == comparison.repeats["gsa"]
    assert more.repeats["random_search"][:3] == comparison.repeats["random_search"]
    assert "3 to 4 repeats" in more.heading()
    assert set(more.versus_first()) == {"gsa"}


def test_another_comparisons_folder_is_refused(on_sphere, tmp_path) -> None:
    _, folder, _ = on_sphere
    same = {"optimisers": ["gsa"], "repeats": 1, "function": SPHERE, "out": folder}
    for changed in (
        {"evaluations": 31},
        {"evaluations": 32, "function": ClassicalFunction("sphere", 2, shift=0.1)},
    ):
        with pytest.raises(RunFolderError, match="another problem"):
            posegsa.compare(tiny(), **(same | changed))
    with pytest.raises(RunFolderError, match="another problem"):
        posegsa.compare(tiny("search.g0=3.0"), evaluations=32, **same)
    (tmp_path / "comparison.json").write_text('{"schema": 1}')
    with pytest.raises(RunFolderError, match=r"comparison\.json.*schema = 1"):
        load_comparison(tmp_path)
    (tmp_path / "comparison.json").write_text("[" * 100000)
    with pytest.raises(RunFolderError, match=r"comparison\.json.*JSON"):
        load_comparison(tmp_path)
    with pytest.raises(RunFolderError, match="nowhere"):
        load_comparison(tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    with pytest.raises(RunFolderError, match=r"file.*not a folder"):
        posegsa.compare(tiny(), **(same | {"out": tmp_path / "file", "evaluations": 32}))
    with (
        locked_folder(folder, overwrite=True),
        pytest.raises(RunFolderError, match="another run is"),
    ):
        posegsa.compare(tiny(), **(same | {"evaluations": 32}))


@pytest.mark.parametrize(
    ("setting", "title"),
    [
        ("filter.schedule=smooth", "smooth gain on 3 training scenarios"),
        ("filter.kind=kalman", "Kalman filter on 3 training scenarios"),
    ],
)
def test_its_title_names_the_filter_that_is_searched(setting, title) -> None:
    assert comparing._filter(config.override(tiny(), [setting])).title == title


@pytest.mark.parametrize("job", [posegsa.compare, partial(posegsa.sweep, vary={"run.seed": [1]})])
def test_a_filter_of_the_users_own_is_refused(job) -> None:
    with pytest.raises(ArgumentError, match=r'filter\.kind = "own"; allowed: a filter of posegsa'):
        job(config.override(tiny(), ["filter.kind=own"]))


def test_an_interrupted_comparison_continues_with_the_others(monkeypatch, tmp_path) -> None:
    same = {"repeats": 2, "evaluations": 32, "function": SPHERE, "out": tmp_path}

    def interrupted(step: Step) -> None:
        if step.about == "gsa 2/2":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        posegsa.compare(tiny(), optimisers=["gsa", "pso"], progress=interrupted, **same)
    assert {n: len(r) for n, r in load_comparison(tmp_path).repeats.items()} == {"gsa": 1}
    assert "1 repeat of" in load_comparison(tmp_path).table()
    more = posegsa.compare(tiny(), optimisers=["random_search"], **same)
    assert {n: len(r) for n, r in more.repeats.items()} == {"random_search": 2, "gsa": 1}


def test_what_replaces_a_comparison_takes_its_table_and_figure_away(on_sphere, tmp_path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(on_sphere[1], folder)

    def look(step: Step) -> None:
        if step.name == "comparing":
            assert not (folder / "comparison.txt").exists()
            assert not (folder / "comparison.png").exists()

    posegsa.compare(
        tiny(),
        optimisers=["gsa"],
        repeats=1,
        evaluations=31,
        function=SPHERE,
        out=folder,
        overwrite=True,
        progress=look,
    )
    assert list(load_comparison(folder).repeats) == ["gsa"]
    assert (folder / "comparison.txt").exists()


def test_a_full_disk_leaves_the_comparison_as_it_was(on_sphere, monkeypatch, tmp_path) -> None:
    _, folder, _ = on_sphere
    shutil.copytree(folder, tmp_path / "copy")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def full(path, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("posegsa.saving.folder.write_synced", full)
    with pytest.raises(RunFolderError, match="No space left"):
        posegsa.compare(
            tiny(),
            optimisers=["gsa"],
            repeats=1,
            evaluations=32,
            function=SPHERE,
            out=tmp_path / "copy",
        )
    assert {p.name: p.read_bytes() for p in (tmp_path / "copy").iterdir()} == before


@pytest.fixture(scope="module")
def on_filter(tmp_path_factory: pytest.TempPathFactory):
    """A comparison with one search of the filter, and its folder."""
    folder = tmp_path_factory.mktemp("compare") / "out"
    same = {"optimisers": ["gsa"], "evaluations": 24, "out": folder}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PosegsaWarning)
        return posegsa.compare(tiny(), repeats=1, **same), same


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_what_cannot_change_a_result_may_differ(on_filter) -> None:
    """A comparison accepts a folder whose checkpoint settings differ."""
    one, same = on_filter
    more = posegsa.compare(tiny("checkpoint.iterations=7"), repeats=2, **same)
    assert more.repeats["gsa"][:1] == one.repeats["gsa"]
    assert len(more.repeats["gsa"]) == 2
    with pytest.raises(RunFolderError, match="another problem"):
        posegsa.compare(tiny("filter.gamma=7.0"), repeats=2, **same)


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_on_the_filter_all_searches_meet_the_same_scenarios(on_filter) -> None:
    experiment, (_, same) = tiny(), on_filter
    comparison = posegsa.compare(experiment, repeats=2, **same)
    first, second = comparison.repeats["gsa"]
    assert first.cost != second.cost
    task = tuning_problem(experiment)
    for found in (first, second):
        assert found.evaluations[-1] == 24
        candidate = task.space.candidate(jnp.asarray(found.position, "float32"))
        one = jax.tree.map(lambda a: a[None], candidate)
        for cost, part in ((found.cost, slice(3)), (found.held_out, slice(3, None))):
            costs = costs_by_scenario(one, task.scenarios.select(part))
            assert float(np.mean(costs)) == pytest.approx(cost, rel=1e-4)


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_the_command_prints_the_table(tmp_path, capsys) -> None:
    words = ["compare", "--function", "sphere", "--dimensions", "2", "--evaluations", "32"]
    words += ["--set", "search.agents=6", "--repeats", "2", "--optimisers", "gsa,random_search"]
    assert main([*words, "--levels", "9000", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    assert_states(said.out, "sphere", "2 dimensions", "2 repeats", "32 evaluations", "to 9000")
    assert_states(said.err, "3/4", "random_search 2/2", "done")
    assert "stopped" not in said.err
    assert json.loads((tmp_path / "out" / "comparison.json").read_text())["budget"] == 32


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
@pytest.mark.parametrize(
    ("words", "facts"),
    [
        (["--optimisers", "gas"], ["optimiser", "'gas'"]),
        (["--optimisers", ","], ["optimisers", "none"]),
        (["--function", "spher"], ["'spher'"]),
        (["--function", "sphere", "--shift", "2"], ["shift = 2.0"]),
        (["--evaluations", "10"], ["evaluations = 10", "32", "gsa"]),
    ],
)
def test_bad_input_is_reported_with_what_is_allowed(words, facts, capsys) -> None:
    assert main(["compare", *words]) == 2
    assert_states(capsys.readouterr().err, *facts)


@pytest.mark.parametrize("arguments", [{"repeats": 0}, {"evaluations": 2.5}, {"repeats": True}])
def test_bad_numbers_are_refused_by_name(arguments: dict) -> None:
    with pytest.raises(ArgumentError, match=f"{next(iter(arguments))} = .*whole number"):
        posegsa.compare(tiny(), **arguments)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"optimisers": "gsa"}, r"optimisers = 'gsa'.*\['gsa'\]"),
        ({"optimisers": 5}, r"optimisers.* int.*names"),
        ({"optimisers": [1]}, r"optimisers.* int.*names"),
        ({"function": len}, r"function.*ClassicalFunction"),
        ({"levels": 3.0}, r"levels.* float.*numbers"),
        ({"levels": ["x"]}, "levels = 'x'"),
        ({"levels": [np.nan]}, "levels = nan"),
    ],
)
def test_arguments_of_another_type_are_refused_by_name(arguments: dict, said: str) -> None:
    with pytest.raises(ArgumentError, match=said):
        posegsa.compare(tiny(), **arguments)


def test_what_would_not_fit_into_memory_is_refused_before_it_is_made(monkeypatch) -> None:
    monkeypatch.setattr("posegsa.search.memory.available", lambda: memory.COMPILER + 2**26)
    with pytest.raises(MemoryLimitError):
        posegsa.compare(tiny(), optimisers=["gsa:agents=1000000"], evaluations=10**9)
    with pytest.raises(ArgumentError, match=r"dimensions = 100000.*5000"):
        ClassicalFunction("sphere", 100_000, rotation=1)
