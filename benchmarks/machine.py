"""The machine that a benchmark ran on."""

import datetime
import platform
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from contenders import c


def machine(jax_version: str, cores: int, load: str) -> dict[str, str]:
    """Hardware and software that the figures depend on."""
    return {
        "load": load,
        "cpu": " ".join(cpu()),
        "cores": str(cores),
        "compiler": c.compiler_version(),
        "jax": jax_version,
        "numpy": np.__version__,
        "python": platform.python_version(),
        "date": datetime.date.today().isoformat(),
    }


def cpu() -> Iterator[str]:
    """Name of the CPU, its family and model if known, and its widest vector instructions."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n")[0]
    except OSError:
        yield platform.processor() or platform.machine()
        return
    entries = (line.split(":", 1) for line in text.splitlines() if ":" in line)
    known = {key.strip(): value.strip() for key, value in entries}
    yield known.get("model name", platform.machine())
    if "cpu family" in known:
        yield f"(family {known['cpu family']}, model {known.get('model', '?')})"
    flags = known.get("flags", "").split()
    yield next((name for name in ("avx512f", "avx2") if name in flags), "")
