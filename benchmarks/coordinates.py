"""In which coordinates a Kalman filter of 18 states should hold its errors.

All filters have the same states, noises and start, and differ in what their covariance is of:

    left         T = T_est exp(xi^), biases added: posegsa's
    right        T = exp(xi^) T_est, biases added
    two frames   a group of pose and biases (A. Barrau, S. Bonnabel, "The Geometry of Navigation
                 Problems", arXiv:2201.04426), left or right: an error of the attitude turns the
                 biases too (left), or a bias's error is in the inertial frame (right)
    body vectors R^T v_i and R^T (p - P) are the states instead of the pose, so that measurements
                 are linear and 180 deg is nothing special (the idea of arXiv:2410.03846); lengths
                 of the vectors and the angle between them are measurements without noise

Derivatives are exact (automatic), matrices dense: slow, and independent of `posegsa.KalmanFilter`,
which the first row repeats. "moved": after an update the covariance is moved to the coordinates of
the new estimate. Prints the mean cost (99th percentile), and the mean NEES with its share up to the
95 % quantile. The noises are those of the sensors; nothing is tuned.

    python benchmarks/coordinates.py --write   # docs/kalman.md; an hour on two cores
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from families import DRAWN, options_of, with_family, with_scenarios
from jax import Array
from readme import write_block
from schedules import FAMILY_START

import posegsa
from posegsa import config
from posegsa.filters.base import Record, Samples, Sensors
from posegsa.filters.kalman import KalmanFilter, KalmanNoise
from posegsa.filters.uncertainty import PoseCovariance
from posegsa.judging.metrics import CONSISTENT_NEES, error_tracks, metrics_of
from posegsa.model.estimate import FilterState, initial_state
from posegsa.model.measurements import Measurements
from posegsa.model.sample import Sample, prepare
from posegsa.model.se3 import stack, unstack
from posegsa.model.vectors import AS_MEASURED
from posegsa.search.candidates import Candidate
from posegsa.search.configured_filters import filter_of
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import held_out_keys


class Estimate(NamedTuple):
    """Pose and biases as arrays."""

    R: Array
    """(3, 3) body to inertial."""
    P: Array
    """(3,) [m], inertial frame."""
    b: Array
    """(2, 3) biases of the velocities, body frame."""
    c: Array
    """(n, 3) biases of the vectors, body frame."""


def skew(a: Array) -> Array:
    """(3, 3) matrix of the cross product with a."""
    zero = jnp.zeros_like(a[0])
    return jnp.stack(
        [
            jnp.stack([zero, -a[2], a[1]]),
            jnp.stack([a[2], zero, -a[0]]),
            jnp.stack([-a[1], a[0], zero]),
        ]
    )


def exp_rotation(theta: Array) -> Array:
    """The rotation of a rotation vector, differentiable at 0."""
    square = theta @ theta
    small = square < 1e-6
    angle = jnp.sqrt(jnp.where(small, 1.0, square))
    a = jnp.where(small, 1 - square / 6, jnp.sin(angle) / angle)
    b = jnp.where(small, 0.5 - square / 24, (1 - jnp.cos(angle)) / (angle * angle))
    K = skew(theta)
    return jnp.eye(3, dtype=theta.dtype) + a * K + b * (K @ K)


def rotation_vector(R: Array) -> Array:
    """The rotation vector of a small rotation, to first order."""
    return 0.5 * jnp.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])


def parts(xi: Array) -> tuple[Array, Array, Array, Array]:
    """theta, rho, errors (2, 3) of the velocities' biases and (n, 3) of the vectors'."""
    return xi[:3], xi[3:6], xi[6:12].reshape(2, 3), xi[12:].reshape(-1, 3)


class Coordinates(NamedTuple):
    """How an error xi changes an estimate, and the error between two estimates close together."""

    plus: Callable[[Estimate, Array], Estimate]
    minus: Callable[[Estimate, Estimate], Array]


def left(turns_biases: bool) -> Coordinates:
    """T = T_est exp(xi^); with `turns_biases` the left error of the two-frames group."""

    def plus(x: Estimate, xi: Array) -> Estimate:
        theta, rho, beta, gamma = parts(xi)
        E = exp_rotation(theta)
        b, c = (x.b @ E, x.c @ E) if turns_biases else (x.b, x.c)  # rows: E^T times each
        return Estimate(x.R @ E, x.P + x.R @ rho, b + beta, c + gamma)

    def minus(new: Estimate, x: Estimate) -> Array:
        E = x.R.T @ new.R
        b, c = (x.b @ E, x.c @ E) if turns_biases else (x.b, x.c)
        pose = rotation_vector(E), x.R.T @ (new.P - x.P)
        return jnp.concatenate([*pose, (new.b - b).ravel(), (new.c - c).ravel()])

    return Coordinates(plus, minus)


def right(turns_biases: bool) -> Coordinates:
    """T = exp(xi^) T_est; with `turns_biases` the right error of the two-frames group."""

    def plus(x: Estimate, xi: Array) -> Estimate:
        theta, rho, beta, gamma = parts(xi)
        E = exp_rotation(theta)
        if turns_biases:
            beta, gamma = beta @ x.R, gamma @ x.R  # rows: R^T times each
        return Estimate(E @ x.R, E @ x.P + rho, x.b + beta, x.c + gamma)

    def minus(new: Estimate, x: Estimate) -> Array:
        E = new.R @ x.R.T
        beta, gamma = new.b - x.b, new.c - x.c
        if turns_biases:
            beta, gamma = beta @ x.R.T, gamma @ x.R.T
        return jnp.concatenate([rotation_vector(E), new.P - E @ x.P, beta.ravel(), gamma.ravel()])

    return Coordinates(plus, minus)


COORDINATES = {
    "left": left(False),
    "two frames, left": left(True),
    "right": right(False),
    "two frames, right": right(True),
}
BODY_VECTORS = "body vectors"


class DenseState(NamedTuple):
    """An estimate and its covariance."""

    x: Any
    """An `Estimate`, or `BodyVectors`."""
    covariance: Array
    """(d, d)."""
    pose: FilterState


def as_state(x: Estimate) -> FilterState:
    """An estimate by components."""
    state = initial_state(x.R, x.P, x.b.ravel())
    return state._replace(vector_biases=tuple(unstack(one) for one in x.c))


def as_estimate(state: FilterState, vectors: int) -> Estimate:
    """The inverse of `as_state`; biases of vectors that it lacks are 0."""
    c = state.vector_bias
    if not state.vector_biases:
        c = jnp.zeros((vectors, 3), state.position.dtype)
    return Estimate(state.rotation, state.position, state.bias.reshape(2, 3), c)


def measured(sample: Sample) -> tuple[Array, Array, Array, Array]:
    """Measured (m, 3) and known (m, 3) of vectors and landmarks, factors (m,), and which these are.

    The last is 1 for a landmark.
    """
    each: Any = sample.vectors
    seen = [(v.measured, v.known, v.factor, 0.0) for v in each.each]
    seen += [(p.body, p.inertial, p.factor, 1.0) for p in sample.landmarks]
    z, known, factors, kinds = zip(*seen, strict=True)
    return (
        jnp.stack([stack(one) for one in z]),
        jnp.stack([stack(one) for one in known]),
        jnp.stack(factors),
        jnp.asarray(kinds, factors[0].dtype),
    )


def by_scalars(
    covariance: Array, H: Array, residual: Array, variance: Array, used: Array
) -> tuple[Array, Array]:
    """Correction (d,) and covariance after scalars one by one, all linearised alike."""

    def one(carry: tuple[Array, Array], row: Any) -> tuple[tuple[Array, Array], None]:
        x, S = carry
        h, off, r, there = row
        g = S @ h
        total = h @ g + r
        gain = jnp.where(there, g / total, 0.0)
        S = S - jnp.outer(gain, g)
        return (x + gain * (off - h @ x), 0.5 * (S + S.T)), None

    begin = jnp.zeros_like(H[0]), covariance
    (x, covariance), _ = jax.lax.scan(one, begin, (H, residual, variance, used))
    return x, covariance


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DenseKalman:
    """A Kalman filter in any coordinates of pose and biases (`posegsa.filters.base.Filter`)."""

    noise: KalmanNoise
    coordinates: str = field(metadata={"static": True})
    moves: bool = field(metadata={"static": True})

    def with_values(self, values: Mapping[str, Array]) -> Self:
        """The same with other noises."""
        return replace(self, noise=self.noise._replace(**values))

    def prepare(self, measurements: Measurements) -> Sample:
        """Vectors and landmarks as measured."""
        return prepare(measurements, AS_MEASURED)

    def ready(self) -> Self:
        """Nothing to compute before the loop."""
        return self

    def estimate(self, state: DenseState) -> FilterState:
        """Pose and biases."""
        return state.pose

    def start(self, initial: FilterState, sensors: Sensors) -> DenseState:
        """The covariance is that of posegsa's filter, moved from its coordinates to these."""
        x, noise = as_estimate(initial, sensors.vectors), self.noise
        deviations = [
            *(noise.initial_attitude,) * 3,
            *(noise.initial_position,) * 3,
            *(noise.initial_angular_bias,) * 3,
            *(noise.initial_linear_bias,) * 3,
            *(noise.initial_vector_bias,) * (3 * sensors.vectors),
        ]
        posegsa_s, own = COORDINATES["left"], COORDINATES[self.coordinates]
        nothing = jnp.zeros(len(deviations), x.P.dtype)
        to_own = jax.jacfwd(lambda xi: own.minus(posegsa_s.plus(x, xi), x))(nothing)
        S = to_own @ jnp.diag(jnp.stack(deviations).astype(x.P.dtype) ** 2) @ to_own.T
        return DenseState(x, S, as_state(x))

    def step(self, state: DenseState, now: Samples) -> tuple[DenseState, Record]:
        """Update by vectors and landmarks, then propagation by the velocities."""
        plus, minus = COORDINATES[self.coordinates]
        sample, noise, x = now.sample, self.noise, state.x
        nothing, dt = jnp.zeros(len(state.covariance), x.P.dtype), sample.time_step
        z, known, factors, kinds = measured(sample)

        def predicted(x: Estimate) -> Array:
            vectors = known[: len(x.c)] @ x.R + x.c
            return jnp.concatenate([vectors, (known[len(x.c) :] - x.P) @ x.R]).ravel()

        H = jax.jacfwd(lambda xi: predicted(plus(x, xi)))(nothing)
        deviation = jnp.where(kinds > 0, noise.landmark, noise.vector)
        variance = deviation**2 / jnp.where(factors > 0, factors, 1.0)
        correction, S = by_scalars(
            state.covariance,
            H,
            z.ravel() - predicted(x),
            jnp.repeat(variance, 3),
            jnp.repeat(factors > 0, 3),
        )
        new = plus(x, correction)
        if self.moves:
            G = jax.jacfwd(lambda xi: minus(plus(x, correction + xi), new))(nothing)
            S = G @ S @ G.T
        measured_velocities = jnp.stack([stack(sample.angular_velocity), stack(sample.velocity)])

        def moved(x: Estimate, noises: Array) -> Estimate:
            omega, v = dt * (measured_velocities - x.b + noises)
            half = exp_rotation(0.5 * omega)
            return x._replace(R=x.R @ exp_rotation(omega), P=x.P + x.R @ half @ v)

        quiet = jnp.zeros((2, 3), x.P.dtype)
        after = moved(new, quiet)
        F = jax.jacfwd(lambda xi: minus(moved(plus(new, xi), quiet), after))(nothing)
        J = jax.jacfwd(lambda w: minus(moved(new, w), after))(quiet).reshape(-1, 6)
        densities = [*(noise.angular_velocity,) * 3, *(noise.velocity,) * 3]
        walks = [*(noise.angular_walk,) * 3, *(noise.linear_walk,) * 3]
        walks += [noise.vector_walk] * (len(nothing) - 12)
        Q = (J * jnp.stack(densities) ** 2 / dt) @ J.T
        Q = Q.at[jnp.arange(6, len(nothing)), jnp.arange(6, len(nothing))].add(
            dt * jnp.stack(walks) ** 2
        )
        S = F @ S @ F.T + Q
        return DenseState(after, S, as_state(after)), Record()

    def pose_covariance(self, state: DenseState) -> PoseCovariance:
        """The covariance of the left error, that of posegsa."""
        own, posegsa_s, x = COORDINATES[self.coordinates], COORDINATES["left"], state.x
        nothing = jnp.zeros(len(state.covariance), x.P.dtype)
        to_left = jax.jacfwd(lambda xi: posegsa_s.minus(own.plus(x, xi), x)[:6])(nothing)
        S = to_left @ state.covariance @ to_left.T
        return tuple(tuple(S[i, j] for j in range(i, 6)) for i in range(6))


class BodyVectors(NamedTuple):
    """What the sensors measure, as states; all in the body frame."""

    d: Array
    """(2, 3) R^T v_i."""
    q: Array
    """(3,) R^T (p - P) of the landmark [m]."""
    b: Array
    """(2, 3) biases of the velocities."""
    c: Array
    """(2, 3) biases of the vectors."""

    def plus(self, error: Array) -> "BodyVectors":
        """The states after an error (21,) is added."""
        d, q, b, c = jnp.split(error, (6, 9, 15))
        return BodyVectors(
            self.d + d.reshape(2, 3),
            self.q + q,
            self.b + b.reshape(2, 3),
            self.c + c.reshape(2, 3),
        )

    def ravel(self) -> Array:
        """All states (21,)."""
        return jnp.concatenate([leaf.ravel() for leaf in self])


def triad(two: Array) -> Array:
    """(3, 3) orthonormal rows: the bisector of two vectors, their normal, and its cross product."""
    a, b = two / jnp.linalg.norm(two, axis=1, keepdims=True)
    first, second = a + b, jnp.cross(a, b)
    first, second = (one / jnp.linalg.norm(one) for one in (first, second))
    return jnp.stack([first, second, jnp.cross(first, second)])


STATES = 21
CONSTRAINT = 1e-1
"""Standard deviation of lengths and angle of the two vectors in `BodyVectorKalman`."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class BodyVectorKalman:
    """A Kalman filter whose states are what its sensors measure: two vectors and one landmark."""

    noise: KalmanNoise
    known: Array
    """(3, 3) the two vectors and the landmark in the inertial frame."""

    with_values, prepare, ready = DenseKalman.with_values, DenseKalman.prepare, DenseKalman.ready
    estimate = DenseKalman.estimate

    def _pose(self, x: BodyVectors) -> Estimate:
        R = triad(self.known[:2]).T @ triad(x.d)
        return Estimate(R, self.known[2] - R @ x.q, x.b, x.c)

    def start(self, initial: FilterState, sensors: Sensors) -> DenseState:
        """Vectors and landmark as the initial pose shows them, each uncertain in all directions."""
        pose, noise = as_estimate(initial, sensors.vectors), self.noise
        x = BodyVectors(self.known[:2] @ pose.R, (self.known[2] - pose.P) @ pose.R, pose.b, pose.c)
        deviations = [
            *(noise.initial_attitude,) * 6,
            *(noise.initial_position,) * 3,
            *(noise.initial_angular_bias,) * 3,
            *(noise.initial_linear_bias,) * 3,
            *(noise.initial_vector_bias,) * 6,
        ]
        S = jnp.diag(jnp.stack(deviations).astype(pose.P.dtype) ** 2)
        return DenseState(x, S, as_state(pose))

    def step(self, state: DenseState, now: Samples) -> tuple[DenseState, Record]:
        """Update, constraints, then propagation by the velocities."""
        sample, noise, x, S = now.sample, self.noise, state.x, state.covariance
        nothing, dt = jnp.zeros(STATES, S.dtype), sample.time_step
        z, _, factors, kinds = measured(sample)

        def predicted(x: BodyVectors) -> Array:
            return jnp.concatenate([(x.d + x.c).ravel(), x.q])

        def lengths(d: Array) -> Array:
            return jnp.stack([d[0] @ d[0], d[1] @ d[1], d[0] @ d[1]])

        H = jax.jacfwd(lambda e: predicted(x.plus(e)))(nothing)
        deviation = jnp.where(kinds > 0, noise.landmark, noise.vector)
        variance = deviation**2 / jnp.where(factors > 0, factors, 1.0)
        seen = jnp.repeat(variance, 3), jnp.repeat(factors > 0, 3)
        correction, S = by_scalars(S, H, z.ravel() - predicted(x), *seen)
        x = x.plus(correction)
        H = jax.jacfwd(lambda e: lengths(x.plus(e).d))(nothing)
        off = lengths(self.known[:2]) - lengths(x.d)
        exact = jnp.full(3, CONSTRAINT**2, S.dtype), jnp.full(3, True)
        correction, S = by_scalars(S, H, off, *exact)
        x = x.plus(correction)
        measured_velocities = jnp.stack([stack(sample.angular_velocity), stack(sample.velocity)])

        def moved(x: BodyVectors, noises: Array) -> BodyVectors:
            omega, v = dt * (measured_velocities - x.b + noises)
            E = exp_rotation(omega)
            q = x.q - exp_rotation(0.5 * omega) @ v
            return x._replace(d=x.d @ E, q=q @ E)

        quiet = jnp.zeros((2, 3), S.dtype)
        F = jax.jacfwd(lambda e: moved(x.plus(e), quiet).ravel())(nothing)
        J = jax.jacfwd(lambda w: moved(x, w).ravel())(quiet).reshape(-1, 6)
        densities = [*(noise.angular_velocity,) * 3, *(noise.velocity,) * 3]
        walks = [*(noise.angular_walk,) * 3, *(noise.linear_walk,) * 3, *(noise.vector_walk,) * 6]
        Q = (J * jnp.stack(densities) ** 2 / dt) @ J.T
        biases = jnp.arange(9, STATES)
        Q = Q.at[biases, biases].add(dt * jnp.stack(walks) ** 2)
        S = F @ S @ F.T + Q
        after = moved(x, quiet)
        return DenseState(after, S, as_state(self._pose(after))), Record()

    def pose_covariance(self, state: DenseState) -> PoseCovariance:
        """The covariance of the left error of the pose."""
        x, minus = state.x, COORDINATES["left"].minus
        nothing = jnp.zeros(STATES, state.covariance.dtype)
        here = self._pose(x)
        to_left = jax.jacfwd(lambda e: minus(self._pose(x.plus(e)), here)[:6])(nothing)
        S = to_left @ state.covariance @ to_left.T
        return tuple(tuple(S[i, j] for j in range(i, 6)) for i in range(6))


FAMILIES = {
    "any start, drawn biases, from the sensors": (DRAWN, "sensors"),
    "any start, as given": ({}, "given"),
}
TIMES = (10.0, 30.0, 60.0)
"""Of NEES [s]."""


def contenders(plain: KalmanFilter, known: Array) -> dict[str, Any]:
    """All filters with the noises of posegsa's, by name."""
    found: dict[str, Any] = {
        "posegsa's": plain,
        "posegsa's, reset two frames": replace(plain, reset="two frames"),
        "posegsa's, 3 iterations an update": replace(plain, iterations=3),
    }
    for name in COORDINATES:
        for moves in (False, True):
            words = f"{name}, moved" if moves else name
            found[words] = DenseKalman(plain.noise, name, moves)
    return found | {BODY_VECTORS: BodyVectorKalman(plain.noise, known)}


def main() -> None:
    """Judge all filters on both families."""
    options = options_of("Coordinates of a Kalman filter's errors.", 45, "docs/kalman.md")
    posegsa.enable_fast_path()
    keys = held_out_keys(0, options.scenarios, options.set)
    rows: dict[str, list[str]] = {}
    for changes, start in FAMILIES.values():
        # One linearisation, as the dense filters have.
        shipped = config.load("kalman").replace(**{"filter.iterations": 1})
        if start == "given":
            section = shipped.filter.model_copy(update=FAMILY_START)
            shipped = shipped.model_copy(update={"filter": section})
        one = with_scenarios(shipped, with_family("observer", changes), start)
        plain = filter_of(one)
        assert isinstance(plain, KalmanFilter)
        batch = scenario_batch(one, keys, plain)
        time = np.asarray(batch.samples.time[0], np.float64)
        samples = [np.argmin(np.abs(time - t)) for t in TIMES]
        first = jax.tree.map(lambda a: a[0, 0], batch.samples)
        known = measured(first.sample)[1]
        for name, filter in contenders(plain, known).items():
            each = batch._replace(filter=filter)
            tracks = error_tracks(Candidate(), each)
            costs = metrics_of(tracks, each)[0].cost
            cells = [f"{np.mean(costs):.1f} ({np.quantile(costs, 0.99):.0f})"]
            if start == "sensors":
                assert tracks.nees is not None
                cells += [
                    f"{np.mean(at):.2f} ({100 * np.mean(at <= CONSISTENT_NEES):.1f} %)"
                    for at in tracks.nees[:, samples].T
                ]
            rows.setdefault(name, []).extend(cells)
            print(f"{name}: {', '.join(cells)}", flush=True)
    first, second = FAMILIES
    lines = [
        f"| coordinates | {first}: cost (99 %) | NEES at 10 s | at 30 s | at 60 s | {second}: cost "
        "(99 %) |",
        f"| --- |{' --: |' * 5}",
        *(f"| {name} | {' | '.join(cells)} |" for name, cells in rows.items()),
    ]
    print("\n".join(lines))
    if options.write:
        write_block("coordinates", "\n".join(lines), "docs/kalman.md")


if __name__ == "__main__":
    main()
