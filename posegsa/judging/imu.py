"""The result of tuning the attitude filter for inertial sensors, judged on recordings."""

from collections.abc import Sequence
from dataclasses import dataclass

from posegsa.config.imu import ImuConfig
from posegsa.judging.on_recordings import RecordingScore, mean_errors, score
from posegsa.judging.replayed import HEADS, error_rows
from posegsa.recordings.imu import ImuRecording, with_vectors
from posegsa.recordings.imu_filter import run_imu
from posegsa.search.imu import FoundImu
from posegsa.words import counted, text_table


@dataclass(frozen=True, kw_only=True)
class ImuResult:
    """The attitude filter for inertial sensors, tuned on recordings."""

    config: ImuConfig
    """The tuned filter; `run_imu(recording, result.config)` runs it."""
    before: ImuConfig
    """The initial filter of the search."""
    cost: float
    """Total RMSE, mean over the training recordings [deg]."""
    cost_before: float
    """The same for the initial filter."""
    training: list[RecordingScore]
    """The tuned filter on each training recording."""
    held_out: list[RecordingScore]
    """The tuned filter on each held-out recording; empty if there were none."""
    held_out_before: list[RecordingScore]
    """The initial filter on each held-out recording."""
    evaluations: int
    seconds: float
    """Duration of the search [s]."""

    @property
    def tuned(self) -> dict[str, float]:
        """The tuned numbers, by key."""
        return _numbers(self.config)

    def __repr__(self) -> str:
        return (
            f"<ImuResult: cost {self.cost:.4g} deg, before {self.cost_before:.4g}; see summary()>"
        )

    def summary(self) -> str:
        """A short text; it always says whether recordings were held out."""
        search, before = self.config.search, _numbers(self.before)
        numbers = [
            ["", "found", "before"],
            *([key, f"{a:.4g}", f"{before[key]:.4g}"] for key, a in self.tuned.items()),
        ]
        kept = "" if self.cost < self.cost_before else " (none was better: they stay as they were)"
        alone = (
            "No recording was held out: these errors say how well the filter fits the recordings "
            "that it was tuned on, not how good it is on others."
        )
        parts = [
            f"{search.optimiser}: {search.size_in_words()} for {len(self.tuned)} numbers on "
            f"{counted(len(self.training), 'recording')}: "
            f"{counted(self.evaluations, 'evaluation')} in {self.seconds:.1f} s, mean total RMSE "
            f"{self.cost:.4g} deg, before {self.cost_before:.4g} deg{kept}",
            text_table(numbers),
            self.table(),
            self._warning() if self.held_out else alone,
        ]
        return "\n\n".join(part for part in parts if part)

    def _warning(self) -> str:
        """A warning if the tuned filter is worse than the initial one on held-out recordings."""
        new, old = (mean_errors(a).total for a in (self.held_out, self.held_out_before))
        if new <= old:
            return ""
        return (
            f"warning: on what was held out the numbers found are worse than those before, "
            f"{new:.4g} deg instead of {old:.4g}; they fit the recordings that were tuned on, not "
            "others"
        )

    def table(self) -> str:
        """Root mean square errors by recording and phase, of the tuned and the initial filter."""
        blocks = {
            "tuned on": self.training,
            "held out": self.held_out,
            "held out, numbers as before": self.held_out_before,
        }
        rows = []
        for title, scores in blocks.items():
            block = [row for one in scores for row in error_rows(one.name, one.errors.items())]
            if len(scores) > 1:
                block += error_rows("mean", [("judged", mean_errors(scores))])
            rows += [[title if first == 0 else "", *row] for first, row in enumerate(block)]
        return text_table([row[:-1] for row in (["", *HEADS], *rows)])  # no position column


def judge_imu(
    found: FoundImu,
    before: ImuConfig,
    training: Sequence[ImuRecording],
    held_out: Sequence[ImuRecording],
) -> ImuResult:
    """Judge the filter that a search found."""

    def scores(config: ImuConfig, recordings: Sequence[ImuRecording]) -> list[RecordingScore]:
        made = (with_vectors(one, config.vectors) for one in recordings)
        return [score(one, run_imu(one, config)) for one in made]

    return ImuResult(
        config=found.config,
        before=before,
        cost=found.cost,
        cost_before=found.cost_before,
        training=scores(found.config, training),
        held_out=scores(found.config, held_out),
        held_out_before=scores(before, held_out),
        evaluations=found.evaluations,
        seconds=found.seconds,
    )


def _numbers(config: ImuConfig) -> dict[str, float]:
    """The numbers of a filter that are tuned, by key."""
    sections = {"vectors": config.vectors, "observer": config.observer}
    pairs = (one.key.split(".", 1) for one in config.also)
    return {f"{section}.{name}": getattr(sections[section], name) for section, name in pairs}
