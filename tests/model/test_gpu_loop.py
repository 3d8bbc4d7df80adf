"""A loop over time as one GPU kernel: the same as `lax.scan`, here by Pallas's interpreter.

The observers' steps are lowered to what Triton gets, too; Triton itself needs a GPU.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.controllers import search_vectors
from helpers.experiments import paper, posed, searched
from jax import Array, export, lax

from posegsa import config
from posegsa.model import gpu_loop
from posegsa.model.gpu_loop import MOST_OPERATIONS, THREADS, last_of_scan
from posegsa.search import devices, population
from posegsa.search.problem import tuning_problem

STEPS = 7
START = {"x": jnp.linspace(-1, 1, THREADS, dtype=jnp.float32)}
ROWS = jnp.asarray(np.random.default_rng(0).normal(size=(STEPS, 2)).astype(np.float32))
PULL = jnp.linspace(0.1, 0.9, THREADS, dtype=jnp.float32)


def step(pull: Array) -> Callable[[Any, list[Array]], Any]:
    """A step that refers to a number of each agent, and to a scalar of all."""
    offset = jnp.float32(0.25)

    def one(carry: Any, row: list[Array]) -> Any:
        return {"x": carry["x"] - pull * jnp.sin(carry["x"] - row[0]) + offset * row[1]}

    return one


def by_kernel(pull: Array, start: Any, rows: Array) -> Any:
    last = last_of_scan(step(pull), start, rows)
    assert last is not None
    return last


def by_scan(pull: Array, start: Any, rows: Array) -> Any:
    return lax.scan(lambda c, row: (step(pull)(c, list(row)), None), start, rows)[0]


def same(got: Any, want: Any) -> None:
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6), got, want)


def test_a_kernel_is_a_scan() -> None:
    same(jax.jit(by_kernel)(PULL, START, ROWS), by_scan(PULL, START, ROWS))


def test_each_lane_of_vmap_has_its_agents_and_rows() -> None:
    pulls, rows = jnp.stack([PULL, 2 * PULL, -PULL]), jnp.stack([ROWS, -ROWS])
    over_agents = [jax.vmap(run, in_axes=(0, None, None)) for run in (by_kernel, by_scan)]
    got, want = (
        jax.jit(jax.vmap(run, in_axes=(None, None, 0)))(pulls, START, rows) for run in over_agents
    )
    same(got, want)


def test_derivatives_are_those_of_a_scan() -> None:
    tangents = jax.tree.map(jnp.ones_like, (PULL, START, ROWS))
    got, want = (jax.jvp(run, (PULL, START, ROWS), tangents) for run in (by_kernel, by_scan))
    same(got, want)


@pytest.mark.parametrize(
    ("start", "refers_to"),
    [
        ({"x": jnp.zeros(THREADS + 1, jnp.float32)}, jnp.ones(1, jnp.float32)),
        ({"x": jnp.zeros(THREADS, jnp.int32)}, jnp.ones(1, jnp.int32)),
        (START, jnp.ones((3, THREADS), jnp.float32)),
        (START, jnp.ones((1, 1), jnp.float32)),
    ],
    ids=["agents", "whole numbers", "an array", "an array of one"],
)
def test_what_a_kernel_can_not_hold_is_left_to_scan(start: Any, refers_to: Array) -> None:
    def sums(carry: Any, row: list[Array]) -> Any:
        return {"x": carry["x"] + refers_to.sum(axis=0, dtype=refers_to.dtype)}

    assert last_of_scan(sums, start, ROWS) is None


@pytest.mark.parametrize(
    "refused",
    [
        lambda x: jnp.round(x),
        lambda x: lax.cond(True, jnp.sin, jnp.cos, x),
    ],
    ids=["round", "cond"],
)
def test_what_triton_does_not_know_is_left_to_scan(refused: Callable[[Array], Array]) -> None:
    def one(carry: Any, row: list[Array]) -> Any:
        return {"x": refused(carry["x"]) + row[0]}

    assert last_of_scan(one, START, ROWS) is None


def test_a_step_that_stores_something_is_left_to_scan() -> None:
    def storing(carry: Any, row: list[Array]) -> Any:
        return step(PULL)(carry, row), row[0]

    assert last_of_scan(storing, START, ROWS) is None


def test_a_step_of_too_many_operations_is_left_to_scan() -> None:
    def many(carry: Any, row: list[Array]) -> Any:
        for _ in range(MOST_OPERATIONS + 1):
            carry = {"x": carry["x"] + row[0]}
        return carry

    assert last_of_scan(many, START, ROWS) is None


# Populations --------------------------------------------------------------------------------------


BRIEF = "scenario.duration=0.3", "cost.transient_window=[0,10]", "cost.steady_window=[15,29]"


@pytest.mark.parametrize("count", [1, 2])
def test_a_population_costs_the_same_in_kernels(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Blocks of 32 agents on one scenario each, the last of them padded, on one or two GPUs."""
    batch, space = posed(paper(*BRIEF, dtype="float32"), scenarios=3), searched(dtype="float32")
    vectors = jnp.asarray(search_vectors(THREADS + 3, seed=1), jnp.float32)
    assert len(jax.devices()) >= count
    mesh = devices.mesh_of(jax.devices()[:count])
    axis = None if mesh is None else devices.AXIS
    want = population.evaluate_population(vectors, batch, space)

    def costs(vectors: Array, batch: Any, space: Any) -> Array:
        return population.population_costs(vectors, batch, space, axis=axis)

    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    interpreted: list[bool] = []

    def not_there() -> bool:
        interpreted.append(True)
        return False

    monkeypatch.setattr(gpu_loop, "on_gpu", not_there)
    given = devices.spread((vectors, batch, space), mesh)
    got = devices.collect(jax.jit(devices.on_each(mesh)(costs))(*given))
    assert interpreted
    np.testing.assert_allclose(got, want, rtol=1e-6)


@pytest.mark.parametrize("name", ["paper", "observer"])
def test_the_observers_step_is_lowered_to_triton(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("jaxlib.triton", reason="jaxlib for this system has no Triton")
    problem = tuning_problem(config.load(name).replace(**{"run.training_scenarios": 1}))
    vectors = jnp.broadcast_to(problem.space.box.lower, (THREADS, len(problem.space.box.lower)))
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")

    def costs(v: Array, batch: Any) -> Array:
        return population.population_costs(v, batch, problem.space)

    custom_call = export.DisabledSafetyCheck.custom_call("__gpu$xla.gpu.triton")
    made = export.export(jax.jit(costs), platforms=["cuda"], disabled_checks=[custom_call])(
        vectors, problem.training
    )
    assert "xla.gpu.triton" in made.mlir_module()
