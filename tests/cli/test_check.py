"""`posegsa check` as a user types it."""

from pathlib import Path

import pytest
from helpers.recordings import motion

from posegsa.cli.command import main
from posegsa.recordings.recording import Recording


def test_what_was_found_is_shown_whatever_else_can_not_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("posegsa.runtime.enable_fast_path", lambda: True)  # JAX has started
    first, bad, last = (str(tmp_path / name) for name in ("first.npz", "bad.csv", "last.npz"))
    for path in (first, last):
        Recording.from_arrays(**motion(name=Path(path).stem)).save(path)
    Path(bad).write_text("time,wx,wy,wz\n1,0,0,0\n0,0,0,0\n", "utf-8")
    assert main(["check", first, bad, last]) == 2
    said = capsys.readouterr()
    assert [said.out.count(f"{name}: 400 samples") for name in ("first", "last")] == [1, 1]
    assert said.err.startswith(f"posegsa: {bad}: time: ")
    assert main(["check", bad, "--out", str(tmp_path / "looked-at")]) == 2
    assert "Written" not in capsys.readouterr().out
    assert not (tmp_path / "looked-at").exists()
