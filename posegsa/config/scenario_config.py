"""The scenario: true motion, sensors and initial estimate; by default the paper's (Section V)."""

import math
from collections.abc import Iterator
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from posegsa.model.observability import are_collinear, why_unobservable
from posegsa.settings.fields import (
    MAX_SAMPLES,
    Count,
    Matrix3,
    NonNegative,
    Number,
    Positive,
    Section,
    Tunable,
    Vector3,
    Vector6,
)
from posegsa.settings.violations import Violation, refusal

_ZERO_LENGTH = 1e-12
"""A direction counts as zero up to this length, in its unit."""

_IDENTITY: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_ROTATION_WITHIN = {"initial_rotation": 1e-6, "initial_rotation_estimate": 0.1}
"""Allowed deviation of singular values from one; the paper's estimate is printed rounded."""


class Sine(Section):
    """amplitude * sin(frequency * t + phase), t in seconds since the start."""

    amplitude: Number
    """Amplitude, in the unit of the sum: rad/s or m/s."""
    frequency: Number
    """Angular frequency [rad/s]."""
    phase: Number = 0.0
    """Phase [rad]."""


class Vector(Section):
    """A direction, such as gravity, known in the inertial frame and measured in the body frame."""

    direction: Vector3
    """v_i^I, inertial frame, in the unit of its sensor; not zero, of any length."""
    bias: Vector3 = (0.0, 0.0, 0.0)
    """Bias b_i^B of the measurement, body frame, same unit."""
    noise: NonNegative = 0.1
    """Standard deviation of the noise n_i^B of each component, body frame, same unit."""
    weight: Annotated[NonNegative, Tunable()] = 1.0
    """Weight s_i^R in the filter, no unit; 0 leaves the vector out."""
    period: Count = 1
    """Samples from one measurement to the next."""
    begin: NonNegative = 0.0
    """Time of the first measurement [s]."""

    @field_validator("direction")
    @classmethod
    def _not_zero(cls, direction: Vector3) -> Vector3:
        if math.hypot(*direction) <= _ZERO_LENGTH:
            raise refusal(direction, "a vector that is not zero")
        return direction


class Landmark(Section):
    """A point known in the inertial frame and measured in the body frame."""

    position: Vector3
    """p_i^I, inertial frame [m]."""
    bias: Vector3 = (0.0, 0.0, 0.0)
    """Bias of the measured position, body frame [m]; the paper gives none."""
    noise: NonNegative = 0.1
    """Standard deviation of the noise of each component, body frame [m]."""
    weight: Annotated[NonNegative, Tunable()] = 1.0
    """Weight s_i^L in the filter, no unit; 0 leaves the landmark out."""


Interval = tuple[NonNegative, NonNegative]
"""Beginning and end [s]."""
Axis = Annotated[tuple[Sine, ...], Field(max_length=64)]
Sines = tuple[Axis, Axis, Axis]
"""A velocity over time: for each body axis x, y, z a sum of sines (an empty one is zero)."""


def _sines(*axes: tuple[float, float, float]) -> Sines:
    """One sine per axis, each given by amplitude, frequency and phase."""
    x, y, z = ((Sine(amplitude=a, frequency=f, phase=p),) for a, f, p in axes)
    return (x, y, z)


class ScenarioConfig(Section):
    """[scenario]: truth, sensors and initial estimate."""

    duration: Positive = 60.0
    """Length of the run [s]; a whole number of samples, at least two."""
    sampling_time: Positive = 0.01
    """Time from one sample to the next [s]."""

    angular_velocity: Sines = _sines((1.0, 0.7, 0.0), (0.7, 0.5, math.pi), (0.5, 0.3, math.pi / 3))
    """True angular velocity Omega, body frame [rad/s]: for each axis a sum of sines."""
    angular_velocity_bias: Vector3 = (0.1, -0.1, 0.1)
    """Bias b_Omega of the measured angular velocity, body frame [rad/s]."""
    angular_velocity_noise: NonNegative = 0.2
    """Standard deviation of the noise of each of its components, body frame [rad/s]."""
    angular_velocity_drift: NonNegative = 0.0
    """Intensity of the random walk of each component of its bias [rad/s/sqrt(s)]."""
    velocity: Sines = _sines((0.3, 0.6, 0.0), (0.3, 0.4, 0.0), (0.3, 0.1, 0.0))
    """True linear velocity V, body frame [m/s]: for each axis a sum of sines."""
    velocity_bias: Vector3 = (0.2, 0.5, 0.1)
    """Bias b_V of the measured linear velocity, body frame [m/s]."""
    velocity_noise: NonNegative = 0.1
    """Standard deviation of the noise of each of its components, body frame [m/s]."""
    velocity_drift: NonNegative = 0.0
    """Intensity of the random walk of each component of its bias [m/s/sqrt(s)]."""
    rest: Annotated[tuple[Interval, ...], Field(max_length=64)] = ()
    """Times at rest, beginning and end [s], during which both velocities are 0."""

    vectors: Annotated[tuple[Vector, ...], Field(max_length=64)] = (
        Vector(
            direction=(1 / math.sqrt(3), -1 / math.sqrt(3), 1 / math.sqrt(3)),
            bias=(0.1, -0.1, 0.1),
        ),
        Vector(direction=(0.0, 0.0, 1.0), bias=(0.0, 0.0, 0.1)),
    )
    """The vectors v_i that are measured, in order."""
    landmarks: Annotated[tuple[Landmark, ...], Field(max_length=64)] = (
        Landmark(position=(0.5, math.sqrt(2), 1.0)),
    )
    """The landmarks p_i that are measured, in order; at least one."""
    landmark_period: Count = 1
    """Samples from one measurement of the landmarks to the next."""

    start: Literal["given", "sensors", "rest"] = "given"
    """Where the estimate starts: "given", at the initial estimate below, or at the wrong one that
    the family draws; "sensors", at the pose that fits the first sample whose vectors and landmarks
    determine one; "rest", at that pose, with the velocities' means over the following second as
    their biases. Before that sample nothing is estimated and nothing counts in the cost."""
    initial_rotation: Matrix3 = _IDENTITY
    """True attitude R(0), body to inertial frame, by rows, no unit."""
    initial_position: Vector3 = (0.0, 0.0, 0.0)
    """True position P(0), inertial frame [m]."""
    initial_rotation_estimate: Matrix3 = (
        (-0.829, 0.293, 0.343),
        (0.399, 0.157, 0.903),
        (0.210, 0.943, -0.257),
    )
    """Estimated attitude at the start, body to inertial frame, by rows, no unit. It may be rounded,
    as the paper's is (determinant 0.943): the nearest rotation is used."""
    initial_position_estimate: Vector3 = (4.0, -3.0, 5.0)
    """Estimated position at the start, inertial frame [m]."""
    initial_bias_estimate: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """Estimated velocity biases at the start, body frame: b_Omega [rad/s], then b_V [m/s]."""

    @property
    def samples(self) -> int:
        """Number of samples: duration over sampling time."""
        return round(self.duration / self.sampling_time)

    @field_validator("initial_rotation", "initial_rotation_estimate")
    @classmethod
    def _is_a_rotation(cls, matrix: Matrix3, info: ValidationInfo) -> Matrix3:
        within = _ROTATION_WITHIN[info.field_name or ""]
        if not _near_rotation(np.array(matrix), within):
            raise refusal(
                matrix,
                "a rotation matrix: determinant above 0, all singular values equal to 1 within "
                f"{within:g}",
            )
        return matrix

    def _conflicts(self) -> Iterator[Violation]:
        ratio = self.duration / self.sampling_time
        if not (2 <= round(ratio) <= MAX_SAMPLES and abs(ratio - round(ratio)) <= 1e-6):
            yield Violation(
                "duration",
                f"allowed: a whole number of samples, 2 to {MAX_SAMPLES}; with sampling_time = "
                f"{self.sampling_time} these are {ratio:.9g}",
                self.duration,
            )
        for i, (begin, end) in enumerate(self.rest):
            if begin > end:
                yield Violation(f"rest.{i}", "allowed: a beginning before the end", (begin, end))

    @property
    def cross_vector(self) -> Vector3 | None:
        """v_1 x v_2 of the first two vectors at length one; None where it is not defined."""
        if len(self.vectors) < 2:
            return None
        first, second = (vector.direction for vector in self.vectors[:2])
        if are_collinear(first, second):
            return None
        x, y, z = np.cross(
            np.array(first) / math.hypot(*first), np.array(second) / math.hypot(*second)
        )
        return (float(x), float(y), float(z))

    def observability_conflicts(self, cross_vector_weight: float) -> Iterator[Violation]:
        """A violation if the vectors and landmarks of the filter do not determine the pose.

        Args:
            cross_vector_weight: Weight of `cross_vector` in the filter; 0 without it.
        """
        vectors = [(vector.direction, vector.weight) for vector in self.vectors]
        product = self.cross_vector if cross_vector_weight > 0 else None
        if product:
            vectors.append((product, cross_vector_weight))
        why = why_unobservable(
            [direction for direction, _ in vectors],
            [landmark.position for landmark in self.landmarks],
            [weight for _, weight in vectors],
            [landmark.weight for landmark in self.landmarks],
        )
        if why:
            these = "these, their cross product" if product else "these"
            yield Violation(
                "vectors", f"with {these} and the landmarks, the pose is not observable: {why}"
            )


def _near_rotation(matrix: np.ndarray, within: float) -> bool:
    """Whether a matrix is a rotation, with singular values within this distance of 1."""
    if np.max(np.abs(matrix)) > 1 + within:  # larger numbers would overflow below
        return False
    stretch = np.linalg.svd(matrix, compute_uv=False)
    return bool(np.max(np.abs(stretch - 1)) <= within and np.linalg.det(matrix) > 0)
