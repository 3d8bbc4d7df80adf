"""Cost of attitude filters in C on one trial of BROAD: posegsa's, VQF, Madgwick's, Mahony's.

All are compiled with the same options and run on the same samples: posegsa's header as `posegsa
export imu` writes it, VQF's own C++ (from the package `vqf`), and the filters of Madgwick and of
Mahony written from their papers (`benchmarks/attitude`). Printed for each:

1. on this machine, nanoseconds of CPU a sample with -O2 and with -O3: best and median of many
   passes over the trial, in turns; bytes of code and of state; the total RMSE on the trial;
2. on a Cortex-M4F, emulated by QEMU, instructions a sample, and code. In single precision VQF
   still filters the acceleration in double precision, which a Cortex-M4F computes in software.
   Needs gcc-arm-none-eabi, libstdc++-arm-none-eabi-newlib and qemu-system-arm; without them this
   part is left out.

    python benchmarks/attitude_in_c.py TRIAL.mat [--write]
"""

import argparse
import re
import shutil
import statistics
import subprocess
import tempfile
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from c_filter import M4F, compiled, markdown, output
from contenders.c import compiler
from machine import machine
from readme import write_block

import posegsa
from posegsa.recordings.accuracy import attitude_errors, rmse
from posegsa.recordings.recording import Recording
from posegsa.recordings.rotations import matrices

HERE = Path(__file__).parent / "attitude"
LINKED = Path(__file__).parent / "on_target" / "mps2.ld"
PASSES, TURNS = 5, 8
"""Passes over the trial in a run, and runs of each program, in turns with the others."""
LEVELS = "-O2", "-O3"
"""Optimisation, on this machine."""
ON_TARGET = 1000
"""Samples for the emulated board, from the middle of the trial."""
TOLD = 0.02
"""Largest difference of w on the board and here: the board has other libraries."""


@dataclass(frozen=True)
class Contender:
    """An attitude filter in C or C++."""

    name: str
    number: int
    """In `attitude_filter.h`."""
    real: str
    """Its type."""

    @property
    def in_cpp(self) -> bool:
        """Whether it is VQF, in C++."""
        return self.number == 2

    def options(self, folder: Path) -> list[str]:
        """Preprocessor options, with the exported header in `folder`."""
        single = ["-DVQF_SINGLE_PRECISION"] if self.in_cpp and self.real == "float" else []
        names = [f"-DFILTER={self.number}", f"-DREAL={self.real}", f"-DPOSEGSA_REAL={self.real}"]
        folders = (folder, HERE, LINKED.parent, vqf_sources())
        return [*names, *single, *(f"-I{each}" for each in folders)]

    def sources(self) -> list[str]:
        """Other files that it needs."""
        return [str(vqf_sources() / "vqf.cpp")] if self.in_cpp else []


CONTENDERS = [
    Contender("posegsa", 1, "float"),
    Contender("posegsa", 1, "double"),
    Contender("VQF", 2, "float"),
    Contender("VQF", 2, "double"),
    Contender("Madgwick", 3, "float"),
    Contender("Mahony", 4, "float"),
]


def vqf_sources() -> Path:
    """The folder of VQF's C++, in its package."""
    found = find_spec("vqf")
    if found is None or found.origin is None:
        raise SystemExit("needs the package vqf")
    return Path(found.origin).parent / "cpp"


def samples_of(recording: Recording) -> np.ndarray:
    """(N, 9) gyr, acc and mag."""
    m = recording.measurements
    parts = (m.angular_velocity, m.vectors[:, 0], m.vectors[:, 1])
    return np.concatenate([np.asarray(part) for part in parts], axis=1)


def built(one: Contender, folder: Path, level: str = "-O2") -> Path:
    """The program that times a filter on this machine."""
    program = folder / f"{one.name}-{one.real}{level}"
    language = ["g++", "-x", "c++"] if one.in_cpp else [str(compiler())]
    sources = [str(HERE / "time_samples.c"), *one.sources()]
    compiled(*language, level, *one.options(folder), *sources, "-o", str(program), "-lm")
    return program


def run_here(
    one: Contender, program: Path, step: float, samples: np.ndarray, passes: int
) -> tuple[list[float], int, np.ndarray]:
    """Nanoseconds a sample of each pass, bytes of state, attitudes (N, 4) of the first pass."""
    dtype = np.dtype({"float": np.float32, "double": np.float64}[one.real])
    given = np.concatenate([[step], samples.ravel()]).astype(dtype).tobytes()
    file = program.with_suffix(".q")
    command = [program, str(len(samples)), str(passes), file]
    done = subprocess.run(command, input=given, capture_output=True, check=True)
    *times, size = done.stdout.decode().split()
    return list(map(float, times)), int(size), np.fromfile(file, dtype).reshape(-1, 4)


def code_size(one: Contender, folder: Path, tool: str, *options: str) -> int:
    """Bytes of code and constants of a filter: of what has no driver around it."""
    source, total = folder / "step.c", 0
    begin_it = "int begin_it(filter_state *f, real dt, const real *acc, const real *mag)"
    arguments = "filter_state *f, const real *gyr, const real *acc, const real *mag"
    source.write_text(
        '#include "attitude_filter.h"\n'
        f"{begin_it};\n{begin_it}\n{{\n    return begin(f, dt, acc, mag);\n}}\n"
        "void attitude_of(filter_state *f, real *q);\n"
        "void attitude_of(filter_state *f, real *q)\n{\n    attitude(f, q);\n}\n"
        f"int one_step({arguments});\nint one_step({arguments})\n"
        "{\n    return step(f, gyr, acc, mag);\n}\n"
    )
    for file in (str(source), *one.sources()):
        made = folder / "size.o"
        language = ["-x", "c++"] if one.in_cpp else []
        command = f"{tool}g++" if one.in_cpp else f"{tool}gcc"
        compiled(
            command, "-O2", *options, *one.options(folder), *language, "-c", file, "-o", str(made)
        )
        total += int(output(f"{tool}size", str(made)).splitlines()[1].split()[0])
    return total


def on_the_board(one: Contender, step: float, samples: np.ndarray, folder: Path) -> list[str]:
    """A table row: code and constants, instructions a sample, in float."""
    part = samples[len(samples) // 2 :][:ON_TARGET].astype(np.float32)
    rows = ",\n".join("{" + ", ".join(f"{x!r}f" for x in row) + "}" for row in part.tolist())
    (folder / "samples.h").write_text(
        f"enum {{ SAMPLES = {len(part)} }};\nstatic const real time_step = {step!r}f;\n"
        f"static const real samples[SAMPLES][9] = {{\n{rows}\n}};\n"
    )
    tool = "arm-none-eabi-"
    common = [*M4F, "-O2", *one.options(folder)]
    elf = folder / "count.elf"
    language = [f"{tool}g++", "-fno-exceptions", "-fno-rtti"] if one.in_cpp else [f"{tool}gcc"]
    compiled(
        *(*language, *common, "-nostartfiles", "-T", str(LINKED)),
        *(["-x", "c++"] if one.in_cpp else ["-std=gnu99"]),
        *(str(HERE / "count_instructions.c"), *one.sources()),
        *("-o", str(elf), "-lm", "-lc", "-specs=nosys.specs"),
    )
    said = output(
        *("qemu-system-arm", "-M", "mps2-an386", "-nographic", "-icount", "shift=0"),
        *("-semihosting-config", "enable=on,target=native", "-kernel", str(elf)),
    )
    numbers = {name.strip(): int(n) for name, n in re.findall(r"(?m)^(.*?) (\d+)$", said)}
    if numbers["failed"]:
        raise RuntimeError(f"a step on the board was refused: {said}")
    program = built(one, folder)
    _, _, q = run_here(one, program, step, np.tile(part, (4, 1)), 0)
    if abs(numbers["attitude"] / 1e6 - abs(float(q[-1, 0]))) > TOLD:
        raise RuntimeError(f"the board's w is {numbers['attitude']}e-6, here it is {q[-1, 0]}")
    a_tick = numbers["instructions of the loop"] / numbers["ticks of the loop"]
    ticks = numbers["ticks of the steps"] - numbers["ticks without them"]
    size = code_size(one, folder, tool, *M4F)
    return [one.name, one.real, f"{a_tick * ticks / numbers['steps']:.0f}", f"{size} B"]


def tables(path: Path) -> str:
    """All measurements as Markdown."""
    recording = posegsa.as_imu(Recording.from_broad(path))
    samples, step = samples_of(recording), recording.time_step
    assert recording.truth is not None
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "posegsa.h").write_text(posegsa.export_c(posegsa.configured("imu")))
        runs = [(one, level, built(one, folder, level)) for one in CONTENDERS for level in LEVELS]
        times: dict[tuple[Contender, str], list[float]] = {run[:2]: [] for run in runs}
        ends = {}
        for _ in range(TURNS):
            for one, level, program in runs:
                took, size, q = run_here(one, program, step, samples, PASSES)
                times[one, level] += took
                errors = attitude_errors(matrices(q.astype(float)), recording.truth.rotation)
                ends[one] = [f"{size} B", f"{rmse(errors[0], recording.judged):.2f} deg"]
        here = [
            [
                *(one.name, one.real),
                *(f"{min(t):.0f} ns ({statistics.median(t):.0f} ns)" for t in took),
                *(f"{code_size(one, folder, '')} B", *ends[one]),
            ]
            for one in CONTENDERS
            for took in [[times[one, level] for level in LEVELS]]
        ]
        single = [one for one in CONTENDERS if one.real == "float"]
        emulated = all(map(shutil.which, ("arm-none-eabi-g++", "qemu-system-arm")))
        board = [on_the_board(one, step, samples, folder) for one in single if emulated]
    about = machine(version("jax"), 1, "")
    levels = [f"a sample, {level}: best (median)" for level in LEVELS]
    head = ["filter", "type", *levels, "code, -O2", "state", "total RMSE"]
    parts = [
        markdown(head, here),
        f"Trial {path.stem}, {len(samples)} samples; {about['cpu']}, one core, "
        f"{about['compiler']}, VQF {version('vqf')}; {about['date']}. The code of VQF is that "
        "of all its functions.",
    ]
    if board:
        said = output("arm-none-eabi-gcc", "--version").splitlines()[0]
        parts += [
            markdown(["Cortex-M4F", "type", "instructions a sample", "code"], board),
            f"{said} -O2; counted by {output('qemu-system-arm', '--version').splitlines()[0]}, "
            f"{ON_TARGET} samples of the trial. VQF's acceleration is filtered in double precision "
            "in both types.",
        ]
    parts.append("By `python benchmarks/attitude_in_c.py TRIAL.mat --write`.")
    return "\n\n".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description="What attitude filters cost in C.")
    parser.add_argument("trial", type=Path, help="a trial of BROAD (.mat)")
    parser.add_argument("--write", action="store_true", help="write the tables to docs/imu.md")
    options = parser.parse_args()
    text = tables(options.trial)
    print(text)
    if options.write:
        write_block("imu-c", text, "docs/imu.md")


if __name__ == "__main__":
    main()
