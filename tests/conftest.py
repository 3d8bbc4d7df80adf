"""What every test runs under: strict JAX, the fast path's options, few and repeatable examples."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import settings

from posegsa.runtime import fast_path_flags

# Before JAX makes its first array. The tests pass without it too; with it they run what users run.
# Searches as small as most tests' use one of the devices.
os.environ["XLA_FLAGS"] = fast_path_flags(os.environ.get("XLA_FLAGS", ""), devices=4)

# Programs that several workers or processes need are compiled once a run: most of the tests' time.
RUN = os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid()))
CACHE = Path(tempfile.gettempdir()) / f"posegsa-tests-{RUN}"
os.environ["JAX_COMPILATION_CACHE_DIR"] = str(CACHE)
jax.config.update("jax_compilation_cache_dir", str(CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)

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


def pytest_unconfigure(config: pytest.Config) -> None:
    """Remove the run's compiled programs, once all workers are done."""
    if not hasattr(config, "workerinput"):
        shutil.rmtree(CACHE, ignore_errors=True)
