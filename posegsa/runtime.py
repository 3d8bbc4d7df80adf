"""The process that posegsa runs in: fast options for CPUs, and the environment stored in results.

Importing posegsa changes nothing in the process. XLA reads its options once, when JAX makes its
first array, so they must be set before that. The command line does so itself. A program calls
`enable_fast_path()` first, or sets the environment variable XLA_FLAGS to `fast_path_flags()`.
"""

import importlib
import os
import platform
import warnings

import jax
import numpy as np

from posegsa.arguments import check_whole
from posegsa.compiled_programs import enable_compilation_cache
from posegsa.errors import PosegsaWarning
from posegsa.version import VERSION

# Use 512-bit vectors on CPUs that have them: 1.4 times faster than XLA's default of 256 bits.
_WIDTH = "--xla_cpu_prefer_vector_width"
# A compiled loop runs on one core. Searches split their simulations over devices, one per core.
_DEVICES = "--xla_force_host_platform_device_count"
# By default XLA ends the process if one device waits 40 s for another. With a large population on
# a core shared with other processes, an iteration can take that much longer.
_PATIENCE = {
    "--xla_cpu_collective_call_warn_stuck_timeout_seconds": 3600,
    "--xla_cpu_collective_call_terminate_timeout_seconds": 7 * 24 * 3600,
    "--xla_cpu_collective_timeout_seconds": 7 * 24 * 3600,  # between processes
}
_MAX_DEVICES = 4096  # more than the cores of any machine
_EXTRA = "--xla_backend_extra_options="
# The first two make XLA:CPU compile the whole time loop as one function, and its body as one kernel
# with many outputs instead of one kernel per output: 3 times faster with 100 agents. The third is
# LLVM's limit of run-time checks for overlapping arrays: above it, LLVM does not vectorise a loop.
# Kernels that write the state in place need hundreds of checks, and the default is 128. Up to 1.3
# times faster. With the last LLVM does not replace a loop over a few registers by copies of its
# body: to compile a Kalman filter takes a seventh less time, and it runs no slower.
_OPTIONS = {
    "xla_cpu_use_multi_output_fusion": "true",
    "xla_cpu_small_while_loop_byte_threshold": "10000000",
    "-vectorize-memory-check-threshold": "100000",
    "-unroll-full-max-count": "1",
}
# LLVM's machine combiner takes a fifth of the time to compile a search of a Kalman filter: its
# work grows faster than a kernel's length. It reorders floating-point operations only where they
# may be reassociated, and XLA does not allow that: without it the results are the same bits, and
# such a search runs a sixth faster. LLVM ends a process that names an option of a processor that it
# does not know.
_X86_OPTIONS = {"-x86-machine-combiner": "false"}


def fast_path_flags(flags: str = "", devices: int | None = None) -> str:
    """XLA_FLAGS with the fast path's options appended. Options already in `flags` are kept.

    If `flags` is the name of a file with options, it is returned unchanged: XLA reads either a file
    or options.

    Args:
        flags: The present value of XLA_FLAGS.
        devices: Number of CPU devices; by default one for each core that the process may use.

    Raises:
        ArgumentError: If `devices` is not a whole number from 1 to 4096.
    """
    words = flags.split()
    if devices is not None:
        check_whole("devices", devices, 1, _MAX_DEVICES)
    if _is_file(flags):
        return flags
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    own = [word for word in words if word.startswith(_EXTRA)]
    options = [option for word in own for option in word.removeprefix(_EXTRA).split(",") if option]
    named = {option.split("=")[0] for option in options}
    ours = _OPTIONS | (_X86_OPTIONS if platform.machine() in ("x86_64", "AMD64") else {})
    options += [f"{name}={value}" for name, value in ours.items() if name not in named]
    others = [word for word in words if word not in own]
    for name, value in {_WIDTH: 512, _DEVICES: devices or cores or 1, **_PATIENCE}.items():
        if not any(word.split("=")[0] == name for word in others):
            others.append(f"{name}={value}")
    return " ".join([*others, _EXTRA + ",".join(options)])


def has_fast_path() -> bool:
    """Whether XLA_FLAGS names XLA's options of the fast path, or a file of unknown options."""
    flags = os.environ.get("XLA_FLAGS", "")
    # Those of LLVM matter less, and other versions of posegsa name others.
    return _is_file(flags) or all(name in flags for name in _OPTIONS if name.startswith("xla_"))


def _is_file(flags: str) -> bool:
    """Whether XLA reads XLA_FLAGS as the name of a file with options."""
    return bool(flags.strip()) and not flags.lstrip().startswith("-")


def enable_fast_path(devices: int | None = None) -> bool:
    """Set XLA's options for speed on CPUs. Call it before anything else uses JAX.

    Compiled programs are also stored on disk, for the next process
    (`compiled_programs.enable_compilation_cache`).

    Args:
        devices: As in `fast_path_flags`; searches split their simulations over them.

    Returns:
        Whether it was called in time. If not, it warns and XLA's options stay unchanged: results
        are the same, but slower.

    Raises:
        ArgumentError: If `devices` is not a whole number from 1 to 4096.
    """
    flags = fast_path_flags(os.environ.get("XLA_FLAGS", ""), devices)
    # Private, but there is no public way to ask. If JAX removes it, only the warning is lost.
    bridge = importlib.import_module("jax._src.xla_bridge")
    if getattr(bridge, "backends_are_initialized", lambda: False)():
        warnings.warn(
            "enable_fast_path() came after JAX had started, so it has no effect: call it before "
            f"the first array is made, or set XLA_FLAGS='{fast_path_flags()}' before Python starts",
            PosegsaWarning,
            stacklevel=2,
        )
        enable_compilation_cache()
        return False
    if _is_file(flags):
        warnings.warn(
            f"XLA_FLAGS names a file, {flags}, which is used as it is: the fast path's options "
            "(posegsa.runtime.fast_path_flags() returns them) are not added",
            PosegsaWarning,
            stacklevel=2,
        )
    os.environ["XLA_FLAGS"] = flags
    enable_compilation_cache()
    return True


def environment() -> dict[str, str]:
    """Versions and devices, stored in every result."""
    device = jax.devices()[0]
    return {
        "posegsa": VERSION,
        "jax": jax.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
        "platform": platform.platform(terse=True),
        "device": f"{device.device_kind} ({device.platform})",
        "devices": str(len(jax.devices())),
    }
