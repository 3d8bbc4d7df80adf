"""Controllers for other fuzzy tools: test cases, inputs and expected outputs.

The readers are third-party programs: Debian's `fuzzylite` (fis, fll), and from PyPI
pyfuzzylite before 8, which needs no NumPy (fll).
"""

import shutil
import subprocess
from pathlib import Path

import jax
import numpy as np
import pytest
from jax import Array
from jax.typing import ArrayLike

from helpers import reference
from helpers.schedules import DRAWN, GAPS, K, tuned
from posegsa.model.fuzzy import FuzzyController

FUZZYLITE = shutil.which("fuzzylite")
needs_fuzzylite = pytest.mark.skipif(
    FUZZYLITE is None, reason="the command fuzzylite is not there (Debian's package fuzzylite)"
)

VERTICAL = np.array(
    [
        *(0.2, 0.2, 0.2, 0.45, 0.4, 0.45, 0.6, 0.6, 0.8, 0.8, 0.7),
        *(10.03, 20.13, 20.13, 40.0, 30.0, 45.17, 45.17, 60.0, 70.0, 90.0, 65.0),
    ]
)
"""Terms with vertical edges inside the universe, but not at a sample of the output."""
WIDE = (f"parameters.lower={[0.0] * 22}", f"parameters.upper={[1.0] * 11 + [100.0] * 11}", *GAPS)

CASES = {"covering": (K, ()), "gaps": (DRAWN[0], GAPS), "vertical": (VERTICAL, WIDE)}


def controller(case: str) -> FuzzyController:
    """One of CASES in float64."""
    k, settings = CASES[case]
    return tuned(k, *settings, dtype="float64").controller


def inputs(count: int = 150) -> np.ndarray:
    """Errors and rates (n, 2) in [0, 1], more of them small; none at a term's corner."""
    rng = np.random.default_rng(3)
    return rng.uniform(0.001, 0.999, (count, 2)) ** [[1.0, 2.0]]


def heights(one: FuzzyController, given: np.ndarray) -> np.ndarray:
    """Heights of the output terms (n, terms), from the reference."""
    terms, rules = np.asarray(one.input_terms), np.array(one.rules)
    return np.array([reference.firing_heights(e, r, terms, rules) for e, r in given])


def by_samples(
    one: FuzzyController, given: np.ndarray, at: np.ndarray, weights: np.ndarray | float = 1.0
) -> np.ndarray:
    """Centroid over sample points `at`, NaN where no rule fires; plain NumPy in float64."""
    a, b, c = np.asarray(one.output_terms, np.float64).T[:, :, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        rise = np.where(at < b, np.clip((at - a) / (b - a), 0, 1), 1.0)
        fall = np.where(at > b, np.clip((c - at) / (c - b), 0, 1), 1.0)
        clipped = np.minimum(heights(one, given)[:, :, None], np.nan_to_num(rise * fall))
        joined = weights * clipped.max(axis=1)
        return (joined * at).sum(axis=1) / joined.sum(axis=1)


def by_midpoints(one: FuzzyController, given: np.ndarray, parts: int) -> np.ndarray:
    """Centroid by a midpoint sum over the output's range, like fuzzylite's."""
    low, high = one.output_range
    return by_samples(one, given, low + (high - low) * (np.arange(parts) + 0.5) / parts)


@jax.jit
def _gains(one: FuzzyController, error: ArrayLike, rate: ArrayLike) -> Array:
    return one(error, rate)


def exact(one: FuzzyController, given: np.ndarray) -> np.ndarray:
    """K - 1 of the controller itself, NaN where no rule fires."""
    with jax.enable_x64(True):
        gains = np.asarray(_gains(one, *given.T)) - 1
    return np.where(heights(one, given).any(axis=1), gains, np.nan)


def with_fuzzylite(text: str, form: str, given: np.ndarray, folder: Path) -> np.ndarray:
    """The outputs of Debian's fuzzylite for a controller in this format, row by row."""
    source, rows, out = folder / f"gain.{form}", folder / "rows.fld", folder / "out.fld"
    source.write_text(text, encoding="utf-8")
    rows.write_text("\n".join(f"{e!r} {r!r}" for e, r in given.tolist()), encoding="utf-8")
    options = {
        "-i": source,
        "-if": form,
        "-o": out,
        "-of": "fld",
        "-d": rows,
        "-decimals": 14,
        "-dheader": "false",
        "-dinputs": "false",
    }
    words = [str(word) for pair in options.items() for word in pair]
    done = subprocess.run(
        [str(FUZZYLITE), *words], capture_output=True, text=True, timeout=60, check=False
    )
    assert out.exists(), done.stdout + done.stderr
    return np.array([float(word) for word in out.read_text("utf-8").split()])
