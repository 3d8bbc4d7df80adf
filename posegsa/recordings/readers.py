"""The files that are recordings, by their suffix."""

READERS = {
    ".csv": "from_csv",
    ".npz": "from_npz",
    ".mat": "from_broad",
    ".bag": "from_rosbag",
    ".mcap": "from_rosbag",
    ".db3": "from_rosbag",
}
"""The method of `Recording` that reads a file with this suffix. Its arguments after the path are
those of `from_arrays`, which replace what the file says."""
IN_WORDS = (
    "a .csv file (columns: docs/recordings.md), an .npz file, a .mat file of BROAD, the folder of "
    "a EuRoC sequence, or a bag of ROS 1 or 2, with its topics in FILE.toml beside it"
)
"""What can be read, for help and errors."""
