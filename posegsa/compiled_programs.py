"""Compiled programs, kept on disk, so that a second process need not compile them again.

JAX keeps them (its persistent compilation cache), in files that it writes in place: one whose
process is killed meanwhile stays damaged for ever, and another process may read half of it. Here a
file appears whole, by a rename, so that any number of processes can share the folder; and a folder
that can't be used is said once.
"""

import importlib
import os
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from posegsa.errors import PosegsaWarning

LEAST_SECONDS = 0.1
"""Time that a program must take to compile to be kept [s]: most here take under a second, and are
together most of a short run."""
_WRITING = ".writing-"
_ABANDONED = 24 * 3600.0
"""Age at which what a killed process has left half written is removed [s]."""


def enable_compilation_cache() -> None:
    """Keep compiled programs in the user's cache folder, and use those that are there.

    That is `posegsa` in XDG_CACHE_HOME, else in ~/.cache, unless JAX has been given a folder
    (JAX_COMPILATION_CACHE_DIR) or is to keep none (JAX_ENABLE_COMPILATION_CACHE=false). A folder
    that can't be made is said in a warning; programs are then not kept.
    """
    config: Any = jax.config  # whose options no stub lists
    if not config.jax_enable_compilation_cache:
        return
    given = config.jax_compilation_cache_dir
    try:
        folder = Path(given) if given is not None else _own_folder()
        if "://" not in str(given):  # else JAX reads and writes it, such as a bucket
            folder.mkdir(parents=True, exist_ok=True)
            _write_whole_files(_can_write(folder))
            _remove_abandoned(folder)
    except (OSError, RuntimeError) as error:
        config.update("jax_compilation_cache_dir", None)
        _say_not_kept(error)
        return
    least = min(LEAST_SECONDS, config.jax_persistent_cache_min_compile_time_secs)
    config.update("jax_persistent_cache_min_compile_time_secs", least)
    config.update("jax_compilation_cache_dir", given or str(folder))


def _own_folder() -> Path:
    """The user's folder; RuntimeError where the user has no home."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "posegsa"


def _can_write(folder: Path) -> bool:
    """Whether programs can be kept there; others' may still be read."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError as error:
        _say_not_kept(error)
        return False


def _say_not_kept(error: Exception) -> None:
    warnings.warn(
        f"compiled programs can't be kept, so that every start compiles anew ({error}); XDG_CACHE_"
        "HOME names another folder, JAX_ENABLE_COMPILATION_CACHE=false keeps none",
        PosegsaWarning,
        stacklevel=4,
    )


def _write_whole_files(writes: bool) -> None:
    """Have JAX write its programs through `WholeFiles`, or none.

    Private, but there is no public way; should it change, JAX writes as it always has.
    """
    module: Any = importlib.import_module("jax._src.compilation_cache")
    made = getattr(module, "get_file_cache", None)
    if made is not None:
        module.get_file_cache = _Made(getattr(made, "make", made), writes)


class _Made:
    """JAX's function that makes a cache of a folder, with `WholeFiles` around the cache."""

    def __init__(self, make: Callable[[str], Any], writes: bool) -> None:
        self.make, self.writes = make, writes
        self._made: dict[str, WholeFiles] = {}

    def __call__(self, path: str) -> Any:
        if path not in self._made:
            found = self.make(path)
            if found is None or getattr(found[0], "eviction_enabled", False):
                return found  # a bounded one has a lock of its own
            one = WholeFiles(found[0], path, lambda place: self.make(place)[0], self.writes)
            # The same whenever JAX asks again, so that what could not be written is said once.
            self._made[path] = one
        return self._made[path], path


class WholeFiles:
    """A cache of JAX's in a folder whose files appear at once, and which fails quietly.

    Args:
        cache: JAX's own.
        folder: Its folder.
        make: Makes one of another folder.
        writes: Whether programs are written.
    """

    def __init__(
        self, cache: Any, folder: str, make: Callable[[str], Any], writes: bool = True
    ) -> None:
        self._path, self._cache, self._make, self._writes = Path(folder), cache, make, writes

    def get(self, key: str) -> bytes | None:
        """A program, if there is one that can be read."""
        try:
            return self._cache.get(key)
        except OSError:
            return None

    def put(self, key: str, value: bytes) -> None:
        """Keep a program, in place of any that was damaged; the first failure is the last try."""
        if not self._writes:
            return
        try:
            with tempfile.TemporaryDirectory(prefix=_WRITING, dir=self._path) as place:
                self._make(place).put(key, value)
                for file in Path(place).iterdir():
                    file.replace(self._path / file.name)
        except OSError as error:
            self._writes = False
            _say_not_kept(error)


def _remove_abandoned(folder: Path) -> None:
    """Remove what processes have left that were killed while they wrote."""
    for place in folder.glob(f"{_WRITING}*"):
        try:
            if time.time() - place.stat().st_mtime > _ABANDONED:
                for file in place.iterdir():
                    file.unlink()
                place.rmdir()
        except OSError:  # another process was quicker
            continue
