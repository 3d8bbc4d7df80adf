"""Thousands of configurations and API calls as a careless or hostile user might make them.

The tests validate some thousands of them and tune a few; the campaign of
`benchmarks/faults.py` runs all that are accepted, most of them as whole tunes.
"""

import copy
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import posegsa
from helpers.experiments import tiny
from posegsa import config
from posegsa.judging.evaluation import TUNED
from posegsa.search.problem import TuningProblem

HOSTILE: tuple[Any, ...] = (
    *(float("nan"), float("inf"), -float("inf"), -1, 0, 1, -0.0, 0.5, 1e308, -1e308, 5e-324),
    *(2, 3, 10**30, -(10**400), 2**32, True, False, None, "", "x", "nan", "off", "../etc/passwd"),
    *([], {}, [[]], [1, 2], [1.0, 2.0, 3.0], [float("nan")] * 3, ["VL"] * 5, {"a": 1}, b"bytes"),
    *((0.0,) * 22, [0.0] * 22, [1.0] * 22, [[1, 0, 0], [0, 1, 0], [0, 0, 1]], object, 1j, {1, 2}),
)
"""Values that may replace any other."""

WORDS = ("gradient", "printed", "measured", "pose", "exact", "sampled", "sum", "trapezoid", "hold")
WORDS += ("midrange", "mean", "median", "worst", "cvar", "mean_std", "gsa", "random_search", "all")
WORDS += ("dimension", "agent", "redraw", "clip", "reflect", "float32", "float64", "VS", "VL")
WORDS += ("pso", "de", "rand/1/bin", "best/1/bin", "adam", "gsa+adam", "spacing")


def places(data: Any, path: tuple = ()) -> Iterator[tuple]:
    """Every path in nested plain data, also of inner containers."""
    items = data.items() if isinstance(data, dict) else enumerate(data)
    for key, value in items:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


def changed(rng: np.random.Generator, value: Any) -> Any:
    """A replacement for a value: close to it, of the same kind, or anything."""
    kind = rng.integers(5)
    if kind == 0:
        return copy.deepcopy(HOSTILE[rng.integers(len(HOSTILE))])
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return int(value) + int(rng.integers(-3, 4)) if kind < 4 else int(rng.integers(-10, 10**7))
    if isinstance(value, float):
        factor = float(rng.choice([0.0, -1.0, 0.5, 0.9, 1.1, 2.0, 1e3, 1e-3, 1e9, 1e-9]))
        return value * factor if kind < 4 else float(rng.normal())
    if isinstance(value, str):
        return str(rng.choice(WORDS))
    if isinstance(value, list) and value:
        return [value[:-1], [*value, value[-1]], value[::-1], value][kind - 1]
    return value


def configuration(rng: np.random.Generator, base: config.Experiment) -> dict[str, Any]:
    """The plain data of an experiment with up to four changes."""
    data = base.model_dump(mode="json")
    for _ in range(rng.integers(1, 5)):
        every = list(places(data))
        path = every[rng.integers(len(every))]
        node = data
        for key in path[:-1]:
            node = node[key]
        what = rng.integers(20)
        if what == 0 and isinstance(node, dict):
            del node[path[-1]]
        elif what == 1 and isinstance(node, dict):
            node[f"{path[-1]}s"] = 1
        else:
            node[path[-1]] = changed(rng, node[path[-1]])
    return data


def structure(task: TuningProblem) -> tuple[Any, ...]:
    """The key of a compiled search: tasks with equal keys run the same program."""
    leaves, tree = jax.tree.flatten((task.training, task.space))
    return (
        tree,
        tuple((a.shape, a.dtype) for a in leaves),
        task.experiment.search,
        task.experiment.objective,
    )


def not_numbers(result: posegsa.Result) -> list[str]:
    """The fields of a result that are NaN but should not be.

    NaN is allowed where a number is undefined: for the mean cost of an iteration in which a cost
    was not finite, and for the metrics of a run whose own cost is not finite.
    """
    judged = result.on_scenarios
    assert judged is not None
    assert result.search is not None
    history, trust, contenders = result.search.history, judged.trust, judged.evaluation.contenders
    seen: dict[str, Any] = {
        "best_cost": result.best_cost,
        "parameters": result.parameters,
        "also": list(result.also.values()),
        "history.best": history.best,
        "history.mean": history.mean[history.non_finite == 0],
        "trust": [trust.cost_float32, trust.cost_float64, trust.cost_perturbed],
        "trust.uncovered": trust.uncovered or 0.0,
    }
    seen |= {f"training: {name}": costs for name, costs in judged.training.items()}
    for name, found in contenders.items():
        good = np.isfinite(found.metrics.cost)
        seen |= {f"{name}: {key}": numbers for key, numbers in found.filter.numbers.items()}
        of_covariance = ("nees", "nees_inside", "nis")
        for field, values in found.metrics._asdict().items():
            if field in of_covariance and found.filter.kind != "kalman":
                continue
            seen[f"{name}: {field}"] = values if field == "cost" else values[good]
        if good.any():
            bands = found.bands._asdict()
            if found.filter.kind == "kalman":
                del bands["gain"]  # it has none
            seen |= {f"{name}: band of {key}": a for key, a in bands.items()}
    if np.isfinite(contenders[TUNED].metrics.cost[0]):
        known = vars(judged.trajectory).items()
        seen |= {f"trajectory.{key}": a for key, a in known if not key.endswith("_sigma")}
        if trust.rule_weights is not None:
            seen["trust.rule_weights"] = trust.rule_weights
    return [name for name, values in seen.items() if np.isnan(values).any()]


def some_result() -> posegsa.Result:
    """A result with only a schedule and an experiment; it was never tuned."""
    experiment = tiny()
    parameters = np.mean([experiment.parameters.lower, experiment.parameters.upper], axis=0)
    controller = posegsa.parameter_space(experiment).controller(parameters)
    return posegsa.configured(experiment, schedule=posegsa.FuzzyGain(controller))


@cache
def stream_filter() -> posegsa.PoseFilter:
    """One filter for all calls; its gain needs no error signal."""
    return posegsa.PoseFilter(
        posegsa.Observer(
            posegsa.ConstantGain(np.float32(5.0)),  # type: ignore[arg-type]  # a NumPy array instead
            posegsa.filter_settings(tiny()),
        ),
        rotation=np.eye(3),
        position=np.zeros(3),
        vector_references=np.eye(3)[:2],
        landmark_references=[[1.0, 2.0, 3.0]],
    )


class Call(NamedTuple):
    """A call of a public function, ready to be made."""

    name: str
    make: Callable[[], Any]


def call(rng: np.random.Generator, result: posegsa.Result) -> Call:
    """A call of a public function with some wrong arguments.

    A refused call compiles nothing, and most accepted ones do not either.
    """
    key, folder = jax.random.key(0), Path(tempfile.gettempdir())
    experiment, controller = result.experiment, result.controller

    def any_of(*good: Any) -> Any:
        """Usually one of these, otherwise anything."""
        pool = good if rng.random() < 0.85 else HOSTILE
        return pool[rng.integers(len(pool))]

    def hostile() -> Any:
        return HOSTILE[rng.integers(len(HOSTILE))]

    def no_count() -> Any:
        """A value that is not a valid count."""
        bad = (0, 0.0, -1, -5, 10**12, "x", "2", 2.5, True, [2], float("nan"), {}, np.ones(2))
        return bad[rng.integers(len(bad))]

    def array(*shape: int) -> Any:
        """Usually an array of this shape."""
        values = rng.normal(size=shape)
        match rng.integers(50):
            case 0:
                return hostile()
            case 1:
                return values[..., :-1] if shape else [values]
            case 2:
                return np.where(rng.random(shape) < 0.1, rng.choice([np.nan, np.inf]), values)
            case 3:
                return values.astype(
                    rng.choice(["U8", "complex64", "object", "float16", "int32", "bool"])
                )
            case 4:
                return 1e300 * values
            case 5:
                return -np.abs(values)
        return values

    N, n, m = (int(rng.integers(1, 4)) for _ in range(3))
    settings = posegsa.filter_settings(experiment)
    signal = posegsa.signal_settings(experiment.gain, np.float32)
    observer = posegsa.Observer(result.schedule, settings, signal)
    state = posegsa.initial_state(np.eye(3), np.zeros(3))
    calls: dict[str, Callable[[], Any]] = {
        "from_arrays": lambda: posegsa.Measurements.from_arrays(
            time_step=any_of(0.01, np.full(N, 0.02), np.linspace(0.01, 0.05, N), np.zeros(N)),
            angular_velocity=array(N, 3),
            velocity=array(N, 3),
            vectors=any_of(None, array(N, n, 3)),
            vector_references=any_of(None, array(n, 3), array(N, n, 3)),
            vector_weights=any_of(None, 1.0, np.ones(n), np.full((N, n), 0.5)),
            landmarks=any_of(None, array(N, m, 3)),
            landmark_references=any_of(None, array(m, 3)),
            landmark_weights=any_of(None, np.ones(m)),
            dtype=any_of(np.float32, np.float64),
        ),
        "box": lambda: posegsa.box(array(n), array(int(rng.choice([n, m])))),
        "GSA": lambda: posegsa.GSA(
            agents=any_of(2, 10),
            iterations=any_of(1, 5),
            g0=any_of(1.0),
            alpha=any_of(20.0),
            force_power=any_of(1, 2),
            random=any_of("agent", "dimension"),
            bounds=any_of("clip"),
            final_percent=any_of(2.0),
            epsilon=any_of("spacing"),
            decay_iterations=any_of("all", 3),
        ),
        "RandomSearch": lambda: posegsa.RandomSearch(agents=any_of(1, 5), iterations=any_of(1, 5)),
        "minimise": lambda: posegsa.minimise(
            hostile(),
            any_of(posegsa.box([0.0], [1.0])),
            any_of(posegsa.GSA(agents=4, iterations=2)),
            any_of(key),
        ),
        "FuzzyController": lambda: posegsa.FuzzyController(
            input_terms=any_of(np.asarray(controller.input_terms), array(5, 3)),
            output_terms=any_of(np.asarray(controller.output_terms), array(5, 3)),
            rules=any_of(controller.rules),
            output_range=any_of((0.0, 100.0), (1.0, 0.0)),
            centroid=any_of("exact", "sampled"),
            sampled_points=any_of(101),
            sampled_rule=any_of("sum"),
            no_rule=any_of("hold"),
        ),
        "initial_state": lambda: posegsa.initial_state(array(3, 3), array(3), any_of(None)),
        "filter_settings": lambda: posegsa.filter_settings(hostile()),
        "signal_settings": lambda: posegsa.signal_settings(hostile(), np.float32),
        "step": lambda: posegsa.step(any_of(observer), hostile(), hostile()),
        "run_filter": lambda: posegsa.run_filter(any_of(observer), hostile(), state),
        "estimate": lambda: result.estimate(hostile(), np.eye(3), np.zeros(3)),
        "parameter_space": lambda: posegsa.parameter_space(hostile()),
        "plot_surface": lambda: posegsa.plot_surface(hostile()),
        "plot_input_terms": lambda: posegsa.plot_input_terms(hostile()),
        "plot_output_terms": lambda: posegsa.plot_output_terms(hostile()),
        "export_c": lambda: posegsa.export_c(hostile()),
        "export_c_gain": lambda: posegsa.export_c_gain(hostile()),
        "filter_to_c": lambda: posegsa.filter_to_c(
            any_of(hostile(), posegsa.Observer(result.schedule, settings, signal)),
            vectors=hostile(),
            landmarks=hostile(),
        ),
        "export_json": lambda: posegsa.export_json(hostile()),
        "export_csv": lambda: posegsa.export_csv(hostile()),
        "export_fis": lambda: posegsa.export_fis(hostile()),
        "load_controller": lambda: posegsa.load_controller(
            any_of(folder / "none.fis", str(folder)), no_rule=hostile()
        ),
        "PoseFilter": lambda: posegsa.PoseFilter(
            any_of(hostile(), controller, posegsa.Observer(hostile(), settings)),
            rotation=array(3, 3),
            position=array(3),
            vector_references=any_of(None, array(n, 3)),
            landmark_references=array(m, 3),
            hold_time=any_of(0.1),
        ),
        "update": lambda: stream_filter().update(
            time_step=any_of(0.01),
            angular_velocity=array(3),
            velocity=array(3),
            vectors=any_of(None, array(2, 3), array(n, 3)),
            landmarks=any_of(None, array(1, 3)),
            vector_weights=any_of(None, 1.0),
        ),
        "restore": lambda: stream_filter().restore(hostile()),
        "reset": lambda: stream_filter().reset(array(3, 3), array(3)),
        "export_csv resolution": lambda: posegsa.export_csv(result, resolution=no_count()),
        "evaluate": lambda: posegsa.evaluate(hostile(), scenarios=any_of(5)),
        "evaluate scenarios": lambda: posegsa.evaluate(result, scenarios=no_count()),
        "load": lambda: posegsa.load(any_of(folder / "none", str(folder))),
        "load_config": lambda: posegsa.load_config(any_of(folder / "none.toml", str(folder))),
        "from_dict": lambda: config.from_dict(hostile()),
        "override": lambda: config.override(any_of(experiment), [any_of("run.seed=1", "run.seed")]),
        "override settings": lambda: config.override(experiment, hostile()),
        "to_toml": lambda: config.to_toml(any_of(experiment)),
        "tune": lambda: posegsa.tune(
            # A class is not an experiment, so nothing is searched here.
            any_of(posegsa.Experiment, {}, 5),
            seed=any_of(None, 1),
            iterations=any_of(None, 1),
            progress=any_of(None),
        ),
        "tune seed": lambda: posegsa.tune(experiment, seed=(-1, 1.5, 2**32, "1")[rng.integers(4)]),
        "tune iterations": lambda: posegsa.tune(experiment, iterations=no_count()),
        "tune resume": lambda: posegsa.tune(resume=hostile() or folder / "no\0ne"),
        "tune_batch": lambda: posegsa.tune_batch(any_of([], 5, [5]), seeds=any_of(None, 5, ["a"])),
        "save_search": lambda: posegsa.save_search(folder / "none" / "x", hostile()),
        "load_search": lambda: posegsa.load_search(any_of(folder / "none"), hostile()),
    }
    name = list(calls)[rng.integers(len(calls))]
    return Call(name, calls[name])
