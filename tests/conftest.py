"""What every test runs under: strict JAX, the fast path's options, few and repeatable examples."""

import ctypes
import gc
import os
import time
import zlib
from collections.abc import Iterator
from pathlib import Path

# Before NumPy and SciPy load: the threads of OpenBLAS wait for their share of a 4 x 4 matrix by
# spinning, which took half the time of the tests against the reference.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
# Where there is a GPU too: what a GPU gets is tested by the interpreter of its kernels.
os.environ["JAX_PLATFORMS"] = "cpu"

import jax
import numpy as np
import pytest
from hypothesis import settings

from posegsa.recordings import running
from posegsa.runtime import fast_path_flags

# Before JAX makes its first array. The tests pass without it too; with it they run what users run.
# Searches as small as most tests' use one of the devices.
os.environ["XLA_FLAGS"] = fast_path_flags(os.environ.get("XLA_FLAGS", ""), devices=4)

# Compiled programs are kept, even the smallest: compiling is two thirds of the tests' time, and a
# program is found again by other workers, processes that tests start, and later runs. One that
# was compiled for another CPU, whose instructions may differ, is none of these.
CPU = Path("/proc/cpuinfo").read_text("utf-8") if Path("/proc/cpuinfo").exists() else ""
INSTRUCTIONS = sorted({line for line in CPU.splitlines() if line.startswith(("flags", "Features"))})
ROOT = Path(__file__).parents[1]
CACHE = ROOT / ".pytest_cache" / "compiled" / f"{zlib.crc32(''.join(INSTRUCTIONS).encode()):08x}"
os.environ["JAX_COMPILATION_CACHE_DIR"] = str(CACHE)
jax.config.update("jax_compilation_cache_dir", str(CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)

# No silent change of dtype, no silent broadcast of ranks. For fixtures as for tests: what is
# compiled under other rules is compiled again.
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

# JAX makes millions of objects that stay. To check all of them in each garbage collection, as often
# as Python does by default, takes a twentieth of the tests' time.
gc.set_threshold(20_000, 50, 1000)

# The first example of a shape compiles, so that no example has a deadline.
settings.register_profile("posegsa", deadline=None, derandomize=True, max_examples=25)
settings.load_profile("posegsa")


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


@pytest.fixture(scope="module", autouse=True)
def optimisation(request: pytest.FixtureRequest) -> None:
    """Compile without most of LLVM's optimisations, except in a file that is marked `optimised`.

    What a test runs for a moment need not be quick, and compiling it so takes twice the time. What
    is compiled either way would be found again by the other files of a process, so it is forgotten
    between them: once in a run, because the marked files come first. Processes that tests start do
    the same, and so find the programs of this one.
    """
    fast = request.node.get_closest_marker("optimised") is None
    os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = str(int(fast))
    if jax.config.read("jax_disable_most_optimizations") != fast:
        jax.clear_caches()
        jax.config.update("jax_disable_most_optimizations", fast)


MEMORY_LIMIT = 4e9
"""Memory of a process above which its compiled programs are forgotten [byte]."""


@pytest.fixture(scope="module", autouse=True)
def memory() -> Iterator[None]:
    """Forget the compiled programs between files, once they take gigabytes.

    Kept to the end, they take 8 GB in each of two processes. Most are of one file; those that are
    needed again are on disk. glibc keeps what is freed until it is told to give it back.
    """
    yield
    status = Path("/proc/self/statm")
    pages = int(status.read_text().split()[1]) if status.exists() else 0
    if pages * os.sysconf("SC_PAGE_SIZE") > MEMORY_LIMIT:
        jax.clear_caches()
        gc.collect()
        if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
            trim(0)


@pytest.fixture(scope="session", autouse=True)
def short_parts() -> Iterator[None]:
    """Filter recordings in parts of one length, so that recordings of all lengths run one program.

    Of the length that users have, each recording of a test would be one part, and compiled anew.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(running, "PART", 100)
        yield


WEEK = 7 * 24 * 3600
"""[s]"""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files that are marked `optimised` first (workers keep to the order)."""
    items.sort(key=lambda item: item.get_closest_marker("optimised") is None)


def pytest_unconfigure(config: pytest.Config) -> None:
    """Forget compiled programs that no run has used for a week."""
    if not hasattr(config, "workerinput"):
        for program in CACHE.glob("*"):
            if time.time() - max(program.stat().st_atime, program.stat().st_mtime) > WEEK:
                program.unlink(missing_ok=True)
