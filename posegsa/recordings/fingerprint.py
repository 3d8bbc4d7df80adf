"""Checksums of recordings, over everything that a search or a judgement depends on."""

import hashlib
from dataclasses import fields

import jax
import numpy as np

from posegsa.recordings.recording import Recording

WORDS = "name", "sources", "notes"
"""Fields that describe a recording and do not change an estimate."""


def fingerprint(recording: Recording) -> str:
    """SHA-256 of a recording's numbers, in hexadecimal; the same on every machine."""
    digest = hashlib.sha256()
    numbers = {each.name: getattr(recording, each.name) for each in fields(recording)}
    counted = {name: value for name, value in numbers.items() if name not in WORDS}
    for path, leaf in jax.tree_util.tree_leaves_with_path(counted):
        array = leaf if isinstance(leaf, str) else np.asarray(leaf)
        if isinstance(array, np.ndarray):
            array = np.ascontiguousarray(array.astype(array.dtype.newbyteorder("<")))
            digest.update(f"{array.dtype.str} {array.shape} ".encode())
        digest.update(f"{jax.tree_util.keystr(path)} ".encode())
        digest.update(array.encode() if isinstance(array, str) else array.tobytes())
    return digest.hexdigest()
