"""Arrays of one shape in one array: unpacking returns the same tree, inside jit too."""

import jax
import jax.numpy as jnp
import numpy as np
from helpers.arrays import assert_same
from helpers.experiments import lasting, paper

from posegsa.search.packing import packed
from posegsa.search.problem import tuning_problem


def test_a_tree_comes_back_to_the_last_bit() -> None:
    tree = {
        "a": jnp.arange(6.0).reshape(2, 3),
        "b": (jnp.float32(4), None, -jnp.arange(6.0).reshape(2, 3)),
        "whole": jnp.arange(6).reshape(2, 3),
    }
    found = packed(tree, tree["a"])
    assert found.together.shape == (2, 3, 2)
    assert len(found.others) == 2
    assert_same(found.unpacked(), tree)
    assert_same(jax.jit(lambda one: one.unpacked())(found), tree)
    # Several trees at once, as in a batch of searches.
    twice = jax.tree.map(lambda a: jnp.stack([a, 2 * a]), found)
    second = jax.tree.map(lambda a: a[1], jax.vmap(lambda one: one.unpacked())(twice))
    assert_same(second, jax.tree.map(lambda a: 2 * a, tree))


def test_scenarios_samples_are_side_by_side_as_the_loop_reads_them() -> None:
    batch = tuning_problem(
        paper(*lasting(0.2), "run.training_scenarios=3", dtype="float32")
    ).training
    found = packed(batch, batch.samples.time)
    leaves = jax.tree.leaves(batch.samples)
    assert found.together.shape == (3, 20, len(leaves))
    for i, leaf in enumerate(leaves):
        np.testing.assert_array_equal(found.together[..., i], leaf)
    assert_same(found.unpacked(), batch)
