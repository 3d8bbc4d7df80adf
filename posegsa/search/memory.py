"""Estimate the memory that an experiment needs, before anything is allocated."""

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
"""Memory of JAX and its compiler, for any experiment [bytes]."""
RECORDINGS = "recordings"
"""Key of the share of recordings."""
PER_AGENT = 100
"""Numbers that one agent's simulation keeps on one scenario; measured: 92."""

MEMINFO = Path("/proc/meminfo")
CGROUP = Path("/sys/fs/cgroup")


class RecordedSize(NamedTuple):
    """The size of a batch of recordings, which are padded to the length of the longest."""

    count: int
    samples: int
    """Number of samples of the longest."""
    vectors: int
    """Largest number of vectors in a recording."""
    landmarks: int
    """Largest number of landmarks in a recording."""


def needs(
    experiment: config.Experiment,
    held_out: int | None = None,
    recorded: RecordedSize | None = None,
) -> dict[str, int]:
    """Estimated bytes, by the values that cause them.

    Args:
        experiment: The experiment.
        held_out: Number of held-out scenarios, instead of the experiment's.
        recorded: The recordings of a search on recordings. The experiment's scenarios then count
            only if the search also uses them.
    """
    if recorded is not None:
        return _needs_recorded(experiment, recorded)
    run, scenario, search = experiment.run, experiment.scenario, experiment.search
    size = np.dtype(run.dtype).itemsize
    held_out = run.held_out_scenarios if held_out is None else held_out
    training, samples = run.training_scenarios, scenario.samples
    vectors = len(scenario.vectors) + _crossed(experiment)
    landmarks = len(scenario.landmarks)
    # Truth, measurements and the loop's inputs; for the training scenarios once more at both
    # precisions, as the sensitivity of the result is checked on them.
    prepared = 27 + 8 * landmarks
    per_scenario = samples * (prepared + 25 + 7 * (vectors + landmarks))
    points = experiment.fuzzy.sampled_points if experiment.fuzzy.centroid == "sampled" else 0
    per_agent = training * (PER_AGENT + points) + 22 * 10
    return {
        "run.held_out_scenarios": held_out * per_scenario * size,
        "run.training_scenarios": training
        * (per_scenario * (size + 8) + samples * prepared * size),
        "run.endurance_scenarios": (run.endurance_scenarios if run.endurance_times > 1 else 0)
        * min(run.endurance_times * samples, MAX_SAMPLES)
        * (per_scenario // samples)
        * size,
        "search.agents": search.agents * per_agent * size,
        "search.iterations": search.total_iterations * (3 * size + 4 + 3 * 8),
    }


def _crossed(experiment: config.Experiment) -> bool:
    """Whether the filter reads the cross product of two vectors as a further one."""
    return getattr(experiment.filter, "cross_vector", False)


def _needs_recorded(experiment: config.Experiment, recorded: RecordedSize) -> dict[str, int]:
    shares = needs(experiment)
    for name in ("run.training_scenarios", "run.endurance_scenarios", "run.held_out_scenarios"):
        if name == "run.endurance_scenarios" or not experiment.objective.simulated_share:
            del shares[name]
    size = np.dtype(experiment.run.dtype).itemsize
    vectors = recorded.vectors + _crossed(experiment)
    # Measurements, truth and masks, padded and stacked in NumPy's float64; the same at the run's
    # precision, and the loop's inputs.
    given = 20 + 7 * recorded.vectors + 7 * recorded.landmarks
    read = 25 + 7 * (vectors + recorded.landmarks) + 8 * recorded.landmarks
    per_sample = 2 * 8 * given + size * (given + 2 * read)
    return shares | {RECORDINGS: recorded.count * recorded.samples * per_sample}


def check(
    experiments: Iterable[config.Experiment],
    held_out: int | None = None,
    recorded: RecordedSize | None = None,
) -> None:
    """Refuse experiments that together would need more memory than is free.

    Raises:
        MemoryLimitError: They need more. The message names the values and their shares.
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
                f"takes {_gib(share)}, as each is padded to the {recorded.samples} samples of "
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
    """Free bytes on the device that runs the simulations; None if the system doesn't say."""
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
            # Cached files that were not read for a while: the system drops them if memory is short.
            used -= _entry(CGROUP / "memory.stat", "inactive_file")
        found.append(limit - used)
    return min(found, default=None)


def _entry(path: Path, name: str) -> int:
    """A number from a system file that has a name and a number in each line."""
    for line in path.read_text("ascii").splitlines():
        words = line.split()
        if len(words) > 1 and words[0] == name:
            return int(words[1])
    raise ValueError(f"{path}: has no {name}")


def _gib(size: int) -> str:
    return f"{size / 2**30:.3g} GiB"
