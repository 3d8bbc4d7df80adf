"""Filter a stream of CSV lines, a hundred per second, and print a pose for each.

    python examples/stream.py --make 30 > sensors.csv     # 30 s of made-up sensors
    python examples/stream.py < sensors.csv               # or from a serial port, a socket, ...

A line is time, gyroscope (3), velocity (3), accelerometer (3), compass (3), beacon (3), in the body
frame and SI units. Empty fields were not measured, and there is no header line. The body hardly
accelerates. The output is time, position (3) [m] and roll, pitch, yaw [deg].
"""

import csv
import sys

import jax.numpy as jnp
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


def main():
    if sys.argv[1:2] == ["--make"] and len(sys.argv) == 3:
        print(*(line for line, _ in made_lines(float(sys.argv[2]))), sep="\n")
        return
    pose_filter = made_filter()
    for time, pose in poses(sys.stdin, pose_filter):
        x, y, z = pose.position
        roll, pitch, yaw = Rotation.from_matrix(pose.rotation).as_euler("xyz", degrees=True)
        doubt = "" if pose_filter.observable else f"   {pose_filter.why_unobservable}"
        print(f"{time:.3f},{x:.3f},{y:.3f},{z:.3f},{roll:.2f},{pitch:.2f},{yaw:.2f}{doubt}")


if __name__ == "__main__":
    main()
