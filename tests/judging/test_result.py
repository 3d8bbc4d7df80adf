"""What a result reports about its own numbers."""

import numpy as np
import pytest
from helpers.results import history

from posegsa import config
from posegsa.judging.description import Description
from posegsa.judging.result import FoundBy, Result


@pytest.mark.quick
@pytest.mark.parametrize("scale", ["logarithmic", "linear"])
@pytest.mark.parametrize("share", [0.0, 0.005, 0.02, 0.5, 0.98, 0.995, 1.0])
def test_a_number_at_an_end_of_its_box_is_named(share: float, scale: str) -> None:
    low, high = 0.03, 3.0
    value = low * (high / low) ** share if scale == "logarithmic" else low + share * (high - low)
    box = f'{{key="filter.vector", lower={low}, upper={high}, scale="{scale}"}}'
    made = Result(
        experiment=config.override(config.load("kalman"), [f"parameters.also=[{box}]"]),
        filter=Description("kalman", {}, {"filter.vector": value}, 12),
        search=FoundBy(
            tuned_on="scenarios",
            cost="configured",
            position_weight=10.0,
            best_cost=float(np.min(history(3).best)),
            non_finite=0,
            compile_seconds=1.0,
            search_seconds=0.5,
            history=history(3),
        ),
        environment={},
        version="1.2.3",
    )
    found = made.at_ends()
    assert len(found) == (share < 0.01 or share > 0.99)
    if found:
        end = "lower" if share < 0.5 else "upper"
        assert f"is at the {end} end of its box, 0.03 to 3: widen it" in found[0]
        assert f"note: {found[0]}" in made.summary()
