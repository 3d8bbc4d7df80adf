"""Filter your own arrays
======================

A tuned filter over arrays with uneven steps and missing measurements. ::

    python examples/own_arrays.py         # the filter of `observer`, as shipped
    python examples/own_arrays.py RUN     # the one in a folder that `posegsa tune --out RUN` wrote
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import posegsa


def main(run=None, samples=2000):
    result = posegsa.load(run) if run else posegsa.configured("observer")

    # A body that rotates about an inclined axis and flies a circle. Read your own from a file.
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.008, 0.012, samples))  # s; uneven
    turn = np.array([0.1, -0.2, 0.4])  # rad/s
    attitude = Rotation.from_rotvec(time[:, None] * turn)  # body to inertial
    position = np.stack([np.sin(0.5 * time), np.cos(0.5 * time), 0.1 * time], axis=1)  # m
    velocity = np.stack([0.5 * np.cos(0.5 * time), -0.5 * np.sin(0.5 * time), 0 * time + 0.1], 1)

    # The measurements of its sensors, all in the body frame, each with noise.
    up, north = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    beacon = np.array([2.0, -1.5, 1.0])  # m
    to_body = attitude.inv()
    gyroscope = turn + 0.02 * rng.normal(size=(samples, 3))
    speed = to_body.apply(velocity) + 0.05 * rng.normal(size=(samples, 3))
    vectors = np.stack([to_body.apply(np.tile(v, (samples, 1))) for v in (up, north)], axis=1)
    vectors += 0.02 * rng.normal(size=vectors.shape)
    seen = to_body.apply(beacon - position)[:, None] + 0.05 * rng.normal(size=(samples, 1, 3))
    seen[np.arange(samples) % 4 > 0] = np.nan  # the beacon is measured at 25 Hz
    vectors[samples // 3 : samples // 2, 1] = np.nan  # the compass fails for a while

    measurements = posegsa.Measurements.from_arrays(
        time_step=np.diff(time, append=time[-1] + 0.01),
        angular_velocity=gyroscope,
        velocity=speed,
        vectors=vectors,
        vector_references=[up, north],
        landmarks=seen,
        landmark_references=[beacon],
        landmark_weights=1 / 3**2,  # about 1 / (distance in m)^2
    )
    estimates = result.estimate(measurements, rotation=np.diag([1, -1, -1]), position=np.zeros(3))

    angle = (Rotation.from_matrix(estimates.rotation) * attitude.inv()).magnitude()
    distance = np.linalg.norm(estimates.position - position, axis=1)
    for k in np.linspace(0, samples - 1, 9).astype(int):
        print(f"{time[k]:6.2f} s   {np.degrees(angle[k]):7.2f} deg   {distance[k]:6.3f} m")
    _, axes = plt.subplots(2, sharex=True, layout="constrained")
    axes[0].semilogy(time, np.degrees(angle))
    axes[0].set_ylabel("attitude error [deg]")
    axes[0].axvspan(time[samples // 3], time[samples // 2], alpha=0.2, label="no compass")
    axes[0].legend()
    axes[1].semilogy(time, distance)
    axes[1].set(xlabel="time [s]", ylabel="position error [m]")
    return np.degrees(angle), distance


if __name__ == "__main__":
    posegsa.enable_fast_path()
    main(*sys.argv[1:])
    plt.show()
