"""Measurements from a user's arrays, and the input of the filter from them."""

import re
from typing import Any

import jax
import numpy as np
import pytest
from helpers.arrays import as_arrays
from helpers.filters import jitted_prepare, prepared
from helpers.measurements import random_measurements

from posegsa.errors import MeasurementError, PosegsaWarning
from posegsa.model.measurements import Measurements

pytestmark = pytest.mark.quick

N, VECTORS, LANDMARKS = 4, 3, 2


def arrays(**changes: Any) -> dict[str, Any]:
    """Valid arguments of `from_arrays` for 4 samples, 3 vectors and 2 landmarks; None omits one."""
    rng = np.random.default_rng(0)
    valid = {
        "time_step": 0.01,
        "angular_velocity": rng.normal(size=(N, 3)),
        "velocity": rng.normal(size=(N, 3)),
        "vectors": 2 * rng.normal(size=(N, VECTORS, 3)),
        "vector_references": 5 * rng.normal(size=(VECTORS, 3)),
        "landmarks": rng.normal(size=(N, LANDMARKS, 3)),
        "landmark_references": rng.normal(size=(LANDMARKS, 3)),
    }
    return {k: v for k, v in (valid | changes).items() if v is not None}


def array_with(name: str, index: Any, value: float) -> dict[str, np.ndarray]:
    """One of the valid arguments with one of its entries replaced."""
    array = arrays()[name]
    array[index] = value
    return {name: array}


def unit(a: np.ndarray) -> np.ndarray:
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


# From arrays -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "place", "value"),
    [
        ("angular_velocity", (1, 0), 1e4),
        ("velocity", (0, 2), -2e4),
        ("vectors", (3, 1, 2), 1e7),
        ("vector_references", (2, 0), 1e7),
        ("landmarks", (0, 1, 1), 1e7),
        ("landmark_references", (1, 0), 1e10),
    ],
)
def test_what_no_sensor_measures_is_refused_as_by_a_stream(name, place, value) -> None:
    given = arrays(**array_with(name, place, value))
    words = re.escape(f"{name} = {value:g}; allowed: ")
    with pytest.raises(MeasurementError, match=words):
        Measurements.from_arrays(**given)
    weight = np.ones((N, VECTORS if "vector" in name else LANDMARKS))
    weight[place[0]] = 0
    if name in ("vectors", "landmarks"):  # unused values may be anything
        Measurements.from_arrays(**given, **{f"{name[:-1]}_weights": weight})


@pytest.mark.parametrize(("name", "value"), [("time_step", 61.0), ("landmark_weights", 1e7)])
def test_one_number_for_all_samples_has_the_limits_of_a_stream(name, value) -> None:
    with pytest.raises(MeasurementError, match=re.escape(f"{name} = {value:g}; allowed: ")):
        Measurements.from_arrays(**arrays(**{name: value}))


def test_from_arrays_spreads_scalars_and_constants_over_all_samples() -> None:
    given = arrays(vector_weights=[1.0, 0.5, 2.0], landmark_weights=3.0)
    m = Measurements.from_arrays(**given)
    np.testing.assert_allclose(m.time_step, np.full(N, 0.01))
    np.testing.assert_allclose(m.vector_weights, np.tile([1.0, 0.5, 2.0], (N, 1)))
    np.testing.assert_allclose(m.landmark_weights, np.full((N, LANDMARKS), 3.0))
    assert m.vector_references.shape == (N, VECTORS, 3)
    want = np.tile(given["landmark_references"], (N, 1, 1))
    np.testing.assert_allclose(m.landmark_references, want, rtol=1e-6)


def test_from_arrays_keeps_what_is_given_per_sample() -> None:
    rng = np.random.default_rng(1)
    given = {
        "time_step": rng.uniform(0.01, 0.02, N),
        "vector_references": rng.normal(size=(N, VECTORS, 3)),
        "vector_weights": rng.uniform(size=(N, VECTORS)),
        "landmark_references": rng.normal(size=(N, LANDMARKS, 3)),
        "landmark_weights": rng.uniform(size=(N, LANDMARKS)),
    }
    given = arrays(**given)
    m = Measurements.from_arrays(**given)
    for name, value in given.items():
        np.testing.assert_allclose(getattr(m, name), value, rtol=1e-6, err_msg=name)


def test_weights_are_one_where_none_are_given() -> None:
    m = Measurements.from_arrays(**arrays())
    assert (np.asarray(m.vector_weights) == 1).all()
    assert (np.asarray(m.landmark_weights) == 1).all()


def test_from_arrays_leaves_vectors_and_landmarks_as_measured() -> None:
    given = arrays()
    m = Measurements.from_arrays(**given)
    np.testing.assert_allclose(m.vectors, given["vectors"], rtol=1e-6)
    np.testing.assert_allclose(m.vector_references[2], given["vector_references"], rtol=1e-6)
    np.testing.assert_allclose(m.landmarks, given["landmarks"], rtol=1e-6)


def test_nan_in_any_component_marks_a_measurement_as_missing() -> None:
    given = arrays(vector_weights=2.0)
    given["vectors"][1, 2, 0] = np.nan
    given["landmarks"][3, 0] = np.nan
    m = Measurements.from_arrays(**given)
    want = np.full((N, VECTORS), 2.0)
    want[1, 2] = 0
    assert (np.asarray(m.vector_weights) == want).all()
    assert np.asarray(m.landmark_weights).tolist() == [[1, 1], [1, 1], [1, 1], [0, 1]]
    assert all(np.isfinite(a).all() for a in m)


def test_what_is_masked_is_missing() -> None:
    """Masked arrays hold numbers under their masks; these must not be used."""
    given, masked = arrays(), arrays()
    given["vectors"][1, 2] = np.nan
    masked["vectors"] = np.ma.masked_invalid(given["vectors"])
    masked["vectors"].data[1, 2] = 999.0
    for a, b in zip(
        Measurements.from_arrays(**masked), Measurements.from_arrays(**given), strict=True
    ):
        np.testing.assert_array_equal(a, b)
    rows = arrays(vectors=list(masked["vectors"]))
    np.testing.assert_array_equal(
        Measurements.from_arrays(**rows).vector_weights,
        Measurements.from_arrays(**given).vector_weights,
    )
    hidden = np.ma.masked_equal(given["angular_velocity"], given["angular_velocity"][2, 1])
    with pytest.raises(MeasurementError, match=r"angular_velocity:.*finite.* nan at"):
        Measurements.from_arrays(**given | {"angular_velocity": hidden})


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_any_value_is_allowed_where_the_weight_is_zero(value) -> None:
    weights = np.ones((N, VECTORS))
    weights[2, 1] = 0
    given = array_with("vectors", (2, 1, 0), value)
    m = Measurements.from_arrays(**arrays(**given, vector_weights=weights))
    assert (np.asarray(m.vector_weights) == weights).all()
    assert np.isfinite(m.vectors).all()


def test_vectors_or_landmarks_may_be_absent() -> None:
    m = Measurements.from_arrays(**arrays(vectors=None, vector_references=None))
    assert m.vectors.shape == m.vector_references.shape == (N, 0, 3)
    assert m.vector_weights.shape == (N, 0)
    m = Measurements.from_arrays(**arrays(landmarks=None, landmark_references=None))
    assert m.landmarks.shape == (N, 0, 3)
    assert jax.eval_shape(prepared, m).landmarks == ()


def test_from_arrays_gives_the_dtype_asked_for(dtype) -> None:
    m = Measurements.from_arrays(**arrays(), dtype=dtype)
    assert {a.dtype for a in m} == {np.dtype(dtype)}
    # Must not be rounded.
    np.testing.assert_array_equal(m.vectors, arrays()["vectors"].astype(dtype))


def test_from_arrays_leaves_the_users_arrays_alone() -> None:
    given = arrays(**array_with("vectors", (0, 0, 0), np.nan))
    before = {k: np.copy(v) for k, v in given.items()}
    Measurements.from_arrays(**given)
    for name, value in before.items():
        np.testing.assert_array_equal(given[name], value)


def test_at_gives_one_sample_or_a_range_of_them() -> None:
    m = Measurements.from_arrays(**arrays())
    one, some = m.at(2), m.at(slice(1, 3))
    for whole, single, part in zip(m, one, some, strict=True):
        np.testing.assert_array_equal(single, whole[2])
        np.testing.assert_array_equal(part, whole[1:3])
        # Views instead of JAX programs, because on-line samples are taken out one by one.
        assert type(single) is type(part) is np.ndarray
        assert (single.dtype, single.shape) == (whole.dtype, whole.shape[1:])
    traced = jax.jit(lambda all_of_them, k: all_of_them.at(k))(m, 2)
    for single, again in zip(one, traced, strict=True):
        np.testing.assert_array_equal(single, again)
    with pytest.raises(IndexError):
        m.at(10**6)


ones = np.ones
# The change, and the expected message ("..." is any text).
REFUSED = {
    "angular velocity, shape": (
        {"angular_velocity": ones((N, 2))},
        "angular_velocity:... (N, 3)... (4, 2)",
    ),
    "angular velocity, axes": (
        {"angular_velocity": ones(3)},
        "angular_velocity:... (N, 3)... (3,)",
    ),
    "angular velocity, text": (
        {"angular_velocity": "fast"},
        "angular_velocity:...array of numbers",
    ),
    "angular velocity, ragged": (
        {"angular_velocity": [[1, 2, 3], [1, 2]]},
        "angular_velocity:...array of numbers",
    ),
    "angular velocity, nan": (
        array_with("angular_velocity", (1, 2), np.nan),
        "angular_velocity:...finite... nan at (1, 2)",
    ),
    "angular velocity, infinite": (
        array_with("angular_velocity", (3, 0), -np.inf),
        "angular_velocity:...finite... -inf at (3, 0)",
    ),
    "no samples": (
        {"angular_velocity": ones((0, 3))},
        "angular_velocity: at least one sample is needed... none",
    ),
    "velocity, length": (
        {"velocity": ones((N + 1, 3))},
        "velocity:... (4, 3)... (5, 3)",
    ),
    "velocity, nan": (
        array_with("velocity", (0, 1), np.nan),
        "velocity:...finite... nan at (0, 1)",
    ),
    "time step, length": (
        {"time_step": ones(N - 1)},
        "time_step:... got (3,)",
    ),
    "time step, axes": (
        {"time_step": ones((N, 1))},
        "time_step:... got (4, 1)",
    ),
    "time step, nan": (
        {"time_step": [0.01, np.nan, 0.01, 0.01]},
        "time_step:...finite... nan at (1,)",
    ),
    "time step, infinite": ({"time_step": np.inf}, "time_step:...finite... inf at (0,)"),
    "time step, text": ({"time_step": "short"}, "time_step:...array of numbers"),
    "time step, zero": (
        {"time_step": 0.0},
        "time_step:...positive... 0 s at sample 0",
    ),
    "time step, back": (
        {"time_step": [0.01, 0.01, -0.02, 0.01]},
        "time_step:...positive... -0.02 s at sample 2",
    ),
    "vectors alone": (
        {"vector_references": None},
        "vectors and vector_references:...both or neither",
    ),
    "vector references alone": (
        {"vectors": None},
        "vectors and vector_references:...both or neither",
    ),
    "landmarks alone": (
        {"landmark_references": None},
        "landmarks and landmark_references:...both or neither",
    ),
    "vector weights alone": (
        {"vectors": None, "vector_references": None, "vector_weights": 1.0},
        "vector_weights: given without vectors",
    ),
    "landmark weights alone": (
        {"landmarks": None, "landmark_references": None, "landmark_weights": 1.0},
        "landmark_weights: given without landmarks",
    ),
    "vectors, shape": (
        {"vectors": ones((N, 3))},
        "vectors:... got (4, 3)",
    ),
    "vectors, length": (
        {"vectors": ones((N + 2, VECTORS, 3))},
        "vectors:... got (6, 3, 3)",
    ),
    "vectors, infinite": (
        array_with("vectors", (1, 2, 0), np.inf),
        "vectors:...infinite... inf at (1, 2, 0)",
    ),
    "landmarks, infinite": (
        array_with("landmarks", (3, 1, 2), -np.inf),
        "landmarks:...infinite... -inf at (3, 1, 2)",
    ),
    "vector references, count": (
        {"vector_references": ones((VECTORS - 1, 3))},
        "vector_references:... (3, 3)... (2, 3)",
    ),
    "vector references, samples": (
        {"vector_references": ones((N - 1, VECTORS, 3))},
        "vector_references:... (4, 3, 3)... (3, 3, 3)",
    ),
    "vector references, nan": (
        array_with("vector_references", (1, 1), np.nan),
        "vector_references:...finite... nan at (1, 1)",
    ),
    "vector references, text": (
        {"vector_references": "up"},
        "vector_references:...array of numbers",
    ),
    "landmark references, nan": (
        array_with("landmark_references", (0, 2), np.nan),
        "landmark_references:...finite... nan at (0, 2)",
    ),
    "landmark references, ragged": (
        {"landmark_references": [[1, 2, 3], [1, 2]]},
        "landmark_references:...array of numbers",
    ),
    "vector weights, shape": (
        {"vector_weights": ones(N)},
        "vector_weights:... a scalar or have the shape (3,) or (4, 3)... (4,)",
    ),
    "vector weights, negative": (
        {"vector_weights": [1.0, -0.5, 1.0]},
        "vector_weights:...not negative... -0.5",
    ),
    "vector weights, nan": (
        {"vector_weights": [1.0, np.nan, 1.0]},
        "vector_weights:...not negative... nan",
    ),
    "landmark weights, infinite": (
        {"landmark_weights": [1.0, np.inf]},
        "landmark_weights:...not negative... inf",
    ),
    "landmark weights, text": (
        {"landmark_weights": "heavy"},
        "landmark_weights:...array of numbers",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_from_arrays_names_what_it_refuses(case) -> None:
    changes, message = REFUSED[case]
    pattern = ".*".join(re.escape(part) for part in message.split("..."))
    with pytest.raises(MeasurementError, match=pattern):
        Measurements.from_arrays(**arrays(**changes))


# Input of the filter ------------------------------------------------------------------------------


def direct_sums(m: Measurements, k: int) -> dict[str, Any]:
    """The fields of sample k by the definitions in their docstrings, in loops."""
    seen = np.flatnonzero(m.vector_weights[k])
    s, v, r = m.vector_weights[k], m.vectors[k], m.vector_references[k]
    return {
        "profile": sum((s[i] * np.outer(v[i], r[i]) for i in seen), np.zeros((3, 3))),
        "power": sum(s[i] * (v[i] @ v[i] + r[i] @ r[i]) for i in seen),
        "curvature": sum(0.5 * s[i] * np.linalg.norm(v[i]) * np.linalg.norm(r[i]) for i in seen),
        "scale": 3 / (8 * s.sum()) if s.sum() > 0 else 0.0,
    }


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("vectors", "landmarks"), [(0, 1), (1, 0), (2, 2), (4, 3)])
def test_prepare_equals_direct_sums_with_and_without_the_time_axis(vectors, landmarks) -> None:
    samples = 20
    raw = random_measurements(np.random.default_rng(0), samples, vectors, landmarks, missing=0.4)
    m = as_arrays(raw, np.float64)
    one = jax.jit(lambda m, k: prepared(m.at(k)))
    whole = jax.tree.map(np.asarray, jitted_prepare(m))
    for k in range(samples):
        at_k = jax.tree.map(lambda a, k=k: a[k], whole)
        want = direct_sums(raw, k)
        wahba = at_k.vectors
        np.testing.assert_allclose(np.array(wahba.profile), want["profile"], atol=1e-14)
        for name in ("power", "curvature", "scale"):
            np.testing.assert_allclose(getattr(wahba, name), want[name], rtol=1e-13, err_msg=name)
        for i, landmark in enumerate(at_k.landmarks):
            assert landmark.factor == raw.landmark_weights[k, i]
            assert np.array(landmark.inertial).tolist() == raw.landmark_references[k, i].tolist()
            if landmark.factor > 0:
                assert np.array(landmark.body).tolist() == raw.landmarks[k, i].tolist()
        for a, b in zip(jax.tree.leaves(at_k), jax.tree.leaves(one(m, k)), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-14)


def test_values_of_missing_measurements_do_not_matter_even_nan() -> None:
    raw = random_measurements(np.random.default_rng(0), 30, 3, 2, missing=0.5)
    assert np.isnan(raw.vectors).any()
    assert np.isnan(raw.landmarks).any()
    zeros = raw._replace(
        vectors=np.nan_to_num(raw.vectors, nan=7.0), landmarks=np.nan_to_num(raw.landmarks, nan=-7)
    )
    with_nan, without = (jitted_prepare(as_arrays(m, np.float32)) for m in (raw, zeros))
    for a, b in zip(jax.tree.leaves(with_nan), jax.tree.leaves(without), strict=True):
        assert np.isfinite(a).all()
        np.testing.assert_array_equal(a, b)


def test_prepare_keeps_the_dtype(dtype) -> None:
    m = as_arrays(random_measurements(np.random.default_rng(0), 2, 2, 1), dtype)
    assert {a.dtype for a in jax.tree.leaves(jax.eval_shape(prepared, m))} == {np.dtype(dtype)}


def test_prepare_in_float32_with_64_bits_allowed_stays_in_float32() -> None:
    with jax.enable_x64(True):
        m = as_arrays(random_measurements(np.random.default_rng(0), 2, 2, 1), np.float32)
        assert {a.dtype for a in jax.tree.leaves(jax.eval_shape(prepared, m))} == {
            np.dtype(np.float32)
        }


# Precision ---------------------------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
def test_measurements_below_the_filters_precision_are_reported_by_field_and_dtypes() -> None:
    m = Measurements.from_arrays(**arrays(), dtype=np.float64)
    assert all(a is b for a, b in zip(m.at_least(np.dtype("float64")), m, strict=True))
    mixed = m._replace(velocity=m.velocity.astype(np.float32))
    with pytest.warns(PosegsaWarning, match=r"measurements\.velocity: float32.* float64"):
        raised = mixed.at_least(np.dtype("float64"))
    assert raised.velocity.dtype == np.float64
    np.testing.assert_array_equal(raised.velocity, mixed.velocity)


@pytest.mark.usefixtures("x64")
def test_measurements_above_the_filters_precision_are_left_as_they_are() -> None:
    m = Measurements.from_arrays(**arrays(), dtype=np.float64)
    assert all(a is b for a, b in zip(m.at_least(np.dtype("float32")), m, strict=True))
