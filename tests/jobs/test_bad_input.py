"""Unusable input is refused, and the error names it."""

import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import BASE, TINY, tiny
from helpers.generated import call, configuration, some_result

import posegsa
from posegsa import config
from posegsa.errors import ArgumentError, MeasurementError, MemoryLimitError, PosegsaError
from posegsa.model.vectors import VectorSettings
from posegsa.search import memory
from posegsa.search.problem import tuning_problem

pytestmark = pytest.mark.quick

SECTIONS = tuple(config.Experiment.model_fields)


@pytest.fixture(scope="module")
def result():
    return some_result()


# Thousands of generated inputs --------------------------------------------------------------------


def test_generated_configurations_are_accepted_or_refused_by_name():
    """`benchmarks/faults.py` runs hundreds of accepted ones, `test_tuning.py` a few."""
    rng, base = np.random.default_rng(0), tiny()
    accepted, unnamed = 0, []
    for _ in range(1500):
        data = configuration(rng, base)
        try:
            experiment = config.from_dict(data)
        except PosegsaError as error:
            named = re.findall(r"^  (\S+)", str(error), flags=re.MULTILINE)
            keys = (*SECTIONS, *data, "(top")
            if not named or any(name.split(".")[0] not in keys for name in named):
                unnamed.append(str(error))
            continue
        accepted += 1
        assert config.from_dict(experiment.model_dump(mode="json")) == experiment
        assert all(0 < share < 2**60 for share in memory.needs(experiment).values())
    assert 150 < accepted < 750
    assert unnamed == []


def test_generated_calls_are_answered_or_refused(result):
    rng = np.random.default_rng(1)
    refused: dict[str, int] = {}
    for _ in range(450):
        made = call(rng, result)
        try:
            with np.errstate(over="ignore"):  # infinite, because float32 overflows
                made.make()
        except PosegsaError:
            refused[made.name] = refused.get(made.name, 0) + 1
    assert len(refused) > 30


def test_configurations_hold_no_paths():
    """Every text in a configuration is one of a few words, so none is a path out of the folder."""

    def texts(schema, root):
        for node in schema.values() if isinstance(schema, dict) else schema:
            if isinstance(node, dict):
                if node.get("type") == "string":
                    yield node
                yield from texts(node, root)
            elif isinstance(node, list):
                yield from texts([n for n in node if isinstance(n, dict)], root)

    schema = config.Experiment.model_json_schema()
    # A key in parameters.also is refused unless it names a number (`test_tunable`).
    found = [node for node in texts(schema, schema) if node.get("title") != "Key"]
    assert len(found) >= 10
    words = r"^[A-Za-z0-9_]+$"
    assert all("enum" in n or "const" in n or n.get("pattern") == words for n in found)


# One by one ---------------------------------------------------------------------------------------


STATE = posegsa.initial_state(np.eye(3), np.zeros(3))
NO_VECTORS = VectorSettings()


def measured() -> posegsa.Measurements:
    """Two samples with velocities only."""
    still = np.zeros((2, 3))
    return posegsa.Measurements.from_arrays(time_step=0.1, angular_velocity=still, velocity=still)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda r: posegsa.tune({"run": {}}), r"experiment:.* dict.*Experiment"),
        (lambda r: posegsa.tune(5), "experiment: a int"),
        (lambda r: posegsa.tune(progress=5), r"progress:.* int.*function"),
        (lambda r: posegsa.tune(seed=-1), "run.seed = -1"),
        (lambda r: posegsa.tune(seed=2**32), "run.seed = 4294967296"),
        (lambda r: posegsa.tune(iterations=-3), "search.iterations = -3"),
        (lambda r: posegsa.tune(iterations=True), "search.iterations = true"),
        (lambda r: posegsa.tune_batch(5), "experiments: a int"),
        (lambda r: posegsa.tune_batch([tiny(), 5]), "experiment: a int"),
        (lambda r: posegsa.tune_batch(tiny(), seeds=5), "seeds: a int"),
        (lambda r: posegsa.tune_batch([]), "nothing to tune"),
        (lambda r: posegsa.evaluate(5), r"result:.* int.*Result"),
        (lambda r: posegsa.evaluate(r, scenarios=1), r"scenarios = 1.*whole number from"),
        (lambda r: posegsa.evaluate(r, scenarios=5, seed=-1), "seed = -1"),
        (lambda r: posegsa.export_c("run"), "result: a str"),
        (lambda r: posegsa.export_csv(r, 1), "resolution = 1"),
        (lambda r: posegsa.plot_surface(r), "controller: a Result"),
        (lambda r: posegsa.parameter_space({}), "experiment: a dict"),
        (lambda r: posegsa.load(5), "folder = 5"),
        (lambda r: posegsa.load_config(5), "path: a int"),
        (lambda r: config.override(tiny(), "run.seed=1"), "settings = 'run.seed=1'"),
        (lambda r: posegsa.filter_settings({}), "experiment: a dict"),
        (lambda r: posegsa.signal_settings(tiny().gain, int), "dtype = .*floating"),
        (lambda r: posegsa.initial_state(np.eye(2), np.zeros(3)), r"rotation: .*\(3, 3\)"),
        (lambda r: posegsa.initial_state(np.eye(3), "here"), "position"),
        (lambda r: posegsa.run_filter(5, measured(), STATE), "filter: a int"),
        (lambda r: posegsa.run_filter(r.filter_for(0, 0), 5), "a Measurements or a Recording"),
        (lambda r: posegsa.run_filter(r.filter_for(0, 0), measured(), 5), "initial: a int"),
        (lambda r: posegsa.replay(5, []), r"result:.* int.*Result, or the name"),
        (lambda r: posegsa.replay(r, 5), "recordings: a int"),
        (lambda r: posegsa.evaluate(r, recordings=[]), "recordings: none"),
        (lambda r: posegsa.evaluate(r, training=[]), "training, others without recordings"),
        (lambda r: posegsa.configured(schedule=5), "schedule: a int"),
        (lambda r: posegsa.recording_errors(5, 5), "estimates: a int"),
        (lambda r: posegsa.Recording.read(5), "path: a int"),
        (lambda r: posegsa.step(5, 5, 5), "filter: a int"),
        (lambda r: posegsa.step(r.filter_for(0, 0), None, 5), "measurement: a int"),
        (lambda r: r.controller([1.0, 2.0], [1.0, 2.0, 3.0]), "error, rate, last"),
        (lambda r: r.estimate(5, np.eye(3), np.zeros(3)), "measurements: a int"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(result, make, said):
    with pytest.raises(PosegsaError, match=said):
        make(result)


def sphere(x):
    return jnp.sum(x**2, axis=1)


GOOD = {
    "objective": sphere,
    "box": posegsa.box([0.0], [1.0]),
    "optimiser": posegsa.GSA(agents=3, iterations=2),
    "key": jax.random.key(0),
}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"objective": 5}, r"objective:.* int.*function"),
        ({"objective": lambda x: np.sin(x)[:, 0]}, "objective: .*outside JAX.*jax.numpy"),
        ({"objective": lambda x: 0.0 if x[0, 0] > 0 else 1.0}, "objective: .*outside JAX"),
        ({"objective": lambda x: None}, "objective: costs are a NoneType"),
        (
            {"objective": lambda x: sphere(x).astype(jnp.complex64)},
            "objective: costs are complex64",
        ),
        ({"objective": lambda x: x}, r"objective: costs are float32 of shape \(3, 1\)"),
        ({"box": ([0.0], [1.0])}, r"box:.* tuple.*Box"),
        ({"box": posegsa.box([0.0], [1.0])._replace(upper=[np.nan])}, r"box: upper\[0\] = nan"),
        ({"optimiser": posegsa.GSA}, "optimiser: a class"),
        ({"optimiser": "gsa"}, "optimiser: a str"),
        ({"key": 0}, r"key:.* int.*jax.random.key"),
        (
            {"key": jax.random.split(jax.random.key(0), (2, 2))},
            r"key: a key<fry> \(2, 2\)",
        ),
        ({"callback": 5}, "callback: a int"),
    ],
)
def test_minimise_refuses_by_name(change, said):
    with pytest.raises(ArgumentError, match=said):
        posegsa.minimise(**GOOD | change)


def test_what_an_objective_raises_is_its_own():
    def objective(x):
        raise LookupError("mine")

    with pytest.raises(LookupError, match="mine"):
        posegsa.minimise(**GOOD | {"objective": objective})


def test_measurements_made_by_hand_are_checked_too(result):
    good = posegsa.Measurements.from_arrays(
        time_step=0.01,
        angular_velocity=np.zeros((5, 3)),
        velocity=np.zeros((5, 3)),
        landmarks=np.ones((5, 1, 3)),
        landmark_references=np.ones((1, 3)),
    )
    gain = posegsa.ConstantGain(jnp.ones(()))
    filter = posegsa.Observer(gain, replace(posegsa.filter_settings(tiny()), vectors=NO_VECTORS))
    for change, said in (
        ({"velocity": jnp.full((5, 3), jnp.nan)}, r"velocity:.*finite.* nan"),
        ({"velocity": jnp.zeros((4, 3))}, r"velocity:.* \(5, 3\)"),
        (
            {"time_step": jnp.asarray([1, 1, -1, 1, 1]) / 100},
            r"time_step:.*positive",
        ),
        ({"time_step": jnp.full(5, jnp.inf)}, r"time_step:.*finite"),
        ({"landmark_weights": -jnp.ones((5, 1))}, r"landmark_weights:.*not neg"),
    ):
        with pytest.raises(MeasurementError, match=said):
            posegsa.run_filter(filter, good._replace(**change), STATE)


# Memory -------------------------------------------------------------------------------------------


def test_memory_is_estimated_by_what_takes_it():
    task = tuning_problem(tiny())
    held = sum(leaf.nbytes for leaf in jax.tree.leaves(task.scenarios.samples))
    shares = memory.needs(tiny())
    estimated = shares["run.held_out_scenarios"] + shares["run.training_scenarios"]
    assert held < estimated < 20 * held
    double = memory.needs(tiny("run.held_out_scenarios=6"))
    assert double["run.held_out_scenarios"] == 2 * shares["run.held_out_scenarios"]
    assert memory.available() is None or memory.available() > 0
    longer = memory.needs(tiny("run.endurance_times=16"))
    assert longer["run.endurance_scenarios"] == 2 * shares["run.endurance_scenarios"] > 0


def test_endurance_that_needs_too_much_memory_is_refused_by_its_name():
    much = tiny("run.endurance_scenarios=1000000", "run.endurance_times=1000")
    with pytest.raises(MemoryLimitError, match=r"(?s)run\.endurance_scenarios.*endurance_times"):
        memory.check([much])


def test_files_that_the_system_can_drop_are_free_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(memory, "CGROUP", tmp_path)
    assert memory.available() is None
    (tmp_path / "memory.max").write_text("9000\n")
    (tmp_path / "memory.current").write_text("8000\n")
    assert memory.available() == 1000
    stat = "anon 5000\nfile 3000\ninactive_anon 10\nactive_file 500\ninactive_file 2500\n"
    (tmp_path / "memory.stat").write_text(stat)
    assert memory.available() == 3500
    (tmp_path / "memory.stat").write_text("inactive_file\ninactive_file many\n")
    assert memory.available() == 1000
    (tmp_path / "meminfo").write_text("MemTotal: 9 kB\nMemAvailable:       2 kB\n")
    (tmp_path / "memory.max").write_text("max\n")
    assert memory.available() == 2048


def test_what_would_not_fit_is_refused_with_an_estimate(monkeypatch):
    huge = tiny("run.training_scenarios=1000000", "search.agents=3000")
    with pytest.raises(MemoryLimitError) as refused:
        posegsa.tune(huge)
    text = str(refused.value)
    for words in ("GiB", "search.agents = 3000", "run.training_scenarios = 1000000"):
        assert words in text
    monkeypatch.setattr(memory, "available", lambda: 2**30)
    memory.check([tiny()])
    with pytest.raises(MemoryLimitError, match="scenarios = 1000000"):
        memory.check([tiny()], held_out=10**6)
    with pytest.raises(MemoryLimitError, match="2000 experiments"):
        memory.check([tiny("run.held_out_scenarios=500")] * 2000)
    monkeypatch.setattr(memory, "available", lambda: None)
    memory.check([huge])
    assert len(TINY) == len(BASE) + 6
