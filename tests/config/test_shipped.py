"""The configurations that come with posegsa, by name."""

import re
import tomllib
from pathlib import Path

import pytest

from posegsa import config
from posegsa.config import shipped
from posegsa.config.defaults_shown import with_defaults_shown
from posegsa.errors import ConfigError

pytestmark = pytest.mark.quick

CONFIGS = Path(__file__).parents[2] / "configs"


def test_each_file_has_a_name_and_says_what_it_is_for() -> None:
    assert shipped.names() == sorted(path.stem for path in CONFIGS.glob("*.toml"))
    for name in shipped.names():
        assert len(shipped.about(name)) > 20
        assert "\n" not in shipped.about(name)


@pytest.mark.parametrize("name", shipped.names())
def test_the_defaults_that_are_shown_are_those_that_hold(name: str) -> None:
    experiment = config.load(name)
    shown = with_defaults_shown(shipped.find(name).read_text("utf-8"), experiment)
    assert config.from_dict(tomllib.loads(shown)) == experiment
    stated = re.sub(r"^# (\w+ = )", r"\1", shown, flags=re.MULTILINE)
    found = tomllib.loads(stated)["filter"]
    assert config.from_dict({"filter": found}).filter == experiment.filter
    plain = experiment.filter.model_dump(mode="json").items()
    assert {key for key, value in plain if not isinstance(value, dict | list | None)} <= set(found)
    if name == "imu":
        assert "\n# magnetometer_delay = 0.011  # Delay of the magnetometer" in shown
        assert "[s]." in shown


def test_a_name_means_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert config.load("quick") == config.load(CONFIGS / "quick.toml")
    named = config.as_experiment("recommended")
    assert named == config.load(CONFIGS / "recommended.toml")
    assert config.as_experiment(None) == named


def test_a_file_of_that_name_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("quick").write_text("[run]\nseed = 77\n", "utf-8")
    assert config.load("quick").run.seed == 77


def test_a_folder_of_that_name_is_no_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For example the folder of `posegsa tune quick --out quick`."""
    monkeypatch.chdir(tmp_path)
    Path("quick").mkdir()
    assert config.load("quick").search.agents == 32


def test_in_a_wheel_they_are_inside_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = tmp_path / "posegsa" / "configs"
    installed.mkdir(parents=True)
    (installed / "mine.toml").write_text("# What I use. More.\n[run]\nseed = 3\n", "utf-8")
    monkeypatch.setattr(shipped, "__file__", str(tmp_path / "posegsa" / "config" / "shipped.py"))
    assert shipped.names() == ["mine"]
    assert shipped.about("mine") == "What I use"
    assert config.load("mine").run.seed == 3


def test_another_name_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(ConfigError, match=r"quik: .*TOML.*field, .*quick"):
        config.load("quik")
