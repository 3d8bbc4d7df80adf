"""The whole filter as C: the compiled header against the Python filter, step by step.

Both filters forget: a rounding error of one step decays over the next ones, so runs of any length
can be compared number by number. In double they agree to 1e-12 of the largest magnitude of a
quantity in the run. In float both differ from the run in double; the C may differ by four times
the difference of JAX in float32, plus a few units of rounding.
"""

import re
import subprocess
import textwrap
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.compiled_c import (
    COMPILERS,
    WARNINGS,
    Build,
    Layout,
    States,
    compile_c,
    need,
    needs_cc,
    rotation_matrices,
    run_c,
    sanitizers,
)
from helpers.compiled_c import build as build
from helpers.controllers import fuzzy
from helpers.filters import settings, state_of, vector_bias, vector_settings
from helpers.results import endurance, trust
from helpers.schedules import K, tuned
from helpers.sensed import SAMPLES, START, recorded, rows_of, sensed, with_wrong_rows

import posegsa
from posegsa import config
from posegsa.errors import ArgumentError, MeasurementError
from posegsa.export import export_c, filter_to_c
from posegsa.filters.base import samples_of
from posegsa.filters.observer import FilterSettings, Observer
from posegsa.filters.rollout import Estimates, simulate
from posegsa.judging.result import Result
from posegsa.model.measurements import Measurements
from posegsa.model.schedules import (
    ConstantGain,
    Gains,
    GainSchedule,
    KnotGain,
    ScheduleInputs,
    SmoothGain,
    SwitchGain,
)
from posegsa.model.signal import SignalSettings, Unknown
from posegsa.search.configured_filters import filter_settings, signal_settings

VECTORS = np.array([[0.6, -0.5, 0.62], [0.0, 0.1, 1.0], [-0.3, 2.0, 0.4]])
LANDMARKS = np.array([[0.5, 1.41, 1.0], [-2.0, 0.3, 0.8], [1.0, -3.0, 0.1]])
QUANTITIES = ("rotation", "position", "bias", "vector_bias", "gain_used")
CODES = {"ok": 0, "invalid input": 1, "not finite": 2}

RECOMMENDED = (
    *("filter.vector_bias=estimated", "filter.vector_bias_law=linear", "filter.gamma=2.5"),
    *("filter.gamma_law=quadratic", "filter.substeps=2", "filter.cross_vector=true"),
    *("gain.smoothing=1.5", "gain.error_scale=0.3", "filter.excitation=0.1"),
)
"""The recommended filter with the paper's sensors."""
ALSO = {"filter.vector_bias_gain": 0.4375, "filter.cross_vector_weight": 0.75}


@dataclass(frozen=True)
class Case:
    """A filter, in Python and for the export."""

    schedule: GainSchedule
    settings: FilterSettings
    signal: SignalSettings
    vectors: np.ndarray
    landmarks: np.ndarray
    layout: Layout

    def header(self) -> str:
        return filter_to_c(
            Observer(self.schedule, self.settings, self.signal),
            vectors=self.vectors if len(self.vectors) else None,
            landmarks=self.landmarks if len(self.landmarks) else None,
        )

    def at(self, dtype: str) -> "Case":
        """The same at another precision."""
        chosen = {
            name: jax.tree.map(lambda a: jnp.asarray(np.asarray(a, np.float64), dtype), record)
            for name, record in vars(self).items()
            if name in ("schedule", "settings", "signal")
        }
        return replace(self, **chosen)


def signal(**numbers: Any) -> SignalSettings:
    values = {"position_weight": 0.3, "smoothing": 0.0, "error_scale": 0.4, "rate_scale": 2.0}
    texts = {"signal": "measured", "rate": "per_sample"}
    unknown = numbers.pop("unknown", None)
    for name, value in numbers.items():
        (texts if isinstance(value, str) else values)[name] = value
    made = {name: jnp.asarray(value, np.float64) for name, value in values.items()}
    return SignalSettings(**texts, **made, unknown=unknown)


def recommended_result(*more: str, **fields: Any) -> Result:
    return tuned(K, *RECOMMENDED, *more, also=ALSO, **fields)


def recommended() -> Case:
    """As in `Result`; the export is by `export_c`."""
    result = recommended_result()
    experiment = config.override(result.tuned, ["run.dtype=float64"])
    scenario = experiment.scenario
    return Case(
        schedule=result.schedule,
        settings=filter_settings(experiment),
        signal=signal_settings(experiment.gain, np.float64),
        vectors=np.array([v.direction for v in scenario.vectors]),
        landmarks=np.array([p.position for p in scenario.landmarks]),
        layout=Layout(2, 1, learns=True),
    )


def printed() -> Case:
    """The paper's filter: no estimated vector biases, no normalisation, no gain limit."""
    low = np.array([[0, 0, 1], [0.5, 1, 2], [1, 2, 3], [2, 3, 4], [3.5, 5, 5]]) / 2
    high = np.array([[0, 0, 0.2], [0.1, 0.2, 0.4], [0.3, 0.4, 0.6], [0.5, 0.7, 0.9], [0.8, 1, 1]])
    controller = fuzzy(
        *(high, low),
        output_range=(0.0, 2.5),
        centroid="sampled",
        sampled_points=31,
        sampled_rule="trapezoid",
        offset=0.5,
    )
    return Case(
        schedule=posegsa.FuzzyGain(controller),
        settings=settings(
            law="printed",
            substeps=1,
            gain_limit=None,
            gamma=(0.1, 0.2),
            vectors=vector_settings(weights=(0.5, 1.0, 0.25)),
            landmark_weights=(0.2, 0.3),
        ),
        signal=signal(rate="per_second", rate_scale=0.5),
        vectors=VECTORS,
        landmarks=LANDMARKS[:2],
        layout=Layout(3, 2, learns=False),
    )


def attitude_only() -> Case:
    """Vectors only, a smooth gain, and a vector bias law with a leak that scales with K^2."""
    learnt = vector_bias(gain=0.3, leak=0.05, bound=0.3, follows="quadratic")
    return Case(
        schedule=SmoothGain(*(jnp.asarray(x, np.float64) for x in (3.0, 20.0, 0.4))),
        settings=settings(
            gamma_law="linear",
            substeps=3,
            vectors=vector_settings(cross_weight=0.5, normalise=True, each_agent=True),
            learnt=learnt,
        ),
        signal=signal(smoothing=0.4, position_weight=0.0),
        vectors=VECTORS[:2],
        landmarks=LANDMARKS[:0],
        layout=Layout(2, 0, learns=True),
    )


def landmarks_alone() -> Case:
    """Landmarks only, a gain that changes with time, and a different gamma for each velocity."""
    numbers = {"before": 12.0, "after": 4.0, "time": 12.3456, "learning_time": 5.4321}
    return Case(
        schedule=SwitchGain(**{k: jnp.asarray(v, np.float64) for k, v in numbers.items()}),
        settings=settings(
            gamma_law="linear",
            substeps=2,
            gamma=(1.0, 3.0),
            length=2.5,
            bias_bounds=(0.05, 0.1),
        ),
        signal=signal(),
        vectors=VECTORS[:0],
        landmarks=LANDMARKS,
        layout=Layout(0, 3, learns=False, time=True),
    )


def attitude_alone() -> Case:
    """Without landmarks and without biases of vectors."""
    numbers = {"low": 4.0, "high": 25.0, "half": 0.2}
    return Case(
        schedule=SmoothGain(**{k: jnp.asarray(v, np.float64) for k, v in numbers.items()}),
        settings=settings(gamma_law="quadratic", gamma=(0.3, 0.3)),
        signal=signal(),
        vectors=VECTORS[:2],
        landmarks=LANDMARKS[:0],
        layout=Layout(2, 0, learns=False, time=False),
    )


def over_time() -> Case:
    """Open-loop gains; the first knot is after the start of the run and the last before its end."""
    time, gain = np.array([0.3, 1.0, 7.654321, 40.0]), np.array([25.0, 40.0, 6.0, 3.0])
    return Case(
        schedule=KnotGain(jnp.asarray(time), jnp.log(jnp.asarray(gain))),
        settings=settings(
            vectors=vector_settings(normalise=True, each_agent=True), learnt=vector_bias()
        ),
        signal=signal(),
        vectors=VECTORS[:1],
        landmarks=LANDMARKS[:2],
        layout=Layout(1, 2, learns=True, time=True),
    )


def unknown() -> Case:
    """The input includes the unknown share, the bias laws wait, and the unit of length grows."""
    result = recommended_result()
    numbers = {"start": 0.6, "fall": 0.005, "rise": 0.5}
    unknown = Unknown(**{name: jnp.asarray(value, np.float64) for name, value in numbers.items()})
    return Case(
        schedule=result.schedule,
        settings=settings(
            gamma_law="quadratic",
            substeps=2,
            vectors=vector_settings(normalise=True, each_agent=True),
            learnt=vector_bias(follows="linear"),
            length=1.5,
            length_growth=0.2,
            landmark_unit="length",
            bias_wait=0.4,
        ),
        signal=signal(smoothing=0.4, unknown=unknown),
        vectors=VECTORS[:2],
        landmarks=LANDMARKS[:2],
        layout=Layout(2, 2, learns=True, unknown=True),
    )


CASES: dict[str, Callable[[], Case]] = {
    "observer": recommended,
    "printed": printed,
    "attitude only": attitude_only,
    "landmarks alone": landmarks_alone,
    "attitude alone": attitude_alone,
    "over time": over_time,
    "unknown": unknown,
}


def in_python(case: Case, m: Measurements, dtype: str) -> Estimates:
    """The estimates of the Python filter."""
    with jax.enable_x64(dtype == "float64"):
        at = case.at(dtype)
        measured = Measurements.from_arrays(**m._asdict(), dtype=np.dtype(dtype))
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation_matrices(START[None, :4])[0], START[4:]
        start = state_of(T, dtype=dtype)
        observer = Observer(at.schedule, at.settings, at.signal)
        found = simulate(observer, jax.jit(samples_of)(observer, measured), start)
        return jax.tree.map(np.asarray, found)


def start_of(case: Case) -> np.ndarray:
    return START if len(case.landmarks) else START[:4]


def options_of(case: Case, *options: str, optimise: str = "-O0") -> tuple[str, ...]:
    return ("-std=c99", optimise, *options, *(() if len(case.landmarks) else ("-DATTITUDE_ONLY",)))


def deviation(a: States | Estimates, exact: Estimates, name: str) -> float:
    """Largest difference of a quantity over the run, in units of its largest magnitude."""
    got, want = (np.asarray(getattr(e, name), np.float64) for e in (a, exact))
    if isinstance(a, States) and name == "gain_used":  # known only after the step
        got, want = got[1:], want[:-1]
    if isinstance(a, States) and name == "bias":  # an attitude filter in C has three
        want = want[:, : got.shape[1]]
    if not got.size:
        return 0.0
    return float(np.abs(got - want).max() / np.abs(want).max())


@cache
def everything() -> dict[str, Case]:
    with jax.enable_x64(True):
        return {name: make() for name, make in CASES.items()}


@cache
def header_of(name: str) -> str:
    """The exported filter of a case."""
    return everything()[name].header()


@cache
def exact_run(name: str) -> tuple[Measurements, Estimates]:
    """The "recorded" measurements, and Python's estimates from them in float64."""
    m = recorded(everything()[name])
    return m, in_python(everything()[name], m, "float64")


@cache
def simulated_runs() -> tuple[Measurements, Estimates, Estimates]:
    """Measurements at 100 Hz without gaps; Python's estimates in float64 and in float32."""
    case = everything()["observer"]
    m = sensed(case, np.full(SAMPLES, 0.01))
    return m, in_python(case, m, "float64"), in_python(case, m, "float32")


# Agreement ----------------------------------------------------------------------------------------


@needs_cc
@pytest.mark.parametrize("name", CASES)
def test_the_c_filter_is_the_python_filter(build: Build, name: str):
    """Under the sanitizers, with missing measurements and uneven time steps."""
    case, (m, exact) = everything()[name], exact_run(name)
    watched = sanitizers(COMPILERS[0])
    program = build(header_of(name), *options_of(case, *watched))
    found = run_c(
        program, case.layout, start_of(case), rows_of(m, velocity=len(case.landmarks) > 0)
    )
    assert (found.code == CODES["ok"]).all()
    assert np.ptp(exact.gain_used) > 1, "the schedule has something to do"
    for quantity in QUANTITIES if len(case.landmarks) else ("rotation", "bias", "vector_bias"):
        assert deviation(found, exact, quantity) < 1e-12, quantity


@needs_cc
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_each_compiler_on_simulated_input_in_both_precisions(build: Build, compiler: str):
    need(compiler)
    case = everything()["observer"]
    header = export_c(recommended_result())
    m, exact, single = simulated_runs()
    for real, dtype in (("double", np.float64), ("float", np.float32)):
        chosen = (f"-DPOSEGSA_REAL={real}", *sanitizers(compiler))
        options = options_of(case, *chosen, optimise="-O1")
        program = build(header, *options, compiler=compiler)
        found = run_c(program, case.layout, START, rows_of(m, dtype))
        assert (found.code == CODES["ok"]).all()
        for quantity in QUANTITIES:
            allowed = 1e-12
            if real == "float":
                allowed = 4 * deviation(single, exact, quantity) + 8 * np.finfo(np.float32).eps
            assert deviation(found, exact, quantity) < allowed, (real, quantity)


def test_a_result_is_exported_as_its_parts_are():
    with jax.enable_x64(True):
        parts = everything()["observer"].header()
    after = re.compile(r"#ifndef POSEGSA_H.*", re.DOTALL)
    (from_result,), (by_hand,) = map(after.findall, (export_c(recommended_result()), parts))
    assert from_result == by_hand
    assert "posegsa_vector_bias_gain = POSEGSA_C(0.4375);" in from_result, "what was tuned too"


# Bad input ----------------------------------------------------------------------------------------


@needs_cc
def test_invalid_input_leaves_the_state_unchanged(build: Build):
    case = everything()["observer"]
    good = rows_of(exact_run("observer")[0])[:200]
    good = np.nan_to_num(good)
    good[:, [13, 14, 18]] = 1  # the weights: nothing is missing
    rows, wrong = with_wrong_rows(good)
    program = build(header_of("observer"), *options_of(case, *sanitizers(COMPILERS[0])))
    mixed, alone = (run_c(program, case.layout, START, r) for r in (rows, good))
    expected = np.where(wrong, CODES["invalid input"], 0)
    np.testing.assert_array_equal(mixed.code, expected)
    np.testing.assert_array_equal(mixed.raw[expected == 0], alone.raw)


@needs_cc
@pytest.mark.parametrize("real", ["double", "float"])
def test_a_million_samples_of_garbage_spoil_nothing(tmp_path, real):
    """The checks are in `fuzz_filter.c`."""
    options = ("-std=c99", "-O1", f"-DPOSEGSA_REAL={real}", *sanitizers(COMPILERS[0]))
    source = Path(__file__).parent / "fuzz_filter.c"
    program = compile_c(tmp_path, header_of("observer"), source, *options, compiler=COMPILERS[0])
    assert subprocess.run([program], check=False).returncode == 0


@needs_cc
def test_a_limit_can_be_set_when_compiling(build: Build):
    case = everything()["observer"]
    row = np.nan_to_num(rows_of(exact_run("observer")[0])[:1])
    row[0, 4] = 20.0  # a velocity [m/s]
    for options, code in (((), "ok"), (("-DPOSEGSA_MAX_VELOCITY=10",), "invalid input")):
        program = build(header_of("observer"), *options_of(case, *options))
        assert run_c(program, case.layout, START, row).code == CODES[code]


@needs_cc
def test_missing_measurements_are_ignored(build: Build):
    """NaN with weight 0, and a direction of length 0, count as missing."""
    case = everything()["observer"]
    rows = np.nan_to_num(rows_of(exact_run("observer")[0])[:300])
    rows[:, [13, 14, 18]] = 1
    given = {name: rows.copy() for name in ("weight 0", "NaN", "length 0")}
    given["weight 0"][50:, 13] = given["NaN"][50:, 13] = 0
    given["NaN"][50:, 7:10] = np.nan
    given["length 0"][50:, 7:10] = 0
    program = build(header_of("observer"), *options_of(case, *sanitizers(COMPILERS[0])))
    first, *others = (run_c(program, case.layout, START, r).raw for r in given.values())
    for other in others:
        np.testing.assert_array_equal(first, other)
    assert (first[-1] != run_c(program, case.layout, START, rows).raw[-1]).any()


BEGINNINGS = """
#include "posegsa.h"
#include <string.h>

static int refuses(posegsa_real w, posegsa_real x, posegsa_real at)
{
    const posegsa_real attitude[4] = {w, x, 0, 0}, position[3] = {0, at, 0};
    posegsa_state state, before;
    memset(&state, 7, sizeof state);
    before = state;
    return posegsa_init(&state, attitude, position) == POSEGSA_INVALID_INPUT &&
           memcmp(&state, &before, sizeof state) == 0;
}

int main(void)
{
    const posegsa_real nan = POSEGSA_C(NAN), inf = POSEGSA_C(INFINITY);
    const posegsa_real longest[4] = {0, POSEGSA_C(3e300), POSEGSA_C(-4e300), 0};
    const posegsa_real origin[3] = {1, 2, 3};
    posegsa_real R[3][3];
    posegsa_state state;
    if (!refuses(nan, 0, 0) || !refuses(inf, 0, 0) || !refuses(0, 0, 0) || !refuses(1, 0, nan) ||
        !refuses(1, 0, inf) || !refuses(1, nan, 0)) {
        return 1;
    }
    if (posegsa_init(&state, longest, origin) != POSEGSA_OK || state.position[2] != 3) {
        return 2;
    }
    posegsa_rotation(&state, R); /* about (0.6, -0.8, 0) by 180 degrees */
    if (!(posegsa_fabs(R[0][1] + POSEGSA_C(0.96)) < POSEGSA_C(1e-15)) ||
        !(posegsa_fabs(R[2][2] + 1) < POSEGSA_C(1e-15))) {
        return 3;
    }
    return 0;
}
"""


@needs_cc
def test_initial_poses_that_are_accepted(tmp_path):
    source = tmp_path / "beginnings.c"
    source.write_text(BEGINNINGS)
    header = header_of("observer")
    options = ("-std=c99", "-O1", *sanitizers(COMPILERS[0]))
    program = compile_c(tmp_path, header, source, *options, compiler=COMPILERS[0])
    assert subprocess.run([program], check=False).returncode == 0


def test_a_run_on_true_errors_is_refused():
    with pytest.raises(ArgumentError, match=r"no vehicle knows.*tune with gain\.signal"):
        export_c(tuned(K, "gain.signal=pose"))


@pytest.mark.quick
@pytest.mark.parametrize("name", ["", "2fast", "my-filter", "int", "x" * 33, 5, None, "a b"])
def test_names_that_c_could_not_take_are_refused(name):
    with pytest.raises(ArgumentError, match=r"name = .*; allowed: a letter, then letters"):
        export_c(tuned(K), name=name)


class LookedUp(NamedTuple):
    """A user's schedule that looks up an array."""

    gains: jax.Array

    def initial_gain(self) -> jax.Array:
        return self.gains[0]

    def prepare(self) -> "LookedUp":
        return self

    def __call__(self, inputs: ScheduleInputs) -> Gains:
        return Gains(self.gains[0] * inputs.error)


@pytest.mark.quick
def test_what_does_not_fit_together_is_refused(x64):
    case = everything()["landmarks alone"]
    gain = ConstantGain(jnp.asarray(5.0))
    given: dict[str, Any] = {"vectors": VECTORS, "landmarks": LANDMARKS}

    def attempt(schedule: Any = gain, chosen: Any = case.settings, **changed: Any) -> None:
        filter_to_c(Observer(schedule, chosen, case.signal), **given | changed)

    attempt()
    weighted = settings(vectors=vector_settings(weights=(1.0, 2.0)))
    with pytest.raises(ArgumentError, match=r"settings.vectors.weights: 2 of them; allowed: 3"):
        attempt(chosen=weighted)
    with pytest.raises(ArgumentError, match="none; allowed: at least one"):
        attempt(vectors=None, landmarks=None)
    with pytest.raises(MeasurementError, match="landmarks: must be finite"):
        attempt(landmarks=[[0, 1, np.nan]])
    with pytest.raises(MeasurementError, match="vector_references: must not be zero"):
        attempt(vectors=[[0, 0, 0]])
    with pytest.raises(MeasurementError, match=r"landmarks = 2e\+09; allowed: -1e\+09 to 1e\+09 m"):
        attempt(landmarks=[[0, 1, 2e9]])
    with pytest.raises(ArgumentError, match="arrays of numbers; allowed: one made of scalars"):
        attempt(schedule=LookedUp(jnp.arange(3.0)))
    for time, log_gain in ((jnp.ones(2), jnp.ones(2)), (jnp.arange(3.0), jnp.ones(2))):
        with pytest.raises(ArgumentError, match=r"a KnotGain of .*allowed: ascending times, and a"):
            attempt(schedule=KnotGain(time, log_gain))
    with pytest.raises(ArgumentError, match="schedule: a int"):
        attempt(schedule=5)
    varied = replace(case.settings, gamma_angular=jnp.ones(7))
    with pytest.raises(ArgumentError, match="arrays of numbers; allowed: one made of scalars"):
        attempt(chosen=varied)


# The file -----------------------------------------------------------------------------------------


def example(header: str) -> str:
    """The program in the comment at the top."""
    lines = header.split(" * USE\n")[1].split(" *\n")[0].splitlines()
    assert len(lines) == 15
    return "\n".join(line.removeprefix(" * ") for line in lines) + "\n"


@needs_cc
@pytest.mark.parametrize("compiler", ["gcc", "clang", "g++", "clang++"])
def test_the_example_compiles_and_runs_as_c_and_cpp(tmp_path, compiler):
    need(compiler)
    name = "attitude only" if compiler.endswith("++") else "observer"
    header = header_of(name)
    language = ["-x", "c++", "-std=c++17"] if compiler.endswith("++") else ["-std=c99"]
    source = tmp_path / "example.c"
    source.write_text(example(header))
    program = compile_c(tmp_path, header, source, *language, compiler=compiler)
    w = float(subprocess.run([program], check=True, capture_output=True, text=True).stdout)
    assert 0 < w <= 1


@needs_cc
@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_two_filters_in_one_program_of_cpp(tmp_path, compiler):
    """Each has its own types and macros."""
    need(compiler)
    constant = replace(everything()["attitude only"], schedule=ConstantGain(jnp.asarray(5.0)))
    first, second = (
        filter_to_c(Observer(c.schedule, c.settings, c.signal), vectors=c.vectors, name=name)
        for name, c in (("front", everything()["attitude only"]), ("Rear", constant))
    )
    (tmp_path / "front.h").write_text(first)
    (tmp_path / "Rear.h").write_text(second)
    (tmp_path / "both.cpp").write_text(
        '#include "front.h"\n#include "Rear.h"\n'
        "front_state a; Rear_state b;\n"
        "int both(const front_measurement *x, const Rear_measurement *y);\n"
        "int both(const front_measurement *x, const Rear_measurement *y)\n"
        "{ return front_step(&a, x, 1) + Rear_step(&b, y, REAR_C(1)); }\n"
    )
    command = [compiler, "-std=c++17", "-O1", *WARNINGS, "-c", "-o", "/dev/null", "both.cpp"]
    subprocess.run(command, check=True, cwd=tmp_path)


@needs_cc
def test_it_needs_nothing_but_the_math_library(build: Build, tmp_path):
    header = header_of("observer")
    assert re.findall(r"#include.*", header.split("*/", 1)[1]) == ["#include <math.h>"]
    source = tmp_path / "alone.c"
    source.write_text(
        '#include "posegsa.h"\n'
        "int alone(posegsa_state *s, const posegsa_measurement *m);\n"
        "int alone(posegsa_state *s, const posegsa_measurement *m)"
        "{ return posegsa_step(s, m, POSEGSA_C(0.01)); }\n"
    )
    made = compile_c(tmp_path, header, source, "-std=c99", "-O1", "-c", compiler=COMPILERS[0])
    listed = subprocess.run(["nm", made], check=True, capture_output=True, text=True).stdout
    symbols = [line.split()[-2:] for line in listed.splitlines()]
    # A compiler may call memcpy and memset, and guard the stack.
    allowed = {"sqrt", "floor", "memcpy", "memset", "__stack_chk_fail", "_GLOBAL_OFFSET_TABLE_"}
    assert {name for kind, name in symbols if kind == "U"} <= allowed
    assert not [name for kind, name in symbols if kind in "BbDdC"], "no variable of its own"


@needs_cc
def test_fast_math_is_refused(tmp_path):
    header = header_of("observer")
    (tmp_path / "posegsa.h").write_text(header)
    command = [COMPILERS[0], "-ffast-math", "-fsyntax-only", "-x", "c", str(tmp_path / "posegsa.h")]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode != 0
    assert "checks for NaN" in done.stderr


def test_the_head_has_title_and_warnings():
    def head(result: Result) -> str:
        return " ".join(export_c(result).split("*/", 1)[0].replace("\n *", " ").split())

    text = head(recommended_result())
    for words in ("posegsa " + posegsa.__version__, "posegsa 0.0.1", "95 % interval", "27.5/s"):
        assert words in text
    assert "vector_bias_gain = 0.4375. Gain gamma_c" in text
    assert "WARNING" not in text
    worse = recommended_result(endurance=endurance(attitude=np.array([40.0, 6, 5, 9.5])))
    assert (
        "WARNING: past the time that it was tuned for it is worse than the best constant"
        in head(worse)
    )
    sensitive = trust(cost_float32=40.5, cost_float64=44.0, cost_perturbed=40.5, sensitive=True)
    assert "WARNING: SENSITIVE" in head(recommended_result(trust=sensitive))


def test_every_number_has_a_comment():
    for name in everything():
        numbers = header_of(name).split("/* ---- Numbers")[1].split("/* ----")[0].splitlines()
        defined = [i for i, line in enumerate(numbers) if line.startswith("static const")]
        unsaid = [numbers[i] for i in defined if not re.fullmatch(r"/\* .+ \*/", numbers[i - 1])]
        # The numbers of a schedule have names but no comments.
        assert all(
            line.startswith("static const posegsa_real posegsa_schedule_") for line in unsaid
        )
        assert len(defined) - len(unsaid) >= 4


def test_the_page_shows_the_example_and_its_python_runs():
    page = (Path(__file__).parents[2] / "docs" / "export.md").read_text("utf-8")
    assert f"```c\n{textwrap.dedent(example(everything()['observer'].header()))}```" in page
    (code,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    names: dict[str, Any] = {}
    exec(code, names)  # code from our own page
    assert "posegsa_schedule_gain = 10;" in names["text"]


@pytest.mark.quick
def test_no_line_is_too_long_to_read():
    header = header_of("observer")
    assert header.isascii()
    table = re.compile(r"\{.*\},?( /\* .* \*/)?|static const.*")
    long = [x for x in header.splitlines() if len(x) > 100 and not table.search(x)]
    assert not long
