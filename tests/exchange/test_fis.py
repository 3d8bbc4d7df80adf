"""MATLAB's format, read by fuzzylite, by Octave and by a short reader written here."""

import re
import shutil
import subprocess

import numpy as np
import pytest
from helpers.fuzzy_readers import (
    CASES,
    by_midpoints,
    by_samples,
    controller,
    exact,
    inputs,
    needs_fuzzylite,
    with_fuzzylite,
)
from helpers.schedules import GAPS, MIDRANGE, K, tuned

import posegsa

pytestmark = pytest.mark.quick

OCTAVE = shutil.which("octave-cli")
FUZZYLITE_PARTS = 100
"""fuzzylite's default resolution; a .fis file can't set it."""


@needs_fuzzylite
@pytest.mark.parametrize("case", CASES)
def test_fuzzylite_reads_the_gain(case, tmp_path):
    one, given = controller(case), inputs()
    read = with_fuzzylite(posegsa.export_fis(one), "fis", given, tmp_path)
    np.testing.assert_allclose(read, by_midpoints(one, given, FUZZYLITE_PARTS), rtol=1e-10)
    assert np.nanmax(np.abs(read - exact(one, given))) < 1


@pytest.mark.skipif(OCTAVE is None, reason="octave-cli is not there (Debian's package octave)")
def test_octave_reads_the_gain(tmp_path):
    one, given = controller("covering"), inputs(60)
    (tmp_path / "gain.fis").write_text(posegsa.export_fis(one), encoding="utf-8")
    np.savetxt(tmp_path / "given.txt", given, fmt="%.17g")
    program = (
        "pkg load fuzzy-logic-toolkit; fis = readfis('gain.fis'); "
        "printf('%.15g\\n', evalfis(load('given.txt'), fis, 101));"
    )
    done = subprocess.run(
        [str(OCTAVE), "--no-gui", "--quiet", "--eval", program],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    if "fuzzy-logic-toolkit" in done.stderr:
        pytest.skip("Octave has no fuzzy-logic-toolkit (Debian's octave-fuzzy-logic-toolkit)")
    read = np.array([float(word) for word in done.stdout.split()])
    ends = np.ones(101)
    ends[[0, -1]] = 0.5  # the trapezoidal rule
    expected = by_samples(one, given, np.linspace(0, 100, 101), ends)
    np.testing.assert_allclose(read, expected, rtol=1e-10)


def sections(text: str) -> dict[str, dict[str, str]]:
    """Keys and values of each section; rules are keys without values."""
    found: dict[str, dict[str, str]] = {}
    for line in text.splitlines():
        if line.startswith("["):
            found[line.strip("[]")] = {}
        elif line and not line.startswith("%"):
            key, _, value = line.partition("=")
            found[list(found)[-1]][key] = value
    return found


@pytest.mark.parametrize("case", CASES)
def test_the_file_holds_the_controller(case):
    one = controller(case)
    read = sections(posegsa.export_fis(one))
    counts = [read["System"][f"Num{kind}"] for kind in ("Inputs", "Outputs", "Rules")]
    assert counts == ["2", "1", "25"]
    variables = {
        "Input1": ("error", one.input_terms, (0.0, 1.0)),
        "Input2": ("rate", one.input_terms, (0.0, 1.0)),
        "Output1": ("gain_minus_1", one.output_terms, one.output_range),
    }
    for section, (name, terms, ends) in variables.items():
        values = read[section]
        assert values["Name"] == f"'{name}'"
        assert tuple(map(float, values["Range"].strip("[]").split())) == ends
        functions = [values[f"MF{i}"] for i in range(1, int(values["NumMFs"]) + 1)]
        assert [f.split(",")[0] for f in functions] == [
            f"'{term}':'trimf'" for term in ("VS", "S", "M", "L", "VL")
        ]
        feet = [[float(x) for x in re.findall(r"[\d.e+-]+", f.split(",")[1])] for f in functions]
        # If the peak is at an end of the range, the foot is outside it.
        expected, (low, high) = np.array(terms), ends
        expected[expected[:, 1] == low, 0] = low - (high - low)
        expected[expected[:, 1] == high, 2] = high + (high - low)
        np.testing.assert_array_equal(feet, expected)  # all digits
    rules = [[int(x) for x in re.findall(r"\d+", rule)] for rule in read["Rules"]]
    assert [rule[3:] for rule in rules] == [[1, 1]] * 25
    for error, rate, output, *_ in rules:
        assert one.rules[rate - 1][error - 1] == output - 1
    assert len({(error, rate) for error, rate, *_ in rules}) == 25


def test_matlabs_own_sum_agrees_with_its_samples():
    """A controller that samples like MATLAB has the gain that MATLAB computes from the file."""
    result = tuned(K, "fuzzy.centroid=sampled", dtype="float64")
    given = inputs()
    expected = by_samples(result.controller, given, np.linspace(0, 100, 101))
    np.testing.assert_allclose(exact(result.controller, given), expected, rtol=1e-12)


def test_the_comment_says_what_the_format_cannot():
    held, middle = (posegsa.export_fis(tuned(K, *more)) for more in (GAPS, MIDRANGE))
    for text in (held, middle):
        head = " ".join(re.findall(r"^% *(.*)$", text, re.MULTILINE))
        assert "the gain is K = 1 + output [1/s]" in head
        assert "error = e / " in head
        assert "held out" in head
    assert "keep the last gain" in held
    assert "keep the last gain" not in middle


def test_a_run_tuned_on_true_errors_says_so():
    text = posegsa.export_fis(tuned(K, "gain.signal=pose"))
    head = " ".join(re.findall(r"^% *(.*)$", text, re.MULTILINE))
    assert "WARNING: signal pose: the gain looks at the true errors, which no vehicle knows" in head
