"""The benchmark's contenders compute the same as posegsa, and its tables are right."""

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from contenders import c, learning, numpy_vectorised, plain_loop
from contenders.posegsa_worker import observer_task, parameter_vectors, scene_of
from contenders.scene import Scene, load
from helpers.experiments import lasting, paper
from machine import cpu
from readme import ROOT
from run_tables import POSEGSA, C, Row, duration, overview, table

from posegsa.search.population import evaluate_population
from posegsa.search.problem import tuning_problem

AVX2 = not {"avx2", "avx512f"}.isdisjoint(cpu())
AGENTS = 20  # more than a block of 16, so that the last one has empty lanes


@pytest.fixture(scope="module")
def posed_scene() -> tuple[Scene, np.ndarray]:
    """A short task with smoothing and two scenarios, and posegsa's costs for it."""
    settings = ("gain.smoothing=0.1", "filter.gamma=[5.0, 3.0]", "run.training_scenarios=2")
    task = tuning_problem(paper(*lasting(1.5), *settings, dtype="float32"))
    vectors = parameter_vectors(task, AGENTS)
    return scene_of(task, vectors), np.asarray(
        evaluate_population(vectors, task.training, task.space)
    )


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The C contender, compiled."""
    if c.compiler() is None:
        pytest.skip("no C compiler")
    return c.build(tmp_path_factory.mktemp("library"))


def test_numpy_agrees(posed_scene: tuple[Scene, np.ndarray]) -> None:
    scene, costs = posed_scene
    found = numpy_vectorised.prepare(scene)()
    assert found.shape == (2, AGENTS)
    np.testing.assert_allclose(found.mean(axis=0), costs, rtol=1e-4)


def test_the_plain_loop_agrees_where_the_controller_matters(
    posed_scene: tuple[Scene, np.ndarray],
) -> None:
    scene = posed_scene[0]
    # Of length 1 up to rounding, because the two compute rotations from quaternions differently.
    q = scene.true_attitude / np.linalg.norm(scene.true_attitude, axis=-1, keepdims=True)
    part = replace(scene, true_attitude=q).part(60, 30, agents=1)
    gains = numpy_vectorised.Schedule(part).gain

    def controller(error: float, rate: float, last: float) -> float:
        return float(gains(*(np.array([a]) for a in (error, rate, last)))[0])

    known = numpy_vectorised.prepare(part)()[0, 0]
    assert plain_loop.simulate(part, controller) == pytest.approx(known, rel=1e-10)
    # In this slice a wrong controller changes the cost by 2 %, 10 000 times the tolerance.
    off = plain_loop.simulate(part, lambda *inputs: 1.02 * controller(*inputs))
    assert abs(off / known - 1) > 1e-6


def test_c_agrees(posed_scene: tuple[Scene, np.ndarray], library: Path) -> None:
    scene, costs = posed_scene
    for threads in (1, 2):
        found = c.prepare(scene, library, threads)()
        np.testing.assert_allclose(found.mean(axis=0), costs, rtol=1e-4)


def test_c_agrees_off_the_paper(posed_scene: tuple[Scene, np.ndarray], library: Path) -> None:
    scene = posed_scene[0]
    # Output terms with wide overlaps take another branch of the centroid.
    wide = scene.outputs.copy()
    wide[:, 0, 2], wide[:, 1, 2], wide[:, 3:, 0] = 80.0, 85.0, 22.0
    wide = np.sort(np.sort(wide, axis=-1), axis=-2)
    assert (wide[:, 0, 2] > wide[:, 4, 0]).all()
    far = replace(scene, outputs=wide)
    found, known = c.prepare(far, library)(), numpy_vectorised.prepare(far)()
    np.testing.assert_allclose(found, known, rtol=1e-3)
    assert np.abs(found - numpy_vectorised.prepare(scene)()).max() > 1e-2
    # Without the gain limit a step may exceed a full turn; soon afterwards the motion is chaotic.
    free = replace(scene.first(samples=4), gain_limit=0.0)
    known = numpy_vectorised.prepare(free)()
    np.testing.assert_allclose(c.prepare(free, library)(), known, rtol=1e-3)


def test_c_learns_the_vectors_biases_as_posegsa_does(library: Path) -> None:
    # Starts without chaos, so that all agents can be compared.
    start = "family.attitude_error=[0.0, 60.0]", "run.training_scenarios=2"
    task = observer_task(*lasting(1.5), *start, f"search.agents={AGENTS}")
    vectors = parameter_vectors(task, AGENTS)
    costs = np.asarray(evaluate_population(vectors, task.training, task.space))
    given = learning.packed(task, vectors)
    for threads in (1, 2):
        found = learning.prepare(given, library, threads)()
        assert found.shape == (2, AGENTS)
        np.testing.assert_allclose(found.mean(axis=0), costs, rtol=1e-4)
    # Without the biases' law the costs differ, so the agreement covers this law.
    numbers = given.numbers.copy()
    numbers[:, 4] = 0.0
    without = learning.prepare(given._replace(numbers=numbers), library)()
    assert np.abs(without.mean(axis=0) / costs - 1).max() > 1e-3


def test_c_of_narrower_vectors_agrees(
    posed_scene: tuple[Scene, np.ndarray], tmp_path: Path
) -> None:
    if c.compiler() is None or not AVX2:
        pytest.skip("no C compiler, or vectors that it could use")
    scene, costs = posed_scene
    found = c.prepare(scene, c.build(tmp_path, "avx2"), 2)()
    np.testing.assert_allclose(found.mean(axis=0), costs, rtol=1e-4)


def test_a_scene_survives_its_file(posed_scene: tuple[Scene, np.ndarray], tmp_path: Path) -> None:
    scene, _ = posed_scene
    scene.save(tmp_path / "scene.npz")
    again = load(tmp_path / "scene.npz")
    jax.tree.map(np.testing.assert_array_equal, vars(again), vars(scene))


def test_rows_say_time_ratio_and_what_is_wrong() -> None:
    rows = [
        Row(C, 2, 100, 1, "float32", 0.0015, 0.002, 0.0015, 3e-6),
        Row(POSEGSA, 2, 100, 8, "float32", 0.036, 0.04, 0.012),
        Row("other", 1, difference=0.5, note="WRONG"),
    ]
    lines = table(rows).splitlines()[2:]
    assert "| 1.5 ms (2 ms) | 10 | 1 | 3e-06 |" in lines[0]
    assert "| 36 ms (40 ms) | 30 | 3 | - |" in lines[1]
    assert "| - | - | - | 5e-01 | WRONG |" in lines[2]
    short = overview([*rows, Row(f"{C}, without gain limit", 2, best=0.001)]).splitlines()[2:]
    assert short == [f"| {C} | 2 | 1.5 ms | 1 |"], "one size, and only what was timed"
    assert [duration(t) for t in (0.0123, 61, 9000)] == ["12.3 ms", "1.02 min", "2.5 h"]


@pytest.mark.parametrize(
    ("page", "block", "named"),
    [
        ("docs/benchmarks.md", "benchmarks", (C, POSEGSA, "NumPy", "Numba", "pyfuzzylite")),
        ("docs/benchmarks.md", "profile", ("kernels (HLO)", "instructions")),
        ("README.md", "benchmarks", (C, POSEGSA)),
        ("docs/robustness.md", "faults", ("kills", "configurations", "one checkpoint")),
    ],
)
def test_the_pages_have_what_was_measured(page: str, block: str, named: tuple[str, ...]) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    measured = text.split(f"<!-- {block}: begin -->")[1].split(f"<!-- {block}: end -->")[0]
    assert all(name in measured for name in named)
    assert "WRONG" not in measured
