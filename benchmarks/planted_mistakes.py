"""The usual mistakes, planted in real recordings, and what `posegsa check` reports.

First all recordings are checked unchanged: nothing may be reported. Then each possible mistake is
planted in a flight, in EuRoC V1_02 and in a trial of BROAD: it alone should be reported.

DATA_FOLDER has the folders `flights`, `euroc` and `broad`.

    python benchmarks/planted_mistakes.py DATA_FOLDER [--write]
"""

import argparse
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from readme import write_block

from posegsa.recordings.data_check import check
from posegsa.recordings.recording import Recording
from posegsa.recordings.rotations import matrices, quaternions

PAGE = "docs/recordings_results.md"
SHOWN = "flights/eight_1.csv", "euroc", "broad/02_undisturbed_slow_rotation_B.mat"
LATE = 0.05
"""Delay of a sensor that is late [s]."""
GRAVITY = 9.81
Arguments = dict[str, Any]
Planted = tuple[str, str, Arguments]
"""A mistake: its name, what the check should say (a regular expression), and the data with it."""


def arguments(recording: Recording) -> Arguments:
    """The arguments that make a recording again."""
    m = {name: np.array(a, float) for name, a in recording.measurements._asdict().items()}
    assert recording.truth is not None
    found: Arguments = {
        "name": recording.name,
        "time": recording.time.copy(),
        "angular_velocity": m["angular_velocity"],
        "sensors": {name: signal.copy() for name, signal in recording.sensors.items()},
        "truth_quaternion": quaternions(recording.truth.rotation),
        "landmark_outlier": "off",
    }
    if not recording.attitude_only:
        found |= {"velocity": m["velocity"], "truth_position": recording.truth.position}
    for name in ("vectors", "landmarks"):
        if m[name].shape[1]:
            one = name.removesuffix("s")
            seen = m[f"{one}_weights"][..., None] > 0
            found |= {name: np.where(seen, m[name], np.nan)}
            found |= {f"{one}_references": m[f"{one}_references"][0]}
    return found


def flipped(name: str, about: str, values: np.ndarray) -> Iterator[tuple[str, str, np.ndarray]]:
    """A sensor's axes with a wrong sign, or exchanged."""
    yield f"{name}: y of the wrong sign", f"{about}: the sign of its y", values * [1, -1, 1]
    yield f"{name}: x and y exchanged", f"{about}: its axes look exch", values[..., [1, 0, 2]]


def late(values: np.ndarray, samples: int) -> np.ndarray:
    """Values that come some samples too late."""
    return np.concatenate([np.repeat(values[:1], samples, axis=0), values[:-samples]])


def planted(given: Arguments) -> Iterator[Planted]:
    """All mistakes that can be made in a recording."""
    R, q = matrices(given["truth_quaternion"]), given["truth_quaternion"]
    samples = round(LATE / float(np.median(np.diff(given["time"]))))
    gyro = given["angular_velocity"]
    about = "angular_velocity"
    yield "gyroscope in deg/s", f"{about} looks like deg/s", given | {about: np.rad2deg(gyro)}
    for name, words, values in flipped("gyroscope", about, gyro):
        yield name, words, given | {about: values}
    yield "gyroscope late", f"{about} looks .* late", given | {about: late(gyro, samples)}
    wrong = given | {"truth_quaternion": q[:, [1, 2, 3, 0]]}
    yield "quaternion scalar last", "as if its scalar came last", wrong
    inverse = given | {"truth_quaternion": q * [1, -1, -1, -1]}
    yield "rotation inverse", "rotation looks inverse", inverse
    if "velocity" in given:
        v = given["velocity"]
        turned = given | {"velocity": np.einsum("kij,kj->ki", R, v)}
        yield "velocity in the inertial frame", "velocity looks .* inertial frame", turned
        for name, words, values in flipped("velocity", "velocity", v):
            yield name, words, given | {"velocity": values}
        yield "velocity late", "velocity looks .* late", given | {"velocity": late(v, samples)}
    if "landmarks" in given:
        yield from in_landmarks(given, R, samples)
    if "vectors" in given and not given["sensors"]:
        yield from in_vectors(given, R)
    for name in given["sensors"]:
        yield from in_raw_sensors(given, R, name)


def in_landmarks(given: Arguments, R: np.ndarray, samples: int) -> Iterator[Planted]:
    """Mistakes in landmarks."""
    y = given["landmarks"]
    order = [2, 1, 0, *range(3, y.shape[1])]
    yield "two landmarks exchanged", "landmarks 0 and 2 look", given | {"landmarks": y[:, order]}
    turned = np.einsum("kij,kmj->kmi", R, y)
    words = "landmarks look as if they were measured in the inertial"
    yield "landmarks in the inertial frame", words, given | {"landmarks": turned}
    places = given | {"landmarks": turned + given["truth_position"][:, None]}
    yield "landmarks as their positions", "landmarks look like their positions", places
    for name, words, values in flipped("landmarks", "landmarks", y):
        yield name, words, given | {"landmarks": values}
    yield "landmarks late", r"landmark.* looks? .* late", given | {"landmarks": late(y, samples)}


def in_vectors(given: Arguments, R: np.ndarray) -> Iterator[Planted]:
    """Mistakes in two vectors, gravity and the field, as directions."""
    b, r = given["vectors"], np.array(given["vector_references"])

    def vector(i: int, values: np.ndarray) -> Arguments:
        changed = b.copy()
        changed[:, i] = values
        return given | {"vectors": changed}

    def reference(i: int, value: np.ndarray) -> Arguments:
        changed = r.copy()
        changed[i] = value
        return given | {"vector_references": changed}

    yield "gravity pointing down", "vector 0 and its reference look opp", reference(0, -r[0])
    without = b[:, 0] - np.einsum("kji,j->ki", R, r[0])
    yield "acceleration without gravity", "without gravity", vector(0, without)
    yield "multiples of g", "vector 0 looks like multiples of g", vector(0, b[:, 0] / GRAVITY)
    mirrored = reference(1, r[1][[1, 0, 2]] * [1, 1, -1])
    yield "north-east-down for east-north-up", "reference of vector 1 looks mirrored", mirrored
    swapped = given | {"vectors": b[:, ::-1]}
    yield "two vectors exchanged", "vector 0 and vector 1 look exchanged", swapped
    inertial = np.einsum("kij,kj->ki", R, b[:, 1])
    words = "vector 1 and its reference look exchanged"
    yield "a vector and its reference exchanged", words, vector(1, inertial)
    for name, words, values in flipped("field", "vector 1", b[:, 1]):
        yield name, words, vector(1, values)


def in_raw_sensors(given: Arguments, R: np.ndarray, name: str) -> Iterator[Planted]:
    """Mistakes in the raw signals of inertial sensors."""
    signal = given["sensors"][name]

    def changed(values: np.ndarray) -> Arguments:
        return given | {"sensors": given["sensors"] | {name: values}}

    for each, words, values in flipped(name, name, signal):
        yield each, words, changed(values)
    if name == "accelerometer":
        yield "gravity pointing down", f"{name} and its reference look opposite", changed(-signal)
        yield "multiples of g", f"{name} looks like multiples of g", changed(signal / GRAVITY)
        without = signal - GRAVITY * R[:, 2]
        yield "acceleration without gravity", "without gravity", changed(without)


def look(words: str, given: Arguments) -> str:
    """A cell of the table: how many times better the data fit without the mistake."""
    found = check(Recording.from_arrays(**given)).findings
    if not found or not all(re.search(words, one) for one in found):
        return f"**not named: {'; '.join(found) or 'nothing said'}**"
    times = re.search(r"\(fits (.*) times better\)", found[0])
    return "named" if times is None else times[1].replace("over ", "> ")


def main() -> None:
    """Check all recordings, plant the mistakes, print the table and write it into the page."""
    parser = argparse.ArgumentParser(description="What posegsa check reports of planted mistakes.")
    parser.add_argument("data", metavar="DATA_FOLDER", type=Path)
    parser.add_argument("--write", action="store_true", help=f"into {PAGE}")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    paths = [*sorted((options.data / "flights").glob("*.csv")), options.data / "euroc"]
    paths += sorted((options.data / "broad").glob("*.mat"))
    alarms = []
    for path in paths:
        findings = check(Recording.read(path, landmark_outlier="off")).findings
        alarms += [f"{path.name}: {words}" for words in findings]
    print(f"{len(alarms)} false alarms on {len(paths)} recordings", *alarms, sep="\n", flush=True)
    rows: dict[str, dict[str, str]] = {}
    for shown in SHOWN:
        given = arguments(Recording.read(options.data / shown))
        for name, words, data in planted(given):
            rows.setdefault(name, {})[shown] = look(words, data)
            print(shown, name, rows[name][shown], flush=True)
    names = [Path(shown).stem.split("_und")[0] for shown in SHOWN]
    lines = [f"| fits better without | {' | '.join(names)} |", f"| --- |{' --: |' * len(names)}"]
    for name, cells in rows.items():
        lines.append(f"| {name} | {' | '.join(cells.get(shown, '') for shown in SHOWN)} |")
    count = sum(len(cells) for cells in rows.values())
    right = sum("not" not in cell for cells in rows.values() for cell in cells.values())
    lines += ["", f"{right} of {count} mistakes are named, and nothing else. "]
    lines[-1] += f"False alarms: {len(alarms)} on {len(paths)} recordings."
    text = "\n".join(lines)
    print(text)
    if options.write:
        write_block("mistakes", text, PAGE)


if __name__ == "__main__":
    main()
