"""A tuned schedule out of Python: the C file against the JAX controller, JSON and CSV."""

import csv
import ctypes
import dataclasses
import io
import itertools
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from setups import corner_vectors, paper, search_vectors

import posegsa
from posegsa import config
from posegsa.comparison import CONSTANT, TUNED, Contender, Evaluation
from posegsa.errors import PosegsaError
from posegsa.export import FORMATS, SCHEMA, export, export_c, export_csv, export_json
from posegsa.fuzzy import FuzzyController
from posegsa.metrics import Bands, Metrics
from posegsa.results import TuneResult
from posegsa.trust import Trust

CC = shutil.which("cc") or shutil.which("gcc")
WARNINGS = [
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wfloat-conversion"),
    *("-Wdouble-promotion", "-Werror"),
]
needs_cc = pytest.mark.skipif(CC is None, reason="there is no C compiler")
PRECISIONS = {"float": (np.float32, ctypes.c_float), "double": (np.float64, ctypes.c_double)}
COUNT = 10_000
TOLERANCE = {"float": 1e-5, "double": 1e-12}
"""Relative; measured are 0 for the exact centroid, and 4e-7 and 7e-16 for the sampled one."""


def tuned(k: np.ndarray, *settings: str, dtype: str = "float32", **fields: Any) -> TuneResult:
    """A result with this vector k; what a search would say of itself is made up."""
    experiment = paper(*settings, dtype=dtype)
    with jax.enable_x64(dtype == "float64"):
        space = posegsa.parameter_space(experiment)
        vector = space.vector(space.controller(space.checked(k)))
        repaired = np.asarray(vector, np.float64)
    costs = {TUNED: np.array([41.0, 43.5, 45.25]), CONSTANT: np.array([44.0, 46.0, 52.5])}
    nothing = Bands(*[np.zeros((len(Bands._fields), 1))] * len(Bands._fields))
    values: dict[str, Any] = {
        "experiment": experiment,
        "best_cost": 40.5,
        "parameters": repaired,
        "training_costs": np.array([40.0, 41.0]),
        "constant_gain": 27.5,
        "constant_training_costs": np.array([44.0, 45.0]),
        "evaluation": Evaluation(
            3,
            None,
            np.zeros(1),
            {
                n: Contender(Metrics(*[c] * len(Metrics._fields)), nothing, {})
                for n, c in costs.items()
            },
        ),
        "trust": Trust(40.5, 40.5, 40.5, False, 0.0, np.zeros((5, 5))),
        "evaluations": 24,
        "non_finite": 0,
        "compile_seconds": 1.0,
        "search_seconds": 1.0,
        "history": None,
        "trajectory": None,
        "environment": {},
        "version": "0.0.1",
    }
    return TuneResult(**values | fields)


K, *DRAWN = search_vectors(1, seed=5)[0], *search_vectors(4)
"""A vector with nothing special about it, and others; DRAWN[0], [1] and [3] leave gaps if let."""
GAPS = ("fuzzy.coverage=false",)
MIDRANGE = (*GAPS, "fuzzy.no_rule=midrange")
SAMPLED = ("fuzzy.centroid=sampled",)
WIDE = (f"parameters.lower={[0.0] * 22}", f"parameters.upper={[1.0] * 11 + [100.0] * 11}", *GAPS)
"""Boxes as wide as the universes, so that any ordered terms are a vector."""
NO_WIDTH = [
    *(0.0, 0.3, 0.3, 0.3, 0.3, 0.3, 0.5, 0.5, 0.6, 0.6, 0.6),
    *(0.0, 10.0, 10.0, 10.0, 10.0, 40.0, 40.0, 70.0, 70.0, 70.0, 100.0),
]
"""Vertical edges, terms of no width among others, and gaps."""
SPIKES = [
    *(0.1, 0.1, 0.2, 0.3, 0.2, 0.4, 0.6, 0.5, 0.8, 0.9, 0.8),
    *(0.0, 0.0, 0.0, 0.0, 40.0, 40.0, 40.0, 40.0, 40.0, 40.0, 100.0),
]
"""Output terms all of no width: rules fire over no area."""
TINY = [
    *(1e-39, 0.0, 1e-39, 1e-12, 1e-30, 1e-12, 1e-7, 1e-12, 0.5, 0.5, 0.5),
    *(1e-38, 1e-39, 1e-38, 1e-30, 1e-30, 1e-12, 1e-12, 50.0, 50.0, 50.0, 50.0),
]
"""Widths down to below the least normal number of float."""

CASES = {
    "exact": (K, ()),
    "another": (DRAWN[2], ()),
    "gaps, hold": (DRAWN[0], GAPS),
    "other gaps, hold": (DRAWN[3], GAPS),
    "gaps, midrange": (DRAWN[1], MIDRANGE),
    "corner": (corner_vectors(2)[1], ()),
    "corner, gaps": (corner_vectors(4)[3], GAPS),
    "sampled": (DRAWN[2], SAMPLED),
    "sampled, gaps, midrange": (DRAWN[0], (*SAMPLED, *MIDRANGE)),
    "trapezoid": (
        DRAWN[1],
        (*SAMPLED, "fuzzy.sampled_rule=trapezoid", "fuzzy.sampled_points=201"),
    ),
    "disordered": (DRAWN[3], (*SAMPLED, *GAPS, "fuzzy.ordering=false")),
    "another range, gaps": (DRAWN[0], ("parameters.gain_range=[0.0,300.0]", *MIDRANGE)),
    "no width, gaps": (np.array(NO_WIDTH), WIDE),
    "no width, sampled, gaps": (np.array(NO_WIDTH), (*SAMPLED, *WIDE)),
    "spikes": (np.array(SPIKES), WIDE),
}
"""Vectors k and settings; "gaps" where some inputs fire no rule."""


Gain = Callable[[float, float, float], float]


@pytest.fixture(scope="module")
def compiled(tmp_path_factory) -> Callable[..., ctypes.CDLL]:
    """Compiles an exported file in one precision, without a warning, and loads it."""
    folder, count = tmp_path_factory.mktemp("c"), itertools.count()

    def build(source: str, real: str, *how: str) -> ctypes.CDLL:
        path = folder / f"gain{next(count)}.c"
        path.write_text(source, encoding="ascii")
        library = path.with_suffix(".so")
        how = how or ("-std=c99", "-O1")
        options = [*how, *WARNINGS, "-shared", "-fPIC", f"-DPOSEGSA_REAL={real}"]
        subprocess.run([CC, *options, path, "-o", library], check=True)
        loaded = ctypes.CDLL(str(library))
        number = PRECISIONS[real][1]
        loaded.posegsa_gain.argtypes, loaded.posegsa_gain.restype = [number] * 3, number
        loaded.posegsa_initial_gain.argtypes = []
        loaded.posegsa_initial_gain.restype = number
        return loaded

    return build


def inputs() -> np.ndarray:
    """Errors, rates and last gains (3, COUNT): over all of [0, 1] and beyond, and often small."""
    rng = np.random.default_rng(0)
    error, rate = rng.uniform(-0.1, 1.1, (2, COUNT))
    error[::2], rate[::2] = error[::2] ** 2, np.abs(rate[::2]) ** 3
    return np.stack([error, rate, rng.uniform(1, 101, COUNT)])


def evaluated(controller: FuzzyController, given: np.ndarray) -> np.ndarray:
    """Gains of (error, rate, last gain) (3, n) or (error, rate) (2, n), at one shape for all n."""
    padded = np.resize(given.T, (COUNT, len(given))).T
    gains = controller(*(jnp.asarray(x, controller.output_terms.dtype) for x in padded))
    return np.asarray(gains)[: given.shape[1]]


def in_python(result: TuneResult, real: str, given: np.ndarray) -> np.ndarray:
    """Gains of the result's controller in a precision, its terms cast to it."""
    dtype = PRECISIONS[real][0]
    with jax.enable_x64(real == "double"):
        controller = result.controller
        controller = dataclasses.replace(
            controller,
            input_terms=jnp.asarray(np.asarray(controller.input_terms, dtype)),
            output_terms=jnp.asarray(np.asarray(controller.output_terms, dtype)),
        )
        return evaluated(controller, given)


def in_c(gain: Gain, real: str, given: np.ndarray) -> np.ndarray:
    dtype = PRECISIONS[real][0]
    return np.array([gain(*case) for case in given.astype(dtype).T.tolist()], dtype)


# The C file ---------------------------------------------------------------------------------------


@needs_cc
@pytest.mark.parametrize("real", PRECISIONS)
@pytest.mark.parametrize("case", CASES)
def test_the_c_gain_is_the_jax_gain(compiled, case, real):
    k, settings = CASES[case]
    result = tuned(k, *settings)
    library = compiled(export_c(result), real)
    given = inputs()
    got, expected = in_c(library.posegsa_gain, real, given), in_python(result, real, given)
    np.testing.assert_allclose(got, expected, rtol=TOLERANCE[real])
    initial = library.posegsa_initial_gain()
    assert initial == result.controller.initial_gain()
    if "gaps" in case:
        idle = given[2].astype(got.dtype) if result.controller.no_rule == "hold" else initial
        assert 0.01 < (got == idle).mean() < 0.9


@needs_cc
@pytest.mark.parametrize("real", PRECISIONS)
def test_the_c_gain_of_a_run_in_float64(compiled, real):
    result = tuned(DRAWN[0], *GAPS, dtype="float64")
    assert (result.parameters != result.parameters.astype(np.float32)).any()
    gain, given = compiled(export_c(result), real).posegsa_gain, inputs()
    np.testing.assert_allclose(
        in_c(gain, real, given), in_python(result, real, given), rtol=TOLERANCE[real]
    )


@needs_cc
@pytest.mark.parametrize("real", PRECISIONS)
def test_the_c_gain_where_the_compiler_fuses_multiply_and_add(compiled, real):
    how = ("-std=gnu99", "-O3", "-ffp-contract=fast")
    # The last has an output term of no width at 0, beside one whose input term has its foot at 0.
    for k in (DRAWN[0], corner_vectors(4)[3], corner_vectors(12, seed=9)[7]):
        result, given = tuned(k, *GAPS), inputs()
        try:  # where such instructions are not in every processor of a kind
            library = compiled(export_c(result), real, *how, "-march=native")
        except subprocess.CalledProcessError:
            library = compiled(export_c(result), real, *how)
        got, expected = in_c(library.posegsa_gain, real, given), in_python(result, real, given)
        np.testing.assert_allclose(got, expected, rtol=TOLERANCE[real])


@needs_cc
@pytest.mark.parametrize("real", PRECISIONS)
@pytest.mark.parametrize("settings", [(), GAPS, MIDRANGE, SAMPLED], ids=str)
def test_the_c_gain_at_the_edges(compiled, settings, real):
    result = tuned(DRAWN[0], *settings)
    gain = compiled(export_c(result), real).posegsa_gain
    ends = [0.0, 1.0, -0.0, -3.5, 7.0, 1e30, -1e30, np.inf, -np.inf, 1e-40, 0.5]
    given = np.array([(e, r, 7.25) for e in ends for r in ends]).T
    np.testing.assert_allclose(
        in_c(gain, real, given), in_python(result, real, given), rtol=TOLERANCE[real]
    )
    assert gain(-3.5, 7.0, 7.25) == gain(0.0, 1.0, 7.25)
    initial = float(result.controller.initial_gain())
    for error, rate in ((np.nan, 0.5), (0.5, np.nan), (np.nan, np.nan)):
        assert gain(error, rate, 7.25) == 7.25, "NaN holds the last gain"
        assert gain(error, rate, np.nan) == initial, "and without one it is the initial gain"
    assert not np.isnan(gain(0.5, 0.5, np.nan))


@needs_cc
def test_the_c_gain_holds_or_takes_the_mid_range_in_a_gap(compiled):
    held, middle = (tuned(np.array(NO_WIDTH), *WIDE, *extra) for extra in ((), MIDRANGE))
    error, rate = 0.55, 0.2  # between the terms at 0.5 and from 0.6
    assert compiled(export_c(held), "double").posegsa_gain(error, rate, 7.25) == 7.25
    assert compiled(export_c(middle), "double").posegsa_gain(error, rate, 7.25) == 51


@needs_cc
@pytest.mark.parametrize("real", PRECISIONS)
@pytest.mark.parametrize("settings", [(), SAMPLED], ids=["exact", "sampled"])
def test_the_c_gain_is_never_nan_and_stays_inside_the_output(compiled, settings, real):
    gain = compiled(export_c(tuned(np.array(TINY), *WIDE, *settings)), real).posegsa_gain
    rng = np.random.default_rng(0)
    given = np.stack([*10.0 ** rng.uniform(-46, 1, (2, 4000)), np.full(4000, 7.25)])
    given[:2, ::7] = 0
    gains = in_c(gain, real, given)
    assert ((gains >= 1) & (gains <= 101.001)).all()


@needs_cc
@pytest.mark.parametrize("settings", [(), SAMPLED], ids=["exact", "sampled"])
def test_the_c_file_is_cpp_too(tmp_path, settings):
    compiler = shutil.which("c++") or shutil.which("g++")
    if compiler is None:
        pytest.skip("there is no C++ compiler")
    path = tmp_path / "gain.cpp"
    path.write_text(export_c(tuned(K, *settings)), encoding="ascii")
    for real in PRECISIONS:
        options = [*WARNINGS, "-fsyntax-only", f"-DPOSEGSA_REAL={real}"]
        subprocess.run([compiler, *options, path], check=True)


@pytest.mark.parametrize("settings", [(), SAMPLED], ids=["exact", "sampled"])
def test_the_c_file_includes_nothing_and_remembers_nothing(settings):
    code = export_c(tuned(K, *settings)).split("*/", 1)[1]
    assert "#include" not in code
    statics = re.findall(r"^\s*static .*", code, re.MULTILINE)
    assert statics
    assert all("static const" in line or "(" in line for line in statics)


def head(result: TuneResult) -> str:
    """The head comment's words, without its line breaks."""
    return " ".join(export_c(result).split("*/", 1)[0].replace("\n *", " ").split())


def test_the_head_comment_says_what_it_is_worth():
    text = head(tuned(K))
    for words in ("posegsa " + posegsa.__version__, "posegsa 0.0.1", "95 % interval", "27.5/s"):
        assert words in text
    # Means and worst of training and held-out costs, of both.
    assert re.search(r"this schedule 40\.5 43\.25 \[40\.\d+, 45\.\d+\] 45\.25", text)
    assert re.search(r"gain 27\.5/s 44\.5 47\.5 \[\d+\.\d+, \d+\.\d+\] 52\.5", text)
    assert "WARNING" not in text
    sensitive = Trust(40.5, 44.0, 40.5, True, 0.0, np.zeros((5, 5)))
    assert "WARNING: the training cost depends on rounding" in head(tuned(K, trust=sensitive))


def test_the_head_comment_says_how_the_inputs_are_formed():
    settings = ("gain.position_weight=0.35", "gain.error_scale=0.75", "gain.rate_scale=12.5")
    text = head(tuned(K, *settings))
    assert "sum_i s_i |R_est v_i^B - v_i^I|^2" in text
    assert "now = attitude + 0.35 x position e = now error = e / 0.75" in text
    assert "rate = |e - before| x 12.5" in text
    assert "p_1 = (0.5, 1.4142135623730951, 1.0) m, weight 1.0" in text
    assert "v_3 = v_1 x v_2" in text
    smoothed = head(tuned(K, *settings, "gain.smoothing=0.05"))
    assert "e = before + dt / (0.05 s + dt) (now - before)" in smoothed
    pose = head(tuned(K, "gain.signal=pose"))
    assert "An oracle, for simulation only" in pose
    assert "v_i^B" not in pose


def test_the_head_comment_lists_the_settings_and_parameters():
    result = tuned(K)
    text = head(result)
    for section in (result.experiment.gain, result.experiment.filter):
        for name, value in section.model_dump().items():
            assert f"{name} = {value!r}. " in text
    for i, value in enumerate(result.parameters.tolist(), start=1):
        assert f"k{i}={value!r}" in text


# JSON and CSV -------------------------------------------------------------------------------------


def rebuilt(data: dict[str, Any]) -> FuzzyController:
    """The controller from the JSON alone."""
    c = data["controller"]
    terms = (
        jnp.asarray(list(c[key].values()), data["dtype"])
        for key in ("input_terms", "output_terms_1_s")
    )
    return FuzzyController(
        *terms,
        tuple(tuple(row) for row in c["rule_indices"]),
        tuple(c["output_range_1_s"]),
        c["centroid"],
        c["sampled_points"],
        c["sampled_rule"],
        c["no_rule"],
    )


@pytest.mark.parametrize(
    ("dtype", "settings"),
    [
        ("float32", GAPS),
        ("float64", (*SAMPLED, *MIDRANGE, "fuzzy.sampled_rule=trapezoid")),
    ],
)
def test_json_gives_the_controller_back_exactly(dtype, settings):
    result = tuned(K, *settings, dtype=dtype)
    data = json.loads(export_json(result))
    surface = data["control_surface"]
    with jax.enable_x64(dtype == "float64"):
        again, own = rebuilt(data), result.controller
        for field in dataclasses.fields(FuzzyController):
            np.testing.assert_array_equal(getattr(again, field.name), getattr(own, field.name))
        assert again.output_terms.dtype == dtype
        np.testing.assert_array_equal(evaluated(again, inputs()), evaluated(own, inputs()))
        assert data["controller"]["initial_gain_1_s"] == own.initial_gain()
        error, rate = (np.asarray(surface[key], dtype) for key in ("error", "rate"))
        np.testing.assert_allclose(error, np.linspace(0, 1, 101), rtol=np.finfo(dtype).eps)
        np.testing.assert_array_equal(rate, error)
        cells = np.stack(np.meshgrid(error, rate)).reshape(2, -1)[:, :COUNT]
        expected = evaluated(own, cells)
    gains = np.array(surface["gain_1_s"])
    assert gains.shape == (101, 101)
    assert (gains == gains.astype(dtype)).all()
    # Compiled otherwise, with fused multiply-adds.
    tolerance = 100 * np.finfo(dtype).eps
    np.testing.assert_allclose(gains.ravel()[:COUNT], expected, rtol=tolerance)


def test_json_says_all_of_the_schedule():
    costs = np.array([40.0, np.inf])
    result = tuned(K, *GAPS, "gain.error_scale=0.75", training_costs=costs)
    text = export_json(result)
    data = json.loads(text, parse_constant=pytest.fail)
    assert (data["schema"], data["version"]) == (SCHEMA, posegsa.__version__)
    assert data["tuned_with"] == "0.0.1"
    assert data["dtype"] == "float32"
    assert data["gain"] == result.experiment.gain.model_dump(mode="json")
    assert data["filter"] == result.experiment.filter.model_dump(mode="json")
    assert data["parameters"] == dict(
        zip(config.PARAMETERS, result.parameters.tolist(), strict=True)
    )
    controller = data["controller"]
    assert list(controller["input_terms"]) == list(config.TERMS)
    assert controller["rules"][0] == ["VS", "S", "M", "VL", "VL"]
    indices = [[config.TERMS.index(name) for name in row] for row in controller["rules"]]
    assert indices == controller["rule_indices"]
    assert data["costs"]["tuned"]["training_mean"] == "inf"
    assert data["costs"]["tuned"]["held_out_mean"] == 43.25
    assert data["costs"]["constant"]["held_out_worst"] == 52.5
    assert data["sensitive"] is False
    assert max(map(len, text.splitlines())) < 4000, "rows of numbers on lines of their own"


def test_csv_is_the_control_surface():
    result = tuned(DRAWN[0], *GAPS)
    header, *rows = csv.reader(io.StringIO(export_csv(result, resolution=21)))
    assert header == ["error", "rate", "gain_1_s"]
    table = np.array(rows, np.float64)
    assert (table == table.astype(np.float32)).all()
    error, rate, gains = table.T
    axis = np.linspace(0, 1, 21)
    # The error runs fastest.
    np.testing.assert_allclose(error.reshape(21, 21), np.tile(axis, (21, 1)), rtol=1e-6)
    np.testing.assert_allclose(rate.reshape(21, 21), np.tile(axis[:, None], 21), rtol=1e-6)
    np.testing.assert_allclose(gains, evaluated(result.controller, table.T[:2]), rtol=1e-5)
    assert (gains == 51).any(), "the initial gain where no rule fires"


def test_a_resolution_below_two_is_refused():
    with pytest.raises(PosegsaError, match="resolution = 1; allowed: a whole number from 2"):
        export_csv(tuned(K), resolution=1)


# By name ------------------------------------------------------------------------------------------


def test_formats_by_name():
    assert {"json": export_json, "csv": export_csv, "c": export_c} == FORMATS
    result = tuned(K)
    assert export(result, "c") == export_c(result)
    with pytest.raises(PosegsaError, match="format: must be one of json, csv, c, got 'fis'"):
        export(result, "fis")
