"""Results of `run.py` as tables and as a figure."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure

from posegsa.figures.style import BLUE, GREEN, PURPLE, VERMILION, WIDTH, style_ticks, styled

SAMPLES = 1500
"""Time steps of the paper's scenario."""
C, POSEGSA = "C, hand-vectorised", "posegsa"
NUMPY, NUMBA = "NumPy, vectorised over agents", "Numba, parallel"
LIMITLESS, AVX2 = "without gain limit", "AVX2"
OBSERVER = "configuration of observer.toml"
"""Label after a contender's name for rows with another configuration."""


@dataclass(frozen=True)
class Row:
    """A contender with one number of agents."""

    contender: str
    threads: int
    agents: int = 100
    scenarios: int = 1
    dtype: str = "float64"
    best: float | None = None
    """Best time of one population [s]; None if it was not timed."""
    median: float | None = None
    c_best: float | None = None
    """C's best time of the same with as many threads, in the same run [s]."""
    difference: float | None = None
    """Largest relative difference of a checked cost from posegsa's; None for posegsa itself."""
    note: str = ""
    samples: int = SAMPLES
    """Time steps of a simulation."""

    @property
    def steps(self) -> int:
        """Agent-steps in one population."""
        return self.agents * self.scenarios * self.samples

    @property
    def nanoseconds(self) -> float | None:
        """Per agent and step [ns]."""
        return None if self.best is None else 1e9 * self.best / self.steps

    @property
    def apart(self) -> bool:
        """Whether the row has another computation than the others, or narrower vectors."""
        return self.contender.endswith((LIMITLESS, AVX2, OBSERVER))

    @property
    def ratio(self) -> float | None:
        """Ratio to C's time."""
        return None if self.best is None or not self.c_best else self.best / self.c_best


def number(value: float) -> str:
    """A number with three significant digits, or all digits before the point."""
    return f"{value:,.0f}".replace(",", " ") if value >= 100 else f"{value:.3g}"


def duration(seconds: float) -> str:
    """A time with its unit."""
    for unit, size in (("h", 3600), ("min", 60), ("s", 1)):
        if seconds >= size:
            return f"{number(seconds / size)} {unit}"
    return f"{number(1e3 * seconds)} ms"


def table(rows: Sequence[Row]) -> str:
    """Rows as a Markdown table."""
    lines = [
        "| contender | threads | agents | scenarios | precision | one population, best (median) "
        "| ns per agent and step | times C | costs differ by | |",
        "| --- | --: | --: | --: | --- | --: | --: | --: | --: | --- |",
    ]
    for row in rows:
        time = ns = ratio = difference = "-"
        if row.best is not None and row.nanoseconds is not None:
            time, ns = duration(row.best), number(row.nanoseconds)
            time += f" ({duration(row.median)})" if row.median is not None else ""
        if row.ratio is not None:
            ratio = number(row.ratio)
        if row.difference is not None:
            difference = f"{row.difference:.0e}"
        cells = (row.contender, row.threads, row.agents, row.scenarios, row.dtype, time, ns, ratio)
        lines.append("| " + " | ".join(map(str, (*cells, difference, row.note))) + " |")
    return "\n".join(lines)


def sentences(facts: dict[str, Any]) -> list[str]:
    """Sentences on compilation, search and memory."""
    lines: list[str] = []
    if not facts["warm"]:
        return lines
    for devices, search in facts["search"].items():
        share = search["optimiser_best"] / search["best"]
        update = 1e3 * search["optimiser_best"] / search["iterations"]
        cores = "one core" if devices == "1" else f"{devices} cores"
        lines.append(
            f"Whole paper run, {search['agents']} agents x {search['iterations']} iterations, "
            f"{cores}: {search['best']:.2f} s (best; median {search['median']:.2f} s) once "
            f"compiled. The optimiser's step alone: {update:.2f} ms an iteration, "
            f"{100 * share:.0f} % of that."
        )
    cold, warm = facts["cold"], facts["warm"]
    lines.append(
        f"First call, compiling included: population {cold['first_seconds']:.1f} s, search "
        f"{cold['compile_seconds']:.1f} s; in a second process, from the compilation cache, "
        f"{warm['first_seconds']:.2f} s and {warm['compile_seconds']:.2f} s."
    )
    sizes = ", ".join(
        f"{number(peak / 2**20)} MiB with {int(agents):,} agents".replace(",", " ")
        for agents, peak in facts["memory"].items()
    )
    lines.append(f"Peak memory of the process, JAX and its compiler included: {sizes}.")
    return lines


def machine_line(machine: dict[str, str]) -> str:
    """The machine in one sentence."""
    return (
        f"{machine['cpu']}, {machine['cores']} cores; {machine['compiler']}; jax {machine['jax']}, "
        f"NumPy {machine['numpy']}, Python {machine['python']}; load before {machine['load']}; "
        f"{machine['date']}."
    )


def overview(rows: Sequence[Row]) -> str:
    """The README's table: one population of 100 agents, each contender with all its threads."""
    base = [row for row in rows if row.agents == 100 and row.scenarios == 1 and not row.apart]
    lines = [
        "| a population of 100 agents, 15 s each | threads | time | times C |",
        "| --- | --: | --: | --: |",
    ]
    for name in dict.fromkeys(row.contender for row in base):
        # In the fastest precision of each contender: float32 for posegsa and C.
        own = [row for row in base if row.contender == name and row.best is not None]
        if own:
            best = min(own, key=lambda row: row.best or 0.0)
            ratio = "-" if best.ratio is None else number(best.ratio)
            lines.append(f"| {name} | {best.threads} | {duration(best.best or 0.0)} | {ratio} |")
    return "\n".join(lines)


@styled
def scaling(rows: Sequence[Row]) -> Figure:
    """Time of a population over the number of agents; C as a line, for reference."""
    figure = Figure(figsize=(WIDTH, 3.8), layout="constrained")
    ax = figure.subplots()
    style_ticks(ax)
    most = max(row.threads for row in rows)
    cores = "both cores" if most == 2 else f"{most} cores"
    curves: list[tuple[str, str, int, dict[str, Any]]] = [
        ("NumPy, one core", NUMPY, 1, {"color": PURPLE, "marker": "^"}),
        (f"Numba, {cores}", NUMBA, most, {"color": GREEN, "marker": "v"}),
        ("posegsa, one core", POSEGSA, 1, {"color": BLUE, "marker": "o", "linestyle": "--"}),
        (f"posegsa, {cores}", POSEGSA, most, {"color": BLUE, "marker": "o"}),
    ]
    for label, contender, threads, style in curves:
        points = sorted(
            (row.agents, 1e3 * row.best)
            for row in rows
            if (row.contender, row.threads, row.scenarios) == (contender, threads, 1)
            and row.best is not None
            and (contender != POSEGSA or row.dtype == "float32")
        )
        if points:
            ax.plot(*zip(*points, strict=True), label=label, markersize=5, **style)
    for label, threads, style in (("one core", 1, "--"), (cores, most, "-")):
        points = sorted(
            {
                row.agents: 1e3 * row.c_best
                for row in rows
                if (row.contender, row.threads, row.scenarios) == (POSEGSA, threads, 1)
                and row.dtype == "float32"
                and row.c_best is not None
            }.items()
        )
        if points:
            ax.plot(
                *zip(*points, strict=True),
                label=f"C, the limit, {label}",
                color=VERMILION,
                linestyle=style,
            )
    ax.set(xscale="log", yscale="log", xlabel="Agents [-]", ylabel="One population [ms]")
    ax.legend()
    return figure
