"""Configuration files of the attitude filter for inertial sensors."""

import tomllib
from pathlib import Path

import pytest

from posegsa import config
from posegsa.config import ImuConfig, load_imu, override_imu
from posegsa.errors import ConfigError

pytestmark = pytest.mark.quick

SHIPPED = Path(__file__).parent.parent.parent / "configs" / "imu.toml"


def test_the_shipped_file_is_the_default_with_every_value_written_out() -> None:
    assert load_imu() == load_imu("imu") == load_imu(SHIPPED) == ImuConfig()
    assert tomllib.loads(SHIPPED.read_text("utf-8")) == ImuConfig().model_dump(mode="json")
    assert tomllib.loads(ImuConfig().to_toml()) == ImuConfig().model_dump(mode="json")


def test_what_a_file_leaves_out_keeps_its_shipped_number(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("[observer]\ngain = 3.0\n", encoding="utf-8")
    found = load_imu(path)
    assert found.observer.gain == 3.0
    assert found.observer.gamma == ImuConfig().observer.gamma
    assert found.vectors == ImuConfig().vectors


def test_a_number_that_is_changed_is_not_searched_unless_it_is_said() -> None:
    changed = override_imu(ImuConfig(), ["vectors.field_tolerance=off", "observer.gain=2.0"])
    assert changed.vectors.field_tolerance == "off"
    assert [one.key for one in changed.also] == [
        *("vectors.low_pass", "observer.east_weight", "observer.gamma")
    ]
    assert [one.key for one in ImuConfig(vectors={"field_tolerance": "off"}).also] == [
        *("vectors.low_pass", "observer.gain", "observer.east_weight", "observer.gamma")
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[observer]\ngain = 0.0\n", "observer.gain"),
        ("[vectors]\nlow_pass = -1.0\n", "vectors.low_pass"),
        ("[vectors]\nlowpass = 1.0\n", "vectors.lowpass"),
        ("[filter]\ngamma = 1.0\n", "filter"),
        ("gain", "not valid TOML"),
    ],
)
def test_what_is_wrong_is_named(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=message) as error:
        load_imu(path)
    assert "mine.toml" in str(error.value)


def test_as_an_experiment_it_is_refused_by_what_it_is() -> None:
    with pytest.raises(ConfigError, match=r"attitude filter for inertial sensors.*replay imu"):
        config.load("imu")
