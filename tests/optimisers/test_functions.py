"""The test functions: published values, minima, shifts and rotations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from posegsa.optimisers.functions import FUNCTIONS, ClassicalFunction

pytestmark = pytest.mark.quick

# The textbook formulas, as the sources print them, in float64.
Z = np.array([0.3, -1.2, 2.5])
D = 3
EXPECTED = {
    "sphere": np.sum(Z**2),
    "ellipsoid": Z[0] ** 2 + 1e3 * Z[1] ** 2 + 1e6 * Z[2] ** 2,
    "rosenbrock": sum(100 * (Z[i + 1] - Z[i] ** 2) ** 2 + (Z[i] - 1) ** 2 for i in range(2)),
    "rastrigin": np.sum(Z**2 - 10 * np.cos(2 * np.pi * Z) + 10),
    "ackley": -20 * np.exp(-0.2 * np.sqrt(np.sum(Z**2) / D))
    - np.exp(np.sum(np.cos(2 * np.pi * Z)) / D)
    + 20
    + np.e,
    "griewank": np.sum(Z**2) / 4000 - np.prod(np.cos(Z / np.sqrt([1, 2, 3]))) + 1,
    "schwefel": 418.9828872724339 * D - np.sum(Z * np.sin(np.sqrt(np.abs(Z)))),
}


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("name", FUNCTIONS)
def test_values_against_the_textbook(name: str) -> None:
    function = ClassicalFunction(name, D)
    costs = jax.jit(function)(np.array([Z, function.minimum]))
    assert costs[0] == pytest.approx(EXPECTED[name], rel=1e-9)
    assert costs[1] == pytest.approx(0, abs=1e-5)  # Schwefel's minimum is known to eight digits


@pytest.mark.usefixtures("x64")
def test_a_shift_moves_the_minimum_and_a_rotation_keeps_it() -> None:
    plain = ClassicalFunction("rosenbrock", D)
    moved = ClassicalFunction("rosenbrock", D, shift=0.5, rotation=3)
    assert moved.minimum.tolist() == [16.0] * 3
    z = np.random.default_rng(0).normal(size=(4, D))
    shifted = ClassicalFunction("rosenbrock", D, shift=0.5)
    np.testing.assert_allclose(shifted(jnp.asarray(z + 15)), plain(jnp.asarray(z)), rtol=1e-9)
    assert moved(jnp.asarray(moved.minimum)[None])[0] < 1e-20
    # A rotation keeps the distance from the minimum: the sphere stays the same, others change.
    for name, same in (("sphere", True), ("ellipsoid", False)):
        a, b = (ClassicalFunction(name, D, rotation=r)(jnp.asarray(z)) for r in (None, 3))
        assert np.allclose(a, b, rtol=1e-9) == same


def test_schwefel_rises_outside_its_box() -> None:
    function = ClassicalFunction("schwefel", 2, rotation=1)
    corners = jnp.asarray([[500, 500], [-500, 500], [500, -500], [-500, -500]], jnp.float32)
    assert (function(corners) > 0).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("spher", 3), "name = 'spher'; allowed: 'sphere' or "),
        (("sphere", 1), "dimensions = 1"),
        (("sphere", 3, 1.5), "shift = 1.5"),
        (("schwefel", 3, 0.5), r"shift = 0.5 takes the minimum of schwefel out.*-1.84 to 0.158"),
        (("sphere", 3, 0.0, -1), "rotation = -1"),
    ],
)
def test_bad_attributes_are_refused(arguments: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=f"function: {message}"):
        ClassicalFunction(*arguments)


def test_titles_say_what_was_done() -> None:
    title = ClassicalFunction("ackley", 5, shift=0.25, rotation=7).title
    assert title == "ackley, 5 dimensions, shifted by 0.25 half widths, rotated (seed 7)"
