"""Simulated flights that are meant to break posegsa: tuned on one, judged on another of its kind.

A body that moves by sums of sines, and sensors with effects that real ones have and a model lacks:
a gyroscope sampled at its stamp, motion capture noise in the truth, scale errors, correlated noise,
random walks, an accelerometer that measures every acceleration, outliers. NumPy and SciPy alone;
nothing of posegsa makes the data. `posegsa tune --recording` is compared with a Kalman filter with
the deviations that the flight was made with, and with the shipped configurations. RMSEs count after
5 s, against the truth without its noise.

    python benchmarks/made_flights.py [--write]   # docs/recordings.md; six minutes
"""

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from readme import write_block
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import posegsa
from posegsa import config
from posegsa.judging.result import Result
from posegsa.recordings.recording import Recording

PAGE = "docs/recordings.md"
Path = Callable[[np.ndarray], tuple[np.ndarray, Rotation]]
GRAVITY, NORTH = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.45, -0.89])
FREE_FALL = 9.81


@dataclass(frozen=True)
class Kind:
    """How a flight is made; standard deviations in a sample."""

    path: str = "drone"
    rate: float = 100.0
    duration: float = 60.0
    gyroscope: float = 0.005
    velocity: float = 0.05
    vectors: tuple[float, ...] = (0.03, 0.03)
    landmark: float = 0.05
    landmark_rate: float = 10.0
    landmarks: int = 4
    gyroscope_bias: float = 0.02
    velocity_bias: float = 0.1
    means: bool = False
    """Whether velocities are means over the step after their stamp."""
    mocap: tuple[float, float] = (0.0, 0.0)
    """Noise of the truth [m], [rad]."""
    lasts: float = 0.0
    """Time constant of half of each noise's variance [s]; 0 without."""
    walks: tuple[float, float] = (0.0, 0.0)
    """Random walks of both velocities' biases."""
    scales: tuple[float, float] = (0.0, 0.0)
    """Deviation of both velocities' scales, by axis."""
    accelerates: bool = False
    """Whether the first vector is an accelerometer that measures the body's acceleration."""
    outliers: float = 0.0
    """Share of landmark measurements that are off by 1 to 5 m."""
    room: float = 5.0


KINDS = {
    "drone": Kind(),
    "drone, mocap as truth": Kind(mocap=(0.001, math.radians(0.1))),
    "drone, biases that walk": Kind(walks=(1e-3, 5e-3)),
    "racer, gyroscope of means": Kind(
        "racer", 200, 50, 0.01, 0.15, (0.06, 0.06), 0.1, 30, 6, 0.06, 0.3, means=True, room=12
    ),
    "racer, scales off": Kind(
        "racer", 200, 50, 0.01, 0.15, (0.06, 0.06), 0.1, 30, 6, 0.06, 0.3, scales=(0.005, 0.01),
        room=12,
    ),
    "pan and tilt, one vector": Kind(
        "pan and tilt", 100, 50, 0.002, 0.02, (0.02,), 0.03, 15, 4, 0.1, 0.05
    ),
    "arm, outliers": Kind(
        "arm", 250, 40, 0.005, 0.03, (0.03, 0.02), 0.015, 30, 8, 0.03, 0.05, outliers=0.005,
        room=2.5,
    ),
    "rover, noise that lasts": Kind(
        "rover", 100, 60, 0.005, 0.05, (0.03, 0.03), 0.1, 8, 5, lasts=0.5, outliers=0.005, room=15
    ),
    "boat, real accelerometer": Kind(
        "boat", 50, 60, 0.002, 0.03, (0.01, 0.015), 0.15, 5, 3, 0.01, accelerates=True, room=40
    ),
    "legged, real accelerometer": Kind(
        "legged", 400, 40, 0.015, 0.1, (0.05, 0.03), 0.05, 15, 5, 0.03,
        mocap=(0.001, math.radians(0.1)), accelerates=True,
    ),
}  # fmt: skip


def waves(rng: np.random.Generator, period: float, size: Any) -> Callable[[np.ndarray], np.ndarray]:
    """Six sines with periods about `period` [s] on each axis; deviations `size`."""
    often = rng.uniform(0.6, 1.6, (6, 3)) / period
    high, phase = rng.normal(size=(6, 3)) / math.sqrt(6), rng.uniform(0, 2 * np.pi, (6, 3))
    return lambda t: (
        size * np.sum(high * np.sin(2 * np.pi * often * t[:, None, None] + phase), axis=1)
    )


def path_of(name: str, rng: np.random.Generator) -> Path:
    """Position and attitude over time."""
    slow = {"racer": 10.0, "boat": 30.0, "rover": 25.0, "arm": 3.0, "pan and tilt": 5.0}
    far = {"racer": 8.0, "boat": 8.0, "rover": 4.0, "arm": 0.4, "pan and tilt": 0.05}
    tilt = {"racer": 0.5, "arm": 0.7, "pan and tilt": 0.5, "rover": 0.03}
    period = slow.get(name, 8.0)
    where = waves(rng, period, far.get(name, 1.5) * np.array([1, 1, 0.3]))
    lean = waves(rng, min(period, 4.0), tilt.get(name, 0.13) * np.array([0.2, 1, 1]))
    steps = waves(rng, 0.15, np.array([0.004, 0.008, 0.012]))
    shakes, heave = waves(rng, 0.15, 0.02), waves(rng, 4.0, 0.35)
    turning = 0.0 if name == "pan and tilt" else rng.uniform(0.2, 0.5) * rng.choice([-1, 1])

    def at(t: np.ndarray) -> tuple[np.ndarray, Rotation]:
        place = where(t) + GRAVITY
        angles = lean(t) + np.stack([turning * t, 0 * t, 0 * t], axis=1)
        if name == "legged":
            place, angles = place + steps(t), angles + shakes(t)
        if name == "boat":
            place = place + heave(t)
        return place, Rotation.from_euler("ZYX", angles)

    return at


def flight(kind: Kind, seed: int) -> tuple[Recording, np.ndarray, Rotation]:
    """A recording, and its true positions and attitudes."""
    rng = np.random.default_rng([20261124, seed, *map(ord, kind.path)])
    dt = 1 / kind.rate
    time = dt * np.arange(round(kind.duration * kind.rate))
    count, at, near = len(time), path_of(kind.path, rng), 5e-4
    P, turn = at(time)
    R = turn.as_matrix()
    if kind.means:
        (after, next_turn), (_, middle) = at(time + dt), at(time + dt / 2)
        rate = (turn.inv() * next_turn).as_rotvec() / dt
        moving = middle.apply((after - P) / dt, inverse=True)
    else:
        (before, first), (after, last) = at(time - near), at(time + near)
        rate = (first.inv() * last).as_rotvec() / (2 * near)
        moving = turn.apply((after - before) / (2 * near), inverse=True)

    def noise(deviation: float) -> np.ndarray:
        white = rng.normal(size=(count, 3))
        if not kind.lasts:
            return deviation * white
        keep = math.exp(-dt / kind.lasts)
        drive = math.sqrt(1 - keep * keep)
        slow = lfilter([drive], [1, -keep], rng.normal(size=(count, 3)), axis=0)
        return deviation * (white + slow) / math.sqrt(2)

    def bias(length: float) -> np.ndarray:
        axis = rng.normal(size=3)
        return length * axis / np.linalg.norm(axis)

    def walk(density: float) -> np.ndarray:
        return density * math.sqrt(dt) * np.cumsum(rng.normal(size=(count, 3)), axis=0)

    sensed = [
        true * (1 + scale * rng.normal(size=3)) + bias(off) + walk(drift) + noise(deviation)
        for true, scale, off, drift, deviation in zip(
            (rate, moving), kind.scales, (kind.gyroscope_bias, kind.velocity_bias), kind.walks,
            (kind.gyroscope, kind.velocity), strict=True,
        )
    ]  # fmt: skip
    references = np.stack([GRAVITY, NORTH])[: len(kind.vectors)]
    pulled = np.zeros_like(P)
    if kind.accelerates:
        step = 2e-3
        pulled = (at(time + step)[0] - 2 * P + at(time - step)[0]) / step**2 / FREE_FALL
    vectors = []
    for i, (reference, deviation) in enumerate(zip(references, kind.vectors, strict=True)):
        there = reference + (pulled if i == 0 else 0.0)
        seen = np.einsum("kji,kj->ki", R, np.broadcast_to(there, P.shape))
        vectors.append(seen + 0.02 * rng.normal(size=3) + noise(deviation))
    places, landmarks = landmarks_of(kind, rng, time, P, R, noise)
    seen_turn = turn * Rotation.from_rotvec(kind.mocap[1] * rng.normal(size=(count, 3)))
    recording = Recording.from_arrays(
        time=time,
        angular_velocity=sensed[0],
        velocity=sensed[1],
        vectors=np.stack(vectors, axis=1),
        vector_references=references,
        landmarks=landmarks,
        landmark_references=places,
        truth_quaternion=seen_turn.as_quat(scalar_first=True),
        truth_position=P + kind.mocap[0] * rng.normal(size=P.shape),
    )
    return recording, P, turn


def landmarks_of(
    kind: Kind,
    rng: np.random.Generator,
    time: np.ndarray,
    P: np.ndarray,
    R: np.ndarray,
    noise: Callable[[float], np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Places (m, 3), and measurements (K, m, 3); some are hidden for some seconds."""
    count, m = len(time), kind.landmarks
    around = 2 * np.pi * (np.arange(m) + rng.uniform(size=m) / 2) / m
    flat = np.stack([np.cos(around), np.sin(around), rng.uniform(0, 0.4, m)], axis=1)
    places = kind.room * flat * rng.uniform(0.8, 1.2, (m, 1))
    every, measured = round(kind.rate / kind.landmark_rate), np.full((count, m, 3), np.nan)
    for j, place in enumerate(places):
        y = np.einsum("kji,kj->ki", R, place - P) + noise(kind.landmark)
        seen = np.zeros(count, bool)
        seen[(j % 2) * (every // 2) :: every] = True
        for begin in rng.uniform(3, time[-1] - 6, 2 if j >= 2 else 0):
            seen &= ~((time > begin) & (time < begin + rng.uniform(1, 4)))
        wrong = seen & (rng.uniform(size=count) < kind.outliers) & (time > 1)
        away = rng.normal(size=(count, 3))
        away *= rng.uniform(1, 5, (count, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
        measured[:, j] = np.where(seen[:, None], y + np.where(wrong[:, None], away, 0.0), np.nan)
    return places, measured


def as_made(kind: Kind) -> config.Experiment:
    """A Kalman filter with the deviations that a flight was made with."""
    root = 1 / math.sqrt(kind.rate)
    return config.load("kalman").replace(
        **{
            "filter.angular_velocity": kind.gyroscope * root,
            "filter.velocity": kind.velocity * root,
            "filter.vector": float(np.sqrt(np.mean(np.square(kind.vectors)))),
            "filter.landmark": kind.landmark,
            "filter.angular_walk": max(2e-5, kind.walks[0]),
            "filter.linear_walk": max(1e-4, kind.walks[1]),
            "filter.vector_walk": 1e-5,
            "filter.initial_angular_bias": kind.gyroscope_bias / math.sqrt(3),
            "filter.initial_linear_bias": kind.velocity_bias / math.sqrt(3),
            "filter.initial_vector_bias": 0.02,
            "filter.initial_attitude": 0.15,
            "filter.initial_position": 0.25,
        }
    )


def errors(result: Result, recording: Recording, P: np.ndarray, turn: Rotation) -> str:
    """Root mean squares after 5 s [deg], [cm]."""
    (replayed,) = posegsa.replay(result, [recording])
    found, late = replayed.estimates, recording.time >= 5.0
    off = (Rotation.from_matrix(np.asarray(found.rotation)) * turn.inv()).magnitude()
    away = np.linalg.norm(np.asarray(found.position) - P, axis=1)
    both = (np.sqrt(np.mean(a[late] ** 2)) for a in (np.degrees(off), 100 * away))
    return "{:.2f}, {:.1f}".format(*both)


def main() -> None:
    parser = argparse.ArgumentParser(description="Simulated flights meant to break posegsa.")
    parser.add_argument("--write", action="store_true", help=f"into {PAGE}")
    options = parser.parse_args()
    posegsa.enable_fast_path()
    heads = ["`tune`", "as made", "as made, with leads", "`kalman`"]
    lines = [
        f"| RMSE after 5 s [deg], [cm] | {' | '.join(heads)} |",
        "| --- " + "| --: " * len(heads) + "|",
    ]
    for name, kind in KINDS.items():
        flights = [flight(kind, seed) for seed in (1, 2)]
        for i, (judged, P, turn) in enumerate(flights):
            other = flights[1 - i][0]
            made = as_made(kind)
            lead = 0.0 if kind.means else 0.5
            led = made.replace(**{"filter.angular_lead": lead, "filter.linear_lead": lead})
            results = [
                posegsa.tune(recordings=[other]),
                *(posegsa.configured(one, recordings=[judged]) for one in (made, led, "kalman")),
            ]
            cells = [errors(result, judged, P, turn) for result in results]
            lines.append(f"| {name}, {i + 1} | {' | '.join(cells)} |")
            print(lines[-1], flush=True)
    if options.write:
        write_block("made-flights", "\n".join(lines), PAGE)


if __name__ == "__main__":
    main()
