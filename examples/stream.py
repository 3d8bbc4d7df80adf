"""Filter a stream
===============

CSV lines, a hundred per second, and a pose for each. ::

    python examples/stream.py                               # 20 s of made-up sensors, and a plot
    python examples/stream.py --make 30 > sensors.csv       # writes them
    python examples/stream.py - < sensors.csv               # or from a serial port, a socket, ...

A line is time, gyroscope (3), velocity (3), accelerometer (3), compass (3), beacon (3), in the body
frame and SI units. Empty fields were not measured, and there is no header line. The body hardly
accelerates. The output is time, position (3) [m] and roll, pitch, yaw [deg].
"""

import csv
import sys

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import posegsa

UP, NORTH, BEACON = [0, 0, 9.81], [0.5, 0, -0.8], [4.0, -3.0, 2.0]  # inertial frame


def made_filter():
    """A filter with a fixed gain; for a tuned one: `posegsa.PoseFilter(posegsa.load(RUN), ...)`."""
    experiment = posegsa.config.override(posegsa.Experiment(), ["filter.vector_bias=off"])
    gain = posegsa.ConstantGain(jnp.asarray(20.0))  # K [1/s]
    return posegsa.PoseFilter(
        posegsa.Observer(gain, posegsa.filter_settings(experiment)),
        rotation=np.eye(3),
        position=[0.0, 0.8, 0.0],
        vector_references=[UP, NORTH],
        landmark_references=[BEACON],
    )


def poses(lines, pose_filter):
    """Yield the time and pose of each line except the first, whose pose is the initial one.

    The filter moves from one sample to the next, so a line waits for the time of the next one.
    """
    before = None
    for row in csv.reader(lines):
        now = np.array([float(field) if field else np.nan for field in row])
        if before is not None:
            sample = before[1:].reshape(5, 3)
            yield (
                now[0],
                pose_filter.update(
                    time_step=now[0] - before[0],
                    angular_velocity=sample[0],
                    velocity=sample[1],
                    vectors=sample[2:4],
                    landmarks=sample[4:5],
                ),
            )
        before = now


def made_lines(seconds):
    """Lines for a body that rotates and flies a circle, and the true poses."""
    rng = np.random.default_rng(0)
    for k in range(round(100 * seconds)):
        t = k / 100
        attitude = Rotation.from_rotvec(t * np.array([0.1, -0.2, 0.4]))
        position = np.array([np.sin(0.5 * t), np.cos(0.5 * t), 0.1 * t])
        speed = [0.5 * np.cos(0.5 * t), -0.5 * np.sin(0.5 * t), 0.1]
        exact = [[0.1, -0.2, 0.4], *attitude.inv().apply([speed, UP, NORTH, BEACON - position])]
        noise = 0.02 * rng.normal(size=(5, 3))
        values = [f"{x:.5f}" for x in np.ravel(exact + noise)]
        if k % 10:
            values[12:] = [""] * 3  # the beacon is measured at 10 Hz
        yield ",".join([f"{t:.3f}", *values]), (attitude, position)


def written(time, pose, pose_filter):
    """A line of the output."""
    x, y, z = pose.position
    roll, pitch, yaw = Rotation.from_matrix(pose.rotation).as_euler("xyz", degrees=True)
    doubt = "" if pose_filter.observable else f"   {pose_filter.why_unobservable}"
    return f"{time:.3f},{x:.3f},{y:.3f},{z:.3f},{roll:.2f},{pitch:.2f},{yaw:.2f}{doubt}"


def tried(seconds=20):
    """Filter made-up lines, print each hundredth pose, and plot the errors."""
    lines, pose_filter, rows = list(made_lines(seconds)), made_filter(), []
    found = poses((line for line, _ in lines), pose_filter)
    for k, (time, pose) in enumerate(found, start=1):
        attitude, position = lines[k][1]
        angle = (attitude.inv() * Rotation.from_matrix(pose.rotation)).magnitude()
        rows.append((time, np.degrees(angle), np.linalg.norm(pose.position - position)))
        if k % 100 == 0:
            print(written(time, pose, pose_filter))
    time, degrees, metres = np.transpose(rows)
    _, axes = plt.subplots(2, sharex=True, layout="constrained")
    axes[0].plot(time, degrees)
    axes[0].set_ylabel("attitude error [deg]")
    axes[1].plot(time, metres)
    axes[1].set(xlabel="time [s]", ylabel="position error [m]")
    return degrees, metres


def main():
    match sys.argv[1:]:
        case ["--make", seconds]:
            print(*(line for line, _ in made_lines(float(seconds))), sep="\n")
        case ["-"]:
            pose_filter = made_filter()
            for time, pose in poses(sys.stdin, pose_filter):
                print(written(time, pose, pose_filter))
        case []:
            tried()
            plt.show()
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main()
