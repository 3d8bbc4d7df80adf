"""Elementwise operations of the hot loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from posegsa.model.elementwise import as_long_as, only_if


@pytest.mark.quick
def test_a_carry_is_changed_only_where_the_condition_holds_alone_and_under_vmap() -> None:
    def changed(condition: jax.Array, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        return only_if(condition, lambda carry: (carry[1], -carry[0]), (x, x + 1))

    conditions, x = jnp.array([True, False, True]), jnp.array([1.0, 2.0, 3.0])
    want = [[2.0, 2.0, 4.0], [-1.0, 3.0, -3.0]]

    np.testing.assert_array_equal(jax.vmap(changed)(conditions, x), want)
    for run in (changed, jax.jit(changed)):
        each = [run(one, number) for one, number in zip(conditions, x, strict=True)]
        np.testing.assert_array_equal(np.transpose(each), want)


@pytest.mark.quick
def test_each_is_changed_as_long_as_its_own_condition_holds() -> None:
    def doubled(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        def change(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            return 2 * carry[0], carry[1] + 1

        return as_long_as(lambda carry: carry[0] < 10, change, (x, y), 5)

    x, y = jnp.array([20.0, 9.0, 1.0, 0.001]), jnp.zeros(4)
    want = [[20.0, 18.0, 16.0, 0.032], [0.0, 1.0, 4.0, 5.0]]

    for run in (doubled, jax.jit(doubled)):
        np.testing.assert_allclose(run(x, y), want)
        each = [run(*pair) for pair in zip(x, y, strict=True)]
        np.testing.assert_allclose(np.transpose(each), want)
    np.testing.assert_allclose(jax.vmap(doubled)(x, y), want)
