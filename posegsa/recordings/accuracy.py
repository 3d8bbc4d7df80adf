"""Errors of estimates against a recording's reference: total, heading, inclination, position.

With the error quaternion q_err = q_est q_ref^-1 = (w, x, y, z) in the inertial frame, whose z axis
is vertical (D. Laidig et al., "BROAD - a benchmark for robust inertial orientation estimation",
Data 6(7):72, 2021):

    total        2 arccos |w|                    the angle of the whole error
    heading      2 arctan |z / w|                the part that a rotation about the vertical removes
    inclination  2 arccos sqrt(w^2 + z^2)        the part that remains after that rotation

The position error is |P_est - P|, as in other tools for trajectories.

NEES and NIS tell whether the covariance of a filter that has one is right (`filters.uncertainty`).
"""

from typing import Annotated, NamedTuple

import numpy as np
from jax.typing import ArrayLike

from posegsa.arguments import check_type
from posegsa.errors import RecordingError
from posegsa.filters.rollout import Estimates
from posegsa.model.measurements import finite_array
from posegsa.recordings.recording import Recording
from posegsa.recordings.rotations import inverse, log, product, quaternions
from posegsa.recordings.truth import all_finite
from posegsa.settings.arrays import Numbers

BLOCK, FEWEST_BLOCKS = 5.0, 4
"""Length of a block [s], and the blocks that a recording needs for a confidence interval."""
BLOCKS_IN_FIGURE = 20
"""Number of blocks, for a figure, of a recording that is too short for such an interval."""
FAR = 1e-4
"""Angle [rad] below which the limit of c in `pose_nees` is as accurate as its closed form."""
AnyNumber = Annotated[float, Numbers(allow="any")]
"""A number that may be NaN, or infinite if a filter diverged."""


class AttitudeErrors(NamedTuple):
    """Errors of each sample [deg]; NaN where the truth or the estimate is NaN."""

    total: np.ndarray
    heading: np.ndarray
    inclination: np.ndarray


class Rmse(NamedTuple):
    """Root mean square errors, and means of NEES and NIS, over the samples of a phase.

    NaN if it has none.
    """

    total: AnyNumber
    """[deg]"""
    heading: AnyNumber
    """[deg]"""
    inclination: AnyNumber
    """[deg]"""
    position: AnyNumber | None
    """[m]; None if the position is not judged."""
    samples: int
    """Number of samples."""
    nees: AnyNumber | None = None
    """6 if the filter's covariance is right; None without one, or if the position is not judged."""
    nis: AnyNumber | None = None
    """1 if the filter's noises are right, NaN where nothing was measured; None for a filter that
    has none."""


class Blocks(NamedTuple):
    """Mean square errors in blocks of a recording's judged samples, for confidence intervals.

    Errors of neighbouring samples are correlated, those of blocks of some seconds hardly are. A
    recording that is too short for such blocks has shorter ones, for a figure alone.
    """

    attitude: list[AnyNumber]
    """Mean square attitude error of each block [deg^2]."""
    position: list[AnyNumber] | None
    """Mean square position error [m^2]; None if the position is not judged."""


class RecordingErrors(NamedTuple):
    """The errors of estimates over the K samples of a recording."""

    time: np.ndarray
    """(K,) [s]."""
    attitude: AttitudeErrors
    """Each (K,) [deg]."""
    position: np.ndarray | None
    """(K,) [m]; None if the position is not judged."""
    masks: dict[str, np.ndarray]
    """The samples of each phase, "judged" first."""
    nees: np.ndarray | None = None
    """(K,) normalised estimation error squared of the pose (`pose_nees`); None as in `Rmse`."""
    nis: np.ndarray | None = None
    """(K,) normalised innovation squared, NaN where nothing was measured, infinite where the
    estimate is not finite; None as in `Rmse`."""

    def rmse(self) -> dict[str, Rmse]:
        """Root mean square errors, NEES and NIS by phase, without empty phases."""
        return {
            name: Rmse(
                total=rmse(self.attitude.total, mask),
                heading=rmse(self.attitude.heading, mask),
                inclination=rmse(self.attitude.inclination, mask),
                position=None if self.position is None else rmse(self.position, mask),
                samples=int(mask.sum()),
                nees=None if self.nees is None else known_mean(self.nees[mask]),
                nis=None if self.nis is None else known_mean(self.nis[mask]),
            )
            for name, mask in self.masks.items()
            if name == "judged" or mask.any()
        }

    def blocks(self) -> Blocks:
        """Mean square errors in blocks of BLOCK seconds of the judged samples.

        Of a recording with fewer than FEWEST_BLOCKS they are in BLOCKS_IN_FIGURE blocks.
        """
        judged = np.flatnonzero(self.masks["judged"])
        length = max(1, int(BLOCK / np.median(np.diff(self.time))))
        count = round(len(judged) / length)
        if count < FEWEST_BLOCKS:
            count = min(BLOCKS_IN_FIGURE, len(judged))
        parts = np.array_split(judged, max(1, count))
        squares = [
            None if errors is None else [rmse(errors[part]) ** 2 for part in parts]
            for errors in (self.attitude.total, self.position)
        ]
        return Blocks(squares[0] or [], squares[1])


def attitude_errors(estimated: ArrayLike, true: ArrayLike) -> AttitudeErrors:
    """Total, heading and inclination errors (K,) [deg] of rotations (K, 3, 3), body to inertial.

    Raises:
        MeasurementError: an array has the wrong shape or length.
    """
    est = finite_array("estimated", estimated, (None, 3, 3), finite=False)
    ref = finite_array("true", true, (len(est), 3, 3), finite=False)
    # A filter that diverged may return infinities; NumPy warns about their differences.
    est = np.where(np.isfinite(est).all(axis=(1, 2), keepdims=True), est, np.nan)
    w, x, y, z = product(quaternions(est), inverse(quaternions(ref))).T
    # The arc cosines of the module docstring, in a form that is accurate for small errors.
    total = np.arctan2(np.sqrt(x * x + y * y + z * z), np.abs(w))
    inclination = np.arctan2(np.hypot(x, y), np.hypot(w, z))
    heading = np.arctan2(np.abs(z), np.abs(w))
    return AttitudeErrors(*(2 * np.degrees(a) for a in (total, heading, inclination)))


def position_errors(estimated: ArrayLike, true: ArrayLike) -> np.ndarray:
    """Distances (K,) [m] of positions (K, 3).

    Raises:
        MeasurementError: an array has the wrong shape or length.
    """
    est = finite_array("estimated", estimated, (None, 3), finite=False)
    ref = finite_array("true", true, (len(est), 3), finite=False)
    return np.linalg.norm(est - ref, axis=1)


def rmse(errors: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Root mean square of errors (K,) over a mask (K,); NaN if there are no samples.

    If an error in the mask is not finite, the result is infinite.

    Raises:
        MeasurementError: an array has the wrong shape.
    """
    values = finite_array("errors", errors, (None,), finite=False)
    if mask is not None:
        chosen = np.asarray(mask)
        if chosen.shape != values.shape or chosen.dtype != bool:
            raise RecordingError(f"mask: must be bool of the shape {values.shape}")
        values = values[chosen]
    if not values.size:
        return float("nan")
    if not np.isfinite(values).all():
        return float("inf")
    return float(np.sqrt(np.mean(values**2)))


def known_mean(values: ArrayLike) -> float:
    """Mean of values (K,), without those that are NaN; NaN if there are no others."""
    known = np.asarray(values, np.float64)
    known = known[~np.isnan(known)]
    return float(np.mean(known)) if known.size else float("nan")


def pose_nees(estimates: Estimates, rotation: ArrayLike, position: ArrayLike) -> np.ndarray:
    """Normalised estimation error squared (K,) of poses, `filters.uncertainty.nees` on the host.

    NaN where the truth is unknown; infinite where the estimate is not finite, or its covariance not
    positive definite.

    Args:
        estimates: Of a filter with a covariance.
        rotation: (K, 3, 3) true R, body to inertial.
        position: (K, 3) true P [m], inertial frame.
    """
    R_est, P_est, sigma, R, P = (
        np.asarray(a, np.float64)
        for a in (estimates.rotation, estimates.position, estimates.covariance, rotation, position)
    )
    found = np.where(all_finite(R, P), np.inf, np.nan)
    known = all_finite(R_est, P_est, sigma, R, P)
    known[known] = np.linalg.eigvalsh(sigma[known])[:, 0] > 0
    R_est, P_est, sigma, R, P = (each[known] for each in (R_est, P_est, sigma, R, P))
    theta = log(product(inverse(quaternions(R_est)), quaternions(R)))
    moved = np.einsum("kji,kj->ki", R_est, P - P_est)
    # rho = V^-1 moved, V^-1 = I - 1/2 [theta]x + c [theta]x^2, c = (1 - t/2 cot t/2) / t^2.
    t = np.linalg.norm(theta, axis=1, keepdims=True)
    far = np.where(t > FAR, t, 1.0)
    c = np.where(t > FAR, (1 - 0.5 * far / np.tan(0.5 * far)) / far**2, 1 / 12)
    once = np.cross(theta, moved)
    xi = np.concatenate([theta, moved - 0.5 * once + c * np.cross(theta, once)], axis=1)
    found[known] = np.einsum("ki,ki->k", xi, np.linalg.solve(sigma, xi[..., None])[..., 0])
    return found


def recording_errors(estimates: Estimates, recording: Recording) -> RecordingErrors:
    """The errors of estimates of a recording.

    Args:
        estimates: the estimates at all its samples (`run_filter`).
        recording: a recording with a truth.

    Raises:
        RecordingError: the recording has no truth.
        MeasurementError: estimates and recording differ in their number of samples.
    """
    check_type("estimates", estimates, Estimates)
    check_type("recording", recording, Recording)
    masks = recording.masks()
    truth = recording.truth
    assert truth is not None
    nees = nis = None
    if estimates.covariance is not None and truth.position is not None:
        nees = pose_nees(estimates, truth.rotation, truth.position)
    if estimates.nis is not None:
        nis = np.where(all_finite(np.asarray(estimates.rotation)), estimates.nis, np.inf)
    return RecordingErrors(
        time=recording.time,
        attitude=attitude_errors(estimates.rotation, truth.rotation),
        position=None
        if truth.position is None
        else position_errors(estimates.position, truth.position),
        masks=masks,
        nees=nees,
        nis=nis,
    )
