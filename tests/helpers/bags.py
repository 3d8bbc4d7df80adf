"""Bags of ROS 1 and ROS 2, written by the library that reads them."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from helpers.recordings import motion

KINDS = "ros1", "sqlite3", "mcap"
"""Bags of ROS 1, and of ROS 2 in both formats."""
STORES = {"ros1": Stores.ROS1_NOETIC, "sqlite3": Stores.ROS2_HUMBLE, "mcap": Stores.ROS2_JAZZY}
FIRST = 1_700_000_000_123_456_789
"""The first stamp [ns]."""
LATE = 3_000_000
"""How long after its stamp a message comes into the bag [ns]."""


class Messages:
    """Makes messages of one version of ROS."""

    def __init__(self, kind: str) -> None:
        self.store = get_typestore(STORES[kind])
        self.ros1 = kind == "ros1"

    def make(self, name: str, **values: Any) -> Any:
        return self.store.types[name.replace("/", "/msg/")](**values)

    def header(self, stamp: int, frame: str) -> Any:
        seconds, ns = divmod(stamp, 1_000_000_000)
        time = self.make("builtin_interfaces/Time", sec=seconds, nanosec=ns)
        more = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/Header", stamp=time, frame_id=frame, **more)

    def three(self, values: np.ndarray, name: str = "geometry_msgs/Vector3") -> Any:
        x, y, z = map(float, values)
        return self.make(name, x=x, y=y, z=z)

    def pose(self, P: np.ndarray, R: np.ndarray) -> Any:
        return self.make(
            "geometry_msgs/Pose",
            position=self.three(P, "geometry_msgs/Point"),
            orientation=self.quaternion(R),
        )

    def quaternion(self, R: np.ndarray) -> Any:
        x, y, z, w = map(float, Rotation.from_matrix(R).as_quat())
        return self.make("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)

    def imu(self, stamp: int, omega: np.ndarray, acc: np.ndarray, covariance: float = 0.0) -> Any:
        nothing = np.zeros(9)
        covariances = np.array([covariance, *[0.0] * 8])
        return self.make(
            "sensor_msgs/Imu",
            header=self.header(stamp, "base_link"),
            orientation=self.quaternion(np.eye(3)),
            orientation_covariance=nothing,
            angular_velocity=self.three(omega),
            angular_velocity_covariance=covariances,
            linear_acceleration=self.three(acc),
            linear_acceleration_covariance=nothing,
        )

    def field(self, stamp: int, field: np.ndarray) -> Any:
        return self.make(
            "sensor_msgs/MagneticField",
            header=self.header(stamp, "base_link"),
            magnetic_field=self.three(field),
            magnetic_field_covariance=np.zeros(9),
        )

    def twist(self, stamp: int, linear: np.ndarray, frame: str = "base_link") -> Any:
        twist = self.make(
            "geometry_msgs/Twist", linear=self.three(linear), angular=self.three(np.zeros(3))
        )
        header = self.header(stamp, frame)
        return self.make("geometry_msgs/TwistStamped", header=header, twist=twist)

    def odometry(
        self, stamp: int, P: np.ndarray, R: np.ndarray, linear: np.ndarray, omega: np.ndarray
    ) -> Any:
        nothing = np.zeros(36)
        twist = self.make(
            "geometry_msgs/Twist", linear=self.three(linear), angular=self.three(omega)
        )
        return self.make(
            "nav_msgs/Odometry",
            header=self.header(stamp, "odom"),
            child_frame_id="base_link",
            pose=self.make(
                "geometry_msgs/PoseWithCovariance", pose=self.pose(P, R), covariance=nothing
            ),
            twist=self.make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=nothing),
        )

    def stamped(self, stamp: int, P: np.ndarray, R: np.ndarray, frame: str) -> Any:
        header = self.header(stamp, frame)
        return self.make("geometry_msgs/PoseStamped", header=header, pose=self.pose(P, R))

    def transform(self, stamp: int, P: np.ndarray, R: np.ndarray, frame: str, child: str) -> Any:
        return self.make(
            "geometry_msgs/TransformStamped",
            header=self.header(stamp, frame),
            child_frame_id=child,
            transform=self.make(
                "geometry_msgs/Transform",
                translation=self.three(P),
                rotation=self.quaternion(R),
            ),
        )


def write_bag(
    folder: Path, kind: str, topics: Mapping[str, list[Any]], received: Sequence[int] = ()
) -> Path:
    """A bag with the messages of each topic, in the order of their stamps.

    They come into the bag 3 ms after their stamps, or at the times `received` [ns].
    """
    messages = Messages(kind)
    path = folder / (f"flight_{kind}.bag" if kind == "ros1" else f"flight_{kind}")
    ordered = sorted(
        ((_stamp(one), topic, one) for topic, each in topics.items() for one in each),
        key=lambda three: three[:2],
    )
    with ExitStack() as stack:
        if kind == "ros1":
            writer: Any = stack.enter_context(Writer1(path))
        else:
            plugin = StoragePlugin[kind.upper()]
            writer = stack.enter_context(Writer2(path, version=9, storage_plugin=plugin))
        to = {
            topic: writer.add_connection(topic, each[0].__msgtype__, typestore=messages.store)
            for topic, each in topics.items()
        }
        at = received or [stamp + LATE for stamp, _, _ in ordered]
        for time, (_, topic, one) in zip(at, ordered, strict=True):
            serialise = (
                messages.store.serialize_ros1 if kind == "ros1" else messages.store.serialize_cdr
            )
            writer.write(to[topic], time, serialise(one, one.__msgtype__))
    return path


def _stamp(message: Any) -> int:
    stamp = message.header.stamp
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def flight(kind: str) -> dict[str, list[Any]]:
    """The messages of `motion`: Imu at 100 Hz, odometry at 50, field at 20, landmarks at 10."""
    make, given = Messages(kind), motion()
    stamps = FIRST + 10_000_000 * np.arange(400)
    omega, velocity, R, P, v, y = (
        given[name]
        for name in (
            "angular_velocity",
            "velocity",
            "truth_rotation",
            "truth_position",
            "vectors",
            "landmarks",
        )
    )
    t = [int(stamp) for stamp in stamps]
    each, even, fifth, tenth = (range(0, 400, step) for step in (1, 2, 5, 10))
    return {
        "/imu": [make.imu(t[k], omega[k], 9.81 * v[k, 0]) for k in each],
        "/mag": [make.field(t[k] + 1_000_000, 5e-5 * v[k, 1]) for k in fifth],
        "/odom": [make.odometry(t[k], P[k], R[k], velocity[k], omega[k]) for k in even],
        "/twist": [make.twist(t[k], velocity[k]) for k in even],
        "/world_twist": [make.twist(t[k], velocity[k], "map") for k in even],
        "/tag_0": [make.stamped(t[k], y[k, 0], np.eye(3), "base_link") for k in tenth],
        "/tag_1": [
            make.transform(t[k] + 2_000_000, y[k, 1], np.eye(3), "base_link", "tag_1")
            for k in tenth
        ],
        "/mocap": [make.transform(t[k], P[k], R[k], "world", "base_link") for k in even],
        "/mocap_pose": [make.stamped(t[k], P[k], R[k], "world") for k in even],
    }
