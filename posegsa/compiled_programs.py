"""JAX's persistent compilation cache, in a folder that belongs to the user alone.

What lies there is machine code, and JAX runs it: whoever can write to the folder can run code as
the user. So a folder of another user, or one that others can write to, is neither read nor written.
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
"""Time that a program must take to compile to be kept [s]. JAX's default is 1, but most here take
less, and together they are most of a short run."""
_LOCAL = "file://"
_BUCKET = re.compile("[a-z][a-z0-9+.-]*://")
"""How a place begins that JAX reads and writes itself, such as gs://bucket/folder."""


def enable_compilation_cache() -> None:
    """Keep compiled programs in the user's cache folder, and use those that are there.

    That is `posegsa` in XDG_CACHE_HOME, else in ~/.cache, unless JAX has been given a folder
    (JAX_COMPILATION_CACHE_DIR) or is to keep none (JAX_ENABLE_COMPILATION_CACHE=false). If the
    folder can't be made, belongs to another user, or others can write to it, a warning says so and
    JAX's cache is off in this process.
    """
    config: Any = jax.config  # whose options no stub lists
    if not config.jax_enable_compilation_cache:
        return
    given = config.jax_compilation_cache_dir
    least = min(LEAST_SECONDS, config.jax_persistent_cache_min_compile_time_secs)
    if not given or not _BUCKET.match(given.removeprefix(_LOCAL)):
        try:
            # Resolved once and for all: a link might lead elsewhere after the check.
            folder = (Path(given.removeprefix(_LOCAL)) if given else _own_folder()).resolve()
            _make_own(folder)
        except (OSError, RuntimeError) as error:
            config.update("jax_enable_compilation_cache", False)
            compilation_cache.reset_cache()  # JAX may be using the folder already
            _say_not_kept(error)
            return
        config.update("jax_compilation_cache_dir", str(folder))
        if not os.access(folder, os.W_OK):
            least = math.inf  # JAX would say so of each program
            _say_not_kept(f"{folder} can only be read")
    config.update("jax_persistent_cache_min_compile_time_secs", least)


def _own_folder() -> Path:
    """The user's folder; RuntimeError where the user has no home."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "posegsa"


def _make_own(folder: Path) -> None:
    """Make a folder that is this user's alone, or see that it is.

    From the root down, so that nothing is made in somebody else's folder. Whoever can write to a
    folder above could put another in its place.

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
        above: Whether it is a folder above the cache. Root may own it; with the sticky bit, as
            /tmp has, others may write to it, because they can't rename what is not theirs.
        shut: Whether only the user can open the folder that it lies in: its mode is no matter then.

    Raises:
        PermissionError: It is another's, or others can write to it.
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
