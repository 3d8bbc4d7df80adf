"""Export of a tuned schedule as JSON and CSV, and by the name of a format."""

import csv
import dataclasses
import io
import json
import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.results import changed, endurance, evaluation, result
from helpers.schedules import COUNT, DRAWN, GAPS, MIDRANGE, SAMPLED, K, evaluated, inputs, tuned

import posegsa
from posegsa import config
from posegsa.errors import PosegsaError
from posegsa.export import FORMATS, SCHEMA, export, export_c_gain, export_csv, export_json
from posegsa.export.c_text import worth
from posegsa.judging.evaluation import CONSTANT, TUNED
from posegsa.model.fuzzy import FuzzyController

pytestmark = pytest.mark.quick

# JSON and CSV -------------------------------------------------------------------------------------


def rebuilt(data: dict[str, Any]) -> FuzzyController:
    """The controller from the JSON alone."""
    c = data["controller"]
    terms = (
        jnp.asarray(list(c[key].values()), data["dtype"])
        for key in ("input_terms", "output_terms_1_s")
    )
    return FuzzyController(
        *terms,
        tuple(tuple(row) for row in c["rule_indices"]),
        tuple(c["output_range_1_s"]),
        c["centroid"],
        c["sampled_points"],
        c["sampled_rule"],
        c["no_rule"],
    )


@pytest.mark.parametrize(
    ("dtype", "settings"),
    [
        ("float32", GAPS),
        ("float64", (*SAMPLED, *MIDRANGE, "fuzzy.sampled_rule=trapezoid")),
    ],
)
def test_json_gives_the_controller_back_exactly(dtype, settings):
    result = tuned(K, *settings, dtype=dtype)
    data = json.loads(export_json(result))
    surface = data["control_surface"]
    with jax.enable_x64(dtype == "float64"):
        again, own = rebuilt(data), result.controller
        assert result.controller is own, "it is made once"
        for field in dataclasses.fields(FuzzyController):
            if field.name == "reach":  # only saves time
                continue
            np.testing.assert_array_equal(getattr(again, field.name), getattr(own, field.name))
        assert again.output_terms.dtype == dtype
        np.testing.assert_array_equal(evaluated(again, inputs()), evaluated(own, inputs()))
        assert data["controller"]["initial_gain_1_s"] == own.initial_gain()
        error, rate = (np.asarray(surface[key], dtype) for key in ("error", "rate"))
        np.testing.assert_allclose(error, np.linspace(0, 1, 101), rtol=np.finfo(dtype).eps)
        np.testing.assert_array_equal(rate, error)
        cells = np.stack(np.meshgrid(error, rate)).reshape(2, -1)[:, :COUNT]
        expected = evaluated(own, cells)
    gains = np.array(surface["gain_1_s"])
    assert gains.shape == (101, 101)
    assert (gains == gains.astype(dtype)).all()
    # Another program, compiled with fused multiply-adds.
    tolerance = 100 * np.finfo(dtype).eps
    np.testing.assert_allclose(gains.ravel()[:COUNT], expected, rtol=tolerance)


def test_json_has_the_whole_schedule():
    costs = {TUNED: np.array([40.0, np.inf]), CONSTANT: np.array([44.0, 45.0])}
    result = tuned(K, *GAPS, "gain.error_scale=0.75", training=costs)
    text = export_json(result)
    data = json.loads(text, parse_constant=pytest.fail)
    assert (data["schema"], data["version"]) == (SCHEMA, posegsa.__version__)
    assert data["tuned_with"] == "0.0.1"
    assert data["dtype"] == "float32"
    assert data["gain"] == result.experiment.gain.model_dump(mode="json")
    assert data["filter"] == result.experiment.filter.model_dump(mode="json")
    assert data["kind"] == "fuzzy"
    numbers = [[k] for k in result.parameters.tolist()]
    assert data["numbers"] == dict(zip(config.PARAMETERS, numbers, strict=True))
    controller = data["controller"]
    assert list(controller["input_terms"]) == list(config.TERMS)
    assert controller["rules"][0] == ["VS", "S", "M", "VL", "VL"]
    indices = [[config.TERMS.index(name) for name in row] for row in controller["rules"]]
    assert indices == controller["rule_indices"]
    assert data["costs"][TUNED]["training_mean"] == "inf"
    assert data["costs"][TUNED]["held_out_mean"] == 43.25
    assert data["costs"][CONSTANT]["held_out_worst"] == 52.5
    assert data["costs"][CONSTANT]["numbers"] == {"gain": [27.5]}
    (warning,) = data["warnings"]
    assert "NOT FINITE" in warning
    assert "1 of 2 training scenarios" in warning
    assert (data["sensors"], data["held_out_recordings"]) == (None, [])
    assert max(map(len, text.splitlines())) < 4000, "rows of numbers on lines of their own"


def test_what_is_worse_past_its_window_is_exported_with_the_warning():
    assert json.loads(export_json(tuned(K)))["warnings"] == []
    worse = tuned(K, endurance=endurance(attitude=np.array([40.0, 6, 5, 9.5])))
    (warning,) = json.loads(export_json(worse))["warnings"]
    assert warning.endswith("worse than the best constant gains: attitude from 60 to 120 s")
    written = " ".join(line.removeprefix(" * ") for line in export_c_gain(worse).splitlines())
    assert f"WARNING: {warning}." in written


def test_other_tuned_numbers_are_in_json_and_c():
    also = {"gain.error_scale": 0.75, "scenario.landmarks.0.weight": 0.375}
    result = tuned(K, also=also)
    data = json.loads(export_json(result))
    assert data["tuned_too"] == also
    assert data["gain"]["error_scale"] == 0.75 != result.experiment.gain.error_scale
    text = export_c_gain(result)
    assert "error = e / 0.75\n" in text
    assert "m, weight 0.375\n" in text


@pytest.mark.parametrize("format", ["c-gain", "fis", "fll"])
def test_a_controller_of_an_observer_with_belief_says_whose_weights_are_divided(format):
    words = "divided by the factor of each sensor's belief"
    plain = tuned(K)
    believing = config.override(plain.experiment, ["filter.belief=ramp"])
    with_belief = dataclasses.replace(plain, experiment=believing)
    oracle = dataclasses.replace(  # its error has no weights
        plain, experiment=config.override(believing, ["gain.signal=pose"])
    )
    for one, said in ((plain, False), (with_belief, True), (oracle, False)):
        written = re.sub(r"[\s*%#]+", " ", export(one, format))
        assert (words in written) == said


def test_csv_is_the_control_surface():
    result = tuned(DRAWN[0], *GAPS)
    header, *rows = csv.reader(io.StringIO(export_csv(result, resolution=21)))
    assert header == ["error", "rate", "gain_1_s"]
    table = np.array(rows, np.float64)
    assert rows[1][0] == "0.05", "and not 0.05000000074505806"
    single = [repr(float(str(np.float32(cell)))) for row in rows for cell in row]
    assert single == [cell for row in rows for cell in row], "no digits beyond the run's precision"
    error, rate, gains = table.T
    axis = np.linspace(0, 1, 21)
    # The error runs fastest.
    np.testing.assert_allclose(error.reshape(21, 21), np.tile(axis, (21, 1)), rtol=1e-6)
    np.testing.assert_allclose(rate.reshape(21, 21), np.tile(axis[:, None], 21), rtol=1e-6)
    np.testing.assert_allclose(gains, evaluated(result.controller, table.T[:2]), rtol=1e-5)
    assert (gains == 51).any(), "the initial gain where no rule fires"


def test_a_resolution_below_two_is_refused():
    with pytest.raises(PosegsaError, match="resolution = 1; allowed: a whole number from 2"):
        export_csv(tuned(K), resolution=1)


# By name ------------------------------------------------------------------------------------------


def test_formats_by_name():
    assert list(FORMATS) == ["json", "csv", "c", "c-gain", "fis", "fll"]
    result = tuned(K)
    assert export(result, "c-gain", name="own") == export_c_gain(result, name="own")
    assert export(result, "json") == export_json(result)
    with pytest.raises(PosegsaError, match=r"format: must be one of json, csv, c, .*, got 'xls'"):
        export(result, "xls")
    with pytest.raises(PosegsaError, match="name = 'own'; allowed: only with c or c-gain"):
        export(result, "json", name="own")


def test_a_c_file_has_its_own_name_in_its_example():
    result = tuned(K)
    for name, file in ((None, "posegsa_front.h"), ("own", "filter.h")):
        text = export(result, "c", name, file)
        assert text.startswith(f"/*\n * {file}: ")
        assert f'#include "{file}"' in text
        assert f"{name or 'posegsa'}.h" not in text
        assert f"{name or 'posegsa'}_step" in text
    odd = export(result, "c", file='a"; */ b.h')
    assert odd == export(result, "c"), "no name that a comment or an #include can't have"


def test_a_file_says_that_its_filter_is_too_sure() -> None:
    sure = changed(evaluation(), TUNED, nees_inside=np.full(40, 0.55))
    told = "The tuned filter is too sure"
    assert told in " ".join(worth(result(evaluation=sure)))
    assert told not in " ".join(worth(result()))
