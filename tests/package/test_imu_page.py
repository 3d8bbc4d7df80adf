"""docs/imu.md: its lines run, and its numbers are those of the configuration."""

import re
from pathlib import Path

import numpy as np

from posegsa.filters.attitude import AttitudeNumbers

TEXT = (Path(__file__).parents[2] / "docs" / "imu.md").read_text(encoding="utf-8")


def test_the_lines_run() -> None:
    (code,) = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
    text = re.sub(r"posegsa.enable_fast_path\(\).*\n", "", code)  # JAX has started already
    assert text != code
    exec(text, found := {})  # the page's own text
    np.testing.assert_allclose(found["pose"].rotation, np.eye(3), atol=2e-3)
    assert not found["state"].at_rest


def test_numbers_that_it_names_are_the_filters() -> None:
    named = {name for name in re.findall(r"`(\w+)`", TEXT) if "_" in name or name == "velocity"}
    others = {"gyroscope_interval", "run_filter", "field_belief", "held_out", "longest_gap"}
    assert named - others <= set(AttitudeNumbers._fields)
    assert {"magnetometer_delay", "iron_time", "field_tolerance", "velocity"} <= named
