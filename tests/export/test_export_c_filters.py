"""Any filter as C: Kalman filters and one of a user's own against Python, step by step.

As the observer's, they agree to 1e-12 of the largest magnitude that a quantity has in the run, over
10 000 samples of a log with jitter and gaps.
"""

import re
import runpy
import subprocess
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.compiled_c import (
    COMPILERS,
    DRIVER,
    Build,
    compile_c,
    needs_cc,
    rotation_matrices,
    sanitizers,
)
from helpers.compiled_c import build as build
from helpers.sensed import START, recorded, rows_of, with_wrong_rows
from jax import Array

import posegsa
from posegsa.errors import ArgumentError, MeasurementError
from posegsa.export import filter_to_c
from posegsa.filters.base import Filter, Record, Sensors
from posegsa.filters.kalman import KalmanFilter, KalmanNoise
from posegsa.filters.leads import Leads
from posegsa.filters.noise_schedules import NoiseGains, NoiseSignal, NoiseSignals
from posegsa.filters.observer import BeliefSettings, ObserverGains
from posegsa.filters.rollout import Estimates
from posegsa.model import sensor_loops
from posegsa.model.measurements import Measurements
from posegsa.model.sample import prepare
from posegsa.model.schedules import KnotGain, RampGain, SwitchGain
from posegsa.model.vectors import VectorSettings

VECTORS = np.array([[0.6, -0.5, 0.62], [0.0, 0.1, 1.0]])
LANDMARKS = np.random.default_rng(3).uniform(-3, 3, (8, 3))
NOISE = (0.02, 0.02, 0.002, 0.003, 0.005, 0.1, 0.15, 1.0, 2.0, 0.1, 0.1, 0.1)
CODES = {"ok": 0, "invalid input": 1, "not finite": 2}
QUANTITIES = ("rotation", "position", "bias", "vector_bias")
KNOWN: dict[str, Any] = {"vectors": VECTORS, "landmarks": LANDMARKS[:1]}
ROOT = Path(__file__).parents[2]


class Case(NamedTuple):
    """A filter, and the number of landmarks that it has in addition to two vectors."""

    filter: Filter
    vectors: np.ndarray
    landmarks: np.ndarray


def kalman(vector_biases: bool) -> KalmanFilter:
    with jax.enable_x64(True):
        return KalmanFilter(KalmanNoise(*(jnp.asarray(x) for x in NOISE)), vector_biases)


def iterated() -> KalmanFilter:
    """One that linearises until the attitude hardly changes, and adapts its covariance."""
    with jax.enable_x64(True):
        level = {"noise_adaptation": jnp.asarray(50.0)}
    return replace(kalman(True), iterations=10, reset="two frames", **level)


def scheduled(name: str, landmarks: int) -> Filter:
    """The paper's controllers on a Kalman filter's noises."""
    with jax.enable_x64(True):
        filter = posegsa.configured(name).filter_for(vectors=2, landmarks=landmarks)
        return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf, np.float64)), filter)


def by_the_clock() -> Filter:
    """Factors over time on a Kalman filter's noises."""
    with jax.enable_x64(True):
        time, log_gain = jnp.asarray([0.0, 0.5, 0.5, 30.0]), jnp.asarray([4.0, 3.0, 1.0, 0.0])
        signal = NoiseSignal(*map(jnp.asarray, (0.1, 30.0, 0.1, 600.0)))
        clock = NoiseGains(KnotGain(time, log_gain))
        return replace(kalman(True), schedule=clock, signals=NoiseSignals(signal, signal))


def led() -> Filter:
    """One by the clock that extrapolates its velocities, with a noise for each sensor."""
    with jax.enable_x64(True):
        return replace(
            by_the_clock(),
            leads=Leads(jnp.asarray(0.5), jnp.asarray(1.25)),
            vector_scales=(1.0, 2.5),
            landmark_scales=(0.5,),
        )


def own() -> Filter:
    """That of the example."""
    kind = runpy.run_path(str(ROOT / "examples" / "own_filter.py"))["ComplementaryFilter"]
    with jax.enable_x64(True):
        return kind(*(jnp.asarray(gain) for gain in (1.0, 4.0, 0.2)))


def believing() -> Filter:
    """The observer as shipped, with belief in each sensor."""
    with jax.enable_x64(True):
        line = RampGain(jnp.asarray(0.1), jnp.asarray(2.0))
        switch = SwitchGain(*map(jnp.asarray, (1.0, 20.0, 0.5, 0.0)))
        shipped = posegsa.configured("observer").filter_for(vectors=2, landmarks=2)
        shipped = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf, np.float64)), shipped)
        signal = NoiseSignal(*map(jnp.asarray, (0.1, 1e6, 0.1, 1e6)))
        return replace(
            shipped,
            schedule=ObserverGains(shipped.schedule, line, switch),
            belief=BeliefSettings(signal, jnp.asarray(0.1), jnp.asarray(0.1)),
        )


@cache
def case_of(name: str) -> Case:
    made = {
        "own": lambda: Case(own(), VECTORS, LANDMARKS[:1]),
        "12 states": lambda: Case(kalman(False), VECTORS, LANDMARKS[:1]),
        "18 states": lambda: Case(kalman(True), VECTORS, LANDMARKS),
        "iterated": lambda: Case(iterated(), VECTORS, LANDMARKS[:1]),
        "led by the clock": lambda: Case(led(), VECTORS, LANDMARKS[:2]),
        "believing": lambda: Case(believing(), VECTORS, LANDMARKS[:2]),
        "recommended": lambda: Case(scheduled("recommended", 1), VECTORS, LANDMARKS[:1]),
        "disturbed": lambda: Case(scheduled("disturbed", 3), VECTORS, LANDMARKS[:3]),
    }
    return made[name]()


CASES = (
    *("own", "12 states", "18 states", "iterated", "led by the clock", "believing"),
    *("recommended", "disturbed"),
)
COARSE = dict.fromkeys(("iterated", "believing", "recommended", "led by the clock"), 1e-4)
COARSE["disturbed"] = 2e-4  # Python's own run in float32 differs by 1.7e-4
"""What is allowed in float where gains, and so estimates, differ by more."""


@cache
def header_of(name: str) -> str:
    case = case_of(name)
    return filter_to_c(case.filter, vectors=case.vectors, landmarks=case.landmarks)


@cache
def exact_run(name: str) -> tuple[Measurements, Estimates]:
    """The "recording", and Python's estimates from it in float64."""
    case = case_of(name)
    m = recorded(case)
    return m, in_python(case.filter, m)


def in_python(filter: Filter, m: Measurements) -> Estimates:
    with jax.enable_x64(True):
        measured = Measurements.from_arrays(**m._asdict(), dtype=np.float64)
        R = rotation_matrices(START[None, :4])[0]
        found = posegsa.run_filter(filter, measured, posegsa.initial_state(R, START[4:]))
        return jax.tree.map(np.asarray, found)


class Found(NamedTuple):
    """What a filter in C returned at each sample, and what it held before."""

    code: np.ndarray
    rotation: np.ndarray
    position: np.ndarray
    bias: np.ndarray
    vector_bias: np.ndarray
    raw: np.ndarray


def run_c(program: Path, rows: np.ndarray, learnt: int) -> Found:
    given = np.concatenate([START.astype(rows.dtype), rows.ravel()]).tobytes()
    done = subprocess.run([program], input=given, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    table = np.frombuffer(done.stdout, rows.dtype).reshape(len(rows), -1)
    state = table[:, 1:].astype(np.float64)
    return Found(
        code=table[:, 0].astype(int),
        rotation=rotation_matrices(state[:, :4]),
        position=state[:, 4:7],
        bias=state[:, 7:13],
        vector_bias=state[:, 13 : 13 + 3 * learnt].reshape(len(rows), learnt, 3),
        raw=table[:, 1:],
    )


def deviation(a: Found, exact: Estimates, name: str) -> float:
    got, want = getattr(a, name), getattr(exact, name)
    assert got.shape == want.shape
    return float(np.abs(got - want).max() / np.abs(want).max()) if want.size else 0.0


def watched(*more: str) -> tuple[str, ...]:
    """Options that check memory and arithmetic; what runs for a moment need not be optimised."""
    return ("-std=c99", "-O0", *more, *sanitizers(COMPILERS[0]), "-g0")


PLAIN = ("-std=c99", "-O1")
"""Options with which the compiler finds what the warnings are about, in a fifth of the time."""


# Agreement ----------------------------------------------------------------------------------------


@needs_cc
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("name", CASES)
def test_the_c_filter_is_the_python_filter(build: Build, name: str, real: str):
    m, exact = exact_run(name)
    rows = rows_of(m, {"double": np.float64, "float": np.float32}[real])
    program = build(header_of(name), *watched(f"-DPOSEGSA_REAL={real}"))
    found = run_c(program, rows, exact.vector_bias.shape[1])
    assert (found.code == CODES["ok"]).all()
    for quantity in QUANTITIES:
        allowed = 1e-12 if real == "double" else COARSE.get(name, 2e-5)
        assert deviation(found, exact, quantity) < allowed, quantity


@needs_cc
def test_one_landmark_is_eight_of_which_seven_are_missing(build: Build):
    """With 18 states, so that Python need not compile it again."""
    case, (m, _) = case_of("18 states"), exact_run("18 states")
    one = filter_to_c(case.filter, **KNOWN)
    alone = m._replace(
        landmarks=m.landmarks[:, :1],
        landmark_weights=m.landmark_weights[:, :1],
        landmark_references=m.landmark_references[:, :1],
    )
    weights = m.landmark_weights * (np.arange(8) == 0)
    missing = m._replace(landmark_weights=weights)
    first, second = (
        run_c(build(header, *watched()), rows_of(each)[:2000], 2)
        for header, each in ((one, alone), (header_of("18 states"), missing))
    )
    np.testing.assert_array_equal(first.raw, second.raw)


@needs_cc
def test_the_variances_are_those_of_python(tmp_path):
    """At the start, as its numbers say; and documented at their indices."""
    source = tmp_path / "variances.c"
    source.write_text(
        '#include "posegsa.h"\n#include <stdio.h>\nint main(void)\n{\n'
        "    const posegsa_real q[4] = {1, 0, 0, 0}, p[3] = {0, 0, 0};\n"
        "    posegsa_state s;\n    int i;\n"
        "    if (posegsa_init(&s, q, p) != POSEGSA_OK) return 1;\n"
        "    for (i = 0; i < POSEGSA_ERROR_STATES; ++i)"
        ' printf("%.17g\\n", posegsa_variance(&s, i));\n    return 0;\n}\n'
    )
    program = compile_c(tmp_path, header_of("18 states"), source, *watched(), compiler=COMPILERS[0])
    said = subprocess.run([program], check=True, capture_output=True, text=True).stdout
    expected = np.repeat(np.square(NOISE[7:]), [3, 3, 3, 3, 6])
    np.testing.assert_allclose(np.array(said.split(), float), expected, rtol=1e-15)


class Remembered(NamedTuple):
    """A state with an estimate inside, and more than that."""

    half: tuple[Array, Array, Array]
    """Half of the position."""
    turned: tuple[Array, Array, Array, Array]
    seconds: Array
    counted: Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Odd:
    """A filter whose estimate is computed from its state, and that uses all of its input."""

    gain: Array
    kind: str = field(default="odd", metadata={"static": True})

    def with_values(self, values: Any) -> "Odd":
        return replace(self, **values)

    def prepare(self, measurements: Measurements) -> Any:
        return prepare(measurements, VectorSettings(each_agent=True))

    def start(self, initial: Any, sensors: Sensors) -> Any:
        x, y, z = initial.place
        zero = jnp.zeros_like(x)
        return Remembered(
            (0.5 * x, 0.5 * y, 0.5 * z), initial.attitude, zero, zero + sensors.vectors
        )

    def ready(self) -> "Odd":
        return self

    def step(self, state: Remembered, now: Any) -> tuple[Remembered, Record]:
        sample = now.sample
        sine = jnp.sin(0.1 * sample.time_step)
        w, x, y, z = state.turned
        cosine = jnp.sqrt(1 - sine * sine)
        turned = (cosine * w - sine * x, cosine * x + sine * w, cosine * y + sine * z)
        after = Remembered(
            half=tuple(
                a + self.gain * v * sample.time_step
                for a, v in zip(state.half, sample.velocity, strict=True)
            ),
            turned=(*turned, cosine * z - sine * y),
            seconds=now.time + 0.001 * sample.reach,
            counted=state.counted + 1,
        )
        return after, Record()

    def estimate(self, state: Remembered) -> Any:
        x, y, z = state.half
        zero = jnp.zeros_like(x)
        return posegsa.FilterState(
            attitude=state.turned,
            place=(2 * x, 2 * y, 2 * z),
            bias_angular=(state.seconds, zero, zero),
            bias_linear=(zero, state.counted, zero),
        )


@needs_cc
def test_an_estimate_that_is_computed_of_the_state(build: Build):
    """With the time, the farthest landmark, a counter; and a function of <math.h>."""
    with jax.enable_x64(True):
        odd = Odd(jnp.asarray(0.5))
    m, _ = exact_run("own")
    m = m._replace(**{name: a[:500] for name, a in m._asdict().items()})
    header = filter_to_c(odd, **KNOWN)
    assert "posegsa_real half[3];" in header
    assert "posegsa_real time;" in header
    found, exact = run_c(build(header, *watched()), rows_of(m), 0), in_python(odd, m)
    for quantity in QUANTITIES:
        assert deviation(found, exact, quantity) < 1e-12, quantity


# Bad input ----------------------------------------------------------------------------------------


@needs_cc
def test_invalid_input_leaves_the_state_unchanged(build: Build):
    good = np.nan_to_num(rows_of(exact_run("own")[0])[:200])
    weights = [13, 14, 18]
    good[:, weights] = 1
    rows, wrong = with_wrong_rows(good)
    program = build(header_of("12 states"), *watched())
    mixed, alone = (run_c(program, each, 0) for each in (rows, good))
    expected = np.where(wrong, CODES["invalid input"], 0)
    np.testing.assert_array_equal(mixed.code, expected)
    np.testing.assert_array_equal(mixed.raw[expected == 0], alone.raw)


@needs_cc
@pytest.mark.parametrize("real", ["double", "float"])
def test_garbage_spoils_nothing(tmp_path: Path, real: str):
    """The checks are in `fuzz_filter.c`."""
    options = watched(f"-DPOSEGSA_REAL={real}", "-DSTEPS=40000")
    source = DRIVER.with_name("fuzz_filter.c")
    program = compile_c(tmp_path, header_of("18 states"), source, *options, compiler=COMPILERS[0])
    assert subprocess.run([program], check=False).returncode == 0


def changed(**functions: Any) -> Any:
    """A filter like `Odd` with other functions."""
    base = Odd(jnp.asarray(0.5))
    kind = jax.tree_util.register_dataclass(
        dataclass(frozen=True)(type("Changed", (Odd,), {"__module__": __name__, **functions})),
        data_fields=["gain"],
        meta_fields=["kind"],
    )
    return kind(base.gain)


def step_with(word: str) -> Any:
    table, two = np.arange(3.0), jnp.asarray(2)

    def step(self: Any, state: Remembered, now: Any) -> Any:
        x = state.counted
        made = {
            "table": lambda: x + jnp.asarray(table)[0],
            "integer": lambda: x * (x.astype(int) + two).astype(x.dtype),
            "lgamma": lambda: jax.scipy.special.gammaln(x),
            "switch": lambda: jax.lax.switch(x.astype(int), [lambda: x, lambda: -x, lambda: 2 * x]),
            "counter": lambda: jax.lax.fori_loop(0, 3, lambda i, a: a + i, x),
        }
        return state._replace(counted=made[word]()), Record()

    return step


def another_state(self: Any, state: Remembered, now: Any) -> Any:
    return tuple(state), Record()


def starting_with(extra: Any) -> Any:
    def start(self: Any, initial: Any, sensors: Sensors) -> Any:
        return Odd.start(self, initial, sensors)._replace(counted=extra)

    return start


@pytest.mark.quick
@pytest.mark.parametrize(
    ("functions", "words"),
    [
        ({"step": step_with("table")}, r"array of shape \(3,\)|on arrays"),
        ({"step": step_with("integer")}, "of type int|on integers"),
        ({"step": step_with("lgamma")}, "'lgamma'"),
        ({"step": step_with("switch")}, "on integers"),
        ({"step": step_with("counter")}, "'scan' on integers|arrays"),
        ({"step": another_state}, r"state.half\[0\] is in the state before it"),
        ({"start": starting_with(jnp.asarray(0))}, "its state's counted is of type int"),
        ({"start": starting_with(jnp.zeros(3))}, r"counted is an array of shape \(3,\)"),
        ({"estimate": lambda self, state: state}, "estimate: returns a Remembered"),
        ({"prepare": lambda self, m: m}, "returns a Measurements"),
        (
            {"prepare": lambda self, m: prepare(m, VectorSettings())},
            r"sums up the vectors.*each_agent=True",
        ),
        (
            {"prepare": lambda self, m: prepare(m._replace(velocity=2 * m.velocity), AS_THEY_ARE)},
            "changes the measured values",
        ),
    ],
)
def test_what_can_not_be_written_is_refused_by_name(x64, functions: Any, words: str):
    with pytest.raises(ArgumentError, match=words) as refused:
        filter_to_c(changed(**functions), **KNOWN)
    assert "; allowed: " in str(refused.value)


AS_THEY_ARE = VectorSettings(each_agent=True)


@pytest.mark.quick
@pytest.mark.parametrize(
    ("filter", "words"),
    [
        (Odd(jnp.ones(3)), r"its gain is an array of shape \(3,\); allowed: .*real scalars"),
        (Odd(jnp.asarray(3)), "its gain is of type int"),
        (KalmanFilter, "the class KalmanFilter"),
        (5, "filter: a int; allowed: a filter"),
    ],
)
def test_a_filter_not_made_of_scalars_is_refused(filter: Any, words: str):
    with pytest.raises(ArgumentError, match=words):
        filter_to_c(filter, **KNOWN)


@pytest.mark.quick
def test_references_are_checked():
    with pytest.raises(ArgumentError, match="none; allowed: at least one"):
        filter_to_c(Odd(jnp.asarray(1.0)))
    with pytest.raises(MeasurementError, match="vector_references: must not be zero"):
        filter_to_c(Odd(jnp.asarray(1.0)), vectors=np.zeros((1, 3)))


# The file -----------------------------------------------------------------------------------------


@needs_cc
@pytest.mark.parametrize("name", CASES)
def test_the_example_in_the_head_compiles_and_runs(tmp_path: Path, name: str):
    lines = header_of(name).split(" * USE\n")[1].split(" *\n")[0].splitlines()
    source = tmp_path / "example.c"
    source.write_text("\n".join(line.removeprefix(" * ") for line in lines) + "\n")
    program = compile_c(tmp_path, header_of(name), source, *PLAIN, compiler=COMPILERS[0])
    said = subprocess.run([program], check=True, capture_output=True, text=True).stdout
    assert 0.99 < float(said) <= 1


@needs_cc
def test_the_example_of_the_page_with_all_sensors_finds_the_pose(tmp_path: Path):
    page = (ROOT / "docs" / "export.md").read_text("utf-8")
    _, code, _ = re.findall(r"```c\n(.*?)```", page, re.DOTALL)
    (tmp_path / "example.c").write_text(code, "utf-8")
    header, source = header_of("recommended"), tmp_path / "example.c"
    program = compile_c(tmp_path, header, source, *watched(), compiler=COMPILERS[0])
    done = subprocess.run([program], check=True, capture_output=True, text=True)
    in_page = re.search(r"It prints ([-.\d ]+),", page)
    assert in_page is not None
    circle = [2 * np.sin(15), 2 - 2 * np.cos(15), 0]
    for printed in (in_page[1], done.stdout):
        np.testing.assert_allclose([float(x) for x in printed.split()], circle, atol=0.01)
    assert done.stderr == ""


@pytest.mark.quick
def test_the_start_of_a_kalman_filter_says_from_how_far_off_it_converges():
    assumed = dict(zip(KalmanNoise._fields, NOISE, strict=True))
    words = header_of("18 states").partition("/* Starts a filter.")[2].partition("*/")[0]
    degrees, metres = map(float, re.findall(r"([\d.]+) (?:deg|m) ", words)[:2])
    assert degrees == pytest.approx(np.degrees(assumed["initial_attitude"]), rel=0.01)
    assert metres == pytest.approx(assumed["initial_position"], rel=0.01)


def test_the_header_is_the_same_where_jax_runs_on_a_gpu(monkeypatch):
    case, want = case_of("believing"), header_of("believing")
    monkeypatch.setattr(sensor_loops, "on_gpu", lambda: True)
    assert filter_to_c(case.filter, vectors=case.vectors, landmarks=case.landmarks) == want


@pytest.mark.quick
def test_the_kalman_filter_is_under_115_kb_however_many_landmarks():
    header = header_of("18 states")
    assert header.isascii()
    assert len(header) < 115_000
    one = filter_to_c(case_of("18 states").filter, **KNOWN)
    assert len(header) - len(one) < 1000  # the table of the landmarks


@pytest.mark.quick
def test_measurement_and_functions_are_the_observers():
    """So that one filter can be put in another's place."""
    experiment = posegsa.Experiment()
    observer = posegsa.Observer(
        posegsa.ConstantGain(jnp.asarray(10.0)),
        posegsa.filter_settings(experiment),
        posegsa.signal_settings(experiment.gain, np.float32),
    )
    of_observer = filter_to_c(observer, **KNOWN)
    for pattern in (
        r"typedef struct posegsa_measurement \{.*?\} posegsa_measurement;",
        r"enum \{\n    POSEGSA_OK = .*?\};",
        r"static inline int posegsa_(?:init|step)\([^)]*\);",
    ):
        found = [re.findall(pattern, text, re.DOTALL) for text in (of_observer, header_of("own"))]
        assert found[0]
        assert found[0] == found[1]


@pytest.mark.quick
def test_names_have_the_prefix_that_was_asked_for():
    text = filter_to_c(case_of("own").filter, name="nav", **KNOWN)
    assert "static inline int nav_step(" in text
    assert "NAV_LANDMARKS = 1" in text
    assert not re.search(r"\bposegsa_", text)
    assert "-DNAV_REAL=float" in text
    assert "POSEGSA_" not in text
