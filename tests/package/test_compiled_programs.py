"""Compiled programs on disk: only in a folder of the user's own, and never an error."""

import hashlib
import os
import pickle
import subprocess
import sys
from pathlib import Path

import jax
import pytest
from jax.experimental.compilation_cache import compilation_cache

from posegsa.compiled_programs import enable_compilation_cache
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
from posegsa.search.keys import training_keys
training_keys(0, 1)
print(float(jax.jit(lambda x: jnp.sin(x).sum() * 3)(jnp.arange(7.0))))
"""


def said(**environment: str) -> list[str]:
    """The output lines of a process that compiles; the last one is its result."""
    chosen = ("XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR", "XDG_CACHE_HOME")
    inherited = {k: v for k, v in os.environ.items() if k not in chosen}
    least = {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    done = subprocess.run(
        [sys.executable, "-c", COMPILE],
        env=inherited | least | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout.splitlines()


def test_a_second_process_compiles_nothing(tmp_path):
    first = said(XDG_CACHE_HOME=str(tmp_path))
    assert "cache_misses" in first
    assert (tmp_path / "posegsa").stat().st_mode & 0o777 == 0o700

    again = said(XDG_CACHE_HOME=str(tmp_path))
    assert "cache_hits" in again
    assert "cache_misses" not in again
    assert again[-1] == first[-1]


def test_a_damaged_program_is_compiled_again(tmp_path):
    first = said(XDG_CACHE_HOME=str(tmp_path))
    for path in (tmp_path / "posegsa").iterdir():
        path.write_bytes(path.read_bytes()[:50])
    again = said(XDG_CACHE_HOME=str(tmp_path))
    assert any("Error reading" in line for line in again)
    assert again[-1] == first[-1]


@pytest.mark.parametrize("home", ["no home", "a file"])
def test_a_home_that_can_not_be_used_is_one_line(tmp_path, home):
    (tmp_path / "a file").touch()
    lines = said(XDG_CACHE_HOME=str(tmp_path / "a file" / home))
    (note,) = [line for line in lines if "Warning" in line]
    assert note.startswith("PosegsaWarning: compiled programs can't be kept")
    assert "XDG_CACHE_HOME" in note


def test_the_command_line_prints_one_line_about_an_unusable_home(tmp_path):
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


def test_none_is_kept_if_jax_is_configured_so(tmp_path):
    environment = {"XDG_CACHE_HOME": str(tmp_path), "JAX_ENABLE_COMPILATION_CACHE": "false"}
    said(**environment)
    assert not any(tmp_path.iterdir())


class Planted:
    """Creates a folder when it is unpickled."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self):
        return os.mkdir, (str(self.marker),)


def test_what_is_planted_where_others_can_write_is_not_run(tmp_path):
    folder, marker = tmp_path / "programs", tmp_path / "planted code ran"
    folder.mkdir(mode=0o700)
    environment = {"JAX_COMPILATION_CACHE_DIR": str(folder)}
    first = said(**environment)
    planted = pickle.dumps(Planted(marker))
    for path in folder.iterdir():
        path.write_bytes(hashlib.sha256(planted).digest() + planted)
    folder.chmod(0o777)
    before = sorted(folder.iterdir())

    again = said(**environment)
    assert not marker.exists()
    assert len(again) == 2, "one line says so, and nothing is read or written"
    assert again[0].startswith("PosegsaWarning: compiled programs can't be kept")
    assert f"others can write to {folder}" in again[0]
    assert again[-1] == first[-1]
    assert sorted(folder.iterdir()) == before


@pytest.fixture
def cache(tmp_path):
    """A folder that was set as JAX's cache."""
    names = "enable_compilation_cache", "compilation_cache_dir"
    names += ("persistent_cache_min_compile_time_secs",)
    before = {name: getattr(jax.config, f"jax_{name}") for name in names}
    folder = tmp_path / "above" / "programs"
    folder.mkdir(parents=True)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    compilation_cache.reset_cache()
    yield folder
    for name, value in before.items():
        jax.config.update(f"jax_{name}", value)
    compilation_cache.reset_cache()


def is_on() -> bool:
    return getattr(jax.config, "jax_enable_compilation_cache")  # noqa: B009  missing in the stubs


def check_refused(reason: str) -> None:
    with pytest.warns(PosegsaWarning, match=reason):
        enable_compilation_cache()
    assert not is_on()


def test_a_folder_of_the_user_alone_is_used(cache):
    (cache / "program").touch()
    enable_compilation_cache()
    assert is_on()


@pytest.mark.parametrize("mode", [0o777, 0o757, 0o1777], ids=oct)
def test_a_folder_that_others_can_write_to_is_refused(cache, mode):
    cache.chmod(mode)
    check_refused(f"others can write to {cache}")


def test_a_folder_above_that_others_can_write_to_is_refused(cache):
    cache.parent.chmod(0o777)
    check_refused(f"others can write to {cache.parent}")


def test_a_folder_above_where_nobody_can_rename_what_is_anothers_is_used(cache):
    cache.parent.chmod(0o1777)
    enable_compilation_cache()
    assert is_on()


def test_a_link_is_judged_by_where_it_leads(cache):
    cache.chmod(0o777)
    link = cache.parent.parent / "link"
    link.symlink_to(cache)
    jax.config.update("jax_compilation_cache_dir", str(link))
    check_refused(f"others can write to {cache}")


def test_the_name_of_a_file_system_hides_nothing(cache):
    cache.chmod(0o777)
    jax.config.update("jax_compilation_cache_dir", f"file://{cache}")
    check_refused(f"others can write to {cache}")


def test_a_program_that_others_can_write_to_is_refused(cache):
    (cache / "program").touch()
    (cache / "program").chmod(0o666)
    check_refused(f"others can write to {cache / 'program'}")


def test_in_a_folder_that_others_can_not_open_the_modes_of_programs_do_not_matter(cache):
    (cache / "program").touch()
    (cache / "program").chmod(0o666)
    cache.chmod(0o700)
    enable_compilation_cache()
    assert is_on()


def test_a_folder_that_a_group_can_write_to_is_refused(cache):
    """Whatever its members: users whose primary group it is are not listed in it."""
    cache.chmod(0o770)
    check_refused(f"others can write to {cache}")


def give_away(folder: Path, monkeypatch) -> None:
    """As root, change the folder's owner; otherwise pretend to be another user."""
    if os.geteuid() == 0:
        os.chown(folder, 54321, -1)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 54321)


def test_a_folder_of_another_user_is_refused(cache, monkeypatch):
    give_away(cache, monkeypatch)
    check_refused("belongs to another user")


def test_nothing_is_made_in_a_folder_of_another_user(cache, monkeypatch):
    jax.config.update("jax_compilation_cache_dir", str(cache / "new"))
    give_away(cache, monkeypatch)
    check_refused("belongs to another user")
    assert not (cache / "new").exists()


def test_a_program_of_another_user_is_refused(cache, monkeypatch):
    (cache / "program").touch()
    give_away(cache / "program", monkeypatch)
    check_refused("belongs to another user")


def test_programs_of_a_folder_that_can_only_be_read_are_used(cache, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.warns(PosegsaWarning, match=f"{cache} can only be read"):
        enable_compilation_cache()
    jax.jit(lambda x: x + 1)(1)
    assert is_on()
    assert list(cache.iterdir()) == []


RUN = """
import sys
import numpy as np
import posegsa
posegsa.enable_fast_path(devices=1)
from posegsa.filters import observer
if sys.argv[1:]:
    observer.REFERENCE_GAIN = float(sys.argv[1])
measurements = posegsa.Measurements.from_arrays(
    time_step=np.full(20, 0.01),
    angular_velocity=np.ones((20, 3)),
    velocity=np.ones((20, 3)),
    vectors=np.tile(np.eye(3)[:2], (20, 1, 1)),
    vector_references=np.eye(3)[:2],
    landmarks=np.ones((20, 1, 3)),
    landmark_references=np.ones((1, 3)),
)
estimates = posegsa.run_filter(
    posegsa.Observer(posegsa.ConstantGain(5.0)),
    measurements,
    posegsa.initial_state(np.eye(3), np.zeros(3)),
)
print(estimates.bias[-1])
"""


def test_a_changed_constant_changes_what_is_computed(tmp_path):
    cache = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path)}

    def bias(*gain: str) -> str:
        return subprocess.run(
            [sys.executable, "-c", RUN, *gain],
            env=os.environ | cache,
            capture_output=True,
            text=True,
            check=True,
            timeout=120,
        ).stdout

    assert bias() != bias("2.0")
