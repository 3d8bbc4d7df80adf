"""posegsa's own measurements, each in a process of its own: a command in, one line of JSON out.

    python benchmarks/contenders/posegsa_worker.py scene OUT.npz
    python benchmarks/contenders/posegsa_worker.py time --agents 1000 --devices 2
    python benchmarks/contenders/posegsa_worker.py search

`benchmarks/run.py` starts it. Processes are fresh because XLA reads its options once, because a
compiled program stays in its process, and because peak memory is the process's.
"""

import argparse
import json
import os
import resource
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent.parent))

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

import posegsa
from contenders import c, learning
from contenders.scene import RULES, Scene
from posegsa import config
from posegsa.compiled_programs import enable_compilation_cache
from posegsa.filters.observer import Observer
from posegsa.model.vectors import Wahba
from posegsa.optimisers import minimise
from posegsa.runtime import fast_path_flags
from posegsa.search.candidates import SearchSpace
from posegsa.search.devices import AXIS, collect, mesh_for, on_each, spread
from posegsa.search.keys import keys
from posegsa.search.objective import SearchObjective, packed_batch
from posegsa.search.packing import Packed
from posegsa.search.population import evaluate_population
from posegsa.search.problem import TuningProblem, tuning_problem
from posegsa.search.run_search import run_search

CONFIGS = Path(__file__).parent.parent.parent / "configs"
PAPER, OBSERVER = CONFIGS / "paper.toml", CONFIGS / "observer.toml"
NARROW = "--xla_cpu_max_isa=AVX2 --xla_cpu_prefer_vector_width=256"
"""XLA options for vectors of 8 floats."""
CHECKED_AGENTS = 100
"""Random parameter vectors that all contenders are checked on; more agents repeat them."""


def use_devices(count: int, isa: str = "native") -> None:
    """Run on `count` CPU devices and cores; to be called before JAX makes its first array.

    The process is pinned to its cores, so that "one device" always uses one core. With "avx2",
    vectors have 8 floats.
    """
    given = f"{os.environ.get('XLA_FLAGS', '')} {NARROW if isa == 'avx2' else ''}"
    own = f"{given} --xla_force_host_platform_device_count={count}"
    os.environ["XLA_FLAGS"] = fast_path_flags(own)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:count])


def task_of(dtype: str, scenarios: int = 1, agents: int = CHECKED_AGENTS) -> TuningProblem:
    """The paper's experiment as a tuning problem."""
    settings = [f"run.dtype={dtype}", f"run.training_scenarios={scenarios}"]
    settings += [f"search.agents={agents}"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", posegsa.PosegsaWarning)
        return tuning_problem(config.override(config.load(PAPER), settings))


def observer_task(*settings: str) -> TuningProblem:
    """The experiment of observer.toml in float32; `settings` change single values of it.

    Settings that are off by default are off, because the contenders lack them.
    """
    few = "run.held_out_scenarios=1", "run.dtype=float32"
    few += "gain.unknown=off", "filter.bias_wait=off", "filter.length_growth=off"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", posegsa.PosegsaWarning)
        return tuning_problem(config.override(config.load(OBSERVER), [*few, *settings]))


def parameter_vectors(task: TuningProblem, agents: int) -> jax.Array:
    """Parameter vectors (agents, d), uniform in their boxes; the same in every dtype."""
    lower, upper = task.space.box
    unit = jax.random.uniform(jax.random.key(1), (CHECKED_AGENTS, len(lower)), jnp.float32)
    drawn = lower[None] + (upper - lower)[None] * unit.astype(lower.dtype)
    return jnp.resize(drawn, (agents, drawn.shape[1]))


def scene_of(task: TuningProblem, vectors: jax.Array) -> Scene:
    """A task's training scenarios and the controllers of parameter vectors as plain arrays.

    Raises:
        ValueError: the experiment is not one that the other contenders can run.
    """
    e = task.experiment
    one_landmark = len(e.scenario.landmarks) == 1 and e.gain.signal == "measured"
    section = e.filter
    if not (
        isinstance(section, config.ObserverConfig)
        and (section.substeps, section.law) == (1, "gradient")
        and one_landmark
    ):
        raise ValueError("the other contenders have one landmark, one step and the gradient law")
    if task.space.schedules.rules != RULES or (e.fuzzy.centroid, e.fuzzy.no_rule) != (
        "exact",
        "hold",
    ):
        raise ValueError("the other contenders have the paper's rules and the exact centroid")
    training = task.training
    sample, truth, initial = training.samples.sample, training.samples.truth, training.initial
    if truth is None or not isinstance(sample.vectors, Wahba):
        raise ValueError("the other contenders need the true pose, and vectors without biases")
    wahba = sample.vectors
    (landmark,) = sample.landmarks
    observer = cast(Observer, training.filter)
    settings, signal = observer.settings, observer.signal
    (weight,) = settings.landmark_weights or (1.0,)

    def plain(a: jax.Array) -> np.ndarray:
        return np.asarray(a, np.float64)

    def joined(components: Sequence[jax.Array]) -> np.ndarray:
        return np.stack([plain(a) for a in components], axis=-1)

    controller = jax.jit(jax.vmap(task.space.schedules.controller))(vectors)
    return Scene(
        time_step=plain(sample.time_step),
        angular_velocity=joined(sample.angular_velocity),
        velocity=joined(sample.velocity),
        profile=np.stack([joined(row) for row in wahba.profile], axis=-2),
        vector_power=plain(wahba.power),
        vector_curvature=plain(wahba.curvature),
        attitude_scale=plain(wahba.scale),
        landmark_body=joined(landmark.body),
        landmark_inertial=joined(landmark.inertial),
        landmark_weight=plain(landmark.factor * weight),
        true_attitude=joined(truth.attitude),
        true_origin=joined(truth.origin),
        attitude=joined(initial.attitude),
        position=joined(initial.place),
        bias=joined(initial.bias_angular + initial.bias_linear),
        cost_weight=plain(training.weights.transient) + plain(training.weights.steady),
        cost_position=float(training.weights.position),
        gamma=np.array([settings.gamma_angular, settings.gamma_linear], np.float64),
        gain_limit=0.0 if jnp.isinf(settings.gain_limit) else float(settings.gain_limit),
        position_weight=float(signal.position_weight),
        smoothing=float(signal.smoothing),
        error_scale=float(signal.error_scale),
        rate_scale=float(signal.rate_scale),
        initial_gain=float(controller.initial_gain()),
        inputs=plain(controller.input_terms),
        outputs=plain(controller.output_terms),
    )


def on_all_devices(task: TuningProblem) -> Callable[[ArrayLike], jax.Array]:
    """The costs (A,) of search vectors (A, d), divided among devices as a search divides them."""
    e = task.experiment
    mesh = mesh_for(e.search.agents * e.run.training_scenarios)
    objective = SearchObjective(e.objective, None if mesh is None else AXIS, task.cost)
    data = spread((packed_batch(task.training), task.space, packed_batch(task.beside)), mesh)

    def costs(
        vectors: jax.Array, training: Packed, space: SearchSpace, beside: Packed | None
    ) -> jax.Array:
        return objective(training, space, beside).costs(vectors)

    compiled = jax.jit(on_each(mesh)(costs))

    def call(vectors: ArrayLike) -> jax.Array:
        # Copying from the host to all devices takes half as long as from one device to the others.
        given = vectors if mesh is None else np.asarray(vectors)
        return collect(compiled(spread(given, mesh), *data))

    return call


def timed(run: Callable[[], object], seconds: float, least: int = 3) -> list[float]:
    """Times of repeated calls [s], for about this many seconds."""
    times: list[float] = []
    while len(times) < least or sum(times) < seconds:
        started = time.perf_counter()
        run()
        times.append(time.perf_counter() - started)
    return times


def make_scene(options: argparse.Namespace) -> dict[str, Any]:
    """Write the scene in float64; posegsa's costs of it in both precisions."""
    found = {}
    for dtype in ("float64", "float32"):
        with jax.enable_x64(dtype == "float64"):
            task = task_of(dtype)
            vectors = parameter_vectors(task, CHECKED_AGENTS)
            costs = np.asarray(evaluate_population(vectors, task.training, task.space))
            found[dtype] = [float(cost) for cost in costs]
            if dtype == "float64":
                scene_of(task, vectors).save(options.out)
    return {"costs": found}


def time_population(options: argparse.Namespace) -> dict[str, Any]:
    """Time one call for all agents on all scenarios, and C's on the same, by turns."""
    with jax.enable_x64(options.dtype == "float64"):
        if options.observer:
            task = observer_task()
        else:
            task = task_of(options.dtype, options.scenarios, options.agents)
        scenarios, samples = task.training.samples.time.shape
        agents = task.experiment.search.agents
        vectors = parameter_vectors(task, agents)

        evaluate = on_all_devices(task)

        def run() -> np.ndarray:
            return np.asarray(evaluate(vectors))

        costs = run()
        found: dict[str, Any] = {"devices": len(jax.devices()), "agents": agents}
        found |= {"scenarios": scenarios, "samples": samples}
        times, limits = timed(run, 0, least=2), []
        if options.against is not None:
            limit = _limit(task, vectors, options)
            off = np.abs(np.mean(limit(), axis=0) / costs - 1)
            # Random starts up to half a turn off: where both ways back are equally long, rounding
            # decides.
            found["c_difference"] = float(np.quantile(off, 0.9 if options.observer else 1.0))
        for _ in range(5):
            times += timed(run, options.seconds / 10)
            if options.against is not None:
                time.sleep(0.01)
                limits += timed(limit, options.seconds / 10)
                time.sleep(0.01)  # OpenMP's threads wait actively for a while
    found |= {"best": min(times), "median": float(np.median(times)), "calls": len(times)}
    if limits:
        found |= {"c_best": min(limits), "c_median": float(np.median(limits))}
    return found


def _limit(
    task: TuningProblem, vectors: jax.Array, options: argparse.Namespace
) -> Callable[[], np.ndarray]:
    """C's costs (S, A) of the same agents."""
    if options.observer:
        packed = learning.packed(task, vectors)
        return learning.prepare(packed, options.against, options.devices)
    return c.prepare(scene_of(task, vectors), options.against, options.devices)


def time_search(options: argparse.Namespace) -> dict[str, Any]:
    """Time first calls, the paper's whole search, and the optimiser with a nearly free cost."""
    started = time.perf_counter()
    task = task_of("float32")
    vectors = parameter_vectors(task, CHECKED_AGENTS).block_until_ready()
    ready = time.perf_counter()
    evaluate_population(vectors, task.training, task.space).block_until_ready()
    first = time.perf_counter() - ready
    runs = [run_search(task) for _ in range(options.repeats)]
    optimiser = task.experiment.search
    box, key = task.space.box, keys(0).search

    def sphere(k: jax.Array) -> jax.Array:
        return jnp.sum(k * k, axis=-1)

    def alone() -> None:
        jax.block_until_ready(minimise(sphere, box, optimiser, key))

    alone()
    times = timed(alone, 1.0)
    return {
        "devices": len(jax.devices()),
        "ready_seconds": ready - started,
        "first_seconds": first,
        "compile_seconds": runs[0].compile_seconds,
        "best": min(run.search_seconds for run in runs),
        "median": float(np.median([run.search_seconds for run in runs])),
        "best_cost": float(runs[0].search.best_cost),
        "optimiser_best": min(times),
        "optimiser_median": float(np.median(times)),
        "iterations": optimiser.iterations,
        "agents": optimiser.agents,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="One measurement of posegsa.")
    actions = parser.add_subparsers(required=True)
    scene = actions.add_parser("scene", help="write the input of all contenders")
    scene.add_argument("out", type=Path)
    scene.set_defaults(action=make_scene, devices=1, isa="native")
    population = actions.add_parser("time", help="one population")
    population.add_argument("--agents", type=int, default=100)
    population.add_argument("--scenarios", type=int, default=1)
    population.add_argument("--dtype", choices=("float32", "float64"), default="float32")
    population.add_argument("--devices", type=int, default=1)
    population.add_argument("--isa", choices=("native", "avx2"), default="native")
    population.add_argument(
        "--observer", action="store_true", help="configs/observer.toml, in its own sizes"
    )
    population.add_argument("--seconds", type=float, default=2.0, help="to measure for")
    population.add_argument("--against", type=Path, metavar="C", help="C, built, to time by turns")
    population.set_defaults(action=time_population)
    search = actions.add_parser("search", help="the paper's whole search")
    search.add_argument("--devices", type=int, default=1)
    search.add_argument("--repeats", type=int, default=3)
    search.set_defaults(action=time_search, isa="native")
    options = parser.parse_args()
    use_devices(options.devices, options.isa)
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        enable_compilation_cache()
    found = options.action(options)
    # Kilobytes on Linux, bytes on macOS.
    unit = 1 if sys.platform == "darwin" else 1024
    found["peak_bytes"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
    found["jax"] = jax.__version__
    print(json.dumps(found))


if __name__ == "__main__":
    main()
