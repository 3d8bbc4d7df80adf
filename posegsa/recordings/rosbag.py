"""Reads bags of ROS 1 and ROS 2 by the package rosbags, which needs no ROS.

    angular_velocity              Imu; TwistStamped, Odometry
    velocity                      TwistStamped, Odometry
    vectors                       Imu (linear_acceleration), MagneticField, Vector3Stamped
    landmarks                     PointStamped, PoseStamped, TransformStamped, in the body frame
    truth                         PoseStamped, TransformStamped, Odometry: of the body
    accelerometer, magnetometer   Imu; MagneticField

and the same types with a covariance. Frames are those of REP-103 and REP-145: x forward, y left, z
up; an Imu at rest measures +9.8 m/s^2 upwards; quaternions are (x, y, z, w). The twist of an
Odometry is in its child frame, which is the body. No transforms are applied, so all sensors must
measure in one frame of the body.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from jax.typing import ArrayLike

from posegsa.errors import RecordingError
from posegsa.model.measurements import finite_array
from posegsa.recordings.checked_files import as_path, file_of, reading
from posegsa.recordings.streams import Stream

Topics: TypeAlias = Mapping[str, str | Sequence[str]]
"""The topic of each quantity; a list of topics for vectors and for landmarks."""
Stamps: TypeAlias = Literal["header", "bag"]
"""Time stamps of the messages: the time of measurement, or the time of recording into the bag."""

_POSES = {
    "geometry_msgs/msg/PoseStamped": "pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose",
    "nav_msgs/msg/Odometry": "pose.pose",
}
_TWISTS = {
    "geometry_msgs/msg/TwistStamped": "twist",
    "geometry_msgs/msg/TwistWithCovarianceStamped": "twist.twist",
    "nav_msgs/msg/Odometry": "twist.twist",
}
_IMU, _FIELD = "sensor_msgs/msg/Imu", "sensor_msgs/msg/MagneticField"
_TRANSFORM = "geometry_msgs/msg/TransformStamped"
FIELDS: dict[str, dict[str, str]] = {
    "angular_velocity": {_IMU: "angular_velocity"}
    | {kind: f"{twist}.angular" for kind, twist in _TWISTS.items()},
    "velocity": {kind: f"{twist}.linear" for kind, twist in _TWISTS.items()},
    "vectors": {
        _IMU: "linear_acceleration",
        _FIELD: "magnetic_field",
        "geometry_msgs/msg/Vector3Stamped": "vector",
    },
    "landmarks": {
        "geometry_msgs/msg/PointStamped": "point",
        "geometry_msgs/msg/PoseStamped": "pose.position",
        "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose.position",
        _TRANSFORM: "transform.translation",
    },
    "truth_quaternion": {kind: f"{pose}.orientation" for kind, pose in _POSES.items()}
    | {_TRANSFORM: "transform.rotation"},
    "truth_position": {kind: f"{pose}.position" for kind, pose in _POSES.items()}
    | {_TRANSFORM: "transform.translation"},
    "accelerometer": {_IMU: "linear_acceleration"},
    "magnetometer": {_FIELD: "magnetic_field"},
}
"""For each quantity, the message types that contain it, and its place in the message."""
TRUTH = "truth_quaternion", "truth_position"
QUANTITIES = (*(name for name in FIELDS if name not in TRUTH), "truth")
"""The quantities that a topic can be given for."""
SEVERAL = "vectors", "landmarks"
INERTIAL = "map", "odom", "world", "earth"
"""Names of frames that are not the body's (REP-105)."""


def is_bag(folder: Path) -> bool:
    """Whether a folder is a bag of ROS 2."""
    return (folder / "metadata.yaml").is_file()


def read_rosbag(
    path: str | Path, topics: Topics | None, stamps: Stamps
) -> tuple[dict[str, Any], dict[str, str], list[str]]:
    """The streams of a bag, what each was read from, and notes; see `Recording.from_rosbag`.

    Raises:
        RecordingError: the bag cannot be read; or a topic is missing, empty or of another type, or
            its frames or covariances do not fit; names it.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise RecordingError(
            f"{path}: bags are read by rosbags, which is not installed; in a clone of posegsa: "
            "pip install '.[ros]'"
        ) from None
    path = as_path(path)
    if not path.exists():
        raise RecordingError(f"{path}: there is no such file or folder")
    if path.is_file():
        file_of(path)
    if stamps not in get_args(Stamps):
        raise RecordingError(f"stamps = {stamps!r}; allowed: {', '.join(get_args(Stamps))}")
    # Bags of older versions of ROS 2 do not contain the message definitions.
    usual = get_typestore(Stores.LATEST)
    with reading(path), AnyReader([path], default_typestore=usual) as bag:
        held = {name: str(info.msgtype) for name, info in bag.topics.items()}
        wanted = _wanted(path, _imu(path, held) if topics is None else topics, held)
        messages: dict[str, list[tuple[int, Any]]] = {topic: [] for _, topic in wanted}
        used = [one for one in bag.connections if one.topic in messages]
        for connection, received, data in bag.messages(connections=used):
            message = bag.deserialize(data, connection.msgtype)
            messages[connection.topic].append((received, message))
    streams: dict[str, Any] = {}
    sources = {}
    for quantity, topic in wanted:
        where = f"{path}: topic {topic!r}"
        if not messages[topic]:
            raise RecordingError(f"{where}, for {quantity}: holds no message")
        kind = held[topic]
        stream = _stream(where, quantity, kind, messages[topic], stamps)
        words = f"{topic} ({_short(kind)})"
        name = "truth" if quantity in TRUTH else quantity.replace("_", " ")
        if quantity in SEVERAL:
            streams.setdefault(quantity, []).append(stream)
            before = f"{sources[name]}," if name in sources else "measured:"
            sources[name] = f"{before} {words}"
        else:
            streams[quantity], sources[name] = stream, f"measured: {words}"
    return streams, sources, _unnamed(path, held, messages) if topics is None else []


def of_unit_length(
    streams: Sequence[Stream], references: ArrayLike
) -> tuple[list[Stream], np.ndarray]:
    """Vectors and their references (n, 3), both divided by the length of the reference.

    Raises:
        MeasurementError: there is not one reference for each vector.
        RecordingError: a reference is 0.
    """
    known = finite_array("vector_references", references, (len(streams), 3))
    length = np.linalg.norm(known, axis=1)
    if not length.all():
        raise RecordingError(f"vector_references: {known.tolist()}; allowed: none of length 0")
    divided = [
        (time, np.asarray(values) / size)
        for (time, values), size in zip(streams, length, strict=True)
    ]
    return divided, known / length[:, None]


def _imu(path: Path, held: Mapping[str, str]) -> Topics:
    """The topics of an inertial sensor, if a bag has just one."""
    imus = [topic for topic, kind in held.items() if kind == _IMU]
    fields = [topic for topic, kind in held.items() if kind == _FIELD]
    if len(imus) != 1 or len(fields) > 1:
        raise RecordingError(
            f"{path}: nothing says which topics to read; allowed: topics = {{angular_velocity = "
            f'"/imu", ...}} in {path.name}.toml beside it, in Python topics=, for any of '
            f"{', '.join(QUANTITIES)}; {_in_words(held)}"
        )
    magnetometer = {"magnetometer": fields[0]} if fields else {}
    return {"angular_velocity": imus[0], "accelerometer": imus[0]} | magnetometer


def _unnamed(path: Path, held: Mapping[str, str], used: Collection[str]) -> list[str]:
    """A note on the topics that a bag holds in addition to those of its inertial sensor, if any."""
    quantities = "velocity", "vectors", "landmarks", "truth_position"
    more = {
        quantity: [topic for topic, kind in held.items() if kind in FIELDS[quantity]]
        for quantity in quantities
    }
    others = [t for t in held if t not in used and any(t in each for each in more.values())]
    if not others:
        return []
    velocity = next((topic for topic in more["velocity"] if topic in others), "/...")
    return [
        f"no topics are named, so only {', '.join(used)} are read, for attitude alone, and not "
        f"{', '.join(others)}; a pose needs velocity, and vectors or landmarks: [topics] in "
        f'{path.name}.toml beside it, with lines such as velocity = "{velocity}"'
    ]


def _wanted(path: Path, topics: Topics, held: Mapping[str, str]) -> list[tuple[str, str]]:
    """The quantities to read, each with its topic."""
    found = []
    for quantity, given in topics.items():
        if quantity not in QUANTITIES:
            raise RecordingError(f"topics: {quantity!r}; allowed: {', '.join(QUANTITIES)}")
        names: Any = given if quantity in SEVERAL else [given]
        if isinstance(names, str) or not all(isinstance(name, str) for name in names):
            allowed = "a list of topics" if quantity in SEVERAL else "a topic"
            raise RecordingError(f"topics: {quantity} = {given!r}; allowed: {allowed}")
        for topic in names:
            each = TRUTH if quantity == "truth" else (quantity,)
            _check_topic(path, quantity, topic, FIELDS[each[0]], held)
            found += [(one, topic) for one in each]
    if "angular_velocity" not in topics:
        raise RecordingError(f"{path}: topics: lacks angular_velocity; {_in_words(held)}")
    return found


def _check_topic(
    path: Path, quantity: str, topic: str, kinds: Collection[str], held: Mapping[str, str]
) -> None:
    """Raise a RecordingError unless a bag has a topic of one of these types."""
    if topic not in held:
        raise RecordingError(f"{path}: no topic {topic!r}, for {quantity}; {_in_words(held)}")
    if held[topic] not in kinds:
        raise RecordingError(
            f"{path}: topic {topic!r} is {_short(held[topic])}, for {quantity}; allowed: "
            f"{', '.join(map(_short, kinds))}; {_in_words(held)}"
        )


def _stream(
    where: str, quantity: str, kind: str, messages: list[tuple[int, Any]], stamps: Stamps
) -> Stream:
    """The stream of a quantity from the messages of a topic."""
    _check_frames(where, quantity, kind, [message for _, message in messages])
    field = FIELDS[quantity][kind]
    if kind == _IMU and getattr(messages[0][1], f"{field}_covariance")[0] == -1:
        raise RecordingError(
            f"{where}: its {field}_covariance begins with -1, so it does not measure that (REP-145)"
        )
    time = [received for received, _ in messages]
    if stamps == "header":
        heads = [message.header.stamp for _, message in messages]
        time = [stamp.sec * 1_000_000_000 + stamp.nanosec for stamp in heads]
        if not any(time):
            raise RecordingError(
                f"{where}: the stamps in its headers are all 0; allowed: stamps = 'bag', the time "
                "at which messages came into the bag"
            )
    parts = attrgetter(*(("w", "x", "y", "z") if quantity == TRUTH[0] else ("x", "y", "z")))
    read = attrgetter(field)
    return np.array(time, np.int64), np.array([parts(read(m)) for _, m in messages], float)


def _check_frames(where: str, quantity: str, kind: str, messages: list[Any]) -> None:
    """Raise a RecordingError if messages differ in their frames, or are not in the body's."""
    frames = sorted({(one.header.frame_id, getattr(one, "child_frame_id", "")) for one in messages})
    if len(frames) > 1:
        names = ", ".join(f"{a} -> {b}" if b else a for a, b in frames[:5])
        raise RecordingError(f"{where}: holds several frames: {names}; allowed: one for each topic")
    header, child = frames[0]
    frame = child if kind in _TWISTS and "child_frame_id" in dir(messages[0]) else header
    if quantity not in TRUTH and frame.strip("/") in INERTIAL:
        raise RecordingError(
            f"{where}, for {quantity}: is in the frame {frame!r}; allowed: the body's, such as "
            "base_link"
        )


def _in_words(held: Mapping[str, str]) -> str:
    """The topics of a bag and their types."""
    each: Iterator[str] = (f"{topic} ({_short(kind)})" for topic, kind in held.items())
    return f"the bag has: {', '.join(each) or 'no topic'}"


def _short(kind: str) -> str:
    """The type of a message as ROS 1 and users write it: sensor_msgs/Imu."""
    return kind.replace("/msg/", "/")
