"""JAX's persistent compilation cache, in a folder that only the user can write to.

JAX runs the machine code stored there, so anyone who can write to the folder can run code as the
user. A folder that belongs to another user, or that others can write to, is therefore not used.
"""

import math
import os
import re
import stat
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import jax
from jax.experimental.compilation_cache import compilation_cache

from posegsa.errors import PosegsaWarning

LEAST_SECONDS = 0.1
"""Programs that compile faster than this are not stored [s]. JAX's default is 1 s, but most of our
programs compile faster, and together they take most of a short run's time."""
_LOCAL = "file://"
_BUCKET = re.compile("[a-z][a-z0-9+.-]*://")
"""Start of a location that JAX reads and writes itself, such as gs://bucket/folder."""


def enable_compilation_cache() -> None:
    """Store compiled programs in the user's cache folder, and load those stored before.

    The folder is `posegsa` in XDG_CACHE_HOME, or in ~/.cache. JAX_COMPILATION_CACHE_DIR names
    another folder; JAX_ENABLE_COMPILATION_CACHE=false switches the cache off. If the folder can't
    be made, belongs to another user, or others can write to it, a warning says so and the cache
    stays off in this process.
    """
    config: Any = jax.config  # JAX's type stubs do not list its options
    if not config.jax_enable_compilation_cache:
        return
    given = config.jax_compilation_cache_dir
    least = min(LEAST_SECONDS, config.jax_persistent_cache_min_compile_time_secs)
    if not given or not _BUCKET.match(given.removeprefix(_LOCAL)):
        try:
            if given:
                folder = Path(given.removeprefix(_LOCAL))
            else:  # a user without a home is a RuntimeError
                caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
                folder = caches / "posegsa"
            folder = folder.resolve()  # links only once: one could be changed after the check
            _make_own(folder)
        except (OSError, RuntimeError) as error:
            config.update("jax_enable_compilation_cache", False)
            compilation_cache.reset_cache()  # JAX may be using the folder already
            _say_not_kept(error)
            return
        config.update("jax_compilation_cache_dir", str(folder))
        if not os.access(folder, os.W_OK):
            least = math.inf  # store nothing; otherwise JAX would warn for each program
            _say_not_kept(f"{folder} can only be read")
    config.update("jax_persistent_cache_min_compile_time_secs", least)


def _make_own(folder: Path) -> None:
    """Make a folder that only this user can write to, or check an existing one.

    Each parent is checked too, from the root down: anyone who can write to a parent could replace
    the folder.

    Args:
        folder: An absolute path without links.

    Raises:
        OSError: It can't be made, belongs to another user, or others can write to it.
    """
    for place in (*reversed(folder.parents), folder):
        place.mkdir(mode=0o700, exist_ok=True)
        if os.name == "posix":
            _check_own(place, above=place != folder)
    if os.name == "posix":
        shut = not folder.stat().st_mode & 0o077
        for program in folder.iterdir():
            with suppress(FileNotFoundError):  # another process has removed it
                _check_own(program, shut=shut)


def _check_own(place: Path, *, above: bool = False, shut: bool = False) -> None:
    """Refuse a file or folder that another user owns or can write to.

    Args:
        place: The file or folder.
        above: Whether it is a parent of the cache folder. Root may own a parent. Others may write
            to it if it has the sticky bit, as /tmp has: they can't rename files of other users.
        shut: Whether only the user can open its folder. Then its own mode does not matter.

    Raises:
        PermissionError: It belongs to another user, or others can write to it.
    """
    about = place.lstat()
    if about.st_uid != os.geteuid() and not (above and about.st_uid == 0):
        raise PermissionError(f"{place} belongs to another user")
    writers = about.st_mode & (stat.S_IWOTH | stat.S_IWGRP)
    if writers and not shut and not (above and about.st_mode & stat.S_ISVTX):
        raise PermissionError(f"others can write to {place}")


def _say_not_kept(why: object) -> None:
    warnings.warn(
        f"compiled programs can't be kept for the next start ({why}); "
        "JAX_COMPILATION_CACHE_DIR or XDG_CACHE_HOME names a folder of your own, "
        "JAX_ENABLE_COMPILATION_CACHE=false keeps none",
        PosegsaWarning,
        stacklevel=4,
    )
