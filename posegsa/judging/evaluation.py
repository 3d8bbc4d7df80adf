"""What schedules are worth on scenarios that they were not tuned on, side by side."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from posegsa.judging.metrics import QUANTILES, Bands, Metrics, metrics_of
from posegsa.model.rollout import ErrorTrack
from posegsa.search.population import ScenarioBatch

TUNED, CONSTANT, RANDOM, SMOOTH, ORACLE = (
    "tuned fuzzy gain",
    "best constant gain",
    "fuzzy gain, random search",
    "smooth gain K(e)",
    "oracle K(t)",
)
BAND_POINTS = 300
"""Most points in time that error bands are kept at."""


class Interval(NamedTuple):
    """A mean and its 95 % confidence interval (normal approximation over scenarios)."""

    mean: float
    low: float
    high: float


class Contender(NamedTuple):
    """A schedule's performance on every scenario."""

    metrics: Metrics
    bands: Bands
    schedule: dict[str, Any]
    """What the schedule is, by its own parameters."""


@dataclass(frozen=True)
class Evaluation:
    """Schedules on the same S scenarios."""

    scenarios: int
    seed: int | None
    """Which held-out set: None is the experiment's own, a number another one."""
    time: np.ndarray
    """(n,) times of the bands [s]."""
    contenders: dict[str, Contender]
    """By name; the tuned schedule first."""

    def cost(self, name: str) -> Interval:
        """Mean cost of a contender."""
        return interval(self.contenders[name].metrics.cost)

    def difference(self, name: str) -> Interval:
        """Paired difference of cost, tuned minus the contender; below 0 tuned is better."""
        tuned = self.contenders[TUNED].metrics.cost
        with np.errstate(invalid="ignore"):
            return interval(tuned - self.contenders[name].metrics.cost)

    def gap_closed(self) -> float | None:
        """Share of the gap from best constant gain to oracle that the tuned schedule closes."""
        if ORACLE not in self.contenders:
            return None
        tuned, constant, best = (self.cost(n).mean for n in (TUNED, CONSTANT, ORACLE))
        gap = constant - best
        return (constant - tuned) / gap if math.isfinite(gap) and gap > 0 else None

    def table(self) -> str:
        """The comparison as text for a person."""
        lines = [
            f"{'held-out cost, ' + str(self.scenarios) + ' scenarios':<36}{'mean':>8} +- 95 %"
            f"{'median':>9}{'95 %':>8}{'worst':>8}{'tuned minus this':>24}{'diverged':>10}"
        ]
        for name, contender in self.contenders.items():
            cost, m = self.cost(name), contender.metrics
            versus = ""
            if name != TUNED:
                d = self.difference(name)
                versus = f"{d.mean:+.2f} [{d.low:+.2f}, {d.high:+.2f}]"
            lines.append(
                f"{name:<36}{cost.mean:>8.2f} {0.5 * (cost.high - cost.low):>7.2f}"
                f"{np.median(m.cost):>9.2f}{np.quantile(m.cost, 0.95, method='lower'):>8.2f}"
                f"{np.max(m.cost):>8.2f}{versus:>24}{100 * np.mean(m.diverged):>9.1f}%"
            )
        lines += [
            "",
            f"{'':<36}{'transient':>10}{'steady':>9}{'settled after':>18}"
            f"{'steady RMS error':>20}{'bias error':>22}",
        ]
        for name, contender in self.contenders.items():
            m = contender.metrics
            settled = (
                f"{np.median(m.settling_attitude):.2f} / {np.median(m.settling_position):.2f} s"
            )
            rms = f"{np.mean(m.rms_attitude):.2f} deg {100 * np.mean(m.rms_position):.1f} cm"
            bias = f"{np.mean(m.bias_angular):.3f} rad/s {np.mean(m.bias_linear):.3f} m/s"
            lines.append(
                f"{name:<36}{np.mean(m.transient):>10.2f}{np.mean(m.steady):>9.2f}{settled:>18}"
                f"{rms:>20}{bias:>22}"
            )
        if (closed := self.gap_closed()) is not None:
            lines += [
                "",
                f"The tuned schedule closes {100 * closed:.0f} % of the gap to the oracle.",
            ]
        return "\n".join(lines)

    def to_json(self) -> str:
        """Everything, as JSON; `from_json` gives it back."""
        contenders = {}
        for name, (metrics, bands, schedule) in self.contenders.items():
            summary = {
                "cost": self.cost(name)._asdict(),
                "median": np.median(metrics.cost),
                "p95": np.quantile(metrics.cost, 0.95, method="higher"),
                "worst": np.max(metrics.cost),
                "diverged_fraction": np.mean(metrics.diverged),
                "tuned_minus_this": self.difference(name)._asdict(),
            }
            contenders[name] = {
                "summary": summary,
                "schedule": schedule,
                "metrics": metrics._asdict(),
                "bands": bands._asdict(),
            }
        data = {
            "scenarios": self.scenarios,
            "seed": self.seed,
            "gap_closed": self.gap_closed(),
            "quantiles": QUANTILES,
            "time": self.time,
            "contenders": contenders,
        }
        return json.dumps(_plain(data)) + "\n"


def from_json(text: str) -> Evaluation:
    """Read what `Evaluation.to_json` wrote.

    Raises:
        KeyError, TypeError, ValueError: It is not an evaluation.
    """
    data = json.loads(text)
    contenders = {}
    for name, each in data["contenders"].items():
        metrics = {key: _array(each["metrics"][key]) for key in Metrics._fields}
        metrics["diverged"] = metrics["diverged"].astype(bool)
        bands = Bands(*(_array(each["bands"][key]) for key in Bands._fields))
        contenders[str(name)] = Contender(Metrics(**metrics), bands, dict(each["schedule"]))
    scenarios, seed, time = int(data["scenarios"]), data["seed"], _array(data["time"])
    for name, (metrics, bands, _) in contenders.items():
        if any(a.shape != (scenarios,) for a in metrics):
            raise ValueError(f"{name}: does not have one of each metric for {scenarios} scenarios")
        if any(a.shape != (len(QUANTILES), len(time)) for a in bands):
            raise ValueError(f"{name}: does not have {len(QUANTILES)} bands over {len(time)} times")
    for name in (TUNED, CONSTANT):
        contenders[name]  # every result shows them
    return Evaluation(scenarios, None if seed is None else int(seed), time, contenders)


def interval(values: np.ndarray) -> Interval:
    """Mean and 95 % interval of values (S,); not finite where a value is not."""
    mean = float(np.mean(values))
    if not math.isfinite(mean) or len(values) < 2:
        return Interval(mean, math.nan, math.nan)
    half = 1.96 * float(np.std(values, ddof=1)) / math.sqrt(len(values))
    return Interval(mean, mean - half, mean + half)


def contender(
    tracks: ErrorTrack, held_out: ScenarioBatch, description: dict[str, Any]
) -> Contender:
    """A schedule's performance from what it did on the held-out scenarios."""
    metrics, bands = metrics_of(tracks, held_out)
    kept = band_samples(held_out)
    return Contender(metrics, Bands(*(band[:, kept] for band in bands)), description)


def band_samples(batch: ScenarioBatch) -> np.ndarray:
    """The samples (n,) at which error bands are kept."""
    samples = batch.samples.time.shape[1]
    return np.unique(np.linspace(0, samples - 1, BAND_POINTS).round().astype(int))


def evaluation(
    contenders: dict[str, Contender], held_out: ScenarioBatch, seed: int | None = None
) -> Evaluation:
    """Contenders that met the same held-out scenarios, side by side."""
    time = np.asarray(held_out.samples.time[0], np.float64)[band_samples(held_out)]
    return Evaluation(held_out.bias.shape[0], seed, time, contenders)


def _plain(value: Any) -> Any:
    """The same in JSON's types; what is not finite becomes text, which `float` reads back."""
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [
            _plain(each) for each in (value.tolist() if isinstance(value, np.ndarray) else value)
        ]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else str(float(value))
    return value


def _array(values: Any) -> np.ndarray:
    """A list of numbers, or of rows of numbers, some of them written as text."""
    return np.array([_array(v) if isinstance(v, list) else float(v) for v in values])
