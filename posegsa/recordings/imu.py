"""Recordings of an inertial sensor, as the attitude filter reads them.

Their two vectors are measured signals: the specific force, whose reference is gravity upwards, and
the magnetic field, whose reference is the direction north. The filter learns the rest of the field.
Such a recording has no position: it is attitude only.
"""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jax.typing import ArrayLike

from posegsa.arguments import check_number, check_type
from posegsa.errors import PosegsaWarning, RecordingError
from posegsa.filters.attitude import LONGEST_PAUSE
from posegsa.model import limits
from posegsa.model.measurements import finite_array, finite_rows
from posegsa.recordings.bridging import refuse_gaps
from posegsa.recordings.frames import GRAVITY, NORTH, UP, Frame, checked_frame
from posegsa.recordings.imu_advice import advice
from posegsa.recordings.recording import Recording
from posegsa.recordings.rotations import to_east_north_up
from posegsa.recordings.start import Start
from posegsa.recordings.units import check_units


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ImuRecording(Recording):
    """A recording of an inertial sensor, made by `imu` or `as_imu`."""

    frame: Frame = "ENU"
    """The inertial frame, of the references too."""

    def describe(self) -> str:
        """A text for people, with advice where the signals call for it."""
        found = advice(
            np.asarray(self.measurements.angular_velocity),
            self.sensors["accelerometer"],
            self.sensors.get("magnetometer"),
            self.time_step,
        )
        return "\n".join([super().describe(), *(f"  advice: {words}" for words in found)])


def references(frame: Frame = "ENU") -> np.ndarray:
    """References (2, 3) of specific force [m/s^2] and field (north), inertial frame."""
    return np.array([GRAVITY * np.array(UP[frame]), NORTH[frame]])


def imu(
    gyr: ArrayLike,
    acc: ArrayLike,
    mag: ArrayLike | None = None,
    *,
    rate: float | None = None,
    time: ArrayLike | None = None,
    frame: Frame = "ENU",
    **more: Any,
) -> ImuRecording:
    """An attitude-only recording from the signals of an inertial sensor.

    All three sensors must have the same right-handed axes: those of the body.

    Args:
        gyr: (K, 3) angular velocity [rad/s].
        acc: (K, 3) specific force [m/s^2], 9.8 upwards at rest; NaN where missing.
        mag: (K, 3) calibrated magnetic field in any unit; NaN where missing. Without it the heading
            starts at an arbitrary value and drifts with the gyroscope.
        rate: samples per second; or give `time`.
        time: (K,) time stamps: integers in ns, floats in s.
        frame: the inertial frame (`Frame`).
        more: further arguments of `Recording.from_arrays` that do not follow from the signals, such
            as name, truth_quaternion, judged, phases or bridge.

    Raises:
        RecordingError: units look wrong (degrees per second, multiples of g), signals are missing
            or zero, or an argument is not allowed; names it.
        MeasurementError: an array has the wrong shape or forbidden values.
    """
    if (rate is None) == (time is None):
        raise RecordingError("rate, time: give one of the two")
    if rate is not None:
        check_number("rate", rate, 1e-3, 1e6)
        more |= {"time_step": 1 / float(rate)}
    gyr = finite_array("gyr", gyr, (None, 3), finite=False)
    acc = finite_array("acc", acc, (len(gyr), 3), finite=False)
    if mag is not None:
        mag = finite_array("mag", mag, (len(gyr), 3), finite=False)
    for name in _FROM_SIGNALS.intersection(more):
        raise RecordingError(f"{name}: follows from gyr, acc and mag; allowed: imu without it")
    sources = {"angular velocity": "measured (gyroscope)"} | more.pop("sources", {})
    sensors = {"accelerometer": acc} | ({} if mag is None else {"magnetometer": mag})
    try:
        return _made(gyr, sensors, frame, time=time, sources=sources, **more)
    except RecordingError as error:
        words = str(error).replace("angular_velocity, velocity", "gyr")
        raise RecordingError(words.replace("angular_velocity", "gyr")) from None


def as_imu(recording: Recording, *, frame: Frame | None = None) -> ImuRecording:
    """An attitude-only recording with the raw signals of an inertial sensor as vectors.

    Args:
        recording: with "accelerometer" and, for a heading, "magnetometer" in its `sensors`, as from
            `Recording.from_broad` and `from_csv`.
        frame: as in `imu`; by default that of the recording (`Recording.frame`), or "ENU".

    Raises:
        RecordingError: as in `imu`, or the recording has no accelerometer.
    """
    check_type("recording", recording, Recording)
    if "accelerometer" not in recording.sensors:
        raise RecordingError(
            f"{recording.name}: has no accelerometer; allowed: sensors with one, as from columns "
            "ax, ay, az of a CSV file"
        )
    truth = recording.truth
    return _made(
        np.asarray(recording.measurements.angular_velocity),
        recording.sensors,
        frame or recording.frame or "ENU",
        name=recording.name,
        time_step=recording.measurements.time_step,
        origin=recording.first_stamp,
        truth_rotation=None if truth is None else truth.rotation,
        judged=recording.judged,
        phases=recording.phases,
        sources=recording.sources,
        notes=recording.notes,
    )


WITHOUT_PAUSES = "observer", "kalman"
"""Kinds of filters that have no rule for a gap between two samples."""
_FROM_SIGNALS = {
    *("angular_velocity", "velocity", "sensors", "start", "weights_by_rate"),
    *("vectors", "vector_references", "vector_weights"),
    *("landmarks", "landmark_references", "landmark_weights"),
}
"""Arguments of `Recording.from_arrays` that are made of the signals."""


def _made(
    gyr: np.ndarray,
    sensors: Mapping[str, np.ndarray],
    frame: Frame,
    *,
    sources: Mapping[str, str],
    notes: Sequence[str] = (),
    **more: Any,
) -> ImuRecording:
    """A checked recording of signals (K, 3), with further arguments of `Recording.from_arrays`."""
    frame = checked_frame(frame)
    sensors, wild = _without_wild(sensors)
    # The filter itself knows for how long a slow sensor's sample stands.
    more["weights_by_rate"] = False
    acc = sensors["accelerometer"]
    mag = sensors.get("magnetometer", np.full_like(acc, math.nan))
    found = Recording.from_arrays(
        angular_velocity=gyr,
        vectors=np.stack([acc, mag], axis=1),
        vector_references=references(frame),
        sensors=sensors,
        frame=frame,
        sources=sources,
        notes=(*notes, *wild),
        **more,
    )
    if found.time_step > LONGEST_PAUSE:
        raise RecordingError(
            f"time: {1 / found.time_step:.2g} samples a second; allowed for an attitude filter: "
            f"{1 / LONGEST_PAUSE:g} or more"
        )
    acc, mag = found.sensors["accelerometer"], found.sensors.get("magnetometer")
    check_units(np.asarray(found.measurements.angular_velocity), acc, found.time_step)
    own = {each.name: getattr(found, each.name) for each in fields(found)}
    own["start"] = Start(_first_attitude(acc, mag, frame), np.zeros(3), np.zeros(6))
    own["sources"] = found.sources | _in_words(acc, mag)
    if wild:
        warnings.warn(f"{found.name}: {'; '.join(wild)}", PosegsaWarning, stacklevel=3)
    return ImuRecording(**own)


def as_read_by(kind: str, recording: Recording, usual: Frame | None = None) -> Recording:
    """A recording as a kind of filter reads it: "imu" reads the raw signals of inertial sensors.

    `usual` is the inertial frame of a recording that states none; by default "ENU".

    Raises:
        RecordingError: as in `as_imu`, or there is a gap that this kind can't read.
    """
    if kind in WITHOUT_PAUSES:
        refuse_gaps(recording.name, recording.time)
    if kind != "imu" or isinstance(recording, ImuRecording):
        return recording
    return as_imu(recording, frame=recording.frame or usual)


def frame_of(known: np.ndarray) -> Frame | None:
    """The frame whose `references` are known (n, 3); None if it is none."""
    for frame in UP:
        if np.array_equal(known, references(frame)):
            return frame
    return None


def _first_attitude(acc: np.ndarray, mag: np.ndarray | None, frame: Frame) -> np.ndarray:
    """R (3, 3), body to inertial, of the first samples of both sensors that are not parallel.

    Without a magnetometer the body's x axis, or its y axis where x is steep, points east.
    """
    first = _known("acc", acc)
    up = acc[first[0]] / np.linalg.norm(acc[first[0]])
    if mag is None:
        field = np.cross(up, np.eye(3)[0 if abs(up[0]) < math.sqrt(0.5) else 1])
        east = np.cross(field, up)
    else:
        seen = _known("mag", mag)
        last = np.maximum(np.searchsorted(first, seen, side="right") - 1, 0)
        for before, at in zip(first[last], seen, strict=True):  # nearly always the first one
            up = acc[before] / np.linalg.norm(acc[before])
            east = np.cross(mag[at] / np.linalg.norm(mag[at]), up)
            if np.linalg.norm(east) > 1e-3:
                break
        else:
            raise RecordingError(
                "mag: is parallel to acc in all samples, so that there is no heading in it; "
                "allowed: a field that is not, or mag=None"
            )
    east = east / np.linalg.norm(east)
    to_axes = np.stack([east, np.cross(up, east), up])
    return to_east_north_up(frame).T @ to_axes


def _known(name: str, values: np.ndarray) -> np.ndarray:
    """Indices of the values (K, 3) that are finite and not zero."""
    known = np.flatnonzero(finite_rows(values) & values.any(axis=1))
    if not known.size:
        raise RecordingError(
            f"{name}: all {len(values)} samples are missing or zero; allowed: some that are not"
        )
    return known


def _without_wild(sensors: Mapping[str, np.ndarray]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Signals (K, 3) with NaN where one is infinite or beyond all sensors, and notes of that."""
    found, notes = dict(sensors), []
    for name, signal in sensors.items():
        wild = np.asarray(np.abs(signal) > limits.VECTOR.high)
        if wild.any():
            rows = np.asarray(wild.any(axis=1))
            found[name] = np.where(rows[:, None], math.nan, signal)
            count = f"{int(rows.sum())} of {len(signal)} samples"
            notes.append(f"{name}: {count} left out, beyond {limits.VECTOR.high:g} or infinite")
    return found, notes


def _in_words(acc: np.ndarray, mag: np.ndarray | None) -> dict[str, str]:
    """The use of each sensor, in words."""
    words = {
        "vectors": "measured: specific force" + ("" if mag is None else " and magnetic field"),
        "accelerometer": _measured(acc),
    }
    if mag is None:
        return words | {"heading": "free, without a magnetometer: starts arbitrarily and drifts"}
    return words | {"magnetometer": _measured(mag)}


def _measured(values: np.ndarray) -> str:
    missing = int(np.sum(~finite_rows(values)))
    return f"measured; {missing} of {len(values)} samples missing" if missing else "measured"
