"""Every field that is read of a run, on scenarios and on recordings, and of a comparison.

Each field is altered: it is given a few of the values, other fields of its type others.

The file is refused by name and field, or it gives a result that can be shown. Nothing else
happens: no other exception, now or later, and no control character in the output.
"""

import contextlib
import copy
import json
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.experiments import tiny
from helpers.results import K, consistent, description, history, trajectory, trust
from helpers.stored import sealed

import posegsa
from posegsa import config
from posegsa.config import Experiment
from posegsa.errors import ArgumentError, ConfigError, RunFolderError
from posegsa.export import export
from posegsa.judging.comparison import Gradients, OptimiserComparison, Repeat
from posegsa.judging.description import Description, candidate_of, described_filter
from posegsa.judging.evaluation import (
    CONSTANT,
    EKF,
    EKF_ITERATED,
    EKF_VECTORS,
    OPEN_LOOP,
    SMOOTH,
    SWITCH,
    TUNED,
)
from posegsa.judging.known_sensors import KnownSensors
from posegsa.judging.on_recordings import OnRecordings, RecordingScore, SimulatedScore
from posegsa.judging.result import FoundBy, Result
from posegsa.recordings.accuracy import Blocks, Rmse
from posegsa.report import report_html
from posegsa.saving.comparison_files import load_comparison, write_searches
from posegsa.saving.records import to_json
from posegsa.saving.result_files import SCHEMA

VALUES = (
    None,
    True,
    "x",
    "\x1b[31m",
    "nan",
    "inf",
    [],
    {},
    -1,
    0,
    1.5,
    1e308,
    10**30,
    [1],
    {"a": 1},
)
DRAWN = 2
"""Values that each field of a type that many have is given: together they meet all of them."""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of a small result with all contenders, without figures."""
    patch = pytest.MonkeyPatch()
    patch.setattr("posegsa.saving.result_files.draw", lambda *_: {})
    yield posegsa.save(consistent(samples=4), tmp_path_factory.mktemp("run") / "out")
    patch.undo()


@pytest.fixture(scope="module")
def comparison(tmp_path_factory):
    """The folder of a comparison."""
    folder = tmp_path_factory.mktemp("comparison")
    repeats = [
        Repeat(cost, 2 * cost, [0.1], 2.0, 0.1, 0, [10, 20], [2 * cost, cost], [0.5, 1.0])
        for cost in (1.0, np.inf, 3.0)
    ]
    made = OptimiserComparison(
        subject="something",
        budget=20,
        settings={"a": 1},
        repeats={"gsa": repeats, "adam": repeats[::-1]},
        gradients={"adam": Gradients(price=5, begin=0)},
        environment={"jax": "0.10"},
    )
    write_searches(made, folder)
    return folder


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The folder of a constant gain on recordings, compared with one other filter."""
    errors = {phase: Rmse(1.0, 0.5, 0.25, 0.1, 20) for phase in ("judged", "moving")}
    origin = {"gyroscope": "measured"}, ["a gap"]
    one = RecordingScore("a walk", 30, 0.3, False, *origin, errors, "0" * 64, Blocks([1.0], [0.01]))
    axis = (0.0, 0.0, 1.0)
    made = Result(
        experiment=tiny("filter.schedule=constant"),
        filter=description("constant", gain=8.0),
        search=FoundBy(
            tuned_on="recordings and scenarios",
            cost="configured",
            position_weight=10.0,
            best_cost=float(history(3).best[-1]),
            non_finite=0,
            compile_seconds=1.0,
            search_seconds=0.5,
            history=history(3),
        ),
        on_recordings=OnRecordings(
            training=[one],
            held_out=[one, one],
            simulated=SimulatedScore([1.0, 2.0], [3.0]),
            baselines={"VQF": [one, one]},
            sensors=KnownSensors([axis], [2.0], [axis, axis], [1.0, 1.0], attitude_only=False),
        ),
        environment={"jax": "0.10"},
        version="1.2.3",
    )
    return posegsa.save(made, tmp_path_factory.mktemp("recorded") / "out")


def paths(data: Any, before: tuple = ()) -> Iterator[tuple]:
    """Every field in plain data; the first entry of a list represents all."""
    items = data.items() if isinstance(data, dict) else enumerate(data[:1])
    for key, value in items:
        yield (*before, key)
        if isinstance(value, dict | list):
            yield from paths(value, (*before, key))


def some(values: tuple, place: object, count: int = DRAWN) -> list:
    """A few of the values: random, the same in every run, and different for each place."""
    rng = np.random.default_rng(zlib.crc32(repr(place).encode()))
    return [values[i] for i in rng.permutation(len(values))[:count]]


def alterations(data: Any, path: tuple) -> Iterator[str]:
    """The file with one field altered or removed, or with an additional field."""
    *above, name = path
    parent = data
    for key in above:
        parent = parent[key]
    own = parent[name]
    cut = (own[:-1], [*own, *own[-1:]], [*own, "x"]) if isinstance(own, list) else ()
    own_kind = len(path) <= 2 or "filter" in path  # few of them are of the same type
    own_kind = own_kind or (len(path) == 3 and path[1] in ("endurance", "trust"))
    for value in (*(VALUES if own_kind else some(VALUES, path)), *cut):
        if value != own or type(value) is not type(own):
            parent[name] = value
            yield sealed(data)
    parent[name] = own
    whole = copy.copy(parent)
    del parent[name]
    yield sealed(data)
    parent.clear()
    if isinstance(parent, list):
        parent.extend(whole)
        return
    parent.update(whole)
    if name == next(iter(parent)):
        parent["unknown"] = 1
        yield sealed(data)
        del parent["unknown"]


def checked(file: Path, text: str, load) -> Any:
    """The object loaded from a file with this text; None if it is refused correctly."""
    file.write_text(text, encoding="utf-8")
    try:
        return load(file.parent)
    except RunFolderError as error:
        words = str(error).removeprefix(f"{file.parent}/")
        assert ".json: " in words, words
        assert all(c.isprintable() or c == "\n" for c in words), words
        return None


def shown(result: Result) -> str:
    """Check that all texts of a result can be made and have no control characters."""
    texts = [result.summary(), export(result, "json")]
    if result.on_scenarios is not None:
        texts += [result.on_scenarios.evaluation.table(), posegsa.export_c_gain(result)]
    assert all(text.replace("\n", "").isprintable() for text in texts)
    if result.on_scenarios is not None:
        texts.append(report_html(result, {}))
    return "".join(texts)


def rebuilt(found: Description, experiment: Experiment) -> object:
    """The filter that a description means; or the error that names what a filter can't have."""
    if found.kind == "kalman":
        other = config.override(experiment, ["filter.kind=kalman"])
        with contextlib.suppress(ConfigError):  # which names the key and the value
            return described_filter(found, other)
        return found
    return candidate_of(found, experiment)


ON_SCENARIOS = ("on_scenarios", "evaluation", "contenders")


def alike(path: tuple) -> bool:
    """Whether others of its kind represent a field."""
    if path[0] == "experiment":  # is checked like any configuration
        return len(path) > 2
    if path[:3] == ON_SCENARIOS and len(path) > 4 and path[3] != TUNED:
        # All contenders are of one type but for the numbers of their filters: of each kind one, and
        # of the noises of a Kalman filter one.
        noise = path[3] == EKF and len(path) > 6 and path[6] != "filter.vector"
        return "filter" not in path or path[3] not in (SWITCH, OPEN_LOOP, EKF) or noise
    # The scores are of one type, on whatever recordings and of whatever filter.
    return len(path) > 3 and path[:2] in (
        ("on_recordings", "held_out"),
        ("on_recordings", "baselines"),
    )


@pytest.mark.parametrize("name", ["run", "recorded"])
def test_every_field_of_a_result(name, request):
    folder = request.getfixturevalue(name)
    file = folder / "result.json"
    good = file.read_text(encoding="utf-8")
    data, accepted, refused = json.loads(good), 0, 0
    try:
        for path in list(paths(data)):
            if alike(path) or path == ("digest",):
                continue
            for altered in alterations(data, path):
                result = checked(file, altered, posegsa.load)
                refused += result is None
                if result is not None and path[0] != "experiment":
                    accepted += 1
                    shown(result)
                    if path[:3] == ON_SCENARIOS and "filter" in path:
                        found = result.on_scenarios.evaluation.contenders[path[3]].filter
                        assert rebuilt(found, result.experiment)
    finally:
        file.write_text(good, encoding="utf-8")
    assert refused > 100
    assert 30 < accepted < refused, "numbers in the place of others, and names of versions"
    assert shown(posegsa.load(folder))


def test_every_field_of_a_comparison(comparison):
    file = comparison / "comparison.json"
    good = file.read_text(encoding="utf-8")
    data, accepted, refused = json.loads(good), 0, 0
    try:
        for path in list(paths(data)):
            for altered in alterations(data, path):
                found = checked(file, altered, load_comparison)
                refused += found is None
                if found is not None:
                    accepted += 1
                    with np.errstate(all="ignore"):
                        texts = (found.table(), found.markdown())
                    assert all(c.isprintable() or c == "\n" for text in texts for c in text)
    finally:
        file.write_text(good, encoding="utf-8")
    assert refused > 2 * accepted


def altered(folder: Path, path: str, value: Any = None, *, gone: bool = False) -> dict[str, Any]:
    """The data of a result with one field, below its names with slashes, another or gone."""
    data = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    *above, name = path.split("/")
    parent = data
    for key in above:
        parent = parent[key]
    parent[name] = value
    if gone:
        del parent[name]
    return data


def load_text(folder: Path, text: str, **options: Any) -> Result:
    """What is loaded from a folder with another result.json, which then is as before."""
    file = folder / "result.json"
    good = file.read_text(encoding="utf-8")
    file.write_text(text, encoding="utf-8")
    try:
        return posegsa.load(folder, **options)
    finally:
        file.write_text(good, encoding="utf-8")


CONTENDER = "on_scenarios/evaluation/contenders/"


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("on_scenarios/trust/rule_weights", True, "trust.rule_weights"),
        ("on_scenarios/trust/rule_weights", 0.5, "trust.rule_weights"),
        ("on_scenarios/trust/rule_weights", "nan", "trust.rule_weights"),
        ("on_scenarios/trust/rule_weights", [], "trust.rule_weights"),
        ("on_scenarios/training/tuned filter", [1.0], f"training.{CONSTANT}: shape (2,)"),
        ("on_scenarios/trajectory/yaw", [1.0], "trajectory.yaw"),
        ("search/history/best", [1.0], "history.mean: shape (40,)"),
        ("search/history/best", ["x"] * 40, "history.best.0 = 'x'"),
        ("experiment/run/seed", -1, "run.seed = -1"),
        (
            f"{CONTENDER}best open-loop gains/filter/numbers/time",
            ["a", "b"],
            "contenders.best open-loop gains.filter.numbers.time.0 = 'a': ",
        ),
        (
            f"{CONTENDER}best time switch/filter/numbers/before",
            [],
            "contenders.best time switch.filter",
        ),
        (
            f"{CONTENDER}tuned gains replayed/filter/numbers/time",
            [0.0, 2.0, 1.0],
            "ascending time",
        ),
        (f"{CONTENDER}\x1b[31m", {}, "contenders.?[31m.[key] = '\\x1b[31m'"),
        (
            f"{CONTENDER}best open-loop gains/metrics/cost",
            [1.0],
            "contenders.best open-loop gains.metrics.cost: shape (1,)",
        ),
    ],
)
def test_what_once_was_loaded_and_then_crashed_is_refused(run, path, value, said):
    with pytest.raises(RunFolderError) as refused:
        load_text(run, sealed(altered(run, path, value)))
    assert said in str(refused.value)


def test_a_changed_digit_is_found_and_read_on_demand(run):
    text = (run / "result.json").read_text(encoding="utf-8")
    changed = text.replace('"search_seconds": 0.25', '"search_seconds": 0.26')
    assert sum(a != b for a, b in zip(text, changed, strict=True)) == 1
    with pytest.raises(RunFolderError, match=r"result\.json: was changed .*edited=True.*--edited"):
        load_text(run, changed)
    result = load_text(run, changed, edited=True)
    assert result.search.search_seconds == 0.26
    assert posegsa.load(run).search.search_seconds == 0.25
    wrong = json.dumps(altered(run, "search/non_finite", 3))
    with pytest.raises(RunFolderError, match=r"search\.history\.non_finite = 0"):
        load_text(run, wrong, edited=True)  # its parts must fit together nevertheless
    with pytest.raises(RunFolderError, match=r"search\.non_finite = -1"):
        load_text(run, json.dumps(altered(run, "search/non_finite", -1)), edited=True)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"training": {TUNED: np.ones(2)}}, "on_scenarios.training = 1; .*: 2"),
        ({"also": {"gain.smoothing": 1.0}}, "keys of filter.also"),
        ({"parameters": np.full(22, 0.5)}, f"filter of {TUNED}"),
        ({"best_cost": 40.0}, "last of search.history.best"),
        ({"non_finite": 3}, "sum of search.history.non_finite"),
        ({"trajectory": trajectory(60)}, "length of trajectory"),
        ({"trust": trust(rule_weights=None)}, "rule_weights, uncovered = .False, True."),
        ({"trust": trust(uncovered=None)}, "rule_weights, uncovered = .True, False."),
        (
            {"filter": description("fuzzy", k=K, rules=[0] * 25), "on_scenarios": None},
            "filter.numbers: rules only where they were searched",
        ),
    ],
)
def test_parts_that_do_not_fit_together_are_refused(tmp_path, monkeypatch, values, said):
    monkeypatch.setattr("posegsa.saving.result_files.draw", lambda *_: {})
    made = consistent(**values)
    (tmp_path / "result.json").write_text(to_json(made, SCHEMA), encoding="utf-8")
    with pytest.raises(RunFolderError, match=rf"result\.json: .*{said}"):
        posegsa.load(tmp_path)


def test_a_contender_by_its_name_of_an_earlier_version_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr("posegsa.saving.result_files.draw", lambda *_: {})
    data = json.loads(to_json(consistent(), SCHEMA))
    contenders = data["on_scenarios"]["evaluation"]["contenders"]
    contenders["invariant EKF, 3 iterations"] = contenders.pop(EKF_ITERATED)
    (tmp_path / "result.json").write_text(json.dumps(data), encoding="utf-8")
    read = posegsa.load(tmp_path, edited=True).on_scenarios.evaluation
    assert EKF_ITERATED in read.contenders
    assert len(read.contenders) == len(contenders)


@pytest.mark.parametrize("name", [SMOOTH, EKF, EKF_VECTORS])
def test_a_filter_beside_with_other_keys_is_refused(tmp_path, monkeypatch, name):
    monkeypatch.setattr("posegsa.saving.result_files.draw", lambda *_: {})
    data = json.loads(to_json(consistent(), SCHEMA))
    also = data["on_scenarios"]["evaluation"]["contenders"][name]["filter"]["also"]
    also["filter.nothing"] = 1.0
    (tmp_path / "result.json").write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(RunFolderError, match=f"keys of filter.also of {re.escape(name)} = "):
        posegsa.load(tmp_path, edited=True)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d["repeats"]["gsa"][1]["evaluations"].append(30), "repeats.gsa: evaluations"),
        (lambda d: d["repeats"]["gsa"][1]["best"].pop(), "repeats.gsa: .*best"),
        (lambda d: d["gradients"]["adam"].update(begin=20), "gradients.adam.begin"),
        (lambda d: d["repeats"].clear(), "repeats: "),
        (lambda d: d["repeats"]["gsa"].clear(), "repeats.gsa: "),
    ],
)
def test_a_comparison_whose_parts_do_not_fit_together_is_refused(comparison, change, said):
    file = comparison / "comparison.json"
    good = file.read_text(encoding="utf-8")
    data = json.loads(good)
    change(data)
    try:
        file.write_text(sealed(data), encoding="utf-8")
        with pytest.raises(RunFolderError, match=rf"comparison\.json: {said}"):
            load_comparison(comparison)
        file.write_text(json.dumps(json.loads(good) | {"subject": "else"}), encoding="utf-8")
        with pytest.raises(RunFolderError, match=r"comparison\.json: was changed .*run it again"):
            load_comparison(comparison)
    finally:
        file.write_text(good, encoding="utf-8")


@pytest.mark.parametrize("missing", [TUNED, CONSTANT])
def test_a_result_without_its_own_contenders_is_refused(run, missing):
    with pytest.raises(RunFolderError, match=r"result\.json: on_scenarios.training = "):
        load_text(run, sealed(altered(run, CONTENDER + missing, gone=True)))


# Content that is refused or converted -------------------------------------------------------------


@dataclass(frozen=True)
class Nothing:
    """A filter of the user's own, which is only named here."""

    speed: float


def test_a_filter_of_the_users_own_has_to_be_passed(tmp_path, run):
    own = config.override(tiny(), ["filter.kind=own", "filter.speed=2.0"])
    made = replace(
        consistent(samples=4),
        experiment=own,
        filter=Description("own", {}, {}, 0),
        search=None,
        on_scenarios=None,
        own=Nothing,
    )
    posegsa.save(made, tmp_path)
    assert "Nothing" not in (tmp_path / "result.json").read_text(encoding="utf-8")
    with pytest.raises(ArgumentError, match=r"filter: none for .*user's own.*filter=.*--filter"):
        posegsa.load(tmp_path)
    back = posegsa.load(tmp_path, filter=Nothing)
    assert back == made
    assert back.own is Nothing
    with pytest.raises(ArgumentError, match=r"filter for .*none: the run is of a filter of"):
        posegsa.load(run, filter=Nothing)


def test_a_folder_of_an_earlier_version_is_recognised(tmp_path):
    for name in ("result.json", "recorded.json"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / name).write_text('{"schema": 4, "version": "0.8.0"}', encoding="utf-8")
    said = r"schema = 4, .*0\.8\.0.*reads schema 8.*run it again"
    with pytest.raises(RunFolderError, match=said):
        posegsa.load(tmp_path / "result.json")
    with pytest.raises(RunFolderError, match=r"recorded\.json: .*before 0\.9.*run it again"):
        posegsa.load(tmp_path / "recorded.json")
    with pytest.raises(RunFolderError, match="schema = 4"):
        posegsa.load(tmp_path / "result.json", edited=True)
