"""The controller as C: the compiled file against the JAX controller."""

import ctypes
import dataclasses
import itertools
import re
import shutil
import subprocess
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.controllers import corner_vectors
from helpers.results import trust
from helpers.schedules import DRAWN, GAPS, MIDRANGE, SAMPLED, K, evaluated, inputs, tuned

import posegsa
from posegsa.export import export_c_gain
from posegsa.judging.result import Result
from posegsa.words import toml

CC = shutil.which("cc") or shutil.which("gcc")
WARNINGS = [
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wfloat-conversion"),
    *("-Wdouble-promotion", "-Werror"),
]
needs_cc = pytest.mark.skipif(CC is None, reason="there is no C compiler")
PRECISIONS = {"float": (np.float32, ctypes.c_float), "double": (np.float64, ctypes.c_double)}
TOLERANCE = {"float": 1e-5, "double": 1e-12}
"""Relative; measured: 0 for the exact centroid, 4e-7 and 7e-16 for the sampled one."""

WIDE = (f"parameters.lower={[0.0] * 22}", f"parameters.upper={[1.0] * 11 + [100.0] * 11}", *GAPS)
"""Boxes as wide as the universes, so that any ordered terms are a vector."""
NO_WIDTH = [
    *(0.0, 0.3, 0.3, 0.3, 0.3, 0.3, 0.5, 0.5, 0.6, 0.6, 0.6),
    *(0.0, 10.0, 10.0, 10.0, 10.0, 40.0, 40.0, 70.0, 70.0, 70.0, 100.0),
]
"""Terms with vertical edges, some of zero width, and gaps."""
SPIKES = [
    *(0.1, 0.1, 0.2, 0.3, 0.2, 0.4, 0.6, 0.5, 0.8, 0.9, 0.8),
    *(0.0, 0.0, 0.0, 0.0, 40.0, 40.0, 40.0, 40.0, 40.0, 40.0, 100.0),
]
"""All output terms have zero width: rules fire, but the area is 0."""
TINY = [
    *(1e-39, 0.0, 1e-39, 1e-12, 1e-30, 1e-12, 1e-7, 1e-12, 0.5, 0.5, 0.5),
    *(1e-38, 1e-39, 1e-38, 1e-30, 1e-30, 1e-12, 1e-12, 50.0, 50.0, 50.0, 50.0),
]
"""Widths down to less than the smallest normal float."""

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
    "another range, gaps": (
        np.concatenate([DRAWN[0][:11], 3 * DRAWN[0][11:]]),  # the boxes grow with the range
        ("parameters.gain_range=[0.0,300.0]", *MIDRANGE),
    ),
    "no width, gaps": (np.array(NO_WIDTH), WIDE),
    "no width, sampled, gaps": (np.array(NO_WIDTH), (*SAMPLED, *WIDE)),
    "spikes": (np.array(SPIKES), WIDE),
}
"""Vectors k and settings; with "gaps", some inputs fire no rule."""

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


def in_python(result: Result, real: str, given: np.ndarray) -> np.ndarray:
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


IN_FLOAT = ("exact", "gaps, hold", "corner, gaps", "sampled", "no width, gaps", "spikes")
"""The cases that are also tested in float, because their arithmetic differs."""


@needs_cc
@pytest.mark.parametrize(
    ("case", "real"),
    [*((case, "double") for case in CASES), *((case, "float") for case in IN_FLOAT)],
)
def test_the_c_gain_is_the_jax_gain(compiled, case, real):
    k, settings = CASES[case]
    result = tuned(k, *settings)
    library = compiled(export_c_gain(result), real)
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
    gain, given = compiled(export_c_gain(result), real).posegsa_gain, inputs()
    np.testing.assert_allclose(
        in_c(gain, real, given), in_python(result, real, given), rtol=TOLERANCE[real]
    )


@needs_cc
@pytest.mark.parametrize("real", PRECISIONS)
def test_the_c_gain_where_the_compiler_fuses_multiply_and_add(compiled, real):
    how = ("-std=gnu99", "-O3", "-ffp-contract=fast")
    # The last has an output term of zero width at 0, next to one whose input term starts at 0.
    for k in (DRAWN[0], corner_vectors(4)[3], corner_vectors(12, seed=9)[7]):
        result, given = tuned(k, *GAPS), inputs()
        try:  # not every compiler knows the processor
            library = compiled(export_c_gain(result), real, *how, "-march=native")
        except subprocess.CalledProcessError:
            library = compiled(export_c_gain(result), real, *how)
        got, expected = in_c(library.posegsa_gain, real, given), in_python(result, real, given)
        np.testing.assert_allclose(got, expected, rtol=TOLERANCE[real])


@needs_cc
@pytest.mark.parametrize("real", PRECISIONS)
@pytest.mark.parametrize("settings", [(), GAPS, MIDRANGE, SAMPLED], ids=str)
def test_the_c_gain_at_the_edges(compiled, settings, real):
    result = tuned(DRAWN[0], *settings)
    gain = compiled(export_c_gain(result), real).posegsa_gain
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
    assert compiled(export_c_gain(held), "double").posegsa_gain(error, rate, 7.25) == 7.25
    assert compiled(export_c_gain(middle), "double").posegsa_gain(error, rate, 7.25) == 51


@needs_cc
@pytest.mark.parametrize("real", PRECISIONS)
@pytest.mark.parametrize("settings", [(), SAMPLED], ids=["exact", "sampled"])
def test_the_c_gain_is_never_nan_and_stays_inside_the_output(compiled, settings, real):
    gain = compiled(export_c_gain(tuned(np.array(TINY), *WIDE, *settings)), real).posegsa_gain
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
    path.write_text(export_c_gain(tuned(K, *settings)), encoding="ascii")
    for real in PRECISIONS:
        options = [*WARNINGS, "-fsyntax-only", f"-DPOSEGSA_REAL={real}"]
        subprocess.run([compiler, *options, path], check=True)


@pytest.mark.parametrize("settings", [(), SAMPLED], ids=["exact", "sampled"])
def test_the_c_file_includes_nothing_and_remembers_nothing(settings):
    code = export_c_gain(tuned(K, *settings)).split("*/", 1)[1]
    assert "#include" not in code
    statics = re.findall(r"^\s*static .*", code, re.MULTILINE)
    assert statics
    assert all("static const" in line or "(" in line for line in statics)


def head(result: Result) -> str:
    """The text of the head comment without line breaks."""
    return " ".join(export_c_gain(result).split("*/", 1)[0].replace("\n *", " ").split())


def test_the_head_comment_states_the_performance():
    text = head(tuned(K))
    for words in ("posegsa " + posegsa.__version__, "posegsa 0.0.1", "95 % interval", "27.5/s"):
        assert words in text
    # Means and worst of training and held-out costs, of both; Student's t over three scenarios.
    assert re.search(r"tuned filter 40\.5 43\.25 \[37\.944, 48\.556\] 45\.25", text)
    assert re.search(r"best constant gains 27\.5/s 44\.5 47\.5 \[36\.46, 58\.54\] 52\.5", text)
    assert "WARNING" not in text
    sensitive = trust(cost_float32=40.5, cost_float64=44.0, cost_perturbed=40.5, sensitive=True)
    assert "WARNING: SENSITIVE: training cost 40.5 in float32" in head(tuned(K, trust=sensitive))


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
    unknown = head(tuned(K, *settings, "gain.unknown=0.625", "filter.bias_wait=0.5"))
    assert "unknown = max(unknown, 0.5 min(error, 1)), first 0.625" in unknown
    assert "q = 1 / (1 + (now / 0.5)^4)" in unknown
    assert "max(unknown" not in text
    pose = head(tuned(K, "gain.signal=pose"))
    assert "An oracle, for simulation only" in pose
    assert "v_i^B" not in pose


def test_the_head_comment_lists_the_settings_and_parameters():
    result = tuned(K)
    text = head(result)
    for section in (result.experiment.gain, result.experiment.filter):
        for name, value, description in section.described():
            assert f"{name} = {toml(value)}. {description}" in text
    assert 'centroid = "exact". How' in text
    for i, value in enumerate(result.parameters.tolist(), start=1):
        assert f"k{i}={value!r}" in text
