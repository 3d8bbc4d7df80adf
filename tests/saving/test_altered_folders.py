"""Every field of every file of a run, simulated or recorded, and of a comparison, altered.

Each field gets some of the values; other fields of its type get others.

The file is refused by name and field, or it gives a result that can be shown. Nothing else
happens: no other exception, now or later, and no control character in the output.
"""

import copy
import json
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from helpers.experiments import tiny
from helpers.results import consistent, description, evaluation

import posegsa
from posegsa.errors import RunFolderError
from posegsa.judging.baselines import candidate_of
from posegsa.judging.comparison import Gradients, OptimiserComparison, Repeat
from posegsa.judging.evaluation import EKF, OPEN_LOOP, SWITCH, TUNED, Description
from posegsa.judging.kalman import candidate_of_noises
from posegsa.judging.known_sensors import KnownSensors
from posegsa.judging.recorded import RecordingResult, RecordingScore, SimulatedScore
from posegsa.recordings.accuracy import Rmse
from posegsa.report import report_html
from posegsa.saving.comparison import load_comparison, write_searches

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
CELLS = ("", "x", "nan", "inf", "1e308", "-1", "0", "1.5", "\x1b[31m", "true")
DRAWN = 5
"""Number of values that each field or cell gets. Many fields have the same type, so each type gets
all values."""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of a small result with all contenders, without figures."""
    patch = pytest.MonkeyPatch()
    patch.setattr("posegsa.saving.run.draw", lambda *_: {})
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
    one = RecordingScore("a walk", 30, 0.3, False, *origin, errors, fingerprint="0" * 64)
    axis = (0.0, 0.0, 1.0)
    made = RecordingResult(
        experiment=tiny(),
        tuned_on="recordings and scenarios",
        filter=description("constant", gain=8.0),
        position_weight=10.0,
        best_cost=2.0,
        training=[one],
        held_out=[one, one],
        compile_seconds=1.0,
        search_seconds=0.5,
        environment={"jax": "0.10"},
        version="1.2.3",
        simulated=SimulatedScore([1.0, 2.0], [3.0]),
        baselines={"VQF": [one, one]},
        sensors=KnownSensors([axis], [2.0], [axis, axis], [1.0, 1.0], attitude_only=False),
    )
    return posegsa.save(made, tmp_path_factory.mktemp("recorded") / "out")


def paths(data: Any, before: tuple = ()) -> Iterator[tuple]:
    """Every field in plain data; the first entry of a list stands for all."""
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
    for value in (*(VALUES if own_kind else some(VALUES, path)), *cut):
        if value != own or type(value) is not type(own):
            parent[name] = value
            yield json.dumps(data)
    parent[name] = own
    whole = copy.copy(parent)
    del parent[name]
    yield json.dumps(data)
    parent.clear()
    if isinstance(parent, list):
        parent.extend(whole)
        return
    parent.update(whole)
    if name == next(iter(parent)):
        parent["unknown"] = 1
        yield json.dumps(data)
        del parent["unknown"]


def checked(file: Path, text: str, load) -> Any:
    """The object loaded from a file with this text; None if it is refused correctly."""
    file.write_text(text, encoding="utf-8")
    try:
        return load(file.parent)
    except RunFolderError as error:
        words = str(error).removeprefix(f"{file.parent}/")
        assert ".json: " in words or ".csv: " in words, words
        assert all(c.isprintable() or c == "\n" for c in words), words
        return None


def shown(result: posegsa.TuneResult) -> str:
    """Check that all texts of a result can be made and have no control characters."""
    texts = (result.summary(), result.evaluation.table(), posegsa.export_c_gain(result))
    assert all(c.isprintable() or c == "\n" for text in texts for c in text)
    return "".join(texts) + report_html(result, {})


def rebuilt(found: Description) -> object:
    """The filter for a description."""
    with jax.enable_x64(True):
        if found.kind == "Kalman":
            return candidate_of_noises(found, np.dtype(np.float64))
        return candidate_of(found, posegsa.parameter_space(tiny("run.dtype=float64")))


@pytest.mark.parametrize("name", ["result.json", "evaluation.json"])
def test_every_field_of_a_run(run, name):
    file = run / name
    good = file.read_text(encoding="utf-8")
    data, accepted, refused = json.loads(good), 0, 0
    try:
        for path in list(paths(data)):
            # The summary is not read, the experiment is checked like any configuration, and all
            # contenders are of one type except for the numbers of their filters: one of each kind,
            # and one of the Kalman filter's noises.
            if path[0] == "summary" or (path[0] == "experiment" and len(path) > 2):
                continue
            if path[0] == "contenders" and len(path) > 2 and path[1] != TUNED:
                if "filter" not in path or path[1] not in (SWITCH, OPEN_LOOP, EKF):
                    continue
                if path[1] == EKF and len(path) > 4 and path[4] != "vector":
                    continue
            for altered in alterations(data, path):
                result = checked(file, altered, posegsa.load)
                refused += result is None
                if result is not None and path[0] != "experiment":
                    accepted += 1
                    shown(result)
                    if "filter" in path:
                        assert rebuilt(result.evaluation.contenders[path[1]].filter)
    finally:
        file.write_text(good, encoding="utf-8")
    assert refused > 100
    assert 30 < accepted < refused, "accepted: only numbers in place of others and version names"
    assert shown(posegsa.load(run))


@pytest.mark.parametrize("name", ["history.csv", "trajectory.csv"])
def test_every_column_of_a_run(run, name):
    file = run / name
    good = file.read_text(encoding="utf-8")
    header, *rows = [line.split(",") for line in good.splitlines()]
    refused = 0
    try:
        for column in range(len(header)):
            for row, count in ((0, 1), (len(rows), DRAWN)):
                for cell in some(CELLS, (name, column, row), count):
                    table = copy.deepcopy([header, *rows])
                    table[row][column] = cell
                    text = "\n".join(map(",".join, table)) + "\n"
                    result = checked(file, text, posegsa.load)
                    refused += result is None
                    if result is not None:
                        assert row, "another name of a column was accepted"
                        shown(result)
    finally:
        file.write_text(good, encoding="utf-8")
    assert refused > 2 * len(header)


def test_every_field_of_a_result_on_recordings(recorded):
    file = recorded / "recorded.json"
    good = file.read_text(encoding="utf-8")
    data, accepted, refused = json.loads(good), 0, 0
    try:
        for path in list(paths(data)):
            # All scores are of one type.
            if len(path) > 2 and path[0] in ("experiment", "held_out", "baselines"):
                continue
            for altered in alterations(data, path):
                result = checked(file, altered, posegsa.load_recorded)
                refused += result is None
                if result is not None:
                    accepted += 1
                    texts = (result.summary(), posegsa.export.export(result, "json"))
                    assert all(c.isprintable() or c == "\n" for text in texts for c in text)
    finally:
        file.write_text(good, encoding="utf-8")
    assert refused > 2 * accepted
    assert posegsa.load_recorded(recorded).summary()


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


@pytest.mark.parametrize(
    ("name", "path", "value", "said"),
    [
        ("result.json", ("trust", "rule_weights"), None, "trust.rule_weights = None"),
        ("result.json", ("trust", "rule_weights"), True, "trust.rule_weights = True"),
        ("result.json", ("trust", "rule_weights"), 0.5, "trust.rule_weights = 0.5"),
        ("result.json", ("trust", "rule_weights"), "nan", "trust.rule_weights = 'nan'"),
        (
            "result.json",
            ("trust", "rule_weights"),
            [],
            "trust.rule_weights: shape (0,)",
        ),
        ("result.json", ("constant_gain",), "nan", "constant_gain = 'nan'"),
        ("result.json", ("training_costs",), [1.0], "constant_training_costs: shape (2,)"),
        ("result.json", ("experiment", "run", "seed"), -1, "run.seed = -1"),
        (
            "evaluation.json",
            ("contenders", "best open-loop gains", "filter", "numbers", "time"),
            ["a", "b"],
            "contenders.best open-loop gains.filter.numbers.time.1 = 'b': ",
        ),
        (
            "evaluation.json",
            ("contenders", "best time switch", "filter", "numbers", "before"),
            [],
            "contenders.best time switch.filter",
        ),
        (
            "evaluation.json",
            ("contenders", "tuned gains replayed", "filter", "numbers", "time"),
            [0.0, 2.0, 1.0],
            "ascending time",
        ),
        (
            "evaluation.json",
            ("contenders", "\x1b[31m"),
            {},
            "contenders.?[31m.[key] = '\\x1b[31m'",
        ),
        (
            "evaluation.json",
            ("contenders", "best open-loop gains", "metrics", "cost"),
            [1.0],
            "contenders.best open-loop gains.metrics.cost: shape (1,)",
        ),
    ],
)
def test_what_once_was_loaded_and_then_crashed_is_refused(run, name, path, value, said):
    file = run / name
    good = file.read_text(encoding="utf-8")
    data = json.loads(good)
    node = data
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    file.write_text(json.dumps(data), encoding="utf-8")
    try:
        with pytest.raises(RunFolderError) as refused:
            posegsa.load(run)
    finally:
        file.write_text(good, encoding="utf-8")
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"training_costs": np.ones(3), "constant_training_costs": np.ones(3)}, "training_costs"),
        ({"also": {"gain.smoothing": 1.0}}, "keys of also"),
        ({"constant_gain": 54.0}, "filter.gain"),
        ({"parameters": np.full(22, 0.5)}, "filter.k"),
        ({"best_cost": 40.0}, "last best"),
        ({"non_finite": 3}, "non_finite"),
    ],
)
def test_files_that_do_not_fit_together_are_refused(tmp_path, monkeypatch, values, said):
    monkeypatch.setattr("posegsa.saving.run.draw", lambda *_: {})
    posegsa.save(consistent(**values), tmp_path)
    with pytest.raises(RunFolderError, match=rf"{said}.* = .*; in result\.json: "):
        posegsa.load(tmp_path)


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
        file.write_text(json.dumps(data), encoding="utf-8")
        with pytest.raises(RunFolderError, match=rf"comparison\.json: {said}"):
            load_comparison(comparison)
    finally:
        file.write_text(good, encoding="utf-8")


@pytest.mark.parametrize("missing", ["tuned fuzzy gain", "best constant gains"])
def test_a_result_without_its_own_contenders_is_refused(run, missing):
    file = run / "evaluation.json"
    good = file.read_text(encoding="utf-8")
    data = json.loads(good)
    del data["contenders"][missing]
    assert missing in evaluation().contenders
    try:
        file.write_text(json.dumps(data), encoding="utf-8")
        with pytest.raises(RunFolderError, match="contenders = "):
            posegsa.load(run)
    finally:
        file.write_text(good, encoding="utf-8")
