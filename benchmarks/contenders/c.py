"""The limit: hand-vectorised C, compiled on the fly and called through ctypes.

`pose_filter.c` is called here, `learning_filter.c` in `learning`, `kalman_filter.c` in `kalman`.
"""

import ctypes
import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from contenders.scene import Scene

SOURCES = ("pose_filter.c", "learning_filter.c")
FLAGS = ("-O3", "-ffast-math", "-fPIC")
OPTIONAL_FLAGS = (
    "-fopenmp",  # threads
    "-fschedule-insns",  # instructions ordered by latency before registers are allocated,
    "-fsched-pressure",  # while registers suffice: 15 % faster
)
"""Used if the compiler supports them."""
ISAS = {
    "native": ("-march=native", "-mprefer-vector-width=512"),  # full vectors: twice as fast
    "avx2": ("-march=x86-64-v3", "-mprefer-vector-width=256", "-DLANES=8"),
}
"""Compiler options for the CPU: this one, or one with vectors of 8 floats."""

FLOATS = np.ctypeslib.ndpointer(np.float32, flags="C_CONTIGUOUS")


class _Settings(ctypes.Structure):
    _fields_ = tuple(
        (name, ctypes.c_float)
        for name in (
            "gamma_angular",
            "gamma_linear",
            "gain_limit",
            "signal_scale",
            "rate_scale",
            "cost_position",
            "initial_gain",
        )
    )


def compiler() -> str | None:
    """The C compiler: CC, gcc or cc, whichever is found first."""
    names = [os.environ.get("CC"), "gcc", "cc"]
    return next((path for name in names if name and (path := shutil.which(name))), None)


def compiler_version() -> str:
    """First line of the compiler's version output."""
    command = compiler()
    if command is None:
        return "none"
    said = subprocess.run([command, "--version"], capture_output=True, text=True, check=True)
    return said.stdout.splitlines()[0]


def build(
    folder: Path,
    isa: str = "native",
    sources: Sequence[str] = SOURCES,
    defined: Sequence[str] = (),
) -> Path:
    """Compile a library of sources into a folder, for one of `ISAS`, with some names -Ddefined.

    Raises:
        RuntimeError: there is no compiler, or it fails.
    """
    command = compiler()
    if command is None:
        raise RuntimeError("no C compiler (CC, gcc or cc) was found")
    suffix = "_".join([isa, *defined])
    library = folder / f"{Path(sources[0]).stem}_{suffix}.so"
    optional = [*OPTIONAL_FLAGS, *ISAS[isa]]
    given = [*FLAGS, *(flag for flag in optional if _knows(command, flag, folder))]
    given += [f"-D{name}" for name in defined]
    compiled = [folder / f"{Path(name).stem}_{suffix}.o" for name in sources]
    # Linked by itself, without -ffast-math: with it, gcc adds code that makes the whole process,
    # Python's and JAX's numbers included, round subnormal numbers to 0 when the library is loaded.
    linked = ["-shared", *(flag for flag in given if flag in ("-fPIC", "-fopenmp"))]
    paths = (Path(__file__).with_name(name) for name in sources)
    for step in (
        *([*given, "-c", str(a), "-o", str(b)] for a, b in zip(paths, compiled, strict=True)),
        [*linked, *map(str, compiled), "-o", str(library), "-lm"],
    ):
        said = subprocess.run([command, *step], capture_output=True, text=True)
        if said.returncode:
            raise RuntimeError(f"{command} failed: {said.stderr.strip()}")
    return library


def _knows(command: str, flag: str, folder: Path) -> bool:
    probe = folder / "probe.c"
    probe.write_text("int probe(void) { return 0; }\n", encoding="utf-8")
    said = subprocess.run(
        [command, flag, "-Werror", "-shared", "-fPIC", str(probe), "-o", str(folder / "probe.so")],
        capture_output=True,
    )
    return said.returncode == 0


def packed(scene: Scene) -> np.ndarray:
    """The samples as the C code reads them: its `Sample`, (S, N, numbers)."""
    C = np.swapaxes(scene.profile, -1, -2)  # sum s v^I (v^B)^T, so that tr(R B) = sum R_ij C_ij
    c = [[C[..., i, j] for j in range(3)] for i in range(3)]
    davenport = (
        c[0][0] + c[1][1] + c[2][2],
        c[2][1] - c[1][2],
        c[0][2] - c[2][0],
        c[1][0] - c[0][1],
        c[0][0] - c[1][1] - c[2][2],
        c[0][1] + c[1][0],
        c[0][2] + c[2][0],
        c[1][1] - c[0][0] - c[2][2],
        c[1][2] + c[2][1],
        c[2][2] - c[0][0] - c[1][1],
    )
    weight, p2 = scene.landmark_weight, np.sum(scene.landmark_inertial**2, axis=-1)
    dt = scene.time_step[..., None]
    columns = [
        *davenport,
        scene.attitude_scale * scene.vector_power,
        2 * scene.attitude_scale,
        scene.position_weight * (weight > 0),  # one landmark: its share is 1 where it is seen
        scene.smoothing_factor,
        scene.landmark_body,
        scene.landmark_inertial,
        0.5 * weight,
        scene.vector_curvature + 0.25 * weight,
        0.25 * weight * np.sqrt(p2),
        0.25 * weight * np.sqrt(1 + p2),
        dt * scene.angular_velocity,
        dt * scene.velocity,
        scene.true_attitude,
        scene.true_origin,
        np.broadcast_to(scene.cost_weight, scene.time_step.shape),
        scene.time_step,
    ]
    columns = [a[..., None] if a.ndim == 2 else a for a in columns]
    return np.ascontiguousarray(np.concatenate(columns, axis=-1), np.float32)


def prepare(scene: Scene, library: Path, threads: int = 1) -> Callable[[], np.ndarray]:
    """A function of no arguments that computes the costs (S, A), float32.

    What does not depend on the agents is done here, as posegsa does it before its own call.

    Raises:
        RuntimeError: the library was built from another source.
    """
    loaded, sample = ctypes.CDLL(str(library)), packed(scene)
    if loaded.pose_filter_sample_numbers() != sample.shape[-1]:
        raise RuntimeError(f"{library}: its samples do not have {sample.shape[-1]} numbers")
    c = _Settings(
        *scene.gamma,
        scene.gain_limit,
        1 / scene.error_scale,
        scene.rate_scale,
        scene.cost_position,
        scene.initial_gain,
    )
    start = np.ascontiguousarray(
        np.concatenate(
            [scene.attitude, in_body(scene.attitude, scene.position), scene.bias], axis=-1
        ),
        np.float32,
    )
    inputs, outputs = (np.ascontiguousarray(a, np.float32) for a in (scene.inputs, scene.outputs))
    run = loaded.pose_filter_costs
    run.argtypes = [ctypes.c_int] * 3 + [FLOATS] * 4 + [ctypes.POINTER(_Settings), ctypes.c_int]
    run.argtypes = [*run.argtypes, FLOATS]
    out = np.empty((scene.scenarios, scene.agents), np.float32)
    sizes = scene.scenarios, scene.samples, scene.agents

    def costs() -> np.ndarray:
        if run(*sizes, sample, start, inputs, outputs, ctypes.byref(c), threads, out):
            raise RuntimeError("pose_filter.c: a group of blocks is larger than its array")
        return out

    return costs


def in_body(attitude: np.ndarray, position: np.ndarray) -> np.ndarray:
    """R^T P of unit quaternions (S, 4) and positions (S, 3), (S, 3)."""
    w, v = attitude[:, :1], -attitude[:, 1:]
    turned = 2 * np.cross(v, position)
    return position + w * turned + np.cross(v, turned)
