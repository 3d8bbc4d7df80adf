"""The performance of a tuned filter on recordings."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import jax
import numpy as np
from pydantic import AfterValidator, Field

from posegsa import config
from posegsa.errors import RecordingError
from posegsa.filters.base import sensors_of
from posegsa.filters.rollout import Estimates
from posegsa.judging.description import Description, described_filter
from posegsa.judging.evaluation import CONSTANT, IMU_AS_IT_COMES, advice, frame_option
from posegsa.judging.known_sensors import StoredSensors
from posegsa.judging.replayed import HEADS, error_rows, far_off, replayed_on, with_heads
from posegsa.judging.verdict import Loss, verdict
from posegsa.recordings.accuracy import BLOCK, FEWEST_BLOCKS, AnyNumber, Blocks, Rmse
from posegsa.recordings.broad import GYROSCOPE
from posegsa.recordings.fingerprint import fingerprint
from posegsa.recordings.frames import Frame
from posegsa.recordings.imu import as_read_by, frame_of
from posegsa.recordings.recording import Recording
from posegsa.recordings.running import run_filter
from posegsa.search.configured_filters import OwnFilter
from posegsa.words import text_table


def _with_what_is_judged(errors: dict[str, Rmse]) -> dict[str, Rmse]:
    """Errors by phase that were read, after a check that the phase "judged" is among them."""
    if "judged" not in errors:
        raise ValueError(
            f"its phases are {', '.join(errors) or 'none'}; allowed: judged among them"
        )
    return errors


NOT_CUT = 0.99
"""Ratio of used to requested gain above which the gain counts as not cut."""
EQUAL_RATIO = 1.02
"""Ratio of errors below which filters count as equally good."""
DRAWS = 2000
"""Draws of a bootstrap."""
LIMITED_SHARE = 0.5
"""Share of samples above which a result warns that the gain limit sets the gain."""
Share = Annotated[float, Field(ge=0, le=1)]


class RecordingScore(NamedTuple):
    """A filter on one recording."""

    name: str
    samples: int
    duration: float
    """[s]"""
    attitude_only: bool
    sources: dict[str, str]
    """Which quantities are measured and which were simulated from the truth, in words."""
    notes: list[str]
    """What was bridged, dropped or left out."""
    errors: Annotated[dict[str, Rmse], AfterValidator(_with_what_is_judged)]
    """Errors, NEES and NIS by phase, "judged" first."""
    fingerprint: str
    """SHA-256 of the recording's numbers (`recordings.fingerprint`)."""
    blocks: Blocks
    """Mean squares of the judged errors in blocks of some seconds."""
    limited: Share | None = None
    """Share of the samples with a measurement in which the gain limit cut what the schedule asked
    for; None of a filter without a gain K."""

    @property
    def judged_seconds(self) -> float:
        """Duration of what is judged [s]."""
        return self.duration * self.errors["judged"].samples / max(1, self.samples)


class SimulatedScore(NamedTuple):
    """A filter that was tuned on recordings and simulated scenarios, on the latter."""

    training: Annotated[list[AnyNumber], Field(min_length=1)]
    """Its cost on each training scenario [deg], from the root mean squares of its errors."""
    held_out: Annotated[list[AnyNumber], Field(min_length=1)]
    """The same on held-out scenarios."""

    def text(self, share: float) -> str:
        """Both as text, with the share of the scenarios in the minimised cost."""
        rows = [
            [label, f"{np.mean(costs):.4g}", f"{np.max(costs):.4g}", str(len(costs))]
            for label, costs in (("tuned on", self.training), ("held out", self.held_out))
        ]
        title = f"Simulated scenarios, {share:g} of what was minimised, cost [deg]"
        return text_table([[title, "mean", "worst", "scenarios"], *rows])


@dataclass(frozen=True, kw_only=True)
class OnRecordings:
    """A tuned filter on recordings, compared with others."""

    training: list[RecordingScore]
    """Its score on each training recording."""
    held_out: list[RecordingScore]
    """Its score on each held-out recording; empty if there were none."""
    baselines: dict[str, list[RecordingScore]] = field(default_factory=dict)
    """Scores of other filters on the same held-out recordings, by name (`evaluate`)."""
    baselines_in_training: dict[str, list[RecordingScore]] = field(default_factory=dict)
    """The same on the training recordings, of filters that were not tuned on these."""
    simulated: SimulatedScore | None = None
    """Its score on simulated scenarios, if it was tuned on these too."""
    sensors: StoredSensors | None = None
    """References and weights of the sensors of the training recordings, for exports and streams;
    None if these differ between recordings, or there are none."""

    @property
    def frame(self) -> Frame | None:
        """The inertial frame of the sensors, if they are those of `imu`; None if not."""
        return None if self.sensors is None else frame_of(np.array(self.sensors.vectors))

    def text(self, simulated_share: float) -> str:
        """A short text; it always says whether recordings were held out.

        Args:
            simulated_share: Share of the simulated scenarios in the objective.
        """
        parts = [
            self.table() if self.training or self.held_out else "",
            self.alone(),
            "" if self.simulated is None else self.simulated.text(simulated_share),
            self.origins(),
        ]
        return "\n\n".join(part for part in parts if part)

    def alone(self) -> str:
        """A sentence that nothing was held out; "" if something was."""
        if self.held_out or not self.training:
            return ""
        return (
            "No recording was held out: these errors say how well the filter fits the recordings "
            "that it was tuned on, not how good it is on others."
        )

    def verdict(self) -> str:
        """Which of the compared filters is best on the held-out recordings, in words.

        "" if there are none. Errors are means over the recordings; a filter is better if it errs
        less in attitude or in position, by more than EQUAL_RATIO.
        """
        if not (self.held_out and self.baselines):
            return ""
        own = mean_errors(self.held_out)
        errors = f"{own.total:.3g} deg"
        if own.position is not None:
            errors += f" and {100 * own.position:.3g} cm"
        found = {name: losses(self.held_out, scores) for name, scores in self.baselines.items()}
        scale = {"deg": own.total, "cm": 100 * (own.position or 0.0)}
        gain = {
            name: max(_share(loss.mean, scale[loss.unit]) for loss in each)
            for name, each in found.items()
        }
        order = sorted(found, key=lambda name: gain[name], reverse=True)
        better = {name: found[name] for name in order if gain[name] > 1 - 1 / EQUAL_RATIO}
        others = {name: found[name] for name in order if name not in better}
        # A run knows the frame that it was tuned in, a configuration does not.
        of_run = "" if self.training else frame_option(self.frame)
        words = verdict("what was held out", errors, better, others, advice(self.frame), of_run)
        return words + self._chosen_on_these()

    def _chosen_on_these(self) -> str:
        """A sentence if a compared filter's numbers were chosen on recordings like the held-out."""
        of_broad = any(GYROSCOPE in one.sources.values() for one in self.held_out)
        if not (of_broad and IMU_AS_IT_COMES in self.baselines):
            return ""
        return f" The numbers of the {IMU_AS_IT_COMES} were chosen on trials of BROAD."

    def warnings(self) -> list[str]:
        """What a reader must know before trusting the filter."""
        found = [behind] if (behind := self._behind_constant()) else []
        judged = self.held_out or self.training
        if judged and (words := far_off(mean_errors(judged).nis)):
            found.append(words)
        shares = [each.limited for each in judged]
        cut = [share for share in shares if share is not None]
        if cut and np.mean(cut) > LIMITED_SHARE:
            found.append(
                "the schedule asks for more than the gain limit allows in "
                f"{100 * np.mean(cut):.0f} % of the samples with a measurement: there the limit "
                "sets the gain, not the schedule, and a constant gain may do as well (`posegsa "
                "evaluate` shows one)"
            )
        return found

    def _behind_constant(self) -> str:
        """A sentence if the best constant gains have lower held-out errors of every kind."""
        others = self.baselines.get(CONSTANT)
        if not (others and self.held_out):
            return ""
        own, constant = mean_errors(self.held_out), mean_errors(others)
        pairs = [(own.total, constant.total, "deg")]
        if own.position is not None and constant.position is not None:
            pairs.append((own.position, constant.position, "m"))
        if not all(a > b for a, b, _ in pairs):
            return ""
        errors = " and ".join(f"{a:.3g} {unit} instead of {b:.3g}" for a, b, unit in pairs)
        return f"on what was held out it errs more than the best constant gains, {errors}"

    def table(self) -> str:
        """Errors, NEES and NIS by recording and phase, and those of other filters."""
        return text_table(self.rows())

    def rows(self) -> list[list[str]]:
        """The rows of `table`, the heads first."""
        blocks = {"tuned on": self.training}
        blocks |= {f"{name}, training": each for name, each in self.baselines_in_training.items()}
        blocks["held out"] = self.held_out
        blocks |= {f"{name}, held out": scores for name, scores in self.baselines.items()}
        rows = [
            [title if first == 0 else "", *row]
            for title, scores in blocks.items()
            for first, row in enumerate(_rows(scores))
        ]
        return with_heads(["", *HEADS], rows)

    def origins(self) -> str:
        """Which quantities are measured, which are synthetic, and what was bridged.

        A line is of the recordings that it names, or of all.
        """
        every = {one.name: one for one in (*self.training, *self.held_out)}
        names: dict[str, list[str]] = {}
        for one in every.values():
            words = [f"{quantity}: {text}" for quantity, text in one.sources.items()]
            for text in dict.fromkeys((*words, *one.notes)):
                names.setdefault(text, []).append(one.name)
        return "\n".join(
            text if len(of) == len(every) > 1 else f"{', '.join(of)}: {text}"
            for text, of in names.items()
        )


@np.errstate(all="ignore")  # a filter may diverge to any number
def losses(own: Sequence[RecordingScore], other: Sequence[RecordingScore]) -> list[Loss]:
    """How much less another filter errs in attitude [deg] and, where both have one, position [cm].

    The interval is a bootstrap over blocks of some seconds, the same for both filters.
    """
    means = mean_errors(own), mean_errors(other)
    found = [_loss(means[0].total - means[1].total, own, other, 0, "deg")]
    if means[0].position is not None and means[1].position is not None:
        difference = 100 * (means[0].position - means[1].position)
        found.append(_loss(difference, own, other, 1, "cm"))
    return found


def _loss(
    mean: float,
    own: Sequence[RecordingScore],
    other: Sequence[RecordingScore],
    which: int,
    unit: str,
) -> Loss:
    """A difference with its interval, from the attitude's blocks (0) or the position's (1)."""
    rng, differences = np.random.default_rng(0), np.zeros(DRAWS)
    for pair in zip(own, other, strict=True):
        squares = np.array([pair[0].blocks[which], pair[1].blocks[which]], np.float64)
        count = squares.shape[1]
        if count < FEWEST_BLOCKS or pair[0].judged_seconds < 0.5 * count * BLOCK:
            return Loss(mean, np.nan, np.nan, unit)
        errors = np.sqrt(squares[:, rng.integers(count, size=(DRAWS, count))].mean(axis=2))
        differences += (errors[0] - errors[1]) / len(own)
    low, high = np.quantile(differences, (0.025, 0.975)) * (100 if unit == "cm" else 1)
    return Loss(mean, float(low), float(high), unit)


def _share(part: float, whole: float) -> float:
    """A loss as a share of an error. It is 1 of an infinite error, and lowest if it is NaN."""
    if part == np.inf:
        return 1.0
    share = part / whole if whole else 0.0
    return share if np.isfinite(share) else -np.inf


def _rows(scores: Sequence[RecordingScore]) -> list[list[str]]:
    """A row for each phase of each recording, and the mean of the judged errors of several."""
    rows = [row for one in scores for row in error_rows(one.name, one.errors.items())]
    if len(scores) > 1:
        mean = mean_errors(scores)
        rows += error_rows("mean", [("judged", mean)])
    return rows


def mean_errors(scores: Sequence[RecordingScore]) -> Rmse:
    """Means over recordings of the errors, NEES and NIS of the judged samples."""
    judged = [one.errors["judged"] for one in scores]

    def mean(values: Iterable[float | None]) -> float | None:
        known = [value for value in values if value is not None]
        return float(np.mean(known)) if known else None

    return Rmse(
        total=float(np.mean([one.total for one in judged])),
        heading=float(np.mean([one.heading for one in judged])),
        inclination=float(np.mean([one.inclination for one in judged])),
        position=mean(one.position for one in judged),
        samples=sum(one.samples for one in judged),
        nees=mean(one.nees for one in judged),
        nis=mean(one.nis for one in judged),
    )


def scored(
    found: Description,
    experiment: config.Experiment,
    recordings: Sequence[Recording],
    own: OwnFilter | None = None,
) -> list[RecordingScore]:
    """What a filter of an experiment is worth on recordings, each as this kind of filter reads it.

    `own` is the user's own filter, where it is one.
    """
    scores = []
    with jax.enable_x64(experiment.run.dtype == "float64"):
        for one in recordings:
            read = as_read_by(experiment.filter.kind, one)
            filter = described_filter(found, experiment, own, sensors_of(read.measurements))
            scores.append(score(read, run_filter(filter, read)))
    return scores


def score(recording: Recording, estimates: Estimates) -> RecordingScore:
    """A filter's estimates of a recording with a truth, judged."""
    errors = replayed_on(recording, estimates).errors
    if errors is None:
        raise RecordingError(f"{recording.name}: has no truth, so that nothing can be judged")
    return RecordingScore(
        name=recording.name,
        samples=recording.samples,
        duration=recording.duration,
        attitude_only=recording.attitude_only,
        sources=recording.sources,
        notes=list(recording.notes),
        errors=errors.rmse(),
        fingerprint=fingerprint(recording),
        blocks=errors.blocks(),
        limited=_limited(recording, estimates),
    )


def _limited(recording: Recording, estimates: Estimates) -> float | None:
    """`RecordingScore.limited` of a filter's estimates."""
    m = recording.measurements
    weights = np.concatenate([m.vector_weights, m.landmark_weights], axis=1)
    asked, used = (np.asarray(g, np.float64) for g in (estimates.gain, estimates.gain_used))
    seen = (np.asarray(weights) > 0).any(axis=1) & np.isfinite(asked) & np.isfinite(used)
    if not seen.any():
        return None
    return float(np.mean(used[seen] < NOT_CUT * asked[seen]))
