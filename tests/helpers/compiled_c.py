"""Exported filters compiled and run: numbers in, the filter's states out."""

import itertools
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

COMPILERS = tuple(filter(shutil.which, ("gcc", "clang"))) or tuple(filter(shutil.which, ["cc"]))
needs_cc = pytest.mark.skipif(not COMPILERS, reason="there is no C compiler")
WARNINGS = [
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wfloat-conversion"),
    *("-Wdouble-promotion", "-Wshadow", "-Werror"),
]
SANITIZERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]
DRIVER = Path(__file__).parents[1] / "export" / "drive_filter.c"


def need(compiler: str) -> str:
    """The compiler, or a skip that names it."""
    if shutil.which(compiler) is None:
        pytest.skip(f"there is no {compiler}")
    return compiler


@cache
def sanitizers(compiler: str) -> tuple[str, ...]:
    """The options that check memory and undefined behaviour; none if they are unsupported."""
    command = [compiler, "-x", "c", "-", *SANITIZERS, "-o", "/dev/null"]
    empty = "int main(void) { return 0; }"
    done = subprocess.run(command, input=empty, text=True, check=False, capture_output=True)
    return tuple(SANITIZERS) if done.returncode == 0 else ()


def compile_c(folder: Path, header: str, source: Path, *options: str, compiler: str) -> Path:
    """Compile, without warnings, an exported header and a source that includes it."""
    (folder / "posegsa.h").write_text(header, encoding="ascii")
    program = folder / "program"
    command = [compiler, *options, *WARNINGS, "-I", str(folder), str(source), "-o", str(program)]
    subprocess.run([*command, "-lm"], check=True)
    return program


class States(NamedTuple):
    """The state of a C filter before each of N samples, (N, ...), with names as in Python."""

    code: np.ndarray
    rotation: np.ndarray
    position: np.ndarray
    bias: np.ndarray
    vector_bias: np.ndarray
    gain: np.ndarray
    gain_used: np.ndarray
    raw: np.ndarray
    """The states (N, numbers) in the order of the memory."""


class Layout(NamedTuple):
    """The layout of an exported filter's state."""

    vectors: int
    landmarks: int
    learns: bool
    time: bool = False
    unknown: bool = False

    def fields(self) -> dict[str, int]:
        """The fields in order, and the number of values of each."""
        moves, n = 3 if self.landmarks else 0, self.vectors
        return {
            "attitude": 4,
            "position": moves,
            "bias_angular": 3,
            "bias_linear": moves,
            "vector_bias": 3 * n if self.learns else 0,
            "turning": 3 if self.learns else 0,
            "attitude_error": 1 if n else 0,
            "position_error": 1 if self.landmarks else 0,
            "error": 1,
            "since_last": 1,
            "unknown": 1 if self.unknown else 0,
            "time": 1 if self.time else 0,
            "gain": 1,
            "gain_used": 1,
        }


def run_c(program: Path, layout: Layout, start: np.ndarray, rows: np.ndarray) -> States:
    """Run a program of `drive_filter.c` over rows (N, dt and measurement), at their dtype."""
    given = np.concatenate([start.ravel().astype(rows.dtype), rows.ravel()]).tobytes()
    done = subprocess.run([program], input=given, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    fields = layout.fields()
    table = np.frombuffer(done.stdout, rows.dtype).reshape(len(rows), 1 + sum(fields.values()))
    ends = list(itertools.accumulate(fields.values(), initial=1))
    of = {
        name: table[:, a:b] for name, (a, b) in zip(fields, itertools.pairwise(ends), strict=True)
    }
    learnt = of["vector_bias"].reshape(len(rows), -1, 3)
    return States(
        code=table[:, 0].astype(int),
        rotation=rotation_matrices(of["attitude"]),
        position=of["position"],
        bias=np.concatenate([of["bias_angular"], of["bias_linear"]], axis=1),
        vector_bias=learnt,
        gain=of["gain"][:, 0],
        gain_used=of["gain_used"][:, 0],
        raw=table[:, 1:],
    )


def rotation_matrices(quaternions: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) from quaternions (N, 4), w first."""
    w, x, y, z = quaternions.astype(np.float64).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


Build = Callable[..., Path]


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Compiles an exported header with `drive_filter.c` in a folder of its own, once."""

    @cache
    def one(header: str, *options: str, compiler: str = COMPILERS[0] if COMPILERS else "") -> Path:
        folder = tmp_path_factory.mktemp("filter")
        return compile_c(folder, header, DRIVER, *options, compiler=compiler)

    return one
