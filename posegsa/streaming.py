"""A tuned filter on-line: one update per incoming sample, NumPy arrays in and out."""

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from posegsa.arguments import check_number, check_type, refuse
from posegsa.configuring import configured
from posegsa.errors import MeasurementError, PosegsaWarning
from posegsa.filters.attitude import AttitudeFilter
from posegsa.filters.base import Filter, check_filter
from posegsa.filters.observer import Observer
from posegsa.filters.online import OnlineLoop, OnlineParameters, OnlineRecord
from posegsa.judging.result import Result
from posegsa.model import limits
from posegsa.model.estimate import FilterState, checked_state
from posegsa.model.first_pose import first_pose
from posegsa.model.measurements import Measurements, finite_array
from posegsa.model.observability import are_collinear, why_attitude_unobservable, why_unobservable
from posegsa.recordings.imu import references as imu_references
from posegsa.stream_inputs import FirstSamples, StreamedSensors, inertial_signal, references_of
from posegsa.words import counted

FORMAT = 5
"""Version of the checkpoint's layout."""

_STILL = np.zeros(3)
_ORIGIN = np.eye(3), np.zeros(3)
_first_pose = jax.jit(first_pose)


class Pose(NamedTuple):
    """An estimated pose."""

    rotation: np.ndarray
    """(3, 3) R_est, body to inertial."""
    position: np.ndarray
    """(3,) P_est [m], inertial frame."""


class PoseFilter:
    """A filter for a stream of samples: each update takes one sample and returns the pose.

    ::

        pose_filter = posegsa.PoseFilter(result, rotation=R, position=P)
        pose = pose_filter.update(time_step=0.01, angular_velocity=w, velocity=v, vectors=seen)

    It computes what `Result.estimate` and `run_filter` compute from the same samples, to
    rounding. Making one compiles the step, which takes a few seconds for the first filter of a
    structure; an update then takes about a tenth of a millisecond (docs/streaming.md), and three
    tenths for a Kalman filter of 18 states.

    An update takes a sample and the time step to the next one, and returns the pose at the end of
    that time step. If your samples carry time stamps, keep the last sample. When the next one
    arrives, update with the kept sample and the time between the two: the pose is the present one.

    A missing value is NaN or None. If one component of a vector or landmark is NaN, all of it is
    missing; a vector of length 0 is missing too. If an angular velocity or velocity is missing, in
    whole or in part, the last measured one is held, for `hold_time` at most. After that the update
    is refused, because the held value is too old. Give zeros for a sensor that you do not have.

    A time step in milliseconds, or an acceleration in multiples of g for the attitude filter, is no
    error, but a PosegsaWarning once the first samples (FIRST_SAMPLES) all look like it.

    Without a rotation and position the filter starts from its sensors: at the first sample that
    fixes a pose by itself, with a landmark and two directions that are not parallel, of vectors and
    of landmarks about their centre (`posegsa.model.first_pose`). Until then it is `waiting`, and
    its pose is NaN. A filter without landmarks needs two vectors, and its position starts at 0.

    A refused update changes nothing. The next one may continue from there, with the whole time that
    has passed. Returned arrays are copies. A filter can be pickled; the process that unpickles it
    compiles it again.

    Args:
        source: A tuned result, the name of a configuration such as "imu", or any filter: an
            `Observer` with a schedule, a `KalmanFilter`, an `AttitudeFilter`, or your own
            (`posegsa.filters.base.Filter`). A result brings the references of its experiment or
            recordings; the weights of its recordings are in its filter.
        rotation: (3, 3) R_est at the first sample, body to inertial; by default from the sensors.
            The attitude filter begins upright and to the north by itself.
        position: (3,) P_est there [m], inertial frame, together with `rotation`.
        bias: (6,) b_est there [rad/s, m/s], body frame, angular first; zeros by default.
        vector_references: (n, 3) v_i^I, the vectors in the inertial frame, in the order of
            `update`; by default those of the result, or none. Vectors beyond those of the
            experiment have the weight 1.
        landmark_references: (m, 3) p_i, the landmarks in the inertial frame [m], likewise.
        vector_weights: scalar or (n,) factors on the filter's weights s_i^R, not negative.
        landmark_weights: scalar or (m,) factors on the weights s_i^L, likewise.
        hold_time: How long a missing velocity is held [s]. 0 refuses it at once, `math.inf` holds
            it for ever.
        observable_window: `observable` counts the sightings within this time [s].

    Raises:
        ArgumentError: The source or an argument has the wrong type or is out of range, they do not
            fit together, or the gain depends on the true errors (signal "pose"), which are unknown
            on-line.
        MeasurementError: An array has the wrong shape or invalid values; names it.
    """

    def __init__(
        self,
        source: Result | Filter | str,
        *,
        rotation: ArrayLike | None = None,
        position: ArrayLike | None = None,
        bias: ArrayLike | None = None,
        vector_references: ArrayLike | None = None,
        landmark_references: ArrayLike | None = None,
        vector_weights: ArrayLike = 1.0,
        landmark_weights: ArrayLike = 1.0,
        hold_time: float = 0.1,
        observable_window: float = 1.0,
    ) -> None:
        self._hold_time = _duration("hold_time", hold_time)
        self._window = _duration("observable_window", observable_window)
        if isinstance(source, str):
            source = configured(source)
        known = None
        stated = vector_references is not None and landmark_references is not None
        if isinstance(source, Result) and not stated:
            known = source.known_sensors
            if vector_references is None:
                vector_references = np.array(known.vectors)
            if landmark_references is None:
                landmark_references = np.array(known.landmarks)
        self._attitude_only = known is not None and known.attitude_only
        kind = source.filter.kind if isinstance(source, Result) else None
        self._inertial = kind == "imu" or isinstance(source, AttitudeFilter)
        if self._inertial:
            self._attitude_only = True
            if vector_references is None:
                vector_references = imu_references()
            rotation = np.eye(3) if rotation is None else rotation
            position = np.zeros(3) if position is None else position
        if (rotation is None) != (position is None):
            refuse("rotation, position: one without the other", "both, or neither")
        vectors = references_of("vector_references", vector_references)
        landmarks = references_of("landmark_references", landmark_references)
        if isinstance(source, Result):
            filter = _tuned(source, len(vectors), len(landmarks))
        else:
            filter = _by_hand(source)
        of_vectors = of_landmarks = None  # only an observer has weights
        if isinstance(filter, Observer):
            settings = filter.settings
            of_vectors, of_landmarks = settings.vectors.weights, settings.landmark_weights
        self._vectors = StreamedSensors("vector", vectors, vector_weights, of_vectors)
        self._landmarks = StreamedSensors("landmark", landmarks, landmark_weights, of_landmarks)
        self._dtype, self._kind = _dtype_of(filter), type(filter).__name__
        limits.VECTOR.checked("vector_references", vectors)
        if self._inertial and len(vectors) == 2 and are_collinear(*vectors):
            refuse("vector_references: are parallel", "up and north, which are not")
        limits.POSITION.checked("landmark_references", landmarks)
        self._bias = np.zeros(6) if bias is None else finite_array("bias", bias, (6,)).copy()
        given = None if rotation is None or position is None else (rotation, position)
        start = self._state(*(given or _ORIGIN), bias)
        parameters = OnlineParameters(filter, vectors, landmarks)
        with jax.enable_x64(self._dtype == np.float64):
            self._loop = OnlineLoop(parameters, start)
        where = self._loop.record.unpack(np.arange(self._loop.record.size))
        self._rotation_at, estimate = where.rotation, where.estimate
        self._quaternion_at, self._position_at = map(np.array, (estimate.attitude, estimate.place))
        self._estimate_at = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(estimate)])
        self._origin = self._loop.start(start)
        """The record before the first sample, at a given pose or at the origin."""
        self._start = self._origin
        if given is None:
            self._start = np.full_like(self._origin, np.nan)
            exact = vectors, self._vectors.factors, landmarks, self._landmarks.factors
            if self._shown(*exact) is None:
                refuse(
                    f"rotation, position: not given, and {counted(len(vectors), 'vector')} and "
                    f"{counted(len(landmarks), 'landmark')} never show a pose in one sample",
                    "both; or two directions that are not parallel, and a landmark",
                )
        gravity = float(np.linalg.norm(vectors[0])) if self._inertial and len(vectors) else None
        self._first = FirstSamples(gravity)
        self._begin(self._start)

    def update(
        self,
        *,
        time_step: float,
        angular_velocity: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        vectors: ArrayLike | Sequence[ArrayLike | None] | None = None,
        landmarks: ArrayLike | Sequence[ArrayLike | None] | None = None,
        vector_weights: ArrayLike | None = None,
        landmark_weights: ArrayLike | None = None,
        gyr: ArrayLike | None = None,
        acc: ArrayLike | None = None,
        mag: ArrayLike | None = None,
    ) -> Pose:
        """Process one sample. The class documents how missing values are handled.

        Args:
            time_step: From this sample to the next [s], positive.
            angular_velocity: (3,) gyroscope, body frame [rad/s].
            velocity: (3,) linear velocity, body frame [m/s].
            vectors: (n, 3) vectors in the body frame, in the unit of their sensor.
            landmarks: (m, 3) landmark positions in the body frame [m].
            vector_weights: scalar or (n,) factors on the weights of this sample; by default those
                of the constructor.
            landmark_weights: scalar or (m,) likewise.
            gyr: (3,) another name of `angular_velocity`.
            acc: (3,) specific force [m/s^2], 9.8 upwards at rest, body frame; only for the attitude
                filter, for which acc and mag are other names of the two `vectors`.
            mag: (3,) magnetic field in any unit, body frame; likewise.

        Returns:
            The pose at the next sample, `time_step` later.

        Raises:
            MeasurementError: An array has the wrong shape, a number or the new estimate is outside
                the limits of `posegsa.model.limits` (the exported C has the same), or a velocity
                has been missing for longer than `hold_time`.
        """
        dt = float(limits.TIME_STEP.checked("time_step", finite_array("time_step", time_step, ())))
        ages = self._ages + self._time_step
        if gyr is not None:
            if angular_velocity is not None:
                refuse("gyr with angular_velocity", "one of the two")
            angular_velocity = gyr
        if acc is not None or mag is not None:
            if not self._inertial or vectors is not None:
                refuse("acc, mag", "without vectors, and only for the attitude filter (imu)")
            vectors = [inertial_signal("acc", acc), inertial_signal("mag", mag)]
        omega = self._held("angular_velocity", angular_velocity, 0, ages, limits.ANGULAR_VELOCITY)
        still = velocity is None and self._attitude_only
        v = self._held("velocity", _STILL if still else velocity, 1, ages, limits.VELOCITY)
        vectors_seen, vector_factors = self._vectors.seen(vectors, vector_weights)
        landmarks_seen, landmark_factors = self._landmarks.seen(landmarks, landmark_weights)
        factors = np.concatenate([vector_factors, landmark_factors])
        before = self._record
        if self.waiting:
            shown = self._shown(vectors_seen, vector_factors, landmarks_seen, landmark_factors)
            before = before if shown is None else self._loop.start(self._state(*shown, self._bias))
        sample = [
            *([self._time, dt], omega, v),
            *(vectors_seen.ravel(), vector_factors, landmarks_seen.ravel(), landmark_factors),
        ]  # the time, then in the order of Measurements
        if not np.isnan(before).all():
            record = self._loop(before, np.concatenate(sample).astype(self._dtype))
            self._check_estimate(record)
            self._record = record
        ages[2:][factors > 0] = 0
        self._ages, self._velocities = ages, (omega, v)
        self._time, self._time_step = self._time + dt, dt
        self._first.see(dt, vectors_seen)
        return self.pose

    def __repr__(self) -> str:
        waiting = ", waiting" if self.waiting else ""
        return f"<PoseFilter of {self._kind} at {self._time:.6g} s{waiting}>"

    @property
    def pose(self) -> Pose:
        """The pose that the last update returned; before the first, the initial pose."""
        return Pose(self._record[self._rotation_at], self._record[self._position_at])

    @property
    def waiting(self) -> bool:
        """Whether no sample has shown a pose to start from yet."""
        return bool(np.isnan(self._record[self._rotation_at]).all())

    @property
    def state(self) -> FilterState:
        """The filter's whole estimate; `run_filter` takes it as its start."""
        return jax.tree.map(np.copy, self._unpacked.estimate)

    @property
    def bias(self) -> np.ndarray:
        """(6,) b_est of the velocities [rad/s, m/s], body frame, angular first."""
        estimate = self._unpacked.estimate
        return np.array(estimate.bias_angular + estimate.bias_linear)

    @property
    def vector_bias(self) -> np.ndarray:
        """(n, 3) c_i of each vector, body frame, in its unit; (0, 3) if they are not estimated."""
        biases = self._unpacked.estimate.vector_biases
        return np.array(biases, self._dtype).reshape(-1, 3)

    @property
    def covariance(self) -> np.ndarray | None:
        """(6, 6) covariance of the pose error; None for a filter without one.

        The error is xi = [theta; rho] (rad, m) in the body frame, T = T_est exp(xi^). So the
        standard deviations are the roots of the diagonal, and R_est Sigma_rho R_est^T is the
        covariance of the position in the inertial frame.
        """
        covariance = self._unpacked.covariance
        return None if covariance is None else np.array(covariance)

    @property
    def nis(self) -> float:
        """Normalised innovation squared of the last update over its degrees of freedom.

        It is 1 on average if the filter's noises are right; NaN at the start and for a filter
        without a covariance, 0 if nothing was measured.
        """
        return _number(self._unpacked.nis)

    @property
    def gain(self) -> float:
        """The schedule's gain K of the last update [1/s], before the limit; NaN at the start."""
        return _number(self._unpacked.gain)

    @property
    def gain_used(self) -> float:
        """The gain K of the last update after the gain limit, mean over the sub-steps [1/s]."""
        return _number(self._unpacked.gain_used)

    @property
    def own_state(self) -> Any:
        """The filter's own state; an `AttitudeState` has rest, belief and standard deviations."""
        return jax.tree.map(np.copy, self._unpacked.state)

    @property
    def time(self) -> float:
        """Time of the pose since the first sample [s], the sum of all time steps."""
        return self._time

    @property
    def observable(self) -> bool:
        """Whether the sightings within `observable_window` determine the pose.

        For a result on recordings without position: whether they determine the attitude.
        Sightings at different times count together, because the velocities connect them; not while
        the filter is `waiting` for one sample that shows a pose.
        If False, the pose drifts, or a wrong pose would go unnoticed; `why_unobservable` says what
        is missing.
        """
        return not self.why_unobservable

    @property
    def why_unobservable(self) -> str:
        """If the pose is not observable, what was seen lately and what is needed; else ""."""
        if self.waiting:
            return (
                "waiting: no sample has shown a pose by itself; needed in one sample are two "
                "directions that are not parallel, and a landmark if there are any"
            )
        recent = self._ages[2:] <= self._window * (1 + 1e-9)
        vectors, landmarks = self._vectors, self._landmarks
        n = len(vectors.references)
        if self._attitude_only and not len(landmarks.references):
            why = why_attitude_unobservable(vectors.references, vectors.weights * recent[:n])
        else:
            why = why_unobservable(
                vectors.references,
                landmarks.references,
                vectors.weights * recent[:n],
                landmarks.weights * recent[n:],
            )
        return f"in the last {self._window:g} s: {why}" if why else ""

    def reset(
        self,
        rotation: ArrayLike | None = None,
        position: ArrayLike | None = None,
        bias: ArrayLike | None = None,
    ) -> None:
        """Start again, as if just constructed: from the initial pose or the sensors, or at a pose.

        Args:
            rotation: (3, 3) R_est, body to inertial.
            position: (3,) P_est [m], inertial frame; both or neither.
            bias: (6,) b_est [rad/s, m/s]; zeros by default where a pose is given.

        Raises:
            ArgumentError: Only a part of a pose is given.
            MeasurementError: An argument has the wrong shape, is not finite, or is not a rotation.
        """
        if rotation is None and position is None and bias is None:
            self._begin(self._start)
            return
        if rotation is None or position is None:
            refuse("rotation, position: one without the other", "both, or neither")
        self._begin(self._loop.start(self._state(rotation, position, bias)))

    def checkpoint(self) -> dict[str, np.ndarray]:
        """The filter's whole state, for `restore`; `numpy.savez` can write it."""
        return {
            "format": np.array(FORMAT),
            "structure": np.array(self._loop.structure),
            "parameters": self._loop.parameters.copy(),
            "record": self._record.copy(),
            "ages": self._ages.copy(),
            "velocities": np.array(self._velocities),
            "bias": self._bias.copy(),
            "clock": np.array([self._time, self._time_step]),
        }

    def restore(self, checkpoint: Mapping[str, np.ndarray]) -> None:
        """Continue from a checkpoint of a filter made with the same arguments, bit by bit the same.

        Args:
            checkpoint: From `checkpoint`, or as read by `numpy.load`.

        Raises:
            ArgumentError: It is not a checkpoint, has another format, is of a filter with other
                laws, rules or numbers, or holds invalid values such as NaN.
        """
        check_type("checkpoint", checkpoint, Mapping, allowed="a mapping of arrays")
        own = self.checkpoint()
        given = {name: _stored(checkpoint, name, like) for name, like in own.items()}
        if given["format"] != FORMAT:
            refuse(f"checkpoint: format {given['format']}", f"format {FORMAT}")
        for name, what in (("structure", "laws or rules"), ("parameters", "numbers")):
            if not np.array_equal(given[name], own[name]):
                refuse(f"checkpoint: of a filter with other {what}", "one of this filter's own")
        if (given["clock"] < 0).any():
            refuse("checkpoint: clock holds a negative time", "times from 0 on")
        known = {
            name: np.isfinite(given[name]) for name in ("record", "velocities", "bias", "clock")
        }
        if np.isnan(self._start).all() and np.isnan(given["record"]).all():  # it is waiting
            known["record"] = np.ones(len(given["record"]), bool)
        elif given["clock"][0] == 0:  # a new filter has some NaN, such as the last error
            known["record"] |= ~np.isfinite(self._origin)
        else:  # the state may hold infinity, the estimate not (`_check_estimate`)
            hidden = np.ones(len(known["record"]), bool)
            hidden[self._estimate_at] = False
            known["record"] |= hidden & ~np.isnan(given["record"])
        for name, finite in known.items():
            if not finite.all():
                refuse(f"checkpoint: {name} holds NaN or infinity", "finite numbers")
        if not (given["ages"] >= 0).all():
            refuse("checkpoint: ages holds NaN or a negative number", "numbers from 0 on")
        self._record, self._ages, self._bias = given["record"], given["ages"], given["bias"]
        self._velocities = tuple(given["velocities"])
        self._time, self._time_step = given["clock"].tolist()

    @property
    def _unpacked(self) -> OnlineRecord:
        return self._loop.record.unpack(self._record)

    def _shown(
        self,
        vectors: np.ndarray,
        of_vectors: np.ndarray,
        landmarks: np.ndarray,
        of_landmarks: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Rotation and position that measurements (n, 3), (m, 3) show, if they fix a pose.

        Weights are (n,) and (m,), 0 for a missing one.
        """
        # A sensor that the filter gives no weight is not asked.
        of_vectors, of_landmarks = (
            factors * (sensors.weights > 0)
            for factors, sensors in ((of_vectors, self._vectors), (of_landmarks, self._landmarks))
        )
        if np.count_nonzero(of_vectors) + np.count_nonzero(of_landmarks) < 2:
            return None  # too few; and nothing is compiled for a filter without sensors
        still = np.zeros(3)
        v, p = self._vectors.references, self._landmarks.references
        sensors = vectors, v, of_vectors, landmarks, p, of_landmarks
        rows = [np.asarray(a)[None] for a in (1.0, still, still, *sensors)]
        with jax.enable_x64(self._dtype == np.float64):
            found = _first_pose(Measurements(*(jnp.asarray(a, self._dtype) for a in rows)))
        return None if int(found.sample) else (np.array(found.rotation), np.array(found.position))

    def _state(
        self, rotation: ArrayLike, position: ArrayLike, bias: ArrayLike | None
    ) -> FilterState:
        P = limits.POSITION.checked("position", finite_array("position", position, (3,)))
        b = np.zeros(6) if bias is None else finite_array("bias", bias, (6,))
        limits.ANGULAR_VELOCITY.checked("bias", b[:3])
        limits.VELOCITY.checked("bias", b[3:])
        with jax.enable_x64(self._dtype == np.float64):
            return checked_state(rotation, P, b, self._dtype)

    def _check_estimate(self, record: np.ndarray) -> None:
        """Refuse a record that is not an estimate.

        Raises:
            MeasurementError: It holds NaN, an estimate that is infinite, or no rotation.
        """
        # The state may hold infinity, such as the time since a sensor was seen.
        if np.isnan(record).any() or not np.isfinite(record[self._estimate_at]).all():
            raise MeasurementError("the estimate would be NaN or infinite, or the gain is below 0")
        excess = abs(np.square(record[self._quaternion_at]).sum() - 1)
        if excess > limits.UNIT_TOLERANCE:
            raise MeasurementError(
                "the squared length of the estimated quaternion would differ from 1 by "
                f"{excess:g}; allowed: {limits.UNIT_TOLERANCE:g} at most"
            )

    def _begin(self, record: np.ndarray) -> None:
        sensors = len(self._vectors.references) + len(self._landmarks.references)
        self._record = record
        self._time = self._time_step = 0.0
        self._ages = np.full(2 + sensors, np.inf)
        """Time since both velocities, each vector and each landmark were last measured [s]."""
        self._velocities = np.zeros(3), np.zeros(3)
        """The last measured velocities."""

    def _held(
        self, name: str, value: ArrayLike | None, which: int, ages: np.ndarray, limit: limits.Limit
    ) -> np.ndarray:
        """The measured velocity; if it is missing, the last one unless that is too old."""
        if value is not None:
            measured = finite_array(name, value, (3,), finite=False)
            if not np.isnan(measured).any():
                ages[which] = 0
                return limit.checked(name, measured)
        age = ages[which]
        if age <= self._hold_time * (1 + 1e-9):
            return self._velocities[which]
        since = "from the first sample on" if np.isinf(age) else f"for {age:g} s"
        raise MeasurementError(
            f"{name}: missing {since}; allowed: for hold_time = {self._hold_time:g} s at most, "
            "while the last one is held"
        )


def _tuned(result: Result, vectors: int, landmarks: int) -> Filter:
    """The filter of a result, for these numbers of vectors and landmarks."""
    observer = result.experiment.filter.kind == "observer"
    if observer and result.experiment.gain.signal == "pose":
        refuse(
            'source: a result tuned on the true errors (gain.signal = "pose"), which no vehicle '
            "knows",
            'one tuned with gain.signal = "measured"',
        )
    if found := result.warnings():
        warnings.warn(f"the result says: {'; '.join(found)}", PosegsaWarning, stacklevel=4)
    with jax.enable_x64(result.experiment.run.dtype == "float64"):
        return result.filter_for(vectors, landmarks)


def _by_hand(source: Any) -> Filter:
    """A user's filter, with all its numbers in one floating-point type."""
    check_filter("source", source, "a Result (posegsa.load reads one)")
    kinds = {leaf.dtype for leaf in jax.tree.leaves(source) if hasattr(leaf, "dtype")}
    if wrong := [kind for kind in kinds if kind.kind != "f"]:
        refuse(f"source: holds {wrong[0]}", "a filter of floating numbers")
    if isinstance(source, Observer) and source.signal.signal == "pose":
        refuse('source.signal: "pose", the true errors, which no vehicle knows', '"measured"')
    dtype = _dtype_of(source)
    with np.errstate(over="ignore"), jax.enable_x64(dtype == np.float64):
        return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf, dtype)), source)


def _dtype_of(filter: Filter) -> np.dtype:
    """The widest floating-point type of a filter's arrays, at least float32."""
    dtypes = (leaf.dtype for leaf in jax.tree.leaves(filter) if hasattr(leaf, "dtype"))
    return np.result_type(np.float32, *(dtype for dtype in dtypes if dtype.kind == "f"))


def _number(value: Any) -> float:
    """A number of a record; NaN if the filter has no such number."""
    return math.nan if value is None else float(value)


def _duration(name: str, value: float) -> float:
    """A time of at least 0 [s]; infinity is allowed."""
    if value != math.inf:
        check_number(name, value, 0.0)
    return float(value)


def _stored(checkpoint: Mapping[str, np.ndarray], name: str, like: np.ndarray) -> np.ndarray:
    """An array of a checkpoint; its shape and dtype must be those of the filter's own."""
    if name not in checkpoint:
        refuse(f"checkpoint: without {name!r}", "one from PoseFilter.checkpoint")
    array = np.array(checkpoint[name])
    if array.shape != like.shape or array.dtype != like.dtype:
        refuse(
            f"checkpoint: {name} of {array.dtype} {array.shape}",
            f"{like.dtype} {like.shape}, as of a filter with these vectors and landmarks",
        )
    return array
