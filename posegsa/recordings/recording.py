"""One recording: its measurements, its reference (the truth), and which samples are judged."""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jax.typing import ArrayLike

from posegsa.arguments import check_type
from posegsa.errors import PosegsaWarning, RecordingError
from posegsa.model.measurements import Measurements, checked_arrays, finite_array
from posegsa.recordings.archive import read_npz, write_npz
from posegsa.recordings.beside import (
    BAG_KEYS,
    TABLE_KEYS,
    check_references,
    path_beside,
    read_beside,
)
from posegsa.recordings.bridging import (
    bridged_samples,
    first_stamp,
    gaps_in,
    known_everywhere,
    stamp_after,
    stamps,
)
from posegsa.recordings.broad import read_broad
from posegsa.recordings.checked_files import as_path, naming
from posegsa.recordings.euroc import LANDMARKS, read_euroc
from posegsa.recordings.frames import Frame, check_stated
from posegsa.recordings.outliers import without_outliers
from posegsa.recordings.policies import Policy
from posegsa.recordings.readers import IN_WORDS, READERS
from posegsa.recordings.rosbag import Stamps, Topics, is_bag, of_unit_length, read_rosbag
from posegsa.recordings.rotations import about
from posegsa.recordings.sightings import spread_sightings, usual_intervals
from posegsa.recordings.start import (
    ASSUMED_REST,
    AVERAGING_TIME,
    Start,
    StartRule,
    aligned,
    checked_start,
)
from posegsa.recordings.streams import Between, Stream, on_one_clock
from posegsa.recordings.table import ACCELEROMETER, SENSORS, Columns, read_csv
from posegsa.recordings.truth import RecordedTruth, checked_truth
from posegsa.recordings.tum import read_tum, with_tum

LANDMARK_OUTLIER = 7.0
"""Default of `landmark_outlier`: jumps of more than this many medians are outliers."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """K samples of recorded motion, made by `from_arrays` or a reader of files.

    Frames and signs are those of the whole package: R maps body to inertial coordinates, P is the
    body's position in the inertial frame, measurements are in the body frame, in SI units, and
    quaternions are (w, x, y, z). Arrays are NumPy float64.
    """

    name: str
    time: np.ndarray
    """(K,) since the first sample [s]."""
    measurements: Measurements
    """Measurements of all sensors; weight 0 marks a missing one."""
    truth: RecordedTruth | None
    """The reference; None without one."""
    judged: np.ndarray
    """(K,) which samples are judged: the requested ones whose truth is known."""
    phases: dict[str, np.ndarray] = field(default_factory=dict)
    """Masks (K,), by name, of parts that are judged separately, such as rest and motion."""
    start: StartRule = "sensors"
    """The initial estimate. A pose; or "rest": attitude and position from the mean measurements at
    rest, biases from the velocities there; or "sensors": the pose from the mean measurements of the
    first 0.1 s, biases `start_bias`."""
    start_bias: np.ndarray = field(default_factory=lambda: np.zeros(6))
    """(6,) b_est with start "sensors" [rad/s, m/s], angular first."""
    attitude_only: bool = False
    """True if there is neither a velocity nor a landmark. The position is then not estimated and
    appears in no result."""
    sources: dict[str, str] = field(default_factory=dict)
    """For each quantity, in words: measured, or simulated from the truth and with which noise."""
    notes: tuple[str, ...] = ()
    """What was bridged, dropped or left out, with counts."""
    sensors: dict[str, np.ndarray] = field(default_factory=dict)
    """Raw signals (K, 3), body frame, for filters that use them: "accelerometer" [m/s^2],
    "magnetometer" [any unit]; NaN where missing."""
    frame: Frame | None = None
    """The inertial frame in which raw signals of an inertial sensor are compared with the truth;
    None if it was not stated. Vectors and landmarks have references instead."""
    vector_interval: np.ndarray = field(default_factory=lambda: np.ones(0))
    """(n,) factor on the weights of each vector: samples from one measurement to the next."""
    landmark_interval: np.ndarray = field(default_factory=lambda: np.ones(0))
    """(m,) the same for each landmark."""
    first_stamp: int | float = 0.0
    """The time stamp of the first sample: an integer in ns, or a float in s; 0.0 without stamps."""

    @classmethod
    def from_arrays(
        cls,
        *,
        name: str = "recording",
        time: ArrayLike | None = None,
        time_step: ArrayLike | None = None,
        origin: int | float = 0.0,
        angular_velocity: ArrayLike,
        velocity: ArrayLike | None = None,
        vectors: ArrayLike | None = None,
        vector_references: ArrayLike | None = None,
        vector_weights: ArrayLike | None = None,
        landmarks: ArrayLike | None = None,
        landmark_references: ArrayLike | None = None,
        landmark_weights: ArrayLike | None = None,
        weights_by_rate: bool = True,
        landmark_outlier: float | Literal["off"] = LANDMARK_OUTLIER,
        truth_rotation: ArrayLike | None = None,
        truth_quaternion: ArrayLike | None = None,
        truth_position: ArrayLike | None = None,
        judged: ArrayLike | None = None,
        phases: Mapping[str, ArrayLike] | None = None,
        start: StartRule | Sequence[ArrayLike] = "sensors",
        bridge: Policy | None = None,
        longest_gap: float | None = None,
        sources: Mapping[str, str] | None = None,
        sensors: Mapping[str, ArrayLike] | None = None,
        frame: Frame | None = None,
        notes: Sequence[str] = (),
    ) -> "Recording":
        """A checked recording of K samples.

        Args:
            name: its name in tables and files.
            time: (K,) time stamps: integers in ns, floats in s; or give `time_step`.
            time_step: scalar or (K,) time to the next sample [s].
            origin: the time stamp that these count from, an integer in ns or a float in s.
            angular_velocity: (K, 3) gyroscope, body frame [rad/s].
            velocity: (K, 3) linear velocity, body frame [m/s]; None for attitude only, which has no
                landmarks either.
            vectors: (K, n, 3) vectors in the body frame; NaN marks a missing one.
            vector_references: (n, 3) or (K, n, 3) the same vectors in the inertial frame.
            vector_weights: scalar, (n,) or (K, n), factors on the filter's weights; default 1.
            landmarks: (K, m, 3) landmark positions in the body frame [m]; NaN marks a missing one.
            landmark_references: (m, 3) or (K, m, 3), their inertial positions [m].
            landmark_weights: scalar, (m,) or (K, m), factors on the filter's weights; default 1.
            weights_by_rate: multiply the weights of each vector and landmark by the median number
                of samples from one of its measurements to the next. With a gyroscope at 200 Hz, a
                landmark seen at 20 Hz then corrects as much per second as one seen at 200 Hz. Only
                an observer uses these weights (`posegsa.recordings.running.as_seen`).
            landmark_outlier: a measurement of a landmark that is farther from the position which
                the velocities predict than this many times the median gets weight 0. A warning
                and `notes` say how many (`posegsa.recordings.outliers`); "off" keeps all.
            truth_rotation: (K, 3, 3) reference of R; NaN where unknown.
            truth_quaternion: (K, 4) the same as (w, x, y, z), instead.
            truth_position: (K, 3) reference of P [m]; NaN where unknown.
            judged: (K,) which samples are judged, by default all; those without truth never are.
            phases: masks (K,), by name, of parts that are judged separately. The phase "rest" is
                used for start "rest"; without it, that is the first second.
            start: "rest", "sensors" or a pose: (rotation (3, 3), position (3,)), optionally with a
                bias (6,).
            bridge: "refuse", "keep", "hold" or "interpolate": what to do where time stamps do not
                increase, velocities are NaN or there is a gap (`posegsa.recordings.bridging`). By
                default all this is refused; but without a velocity and with an accelerometer in
                `sensors` gaps are kept, and samples without velocities dropped.
            longest_gap: maximum time [s] that is bridged, by default 1 s; of a gap that is kept, by
                default an hour.
            sources: `Recording.sources`.
            sensors: `Recording.sensors`.
            frame: `Recording.frame`; only with an accelerometer among the sensors.
            notes: `Recording.notes`.

        Raises:
            MeasurementError: an array has the wrong shape or forbidden values, or something is
                missing that `bridge` does not cover; names the argument, the value and what is
                allowed. Checks that only recordings have raise its subclass `RecordingError`.
        """
        check_type("name", name, str)
        if frame is not None:
            frame = check_stated(frame, sensors or ())
        omega = finite_array("angular_velocity", angular_velocity, (None, 3), finite=False)
        samples = len(omega)
        attitude_only = velocity is None
        if attitude_only and landmarks is not None:
            raise RecordingError(
                "velocity: None with landmarks; allowed: (K, 3) [m/s], or neither (attitude only)"
            )
        linear = np.zeros_like(omega) if velocity is None else velocity
        linear = finite_array("velocity", linear, (samples, 3), finite=False)
        velocities = np.concatenate([omega, linear], axis=1)
        if infinite := np.argwhere(np.isinf(velocities)).tolist():
            k, column = infinite[0]
            name = "angular_velocity" if column < 3 else "velocity"
            raise RecordingError(
                f"{name}: must not be infinite, got {velocities[k, column]} at {(k, column % 3)}"
            )
        found = bridged_samples(
            stamps(time, time_step, samples),
            velocities,
            policy=bridge,
            longest=longest_gap,
            inertial=attitude_only and ACCELEROMETER in (sensors or {}),
        )
        omega, linear = np.hsplit(known_everywhere(found, velocities, bridge), 2)
        if truth_rotation is not None and truth_quaternion is not None:
            raise RecordingError("truth_rotation, truth_quaternion: give one of the two")
        truth = checked_truth(
            samples, truth_rotation, truth_quaternion, truth_position, attitude_only
        )
        values = checked_arrays(
            time_step=np.append(np.diff(found.time), np.median(np.diff(found.time))),
            angular_velocity=omega,
            velocity=linear,
            **spread_sightings(
                "vector", found, samples, vectors, vector_references, vector_weights
            ),
            **spread_sightings(
                "landmark", found, samples, landmarks, landmark_references, landmark_weights
            ),
        )
        changes = [*found.notes, *without_outliers(values, found.time, landmark_outlier)]
        intervals = {}
        for kind in ("vector", "landmark"):
            weights = values[f"{kind}_weights"]
            each = usual_intervals(weights > 0) if weights_by_rate else np.ones(weights.shape[1])
            values[f"{kind}_weights"] = weights * each
            intervals[f"{kind}_interval"] = each
        if truth is not None:
            truth = truth.each(lambda a: found.spread(a, math.nan))
        where = found.spread(_mask("judged", True if judged is None else judged, samples), False)
        recording = cls(
            name=name,
            time=found.time,
            measurements=Measurements(**values),
            truth=truth,
            judged=where if truth is None else where & truth.known,
            phases={
                str(key): found.spread(_mask(f"phases[{key!r}]", mask, samples), False)
                for key, mask in (phases or {}).items()
            },
            start=checked_start(start),
            attitude_only=attitude_only,
            sources={str(key): str(words) for key, words in (sources or {}).items()},
            notes=(*notes, *changes),
            sensors={
                str(key): found.spread(
                    finite_array(f"sensors[{key!r}]", signal, (samples, 3), finite=False), math.nan
                )
                for key, signal in (sensors or {}).items()
            },
            first_stamp=stamp_after(first_stamp(time, _stamp("origin", origin)), found.begin),
            frame=frame,
            **intervals,
        )
        if changes:
            warnings.warn(f"{name}: {'; '.join(changes)}", PosegsaWarning, stacklevel=2)
        return recording

    @classmethod
    def from_streams(
        cls,
        *,
        angular_velocity: Stream,
        velocity: Stream | None = None,
        vectors: Sequence[Stream] = (),
        landmarks: Sequence[Stream] = (),
        truth_quaternion: Stream | None = None,
        truth_position: Stream | None = None,
        sensors: Mapping[str, Stream] | None = None,
        clock: str | ArrayLike = "angular_velocity",
        between: Mapping[str, Between] | None = None,
        bridge: Policy | None = None,
        longest_gap: float | None = None,
        notes: Sequence[str] = (),
        **more: Any,
    ) -> "Recording":
        """A recording of sensors with time stamps of their own, put on one clock.

        A stream is a pair of time stamps (N,), integers in ns or floats in s, and values. Each of
        its samples goes to the nearest stamp of the clock; at the others the stream is missing.
        Velocities are held: at each sample they have the last value, as a filter has it live.
        `notes` say for each stream what was done, and how far its stamps are from the clock's.

        Args:
            angular_velocity: gyroscope, values (N, 3), body frame [rad/s].
            velocity: linear velocity, (N, 3), body frame [m/s]; None for attitude only.
            vectors: one stream for each vector, (N, 3), body frame.
            landmarks: one stream for each landmark, (N, 3), body frame [m].
            truth_quaternion: reference of R, (N, 4) as (w, x, y, z).
            truth_position: reference of P, (N, 3), inertial frame [m]. `read_tum` reads both.
            sensors: raw signals (N, 3), by name (`Recording.sensors`).
            clock: the stamps of the recording: the name of a stream, such as "landmarks[0]", or
                stamps (K,).
            between: for "velocity", "vectors", "landmarks", "truth" or another stream what it is
                between its samples: "missing", "hold" or "interpolate", linearly between the sample
                before and the one after, which a filter does not have live.
            bridge: as in `from_arrays`; samples of any stream whose stamps go back are dropped too.
            longest_gap: maximum time [s] that is bridged, held or interpolated.
            notes: `Recording.notes`.
            more: further arguments of `from_arrays`, such as references.

        Raises:
            RecordingError: a stream does not overlap with the clock, its stamps go back, or an
                argument is not allowed; names the stream.
            MeasurementError: as in `from_arrays`.
        """
        streams: dict[str, Any] = {
            "angular_velocity": angular_velocity,
            "velocity": velocity,
            "vectors": vectors,
            "landmarks": landmarks,
            "truth_quaternion": truth_quaternion,
            "truth_position": truth_position,
        }
        named = {name: a for name, a in streams.items() if a is not None and len(a)}
        signals = dict(sensors or {})
        how: dict[str, Any] = {"bridge": bridge or "refuse"}
        if longest_gap is not None:
            how["longest"] = longest_gap
        found = on_one_clock(named | signals, clock=clock, between=between, **how)
        found["notes"] = (*notes, *found["notes"])
        found["sensors"] = {name: found.pop(name) for name in signals}
        return cls.from_arrays(**found, bridge=bridge, longest_gap=longest_gap, **more)

    @classmethod
    def from_rosbag(
        cls,
        path: str | Path,
        topics: Topics | None = None,
        *,
        truth: str | Path | None = None,
        stamps: Stamps | None = None,
        **more: Any,
    ) -> "Recording":
        """A recording from a bag of ROS 1 or ROS 2 (`pip install "posegsa[ros]"`).

        Topics have stamps of their own and are put on the gyroscope's clock as in `from_streams`.
        A vector is divided by the length of its reference, and the reference too, so that
        accelerations and magnetic fields have the same unit.

        Args:
            path: the bag: a .bag file, or the folder, .mcap or .db3 file of ROS 2.
            topics: for each quantity its topic: {"angular_velocity": "/imu", "velocity": "/odom",
                "vectors": ["/imu", "/mag"], "landmarks": ["/tag_0"], "truth": "/mocap"}; also
                "accelerometer" and "magnetometer". `posegsa.recordings.rosbag` has their types and
                frames. By default they are read from the TOML file beside the bag
                (`posegsa.recordings.beside`); without one they are the only Imu and MagneticField.
            truth: a TUM file with the truth, instead of a topic.
            stamps: "header" (default), the time of measurement, or "bag", the time of recording.
            more: further arguments of `from_streams` and `from_arrays`, such as references,
                weights, `between` and `bridge`.

        Raises:
            RecordingError: the bag cannot be read, a topic is missing or of another type, or
                vectors or landmarks have no references; names it and what the bag has.
            MeasurementError: as in `from_arrays`.
        """
        path = as_path(path)
        given = {"topics": topics, "truth": truth, "stamps": stamps} | more
        found: dict[str, Any] = {"name": path.stem} | read_beside(path, BAG_KEYS)
        found |= {name: value for name, value in given.items() if value is not None}
        reference = found.pop("truth", None)
        streams, sources, notes = read_rosbag(
            path, found.pop("topics", None), found.pop("stamps", "header")
        )
        for name in ("vectors", "landmarks"):
            if name not in streams and (stated := f"{name[:-1]}_references") in found:
                raise RecordingError(
                    f"{path}: {stated}, but no topic for {name}; allowed: both, such as "
                    f'[topics] with {name} = ["/topic"] in {path_beside(path).name}, or neither'
                )
        if reference is not None:
            if "truth_position" in streams:
                raise RecordingError(
                    f"{path}: truth: a topic and {reference}; allowed: one of the two"
                )
            streams |= read_tum(reference)
            sources["truth"] = str(reference)
        check_references(path, streams | found)
        if "vectors" in streams:
            known = found["vector_references"]
            streams["vectors"], found["vector_references"] = of_unit_length(
                streams["vectors"], known
            )
        signals = {name: streams.pop(name) for name in SENSORS if name in streams}
        told = {"sources": sources, "sensors": signals, "notes": notes}
        return cls.from_streams(**told | streams | found)

    @classmethod
    def from_csv(
        cls,
        path: str | Path,
        columns: Columns | None = None,
        *,
        time_unit: str = "s",
        delimiter: str = ",",
        truth: str | Path | None = None,
        **more: Any,
    ) -> "Recording":
        """A recording from a CSV file with one header line; an empty cell is NaN.

        Args:
            path: the file.
            columns: for each argument of `from_arrays` the names of its columns:
                `{"time": "t", "angular_velocity": ["gx", "gy", "gz"], "vectors": [["ax", "ay",
                "az"], ["mx", "my", "mz"]]}`; "accelerometer" and "magnetometer" become `sensors`.
                By default they are read from the TOML file beside the CSV file
                (`posegsa.recordings.beside`); without one they are those of
                `posegsa.recordings.table.COLUMNS` that the CSV file has.
            time_unit: of the time stamps: "s", "ms", "us" or "ns"; integers keep all their digits.
            delimiter: between two cells.
            truth: a TUM file with the truth, by the clock of the CSV file (`from_streams`).
            more: further arguments of `from_arrays`, such as references, weights and `bridge`;
                also `between`, as in `from_streams`, for the TUM file: {"truth": "interpolate"}.

        Raises:
            RecordingError: the CSV or TOML file cannot be read, a column is missing, or vectors or
                landmarks have no references.
            MeasurementError: as in `from_arrays`.
        """
        path = as_path(path)
        beside = read_beside(path)
        table = {name: beside.pop(name) for name in TABLE_KEYS if name in beside}
        if columns is None:
            columns, time_unit, delimiter = (
                table.get(name, given)
                for name, given in zip(TABLE_KEYS, (columns, time_unit, delimiter), strict=True)
            )
        found: dict[str, Any] = {"name": path.stem}
        found |= read_csv(path, columns, time_unit, delimiter) | beside | more
        check_references(path, found)
        reference, between = truth or found.pop("truth", None), found.pop("between", None)
        found.pop("truth", None)
        if reference is not None:
            found = with_tum(found, reference, between)
        elif between is not None:
            raise RecordingError(f"{path}: between; allowed: with truth, a TUM file")
        return cls.from_arrays(**found)

    @classmethod
    def from_npz(cls, path: str | Path, **more: Any) -> "Recording":
        """A recording from an .npz file, written by `save` or by other programs.

        Args:
            path: the file; its arrays have the names of the arguments of `from_arrays`, entries of
                dictionaries names such as "phases/rest".
            more: arguments of `from_arrays` that replace those of the file.

        Raises:
            RecordingError: the file cannot be read.
            MeasurementError: as in `from_arrays`.
        """
        found: dict[str, Any] = {"name": as_path(path).stem} | read_npz(path)
        return cls.from_arrays(**found | more)

    @classmethod
    def from_euroc(
        cls,
        folder: str | Path,
        *,
        landmarks: ArrayLike | Sequence[Sequence[float]] = LANDMARKS,
        landmark_noise: float = 0.05,
        landmark_rate: float = 20.0,
        velocity_noise: float = 0.05,
        velocity_bias: ArrayLike | Sequence[float] = (0.05, -0.05, 0.02),
        seed: int = 0,
        **more: Any,
    ) -> "Recording":
        """A sequence of the EuRoC MAV data set, with simulated velocity and landmarks.

        Args:
            folder: of the sequence, with mav0/imu0/data.csv and
                mav0/state_groundtruth_estimate0/data.csv, or with `*imu0.csv` and
                `*groundtruth.csv`.
            landmarks: (m, 3) their positions in the frame of the reference [m].
            landmark_noise: standard deviation of each coordinate [m].
            landmark_rate: rate of their measurements [Hz], rounded to what the samples allow.
            velocity_noise: standard deviation of each component in each sample [m/s].
            velocity_bias: (3,) constant, body frame [m/s].
            seed: of the noise.
            more: arguments of `from_arrays` that replace those set here.

        Raises:
            RecordingError: there is no such sequence, or its files cannot be read.
            MeasurementError: as in `from_arrays`.
        """
        found = read_euroc(
            folder, landmarks, landmark_noise, landmark_rate, velocity_noise, velocity_bias, seed
        )
        return cls.from_arrays(**found | more)

    @classmethod
    def from_broad(cls, path: str | Path, **more: Any) -> "Recording":
        """A trial of the BROAD data set: attitude only, judged in motion, with start "rest".

        Args:
            path: its .mat file.
            more: arguments of `from_arrays` that replace those set here.

        Raises:
            RecordingError: the file cannot be read, or is not a trial.
            MeasurementError: as in `from_arrays`.
        """
        return cls.from_arrays(**read_broad(path) | more)

    @classmethod
    def read(cls, path: str | Path, **more: Any) -> "Recording":
        """A recording from any supported file or folder.

        They are .csv, .npz, .mat of BROAD, the folder of a EuRoC sequence, and bags of ROS 1 and 2.

        Args:
            path: the file or folder.
            more: arguments of `from_arrays` that replace those of the file, such as `bridge`.

        Raises:
            RecordingError: the kind is not supported, or it cannot be read; names the file.
            MeasurementError: as in `from_arrays`; names the file.
        """
        path = as_path(path)
        reader = READERS.get(path.suffix.lower())
        if path.is_dir():
            reader = "from_rosbag" if is_bag(path) else "from_euroc"
        if reader is None:
            what = "is not a recording" if path.exists() else "there is no such file or folder"
            raise RecordingError(f"{path}: {what}; allowed: {IN_WORDS}")
        with naming(path):
            return getattr(cls, reader)(path, **more)

    def save(self, path: str | Path) -> None:
        """Write the recording to an .npz file for `from_npz`.

        Raises:
            RecordingError: the file cannot be written.
        """
        m = {name: np.asarray(a) for name, a in self.measurements._asdict().items()}
        intervals = {kind: getattr(self, f"{kind}_interval") for kind in ("vector", "landmark")}
        seen = {}
        for kind, interval in intervals.items():
            if m[f"{kind}s"].shape[1]:
                values, weights = m[f"{kind}s"], m[f"{kind}_weights"]
                # As arguments of from_arrays: NaN where missing, weights before weights_by_rate.
                seen[f"{kind}s"] = np.where(weights[..., None] > 0, values, math.nan)
                seen[f"{kind}_references"] = m[f"{kind}_references"]
                seen[f"{kind}_weights"] = weights / interval
        if "landmarks" in seen:
            seen["landmark_outlier"] = "off"  # outliers have weight 0 already and are in the notes
        start = self.start
        if start == "sensors" and self.start_bias.any():
            start = self.initial()
        arguments = {
            "name": self.name,
            "time_step": m["time_step"],
            "origin": self.first_stamp,
            "angular_velocity": m["angular_velocity"],
            "velocity": None if self.attitude_only else m["velocity"],
            **seen,
            "truth_rotation": None if self.truth is None else self.truth.rotation,
            "truth_position": None if self.truth is None else self.truth.position,
            "judged": self.judged,
            "start": start,
            "frame": self.frame,
            "notes": self.notes,
            # Where all are 1, weights may have been left as they were given.
            "weights_by_rate": any((interval != 1).any() for interval in intervals.values()),
        }
        groups = {name: getattr(self, name) for name in ("phases", "sources", "sensors")}
        write_npz(path, arguments | groups)

    @property
    def samples(self) -> int:
        """Number of samples K."""
        return len(self.time)

    @property
    def stamps(self) -> np.ndarray:
        """(K,) time stamps as they were given: integers in ns, or floats in s."""
        if isinstance(self.first_stamp, int):
            return self.first_stamp + np.rint(1e9 * self.time).astype(np.int64)
        return self.first_stamp + self.time

    @property
    def time_step(self) -> float:
        """The median time step [s]."""
        return float(np.median(self.measurements.time_step))

    @property
    def duration(self) -> float:
        """Time from the first sample to the end of the last time step [s]."""
        return float(self.time[-1] + self.measurements.time_step[-1])

    def masks(self) -> dict[str, np.ndarray]:
        """The masks that errors are computed over: "judged", then each phase where truth is known.

        Raises:
            RecordingError: the recording has no truth.
        """
        if self.truth is None:
            raise RecordingError(f"{self.name}: has no truth, so that nothing can be judged")
        known = self.truth.known
        return {"judged": self.judged} | {name: m & known for name, m in self.phases.items()}

    def check_seen(self) -> None:
        """Raise a RecordingError unless the recording has a vector or a landmark.

        Without one nothing corrects the estimate; the error says how to name their columns.
        """
        m = self.measurements
        if np.shape(m.vectors)[1] or np.shape(m.landmarks)[1]:
            return
        told = f" ({'; '.join(self.notes)})" if self.notes else ""
        imu = ""
        if ACCELEROMETER in self.sensors:
            imu = "; `posegsa replay imu` computes vectors from accelerometer and magnetometer"
        raise RecordingError(
            f"{self.name}: has no vectors and no landmarks, so that nothing corrects an "
            f"estimate{told}; allowed in a CSV file: columns v0_x v0_y v0_z of a vector and "
            "l0_x l0_y l0_z of a landmark, or others that "
            f"{self.name}.csv.toml beside it names, in Python columns= of "
            "Recording.from_csv; in an .npz file: vectors (N, n, 3) and vector_references, or the "
            f"same of landmarks (docs/recordings.md){imu}"
        )

    def initial(self) -> Start:
        """The initial estimate according to `start`.

        Raises:
            RecordingError: the measurements do not determine it.
        """
        if isinstance(self.start, Start):
            return self.start
        self.check_seen()
        rest = self.start == "rest"
        first = max(1, int(np.sum(self.time < AVERAGING_TIME)))
        samples = self._rest() if rest else slice(0, first)
        return aligned(self.measurements, samples, None if rest else self.start_bias)

    def window(self, begin: float = 0.0, end: float = math.inf) -> "Recording":
        """The samples from `begin` to before `end` [s]; time counts from the first of them.

        A window after the beginning has start "sensors", with the biases of the recording's initial
        estimate.

        Raises:
            RecordingError: the window has fewer than two samples.
        """
        if not begin < end:
            raise RecordingError(f"window {begin!r} to {end!r}; allowed: a beginning before an end")
        inside = np.flatnonzero((self.time >= begin) & (self.time < end))
        if inside.size < 2:
            raise RecordingError(
                f"window {begin:g} to {end:g} s: holds {inside.size} samples of {self.name}; "
                f"allowed: within 0 to {self.duration:.6g} s"
            )
        part = slice(int(inside[0]), int(inside[-1]) + 1)
        later = part.start > 0
        last = "" if math.isinf(end) else f"{end:g}"
        return replace(
            self,
            name=f"{self.name}[{begin:g}:{last}]",
            time=self.time[part] - self.time[part.start],
            first_stamp=stamp_after(self.first_stamp, float(self.time[part.start])),
            measurements=self.measurements.at(part),
            truth=None if self.truth is None else self.truth.each(lambda a: a[part]),
            judged=self.judged[part],
            phases={name: mask[part] for name, mask in self.phases.items()},
            sensors={name: signal[part] for name, signal in self.sensors.items()},
            start="sensors" if later else self.start,
            start_bias=self.initial().bias
            if later and self.start != "sensors"
            else self.start_bias,
        )

    def off(self, degrees: float, metres: float = 0.0, seed: int = 0) -> "Recording":
        """The recording with an initial estimate off the truth, in random directions.

        Args:
            degrees: attitude error.
            metres: position error.
            seed: of the directions.

        Raises:
            RecordingError: the truth at the first sample is unknown.
        """
        if self.truth is None or not self.truth.known[0]:
            raise RecordingError(f"{self.name}: the truth is not known at the first sample")
        axis, along = np.random.default_rng(seed).normal(size=(2, 3))
        axis, along = axis / np.linalg.norm(axis), along / np.linalg.norm(along)
        P = self.truth.position
        rotation = about(axis, math.radians(degrees)) @ self.truth.rotation[0]
        position = np.zeros(3) if P is None else P[0] + metres * along
        return replace(self, start=Start(rotation, position, np.zeros(6)))

    def describe(self) -> str:
        """A text for people: size, sensors, what is synthetic and what was bridged."""
        counts = [
            f"{a.shape[1]} {word}{'' if a.shape[1] == 1 else 's'}"
            for word, a in (
                ("vector", self.measurements.vectors),
                ("landmark", self.measurements.landmarks),
            )
        ]
        if self.sensors and not self.measurements.vectors.shape[1]:
            counts[0] = ", ".join(self.sensors)
        judged = "no truth" if self.truth is None else f"{100 * np.mean(self.judged):.1f} % judged"
        mode = "attitude only" if self.attitude_only else "pose"
        mode += "" if self.frame is None else f", {self.frame}"
        start = "a pose" if isinstance(self.start, Start) else self.start
        lines = [
            f"{self.name}: {self.samples} samples, {self.duration:.6g} s at "
            f"{1 / self.time_step:.4g} Hz, {', '.join(counts)}, {mode}, {judged}, start: {start}"
        ]
        lines += [f"  {quantity}: {words}" for quantity, words in self.sources.items()]
        if words := gaps_in(self.time)[1]:
            lines.append(f"  gaps: {words}")
        lines += [f"  note: {note}" for note in self.notes]
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.describe().splitlines()[0]}>"

    def _rest(self) -> slice:
        """The samples at rest at the start of the recording."""
        rest = self.phases.get("rest", self.time < ASSUMED_REST)
        if not rest[0]:
            raise RecordingError(
                f'{self.name}: start "rest", but the recording begins in motion (phase "rest"); '
                'allowed: "sensors" or a pose'
            )
        return slice(0, len(rest) if rest.all() else int(np.argmin(rest)))


def _mask(name: str, mask: ArrayLike, samples: int) -> np.ndarray:
    array = np.asarray(mask)
    if array.ndim == 0:
        array = np.full(samples, array)
    if (
        array.shape != (samples,)
        or array.dtype.kind not in "bui"
        or not np.isin(array, (0, 1)).all()
    ):
        raise RecordingError(
            f"{name}: must be a mask of the shape ({samples},), of bool or 0 and 1"
        )
    return array.astype(bool)


def _stamp(name: str, stamp: Any) -> int | float:
    """A checked time stamp from a user."""
    if isinstance(stamp, Real) and not isinstance(stamp, bool) and math.isfinite(stamp):
        return int(stamp) if isinstance(stamp, Integral) else float(stamp)
    raise RecordingError(f"{name} = {stamp!r}; allowed: an integer in ns, or a float in s")
