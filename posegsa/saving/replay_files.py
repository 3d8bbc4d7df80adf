"""The files of replays (a table, trajectories, figures), and of checks of recordings."""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posegsa.errors import RunFolderError
from posegsa.figures.check_figures import plot_check
from posegsa.figures.replay_figures import REPLAY_FIGURES, draw_replay
from posegsa.figures.style import png
from posegsa.judging.replayed import Replay, replay_table
from posegsa.recordings.data_check import DataCheck
from posegsa.recordings.recording import Recording
from posegsa.recordings.tum import tum_text
from posegsa.saving.estimates_csv import csv_text
from posegsa.saving.folder import as_path, lock, replace_files, write_errors
from posegsa.settings.plain import json_text, plain

SCHEMA = 1
"""Version of the format of replay.json; it changes when a key changes its meaning."""
TABLE, DATA, CHECK = "replay.txt", "replay.json", "check.txt"
TRAJECTORIES = "estimated.tum", "true.tum", "judged.tum"


def refuse_replays_in(folder: str | Path, *, overwrite: bool) -> Path:
    """The folder, for replays; one that holds some is refused unless they may be replaced.

    Raises:
        RunFolderError: It contains replays already.
    """
    folder = as_path("folder", folder)
    if not overwrite and (folder / DATA).exists():
        raise RunFolderError(
            f"{folder}: holds replays already; choose another folder, or replace them "
            "(--overwrite; overwrite=True)"
        )
    return folder


def write_replays(
    replays: Sequence[Replay],
    folder: str | Path,
    *,
    overwrite: bool = False,
    figures: Sequence[str] = REPLAY_FIGURES,
) -> Path:
    """Write replays to a folder, created if missing.

    The files are replay.txt and replay.json, and for each recording a folder with estimates.csv
    (`estimates_csv`), the figures and, where there is a position, estimated.tum, true.tum (where
    the truth is known) and judged.tum (the judged part, if that is not all of it).

    Raises:
        RunFolderError: The folder contains replays already, or cannot be written.
    """
    folder = refuse_replays_in(folder, overwrite=overwrite)
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    files: dict[str, bytes] = {}
    names = folder_names([each.recording.name for each in replays])
    for name, each in zip(names, replays, strict=True):
        files |= {f"{name}/{file}": content for file, content in _files(each, figures).items()}
    data = {"schema": SCHEMA, "recordings": [_summary(each) for each in replays]}
    described = [each.recording.describe() for each in replays]
    files[TABLE] = "\n\n".join([replay_table(replays), *described, ""]).encode()
    files[DATA] = (json_text(plain(data)) + "\n").encode()
    # Remove files of an earlier replay that this one may not have.
    optional = *TRAJECTORIES, *(f"{name}.png" for name in REPLAY_FIGURES)
    with lock(folder):
        replace_files(
            folder, files, remove=[f"{name}/{file}" for name in names for file in optional]
        )
    return folder


def write_checks(checks: Sequence[DataCheck], folder: str | Path) -> Path:
    """Write checks to a folder, created if missing: check.txt and a figure of each recording.

    Raises:
        RunFolderError: The folder cannot be written.
    """
    folder = as_path("folder", folder)
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    names = folder_names([each.recording.name for each in checks])
    files = {f"{n}.png": png(plot_check(one)) for n, one in zip(names, checks, strict=True)}
    files[CHECK] = ("\n\n".join(one.text() for one in checks) + "\n").encode()
    with lock(folder):
        replace_files(folder, files, remove=[])
    return folder


def folder_names(names: Sequence[str]) -> list[str]:
    """A unique folder name for each name of a recording."""
    found: list[str] = []
    for name in names:
        plain_name = re.sub(r"[^\w.-]+", "_", name).strip("._") or "recording"
        number, candidate = 2, plain_name
        while candidate in found:
            number, candidate = number + 1, f"{plain_name}_{number}"
        found.append(candidate)
    return found


def _files(replay: Replay, figures: Sequence[str]) -> dict[str, bytes]:
    recording, estimates = replay.recording, replay.estimates
    files = {"estimates.csv": csv_text(replay).encode()}
    if not recording.attitude_only:
        estimated, true, judged = TRAJECTORIES
        text = tum_text(_seconds(recording), estimates.rotation, estimates.position)
        files[estimated] = text.encode()
        if (truth := recording.truth) is not None:
            files[true] = _truth(recording, truth.known)
            if (recording.judged != truth.known).any():
                files[judged] = _truth(recording, recording.judged)
    drawn = draw_replay(replay, figures).items()
    return files | {f"{name}.png": png(figure) for name, figure in drawn}


def _truth(recording: Recording, which: np.ndarray) -> bytes:
    """The truth at some samples, as a TUM file."""
    truth = recording.truth
    assert truth is not None
    position = None if truth.position is None else truth.position[which]
    return tum_text(_seconds(recording)[which], truth.rotation[which], position).encode()


def _seconds(recording: Recording) -> np.ndarray:
    """The time stamps (K,) in seconds, as TUM files have them."""
    stamps = recording.stamps
    return stamps / 1e9 if stamps.dtype.kind == "i" else stamps


def _summary(replay: Replay) -> dict[str, Any]:
    recording = replay.recording
    return {
        "name": recording.name,
        "samples": recording.samples,
        "duration_s": recording.duration,
        "attitude_only": recording.attitude_only,
        "sources": recording.sources,
        "notes": list(recording.notes),
        "median_gain_1_s": _or_null(float(np.median(replay.estimates.gain_used))),
        "rmse": None
        if replay.errors is None
        else {
            phase: {name: _or_null(value) for name, value in each._asdict().items()}
            for phase, each in replay.errors.rmse().items()
        },
    }


def _or_null(number: float | None) -> float | None:
    """A number, or None where it is missing or NaN: a gain of a filter without one, say."""
    return None if number is None or math.isnan(number) else number
