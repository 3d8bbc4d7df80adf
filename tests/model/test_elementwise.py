"""Elementwise operations of the hot loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from posegsa.model.elementwise import only_if


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
