"""Tuning of the attitude filter for inertial sensors, on recordings."""

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
    """Tune the attitude filter for inertial sensors.

    `parameters.also` of its configuration names the tuned numbers: some of [vectors], with which
    each candidate computes its vectors anew, and some of [observer]. The cost is the total RMSE
    [deg] over the judged samples, averaged over the recordings. The numbers of the configuration
    are kept unless the search finds better ones.

    Args:
        config: The filter's configuration, its file, or "imu", the shipped one.
        recordings: Recordings to tune on, each with an accelerometer and a ground truth. Those made
            by `imu` or `as_imu` keep their frame and rest.
        held_out: Held-out recordings.
        frame: Inertial frame of the other recordings, as in `imu`.
        rest: Their time at rest, as in `imu`.
        seed: Seed of the search.
        out: Folder for imu.toml, which `posegsa replay` reads, and imu.txt.
        overwrite: Replace a filter in that folder. A run there is never replaced.
        progress: Called with each `steps.Step`, and after each iteration of the search.

    Raises:
        ArgumentError: An argument has the wrong type, or there is no recording.
        ConfigError: The file does not describe this filter, or it tunes nothing.
        RecordingError: A recording has no accelerometer, or none of its samples is judged.
        RunFolderError: `out` already holds a run or a filter, or can't be written. Raised before
            the search.
        SaveError: The result can't be written after the search. Its `result` holds it.
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
    """A user's recording, with the vectors computed from its inertial sensor."""
    if not recording.masks()["judged"].any():
        raise RecordingError(f"{recording.name}: no sample is judged where the truth is known")
    if isinstance(recording, ImuRecording):
        return recording
    return as_imu(recording, frame=frame, rest=rest, settings=config.vectors)
