"""Comparison of filters on held-out scenarios."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field

from posegsa.arguments import MAX_INTEGER
from posegsa.filters.rollout import ErrorTrack
from posegsa.judging.description import Description, StoredFilter
from posegsa.judging.metrics import POSITION_WORDS, Bands, Metrics, metrics_of
from posegsa.judging.verdict import Loss, verdict
from posegsa.recordings.frames import Frame
from posegsa.search.population import ScenarioBatch, TrackCost
from posegsa.settings.arrays import Numbers
from posegsa.words import counted, text_table

CONTENDERS = (
    TUNED,
    CONSTANT,
    SWITCH,
    REPLAYED,
    RANDOM,
    SMOOTH,
    OPEN_LOOP,
    EKF,
    EKF_VECTORS,
    EKF_ITERATED,
    EKF_GATED,
    EKF_CLOCK,
    UNTUNED,
    AS_CONFIGURED,
) = (
    "tuned filter",
    "best constant gains",
    "best time switch",
    "tuned gains replayed",
    "random search",
    "smooth gain K(e)",
    "best open-loop gains",
    "invariant EKF",
    "invariant EKF, vector biases",
    "invariant EKF, iterated",
    "invariant EKF, gated",
    "invariant EKF, noise by the clock",
    "untuned Kalman filter from sensors",
    "before tuning",
)
"""Names of the filters that can be compared, in the order of the tables."""
NOISES_FOUND = "Kalman filter with the noises found"
"""The filter that stands beside every one that was tuned on recordings: it was not searched."""
KALMAN_AS_IT_COMES = "Kalman filter as it comes"
"""The filter of `kalman.toml` beside it."""
IMU_AS_IT_COMES = "attitude filter as it comes"
"""The same on recordings of inertial sensors."""
CLAIRVOYANT = "clairvoyant"
"""The name of the reference in the last row, which knows what no filter can know."""
NOT_TUNED = "this filter"
"""What tables call the judged filter if it was not searched; else it is TUNED."""
ADVICE = {
    CONSTANT: "`posegsa tune CONFIG --set filter.schedule=constant`",
    SMOOTH: "`posegsa tune CONFIG --set filter.schedule=smooth`",
    EKF: "`posegsa tune kalman --set filter.iterations=1 --set filter.vector_bias=off`",
    EKF_VECTORS: "`posegsa tune kalman --set filter.iterations=1`",
    EKF_ITERATED: "`posegsa tune kalman`",
    EKF_GATED: (
        "`posegsa tune kalman --set filter.iterations=1 --set filter.belief=ramp "
        "--set filter.belief_smoothing=0`"
    ),
    EKF_CLOCK: "`posegsa tune kalman --set filter.iterations=1 --set filter.unknown=clock`",
    UNTUNED: "`posegsa export kalman`, with the noises of your sensors",
    AS_CONFIGURED: "the configuration itself, without a search",
    NOISES_FOUND: "`posegsa check FILE` prints it as a configuration",
    KALMAN_AS_IT_COMES: "`posegsa export kalman --recording FILE`",
    IMU_AS_IT_COMES: "`posegsa export imu --format c{frame}` or `posegsa replay imu FILE{frame}`",
}
"""How to get one of the filters that are compared with a tuned one; {frame} is `frame_option`."""
_FORMER_NAMES = {"invariant EKF, 3 iterations": EKF_ITERATED}
"""Names in results that were stored before 0.27, when that filter had 3 iterations."""
BAND_POINTS = 300
"""Maximum number of times at which error bands are stored over a whole run, evenly spaced."""
EARLY, EARLY_POINTS = 1.0, 100
"""Length of the transient [s], and the maximum number of additional points in it."""


class Interval(NamedTuple):
    """A mean and its 95 % confidence interval (Student's t over scenarios)."""

    mean: float
    low: float
    high: float

    @property
    def ends(self) -> tuple[float, ...]:
        """Both ends; a single NaN if there is no interval."""
        return (math.nan,) if math.isnan(self.low) else (self.low, self.high)


class Contender(NamedTuple):
    """A filter's performance on every scenario."""

    metrics: Metrics
    bands: Bands
    filter: StoredFilter


class Summary(NamedTuple):
    """Statistics of a contender's costs."""

    cost: Interval
    median: float
    p95: float
    """95th percentile: 95 % of the scenarios cost at most this."""
    worst: float
    diverged: float
    """Share of scenarios on which the filter diverged."""
    own_minus_this: Interval | None
    """Mean paired difference; below 0 the judged filter is better. None for that filter."""
    evaluations: int | None
    """Evaluations of the search that found it, 0 without one; None for the clairvoyant."""


def called(name: str) -> str:
    """A contender's name within a sentence."""
    words = {AS_CONFIGURED: "the filter before tuning", NOT_TUNED: NOT_TUNED}
    return words.get(name, f"the {name}")


def advice(frame: Frame | None = None) -> dict[str, str]:
    """How to get each of the filters that are compared, by name.

    `frame` is the inertial frame of the recordings, if they are of inertial sensors.
    """
    return {name: how.format(frame=frame_option(frame)) for name, how in ADVICE.items()}


def frame_option(frame: Frame | None) -> str:
    """The option of a command for an inertial frame; "" for the default."""
    return "" if frame in (None, "ENU") else f" --frame {frame}"


def own_name(found: Description) -> str:
    """The name of the filter that is judged."""
    return TUNED if found.evaluations else NOT_TUNED


def _contender_name(name: str) -> str:
    name = _FORMER_NAMES.get(name, name)
    if name not in (allowed := (*CONTENDERS, NOT_TUNED)):
        raise ValueError(f"allowed: {', '.join(allowed)}")
    return name


Rows = list[list[str]]
_Columns = tuple[tuple[str, str, Callable[[Any], ArrayLike]], ...]
"""Columns of a table: header, format, and a function that returns a cell's numbers."""

COSTS: _Columns = (
    ("Mean", ".2f", lambda s: s.cost.mean),
    ("95 % interval", ".2f", lambda s: s.cost.ends),
    ("Median", ".2f", lambda s: s.median),
    ("95th\npercentile", ".2f", lambda s: s.p95),
    ("Worst", ".2f", lambda s: s.worst),
    ("First\nminus this", "+.2f", lambda s: s.own_minus_this.mean if s.own_minus_this else ()),
    ("95 % interval", "+.2f", lambda s: s.own_minus_this.ends if s.own_minus_this else ()),
    ("Diverged\n[%]", ".1f", lambda s: 100 * s.diverged),
    ("Evaluations\nsearched", ".0f", lambda s: () if s.evaluations is None else s.evaluations),
)
"""Columns of the cost table, from a `Summary`."""
BEHAVIOUR: _Columns = (
    ("Cost of the\nfirst window", ".2f", lambda m: np.mean(m.transient)),
    ("Cost of the\nsecond", ".2f", lambda m: np.mean(m.steady)),
    ("Attitude\nsettled\n[s]", ".2f", lambda m: np.median(m.settling_attitude)),
    ("Position\nsettled\n[s]", ".2f", lambda m: np.median(m.settling_position)),
    ("Attitude\nRMS, second\nwindow [deg]", ".2f", lambda m: np.mean(m.rms_attitude)),
    ("P_err\nRMS, second\nwindow [cm]", ".1f", lambda m: 100 * np.mean(m.rms_position)),
    ("Distance\nRMS, second\nwindow [cm]", ".1f", lambda m: 100 * np.mean(m.rms_distance)),
    ("Bias error,\nangular\n[rad/s]", ".3f", lambda m: np.mean(m.bias_angular)),
    ("Bias error,\nlinear\n[m/s]", ".3f", lambda m: np.mean(m.bias_linear)),
)
"""Columns of the table of errors behind the costs, from `Metrics`."""

CONSISTENCY: _Columns = (
    ("NEES of the pose,\n6 if right", ".2f", lambda m: np.mean(m.nees)),
    ("Inside its 95 %\nbound [%]", ".1f", lambda m: 100 * np.mean(m.nees_inside)),
    ("NIS a scalar,\n1 if right", ".3f", lambda m: np.mean(m.nis)),
)
"""Columns of the table of covariances, from `Metrics`."""
CONSISTENCY_WORDS = (
    "NEES and NIS are normalised squares of the pose error, and of the difference of the sensors "
    "from their prediction, over the second window. Above the right value the filter is too sure."
)
"""Explains them below the table."""
KALMAN_SEARCH_WORDS = (
    f"The filters called {EKF} were searched briefly, from the noises of a data sheet; a longer "
    "search may find lower costs."
)
"""Says below the table how the searched Kalman filters were found (`judging.tuned_kalman`)."""


@np.errstate(over="ignore")  # a filter may diverge to any number
def _rows(columns: _Columns, of: Mapping[str, object], write: Callable[[float, str], str]) -> Rows:
    """The header, then a row for each contender."""
    rows = [["Contender", *(head for head, _, _ in columns)]]
    for name, each in of.items():
        cells = [(np.ravel(numbers(each)).tolist(), form) for _, form, numbers in columns]
        rows.append([name, *(" to ".join(write(n, form) for n in found) for found, form in cells)])
    return rows


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Filters on the same S held-out scenarios."""

    seed: Annotated[int, Field(ge=0, le=MAX_INTEGER)] | None
    """Seed of the held-out set; None is the experiment's own set."""
    time: Annotated[np.ndarray, Numbers("times")]
    """(n,) times of the bands [s]."""
    contenders: dict[Annotated[str, AfterValidator(_contender_name)], Contender]
    """The contenders by name; the judged filter is the first."""
    clairvoyant: Annotated[np.ndarray, Numbers("scenarios", allow="infinite")] | None = None
    """(S,) cost of the clairvoyant (`filters.clairvoyant`); None with a user's own cost."""

    def __repr__(self) -> str:
        costs = ", ".join(f"{name} {self.cost(name).mean:.4g}" for name in self.contenders)
        return f"<Evaluation on {counted(self.scenarios, 'scenario')}: {costs}; see table()>"

    @property
    def own(self) -> str:
        """The name of the filter that is judged."""
        return TUNED if TUNED in self.contenders else NOT_TUNED

    @property
    def scenarios(self) -> int:
        """S, the number of scenarios."""
        return len(self.contenders[self.own].metrics.cost)

    @property
    def costs(self) -> dict[str, np.ndarray]:
        """(S,) cost on each scenario, of each contender and finally of the clairvoyant."""
        found = {name: each.metrics.cost for name, each in self.contenders.items()}
        return found if self.clairvoyant is None else found | {CLAIRVOYANT: self.clairvoyant}

    def cost(self, name: str) -> Interval:
        """Mean cost of a contender, or of the clairvoyant."""
        return interval(self.costs[name])

    def difference(self, name: str) -> Interval:
        """Paired cost difference, own minus contender; below 0 the judged filter is better."""
        costs = self.costs
        with np.errstate(invalid="ignore"):
            return interval(costs[self.own] - costs[name])

    def summary(self, name: str) -> Summary:
        """Statistics of a contender's costs, or of the clairvoyant's."""
        costs = self.costs[name]
        run = self.contenders.get(name)
        diverged = ~np.isfinite(costs) if run is None else run.metrics.diverged
        return Summary(
            cost=self.cost(name),
            median=float(np.median(costs)),
            p95=float(np.quantile(costs, 0.95, method="higher")),
            worst=float(np.max(costs)),
            diverged=float(np.mean(diverged)),
            own_minus_this=None if name == self.own else self.difference(name),
            evaluations=None if run is None else run.filter.evaluations,
        )

    def tables(self, write: Callable[[float, str], str] = format) -> tuple[Rows, Rows]:
        """Two tables, header first: the contenders' costs, and the errors behind them.

        Args:
            write: Formats a number, like the built-in `format`.
        """
        summaries = {name: self.summary(name) for name in self.costs}
        metrics = {name: each.metrics for name, each in self.contenders.items()}
        return _rows(COSTS, summaries, write), _rows(BEHAVIOUR, metrics, write)

    def consistency(self, write: Callable[[float, str], str] = format) -> Rows:
        """A table of the consistency of the contenders' covariances; empty if none has one."""
        metrics = {
            name: each.metrics
            for name, each in self.contenders.items()
            if not np.isnan(each.metrics.nees).all()
        }
        return _rows(CONSISTENCY, metrics, write) if metrics else []

    @property
    def kalman_searched(self) -> bool:
        """Whether there is a Kalman filter that `posegsa evaluate` searched."""
        return any(name.startswith(EKF) for name in self.contenders)

    @property
    def better(self) -> dict[str, Interval]:
        """How much less filters beside the judged one cost, the lowest first, paired.

        A filter whose difference may be chance is left out.
        """
        others = {name: self.difference(name) for name in self.contenders if name != self.own}
        lower = sorted((-each.mean, name) for name, each in others.items() if each.low > 0)
        return {name: others[name] for _, name in lower}

    @np.errstate(over="ignore", invalid="ignore")  # a filter may diverge to any number
    def verdict(self) -> str:
        """Which of the compared filters is best, in words.

        The cost orders them; errors are those in the second window, in which they have settled, on
        the scenarios where they are finite.
        """
        metrics = self.contenders[self.own].metrics
        errors = np.stack([metrics.rms_attitude, metrics.rms_distance])
        finite = np.isfinite(errors).all(axis=0)
        where = counted(self.scenarios, "unseen scenario")
        if not finite.any():
            return f"On {where} the filter has no finite error."
        degrees, metres = np.mean(errors[:, finite], axis=1)
        own = f"{degrees:.3g} deg and {100 * metres:.3g} cm once settled"
        if lost := np.count_nonzero(~finite):
            own += f" (no finite error on {lost} of them)"
        less = {name: self.difference(name) for name in self.contenders if name != self.own}
        listed = ", ".join(less)
        if less and all(math.isnan(each.low) for each in less.values()):
            why = "too few scenarios, or infinite costs"
            return f"On {where} the filter errs by {own} and cannot be compared ({listed}): {why}."
        if not less:
            return f"On {where} the filter errs by {own}; there is none to compare it with."
        order = sorted(less, key=lambda name: np.nan_to_num(less[name].mean, nan=-math.inf))[::-1]
        found = {called(name): self._losses(name, less[name]) for name in order}
        names = {called(name) for name in order if less[name].mean > 0}
        better = {name: each for name, each in found.items() if name in names}
        others = {name: each for name, each in found.items() if name not in names}
        return verdict(where, own, better, others, {called(k): how for k, how in advice().items()})

    def _losses(self, name: str, cost: Interval) -> list[Loss]:
        """How much less a contender errs [deg], [cm], and costs."""
        own, other = (self.contenders[each].metrics for each in (self.own, name))
        degrees = interval(np.asarray(own.rms_attitude) - np.asarray(other.rms_attitude))
        metres = interval(np.asarray(own.rms_distance) - np.asarray(other.rms_distance))
        return [
            Loss(*degrees, "deg"),
            Loss(100 * metres.mean, 100 * metres.low, 100 * metres.high, "cm"),
            Loss(*cost, "points of cost"),
        ]

    def table(self) -> str:
        """Both tables as text."""
        which = "the run's own held-out set" if self.seed is None else f"held-out set {self.seed}"
        title = f"Cost on {counted(self.scenarios, 'scenario')} of {which}:"
        parts = [title, *map(text_table, self.tables()), POSITION_WORDS]
        if self.kalman_searched:
            parts.append(KALMAN_SEARCH_WORDS)
        if rows := self.consistency():
            parts += [text_table(rows), CONSISTENCY_WORDS]
        waits = {name: each.metrics.waited for name, each in self.contenders.items()}
        for name in (self.own, UNTUNED):
            if name in waits and np.any(waits[name] > 0):
                parts.append(
                    f"For {called(name)} the sensors fixed a pose to start from after "
                    f"{np.median(waits[name]):.3g} s (median), {np.max(waits[name]):.3g} s at "
                    "most; before that nothing counts."
                )
        return "\n\n".join(parts)


@np.errstate(over="ignore")
def interval(values: np.ndarray) -> Interval:
    """Mean and 95 % interval of values (S,); not finite if a value is not."""
    mean = float(np.mean(values))
    if not math.isfinite(mean) or len(values) < 2:
        return Interval(mean, math.nan, math.nan)
    from scipy.special import stdtrit  # imported here because it loads slowly

    spread = float(np.std(values, ddof=1)) / math.sqrt(len(values))
    half = float(stdtrit(len(values) - 1, 0.975)) * spread
    return Interval(mean, mean - half, mean + half)


def contender(
    tracks: ErrorTrack,
    held_out: ScenarioBatch,
    description: Description,
    cost: TrackCost | None = None,
) -> Contender:
    """A filter's performance, from its errors on the held-out scenarios."""
    metrics, bands = metrics_of(tracks, held_out, cost)
    kept = band_samples(np.asarray(held_out.samples.time[0]))
    return Contender(metrics, Bands(*(band[:, kept] for band in bands)), description)


def band_samples(time: np.ndarray) -> np.ndarray:
    """Indices (n,) of the samples at which error bands are stored, from times (N,) [s]."""
    early = np.count_nonzero(time - time[0] <= EARLY)
    places = (np.linspace(0, early - 1, EARLY_POINTS), np.linspace(0, len(time) - 1, BAND_POINTS))
    return np.unique(np.concatenate(places).round().astype(int))


def evaluation(
    contenders: dict[str, Contender],
    held_out: ScenarioBatch,
    seed: int | None = None,
    clairvoyant: np.ndarray | None = None,
) -> Evaluation:
    """The comparison of contenders that ran on the same held-out scenarios."""
    time = np.asarray(held_out.samples.time[0], np.float64)
    return Evaluation(
        seed=seed,
        time=time[band_samples(time)],
        contenders=contenders,
        clairvoyant=clairvoyant,
    )
