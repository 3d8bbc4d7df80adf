"""What every test runs under: strict JAX, the fast path's options, few and repeatable examples."""

import os
from collections.abc import Iterator

import jax
import numpy as np
import pytest
from hypothesis import settings

from posegsa.runtime import fast_path_flags

# Before JAX makes its first array. The tests pass without it too; with it they run what users run.
os.environ["XLA_FLAGS"] = fast_path_flags(os.environ.get("XLA_FLAGS", ""))

# The first example of a shape compiles, so that no example has a deadline.
settings.register_profile("posegsa", deadline=None, derandomize=True, max_examples=25)
settings.load_profile("posegsa")


@pytest.fixture(autouse=True)
def strict() -> Iterator[None]:
    """No silent change of dtype, no silent broadcast of ranks."""
    with jax.numpy_dtype_promotion("strict"), jax.numpy_rank_promotion("raise"):
        yield


@pytest.fixture
def x64() -> Iterator[None]:
    """Run a test in float64."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(params=[np.float32, np.float64], ids=["float32", "float64"])
def dtype(request: pytest.FixtureRequest) -> Iterator[type[np.floating]]:
    """Run a test in both precisions."""
    with jax.enable_x64(request.param == np.float64):
        yield request.param
