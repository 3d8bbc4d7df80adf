"""The state of a search in one file with a checksum, without pickling.

    line 1: "posegsa checkpoint"
    line 2: SHA-256 of all that follows, in hexadecimal
    line 3: JSON: format, about, and the name, dtype and shape of each array
    the arrays' bytes, one after the other, little-endian

A `Search` can be saved if its state consists of arrays. They are named by their path in the search,
such as `.state.position`; random keys are stored as their numbers.
"""

import hashlib
import json
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from posegsa.errors import CheckpointError, DamagedCheckpointError
from posegsa.optimisers import Search
from posegsa.saving.atomic_files import read_bounded, write_atomically

FORMAT = 3
"""Version of the format; it changes when older checkpoints cannot be read any more."""

MAX_BYTES = 2**31
"""Maximum size of a checkpoint: 2 GiB."""

_MAGIC = b"posegsa checkpoint\n"
_DIGEST = 2 * hashlib.sha256().digest_size + 1  # characters, and the end of the line
_MAX_HEADER = 2**24


class Checkpoint(NamedTuple):
    """A checkpoint with a valid checksum; its arrays are not yet matched with a search."""

    path: Path
    about: dict[str, Any]
    """What was stored besides the search."""
    arrays: dict[str, tuple[str, str, tuple[int, ...]]]
    """Dtypes and shapes by path in the search, from `_described`; used for checks only."""
    numbers: memoryview
    """The bytes of all arrays, one after the other."""

    def search(self, like: Search) -> Search:
        """The search, with the structure of another search, such as from `start`.

        Raises:
            CheckpointError: An array is missing or has another shape or dtype, or `like` contains
                something other than arrays; names it.
        """
        wanted = _arrays("like", like)
        for name in wanted | self.arrays:
            if name not in self.arrays:
                raise CheckpointError(f"{self.path}: has no {name}, which this optimiser needs")
            if name not in wanted:
                raise CheckpointError(
                    f"{self.path}: has {name}, which this optimiser does not have"
                )
        found, offset = {}, 0
        for name, described in self.arrays.items():
            leaf, numbers = wanted[name], _numbers(wanted[name])
            relations = ("is", "is stored as", "has shape")
            for relation, has, needed in zip(relations, described, _described(leaf), strict=True):
                if has != needed:
                    raise CheckpointError(f"{self.path}: {name} {relation} {has}; needed: {needed}")
            stored = numbers.dtype.newbyteorder("<")
            end = offset + numbers.nbytes
            if end > len(self.numbers):
                raise CheckpointError(f"{self.path}: has no bytes for {name}")
            values = np.frombuffer(self.numbers[offset:end], stored).reshape(numbers.shape)
            array = jnp.asarray(values.astype(numbers.dtype, copy=False))
            offset = end
            if _is_key(leaf):
                array = jax.random.wrap_key_data(array, impl=jax.random.key_impl(leaf))
            found[name] = array
        if offset != len(self.numbers):
            extra = len(self.numbers) - offset
            raise CheckpointError(f"{self.path}: {extra} bytes belong to no array")
        return jax.tree.unflatten(jax.tree.structure(like), [found[name] for name in wanted])


def save_search(path: str | Path, search: Search, about: dict[str, Any] | None = None) -> None:
    """Write a search to a file atomically.

    Args:
        path: The file; its folder exists.
        search: From `start`, `advance` or `minimise`, or the argument of a callback.
        about: Further data to store, in JSON's types.

    Raises:
        CheckpointError: The argument is not a search, its state does not consist of arrays, or the
            file cannot be written.
    """
    if not isinstance(search, Search):
        raise CheckpointError(f"search: a {type(search).__name__}; needed: a Search")
    arrays = _arrays("search", search)
    header = {
        "format": FORMAT,
        "about": about or {},
        "arrays": [[name, *_described(array)] for name, array in arrays.items()],
    }
    stored = map(_numbers, arrays.values())
    bytes_of = (a.astype(a.dtype.newbyteorder("<")).tobytes() for a in stored)
    content = json.dumps(header).encode() + b"\n" + b"".join(bytes_of)
    digest = hashlib.sha256(content).hexdigest().encode()
    try:
        write_atomically(Path(path), _MAGIC + digest + b"\n" + content)
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be written: {error.strerror}") from error


def load_search(path: str | Path, like: Search) -> Search:
    """Read a search from a file that `save_search` wrote.

    Args:
        path: The file.
        like: A search of the same optimiser, box and dtype: `start(optimiser, box, key)`. Its
            values do not matter.

    Raises:
        CheckpointError: The file cannot be read, is damaged, or contains a search with another
            structure, shape or dtype; the message names the difference.
    """
    if not isinstance(like, Search):
        raise CheckpointError(f"like: a {type(like).__name__}; needed: a Search")
    return read(Path(path)).search(like)


def read(path: Path) -> Checkpoint:
    """Read a checkpoint and verify its checksum.

    Raises:
        DamagedCheckpointError: It is truncated, changed, or not a checkpoint.
        CheckpointError: It cannot be read, or has another format.
    """
    try:
        content = read_bounded(path, MAX_BYTES)
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read: {error.strerror or error}") from None
    start = len(_MAGIC) + _DIGEST
    if not content.startswith(_MAGIC):
        raise DamagedCheckpointError(f"{path}: is no checkpoint, or its beginning is damaged")
    digest, rest = content[len(_MAGIC) : start], memoryview(content)[start:]
    if digest != hashlib.sha256(rest).hexdigest().encode() + b"\n":
        raise DamagedCheckpointError(f"{path}: is damaged: its checksum is wrong")
    try:
        end = content.index(b"\n", start, start + _MAX_HEADER)
        header = json.loads(content[start:end])
        if header["format"] != FORMAT:
            raise CheckpointError(
                f"{path}: has format {header['format']}; this version of posegsa reads {FORMAT}"
            )
        return Checkpoint(
            path=path,
            about=dict(header["about"]),
            arrays={name: (a, b, tuple(shape)) for name, a, b, shape in header["arrays"]},
            numbers=memoryview(content)[end + 1 :],
        )
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        # The checksum is valid, so the file is not damaged.
        raise CheckpointError(f"{path}: is not as posegsa writes it: {error}") from None


def _arrays(argument: str, search: Search) -> dict[str, jax.Array]:
    """The arrays of a search by their path in it.

    Raises:
        CheckpointError: It contains something else.
    """
    leaves, _ = jax.tree_util.tree_flatten_with_path(search)
    arrays = {jax.tree_util.keystr(path): leaf for path, leaf in leaves}
    for path, leaf in arrays.items():
        if not _is_numeric(leaf):
            raise CheckpointError(
                f"{argument}{path} is a {type(leaf).__name__}; needed: an array, so that it can be "
                "saved and read"
            )
    return {path: jnp.asarray(leaf) for path, leaf in arrays.items()}


def _is_numeric(leaf: object) -> bool:
    if isinstance(leaf, bool | int | float | complex):
        return True
    dtype, kinds = getattr(leaf, "dtype", None), (np.number, np.bool_, jax.dtypes.prng_key)
    return dtype is not None and any(jnp.issubdtype(dtype, kind) for kind in kinds)


def _is_key(leaf: jax.Array) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _described(leaf: jax.Array) -> tuple[str, str, tuple[int, ...]]:
    """The JAX dtype of an array, and the dtype and shape of its stored numbers."""
    numbers = _numbers(leaf)
    return str(leaf.dtype), numbers.dtype.name, numbers.shape


def _numbers(leaf: jax.Array) -> np.ndarray:
    """The numbers of an array, or those of a random key."""
    return np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)
