"""`posegsa_init_from` of an exported filter, beside Python's start from the sensors."""

import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.compiled_c import COMPILERS, compile_c, needs_cc, rotation_matrices, sanitizers
from helpers.sensed import rows_of, sensed
from numpy.typing import NDArray

import posegsa
from posegsa.export.c_header import filter_to_c
from posegsa.filters.base import Filter
from posegsa.model.first_pose import shown
from posegsa.model.sample import prepare
from posegsa.model.vectors import AS_MEASURED, VectorSamples

MAIN = """
#include "posegsa.h"
#include <stdio.h>
int main(void)
{
    posegsa_measurement now;
    while (fread(&now, sizeof now, 1, stdin) == 1) {
        static posegsa_state filter; /* unchanged if there is no pose */
        posegsa_real out[8] = {0, 0, 0, 0, 0, 0, 0, 0};
        int i;
        out[0] = (posegsa_real)posegsa_init_from(&filter, &now);
        for (i = 0; i < 4; ++i) out[1 + i] = filter.attitude[i];
#ifdef POSEGSA_MAX_POSITION
        for (i = 0; i < 3; ++i) out[5 + i] = filter.position[i];
#endif
        fwrite(out, sizeof out, 1, stdout);
    }
    return 0;
}
"""
OK, INVALID_INPUT, NO_POSE = 0, 1, 3


class Case(NamedTuple):
    """The references of a filter."""

    vectors: NDArray[np.float64]
    landmarks: NDArray[np.float64]

    @property
    def filter(self) -> Filter:
        """An observer; a Kalman filter if there are several landmarks."""
        if len(self.landmarks) > 1:
            noise = posegsa.KalmanNoise(*jnp.full(12, 0.1))
            return posegsa.KalmanFilter(noise, vector_biases=False)
        return posegsa.Observer(posegsa.ConstantGain(jnp.asarray(5.0)))

    def header(self) -> str:
        """The filter in C."""
        v, p = (each if len(each) else None for each in self)
        return filter_to_c(self.filter, vectors=v, landmarks=p)


AXES, PLACES = np.eye(3), np.array([[0.5, 1.4, 1.0], [-2.0, 1.0, 0.5], [1.0, -2.0, 2.0]])
CASES = {
    "two vectors and a landmark": Case(AXES[1:], PLACES[:1]),
    "a vector and three landmarks": Case(AXES[2:], PLACES),
    "two vectors": Case(AXES[1:], PLACES[:0]),
}


def started(folder: Path, case: Case, rows: NDArray[Any]) -> NDArray[Any]:
    """Code, quaternion and position (N, 8) of starts from rows (N, measurement) of one type."""
    source, kind = folder / "start.c", {4: "float", 8: "double"}[rows.itemsize]
    source.write_text(MAIN)
    options = ("-std=c99", "-O1", f"-DPOSEGSA_REAL={kind}", *sanitizers(COMPILERS[0]))
    program = compile_c(folder, case.header(), source, *options, compiler=COMPILERS[0])
    done = subprocess.run([program], input=rows.tobytes(), capture_output=True, check=True)
    return np.frombuffer(done.stdout, rows.dtype).reshape(len(rows), 8)


@needs_cc
@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("dtype", "allowed"), [(np.float64, 1e-11), (np.float32, 1e-4)])
@pytest.mark.parametrize("name", CASES)
def test_it_starts_where_python_starts(name: str, dtype: Any, allowed: float, tmp_path: Path):
    """At each sample that fixes a pose; the others leave the state as it was."""
    case = CASES[name]
    m = sensed(case, np.full(200, 0.01), missing=0.3)
    rows = rows_of(m, dtype, velocity=len(case.landmarks) > 0)[:, 1:]
    found = started(tmp_path, case, np.nan_to_num(rows))
    sample = jax.tree.map(jnp.asarray, prepare(jax.tree.map(jnp.asarray, m), AS_MEASURED))
    vectors = sample.vectors
    assert isinstance(vectors, VectorSamples)
    expected = shown(vectors.each, sample.landmarks)
    fixed = np.asarray(expected.fixed)
    assert 20 < fixed.sum() < 190
    np.testing.assert_array_equal(found[:, 0], np.where(fixed, OK, NO_POSE))
    R = rotation_matrices(np.stack(expected.attitude, axis=-1))
    np.testing.assert_allclose(rotation_matrices(found[fixed, 1:5]), R[fixed], atol=allowed)
    if len(case.landmarks):
        P = np.stack(expected.place, axis=-1)
        np.testing.assert_allclose(found[fixed, 5:], P[fixed], atol=10 * allowed)
    after = 1 + np.flatnonzero(~fixed[1:] & fixed[:-1])
    np.testing.assert_array_equal(found[after, 1:], found[after - 1, 1:])


@needs_cc
def test_what_no_sensor_gives_is_refused(tmp_path: Path):
    case = CASES["two vectors and a landmark"]
    good = rows_of(sensed(case, np.full(5, 0.01)))[:, 1:]
    wrong = good.copy()
    wrong[1, 7], wrong[2, 4], wrong[3, 12] = np.nan, np.inf, -1.0
    codes = started(tmp_path, case, wrong)[:, 0]
    np.testing.assert_array_equal(codes, [OK, *(INVALID_INPUT,) * 3, OK])


@pytest.mark.parametrize(
    "case",
    [
        Case(AXES[2:], PLACES[:1]),
        Case(AXES[:0], PLACES[:2]),
        Case(np.array([[0, 0, 1.0], [0, 0, 2.0]]), PLACES[:1]),
    ],
    ids=["one vector and one landmark", "two landmarks", "parallel vectors"],
)
def test_sensors_that_never_show_a_pose_have_no_such_function(case: Case):
    assert "init_from" not in case.header()


def test_a_vector_without_weight_is_not_asked():
    case = CASES["two vectors and a landmark"]
    filter = case.filter
    assert isinstance(filter, posegsa.Observer)
    weights = tuple(jnp.asarray(one) for one in (1.0, 0.0))
    settings = replace(filter.settings, vectors=replace(filter.settings.vectors, weights=weights))
    header = filter_to_c(
        replace(filter, settings=settings), vectors=case.vectors, landmarks=case.landmarks
    )
    assert "init_from" not in header
