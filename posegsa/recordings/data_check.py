"""Checks of a recording before a filter runs on it: rates, gaps, noise, biases, mistakes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from posegsa.arguments import check_type
from posegsa.config import KalmanConfig
from posegsa.errors import RecordingError
from posegsa.model.observability import why_attitude_unobservable, why_unobservable
from posegsa.recordings.accuracy import attitude_errors
from posegsa.recordings.delays import late_sensors, predicted
from posegsa.recordings.held import held
from posegsa.recordings.mistakes import mistakes
from posegsa.recordings.noises import neighbours, noise_of, velocity_noises
from posegsa.recordings.recording import Recording
from posegsa.recordings.relations import (
    MIN_INTERVALS,
    Quantities,
    Vector,
    misfits,
    quantities,
    true_force,
)
from posegsa.words import counted, text_table


class SensorCheck(NamedTuple):
    """What was found about one sensor."""

    name: str
    unit: str
    rate: float
    """Mean rate of measurements, from the first to the last [1/s]."""
    gap: float
    """Longest time without a measurement [s]."""
    noise: float
    """Standard deviation of each component's noise in a sample, in its unit: of raw signals of an
    inertial sensor, and without a truth, from differences of neighbouring samples; of others as a
    filter must assume it that takes for white what lasts, too (`recordings.noises`). NaN if
    neighbouring samples do not show it, because they are rounded or interpolated."""
    bias: float | None
    """Length of the mean difference from the truth's prediction, in its unit; None without a
    truth. Of a raw signal None too if the motion does not tell it: of an accelerometer without a
    true position, of a magnetometer that hardly turns."""
    held: float
    """Number of samples that repeat each measurement; 1 if it is not held (`recordings.held`)."""


@dataclass(frozen=True)
class DataCheck:
    """What was found about a recording."""

    recording: Recording
    sensors: list[SensorCheck]
    misfits: dict[str, float]
    """How far the sensors disagree with each other and with the truth, as shares
    (`recordings.relations`)."""
    unobservable: str
    """A sentence about what is missing to determine the pose; "" if nothing is missing."""
    findings: list[str]
    """Mistakes and delays that the recording seems to have, in words; nothing is corrected."""

    def __repr__(self) -> str:
        found = counted(len(self.findings), "mistake") if self.findings else "no mistake"
        return f"<DataCheck of {self.recording.name}: {found} found; see text()>"

    def text(self) -> str:
        """The whole check as readable text."""
        rows = [["sensor", "rate [1/s]", "longest gap [s]", "noise by axis", "bias", "unit"]]
        for one in self.sensors:
            bias = "-" if one.bias is None else f"{one.bias:.3g}"
            noise = "-" if math.isnan(one.noise) else f"{one.noise:.3g}"
            rows.append([one.name, f"{one.rate:.4g}", f"{one.gap:.3g}", noise, bias, one.unit])
        parts = [self.recording.describe(), text_table(rows)]
        parts += [
            f"{one.name} is held: measured at {one.rate:.3g} Hz, repeated in between"
            for one in self.sensors
            if one.held > 1
        ]
        if self.unobservable:
            parts.append(self.unobservable)
        if self.findings:
            parts.append("\n".join(f"  look: {words}" for words in self.findings))
        else:
            if not self.unobservable or "accelerometer" in self.recording.sensors:
                parts.append(f"No mistake was found: the sensors agree with {self._compared}.")
            if settings := self.settings:
                use = "save it as mine.toml, then `posegsa replay mine.toml FILE`"
                parts.append(f"These noises as a configuration ({use}):\n\n{settings}")
        return "\n\n".join(parts)

    @property
    def _compared(self) -> str:
        """What the sensors were compared with, in words."""
        truth = self.recording.truth
        if truth is None or not np.any(truth.known):
            return "each other, as far as they overlap; there is no truth to compare them with"
        return "each other and the truth"

    @property
    def settings(self) -> str:
        """The noises that were found as a [filter] table; "" for an attitude-only recording."""
        if self.recording.attitude_only:
            return ""
        numbers = WALKS | _noises(self.recording, self.sensors) | _start(self.recording)
        lines = [f"{key} = {value:.2g}  # {_UNITS[key]}" for key, value in numbers.items()]
        more = (*(bias for _, _, bias, _ in _SETTINGS if bias), "linear_walk")
        for key in (key for key in more if key not in numbers):
            usual = getattr(KalmanConfig(), key)
            lines.append(f"# {key} = {usual:g}  # assumed, as it did not show: state what you know")
        for key, scales in _scales([self.sensors]).items():
            lines.append(f"{key} = [{', '.join(f'{x:.3g}' for x in scales)}]  # one by one")
        head = "[filter]", 'kind = "kalman"', "iterations = 10  # of an update at most"
        return "\n".join([*head, *lines])


_SETTINGS = (
    ("angular_velocity", "angular_velocity", "initial_angular_bias", True),
    ("velocity", "velocity", "initial_linear_bias", True),
    ("vector", "vector", "initial_vector_bias", False),
    ("landmark", "landmark", "", False),
)
"""Keys of the noise and of the bias of each kind of sensor; whether the noise is a density."""
VECTORS = "vector", "accelerometer", "magnetometer"
"""First words of the names of vectors."""
_PREFIXES = {"angular_velocity": "angular_", "velocity": "linear_"}
"""Prefixes of the keys of a velocity's walk and lead."""
SIMULATION_NOISE = 1e-6
"""A noise below this is that of a simulation without noise; no filter should assume it."""
ROUNDING_SHARE = 1e-6
"""Noise by differences of neighbouring samples, as a share of what is measured, up to which it is
rounding."""
MIN_BIAS_INFORMATION = 0.1
"""Least of the information on a field's bias by axis, 1 being that of a field that is known, from
which on it is estimated."""
MAX_LENGTH_RATIO = 10.0
"""Ratio of the vectors' lengths up to which one bias and one walk may serve all."""
FAR_OFF, LENGTH_OFF = 0.8, 1.6
"""A misfit above which something is mistaken, whatever it is; sensors have up to 0.5. That of a
length is a logarithm, and one that strong motion makes larger, if nothing tells it."""
MIN_MOTION = 0.05
"""Standard deviation by the truth, in a sensor's unit, from which on it can't be constant."""
MAX_SPEED = 1000.0
"""Speed of the true position [m/s] above which it jumps."""
SEPARATE_NOISE_RATIO = 2.0
"""Ratio of the noises of two vectors, or two landmarks, above which each gets its own."""
WALKS = {"angular_walk": 2e-5, "vector_walk": 1e-5}
"""Walks if a recording shows none: the biases are assumed to hardly change within it."""
START = {"initial_attitude": 0.15, "initial_position": 0.25}
"""Standard deviations of a start from the first measurements, if its error is not larger [rad],
[m]."""
_UNITS = {
    "angular_velocity": "rad/sqrt(s)",
    "velocity": "m/sqrt(s)",
    "vector": "of each component",
    "landmark": "m",
    "initial_angular_bias": "rad/s",
    "initial_linear_bias": "m/s",
    "initial_vector_bias": "as large as it was",
    "angular_walk": "rad/s/sqrt(s), of its bias",
    "linear_walk": "m/s/sqrt(s), of its bias",
    "angular_lead": "steps: 0.5 if measured at its stamp, 0 if the mean over the step after it",
    "linear_lead": "steps",
    "vector_walk": "1/sqrt(s), assumed: the bias hardly changes",
    "initial_attitude": "rad, or how far off its start was",
    "initial_position": "m, or how far off its start was",
}


def found_noises(recordings: Sequence[Recording]) -> dict[str, float | tuple[float, ...]]:
    """Noises and biases that recordings show, by key of a Kalman filter's settings.

    Noises, walks and leads are medians over the recordings, biases and errors at the start the
    largest. The walk of the velocity's bias is best left to a search.

    Args:
        recordings: Recordings with a body velocity; biases are found if there is a truth.
    """
    sensors = [_sensors(one) for one in recordings]
    pairs = list(zip(recordings, sensors, strict=True))
    each = [_noises(one, found) | _start(one) for one, found in pairs]
    keys = dict.fromkeys(key for noises in each for key in noises)
    found = {key: [noises[key] for noises in each if key in noises] for key in keys}
    combined: dict[str, float | tuple[float, ...]] = {
        key: max(values) if key.startswith("initial") else float(np.median(values))
        for key, values in found.items()
    }
    return WALKS | combined | _scales(sensors)


def _scales(recordings: Sequence[Sequence[SensorCheck]]) -> dict[str, tuple[float, ...]]:
    """Noises of single vectors and landmarks as multiples of the common noise, if they differ."""
    found = {}
    for kind in ("vector", "landmark"):
        noises = [
            [each.noise for each in sensors if each.name.startswith(kind)] for sensors in recordings
        ]
        if len({len(own) for own in noises}) > 1:
            continue  # a scale belongs to a sensor by its index
        own = np.median(np.array(noises), axis=0)
        if (
            len(own) < 2
            or not np.all(own > SIMULATION_NOISE)
            or np.max(own) < SEPARATE_NOISE_RATIO * np.min(own)
        ):
            continue
        found[f"{kind}_scales"] = tuple(float(f"{x:.3g}") for x in own / np.median(own))
    return found


def _start(recording: Recording) -> dict[str, float]:
    """Deviations of the pose at the start: START, or its error if that is larger.

    A start is far off if a wrong one was given, or if the first measurements do not show the pose.
    """
    truth = recording.truth
    if truth is None:
        return START
    try:
        start = recording.initial()
    except RecordingError:  # nothing is seen at first; running a filter reports it
        return START
    angle = np.radians(attitude_errors(start.rotation[None], truth.rotation[:1]).total[0])
    errors = {"initial_attitude": float(angle)}
    if truth.position is not None:
        distance = np.linalg.norm(start.position - truth.position[0])
        errors["initial_position"] = float(distance)
    known = {key: error for key, error in errors.items() if np.isfinite(error)}
    return {key: max(least, known.get(key, least)) for key, least in START.items()}


def _noises(recording: Recording, sensors: Sequence[SensorCheck]) -> dict[str, float]:
    """The noises and biases of sensors, by key of a Kalman filter's settings."""
    found, velocities = {}, velocity_noises(recording)
    for key, kind, bias, density in _SETTINGS:
        own = [one for one in sensors if one.name.startswith(kind) and one.noise > SIMULATION_NOISE]
        if not own:
            continue
        # A filter takes each repetition of a vector or a landmark for a new measurement.
        as_taken = [one.noise * math.sqrt(one.held) for one in own]
        noise = float(np.median(as_taken))
        found[key] = own[0].noise / math.sqrt(own[0].rate) if density else noise
        if kind in velocities and velocities[kind].walk:
            found[_PREFIXES[kind] + "walk"] = velocities[kind].walk
        if kind in velocities and velocities[kind].lead:
            found[_PREFIXES[kind] + "lead"] = velocities[kind].lead
        biases = [one.bias / math.sqrt(3) for one in own if one.bias is not None]
        if bias and biases:  # a bias that did not show may be small, but is not 0
            found[bias] = max(*biases, 0.1 * noise)
    return found


def check(recording: Recording) -> DataCheck:
    """Look for the usual mistakes in a recording, and estimate the properties of its sensors.

    Sensors are compared with each other and, where it is known, with the truth. Delays and some
    mistakes can only be detected with a truth, and those of an axis only if the body turns about
    it.

    Args:
        recording: Any recording; best read with `landmark_outlier="off"`, since wrong landmarks
            look like outliers.

    Raises:
        ArgumentError: It is not a recording.
    """
    check_type("recording", recording, Recording)
    q = quantities(recording)
    found = mistakes(q)
    fits = misfits(q)
    found += _stuck(q)
    found += [] if found else _far_off(fits)
    found += [] if found else late_sensors(q)  # what is mistaken otherwise looks late too
    found += [] if found else _jumps(recording)
    found += [] if recording.attitude_only else _lengths(q)
    sensors = _sensors(recording)
    found += [
        f"{one.name} has no measurement"
        for one in sensors
        if not _measured(recording, one.name)[1].any()
    ]
    return DataCheck(
        recording=recording,
        sensors=sensors,
        misfits=fits,
        unobservable=_unobservable(recording, q),
        findings=found,
    )


def _far_off(fits: dict[str, float]) -> list[str]:
    """Relations with a misfit as large as the compared quantities, in words; the worst three.

    For a vector that is allowed: an accelerometer does not show gravity while the body accelerates.
    """
    far = [
        (misfit, name)
        for name, misfit in fits.items()
        if misfit > (LENGTH_OFF if name.startswith("length") else FAR_OFF)
        and not name.startswith(VECTORS)
    ]
    found = []
    for misfit, name in sorted(far, reverse=True)[:3]:
        if name.startswith("length"):
            of = name.removeprefix("length of ")
            factor = f"by a factor of {math.exp(misfit):.3g}"
            found.append(f"{of} differs in length from its reference, {factor}: another unit?")
        else:
            share = f"by {100 * misfit:.0f} % of their size"
            found.append(f"{name} do not fit, {share}: a unit, an axis or a frame?")
    return found


def _stuck(q: Quantities) -> list[str]:
    """Sensors that never change although what they measure does, by the truth; in words."""
    found = []
    for one in predicted(q):
        seen, true = _known(one.measured), _known(one.expected)
        if len(seen) < MIN_INTERVALS or len(true) < MIN_INTERVALS or np.any(np.ptp(seen, axis=0)):
            continue
        if np.linalg.norm(np.std(true, axis=0)) > MIN_MOTION:
            values = ", ".join(f"{x:.3g}" for x in seen[0])
            found.append(f"{one.sensor} never changes: it is ({values}) in all samples")
    return found


def _jumps(recording: Recording) -> list[str]:
    """The first jump of the true position, in words."""
    if recording.truth is None or recording.truth.position is None:
        return []
    P, time = recording.truth.position, recording.time
    at = np.flatnonzero(np.isfinite(P).all(axis=1))
    steps = np.linalg.norm(np.diff(P[at], axis=0), axis=1)
    far = np.flatnonzero(steps > MAX_SPEED * np.diff(time[at]))
    if not far.size:
        return []
    k = far[0]
    return [f"the true position jumps by {steps[k]:.3g} m in a step, at {time[at[k + 1]]:.4g} s"]


def _lengths(q: Quantities) -> list[str]:
    """What to do with vectors in units so different that no common bias fits them, in words."""
    known = [vector.reference for vector in q.vectors if vector.reference is not None]
    lengths = [float(np.median(np.linalg.norm(np.atleast_2d(each), axis=1))) for each in known]
    if len(lengths) < 2 or max(lengths) <= MAX_LENGTH_RATIO * min(lengths):
        return []
    return [
        f"the references of the vectors are {min(lengths):.3g} to {max(lengths):.3g} long, but a "
        "filter has one bias and one walk for all vectors: divide each vector and its reference by "
        "the length of the reference"
    ]


def _sensors(recording: Recording) -> list[SensorCheck]:
    q = quantities(recording, averaged=False)
    differences = {one.sensor: one.measured - one.expected for one in predicted(q)}
    velocities = velocity_noises(recording)
    named = [("angular_velocity", "rad/s")]
    named += [] if q.velocity is None else [("velocity", "m/s")]
    named += [(v.name, "m/s^2" if v.name == "accelerometer" else "its own") for v in q.vectors]
    named += [(f"landmark {j}", "m") for j in range(len(q.landmarks))]
    found = []
    for name, unit in named:
        raw, there = _measured(recording, name)
        steps, raw = np.diff(recording.time[there]), raw[there]
        step, holding = float(np.median(steps)) if steps.size else math.nan, held(raw)
        off = _known(differences[name]) if name in differences else np.zeros((0, 3))
        mean = np.mean(off, axis=0) if len(off) else None
        if name in recording.sensors:
            mean = _raw_bias(q, next(v for v in q.vectors if v.name == name))
        if name in velocities:
            noise = velocities[name].density / math.sqrt(holding.samples * step)
            mean = velocities[name].bias
        elif len(off) > MIN_INTERVALS and name not in recording.sensors:
            noise = noise_of(off, step) / math.sqrt(holding.samples)
        else:
            noise = neighbours(raw[holding.fresh])
            rounding = ROUNDING_SHARE * np.median(np.linalg.norm(raw, axis=1)) if len(raw) else 0.0
            noise = noise if noise > rounding else math.nan
        found.append(
            SensorCheck(
                name=name,
                unit=unit,
                rate=1 / (holding.samples * step) if steps.size else 0.0,
                gap=float(np.max(steps)) if steps.size else recording.duration,
                noise=noise,
                bias=None if mean is None else float(np.linalg.norm(mean)),
                held=holding.samples,
            )
        )
    return found


def _raw_bias(q: Quantities, vector: Vector) -> np.ndarray | None:
    """Bias (3,) of an accelerometer or a magnetometer; None if the motion does not tell it.

    An accelerometer's is what the true acceleration leaves. A field b = R^T r + c has the bias c:
    least squares for it and for r, which is unknown.
    """
    if q.rotation is None:
        return None
    if vector.reference is not None:
        if (force := true_force(q, vector)) is None:
            return None
        up = np.einsum("kji,j->ki", q.rotation, np.atleast_2d(vector.reference)[0])
        off = _known(force.body - force.pulled - up)
        return np.mean(off, axis=0) if len(off) else None
    there = np.isfinite(q.rotation).all(axis=(1, 2)) & np.isfinite(vector.body).all(axis=1)
    R, b = q.rotation[there], vector.body[there]
    if not len(b):
        return None
    turned = R.mean(axis=0)
    information = np.eye(3) - turned.T @ turned
    if np.linalg.eigvalsh(information)[0] < MIN_BIAS_INFORMATION:
        return None
    left = b.mean(axis=0) - turned.T @ np.einsum("kij,kj->ki", R, b).mean(axis=0)
    return np.linalg.solve(information, left)


def _measured(recording: Recording, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Measurements (K, 3) of a sensor, and at which samples it has one (K,)."""
    kind, _, index = name.partition(" ")
    if kind in recording.sensors:
        raw = recording.sensors[kind]
        return raw, np.asarray(np.isfinite(raw).all(axis=1))
    m = recording.measurements
    if index:
        values, weights = getattr(m, f"{kind}s"), getattr(m, f"{kind}_weights")
        i = int(index)
        return np.asarray(values, np.float64)[:, i], np.asarray(weights)[:, i] > 0
    return np.asarray(getattr(m, name), np.float64), np.full(recording.samples, True)


def _unobservable(recording: Recording, q: Quantities) -> str:
    """What is missing to determine the pose, or the attitude of a recording without position.

    A sentence; "" if nothing is missing.
    """
    sensors = recording.sensors
    if recording.attitude_only and "accelerometer" in sensors and "magnetometer" not in sensors:
        return (
            "Without a magnetometer the heading is free: it starts arbitrarily and drifts. The "
            "inclination is determined."
        )
    if recording.attitude_only and "magnetometer" in sensors and "accelerometer" not in sensors:
        return (
            "The attitude can't be determined: there is no accelerometer (columns ax ay az of a "
            "CSV file)."
        )
    references = [v.reference for v in q.vectors if v.reference is not None]
    directions = np.array([np.atleast_2d(r)[0] for r in references]).reshape(-1, 3)
    if recording.attitude_only:
        told = any(v.reference is None for v in q.vectors)  # a field, whose reference is learnt
        why = "" if told else why_attitude_unobservable(directions)
        more = "" if q.vectors else ", or an accelerometer (columns ax ay az of a CSV file)"
        return f"The attitude can't be determined: {why}{more}." if why else ""
    why = why_unobservable(directions, np.array(q.places).reshape(-1, 3))
    return f"The pose can't be determined: {why}." if why else ""


def _known(values: np.ndarray) -> np.ndarray:
    """The rows of values (K, 3) that are finite."""
    return values[np.isfinite(values).all(axis=1)]
