"""Processing of measured vectors, before and in the loop, against sums by the definition."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference
from helpers.arrays import as_arrays
from helpers.filters import vector_settings
from helpers.measurements import random_measurements, reference_sample
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st
from jax import Array
from scipy.spatial.transform import Rotation

from posegsa.model.measurements import Measurements
from posegsa.model.se3 import Vec3, unstack
from posegsa.model.vectors import (
    VectorSamples,
    VectorSettings,
    Wahba,
    corrected,
    inverse_or_zero,
    normalised,
    prepare_vectors,
    with_cross_vector,
)

N = 15


@jax.jit
def in_the_loop(
    m: Measurements, biases: Array | None, settings: VectorSettings
) -> tuple[Wahba, tuple[Vec3, ...]]:
    """Wahba's sums, computed in the loop, of vectors less biases (N, n, 3), and these vectors."""
    vectors = prepare_vectors(m, settings)
    assert isinstance(vectors, VectorSamples)
    columns = [] if biases is None else [biases[:, i] for i in range(biases.shape[1])]
    return corrected(vectors, tuple(vec3(c) for c in columns), settings)


@jax.jit
def before_the_loop(m: Measurements, settings: VectorSettings) -> Wahba:
    vectors = prepare_vectors(m, settings)
    assert isinstance(vectors, Wahba)
    return vectors


def vec3(a: Array) -> Vec3:
    x, y, z = unstack(a)
    return x, y, z


def by_definition(
    raw: Measurements, biases: np.ndarray, **as_used: Any
) -> dict[str, list[np.ndarray]]:
    """The fields of `Wahba` for each sample, by the reference's vectors, in loops."""
    fields: dict[str, list[Any]] = {"profile": [], "power": [], "curvature": [], "scale": []}
    for k in range(N):
        s = reference.used_sample(reference_sample(raw, k), biases[k], **as_used)
        seen = np.flatnonzero(s.sR)
        u, v, weights = s.vB[seen], s.vI[seen], s.sR[seen]
        length = np.linalg.norm
        fields["profile"].append(np.einsum("n,ni,nj->ij", weights, u, v))
        fields["power"].append(weights @ (length(u, axis=1) ** 2 + length(v, axis=1) ** 2))
        fields["curvature"].append(weights @ (length(u, axis=1) * length(v, axis=1)) / 2)
        fields["scale"].append(3 / (8 * weights.sum()) if len(seen) else 0.0)
    return fields


WAYS = [  # vectors, their weights, weight of the cross product, whether normalised
    (1, None, None, True),
    (2, (0.4, 1.5), 0.3, True),
    (2, None, 0.3, False),
    (3, (0.4, 1.5, 0.0), None, False),
    (3, (2.0, 0.1, 1.0), 1.0, True),
]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("count", "weights", "cross_weight", "normalise"), WAYS)
def test_sums_in_the_loop_are_those_made_before_it_and_those_of_the_definition(
    count, weights, cross_weight, normalise
) -> None:
    raw = random_measurements(np.random.default_rng(0), N, count, 1, missing=0.4)
    m = as_arrays(raw, np.float64)
    settings, each_agent = (
        vector_settings(
            weights=weights, cross_weight=cross_weight, normalise=normalise, each_agent=each
        )
        for each in (False, True)
    )
    none = np.zeros((N, count, 3))
    early, (late, freed) = before_the_loop(m, settings), in_the_loop(m, none, each_agent)
    want = by_definition(
        raw,
        none,
        normalise=normalise,
        cross_weight=cross_weight,
        vector_weights=weights,
    )
    for wahba in (early, late):
        profile = np.array(wahba.profile).transpose(2, 0, 1)
        np.testing.assert_allclose(profile, want["profile"], atol=1e-13)
        for name in ("power", "curvature", "scale"):
            np.testing.assert_allclose(getattr(wahba, name), want[name], rtol=1e-12, err_msg=name)
    seen = raw.vector_weights > 0
    got = np.moveaxis(np.array(freed), -1, 0)
    np.testing.assert_array_equal(got[seen], raw.vectors[seen])


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("count", "weights", "cross_weight", "normalise"), WAYS)
def test_vectors_are_freed_of_their_biases_before_all_else(
    count, weights, cross_weight, normalise
) -> None:
    raw = random_measurements(np.random.default_rng(1), N, count, 1, missing=0.4)
    biases = np.random.default_rng(2).normal(size=(N, count, 3))
    settings = vector_settings(
        weights=weights, cross_weight=cross_weight, normalise=normalise, each_agent=True
    )
    wahba, freed = in_the_loop(as_arrays(raw, np.float64), jnp.asarray(biases), settings)
    as_used = {
        "normalise": normalise,
        "cross_weight": cross_weight,
        "vector_weights": weights,
    }
    want = by_definition(raw, biases, **as_used)
    np.testing.assert_allclose(
        np.array(wahba.profile).transpose(2, 0, 1), want["profile"], atol=1e-13
    )
    for name in ("power", "curvature", "scale"):
        np.testing.assert_allclose(getattr(wahba, name), want[name], rtol=1e-12, err_msg=name)
    seen = raw.vector_weights > 0
    got = np.moveaxis(np.array(freed), -1, 0)
    np.testing.assert_allclose(got[seen], (raw.vectors - biases)[seen], rtol=1e-15)


@pytest.mark.usefixtures("x64")
@examples(max_examples=10)
@given(seed=st.integers(0, 2**31), body=st.booleans())
def test_turned_vectors_turn_the_sums_and_change_no_size(seed: int, body: bool) -> None:
    # A rotation of all body vectors and biases multiplies B from the left, one of all references
    # from the right; power, curvature and scale are the same.
    rng = np.random.default_rng(seed)
    raw = random_measurements(rng, N, 2, 1)
    biases, R = rng.normal(size=(N, 2, 3)), Rotation.random(rng=rng).as_matrix()
    settings = vector_settings(cross_weight=0.7, normalise=True, each_agent=True)
    if body:
        turned, turned_biases = raw._replace(vectors=raw.vectors @ R.T), biases @ R.T
    else:
        turned = raw._replace(vector_references=raw.vector_references @ R.T)
        turned_biases = biases
    one, two = (
        in_the_loop(as_arrays(m, np.float64), jnp.asarray(c), settings)[0]
        for m, c in ((raw, biases), (turned, turned_biases))
    )
    before, after = (np.array(wahba.profile).transpose(2, 0, 1) for wahba in (one, two))
    np.testing.assert_allclose(after, R @ before if body else before @ R.T, atol=1e-12)
    for a, b in zip(one[1:], two[1:], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)


@pytest.mark.parametrize("each_agent", [False, True])
def test_values_of_missing_vectors_do_not_matter_even_nan(each_agent: bool) -> None:
    raw = random_measurements(np.random.default_rng(0), N, 3, 1, missing=0.5)
    other = raw._replace(vectors=np.nan_to_num(raw.vectors, nan=7.0))
    settings = vector_settings(np.float32, cross_weight=1.0, normalise=True, each_agent=each_agent)

    def made(m: Measurements) -> Wahba:
        m = as_arrays(m, np.float32)
        return in_the_loop(m, None, settings)[0] if each_agent else before_the_loop(m, settings)

    for a, b in zip(jax.tree.leaves(made(raw)), jax.tree.leaves(made(other)), strict=True):
        assert np.isfinite(a).all()
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("each_agent", [False, True])
@pytest.mark.parametrize("weights", [(), None])
def test_without_vectors_there_is_nothing_to_sum(each_agent: bool, weights: Any) -> None:
    m = as_arrays(random_measurements(np.random.default_rng(0), N, 0, 1), np.float32)
    chosen = vector_settings(np.float32, weights=weights, each_agent=each_agent)
    wahba = in_the_loop(m, None, chosen)[0] if each_agent else before_the_loop(m, chosen)
    for leaf in jax.tree.leaves(wahba):
        np.testing.assert_array_equal(leaf, np.zeros(N))


@pytest.mark.usefixtures("x64")
def test_a_vector_of_the_length_of_its_bias_has_finite_derivatives() -> None:
    m = as_arrays(random_measurements(np.random.default_rng(0), N, 2, 1), np.float64)
    settings = vector_settings(cross_weight=1.0, normalise=True, each_agent=True)

    def total(biases: Array) -> Array:
        wahba, _ = in_the_loop(m, biases, settings)
        return sum(jnp.sum(leaf) for leaf in jax.tree.leaves(wahba))

    slopes = jax.jit(jax.grad(total))(m.vectors)
    assert np.isfinite(slopes).all()


# Helpers -----------------------------------------------------------------------------------------


def test_normalised_vectors_have_length_one_and_zero_stays_zero() -> None:
    v = np.random.default_rng(0).normal(size=(5, 2, 3)).astype(np.float32)
    v[3, 1] = 0
    got = np.asarray(jax.jit(normalised)(v))
    lengths = np.ones((5, 2))
    lengths[3, 1] = 0
    np.testing.assert_allclose(np.linalg.norm(got, axis=-1), lengths, atol=2e-7)
    np.testing.assert_allclose(got[0], v[0] / np.linalg.norm(v[0], axis=-1)[:, None], atol=2e-7)


def test_cross_vector_is_the_product_of_the_first_two() -> None:
    v = np.random.default_rng(0).normal(size=(5, 3, 3)).astype(np.float32)
    got = np.asarray(jax.jit(with_cross_vector)(v))
    assert got.shape == (5, 4, 3)
    np.testing.assert_array_equal(got[:, :3], v)
    np.testing.assert_allclose(got[:, 3], np.cross(v[:, 0], v[:, 1]), atol=1e-6)


def test_inverse_or_zero_is_differentiable_at_zero() -> None:
    value_and_slope = jax.jit(jax.vmap(jax.value_and_grad(inverse_or_zero)))
    value, slope = value_and_slope(np.float32([0, 4]))
    assert value.tolist() == [0, 0.25]
    assert slope.tolist() == [0, -1 / 16]
