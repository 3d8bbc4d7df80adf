"""Effects of posegsa on the process: none on import, one documented setting on request."""

import os
import subprocess
import sys

import jax.numpy as jnp
import pytest

from posegsa import runtime
from posegsa.errors import ArgumentError, PosegsaWarning

EXTRA = "--xla_backend_extra_options="


def python(code: str, **environment: str) -> str:
    """The output of a fresh interpreter."""
    inherited = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"}
    done = subprocess.run(
        [sys.executable, "-W", "error::UserWarning", "-c", code],
        env=inherited | environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_flags_are_appended_to_what_the_user_has_set():
    flags = runtime.fast_path_flags("--xla_dump_to=/tmp/x --xla_cpu_use_thunk_runtime=true")
    assert flags.startswith("--xla_dump_to=/tmp/x --xla_cpu_use_thunk_runtime=true ")
    assert "xla_cpu_use_multi_output_fusion=true" in flags


def test_options_that_the_user_has_set_win():
    flags = runtime.fast_path_flags(f"{EXTRA}xla_cpu_use_multi_output_fusion=false,other=1")
    assert flags.count(EXTRA) == 1
    assert "xla_cpu_use_multi_output_fusion=false" in flags
    assert "xla_cpu_use_multi_output_fusion=true" not in flags
    assert "other=1" in flags
    assert "xla_cpu_small_while_loop_byte_threshold=" in flags


@pytest.mark.parametrize(
    ("machine", "wanted"), [("x86_64", True), ("AMD64", True), ("arm64", False)]
)
def test_an_option_of_x86_is_for_x86_alone(monkeypatch, machine, wanted):
    monkeypatch.setattr(runtime.platform, "machine", lambda: machine)
    assert ("-x86-machine-combiner=false" in runtime.fast_path_flags()) == wanted


def test_devices_may_wait_for_each_other_longer_than_xla_lets_them():
    name = "--xla_cpu_collective_call_terminate_timeout_seconds"
    assert f"{name}=604800" in runtime.fast_path_flags().split()
    assert runtime.fast_path_flags(f"{name}=5").count(name) == 1


def test_flags_are_set_once_however_often_they_are_asked_for():
    once = runtime.fast_path_flags()
    assert runtime.fast_path_flags(once) == once


def test_the_name_of_a_file_with_flags_stays_as_it_is():
    assert runtime.fast_path_flags("/etc/xla flags") == "/etc/xla flags"


def test_a_file_with_flags_is_read_and_a_warning_says_so(tmp_path):
    file = tmp_path / "flags"
    file.write_text("--xla_force_host_platform_device_count=3", encoding="utf-8")
    code = """
import posegsa, warnings
with warnings.catch_warnings(record=True, action="always") as said:
    assert posegsa.enable_fast_path()
import jax
print(len(jax.devices()), *(str(one.message) for one in said))
"""
    assert python(code, XLA_FLAGS=str(file)).startswith(f"3 XLA_FLAGS names a file, {file}, ")


def test_the_command_line_leaves_a_file_with_flags_alone(tmp_path):
    file = tmp_path / "flags"
    file.write_text("--xla_force_host_platform_device_count=3", encoding="utf-8")
    code = """
import warnings
warnings.simplefilter("always")  # a line on standard error
from posegsa.cli import main
import posegsa.cli.export
def run(options):
    import jax
    print(len(jax.devices()))
posegsa.cli.export.run = run
main(["export", ".", "--format", "c"])
"""
    assert python(code, XLA_FLAGS=str(file)) == "3"


def test_import_changes_nothing_in_the_process():
    code = """
import os, jax
def settings():
    return {k: v for k, v in jax.config.values.items()}
before = dict(os.environ), settings()
from posegsa import *  # all that `import posegsa` loads when it is used
assert (dict(os.environ), settings()) == before
from jax._src import xla_bridge
assert not xla_bridge.backends_are_initialized(), "importing posegsa started JAX"
import sys
assert "matplotlib.pyplot" not in sys.modules, "importing posegsa chose a plotting backend"
assert "jinja2" not in sys.modules, "importing posegsa loaded what only a report needs"
print("same")
"""
    assert python(code) == "same"


def test_it_is_known_whether_the_options_are_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for flags, known in (("", False), (runtime.fast_path_flags(), True), ("/etc/flags", True)):
        monkeypatch.setenv("XLA_FLAGS", flags)
        assert runtime.has_fast_path() is known


def test_the_fast_path_is_on_when_asked_for_in_time():
    code = """
import posegsa, os
assert posegsa.enable_fast_path()
import jax.numpy as jnp
print(float(jnp.sum(jnp.ones(3))), os.environ["XLA_FLAGS"])
"""
    assert python(code) == f"3.0 {runtime.fast_path_flags()}"


def test_too_late_it_warns_and_changes_nothing(monkeypatch):
    jnp.ones(1).block_until_ready()
    monkeypatch.setattr(runtime, "enable_compilation_cache", lambda: None)
    monkeypatch.setenv("XLA_FLAGS", "--as_it_was")
    with pytest.warns(PosegsaWarning, match="before the first array"):
        assert not runtime.enable_fast_path()
    assert os.environ["XLA_FLAGS"] == "--as_it_was"


@pytest.mark.parametrize("devices", [0, -1, 2.0, "2", True, 10**9])
def test_devices_that_can_not_be_made_are_refused(devices, monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--as_it_was")
    message = rf"devices = {devices!r}; allowed: a whole number from 1 to 4096"
    with pytest.raises(ArgumentError, match=message):
        runtime.enable_fast_path(devices)
    assert os.environ["XLA_FLAGS"] == "--as_it_was"


def test_environment_names_versions_and_device():
    named = runtime.environment()
    versions = {"posegsa", "jax", "numpy", "python"}
    assert set(named) == versions | {"platform", "device", "devices"}
    assert all(named.values())
