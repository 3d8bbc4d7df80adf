"""Programs on disk: whole or not there, whoever else writes; a folder that fails is said once."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from jax._src.lru_cache import LRUCache

from posegsa import compiled_programs
from posegsa.compiled_programs import WholeFiles
from posegsa.errors import PosegsaWarning

COMPILE = """
import sys, warnings
warnings.showwarning = lambda message, kind, *_: print(f"{kind.__name__}: {message}")
import posegsa
posegsa.enable_fast_path(devices=1)
import jax, jax.numpy as jnp
jax.monitoring.register_event_listener(
    lambda event, **_: print(event.rpartition("/")[2]) if "cache_" in event else None
)
print(float(jax.jit(lambda x: jnp.sin(x).sum() * 3)(jnp.arange(7.0))))
"""


def started(**environment: str) -> subprocess.Popen[str]:
    """A process that compiles, with what it says on standard output."""
    chosen = ("XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR", "XDG_CACHE_HOME")
    inherited = {k: v for k, v in os.environ.items() if k not in chosen}
    least = {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    return subprocess.Popen(
        [sys.executable, "-c", COMPILE],
        env=inherited | least | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def said(process: subprocess.Popen[str]) -> list[str]:
    out, _ = process.communicate(timeout=120)
    assert process.returncode == 0, out
    return out.splitlines()


def test_python_has_the_cache_that_the_command_line_has(tmp_path):
    both = [started(XDG_CACHE_HOME=str(tmp_path)) for _ in range(2)]
    first = [said(process) for process in both]
    assert any("cache_misses" in lines for lines in first)
    assert not [line for lines in first for line in lines if "Warning" in line], first
    programs = list((tmp_path / "posegsa").iterdir())
    assert programs
    assert all(path.is_file() for path in programs), "nothing is left half written"

    again = said(started(XDG_CACHE_HOME=str(tmp_path)))
    assert "cache_hits" in again
    assert "cache_misses" not in again
    assert again[-1] == first[0][-1]

    for path in programs:
        path.write_bytes(path.read_bytes()[:50])
    assert any("Error reading" in line for line in said(started(XDG_CACHE_HOME=str(tmp_path))))
    healed = said(started(XDG_CACHE_HOME=str(tmp_path)))
    assert "cache_hits" in healed
    assert not [line for line in healed if "Warning" in line], "damaged ones have been replaced"


@pytest.mark.parametrize("home", ["no home", "a file"])
def test_a_home_that_can_not_be_used_is_one_line(tmp_path, home):
    (tmp_path / "a file").touch()
    lines = said(started(XDG_CACHE_HOME=str(tmp_path / "a file" / home)))
    (note,) = [line for line in lines if "Warning" in line]
    assert note.startswith("PosegsaWarning: compiled programs can't be kept")
    assert "XDG_CACHE_HOME" in note


def test_the_command_line_says_one_line_of_a_home_that_can_not_be_used(tmp_path):
    (tmp_path / "home").touch()
    chosen = ("JAX_COMPILATION_CACHE_DIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR")
    inherited = {k: v for k, v in os.environ.items() if k not in chosen}
    code = "from posegsa.cli import main; main(['export', '.', '--format', 'c']); " + (
        "from matplotlib import get_cachedir; get_cachedir()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=inherited | {"HOME": str(tmp_path / "home")},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    note, refusal = done.stderr.splitlines()
    assert note.startswith("note: compiled programs can't be kept")
    assert "holds no finished run" in refusal


def test_none_is_kept_where_jax_is_told_so(tmp_path):
    environment = {"XDG_CACHE_HOME": str(tmp_path), "JAX_ENABLE_COMPILATION_CACHE": "false"}
    said(started(**environment))
    assert not any(tmp_path.iterdir())


@pytest.fixture
def cache(tmp_path) -> WholeFiles:
    folder = tmp_path / "programs"
    return WholeFiles(
        LRUCache(str(folder), max_size=-1), str(folder), lambda place: LRUCache(place, max_size=-1)
    )


def test_what_is_put_is_found_and_replaces_what_was_damaged(cache, tmp_path):
    assert cache.get("a") is None
    cache.put("a", b"half")
    cache.put("a", b"a whole program")
    assert cache.get("a") == b"a whole program"
    assert len(list((tmp_path / "programs").iterdir())) == 1


def test_a_folder_that_fails_is_said_once_and_read_on(cache, monkeypatch):
    cache.put("a", b"a whole program")
    full = OSError(28, "No space left on device")

    def fail(*_, **__):
        raise full

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.warns(PosegsaWarning, match="No space left on device"):
        cache.put("b", b"another")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cache.put("c", b"a third")
    assert cache.get("a") == b"a whole program"
    assert cache.get("b") is None


def test_what_can_not_be_read_is_compiled(cache, tmp_path):
    cache.put("a", b"a whole program")
    (path,) = (tmp_path / "programs").iterdir()
    path.unlink()
    path.mkdir()
    assert cache.get("a") is None


def test_a_folder_that_is_only_read_is_said_at_once(tmp_path, monkeypatch):
    def fail(**_):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("tempfile.TemporaryFile", fail)
    with pytest.warns(PosegsaWarning, match="Read-only file system"):
        assert not compiled_programs._can_write(tmp_path)


def test_what_a_killed_process_left_is_removed_after_a_day(tmp_path):
    old, new = tmp_path / ".writing-old", tmp_path / ".writing-new"
    for place in (old, new):
        place.mkdir()
        (place / "half").touch()
    os.utime(old, (0, 0))
    compiled_programs._remove_abandoned(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [".writing-new"]
