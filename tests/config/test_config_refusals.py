from pathlib import Path
from typing import Any

import pytest
from helpers.experiments import BASE
from helpers.messages import assert_states

import posegsa.config as config
from posegsa.config import Experiment, from_dict, load, override
from posegsa.errors import ConfigError

pytestmark = pytest.mark.quick


def refusal(function: Any, *arguments: Any, **keywords: Any) -> str:
    """The text of the ConfigError that a call raises, without line breaks."""
    with pytest.raises(ConfigError) as caught:
        function(*arguments, **keywords)
    text = str(caught.value)
    assert "pydantic" not in text
    assert "type=" not in text
    assert caught.value.__cause__ is None
    return " ".join(text.split())


def setting_refusal(*texts: str) -> str:
    return refusal(override, override(Experiment(), BASE), texts)


# Values: the key, the value, what is allowed ------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "facts"),
    [
        # wrong types
        ("run.seed=true", ["run.seed = true", "integer"]),
        ("run.seed=1.0", ["run.seed = 1.0", "integer"]),
        ('run.seed="1"', ['run.seed = "1"', "integer"]),
        ("scenario.duration=true", ["scenario.duration = true", "number"]),
        ('scenario.duration="15"', ['scenario.duration = "15"', "number"]),
        ("filter.cross_vector=1", ["filter.cross_vector = 1", "boolean"]),
        ("filter.cross_vector=yes", ['filter.cross_vector = "yes"', "boolean"]),
        ("scenario.vectors=3", ["scenario.vectors = 3", "array"]),
        ("scenario.vectors.0=3", ["scenario.vectors.0 = 3", "table", "direction", "bias"]),
        ("filter.law=1979-05-27", ["filter.law = 1979-05-27", "gradient", "printed"]),
        ("search.random=true", ["search.random = true", "dimension", "agent"]),
        ("filter.gamma_law=cubic", ['"cubic"', "fixed", "linear", "quadratic"]),
        ("filter.vector_bias=on", ['filter.vector_bias = "on"', "off", "estimated"]),
        ("gain.rate=slow", ['gain.rate = "slow"', "per_sample", "per_second"]),
        ("family.outages=often", ['family.outages = "often"', "off"]),
        ("family.outages.sensors=all", ["family.outages", "sensors"]),
        ("family.outages={rate=-1}", ["family.outages.rate = -1", "0"]),
        ("family.bursts={duration=[5, 1]}", ["family.bursts.duration = [5.0, 1.0]"]),
        ("family.bursts={size=[3, 1]}", ["family.bursts.size = [3.0, 1.0]"]),
        ("family.bursts={size=-1}", ["family.bursts.size = -1", "0"]),
        ("family.bursts={each=1}", ["family.bursts.each = 1", "boolean"]),
        ("family.landmark_bursts={rate=2}", ["family.landmark_bursts.rate = 2", "1"]),
        ("family.landmark_bursts=3", ["family.landmark_bursts = 3", "off", "table", "each"]),
        ("family.noise_jumps={factor=[0, 1]}", ["family.noise_jumps.factor.0 = 0", "1e-09"]),
        ("family.noise_jumps={factor=[2, 1]}", ["family.noise_jumps.factor = [2.0, 1.0]"]),
        ("family.noise_jumps={size=1}", ["family.noise_jumps.size", "factor"]),
        (
            "family.landmarks_in_turn={duration=[0, 1]}",
            ["family.landmarks_in_turn.duration.0 = 0", "0.1"],
        ),
        ("family.landmarks_in_turn={begin=-1}", ["family.landmarks_in_turn.begin = -1", "0"]),
        ("family.jumps={angle=[0, 181]}", ["family.jumps.angle.1 = 181", "180"]),
        ("family.jumps={distance=[2, 1]}", ["family.jumps.distance = [2.0, 1.0]"]),
        ("family.jumps={rate=nan}", ["family.jumps.rate = nan"]),
        ("family.velocity_bias=-1", ["family.velocity_bias", "-1", "0"]),
        ("family.angular_velocity_bias=on", ["family.angular_velocity_bias", "off"]),
        ("scenario.vectors.0.period=0", ["scenario.vectors.0.period = 0", "1"]),
        ("scenario.vectors.0.begin=-0.5", ["scenario.vectors.0.begin = -0.5", "0"]),
        # not finite, out of range
        ("filter.vector_bias_gain=-1", ["filter.vector_bias_gain = -1", "0"]),
        ("filter.vector_bias_leak=nan", ["filter.vector_bias_leak = nan", "finite"]),
        ("filter.vector_bias_bound=0", ["filter.vector_bias_bound = 0", "1e-09"]),
        ("filter.excitation=0", ["filter.excitation = 0", "1e-09"]),
        ("filter.excitation_time=-1", ["filter.excitation_time = -1", "0"]),
        ("scenario.landmark_period=0", ["scenario.landmark_period = 0", "1"]),
        ("scenario.velocity_drift=-1", ["scenario.velocity_drift = -1", "0"]),
        ("scenario.rest=[[2.0, 1.0]]", ["scenario.rest.0 = [2.0, 1.0]", "beginning", "end"]),
        ("family.rest_share=1.5", ["family.rest_share = 1.5", "1"]),
        ("family.vector_bias=-0.1", ["family.vector_bias", "-0.1", "0"]),
        ("filter.gamma=nan", ["filter.gamma = nan", "finite", "array"]),
        ("scenario.duration=inf", ["scenario.duration = inf", "finite"]),
        ("filter.gamma=-1", ["filter.gamma = -1", "0"]),
        ("filter.gamma=[1, -2]", ["filter.gamma.1 = -2", "0"]),
        ("filter.gamma=[1, 2, 3]", ["filter.gamma = [1, 2, 3]", "at most 2"]),
        ("filter.substeps=0", ["filter.substeps = 0", "1"]),
        ("filter.gain_limit=0", ["filter.gain_limit = 0", "1e-09", "off"]),
        ("run.seed=4294967296", ["run.seed = 4294967296", "4294967295"]),
        ("run.seed=-1", ["run.seed = -1", "0"]),
        ("run.training_scenarios=0", ["run.training_scenarios = 0", "1"]),
        ("fuzzy.sampled_points=2", ["fuzzy.sampled_points = 2", "3"]),
        ("search.agents=1", ["search.agents = 1", "2"]),
        ("search.final_percent=-1", ["search.final_percent = -1", "0"]),
        ("search.final_percent=101", ["search.final_percent = 101", "100"]),
        # negative noise
        ("scenario.angular_velocity_noise=-0.1", ["scenario.angular_velocity_noise = -0.1", "0"]),
        ("scenario.vectors.1.noise=-1", ["scenario.vectors.1.noise = -1", "0"]),
        ("scenario.landmarks.0.weight=-1", ["scenario.landmarks.0.weight = -1", "0"]),
        # words
        ("filter.law=gradeint", ['filter.law = "gradeint"', "did you mean 'gradient'"]),
        ("filter.law=Printed", ['filter.law = "Printed"', "did you mean 'printed'"]),
        ("fuzzy.rules.0.3=V", ['fuzzy.rules.0.3 = "V"', "VS", "S", "M", "L", "VL"]),
        ("fuzzy.rules=best", ['fuzzy.rules = "best"', "array", "searched"]),
        # lengths
        ("scenario.velocity_bias=[1, 2]", ["scenario.velocity_bias.2", "missing"]),
        (
            "scenario.velocity_bias=[1, 2, 3, 4]",
            ["scenario.velocity_bias = [1, 2, 3, 4]", "at most 3"],
        ),
        ("parameters.lower=[0, 0]", ["parameters.lower = [0, 0]", "at least 22"]),
        ("scenario.velocity=[[], []]", ["scenario.velocity.2", "missing"]),
        # rotations
        (
            "scenario.initial_rotation=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]",
            ["[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]", "determinant", "1e-06"],
        ),
        (
            "scenario.initial_rotation.0.0=1.00001",
            ["scenario.initial_rotation = [[1.00001", "rotation matrix"],
        ),
        (
            "scenario.initial_rotation=[[1, 0, 0], [0, 1, 0], [0, 0.9, 1]]",
            ["scenario.initial_rotation", "rotation matrix"],
        ),
        (
            "scenario.initial_rotation_estimate=[[1, 0, 0], [0, 0.8, 0], [0, 0, 1]]",
            ["scenario.initial_rotation_estimate", "rotation matrix", "0.1"],
        ),
        (
            "scenario.initial_rotation_estimate=[[-1, 0, 0], [0, -1, 0], [0, 0, -1]]",
            ["scenario.initial_rotation_estimate", "determinant"],
        ),
        (
            "scenario.initial_rotation_estimate=[[1e9, 0, 0], [0, 1e9, 0], [0, 0, 1e9]]",
            ["scenario.initial_rotation_estimate", "rotation matrix"],
        ),
        (
            "scenario.initial_rotation_estimate=[[1e308, 0, 0], [0, 1, 0], [0, 0, 1]]",
            ["scenario.initial_rotation_estimate.0.0 = 1e+308", "1000000000"],
        ),
        # zero vectors
        (
            "scenario.vectors.0.direction=[0, 0, 0]",
            ["scenario.vectors.0.direction = [0.0, 0.0, 0.0]", "not zero"],
        ),
        ("scenario.vectors.1.direction=[0, 0, 1e-13]", ["[0.0, 0.0, 1e-13]", "not zero"]),
        # samples and windows
        ("scenario.duration=5.005", ["scenario.duration = 5.005", "2 to 10000000", "500.5"]),
        ("scenario.duration=0.01", ["scenario.duration = 0.01", "2 to 10000000"]),
        ("scenario.duration=1e308", ["scenario.duration = 1e+308", "1000000000"]),
        ("scenario.duration=1e9", ["scenario.duration = 1000000000.0", "1e+11"]),
        ("search.iterations=1000001", ["search.iterations = 1000001", "1000000"]),
        (
            "scenario.duration=10",
            ["cost.steady_window = [400, 5900]", "0 to 999", "scenario.duration = 10.0"],
        ),
        ("cost.transient_window=[9, 8]", ["cost.transient_window = [9, 8]"]),
        ("cost.transient_window=[-1, 8]", ["cost.transient_window.0 = -1", "0"]),
        # inference
        ("fuzzy.ordering=false", ['fuzzy.centroid = "exact"', "sampled", "ordering = false"]),
        ("fuzzy.ordering=false", ["fuzzy.coverage = true", "false", "ordering = false"]),
        # boxes
        ("parameters.lower.4=0.3", ["parameters.lower.4 = 0.3", "k5"]),
        ("parameters.upper.0=1.5", ["parameters.upper.0 = 1.5", "k1"]),
        ("parameters.upper.20=101", ["parameters.upper.20 = 101.0", "0.0 to 100.0"]),
        ("parameters.gain_range=[9, 9]", ["parameters.gain_range = [9.0, 9.0]"]),
        ("parameters.lower.7=0.01", ["parameters.lower.4 = 0.05", "k5", "k8"]),
        ("parameters.upper.1=0.3", ["parameters.upper.1 = 0.3", "k2", "k3"]),
        ("parameters.lower.14=35", ["k15", "upper.14 = 30.0"]),
        ("parameters.lower.7=0.15", ["parameters.lower.7 = 0.15", "k8", "k7", "at most 0.1"]),
    ],
)
def test_a_bad_value_is_named_with_what_is_allowed(setting: str, facts: list[str]) -> None:
    assert_states(setting_refusal(setting), *facts)


@pytest.mark.parametrize(
    ("setting", "facts"),
    [
        ("filter.substep=3", ["filter.substep", "did you mean filter.substeps"]),
        ("fliter.substeps=3", ["fliter", "did you mean filter"]),
        ("gain.Signal=pose", ["gain.Signal", "did you mean gain.signal"]),
        ("family.outages={rat=1}", ["did you mean family.outages.rate"]),
        ("filter.agents=3", ["filter.agents", "did you mean search.agents"]),
        ("scenario.vectors.0.nose=3", ["did you mean scenario.vectors.0.noise"]),
        ("filter.normalize_vectors=false", ["did you mean filter.normalise_vectors"]),
        ("run.x=3", ["run.x", "seed", "dtype", "training_scenarios", "held_out_scenarios"]),
        ("x.y=3", ["x", "run", "scenario", "family", "filter"]),
    ],
)
def test_a_misspelt_key_gets_the_nearest(setting: str, facts: list[str]) -> None:
    assert_states(setting_refusal(setting), *facts)


def test_missing_keys_and_wrong_tables_are_named() -> None:
    text = refusal(from_dict, {"run": 3, "scenario": {"landmarks": [{"positon": [1, 2, 3]}]}})
    assert_states(text, "run = 3", "table", "seed", "dtype")
    assert_states(text, "scenario.landmarks.0.position missing")
    assert_states(
        text, "scenario.landmarks.0.positon", "did you mean scenario.landmarks.0.position"
    )
    assert_states(refusal(from_dict, {"search": []}), "search = []", "table", "optimiser")


def test_all_problems_are_listed() -> None:
    text = setting_refusal("filter.substeps=0", "run.seed=-1", "gain.signl=pose", "fuzzy.overlap=x")
    for key in ("filter.substeps = 0", "run.seed = -1", "gain.signl", 'fuzzy.overlap = "x"'):
        assert key in text


@pytest.mark.parametrize("data", [[1], "run", None])
def test_what_is_not_a_table_of_sections_is_refused(data: Any) -> None:
    assert_states(refusal(from_dict, data), "table", "run", "scenario", "family", "filter")


def test_sections_made_in_python_refuse_the_same() -> None:
    assert_states(refusal(config.ObserverConfig, substeps=0), "substeps = 0", "1")
    assert_states(refusal(Experiment, filter={"substeps": 0}), "filter.substeps = 0", "1")
    short = config.ScenarioConfig(duration=5.0)
    assert "cost.steady_window = [400, 5900]" in refusal(Experiment, scenario=short)


def test_a_huge_value_is_cut_short() -> None:
    text = setting_refusal(f"parameters.lower=[{', '.join(['0.125'] * 1000)}]")
    assert len(text) < 400
    assert "..." in text


# Observability through the configuration ----------------------------------------------------------

ALONG = {"direction": [1.0, -1.0, 1.0]}
AGAINST = {"direction": [-2.0, 2.0, -2.0]}
UP = {"direction": [0.0, 0.0, 1.0]}
UNUSED = {"direction": [0.0, 0.0, 1.0], "weight": 0.0}


def points(*positions: tuple[float, float, float]) -> list[dict[str, Any]]:
    return [{"position": list(position)} for position in positions]


def sensors(vectors: list[Any], landmarks: list[Any], cross: bool = False) -> dict[str, Any]:
    scenario = {"vectors": vectors, "landmarks": landmarks}
    also: dict[str, Any] = {"also": []}  # which further numbers can be tuned depends on the sensors
    return {"scenario": scenario, "filter": {"cross_vector": cross}, "parameters": also}


@pytest.mark.parametrize(
    "data",
    [
        sensors([ALONG, UP], points((1, 2, 3))),
        sensors([ALONG, UP], points((1, 2, 3)), cross=True),
        sensors([UP], points((0, 0, 0), (1, 0, 0))),
        sensors([ALONG, AGAINST], points((0, 0, 0), (1, 0, 0))),
        sensors([], points((0, 0, 0), (1, 0, 0), (0, 1, 0))),
        sensors([UP], points((0, 0, 0), (1, 0, 1), (2, 0, 2))),
        sensors([ALONG, UNUSED], points((0, 0, 0)), cross=True),  # v_1 and v_1 x v_2
    ],
)
def test_observable_sensors_are_accepted(data: dict[str, Any]) -> None:
    from_dict(data)


@pytest.mark.parametrize(
    ("data", "found"),
    [
        (sensors([ALONG, UP], []), "2 vectors and no landmarks"),
        (sensors([ALONG], points((1, 2, 3))), "1 vector and 1 landmark"),
        (sensors([ALONG, AGAINST], points((1, 2, 3))), "2 collinear vectors and 1 landmark"),
        (sensors([ALONG, UNUSED], points((1, 2, 3))), "1 vector and 1 landmark"),
        (sensors([UP], points((1, 1, 1), (1, 1, 5))), "2 landmarks, all parallel"),
        (sensors([UP], points((1, 1, 1), (1, 1, 1))), "2 landmarks at one point"),
        (sensors([], points((0, 0, 0), (1, 0, 1), (3, 0, 3))), "3 landmarks on one line"),
        (sensors([], points((0, 0, 0), (1, 0, 1))), "no vectors and 2 landmarks"),
    ],
)
def test_unobservable_sensors_are_refused(data: dict[str, Any], found: str) -> None:
    text = refusal(from_dict, data)
    assert "not observable" in text
    assert found in text


@pytest.mark.parametrize("vectors", [[], [UP], [ALONG, AGAINST]])
def test_a_cross_product_needs_two_directions(vectors: list[Any]) -> None:
    data = sensors(vectors, points((0, 0, 0), (1, 0, 0), (0, 1, 0)), cross=True)
    assert_states(refusal(from_dict, data), "filter.cross_vector = true", "false", "two vectors")


# Files --------------------------------------------------------------------------------------------


def written(folder: Path, content: bytes) -> Path:
    path = folder / "experiment.toml"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("content", "facts"),
    [
        (b"[run]\nseed =\n", ["line 2", "column 7", "TOML"]),
        (b"[run\nseed = 3\n", ["line 1", "column 5", "TOML"]),
        (b"[run", ["line 1", "column 5", "TOML"]),
        (b'\n\na = "', ["line 3", "column 6", "TOML"]),
        (b"[run]\nseed = 1\nseed = 2\n", ["line 3", "column 9", "TOML"]),
        (b"a\tb\x01", ["line 1", "column 3", "TOML"]),
        (b"[run]\r\nseed = x", ["line 2", "column 8", "TOML"]),
        (b"[run]\n# \xff\n", ["line 2", "UTF-8"]),
        (b"x = " + b"[" * 100_000, ["TOML", "too deep"]),
        (b"x = " + b"9" * 5000, ["TOML", "too long"]),
        (b"#" * (2**20 + 1), ["too large", "1 MiB"]),
        (b"[filter]\nsubsteps = 0", ["filter.substeps = 0", "1"]),
    ],
)
def test_a_bad_file_is_named_with_its_place(
    tmp_path: Path, content: bytes, facts: list[str]
) -> None:
    path = written(tmp_path, content)
    text = refusal(load, path)
    assert text.startswith(str(path))
    assert_states(text.removeprefix(str(path)), *facts)


def test_paths_that_are_no_file_are_refused(tmp_path: Path) -> None:
    assert "No such file" in refusal(load, tmp_path / "none.toml")
    assert "Is a directory" in refusal(load, tmp_path)
    assert "cannot be read" in refusal(load, written(tmp_path, b"") / "below")
    assert "cannot be read" in refusal(load, "a\0b")


def test_a_file_without_rights_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*arguments: Any, **keywords: Any) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", denied)
    assert_states(refusal(load, tmp_path / "secret.toml"), "secret.toml", "Permission denied")


# Settings from the command line -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "facts"),
    [
        ("filter.substeps", ["filter.substeps", "section.key=value"]),
        ("filter.substeps=", ["section.key=value"]),
        ("substeps=3", ["substeps=3", "section.key=value"]),
        ("=3", ["section.key=value"]),
        ("filter..substeps=3", ["section.key=value"]),
        ("run.seed=1\nx = 2", ["TOML"]),
        ("run.seed=[1", ['run.seed = "[1"', "TOML"]),
        ("gain.signal=a b", ['gain.signal = "a b"', "TOML"]),
        ("run.seed=" + "[" * 5000, ["TOML"]),
        ("run.seed.x=3", ["run.seed.x = 3", "single value"]),
        ("scenario.vectors.2.noise=3", ["scenario.vectors", "array of 2"]),
        ("scenario.vectors.-1.noise=3", ["scenario.vectors", "array of 2", "-1"]),
        ("scenario.vectors.first.noise=3", ["scenario.vectors", "array of 2", "first"]),
    ],
)
def test_a_setting_that_cannot_be_applied_is_refused(setting: str, facts: list[str]) -> None:
    assert_states(setting_refusal(setting), *facts)
