"""Check that a recording has a vector or a landmark, without which nothing corrects estimates."""

from collections.abc import Collection

import numpy as np

from posegsa.errors import RecordingError
from posegsa.model.measurements import Measurements


def check_something_is_seen(
    name: str, measurements: Measurements, sensors: Collection[str], notes: tuple[str, ...]
) -> None:
    """Raise a RecordingError, with advice, unless there is a vector or a landmark.

    Args:
        name: Name of the recording.
        measurements: Measurements of the recording.
        sensors: Names of its raw signals.
        notes: Notes of the recording, such as columns that were not used.
    """
    if np.shape(measurements.vectors)[1] or np.shape(measurements.landmarks)[1]:
        return
    told = f" ({'; '.join(notes)})" if notes else ""
    imu = ""
    if "accelerometer" in sensors:
        imu = "; `posegsa replay imu` computes vectors from accelerometer and magnetometer"
    raise RecordingError(
        f"{name}: has no vectors and no landmarks, so that nothing corrects an estimate{told}; "
        "allowed in a CSV file: columns v0_x v0_y v0_z of a vector and l0_x l0_y l0_z of a "
        f"landmark, or others that {name}.csv.toml beside it names, in Python columns= of "
        "Recording.from_csv; in an .npz file: vectors (N, n, 3) and vector_references, or the same "
        f"of landmarks (docs/recordings.md){imu}"
    )
