"""What an experiment needs of memory, estimated before anything is allocated."""

from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from posegsa import config
from posegsa.errors import MemoryLimitError
from posegsa.settings.fields import MAX_SAMPLES
from posegsa.settings.violations import Violation, violations_error

COMPILER = 2**29
"""What JAX and its compiler take, whatever the experiment [bytes]."""
RECORDINGS = "recordings"
"""What the share of recordings is called."""
PER_AGENT = 100
"""Numbers that one agent's simulation keeps on one scenario; measured: 92."""

MEMINFO = Path("/proc/meminfo")
CGROUP = Path("/sys/fs/cgroup")


class RecordedSize(NamedTuple):
    """How much of recordings is simulated at once: all are as long as the longest."""

    count: int
    samples: int
    """Of the longest."""
    vectors: int
    """The most that one of them has."""
    landmarks: int
    """Likewise."""


def needs(
    experiment: config.Experiment,
    held_out: int | None = None,
    recorded: RecordedSize | None = None,
) -> dict[str, int]:
    """Estimated bytes, by the values that cause them.

    `held_out` replaces its own scenarios. With recordings these are simulated, and its scenarios
    only beside them.
    """
    if recorded is not None:
        return _needs_recorded(experiment, recorded)
    run, scenario, search = experiment.run, experiment.scenario, experiment.search
    size = np.dtype(run.dtype).itemsize
    held_out = run.held_out_scenarios if held_out is None else held_out
    training, samples = run.training_scenarios, scenario.samples
    vectors = len(scenario.vectors) + experiment.filter.cross_vector
    landmarks = len(scenario.landmarks)
    # Truth, measurements and what the loop reads of them; once more, at both precisions, of the
    # training scenarios, on which the result's sensitivity is checked.
    prepared = 27 + 8 * landmarks
    per_scenario = samples * (prepared + 25 + 7 * (vectors + landmarks))
    points = experiment.fuzzy.sampled_points if experiment.fuzzy.centroid == "sampled" else 0
    per_agent = training * (PER_AGENT + points) + 22 * 10
    return {
        "run.held_out_scenarios": held_out * per_scenario * size,
        "run.training_scenarios": training
        * (per_scenario * (size + 8) + samples * prepared * size),
        "run.endurance_scenarios": run.endurance_scenarios
        * min(run.endurance_times * samples, MAX_SAMPLES)
        * (per_scenario // samples)
        * size,
        "search.agents": search.agents * per_agent * size,
        "search.iterations": search.total_iterations * (3 * size + 4 + 3 * 8),
    }


def _needs_recorded(experiment: config.Experiment, recorded: RecordedSize) -> dict[str, int]:
    shares = needs(experiment)
    for name in ("run.training_scenarios", "run.endurance_scenarios", "run.held_out_scenarios"):
        if name == "run.endurance_scenarios" or not experiment.objective.simulated_share:
            del shares[name]
    size = np.dtype(experiment.run.dtype).itemsize
    vectors = recorded.vectors + experiment.filter.cross_vector
    # What is measured, the truth and what counts, filled up and joined in NumPy's float64; the same
    # at the run's precision, and what the loop reads of it.
    given = 20 + 7 * recorded.vectors + 7 * recorded.landmarks
    read = 25 + 7 * (vectors + recorded.landmarks) + 8 * recorded.landmarks
    per_sample = 2 * 8 * given + size * (given + 2 * read)
    return shares | {RECORDINGS: recorded.count * recorded.samples * per_sample}


def check(
    experiments: Iterable[config.Experiment],
    held_out: int | None = None,
    recorded: RecordedSize | None = None,
) -> None:
    """Refuse experiments, all held at once, that would need more memory than there is.

    Raises:
        MemoryLimitError: They would; it names the values and their share.
    """
    many = list(experiments)
    shares = Counter[str]()
    for one in many:
        shares.update(needs(one, held_out, recorded))
    total, there = COMPILER + sum(shares.values()), available()
    if there is None or total <= there:
        return
    violations = []
    for key, share in shares.most_common():
        if share > total / 20 and recorded is not None and key == RECORDINGS:
            reason = (
                f"takes {_gib(share)}, as each is filled up to the {recorded.samples} samples of "
                "the longest; allowed: fewer, or windows of them"
            )
            violations.append(Violation(key, reason, recorded.count))
        elif share > total / 20:
            section, name = key.split(".")
            value = getattr(getattr(many[0], section), name)
            if key == "run.held_out_scenarios" and held_out is not None:
                key, value = "scenarios", held_out
            reason = f"takes {_gib(share)}"
            if "scenarios" in key:
                reason += f", with {many[0].scenario.samples} samples (scenario.duration) in each"
            if "endurance" in key:
                reason += f", times {many[0].run.endurance_times} (run.endurance_times)"
            violations.append(Violation(key, reason, value))
    several = f"{len(many)} experiments" if len(many) > 1 else "the experiment"
    title = (
        f"{several} would need about {_gib(total)} of memory; allowed: {_gib(there)}, what is free"
    )
    raise MemoryLimitError(str(violations_error(title, violations)))


def available() -> int | None:
    """Bytes that are free where simulations run; None where the system doesn't say."""
    device = jax.local_devices()[0]
    if device.platform != "cpu":
        stats = device.memory_stats() or {}
        if "bytes_limit" in stats:
            return int(stats["bytes_limit"]) - int(stats.get("bytes_in_use", 0))
    found = []
    with suppress(OSError, ValueError):
        found.append(1024 * _entry(MEMINFO, "MemAvailable:"))
    with suppress(OSError, ValueError):  # "max" is no number: no limit
        limit = int((CGROUP / "memory.max").read_text("ascii"))
        used = int((CGROUP / "memory.current").read_text("ascii"))
        with suppress(OSError, ValueError):
            # Files that nobody has read for a while: the system drops them where memory is short.
            used -= _entry(CGROUP / "memory.stat", "inactive_file")
        found.append(limit - used)
    return min(found, default=None)


def _entry(path: Path, name: str) -> int:
    """A number from a file of the system's with a name and a number in each line."""
    for line in path.read_text("ascii").splitlines():
        words = line.split()
        if len(words) > 1 and words[0] == name:
            return int(words[1])
    raise ValueError(f"{path}: has no {name}")


def _gib(size: int) -> str:
    return f"{size / 2**30:.3g} GiB"
