"""The filter's vectors from gyroscope, accelerometer and magnetometer.

Two vectors are computed, neither normalised:

    up    a_f / g                 reference: up
    east  m x a_f / (g h)         reference: east

where a is the specific force (at rest it points up), a_f is a after a low-pass filter in an almost
inertial frame (`inertial_frame`), g is its length at rest, m is the magnetic field and h its
horizontal part. While the body shakes, the mean of a is an unbiased direction of gravity; the
normalised a is not. Unlike m itself, east does not affect the inclination, however wrong the field
is. The weight of east decreases where the field deviates from its reference (`magnetic_field`).
Such a recording has no position: it is attitude only.
"""

import math
from dataclasses import dataclass, field, fields
from typing import Any, Literal, NamedTuple

import numpy as np
from jax.typing import ArrayLike

from posegsa.arguments import check_number, check_type
from posegsa.config.imu import ImuVectorsConfig
from posegsa.errors import RecordingError
from posegsa.model.measurements import finite_array
from posegsa.recordings.frames import EAST, UP, Frame
from posegsa.recordings.inertial_frame import held, low_passed, strapdown
from posegsa.recordings.magnetic_field import field_parts, field_weights, mean_so_far
from posegsa.recordings.recording import Recording
from posegsa.recordings.rest import LARGEST_BIAS, rest_at_start
from posegsa.recordings.start import Start
from posegsa.recordings.units import check_units
from posegsa.words import counted

GRAVITY = 9.81
"""Assumed length of the specific force at rest if the recording has no rest [m/s^2]."""
FIRST = 1.0
"""Averaging time of the initial estimate of a recording that begins in motion [s]."""
STARTUP = 20.0
"""In a recording that begins in motion, the time constant with which the field's weights and gamma
approach their normal values [s]."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ImuRecording(Recording):
    """A recording of an inertial sensor, made by `imu` or `as_imu`.

    Its `sensors` include the "gyroscope" as measured.
    """

    frame: Frame = "ENU"
    """The inertial frame."""
    settings: ImuVectorsConfig = field(default_factory=ImuVectorsConfig)
    """The settings with which its vectors were computed."""
    resting: int = 0
    """Number of samples at rest at the start; 0 if it begins in motion."""


def imu(
    gyr: ArrayLike,
    acc: ArrayLike,
    mag: ArrayLike | None = None,
    *,
    rate: float | None = None,
    time: ArrayLike | None = None,
    frame: Frame = "ENU",
    rest: float | Literal["auto"] = "auto",
    settings: ImuVectorsConfig | None = None,
    **more: Any,
) -> ImuRecording:
    """An attitude-only recording from the signals of an inertial sensor, ready for `run_filter`.

    All three sensors must have the same right-handed axes: those of the body.

    Args:
        gyr: (K, 3) angular velocity [rad/s].
        acc: (K, 3) specific force [m/s^2], 9.8 upwards at rest; NaN where missing.
        mag: (K, 3) calibrated magnetic field in any unit; NaN where missing. Without it the heading
            starts at an arbitrary value and drifts with the gyroscope.
        rate: samples per second; or give `time`.
        time: (K,) time stamps: integers in ns, floats in s.
        frame: the inertial frame (`Frame`).
        rest: time at rest at the start [s]; 0 if the recording begins in motion, "auto" to detect
            it (`rest_at_start`). The rest gives the gyroscope's bias, the lengths of the references
            and the initial attitude. Without rest the bias estimate starts at 0, the initial
            attitude is from the first second, and the field is compared with its mean so far.
        settings: how vectors are computed, such as `config.load_imu(file).vectors`; by default as
            in the shipped filter.
        more: further arguments of `Recording.from_arrays`, such as name, truth_quaternion, judged,
            phases or bridge.

    Raises:
        RecordingError: units look wrong (degrees per second, multiples of g), signals are missing
            or zero, or an argument is not allowed; names it.
        MeasurementError: an array has the wrong shape or forbidden values.
    """
    if (rate is None) == (time is None):
        raise RecordingError("rate, time: give one of both")
    if rate is not None:
        check_number("rate", rate, 1e-3, 1e6)
        more |= {"time_step": 1 / float(rate)}
    gyr = finite_array("gyr", gyr, (None, 3), finite=False)
    acc = finite_array("acc", acc, (len(gyr), 3), finite=False)
    if mag is not None:
        mag = finite_array("mag", mag, (len(gyr), 3), finite=False)
    sensors = {"accelerometer": acc} | ({} if mag is None else {"magnetometer": mag})
    sources = {"angular velocity": "measured (gyroscope)"} | more.pop("sources", {})
    try:
        recording = Recording.from_arrays(
            time=time, angular_velocity=gyr, sensors=sensors, sources=sources, **more
        )
    except RecordingError as error:
        raise RecordingError(str(error).replace("angular_velocity, velocity", "gyr")) from None
    return as_imu(recording, frame=frame, rest=rest, settings=settings)


def as_imu(
    recording: Recording,
    *,
    frame: Frame = "ENU",
    rest: float | Literal["auto"] = "auto",
    settings: ImuVectorsConfig | None = None,
) -> ImuRecording:
    """An attitude-only recording with vectors and start recomputed from the raw signals.

    Args:
        recording: with "accelerometer" and, for a heading, "magnetometer" in its `sensors`, as from
            `Recording.from_broad` and `from_csv`.
        frame: as in `imu`.
        rest: as in `imu`.
        settings: as in `imu`.

    Raises:
        RecordingError: as in `imu`, or the recording has no accelerometer.
    """
    check_type("recording", recording, Recording)
    settings = ImuVectorsConfig() if settings is None else settings
    check_type("settings", settings, ImuVectorsConfig)
    if frame not in UP:
        raise RecordingError(f"frame = {frame!r}; allowed: {', '.join(UP)}")
    signals = _signals(recording)
    check_units(signals.gyr, signals.acc, signals.time_step)
    resting = _samples_at_rest(rest, signals)
    return _with_vectors(recording, signals, frame, settings, resting, None)


def with_vectors(recording: ImuRecording, settings: ImuVectorsConfig) -> ImuRecording:
    """The recording with vectors recomputed with other settings."""
    made = recording.frame, settings, recording.resting
    return _with_vectors(recording, _signals(recording), *made, None)


def with_known_bias(recording: ImuRecording, bias: np.ndarray) -> ImuRecording:
    """The recording with vectors recomputed with a better bias of the gyroscope.

    Args:
        recording: of an inertial sensor.
        bias: (K, 3) at each sample [rad/s], such as the estimates of a first run.
    """
    signals = _signals(recording)
    made = recording.frame, recording.settings, recording.resting
    return _with_vectors(recording, signals, *made, bias)


def _signals(recording: Recording) -> "Signals":
    """The raw signals of a recording."""
    if "accelerometer" not in recording.sensors:
        raise RecordingError(
            f"{recording.name}: has no accelerometer; allowed: sensors with one, as from columns "
            "ax, ay, az of a CSV file"
        )
    gyr = recording.sensors.get("gyroscope", recording.measurements.angular_velocity)
    return Signals(
        gyr=np.asarray(gyr),
        acc=recording.sensors["accelerometer"],
        mag=recording.sensors.get("magnetometer"),
        steps=np.asarray(recording.measurements.time_step),
    )


def _with_vectors(
    recording: Recording,
    signals: "Signals",
    frame: Frame,
    settings: ImuVectorsConfig,
    resting: int,
    bias: np.ndarray | None,
) -> ImuRecording:
    made = prepared(signals, resting, frame, settings, bias)
    truth = recording.truth
    found = Recording.from_arrays(
        name=recording.name,
        time_step=signals.steps,
        angular_velocity=made.angular_velocity,
        vectors=made.vectors,
        vector_references=made.references,
        vector_weights=made.weights,
        truth_rotation=None if truth is None else truth.rotation,
        judged=recording.judged,
        phases=recording.phases,
        start=made.start,
        sources=recording.sources | made.sources,
        sensors=recording.sensors | {"gyroscope": signals.gyr},
        notes=recording.notes,
    )
    held_by = {each.name: getattr(found, each.name) for each in fields(found)}
    return ImuRecording(**held_by, frame=frame, settings=settings, resting=resting)


class Signals(NamedTuple):
    """K samples of the raw signals of an inertial sensor, body frame."""

    gyr: np.ndarray
    """(K, 3) [rad/s]."""
    acc: np.ndarray
    """(K, 3) specific force [m/s^2]; NaN where missing."""
    mag: np.ndarray | None
    """(K, 3) magnetic field, NaN where missing; None without a magnetometer."""
    steps: np.ndarray
    """(K,) time to the next sample [s]."""

    @property
    def time_step(self) -> float:
        """The median time step [s]."""
        return float(np.median(self.steps))


class Prepared(NamedTuple):
    """The filter's inputs from K samples of an inertial sensor, with n = 1 or 2 vectors."""

    angular_velocity: np.ndarray
    """(K, 3) from each sample to the next [rad/s]."""
    vectors: np.ndarray
    """(K, n, 3) up and east, body frame; NaN where missing."""
    references: np.ndarray
    """(n, 3) the same vectors, inertial frame."""
    weights: np.ndarray
    """(K, n) in [0, 1]."""
    start: Start
    sources: dict[str, str]
    """What each sensor was used for, in words, with counts of what was left out."""


def prepared(
    signals: Signals,
    resting: int,
    frame: Frame,
    settings: ImuVectorsConfig,
    bias: np.ndarray | None = None,
) -> Prepared:
    """Vectors, references and initial estimate of a recording (causal after the first second).

    Args:
        signals: in checked units.
        resting: number of samples at rest at the start; 0 for none.
        frame: the inertial frame.
        settings: how vectors are computed.
        bias: (K, 3) bias of the gyroscope at each sample [rad/s], for the almost inertial frame; by
            default its mean at rest, or 0.

    Raises:
        RecordingError: the signal of a sensor in the first second, or at rest, is missing or zero.
    """
    sources = {"start": _rest_in_words(resting, signals), "vectors": _in_words(settings, signals)}
    omega = signals.gyr
    if settings.gyroscope_interval == "before":
        omega = np.concatenate([omega[1:], omega[-1:]])
    at_rest = signals.gyr[:resting].mean(axis=0) if resting else np.zeros(3)
    S = strapdown(omega - (at_rest if bias is None else bias), signals.steps)
    first = resting or min(len(omega), max(1, round(FIRST / signals.time_step)))

    acc = np.einsum("kij,kj->ki", S, signals.acc)
    gravity = _median("acc", acc[:first])
    length = float(np.linalg.norm(gravity)) if resting else GRAVITY
    acc_known, sources["accelerometer"] = _used(acc, length, settings)
    steady = low_passed(
        held(acc, acc_known, gravity), settings.low_pass, signals.time_step, gravity
    )
    up = np.einsum("kji,kj->ki", S, steady) / length
    vectors, weights = [up], [acc_known.astype(float)]

    east_at_first = None
    if signals.mag is None:
        sources["heading"] = "free, without a magnetometer: starts arbitrarily and drifts"
    else:
        turned = np.einsum("kij,kj->ki", S, signals.mag)
        usual = _median("mag", turned[:first])
        known, sources["magnetometer"] = _used(turned, float(np.linalg.norm(usual)), settings)
        parts = np.where(known[:, None], field_parts(turned, steady), math.nan)
        reference = field_parts(usual[None], gravity[None])[0]
        if not reference[0] > 1e-3 * np.linalg.norm(reference):
            raise RecordingError(
                "mag: is parallel to acc at first, so that there is no heading in it; allowed: a "
                "field that is not, or mag=None"
            )
        east = np.cross(signals.mag, up) / reference[0]
        vectors.append(np.where(known[:, None], east, math.nan))
        weight = np.ones(len(up))
        if settings.field_tolerance != "off":
            weight = field_weights(
                parts,
                reference if resting else mean_so_far(parts, first),
                signals.time_step,
                tolerance=settings.field_tolerance,
                recovery=settings.field_recovery,
            )
            if not resting:
                # No reference of the field is known yet, so the first samples get full weight.
                age = np.arange(len(up)) * signals.time_step
                weight = np.maximum(weight, np.exp(-age / STARTUP))
        weights.append(np.where(known & acc_known, weight, 0.0))
        east_at_first = np.cross(usual, gravity)

    return Prepared(
        angular_velocity=omega,
        vectors=np.stack(vectors, axis=1),
        references=np.array([UP[frame], EAST[frame]][: len(vectors)], float),
        weights=np.stack(weights, axis=1),
        start=Start(
            rotation=_attitude(gravity, east_at_first, frame),
            position=np.zeros(3),
            bias=np.concatenate([at_rest, np.zeros(3)]),
        ),
        sources=sources,
    )


def _samples_at_rest(rest: float | Literal["auto"], signals: Signals) -> int:
    if rest == "auto":
        return rest_at_start(signals.gyr, signals.acc, signals.time_step)
    duration = len(signals.gyr) * signals.time_step
    if isinstance(rest, str):
        raise RecordingError(f'rest = {rest!r}; allowed: "auto", or a time from 0 on [s]')
    check_number("rest", rest, 0.0)
    if rest > duration * (1 + 1e-9):
        raise RecordingError(
            f"rest = {rest:g} s; allowed: up to {duration:g} s, as long as the recording"
        )
    samples = min(len(signals.gyr), round(rest / signals.time_step))
    turning = float(np.linalg.norm(signals.gyr[:samples].mean(axis=0))) if samples else 0.0
    if turning > LARGEST_BIAS:
        raise RecordingError(
            f"rest = {rest:g} s: the gyroscope turns by {np.degrees(turning):.3g} deg/s on average "
            f"in it; allowed: a time at rest (up to {np.degrees(LARGEST_BIAS):g} deg/s, its bias), "
            'or 0 or "auto"'
        )
    return samples


def _median(name: str, values: np.ndarray) -> np.ndarray:
    """Median (3,) of the finite values (K, 3); a RecordingError if there is none or it is zero.

    A mean would be wrong if a magnet comes near or the sensor is knocked before the motion begins.
    """
    known = np.isfinite(values).all(axis=1)
    median = np.median(values[known], axis=0) if known.any() else np.zeros(3)
    if not median.any():
        raise RecordingError(
            f"{name}: the first {len(values)} samples are all missing or zero; allowed: some valid "
            "ones, from which the initial estimate is computed"
        )
    return median


def _used(values: np.ndarray, length: float, settings: ImuVectorsConfig) -> tuple[np.ndarray, str]:
    """Which of the values (K, 3) are used, (K,), and which are not, in words."""
    known = np.all(np.isfinite(values), axis=1)
    with np.errstate(invalid="ignore"):
        far = known & (np.linalg.norm(values, axis=1) > settings.outlier * length)
    words = "measured"
    if missing := int(np.sum(~known)):
        words += f"; {counted(missing, 'sample')} missing"
    if outliers := int(np.sum(far)):
        words += (
            f"; {counted(outliers, 'sample')} ignored, more than {settings.outlier:g} times as "
            "long as the reference"
        )
    return known & ~far, words


def _attitude(up: np.ndarray, east: np.ndarray | None, frame: Frame) -> np.ndarray:
    """R (3, 3), body to inertial, from up and east (3,) in the body frame, of any length.

    Without an east, the body's x axis, or its y axis where x is steep, points along the frame's x.
    """
    u = up / np.linalg.norm(up)
    z = -u if frame == "NED" else u
    if east is None:
        axis = np.eye(3)[0 if abs(u[0]) < math.sqrt(0.5) else 1]
        x = axis - (axis @ u) * u
    else:
        x = east if frame == "ENU" else np.cross(u, east)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _rest_in_words(resting: int, signals: Signals) -> str:
    if not resting:
        return (
            "begins in motion: the gyroscope's bias is learnt from 0, the references are those of "
            f"the first {FIRST:g} s"
        )
    bias = ", ".join(f"{1e3 * b:.2f}" for b in signals.gyr[:resting].mean(axis=0))
    return (
        f"at rest for the first {resting * signals.time_step:.1f} s: gyroscope's bias ({bias}) "
        "mrad/s, references and start from there"
    )


def _in_words(settings: ImuVectorsConfig, signals: Signals) -> str:
    low_pass = (
        f"low-passed over {settings.low_pass:g} s in an almost inertial frame"
        if settings.low_pass
        else "as measured"
    )
    return f"made of the sensors: up = a / g, {low_pass}" + (
        "" if signals.mag is None else ", and east = m x a / (g h)"
    )
