"""Normal numbers by rows: JAX's own, whichever rows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from posegsa.errors import ArgumentError
from posegsa.model.noise import normal_rows


@pytest.mark.parametrize("shape", [(), (2, 3), (0, 3)])
@pytest.mark.parametrize(("first", "rows"), [(0, 40), (13, 20), (39, 1)])
def test_rows_are_those_of_the_whole(shape: tuple[int, ...], first: int, rows: int) -> None:
    key = jax.random.fold_in(jax.random.key(7), 3)
    whole = jax.random.normal(key, (40, *shape), jnp.float32)
    got = jax.jit(normal_rows, static_argnums=(2, *range(3, 3 + len(shape))))(
        key, np.int32(first), rows, *shape
    )
    assert got.dtype == jnp.float32
    np.testing.assert_array_equal(got, whole[first : first + rows])


def test_numbers_far_from_the_start_are_normal_too() -> None:
    drawn = jax.jit(normal_rows, static_argnums=2)
    many = np.asarray(drawn(jax.random.key(0), np.int32(2**30), 40_000))
    np.testing.assert_allclose([many.mean(), many.std()], [0, 1], atol=0.02)
    near = np.asarray(drawn(jax.random.key(0), np.int32(0), 40_000))
    assert abs(np.corrcoef(many, near)[0, 1]) < 0.02


def test_a_key_of_another_generator_is_refused() -> None:
    with pytest.raises(ArgumentError, match=r"key of \(4,\) words; allowed: .*threefry2x32"):
        normal_rows(jax.random.key(0, impl="rbg"), 0, 3)
