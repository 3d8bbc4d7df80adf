"""The examples run, at sizes so small that their results mean nothing."""

import inspect
import io
import runpy
import sys
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest
from helpers.experiments import tiny
from helpers.schedules import K, tuned
from scipy.spatial.transform import Rotation

import posegsa
from posegsa import config
from posegsa.saving.result_files import load

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")

EXAMPLES = Path(__file__).parents[2] / "examples"
README = (EXAMPLES.parent / "README.md").read_text(encoding="utf-8")


@pytest.fixture(autouse=True)
def unshown():
    """Figures are drawn without a screen, and closed."""
    plt.switch_backend("agg")
    yield
    plt.close("all")


def lines_of(figure) -> int:
    """How many lines all panels of a figure have."""
    return sum(len(axes.lines) for axes in figure.axes)


def example(name: str) -> dict:
    """The definitions of an example; nothing runs yet."""
    return runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="example")


@pytest.mark.quick
def test_the_readme_names_each_and_each_is_a_page():
    files = sorted(EXAMPLES.glob("*.py"))
    assert len(files) == 6
    for path in files:
        assert f"(examples/{path.name})" in README
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 130


def test_tune_evaluate_and_export(tmp_path, monkeypatch, capsys):
    # Every baseline of a tiny run is judged in `test_evaluate`, which takes twenty seconds.
    evaluate = inspect.signature(posegsa.evaluate)
    monkeypatch.setattr(posegsa, "evaluate", lambda *a, **k: evaluate.bind(*a, **k).args[0])
    monkeypatch.setattr("posegsa.saving.result_files.draw", lambda *_: {})
    experiment = tiny("run.seed=1")
    result = example("tune_and_export")["main"](experiment, tmp_path / "tuned", scenarios=3)
    assert "best constant gains" in capsys.readouterr().out
    written = {path.name for path in (tmp_path / "tuned").iterdir()}
    assert {"report.html", "result.json", "gain.h", "gain.fis"} <= written
    np.testing.assert_array_equal(load(tmp_path / "tuned").parameters, result.parameters)
    controller = posegsa.load_controller(tmp_path / "tuned" / "gain.fis", no_rule="hold")
    np.testing.assert_array_equal(controller.output_terms, result.controller.output_terms)


def test_own_filter():
    (degrees, metres), stream = example("own_filter")["main"](301)
    for run, streamed in zip((degrees, metres), stream, strict=True):
        np.testing.assert_allclose(streamed, run, atol=1e-3)
    assert degrees[0] > 80
    assert degrees[-1] < 0.2 * degrees[0]
    assert metres[-1] < metres[0] + 0.1


def test_own_arrays(monkeypatch, capsys):
    main = example("own_arrays")["main"]
    monkeypatch.setattr(posegsa, "load", lambda _: tuned(K))
    degrees, metres = main("run", samples=900)
    assert degrees[0] > 170
    assert degrees[-1] < 10
    assert metres[-1] < 0.5
    assert len(capsys.readouterr().out.splitlines()) == 9


@pytest.mark.quick
def test_stream(monkeypatch, capsys):
    names = example("stream")
    made = list(names["made_lines"](8))
    pose_filter = names["made_filter"]()
    found = list(names["poses"]((line for line, _ in made), pose_filter))
    assert [time for time, _ in found] == pytest.approx(np.arange(1, 800) / 100)
    (attitude, position), (_, pose) = made[-1][1], found[-1]
    error = attitude.inv() * Rotation.from_matrix(pose.rotation)
    assert np.degrees(error.magnitude()) < 1
    assert np.linalg.norm(pose.position - position) < 0.1
    assert pose_filter.observable
    # The command itself.
    monkeypatch.setattr(sys, "argv", ["stream.py", "--make", "0.05"])
    names["main"]()
    lines = capsys.readouterr().out
    assert lines.splitlines() == [line for line, _ in made[:5]]
    monkeypatch.setattr(sys, "argv", ["stream.py", "-"])
    monkeypatch.setattr(sys, "stdin", io.StringIO(lines))
    names["main"]()
    rows = capsys.readouterr().out.splitlines()
    assert [row.split(",")[0] for row in rows] == ["0.010", "0.020", "0.030", "0.040"]
    # Without arguments, both and a plot.
    degrees, metres = names["tried"](3)
    assert (degrees[-1] < 1) & (metres[-1] < 0.1)
    assert lines_of(plt.gcf()) == 2
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_minimise(capsys):
    with jax.numpy_rank_promotion("allow"):  # as a user has it
        found = example("minimise")["main"](iterations=60)
    assert len(capsys.readouterr().out.splitlines()) == 4
    best = min(float(search.best_cost) for search in found.values())
    assert float(found["differential evolution"].best_cost) == pytest.approx(best, rel=1e-3)
    grid = np.stack(np.meshgrid(*[np.linspace(-10, 10, 401)] * 2), axis=-1).reshape(-1, 2)
    with jax.numpy_rank_promotion("allow"):
        cost = example("minimise")["cost"](np.asarray(grid, np.float32))
    assert best <= float(np.min(cost)) * (1 + 1e-5)


def test_gamma_study(capsys):
    costs = example("gamma_study")["main"](tiny(), gammas=(2, 8), seeds=[0])
    assert {each.shape for each in costs.values()} == {(2, 1)}
    assert lines_of(plt.gcf()) == 2
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_the_configuration_of_ones_own_filter_is_tuned():
    """Shorter than it is, and with a smaller search."""
    few = ["scenario.duration=2.0", "cost.steady_window=[100, 199]", "run.training_scenarios=1"]
    few += ["run.held_out_scenarios=1", "run.endurance_times=1", "search.iterations=3"]
    configured = config.override(config.load(EXAMPLES / "own_filter.toml"), few)
    result = posegsa.tune(configured, filter=example("own_filter")["ComplementaryFilter"])
    assert set(result.also) == {
        f"filter.{name}" for name in ("attitude_gain", "position_gain", "bias_gain")
    }
    assert result.best_cost <= result.search.history.best[0]
