"""The attitude filter for inertial sensors tuned on recordings."""

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

from posegsa import steps
from posegsa.arguments import check_callable, check_whole, refuse, several
from posegsa.config.imu import ImuConfig, load_imu
from posegsa.errors import RecordingError, RunFolderError, SaveError
from posegsa.judging.imu import ImuResult, judge_imu
from posegsa.recordings.imu import Frame, ImuRecording, as_imu
from posegsa.recordings.recording import Recording
from posegsa.saving.imu import prepare_imu_folder, write_imu
from posegsa.search.imu import search_imu

Given = Recording | Iterable[Recording]


def tune_imu(
    config: ImuConfig | str | Path = "imu",
    *,
    recordings: Given,
    held_out: Given | None = None,
    frame: Frame = "ENU",
    rest: float | Literal["auto"] = "auto",
    seed: int = 0,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: steps.Listener | None = None,
) -> ImuResult:
    """Tune the attitude filter for inertial sensors: what `parameters.also` of its file names.

    These are numbers of [vectors], with which each candidate makes its vectors anew, and of
    [observer]. The cost is the mean over recordings of the total RMSE [deg] of what they judge. The
    numbers of the configuration stay if none better is found.

    Args:
        config: The filter, a file of one, or "imu", the shipped one.
        recordings: Tune on these, each with an accelerometer and a truth; those that `imu` or
            `as_imu` have made keep their frame and rest.
        held_out: Recordings that only judge.
        frame: Of the other recordings, as `imu`'s.
        rest: Likewise.
        seed: Of the search.
        out: Folder to write imu.toml, which `posegsa replay` takes, and imu.txt to.
        overwrite: Replace the filter that it holds; a run there is never replaced.
        progress: Called with each `steps.Step`; of the search, after each iteration.

    Raises:
        ArgumentError: An argument is of another type, or there is no recording.
        ConfigError: The file is no such filter, or it tunes nothing.
        RecordingError: A recording has no accelerometer, or no sample of it is judged.
        RunFolderError: `out` holds a run or a filter already, or can't be written, found before the
            search.
        SaveError: The result can't be written, only now; the error has it as `result`.
    """
    check_callable("progress", progress)
    check_whole("seed", seed, 0)
    chosen = config if isinstance(config, ImuConfig) else load_imu(config)
    if not chosen.also:
        refuse("parameters.also: nothing that is tuned", "numbers of [vectors] and [observer]")
    given, others = (
        several(name, [some] if isinstance(some, Recording) else some, Recording, "recordings")
        for name, some in (("recordings", recordings), ("held_out", held_out or []))
    )
    if not given:
        refuse("recordings: none", "at least one")
    if both := [one.name for one in others if any(one is other for other in given)]:
        refuse(f"held_out: {both[0]} is tuned on", "recordings that are not")
    with steps.listening(progress):
        steps.begin("preparing")
        training, unseen = (
            [_prepared(one, chosen, frame, rest) for one in a] for a in (given, others)
        )
        folder = None if out is None else prepare_imu_folder(out, overwrite=overwrite)
        found = search_imu(chosen, training, seed)
        steps.begin("judging")
        result = judge_imu(found, chosen, training, unseen)
    if folder is not None:
        try:
            write_imu(result, folder)
        except RunFolderError as error:
            raise SaveError(str(error), result) from error
    return result


def _prepared(
    recording: Recording, config: ImuConfig, frame: Frame, rest: float | Literal["auto"]
) -> ImuRecording:
    """A recording from a user, with the vectors of an inertial sensor."""
    if not recording.masks()["judged"].any():
        raise RecordingError(f"{recording.name}: no sample is judged where the truth is known")
    if isinstance(recording, ImuRecording):
        return recording
    return as_imu(recording, frame=frame, rest=rest, settings=config.vectors)
