"""Cost of the exported filters: time on this machine, sizes, instructions on a Cortex-M4F.

1. On this machine: nanoseconds per step over a simulated minute, in float and double; best and
   median of many passes. Sizes of state and measurement.
2. On a Cortex-M4F, emulated by QEMU: code size, stack, and the number of instructions per step.
   Instructions are not cycles: a division or a root takes 14, a taken branch and some loads more
   than one. The board must give the same estimate as this machine. Needs gcc-arm-none-eabi,
   libnewlib-arm-none-eabi and qemu-system-arm; without them this part is left out.

The filters are those of shipped configurations, with the sensors of their scenarios; the observer
also with belief in each sensor, and for the attitude alone, without the landmark, as other attitude
filters use a gyroscope and two vectors; and Kalman filters without a schedule, of 12 and 18 states,
with one landmark and with eight, and with ten iterations an update.

    python benchmarks/c_filter.py [--write]
"""

import argparse
import re
import shutil
import statistics
import subprocess
import tempfile
import warnings
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from contenders.c import compiler
from machine import machine
from readme import write_block

import posegsa
from posegsa import config
from posegsa.export import filter_to_c
from posegsa.filters.belief import NoiseSignal
from posegsa.filters.kalman import KalmanFilter, KalmanNoise
from posegsa.filters.observer import BeliefSettings, ObserverGains
from posegsa.model.measurements import Measurements
from posegsa.model.scenario import integrate, measure
from posegsa.model.schedules import RampGain
from posegsa.search.drawn_scenarios import scenario
from posegsa.words import counted

HERE = Path(__file__).parent / "on_target"
PASSES = 40
ON_TARGET = 128
"""Number of samples for the emulated board."""
START = np.array([0.5, -0.5, 0.5, 0.5, 1.0, -2.0, 3.0])
"""Initial attitude (w, x, y, z) and position [m]."""
M4F = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
PASSES_ON_TARGET = 20
"""The same as in `count_instructions.c`."""
CODE_ONLY = """
#include "posegsa.h"
int step(posegsa_state *state, const posegsa_measurement *seen, posegsa_real dt);
int step(posegsa_state *state, const posegsa_measurement *seen, posegsa_real dt)
{
    return posegsa_step(state, seen, dt);
}
"""


@dataclass(frozen=True)
class Exported:
    """A filter in C, and its input."""

    name: str
    header: str
    rows: np.ndarray
    """(N, numbers) dt and a measurement, in the order of the C struct."""
    options: tuple[str, ...]
    start: np.ndarray


def exported() -> list[Exported]:
    """The filters that are measured."""
    with jax.enable_x64(True):
        few, several, rare = map(measured, ("observer", "disturbed", "sparse"))
        eight = with_landmarks(few, 8)
        observer = shipped("observer", few)
        line = RampGain(jnp.asarray(0.1), jnp.asarray(1.0))
        signal = NoiseSignal(*map(jnp.asarray, (0.1, 1e6, 0.1, 1e6)))
        believing = replace(
            shipped("observer", several),
            schedule=ObserverGains(observer.schedule, line, line),
            belief=BeliefSettings(signal, jnp.asarray(0.1), jnp.asarray(0.1)),
        )
        alone = replace(observer, settings=replace(observer.settings, landmark_weights=None))
        return [
            written("`observer`", observer, few),
            written("`observer` with belief in each sensor", believing, several),
            written("`observer`, attitude alone", alone, few, pose=False),
            *(
                written(f"Kalman, {18 if biases else 12} states", kalman(biases), m)
                for m in (few, eight)
                for biases in (False, True)
            ),
            written("Kalman, 18 states, 10 iterations", replace(kalman(True), iterations=10), few),
            written("`recommended`", shipped("recommended", few), few),
            written("`disturbed`", shipped("disturbed", several), several),
            written("`sparse`", shipped("sparse", rare), rare),
        ]


def measured(name: str) -> Measurements:
    """A minute of the scenario of a shipped configuration."""
    one = scenario(config.override(config.load(name), ["run.dtype=float64"]))
    return jax.tree.map(np.asarray, measure(one, integrate(one), jax.random.key(0)).measurements)


def shipped(name: str, m: Measurements) -> Any:
    """The filter of a configuration as it is shipped, for the sensors of these measurements."""
    vectors, landmarks = m.vectors.shape[1], m.landmarks.shape[1]
    filter = posegsa.configured(name).filter_for(vectors=vectors, landmarks=landmarks)
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf, np.float64)), filter)


def kalman(vector_biases: bool) -> KalmanFilter:
    """A Kalman filter with plausible noises. Its time depends on them only if it iterates."""
    values = (0.02, 0.02, 0.002, 0.003, 0.005, 0.1, 0.15, 1.0, 2.0, 0.1, 0.1, 0.1)
    return KalmanFilter(KalmanNoise(*map(jnp.asarray, values)), vector_biases)


def written(name: str, filter: Any, m: Measurements, *, pose: bool = True) -> Exported:
    """A filter in C, for the sensors of these measurements."""
    vectors, landmarks = m.vector_references[0], m.landmark_references[0] if pose else None
    text = filter_to_c(filter, vectors=vectors, landmarks=landmarks)
    sensors = f"{len(vectors)} vectors"
    if landmarks is not None:
        sensors += f", {counted(len(landmarks), 'landmark')}"
    options, start = ((), START) if pose else (("-DATTITUDE_ONLY",), START[:4])
    return Exported(f"{name}, {sensors}", text, rows(m, pose), options, start)


def with_landmarks(m: Measurements, count: int) -> Measurements:
    """The same with `count` landmarks: the first, and others some metres around it."""
    off = np.random.default_rng(0).uniform(-3.0, 3.0, (count, 3))
    off[0] = 0.0
    # The body's axes are unknown here, so the measurements need not be consistent.
    return m._replace(
        landmarks=m.landmarks[:, :1] + off,
        landmark_references=m.landmark_references[:, :1] + off,
        landmark_weights=np.repeat(m.landmark_weights[:, :1], count, axis=1),
    )


def rows(m: Measurements, pose: bool = True) -> np.ndarray:
    """Time steps and measurements in the order of the C struct."""
    flat = [a.reshape(len(m.time_step), -1) for a in m]
    step, omega, v, vectors, _, vector_weights, landmarks, _, landmark_weights = flat
    columns = [step, omega, *([v] if pose else []), vectors, vector_weights]
    return np.concatenate(columns + ([landmarks, landmark_weights] if pose else []), axis=1)


def run_here(one: Exported, real: str, passes: int, folder: Path) -> tuple[list[float], list[int]]:
    """Nanoseconds per step of each pass, and the last line of `time_steps.c`."""
    dtype = np.dtype({"float": np.float32, "double": np.float64}[real])
    options = ["-O2", f"-DPOSEGSA_REAL={real}", *one.options, "-I", str(folder)]
    program = folder / f"time-{real}"
    compiled(str(compiler()), *options, str(HERE / "time_steps.c"), "-o", str(program), "-lm")
    given = np.concatenate([one.start, one.rows.ravel()]).astype(dtype).tobytes()
    command = [program, str(len(one.rows)), str(passes)]
    done = subprocess.run(command, input=given, capture_output=True, check=True)
    *times, last = done.stdout.decode().splitlines()
    return list(map(float, times)), list(map(int, last.split()))


def on_this_machine(one: Exported, real: str, folder: Path) -> list[str]:
    """A table row: time per step and sizes."""
    times, (state, measurement, _) = run_here(one, real, PASSES, folder)
    took = f"{min(times):.0f} ns ({statistics.median(times):.0f} ns)"
    sizes = (code_size(real, one, folder), state, measurement)
    return [one.name, real, took, *(f"{size} B" for size in sizes)]


def code_size(real: str, one: Exported, folder: Path) -> int:
    """Bytes of the code and the constants of a step on this machine."""
    source, made = folder / "step.c", folder / "step.o"
    source.write_text(CODE_ONLY)
    options = ["-O2", f"-DPOSEGSA_REAL={real}", *one.options, "-I", str(folder)]
    compiled(str(compiler()), *options, "-c", str(source), "-o", str(made))
    return int(output("size", str(made)).splitlines()[1].split()[0])


def on_the_board(one: Exported, level: str, folder: Path) -> list[str]:
    """A table row: code and constants, stack, instructions per step, in float."""
    table = one.rows[:ON_TARGET, 1:].astype(np.float32)
    start = one.start.astype(np.float32)
    values = ",\n".join(", ".join(f"{x!r}f" for x in row) for row in table.tolist())
    quaternion, position = (
        ", ".join(f"{x!r}f" for x in part.tolist()) for part in (start[:4], start[4:])
    )
    (folder / "samples.h").write_text(
        f"enum {{ SAMPLES = {len(table)} }};\n"
        f"static const posegsa_real first_attitude[4] = {{{quaternion}}};\n"
        + (f"static const posegsa_real first_position[3] = {{{position}}};\n" if position else "")
        + f"static const union {{ posegsa_real numbers[{table.size}]; "
        f"posegsa_measurement each[SAMPLES]; }} taken = {{{{\n{values}}}}};\n"
        "#define samples taken.each\n"
    )
    options = [*M4F, level, "-std=gnu99", "-DPOSEGSA_REAL=float", *one.options, "-I", str(folder)]
    source, made = folder / "step.c", folder / "step.o"
    source.write_text(CODE_ONLY)
    compiled("arm-none-eabi-gcc", *options, "-fstack-usage", "-c", str(source), "-o", str(made))
    listed = output("arm-none-eabi-size", str(made)).splitlines()[1].split()
    code_and_constants = int(listed[0])
    used = (folder / "step.su").read_text().splitlines()
    stack = sum(int(line.split("\t")[1]) for line in used)
    elf = folder / "count.elf"
    compiled(
        *("arm-none-eabi-gcc", *options, "-nostartfiles", "-T", str(HERE / "mps2.ld")),
        *(str(HERE / "count_instructions.c"), "-o", str(elf), "-lm", "-lc"),
    )
    said = output(
        *("qemu-system-arm", "-M", "mps2-an386", "-nographic", "-icount", "shift=0"),
        *("-semihosting-config", "enable=on,target=native", "-kernel", str(elf)),
    )
    numbers = {name.strip(): int(n) for name, n in re.findall(r"(?m)^(.*?) (\d+)$", said)}
    if numbers["failed"]:
        raise RuntimeError(f"a step on the board was refused: {said}")
    part = replace(one, rows=one.rows[:ON_TARGET])
    _, (*_, attitude) = run_here(part, "float", PASSES_ON_TARGET, folder)
    if abs(numbers["attitude"] - attitude) > 1000:
        raise RuntimeError(f"the board's w is {numbers['attitude']}e-6, here it is {attitude}e-6")
    a_tick = numbers["instructions of the loop"] / numbers["ticks of the loop"]
    ticks = numbers["ticks of the steps"] - numbers["ticks without them"]
    instructions = a_tick * ticks / numbers["steps"]
    return [one.name, level, f"{code_and_constants} B", f"{stack} B", f"{instructions:.0f}"]


def compiled(*command: str) -> None:
    """Run a compiler.

    Raises:
        CalledProcessError: The compiler failed.
    """
    subprocess.run(command, check=True)


def output(*command: str) -> str:
    """Output of a program, stdout and stderr together."""
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=300)
    return done.stdout + done.stderr


def markdown(head: list[str], lines: list[list[str]]) -> str:
    """A Markdown table."""
    rule = ["---", "---", *["--:"] * (len(head) - 2)]
    return "\n".join(f"| {' | '.join(line)} |" for line in [head, rule, *lines])


def tables() -> str:
    """All measurements as Markdown."""
    filters = exported()
    here, board = [], []
    emulated = all(map(shutil.which, ("arm-none-eabi-gcc", "qemu-system-arm")))
    for one in filters:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "posegsa.h").write_text(one.header)
            here += [on_this_machine(one, real, folder) for real in ("float", "double")]
            if emulated:
                board += [on_the_board(one, level, folder) for level in ("-O2", "-Os")]
    about = machine(version("jax"), 1, "")
    parts = [
        markdown(["filter", "type", "a step, best (median)", "code", "state", "measurement"], here),
        f"{about['cpu']}, one core, {about['compiler']} -O2; {len(filters[0].rows)} samples, "
        f"{PASSES} passes; {about['date']}.",
    ]
    if board:
        head = [
            "filter",
            "Cortex-M4F",
            "code and constants",
            "stack, at most",
            "instructions a step",
        ]
        said = output("arm-none-eabi-gcc", "--version").splitlines()[0]
        parts += [
            markdown(head, board),
            f"In float, {said}; counted by {output('qemu-system-arm', '--version').splitlines()[0]}"
            " (mps2-an386, `-icount shift=0`, SysTick).",
        ]
    parts.append("By `python benchmarks/c_filter.py --write`.")
    return "\n\n".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description="What the exported filter costs.")
    parser.add_argument("--write", action="store_true", help="write the tables to docs/export.md")
    options = parser.parse_args()
    warnings.simplefilter("ignore", posegsa.PosegsaWarning)
    posegsa.enable_fast_path()
    text = tables()
    print(text)
    if options.write:
        write_block("c-filter", text, "docs/export.md")


if __name__ == "__main__":
    main()
