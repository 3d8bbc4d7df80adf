import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel

import posegsa.config as config
from posegsa.config import Experiment, from_dict, load, override, to_toml
from posegsa.config.tunable import with_numbers
from posegsa.errors import ConfigError, PosegsaError, RunFolderError
from posegsa.optimisers import CMAES, GSA, OPTIMISERS, Adam, DifferentialEvolution, Optimiser

pytestmark = pytest.mark.quick

CONFIGS = Path(__file__).parent.parent.parent / "configs"
FILES = sorted(CONFIGS.glob("*.toml"))
WHOLE = ("paper", "paper_literal", "observer")
PI = 3.141592653589793


def leaves(data: Any, path: str = "") -> dict[str, Any]:
    """All values of nested plain data by dotted path."""
    if isinstance(data, dict):
        items = data.items()
    elif isinstance(data, list | tuple):
        items = enumerate(data)
    else:
        return {path: data}
    return {k: v for key, part in items for k, v in leaves(part, f"{path}.{key}").items()}


def written(folder: Path, content: bytes) -> Path:
    path = folder / "experiment.toml"
    path.write_bytes(content)
    return path


# The files in configs/ ----------------------------------------------------------------------------


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_file_loads(path: Path) -> None:
    assert isinstance(load(path), Experiment)
    assert load(str(path)) == load(path)


SHIPPED_ON = {"filter.length_growth": 0.1, "filter.bias_wait": 0.3, "gain.unknown": 0.5}
"""Settings of observer.toml that are off by default."""
OFF = dict.fromkeys(SHIPPED_ON, "off")


def test_the_observer_file_holds_the_defaults_except_for_what_is_off_by_default() -> None:
    observer, default = load(CONFIGS / "observer.toml"), Experiment()
    assert observer.tuned.numbers
    on = with_numbers(default.model_dump(mode="json"), SHIPPED_ON)
    assert observer.replace(tuned=config.TunedConfig()) == from_dict(on)
    off = leaves(default.model_dump())
    assert {key: off[f".{key}"] for key in SHIPPED_ON} == OFF


@pytest.mark.parametrize("name", WHOLE)
def test_files_write_every_value_out(name: str) -> None:
    written = tomllib.loads((CONFIGS / f"{name}.toml").read_text("utf-8"))
    everything = load(CONFIGS / f"{name}.toml").model_dump()
    assert leaves(written).keys() == leaves(everything).keys()
    # Empty lists have no leaves.
    assert set(written["parameters"]) == set(everything["parameters"])


def changes(name: str, base: str = "observer") -> dict[str, Any]:
    """The values in which a file differs from another, by default the observer's.

    Without the numbers of its last tuning, in which all differ.
    """
    default = leaves(load(CONFIGS / f"{base}.toml").model_dump())
    return {
        key.removeprefix("."): value
        for key, value in leaves(load(CONFIGS / f"{name}.toml").model_dump()).items()
        if value != default.get(key) and not key.startswith(".tuned.")
    }


ONE_START = {
    "scenario.duration": 15.0,
    "family.attitude_error": "off",
    "family.position_error": "off",
    "family.random_phase": False,
    "cost.steady_window.1": 1400,
}


def test_the_paper_is_one_scenario_and_its_own_filter_and_search() -> None:
    changed = changes("paper")
    search = {key: value for key, value in changed.items() if key.startswith("search.")}
    assert (
        search.items()
        >= {
            "search.optimiser": "gsa",
            "search.agents": 100,
            "search.iterations": 250,
        }.items()
    )
    assert {key: value for key, value in changed.items() if key not in search} == {
        **ONE_START,
        **OFF,
        "run.training_scenarios": 1,
        "filter.gamma": 5.0,
        "filter.gamma_law": "fixed",
        "filter.substeps": 1,
        "filter.cross_vector_weight": 1.0,
        "filter.vector_bias": "off",
        "gain.smoothing": 0.0,
        "gain.error_scale": 1.0,
    }
    assert load(CONFIGS / "paper.toml").parameters.also == ()


def test_the_papers_start_is_the_observer_on_the_papers_scenario() -> None:
    assert changes("paper_start") == ONE_START | OFF


def test_the_literal_paper_differs_where_the_paper_says_so() -> None:
    assert changes("paper_literal", "paper") == {
        "filter.normalise_vectors": False,
        "filter.law": "printed",
        "filter.gamma": 1.0,
        "filter.gain_limit": "off",
        "gain.signal": "pose",
        "fuzzy.centroid": "sampled",
        "fuzzy.no_rule": "midrange",
        "fuzzy.coverage": False,
        "search.force_power": 2.0,
        "search.random": "agent",
    }


def test_the_quick_file_only_makes_scenarios_and_search_smaller() -> None:
    changed = changes("quick")
    for key in ("scenario.duration", "cost.steady_window.1"):
        assert changed.pop(key) == ONE_START[key]
    assert changed == {
        **OFF,
        "run.training_scenarios": 4,
        "run.held_out_scenarios": 16,
        "search.agents": 32,
        "search.iterations": 40,
    }


SECTION_13 = {
    "family.angular_velocity_bias": 0.1,
    "family.velocity_bias": 0.3,
    "family.vector_bias": 0.1,
    "family.outages.rate": 0.02,
    "family.outages.sensors": "all",
}
"""What the families of disturbed and of sparse sensors share."""


@pytest.mark.parametrize("name", ["disturbed", "sparse"])
def test_the_hard_families_have_the_papers_sensors_and_motion_and_three_landmarks(name) -> None:
    experiment, default = load(CONFIGS / f"{name}.toml"), Experiment()
    changed = changes(name)
    assert changed.items() >= SECTION_13.items()
    assert experiment.cost == default.cost
    assert experiment.filter.kind == "kalman"
    # A number that is stated is not tuned by default: what is tuned is stated too.
    assert len(experiment.parameters.also) == {"disturbed": 3, "sparse": 10}[name]
    for field in ("angular_velocity", "velocity", "angular_velocity_noise", "velocity_noise"):
        assert getattr(experiment.scenario, field) == getattr(default.scenario, field)
    for vector, paper in zip(experiment.scenario.vectors, default.scenario.vectors, strict=True):
        assert (vector.direction, vector.noise) == (paper.direction, paper.noise)
    assert [landmark.position for landmark in experiment.scenario.landmarks] == [
        (0.5, 1.41, 1.0),
        (-2.0, 1.0, 0.5),
        (1.0, -2.0, 2.0),
    ]


# The types ----------------------------------------------------------------------------------------


def test_motion_sensors_and_boxes_are_the_papers() -> None:
    experiment = Experiment()
    scenario = experiment.scenario
    assert load(CONFIGS / "paper.toml").scenario.samples == 1500
    assert [[(s.amplitude, s.frequency, s.phase) for s in axis] for axis in scenario.velocity] == [
        [(0.3, 0.6, 0.0)],
        [(0.3, 0.4, 0.0)],
        [(0.3, 0.1, 0.0)],
    ]
    assert scenario.angular_velocity[1] == (config.Sine(amplitude=0.7, frequency=0.5, phase=PI),)
    assert scenario.angular_velocity[2][0].phase == pytest.approx(PI / 3)
    assert scenario.vectors[0].direction == pytest.approx([3**-0.5, -(3**-0.5), 3**-0.5])
    assert scenario.landmarks[0].position == pytest.approx([0.5, 2**0.5, 1.0])
    inputs = config.triangles(config.PARAMETERS[:11], "0", "1")
    assert inputs[0] == ("0", "0", "k1")
    assert inputs[1:4] == (("k2", "k3", "k4"), ("k5", "k6", "k7"), ("k8", "k9", "k10"))
    assert inputs[4] == ("k11", "1", "1")
    boxes = experiment.parameters
    low, high = (config.triangles(k[11:], *boxes.gain_range) for k in (boxes.lower, boxes.upper))
    assert low == ((0, 0, 0), (0, 0, 5), (5, 10, 20), (20, 20, 40), (30, 100, 100))
    assert high == ((0, 0, 10), (10, 20, 30), (20, 50, 50), (50, 70, 90), (70, 100, 100))
    assert config.TERMS == ("VS", "S", "M", "L", "VL")


def test_an_experiment_is_frozen_and_hashable() -> None:
    experiment = Experiment()
    assert hash(experiment) == hash(from_dict(experiment.model_dump()))
    with pytest.raises(ValueError, match="frozen"):
        experiment.run.seed = 1


def sections(model: type[BaseModel]) -> set[type[BaseModel]]:
    """The model and all models nested in its fields."""

    def models(annotation: Any) -> set[type[BaseModel]]:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            return sections(annotation)
        parts = getattr(annotation, "__args__", ())
        return {m for part in parts for m in models(part)}

    fields = model.model_fields.values()
    return {model, *(m for field in fields for m in models(field.annotation))}


SECTIONS = sections(Experiment) - {Optimiser} | set(OPTIMISERS.values())


@pytest.mark.parametrize("model", sorted(SECTIONS, key=lambda model: model.__name__))
def test_every_field_is_described(model: type[BaseModel]) -> None:
    for name, field in model.model_fields.items():
        assert field.description, name


def test_the_errors_can_be_caught_as_what_they_are() -> None:
    assert issubclass(ConfigError, PosegsaError)
    assert issubclass(ConfigError, ValueError)
    assert issubclass(RunFolderError, OSError)
    assert str(RunFolderError("runs/a holds another run")) == "runs/a holds another run"


def test_what_a_file_leaves_out_keeps_its_default(tmp_path: Path) -> None:
    assert load(written(tmp_path, b"")) == Experiment()
    byte_order_mark = b"\xef\xbb\xbf[run]\r\nseed = 3\r\n"
    assert load(written(tmp_path, byte_order_mark)) == override(Experiment(), ["run.seed=3"])


# Settings from the command line -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("filter.substeps=4", 4),
        (" filter.substeps = 4 ", 4),
        ("gain.signal=pose", "pose"),
        ('gain.signal="pose"', "pose"),
        ("filter.gain_limit=off", "off"),
        ("filter.gain_limit=2", 2.0),
        ("filter.gamma=[1, 2.5]", (1.0, 2.5)),
        ("scenario.vectors.1.noise=0.2", 0.2),
        ("scenario.initial_rotation_estimate.0.1=0.3", 0.3),
        ("fuzzy.rules.4.4=S", "S"),
        ("fuzzy.coverage=false", False),
        ("cost.steady_window=[300, 1499]", (300, 1499)),
    ],
)
def test_a_setting_changes_one_value(setting: str, value: Any) -> None:
    base = override(Experiment(), ["parameters.also=[]"])  # without gamma, which may become a pair
    changed: Any = override(base, [setting])
    for key in setting.partition("=")[0].strip().split("."):
        changed = changed[int(key)] if key.isdecimal() else getattr(changed, key)
    assert changed == value
    assert type(changed) is type(value)


def test_settings_are_applied_together() -> None:
    literal = ["fuzzy.ordering=false", "fuzzy.coverage=false", "fuzzy.centroid=sampled"]
    assert override(Experiment(), literal).fuzzy.ordering is False
    assert override(Experiment(), []) == Experiment()
    assert override(Experiment(), ["run.seed=1", "run.seed=2"]).run.seed == 2


def test_a_setting_may_hold_a_table() -> None:
    setting = "scenario.landmarks=[{position = [1, 2, 3]}, {position = [0, 0, 1], noise = 0}]"
    assert [mark.noise for mark in override(Experiment(), [setting]).scenario.landmarks] == [0.1, 0]


# Any valid experiment -----------------------------------------------------------------------------

numbers = st.floats(-1e6, 1e6)
positive = st.floats(1e-6, 1e6)
non_negative = st.just(0.0) | positive
ranges = st.tuples(non_negative, non_negative).map(sorted)
sizes = non_negative | ranges
triples = st.tuples(numbers, numbers, numbers)
directions = triples.filter(lambda v: max(map(abs, v)) > 1e-9)
words = {
    name: st.sampled_from(choices)
    for name, choices in {
        "signal": ("measured", "pose"),
        "no_rule": ("hold", "midrange"),
        "term": config.TERMS,
        "gain_law": ("fixed", "linear", "quadratic"),
        "vector_bias": ("off", "estimated"),
    }.items()
}
sines = st.lists(st.builds(dict, amplitude=numbers, frequency=numbers, phase=numbers), max_size=2)
profiles = st.tuples(sines, sines, sines)


@st.composite
def scenarios(draw: st.DrawFn) -> dict[str, Any]:
    """Scenarios with three landmarks at the corners of a triangle, and any vectors."""
    x, y, z = draw(st.tuples(*[st.floats(-100, 100)] * 3))
    size = draw(st.floats(0.1, 100))
    samples = draw(st.integers(2, 5000))
    sampling_time = draw(st.sampled_from((0.001, 0.01, 0.02, 0.25)))
    corners = [(x, y, z), (x + size, y, z), (x, y + size, z)]
    vector = {"direction": directions, "bias": triples, "noise": non_negative}
    vector |= {"period": st.integers(1, 50), "begin": non_negative}
    return {
        "duration": samples * sampling_time,
        "sampling_time": sampling_time,
        "angular_velocity": draw(profiles),
        "velocity": draw(profiles),
        "velocity_bias": draw(triples),
        "velocity_noise": draw(non_negative),
        "vectors": draw(st.lists(st.builds(dict, **vector, weight=non_negative), max_size=3)),
        "landmarks": [{"position": p, "noise": draw(non_negative)} for p in corners],
        "landmark_period": draw(st.integers(1, 50)),
        "velocity_drift": draw(non_negative),
        "rest": draw(st.lists(st.tuples(non_negative, non_negative).map(sorted), max_size=2)),
        "initial_position_estimate": draw(triples),
    }


shares = st.floats(0, 1)
searches = st.one_of(
    st.builds(GSA, agents=st.integers(2, 99), g0=positive, final_percent=st.floats(0, 100)),
    st.builds(DifferentialEvolution, crossover=shares, strategy=st.just("best/1/bin")),
    st.builds(Adam, agents=st.integers(1, 99), spread=shares, epsilon=positive),
    st.builds(CMAES, sigma=positive),
).map(lambda search: search.model_dump())


@st.composite
def experiments(draw: st.DrawFn) -> Experiment:
    scenario = draw(scenarios())
    last = round(scenario["duration"] / scenario["sampling_time"]) - 1
    windows = st.tuples(st.integers(0, last), st.integers(0, last)).map(sorted)
    row = st.tuples(*[words["term"]] * 5)
    return from_dict(
        {
            "run": {"seed": draw(st.integers(0, 2**32 - 1))},
            "scenario": scenario,
            "filter": {
                "gamma": draw(non_negative | st.tuples(non_negative, non_negative)),
                "gain_limit": draw(positive | st.just("off")),
                "gamma_law": draw(words["gain_law"]),
                "cross_vector": False,
                "normalise_vectors": draw(st.booleans()),
                "vector_bias": draw(words["vector_bias"]),
                "vector_bias_bound": draw(positive),
                "vector_bias_law": draw(words["gain_law"]),
            },
            "family": {
                "vector_bias": draw(non_negative | st.just("off")),
                "outages": draw(st.just("off") | st.builds(dict, rate=st.floats(0, 1))),
                "bursts": draw(st.just("off") | st.builds(dict, size=sizes, each=st.booleans())),
                "noise_jumps": draw(st.just("off") | st.builds(dict, rate=st.floats(0, 1))),
                "jumps": draw(st.just("off") | st.builds(dict, distance=ranges)),
                "rest_share": draw(st.floats(0, 1)),
            },
            "gain": {"signal": draw(words["signal"]), "error_scale": draw(positive)},
            "fuzzy": {"rules": draw(st.tuples(*[row] * 5)), "no_rule": draw(words["no_rule"])},
            # Which further numbers can be tuned depends on the sensors.
            "parameters": {"also": []},
            "cost": {"transient_window": draw(windows), "steady_window": draw(windows)},
            "search": draw(searches),
        }
    )


@settings(deadline=None)
@given(experiments())
def test_toml_gives_every_experiment_back(experiment: Experiment) -> None:
    text = to_toml(experiment)
    assert from_dict(tomllib.loads(text)) == experiment
    assert override(experiment, []) == experiment
    assert from_dict(experiment.model_dump(mode="json")) == experiment


def test_toml_files_give_the_experiment_back(tmp_path: Path) -> None:
    for path in FILES:
        copy = written(tmp_path, to_toml(load(path)).encode())
        assert load(copy) == load(path)


def sorted_terms(k: tuple[float, ...]) -> tuple[float, ...]:
    """The eleven parameters of a universe from 0 to 1, each triangle sorted, then the terms."""
    triangles = [sorted(triangle) for triangle in config.triangles(k, 0.0, 1.0)]
    columns = [sorted(column) for column in zip(*triangles, strict=True)]
    return tuple(value for triangle in zip(*columns, strict=True) for value in triangle)[2:13]


elevens = st.tuples(*[st.floats(0, 1)] * 11)


def boxes(lower: tuple[float, ...], upper: tuple[float, ...]) -> config.ParametersConfig:
    """The same boxes for the inputs and the output."""
    return config.ParametersConfig(lower=lower * 2, upper=upper * 2, gain_range=(0.0, 1.0))


@settings(deadline=None)
@given(elevens, elevens, st.booleans())
def test_disorder_is_what_sorting_would_change(
    one: tuple[float, ...], other: tuple[float, ...], ordered: bool
) -> None:
    lower, upper = (tuple(map(pick, one, other)) for pick in (min, max))
    if ordered:
        lower, upper = sorted_terms(lower), sorted_terms(upper)
    ascend = (sorted_terms(lower), sorted_terms(upper)) == (lower, upper)
    assert ascend == (not list(boxes(lower, upper).disorder()))


@settings(deadline=None)
@given(elevens, elevens, elevens)
def test_sorting_stays_inside_boxes_that_ascend(
    one: tuple[float, ...], other: tuple[float, ...], fractions: tuple[float, ...]
) -> None:
    lower, upper = (sorted_terms(tuple(map(pick, one, other))) for pick in (min, max))
    k = tuple(
        min(high, low + fraction * (high - low))
        for low, high, fraction in zip(lower, upper, fractions, strict=True)
    )
    for low, value, high in zip(lower, sorted_terms(k), upper, strict=True):
        assert low <= value <= high


def test_several_values_of_a_key_are_read_as_toml_and_bare_words():
    for text, key, values in (
        ("filter.gamma=1,5.5, 10", "filter.gamma", [1, 5.5, 10]),
        ("search.optimiser=gsa,de", "search.optimiser", ["gsa", "de"]),
        ("filter.gamma=[1.0, 2.0],3", "filter.gamma", [[1.0, 2.0], 3]),
        ("a.b='x,y',\"z\"", "a.b", ["x,y", "z"]),
        ("a.b={c = 1, d = [2]},true", "a.b", [{"c": 1, "d": [2]}, True]),
    ):
        assert config.values_of(text) == (key, values)
    for text in ("filter.gamma", "filter.gamma=", "gamma=1", "filter.gamma=1,,2", "a.b=[1,2"):
        with pytest.raises(ConfigError, match="allowed: "):
            config.values_of(text)
