"""A filter's estimates on recordings, their errors by phase, and error tables."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from posegsa.filters.rollout import Estimates
from posegsa.recordings.accuracy import RecordingErrors, Rmse, recording_errors
from posegsa.recordings.recording import Recording
from posegsa.words import text_table


class Replay(NamedTuple):
    """A filter's estimates on one recording."""

    recording: Recording
    estimates: Estimates
    errors: RecordingErrors | None
    """None if the recording has no truth."""

    def __repr__(self) -> str:
        errors = "no truth"
        if self.errors is not None:
            judged = self.errors.rmse()["judged"]
            errors = f"{judged.total:.3g} deg"
            if judged.position is not None:
                errors += f", {100 * judged.position:.3g} cm"
        return f"<Replay of {self.recording.name}: {errors}>"


def replayed_on(recording: Recording, estimates: Estimates) -> Replay:
    """A replay from a recording and the estimates at all its samples."""
    errors = None if recording.truth is None else recording_errors(estimates, recording)
    return Replay(recording, estimates, errors)


HEADS = (
    *("recording", "phase", "samples", "total\n[deg]", "heading\n[deg]", "inclination\n[deg]"),
    "position\n[cm]",
)
"""Column headers of an error table."""


def error_rows(name: str, phases: Iterable[tuple[str, Rmse]]) -> list[list[str]]:
    """A row for each phase of a recording; the position is empty if it is not judged."""
    return [
        [
            name if first == 0 else "",
            phase,
            str(each.samples),
            *(f"{a:.2f}" for a in (each.total, each.heading, each.inclination)),
            "" if each.position is None else f"{100 * each.position:.2f}",
        ]
        for first, (phase, each) in enumerate(phases)
    ]


def replay_table(replays: Sequence[Replay]) -> str:
    """Root mean square errors by recording and phase, as text."""
    rows = []
    for each in replays:
        if each.errors is None:
            rows.append([each.recording.name, "no truth", str(each.recording.samples), *[""] * 4])
        else:
            rows += error_rows(each.recording.name, each.errors.rmse().items())
    heads = list(HEADS)
    if not any(row[-1] for row in rows):
        heads, rows = heads[:-1], [row[:-1] for row in rows]
    return text_table([heads, *rows])
