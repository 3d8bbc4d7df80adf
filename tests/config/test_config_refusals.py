from pathlib import Path
from typing import Any

import pytest
from helpers.experiments import BASE

import posegsa.config as config
from posegsa.config import Experiment, from_dict, load, override
from posegsa.errors import ConfigError

pytestmark = pytest.mark.quick


def refusal(function: Any, *arguments: Any, **keywords: Any) -> str:
    """The text of the ConfigError that a call raises, its line breaks undone."""
    with pytest.raises(ConfigError) as caught:
        function(*arguments, **keywords)
    text = str(caught.value)
    assert "pydantic" not in text
    assert "type=" not in text
    assert caught.value.__cause__ is None
    return " ".join(text.split())


def setting_refusal(*texts: str) -> str:
    return refusal(override, override(Experiment(), BASE), texts)


# Values: the key, the value, what is allowed -----------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "key_and_value", "allowed"),
    [
        # wrong types
        ("run.seed=true", "run.seed = true", "should be a valid integer"),
        ("run.seed=1.0", "run.seed = 1.0", "should be a valid integer"),
        ('run.seed="1"', 'run.seed = "1"', "should be a valid integer"),
        ("scenario.duration=true", "scenario.duration = true", "should be a valid number"),
        ('scenario.duration="15"', 'scenario.duration = "15"', "should be a valid number"),
        ("filter.cross_vector=1", "filter.cross_vector = 1", "should be a valid boolean"),
        ("filter.cross_vector=yes", 'filter.cross_vector = "yes"', "should be a valid boolean"),
        ("scenario.vectors=3", "scenario.vectors = 3", "should be an array"),
        ("scenario.vectors.0=3", "scenario.vectors.0 = 3", "a table with the keys direction, bias"),
        ("filter.law=1979-05-27", "filter.law = 1979-05-27", "'gradient' or 'printed'"),
        ("search.random=true", "search.random = true", "'dimension' or 'agent'"),
        (
            "filter.gamma_law=cubic",
            'filter.gamma_law = "cubic"',
            "'fixed', 'linear' or 'quadratic'",
        ),
        ("filter.vector_bias=on", 'filter.vector_bias = "on"', "'off' or 'estimated'"),
        ("gain.rate=slow", 'gain.rate = "slow"', "'per_sample' or 'per_second'"),
        ("family.outages=often", 'family.outages = "often"', "'off'"),
        ("family.outages.sensors=all", "family.outages is a single value", "it has no sensors"),
        ("family.outages={rate=-1}", "family.outages.rate = -1", "greater than or equal to 0"),
        (
            "family.bursts={duration=[5, 1]}",
            "family.bursts.duration = [5.0, 1.0]",
            "a first value that is not above the second",
        ),
        # not finite, out of range
        (
            "filter.vector_bias_gain=-1",
            "filter.vector_bias_gain = -1",
            "greater than or equal to 0",
        ),
        ("filter.vector_bias_leak=nan", "filter.vector_bias_leak = nan", "a finite number"),
        ("filter.vector_bias_bound=0", "filter.vector_bias_bound = 0", "equal to 1e-09"),
        ("filter.excitation=0", "filter.excitation = 0", "equal to 1e-09"),
        ("filter.excitation_time=-1", "filter.excitation_time = -1", "greater than or equal to 0"),
        (
            "scenario.landmark_period=0",
            "scenario.landmark_period = 0",
            "greater than or equal to 1",
        ),
        (
            "scenario.velocity_drift=-1",
            "scenario.velocity_drift = -1",
            "greater than or equal to 0",
        ),
        (
            "scenario.rest=[[2.0, 1.0]]",
            "scenario.rest.0 = [2.0, 1.0]",
            "a beginning before the end",
        ),
        ("family.rest_share=1.5", "family.rest_share = 1.5", "less than or equal to 1"),
        ("family.vector_bias=-0.1", "family.vector_bias", "greater than or equal to 0"),
        ("filter.gamma=nan", "filter.gamma = nan", "a finite number, or should be an array"),
        ("scenario.duration=inf", "scenario.duration = inf", "should be a finite number"),
        ("filter.gamma=-1", "filter.gamma = -1", "greater than or equal to 0"),
        ("filter.gamma=[1, -2]", "filter.gamma.1 = -2", "greater than or equal to 0"),
        (
            "filter.gamma=[1, 2, 3]",
            "filter.gamma = [1, 2, 3]",
            "should have at most 2 items, not 3",
        ),
        ("filter.substeps=0", "filter.substeps = 0", "greater than or equal to 1"),
        (
            "filter.gain_limit=0",
            "filter.gain_limit = 0",
            "should be greater than or equal to 1e-09, or should be 'off'",
        ),
        ("run.seed=4294967296", "run.seed = 4294967296", "less than or equal to 4294967295"),
        ("run.seed=-1", "run.seed = -1", "greater than or equal to 0"),
        ("run.training_scenarios=0", "run.training_scenarios = 0", "greater than or equal to 1"),
        ("fuzzy.sampled_points=2", "fuzzy.sampled_points = 2", "greater than or equal to 3"),
        ("search.agents=1", "search.agents = 1", "greater than or equal to 2"),
        ("search.final_percent=-1", "search.final_percent = -1", "greater than or equal to 0"),
        ("search.final_percent=101", "search.final_percent = 101", "less than or equal to 100"),
        # negative noise
        (
            "scenario.angular_velocity_noise=-0.1",
            "scenario.angular_velocity_noise = -0.1",
            "greater than or equal to 0",
        ),
        (
            "scenario.vectors.1.noise=-1",
            "scenario.vectors.1.noise = -1",
            "greater than or equal to 0",
        ),
        (
            "scenario.landmarks.0.weight=-1",
            "scenario.landmarks.0.weight = -1",
            "than or equal to 0",
        ),
        # words
        ("filter.law=gradeint", 'filter.law = "gradeint"', "did you mean 'gradient'?"),
        ("filter.law=Printed", 'filter.law = "Printed"', "did you mean 'printed'?"),
        ("fuzzy.rules.0.3=V", 'fuzzy.rules.0.3 = "V"', "'VS', 'S', 'M', 'L' or 'VL'"),
        ("fuzzy.rules=best", 'fuzzy.rules = "best"', "an array, or should be 'searched'"),
        # lengths
        ("scenario.velocity_bias=[1, 2]", "scenario.velocity_bias.2", "missing"),
        ("scenario.velocity_bias=[1, 2, 3, 4]", "velocity_bias = [1, 2, 3, 4]", "at most 3 items"),
        ("parameters.lower=[0, 0]", "parameters.lower = [0, 0]", "at least 22 items"),
        ("scenario.velocity=[[], []]", "scenario.velocity.2", "missing"),
        # rotations
        (
            "scenario.initial_rotation=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]",
            "scenario.initial_rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]",
            "a rotation matrix: determinant above 0, all singular values equal to 1 within 1e-06",
        ),
        (
            "scenario.initial_rotation.0.0=1.00001",
            "scenario.initial_rotation = [[1.00001, ",
            "a rotation matrix",
        ),
        (
            "scenario.initial_rotation=[[1, 0, 0], [0, 1, 0], [0, 0.9, 1]]",
            "scenario.initial_rotation = ",
            "a rotation matrix",
        ),
        (
            "scenario.initial_rotation_estimate=[[1, 0, 0], [0, 0.8, 0], [0, 0, 1]]",
            "scenario.initial_rotation_estimate = ",
            "within 0.1",
        ),
        (
            "scenario.initial_rotation_estimate=[[-1, 0, 0], [0, -1, 0], [0, 0, -1]]",
            "scenario.initial_rotation_estimate = ",
            "determinant above 0",
        ),
        (
            "scenario.initial_rotation_estimate=[[1e9, 0, 0], [0, 1e9, 0], [0, 0, 1e9]]",
            "scenario.initial_rotation_estimate = ",
            "a rotation matrix",
        ),
        (
            "scenario.initial_rotation_estimate=[[1e308, 0, 0], [0, 1, 0], [0, 0, 1]]",
            "scenario.initial_rotation_estimate.0.0 = 1e+308",
            "less than or equal to 1000000000",
        ),
        # zero vectors
        (
            "scenario.vectors.0.direction=[0, 0, 0]",
            "scenario.vectors.0.direction = [0.0, 0.0, 0.0]",
            "a vector that is not zero",
        ),
        ("scenario.vectors.1.direction=[0, 0, 1e-13]", "[0.0, 0.0, 1e-13]", "not zero"),
        # samples and windows
        (
            "scenario.duration=5.005",
            "scenario.duration = 5.005",
            "a whole number of samples, 2 to 10000000; with sampling_time = 0.01 these are 500.5",
        ),
        ("scenario.duration=0.01", "scenario.duration = 0.01", "2 to 10000000"),
        (
            "scenario.duration=1e308",
            "scenario.duration = 1e+308",
            "less than or equal to 1000000000",
        ),
        ("scenario.duration=1e9", "scenario.duration = 1000000000.0", "these are 1e+11"),
        (
            "search.iterations=1000001",
            "search.iterations = 1000001",
            "less than or equal to 1000000",
        ),
        (
            "scenario.duration=10",
            "cost.steady_window = [400, 5900]",
            "samples 0 to 999, as scenario.duration = 10.0 and scenario.sampling_time = 0.01 make",
        ),
        ("cost.transient_window=[9, 8]", "cost.transient_window = [9, 8]", "not above the second"),
        (
            "cost.transient_window=[-1, 8]",
            "cost.transient_window.0 = -1",
            "greater than or equal to 0",
        ),
        # inference
        ("fuzzy.ordering=false", 'fuzzy.centroid = "exact"', '"sampled", because ordering = false'),
        ("fuzzy.ordering=false", "fuzzy.coverage = true", "false, because ordering = false"),
        # boxes
        ("parameters.lower.4=0.3", "parameters.lower.4 = 0.3", "k5 has low > high; allowed: at m"),
        ("parameters.upper.0=1.5", "parameters.upper.0 = 1.5", "k1 is out of its universe; allow"),
        ("parameters.upper.20=101", "parameters.upper.20 = 101", "allowed: 0.0 to 100.0"),
        ("parameters.gain_range=[9, 9]", "parameters.gain_range = [9.0, 9.0]", "a lower end below"),
        ("parameters.lower.7=0.01", "parameters.lower.4 = 0.05", "k5 comes before k8, whose lower"),
        ("parameters.upper.1=0.3", "parameters.upper.1 = 0.3", "k2 comes before k3, whose upper"),
        ("parameters.lower.14=35", "k15 has low > high", "at most upper.14 = 30"),
        (
            "parameters.lower.7=0.15",
            "parameters.lower.7 = 0.15",
            "k8 has to come down to k7 to close a gap; allowed: at most 0.1, the lower bound of k7",
        ),
    ],
)
def test_a_bad_value_is_named_with_what_is_allowed(
    setting: str, key_and_value: str, allowed: str
) -> None:
    text = setting_refusal(setting)
    assert key_and_value in text
    assert allowed in text


@pytest.mark.parametrize(
    ("setting", "hint"),
    [
        ("filter.substep=3", "filter.substep unknown key; did you mean filter.substeps?"),
        ("fliter.substeps=3", "fliter unknown key; did you mean filter?"),
        ("gain.Signal=pose", "gain.Signal unknown key; did you mean gain.signal?"),
        ("family.outages={rat=1}", "did you mean family.outages.rate?"),
        ("filter.agents=3", "filter.agents unknown key; did you mean search.agents?"),
        ("scenario.vectors.0.nose=3", "did you mean scenario.vectors.0.noise?"),
        ("filter.normalize_vectors=false", "did you mean filter.normalise_vectors?"),
        ("run.x=3", "known here: seed, dtype, training_scenarios, held_out_scenarios"),
        ("x.y=3", "known here: run, scenario, family, filter"),
    ],
)
def test_a_misspelt_key_gets_the_nearest(setting: str, hint: str) -> None:
    assert hint in setting_refusal(setting)


def test_missing_keys_and_wrong_tables_are_named() -> None:
    text = refusal(from_dict, {"run": 3, "scenario": {"landmarks": [{"positon": [1, 2, 3]}]}})
    assert "run = 3 should be a table with the keys seed, dtype" in text
    assert "scenario.landmarks.0.position missing" in text
    assert "search = [] should be a table with the keys optimiser" in refusal(
        from_dict, {"search": []}
    )
    assert "landmarks.0.positon unknown key; did you mean scenario.landmarks.0.position?" in text


def test_all_problems_are_listed() -> None:
    text = setting_refusal("filter.substeps=0", "run.seed=-1", "gain.signl=pose", "fuzzy.overlap=x")
    for key in ("filter.substeps = 0", "run.seed = -1", "gain.signl", 'fuzzy.overlap = "x"'):
        assert key in text


@pytest.mark.parametrize("data", [[1], "run", None])
def test_what_is_not_a_table_of_sections_is_refused(data: Any) -> None:
    assert "a table with the keys run, scenario, family, filter" in refusal(from_dict, data)


def test_sections_made_by_hand_say_the_same() -> None:
    assert "substeps = 0 should be greater than or equal to 1" in refusal(
        config.FilterConfig, substeps=0
    )
    text = refusal(Experiment, filter={"substeps": 0})
    assert "filter.substeps = 0 should be greater than or equal to 1" in text
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
    also: dict[str, Any] = {"also": []}  # what may be tuned too depends on the sensors
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
        sensors([ALONG, UNUSED], points((0, 0, 0)), cross=True),  # v_1 and v_1 x v_2 are two
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
    assert "the pose is not observable" in text
    assert found in text
    assert "needed are two non-collinear vectors and a landmark" in text


@pytest.mark.parametrize("vectors", [[], [UP], [ALONG, AGAINST]])
def test_a_cross_product_needs_two_directions(vectors: list[Any]) -> None:
    data = sensors(vectors, points((0, 0, 0), (1, 0, 0), (0, 1, 0)), cross=True)
    assert "filter.cross_vector = true allowed: false, or two vectors" in refusal(from_dict, data)


# Files --------------------------------------------------------------------------------------------


def written(folder: Path, content: bytes) -> Path:
    path = folder / "experiment.toml"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"[run]\nseed =\n", "line 2, column 7: not valid TOML: Invalid value seed = ^"),
        (b"[run\nseed = 3\n", "line 1, column 5: not valid TOML: Expected ']'"),
        (b"[run", "line 1, column 5: not valid TOML"),
        (b'\n\na = "', "line 3, column 6: not valid TOML"),
        (b"[run]\nseed = 1\nseed = 2\n", "line 3, column 9: not valid TOML: Cannot overwrite"),
        (b"a\tb\x01", "line 1, column 3: not valid TOML"),
        (b"[run]\r\nseed = x", "line 2, column 8: not valid TOML"),
        (b"[run]\n# \xff\n", "line 2: not UTF-8 text"),
        (b"x = " + b"[" * 100_000, "not valid TOML: a number too long or arrays too deep"),
        (b"x = " + b"9" * 5000, "not valid TOML: a number too long or arrays too deep"),
        (b"#" * (2**20 + 1), "too large; allowed: at most 1 MiB"),
        (b"[filter]\nsubsteps = 0", "filter.substeps = 0 should be greater than or equal to 1"),
    ],
)
def test_a_bad_file_is_named_with_its_place(tmp_path: Path, content: bytes, message: str) -> None:
    path = written(tmp_path, content)
    text = refusal(load, path)
    assert text.startswith(str(path))
    assert message in text


def test_paths_that_are_no_file_are_refused(tmp_path: Path) -> None:
    assert "cannot be read as a TOML file: No such file" in refusal(load, tmp_path / "none.toml")
    assert "cannot be read as a TOML file: Is a directory" in refusal(load, tmp_path)
    assert "cannot be read" in refusal(load, written(tmp_path, b"") / "below")
    assert "cannot be read" in refusal(load, "a\0b")


def test_a_file_without_rights_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*arguments: Any, **keywords: Any) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", denied)
    assert "cannot be read as a TOML file: Permission denied" in refusal(
        load, tmp_path / "secret.toml"
    )


# Settings from the command line -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("filter.substeps", "filter.substeps allowed: section.key=value"),
        ("filter.substeps=", "allowed: section.key=value"),
        ("substeps=3", "substeps=3 allowed: section.key=value"),
        ("=3", "allowed: section.key=value"),
        ("filter..substeps=3", "allowed: section.key=value"),
        ("run.seed=1\nx = 2", "allowed: a value as TOML writes it"),
        ("run.seed=[1", 'run.seed = "[1" allowed: a value as TOML writes it'),
        ("gain.signal=a b", 'gain.signal = "a b" allowed: a value as TOML writes it'),
        ("run.seed=" + "[" * 5000, "allowed: a value as TOML writes it"),
        ("run.seed.x=3", "run.seed.x = 3 run.seed is a single value; it has no x"),
        ("scenario.vectors.2.noise=3", "scenario.vectors is an array of 2; it has no 2"),
        ("scenario.vectors.-1.noise=3", "scenario.vectors is an array of 2; it has no -1"),
        ("scenario.vectors.first.noise=3", "scenario.vectors is an array of 2; it has no first"),
    ],
)
def test_a_setting_that_cannot_be_applied_is_refused(setting: str, message: str) -> None:
    assert message in setting_refusal(setting)
