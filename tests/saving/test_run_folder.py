"""A run's folder changes atomically, has one writer at a time, and no links out of it."""

import errno
import fcntl
import os
import resource
from pathlib import Path

import pytest

from posegsa.errors import RunFolderError
from posegsa.saving import atomic_files
from posegsa.saving import folder as run_folder
from posegsa.saving.folder import (
    finish_commit,
    lock,
    locked_folder,
    prepare_folder,
    read_text,
    replace_files,
)

pytestmark = pytest.mark.quick

OLD = {"result.json": b"old", "figures/a.png": b"old", "figures/b.png": b"old"}
NEW = {"result.json": b"new", "figures/a.png": b"new", "history.csv": b"new"}


def content(folder: Path) -> dict[str, bytes]:
    """All files except the lock."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != ".lock"
    }


@pytest.fixture
def folder(tmp_path):
    replace_files(tmp_path, OLD, remove=())
    assert content(tmp_path) == OLD
    return tmp_path


def test_all_files_are_replaced_and_those_that_go_are_gone(folder):
    replace_files(folder, NEW, remove=["figures/a.png", "figures/b.png", "figures/c.png"])
    assert content(folder) == NEW


@pytest.mark.parametrize("written", [0, 1, 2])
def test_what_cannot_be_written_leaves_the_old_ones(folder, monkeypatch, written):
    room = iter(range(written))

    def full(path, data):
        if next(room, None) is None:
            raise OSError(28, "No space left on device")
        path.write_bytes(data)

    monkeypatch.setattr(run_folder, "write_synced", full)
    with pytest.raises(RunFolderError, match="cannot be written: No space left"):
        replace_files(folder, NEW, remove=["figures/b.png"])
    assert content(folder) == OLD


@pytest.mark.parametrize("when", ["staging", "moving"])
def test_ctrl_c_leaves_the_old_result_or_the_new(folder, monkeypatch, when):
    """A process dies before the commit, and after it with some files moved."""
    own, moved = Path.replace, []

    def interrupted(*_):
        raise KeyboardInterrupt

    def interrupted_later(self, target):
        if moved:
            raise KeyboardInterrupt
        moved.append(own(self, target))

    with monkeypatch.context() as patch:
        if when == "staging":
            patch.setattr(run_folder, "sync_folder", interrupted)
        else:
            patch.setattr(Path, "replace", interrupted_later)
        with pytest.raises(KeyboardInterrupt):
            replace_files(folder, NEW, remove=())
    kept = "old" if when == "staging" else "new"
    for name in ("result.json", "figures/a.png"):
        assert read_text(folder, name, of="run", limit=10) == kept
    with locked_folder(folder, overwrite=True):
        assert content(folder) == (OLD if when == "staging" else OLD | NEW)
    finish_commit(folder)


def test_a_second_writer_is_refused_until_the_first_is_done(tmp_path):
    with locked_folder(tmp_path):
        with (
            pytest.raises(RunFolderError, match=r"another run.*process \d+"),
            locked_folder(tmp_path),
        ):
            pytest.fail("two at once")
        with locked_folder(tmp_path / "other"):
            pass
    with locked_folder(tmp_path):
        pass


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def test_a_file_system_without_locks_is_still_written_to(tmp_path, monkeypatch, number):
    def no_locks(descriptor, how):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", no_locks)
    with locked_folder(tmp_path) as folder:
        replace_files(folder, NEW, remove=())
    assert content(tmp_path) == NEW


def test_a_run_that_appears_between_look_and_lock_is_seen(tmp_path, monkeypatch):
    looks = []

    def look_and_lose(folder, *, overwrite=False):
        looks.append(prepare_folder(folder, overwrite=overwrite))
        if len(looks) == 1:
            (tmp_path / "result.json").write_text("{}")
        return looks[-1]

    monkeypatch.setattr(run_folder, "prepare_folder", look_and_lose)
    with pytest.raises(RunFolderError, match="already"), locked_folder(tmp_path):
        pytest.fail("the other's run is lost")


@pytest.mark.parametrize("name", ["figures", "checkpoints", ".lock"])
def test_links_that_lead_out_of_it_are_refused(tmp_path, name):
    outside = tmp_path / "outside"
    outside.mkdir()
    run = tmp_path / "run"
    run.mkdir()
    (run / name).symlink_to(outside)
    with pytest.raises(RunFolderError, match=f"{name}: is a link"):
        prepare_folder(run)
    (run / "result.json").symlink_to(tmp_path / "elsewhere")
    (run / name).unlink()
    replace_files(run, NEW, remove=())
    assert not (tmp_path / "elsewhere").exists(), "a link is replaced, not followed"
    precious = tmp_path / "precious"
    precious.write_text("mine")
    (run / ".lock").symlink_to(precious)  # as if it appeared after the check
    with pytest.raises(RunFolderError, match="cannot be written"), lock(run):
        pytest.fail("a link was opened")
    (run / "comparison.json.part").symlink_to(precious)
    with pytest.raises(OSError, match="symbolic links"):
        atomic_files.write_atomically(run / "comparison.json", b"new")
    assert precious.read_text() == "mine"


def test_a_limit_of_the_system_leaves_the_old_file(tmp_path):
    """With a real limit of the system on the size of files."""
    path = tmp_path / "file"
    atomic_files.write_atomically(path, b"old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        with pytest.raises(OSError, match="too large"):
            atomic_files.write_atomically(path, bytes(1000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert content(tmp_path) == {"file": b"old"}


@pytest.mark.parametrize("value", ["", "no\0path", 5, None, b"bytes"])
def test_a_value_that_is_not_a_path_is_refused(value):
    with pytest.raises(RunFolderError, match=r"folder = .*path"):
        prepare_folder(value)
