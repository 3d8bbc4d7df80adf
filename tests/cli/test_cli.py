"""The command line as a user types it: exit status and printed text.

Tests of signals, of the exit and of the installed command start a separate process.
"""

import io
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
import tomllib
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import jax
import numpy as np
import pytest
from helpers.experiments import TINY
from helpers.recordings import motion

import posegsa
from posegsa import config
from posegsa.cli.command import main, parser
from posegsa.cli.tune import _how_to_compare, _tell_noises
from posegsa.export import FORMATS
from posegsa.figures import style as figure_style
from posegsa.optimisers import OPTIMISERS
from posegsa.optimisers.functions import FUNCTIONS

SETTINGS = ["observer", *(word for setting in TINY for word in ("--set", setting))]


class Done(NamedTuple):
    """A command that has been run."""

    status: int
    out: str
    err: str


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> tuple[Path, Done]:
    """`posegsa tune` without CONFIG in an empty folder."""
    folder, out, err = tmp_path_factory.mktemp("anywhere"), io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.chdir(folder)
        patch.setattr("posegsa.runtime.enable_fast_path", lambda: True)  # JAX has already started
        patch.setattr(figure_style, "DPI", 15)
        status = main(["tune", "--seed", "3", *SETTINGS])
    return folder, Done(status, out.getvalue(), err.getvalue())


def test_tune_runs_from_any_folder(finished):
    folder, done = finished
    assert done.status == 0, done.err
    assert "held out" in done.out
    assert "Written to posegsa-run" in done.out
    data = json.loads((folder / "posegsa-run" / "result.json").read_text())
    assert data["experiment"]["run"]["seed"] == 3
    assert data["experiment"]["search"]["agents"] == 6


def test_a_process_of_its_own_finds_the_same(finished, tmp_path):
    command = [sys.executable, "-m", "posegsa", "tune", "--seed", "3", *SETTINGS]
    done = subprocess.run(
        [*command, "--no-figures", "--quiet"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    first, second = (
        json.loads((folder / "posegsa-run" / "result.json").read_text())
        for folder in (finished[0], tmp_path)
    )
    assert first["filter"] == second["filter"]
    assert first["on_scenarios"] == second["on_scenarios"]
    assert first["search"]["history"] == second["search"]["history"]


def test_it_shows_progress_and_notes_in_plain_words(finished):
    _, done = finished
    for step in ("preparing", "compiling", "searching 4/4", "judging", "drawing"):
        assert f"\n{step}: done after" in done.err
    assert "best cost" in done.err
    assert "initial_rotation" not in done.err, "only one that is not quite a rotation gets a note"
    assert "Traceback" not in done.err
    assert "Warning" not in done.err


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_a_second_run_does_not_replace_the_first(finished, monkeypatch, capsys):
    folder, _ = finished
    before = (folder / "posegsa-run" / "result.json").read_bytes()
    monkeypatch.chdir(folder)
    assert main(["tune", *SETTINGS]) == 2
    said = capsys.readouterr().err
    assert "holds a run already" in said
    assert said.startswith("posegsa: "), "a refused command shows no progress"
    assert "--overwrite" in said
    assert (folder / "posegsa-run" / "result.json").read_bytes() == before


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_a_finished_run_says_that_it_is_finished(finished, monkeypatch, capsys):
    folder, _ = finished
    monkeypatch.chdir(folder)
    assert main(["tune", "--resume", "posegsa-run"]) == 0
    said = capsys.readouterr()
    assert "posegsa-run is finished already" in said.out
    assert "Written" not in said.out
    assert "held out" in said.out
    assert "searching" not in said.err


@pytest.mark.quick
@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["tune", "missing.toml"], ["missing.toml", "No such file"]),
        (["tune", "observer", "--set", "filter.substep=4"], ["filter.substep", "substeps"]),
        (["tune", "--set", "run.dtype=float16"], ["run.dtype", "float16", "float32", "float64"]),
        (["tune", "--set", "scenario.velocity_noise=-0.1"], ["scenario.velocity_noise", "-0.1"]),
        (["tune", "--seed", "-1"], ["run.seed", "-1"]),
        (["tune", "--set", "filter.kind=own"], ["filter: none", "--filter module:Class"]),
        (
            ["tune", "kalman", "--set", "parameters.also=[]"],
            ["parameters.also: none", "at least one number", "kalman"],
        ),
    ],
)
def test_bad_input_is_one_readable_message(tmp_path, monkeypatch, capsys, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    said = capsys.readouterr().err
    for word in words:
        assert word in said
    assert said.startswith("posegsa: ")
    assert not any(tmp_path.iterdir()), "a refused command leaves nothing behind"


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_sigterm_saves_and_says_how_to_resume(tmp_path, monkeypatch, capsys):
    """SIGTERM, as sent by a cluster; for Ctrl-C see `test_tuning` and `test_interrupt`."""
    long = ["--set", "search.iterations=100000", "--set", "checkpoint.iterations=1"]
    process = subprocess.Popen(
        [sys.executable, "-m", "posegsa", "tune", "--out", "run", "--quiet", *SETTINGS, *long],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
    )
    checkpoints = tmp_path / "run" / "checkpoints"
    while len(list(checkpoints.glob("*.checkpoint"))) < 2 and process.poll() is None:
        time.sleep(0.01)
    process.terminate()
    _, said = process.communicate(timeout=120)
    assert process.returncode == 128 + signal.SIGTERM, said
    kept = max(int(path.stem) for path in checkpoints.glob("*.checkpoint"))
    # On a busy machine the last chunk may take longer than the process waits for it.
    match = re.search(
        r"interrupted after iteration (\d+) of 100000(?: \(saved: (\d+)\))?, best", said
    )
    assert match is not None, said
    assert int(match[2] or match[1]) == kept
    assert "resume with: posegsa tune --resume run" in said
    assert "Traceback" not in said
    monkeypatch.chdir(tmp_path)
    assert main(["tune", "--resume", "run", "--seed", "5"]) == 2
    assert "run.seed = 5" in capsys.readouterr().err


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_of_joined_processes_only_the_first_writes_and_prints(tmp_path, monkeypatch, capsys):
    joined = {}
    monkeypatch.setattr(
        "posegsa.search.devices.join_processes", lambda **given: joined.update(given)
    )
    monkeypatch.setattr(jax, "process_index", lambda: 1)
    monkeypatch.setattr("posegsa.runtime.enable_fast_path", lambda: True)
    command = ["tune", "--out", str(tmp_path / "run"), "--quiet", "--distributed", "--process", "1"]
    command += ["--coordinator", "127.0.0.1:9", "--processes", "2"]
    command += SETTINGS
    assert main(command) == 0
    assert joined == {"coordinator": "127.0.0.1:9", "processes": 2, "process": 1}
    assert not (tmp_path / "run").exists()
    assert capsys.readouterr().out == ""


def test_addresses_without_distributed_are_refused(capsys, monkeypatch):
    monkeypatch.setattr("posegsa.runtime.enable_fast_path", lambda: True)
    assert main(["tune", "--processes", "2"]) == 2
    assert "--processes = 2; allowed: with --distributed" in capsys.readouterr().err


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_evaluate_judges_the_run_that_it_writes_to(tmp_path, monkeypatch):
    """Another process may replace the run until the folder is locked."""
    events = []

    class Judged:
        on_scenarios = SimpleNamespace(
            evaluation=SimpleNamespace(table=str, verdict=str, own="tuned filter"),
            long_after=lambda _: "",
            beside="another",
        )
        experiment = config.Experiment()
        warnings = list

    @contextmanager
    def locked_folder(folder, *, overwrite):
        events.append("locked")
        yield folder

    def load(folder, **_):
        events.append("loaded")
        return len(events)

    def evaluate(result, **_):
        assert result == events.index("locked") + 2, "judged a result loaded before the lock"
        return Judged()

    monkeypatch.setattr("posegsa.saving.folder.locked_folder", locked_folder)
    monkeypatch.setattr("posegsa.saving.result_files.load", load)
    write = "posegsa.saving.result_files.write_result"
    monkeypatch.setattr(write, lambda *_, **__: events.append("written"))
    monkeypatch.setattr("posegsa.saving.result_files.written", lambda *_: [])
    monkeypatch.setattr("posegsa.evaluating.evaluate", evaluate)
    assert main(["evaluate", str(tmp_path)]) == 0
    assert events == ["loaded", "locked", "loaded", "written"]


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_a_changed_result_is_read_only_on_demand(finished, tmp_path, capsys):
    text = (finished[0] / "posegsa-run" / "result.json").read_text("utf-8")
    changed = re.sub(r'("seed": )3\b', r"\g<1>4", text, count=1)
    assert changed != text
    (tmp_path / "result.json").write_text(changed, "utf-8")
    assert main(["export", str(tmp_path), "--format", "json"]) == 2
    assert "was changed after posegsa wrote it" in capsys.readouterr().err
    assert main(["export", str(tmp_path), "--format", "json", "--edited"]) == 0
    assert json.loads(capsys.readouterr().out)
    assert main(["export", str(tmp_path), "--format", "json", "--set", "filter.gamma=1"]) == 2
    assert "--set; allowed: with a configuration" in capsys.readouterr().err


def test_noises_of_single_sensors_are_printed_one_by_one(capsys: pytest.CaptureFixture[str]):
    scales = {"filter.vector": 0.04, "filter.vector_scales": (0.556, 1.44)}
    _tell_noises(config.load("kalman").replace(**scales))
    assert "vector 0.04, vector_scales 0.556 1.44" in capsys.readouterr().out


def test_a_configuration_means_its_own_filter(monkeypatch, capsys):
    monkeypatch.setattr("posegsa.runtime.enable_fast_path", lambda: True)
    assert main(["export", "quick", "--format", "json"]) == 0
    found = json.loads(capsys.readouterr().out)["numbers"]
    assert [k for (k,) in found.values()] == pytest.approx(config.load("quick").tuned.numbers)
    assert main(["export", "quick", "--format", "json", "--edited"]) == 2
    assert "--edited; allowed: with the folder of a run, not quick" in capsys.readouterr().err
    found = []
    for more in ([], ["--set", "filter.magnetometer_delay=0"]):
        assert main(["export", "imu", "--format", "c", *more]) == 0
        found.append(capsys.readouterr().out)
    assert found[0] != found[1]
    assert main(["export", "imu", "--format", "c", "--set", "filter.delay=0"]) == 2
    assert "filter.delay" in capsys.readouterr().err


def numbers_of(header: str) -> list[str]:
    """The constants of an exported filter."""
    return [line for line in header.splitlines() if line.startswith("static const")]


def test_a_configuration_or_a_run_knows_the_sensors_of_a_recording(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("posegsa.runtime.enable_fast_path", lambda: True)
    given = motion()
    columns = [np.arange(400) / 100, given["angular_velocity"], given["velocity"]]
    path = tmp_path / "flight.csv"  # without a truth
    head = "time,wx,wy,wz,vx,vy,vz,v0_x,v0_y,v0_z"
    rows = np.column_stack([*columns, given["vectors"][:, 0]])
    np.savetxt(path, rows, delimiter=",", header=head, comments="")
    path.with_name("flight.csv.toml").write_text("vector_references = [[0, 0.6, 0.8]]")
    assert main(["export", "kalman", "--format", "c", "--recording", str(path)]) == 0
    own = capsys.readouterr()
    assert "{0, POSEGSA_C(0.6), POSEGSA_C(0.8)}" in own.out
    assert "those of recordings" in own.out
    posegsa.save(posegsa.configured("kalman"), tmp_path / "run", figures=[])
    of_run = ["export", str(tmp_path / "run"), "--format", "c"]
    assert main([*of_run, "--recording", str(path)]) == 0
    assert numbers_of(capsys.readouterr().out) == numbers_of(own.out)
    assert main(of_run) == 0
    printed = capsys.readouterr()
    assert "[scenario]" in printed.out
    assert "2 vectors and 1 landmark of the configuration's [scenario]" in printed.err
    assert "--recording FILE" in printed.err


@pytest.mark.parametrize(
    ("named", "said"),
    [
        ("mine", "--filter mine; allowed: MODULE:CLASS"),
        ("mine:", "--filter mine:; allowed: MODULE:CLASS"),
        ("posegsa_has_none_such:Mine", "No module named 'posegsa_has_none_such'"),
        ("mine_of_a_test:Yours", "has no attribute 'Yours'"),
        ("mine_of_a_test:Mine", "filter, with filter.kind = 'observer'"),
    ],
)
def test_a_filter_of_the_users_own_is_named_by_module_and_class(
    named, said, tmp_path, monkeypatch, capsys
):
    (tmp_path / "mine_of_a_test.py").write_text("class Mine:\n    pass\n", "utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("posegsa.runtime.enable_fast_path", lambda: True)
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    monkeypatch.delitem(sys.modules, "mine_of_a_test", raising=False)
    assert main(["tune", *SETTINGS, "--filter", named]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "posegsa-run").exists()


def test_the_command_that_compares_a_run_on_recordings_has_all_that_it_needs():
    given = ["--filter", "my own:Mine", "--recording", "a 1.csv", "--window", ":40", "--bridge"]
    given += ["hold", "--held-out", "b.csv", "--held-out-window", "40:"]
    tuned = parser().parse_args(["tune", *given])
    *_, line = _how_to_compare(tuned, "a run", "observer").splitlines()
    words = shlex.split(line)
    assert words[0] == "posegsa"
    found = parser().parse_args(words[1:])
    assert (found.run, found.filter, found.bridge) == ("a run", "my own:Mine", "hold")
    assert (found.recording, found.window) == (["b.csv"], tuned.held_out_window)
    assert (found.training, found.training_window) == (["a 1.csv"], tuned.window)


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_export_writes_each_format(finished, tmp_path, capsys):
    run = str(finished[0] / "posegsa-run")
    assert main(["export", run, "--format", "json"]) == 0
    json.loads(capsys.readouterr().out)
    for form in FORMATS:
        path = tmp_path / f"gain.{form}"
        assert main(["export", run, "--format", form, "--out", str(path)]) == 0
        assert path.stat().st_size > 1000
    written = path.read_text("utf-8")
    path.write_text("mine", "utf-8")
    again = ["export", run, "--format", form, "--out", str(path)]
    assert main(again) == 2
    assert "exists already; --overwrite replaces it" in capsys.readouterr().err
    assert path.read_text("utf-8") == "mine"
    assert main([*again, "--overwrite"]) == 0
    assert path.read_text("utf-8") == written
    assert main(["export", run, "--format", "c", "--out", str(tmp_path / "no" / "such")]) == 2
    assert "cannot be written" in capsys.readouterr().err
    header = tmp_path / "front.h"
    assert main(["export", run, "--format", "c", "--out", str(header)]) == 0
    assert '#include "front.h"' in header.read_text()
    capsys.readouterr()
    assert main(["export", run, "--format", "c", "--name", "own"]) == 0
    assert "own_step" in capsys.readouterr().out


@pytest.mark.quick
@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_configurations_are_listed_and_printed(capsys):
    assert main(["configs"]) == 0
    assert "\nquick          A first look" in capsys.readouterr().out
    assert main(["config", "show", "quick"]) == 0
    shown = capsys.readouterr().out
    assert config.from_dict(tomllib.loads(shown)) == config.load("quick")
    assert main(["config", "quick"]) == 0
    assert capsys.readouterr().out == shown
    assert main(["config", "show"]) == 2
    assert "posegsa config [show] NAME" in capsys.readouterr().err
    assert main(["config", "show", "quik.toml"]) == 2, "it prints no files"
    refusal = capsys.readouterr().err
    assert "quik.toml: no configuration of posegsa; allowed: disturbed, field" in refusal
    assert main(["tune", "quik"]) == 2
    assert "allowed: a TOML file, or disturbed, field" in capsys.readouterr().err


@pytest.mark.quick
@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["evaluate", "nowhere"], "no finished run"),
        (["export", "nowhere", "--format", "c"], "no finished run"),
        (["replay", "kalmna", "a.csv"], "did you mean kalman?"),
        (["tune", "Recommended"], "did you mean recommended?"),
        (["tune", "a.csv"], "a.csv: is a recording; allowed: a configuration, or none; and"),
        (["evaluate", "a.bag"], "a run's folder or a configuration; and --recording a.bag"),
        (["replay", "a.csv", "a.csv"], "a run's folder or a configuration, before a.csv"),
    ],
)
def test_a_missing_run_or_configuration_is_refused(tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert said in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    "arguments", [["--scenarios", "1"], ["--scenarios", "x"], ["--seed", "-1"]]
)
def test_bad_numbers_are_refused_by_name(capsys, arguments):
    with pytest.raises(SystemExit) as refused:
        main(["evaluate", "run", *arguments])
    assert refused.value.code == 2
    assert arguments[0] in capsys.readouterr().err


def test_help_of_export_is_a_line_a_format(capsys):
    with pytest.raises(SystemExit):
        main(["export", "--help"])
    lines = capsys.readouterr().out.splitlines()
    first = [line.split()[0] for line in lines if line.startswith("  ") and line[2] != " "]
    assert [word for word in first if word in FORMATS] == list(FORMATS)
    assert not any("docstring" in line or "arguments as" in line for line in lines)
    assert max(map(len, lines)) < 100


def test_help_of_compare_names_all_that_there_are(capsys):
    with pytest.raises(SystemExit):
        main(["compare", "--help"])
    said = capsys.readouterr().out.split()
    assert "gsa,random_search,pso,de,cma_es,adam,gsa+adam." in said
    words = {word for some in said for word in some.strip(".").split(",")}
    assert words >= {*OPTIMISERS, *FUNCTIONS}


def test_help_and_unknown_names_need_not_wait_for_jax(tmp_path):
    """The commands run one after the other in a process that has imported nothing."""
    commands = [
        ["evaluate", "--help"],
        ["sweep", "--help"],
        ["configs"],
        ["compare", "--repeats", "x"],
        ["tune", "nowhere"],
        ["sweep", "nowhere"],
        ["evaluate", "nowhere"],
        ["export", "nowhere", "--format", "c"],
        ["check", "none.csv"],
        ["replay", "imu", "none.csv", "nor.csv"],
        ["evaluate", "imu", "--recording", "none.csv"],
        ["tune", "imu", "--recording", "none.csv"],
    ]
    code = (
        "import json, sys\nfrom posegsa.cli.command import main\n"
        "for arguments in json.loads(sys.argv[1]):\n"
        "    try: main(arguments)\n    except SystemExit: pass\n"
        "    found = {'jax', 'pydantic'} & set(sys.modules)\n"
        "    print('after', *arguments, 'there are', sorted(found))"
    )
    command = [sys.executable, "-c", code, json.dumps(commands)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    loaded = [line for line in done.stdout.splitlines() if line.startswith("after ")]
    assert loaded == [f"after {' '.join(words)} there are []" for words in commands]


def test_the_command_is_installed_and_helps():
    installed = Path(sys.executable).with_name("posegsa")
    done = subprocess.run([installed, "--help"], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    for command in ("tune", "evaluate", "export"):
        assert command in done.stdout


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_figures_that_there_are_not_are_refused_before_a_search(tmp_path, capsys):
    for command in (
        ["tune", *SETTINGS, "--out", str(tmp_path / "run")],
        ["compare", *SETTINGS, "--out", str(tmp_path / "compared")],
    ):
        assert main([*command, "--quiet", "--figures", "gian"]) == 2
        assert "figures: 'gian'; allowed: " in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    with pytest.raises(SystemExit):
        main(["tune", "--figures", "gain", "--no-figures"])
    assert main(["replay", str(tmp_path), str(tmp_path), "--figures", "gain"]) == 2
    assert "--figures; allowed: with --out" in capsys.readouterr().err
    recorded = ["tune", "--recording", str(tmp_path / "none.csv")]
    assert main([*recorded, "--quiet", "--figures", "gian"]) == 2
    # --no-figures is allowed where no figures are drawn; the error is about the missing file.
    for command in (["replay", str(tmp_path), str(tmp_path / "none.csv")], recorded):
        assert main([*command, "--no-figures"]) == 2
        assert "none.csv: there is no such file" in capsys.readouterr().err


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_a_comparison_without_figures(tmp_path, capsys):
    out = tmp_path / "compared"
    command = ["compare", "--function", "sphere", "--dimensions", "2", "--repeats", "1", "--quiet"]
    command += ["--optimisers", "random_search", "--evaluations", "32", "--out", str(out)]
    command += ["--set", "search.agents=6"]
    assert main(command) == 0
    assert "comparison.png" in capsys.readouterr().out
    assert (out / "comparison.png").exists()
    assert main([*command, "--no-figures"]) == 0
    assert "comparison.png" not in capsys.readouterr().out
    assert not (out / "comparison.png").exists()


FULL = Path("/dev/full")
WRITES = [["configs"], ["config", "show", "quick"], ["--help"], ["--version"], ["tune", "--help"]]


@pytest.mark.quick
@pytest.mark.skipif(not FULL.exists(), reason="the system has no /dev/full")
@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
@pytest.mark.parametrize("arguments", WRITES, ids=" ".join)
def test_output_that_can_not_be_written_is_one_line(arguments, monkeypatch, capsys):
    with FULL.open("w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert main(arguments) == 1
        monkeypatch.undo()
    assert capsys.readouterr().err == "posegsa: standard output: No space left on device\n"


@pytest.mark.quick
@pytest.mark.skipif(not FULL.exists(), reason="the system has no /dev/full")
def test_a_process_whose_output_can_not_be_written_ends_silently():
    with FULL.open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "posegsa", "configs"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.stderr == "posegsa: standard output: No space left on device\n"
    assert done.returncode == 1


@pytest.mark.quick
@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_output_that_nobody_reads_is_one_line(monkeypatch, capsys):
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w", encoding="utf-8") as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        assert main(["config", "show", "recommended"]) == 1
        monkeypatch.undo()
    assert capsys.readouterr().err == "posegsa: standard output: Broken pipe\n"


@pytest.mark.quick
def test_closed_output_is_one_line():
    code = "import os, sys; os.close(1); os.execv(sys.executable, sys.argv[1:])"
    done = subprocess.run(
        [sys.executable, "-c", code, sys.executable, "-m", "posegsa", "configs"],
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    assert done.stderr == "posegsa: standard output is closed\n"
    assert done.returncode == 1


@pytest.mark.quick
def test_other_files_errors_are_not_taken_for_those_of_the_output(monkeypatch):
    def fail(_):
        raise FileNotFoundError(2, "No such file or directory", "somewhere")

    monkeypatch.setattr("posegsa.config.shipped.find", fail)
    with pytest.raises(FileNotFoundError, match="somewhere"):
        main(["config", "show", "quick"])


@pytest.mark.quick
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["tune", "a" * 300], "no file, and no configuration of posegsa"),
        (["evaluate", "a" * 300], "holds no finished run"),
        (["tune", "quick", "--out", "a" * 300], ": File name too long\n"),
    ],
)
def test_a_path_that_is_too_long_is_a_line(arguments, said, monkeypatch, capsys):
    monkeypatch.setattr("posegsa.runtime.enable_fast_path", lambda: True)
    assert main(arguments) == 2
    printed = capsys.readouterr().err
    assert printed.startswith(f"posegsa: {'a' * 300}")
    assert said in printed


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")  # JAX has already started
def test_export_writes_the_frame_of_an_attitude_filter_into_its_step(capsys):
    assert main(["export", "imu", "--format", "c", "--frame", "NED"]) == 0
    assert "{0, 0, POSEGSA_C(-9.81)},\n    {1, 0, 0}" in capsys.readouterr().out
    assert main(["export", "kalman", "--format", "c", "--frame", "NED"]) == 2
    assert "allowed: with imu" in capsys.readouterr().err
