"""What tuning gives on unseen noise: the result table of the README.

Tunes each configuration for several seeds, by the gravitational search and by random search at the
same number of evaluations, and judges every result, and the best constant gain, on held-out noise.

    python benchmarks/results.py [--seeds 5] [--readme]
"""

import argparse
import warnings
from pathlib import Path

import numpy as np
from tqdm import tqdm

import posegsa
from posegsa import config
from posegsa.evaluate import Score
from posegsa.runtime import environment

ROOT = Path(__file__).parent.parent
CONFIGS = ("recommended", "paper", "paper_literal")
SEARCHES = {"gsa": "fuzzy gain, GSA", "random_search": "fuzzy gain, random search"}
BEGIN, END = "<!-- results: begin -->", "<!-- results: end -->"


def scores(name: str, seeds: int) -> tuple[dict[str, list[Score]], float]:
    """Scores of each contender for each seed, and the median time of a gravitational search [s]."""
    experiment = config.load(ROOT / "configs" / f"{name}.toml")
    found: dict[str, list[Score]] = {label: [] for label in (*SEARCHES.values(), "constant gain")}
    seconds = []
    for seed in range(seeds):
        for search, label in SEARCHES.items():
            one = config.override(experiment, [f"search.optimiser={search}", f"run.seed={seed}"])
            result = posegsa.tune(one)
            found[label].append(result.judged.tuned)
            if search == "gsa":
                found["constant gain"].append(result.judged.constant)
                seconds.append(result.search_seconds)
    return found, float(np.median(seconds))


def spread(values: list[float]) -> str:
    """Median and range over seeds; `inf` where a filter diverged."""
    if not np.isfinite(values).all():
        return f"{min(values):.4g} to {max(values):.4g}"
    return f"{np.median(values):.1f} ({min(values):.1f} to {max(values):.1f})"


def table(seeds: int) -> str:
    """The table in Markdown."""
    lines = [
        "| configuration | schedule | training cost | held-out cost | worst held out | diverged |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    times = []
    for name in tqdm(CONFIGS, desc="configurations"):
        found, seconds = scores(name, seeds)
        times.append(f"{name} {seconds:.2f} s")
        for label, each in found.items():
            held_out = np.concatenate([s.held_out for s in each])
            lines.append(
                f"| {name} | {label} | {spread([float(np.mean(s.training)) for s in each])} "
                f"| {spread([float(np.mean(s.held_out)) for s in each])} | {held_out.max():.4g} "
                f"| {int(np.sum(~np.isfinite(held_out)))} of {held_out.size} |"
            )
    machine = environment()
    lines += [
        "",
        f"Median (least to largest) over {seeds} seeds, each judged on noise seeds of its own that "
        "the search never saw; lower is better. Search time, compiled: "
        + ", ".join(times)
        + f" ({machine['device']}, jax {machine['jax']}). Made by "
        f"`python benchmarks/results.py --seeds {seeds} --readme`.",
    ]
    return "\n".join(lines)


def write_readme(text: str) -> None:
    """Put the table between its marks in the README."""
    readme = ROOT / "README.md"
    before, rest = readme.read_text(encoding="utf-8").split(BEGIN)
    _, after = rest.split(END)
    readme.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description="Result table of the README.")
    parser.add_argument("--seeds", type=int, default=5, help="seeds for each contender")
    parser.add_argument("--readme", action="store_true", help="write the table into README.md")
    options = parser.parse_args()
    warnings.simplefilter("ignore", posegsa.PosegsaWarning)
    posegsa.enable_fast_path()
    text = table(options.seeds)
    print(text)
    if options.readme:
        write_readme(text)


if __name__ == "__main__":
    main()
