"""Profile a step of the time loop: kernels, bytes, operations and instructions.

Reads XLA's output for one population: the optimised HLO of the loop over samples and, if objdump is
installed, the machine code of its kernel, compared with that of C.

    python benchmarks/profile_rollout.py [--agents 100] [--write]

With --write the table goes into docs/benchmarks.md, the numbers to benchmarks/profile_rollout.json.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from contenders import c
from contenders.posegsa_worker import parameter_vectors, task_of
from readme import write_block
from run_tables import number

from posegsa.runtime import fast_path_flags
from posegsa.search.population import evaluate_population

JSON = Path(__file__).with_suffix(".json")
SAMPLES = 1500
FREE = {"parameter", "get-tuple-element", "tuple", "constant", "bitcast", "after-all"}
"""Instructions that compute nothing."""
ARITHMETIC = {
    *("add", "subtract", "multiply", "divide", "minimum", "maximum", "negate", "abs", "clamp"),
    *("sqrt", "rsqrt", "sine", "cosine", "exponential", "power", "compare", "select"),
}
BYTES = {"f64": 8, "s64": 8, "u64": 8, "f32": 4, "s32": 4, "u32": 4, "pred": 1}

_INSTRUCTION = re.compile(r"^\s+(?:ROOT )?%?([\w.-]+) = (\(.*?\)|\S+) ([\w-]+)\((.*)$")
_SHAPE = re.compile(r"([a-z]+\d*)\[([\d,]*)\]")


class Instruction(NamedTuple):
    """One line of HLO."""

    name: str
    shape: str
    opcode: str
    rest: str


class Loop(NamedTuple):
    """An innermost loop of machine code."""

    instructions: int
    lanes: int
    """Floats in the widest vectors that it uses; 1 for scalar code."""
    counts: Counter[str]


def computations(hlo: str) -> dict[str, list[Instruction]]:
    """The computations of a module by name."""
    found: dict[str, list[Instruction]] = {}
    current: list[Instruction] = []
    for line in hlo.splitlines():
        if line.endswith("{") and not line.startswith(" "):
            name = line.removeprefix("ENTRY ").split()[0].lstrip("%")
            current = found.setdefault(name, [])
        elif match := _INSTRUCTION.match(line):
            current.append(Instruction(*match.groups()))
    return found


def elements(shape: str) -> int:
    """Number of elements in the first array of a shape."""
    match = _SHAPE.search(shape)
    if match is None:
        return 0
    size = 1
    for dimension in filter(None, match[2].split(",")):
        size *= int(dimension)
    return size


def step_bytes(shape: str) -> int:
    """Bytes of a shape that one step accesses; of arrays over all samples, one sample."""
    total = 0
    for kind, dimensions in _SHAPE.findall(shape):
        size = BYTES.get(kind, 4)
        for dimension in filter(None, dimensions.split(",")):
            size *= 1 if int(dimension) == SAMPLES else int(dimension)
        total += size
    return total


def time_loop(modules: dict[str, list[Instruction]]) -> list[Instruction]:
    """The body of the loop over samples: the loop with the most instructions.

    Raises:
        RuntimeError: There is no loop.
    """
    bodies = [
        modules[match[1]]
        for instructions in modules.values()
        for one in instructions
        if one.opcode == "while" and (match := re.search(r"body=%?([\w.-]+)", one.rest))
    ]
    if not bodies:
        raise RuntimeError("the compiled population has no loop")
    return max(bodies, key=len)


def operations(
    instructions: list[Instruction], modules: dict[str, list[Instruction]], agents: int
) -> Counter[str]:
    """Arithmetic per agent and pass, by opcode; repeated for each kernel that computes it."""
    found: Counter[str] = Counter()
    for one in instructions:
        if one.opcode in ("fusion", "call", "map") and (
            match := re.search(r"(?:calls|to_apply)=%?([\w.-]+)", one.rest)
        ):
            found += operations(modules[match[1]], modules, agents)
        elif one.opcode in ARITHMETIC and elements(one.shape) >= agents:
            found[one.opcode] += elements(one.shape) // agents
    return found


def of_hlo(hlo: str, agents: int) -> dict[str, Any]:
    """Kernels, bytes and operations of a step."""
    modules = computations(hlo)
    body = time_loop(modules)
    shapes = {one.name: one.shape for one in body}
    kernels = [one for one in body if one.opcode not in FREE]
    read = sum(
        step_bytes(shapes[name])
        for one in kernels
        for name in re.findall(r"%?([\w.-]+)", one.rest.split(")")[0])
        if name in shapes
    )
    done = operations(body, modules, agents)
    return {
        "kernels": len(kernels),
        "kernels_over_agents": sum(elements(one.shape) >= agents for one in kernels),
        "bytes_read": read,
        "bytes_written": sum(step_bytes(one.shape) for one in kernels),
        "operations_per_agent": sum(done.values()),
        "by_opcode": dict(done.most_common()),
    }


def innermost_loops(library: Path) -> Iterator[Loop]:
    """The innermost loops of an object file, by objdump."""
    said = subprocess.run(
        ["objdump", "-d", "--no-show-raw-insn", str(library)],
        capture_output=True,
        text=True,
        check=True,
    )
    lines = re.findall(r"^\s+([0-9a-f]+):\s+(\S+)\s*(.*)$", said.stdout, re.MULTILINE)
    position = {int(address, 16): i for i, (address, _, _) in enumerate(lines)}
    spans = []
    for i, (_, operation, argument) in enumerate(lines):
        target = re.match(r"([0-9a-f]+)", argument)
        start = position.get(int(target[1], 16)) if operation.startswith("j") and target else None
        if start is not None and start <= i:
            spans.append((start, i))
    for start, end in spans:
        if any(s >= start and e <= end and (s, e) != (start, end) for s, e in spans):
            continue
        body = lines[start : end + 1]
        text = " ".join(argument for _, _, argument in body)
        packed = any(operation.startswith("v") and "ps" in operation for _, operation, _ in body)
        lanes = 1 if not packed else 16 if "zmm" in text else 8 if "ymm" in text else 4
        counts = Counter(operation for _, operation, _ in body)
        counts["memory"] = sum("(" in a and o.startswith("v") for _, o, a in body)
        yield Loop(len(body), lanes, counts)


def of_object(library: Path) -> dict[str, Any]:
    """Innermost loops of a kernel; instructions per agent if each loop runs once per step."""
    loops = [loop for loop in innermost_loops(library) if loop.instructions > 20]
    vector = [loop for loop in loops if loop.lanes >= 8]
    return {
        "vector_loops": len(vector),
        "scalar_loops": len(loops) - len(vector),
        "lanes": max((loop.lanes for loop in vector), default=1),
        "vector_instructions": sum(loop.instructions for loop in vector),
        "vector_instructions_per_agent": sum(loop.instructions / loop.lanes for loop in vector),
        "memory_operands": sum(loop.counts["memory"] for loop in vector),
    }


def of_c(folder: Path) -> dict[str, Any] | None:
    """The same for C's loop over blocks, for the paper's terms with the gain limit."""
    try:
        library = c.build(folder)
    except RuntimeError:
        return None
    # There are four variants. Those without the limit round angles to whole turns; of the other
    # two, the one without far pairs is shorter.
    limited = [
        loop
        for loop in innermost_loops(library)
        if loop.counts["vmaxps"] > 10
        and not any("rndscale" in name or "round" in name for name in loop.counts)
    ]
    if not limited:
        return None
    step = min(limited, key=lambda loop: loop.instructions)
    return {
        "vector_loops": 1,
        "scalar_loops": 0,
        "lanes": step.lanes,
        "vector_instructions": step.instructions,
        "vector_instructions_per_agent": step.instructions / step.lanes,
        "memory_operands": step.counts["memory"],
    }


def report(found: dict[str, Any], agents: int) -> str:
    """The numbers as Markdown."""
    hlo = found["hlo"]
    most = ", ".join(f"{name} {count}" for name, count in list(hlo["by_opcode"].items())[:6])
    lines = [
        "| of one time step | posegsa | C |",
        "| --- | --: | --: |",
        f"| kernels (HLO) | {hlo['kernels']}, over agents {hlo['kernels_over_agents']} | 1 |",
        f"| bytes read, by HLO's operands, per agent | {number(hlo['bytes_read'] / agents)} | - |",
        f"| bytes written per agent | {number(hlo['bytes_written'] / agents)} | - |",
        f"| arithmetic operations per agent | {hlo['operations_per_agent']} ({most}) | - |",
    ]
    if found.get("object"):
        of = [found["object"], found["c"] or {}]
        for label, key in (
            ("vectorised innermost loops", "vector_loops"),
            ("scalar ones of over 20 instructions", "scalar_loops"),
            ("floats in a vector", "lanes"),
            ("instructions in the vectorised loops", "vector_instructions"),
            ("the same per agent", "vector_instructions_per_agent"),
            ("of these with an operand in memory", "memory_operands"),
        ):
            cells = [number(o[key]) if key in o else "-" for o in of]
            lines.append(f"| {label} | {cells[0]} | {cells[1]} |")
    lines += [
        "",
        f"{agents} agents, float32, the paper's scenario, one device. A loop that LLVM vectorises "
        "leaves a scalar one for the agents that do not fill a vector; an operation that several "
        "kernels repeat is counted each time. Made by `python benchmarks/profile_rollout.py"
        f" --agents {agents} --write`.",
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="Profile of the loop over samples.")
    parser.add_argument("--agents", type=int, default=100)
    parser.add_argument("--write", action="store_true", help="write docs/benchmarks.md and JSON")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        dump = f"{os.environ.get('XLA_FLAGS', '')} --xla_dump_to={folder} --xla_dump_hlo_as_text"
        os.environ["XLA_FLAGS"] = fast_path_flags(dump)
        task = task_of("float32")
        vectors = parameter_vectors(task, options.agents)
        compiled = evaluate_population.lower(vectors, task.training, task.space).compile()
        found: dict[str, Any] = {"hlo": of_hlo(compiled.as_text() or "", options.agents)}
        objects = sorted(
            folder.glob("*population_costs*.o"), key=lambda path: path.stat().st_size, reverse=True
        )
        if objects and shutil.which("objdump"):
            found |= {"object": of_object(objects[0]), "c": of_c(folder)}
    print(report(found, options.agents))
    if options.write:
        write_block("profile", report(found, options.agents), "docs/benchmarks.md")
        JSON.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
