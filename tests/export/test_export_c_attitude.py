"""The attitude filter for inertial sensors as C: what Python computes, and the head's example."""

import subprocess
from functools import cache

import jax
import numpy as np
import pytest
from helpers.compiled_c import COMPILERS, Build, compile_c, needs_cc, rotation_matrices, sanitizers
from helpers.compiled_c import build as build
from helpers.recordings import inertial_motion

import posegsa
from posegsa.filters.rollout import Estimates
from posegsa.recordings.imu import ImuRecording


@cache
def seen() -> ImuRecording:
    """A shaken body, with gaps in all that can be missing."""
    given = inertial_motion(3.0, 12.0, noise=1.0, shaking=3.0)
    given["acc"][:3] = np.nan
    given["acc"][700:740] = np.nan
    given["mag"][:30] = np.nan
    given["mag"][500:900] = np.nan
    given["mag"][1000:1100] += [20.0, 5.0, -10.0]
    return posegsa.imu(**given)


@cache
def in_python() -> Estimates:
    found = posegsa.configured("imu").estimate(seen())
    return jax.tree.map(np.asarray, found)


@cache
def header() -> str:
    return posegsa.export_c(posegsa.configured("imu"))


@needs_cc
@pytest.mark.parametrize(("real", "allowed"), [("double", 1e-12), ("float", 2e-4)])
def test_the_c_filter_is_the_python_filter(build: Build, real: str, allowed: float) -> None:
    m, dtype = seen().measurements, {"double": np.float64, "float": np.float32}[real]
    parts = (m.time_step[:, None], m.angular_velocity, m.vectors, m.vector_weights)
    rows = np.concatenate([np.reshape(a, (len(m.time_step), -1)) for a in parts], axis=1)
    options = ("-std=c99", "-O1", "-DATTITUDE_ONLY", f"-DPOSEGSA_REAL={real}")
    program = build(header(), *options, *sanitizers(COMPILERS[0]))
    R = seen().initial().rotation
    with jax.enable_x64(True):
        q = np.asarray(posegsa.initial_state(R, np.zeros(3)).attitude)
    sent = np.concatenate([q.astype(dtype), rows.astype(dtype).ravel()]).tobytes()
    done = subprocess.run([program], input=sent, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    table = np.frombuffer(done.stdout, dtype).reshape(len(rows), -1).astype(float)
    assert not table[:, 0].any()
    exact = in_python()
    np.testing.assert_allclose(
        rotation_matrices(table[:, 1:5])[1:], exact.rotation[1:], atol=allowed
    )
    np.testing.assert_allclose(table[:, 5:8], exact.bias[:, :3], atol=0.1 * allowed)


@needs_cc
def test_the_example_in_the_head_compiles_and_runs(tmp_path) -> None:
    lines = header().partition(" * USE\n")[2].partition(" *\n")[0].splitlines()
    source = tmp_path / "example.c"
    source.write_text("\n".join(line.removeprefix(" * ").removeprefix("    ") for line in lines))
    program = compile_c(tmp_path, header(), source, "-std=c99", compiler=COMPILERS[0])
    done = subprocess.run([program], check=True, capture_output=True, text=True)
    assert abs(float(done.stdout)) == pytest.approx(1.0, abs=1e-3)  # upright, to the north


@pytest.mark.quick
def test_it_says_what_it_reads_and_holds_no_position() -> None:
    text = header()
    assert "specific force (vectors[0]" in " ".join(text.replace("*", "").split())
    assert "position[3]" not in text
    assert "velocity[3];         " not in text
    assert len(text) < 100_000
