"""Functions that are neither traced nor compiled again where another process has done both.

JAX's cache of compiled programs (`compiled_programs`) saves XLA's time alone: a process still
traces each function and lowers it, only to learn which program it wants, and for the short runs
here that takes longer than to load and run it. A `stored` function asks for its program by what
tracing depends on: posegsa's source, the versions of the libraries, the machine, the options, and
what is known of its arguments without their numbers.

Programs are pickled, and are machine code besides: like JAX's own cache, the folder must be the
user's alone.

A program is found again only if all of that can be said in words (`_words`). A function of a user's
own, for one, may change while its name does not: what depends on one is compiled as by `jax.jit`.
So is everything from when a file of posegsa has changed under a process. What can't be seen is a
function of posegsa's that a program has replaced by its own: that needs
`JAX_ENABLE_COMPILATION_CACHE=false`.
"""

import hashlib
import importlib.metadata
import os
import pickle
import platform
import sys
import tempfile
import threading
import time
import types
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache, partial, update_wrapper
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast, overload

import jax
import numpy as np
from jax.core import Tracer
from jax.experimental import serialize_executable
from jax.experimental.compilation_cache import compilation_cache
from jax.sharding import Mesh

from posegsa.version import VERSION

P = ParamSpec("P")
R = TypeVar("R")

_FOLDER: list[Path] = []
"""Where programs are stored; nothing where they are not."""
_FLAGS: list[str] = []
"""XLA's options when storing began, which is before XLA reads them."""
_FORGOTTEN, _ABANDONED = 30 * 24 * 3600.0, 24 * 3600.0
"""Times after which a program that no process has used, and one half written, is removed [s]."""
_SUFFIX, _WRITING = ".program", ".writing-program-"
_PACKAGE = Path(__file__).parent
_CONFIG: Any = jax.config  # whose options no stub lists
_PLAIN = (bool, int, float, str, bytes, type(None))


def store_in(folder: Path | None) -> None:
    """Store programs in a folder that is there from now on, or none any more."""
    _FOLDER[:] = [] if folder is None else [folder]
    _FLAGS[:] = [os.environ.get("XLA_FLAGS", "")]
    if folder is not None:
        _forget_old(folder)


@overload
def stored(function: Callable[P, R], *, static_argnums: Sequence[int] = ()) -> Callable[P, R]: ...


@overload
def stored(
    function: None = None, *, static_argnums: Sequence[int]
) -> Callable[[Callable[P, R]], Callable[P, R]]: ...


def stored(
    function: Callable[..., Any] | None = None, *, static_argnums: Sequence[int] = ()
) -> Callable[..., Any]:
    """Decorator: as `jax.jit`, but its programs are stored if there is a folder for them.

    Args:
        function: Pure and jittable; of posegsa's own.
        static_argnums: Arguments that are structure, as of `jax.jit`.
    """
    if function is None:
        return partial(stored, static_argnums=static_argnums)
    return StoredFunction(function, tuple(static_argnums))


class StoredFunction:
    """A function and its programs: those of this process, and those on disk."""

    def __init__(self, function: Callable[..., Any], static_argnums: tuple[int, ...]) -> None:
        self._function = function
        self._jitted = jax.jit(function, static_argnums=static_argnums, inline=True)
        self._static = static_argnums
        self._programs: dict[Any, Callable[..., Any]] = {}
        update_wrapper(self, function)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """The function's value, by a stored program where there is one."""
        if kwargs or not _FOLDER or not _stores():
            return self._jitted(*args, **kwargs)
        static = tuple(args[i] for i in self._static if i < len(args))
        traced = tuple(a for i, a in enumerate(args) if i not in self._static)
        leaves, tree = jax.tree.flatten(traced)
        if any(isinstance(leaf, Tracer) for leaf in leaves):
            return self._jitted(*args)  # part of a larger program
        key = (static, tree, tuple(map(_kind, leaves)), _traced_under())
        program = self._programs.get(key)
        if program is None:
            return self._first(args, static, traced, key)
        return program(*args) if program is self._jitted else program(*traced)

    def _first(
        self, args: tuple[Any, ...], static: tuple[Any, ...], traced: tuple[Any, ...], key: Any
    ) -> Any:
        """The value by a program that this process has not run yet.

        One that XLA can't run after all, as it says only then, is forgotten.
        """
        program, path = self._program(args, static, traced, key)
        self._programs[key] = program
        if program is self._jitted:
            return program(*args)
        try:
            return jax.block_until_ready(program(*traced))
        except jax.errors.JaxRuntimeError:
            with suppress(OSError):
                path.unlink()
            self._programs[key] = self._jitted
            return self._jitted(*args)

    def __reduce__(self) -> str:
        """Pickled by its name, as a function is."""
        return self._function.__qualname__

    def _program(
        self, args: tuple[Any, ...], static: tuple[Any, ...], traced: tuple[Any, ...], key: Any
    ) -> tuple[Callable[..., Any], Path]:
        """The program of these arguments, from disk or compiled and stored, else JAX's own way."""
        _, tree, kinds, options = key
        try:
            what = (self._function, static, tree, kinds, options)
            words = "\n".join((_here(), _words(what)))
        except _CannotSay:
            return self._jitted, Path()
        if _files() != _SOURCE:
            return self._jitted, Path()  # what this process runs is no longer what stands there
        path = _FOLDER[0] / (hashlib.sha256(words.encode()).hexdigest() + _SUFFIX)
        found = _load(path, tree, _devices(jax.tree.leaves(traced)))
        if found is None:
            found = _compiled(self._jitted.lower(*args))
            _save(path, found)
        return found, path


class _CannotSay(Exception):
    """What a program depends on has no words that tell it from all else."""


def _words(value: Any) -> str:
    """What a program depends on, in words: the same in each process, and for nothing else."""
    if isinstance(value, _PLAIN) or value is type(None):
        return repr(value)
    if isinstance(value, Enum | np.dtype):
        return f"{type(value).__qualname__}({value})"
    if isinstance(value, type | types.FunctionType | types.BuiltinFunctionType):
        return _name(value)
    if isinstance(value, jax.tree_util.PyTreeDef):
        return f"[{_words(value.node_data())} {' '.join(map(_words, value.children()))}]"
    if isinstance(value, partial):
        return f"partial{_words((value.func, value.args, value.keywords))}"
    if isinstance(value, Mesh):
        devices = [(device.platform, device.id) for device in value.devices.flat]
        return f"Mesh{_words((value.axis_names, value.devices.shape, devices))}"
    if isinstance(value, jax.sharding.PartitionSpec | jax.sharding.SingleDeviceSharding):
        return repr(value)
    if isinstance(value, jax.sharding.NamedSharding):
        return f"NamedSharding{_words((value.mesh, value.spec))}"
    if isinstance(value, dict):
        return f"{{{' '.join(_words(item) for item in value.items())}}}"
    if isinstance(value, tuple | list):
        return f"{_type(value)}({' '.join(map(_words, value))})"
    if is_dataclass(value):
        return f"{_type(value)}{_words({f.name: getattr(value, f.name) for f in fields(value)})}"
    if hasattr(type(value), "model_fields"):  # pydantic's
        names = type(value).model_fields
        return f"{_type(value)}{_words({name: getattr(value, name) for name in names})}"
    raise _CannotSay


def _name(value: Any) -> str:
    """The name of a class or function of a library's, by which it is found."""
    module, name = value.__module__ or "", value.__qualname__
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    if isinstance(found, StoredFunction):
        found = found._function
    libraries = ("posegsa", "jax", "jaxlib", "numpy", "builtins")
    if found is not value or module.partition(".")[0] not in libraries:
        raise _CannotSay
    return f"{module}.{name}"


def _type(value: Any) -> str:
    return _words(type(value)) if type(value) not in (tuple, list) else type(value).__name__


def _kind(leaf: Any) -> Any:
    """What a program depends on of a leaf: all but its numbers."""
    if isinstance(leaf, jax.Array):
        placed = leaf.sharding if leaf.committed else None
        return leaf.shape, str(leaf.dtype), getattr(leaf, "weak_type", False), placed
    if isinstance(leaf, np.ndarray | np.generic):
        return leaf.shape, str(leaf.dtype), False, None
    return type(leaf)


def _stores() -> bool:
    """Whether programs are stored as things stand, in this process and with JAX's options."""
    plain = not (_CONFIG.jax_disable_jit or _CONFIG.jax_debug_nans or _CONFIG.jax_debug_infs)
    return plain and _CONFIG.jax_default_device is None and jax.process_count() == 1


def _traced_under() -> tuple[Any, ...]:
    """JAX's options, but for those of its cache; on most no program here depends."""
    return tuple(
        str(getattr(_CONFIG, name, None)) for name in sorted(_CONFIG.values) if "cache" not in name
    )


@cache
def _here() -> str:
    """All that is the same for every program of this process, in words."""
    if [os.environ.get("XLA_FLAGS", "")] != _FLAGS:
        raise _CannotSay  # XLA may have read others
    device = jax.devices()[0]
    return _words(
        (
            VERSION,
            _DIGEST,
            {name: _version(name) for name in ("jax", "jaxlib", "numpy", "optax", "evosax")},
            _FLAGS[0],
            (device.platform, device.device_kind, len(jax.devices())),
            device.client.platform_version,
            (platform.machine(), _instructions()),
        )
    )


def _version(library: str) -> str:
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def _files() -> list[tuple[str, int, int]]:
    """The files of posegsa's own code, with their size and when they were changed."""
    found = ((str(path), path.stat()) for path in sorted(_PACKAGE.rglob("*.py")))
    return [(path, stat.st_size, stat.st_mtime_ns) for path, stat in found]


def _digest() -> str:
    """A digest of what stands in them."""
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(str(path.relative_to(_PACKAGE)).encode() + b"\0")
        digest.update(path.read_bytes() + b"\0")
    return digest.hexdigest()


_SOURCE, _DIGEST = _files(), _digest()
"""As this process has imported them."""


def _instructions() -> str:
    """What this CPU can do; a program may use all of it."""
    with suppress(OSError):
        text = Path("/proc/cpuinfo").read_text("utf-8")
        lines = {line for line in text.splitlines() if line.startswith(("flags", "Features"))}
        return " ".join(sorted(lines))
    return platform.processor()


def _compiled(lowered: Any) -> Callable[..., Any]:
    """A program, compiled without a look at JAX's cache: one that was found there can't be stored.

    Nor does JAX keep it: one copy on disk is enough.
    """
    with _COMPILING:
        enabled = _CONFIG.jax_enable_compilation_cache
        _CONFIG.update("jax_enable_compilation_cache", False)
        compilation_cache.reset_cache()  # JAX asks once whether it is enabled
        try:
            return lowered.compile()
        finally:
            _CONFIG.update("jax_enable_compilation_cache", enabled)
            compilation_cache.reset_cache()


_COMPILING = threading.Lock()
"""JAX's option is the process's, not a thread's."""


def _devices(leaves: Sequence[Any]) -> list[Any]:
    """The devices that a program of these arguments runs on, in order."""
    placed = [leaf.sharding for leaf in leaves if isinstance(leaf, jax.Array) and leaf.committed]
    for sharding in placed:
        if isinstance(sharding, jax.sharding.NamedSharding):
            return list(cast(Mesh, sharding.mesh).devices.flat)
    return list(placed[0].device_set) if placed else jax.devices()[:1]


def _load(path: Path, tree: Any, devices: Sequence[Any]) -> Callable[..., Any] | None:
    """A stored program for arguments of this structure; None if there is none that can be used."""
    try:
        content = path.read_bytes()
        checked, blob = content[:_CHECKSUM], content[_CHECKSUM:]
        if hashlib.sha256(blob).digest() != checked:
            return None
        payload, skeleton = pickle.loads(blob)
        structure = jax.tree.structure((tree.unflatten(range(tree.num_leaves)), {}))
        found = serialize_executable.deserialize_and_load(
            payload, structure, jax.tree.structure(skeleton), execution_devices=devices
        )
    except Exception:  # not there, or of a library that has changed: it is compiled anew
        return None
    with suppress(OSError):
        os.utime(path)
    return found


def _save(path: Path, program: Any) -> None:
    """Store a program, if it can be: whole, by a rename, so that processes can share the folder."""
    try:
        payload, _, structure = serialize_executable.serialize(program)
        skeleton = structure.unflatten(range(structure.num_leaves))
        blob = pickle.dumps((payload, skeleton))
    except Exception:  # JAX can't, such as a program with constants; it serves this process
        return
    written: list[Path] = []
    try:
        with tempfile.NamedTemporaryFile(prefix=_WRITING, dir=path.parent, delete=False) as file:
            written.append(Path(file.name))
            file.write(hashlib.sha256(blob).digest() + blob)
        written[0].replace(path)
    except OSError:
        for half in written:
            half.unlink(missing_ok=True)


_CHECKSUM = hashlib.sha256().digest_size


def _forget_old(folder: Path) -> None:
    """Remove programs that no process has used for long: each change of the code leaves some."""
    for pattern, age in ((f"*{_SUFFIX}", _FORGOTTEN), (f"{_WRITING}*", _ABANDONED)):
        for path in folder.glob(pattern):
            with suppress(OSError):
                if time.time() - path.stat().st_mtime > age:
                    path.unlink()
