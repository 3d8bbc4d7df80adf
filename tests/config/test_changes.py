"""Experiments with single values replaced, from Python and from the command line."""

import pytest

from posegsa import config
from posegsa.config import Experiment
from posegsa.errors import ConfigError
from posegsa.optimisers import GSA

pytestmark = pytest.mark.quick


def test_values_are_replaced_as_settings_do() -> None:
    one = Experiment()
    changed = one.replace(**{"filter.gamma": 2, "scenario.vectors.0.noise": 0.3, "run.seed": 4})
    settings = ["filter.gamma=2", "scenario.vectors.0.noise=0.3", "run.seed=4"]
    assert changed == config.override(one, settings)
    assert one == Experiment()
    assert "filter.gamma" not in [also.key for also in changed.also]


@pytest.mark.parametrize("ends", [(0.0, 50.0), (2.0, 200.0)])
def test_bounds_fit_another_gain_range_as_they_do_in_a_file(ends: tuple[float, float]) -> None:
    in_a_file = config.from_dict({"parameters": {"gain_range": list(ends)}}).parameters
    assert in_a_file.upper != Experiment().parameters.upper
    assert Experiment().replace(**{"parameters.gain_range": ends}).parameters == in_a_file
    set_so = config.override(Experiment(), [f"parameters.gain_range={list(ends)}"])
    assert set_so.parameters == in_a_file
    # A value that is set is kept.
    own = [*in_a_file.upper[:-1], ends[1]]
    changed = Experiment().replace(
        **{
            "parameters.gain_range": ends,
            "parameters.upper": own,
            "parameters.lower": [*in_a_file.lower],
        }
    )
    assert changed.parameters.upper == tuple(own)


def test_another_optimiser_keeps_the_size_of_the_search() -> None:
    changed = Experiment().replace(**{"search.optimiser": "gsa"}).search
    assert isinstance(changed, GSA)
    assert changed.agents == Experiment().search.agents
    assert Experiment().replace(search=GSA(agents=7, iterations=3)).search == GSA(
        agents=7, iterations=3
    )


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("filter.gama", 2.0, r"filter\.gama\s.*did you mean filter\.gamma"),
        ("filter.gamma", -1.0, r"filter\.gamma = -1\.0\s.*0"),
        ("scenario.vectors.7.noise", 1.0, r"scenario\.vectors.*array of 2"),
        ("run.seed.high", 1, r"run\.seed is a single value"),
        ("search", 3, "search = 3"),
    ],
)
def test_what_can_not_be_is_refused_by_its_path(path: str, value: object, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Experiment().replace(**{path: value})
