"""A recording's fingerprint depends on all of its numbers and on nothing else."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from helpers.recordings import motion

from posegsa.recordings.fingerprint import fingerprint
from posegsa.recordings.imu import ImuRecording
from posegsa.recordings.recording import Recording

pytestmark = pytest.mark.quick


@pytest.fixture(scope="module")
def recording() -> Recording:
    return Recording.from_arrays(**motion(50)).off(20, 0.5)


def test_names_and_a_file_change_nothing(recording: Recording, tmp_path: Path) -> None:
    own = fingerprint(recording)
    assert len(own) == 64
    assert fingerprint(replace(recording, name="x", sources={"a": "b"}, notes=("c",))) == own
    recording.save(tmp_path / "a.npz")
    assert fingerprint(Recording.read(tmp_path / "a.npz")) == own


def test_every_number_counts(recording: Recording) -> None:
    changed = [
        recording.off(21, 0.5),
        replace(recording, start="rest"),
        replace(recording, judged=np.arange(50) > 3),
        replace(recording, phases={"late": np.arange(50) > 9}),
        replace(recording, truth=None),
        recording.window(0, 0.4),
    ]
    for name in ("angular_velocity", "vectors", "landmark_references"):
        given = motion(50)
        given[name] = given[name] + 0.0
        given[name].flat[-1] = np.nextafter(given[name].flat[-1], 9)
        changed.append(Recording.from_arrays(**given).off(20, 0.5))
    found = [fingerprint(one) for one in (recording, *changed)]
    assert len(set(found)) == len(found)


def test_the_frame_of_an_inertial_sensor_counts(recording: Recording) -> None:
    own = {each.name: getattr(recording, each.name) for each in fields(recording)}
    one, same, other = (
        fingerprint(ImuRecording(**own | {"frame": f})) for f in ("ENU", "ENU", "NED")
    )
    assert one == same != other
